//! Traces and tolerances of `rigidformer trace`, `diff` and `check`.

use rigidformer_firmware_sim::Tolerances;
use rigidformer_firmware_sim::trace::Recording;
use std::path::Path;

/// Handles an input.
pub fn run(data: &[u8]) {
    let Some((kind, rest)) = data.split_first() else { return };
    let name = Path::new("fuzzed");
    if kind % 4 == 0 {
        let _ = Tolerances::parse(name, rest);
        return;
    }
    // What is read is what is written.
    if let Ok(recording) = Recording::from_bytes(name, rest) {
        let again = Recording::from_bytes(name, &recording.to_bytes());
        assert!(again.is_ok_and(|again| again.to_bytes() == recording.to_bytes()));
    }
}
