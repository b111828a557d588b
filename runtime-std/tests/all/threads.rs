//! Kernels on threads: the bits of the portable ones on one thread.

#[path = "../../../kernels/tests/all/checks.rs"]
mod checks;

use std::path::Path;

use half::f16;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::kernels::{Divisible, Rows};
use rigidformer_core::quant::Scratch;
use rigidformer_core::weights::Panels;
use rigidformer_core::{
    Kernels, Limits, Model, NoTrace, Physics, Portable, Posed, Schedule, Serial, Simulator,
    SlabSizes, Slabs, Unit, UnitSlot,
};
use rigidformer_evaluation::models::{Precision, quantise};
use rigidformer_runtime::kernels::{HostKernels, Kernel, Run};
use rigidformer_runtime::threads::{Threaded, Threads};

use checks::*;

/// Set where ThreadSanitizer watches each access to memory, which takes long.
const WATCHED: &str = "RIGIDFORMER_WATCHED";

/// A schedule whose shared operations stand where those of its kernels would: so that the checks of kernels check it.
#[derive(Clone, Copy)]
struct Shared<K>(Threaded<K>);

impl<K: HostKernels> Kernels for Shared<K> {
    const NAME: &'static str = K::NAME;

    fn linear_f32(self, x: &[f32], weight: &[f32], bias: &[f32], inputs: usize, out: &mut [f32]) {
        self.0.linear_f32(x, weight, bias, inputs, out);
    }

    fn linear_f16(self, x: &[f32], weight: &[f16], bias: &[f32], inputs: usize, out: &mut [f32]) {
        self.0.linear_f16(x, weight, bias, inputs, out);
    }

    fn quantise(self, x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
        self.0.quantise(x, inputs, scratch);
    }

    fn linear_i8(
        self,
        scratch: &mut Scratch<'_>,
        weight: Rows<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    ) {
        self.0.kernels().linear_i8(scratch, weight, bias, inputs, out);
    }

    fn linear_panels(
        self,
        scratch: &mut Scratch<'_>,
        weight: Panels<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    ) {
        self.0.linear_panels(scratch, weight, bias, inputs, out);
    }

    fn dot_f32(self, lhs: &[f32], rhs: &[f32]) -> f32 {
        self.0.kernels().dot_f32(lhs, rhs)
    }

    fn silu(self, x: &mut [f32]) {
        self.0.silu(x);
    }
}

/// As they come, and with everything shared out that can be.
fn thread_counts() -> [Threads; 5] {
    let eager = Threads::new(3).eager();
    [Threads::new(1), Threads::new(2), Threads::new(3), eager, Threads::new(2).eager_layers()]
}

/// Runs a check of operations that schedules share out, with all kernels on threads.
macro_rules! with_all_kernels {
    ($name:ident, $check:ident) => {
        #[test]
        fn $name() {
            struct Check;
            impl Run for Check {
                type Output = ();
                fn run<K: HostKernels>(self, kernels: K) {
                    for threads in thread_counts() {
                        $check(Shared(Threaded::new(kernels, threads)));
                    }
                }
            }
            for kernel in Kernel::available() {
                kernel.run(Check).unwrap();
            }
        }
    };
}

with_all_kernels!(int8_products_are_exact, check_int8);
with_all_kernels!(int8_extremes_neither_saturate_nor_overflow, check_int8_extremes);
with_all_kernels!(rows_that_are_odd_are_quantised_alike, check_odd_rows);
with_all_kernels!(wide_products_have_one_order, check_wide);
with_all_kernels!(elements_have_the_same_bits, check_elements);
with_all_kernels!(mismatched_slices_do_not_panic, check_mismatches);

/// Numbers of scratch that a worker needs in [`rows_are_filled_alike_on_any_number_of_threads`].
const OWN: usize = 8;

/// Fills rows by a schedule: each with its index and its length, by way of the scratch.
fn filled<S: Schedule>(
    schedule: S,
    rows: usize,
    width: usize,
    lacking: usize,
    cost: usize,
) -> Vec<f32> {
    let mut matrix = vec![7.0; (rows * width).saturating_sub(lacking)];
    let mut scratch = vec![f32::NAN; S::LAYOUT.tiles.workers * OWN];
    schedule.each_row(&mut matrix, width, cost, &mut scratch, |index, row, scratch| {
        assert!(scratch.len() >= OWN, "{} numbers of scratch", scratch.len());
        scratch[..OWN].fill(index as f32);
        std::thread::yield_now();
        let whose = scratch[..OWN].iter().sum::<f32>();
        let length = row.len() as f32;
        row.iter_mut().enumerate().for_each(|(i, x)| *x = whose * 100.0 + length + i as f32 * 0.01);
    });
    matrix
}

#[test]
fn rows_are_filled_alike_on_any_number_of_threads() {
    let more = [Threads::new(16), Threads::new(16).eager(), Threads::new(5).eager_layers()];
    for threads in thread_counts().into_iter().chain(more) {
        let threaded = Threaded::new(Portable, threads);
        for rows in (0..40).chain([130]) {
            for (width, lacking) in [(0, 0), (1, 0), (5, 0), (5, 3), (16, 15)] {
                for cost in [0, 1, 1 << 20] {
                    let expected = filled(Serial(Portable), rows, width, lacking, cost);
                    let found = filled(threaded, rows, width, lacking, cost);
                    let what = format!("{rows} rows of {width} less {lacking}, {threads:?}");
                    assert_same(&found, &expected, &what);
                }
            }
        }
    }
}

/// Numbers in a row.
#[derive(Clone, Copy)]
struct Stretch {
    first: usize,
    count: usize,
}

impl Divisible for Stretch {
    fn split(self, left: usize, of: usize) -> [Self; 2] {
        let count = self.count * left / of;
        let rest = Stretch { first: self.first + count, count: self.count - count };
        [Stretch { count, ..self }, rest]
    }
}

/// The numbers that a schedule comes by, and how many parts it made.
fn shared<S: Schedule>(schedule: S, work: usize, count: usize) -> (Vec<usize>, usize) {
    let run = |_: S, part: Stretch| ((part.first..part.first + part.count).collect::<Vec<_>>(), 1);
    let merge = |mut a: (Vec<usize>, usize), b: (Vec<usize>, usize)| {
        a.0.extend(b.0);
        (a.0, a.1 + b.1)
    };
    schedule.share(work, Stretch { first: 0, count }, &run, &merge)
}

#[test]
fn parts_are_shared_out_whole_and_merged_in_order() {
    assert!(!Serial(Portable).shares());
    let more = [Threads::new(16), Threads::new(16).eager()];
    for threads in thread_counts().into_iter().chain(more) {
        let threaded = Threaded::new(Portable, threads);
        for count in [0, 1, 2, 3, 7, 16, 17, 100] {
            let all: Vec<usize> = (0..count).collect();
            for work in [0, 1, 2, 1 << 20, 1 << 30] {
                assert_eq!(shared(Serial(Portable), work, count), (all.clone(), 1));
                let (found, parts) = shared(threaded, work, count);
                assert_eq!(found, all, "{threads:?}, work {work}");
                assert!((1..=threads.count()).contains(&parts));
                assert!(work > 0 || parts == 1, "nothing is worth no thread");
                assert!(work < 1 << 30 || parts == threads.count(), "{parts}, {threads:?}");
            }
        }
        assert!(threads.count() > 1 || !threaded.shares());
    }
    assert!(Threaded::new(Portable, Threads::new(2)).shares());
    assert!(!Threaded::new(Portable, Threads::new(2).eager_layers()).shares());
}

/// Rotations and centres after each step of a scene in contact.
struct Roll<'a> {
    model: &'a [u8],
    threads: Option<usize>,
}

impl Run for Roll<'_> {
    type Output = Vec<u32>;

    fn run<K: HostKernels>(self, kernels: K) -> Vec<u32> {
        match self.threads {
            None => roll(self.model, Serial(kernels)),
            Some(n) => roll(self.model, Threaded::new(kernels, Threads::new(n))),
        }
    }
}

fn roll<S: Schedule>(file: &[u8], schedule: S) -> Vec<u32> {
    let model = Model::load(file).unwrap();
    let corners: Vec<Point3<f32>> = (0..40)
        .map(|i| {
            let fill = (i / 8) as f32 * 0.2;
            let side = |bit: usize| if i & bit == 0 { -0.1 } else { 0.1 - 0.02 * fill };
            Point3::new(side(1), side(2), side(4))
        })
        .collect();
    let shapes: Vec<&[Point3<f32>]> = vec![&corners; 5];
    let poses = |t: f32| -> Vec<Isometry3<f32>> {
        (0..5)
            .map(|i| {
                let place =
                    Translation3::new(0.05 * i as f32, 0.02 * i as f32, 0.1 + 0.19 * i as f32 - t);
                Isometry3::from_parts(
                    place,
                    UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, i as f32) * (0.3 + t)),
                )
            })
            .collect()
    };
    let limits = Limits { units: 8, points: 256 };
    let frames = [poses(0.0), poses(0.004)];
    rolled(&model, limits, schedule, 1.0 / 240.0, (&shapes, &frames), 5)
}

/// Points of units, and their poses in two frames.
type Frames<'a> = (&'a [&'a [Point3<f32>]], &'a [Vec<Isometry3<f32>>; 2]);

/// Rotations and centres after each step of a scene.
fn rolled<S: Schedule>(
    model: &Model<'_>,
    limits: Limits,
    schedule: S,
    dt_s: f32,
    (shapes, [previous, current]): Frames<'_>,
    steps: usize,
) -> Vec<u32> {
    let sizes = SlabSizes::of(model.config(), limits, 1, S::LAYOUT);
    let (mut numbers, mut bytes) = (vec![f32::NAN; sizes.f32], vec![-1; sizes.i8]);
    let mut points = vec![Point3::origin(); sizes.points];
    let mut units = vec![UnitSlot::EMPTY; sizes.units];
    let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points, units: &mut units };
    let mut simulator = Simulator::with_layout(model, limits, 1, S::LAYOUT, slabs).unwrap();
    let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
    let seen = shapes.iter().zip(previous.iter().zip(current)).map(|(points, poses)| {
        let (previous, current) = (*poses.0, *poses.1);
        Posed { unit: Unit::new(points, physics), previous, current }
    });
    simulator.observe_poses(dt_s, seen).unwrap();
    let mut bits = Vec::new();
    for _ in 0..steps {
        simulator.step_on(schedule, &mut NoTrace).unwrap();
        for pose in simulator.units().map(|unit| unit.internal_pose()) {
            bits.extend(pose.rotation.iter().chain(pose.centre.iter()).map(|x| x.to_bits()));
        }
    }
    bits
}

/// Scenes whose units begin anywhere in a tile of points, or are more than a part of the scratch has rows for.
struct Crowd<'a> {
    model: &'a [u8],
    counts: &'a [usize],
    threads: Option<Threads>,
}

impl Run for Crowd<'_> {
    type Output = Vec<u32>;

    fn run<K: HostKernels>(self, kernels: K) -> Vec<u32> {
        match self.threads {
            None => crowd(self.model, self.counts, Serial(kernels)),
            Some(threads) => crowd(self.model, self.counts, Threaded::new(kernels, threads)),
        }
    }
}

fn crowd<S: Schedule>(file: &[u8], counts: &[usize], schedule: S) -> Vec<u32> {
    let model = Model::load(file).unwrap();
    let shapes: Vec<Vec<Point3<f32>>> = counts
        .iter()
        .map(|count| {
            let turn = |i: usize| (i as f32 * 2.4, 0.1 * (i as f32 / *count as f32 - 0.5));
            let point =
                |(angle, z): (f32, f32)| Point3::new(0.1 * angle.cos(), 0.1 * angle.sin(), z);
            (0..*count).map(|i| point(turn(i))).collect()
        })
        .collect();
    let poses = |t: f32| -> Vec<Isometry3<f32>> {
        let place = |i: usize| {
            let (row, column) = (i / 10, i % 10);
            Translation3::new(
                0.17 * column as f32,
                0.18 * row as f32,
                0.06 + 0.01 * (i % 3) as f32 - t,
            )
        };
        let turn =
            |i: usize| UnitQuaternion::from_scaled_axis(Vector3::new(0.1, t, 0.3 * i as f32));
        (0..counts.len()).map(|i| Isometry3::from_parts(place(i), turn(i))).collect()
    };
    let limits = Limits { units: counts.len(), points: counts.iter().sum() };
    let shapes: Vec<&[Point3<f32>]> = shapes.iter().map(Vec::as_slice).collect();
    let frames = [poses(0.0), poses(0.01)];
    rolled(&model, limits, schedule, 5.0 / 240.0, (&shapes, &frames), 2)
}

#[test]
fn tiles_and_parts_may_end_anywhere() {
    let edge = quantise(Path::new("edge"), rigidformer_weights::EDGE, &Precision::I8.into());
    let edge = rigidformer_weights::AlignedBuffer::copy_of(&edge.unwrap().file);
    let odd: Vec<usize> = (0..24).map(|i| [51, 50, 33, 5, 64, 41, 47][i % 7]).collect();
    let many = vec![5; 300];
    let is_watched = std::env::var_os(WATCHED).is_some();
    for counts in [&odd, &many] {
        let threads =
            [None].into_iter().chain([2, 3, 5, 12, 16].map(|n| Some(Threads::new(n).eager())));
        let expected = Kernel::Portable.run(Crowd { model: &edge, counts, threads: None }).unwrap();
        let kernels = Kernel::available().into_iter().filter(|kernel| *kernel != Kernel::Portable);
        let kernels: Vec<_> = kernels.collect();
        for (number, &kernel) in kernels.iter().enumerate() {
            // Threads meet at the same borders whatever computes: watched, each number of them runs with one kernel.
            let (skip, step) = if is_watched { (number, kernels.len()) } else { (0, 1) };
            for threads in threads.clone().skip(skip).step_by(step) {
                let found = kernel.run(Crowd { model: &edge, counts, threads }).unwrap();
                assert!(found == expected, "{kernel}, {} units, {threads:?}", counts.len());
            }
        }
    }
}

#[test]
fn models_predict_the_same_bits() {
    for precision in [Precision::F32, Precision::F16, Precision::I8] {
        let edge = quantise(Path::new("edge"), rigidformer_weights::EDGE, &precision.into());
        let edge = rigidformer_weights::AlignedBuffer::copy_of(&edge.unwrap().file);
        let expected = Kernel::Portable.run(Roll { model: &edge, threads: None }).unwrap();
        for kernel in Kernel::available() {
            for threads in [None, Some(1), Some(2), Some(3)] {
                let found = kernel.run(Roll { model: &edge, threads }).unwrap();
                assert!(found == expected, "{kernel}, {precision:?}, threads {threads:?}");
            }
        }
    }
    let layout = <Threaded<Portable> as Schedule>::LAYOUT;
    assert!(layout.index && layout.tiles.workers >= 16, "a worker's scratch for each thread");
    assert_eq!(layout.queries, Portable::QUERIES);
}
