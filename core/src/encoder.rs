//! Hierarchical PointNet: points to unit tokens (docs/MODEL.md, section 3).

use crate::config::{ANCHORS, POINT_TILE, POOL_LEVELS, Sizes};
use crate::features;
use crate::kernels::Kernels;
use crate::layers::{copy, modulate, part, part_mut, rows, rows_mut, silu_in_place};
use crate::model::Model;
use crate::scene::{Scene, UnitState};
use crate::trace::{Layer, Stage, Trace};
use crate::workspace::Workspace;

/// Fills the first rows of `tokens` (units, width), `avp_pooled` and `anchor_features`.
pub(crate) fn encode<K: Kernels, T: Trace, const UNITS: usize>(
    kernels: K,
    model: &Model<'_>,
    sizes: &Sizes,
    scene: &Scene<'_, UNITS>,
    w: &mut Workspace<'_>,
    trace: &mut T,
) {
    for (index, unit) in scene.units.iter().enumerate() {
        encode_unit(kernels, model, sizes, scene, (index, unit), w, trace);
    }
    let count = scene.units.len();
    trace.record(Layer::Pooled, 0, part(w.pooled, 0, count * 2 * POOL_LEVELS * sizes.point_width));
    let pooled = part(w.pooled, 0, count * 2 * POOL_LEVELS * sizes.point_width);
    let hidden = part_mut(w.fuse_hidden, 0, count * sizes.width);
    let tokens = part_mut(w.tokens, 0, count * sizes.width);
    model.encoder.fuse.apply(kernels, pooled, hidden, tokens, &mut w.scratch);
    modulate(tokens, part(w.films, 0, 2 * sizes.width));
    if model.encoder.command.is_some() {
        modulate(tokens, part(w.commands, 0, 2 * sizes.width));
    }
}

/// Points of a unit that level `level` pools over: a prefix of the farthest-point order.
fn level_count(points: usize, level: usize) -> usize {
    (points.div_ceil(1 << level)).max(1)
}

fn encode_unit<K: Kernels, T: Trace, const UNITS: usize>(
    kernels: K,
    model: &Model<'_>,
    sizes: &Sizes,
    scene: &Scene<'_, UNITS>,
    (index, unit): (usize, &UnitState),
    w: &mut Workspace<'_>,
    trace: &mut T,
) {
    let channels = sizes.point_width;
    let pooled = part_mut(w.pooled, index * 2 * POOL_LEVELS * channels, 2 * POOL_LEVELS * channels);
    for level in rows_mut(pooled, 2 * channels) {
        let (largest, sum) = level.split_at_mut(channels.min(level.len()));
        largest.fill(f32::NEG_INFINITY);
        sum.fill(0.0);
    }
    let near = part_mut(w.avp_pooled, index * ANCHORS * channels, ANCHORS * channels);
    near.fill(0.0);
    let anchor_features =
        part_mut(w.anchor_features, index * ANCHORS * sizes.features, ANCHORS * sizes.features);
    let avp = part(w.avp_weights, unit.start * ANCHORS, unit.count * ANCHORS);
    let points = scene.points_of(unit);
    let mut done = 0;
    for (points, avp) in points.chunks(POINT_TILE).zip(avp.chunks(POINT_TILE * ANCHORS)) {
        trace.enter(Stage::Inputs);
        let inputs = part_mut(w.tile_features, 0, points.len() * sizes.features);
        for (point, row) in points.iter().zip(rows_mut(inputs, sizes.features)) {
            features::raw(model.config(), scene, index, unit, &point.coords, row);
            features::normalise(row, model.encoder.feature_mean, model.encoder.feature_scale);
        }
        trace.enter(Stage::Encoder);
        trace.record(Layer::Features, index, inputs);
        if done == 0 {
            copy(inputs, anchor_features);
        }
        let hidden = part_mut(w.tile_hidden, 0, points.len() * channels);
        let outputs = part_mut(w.tile_points, 0, points.len() * channels);
        model.encoder.point.apply(kernels, inputs, hidden, outputs, &mut w.scratch);
        silu_in_place(outputs);
        trace.record(Layer::PointFeatures, index, outputs);
        for ((row, output), weights) in
            (done..).zip(rows(outputs, channels)).zip(rows(avp, ANCHORS))
        {
            for (level, pool) in rows_mut(pooled, 2 * channels).enumerate() {
                if row < level_count(unit.count, level) {
                    let (largest, sum) = pool.split_at_mut(channels.min(pool.len()));
                    for ((largest, sum), x) in largest.iter_mut().zip(sum).zip(output) {
                        *largest = largest.max(*x);
                        *sum += x;
                    }
                }
            }
            for (anchor, weight) in rows_mut(near, channels).zip(weights) {
                for (anchor, x) in anchor.iter_mut().zip(output) {
                    *anchor += weight * x;
                }
            }
        }
        done += points.len();
    }
    for (level, pool) in rows_mut(pooled, 2 * channels).enumerate() {
        let share = 1.0 / level_count(unit.count, level) as f32;
        let (_, sum) = pool.split_at_mut(channels.min(pool.len()));
        for sum in sum {
            *sum *= share;
        }
    }
}
