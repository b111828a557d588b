//! Memory of the simulator: static, and as long as the const functions of the core say.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, Ordering};

use nalgebra::Point3;
use rigidformer_core::{Limits, SlabSizes, Slabs, UnitSlot};
use rigidformer_weights::{
    Directions, Elastic, FeatureSet, Hidden, ModelConfig, Motion, Scales, Scope, Similarity,
};

/// The configuration of the model in flash; images check that it is that.
#[cfg(not(any(feature = "walk", feature = "drape")))]
// A const, because lengths of statics are needed before a model is read.
pub const CONFIG: ModelConfig = ModelConfig {
    width: 64,
    heads: 2,
    head_dim: 32,
    blocks: 3,
    point_width: 48,
    registers: 4,
    feed_forward_width: 160,
    avp_width: 32,
    film_width: 16,
    command_size: 0,
    rope_frequencies: 4,
    scales: Scales::new(&[0, 1, 3]),
    features: FeatureSet::Impact,
    motion: Motion::Impulses,
    gate: true,
    output_scale: 1.0,
    frame_rate_hz: 240.0,
    gravity_m_s2: [0.0, 0.0, -10.0],
    ground_friction: 0.3,
    ground_restitution: 0.5,
    hidden: Hidden::DEFAULT,
    similarity: Similarity { length_m: 0.7, longest_step: 16.0 },
    directions: Directions::NONE,
    elastic: Elastic::NONE,
    bonds: 0,
    scope: Scope::All,
    most_units: 24,
};
/// The configuration of the model in flash; images check that it is that.
#[cfg(all(feature = "walk", not(feature = "drape")))]
pub const CONFIG: ModelConfig = ModelConfig {
    width: 96,
    heads: 4,
    head_dim: 24,
    blocks: 4,
    point_width: 48,
    registers: 4,
    feed_forward_width: 240,
    avp_width: 32,
    film_width: 32,
    command_size: 3,
    rope_frequencies: 4,
    scales: Scales::new(&[0, 2, 4]),
    features: FeatureSet::Contact,
    motion: Motion::Robot,
    gate: false,
    output_scale: 1.0,
    frame_rate_hz: 30.0,
    gravity_m_s2: [0.0, 0.0, -9.81],
    ground_friction: 0.3,
    ground_restitution: 0.5,
    hidden: Hidden::DEFAULT,
    similarity: Similarity { length_m: 0.0, longest_step: 0.0 },
    directions: Directions::NONE,
    elastic: Elastic::NONE,
    bonds: 0,
    scope: Scope::All,
    most_units: 0,
};
/// The configuration of the model in flash; images check that it is that.
#[cfg(feature = "drape")]
pub const CONFIG: ModelConfig = ModelConfig {
    width: 64,
    heads: 2,
    head_dim: 32,
    blocks: 3,
    point_width: 48,
    registers: 4,
    feed_forward_width: 160,
    avp_width: 32,
    film_width: 16,
    command_size: 0,
    rope_frequencies: 4,
    scales: Scales::new(&[0, 1, 3]),
    features: FeatureSet::Soft,
    motion: Motion::Soft,
    gate: false,
    output_scale: 1.0,
    frame_rate_hz: 60.0,
    gravity_m_s2: [0.0, 0.0, -9.81],
    ground_friction: 1.0,
    ground_restitution: 0.0,
    hidden: Hidden::DEFAULT,
    similarity: Similarity { length_m: 0.0, longest_step: 0.0 },
    directions: Directions::NONE,
    elastic: Elastic {
        neighbours: 8,
        falloff: 8,
        thickness_m: 0.002,
        stiffness: 1.0,
        damping_s: 0.0,
        skin_m: 0.009,
        rate_hz: 960.0,
        strain_sweeps: 8,
        strain_limit: 0.02,
    },
    bonds: 0,
    scope: Scope::All,
    most_units: 0,
};
/// Units that a scene may have: ten bodies, the 31 links of a robot, or the eight patches of a sheet and a sphere.
pub const UNITS: usize = match (cfg!(feature = "drape"), cfg!(feature = "walk")) {
    (true, _) => 9,
    (_, true) => 31,
    _ => 10,
};
/// Points of all of them.
const POINTS: usize = match (cfg!(feature = "drape"), cfg!(feature = "walk")) {
    (true, _) => 8 * 32 + 162,
    (_, true) => 31 * 32,
    _ => 10 * 64,
};
/// What the simulator has room for.
pub const LIMITS: Limits = Limits { units: UNITS, points: POINTS };
/// Lengths of the slabs.
pub const SIZES: SlabSizes = SlabSizes::new(&CONFIG, LIMITS);
/// The most that the workspace may be, bytes.
// 256 KiB is what the images may take. Robots and cloth have more units and points, and get twice
// as much.
pub const BUDGET: usize =
    if cfg!(any(feature = "walk", feature = "drape")) { 512 } else { 256 } * 1024;
// Outgrown memory is an error of the build and not of a board.
const _: () = assert!(SIZES.bytes() <= BUDGET, "the workspace outgrew its RAM budget");

/// Memory that is lent once. Its size is that of its content: what the linker reserves is what
/// [`SlabSizes`] says.
#[repr(transparent)]
struct Slab<T>(UnsafeCell<T>);

// SAFETY: only `slabs` touches the content, and TAKEN makes it do so once.
unsafe impl<T> Sync for Slab<T> {}

// The check of the images finds slabs by these names and compares their lengths.
#[unsafe(export_name = "rigidformer_slab_f32")]
static F32: Slab<[f32; SIZES.f32]> = Slab(UnsafeCell::new([0.0; SIZES.f32]));
#[unsafe(export_name = "rigidformer_slab_i8")]
static I8: Slab<[i8; SIZES.i8]> = Slab(UnsafeCell::new([0; SIZES.i8]));
#[unsafe(export_name = "rigidformer_slab_points")]
static POINT_SLOTS: Slab<[Point3<f32>; SIZES.points]> =
    Slab(UnsafeCell::new([Point3::new(0.0, 0.0, 0.0); SIZES.points]));
#[unsafe(export_name = "rigidformer_slab_units")]
static UNIT_SLOTS: Slab<[UnitSlot; SIZES.units]> =
    Slab(UnsafeCell::new([UnitSlot::EMPTY; SIZES.units]));
static TAKEN: AtomicBool = AtomicBool::new(false);

/// The slabs, the first time.
pub fn slabs() -> Option<Slabs<'static>> {
    if TAKEN.swap(true, Ordering::Relaxed) {
        return None;
    }
    // SAFETY: the line above lets one caller pass, so these are the only references.
    Some(unsafe {
        Slabs {
            f32: &mut *F32.0.get(),
            i8: &mut *I8.0.get(),
            points: &mut *POINT_SLOTS.0.get(),
            units: &mut *UNIT_SLOTS.0.get(),
        }
    })
}
