//! The example `push` with worlds of a shell script: results, and for every fault of a world its text and exit code.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::examples::{Example, NANO};

const PUSH: Example = Example("push");

/// A script that is run instead of Python.
struct Script(TempDir);

impl Script {
    fn new(text: &str) -> Script {
        let script = Script(tempfile::tempdir().unwrap());
        script.file("python", &format!("#!/bin/sh\n{text}\n"));
        let all = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(script.path("python"), all).unwrap();
        script
    }

    /// Answers a trial's beginning with `reset`, and all else with `act`.
    fn world(reset: &Value, act: &str) -> Script {
        let text = "cd \"$(dirname \"$0\")\"\nwhile read -r line; do case \"$line\" in\n*reset*) cat reset;;\n*) ACT;;\nesac; done";
        let script = Script::new(&text.replace("ACT", act));
        script.file("reset", &format!("{reset}\n"));
        let seen = json!({"previous": reset["previous"], "current": reset["current"]});
        script.file("seen", &format!("{seen}\n"));
        script
    }

    fn file(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    fn python(&self) -> String {
        self.path("python")
    }
}

/// A cube that is to go 10 cm, and a stick beside it.
fn trial() -> Value {
    let corners = |half: f32| -> Vec<[f32; 3]> {
        let side = |i: usize, bit| if i & bit == 0 { -half } else { half };
        (0..8).map(|i| [side(i, 1), side(i, 2), side(i, 4)]).collect()
    };
    let unit = |half| json!({"points": corners(half), "mass_kg": 0.1, "friction": 0.5, "restitution": 0.0});
    let poses = json!({"cube": [0, 0, 0.025, 1, 0, 0, 0], "pusher": [0.1, 0, 0.025, 1, 0, 0, 0]});
    json!({
        "frame_s": 1.0 / 60.0, "gravity_m_s2": [0, 0, -9.81], "ground": [1, 0], "radius_m": 0.015, "edge_m": 0.05,
        "cube": unit(0.025), "pusher": unit(0.015), "goal": [-0.1, 0, 0], "previous": poses, "current": poses,
    })
}

#[test]
fn a_cube_that_does_not_move_is_pushed_until_the_time_is_over() {
    let script = Script::world(&trial(), "cat seen");
    let python = script.python();
    let few =
        ["--model", NANO, "--trials", "2", "--seconds", "1", "--seed", "4", "--python", &python];
    let output = PUSH.run(&[&few[..], &["--json"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&json["within_2cm"], &json["within_5cm"]), (&json!(0), &json!(0)));
    assert_eq!(
        (&json["trials"], &json["plans"], &json["planner"]),
        (&json!(2), &json!(6), &json!("model"))
    );
    assert!(json["plans_per_s"].as_f64().unwrap() > 0.0);
    assert_eq!(json["per_trial"][1]["seed"], 5);
    let html = script.path("push.html");
    let printed = PUSH.run(&[&few[..], &["--html", &html]].concat());
    let page = std::fs::read_to_string(&html).unwrap();
    assert!(page.contains("A push, seed 4") && page.contains("1 pusher"), "{page}");
    let printed = String::from_utf8(printed.stdout).unwrap();
    assert!(printed.contains("within 2 cm, .1 rad") && printed.contains("model ("), "{printed}");
}

#[test]
fn without_contact_nothing_is_pushed() {
    let mut near = trial();
    near["goal"] = json!([-0.03, 0, 0]);
    let script = Script::world(&near, "cat seen");
    let output =
        PUSH.run(&["--planner", "free", "--trials", "1", "--json", "--python", &script.python()]);
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&json["within_2cm"], &json["within_5cm"]), (&json!(0), &json!(1)));
    assert_eq!((&json["plans"], &json["model"]), (&json!(1), &Value::Null));
}

#[test]
fn wrong_usage() {
    for (option, value) in [
        ("--trials", "0"),
        ("--planner", "guess"),
        ("--futures", "0"),
        ("--iterations", "0"),
        ("--cycle-ms", "0"),
        ("--seconds", "nan"),
        ("--seed", "-1"),
    ] {
        PUSH.fails(&[&format!("{option}={value}")], 2, &[option]);
    }
    PUSH.fails(&["--model", "no.rfm"], 1, &["no.rfm"]);
}

#[test]
fn worlds_that_cannot_begin() {
    PUSH.fails(
        &["--planner", "free", "--python", "/no/such/python"],
        1,
        &["/no/such/python cannot be started", "tools/lab/setup.sh", "--python"],
    );
    let dies = |text: &str, expected: &[&str]| {
        let script = Script::new(text);
        PUSH.fails(&["--planner", "free", "--python", &script.python()], 1, expected);
    };
    dies(
        "echo \"error: No module named 'pybullet'\" >&2; exit 1",
        &["rigidformer_lab.push_world, ended", "No module named 'pybullet'", "tools/lab/setup.sh"],
    );
    dies("exit 3", &["ended, without a word"]);
    dies("read -r line; echo hello; sleep 5", &["`reset` with something else", "no JSON", "hello"]);
    dies("read -r line; echo '{}'; sleep 5", &["`reset` with something else", "no `"]);
    dies(
        "read -r line; echo '{\"error\": \"out of cubes\"}'; sleep 5",
        &["refused `reset`: out of cubes"],
    );
}

#[test]
fn worlds_that_end_or_talk_nonsense_in_a_trial() {
    let with = |act: &str, planner: &str, expected: &[&str]| {
        let script = Script::world(&trial(), act);
        PUSH.fails(
            &["--planner", planner, "--model", NANO, "--python", &script.python()],
            1,
            expected,
        );
    };
    with("echo 'ball lost' >&2; exit 1", "model", &["ended: ball lost"]);
    with("echo '{\"current\": 3}'", "model", &["`act` with something else", "no `previous`"]);
    with(
        "echo '{\"poses\": []}'",
        "engine",
        &["`rollout` with something else", "0 paths instead of"],
    );
    with("echo '[1'", "engine", &["`rollout` with something else", "no JSON"]);
    let mut nowhere = trial();
    nowhere["current"]["cube"] = json!([0, 0, 0, 0, 0, 0, 0]);
    let script = Script::world(&nowhere, "cat seen");
    PUSH.fails(&["--planner", "free", "--python", &script.python()], 1, &["quaternion is 0"]);
    nowhere["current"]["cube"] = json!([0, 0, null, 1, 0, 0, 0]);
    script.file("reset", &format!("{nowhere}\n"));
    PUSH.fails(&["--planner", "free", "--python", &script.python()], 1, &["is no number"]);
}

/// Files of a folder by their names.
fn lay(folder: &Path, files: &[(&str, &str)]) {
    for (name, text) in files {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(path, Permissions::from_mode(0o755)).unwrap();
    }
}

#[test]
fn nothing_of_the_current_folder_is_run() {
    let (here, named) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let ran = here.path().join("ran");
    // Each says that it was run.
    let module = format!("open({:?}, 'a').write(__name__ + ' ')\n", ran.to_str().unwrap());
    let program = format!("#!/bin/sh\necho \"$0\" >> {}\n", ran.display());
    let [module, program] = [module, program].map(|text| -> &'static str { text.leak() });
    lay(
        here.path(),
        &[
            ("rigidformer_lab/__init__.py", module),
            ("rigidformer_lab/push_world.py", module),
            ("numpy.py", module),
            ("json.py", module),
            ("runpy.py", module),
            ("site.py", module),
            ("sitecustomize.py", module),
            ("usercustomize.py", module),
            ("encodings/__init__.py", module),
            ("python", program),
            ("python3", program),
            ("tools/lab/.venv/bin/python", program),
            ("tools/lab/.venv/bin/python3", program),
        ],
    );
    lay(
        named.path(),
        &[
            ("rigidformer_lab/__init__.py", ""),
            (
                "rigidformer_lab/push_world.py",
                "import json, sys, typing\ntry:\n    import numpy\nexcept ImportError:\n    pass\nsys.exit('the named one')\n",
            ),
        ],
    );
    let run = |path: Option<&Path>| {
        let mut push = PUSH.command();
        push.args(["--planner", "free", "--trials", "1"]).current_dir(here.path());
        push.env_remove("PYTHONPATH").envs(path.map(|path| ("PYTHONPATH", path)));
        let output = push.output().unwrap();
        assert_eq!(std::fs::read_to_string(&ran).unwrap_or_default(), "", "something was run");
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stderr).unwrap()
    };
    let python = Command::new("python3").arg("--version").output();
    let of_nothing = run(None);
    let of_named = run(Some(named.path()));
    if python.is_ok() {
        assert!(of_nothing.contains("No module named 'rigidformer_lab'"), "{of_nothing}");
        assert!(of_named.contains("the named one"), "{of_named}");
        // Python alone would take the one of this folder.
        let mut alone = Command::new("python3");
        alone.args(["-m", "rigidformer_lab.push_world"]).env_remove("PYTHONSAFEPATH");
        alone.current_dir(here.path()).output().unwrap();
        assert!(ran.exists(), "the files of this test are no bait");
    }
}

/// Programs are started by this example alone; what is linked into users' programs starts none.
#[test]
fn nothing_else_starts_a_program() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folders = ["weights", "core", "kernels", "runtime-std", "perception", "evaluation"];
    let more = ["planning/src", "planning/examples/throw", "planning/examples/walk"];
    let mut folders: Vec<_> = folders.iter().map(|name| root.join(name).join("src")).collect();
    folders.extend(more.iter().map(|name| root.join(name)));
    folders.extend(
        ["bindings/c/src", "bindings/python/src", "tools/cli/src"].map(|name| root.join(name)),
    );
    let mut files = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|kind| kind == "rs") {
                let text = std::fs::read_to_string(&path).unwrap();
                let starts = ["process::Command", "libc::exec", "libc::system", "posix_spawn"];
                let starts = starts.iter().find(|word| text.contains(**word));
                assert_eq!(starts, None, "{}", path.display());
                files += 1;
            }
        }
    }
    assert!(files > 200, "{files} files");
}
