//! Finds pivots of articulated bodies from observed poses, without known joints.
//!
//! Two links turn about a pivot if a point `a` of one and a point `b` of the other coincide at all frames: `R_i a + x_i = R_j b + x_j`. For
//! each pair of links of a body [`find`] solves the least squares of that. Along directions that the frames do not determine, such as a
//! hinge's axis, the pivot stays near the point where the two links are nearest. A spanning tree of each body keeps the pairs that fit best,
//! and of those the nearest.
//!
//! [`hold`] joins the units of a simulator at pivots.
//!
//! A pivot is one point: all rotations are free, and sliding is not. Links that slide by more than [`TOLERANCE_M`] in the observed frames are
//! not joined; those that slide later are held.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector3, Vector6};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{JoinError, Joint, Simulator, UnitId};

/// Largest residual of a joined pair, root mean square over frames, metres.
pub const TOLERANCE_M: f64 = 0.005;
/// Excess over the least distance up to which a pair of points counts as nearest, relative to the smaller link.
// The mean of several pairs is less sensitive to the sampling of the surfaces.
const NEAR_RATIO: f64 = 0.3;
/// Least weight of the prior that a pivot lies at the nearest point.
// Rounding of poses needs it: without it, undetermined directions are singular.
const MIN_WEIGHT: f64 = 1e-9;
/// Prior deviation of a pivot from the nearest point, metres.
// The estimated noise of the poses, divided by it, is the weight of the prior.
const PRIOR_DEVIATION_M: f64 = 0.1;
/// Cost of a metre between two links, in metres of residual.
// Of pairs that fit about as well, neighbours are the likelier joint.
const DISTANCE_COST: f64 = 0.1;

/// A pivot that two units of a scene share: one point, fixed in the frames of both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pivot {
    /// Number of the child unit.
    pub unit: usize,
    /// Number of the parent unit.
    pub parent: usize,
    /// The pivot in the unit's body frame, metres.
    pub pivot: Point3<f32>,
    /// The pivot in the parent's body frame, metres.
    pub parent_pivot: Point3<f32>,
    /// Root mean square over the observed frames of the distance of its two images, metres.
    pub residual_m: f32,
}

impl Pivot {
    /// Distance of its two images under poses of the scene's units, metres; `None` where a pose is missing.
    pub fn apart_m(&self, poses: &[Isometry3<f32>]) -> Option<f64> {
        let image = |unit: usize, pivot: &Point3<f32>| -> Option<Point3<f64>> {
            Some(poses.get(unit)?.cast::<f64>() * pivot.cast::<f64>())
        };
        in_own_environment(|| {
            let [own, parents] =
                [image(self.unit, &self.pivot)?, image(self.parent, &self.parent_pivot)?];
            Some((own - parents).norm())
        })
    }
}

/// Observed motion of a link.
#[derive(Clone, Copy, Debug)]
pub struct Link<'a> {
    /// Points in its own frame, metres.
    pub points: &'a [Point3<f32>],
    /// The body that it belongs to; `None`: a body of its own, which is joined to none.
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
    /// A link lacks poses of some frames.
    #[error(
        "part {link} has {found} poses, the first part {expected}; give every part a pose at every frame"
    )]
    Frames {
        /// Which link.
        link: usize,
        /// Its poses.
        found: usize,
        /// Those of the first link.
        expected: usize,
    },
    /// A link of a body has no points.
    #[error(
        "part {link} has no points; the place where two parts are nearest takes at least one of each"
    )]
    NoPoints {
        /// Which link.
        link: usize,
    },
    /// A point or a pose is not finite.
    #[error("part {link} has a point or a pose that is not finite")]
    NotFinite {
        /// Which link.
        link: usize,
    },
}

/// Pivots of all bodies of several links, in an order in which parents come first; the root of each tree is the link with the least number.
/// A body whose links fit no common tree within [`TOLERANCE_M`] has several trees.
///
/// ```
/// use nalgebra::{Isometry3, Point3, Vector3};
/// use rigidformer_runtime::pivots::{self, Link};
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
/// let link = |poses| Link { points: &bar, body: Some(1), poses };
/// let found = pivots::find(&[link(&still), link(&swinging)])?;
/// let [pivot] = found[..] else { panic!("one pair") };
/// assert_eq!((pivot.unit, pivot.parent), (1, 0));
/// assert!((pivot.pivot - Point3::new(-0.15, 0.0, 0.0)).norm() < 1e-4);
/// assert!((pivot.parent_pivot - Point3::new(0.15, 0.0, 0.0)).norm() < 1e-4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`PivotError`]
pub fn find(links: &[Link<'_>]) -> Result<Vec<Pivot>, PivotError> {
    in_own_environment(|| find_here(links))
}

fn find_here(links: &[Link<'_>]) -> Result<Vec<Pivot>, PivotError> {
    let expected = links.first().map_or(0, |link| link.poses.len());
    for (number, link) in links.iter().enumerate() {
        let found = link.poses.len();
        if found != expected {
            return Err(PivotError::Frames { link: number, found, expected });
        }
        if link.body.is_some() && link.points.is_empty() {
            return Err(PivotError::NoPoints { link: number });
        }
        let is_finite = |pose: &Isometry3<f32>| {
            pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite())
        };
        let points = || link.points.iter().flat_map(|point| point.iter());
        if !(link.poses.iter().all(is_finite) && points().all(|v| v.is_finite())) {
            return Err(PivotError::NotFinite { link: number });
        }
    }
    // A single frame has no motion.
    if expected < 2 {
        return Err(PivotError::TooFewFrames { found: expected });
    }
    let motions: Vec<LinkMotion> = links.iter().map(LinkMotion::new).collect();
    let mut pairs = Vec::new();
    for (j, second) in links.iter().enumerate() {
        for (i, first) in links.iter().enumerate().take(j) {
            // Links of different bodies are not connected.
            if first.body.is_some() && first.body == second.body {
                pairs.push(LinkPair::new([i, j], [&motions[i], &motions[j]]));
            }
        }
    }
    // Pairs that slide have no pivot.
    pairs.retain(|pair| pair.residual <= TOLERANCE_M);
    pairs.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.links.cmp(&b.links)));
    Ok(rooted(links.len(), &spanning(links.len(), pairs)))
}

/// Joins units of a simulator, by their numbers, at these pivots.
///
/// # Errors
/// [`JoinError`]; the joints are what they were.
pub fn hold(simulator: &mut Simulator<'_, '_>, pivots: &[Pivot]) -> Result<(), JoinError> {
    let before: Vec<Joint> = simulator.joints().collect();
    let done = pivots.iter().try_for_each(|found| {
        let no_unit = UnitId::from_bits(0);
        let id = |number| simulator.unit(number).map_or(no_unit, |unit| unit.id());
        let [unit, parent] = [found.unit, found.parent].map(id);
        let Pivot { pivot, parent_pivot, .. } = *found;
        simulator.join(&Joint::ball(unit, parent, pivot, parent_pivot))
    });
    // A failed call leaves the joints as they were.
    if done.is_err() {
        let joined: Vec<UnitId> = simulator.joints().map(|joint| joint.unit).collect();
        joined.into_iter().try_for_each(|unit| simulator.unjoin(unit).map(drop))?;
        before.iter().try_for_each(|joint| simulator.join(joint))?;
    }
    done
}

/// A link's poses and points in f64.
struct LinkMotion {
    rotations: Vec<Matrix3<f64>>,
    positions: Vec<Vector3<f64>>,
    /// Points at the last frame.
    points: Vec<Vector3<f64>>,
    /// Longest side of the bounding box of its points.
    size: f64,
}

impl LinkMotion {
    fn new(link: &Link<'_>) -> Self {
        let poses = link.poses.iter().map(|pose| pose.cast::<f64>());
        let (rotations, positions): (Vec<_>, Vec<_>) = poses
            .map(|mut pose| {
                // f32 quaternions are unit to 1e-7 alone, and a scaled rotation would bias the fit.
                pose.rotation.renormalize();
                (pose.rotation.to_rotation_matrix().into_inner(), pose.translation.vector)
            })
            .unzip();
        let points_of = || link.points.iter().map(|point| point.coords.cast::<f64>());
        let low = points_of().fold(Vector3::repeat(f64::INFINITY), |low, point| low.inf(&point));
        let high =
            points_of().fold(Vector3::repeat(f64::NEG_INFINITY), |high, point| high.sup(&point));
        let last = rotations.last().zip(positions.last());
        let points =
            points_of().filter_map(|point| last.map(|(turn, position)| turn * point + position));
        let points = points.collect();
        LinkMotion { rotations, positions, points, size: (high - low).max() }
    }
}

/// Two links and their best pivot.
struct LinkPair {
    links: [usize; 2],
    pivots: [Vector3<f64>; 2],
    residual: f64,
    cost: f64,
}

impl LinkPair {
    fn new(links: [usize; 2], motions: [&LinkMotion; 2]) -> Self {
        let (near, distance) = nearest(motions);
        // Starting points are in both frames at one instant: any frame will do.
        let last = motions[0].positions.len() - 1;
        let start = motions.map(|link| link.rotations[last].tr_mul(&(near - link.positions[last])));
        let frames = motions[0].positions.len() as f64;
        // Normal equations of the separation at the start, in the two points.
        let mut matrix = Matrix6::identity();
        let (mut rotation_product, mut gradient) = (Matrix3::zeros(), Vector6::zeros());
        for frame in 0..=last {
            let [r, s] = motions.map(|link| link.rotations[frame]);
            let separation = separation(motions, frame, &start);
            rotation_product += r.tr_mul(&s);
            let mut upper = gradient.fixed_rows_mut::<3>(0);
            upper += r.tr_mul(&separation);
            let mut lower = gradient.fixed_rows_mut::<3>(3);
            lower -= s.tr_mul(&separation);
        }
        rotation_product /= frames;
        gradient /= frames;
        matrix.fixed_view_mut::<3, 3>(0, 3).copy_from(&-rotation_product);
        matrix.fixed_view_mut::<3, 3>(3, 0).copy_from(&-rotation_product.transpose());
        let solve = |weight: f64| {
            let matrix = matrix + Matrix6::identity() * weight;
            let change =
                matrix.cholesky().map_or_else(Vector6::zeros, |found| found.solve(&-gradient));
            let pivots =
                [start[0] + change.fixed_rows::<3>(0), start[1] + change.fixed_rows::<3>(3)];
            let squares =
                (0..=last).map(|frame| separation(motions, frame, &pivots).norm_squared());
            (pivots, (squares.sum::<f64>() / frames).sqrt())
        };
        // The residual without a prior estimates the noise of the poses.
        let (_, residual) = solve(MIN_WEIGHT);
        let redundancy = 3.0 * frames - 6.0;
        let noise = if redundancy > 0.0 { residual * residual * frames / redundancy } else { 0.0 };
        let (pivots, residual) =
            solve(MIN_WEIGHT + noise / (PRIOR_DEVIATION_M * PRIOR_DEVIATION_M));
        LinkPair { links, pivots, residual, cost: residual + DISTANCE_COST * distance }
    }
}

/// Vector from the second link's image of a pivot to the first link's.
fn separation(motions: [&LinkMotion; 2], frame: usize, pivots: &[Vector3<f64>; 2]) -> Vector3<f64> {
    let image = |link: usize| {
        motions[link].rotations[frame] * pivots[link] + motions[link].positions[frame]
    };
    image(0) - image(1)
}

/// Mean of the nearest points of two links, and their distance.
fn nearest(motions: [&LinkMotion; 2]) -> (Vector3<f64>, f64) {
    let squares = |a: &Vector3<f64>, b: &Vector3<f64>| (a - b).norm_squared();
    let mut least = f64::INFINITY;
    for a in &motions[0].points {
        for b in &motions[1].points {
            least = least.min(squares(a, b));
        }
    }
    let distance = least.sqrt();
    let reach = distance + NEAR_RATIO * motions[0].size.min(motions[1].size);
    let (mut sum, mut count) = (Vector3::zeros(), 0.0);
    for a in &motions[0].points {
        for b in &motions[1].points {
            if squares(a, b) <= reach * reach {
                sum += a + b;
                count += 2.0;
            }
        }
    }
    (sum / f64::max(count, 1.0), distance)
}

/// Kruskal's minimum spanning forest: the pairs, in the order of their costs, that close no cycle.
fn spanning(links: usize, pairs: Vec<LinkPair>) -> Vec<LinkPair> {
    let mut tree: Vec<usize> = (0..links).collect();
    let mut kept = pairs;
    kept.retain(|pair| {
        let [a, b] = pair.links.map(|link| tree[link]);
        for root in tree.iter_mut().filter(|root| **root == b) {
            *root = a;
        }
        a != b
    });
    kept
}

/// The pairs as children and parents.
fn rooted(links: usize, pairs: &[LinkPair]) -> Vec<Pivot> {
    let mut pivots = Vec::with_capacity(pairs.len());
    let mut is_attached = vec![false; links];
    for root in 0..links {
        if is_attached[root] {
            continue;
        }
        is_attached[root] = true;
        let mut open = vec![root];
        while let Some(parent) = open.pop() {
            for pair in pairs {
                let side = match pair.links {
                    [a, b] if a == parent && !is_attached[b] => 1,
                    [a, b] if b == parent && !is_attached[a] => 0,
                    _ => continue,
                };
                let unit = pair.links[side];
                is_attached[unit] = true;
                open.push(unit);
                let [pivot, parent_pivot] =
                    [side, 1 - side].map(|side| Point3::from(pair.pivots[side].cast::<f32>()));
                let residual_m = pair.residual as f32;
                pivots.push(Pivot { unit, parent, pivot, parent_pivot, residual_m });
            }
        }
    }
    pivots
}
