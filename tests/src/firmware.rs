//! Scenes for microcontrollers, and the rollouts that their images must equal bit for bit.

use crate::bits::Fnv1a;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{Limits, Model, Physics, Portable, Simulator, SlabSizes, Slabs};
use std::fmt::Write;

/// Units of a scene.
pub const UNITS: usize = 10;
/// Points of a unit.
pub const POINTS: usize = 64;
/// Native frames between the two observed frames.
const STEP: u32 = 5;

/// Two frames of points. The layout of a file is in `firmware-sim/firmware/src/scene.rs`.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoFrames {
    /// Native frames between them.
    pub step: u32,
    /// (units)
    pub physics: Vec<Physics>,
    /// (units, points) world, metres.
    pub previous: Vec<Vec<Point3<f32>>>,
    /// (units, points) world, metres.
    pub current: Vec<Vec<Point3<f32>>>,
}

impl TwoFrames {
    /// The file's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let counts = [self.step, self.physics.len() as u32, POINTS as u32];
        let physics = self.physics.iter().flat_map(|p| [p.mass_kg, p.friction, p.restitution]);
        let points = self.previous.iter().chain(&self.current).flatten();
        let numbers = physics.chain(points.flat_map(|p| [p.x, p.y, p.z]));
        let words = counts.into_iter().chain(numbers.map(f32::to_bits));
        words.flat_map(u32::to_le_bytes).collect()
    }

    /// From a file's bytes.
    pub fn from_bytes(bytes: &[u8]) -> Self {
        let words: Vec<u32> = bytes
            .chunks_exact(4)
            .map(|word| u32::from_le_bytes(word.try_into().expect("four bytes")))
            .collect();
        let (counts, rest) = words.split_at(3);
        let numbers: Vec<f32> = rest.iter().copied().map(f32::from_bits).collect();
        let (physics, frames) = numbers.split_at(3 * counts[1] as usize);
        let points: Vec<Point3<f32>> =
            frames.chunks_exact(3).map(|p| Point3::new(p[0], p[1], p[2])).collect();
        let mut units = points.chunks_exact(counts[2] as usize).map(<[_]>::to_vec);
        let previous = units.by_ref().take(counts[1] as usize).collect();
        TwoFrames {
            step: counts[0],
            physics: physics
                .chunks_exact(3)
                .map(|p| Physics { mass_kg: p[0], friction: p[1], restitution: p[2] })
                .collect(),
            previous,
            current: units.collect(),
        }
    }

    /// `contact`: two layers of five, that lie on the ground and on each other and slide.
    /// `flight`: the same units, 40 m apart and 300 m up, spinning.
    pub fn generate(name: &str) -> Self {
        let flight = name == "flight";
        let dt = STEP as f32 / 240.0;
        let mut scene =
            TwoFrames { step: STEP, physics: vec![], previous: vec![], current: vec![] };
        for unit in 0..UNITS {
            let points = if unit % 2 == 0 { cube() } else { sphere() };
            let (column, layer) = ((unit % 5) as f32, (unit / 5) as f32);
            let side = if unit % 5 < 3 { 0.0 } else { 0.39 };
            let mut at =
                Vector3::new(0.395 * (column % 3.0) + 0.5 * side, side, 0.199 + 0.397 * layer);
            let mut velocity = Vector3::new(0.2 - 0.1 * column, 0.15 - 0.3 * side, -0.05 * layer);
            let mut spin = Vector3::new(0.1, -0.05, 0.3) * (column - 2.0);
            if flight {
                at = Vector3::new(40.0 * column, 40.0 * layer, 300.0);
                velocity *= 4.0;
                spin *= 5.0;
            }
            let pose = |turn: Vector3<f32>, at: Vector3<f32>| {
                let turn = UnitQuaternion::from_scaled_axis(turn);
                Isometry3::from_parts(Translation3::from(at), turn)
            };
            let turn = Vector3::new(0.0, 0.0, 0.3 * column);
            let frame = |pose: Isometry3<f32>| points.iter().map(|p| pose * p).collect();
            scene.previous.push(frame(pose(turn, at)));
            scene.current.push(frame(pose(turn + spin * dt, at + velocity * dt)));
            scene.physics.push(Physics {
                mass_kg: 1.0 + 0.25 * column,
                friction: 0.3 + 0.1 * layer,
                restitution: 0.5,
            });
        }
        scene
    }
}

/// 64 points on the surface of a cube with edges of 0.4 m: 56 of a grid of four, and 8 inside the faces.
fn cube() -> Vec<Point3<f32>> {
    let at = |i: usize| 0.4 * (i as f32 / 3.0 - 0.5);
    let on_surface = |[x, y, z]: &[usize; 3]| [x, y, z].into_iter().any(|i| *i == 0 || *i == 3);
    let grid = (0..64).map(|i| [i / 16, i / 4 % 4, i % 4]).filter(on_surface);
    let mut points: Vec<_> = grid.map(|[x, y, z]| Point3::new(at(x), at(y), at(z))).collect();
    for i in 0..8 {
        let (x, y) = (0.03 * i as f32 - 0.1, 0.02 * i as f32 - 0.07);
        points.push(if i % 2 == 0 { Point3::new(x, y, 0.2) } else { Point3::new(x, y, -0.2) });
    }
    points
}

/// 64 points on a sphere with a radius of 0.2 m, along a spiral.
fn sphere() -> Vec<Point3<f32>> {
    (0..POINTS)
        .map(|i| {
            let z = (i as f32 + 0.5) / POINTS as f32 * 2.0 - 1.0;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - z * z).sqrt();
            Point3::new(r * cos, r * sin, z) * 0.2
        })
        .collect()
}

/// What an image must print about a rollout of `steps` steps: lines of poses as bits, then a hash over all
/// steps. `name` is that of the scene.
pub fn rollout(file: &[u8], name: &str, scene: &TwoFrames, steps: usize) -> String {
    let model = Model::load(file).expect("model loads");
    let limits = Limits { units: UNITS, points: UNITS * POINTS };
    let sizes = SlabSizes::new(model.config(), limits);
    let (mut numbers, mut bytes) = (vec![f32::NAN; sizes.f32], vec![-1; sizes.i8]);
    let mut points = vec![Point3::origin(); sizes.points];
    let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points };
    let mut simulator =
        Simulator::<UNITS, Portable>::new(&model, limits, slabs).expect("simulator");
    let [previous, current] = [&scene.previous, &scene.current]
        .map(|frame| frame.iter().map(Vec::as_slice).collect::<Vec<_>>());
    simulator.observe(scene.step, &scene.physics, &previous, &current).expect("observation");
    let mut hash = Fnv1a::default();
    let mut active = 0;
    let pose = |simulator: &Simulator<'_, '_, UNITS, Portable>, unit| -> Vec<f32> {
        let pose = simulator.internal_pose(unit).expect("a unit");
        // `transpose` because nalgebra keeps columns together.
        pose.rotation.transpose().iter().chain(&pose.centre).copied().collect()
    };
    for _ in 0..steps {
        active += simulator.step().expect("step").active_units;
        (0..UNITS).for_each(|unit| pose(&simulator, unit).into_iter().for_each(|v| hash.add(v)));
    }
    let mut text = String::new();
    for unit in 0..UNITS {
        let bits: Vec<_> =
            pose(&simulator, unit).iter().map(|v| format!("{:08x}", v.to_bits())).collect();
        let _ = writeln!(text, "{name}: unit {unit} [{}]", bits.join(", "));
    }
    let _ = writeln!(text, "{name}: {steps} steps, active {active}, poses {:016x}", hash.0);
    text
}

/// What the const functions say about the workspace: a line of lengths and bytes.
pub fn workspace(file: &[u8]) -> String {
    let model = Model::load(file).expect("model loads");
    let limits = Limits { units: UNITS, points: UNITS * POINTS };
    let sizes = SlabSizes::new(model.config(), limits);
    let SlabSizes { f32, i8, points } = sizes;
    format!("workspace f32 {} i8 {i8} points {} bytes {}", 4 * f32, 12 * points, sizes.bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_survive_their_files() {
        for name in ["contact", "flight"] {
            let scene = TwoFrames::generate(name);
            assert_eq!(TwoFrames::from_bytes(&scene.to_bytes()), scene);
            assert!(scene.previous.iter().chain(&scene.current).all(|unit| unit.len() == POINTS));
        }
    }
}
