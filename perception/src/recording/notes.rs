//! What a recording had that could not be used, or was used otherwise than it says.

use rigidformer_runtime::files::shown;

use super::error::CaptureError;
use crate::capture::Capture;

/// Different notes of one kind that are kept, at most.
// A hostile file may give as many as it has messages.
const MOST: usize = 8;
/// Characters that say why something is left out, at most.
const SHOWN: usize = 320;

/// One thing about a recording that its user should know. Its text is a sentence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Note {
    /// A file whose recorder did not end it, or whose end was cut off.
    #[error("{0}: the recorder did not finish it, so what is before its end is read")]
    Unfinished(String),
    /// A part of a file that is damaged.
    #[error("a damaged part is left out: {0}")]
    Damaged(String),
    /// An image, a cloud or a message that cannot be used.
    #[error("left out: {0}")]
    LeftOut(String),
    /// Messages of topics whose stamps say no time.
    #[error(
        "the stamps of {0} are 0 or stand still: times are those at which messages were logged"
    )]
    NoStamps(String),
    /// Messages of topics whose stamps are of another clock than those of transforms.
    #[error(
        "the stamps of {0} are of another clock: times are those at which messages were logged"
    )]
    OtherClock(String),
    /// Messages of one topic with one stamp.
    #[error("{0} has two messages of one time: the later one is left out")]
    Duplicate(String),
    /// Messages that came after later ones had been used.
    #[error("messages of {0} came too late, behind others that are newer, and are left out")]
    Late(String),
    /// Messages that are not in the order of their times.
    #[error(
        "messages are not in the file in the order of their times: they are read in that order"
    )]
    Reordered,
    /// Clouds and images of a frame that no transform names, while others are known.
    #[error(
        "no transform knows the frame {0:?}: what it shows is taken to be in the world; where is it? record its transform"
    )]
    UnknownFrame(String),
    /// A frame that is named with a slash before it.
    #[error("no transform knows the frame {0:?}: that of the one without the slash is taken")]
    Slash(String),
    /// Sensors whose transforms do not meet.
    #[error("sensors are in worlds that no transform joins: {0}")]
    Apart(String),
    /// Transforms of a frame that ended before the captures did.
    #[error("transforms of the frame {0:?} end early: its last pose holds on")]
    Ended(String),
    /// A topic that could be read and is not.
    #[error("{0} is not used: name topics with --topic")]
    Unused(String),
    /// Several topics of clouds in one frame.
    #[error("clouds come from {0}: choose with --topic")]
    SeveralTopics(String),
    /// Clouds whose coordinates are far from the origin.
    #[error("coordinates are far from the origin: {0} m are subtracted from x, y, z")]
    Offset(String),
    /// Files whose names are times.
    #[error("times are read from the names of the files ({0})")]
    NamedTimes(&'static str),
    /// Files whose names are in no order of times.
    #[error("hidden files are passed over, such as {0}")]
    Hidden(String),
    /// Points beyond 1000 km.
    #[error("points beyond 1000 km are left out")]
    PointsFar,
    /// Points at the origin of the sensor's frame.
    #[error("points at 0,0,0, which scanners write for beams without a return, are left out")]
    PointsAtOrigin,
    /// A camera whose images are made straight.
    #[error("images of the frame {0:?} are distorted: they are made straight by their calibration")]
    Straightened(String),
}

/// Notes about a recording, each with how often it applies.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Notes {
    notes: Vec<(Note, u64)>,
    points: u64,
    points_not_finite: u64,
}

impl Notes {
    /// Share of the points of clouds so far that are not finite, which scanners write for beams without a return; they are left out.
    pub fn not_finite_share(&self) -> Option<f64> {
        (self.points > 0).then(|| self.points_not_finite as f64 / self.points as f64)
    }

    /// Counts the points of a cloud, and those of them that are not finite.
    pub(super) fn count_points(&mut self, points: u64, not_finite: u64) {
        self.points = self.points.saturating_add(points);
        self.points_not_finite = self.points_not_finite.saturating_add(not_finite);
    }

    /// Each note and how often it applies: files, messages or points.
    pub fn iter(&self) -> impl Iterator<Item = (&Note, u64)> {
        self.notes.iter().map(|(note, count)| (note, *count))
    }

    /// Whether there is nothing to say.
    pub fn is_empty(&self) -> bool {
        self.notes.is_empty()
    }

    /// How many things were left out that could not be used.
    pub fn left_out(&self) -> u64 {
        let of = self.notes.iter().filter(|(note, _)| matches!(note, Note::LeftOut(_)));
        of.map(|(_, count)| count).sum()
    }

    /// Says that a note applies so many times more.
    pub(super) fn count(&mut self, note: Note, times: u64) {
        if times == 0 {
            return;
        }
        if let Some((_, count)) = self.notes.iter_mut().find(|(known, _)| *known == note) {
            *count = count.saturating_add(times);
            return;
        }
        let kind = std::mem::discriminant(&note);
        let mut same =
            self.notes.iter_mut().filter(|(known, _)| std::mem::discriminant(known) == kind);
        match same.nth(MOST - 1) {
            None => self.notes.push((note, times)),
            // The list is full: what it has no room for still counts.
            Some((_, count)) => *count = count.saturating_add(times),
        }
    }

    /// Says that a note applies once more.
    pub(super) fn add(&mut self, note: Note) {
        self.count(note, 1);
    }

    /// Says that something cannot be used, and why.
    pub(super) fn leave_out(&mut self, why: &impl std::fmt::Display) {
        self.add(Note::LeftOut(shown(&why.to_string(), SHOWN)));
    }
}

/// Views of one capture that cannot be read.
#[derive(Debug, Default)]
pub(super) struct LeftOut(Option<CaptureError>);

impl LeftOut {
    /// The first one waits: if it was the only view, it is told by itself.
    pub(super) fn add(&mut self, error: CaptureError, notes: &mut Notes) {
        match self.0 {
            None => self.0 = Some(error),
            Some(_) => notes.leave_out(&error),
        }
    }

    /// The capture without them; their error, where nothing is left of it.
    pub(super) fn of(self, capture: Capture, notes: &mut Notes) -> Result<Capture, CaptureError> {
        match self.0 {
            Some(error) if capture.views.is_empty() => Err(error),
            Some(error) => {
                notes.leave_out(&error);
                Ok(capture)
            }
            None => Ok(capture),
        }
    }
}
