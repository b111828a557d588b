//! Recorded scenes in flash, read in place.
//!
//! Little-endian: step code, units, points of a unit (u32 each); mass, friction, restitution of each unit;
//! then all points of the previous frame and all of the current one, unit by unit (x, y, z in metres, f32).
//! `bodies.bin` has points once, in each unit's own frame; behind them, of the scenes [`SCENES`], the poses of all units in the previous
//! frame and in the current one (x, y, z in metres, then w, i, j, k).
//! `cargo run -p rigidformer-tests --bin firmware -- contact` writes `contact.bin` of it.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use rigidformer_core::{Observed, Physics, Posed, Unit};
use rigidformer_weights::{Aligned, include_model};

use crate::memory::{CONFIG, UNITS};

/// Ten units on and above each other: all in contact, from the first step to the last.
pub static CONTACT: &Aligned<[u8]> = include_model!("../scenes/contact.bin");
/// The same units as bodies, and their poses in two scenes.
pub static BODIES: &Aligned<[u8]> = include_model!("../scenes/bodies.bin");
/// Those scenes: that of [`CONTACT`], and high above the ground and far apart.
pub const SCENES: [&str; 2] = ["contact", "flight"];
/// Two frames of a robot of 31 links; [`crate::walk`] has the layout.
#[cfg(feature = "walk")]
pub static WALK: &Aligned<[u8]> = include_model!("../scenes/walk.bin");
/// A sheet of cloth over a sphere; [`crate::drape`] has the layout.
#[cfg(feature = "drape")]
pub static DRAPE: &Aligned<[u8]> = include_model!("../scenes/drape.bin");

/// Native frames between two, points of a unit, what units are made of, and what follows in a file of exactly [`UNITS`] units.
fn head(file: &'static Aligned<[u8]>) -> Option<(u32, usize, [Physics; UNITS], &'static [u8])> {
    let (header, rest) = file.split_first_chunk::<12>()?;
    // Read in place: flash is aligned, and RAM has no room for a copy.
    let header: &[u32] = bytemuck::try_cast_slice(header).ok()?;
    let &[step, units, points] = header else { return None };
    // Arrays of the image have this many units; chunks of 0 points would panic.
    if units as usize != UNITS || points == 0 {
        return None;
    }
    let (numbers, rest) = rest.split_at_checked(UNITS * 12)?;
    let numbers: &[[f32; 3]] = bytemuck::try_cast_slice(numbers).ok()?;
    let mut physics = [Physics { mass_kg: 1.0, friction: 0.0, restitution: 0.0 }; UNITS];
    for (to, &[mass_kg, friction, restitution]) in physics.iter_mut().zip(numbers) {
        *to = Physics { mass_kg, friction, restitution };
    }
    Some((step, points as usize, physics, rest))
}

/// Bodies, and where they are in two frames of each of [`SCENES`].
#[derive(Clone, Copy, Debug)]
pub struct Bodies {
    /// Native frames between the two.
    step: u32,
    physics: [Physics; UNITS],
    /// (units, points) in the unit's own frame, metres.
    points: &'static [Point3<f32>],
    /// (scenes, frames, units)
    poses: &'static [[[[f32; 7]; UNITS]; 2]],
}

impl Bodies {
    /// A file of exactly [`UNITS`] units and as many scenes as [`SCENES`] has; anything else is `None`.
    pub fn read(file: &'static Aligned<[u8]>) -> Option<Bodies> {
        let (step, points, physics, rest) = head(file)?;
        let (points, poses) = rest.split_at_checked(points.checked_mul(UNITS * 12)?)?;
        let (points, poses) =
            (bytemuck::try_cast_slice(points).ok()?, bytemuck::try_cast_slice(poses).ok()?);
        (poses.len() == SCENES.len()).then_some(Bodies { step, physics, points, poses })
    }

    /// The units in a scene, by its number, for an observation.
    pub fn units(&self, scene: usize) -> Option<[Posed<'static>; UNITS]> {
        let [previous, current] = self.poses.get(scene)?;
        let mut units = self.points.chunks_exact(self.points.len() / UNITS);
        Some(core::array::from_fn(|unit| Posed {
            unit: Unit::new(units.next().unwrap_or_default(), self.physics[unit]),
            previous: pose(&previous[unit]),
            current: pose(&current[unit]),
        }))
    }

    /// Seconds between the frames.
    pub fn seconds(&self) -> f32 {
        self.step as f32 / CONFIG.frame_rate_hz
    }
}

fn pose(&[x, y, z, w, i, j, k]: &[f32; 7]) -> Isometry3<f32> {
    // Normalising would change bits; the simulator checks the length.
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}

/// Two frames of points.
#[derive(Clone, Copy, Debug)]
pub struct Scene {
    /// Native frames between the two.
    pub step: u32,
    /// What the units are made of.
    pub physics: [Physics; UNITS],
    /// (units, points) world, metres.
    pub previous: [&'static [Point3<f32>]; UNITS],
    /// The same points, `step` frames later.
    pub current: [&'static [Point3<f32>]; UNITS],
}

impl Scene {
    /// A scene of exactly [`UNITS`] units; anything else is `None`.
    pub fn read(file: &'static Aligned<[u8]>) -> Option<Scene> {
        let (step, points, physics, frames) = head(file)?;
        let frames: &[Point3<f32>] = bytemuck::try_cast_slice(frames).ok()?;
        if frames.len() != 2 * UNITS * points {
            return None;
        }
        let mut scene = Scene { step, physics, previous: [&[]; UNITS], current: [&[]; UNITS] };
        let units = scene.previous.iter_mut().chain(&mut scene.current);
        for (to, points) in units.zip(frames.chunks_exact(points)) {
            *to = points;
        }
        Some(scene)
    }

    /// The units, for an observation.
    pub fn units(&self) -> [Observed<'static>; UNITS] {
        core::array::from_fn(|unit| Observed {
            unit: Unit::new(self.previous[unit], self.physics[unit]),
            current: self.current[unit],
        })
    }

    /// Seconds between the frames.
    pub fn seconds(&self) -> f32 {
        self.step as f32 / CONFIG.frame_rate_hz
    }
}
