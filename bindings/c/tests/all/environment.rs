//! The C functions give the same bits whatever rounding, flush of subnormal numbers and traps the caller has set.
#![cfg(all(target_arch = "x86_64", not(miri)))]
// Handles live here, and arrays are as long as they say.
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::*;
use rigidformer_capi::edit::*;
use rigidformer_capi::ffi::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_capi::types::*;
use std::arch::asm;

/// Runs `body` where MXCSR is `word`, and says whether it is `word` behind it, flags and all.
#[inline(never)]
fn under<R>(word: u32, body: impl FnOnce() -> R) -> (R, bool) {
    let set = |word: u32| unsafe { asm!("ldmxcsr [{}]", in(reg) &raw const word) };
    set(word);
    let result = body();
    let mut behind = 0;
    unsafe { asm!("stmxcsr [{}]", in(reg) &raw mut behind) };
    set(0x1f80);
    (result, behind == word)
}

/// Four roundings, flush of results, operands that count as zeros, traps; one raised flag, which must stay.
fn environments() -> impl Iterator<Item = u32> {
    (0..32_u32).map(|number| {
        let rounding = (number & 3) << 13;
        let (flush, zeros) = ((number >> 2 & 1) << 15, (number >> 3 & 1) << 6);
        let masks = if number >> 4 == 0 { 0x1f80 } else { 0 };
        rounding | flush | zeros | masks | (number & 1) << 5
    })
}

/// All poses of a rollout, each call of which is made in the caller's environment.
fn rollout(model: &[u8], threads: u32, scene: &Scene, gravity: &[f32; 3]) -> Vec<[u32; 12]> {
    let config = rf_config { threads, ..config(model, 3, 15) };
    let mut workspace = Workspace::of(&config);
    let handle = workspace.init(&config);
    assert_eq!(unsafe { rf_set_gravity(handle, gravity.as_ptr()) }, RF_OK);
    assert_eq!(scene.observe(handle), RF_OK);
    let mut all = Vec::new();
    for _ in 0..2 {
        assert_eq!(step(handle), RF_OK);
        all.extend(poses(handle));
        let mut handed = [rf_pose { position: [0.0; 3], quaternion: [0.0; 4] }; 3];
        assert_eq!(unsafe { rf_poses(handle, handed.as_mut_ptr(), 3) }, RF_OK);
        all.extend(handed.map(|pose| {
            let mut row = [0; 12];
            let numbers = pose.position.iter().chain(&pose.quaternion);
            row.iter_mut().zip(numbers).for_each(|(to, number)| *to = number.to_bits());
            row
        }));
    }
    all
}

#[test]
fn a_rollout_has_the_same_bits_in_every_environment() {
    let scene = Scene::new(3);
    for model in [rigidformer_weights::EDGE, smallest()] {
        let rolled = |threads| rollout(model, threads, &scene, &[0.1, 0.0, -9.81]);
        let run = || rolled(1);
        let expected = run();
        let threads: &[u32] = if cfg!(feature = "threads") { &[1, 2] } else { &[1] };
        for (word, &threads) in
            environments().flat_map(|word| threads.iter().map(move |n| (word, n)))
        {
            let found = under(word, || rolled(threads));
            assert_eq!(found, (expected.clone(), true), "{word:#x}, {threads} threads");
        }
        // A thread begins with what the one has that makes it. All roundings are among these.
        for word in environments().step_by(5) {
            let (of_thread, _) =
                under(word, || std::thread::scope(|scope| scope.spawn(run).join().unwrap()));
            assert_eq!(of_thread, expected, "{word:#x}");
        }
    }
}

#[test]
fn innovations_have_the_same_bits_in_every_environment() {
    let pose = |x, y| rf_pose { position: [x, y, 0.3], quaternion: [0.1, 0.2, 0.3, 0.9273618] };
    let run = || {
        let mut distance = 0.0;
        let (predicted, observed) = (pose(0.1, 0.7), pose(0.3, 0.7));
        let variances = [0.3, 0.7, 0.11, 0.13, 0.17, 0.19];
        let status = unsafe {
            rigidformer_capi::health::rf_innovation(
                &predicted,
                &observed,
                variances.as_ptr(),
                &mut distance,
            )
        };
        (status, distance.to_bits())
    };
    let expected = run();
    assert_eq!(expected.0, RF_OK);
    for word in environments() {
        assert_eq!(under(word, run), (expected, true), "{word:#x}");
    }
}
