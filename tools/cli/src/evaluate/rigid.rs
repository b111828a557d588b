//! Rigid units: the errors of HopNet's protocol, beside the published ones.

use rigidformer_evaluation::figures::{self, Figures, SplitFigures};
use rigidformer_evaluation::metrics::Penetration;
use rigidformer_evaluation::paper::{self, Published};
use rigidformer_evaluation::scenes::{Dataset, RecordedScene, Split};
use rigidformer_runtime::progress::Progress;
use serde_json::Value;

use super::joining::cell;
use super::metric::{Headline, Metric, Task};
use crate::arguments::STEPS;
use crate::loading::plain;
use crate::{output, picture};

pub(super) struct Rigid(SplitFigures);

impl Metric for Rigid {
    const STEPS: &'static [u32] = &STEPS;

    fn applies(_: &Dataset) -> bool {
        true
    }

    fn load(
        dataset: &Dataset,
        split: Split,
        limit: Option<u32>,
        progress: Progress<'_>,
    ) -> anyhow::Result<Vec<RecordedScene>> {
        figures::scenes_to_evaluate(dataset, split, limit, progress).map_err(plain)
    }

    fn check(_: &Task<'_>) -> anyhow::Result<()> {
        Ok(())
    }

    fn calls(task: &Task<'_>) -> u64 {
        figures::calls(task.steps, task.scenes.len())
    }

    fn measure(task: &Task<'_>, progress: Progress<'_>) -> anyhow::Result<Rigid> {
        let how = (task.steps, task.arguments.join);
        let (dataset, split) = (task.dataset, task.split);
        let found = figures::evaluate(task.loaded, dataset, split, task.scenes, how, progress);
        Ok(Rigid(found.map_err(plain)?))
    }

    fn headlines(&self) -> Vec<Headline> {
        let of_step = |(step, figures): &(u32, Figures)| {
            let [.., last] = figures.errors;
            [
                Headline {
                    step: *step,
                    name: "position at frame 100, m",
                    key: "frame100.position_rmse_m",
                    value: last.position_m,
                },
                Headline {
                    step: *step,
                    name: "orientation at frame 100, degrees",
                    key: "frame100.orientation_rmse_deg",
                    value: last.orientation_rms_deg,
                },
            ]
        };
        self.0.by_step.iter().flat_map(of_step).collect()
    }

    fn print(&self, task: &Task<'_>) -> anyhow::Result<()> {
        print_tables(task.dataset, &self.0)
    }

    fn json(&self, _: &Task<'_>) -> Value {
        self.0.document()
    }

    fn picture(&self, task: &Task<'_>) -> anyhow::Result<Vec<u8>> {
        let (figures, dataset) = (&self.0, task.dataset.name());
        let title = format!(
            "{}, {dataset}, {} scenes of {}: mean over scenes of the RMS over units",
            figures.model,
            figures.names.len(),
            task.split
        );
        let rate = task.scenes.first().map_or(1.0, |scene| f64::from(scene.frame_rate_hz()));
        picture::evaluation(&title, dataset, &figures.by_step, &figures.free_fall, rate)
    }
}

fn print_tables(dataset: &Dataset, results: &SplitFigures) -> anyhow::Result<()> {
    output::line(format_args!(
        "{}, split {}, {} scenes",
        dataset.name(),
        results.split,
        results.names.len()
    ))?;
    output::line(
        "position error m / orientation error degrees (RMS over units, mean over scenes) at frame",
    )?;
    let mut errors = output::table(["predictor", "step", "50", "75", "100"]);
    let ours = |figures: &Figures| {
        figures.errors.map(|e| format!("{:.3} / {:5.2}", e.position_m, e.orientation_rms_deg))
    };
    let theirs = |row: &Published| {
        row.errors.map(|(position, degrees)| format!("{position:.3} / {degrees:5.2}"))
    };
    let mut add = |name: &str, step: Option<u32>, cells: [String; 3]| {
        let head = [name.to_owned(), step.map_or(String::new(), |step| step.to_string())];
        output::row(&mut errors, head.into_iter().chain(cells));
    };
    for (step, figures) in &results.by_step {
        add(&results.model, Some(*step), ours(figures));
        if let Some(row) = paper::rigidformer(dataset.name(), *step) {
            add("paper", row.step, theirs(row));
        }
    }
    if let Some(row) = paper::hop_net(dataset.name()) {
        add("HopNet", None, theirs(row));
    }
    add("free fall", None, ours(&results.free_fall));
    output::table_lines(&errors)?;

    output::line(
        "\nmean orientation error over units, degrees, at frame; deepest penetration until frame 100, m",
    )?;
    output::line("(mean over scenes, worst scene); largest change of a length within a unit")?;
    let has_parts = results.by_step.iter().any(|(_, figures)| figures.apart.is_some());
    if has_parts {
        output::line(
            "parts apart: distance of the images of pivots of all recorded frames, median / 99 %, mm",
        )?;
    }
    let columns = ["predictor", "step", "50", "75", "100", "into ground", "into units", "length"];
    let mut more = output::table(columns.into_iter().chain(has_parts.then_some("parts apart")));
    let depths = |mean: Penetration, max: Penetration| {
        let pair = |mean: f64, max: f64| format!("{mean:.3}, {max:.3}");
        [pair(mean.ground_m, max.ground_m), pair(mean.units_m, max.units_m)]
    };
    let predicted = |name: &str, step: String, figures: &Figures| {
        let means = figures.errors.map(|e| format!("{:.2}", e.orientation_mean_deg));
        let depths = depths(figures.penetration_mean, figures.penetration_max);
        let cells = [name.to_owned(), step].into_iter().chain(means).chain(depths);
        let cells = cells.chain([format!("{:.0e}", figures.rigidity)]);
        cells.chain(has_parts.then(|| cell(figures.apart))).collect::<Vec<_>>()
    };
    for (step, figures) in &results.by_step {
        output::row(&mut more, predicted(&results.model, step.to_string(), figures));
    }
    output::row(&mut more, predicted("free fall", String::new(), &results.free_fall));
    let (mean, max) = results.recorded;
    let blank = std::iter::repeat_n(String::new(), 4);
    output::row(
        &mut more,
        ["recorded".to_owned()].into_iter().chain(blank).chain(depths(mean, max)),
    );
    output::table_lines(&more)?;
    for note in results.notes() {
        output::note(&note);
    }
    Ok(())
}
