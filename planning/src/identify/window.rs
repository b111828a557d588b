//! A piece of motion, and how likely parameters make it.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Isometry3, UnitQuaternion, Vector3};
use rigidformer_core::{Physics, Posed, Role};
use rigidformer_runtime::futures::{
    BatchSimulator, ChangeError, End, FutureScene, Start, Variation,
};
use rigidformer_runtime::poses::a_step_before;

use super::setting::{Setting, Touches};
use super::settings::{IdentifyError, ModelError, PoseNoise};
use super::track::{Piece, Sample, turn_between};

/// Numbers of a unit's state: place, rotation, velocity, spin.
const STATE: usize = 12;
/// Steps ahead from whose poses the first velocities are taken.
const SLOPES: [usize; 3] = [1, 2, 4];
/// Shares of the step to a better start that are tried.
const SHARES: [f64; 4] = [1.0, 0.5, 0.2, 0.0];
/// Steps to a better start before parameters are tried.
const FIRST_FITS: usize = 2;
/// No model is nearer than this, in radii and radians.
const MODEL_FLOOR: f64 = 5e-4;
/// What a start may be off: so many deviations of a pose, and in velocity (m/s) and spin (rad/s).
const START_POSES: f64 = 5.0;
const START_VELOCITY: f64 = 1.0;
const START_SPIN: f64 = 10.0;
/// The longest part of a step in which contacts act at once, seconds (docs/CONTACT.md).
const LONGEST_PART_S: f64 = 1.0 / 144.0;
/// Of a part, by which the model is late or early at an impact: a standard deviation.
const LATE: f64 = 0.4;
/// Impacts of a unit in a window whose times are taken for unsure, at most.
const MOST_IMPACTS: usize = 6;
/// A change of velocity between steps that counts as an impact, in what gravity changes.
const KICK: f64 = 2.0;
/// Steps of free flight before a whole motion, at least and at most, and steps after it.
const LEAST_FLIGHT: usize = 3;
const MOST_FLIGHT: usize = 12;
const LEAST_RUN: usize = 12;
/// An impact as far from below the centre, in radii, is one of a corner or an edge.
const ASIDE: f64 = 0.15;
/// Squared residuals of what cannot be predicted.
const UNPREDICTED: f64 = 1e12;

/// What units of a window are made of.
pub(crate) type Materials = Vec<Physics>;

/// How a unit moves at the start of a window.
#[derive(Clone, Copy, Debug)]
struct State {
    place: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
}

impl State {
    /// Where it was seen, without velocity.
    fn lying(sample: &Sample) -> Self {
        State {
            place: sample.pose.translation.vector.cast(),
            rotation: sample.pose.rotation.cast(),
            velocity: Vector3::zeros(),
            spin: Vector3::zeros(),
        }
    }

    /// Moved by a step in each of its numbers.
    fn moved(&self, by: &[f64]) -> Self {
        let vector = |first: usize| {
            Vector3::from_fn(|axis, _| by.get(first + axis).copied().unwrap_or_default())
        };
        State {
            place: self.place + vector(0),
            rotation: UnitQuaternion::from_scaled_axis(vector(3)) * self.rotation,
            velocity: self.velocity + vector(6),
            spin: self.spin + vector(9),
        }
    }

    fn pose(&self) -> Isometry3<f32> {
        Isometry3::from_parts(self.place.cast::<f32>().into(), self.rotation.cast::<f32>())
    }

    fn poses(&self, dt_s: f32) -> [Isometry3<f32>; 2] {
        let current = self.pose();
        let (velocity, spin) = (self.velocity.cast::<f32>(), self.spin.cast::<f32>());
        [a_step_before(&current, &velocity, &spin, dt_s), current]
    }
}

/// A piece of motion in which something touches.
pub(crate) struct Window {
    setting: Arc<Setting>,
    dt_s: f32,
    steps: usize,
    /// (steps + 1, units)
    samples: Vec<Option<Sample>>,
    pub(crate) touches: Touches,
    /// (units)
    states: Vec<State>,
    /// (units) Whether an impact was seen of it or of what it touches: elsewhere restitution would only make noise of the start bounce.
    bounces: Vec<bool>,
    /// (units) Whether it hits something in any window.
    hits: Vec<bool>,
    /// (clusters)
    fits: Vec<Fit>,
    fitted: bool,
}

/// How residuals of a cluster hang on its start and on what the model may be off.
struct Fit {
    /// (residuals, unknowns), both in their deviations.
    slopes: DMatrix<f64>,
    normal: Cholesky<f64, Dyn>,
}

/// (clusters) In deviations; none where it could not be predicted.
type Residuals = Vec<Option<DVector<f64>>>;

/// One future of a window.
struct Try {
    /// (units)
    states: Vec<State>,
    materials: Materials,
}

struct Tries<'t> {
    window: &'t Window,
    tries: &'t [Try],
}

impl Variation for Tries<'_> {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let Some(tried) = self.tries.get(future) else { return Ok(()) };
        let units = self.window.setting.units.iter().zip(&tried.states).zip(&tried.materials);
        for (unit, ((recorded, state), physics)) in units.enumerate() {
            if recorded.role == Role::Free {
                let [previous, current] = state.poses(self.window.dt_s);
                scene.set_poses(unit, &previous, &current)?;
                let bounces = self.window.bounces.get(unit).is_some_and(|bounces| *bounces);
                let restitution = if bounces { physics.restitution } else { 0.0 };
                scene.set_physics(unit, Physics { restitution, ..*physics })?;
            }
        }
        Ok(())
    }

    fn steer(&self, _: usize, step: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        for (unit, recorded) in self.window.setting.units.iter().enumerate() {
            if recorded.role == Role::Driven
                && let Some(sample) = self.window.sample(step + 1, unit)
            {
                scene.drive(unit, &sample.pose)?;
            }
        }
        Ok(())
    }
}

impl Window {
    /// None where a unit was not seen at the start, or where nothing touches.
    pub(crate) fn new(setting: &Arc<Setting>, piece: Piece) -> Option<Self> {
        let units = setting.units.len();
        let starts = piece.samples.get(..units)?;
        if units == 0 || starts.iter().any(Option::is_none) {
            return None;
        }
        let touches = setting.touches(&piece.samples);
        if touches.clusters.is_empty() {
            return None;
        }
        let states = starts.iter().flatten().map(State::lying);
        let mut window = Window {
            setting: setting.clone(),
            dt_s: piece.dt_s,
            steps: piece.steps,
            states: states.collect(),
            samples: piece.samples,
            touches,
            bounces: vec![false; units],
            hits: vec![false; units],
            fits: Vec::new(),
            fitted: false,
        };
        let mut bounces = window.bounces.clone();
        for cluster in &window.touches.clusters {
            let kicked =
                |unit: &usize| (0..=window.steps).any(|step| window.kick(step, *unit).is_some());
            let any = cluster.iter().any(kicked);
            cluster.iter().for_each(|unit| bounces[*unit] = any);
        }
        window.bounces = bounces;
        Some(window)
    }

    /// Motion over these steps, whether or not anything touches, of the units of a cluster.
    fn over(
        setting: &Arc<Setting>,
        piece: &Piece,
        steps: Range<usize>,
        cluster: &[usize],
    ) -> Option<Self> {
        let units = setting.units.len();
        let samples = piece.samples.get(steps.start * units..steps.end * units)?.to_vec();
        let first = samples.get(..units)?;
        if units == 0 || first.iter().any(Option::is_none) {
            return None;
        }
        let states = first.iter().flatten().map(State::lying).collect();
        let touches = Touches { clusters: vec![cluster.to_vec()], met: Vec::new(), quiet: false };
        Some(Window {
            setting: setting.clone(),
            dt_s: piece.dt_s,
            steps: steps.len().saturating_sub(1),
            states,
            samples,
            touches,
            bounces: vec![true; units],
            hits: vec![true; units],
            fits: Vec::new(),
            fitted: false,
        })
    }

    pub(crate) fn steps(&self) -> usize {
        self.steps
    }

    pub(crate) fn setting(&self) -> &Arc<Setting> {
        &self.setting
    }

    fn sample(&self, step: usize, unit: usize) -> Option<&Sample> {
        self.samples.get(step * self.setting.units.len() + unit)?.as_ref()
    }

    /// Whether a unit moves on what it touches and hits nothing.
    pub(crate) fn slides(&self, unit: usize) -> bool {
        let touches = self.touches.clusters.iter().any(|cluster| cluster.contains(&unit));
        touches && !self.touches.quiet && !self.bounces[unit] && !self.falls(unit)
    }

    /// Whether an impact was seen of a unit or of what it touches.
    pub(crate) fn bounces(&self, unit: usize) -> bool {
        let touches = self.touches.clusters.iter().any(|cluster| cluster.contains(&unit));
        touches && self.bounces[unit]
    }

    /// Whether a unit hit something with a corner or an edge, aside of its centre.
    pub(crate) fn hits_aside(&self, unit: usize) -> bool {
        let aside = |sample: &Sample| self.setting.aside(unit, &sample.pose) > ASIDE;
        let mut kicks = (0..=self.steps).filter(|step| self.kick(*step, unit).is_some());
        self.bounces(unit) && kicks.any(|step| self.sample(step, unit).is_some_and(aside))
    }

    /// Whether a unit lies still on what it touches.
    pub(crate) fn sticks(&self, unit: usize) -> bool {
        self.touches.quiet && self.touches.clusters.iter().any(|cluster| cluster.contains(&unit))
    }

    /// Whether a unit falls freely, by its first, middle and last pose.
    fn falls(&self, unit: usize) -> bool {
        let half = self.steps / 2;
        let place =
            |step: usize| Some(self.sample(step, unit)?.pose.translation.vector.cast::<f64>());
        let (Some(first), Some(middle), Some(last)) = (place(0), place(half), place(2 * half))
        else {
            return true;
        };
        let seconds = half as f64 * f64::from(self.dt_s);
        let fall = self.setting.gravity.cast::<f64>() * (seconds * seconds);
        (last - middle * 2.0 + first).dot(&fall) > 0.5 * fall.norm_squared()
    }

    /// How far a pose may be off, and the model with it.
    fn deviations(&self, unit: usize, noise: PoseNoise) -> [f64; 2] {
        let radius = f64::from(self.setting.radii.get(unit).copied().unwrap_or_default());
        [
            f64::from(noise.position_m).hypot(MODEL_FLOOR * radius).max(1e-7),
            f64::from(noise.rotation_rad).hypot(MODEL_FLOOR),
        ]
    }

    /// Deviations of a unit's start that belong to its numbers in turn.
    fn start_deviations(&self, unit: usize) -> [f64; STATE] {
        let noise = self.sample(0, unit).map(|sample| sample.noise);
        let none = PoseNoise { position_m: 0.0, rotation_rad: 0.0 };
        let [place, turn] = self.deviations(unit, noise.unwrap_or(none)).map(|sd| sd * START_POSES);
        let mut all = [0.0; STATE];
        for (index, slot) in all.iter_mut().enumerate() {
            *slot = [place, turn, START_VELOCITY, START_SPIN][index / 3];
        }
        all
    }

    /// Steps by which slopes are measured: about what the start is unsure of in the end.
    fn start_steps(&self, unit: usize) -> [f64; STATE] {
        let mut steps = self.start_deviations(unit);
        let dt = f64::from(self.dt_s);
        let [place, turn] = [steps[0], steps[3]].map(|step| step / (2.0 * START_POSES));
        for (index, slot) in steps.iter_mut().enumerate() {
            *slot = [place, turn, 0.5 * place / dt, 0.5 * turn / dt][index / 3];
        }
        steps
    }

    /// Residuals of a cluster in deviations: positions and rotations of its members at all steps at which they were seen. None
    /// where it could not be predicted.
    fn residuals(
        &self,
        cluster: &[usize],
        tried: &Try,
        poses: &[Isometry3<f32>],
    ) -> Option<DVector<f64>> {
        let units = self.setting.units.len();
        let mut all = Vec::with_capacity(6 * cluster.len() * (self.steps + 1));
        for &unit in cluster {
            for step in 0..=self.steps {
                let Some(sample) = self.sample(step, unit) else { continue };
                let pose = match step.checked_sub(1) {
                    None => tried.states.get(unit)?.pose(),
                    Some(before) => *poses.get(before * units + unit)?,
                };
                let [place, turn] = self.deviations(unit, sample.noise);
                let away = pose.translation.vector.cast::<f64>()
                    - sample.pose.translation.vector.cast::<f64>();
                all.extend(away.iter().map(|v| v / place));
                all.extend(turn_between(&sample.pose, &pose).iter().map(|v| v / turn));
            }
        }
        let all = DVector::from_vec(all);
        all.iter().all(|v| v.is_finite()).then_some(all)
    }

    /// Residuals of each cluster in each try.
    fn predict(
        &self,
        simulator: &BatchSimulator,
        tries: &[Try],
    ) -> Result<Vec<Residuals>, IdentifyError> {
        let setting = &self.setting;
        let row = self.steps * setting.units.len();
        let mut poses = vec![Isometry3::identity(); tries.len() * row];
        let units: Vec<Posed<'_>> = setting
            .units
            .iter()
            .zip(&self.states)
            .map(|(recorded, state)| {
                let [previous, current] = match recorded.role {
                    Role::Free => state.poses(self.dt_s),
                    _ => [state.pose(); 2],
                };
                Posed { unit: recorded.as_unit(), previous, current }
            })
            .collect();
        let start = Start {
            dt_s: self.dt_s,
            units: &units,
            planes: Some(&setting.planes),
            gravity_m_s2: Some(setting.gravity),
            ..Start::default()
        };
        let variation = Tries { window: self, tries };
        let outcomes = simulator.run(&start, self.steps, &variation, &mut poses)?;
        let futures = outcomes.iter().zip(poses.chunks_exact(row.max(1))).zip(tries);
        let residuals = futures.map(|((outcome, poses), tried)| {
            let complete = matches!(outcome.end, End::Complete);
            let of = |cluster: &Vec<usize>| {
                complete.then(|| self.residuals(cluster, tried, poses)).flatten()
            };
            self.touches.clusters.iter().map(of).collect()
        });
        Ok(residuals.collect())
    }

    /// Finds the start that fits best with these materials, and how residuals hang on it.
    pub(crate) fn fit(
        &mut self,
        simulator: &BatchSimulator,
        materials: &Materials,
        error: &ModelError,
    ) -> Result<(), IdentifyError> {
        if !self.fitted {
            self.scout(simulator, std::slice::from_ref(materials))?;
            for _ in 1..FIRST_FITS {
                self.fit_once(simulator, materials, error)?;
            }
            self.fitted = true;
        }
        self.fit_once(simulator, materials, error)
    }

    /// Whether it has been fitted before.
    pub(crate) fn is_fitted(&self) -> bool {
        self.fitted
    }

    /// Starts with velocities from the first poses, or at rest: of these guesses the one that fits best with any of the materials, for
    /// each cluster. (materials, clusters) The sum of squared residuals with the guess that is best for each.
    pub(crate) fn scout(
        &mut self,
        simulator: &BatchSimulator,
        materials: &[Materials],
    ) -> Result<Vec<Vec<f64>>, IdentifyError> {
        let moving = |ahead: usize| -> Vec<State> {
            let states = self.states.iter().enumerate().map(|(unit, state)| {
                let seen = |step| Some((step, self.sample(step, unit)?));
                let Some((step, later)) = (1..=ahead).rev().find_map(seen) else { return *state };
                let seconds = step as f64 * f64::from(self.dt_s);
                let way = later.pose.translation.vector.cast::<f64>() - state.place;
                let turn = turn_between(&state.pose(), &later.pose);
                State { velocity: way / seconds, spin: turn / seconds, ..*state }
            });
            states.collect()
        };
        let still = self.states.iter().enumerate().map(|(unit, state)| {
            let seen: Vec<_> =
                (0..=self.steps).filter_map(|step| self.sample(step, unit)).collect();
            let count = seen.len().max(1) as f64;
            let places = seen.iter().map(|s| s.pose.translation.vector.cast::<f64>() - state.place);
            let turns = seen.iter().map(|sample| turn_between(&state.pose(), &sample.pose));
            let (way, turn) =
                (places.sum::<Vector3<f64>>() / count, turns.sum::<Vector3<f64>>() / count);
            let mean = State {
                place: state.place + way,
                velocity: Vector3::zeros(),
                spin: Vector3::zeros(),
                ..*state
            };
            State { rotation: UnitQuaternion::from_scaled_axis(turn) * state.rotation, ..mean }
        });
        // What lies has no velocity but that of noise.
        let slopes = if self.touches.quiet { &[][..] } else { &SLOPES[..] };
        let guesses: Vec<Vec<State>> =
            slopes.iter().map(|ahead| moving(*ahead)).chain([still.collect()]).collect();
        let tries: Vec<Try> = guesses
            .iter()
            .flat_map(|states| {
                materials
                    .iter()
                    .map(|materials| Try { states: states.clone(), materials: materials.clone() })
            })
            .collect();
        let found = self.predict(simulator, &tries)?;
        self.keep_best(&tries, &found);
        let squared = |try_at: usize, cluster: usize| {
            let residuals = found.get(try_at).and_then(|all| all.get(cluster)?.as_ref());
            residuals.map_or(UNPREDICTED, |residuals| residuals.norm_squared())
        };
        let best = |material: usize, cluster: usize| {
            let guesses = (0..guesses.len()).map(|guess| guess * materials.len() + material);
            guesses.map(|at| squared(at, cluster)).fold(f64::INFINITY, f64::min)
        };
        let clusters = self.touches.clusters.len();
        Ok((0..materials.len())
            .map(|material| (0..clusters).map(|cluster| best(material, cluster)).collect())
            .collect())
    }

    /// Takes for each cluster the states of the try that fits it best, the first of equals.
    fn keep_best(&mut self, tries: &[Try], found: &[Residuals]) {
        for (number, cluster) in self.touches.clusters.iter().enumerate() {
            let misfit = |index: usize| {
                let residuals = found.get(index)?.get(number)?.as_ref()?;
                Some(residuals.norm_squared())
            };
            let scored = (0..tries.len()).filter_map(|index| Some((misfit(index)?, index)));
            let best = scored.min_by(|a, b| a.0.total_cmp(&b.0));
            let Some(tried) = best.and_then(|(_, index)| tries.get(index)) else { continue };
            for &unit in cluster {
                if let (Some(state), Some(better)) =
                    (self.states.get_mut(unit), tried.states.get(unit))
                {
                    *state = *better;
                }
            }
        }
    }

    /// Tells which units hit something anywhere.
    pub(crate) fn mark(&mut self, hits: &[bool]) {
        self.hits.clear();
        self.hits.extend_from_slice(hits);
    }

    fn fit_once(
        &mut self,
        simulator: &BatchSimulator,
        materials: &Materials,
        error: &ModelError,
    ) -> Result<(), IdentifyError> {
        let most = self.touches.clusters.iter().map(Vec::len).max().unwrap_or_default();
        let same = || Try { states: self.states.clone(), materials: materials.clone() };
        // The same number of the same member of all clusters at once: they do not touch.
        let mut tries = vec![same()];
        for member in 0..most {
            for number in 0..STATE {
                for sign in [1.0, -1.0] {
                    let mut tried = same();
                    for &unit in self.touches.clusters.iter().filter_map(|all| all.get(member)) {
                        let mut by = [0.0; STATE];
                        by[number] = sign * self.start_steps(unit)[number];
                        tried.states[unit] = self.states[unit].moved(&by);
                    }
                    tries.push(tried);
                }
            }
            for change in CHANGES {
                for sign in [1.0, -1.0] {
                    let mut tried = same();
                    for &unit in self.touches.clusters.iter().filter_map(|all| all.get(member)) {
                        tried.materials[unit] = self.changed(change, unit, &materials[unit], sign);
                    }
                    tries.push(tried);
                }
            }
        }
        let found = self.predict(simulator, &tries)?;
        let residuals = |index: usize, number: usize| found.get(index)?.get(number)?.as_ref();
        let a_member = 2 * (STATE + CHANGES.len());
        let (mut fits, mut steps) = (Vec::new(), Vec::new());
        for (number, cluster) in self.touches.clusters.iter().enumerate() {
            let rows = self.rows(cluster);
            let impacts: Vec<DVector<f64>> = self.impacts(cluster, rows);
            let unknowns = cluster.len() * (STATE + CHANGES.len()) + impacts.len();
            let mut slopes = DMatrix::zeros(rows, unknowns);
            let mut scales = vec![0.0; unknowns];
            for (member, &unit) in cluster.iter().enumerate() {
                let steps_and_deviations: Vec<(f64, f64)> =
                    self.start_steps(unit).into_iter().zip(self.start_deviations(unit)).collect();
                for index in 0..STATE + CHANGES.len() {
                    let at = 1 + member * a_member + 2 * index;
                    let (Some(above), Some(below)) =
                        (residuals(at, number), residuals(at + 1, number))
                    else {
                        continue;
                    };
                    let own = steps_and_deviations.get(index);
                    let (apart, deviation) = match (own, CHANGES.get(index.wrapping_sub(STATE))) {
                        (Some((step, deviation)), _) => (2.0 * step, *deviation),
                        (None, None) => continue,
                        (None, Some(&change)) => {
                            let [up, down] = [1.0, -1.0].map(|sign| {
                                let physics = self.changed(change, unit, &materials[unit], sign);
                                change.measure(&physics)
                            });
                            let product = change.reference(&self.setting);
                            let physics = materials[unit];
                            let hits = (self.bounces[unit], self.hits.get(unit) == Some(&true));
                            ((up - down) * product, change.error(&physics, product, error, hits))
                        }
                    };
                    let column = member * (STATE + CHANGES.len()) + index;
                    let is_velocity = (STATE / 2..STATE).contains(&index);
                    let counts = !(is_velocity && self.touches.quiet);
                    if apart > 0.0 && counts {
                        slopes.set_column(column, &((above - below) * (deviation / apart)));
                        scales[column] = deviation;
                    }
                }
            }
            for (column, impact) in (unknowns - impacts.len()..).zip(&impacts) {
                slopes.set_column(column, impact);
            }
            let mut normal = slopes.tr_mul(&slopes);
            for index in 0..unknowns {
                normal[(index, index)] += 1.0;
            }
            let Some(normal) = Cholesky::new(normal) else {
                // Slopes that are no numbers say nothing.
                let normal = Cholesky::new(DMatrix::identity(unknowns, unknowns));
                let slopes = DMatrix::zeros(rows, unknowns);
                fits.extend(normal.map(|normal| Fit { slopes, normal }));
                steps.push(vec![0.0; unknowns]);
                continue;
            };
            let step = residuals(0, number).map(|now| normal.solve(&slopes.tr_mul(now)));
            let step = step.map_or_else(
                || vec![0.0; unknowns],
                |step| step.iter().zip(&scales).map(|(step, scale)| -step * scale).collect(),
            );
            steps.push(step);
            fits.push(Fit { slopes, normal });
        }
        let tries: Vec<Try> = SHARES
            .into_iter()
            .map(|share| {
                let mut tried = same();
                for (cluster, step) in self.touches.clusters.iter().zip(&steps) {
                    let steps = step.chunks_exact(STATE + CHANGES.len());
                    for (&unit, step) in cluster.iter().zip(steps) {
                        let by: Vec<f64> = step.iter().take(STATE).map(|by| by * share).collect();
                        tried.states[unit] = self.states[unit].moved(&by);
                    }
                }
                tried
            })
            .collect();
        let found = self.predict(simulator, &tries)?;
        self.keep_best(&tries, &found);
        self.fits = fits;
        Ok(())
    }

    /// What residuals of a cluster become where the model is late at an impact by a usual time, one column an impact of a unit. The
    /// model lets contacts act at the ends of the parts of its steps alone.
    fn impacts(&self, cluster: &[usize], rows: usize) -> Vec<DVector<f64>> {
        let dt = f64::from(self.dt_s);
        let late_s = LATE * dt / (dt / LONGEST_PART_S).ceil().max(1.0);
        let mut columns = Vec::new();
        let mut first_row = 0;
        for &unit in cluster {
            let kicks: Vec<Option<[Vector3<f64>; 2]>> =
                (0..=self.steps).map(|step| self.kick(step, unit)).collect();
            let mut events: Vec<(usize, usize)> = Vec::new();
            for step in (0..=self.steps).filter(|step| kicks[*step].is_some()) {
                match events.last_mut() {
                    Some((_, end)) if *end == step => *end = step + 1,
                    _ => events.push((step, step + 1)),
                }
            }
            for (start, end) in events.into_iter().take(MOST_IMPACTS) {
                let mut column = DVector::zeros(rows);
                let (mut row, mut offset) = (first_row, [Vector3::zeros(); 2]);
                for step in 0..=self.steps {
                    // What the velocity changed by until a step moves the unit from the next one on.
                    if let Some(Some([velocity, spin])) =
                        step.checked_sub(1).filter(|s| (start..end).contains(s)).map(|s| kicks[s])
                    {
                        offset = [offset[0] + velocity * late_s, offset[1] + spin * late_s];
                    }
                    let Some(sample) = self.sample(step, unit) else { continue };
                    let [place, turn] = self.deviations(unit, sample.noise);
                    for axis in 0..3 {
                        column[row + axis] = offset[0][axis] / place;
                        column[row + 3 + axis] = offset[1][axis] / turn;
                    }
                    row += 6;
                }
                columns.push(column);
            }
            first_row += self.rows(&[unit]);
        }
        columns
    }

    /// By how much velocity and spin of a unit change about a step, where that is more than gravity and noise make.
    fn kick(&self, step: usize, unit: usize) -> Option<[Vector3<f64>; 2]> {
        let dt = f64::from(self.dt_s);
        let [before, here, after] =
            [step.checked_sub(1)?, step, step + 1].map(|step| self.sample(step, unit));
        let (before, here, after) = (before?, here?, after?);
        let place = |sample: &Sample| sample.pose.translation.vector.cast::<f64>();
        let gravity = self.setting.gravity.cast::<f64>();
        let velocity = (place(after) - place(here) * 2.0 + place(before)) / dt - gravity * dt;
        let spin =
            (turn_between(&here.pose, &after.pose) - turn_between(&before.pose, &here.pose)) / dt;
        let unsure = 3.0 * 6.0_f64.sqrt() * f64::from(here.noise.position_m) / dt;
        (velocity.norm() > KICK * gravity.norm() * dt + unsure).then_some([velocity, spin])
    }

    /// Residuals of a cluster.
    pub(crate) fn rows(&self, cluster: &[usize]) -> usize {
        let seen = |unit: &usize| {
            (0..=self.steps).filter(|step| self.sample(*step, *unit).is_some()).count()
        };
        6 * cluster.iter().map(seen).sum::<usize>()
    }

    /// Residuals that a cluster has beyond what its start can make up for.
    pub(crate) fn freedom(&self, cluster: &[usize]) -> f64 {
        self.rows(cluster).saturating_sub(STATE * cluster.len()).max(1) as f64
    }

    /// (materials, clusters) The sum of squared residuals with each materials, whatever the start was and the model is off; in
    /// deviations.
    pub(crate) fn misfits(
        &self,
        simulator: &BatchSimulator,
        materials: Vec<Materials>,
    ) -> Result<Vec<Vec<f64>>, IdentifyError> {
        let tries: Vec<Try> = materials
            .into_iter()
            .map(|materials| Try { states: self.states.clone(), materials })
            .collect();
        let found = self.predict(simulator, &tries)?;
        let misfit = |residuals: &Option<DVector<f64>>, number: usize| {
            let (Some(residuals), Some(fit)) = (residuals, self.fits.get(number)) else {
                return UNPREDICTED;
            };
            if residuals.len() != fit.slopes.nrows() {
                return UNPREDICTED;
            }
            let along = fit.slopes.tr_mul(residuals);
            let explained = along.dot(&fit.normal.solve(&along));
            (residuals.norm_squared() - explained).max(0.0)
        };
        let of_try = |clusters: &Vec<Option<DVector<f64>>>| {
            clusters.iter().enumerate().map(|(number, found)| misfit(found, number)).collect()
        };
        Ok(found.iter().map(of_try).collect())
    }

    /// The physics of a unit a step further in one of its numbers.
    fn changed(&self, change: Change, unit: usize, physics: &Physics, sign: f32) -> Physics {
        let reference = change.reference(&self.setting).max(1e-6) as f32;
        let mut physics = *physics;
        match change {
            Change::Friction => {
                let step = (0.05 * physics.friction).max(0.01 / reference);
                physics.friction = (physics.friction + sign * step).clamp(0.0, 1e3);
            }
            Change::Restitution => {
                let step = 0.03 / reference;
                physics.restitution = (physics.restitution + sign * step).clamp(0.0, 1e3);
            }
            Change::Mass => {
                let alone = self.touches.met.iter().all(|(a, b)| *a != unit && *b != unit);
                let step = if alone { 1.0 } else { (0.1 * sign).exp() };
                physics.mass_kg = (physics.mass_kg * step).clamp(1e-9, 1e9);
            }
        }
        physics
    }
}

/// A whole motion of one unit, from free flight through impacts to the end: how far it is predicted aside.
///
/// Its start is fitted to the flight alone, where the model is exact. Impacts that the model has otherwise cannot be made up for by
/// another start then, as they can in a piece.
pub(crate) struct Whole {
    pub(crate) unit: usize,
    flight: Window,
    run: Window,
    ready: bool,
}

impl Whole {
    /// None where there is more than one unit that moves, no impact, or no flight before the first one.
    pub(crate) fn new(setting: &Arc<Setting>, piece: &Piece) -> Option<Self> {
        let mut free =
            (0..setting.units.len()).filter(|unit| setting.units[*unit].role == Role::Free);
        let (unit, None) = (free.next()?, free.next()) else { return None };
        if setting.units.iter().any(|unit| unit.role == Role::Driven) {
            return None;
        }
        let all = Window::over(setting, piece, 0..piece.steps + 1, &[unit])?;
        let first = (0..=all.steps).find(|step| all.kick(*step, unit).is_some())?;
        let start = first.checked_sub(LEAST_FLIGHT + 1)?.saturating_sub(MOST_FLIGHT - LEAST_FLIGHT);
        let flight = Window::over(setting, piece, start..first, &[unit])?;
        let run = Window::over(setting, piece, start..piece.steps + 1, &[unit])?;
        if !flight.falls(unit) || run.steps < flight.steps + LEAST_RUN {
            return None;
        }
        Some(Whole { unit, flight, run, ready: false })
    }

    pub(crate) fn setting(&self) -> &Arc<Setting> {
        &self.run.setting
    }

    /// (materials) The mean square of the way from where the unit was seen after its first impact to where it is predicted, in radii.
    pub(crate) fn aside(
        &mut self,
        simulator: &BatchSimulator,
        materials: Vec<Materials>,
    ) -> Result<Vec<f64>, IdentifyError> {
        if !self.ready {
            if let Some(any) = materials.first() {
                for _ in 0..FIRST_FITS {
                    self.flight.fit(simulator, any, &ModelError::NONE)?;
                }
            }
            self.run.states = self.flight.states.clone();
            self.ready = true;
        }
        let tries: Vec<Try> = materials
            .into_iter()
            .map(|materials| Try { states: self.run.states.clone(), materials })
            .collect();
        let found = self.run.predict(simulator, &tries)?;
        let radius = f64::from(self.run.setting.radii.get(self.unit).copied().unwrap_or(1.0));
        let aside = |residuals: &DVector<f64>| {
            let seen = (0..=self.run.steps)
                .filter_map(|step| Some((step, self.run.sample(step, self.unit)?)));
            let (mut sum, mut count) = (0.0, 0.0);
            for ((step, sample), of) in seen.zip(residuals.as_slice().chunks_exact(6)) {
                if step > self.flight.steps {
                    let [place, _] = self.run.deviations(self.unit, sample.noise);
                    let way: f64 = of.iter().take(3).map(|v| v * v).sum();
                    sum += way * (place / radius).powi(2);
                    count += 1.0;
                }
            }
            sum / f64::max(count, 1.0)
        };
        let of_try = |clusters: &Residuals| {
            clusters.first().and_then(Option::as_ref).map_or(UNPREDICTED, aside)
        };
        Ok(found.iter().map(of_try).collect())
    }
}

/// A number of a unit's physics.
#[derive(Clone, Copy)]
enum Change {
    Friction,
    Restitution,
    Mass,
}

const CHANGES: [Change; 3] = [Change::Friction, Change::Restitution, Change::Mass];

impl Change {
    /// As a number in which slopes are measured.
    fn measure(self, physics: &Physics) -> f64 {
        match self {
            Change::Friction => f64::from(physics.friction),
            Change::Restitution => f64::from(physics.restitution),
            Change::Mass => f64::from(physics.mass_kg).ln(),
        }
    }

    /// What the number is multiplied with in a contact with a plane.
    fn reference(self, setting: &Setting) -> f64 {
        let (friction, restitution) = setting.reference();
        match self {
            Change::Friction => f64::from(friction),
            Change::Restitution => f64::from(restitution),
            Change::Mass => 1.0,
        }
    }

    /// What the model is off, in that number times the reference.
    fn error(
        self,
        physics: &Physics,
        reference: f64,
        error: &ModelError,
        hits: (bool, bool),
    ) -> f64 {
        match self {
            Change::Friction => {
                let part = match hits {
                    (true, _) => error.friction_at_impacts,
                    (false, true) => error.friction_of_hits,
                    (false, false) => error.friction,
                };
                f64::from(part) * f64::from(physics.friction) * reference
            }
            Change::Restitution => f64::from(error.restitution),
            Change::Mass => f64::from(error.mass),
        }
    }
}
