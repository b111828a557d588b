//! `drift.png`: how far a quantised model's rollouts leave the float model's.

use rigidformer_firmware_sim::{Drift, Report, Spread, StepFigures};

use super::page::Rgb;
use super::plot::{Curve, FREE_FALL, Key, MODEL, OBSERVED, Panel, side_by_side};

/// Step codes in turn.
const COLOURS: [Rgb; 4] = [MODEL, FREE_FALL, [0.16, 0.58, 0.35], [0.58, 0.29, 0.68]];
const MEDIAN: f32 = 3.5;
const P95: f32 = 1.5;

/// Draws median and 95 % of position and orientation drift, a colour a step code; a PNG file.
pub(crate) fn drift(report: &Report, title: &str) -> anyhow::Result<Vec<u8>> {
    let of_step = || report.steps.iter().zip(COLOURS.into_iter().cycle());
    let names: Vec<(String, Rgb, f32)> = of_step()
        .flat_map(|(figures, colour)| {
            let name = |what| format!("step {} {what}", figures.step);
            [(name("median"), colour, MEDIAN), (name("95 %"), colour, P95)]
        })
        .collect();
    let keys =
        names.iter().map(|(name, colour, width)| Key { colour: *colour, line: Some(*width), name });
    let keys: Vec<Key<'_>> =
        keys.chain([Key { colour: OBSERVED, line: None, name: "observed" }]).collect();
    let seconds = |frame: u32| f64::from(frame) / f64::from(report.frame_rate_hz);
    let panel = |title, of: fn(&StepFigures) -> Vec<(u32, Spread)>| {
        let curve = |figures: &StepFigures, part: fn(&Spread) -> f64, colour, width| {
            let points = of(figures);
            let points = points.iter().map(|(frame, spread)| (seconds(*frame), part(spread)));
            Curve { points: points.collect(), colour, width }
        };
        let curves = of_step().flat_map(|(figures, colour)| {
            let median = curve(figures, |spread| spread.median, colour, MEDIAN);
            [curve(figures, |spread| spread.p95, colour, P95), median]
        });
        let frames =
            report.steps.iter().flat_map(|figures| &figures.drift).map(|drift| drift.frame);
        let first_step = report.steps.iter().map(|figures| figures.step).min();
        Panel {
            title,
            end_s: seconds(frames.max().unwrap_or(1)),
            observed_s: seconds(first_step.unwrap_or(0)),
            curves: curves.collect(),
        }
    };
    let position =
        panel("position drift, m (over units)", |figures| poses(figures, |drift| drift.position_m));
    if report.steps.iter().any(|figures| !figures.point_drift.is_empty()) {
        // What bends has no orientation.
        let soft = panel("drift of soft points, m (over points)", |figures| {
            let points = figures.point_drift.iter();
            points.map(|drift| (drift.frame, drift.distance_m)).collect()
        });
        let rigid = Panel { title: "position drift of rigid units, m (over units)", ..position };
        return side_by_side(title, &keys, [&soft, &rigid]);
    }
    let orientation = panel("orientation drift, degrees (over units)", |figures| {
        poses(figures, |drift| drift.orientation_deg)
    });
    side_by_side(title, &keys, [&position, &orientation])
}

/// A spread of poses by frame.
fn poses(figures: &StepFigures, of: fn(&Drift) -> Spread) -> Vec<(u32, Spread)> {
    figures.drift.iter().map(|drift| (drift.frame, of(drift))).collect()
}
