//! The looks of soft bodies: the triangles that a scene has over their points, or the points alone.

use std::collections::HashMap;
use std::ops::Range;

use nalgebra::{Point3, Vector3};
use rigidformer_evaluation::scenes::RecordedScene;

use super::mesh::{Corner, Mesh};

/// Triangles that meet at less than this angle look round: its cosine. Folds of cloth are round, the edges of a cube are not.
const SMOOTH_COSINE: f32 = 0.5;
/// How far in front of itself a surface is drawn, in parts of its triangles' sides. What lies right under a sheet shows through
/// between its points otherwise: triangles cut corners.
const LIFT: f32 = 0.12;

/// The soft bodies of a scene, whatever the frame.
pub(super) struct Surface {
    bodies: Vec<SoftBody>,
    /// (points) Of the soft points, the first one that was in the same place at rest: they are one.
    twins: Vec<usize>,
}

struct SoftBody {
    /// Number of its first unit.
    unit: usize,
    /// Its points among all soft points, a range a patch.
    patches: Vec<Range<usize>>,
    /// Rows of soft points.
    faces: Vec<[usize; 3]>,
}

/// A soft body at an instant, in the world.
pub(super) struct Shown {
    /// Number of its first unit.
    pub(super) unit: usize,
    pub(super) mesh: Mesh,
    /// Points of a body without triangles.
    pub(super) points: Vec<Point3<f32>>,
    /// How far in front of itself it is drawn, metres.
    pub(super) lift_m: f32,
}

impl Surface {
    /// `None` for a scene without soft units.
    pub(super) fn new(scene: &RecordedScene) -> Option<Surface> {
        let mut bodies: Vec<SoftBody> = Vec::new();
        let mut places: HashMap<u16, usize> = HashMap::new();
        let (mut first, mut twins) = (HashMap::new(), Vec::new());
        for (unit, recorded) in scene.units().iter().enumerate() {
            if recorded.soft.is_none() {
                continue;
            }
            let start = twins.len();
            // Patches of a body that is none with others share no points with them.
            let whose = recorded.body.map_or((true, unit), |body| (false, usize::from(body)));
            for point in &recorded.points {
                let place =
                    [point.x, point.y, point.z].map(|v| (f64::from(v) * 1e5).round() as i64);
                let next = twins.len();
                twins.push(*first.entry((whose, place)).or_insert(next));
            }
            let at = recorded.body.and_then(|body| places.get(&body).copied());
            let at = at.unwrap_or_else(|| {
                bodies.push(SoftBody { unit, patches: Vec::new(), faces: Vec::new() });
                bodies.len() - 1
            });
            if let Some(body) = recorded.body {
                places.insert(body, at);
            }
            if let Some(body) = bodies.get_mut(at) {
                body.patches.push(start..twins.len());
            }
        }
        for face in &scene.mesh().faces {
            let owns = |body: &&mut SoftBody| body.patches.iter().any(|own| own.contains(&face[0]));
            if let Some(body) = bodies.iter_mut().find(owns) {
                body.faces.push(*face);
            }
        }
        (!bodies.is_empty()).then_some(Surface { bodies, twins })
    }

    /// All bodies with these points.
    pub(super) fn at(&self, points: &[Point3<f32>]) -> Vec<Shown> {
        self.bodies.iter().map(|body| self.shown(body, points)).collect()
    }

    fn shown(&self, body: &SoftBody, points: &[Point3<f32>]) -> Shown {
        let place = |row: usize| points.get(row).copied();
        if body.faces.is_empty() {
            let points = body.patches.iter().cloned().flatten().filter_map(place).collect();
            return Shown {
                unit: body.unit,
                mesh: Mesh { triangles: Vec::new() },
                points,
                lift_m: 0.0,
            };
        }
        let corners = |face: &[usize; 3]| -> Option<[Point3<f32>; 3]> {
            Some([place(face[0])?, place(face[1])?, place(face[2])?])
        };
        let twin = |row: usize| self.twins.get(row).copied().unwrap_or(row);
        // Twice the area times the normal, so that large triangles count more.
        let mut around: HashMap<usize, Vec<Vector3<f32>>> = HashMap::new();
        let (mut sides_m, mut sides) = (0.0, 0u32);
        for face in &body.faces {
            let Some([a, b, c]) = corners(face) else { continue };
            for row in face {
                around.entry(twin(*row)).or_default().push((b - a).cross(&(c - a)));
            }
            sides_m += (b - a).norm();
            sides += 1;
        }
        let triangle = |face: &[usize; 3]| {
            let points = corners(face)?;
            let [a, b, c] = points;
            let own = (b - a).cross(&(c - a)).try_normalize(1e-12)?;
            let round = |row: usize| {
                let near = around.get(&twin(row)).map_or(&[][..], Vec::as_slice).iter();
                let near = near.filter(|n| n.dot(&own) > SMOOTH_COSINE * n.norm());
                near.sum::<Vector3<f32>>().try_normalize(1e-12).unwrap_or(own)
            };
            let corner = |k: usize| Corner { point: points[k], normal: round(face[k]) };
            Some([corner(0), corner(1), corner(2)])
        };
        let triangles = body.faces.iter().filter_map(triangle).collect();
        let lift_m = LIFT * sides_m / sides.max(1) as f32;
        Shown { unit: body.unit, mesh: Mesh { triangles }, points: Vec::new(), lift_m }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;
    use rigidformer_core::Physics;
    use rigidformer_evaluation::scenes::{RecordedUnit, SoftMesh, Split};

    /// Two patches of one sheet that share the line x = 1, and a soft block of its own in the same place.
    fn scene(faces: Vec<[usize; 3]>) -> RecordedScene {
        let unit = |x: f32| {
            let points: Vec<Point3<f32>> =
                (0..4).map(|i| Point3::new(x + (i & 1) as f32, (i >> 1) as f32, 0.0)).collect();
            let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
            RecordedUnit::new("x", points.clone(), physics, vec![Isometry3::identity()])
                .with_soft(vec![points])
        };
        let units = vec![unit(0.0).with_body(3), unit(1.0).with_body(3), unit(0.0)];
        RecordedScene::new("x", 1, Split::Test, 60.0, Vector3::zeros(), units)
            .unwrap()
            .with_mesh(SoftMesh { faces, ..SoftMesh::default() })
            .unwrap()
    }

    #[test]
    fn patches_of_a_body_share_normals_where_they_meet() {
        let scene = scene(vec![[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6]]);
        let surface = Surface::new(&scene).unwrap();
        assert_eq!(surface.twins, [0, 1, 2, 3, 1, 5, 3, 7, 8, 9, 10, 11]);
        // The second patch bends down.
        let mut points = rigidformer_evaluation::predicted::recorded(&scene, 0).unwrap();
        (points[5].z, points[7].z) = (-0.5, -0.5);
        let shown = surface.at(&points);
        assert_eq!(shown.iter().map(|body| body.unit).collect::<Vec<_>>(), [0, 2]);
        let sheet = &shown[0].mesh.triangles;
        assert_eq!((sheet.len(), shown[0].points.len()), (4, 0));
        let normal = |triangle: usize, corner: usize| sheet[triangle][corner].normal;
        assert_eq!(normal(0, 1), normal(2, 0), "one point, one normal");
        assert_eq!(normal(1, 2), Vector3::z(), "far from the bend");
        // No triangles: points.
        assert_eq!((shown[1].mesh.triangles.len(), shown[1].points.len()), (0, 4));
    }

    #[test]
    fn a_rigid_scene_has_no_surface_and_missing_points_no_triangles() {
        let surface = Surface::new(&scene(vec![[0, 1, 2]])).unwrap();
        assert_eq!(surface.at(&[])[0].mesh.triangles.len(), 0);
        let mut units = scene(Vec::new()).units().to_vec();
        units.iter_mut().for_each(|unit| unit.soft = None);
        let rigid = RecordedScene::new("x", 1, Split::Test, 60.0, Vector3::zeros(), units).unwrap();
        assert!(Surface::new(&rigid).is_none());
    }
}
