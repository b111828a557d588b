//! Convex pieces of hollow units, owned.

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};
use rigidformer_core::Pieces;
use rigidformer_runtime::hull::ConvexHull;

/// Convex pieces of a unit: [`Pieces`] with memory of their own. None: the unit is the hull of its points.
///
/// ```
/// use nalgebra::Point3;
/// use rigidformer_core::{Physics, Unit};
/// use rigidformer_evaluation::convex_pieces::ConvexPieces;
/// let corner = |k: u8, bit: u8| if k & bit == 0 { -0.1 } else { 0.1 };
/// let cube: Vec<Point3<f32>> = (0..8).map(|k| Point3::new(corner(k, 1), corner(k, 2), corner(k, 4))).collect();
/// let beside: Vec<_> = cube.iter().map(|point| point + nalgebra::Vector3::x()).collect();
/// let pieces: ConvexPieces = [cube, beside].into_iter().collect();
/// let wood = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.2 };
/// let unit = Unit::new(pieces.points(), wood).pieces(pieces.view());
/// assert_eq!((pieces.len(), unit.room()), (2, 20));
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConvexPieces {
    /// Of all, one piece after another.
    points: Vec<Point3<f32>>,
    counts: Vec<u16>,
}

impl ConvexPieces {
    /// As a unit takes them.
    pub fn view(&self) -> Pieces<'_> {
        Pieces::new(&self.points, &self.counts)
    }

    /// Points of each piece, in the frame of the unit's points, metres.
    pub fn iter(&self) -> impl Iterator<Item = &[Point3<f32>]> {
        self.view().iter()
    }

    /// Points of all, one piece after another.
    pub fn points(&self) -> &[Point3<f32>] {
        &self.points
    }

    /// How many points each has.
    pub fn counts(&self) -> &[u16] {
        &self.counts
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.counts.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.counts.is_empty()
    }
}

impl FromIterator<Vec<Point3<f32>>> for ConvexPieces {
    /// Of more than 65535 points in a piece the first count: a simulator takes 255 at most, and says so.
    fn from_iter<I: IntoIterator<Item = Vec<Point3<f32>>>>(pieces: I) -> Self {
        let mut all = ConvexPieces::default();
        for piece in pieces {
            // Counts that do not fit stay above the simulator's limit, which then names the piece.
            let count = u16::try_from(piece.len()).unwrap_or(u16::MAX);
            all.points.extend(piece.into_iter().take(usize::from(count)));
            all.counts.push(count);
        }
        all
    }
}

/// Points of a piece, at most.
// A simulator takes 255 points a piece at most.
const MOST_POINTS: usize = 255;

impl ConvexPieces {
    /// At most `most` of these pieces, at least one: of each the corners of its hull, at most 255, those that lie farthest
    /// from each other. Where there are more pieces, pairs become their common hull, the pair first that gains the least
    /// volume. The work grows with the square of their number.
    ///
    /// ```
    /// use nalgebra::{Point3, Vector3};
    /// use rigidformer_evaluation::convex_pieces::ConvexPieces;
    /// let corner = |k: u8, bit: u8| if k & bit == 0 { 0.0 } else { 1.0 };
    /// let cube = |x: f32| -> Vec<Point3<f32>> {
    ///     (0..8).map(|k| Point3::new(x + corner(k, 1), corner(k, 2), corner(k, 4))).collect()
    /// };
    /// let pieces = ConvexPieces::merged(vec![cube(0.0), cube(5.0), cube(1.0)], 2);
    /// assert_eq!(pieces.counts(), [8, 8]);
    /// assert!((pieces.volume_m3() - 3.0).abs() < 1e-9);
    /// ```
    pub fn merged(pieces: Vec<Vec<Point3<f32>>>, most: usize) -> Self {
        let mut hulls: Vec<Hull> = pieces.into_iter().map(Hull::new).collect();
        // Gains of pairs (a, b) with b < a, in row a.
        let row = |hulls: &[Hull], a: usize| -> Vec<f64> {
            hulls[..a].iter().map(|other| hulls[a].gain(other)).collect()
        };
        let mut gains = Vec::new();
        // All gains are the square of the pieces in hulls, so they wait until a merge needs them.
        if hulls.len() > most {
            gains.extend((0..hulls.len()).map(|a| row(&hulls, a)));
        }
        while hulls.len() > most.max(1) {
            let pairs = gains
                .iter()
                .enumerate()
                .flat_map(|(a, row)| row.iter().enumerate().map(move |(b, gain)| (*gain, b, a)));
            let Some((_, b, a)) = pairs.min_by(|x, y| x.0.total_cmp(&y.0)) else { break };
            let gone = hulls.remove(a);
            gains.remove(a);
            for row in gains.iter_mut().skip(a) {
                row.remove(a);
            }
            hulls[b] = hulls[b].with(&gone);
            // Only gains with the merged hull change.
            gains[b] = row(&hulls, b);
            for later in b + 1..hulls.len() {
                gains[later][b] = hulls[later].gain(&hulls[b]);
            }
        }
        hulls.into_iter().map(|hull| thinned(hull.corners, MOST_POINTS)).collect()
    }

    /// The same pieces with at most so many points each, at least 4: those that lie farthest from each other.
    pub fn thinned(&self, most: usize) -> Self {
        self.iter().map(|piece| thinned(piece.to_vec(), most.max(4))).collect()
    }

    /// Volumes of all together, m^3; what two pieces share counts twice.
    pub fn volume_m3(&self) -> f64 {
        self.iter().map(volume).sum()
    }
}

/// A piece on its way to be merged.
struct Hull {
    corners: Vec<Point3<f32>>,
    volume: f64,
}

impl Hull {
    fn new(points: Vec<Point3<f32>>) -> Self {
        let volume = volume(&points);
        // Flat pieces have no hull and stay as they are; the simulator judges them.
        let Some(hull) = ConvexHull::new(&points) else {
            return Hull { corners: points, volume };
        };
        let used: BTreeSet<usize> = hull.faces().iter().flatten().copied().collect();
        Hull { corners: used.into_iter().map(|corner| points[corner]).collect(), volume }
    }

    /// The hull of both.
    fn with(&self, other: &Hull) -> Hull {
        Hull::new([&self.corners[..], &other.corners].concat())
    }

    /// Volume that the hull of both has more than the two.
    fn gain(&self, other: &Hull) -> f64 {
        volume(&[&self.corners[..], &other.corners].concat()) - self.volume - other.volume
    }
}

/// How far pieces may lie from the middle of a unit's points, in the greatest distance of those from it. Farther ones are most
/// likely in another unit of length, such as millimetres.
// Pieces of a mesh that was exported in millimetres are 1000 times as far.
const FAR: f32 = 100.0;

/// Whether a point of the pieces is farther from the unit's points than [`FAR`] allows.
pub(crate) fn lie_far<'p>(
    points: &[Point3<f32>],
    mut pieces: impl Iterator<Item = &'p Point3<f32>>,
) -> bool {
    let Some(first) = points.first() else { return false };
    let (mut low, mut high) = (*first, *first);
    for point in points {
        (low, high) = (low.inf(point), high.sup(point));
    }
    let (middle, reach) = (nalgebra::center(&low, &high), (high - low).norm() / 2.0);
    // Points in one place have no size to compare with.
    reach > 0.0 && pieces.any(|point| (point - middle).norm() > FAR * reach)
}

/// So many of them, at most: those that lie farthest from each other, the first one farthest from the middle of all. In their
/// order. A mesh may have many times as many corners, so no more are ordered than are kept.
fn thinned(corners: Vec<Point3<f32>>, most: usize) -> Vec<Point3<f32>> {
    if corners.len() <= most {
        return corners;
    }
    // A mean has more digits than the f32 corners, or its rounding would choose the first corner.
    let sum =
        corners.iter().fold(Vector3::<f64>::zeros(), |sum, corner| sum + corner.coords.cast());
    let mut last: Vector3<f64> = sum / corners.len() as f64;
    let mut distances = vec![f64::INFINITY; corners.len()];
    let mut kept = vec![false; corners.len()];
    for turn in 0..most {
        let mut farthest = (0, -1.0);
        for (number, (corner, distance)) in corners.iter().zip(&mut distances).enumerate() {
            let apart = (corner.coords.cast() - last).norm_squared();
            // The mean is no corner, so the choice after the first forgets it.
            *distance = if turn < 2 { apart } else { distance.min(apart) };
            if !kept[number] && *distance > farthest.1 {
                farthest = (number, *distance);
            }
        }
        let (number, _) = farthest;
        kept[number] = true;
        last = corners[number].coords.cast();
    }
    // The given order stays, so that thinning twice gives the same pieces.
    let keeps = corners.iter().zip(kept).filter(|(_, kept)| *kept);
    keeps.map(|(corner, _)| *corner).collect()
}

/// Volume of the hull of points, m^3; 0 where they are flat.
fn volume(points: &[Point3<f32>]) -> f64 {
    let (Some(hull), Some(first)) = (ConvexHull::new(points), points.first()) else { return 0.0 };
    // Corners near the origin keep the digits of small pieces far from it.
    let from_first = |corner: usize| -> Vector3<f64> { (points[corner] - first).cast() };
    let volumes = hull.faces().iter().map(|face| {
        let [a, b, c] = face.map(from_first);
        a.dot(&b.cross(&c)) / 6.0
    });
    volumes.sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An arc of a ring from one angle to another, of radii .8 and 1.
    fn arc(from: f32, to: f32) -> Vec<Point3<f32>> {
        let corner = |k: usize| {
            let angle = if k & 1 == 0 { from } else { to };
            let radius = if k & 2 == 0 { 0.8 } else { 1.0 };
            let z = if k & 4 == 0 { 0.0 } else { 0.2 };
            Point3::new(radius * angle.cos(), radius * angle.sin(), z)
        };
        (0..8).map(corner).collect()
    }

    fn ring(count: usize) -> Vec<Vec<Point3<f32>>> {
        let at = |k: usize| std::f32::consts::TAU * k as f32 / count as f32;
        (0..count).map(|k| arc(at(k), at(k + 1))).collect()
    }

    #[test]
    fn neighbours_of_a_ring_merge_and_its_hole_stays() {
        let whole = ConvexPieces::merged(ring(24), 32);
        assert_eq!(whole.len(), 24);
        let half = ConvexPieces::merged(ring(24), 12);
        assert_eq!(half.len(), 12);
        assert!(half.volume_m3() < 1.1 * whole.volume_m3(), "{}", half.volume_m3());
        let points: Vec<_> = half.iter().flatten().copied().collect();
        assert!(half.volume_m3() < 0.6 * volume(&points), "the hole is not filled");
        let one = ConvexPieces::merged(ring(24), 1);
        assert_eq!((one.len(), one.counts()), (1, &[48_u16][..]));
        assert_eq!(ConvexPieces::merged(ring(24), 0), one);
        assert!(ConvexPieces::merged(Vec::new(), 3).is_empty());
    }

    #[test]
    fn inner_points_go_and_many_corners_are_thinned() {
        let mut cube = arc(0.0, 1.0);
        cube.insert(0, Point3::new(0.7, 0.38, 0.1));
        assert_eq!(ConvexPieces::merged(vec![cube], 32).counts(), [8]);
        let ball = |k: usize| {
            let z = 1.0 - (2 * k + 1) as f32 / 600.0;
            let (sine, cosine) = (k as f32 * 2.399_963).sin_cos();
            let across = (1.0 - z * z).sqrt();
            Point3::new(across * cosine, across * sine, z)
        };
        let thinned = ConvexPieces::merged(vec![(0..600).map(ball).collect()], 32);
        assert_eq!(thinned.counts(), [255]);
        assert!(thinned.volume_m3() > 0.97 * 4.18, "{}", thinned.volume_m3());
        assert_eq!(thinned.thinned(20).counts(), [20]);
        assert!(thinned.thinned(20).volume_m3() > 0.6 * 4.18);
        assert_eq!(thinned.thinned(0).counts(), [4]);
    }

    #[test]
    fn flat_and_foul_points_do_no_harm() {
        let flat: Vec<_> =
            (0..9).map(|k| Point3::new((k % 3) as f32, (k / 3) as f32, 0.0)).collect();
        let foul = vec![Point3::new(f32::NAN, 0.0, 0.0); 5];
        let pieces = ConvexPieces::merged(vec![flat, foul, arc(0.0, 1.0)], 3);
        assert_eq!(pieces.counts(), [9, 5, 8]);
        assert_eq!(ConvexPieces::merged(ring(3), 3).len(), 3);
    }
}
