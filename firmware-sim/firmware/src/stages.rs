//! Where the instructions of a step go.

use rigidformer_core::{Layer, Stage, Trace};

use crate::counter::{Counter, Moment};

/// Names of the stages, as the report has them.
pub const NAMES: [&str; 6] = ["impulses", "nearest", "encoder", "interaction", "anchors", "kabsch"];

/// Adds instructions up, stage by stage.
#[derive(Clone, Copy, Debug)]
pub struct Stages {
    counter: Counter,
    since: Moment,
    stage: usize,
    /// Instructions of each stage.
    pub spent: [u64; NAMES.len()],
}

impl Stages {
    /// Nothing spent so far.
    pub fn new(counter: Counter) -> Stages {
        Stages { counter, since: counter.now(), stage: 0, spent: [0; NAMES.len()] }
    }

    /// Call it right before a step.
    pub fn begin(&mut self) {
        // What comes before the first stage belongs to none.
        self.stage = usize::MAX;
        self.since = self.counter.now();
    }

    /// Call it right after a step.
    pub fn end(&mut self) {
        let now = self.counter.now();
        if let Some(spent) = self.spent.get_mut(self.stage) {
            *spent += u64::from(self.counter.between(self.since, now));
        }
        self.since = now;
    }
}

impl Trace for Stages {
    fn record(&mut self, _: Layer, _: usize, _: &[f32]) {}

    // Layers are not recorded, so that counting costs nothing but the counting.
    fn records(&self) -> bool {
        false
    }

    fn enter(&mut self, stage: Stage) {
        self.end();
        self.stage = match stage {
            Stage::Impulses => 0,
            Stage::Inputs => 1,
            Stage::Encoder => 2,
            Stage::Interaction => 3,
            Stage::Anchors => 4,
            // Integration, the fit and all that ends a step.
            _ => 5,
        };
    }
}
