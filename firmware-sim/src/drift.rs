//! How far two rollouts of the same scenes are apart.

use std::collections::BTreeSet;

use rigidformer_evaluation::figures::{FRAMES, LAST_FRAME};
use rigidformer_evaluation::metrics::angle_deg;
use rigidformer_evaluation::predicted::Predicted;
use rigidformer_evaluation::scenes::RecordedScene;

use crate::report::{Drift, PointDrift, Spread};

/// Drift over all rigid units of all scenes at every predicted frame and at [`FRAMES`].
pub(crate) fn over_time(
    scenes: &[RecordedScene],
    float: &[Predicted],
    quantised: &[Predicted],
) -> Vec<Drift> {
    frames(float).into_iter().map(|frame| at(scenes, float, quantised, frame)).collect()
}

/// Drift of all soft points of all scenes at the same frames; none where there are no such points.
pub(crate) fn of_points(float: &[Predicted], quantised: &[Predicted]) -> Vec<PointDrift> {
    let of = |frame| points_at(float, quantised, frame);
    frames(float).into_iter().map(of).filter(|drift| drift.points > 0).collect()
}

fn frames(float: &[Predicted]) -> BTreeSet<u32> {
    let sampled = float.iter().flat_map(|of| of.poses.iter().map(|(frame, _)| frame));
    // Tables read these frames also where no sample is at them.
    sampled.chain(FRAMES).filter(|frame| *frame <= LAST_FRAME).collect()
}

fn points_at(float: &[Predicted], quantised: &[Predicted], frame: u32) -> PointDrift {
    let (mut distances, mut apart) = (Vec::new(), 0);
    for (float, quantised) in float.iter().zip(quantised) {
        let at = |of: &Predicted| of.points.as_ref()?.between(frame);
        let (Some(float), Some(quantised)) = (at(float), at(quantised)) else { continue };
        for (a, b) in float.iter().zip(&quantised) {
            // Bits are compared, because points that nothing touches are equal in every bit.
            apart += usize::from(a != b);
            distances.push((a.coords.cast::<f64>() - b.coords.cast::<f64>()).norm());
        }
    }
    PointDrift { frame, points: distances.len(), apart, distance_m: spread(distances) }
}

fn at(scenes: &[RecordedScene], float: &[Predicted], quantised: &[Predicted], frame: u32) -> Drift {
    let mut position = Vec::new();
    let mut orientation = Vec::new();
    let (mut apart_m, mut apart_deg) = (Vec::new(), Vec::new());
    for (scene, (float, quantised)) in scenes.iter().zip(float.iter().zip(quantised)) {
        // A soft unit's pose is a fit, whose difference says little of its points.
        let rigid = scene.units().iter().enumerate().filter(|(_, unit)| unit.soft.is_none());
        for (unit, _) in rigid {
            let poses = (float.poses.pose(frame, unit), quantised.poses.pose(frame, unit));
            let (Some(float), Some(quantised)) = poses else { continue };
            let apart =
                float.translation.vector.cast::<f64>() - quantised.translation.vector.cast::<f64>();
            let turned = angle_deg(&float, &quantised);
            position.push(apart.norm());
            orientation.push(turned);
            // Units that nothing touches do not drift and would pull the median to 0.
            if float != quantised {
                apart_m.push(apart.norm());
                apart_deg.push(turned);
            }
        }
    }
    Drift {
        frame,
        units: position.len(),
        apart: apart_m.len(),
        position_m: spread(position),
        orientation_deg: spread(orientation),
        apart_median_m: spread(apart_m).median,
        apart_median_deg: spread(apart_deg).median,
    }
}

pub(crate) fn spread(mut values: Vec<f64>) -> Spread {
    values.sort_by(f64::total_cmp);
    Spread {
        median: quantile(&values, 0.5),
        p95: quantile(&values, 0.95),
        max: quantile(&values, 1.0),
    }
}

/// A quantile of ascending values, interpolated between neighbours; 0 for none.
fn quantile(ascending: &[f64], share: f64) -> f64 {
    let at = share * ascending.len().saturating_sub(1) as f64;
    let value = |index: f64| ascending.get(index as usize).copied().unwrap_or(0.0);
    let (low, high) = (value(at.floor()), value(at.ceil()));
    low + (high - low) * at.fract()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_neighbours() {
        let spread = spread(vec![3.0, 1.0, 2.0, 4.0]);
        assert_eq!((spread.median, spread.max), (2.5, 4.0));
        assert!((spread.p95 - 3.85).abs() < 1e-12);
        assert_eq!(quantile(&[], 0.5), 0.0);
        assert_eq!(quantile(&[7.0], 0.95), 7.0);
    }
}
