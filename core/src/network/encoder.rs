//! Hierarchical PointNet: points to unit tokens (docs/MODEL.md, section 3).

use crate::contact::impacts;
use crate::contact::prior;
use crate::geometry::index::{self, Answers, ROW};
use crate::kernels::{Kernels, Schedule};
use crate::limits::{ANCHORS, POOL_LEVELS};
use crate::model::{Impacts, Model};
use crate::network::features;
use crate::network::layers::modulate;
use crate::network::present::Present;
use crate::network::{Buffers, View};
use crate::scene::{Scene, UnitSlot};
use crate::share::{UnitRange, Units, Work, share_out};
use crate::sizes::Sizes;
use crate::slices::{copy_slice, rows, rows_mut, slice_at, slice_at_mut};
use crate::stand_in::IS_HOST;
use crate::trace::{Layer, Stage, Trace};
use crate::workspace::{RowLengths, Rows, command_places};
use rigidformer_weights::IMPACT_FEATURES;

/// Cost of a point's inputs, in multiplications: decides whether threads share them. Most is the search for the nearest
/// point.
const POINT_COST: usize = 1500;
/// Cost of searching for what is nearest to a leaf's points, in multiplications (about 1 us): decides whether threads
/// share it.
const LEAF_COST: usize = 8 << 10;
/// Cost of finding a unit's impacts, in multiplications: decides whether threads share it.
const IMPACTS_COST: usize = 64 << 10;

/// Fills the units' rows of `tokens` (copies, units and registers, width), `avp_pooled` and
/// `anchor_features`.
#[inline(never)]
pub(crate) fn encode<S: Schedule, T: Trace>(
    schedule: S,
    model: &Model<'_>,
    sizes: &Sizes,
    view: View<'_>,
    buffers: Buffers<'_, '_>,
    trace: &mut T,
) {
    let (View { scene, present }, Buffers { lasting, rows: w }) = (view, buffers);
    let total = first_point(scene, present, present.rows());
    // Points that deform leave the boxes of the index.
    let indexed = S::LAYOUT.index && !sizes.is_soft();
    if indexed {
        trace.enter(Stage::Nearest);
        find_nearest(schedule, sizes, view, lasting.distance);
    }
    let answers = if indexed {
        index::Parts::new(lasting.distance, &sizes.room()).answers(scene.per_copy)
    } else {
        Answers::EMPTY
    };
    let (weights, films) = (&*lasting.avp_weights, &*lasting.films);
    let solved = &*lasting.solved;
    let encode = Encode { model, sizes, scene, present, answers, weights, films, solved };
    let count = present.rows();
    let units = Units { first: 0, count, tile: sizes.tiles.points };
    let cost = total * sizes.point_work() + count * sizes.unit_work();
    trace.enter(Stage::Encoder);
    let whole = UnitRange { units, sizes, w: w.reborrow(), cut };
    // What threads share is cut by units, and soft ones' channels lie by points.
    let may_share = sizes.is_small() && !sizes.is_soft();
    share_out(schedule, trace, (may_share, cost), &encode, whole);
    let width = sizes.width;
    for context in 0..present.contexts() {
        let rows = present.rows_of(context);
        let start = present.token_start(context, sizes.registers) * width;
        let tokens = slice_at_mut(w.tokens, start, rows.len() * width);
        copy_slice(slice_at(w.normed, rows.start * width, rows.len() * width), tokens);
        if model.encoder.command.is_some() {
            let copy_index = present.unit(rows.start) / scene.per_copy.max(1);
            let film = copy_index * command_places(sizes) * 2 * width;
            modulate(tokens, slice_at(lasting.commands, film, 2 * width));
        }
    }
}

/// What all units read.
struct Encode<'a> {
    model: &'a Model<'a>,
    sizes: &'a Sizes,
    scene: &'a Scene<'a>,
    present: Present<'a>,
    answers: Answers<'a>,
    weights: &'a [f32],
    films: &'a [f32],
    /// Motion by impulses; empty for models without.
    solved: &'a [f32],
}

impl Work<UnitRange<'_>> for Encode<'_> {
    type Out = ();

    fn run<S: Schedule, T: Trace>(&self, schedule: S, mut part: UnitRange<'_>, trace: &mut T) {
        encode_units(schedule, self, part.units, &mut part.w, trace);
    }

    fn merge((): (), (): ()) {}
}

/// What of the buffers belongs to units.
fn cut(s: &Sizes, units: Units) -> RowLengths {
    let Units { count, tile, .. } = units;
    RowLengths {
        tile_features: tile * s.row_features,
        tile_hidden: tile * s.row_hidden,
        tile_second: tile * s.point_hidden[1],
        tile_points: tile * s.point_width,
        pooled: count * s.pools * s.point_width,
        impacts: count * s.impacts,
        avp_pooled: count * ANCHORS * s.point_width,
        anchor_features: count * ANCHORS * s.features,
        fuse_hidden: count * s.fuse_hidden,
        normed: count * s.width,
        ..RowLengths::default()
    }
}

/// The number of a row's first point, counted through all rows; behind the last row, that of
/// all points.
fn first_point(scene: &Scene<'_>, present: Present<'_>, unit: usize) -> usize {
    if let Some(before) = present.points_before(unit) {
        return before;
    }
    let copy = unit.checked_div(scene.per_copy).unwrap_or_default();
    let (_, around) = scene.around(unit);
    let start = scene.units().get(unit).map_or(0, |unit| unit.start - first_row(around));
    copy * scene.points_per_copy() + start
}

/// The row of the slab of points where those of a copy begin: that of all copies, but where they have soft units.
fn first_row(copy: &[UnitSlot]) -> usize {
    if IS_HOST { copy.first().map_or(0, |unit| unit.start) } else { 0 }
}

/// Leaves the tokens of units in `normed`.
fn encode_units<S: Schedule, T: Trace>(
    schedule: S,
    fixed: &Encode<'_>,
    units: Units,
    w: &mut Rows<'_>,
    trace: &mut T,
) {
    let Encode { model, sizes, scene, present, films, .. } = fixed;
    let total = first_point(scene, *present, units.first + units.count);
    let mut done = first_point(scene, *present, units.first);
    while done < total {
        let end = total.min(done + units.tile.max(1));
        encode_tile(schedule, fixed, (units.first, done, end), w, trace);
        done = end;
    }
    if let Some(net) = &model.encoder.impact {
        encode_impacts(schedule, (net, fixed), units, w, trace);
    }
    let (count, width) = (units.count, sizes.width);
    let pooled = slice_at(w.pooled, 0, count * sizes.pools * sizes.point_width);
    trace.record(Layer::Pooled, 0, pooled);
    let hidden = slice_at_mut(w.fuse_hidden, 0, count * sizes.fuse_hidden);
    let fused = slice_at_mut(w.normed, 0, count * width);
    model.encoder.fuse.apply(schedule, pooled, hidden, fused, &mut w.scratch);
    modulate(fused, slice_at(films, 0, 2 * width));
}

/// What is nearest to each point, by the index: moves the boxes of units, and searches.
fn find_nearest<S: Schedule>(
    schedule: S,
    sizes: &Sizes,
    View { scene, present }: View<'_>,
    slab: &mut [f32],
) {
    let placed = scene.units().iter().map(|unit| (&unit.current, unit.radius, unit.body));
    let mut parts = index::Parts::new(slab, &sizes.room());
    parts.place(scene.per_copy, placed);
    let (index, answers) = parts.search(scene.per_copy, &scene.planes);
    let answers = slice_at_mut(answers, 0, index.rows(scene.copies()) * ROW);
    schedule.each_row(answers, ROW, LEAF_COST, &mut [], |row, out, _| {
        // Nobody reads what is nearest to units that the network does not see.
        if index.unit(row).is_some_and(|unit| present.row(unit).is_some()) {
            schedule.kernels().nearest_of_leaf(&index, row, out);
        }
    });
}

/// Points of a unit that level `level` pools over: a prefix of the farthest-point order.
fn level_count(points: usize, level: usize) -> usize {
    (points.div_ceil(1 << level)).max(1)
}

/// The row, its unit, and the place in it, of a point counted through all rows.
fn locate<'s>(
    scene: &'s Scene<'_>,
    present: Present<'_>,
    point: usize,
) -> Option<(usize, &'s UnitSlot, usize)> {
    if let Some(row) = present.row_of_point(point) {
        let unit = scene.units().get(present.unit(row))?;
        return Some((row, unit, point.checked_sub(present.points_before(row)?)?));
    }
    let (mut first, mut units, mut point) = (0, scene.units(), point);
    if IS_HOST {
        let per_copy = scene.points_per_copy().max(1);
        (first, units) = scene.around(point / per_copy * scene.per_copy);
        point = point % per_copy + first_row(units);
    }
    let unit = units.partition_point(|unit| unit.start <= point).checked_sub(1)?;
    let state = units.get(unit)?;
    Some((first + unit, state, point - state.start))
}

/// The point so many points on from one, as [`locate`] finds it: a tile has few units.
fn onward<'s>(
    View { scene, present }: View<'s>,
    (mut row, mut unit, point): (usize, &'s UnitSlot, usize),
    points: usize,
) -> Option<(usize, &'s UnitSlot, usize)> {
    let mut point = point + points;
    while point >= unit.count {
        point -= unit.count;
        row += 1;
        unit = scene.units().get(present.unit(row))?;
    }
    Some((row, unit, point))
}

/// The points from `start` to `end`, of as many units as they belong to; the workspace's rows begin
/// with those of `first_row`.
fn encode_tile<S: Schedule, T: Trace>(
    schedule: S,
    fixed: &Encode<'_>,
    (first_row, start, end): (usize, usize, usize),
    w: &mut Rows<'_>,
    trace: &mut T,
) {
    let Encode { model, sizes, scene, present, answers, weights, .. } = fixed;
    let kernels = schedule.kernels();
    let config = model.config();
    let net = &model.encoder;
    let count = end - start;
    trace.enter(Stage::Inputs);
    let inputs = slice_at_mut(w.tile_features, 0, count * sizes.features);
    let Some(first) = locate(scene, *present, start) else { return };
    schedule.each_row(inputs, sizes.features, POINT_COST, &mut [], |row, out, _| {
        let Some((row, unit, point)) = onward(View { scene, present: *present }, first, row) else {
            return;
        };
        let index = present.unit(row);
        let indexed = S::LAYOUT.index && !sizes.is_soft();
        let found = indexed.then(|| answers.nearest(index, unit.start + point));
        features::raw(kernels, config, scene, found, (index, unit), point, out);
        kernels.normalise(out, net.feature_mean, net.feature_scale, features::CLAMP);
    });
    trace.enter(Stage::Encoder);
    let hidden = [
        slice_at_mut(w.tile_hidden, 0, count * sizes.point_hidden[0]),
        slice_at_mut(w.tile_second, 0, count * sizes.point_hidden[1]),
    ];
    let outputs = slice_at_mut(w.tile_points, 0, count * sizes.point_width);
    net.point.apply(schedule, inputs, hidden, outputs, &mut w.scratch);
    let (inputs, outputs) = (&*inputs, &*outputs);
    if sizes.is_soft() {
        let width = sizes.point_width;
        copy_slice(outputs, slice_at_mut(w.point_channels, start * width, count * width));
    }
    let mut at = start;
    while let Some((row, unit, first)) = locate(scene, *present, at).filter(|_| at < end) {
        let (row, index) = (row - first_row, present.unit(row));
        let count = (unit.count - first).min(end - at);
        let inputs = slice_at(inputs, (at - start) * sizes.features, count * sizes.features);
        let outputs =
            slice_at(outputs, (at - start) * sizes.point_width, count * sizes.point_width);
        trace.record(Layer::Features, index, inputs);
        trace.record(Layer::PointFeatures, index, outputs);
        if first < ANCHORS {
            // A tile may end between a unit's anchors.
            let length = count.min(ANCHORS - first) * sizes.features;
            let place = (row * ANCHORS + first) * sizes.features;
            copy_slice(slice_at(inputs, 0, length), slice_at_mut(w.anchor_features, place, length));
        }
        let channels = sizes.point_width;
        let (pooled, near) = (2 * POOL_LEVELS * channels, ANCHORS * channels);
        let pools = Pools {
            levels: slice_at_mut(w.pooled, row * sizes.pools * channels, pooled),
            near: slice_at_mut(w.avp_pooled, row * near, near),
            weights: slice_at(weights, unit.start * ANCHORS, unit.count * ANCHORS),
        };
        pool(kernels, channels, unit.count, (first, outputs), pools);
        at += count;
    }
}

/// Finds the impacts of units, and pools them into the last two rows of `pooled`.
#[inline(never)]
fn encode_impacts<S: Schedule, T: Trace>(
    schedule: S,
    (net, fixed): (&Impacts<'_>, &Encode<'_>),
    units: Units,
    w: &mut Rows<'_>,
    trace: &mut T,
) {
    let Encode { sizes, scene, present, solved, .. } = fixed;
    let kernels = schedule.kernels();
    trace.enter(Stage::Inputs);
    let Units { first, count, tile } = units;
    let records = slice_at_mut(w.impacts, 0, count * sizes.impacts);
    schedule.each_row(records, sizes.impacts, IMPACTS_COST, &mut [], |row, record, _| {
        let index = present.unit(first + row);
        impacts::describe(scene, index, record);
        if !solved.is_empty() {
            prior::push(scene, index, &prior::solved(scene, index, solved), record);
        }
    });
    trace.enter(Stage::Encoder);
    let (records, channels) = (&*records, sizes.point_width);
    let pools = sizes.pools * channels;
    for (record, pooled) in rows(records, sizes.impacts).zip(rows_mut(w.pooled, pools)) {
        let pooled = slice_at_mut(pooled, pools.saturating_sub(2 * channels), 2 * channels);
        let (largest, sum) = pooled.split_at_mut(channels.min(pooled.len()));
        // No impact is no impact, not the smallest possible one.
        let none = impacts::inputs(record).len() == 0;
        largest.fill(if none { 0.0 } else { f32::NEG_INFINITY });
        sum.fill(0.0);
    }
    // All units' impacts one after another, as many at a time as a tile has rows.
    let all = || {
        rows(records, sizes.impacts)
            .enumerate()
            .flat_map(|(unit, record)| impacts::inputs(record).map(move |input| (unit, input)))
    };
    let total = all().count();
    let mut done = 0;
    while done < total {
        let count = tile.max(1).min(total - done);
        let inputs = slice_at_mut(w.tile_features, 0, count * IMPACT_FEATURES);
        for ((unit, from), to) in all().skip(done).zip(rows_mut(inputs, IMPACT_FEATURES)) {
            copy_slice(from, to);
            kernels.normalise(to, net.mean, net.scale, features::CLAMP);
            trace.record(Layer::Impacts, present.unit(first + unit), to);
        }
        let hidden = [slice_at_mut(w.tile_hidden, 0, count * channels), &mut [][..]];
        let outputs = slice_at_mut(w.tile_points, 0, count * channels);
        net.network.apply(schedule, inputs, hidden, outputs, &mut w.scratch);
        for ((unit, _), output) in all().skip(done).zip(rows(outputs, channels)) {
            let place = (unit + 1) * pools - 2 * channels;
            let pooled = slice_at_mut(w.pooled, place, 2 * channels);
            let (largest, sum) = pooled.split_at_mut(channels.min(pooled.len()));
            kernels.pool(output, largest, sum);
        }
        done += count;
    }
}

/// What a unit's points are pooled into.
struct Pools<'w> {
    /// (levels, 2 channels) maximum and mean.
    levels: &'w mut [f32],
    /// (anchors, channels)
    near: &'w mut [f32],
    /// (points, anchors)
    weights: &'w [f32],
}

/// Pools the outputs (points, channels) of a unit's points from `first` on.
fn pool<K: Kernels>(
    kernels: K,
    channels: usize,
    unit_points: usize,
    (first, outputs): (usize, &[f32]),
    Pools { levels: pooled, near, weights }: Pools<'_>,
) {
    let end = first + outputs.len() / channels.max(1);
    // A level's prefix begins with the next one's, so one running maximum and sum, that of the
    // first level, pass through the values of the others.
    let (running, levels) = pooled.split_at_mut((2 * channels).min(pooled.len()));
    let (largest, sum) = running.split_at_mut(channels.min(running.len()));
    if first == 0 {
        largest.fill(f32::NEG_INFINITY);
        sum.fill(0.0);
        near.fill(0.0);
    }
    let mut from = first;
    for level in (0..POOL_LEVELS).rev() {
        let count = level_count(unit_points, level);
        let to = count.max(from).min(end);
        let run = slice_at(outputs, (from - first) * channels, (to - from) * channels);
        kernels.pool(run, largest, sum);
        from = to;
        if level > 0 && first < count && count <= end {
            let level = slice_at_mut(levels, (level - 1) * 2 * channels, 2 * channels);
            let (level_largest, level_sum) = level.split_at_mut(channels.min(level.len()));
            copy_slice(largest, level_largest);
            copy_slice(sum, level_sum);
        }
    }
    let weights = slice_at(weights, first * ANCHORS, (end - first) * ANCHORS);
    kernels.weigh(outputs, weights.as_chunks().0, near);
    if end < unit_points {
        return;
    }
    for (level, pool) in rows_mut(pooled, 2 * channels).enumerate() {
        let share = 1.0 / level_count(unit_points, level) as f32;
        let (_, sum) = pool.split_at_mut(channels.min(pool.len()));
        for sum in sum {
            *sum *= share;
        }
    }
}
