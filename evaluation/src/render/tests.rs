use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{Physics, Plane};

use super::*;
use crate::scenes::{SoftMesh, Split};

const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.2 };
const EXACT: DepthNoise = DepthNoise { deviation_at_1m_m: 0.0, edge_loss: 0.0, seed: 0 };

fn cuboid(half: [f32; 3]) -> Vec<Point3<f32>> {
    let corner = |i: usize, axis: usize| if i >> axis & 1 == 0 { -half[axis] } else { half[axis] };
    (0..8).map(|i| Point3::from([0, 1, 2].map(|axis| corner(i, axis)))).collect()
}

fn scene(units: Vec<RecordedUnit>) -> RecordedScene {
    RecordedScene::new("x", 1, Split::Test, 240.0, Vector3::zeros(), units)
        .unwrap()
        .with_planes(vec![Plane::ground(0.5, 0.5)])
        .unwrap()
}

/// A camera 2 m above the origin that looks straight down; the image's right is x.
fn above() -> Camera {
    let pose = Isometry3::new(Vector3::new(0.0, 0.0, 2.0), Vector3::x() * std::f32::consts::PI);
    Camera::new([160, 120], [123.0, 123.0], [80.0, 60.0], pose).unwrap()
}

#[test]
fn a_box_on_the_ground_has_its_depths_and_labels() {
    let pose = Isometry3::translation(0.0, 0.0, 0.25);
    let unit = RecordedUnit::new("box", cuboid([0.2, 0.1, 0.25]), WOOD, vec![pose]);
    let scene = scene(vec![unit]);
    let view = Renderer::new(&scene).unwrap().view(&above(), 0.0, 0.001, &EXACT, 0).unwrap();
    assert_eq!((view.depth[60 * 160 + 80], view.depth[0]), (1500, 2000));
    // Its top reaches 123 * 0.2 / 1.5 = 16.4 columns and 8.2 rows to each side; nothing else of it is seen from above.
    let labels = view.labels.as_ref().unwrap();
    assert_eq!(labels.iter().filter(|label| **label == 1).count(), 33 * 17);
    assert_eq!(labels.iter().filter(|label| **label == 0).count(), 160 * 120 - 33 * 17);
    let top = view.point(80 + 10, 60).unwrap();
    assert!((top - Point3::new(15.0 / 123.0, 0.0, 0.5)).norm() < 1e-5, "{top}");
}

#[test]
fn every_pixel_of_a_tilted_body_lies_on_its_surface_and_none_is_a_hole() {
    let half = [0.3, 0.2, 0.25];
    let pose = Isometry3::new(Vector3::new(0.1, -0.1, 0.8), Vector3::new(0.5, 0.3, 0.9));
    let scene = scene(vec![RecordedUnit::new("box", cuboid(half), WOOD, vec![pose])]);
    let renderer = Renderer::new(&scene).unwrap();
    for camera in cameras(&scene, [320, 240], 3).unwrap().into_iter().chain([above()]) {
        let view = renderer.view(&camera, 0.0, 0.0001, &EXACT, 0).unwrap();
        let [width, height] = camera.size();
        let labels = view.labels.as_ref().unwrap();
        let label = |column: u32, row: u32| labels[(row * width + column) as usize];
        let mut on = 0;
        for row in 0..height {
            for column in 0..width {
                let Some(point) = view.point(column, row) else { continue };
                if label(column, row) == 0 {
                    assert!(point.z.abs() < 1e-3, "the ground: {point}");
                    continue;
                }
                on += 1;
                let own = pose.inverse_transform_point(&point);
                let outside =
                    (0..3).map(|axis| own[axis].abs() - half[axis]).fold(f32::MIN, f32::max);
                assert!(outside.abs() < 1e-3, "{outside} at {column} {row}");
            }
            // A convex body has no gap in a row.
            let of_row: Vec<bool> = (0..width).map(|column| label(column, row) == 1).collect();
            let changes = of_row.windows(2).filter(|pair| pair[0] != pair[1]).count();
            assert!(changes <= 2, "row {row}");
        }
        assert!(on > 1000, "{on}");
    }
}

#[test]
fn nearer_things_hide_others_and_what_is_behind_is_not_seen() {
    let unit = |z: f32, half: f32| {
        RecordedUnit::new("x", cuboid([half; 3]), WOOD, vec![Isometry3::translation(0.0, 0.0, z)])
    };
    // One below another, and one behind the camera.
    let scene = scene(vec![unit(0.1, 0.1), unit(1.0, 0.3), unit(5.0, 1.0)]);
    let view = Renderer::new(&scene).unwrap().view(&above(), 0.0, 0.001, &EXACT, 0).unwrap();
    let labels = view.labels.unwrap();
    assert!(labels.contains(&2) && !labels.contains(&1) && !labels.contains(&3));
}

#[test]
fn a_surface_through_the_camera_is_cut_off() {
    // The camera is 10 cm above a long bar that goes below and behind it.
    let pose = Isometry3::new(Vector3::new(0.0, 0.0, 1.0), Vector3::y() * 0.3);
    let bar = RecordedUnit::new("bar", cuboid([50.0, 0.1, 0.5]), WOOD, vec![pose]);
    let scene = scene(vec![bar]);
    let eye = Isometry3::new(Vector3::new(0.0, 0.0, 2.0), Vector3::y() * 1.7);
    let camera = Camera::new([160, 120], [120.0, 120.0], [80.0, 60.0], eye).unwrap();
    let view = Renderer::new(&scene).unwrap().view(&camera, 0.0, 0.001, &EXACT, 0).unwrap();
    let labels = view.labels.unwrap();
    assert!(labels.iter().filter(|label| **label == 1).count() > 300);
}

#[test]
fn units_are_seen_between_frames_and_not_outside_of_the_record() {
    let poses = (0..=24).map(|frame| Isometry3::translation(0.0, 0.0, 0.2 + 0.01 * frame as f32));
    let unit = RecordedUnit::new("x", cuboid([0.2; 3]), WOOD, poses.collect());
    let scene = scene(vec![unit]);
    let renderer = Renderer::new(&scene).unwrap();
    let middle = |time_s: f64| {
        renderer.view(&above(), time_s, 0.0001, &EXACT, 0).map(|view| view.depth_m(80, 60).unwrap())
    };
    assert!((middle(0.0).unwrap() - 1.6).abs() < 1e-4);
    assert!((middle(4.5 / 240.0).unwrap() - 1.555).abs() < 1e-4);
    assert!((middle(0.1).unwrap() - 1.36).abs() < 1e-4);
    let text = middle(0.2).unwrap_err().to_string();
    assert!(text.contains("from 0 to 0.1 s"), "{text}");
    assert!(matches!(middle(f64::NAN), Err(RenderError::Time { .. })));
    assert!(matches!(middle(-0.1), Err(RenderError::Time { .. })));
}

#[test]
fn pieces_leave_their_hollow_open() {
    let upright = |x: f32| -> Vec<Point3<f32>> {
        cuboid([0.1, 0.3, 0.3]).into_iter().map(|point| point + Vector3::new(x, 0.0, 0.0)).collect()
    };
    let pieces: crate::convex_pieces::ConvexPieces =
        [upright(-0.3), upright(0.3)].into_iter().collect();
    let pose = Isometry3::translation(0.0, 0.0, 0.3);
    let unit =
        RecordedUnit::new("gate", pieces.points().to_vec(), WOOD, vec![pose]).with_pieces(pieces);
    let scene = scene(vec![unit]);
    let view = Renderer::new(&scene).unwrap().view(&above(), 0.0, 0.001, &EXACT, 0).unwrap();
    assert_eq!(view.depth[60 * 160 + 80], 2000, "the ground between them");
    let beside = view.depth_m(80 + 25, 60).unwrap();
    assert!((beside - 1.4).abs() < 1e-6);
}

#[test]
fn soft_units_are_their_triangles() {
    let sheet: Vec<Point3<f32>> = [[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]]
        .map(|[x, y]| Point3::new(x, y, 0.0))
        .into();
    let at = |z: f32| sheet.iter().map(|point| point + Vector3::z() * z).collect::<Vec<_>>();
    let unit = RecordedUnit::new("sheet", sheet.clone(), WOOD, vec![Isometry3::identity(); 2])
        .with_soft(vec![at(0.5), at(1.0)]);
    let bare = scene(vec![unit]);
    assert!(matches!(Renderer::new(&bare), Err(RenderError::NoSurface { unit: 0, .. })));
    let faces = vec![[0, 1, 3], [3, 2, 0]];
    let scene = bare.with_mesh(SoftMesh { faces, ..SoftMesh::default() }).unwrap();
    let renderer = Renderer::new(&scene).unwrap();
    let view = renderer.view(&above(), 0.5 / 240.0, 0.001, &EXACT, 0).unwrap();
    assert_eq!(view.depth[60 * 160 + 80], 1250);
    assert!(matches!(
        renderer.view(&above(), 1.0, 0.001, &EXACT, 0),
        Err(RenderError::Time { .. })
    ));
}

#[test]
fn wrong_input_is_named() {
    let flat: Vec<_> = (0..9).map(|i| Point3::new((i % 3) as f32, (i / 3) as f32, 0.0)).collect();
    let foul = scene(vec![RecordedUnit::new("plate", flat, WOOD, vec![Isometry3::identity()])]);
    let text = Renderer::new(&foul).err().unwrap().to_string();
    assert!(text.contains("unit 0 (plate)") && text.contains("no volume"), "{text}");
    let unit = RecordedUnit::new("x", cuboid([0.1; 3]), WOOD, vec![Isometry3::identity()]);
    let scene = scene(vec![unit]);
    let renderer = Renderer::new(&scene).unwrap();
    for noise in [
        DepthNoise { deviation_at_1m_m: f32::NAN, ..EXACT },
        DepthNoise { edge_loss: 1.5, ..EXACT },
        DepthNoise { deviation_at_1m_m: -0.1, ..EXACT },
    ] {
        let view = renderer.view(&above(), 0.0, 0.001, &noise, 0);
        assert!(matches!(view, Err(RenderError::Noise(_))));
    }
    for scale_m in [0.0, f32::NAN, -1.0] {
        let view = renderer.view(&above(), 0.0, scale_m, &EXACT, 0);
        assert!(matches!(view, Err(RenderError::Depth(_))));
    }
}

#[test]
fn the_same_arguments_give_the_same_bits() {
    let pose = Isometry3::translation(0.0, 0.0, 0.25);
    let scene = scene(vec![RecordedUnit::new("box", cuboid([0.2; 3]), WOOD, vec![pose])]);
    let renderer = Renderer::new(&scene).unwrap();
    let noise = DepthNoise { deviation_at_1m_m: 0.003, edge_loss: 0.3, seed: 5 };
    let view = |place| renderer.view(&above(), 0.0, 0.001, &noise, place).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(view(1), pool.install(|| view(1)));
    assert_ne!(view(1).depth, view(2).depth);
}

/// `cargo test -p rigidformer-runtime --lib -- --ignored --nocapture images_take_so_long`
#[test]
#[ignore = "a measurement"]
fn images_take_so_long() {
    let ball = |count: usize| -> Vec<Point3<f32>> {
        let at = |i: usize| {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / count as f32;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - z * z).sqrt();
            Point3::new(r * cos, r * sin, z) * 0.1
        };
        (0..count).map(at).collect()
    };
    let place =
        |i: usize| Isometry3::translation((i % 4) as f32 * 0.25, (i / 4) as f32 * 0.25, 0.1);
    let units = (0..10).map(|i| RecordedUnit::new("ball", ball(512), WOOD, vec![place(i)]));
    let scene = scene(units.collect());
    let renderer = Renderer::new(&scene).unwrap();
    let camera = cameras(&scene, [640, 480], 1).unwrap()[0];
    for deviation_at_1m_m in [0.0, 0.001] {
        let noise = DepthNoise { deviation_at_1m_m, edge_loss: 0.0, seed: 1 };
        let time = |place| {
            let start = std::time::Instant::now();
            renderer.view(&camera, 0.0, 0.001, &noise, place).unwrap();
            start.elapsed().as_secs_f64() * 1e3
        };
        let mut times: Vec<f64> = (0..31).map(time).collect();
        times.sort_by(f64::total_cmp);
        println!(
            "640 x 480, 10 units of 512 points, a plane, {deviation_at_1m_m} m of noise at 1 m: {:.2} ms, median {:.2}",
            times[0], times[15]
        );
    }
}
