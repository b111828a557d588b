//! The measure of a scene, from its units.

use super::state::Simulator;
use crate::error::ObserveError;
use crate::geometry::norm;
use crate::limits::{MAX_SUB_STEPS, SHORTEST_SOFT_STEP_S, SHORTEST_STEP_S};
use crate::math;
use crate::measure::{Measure, Pace, is_similar};
use crate::scene::{Physics, Role, Unit};
use crate::structure::heading::is_robot;
use nalgebra::{Point3, Vector3};
use rigidformer_weights::ModelConfig;

/// A time step within this share of a whole number of native frames is that number: callers round 1/24 s, and step codes
/// are exact.
const WHOLE: f32 = 1e-6;

/// Radii and masses of units, added up in their order.
#[derive(Clone, Copy, Default)]
struct Sum {
    count: f32,
    radius: f32,
    mass: f32,
}

impl Sum {
    fn add(&mut self, radius: f32, physics: &Physics) {
        self.count += 1.0;
        self.radius += radius;
        self.mass += physics.mass_kg;
    }
}

/// What units tell of their scene's measure: the free ones, or all where none is free.
#[derive(Clone, Copy, Default)]
pub(super) struct Census {
    free: Sum,
    all: Sum,
}

impl Census {
    /// Counts a unit for a model; models that take SI units do not look.
    pub(super) fn take(&mut self, config: &ModelConfig, unit: &Unit<'_>) {
        if is_similar(config) {
            let radius = box_radius(unit.points);
            self.all.add(radius, &unit.physics);
            if unit.role == Role::Free {
                self.free.add(radius, &unit.physics);
            }
        }
    }

    /// The measure of the units that were counted, at least one.
    pub(super) fn measure(&self, config: &ModelConfig) -> Measure {
        let Sum { count, radius, mass } = if self.free.count > 0.0 { self.free } else { self.all };
        match is_similar(config) && count > 0.0 {
            true => Measure::new(radius / count / config.similarity.length_m, mass / count),
            false => Measure::SI,
        }
    }
}

/// Radius about the centre of the box around points: no order of the points changes a bit of it, and none of their
/// density.
fn box_radius(points: &[Point3<f32>]) -> f32 {
    let mut low = Vector3::repeat(f32::INFINITY);
    let mut high = Vector3::repeat(f32::NEG_INFINITY);
    for point in points {
        low = low.inf(&point.coords);
        high = high.sup(&point.coords);
    }
    let middle = (low + high) * 0.5;
    points.iter().fold(0.0_f32, |radius, point| radius.max(norm(&(point.coords - middle))))
}

/// A time step, its substeps, and the step code of one: native frames of the model in it.
#[derive(Clone, Copy)]
pub(super) struct Time {
    /// As the caller has it.
    pub(super) given_s: f32,
    /// Substeps that it is taken in, at least 1.
    pub(super) substeps: u32,
    /// A substep, in the scene's measure.
    pub(super) dt_s: f32,
    pub(super) step_code: f32,
}

impl Time {
    /// Rounding of a division and a multiplication must not tell a whole number of native frames from itself.
    pub(super) fn new(
        given_s: f32,
        measure: &Measure,
        gravity: &Vector3<f32>,
        config: &ModelConfig,
    ) -> Result<Time, ObserveError> {
        let dt_s = given_s / Pace::new(config, measure, gravity).time;
        let frame_rate_hz = config.frame_rate_hz;
        let code = dt_s * frame_rate_hz;
        let positive = f32::MIN_POSITIVE..=f32::MAX;
        if ![given_s, dt_s, code].iter().all(|time| positive.contains(time)) {
            return Err(ObserveError::BadTimestep);
        }
        check_dt(given_s, config)?;
        let whole = if code < 4_194_304.0 { (code + math::SHIFT) - math::SHIFT } else { code };
        let is_whole = whole >= 1.0 && (code - whole).abs() <= whole * WHOLE;
        let (dt_s, step_code) =
            if is_whole { (whole / frame_rate_hz, whole) } else { (dt_s, code) };
        let given_s = if is_similar(config) { given_s } else { dt_s };
        #[cfg(feature = "deform")]
        if config.motion.is_soft() {
            let steps = dt_s * config.elastic.rate_hz / crate::structure::soft::MAX_SOFT_SUBSTEPS;
            if steps > 1.0 {
                return Err(ObserveError::LongTimestep {
                    dt_s: given_s,
                    substeps: steps,
                    longest_s: given_s / steps,
                });
            }
        }
        let longest = config.similarity.longest_step;
        // Rounding must not make two substeps of a longest step.
        let ratio = if longest > 0.0 { step_code / longest * (1.0 - WHOLE) } else { 0.0 };
        if ratio <= 1.0 {
            return Ok(Time { given_s, substeps: 1, dt_s, step_code });
        }
        if ratio > MAX_SUB_STEPS as f32 {
            let longest_s = given_s / ratio * MAX_SUB_STEPS as f32;
            return Err(ObserveError::LongTimestep { dt_s: given_s, substeps: ratio, longest_s });
        }
        // Rounded down; at most the limit.
        let substeps = ratio as u32;
        let substeps =
            if (substeps as f32) < ratio { substeps.saturating_add(1) } else { substeps };
        let share = substeps as f32;
        Ok(Time { given_s, substeps, dt_s: dt_s / share, step_code: step_code / share })
    }
}

/// Whether a time step is a finite time that is long enough for a model.
pub(super) fn check_dt(dt_s: f32, config: &ModelConfig) -> Result<(), ObserveError> {
    if !(f32::MIN_POSITIVE..=f32::MAX).contains(&dt_s) {
        return Err(ObserveError::BadTimestep);
    }
    let is_soft = cfg!(feature = "deform") && config.motion.is_soft();
    let shortest_s = if is_soft { SHORTEST_SOFT_STEP_S } else { SHORTEST_STEP_S };
    match dt_s < shortest_s {
        true => Err(ObserveError::ShortTimestep { dt_s, shortest_s }),
        false => Ok(()),
    }
}

impl Simulator<'_, '_> {
    /// A time step in a scene of such units, the nearest of which is about a place.
    pub(super) fn measured(
        &self,
        dt_s: f32,
        census: &Census,
        place: &Vector3<f32>,
    ) -> Result<(Measure, Time), ObserveError> {
        let config = self.model.config();
        let measure = self.about(&census.measure(config), place);
        Ok((measure, Time::new(dt_s, &measure, &self.given.gravity, config)?))
    }

    /// A measure with the origin for units about a place.
    pub(super) fn about(&self, measure: &Measure, place: &Vector3<f32>) -> Measure {
        if self.keeps_origin() { measure.from(Vector3::zeros()) } else { measure.about(place) }
    }

    /// Points of soft bodies and the ground of robots are where the world has them.
    pub(super) fn keeps_origin(&self) -> bool {
        self.sizes.is_soft() || is_robot(self.model.config())
    }

    /// Measures planes and gravity by another measure.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    pub(super) fn set_measure(&mut self, measure: Measure) {
        self.forget_still();
        let Self { scene, given, model, .. } = self;
        scene.measure = measure;
        scene.planes.clone_from(&given.planes);
        for plane in &mut scene.planes {
            plane.offset_m = measure.inward_offset(&plane.normal, plane.offset_m);
        }
        let pace = Pace::new(model.config(), &measure, &given.gravity);
        scene.gravity = given.gravity * pace.gravity_factor;
        if let Some(second) = scene.second.get_mut() {
            *second = pace.time;
        }
    }

    pub(super) fn set_time(&mut self, Time { given_s, substeps, dt_s, step_code }: Time) {
        self.forget_still();
        self.given.dt_s = given_s;
        (self.scene.substeps, self.scene.dt) = (substeps, dt_s);
        self.films_stale |= self.step_code != step_code;
        self.step_code = step_code;
    }
}
