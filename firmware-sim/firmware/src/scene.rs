//! Recorded scenes in flash, read in place.
//!
//! Little-endian: step code, units, points of a unit (u32 each); mass, friction, restitution of each unit;
//! then all points of the previous frame and all of the current one, unit by unit (x, y, z in metres, f32).
//! `cargo run -p rigidformer-tests --bin firmware -- scenes` writes them.

use nalgebra::Point3;
use rigidformer_core::{Observed, Physics, Unit};
use rigidformer_weights::{Aligned, include_model};

use crate::memory::{CONFIG, UNITS};

/// Ten units on and above each other: all in contact, from the first step to the last.
pub static CONTACT: &Aligned<[u8]> = include_model!("../scenes/contact.bin");
/// The same units high above the ground and far apart.
pub static FLIGHT: &Aligned<[u8]> = include_model!("../scenes/flight.bin");
/// Two frames of a robot of 31 links; [`crate::walk`] has the layout.
#[cfg(feature = "walk")]
pub static WALK: &Aligned<[u8]> = include_model!("../scenes/walk.bin");
/// A sheet of cloth over a sphere; [`crate::drape`] has the layout.
#[cfg(feature = "drape")]
pub static DRAPE: &Aligned<[u8]> = include_model!("../scenes/drape.bin");

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
        let (header, rest) = file.split_first_chunk::<12>()?;
        // Read in place: flash is aligned, and RAM has no room for a copy.
        let header: &[u32] = bytemuck::try_cast_slice(header).ok()?;
        let &[step, units, points] = header else { return None };
        let points = points as usize;
        // Arrays of the image have this many units; chunks of 0 points would panic.
        if units as usize != UNITS || points == 0 {
            return None;
        }
        let (physics, frames) = rest.split_at_checked(UNITS * 12)?;
        let physics: &[[f32; 3]] = bytemuck::try_cast_slice(physics).ok()?;
        let frames: &[Point3<f32>] = bytemuck::try_cast_slice(frames).ok()?;
        if frames.len() != 2 * UNITS * points {
            return None;
        }
        let mut scene = Scene {
            step,
            physics: [Physics { mass_kg: 1.0, friction: 0.0, restitution: 0.0 }; UNITS],
            previous: [&[]; UNITS],
            current: [&[]; UNITS],
        };
        for (to, &[mass_kg, friction, restitution]) in scene.physics.iter_mut().zip(physics) {
            *to = Physics { mass_kg, friction, restitution };
        }
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
