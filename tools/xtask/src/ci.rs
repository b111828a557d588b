//! All checks, one after another.

use std::env;
use std::process::Command;

use anyhow::Result;

use crate::report::{Allowed, Report};
use crate::{
    arrows, bits, capi, costs, counts, deny, docs, embedded, features, firmware, fuzz, header, integrations,
    lab, package, process, python, reproduce, sanitize, site,
};

/// Inputs: enough to show that the targets build and run; fuzz/README.md counts the long runs.
const FUZZ_EXECUTIONS: u64 = 45_000;

/// README's second command.
const TESTS: [&str; 2] = ["test", "--workspace"];

/// Of `cargo xtask ci`.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Leaves the tests out: README's second command has just run them.
    #[arg(long)]
    tests_done: bool,
}

/// Stops at the first check that fails. At the end a table says what ran.
pub(crate) fn run(options: &Options) -> Result<()> {
    let allowed = Allowed::read()?;
    let mut report = Report::default();
    let done = steps(options, &mut report);
    println!("{}", report.table());
    done?;
    if env::var("CI").is_ok_and(|value| value == "true" || value == "1") {
        report.judge(&allowed)?;
    }
    match report.skips() {
        0 => println!("== all checks passed"),
        1 => println!("== all checks that ran passed; 1 was skipped"),
        skips => println!("== all checks that ran passed; {skips} were skipped"),
    }
    Ok(())
}

fn steps(options: &Options, report: &mut Report) -> Result<()> {
    report.step("formatting", |_| {
        run_cargo(&["fmt", "--all", "--check"])?;
        run_cargo(&["fmt", "--manifest-path", "fuzz/Cargo.toml", "--check"])?;
        run_cargo(&["fmt", "--manifest-path", "firmware-sim/firmware/Cargo.toml", "--check"])
    })?;
    report.step("lints", |_| {
        run_cargo(&[
            "clippy",
            "--workspace",
            "--all-targets",
            "--release",
            "--",
            "--deny",
            "warnings",
        ])?;
        // Tests turn all features of the program on; README's first command has its default ones.
        let program = ["--package", "rigidformer-cli", "--bins", "--release"];
        run_cargo(&[&["clippy"][..], &program, &["--", "--deny", "warnings"]].concat())
    })?;
    report.step("arrows", |_| arrows::run(false))?;
    if options.tests_done {
        report.ran_before("tests");
    } else {
        report.step("tests", |_| run_cargo(&TESTS))?;
    }
    report.step("documentation", |_| {
        let mut documentation = cargo(&["doc", "--workspace", "--no-deps"]);
        run_command(documentation.env("RUSTDOCFLAGS", "--deny warnings"))
    })?;
    report.step("pages", |_| docs::run(&docs::Options::default()))?;
    report.step("site", site::run)?;
    // Without building them: that compiles all dependencies once more.
    report.step("packages", |report| package::run(false, report))?;
    report.step("dependencies", deny::run)?;
    report.step("AddressSanitizer", |_| sanitize::run_address())?;
    report.step("without std", |report| embedded::run(false, report))?;
    report.step("combinations of features", features::run)?;
    report.step("header", |_| header::run(false))?;
    report.step("C and C++", |report| capi::run(None, false, report))?;
    report.step("ROS 2, ESP-IDF and Zephyr", integrations::run)?;
    report.step("the same C library twice", |_| reproduce::run())?;
    report.step("Python", python::run)?;
    report.step("the lab's many processes", lab::run)?;
    report.step("bits", |report| bits::run(false, report))?;
    report.step("firmware", |report| firmware::run(&firmware::Options::default(), report))?;
    report.step("instruction counts", |report| counts::run(false, report))?;
    report.step("what the change costs", |report| costs::run_if_known("HEAD^", report))?;
    report.step("a short run of the fuzz targets", |report| {
        let short =
            fuzz::Options { executions: FUZZ_EXECUTIONS, seed: 1, ..fuzz::Options::default() };
        fuzz::run(&short, report)
    })
}

fn cargo(arguments: &[&str]) -> Command {
    let mut command = process::cargo();
    command.args(arguments);
    command
}

fn run_cargo(arguments: &[&str]) -> Result<()> {
    run_command(&mut cargo(arguments))
}

fn run_command(command: &mut Command) -> Result<()> {
    println!("{}", process::line(command));
    process::run(command)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readme;

    const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

    #[test]
    fn the_tests_are_the_second_command_of_the_readme_and_of_ci() -> Result<()> {
        let text = std::fs::read_to_string(format!("{ROOT}/README.md"))?;
        let [_, second] = readme::parse(&text)?;
        let tests = format!("cargo {}", TESTS.join(" "));
        assert_eq!(readme::bare(&second), tests);
        let script = std::fs::read_to_string(format!("{ROOT}/.ci/run"))?;
        assert!(script.lines().any(|line| line == tests), ".ci/run does not run `{tests}`");
        Ok(())
    }

    #[test]
    fn the_list_of_allowed_skips_parses() -> Result<()> {
        let text = std::fs::read_to_string(format!("{ROOT}/tools/xtask/allowed-skips.toml"))?;
        Allowed::parse(&text).map(drop)
    }
}
