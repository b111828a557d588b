//! Kernels on one thread or several: rows and output channels are shared out, never a reduction, so the bits do not change.

use half::f16;
use rigidformer_core::kernels::Divisible;
use rigidformer_core::quant::Scratch;
use rigidformer_core::weights::{PANEL, Panels};
use rigidformer_core::{Layout, Schedule, Tiles};

use crate::kernels::{Columns, HostKernels, Quantised};

/// Threads that share a layer, at most.
const MOST: usize = 16;
/// What hosts take at a time: caches are large, reading weights again is not cheap.
const TILES: Tiles = Tiles { points: 128, anchor_units: 256, rows: 256, workers: MOST };

/// Multiply-accumulates below which int8 products are not shared out: docs/PERFORMANCE.md has the measurement.
const LEAST_I8: usize = 4 << 20;
/// The same for f32 and f16.
const LEAST_WIDE: usize = 1 << 20;
/// Numbers below which elementwise work is not shared out.
const LEAST_NUMBERS: usize = 16 << 10;
/// Multiplications below which rows are not shared out.
const LEAST_ROWS: usize = 192 << 10;

/// Multiplications below which parts of a scene are not shared out.
const LEAST_SHARED: usize = 12 << 20;

/// How many threads of the current rayon pool may share the work of one layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Threads {
    count: usize,
    eager: Option<Grain>,
    is_whole: bool,
}

/// What is shared out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Grain {
    Scenes,
    Layers,
}

impl Threads {
    /// One: for scenes that are on threads of their own.
    pub const ONE: Threads = Threads { count: 1, eager: None, is_whole: false };

    /// So many, from 1 to 16.
    pub fn new(count: usize) -> Self {
        Threads { count: count.clamp(1, MOST), ..Threads::ONE }
    }

    /// Shares out parts of scenes also where that is done sooner alone: for tests.
    pub fn eager(self) -> Self {
        Threads { eager: Some(Grain::Scenes), ..self }
    }

    /// Shares out layers, and no parts of scenes, also where that is done sooner alone: for tests.
    pub fn eager_layers(self) -> Self {
        Threads { eager: Some(Grain::Layers), ..self }
    }

    /// Takes whole steps, with parts of the network that nobody reads: for measurements, and for those who want each step to take
    /// about the same time.
    pub fn whole(self) -> Self {
        Threads { is_whole: true, ..self }
    }

    /// As many as the current rayon pool has. Call steps from inside the pool (`rayon::ThreadPool::install`): from
    /// outside each layer would wait for a thread to wake up.
    pub fn all() -> Self {
        Threads::new(rayon::current_num_threads())
    }

    /// One of them, which takes whole steps where they do.
    pub(crate) fn alone(self) -> Self {
        Threads { count: 1, eager: None, ..self }
    }

    /// An equal share of them for each of so many, at least one thread; else as they are.
    pub(crate) fn shared_by(self, sharers: usize) -> Self {
        Threads { count: (self.count / sharers.max(1)).max(1), ..self }
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

    /// Parts that so much work is worth.
    fn parts(&self, work: usize, least: usize) -> usize {
        let Threads { count, eager, .. } = self.threads;
        (work / if eager.is_some() { 1 } else { least }).clamp(1, count)
    }

    /// As [`Schedule::share`], in `parts`, each on a thread of its own.
    fn share_parts<P: Divisible, R: Send>(
        self,
        parts: usize,
        whole: P,
        run: &(impl Fn(Self, P) -> R + Sync),
        merge: &(impl Fn(R, R) -> R + Sync),
    ) -> R {
        if parts < 2 {
            return run(Threaded { threads: self.threads.alone(), ..self }, whole);
        }
        let left = parts / 2;
        let [one, other] = whole.split(left, parts);
        let (one, other) = rayon::join(
            || self.share_parts(left, one, run, merge),
            || self.share_parts(parts - left, other, run, merge),
        );
        merge(one, other)
    }

    fn multiply(
        self,
        parts: usize,
        x: Quantised<'_>,
        weight: Panels<'_>,
        bias: &[f32],
        out: Columns<'_>,
    ) {
        let panels = weight.scales.len().div_ceil(PANEL);
        if parts < 2 || panels < 2 {
            return self.kernels.multiply(x, weight, bias, out);
        }
        let left = parts / 2;
        // Whole register tiles of four panels where there are enough.
        let unit = if panels >= 4 * parts { 4 } else { 1 };
        let at = (panels * left / parts).next_multiple_of(unit).min(panels - 1);
        let channels = at * PANEL;
        let (values, more_values) = weight.values.split_at(channels * x.inputs.next_multiple_of(4));
        let (scales, more_scales) = weight.scales.split_at(channels);
        let (sums, more_sums) = weight.sums.split_at(channels);
        let (bias, more_bias) = bias.split_at(channels.min(bias.len()));
        let (out, more_out) = out.split_at(channels);
        let first = Panels { values, scales, sums };
        let second = Panels { values: more_values, scales: more_scales, sums: more_sums };
        rayon::join(
            || self.multiply(left, x, first, bias, out),
            || self.multiply(parts - left, x, second, more_bias, more_out),
        );
    }
}

/// Splits rows of two matrices in `parts` and calls `work` on each.
fn share_rows<A: Sync, B: Send>(
    parts: usize,
    (from, inputs): (&[A], usize),
    (to, outputs): (&mut [B], usize),
    work: &(impl Fn(&[A], &mut [B]) + Sync),
) {
    let rows = from.len() / inputs.max(1);
    if parts < 2 || rows < 2 {
        return work(from, to);
    }
    let left = (rows * (parts / 2) / parts).max(1);
    let (from, more_from) = from.split_at(left * inputs);
    let (to, more_to) = to.split_at_mut((left * outputs).min(to.len()));
    rayon::join(
        || share_rows(parts / 2, (from, inputs), (to, outputs), work),
        || share_rows(parts - parts / 2, (more_from, inputs), (more_to, outputs), work),
    );
}

/// Splits rows in `parts`, with a part of the scratch for each.
fn share_filling(
    parts: usize,
    first: usize,
    (matrix, width): (&mut [f32], usize),
    scratch: &mut [f32],
    fill: &(impl Fn(usize, &mut [f32], &mut [f32]) + Sync),
) {
    let rows = matrix.len().div_ceil(width.max(1));
    if parts < 2 || rows < 2 {
        for (index, row) in matrix.chunks_mut(width.max(1)).enumerate() {
            fill(first + index, row, scratch);
        }
        return;
    }
    let left = (rows * (parts / 2) / parts).max(1);
    let (matrix, more) = matrix.split_at_mut(left * width);
    let (scratch, more_scratch) = scratch.split_at_mut(scratch.len() / parts * (parts / 2));
    rayon::join(
        || share_filling(parts / 2, first, (matrix, width), scratch, fill),
        || share_filling(parts - parts / 2, first + left, (more, width), more_scratch, fill),
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
        let parts = self.parts(x.len() * outputs, LEAST_WIDE);
        share_rows(parts, (x, inputs), (out, outputs), &|x, out| {
            self.kernels.linear_f32(x, weight, bias, inputs, out);
        });
    }

    fn linear_f16(self, x: &[f32], weight: &[f16], bias: &[f32], inputs: usize, out: &mut [f32]) {
        let outputs = weight.len() / inputs.max(1);
        let parts = self.parts(x.len() * outputs, LEAST_WIDE);
        share_rows(parts, (x, inputs), (out, outputs), &|x, out| {
            self.kernels.linear_f16(x, weight, bias, inputs, out);
        });
    }

    fn quantise(self, x: &[f32], inputs: usize, scratch: &mut Scratch<'_>) {
        let row_bytes = self.kernels.row_bytes(inputs);
        let rows = (x.len() / inputs.max(1))
            .min(scratch.scales.len())
            .min(scratch.values.len() / row_bytes.max(1));
        let half = rows / 2;
        if self.parts(x.len(), LEAST_NUMBERS) < 2 || half == 0 {
            return self.kernels.quantise(x, inputs, scratch);
        }
        let (x, more_x) = x.split_at(half * inputs);
        let (values, more_values) = scratch.values.split_at_mut(half * row_bytes);
        let (scales, more_scales) = scratch.scales.split_at_mut(half);
        let mut first = Scratch { values, scales };
        let mut second = Scratch { values: more_values, scales: more_scales };
        rayon::join(
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
        let parts = self.parts(out.len() * inputs, LEAST_I8);
        let x = Quantised { values: scratch.values, scales: scratch.scales, inputs };
        self.multiply(parts, x, weight, bias, Columns::new(out, weight.scales.len()));
    }

    fn each_row(
        self,
        matrix: &mut [f32],
        width: usize,
        cost: usize,
        scratch: &mut [f32],
        fill: impl Fn(usize, &mut [f32], &mut [f32]) + Sync,
    ) {
        let parts = self.parts(matrix.len().div_ceil(width.max(1)) * cost, LEAST_ROWS);
        share_filling(parts, 0, (matrix, width), scratch, &fill);
    }

    fn skips(self) -> bool {
        !self.threads.is_whole
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
        match self.parts(work, LEAST_SHARED) {
            // Its layers may be worth sharing out.
            1 => run(self, whole),
            parts => self.share_parts(parts, whole, run, merge),
        }
    }

    fn silu(self, x: &mut [f32]) {
        let parts = self.parts(x.len(), LEAST_NUMBERS);
        if parts < 2 {
            return self.kernels.silu(x);
        }
        let (x, more) = x.split_at_mut(x.len() * (parts / 2) / parts);
        let [left, right] = [parts / 2, parts - parts / 2]
            .map(|count| Threaded { threads: Threads { count, ..self.threads }, ..self });
        rayon::join(|| left.silu(x), || right.silu(more));
    }
}
