//! The memory that a simulator works in, which its caller owns.

use crate::limits::{Layout, Limits};
use crate::quant;
use crate::scene::UnitSlot;
use crate::sizes::Sizes;
use crate::workspace;
use nalgebra::Point3;
use rigidformer_weights::ModelConfig;

/// Memory that the caller owns and a simulator works in. Lengths: [`SlabSizes::new`].
pub struct Slabs<'s> {
    /// Activations.
    pub f32: &'s mut [f32],
    /// Rows on their way into int8 layers.
    pub i8: &'s mut [i8],
    /// The scene's points.
    pub points: &'s mut [Point3<f32>],
    /// The scene's units.
    pub units: &'s mut [UnitSlot],
}

/// Lengths of the slabs that a caller hands in.
///
/// ```
/// use rigidformer_core::{Limits, SlabSizes, weights::{Directions, Elastic, FeatureSet, Hidden, ModelConfig, Motion, Scales, Scope, Similarity}};
/// const CONFIG: ModelConfig = ModelConfig {
///     width: 64, heads: 2, head_dim: 32, blocks: 4, point_width: 64, registers: 4,
///     feed_forward_width: 160, avp_width: 32, film_width: 16, command_size: 0,
///     rope_frequencies: 4, scales: Scales::new(&[0, 1, 2, 4]), features: FeatureSet::Contact,
///     motion: Motion::Free, gate: true, output_scale: 1.0, frame_rate_hz: 240.0,
///     gravity_m_s2: [0.0, 0.0, -10.0], ground_friction: 0.3, ground_restitution: 0.5,
///     hidden: Hidden::DEFAULT, similarity: Similarity::OFF, directions: Directions::NONE, elastic: Elastic::NONE, bonds: 0,
///     scope: Scope::All, most_units: 0,
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
    /// Points of three f32; for models with impacts twice as many as the limit, and for models that move soft bodies as many for each copy.
    pub points: usize,
    /// Units.
    pub units: usize,
}

impl SlabSizes {
    /// Lengths that a model of this configuration needs within these limits, on kernels of this crate and one thread
    /// ([`Layout::SMALL`]).
    pub const fn new(config: &ModelConfig, limits: Limits) -> SlabSizes {
        Self::of(config, limits, 1, Layout::SMALL)
    }

    /// Lengths for so many copies of a scene within these limits, each, and schedules of this layout.
    pub const fn of(
        config: &ModelConfig,
        limits: Limits,
        copies: usize,
        layout: Layout,
    ) -> SlabSizes {
        let sizes = Sizes::new(config, limits, copies, layout);
        let hulls = if config.features.has_impacts() { 2 } else { 1 };
        SlabSizes {
            f32: workspace::total(&sizes),
            i8: quant::scratch_bytes(sizes.widest, layout.tiles.rows),
            points: sizes.point_rows().saturating_mul(hulls),
            units: sizes.units,
        }
    }

    /// All slabs together, bytes.
    pub const fn bytes(&self) -> usize {
        let numbers = self.f32.saturating_add(self.points.saturating_mul(3));
        let units = self.units.saturating_mul(size_of::<UnitSlot>());
        numbers.saturating_mul(4).saturating_add(self.i8).saturating_add(units)
    }
}

/// Slabs whose lengths are compile-time constants: what a firmware keeps in a static.
///
/// ```
/// use rigidformer_core::{Limits, Memory, Model, Simulator, SlabSizes};
/// # const CONFIG: rigidformer_core::weights::ModelConfig = rigidformer_core::weights::ModelConfig {
/// #     width: 64, heads: 2, head_dim: 32, blocks: 3, point_width: 48, registers: 4, feed_forward_width: 160,
/// #     avp_width: 32, film_width: 16, command_size: 0, rope_frequencies: 4,
/// #     scales: rigidformer_core::weights::Scales::new(&[0, 1, 3]),
/// #     features: rigidformer_core::weights::FeatureSet::Impact, motion: rigidformer_core::weights::Motion::Free,
/// #     gate: true, output_scale: 1.0, frame_rate_hz: 240.0, gravity_m_s2: [0.0, 0.0, -10.0],
/// #     ground_friction: 0.3, ground_restitution: 0.5, hidden: rigidformer_core::weights::Hidden::DEFAULT,
/// #     similarity: rigidformer_core::weights::Similarity::OFF,
/// #     directions: rigidformer_core::weights::Directions::NONE,
/// #     elastic: rigidformer_core::weights::Elastic::NONE, bonds: 0, scope: rigidformer_core::weights::Scope::All, most_units: 0,
/// # };
/// const SIZES: SlabSizes = SlabSizes::new(&CONFIG, Limits { units: 10, points: 640 });
/// let mut memory: Memory<{ SIZES.f32 }, { SIZES.i8 }, { SIZES.points }, { SIZES.units }> = Memory::new();
/// assert_eq!(memory.slabs().units.len(), 10);
/// ```
pub struct Memory<const F32: usize, const I8: usize, const POINTS: usize, const UNITS: usize> {
    f32: [f32; F32],
    i8: [i8; I8],
    points: [Point3<f32>; POINTS],
    units: [UnitSlot; UNITS],
}

impl<const F32: usize, const I8: usize, const POINTS: usize, const UNITS: usize>
    Memory<F32, I8, POINTS, UNITS>
{
    /// Memory of zeros.
    pub const fn new() -> Self {
        Memory {
            f32: [0.0; F32],
            i8: [0; I8],
            points: [Point3::new(0.0, 0.0, 0.0); POINTS],
            units: [UnitSlot::EMPTY; UNITS],
        }
    }

    /// All of it, for a simulator.
    pub fn slabs(&mut self) -> Slabs<'_> {
        let Memory { f32, i8, points, units } = self;
        Slabs { f32, i8, points, units }
    }
}

impl<const F32: usize, const I8: usize, const POINTS: usize, const UNITS: usize> Default
    for Memory<F32, I8, POINTS, UNITS>
{
    fn default() -> Self {
        Self::new()
    }
}
