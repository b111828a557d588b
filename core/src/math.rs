//! The one place that every elementary function comes from, so that every target and every
//! kernel computes the same bits: plain f32 arithmetic in a fixed order, or `libm`'s portable
//! versions, never the platform's. Errors: `docs/MATH.md`.
//!
//! They compute as the thread is set; [`in_own_environment`](crate::kernels::in_own_environment) runs them to nearest.

/// 1 / ln 2.
pub(crate) const LOG2_E: f32 = core::f32::consts::LOG2_E;
/// ln 2 in two parts; the first has 9 bits, so that its products with whole numbers are exact.
pub(crate) const LN_2_HIGH: f32 = 0.693_359_4;
pub(crate) const LN_2_LOW: f32 = -2.121_944_4e-4;
/// 1.5 * 2^23: adding it leaves no bits behind the point, so that the sum's last bits are the
/// nearest integer.
pub(crate) const SHIFT: f32 = 12_582_912.0;
/// Where [`exp`] saturates.
pub(crate) const EXP_RANGE: (f32, f32) = (-86.0, 88.0);
/// e^r on |r| <= ln 2 / 2, relative error 3e-9 before rounding: coefficients of r^6 to r^2.
pub(crate) const EXP: [f32; 5] =
    [1.381_454e-3, 8.368_745e-3, 4.166_839e-2, 1.666_652_1e-1, 4.999_999_4e-1];

/// Where [`sin_cos`] saturates, radians.
const MOST_ANGLE: f32 = 1e5;
/// Half of pi in three parts; the first two have 8 and 11 bits, so that their products with small
/// whole numbers are exact.
const HALF_PI: [f32; 3] = [1.570_312_5, 4.837_513e-4, 7.549_79e-8];
/// sin r / r - 1 and cos r - 1 + r^2 / 2 on |r| <= pi / 4, in r^2, highest power first (the
/// polynomials of Cephes).
const SIN: [f32; 3] = [-1.951_529_6e-4, 8.332_161e-3, -1.666_665_5e-1];
const COS: [f32; 3] = [2.443_315_7e-5, -1.388_731_6e-3, 4.166_664_6e-2];

/// Square root, correctly rounded.
pub fn sqrt(x: f32) -> f32 {
    // Correct rounding leaves one answer, whoever computes it.
    #[cfg(rigidformer_dsp)]
    return crate::root::sqrt(x);
    #[cfg(not(rigidformer_dsp))]
    libm::sqrtf(x)
}

/// e to the x, within 1.2 units in the last place; saturates below -86 and above 88, so that
/// it is neither 0 nor infinite. NaN stays NaN.
///
/// Straight-line code of multiplications and additions that any SIMD unit repeats bit by bit.
///
/// ```
/// use rigidformer_core::math::exp;
/// assert_eq!(exp(0.0), 1.0);
/// assert!((exp(1.0) - core::f32::consts::E).abs() < 3e-7);
/// assert!(exp(-1e30) > 0.0 && exp(1e30) < f32::MAX && exp(f32::NAN).is_nan());
/// ```
// Its constants stay in registers through a loop, also where a firmware inlines little.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let (low, high) = EXP_RANGE;
    let x = x.clamp(low, high);
    let shifted = x * LOG2_E + SHIFT;
    let n = shifted - SHIFT;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let [first, rest @ ..] = EXP;
    let mut p = first;
    for c in rest {
        p = p * r + c;
    }
    let p = (p * r + 1.0) * r + 1.0;
    // n + 127 in the exponent's place; what else is in `shifted` falls off the top.
    let power = f32::from_bits((shifted.to_bits() << 23).wrapping_add(1.0_f32.to_bits()));
    p * power
}

/// [`exp`] for where it is rare: in one place of the code, not in each loop.
#[inline(never)]
pub(crate) fn exp_once(x: f32) -> f32 {
    exp(x)
}

/// Natural logarithm.
pub fn ln(x: f32) -> f32 {
    libm::logf(x)
}

/// Sine and cosine of an angle in radians, within 1e-7 up to 8000 rad and 1e-6 up to 1e5,
/// where they saturate: an f32 hardly tells one angle from the next there. NaN stays NaN.
///
/// In f32 alone: the processors that this is for have no f64, and `libm` reduces in f64.
///
/// ```
/// use rigidformer_core::math::sin_cos;
/// assert_eq!(sin_cos(0.0), (0.0, 1.0));
/// let (sin, cos) = sin_cos(-200.3);
/// assert!((sin - 0.690_316_8).abs() < 1e-6 && (cos - 0.723_507_3).abs() < 1e-6);
/// ```
pub fn sin_cos(x: f32) -> (f32, f32) {
    let x = x.clamp(-MOST_ANGLE, MOST_ANGLE);
    let shifted = x * core::f32::consts::FRAC_2_PI + SHIFT;
    let n = shifted - SHIFT;
    let [high, middle, low] = HALF_PI;
    let r = ((x - n * high) - n * middle) - n * low;
    let z = r * r;
    let [s0, s1, s2] = SIN;
    let [c0, c1, c2] = COS;
    let sin = ((s0 * z + s1) * z + s2) * z * r + r;
    let cos = ((c0 * z + c1) * z + c2) * (z * z) + (1.0 - 0.5 * z);
    // The quadrant is the number of quarter turns modulo four.
    let quadrant = shifted.to_bits();
    let (sin, cos) = if quadrant & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let negate = |x: f32, bits: u32| f32::from_bits(x.to_bits() ^ ((bits & 2) << 30));
    (negate(sin, quadrant), negate(cos, quadrant.wrapping_add(1)))
}

/// Logistic function, 1 / (1 + e^-x).
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// x times its logistic function (SiLU).
pub fn silu(x: f32) -> f32 {
    x / (1.0 + exp(-x))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Not 0, infinite or subnormal for anything but NaN: targets differ in what they make of
    /// subnormal numbers.
    #[test]
    fn exp_saturates_to_normal_numbers() {
        for x in [-f32::MAX, -1e4, -86.0, -85.99, 0.0, 87.99, 88.0, 1e4, f32::MAX] {
            assert!(exp(x).is_normal(), "{x}: {}", exp(x));
        }
        assert!(exp(f32::NEG_INFINITY).is_normal() && exp(f32::INFINITY).is_normal());
        for bits in [0x7fc0_0000, 0xffc0_0000, 0x7f80_0001, 0x7fff_ffff] {
            assert!(exp(f32::from_bits(bits)).is_nan());
        }
    }

    #[test]
    fn sines_are_bounded_wherever_they_are_asked_for() {
        for x in [1e4, -99_999.0, 1e5, 1e9, -f32::MAX, f32::INFINITY] {
            let (sin, cos) = sin_cos(x);
            assert!((sin * sin + cos * cos - 1.0).abs() < 1e-5, "{x}: {sin}, {cos}");
        }
        let (sin, cos) = sin_cos(f32::NAN);
        assert!(sin.is_nan() && cos.is_nan());
    }

    #[test]
    fn exp_rises() {
        let mut last = 0.0;
        for i in -860_000..=880_000 {
            let here = exp(i as f32 / 1e4);
            assert!(here >= last, "{i}");
            last = here;
        }
    }
}
