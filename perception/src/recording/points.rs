//! What readers of clouds share.

use nalgebra::{Point3, Vector3};
use rigidformer_runtime::files::shown;
use rigidformer_runtime::memory::Budget;

use super::error::CaptureProblem;
use super::notes::{Note, Notes};
use crate::capture::Cloud;

/// Points of a cloud, at most.
// It bounds what a hostile header makes a reader allocate.
pub(super) const MAX_POINTS: u64 = 4 << 20;
/// Characters of a reader's message that are shown, at most.
const SHOWN: usize = 160;
/// Coordinates beyond this have an offset taken from them, metres.
// Single precision resolves a millimetre there.
const FAR_M: f64 = 1e4;
/// Beyond this, coordinates of four bytes resolve less than 5 mm.
const COARSE_M: f64 = 65_536.0;
/// Largest coordinate of a point, metres.
const MAX_COORDINATE_M: f64 = 1e6;
/// Offsets are multiples of this, metres.
const ROUND_M: f64 = 100.0;

/// A point as a file has it, and its label.
pub(super) type Read = (Point3<f64>, u16);

/// The points of a file.
pub(super) struct Points {
    pub(super) points: Vec<Read>,
    pub(super) is_labelled: bool,
    /// Whether coordinates are of four bytes.
    pub(super) is_single: bool,
    /// Where the sensor was, where it is known.
    pub(super) sensor: Option<Point3<f64>>,
}

/// Counts the points of a cloud that are about to be read, each with a label.
pub(super) fn count(budget: &mut Budget, points: usize) -> Result<(), CaptureProblem> {
    Ok(budget.take_all::<Read>(points)?)
}

/// What is subtracted from all coordinates of a recording; its first cloud with points says it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Origin(Option<Vector3<f64>>);

impl Origin {
    /// None: coordinates stay.
    pub(super) const NONE: Origin = Origin(Some(Vector3::new(0.0, 0.0, 0.0)));

    /// The offset of a recording that has this cloud; `is_single` where coordinates are of four bytes.
    fn of(
        &mut self,
        points: &[Read],
        is_single: bool,
        notes: &mut Notes,
    ) -> Result<Vector3<f64>, CaptureProblem> {
        if let Some(known) = self.0 {
            return Ok(known);
        }
        let is_far = |(point, _): &Read| point.iter().any(|v| v.is_finite() && v.abs() > FAR_M);
        if !points.iter().any(is_far) {
            if points.iter().any(|(point, _)| is_measured(point)) {
                *self = Origin::NONE;
            }
            return Ok(Vector3::zeros());
        }
        // The middle point: a few wild ones move no scene.
        let middle = [0, 1, 2].map(|axis: usize| {
            let measured = points.iter().map(|(point, _)| point).filter(|point| is_measured(point));
            let mut all: Vec<f64> = measured.map(|point| point[axis]).collect();
            let half = all.len() / 2;
            if all.is_empty() { 0.0 } else { *all.select_nth_unstable_by(half, f64::total_cmp).1 }
        });
        let far = middle.iter().fold(0.0, |far: f64, v| far.max(v.abs()));
        if is_single && far > COARSE_M {
            return Err(CaptureProblem::Coarse { far_m: far });
        }
        let offset =
            middle.map(|v| if v.abs() > FAR_M { (v / ROUND_M).round() * ROUND_M } else { 0.0 });
        if offset != [0.0; 3] {
            let [x, y, z] = offset;
            notes.add(Note::Offset(format!("{x}, {y}, {z}")));
        }
        self.0 = Some(offset.into());
        Ok(offset.into())
    }

    /// A place of the same world.
    pub(super) fn moved(&self, place: Point3<f64>) -> Point3<f32> {
        (place - self.0.unwrap_or_default()).cast()
    }

    /// A place of the same world, which says the offset where no cloud has.
    pub(super) fn settled(&mut self, place: Point3<f64>, notes: &mut Notes) -> Point3<f32> {
        let offset = self.of(&[(place, 0)], false, notes).unwrap_or_default();
        self.0.get_or_insert(offset);
        (place - offset).cast()
    }
}

/// Whether a point is one: finite, and not what scanners write for a beam without a return.
fn is_measured(point: &Point3<f64>) -> bool {
    point.iter().all(|v| v.is_finite()) && *point != Point3::origin()
}

/// Leaves out what scanners write for beams without a return: several points at the origin of the sensor's frame. A single one may be
/// measured.
pub(super) fn drop_no_returns(points: &mut Vec<Read>, notes: &mut Notes) {
    let at_origin = points.iter().filter(|(point, _)| *point == Point3::origin()).count();
    if at_origin > 1 {
        points.retain(|(point, _)| *point != Point3::origin());
        notes.count(Note::PointsAtOrigin, at_origin as u64);
    }
}

/// A cloud of the points that are finite; `is_single` where coordinates are of four bytes.
pub(super) fn cloud_of(
    points: &[Read],
    is_labelled: bool,
    is_single: bool,
    origin: &mut Origin,
    notes: &mut Notes,
) -> Result<Cloud, CaptureProblem> {
    let offset = origin.of(points, is_single, notes)?;
    let kept = points.iter().filter_map(|(point, label)| {
        let moved = point - offset;
        // What is not a number is not within the limits either.
        let is_near = moved.iter().all(|v| v.abs() <= MAX_COORDINATE_M);
        is_near.then(|| (moved.cast::<f32>(), *label))
    });
    let (points_m, labels): (Vec<_>, Vec<_>) = kept.unzip();
    let not_finite =
        points.iter().filter(|(point, _)| !point.iter().all(|v| v.is_finite())).count();
    notes.count_points(points.len() as u64, not_finite as u64);
    let left_out = points.len() - points_m.len();
    notes.count(Note::PointsFar, left_out.saturating_sub(not_finite) as u64);
    Ok(Cloud { points: points_m, sensor: None, labels: is_labelled.then_some(labels) })
}

/// A number of a text. Writers have several words for what is none.
pub(super) fn number(word: &str) -> Option<f64> {
    match word.parse() {
        Ok(number) => Some(number),
        // `-nan(ind)`, `1.#QNAN`
        Err(_) => {
            let small = word.to_ascii_lowercase();
            let is_none =
                small.trim_start_matches(['-', '+']).starts_with("nan") || small.contains(".#");
            is_none.then_some(f64::NAN)
        }
    }
}

/// A message of printable characters, shortened to a line.
pub(super) fn shortened(text: String) -> String {
    shown(&text, SHOWN)
}
