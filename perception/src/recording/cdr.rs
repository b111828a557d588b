//! Numbers and texts of ROS messages: CDR, little-endian or big-endian, and the packed bytes of ROS 1.

use super::error::CaptureProblem;

/// Reads one number after another. Those of CDR are aligned to their size, counted from behind the identifier; those of ROS 1 are not.
pub(super) struct Cdr<'b> {
    bytes: &'b [u8],
    at: usize,
    is_big: bool,
    is_ros_1: bool,
    /// Largest alignment.
    most: usize,
}

/// Where a message is from and when, nanoseconds since 1970.
pub(super) struct Header {
    pub(super) time: i128,
    pub(super) frame: String,
}

/// What a message says that ends before all is read.
pub(super) fn short() -> CaptureProblem {
    CaptureProblem::Message("it ends early".into())
}

impl<'b> Cdr<'b> {
    pub(super) fn of(encoding: &str, schema: &str, data: &'b [u8]) -> Result<Self, CaptureProblem> {
        if encoding == "ros1" {
            return Ok(Cdr { bytes: data, at: 0, is_big: false, is_ros_1: true, most: 1 });
        }
        if encoding != "cdr" {
            let (schema, encoding) = (schema.into(), encoding.into());
            return Err(CaptureProblem::Encoding { schema, encoding });
        }
        // Representation identifiers of plain CDR, and of its second version, which aligns to four bytes at most.
        let (is_big, most) = match data {
            [0, 0, _, _, ..] => (true, 8),
            [0, 1, _, _, ..] => (false, 8),
            [0, 6, _, _, ..] => (true, 4),
            [0, 7, _, _, ..] => (false, 4),
            _ => return Err(CaptureProblem::Message("it is not plain CDR".into())),
        };
        let bytes = data.get(4..).unwrap_or_default();
        Ok(Cdr { bytes, at: 0, is_big, is_ros_1: false, most })
    }

    pub(super) fn take(&mut self, count: usize) -> Result<&'b [u8], CaptureProblem> {
        let end = self.at.checked_add(count).ok_or_else(short)?;
        let taken = self.bytes.get(self.at..end).ok_or_else(short)?;
        self.at = end;
        Ok(taken)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], CaptureProblem> {
        self.at = self.at.checked_next_multiple_of(N.min(self.most)).ok_or_else(short)?;
        let mut bytes: [u8; N] = self.take(N)?.try_into().map_err(|_| short())?;
        if self.is_big {
            bytes.reverse();
        }
        Ok(bytes)
    }

    pub(super) fn byte(&mut self) -> Result<u8, CaptureProblem> {
        Ok(u8::from_le_bytes(self.number()?))
    }

    pub(super) fn word(&mut self) -> Result<u32, CaptureProblem> {
        Ok(u32::from_le_bytes(self.number()?))
    }

    pub(super) fn double(&mut self) -> Result<f64, CaptureProblem> {
        Ok(f64::from_le_bytes(self.number()?))
    }

    pub(super) fn doubles<const N: usize>(&mut self) -> Result<[f64; N], CaptureProblem> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.double()?;
        }
        Ok(numbers)
    }

    /// With its length before it, and in CDR a zero behind it.
    pub(super) fn string(&mut self) -> Result<String, CaptureProblem> {
        let length = self.word()? as usize;
        let bytes = self.take(length)?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        Ok(String::from_utf8_lossy(text).into_owned())
    }

    /// Bytes with their number before them.
    pub(super) fn bytes(&mut self) -> Result<&'b [u8], CaptureProblem> {
        let length = self.word()? as usize;
        self.take(length)
    }

    pub(super) fn header(&mut self) -> Result<Header, CaptureProblem> {
        let time = self.stamp()?;
        Ok(Header { time, frame: self.string()? })
    }

    /// The stamp that a header begins with, nanoseconds.
    pub(super) fn stamp(&mut self) -> Result<i128, CaptureProblem> {
        // ROS 1 counts the messages first, and its seconds have no sign.
        let seconds = match self.is_ros_1 {
            true => {
                self.word()?;
                i128::from(self.word()?)
            }
            false => i128::from(self.word()? as i32),
        };
        let nanos = i32::try_from(self.word()?);
        let nanos = nanos.map_err(|_| CaptureProblem::Message("nanoseconds".into()))?;
        Ok(seconds * 1_000_000_000 + i128::from(nanos))
    }
}
