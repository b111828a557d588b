//! What each method of kernels must do: the same as the portable one, bit by bit, at sizes that straddle every tile. The tests of threads
//! check their shared operations with these too.
#![allow(dead_code)]

use half::f16;
use rigidformer_core::kernels::{Block, Goal, Motion, Rows, WIDE};
use rigidformer_core::quant::{self, Scratch, scratch_bytes};
use rigidformer_core::weights::Panels;
use rigidformer_core::{ANCHORS, Kernels, Portable};
use rigidformer_kernels::{Columns, HostKernels, Quantised, panels};

pub(crate) const ROWS: [usize; 16] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 16, 31, 32, 33, 64, 65];

pub(crate) const INPUTS: [usize; 20] =
    [1, 2, 3, 4, 5, 6, 7, 8, 9, 15, 16, 17, 31, 32, 33, 63, 64, 65, 130, 768];
pub(crate) const OUTPUTS: [usize; 10] = [1, 3, 15, 16, 17, 33, 63, 64, 65, 130];

/// Set where an emulator plays the processor: products of f32 and f16, which take it longest, leave out most large sizes.
pub(crate) const EMULATED: &str = "RIGIDFORMER_EMULATED";

/// Numbers between -1 and 1.
pub(crate) fn series(n: usize, seed: usize) -> Vec<f32> {
    let mut state = seed as u32;
    let next = |_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..n).map(next).collect()
}

/// Numbers from -127 to 127.
pub(crate) fn bytes(n: usize, seed: usize) -> Vec<i8> {
    series(n, seed).into_iter().map(|x| (x * 127.4) as i8).collect()
}

/// Bits, but for what a NaN is made of.
pub(crate) fn bits(x: f32) -> u32 {
    if x.is_nan() { u32::MAX } else { x.to_bits() }
}

#[track_caller]
pub(crate) fn assert_same(found: &[f32], expected: &[f32], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert_eq!(bits(*found), bits(*expected), "{what}: {found} for {expected} at {i}");
    }
}

/// The same, but for the sign of a zero.
#[track_caller]
pub(crate) fn assert_equal(found: &[f32], expected: &[f32], what: &str) {
    let plus_zero = |x: &[f32]| x.iter().map(|x| x + 0.0).collect::<Vec<_>>();
    assert_same(&plus_zero(found), &plus_zero(expected), what);
}

/// The numbers at an address that no register is aligned at.
pub(crate) fn odd(numbers: &[f32]) -> Vec<f32> {
    std::iter::once(0.0).chain(numbers.iter().copied()).collect()
}

/// Quantised rows of kernels.
pub(crate) struct Room {
    values: Vec<i8>,
    scales: Vec<f32>,
}

impl Room {
    pub(crate) fn new<K: Kernels>(kernels: K, x: &[f32], inputs: usize) -> Self {
        let rows = x.len() / inputs.max(1);
        let mut room =
            Room { values: vec![-1; scratch_bytes(inputs, rows)], scales: vec![-1.0; rows] };
        kernels.quantise(x, inputs, &mut room.scratch());
        room
    }

    pub(crate) fn scratch(&mut self) -> Scratch<'_> {
        Scratch { values: &mut self.values, scales: &mut self.scales }
    }
}

/// An int8 layer.
pub(crate) struct Layer {
    rows: Vec<i8>,
    values: Vec<i8>,
    sums: Vec<i32>,
    scales: Vec<f32>,
    pub(crate) bias: Vec<f32>,
}

impl Layer {
    pub(crate) fn new(rows: Vec<i8>, outputs: usize, inputs: usize, bias: Vec<f32>) -> Self {
        let (values, sums) = panels(&rows, outputs, inputs);
        let scales = series(outputs, 5).iter().map(|x| x.abs() / 100.0 + 1e-3).collect();
        Layer { rows, values, sums, scales, bias }
    }

    pub(crate) fn panels(&self) -> Panels<'_> {
        Panels { values: &self.values, scales: &self.scales, sums: &self.sums }
    }

    pub(crate) fn rows(&self) -> Rows<'_> {
        Rows { values: &self.rows, scales: &self.scales }
    }

    /// Compares both layouts for these rows.
    pub(crate) fn check<K: Kernels>(&self, kernels: K, x: &[f32], inputs: usize, what: &str) {
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
    pub(crate) fn check_columns<K: HostKernels>(
        &self,
        kernels: K,
        x: &[f32],
        inputs: usize,
        what: &str,
    ) {
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

pub(crate) fn check_int8<K: Kernels>(kernels: K) {
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

pub(crate) fn check_int8_extremes<K: Kernels>(kernels: K) {
    let (inputs, outputs) = (14_592, 20);
    for (x, w) in [(1.0, 127), (-1.0, 127), (1.0, -127), (-1.0, -127)] {
        let layer = Layer::new(vec![w; outputs * inputs], outputs, inputs, Vec::new());
        for rows in [1, 2, 7, 14] {
            let what = format!("{rows} rows of {x} x {w}");
            layer.check(kernels, &vec![x; rows * inputs], inputs, &what);
        }
    }
    // Neighbours that cancel, and sizes about each tile. No model has -128, but nothing here depends on that.
    for (inputs, outputs) in [(1, 1), (3, 17), (4, 16), (31, 7), (33, 33), (66, 24)] {
        for (seed, extremes) in
            [[-127, 127], [127, -127], [-127, -127], [-128, 127]].iter().enumerate()
        {
            let weights = (0..outputs * inputs).map(|i| extremes[(i / (seed + 1)) % 2]).collect();
            let layer = Layer::new(weights, outputs, inputs, series(outputs, 3));
            for rows in 1..=14 {
                let x: Vec<f32> = series(rows * inputs, seed).iter().map(|x| x.signum()).collect();
                let what = format!("{rows}x{inputs}x{outputs} of {extremes:?}");
                layer.check(kernels, &x, inputs, &what);
                let x = vec![-1.0; rows * inputs];
                layer.check(kernels, &x, inputs, &format!("{what} by -1"));
            }
        }
    }
    // As many inputs as a model may have.
    let inputs = 16_384 * 8;
    let layer = Layer::new(vec![-127; 2 * inputs], 2, inputs, Vec::new());
    layer.check(kernels, &vec![-3e38; inputs], inputs, "the widest layer");
}

pub(crate) fn check_odd_rows<K: Kernels>(kernels: K) {
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

pub(crate) fn check_wide<K: Kernels>(kernels: K) {
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

pub(crate) fn check_sums<K: Kernels>(kernels: K) {
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
pub(crate) fn arguments() -> Vec<f32> {
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

pub(crate) fn check_elements<K: Kernels>(kernels: K) {
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
pub(crate) fn gates<K: Kernels>(kernels: K, gate: &[f32]) -> Vec<f32> {
    let mut x = series(gate.len(), 12);
    kernels.gate(&mut x, 1.3, gate);
    x
}

pub(crate) fn check_softmax<K: Kernels>(kernels: K) {
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

pub(crate) fn check_pools<K: Kernels>(kernels: K) {
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
pub(crate) fn check_mismatches<K: Kernels>(kernels: K) {
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

pub(crate) fn check_sweeps<K: HostKernels>(kernels: K) {
    // Three blocks of contacts of 2 x WIDE units, one of each block with a plane.
    let units = 2 * WIDE;
    let fields = size_of::<Block>() / size_of::<[f32; WIDE]>();
    let numbers = series(3 * fields * WIDE, 5);
    let mut blocks: Vec<Block> =
        vec![[[0.0; WIDE]; size_of::<Block>() / size_of::<[f32; WIDE]>()]; 3];
    let mut rest = numbers.into_iter();
    for (block, shift) in blocks.iter_mut().zip([0, 3, 7]) {
        block.as_flattened_mut().iter_mut().for_each(|number| *number = rest.next().unwrap());
        let [along, _, _, _, _, first, second, ..] = block;
        // Impulses along normals are none below 0; units of a block are all different, and one contact is with a plane.
        for (lane, along) in along.iter_mut().enumerate() {
            *along = along.max(0.0);
            first[lane] = ((2 * lane + shift) % units) as f32;
            second[lane] = ((2 * lane + 1 + shift) % units) as f32;
        }
        first[2] = f32::MAX;
    }
    let motion = size_of::<Motion>() / size_of::<f32>();
    let motions = series(units * motion, 6);
    let start: Vec<Motion> = motions.as_chunks().0.to_vec();
    for goal in [Goal::Stop, Goal::Settle, Goal::Bounce] {
        for upwards in [true, false] {
            let (mut ours, mut theirs) =
                ((blocks.clone(), start.clone()), (blocks.clone(), start.clone()));
            let acts = kernels.sweep(&mut ours.0, &mut ours.1, (goal, upwards));
            assert_eq!(acts, Portable.sweep(&mut theirs.0, &mut theirs.1, (goal, upwards)));
            assert!(acts, "nothing was tested");
            let what = format!("{} {goal:?}", K::NAME);
            let flat = |blocks: &[Block]| blocks.as_flattened().as_flattened().to_vec();
            assert_same(&flat(&ours.0), &flat(&theirs.0), &what);
            assert_same(ours.1.as_flattened(), theirs.1.as_flattened(), &what);
        }
    }
}
