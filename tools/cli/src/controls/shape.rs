//! What is tracked: points of units, or surfaces.

use nalgebra::Point3;
use rigidformer_evaluation::scenes::RecordedScene;

use super::motion::Instant;
use crate::picture::SHEET_LIFT;
use crate::viewers::MovingUnit;

/// Vertices, and what is drawn of them.
pub(super) struct Shape {
    /// Unit, and its vertices in its frame, metres. Those of soft units come after all of these, in the world.
    rigid: Vec<(usize, Vec<Point3<f32>>)>,
    /// Vertices that are drawn as squares.
    pub(super) squares: Vec<usize>,
    /// Of vertices, of closed surfaces.
    pub(super) triangles: Vec<[usize; 3]>,
    /// Of vertices, of soft units, which may be sheets.
    pub(super) sheets: Vec<[usize; 3]>,
    /// Units that surfaces were asked of and that have none: numbers.
    pub(super) flat: Vec<usize>,
}

impl Shape {
    /// The points of all units.
    pub(super) fn points(scene: &RecordedScene) -> Shape {
        let units = scene.units().iter().enumerate().filter(|(_, unit)| unit.soft.is_none());
        let rigid = units.map(|(number, unit)| (number, unit.points.clone())).collect();
        let squares = (0..scene.points()).collect();
        Shape { rigid, squares, triangles: Vec::new(), sheets: Vec::new(), flat: Vec::new() }
    }

    /// The surfaces of all units: hulls or convex pieces, and the triangles that a scene has of soft units. A unit without any is its points.
    pub(super) fn surfaces(scene: &RecordedScene) -> Shape {
        let mut shape = Shape {
            rigid: Vec::new(),
            squares: Vec::new(),
            triangles: Vec::new(),
            sheets: Vec::new(),
            flat: Vec::new(),
        };
        let mut vertices = 0;
        let looks = MovingUnit::of_scene(scene);
        for (number, looks) in looks.into_iter().enumerate().filter(|(_, looks)| !looks.is_soft) {
            let own = match looks.triangles.is_empty() {
                true => {
                    shape.flat.push(number);
                    shape.squares.extend(vertices..vertices + looks.points.len());
                    looks.points
                }
                false => {
                    let moved = |face: &[usize; 3]| face.map(|corner| vertices + corner);
                    shape.triangles.extend(looks.triangles.iter().map(moved));
                    looks.corners
                }
            };
            vertices += own.len();
            shape.rigid.push((number, own));
        }
        let faces = &scene.mesh().faces;
        shape.sheets.extend(faces.iter().map(|face| face.map(|row| vertices + row)));
        let mut first = 0;
        for (number, unit) in scene.units().iter().enumerate() {
            let Some(_) = &unit.soft else { continue };
            let own = first..first + unit.points.len();
            first = own.end;
            if !faces.iter().flatten().any(|row| own.contains(row)) {
                shape.flat.push(number);
                shape.squares.extend(own.map(|row| vertices + row));
            }
        }
        shape
    }

    /// How far in front of themselves sheets are drawn, metres: by the mean side of all of them, where other pictures take that of each body.
    pub(super) fn lift_m(&self, placed: &[Point3<f32>]) -> f32 {
        let side_m = |[a, b, _]: &[usize; 3]| Some((placed.get(*a)? - placed.get(*b)?).norm());
        let sum_m: f32 = self.sheets.iter().filter_map(side_m).sum();
        SHEET_LIFT * sum_m / self.sheets.len().max(1) as f32
    }

    /// (vertices) In the world.
    pub(super) fn placed(&self, instant: &Instant) -> Vec<Point3<f32>> {
        let mut all = Vec::new();
        for (unit, points) in &self.rigid {
            let pose = instant.poses.get(*unit).copied().unwrap_or_default();
            all.extend(points.iter().map(|point| pose * point));
        }
        all.extend_from_slice(&instant.soft);
        all
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Vector3};
    use rigidformer_core::Physics;
    use rigidformer_evaluation::scenes::{RecordedUnit, SoftMesh, Split};

    const PHYSICS: Physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };

    /// A soft square, a tetrahedron one metre up, a flat square, and a soft square without triangles.
    fn scene() -> RecordedScene {
        let square = |z: f32| -> Vec<Point3<f32>> {
            (0..4).map(|i| Point3::new((i & 1) as f32, (i >> 1) as f32, z)).collect()
        };
        let mut corners = square(0.0);
        corners[3] = Point3::new(0.2, 0.2, 1.0);
        let up = vec![Isometry3::translation(0.0, 0.0, 1.0)];
        let soft = |points: Vec<Point3<f32>>| {
            let here = vec![Isometry3::identity()];
            RecordedUnit::new("soft", points.clone(), PHYSICS, here).with_soft(vec![points])
        };
        let units = vec![
            soft(square(5.0)),
            RecordedUnit::new("tetrahedron", corners, PHYSICS, up.clone()),
            RecordedUnit::new("flat", square(0.0), PHYSICS, up),
            soft(square(6.0)),
        ];
        let faces = vec![[0, 1, 3], [0, 3, 2]];
        RecordedScene::new("x", 1, Split::Test, 60.0, Vector3::zeros(), units)
            .unwrap()
            .with_mesh(SoftMesh { faces, ..SoftMesh::default() })
            .unwrap()
    }

    fn instant(scene: &RecordedScene) -> Instant {
        let poses = scene.poses_at(0).unwrap();
        Instant { poses, soft: rigidformer_evaluation::predicted::recorded(scene, 0).unwrap() }
    }

    #[test]
    fn points_are_those_of_rigid_units_and_then_of_soft_ones() {
        let scene = scene();
        let shape = Shape::points(&scene);
        let placed = shape.placed(&instant(&scene));
        assert_eq!((placed.len(), shape.squares.len(), shape.triangles.len()), (16, 16, 0));
        let heights: Vec<f32> = placed.iter().map(|point| point.z).collect();
        assert_eq!(heights[..8], [1.0, 1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 1.0]);
        assert_eq!(heights[8..], [5.0, 5.0, 5.0, 5.0, 6.0, 6.0, 6.0, 6.0]);
    }

    #[test]
    fn what_has_no_surface_is_its_points() {
        let scene = scene();
        let shape = Shape::surfaces(&scene);
        let placed = shape.placed(&instant(&scene));
        assert_eq!(shape.flat, [2, 3]);
        assert_eq!(shape.squares, [4, 5, 6, 7, 12, 13, 14, 15]);
        assert_eq!(shape.triangles.len(), 4);
        assert_eq!(shape.sheets, [[8, 9, 11], [8, 11, 10]]);
        assert!(shape.sheets.iter().flatten().all(|corner| placed[*corner].z == 5.0));
        // Sides of 1 m and of a diagonal.
        let lift_m = SHEET_LIFT * (1.0 + std::f32::consts::SQRT_2) / 2.0;
        assert!((shape.lift_m(&placed) - lift_m).abs() < 1e-6);
    }
}
