//! `rigidformer render`

use rigidformer_evaluation::render::{DepthNoise, Renderer, SmoothErrors, cameras};
use rigidformer_evaluation::scenes::{RecordedScene, Split};
use rigidformer_evaluation::score::Seen;
use rigidformer_perception::camera::Camera;
use rigidformer_perception::capture::{Capture, DepthView, View};
use rigidformer_perception::recording::Recorder;
use serde_json::{Value, json};

use crate::arguments::Render;
use crate::usage::Usage;
use crate::{defaults, interrupt, output, picture};

/// Metres a step of the images.
const SCALE_M: f32 = 0.001;
/// The picture for people.
const PREVIEW: &str = "preview.png";
/// A time that misses the end by less than this is within the record, captures.
const ROUNDING: f64 = 1e-6;

pub(crate) fn run(arguments: &Render) -> anyhow::Result<()> {
    interrupt::watch();
    let dataset = defaults::dataset(arguments.scene.as_deref())?;
    let first_of_test = || dataset.scenes_of(Split::Test).first().copied().unwrap_or(0);
    let index = arguments.index.unwrap_or_else(first_of_test);
    let scene = dataset.scene(index, None)?;
    let rate_hz = f64::from(arguments.rate);
    let captures = captures(arguments, &scene, rate_hz)?;
    let renderer = Renderer::new(&scene)?;
    let cameras = cameras(&scene, arguments.size, usize::from(arguments.cameras))?;
    let away_m = cameras.iter().map(|camera| distance_m(&scene, camera)).sum::<f32>();
    let away_m = (away_m / cameras.len().max(1) as f32).max(1e-3);
    let at_1m_m = |there_mm: f32| there_mm / 1000.0 / (away_m * away_m);
    let noise = DepthNoise {
        deviation_at_1m_m: at_1m_m(arguments.deviation_mm),
        edge_loss: arguments.edge_loss,
        seed: arguments.seed,
    };
    let smooth = SmoothErrors {
        bowl: arguments.bowl,
        step_at_1m_m: at_1m_m(arguments.step_mm),
        wave_at_1m_m: at_1m_m(arguments.wave_mm),
        seed: arguments.seed,
    };

    if let Some(parent) = arguments.out.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        output::folder(parent)?;
    }
    let mut recorder = Recorder::new(&arguments.out, Some(scene.gravity_m_s2()))?;
    let mut named = Vec::new();
    for (index, camera) in cameras.iter().enumerate() {
        let name = format!("camera{}", index + 1);
        recorder.camera(&name, camera, SCALE_M)?;
        named.push((name, *camera));
    }
    let bar = output::progress(captures, scene.name());
    let mut pixels = vec![Pixels::default(); scene.units().len()];
    for capture in 0..captures {
        interrupt::check()?;
        let time_s = capture as f64 / rate_hz;
        let mut views = Vec::with_capacity(named.len());
        for (index, (_, camera)) in named.iter().enumerate() {
            let place = capture * named.len() as u64 + index as u64;
            // Each camera has smooth errors of its own.
            let smooth = SmoothErrors { seed: smooth.seed.wrapping_add(index as u64), ..smooth };
            let view = renderer.view_with(camera, time_s, SCALE_M, (&noise, &smooth), place)?;
            recorder.add(time_s, index, &view)?;
            views.push(view);
        }
        if capture == 0 {
            recorder.extra(PREVIEW, &preview(&scene, &named, &views)?)?;
        }
        let views = views.into_iter().map(View::Depth).collect();
        if let Some(seen) = Seen::of(&Capture { time_s, views }, scene.units().len()) {
            pixels.iter_mut().zip(seen.pixels).for_each(|(pixels, count)| pixels.add(count));
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    interrupt::check()?;
    recorder.finish()?;
    if arguments.json {
        return output::json(&document(
            arguments,
            &scene,
            &named,
            (&noise, &smooth),
            captures,
            &pixels,
        ));
    }
    print(arguments, &scene, &named, &noise, captures, &pixels)
}

/// How many captures there are.
fn captures(arguments: &Render, scene: &RecordedScene, rate_hz: f64) -> anyhow::Result<u64> {
    let recorded_s = scene.duration_s();
    let wanted_s = arguments.seconds.map_or(recorded_s, f64::from);
    if wanted_s > recorded_s + ROUNDING / rate_hz {
        return Err(Usage(format!(
            "--seconds {wanted_s}: {} has {recorded_s:.3} s; give less",
            scene.name()
        ))
        .into());
    }
    Ok((wanted_s * rate_hz + ROUNDING).floor() as u64 + 1)
}

/// Pixels that show a unit, over captures.
#[derive(Clone, Copy, Default)]
struct Pixels {
    captures: u64,
    sum: u64,
    least: Option<u32>,
}

impl Pixels {
    fn add(&mut self, count: u32) {
        self.captures += 1;
        self.sum += u64::from(count);
        self.least = Some(self.least.map_or(count, |least| least.min(count)));
    }

    fn mean(&self) -> f64 {
        self.sum as f64 / self.captures.max(1) as f64
    }
}

fn preview(
    scene: &RecordedScene,
    named: &[(String, Camera)],
    views: &[DepthView],
) -> anyhow::Result<Vec<u8>> {
    let named: Vec<_> =
        named.iter().map(|(name, _)| name.clone()).zip(views.iter().cloned()).collect();
    picture::depths(&named, &format!("{}, first capture", scene.name()))
}

/// How far in front of a camera units are at the first frame, on average, metres.
fn distance_m(scene: &RecordedScene, camera: &Camera) -> f32 {
    let places = scene.poses_at(0).unwrap_or_default();
    let count = places.len().max(1) as f32;
    let depths = places.iter().filter_map(|pose| camera.pixel(&pose.translation.vector.into()));
    depths.map(|(_, depth_m)| depth_m).sum::<f32>() / count
}

fn print(
    arguments: &Render,
    scene: &RecordedScene,
    named: &[(String, Camera)],
    noise: &DepthNoise,
    captures: u64,
    pixels: &[Pixels],
) -> anyhow::Result<()> {
    let [width, height] = arguments.size;
    output::line(format_args!(
        "scene {}: {captures} captures at {} Hz by {} cameras of {width} x {height} pixels",
        scene.name(),
        arguments.rate,
        named.len()
    ))?;
    for (name, camera) in named {
        let place = camera.pose().translation.vector;
        let distance_m = distance_m(scene, camera);
        output::line(format_args!(
            "{name} at {:.2}, {:.2}, {:.2} m; units are {distance_m:.2} m away, where depths have a deviation of {:.2} mm",
            place.x,
            place.y,
            place.z,
            noise.deviation_m(distance_m) * 1e3,
        ))?;
    }
    let mut table = output::table(["unit", "pixels, mean", "fewest"]);
    for (index, (unit, pixels)) in scene.units().iter().zip(pixels).enumerate() {
        let least = pixels.least.unwrap_or_default();
        let cells =
            [format!("{index} {}", unit.shape), format!("{:.0}", pixels.mean()), least.to_string()];
        output::row(&mut table, cells);
    }
    output::table_lines(&table)?;
    output::line(format_args!("wrote {}, with {PREVIEW}", arguments.out.display()))
}

fn document(
    arguments: &Render,
    scene: &RecordedScene,
    named: &[(String, Camera)],
    (noise, smooth): (&DepthNoise, &SmoothErrors),
    captures: u64,
    pixels: &[Pixels],
) -> Value {
    let cameras = named.iter().map(|(name, camera)| {
        let (t, q) = (camera.pose().translation.vector, camera.pose().rotation.quaternion());
        let distance_m = distance_m(scene, camera);
        json!({
            "name": name,
            "pose": [t.x, t.y, t.z, q.w, q.i, q.j, q.k],
            "focal_px": camera.focal(),
            "units_away_m": distance_m,
            "deviation_there_m": noise.deviation_m(distance_m),
        })
    });
    let units = scene.units().iter().zip(pixels).enumerate().map(|(index, (unit, pixels))| {
        let (mean, least) = (pixels.mean(), pixels.least);
        json!({"unit": index, "shape": unit.shape, "pixels_mean": mean, "pixels_least": least})
    });
    json!({
        "out": arguments.out.display().to_string(),
        "scene": scene.name(),
        "captures": captures,
        "rate_hz": arguments.rate,
        "size": arguments.size,
        "depth_scale_m": SCALE_M,
        "noise": {
            "deviation_at_1m_m": noise.deviation_at_1m_m,
            "edge_loss": noise.edge_loss,
            "bowl": smooth.bowl,
            "step_at_1m_m": smooth.step_at_1m_m,
            "wave_at_1m_m": smooth.wave_at_1m_m,
            "seed": noise.seed,
        },
        "cameras": cameras.collect::<Vec<_>>(),
        "units": units.collect::<Vec<_>>(),
    })
}
