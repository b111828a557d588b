//! Exported weights of unknown quality through the packer: what packs must load, or say why not.

use rigidformer_evaluation::models::pack_bytes;
use rigidformer_tests::hostile::exercise;
use rigidformer_weights::AlignedBuffer;
use std::path::Path;

/// Handles an input.
pub fn run(data: &[u8]) {
    if let Ok(packed) = pack_bytes(Path::new("fuzzed"), data) {
        exercise(&AlignedBuffer::copy_of(&packed));
    }
}
