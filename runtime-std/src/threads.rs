//! Kernels on one thread or several: rows and output channels are shared out, never a reduction, so the bits do not change.

use half::f16;
use rigidformer_core::kernels::{Divisible, in_own_environment};
use rigidformer_core::quant::Scratch;
use rigidformer_core::weights::{PANEL, Panels};
use rigidformer_core::{Layout, Schedule, Tiles};

use crate::kernels::{Columns, HostKernels, Quantised, TILES as ONE_THREAD};
use crate::pool;

/// Threads that share a layer, at most.
// Buffers have a part for each thread, so their number is bounded.
const MAX_THREADS: usize = 16;
/// Rows that hosts take at a time.
const TILES: Tiles = Tiles { workers: MAX_THREADS, ..ONE_THREAD };

/// Multiply-accumulates below which one thread does an int8 product.
// A fork costs more than smaller products take; docs/PERFORMANCE.md has the measurement.
const MIN_WORK_I8: usize = 4 << 20;
/// The same for f32 and f16.
// They take longer a multiply-accumulate than int8, so a fork pays earlier.
const MIN_WORK_FLOAT: usize = 1 << 20;
/// Numbers below which one thread does elementwise work.
const MIN_NUMBERS: usize = 16 << 10;
/// Multiplications below which one thread fills all rows.
const MIN_WORK_ROWS: usize = 192 << 10;

/// Multiplications of a share of a scene, at least.
// A helper thread often wakes too late for less; a step of the edge model stays on one thread.
const MIN_WORK_SCENE: usize = 12 << 20;

/// How many threads of the current rayon pool may share the work of one layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Threads {
    count: usize,
    eager: Option<Grain>,
    takes_all: bool,
}

/// What threads share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Grain {
    Scenes,
    Layers,
}

impl Threads {
    /// One: for scenes that are on threads of their own.
    pub const ONE: Threads = Threads { count: 1, eager: None, takes_all: false };

    /// So many, from 1 to 16.
    pub fn new(count: usize) -> Self {
        Threads { count: count.clamp(1, MAX_THREADS), ..Threads::ONE }
    }

    /// Shares out scenes even where one thread is faster: for tests.
    pub fn eager(self) -> Self {
        Threads { eager: Some(Grain::Scenes), ..self }
    }

    /// Shares out layers, and not scenes, even where one thread is faster: for tests.
    pub fn eager_layers(self) -> Self {
        Threads { eager: Some(Grain::Layers), ..self }
    }

    /// Computes all of the network, with outputs that nothing reads: for measurements, and for steps of about equal duration.
    pub fn whole(self) -> Self {
        Threads { takes_all: true, ..self }
    }

    /// As many as the current rayon pool has, in a forked process as many as [`pool`] has. Call steps from inside the pool
    /// (`rayon::ThreadPool::install`): from outside, each layer waits for a thread to wake up.
    pub fn all() -> Self {
        Threads::new(pool::size())
    }

    /// A single one, with the same extent of steps.
    pub(crate) fn alone(self) -> Self {
        Threads { count: 1, eager: None, ..self }
    }

    /// An equal share of the threads for each of `sharers`, at least one.
    pub(crate) fn shared_by(self, sharers: usize) -> Self {
        Threads { count: (self.count / sharers.max(1)).max(1), ..self }
    }

    /// The same, or fewer where `others` are fewer.
    pub(crate) fn at_most(self, others: Threads) -> Self {
        Threads { count: self.count.min(others.count), ..self }
    }

    /// How many.
    pub fn count(self) -> usize {
        self.count
    }
}

/// Kernels `K` on several threads.
#[derive(Clone, Copy, Debug)]
pub struct Threaded<K> {
    kernels: K,
    threads: Threads,
}

impl<K: HostKernels> Threaded<K> {
    /// Shares the work of `kernels` out.
    pub fn new(kernels: K, threads: Threads) -> Self {
        Threaded { kernels, threads }
    }

    /// Number of shares that so much work is worth.
    fn share_count(&self, work: usize, least: usize) -> usize {
        let Threads { count, eager, .. } = self.threads;
        (work / if eager.is_some() { 1 } else { least }).clamp(1, count)
    }

    /// As [`Schedule::share`], in `shares`, each on a thread of its own.
    fn share_scene<P: Divisible, R: Send>(
        self,
        shares: usize,
        whole: P,
        run: &(impl Fn(Self, P) -> R + Sync),
        merge: &(impl Fn(R, R) -> R + Sync),
    ) -> R {
        if shares < 2 {
            return run(Threaded { threads: self.threads.alone(), ..self }, whole);
        }
        let left = shares / 2;
        let [one, other] = whole.split(left, shares);
        let (one, other) = join(
            || self.share_scene(left, one, run, merge),
            || self.share_scene(shares - left, other, run, merge),
        );
        merge(one, other)
    }

    fn multiply(
        self,
        shares: usize,
        x: Quantised<'_>,
        weight: Panels<'_>,
        bias: &[f32],
        out: Columns<'_>,
    ) {
        let panels = weight.scales.len().div_ceil(PANEL);
        // A panel is the smallest unit of weights.
        if shares < 2 || panels < 2 {
            return self.kernels.multiply(x, weight, bias, out);
        }
        let left = shares / 2;
        // Kernels take tiles of up to four panels, so shares are multiples of four where there are enough panels.
        let unit = if panels >= 4 * shares { 4 } else { 1 };
        let at = (panels * left / shares).next_multiple_of(unit).min(panels - 1);
        let channels = at * PANEL;
        let (values, more_values) = weight.values.split_at(channels * x.inputs.next_multiple_of(4));
        let (scales, more_scales) = weight.scales.split_at(channels);
        let (sums, more_sums) = weight.sums.split_at(channels);
        let (bias, more_bias) = bias.split_at(channels.min(bias.len()));
        let (out, more_out) = out.split_at(channels);
        let first = Panels { values, scales, sums };
        let second = Panels { values: more_values, scales: more_scales, sums: more_sums };
        join(
            || self.multiply(left, x, first, bias, out),
            || self.multiply(shares - left, x, second, more_bias, more_out),
        );
    }
}

/// Both, perhaps on two threads, which compute to nearest whatever their creator had set.
fn join<A: Send, B: Send>(
    one: impl FnOnce() -> A + Send,
    other: impl FnOnce() -> B + Send,
) -> (A, B) {
    pool::join(|| in_own_environment(one), || in_own_environment(other))
}

/// Splits the rows of two matrices in `shares` and calls `work` on each.
fn share_rows<A: Sync, B: Send>(
    shares: usize,
    (from, inputs): (&[A], usize),
    (to, outputs): (&mut [B], usize),
    work: &(impl Fn(&[A], &mut [B]) + Sync),
) {
    let rows = from.len() / inputs.max(1);
    if shares < 2 || rows < 2 {
        return work(from, to);
    }
    let left = (rows * (shares / 2) / shares).max(1);
    let (from, more_from) = from.split_at(left * inputs);
    let (to, more_to) = to.split_at_mut((left * outputs).min(to.len()));
    join(
        || share_rows(shares / 2, (from, inputs), (to, outputs), work),
        || share_rows(shares - shares / 2, (more_from, inputs), (more_to, outputs), work),
    );
}

/// Splits rows in `shares`, with a section of the scratch for each.
fn share_filling(
    shares: usize,
    first: usize,
    (matrix, width): (&mut [f32], usize),
    scratch: &mut [f32],
    fill: &(impl Fn(usize, &mut [f32], &mut [f32]) + Sync),
) {
    let rows = matrix.len().div_ceil(width.max(1));
    if shares < 2 || rows < 2 {
        for (index, row) in matrix.chunks_mut(width.max(1)).enumerate() {
            fill(first + index, row, scratch);
        }
        return;
    }
    let left = (rows * (shares / 2) / shares).max(1);
    let (matrix, more) = matrix.split_at_mut(left * width);
    let (scratch, more_scratch) = scratch.split_at_mut(scratch.len() / shares * (shares / 2));
    join(
        || share_filling(shares / 2, first, (matrix, width), scratch, fill),
        || share_filling(shares - shares / 2, first + left, (more, width), more_scratch, fill),
    );
}

impl<K: HostKernels> Schedule for Threaded<K> {
    type Kernels = K;
    const LAYOUT: Layout = Layout { tiles: TILES, queries: K::QUERIES, index: true };

    fn kernels(self) -> K {
        self.kernels
    }

    fn linear_f32(self, x: &[f32], weight: &[f32], bias: &[f32], inputs: usize, out: &mut [f32]) {
        let outputs = weight.len() / inputs.max(1);
        let shares = self.share_count(x.len() * outputs, MIN_WORK_FLOAT);
        share_rows(shares, (x, inputs), (out, outputs), &|x, out| {
            self.kernels.linear_f32(x, weight, bias, inputs, out);
        });
    }

    fn linear_f16(self, x: &[f32], weight: &[f16], bias: &[f32], inputs: usize, out: &mut [f32]) {
        let outputs = weight.len() / inputs.max(1);
        let shares = self.share_count(x.len() * outputs, MIN_WORK_FLOAT);
        share_rows(shares, (x, inputs), (out, outputs), &|x, out| {
            self.kernels.linear_f16(x, weight, bias, inputs, out);
        });
    }

    fn quantise(self, x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
        let row_bytes = self.kernels.row_bytes(inputs);
        let rows = (x.len() / inputs.max(1))
            .min(scratch.scales.len())
            .min(scratch.values.len() / row_bytes.max(1));
        let half = rows / 2;
        if self.share_count(x.len(), MIN_NUMBERS) < 2 || half == 0 {
            return self.kernels.quantise(x, inputs, scratch);
        }
        let (x, more_x) = x.split_at(half * inputs);
        let (values, more_values) = scratch.values.split_at_mut(half * row_bytes);
        let (scales, more_scales) = scratch.scales.split_at_mut(half);
        let mut first = Scratch { values, scales };
        let mut second = Scratch { values: more_values, scales: more_scales };
        join(
            || self.kernels.quantise(x, inputs, &mut first),
            || self.kernels.quantise(more_x, inputs, &mut second),
        );
    }

    fn linear_panels(
        self,
        scratch: &mut Scratch<'_>,
        weight: Panels<'_>,
        bias: &[f32],
        inputs: usize,
        out: &mut [f32],
    ) {
        let shares = self.share_count(out.len() * inputs, MIN_WORK_I8);
        let x = Quantised { values: scratch.values, scales: scratch.scales, inputs };
        self.multiply(shares, x, weight, bias, Columns::new(out, weight.scales.len()));
    }

    fn each_row(
        self,
        matrix: &mut [f32],
        width: usize,
        cost: usize,
        scratch: &mut [f32],
        fill: impl Fn(usize, &mut [f32], &mut [f32]) + Sync,
    ) {
        let shares = self.share_count(matrix.len().div_ceil(width.max(1)) * cost, MIN_WORK_ROWS);
        share_filling(shares, 0, (matrix, width), scratch, &fill);
    }

    fn skips(self) -> bool {
        !self.threads.takes_all
    }

    fn shares(self) -> bool {
        self.threads.count > 1 && self.threads.eager != Some(Grain::Layers)
    }

    fn share<P: Divisible, R: Send>(
        self,
        work: usize,
        whole: P,
        run: &(impl Fn(Self, P) -> R + Sync),
        merge: &(impl Fn(R, R) -> R + Sync),
    ) -> R {
        match self.share_count(work, MIN_WORK_SCENE) {
            // One share takes the whole scene, and its layers may still be worth sharing.
            1 => run(self, whole),
            shares => self.share_scene(shares, whole, run, merge),
        }
    }

    fn silu(self, x: &mut [f32]) {
        let shares = self.share_count(x.len(), MIN_NUMBERS);
        if shares < 2 {
            return self.kernels.silu(x);
        }
        let (x, more) = x.split_at_mut(x.len() * (shares / 2) / shares);
        let [left, right] = [shares / 2, shares - shares / 2]
            .map(|count| Threaded { threads: Threads { count, ..self.threads }, ..self });
        join(|| left.silu(x), || right.silu(more));
    }
}
