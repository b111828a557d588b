//! Predictions have the same bits whatever rounding, flush of subnormal numbers and traps the caller's thread has set.
#![cfg(all(target_arch = "x86_64", not(miri)))]
#![allow(unsafe_code)]

use std::arch::asm;
use std::panic::{AssertUnwindSafe, catch_unwind};

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::geometry::{
    centre_of_mass, density_centre, farthest_point_order, kabsch, kabsch_f64, leading_svd, radius,
};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{
    Health, Joint, Limits, Model, Observed, Physics, Plane, Posed, Role, Simulator, SlabSizes,
    Slabs, Unit, UnitSlot, Velocity,
};
use rigidformer_evaluation::metrics::{self, Apart, FrameErrors, Penetration, PenetrationProbe};
use rigidformer_evaluation::predicted::PointTrajectory;
use rigidformer_evaluation::rollout::Trajectory;
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
use rigidformer_evaluation::soft;
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::futures::{BatchSimulator, Start, VelocityNoise};
use rigidformer_runtime::hull::ConvexHull;
use rigidformer_runtime::kernels::Kernel;
use rigidformer_runtime::memory::Budget;
use rigidformer_runtime::mesh::{self, Format, TriangleMesh};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::noise::Noise;
use rigidformer_runtime::pivots::{self, Link, Pivot};
use rigidformer_runtime::pool;
use rigidformer_runtime::poses::{a_step_before, free_fall, heading};
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;
use rigidformer_weights::{
    AlignedBuffer, Elastic, ModelConfig, ModelFile, ModelWriter, Motion, Quantity, Ranges, Shape,
    Similarity, TensorData,
};

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

/// All that is called without a world, once: calls of the core, and functions of the runtime.
struct Alone<'m> {
    model: &'m Model<'m>,
    points: Vec<Point3<f32>>,
    starts: Vec<Isometry3<f32>>,
    pushed: Isometry3<f32>,
    /// Points, and where they went.
    pairs: [Vec<Vector3<f32>>; 2],
    /// One whose normal is no number, which a comparison signals.
    plane: Plane,
    mesh: &'static str,
}

impl Alone<'_> {
    fn simulator(&self) -> Vec<u32> {
        let limits = Limits { units: 5, points: 64 };
        let sizes = SlabSizes::new(self.model.config(), limits);
        let (mut numbers, mut bytes) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
        let mut slots = vec![Point3::origin(); sizes.points];
        let mut units = vec![UnitSlot::EMPTY; sizes.units];
        let slabs =
            Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut slots, units: &mut units };
        let mut simulator = Simulator::new(self.model, limits, slabs).unwrap();
        simulator.set_gravity(Vector3::new(0.1, 1e-40, -9.81)).unwrap();
        simulator.set_planes(&[Plane::ground(0.6, 0.3)]).unwrap();
        let unit = Unit::new(&self.points, RUBBER);
        // Observed points are fitted; poses are not.
        let seen = Observed { unit, current: &self.points };
        simulator.observe(1.0 / 24.0, [seen]).unwrap();
        let mut bits = Bits::default();
        bits.scene(&simulator);
        let posed = |at: &Isometry3<f32>| Posed { unit, previous: *at, current: *at };
        let first = self.starts[..2].iter().map(posed);
        simulator.observe_poses(1.0 / 30.0, first).unwrap();
        for start in &self.starts[2..] {
            simulator.add(&unit, start, start).unwrap();
        }
        let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
        simulator.set_dt(1.0 / 24.0).unwrap();
        simulator.set_poses(ids[1], &self.starts[1], &self.pushed).unwrap();
        let heavy = Physics { mass_kg: 1.3, friction: 0.7, restitution: 0.1 };
        simulator.set_physics(ids[2], heavy).unwrap();
        simulator.set_role(ids[3], Role::Driven).unwrap();
        simulator.drive(ids[3], &self.starts[3]).unwrap();
        let pivot = Point3::new(0.1, 1e-41, 0.03);
        let joint = Joint::ball(ids[1], ids[2], pivot, pivot);
        simulator.join(&joint).unwrap();
        for _ in 0..2 {
            simulator.step().unwrap();
            bits.scene(&simulator);
        }
        let mut state = vec![0; simulator.snapshot_bytes()];
        simulator.snapshot(&mut state).unwrap();
        let thrown = Velocity {
            linear_m_s: Vector3::new(0.1, 1e-40, 2.3),
            angular_rad_s: Vector3::new(0.7, 0.0, 0.1),
        };
        simulator.set_velocity(ids[0], &thrown).unwrap();
        for velocity in simulator.velocities() {
            bits.numbers(velocity.linear_m_s.as_slice());
            bits.numbers(velocity.angular_rad_s.as_slice());
        }
        // Weights of pooling are worked out anew.
        simulator.restore(&state).unwrap();
        simulator.step().unwrap();
        bits.scene(&simulator);
        bits.0
    }

    /// The building blocks of the core.
    fn geometry(&self, bits: &mut Bits) {
        let [before, after] = &self.pairs;
        let mut points: Vec<_> = after.iter().map(|point| Point3::from(*point)).collect();
        let pairs = before.iter().zip(after);
        for fit in [
            kabsch(before, after, &Matrix3::identity()),
            kabsch_f64(pairs.clone(), &Matrix3::identity()),
        ] {
            let at = fit.pose_at(&before[2]);
            bits.numbers(at.rotation.as_slice());
            bits.numbers(at.centre.as_slice());
            bits.numbers(&[fit.residual(pairs.clone())]);
        }
        bits.numbers(
            &leading_svd(&Matrix3::new(0.1, 0.7, 0.3, 1e-41, 0.9, 0.2, 0.5, 0.3, 0.7)).values,
        );
        let centre = centre_of_mass(&mut points);
        bits.numbers(centre.coords.as_slice());
        bits.numbers(density_centre(&mut points).coords.as_slice());
        farthest_point_order(&mut points, &centre, &mut [0.0; 16]);
        points.iter().for_each(|point| bits.numbers(point.coords.as_slice()));
        bits.numbers(&[radius(&points)]);
    }

    fn functions(&self) -> Vec<u32> {
        let mut bits = Bits::default();
        let [a, b] = [self.starts[1], self.pushed];
        bits.pose(&free_fall(&a, &b, &Vector3::new(0.0, 0.1, -9.81), 0.1, 3.0));
        bits.pose(&a_step_before(&a, &Vector3::new(0.1, 0.2, 1e-40), &Vector3::x(), 0.03));
        bits.pose(&heading(&b));
        let mut noise = Noise::new(1, 2);
        bits.numbers(&[noise.uniform(), noise.normal(), noise.normal()]);
        let hull = ConvexHull::new(&self.points).unwrap();
        let inside = Point3::new(0.01, 0.03, 1e-40);
        bits.numbers(&[hull.height_m(&inside), hull.depth_m(&inside)]);
        let tilted = Plane { normal: Vector3::new(0.6, 1e-40, 0.8), offset_m: 0.1, ..self.plane };
        bits.numbers(&[tilted.height_m(&inside.coords)]);
        assert!(tilted.is_sound() && !self.plane.is_sound());
        self.geometry(&mut bits);
        let variances = [0.3, 0.7, 0.11, 0.13, 0.17, 0.19];
        bits.numbers(&[Health::innovation(&a, &b, &variances).unwrap()]);
        let link = |poses| Link { points: &self.points, body: Some(1), poses };
        let poses = [[a, b, a, b], [b, a, a, b]];
        let found = pivots::find(&poses.each_ref().map(|poses| link(poses)));
        for pivot in found.unwrap() {
            bits.numbers(&[pivot.residual_m, pivot.pivot.x, pivot.parent_pivot.y]);
            bits.wide(&[pivot.apart_m(&[a, b]).unwrap()]);
        }
        let groups = mesh::read(self.mesh.as_bytes(), Format::Obj, &mut Budget::default());
        let mesh = TriangleMesh::joined(groups.unwrap().into_iter().map(|group| group.mesh));
        let mesh = mesh.scaled(0.37).welded();
        let mass = mesh.mass_properties().unwrap();
        let numbers = [mass.volume_m3, mass.centre_m.x, mass.inertia_m5[(0, 1)], mesh.volume_m3()];
        bits.wide(&numbers);
        bits.numbers(mesh.points.iter().map(|p| p.x).collect::<Vec<_>>().as_slice());
        bits.0
    }
}

#[derive(Default)]
struct Bits(Vec<u32>);

impl Bits {
    fn numbers(&mut self, numbers: &[f32]) {
        self.0.extend(numbers.iter().map(|v| v.to_bits()));
    }

    /// Both halves: a conversion would round.
    fn wide(&mut self, numbers: &[f64]) {
        self.0.extend(numbers.iter().map(|v| v.to_bits() as u32));
        self.0.extend(numbers.iter().map(|v| (v.to_bits() >> 32) as u32));
    }

    fn pose(&mut self, pose: &Isometry3<f32>) {
        self.numbers(pose.translation.vector.as_slice());
        self.numbers(pose.rotation.coords.as_slice());
    }

    fn scene(&mut self, simulator: &Simulator<'_, '_>) {
        for number in 0..simulator.copies() * simulator.len() {
            let unit = simulator.unit(number).unwrap();
            self.pose(&unit.pose());
            self.pose(&unit.previous_pose());
            self.numbers(unit.internal_pose().rotation.as_slice());
            unit.points().for_each(|point| self.numbers(point.coords.as_slice()));
        }
        for unit in simulator.units() {
            self.numbers(&simulator.quantities(unit.id()).unwrap());
            let farthest = simulator.health(unit.id()).unwrap().farthest;
            self.numbers(&farthest.map_or([0.0; 2], |excess| [excess.value, excess.beyond]));
        }
        let farthest = simulator.health_report().farthest;
        self.numbers(&[farthest.map_or(0.0, |(_, excess)| excess.beyond)]);
    }
}

/// A tetrahedron whose corners are no round numbers.
const MESH: &str =
    "v 0.1 0 1e-42\nv 1 0.3 0\nv 0 1.1 0.7\nv 0.2 0.3 1.3\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";

#[test]
fn calls_without_a_world_have_the_same_bits_in_every_environment() {
    let pushed = Isometry3::translation(0.01, 1e-40, 0.02) * start(1);
    let model = Model::load(rigidformer_weights::NANO).unwrap();
    let starts = (0..4).map(start).collect();
    let plane =
        Plane { normal: Vector3::repeat(f32::from_bits(0x7f80_0001)), ..Plane::ground(0.6, 0.3) };
    // What the test computes itself is computed here.
    let points: Vec<_> =
        corners(0.1).iter().map(|point| pushed.inverse() * start(2) * point).collect();
    let pairs = [Isometry3::identity(), pushed]
        .map(|pose| points.iter().map(|point| (pose * point).coords).collect());
    let alone =
        Alone { model: &model, points: corners(0.1), starts, pushed, pairs, plane, mesh: MESH };
    let run = || [alone.simulator(), alone.functions()];
    let expected = run();
    for word in environments() {
        assert_eq!(under(word, run), (expected.clone(), true), "{word:#x}");
    }
    // A thread begins with what the one has that makes it. All roundings are among these.
    for word in environments().step_by(5) {
        let (of_thread, _) =
            under(word, || std::thread::scope(|scope| scope.spawn(run).join().unwrap()));
        assert_eq!(of_thread, expected, "{word:#x}");
    }
}

/// Subnormal numbers, and NaNs that a comparison signals: a reader of files compares them by their bits.
#[test]
fn model_files_are_read_alike_in_every_environment() {
    let signals = f32::from_bits(0x7f80_0001);
    let mut of = [[0.1, 1.0 / 3.0]; Quantity::COUNT];
    of[0] = [-1e-41, 1e-41];
    let scales = [1e-41, 1.0];
    let int8 = TensorData::I8 { values: &[1, 2], scales: &scales };
    let file = ModelWriter::new("tiny", ModelConfig::TINY)
        .ranges(Some(Ranges { of }))
        .metric("loss", 1e-42)
        .tensor("f", Shape::Vector(2), TensorData::F32(&[1e-43, -0.0]))
        .tensor("i", Shape::Matrix { rows: 2, columns: 1 }, int8)
        .finish()
        .unwrap();
    let file = AlignedBuffer::copy_of(&file);
    let configs = [
        ModelConfig { output_scale: signals, ..ModelConfig::TINY },
        ModelConfig {
            similarity: Similarity { length_m: 1e-41, longest_step: 0.0 },
            ..ModelConfig::TINY
        },
        ModelConfig { ground_friction: -1e-41, ..ModelConfig::TINY },
        ModelConfig { ground_friction: -0.0, ..ModelConfig::TINY },
    ];
    // A motion that goes with neither: subnormal numbers are no zeros.
    let springs = Elastic { thickness_m: 1e-41, ..Elastic::NONE };
    let robot = ModelConfig { motion: Motion::Robot, ..ModelConfig::TINY };
    let length = Similarity { length_m: 1e-41, longest_step: 0.0 };
    let strange = [
        ModelConfig { elastic: springs, ..ModelConfig::TINY },
        ModelConfig { elastic: Elastic { rate_hz: signals, ..Elastic::NONE }, ..ModelConfig::TINY },
        ModelConfig { similarity: length, ..robot },
        ModelConfig { similarity: Similarity { longest_step: signals, ..length }, ..robot },
        robot,
    ];
    let range = |range| {
        let mut of = of;
        of[1] = range;
        Ranges { of }
    };
    let ranges = [
        range([0.1, signals]),
        range([1e-41, 1e-41]),
        range([f32::MIN, f32::MAX]),
        range([f32::NEG_INFINITY, 0.0]),
    ];
    let run = || {
        let tensors = ModelFile::parse(&file).map(|file| file.parameters());
        let loaded = Model::load(&file).map(|_| ()).map_err(|error| format!("{error:?}"));
        let configs = configs.each_ref().map(|config| config.validate().is_ok());
        let strange = strange.each_ref().map(|config| format!("{:?}", config.validate()));
        (tensors, loaded, configs, ranges.each_ref().map(Ranges::are_sound), strange)
    };
    let expected = run();
    assert_eq!((&expected.0, expected.2), (&Ok(4), [false, false, false, true]));
    assert_eq!(expected.3, [false; 4]);
    let fields = ["elastic", "elastic", "similarity", "similarity"];
    assert!(
        expected.4.iter().zip(fields).all(|(said, field)| said.contains(field)),
        "{expected:?}"
    );
    assert_eq!(expected.4[4], "Ok(())");
    for word in environments() {
        assert_eq!(under(word, run), (expected.clone(), true), "{word:#x}");
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

/// A record whose bodies fall into each other and the ground, and a prediction that is elsewhere.
fn recorded_and_predicted() -> (RecordedScene, Trajectory) {
    let gap = Isometry3::translation(0.01, 0.003, -0.1);
    let unit = |number: usize| {
        let poses = (0..9).map(|frame| (0..frame).fold(start(number), |pose, _| gap * pose));
        RecordedUnit::new("cube", corners(0.2), RUBBER, poses.collect())
    };
    let units = (0..3).map(unit).collect();
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let scene = RecordedScene::new("made", 1, Split::Test, 24.0, gravity, units).unwrap();
    let scene = scene.with_commands(1, (0..9).map(|frame| 0.1 * frame as f32).collect()).unwrap();
    let mut predicted = Trajectory::new(0, 3, scene.poses_at(0).unwrap());
    for frame in [2, 5] {
        predicted.push(scene.poses_at(frame).unwrap());
    }
    (scene, predicted)
}

/// All metrics, and what they are computed from.
fn metrics_of(scene: &RecordedScene, predicted: &Trajectory, bits: &mut Bits) {
    // Frame 4 is none of a sample.
    let errors = [3, 4, 6].map(|frame| metrics::frame_errors(predicted, scene, frame).unwrap());
    for FrameErrors { position_m, orientation_rms_deg, orientation_mean_deg } in
        errors.into_iter().chain([metrics::mean(&errors)])
    {
        bits.wide(&[position_m, orientation_rms_deg, orientation_mean_deg]);
    }
    bits.pose(&predicted.pose(4, 1).unwrap());
    bits.pose(&predicted.pose_at(1.3, 2).unwrap());
    let [a, b] = [1, 2].map(|unit| predicted.pose(3, unit).unwrap());
    bits.wide(&[metrics::angle_deg(&a, &b), metrics::rigidity(predicted, scene)]);
    let probe = PenetrationProbe::new(scene);
    let depths = predicted.iter().map(|(_, poses)| probe.measure(poses));
    let deepest = depths.reduce(Penetration::max).unwrap();
    assert!(deepest.ground_m > 0.0 && deepest.units_m > 0.0, "{deepest:?}");
    bits.wide(&[deepest.ground_m, deepest.units_m]);
    let [pivot, parent_pivot] = [Point3::new(0.1, 0.2, 0.3), Point3::new(0.1, 0.2, 1e-41)];
    let pivot = Pivot { unit: 2, parent: 1, pivot, parent_pivot, residual_m: 0.0 };
    let apart = metrics::apart(predicted, &[pivot], 0, 6);
    bits.wide(&apart);
    let Apart { median_m, most_m, max_m } = Apart::of(apart).unwrap();
    bits.wide(&[median_m, most_m, max_m]);
    let points = [2, 4].map(|frame| scene.units()[1].points_at(frame).unwrap());
    bits.numbers(points.iter().flatten().map(|p| p.x).collect::<Vec<_>>().as_slice());
    bits.wide(&[soft::vertex_error_m(&points[0], &points[1]).unwrap()]);
    bits.numbers(&scene.command_of_step(1, 4).unwrap());
    let samples = points.into();
    let between = PointTrajectory { first_frame: 0, step: 3, samples }.between(1).unwrap();
    bits.numbers(between.iter().map(|p| p.y).collect::<Vec<_>>().as_slice());
}

#[test]
fn metrics_have_the_same_bits_in_every_environment() {
    let (scene, predicted) = recorded_and_predicted();
    let run = || {
        let mut bits = Bits::default();
        metrics_of(&scene, &predicted, &mut bits);
        bits.0
    };
    let expected = run();
    for word in environments() {
        assert_eq!(under(word, run), (expected.clone(), true), "{word:#x}");
    }
}

/// They are made by the first call that needs them.
#[test]
fn threads_that_share_work_are_made_to_nearest() {
    let third = || {
        pool::enter(|| {
            rayon::broadcast(|_| (control() & !0x3f, std::hint::black_box(1.0_f32) / 3.0))
        })
    };
    let (found, is_restored) = under(0x7f80, third);
    assert!(is_restored && found.iter().all(|found| *found == (DEFAULT, 1.0 / 3.0)), "{found:x?}");
}
