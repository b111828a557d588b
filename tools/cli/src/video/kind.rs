//! What a video is.

use super::planes::Colours;

/// Frames a second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rate {
    /// In 1000 seconds, so that 29.97 is a whole number too.
    pub(crate) thousandths: u32,
}

impl Rate {
    /// The nearest that there is.
    pub(crate) fn of_hz(hz: f64) -> Rate {
        Rate { thousandths: (hz * 1000.0).round() as u32 }
    }

    pub(crate) fn hz(self) -> f64 {
        f64::from(self.thousandths) / 1000.0
    }
}

/// What a video is.
#[derive(Clone, Copy)]
pub(crate) struct Kind {
    /// Pixels a row, and rows; even.
    pub(crate) size: [u32; 2],
    pub(crate) rate: Rate,
    pub(crate) frames: u32,
    pub(crate) colours: Colours,
}
