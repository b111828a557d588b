//! Where captures come from: a recording, or a scene that is seen by cameras.

use std::io::{Cursor, Read};
use std::path::Path;

use nalgebra::Vector3;
use rigidformer_evaluation::render::{DepthNoise, Renderer, cameras, distance_m};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene};
use rigidformer_perception::camera::Camera;
use rigidformer_perception::capture::{Capture, DepthView, View};
use rigidformer_perception::recording::{self, CaptureProblem, Captures, Options};

use super::pipe::Pipe;
use crate::arguments::Track;

/// Columns and rows of rendered images.
const SIZE: [u32; 2] = [640, 480];
/// Metres a step of rendered images.
const SCALE_M: f32 = 0.001;
/// Share of the pixels at edges that are lost, as `rigidformer render` has it.
const EDGE_LOSS: f32 = 0.3;
/// A time that misses the end by less than this is within the record, captures.
const ROUNDING: f64 = 1e-6;

/// Captures in a row that cannot be read, at most.
const MOST_FAILURES: usize = 100;
/// First byte of an MCAP stream.
const MCAP: u8 = 0x89;
/// Captures a second of --render.
const RENDERED_HZ: f64 = 30.0;

pub(super) struct Source {
    name: String,
    kind: Kind,
    scale: f32,
    /// The first capture, which says where gravity is.
    first: Option<Capture>,
    /// Captures that could not be read, and why the first of them.
    pub(super) unreadable: usize,
    pub(super) failure: Option<anyhow::Error>,
}

enum Kind {
    Recording(Box<Captures>),
    Pipe(Pipe<Box<dyn Read>>),
    Rendered(Box<Rendered>),
}

struct Rendered {
    scene: RecordedScene,
    cameras: Vec<Camera>,
    noise: DepthNoise,
    rate_hz: f64,
    captures: u64,
    next: u64,
}

impl Source {
    pub(super) fn open(arguments: &Track) -> anyhow::Result<Source> {
        let scale = arguments.scale.unwrap_or(1.0);
        let of = |name: String, kind: Kind| Source {
            name,
            kind,
            scale,
            first: None,
            unreadable: 0,
            failure: None,
        };
        let options = Options {
            rate_hz: arguments.rate,
            latency_s: arguments.latency,
            topics: arguments.topic.clone(),
        };
        if is_pipe(arguments) {
            return Ok(of("standard input".into(), piped(&options)?));
        }
        if !arguments.render {
            let captures = recording::open_with(&arguments.input, &options);
            let captures = captures.map_err(|error| match error.problem {
                CaptureProblem::NoRate => anyhow::anyhow!("{error}; --rate says how many"),
                _ => error.into(),
            })?;
            return Ok(of(name(&arguments.input), Kind::Recording(Box::new(captures))));
        }
        let scene = Dataset::open(&arguments.input)?.scene(arguments.index, None)?;
        let cameras = cameras(&scene, SIZE, usize::from(arguments.cameras))?;
        let distance_m = distance_m(&scene, &cameras).max(1e-3);
        let noise = DepthNoise {
            deviation_at_1m_m: arguments.deviation_mm / 1000.0 / (distance_m * distance_m),
            edge_loss: EDGE_LOSS,
            seed: 1,
        };
        let rate_hz = arguments.rate.unwrap_or(RENDERED_HZ);
        let captures = (scene.duration_s() * rate_hz + ROUNDING).floor() as u64 + 1;
        let name = scene.name().to_owned();
        let rendered = Rendered { scene, cameras, noise, rate_hz, captures, next: 0 };
        Ok(of(name, Kind::Rendered(Box::new(rendered))))
    }

    /// The first capture that can be read, which is the next one.
    pub(super) fn peek(&mut self) -> anyhow::Result<Option<&Capture>> {
        if self.first.is_none() {
            self.first = self.next().transpose()?;
        }
        Ok(self.first.as_ref())
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn gravity_m_s2(&self) -> Option<Vector3<f32>> {
        match &self.kind {
            Kind::Recording(captures) => captures.gravity_m_s2(),
            Kind::Pipe(_) => None,
            Kind::Rendered(rendered) => Some(rendered.scene.gravity_m_s2()),
        }
    }

    /// The way up in the recording's world by an inertial sensor, where one rested.
    pub(super) fn measured_up(&self) -> Option<Vector3<f32>> {
        match &self.kind {
            Kind::Recording(captures) => captures.measured_up(),
            Kind::Rendered(_) | Kind::Pipe(_) => None,
        }
    }

    /// What is to be said about the recording, each with how often it applies.
    pub(super) fn notes(&self) -> Vec<String> {
        let Kind::Recording(captures) = &self.kind else { return Vec::new() };
        let notes = captures.notes().iter().map(|(note, count)| match count {
            1 => note.to_string(),
            count => format!("{note} ({count} times)"),
        });
        notes.collect()
    }

    /// The scene that is seen, where that is known.
    pub(super) fn scene(&self) -> Option<&RecordedScene> {
        match &self.kind {
            Kind::Recording(_) | Kind::Pipe(_) => None,
            Kind::Rendered(rendered) => Some(&rendered.scene),
        }
    }

    /// Captures, where their number is known.
    pub(super) fn count(&self) -> Option<u64> {
        match &self.kind {
            Kind::Recording(captures) => captures.count_left().map(|count| count as u64),
            Kind::Pipe(_) => None,
            Kind::Rendered(rendered) => Some(rendered.captures),
        }
    }

    /// Leaves out a recording's labels, so that a file of theirs that cannot be read costs nothing.
    pub(super) fn without_labels(self) -> Self {
        let kind = match self.kind {
            Kind::Recording(captures) => Kind::Recording(Box::new(captures.without_labels())),
            other => other,
        };
        Source { kind, ..self }
    }

    /// The next capture that can be read. One that cannot costs itself alone, and is counted.
    pub(super) fn next(&mut self) -> Option<anyhow::Result<Capture>> {
        if let Some(first) = self.first.take() {
            return Some(Ok(first));
        }
        for _ in 0..MOST_FAILURES {
            let next = match &mut self.kind {
                Kind::Recording(captures) => {
                    captures.next().map(|capture| capture.map_err(anyhow::Error::from))
                }
                // After a mistake nobody knows where the next frame begins.
                Kind::Pipe(pipe) => return scaled(pipe.next()?, self.scale),
                Kind::Rendered(rendered) => return rendered.next(),
            };
            match next? {
                Ok(capture) => return scaled(Ok(capture), self.scale),
                Err(error) => {
                    self.unreadable += 1;
                    self.failure.get_or_insert(error);
                }
            }
        }
        None
    }
}

/// Whether frames come from standard input.
pub(super) fn is_pipe(arguments: &Track) -> bool {
    arguments.input.as_os_str() == "-"
}

/// An MCAP stream, or frames with a line of JSON each.
fn piped(options: &Options) -> anyhow::Result<Kind> {
    let mut first = Vec::new();
    std::io::stdin().take(1).read_to_end(&mut first)?;
    let is_mcap = first.first() == Some(&MCAP);
    let from = Cursor::new(first).chain(std::io::stdin());
    if is_mcap {
        let captures = recording::stream(from, options)?;
        return Ok(Kind::Recording(Box::new(captures)));
    }
    Ok(Kind::Pipe(Pipe::new(Box::new(from))))
}

/// What a recording is called in results: where it lies is nobody's business.
pub(super) fn name(path: &Path) -> String {
    let whole = path.file_name().is_none().then(|| path.canonicalize().ok()).flatten();
    let name = whole.as_deref().unwrap_or(path).file_name().unwrap_or(path.as_os_str());
    name.to_string_lossy().into_owned()
}

/// A capture whose lengths are multiplied.
fn scaled(capture: anyhow::Result<Capture>, scale: f32) -> Option<anyhow::Result<Capture>> {
    // Multiplying by one may not change a bit, but takes time.
    if scale == 1.0 {
        return Some(capture);
    }
    Some(capture.and_then(|mut capture| {
        for view in &mut capture.views {
            match view {
                View::Depth(view) => {
                    let (depth, labels) = (std::mem::take(&mut view.depth), view.labels.take());
                    *view = DepthView::new(view.camera, view.scale_m * scale, depth, labels)?;
                }
                View::Cloud(cloud) => {
                    let sensor = cloud.sensor.iter_mut();
                    cloud.points.iter_mut().chain(sensor).for_each(|point| point.coords *= scale);
                }
            }
        }
        Ok(capture)
    }))
}

impl Rendered {
    fn next(&mut self) -> Option<anyhow::Result<Capture>> {
        let number = self.next;
        if number >= self.captures {
            return None;
        }
        self.next += 1;
        Some(self.capture(number))
    }

    fn capture(&self, number: u64) -> anyhow::Result<Capture> {
        let renderer = Renderer::new(&self.scene)?;
        let time_s = number as f64 / self.rate_hz;
        let views = self.cameras.iter().enumerate().map(|(index, camera)| {
            let place = number * self.cameras.len() as u64 + index as u64;
            renderer.view(camera, time_s, SCALE_M, &self.noise, place).map(View::Depth)
        });
        Ok(Capture { time_s, views: views.collect::<Result<_, _>>()? })
    }
}
