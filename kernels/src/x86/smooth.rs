//! Loops over the exponential function, in the arithmetic of `math::exp`.
//!
//! The operations of one exponential depend on each other, so several registers take each step together.

use super::wide::Wide;

/// Registers that take a step together.
const INTERLEAVED: usize = 4;

// The constants of `math::exp`: other ones would give other bits.
const RANGE: (f32, f32) = (-86.0, 88.0);
const SHIFT: f32 = 12_582_912.0;
const LN_2: (f32, f32) = (0.693_359_4, -2.121_944_4e-4);
const POWERS: [f32; 5] = [1.381_454e-3, 8.368_745e-3, 4.166_839e-2, 1.666_652_1e-1, 4.999_999_4e-1];

/// `math::exp` of each number.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
unsafe fn exp<V: Wide, const N: usize>(x: [V; N]) -> [V; N] {
    // SAFETY: the instructions by this function's contract; constants are read through references.
    unsafe {
        let (low, high) = (V::splat(&RANGE.0), V::splat(&RANGE.1));
        let (log2, shift) = (V::splat(&std::f32::consts::LOG2_E), V::splat(&SHIFT));
        let (mut r, mut shifted, mut n) = (x, x, x);
        for r in &mut r {
            // NaN stays NaN: `most` and `least` return `self` where a number is none.
            *r = r.most(low).least(high);
        }
        for i in 0..N {
            shifted[i] = r[i].mul(log2);
        }
        for shifted in &mut shifted {
            *shifted = shifted.add(shift);
        }
        for i in 0..N {
            n[i] = shifted[i].sub(shift);
        }
        for term in [LN_2.0, LN_2.1] {
            let term = V::splat(&term);
            for i in 0..N {
                r[i] = r[i].sub(n[i].mul(term));
            }
        }
        let one = V::splat(&1.0);
        let [first, rest @ ..] = POWERS;
        let mut p = [V::splat(&first); N];
        for c in rest {
            step(&mut p, r, V::splat(&c));
        }
        step(&mut p, r, one);
        step(&mut p, r, one);
        for (p, shifted) in p.iter_mut().zip(shifted) {
            *p = p.mul(shifted.power());
        }
        p
    }
}

/// p r + c
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
unsafe fn step<V: Wide, const N: usize>(p: &mut [V; N], r: [V; N], c: V) {
    // SAFETY: the instructions by this function's contract.
    unsafe {
        for (p, r) in p.iter_mut().zip(r) {
            *p = p.mul(r);
        }
        for p in p.iter_mut() {
            *p = p.add(c);
        }
    }
}

/// An elementwise function of numbers and others beside them.
trait Function<V> {
    /// Values of the function.
    ///
    /// # Safety
    /// The processor has the instructions of `V`.
    unsafe fn of<const N: usize>(&self, x: [V; N], others: [V; N]) -> [V; N];
}

/// Replaces `N` registers' numbers.
///
/// # Safety
/// The processor has the instructions of `V`. `N * V::WIDTH` numbers may be read and written from
/// `from` on, and read from `others` on, which may be the same.
#[inline(always)]
unsafe fn some<V: Wide, const N: usize>(
    from: *mut f32,
    others: *const f32,
    function: &impl Function<V>,
) {
    // SAFETY: by this function's contract the instructions, and `N` registers' numbers at `from`
    // and at `others`.
    unsafe {
        let (mut x, mut beside) = ([V::zero(); N], [V::zero(); N]);
        for i in 0..N {
            x[i] = V::load(from.add(i * V::WIDTH));
            beside[i] = V::load(others.add(i * V::WIDTH));
        }
        let y = function.of(x, beside);
        for (i, y) in y.iter().enumerate() {
            y.store(from.add(i * V::WIDTH));
        }
    }
}

/// Replaces `length` numbers; there are as many others.
///
/// # Safety
/// The processor has the instructions of `V`. `length` numbers may be read and written from `from`
/// on, and read from `others` on, which may be the same place.
#[inline(always)]
unsafe fn each<V: Wide>(
    (from, length): (*mut f32, usize),
    others: *const f32,
    function: impl Function<V>,
) {
    let mut at = 0;
    // SAFETY: the instructions by this function's contract. `at` and as many registers as are taken
    // stay within `length`, and so within both; the rest is less than a register, as
    // `load_some` and `store_some` ask.
    unsafe {
        while at + INTERLEAVED * V::WIDTH <= length {
            some::<V, INTERLEAVED>(from.add(at), others.add(at), &function);
            at += INTERLEAVED * V::WIDTH;
        }
        // A head may have fewer channels than four registers.
        while at + 2 * V::WIDTH <= length {
            some::<V, 2>(from.add(at), others.add(at), &function);
            at += 2 * V::WIDTH;
        }
        while at + V::WIDTH <= length {
            let [y] = function.of([V::load(from.add(at))], [V::load(others.add(at))]);
            y.store(from.add(at));
            at += V::WIDTH;
        }
        let rest = length - at;
        if rest > 0 {
            let load = |from: *const f32| V::load_some(from.add(at), rest, V::zero());
            let [y] = function.of([load(from)], [load(others)]);
            y.store_some(from.add(at), rest);
        }
    }
}

struct Exponential;

impl<V: Wide> Function<V> for Exponential {
    #[inline(always)]
    unsafe fn of<const N: usize>(&self, x: [V; N], _: [V; N]) -> [V; N] {
        // SAFETY: `Function::of` asks for the instructions of `V`, as do its steps.
        unsafe { exp(x) }
    }
}

/// As `Kernels::exp`.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
pub(super) unsafe fn exponential<V: Wide>(x: &mut [f32]) {
    let (length, from) = (x.len(), x.as_mut_ptr());
    // SAFETY: the instructions by this function's contract; the others are the numbers themselves, as
    // many.
    unsafe { each::<V>((from, length), from, Exponential) }
}

struct ExponentialLess<V> {
    less: V,
}

impl<V: Wide> Function<V> for ExponentialLess<V> {
    #[inline(always)]
    unsafe fn of<const N: usize>(&self, x: [V; N], _: [V; N]) -> [V; N] {
        // SAFETY: `Function::of` asks for the instructions of `V`, as do its steps.
        unsafe {
            let mut x = x;
            for x in &mut x {
                *x = x.sub(self.less);
            }
            exp(x)
        }
    }
}

/// e to each number less that of `less` in its place; whole registers.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
pub(super) unsafe fn exponential_less<V: Wide>(x: &mut [f32], less: V) {
    let (length, from) = (x.len(), x.as_mut_ptr());
    // SAFETY: the instructions by this function's contract; the others are the numbers themselves, as
    // many.
    unsafe { each::<V>((from, length), from, ExponentialLess { less }) }
}

struct Silu;

impl<V: Wide> Function<V> for Silu {
    #[inline(always)]
    unsafe fn of<const N: usize>(&self, x: [V; N], _: [V; N]) -> [V; N] {
        // SAFETY: `Function::of` asks for the instructions of `V`, as do its steps.
        unsafe {
            let mut y = x;
            for y in &mut y {
                *y = y.negative();
            }
            let mut y = exp(y);
            for (y, x) in y.iter_mut().zip(x) {
                *y = x.div(V::splat(&1.0).add(*y));
            }
            y
        }
    }
}

/// As `Kernels::silu`.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
pub(super) unsafe fn silu<V: Wide>(x: &mut [f32]) {
    let (length, from) = (x.len(), x.as_mut_ptr());
    // SAFETY: the instructions by this function's contract; the others are the numbers themselves, as
    // many.
    unsafe { each::<V>((from, length), from, Silu) }
}

struct Gate {
    share: f32,
}

impl<V: Wide> Function<V> for Gate {
    #[inline(always)]
    unsafe fn of<const N: usize>(&self, x: [V; N], gate: [V; N]) -> [V; N] {
        // SAFETY: `Function::of` asks for the instructions of `V`, as do its steps.
        unsafe {
            let (one, share) = (V::splat(&1.0), V::splat(&self.share));
            let mut y = gate;
            for y in &mut y {
                *y = y.negative();
            }
            let mut y = exp(y);
            for (y, x) in y.iter_mut().zip(x) {
                *y = x.mul(share).mul(one.div(one.add(*y)));
            }
            y
        }
    }
}

/// As `Kernels::gate`.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
pub(super) unsafe fn gate<V: Wide>(x: &mut [f32], share: f32, gate: &[f32]) {
    let length = x.len().min(gate.len());
    // SAFETY: the instructions by this function's contract; `x`, cut to `length`, has no more
    // numbers than `gate`.
    unsafe { each::<V>((x.as_mut_ptr(), length), gate.as_ptr(), Gate { share }) }
}

/// The largest number, or negative infinity.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
unsafe fn largest<V: Wide>(numbers: &[f32]) -> f32 {
    let (from, length) = (numbers.as_ptr(), numbers.len());
    // SAFETY: the instructions by this function's contract. `at` and a register's numbers stay
    // within `length`; the rest is less than a register, as `load_some` asks.
    unsafe {
        let lowest = V::splat(&f32::NEG_INFINITY);
        let (mut most, mut at) = (lowest, 0);
        // A NaN in memory is ignored: `most` returns `self` then.
        while at + V::WIDTH <= length {
            most = most.most(V::load(from.add(at)));
            at += V::WIDTH;
        }
        if at < length {
            most = most.most(V::load_some(from.add(at), length - at, lowest));
        }
        most.largest()
    }
}

/// As `Kernels::softmax`.
///
/// # Safety
/// The processor has the instructions of `V`.
#[inline(always)]
pub(super) unsafe fn softmax<V: Wide>(scores: &mut [f32]) -> f32 {
    // SAFETY: the instructions by this function's contract; the others are the numbers themselves, as
    // many.
    unsafe {
        let largest = largest::<V>(scores);
        let (length, from) = (scores.len(), scores.as_mut_ptr());
        each::<V>((from, length), from, ExponentialLess { less: V::splat(&largest) });
    }
    // The order of the portable kernel: one sum, from left to right.
    scores.iter().fold(0.0, |total, score| total + score)
}
