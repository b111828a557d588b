//! `rigidformer check`

use rigidformer_evaluation::figures;
use rigidformer_evaluation::scenes::{Dataset, Split};
use rigidformer_firmware_sim::{
    CheckError, Options, Report, StepFigures, Tolerances, Violation, check,
};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

use crate::arguments::Check;
use crate::loading::load_scenes;
use crate::{interrupt, output, picture};

/// Frames that the drift table shows.
const DRIFT_FRAMES: [u32; 2] = [50, 100];

pub(crate) fn run(arguments: &Check) -> anyhow::Result<()> {
    let cancelled = interrupt::watch();
    let float = LoadedModel::open(&arguments.float)?;
    let quantised = LoadedModel::open(&arguments.quantised)?;
    let tolerances = match &arguments.tolerances {
        Some(path) => Tolerances::open(path)?,
        None => Tolerances::of(quantised.model()),
    };
    let split = Split::from(arguments.split);
    let dataset = Dataset::open(&arguments.dataset)?;
    let scenes = load_scenes(&dataset, split, arguments.limit, Some(figures::TO_LAST_FRAME))?;

    let options = Options { steps: arguments.steps.clone(), ..Options::default() };
    let bar = output::progress(options.calls(scenes.len()), dataset.name());
    let stepped = || bar.inc(1);
    let progress = Progress { cancelled, stepped: &stepped };
    let report = check(&float, &quantised, &scenes, &options, progress);
    let report = report.map_err(|error| match error {
        // By its type the program knows that Ctrl-C was pressed.
        CheckError::Rollout(error) => anyhow::Error::new(error),
        other => other.into(),
    })?;
    bar.finish_and_clear();
    interrupt::check()?;

    let violations = report.verdict(&tolerances);
    let title = format!("{}, split {split}, {} scenes", dataset.name(), report.scenes);
    if arguments.json {
        let document = report.document(&tolerances, dataset.name(), split)?;
        output::json(&document)?;
    } else {
        print(&report, &title)?;
    }
    if let Some(folder) = &arguments.out {
        let picture = picture::drift(&report, &title)?;
        output::folder(folder)?;
        let path = folder.join("drift.png");
        output::write_whole(&path, &picture)?;
        if !arguments.json {
            output::line(format_args!("wrote {}", path.display()))?;
        }
    }
    if let Some(step) = tolerances.drift_step.filter(|step| !arguments.steps.contains(step)) {
        output::note(&format!("the limits on drift are for step {step}, which was not measured"));
    }
    verdict(arguments, &violations)
}

fn verdict(arguments: &Check, violations: &[Violation]) -> anyhow::Result<()> {
    if violations.is_empty() {
        return if arguments.json { Ok(()) } else { output::line("within the tolerances") };
    }
    let lines: Vec<String> = violations.iter().map(|violation| format!("  {violation}")).collect();
    let (path, count) = (arguments.quantised.display(), violations.len());
    anyhow::bail!("{path}: outside {count} of the tolerances\n{}", lines.join("\n"))
}

fn print(report: &Report, title: &str) -> anyhow::Result<()> {
    output::line(title)?;
    for (what, model) in [("float", &report.float), ("quantised", &report.quantised)] {
        let (path, weights, bytes) = (&model.path, &model.weights, model.bytes);
        output::line(format_args!("{what}: {path}: {weights}, {bytes} bytes"))?;
    }
    if has_soft(report) {
        points(report)?;
    }
    if has_rigid(report) {
        metrics(report)?;
        drift(report)?;
    }
    one_step(report)?;
    output::line("\nsignal to quantisation noise in single steps, earlier layers' included")?;
    let mut table = output::table(["layer", "dB"]);
    for layer in &report.layers {
        let noise = layer.sqnr_db.map_or("exact".into(), |db| format!("{db:.1}"));
        output::row(&mut table, [layer.layer.clone(), noise]);
    }
    output::table_lines(&table)
}

fn has_soft(report: &Report) -> bool {
    report.steps.iter().any(|figures| !figures.point_drift.is_empty())
}

/// Whether there are poses to compare: of scenes with soft units alone all figures of poses are 0.
fn has_rigid(report: &Report) -> bool {
    let moved = |figures: &StepFigures| figures.metrics.iter().any(|m| m.position_m.float > 0.0);
    !has_soft(report) || report.steps.iter().any(moved)
}

/// Errors of soft points, and how far the models' points are apart.
fn points(report: &Report) -> anyhow::Result<()> {
    output::line(
        "\nsoft points: mean distance from the record and its change; distance between the models",
    )?;
    let head =
        ["step, frame", "float m", "quantised", "change", "median mm", "95 %", "max", "apart"];
    let mut table = output::table(head);
    for figures in &report.steps {
        for metric in &figures.point_metrics {
            let Some(drift) = figures.point_drift_at(metric.frame) else { continue };
            let millimetres = |metres: f64| format!("{:.2}", metres * 1e3);
            output::row(
                &mut table,
                [
                    format!("{}, {}", figures.step, metric.frame),
                    format!("{:.4}", metric.vertex_m.float),
                    format!("{:.4}", metric.vertex_m.quantised),
                    percent(metric.vertex_m.change),
                    millimetres(drift.distance_m.median),
                    millimetres(drift.distance_m.p95),
                    millimetres(drift.distance_m.max),
                    format!("{} of {}", drift.apart, drift.points),
                ],
            );
        }
    }
    output::table_lines(&table)
}

fn metrics(report: &Report) -> anyhow::Result<()> {
    output::line(
        "\nerrors against the record (RMS over units, mean over scenes) and their change",
    )?;
    let head =
        ["step, frame", "float m", "quantised", "change", "float deg", "quantised", "change"];
    let mut table = output::table(head);
    for figures in &report.steps {
        for metric in &figures.metrics {
            let (position, orientation) = (&metric.position_m, &metric.orientation_rms_deg);
            output::row(
                &mut table,
                [
                    format!("{}, {}", figures.step, metric.frame),
                    format!("{:.4}", position.float),
                    format!("{:.4}", position.quantised),
                    percent(position.change),
                    format!("{:.3}", orientation.float),
                    format!("{:.3}", orientation.quantised),
                    percent(orientation.change),
                ],
            );
        }
    }
    output::table_lines(&table)
}

fn drift(report: &Report) -> anyhow::Result<()> {
    output::line(
        "\ndrift between the models over all units, and median of those that are apart at all; change of lengths",
    )?;
    let head = [
        "step, frame",
        "median mm",
        "95 %",
        "max",
        "median deg",
        "95 %",
        "max",
        "apart",
        "median mm",
        "deg",
        "float",
        "quantised",
    ];
    let mut table = output::table(head);
    for figures in &report.steps {
        for drift in DRIFT_FRAMES.into_iter().filter_map(|frame| figures.drift_at(frame)) {
            let (position, orientation) = (&drift.position_m, &drift.orientation_deg);
            let millimetres = |metres: f64| format!("{:.2}", metres * 1e3);
            let degrees = |degrees: f64| format!("{degrees:.3}");
            output::row(
                &mut table,
                [
                    format!("{}, {}", figures.step, drift.frame),
                    millimetres(position.median),
                    millimetres(position.p95),
                    millimetres(position.max),
                    degrees(orientation.median),
                    degrees(orientation.p95),
                    degrees(orientation.max),
                    format!("{} of {}", drift.apart, drift.units),
                    millimetres(drift.apart_median_m),
                    degrees(drift.apart_median_deg),
                    format!("{:.0e}", figures.float_rigidity),
                    format!("{:.0e}", figures.quantised_rigidity),
                ],
            );
        }
    }
    output::table_lines(&table)
}

fn one_step(report: &Report) -> anyhow::Result<()> {
    output::line(
        "\nanchors after one step from recorded states, RMS over units that the network moved",
    )?;
    let head =
        ["step", "units", "moved", "difference mm", "largest", "float error mm", "ratio", "median"];
    let mut table = output::table(head);
    for figures in &report.steps {
        let one = &figures.one_step;
        output::row(
            &mut table,
            [
                figures.step.to_string(),
                one.units.to_string(),
                one.active_units.to_string(),
                format!("{:.4}", one.difference_m * 1e3),
                format!("{:.3}", one.largest_difference_m * 1e3),
                format!("{:.3}", one.float_error_m * 1e3),
                format!("{:.2} %", one.ratio * 100.0),
                format!("{:.2} %", one.median_ratio * 100.0),
            ],
        );
    }
    output::table_lines(&table)?;
    let bonds =
        report.steps.iter().filter_map(|figures| Some((figures.step, figures.one_step.bonds?)));
    for (step, bonds) in bonds {
        output::line(format!(
            "bonds, step {step}: {} of {} that held ({:.2} %) are broken by one model alone; the {} units they held are not in the table",
            bonds.apart,
            bonds.held,
            bonds.share * 100.0,
            bonds.units
        ))?;
    }
    Ok(())
}

fn percent(change: f64) -> String {
    format!("{:+.2} %", change * 100.0)
}
