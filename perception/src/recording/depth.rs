//! Depth recordings: captures of a folder of images.

use std::path::Path;

use rigidformer_runtime::memory::Budget;

use super::error::{CaptureError, CaptureProblem};
use super::image;
use super::manifest::{KnownCamera, KnownFrame, MAX_CAPTURE_SPAN_S};
use super::notes::{LeftOut, Notes};
use crate::capture::{Capture, DepthView, View};

/// Captures that are read one at a time.
pub(super) struct DepthCaptures {
    cameras: Vec<KnownCamera>,
    frames: Vec<KnownFrame>,
    /// The frame that comes next.
    next: usize,
    captures: usize,
    notes: Notes,
    /// Whether labels are read.
    labelled: bool,
    /// The first labels that are not there: an error of the first capture, unless labels are not read.
    no_labels: Option<CaptureError>,
}

impl DepthCaptures {
    /// Looks whether all images are there; labels that are not are no error before they are to be read.
    pub(super) fn new(
        cameras: Vec<KnownCamera>,
        frames: Vec<KnownFrame>,
    ) -> Result<Self, CaptureError> {
        if let Some(path) = frames.iter().map(|frame| &frame.depth).find(|path| !path.is_file()) {
            return Err(CaptureError::of(path, CaptureProblem::Missing));
        }
        let no_labels = frames.iter().filter_map(|frame| frame.labels.as_ref());
        let no_labels = no_labels
            .filter(|path| !path.is_file())
            .map(|path| CaptureError::at(path, "labels", CaptureProblem::Missing))
            .next();
        let mut all = DepthCaptures {
            cameras,
            frames,
            next: 0,
            captures: 0,
            notes: Notes::default(),
            labelled: true,
            no_labels,
        };
        while all.of_next().is_some() {
            all.captures += 1;
        }
        all.next = 0;
        Ok(all)
    }

    /// Leaves out labels.
    pub(super) fn ignore_labels(&mut self) {
        self.labelled = false;
    }

    /// How many are left.
    pub(super) fn left(&self) -> usize {
        self.captures
    }

    /// What is to be said about those so far.
    pub(super) fn notes(&self) -> &Notes {
        &self.notes
    }

    /// Frames of the next capture.
    fn of_next(&mut self) -> Option<std::ops::Range<usize>> {
        let start = self.next;
        let first_s = self.frames.get(start)?.time_s;
        let of_it = |frame: &&KnownFrame| frame.time_s - first_s < MAX_CAPTURE_SPAN_S;
        self.next += self.frames.iter().skip(start).take_while(of_it).count();
        Some(start..self.next)
    }

    /// Counts all images of a capture before the first is read.
    fn count_images(&self, frames: &[KnownFrame]) -> Result<(), CaptureError> {
        let mut budget = Budget::default();
        let mut decoded = 0;
        for frame in frames {
            let Some(known) = self.cameras.get(frame.camera) else { continue };
            let pixels = known.camera.size().map(u64::from).iter().product::<u64>();
            let image = pixels.saturating_mul(size_of::<u16>() as u64);
            let images = if self.labelled && frame.labels.is_some() { 2 } else { 1 };
            decoded = image.max(decoded);
            let view = image.saturating_mul(images).saturating_add(size_of::<View>() as u64);
            budget.take(view).map_err(|large| CaptureError::of(&frame.depth, large))?;
        }
        // The bytes of one image, while its numbers are made of them.
        let first = frames.first().map_or(Path::new(""), |frame| &frame.depth);
        budget.take(decoded).map_err(|large| CaptureError::of(first, large))
    }

    fn read(&mut self, frames: std::ops::Range<usize>) -> Result<Option<Capture>, CaptureError> {
        let Some(frames) = self.frames.get(frames) else { return Ok(None) };
        let Some(first) = frames.first() else { return Ok(None) };
        self.count_images(frames)?;
        let mut views = Vec::with_capacity(frames.len());
        let mut left = LeftOut::default();
        for frame in frames {
            let Some(known) = self.cameras.get(frame.camera) else { continue };
            match view(known, frame, self.labelled) {
                Ok(view) => views.push(View::Depth(view)),
                Err(error) => left.add(error, &mut self.notes),
            }
        }
        left.of(Capture { time_s: first.time_s, views }, &mut self.notes).map(Some)
    }
}

impl Iterator for DepthCaptures {
    type Item = Result<Capture, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(missing) = self.no_labels.take().filter(|_| self.labelled) {
            return Some(Err(missing));
        }
        let frames = self.of_next()?;
        self.captures = self.captures.saturating_sub(1);
        self.read(frames).transpose()
    }
}

fn view(
    known: &KnownCamera,
    frame: &KnownFrame,
    labelled: bool,
) -> Result<DepthView, CaptureError> {
    let fail = |path: &Path, problem: CaptureProblem| CaptureError::of(path, problem);
    let camera = match frame.moved {
        Some(pose) => known.camera.moved(pose).map_err(|error| fail(&frame.depth, error.into()))?,
        None => known.camera,
    };
    let depth = image::read(&frame.depth, camera.size())?;
    let labels = frame.labels.as_deref().filter(|_| labelled);
    let labels = labels.map(|path| image::read_labels(path, camera.size())).transpose()?;
    DepthView::new(camera, known.scale_m, depth, labels)
        .map_err(|error| fail(&frame.depth, error.into()))
}
