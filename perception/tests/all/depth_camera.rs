//! A depth camera's images of a room. They are not part of this repository: `../shared/data/rgbd` beside it, or the folder that
//! `RIGIDFORMER_RGBD` names.

use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::{Matrix4, Point3, Rotation3, UnitQuaternion, Vector3};
use rigidformer_perception::capture::{DepthView, View};
use rigidformer_perception::recording;
use serde_json::{Value, json};

fn data() -> Option<PathBuf> {
    let named = std::env::var_os("RIGIDFORMER_RGBD").map(PathBuf::from);
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/rgbd");
    let folder = named.unwrap_or(beside);
    if folder.join("frames.json").is_file() {
        return Some(folder);
    }
    eprintln!(
        "SKIPPED: no depth images in {}; name their folder with RIGIDFORMER_RGBD",
        folder.display()
    );
    None
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// Writes the images that are there as a depth recording, from a file as align3d has it.
fn converted(from: &Path, to: &Path) -> usize {
    let known: Value =
        serde_json::from_slice(&fs::read(from.join("frames.json")).unwrap()).unwrap();
    let mut cameras = Vec::new();
    let mut frames = Vec::new();
    for frame in known["root"].as_array().unwrap() {
        let name = frame["depth_image"].as_str().unwrap();
        if !from.join(name).is_file() {
            continue;
        }
        fs::copy(from.join(name), to.join(name)).unwrap();
        let info = &frame["info"];
        let pose = &info["rt_cam"]["matrix"];
        let pose = Matrix4::from_fn(|row, column| number(&pose[row][column]));
        let turn = Rotation3::from_matrix(&pose.fixed_view::<3, 3>(0, 0).into_owned());
        let q = UnitQuaternion::from_rotation_matrix(&turn);
        let pose = json!([pose[(0, 3)], pose[(1, 3)], pose[(2, 3)], q.w, q.i, q.j, q.k]);
        if cameras.is_empty() {
            let (k, size) = (&info["kcam"]["matrix"], &info["kcam"]["image_size"]);
            cameras.push(json!({
                "name": "hand", "width": size[0], "height": size[1], "fx": k[0][0], "fy": k[1][1],
                "cx": k[0][2], "cy": k[1][2], "depth_scale_m": info["depth_scale"], "pose": pose,
            }));
        }
        let time_s = number(&info["timestamp"]) / 1e6;
        frames.push(json!({"time_s": time_s, "camera": "hand", "depth": name, "pose": pose}));
    }
    let count = frames.len();
    let json =
        json!({"format": "rigidformer-depth", "version": 1, "cameras": cameras, "frames": frames});
    fs::write(to.join("frames.json"), json.to_string()).unwrap();
    count
}

/// (row, column) Points of the world where there are any, every eighth.
fn points(view: &DepthView) -> Vec<Option<Point3<f32>>> {
    let [width, height] = view.camera.size();
    let at = (0..height)
        .step_by(8)
        .flat_map(|row| (0..width).step_by(8).map(move |column| (column, row)));
    at.map(|(column, row)| view.point(column, row)).collect()
}

#[test]
fn a_room_has_sane_distances_and_stands_still() {
    let Some(data) = data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let count = converted(&data, folder.path());
    let captures = recording::open(folder.path()).unwrap();
    assert_eq!(captures.count_left(), Some(count));
    assert!(count >= 2, "{count} images");
    let views: Vec<DepthView> = captures
        .map(|capture| match capture.unwrap().views.pop() {
            Some(View::Depth(view)) => view,
            _ => panic!("no depth"),
        })
        .collect();

    let first = &views[0];
    let measured: Vec<f32> = first
        .depth
        .iter()
        .filter(|depth| **depth > 0)
        .map(|depth| f32::from(*depth) * first.scale_m)
        .collect();
    let share = measured.len() as f32 / first.depth.len() as f32;
    let (near, far) =
        measured.iter().fold((f32::MAX, 0.0_f32), |(near, far), z| (near.min(*z), far.max(*z)));
    println!("{count} images, {share:.2} measured, from {near} to {far} m");
    assert!(share > 0.5 && near > 0.2 && far < 12.0, "{share} {near} {far}");

    // A room is metres wide and high, not millimetres or kilometres.
    let seen: Vec<Point3<f32>> = points(first).into_iter().flatten().collect();
    let low = seen.iter().fold(Vector3::repeat(f32::MAX), |low, point| low.inf(&point.coords));
    let high = seen.iter().fold(Vector3::repeat(f32::MIN), |high, point| high.sup(&point.coords));
    let size = high - low;
    println!("{size:?} m");
    assert!(size.iter().all(|side| (0.5..10.0).contains(side)), "{size}");

    // What one image sees, another sees at the same place, since nothing moves: intrinsics, scale and poses fit together.
    for view in &views[1..] {
        let mut off: Vec<f32> = Vec::new();
        for point in &seen {
            let Some(([column, row], z_m)) = view.camera.pixel(point) else { continue };
            if column < 0.0 || row < 0.0 {
                continue;
            }
            if let Some(depth_m) = view.depth_m(column.round() as u32, row.round() as u32) {
                off.push((depth_m - z_m).abs());
            }
        }
        off.sort_by(f32::total_cmp);
        let median = off[off.len() / 2];
        println!("{} points in common, half of them within {:.1} mm", off.len(), median * 1e3);
        assert!(off.len() > seen.len() / 2 && median < 0.02, "{} {median}", off.len());
    }
}
