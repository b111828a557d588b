//! `rigidformer track`

mod files;
mod followed;
mod objects;
mod source;
mod truth;
mod viewed;

use nalgebra::Vector3;
use rigidformer_evaluation::score::Score;
use rigidformer_perception::tracker::{Segmentation, Tracker, TrackerOptions};
use serde_json::{Value, json};

use crate::arguments::Track;
use crate::usage::Usage;
use crate::viewers::Viewers;
use crate::{defaults, interrupt, output};
use followed::Followed;
use source::{Said, Source};
use truth::{Scores, Truth};

pub(crate) fn run(arguments: &Track) -> anyhow::Result<()> {
    interrupt::watch();
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
    let mut options = TrackerOptions::default();
    options.model = match arguments.no_model {
        true => None,
        false => Some(defaults::model(&arguments.model)?.for_host()?),
    };
    options.segmentation = match arguments.mask {
        Some(_) => Segmentation::Given,
        None => arguments.segmentation.into(),
    };
    options.gravity_m_s2 = gravity(arguments, &source)?;
    let [friction, restitution] = arguments.physics[..] else {
        return Err(Usage("--physics needs two numbers, such as 0.5,0.4".into()).into());
    };
    options.plane_physics = [friction, restitution];
    options.unit_physics = [friction, restitution];
    options.objects = objects::read(arguments, options.density_kg_m3)?;
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
        bar.inc(1);
    }
    bar.finish_and_clear();
    for Said { text, count } in source.said() {
        match count {
            1 => output::note(&text),
            count => output::note(&format!("{text} ({count} times)")),
        }
    }
    if followed.estimates.is_empty() {
        anyhow::bail!("{}: no capture is in it; record some", arguments.input.display());
    }
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
    if arguments.json {
        return output::json(&document(arguments, &followed, &source.said(), scores.as_ref()));
    }
    print(arguments, &followed, scores.as_ref())
}

/// Where results go, if anywhere.
fn folder(arguments: &Track) -> Option<std::path::PathBuf> {
    arguments.out.clone().or_else(|| (!arguments.json).then(|| "track".into()))
}

fn gravity(arguments: &Track, source: &Source) -> anyhow::Result<Vector3<f32>> {
    match arguments.gravity[..] {
        [x, y, z] => Ok(Vector3::new(x, y, z)),
        [] => Ok(source.gravity_m_s2().unwrap_or(Vector3::new(0.0, 0.0, -9.81))),
        _ => Err(Usage("--gravity needs three numbers, such as 0,0,-9.81".into()).into()),
    }
}

fn print(arguments: &Track, followed: &Followed, scores: Option<&Scores>) -> anyhow::Result<()> {
    output::line(format_args!(
        "{}: {} captures, {} planes; {:.1} ms a capture, at most {:.1}",
        arguments.input.display(),
        followed.estimates.len(),
        followed.planes.len(),
        followed.milliseconds(),
        followed.slowest.as_secs_f64() * 1e3,
    ))?;
    let mut table = output::table(["unit", "from s", "to s", "seen", "points", "object"]);
    for (id, first, last, seen) in followed.units() {
        let points = followed.estimates.iter().rev().find_map(|estimate| {
            estimate.units.iter().find(|unit| unit.id == id).map(|unit| unit.points.len())
        });
        let cells = [format!("{first:.3}"), format!("{last:.3}"), seen.to_string()];
        let points = points.unwrap_or(0).to_string();
        let object = followed.objects.get(&id).cloned().unwrap_or_default();
        output::row(&mut table, [id.to_string()].into_iter().chain(cells).chain([points, object]));
    }
    output::table_lines(&table)?;
    if let Some(scores) = scores {
        print_scores(scores)?;
    }
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
            output::note(&format!("{count} {what}"));
        }
    }
    Ok(())
}

fn print_scores(scores: &Scores) -> anyhow::Result<()> {
    let Score { found, findable, losses, seen, .. } = &scores.tracker;
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
    arguments: &Track,
    followed: &Followed,
    said: &[Said],
    scores: Option<&Scores>,
) -> Value {
    let said = said.iter().map(|said| json!({ "text": said.text, "count": said.count }));
    let units = followed.units().into_iter().map(|(id, first_s, last_s, seen)| {
        let object = followed.objects.get(&id);
        json!({ "id": id, "first_s": first_s, "last_s": last_s, "seen": seen, "object": object })
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
        "input": arguments.input.display().to_string(),
        "captures": followed.estimates.len(),
        "ms_a_capture": followed.milliseconds(),
        "ms_at_most": followed.slowest.as_secs_f64() * 1e3,
        "planes": planes.collect::<Vec<_>>(),
        "units": units.collect::<Vec<_>>(),
        "clusters_left_out": followed.clusters_left_out,
        "blind_captures": followed.blind,
        "captures_without_forecast": followed.without_forecast,
        "left_out_of_predictions": followed.left_out,
        "notes": said.collect::<Vec<_>>(),
        "scores": scores,
    })
}
