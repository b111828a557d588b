//! Pivots of articulated bodies, read off observed poses: no joint is given.
//!
//! Two parts turn about a pivot if a point `a` of one and a point `b` of the other are in one place at all frames:
//! `R_i a + x_i = R_j b + x_j`. For each pair of parts of a body [`find`] takes the least squares of that. Where the frames leave
//! the pivot open, along a hinge's axis or between parts that did not turn, it stays near the place where the two parts are
//! nearest. A spanning tree of each body keeps the pairs that fit best, and of those the nearest.
//!
//! [`hold`] joins the units of a simulator so.
//!
//! A pivot is one point: it leaves all turns free, and does not let parts slide. Parts that slid by more than
//! [`TOLERANCE_M`] in the observed frames are not joined; those that slide later are held.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector3, Vector6};
use rigidformer_core::{JoinError, Joint, Simulator, UnitId};

/// Pairs whose images of the best pivot lie farther apart than this, root mean square over frames, are not joined.
pub const TOLERANCE_M: f64 = 0.005;
/// Pairs of points count as nearest up to this share of the smaller part beyond the least distance.
const NEAR_SHARE: f64 = 0.3;
/// Weight of the distance of a pivot from the nearest place, beside that of its images: what rounding of poses asks for.
const LEAST_WEIGHT: f64 = 1e-9;
/// How far from the nearest place a pivot is thought to lie, metres: says how much weight noise of poses asks for.
const SPREAD_M: f64 = 0.1;
/// A metre between two parts counts as so many of residual.
const DISTANCE_SHARE: f64 = 0.1;

/// A pivot that two units of a scene share: one place, fixed in the frames of both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pivot {
    /// Number of the unit that hangs.
    pub unit: usize,
    /// Number of the unit that it hangs from.
    pub parent: usize,
    /// The pivot in the unit's body frame, metres.
    pub pivot: Point3<f32>,
    /// The pivot in the parent's body frame, metres.
    pub parent_pivot: Point3<f32>,
    /// How well it fits what was seen: root mean square over frames of the distance of its two images, metres.
    pub residual_m: f32,
}

impl Pivot {
    /// Distance of its two images under poses of the scene's units, metres; `None` where they are not there.
    pub fn apart_m(&self, poses: &[Isometry3<f32>]) -> Option<f64> {
        let image = |unit: usize, pivot: &Point3<f32>| -> Option<Point3<f64>> {
            Some(poses.get(unit)?.cast::<f64>() * pivot.cast::<f64>())
        };
        let [own, parents] =
            [image(self.unit, &self.pivot)?, image(self.parent, &self.parent_pivot)?];
        Some((own - parents).norm())
    }
}

/// A part as it was seen.
#[derive(Clone, Copy, Debug)]
pub struct Part<'a> {
    /// Points in its own frame, metres.
    pub points: &'a [Point3<f32>],
    /// The body that it is a part of; `None`: a body of its own, which is joined to none.
    pub body: Option<u16>,
    /// (frames) Its poses.
    pub poses: &'a [Isometry3<f32>],
}

/// Why no pivots were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PivotError {
    /// A pivot takes two frames.
    #[error("{found} frames are given; pivots take 2 or more")]
    TooFewFrames {
        /// Frames given.
        found: usize,
    },
    /// A part was not seen in all frames.
    #[error(
        "part {part} has {found} poses, the first part {expected}; give every part a pose at every frame"
    )]
    Frames {
        /// Which part.
        part: usize,
        /// Its poses.
        found: usize,
        /// Those of the first part.
        expected: usize,
    },
    /// A part of a body has no points.
    #[error(
        "part {part} has no points; the place where two parts are nearest takes at least one of each"
    )]
    NoPoints {
        /// Which part.
        part: usize,
    },
    /// A point or a pose is not finite.
    #[error("part {part} has a point or a pose that is not finite")]
    NotFinite {
        /// Which part.
        part: usize,
    },
}

/// Pivots of all bodies of several parts, in an order in which parents come first; the root of each tree is the part with the
/// least number. A body whose parts fit no common tree within [`TOLERANCE_M`] falls into several.
///
/// ```
/// use nalgebra::{Isometry3, Point3, Vector3};
/// use rigidformer_runtime::pivots::{self, Part};
///
/// // An arm that swings at the end of another, about y through (0.3, 0, 0).
/// let corner = |i: i32, bit| if i & bit == 0 { -1.0 } else { 1.0 };
/// let bar: Vec<_> = (0..8).map(|i| Point3::new(0.15 * corner(i, 1), 0.02 * corner(i, 2), 0.02 * corner(i, 4))).collect();
/// let still = vec![Isometry3::translation(0.15, 0.0, 0.0); 11];
/// let swing = |frame| {
///     let turn = Isometry3::rotation(Vector3::y() * (0.05 * frame as f32));
///     Isometry3::translation(0.3, 0.0, 0.0) * turn * Isometry3::translation(0.15, 0.0, 0.0)
/// };
/// let swinging: Vec<_> = (0..11).map(swing).collect();
/// let part = |poses| Part { points: &bar, body: Some(1), poses };
/// let found = pivots::find(&[part(&still), part(&swinging)])?;
/// let [pivot] = found[..] else { panic!("one pair") };
/// assert_eq!((pivot.unit, pivot.parent), (1, 0));
/// assert!((pivot.pivot - Point3::new(-0.15, 0.0, 0.0)).norm() < 1e-4);
/// assert!((pivot.parent_pivot - Point3::new(0.15, 0.0, 0.0)).norm() < 1e-4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`PivotError`]
pub fn find(parts: &[Part<'_>]) -> Result<Vec<Pivot>, PivotError> {
    let expected = parts.first().map_or(0, |part| part.poses.len());
    for (number, part) in parts.iter().enumerate() {
        let found = part.poses.len();
        if found != expected {
            return Err(PivotError::Frames { part: number, found, expected });
        }
        if part.body.is_some() && part.points.is_empty() {
            return Err(PivotError::NoPoints { part: number });
        }
        let is_finite = |pose: &Isometry3<f32>| {
            pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite())
        };
        let points = || part.points.iter().flat_map(|point| point.iter());
        if !(part.poses.iter().all(is_finite) && points().all(|v| v.is_finite())) {
            return Err(PivotError::NotFinite { part: number });
        }
    }
    if expected < 2 {
        return Err(PivotError::TooFewFrames { found: expected });
    }
    let seen: Vec<Seen> = parts.iter().map(Seen::new).collect();
    let mut pairs = Vec::new();
    for (j, second) in parts.iter().enumerate() {
        for (i, first) in parts.iter().enumerate().take(j) {
            if first.body.is_some() && first.body == second.body {
                pairs.push(Pair::new([i, j], [&seen[i], &seen[j]]));
            }
        }
    }
    pairs.retain(|pair| pair.residual <= TOLERANCE_M);
    pairs.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.parts.cmp(&b.parts)));
    Ok(hung(parts.len(), &spanning(parts.len(), pairs)))
}

/// Joins units of a simulator, by their numbers, at these pivots.
///
/// # Errors
/// [`JoinError`]; the joints are what they were.
pub fn hold(simulator: &mut Simulator<'_, '_>, pivots: &[Pivot]) -> Result<(), JoinError> {
    let before: Vec<Joint> = simulator.joints().collect();
    let done = pivots.iter().try_for_each(|found| {
        let nobody = UnitId::from_bits(0);
        let id = |number| simulator.unit(number).map_or(nobody, |unit| unit.id());
        let [unit, parent] = [found.unit, found.parent].map(id);
        let Pivot { pivot, parent_pivot, .. } = *found;
        simulator.join(&Joint { unit, parent, pivot, parent_pivot })
    });
    if done.is_err() {
        let joined: Vec<UnitId> = simulator.joints().map(|joint| joint.unit).collect();
        joined.into_iter().try_for_each(|unit| simulator.unjoin(unit).map(drop))?;
        before.iter().try_for_each(|joint| simulator.join(joint))?;
    }
    done
}

/// A part's poses and points in f64.
struct Seen {
    turns: Vec<Matrix3<f64>>,
    places: Vec<Vector3<f64>>,
    /// At the last frame.
    points: Vec<Vector3<f64>>,
    /// The longest side of the box around its points.
    size: f64,
}

impl Seen {
    fn new(part: &Part<'_>) -> Self {
        let poses = part.poses.iter().map(|pose| pose.cast::<f64>());
        let (turns, places): (Vec<_>, Vec<_>) = poses
            .map(|mut pose| {
                pose.rotation.renormalize();
                (pose.rotation.to_rotation_matrix().into_inner(), pose.translation.vector)
            })
            .unzip();
        let own = || part.points.iter().map(|point| point.coords.cast::<f64>());
        let low = own().fold(Vector3::repeat(f64::INFINITY), |low, point| low.inf(&point));
        let high = own().fold(Vector3::repeat(f64::NEG_INFINITY), |high, point| high.sup(&point));
        let last = turns.last().zip(places.last());
        let points = own().filter_map(|point| last.map(|(turn, place)| turn * point + place));
        let points = points.collect();
        Seen { turns, places, points, size: (high - low).max() }
    }
}

/// Two parts and their best pivot.
struct Pair {
    parts: [usize; 2],
    pivots: [Vector3<f64>; 2],
    residual: f64,
    cost: f64,
}

impl Pair {
    fn new(parts: [usize; 2], seen: [&Seen; 2]) -> Self {
        let (near, distance) = nearest(seen);
        let last = seen[0].places.len() - 1;
        let start = seen.map(|part| part.turns[last].tr_mul(&(near - part.places[last])));
        let frames = seen[0].places.len() as f64;
        // What the start leaves, and how that changes with the two points.
        let mut matrix = Matrix6::identity();
        let (mut turned, mut left) = (Matrix3::zeros(), Vector6::zeros());
        for frame in 0..=last {
            let [r, s] = seen.map(|part| part.turns[frame]);
            let gap = gap(seen, frame, &start);
            turned += r.tr_mul(&s);
            let mut upper = left.fixed_rows_mut::<3>(0);
            upper += r.tr_mul(&gap);
            let mut lower = left.fixed_rows_mut::<3>(3);
            lower -= s.tr_mul(&gap);
        }
        turned /= frames;
        left /= frames;
        matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(&-turned);
        matrix.fixed_view_mut::<3, 3>(3, 0).copy_from(&-turned.transpose());
        let solve = |weight: f64| {
            let matrix = matrix + Matrix6::identity() * weight;
            let change = matrix.cholesky().map_or_else(Vector6::zeros, |found| found.solve(&-left));
            let pivots =
                [start[0] + change.fixed_rows::<3>(0), start[1] + change.fixed_rows::<3>(3)];
            let squares = (0..=last).map(|frame| gap(seen, frame, &pivots).norm_squared());
            (pivots, (squares.sum::<f64>() / frames).sqrt())
        };
        // What is left says how much noise the poses have.
        let (_, residual) = solve(LEAST_WEIGHT);
        let open = 3.0 * frames - 6.0;
        let noise = if open > 0.0 { residual * residual * frames / open } else { 0.0 };
        let (pivots, residual) = solve(LEAST_WEIGHT + noise / (SPREAD_M * SPREAD_M));
        Pair { parts, pivots, residual, cost: residual + DISTANCE_SHARE * distance }
    }
}

/// From the second part's image of a pivot to the first part's.
fn gap(seen: [&Seen; 2], frame: usize, pivots: &[Vector3<f64>; 2]) -> Vector3<f64> {
    let image = |part: usize| seen[part].turns[frame] * pivots[part] + seen[part].places[frame];
    image(0) - image(1)
}

/// The middle of the points of two parts that are nearest to each other, and their distance.
fn nearest(seen: [&Seen; 2]) -> (Vector3<f64>, f64) {
    let squares = |a: &Vector3<f64>, b: &Vector3<f64>| (a - b).norm_squared();
    let mut least = f64::INFINITY;
    for a in &seen[0].points {
        for b in &seen[1].points {
            least = least.min(squares(a, b));
        }
    }
    let distance = least.sqrt();
    let reach = distance + NEAR_SHARE * seen[0].size.min(seen[1].size);
    let (mut sum, mut count) = (Vector3::zeros(), 0.0);
    for a in &seen[0].points {
        for b in &seen[1].points {
            if squares(a, b) <= reach * reach {
                sum += a + b;
                count += 2.0;
            }
        }
    }
    (sum / f64::max(count, 1.0), distance)
}

/// The pairs, in the order of their costs, that close no circle.
fn spanning(parts: usize, pairs: Vec<Pair>) -> Vec<Pair> {
    let mut tree: Vec<usize> = (0..parts).collect();
    let mut kept = pairs;
    kept.retain(|pair| {
        let [a, b] = pair.parts.map(|part| tree[part]);
        for own in tree.iter_mut().filter(|own| **own == b) {
            *own = a;
        }
        a != b
    });
    kept
}

/// The pairs as units that hang from units.
fn hung(parts: usize, pairs: &[Pair]) -> Vec<Pivot> {
    let mut pivots = Vec::with_capacity(pairs.len());
    let mut is_hung = vec![false; parts];
    for root in 0..parts {
        if is_hung[root] {
            continue;
        }
        is_hung[root] = true;
        let mut above = vec![root];
        while let Some(parent) = above.pop() {
            for pair in pairs {
                let own = match pair.parts {
                    [a, b] if a == parent && !is_hung[b] => 1,
                    [a, b] if b == parent && !is_hung[a] => 0,
                    _ => continue,
                };
                let unit = pair.parts[own];
                is_hung[unit] = true;
                above.push(unit);
                let [pivot, parent_pivot] =
                    [own, 1 - own].map(|side| Point3::from(pair.pivots[side].cast::<f32>()));
                let residual_m = pair.residual as f32;
                pivots.push(Pivot { unit, parent, pivot, parent_pivot, residual_m });
            }
        }
    }
    pivots
}
