//! Bits of H.264: fixed lengths, Exp-Golomb codes, and units that cannot be taken for two.

/// Bits that are being written, the most significant first.
#[derive(Default)]
pub(super) struct Bits {
    bytes: Vec<u8>,
    /// Of the last byte, 0 to 7; 0: the last one is full.
    used: u32,
}

impl Bits {
    /// The `count` lowest bits of a number.
    pub(super) fn put(&mut self, value: u32, count: u32) {
        for at in (0..count).rev() {
            if self.used == 0 {
                self.bytes.push(0);
            }
            if let Some(last) = self.bytes.last_mut() {
                *last |= (((value >> at) & 1) as u8) << (7 - self.used);
            }
            self.used = (self.used + 1) % 8;
        }
    }

    /// A number as an Exp-Golomb code, `ue(v)`.
    pub(super) fn number(&mut self, value: u32) {
        let more = value + 1;
        let length = more.ilog2();
        self.put(0, length);
        self.put(more, length + 1);
    }

    /// Whole bytes, after zeros up to the next one.
    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        self.used = 0;
        self.bytes.extend_from_slice(bytes);
    }

    /// The unit with this header. A 1 ends it, and no three bytes in it are 0, 0 and at most 3: decoders take them for the start of another.
    pub(super) fn unit(mut self, header: u8) -> Vec<u8> {
        self.put(1, 1);
        let mut unit = Vec::with_capacity(self.bytes.len() + self.bytes.len() / 64 + 1);
        unit.push(header);
        let mut zeros = 0;
        for byte in self.bytes {
            if zeros >= 2 && byte <= 3 {
                unit.push(3);
                zeros = 0;
            }
            unit.push(byte);
            zeros = if byte == 0 { zeros + 1 } else { 0 };
        }
        unit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_the_standard() {
        let mut bits = Bits::default();
        // 1, 010, 011, 00100, then 101.
        for number in 0..4 {
            bits.number(number);
        }
        bits.put(0b101, 3);
        // 1 010 011 0 | 0100 101 and the 1 at the end.
        assert_eq!(bits.unit(0x65), [0x65, 0b1010_0110, 0b0100_1011]);
    }

    #[test]
    fn starts_of_units_do_not_occur_within_one() {
        let mut bits = Bits::default();
        bits.put(1, 1);
        bits.bytes(&[0, 0, 1, 0, 0, 0, 0, 4]);
        assert_eq!(bits.unit(0x41), [0x41, 0x80, 0, 0, 3, 1, 0, 0, 3, 0, 0, 4, 0x80]);
    }
}
