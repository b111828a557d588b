//! The fuzz targets of `fuzz/`, with the stable toolchain.

mod corpus;
mod said;

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::apt;
use crate::install::Program;
use crate::process::{line, output};
use crate::report::Report;
use crate::tools;
use said::Said;

const FUZZ: Program = Program { name: "cargo-fuzz", version: None, features: &[] };

/// Of `cargo xtask fuzz`.
#[derive(clap::Args, Default)]
pub(crate) struct Options {
    /// Inputs to try, over all targets together.
    #[arg(long, default_value_t = 100_000)]
    pub(crate) executions: u64,
    /// A target to run; may be given more than once [default: all].
    #[arg(long, value_name = "NAME")]
    pub(crate) target: Vec<String>,
    /// Another seed, other inputs.
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u32,
    /// Seconds of a target, at most.
    #[arg(long, value_name = "S")]
    pub(crate) seconds: Option<u64>,
    /// Keeps the inputs that reach something new: the smallest set of them becomes the committed corpus.
    #[arg(long)]
    pub(crate) keep: bool,
}

/// A target of `fuzz/fuzz_targets`.
struct Target {
    name: &'static str,
    /// Bytes of an input, at most.
    longest: u32,
    sanitizer: Sanitizer,
}

#[derive(Clone, Copy, PartialEq)]
enum Sanitizer {
    /// No unsafe code to watch; panics and overflows are caught without, and it is several times as fast.
    None,
    /// Pointers of C.
    Address,
}

const fn target(name: &'static str, longest: u32) -> Target {
    Target { name, longest, sanitizer: Sanitizer::None }
}

/// The longest files that are tried.
const LONG: u32 = 1 << 20;
/// Mebibytes of a target's process, at most: what readers may take, and what libFuzzer itself keeps.
const MEMORY_MIB: u32 = 2048;

const TARGETS: [Target; 16] = [
    target("model_file", LONG),
    target("observe_step", 4096),
    target("soft_step", 4096),
    target("kernels_step", 4096),
    target("snapshot", 4096),
    target("scene_file", LONG),
    target("export_file", LONG),
    target("trace_file", LONG),
    target("recording", LONG),
    target("own_files", LONG),
    target("tracker", 4096),
    target("identify", LONG),
    target("shown", LONG),
    target("pieces", 16_384),
    target("robot", 16_384),
    Target { sanitizer: Sanitizer::Address, ..target("c_calls", 4096) },
];

/// Runs every target for an equal share of `executions`, on what is kept of earlier runs first.
pub(crate) fn run(options: &Options, report: &mut Report) -> Result<()> {
    let targets = chosen(&options.target)?;
    if let Err(missing) = apt::ensure(&[tools::CXX]) {
        // libFuzzer is C++.
        report.skip(missing);
        return Ok(());
    }
    let program = match FUZZ.ensure() {
        Ok(program) => program,
        Err(missing) => {
            report.skip(missing);
            return Ok(());
        }
    };
    let host = output(Command::new("rustc").arg("-vV"))?;
    let host = host.lines().find_map(|line| line.strip_prefix("host: ")).unwrap_or_default();
    let (mut table, mut failed) = (vec![Said::header()], Vec::new());
    let executions = options.executions.div_ceil(targets.len() as u64);
    for target in targets {
        let folder = corpus::unpacked(target.name)?;
        let command = |words: &[&str]| {
            let mut command = Command::new(&program);
            command.args(["run", "--fuzz-dir", "fuzz", "--target", host, "--sanitizer"]);
            match target.sanitizer {
                Sanitizer::None => command.arg("none"),
                // All is built once more for it: nothing that it does not need.
                Sanitizer::Address => command.args(["address", "--no-default-features"]),
            };
            command.arg(target.name).args(words);
            // Coverage instrumentation is an unstable option of the stable compiler.
            command.env("RUSTC_BOOTSTRAP", "1");
            command
        };
        let mut fuzz = command(&[]);
        fuzz.arg(&folder).args(["--", "-timeout=10", "-print_final_stats=1"]);
        fuzz.arg(format!("-seed={}", options.seed)).arg(format!("-max_len={}", target.longest));
        fuzz.arg(format!("-runs={executions}")).arg(format!("-rss_limit_mb={MEMORY_MIB}"));
        fuzz.args(options.seconds.map(|seconds| format!("-max_total_time={seconds}")));
        println!("{}", line(&fuzz));
        let (is_whole, said) = said::listen(&mut fuzz)?;
        table.push(said.row(target.name));
        if !is_whole {
            println!("{}", said.end());
            failed.push(target.name);
        } else if options.keep {
            keep(target, &folder, command)?;
        }
    }
    println!("{}", Said::table(&table));
    if !failed.is_empty() {
        bail!("{} found something: fuzz/artifacts has the inputs", failed.join(", "));
    }
    Ok(())
}

/// The smallest set of inputs that reaches what all of them reach becomes the corpus.
fn keep(target: &Target, folder: &Path, command: impl Fn(&[&str]) -> Command) -> Result<()> {
    let merged: PathBuf = folder.with_extension("merged");
    if merged.exists() {
        std::fs::remove_dir_all(&merged)?;
    }
    std::fs::create_dir_all(&merged)?;
    let mut merge = command(&[]);
    merge.arg(&merged).arg(folder).args(["--", "-set_cover_merge=1"]);
    merge.arg(format!("-max_len={}", target.longest));
    println!("{}", line(&merge));
    let (is_whole, said) = said::listen(&mut merge)?;
    if !is_whole {
        bail!("{}: the inputs cannot be merged\n{}", target.name, said.end());
    }
    let (inputs, bytes) = corpus::pack(target.name, &merged)?;
    println!("{}: {inputs} inputs are kept, in {bytes} bytes", target.name);
    std::fs::remove_dir_all(&merged).context("a folder of this command")
}

fn chosen(names: &[String]) -> Result<Vec<&'static Target>> {
    let known = || TARGETS.iter().map(|target| target.name).collect::<Vec<_>>().join(", ");
    if let Some(unknown) = names.iter().find(|name| TARGETS.iter().all(|t| t.name != *name)) {
        bail!("--target {unknown}: there is none of that name; there are {}", known());
    }
    let is_asked = |target: &&Target| names.is_empty() || names.iter().any(|n| n == target.name);
    Ok(TARGETS.iter().filter(is_asked).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_target_is_in_the_crate() -> Result<()> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/fuzz_targets");
        let mut there = Vec::new();
        for entry in std::fs::read_dir(folder)? {
            there
                .push(entry?.path().file_stem().unwrap_or_default().to_string_lossy().into_owned());
        }
        there.sort();
        let mut named: Vec<_> = TARGETS.iter().map(|target| target.name.to_owned()).collect();
        named.sort();
        assert_eq!(there, named);
        Ok(())
    }

    #[test]
    fn a_target_that_is_not_there_is_named() {
        let error = chosen(&["model_flie".into()]).err().map(|error| error.to_string());
        assert!(
            error.is_some_and(|text| text.contains("model_flie") && text.contains("model_file"))
        );
    }
}
