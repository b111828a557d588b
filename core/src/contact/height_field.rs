//! Ground of varying height: a grid of heights, and its faces where units are.

use crate::geometry::{dot, norm};
use crate::kernels::in_own_environment;
use crate::limits::MAX_COORDINATE_M;
use crate::measure::Measure;
use nalgebra::Vector3;

/// Heights of a field, at most: f32 count them exactly.
pub const MAX_HEIGHTS: usize = 1 << 22;
/// Columns are this far apart at least and at most, and so are rows, metres.
const SPACING_M: core::ops::RangeInclusive<f32> = 1e-4..=1e4;
/// A point this far outside of a face, in spacings, is on it: rounding puts what is on an edge to either side.
const ON_EDGE: f32 = 1e-4;

/// Unmoving ground of varying height: a grid of heights above `corner_m`. Units stay above it. Beyond its borders there is
/// nothing; a [`Plane`](crate::Plane) may lie below. What is deeper under it than its own size is let be: it has come from elsewhere.
///
/// Rows go along y and columns along x. A cell between four heights is two triangles, which share the diagonal from its first
/// corner (least x and y) to the opposite one, as MuJoCo's `hfield` has it. Heights are borrowed: a microcontroller may
/// keep them in flash.
///
/// ```
/// use nalgebra::Vector3;
/// use rigidformer_core::HeightField;
/// // A ramp that rises by 10 cm over a metre along x.
/// let heights_m = [0.0, 0.1, 0.0, 0.1];
/// let ramp = HeightField {
///     heights_m: &heights_m,
///     columns: 2,
///     spacing_m: [1.0, 1.0],
///     corner_m: Vector3::new(-0.5, -0.5, 0.0),
///     friction: 0.5,
///     restitution: 0.3,
/// };
/// assert_eq!((ramp.check(), ramp.rows()), (Ok(()), 2));
/// assert_eq!(ramp.height_m(0.0, 0.2), Some(0.05));
/// assert_eq!(ramp.height_m(0.6, 0.0), None, "beyond the border");
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeightField<'a> {
    /// (rows, columns) heights above the corner, metres: at least two rows and two columns, at most [`MAX_HEIGHTS`] in all.
    pub heights_m: &'a [f32],
    /// Heights of a row.
    pub columns: usize,
    /// Between columns along x and between rows along y, metres, from 1e-4 to 1e4.
    pub spacing_m: [f32; 2],
    /// The place of a first height of zero, metres.
    pub corner_m: Vector3<f32>,
    /// Friction coefficient, from 0 to 1000.
    pub friction: f32,
    /// Restitution coefficient, from 0 to 1000.
    pub restitution: f32,
}

/// What is wrong with a height field.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum HeightFieldError {
    /// Heights do not fill rows of so many columns, or are too few or too many.
    #[error(
        "height field: {heights} heights in rows of {columns}; give whole rows, at least 2 rows and 2 columns, at most {MAX_HEIGHTS} heights"
    )]
    Shape {
        /// Heights given.
        heights: usize,
        /// Columns given.
        columns: usize,
    },
    /// A spacing is out of range.
    #[error("height field: spacing must be from 1e-4 to 1e4 m along x and along y")]
    Spacing,
    /// The corner, a border or a height is not finite or too far away.
    #[error("height field: its corner and borders must be finite and within 1e6 m")]
    Place,
    /// A height is not finite or too far away.
    #[error("height field: height {height} must be finite and within 1e6 m")]
    Height {
        /// Which one.
        height: usize,
    },
    /// A friction or restitution coefficient is out of range.
    #[error("height field: friction and restitution must be from 0 to 1000")]
    Coefficient,
    /// The model does not move units by impulses, and knows planes alone.
    #[error(
        "height field: the model knows planes alone; use a model that moves units by impulses, such as edge or nano"
    )]
    Model,
}

impl<'a> HeightField<'a> {
    /// Whole rows of heights.
    pub fn rows(&self) -> usize {
        self.heights_m.len().checked_div(self.columns).unwrap_or_default()
    }

    /// Height of the ground at a place, metres, by the triangle there; `None` beyond the borders.
    pub fn height_m(&self, x_m: f32, y_m: f32) -> Option<f32> {
        in_own_environment(|| {
            let near = Surface::new(self, &Measure::SI).from(&Vector3::zeros());
            let face = near.face_below(&Vector3::new(x_m, y_m, 0.0))?;
            Some(face.height_at(x_m, y_m))
        })
    }

    /// Whether its numbers are those of a field.
    ///
    /// # Errors
    /// [`HeightFieldError`]
    pub fn check(&self) -> Result<(), HeightFieldError> {
        in_own_environment(|| self.check_here())
    }

    fn check_here(&self) -> Result<(), HeightFieldError> {
        let (heights, columns, rows) = (self.heights_m.len(), self.columns, self.rows());
        if columns < 2 || rows < 2 || heights > MAX_HEIGHTS || rows * columns != heights {
            return Err(HeightFieldError::Shape { heights, columns });
        }
        if !self.spacing_m.iter().all(|spacing| SPACING_M.contains(spacing)) {
            return Err(HeightFieldError::Spacing);
        }
        let [dx, dy] = self.spacing_m;
        let far = self.corner_m + Vector3::new(dx * columns as f32, dy * rows as f32, 0.0);
        let is_near = |v: &f32| v.abs() <= MAX_COORDINATE_M;
        if !self.corner_m.iter().all(is_near) || !far.iter().all(is_near) {
            return Err(HeightFieldError::Place);
        }
        let is_bad = |height: &f32| !is_near(height) || !is_near(&(self.corner_m.z + height));
        if let Some(height) = self.heights_m.iter().position(is_bad) {
            return Err(HeightFieldError::Height { height });
        }
        let coefficient = |value: f32| (0.0..=1e3).contains(&value);
        if !coefficient(self.friction) || !coefficient(self.restitution) {
            return Err(HeightFieldError::Coefficient);
        }
        Ok(())
    }

    /// The greatest height above the corner, metres.
    pub(crate) fn highest_m(&self) -> f32 {
        self.heights_m.iter().fold(f32::NEG_INFINITY, |high, z| high.max(*z))
    }

    /// A number of all that it says, to the bit: other fields hardly have the same.
    pub(crate) fn digest(&self) -> u64 {
        let [dx, dy] = self.spacing_m;
        let corner = self.corner_m;
        let head = [corner.x, corner.y, corner.z, dx, dy, self.friction, self.restitution];
        let words = head.iter().chain(self.heights_m).map(|number| number.to_bits());
        let add = |hash: u64, word: u32| (hash ^ u64::from(word)).wrapping_mul(0x0100_0000_01b3);
        words.chain([self.columns as u32]).fold(0xcbf2_9ce4_8422_2325, add)
    }
}

/// A height field in a scene's measure.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface<'a> {
    heights: &'a [f32],
    columns: usize,
    rows: usize,
    /// Between columns and between rows.
    spacing: [f32; 2],
    /// Of a metre.
    scale: f32,
    corner: Vector3<f32>,
}

impl<'a> Surface<'a> {
    pub(crate) fn new(field: &HeightField<'a>, measure: &Measure) -> Self {
        let scale = 1.0 / measure.length();
        let corner = field.corner_m.cast::<f64>() - measure.origin().cast::<f64>();
        Surface {
            heights: field.heights_m,
            columns: field.columns,
            rows: field.rows(),
            spacing: field.spacing_m.map(|spacing| spacing * scale),
            scale,
            corner: corner.map(|v| v as f32) * scale,
        }
    }

    /// The greatest height, of one above the corner in metres.
    pub(crate) fn highest(&self, above_m: f32) -> f32 {
        self.corner.z + above_m * self.scale
    }

    /// Whether a ball reaches over the field, seen from above.
    pub(crate) fn is_under(&self, centre: &Vector3<f32>, radius: f32) -> bool {
        let around = Vector3::repeat(radius);
        self.from(centre).cells(&-around, &around).is_some()
    }

    /// How far a face has to fall away behind an edge of a cell for that to stick out, as a unit of this radius feels it: what is
    /// nearest to it has to be on a face otherwise, to [`ON_EDGE`].
    pub(crate) fn least_dip(&self, radius: f32) -> f32 {
        let [dx, dy] = self.spacing;
        let spacing = dx.min(dy);
        let felt = ON_EDGE * spacing * (spacing / radius).min(10.0);
        felt.max(8.0 * f32::EPSILON * self.corner.z.abs())
    }

    /// As seen from a place.
    pub(crate) fn from(&self, place: &Vector3<f32>) -> Near<'a> {
        Near { surface: *self, corner: self.corner - place }
    }
}

/// A surface as seen from a place, from which all places are counted here.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Near<'a> {
    surface: Surface<'a>,
    corner: Vector3<f32>,
}

/// A triangle of the surface. Its points go round to the left as seen from above.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Face {
    /// Upwards.
    pub(crate) normal: Vector3<f32>,
    pub(crate) corners: [Vector3<f32>; 3],
    /// How much it rises along x and y.
    rise: [f32; 2],
    /// Whether it is the one of its cell with the lesser y.
    is_right: bool,
    spacing: [f32; 2],
}

impl Face {
    /// `rises` are along x and y over a spacing.
    fn new(corners: [Vector3<f32>; 3], rises: [f32; 2], half: (bool, [f32; 2])) -> Self {
        let (is_right, spacing) = half;
        let ([x, y], [dx, dy]) = (rises, spacing);
        let rise @ [x, y] = [x / dx, y / dy];
        let across = Vector3::new(-x, -y, 1.0);
        Face { normal: across / norm(&across), corners, rise, is_right, spacing }
    }

    /// How far a point is above its plane.
    pub(crate) fn above(&self, point: &Vector3<f32>) -> f32 {
        let [first, ..] = &self.corners;
        dot(&self.normal, &(point - first))
    }

    /// Whether a point is above or below it along the normal, or on an edge of what is.
    pub(crate) fn has_foot_of(&self, point: &Vector3<f32>, above: f32) -> bool {
        let ([first, ..], [dx, dy]) = (&self.corners, self.spacing);
        let foot = (point - first) - self.normal * above;
        let (u, v) = (foot.x / dx, foot.y / dy);
        // The first corner is that of the cell.
        let (more, less) = if self.is_right { (u, v) } else { (v, u) };
        less >= -ON_EDGE && less <= more + ON_EDGE && more <= 1.0 + ON_EDGE
    }

    /// Height of its plane over a place.
    fn height_at(&self, x: f32, y: f32) -> f32 {
        let ([first, ..], [rise_x, rise_y]) = (&self.corners, self.rise);
        first.z + (rise_x * (x - first.x) + rise_y * (y - first.y))
    }
}

/// An edge that two faces share, and what is beside it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ridge {
    pub(crate) ends: [Vector3<f32>; 2],
    /// Rows and columns of both ends.
    places: [[usize; 2]; 2],
    normals: [Vector3<f32>; 2],
    /// Across the edge, into each of the faces.
    inward: [Vector3<f32>; 2],
}

impl Ridge {
    /// Between the normals of its faces.
    pub(crate) fn middle_normal(&self) -> Vector3<f32> {
        let [a, b] = &self.normals;
        let sum = a + b;
        sum / norm(&sum)
    }
}

/// How far a normal may lean into a face beside an edge or a corner and still be one of those: the sine of half a degree.
const LEANS: f32 = 0.01;

impl<'a> Near<'a> {
    /// The corner of cells in a row and a column.
    fn corner_at(&self, row: usize, column: usize) -> Vector3<f32> {
        let Surface { heights, columns, spacing: [dx, dy], scale, .. } = self.surface;
        let height = heights.get(row * columns + column).copied().unwrap_or_default();
        let way = Vector3::new(dx * column as f32, dy * row as f32, height * scale);
        self.corner + way
    }

    /// Rows and columns of the cells that a box reaches into, seen from above; none beyond the borders.
    pub(crate) fn cells(
        &self,
        low: &Vector3<f32>,
        high: &Vector3<f32>,
    ) -> Option<[core::ops::Range<usize>; 2]> {
        let Surface { columns, rows, spacing: [dx, dy], .. } = self.surface;
        // What was not checked may be no field.
        if columns < 2 || rows < 2 {
            return None;
        }
        let range = |low: f32, high: f32, count: usize| {
            let last = count.saturating_sub(1);
            // What is not a number reaches into none.
            let is_there = high >= 0.0 && low <= last as f32;
            let start = (low.max(0.0) as usize).min(last.saturating_sub(1));
            // The cell that the last point is in, and no more than there are.
            let end = (high.max(0.0) as usize).saturating_add(1).min(last);
            is_there.then_some(start..end)
        };
        let across = range((low.y - self.corner.y) / dy, (high.y - self.corner.y) / dy, rows)?;
        let along = range((low.x - self.corner.x) / dx, (high.x - self.corner.x) / dx, columns)?;
        Some([across, along])
    }

    /// The faces of a cell, the right one (of lesser y) first.
    pub(crate) fn faces(&self, row: usize, column: usize) -> [Face; 2] {
        let (a, b) = (self.corner_at(row, column), self.corner_at(row, column + 1));
        let (c, d) = (self.corner_at(row + 1, column + 1), self.corner_at(row + 1, column));
        // As it is where corners are rounded, so that nothing is between two cells.
        let spacing = [b.x - a.x, d.y - a.y];
        [
            Face::new([a, b, c], [b.z - a.z, c.z - b.z], (true, spacing)),
            Face::new([a, c, d], [c.z - d.z, d.z - a.z], (false, spacing)),
        ]
    }

    /// The greatest height of a cell.
    pub(crate) fn top(&self, row: usize, column: usize) -> f32 {
        let heights = [(row, column), (row, column + 1), (row + 1, column), (row + 1, column + 1)];
        heights
            .map(|(row, column)| self.corner_at(row, column).z)
            .into_iter()
            .fold(f32::NEG_INFINITY, f32::max)
    }

    /// The face above or below a place; none beyond the borders.
    pub(crate) fn face_below(&self, point: &Vector3<f32>) -> Option<Face> {
        let [rows, columns] = self.cells(point, point)?;
        let (row, column) = (rows.start, columns.start);
        let [right, left] = self.faces(row, column);
        let ([first, ..], [dx, dy]) = (&right.corners, right.spacing);
        let (u, v) = ((point.x - first.x) / dx, (point.y - first.y) / dy);
        Some(if u >= v { right } else { left })
    }

    /// The edges of a cell that stick out: its first ones along x and y, its diagonal, and its last ones at the border. `dip` is how far
    /// a face has to fall away behind an edge for that.
    pub(crate) fn ridges(&self, row: usize, column: usize, dip: f32) -> heapless::Vec<Ridge, 5> {
        let mut found = heapless::Vec::new();
        let [right, left] = self.faces(row, column);
        let ([a, b, c], [_, _, d]) = (right.corners, left.corners);
        let Surface { rows, columns, .. } = self.surface;
        let [here, beside] = [[row, column], [row, column + 1]];
        let [across, behind] = [[row + 1, column + 1], [row + 1, column]];
        let mut add = |ends: [Vector3<f32>; 2], places, own: (&Face, Vector3<f32>), other| {
            let [start, end] = &ends;
            let way = end - start;
            let along = way / norm(&way);
            let inward = |corner: &Vector3<f32>| {
                let arm = corner - start;
                let across = arm - along * dot(&along, &arm);
                across / norm(&across)
            };
            let (one, corner) = own;
            let mine = inward(&corner);
            // Behind a border there is nothing.
            let Some((other, corner)): Option<(Face, Vector3<f32>)> = other else {
                let normals = [one.normal, -mine];
                let _ = found.push(Ridge { ends, places, normals, inward: [mine; 2] });
                return;
            };
            if one.above(&corner) <= -dip {
                let normals = [one.normal, other.normal];
                let _ =
                    found.push(Ridge { ends, places, normals, inward: [mine, inward(&corner)] });
            }
        };
        add([a, c], [here, across], (&right, b), Some((left, d)));
        let other = row.checked_sub(1).map(|below| {
            let [_, other] = self.faces(below, column);
            let [corner, ..] = other.corners;
            (other, corner)
        });
        add([a, b], [here, beside], (&right, c), other);
        let other = column.checked_sub(1).map(|before| {
            let [other, _] = self.faces(row, before);
            let [corner, ..] = other.corners;
            (other, corner)
        });
        add([a, d], [here, behind], (&left, c), other);
        if column + 2 == columns {
            add([b, c], [beside, across], (&right, a), None);
        }
        if row + 2 == rows {
            add([d, c], [behind, across], (&left, a), None);
        }
        found
    }

    /// Whether a direction away from an edge, or from the end of it that is farthest along that, leads into no face there: what is nearest
    /// to the edge lies that way.
    pub(crate) fn sticks_out(&self, ridge: &Ridge, normal: &Vector3<f32>) -> bool {
        if ridge.inward.iter().any(|inward| dot(inward, normal) > LEANS) {
            return false;
        }
        let [start, end] = &ridge.ends;
        let way = end - start;
        let along = dot(&way, normal) / norm(&way);
        if along.abs() <= LEANS {
            return true;
        }
        // A corner: no edge of it may lead that way.
        let ([first, second], Surface { rows, columns, .. }) = (ridge.places, self.surface);
        let ([row, column], place) = if along > 0.0 { (second, end) } else { (first, start) };
        const AROUND: [[isize; 2]; 6] = [[0, 1], [1, 1], [1, 0], [0, -1], [-1, -1], [-1, 0]];
        AROUND.iter().all(|[up, right]| {
            let (row, column) = (row.checked_add_signed(*up), column.checked_add_signed(*right));
            let (Some(row), Some(column)) = (row, column) else { return true };
            if row >= rows || column >= columns {
                return true;
            }
            let edge = self.corner_at(row, column) - place;
            dot(&edge, normal) <= LEANS * norm(&edge)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field<'a>(heights_m: &'a [f32], columns: usize) -> HeightField<'a> {
        HeightField {
            heights_m,
            columns,
            spacing_m: [0.5, 0.25],
            corner_m: Vector3::new(1.0, 2.0, 3.0),
            friction: 1.0,
            restitution: 0.0,
        }
    }

    #[test]
    fn a_roof_has_one_ridge_and_a_ditch_none() {
        for (heights, ridges) in
            [([0.0, 0.2, 0.0, 0.0, 0.2, 0.0], 1), ([0.2, 0.0, 0.2, 0.2, 0.0, 0.2], 0)]
        {
            let near = Surface::new(&field(&heights, 3), &Measure::SI).from(&Vector3::zeros());
            let all: usize = (0..2).map(|column| near.ridges(0, column, 1e-4).len()).sum();
            // Six edges are borders.
            assert_eq!(all, ridges + 6, "{heights:?}");
        }
    }

    #[test]
    fn heights_are_those_of_the_triangles() {
        let heights = [0.0, 1.0, 2.0, 0.0, 3.0, 1.0];
        let field = field(&heights, 3);
        // On the grid, on a diagonal, and on either side of one.
        let cases = [
            ([1.0, 2.0], 3.0),
            ([1.5, 2.25], 6.0),
            ([1.25, 2.125], 4.5),
            ([1.375, 2.0625], 4.25),
            ([1.125, 2.1875], 3.75),
            ([2.0, 2.0], 5.0),
        ];
        for ([x, y], height) in cases {
            assert_eq!(field.height_m(x, y), Some(height), "{x} {y}");
        }
        assert_eq!(field.height_m(2.01, 2.1), None);
        assert_eq!(field.height_m(f32::NAN, 2.1), None);
        for columns in [0, 1, 6, usize::MAX] {
            assert_eq!(HeightField { columns, ..field }.height_m(1.0, 2.0), None, "{columns}");
        }
    }

    #[test]
    fn what_is_no_field_is_refused() {
        let good = [0.0; 6];
        assert_eq!(field(&good, 3).check(), Ok(()));
        let shape = |columns| HeightFieldError::Shape { heights: 6, columns };
        for columns in [0, 1, 4, 6, 7, usize::MAX] {
            assert_eq!(field(&good, columns).check(), Err(shape(columns)));
        }
        let bad = [0.0, 0.0, f32::NAN, 0.0];
        assert_eq!(field(&bad, 2).check(), Err(HeightFieldError::Height { height: 2 }));
        let spacing_m = [0.1, f32::INFINITY];
        let field = HeightField { spacing_m, ..field(&good, 3) };
        assert_eq!(field.check(), Err(HeightFieldError::Spacing));
    }
}
