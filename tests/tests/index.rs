//! Kernels that search an index for the nearest point roll out the bits of those that try all
//! points.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use half::f16;
use nalgebra::{Isometry3, Point3, Translation3};
use rigidformer_core::kernels::Rows;
use rigidformer_core::quant::Scratch;
use rigidformer_core::weights::Panels;
use rigidformer_core::{
    Kernels, Limits, Model, NoTrace, Physics, Portable, Rigid, Simulator, SlabSizes, Slabs, Tiles,
};
use rigidformer_tests::bits::models;
use rigidformer_tests::{Golden, Inputs, Random, packed_model};

/// [`Portable`] with an index, and other tiles.
#[derive(Clone, Copy, Default)]
struct Indexed;

impl Kernels for Indexed {
    const NAME: &'static str = "indexed";
    const TILES: Tiles = Tiles { points: 100, ..Tiles::SMALL };
    const INDEX: bool = true;

    fn linear_f32(self, x: &[f32], weight: &[f32], bias: &[f32], inputs: usize, out: &mut [f32]) {
        Portable.linear_f32(x, weight, bias, inputs, out);
    }

    fn linear_f16(self, x: &[f32], weight: &[f16], bias: &[f32], inputs: usize, out: &mut [f32]) {
        Portable.linear_f16(x, weight, bias, inputs, out);
    }

    fn quantise(self, x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
        Portable.quantise(x, inputs, scratch);
    }

    fn linear_i8(
        self,
        scratch: &mut Scratch<'_>,
        weight: Rows<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    ) {
        Portable.linear_i8(scratch, weight, bias, inputs, out);
    }

    fn linear_panels(
        self,
        scratch: &mut Scratch<'_>,
        weight: Panels<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    ) {
        Portable.linear_panels(scratch, weight, bias, inputs, out);
    }

    fn dot_f32(self, lhs: &[f32], rhs: &[f32]) -> f32 {
        Portable.dot_f32(lhs, rhs)
    }
}

/// Bits of every pose of every copy after every step. Each copy but the first is moved aside, and
/// other copies are dropped on the way.
fn poses<K: Kernels + Default>(
    file: &[u8],
    (step, steps): (u32, usize),
    (inputs, command): (&Inputs, Option<&[f32]>),
    copies: usize,
) -> Vec<u32> {
    let model = Model::load(file).unwrap();
    let points = inputs.points.iter().map(Vec::len).sum::<usize>() + 7;
    let limits = Limits { units: inputs.points.len() + 1, points };
    let sizes = SlabSizes::of::<K>(model.config(), limits, copies);
    let (mut numbers, mut bytes) = (vec![f32::NAN; sizes.f32], vec![-1; sizes.i8]);
    let mut slab = vec![Point3::origin(); sizes.points];
    let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut slab };
    let mut simulator =
        Simulator::<64, K, Rigid>::with_kernels(K::default(), &model, limits, copies, slabs)
            .unwrap();
    if let Some(command) = command {
        simulator.set_command(command).unwrap();
    }
    let mut bits = Vec::new();
    // Twice: an index that was there before is built anew.
    for _ in 0..2 {
        simulator.observe_poses(step, &inputs.units(), &inputs.previous, &inputs.current).unwrap();
        assert_eq!(simulator.replicate(copies), copies);
        let mut random = Random(7);
        for copy in 1..copies {
            for unit in 0..simulator.len() {
                let by = Translation3::from(random.vector() * 0.05);
                let (before, now) = (by * inputs.previous[unit], by * inputs.current[unit]);
                assert!(simulator.set_poses(copy, unit, &before, &now).unwrap());
            }
        }
        for step in 0..steps {
            let mut failed = Vec::new();
            simulator
                .step_copies(&mut NoTrace, |copy, report| {
                    bits.push(report.map_or(u32::MAX, |report| report.active_units));
                    failed.push(copy == 1 && step == steps / 2);
                })
                .unwrap();
            simulator.retain_copies(|copy| !failed[copy]);
            for unit in 0..simulator.len() * simulator.copies() {
                let pose = simulator.internal_pose(unit).unwrap();
                bits.extend(pose.rotation.iter().chain(&pose.centre).map(|v| v.to_bits()));
            }
        }
    }
    bits
}

#[test]
fn rollouts_of_the_golden_scenes_are_equal() {
    for (name, file) in models() {
        let (scene, storage) = name.rsplit_once('-').unwrap();
        let golden = Golden::read(scene);
        let (inputs, command) = (golden.inputs(), golden.command());
        // The storage of weights is nothing to the search.
        let (steps, copies) = match (scene, storage) {
            ("edge", "i8") => (12, 1),
            ("edge", _) => continue,
            _ => (40, 3),
        };
        let input = (&inputs, command.as_deref());
        let all = poses::<Portable>(&file, (golden.step, steps), input, copies);
        let indexed = poses::<Indexed>(&file, (golden.step, steps), input, copies);
        assert!(all.len() > 1000 && all == indexed, "{name}");
    }
}

/// Units of 4 to 1,200 points that fall on each other, some of them in the same place.
#[test]
fn rollouts_of_large_and_small_units_are_equal() {
    let file = packed_model("tiny-paper-inputs");
    let mut random = Random(3);
    for sizes in [&[4, 16, 17, 1200, 300, 64, 64, 8][..], &[8; 40], &[257, 4, 4]] {
        let points: Vec<Vec<_>> = sizes
            .iter()
            .map(|size| (0..*size).map(|_| Point3::from(random.vector() * 0.2)).collect())
            .collect();
        let current: Vec<Isometry3<f32>> = sizes
            .iter()
            .enumerate()
            .map(|(i, _)| {
                let v = random.vector() * if i % 5 == 4 { 0.0 } else { 0.5 };
                let at = Translation3::new(v.x, v.y, v.z + 0.5);
                Isometry3::from_parts(at, random.rotation())
            })
            .collect();
        let physics = Physics { mass_kg: 0.5, friction: 0.8, restitution: 0.7 };
        let physics = vec![physics; sizes.len()];
        let inputs = Inputs { points, physics, previous: current.clone(), current };
        let all = poses::<Portable>(&file, (10, 12), (&inputs, None), 1);
        assert!(all == poses::<Indexed>(&file, (10, 12), (&inputs, None), 1), "{sizes:?}");
    }
}

/// The index lies in the caller's slab.
#[test]
fn nothing_is_allocated() {
    let file = packed_model("tiny-paper-inputs");
    let inputs = Golden::read("tiny-paper-inputs").inputs();
    let model = Model::load(&file).unwrap();
    let points = inputs.points.iter().map(Vec::len).sum();
    let limits = Limits { units: 16, points };
    let sizes = SlabSizes::of::<Indexed>(model.config(), limits, 1);
    assert!(sizes.f32 > SlabSizes::of::<Portable>(model.config(), limits, 1).f32);
    let (mut numbers, mut bytes) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
    let mut slab = vec![Point3::origin(); sizes.points];
    let units = inputs.units();
    let counted = allocation_counter::measure(|| {
        let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut slab };
        let mut simulator = Simulator::<16, Indexed>::new(&model, limits, slabs).unwrap();
        simulator.observe_poses(10, &units, &inputs.previous, &inputs.current).unwrap();
        simulator.step().unwrap();
    });
    assert_eq!(counted.count_total, 0);
}
