//! A sheet of cloth that falls on a sphere: what the image `drape` does. This machine compiles this file too, for
//! `tests/src/firmware.rs`, so that both take the same steps.
//!
//! `scenes/drape.bin`, little-endian: step code, frames a second, patches, points of a patch, points of the sphere (u32 each);
//! Young's modulus (Pa); friction and restitution of the ground; mass, friction, restitution of each patch, then of the sphere;
//! the patches' points at rest, all in one frame; where they are, in the world, a step ago and now: the sheet was held still. Last
//! the sphere's points, in the world. Points are x, y, z in metres, numbers f32.

use bytemuck::{Pod, try_cast_slice};
use nalgebra::Point3;
use rigidformer_core::{Observed, Physics, Plane, Role, Simulator, Unit};

/// Steps that it takes.
pub const STEPS: u32 = 12;
/// The body that the patches are of.
const SHEET: u16 = 0;
/// Points that a patch may have.
// `each_number` puts a patch's points into an array of this length: there is no allocator.
const MOST: usize = 64;

/// A sheet that was held still, in place.
#[derive(Clone, Copy, Debug)]
pub struct Drape<'d> {
    step: u32,
    frame_rate_hz: u32,
    /// Points of a patch.
    count: usize,
    young_pa: f32,
    ground: [f32; 2],
    /// Of the patches, then of the sphere.
    physics: &'d [[f32; 3]],
    /// (patches, points)
    rest: &'d [Point3<f32>],
    /// (patches, points)
    points: &'d [Point3<f32>],
    sphere: &'d [Point3<f32>],
}

/// The next so many of a file.
fn take<'d, T: Pod>(rest: &mut &'d [u8], count: usize) -> Option<&'d [T]> {
    // Counts come from the file, so products may overflow.
    let (taken, after) = rest.split_at_checked(count.checked_mul(size_of::<T>())?)?;
    *rest = after;
    try_cast_slice(taken).ok()
}

impl<'d> Drape<'d> {
    /// Reads a file; anything that is not as long as it says is `None`.
    pub fn read(mut rest: &'d [u8]) -> Option<Self> {
        let file = &mut rest;
        let &[step, frame_rate_hz, patches, count, of_sphere] = take::<u32>(file, 5)? else {
            return None;
        };
        let (patches, count) = (patches as usize, count as usize);
        let &[young_pa, friction, restitution] = take::<f32>(file, 3)? else { return None };
        let physics = take(file, patches.checked_add(1)?)?;
        let points = patches.checked_mul(count)?;
        let (rest, points) = (take(file, points)?, take(file, points)?);
        let sphere = take(file, of_sphere as usize)?;
        // Bytes that are left over mean that the counts are wrong.
        let whole = file.is_empty() && (1..=MOST).contains(&count) && frame_rate_hz > 0;
        let ground = [friction, restitution];
        whole.then_some(Self {
            step,
            frame_rate_hz,
            count,
            young_pa,
            ground,
            physics,
            rest,
            points,
            sphere,
        })
    }

    /// The patches of the sheet, then the sphere.
    pub fn units(&self) -> impl Iterator<Item = Observed<'d>> + Clone {
        let Self { young_pa, count, sphere, .. } = *self;
        let mut physics = self.physics.iter().map(|&[mass_kg, friction, restitution]| Physics {
            mass_kg,
            friction,
            restitution,
        });
        // The file has the sphere's physics last.
        let of_sphere = physics.next_back();
        let patches = self.rest.chunks_exact(count).zip(self.points.chunks_exact(count));
        let patches = patches.zip(physics).map(move |((rest, points), physics)| Observed {
            unit: Unit::new(points, physics).body(SHEET).soft(rest, young_pa),
            current: points,
        });
        let sphere = of_sphere.into_iter().map(move |physics| Observed {
            unit: Unit::new(sphere, physics).role(Role::Fixed),
            current: sphere,
        });
        patches.chain(sphere)
    }

    /// What the sphere stands on.
    pub fn ground(&self) -> Plane {
        let [friction, restitution] = self.ground;
        Plane::ground(friction, restitution)
    }

    /// Seconds of a step.
    pub fn seconds(&self) -> f32 {
        self.step as f32 / self.frame_rate_hz as f32
    }

    /// Observes the sheet over the sphere.
    pub fn observe(&self, simulator: &mut Simulator<'_, '_>) -> Result<(), &'static str> {
        simulator.set_planes(&[self.ground()]).map_err(|_| "the ground was refused")?;
        let seen = simulator.observe(self.seconds(), self.units());
        seen.map(|_| ()).map_err(|_| "the observation was refused")
    }
}

/// Shows where the points of the sheet are, number by number, in the order in which they were given.
pub fn each_number(simulator: &Simulator<'_, '_>, mut see: impl FnMut(f32)) {
    for unit in simulator.units().filter(|unit| unit.is_soft()) {
        // Points come in the simulator's order, and the hash is over the order in which they were
        // given.
        let mut points = [Point3::origin(); MOST];
        for (number, point) in unit.soft_points() {
            if let Some(slot) = points.get_mut(number) {
                *slot = point;
            }
        }
        let points = points.iter().take(unit.point_count());
        points.flat_map(|point| [point.x, point.y, point.z]).for_each(&mut see);
    }
}

/// Observations that cannot be: the sheet with one of its patches as the last argument says.
pub fn wrong<'d>(
    drape: &Drape<'d>,
    change: impl Fn(&mut Observed<'d>) + Clone,
) -> impl Iterator<Item = Observed<'d>> + Clone {
    drape.units().enumerate().map(move |(number, mut seen)| {
        // A patch in the middle: errors must name it, and not the first.
        if number == 3 {
            change(&mut seen);
        }
        seen
    })
}
