//! A page that plays the scene in a browser; everything is in it.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use nalgebra::Isometry3;
use rigidformer_core::Role;
use serde_json::json;

use rigidformer_runtime::terrain::HeightFieldBuf;

use super::moving::Moving;

const PAGE: &str = include_str!("html/page.html");
const STYLE: &str = include_str!("html/page.css");
const SCRIPT: &str = include_str!("html/page.js");

/// Numbers of a pose: x, y, z, then the quaternion's x, y, z, w.
const POSE: usize = 7;

/// A file's bytes.
pub(super) fn file(moving: &Moving) -> anyhow::Result<Vec<u8>> {
    let mut numbers: Vec<f32> = Vec::new();
    // Where an array begins among all numbers, and how long it is.
    let mut add = |values: &mut dyn Iterator<Item = f32>| {
        let start = numbers.len();
        numbers.extend(values);
        [start, numbers.len() - start]
    };
    let frames = moving.frames();
    let times = add(&mut frames.iter().map(|frame| moving.seconds(frame)));
    let poses = add(&mut frames.iter().flat_map(|frame| frame.poses.iter().flat_map(flat)));
    let truth = moving
        .has_truth()
        .then(|| add(&mut frames.iter().flat_map(|frame| frame.truth.iter().flat_map(flat))));
    let units = moving.units.iter().enumerate().map(|(number, unit)| {
        let points = add(&mut unit.points.iter().flat_map(|point| [point.x, point.y, point.z]));
        let corners = match unit.corners == unit.points {
            true => points,
            false => add(&mut unit.corners.iter().flat_map(|point| [point.x, point.y, point.z])),
        };
        let is_free = matches!(unit.role, Role::Free);
        json!({
            "name": moving.label(number),
            "colour": unit.colour,
            "free": is_free,
            "points": points,
            "corners": corners,
            "triangles": unit.triangles,
        })
    });
    let units = units.collect::<Vec<_>>();
    let planes = add(&mut moving
        .planes
        .iter()
        .flat_map(|p| [p.normal.x, p.normal.y, p.normal.z, p.offset_m]));
    let triangles = moving.terrain.iter().flat_map(HeightFieldBuf::triangles);
    let terrain = add(&mut triangles.flatten().flat_map(|point| [point.x, point.y, point.z]));
    let (middle, radius) = moving.extent();
    let scene = json!({
        "name": moving.name,
        "poses_are": moving.poses_are,
        "truth_is": moving.truth_is,
        "frames": frames.len(),
        "times": times,
        "poses": poses,
        "truth": truth,
        "units": units,
        "planes": planes,
        "terrain": terrain,
        "middle": [middle.x, middle.y, middle.z],
        "radius": radius,
    });
    // A name that closes the element would end it.
    let scene = serde_json::to_string(&scene)?.replace('<', "\\u003c");
    let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    let parts = [
        ("{{title}}", escaped(&moving.name)),
        ("{{style}}", STYLE.to_owned()),
        ("{{scene}}", scene),
        ("{{data}}", STANDARD.encode(bytes)),
        ("{{script}}", SCRIPT.to_owned()),
    ];
    Ok(filled(PAGE, &parts).into_bytes())
}

/// Seven numbers; not-a-number where nothing is.
fn flat(pose: &Option<Isometry3<f32>>) -> [f32; POSE] {
    let Some(pose) = pose else { return [f32::NAN; POSE] };
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// A page with its parts, in the order in which it names them. What a part contains is not looked at again.
fn filled(page: &str, parts: &[(&str, String)]) -> String {
    let (mut out, mut rest) = (String::new(), page);
    for (name, part) in parts {
        if let Some((before, after)) = rest.split_once(name) {
            out.push_str(before);
            out.push_str(part);
            rest = after;
        }
    }
    out.push_str(rest);
    out
}
