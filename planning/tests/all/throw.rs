//! The example `throw`.

use std::path::Path;

use serde_json::Value;

use crate::examples::{Example, NANO, packed, path};

const THROW: Example = Example("throw");
/// An untrained model with the paper's inputs, as the lab exports it.
const EXPORTED: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/tiny-paper-inputs.model.safetensors");

/// The example itself predicts the plan once more, alone, and fails where a bit differs.
#[test]
fn throw_goes_over_the_wall_and_hits() {
    let few = ["--method", "mppi", "--futures", "24", "--iterations", "2", "--json"];
    let printed = THROW.works(&[&few[..], &["--model", NANO]].concat());
    let json: Value = serde_json::from_str(&printed).unwrap();
    let number = |throw: &str, what: &str| json[throw][what].as_f64().unwrap();
    assert!(number("planned", "cost") < number("straight", "cost") - 1.0, "{printed}");
    // Both balls have a radius of 0.35 m.
    assert!(number("planned", "miss_m") < 0.9 && number("straight", "miss_m") > 1.5, "{printed}");
}

#[test]
fn throw_prints_and_draws() {
    let folder = tempfile::tempdir().unwrap();
    let (model, out) = (packed(&folder, EXPORTED), path(&folder, "a/b"));
    let throw = ["--model", &model, "--futures", "30", "--iterations", "3", "--spin"];
    let printed = THROW.works(&[&throw[..], &["--out", &out]].concat());
    for expected in ["CEM of 30 futures", "planned", "spin (", "straight", "alone: the same bits"] {
        assert!(printed.contains(expected), "{expected:?} in {printed}");
    }
    let png = std::fs::read(Path::new(&out).join("throw.png")).unwrap();
    assert!(png.starts_with(b"\x89PNG"));

    let json: Value =
        serde_json::from_str(&THROW.works(&[&throw[..], &["--json"]].concat())).unwrap();
    assert_eq!(json["futures"], 90);
    assert_eq!(json["iterations"].as_array().unwrap().len(), 3);
    assert_eq!(json["planned"]["spin_rad_s"].as_array().unwrap().len(), 3);
    assert_eq!(json["cut"], Value::Null);
    assert_eq!(json["poses"].as_array().unwrap().len(), 24);
}

#[test]
fn throws_that_cannot_be_planned() {
    THROW.fails(&["--futures", "12"], 2, &["--futures", "fewer than two"]);
    THROW.fails(&["--iterations", "0"], 2, &["--iterations"]);
    THROW.fails(&["--deadline-ms", "0"], 1, &["before the first future", "allow more time"]);
}

#[test]
fn a_throw_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| path(&folder, name);
    let (mcap, glb, html) = (file("t.mcap"), file("t.glb"), file("t.html"));
    let few = ["--model", NANO, "--futures", "32", "--iterations", "1", "--json"];
    let json =
        THROW.works(&[&few[..], &["--mcap", &mcap, "--gltf", &glb, "--html", &html]].concat());
    let json: Value = serde_json::from_str(&json).unwrap();
    let steps = json["poses"].as_array().unwrap().len();
    let bytes = std::fs::read(&mcap).unwrap();
    // Its chunks are compressed, which tests of the program unpack.
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let channel = summary.channels.values().find(|channel| channel.topic == "/tf").unwrap();
    let counts = summary.stats.unwrap().channel_message_counts;
    assert_eq!(counts[&channel.id], steps as u64 + 1);
    let read = gltf::Gltf::from_slice(&std::fs::read(&glb).unwrap()).unwrap();
    assert!(read.nodes().any(|node| node.name() == Some("2 target")));
    assert!(std::fs::read_to_string(&html).unwrap().contains("A throw over a wall"));
}
