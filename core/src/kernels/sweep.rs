//! Sweeps of impulses over contacts that share no unit that moves, several at a time: of finite numbers the bits of the solver's sweeps
//! one by one.

use super::goal::Goal;
use crate::geometry::STATE;
use crate::math;

/// Contacts of a block.
pub const WIDE: usize = 8;
/// Numbers of one in a block: impulses, row and units, arms and axes, weights and what is wanted, what an impulse changes of its units.
pub(crate) const FIELDS: usize = 4 + 3 + 12 + 11 + 14;
/// One number of each contact of a block.
pub type Lane = [f32; WIDE];
/// Contacts of which no two change the motion of one unit, lane by lane.
pub type Block = [Lane; FIELDS];
/// Velocity and spin of a unit, and what the solver knows of it besides.
pub type Motion = [f32; STATE + 1];
/// Number of no unit.
pub(crate) const NOBODY: f32 = f32::MAX;

/// So many numbers at a time, of [`WIDE`] or a part of them: IEEE 754's arithmetic, each operation rounded.
pub trait Vector: Copy {
    /// Numbers; [`WIDE`] is a multiple.
    const WIDTH: usize;
    /// Yes or no for each.
    type Mask: Copy;

    /// The numbers of a part of a lane.
    fn load(from: &Lane, part: usize) -> Self;
    /// Keeps them there.
    fn store(self, to: &mut Lane, part: usize);
    /// One number everywhere.
    fn splat(x: f32) -> Self;
    /// Sums.
    fn plus(self, other: Self) -> Self;
    /// Differences.
    fn minus(self, other: Self) -> Self;
    /// Products.
    fn times(self, other: Self) -> Self;
    /// Quotients.
    fn over(self, other: Self) -> Self;
    /// Square roots.
    fn root(self) -> Self;
    /// Whether each is greater.
    fn above(self, other: Self) -> Self::Mask;
    /// Those of `yes` where `mask` says so.
    fn choose(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// Whether `mask` says so of any.
    fn any(mask: Self::Mask) -> bool;
}

/// One at a time.
impl Vector for f32 {
    const WIDTH: usize = 1;
    type Mask = bool;

    #[inline(always)]
    fn load(from: &Lane, part: usize) -> Self {
        at(from, part)
    }

    #[inline(always)]
    fn store(self, to: &mut Lane, part: usize) {
        put(to, part, self);
    }

    #[inline(always)]
    fn splat(x: f32) -> Self {
        x
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        self + other
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self - other
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        self * other
    }

    #[inline(always)]
    fn over(self, other: Self) -> Self {
        self / other
    }

    #[inline(always)]
    fn root(self) -> Self {
        math::sqrt(self)
    }

    #[inline(always)]
    fn above(self, other: Self) -> bool {
        self > other
    }

    #[inline(always)]
    fn choose(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }

    #[inline(always)]
    fn any(mask: bool) -> bool {
        mask
    }
}

/// A vector of space for each.
type Space<V> = [V; 3];

#[inline(always)]
fn plus<V: Vector>([a, b, c]: Space<V>, [x, y, z]: Space<V>) -> Space<V> {
    [a.plus(x), b.plus(y), c.plus(z)]
}

#[inline(always)]
fn minus<V: Vector>([a, b, c]: Space<V>, [x, y, z]: Space<V>) -> Space<V> {
    [a.minus(x), b.minus(y), c.minus(z)]
}

#[inline(always)]
fn times<V: Vector>(a: Space<V>, by: V) -> Space<V> {
    a.map(|number| number.times(by))
}

#[inline(always)]
fn opposite<V: Vector>(a: Space<V>) -> Space<V> {
    times(a, V::splat(-1.0))
}

#[inline(always)]
fn dot<V: Vector>([a, b, c]: Space<V>, [x, y, z]: Space<V>) -> V {
    a.times(x).plus(b.times(y)).plus(c.times(z))
}

#[inline(always)]
fn cross<V: Vector>([a, b, c]: Space<V>, [x, y, z]: Space<V>) -> Space<V> {
    [b.times(z).minus(c.times(y)), c.times(x).minus(a.times(z)), a.times(y).minus(b.times(x))]
}

#[inline(always)]
fn choose<V: Vector>(mask: V::Mask, [a, b, c]: Space<V>, [x, y, z]: Space<V>) -> Space<V> {
    [V::choose(mask, a, x), V::choose(mask, b, y), V::choose(mask, c, z)]
}

/// Velocity and spin of one unit of a contact, and what an impulse changes of it.
#[derive(Clone, Copy)]
struct Side<V> {
    velocity: Space<V>,
    spin: Space<V>,
    lightness: V,
    inverse: [V; 6],
}

impl<V: Vector> Side<V> {
    #[inline(always)]
    fn new(motions: &Motions, lightness: &Lane, inverse: [&Lane; 6], part: usize) -> Self {
        let [a, b, c, d, e, f] = motions;
        Side {
            velocity: [a, b, c].map(|lane| V::load(lane, part)),
            spin: [d, e, f].map(|lane| V::load(lane, part)),
            lightness: V::load(lightness, part),
            inverse: inverse.map(|lane| V::load(lane, part)),
        }
    }

    #[inline(always)]
    fn keep(&self, motions: &mut Motions, part: usize) {
        let ([a, b, c, d, e, f], [u, v, w], [x, y, z]) = (motions, self.velocity, self.spin);
        for (lane, number) in [(a, u), (b, v), (c, w), (d, x), (e, y), (f, z)] {
            number.store(lane, part);
        }
    }

    #[inline(always)]
    fn speed_at(&self, arm: Space<V>) -> Space<V> {
        plus(self.velocity, cross(self.spin, arm))
    }

    #[inline(always)]
    fn turns(&self, [x, y, z]: Space<V>) -> Space<V> {
        let [xx, yy, zz, xy, xz, yz] = self.inverse;
        [
            xx.times(x).plus(xy.times(y)).plus(xz.times(z)),
            xy.times(x).plus(yy.times(y)).plus(yz.times(z)),
            xz.times(x).plus(yz.times(y)).plus(zz.times(z)),
        ]
    }

    #[inline(always)]
    fn push(&mut self, arm: Space<V>, impulse: Space<V>) {
        self.velocity = plus(self.velocity, times(impulse, self.lightness));
        self.spin = plus(self.spin, self.turns(cross(arm, impulse)));
    }

    #[inline(always)]
    fn hold(&mut self, held: V::Mask) {
        let zero = V::splat(0.0);
        self.lightness = V::choose(held, zero, self.lightness);
        self.inverse = self.inverse.map(|number| V::choose(held, zero, number));
    }
}

/// Velocities and spins of the units of a block's contacts.
type Motions = [Lane; 6];

/// A number of a lane.
#[inline(always)]
pub(crate) fn at(lane: &Lane, number: usize) -> f32 {
    lane.get(number).copied().unwrap_or_default()
}

/// Keeps a number of a lane.
#[inline(always)]
pub(crate) fn put(lane: &mut Lane, number: usize, value: f32) {
    if let Some(there) = lane.get_mut(number) {
        *there = value;
    }
}

#[inline(always)]
fn gather(motions: &[Motion], units: &Lane) -> Motions {
    let mut of = [[0.0; WIDE]; 6];
    let [a, b, c, d, e, f] = &mut of;
    for number in 0..WIDE {
        // A plane does not move, and has no row.
        if let Some([u, v, w, x, y, z, ..]) = motions.get(at(units, number) as usize) {
            for (lane, value) in [(&mut *a, u), (b, v), (c, w), (d, x), (e, y), (f, z)] {
                put(lane, number, *value);
            }
        }
    }
    of
}

#[inline(always)]
fn scatter(motions: &mut [Motion], units: &Lane, of: &Motions, acts: &Lane) {
    let [a, b, c, d, e, f] = of;
    for number in 0..WIDE {
        if at(acts, number) == 0.0 {
            continue;
        }
        if let Some([u, v, w, x, y, z, ..]) = motions.get_mut(at(units, number) as usize) {
            [*u, *v, *w] = [a, b, c].map(|lane| at(lane, number));
            [*x, *y, *z] = [d, e, f].map(|lane| at(lane, number));
        }
    }
}

/// A sweep over blocks, upwards or downwards. Whether any contact had an impulse.
#[inline(always)]
pub fn sweep<V: Vector>(
    blocks: &mut [Block],
    motions: &mut [Motion],
    (goal, upwards): (Goal, bool),
) -> bool {
    match goal {
        Goal::Stop => in_order::<V, false, false>(blocks, motions, upwards),
        Goal::Settle => in_order::<V, true, false>(blocks, motions, upwards),
        Goal::Bounce => in_order::<V, false, true>(blocks, motions, upwards),
    }
}

#[inline(always)]
fn in_order<V: Vector, const SETTLE: bool, const BOUNCE: bool>(
    blocks: &mut [Block],
    motions: &mut [Motion],
    upwards: bool,
) -> bool {
    let (mut any, count) = (false, blocks.len());
    for number in 0..count {
        let number = if upwards { number } else { count - 1 - number };
        if let Some(block) = blocks.get_mut(number) {
            any |= resolve::<V, SETTLE, BOUNCE>(block, motions);
        }
    }
    any
}

/// One impulse at each contact of a block. Whether any had one.
#[inline(always)]
fn resolve<V: Vector, const SETTLE: bool, const BOUNCE: bool>(
    block: &mut Block,
    motions: &mut [Motion],
) -> bool {
    #[rustfmt::skip]
    let [along, across, aside, twist, _, first, second, ax, ay, az, bx, by, bz, nx, ny, nz, tx, ty, tz,
        heavy, heavy_across, heavy_aside, stiffness, wanted, rebound, friction, held, middle, arm, heavy_twist,
        lightness, xx, yy, zz, xy, xz, yz, other_lightness, uu, vv, ww, uv, uw, vw] = block;
    // Contacts without an impulse did not touch, and do not bounce.
    if BOUNCE && !along.iter().any(|along| *along > 0.0) {
        return false;
    }
    let (mut froms, mut tos) = (gather(motions, first), gather(motions, second));
    let mut acts = [0.0; WIDE];
    let zero = V::splat(0.0);
    for part in 0..WIDE / V::WIDTH {
        let load = |lane: &Lane| V::load(lane, part);
        let vector = |lanes: [&Lane; 3]| lanes.map(load);
        let mut from = Side::<V>::new(&froms, lightness, [xx, yy, zz, xy, xz, yz], part);
        let mut to = Side::<V>::new(&tos, other_lightness, [uu, vv, ww, uv, uw, vw], part);
        let (own, other) = (vector([ax, ay, az]), vector([bx, by, bz]));
        let (n, t) = (vector([nx, ny, nz]), vector([tx, ty, tz]));
        let b = cross(n, t);
        let [before, slid, slid_aside, whirled] = [&*along, across, aside, twist].map(load);
        let mut weight = load(heavy);
        if SETTLE {
            weight = weight.times(load(stiffness));
            from.hold(zero.above(load(held)));
            to.hold(load(held).above(zero));
        }
        let leaving = dot(minus(to.speed_at(other), from.speed_at(own)), n);
        let aim = load(if BOUNCE { rebound } else { wanted });
        let after = before.plus(aim.minus(leaving).times(weight));
        let after = V::choose(after.above(zero), after, zero);
        let size = |number: V| V::choose(number.above(zero), number, zero.minus(number));
        let sizes = after.plus(before).plus(size(slid).plus(size(slid_aside)));
        let mut is_there = V::choose(sizes.above(zero), V::splat(1.0), zero);
        if BOUNCE {
            is_there = V::choose(before.above(zero), is_there, zero);
        }
        let there = is_there.above(zero);
        if !V::any(there) {
            continue;
        }
        is_there.store(&mut acts, part);
        let impulse = times(n, after.minus(before));
        to.push(other, impulse);
        from.push(own, opposite(impulse));

        let is_middle = load(middle).above(zero);
        let (arm, sliding) = (load(arm), minus(to.speed_at(other), from.speed_at(own)));
        let spin = dot(minus(to.spin, from.spin), n);
        let whirl = whirled.minus(spin.times(arm).times(load(heavy_twist)));
        let turn = times(n, whirl.minus(whirled).times(arm));
        let braked = plus(cross(to.turns(turn), other), cross(from.turns(turn), own));
        let sliding = choose(is_middle, plus(sliding, braked), sliding);
        let whirl = V::choose(is_middle, whirl, zero);
        let p = slid.minus(dot(sliding, t).times(load(heavy_across)));
        let q = slid_aside.minus(dot(sliding, b).times(load(heavy_aside)));
        let size = p.times(p).plus(q.times(q)).plus(whirl.times(whirl)).root();
        let limit = load(friction);
        let most = V::choose(zero.above(limit), zero.minus(limit), limit).times(after);
        let share = V::choose(size.above(most), most.over(size), V::splat(1.0));
        let is_pyramid = zero.above(limit);
        let within = |impulse: V| {
            // As one by one, zeros and all: a pyramid's coefficient is below 0.
            let least = limit.times(after);
            let own = V::choose(least.above(impulse), least, impulse);
            let own = V::choose(impulse.above(most), most, own);
            V::choose(is_pyramid, own, impulse.times(share))
        };
        let (p, q, whirl) = (within(p), within(q), within(whirl));
        let impulse = plus(times(t, p.minus(slid)), times(b, q.minus(slid_aside)));
        to.push(other, impulse);
        from.push(own, opposite(impulse));
        let turn = times(n, whirl.minus(whirled).times(arm));
        to.spin = choose(is_middle, plus(to.spin, to.turns(turn)), to.spin);
        from.spin = choose(is_middle, plus(from.spin, from.turns(opposite(turn))), from.spin);

        V::choose(there, after, before).store(along, part);
        V::choose(there, p, slid).store(across, part);
        V::choose(there, q, slid_aside).store(aside, part);
        // Contacts without a twist keep 0.
        V::choose(there, whirl, whirled).store(twist, part);
        from.keep(&mut froms, part);
        to.keep(&mut tos, part);
    }
    scatter(motions, first, &froms, &acts);
    scatter(motions, second, &tos, &acts);
    acts.iter().any(|acts| *acts > 0.0)
}
