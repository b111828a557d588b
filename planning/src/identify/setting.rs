//! What bodies move on: the units of a scene and what they touch with.

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{MAX_PLANES, Physics, Plane, Role};
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit};

use super::settings::IdentifyError;
use super::track::Sample;

/// Distance that still counts as touching, in radii.
const NEAR: f32 = 0.03;
/// And in deviations of the pose.
const NOISY: f32 = 4.0;
/// Share of a step's way that may lie between two poses and a contact.
const AHEAD: f32 = 0.6;

/// The units of a scene, their planes and gravity.
#[derive(Clone, Debug)]
pub(crate) struct Setting {
    /// Without poses.
    pub(crate) units: Vec<RecordedUnit>,
    pub(crate) planes: Vec<Plane>,
    pub(crate) gravity: Vector3<f32>,
    /// (units) About the middle of its points, metres.
    pub(crate) radii: Vec<f32>,
    /// (units)
    middles: Vec<Point3<f32>>,
}

/// How the units of a window touch.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Touches {
    /// Free units that touch something, in groups that touch each other.
    pub(crate) clusters: Vec<Vec<usize>>,
    /// Pairs of them.
    pub(crate) met: Vec<(usize, usize)>,
    /// Whether none of them moves.
    pub(crate) quiet: bool,
}

impl Setting {
    /// As recorded; over `ground` where the scene's planes are not known.
    pub(crate) fn new(scene: &RecordedScene, ground: Plane) -> Result<Self, IdentifyError> {
        let refused = |what| Err(IdentifyError::Scene { scene: scene.name().to_owned(), what });
        if scene.units().iter().any(|unit| unit.soft.is_some()) {
            return refused("has soft units; identification knows rigid ones");
        }
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
        Setting::of(units.collect(), planes, scene.gravity_m_s2())
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
        let middles: Vec<Point3<f32>> = units
            .iter()
            .map(|unit| {
                let sum: Vector3<f32> = unit.points.iter().map(|point| point.coords).sum();
                Point3::from(sum / unit.points.len().max(1) as f32)
            })
            .collect();
        let radii = units.iter().zip(&middles).map(|(unit, middle)| {
            let points = unit.points.iter().chain(unit.pieces.points());
            points.map(|point| (point - middle).norm()).fold(0.0, f32::max)
        });
        let radii = radii.collect();
        Ok(Setting { units, planes, gravity, radii, middles })
    }

    /// Whether each unit is moved by the model.
    pub(crate) fn free(&self) -> Vec<bool> {
        self.units.iter().map(|unit| unit.role == Role::Free).collect()
    }

    /// Friction and restitution of planes that products are told with: of the roughest plane; 1 where there is none.
    pub(crate) fn reference(&self) -> (f32, f32) {
        let rough = self.planes.iter().max_by(|a, b| a.friction.total_cmp(&b.friction));
        rough.map_or((1.0, 1.0), |plane| (plane.friction, plane.restitution))
    }

    /// Whether other units are those of this scene.
    pub(crate) fn has_units_of(&self, other: &Setting) -> bool {
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

    /// What touches what in a piece of motion, (steps + 1, units) samples.
    pub(crate) fn touches(&self, samples: &[Option<Sample>]) -> Touches {
        let count = self.units.len();
        let rows: Vec<&[Option<Sample>]> = samples.chunks_exact(count.max(1)).collect();
        let margins: Vec<f32> = (0..count).map(|unit| self.margin(&rows, unit)).collect();
        let is_free = |unit: usize| self.units[unit].role == Role::Free;
        let seen = |row: &[Option<Sample>], unit: usize| {
            row.get(unit).copied().flatten().map(|sample| sample.pose)
        };
        let mut touching: Vec<bool> = (0..count)
            .map(|unit| {
                let on_plane = |row: &&[Option<Sample>]| {
                    seen(row, unit).is_some_and(|pose| self.height(unit, &pose) < margins[unit])
                };
                is_free(unit) && rows.iter().any(on_plane)
            })
            .collect();
        let (mut met, mut group) = (Vec::new(), (0..count).collect::<Vec<usize>>());
        for one in 0..count {
            for other in one + 1..count {
                let same = self.units[one].body.is_some()
                    && self.units[one].body == self.units[other].body;
                if same || !(is_free(one) || is_free(other)) {
                    continue;
                }
                let reach = self.radii[one] + self.radii[other] + margins[one] + margins[other];
                let near = rows.iter().any(|row| match (seen(row, one), seen(row, other)) {
                    (Some(a), Some(b)) => {
                        (a * self.middles[one] - b * self.middles[other]).norm() < reach
                    }
                    _ => false,
                });
                if !near {
                    continue;
                }
                for unit in [one, other] {
                    touching[unit] |= is_free(unit);
                }
                if is_free(one) && is_free(other) {
                    met.push((one, other));
                    let (keep, gone) = (group[one], group[other]);
                    group.iter_mut().filter(|of| **of == gone).for_each(|of| *of = keep);
                }
            }
        }
        let members = |lead: usize| -> Vec<usize> {
            (0..count).filter(|unit| touching[*unit] && group[*unit] == lead).collect()
        };
        let clusters: Vec<Vec<usize>> =
            (0..count).map(members).filter(|members| !members.is_empty()).collect();
        let quiet = clusters.iter().flatten().all(|unit| self.is_quiet(&rows, *unit));
        Touches { clusters, met, quiet }
    }

    /// Height of a unit over the plane that is nearest, metres.
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

    /// How far aside of its centre a unit touches the plane that is nearest, in radii: 0 on the middle of a face.
    pub(crate) fn aside(&self, unit: usize, pose: &Isometry3<f32>) -> f64 {
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
        let until = lowest(plane) + 0.05 * radius;
        let near: Vec<Vector3<f32>> = points
            .iter()
            .filter(|p| plane.normal.dot(&p.coords) - plane.offset_m <= until)
            .map(|p| p.coords)
            .collect();
        let middle: Vector3<f32> = near.iter().sum::<Vector3<f32>>() / near.len().max(1) as f32;
        let away = middle - pose.translation.vector;
        let normal: Vector3<f32> = plane.normal;
        f64::from((away - normal * normal.dot(&away)).norm() / radius.max(1e-9))
    }

    /// How near counts as touching: what poses may be off, and part of the way between two of them.
    fn margin(&self, rows: &[&[Option<Sample>]], unit: usize) -> f32 {
        let seen = |row: &&[Option<Sample>]| row.get(unit).copied().flatten();
        let noise = rows.iter().filter_map(seen).map(|s| s.noise.position_m).fold(0.0, f32::max);
        let radius = self.radii[unit];
        let way = rows.iter().zip(rows.iter().skip(1)).filter_map(|(a, b)| {
            let (a, b) = (seen(a)?.pose, seen(b)?.pose);
            let turn = a.rotation.angle_to(&b.rotation) * radius;
            Some((a.translation.vector - b.translation.vector).norm() + turn)
        });
        NEAR * radius + NOISY * noise + AHEAD * way.fold(0.0, f32::max)
    }

    /// Whether a unit's poses are one, but for their noise.
    fn is_quiet(&self, rows: &[&[Option<Sample>]], unit: usize) -> bool {
        let mut seen = rows.iter().filter_map(|row| row.get(unit).copied().flatten());
        let Some(first) = seen.next() else { return true };
        let radius = self.radii[unit];
        let still = |sample: Sample| {
            let way = (sample.pose.translation.vector - first.pose.translation.vector).norm();
            let turn = sample.pose.rotation.angle_to(&first.pose.rotation);
            way < 1e-3 * radius + 6.0 * sample.noise.position_m
                && turn < 1e-3 + 6.0 * sample.noise.rotation_rad
        };
        seen.all(still)
    }
}
