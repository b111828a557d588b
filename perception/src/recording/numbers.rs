//! Numbers in packed bytes.

/// What the bits of a number are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Unsigned,
    Signed,
    Float,
}

/// A number of 1, 2, 4 or 8 bytes, the low one first where nothing else is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Number {
    kind: Kind,
    size: usize,
    is_big: bool,
}

impl Number {
    /// None for a size that no number of that kind has.
    pub(super) fn new(kind: Kind, size: usize) -> Option<Number> {
        let is_known = match kind {
            Kind::Float => matches!(size, 4 | 8),
            Kind::Unsigned | Kind::Signed => matches!(size, 1 | 2 | 4 | 8),
        };
        is_known.then_some(Number { kind, size, is_big: false })
    }

    /// The same with the high byte first.
    pub(super) fn big(self) -> Number {
        Number { is_big: true, ..self }
    }

    /// Its bytes.
    pub(super) fn size(self) -> usize {
        self.size
    }

    /// Reads it; NaN where there are no bytes.
    pub(super) fn read(self, bytes: &[u8], start: usize) -> f64 {
        let own = start.checked_add(self.size).and_then(|end| bytes.get(start..end));
        let Some(own) = own else { return f64::NAN };
        let mut eight = [0; 8];
        for (to, from) in eight.iter_mut().zip(own) {
            *to = *from;
        }
        if self.is_big
            && let Some(own) = eight.get_mut(..self.size)
        {
            own.reverse();
        }
        let bits = u64::from_le_bytes(eight);
        match (self.kind, self.size) {
            (Kind::Float, 4) => f64::from(f32::from_bits(bits as u32)),
            (Kind::Float, _) => f64::from_bits(bits),
            (Kind::Signed, 1) => f64::from(bits as u8 as i8),
            (Kind::Signed, 2) => f64::from(bits as u16 as i16),
            (Kind::Signed, 4) => f64::from(bits as u32 as i32),
            (Kind::Signed, _) => bits as i64 as f64,
            (Kind::Unsigned, _) => bits as f64,
        }
    }
}

/// A label of a point. What has more than 16 bits is packed, a class in the low 16 and an instance above: both together tell bodies
/// apart. Anything that is no label is none.
pub(super) fn label(number: f64) -> u16 {
    if !(0.0..4_294_967_296.0).contains(&number) {
        return 0;
    }
    let bits = number as u32;
    match u16::try_from(bits) {
        Ok(label) => label,
        // An odd factor spreads instances over all numbers; two of a scene's few bodies seldom meet.
        Err(_) => ((bits as u16) ^ ((bits >> 16) as u16).wrapping_mul(0x9e37)).max(1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_all_kinds() {
        let read = |kind, bytes: &[u8]| Number::new(kind, bytes.len()).unwrap().read(bytes, 0);
        assert_eq!(read(Kind::Unsigned, &[0xff]), 255.0);
        assert_eq!(read(Kind::Signed, &[0xff]), -1.0);
        assert_eq!(read(Kind::Signed, &(-300_i16).to_le_bytes()), -300.0);
        assert_eq!(read(Kind::Signed, &i32::MIN.to_le_bytes()), f64::from(i32::MIN));
        assert_eq!(read(Kind::Signed, &(-7_i64).to_le_bytes()), -7.0);
        assert_eq!(read(Kind::Float, &0.25_f32.to_le_bytes()), 0.25);
        assert_eq!(read(Kind::Float, &(-1e300_f64).to_le_bytes()), -1e300);
        assert!(Number::new(Kind::Float, 2).is_none() && Number::new(Kind::Signed, 3).is_none());
        let big = |kind, bytes: &[u8]| Number::new(kind, bytes.len()).unwrap().big().read(bytes, 0);
        assert_eq!(big(Kind::Float, &0.25_f32.to_be_bytes()), 0.25);
        assert_eq!(big(Kind::Signed, &(-300_i16).to_be_bytes()), -300.0);
        let word = Number::new(Kind::Unsigned, 4).unwrap();
        assert!(word.read(&[1, 2, 3], 0).is_nan() && word.read(&[0; 8], usize::MAX).is_nan());
    }

    #[test]
    fn packed_labels_tell_bodies_apart() {
        assert_eq!([0.0, 7.0, 65_535.0].map(label), [0, 7, 65_535]);
        assert_eq!([-1.0, f64::NAN, f64::INFINITY, 1e18].map(label), [0; 4]);
        // Three cars, and the road.
        let packed = [10 | 1 << 16, 10 | 2 << 16, 10 | 3 << 16, 40];
        let mut labels = packed.map(|bits: u32| label(f64::from(bits))).to_vec();
        labels.sort_unstable();
        labels.dedup();
        assert_eq!(labels.len(), 4);
    }
}
