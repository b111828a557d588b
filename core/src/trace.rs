//! A look inside the forward pass, for comparing two implementations layer by layer.

/// A place in the forward pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Layer {
    /// (points of a tile, features) normalised inputs; index is the unit.
    Features,
    /// (points of a tile, point width) outputs of the point network; index is the unit.
    PointFeatures,
    /// (impacts, impact features) normalised inputs of a unit's impacts; index is the unit.
    Impacts,
    /// (units, 8 point width, 10 for models with impacts) pooled levels.
    Pooled,
    /// (units, width) tokens at a scale; index 0 is the encoder's output, i block i's.
    Tokens,
    /// (registers, width) registers at a scale, as [`Layer::Tokens`].
    Registers,
    /// (units and registers, width) tokens of block `index` (from 1) after its attention.
    Attention,
    /// (anchors of a tile, width) anchor queries; index 0.
    AnchorQueries,
    /// (anchors of a tile, scales x heads x head_dim) what they saw at each scale; index 0.
    Seen,
    /// (anchors of a tile, width) anchor tokens on their way to the head; index 0.
    AnchorTokens,
    /// (units, anchors, 3) the head's output.
    Head,
    /// (anchors, 3) world positions before the projection, metres; index is the unit.
    Advanced,
}

/// A part of a step, for telling where its work goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Stage {
    /// The search for the nearest points, by kernels with an index of them.
    Nearest,
    /// Inputs of a tile of points; without an index the search for the nearest points foremost.
    Inputs,
    /// Points to unit tokens.
    Encoder,
    /// Unit tokens to unit tokens.
    Interaction,
    /// Anchors to predictions.
    Anchors,
    /// Integration and rigid fit.
    Motion,
}

/// Receives the values of each layer as they are computed. The points of a unit come in
/// farthest-point order, a tile at a time.
pub trait Trace {
    /// One layer's values, row-major.
    fn record(&mut self, layer: Layer, index: usize, values: &[f32]);

    /// Whether [`record`](Self::record) does anything: where it does, threads do not share layers out.
    fn records(&self) -> bool {
        true
    }

    /// A part of the step begins, and the one before it ends. Inputs and encoder take turns,
    /// tile by tile.
    fn enter(&mut self, _: Stage) {}
}

/// Records nothing and costs nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoTrace;

impl Trace for NoTrace {
    fn record(&mut self, _: Layer, _: usize, _: &[f32]) {}

    fn records(&self) -> bool {
        false
    }
}
