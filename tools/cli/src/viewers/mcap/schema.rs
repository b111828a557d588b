//! The definitions of the messages, which the file carries so that viewers can decode them.

use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet,
};

use super::messages::{FrameTransforms, SceneUpdate, TimeToContact};

/// A message that is a topic's.
pub(super) trait Described {
    /// Number of its schema in the file, not 0.
    const ID: u16;
    const NAME: &'static str;
}

impl Described for SceneUpdate {
    const ID: u16 = 1;
    const NAME: &'static str = "foxglove.SceneUpdate";
}

impl Described for FrameTransforms {
    const ID: u16 = 2;
    const NAME: &'static str = "foxglove.FrameTransforms";
}

impl Described for TimeToContact {
    const ID: u16 = 3;
    const NAME: &'static str = "rigidformer.TimeToContact";
}

/// What a field holds.
#[derive(Clone, Copy)]
enum Holds {
    Plain(Type),
    One(&'static str),
    Many(&'static str),
    ManyPlain(Type),
    /// One of the message's own names, in the order of their numbers.
    Choice(&'static [&'static str]),
}

use Holds::{Choice, Many, ManyPlain, One, Plain};

/// Name and number.
type Field = (&'static str, i32, Holds);

const DOUBLE: Holds = Plain(Type::Double);
const BOOL: Holds = Plain(Type::Bool);
const TEXT: Holds = Plain(Type::String);
const TIME: Holds = One(".google.protobuf.Timestamp");
const POSE: Holds = One(".foxglove.Pose");
const SIZE: Holds = One(".foxglove.Vector3");
const COLOUR: Holds = One(".foxglove.Color");
const COLOURS: Holds = Many(".foxglove.Color");
const POINTS: Holds = Many(".foxglove.Point3");
const INDICES: Holds = ManyPlain(Type::Fixed32);
const XYZ: &[Field] = &[("x", 1, DOUBLE), ("y", 2, DOUBLE), ("z", 3, DOUBLE)];

/// Our own, of package `rigidformer`.
const OWN: [(&str, &[Field]); 2] = [
    (
        "Contact",
        &[("unit", 1, TEXT), ("other", 2, TEXT), ("time_s", 3, DOUBLE), ("distance_m", 4, DOUBLE)],
    ),
    ("TimeToContact", &[("timestamp", 1, TIME), ("contacts", 2, Many(".rigidformer.Contact"))]),
];

/// All fields, also those that are never written: viewers expect the whole definition.
const MESSAGES: [(&str, &[Field]); 19] = [
    ("Vector3", XYZ),
    ("Point3", XYZ),
    ("Quaternion", &[("x", 1, DOUBLE), ("y", 2, DOUBLE), ("z", 3, DOUBLE), ("w", 4, DOUBLE)]),
    (
        "Pose",
        &[
            ("position", 1, One(".foxglove.Vector3")),
            ("orientation", 2, One(".foxglove.Quaternion")),
        ],
    ),
    ("Color", &[("r", 1, DOUBLE), ("g", 2, DOUBLE), ("b", 3, DOUBLE), ("a", 4, DOUBLE)]),
    ("KeyValuePair", &[("key", 1, TEXT), ("value", 2, TEXT)]),
    (
        "ArrowPrimitive",
        &[
            ("pose", 1, POSE),
            ("shaft_length", 2, DOUBLE),
            ("shaft_diameter", 3, DOUBLE),
            ("head_length", 4, DOUBLE),
            ("head_diameter", 5, DOUBLE),
            ("color", 6, COLOUR),
        ],
    ),
    ("CubePrimitive", &[("pose", 1, POSE), ("size", 2, SIZE), ("color", 3, COLOUR)]),
    ("SpherePrimitive", &[("pose", 1, POSE), ("size", 2, SIZE), ("color", 3, COLOUR)]),
    (
        "CylinderPrimitive",
        &[
            ("pose", 1, POSE),
            ("size", 2, SIZE),
            ("bottom_scale", 3, DOUBLE),
            ("top_scale", 4, DOUBLE),
            ("color", 5, COLOUR),
        ],
    ),
    (
        "LinePrimitive",
        &[
            ("type", 1, Choice(&["LINE_STRIP", "LINE_LOOP", "LINE_LIST"])),
            ("pose", 2, POSE),
            ("thickness", 3, DOUBLE),
            ("scale_invariant", 4, BOOL),
            ("points", 5, POINTS),
            ("color", 6, COLOUR),
            ("colors", 7, COLOURS),
            ("indices", 8, INDICES),
        ],
    ),
    (
        "TriangleListPrimitive",
        &[
            ("pose", 1, POSE),
            ("points", 2, POINTS),
            ("color", 3, COLOUR),
            ("colors", 4, COLOURS),
            ("indices", 5, INDICES),
        ],
    ),
    (
        "TextPrimitive",
        &[
            ("pose", 1, POSE),
            ("billboard", 2, BOOL),
            ("font_size", 3, DOUBLE),
            ("scale_invariant", 4, BOOL),
            ("color", 5, COLOUR),
            ("text", 6, TEXT),
        ],
    ),
    (
        "ModelPrimitive",
        &[
            ("pose", 1, POSE),
            ("scale", 2, SIZE),
            ("color", 3, COLOUR),
            ("override_color", 4, BOOL),
            ("url", 5, TEXT),
            ("media_type", 6, TEXT),
            ("data", 7, Plain(Type::Bytes)),
        ],
    ),
    (
        "SceneEntity",
        &[
            ("timestamp", 1, TIME),
            ("frame_id", 2, TEXT),
            ("id", 3, TEXT),
            ("lifetime", 4, One(".google.protobuf.Duration")),
            ("frame_locked", 5, BOOL),
            ("metadata", 6, Many(".foxglove.KeyValuePair")),
            ("arrows", 7, Many(".foxglove.ArrowPrimitive")),
            ("cubes", 8, Many(".foxglove.CubePrimitive")),
            ("spheres", 9, Many(".foxglove.SpherePrimitive")),
            ("cylinders", 10, Many(".foxglove.CylinderPrimitive")),
            ("lines", 11, Many(".foxglove.LinePrimitive")),
            ("triangles", 12, Many(".foxglove.TriangleListPrimitive")),
            ("texts", 13, Many(".foxglove.TextPrimitive")),
            ("models", 14, Many(".foxglove.ModelPrimitive")),
        ],
    ),
    (
        "SceneEntityDeletion",
        &[("timestamp", 1, TIME), ("type", 2, Choice(&["MATCHING_ID", "ALL"])), ("id", 3, TEXT)],
    ),
    (
        "SceneUpdate",
        &[
            ("deletions", 1, Many(".foxglove.SceneEntityDeletion")),
            ("entities", 2, Many(".foxglove.SceneEntity")),
        ],
    ),
    (
        "FrameTransform",
        &[
            ("timestamp", 1, TIME),
            ("parent_frame_id", 2, TEXT),
            ("child_frame_id", 3, TEXT),
            ("translation", 4, One(".foxglove.Vector3")),
            ("rotation", 5, One(".foxglove.Quaternion")),
        ],
    ),
    ("FrameTransforms", &[("transforms", 1, Many(".foxglove.FrameTransform"))]),
];

/// Seconds and nanoseconds.
const CLOCK: &[Field] = &[("seconds", 1, Plain(Type::Int64)), ("nanos", 2, Plain(Type::Int32))];

/// All definitions; a file comes after those that it needs.
pub(super) fn descriptors() -> FileDescriptorSet {
    let google =
        |name: &str, message: &'static str| file(name, "google.protobuf", &[(message, CLOCK)], &[]);
    let (timestamp, duration) =
        ("google/protobuf/timestamp.proto", "google/protobuf/duration.proto");
    FileDescriptorSet {
        file: vec![
            google(timestamp, "Timestamp"),
            google(duration, "Duration"),
            file("foxglove/SceneUpdate.proto", "foxglove", &MESSAGES, &[timestamp, duration]),
            file("rigidformer/TimeToContact.proto", "rigidformer", &OWN, &[timestamp]),
        ],
    }
}

fn file(
    name: &str,
    package: &str,
    messages: &[(&str, &[Field])],
    needs: &[&str],
) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(name.into()),
        package: Some(package.into()),
        dependency: needs.iter().map(|name| (*name).into()).collect(),
        message_type: messages
            .iter()
            .map(|(name, fields)| message(package, name, fields))
            .collect(),
        syntax: Some("proto3".into()),
        ..FileDescriptorProto::default()
    }
}

fn message(package: &str, name: &str, fields: &[Field]) -> DescriptorProto {
    let choices = fields.iter().filter_map(|(_, _, holds)| match holds {
        Choice(names) => Some(EnumDescriptorProto {
            name: Some("Type".into()),
            value: names.iter().zip(0..).map(value).collect(),
            ..EnumDescriptorProto::default()
        }),
        _ => None,
    });
    DescriptorProto {
        name: Some(name.into()),
        field: fields.iter().map(|row| field(package, name, row)).collect(),
        enum_type: choices.collect(),
        ..DescriptorProto::default()
    }
}

fn value((name, number): (&&str, i32)) -> EnumValueDescriptorProto {
    EnumValueDescriptorProto {
        name: Some((*name).into()),
        number: Some(number),
        ..Default::default()
    }
}

fn field(package: &str, message: &str, (name, number, holds): &Field) -> FieldDescriptorProto {
    let (label, kind, of) = match *holds {
        Plain(kind) => (Label::Optional, kind, None),
        ManyPlain(kind) => (Label::Repeated, kind, None),
        One(of) => (Label::Optional, Type::Message, Some(of.to_owned())),
        Many(of) => (Label::Repeated, Type::Message, Some(of.to_owned())),
        Choice(_) => (Label::Optional, Type::Enum, Some(format!(".{package}.{message}.Type"))),
    };
    FieldDescriptorProto {
        name: Some((*name).into()),
        number: Some(*number),
        label: Some(label.into()),
        r#type: Some(kind.into()),
        type_name: of,
        ..FieldDescriptorProto::default()
    }
}
