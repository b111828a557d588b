//! A simulator of one scene, whatever its compile-time limit.

use nalgebra::{Isometry3, Point3};
use rigidformer_runtime::core::geometry::Pose;
use rigidformer_runtime::core::{
    ANCHORS, Layer, Limits, Model, Simulator, SlabSizes, Slabs, StepError, Trace, Unit,
};
use rigidformer_runtime::rollout::{MAX_UNITS, RolloutError, check_fit};
use rigidformer_runtime::scenes::RecordedScene;

/// What the harness does with a simulator.
pub(crate) trait Stepping {
    /// Starts from the recorded poses at frames `frame - step` and `frame`.
    fn observe(&mut self, scene: &RecordedScene, step: u32, frame: u32)
    -> Result<(), RolloutError>;

    fn step(&mut self, trace: &mut dyn Trace) -> Result<(), StepError>;

    /// World positions of a unit's anchors.
    fn anchors(&self, unit: usize) -> [Point3<f32>; ANCHORS];

    /// The state whose bits targets are compared by.
    fn internal_pose(&self, unit: usize) -> Option<Pose>;
}

/// `Simulator::step_traced` takes sized traces only.
struct Borrowed<'t>(&'t mut dyn Trace);

impl Trace for Borrowed<'_> {
    fn record(&mut self, layer: Layer, index: usize, values: &[f32]) {
        self.0.record(layer, index, values);
    }
}

impl<const UNITS: usize> Stepping for Simulator<'_, '_, UNITS> {
    fn observe(
        &mut self,
        scene: &RecordedScene,
        step: u32,
        frame: u32,
    ) -> Result<(), RolloutError> {
        let poses =
            |frame: Option<u32>| -> Option<Vec<Isometry3<f32>>> { scene.poses_at(frame? as usize) };
        let (Some(previous), Some(current)) = (poses(frame.checked_sub(step)), poses(Some(frame)))
        else {
            let (scene, recorded) = (scene.name().into(), scene.frames());
            return Err(RolloutError::TooFewFrames { scene, step, recorded });
        };
        let units: Vec<Unit<'_>> = scene
            .units()
            .iter()
            .map(|recorded| Unit { points: &recorded.points, physics: recorded.physics })
            .collect();
        self.observe_poses(step, &units, &previous, &current)
            .map_err(|source| RolloutError::Observe { scene: scene.name().into(), source })?;
        Ok(())
    }

    fn step(&mut self, trace: &mut dyn Trace) -> Result<(), StepError> {
        self.step_traced(&mut Borrowed(trace))?;
        Ok(())
    }

    fn anchors(&self, unit: usize) -> [Point3<f32>; ANCHORS] {
        // The farthest-point order begins with the anchors.
        let mut points = self.points(unit);
        std::array::from_fn(|_| points.next().unwrap_or_else(Point3::origin))
    }

    fn internal_pose(&self, unit: usize) -> Option<Pose> {
        Simulator::internal_pose(self, unit)
    }
}

/// Runs `body` with a simulator that has room for the scene.
pub(crate) fn with_simulator<R>(
    model: &Model<'_>,
    scene: &RecordedScene,
    body: impl FnOnce(&mut dyn Stepping) -> Result<R, RolloutError>,
) -> Result<R, RolloutError> {
    check_fit(model, scene)?;
    let units = scene.units().len();
    match units {
        0..=16 => run::<16, R>(model, scene, body),
        17..=64 => run::<64, R>(model, scene, body),
        65..=MAX_UNITS => run::<MAX_UNITS, R>(model, scene, body),
        _ => Err(RolloutError::TooManyUnits { scene: scene.name().into(), units }),
    }
}

fn run<const UNITS: usize, R>(
    model: &Model<'_>,
    scene: &RecordedScene,
    body: impl FnOnce(&mut dyn Stepping) -> Result<R, RolloutError>,
) -> Result<R, RolloutError> {
    let limits = Limits { units: scene.units().len(), points: scene.points() };
    let sizes = SlabSizes::new(model.config(), limits);
    let mut f32_slab = vec![0.0; sizes.f32];
    let mut i8_slab = vec![0; sizes.i8];
    let mut point_slab = vec![Point3::origin(); sizes.points];
    let slabs = Slabs { f32: &mut f32_slab, i8: &mut i8_slab, points: &mut point_slab };
    let mut simulator = Simulator::<'_, '_, UNITS>::new(model, limits, slabs)
        .map_err(|source| RolloutError::Workspace { scene: scene.name().into(), source })?;
    body(&mut simulator)
}
