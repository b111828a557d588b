//! Weighs parameters of units by windows of motion: population Monte Carlo.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use rigidformer_core::Physics;
use rigidformer_runtime::futures::BatchSimulator;
use rigidformer_runtime::noise::Noise;
use rigidformer_runtime::progress::Progress;

use super::cloud::{Cloud, Proposal, effective, logistic};
use super::interval::Interval;
use super::settings::{IdentifyError, Settings};
use super::static_scene::StaticScene;
use super::track::Segment;
use super::window::{Materials, WholeMotion, Window};

/// Windows at rest that are kept.
// More of them carry the same information.
const MAX_WINDOWS_AT_REST: usize = 2;
/// Steps over which errors of the model are correlated.
// Correlated residuals count as fewer independent ones.
const CORRELATION_STEPS: f64 = 4.0;
/// Change of the mean logarithm of deviations below which a cloud has settled.
// Where the likelihood is rough, as after many impacts, the full likelihood may never be reached.
const SETTLED_CHANGE: f64 = 0.1;
/// Windows with impacts count together as this many, at most.
// The error of the model's impulses is common to all of them.
const MAX_IMPACT_WINDOWS: f64 = 3.0;
/// Least ratio of a window's misfit to that of the best particle.
// It bounds how much one window can say for other parameters than all windows together.
const MIN_LIKELIHOOD_RATIO: f64 = 0.05;
/// Steps of a whole motion, at most.
// It bounds the time of a prediction.
const MAX_MOTION_STEPS: usize = 160;
/// Misfit above which nothing is told of mass ratios.
// They come from a few meetings alone: where no particle explains the motion, the likeliest is as wrong as the others.
const MOST_MISFIT_OF_RATIOS: f64 = 4.0;
/// Degrees of freedom of a whole motion's error.
// A path has two directions, and an end.
const MOTION_DEGREES_OF_FREEDOM: f64 = 3.0;
/// Least deviation of a whole motion's prediction, in radii.
// Without it, one nearly exact prediction would outweigh all windows.
const MOTION_FLOOR: f64 = 0.05;
/// Rounds whose samples make the posterior.
// Pooled rounds have more effective samples than a single one.
const POOLED_ROUNDS: usize = 2;
/// Upper quartile of the logistic distribution, ln 3.
const QUARTILE: f64 = 1.098_612_288_668_109_8;
/// Medians of seven equally likely parts of the normal distribution.
// They convolve the posterior with the model's shared error.
const NORMAL_NODES: [f64; 7] = [-1.465, -0.792, -0.366, 0.0, 0.366, 0.792, 1.465];
/// Samples of the prior in each dimension.
const PRIOR_SAMPLES: usize = 64;

/// Identified physics of a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnitPhysics {
    /// Whether it is in contact in any window.
    pub touched: bool,
    /// Friction with the scene's roughest plane: the product of both coefficients.
    pub friction: Interval,
    /// Restitution with that plane, likewise.
    pub restitution: Interval,
    /// The unit's own coefficient, if the plane's is as given.
    pub own_friction: Interval,
    /// The unit's own restitution, if the plane's is as given.
    pub own_restitution: Interval,
}

/// Identified mass ratio of two units that collide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassRatio {
    /// Their numbers.
    pub units: [usize; 2],
    /// Mass of the first over that of the second.
    pub ratio: Interval,
}

/// Result of an identification.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Identified {
    /// (units)
    pub units: Vec<UnitPhysics>,
    /// Of units that collide.
    pub ratios: Vec<MassRatio>,
    /// Windows of motion that are used.
    pub windows: usize,
    /// Median over windows of the reduced chi-squared, at least 1: how well the model fits.
    pub misfit: f64,
    /// Whether the rounds ended before the intervals settled. They hold, and are wider than the motion allows. Mass ratios of
    /// units whose intervals have not settled are not told.
    pub unfinished: bool,
}

/// Units whose parameters depend on each other, because they are in contact.
struct Group {
    units: Vec<usize>,
    cloud: Cloud,
    /// Clouds of the last settled rounds.
    pooled: VecDeque<Cloud>,
    power: f64,
    /// Whether its cloud has no weights yet.
    is_new: bool,
    /// The likeliest sample of the last round.
    best: Vec<f64>,
    /// Mean logarithm of its cloud's deviations, and whether it has settled.
    spread: f64,
    settled: bool,
}

impl Group {
    /// Parameters of a unit: the mass of a single unit cancels.
    fn width(&self) -> usize {
        if self.units.len() > 1 { 3 } else { 2 }
    }

    fn dims(&self) -> usize {
        self.units.len() * self.width()
    }

    /// Number of a unit's first parameter.
    fn first_parameter(&self, unit: usize) -> Option<usize> {
        Some(self.units.iter().position(|own| *own == unit)? * self.width())
    }

    /// Samples and weights of the last rounds.
    fn posterior(&self) -> Vec<(&[f64], f64)> {
        let clouds: Vec<&Cloud> =
            if self.pooled.is_empty() { vec![&self.cloud] } else { self.pooled.iter().collect() };
        let effective_count: Vec<f64> = clouds.iter().map(|cloud| effective(cloud)).collect();
        let samples = clouds.iter().zip(effective_count).flat_map(|(cloud, effective_count)| {
            let samples = cloud.samples.iter().zip(&cloud.weights);
            samples.map(move |(sample, weight)| (sample.as_slice(), weight * effective_count))
        });
        samples.collect()
    }
}

/// Weighs parameters by its windows.
pub(crate) struct Estimator {
    simulator: BatchSimulator,
    settings: Settings,
    scene: Arc<StaticScene>,
    windows: VecDeque<Window>,
    /// Whole motions.
    whole_motions: VecDeque<WholeMotion>,
    /// The last segments joined, and whether the last whole motion is theirs.
    motion: Option<(Arc<StaticScene>, Segment)>,
    open: bool,
    groups: Vec<Group>,
    pairs: BTreeSet<(usize, usize)>,
    windows_at_rest: usize,
    /// Streams of noise so far.
    round: u64,
    misfit: f64,
    fresh: bool,
}

impl Estimator {
    pub(crate) fn new(
        simulator: BatchSimulator,
        scene: Arc<StaticScene>,
        settings: Settings,
    ) -> Result<Self, IdentifyError> {
        settings.check()?;
        Ok(Estimator {
            simulator,
            settings,
            scene,
            windows: VecDeque::new(),
            whole_motions: VecDeque::new(),
            motion: None,
            open: false,
            groups: Vec::new(),
            pairs: BTreeSet::new(),
            windows_at_rest: 0,
            round: 0,
            misfit: 1.0,
            fresh: false,
        })
    }

    /// Takes a segment of motion. Whether it is informative.
    pub(crate) fn take(&mut self, scene: &Arc<StaticScene>, segment: Segment) -> bool {
        // Segments of one recording follow each other, and their union shows all impacts of a motion.
        let continues = self.motion.as_mut().is_some_and(|(of, whole)| {
            Arc::ptr_eq(of, scene) && whole.join(&segment, MAX_MOTION_STEPS)
        });
        if !continues {
            self.motion = Some((scene.clone(), segment.clone()));
            self.open = false;
        }
        let Some(window) = Window::new(scene, segment) else { return false };
        if !self.push(window) {
            return false;
        }
        // The whole motion grows with each segment, and its shorter version would count twice.
        if self.open {
            self.whole_motions.pop_back();
        }
        let whole = self.motion.as_ref().and_then(|(scene, all)| WholeMotion::new(scene, all));
        self.open = whole.is_some();
        self.whole_motions.extend(whole);
        while self.whole_motions.len() > self.settings.windows {
            self.whole_motions.pop_front();
        }
        true
    }

    /// Takes a window. Whether it is informative.
    fn push(&mut self, window: Window) -> bool {
        if window.contacts.at_rest {
            self.windows_at_rest += 1;
            if self.windows_at_rest > MAX_WINDOWS_AT_REST {
                return false;
            }
        }
        self.pairs.extend(&window.contacts.pairs);
        self.windows.push_back(window);
        while self.windows.len() > self.settings.windows {
            self.windows.pop_front();
        }
        let hits: Vec<bool> =
            (0..self.scene.units.len()).map(|unit| self.has(unit, Window::has_impact)).collect();
        self.windows.iter_mut().for_each(|window| window.set_impacting(&hits));
        self.regroup();
        self.fresh = true;
        true
    }

    pub(crate) fn windows(&self) -> usize {
        self.windows.len()
    }

    /// Groups units that are in contact with each other in any window.
    fn regroup(&mut self) {
        let count = self.scene.units.len();
        let mut root: Vec<usize> = (0..count).collect();
        let mut touched = vec![false; count];
        let known = self.groups.iter().map(|group| &group.units);
        for cluster in self.windows.iter().flat_map(|w| &w.contacts.clusters).chain(known) {
            for pair in cluster.windows(2) {
                if let [one, other] = pair {
                    let (keep, merged) = (root[*one], root[*other]);
                    root.iter_mut().filter(|of| **of == merged).for_each(|of| *of = keep);
                }
            }
            cluster.iter().for_each(|unit| touched[*unit] = true);
        }
        for first in 0..count {
            let units: Vec<usize> =
                (0..count).filter(|unit| touched[*unit] && root[*unit] == first).collect();
            // An unchanged group keeps its posterior.
            if units.is_empty() || self.groups.iter().any(|group| group.units == units) {
                continue;
            }
            let (old, others) =
                std::mem::take(&mut self.groups).into_iter().partition::<Vec<_>, _>(|group| {
                    group.units.iter().any(|unit| units.contains(unit))
                });
            self.groups = others;
            let (seed, particles) = (self.settings.seed, self.settings.particles);
            let mut group = Group {
                units,
                cloud: Cloud::prior(0, 0, 0, 0),
                pooled: VecDeque::new(),
                power: 0.0,
                is_new: true,
                best: Vec::new(),
                spread: f64::INFINITY,
                settled: false,
            };
            // Known posteriors are kept: samples of the old groups are paired at random.
            let mut cloud = Cloud::prior(group.dims(), particles, seed, self.next_stream());
            for known in &old {
                let mut noise = Noise::new(seed, self.next_stream());
                let samples = known.cloud.resampled(particles, &mut noise);
                for (new, sample) in cloud.samples.iter_mut().zip(samples) {
                    for &unit in &known.units {
                        let (Some(from), Some(to)) =
                            (known.first_parameter(unit), group.first_parameter(unit))
                        else {
                            continue;
                        };
                        let width = known.width();
                        new[to..to + width].copy_from_slice(&sample[from..from + width]);
                    }
                }
            }
            group.cloud = cloud;
            self.groups.push(group);
        }
    }

    fn next_stream(&mut self) -> u64 {
        self.round += 1;
        self.round
    }

    /// (units) Physics under these parameters, by group.
    fn materials(&self, scene: &StaticScene, parameters: &[&[f64]]) -> Materials {
        let mut all: Materials = (0..scene.units.len()).map(|unit| scene.physics(unit)).collect();
        let prior = self.settings.prior;
        let (friction, restitution) = scene.reference();
        // Half of a logistic distribution is within its quartile, and half of the masses within the factor.
        let scale = f64::from(prior.mass_factor).ln() / QUARTILE;
        for (group, numbers) in self.groups.iter().zip(parameters) {
            for (&unit, own) in group.units.iter().zip(numbers.chunks_exact(group.width())) {
                let (Some(slot), [f, e, mass @ ..]) = (all.get_mut(unit), own) else { continue };
                let coefficient = |most: f32, x: f64, other: f32| {
                    let product = f64::from(most) * logistic(x);
                    if other > 0.0 { (product / f64::from(other)).min(1e3) as f32 } else { 0.0 }
                };
                let times = mass.first().map_or(1.0, |x| (scale * x).exp());
                *slot = Physics {
                    mass_kg: (f64::from(slot.mass_kg) * times).clamp(1e-9, 1e9) as f32,
                    friction: coefficient(prior.friction_most, *f, friction),
                    restitution: coefficient(prior.restitution_most, *e, restitution),
                };
            }
        }
        all
    }

    /// Predicts all windows with new particles and weighs them, for at most `rounds` rounds. `progress` counts windows of rounds.
    ///
    /// # Errors
    /// [`IdentifyError::Cancelled`], or an error of a prediction; the posterior is unchanged.
    pub(crate) fn update(
        &mut self,
        rounds: usize,
        progress: Progress<'_>,
    ) -> Result<(), IdentifyError> {
        if self.groups.is_empty() {
            return Ok(());
        }
        // Pooled rounds must weigh the same windows, and an update may add one.
        self.groups.iter_mut().for_each(|group| group.pooled.clear());
        let mut full = 0;
        for round in 0..rounds {
            self.one_round(self.fresh && round == 0, progress)?;
            self.fresh = false;
            full = if self.groups.iter().all(|group| group.settled) { full + 1 } else { 0 };
            // The first settled round has samples of the wide proposal before it.
            if full > POOLED_ROUNDS {
                break;
            }
        }
        Ok(())
    }

    fn one_round(&mut self, fresh: bool, progress: Progress<'_>) -> Result<(), IdentifyError> {
        let particles = self.settings.particles;
        let mut proposals: Vec<Proposal> = Vec::with_capacity(self.groups.len());
        let seed = self.settings.seed;
        for group in 0..self.groups.len() {
            let mut noise = Noise::new(seed, self.next_stream());
            let group = &self.groups[group];
            proposals.push(match group.is_new {
                true => group.cloud.as_proposal(),
                false => group.cloud.propose(particles, fresh, &mut noise),
            });
        }
        if self.groups.iter().any(|group| group.is_new) {
            self.initialise(&proposals, progress)?;
        }
        // The mean of a wide cloud may be unlikely, so windows are linearised about the best sample until it settles.
        let about = self.groups.iter().map(|group| match !group.settled {
            true => group.best.clone(),
            false => group.cloud.mean(),
        });
        let about: Vec<Vec<f64>> = about.collect();
        let about: Vec<&[f64]> = about.iter().map(Vec::as_slice).collect();
        let mut misfits: Vec<Vec<Misfit>> = Vec::with_capacity(self.windows.len());
        for number in 0..self.windows.len() {
            if progress.cancelled.load(Ordering::Relaxed) {
                return Err(IdentifyError::Cancelled);
            }
            let materials = self.materials(self.windows[number].scene(), &about);
            let all = self.all_materials(number, &proposals);
            let window = &mut self.windows[number];
            window.fit(&self.simulator, &materials, &self.settings.model_error)?;
            let found = window.squared_misfits(&self.simulator, all)?;
            misfits.push(self.by_group(number, &found));
            (progress.stepped)();
        }
        let mut squares_of_motions = Vec::with_capacity(self.whole_motions.len());
        for number in 0..self.whole_motions.len() {
            if progress.cancelled.load(Ordering::Relaxed) {
                return Err(IdentifyError::Cancelled);
            }
            let all = self.materials_of(self.whole_motions[number].scene(), &proposals);
            let whole = &mut self.whole_motions[number];
            squares_of_motions.push((whole.unit, whole.position_misfit(&self.simulator, all)?));
        }
        let mut ratios = Vec::new();
        for (index, proposal) in proposals.into_iter().enumerate() {
            let own: Vec<&Misfit> =
                misfits.iter().flatten().filter(|misfit| misfit.group == index).collect();
            let best = likeliest(&own, particles);
            // Misfit beyond noise is an error of the model, and correlated over steps.
            let mut logs = vec![0.0; particles];
            let impact_windows = own.iter().filter(|misfit| misfit.has_impact).count() as f64;
            let impact_weight = (MAX_IMPACT_WINDOWS / impact_windows.max(1.0)).min(1.0);
            for Misfit { degrees_of_freedom, correlation, has_impact, squares, .. } in own {
                let ratio = (squares[best] / degrees_of_freedom).max(1.0);
                ratios.push(ratio);
                // The variance of a mean of correlated errors is larger by the length of their correlation.
                let times = 1.0 + (ratio - 1.0) * correlation;
                // The variance of the model's error at impacts is estimated from few residuals: Student's distribution.
                let numbers = degrees_of_freedom / correlation;
                logs.iter_mut().zip(squares).for_each(|(log, square)| {
                    let more = (square - squares[best]) / times;
                    *log -= match *has_impact {
                        true => {
                            0.5 * impact_weight
                                * numbers
                                * (1.0 + more / numbers).max(MIN_LIKELIHOOD_RATIO).ln()
                        }
                        false => 0.5 * more,
                    };
                });
            }
            for (unit, square) in &squares_of_motions {
                if self.groups[index].units.contains(unit) {
                    logs.iter_mut().zip(square).for_each(|(log, square)| {
                        *log -= 0.5
                            * MOTION_DEGREES_OF_FREEDOM
                            * (square + MOTION_FLOOR * MOTION_FLOOR).ln();
                    });
                }
            }
            let group = &mut self.groups[index];
            group.best = proposal.samples[best].clone();
            let (cloud, power) = proposal.weigh(group.dims(), &logs);
            // Where all predictions fail, the last cloud is the better proposal.
            if !cloud.weights.iter().all(|weight| weight.is_finite()) {
                continue;
            }
            // A rough likelihood, as after many impacts, may never be reached in full.
            let spread = cloud.spread();
            group.settled = power >= 1.0 || (group.spread - spread).abs() < SETTLED_CHANGE;
            (group.cloud, group.power, group.is_new, group.spread) = (cloud, power, false, spread);
            if group.settled {
                group.pooled.push_back(group.cloud.clone());
            } else {
                group.pooled.clear();
            }
            while group.pooled.len() > POOLED_ROUNDS {
                group.pooled.pop_front();
            }
        }
        // The median ignores single windows with huge ratios.
        ratios.sort_by(f64::total_cmp);
        self.misfit = ratios.get(ratios.len() / 2).copied().unwrap_or(1.0);
        Ok(())
    }

    /// Physics of a window's units under each particle.
    fn all_materials(&self, window: usize, proposals: &[Proposal]) -> Vec<Materials> {
        self.materials_of(self.windows[window].scene(), proposals)
    }

    fn materials_of(&self, scene: &StaticScene, proposals: &[Proposal]) -> Vec<Materials> {
        let of = |particle: usize| {
            let numbers: Vec<&[f64]> =
                proposals.iter().map(|proposal| proposal.samples[particle].as_slice()).collect();
            self.materials(scene, &numbers)
        };
        (0..self.settings.particles).map(of).collect()
    }

    /// Squared residuals of a window, (particles, clusters), by the group of each cluster.
    fn by_group(&self, window: usize, found: &[Vec<f64>]) -> Vec<Misfit> {
        let window = &self.windows[window];
        let clusters = window.contacts.clusters.iter().enumerate();
        let misfits = clusters.filter_map(|(index, cluster)| {
            let unit = cluster.first()?;
            let group = self.groups.iter().position(|group| group.units.contains(unit))?;
            let squares = found.iter().map(|clusters| clusters[index]).collect();
            let correlation = match window.has_impact(*unit) {
                true => CORRELATION_STEPS.max(window.steps() as f64),
                false => CORRELATION_STEPS,
            };
            Some(Misfit {
                group,
                has_impact: window.has_impact(*unit),
                degrees_of_freedom: window.degrees_of_freedom(cluster),
                correlation,
                squares,
            })
        });
        misfits.collect()
    }

    /// Finds the best sample of each new group, with starts from observed velocities.
    fn initialise(
        &mut self,
        proposals: &[Proposal],
        progress: Progress<'_>,
    ) -> Result<(), IdentifyError> {
        let mut misfits: Vec<Misfit> = Vec::new();
        for number in 0..self.windows.len() {
            if progress.cancelled.load(Ordering::Relaxed) {
                return Err(IdentifyError::Cancelled);
            }
            if !self.windows[number].is_fitted() {
                let all = self.all_materials(number, proposals);
                let found = self.windows[number].initialise(&self.simulator, &all)?;
                misfits.extend(self.by_group(number, &found));
            }
        }
        for (index, (group, proposal)) in self.groups.iter_mut().zip(proposals).enumerate() {
            let own: Vec<&Misfit> = misfits.iter().filter(|misfit| misfit.group == index).collect();
            if group.is_new {
                group.best = proposal.samples[likeliest(&own, proposal.samples.len())].clone();
            }
        }
        Ok(())
    }

    /// The present result.
    pub(crate) fn identified(&self) -> Identified {
        let mut units = vec![UnitPhysics::default(); self.scene.units.len()];
        let (prior, error) = (self.settings.prior, self.settings.model_error);
        let (friction, restitution) = self.scene.reference();
        for group in &self.groups {
            let posterior = group.posterior();
            for &unit in &group.units {
                let (Some(first_parameter), Some(slot)) =
                    (group.first_parameter(unit), units.get_mut(unit))
                else {
                    continue;
                };
                let coefficient = |at: usize, most: f32, error: &dyn Fn(f64) -> f64| {
                    let most = f64::from(most);
                    let mut values: Vec<(f64, f64)> =
                        Vec::with_capacity(posterior.len() * NORMAL_NODES.len());
                    for (sample, weight) in &posterior {
                        let value = most * logistic(sample[at]);
                        // No coefficient is below 0, so the error is reflected there.
                        let off =
                            NORMAL_NODES.iter().map(|node| (value + node * error(value)).abs());
                        values.extend(off.map(|value| (value, *weight)));
                    }
                    let mut before =
                        even().map(|fraction| (fraction * most, 1.0)).collect::<Vec<_>>();
                    Interval::of(&mut values, &mut before)
                };
                let own = |interval: Interval, other: f32| match other > 0.0 {
                    true => (interval, interval.times(1.0 / f64::from(other))),
                    false => (Interval::NotSeen, Interval::NotSeen),
                };
                let bounced = self.has(unit, Window::has_impact);
                let slid = self.has(unit, Window::is_sliding);
                let rested = self.has(unit, Window::is_at_rest) && !bounced;
                let relative_error = f64::from(match bounced {
                    true => error.shared_friction_of_hits,
                    false => error.shared_friction,
                });
                let f = coefficient(first_parameter, prior.friction_most, &|f| relative_error * f);
                // The model needs too much friction to turn a bouncing body, so impacts alone do not identify friction.
                let f = match f {
                    Interval::Between { .. } if bounced && slid => f,
                    f if !bounced && (slid || rested) => f,
                    _ => Interval::NotSeen,
                };
                let off = match self.has(unit, Window::impacts_off_centre) {
                    true => error.shared_restitution_at_corners,
                    false => error.shared_restitution,
                };
                let e =
                    coefficient(first_parameter + 1, prior.restitution_most, &|_| f64::from(off));
                // Bounces smaller than the noise give a bound alone, which is not reliable.
                let e = match e {
                    Interval::Between { .. } if bounced => e,
                    _ => Interval::NotSeen,
                };
                slot.touched = true;
                (slot.friction, slot.own_friction) = own(f, friction);
                (slot.restitution, slot.own_restitution) = own(e, restitution);
            }
        }
        let ratios = self.pairs.iter().filter_map(|(one, other)| self.ratio(*one, *other));
        Identified {
            units,
            ratios: ratios.collect(),
            windows: self.windows.len(),
            misfit: self.misfit,
            unfinished: self.groups.iter().any(|group| !group.settled),
        }
    }

    fn has(&self, unit: usize, what: impl Fn(&Window, usize) -> bool) -> bool {
        self.windows.iter().any(|window| what(window, unit))
    }

    fn ratio(&self, one: usize, other: usize) -> Option<MassRatio> {
        let group = self.groups.iter().find(|group| group.units.contains(&one))?;
        let (at, to) = (group.first_parameter(one)? + 2, group.first_parameter(other)? + 2);
        let scale = f64::from(self.settings.prior.mass_factor).ln() / QUARTILE;
        let given = |unit: usize| f64::from(self.scene.physics(unit).mass_kg).ln();
        let middle = given(one) - given(other);
        let error = f64::from(self.settings.model_error.shared_mass);
        let mut values = Vec::new();
        for (sample, weight) in group.posterior() {
            let value = middle + scale * (sample.get(at)? - sample.get(to)?);
            values.extend(NORMAL_NODES.iter().map(|node| (value + node * error, weight)));
        }
        let logit = |fraction: f64| (fraction / (1.0 - fraction)).ln();
        let mut before: Vec<(f64, f64)> = even()
            .flat_map(|a| even().map(move |b| (middle + scale * (logit(a) - logit(b)), 1.0)))
            .collect();
        // A cloud that has not settled about one meeting may be about another motion.
        let ratio = match group.settled && self.misfit <= MOST_MISFIT_OF_RATIOS {
            true => Interval::of(&mut values, &mut before).map(f64::exp),
            false => Interval::NotSeen,
        };
        Some(MassRatio { units: [one, other], ratio })
    }
}

/// Chi-squared of a cluster in a window.
struct Misfit {
    group: usize,
    /// Residuals less the unknowns of the start.
    degrees_of_freedom: f64,
    /// Whether the window has an impact.
    has_impact: bool,
    /// Steps over which errors of the model are correlated.
    correlation: f64,
    /// (particles)
    squares: Vec<f64>,
}

/// The particle of least misfit, where the variance of each window is unknown and at least that of noise.
fn likeliest(misfits: &[&Misfit], particles: usize) -> usize {
    let total = |particle: usize| {
        let of = |misfit: &&Misfit| {
            let ratio = misfit.squares[particle] / misfit.degrees_of_freedom;
            // The profile likelihood of an unknown variance is logarithmic in the ratio.
            misfit.degrees_of_freedom * if ratio < 1.0 { ratio } else { 1.0 + ratio.ln() }
        };
        misfits.iter().map(of).sum::<f64>()
    };
    (0..particles).min_by(|a, b| total(*a).total_cmp(&total(*b))).unwrap_or(0)
}

/// Evenly spaced numbers between 0 and 1.
fn even() -> impl Iterator<Item = f64> {
    (0..PRIOR_SAMPLES).map(|i| (i as f64 + 0.5) / PRIOR_SAMPLES as f64)
}
