//! What of the network's output anybody reads in a step.

use crate::contact::prior;
use crate::kernels::Schedule;
use crate::scene::Scene;
use crate::sizes::Sizes;
use crate::trace::Trace;

/// Which units the network has to look at: all, or those that it corrects.
#[derive(Clone, Copy)]
pub(crate) struct Wanted {
    all: bool,
}

impl Wanted {
    /// All, unless the schedule leaves out what nobody reads and impulses say which units are corrected.
    pub(crate) fn of<S: Schedule, T: Trace>(schedule: S, sizes: &Sizes, trace: &T) -> Self {
        Wanted { all: !schedule.skips() || sizes.solved == 0 || trace.records() }
    }

    /// Whether a unit's own output is read; `solved` is what [`prior::solve`] has written.
    pub(crate) fn unit(self, scene: &Scene<'_>, index: usize, solved: &[f32]) -> bool {
        // The output of a unit with a share of 0 is multiplied by it.
        self.all || prior::share(scene, index, solved) > 0.0
    }

    /// Whether that of any is.
    pub(crate) fn any(self, scene: &Scene<'_>, solved: &[f32]) -> bool {
        self.all || (0..scene.count).any(|index| self.unit(scene, index, solved))
    }
}
