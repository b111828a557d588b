//! Pose and velocity of a unit with their covariance: an error-state Kalman filter.
//!
//! The state is about the unit's centre, in the world's axes: under gravity alone the centre follows a parabola, and other points of a
//! spinning body do not.

use nalgebra::{
    Isometry3, Matrix3, Matrix6, Point3, SMatrix, Translation3, UnitQuaternion, Vector3, Vector6,
};

/// Covariance of the error state: centre (m), rotation (rad), velocity (m/s) and spin (rad/s).
pub(super) type Covariance = SMatrix<f64, 12, 12>;

/// Pose and velocity of a unit.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Motion {
    /// Of its centre, m.
    pub(super) centre: Vector3<f64>,
    /// From the unit's frame to the world.
    pub(super) rotation: UnitQuaternion<f64>,
    /// Of its centre, m/s.
    pub(super) linear: Vector3<f64>,
    /// rad/s, in the world's axes.
    pub(super) angular: Vector3<f64>,
    pub(super) covariance: Covariance,
}

/// A prediction of a unit.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub(super) motion: Motion,
    /// As the forecaster's `MovingUnit` has it.
    pub(super) velocity_lag_m_s2: Vector3<f32>,
    /// Whether it is that the unit stays.
    pub(super) is_still: bool,
}

impl Candidate {
    pub(super) fn still(motion: Motion) -> Self {
        Candidate { motion, velocity_lag_m_s2: Vector3::zeros(), is_still: true }
    }
}

/// Standard deviations of a unit's first state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Deviations {
    pub(super) position_m: f64,
    pub(super) turn_rad: f64,
    pub(super) linear_m_s: f64,
    pub(super) angular_rad_s: f64,
}

/// Process noise: spectral densities of white accelerations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ProcessNoise {
    /// m/s^2 per square root of Hz.
    pub(super) linear: f64,
    /// rad/s^2 per square root of Hz.
    pub(super) angular: f64,
}

/// Deviations of the velocity of a unit at rest in the time to the next capture: m/s, rad/s. Captures of a scene at rest differ by more than
/// the noise of their pixels.
const STILL: [f64; 2] = [0.01, 0.02];
/// Shortest time that bounds a velocity, seconds.
const MIN_SINCE_S: f64 = 1e-3;

impl Motion {
    pub(super) fn at_rest(centre: Vector3<f64>, deviations: Deviations) -> Self {
        let Deviations { position_m, turn_rad, linear_m_s, angular_rad_s } = deviations;
        let mut covariance = Covariance::zeros();
        for (block, deviation) in
            [position_m, turn_rad, linear_m_s, angular_rad_s].iter().enumerate()
        {
            for axis in 0..3 {
                covariance[(3 * block + axis, 3 * block + axis)] = deviation * deviation;
            }
        }
        let (linear, angular) = (Vector3::zeros(), Vector3::zeros());
        Motion { centre, rotation: UnitQuaternion::identity(), linear, angular, covariance }
    }

    /// Carries the unit's points to the world; `centre` is in the unit's frame.
    pub(super) fn pose(&self, centre: &Point3<f32>) -> Isometry3<f32> {
        let offset = self.rotation * centre.coords.cast::<f64>();
        Isometry3::from_parts(
            Translation3::from((self.centre - offset).cast::<f32>()),
            self.rotation.cast::<f32>(),
        )
    }

    /// Velocity of the centre, then spin.
    pub(super) fn velocity(&self) -> Vector6<f32> {
        let (v, w) = (self.linear, self.angular);
        Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z).cast()
    }

    /// Of the pose, and of the velocity.
    pub(super) fn covariances(&self) -> [Matrix6<f32>; 2] {
        [0, 6].map(|at| self.covariance.fixed_view::<6, 6>(at, at).into_owned().cast())
    }

    /// Upper bounds of the deviations of the centre, m, and of the rotation, rad, along any axis: square roots of traces.
    pub(super) fn pose_deviation(&self) -> (f64, f64) {
        let trace = |at: usize| (0..3).map(|i| self.covariance[(at + i, at + i)]).sum::<f64>();
        (trace(0).max(0.0).sqrt(), trace(3).max(0.0).sqrt())
    }

    /// Deviation of the centre, m, after `while_s` seconds of known accelerations.
    pub(super) fn position_deviation_after(&self, while_s: f64) -> f64 {
        let variances = (0..3).map(|i| {
            let entry = |row: usize, column: usize| self.covariance[(row, column)];
            entry(i, i) + 2.0 * while_s * entry(i, i + 6) + while_s * while_s * entry(i + 6, i + 6)
        });
        variances.sum::<f64>().max(0.0).sqrt()
    }

    /// Predicts that the unit stays where it is, over `dt_s`. `since_s` is how long it has been there: the longer, the less its velocity can
    /// have been, in the directions that were observed.
    pub(super) fn propagate_still(&mut self, dt_s: f64, since_s: f64) {
        self.stop(since_s.max(dt_s));
    }

    /// Adds what may have moved a unit at rest over `dt_s` in which nothing was seen of it.
    pub(super) fn stay_unseen(&mut self, dt_s: f64) {
        self.add_pose_noise(STILL[0] * dt_s, STILL[1] * dt_s);
    }

    /// Sets the velocity of a unit that has been in its place for `since_s`.
    pub(super) fn stop(&mut self, since_s: f64) {
        (self.linear, self.angular) = (Vector3::zeros(), Vector3::zeros());
        // Two poses bound the mean velocity between them.
        let between = (2.0 / since_s.max(MIN_SINCE_S).powi(2)) * self.pose_covariance();
        self.covariance.fixed_view_mut::<6, 6>(0, 6).fill(0.0);
        self.covariance.fixed_view_mut::<6, 6>(6, 0).fill(0.0);
        self.covariance.fixed_view_mut::<6, 6>(6, 6).copy_from(&between);
        for axis in 0..6 {
            self.covariance[(axis + 6, axis + 6)] += (0.1 * STILL[axis / 3]).powi(2);
        }
        self.symmetrise();
    }

    /// Predicts free motion over `dt_s`.
    pub(super) fn propagate_freely(
        &mut self,
        dt_s: f64,
        gravity: &Vector3<f64>,
        process_noise: ProcessNoise,
    ) {
        self.centre += self.linear * dt_s + gravity * (0.5 * dt_s * dt_s);
        self.rotation = UnitQuaternion::from_scaled_axis(self.angular * dt_s) * self.rotation;
        self.linear += gravity * dt_s;
        let mut step = Covariance::identity();
        for axis in 0..6 {
            step[(axis, axis + 6)] = dt_s;
        }
        self.covariance = step * self.covariance * step.transpose();
        self.add_process_noise(dt_s, process_noise);
        self.symmetrise();
    }

    /// Adds the covariance that white accelerations accumulate over `dt_s`.
    fn add_process_noise(&mut self, dt_s: f64, process_noise: ProcessNoise) {
        let (cubic, square) = (dt_s.powi(3) / 3.0, dt_s.powi(2) / 2.0);
        for axis in 0..6 {
            // The first three of each block are linear, the others angular.
            let density = if axis < 3 { process_noise.linear } else { process_noise.angular };
            let density = density * density;
            self.covariance[(axis, axis)] += cubic * density;
            self.covariance[(axis, axis + 6)] += square * density;
            self.covariance[(axis + 6, axis)] += square * density;
            self.covariance[(axis + 6, axis + 6)] += dt_s * density;
        }
    }

    /// Difference of another pose from this one: centre, then rotation, in the world's axes.
    pub(super) fn difference_to(&self, other: &Motion) -> Vector6<f64> {
        let position = other.centre - self.centre;
        let turn = (other.rotation * self.rotation.inverse()).scaled_axis();
        Vector6::new(position.x, position.y, position.z, turn.x, turn.y, turn.z)
    }

    /// Logarithm of the likelihood of a pose that differs by `delta`, observed with this information, up to a constant. `f64::MIN` where a
    /// matrix is singular.
    pub(super) fn likelihood(&self, delta: &Vector6<f64>, information: &Matrix6<f64>) -> f64 {
        // Unobserved directions have no information. A variance of 1 m2 makes the matrix invertible, and is that of a body's size.
        let observed = (information + Matrix6::identity()).try_inverse();
        let Some(whole) =
            observed.and_then(|observed| (self.pose_covariance() + observed).cholesky())
        else {
            return f64::MIN;
        };
        let spread: f64 =
            whole.l_dirty().diagonal().iter().map(|entry| entry.max(1e-30).ln()).sum();
        -0.5 * delta.dot(&whole.solve(delta)) - spread
    }

    /// Adds the covariance of an impact at an unknown time of the last `dt_s`, which changes velocities by about these amounts. An early
    /// impact explains a displacement by a smaller change of velocity than a late one, so the change counts over all of `dt_s`.
    fn add_impact_noise(&mut self, dt_s: f64, linear_m_s: f64, angular_rad_s: f64) {
        for axis in 0..6 {
            let change = if axis < 3 { linear_m_s } else { angular_rad_s };
            let square = change * change / 3.0;
            self.covariance[(axis, axis)] += square * dt_s * dt_s;
            self.covariance[(axis, axis + 6)] += square * dt_s;
            self.covariance[(axis + 6, axis)] += square * dt_s;
            self.covariance[(axis + 6, axis + 6)] += 1.5 * square;
        }
    }

    /// Adds an independent deviation of position, m, and rotation, rad, along each axis.
    pub(super) fn add_pose_noise(&mut self, position_m: f64, turn_rad: f64) {
        for axis in 0..6 {
            let deviation = if axis < 3 { position_m } else { turn_rad };
            self.covariance[(axis, axis)] += deviation * deviation;
        }
    }

    /// Replaces the prediction of free motion by the model's. Where the two differ the model predicts a contact, whose outcome is less
    /// certain: `share` of the difference is a deviation, in any direction and at any time of the step.
    pub(super) fn adopt_prediction(&mut self, predicted: &Motion, share: f64, dt_s: f64) {
        let linear = (predicted.linear - self.linear).norm();
        let angular = (predicted.angular - self.angular).norm();
        self.add_impact_noise(dt_s, share * linear, share * angular);
        self.centre = predicted.centre;
        self.rotation = predicted.rotation;
        self.linear = predicted.linear;
        self.angular = predicted.angular;
    }

    /// Covariance of centre and rotation.
    pub(super) fn pose_covariance(&self) -> Matrix6<f64> {
        self.covariance.fixed_view::<6, 6>(0, 0).into_owned()
    }

    /// Squared Mahalanobis distance of a correction under the prior's covariance, over its 6 degrees of freedom.
    pub(super) fn normalised_innovation(&self, delta: &Vector6<f64>) -> Option<f64> {
        let whole = self.pose_covariance().cholesky()?;
        Some(delta.dot(&whole.solve(delta)) / 6.0)
    }

    /// Squared Mahalanobis distance of a pose that points alone show, under the prior's and their covariance, over its 6 degrees of freedom.
    pub(super) fn surprise(&self, delta: &Vector6<f64>, information: &Matrix6<f64>) -> Option<f64> {
        // As in `likelihood`.
        let observed = (information + Matrix6::identity()).try_inverse()?;
        let whole = (self.pose_covariance() + observed).cholesky()?;
        Some(delta.dot(&whole.solve(delta)) / 6.0)
    }

    /// What the prior leaves of a pose that points alone show.
    pub(super) fn posterior(
        &self,
        delta: &Vector6<f64>,
        information: &Matrix6<f64>,
    ) -> Option<Vector6<f64>> {
        let prior = self.pose_covariance().try_inverse()?;
        Some((prior + information).cholesky()?.solve(&(information * delta)))
    }

    /// Adds the covariance of an impact within the last `dt_s` that explains the error `delta` of the prediction.
    pub(super) fn widen_for_impact(&mut self, delta: &Vector6<f64>, dt_s: f64) {
        // An impact at the middle of the time displaces the unit by half of its change of velocity.
        let speeds = [0, 3].map(|at| delta.fixed_rows::<3>(at).norm() / dt_s);
        self.add_impact_noise(dt_s, 2.0 * speeds[0], 2.0 * speeds[1]);
    }

    /// Kalman update with a registered pose, whose prior this pose is: it differs by `delta`, centre and rotation, and the points alone have
    /// this information.
    pub(super) fn correct(
        &mut self,
        delta: &Vector6<f64>,
        information: &Matrix6<f64>,
    ) -> Option<()> {
        let prior = self.pose_covariance();
        let all = prior.cholesky()?.solve(delta);
        let columns = self.covariance.fixed_columns::<6>(0).into_owned();
        let change = columns * all;
        // `delta` already includes the prior, so the gain in information form applies to the covariance alone.
        let gain = (Matrix6::identity() + information * prior).try_inverse()? * information;
        let covariance = self.covariance - columns * gain * columns.transpose();
        if !change.iter().chain(covariance.iter()).all(|number| number.is_finite()) {
            return None;
        }
        self.covariance = covariance;
        self.centre += change.fixed_rows::<3>(0);
        let turn = UnitQuaternion::from_scaled_axis(change.fixed_rows::<3>(3).into_owned());
        self.rotation = turn * self.rotation;
        self.linear += change.fixed_rows::<3>(6);
        self.angular += change.fixed_rows::<3>(9);
        self.symmetrise();
        Some(())
    }

    /// Moves the centre by `lever`, in the world's axes; the motion is the same.
    pub(super) fn move_centre(&mut self, lever: &Vector3<f64>) {
        self.centre += lever;
        self.linear += self.angular.cross(lever);
        // A rotation error moves the new centre by its cross product with the lever.
        let cross = -lever.cross_matrix();
        let mut change = Covariance::identity();
        for at in [0, 6] {
            change.fixed_view_mut::<3, 3>(at, at + 3).copy_from(&cross);
        }
        self.covariance = change * self.covariance * change.transpose();
        self.symmetrise();
    }

    /// Restores symmetry, positive variances and a unit quaternion, which rounding spoils.
    fn symmetrise(&mut self) {
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
        for axis in 0..12 {
            // Variances of 0 would make matrices singular: a micrometre, and ten of them a second, are no limit.
            let least = if axis < 6 { 1e-12 } else { 1e-10 };
            let entry = &mut self.covariance[(axis, axis)];
            *entry = entry.max(least);
        }
        self.rotation.renormalize();
    }
}

/// Rotation matrices of f64 that are applied to many points.
pub(super) fn matrix(rotation: &UnitQuaternion<f64>) -> Matrix3<f64> {
    rotation.to_rotation_matrix().into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigidformer_runtime::noise::Noise;

    const START: Deviations =
        Deviations { position_m: 0.1, turn_rad: 0.1, linear_m_s: 2.0, angular_rad_s: 3.0 };
    const CALM: ProcessNoise = ProcessNoise { linear: 0.0, angular: 0.0 };

    /// A centre and a turn that were seen, as the filter takes them.
    fn see(motion: &mut Motion, centre: Vector3<f64>, turn: UnitQuaternion<f64>, sd: [f64; 2]) {
        let mut information = Matrix6::zeros();
        for axis in 0..6 {
            information[(axis, axis)] = sd[axis / 3].powi(-2);
        }
        let prior = motion.pose_covariance().try_inverse().unwrap();
        let position = centre - motion.centre;
        let angle = (turn * motion.rotation.inverse()).scaled_axis();
        let seen = Vector6::new(position.x, position.y, position.z, angle.x, angle.y, angle.z);
        let delta = (prior + information).try_inverse().unwrap() * (information * seen);
        motion.correct(&delta, &information).unwrap();
    }

    #[test]
    fn a_throw_is_followed_and_the_covariance_is_honest() {
        let gravity = Vector3::new(0.0, 0.0, -9.81);
        let (mut square, mut counted) = (0.0, 0.0);
        for seed in 0..60 {
            let mut noise = Noise::new(seed, 3);
            let mut normal = |sd: f64| f64::from(noise.normal()) * sd;
            let mut vector = |sd: f64| Vector3::new(normal(sd), normal(sd), normal(sd));
            let (v, w) = (vector(1.5), vector(2.0));
            let mut motion = Motion::at_rest(vector(0.05), START);
            let dt = 1.0 / 30.0;
            for frame in 0..12 {
                let t = f64::from(frame) * dt;
                if frame > 0 {
                    motion.propagate_freely(dt, &gravity, CALM);
                }
                let centre = v * t + gravity * (0.5 * t * t) + vector(0.002);
                let turn = UnitQuaternion::from_scaled_axis(vector(0.01))
                    * UnitQuaternion::from_scaled_axis(w * t);
                see(&mut motion, centre, turn, [0.002, 0.01]);
            }
            let t = 11.0 * dt;
            let off = motion.linear - (v + gravity * t);
            let covariance = motion.covariance.fixed_view::<3, 3>(6, 6).into_owned();
            square += off.dot(&(covariance.try_inverse().unwrap() * off));
            counted += 3.0;
            assert!(off.norm() < 0.05, "{off}");
            assert!((motion.angular - w).norm() < 0.3, "{}", motion.angular - w);
        }
        // Of 180 numbers the mean square in deviations is within .2 of 1 nearly always.
        let mean: f64 = square / counted;
        assert!((0.6..1.4).contains(&mean), "{mean}");
    }

    #[test]
    fn about_another_centre_it_is_the_same_motion() {
        let mut motion = Motion::at_rest(Vector3::new(1.0, 2.0, 3.0), START);
        motion.angular = Vector3::new(0.0, 0.0, 2.0);
        motion.linear = Vector3::new(1.0, 0.0, 0.0);
        let before = motion.clone();
        let lever = Vector3::new(0.0, 0.5, 0.0);
        motion.move_centre(&lever);
        assert!((motion.linear - Vector3::new(0.0, 0.0, 0.0)).norm() < 1e-12);
        assert!(motion.covariance[(0, 0)] > before.covariance[(0, 0)]);
        motion.move_centre(&-lever);
        assert!((motion.covariance - before.covariance).norm() < 1e-12);
        assert!((motion.linear - before.linear).norm() < 1e-12);
        assert!((motion.centre - before.centre).norm() < 1e-12);
    }
}
