//! Firmware images under QEMU: built, run, compared with this machine bit for bit, weighed.

mod boards;
mod budget;
mod elf;
mod output;
mod own;
mod table;

use std::collections::BTreeMap;
use std::fs;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use anyhow::{Context, Result, anyhow, bail};
use clap::Args;

use crate::process::{cargo, output as output_of};
use crate::report::Report;
use crate::{apt, tables, tools};
use boards::{Board, FOLDER};
use budget::Numbers;
pub(crate) use elf::forbidden;
pub(crate) use table::{grouped, millions};

const MODEL: &str = "weights/models/nano.rfm";
/// Where the example is shown.
const PAGE: &str = "docs/FIRMWARE.md";
/// The images that are linked and weighed, but not run, what their text is called, and the model in it that is not counted.
const RUNTIMES: [(&str, &str, &str); 3] = [
    ("runtime_only", "runtime.text", MODEL),
    ("runtime_whole", "runtime_whole.text", MODEL),
    ("runtime_soft", "runtime_soft.text", "weights/models/shell.rfm"),
];
/// The images that have memory of their own, and what their flash and RAM are called.
const OWN_MEMORY: [(&str, [&str; 2]); 2] =
    [("walk", ["walk.flash", "walk.ram"]), ("drape", ["drape.flash", "drape.ram"])];

/// Of `cargo xtask firmware`.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct Options {
    /// Takes what the images print as expected, where it equals this machine's rollouts, and what was
    /// measured as the budget.
    #[arg(long)]
    bless: bool,
    /// This board alone.
    #[arg(long)]
    board: Option<Board>,
    /// Prints the measured numbers as JSON.
    #[arg(long)]
    json: bool,
    /// Builds and runs the image `rollout` alone, with this packed model of nano's sizes instead of nano, and compares its poses with
    /// this machine's. Nothing is compared with the budget.
    #[arg(long, value_name = "FILE", conflicts_with = "bless")]
    model: Option<PathBuf>,
}

/// Runs every image on every board.
pub(crate) fn run(options: &Options, report: &mut Report) -> Result<()> {
    if let Err(missing) = apt::ensure(&[tools::QEMU_ARM]) {
        report.skip(missing);
        return Ok(());
    }
    if let Some(model) = &options.model {
        let path = fs::canonicalize(model).with_context(|| {
            format!(
                "cannot read {}; give a packed model, as `rigidformer pack` writes it",
                model.display()
            )
        })?;
        let boards = options.board.map_or(Board::ALL.to_vec(), |board| vec![board]);
        let expected = host_of(&path, "rollout")?;
        return own::run(&boards, options.json, &path, &expected, report);
    }
    let boards = options.board.map_or(Board::ALL.to_vec(), |board| vec![board]);
    images(&boards, options, report)
}

/// The boards that a change needs: both sets of kernels, and both targets of the compiler.
const ON_A_CHANGE: [Board; 2] = [Board::M7, Board::M55];

/// Runs every image on the boards that a change needs.
pub(crate) fn on_a_change(report: &mut Report) -> Result<()> {
    on(|board| ON_A_CHANGE.contains(&board), report)
}

/// Runs every image on the other boards.
pub(crate) fn other_boards(report: &mut Report) -> Result<()> {
    on(|board| !ON_A_CHANGE.contains(&board), report)
}

fn on(is_wanted: impl Fn(Board) -> bool, report: &mut Report) -> Result<()> {
    if let Err(missing) = apt::ensure(&[tools::QEMU_ARM]) {
        report.skip(missing);
        return Ok(());
    }
    let boards: Vec<Board> = Board::ALL.into_iter().filter(|board| is_wanted(*board)).collect();
    images(&boards, &Options::default(), report)
}

fn images(boards: &[Board], options: &Options, report: &mut Report) -> Result<()> {
    if !Path::new(MODEL).is_file() {
        bail!("{MODEL} is missing; train and pack the nano preset (tools/lab/README.md)");
    }
    let mut numbers = Numbers::new();
    let mut faults = Vec::new();
    example(&mut faults)?;
    if boards.contains(&Board::M7) {
        Board::M7.lint()?;
    }
    let mut portable = false;
    for &board in boards {
        if let Err(missing) = board.build()? {
            report.skip_part(board.name(), missing);
            continue;
        }
        let mut measured = BTreeMap::new();
        weigh(board, &mut measured, &mut faults)?;
        for (case, sent) in run_all(board, cases()?) {
            let stable = sent.and_then(|sent| {
                check(board, &case, &sent, options.bless, &mut measured, &mut faults)
            });
            let stable = stable.with_context(|| format!("{}: {case}", board.name()))?;
            portable |= stable.lines().any(|line| line.ends_with("kernels portable"));
        }
        independence(board, &measured, &mut faults);
        reserved(board, &measured, &mut faults)?;
        numbers.insert(board.name().into(), measured);
    }
    if options.bless {
        budget::write(&numbers)?;
        tables::write()?;
    } else {
        let stale = budget::faults(&budget::read()?, &numbers);
        if !stale.is_empty() {
            faults.extend(stale);
            faults.push(
                "`cargo xtask firmware --bless` renews the budget, where that is meant".into(),
            );
        }
    }
    faults.extend(budget::above(budget::CEILINGS, &numbers));
    if !portable {
        faults.extend(budget::above(budget::NATIVE_CEILINGS, &numbers));
    }
    if options.json {
        println!("{}", serde_json::to_string_pretty(&numbers)?);
    } else {
        println!("{}", table::tables(&numbers));
    }
    if !faults.is_empty() {
        bail!("{}", faults.join("\n"));
    }
    Ok(())
}

/// The example that is compiled is the one that is shown.
fn example(faults: &mut Vec<String>) -> Result<()> {
    let code = fs::read_to_string(Path::new(FOLDER).join("src/bin/example.rs"))?;
    let (_, shown) = code.split_once('\n').unwrap_or_default();
    if !fs::read_to_string(PAGE)?.contains(shown) {
        faults.push(format!("{PAGE} does not show {FOLDER}/src/bin/example.rs"));
    }
    Ok(())
}

/// Names of the images that run: those in `src/bin` but the bare ones.
fn cases() -> Result<Vec<String>> {
    let folder = Path::new(FOLDER).join("src/bin");
    let mut names = Vec::new();
    for entry in fs::read_dir(&folder).with_context(|| format!("no {}", folder.display()))? {
        let path = entry?.path();
        let is_rust = path.extension().is_some_and(|kind| kind == "rs");
        if let Some(name) = path.file_stem().and_then(|name| name.to_str())
            && is_rust
            && !RUNTIMES.iter().any(|(bare, ..)| name == *bare)
        {
            names.push(name.to_owned());
        }
    }
    names.sort();
    Ok(names)
}

fn read(path: PathBuf) -> Result<Vec<u8>> {
    fs::read(&path).with_context(|| format!("cannot read {}", path.display()))
}

/// Sizes, and symbols that must not be there.
fn weigh(
    board: Board,
    measured: &mut BTreeMap<String, f64>,
    faults: &mut Vec<String>,
) -> Result<()> {
    let model = fs::metadata(MODEL)?.len();
    let rollout = read(board.image("rollout"))?;
    let sizes = elf::sizes(&rollout)?;
    let mut bytes =
        vec![("model", model), ("rollout.flash", sizes.flash), ("rollout.ram", sizes.ram)];
    let mut symbols = vec![("rollout", elf::forbidden(&rollout, false)?)];
    for (image, [flash, ram]) in OWN_MEMORY {
        let file = read(board.image(image))?;
        let sizes = elf::sizes(&file)?;
        bytes.extend([(flash, sizes.flash), (ram, sizes.ram)]);
        symbols.push((image, elf::forbidden(&file, false)?));
    }
    for (image, figure, model) in RUNTIMES {
        let runtime = read(board.image(image))?;
        bytes.push((figure, elf::sizes(&runtime)?.text - fs::metadata(model)?.len()));
        symbols.push((image, elf::forbidden(&runtime, true)?));
    }
    measured.extend(bytes.into_iter().map(|(name, bytes)| (name.to_owned(), bytes as f64)));
    for (image, symbols) in symbols {
        if !symbols.is_empty() {
            faults.push(format!("{}: {image} has {}", board.name(), symbols.join(", ")));
        }
    }
    slabs(board, &rollout, faults)
}

/// What the linker reserves for the slabs is what the const functions say on this machine, but for joints: this image has none, and
/// this machine's builds have room for them.
fn slabs(board: Board, rollout: &[u8], faults: &mut Vec<String>) -> Result<()> {
    let said = host("sizes")?;
    let words: Vec<&str> = said.split_whitespace().collect();
    for (slab, symbol) in [
        ("f32", "rigidformer_slab_f32"),
        ("i8", "rigidformer_slab_i8"),
        ("points", "rigidformer_slab_points"),
    ] {
        let at = words.iter().position(|word| *word == slab);
        let expected: Option<u64> =
            at.and_then(|at| words.get(at + 1)).and_then(|word| word.parse().ok());
        let found = elf::symbol_size(rollout, symbol)?;
        let is_right = if slab == "f32" { found <= expected } else { found == expected };
        if expected.is_none() || found.is_none() || !is_right {
            faults.push(format!(
                "{}: {symbol} has {found:?} bytes, the const functions say {expected:?}",
                board.name()
            ));
        }
    }
    Ok(())
}

/// What the linker reserves for all slabs is what the const functions say on the board: a unit is shorter there.
fn reserved(
    board: Board,
    measured: &BTreeMap<String, f64>,
    faults: &mut Vec<String>,
) -> Result<()> {
    let rollout = read(board.image("rollout"))?;
    let mut sum = 0;
    for slab in ["f32", "i8", "points", "units"] {
        let symbol = format!("rigidformer_slab_{slab}");
        let size = elf::symbol_size(&rollout, &symbol)?;
        sum += size.with_context(|| format!("the image has no {symbol}"))?;
    }
    let said = measured.get("rollout.workspace");
    if said != Some(&(sum as f64)) {
        let name = board.name();
        faults
            .push(format!("{name}: the slabs have {sum} bytes, the const functions say {said:?}"));
    }
    Ok(())
}

/// What this machine computes for an image: its lines, by the portable kernels.
fn host(image: &str) -> Result<String> {
    host_of(Path::new(MODEL), image)
}

/// The same of a model.
fn host_of(model: &Path, image: &str) -> Result<String> {
    let mut command = cargo();
    command.args(["run", "--quiet", "--release", "--package", "rigidformer-tests"]);
    command.args(["--bin", "firmware", "--"]).arg(model).arg(image);
    output_of(&mut command)
}

/// What each image sends, in their order; as many run at a time as there are cores, for an emulator takes one.
fn run_all(board: Board, cases: Vec<String>) -> Vec<(String, Result<Vec<u8>>)> {
    let next = AtomicUsize::new(0);
    let sent: Vec<Mutex<Option<Result<Vec<u8>>>>> =
        cases.iter().map(|_| Mutex::default()).collect();
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, NonZero::get) {
            scope.spawn(|| {
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let (Some(case), Some(place)) = (cases.get(at), sent.get(at)) else { break };
                    let found = board.run(&board.image(case));
                    if let Ok(mut place) = place.lock() {
                        *place = Some(found);
                    }
                }
            });
        }
    });
    let found = sent.into_iter().map(|place| {
        let none = || Err(anyhow!("the thread of its emulator died"));
        place.into_inner().ok().flatten().unwrap_or_else(none)
    });
    cases.into_iter().zip(found.collect::<Vec<_>>()).collect()
}

/// Compares what an image sent; gives back what it printed.
fn check(
    board: Board,
    case: &str,
    sent: &[u8],
    bless: bool,
    measured: &mut BTreeMap<String, f64>,
    faults: &mut Vec<String>,
) -> Result<String> {
    let mut found = output::decode(&read(board.image(case))?, sent)?;
    // One file of expected lines for all boards: there the kernels of a processor have one name.
    const KERNELS: &str = "INFO kernels ";
    let own = format!("{KERNELS}{}\n", board.kernels());
    if found.stable.contains(KERNELS) && !found.stable.contains(&own) {
        faults.push(format!("{}: {case}: other kernels than {}", board.name(), board.kernels()));
    }
    found.stable = found.stable.replace(&own, "INFO kernels cortex-m\n");
    let mut named =
        |(name, number)| (name != "clock").then_some((format!("{case}.{name}"), number));
    measured.extend(found.measured.into_iter().filter_map(&mut named));
    let before = faults.len();
    for line in output::missing(&host(case)?, &found.stable) {
        faults
            .push(format!("{}: {case}: this machine computes otherwise:\n  {line}", board.name()));
    }
    let expected = Path::new(FOLDER).join("src/bin").join(case).with_extension("out");
    if bless && faults.len() == before {
        fs::write(&expected, &found.stable)?;
    }
    let text = fs::read_to_string(&expected)
        .with_context(|| format!("cannot read {}; --bless writes it", expected.display()))?;
    if let Some(difference) = output::first_difference(&text, &found.stable) {
        faults.push(format!("{}: {case}: {difference}", board.name()));
    }
    if faults.len() == before {
        println!("{}: {case}: as expected, bit for bit", board.name());
    }
    Ok(found.stable)
}

/// A step takes the same time whatever the units do.
fn independence(board: Board, measured: &BTreeMap<String, f64>, faults: &mut Vec<String>) {
    let of = |scene| measured.get(&format!("rollout.{scene}.step")).copied().unwrap_or_default();
    let (contact, flight): (f64, f64) = (of("contact"), of("flight"));
    let difference = (contact - flight).abs() / contact.max(flight);
    println!("{}: contacts change a step by {:.2} %", board.name(), 100.0 * difference);
    // Not a number where neither was measured.
    if difference.is_nan() || difference > board.dependence() {
        faults.push(format!(
            "{}: a step takes {contact} instructions with contacts and {flight} without",
            board.name()
        ));
    }
}
