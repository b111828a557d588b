//! Contact: what units touch with, when they touch, and what impulses make of it.
//!
//! | file | does |
//! |---|---|
//! | `ground` | the planes of a scene |
//! | `height_field` | ground of varying height |
//! | `law` | how contacts that bounce differ from rigid ones |
//! | `pieces` | convex pieces of hollow units |
//! | `impacts` | a unit's first impacts under free motion |
//! | `solver` | rigid motion with contact by sequential impulses |
//! | `prior` | the solver's motion, as the network corrects it |

pub(crate) mod ground;
#[cfg(feature = "terrain")]
pub(crate) mod height_field;
pub(crate) mod impacts;
pub(crate) mod law;
pub(crate) mod pieces;
pub(crate) mod prior;
mod solver;
