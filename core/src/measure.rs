//! What a scene is measured in: SI units, or its own length, mass and time (docs/MODEL.md, section 1).

use crate::geometry::{Pose, State, norm, rotate};
use crate::limits::MAX_COORDINATE_M;
use crate::math;
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use rigidformer_weights::ModelConfig;

/// Origins are whole numbers of so many lengths, rounded up to powers of two: scenes about the world's origin have that one, and f32 hold
/// the differences exactly.
const GRID: f32 = 64.0;

/// What stands for a metre and for a kilogram in a scene, and where it counts places from. For models that are told lengths in those of the scene, metres
/// and kilograms in all that a scene holds are multiples of these, and seconds those of its [`Pace`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Measure {
    length: f32,
    mass: f32,
    /// In the caller's metres.
    origin: Vector3<f32>,
}

impl Measure {
    /// Metres and kilograms themselves.
    pub(crate) const SI: Measure = Measure::new(1.0, 1.0);

    /// Of so many metres and kilograms.
    pub(crate) const fn new(length: f32, mass: f32) -> Self {
        Measure { length, mass, origin: Vector3::new(0.0, 0.0, 0.0) }
    }

    /// With another origin, in the caller's metres.
    pub(crate) fn from(&self, origin: Vector3<f32>) -> Self {
        Measure { origin, ..*self }
    }

    /// With the origin for units about a place, in the caller's metres: within 32 m of it f32 hold 2 um.
    pub(crate) fn about(&self, place: &Vector3<f32>) -> Self {
        // The next power of two: bits beyond the exponent carry into it.
        let grid = GRID * f32::from_bits((self.length.to_bits() + 0x007f_ffff) & 0x7f80_0000);
        self.from(place.map(|v| {
            let number = v / grid;
            let whole = (number + math::SHIFT) - math::SHIFT;
            // Larger numbers have nothing to round off.
            grid * if number.abs() < 4_194_304.0 { whole } else { number }
        }))
    }

    /// Where it counts places from, in the caller's metres.
    pub(crate) fn origin(&self) -> Vector3<f32> {
        self.origin
    }

    /// Metres.
    pub(crate) fn length(&self) -> f32 {
        self.length
    }

    /// Kilograms.
    pub(crate) fn mass(&self) -> f32 {
        self.mass
    }

    /// A pose in metres, in this measure.
    pub(crate) fn inward(&self, pose: &Pose) -> Pose {
        Pose { rotation: pose.rotation, centre: (pose.centre - self.origin) / self.length() }
    }

    /// The pose of a centre at `offset` in the caller's reference frame, in this measure.
    pub(crate) fn inward_isometry(&self, pose: &Isometry3<f32>, offset: &Point3<f32>) -> Pose {
        let place = Translation3::from(pose.translation.vector - self.origin);
        let near = Isometry3::from_parts(place, pose.rotation);
        let pose = Pose::from_isometry(&near, offset);
        Pose { rotation: pose.rotation, centre: pose.centre / self.length() }
    }

    /// A state's pose in metres.
    pub(crate) fn outward(&self, state: &State) -> Pose {
        let centre = match self.origin == Vector3::zeros() {
            true => self.near(state),
            // Rounded once, so that the origin does not show.
            false => self.centre(state).coords.map(|v| v as f32),
        };
        Pose { rotation: state.pose.rotation, centre }
    }

    /// As [`outward`](Self::outward), of the caller's reference frame, in which the centre is at `offset`.
    pub(crate) fn outward_isometry(&self, state: &State, offset: &Point3<f32>) -> Isometry3<f32> {
        let near = Pose { centre: self.near(state), ..state.pose }.isometry(offset);
        let place = Translation3::from(near.translation.vector + self.origin);
        Isometry3::from_parts(place, near.rotation)
    }

    /// A state's centre from the origin, metres.
    fn near(&self, state: &State) -> Vector3<f32> {
        (state.pose.centre + state.course.centre_low) * self.length()
    }

    /// A point of a unit in metres.
    pub(crate) fn outward_point(&self, state: &State, local: &Vector3<f32>) -> Point3<f32> {
        let lever = rotate(&state.pose.rotation, local) * self.length();
        Point3::from((lever + self.near(state)) + self.origin)
    }

    /// The centre of a unit, metres, with all of its digits.
    pub(crate) fn centre(&self, state: &State) -> Point3<f64> {
        let [high, low, origin] =
            [state.pose.centre, state.course.centre_low, self.origin].map(|v| v.cast::<f64>());
        Point3::from((high + low) * f64::from(self.length()) + origin)
    }

    /// Whether a unit may be in a state, and in the pose that it comes from: numbers are finite and places near enough.
    pub(crate) fn allows(&self, state: &State) -> bool {
        let centre = state.pose.centre;
        state.is_finite() && self.is_near(&centre) && self.is_near(&(centre - state.course.way))
    }

    /// Whether a place is near enough.
    #[cfg_attr(rigidformer_dsp, inline(never))]
    fn is_near(&self, centre: &Vector3<f32>) -> bool {
        let (mut here, mut there) = (0.0_f32, 0.0_f32);
        for (v, origin) in centre.iter().zip(self.origin.iter()) {
            here = here.max(v.abs());
            there = there.max((v * self.length() + origin).abs());
        }
        // In lengths from the scene's own origin, or from the world's: a scene may lie on both sides of that.
        let most = MAX_COORDINATE_M * self.length().min(1.0);
        there <= MAX_COORDINATE_M && (here <= MAX_COORDINATE_M || there <= most)
    }

    /// The offset of a plane, given in metres, in this measure.
    pub(crate) fn inward_offset(&self, normal: &Vector3<f32>, offset_m: f32) -> f32 {
        if self.origin == Vector3::zeros() {
            return offset_m / self.length();
        }
        let [normal, origin] = [normal, &self.origin].map(|v| v.cast::<f64>());
        let along = normal.x * origin.x + normal.y * origin.y + normal.z * origin.z;
        (f64::from(offset_m) - along) as f32 / self.length()
    }
}

/// Whether a model is told lengths in those of the scene.
pub(crate) fn is_similar(config: &ModelConfig) -> bool {
    config.similarity.length_m > 0.0
}

/// How fast time goes in a scene.
#[derive(Clone, Copy)]
pub(crate) struct Pace {
    /// Seconds that count as one.
    pub(crate) time: f32,
    /// What gravity is multiplied by.
    pub(crate) gravity_factor: f32,
}

impl Pace {
    /// In a scene of a measure, under a gravity in m/s^2.
    pub(crate) fn new(config: &ModelConfig, measure: &Measure, gravity: &Vector3<f32>) -> Self {
        if !is_similar(config) {
            return Pace { time: 1.0, gravity_factor: 1.0 };
        }
        let own = norm(&Vector3::from(config.gravity_m_s2));
        let here = norm(gravity);
        let gravity_factor = if own > 0.0 && here > 0.0 { own / here } else { 1.0 };
        Pace { time: math::sqrt(measure.length() * gravity_factor), gravity_factor }
    }
}
