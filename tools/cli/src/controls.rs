//! `rigidformer controls`: videos that drive rendering.

mod colours;
mod draw;
mod motion;
mod shape;
mod view;

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use nalgebra::{Point3, Vector3};
use rigidformer_evaluation::pivots::joined;
use rigidformer_evaluation::predicted::predict;
use rigidformer_evaluation::rollout::open_loop_on;
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_perception::camera::Camera;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::files::{FileError, write_whole};
use rigidformer_runtime::progress::Progress;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::arguments::{Controls, usual_step};
use crate::picture::Stage;
use crate::tosses::JOIN_FRAME;
use crate::usage::Usage;
use crate::video::{Colours, Kind, Video};
use crate::{defaults, interrupt, output};

use colours::{Palette, seen};
use draw::{Canvas, Spot};
use motion::{Instant, Motion, Prediction};
use shape::Shape;
use view::{Lens, middle};

/// The camera is fitted to no more instants of the motion than this, which bounds memory and time.
const MOST_INSTANTS: u32 = 512;
/// Whatever is farther from the origin than this counts as a mistake, metres.
const FARTHEST_M: f32 = 1e6;
/// A time that misses the end by less than this is within the motion, seconds.
const ROUNDING_S: f64 = 1e-6;

pub(crate) fn run(arguments: &Controls) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    check_outputs(arguments)?;
    let dataset = defaults::dataset(arguments.scene.as_deref())?;
    let first_of_test = || dataset.scenes_of(Split::Test).first().copied().unwrap_or(0);
    let index = arguments.index.unwrap_or_else(first_of_test);
    let scene = dataset.scene(index, None)?;
    let (motion, poses_are) = moving(arguments, &dataset, scene, cancelled)?;
    let span_s = span_s(arguments, &motion)?;

    let shape = match arguments.mesh {
        true => Shape::surfaces(&motion.scene),
        false => Shape::points(&motion.scene),
    };
    let fitted = times(span_s, arguments.frames.min(MOST_INSTANTS));
    let all = whole_motion(&motion, &shape, &fitted)?;
    let camera = camera(arguments, &all)?;
    let first: Vec<Vector3<f32>> =
        shape.placed(&instant(&motion, 0.0)?).iter().map(|point| seen(&camera, point)).collect();
    let palette = Palette::new(&camera, &first);
    let beside = first.iter().filter(|point| !palette.shows(point)).count();
    // Of surfaces, and of more instants than these, only pictures tell.
    let is_known = !arguments.mesh && arguments.frames <= MOST_INSTANTS;
    if is_known && !all.iter().any(|point| palette.shows(&seen(&camera, point))) {
        return Err(unseen(&all).into());
    }

    let kind = Kind {
        size: arguments.size,
        rate: arguments.fps,
        frames: arguments.frames,
        colours: if arguments.exact { Colours::Exact } else { Colours::Shared },
    };
    let away_m = (camera.pose().translation.vector - middle(&all).coords).norm();
    let stage = Stage::new(&motion.scene, &camera, away_m);
    let mut files = Files::create(arguments, kind)?;
    let bar = output::progress(u64::from(arguments.frames), motion.scene.name());
    let [mut starts_empty, mut is_empty] = [true; 2];
    for (number, time_s) in times(span_s, arguments.frames).iter().enumerate() {
        interrupt::check()?;
        let instant = instant(&motion, *time_s)?;
        let now = shape.placed(&instant);
        let spots: Vec<Spot> = now
            .iter()
            .zip(&first)
            .map(|(point, first)| Spot { now: seen(&camera, point), first: *first })
            .collect();
        let tracked = tracked(&shape, &spots, shape.lift_m(&now), arguments, &palette);
        let rendered =
            arguments.rendered.as_ref().map(|_| stage.pixels(&instant.poses, &instant.soft));
        is_empty &= !tracked.is_used();
        starts_empty &= number > 0 || is_empty;
        files.push(number, &tracked.pixels, rendered.as_deref())?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    interrupt::check()?;
    if is_empty {
        return Err(unseen(&all).into());
    }
    let bytes = files.finish()?;

    let made =
        Made { motion: &motion, poses_are, span_s, camera, palette, beside, starts_empty, bytes };
    let vertices = first.len();
    if arguments.json {
        output::json(&document(arguments, &made, vertices))?;
    } else {
        print(arguments, &made)?;
    }
    warn(&made, &shape, vertices);
    Ok(())
}

/// What there is to say at the end.
struct Made<'m> {
    motion: &'m Motion,
    poses_are: String,
    span_s: f64,
    camera: Camera,
    palette: Palette,
    /// Vertices that begin beside the picture.
    beside: usize,
    /// Whether nothing is in the first picture.
    starts_empty: bool,
    /// Of the videos.
    bytes: (u64, Option<u64>),
}

fn unseen(all: &[Point3<f32>]) -> Usage {
    let [x, y, z]: [f32; 3] = middle(all).into();
    Usage(format!(
        "the camera sees no unit in any frame; look at the middle of the motion with --look-at {x:.2},{y:.2},{z:.2}, or leave --eye out"
    ))
}

/// Looks where the files go, so that a path that cannot be written costs no computation.
fn check_outputs(arguments: &Controls) -> anyhow::Result<()> {
    let inputs = || arguments.scene.iter().chain(&arguments.model.path).map(PathBuf::as_path);
    let videos = [
        Some(("--out", &arguments.out)),
        arguments.rendered.as_ref().map(|path| ("--rendered", path)),
    ];
    let all =
        videos.into_iter().flatten().chain(arguments.png.as_ref().map(|path| ("--png", path)));
    let here = std::env::current_dir().and_then(|folder| folder.canonicalize()).ok();
    let mut before: Vec<PathBuf> = Vec::new();
    for (option, path) in all {
        let (shown, is_png) = (path.display(), option == "--png");
        let is_used = || path.read_dir().is_ok_and(|mut entries| entries.next().is_some());
        let own = place(path);
        let is_fixed =
            own.is_none() || own == here || own.as_ref().is_some_and(|own| own.is_symlink());
        let holds = |video: &PathBuf| own.as_ref().is_some_and(|own| video.starts_with(own));
        let problem = if !folder_of(path).is_dir() {
            "its folder does not exist; make it first"
        } else if own.as_ref().is_some_and(|own| before.contains(own)) {
            "two options name this file; give two names"
        } else if is_png && is_fixed {
            "is a link, or the folder that you are in; name a folder that does not exist"
        } else if is_png && path.exists() && !path.is_dir() {
            "is a file; name a folder that does not exist"
        } else if is_png && is_used() {
            "is a folder with something in it; name another one, or empty it"
        } else if is_png && before.iter().any(holds) {
            "a video goes into this folder; name another one"
        } else if !is_png && path.is_dir() {
            "is a folder; name a file in it"
        } else if !is_png && path.to_string_lossy().ends_with(std::path::is_separator) {
            "ends like a folder; name a file"
        } else {
            output::apart(option, path, inputs())?;
            before.extend(own);
            continue;
        };
        return Err(Usage(format!("{option} {shown}: {problem}")).into());
    }
    Ok(())
}

/// The folder that a path is in.
fn folder_of(path: &Path) -> &Path {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

/// Where a file is or will be, the same for all of its names. A link is where it lies, as renaming replaces it. `None` where a path has
/// no name, such as `.`, or no folder.
fn place(path: &Path) -> Option<PathBuf> {
    Some(folder_of(path).canonicalize().ok()?.join(path.file_name()?))
}

/// The motion to show, and what it is.
fn moving(
    arguments: &Controls,
    dataset: &Dataset,
    scene: RecordedScene,
    cancelled: &AtomicBool,
) -> anyhow::Result<(Motion, String)> {
    if arguments.recorded {
        return Ok((Motion { scene, predicted: None }, "recorded".into()));
    }
    let step = arguments.step.unwrap_or_else(|| usual_step(dataset));
    let loaded = defaults::model(&arguments.model)?.for_host()?;
    let engine = Engine::new()?;
    let poses_are = format!("predicted by {}, step {step}", loaded.model().file().name());
    if scene.has_velocities() {
        let scene = if arguments.join { joined(scene, JOIN_FRAME)? } else { scene };
        let progress = Progress { cancelled, ..Progress::none() };
        let poses = open_loop_on(engine, &loaded, &scene, step, progress)?;
        let rate_hz = f64::from(loaded.model().config().frame_rate_hz);
        let predicted = Some(Prediction { poses, points: None, rate_hz });
        return Ok((Motion { scene, predicted }, poses_are));
    }
    let last = u32::try_from(scene.frames().saturating_sub(1)).unwrap_or(u32::MAX);
    let needed = step.saturating_mul(2);
    if needed > last {
        let (name, frames) = (scene.name(), scene.frames());
        return Err(Usage(format!(
            "--step {step}: the first prediction is frame {needed}, and {name} has {frames} frames; give a smaller step, or --recorded"
        ))
        .into());
    }
    let scene = if arguments.join { joined(scene, step as usize)? } else { scene };
    let last = last - last % step;
    let bar = output::progress(u64::from(last / step - 1), scene.name());
    let stepped = || bar.inc(1);
    let progress = Progress { cancelled, stepped: &stepped };
    let made = predict(engine, &loaded, &scene, step, last, progress)?;
    bar.finish_and_clear();
    let rate_hz = f64::from(scene.frame_rate_hz());
    let predicted = Some(Prediction { poses: made.poses, points: made.points, rate_hz });
    Ok((Motion { scene, predicted }, poses_are))
}

/// Seconds of the motion that the video shows.
fn span_s(arguments: &Controls, motion: &Motion) -> Result<f64, Usage> {
    let most_s = motion.duration_s();
    let wanted_s = arguments.seconds.unwrap_or(most_s);
    if wanted_s > most_s + ROUNDING_S {
        let what = if arguments.recorded { "recorded" } else { "predicted" };
        return Err(Usage(format!(
            "--seconds {wanted_s}: {most_s:.3} s of {} are {what}; give less, or leave --seconds out",
            motion.scene.name()
        )));
    }
    Ok(wanted_s.min(most_s))
}

/// Evenly spaced, the first at 0 and the last at the end.
fn times(span_s: f64, frames: u32) -> Vec<f64> {
    let gaps = f64::from(frames.saturating_sub(1).max(1));
    (0..frames).map(|frame| span_s * f64::from(frame) / gaps).collect()
}

fn instant(motion: &Motion, time_s: f64) -> anyhow::Result<Instant> {
    motion.at(time_s).ok_or_else(|| {
        let name = motion.scene.name();
        anyhow::anyhow!("{name}: nothing is known of {time_s} s; give fewer --seconds")
    })
}

/// Everywhere that vertices are at these times.
fn whole_motion(motion: &Motion, shape: &Shape, times: &[f64]) -> anyhow::Result<Vec<Point3<f32>>> {
    let mut all = Vec::new();
    for time_s in times {
        interrupt::check()?;
        all.extend(shape.placed(&instant(motion, *time_s)?));
    }
    if all.is_empty() {
        anyhow::bail!("{}: has no point to track; give another scene", motion.scene.name());
    }
    // Not-a-number is not within either.
    let is_within = |point: &Point3<f32>| point.coords.iter().all(|x| x.abs() <= FARTHEST_M);
    if !all.iter().all(is_within) {
        let name = motion.scene.name();
        let (what, remedy) = match motion.predicted {
            Some(_) => ("prediction", "give a smaller --step, or --recorded"),
            None => ("record", "give another scene with --index"),
        };
        anyhow::bail!(
            "{name}: the {what} has points that are no numbers or more than {FARTHEST_M} m away; {remedy}"
        );
    }
    Ok(all)
}

fn camera(arguments: &Controls, all: &[Point3<f32>]) -> anyhow::Result<Camera> {
    let lens = Lens { size: arguments.size, view_rad: arguments.view.to_radians() };
    let Some(eye) = arguments.eye.map(Point3::from) else {
        let angles = [arguments.azimuth, arguments.elevation].map(f32::to_radians);
        return Ok(lens.fit(all, angles)?);
    };
    let target = arguments.look_at.map_or_else(|| middle(all), Point3::from);
    match lens.between(&eye, &target) {
        Some(camera) => Ok(camera?),
        None => Err(Usage(
            "--eye and --look-at: the camera stands where it looks; give two places".into(),
        )
        .into()),
    }
}

/// A frame of the tracking video.
fn tracked<'p>(
    shape: &Shape,
    spots: &[Spot],
    lift_m: f32,
    arguments: &Controls,
    palette: &'p Palette,
) -> Canvas<'p> {
    let mut canvas = Canvas::new(arguments.size, palette);
    for (triangles, lift_m) in [(&shape.triangles, 0.0), (&shape.sheets, lift_m)] {
        for [a, b, c] in triangles {
            if let (Some(a), Some(b), Some(c)) = (spots.get(*a), spots.get(*b), spots.get(*c)) {
                canvas.triangle([*a, *b, *c], lift_m);
            }
        }
    }
    for spot in shape.squares.iter().filter_map(|vertex| spots.get(*vertex)) {
        canvas.square(spot, arguments.side);
    }
    canvas
}

/// The files that the command line asks for, without their names so far.
struct Files<'a> {
    tracking: Video,
    rendered: Option<Video>,
    png: Option<(&'a Path, TempDir)>,
    size: [u32; 2],
}

impl<'a> Files<'a> {
    fn create(arguments: &'a Controls, kind: Kind) -> anyhow::Result<Files<'a>> {
        let png = match arguments.png.as_deref() {
            Some(path) => {
                let mut builder = tempfile::Builder::new();
                builder.prefix(".rigidformer-");
                #[cfg(unix)]
                {
                    use std::os::unix::fs::PermissionsExt;
                    // As any new folder; the umask applies. Temporary folders are private otherwise.
                    builder.permissions(std::fs::Permissions::from_mode(0o777));
                }
                let folder =
                    builder.tempdir_in(folder_of(path)).map_err(|source| unmade(path, source))?;
                Some((path, folder))
            }
            None => None,
        };
        let rendered = arguments.rendered.as_deref();
        Ok(Files {
            tracking: Video::create(&arguments.out, kind)?,
            rendered: rendered.map(|path| Video::create(path, kind)).transpose()?,
            png,
            size: arguments.size,
        })
    }

    fn push(
        &mut self,
        number: usize,
        tracked: &[[u8; 3]],
        rendered: Option<&[[u8; 3]]>,
    ) -> anyhow::Result<()> {
        self.tracking.push(tracked)?;
        if let (Some(video), Some(pixels)) = (&mut self.rendered, rendered) {
            video.push(pixels)?;
        }
        if let Some((_, folder)) = &self.png {
            let write = |what: &str, pixels: &[[u8; 3]]| -> anyhow::Result<()> {
                let path = folder.path().join(format!("{number:05}-{what}.png"));
                Ok(write_whole(&path, &png(self.size, pixels)?)?)
            };
            write("tracking", tracked)?;
            rendered.map_or(Ok(()), |pixels| write("rendered", pixels))?;
        }
        Ok(())
    }

    /// Gives all files their names. Bytes of the videos.
    fn finish(self) -> anyhow::Result<(u64, Option<u64>)> {
        let tracking = self.tracking.finish()?;
        let rendered = self.rendered.map(Video::finish).transpose()?;
        if let Some((path, folder)) = self.png {
            // From here on the frames stay, whatever happens.
            let made = folder.keep();
            named(&made, path).map_err(|source| {
                let (path, made) = (path.display(), made.display());
                anyhow::anyhow!(
                    "{path}: cannot be made: {source}; the frames are in {made}: rename that folder"
                )
            })?;
        }
        Ok((tracking, rendered))
    }
}

/// Gives a folder its name.
fn named(made: &Path, path: &Path) -> std::io::Result<()> {
    // An empty folder of this name makes room.
    if path.is_dir() {
        std::fs::remove_dir(path)?;
    }
    std::fs::rename(made, path)
}

fn unmade(path: &Path, source: std::io::Error) -> FileError {
    FileError {
        path: path.into(),
        action: "cannot be made",
        remedy: "name a new folder below one that you may write to",
        source,
    }
}

fn png([width, height]: [u32; 2], pixels: &[[u8; 3]]) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels.as_flattened())?;
    writer.finish()?;
    Ok(bytes)
}

fn print(arguments: &Controls, made: &Made<'_>) -> anyhow::Result<()> {
    let (scene, [width, height]) = (&made.motion.scene, arguments.size);
    output::line(format_args!(
        "scene {}: {} units, {} points; {}",
        scene.name(),
        scene.units().len(),
        scene.points(),
        made.poses_are
    ))?;
    let rate_hz = arguments.fps.hz();
    let plays_s = f64::from(arguments.frames) / rate_hz;
    output::line(format_args!(
        "{} frames of {width} x {height} pixels over {:.3} s of the motion; at {rate_hz} frames a second they play {plays_s:.2} s",
        arguments.frames, made.span_s
    ))?;
    let [x, y, z]: [f32; 3] = made.camera.pose().translation.vector.into();
    let [far, near] = made.palette.inverse_m;
    let blue = match near > far {
        true => format!("blue is 0 at {:.2} m and 255 at {:.2} m", 1.0 / far, 1.0 / near),
        false => "blue is 128 throughout: all points are equally far".into(),
    };
    output::line(format_args!(
        "camera at {x:.2}, {y:.2}, {z:.2} m, focal length {:.1} pixels; {blue}",
        made.camera.focal()[0]
    ))?;
    let (tracking, rendered) = made.bytes;
    let wrote = |path: &Path, bytes: u64| {
        output::line(format_args!("wrote {}, {:.1} MB", path.display(), bytes as f64 / 1e6))
    };
    wrote(&arguments.out, tracking)?;
    if let (Some(path), Some(bytes)) = (&arguments.rendered, rendered) {
        wrote(path, bytes)?;
    }
    match &arguments.png {
        Some(path) => output::line(format_args!("wrote {}", path.display())),
        None => Ok(()),
    }
}

fn warn(made: &Made<'_>, shape: &Shape, vertices: usize) {
    if made.starts_empty {
        output::note(
            "nothing is in the picture in the first frame, so colours say little; move the camera, or leave --eye out",
        );
    } else if made.beside > 0 {
        output::note(&format!(
            "{} of {vertices} points begin beside the picture and have the colours of its edges",
            made.beside
        ));
    }
    if !shape.flat.is_empty() {
        let numbers: Vec<String> = shape.flat.iter().map(ToString::to_string).collect();
        output::note(&format!(
            "units {} have no surface, and are drawn as their points",
            numbers.join(", ")
        ));
    }
}

fn document(arguments: &Controls, made: &Made<'_>, vertices: usize) -> Value {
    let camera = &made.camera;
    let (t, q) = (camera.pose().translation.vector, camera.pose().rotation.quaternion());
    let (tracking, rendered) = made.bytes;
    let path = |path: &Path| path.display().to_string();
    json!({
        "scene": made.motion.scene.name(),
        "poses": made.poses_are,
        "frames": arguments.frames,
        "rate_hz": arguments.fps.hz(),
        "size": arguments.size,
        "span_s": made.span_s,
        "camera": {
            "pose": [t.x, t.y, t.z, q.w, q.i, q.j, q.k],
            "focal_px": camera.focal(),
            "centre_px": camera.centre(),
        },
        "tracked": if arguments.mesh { "surfaces" } else { "points" },
        "points": vertices,
        "points_beside_the_first_picture": made.beside,
        "inverse_depth_per_m": made.palette.inverse_m,
        "exact": arguments.exact,
        "out": path(&arguments.out),
        "bytes": tracking,
        "rendered": arguments.rendered.as_deref().map(path),
        "rendered_bytes": rendered,
        "png": arguments.png.as_deref().map(path),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_over_the_whole_span() {
        assert_eq!(times(0.5, 3), [0.0, 0.25, 0.5]);
        assert_eq!(times(0.5, 1), [0.0]);
    }
}
