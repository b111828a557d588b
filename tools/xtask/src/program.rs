//! README's first command, and the program that it builds: without the features that take long.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::SystemTime;

use anyhow::{Context, Result, ensure};

use crate::door;
use crate::process::{line, run as run_command, target};
use crate::readme;

/// Where the command writes, and what.
const FOLDER: &str = "rollout";
const WRITTEN: [&str; 3] = ["poses.csv", "errors.png", "strip.png"];

/// Command lines that need a feature, and the feature. None reads or writes a file.
const REFUSED: [(&[&str], &str); 9] = [
    (&["import", "poses.csv", "--out", "x.safetensors"], "import"),
    (&["pieces", "mesh.obj"], "pieces"),
    (&["identify", "scene.safetensors"], "identify"),
    (&["calibrate", "scene.safetensors"], "calibrate"),
    (&["rollout", "--contact", "x.toml", "--out", "x"], "calibrate"),
    (&["render", "--out", "x"], "sensors"),
    (&["track", "recording.mcap"], "sensors"),
    (&["rollout", "--html", "x.html", "--out", "x"], "viewers"),
    (&["pack", NANO, "--provenance", "x.toml", "--out", "x.rfm"], "provenance"),
];
const NANO: &str = "weights/models/nano.rfm";

/// Runs the command as README has it, and asks the program for what this build lacks.
pub(crate) fn run() -> Result<()> {
    let [first, _] = readme::commands()?;
    let mut words = readme::bare(&first).split(' ');
    let mut command = Command::new(words.next().context("README's first command is empty")?);
    let start = SystemTime::now();
    println!("{}", line(command.args(words)));
    run_command(&mut command)?;
    for name in WRITTEN {
        let path = Path::new(FOLDER).join(name);
        let about = fs::metadata(&path);
        let about = about.with_context(|| format!("the program left no {}", path.display()))?;
        // Some file systems count whole seconds.
        let age = start.duration_since(about.modified()?).unwrap_or_default();
        ensure!(about.len() > 0 && age.as_secs() < 2, "{} is of another run", path.display());
    }
    // Where a command that should refuse does more, it does so in a folder that goes.
    let folder = tempfile::tempdir().context("no temporary folder")?;
    let program = target().join("release/rigidformer").canonicalize();
    let program = program.context("README's first command built no program")?;
    let root = std::env::current_dir().context("no current folder")?;
    for (arguments, feature) in REFUSED {
        let mut command = Command::new(&program);
        for word in arguments {
            match *word {
                NANO => command.arg(root.join(NANO)),
                word => command.arg(word),
            };
        }
        command.current_dir(folder.path()).stdin(Stdio::null());
        let said = command.output().with_context(|| format!("cannot start {}", line(&command)))?;
        let text = String::from_utf8_lossy(&said.stderr);
        println!("{}: {}", line(&command), text.trim_end());
        ensure!(said.status.code() == Some(2), "`{}` ends with {}", line(&command), said.status);
        ensure!(
            text.contains(&format!("needs the feature `{feature}`")),
            "`{}` does not name the feature {feature}",
            line(&command)
        );
    }
    let left = fs::read_dir(folder.path())?.count();
    ensure!(left == 0, "what the program refused left {left} files");
    // The library's first sight.
    door::run()
}
