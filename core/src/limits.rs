//! Compile-time limits, and how much work is taken at a time.

use crate::quant;

/// Anchors of a unit: farthest-point samples that carry its state. Four determine a pose (paper, section III).
pub const ANCHORS: usize = 4;
/// Pooling levels of the encoder, over all, half, a quarter and an eighth of the points: coarse shape beside detail.
pub const POOL_LEVELS: usize = 4;
/// Blocks that a [`Model`](crate::Model) has room for: 16 with the feature `host`, else 8, since a model lies on a
/// firmware's stack, 288 bytes a block. On Cortex-M with DSP it is 8 with `host` too.
pub const MAX_BLOCKS: usize = if cfg!(rigidformer_host) { 16 } else { 8 };
/// Scales that a [`Model`](crate::Model) has room for: a model lies on a firmware's stack.
pub const MAX_SCALES: usize = 8;
/// Numbers in a command that a [`Simulator`](crate::Simulator) has room for: one turned into a heading lies on the stack.
pub const MAX_COMMAND: usize = 64;
/// Convex pieces of a unit, at most: pairs of two units are their square, which bounds a step's time.
pub const MAX_PIECES: usize = 32;
/// Planes of a scene, at most: each point looks at all, which bounds a step's time.
pub const MAX_PLANES: usize = 8;
/// Substeps that a step is taken in, at most, by models with a longest step: it bounds a step's time.
pub const MAX_SUB_STEPS: u32 = 16;
/// Shorter steps are refused, seconds: motion is exact down to here.
pub const SHORTEST_STEP_S: f32 = 1e-6;
/// As [`SHORTEST_STEP_S`], of models of soft bodies: springs work on places in f32, which tell no velocities over less.
pub const SHORTEST_SOFT_STEP_S: f32 = 1e-3;
/// Coordinates beyond this are refused, metres. A caller's f32 keep 6 cm there; within a scene they count from near its nearest unit.
pub const MAX_COORDINATE_M: f32 = 1e6;
/// Points of a unit closer together than this are one point, metres: they have no extent to fit a rotation to.
pub(crate) const MIN_EXTENT_M: f32 = 1e-6;
/// The fastest that a driven unit may be told to go, m/s: nothing that a robot moves is so fast, so what is faster is a mistake.
pub const MAX_DRIVEN_M_S: f32 = 100.0;

/// How much a simulator must be able to hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Units, at most.
    pub units: usize,
    /// Points of all units together, at most. A unit of several [`Pieces`](crate::Pieces) takes as many as it has, or as
    /// its pieces have and two a piece more, whichever are more.
    pub points: usize,
}

/// How much is taken at a time: memory against reading weights again. No result depends on it.
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

/// What a [`Schedule`](crate::Schedule) needs of a simulator's memory. A simulator is made for one layout and steps on
/// schedules of that layout alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// How much is taken at a time.
    pub tiles: Tiles,
    /// Queries that attend together ([`Kernels::QUERIES`](crate::Kernels::QUERIES)).
    pub queries: usize,
    /// Whether the search for the nearest point goes through an index of the points: far less work where there are
    /// many, for memory that [`SlabSizes::of`](crate::SlabSizes::of) counts. The answer is the same.
    pub index: bool,
}

impl Layout {
    /// For kernels of this crate on one thread.
    pub const SMALL: Layout = Layout { tiles: Tiles::SMALL, queries: 1, index: false };
}
