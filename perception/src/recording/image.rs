//! Depths and labels as PNG files.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::Path;

use png::{BitDepth, ColorType};
use rigidformer_runtime::memory::Budget;

use super::error::{CaptureError, CaptureProblem};
use crate::camera::MAX_SIDE;

/// Bytes that decoding may take beyond the pixels.
// It bounds what a hostile file makes the decoder allocate.
const DECODER_BYTES: usize = 16 << 20;

/// Reads depths, 16-bit grey, that must have this size. (height * width)
pub(super) fn read(path: &Path, size: [u32; 2]) -> Result<Vec<u16>, CaptureError> {
    let kind_problem = |found| CaptureProblem::ImageKind { found };
    decoded(path, size, is_depth, kind_problem).map_err(|problem| CaptureError::of(path, problem))
}

/// Reads labels that must have this size: grey of 1 to 16 bits, or the indices of a palette. (height * width)
///
/// An error's place says that it is about labels.
pub(super) fn read_labels(path: &Path, size: [u32; 2]) -> Result<Vec<u16>, CaptureError> {
    let is_label = |(colours, _)| matches!(colours, ColorType::Grayscale | ColorType::Indexed);
    let kind_problem = |found| CaptureProblem::LabelKind { found };
    decoded(path, size, is_label, kind_problem)
        .map_err(|problem| CaptureError::at(path, "labels", problem))
}

fn decoded(
    path: &Path,
    size: [u32; 2],
    is_read: impl Fn((ColorType, BitDepth)) -> bool,
    kind_problem: impl Fn(String) -> CaptureProblem,
) -> Result<Vec<u16>, CaptureProblem> {
    let file = File::open(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => CaptureProblem::Missing,
        _ => CaptureProblem::Unreadable(error),
    })?;
    let check = |found: [u32; 2]| match found == size {
        true => Ok(()),
        false => Err(CaptureProblem::ImageSize { found, camera: size }),
    };
    read_checked(BufReader::new(file), most_bytes(size), is_read, kind_problem, check)
        .map(|(_, pixels)| pixels)
}

/// First bytes of a PNG file.
pub(super) const MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";

/// An image of depths of any size up to 8192 pixels a side, its columns and rows first. (height * width)
pub(super) fn decode(
    bytes: &[u8],
    budget: &mut Budget,
) -> Result<([u32; 2], Vec<u16>), CaptureProblem> {
    let check = |[width, height]: [u32; 2]| {
        if width > MAX_SIDE || height > MAX_SIDE {
            return Err(CaptureProblem::Png("it has more than 8192 pixels a side".into()));
        }
        // Its bytes and its numbers.
        Ok(budget.take(u64::from(width) * u64::from(height) * 4)?)
    };
    let kind_problem = |found| CaptureProblem::ImageKind { found };
    read_checked(Cursor::new(bytes), most_bytes([MAX_SIDE; 2]), is_depth, kind_problem, check)
}

/// What decoding may take.
fn most_bytes(size: [u32; 2]) -> usize {
    let pixels = size.map(|side| side as usize).iter().product::<usize>();
    pixels.saturating_mul(2).saturating_add(DECODER_BYTES)
}

fn is_depth(kind: (ColorType, BitDepth)) -> bool {
    kind == (ColorType::Grayscale, BitDepth::Sixteen)
}

fn read_checked(
    file: impl BufRead + Seek,
    bytes: usize,
    is_read: impl Fn((ColorType, BitDepth)) -> bool,
    kind_problem: impl Fn(String) -> CaptureProblem,
    check: impl FnOnce([u32; 2]) -> Result<(), CaptureProblem>,
) -> Result<([u32; 2], Vec<u16>), CaptureProblem> {
    let broken = |error: png::DecodingError| CaptureProblem::Png(error.to_string());
    let mut decoder = png::Decoder::new_with_limits(file, png::Limits { bytes });
    // A palette's colours would hide its indices, which are the labels.
    decoder.set_transformations(png::Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(broken)?;
    let info = reader.info();
    let found = [info.width, info.height];
    let (colours, bits) = (info.color_type, info.bit_depth);
    if !is_read((colours, bits)) {
        return Err(kind_problem(format!("{colours:?} with {} bits", bits as u8)));
    }
    check(found)?;
    let [width, height] = found.map(|side| side as usize);
    // Rows of less than a byte a pixel end with a whole byte.
    let row_bytes = width.saturating_mul(usize::from(bits as u8)).div_ceil(8);
    let mut bytes = vec![0; row_bytes.saturating_mul(height)];
    reader.next_frame(&mut bytes).map_err(broken)?;
    reader.finish().map_err(broken)?;
    let rows = bytes.chunks_exact(row_bytes.max(1));
    Ok((found, rows.flat_map(|row| numbers(row, bits, width)).collect()))
}

/// The numbers of a row's pixels; the first is in the high bits, and the high byte comes first.
fn numbers(row: &[u8], bits: BitDepth, width: usize) -> impl Iterator<Item = u16> {
    let bits = usize::from(bits as u8);
    (0..width).map(move |pixel| {
        let at = pixel * bits;
        let byte = |at: usize| row.get(at / 8).copied().map_or(0, u16::from);
        if bits == 16 {
            return byte(at) << 8 | byte(at + 8);
        }
        byte(at) >> (8 - bits - at % 8) & ((1 << bits) - 1)
    })
}

/// An image as a PNG file. (height * width)
pub(super) fn encode(pixels: &[u16], [width, height]: [u32; 2]) -> Result<Vec<u8>, CaptureProblem> {
    let failed = |error: png::EncodingError| {
        CaptureProblem::Unwritable(std::io::Error::other(error.to_string()))
    };
    let bytes: Vec<u8> = pixels.iter().flat_map(|pixel| pixel.to_be_bytes()).collect();
    let mut encoded = Vec::new();
    let mut encoder = png::Encoder::new(&mut encoded, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(&bytes).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(encoded)
}
