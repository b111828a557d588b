//! What the structure of a scene does in a step. A build that leaves a structure out has [`Absent`] in its place.

use crate::geometry::State;
use crate::kernels::Schedule;
use crate::model::Model;
use crate::scene::{Scene, UnitSlot};
use crate::sizes::Sizes;
use crate::workspace::Rows;
use core::marker::PhantomData;
use rigidformer_weights::ModelConfig;

/// Where the step under way takes the units of a copy, and what that follows from.
#[allow(dead_code, reason = "builds that leave structures out do not read all of it")]
pub(crate) struct Attempt<'a, 's> {
    pub(crate) model: &'a Model<'a>,
    pub(crate) sizes: &'a Sizes,
    pub(crate) scene: &'a mut Scene<'s>,
    pub(crate) copy: usize,
    /// Motion by impulses; empty for models without.
    pub(crate) solved: &'a [f32],
    /// (units of the copy, [`STATE`](crate::geometry::STATE))
    pub(crate) next: &'a mut [f32],
    pub(crate) rows: &'a mut Rows<'s>,
}

/// Units that hold together or deform. What a structure does not say is left as it is.
pub(crate) trait Structure {
    /// Finds the motion of a copy that the network corrects, where that is not by impulses.
    fn prior(_config: &ModelConfig, _scene: &mut Scene<'_>, _copy: usize) {}

    /// Where a free unit goes, where its points go their own ways.
    fn state(_scene: &Scene<'_>, _index: usize, unit: &UnitSlot) -> State {
        unit.state()
    }

    /// Changes where units go, so that they hold together. The number in the copy of a unit that goes nowhere is an error.
    fn constrain<S: Schedule>(_schedule: S, _attempt: Attempt<'_, '_>) -> Result<(), usize> {
        Ok(())
    }

    /// Takes over where the step has taken a copy.
    fn commit(_scene: &mut Scene<'_>, _copy: usize) {}

    /// Lets what the network says comes apart in this step come apart, in all copies; whether there is any.
    fn come_apart<S: Schedule>(
        &mut self,
        _schedule: S,
        (_model, _sizes): (&Model<'_>, &Sizes),
        _scene: &mut Scene<'_>,
        (_solved, _rows): (&[f32], &mut Rows<'_>),
    ) -> bool {
        false
    }

    /// Ends a step of a copy: what came apart stays so, or holds again where the step failed.
    fn finish(&mut self, _model: &Model<'_>, _scene: &mut Scene<'_>, _copy: usize, _failed: bool) {}
}

/// A structure that the build leaves out.
#[derive(Default)]
#[allow(dead_code, reason = "builds with all features have none")]
pub(crate) struct Absent<'s>(PhantomData<&'s mut [f32]>);

impl Structure for Absent<'_> {}
