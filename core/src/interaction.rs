//! Unit interaction: blocks over unit tokens and registers (docs/MODEL.md, section 4).

use crate::config::{ANCHORS, Sizes};
use crate::kernels::Kernels;
use crate::layers::attention::{KeysValues, attend, norm_and_rotate, place, turns};
use crate::layers::{add, modulate, part, part_mut, rms_norm, rows, rows_mut, swiglu};
use crate::model::{Block, Cross, Model};
use crate::scene::Scene;
use crate::trace::{Layer, Trace};
use crate::workspace::Workspace;

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
    let units = scene.units.len();
    place(model.registers, units * sizes.width, w.tokens);
    for (unit, out) in scene.units.iter().zip(rows_mut(w.unit_turns, 2 * sizes.angles)) {
        let [a, b, c, d] = scene.anchors_of(unit).map(|anchor| unit.current.apply(&anchor));
        let mean = ((a + b) + (c + d)) * (1.0 / ANCHORS as f32);
        turns([mean.x, mean.y, mean.z], model.rope_frequencies, out);
    }
    record(trace, sizes, units, 0, w);
    project_scale(kernels, model, sizes, units, 0, w);
    for (i, block) in model.blocks.iter().enumerate() {
        run(kernels, block, sizes, units, i, w, trace);
        record(trace, sizes, units, i + 1, w);
        project_scale(kernels, model, sizes, units, i + 1, w);
    }
}

/// Shows the tokens of a scale.
fn record<T: Trace>(trace: &mut T, sizes: &Sizes, units: usize, scale: usize, w: &Workspace<'_>) {
    let all = part(w.tokens, 0, in_use(sizes, units) * sizes.width);
    let (units, registers) = all.split_at(all.len().min(units * sizes.width));
    trace.record(Layer::Tokens, scale, units);
    trace.record(Layer::Registers, scale, registers);
}

/// Tokens in use: units, then registers.
fn in_use(sizes: &Sizes, units: usize) -> usize {
    units + (sizes.tokens - sizes.units)
}

/// `Z' = Z + SelfAttention(RMSNorm(Z)); Z'' = FiLM(Z'); Z = Z'' + SwiGLU(RMSNorm(Z''))`
fn run<K: Kernels, T: Trace>(
    kernels: K,
    block: &Block<'_>,
    sizes: &Sizes,
    units: usize,
    index: usize,
    w: &mut Workspace<'_>,
    trace: &mut T,
) {
    let count = in_use(sizes, units);
    let (width, inner, hidden) = (sizes.width, sizes.inner, sizes.feed_forward);
    let tokens = part_mut(w.tokens, 0, count * width);
    let normed = part_mut(w.normed, 0, count * width);

    rms_norm(kernels, tokens, block.norm, normed);
    let qkvg = part_mut(w.qkvg, 0, count * 4 * inner);
    block.qkvg.apply(kernels, normed, qkvg, &mut w.scratch);
    let mut turns = rows(part(w.unit_turns, 0, units * 2 * sizes.angles), 2 * sizes.angles);
    for row in rows_mut(qkvg, 4 * inner) {
        // Registers have no place: no rotation, their norm alone.
        let turn = turns.next().unwrap_or_default();
        let (query, rest) = row.split_at_mut(inner.min(row.len()));
        norm_and_rotate(kernels, query, block.query_norm, turn);
        norm_and_rotate(kernels, part_mut(rest, 0, inner), block.key_norm, turn);
    }
    let context = KeysValues { matrix: qkvg, stride: 4 * inner, key: inner, value: 2 * inner };
    let attended = part_mut(w.attended, 0, count * inner);
    for (row, out) in rows(context.matrix, 4 * inner).zip(rows_mut(attended, inner)) {
        let (query, gate) = (part(row, 0, inner), part(row, 3 * inner, inner));
        attend(kernels, query, gate, &context, sizes.head_dim, w.scores, out);
    }
    block.out.apply(kernels, attended, normed, &mut w.scratch);
    add(tokens, normed);
    trace.record(Layer::Attention, index + 1, tokens);

    modulate(tokens, part(w.films, (index + 1) * 2 * width, 2 * width));
    if block.command.is_some() {
        modulate(tokens, part(w.commands, (index + 1) * 2 * width, 2 * width));
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
    units: usize,
    level: usize,
    w: &mut Workspace<'_>,
) {
    let Some(scale) = model.config().scales.position(level) else { return };
    let Some(cross) = model.anchors.cross.get(scale) else { return };
    let Cross { unit_norm, key_value, key_norm, .. } = cross;
    let normed = part_mut(w.normed, 0, units * sizes.width);
    rms_norm(kernels, part(w.tokens, 0, units * sizes.width), unit_norm, normed);
    let stride = 2 * sizes.inner;
    let out = part_mut(w.keys_values, scale * sizes.units * stride, units * stride);
    key_value.apply(kernels, normed, out, &mut w.scratch);
    for (row, turn) in rows_mut(out, stride).zip(rows(w.unit_turns, 2 * sizes.angles)) {
        norm_and_rotate(kernels, part_mut(row, 0, sizes.inner), key_norm, turn);
    }
}
