//! Where the words of a snapshot are, and what some of them mean.

use crate::contact::law::FrictionLimit;
use crate::geometry::{COURSE, POSE};
use crate::scene::Role;
#[cfg(feature = "robot")]
use crate::structure::link::Way;

/// What a snapshot begins with.
pub(super) const MAGIC: u32 = u32::from_le_bytes(*b"RFST");
/// Of this layout; it rises with each change.
pub(super) const VERSION: u32 = 2;

/// Words before what all copies share.
pub(super) const HEAD: usize = 7;
/// Words of that before the planes.
pub(super) const SCENE: usize = 14;
/// Words of a plane, a unit, a pair of bonded units, and in a copy of a unit and a bond.
pub(super) const PLANE: usize = 6;
pub(super) const UNIT: usize = 19;
pub(super) const PAIR: usize = 2;
pub(super) const COPY_UNIT: usize = COPY_COURSE + COURSE;
/// Words of it before the course.
pub(super) const COPY_COURSE: usize = 6 + 3 * POSE;
pub(super) const COPY_BOND: usize = 6;
/// Words of a point of a soft unit, at rest and in a copy.
pub(super) const REST: usize = 4;
pub(super) const SOFT: usize = 6;

/// Words of the checksum behind all.
pub(super) const END: usize = 2;

/// A command was set.
pub(super) const COMMANDED: u32 = 1;
/// Units that diverge are held.
pub(super) const QUARANTINES: u32 = 2;
/// Contact of a plane or a unit gives way: each of them has [`COMPLIANCE`] words more.
pub(super) const GIVES_WAY: u32 = 4;
/// The network does not correct motion.
pub(super) const NO_NETWORK: u32 = 8;
/// Contacts that bounce are no rigid ones: [`LAW`] words behind those of the scene say how they differ.
pub(super) const LAWFUL: u32 = 16;
/// Joints have axes, or leave nothing open: each unit has [`GUIDE`] words more, and [`TARGET`] in a copy.
pub(super) const GUIDED: u32 = 32;
/// The scene is on a height field: [`TERRAIN`] words more say on which.
pub(super) const ON_TERRAIN: u32 = 64;
/// Words of which height field it is.
pub(super) const TERRAIN: usize = 2;
/// Words of how contact gives way.
pub(super) const COMPLIANCE: usize = 2;
/// Words of how contacts that bounce differ from rigid ones.
pub(super) const LAW: usize = 2;

/// Words of what a joint lets a unit do: its kind, axis, rest, limits and force.
pub(super) const GUIDE: usize = 11;
/// Words of where a joint is wanted.
pub(super) const TARGET: usize = 1;

/// The solver takes the unit for a ball.
pub(super) const BALL: u32 = 1 << 2;
/// It is a patch of a soft body.
pub(super) const PATCH: u32 = 1 << 3;
/// Where the number of its pieces begins.
pub(super) const PIECES: u32 = 8;

/// A limit of friction as a number.
pub(super) fn code_of_limit(friction: FrictionLimit) -> u32 {
    match friction {
        FrictionLimit::Cone => 0,
        FrictionLimit::Pyramid => 1,
    }
}

/// The limit of friction of a number.
pub(super) fn limit_of(code: u32) -> Option<FrictionLimit> {
    let all = [FrictionLimit::Cone, FrictionLimit::Pyramid];
    all.into_iter().find(|friction| code_of_limit(*friction) == code)
}

/// A role as a number.
pub(super) fn code_of(role: Role) -> u32 {
    match role {
        Role::Free => 0,
        Role::Driven => 1,
        Role::Fixed => 2,
    }
}

/// The role of a number.
pub(super) fn role_of(code: u32) -> Option<Role> {
    [Role::Free, Role::Driven, Role::Fixed].into_iter().find(|role| code_of(*role) == code)
}

/// What a joint leaves open as a number.
#[cfg(feature = "robot")]
pub(super) fn code_of_way(way: Way) -> u32 {
    match way {
        Way::Ball => 0,
        Way::Turns => 1,
        Way::Slides => 2,
        Way::Fixed => 3,
    }
}

/// What a joint of a number leaves open.
#[cfg(feature = "robot")]
pub(super) fn way_of(code: u32) -> Option<Way> {
    [Way::Ball, Way::Turns, Way::Slides, Way::Fixed]
        .into_iter()
        .find(|way| code_of_way(*way) == code)
}
