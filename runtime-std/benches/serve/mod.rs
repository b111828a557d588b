//! Measures in slices, as `cargo xtask bench` asks for them: who takes turns with others neither starts nor packs in between.
//!
//! The first line of output is what there is. Then each line of input is a slice,
//! `{"workload": "W-edge", "stage": "step", "threads": 1, "seconds": 0.3}`, and answered with a line
//! `{"times_ms": [0.55, 0.56], "macs": 39e6}`. What a workload needs is kept until another group of workloads is asked for.

use std::collections::BTreeMap;
use std::io::{self, BufRead, Write};

use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::kernels::{HostKernels, Kernel, Run};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::{Threaded, Threads};
use rigidformer_runtime::world::World;
use rten_gemm::{GemmExecutor, GemmInputA, GemmInputB, GemmOptions};
use rten_tensor::NdTensorView;
use serde_json::{Value, json};

use crate::scenes::{self, Bodies};
use crate::{
    Arrays, FUTURES, SHAPES, STEPS, Times, edge, futures, macs, measure_here, paper, together,
};

/// The stage of products that has rten multiply.
const RTEN: &str = "rten";
/// Units in a lockstep: docs/PERFORMANCE.md has others.
const LOCKSTEP: usize = 128;
/// Scenes that are stepped.
const SCENES: [&str; 4] = ["W-edge", "W-paper", "W-wreck-edge", "W-wreck-paper"];
/// Rounds of the ceiling's loop between looks at the clock.
const ROUNDS: u64 = 500_000;

/// Answers until the input ends.
pub(crate) fn serve(engine: Engine) {
    let threads = engine.threads.count();
    let counts = if threads > 1 { vec![1, threads] } else { vec![1] };
    let mut workloads = Vec::new();
    for (rows, inputs, outputs) in SHAPES {
        let name = format!("gemm {rows}x{inputs}x{outputs}");
        workloads
            .push(json!({"name": name, "group": "gemm", "stage": "product", "threads": counts}));
    }
    for name in SCENES {
        workloads.push(json!({"name": name, "group": name, "stage": "step", "threads": counts}));
        workloads
            .push(json!({"name": name, "group": name, "stage": "as it comes", "threads": counts}));
    }
    let name = format!("W-futures, {LOCKSTEP} units");
    workloads.push(json!({"name": name, "group": name, "stage": "10 steps", "threads": [threads]}));
    let (kernel, instruction) = (engine.kernel.name(), engine.kernel.instruction());
    say(
        &json!({"kernel": kernel, "instruction": instruction, "threads": threads, "workloads": workloads}),
    );
    let mut served = Served { engine, group: String::new(), model: None, bodies: BTreeMap::new() };
    for line in io::stdin().lock().lines() {
        let request: Value = serde_json::from_str(&line.unwrap()).unwrap();
        say(&served.slice(&request));
    }
}

fn say(line: &Value) {
    let mut out = io::stdout().lock();
    writeln!(out, "{line}").unwrap();
    out.flush().unwrap();
}

/// One slice: milliseconds of runs for so many seconds.
type Slice = Box<dyn FnMut(f64) -> Vec<f64>>;

/// What the present group of workloads needs.
struct Served {
    engine: Engine,
    group: String,
    model: Option<LoadedModel>,
    /// By workload, stage and threads, with the multiply-accumulates of a run.
    bodies: BTreeMap<(String, String, usize), (Slice, f64)>,
}

impl Served {
    fn slice(&mut self, request: &Value) -> Value {
        let text = |name: &str| request[name].as_str().unwrap_or_default().to_owned();
        let (workload, stage) = (text("workload"), text("stage"));
        let threads = request["threads"].as_u64().unwrap_or(1) as usize;
        let seconds = request["seconds"].as_f64().unwrap_or(0.3);
        if stage == "ceiling" {
            let rate = ceiling_rate(self.engine.kernel, threads, seconds);
            return json!({"gmac_per_s": rate});
        }
        let group = workload.split(' ').next().unwrap_or_default();
        if self.group != group {
            self.bodies.clear();
            self.model = None;
            self.group = group.to_owned();
        }
        let key = (workload.clone(), stage.clone(), threads);
        if !self.bodies.contains_key(&key) {
            let Some(made) = self.make(&workload, &stage, threads) else {
                return json!({"absent": format!("no {stage} of {workload}")});
            };
            self.bodies.insert(key.clone(), made);
        }
        let (body, macs) = self.bodies.get_mut(&key).unwrap();
        json!({"times_ms": body(seconds), "macs": *macs})
    }

    fn make(&mut self, workload: &str, stage: &str, threads: usize) -> Option<(Slice, f64)> {
        if let Some(shape) = workload.strip_prefix("gemm ") {
            let [rows, inputs, outputs] = crate::shape(shape).ok()?;
            let shape = [rows, inputs, outputs];
            let slice =
                if stage == RTEN { rten(shape, threads) } else { self.product(shape, threads) };
            return Some((slice, (rows * inputs * outputs) as f64));
        }
        let engine = Engine { threads: Threads::new(threads), ..self.engine };
        let model = self.model.get_or_insert_with(|| match workload.ends_with("paper") {
            true => paper(),
            false => edge(),
        });
        if workload.starts_with("W-futures") {
            let macs = macs(model.model(), 10, 640) * (FUTURES * STEPS) as f64;
            let mut run = futures(engine, model, LOCKSTEP);
            return Some((Box::new(move |seconds| Times::at_least(1, seconds, &mut run).0), macs));
        }
        let bodies = match workload {
            "W-edge" => Bodies::grid(&[64; 10]),
            "W-paper" => Bodies::grid(&scenes::PAPER),
            "W-wreck-edge" | "W-wreck-paper" => Bodies::wreck(217),
            _ => return None,
        };
        let engine = match stage {
            "step" => Engine { threads: engine.threads.whole(), ..engine },
            "as it comes" => engine,
            _ => return None,
        };
        let macs = macs(model.model(), bodies.points.len(), bodies.total());
        let mut world = World::on(engine, model, bodies.limits(), 1).unwrap();
        let slice =
            move |seconds| engine.enter(|| measure_here(&mut world, &bodies, 1, seconds).0.0);
        Some((Box::new(slice), macs))
    }

    fn product(&self, [rows, inputs, outputs]: [usize; 3], threads: usize) -> Slice {
        let kernel = self.engine.kernel;
        let mut arrays = Arrays::new(rows, inputs, outputs);
        Box::new(move |seconds| {
            let task = Timed { arrays: &mut arrays, threads, seconds };
            // Inside the pool, so that sharing work out wakes nobody up.
            let run = || kernel.run(task).unwrap();
            if threads == 1 { run() } else { rayon::scope(|_| run()) }
        })
    }
}

/// rten's product alone, of weights that are packed before: integers in and out, neither quantised nor scaled, so that it has less to do
/// than ours.
fn rten([rows, inputs, outputs]: [usize; 3], threads: usize) -> Slice {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let gemm = GemmExecutor::<u8, i8, i32>::new();
    let weights: Vec<i8> = (0..inputs * outputs).map(|i| (i % 255) as i8).collect();
    let weights = NdTensorView::from_data([inputs, outputs], &weights[..]);
    let packed = gemm.prepack_b(weights);
    let x: Vec<u8> = (0..rows * inputs).map(|i| (i * 29 % 97) as u8).collect();
    let mut out = vec![0; rows * outputs];
    Box::new(move |seconds| {
        pool.install(|| {
            let times = Times::at_least(1, seconds, || {
                let x = NdTensorView::from_data([rows, inputs], &x[..]);
                let (x, weights) = (GemmInputA::Unpacked(x), GemmInputB::Packed(&packed));
                gemm.gemm(&mut out, x, weights, GemmOptions::default()).unwrap();
            });
            times.0
        })
    })
}

/// A slice of products.
struct Timed<'a> {
    arrays: &'a mut Arrays,
    threads: usize,
    seconds: f64,
}

impl Run for Timed<'_> {
    type Output = Vec<f64>;

    fn run<K: HostKernels>(self, kernels: K) -> Vec<f64> {
        let kernels = Threaded::new(kernels, Threads::new(self.threads));
        Times::at_least(1, self.seconds, || self.arrays.multiply(kernels)).0
    }
}

/// What so many threads reach together with registers alone, in GMAC/s, or none where that is not known.
fn ceiling_rate(kernel: Kernel, threads: usize, seconds: f64) -> Option<f64> {
    let each = kernel.ceiling(1)? as f64 * ROUNDS as f64;
    let times = Times::at_least(1, seconds, || {
        together(threads, |_| {
            kernel.ceiling(ROUNDS);
        });
    });
    Some(threads as f64 * each / times.median() / 1e6)
}
