//! Why a group cannot do what it is asked.

use rigidformer_core::{CommandError, EditError, Limits, StepError};

use super::id::MemberId;
use crate::world::WorldError;

/// Why a group refused; it is what it was. Its text names the member and the remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GroupError {
    /// A member needs a name of its own.
    #[error("a member is called {name:?} already; give another name, or remove that one first")]
    NameTaken {
        /// The name.
        name: String,
    },
    /// A name without letters tells nobody apart.
    #[error("a member's name is empty; give it one")]
    NoName,
    /// No member has that id.
    #[error("member {} is none of this group: it was removed, or is of another group", .id.to_bits())]
    NoSuchMember {
        /// The id.
        id: MemberId,
    },
    /// A member's world has no time step.
    #[error("{name}: its world has no time step yet; observe its units, or give it one, first")]
    NoTimestep {
        /// The member.
        name: String,
    },
    /// A member's world steps by another time than the others'.
    #[error(
        "{name}: its steps take {dt_s} s, those of the group {group_dt_s} s; observe its units that far apart, or use a model of that step"
    )]
    OtherTimestep {
        /// The member.
        name: String,
        /// Seconds of its steps.
        dt_s: f32,
        /// Seconds of the steps of the others.
        group_dt_s: f32,
    },
    /// A member's world has copies, and the group shows the first one alone.
    #[error("{name}: its world has {copies} copies; a member has one scene, so retain one copy")]
    Copies {
        /// The member.
        name: String,
        /// Copies.
        copies: usize,
    },
    /// A distance is no distance.
    #[error("a distance of {distance_m} m; give a finite number of metres, 0 or more")]
    Distance {
        /// The number given.
        distance_m: f32,
    },
    /// Scenes of soft units take no others.
    #[error(
        "{name}: its model moves soft bodies, whose scenes take no units of others; give it no neighbour distance"
    )]
    Soft {
        /// The member.
        name: String,
    },
    /// A member's world has no room for its neighbours.
    #[error(
        "{name}: its units and those of others near it are {} with {} points in all, its world holds {} with {}; raise the limits of its world, or shorten its neighbour distance",
        .needed.units, .needed.points, .limits.units, .limits.points
    )]
    Room {
        /// The member.
        name: String,
        /// What its units and its neighbours need.
        needed: Limits,
        /// What its world was made for.
        limits: Limits,
    },
    /// A command was refused.
    #[error("{name}: {source}")]
    Command {
        /// The member.
        name: String,
        /// Why.
        source: CommandError,
    },
    /// A member's world does not take a unit of another member as it moves.
    #[error("{name}: a neighbour of {of} cannot be added to its world: {source}")]
    Neighbour {
        /// The member.
        name: String,
        /// Whose unit.
        of: String,
        /// Why.
        source: EditError,
    },
    /// A member's step failed.
    #[error("{name}: {source}")]
    Step {
        /// The member.
        name: String,
        /// Why.
        source: StepError,
    },
    /// A copy of a member cannot be made.
    #[error("{name}: {source}")]
    World {
        /// The member.
        name: String,
        /// Why.
        source: WorldError,
    },
}
