//! Labels as masks come: 8 bits, packed, palettes.

use std::fs;
use std::path::Path;

use png::{BitDepth, ColorType};

use super::*;
use crate::camera::Camera;
use crate::capture::{DepthView, View};

// Rows of 9 packed pixels end within a byte.
const SIZE: [u32; 2] = [9, 6];

/// The label of a pixel, of at most so many.
fn label(at: usize, count: u16) -> u16 {
    (at * 7 / 3) as u16 % count
}

/// A recording of one labelled capture.
fn recorded(path: &Path) {
    let mut recorder = Recorder::new(path, None).unwrap();
    let camera =
        Camera::new(SIZE, [7.0, 7.5], [4.0, 2.5], nalgebra::Isometry3::identity()).unwrap();
    let number = recorder.camera("c", &camera, 0.001).unwrap();
    let labels = (0..54).map(|at| label(at, 3)).collect();
    let view = DepthView::new(camera, 0.001, vec![700; 54], Some(labels)).unwrap();
    recorder.add(0.0, number, &view).unwrap();
    recorder.finish().unwrap();
}

fn labels_file(path: &Path) -> std::path::PathBuf {
    let manifest = fs::read(path.join("frames.json")).unwrap();
    let manifest: serde_json::Value = serde_json::from_slice(&manifest).unwrap();
    path.join(manifest["frames"][0]["labels"].as_str().unwrap())
}

/// A PNG file of rows of packed bytes.
fn png_of(size: [u32; 2], colours: ColorType, bits: BitDepth, bytes: &[u8]) -> Vec<u8> {
    let mut encoded = Vec::new();
    let mut encoder = png::Encoder::new(&mut encoded, size[0], size[1]);
    encoder.set_color(colours);
    encoder.set_depth(bits);
    if colours == ColorType::Indexed {
        // All of one colour: labels are indices, not colours.
        encoder.set_palette(vec![90; 3 << (bits as u8).min(8)]);
    }
    encoder.write_header().unwrap().write_image_data(bytes).unwrap();
    encoded
}

fn packed(bits: usize, label: impl Fn(usize) -> u16) -> Vec<u8> {
    let mut bytes = Vec::new();
    for row in 0..SIZE[1] as usize {
        let mut line = vec![0_u8; (SIZE[0] as usize * bits).div_ceil(8)];
        for column in 0..SIZE[0] as usize {
            let number = label(row * SIZE[0] as usize + column);
            for bit in 0..bits {
                let at = column * bits + bit;
                line[at / 8] |= ((number >> (bits - 1 - bit) & 1) as u8) << (7 - at % 8);
            }
        }
        bytes.extend(line);
    }
    bytes
}

/// The capture with this file of labels.
fn read_with(file: &[u8]) -> Result<Capture, CaptureError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording");
    recorded(&path);
    fs::write(labels_file(&path), file).unwrap();
    open(&path).unwrap().next().unwrap()
}

fn labels(capture: &Capture) -> Option<&[u16]> {
    let [View::Depth(view)] = capture.views.as_slice() else { panic!("no depth image") };
    view.labels.as_deref()
}

#[test]
fn labels_are_read_as_masks_come() {
    let kinds = [
        (ColorType::Grayscale, BitDepth::One),
        (ColorType::Grayscale, BitDepth::Two),
        (ColorType::Grayscale, BitDepth::Four),
        (ColorType::Grayscale, BitDepth::Eight),
        (ColorType::Grayscale, BitDepth::Sixteen),
        (ColorType::Indexed, BitDepth::One),
        (ColorType::Indexed, BitDepth::Two),
        (ColorType::Indexed, BitDepth::Four),
        (ColorType::Indexed, BitDepth::Eight),
    ];
    for (colours, bits) in kinds {
        let most = 1_u32 << (bits as u32);
        let most = most.min(60_000) as u16;
        // Steps of a prime reach high bits too.
        let label = |at: usize| (at * 1009 % usize::from(most)) as u16;
        let file = png_of(SIZE, colours, bits, &packed(bits as usize, label));
        let expected: Vec<u16> = (0..54).map(label).collect();
        let capture = read_with(&file).unwrap();
        assert_eq!(labels(&capture), Some(&expected[..]), "{colours:?} {bits:?}");
    }
}

#[test]
fn an_error_of_labels_is_about_labels() {
    let rgb = png_of(SIZE, ColorType::Rgb, BitDepth::Eight, &[0; 162]);
    let alpha = png_of(SIZE, ColorType::GrayscaleAlpha, BitDepth::Eight, &[0; 108]);
    let small = png_of([8, 6], ColorType::Grayscale, BitDepth::Eight, &[0; 48]);
    let whole = png_of(SIZE, ColorType::Grayscale, BitDepth::Eight, &[1; 54]);
    for (file, says) in [
        (&rgb[..], "Rgb with 8 bits"),
        (&alpha, "GrayscaleAlpha with 8 bits"),
        (&small, "8 x 6"),
        (b"GIF89a", "PNG"),
        (&whole[..whole.len() - 20], "PNG"),
    ] {
        let error = read_with(file).unwrap_err().to_string();
        assert!(error.contains("labels: ") && error.contains(says), "{error}");
        assert!(!error.contains("write depths"), "{error}");
    }
    for at in 0..whole.len() * 8 {
        let mut flipped = whole.clone();
        flipped[at / 8] ^= 1 << (at % 8);
        // Any answer but a panic will do: some bits, such as those of an ancillary chunk, mean nothing.
        let _ = read_with(&flipped);
    }
}

#[test]
fn labels_that_nobody_reads_cost_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording");
    recorded(&path);
    let file = labels_file(&path);
    fs::write(&file, b"GIF89a").unwrap();
    let without = || open(&path).unwrap().without_labels().next().unwrap().unwrap();
    assert_eq!(labels(&without()), None);
    fs::remove_file(&file).unwrap();
    assert_eq!(labels(&without()), None);
    let error = open(&path).unwrap().next().unwrap().unwrap_err();
    assert!(matches!(error.problem, CaptureProblem::Missing), "{error}");
    assert!(error.to_string().contains("labels: "), "{error}");
}
