//! MCAP with messages of `foxglove`: looks once, and then transforms.

mod messages;
mod packed;
mod schema;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::sync::Arc;

use ::mcap::records::Metadata;
use ::mcap::{Channel, Message, Schema, WriteOptions, Writer};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use prost::Message as _;
use rigidformer_core::{Plane, Role};

use self::messages::{
    Colour, CubePrimitive, Deletion, Duration, FrameTransform, FrameTransforms, KeyValue, Line,
    Pose, SceneEntity, SceneUpdate, SpherePrimitive, Text, TimeToContact, Timestamp, TriangleList,
    Turn, Vector,
};
use super::contacts::{Contact, Met, contacts};
use super::moving::{Frame, Moving, MovingUnit};
use crate::picture::Rgb;

/// The frame that does not move.
const WORLD: &str = "world";
const TRANSFORMS: &str = "/tf";
const PLANES: &str = "/planes";
const POINTS: &str = "/points";
const TIME_TO_CONTACT: &str = "/time_to_contact";
const CONTACTS: &str = "/contacts";
/// Of a chunk before compression. Small ones let viewers jump.
const CHUNK_BYTES: u64 = 1 << 20;
const TRUTH_OPACITY: f32 = 0.35;
const GROUND: Rgb = [0.72, 0.73, 0.75];
const TO_COME: Rgb = [0.85, 0.25, 0.1];
/// Of lines and of text that tell of contacts, in pixels.
const LINE_PIXELS: f64 = 2.0;
const TEXT_PIXELS: f64 = 14.0;
/// Half a side of a plane, and the diameter of a point, in parts of the scene's radius.
const PLANE_HALF: f32 = 2.0;
const POINT: f32 = 0.008;
/// Thickness of planes, in parts of the scene's radius: boxes have two sides, triangles one.
const THICKNESS: f32 = 0.002;

/// Frames of a kind: what they are called, and where their poses are.
struct Kind {
    prefix: &'static str,
    topic: &'static str,
    opacity: f32,
    of: fn(&Frame) -> &[Option<Isometry3<f32>>],
}

const KINDS: [Kind; 2] = [
    Kind { prefix: "predicted", topic: "/predicted", opacity: 1.0, of: |frame| &frame.poses },
    Kind { prefix: "truth", topic: "/truth", opacity: TRUTH_OPACITY, of: |frame| &frame.truth },
];

impl Kind {
    fn frame_id(&self, moving: &Moving, unit: usize) -> String {
        format!("{}/{}", self.prefix, moving.label(unit))
    }

    /// (units) Which are there.
    fn there(&self, frame: &Frame) -> Vec<bool> {
        (self.of)(frame).iter().map(Option::is_some).collect()
    }
}

/// A file's bytes.
pub(super) fn file(moving: &Moving) -> anyhow::Result<Vec<u8>> {
    let library = concat!("rigidformer ", env!("CARGO_PKG_VERSION"));
    // Packed at the end.
    let options = WriteOptions::new().compression(None).chunk_size(Some(CHUNK_BYTES));
    let writer = options.library(library).profile("").create(Cursor::new(Vec::new()))?;
    let mut log = Log { writer, channels: BTreeMap::new() };
    log.writer.write_metadata(&Metadata { name: "rigidformer".into(), metadata: notes(moving) })?;

    let mut there: [Vec<bool>; 2] = [Vec::new(), Vec::new()];
    let contacts = contacts(moving)?;
    let (middle, radius) = moving.extent();
    let start_s = moving.frames().first().map_or(0.0, |frame| frame.time_s.min(0.0));
    let has_contacts = contacts.iter().any(|contacts| !contacts.is_empty());
    for ((number, frame), contacts) in moving.frames().iter().enumerate().zip(&contacts) {
        let time = nanoseconds(frame.time_s - start_s);
        log.write(TRANSFORMS, time, &transforms(moving, frame, time))?;
        if number == 0 && !moving.planes.is_empty() {
            log.write(PLANES, time, &update(planes(moving, (&middle, radius), time)))?;
        }
        if has_contacts {
            log.write(TIME_TO_CONTACT, time, &time_to_contact(moving, contacts, time))?;
            log.write(CONTACTS, time, &update(soonest(moving, contacts, time)))?;
        }
        for (kind, there) in KINDS.iter().zip(&mut there) {
            let now = kind.there(frame);
            if now == *there || (there.is_empty() && !now.contains(&true)) {
                continue;
            }
            // All at once whenever a unit comes or goes: viewers that jump to a time read a topic's last message before it.
            let units = || moving.units.iter().enumerate().filter(|(unit, _)| now[*unit]);
            let shapes = units().map(|(unit, looks)| entity(moving, kind, (unit, looks), time));
            log.write(kind.topic, time, &update(shapes.collect()))?;
            if kind.prefix == KINDS[0].prefix {
                let points = units().map(|(unit, looks)| {
                    points(moving, kind, (unit, looks), (POINT * radius, time))
                });
                log.write(POINTS, time, &update(points.collect()))?;
            }
            *there = now;
        }
    }
    log.writer.finish()?;
    packed::packed(&log.writer.into_inner().into_inner())
}

/// Writes messages of topics, whose channels are made when they are needed.
struct Log {
    writer: Writer<Cursor<Vec<u8>>>,
    channels: BTreeMap<&'static str, Arc<Channel<'static>>>,
}

impl Log {
    fn write<M: schema::Described + prost::Message>(
        &mut self,
        topic: &'static str,
        time: u64,
        message: &M,
    ) -> anyhow::Result<()> {
        let number = self.channels.len() as u16;
        let channel = self.channels.entry(topic).or_insert_with(|| {
            let schema = Schema {
                id: M::ID,
                name: M::NAME.into(),
                encoding: "protobuf".into(),
                data: Cow::Owned(schema::descriptors().encode_to_vec()),
            };
            Arc::new(Channel {
                id: number,
                topic: topic.into(),
                schema: Some(Arc::new(schema)),
                message_encoding: "protobuf".into(),
                metadata: BTreeMap::new(),
            })
        });
        let (channel, data) = (Arc::clone(channel), Cow::Owned(message.encode_to_vec()));
        self.writer.write(&Message {
            channel,
            sequence: 0,
            log_time: time,
            publish_time: time,
            data,
        })?;
        Ok(())
    }
}

/// The format has no times before 0: motions that begin before it count from their first frame.
fn nanoseconds(time_s: f64) -> u64 {
    (time_s * 1e9).round().max(0.0) as u64
}

fn timestamp(time: u64) -> Option<Timestamp> {
    let second = 1_000_000_000;
    Some(Timestamp { seconds: (time / second) as i64, nanos: (time % second) as i32 })
}

fn notes(moving: &Moving) -> BTreeMap<String, String> {
    let mut notes = BTreeMap::from([
        ("scene".to_owned(), moving.name.clone()),
        ("/predicted".to_owned(), moving.poses_are.clone()),
    ]);
    if moving.has_truth() {
        notes.insert("/truth".to_owned(), moving.truth_is.clone());
    }
    notes
}

/// What replaces all that its topic showed.
fn update(entities: Vec<SceneEntity>) -> SceneUpdate {
    let all = Deletion { timestamp: None, kind: messages::DELETE_ALL, id: String::new() };
    SceneUpdate { deletions: vec![all], entities }
}

fn transforms(moving: &Moving, frame: &Frame, time: u64) -> FrameTransforms {
    let of_kind = |kind: &'static Kind| {
        let poses = (kind.of)(frame).iter().enumerate();
        poses.filter_map(move |(unit, pose)| {
            let pose = pose.as_ref()?;
            Some(FrameTransform {
                timestamp: timestamp(time),
                parent_frame_id: WORLD.into(),
                child_frame_id: kind.frame_id(moving, unit),
                translation: Some(vector(&pose.translation.vector)),
                rotation: Some(turn(&pose.rotation)),
            })
        })
    };
    FrameTransforms { transforms: KINDS.iter().flat_map(of_kind).collect() }
}

/// An entity without anything in it. It stays until it is replaced, and moves with its frame.
fn blank(frame_id: String, id: String, time: u64) -> SceneEntity {
    SceneEntity {
        timestamp: timestamp(time),
        frame_id,
        id,
        lifetime: Some(Duration { seconds: 0, nanos: 0 }),
        frame_locked: true,
        ..SceneEntity::default()
    }
}

fn entity(
    moving: &Moving,
    kind: &Kind,
    (unit, looks): (usize, &MovingUnit),
    time: u64,
) -> SceneEntity {
    let mut entity = blank(kind.frame_id(moving, unit), moving.label(unit), time);
    let corners = looks.triangles.iter().flatten().filter_map(|corner| looks.corners.get(*corner));
    let triangles = TriangleList {
        pose: Some(Pose::identity()),
        points: corners.map(|corner| vector(&corner.coords)).collect(),
        color: Some(colour(looks.colour, kind.opacity)),
    };
    if !triangles.points.is_empty() {
        entity.triangles.push(triangles);
    }
    let role = match looks.role {
        Role::Free => "free",
        Role::Driven => "driven",
        _ => "fixed",
    };
    let mut note =
        |key: &str, value: String| entity.metadata.push(KeyValue { key: key.into(), value });
    note("role", role.into());
    note("points", looks.points.len().to_string());
    if let Some(mass_kg) = looks.mass_kg {
        note("mass_kg", mass_kg.to_string());
    }
    entity
}

fn points(
    moving: &Moving,
    kind: &Kind,
    (unit, looks): (usize, &MovingUnit),
    (size, time): (f32, u64),
) -> SceneEntity {
    let size = f64::from(size);
    let sphere = |point: &Point3<f32>| SpherePrimitive {
        pose: Some(Pose { position: Some(vector(&point.coords)), ..Pose::identity() }),
        size: Some(Vector { x: size, y: size, z: size }),
        color: Some(colour(looks.colour.map(|channel| channel * 0.6), 1.0)),
    };
    let mut entity = blank(kind.frame_id(moving, unit), moving.label(unit), time);
    entity.spheres.extend(looks.points.iter().map(sphere));
    entity
}

fn planes(moving: &Moving, (middle, radius): (&Point3<f32>, f32), time: u64) -> Vec<SceneEntity> {
    let (side, thickness) = (f64::from(2.0 * PLANE_HALF * radius), THICKNESS * radius);
    let plane = |(number, plane): (usize, &Plane)| {
        let mut entity = blank(WORLD.into(), plane_label(number), time);
        // A half turn where the normal is straight down.
        let upside_down =
            || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f32::consts::PI);
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &plane.normal)
            .unwrap_or_else(upside_down);
        let height = plane.normal.dot(&middle.coords) - plane.offset_m;
        let place = middle - plane.normal * (height + thickness / 2.0);
        entity.cubes.push(CubePrimitive {
            pose: Some(Pose {
                position: Some(vector(&place.coords)),
                orientation: Some(turn(&rotation)),
            }),
            size: Some(Vector { x: side, y: side, z: f64::from(thickness) }),
            color: Some(colour(GROUND, 1.0)),
        });
        let numbers = [
            ("friction", plane.friction),
            ("restitution", plane.restitution),
            ("offset_m", plane.offset_m),
        ];
        let notes =
            numbers.map(|(key, value)| KeyValue { key: key.into(), value: value.to_string() });
        entity.metadata.extend(notes);
        entity
    };
    moving.planes.iter().enumerate().map(plane).collect()
}

fn label(moving: &Moving, met: Met) -> String {
    match met {
        Met::Unit(unit) => moving.label(unit),
        Met::Plane(plane) => plane_label(plane),
    }
}

fn plane_label(plane: usize) -> String {
    format!("plane {plane}")
}

fn time_to_contact(moving: &Moving, contacts: &[Contact], time: u64) -> TimeToContact {
    let contact = |contact: &Contact| messages::Contact {
        unit: moving.label(contact.unit),
        other: label(moving, contact.met),
        time_s: contact.time_s,
        distance_m: f64::from(contact.distance_m),
    };
    TimeToContact { timestamp: timestamp(time), contacts: contacts.iter().map(contact).collect() }
}

/// The contact that is next for one of its units, of those to come: a line between their nearest points, and the time.
fn soonest(moving: &Moving, contacts: &[Contact], time: u64) -> Vec<SceneEntity> {
    let of_unit = |unit: usize| {
        let is_its = |contact: &Contact| contact.unit == unit || contact.met.unit() == Some(unit);
        let to_come = contacts.iter().enumerate().filter(|(_, contact)| contact.time_s > 0.0);
        let its = to_come.filter(|(_, contact)| is_its(contact));
        its.min_by(|(_, a), (_, b)| a.time_s.total_cmp(&b.time_s)).map(|(number, _)| number)
    };
    let soonest: BTreeSet<usize> = (0..moving.units.len()).filter_map(of_unit).collect();
    let entity = |contact: &Contact| {
        let points = contact.nearest?;
        let (unit, other) = (moving.label(contact.unit), label(moving, contact.met));
        let mut entity = blank(WORLD.into(), format!("{unit}, {other}"), time);
        let color = Some(colour(TO_COME, 1.0));
        entity.lines.push(Line {
            pose: Some(Pose::identity()),
            thickness: LINE_PIXELS,
            scale_invariant: true,
            points: points.iter().map(|point| vector(&point.coords)).collect(),
            color,
        });
        let middle = nalgebra::center(&points[0], &points[1]);
        entity.texts.push(Text {
            pose: Some(Pose { position: Some(vector(&middle.coords)), ..Pose::identity() }),
            billboard: true,
            font_size: TEXT_PIXELS,
            scale_invariant: true,
            color,
            text: format!("{:.3} s", contact.time_s),
        });
        Some(entity)
    };
    soonest.iter().filter_map(|number| contacts.get(*number)).filter_map(entity).collect()
}

fn vector(vector: &Vector3<f32>) -> Vector {
    let [x, y, z] = <[f32; 3]>::from(*vector).map(f64::from);
    Vector { x, y, z }
}

fn turn(turn: &UnitQuaternion<f32>) -> Turn {
    let [x, y, z, w] = <[f32; 4]>::from(turn.coords).map(f64::from);
    Turn { x, y, z, w }
}

fn colour(colour: Rgb, opacity: f32) -> Colour {
    let [r, g, b] = colour.map(f64::from);
    Colour { r, g, b, a: f64::from(opacity) }
}
