//! The nearest point without trying all points: a tree over each unit's points, which a rigid
//! unit keeps, and a box around each unit, which every step moves.
//!
//! The answer is that of brute force, bit for bit: `search` says why. All of it lies in one slice
//! of f32 numbers, in groups of [`WIDTH`], so that one pass over arrays of that length bounds or
//! measures a whole group:
//!
//! - a **leaf** is [`WIDTH`] points: x, y, z and the point's number in its unit;
//! - a **node** is the boxes of [`WIDTH`] leaves, a **root** those of [`WIDTH`] nodes;
//! - a **group** is the boxes of [`WIDTH`] units in the world.
//!
//! A unit's tree is its roots, its nodes, its leaves; where one node or leaf is all, nothing is
//! above it.

mod bounds;
mod layout;
mod parts;
mod place;
mod search;
#[cfg(test)]
mod tests;
mod tree;

pub(crate) use layout::{ROW, Room};
pub use parts::Index;
pub(crate) use parts::{Answers, Parts};
pub(crate) use search::nearest;
