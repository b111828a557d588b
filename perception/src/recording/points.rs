//! What readers of clouds share.

use nalgebra::Point3;

use crate::capture::Cloud;

/// Points of a cloud, at most.
pub(super) const MOST_POINTS: u64 = 4 << 20;
/// Characters of a reader's message that are shown, at most.
const SHOWN: usize = 160;

/// A cloud of those points that are finite. Scanners write others for beams that came back from nothing.
pub(super) fn points_of(
    points: impl Iterator<Item = (Point3<f32>, u16)>,
    is_labelled: bool,
) -> Cloud {
    let is_sound = |(place, _): &(Point3<f32>, u16)| place.iter().all(|v| v.is_finite());
    let (points, labels): (Vec<_>, Vec<_>) = points.filter(is_sound).unzip();
    Cloud { points, sensor: None, labels: is_labelled.then_some(labels) }
}

/// A message of which not more is shown than a line.
pub(super) fn shortened(text: String) -> String {
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    match line.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{} ...", line.get(..end).unwrap_or_default()),
        None => line,
    }
}
