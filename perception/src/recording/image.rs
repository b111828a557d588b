//! Images of 16-bit grey as PNG files.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use super::error::{CaptureError, CaptureProblem};

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
    let broken = |error: png::DecodingError| fail(CaptureProblem::Png(error.to_string()));
    let pixels = size.map(|side| side as usize).iter().product::<usize>();
    let limits = png::Limits { bytes: pixels.saturating_mul(2).saturating_add(DECODER_BYTES) };
    let decoder = png::Decoder::new_with_limits(BufReader::new(file), limits);
    let mut reader = decoder.read_info().map_err(broken)?;
    let info = reader.info();
    let found = [info.width, info.height];
    let kind = (info.color_type, info.bit_depth);
    if kind != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        let found = format!("{:?} with {} bits", kind.0, kind.1 as u8);
        return Err(fail(CaptureProblem::ImageKind { found }));
    }
    if found != size {
        return Err(fail(CaptureProblem::ImageSize { found, camera: size }));
    }
    // Two bytes a pixel, the high one first.
    let mut bytes = vec![0; pixels.saturating_mul(2)];
    reader.next_frame(&mut bytes).map_err(broken)?;
    reader.finish().map_err(broken)?;
    Ok(bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect())
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
