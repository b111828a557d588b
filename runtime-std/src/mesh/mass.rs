//! Volume, centre of mass and inertia of what a mesh encloses.

use nalgebra::{Matrix3, Point3, Vector3};
use rigidformer_core::kernels::in_own_environment;

use super::triangles::TriangleMesh;

/// Volume below which a mesh encloses nothing, as a share of its bounding box's diagonal cubed.
// Rounding of f32 corners alone gives 1e-7 of it.
const NOTHING: f64 = 1e-6;

/// Parts among which one is searched that is around a cavity.
const MOST_CAVITIES: usize = 512;
/// Triangles that are looked at for it, over all parts. Beyond them boxes decide.
const MOST_LOOKS: usize = 1 << 26;

/// Mass properties of a uniform body of density 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassProperties {
    /// Its volume.
    pub volume_m3: f64,
    /// Centre of mass.
    pub centre_m: Point3<f64>,
    /// Moments and products of inertia about the centre of mass, along the mesh's axes; times a density in kg/m3 they are in kg m2.
    pub inertia_m5: Matrix3<f64>,
}

impl TriangleMesh {
    /// Those of the uniform body within, by signed tetrahedra. Parts whose faces look inwards are cavities where another part is around
    /// them. None where the mesh is not closed, or encloses nothing: see [`is_closed`](Self::is_closed).
    pub fn mass_properties(&self) -> Option<MassProperties> {
        in_own_environment(|| {
            let welded = self.welded();
            welded.is_closed().then(|| MassProperties::of(&welded.outward())).flatten()
        })
    }

    /// The same mesh, closed and [`welded`](Self::welded), with parts turned whose faces look inwards, but for cavities.
    pub fn outward(&self) -> Self {
        let parts = self.parts();
        let bounds: Vec<_> = parts.iter().map(bounds).collect();
        let mut looks = MOST_LOOKS;
        let mut is_inside = |at: usize| {
            let (low, high) = bounds[at];
            let around = |(other, (least, most)): (usize, &(Vector3<f32>, Vector3<f32>))| {
                other != at
                    && (0..3).all(|axis| least[axis] < low[axis] && most[axis] > high[axis])
                    && match looks.checked_sub(parts[other].triangles.len()) {
                        Some(left) => {
                            looks = left;
                            parts[at].points.first().is_some_and(|own| parts[other].surrounds(own))
                        }
                        None => true,
                    }
            };
            bounds.iter().enumerate().take(MOST_CAVITIES).any(around)
        };
        let turned: Vec<bool> =
            (0..parts.len()).map(|at| parts[at].volume_m3() < 0.0 && !is_inside(at)).collect();
        let parts = parts.into_iter().zip(turned);
        TriangleMesh::joined(parts.map(|(part, turns)| if turns { part.flipped() } else { part }))
    }

    /// Whether a point is within a closed mesh: its faces are all around the point, whichever way they look.
    fn surrounds(&self, point: &Point3<f32>) -> bool {
        let solid_angle: f64 = self
            .corners()
            .map(|corners| {
                let [a, b, c] = corners.map(|corner| corner - point.coords.cast::<f64>());
                let [p, q, r] = [a.norm(), b.norm(), c.norm()];
                // Of Van Oosterom and Strackee (1983), half of it.
                let below = p * q * r + a.dot(&b) * r + b.dot(&c) * p + c.dot(&a) * q;
                a.dot(&b.cross(&c)).atan2(below)
            })
            .sum();
        solid_angle.abs() > std::f64::consts::PI
    }
}

fn bounds(mesh: &TriangleMesh) -> (Vector3<f32>, Vector3<f32>) {
    let first = mesh.points.first().copied().unwrap_or_default().coords;
    mesh.points.iter().fold((first, first), |(low, high), point| {
        (low.inf(&point.coords), high.sup(&point.coords))
    })
}

impl MassProperties {
    /// Of tetrahedra from the mesh's first point to its triangles.
    fn of(mesh: &TriangleMesh) -> Option<Self> {
        let origin = mesh.points.first()?.coords.cast::<f64>();
        let (mut volume, mut first, mut second) = (0.0, Vector3::zeros(), Matrix3::zeros());
        for corners in mesh.corners() {
            let [a, b, c] = corners.map(|corner| corner - origin);
            let part = a.dot(&b.cross(&c)) / 6.0;
            let sum = a + b + c;
            volume += part;
            first += sum * (part / 4.0);
            // Second moments of a tetrahedron with a corner at the origin.
            let squares = a * a.transpose() + b * b.transpose() + c * c.transpose();
            second += (squares + sum * sum.transpose()) * (part / 20.0);
        }
        let least = NOTHING * f64::from(mesh.size_m()).powi(3);
        if !(volume > least && volume.is_finite()) {
            return None;
        }
        let centre = first / volume;
        let about = second - centre * centre.transpose() * volume;
        let inertia = Matrix3::identity() * about.trace() - about;
        Some(MassProperties {
            volume_m3: volume,
            centre_m: Point3::from(origin + centre),
            inertia_m5: (inertia + inertia.transpose()) * 0.5,
        })
    }

    /// Those of several bodies together.
    pub fn sum(bodies: impl IntoIterator<Item = MassProperties>) -> Option<Self> {
        let bodies: Vec<MassProperties> = bodies.into_iter().collect();
        let volume_m3: f64 = bodies.iter().map(|body| body.volume_m3).sum();
        let weighted = bodies.iter().map(|body| body.centre_m.coords * body.volume_m3);
        let centre = weighted.sum::<Vector3<f64>>() / volume_m3;
        let moved = bodies.iter().map(|body| {
            let off = body.centre_m.coords - centre;
            let square = Matrix3::identity() * off.norm_squared() - off * off.transpose();
            body.inertia_m5 + square * body.volume_m3
        });
        (volume_m3 > 0.0).then(|| MassProperties {
            volume_m3,
            centre_m: Point3::from(centre),
            inertia_m5: moved.sum(),
        })
    }
}
