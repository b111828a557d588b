//! Bodies whose shape is known before they are seen: from a mesh.

use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use rigidformer_core::Pieces;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_runtime::hull::ConvexHull;

/// Surface elements of an object, at most.
// As many as a surface that is observed has.
const ELEMENTS: usize = 850;
/// Points among which they are chosen, so many for each.
const CANDIDATES: usize = 6;
/// Points of an object for the model, at most.
// Simulators take a hull of 120 points or more on a sphere for a ball.
const MODEL_POINTS: usize = 160;
/// Points of an object for the model, at least: its corners, and others on its faces.
const LEAST_MODEL_POINTS: usize = 64;
/// Products of inertia below this, relative to the greatest moment, are 0.
const DIAGONAL: f64 = 1e-4;

/// Why an object cannot be followed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ObjectError {
    /// Points or corners that are none.
    #[error("its mesh has a corner that is not finite or not there: export it again")]
    Corner,
    /// No area, or points in one plane.
    #[error("its points lie in one plane: give a mesh that encloses a volume")]
    Flat,
    /// A mass or moments of inertia that no body has.
    #[error("its mass, centre or moments of inertia are not those of a body: give a closed mesh")]
    Mass,
}

/// What a mesh says of a body, in the mesh's frame.
#[derive(Clone, Debug)]
pub struct ObjectMesh<'m> {
    /// What it is called.
    pub name: &'m str,
    /// Corners of its triangles, metres.
    pub points: &'m [Point3<f32>],
    /// (triangles) Indices of the points, counter-clockwise seen from outside.
    pub triangles: &'m [[u32; 3]],
    /// Convex pieces that it touches with; none: those of the hull.
    pub pieces: &'m [Vec<Point3<f32>>],
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, metres.
    pub centre_m: Point3<f64>,
    /// Matrix of inertia about it, kg m2.
    pub inertia_kg_m2: Matrix3<f64>,
}

/// A body whose shape is known: a tracker finds it, and follows it with the sides that it does not see.
///
/// ```
/// use nalgebra::{Matrix3, Point3};
/// use rigidformer_perception::known::{KnownObject, ObjectMesh};
/// let points: Vec<Point3<f32>> = (0..8).map(|k| Point3::from([k >> 2 & 1, k >> 1 & 1, k & 1].map(|side| 0.1 * side as f32))).collect();
/// let sides = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]];
/// let cube = KnownObject::new(&ObjectMesh {
///     name: "cube",
///     points: &points,
///     triangles: &sides,
///     pieces: &[],
///     mass_kg: 0.5,
///     centre_m: Point3::new(0.05, 0.05, 0.05),
///     inertia_kg_m2: Matrix3::identity() * (0.5 * 0.02 / 12.0),
/// })?;
/// assert_eq!(cube.name(), "cube");
/// # Ok::<(), rigidformer_perception::known::ObjectError>(())
/// ```
#[derive(Clone, Debug)]
pub struct KnownObject(Arc<Shape>);

#[derive(Debug)]
struct Shape {
    name: String,
    /// Surface elements: point and outward normal, spread evenly.
    elements: Vec<(Point3<f32>, Vector3<f32>)>,
    /// Distance of neighbouring elements, about.
    spacing_m: f32,
    /// Of its bounding sphere about the centre.
    radius_m: f32,
    centre: Point3<f32>,
    mass_kg: f32,
    volume_m3: f32,
    /// Carries the frame of its principal axes to the mesh's.
    principal: UnitQuaternion<f32>,
    moments_kg_m2: [f32; 3],
    /// For the model, in the frame of the principal axes.
    points: Vec<Point3<f32>>,
    piece_points: Vec<Point3<f32>>,
    piece_counts: Vec<u16>,
}

impl KnownObject {
    /// From a mesh.
    ///
    /// # Errors
    /// [`ObjectError`].
    pub fn new(mesh: &ObjectMesh<'_>) -> Result<Self, ObjectError> {
        in_own_environment(|| Self::new_here(mesh))
    }

    fn new_here(mesh: &ObjectMesh<'_>) -> Result<Self, ObjectError> {
        let number = mesh.points.len();
        let is_sound = mesh.triangles.iter().flatten().all(|at| (*at as usize) < number)
            && mesh.points.iter().chain(mesh.pieces.iter().flatten()).all(is_finite);
        if !is_sound {
            return Err(ObjectError::Corner);
        }
        let hull = ConvexHull::new(mesh.points).ok_or(ObjectError::Flat)?;
        let centre: Point3<f32> = mesh.centre_m.cast();
        let (elements, area_m2) = elements(mesh).ok_or(ObjectError::Flat)?;
        let radius = mesh.points.iter().map(|point| (point - centre).norm_squared());
        let radius_m = radius.fold(0.0, f32::max).sqrt();
        let (principal, moments_kg_m2) = principal(&mesh.inertia_kg_m2);
        let [a, b, c] = moments_kg_m2;
        let greatest = a.max(b).max(c);
        let is_body = (1e-9..=1e9).contains(&mesh.mass_kg)
            && is_finite(&centre)
            && moments_kg_m2.iter().all(|moment| (1e-18..=1e18).contains(moment))
            && greatest <= 1.001 * (a + b + c - greatest);
        if !is_body {
            return Err(ObjectError::Mass);
        }
        let inward = |point: &Point3<f32>| principal.inverse() * point;
        let corners = hull.faces().iter().flatten().collect::<std::collections::BTreeSet<_>>();
        let corners: Vec<Point3<f32>> =
            corners.into_iter().filter_map(|at| mesh.points.get(*at).copied()).collect();
        let points = model_points(corners, &elements, &centre);
        // One piece is the hull, which the points have.
        let pieces = if mesh.pieces.len() > 1 { mesh.pieces } else { &[] };
        let counts = pieces.iter().map(|piece| u16::try_from(piece.len()).unwrap_or(u16::MAX));
        Ok(KnownObject(Arc::new(Shape {
            name: mesh.name.to_owned(),
            spacing_m: 1.1 * (area_m2 / elements.len() as f32).sqrt(),
            elements,
            radius_m,
            centre,
            mass_kg: mesh.mass_kg as f32,
            volume_m3: crate::shape::volume_m3(mesh.points),
            principal,
            moments_kg_m2,
            points: points.iter().map(inward).collect(),
            piece_points: pieces.iter().flatten().map(inward).collect(),
            piece_counts: counts.collect(),
        })))
    }

    /// What it is called.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    pub(crate) fn elements(&self) -> &[(Point3<f32>, Vector3<f32>)] {
        &self.0.elements
    }

    pub(crate) fn spacing_m(&self) -> f32 {
        self.0.spacing_m
    }

    pub(crate) fn radius_m(&self) -> f32 {
        self.0.radius_m
    }

    pub(crate) fn centre(&self) -> Point3<f32> {
        self.0.centre
    }

    pub(crate) fn mass_kg(&self) -> f32 {
        self.0.mass_kg
    }

    pub(crate) fn volume_m3(&self) -> f32 {
        self.0.volume_m3
    }

    pub(crate) fn principal(&self) -> UnitQuaternion<f32> {
        self.0.principal
    }

    pub(crate) fn moments_kg_m2(&self) -> [f32; 3] {
        self.0.moments_kg_m2
    }

    /// Points for the model, in the frame of the principal axes.
    pub(crate) fn points(&self) -> &[Point3<f32>] {
        &self.0.points
    }

    /// Pieces for the model, in the frame of the principal axes.
    pub(crate) fn pieces(&self) -> Pieces<'_> {
        Pieces::new(&self.0.piece_points, &self.0.piece_counts)
    }
}

fn is_finite(point: &Point3<f32>) -> bool {
    point.iter().all(|number| number.is_finite())
}

/// Axes along which the matrix of inertia is diagonal, and its diagonal there.
fn principal(inertia: &Matrix3<f64>) -> (UnitQuaternion<f32>, [f32; 3]) {
    let diagonal = inertia.diagonal();
    let off = [(0, 1), (0, 2), (1, 2)].map(|at| inertia[at].abs()).into_iter().fold(0.0, f64::max);
    // Axes of a body that lies along them already must not be swapped by rounding.
    if off <= DIAGONAL * diagonal.max() || !off.is_finite() {
        return (UnitQuaternion::identity(), diagonal.cast().into());
    }
    let eigen = inertia.symmetric_eigen();
    let mut axes = eigen.eigenvectors;
    if axes.determinant() < 0.0 {
        axes.column_mut(0).neg_mut();
    }
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    (turn.cast(), eigen.eigenvalues.cast().into())
}

/// A point of a surface, and its normal.
type Element = (Point3<f32>, Vector3<f32>);

/// Elements spread evenly over the triangles, and the area of those.
fn elements(mesh: &ObjectMesh<'_>) -> Option<(Vec<Element>, f32)> {
    let corner = |at: u32| mesh.points.get(at as usize).copied().unwrap_or_default();
    let doubled = |face: &[u32; 3]| {
        let [a, b, c] = face.map(corner);
        (b - a).cross(&(c - a))
    };
    let areas: Vec<f64> =
        mesh.triangles.iter().map(|face| 0.5 * f64::from(doubled(face).norm())).collect();
    let area: f64 = areas.iter().sum();
    if !(area > 0.0 && area.is_finite()) {
        return None;
    }
    let count = ELEMENTS * CANDIDATES;
    let mut candidates = Vec::with_capacity(count);
    let (mut before, mut at) = (0.0, 0);
    for (face, own) in mesh.triangles.iter().zip(&areas) {
        let Some(normal) = doubled(face).try_normalize(1e-20) else { continue };
        let [a, b, c] = face.map(corner);
        while at < count && (at as f64 + 0.5) * area < (before + own) * count as f64 {
            // The plastic sequence fills the unit square evenly; its half above the diagonal is folded back.
            let [mut u, mut v] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2]
                .map(|step: f64| (0.5 + step * at as f64).fract() as f32);
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            candidates.push((a + (b - a) * u + (c - a) * v, normal));
            at += 1;
        }
        before += own;
    }
    Some((farthest(&candidates, ELEMENTS), area as f32))
}

/// So many of the elements, each the farthest one from those before.
fn farthest(
    candidates: &[(Point3<f32>, Vector3<f32>)],
    most: usize,
) -> Vec<(Point3<f32>, Vector3<f32>)> {
    let mut squares = vec![f32::MAX; candidates.len()];
    let mut chosen: Vec<(Point3<f32>, Vector3<f32>)> = Vec::with_capacity(most);
    let mut next = candidates.first().copied();
    while let Some(element) = next.filter(|_| chosen.len() < most) {
        chosen.push(element);
        let mut far = (0.0, None);
        for (square, other) in squares.iter_mut().zip(candidates) {
            let mut off = (other.0 - element.0).norm_squared();
            // Both sides of a thin body need elements.
            if other.1.dot(&element.1) < 0.0 {
                off = f32::MAX;
            }
            *square = square.min(off);
            if *square > far.0 {
                far = (*square, Some(*other));
            }
        }
        next = far.1;
    }
    chosen
}

/// Corners of the hull, those first that lie farthest from each other, and elements of the surface where corners are few.
fn model_points(
    mut corners: Vec<Point3<f32>>,
    elements: &[(Point3<f32>, Vector3<f32>)],
    centre: &Point3<f32>,
) -> Vec<Point3<f32>> {
    let mut distances = vec![0.0; corners.len()];
    rigidformer_core::geometry::farthest_point_order(&mut corners, centre, &mut distances);
    corners.truncate(MODEL_POINTS);
    let more = LEAST_MODEL_POINTS.saturating_sub(corners.len());
    corners.extend(elements.iter().take(more).map(|element| element.0));
    corners
}
