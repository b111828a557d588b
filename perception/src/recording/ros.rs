//! Messages of ROS 1 and 2 that sensors give: clouds, depth images and calibrations.

use nalgebra::Isometry3;
use rigidformer_runtime::memory::Budget;

use super::cdr::Cdr;
use super::error::CaptureProblem;
use super::image::{self, MAGIC};
use super::messages::{Field, Raw, Steps, of_metres, unpack};
use super::numbers::{Kind, Number};
use super::points::Read;
use super::straight::{Lens, Model};
use crate::camera::Camera;

/// Fields of a cloud, and numbers of a distortion, at most.
// They bound the time of a hostile message.
const MAX_FIELDS: u32 = 256;
const MAX_COEFFICIENTS: u32 = 32;
/// Bytes before the PNG file of `compressedDepth`: a number, and two that spread inverse depths.
const DEPTH_HEAD: usize = 12;

/// Points of a `PointCloud2`, and whether they are labelled.
pub(super) fn cloud(
    encoding: &str,
    schema: &str,
    data: &[u8],
    budget: &mut Budget,
) -> Result<(String, Vec<Read>, bool), CaptureProblem> {
    let broken = |why: &str| CaptureProblem::Message(why.into());
    let mut cdr = Cdr::of(encoding, schema, data)?;
    let frame = cdr.header()?.frame;
    let (height, width) = (cdr.word()? as usize, cdr.word()? as usize);
    let count = cdr.word()?;
    if count > MAX_FIELDS {
        return Err(broken("it has more than 256 fields"));
    }
    let mut fields = Vec::new();
    for _ in 0..count {
        fields.push(field(&mut cdr)?);
    }
    let is_big = cdr.byte()? != 0;
    let stride = cdr.word()? as usize;
    let row = cdr.word()? as usize;
    let data = cdr.bytes()?;
    let of_row = width.checked_mul(stride).filter(|of_row| *of_row <= row);
    let of_row = of_row.ok_or_else(|| broken("its rows are shorter than its points"))?;
    if row.checked_mul(height) != Some(data.len()) {
        return Err(broken("its data are not as long as its rows"));
    }
    if is_big {
        fields.iter_mut().for_each(|field| field.number = field.number.map(Number::big));
    }
    // Rows may have padding behind their points.
    let (points, is_labelled) = match row == of_row || row == 0 {
        true => unpack(&fields, stride, data, budget)?,
        false => {
            let rows = data.chunks(row).filter_map(|bytes| bytes.get(..of_row));
            let packed: Vec<u8> = rows.flatten().copied().collect();
            unpack(&fields, stride, &packed, budget)?
        }
    };
    Ok((frame, points, is_labelled))
}

fn field(cdr: &mut Cdr<'_>) -> Result<Field, CaptureProblem> {
    let (name, offset, kind) = (cdr.string()?, cdr.word()? as usize, cdr.byte()?);
    // The count of numbers: only the first is read.
    let count = cdr.word()?;
    let number = match kind {
        _ if count == 0 => None,
        1 => Number::new(Kind::Signed, 1),
        2 => Number::new(Kind::Unsigned, 1),
        3 => Number::new(Kind::Signed, 2),
        4 => Number::new(Kind::Unsigned, 2),
        5 => Number::new(Kind::Signed, 4),
        6 => Number::new(Kind::Unsigned, 4),
        7 => Number::new(Kind::Float, 4),
        8 => Number::new(Kind::Float, 8),
        _ => None,
    };
    Ok(Field { name, offset, number })
}

/// Frame of a message with a header.
pub(super) fn frame(encoding: &str, schema: &str, data: &[u8]) -> Result<String, CaptureProblem> {
    Ok(Cdr::of(encoding, schema, data)?.header()?.frame)
}

/// Frame and encoding of an `Image` or a `CompressedImage`; all that is read of one before it is known to be wanted.
pub(super) fn image_kind(
    encoding: &str,
    schema: &str,
    data: &[u8],
) -> Result<(String, String), CaptureProblem> {
    let mut cdr = Cdr::of(encoding, schema, data)?;
    let frame = cdr.header()?.frame;
    if !schema.ends_with("CompressedImage") {
        cdr.word()?;
        cdr.word()?;
    }
    Ok((frame, cdr.string()?))
}

/// Depths of an `Image`.
pub(super) fn image(
    encoding: &str,
    schema: &str,
    data: &[u8],
) -> Result<(String, Steps), CaptureProblem> {
    let mut cdr = Cdr::of(encoding, schema, data)?;
    let frame = cdr.header()?.frame;
    let (height, width) = (cdr.word()?, cdr.word()?);
    let encoding = cdr.string()?;
    let is_big = cdr.byte()? != 0;
    let step = cdr.word()?;
    let data = cdr.bytes()?;
    let raw = Raw { width, height, step, encoding: &encoding, is_big, data };
    Ok((frame, raw.steps()?))
}

/// Depths of a `CompressedImage`: of the transport `compressedDepth`, or a 16-bit PNG file.
pub(super) fn compressed(
    encoding: &str,
    schema: &str,
    data: &[u8],
    budget: &mut Budget,
) -> Result<(String, Steps), CaptureProblem> {
    let broken = |why: &str| CaptureProblem::Message(why.into());
    let mut cdr = Cdr::of(encoding, schema, data)?;
    let frame = cdr.header()?.frame;
    let format = cdr.string()?;
    let data = cdr.bytes()?;
    if data.starts_with(MAGIC) {
        let (size, depths) = image::decode(data, budget)?;
        return Ok((frame, Steps { size, depths }));
    }
    let (head, png) = data.split_at_checked(DEPTH_HEAD).ok_or_else(|| broken("it ends early"))?;
    if !png.starts_with(MAGIC) {
        return Err(broken("its depths are packed otherwise than as PNG"));
    }
    let (size, mut depths) = image::decode(png, budget)?;
    if format.starts_with("32FC1") {
        let float = Number::new(Kind::Float, 4).ok_or_else(|| broken("numbers"))?;
        let (a, b) = (float.read(head, 4), float.read(head, 8));
        for depth in &mut depths {
            *depth = match *depth {
                0 => 0,
                // The inverse of the depth, spread over 16 bits.
                inverse => of_metres(a / (f64::from(inverse) - b)),
            };
        }
    }
    Ok((frame, Steps { size, depths }))
}

/// Whether an encoding, or a format of a `CompressedImage`, may be that of depths.
pub(super) fn is_depth(encoding: &str, topic: &str) -> bool {
    let kind = encoding.split(';').next().unwrap_or_default().trim();
    let is_packed =
        !encoding.contains(';') || encoding.contains("compressedDepth") || encoding.contains("png");
    // Infrared images have 16 bits as well.
    let is_other = || {
        let small = topic.to_ascii_lowercase();
        let parts = small.split('/');
        ["infra", "ir", "amplitude", "confidence", "intensity", "reflec"].iter().any(|other| {
            parts.clone().any(|part| part == *other || other.len() > 2 && part.contains(other))
        })
    };
    match kind {
        "16UC1" | "32FC1" => is_packed && !is_other(),
        "mono16" => is_packed && !is_other(),
        _ => false,
    }
}

/// The camera of a `CameraInfo` in its own frame, and what its lens does; `is_rectified` where it is asked for images without distortion.
pub(super) fn calibration(
    encoding: &str,
    schema: &str,
    data: &[u8],
    is_rectified: bool,
) -> Result<(String, Lens), CaptureProblem> {
    let mut cdr = Cdr::of(encoding, schema, data)?;
    let frame = cdr.header()?.frame;
    let (height, width) = (cdr.word()?, cdr.word()?);
    let model = cdr.string()?;
    let count = cdr.word()?;
    if count > MAX_COEFFICIENTS {
        return Err(CaptureProblem::Message("it has more than 32 coefficients".into()));
    }
    let mut d = Vec::new();
    for _ in 0..count {
        d.push(cdr.double()?);
    }
    let k: [f64; 9] = cdr.doubles()?;
    let _r: [f64; 9] = cdr.doubles()?;
    let p: [f64; 12] = cdr.doubles()?;
    let [fx, _, cx, _, _, fy, cy, ..] = p;
    let is_projected = is_rectified && fx > 0.0 && fy > 0.0;
    let [fx, cx, fy, cy] = match is_projected {
        true => [fx, cx, fy, cy],
        false => [k[0], k[2], k[4], k[5]],
    };
    let model = if is_projected { None } else { Model::of(&model, &d)? };
    let camera = Camera::new(
        [width, height],
        [fx as f32, fy as f32],
        [cx as f32, cy as f32],
        Isometry3::identity(),
    )?;
    Ok((frame, Lens { camera, model }))
}

/// What an `Imu` says: its frame, and the acceleration that it measures, m/s^2: at rest, upwards.
pub(super) fn acceleration(
    encoding: &str,
    schema: &str,
    data: &[u8],
) -> Result<(String, [f64; 3]), CaptureProblem> {
    let mut cdr = Cdr::of(encoding, schema, data)?;
    let frame = cdr.header()?.frame;
    // Orientation and its covariance, angular velocity and its covariance.
    let _: [f64; 4 + 9 + 3 + 9] = cdr.doubles()?;
    Ok((frame, cdr.doubles()?))
}
