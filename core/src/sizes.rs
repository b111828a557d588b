//! Lengths that follow from a model's configuration, the limits and the layout.

use crate::contact::impacts::RECORD;
use crate::contact::prior;
use crate::geometry::index::Room;
use crate::kernels::scratch_numbers;
use crate::limits::{Layout, Limits, POOL_LEVELS, Tiles};
use rigidformer_weights::{
    BLEND_CODE, BLEND_HIDDEN, BOND_FEATURES, IMPACT_FEATURES, IMPACT_PUSHES, ModelConfig,
};

/// Pooled rows of a unit: maximum and mean of each level, and maximum and sum over impacts.
pub(crate) const fn pools(config: &ModelConfig) -> usize {
    if config.features.has_impacts() { 2 * POOL_LEVELS + 2 } else { 2 * POOL_LEVELS }
}

/// Inputs of the network of anchor queries.
pub(crate) const fn query_inputs(config: &ModelConfig) -> usize {
    let pushes = if config.features.has_impacts() { IMPACT_PUSHES } else { 0 };
    (config.avp_width as usize).saturating_add(config.features.len()).saturating_add(3 + pushes)
}

/// Inputs of the network of bonds: the sum of two units' tokens, how far they differ, and what it is told besides. 0 for models without.
pub(crate) const fn bond_inputs(config: &ModelConfig) -> usize {
    if config.bonds == 0 {
        return 0;
    }
    (config.width as usize).saturating_mul(2).saturating_add(BOND_FEATURES)
}

/// The configuration as lengths. Public fields of a file are at most 16,384, so products of
/// three stay far below `usize` on 64-bit targets; 32-bit targets saturate and the slab
/// check fails.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sizes {
    pub(crate) layout: Layout,
    /// Those of the layout, no larger than the limits.
    pub(crate) tiles: Tiles,
    /// Copies of the scene.
    pub(crate) copies: usize,
    /// Units of all copies.
    pub(crate) units: usize,
    /// Points of a copy.
    pub(crate) points: usize,
    /// Rows of the slab of points.
    #[cfg(feature = "deform")]
    point_rows: usize,
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
    /// Springs of a point of a soft body; 0 for models of rigid ones.
    #[cfg_attr(not(feature = "deform"), expect(dead_code, reason = "see is_soft"))]
    pub(crate) neighbours: usize,
    /// Points of all copies whose channels are kept, for soft ones to read.
    pub(crate) kept_points: usize,
    /// Numbers of soft bodies' state and scratch.
    pub(crate) soft: usize,
    /// Numbers of a row that the point network writes.
    pub(crate) row_out: usize,
    /// Numbers of a unit's record of impacts; 0 for models without.
    pub(crate) impacts: usize,
    pub(crate) feed_forward: usize,
    /// Tokens that go through the feed-forward layers at a time: all where threads share them.
    pub(crate) fed: usize,
    pub(crate) avp: usize,
    pub(crate) film: usize,
    /// 1 for models whose steps may be taken in substeps, else 0.
    pub(crate) substepped: usize,
    pub(crate) command: usize,
    pub(crate) angles: usize,
    pub(crate) scales: usize,
    /// Numbers of an anchor that the head gives.
    pub(crate) outputs: usize,
    /// Numbers of a unit that motion by impulses takes, its room for bonds and for which units the network sees among them; 0 for models without.
    pub(crate) solved: usize,
    /// 1 where the network sees some of the units, else 0.
    pub(crate) near: usize,
    pub(crate) query: usize,
    /// Inputs and hidden channels of the network of bonds; 0 for models without.
    pub(crate) bonds: [usize; 2],
    /// Most inputs of any linear layer.
    pub(crate) widest: usize,
}

impl Sizes {
    pub(crate) const fn new(
        c: &ModelConfig,
        limits: Limits,
        copies: usize,
        layout: Layout,
    ) -> Sizes {
        let tiles = layout.tiles;
        let tokens = limits.units.saturating_add(c.registers as usize).saturating_mul(copies);
        let inner = (c.heads as usize).saturating_mul(c.head_dim as usize);
        let has_impacts = c.features.has_impacts();
        let query = query_inputs(c);
        let pools = pools(c);
        let points = c.point_width as usize;
        let (impact_features, impact_hidden) =
            if has_impacts { (IMPACT_FEATURES, points) } else { (0, 0) };
        let soft = cfg!(feature = "deform") && c.motion.is_soft();
        let (blend, blend_hidden) =
            if soft { (points.saturating_add(BLEND_CODE), BLEND_HIDDEN) } else { (0, 0) };
        #[cfg(feature = "deform")]
        let neighbours = if soft { c.elastic.neighbours as usize } else { 0 };
        #[cfg(not(feature = "deform"))]
        let neighbours = 0;
        let near = if cfg!(feature = "host") && c.scope.is_near() { 1 } else { 0 };
        #[cfg(feature = "deform")]
        let point_rows = if soft { limits.points.saturating_mul(copies) } else { limits.points };
        #[cfg(not(feature = "deform"))]
        let point_rows = limits.points;
        let units = limits.units.saturating_mul(copies);
        let bonds =
            if cfg!(feature = "deform") { [bond_inputs(c), c.bonds as usize] } else { [0, 0] };
        let inputs = [
            points.saturating_mul(pools),
            impact_features,
            blend,
            blend_hidden,
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
            bonds[0],
            bonds[1],
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
            layout,
            tiles: Tiles {
                points: least(tiles.points, limits.points.saturating_mul(copies)),
                anchor_units: least(tiles.anchor_units, limits.units.saturating_mul(copies)),
                ..tiles
            },
            copies,
            units,
            points: limits.points,
            #[cfg(feature = "deform")]
            point_rows,
            registers: c.registers as usize,
            tokens,
            scores: if layout.queries > 1 {
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
            row_features: most(most(c.features.len(), impact_features), blend),
            row_hidden: most(most(c.point_hidden()[0] as usize, impact_hidden), blend_hidden),
            row_out: if soft { most(points, 6) } else { points },
            neighbours,
            kept_points: if soft { point_rows } else { 0 },
            soft: soft_numbers(units, point_rows, neighbours),
            pools,
            impacts: if has_impacts { RECORD } else { 0 },
            feed_forward: c.feed_forward_width as usize,
            fed: if tiles.workers > 1 || tokens < FED { tokens } else { FED },
            avp: c.avp_width as usize,
            film: c.film_width as usize,
            substepped: if c.similarity.longest_step > 0.0 { 1 } else { 0 },
            command: c.command_size as usize,
            angles: (c.rope_frequencies as usize).saturating_mul(3),
            scales: c.scales.len(),
            outputs: c.motion.outputs(),
            solved: if c.motion.has_impulses() {
                let extra = if layout.index { prior::extra(limits.units) } else { 0 };
                prior::solved_numbers(limits.units) + extra + BOND_ROOM + near * NEAR_ROOM
            } else {
                0
            },
            near,
            query,
            bonds,
            widest,
        }
    }

    /// Rows of the slab of points: copies share them, but for soft ones, which each copy has where they are.
    pub(crate) const fn point_rows(&self) -> usize {
        #[cfg(feature = "deform")]
        return self.point_rows;
        #[cfg(not(feature = "deform"))]
        self.points
    }

    /// Whether points may deform.
    pub(crate) const fn is_soft(&self) -> bool {
        #[cfg(feature = "deform")]
        let is_soft = self.neighbours > 0;
        #[cfg(not(feature = "deform"))]
        let is_soft = false;
        is_soft
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

/// Numbers of a unit's room for bonds.
#[cfg(feature = "deform")]
const BOND_ROOM: usize = crate::structure::bonds::ROOM;
#[cfg(not(feature = "deform"))]
const BOND_ROOM: usize = 0;

/// Numbers of a unit for which units the network sees: of a copy with one unit as many as there can be. Models that take them are for
/// the feature `host`.
const NEAR_ROOM: usize = near_numbers(1, 1);

/// Numbers that say which units the network sees, of so many units and copies: how many rows, points and contexts there are, then the
/// lists.
pub(crate) const fn near_numbers(units: usize, copies: usize) -> usize {
    units.saturating_mul(2).saturating_add(copies).saturating_add(NEAR_COUNTS)
}

/// The first of them.
pub(crate) const NEAR_COUNTS: usize = 3;

/// Of the state and scratch of soft bodies.
#[cfg(feature = "deform")]
const fn soft_numbers(units: usize, points: usize, neighbours: usize) -> usize {
    crate::structure::soft_points::numbers(units, points, neighbours)
}

#[cfg(not(feature = "deform"))]
const fn soft_numbers(_: usize, _: usize, _: usize) -> usize {
    0
}

/// See [`Sizes::fed`]: few save memory, more read weights less often.
const FED: usize = 16;

const fn most(a: usize, b: usize) -> usize {
    if a > b { a } else { b }
}

const fn least(a: usize, b: usize) -> usize {
    if a < b { a } else { b }
}
