//! Predictions have the same bits whatever rounding, flush of subnormal numbers and traps the caller's thread has set.
#![cfg(all(target_arch = "x86_64", not(miri)))]
#![allow(unsafe_code)]

use std::arch::asm;
use std::panic::{AssertUnwindSafe, catch_unwind};

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{Limits, Physics, Posed, Unit};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchSimulator, Start, VelocityNoise};
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;

/// MXCSR of a new thread.
const DEFAULT: u32 = 0x1f80;

fn control() -> u32 {
    let mut word = 0;
    // SAFETY: writes the four bytes of `word`.
    unsafe { asm!("stmxcsr [{}]", in(reg) &raw mut word) };
    word
}

/// Runs `body` where MXCSR is `word`, and says whether it is `word` behind it, flags and all.
#[inline(never)]
fn under<R>(word: u32, body: impl FnOnce() -> R) -> (R, bool) {
    let set = |word: u32| {
        // SAFETY: no reserved bit is set; what the test computes under it is the library's.
        unsafe { asm!("ldmxcsr [{}]", in(reg) &raw const word) }
    };
    set(word);
    let result = body();
    let behind = control();
    set(DEFAULT);
    (result, behind == word)
}

/// Four roundings, flush of results, operands that count as zeros, traps; one raised flag, which must stay.
fn environments() -> impl Iterator<Item = u32> {
    (0..32_u32).map(|number| {
        let rounding = (number & 3) << 13;
        let (flush, zeros) = ((number >> 2 & 1) << 15, (number >> 3 & 1) << 6);
        let masks = if number >> 4 == 0 { 0x1f80 } else { 0 };
        rounding | flush | zeros | masks | (number & 1) << 5
    })
}

fn corners(half_m: f32) -> Vec<Point3<f32>> {
    let side = |corner: usize, bit| if corner & bit == 0 { -half_m } else { half_m };
    (0..8).map(|corner| Point3::new(side(corner, 1), side(corner, 2), side(corner, 4))).collect()
}

const RUBBER: Physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.4 };

fn start(unit: usize) -> Isometry3<f32> {
    let i = unit as f32;
    // The first does not turn: a division by its angle would be 0 / 0.
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 0.1, 0.2) * i);
    Isometry3::from_parts(Translation3::new(0.03 * i, 0.02 * i, 0.09 + 0.2 * i), turn)
}

/// A hash of all poses of a rollout, all calls of which are made in the caller's environment.
fn rollout(
    model: &'static [u8],
    engine: Engine,
    points: &[Point3<f32>],
    starts: &[Isometry3<f32>],
) -> u64 {
    let model = LoadedModel::embedded("model", model).unwrap().for_host().unwrap();
    let mut world = World::on(engine, &model, Limits { units: 4, points: 64 }, 1).unwrap();
    world.set_dt(1.0 / 24.0).unwrap();
    let ids: Vec<_> =
        starts.iter().map(|at| world.add(&Unit::new(points, RUBBER), at).unwrap()).collect();
    world
        .set_velocity(ids[1], &Vector3::new(0.1, 0.3, 1e-39), &Vector3::new(0.7, 0.0, 0.1))
        .unwrap();
    let mut hash = Hash(0xcbf2_9ce4_8422_2325);
    for _ in 0..2 {
        world.step().unwrap();
        ids.iter().for_each(|id| hash.pose(&world.pose(*id).unwrap()));
    }
    hash.0
}

struct Hash(u64);

impl Hash {
    fn pose(&mut self, pose: &Isometry3<f32>) {
        for number in pose.translation.vector.iter().chain(pose.rotation.coords.iter()) {
            self.0 = (self.0 ^ u64::from(number.to_bits())).wrapping_mul(0x100_0000_01b3);
        }
    }
}

#[test]
fn a_world_has_the_same_bits_in_every_environment() {
    // What the test computes itself is computed here.
    let points = corners(0.1);
    let starts: Vec<_> = (0..4).map(start).collect();
    for model in [rigidformer_weights::EDGE, rigidformer_weights::NANO] {
        let mut hashes = Vec::new();
        for threads in [Threads::ONE, Threads::new(2).eager(), Threads::new(2).eager_layers()] {
            let engine = Engine { kernel: *Kernel::available().last().unwrap(), threads };
            for word in environments() {
                // Workers begin with what the thread has that makes them.
                let pool = |body: &(dyn Fn() -> u64 + Sync)| {
                    if threads == Threads::ONE {
                        return body();
                    }
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
                    pool.install(body)
                };
                let (hash, is_restored) =
                    under(word, || pool(&|| rollout(model, engine, &points, &starts)));
                assert!(is_restored, "{word:#x}");
                hashes.push(hash);
            }
        }
        let first = hashes[0];
        assert!(hashes.iter().all(|hash| *hash == first), "{hashes:x?}");
    }
}

#[test]
fn futures_have_the_same_bits_in_every_environment() {
    let model =
        LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap().for_host().unwrap();
    let points = corners(0.1);
    let units: Vec<_> = (0..3)
        .map(|i| Posed { unit: Unit::new(&points, RUBBER), previous: start(i), current: start(i) })
        .collect();
    let start = Start { dt_s: 1.0 / 24.0, units: &units, ..Start::default() };
    let noise = VelocityNoise { seed: 1, linear_m_s: 0.3, angular_rad_s: 1.0 };
    let run = |threads| {
        let engine = Engine { kernel: Kernel::Portable, threads };
        let mut poses = vec![Isometry3::identity(); 4 * 2 * 3];
        BatchSimulator::new(engine, &model).run(&start, 2, &noise, &mut poses).unwrap();
        let mut hash = Hash(0);
        poses.iter().for_each(|pose| hash.pose(pose));
        hash.0
    };
    let expected = run(Threads::ONE);
    for word in environments() {
        for threads in [Threads::ONE, Threads::new(2)] {
            assert_eq!(under(word, || run(threads)), (expected, true), "{word:#x}");
        }
    }
}

#[test]
fn what_unwinds_leaves_the_callers_environment() {
    let word = 0x7fc0 | 0x8000;
    let unwinds = || {
        catch_unwind(AssertUnwindSafe(|| {
            in_own_environment(|| {
                assert_eq!(control(), DEFAULT);
                std::panic::resume_unwind(Box::new(1));
            })
        }))
    };
    let (result, is_restored) = under(word, unwinds);
    assert!(result.is_err() && is_restored);
    // Nested, and with what the inner one raises.
    let (zero, one) = (std::hint::black_box(0.0_f32), std::hint::black_box(1.0_f32));
    let nested =
        || in_own_environment(|| (in_own_environment(|| zero / zero), one / 3.0, control()));
    let ((nan, third, raised), is_restored) = under(word, nested);
    assert!(nan.is_nan() && third == 1.0 / 3.0 && is_restored);
    // What the inner one raised went with it.
    assert_eq!(raised & 1, 0);
}
