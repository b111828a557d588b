//! `rigidformer track`

mod facts;
mod files;
mod followed;
mod gravity;
mod live;
mod objects;
mod pipe;
mod source;
mod truth;
mod viewed;
mod words;

use rigidformer_evaluation::score::Score;
use rigidformer_evaluation::segments::{self, SegmentsScore};
use rigidformer_perception::gravity::Gravity;
use rigidformer_perception::tracker::{Segmentation, Tracker, TrackerOptions};
use serde_json::{Value, json};

use crate::arguments::{SegmentationName, Track};
use crate::usage::Usage;
use crate::viewers::Viewers;
use crate::{defaults, interrupt, output};
use followed::Followed;
use source::Source;
use truth::{Scores, Truth};
use words::rest_word;

pub(crate) fn run(arguments: &Track) -> anyhow::Result<()> {
    interrupt::watch();
    if source::is_pipe(arguments) {
        return run_live(arguments);
    }
    if arguments.truth_labels && arguments.segmentation == SegmentationName::Given {
        let what = "--truth-labels scores segments that are found: leave --segmentation given out";
        return Err(Usage(what.into()).into());
    }
    let viewers = Viewers::open(&arguments.viewers)?;
    let inputs = || {
        let paths = std::iter::once(&arguments.input).chain(&arguments.truth);
        let paths = paths.chain(&arguments.mask);
        paths.chain(&arguments.model.path).map(|path| path.as_path())
    };
    viewers.apart_from(inputs())?;
    let folder = folder(arguments);
    let own = folder.iter().flat_map(|folder| files::RESULTS.map(|name| folder.join(name)));
    let own: Vec<_> = own.collect();
    for path in &own {
        output::apart("--out", path, inputs())?;
    }
    let own = own.iter().map(|path| ("--out", path.as_path()));
    output::distinct(own.chain(viewers.paths()))?;
    let mut source = Source::open(arguments)?;
    if !arguments.reads_labels() {
        source = source.without_labels();
    }
    let (options, gravity) = options(arguments, &mut source)?;
    let mut tracker = Tracker::new(options.clone()).map_err(|error| Usage(error.to_string()))?;
    let mut truth = Truth::open(arguments, &mut source)?;

    let bar = output::progress(source.count().unwrap_or(0), "following");
    let mut followed = Followed::default();
    while let Some(capture) = source.next() {
        interrupt::check()?;
        let mut capture = capture?;
        if let Some(truth) = &mut truth {
            truth.see(&capture);
        }
        if let Some(mask) = &arguments.mask {
            objects::mask(mask, &mut capture, followed.estimates.is_empty())?;
        }
        followed.take(&mut tracker, &capture, truth.is_some())?;
        if arguments.truth_labels {
            followed.score_segments(&tracker, &capture)?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    if followed.estimates.is_empty() {
        if let Some(failure) = source.failure.take() {
            return Err(failure);
        }
        anyhow::bail!("{}: no capture is in it; record some", arguments.input.display());
    }
    let segments = match (arguments.truth_labels, segments::mean(&followed.segments)) {
        (true, None) => anyhow::bail!(
            "{}: --truth-labels needs depth images with labels, and none has any",
            arguments.input.display()
        ),
        (_, mean) => mean,
    };
    followed.planes = tracker.planes().to_vec();
    let scores = match &mut truth {
        Some(truth) => Some(truth.scores(&options, &followed)?),
        None => None,
    };
    let mut results = Vec::new();
    if let Some(folder) = &folder {
        results.extend(files::made(folder, source.name(), &options, &followed)?);
    }
    if viewers.is_asked() {
        let scene = truth.as_ref().map(Truth::scene);
        results.extend(viewers.made(&viewed::moving(source.name(), &followed, scene))?);
    }
    interrupt::check()?;
    if let Some(folder) = &folder {
        output::folder(folder)?;
    }
    output::write_results(&results, arguments.json)?;
    let notes = notes(&source, &followed, &gravity);
    notes.iter().for_each(|note| output::note(note));
    if arguments.json {
        let mut document = document(&source, &followed, &gravity, scores.as_ref(), &notes);
        if let Some(segments) = &segments {
            document["segments"] = segments_document(segments, followed.segments.len());
        }
        return output::json(&document);
    }
    print(arguments, &followed, &gravity, scores.as_ref())?;
    segments.iter().try_for_each(|segments| print_segments(segments, followed.segments.len()))
}

/// Follows what comes from standard input.
fn run_live(arguments: &Track) -> anyhow::Result<()> {
    let others = [
        (arguments.out.is_some(), "--out"),
        (arguments.mask.is_some(), "--mask"),
        (arguments.truth.is_some(), "--truth"),
        (arguments.truth_labels, "--truth-labels"),
        (arguments.viewers.mcap.is_some(), "--mcap"),
        (arguments.viewers.gltf.is_some(), "--gltf"),
        (arguments.viewers.html.is_some(), "--html"),
    ];
    if let Some((_, name)) = others.iter().find(|(is_given, _)| *is_given) {
        let what = format!("{name} needs a recording: of a pipe nothing is kept");
        return Err(Usage(what).into());
    }
    let mut source = Source::open(arguments)?;
    let (options, gravity) = options(arguments, &mut source)?;
    if let Some(note) = gravity::note(&gravity) {
        output::note(&note);
    }
    let mut tracker = Tracker::new(options).map_err(|error| Usage(error.to_string()))?;
    live::follow(&mut tracker, &mut source, &gravity)
}

fn options(arguments: &Track, source: &mut Source) -> anyhow::Result<(TrackerOptions, Gravity)> {
    let mut options = TrackerOptions::default();
    options.model = match arguments.no_model {
        true => None,
        false => Some(defaults::model(&arguments.model)?.for_host()?),
    };
    options.network = !arguments.no_network;
    options.segmentation = match arguments.mask {
        Some(_) => Segmentation::Given,
        None => arguments.segmentation.into(),
    };
    options.objects = match source.scene().filter(|_| arguments.known) {
        Some(scene) => objects::of_scene(scene)?,
        None => objects::read(arguments, options.density_kg_m3)?,
    };
    let [friction, restitution] = arguments.physics[..] else {
        return Err(Usage("--physics needs two numbers, such as 0.5,0.4".into()).into());
    };
    options.plane_physics = [friction, restitution];
    options.unit_physics = [friction, restitution];
    let gravity = gravity::gravity(arguments, source)?;
    options.gravity_m_s2 = gravity.m_s2;
    Ok((options, gravity))
}

/// Where results go, if anywhere.
fn folder(arguments: &Track) -> Option<std::path::PathBuf> {
    arguments.out.clone().or_else(|| (!arguments.json).then(|| "track".into()))
}

/// What a user should know.
fn notes(source: &Source, followed: &Followed, gravity: &Gravity) -> Vec<String> {
    let mut notes: Vec<String> = gravity::note(gravity).into_iter().collect();
    notes.extend(source.notes());
    notes.extend(followed.facts.doubts().iter().map(ToString::to_string));
    if let Some(failure) = &source.failure {
        let count = source.unreadable;
        notes.push(format!("{count} captures cannot be read and are left out: {failure:#}"));
    }
    let held = followed.held();
    if held > 0 {
        notes.push(format!(
            "{held} units rest on nothing that is seen, and are held still until they move"
        ));
    }
    notes.extend(facts::reason(followed));
    for (count, what) in [
        (followed.clusters_left_out, "clusters were left out: there were too many"),
        (followed.blind, "captures had an image that shows nothing"),
        (
            followed.without_forecast,
            "captures were predicted by free motion: the model refused the scene",
        ),
        (
            followed.left_out,
            "times a unit was left out of a prediction: too few of its points were seen, it was lost, or its velocity is a guess",
        ),
    ] {
        if count > 0 {
            notes.push(format!("{count} {what}"));
        }
    }
    notes
}

fn print(
    arguments: &Track,
    followed: &Followed,
    gravity: &Gravity,
    scores: Option<&Scores>,
) -> anyhow::Result<()> {
    output::line(format_args!(
        "{}: {} captures, {} planes; {:.1} ms a capture, at most {:.1}",
        arguments.input.display(),
        followed.estimates.len(),
        followed.planes.len(),
        followed.milliseconds(),
        followed.slowest.as_secs_f64() * 1e3,
    ))?;
    output::line(facts::line(&followed.facts, &followed.planes, gravity))?;
    let mut table =
        output::table(["unit", "from s", "to s", "seen", "points", "at last", "object"]);
    for (id, first, last, seen) in followed.units() {
        let at_last = followed.last_of(id);
        let points = at_last.map(|unit| unit.points.len());
        let rest = at_last.map_or("", |unit| rest_word(unit.rest)).to_owned();
        let cells = [format!("{first:.3}"), format!("{last:.3}"), seen.to_string()];
        let points = points.unwrap_or(0).to_string();
        let object = followed.objects.get(&id).cloned().unwrap_or_default();
        let last = [points, rest, object];
        output::row(&mut table, [id.to_string()].into_iter().chain(cells).chain(last));
    }
    output::table_lines(&table)?;
    if let Some(scores) = scores {
        print_scores(scores)?;
    }
    Ok(())
}

fn print_scores(scores: &Scores) -> anyhow::Result<()> {
    let Score { found, findable, losses, seen, expected_share, .. } = &scores.tracker;
    output::line(format_args!(
        "found {found} of {findable} visible units; lost {}, merged {}, swapped {}, renewed {}, split {}, false {}",
        losses.lost,
        losses.merged,
        losses.swapped,
        losses.renewed,
        losses.split,
        losses.false_tracks,
    ))?;
    output::line(format_args!(
        "poses off by {:.2} mm, {:.2} degrees, {:.2} mm from the surface (median)",
        seen.translation_m.median * 1e3,
        seen.rotation_deg.median,
        seen.surface_m.median * 1e3,
    ))?;
    if let Some(share) = expected_share {
        output::line(format_args!(
            "{:.1} % of the positions within what covariances say of 95 %",
            share * 1e2
        ))?;
    }
    let header = [
        "ahead s",
        "position m",
        "told all",
        "told poses",
        "orientation deg",
        "told all",
        "told poses",
    ];
    let mut table = output::table(header);
    for row in rows(scores) {
        let [a, b, c] = row.translation_m.map(|rms| format!("{rms:.4}"));
        let [d, e, f] = row.rotation_deg.map(|rms| format!("{rms:.2}"));
        output::row(&mut table, [format!("{:.1}", row.ahead_s), a, b, c, d, e, f]);
    }
    output::table_lines(&table)?;
    output::line(
        "errors of predictions, RMS; beside the same model that is told true poses, points and what units are made of, and true poses and points alone",
    )
}

fn print_segments(score: &SegmentsScore, images: usize) -> anyhow::Result<()> {
    let [half, most] = score.found_shares();
    output::line(format_args!(
        "segments of {images} images: overlap P {:.3} R {:.3} F {:.3}; boundary P {:.3} R {:.3} F {:.3}; {:.3} of {} bodies at IoU .5, {:.3} at .75",
        score.overlap.precision,
        score.overlap.recall,
        score.overlap.f,
        score.boundary.precision,
        score.boundary.recall,
        score.boundary.f,
        half,
        score.objects,
        most,
    ))
}

/// Means over the images, and how many those are.
fn segments_document(score: &SegmentsScore, images: usize) -> Value {
    let [half, most] = score.found_shares();
    json!({ "images": images, "found_share_50": half, "found_share_75": most, "mean": score })
}

/// Errors of predictions so far ahead: the tracker's, of the model that is told all, and that is told poses and points.
struct Row {
    ahead_s: f64,
    count: usize,
    translation_m: [f64; 3],
    rotation_deg: [f64; 3],
}

fn rows(scores: &Scores) -> Vec<Row> {
    let told = |score: &Score, ahead_s: f64| {
        let same = score.predictions.iter().find(|row| (row.ahead_s - ahead_s).abs() < 1e-6);
        same.map_or((0.0, 0.0), |row| (row.errors.translation_m.rms, row.errors.rotation_deg.rms))
    };
    let of = scores.tracker.predictions.iter().map(|row| {
        let own = (row.errors.translation_m.rms, row.errors.rotation_deg.rms);
        let all = [own, told(&scores.told, row.ahead_s), told(&scores.told_poses, row.ahead_s)];
        Row {
            ahead_s: row.ahead_s,
            count: row.errors.translation_m.count,
            translation_m: all.map(|(translation, _)| translation),
            rotation_deg: all.map(|(_, rotation)| rotation),
        }
    });
    of.collect()
}

fn document(
    source: &Source,
    followed: &Followed,
    gravity: &Gravity,
    scores: Option<&Scores>,
    notes: &[String],
) -> Value {
    let units = followed.units().into_iter().map(|(id, first_s, last_s, seen)| {
        let rest = followed.last_of(id).map(|unit| rest_word(unit.rest));
        let object = followed.objects.get(&id);
        json!({
            "id": id, "first_s": first_s, "last_s": last_s, "seen": seen, "rest": rest, "object": object,
        })
    });
    let planes = followed.planes.iter().map(|plane| {
        let n = plane.normal;
        json!({ "normal": [n.x, n.y, n.z], "offset_m": plane.offset_m })
    });
    let scores = scores.map(|scores| {
        let predictions = rows(scores).into_iter().map(|row| {
            json!({
                "ahead_s": row.ahead_s,
                "count": row.count,
                "position_m": row.translation_m[0],
                "position_told_all_m": row.translation_m[1],
                "position_told_poses_m": row.translation_m[2],
                "orientation_deg": row.rotation_deg[0],
                "orientation_told_all_deg": row.rotation_deg[1],
                "orientation_told_poses_deg": row.rotation_deg[2],
            })
        });
        json!({ "tracker": scores.tracker, "predictions": predictions.collect::<Vec<_>>() })
    });
    json!({
        "input": source.name(),
        "captures": followed.estimates.len(),
        "ms_a_capture": followed.milliseconds(),
        "ms_at_most": followed.slowest.as_secs_f64() * 1e3,
        "planes": planes.collect::<Vec<_>>(),
        "units": units.collect::<Vec<_>>(),
        "clusters_left_out": followed.clusters_left_out,
        "blind_captures": followed.blind,
        "captures_without_forecast": followed.without_forecast,
        "left_out_of_predictions": followed.left_out,
        "captures_unreadable": source.unreadable,
        "facts": facts::document(&followed.facts, &followed.planes, gravity),
        "notes": notes,
        "scores": scores,
    })
}
