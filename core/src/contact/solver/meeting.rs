//! How two hulls are to each other, and what their faces share.

use super::patch::{self, Patch, Slope};
use crate::geometry::{Hull, Precision, Separation, direction, dot, separation};
use crate::math;
use nalgebra::Vector3;

/// Points this close to the lowest one belong to its face, in radii: sampled faces are not flat to the bit.
pub(super) const FACE: f32 = 0.03;
/// Hulls that overlap are moved this far apart to find their normal, in radii: overlapping hulls have no closest points.
const APART: f32 = 0.02;
/// Of a unit vector some component is at most 1 / sqrt(3). Crossing with its axis gives tangents that are far from zero.
const SEED: f32 = 0.577;

/// A unit vector across another one.
pub(super) fn tangent(normal: &Vector3<f32>) -> Vector3<f32> {
    let seed = if normal.x.abs() < SEED {
        Vector3::x()
    } else if normal.y.abs() < SEED {
        Vector3::y()
    } else {
        Vector3::z()
    };
    let across = normal.cross(&seed);
    across / math::sqrt(dot(&across, &across))
}

/// How two hulls are to each other. Points are counted from the first one's centre.
pub(super) struct Meeting {
    /// Negative where they overlap, metres.
    pub(super) gap: f32,
    /// From the first to the second.
    pub(super) normal: Vector3<f32>,
    /// Between their closest points.
    pub(super) middle: Vector3<f32>,
}

/// Hulls are grown by what makes them round. Their centres are `apart`, and `between` goes from the middle of one to that of the
/// other. The gap of those that are farther than `far` apart may be infinite. Those that overlap are moved apart along a first
/// guess; the normal there serves if it tells of less.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn meeting(
    hulls: [&Hull<'_>; 2],
    rounds @ [round, other_round]: [f32; 2],
    (apart, between, known): (&Vector3<f32>, &Vector3<f32>, Option<Vector3<f32>>),
    [small, radii, far]: [f32; 3],
) -> Meeting {
    let guess = known.unwrap_or(*between);
    let beyond_m = far + (round + other_round);
    let precision = Precision { beyond_m, ..Precision::fine(radii) };
    if let Some(found) = separation(hulls, &-apart, &-guess, &precision) {
        let Separation { distance, normal, levers: [own, other] } = found;
        let (own, other) = (own + normal * round, (other + apart) - normal * other_round);
        let gap = distance - (round + other_round);
        return Meeting { gap, normal, middle: (own + other) * 0.5 };
    }
    let gap = |normal: &Vector3<f32>| gap_along(hulls, rounds, apart, normal);
    let mut normal = known.or_else(|| direction(between)).unwrap_or_else(Vector3::z);
    for _ in 0..2 {
        let here = gap(&normal);
        let moved = apart + normal * (APART * small - here);
        let Some(found) = separation(hulls, &-moved, &-normal, &Precision::fine(radii)) else {
            break;
        };
        if gap(&found.normal) > here {
            normal = found.normal;
        }
    }
    let [own, other] = ends(hulls, rounds, apart, &normal);
    Meeting { gap: gap(&normal), normal, middle: (own + other) * 0.5 }
}

/// The outermost points of two hulls towards each other along a normal from the first to the second.
fn ends(
    [mine, theirs]: [&Hull<'_>; 2],
    [round, other_round]: [f32; 2],
    apart: &Vector3<f32>,
    normal: &Vector3<f32>,
) -> [Vector3<f32>; 2] {
    let own = mine.support(normal) + normal * round;
    [own, (theirs.support(&-normal) + apart) - normal * other_round]
}

/// Gap of two hulls along a normal from the first to the second, negative where they overlap along it: no more than what
/// is between them.
pub(super) fn gap_along(
    hulls: [&Hull<'_>; 2],
    rounds: [f32; 2],
    apart: &Vector3<f32>,
    normal: &Vector3<f32>,
) -> f32 {
    let [own, other] = ends(hulls, rounds, apart, normal);
    dot(&(other - own), normal)
}

/// The patch that the faces of two hulls share, seen along the normal; none where they share less than an edge.
#[cfg_attr(rigidformer_dsp, inline(never))]
pub(super) fn touching(
    [mine, theirs]: [&Hull<'_>; 2],
    [own, other]: [f32; 2],
    apart: &Vector3<f32>,
    (met, skin): (&Meeting, f32),
) -> Option<Patch> {
    let Meeting { gap, normal, middle } = *met;
    let u = tangent(&normal);
    let axes = [u, normal.cross(&u), normal];
    let mine = patch::face(mine, &Vector3::zeros(), &axes, (1.0, FACE * own));
    let theirs = patch::face(theirs, apart, &axes, (-1.0, FACE * other));
    let shared = patch::overlap(&mine, &theirs);
    if shared.is_empty() {
        return None;
    }
    let (low, high) = (Slope::new(&mine, own), Slope::new(&theirs, other));
    let [u, v, n] = axes;
    let points = shared.iter().map(|place @ [x, y]| {
        let (low, high) = (low.at(*place), high.at(*place));
        let point = (u * *x + v * *y) + n * (0.5 * (low + high));
        // Slopes are fits: no point of hulls that are apart is closer than they are.
        let between = high - low;
        (point, if gap > 0.0 { between.max(gap) } else { between })
    });
    // They may meet beside what their faces share.
    let least = points.clone().fold(f32::INFINITY, |least, (_, gap)| least.min(gap));
    let beside = (least > gap + skin).then_some((middle, gap));
    Some(patch::choose(points.chain(beside), &normal))
}
