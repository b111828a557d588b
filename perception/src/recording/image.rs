//! Images of 16-bit grey as PNG files.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Seek};
use std::path::Path;

use rigidformer_runtime::memory::Budget;

use super::error::{CaptureError, CaptureProblem};
use crate::camera::MAX_SIDE;

/// Bytes that decoding may take beyond the pixels.
// It bounds what a hostile file makes the decoder allocate.
const DECODER_BYTES: usize = 16 << 20;

/// Reads an image that must have this size. (height * width)
pub(super) fn read(path: &Path, size: [u32; 2]) -> Result<Vec<u16>, CaptureError> {
    let fail = |problem| CaptureError::of(path, problem);
    let file = File::open(path).map_err(|error| {
        fail(match error.kind() {
            std::io::ErrorKind::NotFound => CaptureProblem::Missing,
            _ => CaptureProblem::Unreadable(error),
        })
    })?;
    let check = |found: [u32; 2]| match found == size {
        true => Ok(()),
        false => Err(CaptureProblem::ImageSize { found, camera: size }),
    };
    read_checked(BufReader::new(file), most_bytes(size), check)
        .map(|(_, pixels)| pixels)
        .map_err(fail)
}

/// First bytes of a PNG file.
pub(super) const MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";

/// An image of any size up to 8192 pixels a side, its columns and rows first. (height * width)
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
    read_checked(Cursor::new(bytes), most_bytes([MAX_SIDE; 2]), check)
}

/// What decoding may take.
fn most_bytes(size: [u32; 2]) -> usize {
    let pixels = size.map(|side| side as usize).iter().product::<usize>();
    pixels.saturating_mul(2).saturating_add(DECODER_BYTES)
}

fn read_checked(
    file: impl BufRead + Seek,
    bytes: usize,
    check: impl FnOnce([u32; 2]) -> Result<(), CaptureProblem>,
) -> Result<([u32; 2], Vec<u16>), CaptureProblem> {
    let broken = |error: png::DecodingError| CaptureProblem::Png(error.to_string());
    let decoder = png::Decoder::new_with_limits(file, png::Limits { bytes });
    let mut reader = decoder.read_info().map_err(broken)?;
    let info = reader.info();
    let found = [info.width, info.height];
    let kind = (info.color_type, info.bit_depth);
    if kind != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        let found = format!("{:?} with {} bits", kind.0, kind.1 as u8);
        return Err(CaptureProblem::ImageKind { found });
    }
    check(found)?;
    // Two bytes a pixel, the high one first.
    let pixels = found.map(|side| side as usize).iter().product::<usize>();
    let mut bytes = vec![0; pixels.saturating_mul(2)];
    reader.next_frame(&mut bytes).map_err(broken)?;
    reader.finish().map_err(broken)?;
    let pixels = bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
    Ok((found, pixels.collect()))
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
