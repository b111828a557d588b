//! Canonical order, centre, radius and farthest-point ordering of a unit's points.

use super::{dot, norm};
use crate::kernels::in_own_environment;
use core::cmp::Ordering;
use nalgebra::{Point3, Vector3};

/// Kernel radius of the centre's density weights, as a share of the unit's diameter.
const DENSITY_RADIUS: f32 = 0.2;

/// Estimate of the centre of mass from points alone: the centroid of their convex hull, or their
/// [`density_centre`] where that is not their shape (docs/MODEL.md, section 1).
///
/// `points` are sorted in place by x, y, z, which makes the result independent of their order.
pub fn centre_of_mass(points: &mut [Point3<f32>]) -> Point3<f32> {
    in_own_environment(|| centre_of_mass_here(points))
}

pub(crate) fn centre_of_mass_here(points: &mut [Point3<f32>]) -> Point3<f32> {
    sort(points);
    super::extreme_points::hull_centre(points).unwrap_or_else(|| density_centre_here(points))
}

/// Estimate of the centre of mass without the shape: their mean, each weighted by the
/// inverse of the local point density, so that an unevenly sampled surface does not pull
/// it aside (docs/MODEL.md, section 1).
///
/// `points` are sorted in place by x, y, z, which makes the result independent of their
/// order. Time grows with the square of their number.
pub fn density_centre(points: &mut [Point3<f32>]) -> Point3<f32> {
    in_own_environment(|| density_centre_here(points))
}

fn density_centre_here(points: &mut [Point3<f32>]) -> Point3<f32> {
    sort(points);
    let mut diameter2 = 0.0_f32;
    for (i, a) in points.iter().enumerate() {
        for b in points.iter().skip(i + 1) {
            let d = a - b;
            diameter2 = diameter2.max(dot(&d, &d));
        }
    }
    let reach2 = (DENSITY_RADIUS * DENSITY_RADIUS) * diameter2;
    if reach2 < f32::MIN_POSITIVE {
        return points.first().copied().unwrap_or_else(Point3::origin);
    }
    let mut total = 0.0_f32;
    let mut sum = Vector3::zeros();
    for a in points.iter() {
        let mut density = 0.0_f32;
        for b in points.iter() {
            let d = a - b;
            let q = 1.0 + dot(&d, &d) / reach2;
            let q2 = q * q;
            density += 1.0 / (q2 * q2);
        }
        let weight = 1.0 / density;
        total += weight;
        sum += a.coords * weight;
    }
    Point3::from(sum / total)
}

/// Points whose distance is this close to the greatest count as equally far, so that
/// rounding does not decide between the corners of a symmetric unit.
const TIE: f32 = 1.0 - 1e-4;

/// Puts points into farthest-point order in place: the first is the farthest from
/// `centre`, each next the farthest from all before it; ties go to the smallest x, y, z.
/// Any prefix then covers the unit evenly, and the first four are its anchors.
///
/// `distance` is scratch of at least as many numbers as there are points.
pub fn farthest_point_order(
    points: &mut [Point3<f32>],
    centre: &Point3<f32>,
    distance: &mut [f32],
) {
    in_own_environment(|| farthest_point_order_here(points, centre, distance));
}

pub(crate) fn farthest_point_order_here(
    points: &mut [Point3<f32>],
    centre: &Point3<f32>,
    distance: &mut [f32],
) {
    #[cfg(rigidformer_host)]
    if points.len() >= MANY && blocks::order(points, centre, distance).is_some() {
        return;
    }
    let mut start = true;
    let mut reference = *centre;
    let mut rest = points;
    let mut distance = distance;
    while !rest.is_empty() {
        let greatest = nearer(rest, distance, &reference, start);
        // The first point chosen replaces the centre; its distances start afresh.
        let fresh = core::mem::replace(&mut start, false);
        let best = smallest(rest, distance, greatest * TIE);
        let Some((index, chosen)) = best else { return };
        let (Some((first, points)), Some((nearest, distances))) = (
            core::mem::take(&mut rest).split_first_mut(),
            core::mem::take(&mut distance).split_first_mut(),
        ) else {
            return;
        };
        // The one that is first already has nothing to change places with.
        let other = index.checked_sub(1);
        if let Some(other) = other.and_then(|other| points.get_mut(other)) {
            core::mem::swap(first, other);
        }
        if let Some(other) = other.and_then(|other| distances.get_mut(other)) {
            core::mem::swap(nearest, other);
        }
        if fresh {
            distances.fill(f32::INFINITY);
        }
        reference = chosen;
        rest = points;
        distance = distances;
    }
}

/// Points that are looked at together.
// On hosts in vectors: whoever adds a mesh waits for the square of its points.
const LANES: usize = if cfg!(rigidformer_host) { 8 } else { 1 };

/// Lowers each point's distance, squared, to that from `reference`, or sets it to that, and returns the greatest.
fn nearer(
    points: &[Point3<f32>],
    distance: &mut [f32],
    reference: &Point3<f32>,
    sets: bool,
) -> f32 {
    let mut greatest = [0.0_f32; LANES];
    for (points, distances) in points.chunks(LANES).zip(distance.chunks_mut(LANES)) {
        for ((p, d), greatest) in points.iter().zip(distances).zip(&mut greatest) {
            let delta = p - reference;
            let d2 = dot(&delta, &delta);
            // Comparisons, and not `min` and `max`, which ask for numbers that are none.
            *d = if sets || d2 < *d { d2 } else { *d };
            *greatest = if *d > *greatest { *d } else { *greatest };
        }
    }
    greatest.into_iter().fold(0.0, f32::max)
}

/// The point of the smallest x, y, z among those at least so far away, and its place.
fn smallest(points: &[Point3<f32>], distance: &[f32], least: f32) -> Option<(usize, Point3<f32>)> {
    let mut best: Option<(usize, Point3<f32>)> = None;
    let chunks = points.chunks(LANES).zip(distance.chunks(LANES));
    for (start, (points, distances)) in (0..).step_by(LANES).zip(chunks) {
        // Few points are so far away, and the look at all of them at once is short.
        if distances.iter().fold(false, |any, d| any | (*d >= least)) {
            for (i, (p, d)) in (start..).zip(points.iter().zip(distances)) {
                let first = best.is_none_or(|(_, b)| lexicographic(p, &b) == Ordering::Less);
                if *d >= least && first {
                    best = Some((i, *p));
                }
            }
        }
    }
    best
}

/// From so many points on, hosts leave out blocks of points that are too near to be changed.
#[cfg(rigidformer_host)]
const MANY: usize = 1024;

/// The same order in less time than the square of the points takes: they stay in blocks, and each has its place in the order written
/// in its distance's stead.
#[cfg(rigidformer_host)]
mod blocks {
    use super::{TIE, lexicographic, nearer, smallest};
    use crate::geometry::dot;
    use core::cmp::Ordering;
    use nalgebra::{Point3, Vector3};

    // Sorted points of a surface are in slices: the looks at blocks and at points cost alike for tens of thousands.
    const BLOCKS: usize = 128;
    /// Whole numbers below it are numbers of f32.
    const EXACT: usize = 1 << 24;

    /// What is known of a block of points.
    #[derive(Clone, Copy)]
    struct Block {
        low: Point3<f32>,
        high: Point3<f32>,
        /// The greatest distance of its points, squared.
        most: f32,
    }

    impl Block {
        fn of(points: &[Point3<f32>]) -> Self {
            let first = points.first().copied().unwrap_or_else(Point3::origin);
            let start = Block { low: first, high: first, most: 0.0 };
            points.iter().fold(start, |block, point| Block {
                low: block.low.inf(point),
                high: block.high.sup(point),
                ..block
            })
        }

        /// No point of it is nearer than that, squared. Sums and products round upwards and downwards alike, so this holds to the bit.
        fn gap2(&self, point: &Point3<f32>) -> f32 {
            let gap = (self.low - point).sup(&(point - self.high)).sup(&Vector3::zeros());
            dot(&gap, &gap)
        }
    }

    /// Puts points into farthest-point order. None, and nothing is moved, where another order of equal points could show: points that
    /// are not sorted, or not finite, or zeros of two signs.
    pub(super) fn order(
        points: &mut [Point3<f32>],
        centre: &Point3<f32>,
        distance: &mut [f32],
    ) -> Option<()> {
        let (count, distance) = (points.len(), distance.get_mut(..points.len())?);
        let is_finite = |p: &Point3<f32>| p.iter().all(|x| x.is_finite());
        let bits = |p: &Point3<f32>| p.coords.map(f32::to_bits);
        let follows = |a: &Point3<f32>, b: &Point3<f32>| match lexicographic(a, b) {
            Ordering::Less => true,
            Ordering::Equal => bits(a) == bits(b),
            Ordering::Greater => false,
        };
        let is_plain = count < EXACT && is_finite(centre) && points.iter().all(is_finite);
        if !is_plain || !points.is_sorted_by(follows) {
            return None;
        }
        let size = count.div_ceil(BLOCKS).max(1);
        let mut blocks = [Block::of(&[]); BLOCKS];
        for (block, points) in blocks.iter_mut().zip(points.chunks(size)) {
            *block = Block::of(points);
        }
        let mut reference = *centre;
        for place in 0..count {
            let mut greatest = 0.0_f32;
            let rows = points.chunks(size).zip(distance.chunks_mut(size)).zip(&mut blocks);
            for ((points, distances), block) in rows {
                // The distances of the first two are new ones.
                if place < 2 || block.gap2(&reference) < block.most {
                    block.most = nearer(points, distances, &reference, place == 0);
                }
                greatest = greatest.max(block.most);
            }
            let least = greatest * TIE;
            let mut best: Option<(usize, Point3<f32>)> = None;
            let rows = points.chunks(size).zip(distance.chunks(size)).zip(&blocks);
            for (start, ((points, distances), _)) in
                (0..).step_by(size).zip(rows).filter(|(_, (_, block))| block.most >= least)
            {
                if let Some((index, point)) = smallest(points, distances, least)
                    && best.is_none_or(|(_, b)| lexicographic(&point, &b) == Ordering::Less)
                {
                    best = Some((start + index, point));
                }
            }
            let (index, chosen) = best?;
            // Below every distance, so it is neither lowered nor chosen.
            *distance.get_mut(index)? = -((place + 1) as f32);
            if place == 0 {
                let rest = distance.iter_mut().filter(|distance| **distance >= 0.0);
                rest.for_each(|distance| *distance = f32::INFINITY);
            }
            reference = chosen;
        }
        for at in 0..count {
            // Each swap brings a point to its place.
            while let Some(place) =
                distance.get(at).and_then(|code| (-code as usize).checked_sub(1))
                && place != at
                && let (Ok([a, b]), Ok([c, d])) =
                    (points.get_disjoint_mut([at, place]), distance.get_disjoint_mut([at, place]))
            {
                core::mem::swap(a, b);
                core::mem::swap(c, d);
            }
        }
        Some(())
    }
}

/// So few points are sorted by insertion on hosts.
const FEW: usize = 32;

/// By x, y, z; points that are equal in that stay in their order. The sorts of the standard library need memory, or are large
/// and can panic.
fn sort(points: &mut [Point3<f32>]) {
    let half = points.len() / 2;
    // Only hosts get units of so many points that the square of their number is long to wait for.
    if cfg!(rigidformer_host)
        && points.len() > FEW
        && let Some((low, high)) = points.split_at_mut_checked(half)
    {
        sort(low);
        sort(high);
        return merge(points, half);
    }
    for end in 1..points.len() {
        let mut at = end;
        while let Some([a, b]) = at.checked_sub(1).and_then(|low| points.get_mut(low..=at))
            && lexicographic(a, b) == Ordering::Greater
        {
            core::mem::swap(a, b);
            at -= 1;
        }
    }
}

/// Makes one sorted run of two, of which the second begins at `middle`, in place: halves the longer one, brings what is less before
/// what is not, and merges both sides.
fn merge(points: &mut [Point3<f32>], middle: usize) {
    if let ([a, b], 1) = (&mut *points, middle) {
        if lexicographic(a, b) == Ordering::Greater {
            core::mem::swap(a, b);
        }
        return;
    }
    let Some((low, high)) = points.split_at_checked(middle) else { return };
    let (Some(last), Some(first)) = (low.last(), high.first()) else { return };
    if lexicographic(last, first) != Ordering::Greater {
        return;
    }
    // Of equal points those of the first run come first.
    let (before, within) = if low.len() > high.len() {
        let before = low.len() / 2;
        let less = |p: &Point3<f32>| {
            low.get(before).is_some_and(|own| lexicographic(p, own) == Ordering::Less)
        };
        (before, high.partition_point(less))
    } else {
        let within = high.len() / 2;
        let not_greater = |p: &Point3<f32>| {
            high.get(within).is_some_and(|own| lexicographic(p, own) != Ordering::Greater)
        };
        (low.partition_point(not_greater), within)
    };
    let behind = middle - before;
    if let Some(turned) = points.get_mut(before..middle + within)
        && behind <= turned.len()
    {
        turned.rotate_left(behind);
    }
    if let Some((first, second)) = points.split_at_mut_checked(before + within) {
        merge(first, before);
        merge(second, behind);
    }
}

/// Radius about the origin of a sphere that holds all points, metres.
pub fn radius(points: &[Point3<f32>]) -> f32 {
    in_own_environment(|| radius_here(points))
}

pub(crate) fn radius_here(points: &[Point3<f32>]) -> f32 {
    points.iter().fold(0.0_f32, |r, p| r.max(norm(&p.coords)))
}

fn lexicographic(a: &Point3<f32>, b: &Point3<f32>) -> Ordering {
    let by = |x: f32, y: f32| x.partial_cmp(&y).unwrap_or(Ordering::Equal);
    by(a.x, b.x).then(by(a.y, b.y)).then(by(a.z, b.z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn bits(points: &[Point3<f32>]) -> Vec<[u32; 3]> {
        points.iter().map(|p| [p.x, p.y, p.z].map(f32::to_bits)).collect()
    }

    /// By blocks and without: equal to the bit, on surfaces, lattices, with duplicates and on a line.
    #[cfg(rigidformer_host)]
    #[test]
    fn blocks_change_no_order() {
        let mut state = 7_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let mut clouds = Vec::new();
        for count in [1024_usize, 1025, 3000] {
            let ball = (0..count).map(|_| {
                let v = Vector3::new(random(), random(), random());
                Point3::from(v / norm(&v).max(1e-3))
            });
            clouds.push(ball.collect::<Vec<_>>());
            clouds.push(
                (0..count)
                    .map(|i| Point3::new((i % 13) as f32, (i / 13 % 11) as f32, (i / 143) as f32))
                    .collect(),
            );
            clouds.push(
                (0..count).map(|i| Point3::new((i % 3) as f32, (i % 5) as f32, 1.0)).collect(),
            );
            clouds.push((0..count).map(|_| Point3::new(0.5, random(), 0.5)).collect());
            clouds.push(
                (0..count)
                    .map(|_| Point3::new(1e19 * random(), random(), 1e-30 * random()))
                    .collect(),
            );
            clouds.push(vec_of(count, Point3::new(1.0, 2.0, 3.0)));
        }
        for mut points in clouds {
            sort(&mut points);
            let centre = Point3::new(0.1, -0.2, 0.3);
            let mut expected = points.clone();
            let mut distance = Vec::from_iter(points.iter().map(|_| 0.0));
            slowly(&mut expected, &centre);
            assert!(blocks::order(&mut points, &centre, &mut distance).is_some());
            assert_eq!(bits(&points), bits(&expected));
        }
        // What could show is left to the other.
        let mut twins = vec_of(1024, Point3::new(0.0, 1.0, 2.0));
        twins[512].x = -0.0;
        let before = bits(&twins);
        let mut distance = Vec::from_iter(twins.iter().map(|_| 0.0));
        assert_eq!(blocks::order(&mut twins, &Point3::origin(), &mut distance), None);
        assert_eq!(bits(&twins), before);
    }

    #[cfg(rigidformer_host)]
    fn vec_of(count: usize, point: Point3<f32>) -> Vec<Point3<f32>> {
        Vec::from_iter(core::iter::repeat_n(point, count))
    }

    /// The definition.
    #[cfg(rigidformer_host)]
    fn slowly(points: &mut [Point3<f32>], centre: &Point3<f32>) {
        let mut distance = Vec::from_iter(points.iter().map(|p| dot(&(p - centre), &(p - centre))));
        for place in 0..points.len() {
            let least = distance[place..].iter().fold(0.0, |a: f32, b| a.max(*b)) * TIE;
            let far = (place..points.len()).filter(|i| distance[*i] >= least);
            let best = far.min_by(|a, b| lexicographic(&points[*a], &points[*b])).unwrap();
            points.swap(place, best);
            distance.swap(place, best);
            let chosen = points[place];
            for (p, d) in points.iter().zip(&mut distance).skip(place + 1) {
                let d2 = dot(&(p - chosen), &(p - chosen));
                *d = if place == 0 { d2 } else { d.min(d2) };
            }
        }
    }

    #[test]
    fn many_points_are_sorted_as_few_are() {
        let mut state = 1_u32;
        let mut next = |most: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % most
        };
        // Signs of zero tell points apart that are equal.
        let number = |n: u32| if n == 0 { -0.0 } else { (n - 1) as f32 };
        for count in (0..200).chain([1000, 4099]) {
            for most in [1, 2, 3, 5, 1000] {
                let mut points = [Point3::origin(); 4099];
                let points = &mut points[..count];
                points.fill_with(|| Point3::new(number(next(most)), number(next(most)), 7.0));
                let mut expected = [Point3::origin(); 4099];
                let expected = &mut expected[..count];
                expected.copy_from_slice(points);
                for end in 1..count {
                    let mut at = end;
                    while at > 0 && lexicographic(&expected[at - 1], &expected[at]).is_gt() {
                        expected.swap(at - 1, at);
                        at -= 1;
                    }
                }
                sort(points);
                assert_eq!(bits(points), bits(expected), "{count} {most}");
                points.reverse();
                sort(points);
                assert!(points.is_sorted_by(|a, b| lexicographic(a, b).is_le()));
            }
        }
    }
}
