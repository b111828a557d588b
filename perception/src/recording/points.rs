//! What readers of clouds share.

use nalgebra::Point3;
use rigidformer_runtime::files::shown;
use rigidformer_runtime::memory::Budget;

use super::error::CaptureProblem;
use crate::capture::Cloud;

/// Points of a cloud, at most.
// It bounds what a hostile header makes a reader allocate.
pub(super) const MAX_POINTS: u64 = 4 << 20;
/// Characters of a reader's message that are shown, at most.
const SHOWN: usize = 160;

/// Counts the points of a cloud that are about to be read, each with a label.
pub(super) fn count(budget: &mut Budget, points: usize) -> Result<(), CaptureProblem> {
    Ok(budget.take_all::<(Point3<f32>, u16)>(points)?)
}

/// A cloud of the finite points. Scanners write others for beams without a return.
pub(super) fn points_of(
    points: impl Iterator<Item = (Point3<f32>, u16)>,
    is_labelled: bool,
) -> Cloud {
    let is_sound = |(point, _): &(Point3<f32>, u16)| point.iter().all(|v| v.is_finite());
    let (points, labels): (Vec<_>, Vec<_>) = points.filter(is_sound).unzip();
    Cloud { points, sensor: None, labels: is_labelled.then_some(labels) }
}

/// A message of printable characters, shortened to a line.
pub(super) fn shortened(text: String) -> String {
    shown(&text, SHOWN)
}
