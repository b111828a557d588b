//! A split's mean errors against time, every step code's beside the published ones.

use rigidformer_evaluation::figures::{FRAMES, Figures};
use rigidformer_evaluation::metrics::FrameErrors;
use rigidformer_evaluation::paper::{self, Published};

use super::page::Rgb;
use super::plot::{Curve, FREE_FALL, Key, MODEL, Panel, side_by_side};

/// Step codes in turn.
const COLOURS: [Rgb; 4] = [MODEL, [0.16, 0.58, 0.35], [0.58, 0.29, 0.68], [0.75, 0.15, 0.25]];
const HOP_NET: Rgb = [0.45, 0.45, 0.47];
const OURS: f32 = 3.5;
const THEIRS: f32 = 1.5;

/// What of a predictor's errors a panel shows.
type Of = (fn(&FrameErrors) -> f64, fn(&(f64, f64)) -> f64);

/// Draws both errors of each step code (thick), of the paper and HopNet (thin), and of free fall; a PNG file.
pub(crate) fn evaluation(
    title: &str,
    dataset: &str,
    by_step: &[(u32, Figures)],
    free_fall: &Figures,
    frame_rate_hz: f64,
) -> anyhow::Result<Vec<u8>> {
    let seconds = |frame: u32| f64::from(frame) / frame_rate_hz;
    let steps = || by_step.iter().zip(COLOURS.into_iter().cycle());
    let ours = |figures: &Figures, (of, _): Of, colour| {
        let points = figures.curve.iter().map(|(frame, errors)| (seconds(*frame), of(errors)));
        Curve { points: points.collect(), colour, width: OURS }
    };
    let theirs = |row: &Published, (_, of): Of, colour| {
        let points = FRAMES.iter().zip(&row.errors).map(|(f, errors)| (seconds(*f), of(errors)));
        Curve { points: points.collect(), colour, width: THEIRS }
    };
    let published: Vec<(String, &Published, Rgb)> = steps()
        .filter_map(|((step, _), colour)| {
            Some((format!("paper {step}"), paper::rigidformer(dataset, *step)?, colour))
        })
        .chain(paper::hop_net(dataset).map(|row| ("HopNet".to_owned(), row, HOP_NET)))
        .collect();
    let names: Vec<(String, Rgb)> =
        steps().map(|((step, _), colour)| (format!("step {step}"), colour)).collect();
    let key = |name, colour, width| Key { colour, line: Some(width), name };
    let keys = names.iter().map(|(name, colour)| key(name, *colour, OURS));
    let keys = keys.chain(published.iter().map(|(name, _, colour)| key(name, *colour, THEIRS)));
    let keys: Vec<Key<'_>> = keys.chain([key("free fall", FREE_FALL, OURS)]).collect();
    let panel = |title, of: Of| {
        let mut curves = vec![ours(free_fall, of, FREE_FALL)];
        curves.extend(published.iter().map(|(_, row, colour)| theirs(row, of, *colour)));
        curves.extend(steps().map(|((_, figures), colour)| ours(figures, of, colour)));
        Panel { title, end_s: seconds(FRAMES[2]), observed_s: 0.0, curves }
    };
    let position = panel("position error, m", (|e| e.position_m, |row| row.0));
    let orientation = panel("orientation error, degrees", (|e| e.orientation_rms_deg, |row| row.1));
    side_by_side(title, &keys, [&position, &orientation])
}
