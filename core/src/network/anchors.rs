//! Anchors: pooled neighbourhood, attention to the units, head (docs/MODEL.md, section 5).

use crate::contact::impacts;
use crate::geometry::norm;
use crate::kernels::{Attention, Kernels, Schedule};
use crate::limits::ANCHORS;
use crate::math;
use crate::model::Model;
use crate::network::layers::attention::{norm_and_rotate, turns};
use crate::network::layers::{add, modulate, rms_norm};
use crate::network::present::Present;
use crate::network::wanted::Wanted;
use crate::network::{Buffers, View};
use crate::scene::{Scene, UnitSlot};
use crate::share::{UnitRange, Units, Work, share_out};
use crate::sizes::Sizes;
use crate::slices::{copy_slice, rows, rows_mut, slice_at, slice_at_mut};
use crate::structure::heading;
use crate::trace::{Layer, Trace};
use crate::workspace::{Lasting, RowLengths, Rows};

/// Weights of anchor-vertex pooling of one unit into `out` (points, anchors): the kernel
/// exp(-distance / sigma), normalised over the unit's points. Rigid units keep them.
pub(crate) fn pooling_weights(scene: &Scene<'_>, unit: &UnitSlot, sigma_m: f32, out: &mut [f32]) {
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

/// Fills `head` (units, anchors, outputs) from what encoder and interaction left.
#[inline(never)]
pub(crate) fn predict<S: Schedule, T: Trace>(
    schedule: S,
    model: &Model<'_>,
    sizes: &Sizes,
    view: View<'_>,
    buffers: Buffers<'_, '_>,
    wanted: Wanted,
    trace: &mut T,
) {
    let (View { scene, present }, Buffers { lasting, rows: w }) = (view, buffers);
    let Lasting { films, keys_values, solved, .. } = lasting;
    let predict = Predict { model, sizes, scene, present, films, keys_values, solved, wanted };
    let count = present.rows();
    let units = Units { first: 0, count, tile: sizes.tiles.anchor_units };
    let seen = 2 * sizes.scales * sizes.inner * scene.per_copy;
    let cost = count * ANCHORS * (sizes.anchor_work() + seen);
    let whole = UnitRange { units, sizes, w: w.reborrow(), cut };
    share_out(schedule, trace, (sizes.is_small(), cost), &predict, whole);
}

/// What all units read.
struct Predict<'a> {
    model: &'a Model<'a>,
    sizes: &'a Sizes,
    scene: &'a Scene<'a>,
    present: Present<'a>,
    films: &'a [f32],
    keys_values: &'a [f32],
    /// Motion by impulses; empty for models without.
    solved: &'a [f32],
    wanted: Wanted,
}

impl Work<UnitRange<'_>> for Predict<'_> {
    type Out = ();

    fn run<S: Schedule, T: Trace>(&self, schedule: S, mut part: UnitRange<'_>, trace: &mut T) {
        let Units { first, count, tile } = part.units;
        let tile = tile.max(1);
        // Schedules that leave nothing out take all units, a tile at a time.
        if !schedule.skips() {
            let mut ahead = 0;
            while ahead < count {
                let run = tile.min(count - ahead);
                predict_tile(schedule, self, (first, ahead, run), &mut part.w, trace);
                ahead += run;
            }
            return;
        }
        let is_wanted = |number: &usize| {
            self.wanted.unit(self.scene, self.present.unit(first + number), self.solved)
        };
        let mut ahead = 0;
        while ahead < count {
            ahead += (ahead..count).take_while(|number| !is_wanted(number)).count();
            let run = (ahead..count).take(tile).take_while(is_wanted).count();
            if run == 0 {
                break;
            }
            predict_tile(schedule, self, (first, ahead, run), &mut part.w, trace);
            ahead += run;
        }
    }

    fn merge((): (), (): ()) {}
}

/// What of the buffers belongs to units.
fn cut(s: &Sizes, units: Units) -> RowLengths {
    let (tiled, all) = (units.tile * ANCHORS, units.count * ANCHORS);
    RowLengths {
        avp_pooled: all * s.point_width,
        anchor_features: all * s.features,
        impacts: units.count * s.impacts,
        head: all * s.outputs,
        anchor_turns: tiled * 2 * s.angles,
        avp_hidden: tiled * s.avp,
        avp_out: tiled * s.avp,
        anchor_state: tiled * s.query,
        anchor_hidden: tiled * s.width,
        anchor_tokens: tiled * s.width,
        anchor_normed: tiled * s.width,
        query_gate: tiled * 2 * s.inner,
        seen: tiled * s.scales * s.inner,
        ..RowLengths::default()
    }
}

/// The workspace's rows begin with row `before`; the first of so many `units` is `ahead` of it.
fn predict_tile<S: Schedule, T: Trace>(
    schedule: S,
    fixed: &Predict<'_>,
    (before, ahead, units): (usize, usize, usize),
    w: &mut Rows<'_>,
    trace: &mut T,
) {
    let Predict { model, sizes, scene, present, films, keys_values, .. } = fixed;
    let (kernels, together) = (schedule.kernels(), S::Kernels::QUERIES);
    let net = &model.anchors;
    let count = units * ANCHORS;
    let (first, start) = (before + ahead, ahead * ANCHORS);
    let (width, inner) = (sizes.width, sizes.inner);

    let pooled = slice_at(w.avp_pooled, start * sizes.point_width, count * sizes.point_width);
    let avp = slice_at_mut(w.avp_out, 0, count * sizes.avp);
    net.avp.apply(
        schedule,
        pooled,
        slice_at_mut(w.avp_hidden, 0, count * sizes.avp),
        avp,
        &mut w.scratch,
    );
    let state = slice_at_mut(w.anchor_state, 0, count * sizes.query);
    let features = slice_at(w.anchor_features, start * sizes.features, count * sizes.features);
    let records = slice_at(w.impacts, ahead * sizes.impacts, units * sizes.impacts);
    let mut pushes = rows(records, sizes.impacts).flat_map(impacts::pushes);
    let config = model.config();
    let positions = (first..first + units)
        .filter_map(|row| scene.units().get(present.unit(row)))
        .flat_map(|unit| scene.anchors_of(unit).map(|anchor| heading::seen(config, unit, &anchor)));
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
        copy_slice(features, slots);
        let (slots, rest) = rest.split_at_mut(sizes.avp.min(rest.len()));
        copy_slice(avp, slots);
        if let Some(push) = pushes.next() {
            copy_slice(push, rest);
        }
    }

    let hidden = slice_at_mut(w.anchor_hidden, 0, count * width);
    let tokens = slice_at_mut(w.anchor_tokens, 0, count * width);
    net.query.apply(schedule, state, hidden, tokens, &mut w.scratch);
    trace.record(Layer::AnchorQueries, 0, tokens);

    let normed = slice_at_mut(w.anchor_normed, 0, count * width);
    let query_gate = slice_at_mut(w.query_gate, 0, count * 2 * inner);
    let seen = slice_at_mut(w.seen, 0, count * sizes.scales * inner);
    for (scale, cross) in net.cross.iter().enumerate() {
        rms_norm(kernels, tokens, cross.input_norm, normed);
        cross.query_gate.apply(schedule, normed, query_gate, &mut w.scratch);
        let turns = &*w.anchor_turns;
        schedule.each_row(query_gate, 2 * inner, 4 * inner, &mut [], |row, values, _| {
            let turn = slice_at(turns, row * 2 * sizes.angles, 2 * sizes.angles);
            norm_and_rotate(kernels, slice_at_mut(values, 0, inner), cross.query_norm, turn);
        });
        let (query_gate, stride, out_stride) = (&*query_gate, 2 * inner, sizes.scales * inner);
        // The anchors of a context's units in this tile attend to that context's units.
        let mut unit = first;
        while unit < first + units {
            let around = present.rows_of(present.context_of(unit));
            let end = around.end.min(first + units).max(unit + 1);
            let rows = (unit - first) * ANCHORS..(end - first) * ANCHORS;
            let tokens = (scale * sizes.units + around.start) * stride;
            let tokens = slice_at(keys_values, tokens, around.len() * stride);
            let queries = slice_at(query_gate, rows.start * stride, rows.len() * stride);
            let seen = slice_at_mut(seen, rows.start * out_stride, rows.len() * out_stride);
            let (width, cost) = (together * out_stride, 2 * inner * around.len() * together);
            schedule.each_row(seen, width, cost, w.scores, |block, out, scratch| {
                let rows = out.len() / out_stride.max(1);
                let attention = Attention {
                    queries: slice_at(queries, block * together * stride, rows * stride),
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
    net.fuse.apply(schedule, seen, normed, &mut w.scratch);
    add(tokens, normed);
    modulate(tokens, slice_at(films, (sizes.blocks + 1) * 2 * width, 2 * width));
    trace.record(Layer::AnchorTokens, 0, tokens);
    rms_norm(kernels, tokens, net.norm, normed);
    net.head.first.apply(schedule, normed, hidden, &mut w.scratch);
    schedule.silu(hidden);
    let outputs = slice_at_mut(w.head, start * sizes.outputs, count * sizes.outputs);
    net.head.second.apply(schedule, hidden, outputs, &mut w.scratch);
}
