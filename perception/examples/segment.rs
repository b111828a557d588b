//! Segments a recording of depth images, and writes it again with the number of each pixel's body as its label.
//!
//! ```sh
//! cargo run --release -p rigidformer-perception --features captures --example segment -- seen labelled
//! ```

use std::error::Error;
use std::path::Path;
use std::time::Instant;

use rigidformer_perception::capture::{DepthView, View};
use rigidformer_perception::recording::{self, Recorder};
use rigidformer_perception::tracker::{Tracker, TrackerOptions};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [input, output] = arguments.as_slice() else {
        return Err("usage: segment RECORDING OUT".into());
    };
    let mut tracker = Tracker::new(TrackerOptions::default())?;
    let mut recorder = Recorder::new(Path::new(output), None)?;
    let mut cameras: Vec<usize> = Vec::new();
    for capture in recording::open(Path::new(input))? {
        let capture = capture?;
        let start = Instant::now();
        tracker.observe(&capture)?;
        let took_ms = start.elapsed().as_secs_f64() * 1e3;
        for (number, view) in capture.views.iter().enumerate() {
            let View::Depth(view) = view else { continue };
            if cameras.len() <= number {
                cameras.push(recorder.camera(
                    &format!("camera{number}"),
                    &view.camera,
                    view.scale_m,
                )?);
            }
            let view = DepthView { labels: Some(tracker.segments(number)), ..view.clone() };
            recorder.add(capture.time_s, cameras[number], &view)?;
        }
        println!(
            "{:.3} s: {} planes, {} units, {took_ms:.1} ms",
            capture.time_s,
            tracker.planes().len(),
            tracker.estimate().units.len()
        );
    }
    recorder.finish()?;
    Ok(())
}
