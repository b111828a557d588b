//! Convex pieces of hollow units: what they touch with, where that is not the hull of their points.

use crate::geometry::{Felt, keep_extremes, norm};
use crate::limits::MAX_PIECES;
use nalgebra::{Point3, Vector3};

/// Points of a piece, at least: fewer have no volume.
const LEAST: u16 = 4;
/// Points of a piece, at most: a byte counts them.
const MOST: u16 = 255;
/// Rows of a unit's hull that say where its pieces are, a piece: a count and a sphere around it.
const TABLE: usize = 2;
/// Six times the volume of all pieces over the cube of their extent. Below this they are flat, and a centre by volume is
/// noise.
const FLAT: f32 = 1e-4;

/// Convex pieces of a unit: what it touches with, where that is not the convex hull of its points. A ring, a cup or a table
/// is hollow; its pieces are what others reach into it between. Each piece is the hull of 4 to 255 points, and a unit has at
/// most [`MAX_PIECES`]. Pieces may overlap. The unit's centre of mass is then that of the pieces; what two of them share counts
/// twice.
///
/// Only models that move units by impulses (`Motion::Impulses`) touch with pieces. `rigidformer pieces` and
/// `rigidformer_evaluation::convex_pieces` make them of a mesh.
///
/// ```
/// use nalgebra::Point3;
/// use rigidformer_core::{Physics, Pieces, Unit};
/// fn cuboid([x, y, z]: [f32; 3], half: [f32; 3]) -> [Point3<f32>; 8] {
///     let [a, b, c] = half;
///     [[-a, -b, -c], [a, -b, -c], [-a, b, -c], [a, b, -c], [-a, -b, c], [a, -b, c], [-a, b, c], [a, b, c]]
///         .map(|[u, v, w]| Point3::new(x + u, y + v, z + w))
/// }
/// // A table: a plate and two walls under it.
/// let pieces = [
///     cuboid([0.0, 0.0, 0.1], [0.2, 0.1, 0.01]),
///     cuboid([-0.19, 0.0, 0.045], [0.01, 0.1, 0.045]),
///     cuboid([0.19, 0.0, 0.045], [0.01, 0.1, 0.045]),
/// ];
/// let points = pieces.as_flattened();
/// let wood = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.2 };
/// let table = Unit::new(points, wood).pieces(Pieces::new(points, &[8, 8, 8]));
/// assert_eq!(table.pieces.iter().map(<[_]>::len).collect::<Vec<_>>(), [8, 8, 8]);
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Pieces<'a> {
    points: &'a [Point3<f32>],
    counts: &'a [u16],
}

impl<'a> Pieces<'a> {
    /// No pieces: the unit is the hull of its points.
    pub const NONE: Pieces<'static> = Pieces { points: &[], counts: &[] };

    /// Pieces whose points follow each other, in the frame of the unit's points, metres; each has as many as its count
    /// says.
    pub const fn new(points: &'a [Point3<f32>], counts: &'a [u16]) -> Self {
        Pieces { points, counts }
    }

    /// Points of each piece; fewer where there are fewer points than the counts say.
    pub fn iter(&self) -> impl Iterator<Item = &'a [Point3<f32>]> + use<'a> {
        let mut rest = self.points;
        self.counts.iter().map(move |count| {
            let (piece, behind) = rest.split_at(usize::from(*count).min(rest.len()));
            rest = behind;
            piece
        })
    }

    /// Points of all pieces, one piece after another.
    pub fn points(&self) -> &'a [Point3<f32>] {
        self.points
    }

    /// How many points each piece has.
    pub fn counts(&self) -> &'a [u16] {
        self.counts
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty() && self.counts.is_empty()
    }

    /// Points of the limit that they take: theirs and two a piece.
    pub(crate) fn room(&self) -> usize {
        self.points.len().saturating_add(TABLE * self.counts.len())
    }

    /// The first piece that is none: its count is out of range or beyond the points, or one of its points is not `sound`.
    /// Points that no count speaks of are a piece behind all others.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn first_bad(&self, sound: impl Fn(&Point3<f32>) -> bool) -> Option<usize> {
        let is_bad = |(points, count): (&[Point3<f32>], &u16)| {
            points.len() != usize::from(*count)
                || !(LEAST..=MOST).contains(count)
                || !points.iter().all(&sound)
        };
        let bad = self.iter().zip(self.counts).position(is_bad);
        let counted = self.counts.iter().fold(0, |sum, count| sum + usize::from(*count));
        bad.or((counted != self.points.len()).then_some(self.counts.len()))
    }

    /// Centroid of all by their volumes; None where they are flat, or there are none.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn centre(&self) -> Option<Point3<f32>> {
        // From one of them: a sum of far coordinates would lose digits.
        let first = self.points.first()?;
        let (mut volume, mut moment) = (0.0, Vector3::zeros());
        for piece in self.iter() {
            let felt = Felt::new(piece);
            volume += felt.volume;
            moment += (felt.middle - first) * felt.volume + felt.offset;
        }
        let (mut low, mut high) = (*first, *first);
        for point in self.points {
            (low, high) = (low.inf(point), high.sup(point));
        }
        let size = (high - low).max();
        (volume > FLAT * (size * size * size)).then(|| first + moment / volume)
    }

    /// Keeps their extreme points in a unit's rows, from its centre in the unit's length, one piece after another, and then
    /// what [`Piece`] reads of each. `marks` is scratch of a number a point. How many points are kept.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(crate) fn store(
        &self,
        (centre, length): (&Point3<f32>, f32),
        marks: &mut [f32],
        rows: &mut [Point3<f32>],
    ) -> usize {
        // Points come first; where the table will be is not known before.
        let mut counts = heapless::Vec::<u8, MAX_PIECES>::new();
        let mut start = 0;
        for piece in self.iter() {
            let Some(own) = rows.get_mut(start..start + piece.len()) else { break };
            for (row, point) in own.iter_mut().zip(piece) {
                *row = Point3::from((*point - centre) / length);
            }
            let count = keep_extremes(own, marks);
            start += count;
            // No more than `MOST`.
            let _ = counts.push(count as u8);
        }
        let (points, table) = rows.split_at_mut(start.min(rows.len()));
        let mut first = 0;
        for (place, count) in table.as_chunks_mut::<TABLE>().0.iter_mut().zip(counts) {
            let end = first + usize::from(count);
            let own = points.get(first..end).unwrap_or_default();
            let (mut low, mut high) =
                (Point3::from([f32::INFINITY; 3]), Point3::from([f32::NEG_INFINITY; 3]));
            for point in own {
                (low, high) = (low.inf(point), high.sup(point));
            }
            let middle = Point3::from((low.coords + high.coords) * 0.5);
            let reach = own.iter().fold(0.0_f32, |most, point| most.max(norm(&(point - middle))));
            *place = [middle, Point3::new(reach, first as f32, f32::from(count))];
            first = end;
        }
        start
    }
}

/// A convex piece of a unit, in the unit's frame and the scene's measure.
pub(crate) struct Piece<'s> {
    pub(crate) points: &'s [Point3<f32>],
    /// Of a ball around it.
    pub(crate) middle: Vector3<f32>,
    pub(crate) radius: f32,
}

impl<'s> Piece<'s> {
    /// A piece by its number, of rows that [`Pieces::store`] has filled with so many points.
    pub(crate) fn of(rows: &'s [Point3<f32>], points: usize, number: usize) -> Self {
        let place = points + number * TABLE;
        let Some([middle, row]) = rows.get(place..).and_then(<[_]>::first_chunk) else {
            return Piece { points: &[], middle: Vector3::zeros(), radius: 0.0 };
        };
        let (start, count) = (row.y as usize, row.z as usize);
        let points = rows.get(start..start + count).unwrap_or_default();
        Piece { points, middle: middle.coords, radius: row.x }
    }
}

/// Rows that a unit's pieces take.
pub(crate) fn rows(points: usize, pieces: u8) -> usize {
    points + usize::from(pieces) * TABLE
}

/// Multiplies the rows of a unit's pieces by a share of the scene's length.
pub(crate) fn rescale(rows: &mut [Point3<f32>], points: usize, share: f32) {
    let (points, table) = rows.split_at_mut(points.min(rows.len()));
    points.iter_mut().for_each(|point| *point *= share);
    for place in table.as_chunks_mut::<TABLE>().0 {
        let [middle, row] = place;
        *middle *= share;
        row.x *= share;
    }
}
