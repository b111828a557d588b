//! Checks of this repository; `cargo xtask ci` runs them all.

mod apt;
mod arrows;
mod bare;
mod bench;
mod bits;
mod capi;
mod ci;
mod costs;
mod counts;
mod deny;
mod disk;
mod docs;
mod door;
mod embedded;
mod features;
mod firmware;
mod fuzz;
mod header;
mod install;
mod integrations;
mod lab;
mod package;
mod process;
mod program;
mod python;
mod readme;
mod report;
mod reproduce;
mod rust_src;
mod sanitize;
mod site;
mod sources;
mod tables;
mod tools;

use std::env;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Parser;

use report::Report;

/// Checks of this repository.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
enum Command {
    /// All checks: formatting, lints, arrows, tests, documentation, builds without std, the Python wheel, bits, firmware.
    Ci(ci::Options),
    /// Runs README's two commands in a minimal Debian root with Rust and a C linker and nothing else.
    Bare(bare::Options),
    /// Checks which crate may depend on which, and that no files of a crate need each other in a circle.
    Arrows {
        /// Prints the files of each crate in layers: a file uses files of lower layers alone.
        #[arg(long)]
        graph: bool,
    },
    /// Builds the crates without std for a Cortex-M.
    NoStd {
        /// Builds `core` itself, although the target may be installed.
        #[arg(long)]
        from_source: bool,
    },
    /// Lints every combination of features that the documents offer, for this machine and for a Cortex-M, and the program with each alone.
    Features,
    /// Compares 100-step rollouts bit for bit: debug, release, other processors.
    Bits {
        /// Takes this machine's bits as the golden ones.
        #[arg(long)]
        bless: bool,
    },
    /// Builds the C libraries and runs the C and C++ examples, here and on emulated boards.
    Capi {
        /// Where header and libraries go, for keeps; a folder of cargo's where left out.
        #[arg(long)]
        prefix: Option<PathBuf>,
        /// Installs this machine's libraries and what finds them, and stops: nothing is run, added by rustup or installed by apt.
        #[arg(long, requires = "prefix", conflicts_with = "bless")]
        install_only: bool,
        /// Takes what the examples say about nonsense as what they should.
        #[arg(long)]
        bless: bool,
    },
    /// Checks the node for ROS 2, the component for ESP-IDF and the module for Zephyr, as far as that goes without those.
    Integrations,
    /// Compares the C header with the crate that it is generated from.
    Header {
        /// Writes the header.
        #[arg(long)]
        bless: bool,
    },
    /// Runs the images of `firmware-sim/firmware` on Cortex-M7, M4, M33 and M55 under QEMU.
    Firmware(firmware::Options),
    /// Times the workloads of docs/PERFORMANCE.md in turn with the ceiling, a commit before, PyTorch and ONNX Runtime.
    Bench(bench::Options),
    /// Counts instructions under Callgrind and compares them with the committed ones.
    Counts {
        /// Takes the counts as the committed ones.
        #[arg(long)]
        bless: bool,
        /// Prints those of products by aarch64's kernels under qemu-user instead.
        #[arg(long, conflicts_with = "bless")]
        aarch64: bool,
    },
    /// Trains in two processes and shares scenes out to workers, where the lab's environment is.
    Lab,
    /// Prints what a change costs: committed bytes and instructions beside those of a commit before.
    Costs {
        /// A commit, branch or tag.
        #[arg(long, default_value = "HEAD^")]
        before: String,
    },
    /// Installs the Python wheel into an environment of its own, and runs its tests and its example.
    Python {
        /// Builds the wheel that is published, for every Linux with glibc 2.17 (manylinux2014), and tests its bits and its size.
        #[arg(long)]
        release: bool,
    },
    /// Checks licences, sources and advisories of all that is depended on.
    Deny,
    /// Packs the crates as a registry would get them, and builds each from its package.
    Package,
    /// Builds the C libraries twice, from sources in two places, and compares the bytes.
    Reproduce,
    /// Checks the pages: words, sentences, forbidden phrases, tables, links.
    Docs(docs::Options),
    /// Writes the tables of docs/tables into the pages.
    Tables(tables::Options),
    /// Builds the pages as a site below target/site, and follows its links.
    Site,
    /// Runs the tests that reach unsafe code with AddressSanitizer.
    Sanitize {
        /// Interprets those of C's pointers with Miri instead, which takes long and needs nightly Rust.
        #[arg(long)]
        miri: bool,
        /// Runs those of threads and futures with ThreadSanitizer instead, which needs nightly Rust.
        #[arg(long, conflicts_with = "miri")]
        threads: bool,
    },
    /// Feeds mutated files, observations and calls to what reads them.
    Fuzz(fuzz::Options),
}

fn main() -> Result<()> {
    let start = env::current_dir().context("no current folder")?;
    // From any folder of the repository: cargo tells where this crate is.
    if let Some(here) = env::var_os("CARGO_MANIFEST_DIR") {
        let root = Path::new(&here).join("../..");
        env::set_current_dir(&root).with_context(|| format!("cannot enter {}", root.display()))?;
    }
    let report = &mut Report::default();
    match Command::parse() {
        Command::Ci(options) => ci::run(&options),
        Command::Bare(options) => bare::run(&options, &start),
        Command::Arrows { graph } => arrows::run(graph),
        Command::Features => features::run(report).and_then(|()| features::run_program()),
        Command::NoStd { from_source } => embedded::run(from_source, report),
        Command::Bits { bless } => bits::run(bless, report),
        Command::Capi { prefix: Some(prefix), install_only: true, .. } => {
            capi::install(&start.join(prefix))
        }
        Command::Capi { prefix, bless, .. } => {
            capi::run(prefix.map(|prefix| start.join(prefix)), bless, report)
        }
        Command::Integrations => integrations::run(report),
        Command::Header { bless } => header::run(bless),
        Command::Firmware(options) => firmware::run(&options, report),
        Command::Bench(options) => bench::measure(&options, &start),
        Command::Counts { aarch64: true, .. } => counts::aarch64(report),
        Command::Counts { bless, .. } => counts::run(bless, report),
        Command::Lab => lab::run(report),
        Command::Costs { before } => costs::run(&before),
        Command::Python { release: true } => python::release(report),
        Command::Python { .. } => python::run(report),
        Command::Deny => deny::run(report),
        Command::Package => package::run(true, report),
        Command::Reproduce => reproduce::run(),
        Command::Docs(options) => docs::run(&options),
        Command::Tables(options) => tables::run(&options),
        Command::Site => site::run(report),
        Command::Sanitize { miri: true, .. } => sanitize::run_miri(report),
        Command::Sanitize { threads: true, .. } => sanitize::run_threads(report),
        Command::Sanitize { .. } => sanitize::run_address(),
        Command::Fuzz(options) => fuzz::run(&options, report),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_installation_names_its_place_and_runs_nothing() {
        let parsed = |arguments: &[&str]| {
            Command::try_parse_from(["xtask", "capi"].iter().chain(arguments)).ok()
        };
        let only = parsed(&["--install-only", "--prefix", "/p"]);
        assert!(matches!(only, Some(Command::Capi { install_only: true, .. })));
        // A folder of cargo's, or what examples say: neither is an installation's.
        assert!(parsed(&["--install-only"]).is_none());
        assert!(parsed(&["--install-only", "--prefix", "/p", "--bless"]).is_none());
        let all = parsed(&["--prefix", "/p"]);
        assert!(matches!(all, Some(Command::Capi { install_only: false, .. })));
    }
}
