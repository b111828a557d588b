//! What the input is like, and what is odd about it.

use rigidformer_core::Plane;
use rigidformer_perception::capture::Facts;
use rigidformer_perception::gravity::Gravity;
use serde_json::{Value, json};

use super::followed::Followed;
use super::gravity::word;

/// Angle between the plane that is nearest to level and level, degrees.
pub(super) fn tilt_deg(planes: &[Plane], gravity: &Gravity) -> Option<f64> {
    let up = (-gravity.m_s2).try_normalize(1e-6)?;
    let angles = planes.iter().map(|plane| f64::from(plane.normal.angle(&up)).to_degrees());
    angles.min_by(f64::total_cmp)
}

/// One line.
pub(super) fn line(facts: &Facts, planes: &[Plane], gravity: &Gravity) -> String {
    let mut parts = Vec::new();
    if let Some(extent_m) = facts.extent_m() {
        parts.push(format!("extent {extent_m:.2} m"));
    }
    if let Some(interval_s) = facts.interval_s() {
        parts.push(format!("{interval_s:.3} s between captures"));
    }
    if let Some([near, middle, far]) = facts.depths_m().or(facts.ranges_m()) {
        parts.push(format!("depths {near:.2} to {far:.2} m, half below {middle:.2}"));
    }
    if let Some(share) = facts.unmeasured_share() {
        parts.push(format!("{:.1} % of pixels unmeasured", share * 100.0));
    }
    if let Some(share) = facts.at_origin_share().filter(|share| *share > 0.0) {
        parts.push(format!("{:.1} % of points at 0,0,0", share * 100.0));
    }
    parts.push(match tilt_deg(planes, gravity) {
        Some(tilt) => format!("the most level plane is {tilt:.1} degrees from level"),
        None => "no plane".into(),
    });
    format!("seen: {}", parts.join(", "))
}

/// All of it, for programs.
pub(super) fn document(facts: &Facts, planes: &[Plane], gravity: &Gravity) -> Value {
    let g = gravity.m_s2;
    json!({
        "extent_m": facts.extent_m(),
        "interval_s": facts.interval_s(),
        "depths_m": facts.depths_m().or(facts.ranges_m()),
        "unmeasured_share": facts.unmeasured_share(),
        "at_origin_share": facts.at_origin_share(),
        "level_plane_tilt_deg": tilt_deg(planes, gravity),
        "gravity_m_s2": [g.x, g.y, g.z],
        "gravity_known": word(gravity.known),
    })
}

/// Why nothing was followed; none where something was.
pub(super) fn reason(followed: &Followed) -> Option<String> {
    if !followed.shapes.is_empty() {
        return None;
    }
    let Followed { most_clusters, of_other_sizes, samples, estimates, .. } = followed;
    let captures = estimates.len();
    Some(if *samples == 0 && followed.planes.is_empty() {
        "nothing was followed: no capture has points that can be used".into()
    } else if *samples == 0 {
        "nothing was followed: all points are of planes, or stand alone".into()
    } else if captures == 1 {
        "nothing was followed: there is one capture, and a unit is followed from its second on"
            .into()
    } else if *of_other_sizes > 0 {
        format!(
            "nothing was followed: {of_other_sizes} clusters are no units, which are .01 to 5 m large and have 20 points or more; check --scale"
        )
    } else {
        format!(
            "nothing was followed: of at most {most_clusters} clusters a capture none was at the same place in two captures; check the times, or --rate"
        )
    })
}
