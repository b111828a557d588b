//! Arrays of numpy's npy format (its version 1 to 3), as `numpy.save` writes them.

use std::io::Read;

use rigidformer_runtime::files::shown;
use rigidformer_runtime::memory::{Budget, TooLarge};

/// Arrays as f64, whatever they were.
#[derive(Debug, PartialEq)]
pub(super) struct Array {
    pub(super) shape: Vec<usize>,
    pub(super) values: Vec<f64>,
}

const MAGIC: &[u8] = b"\x93NUMPY";
/// Types that are read: as numpy calls them, and their bytes.
const TYPES: [(&str, usize); 6] =
    [("<f4", 4), ("<f8", 8), ("<f2", 2), ("<i4", 4), ("<i8", 8), ("<u4", 4)];

/// Bytes of a header, at most; numpy's have 118.
const MOST_HEADER: usize = 64 << 10;
/// Numbers that are read at once.
const AT_ONCE: usize = 8192;

/// An array in C order of floats or whole numbers. Its numbers are counted as f64 before the first is read. The error says what is
/// wrong and what to do.
pub(super) fn parse(mut source: impl Read, budget: &mut Budget) -> Result<Array, String> {
    let cut = || "is damaged or cut short; save it again with numpy.savez".to_owned();
    let mut take = |length: usize| -> Result<Vec<u8>, String> {
        let mut bytes = vec![0; length];
        source.read_exact(&mut bytes).map_err(|_| cut())?;
        Ok(bytes)
    };
    let magic = take(MAGIC.len()).ok().filter(|magic| magic == MAGIC);
    magic.ok_or("is no numpy array; save it with numpy.savez")?;
    let version = take(2)?;
    let length = match version.first() {
        Some(1) => take(2)?,
        _ => take(4)?,
    };
    let length = length.iter().rev().fold(0, |sum, byte| (sum << 8) | usize::from(*byte));
    if length > MOST_HEADER {
        return Err(cut());
    }
    let header = String::from_utf8(take(length)?).map_err(|_| cut())?;
    let dtype = after(&header, "'descr':").and_then(quoted).ok_or(
        "has fields or Python objects, not numbers; save plain arrays of float32 or float64",
    )?;
    if after(&header, "'fortran_order':").is_some_and(|text| text.starts_with("True")) {
        return Err("is in Fortran order; save numpy.ascontiguousarray of it".into());
    }
    let shape = after(&header, "'shape':").and_then(tuple).ok_or_else(cut)?;
    let Some((_, size)) = TYPES.iter().find(|(name, _)| *name == dtype) else {
        return Err(format!(
            "is of dtype {}; save it as float32 or float64, little-endian (.astype('<f8'))",
            shown(dtype, 40)
        ));
    };
    let count = shape.iter().try_fold(1_usize, |count, length| count.checked_mul(*length));
    let count = count.ok_or_else(cut)?;
    budget.take_all::<f64>(count).map_err(|large| format!("{large}; {}", TooLarge::REMEDY))?;
    let mut values = Vec::with_capacity(count);
    let mut left = count;
    while left > 0 {
        let next = left.min(AT_ONCE);
        let data = take(next.saturating_mul(*size))?;
        values.extend(data.chunks_exact(*size).map(|bytes| number(dtype, bytes)));
        left -= next;
    }
    match source.read(&mut [0]) {
        Ok(0) => Ok(Array { shape, values }),
        _ => Err(cut()),
    }
}

fn after<'t>(header: &'t str, key: &str) -> Option<&'t str> {
    header.split_once(key).map(|(_, rest)| rest.trim_start())
}

fn quoted(text: &str) -> Option<&str> {
    text.strip_prefix('\'')?.split('\'').next()
}

fn tuple(text: &str) -> Option<Vec<usize>> {
    let inner = text.strip_prefix('(')?.split(')').next()?;
    let parts = inner.split(',').map(str::trim).filter(|part| !part.is_empty());
    parts.map(|part| part.parse().ok()).collect()
}

fn number(dtype: &str, bytes: &[u8]) -> f64 {
    match (dtype, bytes) {
        ("<f4", &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
        ("<i4", &[a, b, c, d]) => f64::from(i32::from_le_bytes([a, b, c, d])),
        ("<u4", &[a, b, c, d]) => f64::from(u32::from_le_bytes([a, b, c, d])),
        ("<f2", &[a, b]) => half(u16::from_le_bytes([a, b])),
        (_, &[a, b, c, d, e, f, g, h]) => {
            let bytes = [a, b, c, d, e, f, g, h];
            if dtype == "<i8" {
                i64::from_le_bytes(bytes) as f64
            } else {
                f64::from_le_bytes(bytes)
            }
        }
        _ => f64::NAN, // chunks have the size of the type
    }
}

/// An IEEE 754 half.
fn half(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from((bits >> 10) & 31), f64::from(bits & 1023));
    let size = match exponent {
        0 => fraction * 2.0_f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1.0 + fraction / 1024.0) * 2.0_f64.powi(exponent - 15),
    };
    if bits >> 15 == 1 { -size } else { size }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_read() {
        for (bits, value) in
            [(0x3c00, 1.0), (0xc000, -2.0), (0x3555, 0.333_251_953_125), (1, 2.0_f64.powi(-24))]
        {
            assert_eq!(half(bits), value);
        }
        assert!(half(0x7e00).is_nan());
    }
}
