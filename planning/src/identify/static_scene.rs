//! The scene of an identification without its motion, and contacts in it.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{Compliance, ContactLaw, MAX_PLANES, Physics, Plane, Role};
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit};
use rigidformer_runtime::terrain::HeightFieldBuf;

use super::settings::IdentifyError;
use super::track::Sample;

/// Distance that counts as contact, in radii.
// Shapes and poses are not exact. A missed contact loses a window, and a false one only costs time.
const CONTACT_RADII: f32 = 0.03;
/// The same in standard deviations of the pose.
const CONTACT_DEVIATIONS: f32 = 4.0;
/// The same in displacements of a step.
// A contact may happen between two poses.
const CONTACT_STEP_SHARE: f32 = 0.6;

/// The units of a scene, their planes and gravity.
#[derive(Clone, Debug)]
pub(crate) struct StaticScene {
    /// Without poses.
    pub(crate) units: Vec<RecordedUnit>,
    pub(crate) planes: Vec<Plane>,
    /// Of each plane; none: all are rigid.
    pub(crate) plane_compliance: Vec<Compliance>,
    pub(crate) contact_law: ContactLaw,
    pub(crate) height_field: Option<HeightFieldBuf>,
    pub(crate) gravity: Vector3<f32>,
    /// (units) Radius about the centroid of the points, metres.
    pub(crate) radii: Vec<f32>,
    /// (units)
    centroids: Vec<Point3<f32>>,
}

/// Contacts of the units of a window.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Contacts {
    /// Free units in contact, in groups that are in contact with each other.
    pub(crate) clusters: Vec<Vec<usize>>,
    /// Pairs of free units in contact.
    pub(crate) pairs: Vec<(usize, usize)>,
    /// Whether none of them moves.
    pub(crate) at_rest: bool,
}

impl StaticScene {
    /// As recorded; over `ground` where the scene's planes are not known.
    pub(crate) fn new(scene: &RecordedScene, ground: Plane) -> Result<Self, IdentifyError> {
        let refused = |what| Err(IdentifyError::Scene { scene: scene.name().to_owned(), what });
        // A soft unit has no pose, and its stiffness would be another unknown.
        if scene.units().iter().any(|unit| unit.soft.is_some()) {
            return refused("has soft units; identification knows rigid ones");
        }
        // Bonds and commands move units without contact, and the likelihood takes all forces for contact's.
        if !scene.bonds().is_empty() || scene.command_size() > 0 {
            return refused(
                "has bonds or commands; identification knows bodies that move by contact alone",
            );
        }
        if !scene.units().iter().any(|unit| unit.role == Role::Free) {
            return refused("has no free unit; nothing moves by what it is made of");
        }
        let planes = scene.planes().map_or_else(|| vec![ground], <[Plane]>::to_vec);
        let units =
            scene.units().iter().map(|unit| RecordedUnit { poses: Vec::new(), ..unit.clone() });
        let plane_compliance = scene.plane_compliance().to_vec();
        let read = StaticScene::of(units.collect(), planes, scene.gravity_m_s2())?;
        let (contact_law, height_field) = (scene.contact_law(), scene.height_field().cloned());
        Ok(StaticScene { plane_compliance, contact_law, height_field, ..read })
    }

    /// Units that are rigid.
    pub(crate) fn of(
        units: Vec<RecordedUnit>,
        planes: Vec<Plane>,
        gravity: Vector3<f32>,
    ) -> Result<Self, IdentifyError> {
        if planes.len() > MAX_PLANES {
            return Err(IdentifyError::Planes { given: planes.len() });
        }
        if !gravity.iter().all(|g| g.is_finite()) {
            return Err(IdentifyError::Gravity);
        }
        let centroids: Vec<Point3<f32>> = units
            .iter()
            .map(|unit| {
                let sum: Vector3<f32> = unit.points.iter().map(|point| point.coords).sum();
                Point3::from(sum / unit.points.len().max(1) as f32)
            })
            .collect();
        let radii = units.iter().zip(&centroids).map(|(unit, centroid)| {
            let points = unit.points.iter().chain(unit.pieces.points());
            points.map(|point| (point - centroid).norm()).fold(0.0, f32::max)
        });
        let radii = radii.collect();
        let (plane_compliance, contact_law) = (Vec::new(), ContactLaw::RIGID);
        let height_field = None;
        Ok(StaticScene {
            units,
            planes,
            plane_compliance,
            contact_law,
            height_field,
            gravity,
            radii,
            centroids,
        })
    }

    /// Whether each unit is moved by the model.
    pub(crate) fn free(&self) -> Vec<bool> {
        self.units.iter().map(|unit| unit.role == Role::Free).collect()
    }

    /// Friction and restitution of the plane of reference, the roughest one; 1 where there is none.
    pub(crate) fn reference(&self) -> (f32, f32) {
        let rough = self.planes.iter().max_by(|a, b| a.friction.total_cmp(&b.friction));
        rough.map_or((1.0, 1.0), |plane| (plane.friction, plane.restitution))
    }

    /// Whether other units are those of this scene.
    pub(crate) fn has_units_of(&self, other: &StaticScene) -> bool {
        let same = |(a, b): (&RecordedUnit, &RecordedUnit)| {
            a.role == b.role && a.points == b.points && a.pieces == b.pieces
        };
        self.units.len() == other.units.len() && self.units.iter().zip(&other.units).all(same)
    }

    /// The physics of a unit as given.
    pub(crate) fn physics(&self, unit: usize) -> Physics {
        let none = Physics { mass_kg: 1.0, friction: 0.0, restitution: 0.0 };
        self.units.get(unit).map_or(none, |unit| unit.physics)
    }

    /// Contacts in a segment of motion, (steps + 1, units) samples.
    pub(crate) fn contacts(&self, samples: &[Option<Sample>]) -> Contacts {
        let count = self.units.len();
        let rows: Vec<&[Option<Sample>]> = samples.chunks_exact(count.max(1)).collect();
        let contact_distances: Vec<f32> =
            (0..count).map(|unit| self.contact_distance(&rows, unit)).collect();
        let is_free = |unit: usize| self.units[unit].role == Role::Free;
        let pose_at = |row: &[Option<Sample>], unit: usize| {
            row.get(unit).copied().flatten().map(|sample| sample.pose)
        };
        let mut in_contact: Vec<bool> = (0..count)
            .map(|unit| {
                let on_plane = |row: &&[Option<Sample>]| {
                    pose_at(row, unit)
                        .is_some_and(|pose| self.height(unit, &pose) < contact_distances[unit])
                };
                is_free(unit) && rows.iter().any(on_plane)
            })
            .collect();
        let (mut pairs, mut group) = (Vec::new(), (0..count).collect::<Vec<usize>>());
        for one in 0..count {
            for other in one + 1..count {
                let same = self.units[one].body.is_some()
                    && self.units[one].body == self.units[other].body;
                // Units of one body do not collide, and contacts between unmoved units have no effect.
                if same || !(is_free(one) || is_free(other)) {
                    continue;
                }
                // Bounding spheres suffice: a false pair only joins two clusters.
                let reach = self.radii[one]
                    + self.radii[other]
                    + contact_distances[one]
                    + contact_distances[other];
                let near = rows.iter().any(|row| match (pose_at(row, one), pose_at(row, other)) {
                    (Some(a), Some(b)) => {
                        (a * self.centroids[one] - b * self.centroids[other]).norm() < reach
                    }
                    _ => false,
                });
                if !near {
                    continue;
                }
                for unit in [one, other] {
                    in_contact[unit] |= is_free(unit);
                }
                // A driven or fixed unit has no unknowns, so it does not connect clusters.
                if is_free(one) && is_free(other) {
                    pairs.push((one, other));
                    let (keep, merged) = (group[one], group[other]);
                    group.iter_mut().filter(|of| **of == merged).for_each(|of| *of = keep);
                }
            }
        }
        let members = |first: usize| -> Vec<usize> {
            (0..count).filter(|unit| in_contact[*unit] && group[*unit] == first).collect()
        };
        let clusters: Vec<Vec<usize>> =
            (0..count).map(members).filter(|members| !members.is_empty()).collect();
        let at_rest = clusters.iter().flatten().all(|unit| self.is_at_rest(&rows, *unit));
        Contacts { clusters, pairs, at_rest }
    }

    /// Height of a unit over the nearest plane, metres.
    fn height(&self, unit: usize, pose: &Isometry3<f32>) -> f32 {
        let of = &self.units[unit];
        let points = of.points.iter().chain(of.pieces.points()).map(|point| pose * point);
        let height = |point: Point3<f32>| {
            let heights =
                self.planes.iter().map(|plane| plane.normal.dot(&point.coords) - plane.offset_m);
            heights.fold(f32::INFINITY, f32::min)
        };
        points.map(height).fold(f32::INFINITY, f32::min)
    }

    /// Distance of the contact with the nearest plane from the unit's centre, along the plane, in radii: 0 on the middle of a face.
    pub(crate) fn contact_offset(&self, unit: usize, pose: &Isometry3<f32>) -> f64 {
        let (Some(of), Some(&radius)) = (self.units.get(unit), self.radii.get(unit)) else {
            return 0.0;
        };
        let points: Vec<Point3<f32>> =
            of.points.iter().chain(of.pieces.points()).map(|point| pose * point).collect();
        let lowest = |plane: &Plane| {
            points
                .iter()
                .map(|p| plane.normal.dot(&p.coords) - plane.offset_m)
                .fold(f32::INFINITY, f32::min)
        };
        let Some(plane) = self.planes.iter().min_by(|a, b| lowest(a).total_cmp(&lowest(b))) else {
            return 0.0;
        };
        // Points within a twentieth of the radius are in contact, for poses are not exact.
        let until = lowest(plane) + 0.05 * radius;
        let near: Vec<Vector3<f32>> = points
            .iter()
            .filter(|p| plane.normal.dot(&p.coords) - plane.offset_m <= until)
            .map(|p| p.coords)
            .collect();
        let centroid: Vector3<f32> = near.iter().sum::<Vector3<f32>>() / near.len().max(1) as f32;
        let away = centroid - pose.translation.vector;
        let normal: Vector3<f32> = plane.normal;
        f64::from((away - normal * normal.dot(&away)).norm() / radius.max(1e-9))
    }

    /// Distance that counts as contact: for errors of shapes and poses, and for the motion between two poses.
    fn contact_distance(&self, rows: &[&[Option<Sample>]], unit: usize) -> f32 {
        let sample_of = |row: &&[Option<Sample>]| row.get(unit).copied().flatten();
        let noise =
            rows.iter().filter_map(sample_of).map(|s| s.noise.position_m).fold(0.0, f32::max);
        let radius = self.radii[unit];
        let displacement = rows.iter().zip(rows.iter().skip(1)).filter_map(|(a, b)| {
            let (a, b) = (sample_of(a)?.pose, sample_of(b)?.pose);
            // Rotation moves the surface by its angle times the radius, at most.
            let turn = a.rotation.angle_to(&b.rotation) * radius;
            Some((a.translation.vector - b.translation.vector).norm() + turn)
        });
        CONTACT_RADII * radius
            + CONTACT_DEVIATIONS * noise
            + CONTACT_STEP_SHARE * displacement.fold(0.0, f32::max)
    }

    /// Whether a unit's poses differ by noise alone.
    fn is_at_rest(&self, rows: &[&[Option<Sample>]], unit: usize) -> bool {
        let mut samples = rows.iter().filter_map(|row| row.get(unit).copied().flatten());
        let Some(first) = samples.next() else { return true };
        let radius = self.radii[unit];
        let still = |sample: Sample| {
            let displacement =
                (sample.pose.translation.vector - first.pose.translation.vector).norm();
            let turn = sample.pose.rotation.angle_to(&first.pose.rotation);
            displacement < 1e-3 * radius + 6.0 * sample.noise.position_m
                && turn < 1e-3 + 6.0 * sample.noise.rotation_rad
        };
        samples.all(still)
    }
}
