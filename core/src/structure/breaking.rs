//! Which bonds break in a step (docs/MODEL.md, section 7): a network says so of each, from the tokens of its two units and from what
//! the solver does to their cluster while all bonds hold.

use crate::contact::prior::{self, Solved};
use crate::geometry::{STATE, State, dot, norm, rotate, rotate_back};
use crate::kernels::Schedule;
use crate::math;
use crate::model::Model;
use crate::scene::{Scene, UnitSlot, members};
use crate::sizes::Sizes;
use crate::slices::{rows, slice_at, slice_at_mut};
use crate::structure::bonds::{Bonds, Kept, Seam, group, hold_together, keep_bodies, restore};
use crate::structure::stage::{Attempt, Structure};
use crate::workspace::{BOND_TILE, Rows};
use nalgebra::{Point3, Vector3};
use rigidformer_weights::BOND_FEATURES;

impl Structure for Bonds<'_> {
    fn constrain<S: Schedule>(_: S, attempt: Attempt<'_, '_>) -> Result<(), usize> {
        let Attempt { sizes, scene, copy, solved, next, .. } = attempt;
        if sizes.solved == 0 {
            return Ok(());
        }
        let any = hold_together(scene, copy * scene.per_copy, solved, next);
        let nowhere = |row: &[f32]| !scene.measure.allows(&State::read(row));
        rows(next, STATE).position(nowhere).filter(|_| any).map_or(Ok(()), Err)
    }

    fn come_apart<S: Schedule>(
        &mut self,
        schedule: S,
        (model, sizes): (&Model<'_>, &Sizes),
        scene: &mut Scene<'_>,
        (solved, w): (&[f32], &mut Rows<'_>),
    ) -> bool {
        if model.breaking.is_none() || self.len() == 0 {
            return false;
        }
        keep_bodies(scene.units_mut());
        let mut any = false;
        for copy in 0..scene.copies() {
            any |= break_bonds(schedule, model, sizes, scene, (self, copy), (solved, w));
        }
        any
    }

    fn finish(&mut self, model: &Model<'_>, scene: &mut Scene<'_>, copy: usize, has_failed: bool) {
        if model.breaking.is_some() && self.confirm(copy, has_failed) > 0 && has_failed {
            let per_copy = scene.per_copy;
            let units = scene.units_mut().chunks_exact_mut(per_copy.max(1)).nth(copy);
            restore(units.unwrap_or_default(), self.of(copy));
        }
    }
}

/// Points of two units touch that are closer than this share of the smaller radius: points are samples, so those of two
/// faces that meet do not coincide.
const TOUCH: f32 = 0.12;
/// Pairs of points that are looked at, at most: what a bond costs is bounded, and a fixed array holds them.
const TOUCHES: usize = 32;
/// Normalised inputs are clamped to this: what training did not see cannot drive the network without bound.
const CLAMP: f32 = 8.0;
/// Added to a spread before its logarithm, m^2: a bond at one point has none.
const LEAST_M2: f32 = 1e-4;
/// Added to a momentum before its logarithm, kg m/s: what nothing pushes has none.
const LEAST_KG_M_S: f32 = 1e-2;
/// Heights over planes are told up to this, metres: a bounded input, as gaps are.
const HIGH_M: f32 = 1.0;

/// Where two units of a copy meet, as they lie.
pub(crate) fn seam(scene: &Scene<'_>, copy: usize, [a, b]: [usize; 2]) -> Seam {
    let first = copy * scene.per_copy;
    let (Some(a), Some(b)) = (scene.units().get(first + a), scene.units().get(first + b)) else {
        return Seam::default();
    };
    let reach = TOUCH * a.radius.min(b.radius);
    let mut places = heapless::Vec::<Vector3<f32>, TOUCHES>::new();
    // Levers from the first unit's centre, so that nothing is lost far from the origin.
    let between = b.current.centre - a.current.centre;
    'pairs: for one in points_of(scene, a) {
        let one = rotate(&a.current.rotation, &one.coords);
        for other in points_of(scene, b) {
            let other = rotate(&b.current.rotation, &other.coords) + between;
            let apart = other - one;
            if dot(&apart, &apart) < reach * reach && places.push((one + other) * 0.5).is_err() {
                break 'pairs;
            }
        }
    }
    let touches = places.len() as f32;
    if places.is_empty() {
        let middle = rotate_back(&a.current.rotation, &between) * 0.5;
        return Seam { spread_m2: 0.0, touches, middle: middle.into() };
    }
    let middle = places.iter().fold(Vector3::zeros(), |sum, place| sum + place) / touches;
    let mut area = 0.0;
    for (number, one) in places.iter().enumerate() {
        for other in places.iter().skip(number + 1) {
            area += norm(&(one - middle).cross(&(other - middle)));
        }
    }
    let pairs = (touches * (touches - 1.0) * 0.5).max(1.0);
    let local = rotate_back(&a.current.rotation, &middle);
    Seam { spread_m2: 0.5 * area / pairs, touches, middle: local.into() }
}

/// Points of a unit, from its centre and in its axes.
fn points_of<'s>(scene: &'s Scene<'_>, unit: &UnitSlot) -> &'s [Point3<f32>] {
    scene.points.get(unit.start..unit.start + unit.count).unwrap_or_default()
}

/// Breaks the bonds of a copy that the network says break in the step, whose tokens and motion by impulses (`solved`) are those of
/// all bonds that hold. Whether there are any. What [`Bonds::confirm`] does not confirm holds again.
fn break_bonds<S: Schedule>(
    schedule: S,
    model: &Model<'_>,
    sizes: &Sizes,
    scene: &mut Scene<'_>,
    (bonds, copy): (&mut Bonds<'_>, usize),
    (solved, w): (&[f32], &mut Rows<'_>),
) -> bool {
    let Some(net) = &model.breaking else { return false };
    let first = copy * scene.per_copy;
    let (_, units) = scene.around(first);
    let context = scene.per_copy + sizes.registers;
    let tokens = slice_at(w.tokens, copy * context * sizes.width, scene.per_copy * sizes.width);
    let [inputs, hidden] = sizes.bonds;
    let mut any = false;
    let mut done = 0;
    while done < bonds.len() {
        let judge = Judge { scene, units, bonds, copy, solved, tokens, width: sizes.width };
        let mut asked = heapless::Vec::<usize, BOND_TILE>::new();
        for (number, bond) in bonds.of(copy).enumerate().skip(done) {
            done = number + 1;
            if bond.holds && judge.may_break(bond.pair) && asked.push(number).is_ok() {
                let row = slice_at_mut(w.bond_inputs, (asked.len() - 1) * inputs, inputs);
                judge.describe(&bond, row);
                let told = slice_at_mut(row, 2 * sizes.width, BOND_FEATURES);
                let scales = net.mean.iter().zip(net.scale);
                for (value, (mean, scale)) in told.iter_mut().zip(scales) {
                    *value = ((*value - mean) * scale).clamp(-CLAMP, CLAMP);
                }
                if asked.is_full() {
                    break;
                }
            }
        }
        let seen = slice_at(w.bond_inputs, 0, asked.len() * inputs);
        let hidden = slice_at_mut(w.bond_hidden, 0, asked.len() * hidden);
        let mut out = [0.0; BOND_TILE];
        let out = slice_at_mut(&mut out, 0, asked.len());
        net.net.apply(schedule, seen, hidden, out, &mut w.scratch);
        for (number, answer) in asked.iter().zip(out) {
            if *answer > 0.0 {
                bonds.strain(copy, *number);
                any = true;
            }
        }
    }
    if any {
        let per_copy = scene.per_copy;
        let units = scene.units_mut().get_mut(first..first + per_copy).unwrap_or_default();
        group(units, bonds.of(copy));
    }
    any
}

/// What is known of a copy while all its bonds hold.
struct Judge<'a> {
    scene: &'a Scene<'a>,
    /// Of the copy.
    units: &'a [UnitSlot],
    bonds: &'a Bonds<'a>,
    copy: usize,
    solved: &'a [f32],
    /// (units, width)
    tokens: &'a [f32],
    width: usize,
}

impl Judge<'_> {
    fn solved(&self, number: usize) -> Solved {
        prior::solved(self.scene, self.copy * self.scene.per_copy + number, self.solved)
    }

    /// Whether impulses act on one of the two: nothing breaks that flies freely or rests.
    fn may_break(&self, pair: [usize; 2]) -> bool {
        pair.into_iter().any(|number| self.solved(number).share > 0.0)
    }

    /// By how much impulses change a unit's velocity in the step, m/s.
    fn push(&self, number: usize, unit: &UnitSlot) -> Vector3<f32> {
        let Solved { next, .. } = self.solved(number);
        (next.course.way - unit.course.way) / self.scene.dt - self.scene.gravity * self.scene.dt
    }

    /// How high the lowest point of a unit is over the planes in the step, metres.
    fn low(&self, number: usize, unit: &UnitSlot) -> f32 {
        let next = self.solved(number).next.pose;
        let poses = [&unit.current, &next];
        self.scene.planes.iter().fold(HIGH_M, |low, plane| {
            poses.iter().fold(low, |low, pose| {
                let along = rotate_back(&pose.rotation, &plane.normal);
                let points = self.scene.hull_of(unit).iter();
                let below =
                    points.fold(0.0_f32, |below, point| below.min(dot(&along, &point.coords)));
                low.min(plane.height_here(&pose.centre) + below)
            })
        })
    }

    /// Bonds of a unit that hold.
    fn ends(&self, number: usize) -> f32 {
        let held = self.bonds.of(self.copy).filter(|bond| bond.holds || bond.breaks);
        held.filter(|bond| bond.pair.contains(&number)).fold(0.0, |ends, _| ends + 1.0)
    }

    /// Fills a row with the inputs of a bond: the sum of its units' tokens, how far they differ, and what is known of it besides.
    fn describe(&self, bond: &Kept, row: &mut [f32]) {
        let [a, b] = bond.pair;
        let (Some(one), Some(other)) = (self.units.get(a), self.units.get(b)) else { return };
        let (sums, rest) = row.split_at_mut(self.width.min(row.len()));
        let (differences, told) = rest.split_at_mut(self.width.min(rest.len()));
        let token = |unit: usize| slice_at(self.tokens, unit * self.width, self.width);
        let both = token(a).iter().zip(token(b));
        for ((x, y), (sum, difference)) in both.zip(sums.iter_mut().zip(differences)) {
            (*sum, *difference) = (x + y, (x - y).abs());
        }
        let Seam { spread_m2, touches, middle } = bond.seam;
        let middle = one.current.centre + rotate(&one.current.rotation, &Vector3::from(middle));
        let across = other.current.centre - one.current.centre;
        let apart = norm(&across);
        let normal = across / apart.max(1e-12);
        let pushes = [self.push(a, one), self.push(b, other)];
        let [x, y] = pushes;
        let (mean, odd) = ((x + y) * 0.5, x - y);
        let cluster_root = one.cluster_root().unwrap_or(a);
        let mut sides = [Vector3::zeros(); 2];
        let (mut mass, mut sum) = (0.0, Vector3::zeros());
        for (number, unit) in members(self.units, cluster_root) {
            let arm = unit.current.centre - middle;
            let momentum = self.push(number, unit) * unit.mass;
            let [near, far] = &mut sides;
            let side = if dot(&arm, &normal) > 0.0 { far } else { near };
            *side += momentum;
            mass += unit.mass;
            sum += arm * unit.mass;
        }
        let [near, far] = sides.map(|side| norm(&side));
        let [low, other_low] = [self.low(a, one), self.low(b, other)];
        let share = self.solved(a).share.max(self.solved(b).share);
        let values = [
            math::ln(spread_m2 + LEAST_M2),
            touches / 8.0,
            one.ln_mass + other.ln_mass,
            (one.ln_mass - other.ln_mass).abs(),
            apart,
            norm(&mean),
            norm(&odd),
            dot(&mean, &normal).abs(),
            math::ln(near.min(far) + LEAST_KG_M_S),
            math::ln(near.max(far) + LEAST_KG_M_S),
            norm(&(sum / mass)),
            share,
            low.min(other_low),
            low.max(other_low),
            self.ends(a).max(self.ends(b)) / 8.0,
            math::ln(mass),
        ];
        for (slot, value) in told.iter_mut().zip(values) {
            *slot = value;
        }
    }
}
