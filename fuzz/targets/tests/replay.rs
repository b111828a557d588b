//! Every input that fuzzing keeps, and a change of each, through what its target does with it. `cargo xtask fuzz` makes new ones.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use rigidformer_fuzz_targets as targets;
use rigidformer_tests::Random;
use std::cell::Cell;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, Once, PoisonError};
use std::time::{Duration, Instant};
use zip::ZipArchive;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name)
}

/// An input, and where it is from.
#[derive(Clone, Default)]
struct Input {
    name: String,
    bytes: Vec<u8>,
}

impl Input {
    /// Keeps the bytes where fuzzers keep theirs; says what and where.
    fn kept(&self, target: &str) -> String {
        let folder = folder("artifacts").join(target);
        let words: Vec<&str> = self.name.split(|c: char| !c.is_ascii_alphanumeric()).collect();
        let path = folder.join(format!("replay-{}", words.join("-")));
        let written =
            std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&path, &self.bytes));
        match written {
            Ok(()) => format!("{target}: {}; its bytes are in {}", self.name, path.display()),
            Err(error) => format!("{target}: {}; {}: {error}", self.name, path.display()),
        }
    }
}

/// The sound inputs of a target that fuzzing begins with, and those that it kept.
fn inputs(target: &str) -> Vec<Input> {
    let mut inputs = Vec::new();
    if let Ok(seeds) = std::fs::read_dir(folder("seeds").join(target)) {
        let mut seeds: Vec<PathBuf> = seeds.map(|entry| entry.unwrap().path()).collect();
        seeds.sort();
        inputs.extend(seeds.iter().map(|seed| Input {
            name: format!("seed {}", seed.file_name().unwrap_or_default().display()),
            bytes: std::fs::read(seed).unwrap(),
        }));
    }
    let kept = File::open(folder("corpus").join(format!("{target}.zip"))).unwrap();
    let mut kept = ZipArchive::new(kept).unwrap();
    for index in 0..kept.len() {
        let mut input = Input { name: format!("{target}.zip entry {index}"), bytes: Vec::new() };
        kept.by_index(index).unwrap().read_to_end(&mut input.bytes).unwrap();
        inputs.push(input);
    }
    inputs
}

/// The stack of a main thread, on which libFuzzer runs targets. Tests have a quarter of it.
const STACK: usize = 8 << 20;
/// A guard against inputs that never end: far longer than any takes.
const HANG: Duration = Duration::from_secs(60);

thread_local! {
    /// How often a thread of this file has panicked. None on others.
    static PANICS: Cell<Option<usize>> = const { Cell::new(None) };
}
/// Panics of threads that targets start.
static PANICS_ELSEWHERE: AtomicUsize = AtomicUsize::new(0);

/// Counts panics, also those that something catches.
fn count_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            match PANICS.get() {
                Some(count) => PANICS.set(Some(count + 1)),
                None => {
                    PANICS_ELSEWHERE.fetch_add(1, Ordering::Relaxed);
                }
            }
            usual(panic);
        }));
    });
}

/// What a replay is at, and since when. None between inputs.
type At = Arc<Mutex<Option<(Input, Instant)>>>;

fn set(at: &At, now: Option<(Input, Instant)>) {
    *at.lock().unwrap_or_else(PoisonError::into_inner) = now;
}

fn get(at: &At) -> Option<(Input, Instant)> {
    at.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

fn replay(target: &'static str, run: fn(&[u8])) {
    count_panics();
    PANICS.set(Some(0));
    let at = At::default();
    let here = at.clone();
    let replayed = std::thread::Builder::new().stack_size(STACK).spawn(move || {
        PANICS.set(Some(0));
        let inputs = inputs(target);
        assert!(inputs.len() > 100, "{target} keeps {} inputs", inputs.len());
        let mut random = Random(1);
        let before = PANICS_ELSEWHERE.load(Ordering::Relaxed);
        let once = |input: &Input| {
            set(&here, Some((input.clone(), Instant::now())));
            run(&input.bytes);
            assert_eq!(PANICS.get(), Some(0), "a panic was caught");
            let elsewhere = PANICS_ELSEWHERE.load(Ordering::Relaxed);
            assert_eq!(elsewhere, before, "a thread panicked, of this target or of one beside it");
            set(&here, None);
        };
        for mut input in inputs {
            once(&input);
            for _ in 0..3 {
                let place = random.bits() as usize % input.bytes.len().max(1);
                if let Some(byte) = input.bytes.get_mut(place) {
                    *byte = random.bits() as u8;
                }
            }
            input.name += ", changed";
            once(&input);
        }
    });
    let replayed = replayed.unwrap();
    while !replayed.is_finished() {
        std::thread::sleep(Duration::from_millis(20));
        // No lock is held while this looks, so that the replay does not wait.
        let since =
            at.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(|(_, since)| *since);
        if since.is_some_and(|since| since.elapsed() > HANG) {
            let input = get(&at).map(|(input, _)| input).unwrap_or_default();
            // Past what tests print: that is lost.
            let said =
                format!("{}, which takes more than {} s", input.kept(target), HANG.as_secs());
            let _ = writeln!(std::io::stderr(), "{said}");
            std::process::abort();
        }
    }
    if replayed.join().is_err() {
        match get(&at) {
            Some((input, _)) => panic!("a finding: {}", input.kept(target)),
            None => panic!("{target}: the inputs cannot be read"),
        }
    }
}

macro_rules! replays {
    ($($target:ident)*) => {
        $(#[test]
        fn $target() {
            replay(stringify!($target), targets::$target::run);
        })*
    };
}

replays! { c_calls export_file kernels_step model_file observe_step scene_file snapshot soft_step }

#[cfg(feature = "files")]
replays! { recording robot trace_file tracker }

#[cfg(feature = "program")]
replays! { identify own_files pieces shown }

#[test]
fn every_target_is_replayed() {
    let mut kept = Vec::new();
    for entry in std::fs::read_dir(folder("fuzz_targets")).unwrap() {
        kept.push(entry.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned());
    }
    kept.sort();
    let text = include_str!("replay.rs");
    let listed =
        text.lines().filter_map(|line| line.strip_prefix("replays! { ")?.strip_suffix(" }"));
    let mut listed: Vec<&str> = listed.flat_map(|names| names.split(' ')).collect();
    listed.sort();
    assert_eq!(kept, listed);
}
