//! Limits and the sizes that follow from them.

use crate::geometry::index::Room;
use crate::impacts::RECORD;
use crate::kernels::Kernels;
use crate::kernels::attention::scratch_numbers;
use crate::quant;
use rigidformer_weights::{IMPACT_FEATURES, IMPACT_PUSHES, ModelConfig, Motion};

/// Anchors of a unit (paper, section III): farthest-point samples that carry its state.
pub const ANCHORS: usize = 4;
/// Pooling levels of the encoder, over all, half, a quarter and an eighth of the points.
pub const POOL_LEVELS: usize = 4;
/// Blocks that a [`Model`](crate::Model) has room for.
pub const MAX_BLOCKS: usize = 16;
/// Scales that a [`Model`](crate::Model) has room for.
pub const MAX_SCALES: usize = 8;
/// Numbers in a command that a [`Simulator`](crate::Simulator) has room for.
pub const MAX_COMMAND: usize = 64;
/// Coordinates beyond this are refused, metres: f32 keeps 6 cm there.
pub const MAX_COORDINATE_M: f32 = 1e6;

/// How much kernels take at a time: memory against reading weights again. No result depends on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiles {
    /// Points that the point network takes at a time.
    pub points: usize,
    /// Units whose anchors the anchor network takes at a time.
    pub anchor_units: usize,
    /// Rows that an int8 layer quantises at a time.
    pub rows: usize,
    /// Rows that attend at a time, each with scores of its own; more than one only for threads.
    pub workers: usize,
}

impl Tiles {
    /// For small memories: 32 points, 16 anchors, 32 rows.
    pub const SMALL: Tiles = Tiles { points: 32, anchor_units: 4, rows: quant::TILE, workers: 1 };
}

/// How much a simulator must be able to hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Units, at most.
    pub units: usize,
    /// Points of all units together, at most.
    pub points: usize,
}

/// Lengths of the slabs that a caller hands in.
///
/// ```
/// use rigidformer_core::{Limits, SlabSizes, weights::{FeatureSet, Hidden, ModelConfig, Motion, Scales}};
/// const CONFIG: ModelConfig = ModelConfig {
///     width: 64, heads: 2, head_dim: 32, blocks: 4, point_width: 64, registers: 4,
///     feed_forward_width: 160, avp_width: 32, film_width: 16, command_size: 0,
///     rope_frequencies: 4, scales: Scales::new(&[0, 1, 2, 4]), features: FeatureSet::Contact,
///     motion: Motion::Free, gate: true, output_scale: 1.0, frame_rate_hz: 240.0,
///     gravity_m_s2: [0.0, 0.0, -10.0], ground_friction: 0.3, ground_restitution: 0.5,
///     hidden: Hidden::DEFAULT,
/// };
/// const SIZES: SlabSizes = SlabSizes::new(&CONFIG, Limits { units: 10, points: 640 });
/// const _: () = assert!(SIZES.bytes() < 256 * 1024, "the workspace outgrew its RAM budget");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlabSizes {
    /// f32 numbers.
    pub f32: usize,
    /// i8 numbers.
    pub i8: usize,
    /// Points of three f32; for models with impacts twice as many as the limit.
    pub points: usize,
}

impl SlabSizes {
    /// Lengths that a model of this configuration needs within these limits, for kernels of
    /// [`Tiles::SMALL`]: [`Portable`](crate::Portable) and those of this crate.
    pub const fn new(config: &ModelConfig, limits: Limits) -> SlabSizes {
        Self::of::<crate::Portable>(config, limits, 1)
    }

    /// Lengths for so many copies of a scene within these limits, each, and these kernels.
    pub const fn of<K: Kernels>(config: &ModelConfig, limits: Limits, copies: usize) -> SlabSizes {
        let sizes = Sizes::new::<K>(config, limits, copies);
        SlabSizes {
            f32: crate::workspace::total::<K>(&sizes),
            i8: quant::scratch_bytes(sizes.widest, K::TILES.rows),
            points: if config.features.has_impacts() {
                limits.points.saturating_mul(2)
            } else {
                limits.points
            },
        }
    }

    /// All slabs together, bytes.
    pub const fn bytes(&self) -> usize {
        let numbers = self.f32.saturating_add(self.points.saturating_mul(3));
        numbers.saturating_mul(4).saturating_add(self.i8)
    }
}

/// The configuration as lengths. Public fields of a file are at most 16,384, so products of
/// three stay far below `usize` on 64-bit targets; 32-bit targets saturate and the slab
/// check fails.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sizes {
    pub(crate) tiles: Tiles,
    /// Copies of the scene.
    pub(crate) copies: usize,
    /// Units of all copies.
    pub(crate) units: usize,
    /// Points of a copy.
    pub(crate) points: usize,
    /// Learned tokens beside the units of each copy.
    pub(crate) registers: usize,
    /// Units and registers of all copies.
    pub(crate) tokens: usize,
    /// Scratch of queries that attend together.
    pub(crate) scores: usize,
    pub(crate) width: usize,
    pub(crate) head_dim: usize,
    pub(crate) inner: usize,
    pub(crate) blocks: usize,
    pub(crate) point_width: usize,
    /// Of the point network.
    pub(crate) point_hidden: [usize; 2],
    pub(crate) fuse_hidden: usize,
    pub(crate) features: usize,
    /// Numbers of a row of inputs, of a point or of an impact.
    pub(crate) row_features: usize,
    /// Hidden channels of such a row.
    pub(crate) row_hidden: usize,
    /// Pooled rows of a unit, each `point_width` long.
    pub(crate) pools: usize,
    /// Numbers of a unit's record of impacts; 0 for models without.
    pub(crate) impacts: usize,
    pub(crate) feed_forward: usize,
    pub(crate) avp: usize,
    pub(crate) film: usize,
    pub(crate) command: usize,
    pub(crate) angles: usize,
    pub(crate) scales: usize,
    pub(crate) query: usize,
    /// Most inputs of any linear layer.
    pub(crate) widest: usize,
}

impl Sizes {
    pub(crate) const fn new<K: Kernels>(c: &ModelConfig, limits: Limits, copies: usize) -> Sizes {
        let tiles = K::TILES;
        let inner = (c.heads as usize).saturating_mul(c.head_dim as usize);
        let has_impacts = c.features.has_impacts();
        let query = (c.avp_width as usize)
            .saturating_add(c.features.len())
            .saturating_add(if has_impacts { 3 + IMPACT_PUSHES } else { 3 });
        let pools = if has_impacts { 2 * POOL_LEVELS + 2 } else { 2 * POOL_LEVELS };
        let points = c.point_width as usize;
        let (impact_features, impact_hidden) =
            if has_impacts { (IMPACT_FEATURES, points) } else { (0, 0) };
        let inputs = [
            points.saturating_mul(pools),
            impact_features,
            c.width as usize,
            c.feed_forward_width as usize,
            inner.saturating_mul(c.scales.len()),
            inner,
            c.film_width as usize,
            c.command_size as usize,
            query,
            c.point_hidden()[0] as usize,
            c.point_hidden()[1] as usize,
            c.fuse_hidden() as usize,
        ];
        let mut widest = 2;
        let mut rest: &[usize] = &inputs;
        while let [first, tail @ ..] = rest {
            if *first > widest {
                widest = *first;
            }
            rest = tail;
        }
        Sizes {
            tiles: Tiles {
                points: least(tiles.points, limits.points.saturating_mul(copies)),
                anchor_units: least(tiles.anchor_units, limits.units.saturating_mul(copies)),
                ..tiles
            },
            copies,
            units: limits.units.saturating_mul(copies),
            points: limits.points,
            registers: c.registers as usize,
            tokens: limits.units.saturating_add(c.registers as usize).saturating_mul(copies),
            scores: if K::QUERIES > 1 {
                scratch_numbers(
                    limits.units.saturating_add(c.registers as usize),
                    c.head_dim as usize,
                )
            } else {
                limits.units.saturating_add(c.registers as usize)
            },
            width: c.width as usize,
            head_dim: c.head_dim as usize,
            inner,
            blocks: c.blocks as usize,
            point_width: c.point_width as usize,
            point_hidden: [c.point_hidden()[0] as usize, c.point_hidden()[1] as usize],
            fuse_hidden: c.fuse_hidden() as usize,
            features: c.features.len(),
            row_features: most(c.features.len(), impact_features),
            row_hidden: most(c.point_hidden()[0] as usize, impact_hidden),
            pools,
            impacts: if has_impacts { RECORD } else { 0 },
            feed_forward: c.feed_forward_width as usize,
            avp: c.avp_width as usize,
            film: c.film_width as usize,
            command: c.command_size as usize,
            angles: (c.rope_frequencies as usize).saturating_mul(3),
            scales: c.scales.len(),
            query,
            widest,
        }
    }

    /// Whether a processor's own cache holds the weights of a part of the network: then threads that
    /// share rows lose nothing by reading all of them, each.
    pub(crate) fn is_small(&self) -> bool {
        self.unit_work().max(self.token_work()).max(4 * self.anchor_work()) <= 4 << 20
    }

    /// Multiplications for a point.
    pub(crate) fn point_work(&self) -> usize {
        let [first, second] = self.point_hidden;
        match second {
            0 => (self.features + self.point_width) * first,
            _ => self.features * first + first * second + second * self.point_width,
        }
    }

    /// Multiplications to fuse a unit's points.
    pub(crate) fn unit_work(&self) -> usize {
        (self.pools * self.point_width + self.width) * self.fuse_hidden
    }

    /// Multiplications of a block for a token, attention aside.
    pub(crate) fn token_work(&self) -> usize {
        self.width * (7 * self.inner + 3 * self.feed_forward)
    }

    /// Multiplications for an anchor, attention aside.
    pub(crate) fn anchor_work(&self) -> usize {
        let seen = self.scales * self.inner * (2 + 1);
        self.width * (self.query + 2 * self.width + seen) + 2 * self.avp * self.point_width
    }

    /// What an index of the points must hold.
    pub(crate) const fn room(&self) -> Room {
        let copies = if self.copies > 1 { self.copies } else { 1 };
        Room { units: self.units / copies, points: self.points, copies }
    }
}

const fn most(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

const fn least(a: usize, b: usize) -> usize {
    if a < b { a } else { b }
}

/// Whether the integrator is the free-motion one.
pub(crate) fn is_free(config: &ModelConfig) -> bool {
    config.motion == Motion::Free
}
