//! What windows of motion say of the units in them.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use rigidformer_core::Physics;
use rigidformer_runtime::futures::BatchSimulator;
use rigidformer_runtime::noise::Noise;
use rigidformer_runtime::progress::Progress;

use super::cloud::{Cloud, Proposal, effective, share};
use super::interval::Interval;
use super::setting::Setting;
use super::settings::{IdentifyError, Settings};
use super::track::Piece;
use super::window::{Materials, Whole, Window};

/// Windows in which nothing moves that are kept: more of them say the same.
const QUIET_WINDOWS: usize = 2;
/// Steps over which misfit that noise does not explain is taken to last.
const LASTING: f64 = 4.0;
/// A change of the mean logarithm of deviations that counts as none.
const STEADY: f64 = 0.1;
/// Windows with impacts count together as so many at most: the model's impulses are off in all of them alike.
const ROUGH_WINDOWS: f64 = 3.0;
/// No window is so much likelier with other parameters than with the best of all that it says more than this.
const LEAST_RATIO: f64 = 0.05;
/// Steps of a whole motion, at most.
const MOST_WHOLE: usize = 160;
/// Numbers that a whole motion tells: its way has two directions, and an end.
const WHOLE_NUMBERS: f64 = 3.0;
/// No whole motion is predicted nearer than this, in radii.
const WHOLE_FLOOR: f64 = 0.05;
/// Rounds whose samples make the posterior.
const POOLED: usize = 2;
/// Where a quarter of the logistic distribution ends.
const QUARTILE: f64 = 1.098_612_288_668_109_8;
/// Normal deviations of equal probability.
const NODES: [f64; 7] = [-1.465, -0.792, -0.366, 0.0, 0.366, 0.792, 1.465];
/// Values of the prior in each dimension.
const PRIOR_VALUES: usize = 64;

/// What is known of a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnitPhysics {
    /// Whether it touched anything while it was seen.
    pub touched: bool,
    /// Friction with the scene's plane: the product of both coefficients. Of several planes the roughest is meant.
    pub friction: Interval,
    /// Restitution with that plane, likewise.
    pub restitution: Interval,
    /// The unit's own coefficient, if the plane's is as given.
    pub own_friction: Interval,
    /// Likewise.
    pub own_restitution: Interval,
}

/// What is known of two units that met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassRatio {
    /// Their numbers.
    pub units: [usize; 2],
    /// Mass of the first over that of the second.
    pub ratio: Interval,
}

/// What motion says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Identified {
    /// (units)
    pub units: Vec<UnitPhysics>,
    /// Of units that met.
    pub ratios: Vec<MassRatio>,
    /// Pieces of motion that were used.
    pub windows: usize,
    /// Median over them of the squared residuals over what noise explains, at least 1: how well the model fits.
    pub misfit: f64,
    /// Whether all rounds ended before the intervals were as narrow as the motion allows. They are right, and wider than need be.
    pub unfinished: bool,
}

/// Units whose parameters hang together, as they touch each other.
struct Group {
    units: Vec<usize>,
    cloud: Cloud,
    /// Clouds of the last rounds that weighed likelihoods in full.
    pooled: VecDeque<Cloud>,
    power: f64,
    /// Whether its cloud has never been weighed.
    is_new: bool,
    /// The likeliest sample of the last round.
    best: Vec<f64>,
    /// Of its cloud, and whether it no longer narrows.
    spread: f64,
    settled: bool,
}

impl Group {
    /// Parameters of a unit: masses matter only to each other.
    fn width(&self) -> usize {
        if self.units.len() > 1 { 3 } else { 2 }
    }

    fn dims(&self) -> usize {
        self.units.len() * self.width()
    }

    /// Number of a unit's first parameter.
    fn place(&self, unit: usize) -> Option<usize> {
        Some(self.units.iter().position(|own| *own == unit)? * self.width())
    }

    /// Samples and weights of the last rounds.
    fn posterior(&self) -> Vec<(&[f64], f64)> {
        let clouds: Vec<&Cloud> =
            if self.pooled.is_empty() { vec![&self.cloud] } else { self.pooled.iter().collect() };
        let worth: Vec<f64> = clouds.iter().map(|cloud| effective(cloud)).collect();
        let samples = clouds.iter().zip(worth).flat_map(|(cloud, worth)| {
            let samples = cloud.samples.iter().zip(&cloud.weights);
            samples.map(move |(sample, weight)| (sample.as_slice(), weight * worth))
        });
        samples.collect()
    }
}

/// Weighs parameters by the windows that it has got.
pub(crate) struct Estimator {
    simulator: BatchSimulator,
    settings: Settings,
    setting: Arc<Setting>,
    windows: VecDeque<Window>,
    /// Whole motions.
    wholes: VecDeque<Whole>,
    /// The last pieces in one, and whether the last whole motion is theirs.
    chain: Option<(Arc<Setting>, Piece)>,
    open: bool,
    groups: Vec<Group>,
    met: BTreeSet<(usize, usize)>,
    quiet: usize,
    /// Of noise so far.
    round: u64,
    misfit: f64,
    fresh: bool,
}

impl Estimator {
    pub(crate) fn new(
        simulator: BatchSimulator,
        setting: Arc<Setting>,
        settings: Settings,
    ) -> Result<Self, IdentifyError> {
        settings.check()?;
        Ok(Estimator {
            simulator,
            settings,
            setting,
            windows: VecDeque::new(),
            wholes: VecDeque::new(),
            chain: None,
            open: false,
            groups: Vec::new(),
            met: BTreeSet::new(),
            quiet: 0,
            round: 0,
            misfit: 1.0,
            fresh: false,
        })
    }

    /// Takes a piece of the motion of units; whether it says anything new.
    pub(crate) fn take(&mut self, setting: &Arc<Setting>, piece: Piece) -> bool {
        let goes_on = self
            .chain
            .as_mut()
            .is_some_and(|(of, whole)| Arc::ptr_eq(of, setting) && whole.join(&piece, MOST_WHOLE));
        if !goes_on {
            self.chain = Some((setting.clone(), piece.clone()));
            self.open = false;
        }
        let Some(window) = Window::new(setting, piece) else { return false };
        if !self.push(window) {
            return false;
        }
        if self.open {
            self.wholes.pop_back();
        }
        let whole = self.chain.as_ref().and_then(|(setting, all)| Whole::new(setting, all));
        self.open = whole.is_some();
        self.wholes.extend(whole);
        while self.wholes.len() > self.settings.windows {
            self.wholes.pop_front();
        }
        true
    }

    /// Takes a window; whether it says anything new.
    fn push(&mut self, window: Window) -> bool {
        if window.touches.quiet {
            self.quiet += 1;
            if self.quiet > QUIET_WINDOWS {
                return false;
            }
        }
        self.met.extend(&window.touches.met);
        self.windows.push_back(window);
        while self.windows.len() > self.settings.windows {
            self.windows.pop_front();
        }
        let hits: Vec<bool> =
            (0..self.setting.units.len()).map(|unit| self.has(unit, Window::bounces)).collect();
        self.windows.iter_mut().for_each(|window| window.mark(&hits));
        self.regroup();
        self.fresh = true;
        true
    }

    pub(crate) fn windows(&self) -> usize {
        self.windows.len()
    }

    /// Puts units together that touch each other in any window.
    fn regroup(&mut self) {
        let count = self.setting.units.len();
        let mut lead: Vec<usize> = (0..count).collect();
        let mut touched = vec![false; count];
        let known = self.groups.iter().map(|group| &group.units);
        for cluster in self.windows.iter().flat_map(|w| &w.touches.clusters).chain(known) {
            for pair in cluster.windows(2) {
                if let [one, other] = pair {
                    let (keep, gone) = (lead[*one], lead[*other]);
                    lead.iter_mut().filter(|of| **of == gone).for_each(|of| *of = keep);
                }
            }
            cluster.iter().for_each(|unit| touched[*unit] = true);
        }
        for first in 0..count {
            let units: Vec<usize> =
                (0..count).filter(|unit| touched[*unit] && lead[*unit] == first).collect();
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
            // What was known stays, each sample of one with one of the other.
            let mut cloud = Cloud::prior(group.dims(), particles, seed, self.next_place());
            for known in &old {
                let mut noise = Noise::new(seed, self.next_place());
                let samples = known.cloud.resampled(particles, &mut noise);
                for (new, sample) in cloud.samples.iter_mut().zip(samples) {
                    for &unit in &known.units {
                        let (Some(from), Some(to)) = (known.place(unit), group.place(unit)) else {
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

    fn next_place(&mut self) -> u64 {
        self.round += 1;
        self.round
    }

    /// What units of a scene are made of with these parameters, by group.
    fn materials(&self, setting: &Setting, parameters: &[&[f64]]) -> Materials {
        let mut all: Materials =
            (0..setting.units.len()).map(|unit| setting.physics(unit)).collect();
        let prior = self.settings.prior;
        let (friction, restitution) = setting.reference();
        let scale = f64::from(prior.mass_factor).ln() / QUARTILE;
        for (group, numbers) in self.groups.iter().zip(parameters) {
            for (&unit, own) in group.units.iter().zip(numbers.chunks_exact(group.width())) {
                let (Some(slot), [f, e, mass @ ..]) = (all.get_mut(unit), own) else { continue };
                let coefficient = |most: f32, x: f64, other: f32| {
                    let product = f64::from(most) * share(x);
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

    /// So many rounds at most: predicts all windows with new parameters and weighs those. `progress` is told of each window of
    /// each round.
    ///
    /// # Errors
    /// [`IdentifyError::Cancelled`], or what predictions met; what was known stays.
    pub(crate) fn update(
        &mut self,
        rounds: usize,
        progress: Progress<'_>,
    ) -> Result<(), IdentifyError> {
        if self.groups.is_empty() {
            return Ok(());
        }
        self.groups.iter_mut().for_each(|group| group.pooled.clear());
        let mut full = 0;
        for round in 0..rounds {
            self.one_round(self.fresh && round == 0, progress)?;
            self.fresh = false;
            full = if self.groups.iter().all(|group| group.settled) { full + 1 } else { 0 };
            // The first of them still lay wide.
            if full > POOLED {
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
            let mut noise = Noise::new(seed, self.next_place());
            let group = &self.groups[group];
            proposals.push(match group.is_new {
                true => group.cloud.as_proposal(),
                false => group.cloud.propose(particles, fresh, &mut noise),
            });
        }
        if self.groups.iter().any(|group| group.is_new) {
            self.scout(&proposals, progress)?;
        }
        // While the cloud is wide its mean may be nowhere near.
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
            let materials = self.materials(self.windows[number].setting(), &about);
            let all = self.all_materials(number, &proposals);
            let window = &mut self.windows[number];
            window.fit(&self.simulator, &materials, &self.settings.model_error)?;
            let found = window.misfits(&self.simulator, all)?;
            misfits.push(self.by_group(number, &found));
            (progress.stepped)();
        }
        let mut asides = Vec::with_capacity(self.wholes.len());
        for number in 0..self.wholes.len() {
            if progress.cancelled.load(Ordering::Relaxed) {
                return Err(IdentifyError::Cancelled);
            }
            let all = self.materials_of(self.wholes[number].setting(), &proposals);
            let whole = &mut self.wholes[number];
            asides.push((whole.unit, whole.aside(&self.simulator, all)?));
        }
        let mut ratios = Vec::new();
        for (index, proposal) in proposals.into_iter().enumerate() {
            let own: Vec<&Misfit> =
                misfits.iter().flatten().filter(|misfit| misfit.group == index).collect();
            let best = likeliest(&own, particles);
            // What noise does not explain is the model's fault, and lasts.
            let mut logs = vec![0.0; particles];
            let rough = own.iter().filter(|misfit| misfit.rough).count() as f64;
            let share_of_rough = (ROUGH_WINDOWS / rough.max(1.0)).min(1.0);
            for Misfit { freedom, lasting, rough, squares, .. } in own {
                let ratio = (squares[best] / freedom).max(1.0);
                ratios.push(ratio);
                let times = 1.0 + (ratio - 1.0) * lasting;
                // How far the model is off at impacts is told by as many numbers alone: Student's distribution.
                let numbers = freedom / lasting;
                logs.iter_mut().zip(squares).for_each(|(log, square)| {
                    let more = (square - squares[best]) / times;
                    *log -= match *rough {
                        true => {
                            0.5 * share_of_rough
                                * numbers
                                * (1.0 + more / numbers).max(LEAST_RATIO).ln()
                        }
                        false => 0.5 * more,
                    };
                });
            }
            for (unit, aside) in &asides {
                if self.groups[index].units.contains(unit) {
                    logs.iter_mut().zip(aside).for_each(|(log, aside)| {
                        *log -= 0.5 * WHOLE_NUMBERS * (aside + WHOLE_FLOOR * WHOLE_FLOOR).ln();
                    });
                }
            }
            let group = &mut self.groups[index];
            group.best = proposal.samples[best].clone();
            let (cloud, power) = proposal.weigh(group.dims(), &logs);
            if !cloud.weights.iter().all(|weight| weight.is_finite()) {
                continue;
            }
            // Where the likelihood is rough, as after many impacts, a part of it is all that may count.
            let spread = cloud.spread();
            group.settled = power >= 1.0 || (group.spread - spread).abs() < STEADY;
            (group.cloud, group.power, group.is_new, group.spread) = (cloud, power, false, spread);
            if group.settled {
                group.pooled.push_back(group.cloud.clone());
            } else {
                group.pooled.clear();
            }
            while group.pooled.len() > POOLED {
                group.pooled.pop_front();
            }
        }
        ratios.sort_by(f64::total_cmp);
        self.misfit = ratios.get(ratios.len() / 2).copied().unwrap_or(1.0);
        Ok(())
    }

    /// What units are made of in a window, with each sample.
    fn all_materials(&self, window: usize, proposals: &[Proposal]) -> Vec<Materials> {
        self.materials_of(self.windows[window].setting(), proposals)
    }

    fn materials_of(&self, setting: &Setting, proposals: &[Proposal]) -> Vec<Materials> {
        let of = |particle: usize| {
            let numbers: Vec<&[f64]> =
                proposals.iter().map(|proposal| proposal.samples[particle].as_slice()).collect();
            self.materials(setting, &numbers)
        };
        (0..self.settings.particles).map(of).collect()
    }

    /// Squared residuals of a window, (particles, clusters), by the group that a cluster is of.
    fn by_group(&self, window: usize, found: &[Vec<f64>]) -> Vec<Misfit> {
        let window = &self.windows[window];
        let clusters = window.touches.clusters.iter().enumerate();
        let misfits = clusters.filter_map(|(index, cluster)| {
            let unit = cluster.first()?;
            let group = self.groups.iter().position(|group| group.units.contains(unit))?;
            let squares = found.iter().map(|clusters| clusters[index]).collect();
            let lasting = match window.bounces(*unit) {
                true => LASTING.max(window.steps() as f64),
                false => LASTING,
            };
            Some(Misfit {
                group,
                rough: window.bounces(*unit),
                freedom: window.freedom(cluster),
                lasting,
                squares,
            })
        });
        misfits.collect()
    }

    /// Finds samples of new groups to begin at: those that fit best with velocities as seen.
    fn scout(
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
                let found = self.windows[number].scout(&self.simulator, &all)?;
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

    /// What is known now.
    pub(crate) fn identified(&self) -> Identified {
        let mut units = vec![UnitPhysics::default(); self.setting.units.len()];
        let (prior, error) = (self.settings.prior, self.settings.model_error);
        let (friction, restitution) = self.setting.reference();
        for group in &self.groups {
            let posterior = group.posterior();
            for &unit in &group.units {
                let (Some(place), Some(slot)) = (group.place(unit), units.get_mut(unit)) else {
                    continue;
                };
                let coefficient = |at: usize, most: f32, error: &dyn Fn(f64) -> f64| {
                    let most = f64::from(most);
                    let mut values: Vec<(f64, f64)> =
                        Vec::with_capacity(posterior.len() * NODES.len());
                    for (sample, weight) in &posterior {
                        let value = most * share(sample[at]);
                        // Reflected: no coefficient is below 0.
                        let off = NODES.iter().map(|node| (value + node * error(value)).abs());
                        values.extend(off.map(|value| (value, *weight)));
                    }
                    let mut before = even().map(|part| (part * most, 1.0)).collect::<Vec<_>>();
                    Interval::of(&mut values, &mut before)
                };
                let own = |interval: Interval, other: f32| match other > 0.0 {
                    true => (interval, interval.times(1.0 / f64::from(other))),
                    false => (Interval::NotSeen, Interval::NotSeen),
                };
                let bounced = self.has(unit, Window::bounces);
                let slid = self.has(unit, Window::slides);
                let stuck = self.has(unit, Window::sticks) && !bounced;
                let part = f64::from(match bounced {
                    true => error.shared_friction_of_hits,
                    false => error.shared_friction,
                });
                let f = coefficient(place, prior.friction_most, &|f| part * f);
                // The model takes more friction than there is to turn what bounces: impacts alone do not tell it.
                let f = match f {
                    Interval::Between { .. } if bounced && slid => f,
                    f if !bounced && (slid || stuck) => f,
                    _ => Interval::NotSeen,
                };
                let off = match self.has(unit, Window::hits_aside) {
                    true => error.shared_restitution_at_corners,
                    false => error.shared_restitution,
                };
                let e = coefficient(place + 1, prior.restitution_most, &|_| f64::from(off));
                // A bound alone is what noise makes of bounces too small to be seen.
                let e = match e {
                    Interval::Between { .. } if bounced => e,
                    _ => Interval::NotSeen,
                };
                slot.touched = true;
                (slot.friction, slot.own_friction) = own(f, friction);
                (slot.restitution, slot.own_restitution) = own(e, restitution);
            }
        }
        let ratios = self.met.iter().filter_map(|(one, other)| self.ratio(*one, *other));
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
        let (at, to) = (group.place(one)? + 2, group.place(other)? + 2);
        let scale = f64::from(self.settings.prior.mass_factor).ln() / QUARTILE;
        let given = |unit: usize| f64::from(self.setting.physics(unit).mass_kg).ln();
        let middle = given(one) - given(other);
        let error = f64::from(self.settings.model_error.shared_mass);
        let mut values = Vec::new();
        for (sample, weight) in group.posterior() {
            let value = middle + scale * (sample.get(at)? - sample.get(to)?);
            values.extend(NODES.iter().map(|node| (value + node * error, weight)));
        }
        let logistic = |part: f64| (part / (1.0 - part)).ln();
        let mut before: Vec<(f64, f64)> = even()
            .flat_map(|a| even().map(move |b| (middle + scale * (logistic(a) - logistic(b)), 1.0)))
            .collect();
        let ratio = Interval::of(&mut values, &mut before).map(f64::exp);
        Some(MassRatio { units: [one, other], ratio })
    }
}

/// Squared residuals of a cluster in a window.
struct Misfit {
    group: usize,
    /// Residuals that the start cannot make up for.
    freedom: f64,
    /// Whether something hits something.
    rough: bool,
    /// Steps over which misfit that noise does not explain lasts.
    lasting: f64,
    /// (particles)
    squares: Vec<f64>,
}

/// The particle that fits best, where no window says how large residuals are but that they are no less than noise.
fn likeliest(misfits: &[&Misfit], particles: usize) -> usize {
    let total = |particle: usize| {
        let of = |misfit: &&Misfit| {
            let ratio = misfit.squares[particle] / misfit.freedom;
            misfit.freedom * if ratio < 1.0 { ratio } else { 1.0 + ratio.ln() }
        };
        misfits.iter().map(of).sum::<f64>()
    };
    (0..particles).min_by(|a, b| total(*a).total_cmp(&total(*b))).unwrap_or(0)
}

/// Evenly from 0 to 1, without both.
fn even() -> impl Iterator<Item = f64> {
    (0..PRIOR_VALUES).map(|i| (i as f64 + 0.5) / PRIOR_VALUES as f64)
}
