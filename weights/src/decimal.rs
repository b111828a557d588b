//! Numbers in messages.

use core::fmt::{Display, Formatter, Result};

/// Shows a number to six digits, as messages do. What `core` shows tells an f32 from all others, and takes 13 kB of flash.
///
/// ```
/// use rigidformer_weights::Decimal;
/// assert_eq!(format!("{} s", Decimal(1.0 / 60.0)), "0.0166667 s");
/// assert_eq!(format!("{}", Decimal(2.5e-12)), "2.5e-12");
/// ```
pub struct Decimal(pub f32);

/// The greatest power of ten that is a u32; such are exact in f32 too.
const MOST_POWER: u32 = 9;

/// A number as so many times a power of ten.
fn scaled(size: f32, exponent: i32) -> f32 {
    let (mut scaled, mut left) = (size, exponent.unsigned_abs());
    while left > 0 {
        let part = left.min(MOST_POWER);
        let power = 10_u32.pow(part) as f32;
        scaled = if exponent < 0 { scaled * power } else { scaled / power };
        left = left.saturating_sub(part);
    }
    scaled
}

/// As [`Decimal`], of a positive number the greatest of six digits that is no greater: a limit that is read off a message holds.
///
/// ```
/// use rigidformer_weights::AtMost;
/// assert_eq!(format!("{} s", AtMost(0.530_591_7)), "0.530591 s");
/// ```
pub struct AtMost(pub f32);

impl Display for Decimal {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        write_rounded(f, self.0, 0.5)
    }
}

impl Display for AtMost {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        write_rounded(f, self.0, 0.0)
    }
}

/// Writes a number; `half` is added to its sixth digit before the others are left out.
fn write_rounded(f: &mut Formatter<'_>, number: f32, half: f32) -> Result {
    if number.is_nan() {
        return f.write_str("NaN");
    }
    if number < 0.0 {
        f.write_str("-")?;
    }
    if number.is_infinite() {
        return f.write_str("inf");
    }
    // From the least f32 to the greatest; the first has six digits.
    let size = number.abs();
    let mut exponent = (-51..33).find(|e| scaled(size, *e) < 1e6 - half).unwrap_or(33);
    let mut digits = (scaled(size, exponent) + half) as u32;
    while digits > 0 && digits.is_multiple_of(10) {
        (digits, exponent) = (digits / 10, exponent.saturating_add(1));
    }
    let power = 10_u32.checked_pow(exponent.unsigned_abs());
    if digits == 0 {
        return f.write_str("0");
    }
    if exponent < 0 && power.is_some() {
        return write_with_point(f, digits, exponent.unsigned_abs());
    }
    if let Some(whole) = power.and_then(|power| digits.checked_mul(power)) {
        return write!(f, "{whole}");
    }
    let places = digits.ilog10();
    write_with_point(f, digits, places)?;
    write!(f, "e{}", exponent.saturating_add_unsigned(places))
}

/// Writes digits, so many of them behind a point.
fn write_with_point(f: &mut Formatter<'_>, digits: u32, places: u32) -> Result {
    let power = 10_u32.saturating_pow(places);
    let whole = digits.checked_div(power).unwrap_or_default();
    write!(f, "{whole}")?;
    match digits.checked_rem(power) {
        Some(rest) if places > 0 => write!(f, ".{rest:0width$}", width = places as usize),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::{AtMost, Decimal};
    use std::string::ToString;

    #[test]
    fn numbers_read_as_they_are() {
        let cases: [(f32, &str); 18] = [
            (0.0, "0"),
            (-0.0, "0"),
            (0.01, "0.01"),
            (-0.05, "-0.05"),
            (5.0 / 240.0, "0.0208333"),
            (1e-6, "0.000001"),
            (1.25e-9, "1.25e-9"),
            (2e-12, "2e-12"),
            (1.5e30, "1.5e30"),
            (999_999.9, "1000000"),
            (99_999.96, "100000"),
            (123_456.0, "123456"),
            (1e9, "1000000000"),
            (1e30, "1e30"),
            (30.0, "30"),
            (f32::NAN, "NaN"),
            (f32::INFINITY, "inf"),
            (f32::NEG_INFINITY, "-inf"),
        ];
        for (number, expected) in cases {
            assert_eq!(Decimal(number).to_string(), expected, "{number}");
        }
    }

    #[test]
    fn limits_hold_as_they_are_read() {
        for limit in (1..100_000).map(|k| k as f32 * 1.7e-5) {
            let read: f32 = AtMost(limit).to_string().parse().unwrap();
            assert!(read <= limit && read > limit * (1.0 - 1.2e-5), "{limit} {read}");
        }
        assert_eq!(AtMost(0.7).to_string(), "0.7");
        assert_eq!(AtMost(999_999.9).to_string(), "999999");
    }

    #[test]
    fn six_digits_are_right() {
        let mut bits = 1_u32;
        while bits < f32::INFINITY.to_bits() {
            let number = f32::from_bits(bits);
            let read: f64 = Decimal(number).to_string().parse().unwrap();
            let error = (read / f64::from(number) - 1.0).abs();
            let few = f64::from_bits(1) + 1e-45 / f64::from(number);
            assert!(error < 1e-5 + few, "{number:e}: {read:e}");
            bits += 99_991;
        }
    }
}
