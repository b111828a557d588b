//! Points on a surface.

use nalgebra::{Point3, Vector3};
use rigidformer_runtime::mesh::TriangleMesh;

/// Points that are drawn from faces for each point that is kept.
const DRAWN: usize = 24;
/// Corners that are looked at besides, at most.
const CORNERS: usize = 4096;
/// The golden ratio's and the plastic number's fractions: sequences that fill a square evenly.
const STEPS: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053];

/// So many points of a surface that lie far from each other: of its corners, and of points spread evenly over its faces. The same
/// surface gives the same points.
pub(crate) fn points(mesh: &TriangleMesh, count: usize) -> Vec<Point3<f32>> {
    let every = mesh.points.len().div_ceil(CORNERS).max(1);
    let mut found: Vec<Point3<f32>> = mesh.points.iter().step_by(every).copied().collect();
    // Corners that no sample keeps may be the outermost ones.
    for axis in 0..3 {
        let by = |a: &&Point3<f32>, b: &&Point3<f32>| a[axis].total_cmp(&b[axis]);
        found.extend(mesh.points.iter().min_by(by).copied());
        found.extend(mesh.points.iter().max_by(by).copied());
    }
    drawn(mesh, count.saturating_mul(DRAWN), &mut found);
    farthest(&found, count)
}

/// Adds points of the faces, as many to each area.
fn drawn(mesh: &TriangleMesh, count: usize, found: &mut Vec<Point3<f32>>) {
    let corner = |corner: u32| -> Vector3<f64> {
        mesh.points.get(corner as usize).map_or(Vector3::zeros(), |point| point.coords.cast())
    };
    let area = |[a, b, c]: [Vector3<f64>; 3]| (b - a).cross(&(c - a)).norm();
    let total: f64 = mesh.triangles.iter().map(|face| area(face.map(corner))).sum();
    if !(total > 0.0 && total.is_finite()) {
        return;
    }
    let (mut below, mut next) = (0.0, 0_usize);
    for face in &mesh.triangles {
        let [a, b, c] = face.map(corner);
        below += area([a, b, c]);
        while next < count && (next as f64 + 0.5) * total <= below * count as f64 {
            let [mut u, mut v] = STEPS.map(|step| ((next + 1) as f64 * step).fract());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            found.push(Point3::from(a + (b - a) * u + (c - a) * v).cast());
            next += 1;
        }
    }
}

/// The points farthest from each other, the first one farthest from the mean.
fn farthest(points: &[Point3<f32>], count: usize) -> Vec<Point3<f32>> {
    let sum = points.iter().fold(Vector3::<f64>::zeros(), |sum, point| sum + point.coords.cast());
    let mut last = sum / points.len().max(1) as f64;
    let mut distances = vec![f64::INFINITY; points.len()];
    let mut kept: Vec<Point3<f32>> = Vec::new();
    for turn in 0..count {
        let mut best: Option<(usize, f64)> = None;
        for (number, (point, distance)) in points.iter().zip(&mut distances).enumerate() {
            let apart = (point.coords.cast() - last).norm_squared();
            // The mean is no point of the surface, so the choice after the first forgets it.
            *distance = if turn < 2 { apart } else { distance.min(apart) };
            if best.is_none_or(|(_, most)| *distance > most) {
                best = Some((number, *distance));
            }
        }
        let Some((number, apart)) = best else { break };
        // All others lie where one is kept already.
        if turn > 0 && apart <= 0.0 {
            break;
        }
        let Some(point) = points.get(number) else { break };
        kept.push(*point);
        last = point.coords.cast();
    }
    kept
}
