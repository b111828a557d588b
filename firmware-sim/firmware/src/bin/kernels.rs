//! The kernels of the processor against the portable ones, bit by bit, over sizes that straddle every tile and
//! numbers that are at the edge; then what they cost, in instructions.
#![no_std]
#![no_main]

use core::hint::black_box;

use half::f16;
use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::geometry::Pose;
use rigidformer_core::kernels::Rows;
use rigidformer_core::quant::{Scratch, TILE, scratch_bytes};
use rigidformer_core::{Kernels, Native, Portable};
use rigidformer_firmware::counter::Counter;
use rigidformer_firmware::image;

/// Most numbers of a list.
const NUMBERS: usize = 10_240;
/// Numbers behind a result that must stay as they are.
// Two vectors of Helium: what a kernel writes beyond its end falls there.
const BEHIND: usize = 8;
/// What stands there.
const UNTOUCHED: f32 = 5.5;
/// Most inputs of an int8 layer here.
const WIDEST: usize = 520;

/// Room for one case.
struct Lists {
    x: [f32; NUMBERS],
    w: [f32; NUMBERS],
    int8: [i8; 70_000],
    half: [f16; 2_500],
    outs: [[f32; NUMBERS]; 2],
    bytes: [[i8; scratch_bytes(WIDEST, TILE) + 4]; 2],
    random: Random,
    /// FNV-1a of all results.
    digest: u64,
    cases: u32,
}

/// A linear congruential generator.
struct Random(u32);

impl Random {
    fn next(&mut self) -> usize {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        // The low bits of a linear congruential generator repeat soon.
        (self.0 >> 8) as usize
    }

    /// From -1 to 1.
    fn number(&mut self) -> f32 {
        self.next() as f32 / (1 << 23) as f32 - 1.0
    }

    fn one_of<T: Copy, const N: usize>(&mut self, list: [T; N]) -> T {
        list[self.next() % N]
    }
}

#[cortex_m_rt::entry]
fn main() -> ! {
    image::run(case)
}

fn case(counter: Counter) -> Result<(), &'static str> {
    let lists: &'static mut Lists = cortex_m::singleton!(: Lists = Lists {
        x: [0.0; NUMBERS],
        w: [0.0; NUMBERS],
        int8: [0; 70_000],
        half: [f16::ZERO; 2_500],
        outs: [[0.0; NUMBERS]; 2],
        bytes: [[0; scratch_bytes(WIDEST, TILE) + 4]; 2],
        random: Random(7),
        digest: 0xcbf2_9ce4_8422_2325,
        cases: 0,
    })
    .ok_or("the lists are taken")?;
    defmt::info!("kernels {=str}", Native::NAME);
    lists.section("int8 products", int8_products)?;
    lists.section("wide products", wide_products)?;
    lists.section("attention and norms", attention)?;
    lists.section("elementwise", elementwise)?;
    lists.section("pooling", pooling)?;
    lists.section("nearest points", nearest)?;
    lists.section("gates and rotations", gates)?;
    lists.section("subnormal numbers", subnormal)?;
    count(lists, counter);
    Ok(())
}

impl Lists {
    fn section(
        &mut self,
        name: &'static str,
        check: fn(&mut Lists) -> Result<(), &'static str>,
    ) -> Result<(), &'static str> {
        self.cases = 0;
        check(self)?;
        defmt::info!("{=str}: {=u32} cases, digest {=u64:016x}", name, self.cases, self.digest);
        Ok(())
    }

    /// Compares the first `length` results, and what is behind them.
    fn compare(
        &mut self,
        what: &'static str,
        shape: [usize; 3],
        length: usize,
    ) -> Result<(), &'static str> {
        let [found, expected] = &self.outs;
        self.cases += 1;
        for (at, (found, expected)) in found.iter().zip(expected).enumerate().take(length + BEHIND)
        {
            // Processors choose the bits of NaN, and the kernels promise none of them.
            let same =
                found.to_bits() == expected.to_bits() || (found.is_nan() && expected.is_nan());
            if !same || (at >= length && *found != UNTOUCHED) {
                let [a, b, c] = shape;
                defmt::error!(
                    "{=str} {=usize}x{=usize}x{=usize}: element {=usize} is {=f32}, {=f32} expected",
                    what,
                    a,
                    b,
                    c,
                    at,
                    *found,
                    *expected
                );
                return Err("the kernels differ");
            }
            // One pattern for all NaN, so that digests of boards can be compared.
            let bits = if found.is_nan() { f32::NAN.to_bits() } else { found.to_bits() };
            self.digest = (self.digest ^ u64::from(bits)).wrapping_mul(0x0100_0000_01b3);
        }
        Ok(())
    }

    /// Both results untouched.
    fn clear(&mut self) {
        for out in &mut self.outs {
            out.fill(UNTOUCHED);
        }
    }

    fn fill(&mut self, length: usize, mut of: impl FnMut(&mut Random) -> f32) {
        for x in &mut self.x[..length] {
            *x = of(&mut self.random);
        }
    }
}

/// Numbers of an int8 layer: ordinary, extreme, dust, with a flaw, with ties.
fn activations(lists: &mut Lists, length: usize, kind: usize) {
    lists.fill(length, |r| match kind {
        1 => r.one_of([1.0, -1.0]),
        2 => r.one_of([0.0, 1e-31, -1e-38, 2e-30]),
        4 => (r.number() * 192.0) as i32 as f32 * 0.5,
        _ => r.number() * 3.0,
    });
    if kind == 3 {
        let at = lists.random.next() % length;
        lists.x[at] = lists.random.one_of([f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -0.0]);
    }
}

fn int8_products(lists: &mut Lists) -> Result<(), &'static str> {
    let mut scales = [0.0; 64];
    let mut biases = [0.0; 64];
    for rows in [1, 2, 3, 4, 5, 8, 26, 32] {
        for inputs in [
            1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 33, 34, 48, 63, 64, 65, 68, 69, 128, 132, 160,
            192, 256, 384, WIDEST,
        ] {
            for outputs in [1, 2, 3, 4, 7, 48] {
                if rows * inputs > 8_320 || outputs * inputs > 9_000 {
                    continue;
                }
                for kind in 0..5 {
                    activations(lists, rows * inputs, kind);
                    for (scale, bias) in scales.iter_mut().zip(&mut biases) {
                        *scale = lists.random.number().abs() * 0.01;
                        *bias = lists.random.number();
                    }
                    // A channel in the middle of a file may begin at any byte.
                    let at = lists.random.next() % 4;
                    for w in &mut lists.int8[at..at + outputs * inputs] {
                        *w = match kind {
                            1 => 127,
                            2 => -128,
                            _ => lists.random.next() as i8,
                        };
                    }
                    let offset = lists.random.next() % 4;
                    lists.clear();
                    let x = &lists.x[..rows * inputs];
                    let weight = Rows {
                        values: &lists.int8[at..at + outputs * inputs],
                        scales: &scales[..outputs],
                    };
                    // Layers may have no bias.
                    let bias = if kind == 1 { &[] } else { &biases[..outputs] };
                    let [found, expected] = &mut lists.outs;
                    let [bytes, portable] = &mut lists.bytes;
                    let mut row_scales = [0.0; TILE];
                    let mut scratch = Scratch {
                        values: &mut bytes[offset..offset + scratch_bytes(inputs, TILE)],
                        scales: &mut row_scales,
                    };
                    Native.quantise(x, inputs, &mut scratch);
                    Native.linear_i8(
                        &mut scratch,
                        weight,
                        bias,
                        inputs,
                        &mut found[..rows * outputs],
                    );
                    let mut scratch = Scratch { values: portable, scales: &mut row_scales };
                    Portable.quantise(x, inputs, &mut scratch);
                    Portable.linear_i8(
                        &mut scratch,
                        weight,
                        bias,
                        inputs,
                        &mut expected[..rows * outputs],
                    );
                    lists.compare("int8", [rows, inputs, outputs], rows * outputs)?;
                }
            }
        }
    }
    Ok(())
}

fn wide_products(lists: &mut Lists) -> Result<(), &'static str> {
    for rows in [0, 1, 2, 3, 4, 5, 7] {
        for inputs in
            [1, 2, 3, 4, 5, 6, 7, 8, 9, 15, 16, 17, 23, 34, 48, 64, 250, 255, 256, 257, 300]
        {
            for outputs in [1, 2, 3, 5, 8] {
                for kind in 0..3 {
                    lists.fill(rows * inputs, |r| match kind {
                        0 => r.number(),
                        1 => r.one_of([0.0, -0.0]),
                        _ => r.number() * 1e-38,
                    });
                    let mut bias = [-0.0; 8];
                    for (w, half) in lists.w.iter_mut().zip(&mut lists.half).take(outputs * inputs)
                    {
                        *w = if kind == 1 {
                            lists.random.one_of([0.0, -0.0])
                        } else {
                            lists.random.number()
                        };
                        *half = f16::from_bits(lists.random.next() as u16);
                        // Weights are finite: loading refuses others.
                        if half.is_nan() {
                            *half = f16::ONE;
                        }
                    }
                    if kind != 1 {
                        bias = bias.map(|_| lists.random.number());
                    }
                    let (length, bias) = (rows * outputs, &bias[..outputs]);
                    for wide in [true, false] {
                        lists.clear();
                        let (x, w) = (&lists.x[..rows * inputs], &lists.w[..outputs * inputs]);
                        let [found, expected] = &mut lists.outs;
                        let (found, expected) = (&mut found[..length], &mut expected[..length]);
                        if wide {
                            Native.linear_f32(x, w, bias, inputs, found);
                            Portable.linear_f32(x, w, bias, inputs, expected);
                        } else {
                            let half = &lists.half[..outputs * inputs];
                            Native.linear_f16(x, half, bias, inputs, found);
                            Portable.linear_f16(x, half, bias, inputs, expected);
                        }
                        lists.compare("wide", [rows, inputs, outputs], length)?;
                    }
                }
            }
        }
    }
    Ok(())
}

fn attention(lists: &mut Lists) -> Result<(), &'static str> {
    for rows in [0, 1, 2, 5, 14] {
        for width in [1, 4, 8, 15, 16, 17, 31, 32, 33, 48] {
            for gap in [0, 1, 9] {
                let (stride, length) = (width + gap, rows * (width + gap));
                lists.fill(length + 2 * width + rows, Random::number);
                lists.clear();
                let (values, rest) = lists.x.split_at(length);
                // The last row ends where its matrix does, and nothing behind it may be read.
                let values = &values[..length.saturating_sub(gap)];
                let (query, rest) = rest.split_at(width);
                let (weight, rest) = rest.split_at(width);
                let [found, expected] = &mut lists.outs;
                sums(Native, [query, values, weight, &rest[..rows]], stride, found);
                sums(Portable, [query, values, weight, &rest[..rows]], stride, expected);
                lists.compare("attention", [rows, width, gap], 3 * width + rows + 1)?;
            }
        }
    }
    Ok(())
}

/// Mixed values, scores, a row divided by its root mean square, the same normalised, a dot product.
fn sums<K: Kernels>(
    kernels: K,
    [query, values, weight, weights]: [&[f32]; 4],
    stride: usize,
    out: &mut [f32],
) {
    let (mixed, out) = out.split_at_mut(query.len());
    kernels.mix(weights, values, stride, mixed);
    let (scores, out) = out.split_at_mut(weights.len());
    kernels.scores(query, values, stride, 0.3, scores);
    let (normed, out) = out.split_at_mut(query.len());
    normed.copy_from_slice(query);
    kernels.rms_norm(normed, weight, 1e-6);
    let (clamped, out) = out.split_at_mut(query.len());
    clamped.copy_from_slice(normed);
    kernels.normalise(clamped, query, weight, 0.1);
    out[0] = kernels.dot_f32(query, weight);
}

fn elementwise(lists: &mut Lists) -> Result<(), &'static str> {
    for length in [0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 14, 16, 17, 64] {
        for size in [1.0, 10.0, 100.0, 1e30, 1e-30, f32::NAN] {
            lists.fill(length, |r| r.number() * if size.is_nan() { 1.0 } else { size });
            if size.is_nan() && length > 2 {
                (lists.x[1], lists.x[2]) = (f32::NAN, f32::INFINITY);
            }
            for kind in 0..2 {
                lists.clear();
                let [found, expected] = &mut lists.outs;
                let (found, expected) = (&mut found[..=length], &mut expected[..=length]);
                for out in [&mut *found, &mut *expected] {
                    out[..length].copy_from_slice(&lists.x[..length]);
                }
                let (last, found) = found.split_last_mut().ok_or("empty")?;
                let (last_expected, expected) = expected.split_last_mut().ok_or("empty")?;
                if kind == 0 {
                    Native.silu(found);
                    Portable.silu(expected);
                } else {
                    *last = Native.softmax(found);
                    *last_expected = Portable.softmax(expected);
                }
                lists.compare("elementwise", [length, kind, 1], length + kind)?;
            }
        }
    }
    Ok(())
}

fn pooling(lists: &mut Lists) -> Result<(), &'static str> {
    for rows in [0, 1, 2, 5, 32] {
        for channels in [1, 3, 4, 7, 8, 9, 11, 12, 48, 50] {
            lists.fill(rows * channels, Random::number);
            let mut weights = [[0.0; 4]; 32];
            for w in weights.as_flattened_mut() {
                *w = lists.random.number();
            }
            lists.clear();
            let (x, weights) = (&lists.x[..rows * channels], &weights[..rows]);
            let [found, expected] = &mut lists.outs;
            pool(Native, x, weights, channels, found);
            pool(Portable, x, weights, channels, expected);
            lists.compare("pooling", [rows, channels, 1], 6 * channels)?;
        }
    }
    Ok(())
}

fn pool<K: Kernels>(kernels: K, x: &[f32], weights: &[[f32; 4]], channels: usize, out: &mut [f32]) {
    let (largest, out) = out.split_at_mut(channels);
    let (sum, out) = out.split_at_mut(channels);
    largest.fill(f32::NEG_INFINITY);
    kernels.pool(x, largest, sum);
    kernels.weigh(x, weights, &mut out[..4 * channels]);
}

fn nearest(lists: &mut Lists) -> Result<(), &'static str> {
    let turned = Isometry3::new(Vector3::new(0.1, 0.2, -0.3), Vector3::new(0.4, -1.1, 2.0));
    let poses = [Pose::default(), Pose::from_isometry(&turned, &Point3::new(0.3, 0.2, 0.1))];
    for count in [0, 1, 2, 7, 8, 9, 15, 16, 17, 24, 31, 32, 33, 64, 65, 100] {
        for kind in 0..60 {
            // A lattice has many ties, of which the first point must win.
            let mut points = [Point3::origin(); 100];
            let random = &mut lists.random;
            for point in points.iter_mut().flat_map(|point| point.iter_mut()) {
                *point = if kind < 20 { random.number() } else { (random.next() % 3) as f32 };
            }
            let query = if kind < 20 {
                Vector3::new(random.number(), random.number(), random.number())
            } else {
                Vector3::new(1.0, 0.0, 2.0)
            };
            let limits =
                [0.0, -0.0, 1e-4, 0.01, 0.1, 1.0, 3.0, 1e12, f32::INFINITY, f32::NAN, -1.0];
            for distance2 in limits {
                lists.clear();
                let (points, pose) = (&points[..count], &poses[kind % 2]);
                let kernels = Native;
                let found = kernels.nearest(points, pose, &query, distance2);
                let found = found.map(|(from, distance2)| {
                    (kernels.first_at(points, pose, &query, from, distance2), distance2)
                });
                let expected = Portable.nearest(points, pose, &query, distance2);
                for (out, result) in lists.outs.iter_mut().zip([found, expected]) {
                    let (index, distance2) = result.unwrap_or((usize::MAX, -1.0));
                    (out[0], out[1]) = (index as f32, distance2);
                }
                lists.compare("nearest", [count, kind, 1], 2)?;
            }
        }
    }
    Ok(())
}

fn gates(lists: &mut Lists) -> Result<(), &'static str> {
    for length in [0, 1, 2, 3, 4, 5, 7, 8, 9, 12, 16, 17, 24, 31, 32, 33, 64] {
        for size in [1.0, 10.0, 100.0, 1e30, 1e-30, 1e-38, f32::NAN] {
            lists.fill(4 * length, |r| r.number() * if size.is_nan() { 1.0 } else { size });
            if size.is_nan() && length > 2 {
                (lists.x[1], lists.x[2]) = (f32::NAN, f32::NEG_INFINITY);
            }
            turn_and_gate(lists, length)?;
        }
    }
    Ok(())
}

/// Pairs rotated, and numbers behind gates.
fn turn_and_gate(lists: &mut Lists, length: usize) -> Result<(), &'static str> {
    lists.clear();
    let (x, rest) = lists.x[..4 * length].split_at(2 * length);
    let (cos, sin) = rest.split_at(length);
    let [found, expected] = &mut lists.outs;
    let (found, expected) = (&mut found[..3 * length], &mut expected[..3 * length]);
    for out in [&mut *found, &mut *expected] {
        out.copy_from_slice(&lists.x[..3 * length]);
    }
    let (pairs, gated) = found.split_at_mut(2 * length);
    Native.rotate(pairs, cos, sin);
    Native.gate(gated, 0.3, x);
    let (pairs, gated) = expected.split_at_mut(2 * length);
    Portable.rotate(pairs, cos, sin);
    Portable.gate(gated, 0.3, x);
    lists.compare("gates", [length, 1, 1], 3 * length)
}

/// What comes near to zero without being it: numbers, their squares, their products, scales of int8 products.
fn subnormal(lists: &mut Lists) -> Result<(), &'static str> {
    for size in [1e-17, 1e-20, 1e-36, 1e-38, 1e-40] {
        let away = |r: &mut Random| {
            let x = r.number();
            (x + x.signum()) * size
        };
        for length in [1, 4, 7, 8, 16, 31, 32] {
            lists.fill(4 * length, away);
            turn_and_gate(lists, length)?;
            let (rows, stride) = (5, length + 3);
            lists.fill(rows * stride + 2 * length + rows, away);
            lists.clear();
            let (values, rest) = lists.x.split_at(rows * stride);
            let (query, rest) = rest.split_at(length);
            let (weight, rest) = rest.split_at(length);
            let [found, expected] = &mut lists.outs;
            sums(Native, [query, values, weight, &rest[..rows]], stride, found);
            sums(Portable, [query, values, weight, &rest[..rows]], stride, expected);
            lists.compare("small attention", [rows, length, 3], 3 * length + rows + 1)?;
            let mut weights = [[0.0; 4]; 5];
            for w in weights.as_flattened_mut() {
                *w = lists.random.number();
            }
            lists.clear();
            let x = &lists.x[..rows * length];
            let [found, expected] = &mut lists.outs;
            pool(Native, x, &weights, length, found);
            pool(Portable, x, &weights, length, expected);
            lists.compare("small pooling", [rows, length, 1], 6 * length)?;
            small_product(lists, size)?;
            small_distances(lists, length, size)?;
        }
    }
    Ok(())
}

fn small_product(lists: &mut Lists, size: f32) -> Result<(), &'static str> {
    let (rows, inputs, outputs) = (3, 37, 9);
    lists.fill(rows * inputs, Random::number);
    for w in &mut lists.int8[..inputs * outputs] {
        *w = lists.random.next() as i8;
    }
    let mut scales = [0.0; 9];
    for scale in &mut scales {
        *scale = lists.random.number() * size;
    }
    lists.clear();
    let weight = Rows { values: &lists.int8[..inputs * outputs], scales: &scales };
    let x = &lists.x[..rows * inputs];
    let [found, expected] = &mut lists.outs;
    let [bytes, portable] = &mut lists.bytes;
    let mut row_scales = [0.0; TILE];
    let mut scratch = Scratch { values: bytes, scales: &mut row_scales };
    Native.quantise(x, inputs, &mut scratch);
    Native.linear_i8(&mut scratch, weight, &[], inputs, &mut found[..rows * outputs]);
    let mut scratch = Scratch { values: portable, scales: &mut row_scales };
    Portable.quantise(x, inputs, &mut scratch);
    Portable.linear_i8(&mut scratch, weight, &[], inputs, &mut expected[..rows * outputs]);
    lists.compare("small product", [rows, inputs, outputs], rows * outputs)
}

fn small_distances(lists: &mut Lists, count: usize, size: f32) -> Result<(), &'static str> {
    let mut points = [Point3::origin(); 32];
    for point in points.iter_mut().flat_map(|point| point.iter_mut()) {
        *point = lists.random.number() * size;
    }
    let (points, pose) = (&points[..count], &Pose::default());
    let query = Vector3::new(size, -size, 0.0);
    lists.clear();
    let [found, expected] = &mut lists.outs;
    closest(Native, points, pose, &query, found);
    closest(Portable, points, pose, &query, expected);
    lists.compare("small distances", [count, 1, 1], 2)
}

fn closest<K: Kernels>(
    kernels: K,
    points: &[Point3<f32>],
    pose: &Pose,
    query: &Vector3<f32>,
    out: &mut [f32],
) {
    let found = kernels.nearest(points, pose, query, 1.0).map(|(from, distance2)| {
        (kernels.first_at(points, pose, query, from, distance2), distance2)
    });
    let (index, distance2) = found.unwrap_or((usize::MAX, -1.0));
    (out[0], out[1]) = (index as f32, distance2);
}

/// Instructions of a call for each of its `operations`.
fn cost(counter: Counter, operations: usize, mut call: impl FnMut()) -> f32 {
    // So many that a tick of the clock is nothing beside them.
    let calls = (400_000 / operations).clamp(4, 1_000);
    call();
    let start = counter.now();
    for _ in 0..calls {
        call();
    }
    counter.since(start) as f32 / (calls * operations) as f32
}

fn count(lists: &mut Lists, counter: Counter) {
    let kernels = Native;
    lists.fill(NUMBERS, Random::number);
    let x = black_box(&lists.x);
    for w in &mut lists.int8 {
        *w = lists.random.next() as i8;
    }
    let (scales, biases) = ([0.01; 320], [0.5; 320]);
    let [out, room] = &mut lists.outs;
    let mut row_scales = [0.0; TILE];
    for (rows, inputs, outputs) in [
        (26, 64, 64),
        (64, 64, 160),
        (26, 256, 256),
        (1, 64, 64),
        (1, 256, 256),
        (32, 34, 48),
        (32, 48, 48),
        (10, 384, 64),
        (14, 64, 256),
        (14, 64, 64),
        (14, 64, 320),
        (14, 160, 64),
        (10, 64, 128),
        (16, 69, 64),
        (16, 64, 128),
        (16, 192, 64),
        (16, 48, 32),
    ] {
        let weight = Rows { values: &lists.int8[..inputs * outputs], scales: &scales[..outputs] };
        let mut scratch = Scratch { values: &mut lists.bytes[0], scales: &mut row_scales };
        let x = &x[..rows.min(TILE) * inputs];
        let quantise =
            cost(counter, x.len(), || kernels.quantise(black_box(x), inputs, &mut scratch));
        let product = cost(counter, rows * inputs * outputs, || {
            // Rows beyond a tile are another call, over the same room for what comes of it.
            for first in (0..rows).step_by(TILE) {
                let out = &mut out[..(rows - first).min(TILE) * outputs];
                kernels.linear_i8(&mut scratch, black_box(weight), &biases[..outputs], inputs, out);
            }
        });
        defmt::info!(
            "measured product {=usize}x{=usize}x{=usize} {=f32}",
            rows,
            inputs,
            outputs,
            product
        );
        if outputs == 64 {
            defmt::info!("measured quantise {=usize}x{=usize} {=f32}", rows, inputs, quantise);
        }
    }
    let half = &lists.half[..34 * 48];
    let f16 = cost(counter, 32 * 34 * 48, || {
        kernels.linear_f16(black_box(&x[..32 * 34]), half, &biases[..48], 34, &mut out[..32 * 48]);
    });
    defmt::info!("measured f16 32x34x48 {=f32}", f16);
    for length in [26, 14, 10] {
        let softmax = cost(counter, length, || {
            let scores = black_box(&mut room[..length]);
            black_box(kernels.softmax(scores));
        });
        defmt::info!("measured softmax {=usize} {=f32}", length, softmax);
    }
    room.copy_from_slice(x);
    let silu = cost(counter, 512, || kernels.silu(black_box(&mut room[..512])));
    defmt::info!("measured silu {=f32}", silu);
    let norm = cost(counter, 64, || kernels.rms_norm(black_box(&mut room[..64]), &x[..64], 1e-6));
    defmt::info!("measured rms_norm 64 {=f32}", norm);
    let scores =
        cost(counter, 320, || kernels.scores(&x[..32], black_box(x), 32, 0.2, &mut out[..10]));
    defmt::info!("measured scores 10x32 {=f32}", scores);
    let mix = cost(counter, 320, || kernels.mix(&x[..10], black_box(x), 32, &mut out[..32]));
    defmt::info!("measured mix 10x32 {=f32}", mix);
    let (largest, sum) = out.split_at_mut(48);
    let pool =
        cost(counter, 32 * 48, || kernels.pool(black_box(&x[..32 * 48]), largest, &mut sum[..48]));
    defmt::info!("measured pool 32x48 {=f32}", pool);
    let weights = [[0.1; 4]; 32];
    let weigh = cost(counter, 4 * 32 * 48, || {
        kernels.weigh(black_box(&x[..32 * 48]), &weights, &mut sum[..4 * 48]);
    });
    defmt::info!("measured weigh 32x48 {=f32}", weigh);
    let mut points = [Point3::origin(); 64];
    for point in points.iter_mut().flat_map(|point| point.iter_mut()) {
        *point = lists.random.number();
    }
    let pose = Pose::default();
    for (name, distance2) in [("passed", 0.0), ("found", 9.0)] {
        let nearest = cost(counter, 64, || {
            black_box(kernels.nearest(black_box(&points), &pose, &Vector3::zeros(), distance2));
        });
        defmt::info!("measured nearest {=str} {=f32}", name, nearest);
    }
}
