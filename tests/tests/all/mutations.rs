//! Damaged quantised models are refused; crafted ones are refused or harmless. `fuzz/` goes
//! further.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use rigidformer_core::{LoadError, Model};
use rigidformer_evaluation::models::Precision;
use rigidformer_tests::bits::{PRECISIONS, quantised};
use rigidformer_tests::hostile::{
    SMALLEST, SMALLEST_BONDS, SMALLEST_IMPACT, SMALLEST_NEAR, SMALLEST_SOFT, exercise,
    random_model, repair,
};
use rigidformer_tests::{Random, packed_model};
use rigidformer_weights::{AlignedBuffer, FormatError, ModelConfig, NANO, Scales};

fn smallest(precision: Precision) -> AlignedBuffer {
    quantised(&random_model(SMALLEST, 1), precision)
}

/// The error of loading.
fn refusal(file: &[u8], what: &dyn Fn() -> String) -> LoadError {
    Model::load(file).err().unwrap_or_else(|| panic!("{} was accepted", what()))
}

fn refuses_every_truncation(file: &AlignedBuffer) {
    for length in 0..file.len() {
        let error = refusal(&file[..length], &|| format!("a cut to {length} bytes"));
        assert!(matches!(error, LoadError::Format(FormatError::Truncated { .. })), "{error}");
    }
}

fn refuses_changes(file: &AlignedBuffer, flips: impl Fn(usize) -> Vec<u8>) {
    // A writable copy, as well aligned.
    let mut memory = vec![0; file.len() + 64];
    let start = memory.as_ptr().align_offset(64);
    let copy = &mut memory[start..start + file.len()];
    copy.copy_from_slice(file);
    for at in 0..file.len() {
        for flip in flips(at) {
            copy[at] ^= flip;
            refusal(copy, &|| format!("byte {at} changed by {flip:#04x}"));
            copy[at] ^= flip;
        }
    }
    assert!(Model::load(copy).is_ok());
}

#[test]
fn every_truncation_is_refused() {
    refuses_every_truncation(&smallest(Precision::I8));
    refuses_every_truncation(&quantised(&random_model(SMALLEST_SOFT, 1), Precision::I8));
    refuses_every_truncation(&quantised(&random_model(SMALLEST_BONDS, 1), Precision::I8));
    refuses_every_truncation(&quantised(&random_model(SMALLEST_NEAR, 1), Precision::I8));
    refuses_every_truncation(&quantised(&packed_model("tiny"), Precision::I8));
}

#[test]
fn every_bit_of_a_quantised_file_matters() {
    let file = smallest(Precision::I8);
    println!("{} bytes", file.len());
    let flips = |_| (0..8).map(|bit| 1 << bit).chain([0xff]).collect();
    refuses_changes(&file, flips);
    refuses_changes(&quantised(&random_model(SMALLEST_SOFT, 1), Precision::I8), flips);
}

/// A seeded change of a byte.
fn one(at: usize) -> Vec<u8> {
    vec![1 + (Random(at as u64).bits() % 255) as u8]
}

/// A larger model: every byte of the prefix and the header, every 32nd of the payload.
#[test]
fn bytes_of_a_larger_file_matter() {
    let file = quantised(&packed_model("tiny"), Precision::I8);
    let header = 64 + u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    let some = |at| if at < header || at % 32 == 0 { one(at) } else { vec![] };
    refuses_changes(&file, some);
}

#[test]
#[ignore = "takes minutes; a CRC-32 finds any change within 32 bits, and every bit is changed above"]
fn every_byte_of_a_larger_file_matters() {
    refuses_changes(&quantised(&packed_model("tiny"), Precision::I8), one);
    refuses_changes(&smallest(Precision::I8), |_| (1..=255).collect());
}

/// A change of a CRC-32 (reflected, 0xEDB88320) after one more byte. A CRC is linear: what changes
/// of several bits do together is the xor of what each does.
fn zero_byte(state: u32) -> u32 {
    (0..8).fold(state, |s, _| (s >> 1) ^ if s & 1 == 1 { 0xedb8_8320 } else { 0 })
}

/// A file of the size of the nano model: every cut, and all 255 changes of every byte. The
/// payload's are too many to load one by one (78 million), so the checksum is shown to change
/// with each of them, and a sample is loaded to show that the reader compares it.
#[test]
fn every_change_of_a_byte_of_nano_is_refused() {
    let file = AlignedBuffer::copy_of(NANO);
    refuses_every_truncation(&file);
    let header = 64 + u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    refuses_changes(&file, |at| match at {
        0..64 => (1..=255).collect(),
        _ if at < header || at % 4096 == 0 => one(at),
        _ => vec![],
    });
    let mut bits: [u32; 8] = std::array::from_fn(|bit| zero_byte(1 << bit));
    for at in (64..file.len()).rev() {
        for change in 1_usize..256 {
            let chosen = (0..8).filter(|bit| change >> bit & 1 == 1).map(|bit| bits[bit]);
            assert_ne!(chosen.fold(0, |sum, bit| sum ^ bit), 0, "byte {at} changed by {change}");
        }
        bits = bits.map(zero_byte);
    }
}

/// Changes behind checksums that fit: whatever still loads must run.
#[test]
fn crafted_files_never_panic() {
    let configs = [SMALLEST, SMALLEST_IMPACT, SMALLEST_SOFT, SMALLEST_BONDS];
    let sources = configs.map(|config| random_model(config, 1));
    let each = |source| PRECISIONS.map(|(_, precision)| quantised(source, precision));
    let models: Vec<AlignedBuffer> = sources.iter().flat_map(|source| each(source)).collect();
    let mut random = Random(5);
    let (mut loaded, mut refused) = (0, 0);
    for round in 0..30_000 {
        let sound = &models[round % models.len()];
        let mut file = sound.to_vec();
        for _ in 0..1 + random.bits() % 6 {
            // Half of the changes in the prefix and the header, which steer everything.
            let header = 64 + u32::from_le_bytes(sound[12..16].try_into().unwrap()) as usize;
            let range = if random.bits() & 1 == 0 { header } else { sound.len() };
            let at = (random.bits() % range as u64) as usize;
            if let Some(byte) = file.get_mut(at) {
                *byte = match random.bits() % 4 {
                    0 => 0,
                    1 => 0xff,
                    2 => *byte ^ (1 << (random.bits() % 8)),
                    _ => random.bits() as u8,
                };
            }
            if random.bits().is_multiple_of(64) {
                file.truncate((random.bits() % sound.len() as u64) as usize);
            }
        }
        repair(&mut file);
        match exercise(&AlignedBuffer::copy_of(&file)) {
            true => loaded += 1,
            false => refused += 1,
        }
    }
    println!("{loaded} loaded and ran, {refused} were refused");
    assert!(loaded > 1000 && refused > 1000);
}

/// A layer over the heads of eight scales is the widest there is: its int8 products must add up
/// within an i32, so heads x head_dim has a limit.
#[test]
fn no_layer_is_too_wide_for_its_accumulator() {
    let config =
        ModelConfig { heads: 256, head_dim: 1024, blocks: 8, scales: Scales(0xff), ..SMALLEST };
    assert!(config.validate().is_err());
    let widest = ModelConfig { heads: 16, ..config };
    assert!(widest.validate().is_ok());
    let inputs = i64::from(widest.heads) * i64::from(widest.head_dim) * 8;
    assert!(inputs * 127 * 128 < i64::from(i32::MAX));
}
