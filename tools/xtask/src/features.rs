//! Builds every combination of features that the documents offer.

use std::fs;
use std::process::Command;

use anyhow::{Context, Result};

use crate::embedded;
use crate::process::{cargo, line, run as run_command};
use crate::report::{Missing, Report};

/// A controller: what there is without an operating system.
const BARE: &str = "thumbv7em-none-eabihf";

/// The combinations of core and of the C library. `host` has all that the others have, so nothing goes beside it.
pub(crate) const OFFERED: [&str; 11] = [
    "",
    "robot",
    "deform",
    "health",
    "compliance",
    "terrain",
    "robot,deform",
    "robot,health",
    "deform,health",
    "robot,deform,health",
    "host",
];

/// Those of the model format's crate, models aside: `std` has what `host` has, and the writer.
pub(crate) const OFFERED_READERS: [&str; 6] =
    ["", "deform", "health", "deform,health", "host", "std"];

/// The program's manifest.
const PROGRAM: &str = "tools/cli/Cargo.toml";

/// Lints each combination for this machine and for a controller: code that a combination leaves unused is a fault too.
pub(crate) fn run(report: &mut Report) -> Result<()> {
    let packages = ["rigidformer-core", "rigidformer-capi"];
    for features in OFFERED_READERS {
        check(&["rigidformer-weights"], features, None)?;
    }
    for features in OFFERED {
        check(&packages, features, None)?;
    }
    // Libraries for Linux.
    for features in ["std", "threads", "tracker"] {
        check(&["rigidformer-capi"], features, None)?;
    }
    for features in OFFERED {
        // A static library without std does not build without a panic handler.
        let features = ["panic-handler", features].join(",");
        if let Some(missing) = check(&packages, features.trim_end_matches(','), Some(BARE))? {
            report.skip_part("combinations of features for a controller", missing);
            break;
        }
    }
    Ok(())
}

/// Lints the program with each of its features alone, beside the default ones.
pub(crate) fn run_program() -> Result<()> {
    for feature in of_program(&fs::read_to_string(PROGRAM)?)? {
        let mut command = cargo();
        command.args(["clippy", "--quiet", "--package", "rigidformer-cli", "--bins"]);
        command.args(["--features", &feature, "--", "--deny", "warnings"]);
        println!("{}", line(&command));
        run_command(&mut command)
            .with_context(|| format!("the program must build with `{feature}` alone"))?;
    }
    Ok(())
}

/// The names of features in a manifest.
fn declared(manifest: &str) -> Result<Vec<String>> {
    let manifest: toml::Table = manifest.parse()?;
    let table = manifest.get("features").and_then(|table| table.as_table());
    Ok(table.into_iter().flat_map(|table| table.keys().cloned()).collect())
}

/// The program's features but for those of the other lints: the default ones, and all.
fn of_program(manifest: &str) -> Result<Vec<String>> {
    let mut names = declared(manifest)?;
    names.retain(|name| !["default", "default-model", "full"].contains(&name.as_str()));
    Ok(names)
}

/// Why this machine cannot check it, if it cannot.
fn check(packages: &[&str], features: &str, target: Option<&str>) -> Result<Option<Missing>> {
    let mut command: Command = cargo();
    command.args(["clippy", "--quiet", "--lib"]);
    packages.iter().for_each(|package| {
        command.args(["--package", package]);
    });
    if !features.is_empty() {
        command.args(["--features", features]);
    }
    if let Some(target) = target {
        command.args(["--target", target]);
        if let Err(missing) = embedded::prepare(&mut command, target, false)? {
            return Ok(Some(missing));
        }
    }
    command.args(["--", "--deny", "warnings"]);
    println!("{}", line(&command));
    run_command(&mut command)
        .with_context(|| format!("these features must go together: `{features}`"))?;
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The features of a crate, by its manifest.
    fn features(folder: &str) -> Result<Vec<String>> {
        let path = format!("{}/../../{folder}/Cargo.toml", env!("CARGO_MANIFEST_DIR"));
        declared(&fs::read_to_string(path)?)
    }

    #[test]
    fn the_program_has_features_of_single_commands() -> Result<()> {
        let path = format!("{}/../../{PROGRAM}", env!("CARGO_MANIFEST_DIR"));
        let names = of_program(&fs::read_to_string(path)?)?;
        assert!(names.iter().any(|name| name == "import"), "{names:?}");
        assert!(!names.iter().any(|name| name.starts_with("default")), "{names:?}");
        Ok(())
    }

    #[test]
    fn every_feature_is_in_a_combination() -> Result<()> {
        let offered = |lists: &[&str], name: &str| {
            lists.iter().any(|list| list.split(',').any(|feature| feature == name))
        };
        assert!(features("core")?.iter().all(|name| offered(&OFFERED, name)));
        // The panic handler goes with every combination for a controller, and `std` is `host` with a panic handler.
        let of_c = ["default", "panic-handler", "std", "threads", "tracker"];
        let is_known = |name: &String| of_c.contains(&name.as_str()) || offered(&OFFERED, name);
        assert!(features("bindings/c")?.iter().all(is_known));
        // A model is a file; `shell` asks for `deform`, which is in a combination of its own.
        let models = ["default", "edge", "nano", "g1", "shell"];
        let is_known =
            |name: &String| models.contains(&name.as_str()) || offered(&OFFERED_READERS, name);
        assert!(features("weights")?.iter().all(is_known));
        Ok(())
    }
}
