//! Messages that are read from MCAP files, in the encodings in which they come.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Deserializer};

use rigidformer_runtime::memory::Budget;

use super::cdr::Cdr;
use super::error::CaptureProblem;
use super::numbers::{self, Kind, Number};
use super::points::{MAX_POINTS, Read, count, shortened};
use super::straight::{Lens, Model};
use crate::camera::{Camera, MAX_SIDE};

/// Metres a step of depths, from images of 32-bit numbers and of 16 bits.
pub(super) const SCALE_M: f32 = 0.001;
/// Largest coordinate of a pose.
// Beyond, single precision resolves less than .06 m.
const MAX_POSITION_M: f64 = 1e6;

/// An instant since 1970.
#[derive(Clone, Copy, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
pub(super) struct Timestamp {
    #[prost(int64, tag = "1")]
    #[serde(rename = "sec")]
    seconds: i64,
    #[prost(int32, tag = "2")]
    #[serde(rename = "nsec")]
    nanos: i32,
}

#[derive(Clone, Copy, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
struct Vector {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
}

#[derive(Clone, Copy, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
struct Orientation {
    #[prost(double, tag = "1")]
    x: f64,
    #[prost(double, tag = "2")]
    y: f64,
    #[prost(double, tag = "3")]
    z: f64,
    #[prost(double, tag = "4")]
    w: f64,
}

#[derive(Clone, Copy, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
struct Pose {
    #[prost(message, optional, tag = "1")]
    position: Option<Vector>,
    #[prost(message, optional, tag = "2")]
    orientation: Option<Orientation>,
}

#[derive(Clone, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
struct Packed {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(fixed32, tag = "2")]
    offset: u32,
    #[prost(int32, tag = "3")]
    #[serde(rename = "type")]
    kind: i32,
}

/// `foxglove.PointCloud`
#[derive(Clone, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
pub(super) struct PointCloud {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(message, optional, tag = "3")]
    pose: Option<Pose>,
    #[prost(fixed32, tag = "4")]
    point_stride: u32,
    #[prost(message, repeated, tag = "5")]
    fields: Vec<Packed>,
    #[prost(bytes = "vec", tag = "6")]
    #[serde(deserialize_with = "base64")]
    data: Vec<u8>,
}

/// `foxglove.RawImage`
#[derive(Clone, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
pub(super) struct RawImage {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(fixed32, tag = "2")]
    width: u32,
    #[prost(fixed32, tag = "3")]
    height: u32,
    #[prost(string, tag = "4")]
    encoding: String,
    #[prost(fixed32, tag = "5")]
    step: u32,
    #[prost(bytes = "vec", tag = "6")]
    #[serde(deserialize_with = "base64")]
    data: Vec<u8>,
    #[prost(string, tag = "7")]
    pub(super) frame_id: String,
}

/// `foxglove.CameraCalibration`
#[derive(Clone, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
pub(super) struct CameraCalibration {
    #[prost(fixed32, tag = "2")]
    width: u32,
    #[prost(fixed32, tag = "3")]
    height: u32,
    #[prost(string, tag = "4")]
    distortion_model: String,
    #[prost(double, repeated, tag = "5")]
    #[serde(rename = "D")]
    d: Vec<f64>,
    #[prost(double, repeated, tag = "6")]
    #[serde(rename = "K")]
    k: Vec<f64>,
    #[prost(string, tag = "9")]
    pub(super) frame_id: String,
}

/// `foxglove.FrameTransform`
#[derive(Clone, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
pub(super) struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    parent_frame_id: String,
    #[prost(string, tag = "3")]
    child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    translation: Option<Vector>,
    #[prost(message, optional, tag = "5")]
    rotation: Option<Orientation>,
}

/// `foxglove.FrameTransforms`
#[derive(Clone, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
pub(super) struct FrameTransforms {
    #[prost(message, repeated, tag = "1")]
    transforms: Vec<FrameTransform>,
}

/// `foxglove.PoseInFrame`
#[derive(Clone, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
pub(super) struct PoseInFrame {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(message, optional, tag = "3")]
    pose: Option<Pose>,
}

/// Pose of a frame in another.
pub(super) struct Transform {
    /// Nanoseconds since 1970, where the message says so.
    pub(super) time: Option<i128>,
    pub(super) parent: String,
    /// None where the message has no child frame: its topic names it.
    pub(super) child: Option<String>,
    /// Carries the child's frame to the parent's.
    pub(super) pose: Isometry3<f64>,
}

/// The type's name without what ROS 2 put into it: `sensor_msgs/Image`.
pub(super) fn plain_name(schema: &str) -> String {
    schema.replacen("/msg/", "/", 1)
}

/// Whether messages of this type are transforms, and no poses of objects.
pub(super) fn is_transform(schema: &str) -> bool {
    matches!(
        plain_name(schema).as_str(),
        "foxglove.FrameTransform"
            | "foxglove.FrameTransforms"
            | "geometry_msgs/TransformStamped"
            | "tf2_msgs/TFMessage"
            | "tf/tfMessage"
    )
}

/// The transforms or the pose of a message; none where it is of another type.
pub(super) fn transforms(
    encoding: &str,
    schema: &str,
    data: &[u8],
) -> Result<Option<Vec<Transform>>, CaptureProblem> {
    let name = plain_name(schema);
    let found = match name.as_str() {
        "foxglove.FrameTransform" => {
            vec![decode::<FrameTransform>(encoding, schema, data)?.transform()?]
        }
        "foxglove.FrameTransforms" => decode::<FrameTransforms>(encoding, schema, data)?
            .transforms
            .into_iter()
            .map(FrameTransform::transform)
            .collect::<Result<_, _>>()?,
        "foxglove.PoseInFrame" => {
            let read: PoseInFrame = decode(encoding, schema, data)?;
            let pose = read.pose.unwrap_or_default();
            vec![Transform {
                time: read.timestamp.map(|stamp| stamp.nanoseconds()),
                parent: read.frame_id,
                child: None,
                pose: isometry(pose.position, pose.orientation)?,
            }]
        }
        "geometry_msgs/PoseStamped"
        | "geometry_msgs/TransformStamped"
        | "tf2_msgs/TFMessage"
        | "tf/tfMessage" => {
            let mut cdr = Cdr::of(encoding, schema, data)?;
            let count = if name.starts_with("tf") { cdr.word()? } else { 1 };
            let is_pose = name == "geometry_msgs/PoseStamped";
            // No capacity by the claimed count: a hostile one would exhaust memory.
            let mut found = Vec::new();
            for _ in 0..count {
                found.push(transform(&mut cdr, is_pose)?);
            }
            found
        }
        _ => return Ok(None),
    };
    if found.iter().any(|one| one.child.as_deref() == Some("")) {
        return Err(CaptureProblem::NoChild);
    }
    Ok(Some(found))
}

/// A `TransformStamped`, or a `PoseStamped`, which names no frame of its own.
fn transform(cdr: &mut Cdr<'_>, is_pose: bool) -> Result<Transform, CaptureProblem> {
    let header = cdr.header()?;
    let child = if is_pose { None } else { Some(cdr.string()?) };
    let [x, y, z, i, j, k, w] = cdr.doubles()?;
    let turn = Orientation { x: i, y: j, z: k, w };
    let pose = isometry(Some(Vector { x, y, z }), Some(turn))?;
    Ok(Transform { time: Some(header.time), parent: header.frame, child, pose })
}

/// What a message of foxglove.dev's begins with.
#[derive(Clone, Copy, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
struct Stamped {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
}

/// Frame of a `foxglove.PointCloud`, without its points.
#[derive(Clone, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
pub(super) struct Framed {
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
}

/// Frame and pixels of a `foxglove.RawImage`, without its data.
#[derive(Clone, PartialEq, prost::Message, Deserialize)]
#[serde(default)]
pub(super) struct ImageKind {
    #[prost(string, tag = "4")]
    pub(super) encoding: String,
    #[prost(string, tag = "7")]
    pub(super) frame_id: String,
}

/// A message's stamp, nanoseconds since 1970, without the rest of it; none where it has none.
pub(super) fn stamp(
    encoding: &str,
    schema: &str,
    data: &[u8],
) -> Result<Option<i128>, CaptureProblem> {
    if schema.starts_with("foxglove.") {
        let read: Stamped = decode(encoding, schema, data)?;
        return Ok(read.timestamp.map(|stamp| stamp.nanoseconds()));
    }
    Cdr::of(encoding, schema, data)?.stamp().map(Some)
}

fn base64<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<u8>, D::Error> {
    let text = String::deserialize(from)?;
    STANDARD.decode(text).map_err(serde::de::Error::custom)
}

impl Timestamp {
    /// Nanoseconds since 1970.
    pub(super) fn nanoseconds(&self) -> i128 {
        i128::from(self.seconds) * 1_000_000_000 + i128::from(self.nanos)
    }
}

/// A message of a type that can be decoded from JSON and from protobuf.
pub(super) fn decode<M>(encoding: &str, schema: &str, data: &[u8]) -> Result<M, CaptureProblem>
where
    M: prost::Message + Default + for<'de> Deserialize<'de>,
{
    let broken = |why: String| CaptureProblem::Message(shortened(why));
    match encoding {
        "json" => serde_json::from_slice(data).map_err(|error| broken(error.to_string())),
        "protobuf" => M::decode(data).map_err(|error| broken(error.to_string())),
        _ => Err(CaptureProblem::Encoding { schema: schema.into(), encoding: encoding.into() }),
    }
}

fn isometry(
    position: Option<Vector>,
    turn: Option<Orientation>,
) -> Result<Isometry3<f64>, CaptureProblem> {
    let position = position.unwrap_or_default();
    let turn = turn.unwrap_or(Orientation { w: 1.0, ..Orientation::default() });
    let numbers = [position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z];
    if !numbers.iter().all(|number| number.is_finite()) {
        return Err(CaptureProblem::Pose("has a number that is not finite"));
    }
    if [position.x, position.y, position.z].iter().any(|metres| metres.abs() > MAX_POSITION_M) {
        return Err(CaptureProblem::Far);
    }
    let rotation = Quaternion::new(turn.w, turn.x, turn.y, turn.z);
    // Writers without an orientation leave zeros.
    let rotation = match rotation.norm() {
        0.0 => UnitQuaternion::identity(),
        length if (length - 1.0).abs() < 1e-3 => UnitQuaternion::new_normalize(rotation),
        _ => return Err(CaptureProblem::Pose("has a quaternion whose length is not 1")),
    };
    let position = Translation3::new(position.x, position.y, position.z);
    Ok(Isometry3::from_parts(position, rotation))
}

impl FrameTransform {
    fn transform(self) -> Result<Transform, CaptureProblem> {
        Ok(Transform {
            time: self.timestamp.map(|stamp| stamp.nanoseconds()),
            pose: isometry(self.translation, self.rotation)?,
            parent: self.parent_frame_id,
            child: Some(self.child_frame_id),
        })
    }
}

impl CameraCalibration {
    /// In its own frame.
    pub(super) fn lens(&self) -> Result<Lens, CaptureProblem> {
        let model = Model::of(&self.distortion_model, &self.d)?;
        let [fx, _, cx, _, fy, cy, ..] = *self.k.as_slice() else {
            let why = format!("K has {} numbers, not 9", self.k.len());
            return Err(CaptureProblem::Message(why));
        };
        let (focal, centre) = ([fx as f32, fy as f32], [cx as f32, cy as f32]);
        let here = Isometry3::identity();
        let camera = Camera::new([self.width, self.height], focal, centre, here)?;
        Ok(Lens { camera, model })
    }
}

/// An image of depths as it was packed.
pub(super) struct Raw<'d> {
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) step: u32,
    pub(super) encoding: &'d str,
    pub(super) is_big: bool,
    pub(super) data: &'d [u8],
}

/// Depths in millimetres.
pub(super) struct Steps {
    /// Columns and rows.
    pub(super) size: [u32; 2],
    /// (height * width)
    pub(super) depths: Vec<u16>,
}

/// Millimetres of a depth. NaN, and depths beyond 16 bits, count as not measured.
pub(super) fn of_metres(depth_m: f64) -> u16 {
    let steps = (depth_m / f64::from(SCALE_M)).round();
    if (1.0..=65535.0).contains(&steps) { steps as u16 } else { 0 }
}

impl RawImage {
    pub(super) fn steps(&self) -> Result<Steps, CaptureProblem> {
        let RawImage { width, height, step, encoding, data, .. } = self;
        Raw { width: *width, height: *height, step: *step, encoding, is_big: false, data }.steps()
    }
}

impl Raw<'_> {
    pub(super) fn steps(&self) -> Result<Steps, CaptureProblem> {
        let broken = |why: &str| CaptureProblem::Message(why.into());
        if self.width > MAX_SIDE || self.height > MAX_SIDE {
            return Err(broken("its image has more than 8192 pixels a side"));
        }
        let [width, height, step] = [self.width, self.height, self.step].map(|side| side as usize);
        let (kind, size) = match self.encoding {
            "32FC1" => (Kind::Float, 4),
            "16UC1" | "mono16" => (Kind::Unsigned, 2),
            other => {
                return Err(CaptureProblem::Message(shortened(format!(
                    "its pixels are {other:?}"
                ))));
            }
        };
        let row = width * size;
        if row == 0 || height == 0 || step < row || self.data.len() < step * (height - 1) + row {
            return Err(broken("its data are too short for its width, height and step"));
        }
        let rows = self.data.chunks(step).take(height).filter_map(|bytes| bytes.get(..row));
        let number = Number::new(kind, size).ok_or_else(|| broken("its encoding is unknown"))?;
        let number = if self.is_big { number.big() } else { number };
        let depth = |bytes: &[u8]| match kind {
            Kind::Float => of_metres(number.read(bytes, 0)),
            _ => number.read(bytes, 0) as u16,
        };
        let depths = rows.flat_map(|row| row.chunks_exact(size)).map(depth).collect();
        Ok(Steps { size: [self.width, self.height], depths })
    }
}

/// A field of a point: where it starts among the point's bytes.
pub(super) struct Field {
    pub(super) name: String,
    pub(super) offset: usize,
    pub(super) number: Option<Number>,
}

impl PointCloud {
    /// Points in its frame, and whether they are labelled.
    pub(super) fn points(&self, budget: &mut Budget) -> Result<(Vec<Read>, bool), CaptureProblem> {
        let number = |kind| match kind {
            1 => Number::new(Kind::Unsigned, 1),
            2 => Number::new(Kind::Signed, 1),
            3 => Number::new(Kind::Unsigned, 2),
            4 => Number::new(Kind::Signed, 2),
            5 => Number::new(Kind::Unsigned, 4),
            6 => Number::new(Kind::Signed, 4),
            7 => Number::new(Kind::Float, 4),
            8 => Number::new(Kind::Float, 8),
            _ => None,
        };
        let fields = self.fields.iter().map(|field| Field {
            name: field.name.clone(),
            offset: field.offset as usize,
            number: number(field.kind),
        });
        let fields: Vec<_> = fields.collect();
        unpack(&fields, self.point_stride as usize, &self.data, budget)
    }

    /// From the points' frame to that of the message.
    pub(super) fn pose(&self) -> Result<Isometry3<f64>, CaptureProblem> {
        let pose = self.pose.unwrap_or_default();
        isometry(pose.position, pose.orientation)
    }
}

/// Points of packed fields, one after another, and whether they are labelled.
pub(super) fn unpack(
    fields: &[Field],
    stride: usize,
    data: &[u8],
    budget: &mut Budget,
) -> Result<(Vec<Read>, bool), CaptureProblem> {
    let broken = |why: &str| CaptureProblem::Message(why.into());
    if data.is_empty() {
        return Ok((Vec::new(), false));
    }
    if stride == 0 || !data.len().is_multiple_of(stride) {
        return Err(broken("its data are not a whole number of points"));
    }
    let points = (data.len() / stride) as u64;
    if points > MAX_POINTS {
        return Err(CaptureProblem::TooManyPoints { points, most: MAX_POINTS });
    }
    count(budget, points as usize)?;
    let find = |name: &str| {
        let field = fields.iter().find(|field| field.name == name)?;
        let number = field.number?;
        let end = field.offset.checked_add(number.size())?;
        (end <= stride).then_some((number, field.offset))
    };
    let (Some(x), Some(y), Some(z)) = (find("x"), find("y"), find("z")) else {
        return Err(CaptureProblem::NoCoordinates);
    };
    let label = find("label");
    let points = data.chunks_exact(stride).map(|point| {
        let at = |(number, offset): (Number, usize)| number.read(point, offset);
        (Point3::new(at(x), at(y), at(z)), label.map_or(0, |field| numbers::label(at(field))))
    });
    Ok((points.collect(), label.is_some()))
}
