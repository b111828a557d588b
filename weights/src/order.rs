//! Comparisons of numbers by their bits. The floating-point environment of who reads a file may trap on its numbers, or take subnormal
//! ones for zeros; integers have none.

use core::hint::black_box;

/// The bits, which the compiler does not know to be a number's: it turns tests of a number's bits into comparisons of the number.
const fn bits(number: f32) -> u32 {
    black_box(number.to_bits())
}

/// Rises with the number; both zeros are 0. NaNs are beyond the infinities.
#[inline(never)]
pub(crate) const fn order(number: f32) -> i32 {
    let bits = bits(number);
    let size = (bits & 0x7fff_ffff) as i32;
    if bits >> 31 == 0 { size } else { size.wrapping_neg() }
}

/// As `f32::is_finite`.
#[inline(never)]
pub(crate) const fn is_finite(number: f32) -> bool {
    bits(number) & 0x7f80_0000 != 0x7f80_0000
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_compare_as_numbers_do() {
        let numbers = [
            f32::NEG_INFINITY,
            f32::MIN,
            -1.0,
            -f32::MIN_POSITIVE,
            -1e-45,
            -0.0,
            0.0,
            1e-45,
            1.0,
            f32::MAX,
            f32::INFINITY,
        ];
        for a in numbers {
            assert_eq!(is_finite(a), a.is_finite());
            for b in numbers {
                assert_eq!(order(a).cmp(&order(b)), a.partial_cmp(&b).unwrap(), "{a} {b}");
            }
        }
        for nan in [f32::NAN, -f32::NAN, f32::from_bits(0x7f80_0001)] {
            assert!(!is_finite(nan) && order(nan).abs() > order(f32::INFINITY));
        }
    }
}
