//! Messages that are read from MCAP files, in the encodings in which they come.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Deserializer};

use super::error::CaptureProblem;
use super::numbers::{Kind, Number};
use super::points::{MAX_POINTS, points_of, shortened};
use crate::camera::{Camera, MAX_SIDE};
use crate::capture::Cloud;

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

/// Whether messages of this type are transforms, and no poses of objects.
pub(super) fn is_transform(schema: &str) -> bool {
    matches!(
        schema,
        "foxglove.FrameTransform"
            | "foxglove.FrameTransforms"
            | "geometry_msgs/msg/TransformStamped"
            | "tf2_msgs/msg/TFMessage"
    )
}

/// The transforms or the pose of a message; none where it is of another type.
pub(super) fn transforms(
    encoding: &str,
    schema: &str,
    data: &[u8],
) -> Result<Option<Vec<Transform>>, CaptureProblem> {
    let found = match schema {
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
        "geometry_msgs/msg/PoseStamped"
        | "geometry_msgs/msg/TransformStamped"
        | "tf2_msgs/msg/TFMessage" => {
            let mut cdr = Cdr::of(encoding, schema, data)?;
            let short = || CaptureProblem::Message("it ends early".into());
            let is_list = schema == "tf2_msgs/msg/TFMessage";
            let count = if is_list { cdr.word().ok_or_else(short)? } else { 1 };
            let is_pose = schema == "geometry_msgs/msg/PoseStamped";
            // No capacity by the claimed count: a hostile one would exhaust memory.
            let mut found = Vec::new();
            for _ in 0..count {
                found.push(cdr.transform(is_pose)?);
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
    pub(super) fn camera(&self) -> Result<Camera, CaptureProblem> {
        if self.d.iter().any(|coefficient| *coefficient != 0.0) {
            return Err(CaptureProblem::Distorted(format!(
                "{:?} {:?}",
                self.distortion_model, self.d
            )));
        }
        let [fx, _, cx, _, fy, cy, ..] = *self.k.as_slice() else {
            let why = format!("K has {} numbers, not 9", self.k.len());
            return Err(CaptureProblem::Message(why));
        };
        let (focal, centre) = ([fx as f32, fy as f32], [cx as f32, cy as f32]);
        let here = Isometry3::identity();
        Ok(Camera::new([self.width, self.height], focal, centre, here)?)
    }
}

impl RawImage {
    /// Whether its encoding may be that of depths.
    pub(super) fn is_depth(&self) -> bool {
        matches!(self.encoding.as_str(), "16UC1" | "mono16" | "32FC1")
    }

    /// Depths in millimetres. (height * width)
    pub(super) fn depths(&self) -> Result<Vec<u16>, CaptureProblem> {
        let broken = |why: &str| CaptureProblem::Message(why.into());
        if self.width > MAX_SIDE || self.height > MAX_SIDE {
            return Err(broken("its image has more than 8192 pixels a side"));
        }
        let [width, height, step] = [self.width, self.height, self.step].map(|side| side as usize);
        let size = if self.encoding == "32FC1" { 4 } else { 2 };
        let row = width * size;
        if row == 0 || height == 0 || step < row || self.data.len() < step * (height - 1) + row {
            return Err(broken("its data are too short for its width, height and step"));
        }
        let rows = self.data.chunks(step).take(height).filter_map(|bytes| bytes.get(..row));
        let kind = if size == 4 { Kind::Float } else { Kind::Unsigned };
        let number = Number::new(kind, size).ok_or_else(|| broken("its encoding is unknown"))?;
        let depth = |bytes: &[u8]| match size {
            // Metres. NaN, and depths beyond 16 bits, count as not measured.
            4 => {
                let steps = (number.read(bytes, 0) / f64::from(SCALE_M)).round();
                if (1.0..=65535.0).contains(&steps) { steps as u16 } else { 0 }
            }
            _ => number.read(bytes, 0) as u16,
        };
        Ok(rows.flat_map(|row| row.chunks_exact(size)).map(depth).collect())
    }
}

/// A field of a point: where it starts among the point's bytes.
struct Field {
    name: String,
    offset: usize,
    number: Option<Number>,
}

impl PointCloud {
    /// In its frame.
    pub(super) fn cloud(&self) -> Result<Cloud, CaptureProblem> {
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
        let pose = self.pose.unwrap_or_default();
        let pose: Isometry3<f32> = isometry(pose.position, pose.orientation)?.cast();
        let mut cloud =
            unpack(&fields.collect::<Vec<_>>(), self.point_stride as usize, &self.data)?;
        cloud.points.iter_mut().for_each(|point| *point = pose * *point);
        Ok(cloud)
    }
}

/// Points of packed fields, one after another.
fn unpack(fields: &[Field], stride: usize, data: &[u8]) -> Result<Cloud, CaptureProblem> {
    let broken = |why: &str| CaptureProblem::Message(why.into());
    if data.is_empty() {
        return Ok(Cloud::default());
    }
    if stride == 0 || !data.len().is_multiple_of(stride) {
        return Err(broken("its data are not a whole number of points"));
    }
    let points = (data.len() / stride) as u64;
    if points > MAX_POINTS {
        return Err(CaptureProblem::TooManyPoints { points, most: MAX_POINTS });
    }
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
        let position = Point3::new(at(x) as f32, at(y) as f32, at(z) as f32);
        (position, label.map_or(0, |label| at(label) as u16))
    });
    Ok(points_of(points, label.is_some()))
}

/// `sensor_msgs/msg/PointCloud2` of ROS 2, as CDR has it.
pub(super) struct PointCloud2 {
    pub(super) timestamp: Timestamp,
    pub(super) frame_id: String,
    pub(super) cloud: Cloud,
}

/// Fields of a ROS cloud, at most.
// It bounds the time of a hostile message.
const MAX_FIELDS: u32 = 256;

impl PointCloud2 {
    pub(super) fn decode(
        encoding: &str,
        schema: &str,
        data: &[u8],
    ) -> Result<PointCloud2, CaptureProblem> {
        let short = || CaptureProblem::Message("it ends early".into());
        let broken = |why: &str| CaptureProblem::Message(why.into());
        let mut cdr = Cdr::of(encoding, schema, data)?;
        let timestamp = cdr.time()?;
        let frame_id = cdr.string().ok_or_else(short)?;
        let (height, width) = (cdr.word().ok_or_else(short)?, cdr.word().ok_or_else(short)?);
        let count = cdr.word().ok_or_else(short)?;
        if count > MAX_FIELDS {
            return Err(broken("it has more than 256 fields"));
        }
        let mut fields = Vec::new();
        for _ in 0..count {
            fields.push(cdr.field().ok_or_else(short)?);
        }
        let is_big = cdr.byte().ok_or_else(short)? != 0;
        let stride = cdr.word().ok_or_else(short)? as usize;
        let row = cdr.word().ok_or_else(short)? as usize;
        let length = cdr.word().ok_or_else(short)? as usize;
        let data = cdr.take(length).ok_or_else(short)?;
        if is_big {
            return Err(broken("its data are big-endian"));
        }
        let of_row = (width as usize).checked_mul(stride).filter(|of_row| *of_row <= row);
        let (Some(of_row), height) = (of_row, height as usize) else {
            return Err(broken("its rows are shorter than its points"));
        };
        if row.checked_mul(height) != Some(data.len()) {
            return Err(broken("its data are not as long as its rows"));
        }
        // Rows may have padding behind their points.
        let packed: Vec<u8> = match row == of_row || row == 0 {
            true => data.to_vec(),
            false => data
                .chunks(row)
                .filter_map(|bytes| bytes.get(..of_row))
                .flatten()
                .copied()
                .collect(),
        };
        let cloud = unpack(&fields, stride, &packed)?;
        Ok(PointCloud2 { timestamp, frame_id, cloud })
    }
}

/// Reads plain little-endian CDR: numbers are aligned to their size, counted from behind the identifier.
struct Cdr<'b> {
    bytes: &'b [u8],
    at: usize,
}

impl<'b> Cdr<'b> {
    fn of(encoding: &str, schema: &str, data: &'b [u8]) -> Result<Self, CaptureProblem> {
        if encoding != "cdr" {
            let (schema, encoding) = (schema.into(), encoding.into());
            return Err(CaptureProblem::Encoding { schema, encoding });
        }
        // Representation identifier: plain CDR, little-endian.
        if !matches!(data, [0, 1, _, _, ..]) {
            return Err(CaptureProblem::Message("it is not plain little-endian CDR".into()));
        }
        Ok(Cdr { bytes: data.get(4..).unwrap_or_default(), at: 0 })
    }

    fn take(&mut self, count: usize) -> Option<&'b [u8]> {
        let end = self.at.checked_add(count)?;
        let taken = self.bytes.get(self.at..end)?;
        self.at = end;
        Some(taken)
    }

    fn byte(&mut self) -> Option<u8> {
        self.take(1)?.first().copied()
    }

    fn word(&mut self) -> Option<u32> {
        self.at = self.at.checked_next_multiple_of(4)?;
        Some(u32::from_le_bytes(self.take(4)?.try_into().ok()?))
    }

    fn double(&mut self) -> Option<f64> {
        self.at = self.at.checked_next_multiple_of(8)?;
        Some(f64::from_le_bytes(self.take(8)?.try_into().ok()?))
    }

    fn time(&mut self) -> Result<Timestamp, CaptureProblem> {
        let short = || CaptureProblem::Message("it ends early".into());
        Ok(Timestamp {
            seconds: i64::from(self.word().ok_or_else(short)? as i32),
            nanos: i32::try_from(self.word().ok_or_else(short)?)
                .map_err(|_| CaptureProblem::Message("nanoseconds".into()))?,
        })
    }

    /// A `geometry_msgs/msg/TransformStamped`, or a `PoseStamped`, which names no frame of its own.
    fn transform(&mut self, is_pose: bool) -> Result<Transform, CaptureProblem> {
        let short = || CaptureProblem::Message("it ends early".into());
        let time = Some(self.time()?.nanoseconds());
        let parent = self.string().ok_or_else(short)?;
        let child = if is_pose { None } else { Some(self.string().ok_or_else(short)?) };
        let mut numbers = [0.0; 7];
        for number in &mut numbers {
            *number = self.double().ok_or_else(short)?;
        }
        let [x, y, z, i, j, k, w] = numbers;
        let turn = Orientation { x: i, y: j, z: k, w };
        Ok(Transform { time, parent, child, pose: isometry(Some(Vector { x, y, z }), Some(turn))? })
    }

    /// With its length and a zero behind it.
    fn string(&mut self) -> Option<String> {
        let length = self.word()? as usize;
        let bytes = self.take(length)?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        Some(String::from_utf8_lossy(text).into_owned())
    }

    fn field(&mut self) -> Option<Field> {
        let (name, offset, kind) = (self.string()?, self.word()? as usize, self.byte()?);
        // The count of numbers: only the first is read.
        self.word()?;
        let number = match kind {
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
        Some(Field { name, offset, number })
    }
}
