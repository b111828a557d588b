//! `rigidformer import`

mod budget;
mod csv_poses;
mod file;
mod mcap_poses;
mod motive;
mod named;
mod npy;
mod npz_poses;
mod shapes;
mod tracks;

use std::collections::{HashMap, HashSet};
use std::path::Path;

use nalgebra::{Point3, Vector3};
use rigidformer_evaluation::scenes::{Dataset, Split};
use rigidformer_runtime::core::{Physics, Plane, Role};
use rigidformer_runtime::files::shown as one_line;
use rigidformer_runtime::memory::Budget;
use serde_json::json;

use crate::arguments::{Import, RepeatsName, UpAxis};
use crate::usage::Usage;
use crate::{interrupt, output};
use budget::counted;
use file::{ImportedScene, ImportedUnit};
use named::Named;
use tracks::{Recording, Repeats, Resampled, Track};

/// Planes of a scene, at most.
const MOST_PLANES: usize = 8;

pub(crate) fn run(arguments: &Import) -> anyhow::Result<()> {
    interrupt::watch();
    let inputs = arguments.inputs.iter().chain(&arguments.points);
    output::apart("--out", &arguments.out, inputs.map(std::path::PathBuf::as_path))?;
    let options = Options::of(arguments)?;
    let mut budget = Budget::default();
    let given = match &arguments.points {
        Some(path) => csv_poses::points(path, &mut budget)?,
        None => HashMap::new(),
    };
    let mut recordings = Vec::new();
    let bar = output::progress(arguments.inputs.len() as u64, "recordings");
    for path in &arguments.inputs {
        interrupt::check()?;
        recordings.push(read(path, arguments, &mut budget)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    options.check_names(&recordings, &given, &arguments.unit)?;
    let mut rate_hz = arguments.fps;
    let mut scenes = Vec::new();
    let splits = splits(arguments, recordings.len());
    for (number, (recording, split)) in recordings.iter().zip(splits).enumerate() {
        interrupt::check()?;
        let resampled = tracks::resample(recording, rate_hz, arguments.gap, &budget)?;
        if rate_hz.is_none()
            && let Some(doubt) = doubt(resampled.rate_hz)
        {
            output::note(&format!("{}: {doubt}", recording.path.display()));
        }
        rate_hz = Some(resampled.rate_hz);
        scenes.push(options.scene(number, split, recording, resampled, &given, &mut budget)?);
        // Before the next one is made: so many may be too many for the memory.
        let (units, longest) = file::sizes(&scenes);
        tracks::fits(units, longest, &budget)?;
    }
    let rate_hz = rate_hz.unwrap_or_default();
    let notes = file::Notes {
        dataset: match (&arguments.name, arguments.out.file_stem()) {
            (Some(name), _) => name.clone(),
            (None, Some(stem)) => stem.to_string_lossy().into_owned(),
            (None, None) => "imported".into(),
        },
        licence: arguments.licence.clone(),
        rate_hz,
        gravity_m_s2: options.gravity_m_s2,
        planes: options.planes.clone(),
    };
    let bytes = file::encode(&scenes, &notes);
    // What another command would refuse is not written.
    let dataset = Dataset::from_bytes(arguments.out.clone(), bytes)?;
    for index in 0..dataset.len() {
        dataset.scene(index, None)?;
    }
    interrupt::check()?;
    output::write_whole(&arguments.out, dataset.bytes())?;
    told(arguments, &scenes, rate_hz, dataset.bytes().len())
}

fn read(path: &Path, arguments: &Import, budget: &mut Budget) -> anyhow::Result<Recording> {
    let wanted = &arguments.unit;
    let shown = path.display();
    let kind = path.extension().and_then(|kind| kind.to_str()).map(str::to_ascii_lowercase);
    let is_motive = kind.as_deref() == Some("csv") && motive::is_one(path);
    let mut recording = match kind.as_deref() {
        Some("csv") if is_motive => motive::read(path, budget)?,
        Some("csv") => csv_poses::read(path, budget)?,
        Some("npz") => npz_poses::read(path, budget)?,
        Some("mcap") => mcap_poses::read(path, wanted, budget)?,
        Some("ply" | "pcd") => anyhow::bail!(
            "{shown}: is a recording of a sensor; follow its units with `rigidformer track`, which writes a scene file and poses.csv"
        ),
        Some("c3d") => anyhow::bail!(
            "{shown}: has markers and no poses; make rigid bodies of them in the program that recorded it, and export those as CSV"
        ),
        _ => anyhow::bail!(
            "{shown}: is no recording that import knows by its name; give a file that ends in .csv, .npz or .mcap"
        ),
    };
    let is_wanted = |unit: &Track| wanted.is_empty() || wanted.contains(&unit.name);
    if !recording.units.iter().any(is_wanted) {
        return Err(named::none_wanted(
            path,
            recording.units.iter().map(|unit| unit.name.as_str()),
        ));
    }
    recording.units.retain(is_wanted);
    let is_y_up = arguments.up.map_or(is_motive, |up| up == UpAxis::Y);
    if is_motive && arguments.up.is_none() {
        output::note(&format!("{shown}: is of Motive, with y up; it is turned to z up"));
    }
    recording.rate_hz = recording.rate_hz.map(|rate_hz| rate_hz / arguments.time_scale);
    for unit in &mut recording.units {
        settle(path, unit, arguments, is_y_up)?;
    }
    Ok(recording)
}

/// Orders and converts the poses of a unit, and takes out frames in which it was lost.
fn settle(path: &Path, unit: &mut Track, arguments: &Import, is_y_up: bool) -> anyhow::Result<()> {
    let (shown, name) = (path.display(), one_line(&unit.name, 80));
    let repeats = match arguments.repeats {
        RepeatsName::Error => Repeats::Error,
        RepeatsName::KeepFirst => Repeats::KeepFirst,
        RepeatsName::KeepLast => Repeats::KeepLast,
    };
    let repeated = unit.order(repeats).map_err(|text| anyhow::anyhow!("{shown}: {text}"))?;
    if repeated > 0 {
        output::note(&format!(
            "{shown}: {repeated} rows of unit {name} are not later than those before; they are sorted, one pose an instant"
        ));
    }
    unit.convert(arguments.time_scale, f64::from(arguments.scale), is_y_up);
    if let Some((lost, off_m)) = unit.drop_lost() {
        output::note(&format!(
            "{shown}: {lost} poses of unit {name} are the origin without a turn, {off_m:.2} m off those beside: they are taken for frames in which it was lost"
        ));
    }
    unit.unflip();
    Ok(())
}

/// What is odd about a rate, in words.
fn doubt(rate_hz: f64) -> Option<String> {
    let units = [("milliseconds", "0.001"), ("microseconds", "1e-6"), ("nanoseconds", "1e-9")];
    let faster = [1e3, 1e6, 1e9].map(|factor| rate_hz * factor);
    // Cameras of motion capture have 10 to 2000 Hz.
    let likely = faster.iter().position(|rate| (10.0..=2000.0).contains(rate));
    let (unit, scale) = likely.filter(|_| rate_hz < 1.0).and_then(|at| units.get(at))?;
    Some(format!("has {rate_hz:.3e} poses a second; is its time in {unit}? --time-scale {scale}"))
}

/// A split for each scene: shuffled by the seed, the first ones for tests, the next ones for validation.
fn splits(arguments: &Import, count: usize) -> Vec<Split> {
    let mut order: Vec<usize> = (0..count).collect();
    let mut state = arguments.seed;
    for last in (1..count).rev() {
        let other = (splitmix(&mut state) % (last as u64 + 1)) as usize;
        order.swap(last, other);
    }
    let share = |share: f64| (share * count as f64).round() as usize;
    let (tests, validations) = (share(arguments.test_share), share(arguments.validation_share));
    let mut splits = vec![Split::Train; count];
    for (place, scene) in order.into_iter().enumerate() {
        if let Some(split) = splits.get_mut(scene) {
            *split = match place {
                place if place < tests => Split::Test,
                place if place < tests + validations => Split::Validation,
                _ => Split::Train,
            };
        }
    }
    splits
}

/// SplitMix64: the same splits on every machine.
fn splitmix(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut mixed = *state;
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

/// What the command line says of units and the world.
struct Options {
    shapes: Named<shapes::Solid>,
    physics: Named<Physics>,
    inertia: Named<[f32; 3]>,
    roles: Named<Role>,
    gravity_m_s2: Vector3<f32>,
    planes: Vec<Plane>,
    open_loop: bool,
}

impl Options {
    fn of(arguments: &Import) -> anyhow::Result<Self> {
        for (option, share) in [
            ("--test-share", arguments.test_share),
            ("--validation-share", arguments.validation_share),
        ] {
            if !(0.0..=1.0).contains(&share) {
                return Err(Usage(format!("{option} {share}: give a share from 0 to 1")).into());
            }
        }
        if arguments.test_share + arguments.validation_share > 1.0 {
            let text = "--test-share and --validation-share are more than 1 together; give less";
            return Err(Usage(text.into()).into());
        }
        for (option, number) in [("--fps", arguments.fps), ("--gap", arguments.gap)] {
            if let Some(number) = number.filter(|number| !(*number > 0.0 && *number <= 1e6)) {
                let text = format!("{option} {number}: give a number above 0, at most a million");
                return Err(Usage(text).into());
            }
        }
        let mut shapes = Named::default();
        for text in &arguments.boxes {
            let (name, [a, b, c]) = named::numbers("--box", text)?;
            shapes.add("--box", name, shapes::Solid::Box([a, b, c]).checked("--box", text)?)?;
        }
        for text in &arguments.cylinders {
            let (name, [radius, height]) = named::numbers("--cylinder", text)?;
            let solid = shapes::Solid::Cylinder { radius, height };
            shapes.add("--cylinder", name, solid.checked("--cylinder", text)?)?;
        }
        for text in &arguments.spheres {
            let (name, [radius]) = named::numbers("--sphere", text)?;
            let solid = shapes::Solid::Sphere { radius };
            shapes.add("--sphere", name, solid.checked("--sphere", text)?)?;
        }
        let mut physics = Named::default();
        for text in &arguments.physics {
            let (name, [mass_kg, friction, restitution]) = named::numbers("--physics", text)?;
            if !(mass_kg > 0.0 && friction >= 0.0 && restitution >= 0.0) {
                let text = format!(
                    "--physics {text}: give a mass above 0, and friction and restitution of at least 0"
                );
                return Err(Usage(text).into());
            }
            physics.add("--physics", name, Physics { mass_kg, friction, restitution })?;
        }
        let mut inertia = Named::default();
        for text in &arguments.inertia {
            let (name, moments) = named::numbers("--inertia", text)?;
            let [a, b, c]: [f32; 3] = moments;
            // No body has a moment above the sum of the others'; what is read back may be off in its last digit.
            if a.min(b).min(c) <= 0.0 || 2.0 * a.max(b).max(c) > (a + b + c) * 1.000_01 {
                let problem = format!(
                    "--inertia {text}: each moment must be above 0 and at most the sum of the other two, kg m2"
                );
                return Err(Usage(problem).into());
            }
            inertia.add("--inertia", name, moments)?;
        }
        let mut roles = Named::default();
        for (option, names, role) in [
            ("--fixed", &arguments.fixed, Role::Fixed),
            ("--driven", &arguments.driven, Role::Driven),
        ] {
            for name in names {
                roles.add(option, name.clone(), role)?;
            }
        }
        let [x, y, z] = named::row("--gravity", &arguments.gravity)?;
        let mut planes = Vec::new();
        if !arguments.no_ground {
            let [friction, restitution] = named::row("--ground", &arguments.ground)?;
            planes.push(plane(
                "--ground",
                &arguments.ground,
                [0.0, 0.0, 1.0, 0.0, friction, restitution],
            )?);
        }
        for text in &arguments.plane {
            planes.push(plane("--plane", text, named::row("--plane", text)?)?);
        }
        if planes.len() > MOST_PLANES {
            return Err(Usage(format!(
                "--plane: {} planes with the ground; a scene has {MOST_PLANES} at most",
                planes.len()
            ))
            .into());
        }
        Ok(Self {
            shapes,
            physics,
            inertia,
            roles,
            gravity_m_s2: Vector3::new(x, y, z),
            planes,
            open_loop: arguments.open_loop,
        })
    }

    /// Refuses names of options that no recording has: they are mistyped.
    fn check_names(
        &self,
        recordings: &[Recording],
        given: &HashMap<String, Vec<Point3<f32>>>,
        wanted: &[String],
    ) -> anyhow::Result<()> {
        let known: HashSet<&str> = recordings
            .iter()
            .flat_map(|recording| recording.units.iter().map(|unit| unit.name.as_str()))
            .collect();
        let asked = self.shapes.names().chain(self.physics.names());
        let asked = asked.chain(self.inertia.names()).chain(self.roles.names());
        let asked = asked.chain(wanted.iter().map(|name| ("--unit", name.as_str())));
        // Points of units that are not wanted may stay in their file.
        let given = given.keys().filter(|_| wanted.is_empty());
        let asked = asked.chain(given.map(|name| ("--points", name.as_str())));
        for (option, name) in asked {
            if !known.contains(name) {
                return Err(Usage(format!(
                    "{option}: unknown unit {name}: no recording has it; they have {}",
                    named::listed(known.iter().copied())
                ))
                .into());
            }
        }
        Ok(())
    }

    fn scene(
        &self,
        number: usize,
        split: Split,
        recording: &Recording,
        resampled: Resampled,
        given: &HashMap<String, Vec<Point3<f32>>>,
        budget: &mut Budget,
    ) -> anyhow::Result<ImportedScene> {
        let usual = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.4 };
        let mut units = Vec::new();
        for (unit, poses) in recording.units.iter().zip(resampled.poses) {
            let name = &unit.name;
            let own = self.shapes.own(name).map(shapes::Solid::points);
            // A copy, and the same in the file and in the scene that is read back.
            let copied = given.get(name).or(unit.points.as_ref()).map_or(0, Vec::len);
            let copied = (copied as u64).saturating_mul(3 * size_of::<Point3<f32>>() as u64);
            counted(&recording.path, budget, copied)?;
            let points = own
                .or_else(|| given.get(name).cloned())
                .or_else(|| unit.points.clone())
                .or_else(|| self.shapes.rest().map(shapes::Solid::points));
            let Some(points) = points else {
                let name = one_line(name, 80);
                anyhow::bail!(
                    "{}: unit {name} has no points; give them with --points FILE, --box {name}=A,B,C, --cylinder {name}=R,H or --sphere {name}=R",
                    recording.path.display()
                );
            };
            if points.len() < 4 {
                anyhow::bail!(
                    "{}: unit {name} has {} points; a unit needs at least 4",
                    recording.path.display(),
                    points.len()
                );
            }
            let role = self.roles.get(name).copied().unwrap_or(Role::Free);
            let mut poses = poses;
            if let (Role::Fixed, Some(first)) = (role, poses.first().copied()) {
                poses.fill(first);
            }
            let velocity = self
                .open_loop
                .then(|| tracks::velocity(&poses, resampled.rate_hz, self.gravity_m_s2, role));
            units.push(ImportedUnit {
                name: name.clone(),
                points,
                physics: self.physics.get(name).copied().unwrap_or(usual),
                inertia: self.inertia.get(name).copied(),
                role,
                velocity,
                poses: poses.iter().map(tracks::Pose::numbers).collect(),
            });
        }
        Ok(ImportedScene { seed: number as i64, split, units, from: recording.path.clone() })
    }
}

fn plane(option: &str, text: &str, numbers: [f32; 6]) -> anyhow::Result<Plane> {
    let [x, y, z, offset_m, friction, restitution] = numbers;
    let normal = Vector3::new(x, y, z);
    let is_normal = (normal.norm() - 1.0).abs() < 1e-3;
    if !(is_normal && friction >= 0.0 && restitution >= 0.0) {
        return Err(Usage(format!(
            "{option} {text}: give a normal of length 1, and friction and restitution of at least 0"
        ))
        .into());
    }
    Ok(Plane { normal: normal.normalize(), offset_m, friction, restitution })
}

fn told(
    arguments: &Import,
    scenes: &[ImportedScene],
    rate_hz: f64,
    bytes: usize,
) -> anyhow::Result<()> {
    let of = |split: Split| scenes.iter().filter(|scene| scene.split == split).count();
    let (train, validation, test) = (of(Split::Train), of(Split::Validation), of(Split::Test));
    if arguments.json {
        let rows = scenes.iter().map(|scene| {
            let units = scene.units.iter().map(|unit| {
                json!({ "name": unit.name, "points": unit.points.len(), "mass_kg": unit.physics.mass_kg })
            });
            json!({
                "from": scene.from.display().to_string(),
                "split": scene.split.to_string(),
                "frames": scene.frames(),
                "units": units.collect::<Vec<_>>(),
            })
        });
        return output::json(&json!({
            "out": arguments.out.display().to_string(),
            "bytes": bytes,
            "frame_rate_hz": rate_hz,
            "train": train,
            "validation": validation,
            "test": test,
            "scenes": rows.collect::<Vec<_>>(),
        }));
    }
    let frames = scenes.iter().map(ImportedScene::frames);
    let (least, most) = (frames.clone().min().unwrap_or(0), frames.max().unwrap_or(0));
    output::line(format_args!(
        "{}: {} scenes of {least} to {most} frames at {rate_hz} Hz; {train} to learn from, {validation} to choose by, {test} for tests; {bytes} bytes",
        arguments.out.display(),
        scenes.len(),
    ))
}
