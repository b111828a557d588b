//! How far a unit is from what training saw, and from what was observed of it (docs/HEALTH.md). Computed when asked: a step does none of
//! it.

use super::state::Simulator;
use crate::geometry::{dot, felt_directions, norm};
use crate::kernels::in_own_environment;
use crate::math;
use crate::scene::{Role, Scene, UnitId, UnitSlot};
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use rigidformer_weights::{Quantity, Ranges};
use thiserror::Error;

/// A value counts as outside of its range from so many widths of the range on.
const MARGIN: f32 = 0.05;
/// Points that are looked at: the first in farthest-point order, which are spread over the unit.
const LOOKED_AT: usize = 256;
/// Variances are at most so large, m^2 or rad^2.
const MAX_VARIANCE: f32 = 1e12;

/// A quantity of a unit beside its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// Which one.
    pub quantity: Quantity,
    /// What it is.
    pub value: f32,
    /// How far that is beyond the range, in widths of the range; below 0 inside.
    pub beyond: f32,
}

/// What can be said of how far a unit's prediction may be believed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Health {
    /// Of all quantities the one that is farthest outside, or nearest to its end where none is. `None`: the model does not say what
    /// training saw.
    pub farthest: Option<Excess>,
    /// Quantities that are outside, more than a twentieth of their range: bit k for [`Quantity::ALL`]`[k]`.
    pub outside: u32,
    /// Whether it diverged ([`Simulator::set_quarantine`]).
    pub is_quarantined: bool,
    /// The [innovation](Health::innovation) that it was [given](Health::with_innovation).
    pub innovation: Option<f32>,
}

/// The health of all units together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HealthReport {
    /// Units of which a quantity is outside of what training saw.
    pub outside_units: u32,
    /// Units in quarantine.
    pub quarantined_units: u32,
    /// Of all units and quantities the one that is farthest outside; none where the model does not say what training saw, or there
    /// are no units.
    pub farthest: Option<(UnitId, Excess)>,
}

/// Why there is no innovation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum InnovationError {
    /// A pose has a number that is not finite.
    #[error("the predicted or the observed pose is not finite; leave the observation out")]
    BadPose,
    /// A variance is not finite, not above 0, or above 1e12.
    #[error(
        "variance {index} must be above 0 and at most 1e12 m^2 or rad^2; give a sensor's noise, squared"
    )]
    BadVariance {
        /// Which one: x, y, z of the place, then of the turn.
        index: usize,
    },
}

impl Health {
    /// How far an observed pose is from the predicted one, in standard deviations: the Mahalanobis distance over six numbers that do not
    /// depend on each other. They are the way between the origins of the frames, m, and the turn from one to the other, rad, along the
    /// world's axes. `variances` are those of prediction and observation together, m^2 and rad^2.
    ///
    /// Of a right prediction its square has the mean 6, and is above 16.8 once in a hundred times: 4.1 is a fair limit. A turn counts as
    /// twice the sine of half its angle, which is 1 % less than the angle at 28 degrees and 5 % less at 63.
    ///
    /// # Errors
    /// [`InnovationError`] for numbers that are none.
    ///
    /// ```
    /// use nalgebra::Isometry3;
    /// use rigidformer_core::Health;
    /// let (millimetre, degree) = (1e-6, 3e-4);
    /// let variances = [millimetre, millimetre, millimetre, degree, degree, degree];
    /// let (predicted, seen) = (Isometry3::identity(), Isometry3::translation(0.003, 0.004, 0.0));
    /// let distance = Health::innovation(&predicted, &seen, &variances)?;
    /// assert!((distance - 5.0).abs() < 1e-5); // five millimetres
    /// # Ok::<(), rigidformer_core::InnovationError>(())
    /// ```
    pub fn innovation(
        predicted: &Isometry3<f32>,
        observed: &Isometry3<f32>,
        variances: &[f32; 6],
    ) -> Result<f32, InnovationError> {
        in_own_environment(|| Self::innovation_here(predicted, observed, variances))
    }

    fn innovation_here(
        predicted: &Isometry3<f32>,
        observed: &Isometry3<f32>,
        variances: &[f32; 6],
    ) -> Result<f32, InnovationError> {
        let is_variance = |variance: &f32| *variance > 0.0 && *variance <= MAX_VARIANCE;
        if let Some(index) = variances.iter().position(|variance| !is_variance(variance)) {
            return Err(InnovationError::BadVariance { index });
        }
        let way = observed.translation.vector - predicted.translation.vector;
        let (now, before) = (observed.rotation.coords, predicted.rotation.coords);
        let (v, w) = (Vector3::new(now.x, now.y, now.z), now.w);
        let (p, q) = (Vector3::new(before.x, before.y, before.z), before.w);
        // The vector of observed times the inverse of predicted; the shorter way round.
        let half = (v * q - p * w) - v.cross(&p);
        let whole = w * q + dot(&v, &p);
        let turn = if whole < 0.0 { half * -2.0 } else { half * 2.0 };
        let parts = [way.x, way.y, way.z, turn.x, turn.y, turn.z];
        let sum = parts.iter().zip(variances).fold(0.0_f32, |sum, (part, variance)| {
            let deviations = part / math::sqrt(*variance);
            sum + deviations * deviations
        });
        match sum.is_finite() {
            true => Ok(math::sqrt(sum)),
            false if parts.iter().all(|part| part.is_finite()) => Ok(f32::MAX),
            false => Err(InnovationError::BadPose),
        }
    }

    /// The same with an innovation.
    #[must_use]
    pub fn with_innovation(self, innovation: f32) -> Self {
        Health { innovation: Some(innovation), ..self }
    }

    /// Whether the model says what training saw.
    pub fn is_known(&self) -> bool {
        self.farthest.is_some()
    }

    /// Whether a quantity is outside of what training saw.
    pub fn is_outside(&self, quantity: Quantity) -> bool {
        self.outside >> quantity as u32 & 1 == 1
    }

    /// Whether anything warns of the unit's prediction: a quantity outside, quarantine, or an innovation above `limit`, in standard
    /// deviations. A unit of which nothing is known warns of nothing.
    pub fn warns(&self, limit: f32) -> bool {
        let is_far = self.innovation.is_some_and(|innovation| innovation > limit);
        self.outside != 0 || self.is_quarantined || is_far
    }
}

impl Simulator<'_, '_> {
    /// The health of a unit as it is now, in the first copy; none where no unit has that name. Of a unit that is not free, its motion and
    /// the world alone are looked at. It costs about as much as observing the
    /// unit does: every quantity is measured when asked for.
    ///
    /// ```
    /// use nalgebra::{Isometry3, Point3};
    /// use rigidformer_core::{Limits, Model, Physics, Simulator, SlabSizes, Slabs, Unit, UnitSlot, weights::Quantity};
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// # let model = Model::load(rigidformer_weights::EDGE)?;
    /// # let limits = Limits { units: 2, points: 16 };
    /// # let sizes = SlabSizes::new(model.config(), limits);
    /// # let (mut numbers, mut bytes) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
    /// # let mut points = vec![Point3::origin(); sizes.points];
    /// # let mut units = vec![UnitSlot::EMPTY; sizes.units];
    /// # let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points, units: &mut units };
    /// # let mut simulator = Simulator::new(&model, limits, slabs)?;
    /// # simulator.set_dt(1.0 / 24.0)?;
    /// # let corner = |i: usize, bit| if i & bit == 0 { -0.2 } else { 0.2 };
    /// # let cube: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    /// # let rubber = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
    /// let at = |x| Isometry3::translation(x, 0.0, 1.0);
    /// let id = simulator.add(&Unit::new(&cube, rubber), &at(0.0), &at(4.0))?; // four metres in a 24th of a second
    /// let health = simulator.health(id).ok_or("no such unit")?;
    /// if health.is_known() {
    ///     assert!(health.is_outside(Quantity::Speed) && health.warns(4.1));
    /// }
    /// # Ok(())
    /// # }
    /// ```
    pub fn health(&self, id: UnitId) -> Option<Health> {
        self.health_within(id, self.model.file().ranges())
    }

    /// As [`health`](Self::health), by ranges of the caller's choice instead of the model's; none: nothing is known.
    pub fn health_within(&self, id: UnitId, ranges: Option<&Ranges>) -> Option<Health> {
        Some(self.health_of(self.scene.units().get(self.number(id)?)?, ranges))
    }

    /// The health of all units of the first copy together.
    pub fn health_report(&self) -> HealthReport {
        let mut report = HealthReport::default();
        for unit in self.scene.units().iter().take(self.scene.per_copy) {
            let health = self.health_of(unit, self.model.file().ranges());
            report.outside_units += u32::from(health.outside != 0);
            report.quarantined_units += u32::from(health.is_quarantined);
            let worst = report.farthest.map_or(f32::NEG_INFINITY, |(_, worst)| worst.beyond);
            if let Some(excess) = health.farthest.filter(|excess| excess.beyond > worst) {
                report.farthest = Some((unit.id, excess));
            }
        }
        report
    }

    /// What a unit's quantities are now, in the order of [`Quantity::ALL`], in the first copy; none where no unit has that name.
    pub fn quantities(&self, id: UnitId) -> Option<[f32; Quantity::COUNT]> {
        let unit = self.scene.units().get(self.number(id)?)?;
        Some(in_own_environment(|| self.quantities_of(unit)))
    }

    fn health_of(&self, unit: &UnitSlot, ranges: Option<&Ranges>) -> Health {
        in_own_environment(|| self.health_here(unit, ranges))
    }

    fn health_here(&self, unit: &UnitSlot, ranges: Option<&Ranges>) -> Health {
        let mut health = Health { is_quarantined: unit.is_quarantined(), ..Health::default() };
        let Some(ranges) = ranges else { return health };
        let is_free = unit.given_role() == Role::Free;
        let values = Quantity::ALL.into_iter().zip(self.quantities_of(unit));
        for (quantity, value) in values.filter(|(quantity, _)| is_free || quantity.is_of_all()) {
            let beyond = ranges.beyond(quantity, value);
            if beyond > MARGIN {
                health.outside |= 1 << quantity as u32;
            }
            if health.farthest.is_none_or(|farthest| beyond > farthest.beyond) {
                health.farthest = Some(Excess { quantity, value, beyond });
            }
        }
        health
    }

    fn quantities_of(&self, unit: &UnitSlot) -> [f32; Quantity::COUNT] {
        let scene = &self.scene;
        let coming = unit.coming();
        let points = scene.points_of(unit);
        let form = Form::of(points, unit.radius);
        [
            norm(&coming.way) / scene.dt,
            chord(&coming.change) / scene.dt,
            math::ln(unit.radius),
            form.thickness,
            unit.ln_mass,
            unit.physics.friction,
            unit.physics.restitution,
            self.step_code,
            norm(&scene.gravity),
            footing(scene),
            math::ln(points.len() as f32),
            form.spacing,
            form.hole,
            depth(scene, unit) / unit.radius,
        ]
    }
}

/// Twice the sine of half the angle between two rotations that differ by so much.
fn chord(difference: &Matrix3<f32>) -> f32 {
    math::sqrt(difference.iter().fold(0.0_f32, |sum, v| sum + v * v) * 0.5)
}

/// See [`Quantity::Footing`].
fn footing(scene: &Scene<'_>) -> f32 {
    let size = norm(&scene.gravity);
    if size <= 0.0 {
        return 1.0;
    }
    let into = scene.planes.iter().map(|plane| -dot(&plane.normal, &scene.gravity) / size);
    into.reduce(f32::max).unwrap_or_default()
}

/// Depth of the lowest point below a plane, in the scene's measure; 0 above all.
fn depth(scene: &Scene<'_>, unit: &UnitSlot) -> f32 {
    let points = scene.points_of(unit);
    let depth = |plane: &crate::Plane| plane.depth_m(points, unit.radius, &unit.current);
    scene.planes.iter().map(depth).fold(0.0, f32::max)
}

/// What a unit's points look like.
struct Form {
    thickness: f32,
    spacing: f32,
    hole: f32,
}

impl Form {
    /// Of points about a centre.
    fn of(points: &[Point3<f32>], radius: f32) -> Form {
        let points = points.get(..LOOKED_AT.min(points.len())).unwrap_or_default();
        // A point in the centre is in no direction.
        let mut shares = [0.0_f32; LOOKED_AT];
        for (share, point) in shares.iter_mut().zip(points) {
            *share = 1.0 / norm(&point.coords).max(f32::MIN_POSITIVE);
        }
        let (mut thinnest, mut widest) = (f32::INFINITY, f32::INFINITY);
        for direction in felt_directions() {
            let (mut reach, mut cosine) = (0.0_f32, f32::NEG_INFINITY);
            for (point, share) in points.iter().zip(shares) {
                let along = dot(&point.coords, &direction);
                reach = reach.max(along);
                cosine = cosine.max(along * share);
            }
            let length = norm(&direction);
            thinnest = thinnest.min(reach / length);
            widest = widest.min(cosine / length);
        }
        let mut spacing2 = 0.0_f32;
        for (number, point) in points.iter().enumerate() {
            let others = points.iter().enumerate().filter(|(other, _)| *other != number);
            let nearest = others.fold(f32::INFINITY, |nearest, (_, other)| {
                let way = other - point;
                nearest.min(dot(&way, &way))
            });
            spacing2 = spacing2.max(nearest);
        }
        Form {
            thickness: thinnest / radius,
            spacing: math::sqrt(spacing2) / radius,
            hole: 1.0 - widest,
        }
    }
}
