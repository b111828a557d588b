//! Files of unknown quality through the reader and the loader, and through a step where they load.

use rigidformer_tests::bits::{PRECISIONS, quantised};
use rigidformer_tests::hostile::{
    SMALLEST, SMALLEST_BONDS, SMALLEST_IMPACT, SMALLEST_NEAR, SMALLEST_SOFT, exercise,
    random_model, repair,
};
use rigidformer_weights::AlignedBuffer;
use std::sync::LazyLock;

/// Sound models in every storage, with and without impacts, of soft bodies, of bonds that break, and of what sees what is near.
static MODELS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let sources = [
        random_model(SMALLEST, 1),
        random_model(SMALLEST_IMPACT, 2),
        random_model(SMALLEST_SOFT, 3),
        random_model(SMALLEST_BONDS, 4),
        random_model(SMALLEST_NEAR, 5),
    ];
    let each = |source: &AlignedBuffer| {
        PRECISIONS.map(|(_, precision)| quantised(source, precision).to_vec())
    };
    sources.iter().flat_map(each).collect()
});

/// Handles an input.
pub fn run(data: &[u8]) {
    let Some((kind, rest)) = data.split_first() else { return };
    let kind = usize::from(*kind) % (2 + MODELS.len());
    let mut file = match kind {
        // The input is the file.
        0 | 1 => rest.to_vec(),
        // The input is a list of changes to a sound file: a place and what to write there.
        model => {
            let mut file = MODELS[model - 2].clone();
            for change in rest.chunks_exact(3) {
                // The last 32 places count from the end, where a file is cut or grows.
                let at = usize::from(u16::from_le_bytes([change[0], change[1]]));
                match at {
                    65504.. => file.truncate(file.len().saturating_sub(64 * (at - 65503))),
                    _ => {
                        let at = at % file.len().max(1);
                        if let Some(byte) = file.get_mut(at) {
                            *byte = change[2];
                        }
                    }
                }
            }
            file
        }
    };
    if kind != 0 {
        repair(&mut file);
    }
    let file = AlignedBuffer::copy_of(&file);
    exercise(&file);
}
