//! Kernels of this processor: each equals the portable ones bit by bit, alone and on threads, at sizes that straddle every
//! tile.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use half::f16;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::kernels::{Divisible, Rows};
use rigidformer_core::quant::{self, Scratch, scratch_bytes};
use rigidformer_core::weights::Panels;
use rigidformer_core::{
    ANCHORS, Kernels, Limits, Model, NoTrace, Physics, Portable, Posed, Schedule, Serial,
    Simulator, SlabSizes, Slabs, Unit, UnitSlot,
};
use rigidformer_runtime::kernels::{
    Columns, HostKernels, Kernel, KernelError, Quantised, Run, Threaded, Threads, VARIABLE, panels,
};
use rigidformer_runtime::models::{Precision, quantise};

const ROWS: [usize; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 16, 31, 32, 33, 64, 65];
const INPUTS: [usize; 20] =
    [1, 2, 3, 4, 5, 6, 7, 8, 9, 15, 16, 17, 31, 32, 33, 63, 64, 65, 130, 768];
const OUTPUTS: [usize; 10] = [1, 3, 15, 16, 17, 33, 63, 64, 65, 130];

/// Set where an emulator plays the processor: products of f32 and f16, which take it longest, leave out most large sizes.
const EMULATED: &str = "RIGIDFORMER_EMULATED";

/// Numbers between -1 and 1.
fn series(n: usize, seed: usize) -> Vec<f32> {
    let mut state = seed as u32;
    let next = |_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..n).map(next).collect()
}

/// Numbers from -127 to 127.
fn bytes(n: usize, seed: usize) -> Vec<i8> {
    series(n, seed).into_iter().map(|x| (x * 127.4) as i8).collect()
}

/// Bits, but for what a NaN is made of.
fn bits(x: f32) -> u32 {
    if x.is_nan() { u32::MAX } else { x.to_bits() }
}

#[track_caller]
fn assert_same(found: &[f32], expected: &[f32], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert_eq!(bits(*found), bits(*expected), "{what}: {found} for {expected} at {i}");
    }
}

/// The same, but for the sign of a zero.
#[track_caller]
fn assert_equal(found: &[f32], expected: &[f32], what: &str) {
    let plus_zero = |x: &[f32]| x.iter().map(|x| x + 0.0).collect::<Vec<_>>();
    assert_same(&plus_zero(found), &plus_zero(expected), what);
}

/// The numbers at an address that no register is aligned at.
fn odd(numbers: &[f32]) -> Vec<f32> {
    std::iter::once(0.0).chain(numbers.iter().copied()).collect()
}

/// Quantised rows of kernels.
struct Room {
    values: Vec<i8>,
    scales: Vec<f32>,
}

impl Room {
    fn new<K: Kernels>(kernels: K, x: &[f32], inputs: usize) -> Self {
        let rows = x.len() / inputs.max(1);
        let mut room =
            Room { values: vec![-1; scratch_bytes(inputs, rows)], scales: vec![-1.0; rows] };
        kernels.quantise(x, inputs, &mut room.scratch());
        room
    }

    fn scratch(&mut self) -> Scratch<'_> {
        Scratch { values: &mut self.values, scales: &mut self.scales }
    }
}

/// An int8 layer.
struct Layer {
    rows: Vec<i8>,
    values: Vec<i8>,
    sums: Vec<i32>,
    scales: Vec<f32>,
    bias: Vec<f32>,
}

impl Layer {
    fn new(rows: Vec<i8>, outputs: usize, inputs: usize, bias: Vec<f32>) -> Self {
        let (values, sums) = panels(&rows, outputs, inputs);
        let scales = series(outputs, 5).iter().map(|x| x.abs() / 100.0 + 1e-3).collect();
        Layer { rows, values, sums, scales, bias }
    }

    fn panels(&self) -> Panels<'_> {
        Panels { values: &self.values, scales: &self.scales, sums: &self.sums }
    }

    fn rows(&self) -> Rows<'_> {
        Rows { values: &self.rows, scales: &self.scales }
    }

    /// Compares both layouts for these rows.
    fn check<K: Kernels>(&self, kernels: K, x: &[f32], inputs: usize, what: &str) {
        let (rows, outputs) = (x.len() / inputs, self.scales.len());
        let mut expected = vec![7.0; rows * outputs];
        let mut theirs = Room::new(Portable, x, inputs);
        Portable.linear_i8(&mut theirs.scratch(), self.rows(), &self.bias, inputs, &mut expected);
        let mut ours = Room::new(kernels, x, inputs);
        assert_same(&ours.scales, &theirs.scales, &format!("scales of {what}"));

        let mut out = vec![7.0; rows * outputs + 1];
        kernels.linear_i8(&mut ours.scratch(), self.rows(), &self.bias, inputs, &mut out[1..]);
        assert_same(&out[1..], &expected, &format!("rows of {what}"));
        out.fill(7.0);
        let weight = self.panels();
        kernels.linear_panels(&mut ours.scratch(), weight, &self.bias, inputs, &mut out[1..]);
        assert_same(&out[1..], &expected, &format!("panels of {what}"));
    }

    /// Compares some of the channels, written among others'.
    fn check_columns<K: HostKernels>(&self, kernels: K, x: &[f32], inputs: usize, what: &str) {
        let (rows, outputs) = (x.len() / inputs, self.scales.len());
        let mut expected = vec![7.0; rows * outputs];
        let mut theirs = Room::new(Portable, x, inputs);
        Portable.linear_i8(&mut theirs.scratch(), self.rows(), &self.bias, inputs, &mut expected);
        let ours = Room::new(kernels, x, inputs);
        let (values, scales) = (&ours.values[..], &ours.scales[..]);
        assert!(kernels.row_bytes(inputs) * rows <= values.len());
        for from in [0, 16, 48] {
            if from >= outputs {
                continue;
            }
            let mut out = vec![7.0; rows * outputs];
            let (_, columns) = Columns::new(&mut out, outputs).split_at(from);
            let weight = Panels {
                values: &self.values[from * inputs.next_multiple_of(4)..],
                scales: &self.scales[from..],
                sums: &self.sums[from..],
            };
            let bias = self.bias.get(from..).unwrap_or_default();
            kernels.multiply(Quantised { values, scales, inputs }, weight, bias, columns);
            for (out, expected) in out.chunks(outputs).zip(expected.chunks(outputs)) {
                assert_same(&out[..from], &vec![7.0; from], "columns of others");
                assert_same(&out[from..], &expected[from..], &format!("columns of {what}"));
            }
        }
    }
}

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

/// Runs a check with kernels, then, where it is of operations that schedules share out, with threads.
macro_rules! with_all_kernels {
    ($name:ident, $check:ident $(, $threads:ident)?) => {
        #[test]
        fn $name() {
            struct Check;
            impl Run for Check {
                type Output = ();
                fn run<K: HostKernels>(self, kernels: K) {
                    $check(kernels);
                    $(for $threads in thread_counts() {
                        $check(Shared(Threaded::new(kernels, $threads)));
                    })?
                }
            }
            for kernel in Kernel::available() {
                kernel.run(Check).unwrap();
            }
        }
    };
}

with_all_kernels!(int8_products_are_exact, check_int8, threads);
with_all_kernels!(int8_extremes_neither_saturate_nor_overflow, check_int8_extremes, threads);
with_all_kernels!(rows_that_are_odd_are_quantised_alike, check_odd_rows, threads);
with_all_kernels!(wide_products_have_one_order, check_wide, threads);
with_all_kernels!(sums_have_one_order, check_sums);
with_all_kernels!(elements_have_the_same_bits, check_elements, threads);
with_all_kernels!(softmax_is_the_same, check_softmax);
with_all_kernels!(pools_are_the_same, check_pools);
with_all_kernels!(mismatched_slices_do_not_panic, check_mismatches, threads);

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

fn check_int8<K: Kernels>(kernels: K) {
    for inputs in INPUTS {
        for outputs in OUTPUTS {
            let bias = if outputs % 2 == 0 { series(outputs, 3) } else { Vec::new() };
            let layer = Layer::new(bytes(outputs * inputs, 2), outputs, inputs, bias);
            for rows in ROWS {
                // Threads share out large layers alone.
                if K::NAME == Portable::NAME && rows * inputs > 1000 && rows != 65 {
                    continue;
                }
                let x = series(rows * inputs, 1);
                layer.check(kernels, &x, inputs, &format!("{rows}x{inputs}x{outputs}"));
            }
        }
    }
}

#[test]
fn parts_of_layers_equal_the_whole() {
    struct Check;
    impl Run for Check {
        type Output = ();
        fn run<K: HostKernels>(self, kernels: K) {
            for (inputs, outputs) in [
                (1, 1_usize),
                (7, 17),
                (64, 65),
                (130, 130),
                (200, 48),
                (1030, 33),
                (1024, 64),
                (4101, 24),
            ] {
                let bias = series(outputs.saturating_sub(5), 3);
                let layer = Layer::new(bytes(outputs * inputs, 2), outputs, inputs, bias);
                for rows in 1..=40 {
                    let x = series(rows * inputs, 1);
                    let what = format!("{rows}x{inputs}x{outputs}");
                    layer.check_columns(kernels, &x, inputs, &what);
                }
            }
        }
    }
    for kernel in Kernel::available() {
        kernel.run(Check).unwrap();
    }
}

#[test]
fn weights_that_fill_caches_give_the_same() {
    struct Check<'l>(&'l Layer, &'l [f32], &'l [f32], usize);
    impl Run for Check<'_> {
        type Output = ();
        fn run<K: HostKernels>(self, kernels: K) {
            let Check(layer, x, expected, inputs) = self;
            let mut out = vec![7.0; expected.len()];
            let mut ours = Room::new(kernels, x, inputs);
            let weight = layer.panels();
            kernels.linear_panels(&mut ours.scratch(), weight, &layer.bias, inputs, &mut out);
            assert_same(&out, expected, K::NAME);
        }
    }
    // 8.5 MB, a last panel and a last group that are not whole, rows that two registers share.
    let (rows, inputs, outputs) = (35, 1031, 8203);
    let layer = Layer::new(bytes(outputs * inputs, 2), outputs, inputs, series(outputs, 3));
    let x = series(rows * inputs, 1);
    let mut expected = vec![7.0; rows * outputs];
    let mut theirs = Room::new(Portable, &x, inputs);
    let weights = layer.rows();
    Portable.linear_i8(&mut theirs.scratch(), weights, &layer.bias, inputs, &mut expected);
    for kernel in Kernel::available() {
        if kernel != Kernel::Portable {
            kernel.run(Check(&layer, &x, &expected, inputs)).unwrap();
        }
    }
}

fn check_int8_extremes<K: Kernels>(kernels: K) {
    let (inputs, outputs) = (14_592, 20);
    for (x, w) in [(1.0, 127), (-1.0, 127), (1.0, -127), (-1.0, -127)] {
        let layer = Layer::new(vec![w; outputs * inputs], outputs, inputs, Vec::new());
        for rows in [1, 2, 7, 14] {
            let what = format!("{rows} rows of {x} x {w}");
            layer.check(kernels, &vec![x; rows * inputs], inputs, &what);
        }
    }
    // As many inputs as a model may have.
    let inputs = 16_384 * 8;
    let layer = Layer::new(vec![-127; 2 * inputs], 2, inputs, Vec::new());
    layer.check(kernels, &vec![-3e38; inputs], inputs, "the widest layer");
}

fn check_odd_rows<K: Kernels>(kernels: K) {
    for inputs in [1, 5, 8, 17, 64, 65, 130] {
        let mut x = Vec::new();
        let plain = series(inputs, 4);
        for bad in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for at in [0, inputs / 2, inputs - 1] {
                let mut row = plain.clone();
                row[at] = bad;
                x.extend(row);
            }
        }
        for scale in [0.0, -0.0, 1e-45, 1e-38, 9e-31, 1.1e-30, 1e-20, 3.4e38] {
            x.extend(plain.iter().map(|x| x * scale));
        }
        // Halves, which go to the even number.
        x.extend((0..inputs).map(|i| if i == 0 { 127.0 } else { i as f32 * 0.5 - 30.0 }));
        x.extend((0..inputs).map(|i| if i == 0 { 254.0 } else { (i % 253) as f32 - 126.0 }));
        let layer = Layer::new(bytes(17 * inputs, 6), 17, inputs, series(17, 7));
        layer.check(kernels, &x, inputs, &format!("odd rows of {inputs}"));
    }
    // Rows that the scratch has no room for are left out.
    let x = series(40, 8);
    let mut room = Room { values: vec![0; scratch_bytes(8, 2)], scales: vec![-1.0; 2] };
    kernels.quantise(&x, 8, &mut room.scratch());
    for (scale, row) in room.scales.iter().zip(x.chunks(8)) {
        assert_eq!(*scale, quant::quantise_row(row, &mut [0; 8]));
    }
}

fn check_wide<K: Kernels>(kernels: K) {
    let emulated = std::env::var_os(EMULATED).is_some();
    let most = if emulated { 20_000 } else { 500_000 };
    for inputs in INPUTS.into_iter().chain([1024, 1025]) {
        for outputs in OUTPUTS {
            let weight = odd(&series(outputs * inputs, 2));
            let half: Vec<f16> = weight.iter().map(|w| f16::from_f32(*w)).collect();
            let bias = if outputs % 2 == 0 { series(outputs, 3) } else { Vec::new() };
            for rows in ROWS {
                let wanted = rows == 65 && (!emulated || outputs == 65);
                if rows * inputs * outputs > most && !wanted {
                    continue;
                }
                let what = format!("{rows}x{inputs}x{outputs}");
                let x = odd(&series(rows * inputs, 1));
                let (mut found, mut expected) =
                    (vec![7.0; rows * outputs], vec![7.0; rows * outputs]);
                let (x, weight, half) = (&x[1..], &weight[1..], &half[1..]);
                kernels.linear_f32(x, weight, &bias, inputs, &mut found);
                Portable.linear_f32(x, weight, &bias, inputs, &mut expected);
                assert_same(&found, &expected, &format!("f32 {what}"));
                kernels.linear_f16(x, half, &bias, inputs, &mut found);
                Portable.linear_f16(x, half, &bias, inputs, &mut expected);
                assert_same(&found, &expected, &format!("f16 {what}"));
            }
        }
    }
    // Numbers that are none go where they do in the definition, and nowhere else.
    let (rows, inputs, outputs) = (9, 21, 35);
    let (mut x, mut weight) = (series(rows * inputs, 1), series(outputs * inputs, 2));
    (x[5], x[3 * inputs + 20], x[40]) = (f32::NAN, f32::INFINITY, -0.0);
    (weight[7 * inputs + 3], weight[34 * inputs]) = (f32::NEG_INFINITY, f32::NAN);
    let (mut found, mut expected) = (vec![7.0; rows * outputs], vec![7.0; rows * outputs]);
    kernels.linear_f32(&x, &weight, &[], inputs, &mut found);
    Portable.linear_f32(&x, &weight, &[], inputs, &mut expected);
    assert_same(&found, &expected, "f32 that is not finite");
    kernels.linear_f32(&x[..2 * inputs], &weight, &[], inputs, &mut found[..2 * outputs]);
    assert_same(&found, &expected, "two rows of f32 that is not finite");
}

fn check_sums<K: Kernels>(kernels: K) {
    for width in INPUTS {
        let (lhs, rhs) = (odd(&series(width, 1)), odd(&series(width, 2)));
        let found = [kernels.dot_f32(&lhs[1..], &rhs[1..])];
        assert_same(&found, &[Portable.dot_f32(&lhs[1..], &rhs[1..])], &format!("dot {width}"));

        let (mut found, mut expected) = (odd(&lhs), odd(&lhs));
        kernels.rms_norm(&mut found[1..], &rhs, 1e-6);
        Portable.rms_norm(&mut expected[1..], &rhs, 1e-6);
        assert_same(&found, &expected, &format!("norm {width}"));

        for rows in ROWS {
            for stride in [width, width + 3, 4 * width] {
                let what = format!("{rows} rows of {width}, {stride} apart");
                // The last row may end early where others begin `stride` after the one before.
                let end = rows.saturating_sub(1) * stride + width.min(rows * width);
                let keys = odd(&series(end, 3));
                let (mut found, mut expected) = (vec![7.0; rows], vec![7.0; rows]);
                kernels.scores(&lhs[1..], &keys[1..], stride, 0.3, &mut found);
                Portable.scores(&lhs[1..], &keys[1..], stride, 0.3, &mut expected);
                assert_same(&found, &expected, &format!("scores {what}"));

                let (mut mixed, mut expected_mix) = (vec![7.0; width], vec![7.0; width]);
                kernels.mix(&found, &keys[1..], stride, &mut mixed);
                Portable.mix(&found, &keys[1..], stride, &mut expected_mix);
                assert_same(&mixed, &expected_mix, &format!("mix {what}"));
            }
        }
    }
}

/// Numbers where functions bend, and between.
fn arguments() -> Vec<f32> {
    let special = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        1e-45,
        -1e-45,
        1e-38,
        -1e-38,
        86.0,
        -86.0,
        86.1,
        -86.1,
        88.0,
        -88.0,
        88.1,
        -88.1,
        1e30,
        -1e30,
        f32::MAX,
        f32::MIN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::NAN,
        -f32::NAN,
    ];
    let many = (-40_000..40_000).map(|i| i as f32 * 0.0025 + 0.000_1);
    special.into_iter().chain(many).collect()
}

fn check_elements<K: Kernels>(kernels: K) {
    let all = arguments();
    let other = series(all.len(), 9);
    for length in INPUTS.into_iter().chain([24, all.len()]) {
        let (x, y) = (odd(&all[..length]), &other[..length]);
        let z: Vec<f32> = y.iter().map(|y| y * 3.0).collect();
        let compare = |what: &str, work: &dyn Fn(&mut [f32]), definition: &dyn Fn(&mut [f32])| {
            let (mut found, mut expected) = (x.clone(), x.clone());
            work(&mut found[1..]);
            definition(&mut expected[1..]);
            assert_same(&found, &expected, &format!("{what} {length}"));
        };
        compare("silu", &|x| kernels.silu(x), &|x| Portable.silu(x));
        compare("gate", &|x| kernels.gate(x, 0.7, y), &|x| Portable.gate(x, 0.7, y));
        compare("gates", &|x| x.copy_from_slice(&gates(kernels, x)), &|x| {
            x.copy_from_slice(&gates(Portable, x));
        });
        compare("rotate", &|x| kernels.rotate(x, y, &z), &|x| Portable.rotate(x, y, &z));
        let half = length / 3;
        compare("turns", &|x| kernels.rotate(x, &y[..half], &z), &|x| {
            Portable.rotate(x, &y[..half], &z);
        });
        // Of what is not a number, the trait leaves the answer open.
        let finite = |x: &mut [f32]| x.iter_mut().for_each(|x| *x = x.clamp(-1e30, 1e30));
        let numbers = |x: &mut [f32]| {
            finite(x);
            x.iter_mut().filter(|x| x.is_nan()).for_each(|x| *x = 0.5);
        };
        compare(
            "normalise",
            &|x| {
                numbers(x);
                kernels.normalise(x, y, &z, 5.0);
            },
            &|x| {
                numbers(x);
                Portable.normalise(x, y, &z, 5.0);
            },
        );
    }
}

/// Numbers gated by others.
fn gates<K: Kernels>(kernels: K, gate: &[f32]) -> Vec<f32> {
    let mut x = series(gate.len(), 12);
    kernels.gate(&mut x, 1.3, gate);
    x
}

fn check_softmax<K: Kernels>(kernels: K) {
    for length in (0..70).chain([130, 768]) {
        let plain = series(length, 10);
        let mut rows = vec![
            plain.iter().map(|x| x * 20.0).collect::<Vec<_>>(),
            plain.iter().map(|x| x * 1e3).collect(),
            plain.iter().map(|_| -0.0).collect(),
        ];
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut row = plain.clone();
            if let Some(x) = row.get_mut(length / 2) {
                *x = bad;
            }
            rows.push(row);
            rows.push(vec![bad; length]);
        }
        for row in rows {
            let (mut found, mut expected) = (odd(&row), odd(&row));
            let total = [kernels.softmax(&mut found[1..])];
            assert_same(&total, &[Portable.softmax(&mut expected[1..])], "softmax's sum");
            assert_same(&found, &expected, &format!("softmax of {length}"));
        }
    }
}

fn check_pools<K: Kernels>(kernels: K) {
    for channels in [1, 3, 8, 15, 16, 17, 33, 64, 130] {
        for rows in ROWS {
            let what = format!("{rows} points, {channels} channels");
            let mut x = series(rows * channels, 11);
            if rows == 9 {
                x[channels] = f32::NAN;
                x[2 * channels - 1] = f32::NEG_INFINITY;
                x[7 * channels] = -0.0;
            }
            let start = || {
                (odd(&vec![f32::NEG_INFINITY; channels]), odd(&series(channels + channels % 3, 13)))
            };
            let (mut most, mut sum) = start();
            let (mut expected_most, mut expected_sum) = start();
            kernels.pool(&x, &mut most[1..], &mut sum[1..]);
            Portable.pool(&x, &mut expected_most[1..], &mut expected_sum[1..]);
            assert_equal(&most, &expected_most, &format!("maximum of {what}"));
            assert_same(&sum, &expected_sum, &format!("sum of {what}"));

            let weights: Vec<[f32; ANCHORS]> =
                series(rows * ANCHORS, 14).as_chunks::<ANCHORS>().0.to_vec();
            let (mut found, mut expected) =
                (odd(&series(ANCHORS * channels, 15)), odd(&series(ANCHORS * channels, 15)));
            kernels.weigh(&x, &weights, &mut found[1..]);
            Portable.weigh(&x, &weights, &mut expected[1..]);
            assert_same(&found, &expected, &format!("weights of {what}"));
        }
    }
}

/// What slices of other lengths come to is not defined, only that nothing is read or written beyond them.
fn check_mismatches<K: Kernels>(kernels: K) {
    let lengths = [0, 1, 3, 7, 20, 65];
    let x = series(65, 1);
    let half: Vec<f16> = x.iter().map(|x| f16::from_f32(*x)).collect();
    for a in lengths {
        for b in lengths {
            for c in lengths {
                let mut out = series(c, 2);
                for inputs in [0, 1, 5, 16] {
                    kernels.linear_f32(&x[..a], &x[..b], &x[..3], inputs, &mut out);
                    kernels.linear_f16(&x[..a], &half[..b], &x[..3], inputs, &mut out);
                    kernels.scores(&x[..a], &x[..b], inputs, 0.5, &mut out);
                    kernels.mix(&x[..a], &x[..b], inputs, &mut out);
                    let (mut values, weights) = (vec![1; a * 3], bytes(b * 3, 3));
                    let mut scales = series(c, 4);
                    kernels.quantise(
                        &x[..b],
                        inputs,
                        &mut Scratch { values: &mut values, scales: &mut scales },
                    );
                    let mut scratch = Scratch { values: &mut values, scales: &mut scales };
                    let weight = Rows { values: &weights, scales: &x[..a] };
                    kernels.linear_i8(&mut scratch, weight, &x[..2], inputs, &mut out);
                    if K::NAME == Portable::NAME {
                        continue;
                    }
                }
                kernels.dot_f32(&x[..a], &x[..b]);
                kernels.rms_norm(&mut out, &x[..a], 1e-6);
                kernels.rotate(&mut out, &x[..a], &x[..b]);
                kernels.gate(&mut out, 0.5, &x[..a]);
                kernels.normalise(&mut out, &x[..a], &x[..b], 2.0);
                let mut sum = series(b, 5);
                kernels.pool(&x[..a], &mut out, &mut sum);
                let weights = vec![[0.5; ANCHORS]; b];
                kernels.weigh(&x[..a], &weights, &mut out);
            }
        }
    }
}

#[test]
fn panels_of_other_sizes_do_not_panic() {
    struct Check;
    impl Run for Check {
        type Output = ();
        fn run<K: HostKernels>(self, kernels: K) {
            let (bytes, sums, numbers) = (bytes(4096, 1), [3; 40], series(40, 2));
            for inputs in [0, 1, 5, 16] {
                for a in [0, 63, 64, 1000, 4096] {
                    for b in [0, 1, 17, 40] {
                        for width in [0, 1, 16, 17, 30] {
                            let mut out = vec![0.0; 100];
                            let weight = Panels {
                                values: &bytes[..a],
                                scales: &numbers[..b],
                                sums: &sums[..40 - b],
                            };
                            let (values, scales) = (&bytes[..a / 2], &numbers[..b]);
                            let x = Quantised { values, scales, inputs };
                            if kernels.row_bytes(inputs) > 0 || inputs == 0 {
                                kernels.multiply(
                                    x,
                                    weight,
                                    &numbers[..7],
                                    Columns::new(&mut out, width),
                                );
                            }
                        }
                    }
                }
            }
        }
    }
    // The portable ones take any columns for whole rows.
    for kernel in Kernel::available().into_iter().filter(|kernel| *kernel != Kernel::Portable) {
        kernel.run(Check).unwrap();
    }
}

#[test]
fn names_are_those_of_the_variable() {
    for kernel in Kernel::ALL {
        assert_eq!(kernel.to_string().parse(), Ok(kernel));
    }
    let error = "sse2".parse::<Kernel>().unwrap_err();
    assert_eq!(error, KernelError::Unknown { name: "sse2".into() });
    let message = error.to_string();
    assert!(message.contains("\"sse2\"") && message.contains(VARIABLE), "{message}");
    assert!(
        message.contains("portable, avx2, avx-vnni, avx512-vnni, amx, neon, sdot, smmla"),
        "{message}"
    );
    for name in ["", "AVX2", " avx2", "avx2 "] {
        assert!(name.parse::<Kernel>().is_err(), "{name:?}");
    }
    let foreign = if cfg!(target_arch = "x86_64") { Kernel::Sdot } else { Kernel::Avx2 };
    assert!(!Kernel::available().contains(&foreign));
    let message = KernelError::Lacking { kernel: foreign }.to_string();
    assert!(message.contains(foreign.name()) && message.contains("portable"), "{message}");
    assert_eq!(Kernel::available()[0], Kernel::Portable);
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
    for counts in [&odd, &many] {
        let threads =
            [None].into_iter().chain([2, 3, 5, 12, 16].map(|n| Some(Threads::new(n).eager())));
        let expected = Kernel::Portable.run(Crowd { model: &edge, counts, threads: None }).unwrap();
        for kernel in Kernel::available().into_iter().filter(|kernel| *kernel != Kernel::Portable) {
            for threads in threads.clone() {
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
