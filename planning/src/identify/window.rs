//! The likelihood of parameters in a window of motion.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Isometry3, UnitQuaternion, Vector3};
use rigidformer_core::{Physics, Posed, Role};
use rigidformer_runtime::futures::{
    BatchSimulator, ChangeError, End, FutureScene, Start, Variation,
};
use rigidformer_runtime::poses::a_step_before;

use super::settings::{IdentifyError, ModelError, PoseNoise};
use super::static_scene::{Contacts, StaticScene};
use super::track::{Sample, Segment, turn_between};

/// Numbers of a unit's state: position, rotation, velocity, spin.
// Rotation counts as a vector of three, so that the fit has no constraint.
const STATE: usize = 12;
/// Steps over which first velocities are averaged.
// Long ones suppress noise, and short ones end before an impact: the best fit decides.
const VELOCITY_BASELINES: [usize; 3] = [1, 2, 4];
/// Fractions of a Gauss-Newton step that are tried.
// The full step overshoots where contacts make the residuals nonlinear.
const STEP_FRACTIONS: [f64; 4] = [1.0, 0.5, 0.2, 0.0];
/// Gauss-Newton steps before the first particles are weighed.
const INITIAL_FITS: usize = 2;
/// Least deviation of the model from the motion, in radii and radians.
// Without it, noiseless poses make residuals of the model's own error count as impossible.
const MODEL_FLOOR: f64 = 5e-4;
/// Prior deviations of a window's start: of the pose in its own deviations, of the velocity in m/s, of the spin in rad/s.
// Wide priors: the poses of the window determine the start, and the prior only keeps the fit regular.
const START_POSES: f64 = 5.0;
const START_VELOCITY: f64 = 1.0;
const START_SPIN: f64 = 10.0;
/// Longest substep of the model's contact solver, seconds (docs/CONTACT.md).
const MAX_SUBSTEP_S: f64 = 1.0 / 144.0;
/// Standard deviation of an impact's time, in substeps.
// The solver applies contacts at the ends of substeps alone, so impacts come early or late.
const IMPACT_TIME_DEVIATION: f64 = 0.4;
/// Impacts of a unit in a window whose times are unknowns, at most.
// Each adds an unknown to the normal equations.
const MAX_IMPACTS: usize = 6;
/// Change of velocity over a step that counts as an impact, in gravity's.
// Below it, sliding and resting contacts change velocities too.
const MIN_VELOCITY_JUMP: f64 = 2.0;
/// Steps of free flight before a whole motion, at least and at most, and least steps after it.
// The flight fits the start. A longer one adds no accuracy.
const MIN_FLIGHT: usize = 3;
const MAX_FLIGHT: usize = 12;
const MIN_RUN: usize = 12;
/// Horizontal distance from the centre, in radii, from which an impact is one of a corner or an edge.
// The model's restitution at corners and edges has a larger error than at faces.
const MIN_OFF_CENTRE: f64 = 0.15;
/// Squared residuals of a failed prediction.
// Finite, so that a sum over windows still compares particles.
const MISFIT_OF_FAILURE: f64 = 1e12;

/// (units) Physics of a window's units.
pub(crate) type Materials = Vec<Physics>;

/// State of a unit at the start of a window.
#[derive(Clone, Copy, Debug)]
struct State {
    position: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
    velocity: Vector3<f64>,
    spin: Vector3<f64>,
}

impl State {
    /// At an observed pose, without velocity.
    fn without_velocity(sample: &Sample) -> Self {
        State {
            position: sample.pose.translation.vector.cast(),
            rotation: sample.pose.rotation.cast(),
            velocity: Vector3::zeros(),
            spin: Vector3::zeros(),
        }
    }

    /// The state after an increment of its numbers.
    fn moved(&self, by: &[f64]) -> Self {
        let vector = |first: usize| {
            Vector3::from_fn(|axis, _| by.get(first + axis).copied().unwrap_or_default())
        };
        State {
            position: self.position + vector(0),
            rotation: UnitQuaternion::from_scaled_axis(vector(3)) * self.rotation,
            velocity: self.velocity + vector(6),
            spin: self.spin + vector(9),
        }
    }

    fn pose(&self) -> Isometry3<f32> {
        Isometry3::from_parts(self.position.cast::<f32>().into(), self.rotation.cast::<f32>())
    }

    fn poses(&self, dt_s: f32) -> [Isometry3<f32>; 2] {
        let current = self.pose();
        let (velocity, spin) = (self.velocity.cast::<f32>(), self.spin.cast::<f32>());
        [a_step_before(&current, &velocity, &spin, dt_s), current]
    }
}

/// A segment of motion with contact.
pub(crate) struct Window {
    scene: Arc<StaticScene>,
    dt_s: f32,
    steps: usize,
    /// (steps + 1, units)
    samples: Vec<Option<Sample>>,
    pub(crate) contacts: Contacts,
    /// (units)
    states: Vec<State>,
    /// (units) Whether a unit, or one in contact with it, has an impact. Without one, restitution only amplifies noise of the start.
    has_impact: Vec<bool>,
    /// (units) Whether a unit has an impact in any window.
    impacting: Vec<bool>,
    /// (clusters)
    fits: Vec<Fit>,
    fitted: bool,
}

/// Linearisation of a cluster's residuals in its start and in the model's errors.
struct Fit {
    /// (residuals, unknowns), both in standard deviations.
    jacobian: DMatrix<f64>,
    normal: Cholesky<f64, Dyn>,
}

/// (clusters) In standard deviations; none where the prediction failed.
type Residuals = Vec<Option<DVector<f64>>>;

/// One future of a window.
struct Candidate {
    /// (units)
    states: Vec<State>,
    materials: Materials,
}

struct Candidates<'t> {
    window: &'t Window,
    candidates: &'t [Candidate],
}

impl Variation for Candidates<'_> {
    fn begin(&self, future: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        let Some(candidate) = self.candidates.get(future) else { return Ok(()) };
        let units = self.window.scene.units.iter().zip(&candidate.states).zip(&candidate.materials);
        for (unit, ((recorded, state), physics)) in units.enumerate() {
            // Poses of driven and fixed units are given, so they are no unknowns.
            if recorded.role == Role::Free {
                let [previous, current] = state.poses(self.window.dt_s);
                scene.set_poses(unit, &previous, &current)?;
                let has_impact =
                    self.window.has_impact.get(unit).is_some_and(|has_impact| *has_impact);
                let restitution = if has_impact { physics.restitution } else { 0.0 };
                scene.set_physics(unit, Physics { restitution, ..*physics })?;
            }
        }
        Ok(())
    }

    fn steer(&self, _: usize, step: usize, scene: &mut FutureScene<'_>) -> Result<(), ChangeError> {
        for (unit, recorded) in self.window.scene.units.iter().enumerate() {
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
    /// None where the start lacks a pose of a unit, or where nothing is in contact.
    pub(crate) fn new(scene: &Arc<StaticScene>, segment: Segment) -> Option<Self> {
        let units = scene.units.len();
        let starts = segment.samples.get(..units)?;
        // The model cannot predict a scene without the poses of all units.
        if units == 0 || starts.iter().any(Option::is_none) {
            return None;
        }
        let contacts = scene.contacts(&segment.samples);
        // Free flight does not depend on friction, restitution or mass.
        if contacts.clusters.is_empty() {
            return None;
        }
        let states = starts.iter().flatten().map(State::without_velocity);
        let mut window = Window {
            scene: scene.clone(),
            dt_s: segment.dt_s,
            steps: segment.steps,
            states: states.collect(),
            samples: segment.samples,
            contacts,
            has_impact: vec![false; units],
            impacting: vec![false; units],
            fits: Vec::new(),
            fitted: false,
        };
        let mut has_impact = window.has_impact.clone();
        for cluster in &window.contacts.clusters {
            let jumped = |unit: &usize| {
                (0..=window.steps).any(|step| window.velocity_jump(step, *unit).is_some())
            };
            let is_jumping = cluster.iter().any(jumped);
            cluster.iter().for_each(|unit| has_impact[*unit] = is_jumping);
        }
        window.has_impact = has_impact;
        Some(window)
    }

    /// Motion of a cluster over these steps, with contact or without.
    fn over(
        scene: &Arc<StaticScene>,
        segment: &Segment,
        steps: Range<usize>,
        cluster: &[usize],
    ) -> Option<Self> {
        let units = scene.units.len();
        let samples = segment.samples.get(steps.start * units..steps.end * units)?.to_vec();
        let first = samples.get(..units)?;
        if units == 0 || first.iter().any(Option::is_none) {
            return None;
        }
        let states = first.iter().flatten().map(State::without_velocity).collect();
        let contacts =
            Contacts { clusters: vec![cluster.to_vec()], pairs: Vec::new(), at_rest: false };
        Some(Window {
            scene: scene.clone(),
            dt_s: segment.dt_s,
            steps: steps.len().saturating_sub(1),
            states,
            samples,
            contacts,
            has_impact: vec![true; units],
            impacting: vec![true; units],
            fits: Vec::new(),
            fitted: false,
        })
    }

    pub(crate) fn steps(&self) -> usize {
        self.steps
    }

    pub(crate) fn scene(&self) -> &Arc<StaticScene> {
        &self.scene
    }

    fn sample(&self, step: usize, unit: usize) -> Option<&Sample> {
        self.samples.get(step * self.scene.units.len() + unit)?.as_ref()
    }

    /// Whether a unit slides: it moves in contact, without an impact.
    pub(crate) fn is_sliding(&self, unit: usize) -> bool {
        let in_contact = self.contacts.clusters.iter().any(|cluster| cluster.contains(&unit));
        in_contact
            && !self.contacts.at_rest
            && !self.has_impact[unit]
            && !self.is_in_free_fall(unit)
    }

    /// Whether a unit, or one in contact with it, has an impact.
    pub(crate) fn has_impact(&self, unit: usize) -> bool {
        let in_contact = self.contacts.clusters.iter().any(|cluster| cluster.contains(&unit));
        in_contact && self.has_impact[unit]
    }

    /// Whether a unit has an impact of a corner or an edge, off its centre.
    pub(crate) fn impacts_off_centre(&self, unit: usize) -> bool {
        let is_off_centre =
            |sample: &Sample| self.scene.contact_offset(unit, &sample.pose) > MIN_OFF_CENTRE;
        let mut jumps = (0..=self.steps).filter(|step| self.velocity_jump(*step, unit).is_some());
        self.has_impact(unit)
            && jumps.any(|step| self.sample(step, unit).is_some_and(is_off_centre))
    }

    /// Whether a unit is at rest in contact.
    pub(crate) fn is_at_rest(&self, unit: usize) -> bool {
        self.contacts.at_rest
            && self.contacts.clusters.iter().any(|cluster| cluster.contains(&unit))
    }

    /// Whether a unit is in free fall, by its first, middle and last pose.
    fn is_in_free_fall(&self, unit: usize) -> bool {
        // The second difference over half of the window has the least noise, and contact lowers it below half of gravity's.
        let half = self.steps / 2;
        let position =
            |step: usize| Some(self.sample(step, unit)?.pose.translation.vector.cast::<f64>());
        let (Some(first), Some(middle), Some(last)) =
            (position(0), position(half), position(2 * half))
        else {
            return true;
        };
        let seconds = half as f64 * f64::from(self.dt_s);
        let fall = self.scene.gravity.cast::<f64>() * (seconds * seconds);
        (last - middle * 2.0 + first).dot(&fall) > 0.5 * fall.norm_squared()
    }

    /// Standard deviations of position and rotation: of the pose and of the model.
    fn deviations(&self, unit: usize, noise: PoseNoise) -> [f64; 2] {
        let radius = f64::from(self.scene.radii.get(unit).copied().unwrap_or_default());
        [
            f64::from(noise.position_m).hypot(MODEL_FLOOR * radius).max(1e-7),
            f64::from(noise.rotation_rad).hypot(MODEL_FLOOR),
        ]
    }

    /// Prior deviations of the numbers of a unit's start.
    fn start_deviations(&self, unit: usize) -> [f64; STATE] {
        let noise = self.sample(0, unit).map(|sample| sample.noise);
        let none = PoseNoise { position_m: 0.0, rotation_rad: 0.0 };
        let [position, turn] =
            self.deviations(unit, noise.unwrap_or(none)).map(|sd| sd * START_POSES);
        let mut all = [0.0; STATE];
        for (index, slot) in all.iter_mut().enumerate() {
            *slot = [position, turn, START_VELOCITY, START_SPIN][index / 3];
        }
        all
    }

    /// Increments of the finite differences: about the posterior deviations of the start.
    fn start_steps(&self, unit: usize) -> [f64; STATE] {
        let mut steps = self.start_deviations(unit);
        let dt = f64::from(self.dt_s);
        let [position, turn] = [steps[0], steps[3]].map(|step| step / (2.0 * START_POSES));
        for (index, slot) in steps.iter_mut().enumerate() {
            *slot = [position, turn, 0.5 * position / dt, 0.5 * turn / dt][index / 3];
        }
        steps
    }

    /// Residuals of a cluster in standard deviations: positions and rotations of its members at all observed steps. None where the
    /// prediction failed.
    fn residuals(
        &self,
        cluster: &[usize],
        candidate: &Candidate,
        poses: &[Isometry3<f32>],
    ) -> Option<DVector<f64>> {
        let units = self.scene.units.len();
        let mut all = Vec::with_capacity(6 * cluster.len() * (self.steps + 1));
        for &unit in cluster {
            for step in 0..=self.steps {
                let Some(sample) = self.sample(step, unit) else { continue };
                let pose = match step.checked_sub(1) {
                    None => candidate.states.get(unit)?.pose(),
                    Some(before) => *poses.get(before * units + unit)?,
                };
                let [position, turn] = self.deviations(unit, sample.noise);
                let away = pose.translation.vector.cast::<f64>()
                    - sample.pose.translation.vector.cast::<f64>();
                all.extend(away.iter().map(|v| v / position));
                all.extend(turn_between(&sample.pose, &pose).iter().map(|v| v / turn));
            }
        }
        let all = DVector::from_vec(all);
        all.iter().all(|v| v.is_finite()).then_some(all)
    }

    /// Residuals of each cluster under each candidate.
    fn predict(
        &self,
        simulator: &BatchSimulator,
        candidates: &[Candidate],
    ) -> Result<Vec<Residuals>, IdentifyError> {
        let scene = &self.scene;
        let row = self.steps * scene.units.len();
        let mut poses = vec![Isometry3::identity(); candidates.len() * row];
        let units: Vec<Posed<'_>> = scene
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
            planes: Some(&scene.planes),
            plane_compliance: &scene.plane_compliance,
            contact_law: Some(scene.contact_law),
            height_field: scene.height_field.as_ref(),
            gravity_m_s2: Some(scene.gravity),
            ..Start::default()
        };
        let variation = Candidates { window: self, candidates };
        let outcomes = simulator.run(&start, self.steps, &variation, &mut poses)?;
        let futures = outcomes.iter().zip(poses.chunks_exact(row.max(1))).zip(candidates);
        let residuals = futures.map(|((outcome, poses), candidate)| {
            let complete = matches!(outcome.end, End::Complete);
            let of = |cluster: &Vec<usize>| {
                complete.then(|| self.residuals(cluster, candidate, poses)).flatten()
            };
            self.contacts.clusters.iter().map(of).collect()
        });
        Ok(residuals.collect())
    }

    /// Fits the start with these materials, and linearises the residuals about it.
    pub(crate) fn fit(
        &mut self,
        simulator: &BatchSimulator,
        materials: &Materials,
        error: &ModelError,
    ) -> Result<(), IdentifyError> {
        // The first linearisation needs a start near the motion; later rounds only refine it.
        if !self.fitted {
            self.initialise(simulator, std::slice::from_ref(materials))?;
            for _ in 1..INITIAL_FITS {
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

    /// Chooses each cluster's first start among velocities over several baselines, and rest. (materials, clusters) The sum of squared residuals
    /// with the best start for each.
    pub(crate) fn initialise(
        &mut self,
        simulator: &BatchSimulator,
        materials: &[Materials],
    ) -> Result<Vec<Vec<f64>>, IdentifyError> {
        let moving = |ahead: usize| -> Vec<State> {
            let states = self.states.iter().enumerate().map(|(unit, state)| {
                let observed = |step| Some((step, self.sample(step, unit)?));
                let Some((step, later)) = (1..=ahead).rev().find_map(observed) else {
                    return *state;
                };
                let seconds = step as f64 * f64::from(self.dt_s);
                let displacement = later.pose.translation.vector.cast::<f64>() - state.position;
                let turn = turn_between(&state.pose(), &later.pose);
                State { velocity: displacement / seconds, spin: turn / seconds, ..*state }
            });
            states.collect()
        };
        let at_mean = self.states.iter().enumerate().map(|(unit, state)| {
            let samples: Vec<_> =
                (0..=self.steps).filter_map(|step| self.sample(step, unit)).collect();
            let count = samples.len().max(1) as f64;
            let offsets =
                samples.iter().map(|s| s.pose.translation.vector.cast::<f64>() - state.position);
            let turns = samples.iter().map(|sample| turn_between(&state.pose(), &sample.pose));
            let (displacement, turn) =
                (offsets.sum::<Vector3<f64>>() / count, turns.sum::<Vector3<f64>>() / count);
            let mean = State {
                position: state.position + displacement,
                velocity: Vector3::zeros(),
                spin: Vector3::zeros(),
                ..*state
            };
            State { rotation: UnitQuaternion::from_scaled_axis(turn) * state.rotation, ..mean }
        });
        // Velocities of a unit at rest are noise.
        let baselines = if self.contacts.at_rest { &[][..] } else { &VELOCITY_BASELINES[..] };
        let guesses: Vec<Vec<State>> =
            baselines.iter().map(|ahead| moving(*ahead)).chain([at_mean.collect()]).collect();
        let candidates: Vec<Candidate> = guesses
            .iter()
            .flat_map(|states| {
                materials.iter().map(|materials| Candidate {
                    states: states.clone(),
                    materials: materials.clone(),
                })
            })
            .collect();
        let found = self.predict(simulator, &candidates)?;
        self.keep_best(&candidates, &found);
        let squared = |candidate_index: usize, cluster: usize| {
            let residuals = found.get(candidate_index).and_then(|all| all.get(cluster)?.as_ref());
            residuals.map_or(MISFIT_OF_FAILURE, |residuals| residuals.norm_squared())
        };
        let best = |material: usize, cluster: usize| {
            let guesses = (0..guesses.len()).map(|guess| guess * materials.len() + material);
            guesses.map(|at| squared(at, cluster)).fold(f64::INFINITY, f64::min)
        };
        let clusters = self.contacts.clusters.len();
        Ok((0..materials.len())
            .map(|material| (0..clusters).map(|cluster| best(material, cluster)).collect())
            .collect())
    }

    /// Takes the states of the candidate that fits best, for each cluster; the first of equals.
    fn keep_best(&mut self, candidates: &[Candidate], found: &[Residuals]) {
        for (number, cluster) in self.contacts.clusters.iter().enumerate() {
            let squared_misfit = |index: usize| {
                let residuals = found.get(index)?.get(number)?.as_ref()?;
                Some(residuals.norm_squared())
            };
            let scored =
                (0..candidates.len()).filter_map(|index| Some((squared_misfit(index)?, index)));
            let best = scored.min_by(|a, b| a.0.total_cmp(&b.0));
            let Some(candidate) = best.and_then(|(_, index)| candidates.get(index)) else {
                continue;
            };
            for &unit in cluster {
                if let (Some(state), Some(better)) =
                    (self.states.get_mut(unit), candidate.states.get(unit))
                {
                    *state = *better;
                }
            }
        }
    }

    /// Sets which units have an impact in any window.
    pub(crate) fn set_impacting(&mut self, impacting: &[bool]) {
        self.impacting.clear();
        self.impacting.extend_from_slice(impacting);
    }

    fn fit_once(
        &mut self,
        simulator: &BatchSimulator,
        materials: &Materials,
        error: &ModelError,
    ) -> Result<(), IdentifyError> {
        let members = self.contacts.clusters.iter().map(Vec::len).max().unwrap_or_default();
        let same = || Candidate { states: self.states.clone(), materials: materials.clone() };
        // Clusters are not in contact with each other, so one prediction perturbs a member of each.
        let mut candidates = vec![same()];
        for member in 0..members {
            for number in 0..STATE {
                for sign in [1.0, -1.0] {
                    let mut candidate = same();
                    for &unit in self.contacts.clusters.iter().filter_map(|all| all.get(member)) {
                        let mut by = [0.0; STATE];
                        by[number] = sign * self.start_steps(unit)[number];
                        candidate.states[unit] = self.states[unit].moved(&by);
                    }
                    candidates.push(candidate);
                }
            }
            for coefficient in COEFFICIENTS {
                for sign in [1.0, -1.0] {
                    let mut candidate = same();
                    for &unit in self.contacts.clusters.iter().filter_map(|all| all.get(member)) {
                        candidate.materials[unit] =
                            self.perturbed(coefficient, unit, &materials[unit], sign);
                    }
                    candidates.push(candidate);
                }
            }
        }
        let found = self.predict(simulator, &candidates)?;
        let residuals = |index: usize, number: usize| found.get(index)?.get(number)?.as_ref();
        let columns_of_member = 2 * (STATE + COEFFICIENTS.len());
        let (mut fits, mut steps) = (Vec::new(), Vec::new());
        for (number, cluster) in self.contacts.clusters.iter().enumerate() {
            let rows = self.rows(cluster);
            let impacts: Vec<DVector<f64>> = self.impacts(cluster, rows);
            let unknowns = cluster.len() * (STATE + COEFFICIENTS.len()) + impacts.len();
            let mut jacobian = DMatrix::zeros(rows, unknowns);
            let mut scales = vec![0.0; unknowns];
            for (member, &unit) in cluster.iter().enumerate() {
                let steps_and_deviations: Vec<(f64, f64)> =
                    self.start_steps(unit).into_iter().zip(self.start_deviations(unit)).collect();
                for index in 0..STATE + COEFFICIENTS.len() {
                    let at = 1 + member * columns_of_member + 2 * index;
                    let (Some(above), Some(below)) =
                        (residuals(at, number), residuals(at + 1, number))
                    else {
                        continue;
                    };
                    let deviations = steps_and_deviations.get(index);
                    let (apart, deviation) =
                        match (deviations, COEFFICIENTS.get(index.wrapping_sub(STATE))) {
                            (Some((step, deviation)), _) => (2.0 * step, *deviation),
                            (None, None) => continue,
                            (None, Some(&coefficient)) => {
                                let [up, down] = [1.0, -1.0].map(|sign| {
                                    let physics =
                                        self.perturbed(coefficient, unit, &materials[unit], sign);
                                    coefficient.value(&physics)
                                });
                                let product = coefficient.reference(&self.scene);
                                let physics = materials[unit];
                                let impacting = (
                                    self.has_impact[unit],
                                    self.impacting.get(unit) == Some(&true),
                                );
                                (
                                    (up - down) * product,
                                    coefficient.error(&physics, product, error, impacting),
                                )
                            }
                        };
                    let column = member * (STATE + COEFFICIENTS.len()) + index;
                    let is_velocity = (STATE / 2..STATE).contains(&index);
                    // Velocities of a unit at rest are not unknowns.
                    let counts = !(is_velocity && self.contacts.at_rest);
                    if apart > 0.0 && counts {
                        jacobian.set_column(column, &((above - below) * (deviation / apart)));
                        scales[column] = deviation;
                    }
                }
            }
            for (column, impact) in (unknowns - impacts.len()..).zip(&impacts) {
                jacobian.set_column(column, impact);
            }
            let mut normal = jacobian.tr_mul(&jacobian);
            // Unknowns are in prior deviations, so the prior's information is the identity.
            for index in 0..unknowns {
                normal[(index, index)] += 1.0;
            }
            let Some(normal) = Cholesky::new(normal) else {
                // A Jacobian that is not finite carries no information.
                let normal = Cholesky::new(DMatrix::identity(unknowns, unknowns));
                let jacobian = DMatrix::zeros(rows, unknowns);
                fits.extend(normal.map(|normal| Fit { jacobian, normal }));
                steps.push(vec![0.0; unknowns]);
                continue;
            };
            let step = residuals(0, number).map(|now| normal.solve(&jacobian.tr_mul(now)));
            let step = step.map_or_else(
                || vec![0.0; unknowns],
                |step| step.iter().zip(&scales).map(|(step, scale)| -step * scale).collect(),
            );
            steps.push(step);
            fits.push(Fit { jacobian, normal });
        }
        let candidates: Vec<Candidate> = STEP_FRACTIONS
            .into_iter()
            .map(|share| {
                let mut candidate = same();
                for (cluster, step) in self.contacts.clusters.iter().zip(&steps) {
                    let steps = step.chunks_exact(STATE + COEFFICIENTS.len());
                    for (&unit, step) in cluster.iter().zip(steps) {
                        let by: Vec<f64> = step.iter().take(STATE).map(|by| by * share).collect();
                        candidate.states[unit] = self.states[unit].moved(&by);
                    }
                }
                candidate
            })
            .collect();
        let found = self.predict(simulator, &candidates)?;
        self.keep_best(&candidates, &found);
        self.fits = fits;
        Ok(())
    }

    /// Columns of the Jacobian for the times of impacts, one for each impact of a unit: the residuals where the model is late by a standard
    /// deviation. The model applies contacts at the ends of substeps alone.
    fn impacts(&self, cluster: &[usize], rows: usize) -> Vec<DVector<f64>> {
        let dt = f64::from(self.dt_s);
        // Contacts act at the ends of substeps: longer steps have more of them, not longer ones.
        let late_s = IMPACT_TIME_DEVIATION * dt / (dt / MAX_SUBSTEP_S).ceil().max(1.0);
        let mut columns = Vec::new();
        let mut first_row = 0;
        for &unit in cluster {
            let jumps: Vec<Option<[Vector3<f64>; 2]>> =
                (0..=self.steps).map(|step| self.velocity_jump(step, unit)).collect();
            let mut events: Vec<(usize, usize)> = Vec::new();
            for step in (0..=self.steps).filter(|step| jumps[*step].is_some()) {
                match events.last_mut() {
                    Some((_, end)) if *end == step => *end = step + 1,
                    _ => events.push((step, step + 1)),
                }
            }
            for (start, end) in events.into_iter().take(MAX_IMPACTS) {
                let mut column = DVector::zeros(rows);
                let (mut row, mut offset) = (first_row, [Vector3::zeros(); 2]);
                for step in 0..=self.steps {
                    // A late change of velocity displaces the unit in all later steps.
                    if let Some(Some([velocity, spin])) =
                        step.checked_sub(1).filter(|s| (start..end).contains(s)).map(|s| jumps[s])
                    {
                        offset = [offset[0] + velocity * late_s, offset[1] + spin * late_s];
                    }
                    let Some(sample) = self.sample(step, unit) else { continue };
                    let [position, turn] = self.deviations(unit, sample.noise);
                    for axis in 0..3 {
                        column[row + axis] = offset[0][axis] / position;
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

    /// Change of a unit's velocity and spin at a step, where it exceeds gravity and noise.
    fn velocity_jump(&self, step: usize, unit: usize) -> Option<[Vector3<f64>; 2]> {
        let dt = f64::from(self.dt_s);
        let [before, here, after] =
            [step.checked_sub(1)?, step, step + 1].map(|step| self.sample(step, unit));
        let (before, here, after) = (before?, here?, after?);
        let position = |sample: &Sample| sample.pose.translation.vector.cast::<f64>();
        let gravity = self.scene.gravity.cast::<f64>();
        let velocity =
            (position(after) - position(here) * 2.0 + position(before)) / dt - gravity * dt;
        let spin =
            (turn_between(&here.pose, &after.pose) - turn_between(&before.pose, &here.pose)) / dt;
        // A second difference has 6 times the variance; three deviations are noise.
        let unsure = 3.0 * 6.0_f64.sqrt() * f64::from(here.noise.position_m) / dt;
        (velocity.norm() > MIN_VELOCITY_JUMP * gravity.norm() * dt + unsure)
            .then_some([velocity, spin])
    }

    /// Number of residuals of a cluster.
    pub(crate) fn rows(&self, cluster: &[usize]) -> usize {
        let observed = |unit: &usize| {
            (0..=self.steps).filter(|step| self.sample(*step, *unit).is_some()).count()
        };
        6 * cluster.iter().map(observed).sum::<usize>()
    }

    /// Residuals of a cluster less the unknowns of its start.
    pub(crate) fn degrees_of_freedom(&self, cluster: &[usize]) -> f64 {
        self.rows(cluster).saturating_sub(STATE * cluster.len()).max(1) as f64
    }

    /// (materials, clusters) Squared residuals in standard deviations, with the start and the model's errors marginalised.
    pub(crate) fn squared_misfits(
        &self,
        simulator: &BatchSimulator,
        materials: Vec<Materials>,
    ) -> Result<Vec<Vec<f64>>, IdentifyError> {
        let candidates: Vec<Candidate> = materials
            .into_iter()
            .map(|materials| Candidate { states: self.states.clone(), materials })
            .collect();
        let found = self.predict(simulator, &candidates)?;
        let squared_misfit = |residuals: &Option<DVector<f64>>, number: usize| {
            let (Some(residuals), Some(fit)) = (residuals, self.fits.get(number)) else {
                return MISFIT_OF_FAILURE;
            };
            // The linearisation applies to residuals of the same poses alone.
            if residuals.len() != fit.jacobian.nrows() {
                return MISFIT_OF_FAILURE;
            }
            // Marginal chi-squared: r'r - r'J (I + J'J)^-1 J'r, for unknowns with unit prior variance.
            let along = fit.jacobian.tr_mul(residuals);
            let explained = along.dot(&fit.normal.solve(&along));
            (residuals.norm_squared() - explained).max(0.0)
        };
        let of_try = |clusters: &Vec<Option<DVector<f64>>>| {
            clusters
                .iter()
                .enumerate()
                .map(|(number, found)| squared_misfit(found, number))
                .collect()
        };
        Ok(found.iter().map(of_try).collect())
    }

    /// The physics of a unit with one coefficient perturbed.
    fn perturbed(
        &self,
        coefficient: Coefficient,
        unit: usize,
        physics: &Physics,
        sign: f32,
    ) -> Physics {
        let reference = coefficient.reference(&self.scene).max(1e-6) as f32;
        let mut physics = *physics;
        match coefficient {
            Coefficient::Friction => {
                let step = (0.05 * physics.friction).max(0.01 / reference);
                physics.friction = (physics.friction + sign * step).clamp(0.0, 1e3);
            }
            Coefficient::Restitution => {
                let step = 0.03 / reference;
                physics.restitution = (physics.restitution + sign * step).clamp(0.0, 1e3);
            }
            Coefficient::Mass => {
                let alone = self.contacts.pairs.iter().all(|(a, b)| *a != unit && *b != unit);
                // The mass of a unit without collisions cancels, so it has no derivative.
                let step = if alone { 1.0 } else { (0.1 * sign).exp() };
                physics.mass_kg = (physics.mass_kg * step).clamp(1e-9, 1e9);
            }
        }
        physics
    }
}

/// A whole motion of one unit, from free flight through impacts to the end, and the error of its prediction.
///
/// The flight alone fits its start, because the model is exact there. So another start cannot compensate for wrong impacts, as it can in a
/// window.
pub(crate) struct WholeMotion {
    pub(crate) unit: usize,
    flight: Window,
    run: Window,
    ready: bool,
}

impl WholeMotion {
    /// None where several units move, where there is no impact, or no flight before the first one.
    pub(crate) fn new(scene: &Arc<StaticScene>, segment: &Segment) -> Option<Self> {
        let mut free = (0..scene.units.len()).filter(|unit| scene.units[*unit].role == Role::Free);
        let (unit, None) = (free.next()?, free.next()) else { return None };
        // A driven unit may push at any time, and then the flight is no free motion.
        if scene.units.iter().any(|unit| unit.role == Role::Driven) {
            return None;
        }
        let all = Window::over(scene, segment, 0..segment.steps + 1, &[unit])?;
        let first = (0..=all.steps).find(|step| all.velocity_jump(*step, unit).is_some())?;
        let start = first.checked_sub(MIN_FLIGHT + 1)?.saturating_sub(MAX_FLIGHT - MIN_FLIGHT);
        let flight = Window::over(scene, segment, start..first, &[unit])?;
        let run = Window::over(scene, segment, start..segment.steps + 1, &[unit])?;
        // Without a flight the start is not exact, and without a long run impacts hardly show.
        if !flight.is_in_free_fall(unit) || run.steps < flight.steps + MIN_RUN {
            return None;
        }
        Some(WholeMotion { unit, flight, run, ready: false })
    }

    pub(crate) fn scene(&self) -> &Arc<StaticScene> {
        &self.run.scene
    }

    /// (materials) Mean squared error of the predicted position after the first impact, in radii.
    pub(crate) fn position_misfit(
        &mut self,
        simulator: &BatchSimulator,
        materials: Vec<Materials>,
    ) -> Result<Vec<f64>, IdentifyError> {
        // The flight does not depend on the materials, so any of them fits its start.
        if !self.ready {
            if let Some(first) = materials.first() {
                for _ in 0..INITIAL_FITS {
                    self.flight.fit(simulator, first, &ModelError::NONE)?;
                }
            }
            self.run.states = self.flight.states.clone();
            self.ready = true;
        }
        let candidates: Vec<Candidate> = materials
            .into_iter()
            .map(|materials| Candidate { states: self.run.states.clone(), materials })
            .collect();
        let found = self.run.predict(simulator, &candidates)?;
        let radius = f64::from(self.run.scene.radii.get(self.unit).copied().unwrap_or(1.0));
        let position_misfit = |residuals: &DVector<f64>| {
            let samples = (0..=self.run.steps)
                .filter_map(|step| Some((step, self.run.sample(step, self.unit)?)));
            let (mut sum, mut count) = (0.0, 0.0);
            for ((step, sample), of) in samples.zip(residuals.as_slice().chunks_exact(6)) {
                // Poses of the flight are fitted, and say nothing of impacts.
                if step > self.flight.steps {
                    let [position, _] = self.run.deviations(self.unit, sample.noise);
                    let square: f64 = of.iter().take(3).map(|v| v * v).sum();
                    sum += square * (position / radius).powi(2);
                    count += 1.0;
                }
            }
            sum / f64::max(count, 1.0)
        };
        let of_try = |clusters: &Residuals| {
            clusters.first().and_then(Option::as_ref).map_or(MISFIT_OF_FAILURE, position_misfit)
        };
        Ok(found.iter().map(of_try).collect())
    }
}

/// A coefficient of a unit's physics.
#[derive(Clone, Copy)]
enum Coefficient {
    Friction,
    Restitution,
    Mass,
}

const COEFFICIENTS: [Coefficient; 3] =
    [Coefficient::Friction, Coefficient::Restitution, Coefficient::Mass];

impl Coefficient {
    /// Its value, on the scale of finite differences.
    fn value(self, physics: &Physics) -> f64 {
        match self {
            Coefficient::Friction => f64::from(physics.friction),
            Coefficient::Restitution => f64::from(physics.restitution),
            Coefficient::Mass => f64::from(physics.mass_kg).ln(),
        }
    }

    /// The plane's coefficient, which a contact multiplies it with.
    fn reference(self, scene: &StaticScene) -> f64 {
        let (friction, restitution) = scene.reference();
        match self {
            Coefficient::Friction => f64::from(friction),
            Coefficient::Restitution => f64::from(restitution),
            Coefficient::Mass => 1.0,
        }
    }

    /// Standard deviation of the model's error, in the coefficient times the reference.
    fn error(
        self,
        physics: &Physics,
        reference: f64,
        error: &ModelError,
        impacting: (bool, bool),
    ) -> f64 {
        match self {
            Coefficient::Friction => {
                let relative = match impacting {
                    (true, _) => error.friction_at_impacts,
                    (false, true) => error.friction_of_hits,
                    (false, false) => error.friction,
                };
                f64::from(relative) * f64::from(physics.friction) * reference
            }
            Coefficient::Restitution => f64::from(error.restitution),
            Coefficient::Mass => f64::from(error.mass),
        }
    }
}
