//! A look inside the forward pass, for comparing two implementations layer by layer.

use rigidformer_weights::{IMPACT_FEATURES, ModelConfig};

use crate::{ANCHORS, POOL_LEVELS};

/// Defines the layers, each with its name, so that none is missing from [`Layer::ALL`].
macro_rules! layers {
    ($( $(#[$doc:meta])* $layer:ident = $name:literal, )+) => {
        /// A place in the forward pass. The order is that of the computation. Rows are the units that the network sees: all, but in models of scope near.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[non_exhaustive]
        pub enum Layer {
            $( $(#[$doc])* $layer, )+
        }

        impl Layer {
            /// Every layer, in the order of the forward pass.
            pub const ALL: &'static [Layer] = &[$( Layer::$layer, )+];

            /// As files and tables call it.
            pub const fn name(self) -> &'static str {
                match self {
                    $( Layer::$layer => $name, )+
                }
            }
        }
    };
}

layers! {
    /// (points of a tile, features) normalised inputs; index is the unit.
    Features = "features",
    /// (points of a tile, point width) outputs of the point network; index is the unit.
    PointFeatures = "point_features",
    /// (impacts, impact features) normalised inputs of a unit's impacts; index is the unit.
    Impacts = "impacts",
    /// (rows, 8 point width, 10 for models with impacts) pooled levels.
    Pooled = "pooled",
    /// (rows, width) tokens at a scale; index 0 is the encoder's output, i block i's.
    Tokens = "tokens",
    /// (registers, width) registers at a scale, as [`Layer::Tokens`].
    Registers = "registers",
    /// (rows and registers, width) tokens of block `index` (from 1) after its attention.
    Attention = "attention",
    /// (anchors of a tile, width) anchor queries; index 0.
    AnchorQueries = "anchor_queries",
    /// (anchors of a tile, scales x heads x head_dim) what they saw at each scale; index 0.
    Seen = "seen",
    /// (anchors of a tile, width) anchor tokens on their way to the head; index 0.
    AnchorTokens = "anchor_tokens",
    /// (rows, anchors, 3, 6 or 22) the head's output.
    Head = "head",
    /// (anchors, 3) world positions before the projection, metres; index is the unit.
    Advanced = "advanced",
}

// Matches without a default: a new layer has to answer each of them.
impl Layer {
    /// The layer of this [name](Layer::name).
    pub fn from_name(name: &str) -> Option<Layer> {
        Layer::ALL.iter().copied().find(|layer| layer.name() == name)
    }

    /// What a row is.
    pub const fn row(self) -> &'static str {
        match self {
            Layer::Features | Layer::PointFeatures => "point",
            Layer::Impacts => "impact",
            // Rows of attention beyond the units are registers.
            Layer::Pooled | Layer::Tokens | Layer::Attention | Layer::Head => "unit",
            Layer::Registers => "register",
            Layer::AnchorQueries | Layer::Seen | Layer::AnchorTokens | Layer::Advanced => "anchor",
        }
    }

    /// Numbers of a row, in a model with this configuration.
    pub const fn columns(self, config: &ModelConfig) -> usize {
        let (width, points) = (config.width as usize, config.point_width as usize);
        let pools = 2 * POOL_LEVELS + if config.features.has_impacts() { 2 } else { 0 };
        match self {
            Layer::Features => config.features.len(),
            Layer::PointFeatures => points,
            Layer::Impacts => IMPACT_FEATURES,
            Layer::Pooled => pools.saturating_mul(points),
            Layer::Tokens
            | Layer::Registers
            | Layer::Attention
            | Layer::AnchorQueries
            | Layer::AnchorTokens => width,
            Layer::Seen => (config.heads as usize)
                .saturating_mul(config.head_dim as usize)
                .saturating_mul(config.scales.len()),
            Layer::Head => config.motion.outputs().saturating_mul(ANCHORS),
            Layer::Advanced => 3,
        }
    }

    /// Whether the index is a scale or a block.
    pub const fn is_by_scale(self) -> bool {
        match self {
            Layer::Tokens | Layer::Registers | Layer::Attention => true,
            Layer::Features
            | Layer::PointFeatures
            | Layer::Impacts
            | Layer::Pooled
            | Layer::AnchorQueries
            | Layer::Seen
            | Layer::AnchorTokens
            | Layer::Head
            | Layer::Advanced => false,
        }
    }

    /// Whether the index is a unit, to which all rows belong; otherwise rows are of all units.
    pub const fn is_by_unit(self) -> bool {
        match self {
            Layer::Features | Layer::PointFeatures | Layer::Impacts | Layer::Advanced => true,
            Layer::Pooled
            | Layer::Tokens
            | Layer::Registers
            | Layer::Attention
            | Layer::AnchorQueries
            | Layer::Seen
            | Layer::AnchorTokens
            | Layer::Head => false,
        }
    }

    /// Rows of one unit, where rows are of all units.
    pub const fn rows_of_a_unit(self) -> usize {
        match self {
            Layer::AnchorQueries | Layer::Seen | Layer::AnchorTokens => ANCHORS,
            Layer::Features
            | Layer::PointFeatures
            | Layer::Impacts
            | Layer::Pooled
            | Layer::Tokens
            | Layer::Registers
            | Layer::Attention
            | Layer::Head
            | Layer::Advanced => 1,
        }
    }

    /// Whether the number of rows may depend on the state, and not on the model and the scene alone: impacts come and go, and the
    /// network may see some of the units.
    pub const fn rows_vary(self) -> bool {
        match self {
            Layer::Features
            | Layer::PointFeatures
            | Layer::Impacts
            | Layer::Pooled
            | Layer::Tokens
            | Layer::Registers
            | Layer::Attention
            | Layer::AnchorQueries
            | Layer::Seen
            | Layer::AnchorTokens
            | Layer::Head => true,
            Layer::Advanced => false,
        }
    }
}

/// A part of a step, for telling where its work goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Stage {
    /// Motion by impulses, before the network corrects it.
    Impulses,
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

    /// Bonds broke: what was recorded of the step is void, and its layers come again.
    fn begin_again(&mut self) {}
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unlike_and_lead_back() {
        assert_eq!(Layer::ALL.len(), 12);
        assert!(Layer::ALL.is_sorted_by(|a, b| a < b));
        for layer in Layer::ALL {
            assert_eq!(Layer::from_name(layer.name()), Some(*layer));
        }
        assert_eq!(Layer::from_name("other"), None);
    }
}
