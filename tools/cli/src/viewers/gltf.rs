//! Binary glTF 2.0: a node and a mesh a unit, moved by one animation.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::Plane;
use serde_json::{Value, json};

use super::moving::{Frame, Moving, MovingUnit};
use crate::picture::Rgb;

const VERSION: u32 = 2;
const MAGIC: &[u8; 4] = b"glTF";
const JSON_CHUNK: &[u8; 4] = b"JSON";
const BINARY_CHUNK: &[u8; 4] = b"BIN\0";

const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34962;

/// x, y, z, w: turns z, which is up here, to y, which is up in glTF.
const Y_UP: [f32; 4] =
    [-std::f32::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f32::consts::FRAC_1_SQRT_2];
const GROUND: [f32; 4] = [0.72, 0.73, 0.75, 1.0];
/// How opaque the truth is.
const TRUTH_OPACITY: f32 = 0.35;
/// Half a side of a plane, in parts of the scene's radius.
const PLANE_HALF: f32 = 2.0;

/// A file's bytes.
pub(super) fn file(moving: &Moving) -> anyhow::Result<Vec<u8>> {
    let mut build = Build::default();
    let mut roots = Vec::new();
    for (number, plane) in moving.planes.iter().enumerate() {
        roots.push(build.plane(number, plane, moving.extent()));
    }
    if let Some(field) = &moving.terrain
        && let Some(shape) = build.flat(field.triangles())
    {
        let mesh = build.painted("terrain", shape, GROUND.map(linear));
        roots.push(build.node("terrain", Some(mesh)));
    }
    for (number, unit) in moving.units.iter().enumerate() {
        let label = moving.label(number);
        let shape = build.shape(unit);
        let mut motion = |name: String,
                          opacity: f32,
                          of: fn(&Frame) -> &[Option<Isometry3<f32>>]| {
            let there = moving
                .frames()
                .iter()
                .any(|frame| of(frame).get(number).is_some_and(Option::is_some));
            if there {
                let mesh = shape.map(|shape| build.mesh(&name, shape, unit.colour, opacity));
                let node = build.node(&name, mesh);
                let keys = moving.frames().iter();
                let keys = keys
                    .map(|frame| (moving.seconds(frame), of(frame).get(number).copied().flatten()));
                build.animate(node, &keys.collect::<Vec<_>>());
                roots.push(node);
            }
        };
        motion(label.clone(), 1.0, |frame| &frame.poses);
        motion(format!("{label} ({})", moving.truth_is), TRUTH_OPACITY, |frame| &frame.truth);
    }
    let root = build.add("nodes", json!({ "name": "z up", "rotation": Y_UP, "children": roots }));
    build.finish(moving, root)
}

/// The accessors of a mesh.
#[derive(Clone, Copy)]
struct Shape {
    positions: usize,
    normals: usize,
}

/// A file that is being built. Lists of glTF are referred to by numbers.
#[derive(Default)]
struct Build {
    lists: serde_json::Map<String, Value>,
    channels: Vec<Value>,
    samplers: Vec<Value>,
    binary: Vec<u8>,
    /// Times that units share, and their accessor.
    times: Vec<(Vec<f32>, usize)>,
}

impl Build {
    /// Adds to a list, and gives the number there.
    fn add(&mut self, list: &str, value: Value) -> usize {
        let all = self.lists.entry(list).or_insert_with(|| json!([]));
        let Some(all) = all.as_array_mut() else { return 0 };
        all.push(value);
        all.len() - 1
    }

    /// Adds numbers, `N` of them an element.
    fn accessor<const N: usize>(
        &mut self,
        values: &[[f32; N]],
        is_bounded: bool,
        target: Option<u32>,
    ) -> usize {
        let start = self.binary.len();
        self.binary.extend(values.iter().flatten().flat_map(|value| value.to_le_bytes()));
        let mut view =
            json!({ "buffer": 0, "byteOffset": start, "byteLength": self.binary.len() - start });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        let view = self.add("bufferViews", view);
        let kind = if N == 1 {
            "SCALAR"
        } else if N == 3 {
            "VEC3"
        } else {
            "VEC4"
        };
        let mut accessor = json!({ "bufferView": view, "componentType": FLOAT, "count": values.len(), "type": kind });
        if is_bounded {
            let bound = |pick: fn(f32, f32) -> f32| {
                let mut all = values.iter().copied();
                let first = all.next().unwrap_or([0.0; N]);
                let bound =
                    all.fold(first, |bound, v| std::array::from_fn(|at| pick(bound[at], v[at])));
                bound.to_vec()
            };
            accessor["min"] = json!(bound(f32::min));
            accessor["max"] = json!(bound(f32::max));
        }
        self.add("accessors", accessor)
    }

    /// Triangles with a normal each; `None` without any.
    fn flat(&mut self, triangles: impl Iterator<Item = [Point3<f32>; 3]>) -> Option<Shape> {
        let (mut positions, mut normals) = (Vec::new(), Vec::new());
        for [a, b, c] in triangles {
            // In f64: triangles of a millimetre have areas that f32 rounds to nothing.
            let side = |p: Point3<f32>| (p - a).cast::<f64>();
            let Some(normal) = side(b).cross(&side(c)).try_normalize(1e-18) else { continue };
            positions.extend([a, b, c].map(|p| [p.x, p.y, p.z]));
            normals.extend([<[f32; 3]>::from(normal.cast::<f32>()); 3]);
        }
        (!positions.is_empty()).then(|| Shape {
            positions: self.accessor(&positions, true, Some(ARRAY_BUFFER)),
            normals: self.accessor(&normals, false, Some(ARRAY_BUFFER)),
        })
    }

    fn shape(&mut self, unit: &MovingUnit) -> Option<Shape> {
        let corner = |at: usize| unit.corners.get(at).copied().unwrap_or_default();
        self.flat(unit.triangles.iter().map(|triangle| triangle.map(corner)))
    }

    fn mesh(&mut self, name: &str, shape: Shape, colour: Rgb, opacity: f32) -> usize {
        let [r, g, b] = colour.map(linear);
        self.painted(name, shape, [r, g, b, opacity])
    }

    fn painted(&mut self, name: &str, shape: Shape, colour: [f32; 4]) -> usize {
        let mut material = json!({
            "name": name,
            "pbrMetallicRoughness": { "baseColorFactor": colour, "metallicFactor": 0.0, "roughnessFactor": 0.7 },
        });
        if colour[3] < 1.0 {
            material["alphaMode"] = "BLEND".into();
        }
        let material = self.add("materials", material);
        let attributes = json!({ "POSITION": shape.positions, "NORMAL": shape.normals });
        let primitive = json!({ "attributes": attributes, "material": material });
        self.add("meshes", json!({ "name": name, "primitives": [primitive] }))
    }

    fn node(&mut self, name: &str, mesh: Option<usize>) -> usize {
        let mut node = json!({ "name": name });
        if let Some(mesh) = mesh {
            node["mesh"] = mesh.into();
        }
        self.add("nodes", node)
    }

    /// A square in the plane below the scene's middle.
    fn plane(
        &mut self,
        number: usize,
        plane: &Plane,
        (middle, radius): (Point3<f32>, f32),
    ) -> usize {
        let name = format!("plane {number}");
        let half = PLANE_HALF * radius;
        let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
        let corner = |at: usize| Point3::new(corners[at].0, corners[at].1, 0.0);
        let shape = self.flat([[0, 1, 2], [0, 2, 3]].map(|three| three.map(corner)).into_iter());
        let mesh = shape.map(|shape| self.painted(&name, shape, GROUND.map(linear)));
        let node = self.node(&name, mesh);
        // A half turn where the normal is straight down.
        let upside_down =
            || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f32::consts::PI);
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &plane.normal)
            .unwrap_or_else(upside_down);
        let place = middle - plane.normal * (plane.normal.dot(&middle.coords) - plane.offset_m);
        if let Some(node) = self.lists.get_mut("nodes").and_then(|nodes| nodes.get_mut(node)) {
            node["translation"] = json!([place.x, place.y, place.z]);
            node["rotation"] = json!([turn.i, turn.j, turn.k, turn.w]);
        }
        node
    }

    /// Moves a node. While it is not there its size is 0.
    fn animate(&mut self, node: usize, keys: &[(f32, Option<Isometry3<f32>>)]) {
        let there: Vec<_> =
            keys.iter().filter_map(|(time, pose)| Some((*time, (*pose)?))).collect();
        let times: Vec<f32> = there.iter().map(|(time, _)| *time).collect();
        let input = self.clock(times);
        let places: Vec<_> =
            there.iter().map(|(_, pose)| <[f32; 3]>::from(pose.translation.vector)).collect();
        let turns: Vec<_> =
            there.iter().map(|(_, pose)| <[f32; 4]>::from(pose.rotation.coords)).collect();
        let (places, turns) =
            (self.accessor(&places, false, None), self.accessor(&turns, false, None));
        self.channel(node, "translation", "LINEAR", input, places);
        self.channel(node, "rotation", "LINEAR", input, turns);
        if there.len() < keys.len() {
            let input = self.clock(keys.iter().map(|(time, _)| *time).collect());
            let sizes: Vec<_> =
                keys.iter().map(|(_, pose)| [if pose.is_some() { 1.0 } else { 0.0 }; 3]).collect();
            let sizes = self.accessor(&sizes, false, None);
            self.channel(node, "scale", "STEP", input, sizes);
        }
    }

    fn clock(&mut self, times: Vec<f32>) -> usize {
        if let Some((_, input)) = self.times.iter().find(|(known, _)| *known == times) {
            return *input;
        }
        let input =
            self.accessor(&times.iter().map(|time| [*time]).collect::<Vec<_>>(), true, None);
        self.times.push((times, input));
        input
    }

    fn channel(
        &mut self,
        node: usize,
        path: &str,
        interpolation: &str,
        input: usize,
        output: usize,
    ) {
        let sampler = self.samplers.len();
        self.samplers
            .push(json!({ "input": input, "output": output, "interpolation": interpolation }));
        self.channels.push(json!({ "sampler": sampler, "target": { "node": node, "path": path } }));
    }

    /// The file.
    fn finish(mut self, moving: &Moving, root: usize) -> anyhow::Result<Vec<u8>> {
        let generator = concat!("rigidformer ", env!("CARGO_PKG_VERSION"));
        self.lists.insert("asset".into(), json!({ "version": "2.0", "generator": generator }));
        self.lists.insert("scene".into(), 0.into());
        self.add("scenes", json!({ "name": moving.name, "nodes": [root] }));
        if !self.channels.is_empty() {
            let (channels, samplers) =
                (std::mem::take(&mut self.channels), std::mem::take(&mut self.samplers));
            let name = moving.poses_are.as_str();
            self.add(
                "animations",
                json!({ "name": name, "channels": channels, "samplers": samplers }),
            );
        }
        if !self.binary.is_empty() {
            let bytes = self.binary.len();
            self.add("buffers", json!({ "byteLength": bytes }));
        }
        let mut json = serde_json::to_vec(&self.lists)?;
        json.resize(json.len().next_multiple_of(4), b' ');
        let has_binary = !self.binary.is_empty();
        let chunks = [(JSON_CHUNK, json), (BINARY_CHUNK, self.binary)];
        let mut body = Vec::new();
        for (kind, bytes) in chunks.iter().take(if has_binary { 2 } else { 1 }) {
            body.extend(u32::try_from(bytes.len())?.to_le_bytes());
            body.extend_from_slice(*kind);
            body.extend_from_slice(bytes);
        }
        let mut file = MAGIC.to_vec();
        file.extend(VERSION.to_le_bytes());
        file.extend(u32::try_from(body.len() + 12)?.to_le_bytes());
        file.append(&mut body);
        Ok(file)
    }
}

/// The colours of materials are linear, those of screens are not.
fn linear(channel: f32) -> f32 {
    if channel <= 0.04045 { channel / 12.92 } else { ((channel + 0.055) / 1.055).powf(2.4) }
}
