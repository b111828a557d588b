//! Messages of `foxglove` that are written. Fields that stay empty are left out; `schema` has them.

/// `google.protobuf.Timestamp`
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(crate) struct Timestamp {
    #[prost(int64, tag = "1")]
    pub(crate) seconds: i64,
    #[prost(int32, tag = "2")]
    pub(crate) nanos: i32,
}

/// `google.protobuf.Duration`
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(crate) struct Duration {
    #[prost(int64, tag = "1")]
    pub(crate) seconds: i64,
    #[prost(int32, tag = "2")]
    pub(crate) nanos: i32,
}

/// `foxglove.Vector3`, and `foxglove.Point3`
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(crate) struct Vector {
    #[prost(double, tag = "1")]
    pub(crate) x: f64,
    #[prost(double, tag = "2")]
    pub(crate) y: f64,
    #[prost(double, tag = "3")]
    pub(crate) z: f64,
}

/// `foxglove.Quaternion`
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(crate) struct Turn {
    #[prost(double, tag = "1")]
    pub(crate) x: f64,
    #[prost(double, tag = "2")]
    pub(crate) y: f64,
    #[prost(double, tag = "3")]
    pub(crate) z: f64,
    #[prost(double, tag = "4")]
    pub(crate) w: f64,
}

/// `foxglove.Pose`
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(crate) struct Pose {
    #[prost(message, optional, tag = "1")]
    pub(crate) position: Option<Vector>,
    #[prost(message, optional, tag = "2")]
    pub(crate) orientation: Option<Turn>,
}

impl Pose {
    pub(crate) fn identity() -> Pose {
        let (position, orientation) =
            (Vector { x: 0.0, y: 0.0, z: 0.0 }, Turn { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
        Pose { position: Some(position), orientation: Some(orientation) }
    }
}

/// `foxglove.Color`
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub(crate) struct Colour {
    #[prost(double, tag = "1")]
    pub(crate) r: f64,
    #[prost(double, tag = "2")]
    pub(crate) g: f64,
    #[prost(double, tag = "3")]
    pub(crate) b: f64,
    #[prost(double, tag = "4")]
    pub(crate) a: f64,
}

/// `foxglove.KeyValuePair`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct KeyValue {
    #[prost(string, tag = "1")]
    pub(crate) key: String,
    #[prost(string, tag = "2")]
    pub(crate) value: String,
}

/// `foxglove.CubePrimitive`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct CubePrimitive {
    #[prost(message, optional, tag = "1")]
    pub(crate) pose: Option<Pose>,
    #[prost(message, optional, tag = "2")]
    pub(crate) size: Option<Vector>,
    #[prost(message, optional, tag = "3")]
    pub(crate) color: Option<Colour>,
}

/// `foxglove.SpherePrimitive`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct SpherePrimitive {
    #[prost(message, optional, tag = "1")]
    pub(crate) pose: Option<Pose>,
    #[prost(message, optional, tag = "2")]
    pub(crate) size: Option<Vector>,
    #[prost(message, optional, tag = "3")]
    pub(crate) color: Option<Colour>,
}

/// `foxglove.TriangleListPrimitive`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct TriangleList {
    #[prost(message, optional, tag = "1")]
    pub(crate) pose: Option<Pose>,
    #[prost(message, repeated, tag = "2")]
    pub(crate) points: Vec<Vector>,
    #[prost(message, optional, tag = "3")]
    pub(crate) color: Option<Colour>,
}

/// `foxglove.LinePrimitive`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Line {
    #[prost(message, optional, tag = "2")]
    pub(crate) pose: Option<Pose>,
    /// In pixels where `scale_invariant`.
    #[prost(double, tag = "3")]
    pub(crate) thickness: f64,
    #[prost(bool, tag = "4")]
    pub(crate) scale_invariant: bool,
    #[prost(message, repeated, tag = "5")]
    pub(crate) points: Vec<Vector>,
    #[prost(message, optional, tag = "6")]
    pub(crate) color: Option<Colour>,
}

/// `foxglove.TextPrimitive`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Text {
    #[prost(message, optional, tag = "1")]
    pub(crate) pose: Option<Pose>,
    /// Whether it faces who looks.
    #[prost(bool, tag = "2")]
    pub(crate) billboard: bool,
    /// In pixels where `scale_invariant`.
    #[prost(double, tag = "3")]
    pub(crate) font_size: f64,
    #[prost(bool, tag = "4")]
    pub(crate) scale_invariant: bool,
    #[prost(message, optional, tag = "5")]
    pub(crate) color: Option<Colour>,
    #[prost(string, tag = "6")]
    pub(crate) text: String,
}

/// `foxglove.SceneEntity`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct SceneEntity {
    #[prost(message, optional, tag = "1")]
    pub(crate) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(crate) frame_id: String,
    #[prost(string, tag = "3")]
    pub(crate) id: String,
    /// Zero: without end.
    #[prost(message, optional, tag = "4")]
    pub(crate) lifetime: Option<Duration>,
    #[prost(bool, tag = "5")]
    pub(crate) frame_locked: bool,
    #[prost(message, repeated, tag = "6")]
    pub(crate) metadata: Vec<KeyValue>,
    #[prost(message, repeated, tag = "8")]
    pub(crate) cubes: Vec<CubePrimitive>,
    #[prost(message, repeated, tag = "9")]
    pub(crate) spheres: Vec<SpherePrimitive>,
    #[prost(message, repeated, tag = "11")]
    pub(crate) lines: Vec<Line>,
    #[prost(message, repeated, tag = "12")]
    pub(crate) triangles: Vec<TriangleList>,
    #[prost(message, repeated, tag = "13")]
    pub(crate) texts: Vec<Text>,
}

/// The type of a deletion that leaves nothing.
pub(crate) const DELETE_ALL: i32 = 1;

/// `foxglove.SceneEntityDeletion`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Deletion {
    #[prost(message, optional, tag = "1")]
    pub(crate) timestamp: Option<Timestamp>,
    #[prost(int32, tag = "2")]
    pub(crate) kind: i32,
    #[prost(string, tag = "3")]
    pub(crate) id: String,
}

/// `foxglove.SceneUpdate`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct SceneUpdate {
    #[prost(message, repeated, tag = "1")]
    pub(crate) deletions: Vec<Deletion>,
    #[prost(message, repeated, tag = "2")]
    pub(crate) entities: Vec<SceneEntity>,
}

/// `foxglove.FrameTransform`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    pub(crate) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(crate) parent_frame_id: String,
    #[prost(string, tag = "3")]
    pub(crate) child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pub(crate) translation: Option<Vector>,
    #[prost(message, optional, tag = "5")]
    pub(crate) rotation: Option<Turn>,
}

/// `foxglove.FrameTransforms`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct FrameTransforms {
    #[prost(message, repeated, tag = "1")]
    pub(crate) transforms: Vec<FrameTransform>,
}

/// `rigidformer.TimeToContact`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct TimeToContact {
    #[prost(message, optional, tag = "1")]
    pub(crate) timestamp: Option<Timestamp>,
    #[prost(message, repeated, tag = "2")]
    pub(crate) contacts: Vec<Contact>,
}

/// `rigidformer.Contact`
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Contact {
    #[prost(string, tag = "1")]
    pub(crate) unit: String,
    /// What it meets: a unit, or a plane.
    #[prost(string, tag = "2")]
    pub(crate) other: String,
    /// Seconds until both touch; 0 while they do.
    #[prost(double, tag = "3")]
    pub(crate) time_s: f64,
    #[prost(double, tag = "4")]
    pub(crate) distance_m: f64,
}
