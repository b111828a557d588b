//! Scenes of given sizes; what the bodies do does not matter for time, but where they are does for the search.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_runtime::core::{Limits, Physics, Posed, Unit};
use rigidformer_runtime::noise::Noise;
use rigidformer_runtime::world::World;

/// Points of the units of MOVi-B's scene 72, which the paper's timings are of.
pub(crate) const PAPER: [usize; 10] = [64, 51, 1142, 64, 64, 682, 682, 647, 51, 569];

/// Units and where they are in two frames.
pub(crate) struct Bodies {
    pub(crate) points: Vec<Vec<Point3<f32>>>,
    pub(crate) previous: Vec<Isometry3<f32>>,
    pub(crate) current: Vec<Isometry3<f32>>,
}

/// Seconds of a step: ten of the model's frames.
pub(crate) const DT_S: f32 = 10.0 / 240.0;

const PHYSICS: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.4 };

impl Bodies {
    /// Ellipsoids of so many points each, close to each other on the ground.
    pub(crate) fn grid(counts: &[usize]) -> Self {
        let points = counts.iter().enumerate().map(|(unit, count)| {
            let mut noise = Noise::new(3, unit as u64);
            let axes = Vector3::from_fn(|_, _| 0.15 + 0.2 * noise.uniform());
            let point = |_| {
                let direction = Vector3::from_fn(|_, _| noise.normal());
                Point3::from(direction.normalize().component_mul(&axes))
            };
            (0..*count).map(point).collect()
        });
        let place = |unit: usize| {
            let mut noise = Noise::new(4, unit as u64);
            let (x, y) = ((unit % 4) as f32, (unit / 4) as f32);
            Vector3::new(0.55 * x + 0.1 * noise.uniform(), 0.55 * y, 0.3 + 0.5 * noise.uniform())
        };
        Self::at(points.collect(), place)
    }

    /// A heap of cubes and a ball, `units` together; 217 are 1,771 points.
    pub(crate) fn wreck(units: usize) -> Self {
        let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
        let cube: Vec<_> =
            (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
        let mut noise = Noise::new(5, 0);
        let ball = (0..43)
            .map(|_| Point3::from(Vector3::from_fn(|_, _| noise.normal()).normalize() * 0.4))
            .collect();
        let mut points = vec![cube; units - 1];
        points.push(ball);
        let side = ((units - 1) as f32).cbrt().ceil() as usize;
        let place = |unit: usize| {
            let [x, y, z] = [unit % side, unit / side % side, unit / side / side];
            if unit == units - 1 {
                return Vector3::new(-0.55, 0.5, 0.5);
            }
            Vector3::new(0.205 * x as f32, 0.205 * y as f32, 0.1 + 0.201 * z as f32)
        };
        Self::at(points, place)
    }

    /// A heap of so many units, and `others` that touch nothing: cubes that fly far above, or lie still on the ground.
    pub(crate) fn sparse(units: usize, others: usize, lying: bool) -> Self {
        let mut bodies = Self::wreck(units);
        let cube = bodies.points[0].clone();
        for other in 0..others {
            let (x, y) = ((other % 16) as f32, (other / 16) as f32);
            let (height, way) = if lying { (0.1, 0.0) } else { (20.0, 0.02) };
            let pose = |back: f32| Isometry3::translation(3.0 + x + way * back, y, height);
            bodies.points.push(cube.clone());
            bodies.previous.push(pose(1.0));
            bodies.current.push(pose(0.0));
        }
        bodies
    }

    fn at(points: Vec<Vec<Point3<f32>>>, place: impl Fn(usize) -> Vector3<f32>) -> Self {
        let pose = |unit: usize, back: f32| {
            let mut noise = Noise::new(6, unit as u64);
            let turn = Vector3::from_fn(|_, _| 0.1 * noise.normal());
            let travel = Vector3::from_fn(|_, _| 0.01 * noise.normal());
            Isometry3::from_parts(
                Translation3::from(place(unit) - travel * back),
                UnitQuaternion::from_scaled_axis(turn * (1.0 - 0.1 * back)),
            )
        };
        let previous = (0..points.len()).map(|unit| pose(unit, 1.0)).collect();
        let current = (0..points.len()).map(|unit| pose(unit, 0.0)).collect();
        Bodies { points, previous, current }
    }

    pub(crate) fn total(&self) -> usize {
        self.points.iter().map(Vec::len).sum()
    }

    pub(crate) fn limits(&self) -> Limits {
        Limits { units: self.points.len(), points: self.total() }
    }

    pub(crate) fn units(&self) -> Vec<Posed<'_>> {
        let poses = self.previous.iter().zip(&self.current);
        let units = self.points.iter().zip(poses).map(|(points, (previous, current))| Posed {
            unit: Unit::new(points, PHYSICS),
            previous: *previous,
            current: *current,
        });
        units.collect()
    }

    pub(crate) fn observe(&self, world: &mut World) {
        let observed = world.edit(|simulator| simulator.observe_poses(DT_S, self.units()));
        assert!(observed.is_ok(), "{observed:?}");
    }
}
