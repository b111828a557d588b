//! Quantities over time, two panels a picture; `errors.png`: the model's errors beside free fall's.

use super::page::{Align, FAINT, Font, INK, Page, RULE, Rgb};
use crate::comparison::{Comparison, ErrorsAt, PointErrors, PointErrorsAt};

pub(super) const MODEL: Rgb = [0.07, 0.42, 0.75];
pub(super) const FREE_FALL: Rgb = [0.90, 0.45, 0.10];
/// Between the two observed frames.
pub(super) const OBSERVED: Rgb = [0.94, 0.945, 0.955];
const WIDTH: u32 = 1640;
const HEIGHT: u32 = 640;
const PANEL_WIDTH: f32 = 700.0;

/// A quantity over time.
pub(super) struct Panel {
    pub(super) title: &'static str,
    pub(super) end_s: f64,
    /// Until when both frames are observed.
    pub(super) observed_s: f64,
    /// The last is on top.
    pub(super) curves: Vec<Curve>,
}

/// A line through (seconds, value) points.
pub(super) struct Curve {
    pub(super) points: Vec<(f64, f64)>,
    pub(super) colour: Rgb,
    pub(super) width: f32,
}

/// An entry of the legend: what is drawn like this, and its name.
pub(super) struct Key<'n> {
    pub(super) colour: Rgb,
    /// None for an area.
    pub(super) line: Option<f32>,
    pub(super) name: &'n str,
}

/// Draws both errors of a rollout at its predicted frames, those of points where units are soft; a PNG file.
pub(crate) fn errors(comparison: &Comparison<'_>) -> anyhow::Result<Vec<u8>> {
    if comparison.is_soft() {
        return point_errors(comparison);
    }
    let rows: Vec<ErrorsAt> =
        comparison.predicted.poses.iter().filter_map(|(frame, _)| comparison.row(frame)).collect();
    let panel = |title, model: fn(&ErrorsAt) -> f64, free_fall: fn(&ErrorsAt) -> f64| {
        let of = |of: fn(&ErrorsAt) -> f64| rows.iter().map(move |row| (row.frame, of(row)));
        two_curves(comparison, title, of(model), of(free_fall))
    };
    let position = panel(
        "position error, m (RMS over units)",
        |row| row.model.position_m,
        |row| row.free_fall.position_m,
    );
    let orientation = panel(
        "orientation error, degrees (RMS over units)",
        |row| row.model.orientation_rms_deg,
        |row| row.free_fall.orientation_rms_deg,
    );
    beside(comparison, "free fall", [&position, &orientation])
}

fn point_errors(comparison: &Comparison<'_>) -> anyhow::Result<Vec<u8>> {
    let frames = comparison.predicted.poses.iter().map(|(frame, _)| frame);
    let rows: Vec<PointErrorsAt> =
        frames.filter_map(|frame| comparison.points_row(frame)).collect();
    let panel = |title, of: fn(&PointErrors) -> f64| {
        let model = rows.iter().map(|row| (row.frame, of(&row.model)));
        let rigid = rows.iter().map(|row| (row.frame, of(&row.rigid)));
        two_curves(comparison, title, model, rigid)
    };
    let mean = panel("points from where they were recorded, m (mean)", |errors| errors.mean_m);
    let most = panel("the farthest point, m", |errors| errors.most_m);
    beside(comparison, "best rigid motion (told the truth)", [&mean, &most])
}

/// A panel of the model's quantity above a baseline's, both by frame.
fn two_curves(
    comparison: &Comparison<'_>,
    title: &'static str,
    model: impl Iterator<Item = (u32, f64)>,
    baseline: impl Iterator<Item = (u32, f64)>,
) -> Panel {
    let time_s = |(frame, value): (u32, f64)| (comparison.time_s(frame), value);
    let model = Curve { points: model.map(time_s).collect(), colour: MODEL, width: 3.0 };
    let baseline = Curve { points: baseline.map(time_s).collect(), colour: FREE_FALL, width: 3.0 };
    Panel {
        title,
        end_s: comparison.time_s(comparison.predicted.poses.last_frame()),
        observed_s: comparison.time_s(comparison.predicted.poses.step()),
        curves: vec![baseline, model],
    }
}

fn beside(
    comparison: &Comparison<'_>,
    baseline: &str,
    panels: [&Panel; 2],
) -> anyhow::Result<Vec<u8>> {
    let title = format!("{}, step {}", comparison.scene.name(), comparison.predicted.poses.step());
    let keys = [
        Key { colour: MODEL, line: Some(4.0), name: &comparison.model_name },
        Key { colour: FREE_FALL, line: Some(4.0), name: baseline },
        Key { colour: OBSERVED, line: None, name: "observed" },
    ];
    side_by_side(&title, &keys, panels)
}

/// Two panels under a title and a legend; a PNG file.
pub(super) fn side_by_side(
    title: &str,
    keys: &[Key<'_>],
    [left, right]: [&Panel; 2],
) -> anyhow::Result<Vec<u8>> {
    let mut page = Page::new(WIDTH, HEIGHT)?;
    page.text(title, (90.0, 24.0), Align::Left, Font::TITLE);
    let mut x = 90.0;
    for Key { colour, line, name } in keys {
        let font = Font::PLAIN.coloured(if line.is_none() { FAINT } else { *colour });
        match line {
            Some(width) => page.line([(x, 74.0), (x + 34.0, 74.0)], *width, *colour),
            None => page.fill([x, 62.0, 34.0, 24.0], *colour),
        }
        page.text(name, (x + 48.0, 64.0), Align::Left, font);
        x += 48.0 + font.width(name) + 44.0;
    }
    draw(&mut page, 90.0, left);
    draw(&mut page, 90.0 + PANEL_WIDTH + 110.0, right);
    page.png()
}

fn draw(page: &mut Page, left: f32, panel: &Panel) {
    let (top, bottom, right) = (150.0, HEIGHT as f32 - 80.0, left + PANEL_WIDTH);
    let values = panel.curves.iter().flat_map(|curve| curve.points.iter().map(|(_, value)| *value));
    let highest = values.filter(|value| value.is_finite()).fold(1e-6, f64::max);
    let step = tick_step(highest);
    let ceiling = (highest * 1.04 / step).ceil() * step;
    let x_of = |time: f64| left + (time / panel.end_s) as f32 * (right - left);
    let y_of = |value: f64| bottom - (value / ceiling).min(1.0) as f32 * (bottom - top);

    page.text(panel.title, (left, top - 44.0), Align::Left, Font::PLAIN);
    let observed = [
        (left, top),
        (x_of(panel.observed_s), top),
        (x_of(panel.observed_s), bottom),
        (left, bottom),
    ];
    page.area(observed, OBSERVED, 1.0);
    for tick in 0..=(ceiling / step).round() as u32 {
        let value = f64::from(tick) * step;
        page.line([(left, y_of(value)), (right, y_of(value))], 1.0, RULE);
        page.text(
            &number(value, step),
            (left - 12.0, y_of(value) - 9.0),
            Align::Right,
            Font::SMALL,
        );
    }
    let time_step = tick_step(panel.end_s);
    for tick in 0..=(panel.end_s / time_step + 1e-9).floor() as u32 {
        let time = f64::from(tick) * time_step;
        page.line([(x_of(time), bottom), (x_of(time), bottom + 7.0)], 1.5, FAINT);
        page.text(
            &number(time, time_step),
            (x_of(time), bottom + 12.0),
            Align::Centre,
            Font::SMALL,
        );
    }
    page.line([(left, bottom), (right, bottom)], 1.5, INK);
    page.text("time, s", ((left + right) / 2.0, bottom + 40.0), Align::Centre, Font::SMALL);

    for Curve { points, colour, width } in &panel.curves {
        let points: Vec<(f32, f32)> =
            points.iter().map(|(time, value)| (x_of(*time), y_of(*value))).collect();
        page.line(points.iter().copied(), *width, *colour);
        if points.len() <= 40 {
            for point in points {
                page.dot(point, 1.5 * width, *colour);
            }
        }
    }
}

/// A round distance between about five ticks up to `highest`.
fn tick_step(highest: f64) -> f64 {
    let rough = (highest / 5.0).max(1e-12);
    let magnitude = 10f64.powf(rough.log10().floor());
    let steps = [1.0, 2.0, 2.5, 5.0, 10.0].map(|round| round * magnitude);
    steps.into_iter().find(|step| *step >= rough * 0.999).unwrap_or(10.0 * magnitude)
}

/// A tick's label with as many decimals as its distance to the next needs.
fn number(value: f64, step: f64) -> String {
    let decimals = (0..8).find(|decimals| {
        let scaled = step * 10f64.powi(*decimals);
        (scaled - scaled.round()).abs() < 1e-6 * scaled.max(1.0)
    });
    format!("{value:.*}", decimals.unwrap_or(8) as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round() {
        assert!((tick_step(0.5) - 0.1).abs() < 1e-12);
        assert!((tick_step(37.0) - 10.0).abs() < 1e-12);
        assert_eq!(number(0.25, 0.05), "0.25");
        assert_eq!(number(20.0, 10.0), "20");
        assert_eq!(number(0.075, 0.025), "0.075");
    }
}
