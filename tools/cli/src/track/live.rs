//! Frames from a pipe: a line of JSON for each capture. Memory does not grow with time.

use std::io::Write;

use anyhow::bail;
use nalgebra::{Isometry3, Matrix6};
use rigidformer_perception::capture::Facts;
use rigidformer_perception::estimate::UnitEstimate;
use rigidformer_perception::gravity::Gravity;
use rigidformer_perception::tracker::Tracker;
use serde_json::{Value, json};

use super::gravity::word;
use super::source::Source;
use super::words::{rest_word, sight_word};
use crate::{interrupt, output};

/// Horizon of a line's predictions, seconds, and how many there are until then.
const AHEAD_S: f64 = 1.0;
const AHEAD: usize = 4;

/// Follows captures as they come, and tells each result at once.
pub(super) fn follow(
    tracker: &mut Tracker,
    source: &mut Source,
    gravity: &Gravity,
) -> anyhow::Result<()> {
    let mut facts = Facts::default();
    let (mut captures, mut units) = (0_u64, 0);
    while let Some(capture) = source.next() {
        interrupt::check()?;
        let capture = capture?;
        facts.add(&capture);
        tracker.observe(&capture)?;
        let line = line(tracker, gravity)?;
        let mut stdout = std::io::stdout().lock();
        let told = writeln!(stdout, "{line}").and_then(|()| stdout.flush());
        // Nobody listens any more.
        if told.as_ref().is_err_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe) {
            return Ok(());
        }
        output::heard(told)?;
        captures += 1;
        units += tracker.report().appeared.len();
    }
    if captures == 0 {
        bail!("standard input: no frame came");
    }
    let doubts = facts.doubts();
    source.notes().into_iter().chain(doubts.iter().map(ToString::to_string)).for_each(|note| {
        output::note(&note);
    });
    if units == 0 {
        output::note("nothing was followed: each line says how many clusters were seen");
    }
    Ok(())
}

fn line(tracker: &mut Tracker, gravity: &Gravity) -> anyhow::Result<Value> {
    let forecast = tracker.predict(AHEAD_S)?;
    let every = forecast.poses.len().div_ceil(AHEAD).max(1);
    let predicted = forecast.poses.iter().enumerate().skip(every - 1).step_by(every);
    let predicted: Vec<Value> = predicted
        .map(|(number, poses)| {
            let poses = poses.iter().map(|(id, pose)| json!({ "unit": id, "pose": numbers(pose) }));
            json!({
                "ahead_s": forecast.step_s * (number + 1) as f64,
                "poses": poses.collect::<Vec<_>>(),
            })
        })
        .collect();
    let planes = tracker.planes().iter().map(|plane| {
        let n = plane.normal;
        json!({ "normal": [n.x, n.y, n.z], "offset_m": plane.offset_m })
    });
    let (estimate, report, g) = (tracker.estimate(), tracker.report(), gravity.m_s2);
    Ok(json!({
        "time_s": estimate.time_s,
        "units": estimate.units.iter().map(unit).collect::<Vec<_>>(),
        "planes": planes.collect::<Vec<_>>(),
        "predicted": predicted,
        "clusters": report.clusters,
        "blind": report.is_blind(),
        "gravity_m_s2": [g.x, g.y, g.z],
        "gravity_known": word(gravity.known),
    }))
}

fn unit(unit: &UnitEstimate) -> Value {
    json!({
        "unit": unit.id,
        "pose": numbers(&unit.pose),
        "covariance": rows(&unit.covariance),
        "velocity": unit.velocity.as_slice(),
        "velocity_covariance": rows(&unit.velocity_covariance),
        "sight": sight_word(unit.visibility),
        "rest": rest_word(unit.rest),
    })
}

/// x, y, z and w, x, y, z of the quaternion.
fn numbers(pose: &Isometry3<f32>) -> [f32; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
    [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
}

fn rows(matrix: &Matrix6<f32>) -> Vec<Vec<f32>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}
