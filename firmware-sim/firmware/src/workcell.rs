//! A robot's workplace: what the image `robot` does step by step. This machine compiles this file too, for
//! `tests/src/firmware.rs`, so that both take the same steps.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::geometry::Pose;
use rigidformer_core::{EditError, Physics, Plane, Posed, Role, Simulator, Unit, UnitId};

/// Steps that it takes.
pub const STEPS: u32 = 20;
/// The step before which a unit is added.
const ADDED: u32 = 5;
/// The step before which a unit is removed.
const REMOVED: u32 = 10;
/// Seconds of a step: five of the model's native frames.
const DT_S: f32 = 5.0 / 240.0;
/// How far the driven unit goes in a step, metres.
// A power of two, so that places add up without rounding.
const PUSH_M: f32 = 0.015_625;
/// Points of the table along each axis.
const TABLE: [usize; 3] = [9, 5, 2];
/// Points of all other units along each axis.
const CUBE: [usize; 3] = [5, 3, 3];

/// A workplace after its observation.
#[derive(Clone, Copy, Debug)]
pub struct Workcell {
    table: UnitId,
    table_pose: Pose,
    pusher: UnitId,
    /// The driven unit's centre in its reference frame.
    pusher_centre: Point3<f32>,
    on_ramp: UnitId,
    /// Where the driven unit was told to go last.
    told: Isometry3<f32>,
}

/// A lattice of points in a box about the origin, so many along each axis.
fn cuboid<const POINTS: usize>(half: [f32; 3], counts: [usize; 3]) -> [Point3<f32>; POINTS] {
    core::array::from_fn(|i| {
        let index = [i % counts[0], i / counts[0] % counts[1], i / (counts[0] * counts[1])];
        let side = |axis: usize| {
            let last = (counts[axis] - 1) as f32;
            (2.0 * index[axis] as f32 - last) * (half[axis] / last)
        };
        Point3::new(side(0), side(1), side(2))
    })
}

fn at(x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::identity())
}

/// Where the driven unit is before a step: a finger that is turned by 0.2 radians about z.
fn finger(step: u32) -> Isometry3<f32> {
    // Numbers, because sines differ between machines.
    let turned = Quaternion::new(0.995_004_2, 0.0, 0.0, 0.099_833_42);
    Isometry3::from_parts(
        Translation3::new(-0.5 + PUSH_M * step as f32, 0.0, 0.375),
        UnitQuaternion::new_unchecked(turned),
    )
}

impl Workcell {
    /// Observes a table, a finger over it, a box before the finger, a box on a ramp and two units of one body.
    pub fn observe(simulator: &mut Simulator<'_, '_>) -> Result<Self, EditError> {
        let wood = Physics { mass_kg: 0.5, friction: 0.5, restitution: 0.25 };
        let floor = Plane::ground(0.3, 0.5);
        let ramp = Plane { normal: Vector3::new(0.0, 0.6, 0.8), offset_m: -0.6, ..floor };
        let wall = Plane { normal: Vector3::new(-1.0, 0.0, 0.0), offset_m: -1.25, ..floor };
        simulator.set_planes(&[floor, ramp, wall])?;
        let (table, rod) =
            (cuboid::<90>([0.75, 0.375, 0.125], TABLE), cuboid::<45>([0.0625, 0.125, 0.125], CUBE));
        let (cube, link) =
            (cuboid::<45>([0.125; 3], CUBE), cuboid::<45>([0.25, 0.125, 0.125], CUBE));
        let still = |unit, pose| Posed { unit, previous: pose, current: pose };
        let units = [
            still(Unit::new(&table, wood).role(Role::Fixed), at(0.0, 0.0, 0.125)),
            // At the origin, which shows its centre; it goes to its place below.
            still(Unit::new(&rod, wood).role(Role::Driven), Isometry3::identity()),
            still(Unit::new(&cube, wood), at(-0.25, 0.0, 0.375)),
            still(Unit::new(&cube, wood), at(0.25, -1.5, 0.625)),
            still(Unit::new(&link, wood).body(1), at(0.75, 1.0, 0.125)),
            // It is inside the other unit by 3 cm: units of one body do not collide.
            Posed {
                unit: Unit::new(&link, wood).body(1),
                previous: at(1.0, 1.0, 0.359_375),
                current: at(1.0, 1.0, 0.343_75),
            },
        ];
        simulator.observe_poses(DT_S, units)?;
        let name = |number| simulator.unit(number).map_or(UnitId::from_bits(0), |unit| unit.id());
        let table_pose = simulator.unit(0).map_or(Pose::default(), |unit| unit.internal_pose());
        let pusher_pose = simulator.unit(1).map_or(Pose::default(), |unit| unit.internal_pose());
        let (table, pusher, on_ramp) = (name(0), name(1), name(3));
        let (told, pusher_centre) = (finger(0), Point3::from(pusher_pose.centre));
        // Its centre is read off first, which the check after each step needs.
        simulator.set_poses(pusher, &told, &told)?;
        Ok(Workcell { table, table_pose, pusher, pusher_centre, on_ramp, told })
    }

    /// What the robot does before a step, counted from 0.
    pub fn prepare(
        &mut self,
        simulator: &mut Simulator<'_, '_>,
        step: u32,
    ) -> Result<(), EditError> {
        self.told = finger(step + 1);
        simulator.drive(self.pusher, &self.told)?;
        if step == ADDED {
            let light = Physics { mass_kg: 0.25, friction: 0.5, restitution: 0.75 };
            let points = cuboid::<45>([0.125, 0.125, 0.0625], CUBE);
            simulator.add(
                &Unit::new(&points, light),
                &at(0.5, 0.0, 0.75),
                &at(0.5, 0.0, 0.718_75),
            )?;
        }
        if step == REMOVED {
            simulator.remove(self.on_ramp)?;
        }
        Ok(())
    }

    /// What must hold after every step.
    pub fn check(&self, simulator: &Simulator<'_, '_>) -> Result<(), &'static str> {
        let pose = |id| simulator.get(id).map(|unit| bits(&unit.internal_pose()));
        // Bits, because a fixed unit is never written.
        if pose(self.table) != Some(bits(&self.table_pose)) {
            return Err("the fixed unit moved");
        }
        let told = Pose::from_isometry(&self.told, &self.pusher_centre);
        let found = simulator.get(self.pusher).map(|unit| unit.internal_pose());
        match found {
            Some(found) if is_there(&found, &told) => Ok(()),
            _ => Err("the driven unit is not where it was told to go"),
        }
    }
}

/// Whether a pose is another one to the bit, but for what centres lose on the way to a scene's own length and back.
fn is_there(found: &Pose, told: &Pose) -> bool {
    let lost = found.centre - told.centre;
    let Pose { rotation, .. } = told;
    // The model measures scenes in their own length, and a centre rounds on the way there and back.
    found.rotation == *rotation && lost.amax() <= 2.0 * f32::EPSILON * told.centre.amax()
}

fn bits(pose: &Pose) -> [u32; 12] {
    let mut numbers = pose.rotation.iter().chain(&pose.centre);
    core::array::from_fn(|_| numbers.next().map_or(0, |number| number.to_bits()))
}
