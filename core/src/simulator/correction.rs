//! Whether the network corrects motion.

use super::state::Simulator;

impl Simulator<'_, '_> {
    /// Lets the network correct motion, as it does at first, or leaves it out: what a model is worth shows beside the same motion without it.
    ///
    /// Without the network its output is 0, and contacts are rigid, whatever the model's
    /// [contact law](rigidformer_weights::ContactLaw) says. Models that move units by impulses then move them by impulses alone.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_core::{Limits, Model, Physics, Simulator, Unit, Workspace};
    /// use rigidformer_weights::{AlignedBuffer, ModelFile};
    ///
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// let bytes = AlignedBuffer::copy_of(include_bytes!("../../../weights/models/nano.rfm"));
    /// let model = Model::load(ModelFile::parse(&bytes)?)?;
    /// let mut workspace = Workspace::new(model.config(), Limits { units: 1, points: 8 });
    /// let mut simulator = workspace.simulator(&model)?;
    /// let cube = [-0.1_f32, 0.1].map(|x| [-0.1, 0.1].map(|y| [-0.1, 0.1].map(|z| Point3::new(x, y, z))));
    /// let cube: Vec<_> = cube.into_iter().flatten().flatten().collect();
    /// let at = |z| Isometry3::translation(0.0, 0.0, z);
    /// let rubber = Physics { mass_kg: 0.5, friction: 0.8, restitution: 0.7 };
    /// let falls = simulator.add(&Unit::new(&cube, rubber), &at(0.14), &at(0.12))?;
    /// simulator.set_network(false);
    /// simulator.step()?;
    /// assert!(simulator.pose(falls).is_some_and(|pose| pose.translation.z > 0.0));
    /// # Ok(())
    /// # }
    /// ```
    pub fn set_network(&mut self, corrects: bool) {
        self.has_network = corrects;
    }

    /// Whether the network corrects motion: see [`set_network`](Self::set_network). Models leave copies of more units than their
    /// [`most_units`](rigidformer_weights::ModelConfig::most_units) alone all the same.
    pub fn has_network(&self) -> bool {
        self.has_network
    }

    /// Whether it does in a copy of as many units as there are.
    pub(super) fn corrects(&self) -> bool {
        let most = self.model.config().most_units as usize;
        self.has_network && (most == 0 || self.scene.per_copy <= most)
    }
}
