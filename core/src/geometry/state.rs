//! A unit's pose with the digits that f32 leave out of it, and its motion in the last substep.
//!
//! Two poses lose a motion that is small beside their coordinates: at 10 m and steps of 0.1 ms, nothing would fall. So the way and
//! the turn are numbers of their own, and sums of small ways keep a second f32.

use super::dot;
use super::pose::{
    POSE, Pose, product, product_transposed, read_pose, rotate, shares, turned, write_pose,
};
use nalgebra::{Matrix3, Vector3};

/// Numbers of a course in a row.
pub(crate) const COURSE: usize = 15;
/// Numbers of a state in a row: the pose, then the course.
pub(crate) const STATE: usize = POSE + COURSE;

/// What a pose leaves out: further digits, and motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Course {
    /// Added to the pose's centre it is the unit's centre, metres.
    pub(crate) centre_low: Vector3<f32>,
    /// The turn that the pose's rotation lacks, radians along the world's axes.
    pub(crate) turn_low: Vector3<f32>,
    /// Of the centre in the last substep, metres.
    pub(crate) way: Vector3<f32>,
    /// What that leaves out, metres.
    pub(crate) way_low: Vector3<f32>,
    /// In the last substep, radians along the world's axes.
    turn: Vector3<f32>,
    /// How much of the turn once and twice across a vector is how far it took that.
    shares: (f32, f32),
}

/// A pose and its course.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct State {
    pub(crate) pose: Pose,
    pub(crate) course: Course,
}

impl Course {
    /// No course. Zeros alone.
    pub(crate) const NONE: Course = Course { shares: (0.0, 0.0), ..Course::REST };

    /// At rest, with a pose's own digits.
    pub(crate) const REST: Course = {
        let zero = Vector3::new(0.0, 0.0, 0.0);
        Course {
            centre_low: zero,
            turn_low: zero,
            way: zero,
            way_low: zero,
            turn: zero,
            shares: (1.0, 0.5),
        }
    };

    /// With another motion.
    pub(crate) fn moving(&self, way: Vector3<f32>, turn: Vector3<f32>) -> Course {
        Course { way, way_low: Vector3::zeros(), turn, shares: shares(&turn), ..*self }
    }

    /// As a row.
    pub(crate) fn row(&self) -> [f32; COURSE] {
        let Course { centre_low: c, turn_low: r, way: v, way_low: u, turn: w, .. } = self;
        [c.x, c.y, c.z, r.x, r.y, r.z, v.x, v.y, v.z, u.x, u.y, u.z, w.x, w.y, w.z]
    }

    /// From a [`row`](Self::row).
    pub(crate) fn read(row: &[f32]) -> Course {
        let rows: [[f32; 3]; 5] = row.as_chunks().0.first_chunk().copied().unwrap_or_default();
        let [centre_low, turn_low, way, way_low, turn] = rows.map(Vector3::from);
        Course { centre_low, turn_low, way, way_low, turn, shares: shares(&turn) }
    }

    /// In the last substep, radians along the world's axes.
    pub(crate) fn turn(&self) -> Vector3<f32> {
        self.turn
    }

    /// Where the last substep's turn took the point at a lever now from, to there, metres.
    #[inline(always)]
    fn turned(&self, lever: &Vector3<f32>) -> Vector3<f32> {
        let (once, twice) = self.shares;
        let across = self.turn.cross(lever);
        across * once - self.turn.cross(&across) * twice
    }

    /// The way of the point at a lever now in the last substep, metres.
    #[inline(always)]
    pub(crate) fn way_at(&self, lever: &Vector3<f32>) -> Vector3<f32> {
        self.way + self.turned(lever)
    }
}

impl State {
    /// Without motion.
    #[cfg(test)]
    pub(crate) fn at(pose: Pose) -> State {
        State { pose, course: Course::REST }
    }

    /// What [`write`](Self::write) wrote.
    pub(crate) fn read(row: &[f32]) -> State {
        let (pose, course) = row.split_at(POSE.min(row.len()));
        State { pose: read_pose(pose), course: Course::read(course) }
    }

    /// To the first [`STATE`] numbers of a row.
    pub(crate) fn write(&self, row: &mut [f32]) {
        let (pose, course) = row.split_at_mut(POSE.min(row.len()));
        write_pose(&self.pose, pose);
        if let Some(course) = course.first_chunk_mut() {
            *course = self.course.row();
        }
    }

    /// Whether it is another one to the bit.
    #[cfg(rigidformer_host)]
    pub(crate) fn has_bits_of(&self, other: &State) -> bool {
        let row = |state: &State| state.course.row().map(f32::to_bits);
        self.pose.has_bits_of(&other.pose) && row(self) == row(other)
    }

    /// Whether all its numbers are finite.
    pub(crate) fn is_finite(&self) -> bool {
        let mut row = [0.0; STATE];
        self.write(&mut row);
        // The product is none where a number is not finite.
        row.iter().fold(0.0, |sum, v| sum + v * 0.0) == 0.0
    }

    /// The pose of a substep ago.
    pub(crate) fn before(&self) -> Pose {
        let Pose { rotation, centre } = self.pose;
        Pose { rotation: turned(&rotation, &-self.course.turn), centre: centre - self.course.way }
    }

    /// Moves it. That is no velocity.
    pub(crate) fn shift(&mut self, way: &Vector3<f32>) {
        add(&mut self.pose.centre, &mut self.course.centre_low, way);
    }

    /// Moves it, in the last substep: that is velocity.
    pub(crate) fn push(&mut self, way: &Vector3<f32>) {
        self.shift(way);
        self.course.way += way;
    }

    /// Turns it, radians along the world's axes. That is no spin.
    pub(crate) fn turn(&mut self, turn: &Vector3<f32>) {
        let old = self.pose.rotation;
        let whole = turn + self.course.turn_low;
        let new = squared(&turned(&old, &whole));
        // The matrix has turned by no more digits than it has. Differences of near numbers are exact.
        let sine = product_transposed(&(new - old), &old);
        let made = Vector3::new(sine.m32 - sine.m23, sine.m13 - sine.m31, sine.m21 - sine.m12);
        self.course.turn_low = whole * shares(&whole).0 - made * 0.5;
        self.pose.rotation = new;
    }

    /// As [`turn`](Self::turn), in the last substep: that is spin.
    #[cfg(feature = "robot")]
    pub(crate) fn push_turn(&mut self, turn: &Vector3<f32>) {
        let before = self.before().rotation;
        self.turn(turn);
        let turn = super::turn_between(&before, &self.pose.rotation);
        self.course = self.course.moving(self.course.way, turn);
    }

    /// Where it is a substep later without contact: its motion goes on, and gravity adds `fall` to the way.
    pub(crate) fn free(&self, fall: &Vector3<f32>) -> State {
        let mut free = *self;
        add(&mut free.course.way, &mut free.course.way_low, fall);
        let way = free.course.way;
        free.shift(&way);
        let turn = free.course.turn;
        if turn != Vector3::zeros() {
            free.turn(&turn);
        }
        free
    }

    /// How far a local point is from where another state has it, metres.
    pub(crate) fn displacement_from(&self, other: &State, local: &Vector3<f32>) -> Vector3<f32> {
        let low = |state: &State| {
            let turned = state.course.turn_low.cross(&rotate(&state.pose.rotation, local));
            state.course.centre_low + turned
        };
        self.pose.displacement_from(&other.pose, local) + (low(self) - low(other))
    }

    /// What the last substep's turn made of the rotation.
    #[cfg(feature = "health")]
    pub(crate) fn turned_by(&self) -> Matrix3<f32> {
        let [x, y, z] =
            super::pose::columns(&self.pose.rotation).map(|axis| self.course.turned(&axis));
        Matrix3::new(x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z)
    }
}

/// Adds to a sum of two f32.
fn add(high: &mut Vector3<f32>, low: &mut Vector3<f32>, more: &Vector3<f32>) {
    for ((high, low), more) in high.iter_mut().zip(low.iter_mut()).zip(more.iter()) {
        let sum = *high + more;
        let taken = sum - *high;
        // What the sum rounds off, exactly.
        let rest = ((*high - (sum - taken)) + (more - taken)) + *low;
        let whole = sum + rest;
        (*low, *high) = (rest - (whole - sum), whole);
    }
}

/// A rotation without what rounding has added in a step, to the first order: R (3 - RᵀR) / 2.
pub(crate) fn squared(rotation: &Matrix3<f32>) -> Matrix3<f32> {
    let square = product(&product_transposed(rotation, rotation), rotation);
    rotation * 1.5 - square * 0.5
}

/// Rodrigues' parameters of a turn: half of it, in radians, while it is small. Turns count as smaller ones from 162 degrees on: half a
/// turn has none.
pub(crate) fn half_turn(turn: &Vector3<f32>) -> Vector3<f32> {
    /// Of 1 + cos: of the greatest turn.
    const LEAST: f32 = 0.05;
    let (once, twice) = shares(turn);
    let cosine = 1.0 - twice * dot(turn, turn);
    turn * (once / (1.0 + cosine).max(LEAST))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    #[test]
    fn small_ways_add_up_far_away() {
        let mut state =
            State::at(Pose { centre: Vector3::new(1000.0, -10.0, 0.0), ..Pose::default() });
        let way = Vector3::new(1e-7, -1e-8, 1e-9);
        (0..1_000_000).for_each(|_| state.shift(&way));
        let found = state.pose.centre.cast::<f64>() + state.course.centre_low.cast::<f64>();
        let start = Vector3::new(1000.0, -10.0, 0.0);
        let error = found - start - way.cast::<f64>() * 1e6;
        assert!(error.amax() < 1e-6, "{error}");
    }

    #[test]
    fn small_turns_add_up() {
        let mut state = State::at(Pose::default());
        let turn = Vector3::new(1e-8, 2e-8, -1e-8);
        (0..1_000_000).for_each(|_| state.turn(&turn));
        let whole = Rotation3::from_scaled_axis(turn.cast::<f64>() * 1e6);
        let rotation = state.pose.rotation.cast::<f64>();
        let error = (rotation - whole.matrix()).norm();
        assert!(error < 3e-7, "{error}");
    }

    #[test]
    fn large_turns_keep_rotations() {
        let mut state = State::at(Pose::default());
        let turn = Vector3::new(0.3, -0.2, 0.9);
        (0..1000).for_each(|_| state.turn(&turn));
        let whole = Rotation3::from_scaled_axis(turn.cast::<f64>() * 1e3);
        let rotation = state.pose.rotation.cast::<f64>();
        assert!((rotation - whole.matrix()).norm() < 1e-4);
        assert!((rotation * rotation.transpose() - Matrix3::identity()).norm() < 1e-6);
    }

    #[test]
    fn a_body_falls_by_the_parabola_at_any_step() {
        for dt in [1e-6_f32, 1e-5, 1e-4, 1e-3, 1e-2] {
            let fall = Vector3::new(0.0, 0.0, -9.81 * dt * dt);
            let mut state =
                State::at(Pose { centre: Vector3::new(3.0, 2.0, 10.0), ..Pose::default() });
            let steps = (0.2 / dt) as u32;
            (0..steps).for_each(|_| state = state.free(&fall));
            let n = f64::from(steps);
            let exact = 10.0 + f64::from(fall.z) * n * (n + 1.0) / 2.0;
            let found = f64::from(state.pose.centre.z) + f64::from(state.course.centre_low.z);
            assert!((found - exact).abs() < 1e-6 * (10.0 - exact), "{dt}: {found} {exact}");
        }
    }

    #[test]
    fn rows_hold_all_of_a_state() {
        let mut row = [0.0; STATE];
        let numbers: [f32; STATE] = core::array::from_fn(|number| number as f32 + 1.0);
        State::read(&numbers).write(&mut row);
        assert_eq!(row, numbers);
    }

    #[test]
    fn what_is_not_finite_is_found() {
        let state = State::at(Pose::default());
        assert!(state.is_finite());
        for number in 0..STATE {
            for bad in [f32::NAN, f32::INFINITY] {
                let mut row = [0.0; STATE];
                state.write(&mut row);
                row[number] = bad;
                assert!(!State::read(&row).is_finite(), "{number}");
            }
        }
    }
}
