//! A second static library of Rust, with a standard library of its own: rustc --crate-type staticlib other.rs
use std::panic::catch_unwind;

/// Allocates, starts a thread and catches a panic.
#[unsafe(no_mangle)]
pub extern "C" fn other_sum(count: u32) -> u32 {
    let numbers: Vec<u32> = (1..=count).collect();
    let sum = std::thread::spawn(move || numbers.iter().sum());
    std::panic::set_hook(Box::new(|_| {}));
    let caught = catch_unwind(|| panic!("caught")).is_err();
    sum.join().unwrap_or(0) + u32::from(caught)
}
