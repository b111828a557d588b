//! Where captures come from: a recording, or a scene that is seen by cameras.

use nalgebra::Vector3;
use rigidformer_evaluation::render::{DepthNoise, Renderer, cameras};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene};
use rigidformer_perception::camera::Camera;
use rigidformer_perception::capture::{Capture, View};
use rigidformer_perception::recording::{self, CaptureError, Captures, Options};

use crate::arguments::Track;

/// Columns and rows of rendered images.
const SIZE: [u32; 2] = [640, 480];
/// Metres a step of rendered images.
const SCALE_M: f32 = 0.001;
/// Share of the pixels at edges that are lost, as `rigidformer render` has it.
const EDGE_LOSS: f32 = 0.3;
/// A time that misses the end by less than this is within the record, captures.
const ROUNDING: f64 = 1e-6;

pub(super) struct Source {
    name: String,
    kind: Kind,
}

enum Kind {
    Recording(Box<Recorded>),
    Rendered(Box<Rendered>),
}

/// A recording of which some captures may be unreadable.
struct Recorded {
    captures: Captures,
    read: u64,
    refused: u64,
    /// Why the first of them could not be read.
    first: Option<CaptureError>,
}

/// What is to be said about the input: a sentence, and to how many messages, files or points it applies.
pub(super) struct Said {
    pub(super) text: String,
    pub(super) count: u64,
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
        if !arguments.render {
            let options = Options {
                rate_hz: Some(arguments.rate),
                latency_s: arguments.latency,
                topics: arguments.topic.clone(),
            };
            let captures = match arguments.input.as_os_str() == "-" {
                true => recording::stream(std::io::stdin(), &options)?,
                false => recording::open_with(&arguments.input, &options)?,
            };
            let name = arguments.input.display().to_string();
            let recorded = Recorded { captures, read: 0, refused: 0, first: None };
            return Ok(Source { name, kind: Kind::Recording(Box::new(recorded)) });
        }
        let scene = Dataset::open(&arguments.input)?.scene(arguments.index, None)?;
        let cameras = cameras(&scene, SIZE, usize::from(arguments.cameras))?;
        let distance_m = distance_m(&scene, &cameras).max(1e-3);
        let noise = DepthNoise {
            deviation_at_1m_m: arguments.deviation_mm / 1000.0 / (distance_m * distance_m),
            edge_loss: EDGE_LOSS,
            seed: 1,
        };
        let rate_hz = arguments.rate;
        let captures = (scene.duration_s() * rate_hz + ROUNDING).floor() as u64 + 1;
        let name = scene.name().to_owned();
        let rendered = Rendered { scene, cameras, noise, rate_hz, captures, next: 0 };
        Ok(Source { name, kind: Kind::Rendered(Box::new(rendered)) })
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn gravity_m_s2(&self) -> Option<Vector3<f32>> {
        match &self.kind {
            Kind::Recording(recorded) => recorded.captures.gravity_m_s2(),
            Kind::Rendered(rendered) => Some(rendered.scene.gravity_m_s2()),
        }
    }

    /// The scene that is seen, where that is known.
    pub(super) fn scene(&self) -> Option<&RecordedScene> {
        match &self.kind {
            Kind::Recording(_) => None,
            Kind::Rendered(rendered) => Some(&rendered.scene),
        }
    }

    /// What was left out so far, or read otherwise than the input says.
    pub(super) fn said(&self) -> Vec<Said> {
        match &self.kind {
            Kind::Recording(recorded) => recorded.said(),
            Kind::Rendered(_) => Vec::new(),
        }
    }

    /// Captures, where their number is known.
    pub(super) fn count(&self) -> Option<u64> {
        match &self.kind {
            Kind::Recording(recorded) => recorded.captures.count_left().map(|count| count as u64),
            Kind::Rendered(rendered) => Some(rendered.captures),
        }
    }

    pub(super) fn next(&mut self) -> Option<anyhow::Result<Capture>> {
        match &mut self.kind {
            Kind::Recording(recorded) => recorded.next(),
            Kind::Rendered(rendered) => rendered.next(),
        }
    }
}

impl Recorded {
    /// One that cannot be read costs itself alone; if none can be, the first error is all there is to say.
    fn next(&mut self) -> Option<anyhow::Result<Capture>> {
        loop {
            match self.captures.next() {
                Some(Ok(capture)) => {
                    self.read += 1;
                    return Some(Ok(capture));
                }
                Some(Err(error)) => {
                    self.refused += 1;
                    self.first.get_or_insert(error);
                }
                None if self.read > 0 => return None,
                None => return self.first.take().map(|first| Err(first.into())),
            }
        }
    }

    fn said(&self) -> Vec<Said> {
        let mut said: Vec<Said> = Vec::new();
        if let Some(first) = &self.first {
            let count = self.refused;
            let text = match count {
                1 => format!("left out: {first}"),
                more => format!("{more} captures left out, the first one: {first}"),
            };
            said.push(Said { text, count });
        }
        for (note, count) in self.captures.notes().iter() {
            said.push(Said { text: note.to_string(), count });
        }
        said
    }
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

/// Mean distance of the units from the cameras' planes at the first frame, metres.
fn distance_m(scene: &RecordedScene, cameras: &[Camera]) -> f32 {
    let places = scene.poses_at(0).unwrap_or_default();
    let depths = cameras.iter().flat_map(|camera| {
        places.iter().filter_map(|pose| camera.pixel(&pose.translation.vector.into()))
    });
    let depths: Vec<f32> = depths.map(|(_, depth_m)| depth_m).collect();
    depths.iter().sum::<f32>() / depths.len().max(1) as f32
}
