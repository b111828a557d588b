//! Lengths that no memory has: nothing is read or written beyond a slice, and numbers that have no row stay what they were.

use std::panic::{AssertUnwindSafe, catch_unwind};

use half::f16;
use rigidformer_core::ANCHORS;
use rigidformer_core::kernels::{Attention, Lanes, Rows, TOGETHER, scratch_numbers};
use rigidformer_core::quant::Scratch;
use rigidformer_core::weights::Panels;
use rigidformer_kernels::{Columns, HostKernels, Kernel, Quantised, Run};

use crate::checks::*;

/// Lengths whose products with 2, 4, 16 or 64 wrap round to small numbers, and their neighbours.
fn lengths() -> impl Iterator<Item = usize> {
    let powers = (24..usize::BITS).map(|bit| 1_usize << bit);
    let near = powers.flat_map(|power| {
        [-5_isize, -4, -1, 0, 1, 3, 4, 64].map(|by| power.wrapping_add_signed(by))
    });
    near.chain((0..=65).map(|below| usize::MAX - below))
}

/// Runs a check with all kernels of this processor.
fn with_all(check: impl Run<Output = ()> + Copy) {
    for kernel in Kernel::available() {
        kernel.run(check).unwrap();
    }
}

#[test]
fn no_row_of_so_many_inputs_is_multiplied() {
    #[derive(Clone, Copy)]
    struct Check;
    impl Run for Check {
        type Output = ();
        fn run<K: HostKernels>(self, kernels: K) {
            let (values, numbers, sums) = (bytes(4096, 1), series(64, 2), [3; 64]);
            for inputs in lengths() {
                assert!(kernels.row_bytes(inputs) >= inputs, "{}: {inputs}", K::NAME);
                for (room, rows, outputs) in
                    [(64, 1, 16), (4096, 1, 1), (4096, 13, 17), (4096, 64, 64)]
                {
                    let weight = Panels {
                        values: &values[..room],
                        scales: &numbers[..outputs],
                        sums: &sums[..outputs],
                    };
                    let mut out = vec![7.0; rows * outputs];
                    let x = Quantised { values: &values[..room], scales: &numbers[..rows], inputs };
                    kernels.multiply(x, weight, &[], Columns::new(&mut out, outputs));
                    let (mut own, mut scales) = (values.clone(), vec![1.0; rows]);
                    let mut scratch = Scratch { values: &mut own, scales: &mut scales };
                    kernels.quantise(&numbers, inputs, &mut scratch);
                    kernels.linear_panels(&mut scratch, weight, &[], inputs, &mut out);
                    let of_rows = Rows { values: &values[..room], scales: &numbers[..outputs] };
                    kernels.linear_i8(&mut scratch, of_rows, &[], inputs, &mut out);
                    assert!(out.iter().all(|x| *x == 7.0), "{}: {inputs}", K::NAME);
                    assert!(
                        own == values && scales.iter().all(|x| *x == 1.0),
                        "{}: {inputs}",
                        K::NAME
                    );
                }
            }
        }
    }
    with_all(Check);
}

#[test]
fn no_row_so_wide_is_multiplied() {
    #[derive(Clone, Copy)]
    struct Check;
    impl Run for Check {
        type Output = ();
        fn run<K: HostKernels>(self, kernels: K) {
            let numbers = series(256, 1);
            let halves: Vec<f16> = numbers.iter().map(|x| f16::from_f32(*x)).collect();
            for inputs in lengths() {
                let mut out = vec![7.0; 64];
                kernels.linear_f32(&numbers, &numbers, &numbers, inputs, &mut out);
                kernels.linear_f16(&numbers, &halves, &numbers, inputs, &mut out);
                assert!(out.iter().all(|x| *x == 7.0), "{}: {inputs}", K::NAME);
            }
        }
    }
    with_all(Check);
}

#[test]
fn only_the_first_row_has_a_place_at_so_long_a_stride() {
    #[derive(Clone, Copy)]
    struct Check;
    impl Run for Check {
        type Output = ();
        fn run<K: HostKernels>(self, kernels: K) {
            let numbers = series(64, 1);
            for stride in lengths() {
                let what = format!("{}: {stride}", K::NAME);
                let (mut found, mut expected) = ([7.0; 8], [7.0; 8]);
                kernels.scores(&numbers[..16], &numbers, stride, 0.5, &mut found);
                kernels.scores(&numbers[..16], &numbers, 64, 0.5, &mut expected);
                assert_same(&found, &expected, &what);
                let (mut found, mut expected) = ([7.0; 33], [7.0; 33]);
                kernels.mix(&numbers[..5], &numbers, stride, &mut found);
                kernels.mix(&numbers[..5], &numbers, 64, &mut expected);
                assert_same(&found, &expected, &what);
                let mixed = |stride| {
                    let mut queries = vec![[0.5; TOGETHER]; 9];
                    let mut scores: Vec<Lanes> = vec![[7.0; TOGETHER]; 5];
                    let (keys, values) = (&numbers[..40], &numbers[..30]);
                    let totals =
                        kernels.mix_lanes(&mut queries, &mut scores, keys, values, stride, 0.5);
                    [queries.concat(), scores.concat(), totals.to_vec()].concat()
                };
                assert_same(&mixed(stride), &mixed(64), &what);
            }
        }
    }
    with_all(Check);
}

/// Places of an attention that are none: builds that check sums and slices stop, others end and write no further than they may.
#[test]
fn attention_stays_in_its_slices() {
    const RIM: usize = 16;
    #[derive(Clone, Copy)]
    struct Check;
    impl Run for Check {
        type Output = ();
        fn run<K: HostKernels>(self, kernels: K) {
            let numbers = series(96, 1);
            let sound = Attention {
                queries: &numbers[..48],
                query_stride: 24,
                gate: 8,
                tokens: &numbers,
                stride: 24,
                key: 0,
                value: 8,
                head_dim: 4,
                inner: 8,
                out_stride: 12,
                out_start: 2,
            };
            type Change = fn(&mut Attention<'_>, usize);
            let changes: [Change; 9] = [
                |a, length| a.query_stride = length,
                |a, length| a.gate = length,
                |a, length| a.stride = length,
                |a, length| a.key = length,
                |a, length| a.value = length,
                |a, length| a.head_dim = length,
                |a, length| a.inner = length,
                |a, length| a.out_stride = length,
                |a, length| a.out_start = length,
            ];
            let attended = |attention: &Attention<'_>, scratch: usize| {
                let mut room = vec![7.0; scratch + 2 * RIM];
                let mut out = vec![7.0; 24 + 2 * RIM];
                let ends = catch_unwind(AssertUnwindSafe(|| {
                    let scratch = &mut room[RIM..RIM + scratch];
                    kernels.attend(attention, scratch, &mut out[RIM..RIM + 24]);
                }));
                for all in [&room, &out] {
                    let rims = all[..RIM].iter().chain(&all[all.len() - RIM..]);
                    assert!(rims.copied().all(|x| x == 7.0), "{}: {attention:?}", K::NAME);
                }
                ends.map(|()| out)
            };
            let whole = scratch_numbers(4, 4);
            assert!(attended(&sound, whole).is_ok());
            for length in lengths().step_by(3).chain(0..=26) {
                for change in changes {
                    let mut odd = sound;
                    change(&mut odd, length);
                    let _ = [3, whole].map(|scratch| attended(&odd, scratch));
                }
            }
        }
    }
    // Thousands of panics of this thread, which are meant: nobody wants to read them.
    let (tell, here) = (std::panic::take_hook(), std::thread::current().id());
    std::panic::set_hook(Box::new(move |panic| {
        if std::thread::current().id() != here {
            tell(panic);
        }
    }));
    with_all(Check);
}

#[test]
fn columns_are_inside_their_matrix() {
    let numbers = series(64, 1);
    for width in lengths() {
        let mut matrix = [7.0; 64];
        assert_eq!(Columns::new(&mut matrix, width).rows(), 0);
        let (left, right) = Columns::new(&mut matrix, 8).split_at(width);
        assert_eq!((left.width(), right.width(), right.rows()), (8, 0, 8));
    }
    #[derive(Clone, Copy)]
    struct Check<'n>(&'n [f32]);
    impl Run for Check<'_> {
        type Output = ();
        fn run<K: HostKernels>(self, kernels: K) {
            // Fewer sums, scales or weights than the columns, and columns that are none.
            let (values, sums) = (bytes(4096, 1), [3; 64]);
            for width in [0, 1, 15, 16, 17, 64] {
                for at in [0, 1, 64, usize::MAX] {
                    let mut matrix = [7.0; 4096];
                    let weight =
                        Panels { values: &values[..64 * 4], scales: self.0, sums: &sums[..width] };
                    let x = Quantised { values: &values, scales: self.0, inputs: 16 };
                    let (_, right) = Columns::new(&mut matrix, 64).split_at(at);
                    if K::NAME != "portable" {
                        kernels.multiply(x, weight, &[], right);
                    }
                    assert!(
                        matrix
                            .as_chunks::<64>()
                            .0
                            .iter()
                            .all(|row| row.iter().take(at.min(64)).all(|x| *x == 7.0))
                    );
                }
            }
            let weights = [[0.5; ANCHORS]; 3];
            for channels in [0, 1, 3, 4, 7] {
                kernels.weigh(self.0, &weights, &mut [7.0; 7][..channels]);
            }
        }
    }
    with_all(Check(&numbers));
}
