//! A robot that walks under command: what the image `walk` does step by step. This machine compiles this file too, for
//! `tests/src/firmware.rs`, so that both take the same steps.
//!
//! `scenes/walk.bin`, little-endian: step code, frames a second, links, points of a link, joints (u32 each); friction and restitution of
//! the ground; mass, friction, restitution of each link; its points in its own frame (x, y, z in metres); the poses of all links a
//! step ago, then those of now (x, y, z, quaternion w, x, y, z); of each joint the link that hangs and its parent (u32 each), then
//! the pivot in the frames of both. Numbers are f32.

use bytemuck::{Pod, try_cast_slice};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use rigidformer_core::{Joint, Physics, Plane, Posed, Simulator, Unit, UnitId};

/// Steps that it takes.
pub const STEPS: u32 = 10;
/// Commands, (vx, vy, yaw rate), m/s and rad/s in the robot's heading, each for a half of the steps.
// Multiples of an eighth, which f32 holds exactly.
const COMMANDS: [[f32; 3]; 2] = [[0.5, 0.0, 0.25], [0.25, 0.125, -0.5]];
/// Numbers of a pose.
const POSE: usize = 7;

/// Two frames of a robot, in place.
#[derive(Clone, Copy, Debug)]
pub struct Walk<'w> {
    step: u32,
    frame_rate_hz: u32,
    /// Points of a link.
    count: usize,
    ground: [f32; 2],
    physics: &'w [[f32; 3]],
    points: &'w [Point3<f32>],
    previous: &'w [[f32; POSE]],
    current: &'w [[f32; POSE]],
    /// (joints) Numbers of the link that hangs and of its parent.
    pairs: &'w [[u32; 2]],
    pivots: &'w [[Point3<f32>; 2]],
}

/// The next so many of a file.
fn take<'w, T: Pod>(rest: &mut &'w [u8], count: usize) -> Option<&'w [T]> {
    // Counts come from the file, so products may overflow.
    let (taken, after) = rest.split_at_checked(count.checked_mul(size_of::<T>())?)?;
    *rest = after;
    try_cast_slice(taken).ok()
}

fn pose(&[x, y, z, w, i, j, k]: &[f32; POSE]) -> Isometry3<f32> {
    // Normalising would change bits; the simulator checks the length.
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}

impl<'w> Walk<'w> {
    /// Reads a file; anything that is not as long as it says is `None`.
    pub fn read(mut rest: &'w [u8]) -> Option<Self> {
        let rest = &mut rest;
        let &[step, frame_rate_hz, links, count, joints] = take::<u32>(rest, 5)? else {
            return None;
        };
        let (links, count, joints) = (links as usize, count as usize, joints as usize);
        let &[ground] = take::<[f32; 2]>(rest, 1)? else { return None };
        let physics = take(rest, links)?;
        let points = take(rest, links.checked_mul(count)?)?;
        let (previous, current) = (take(rest, links)?, take(rest, links)?);
        let pairs = take(rest, joints)?;
        let pivots: &[Point3<f32>] = take(rest, joints.checked_mul(2)?)?;
        let (pivots, _) = pivots.as_chunks();
        // Bytes that are left over mean that the counts are wrong.
        let whole = rest.is_empty() && count > 0 && frame_rate_hz > 0;
        let (previous, current): (&[[f32; POSE]], &[[f32; POSE]]) = (previous, current);
        whole.then_some(Self {
            step,
            frame_rate_hz,
            count,
            ground,
            physics,
            points,
            previous,
            current,
            pairs,
            pivots,
        })
    }

    /// The links, of one body.
    pub fn links(&self) -> impl Iterator<Item = Posed<'w>> + Clone {
        let poses = self.previous.iter().zip(self.current);
        let links = self.physics.iter().zip(self.points.chunks_exact(self.count)).zip(poses);
        links.map(|((physics, points), (previous, current))| {
            let &[mass_kg, friction, restitution] = physics;
            let physics = Physics { mass_kg, friction, restitution };
            Posed {
                // Units of one body do not collide, and links of a robot overlap at their joints.
                unit: Unit::new(points, physics).body(0),
                previous: pose(previous),
                current: pose(current),
            }
        })
    }

    /// Numbers of a link and of that which it hangs from, and the pivot in the frames of both, metres.
    pub fn joints(&self) -> impl Iterator<Item = ([u32; 2], [Point3<f32>; 2])> {
        self.pairs.iter().copied().zip(self.pivots.iter().copied())
    }

    /// What the robot stands on.
    pub fn ground(&self) -> Plane {
        let [friction, restitution] = self.ground;
        Plane::ground(friction, restitution)
    }

    /// Seconds between the frames, and of a step.
    pub fn seconds(&self) -> f32 {
        self.step as f32 / self.frame_rate_hz as f32
    }

    /// Observes the robot and holds its links together.
    pub fn observe(&self, simulator: &mut Simulator<'_, '_>) -> Result<(), &'static str> {
        simulator.set_planes(&[self.ground()]).map_err(|_| "the ground was refused")?;
        let seen = simulator.observe_poses(self.seconds(), self.links());
        seen.map_err(|_| "the observation was refused")?;
        for ([unit, parent], [pivot, parent_pivot]) in self.joints() {
            let name = |number: u32| {
                let found = simulator.unit(number as usize);
                // 0 is no unit's id, so `join` refuses a number that is not there.
                found.map_or(UnitId::from_bits(0), |unit| unit.id())
            };
            let (unit, parent) = (name(unit), name(parent));
            let joint = Joint::ball(unit, parent, pivot, parent_pivot);
            simulator.join(&joint).map_err(|_| "a joint was refused")?;
        }
        Ok(())
    }

    /// What the robot is told before a step, counted from 0.
    pub fn prepare(
        &self,
        simulator: &mut Simulator<'_, '_>,
        step: u32,
    ) -> Result<(), &'static str> {
        let [first, second] = &COMMANDS;
        let command = if step < STEPS / 2 { first } else { second };
        simulator.set_command(command).map_err(|_| "the command was refused")
    }
}
