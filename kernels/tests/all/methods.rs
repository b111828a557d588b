//! Kernels of this processor: each equals the portable ones bit by bit.

use rigidformer_core::weights::Panels;
use rigidformer_core::{Kernels, Portable};
use rigidformer_kernels::{Columns, HostKernels, Kernel, KernelError, Quantised, Run, VARIABLE};

use crate::checks::*;

/// Runs a check with all kernels of this processor.
macro_rules! with_all_kernels {
    ($name:ident, $check:ident) => {
        #[test]
        fn $name() {
            struct Check;
            impl Run for Check {
                type Output = ();
                fn run<K: HostKernels>(self, kernels: K) {
                    $check(kernels);
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
with_all_kernels!(sums_have_one_order, check_sums);
with_all_kernels!(elements_have_the_same_bits, check_elements);
with_all_kernels!(softmax_is_the_same, check_softmax);
with_all_kernels!(pools_are_the_same, check_pools);
with_all_kernels!(sweeps_are_the_same, check_sweeps);
with_all_kernels!(mismatched_slices_do_not_panic, check_mismatches);

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
fn kernels_that_name_an_instruction_have_its_ceiling() {
    for kernel in Kernel::available() {
        let macs = [0, 1, 3].map(|rounds| kernel.ceiling(rounds));
        assert!(macs.iter().all(|macs| *macs == macs_of_a_round(kernel)), "{kernel}: {macs:?}");
    }
    /// Sums of a round times channels and inputs of a register.
    fn macs_of_a_round(kernel: Kernel) -> Option<u64> {
        let macs = match kernel.instruction()? {
            "vpmaddubsw" => 6 * 8 * 4,
            "vpdpbusd of 256 bits" => 12 * 8 * 4,
            _ => 24 * 16 * 4,
        };
        Some(macs)
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
