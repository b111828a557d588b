//! `robot` of the targets, for libFuzzer.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| rigidformer_fuzz_targets::robot::run(data));
