//! Unit interaction: blocks over unit tokens and registers (docs/MODEL.md, section 4).

use crate::config::{ANCHORS, Sizes};
use crate::kernels::Kernels;
use crate::kernels::attention::Attention;
use crate::layers::attention::{norm_and_rotate, place, turns};
use crate::layers::{add, modulate, part, part_mut, rms_norm, rows, rows_mut, swiglu};
use crate::model::{Block, Cross, Model};
use crate::scene::Scene;
use crate::trace::{Layer, Trace};
use crate::workspace::{Workspace, command_places};

/// Runs all blocks on `tokens`, and leaves the units' keys and values of every scale in
/// `keys_values` (scales, units, 2 inner).
pub(crate) fn interact<K: Kernels, T: Trace, const UNITS: usize>(
    kernels: K,
    model: &Model<'_>,
    sizes: &Sizes,
    scene: &Scene<'_, UNITS>,
    w: &mut Workspace<'_>,
    trace: &mut T,
) {
    let shape = Shape::of(scene, sizes);
    for tokens in rows_mut(w.tokens, shape.context * sizes.width).take(scene.copies()) {
        place(model.registers, scene.per_copy * sizes.width, tokens);
    }
    for (unit, out) in scene.units.iter().zip(rows_mut(w.unit_turns, 2 * sizes.angles)) {
        let [a, b, c, d] = scene.anchors_of(unit).map(|anchor| unit.current.apply(&anchor));
        let mean = ((a + b) + (c + d)) * (1.0 / ANCHORS as f32);
        turns([mean.x, mean.y, mean.z], model.rope_frequencies, out);
    }
    record(trace, sizes, shape, 0, w);
    project_scale(kernels, model, sizes, shape, 0, w);
    for (i, block) in model.blocks.iter().enumerate() {
        run(kernels, block, sizes, shape, i, w, trace);
        record(trace, sizes, shape, i + 1, w);
        project_scale(kernels, model, sizes, shape, i + 1, w);
    }
}

/// Rows in use.
#[derive(Clone, Copy)]
struct Shape {
    copies: usize,
    /// Units of a copy.
    units: usize,
    /// Units and registers of a copy.
    context: usize,
}

impl Shape {
    fn of<const UNITS: usize>(scene: &Scene<'_, UNITS>, sizes: &Sizes) -> Self {
        let units = scene.per_copy;
        Shape { copies: scene.copies(), units, context: units + sizes.registers }
    }
}

/// Shows the tokens of a scale.
fn record<T: Trace>(trace: &mut T, sizes: &Sizes, shape: Shape, scale: usize, w: &Workspace<'_>) {
    for all in rows(w.tokens, shape.context * sizes.width).take(shape.copies) {
        let (units, registers) = all.split_at(all.len().min(shape.units * sizes.width));
        trace.record(Layer::Tokens, scale, units);
        trace.record(Layer::Registers, scale, registers);
    }
}

/// `Z' = Z + SelfAttention(RMSNorm(Z)); Z'' = FiLM(Z'); Z = Z'' + SwiGLU(RMSNorm(Z''))`
fn run<K: Kernels, T: Trace>(
    kernels: K,
    block: &Block<'_>,
    sizes: &Sizes,
    shape: Shape,
    index: usize,
    w: &mut Workspace<'_>,
    trace: &mut T,
) {
    let Shape { copies, units, context } = shape;
    let count = copies * context;
    let (width, inner, hidden) = (sizes.width, sizes.inner, sizes.feed_forward);
    let tokens = part_mut(w.tokens, 0, count * width);
    let normed = part_mut(w.normed, 0, count * width);

    rms_norm(kernels, tokens, block.norm, normed);
    let qkvg = part_mut(w.qkvg, 0, count * 4 * inner);
    block.qkvg.apply(kernels, normed, qkvg, &mut w.scratch);
    let all_turns = &*w.unit_turns;
    kernels.each_row(qkvg, 4 * inner, 8 * inner, &mut [], |row, values, _| {
        // Registers have no place: no rotation, their norm alone.
        let (copy, token) = match copies {
            1 => (0, row),
            _ => (row / context.max(1), row % context.max(1)),
        };
        let turns = if token < units { 2 * sizes.angles } else { 0 };
        let turn = part(all_turns, (copy * units + token) * turns, turns);
        let (query, rest) = values.split_at_mut(inner.min(values.len()));
        norm_and_rotate(kernels, query, block.query_norm, turn);
        norm_and_rotate(kernels, part_mut(rest, 0, inner), block.key_norm, turn);
    });
    let (qkvg, stride) = (&*qkvg, 4 * inner);
    let attended = part_mut(w.attended, 0, count * inner);
    for copy in 0..copies {
        let tokens = part(qkvg, copy * context * stride, context * stride);
        let attended = part_mut(attended, copy * context * inner, context * inner);
        let cost = 2 * inner * context * K::QUERIES;
        kernels.each_row(attended, K::QUERIES * inner, cost, w.scores, |block, out, scratch| {
            let rows = out.len() / inner.max(1);
            let attention = Attention {
                queries: part(tokens, block * K::QUERIES * stride, rows * stride),
                query_stride: stride,
                gate: 3 * inner,
                tokens,
                stride,
                key: inner,
                value: 2 * inner,
                head_dim: sizes.head_dim,
                inner,
                out_stride: inner,
                out_start: 0,
            };
            kernels.attend(&attention, scratch, out);
        });
    }
    block.out.apply(kernels, attended, normed, &mut w.scratch);
    add(tokens, normed);
    trace.record(Layer::Attention, index + 1, tokens);

    modulate(tokens, part(w.films, (index + 1) * 2 * width, 2 * width));
    if block.command.is_some() {
        for (copy, tokens) in rows_mut(tokens, context * width).enumerate() {
            let film = (copy * command_places(sizes) + index + 1) * 2 * width;
            modulate(tokens, part(w.commands, film, 2 * width));
        }
    }

    rms_norm(kernels, tokens, block.feed_forward_norm, normed);
    let gate_up = part_mut(w.gate_up, 0, count * 2 * hidden);
    block.gate_up.apply(kernels, normed, gate_up, &mut w.scratch);
    let gated = part_mut(w.gated, 0, count * hidden);
    swiglu(kernels, gate_up, hidden, gated);
    block.down.apply(kernels, gated, normed, &mut w.scratch);
    add(tokens, normed);
}

/// Keys and values for the anchors, where `level` is one of the scales.
fn project_scale<K: Kernels>(
    kernels: K,
    model: &Model<'_>,
    sizes: &Sizes,
    shape: Shape,
    level: usize,
    w: &mut Workspace<'_>,
) {
    let Some(scale) = model.config().scales.position(level) else { return };
    let Some(cross) = model.anchors.cross.get(scale) else { return };
    let Cross { unit_norm, key_value, key_norm, .. } = cross;
    let (units, width) = (shape.copies * shape.units, sizes.width);
    let normed = part_mut(w.normed, 0, units * width);
    let length = shape.units * width;
    for copy in 0..shape.copies {
        let tokens = part(w.tokens, copy * shape.context * width, length);
        rms_norm(kernels, tokens, unit_norm, part_mut(normed, copy * length, length));
    }
    let stride = 2 * sizes.inner;
    let out = part_mut(w.keys_values, scale * sizes.units * stride, units * stride);
    key_value.apply(kernels, normed, out, &mut w.scratch);
    let turns = &*w.unit_turns;
    kernels.each_row(out, stride, 4 * sizes.inner, &mut [], |row, values, _| {
        let turn = part(turns, row * 2 * sizes.angles, 2 * sizes.angles);
        norm_and_rotate(kernels, part_mut(values, 0, sizes.inner), key_norm, turn);
    });
}
