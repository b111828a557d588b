//! Anchors: pooled neighbourhood, attention to the units, head (docs/MODEL.md, section 5).

use crate::config::{ANCHORS, Sizes};
use crate::geometry::norm;
use crate::kernels::Kernels;
use crate::kernels::attention::Attention;
use crate::layers::attention::{norm_and_rotate, turns};
use crate::layers::{add, copy, modulate, part, part_mut, rms_norm, rows, rows_mut};
use crate::math;
use crate::model::Model;
use crate::scene::{Scene, UnitState};
use crate::trace::{Layer, Trace};
use crate::workspace::Workspace;

/// Weights of anchor-vertex pooling of one unit into `out` (points, anchors): the kernel
/// exp(-distance / sigma), normalised over the unit's points. Rigid units keep them.
pub(crate) fn pooling_weights<const UNITS: usize>(
    scene: &Scene<'_, UNITS>,
    unit: &UnitState,
    sigma_m: f32,
    out: &mut [f32],
) {
    let points = scene.points_of(unit);
    let anchors = scene.anchors_of(unit);
    let mut totals = [0.0_f32; ANCHORS];
    for (point, row) in points.iter().zip(rows_mut(out, ANCHORS)) {
        for ((anchor, weight), total) in anchors.iter().zip(row).zip(&mut totals) {
            *weight = math::exp_once(-norm(&(anchor - point.coords)) / sigma_m);
            *total += *weight;
        }
    }
    for row in rows_mut(out, ANCHORS) {
        for (weight, total) in row.iter_mut().zip(&totals) {
            *weight /= total;
        }
    }
}

/// Fills `head` (units, anchors, 3) from what encoder and interaction left.
pub(crate) fn predict<K: Kernels, T: Trace, const UNITS: usize>(
    kernels: K,
    model: &Model<'_>,
    sizes: &Sizes,
    scene: &Scene<'_, UNITS>,
    w: &mut Workspace<'_>,
    trace: &mut T,
) {
    let tile = K::TILES.anchor_units.max(1);
    for (index, units) in scene.units.chunks(tile).enumerate() {
        predict_tile(kernels, model, sizes, scene, (index * tile, units), w, trace);
    }
}

fn predict_tile<K: Kernels, T: Trace, const UNITS: usize>(
    kernels: K,
    model: &Model<'_>,
    sizes: &Sizes,
    scene: &Scene<'_, UNITS>,
    (first, units): (usize, &[UnitState]),
    w: &mut Workspace<'_>,
    trace: &mut T,
) {
    let net = &model.anchors;
    let count = units.len() * ANCHORS;
    let start = first * ANCHORS;
    let (width, inner) = (sizes.width, sizes.inner);

    let pooled = part(w.avp_pooled, start * sizes.point_width, count * sizes.point_width);
    let avp = part_mut(w.avp_out, 0, count * sizes.avp);
    net.avp.apply(
        kernels,
        pooled,
        part_mut(w.avp_hidden, 0, count * sizes.avp),
        avp,
        &mut w.scratch,
    );
    let state = part_mut(w.anchor_state, 0, count * sizes.query);
    let features = part(w.anchor_features, start * sizes.features, count * sizes.features);
    let positions = units
        .iter()
        .flat_map(|unit| scene.anchors_of(unit).map(|anchor| unit.current.apply(&anchor)));
    let inputs = rows(features, sizes.features).zip(rows(avp, sizes.avp));
    for (((position, (features, avp)), row), turn) in positions
        .zip(inputs)
        .zip(rows_mut(state, sizes.query))
        .zip(rows_mut(w.anchor_turns, 2 * sizes.angles))
    {
        let position = [position.x, position.y, position.z];
        turns(position, model.rope_frequencies, turn);
        let (place, rest) = row.split_at_mut(3.min(row.len()));
        let constants = net.position_mean.iter().zip(net.position_scale);
        for ((out, x), (mean, scale)) in place.iter_mut().zip(position).zip(constants) {
            *out = (x - mean) * scale;
        }
        let (slots, rest) = rest.split_at_mut(sizes.features.min(rest.len()));
        copy(features, slots);
        copy(avp, rest);
    }

    let hidden = part_mut(w.anchor_hidden, 0, count * width);
    let tokens = part_mut(w.anchor_tokens, 0, count * width);
    net.query.apply(kernels, state, hidden, tokens, &mut w.scratch);
    trace.record(Layer::AnchorQueries, 0, tokens);

    let normed = part_mut(w.anchor_normed, 0, count * width);
    let query_gate = part_mut(w.query_gate, 0, count * 2 * inner);
    let seen = part_mut(w.seen, 0, count * sizes.scales * inner);
    for (scale, cross) in net.cross.iter().enumerate() {
        rms_norm(kernels, tokens, cross.input_norm, normed);
        cross.query_gate.apply(kernels, normed, query_gate, &mut w.scratch);
        let turns = &*w.anchor_turns;
        kernels.each_row(query_gate, 2 * inner, 4 * inner, &mut [], |row, values, _| {
            let turn = part(turns, row * 2 * sizes.angles, 2 * sizes.angles);
            norm_and_rotate(kernels, part_mut(values, 0, inner), cross.query_norm, turn);
        });
        let (query_gate, stride, out_stride) = (&*query_gate, 2 * inner, sizes.scales * inner);
        // The anchors of a copy's units in this tile attend to that copy's units.
        let mut unit = first;
        while unit < first + units.len() {
            let (start, around) = scene.around(unit);
            let end = (start + around.len()).min(first + units.len()).max(unit + 1);
            let rows = (unit - first) * ANCHORS..(end - first) * ANCHORS;
            let tokens = (scale * sizes.units + start) * stride;
            let tokens = part(w.keys_values, tokens, scene.per_copy * stride);
            let queries = part(query_gate, rows.start * stride, rows.len() * stride);
            let seen = part_mut(seen, rows.start * out_stride, rows.len() * out_stride);
            let (width, cost) = (K::QUERIES * out_stride, 2 * inner * scene.per_copy * K::QUERIES);
            kernels.each_row(seen, width, cost, w.scores, |block, out, scratch| {
                let rows = out.len() / out_stride.max(1);
                let attention = Attention {
                    queries: part(queries, block * K::QUERIES * stride, rows * stride),
                    query_stride: stride,
                    gate: inner,
                    tokens,
                    stride,
                    key: 0,
                    value: inner,
                    head_dim: sizes.head_dim,
                    inner,
                    out_stride,
                    out_start: scale * inner,
                };
                kernels.attend(&attention, scratch, out);
            });
            unit = end;
        }
    }

    trace.record(Layer::Seen, 0, seen);
    net.fuse.apply(kernels, seen, normed, &mut w.scratch);
    add(tokens, normed);
    modulate(tokens, part(w.films, (sizes.blocks + 1) * 2 * width, 2 * width));
    trace.record(Layer::AnchorTokens, 0, tokens);
    rms_norm(kernels, tokens, net.norm, normed);
    net.head.first.apply(kernels, normed, hidden, &mut w.scratch);
    kernels.silu(hidden);
    net.head.second.apply(kernels, hidden, part_mut(w.head, start * 3, count * 3), &mut w.scratch);
}
