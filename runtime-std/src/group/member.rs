//! Members of a group.

use super::error::GroupError;
use super::id::MemberId;
use crate::world::{Undo, World};

/// A world of a group.
pub(super) struct Member {
    pub(super) id: MemberId,
    pub(super) name: String,
    pub(super) world: World,
    /// None: it takes nobody in.
    pub(super) distance_m: Option<f32>,
    pub(super) undo: Undo,
}

impl Member {
    /// Whether it moves before those that have no command.
    pub(super) fn is_commanded(&self) -> bool {
        self.world.model().model().config().command_size > 0
    }

    /// The world's time step, where the world can be a member's.
    pub(super) fn check(name: &str, world: &World) -> Result<f32, GroupError> {
        let (name, simulator) = (|| name.to_owned(), world.simulator());
        let copies = simulator.copies();
        if copies > 1 {
            return Err(GroupError::Copies { name: name(), copies });
        }
        simulator.dt_s().ok_or_else(|| GroupError::NoTimestep { name: name() })
    }
}
