//! How much stack a thread needs that calls.
// Handles live here, and arrays are as long as they say.
#![cfg(all(not(miri), target_os = "linux"))]
#![allow(unsafe_code, clippy::undocumented_unsafe_blocks)]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::common::*;
use rigidformer_capi::types::rf_status::*;
use rigidformer_weights::{EDGE, NANO};
use std::hint::black_box;
use std::thread;

const UNITS: usize = 9;
/// What is painted below the caller, bytes, and how far below it begins: what paints has a frame of its own.
const PAINTED: usize = 512 << 10;
const SPARED: usize = 4 << 10;
const COLOUR: u8 = 0xa5;
/// Bytes that docs/C.md has a thread have on Linux that calls rf_init.
const TO_BEGIN: usize = 192 << 10;
/// And for the other calls, with models of f16 and of f32.
const ENOUGH: [usize; 2] = [64 << 10, 128 << 10];

/// Bytes of stack that `work` takes.
#[inline(never)]
fn taken(work: &mut dyn FnMut()) -> usize {
    let here = 0_u8;
    let top = (&raw const here).addr() - SPARED;
    let bottom = std::ptr::with_exposed_provenance_mut::<u8>(top - PAINTED);
    // The thread's stack is larger, and nothing is below this frame but what paints it.
    unsafe { bottom.write_bytes(COLOUR, PAINTED) };
    work();
    black_box(&here);
    let left = (0..PAINTED).take_while(|at| unsafe { bottom.add(*at).read_volatile() } == COLOUR);
    PAINTED + SPARED - left.count()
}

#[test]
fn calls_take_no_more_stack_than_the_page_says() {
    // Under sanitisers and emulators frames are larger.
    if std::env::var_os("RIGIDFORMER_EMULATED").is_some() {
        return;
    }
    let models: [(&str, &'static [u8]); 2] = [("nano", NANO), ("edge", EDGE)];
    for ((name, model), enough) in models.into_iter().zip(ENOUGH) {
        let calls = move || {
            let config = config(model, UNITS as u32, 5 * UNITS as u32);
            let (mut workspace, scene) = (Workspace::of(&config), Scene::new(UNITS));
            let mut handle = std::ptr::null_mut();
            let begun = taken(&mut || handle = workspace.init(&config));
            let others = taken(&mut || {
                assert_eq!(scene.observe(handle), RF_OK);
                assert_eq!(step(handle), RF_OK);
            });
            (begun, others)
        };
        let thread = thread::Builder::new().stack_size(2 * PAINTED).spawn(calls);
        let (begun, others) = thread.unwrap().join().unwrap();
        println!("{name}: rf_init takes {begun} bytes of stack, rf_observe and rf_step {others}");
        assert!(begun > SPARED && begun < TO_BEGIN, "{name}: {begun} bytes");
        assert!(others > SPARED && others < enough, "{name}: {others} bytes");
    }
}
