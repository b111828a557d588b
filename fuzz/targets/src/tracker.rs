//! Any captures of depth images and clouds, sound and unsound, of boxes over a plane: a refused capture leaves the estimate, and what is
//! estimated is finite.

use crate::structured::structured;
use arbitrary::Arbitrary;
use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_perception::camera::Camera;
use rigidformer_perception::capture::{Capture, Cloud, DepthView, View};
use rigidformer_perception::tracker::{Segmentation, Tracker, TrackerOptions};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_tests::hostile::{SMALLEST_IMPACT, random_model};
use std::sync::LazyLock;

static MODEL: LazyLock<LoadedModel> = LazyLock::new(|| {
    LoadedModel::copy_of("fuzzed", &random_model(SMALLEST_IMPACT, 3)).expect("sound")
});

const WIDTH: usize = 40;
const HEIGHT: usize = 30;

/// Part of an image at another depth.
#[derive(Arbitrary, Debug)]
struct Patch {
    corner: [u8; 2],
    size: [u8; 2],
    depth: u16,
    label: u8,
}

/// Part of a cloud: a grid of points.
#[derive(Arbitrary, Debug)]
struct Sheet {
    corner: [i16; 3],
    sides: [[i8; 3]; 2],
    count: [u8; 2],
    label: u8,
}

#[derive(Arbitrary, Debug)]
enum Seen {
    Depth { place: [i16; 3], background: u16, patches: Vec<Patch>, labels: bool, spoilt: u8 },
    Cloud { sheets: Vec<Sheet>, sensor: Option<[i16; 3]>, labels: bool, spoilt: Option<(u8, u8)> },
}

#[derive(Arbitrary, Debug)]
struct Frame {
    /// Hundredths of a second since the one before.
    after: i8,
    seen: Vec<Seen>,
}

#[derive(Arbitrary, Debug)]
struct Run {
    given: bool,
    has_model: bool,
    ahead: u8,
    frames: Vec<Frame>,
}

fn place(numbers: [i16; 3]) -> Vector3<f32> {
    Vector3::from(numbers.map(|number| f32::from(number) / 4096.0))
}

impl Seen {
    fn view(&self) -> Option<View> {
        match self {
            Seen::Depth { place: at, background, patches, labels, spoilt } => {
                let mut depth = vec![*background; WIDTH * HEIGHT];
                let mut label = vec![0; WIDTH * HEIGHT];
                for patch in patches.iter().take(6) {
                    let [left, top] = patch.corner.map(usize::from);
                    let [width, height] = patch.size.map(usize::from);
                    for (row, column) in (top % HEIGHT..HEIGHT)
                        .take(height)
                        .flat_map(|row| (left % WIDTH..WIDTH).take(width).map(move |at| (row, at)))
                    {
                        depth[row * WIDTH + column] = patch.depth;
                        label[row * WIDTH + column] = patch.label.into();
                    }
                }
                let eye = Point3::from(place(*at)) + Vector3::z();
                let pose = Isometry3::face_towards(&eye, &Point3::origin(), &Vector3::y());
                let sound = pose.translation.vector.iter().all(|v| v.is_finite());
                let camera = Camera::new([40, 30], [35.0; 2], [20.0, 15.0], pose);
                let camera = camera.ok().filter(|_| sound)?;
                let labels = labels.then_some(label);
                let mut view = DepthView::new(camera, 0.001, depth, labels).ok()?;
                match spoilt {
                    1 => drop(view.depth.pop()),
                    2 => view.scale_m = f32::NAN,
                    3 => view.scale_m = 1e30,
                    4 => view.scale_m = 1e-30,
                    _ => {}
                }
                Some(View::Depth(view))
            }
            Seen::Cloud { sheets, sensor, labels, spoilt } => {
                let mut cloud = Cloud::default();
                let mut all_labels = Vec::new();
                for sheet in sheets.iter().take(6) {
                    let [a, b] = sheet.sides.map(|side| side.map(|v| f32::from(v) / 2048.0).into());
                    let [rows, columns] = sheet.count.map(|count| u16::from(count % 24));
                    for (row, column) in (0..rows).flat_map(|i| (0..columns).map(move |j| (i, j))) {
                        let (row, column): (f32, f32) = (row.into(), column.into());
                        let (a, b): (Vector3<f32>, Vector3<f32>) = (a, b);
                        let point = place(sheet.corner) + a * row + b * column;
                        cloud.points.push(point.into());
                        all_labels.push(sheet.label.into());
                    }
                }
                if let Some((at, kind)) = spoilt {
                    let wrong = [f32::NAN, f32::INFINITY, 1e6, 1.1e6, -1e38, 1e-42, 0.0];
                    let length = cloud.points.len().max(1);
                    if let Some(point) = cloud.points.get_mut(usize::from(*at) % length) {
                        point.x = wrong[usize::from(*kind) % wrong.len()];
                    }
                    if *kind > 250 {
                        all_labels.pop();
                    }
                }
                cloud.sensor = sensor.map(|at| place(at).into());
                cloud.labels = labels.then_some(all_labels);
                Some(View::Cloud(cloud))
            }
        }
    }
}

/// Handles an input.
pub fn run(data: &[u8]) {
    let Some(input) = structured::<Run>(data) else { return };
    let mut options = TrackerOptions::default();
    options.model = input.has_model.then(|| MODEL.clone());
    if input.given {
        options.segmentation = Segmentation::Given;
    }
    let mut tracker = Tracker::new(options).expect("sound options");
    let mut time_s = 0.0;
    for frame in input.frames.iter().take(8) {
        time_s += f64::from(frame.after) / 100.0;
        let views = frame.seen.iter().take(3).filter_map(Seen::view).collect();
        let before = tracker.estimate().clone();
        if tracker.observe(&Capture { time_s, views }).is_err() {
            assert_eq!(before, *tracker.estimate(), "a refused capture changed the estimate");
        }
        let estimate = tracker.estimate();
        assert!(estimate.units.is_sorted_by_key(|unit| unit.id), "units out of order");
        for unit in &estimate.units {
            let pose = unit.pose.translation.vector.iter().chain(unit.pose.rotation.coords.iter());
            let mut numbers = pose
                .chain(unit.velocity.iter())
                .chain(unit.covariance.iter())
                .chain(unit.velocity_covariance.iter())
                .chain(unit.points.iter().flat_map(|point| point.iter()));
            assert!(numbers.all(|number| number.is_finite()), "unit {}: not finite", unit.id);
        }
    }
    if let Ok(forecast) = tracker.predict(f64::from(input.ahead) / 100.0) {
        let poses = forecast.poses.iter().flatten();
        let mut numbers = poses.flat_map(|(_, pose)| pose.translation.vector.iter());
        assert!(numbers.all(|number| number.is_finite()), "a forecast that is not finite");
    }
}
