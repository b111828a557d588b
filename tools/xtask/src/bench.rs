//! Speed: the workloads of docs/PERFORMANCE.md, beside the machine's ceiling, a commit before and other engines.
//!
//! Machines that are shared change their speed by half within minutes. So all take turns in slices of a fraction of a second, round
//! after round, and what counts is the median of each round's ratios.

mod child;
mod machine;
pub(crate) mod program;
mod rows;
mod spread;

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use child::Child;
use spread::{Spread, quantile, ratios};

const EXAMPLES: &str = "\
Examples:
  cargo xtask bench                               all workloads, beside the machine's ceiling
  cargo xtask bench --only W-edge --rounds 15     some workloads, more rounds
  cargo xtask bench --before HEAD~1               beside a commit before
  cargo xtask bench --peers tools/lab/.venv/bin/python --out bench.json
                                                  beside PyTorch and ONNX Runtime

Stages of a step, futures by units, units against time, loading:
  cargo bench -p rigidformer-runtime --bench workloads -- --help";

/// What `cargo xtask bench` is told.
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Options {
    /// Only workloads whose name contains this, such as W-edge or gemm; may be given more than once
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Time for each slice, in seconds
    #[arg(long, default_value_t = 0.3, value_parser = seconds)]
    seconds: f64,
    /// Slices for each engine and workload
    #[arg(long, default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Also times this commit, built in a temporary worktree with a target folder of its own
    #[arg(long, value_name = "COMMIT")]
    before: Option<String>,
    /// Also times PyTorch and ONNX Runtime, with this Python that has tools/lab[bench] installed
    #[arg(long, value_name = "PYTHON")]
    peers: Option<PathBuf>,
    /// Also writes all numbers as JSON, when all are there
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Prints all numbers as JSON; what people read goes to standard error
    #[arg(long)]
    json: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    if (0.001..=3600.0).contains(&seconds) {
        Ok(seconds)
    } else {
        Err("0.001 to 3600 seconds".into())
    }
}

/// Measures in turn. Files that are told are seen from the folder `start`.
pub(crate) fn measure(options: &Options, start: &Path) -> Result<()> {
    let interrupted = Arc::new(AtomicBool::new(false));
    for signal in [SIGHUP, SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&interrupted))
            .context("cannot listen for signals")?;
    }
    let out = options.out.as_ref().map(|path| Whole::new(&start.join(path))).transpose()?;
    let measured = everything(options, start, &interrupted);
    if interrupted.load(Ordering::Relaxed) {
        bail!("interrupted; nothing is written");
    }
    let document = serde_json::to_string_pretty(&measured?)?;
    if let Some(out) = out {
        out.write(&document)?;
    }
    if options.json {
        println!("{document}");
    }
    Ok(())
}

/// A file that is written whole or not at all. Its folder is tried before anything is measured.
struct Whole {
    path: PathBuf,
    file: tempfile::NamedTempFile,
}

impl Whole {
    fn new(path: &Path) -> Result<Self> {
        let cannot = || format!("cannot write {}", path.display());
        if path.is_dir() {
            bail!("cannot write {}: it is a folder; name a file", path.display());
        }
        let folder = path.parent().with_context(cannot)?;
        let file = tempfile::NamedTempFile::new_in(folder).with_context(cannot)?;
        Ok(Whole { path: path.into(), file })
    }

    fn write(self, text: &str) -> Result<()> {
        let Whole { path, mut file } = self;
        let cannot = || format!("cannot write {}", path.display());
        writeln!(file, "{text}").with_context(cannot)?;
        file.persist(&path).with_context(cannot)?;
        Ok(())
    }
}

fn everything(options: &Options, start: &Path, interrupted: &AtomicBool) -> Result<Value> {
    let say = |text: &str| match options.json {
        true => eprintln!("{text}"),
        false => println!("{text}"),
    };
    let mut programs = Programs::new(options, start)?;
    let machine = machine::machine();
    let (commit, is_changed) = program::present_commit()?;
    let kernel = programs.ours.hello["kernel"].as_str().unwrap_or_default().to_owned();
    let ceiling = programs.ours.hello["instruction"].as_str().unwrap_or("unknown").to_owned();
    let features = machine["features"].as_array().into_iter().flatten().filter_map(Value::as_str);
    say(&format!(
        "{}, {} cores ({}), load {}; kernel {kernel}, ceiling {ceiling}; {} rounds of slices of {} s",
        machine["name"].as_str().unwrap_or_default(),
        machine["cores"],
        features.collect::<Vec<_>>().join(" "),
        machine["load"],
        options.rounds,
        options.seconds
    ));
    let cores = machine["cores"].as_f64().unwrap_or(1.0);
    if machine["load"].as_f64().is_some_and(|load| load > cores / 2.0) {
        say(
            "Other programs are running. PyTorch's threads wait for one another, often for longer than they work.",
        );
    }
    let absent = programs.peers.as_ref().and_then(|peers| peers.hello["absent"].as_array());
    for engine in absent.into_iter().flatten().filter_map(Value::as_str) {
        say(&format!("{engine} is not installed: pip install -e 'tools/lab[bench]'"));
    }
    let workloads = workloads(&programs.ours.hello, &options.only)?;
    let mut groups: Vec<&str> = workloads.iter().map(|workload| workload.group.as_str()).collect();
    groups.dedup();
    let mut results = Vec::new();
    for group in groups {
        let mut contests: Vec<Contest> = workloads
            .iter()
            .filter(|workload| workload.group == group)
            .map(|workload| Contest { workload, macs: None, turns: BTreeMap::new() })
            .collect();
        for round in 0..options.rounds as usize {
            programs.rows = None;
            for contest in &mut contests {
                let mut engines = programs.engines(contest.workload);
                // Who comes first is another one each time: none always follows the same.
                let first = round % engines.len().max(1);
                engines.rotate_left(first);
                for engine in engines {
                    if interrupted.load(Ordering::Relaxed) {
                        bail!("interrupted");
                    }
                    programs.turn(contest, &engine, round, options.seconds)?;
                }
            }
        }
        for contest in &contests {
            let result = contest.result();
            say(&text(&result));
            results.push(result);
        }
    }
    let peers = programs.peers.as_ref().map(|peers| &peers.hello);
    Ok(json!({
        "machine": machine, "kernel": kernel, "ceiling": ceiling, "threads": programs.ours.hello["threads"], "commit": commit, "changed_since": is_changed,
        "before": programs.before.as_ref().map(|(_, checkout)| &checkout.commit), "peers": peers, "rounds": options.rounds,
        "slice_s": options.seconds, "workloads": results,
    }))
}

/// What is measured, and on how many threads by us.
struct Workload {
    name: String,
    group: String,
    stage: String,
    threads: Vec<u64>,
}

/// Those that are asked for.
fn workloads(hello: &Value, only: &[String]) -> Result<Vec<Workload>> {
    let all = hello["workloads"].as_array().into_iter().flatten();
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let all = all.map(|workload| Workload {
        name: text(&workload["name"]),
        group: text(&workload["group"]),
        stage: text(&workload["stage"]),
        threads: workload["threads"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(Value::as_u64)
            .collect(),
    });
    let is_asked_for = |name: &str| only.is_empty() || only.iter().any(|only| name.contains(only));
    let (wanted, others): (Vec<_>, Vec<_>) = all.partition(|workload| is_asked_for(&workload.name));
    if wanted.is_empty() {
        let mut names: Vec<&str> = others.iter().map(|workload| workload.name.as_str()).collect();
        names.dedup();
        bail!("no workload is called so; there are {}", names.join(", "));
    }
    Ok(wanted)
}

/// Who takes a turn.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Engine {
    Ours { threads: u64 },
    Before { threads: u64 },
    Ceiling { threads: u64 },
    Rten { threads: u64 },
    Peer { name: String },
}

impl Engine {
    fn name(&self) -> String {
        let on = |who: &str, threads: u64| match threads {
            1 => format!("{who}, one thread"),
            _ => format!("{who}, {threads} threads"),
        };
        match self {
            Engine::Ours { threads } => on("ours", *threads),
            Engine::Before { threads } => on("before", *threads),
            Engine::Ceiling { threads } => on("ceiling", *threads),
            Engine::Rten { threads } => on("rten", *threads),
            Engine::Peer { name } => name.clone(),
        }
    }
}

/// A commit before.
enum Before {
    /// That takes turns.
    Served(Child),
    /// That runs whole groups of workloads.
    Program(PathBuf),
}

/// All that take turns.
struct Programs {
    ours: Child,
    // Before its checkout, which cannot go while it runs.
    before: Option<(Before, program::Checkout)>,
    peers: Option<Child>,
    /// Of the commit before, of this round, where it does not take turns.
    rows: Option<Value>,
}

impl Programs {
    fn new(options: &Options, start: &Path) -> Result<Self> {
        let serve = |program: &Path| Child::start(Command::new(program).arg("--serve"));
        let before = match &options.before {
            None => None,
            Some(commit) => {
                let checkout = program::Checkout::new(commit)?;
                let program = checkout.built()?;
                let before = match rows::takes_turns(&program)? {
                    true => Before::Served(serve(&program)?),
                    false => Before::Program(program),
                };
                Some((before, checkout))
            }
        };
        let ours = serve(&program::built(Path::new("."), None)?)?;
        let mut peers = None;
        if let Some(python) = &options.peers {
            // As the shell would find it, else from the repository's root.
            let here = start.join(python);
            let mut command = Command::new(if here.exists() { &here } else { python });
            command.args(["-m", "rigidformer_lab.bench", "--serve"]);
            // This repository's lab, whichever is installed there.
            command.env("PYTHONPATH", "tools/lab");
            let started = Child::start(&mut command);
            peers = Some(started.context("tools/lab/README.md tells how to install the peers")?);
        }
        Ok(Programs { ours, before, peers, rows: None })
    }

    /// Those that may have this workload.
    fn engines(&self, workload: &Workload) -> Vec<Engine> {
        let mut engines = Vec::new();
        for threads in workload.threads.iter().copied() {
            engines.push(Engine::Ours { threads });
            engines.push(Engine::Ceiling { threads });
            if self.before.is_some() {
                engines.push(Engine::Before { threads });
            }
            if workload.stage == "product" {
                engines.push(Engine::Rten { threads });
            }
        }
        let peers = self.peers.as_ref().and_then(|peers| peers.hello["engines"].as_array());
        // They compute whole steps.
        if workload.stage == "step" || workload.stage == "product" {
            let names = peers.into_iter().flatten().filter_map(Value::as_str);
            engines.extend(names.map(|name| Engine::Peer { name: name.into() }));
        }
        engines
    }

    /// A slice.
    fn turn(
        &mut self,
        contest: &mut Contest<'_>,
        engine: &Engine,
        round: usize,
        seconds: f64,
    ) -> Result<()> {
        let Workload { name, stage, group, .. } = contest.workload;
        let request = |stage: &str, threads: u64| json!({"workload": name, "stage": stage, "threads": threads, "seconds": seconds});
        let answer = match engine {
            Engine::Ours { threads } => self.ours.ask(&request(stage, *threads))?,
            Engine::Ceiling { threads } => self.ours.ask(&request("ceiling", *threads))?,
            Engine::Rten { threads } => self.ours.ask(&request("rten", *threads))?,
            Engine::Peer { name: engine } => {
                let Some(peers) = &mut self.peers else { return Ok(()) };
                peers.ask(&json!({"workload": name, "engine": engine, "seconds": seconds}))?
            }
            Engine::Before { threads } => match &mut self.before {
                None => return Ok(()),
                Some((Before::Served(served), _)) => served.ask(&request(stage, *threads))?,
                Some((Before::Program(program), _)) => {
                    if self.rows.is_none() {
                        self.rows = Some(rows::of(program, group, seconds)?);
                    }
                    let rows = self.rows.as_ref().unwrap_or(&Value::Null);
                    match rows::median(rows, name, stage, *threads) {
                        Some(median) => json!({"times_ms": [median]}),
                        None => return Ok(()),
                    }
                }
            },
        };
        contest.take(engine, round, &answer);
        Ok(())
    }
}

/// What an engine did in a round.
struct Turn {
    round: usize,
    times_ms: Vec<f64>,
}

/// A workload and the turns that were taken.
struct Contest<'w> {
    workload: &'w Workload,
    macs: Option<f64>,
    turns: BTreeMap<Engine, Vec<Turn>>,
}

impl Contest<'_> {
    fn take(&mut self, engine: &Engine, round: usize, answer: &Value) {
        self.macs = self.macs.or(answer["macs"].as_f64());
        let times = answer["times_ms"].as_array().into_iter().flatten();
        let mut times_ms: Vec<f64> = times.filter_map(Value::as_f64).collect();
        // What the products alone would take, were they as fast as registers.
        if let (Some(rate), Some(macs)) = (answer["gmac_per_s"].as_f64(), self.macs) {
            times_ms = vec![macs / rate / 1e6];
        }
        if !times_ms.is_empty() {
            self.turns.entry(engine.clone()).or_default().push(Turn { round, times_ms });
        }
    }

    /// Each round's median.
    fn medians(&self, engine: &Engine) -> Vec<(usize, f64)> {
        let turns = self.turns.get(engine).into_iter().flatten();
        turns.filter_map(|turn| Some((turn.round, quantile(&turn.times_ms, 0.5)?))).collect()
    }

    fn median(&self, engine: &Engine) -> Option<f64> {
        let medians: Vec<f64> =
            self.medians(engine).into_iter().map(|(_, median)| median).collect();
        quantile(&medians, 0.5)
    }

    /// Which of ours an engine is compared with: that on as many threads, or the faster one.
    fn rival(&self, engine: &Engine) -> Option<Engine> {
        match engine {
            Engine::Before { threads } | Engine::Ceiling { threads } | Engine::Rten { threads } => {
                Some(Engine::Ours { threads: *threads })
            }
            Engine::Ours { .. } | Engine::Peer { .. } => {
                let ours = self.turns.keys().filter(|engine| matches!(engine, Engine::Ours { .. }));
                let of = |engine: &Engine| self.median(engine).unwrap_or(f64::INFINITY);
                ours.min_by(|a, b| of(a).total_cmp(&of(b))).cloned()
            }
        }
    }

    fn result(&self) -> Value {
        let engines: Vec<Value> = self
            .turns
            .iter()
            .map(|(engine, turns)| {
                let all: Vec<f64> =
                    turns.iter().flat_map(|turn| turn.times_ms.iter().copied()).collect();
                let medians = self.medians(engine);
                let mut result = json!({
                    "engine": engine.name(), "median_ms": self.median(engine), "runs": all.len(),
                    "rounds_ms": medians.iter().map(|(_, median)| median).collect::<Vec<_>>(),
                });
                // A slice's median alone has no tail.
                if all.len() > turns.len() {
                    result["p99_ms"] = json!(quantile(&all, 0.99));
                }
                if let Some(rival) = self.rival(engine).filter(|rival| rival != engine)
                    && let Some(ratio) = Spread::of(&ratios(&medians, &self.medians(&rival)))
                {
                    result["ratio"] = ratio.json();
                    result["ratio_to"] = json!(rival.name());
                }
                result
            })
            .collect();
        let Workload { name, stage, .. } = self.workload;
        json!({"workload": name, "stage": stage, "macs": self.macs, "engines": engines})
    }
}

/// A workload for people.
fn text(result: &Value) -> String {
    let name = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let mut lines = vec![format!("\n{}, {}", name(&result["workload"]), name(&result["stage"]))];
    for engine in result["engines"].as_array().into_iter().flatten() {
        let mut line = format!("  {:<20}", name(&engine["engine"]));
        line += &format!("{:>10.3} ms", engine["median_ms"].as_f64().unwrap_or(f64::NAN));
        line += &match engine["p99_ms"].as_f64() {
            Some(p99) => format!("  p99 {p99:>9.3} ms"),
            None => " ".repeat(18),
        };
        if let Some(median) = engine["ratio"]["median"].as_f64() {
            let at = |place: &str| engine["ratio"][place].as_f64().unwrap_or(f64::NAN);
            line += &format!(
                "  {median:>7.3} x ({:.3} to {:.3}) of {}",
                at("p10"),
                at("p90"),
                name(&engine["ratio_to"])
            );
        }
        lines.push(line);
    }
    lines.join("\n")
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn workload() -> Workload {
        Workload {
            name: "W-edge".into(),
            group: "W-edge".into(),
            stage: "step".into(),
            threads: vec![1, 2],
        }
    }

    #[test]
    fn workloads_are_chosen_by_name() {
        let hello = json!({"workloads": [
            {"name": "W-edge", "group": "W-edge", "stage": "step", "threads": [1, 2]},
            {"name": "gemm 1x2x3", "group": "gemm", "stage": "product", "threads": [1]},
        ]});
        assert_eq!(workloads(&hello, &[]).unwrap().len(), 2);
        let some = workloads(&hello, &["gemm".into()]).unwrap();
        assert_eq!(
            (some.len(), some[0].name.as_str(), &some[0].threads[..]),
            (1, "gemm 1x2x3", &[1][..])
        );
        let error = workloads(&hello, &["W-egde".into()]).err().unwrap().to_string();
        assert!(error.contains("W-edge, gemm 1x2x3"), "{error}");
    }

    #[test]
    fn each_is_compared_with_ours_round_by_round() {
        let workload = workload();
        let mut contest = Contest { workload: &workload, macs: None, turns: BTreeMap::new() };
        let peer = Engine::Peer { name: "torch-f32".into() };
        // The machine is half as fast in the second round.
        for (round, slow) in [1.0, 2.0, 1.0].into_iter().enumerate() {
            let times =
                |ms: f64| json!({"times_ms": [ms * slow, ms * slow, 9.0 * ms * slow], "macs": 1e6});
            contest.take(&Engine::Ours { threads: 1 }, round, &times(4.0));
            contest.take(&Engine::Ours { threads: 2 }, round, &times(3.0));
            contest.take(&Engine::Before { threads: 1 }, round, &json!({"times_ms": [6.0 * slow]}));
            contest.take(
                &Engine::Ceiling { threads: 2 },
                round,
                &json!({"gmac_per_s": 1.0 / slow}),
            );
            contest.take(&peer, round, &times(30.0));
        }
        contest.take(&Engine::Before { threads: 2 }, 0, &json!({"absent": "no such workload"}));
        let result = contest.result();
        let of = |name: &str| {
            let mut engines = result["engines"].as_array().unwrap().iter();
            engines.find(|engine| engine["engine"] == name).cloned().unwrap_or(Value::Null)
        };
        assert_eq!(of("ours, 2 threads")["ratio"], Value::Null, "nobody is compared with himself");
        assert_eq!(of("ours, one thread")["ratio"]["median"], 4.0 / 3.0);
        assert_eq!(of("before, one thread")["ratio"]["p90"], 1.5);
        assert_eq!(of("before, one thread")["ratio_to"], "ours, one thread");
        assert_eq!(of("before, one thread")["p99_ms"], Value::Null);
        assert_eq!(of("before, 2 threads"), Value::Null);
        assert_eq!(of("ceiling, 2 threads")["median_ms"], 1.0);
        assert_eq!(of("torch-f32")["ratio"]["min"], 10.0);
        assert_eq!(of("torch-f32")["ratio_to"], "ours, 2 threads");
        assert_eq!(of("torch-f32")["runs"], 9);
        assert!(
            text(&result).contains("10.000 x (10.000 to 10.000) of ours, 2 threads"),
            "{}",
            text(&result)
        );
    }

    #[test]
    fn files_are_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.json");
        Whole::new(&path).unwrap().write("{}").unwrap();
        Whole::new(&path).unwrap().write("[]").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "[]\n");
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1, "no other file is left");
        assert!(Whole::new(&folder.path().join("none/out.json")).is_err());
        assert!(Whole::new(folder.path()).is_err(), "a folder is no file");
    }
}
