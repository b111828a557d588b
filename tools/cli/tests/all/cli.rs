//! The program as a user meets it: results, and for every mistake its text and exit code.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{Physics, Plane, Role};
use rigidformer_evaluation::convex_pieces::ConvexPieces;
use rigidformer_evaluation::models::random;
use rigidformer_evaluation::scenes::{
    Dataset, RecordedBond, RecordedScene, RecordedUnit, SceneNotes, SoftMesh, Split, Velocity,
    write_scene,
};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_weights::ModelConfig;
use tempfile::TempDir;

/// An untrained model with the paper's inputs, as the lab exports it.
const EXPORTED: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/tiny-paper-inputs.model.safetensors");
/// A small trained model.
const NANO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/nano.rfm");
/// The scene that comes with the program.
const SCENE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/default.safetensors");

/// Models of thin shells, and a scene with a sheet of four patches, a fixed ball, a fixed box and a free ball.
const SHELL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/shell.rfm");
const SHELL_F16: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/shell-f16.rfm");
const TINY_SOFT: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/tiny-soft.scene.safetensors");
/// A model that breaks bonds.
const FRAGMENTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../weights/models/fragments.rfm");

fn program() -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_rigidformer"));
    program.stdin(Stdio::null());
    program
}

fn run(arguments: &[&str]) -> Output {
    program().args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Runs what must work; its stdout.
fn works(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// Runs what must fail with this exit code, say all of `expected` on stderr and nothing on stdout.
fn fails(arguments: &[&str], code: i32, expected: &[&str]) {
    let output = run(arguments);
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
    for part in expected {
        assert!(stderr.contains(part), "{arguments:?}: no {part:?} in: {stderr}");
    }
    assert!(!stderr.contains("panicked"), "{stderr}");
    assert!(!stderr.contains('\u{1b}'), "colours although not on a terminal: {stderr}");
    assert_eq!(text(&output.stdout), "", "{arguments:?}");
}

/// A folder with a packed model in it.
struct Folder(TempDir);

impl Folder {
    fn new() -> Folder {
        let folder = Folder(tempfile::tempdir().unwrap());
        works(&["pack", EXPORTED, "--out", &folder.path("model.rfm")]);
        folder
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    fn file(&self, name: &str, bytes: &[u8]) -> String {
        let path = self.path(name);
        std::fs::write(&path, bytes).unwrap();
        path
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(self.0.path())
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }
}

/// The default scene's file with `change` made to the bytes after the header.
fn changed_scene(change: impl FnOnce(&serde_json::Value, &mut [u8])) -> Vec<u8> {
    let mut bytes = std::fs::read(SCENE).unwrap();
    let header_bytes = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header = serde_json::from_slice(&bytes[8..8 + header_bytes]).unwrap();
    change(&header, &mut bytes[8 + header_bytes..]);
    bytes
}

#[test]
fn help_has_examples_for_every_command() {
    let help = works(&["--help"]);
    for command in [
        "rollout",
        "evaluate",
        "inspect",
        "pack",
        "check",
        "identify",
        "calibrate",
        "import",
        "pieces",
        "render",
        "track",
        "trace",
        "diff",
    ] {
        assert!(help.contains(command), "{help}");
        assert!(
            works(&[command, "--help"]).contains(&format!("  rigidformer {command} ")),
            "{command}"
        );
    }
    assert!(works(&["--version"]).starts_with("rigidformer 0."));
}

#[test]
fn commands_that_moved_say_where_to() {
    for (command, instead) in [
        ("health", "inspect FILE --health"),
        ("embed", "pack MODEL --header"),
        ("throw", "--example throw"),
        ("push", "--example push"),
        ("walk", "--example walk"),
        ("controls", "rigidformer_lab.controls"),
    ] {
        fails(&[command], 2, &[command, instead]);
        fails(&[command, "x", "--json"], 2, &[command, instead]);
    }
}

#[test]
fn rollout_writes_its_three_files() {
    let folder = Folder::new();
    let (model, out) = (folder.path("model.rfm"), folder.path("a/b"));
    let printed =
        works(&["rollout", "--model", &model, "--out", &out, "--step", "5", "--frames", "40"]);
    assert!(printed.contains("primitives seed 260: 5 units"), "{printed}");
    assert!(printed.contains("40"), "{printed}");

    let csv = std::fs::read_to_string(Path::new(&out).join("poses.csv")).unwrap();
    let mut lines = csv.lines();
    let header =
        "frame,time_s,unit,x,y,z,qw,qx,qy,qz,true_x,true_y,true_z,true_qw,true_qx,true_qy,true_qz";
    assert_eq!(lines.next(), Some(header));
    assert_eq!(lines.clone().count(), 9 * 5, "frames 0, 5, .. 40 of five units");
    assert!(
        lines.all(|line| line.split(',').all(|cell| cell.parse::<f64>().is_ok_and(f64::is_finite)))
    );
    for picture in ["errors.png", "strip.png"] {
        let bytes = std::fs::read(Path::new(&out).join(picture)).unwrap();
        assert!(
            bytes.starts_with(b"\x89PNG\r\n\x1a\n") && bytes.len() > 10_000,
            "{picture}: {} bytes",
            bytes.len()
        );
    }
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 3, "no temporary files stay");
}

/// Width and height of a picture, pixels.
fn png_size(path: &str) -> (u32, u32) {
    let bytes = std::fs::read(path).unwrap();
    assert!(bytes.starts_with(b"\x89PNG\r\n\x1a\n"), "{path}");
    let number = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    (number(16), number(20))
}

#[test]
fn rollout_shows_the_frames_that_are_asked_for() {
    let folder = Folder::new();
    let (model, out) = (folder.path("model.rfm"), folder.path("out"));
    let with = |more: &[&'static str]| {
        let all = ["rollout", "--model", &model, "--out", &out, "--step", "8", "--frames", "40"];
        [&all[..], more].concat()
    };
    let strip = folder.path("out/strip.png");
    works(&with(&[]));
    let (four, high) = png_size(&strip);
    works(&with(&["--show", "10,40"]));
    let (two, same) = png_size(&strip);
    assert!(two < four && same == high, "{two} {four} {same} {high}");
    fails(&with(&["--show", "10,41"]), 2, &["--show 41", "frame 40 is the last", "--frames"]);
    fails(&with(&["--show", "1,2,3,4,5,6,7,8,9"]), 2, &["--show with 9 frames", "8 have room"]);
    fails(&with(&["--show", "ten"]), 2, &["--show"]);
}

#[test]
fn evaluate_interpolates_where_a_step_reaches_no_published_frame() {
    let folder = Folder::new();
    let model = folder.path("model.rfm");
    let json = works(&["evaluate", SCENE, "--model", &model, "--steps", "8", "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let notes = json["notes"].to_string();
    assert!(notes.contains("step 8 does not reach frame 50, 75, 100"), "{notes}");
    let frames = &json["model"]["steps"][0]["figures"]["frames"];
    assert_eq!((&frames[0]["frame"], frames.as_array().unwrap().len()), (&50.into(), 3));
    assert!(works(&["evaluate", "--help"]).contains("frame 50 between 48 and 56"));
}

#[test]
#[cfg(feature = "default-model")]
fn rollout_needs_no_arguments() {
    let folder = tempfile::tempdir().unwrap();
    let output = program().arg("rollout").current_dir(&folder).output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!(std::fs::read_dir(folder.path().join("rollout")).unwrap().count(), 3);
}

#[test]
fn evaluate_prints_tables_and_json() {
    let folder = Folder::new();
    let model = folder.path("model.rfm");
    let table = works(&["evaluate", SCENE, "--model", &model, "--steps", "10"]);
    assert!(table.contains("tiny-paper-inputs") && table.contains("free fall"), "{table}");
    let json = works(&["evaluate", SCENE, "--model", &model, "--steps", "5,10", "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["scenes"], 1);
    assert_eq!(json["model"]["steps"][1]["step"], 10);
    assert_eq!(json["model"]["steps"][1]["figures"]["frames"][2]["frame"], 100);
    assert!(json["free_fall"]["frames"][2]["position_m"].as_f64().unwrap() > 0.1);
    // The means of one scene are that scene's figures.
    let scene = &json["per_scene"][0];
    assert_eq!(json["per_scene"].as_array().unwrap().len(), 1);
    assert_eq!(
        (&scene["name"], &scene["seed"], &scene["units"]),
        (&"primitives seed 260".into(), &260.into(), &5.into())
    );
    for (step, code) in [(0, 5), (1, 10)] {
        let (alone, all) =
            (&scene["steps"][step]["figures"], &json["model"]["steps"][step]["figures"]);
        assert_eq!(scene["steps"][step]["step"], code);
        assert_eq!(alone["frames"], all["frames"]);
        assert_eq!(alone["frames"][2]["frame"], 100);
        assert!(alone["frames"][2]["orientation_mean_deg"].as_f64().unwrap() > 0.0);
        assert_eq!(alone["penetration"]["ground_m"], all["penetration"]["ground_mean_m"]);
        assert_eq!(alone["penetration"]["units_m"], all["penetration"]["units_max_m"]);
    }
    assert_eq!(scene["free_fall"]["frames"], json["free_fall"]["frames"]);
}

/// A file with one toss of a cube that touches nothing, called as the recorded ones are or otherwise.
fn toss(folder: &Folder, dataset: &str) -> String {
    let corner =
        |i: i32| Point3::from([1, 2, 4].map(|bit| if i & bit == 0 { -0.05 } else { 0.05 }));
    let velocity = Velocity {
        linear_m_s: Vector3::new(1.0, 0.5, 0.25),
        angular_rad_s: Vector3::new(0.0, 0.0, 3.0),
    };
    let pose = |frame: u32| {
        let t = frame as f32 / 148.0;
        let fall = Vector3::new(0.0, 0.0, 2.0 - 0.5 * 9.81 * t * t);
        Isometry3::new(fall + velocity.linear_m_s * t, velocity.angular_rad_s * t)
    };
    let physics = Physics { mass_kg: 0.37, friction: 0.42, restitution: 0.35 };
    let points = (0..8).map(corner).collect();
    let unit = RecordedUnit::new("cube", points, physics, (0..=40).map(pose).collect());
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let units = vec![unit.with_velocity(velocity)];
    let scene = RecordedScene::new("toss", 12, Split::Test, 148.0, gravity, units)
        .unwrap()
        .with_planes(vec![Plane::ground(0.42, 0.35)])
        .unwrap();
    let path = folder.path("toss.safetensors");
    let notes =
        SceneNotes { dataset: dataset.into(), provenance: "a test".into(), licence: "none".into() };
    write_scene(Path::new(&path), &scene, &notes).unwrap();
    path
}

#[test]
fn evaluate_rolls_tosses_out_in_open_loop() {
    let folder = Folder::new();
    let path = toss(&folder, "cube-tosses");
    let table = works(&["evaluate", &path, "--model", NANO, "--steps", "2,10"]);
    for part in ["open loop", "Drake", "13.5 ± 8.2", "MuJoCo", "21.7 ± 21.4", "% of an edge"] {
        assert!(table.contains(part), "no {part:?} in {table}");
    }
    let json = works(&["evaluate", &path, "--model", NANO, "--steps", "2,10", "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    for (index, code) in [(0, 2), (1, 10)] {
        let step = &json["model"]["steps"][index];
        assert_eq!(step["step"], code);
        let alone = &step["per_toss"][0];
        assert_eq!((&alone["seed"], &alone["frames"]), (&12.into(), &40.into()));
        assert_eq!(
            (&alone["position_m"], &alone["rotation_deg"]),
            (&step["position_m"], &step["rotation_deg"])
        );
        assert!(step["position_m"].as_f64().unwrap() < 3e-3, "{step}");
        assert!(step["rotation_deg"].as_f64().unwrap() < 0.05, "{step}");
    }
    assert_eq!(json["published"][1]["predictor"], "Bullet");
    let shown = works(&["inspect", &path]);
    assert!(shown.contains("velocities") && shown.contains("41 frames at 148 Hz"), "{shown}");
    let picture = folder.path("toss.png");
    let drawn =
        works(&["evaluate", &path, "--model", NANO, "--steps", "10", "--picture", &picture]);
    assert!(drawn.ends_with(&format!("wrote {picture}\n")), "{drawn}");
    assert!(png_size(&picture).0 > 8 * 250, "eight instants");
    let nowhere = folder.path("no/such/toss.png");
    let refused =
        run(&["evaluate", &path, "--model", NANO, "--steps", "10", "--picture", &nowhere]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(text(&refused.stdout).contains("Drake"), "the figures come first");
    assert!(text(&refused.stderr).contains(&nowhere));

    let other = toss(&folder, "tosses of my own");
    let table = works(&["evaluate", &other, "--model", NANO, "--steps", "5"]);
    assert!(!table.contains("Drake") && !table.contains("% of an edge"), "{table}");
}

/// A scene file may say how contacts in it differ from rigid ones: all commands that step its scenes follow, with the network and
/// without it.
#[test]
fn scenes_have_the_contact_law_of_their_file() {
    let folder = Folder::new();
    let bytes = std::fs::read(SCENE).unwrap();
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let with = |name: &str, law: &str| {
        let mut header: serde_json::Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
        header["__metadata__"]["contact_law"] = law.into();
        let mut header = header.to_string();
        header.extend(std::iter::repeat_n(' ', header.len().next_multiple_of(8) - header.len()));
        let made = [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &bytes[8 + length..]];
        let path = folder.path(name);
        std::fs::write(&path, made.concat()).unwrap();
        path
    };
    let lawful = with("lawful.safetensors", "0.3,pyramid");
    let evaluated = |path: &str, more: &[&str]| -> serde_json::Value {
        let usual = ["evaluate", path, "--model", NANO, "--steps", "10", "--json"];
        serde_json::from_str(&works(&[&usual, more].concat())).unwrap()
    };
    let (plain, ruled) = (evaluated(SCENE, &[]), evaluated(&lawful, &[]));
    assert_eq!(
        (&plain["contact_law"], &ruled["contact_law"]),
        (&"0".into(), &"0.3,pyramid".into())
    );
    assert_eq!(ruled["changed_by"], serde_json::json!([]));
    for part in ["model", "without_network"] {
        assert_ne!(plain[part], ruled[part], "{part}");
        // The option has the same law, and takes the file's place.
        for (path, law, expected) in [
            (SCENE, "0.3,pyramid", &ruled),
            (lawful.as_str(), "0", &plain),
            (&lawful, "0.3,pyramid", &ruled),
        ] {
            let asked = evaluated(path, &["--contact-law", law]);
            assert_eq!(asked[part], expected[part], "{law}");
            assert_eq!(asked["changed_by"], serde_json::json!(["--contact-law"]));
        }
    }
    let alone = evaluated(&lawful, &["--without-network"]);
    assert_eq!(
        (&alone["model"], &alone["contact_law"]),
        (&ruled["without_network"], &"0.3,pyramid".into())
    );

    let rolled_out = |path: &str, out: &str| {
        works(&["rollout", path, "--model", NANO, "--out", &folder.path(out)]);
        std::fs::read_to_string(folder.path(out) + "/poses.csv").unwrap()
    };
    assert_ne!(rolled_out(SCENE, "plain"), rolled_out(&lawful, "ruled"));
    let checked = |path: &str| {
        let float = NANO.replace("nano.rfm", "nano-f32.rfm");
        let out = run(&["check", "--float", &float, "--quantised", NANO, path, "--json"]);
        let document: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        document["steps"].clone()
    };
    // nano leaves scenes with a law alone, so it is checked over rigid contact.
    assert!(checked(SCENE).is_array() && checked(SCENE) == checked(&lawful));
    assert!(
        ruled["model"]["steps"][0]["figures"] == ruled["without_network"]["steps"][0]["figures"]
    );

    assert!(works(&["inspect", &lawful]).contains("0.3,pyramid"));
    let shown: serde_json::Value =
        serde_json::from_str(&works(&["inspect", &lawful, "--json"])).unwrap();
    assert_eq!(shown["contact_law"], "0.3,pyramid");
    for (number, law) in ["", "2", "-0.1", "NaN", "0.1,cone", "0.1,pyramid,"].iter().enumerate() {
        let out = run(&["evaluate", &with(&format!("{number}.safetensors"), law), "--model", NANO]);
        let said = text(&out.stderr);
        assert!(!out.status.success());
        assert!(said.contains("metadata contact_law") && said.contains("from 0 to 1"), "{said}");
    }
}

/// The same motion without the network stands beside a model, and the model's file and card can keep both.
#[test]
fn what_a_network_is_worth_is_shown_and_kept() {
    let folder = Folder::new();
    let (scene, figures, packed) =
        (toss(&folder, "my tosses"), folder.path("figures.json"), folder.path("nano.rfm"));
    let evaluated = |more: &[&str]| {
        let usual = ["evaluate", &scene, "--model", NANO, "--steps", "5"];
        works(&[&usual, more].concat())
    };
    let document = evaluated(&["--json"]);
    let json: serde_json::Value = serde_json::from_str(&document).unwrap();
    let gains = json["gains"].as_array().unwrap();
    assert_eq!(gains.len(), 2);
    assert_eq!((&gains[0]["step"], &gains[0]["figure"]), (&5.into(), &"position_m".into()));
    let alone: serde_json::Value =
        serde_json::from_str(&evaluated(&["--json", "--no-network"])).unwrap();
    assert_eq!(json["without_network"], alone["model"]);
    assert!(alone["gains"].is_null());
    assert_eq!(gains[0]["with_network"], json["model"]["steps"][0]["position_m"]);
    assert_eq!(gains[0]["without_network"], alone["model"]["steps"][0]["position_m"]);
    assert!(evaluated(&[]).contains("what the network is worth"));

    std::fs::write(&figures, &document).unwrap();
    works(&["pack", NANO, "--metrics", &figures, "--out", &packed]);
    let card = works(&["inspect", &packed, "--card"]);
    for part in [
        "# Model card: nano",
        "my tosses.test.step5.position_m|",
        "## Where it fails",
        "Apache-2.0",
    ] {
        assert!(card.contains(part), "{part}: {card}");
    }
    // Figures of before may be of other code.
    assert!(!card.contains("|movi-a"), "{card}");

    let refused = |arguments: &[&str], what: &str| {
        let out = run(arguments);
        assert!(!out.status.success() && text(&out.stderr).contains(what), "{}", text(&out.stderr));
    };
    refused(&["pack", SHELL, "--metrics", &figures, "--out", &packed], "has the figures of nano");
    for law in ["2", "NaN", "0.1,cone", ""] {
        refused(&["evaluate", &scene, "--model", NANO, "--contact-law", law], "--contact-law");
    }
    refused(&["evaluate", &scene, "--model", SHELL, "--contact-law", "0.1"], "give edge or nano");
    let lawful = evaluated(&["--json", "--contact-law", "0.3,pyramid"]);
    let other: serde_json::Value = serde_json::from_str(&lawful).unwrap();
    assert_eq!(other["changed_by"], serde_json::json!(["--contact-law"]));
    assert_eq!((&other["contact_law"], &json["contact_law"]), (&"0.3,pyramid".into(), &"0".into()));
    assert!(evaluated(&["--contact-law", "0.3"]).contains("contact law 0.3"));
    std::fs::write(&figures, lawful).unwrap();
    refused(&["pack", NANO, "--metrics", &figures, "--out", &packed], "--contact-law");
    std::fs::write(&figures, "{}").unwrap();
    refused(
        &["pack", NANO, "--metrics", &figures, "--out", &packed],
        "rigidformer evaluate --json",
    );
    refused(&["inspect", &scene, "--card"], "--card");
}

#[test]
fn inspect_tells_models_from_scenes() {
    let folder = Folder::new();
    let model = folder.path("model.rfm");
    assert!(works(&["inspect", &model]).contains("encoder.point.0.weight"));
    let json: serde_json::Value =
        serde_json::from_str(&works(&["inspect", &model, "--json"])).unwrap();
    assert_eq!((&json["kind"], &json["config"]["ground_friction"]), (&"model".into(), &0.3.into()));
    let shown = works(&["inspect", SCENE]);
    assert!(shown.contains("every pose checked") && shown.contains("file version 1"), "{shown}");
    assert!(shown.contains("ground friction     0.3"), "{shown}");
    let json: serde_json::Value =
        serde_json::from_str(&works(&["inspect", SCENE, "--json"])).unwrap();
    assert_eq!(
        (&json["kind"], &json["units"], &json["frames"]),
        (&"scenes".into(), &5.into(), &121.into())
    );
}

#[test]
fn inspect_shows_what_version_2_adds() {
    let folder = Folder::new();
    let path = folder.path("cell.safetensors");
    let points: Vec<_> = (0..4).map(|i| Point3::new(i as f32, (i * i) as f32, 0.5)).collect();
    let unit = |x: f32| {
        let physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
        let poses = vec![Isometry3::translation(x, 0.0, 1.0); 6];
        RecordedUnit::new("part", points.clone(), physics, poses)
    };
    let units = vec![
        unit(0.0),
        unit(2.0).with_role(Role::Driven).with_body(1),
        unit(4.0).with_role(Role::Driven).with_body(1),
        unit(6.0).with_role(Role::Fixed),
        unit(8.0).with_soft(vec![points.clone(); 6]),
    ];
    let wall = Plane {
        normal: Vector3::new(-1.0, 0.0, 0.0),
        offset_m: -2.5,
        friction: 0.7,
        restitution: 0.1,
    };
    let scene = RecordedScene::new("cell", 1, Split::Test, 60.0, Vector3::zeros(), units)
        .unwrap()
        .with_planes(vec![Plane::ground(0.3, 0.5), wall])
        .unwrap()
        .with_commands(3, vec![0.5; 18])
        .unwrap();
    let notes =
        SceneNotes { dataset: "cell".into(), provenance: "a test".into(), licence: "none".into() };
    write_scene(path.as_ref(), &scene, &notes).unwrap();

    let shown = works(&["inspect", &path]);
    for expected in [
        "file version 2",
        "free    2",
        "driven  2",
        "fixed   1",
        "soft    1",
        "bodies  4, 2 units share one with others",
        "3 numbers a frame",
        "normal -1 0 0  offset -2.5 m, friction 0.7, restitution 0.1, in 1 scenes",
    ] {
        assert!(shown.contains(expected), "no {expected:?} in: {shown}");
    }
    let json: serde_json::Value =
        serde_json::from_str(&works(&["inspect", &path, "--json"])).unwrap();
    assert_eq!(json["version"], 2);
    assert_eq!(json["roles"], serde_json::json!({ "free": 2, "driven": 2, "fixed": 1 }));
    assert_eq!((&json["bodies"], &json["units_sharing_a_body"]), (&4.into(), &2.into()));
    assert_eq!((&json["soft_units"], &json["command_size"]), (&1.into(), &3.into()));
    let expected = serde_json::json!({
        "normal": [-1.0, 0.0, 0.0], "offset_m": -2.5, "friction": 0.7, "restitution": 0.1,
        "scenes": 1,
    });
    assert_eq!(json["planes"][1], expected);
    assert!(json["ground_friction"].is_null());
}

#[test]
fn check_measures_judges_and_draws() {
    let folder = Folder::new();
    let (float, i8) = (folder.path("model.rfm"), folder.path("i8.rfm"));
    works(&["pack", &float, "--dtype", "i8", "--out", &i8]);
    let lax = folder.file(
        "lax.json",
        b"{\"metric_change\": 9, \"one_step_ratio\": 9, \"drift_step\": null, \"median_drift_m\": 9,
           \"median_drift_deg\": 180, \"rigidity\": 1, \"layer_sqnr_db\": null}",
    );
    let models = ["check", "--float", &float, "--quantised", &i8, SCENE];
    let out = folder.path("out");
    let printed = works(&[&models[..], &["--tolerances", &lax, "--out", &out]].concat());
    for part in ["primitives", "10, 100", "point_features", "within the tolerances", "drift.png"] {
        assert!(printed.contains(part), "no {part:?} in: {printed}");
    }
    let png = std::fs::read(Path::new(&out).join("drift.png")).unwrap();
    assert!(png.starts_with(b"\x89PNG\r\n\x1a\n") && png.len() > 5_000);

    let strict = std::fs::read_to_string(&lax).unwrap().replace(": 9", ": 0");
    let strict = folder.file("strict.json", strict.as_bytes());
    let options = ["--tolerances", &strict, "--steps", "10", "--json"];
    let failed = run(&[&models[..], &options].concat());
    assert_eq!(failed.status.code(), Some(1));
    let stderr = text(&failed.stderr);
    for part in [&i8, "outside", "step 10: one-step ratio is", "allowed is 0"] {
        assert!(stderr.contains(part), "no {part:?} in: {stderr}");
    }
    let json: serde_json::Value = serde_json::from_slice(&failed.stdout).unwrap();
    assert_eq!((&json["pass"], &json["steps"][0]["step"]), (&false.into(), &10.into()));
    assert!(!json["violations"].as_array().unwrap().is_empty());

    // The float model against itself: no difference is allowed, none is there.
    let printed = works(&["check", "--float", &float, "--quantised", &float, SCENE]);
    assert!(printed.contains("exact"), "{printed}");
}

/// A sheet of two patches that share a line and fall, recorded for so many frames.
fn falling_sheet(folder: &Folder, frames: u32) -> String {
    let patch = |first: usize| -> Vec<Point3<f32>> {
        let place = |i: usize| Point3::new(0.1 * (first + i % 3) as f32, 0.1 * (i / 3) as f32, 0.0);
        (0..9).map(place).collect()
    };
    let z = |frame: u32| 20.0 - 0.5 * 9.81 * (frame as f32 / 60.0).powi(2);
    let unit = |first: usize| {
        let points = patch(first);
        let physics = Physics { mass_kg: 0.05, friction: 0.5, restitution: 0.0 };
        let poses = (0..frames).map(|frame| Isometry3::translation(0.0, 0.0, z(frame))).collect();
        let at = |frame| points.iter().map(|p| p + Vector3::z() * z(frame)).collect();
        let soft = (0..frames).map(at).collect();
        RecordedUnit::new(format!("patch {first}"), points, physics, poses)
            .with_body(0)
            .with_soft(soft)
            .with_young(4e5)
    };
    let square = |a: usize| [[a, a + 1, a + 4], [a, a + 4, a + 3]];
    let faces = [0, 1, 3, 4, 9, 10, 12, 13].into_iter().flat_map(square).collect();
    let mesh = SoftMesh { faces, edges: vec![[0, 1], [9, 10]], tetrahedra: Vec::new() };
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let scene = RecordedScene::new("sheet", 1, Split::Test, 60.0, gravity, vec![unit(0), unit(2)])
        .unwrap()
        .with_planes(vec![Plane::ground(1.0, 0.0)])
        .unwrap()
        .with_mesh(mesh)
        .unwrap();
    saved(folder, "sheet", &scene)
}

fn saved(folder: &Folder, name: &str, scene: &RecordedScene) -> String {
    let path = folder.path(&format!("{name}.safetensors"));
    let notes =
        SceneNotes { dataset: name.into(), provenance: "a test".into(), licence: "none".into() };
    write_scene(path.as_ref(), scene, &notes).unwrap();
    path
}

#[test]
fn rollout_draws_soft_bodies_and_writes_their_points() {
    let folder = Folder::new();
    let out = folder.path("out");
    let printed = works(&["rollout", TINY_SOFT, "--model", SHELL, "--out", &out]);
    for part in ["step 5", "points m", "best rigid", "predicted.safetensors"] {
        assert!(printed.contains(part), "no {part:?} in: {printed}");
    }
    for name in ["strip.png", "errors.png"] {
        assert!(png_size(&format!("{out}/{name}")).0 > 500, "{name}");
    }
    let again = folder.path("again");
    works(&["rollout", TINY_SOFT, "--model", SHELL, "--out", &again]);
    let written = Dataset::open(format!("{out}/predicted.safetensors").as_ref()).unwrap();
    let twin = Dataset::open(format!("{again}/predicted.safetensors").as_ref()).unwrap();
    let truth = Dataset::open(TINY_SOFT.as_ref()).unwrap().scene(0, None).unwrap();
    let scene = written.scene(0, None).unwrap();
    assert_eq!(scene, twin.scene(0, None).unwrap());
    assert_eq!((scene.frames(), scene.frame_rate_hz()), (3, 12.0));
    assert_eq!(scene.mesh(), truth.mesh());
    assert!(written.provenance().contains("step 5 from frames 0 and 5"));
    for (unit, recorded) in scene.units().iter().zip(truth.units()) {
        assert_eq!(
            (&unit.points, unit.role, unit.young_pa),
            (&recorded.points, recorded.role, recorded.young_pa)
        );
        let (Some(soft), Some(recorded)) = (&unit.soft, &recorded.soft) else { continue };
        assert_eq!((&soft[0], &soft[1]), (&recorded[0], &recorded[5]), "observed");
        let far = soft[2].iter().zip(&recorded[10]).map(|(a, b)| (a - b).norm());
        // The scene is made up, and not what the model learnt: but nothing flies away.
        assert!(far.fold(0.0, f32::max) < 0.5);
    }

    let remedy = ["unit 0 is soft", "give a model of soft bodies"];
    fails(&["rollout", TINY_SOFT, "--model", NANO, "--out", &out], 1, &remedy);
    // The other commands that take a model and a scene say the same.
    let trace = folder.path("trace");
    fails(&["trace", TINY_SOFT, "--model", NANO, "--step", "5", "--out", &trace], 1, &remedy);
}

#[test]
fn rollout_of_a_rigid_scene_writes_no_scene() {
    let folder = Folder::new();
    let out = folder.path("out");
    works(&["rollout", SCENE, "--model", NANO, "--frames", "30", "--out", &out]);
    assert!(!Path::new(&out).join("predicted.safetensors").exists());
}

#[test]
fn pieces_that_hold_together_are_drawn_and_written() {
    let folder = Folder::new();
    let corner = |i: i32| [1, 2, 4].map(|bit| if i & bit == 0 { -0.1_f32 } else { 0.1 });
    let points: Vec<Point3<f32>> = (0..8).map(|i| Point3::from(corner(i))).collect();
    let unit = |x: f32| {
        let z = |frame: i32| 3.0 - 0.5 * 9.81 * (frame as f32 / 60.0).powi(2);
        let poses = (0..31).map(|frame| Isometry3::translation(x, 0.0, z(frame))).collect();
        let physics = Physics { mass_kg: 8.0, friction: 0.5, restitution: 0.0 };
        RecordedUnit::new("brick", points.clone(), physics, poses).with_body(0)
    };
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let units = vec![unit(0.0), unit(0.2), unit(0.4)];
    let bond = |units, breaks_at| RecordedBond { units, breaks_at };
    let scene = RecordedScene::new("bricks", 1, Split::Test, 60.0, gravity, units)
        .unwrap()
        .with_planes(vec![Plane::ground(1.0, 0.0)])
        .unwrap()
        .with_bonds(vec![bond([0, 1], None), bond([2, 1], Some(12))])
        .unwrap();
    let path = saved(&folder, "bricks", &scene);
    let out = folder.path("out");
    works(&["rollout", &path, "--model", NANO, "--step", "5", "--out", &out]);
    let written = Dataset::open(format!("{out}/predicted.safetensors").as_ref()).unwrap();
    // Broken at frame 12, so in the step from frame 15 on: at the fifth sample.
    assert_eq!(
        written.scene(0, None).unwrap().bonds(),
        [bond([0, 1], None), bond([2, 1], Some(4))]
    );
    let shown = works(&["inspect", &path]);
    assert!(shown.contains("pairs of units  2, 1 break within the record"), "{shown}");
    assert!(shown.contains("\nbonds\n"), "{shown}");
}

/// A row of bricks that falls fast on the ground: recorded to stay whole in the air, which the ground is not.
#[test]
fn evaluate_says_which_bonds_break_and_where_pieces_are() {
    let folder = Folder::new();
    let corner = |i: i32| [1, 2, 4].map(|bit| if i & bit == 0 { -0.25_f32 } else { 0.25 });
    let points: Vec<Point3<f32>> = (0..8).map(|i| Point3::from(corner(i))).collect();
    let unit = |x: f32, z: f32| {
        let poses = (0..121).map(|frame| {
            let time = frame as f32 / 60.0;
            Isometry3::translation(x, 0.0, (z + 2.0 - 6.0 * time).max(z))
        });
        let physics = Physics { mass_kg: 125.0, friction: 0.6, restitution: 0.0 };
        RecordedUnit::new("brick", points.clone(), physics, poses.collect()).with_body(0)
    };
    let units = vec![unit(0.0, 0.25), unit(0.5, 0.25), unit(0.0, 0.75), unit(0.5, 0.75)];
    let bond = |units, breaks_at| RecordedBond { units, breaks_at };
    let bonds = vec![
        bond([0, 1], Some(21)),
        bond([2, 3], Some(21)),
        bond([0, 2], Some(21)),
        bond([1, 3], None),
    ];
    let scene = RecordedScene::new("bricks", 1, Split::Test, 60.0, Vector3::z() * -9.81, units)
        .unwrap()
        .with_planes(vec![Plane::ground(1.0, 0.0)])
        .unwrap()
        .with_bonds(bonds)
        .unwrap();
    let path = saved(&folder, "bricks", &scene);
    let json = |arguments: &[&str]| -> serde_json::Value {
        serde_json::from_str(&works(&[&["evaluate", &path, "--json"], arguments].concat())).unwrap()
    };
    let found = json(&["--model", FRAGMENTS]);
    let figures = &found["model"]["steps"][0]["figures"];
    assert_eq!(found["model"]["steps"][0]["step"], 5);
    let frames = figures["frames"].as_array().unwrap();
    assert_eq!(
        (frames[0]["frame"].as_u64(), frames.last().unwrap()["frame"].as_u64()),
        (Some(5), Some(100))
    );
    assert!(frames.iter().all(|frame| frame["vertex_m"].as_f64().unwrap() < 3.0));
    let all = |bonds: &serde_json::Value| -> u64 {
        let keys = ["broken_in_both", "broken_in_rollout", "broken_in_record", "hold_in_both"];
        keys.map(|key| bonds[key].as_u64().unwrap()).iter().sum()
    };
    assert_eq!(all(&figures["bonds"]), 4);
    let named = |name: &str| {
        let rows = found["baselines"].as_array().unwrap();
        rows.iter().find(|row| row["name"] == name).unwrap().clone()
    };
    assert_eq!(named("all broken")["bonds"]["recall"], 1.0);
    assert_eq!(named("none broken")["bonds"]["f1"], 0.0);
    // A model that breaks none is told when they do.
    let told = json(&["--model", NANO]);
    assert_eq!(told["model"]["steps"][0]["figures"]["bonds"]["f1"], 1.0);
    let shown = works(&["evaluate", &path, "--model", NANO]);
    assert!(shown.contains("when the record says so") && shown.contains("F1 of those that hold"));

    // Bonds that one model alone breaks are counted, and their units left out of the distance after one step.
    let f16 = FRAGMENTS.replace("fragments.rfm", "fragments-f16.rfm");
    let models = ["check", "--float", &f16, "--quantised", FRAGMENTS, &path, "--steps", "5"];
    let shown = text(&run(&models).stdout);
    assert!(shown.contains("bonds, step 5: ") && shown.contains("by one model alone"), "{shown}");
    let one: serde_json::Value =
        serde_json::from_str(&text(&run(&[&models[..], &["--json"]].concat()).stdout)).unwrap();
    let one = &one["steps"][0]["one_step"];
    let (held, apart) = (one["bonds"]["held"].as_u64(), one["bonds"]["apart"].as_u64());
    assert!(held > Some(4) && apart <= held, "{one}");
    let units = one["units"].as_u64().unwrap() + one["bonds"]["units"].as_u64().unwrap();
    assert_eq!(units, 40, "10 states of four bricks");

    fails(&["evaluate", &path, "--model", FRAGMENTS, "--join"], 2, &["without bonds"]);
    fails(&["evaluate", &path, "--model", FRAGMENTS, "--steps", "61"], 2, &["121 frames"]);
    fails(&["evaluate", &path, "--model", SHELL], 2, &["hold together", "fragments.rfm"]);
}

#[test]
fn check_and_trace_compare_soft_points() {
    let folder = Folder::new();
    let path = falling_sheet(&folder, 101);
    let out = folder.path("out");
    let lax = folder.file(
        "lax.json",
        b"{\"metric_change\": 9e9, \"one_step_ratio\": 9e9, \"drift_step\": null, \"median_drift_m\": 9,
           \"median_drift_deg\": 180, \"rigidity\": 1, \"layer_sqnr_db\": null}",
    );
    let models = ["check", "--float", SHELL_F16, "--quantised", SHELL, &path, "--steps", "5"];
    let lenient = [&models[..], &["--tolerances", &lax, "--out", &out]].concat();
    let printed = works(&lenient);
    assert!(printed.contains("soft points") && printed.contains("of 18"), "{printed}");
    assert!(!printed.contains("float deg"), "no pose of a rigid unit is there: {printed}");
    assert!(png_size(&format!("{out}/drift.png")).0 > 500);
    let json = works(&[&lenient[..], &["--json"]].concat());
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let drift = json["steps"][0]["point_drift"].as_array().unwrap();
    let frames: Vec<u64> = drift.iter().map(|at| at["frame"].as_u64().unwrap()).collect();
    assert!((0..=100).step_by(5).all(|frame| frames.contains(&frame)), "{frames:?}");
    assert_eq!((&drift[0]["points"], &drift[0]["apart"]), (&18.into(), &0.into()));
    let last = drift.last().unwrap();
    assert!(
        last["apart"].as_u64().unwrap() > 0 && last["distance_m"]["max"].as_f64().unwrap() > 0.0
    );
    assert_eq!(json["steps"][0]["point_metrics"].as_array().unwrap().len(), 3);
    assert_eq!(json["steps"][0]["one_step"]["units"], 20, "10 states of two patches");

    // Limits are looked at.
    let strict = std::fs::read_to_string(&lax)
        .unwrap()
        .replace("\"median_drift_m\": 9", "\"median_drift_m\": 0");
    let strict = folder.file("strict.json", strict.as_bytes());
    let failed = run(&[&models[..], &["--tolerances", &strict]].concat());
    assert_eq!(failed.status.code(), Some(1));
    let stderr = text(&failed.stderr);
    assert!(stderr.contains("median drift of points, m, is"), "{stderr}");
    // Models of another kind of bodies, and int8 as the reference.
    fails(&["check", "--float", SHELL_F16, "--quantised", NANO, &path], 1, &["configuration: "]);
    fails(&["check", "--float", SHELL, "--quantised", SHELL_F16, &path], 1, &["is i8", "f16 one"]);

    let trace = |name: &str, model: &str| {
        let out = folder.path(name);
        works(&[
            "trace", TINY_SOFT, "--model", model, "--step", "5", "--steps", "2", "--out", &out,
        ]);
        out
    };
    let (a, again, b) = (trace("a", SHELL), trace("again", SHELL), trace("b", SHELL_F16));
    let printed = works(&["diff", &a, &again]);
    assert!(printed.contains("soft_points") && printed.contains("the same bits"), "{printed}");
    let differ = run(&["diff", &a, &b, "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&differ.stdout).unwrap();
    let layers = json["layers"].as_array().unwrap();
    let points = layers.iter().find(|layer| layer["layer"] == "soft_points").unwrap();
    assert_eq!(points["elements"], 3 * 64 * 3, "observed and two steps");
    assert!(points["different"].as_u64().unwrap() > 0);
}

#[test]
fn inspect_is_short_whatever_the_number_of_shapes() {
    let folder = Folder::new();
    let shown = works(&["inspect", &falling_sheet(&folder, 3)]);
    for part in [
        "soft    2",
        "soft units",
        "points           18",
        "4e5 Pa",
        "faces            16",
        "edges            2",
    ] {
        assert!(shown.contains(part), "no {part:?} in: {shown}");
    }
    assert!(!shown.contains("tetrahedra") && !shown.contains("bonds"), "{shown}");
    let physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
    let unit = |number: usize| {
        let points = (0..4 + number % 3).map(|i| Point3::new(i as f32, 0.0, 0.0)).collect();
        RecordedUnit::new(format!("cell {number}"), points, physics, vec![Isometry3::identity()])
    };
    let scene = |units: usize| {
        let units = (0..units).map(unit).collect();
        RecordedScene::new("many", 1, Split::Test, 60.0, Vector3::zeros(), units)
            .unwrap()
            .with_planes(vec![Plane::ground(0.3, 0.5)])
            .unwrap()
    };
    let many = works(&["inspect", &saved(&folder, "many", &scene(1000))]);
    assert!(many.contains("1000  4 to 6 points each, 4999 together"), "{many}");
    assert!(many.lines().count() < 40, "{many}");
    let few = works(&["inspect", &saved(&folder, "few", &scene(24))]);
    assert!(few.contains("cell 23"), "{few}");
}

#[test]
fn check_refuses_what_cannot_be_compared() {
    let folder = Folder::new();
    let (float, i8) = (folder.path("model.rfm"), folder.path("i8.rfm"));
    works(&["pack", &float, "--dtype", "i8", "--out", &i8]);
    let nowhere = folder.path("nowhere");
    let with = |float: &str, quantised: &str, more: &[&str], code, expected: &[&str]| {
        let options = ["check", "--float", float, "--quantised", quantised, SCENE];
        fails(&[&options[..], more].concat(), code, expected);
    };
    with(&nowhere, &i8, &[], 1, &[&nowhere, "cannot be read"]);
    with(&float, &nowhere, &[], 1, &[&nowhere, "cannot be read"]);
    with(&float, &i8, &["--tolerances", &nowhere], 1, &[&nowhere, "cannot be read"]);
    with(&i8, &float, &[], 1, &[&i8, "is i8", "as the float model"]);
    with(&float, &i8, &["--steps", "26"], 2, &["--steps", "26 is not in 1..=25"]);
    with(&float, &i8, &["--split", "train"], 1, &[SCENE, "no scene is in the split train"]);
    let foul = folder.file("foul.json", b"{\"metric_change\": 0.1}");
    with(&float, &i8, &["--tolerances", &foul], 1, &[&foul, "missing field", "median_drift_m"]);

    // A model of another configuration.
    let other = folder.path("other.rfm");
    works(&["pack", &EXPORTED.replace("-paper-inputs", ""), "--out", &other]);
    with(&float, &other, &[], 1, &[&other, "configuration: ", "the float model has", "quantise"]);
    fails(&["check", "--float", &float, SCENE], 2, &["--quantised"]);
}

#[test]
fn traces_are_compared_bit_by_bit() {
    let folder = Folder::new();
    let (float, i8) = (folder.path("model.rfm"), folder.path("i8.rfm"));
    works(&["pack", &float, "--dtype", "i8", "--out", &i8]);
    let trace = |name: &str, model: &str, more: &[&str]| {
        let out = folder.path(name);
        works(&[&["trace", "--model", model, "--out", &out], more].concat());
        out
    };
    let a = trace("a", &float, &[]);
    let again = trace("again", &float, &[]);
    assert_eq!(std::fs::read(&a).unwrap(), std::fs::read(&again).unwrap());
    let printed = works(&["diff", &a, &again]);
    assert!(printed.contains("the same bits") && printed.contains("tokens 0"), "{printed}");

    let quantised = trace("quantised", &i8, &[]);
    let differ = run(&["diff", &a, &quantised, "--json"]);
    assert_eq!(differ.status.code(), Some(1));
    let stderr = text(&differ.stderr);
    let expected = "first at step 1, layer point_features, unit 0, point 0, element 0: ";
    assert!(stderr.contains(expected) && stderr.contains("(0x"), "{stderr}");
    let json: serde_json::Value = serde_json::from_slice(&differ.stdout).unwrap();
    assert_eq!(json["first"]["layer"], "point_features");
    assert!(json["layers"][1]["different"].as_u64().unwrap() > 0);

    let shorter = trace("shorter", &float, &["--steps", "2"]);
    fails(&["diff", &a, &shorter], 1, &["steps is 3", "and 2 in the second", "the same run"]);
    let finer = trace("finer", &float, &["--step", "5"]);
    fails(&["diff", &a, &finer], 1, &["step is 10", "and 5 in the second"]);
    let another = changed_scene(|header, payload| {
        let start = header["scene_seed"]["data_offsets"][0].as_u64().unwrap() as usize;
        payload[start..start + 8].copy_from_slice(&261_i64.to_le_bytes());
    });
    let another = trace("another", &float, &[&folder.file("another.safetensors", &another)]);
    fails(&["diff", &a, &another], 1, &["scene is primitives seed 260", "primitives seed 261"]);

    let nowhere = folder.path("nowhere");
    fails(&["diff", &a, &nowhere], 1, &[&nowhere, "cannot be read"]);
    fails(&["diff", &float, &a], 1, &[&float, "not a whole safetensors file", "rigidformer trace"]);
    fails(&["diff", SCENE, &a], 1, &[SCENE, "metadata format", "rigidformer-scenes"]);
    fails(&["trace", "--model", &float], 2, &["--out"]);
    fails(&["trace", "--model", &float, "--steps", "0", "--out", &nowhere], 2, &["--steps"]);
}

#[test]
fn wrong_usage_exits_with_2() {
    let folder = Folder::new();
    let model = folder.path("model.rfm");
    fails(&["rollout", "--step", "0"], 2, &["--step", "0 is not in 1.."]);
    fails(&["evaluate", SCENE, "--steps", "1,0"], 2, &["--steps", "0 is not in 1..=100"]);
    // Figures of what was observed would be no errors of the model's.
    fails(&["evaluate", SCENE, "--steps", "1,26"], 2, &["step code 26", "give 1 to 25"]);
    fails(
        &["evaluate", SCENE, "--split", "exam"],
        2,
        &["--split", "[possible values: train, validation, test, extra]"],
    );
    fails(&["pack", EXPORTED], 2, &["--out"]);
    fails(&["frobnicate"], 2, &["frobnicate"]);
    let much = ["rollout", "--model", &model, "--step", "20", "--frames", "39"];
    fails(&much, 2, &["--frames 39 with --step 20: nothing to predict", "smaller step"]);
    #[cfg(not(feature = "default-model"))]
    fails(&["rollout"], 2, &["--model", "without a default model"]);
}

#[test]
fn files_that_are_not_there_or_no_files() {
    let folder = Folder::new();
    let model = folder.path("model.rfm");
    let nowhere = folder.path("nowhere.safetensors");
    let out = folder.path("out");
    let remedy = "that exists and that you may read";
    fails(
        &["rollout", &nowhere, "--model", &model, "--out", &out],
        1,
        &[&nowhere, "cannot be read", "scene file"],
    );
    fails(&["evaluate", &nowhere, "--model", &model], 1, &[&nowhere, "cannot be read"]);
    fails(
        &["rollout", "--model", &nowhere, "--out", &out],
        1,
        &[&nowhere, "cannot be read", remedy],
    );
    fails(&["inspect", &nowhere], 1, &[&nowhere, remedy]);
    fails(&["pack", &nowhere, "--out", &out], 1, &[&nowhere, remedy]);

    let directory = folder.0.path().to_str().unwrap();
    fails(&["rollout", directory, "--model", &model, "--out", &out], 1, &[directory, "directory"]);
    fails(&["rollout", "--model", directory, "--out", &out], 1, &[directory, "directory"]);
    fails(&["inspect", directory], 1, &[directory, "directory"]);
    fails(&["pack", directory, "--out", &out], 1, &[directory, "directory"]);
    fails(
        &["pack", EXPORTED, "--out", directory],
        1,
        &[directory, "cannot be written", "name a file"],
    );
    let deep = folder.path("no/such/folder.rfm");
    fails(
        &["pack", EXPORTED, "--out", &deep],
        1,
        &[&deep, "cannot be written", "folder that exists"],
    );
    let in_file = folder.path("model.rfm/out");
    let into_a_file = program()
        .args(["rollout", "--model", &model, "--out", &in_file, "--frames", "20"])
        .output()
        .unwrap();
    assert_eq!(into_a_file.status.code(), Some(1));
    assert!(
        text(&into_a_file.stderr).contains("another folder with --out"),
        "{}",
        text(&into_a_file.stderr)
    );
    assert_eq!(folder.names(), ["model.rfm"], "failures leave nothing behind");
}

#[test]
fn damaged_and_foreign_files() {
    let folder = Folder::new();
    let model = folder.path("model.rfm");
    let (scene_bytes, model_bytes) =
        (std::fs::read(SCENE).unwrap(), std::fs::read(&model).unwrap());

    let empty = folder.file("empty", b"");
    fails(
        &["evaluate", &empty, "--model", &model],
        1,
        &[&empty, "it is empty", "give a scene file"],
    );
    fails(&["rollout", "--model", &empty], 1, &[&empty, "bytes", "cut off"]);
    fails(&["inspect", &empty], 1, &[&empty, "is empty"]);
    fails(
        &["pack", &empty, "--out", &folder.path("x")],
        1,
        &[&empty, "it is empty", "rigidformer_lab.export"],
    );

    let cut = folder.file("cut.safetensors", &scene_bytes[..scene_bytes.len() / 2]);
    fails(&["evaluate", &cut, "--model", &model], 1, &[&cut, "not a whole safetensors file"]);
    fails(&["inspect", &cut], 1, &[&cut, "not a whole safetensors file"]);
    let cut = folder.file("cut.rfm", &model_bytes[..model_bytes.len() - 1]);
    fails(&["rollout", "--model", &cut], 1, &[&cut, "cut off"]);
    fails(&["inspect", &cut], 1, &[&cut, "cut off"]);

    let foreign = folder.file("notes.txt", b"Dear diary, today I fell freely.");
    fails(
        &["evaluate", &foreign, "--model", &model],
        1,
        &[&foreign, "not a whole safetensors file"],
    );
    fails(&["rollout", "--model", &foreign], 1, &[&foreign, "not a RigidFormer model"]);
    fails(&["inspect", &foreign], 1, &[&foreign, "neither a packed model nor a scene file"]);

    // Each for the other.
    fails(&["evaluate", &model, "--model", &model], 1, &[&model, "not a whole safetensors file"]);
    fails(&["rollout", "--model", SCENE], 1, &[SCENE, "not a RigidFormer model"]);
    fails(
        &["rollout", EXPORTED, "--model", &model],
        1,
        &["metadata format", "rigidformer-model", "rigidformer-scenes"],
    );
    fails(
        &["pack", SCENE, "--out", &folder.path("x")],
        1,
        &[SCENE, "metadata format", "rigidformer-scenes"],
    );
}

#[test]
fn a_pose_that_is_not_a_number() {
    let folder = Folder::new();
    let model = folder.path("model.rfm");
    let foul = changed_scene(|header, payload| {
        let start = header["unit_poses"]["data_offsets"][0].as_u64().unwrap() as usize;
        let number = ((3 * 121) + 70) * 7 + 2; // unit 3, frame 70, z
        payload[start + number * 4..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    });
    let foul = folder.file("foul.safetensors", &foul);
    let expected = [
        foul.as_str(),
        "unit_poses",
        "seed 260",
        "unit 3 at frame 70",
        "not finite",
        "rigidformer_lab.movi",
    ];
    fails(&["rollout", &foul, "--model", &model], 1, &expected);
    fails(&["evaluate", &foul, "--model", &model], 1, &expected);
    fails(&["inspect", &foul], 1, &expected);
}

#[test]
fn scenes_and_frames_that_are_not_recorded() {
    let folder = Folder::new();
    let model = folder.path("model.rfm");
    let with = |more: &[&'static str]| [&["rollout", SCENE, "--model", &model], more].concat();
    fails(&with(&["--index", "1"]), 1, &[SCENE, "scene 1 of 1", "index below"]);
    fails(
        &with(&["--frames", "121"]),
        1,
        &[SCENE, "has 121 frames, 122 are needed", "fewer frames"],
    );
    fails(&with(&["--step", "61"]), 1, &[SCENE, "has 121 frames, 123 are needed"]);
    fails(&with(&["--step", "4294967295"]), 1, &[SCENE, "has 121 frames"]);
    fails(
        &["evaluate", SCENE, "--model", &model, "--split", "train"],
        1,
        &[SCENE, "no scene is in the split train"],
    );
}

#[test]
fn exports_that_are_incomplete() {
    let folder = Folder::new();
    let export = std::fs::read(EXPORTED).unwrap();
    let out = folder.path("out.rfm");
    let with = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let mut bytes = export.clone();
        let at =
            bytes.windows(from.len()).position(|window| window == from.as_bytes()).expect(from);
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        folder.file("export.safetensors", &bytes)
    };
    let path = with("\"anchors.head.1.bias\"", "\"anchors.head.1.bais\"");
    fails(&["pack", &path, "--out", &out], 1, &[&path, "anchors.head.1.bias", "missing"]);
    let path = with("\\\"width\\\": 32", "\\\"width\\\": 64");
    fails(&["pack", &path, "--out", &out], 1, &[&path, "tensor", "shape"]);
    let path = with("\\\"heads\\\"", "\\\"hoods\\\"");
    fails(&["pack", &path, "--out", &out], 1, &[&path, "metadata config", "hoods"]);
    assert!(!PathBuf::from(&out).exists());
}

/// Waits until a process has a handler for SIGINT, which would end it before.
#[cfg(unix)]
fn await_handler(process: u32) {
    use std::time::{Duration, Instant};

    // Elsewhere nothing tells.
    if !cfg!(target_os = "linux") {
        std::thread::sleep(Duration::from_millis(1500));
        return;
    }
    let path = format!("/proc/{process}/status");
    let start = Instant::now();
    loop {
        let status = std::fs::read_to_string(&path).unwrap();
        let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
        let caught = u64::from_str_radix(caught.trim(), 16).unwrap();
        // Signal 1 is bit 0.
        if caught & 1 << (rustix::process::Signal::INT.as_raw() - 1) != 0 {
            return;
        }
        assert!(start.elapsed() < Duration::from_secs(120), "no handler of SIGINT:\n{status}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn provenance_is_added_and_nothing_else_changes() {
    let folder = Folder::new();
    let entries = folder.file(
        "runs.toml",
        b"\"run 2\" = \"seeds 1-3600\"\n\"run 10\" = \"all\"\nlicence = \"none\"\n",
    );
    let inspected = |path: &str| -> serde_json::Value {
        serde_json::from_str(&works(&["inspect", path, "--json"])).unwrap()
    };
    let int8 = folder.path("int8.rfm");
    works(&["pack", &folder.path("model.rfm"), "--dtype", "i8", "--out", &int8]);
    for model in [folder.path("model.rfm"), int8, NANO.to_owned()] {
        let out = folder.path("more.rfm");
        let said = works(&["pack", &model, "--provenance", &entries, "--out", &out]);
        let (mut before, mut after) = (inspected(&model), inspected(&out));
        assert!(said.contains(after["payload_crc"].as_str().unwrap()), "{said}");
        assert_eq!(after["provenance"]["run 2"], "seeds 1-3600");
        assert_eq!(after["provenance"]["licence"], "none");
        assert_eq!(after["bytes"], std::fs::metadata(&out).unwrap().len());
        let shown = works(&["inspect", &out]);
        assert!(shown.find("run 2").unwrap() < shown.find("run 10").unwrap(), "the file's order");
        for file in [&mut before, &mut after] {
            let file = file.as_object_mut().unwrap();
            file.remove("bytes");
            file.remove("provenance");
        }
        assert_eq!(before, after, "the checksum of the tensors among all else");
        let payload = |path: &str| {
            let bytes = std::fs::read(path).unwrap();
            bytes[u64::from_le_bytes(bytes[16..24].try_into().unwrap()) as usize..].to_vec()
        };
        assert!(payload(&model) == payload(&out), "a tensor has changed");

        // Again, with the result in place: nothing is left to change.
        let first = std::fs::read(&out).unwrap();
        works(&["pack", &out, "--provenance", &entries, "--out", &out, "--json"]);
        assert!(std::fs::read(&out).unwrap() == first);
    }
}

#[test]
fn provenance_that_cannot_be_added() {
    let folder = Folder::new();
    let (model, out) = (folder.path("model.rfm"), folder.path("out.rfm"));
    let good = folder.file("good.toml", b"\"run 1\" = \"x\"");
    let refused = |model: &str, entries: &str, expected: &[&str]| {
        fails(&["pack", model, "--provenance", entries, "--out", &out], 1, expected);
    };
    refused(EXPORTED, &good, &[EXPORTED, "no packed model", "pack it first"]);
    refused(&model, &folder.path("none.toml"), &["none.toml", "cannot be read"]);
    let file = folder.file("bad.toml", b"run 1 = x");
    refused(&model, &file, &["bad.toml", "not a TOML file", "write lines such as"]);
    let file = folder.file("bad.toml", b"minutes = 5");
    refused(&model, &file, &["bad.toml", "minutes", "integer", "not a text"]);
    let file = folder.file("bad.toml", b"\xff");
    refused(&model, &file, &["bad.toml", "no UTF-8"]);
    let file = folder.file("bad.toml", b"");
    refused(&model, &file, &["bad.toml", "no entries"]);
    let file = folder.file("bad.toml", b"\"run 1\" = \"a\\u0007b\"");
    refused(&model, &file, &[&model, "provenance value"]);
    assert!(!Path::new(&out).exists());
    let both = ["pack", &model, "--provenance", &good, "--dtype", "i8", "--out", &out];
    fails(&both, 2, &["--provenance", "--dtype"]);
}

#[test]
#[cfg(unix)]
fn ctrl_c_leaves_nothing_and_exits_with_130() {
    let folder = Folder::new();
    let (model, scene, out) =
        (folder.path("model.rfm"), folder.path("crowd.safetensors"), folder.path("out"));
    let point = |i: usize| {
        Point3::new((i % 5) as f32 * 0.1, (i / 5 % 5) as f32 * 0.1, (i / 25) as f32 * 0.1)
    };
    let unit = |k: usize| {
        let physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
        let poses = vec![Isometry3::translation((k % 8) as f32, (k / 8) as f32, 1000.0); 4000];
        RecordedUnit::new("grid", (0..125).map(point).collect(), physics, poses)
    };
    let gravity = Vector3::new(0.0, 0.0, -10.0);
    let crowd =
        RecordedScene::new("crowd", 1, Split::Test, 240.0, gravity, (0..64).map(unit).collect())
            .unwrap()
            .with_planes(vec![Plane::ground(0.3, 0.5)])
            .unwrap();
    let notes =
        SceneNotes { dataset: "crowd".into(), provenance: "a test".into(), licence: "none".into() };
    write_scene(scene.as_ref(), &crowd, &notes).unwrap();

    let mut command = program();
    command.args([
        "rollout", &scene, "--model", &model, "--out", &out, "--step", "1", "--frames", "3999",
    ]);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    await_handler(child.id());
    rustix::process::kill_process(
        rustix::process::Pid::from_child(&child),
        rustix::process::Signal::INT,
    )
    .unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("interrupted"));
    assert_eq!(folder.names(), ["crowd.safetensors", "model.rfm"]);
}

#[test]
#[cfg(unix)]
fn a_reader_that_leaves_is_no_failure() {
    let folder = Folder::new();
    let mut child = program()
        .args(["inspect", &folder.path("model.rfm")])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
}

/// A U of three boxes: one group each, or one closed mesh whose faces between boxes are there too.
fn u_shape(groups: bool) -> String {
    let mut mesh = String::new();
    let boxes = [[0.0, 0.0, 3.0, 1.0], [0.0, 1.0, 1.0, 3.0], [2.0, 1.0, 3.0, 3.0]];
    for (number, [x, z, to_x, to_z]) in boxes.into_iter().enumerate() {
        if groups {
            mesh += &format!("o part_{number}\n");
        }
        for k in 0..8 {
            let (x, y) = (if k & 1 == 0 { x } else { to_x }, if k & 2 == 0 { 0 } else { 1 });
            mesh += &format!("v {x} {y} {}\n", if k & 4 == 0 { z } else { to_z });
        }
        for face in
            [[1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [3, 7, 8, 4], [1, 5, 7, 3], [2, 4, 8, 6]]
        {
            let [a, b, c, d] = face.map(|corner: usize| corner + 8 * number);
            mesh += &format!("f {a} {b} {c} {d}\n");
        }
    }
    mesh
}

#[test]
fn pieces_of_a_mesh_leave_its_hollow_free() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (groups, whole) = (path("groups.obj"), path("whole.obj"));
    std::fs::write(&groups, u_shape(true)).unwrap();
    std::fs::write(&whole, u_shape(false)).unwrap();
    let found: serde_json::Value = serde_json::from_str(&works(&["pieces", &groups])).unwrap();
    let pieces = found["pieces"].as_array().unwrap();
    assert_eq!(pieces.len(), 3);
    assert!(pieces.iter().all(|piece| piece.as_array().unwrap().len() == 8));
    // V-HACD finds the walls, and nothing of the room between them.
    let found: serde_json::Value =
        serde_json::from_str(&works(&["pieces", &whole, "--split", "vhacd", "--scale", "0.1"]))
            .unwrap();
    let pieces = found["pieces"].as_array().unwrap();
    assert!((2..=8).contains(&pieces.len()), "{found}");
    let mut walls = [false; 2];
    for piece in pieces {
        let points = piece.as_array().unwrap().iter().map(|point| {
            let [x, _, z] = [0, 1, 2].map(|axis| point[axis].as_f64().unwrap());
            (x, z)
        });
        let above: Vec<_> = points.filter(|(_, z)| *z > 0.13).collect();
        let left = above.iter().all(|(x, _)| *x < 0.12);
        assert!(left || above.iter().all(|(x, _)| *x > 0.18), "{piece}");
        walls[usize::from(left)] |= !above.is_empty();
    }
    assert_eq!(walls, [true; 2], "both walls are there: {found}");
    let rust = path("u.rs");
    assert_eq!(works(&["pieces", &groups, "--format", "rust", "--most", "1", "--out", &rust]), "");
    let written = std::fs::read_to_string(rust).unwrap();
    assert!(written.contains("pub const COUNTS: [u16; 1] = [8];"), "{written}");
    let c = works(&["pieces", &groups, "--format", "c", "--points", "4"]);
    assert!(c.contains("static const uint16_t piece_counts[3] = {4, 4, 4};"), "{c}");
}

#[test]
fn groups_without_volume_are_no_pieces() {
    let folder = TempDir::new().unwrap();
    let mesh = folder.path().join("mesh.obj").display().to_string();
    let flat = "o decal\nv 0 0 9\nv 1 0 9\nv 0 1 9\nf -3 -2 -1\n";
    std::fs::write(&mesh, u_shape(true) + flat).unwrap();
    let output = run(&["pieces", &mesh]);
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let pieces = found["pieces"].as_array().unwrap();
    assert!(pieces.len() == 3 && pieces.iter().all(|piece| piece.as_array().unwrap().len() == 8));
    let note = text(&output.stderr);
    assert!(note.contains("1 of 4 groups lie in one plane"), "{note}");
    std::fs::write(&mesh, flat).unwrap();
    fails(&["pieces", &mesh, "--split", "groups"], 1, &["one plane"]);
}

/// Twice the same, byte by byte.
#[test]
fn pieces_by_vhacd_are_the_same_every_time() {
    let folder = TempDir::new().unwrap();
    let mesh = folder.path().join("mesh.obj").display().to_string();
    std::fs::write(&mesh, u_shape(false)).unwrap();
    let find = || works(&["pieces", &mesh, "--split", "vhacd", "--most", "3"]);
    assert_eq!(find(), find());
}

#[test]
fn what_is_no_mesh_has_no_pieces() {
    let folder = TempDir::new().unwrap();
    let mesh = folder.path().join("mesh.obj").display().to_string();
    fails(&["pieces", &mesh], 1, &["mesh.obj", "give the path of a file"]);
    for (text, expected) in [
        ("hello", "has no faces"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "one plane"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "no Wavefront OBJ"),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 2 3 4\n", "not finite"),
        ("v 0 0 x\n", "no Wavefront OBJ"),
    ] {
        std::fs::write(&mesh, text).unwrap();
        fails(&["pieces", &mesh], 1, &["mesh.obj", expected]);
    }
    for odd in [["--most", "0"], ["--most", "33"], ["--points", "3"], ["--scale", "0"]] {
        fails(&["pieces", &mesh, odd[0], odd[1]], 2, &[odd[0]]);
    }
}

/// Corners of a cube of .1 m at `x`, and what makes lines of its six sides: the first corner's number is given.
fn cube_obj(x: f32, first: usize, side: impl Fn(usize, [usize; 4]) -> String) -> String {
    let corners = (0..8).map(|k| {
        let bit = |bit: usize| if k & bit == 0 { 0.0 } else { 0.1 };
        format!("v {} {} {}\n", x + bit(4), bit(2), bit(1))
    });
    let quads =
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let sides = quads.iter().enumerate().map(|(at, quad)| side(at, quad.map(|k| k + first)));
    corners.collect::<String>() + &sides.collect::<String>()
}

/// A U of one closed mesh, .3 m wide, moved along x; the first corner's number is given.
fn hollow_u(x: f32, first: usize) -> String {
    let outline = [
        [0.0, 0.0],
        [0.3, 0.0],
        [0.3, 0.3],
        [0.2, 0.3],
        [0.2, 0.05],
        [0.1, 0.05],
        [0.1, 0.3],
        [0.0, 0.3],
    ];
    let mut mesh = String::new();
    for z in [0.0, 0.1] {
        mesh.extend(outline.iter().map(|[a, b]| format!("v {} {b} {z}\n", a + x)));
    }
    let sides = (0..8).map(|k| [k, (k + 1) % 8, (k + 1) % 8 + 8, k + 8]);
    mesh.extend(
        sides.map(|side| format!("f {}\n", side.map(|k| (k + first).to_string()).join(" "))),
    );
    for [a, b, c] in [[0, 1, 4], [0, 4, 5], [0, 5, 6], [0, 6, 7], [1, 2, 3], [1, 3, 4]] {
        let [a, b, c] = [a, b, c].map(|k| k + first);
        mesh += &format!("f {c} {b} {a}\nf {} {} {}\n", a + 8, b + 8, c + 8);
    }
    mesh
}

fn pieces_of(
    name: &str,
    mesh_text: impl AsRef<[u8]>,
    more: &[&str],
) -> (serde_json::Value, String) {
    let folder = TempDir::new().unwrap();
    let mesh = folder.path().join(name).display().to_string();
    std::fs::write(&mesh, mesh_text).unwrap();
    let output = run(&[&["pieces", &mesh], more].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    (serde_json::from_slice(&output.stdout).unwrap(), text(&output.stderr))
}

/// Volume of the hulls of pieces.
fn volume_m3(found: &serde_json::Value) -> f64 {
    let pieces = found["pieces"].as_array().unwrap().iter().map(|piece| {
        let points = piece.as_array().unwrap().iter();
        let point = |point: &serde_json::Value| {
            Point3::from([0, 1, 2].map(|axis| point[axis].as_f64().unwrap() as f32))
        };
        points.map(point).collect::<Vec<_>>()
    });
    pieces.collect::<ConvexPieces>().volume_m3()
}

#[test]
fn sides_that_are_groups_are_one_body() {
    let sides = cube_obj(0.0, 1, |at, [a, b, c, d]| format!("g side{at}\nf {a} {b} {c} {d}\n"));
    let split = sides.replace("g side3", "o lid");
    let beside =
        sides.clone() + &cube_obj(0.5, 9, |_, [a, b, c, d]| format!("g more\nf {a} {b} {c} {d}\n"));
    for (text, bodies) in [(sides, 1), (split, 1), (beside, 2)] {
        let (found, note) = pieces_of("cube.obj", text, &[]);
        assert_eq!(found["pieces"].as_array().unwrap().len(), bodies, "{note}");
        assert!((volume_m3(&found) - 1e-3 * bodies as f64).abs() < 1e-6, "{found}");
        assert_eq!(found["closed"], true);
        assert!(note.contains("groups are not all closed and convex"), "{note}");
    }
}

#[test]
fn hollow_groups_are_split_each() {
    let two = format!("o left\n{}o right\n{}", hollow_u(0.0, 1), hollow_u(0.5, 17));
    let (one, note) = pieces_of("one.obj", hollow_u(0.0, 1), &[]);
    assert!((volume_m3(&one) - 0.0065).abs() < 0.0008, "{} {note}", volume_m3(&one));
    let apart = format!("{}{}", hollow_u(0.0, 1), hollow_u(0.5, 17));
    let with_cube = format!(
        "o u\n{}o cube\n{}",
        hollow_u(0.0, 1),
        cube_obj(0.5, 17, |_, [a, b, c, d]| format!("f {a} {b} {c} {d}\n"))
    );
    for (text, volume) in [(two, 0.013), (apart, 0.013), (with_cube, 0.0075)] {
        let (found, note) = pieces_of("two.obj", text, &[]);
        assert!((volume_m3(&found) / volume - 1.0).abs() < 0.12, "{} {note}", volume_m3(&found));
        let whole = found["volume_m3"].as_f64().unwrap();
        assert!((whole / volume - 1.0).abs() < 1e-4, "{whole}");
    }
    let two = format!("o left\n{}o right\n{}", hollow_u(0.0, 1), hollow_u(0.5, 17));
    let (found, note) = pieces_of("two.obj", two, &["--split", "groups"]);
    assert!(volume_m3(&found) > 0.017 && note.contains("2 of 2 groups are not"), "{note}");
}

#[test]
fn stl_has_pieces_and_a_doubt_about_its_unit() {
    let corner = |k: u32| [4, 2, 1].map(|bit| if k & bit == 0 { "0" } else { "100" });
    let quads =
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let faces = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).map(|face| {
        let corners = face.map(|k| format!("vertex {}\n", corner(k).join(" "))).concat();
        format!("facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n")
    });
    let text = format!("solid cube\n{}endsolid cube\n", faces.collect::<String>());
    let (_, note) = pieces_of("cube.stl", &text, &[]);
    assert!(note.contains("is 100 m long; is it in millimetres? --scale 0.001"), "{note}");
    let (found, note) = pieces_of("cube.STL", &text, &["--scale", "0.001"]);
    assert!(!note.contains("millimetres"), "{note}");
    assert!((found["volume_m3"].as_f64().unwrap() / 1e-3 - 1.0).abs() < 1e-5);
    assert!((found["centre_of_mass_m"][2].as_f64().unwrap() - 0.05).abs() < 1e-6);
    assert!(
        (found["inertia_m5"][1][1].as_f64().unwrap() / (1e-3 * 0.02 / 12.0) - 1.0).abs() < 1e-3
    );
    // Without its first face.
    let (from, to) = (text.find("facet").unwrap(), text.find("endfacet").unwrap() + 9);
    let open = text[..from].to_owned() + &text[to..];
    let (found, note) = pieces_of("open.stl", open, &["--scale", "1e-6"]);
    assert_eq!(found["closed"], false);
    assert!(note.contains("not closed"), "{note}");
}

/// An untrained model of a robot under a command of three numbers, as the lab exports it.
const CARRIED: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/tiny-carried.model.safetensors");

/// A file with a robot of two parts on a circle, recorded so many frames at 30 Hz.
fn robot(folder: &Folder, frames: u32) -> String {
    let corner = |i: i32| Point3::from([1, 2, 4].map(|bit| if i & bit == 0 { -0.1 } else { 0.1 }));
    let part = |name: &str, mass_kg: f32, height: f32| {
        let pose = |frame: u32| {
            let turn = Vector3::z() * (0.02 * frame as f32);
            Isometry3::new(Vector3::zeros(), turn) * Isometry3::translation(1.0, 0.0, height)
        };
        let physics = Physics { mass_kg, friction: 0.8, restitution: 0.0 };
        let points = (0..8).map(corner).collect();
        RecordedUnit::new(name, points, physics, (0..=frames).map(pose).collect()).with_body(0)
    };
    let units = vec![part("leg", 1.0, 0.3), part("trunk", 3.0, 0.8)];
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let scene = RecordedScene::new("robot", 5, Split::Test, 30.0, gravity, units)
        .unwrap()
        .with_planes(vec![Plane::ground(0.8, 0.0)])
        .unwrap()
        .with_commands(3, [0.6, 0.0, 0.6].repeat(frames as usize + 1))
        .unwrap();
    let path = folder.path("robot.safetensors");
    let notes =
        SceneNotes { dataset: "g1".into(), provenance: "a test".into(), licence: "none".into() };
    write_scene(Path::new(&path), &scene, &notes).unwrap();
    path
}

#[test]
fn robots_are_measured_beside_guesses() {
    let folder = Folder::new();
    let (path, model) = (robot(&folder, 120), folder.path("carried.rfm"));
    works(&["pack", CARRIED, "--out", &model]);
    let table = works(&["evaluate", &path, "--model", &model]);
    for part in ["1 scenes under command", "paper", "0.072 / 16.26", "constant velocity"] {
        assert!(table.contains(part), "no {part:?} in {table}");
    }
    let json = works(&["evaluate", &path, "--model", &model, "--steps", "10,20", "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let at = |row: &serde_json::Value, place: usize| row["figures"]["frames"][place].clone();
    let ours = &json["model"]["steps"];
    assert_eq!((&ours[0]["step"], &ours[1]["step"]), (&10.into(), &20.into()));
    assert_eq!(at(&ours[0], 12)["frame"], 120);
    let others = json["others"].as_array().unwrap();
    let carry = others.iter().find(|row| row["name"] == "rigid carry").unwrap();
    // The robot does go on like that.
    assert!(at(carry, 12)["position_m"].as_f64().unwrap() < 1e-4, "{carry}");
    assert_eq!(json["published"]["position_m"], 0.072);

    let drawn = ["evaluate", &path, "--model", &model, "--picture", "x.png"];
    fails(&drawn, 2, &["--picture draws no robots"]);
    let alone = ["evaluate", &path, "--model", &model, "--neighbours", &path];
    fails(&alone, 1, &[&path, "train"]);
    fails(&["evaluate", &path, "--model", &model, "--steps", "100"], 2, &["frame 200"]);
    fails(&["evaluate", &path, "--model", NANO, "--neighbours", "no"], 1, &["no"]);
    let bodies = toss(&folder, "tosses");
    fails(&["evaluate", &bodies, "--model", NANO, "--neighbours", &path], 2, &["--neighbours"]);
}

#[test]
fn a_robot_is_driven_by_a_command() {
    let folder = Folder::new();
    // Of the record frames 0 and 10 alone are read.
    let (path, model) = (robot(&folder, 10), folder.path("carried.rfm"));
    works(&["pack", CARRIED, "--out", &model]);
    let out = folder.path("walk");
    let drive = |command: &str, more: &[&str]| {
        let all = ["rollout", &path, "--model", &model, "--command", command, "--out", &out];
        run(&[&all, more].concat())
    };
    let done = drive("0.5,-0.1,0.3", &["--frames", "60"]);
    assert!(done.status.success(), "{}", text(&done.stderr));
    let (shown, notes) = (text(&done.stdout), text(&done.stderr));
    assert!(shown.contains("command 0.5, -0.1, 0.3 from frame 10 on"), "{shown}");
    assert!(shown.contains("m/s forward") && notes.is_empty(), "{shown}{notes}");
    let poses = std::fs::read_to_string(format!("{out}/poses.csv")).unwrap();
    // Seven frames of two parts under a header.
    assert_eq!(poses.lines().count(), 15);
    assert!(png_size(&format!("{out}/walk.png")).0 > 6 * 400);

    let refused = |arguments: &[&str], code, expected: &[&str]| fails(arguments, code, expected);
    let with = |command: &'static str| {
        ["rollout", path.as_str(), "--model", model.as_str(), "--command", command]
    };
    refused(&with("0.5,0"), 2, &["--command has 2 numbers", "takes 3"]);
    refused(&with("0.5,0,nan"), 2, &["--command", "NaN"]);
    refused(&with("0.5,0,fast"), 2, &["--command", "fast"]);
    refused(
        &["rollout", &path, "--model", NANO, "--command", "1"],
        2,
        &["--command", "takes none"],
    );
    refused(
        &[&with("0,0,0")[..], &["--frames", "19"]].concat(),
        2,
        &["--frames 19 with --step 10", "frame 20"],
    );
}

/// A slab of friction .6 slides on a plane of .5 to a stop, as Coulomb has it; its physics in the file are guesses.
fn sliding(folder: &Folder, name: &str) -> String {
    let half = [0.05, 0.04, 0.02];
    let corner = |i: usize, axis: usize| if i >> axis & 1 == 0 { -half[axis] } else { half[axis] };
    let points: Vec<_> =
        (0..8).map(|i| Point3::new(corner(i, 0), corner(i, 1), corner(i, 2))).collect();
    let slows = 0.3 * 9.81_f32;
    let pose = |frame: u32| {
        let t = (frame as f32 / 120.0).min(1.5 / slows);
        Isometry3::translation(1.5 * t - 0.5 * slows * t * t, 0.0, 0.02)
    };
    let guess = Physics { mass_kg: 0.5, friction: 0.9, restitution: 0.5 };
    let unit = RecordedUnit::new("slab", points, guess, (0..60).map(pose).collect());
    let scene = RecordedScene::new(
        "slide",
        1,
        Split::Test,
        120.0,
        Vector3::new(0.0, 0.0, -9.81),
        vec![unit],
    )
    .unwrap()
    .with_planes(vec![Plane::ground(0.5, 0.5)])
    .unwrap();
    let notes = SceneNotes {
        dataset: "slides".into(),
        provenance: "made by a test".into(),
        licence: "none".into(),
    };
    let path = folder.path(name);
    write_scene(Path::new(&path), &scene, &notes).unwrap();
    path
}

#[test]
fn identify_finds_the_friction_of_a_slide() {
    let folder = Folder::new();
    let scene = sliding(&folder, "slide.safetensors");
    let out = folder.path("identified.safetensors");
    let arguments =
        ["identify", &scene, "--model", NANO, "--particles", "16", "--json", "--out", &out];
    let found: serde_json::Value = serde_json::from_str(&works(&arguments)).unwrap();
    let unit = &found["results"][0]["units"][0];
    let friction = &unit["friction"];
    assert_eq!(friction["seen"], "between", "{found}");
    let bounds = ["low", "high"].map(|bound| friction[bound].as_f64().unwrap());
    assert!(bounds[0] < 0.3 && 0.3 < bounds[1] && bounds[1] - bounds[0] < 0.1, "{found}");
    let own = unit["own_friction"]["middle"].as_f64().unwrap();
    let written = Dataset::open(Path::new(&out)).unwrap().scene(0, None).unwrap();
    let before = Dataset::open(Path::new(&scene)).unwrap().scene(0, None).unwrap();
    let physics = written.units()[0].physics;
    assert!((f64::from(physics.friction) - own).abs() < 1e-6);
    assert_eq!(physics.mass_kg, 0.5);
    assert_eq!(written.units()[0].poses, before.units()[0].poses);
    assert_eq!(works(&arguments), works(&arguments), "the same seed, the same intervals");
    let table = works(&["identify", &scene, "--model", NANO, "--particles", "16"]);
    assert!(table.contains("restitution") && table.contains("0 slab"), "{table}");
}

#[test]
fn identify_says_what_is_wrong() {
    let folder = Folder::new();
    let scene = sliding(&folder, "slide.safetensors");
    let fails_with = |arguments: &[&str], code: i32, expected: &[&str]| {
        let all: Vec<&str> = ["identify", &scene, "--model", NANO]
            .into_iter()
            .chain(arguments.iter().copied())
            .collect();
        fails(&all, code, expected);
    };
    fails_with(&["--index", "3"], 2, &["--index 3", "1 scenes"]);
    fails_with(&["--split", "train"], 1, &["no scene is in the split train"]);
    fails_with(&["--index", "0", "--same-body"], 2, &["cannot be used with"]);
    fails_with(&["--noise-mm", "1"], 2, &["--noise-mrad"]);
    fails_with(&["--particles", "3"], 2, &["16..=4096"]);
    fails_with(&["--most", "1"], 2, &["--most"]);
    fails(&["identify", TINY_SOFT, "--model", NANO], 1, &["soft units"]);
    fails(&["identify", NANO, "--model", NANO], 1, &["nano.rfm", "safetensors"]);
}

/// A cube that falls and meets nothing, as a training scene.
fn falling(folder: &Folder, name: &str, split: Split) -> String {
    let corner = |i: i32| Point3::from([1, 2, 4].map(|bit| if i & bit == 0 { -0.5 } else { 0.5 }));
    let pose = |frame: u32| {
        let t = frame as f32 / 240.0;
        Isometry3::translation(t, 0.0, 5.0 - 5.0 * t * t)
    };
    let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
    let points = (0..8).map(corner).collect();
    let unit = RecordedUnit::new("cube", points, physics, (0..=110).map(pose).collect());
    let gravity = Vector3::new(0.0, 0.0, -10.0);
    let scene = RecordedScene::new("fall", 7, split, 240.0, gravity, vec![unit])
        .unwrap()
        .with_planes(vec![Plane::ground(0.3, 0.5)])
        .unwrap();
    let notes =
        SceneNotes { dataset: "fall".into(), provenance: "a test".into(), licence: "none".into() };
    let path = folder.path(name);
    write_scene(Path::new(&path), &scene, &notes).unwrap();
    path
}

#[test]
fn a_model_learns_what_its_training_saw_and_tells_what_is_unlike_it() {
    let folder = Folder::new();
    let scene = falling(&folder, "train.safetensors", Split::Extra);
    let (ranged, other) = (folder.path("ranged.rfm"), folder.path("other.rfm"));
    let said = works(&["pack", NANO, "--ranges", &scene, "--out", &ranged]);
    assert!(said.contains("friction") && said.contains("weights CRC-32"), "{said}");
    works(&["pack", NANO, "--ranges", &ranged, "--out", &other]);
    assert_eq!(std::fs::read(&ranged).unwrap(), std::fs::read(&other).unwrap());
    let inspect: serde_json::Value =
        serde_json::from_str(&works(&["inspect", "--json", &ranged])).unwrap();
    let plain: serde_json::Value =
        serde_json::from_str(&works(&["inspect", "--json", NANO])).unwrap();
    assert_eq!(inspect["payload_crc"], plain["payload_crc"]);
    assert_eq!(
        (plain["ranges"].is_null(), inspect["ranges"].as_object().unwrap().len()),
        (true, 14)
    );
    assert!(works(&["inspect", &ranged]).contains("ranges that training saw"));

    let health = |model: &str, scene: &str, split: &str| {
        let arguments =
            ["inspect", scene, "--health", "--split", split, "--model", model, "--json"];
        let found: serde_json::Value = serde_json::from_str(&works(&arguments)).unwrap();
        (found["recorded"]["looks"].clone(), found["recorded"]["outside"].clone())
    };
    assert_eq!(health(&ranged, &scene, "extra"), (10.into(), 0.into()));
    let (looks, outside) = health(&ranged, SCENE, "test");
    assert!(looks.as_u64() > Some(0) && outside == looks, "spheres are no cube");

    let test = falling(&folder, "test.safetensors", Split::Test);
    let out = folder.path("none.rfm");
    fails(&["pack", NANO, "--ranges", &test, "--out", &out], 1, &["splits train and extra"]);
    fails(&["pack", NANO, "--ranges", NANO, "--out", &out], 1, &["does not say"]);
    fails(&["pack", NANO, "--ranges", &ranged, &scene, "--out", &out], 1, &["give it alone"]);
    fails(&["pack", EXPORTED, "--ranges", &scene, "--out", &out], 1, &["no packed model"]);
    fails(
        &["inspect", &test, "--health", "--model", NANO],
        1,
        &["does not say what its training saw"],
    );
    fails(&["inspect", NANO, "--split", "train"], 2, &["--health"]);
    fails(&["inspect", NANO, "--model", NANO], 2, &["--model goes with --health"]);
    assert!(!Path::new(&out).exists());
}

/// As [`sliding`], with the velocity that it begins with.
fn pushed(folder: &Folder, name: &str) -> String {
    let path = sliding(folder, name);
    let scene = Dataset::open(Path::new(&path)).unwrap().scene(0, None).unwrap();
    let linear_m_s = Vector3::new(1.5, 0.0, 0.0);
    let unit =
        scene.units()[0].clone().with_velocity(Velocity { linear_m_s, ..Velocity::default() });
    let gravity = scene.gravity_m_s2();
    let scene = RecordedScene::new("push", 1, Split::Test, 120.0, gravity, vec![unit]).unwrap();
    let scene = scene.with_planes(vec![Plane::ground(0.5, 0.5)]).unwrap();
    let notes = SceneNotes {
        dataset: "pushes".into(),
        provenance: "made by a test".into(),
        licence: "none".into(),
    };
    write_scene(Path::new(&path), &scene, &notes).unwrap();
    path
}

#[test]
fn calibrate_finds_the_friction_of_a_slide() {
    let folder = Folder::new();
    let scene = pushed(&folder, "push.safetensors");
    let (out, state) = (folder.path("contact.toml"), folder.path("state"));
    let arguments = [
        "calibrate",
        &scene,
        "--model",
        NANO,
        "--without-network",
        "--fit",
        "friction",
        "--evaluations",
        "20",
        "--resume",
        &state,
        "--out",
        &out,
        "--json",
    ];
    let printed = works(&arguments);
    let found: serde_json::Value = serde_json::from_str(&printed).unwrap();
    let number = &found["numbers"][0];
    assert_eq!(
        (number["name"].as_str(), &number["interval"]),
        (Some("friction"), &serde_json::Value::Null)
    );
    assert!((number["in_file"].as_f64().unwrap() - 0.45).abs() < 1e-6, "{printed}");
    assert!((number["fitted"].as_f64().unwrap() - 0.3).abs() < 0.02, "{printed}");
    let share = &found["shares"][0]["predictors"][0];
    assert_eq!(
        (&found["model"], &share["predictor"]),
        (&"impulses alone".into(), &"impulses alone".into())
    );
    let degrees = |of: &str| share[of]["position_percent"].as_f64().unwrap();
    assert!(degrees("fitted") < 0.2 * degrees("in_file"), "{printed}");

    // What is known is not computed again, and half of it leads to the same end.
    let (text, whole) = (std::fs::read(&out).unwrap(), std::fs::read_to_string(&state).unwrap());
    assert_eq!(works(&arguments), printed);
    let half: Vec<&str> = whole.lines().take(6).collect();
    std::fs::write(&state, half.join("\n")).unwrap();
    assert_eq!(works(&arguments), printed);
    assert_eq!(
        (std::fs::read(&out).unwrap(), std::fs::read_to_string(&state).unwrap()),
        (text, whole)
    );

    let row = |more: &[&str]| {
        let all =
            ["evaluate", &scene, "--model", NANO, "--without-network", "--steps", "2", "--json"];
        let said = works(&[&all[..], more].concat());
        let said: serde_json::Value = serde_json::from_str(&said).unwrap();
        assert_eq!(said["model"]["name"], "impulses alone");
        said["model"]["steps"][0]["position_m"].as_f64().unwrap()
    };
    let fitted = row(&["--contact", &out]);
    assert_eq!(fitted, share["fitted"]["position_m"].as_f64().unwrap());
    assert_eq!(row(&[]), share["in_file"]["position_m"].as_f64().unwrap());
    // Beside a model, impulses alone are measured too.
    let table = works(&[
        "calibrate",
        &scene,
        "--model",
        NANO,
        "--fit",
        "friction",
        "--evaluations",
        "4",
        "--starts",
        "1",
    ]);
    assert!(table.contains("nano") && table.contains("impulses alone"), "{table}");
    let rolled = folder.path("rolled");
    works(&["rollout", &scene, "--model", NANO, "--contact", &out, "--out", &rolled]);
    works(&["identify", &scene, "--model", NANO, "--contact", &out, "--particles", "16"]);
}

#[test]
fn calibrate_says_what_is_wrong() {
    let folder = Folder::new();
    let scene = pushed(&folder, "push.safetensors");
    let fails_with = |arguments: &[&str], code: i32, expected: &[&str]| {
        fails(&[&["calibrate", &scene, "--model", NANO], arguments].concat(), code, expected);
    };
    fails_with(
        &["--fit", "stickiness"],
        2,
        &["--fit stickiness", "friction, restitution, stiffness, gravity, height, tilt, inertia"],
    );
    fails_with(&["--train", "2"], 2, &["--train 2", "has 1 scenes"]);
    fails_with(&["--validation", "0.9"], 2, &["--validation 0.9", "smaller share"]);
    fails_with(&["--validation", "1"], 2, &["not from 0 to 0.9"]);
    fails_with(&["--split", "train"], 1, &["no scene is in the split train"]);
    fails_with(&["--weights", "1"], 2, &["--weights: give two numbers"]);
    fails_with(&["--weights", "0,0"], 2, &["--weights: both are 0"]);
    fails_with(&["--weights", "1,-1"], 2, &["not from 0 to 1e6"]);
    fails_with(&["--out", &scene], 2, &["is what this command reads"]);
    fails_with(&["--out", "x.toml", "--resume", "x.toml"], 2, &["two options name this file"]);
    let state = folder.file("state", b"friction = 0.2");
    fails_with(&["--resume", &state], 1, &[&state, "is not the state of a calibration"]);
    let state = folder.file("state", b"rigidformer-calibration 1 0000000000000007\n");
    fails_with(&["--resume", &state], 1, &[&state, "other options"]);
    fails(&["calibrate", TINY_SOFT, "--model", NANO], 1, &["soft units"]);
    fails(&["calibrate", NANO, "--model", NANO], 1, &["nano.rfm", "safetensors"]);
    fails(
        &["calibrate", &scene, "--model", SHELL, "--without-network"],
        2,
        &["--without-network", "impulses"],
    );

    let evaluate = |text: &[u8], expected: &[&str]| {
        let path = folder.file("contact.toml", text);
        let all = ["evaluate", &scene, "--model", NANO, "--steps", "2", "--contact", &path];
        fails(&all, 1, &[&[path.as_str()], expected].concat());
    };
    let head = "format = 'rigidformer-contact'\nversion = 1\n";
    evaluate(
        format!("{head}frictoin = 0.2").as_bytes(),
        &["line 3", "frictoin", "no number of contact", "friction"],
    );
    evaluate(format!("{head}friction = -1").as_bytes(), &["line 3", "from 0.005 to 2"]);
    evaluate(b"friction = 0.2", &["format", "missing"]);
    evaluate(b"\xff\xfe", &["UTF-8"]);
    evaluate(b"[[[[", &["line 1", "calibrate"]);
    let none = folder.path("none.toml");
    fails(
        &["evaluate", &scene, "--model", NANO, "--contact", &none],
        1,
        &["none.toml", "cannot be read"],
    );
}

#[test]
#[cfg(unix)]
fn ctrl_c_keeps_what_was_computed() {
    let folder = Folder::new();
    let scene = pushed(&folder, "push.safetensors");
    let (out, state) = (folder.path("contact.toml"), folder.path("state"));
    let child = program()
        .args(["calibrate", &scene, "--model", NANO, "--evaluations", "100000", "--starts", "16"])
        .args(["--weights", "1000000,0", "--resume", &state, "--out", &out])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    await_handler(child.id());
    let process = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
    let output = child.wait_with_output().unwrap();
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(!Path::new(&out).exists());
    // It may have been stopped while it still read.
    let kept = Path::new(&state).exists();
    assert_eq!(kept, said.contains("the same command goes on"), "{said}");
    assert_eq!(kept, !said.contains("nothing was written"), "{said}");
}

#[test]
fn a_state_that_cannot_be_written_ends_no_search() {
    let folder = Folder::new();
    let scene = pushed(&folder, "push.safetensors");
    let (out, state) = (folder.path("contact.toml"), folder.path("states/state"));
    let arguments = [
        "calibrate",
        &scene,
        "--model",
        NANO,
        "--evaluations",
        "300",
        "--starts",
        "16",
        "--resume",
        &state,
        "--out",
        &out,
    ];
    // Before the search it is refused.
    fails(&arguments, 1, &[&state, "cannot be written"]);
    assert!(!Path::new(&out).exists());

    let states = folder.path("states");
    std::fs::create_dir(&states).unwrap();
    let child =
        program().args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let start = std::time::Instant::now();
    while !Path::new(&state).exists() {
        assert!(start.elapsed() < std::time::Duration::from_secs(120), "no state");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    // Moved away whole: what is just being written is not in the way.
    std::fs::rename(&states, folder.path("away")).unwrap();
    let output = child.wait_with_output().unwrap();
    let said = text(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("--resume") && said.contains("cannot be written"), "{said}");
    assert!(text(&output.stdout).contains("friction"));
    works(&["evaluate", &scene, "--model", NANO, "--steps", "2", "--contact", &out]);
}

/// The same weights under other physics are another model.
#[test]
fn a_state_is_of_one_configuration() {
    let folder = Folder::new();
    let scene = pushed(&folder, "push.safetensors");
    let nano = LoadedModel::copy_of("nano.rfm", &std::fs::read(NANO).unwrap()).unwrap();
    let config = *nano.model().config();
    let model = |name: &str, ground_friction: f32| {
        let config = ModelConfig { ground_friction, ..config };
        let packed = random::without_network(&config).unwrap().unwrap();
        (folder.file(name, &packed), LoadedModel::copy_of(name, &packed).unwrap())
    };
    let ((first, one), (second, other)) = (model("a.rfm", 0.3), model("b.rfm", 0.4));
    let crc = |model: &LoadedModel| model.model().file().payload_crc();
    assert_eq!(crc(&one), crc(&other));
    let state = folder.path("state");
    let fit = ["--fit", "friction", "--starts", "1", "--evaluations", "4", "--resume", &state];
    works(&[&["calibrate", &scene, "--model", &first], &fit[..]].concat());
    fails(
        &[&["calibrate", &scene, "--model", &second], &fit[..]].concat(),
        1,
        &[&state, "another model"],
    );
}
