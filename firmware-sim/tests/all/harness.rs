//! The harness on a tiny random model: what it measures, what it refuses, and where traces differ.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;

use crate::common::{CONFIG, loaded, packed, quantised, scene};
use rigidformer_evaluation::models::Precision;
use rigidformer_evaluation::rollout::RolloutError;
use rigidformer_firmware_sim::trace::{
    Content, Incomparable, Recording, TraceError, compare, record,
};
use rigidformer_firmware_sim::{CheckError, Options, Tolerances, check};
use rigidformer_runtime::core::weights::{FeatureSet, IMPACT_FEATURES, ModelConfig};
use rigidformer_runtime::core::{Layer, POOL_LEVELS};
use rigidformer_runtime::progress::Progress;

#[test]
fn the_same_model_twice_does_not_differ() {
    let bytes = packed(CONFIG);
    let (a, b) = (loaded(&bytes), loaded(&bytes));
    let options = Options::default();
    let report = check(&a, &b, &[scene(1), scene(2)], &options, Progress::none()).unwrap();
    assert!(report.verdict(&Tolerances::of(b.model())).is_empty());
    assert_eq!((report.scenes, report.steps.len()), (2, 2));
    for figures in &report.steps {
        assert_eq!(figures.drift_at(100).unwrap().position_m.max, 0.0);
        assert_eq!((figures.one_step.ratio, figures.one_step.active_units), (0.0, 0));
        assert!(figures.one_step.units > 0);
    }
    assert!(report.layers.iter().all(|layer| layer.sqnr_db.is_none()));
}

#[test]
fn quantisation_is_measured_and_judged() {
    let bytes = packed(CONFIG);
    let float = loaded(&bytes);
    let scenes = [scene(1), scene(2)];
    let run = |precision| {
        let quantised = quantised(&bytes, precision);
        check(&float, &quantised, &scenes, &Options::default(), Progress::none()).unwrap()
    };
    let (i8, f16) = (run(Precision::I8), run(Precision::F16));
    assert_eq!(i8, run(Precision::I8), "threads change nothing");
    let step = |report: &rigidformer_firmware_sim::Report| report.steps[1].one_step;
    assert!(step(&i8).ratio > step(&f16).ratio && step(&f16).ratio > 0.0);
    assert!(step(&i8).active_units > 0 && step(&i8).ratio >= step(&i8).ratio_all);
    let drift = i8.steps[1].drift_at(100).unwrap().position_m;
    assert!(0.0 < drift.median && drift.median <= drift.p95 && drift.p95 <= drift.max);
    let names: Vec<&str> = i8.layers.iter().map(|layer| layer.layer.as_str()).collect();
    assert_eq!(names[..4], ["features", "point_features", "pooled", "tokens 0"]);
    assert_eq!(names.last(), Some(&"head"));
    assert_eq!(i8.layers[0].sqnr_db, None, "inputs are not quantised");
    let decibels = |report: &rigidformer_firmware_sim::Report| report.layers[2].sqnr_db.unwrap();
    assert!(decibels(&i8) > 20.0 && decibels(&f16) > decibels(&i8) + 10.0);

    // No difference at all is allowed: everything is named.
    let violations = i8.verdict(&Tolerances::EXACT);
    let text: Vec<String> = violations.iter().map(ToString::to_string).collect();
    for part in [
        "step 5, frame 50: relative change of position RMSE",
        "step 10: one-step ratio",
        "median orientation drift",
    ] {
        assert!(text.iter().any(|line| line.contains(part)), "{part}: {text:#?}");
    }
    let noise = Tolerances { layer_sqnr_db: Some(1e3), ..Tolerances::I8 };
    assert!(i8.verdict(&noise).iter().any(|violation| violation.place == "layer head"));
    let json = serde_json::to_value(&i8).unwrap();
    assert!(json["steps"][0]["one_step"]["ratio"].as_f64().unwrap() > 0.0);
}

#[test]
fn models_that_cannot_be_compared_are_refused() {
    let bytes = packed(CONFIG);
    let float = loaded(&bytes);
    let refused = |float, quantised, scenes: &[_], options: &Options| {
        check(float, quantised, scenes, options, Progress::none()).unwrap_err()
    };
    let defaults = Options::default();
    let other = loaded(&packed(ModelConfig { gate: !CONFIG.gate, ..CONFIG }));
    let error = refused(&float, &other, &[scene(1)], &defaults);
    assert!(
        matches!(&error, CheckError::Configuration { field, .. } if field == "gate"),
        "{error}"
    );
    assert!(error.to_string().contains("configuration: gate is"), "{error}");

    let i8 = quantised(&bytes, Precision::I8);
    let error = refused(&i8, &float, &[scene(1)], &defaults);
    assert!(matches!(error, CheckError::NotFloat { .. }), "{error}");
    let error = refused(&float, &i8, &[], &defaults);
    assert!(matches!(error, CheckError::Nothing(_)), "{error}");
    for steps in [vec![], vec![0], vec![26]] {
        let error = refused(&float, &i8, &[scene(1)], &Options { steps, ..Options::default() });
        assert!(matches!(error, CheckError::Nothing(_)), "{error}");
    }
    let short = scene(1).truncated(100);
    let error = refused(&float, &i8, &[short], &defaults);
    assert!(matches!(error, CheckError::Rollout(RolloutError::TooFewFrames { .. })), "{error}");
}

#[test]
fn progress_is_told_as_often_as_announced() {
    let bytes = packed(CONFIG);
    let (float, i8) = (loaded(&bytes), quantised(&bytes, Precision::I8));
    let calls = std::sync::atomic::AtomicU64::new(0);
    let stepped = || {
        calls.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
    };
    let options = Options { steps: vec![3, 10, 25], state_every: 7 };
    let progress = Progress { stepped: &stepped, ..Progress::none() };
    check(&float, &i8, &[scene(1), scene(2)], &options, progress).unwrap();
    assert_eq!(calls.into_inner(), options.calls(2));
}

#[test]
fn tolerance_files_are_whole_or_refused() {
    let parse = |text: &str| Tolerances::parse("t.json".as_ref(), text.as_bytes());
    let text = serde_json::to_string(&Tolerances::F16).unwrap();
    assert_eq!(parse(&text).unwrap(), Tolerances::F16);
    let error = parse(&text.replace("\"rigidity\"", "\"rigidness\"")).unwrap_err().to_string();
    assert!(error.contains("t.json") && error.contains("rigidness"), "{error}");
    let error = parse("{\"rigidity\": null}").unwrap_err().to_string();
    assert!(error.contains("missing field"), "{error}");
}

fn recording(precision: Precision) -> Recording {
    let model = quantised(&packed(CONFIG), precision);
    record(&model, &scene(1), 10, 3, Progress::none()).unwrap()
}

#[test]
fn a_trace_survives_its_file() {
    let recording = recording(Precision::I8);
    let bytes = recording.to_bytes();
    let read = Recording::from_bytes(Path::new("x"), &bytes).unwrap();
    assert_eq!(read, recording);
    assert_eq!(read.to_bytes(), bytes);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.trace");
    recording.write(&path).unwrap();
    assert_eq!(compare(&Recording::open(&path).unwrap(), &recording).unwrap().first, None);

    for cut in [0, 7, 100, bytes.len() - 1] {
        let error = Recording::from_bytes(Path::new("cut"), &bytes[..cut]).unwrap_err();
        assert!(matches!(error, TraceError::NotATrace { .. }), "{error}");
    }
}

#[test]
fn a_single_bit_is_found_and_named() {
    let a = recording(Precision::I8);
    for (content, index, at, unit, row, element) in [
        (Content::Layer(Layer::Features), 2, CONFIG.features.len() * 5 + 7, 2, 5, 7),
        (Content::Layer(Layer::Tokens), 1, CONFIG.width as usize * 2 + 3, 2, 2, 3),
        (Content::Layer(Layer::Advanced), 1, 3 * 2 + 1, 1, 2, 1),
        (Content::Poses, 0, 12 + 11, 1, 1, 11),
    ] {
        let mut b = a.clone();
        let part = b
            .records
            .iter_mut()
            .find(|record| record.step == 2 && record.content == content && record.index == index)
            .unwrap();
        part.values[at] = f32::from_bits(part.values[at].to_bits() ^ 1);
        let comparison = compare(&a, &b).unwrap();
        let first = comparison.first.unwrap();
        assert_eq!((first.step, first.layer), (2, content.name()));
        assert_eq!(
            (first.index, first.unit, first.row, first.element),
            (index, unit, row, element)
        );
        assert_eq!(first.a_bits ^ 1, first.b_bits);
        let text = first.to_string();
        assert!(text.contains(&format!("unit {unit}")) && text.contains("0x"), "{text}");
        let rows = comparison.layers.iter().filter(|layer| layer.different > 0);
        assert_eq!(rows.map(|layer| layer.different).collect::<Vec<_>>(), [1]);
    }
}

#[test]
fn quantised_and_float_first_differ_in_the_point_network() {
    let comparison = compare(&recording(Precision::F32), &recording(Precision::I8)).unwrap();
    let first = comparison.first.unwrap();
    assert_eq!((first.step, first.layer), (1, "point_features"));
    let features = comparison.layers.iter().find(|layer| layer.layer == "features").unwrap();
    assert_ne!(features.first_step, Some(1), "the observation is the same");
}

#[test]
fn traces_of_different_runs_are_refused() {
    let model = quantised(&packed(CONFIG), Precision::F32);
    let of =
        |seed, step, steps| record(&model, &scene(seed), step, steps, Progress::none()).unwrap();
    let a = of(1, 10, 2);
    for (b, what) in [(of(2, 10, 2), "scene"), (of(1, 5, 2), "step"), (of(1, 10, 3), "steps")] {
        let error = compare(&a, &b).unwrap_err();
        assert!(
            matches!(&error, Incomparable::Run { what: found, .. } if *found == what),
            "{error}"
        );
    }
    let wider = loaded(&packed(ModelConfig { point_width: CONFIG.point_width * 2, ..CONFIG }));
    let wider = record(&wider, &scene(1), 10, 2, Progress::none()).unwrap();
    let error = compare(&a, &wider).unwrap_err();
    assert!(matches!(error, Incomparable::Layers { .. }), "{error}");
    assert!(error.to_string().contains("point_features 0 of step 1"), "{error}");
}

/// A model that is told of impacts.
const WITH_IMPACTS: ModelConfig = ModelConfig { features: FeatureSet::Impact, ..CONFIG };

fn with_impacts() -> Recording {
    let model = loaded(&packed(WITH_IMPACTS));
    record(&model, &scene(1), 10, 3, Progress::none()).unwrap()
}

#[test]
fn impacts_have_columns_of_their_own_and_pooled_levels_room_for_them() {
    let recording = with_impacts();
    let of = |layer| {
        let content = Content::Layer(layer);
        recording.records.iter().filter(move |record| record.content == content)
    };
    assert!(of(Layer::Impacts).count() > 0);
    for part in of(Layer::Impacts) {
        assert_eq!((part.columns, part.values.len() % IMPACT_FEATURES), (IMPACT_FEATURES, 0));
    }
    for part in of(Layer::Pooled) {
        let columns = (2 * POOL_LEVELS + 2) * WITH_IMPACTS.point_width as usize;
        assert_eq!((part.columns, part.values.len()), (columns, 3 * columns));
    }
    let bytes = recording.to_bytes();
    assert_eq!(Recording::from_bytes(Path::new("x"), &bytes).unwrap(), recording);
}

#[test]
fn every_layer_of_a_model_has_whole_rows() {
    let recording = with_impacts();
    for layer in Layer::ALL {
        let mut parts = recording
            .records
            .iter()
            .filter(|record| record.content == Content::Layer(*layer))
            .peekable();
        assert!(parts.peek().is_some(), "{}", layer.name());
        assert!(parts.all(|record| record.values.len() % record.columns == 0), "{}", layer.name());
    }
}

#[test]
fn the_noise_of_impacts_is_measured() {
    let bytes = packed(WITH_IMPACTS);
    let (float, i8) = (loaded(&bytes), quantised(&bytes, Precision::I8));
    let report = check(&float, &i8, &[scene(1)], &Options::default(), Progress::none()).unwrap();
    let names: Vec<&str> = report.layers.iter().map(|layer| layer.layer.as_str()).collect();
    assert_eq!(names[..4], ["features", "point_features", "impacts", "pooled"]);
    assert_eq!(report.layers[2].sqnr_db, None, "inputs are not quantised");
    assert!(report.layers[3].sqnr_db.unwrap() > 20.0);
}

#[test]
fn an_impact_of_one_trace_alone_is_found_and_named() {
    let a = with_impacts();
    let is_impacts = |content| content == Content::Layer(Layer::Impacts);
    let at =
        a.records.iter().position(|record| record.step == 2 && is_impacts(record.content)).unwrap();
    let (unit, rows) = (a.records[at].index, a.records[at].values.len() / IMPACT_FEATURES);

    let mut b = a.clone();
    b.records[at].values.truncate((rows - 1) * IMPACT_FEATURES);
    let mut none = a.clone();
    none.records.remove(at);
    for (a, b, row, different) in
        [(&a, &b, rows - 1, 1), (&b, &a, rows - 1, 1), (&a, &none, 0, rows), (&none, &a, 0, rows)]
    {
        let comparison = compare(a, b).unwrap();
        let first = comparison.first.unwrap();
        assert_eq!((first.step, first.layer, first.unit, first.row), (2, "impacts", unit, row));
        assert!(first.a.is_nan() != first.b.is_nan());
        let text = first.to_string();
        assert!(text.contains(&format!("layer impacts, unit {unit}, impact {row}, ")), "{text}");
        let layers = comparison.layers.iter().filter(|layer| layer.different > 0);
        let found: Vec<_> =
            layers.map(|layer| (layer.layer.as_str(), layer.different, layer.largest)).collect();
        assert_eq!(found, [("impacts", (different * IMPACT_FEATURES) as u64, f64::INFINITY)]);
    }
}

#[test]
fn traces_of_an_older_version_are_refused() {
    let bytes = recording(Precision::F32).to_bytes();
    let (length, rest) = bytes.split_at(8);
    let end = u64::from_le_bytes(length.try_into().unwrap()) as usize;
    let header = std::str::from_utf8(&rest[..end]).unwrap();
    let older = header.replace("\"version\":\"2\"", "\"version\":\"1\"");
    assert_ne!(older, header);
    let bytes = [length, older.as_bytes(), &rest[end..]].concat();
    let error = Recording::from_bytes(Path::new("old.trace"), &bytes).unwrap_err().to_string();
    for part in ["old.trace", "metadata version", "\"1\"", "rigidformer trace"] {
        assert!(error.contains(part), "{error}");
    }
}
