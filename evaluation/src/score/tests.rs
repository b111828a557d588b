use std::sync::Arc;

use nalgebra::{Isometry3, Matrix6, Point3, UnitQuaternion, Vector3, Vector6};
use rigidformer_core::Physics;
use rigidformer_perception::estimate::Rest;

use super::surface::tests::{ball, cuboid};
use super::*;
use crate::scenes::{RecordedUnit, Split};

const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.2 };
const HZ: f64 = 30.0;
const FRAMES: usize = 10;

/// A cube that turns and slides, 30 cm beside a ball at rest.
fn scene() -> RecordedScene {
    let turning = |frame: usize| {
        let at = frame as f32;
        Isometry3::new(Vector3::new(0.02 * at, 0.0, 0.1), Vector3::new(0.0, 0.1, 0.2) * at)
    };
    let cube =
        RecordedUnit::new("cube", cuboid([0.05; 3]), WOOD, (0..FRAMES).map(turning).collect());
    let place = Isometry3::translation(0.0, 0.3, 0.08);
    let ball = RecordedUnit::new("ball", ball(0.08, 256), WOOD, vec![place; FRAMES]);
    RecordedScene::new("two", 1, Split::Test, HZ as f32, Vector3::zeros(), vec![cube, ball])
        .unwrap()
}

/// A track with a unit's points, `frame` being its own reference frame in the unit's body frame.
fn track(
    id: u32,
    points: &[Point3<f32>],
    pose: Isometry3<f32>,
    frame: Isometry3<f32>,
) -> UnitEstimate {
    UnitEstimate {
        id,
        pose: pose * frame,
        covariance: Matrix6::zeros(),
        velocity: Vector6::zeros(),
        velocity_covariance: Matrix6::zeros(),
        points: points.iter().map(|point| frame.inverse() * point).collect::<Arc<[_]>>(),
        visibility: Visibility::Seen,
        rest: Rest::Moving,
    }
}

fn time_s(frame: usize) -> f64 {
    frame as f64 / HZ
}

/// Estimates of all frames, made of each frame's true tracks by `change`.
fn estimates(
    scene: &RecordedScene,
    change: impl Fn(usize, &mut Vec<UnitEstimate>),
) -> Vec<Estimate> {
    let frame_of = |unit: usize| {
        Isometry3::new(Vector3::new(0.01, -0.02, 0.03 * unit as f32), Vector3::new(0.3, 1.0, -0.5))
    };
    (0..FRAMES)
        .map(|frame| {
            let units = scene.units().iter().enumerate();
            let mut tracks: Vec<_> = units
                .map(|(unit, recorded)| {
                    let pose = recorded.poses[frame];
                    track(unit as u32 + 10, &recorded.points, pose, frame_of(unit))
                })
                .collect();
            change(frame, &mut tracks);
            Estimate { time_s: time_s(frame), units: tracks }
        })
        .collect()
}

fn scored(change: impl Fn(usize, &mut Vec<UnitEstimate>)) -> Score {
    let scene = scene();
    score(&scene, &[], &estimates(&scene, change), &[], &Settings::default()).unwrap()
}

#[test]
fn the_truth_has_no_errors_whatever_the_tracks_frames() {
    let score = scored(|_, _| ());
    assert_eq!((score.captures, score.units), (FRAMES, 2));
    assert_eq!((score.found, score.findable, score.found_share), (20, 20, Some(1.0)));
    assert_eq!(score.losses, Losses::default());
    assert!(score.seen.translation_m.max < 1e-6 && score.seen.surface_m.max < 1e-6, "{score:?}");
    assert!(score.seen.rotation_deg.max < 1e-3, "{score:?}");
    assert_eq!(
        (score.seen.translation_m.count, score.seen.rotation_deg.count),
        (20, 10),
        "balls do not turn"
    );
    assert_eq!(score.by_unit[1].tracks, [11]);
    assert_eq!(score.by_unit[0].shape, "cube");
}

#[test]
fn offsets_and_turns_are_measured() {
    // Half of the frames 4 mm to one side, the others to the other: the alignment is between.
    let score = scored(|frame, tracks| {
        let side = if frame % 2 == 0 { 0.002 } else { -0.002 };
        tracks[1].pose = Isometry3::translation(0.0, 0.0, side) * tracks[1].pose;
    });
    let ball = &score.by_unit[1].seen;
    assert!((ball.translation_m.rms - 0.002).abs() < 1e-5, "{ball:?}");
    assert!(
        (0.0005..0.002).contains(&ball.surface_m.rms),
        "half of a ball's points move along it: {ball:?}"
    );
    let score = scored(|frame, tracks| {
        let turn = if frame % 2 == 0 { 2.0_f32 } else { -2.0 };
        let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, turn.to_radians());
        let centre = Point3::from(scene().units()[0].poses[frame].translation.vector);
        tracks[0].pose = Isometry3::rotation_wrt_point(turn, centre) * tracks[0].pose;
        // A ball may turn as it likes.
        let centre = Point3::new(0.0, 0.3, 0.08);
        let turn = UnitQuaternion::from_euler_angles(0.3 * frame as f32, 0.0, 0.0);
        tracks[1].pose = Isometry3::rotation_wrt_point(turn, centre) * tracks[1].pose;
    });
    let [cube, ball] = [0, 1].map(|unit| score.by_unit[unit].seen);
    assert!((cube.rotation_deg.rms - 2.0).abs() < 0.05, "{cube:?}");
    assert!(cube.translation_m.rms < 1e-4, "{cube:?}");
    assert_eq!(ball.rotation_deg.count, 0);
    assert!(ball.translation_m.max < 1e-3 && ball.surface_m.max < 2e-3, "{ball:?}");
}

#[test]
fn losses_have_kinds() {
    // Frames 0 to 3: the cube has no track. 4, 5: the ball's track lies on the cube. 6: both have a second track. 7: a track in the air.
    let score = scored(|frame, tracks| match frame {
        1..=3 => drop(tracks.remove(0)),
        4 | 5 => {
            let (cube, ball) = (tracks[0].clone(), tracks.remove(1));
            tracks[0] = UnitEstimate { id: ball.id, ..cube };
        }
        6 => {
            let more =
                tracks.clone().into_iter().map(|track| UnitEstimate { id: track.id + 10, ..track });
            tracks.extend(more.collect::<Vec<_>>());
        }
        7 => {
            let mut one = tracks[0].clone();
            (one.id, one.pose.translation.z) = (99, 5.0);
            tracks.push(one);
        }
        8 => tracks[0].id = 50,
        _ => (),
    });
    let losses = score.losses;
    assert_eq!((losses.lost, losses.swapped, losses.split, losses.false_tracks), (3 + 2, 2, 2, 1));
    assert_eq!((losses.merged, losses.unseen), (0, 0));
    // To 50, and back.
    assert_eq!((losses.renewed, &score.by_unit[0].tracks), (2, &vec![10, 50, 10]));
    assert_eq!(score.findable - score.found, losses.lost + losses.swapped + losses.merged);
}

#[test]
fn one_track_on_two_units_is_merged() {
    let score = scored(|_, tracks| {
        let cube = tracks.remove(0);
        let ball = &mut tracks[0];
        // Eight points of the cube among forty of the ball.
        let carried = ball.pose.inverse() * cube.pose;
        let few = ball.points.iter().step_by(7).copied();
        ball.points = few.chain(cube.points.iter().map(|point| carried * point)).collect();
    });
    assert_eq!((score.losses.merged, score.losses.lost), (FRAMES, 0));
    assert_eq!(score.by_unit[1].found, FRAMES);
}

#[test]
fn what_is_hardly_visible_is_not_expected() {
    let scene = scene();
    let pixels = |frame: usize| vec![if frame < 4 { 99 } else { 100 }, 5000];
    let seen: Vec<_> =
        (0..FRAMES).map(|frame| Seen { time_s: time_s(frame), pixels: pixels(frame) }).collect();
    let tracks = estimates(&scene, |frame, tracks| {
        if frame < 6 {
            drop(tracks.remove(0))
        }
    });
    let score = score(&scene, &seen, &tracks, &[], &Settings::default()).unwrap();
    assert_eq!((score.losses.unseen, score.losses.lost), (4, 2));
    assert_eq!((score.by_unit[0].findable, score.by_unit[0].found), (6, 4));
}

#[test]
fn hidden_tracks_and_predictions_have_errors_of_their_own() {
    let scene = scene();
    let tracks = estimates(&scene, |frame, tracks| {
        if frame == 7 {
            tracks[0].visibility = Visibility::Hidden;
            tracks[0].pose.translation.z += 0.3;
        }
    });
    let ahead = |made: usize, frame: usize, off_m: f32| {
        let off = Isometry3::translation(0.0, off_m, 0.0);
        let pose = off * tracks[if frame == 7 { 6 } else { frame }].units[0].pose;
        Prediction {
            made_at_s: time_s(made),
            time_s: time_s(frame),
            poses: vec![(10, pose), (77, pose)],
        }
    };
    let beyond = Prediction { made_at_s: 0.0, time_s: 99.0, poses: Vec::new() };
    let predictions = [ahead(0, 3, 0.01), ahead(3, 6, 0.03), ahead(4, 5, 0.02), beyond];
    let score = score(&scene, &[], &tracks, &predictions, &Settings::default()).unwrap();
    assert_eq!(score.unseen.translation_m.count, 1);
    assert!((score.unseen.translation_m.max - 0.3).abs() < 1e-4);
    assert_eq!(score.losses.lost, 1, "it is not where it was predicted");
    let rows: Vec<_> = score.predictions.iter().map(|row| (row.ahead_s, row.unknown)).collect();
    assert_eq!(rows, [(0.033, 1), (0.1, 2)]);
    let error = score.predictions[1].errors.translation_m;
    assert!((error.max - 0.03).abs() < 1e-5 && (error.median - 0.01).abs() < 1e-5, "{error:?}");
}

#[test]
fn wrong_input_is_named() {
    let scene = scene();
    let tracks = estimates(&scene, |_, _| ());
    let usual = Settings::default();
    let failed = |estimates: &[Estimate], settings| {
        score(&scene, &[], estimates, &[], &settings).unwrap_err().to_string()
    };
    assert!(failed(&tracks, Settings { near: f32::NAN, ..usual }).contains("near"));
    assert!(failed(&tracks, Settings { findable_pixels: 0, ..usual }).contains("at least 1"));
    let mut back = tracks.clone();
    back.swap(1, 2);
    assert!(failed(&back, usual).contains("order of their times"));
    back[1].time_s = f64::NAN;
    assert!(failed(&back[..2], usual).contains("NaN"));
    let mut late = tracks.clone();
    late.iter_mut().for_each(|estimate| estimate.time_s += 100.0);
    assert!(failed(&late, usual).contains("same instant"));
    assert!(failed(&[], usual).contains("no estimate"));
    let mut lost = tracks.clone();
    lost[3].units[1].pose.translation.x = f32::NAN;
    assert!(failed(&lost, usual).contains("track 11"));
    let empty = [Estimate { time_s: 0.0, units: Vec::new() }];
    let nothing = score(&scene, &[], &empty, &[], &usual).unwrap();
    assert_eq!((nothing.found, nothing.losses.lost), (0, 2));
    let json = serde_json::to_string(&nothing).unwrap();
    assert!(json.contains("\"false_tracks\":0"), "{json}");
}

/// Covariances that are a quarter, one and a hundred times the variance of the errors, and none at all.
#[test]
fn claims_of_covariances_are_counted() {
    // Errors of a normal distribution along one axis, by its quantiles, in centimetres.
    let errors = [-1.64, -1.04, -0.67, -0.39, -0.13, 0.13, 0.39, 0.67, 1.04, 1.64];
    let share = |variance: Option<f32>, turned: bool| {
        let score = scored(|frame, tracks| {
            for track in tracks {
                let way = Vector3::new(0.0, 0.0, 0.01 * errors[frame]);
                track.pose.translation.vector += way;
                let along = variance.map_or(0.0, |factor| 1e-4 * factor);
                let across = variance.map_or(0.0, |_| 4e-6);
                let [x, z] = if turned { [along, across] } else { [across, along] };
                track.covariance.fixed_view_mut::<3, 3>(0, 0).set_diagonal(&[x, across, z].into());
            }
        });
        score.expected_share.unwrap()
    };
    assert_eq!(share(Some(1.0), false), 1.0);
    // Three degrees of freedom allow 2.8 deviations, so 1.4 of half of them.
    assert_eq!(share(Some(0.25), false), 0.8);
    assert!(share(Some(100.0), true) < 0.5);
    assert_eq!(share(None, false), 0.0);
}
