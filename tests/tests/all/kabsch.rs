//! The rigid fit against nalgebra's SVD (f64), and where that has no answer.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Matrix3, Vector3};
use rigidformer_core::geometry::{Fit, Rank, kabsch};
use rigidformer_tests::Random;

type Anchors = [Vector3<f32>; 4];

/// Textbook Kabsch in f64.
fn oracle(reference: &Anchors, target: &Anchors) -> (Matrix3<f64>, Vector3<f64>) {
    let mean = |p: &Anchors| p.iter().map(|v| v.cast::<f64>()).sum::<Vector3<f64>>() / 4.0;
    let (from, to) = (mean(reference), mean(target));
    let mut h = Matrix3::zeros();
    for (r, t) in reference.iter().zip(target) {
        h += (r.cast::<f64>() - from) * (t.cast::<f64>() - to).transpose();
    }
    let svd = h.svd(true, true);
    let (u, v) = (svd.u.unwrap(), svd.v_t.unwrap().transpose());
    let d = Vector3::new(1.0, 1.0, (v * u.transpose()).determinant().signum());
    let rotation = v * Matrix3::from_diagonal(&d) * u.transpose();
    (rotation, to - rotation * from)
}

fn cost(
    rotation: &Matrix3<f64>,
    shift: &Vector3<f64>,
    reference: &Anchors,
    target: &Anchors,
) -> f64 {
    let pairs = reference.iter().zip(target);
    pairs.map(|(r, t)| (rotation * r.cast::<f64>() + shift - t.cast::<f64>()).norm_squared()).sum()
}

fn assert_rotation(fit: &Fit) {
    let r = fit.pose.rotation.cast::<f64>();
    assert!(r.iter().all(|v| v.is_finite()), "{r}");
    assert!(fit.pose.centre.iter().all(|v| v.is_finite()));
    assert!((r.determinant() - 1.0).abs() < 2e-6, "determinant {}", r.determinant());
    assert!((r.transpose() * r - Matrix3::identity()).norm() < 2e-6, "not orthogonal");
}

fn anchors(random: &mut Random, scale: f32) -> Anchors {
    std::array::from_fn(|_| random.vector() * scale)
}

/// A moved, disturbed copy.
fn moved(random: &mut Random, reference: &Anchors, noise: f32, shift: f32) -> Anchors {
    let rotation = random.rotation();
    let shift = random.vector() * shift;
    reference.map(|p| rotation * p + shift + random.vector() * noise)
}

/// 100,000 random sets, noise from none to as large as the set: the same rotation as the
/// oracle where it is well determined, and never a worse fit.
#[test]
fn equals_the_svd_of_nalgebra() {
    let mut random = Random(1);
    let (mut worst_angle, mut compared) = (0.0_f64, 0);
    for i in 0..100_000 {
        let scale = 0.2 + random.uniform().abs();
        let reference = anchors(&mut random, scale);
        let noise = [0.0, 0.01, 0.1, 1.0][i % 4] * scale;
        let target = moved(&mut random, &reference, noise, 5.0);
        let fit = kabsch(&reference, &target, &Matrix3::identity());
        assert_rotation(&fit);
        let (rotation, shift) = oracle(&reference, &target);
        let mine = cost(&fit.pose.rotation.cast(), &fit.pose.centre.cast(), &reference, &target);
        let best = cost(&rotation, &shift, &reference, &target);
        // The targets themselves carry f32 rounding of coordinates up to 6 m.
        assert!(mine <= best * (1.0 + 1e-4) + 1e-10, "set {i}: {mine} against {best}");
        if noise <= 0.1 * scale && spread(&reference) > 0.1 * scale {
            let angle = (fit.pose.rotation.cast::<f64>() - rotation).norm();
            worst_angle = worst_angle.max(angle);
            compared += 1;
        }
    }
    println!("{compared} rotations compared, worst difference {worst_angle:.1e}");
    assert!(compared > 50_000 && worst_angle < 2e-4, "{compared}: {worst_angle}");
}

/// The second singular value of the centred set: how far from a line it is.
fn spread(points: &Anchors) -> f32 {
    let mean = points.iter().sum::<Vector3<f32>>() / 4.0;
    let mut values: Vec<f32> = nalgebra::Matrix3x4::from_columns(&points.map(|p| p - mean))
        .singular_values()
        .iter()
        .copied()
        .collect();
    values.sort_by(f32::total_cmp);
    values[1]
}

#[test]
fn huge_and_tiny_sets() {
    let mut random = Random(2);
    for exponent in [-18, -12, -6, -3, 3, 6, 12, 18] {
        for _ in 0..500 {
            let scale = 10.0_f32.powi(exponent);
            let reference = anchors(&mut random, scale);
            let rotation = random.rotation();
            let target = reference.map(|p| rotation * p);
            let fit = kabsch(&reference, &target, &Matrix3::identity());
            assert_rotation(&fit);
            if spread(&reference) > 0.2 * scale {
                let error = (fit.pose.rotation - rotation.to_rotation_matrix().matrix()).norm();
                assert!(error < 2e-5, "scale 1e{exponent}: {error}");
            }
        }
    }
}

/// A mirrored set has no exact answer: the best proper rotation is returned.
#[test]
fn mirrored_sets_stay_proper() {
    let mut random = Random(3);
    for _ in 0..5_000 {
        let reference = anchors(&mut random, 1.0);
        let rotation = random.rotation();
        let target = reference.map(|p| rotation * Vector3::new(p.x, p.y, -p.z));
        let fit = kabsch(&reference, &target, &Matrix3::identity());
        assert_rotation(&fit);
        let (best, shift) = oracle(&reference, &target);
        let mine = cost(&fit.pose.rotation.cast(), &fit.pose.centre.cast(), &reference, &target);
        assert!(mine <= cost(&best, &shift, &reference, &target) * (1.0 + 1e-4) + 1e-9);
    }
}

/// Collinear anchors leave the turn about their line open: the answer carries the line
/// onto its target and otherwise keeps the previous rotation.
#[test]
fn collinear_sets_keep_the_previous_turn() {
    let mut random = Random(4);
    for _ in 0..5_000 {
        let axis = random.rotation() * Vector3::x();
        let reference = [-1.0, -0.3, 0.4, 1.1].map(|s| axis * s);
        let previous = random.rotation();
        let swing = random.rotation();
        let target = reference.map(|p| swing * p + Vector3::new(1.0, 2.0, 3.0));
        let fit = kabsch(&reference, &target, previous.to_rotation_matrix().matrix());
        assert_rotation(&fit);
        assert_eq!(fit.rank, Rank::Line);
        for (r, t) in reference.iter().zip(&target) {
            assert!((fit.pose.apply(r) - t).norm() < 2e-5);
        }
        // The least turn from the previous rotation that does so.
        let from = previous * axis;
        let to = swing * axis;
        let least = from.cross(&to).norm().atan2(from.dot(&to));
        let turn = fit.pose.rotation * previous.to_rotation_matrix().matrix().transpose();
        let skew = turn - turn.transpose();
        let sine = Vector3::new(skew.m32, skew.m13, skew.m21).norm() / 2.0;
        let angle = sine.atan2((turn.trace() - 1.0) / 2.0);
        assert!((angle - least).abs() < 1e-5, "{angle} against {least}");
    }
    // Exactly opposite: half a turn.
    let line = [-1.0, 0.0, 1.0, 2.0].map(|s| Vector3::new(s, 0.0, 0.0));
    let fit = kabsch(&line, &line.map(|p| -p), &Matrix3::identity());
    assert_rotation(&fit);
    assert!((fit.pose.rotation * Vector3::x() + Vector3::x()).norm() < 1e-6);
}

#[test]
fn coincident_sets_keep_the_previous_rotation() {
    let mut random = Random(5);
    let previous = random.rotation().to_rotation_matrix();
    let point = [Vector3::new(0.3, -2.0, 1.0); 4];
    let spread_out = anchors(&mut random, 1.0);
    for (reference, target) in [(point, spread_out), (spread_out, point), (point, point)] {
        let fit = kabsch(&reference, &target, previous.matrix());
        assert_eq!(fit.rank, Rank::Point);
        assert_eq!(fit.pose.rotation, *previous.matrix());
        assert_rotation(&fit);
    }
}

/// Near every border between the cases, the answer is a rotation.
#[test]
fn nearly_degenerate_sets_are_rotations() {
    let mut random = Random(6);
    for i in 0..50_000 {
        let flat = 10.0_f32.powi(-(i % 9));
        let thin = 10.0_f32.powi(-(i / 9 % 9));
        let rotation = random.rotation();
        let reference = anchors(&mut random, 1.0)
            .map(|p| rotation * Vector3::new(p.x, p.y * thin, p.z * thin * flat));
        let target = moved(&mut random, &reference, thin * flat, 1.0);
        assert_rotation(&kabsch(
            &reference,
            &target,
            random.rotation().to_rotation_matrix().matrix(),
        ));
    }
}
