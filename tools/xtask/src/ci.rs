//! All checks, one after another: those that a change needs, and with `--full` those that a release needs.

use std::env;
use std::fmt::Write;
use std::process::Command;

use anyhow::Result;

use crate::report::{Allowed, Report};
use crate::{
    arrows, bits, capi, costs, counts, deny, disk, docs, embedded, features, firmware, fuzz,
    header, integrations, lab, package, process, program, python, reproduce, sanitize, site,
};

/// Inputs of the long run: some minutes. fuzz/README.md counts the longest ones.
const FUZZ_EXECUTIONS: u64 = 1_000_000;

/// README's second command.
const TESTS: [&str; 2] = ["test", "--workspace"];
const TESTS_STEP: &str = "tests";

/// Of `cargo xtask ci`.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Runs what a release needs, too
    #[arg(long)]
    full: bool,
    /// Leaves the tests out: README's second command has just run them.
    #[arg(long)]
    tests_done: bool,
    /// Prints the steps as docs/TESTING.md shows them, and runs none.
    #[arg(long)]
    list: bool,
}

/// When a step runs.
#[derive(Clone, Copy, PartialEq)]
enum When {
    /// Always.
    Change,
    /// With `--full`.
    Full,
}

/// A check. docs/TESTING.md has a row for each.
struct Step {
    name: &'static str,
    guards: &'static str,
    when: When,
    /// Why it runs then.
    why: &'static str,
    run: fn(&mut Report) -> Result<()>,
}

const fn change(
    name: &'static str,
    guards: &'static str,
    why: &'static str,
    run: fn(&mut Report) -> Result<()>,
) -> Step {
    Step { name, guards, when: When::Change, why, run }
}

const fn full(
    name: &'static str,
    guards: &'static str,
    why: &'static str,
    run: fn(&mut Report) -> Result<()>,
) -> Step {
    Step { name, guards, when: When::Full, why, run }
}

/// Quick ones first, and those of one build together.
const STEPS: &[Step] = &[
    change("formatting", "one style", "takes seconds", |_| formatted()),
    change("pages", "words, links and tables", "takes seconds", |_| {
        docs::run(&docs::Options::default())
    }),
    change("lints", "clippy's rules", "any change can break them", |_| lints()),
    change("arrows", "what may use what", "takes seconds", |_| arrows::run(false)),
    change(
        TESTS_STEP,
        "README's second command: results, debug bits, kept fuzz inputs",
        "any change can break them",
        |_| run_cargo(&TESTS),
    ),
    change(
        "program",
        "README's first command; what its build lacks names a feature",
        "a newcomer's first sight",
        |_| program::run(),
    ),
    change("documentation", "links of the API", "shares the build of lints", |_| {
        let mut documentation = cargo(&["doc", "--workspace", "--no-deps"]);
        run_command(documentation.env("RUSTDOCFLAGS", "--deny warnings"))
    }),
    change("AddressSanitizer", "memory of kernels and C", "all unsafe code of hosts", |_| {
        sanitize::run_address()
    }),
    change("without std", "builds for microcontrollers", "takes seconds", |report| {
        embedded::run(false, report)
    }),
    change("features", "all offered combinations", "each builds other code", features::run),
    change("header", "C's header", "takes seconds", |_| header::run(false)),
    change("C and C++", "C here and on Cortex-M7", "Rust tests miss it", capi::on_a_change),
    change("Python", "wheel, types and bits", "Rust tests miss it", python::wheel),
    change(
        "bits",
        "release builds here and for aarch64",
        "kernels of their own",
        bits::on_a_change,
    ),
    change(
        "firmware",
        "bits, panics and budgets on Cortex-M7 and M55",
        "both sets of kernels",
        firmware::on_a_change,
    ),
    change("cost", "prints committed numbers", "takes seconds", |report| {
        costs::run_if_known("HEAD^", report)
    }),
    full("site", "the book", "releases publish it", site::run),
    // Without building them: that compiles all dependencies once more.
    full("packages", "what registries get", "releases upload it", |report| {
        package::run(false, report)
    }),
    full("dependencies", "licences and advisories", "time changes them too", deny::run),
    full("features of the program", "each alone", "takes 2 minutes of a processor", |_| {
        features::run_program()
    }),
    full("counts", "instructions on x86", "no result depends on them", |report| {
        counts::run(false, report)
    }),
    full("other bits", "dev builds and riscv64", "portable kernels, as tested", bits::others),
    full("other C boards", "Cortex-M4 and M33", "M7 has their kernels", capi::other_boards),
    full("other firmware", "Cortex-M4 and M33", "M7 has their kernels", firmware::other_boards),
    full("integrations", "ROS 2, ESP-IDF, Zephyr", "they use C alone", integrations::run),
    full("reproduction", "the same C library twice", "builds all twice", |_| reproduce::run()),
    full(
        "source distribution",
        "the wheel from it, videos",
        "builds all again",
        python::source_distribution,
    ),
    full("all AddressSanitizer", "memory of all tests", "takes longest", |_| {
        sanitize::run_everything()
    }),
    full("ThreadSanitizer", "threads and futures", "builds the standard library", |report| {
        sanitize::run_threads(report)
    }),
    full("Miri", "pointers of C, model files", "interprets", sanitize::run_miri),
    full("many processes", "the lab's training", "needs PyTorch", lab::run),
    full("fuzzing", "new inputs", "tests replay the kept ones", |report| {
        let long =
            fuzz::Options { executions: FUZZ_EXECUTIONS, seed: 1, ..fuzz::Options::default() };
        fuzz::run(&long, report)
    }),
];

/// Stops at the first check that fails. At the end a table says what ran.
pub(crate) fn run(options: &Options) -> Result<()> {
    if options.list {
        print!("{}", table());
        return Ok(());
    }
    let needed_mib = if options.full { disk::FULL_MIB } else { disk::CHANGE_MIB };
    disk::ensure_room(&process::target(), needed_mib)?;
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
    for step in STEPS {
        report.guards(step.name, step.guards);
        match step.when {
            When::Full if !options.full => report.left_out(step.name),
            _ if step.name == TESTS_STEP && options.tests_done => report.ran_before(step.name),
            _ => report.step(step.name, step.run)?,
        }
    }
    Ok(())
}

/// The steps, as docs/TESTING.md shows them.
fn table() -> String {
    let mut text = String::from("|check|guards|runs|why then|\n|---|---|---|---|\n");
    for Step { name, guards, when, why, .. } in STEPS {
        let when = if *when == When::Change { "change" } else { "`--full`" };
        let _ = writeln!(text, "|{name}|{guards}|{when}|{why}|");
    }
    text
}

fn lints() -> Result<()> {
    // Tests turn all features of the program on; README's first command has its default ones.
    for what in [&["--workspace", "--all-targets"][..], &["--package", "rigidformer-cli", "--bins"]]
    {
        run_cargo(&[&["clippy"], what, &["--", "--deny", "warnings"]].concat())?;
    }
    Ok(())
}

fn formatted() -> Result<()> {
    run_cargo(&["fmt", "--all", "--check"])?;
    for manifest in ["fuzz/Cargo.toml", "firmware-sim/firmware/Cargo.toml", python::MANIFEST] {
        run_cargo(&["fmt", "--manifest-path", manifest, "--check"])?;
    }
    Ok(())
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
    fn the_page_shows_the_steps() -> Result<()> {
        let page = std::fs::read_to_string(format!("{ROOT}/docs/TESTING.md"))?;
        let table = table();
        assert!(
            page.contains(&table),
            "docs/TESTING.md lacks what `cargo xtask ci --list` prints:\n{table}"
        );
        Ok(())
    }

    #[test]
    fn names_of_steps_are_their_own() {
        let mut names: Vec<&str> = STEPS.iter().map(|step| step.name).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), STEPS.len());
    }

    #[test]
    fn the_list_of_allowed_skips_parses() -> Result<()> {
        let text = std::fs::read_to_string(format!("{ROOT}/tools/xtask/allowed-skips.toml"))?;
        Allowed::parse(&text).map(drop)
    }
}
