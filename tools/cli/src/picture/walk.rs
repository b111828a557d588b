//! `walk.png`: a robot under a command, at several instants.

use nalgebra::Point3;
use rigidformer_core::Plane;

use super::camera::Camera;
use super::film::{Column, Film, draw};
use crate::commanded::Drive;

const INSTANTS: u32 = 6;
const PANEL: (usize, usize) = (400, 400);
/// From ahead and aside of where it starts.
const AZIMUTH_RAD: f32 = -0.9;

/// Draws the robot at these frames, six evenly spaced ones without any; a PNG file.
pub(crate) fn walk(drive: &Drive<'_>, frames: &[u32]) -> anyhow::Result<Vec<u8>> {
    let (scene, walk) = (drive.scene, drive.walk);
    let (step, last) = (walk.step(), walk.last_frame());
    let frames: Vec<u32> = match frames {
        [] => (0..INSTANTS).map(|k| last / step * k / (INSTANTS - 1) * step).collect(),
        frames => frames.to_vec(),
    };
    let placed = |frame: u32, unit: usize| walk.pose(frame, unit);
    let points = frames.iter().flat_map(|frame| {
        scene.units().iter().enumerate().flat_map(move |(number, unit)| {
            let pose = placed(*frame, number);
            unit.points.iter().filter_map(move |point| Some(pose? * point))
        })
    });
    let points: Vec<Point3<f32>> = points.collect();
    let column = |frame: &u32| Column {
        time_s: drive.time_s(*frame),
        text: if *frame <= step { "observed".into() } else { String::new() },
        poses: vec![(0..scene.units().len()).map(|unit| placed(*frame, unit)).collect()],
        ..Column::default()
    };
    let ground = [Plane::ground(0.0, 0.0)];
    let command: Vec<String> = drive.command.iter().map(f32::to_string).collect();
    draw(&Film {
        title: format!("{} under the command {}", scene.name(), command.join(", ")),
        note: "",
        units: scene.units(),
        planes: scene.planes().unwrap_or(&ground),
        terrain: scene.height_field(),
        columns: frames.iter().map(column).collect(),
        rows: vec!["predicted"],
        surface: None,
        camera: Camera::fit(&points, AZIMUTH_RAD, PANEL.0, PANEL.1),
    })
}
