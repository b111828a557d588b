//! The workloads of docs/PERFORMANCE.md; `cargo xtask bench` runs them, and their peers on request.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod scenes;
mod serve;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Parser;
use nalgebra::Isometry3;
use rigidformer_evaluation::models::{Precision, quantise, random, with_rules, with_scope};
use rigidformer_runtime::core::quant::{Scratch, scratch_bytes};
use rigidformer_runtime::core::weights::Panels;
use rigidformer_runtime::core::weights::Scope;
use rigidformer_runtime::core::{Layer, Model, Schedule, Stage, Trace};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchSimulator, Start, VelocityNoise};
use rigidformer_runtime::kernels::{HostKernels, Kernel, Run, panels};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::{Threaded, Threads};
use rigidformer_runtime::world::World;
use scenes::Bodies;
use serde_json::{Value, json};

/// Measures the workloads of docs/PERFORMANCE.md on this machine.
#[derive(Parser)]
struct Options {
    /// Only workloads whose name contains this, such as W-edge or gemm; may be given more than once
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Time for each measurement
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
    /// Also writes the rows as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Runs this once, for an instruction counter to look at `rigidformer_counted`
    #[arg(long, value_name = "WHAT", value_parser = ["product", "edge-step"])]
    count: Option<String>,
    /// The product that is counted: rows, inputs and outputs
    #[arg(long, value_name = "MxKxN", default_value = "26x256x256", value_parser = shape)]
    shape: [usize; 3],
    /// How many times it runs: a counter of whole processes takes the difference of two runs
    #[arg(long, default_value_t = 1)]
    times: usize,
    /// Loads this file, takes one step of W-paper, and says how long it took and how much memory
    #[arg(long, value_name = "FILE")]
    load: Option<PathBuf>,
    /// Measures slices of workloads as lines on standard input ask for them: `cargo xtask bench` does
    #[arg(long)]
    serve: bool,
    /// cargo says so
    #[arg(long, hide = true)]
    bench: bool,
}

/// Milliseconds of repeated runs.
struct Times(Vec<f64>);

impl Times {
    /// Runs `body` for so long, at least five times, after one run to warm up.
    fn of(seconds: f64, body: impl FnMut()) -> Self {
        Times::at_least(5, seconds, body)
    }

    /// As [`of`](Self::of), but so many times at least.
    fn at_least(least: usize, seconds: f64, mut body: impl FnMut()) -> Self {
        body();
        let until = Instant::now() + Duration::from_secs_f64(seconds);
        let mut times = Vec::new();
        while times.len() < least || Instant::now() < until {
            let start = Instant::now();
            body();
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        times.sort_by(f64::total_cmp);
        Times(times)
    }

    fn at(&self, share: f64) -> f64 {
        self.0[((self.0.len() - 1) as f64 * share).round() as usize]
    }

    fn median(&self) -> f64 {
        self.at(0.5)
    }
}

/// Where a step's time goes.
#[derive(Default)]
struct Clock {
    running: Option<(Stage, Instant)>,
    /// Milliseconds of each stage in the order of `STAGES`.
    spent: [f64; 7],
}

const STAGES: [Stage; 7] = [
    Stage::Impulses,
    Stage::Nearest,
    Stage::Inputs,
    Stage::Encoder,
    Stage::Interaction,
    Stage::Anchors,
    Stage::Motion,
];

impl Clock {
    fn stop(&mut self) {
        if let Some((stage, since)) = self.running.take() {
            let index = STAGES.iter().position(|s| *s == stage).unwrap();
            self.spent[index] += since.elapsed().as_secs_f64() * 1e3;
        }
    }
}

impl Trace for Clock {
    fn record(&mut self, _: Layer, _: usize, _: &[f32]) {}

    fn records(&self) -> bool {
        false
    }

    fn enter(&mut self, stage: Stage) {
        self.stop();
        self.running = Some((stage, Instant::now()));
    }
}

/// What the machine can do at most, measured beside the workloads.
struct Ceilings {
    /// int8 GMAC/s on one thread and on all.
    int8: Option<[f64; 2]>,
    /// GB/s read from memory on one thread and on all.
    memory: [f64; 2],
}

/// Rows, inputs and outputs of the products.
const SHAPES: [(usize, usize, usize); 15] = [
    (6, 64, 128),
    (8, 96, 128),
    (40, 32, 32),
    (64, 64, 64),
    (14, 64, 64),
    (2, 256, 256),
    (10, 128, 128),
    (26, 256, 256),
    (26, 768, 768),
    (64, 768, 768),
    (26, 768, 3072),
    (64, 3072, 768),
    (1, 768, 768),
    (128, 512, 1024),
    (10, 8192, 14_592),
];

struct Bench {
    options: Options,
    engine: Engine,
    ceilings: Ceilings,
    rows: Vec<Value>,
}

fn main() {
    let options = Options::parse();
    let engine = Engine::new().unwrap_or_else(|error| {
        eprintln!("{error}");
        std::process::exit(2)
    });
    if let Some(what) = &options.count {
        return count(engine.single(), what, &options);
    }
    if let Some(path) = &options.load {
        return println!("{} {:.0}", first_step(engine, path), peak_memory_mb());
    }
    if options.serve {
        return serve::serve(engine);
    }
    let threads = engine.threads.count();
    println!("machine: {}", machine());
    println!("kernel {}, {threads} threads", engine.kernel);
    let ceilings =
        Ceilings { int8: int8_ceiling(engine.kernel, threads), memory: memory_ceiling(threads) };
    if let Some([one, all]) = ceilings.int8 {
        let by = engine.kernel.instruction().unwrap_or_default();
        println!("int8 ceiling: {one:.0} GMAC/s by {by} on one thread, {all:.0} on {threads}");
    }
    let [one, all] = ceilings.memory;
    println!("memory: {one:.0} GB/s read on one thread, {all:.0} on {threads}\n");
    let mut bench = Bench { options, engine, ceilings, rows: Vec::new() };
    bench.products();
    bench.steps();
    bench.futures();
    bench.wreck_curve();
    bench.sparse();
    bench.load();
    if let Some(path) = &bench.options.json {
        let document = json!({
            "machine": machine(), "kernel": engine.kernel.name(), "threads": threads,
            "int8_gmac_per_s": bench.ceilings.int8, "memory_gb_per_s": bench.ceilings.memory,
            "rows": bench.rows,
        });
        std::fs::write(path, serde_json::to_string_pretty(&document).unwrap()).unwrap();
    }
}

/// What an instruction counter collects.
#[inline(never)]
#[unsafe(no_mangle)]
#[allow(unsafe_code)]
extern "C" fn rigidformer_counted(body: &mut Body<'_>) {
    (body.0)();
}

struct Body<'b>(&'b mut dyn FnMut());

/// Three numbers with an x between.
fn shape(text: &str) -> Result<[usize; 3], String> {
    let numbers: Result<Vec<usize>, _> = text.split('x').map(str::parse).collect();
    let shape = numbers.ok().and_then(|numbers| numbers.try_into().ok());
    shape.ok_or_else(|| format!("{text:?} is not like 26x256x256"))
}

fn count(engine: Engine, what: &str, options: &Options) {
    if what == "product" {
        let [rows, inputs, outputs] = options.shape;
        let product = Product { rows, inputs, outputs, threads: 1, seconds: 0.0 };
        return engine.kernel.run(Counted(product, options.times)).unwrap();
    }
    // What a scene lets a step leave out is no gain: it sees all units, in whole steps.
    let all = with_scope("edge".as_ref(), rigidformer_weights::EDGE, Scope::All).unwrap();
    let all = quantise("edge".as_ref(), &all, &Precision::I8.into()).unwrap();
    let (loaded, bodies) = (loaded(&all.file), Bodies::grid(&[64; 10]));
    let engine = Engine { threads: engine.threads.whole(), ..engine };
    let mut world = World::on(engine, &loaded, bodies.limits(), 1).unwrap();
    bodies.observe(&mut world);
    world.step().unwrap();
    for _ in 0..options.times {
        rigidformer_counted(&mut Body(&mut || {
            world.step().unwrap();
        }));
    }
}

fn machine() -> String {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    format!("{}, {cores} cores", model.map_or(std::env::consts::ARCH, |(_, name)| name))
}

/// Runs `body` on so many threads at once; seconds of the slowest.
fn together(threads: usize, body: impl Fn(usize) + Sync) -> f64 {
    let start = Instant::now();
    std::thread::scope(|scope| {
        for thread in 0..threads {
            let body = &body;
            scope.spawn(move || body(thread));
        }
    });
    start.elapsed().as_secs_f64()
}

fn best(body: impl Fn() -> f64) -> f64 {
    (0..5).map(|_| body()).fold(0.0, f64::max)
}

fn int8_ceiling(kernel: Kernel, threads: usize) -> Option<[f64; 2]> {
    let each = kernel.ceiling(1)? as f64;
    let rate = |threads: usize| {
        best(|| {
            let seconds = together(threads, |_| {
                kernel.ceiling(5_000_000);
            });
            threads as f64 * each * 5e6 / seconds / 1e9
        })
    };
    Some([rate(1), rate(threads)])
}

fn memory_ceiling(threads: usize) -> [f64; 2] {
    let numbers = vec![1_u64; 32 << 20];
    let rate = |threads: usize| {
        best(|| {
            let seconds = together(threads, |thread| {
                let part = numbers.len() / threads;
                let mine = &numbers[thread * part..][..part];
                let sum: [u64; 16] = mine.chunks_exact(16).fold([0; 16], |mut sum, chunk| {
                    for (sum, number) in sum.iter_mut().zip(chunk) {
                        *sum = sum.wrapping_add(*number);
                    }
                    sum
                });
                std::hint::black_box(sum);
            });
            numbers.len() as f64 * 8.0 / seconds / 1e9
        })
    };
    [rate(1), rate(threads)]
}

impl Bench {
    /// Whether a workload, or one of a group that begins with `name`, is asked for.
    fn wants(&self, name: &str) -> bool {
        let mut only = self.options.only.iter();
        self.options.only.is_empty()
            || only.any(|only| name.contains(only) || only.starts_with(name))
    }

    fn row(&mut self, workload: &str, stage: &str, times: &Times, macs: f64) {
        let (median, p99) = (times.median(), times.at(0.99));
        let rate = macs / median / 1e6;
        let share = match self.ceilings.int8 {
            Some([_, all]) if macs > 0.0 => format!("{:5.1} %", 100.0 * rate / all),
            _ => String::new(),
        };
        let rate_text = if macs > 0.0 { format!("{rate:7.1} GMAC/s") } else { String::new() };
        println!(
            "{workload:<24} {stage:<12} {median:9.3} ms  p99 {p99:9.3} ms  {rate_text} {share}"
        );
        self.rows.push(json!({
            "workload": workload, "engine": "rigidformer-int8", "stage": stage,
            "median_ms": median, "p99_ms": p99, "runs": times.0.len(), "gmac_per_s": rate,
        }));
    }

    /// int8 products with row quantisation and epilogue, f32 in and out.
    fn products(&mut self) {
        if !self.wants("gemm") {
            return;
        }
        for threads in [1, self.engine.threads.count()] {
            for (rows, inputs, outputs) in SHAPES {
                let task =
                    Product { rows, inputs, outputs, threads, seconds: self.options.seconds / 3.0 };
                let times = self.pool(threads, |kernel| kernel.run(task)).unwrap();
                let name = format!("gemm {rows}x{inputs}x{outputs}");
                let macs = (rows * inputs * outputs) as f64;
                self.row(&name, &format!("{threads} thread(s)"), &times, macs);
            }
        }
    }

    /// Inside the pool, so that sharing work out wakes nobody up.
    fn pool<R: Send>(&self, threads: usize, body: impl FnOnce(Kernel) -> R + Send) -> R {
        let kernel = self.engine.kernel;
        if threads == 1 { body(kernel) } else { rayon::scope(|_| body(kernel)) }
    }

    fn steps(&mut self) {
        if self.wants("W-edge") {
            self.step("W-edge", &edge(), &Bodies::grid(&[64; 10]));
        }
        if self.wants("W-paper") {
            self.step("W-paper", &paper(), &Bodies::grid(&scenes::PAPER));
        }
        if self.wants("W-wreck-edge") {
            self.step("W-wreck-edge", &edge(), &Bodies::wreck(217));
        }
        if self.wants("W-wreck-paper") {
            self.step("W-wreck-paper", &paper(), &Bodies::wreck(217));
        }
    }

    fn step(&mut self, name: &str, loaded: &LoadedModel, bodies: &Bodies) {
        let macs = macs(loaded.model(), bodies.points.len(), bodies.total());
        let seconds = self.options.seconds;
        let all = self.engine.threads.count();
        for threads in if all > 1 { vec![1, all] } else { vec![1] } {
            let engine = Engine { threads: Threads::new(threads), ..self.engine };
            let (as_it_comes, _) = measure(engine, loaded, bodies, seconds);
            let engine = Engine { threads: engine.threads.whole(), ..engine };
            let (whole, stages) = measure(engine, loaded, bodies, seconds);
            for (stage, times) in STAGES.iter().zip(&stages) {
                self.row(name, &format!("{stage:?}"), times, 0.0);
            }
            self.row(name, &format!("step x{threads}"), &whole, macs);
            self.row(name, &format!("as it comes x{threads}"), &as_it_comes, 0.0);
        }
    }

    fn futures(&mut self) {
        if !self.wants("W-futures") {
            return;
        }
        let loaded = edge();
        let macs = macs(loaded.model(), 10, 640) * (FUTURES * STEPS) as f64;
        for units in [10, 64, 128, 256, 512] {
            let name = format!("W-futures, {units} units");
            if !self.wants(&name) {
                continue;
            }
            let mut run = futures(self.engine, &loaded, units);
            let times = Times::of(self.options.seconds, &mut run);
            self.row(&name, "10 steps", &times, macs);
            println!(
                "{:<24} {:.0} futures/s, p99/p50 {:.3}",
                "",
                FUTURES as f64 / times.median() * 1e3,
                times.at(0.99) / times.median()
            );
        }
    }

    /// Step time against the number of units, with the exponent between neighbours.
    fn wreck_curve(&mut self) {
        if !self.wants("curve") {
            return;
        }
        let loaded = edge();
        let mut last: Option<(f64, f64)> = None;
        for units in [10, 20, 40, 80, 160, 217] {
            let bodies = Bodies::wreck(units);
            let seconds = self.options.seconds / 2.0;
            let (times, _) = measure(self.engine, &loaded, &bodies, seconds);
            self.row(
                &format!("curve, {units} units"),
                "step",
                &times,
                macs(loaded.model(), units, bodies.total()),
            );
            let here = (units as f64, times.median());
            if let Some((units, before)) = last {
                println!(
                    "{:<24} exponent {:.2}",
                    "",
                    (here.1 / before).ln() / (here.0 / units).ln()
                );
            }
            last = Some(here);
        }
    }

    /// Ten units in a heap, alone and with others that touch nothing.
    fn sparse(&mut self) {
        if !self.wants("sparse") {
            return;
        }
        let loaded = edge();
        for (name, others, lying) in [
            ("sparse, 10 units", 0, false),
            ("sparse, and 207 that fly", 207, false),
            ("sparse, and 207 that lie", 207, true),
        ] {
            let bodies = Bodies::sparse(10, others, lying);
            let (times, stages) = measure(self.engine, &loaded, &bodies, self.options.seconds);
            for (stage, times) in STAGES.iter().zip(&stages) {
                self.row(name, &format!("{stage:?}"), times, 0.0);
            }
            self.row(name, "as it comes", &times, 0.0);
        }
    }

    /// From a file in the page cache to the end of the first step.
    fn load(&mut self) {
        if !self.wants("load") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("paper.rfm");
        let file = random::random("paper", &random::PAPER, Precision::I8, 1).unwrap();
        std::fs::write(&path, &file).unwrap();
        drop(file);
        // In processes of their own, which have done nothing else.
        let mut times = Vec::new();
        let mut memory = String::new();
        for _ in 0..9 {
            let this = std::env::current_exe().unwrap();
            let ran = std::process::Command::new(this).arg("--load").arg(&path).output().unwrap();
            let text = String::from_utf8(ran.stdout).unwrap();
            let (time, peak) = text.trim().split_once(' ').unwrap();
            times.push(time.parse().unwrap());
            memory = peak.into();
        }
        times.sort_by(f64::total_cmp);
        self.row("load paper", "first step", &Times(times), 0.0);
        println!("{:<24} peak memory {memory} MB", "");
    }
}

const FUTURES: usize = 256;
const STEPS: usize = 10;

/// Runs futures of a scene, so many units in a lockstep.
fn futures(engine: Engine, loaded: &LoadedModel, units: usize) -> impl FnMut() + use<> {
    let simulator = BatchSimulator::new(engine, loaded).with_units_a_chunk(units);
    let bodies = Bodies::grid(&[64; 10]);
    let noise = VelocityNoise { seed: 1, linear_m_s: 0.2, angular_rad_s: 0.5 };
    let mut out = vec![Isometry3::identity(); FUTURES * STEPS * 10];
    move || {
        let units = bodies.units();
        let start = Start { dt_s: scenes::DT_S, units: &units, ..Start::default() };
        simulator.run(&start, STEPS, &noise, &mut out).unwrap();
    }
}

/// Milliseconds from opening a model to the end of the first step of W-paper.
fn first_step(engine: Engine, path: &Path) -> f64 {
    let bodies = Bodies::grid(&scenes::PAPER);
    let start = Instant::now();
    let loaded = LoadedModel::open(path).unwrap();
    let mut world = World::on(engine, &loaded, bodies.limits(), 1).unwrap();
    bodies.observe(&mut world);
    world.step().unwrap();
    start.elapsed().as_secs_f64() * 1e3
}

fn peak_memory_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak =
        status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.split_whitespace().next());
    peak.and_then(|kb| kb.parse::<f64>().ok()).unwrap_or(f64::NAN) / 1e3
}

/// Times of whole steps and of their stages. All of them inside the pool, so that no step waits to get there.
fn measure(
    engine: Engine,
    loaded: &LoadedModel,
    bodies: &Bodies,
    seconds: f64,
) -> (Times, Vec<Times>) {
    let mut world = World::on(engine, loaded, bodies.limits(), 1).unwrap();
    engine.enter(|| measure_here(&mut world, bodies, 5, seconds))
}

/// At least so many steps, for so many seconds.
fn measure_here(
    world: &mut World,
    bodies: &Bodies,
    least: usize,
    seconds: f64,
) -> (Times, Vec<Times>) {
    let mut stages: [Vec<f64>; 6] = Default::default();
    let mut whole = Vec::new();
    let until = Instant::now() + Duration::from_secs_f64(seconds);
    let mut count = 0;
    while whole.len() < least || Instant::now() < until {
        // Random weights send bodies anywhere; the search should see a scene.
        if count % 4 == 0 {
            bodies.observe(world);
        }
        let start = Instant::now();
        let mut clock = Clock::default();
        world.step_traced(&mut clock).unwrap();
        clock.stop();
        count += 1;
        // Twice to warm up.
        if count > 2 {
            whole.push(start.elapsed().as_secs_f64() * 1e3);
            stages.iter_mut().zip(clock.spent).for_each(|(times, spent)| times.push(spent));
        }
    }
    let sorted = |mut times: Vec<f64>| {
        times.sort_by(f64::total_cmp);
        Times(times)
    };
    (sorted(whole), stages.into_iter().map(sorted).collect())
}

/// The committed edge model as int8 in panels; it corrects scenes of any size.
fn edge() -> LoadedModel {
    let any = with_rules("edge".as_ref(), rigidformer_weights::EDGE, 0).unwrap();
    let packed = quantise("edge".as_ref(), &any, &Precision::I8.into()).unwrap();
    loaded(&packed.file)
}

/// The preset `paper` with random weights, as int8 in panels.
fn paper() -> LoadedModel {
    loaded(&random::random("paper", &random::PAPER, Precision::I8, 1).unwrap())
}

fn loaded(bytes: &[u8]) -> LoadedModel {
    LoadedModel::copy_of("bench.rfm", bytes).unwrap().for_host().unwrap()
}

/// Multiply-accumulates of the matrix products of a step, attention's not among them.
fn macs(model: &Model<'_>, units: usize, points: usize) -> f64 {
    let c = model.config();
    let [first, second] = c.point_hidden();
    let chain = match second {
        0 => c.features.len() as u32 * first + first * c.point_width,
        _ => c.features.len() as u32 * first + first * second + second * c.point_width,
    };
    let (width, inner) = (f64::from(c.width), f64::from(c.heads * c.head_dim));
    let (tokens, anchors) = (units as f64 + f64::from(c.registers), 4.0 * units as f64);
    let fuse = f64::from(c.fuse_hidden()) * (8.0 * f64::from(c.point_width) + width);
    let block = width * 5.0 * inner + 3.0 * width * f64::from(c.feed_forward_width);
    let scales = c.scales.len() as f64;
    let avp = f64::from(c.avp_width * (c.point_width + c.avp_width));
    let query = (3.0 + c.features.len() as f64 + f64::from(c.avp_width)) * width + width * width;
    let anchor =
        avp + query + scales * (2.0 * width * inner + inner * width) + width * width + 3.0 * width;
    points as f64 * f64::from(chain)
        + units as f64 * (fuse + scales * 2.0 * width * inner)
        + tokens * f64::from(c.blocks) * block
        + anchors * anchor
}

#[derive(Clone, Copy)]
struct Product {
    rows: usize,
    inputs: usize,
    outputs: usize,
    threads: usize,
    seconds: f64,
}

impl Run for Product {
    type Output = Times;

    fn run<K: HostKernels>(self, kernels: K) -> Times {
        let seconds = self.seconds;
        self.with(kernels, |body| Times::of(seconds, body))
    }
}

/// Counts a product, so many times.
struct Counted(Product, usize);

impl Run for Counted {
    type Output = ();

    fn run<K: HostKernels>(self, kernels: K) {
        self.0.with(kernels, |body| (0..self.1).for_each(|_| rigidformer_counted(&mut Body(body))));
    }
}

impl Product {
    fn with<K: HostKernels, R>(self, kernels: K, measure: impl FnOnce(&mut dyn FnMut()) -> R) -> R {
        let mut arrays = Arrays::new(self.rows, self.inputs, self.outputs);
        let kernels = Threaded::new(kernels, Threads::new(self.threads));
        measure(&mut || arrays.multiply(kernels))
    }
}

/// What a product reads and writes.
struct Arrays {
    inputs: usize,
    values: Vec<i8>,
    sums: Vec<i32>,
    scales: Vec<f32>,
    bias: Vec<f32>,
    x: Vec<f32>,
    quantised: Vec<i8>,
    row_scales: Vec<f32>,
    out: Vec<f32>,
}

impl Arrays {
    fn new(rows: usize, inputs: usize, outputs: usize) -> Self {
        let weights: Vec<i8> = (0..outputs * inputs).map(|i| (i * 37 % 255) as i8).collect();
        let weights: Vec<i8> = weights.into_iter().map(|w| w.max(-127)).collect();
        let (values, sums) = panels(&weights, outputs, inputs);
        Arrays {
            inputs,
            values,
            sums,
            scales: vec![0.01; outputs],
            bias: vec![0.5; outputs],
            x: (0..rows * inputs).map(|i| (i * 29 % 97) as f32 - 48.0).collect(),
            quantised: vec![0; scratch_bytes(inputs, rows)],
            row_scales: vec![0.0; rows],
            out: vec![0.0; rows * outputs],
        }
    }

    /// Quantises rows, multiplies, scales and adds biases.
    fn multiply(&mut self, schedule: impl Schedule) {
        let weight = Panels { values: &self.values, scales: &self.scales, sums: &self.sums };
        let mut scratch = Scratch { values: &mut self.quantised, scales: &mut self.row_scales };
        schedule.quantise(&self.x, self.inputs, &mut scratch);
        schedule.linear_panels(&mut scratch, weight, &self.bias, self.inputs, &mut self.out);
    }
}
