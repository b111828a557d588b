//! Scenes for microcontrollers, and the rollouts that their images must equal bit for bit.

use crate::bits::Fnv1a;
use crate::drape::{self, Drape};
use crate::walk::{self, Walk};
use crate::workcell::{STEPS, Workcell};
use crate::{Room, observed, seconds};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{
    BOND_ROOM, Limits, Model, Physics, Plane, Posed, Role, Simulator, SlabSizes, Unit, UnitView,
};
use rigidformer_evaluation::pivots;
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit};
use rigidformer_weights::AlignedBuffer;
use std::fmt::Write;

/// Units of a scene.
pub const UNITS: usize = 10;
/// Points of a unit.
pub const POINTS: usize = 64;

/// Two frames of points. The layout of a file is in `firmware-sim/firmware/src/scene.rs`.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoFrames {
    /// Native frames between them.
    pub step: u32,
    /// (units)
    pub physics: Vec<Physics>,
    /// (units, points) world, metres.
    pub previous: Vec<Vec<Point3<f32>>>,
    /// (units, points) world, metres.
    pub current: Vec<Vec<Point3<f32>>>,
}

impl TwoFrames {
    /// The file's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let counts = [self.step, self.physics.len() as u32, POINTS as u32];
        let physics = self.physics.iter().flat_map(|p| [p.mass_kg, p.friction, p.restitution]);
        let points = self.previous.iter().chain(&self.current).flatten();
        let numbers = physics.chain(points.flat_map(|p| [p.x, p.y, p.z]));
        let words = counts.into_iter().chain(numbers.map(f32::to_bits));
        words.flat_map(u32::to_le_bytes).collect()
    }

    /// From a file's bytes.
    pub fn from_bytes(bytes: &[u8]) -> Self {
        let words: Vec<u32> = bytes
            .chunks_exact(4)
            .map(|word| u32::from_le_bytes(word.try_into().expect("four bytes")))
            .collect();
        let (counts, rest) = words.split_at(3);
        let numbers: Vec<f32> = rest.iter().copied().map(f32::from_bits).collect();
        let (physics, frames) = numbers.split_at(3 * counts[1] as usize);
        let points: Vec<Point3<f32>> =
            frames.chunks_exact(3).map(|p| Point3::new(p[0], p[1], p[2])).collect();
        let mut units = points.chunks_exact(counts[2] as usize).map(<[_]>::to_vec);
        let previous = units.by_ref().take(counts[1] as usize).collect();
        TwoFrames {
            step: counts[0],
            physics: physics
                .chunks_exact(3)
                .map(|p| Physics { mass_kg: p[0], friction: p[1], restitution: p[2] })
                .collect(),
            previous,
            current: units.collect(),
        }
    }

    /// The first scene of bodies.
    pub fn of(bodies: &Bodies) -> Self {
        let Bodies { step, physics, points, scenes: [contact, _] } = bodies;
        let frame = |poses: &Vec<Isometry3<f32>>| {
            let units = points.iter().zip(poses);
            units.map(|(unit, pose)| unit.iter().map(|point| pose * point).collect()).collect()
        };
        let [previous, current] = contact.each_ref().map(frame);
        TwoFrames { step: *step, physics: physics.clone(), previous, current }
    }
}

/// Scenes of [`Bodies`]: two recorded frames of ten units that collide, and the same units far apart and high up, spinning.
pub const SCENES: [&str; 2] = ["contact", "flight"];

/// Bodies, and their poses in two frames of two scenes. The layout of a file is where that of [`TwoFrames`] is.
#[derive(Clone, Debug, PartialEq)]
pub struct Bodies {
    /// Native frames between them.
    pub step: u32,
    /// (units)
    pub physics: Vec<Physics>,
    /// (units, points) in the unit's own frame, metres.
    pub points: Vec<Vec<Point3<f32>>>,
    /// (scenes, frames, units)
    pub scenes: [[Vec<Isometry3<f32>>; 2]; 2],
}

impl Bodies {
    /// The file's bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let counts = [self.step, self.physics.len() as u32, POINTS as u32];
        let physics = self.physics.iter().flat_map(|p| [p.mass_kg, p.friction, p.restitution]);
        let points = self.points.iter().flatten().flat_map(|p| [p.x, p.y, p.z]);
        let poses = self.scenes.iter().flatten().flatten().flat_map(|pose| {
            let (p, q) = (pose.translation.vector, pose.rotation.quaternion());
            [p.x, p.y, p.z, q.w, q.i, q.j, q.k]
        });
        let numbers = physics.chain(points).chain(poses);
        let words = counts.into_iter().chain(numbers.map(f32::to_bits));
        words.flat_map(u32::to_le_bytes).collect()
    }

    /// From a file's bytes.
    pub fn from_bytes(bytes: &[u8]) -> Self {
        let (words, _) = bytes.as_chunks::<4>();
        let words: Vec<u32> = words.iter().copied().map(u32::from_le_bytes).collect();
        let (counts, rest) = words.split_at(3);
        let (step, units, points) = (counts[0], counts[1] as usize, counts[2] as usize);
        let numbers: Vec<f32> = rest.iter().copied().map(f32::from_bits).collect();
        let (physics, rest) = numbers.split_at(3 * units);
        let (points, poses) = {
            let (all, poses) = rest.split_at(3 * units * points);
            let all: Vec<_> =
                all.as_chunks().0.iter().map(|p: &[f32; 3]| Point3::from(*p)).collect();
            (all.chunks_exact(points).map(<[_]>::to_vec).collect(), poses)
        };
        let mut poses = poses.as_chunks().0.iter().map(|[x, y, z, w, i, j, k]| {
            let rotation = UnitQuaternion::new_unchecked(Quaternion::new(*w, *i, *j, *k));
            Isometry3::from_parts(Translation3::new(*x, *y, *z), rotation)
        });
        let physics = physics.as_chunks().0.iter();
        let physics = physics.map(|[mass_kg, friction, restitution]| Physics {
            mass_kg: *mass_kg,
            friction: *friction,
            restitution: *restitution,
        });
        let mut frame = || poses.by_ref().take(units).collect();
        let scenes = core::array::from_fn(|_| core::array::from_fn(|_| frame()));
        Bodies { step, physics: physics.collect(), points, scenes }
    }
}

/// Steps of an image, and what it must print about them: lines of poses as bits, then a hash over all steps.
#[derive(Default)]
struct Rollout {
    steps: usize,
    active: u32,
    hash: Fnv1a,
}

impl Rollout {
    fn step(&mut self, simulator: &mut Simulator<'_, '_>) {
        self.active += simulator.step().expect("step").active_units;
        self.steps += 1;
        simulator.units().for_each(|unit| self.hash.add_unit(&unit));
    }

    /// `name` is that of the scene.
    fn text(&self, simulator: &Simulator<'_, '_>, name: &str) -> String {
        let mut text = String::new();
        let numbers = |unit: &UnitView<'_>| -> Vec<f32> {
            let pose = unit.internal_pose();
            pose.rotation.transpose().iter().chain(&pose.centre).copied().collect()
        };
        for (number, unit) in simulator.units().enumerate() {
            let bits: Vec<_> =
                numbers(&unit).iter().map(|v| format!("{:08x}", v.to_bits())).collect();
            let _ = writeln!(text, "{name}: unit {number} [{}]", bits.join(", "));
        }
        let Rollout { steps, active, hash } = self;
        let _ = writeln!(text, "{name}: {steps} steps, active {active}, poses {:016x}", hash.0);
        text
    }
}

/// What an image must print about a snapshot.
fn snapshot(simulator: &Simulator<'_, '_>, name: &str) -> String {
    let mut bytes = vec![0; simulator.snapshot_bytes()];
    simulator.snapshot(&mut bytes).expect("a snapshot");
    let mut hash = Fnv1a::default();
    bytes.iter().for_each(|byte| hash.add_byte(*byte));
    format!("{name}: snapshot of {} bytes {:016x}\n", bytes.len(), hash.0)
}

/// What the images can hold.
const LIMITS: Limits = Limits { units: UNITS, points: UNITS * POINTS };

/// What an image must print about a rollout of `steps` steps of a scene of this name.
pub fn rollout(file: &[u8], name: &str, scene: &TwoFrames, steps: usize) -> String {
    let model = Model::load(file).expect("model loads");
    let mut room = Room::new(SlabSizes::new(model.config(), LIMITS));
    let mut simulator = Simulator::new(&model, LIMITS, room.slabs()).expect("simulator");
    let units = observed(&scene.physics, &scene.previous, &scene.current);
    simulator.observe(seconds(scene.step), units).expect("observation");
    let mut rollout = Rollout::default();
    for _ in 0..steps {
        rollout.step(&mut simulator);
    }
    rollout.text(&simulator, name)
}

/// What the image `rollout` must print of its scenes, `steps` steps each.
pub fn rollouts(file: &[u8], bodies: &Bodies, steps: usize) -> String {
    let model = Model::load(file).expect("model loads");
    let mut room = Room::new(SlabSizes::new(model.config(), LIMITS));
    let mut simulator = Simulator::new(&model, LIMITS, room.slabs()).expect("simulator");
    let mut text = String::new();
    for (name, [previous, current]) in SCENES.iter().zip(&bodies.scenes) {
        let poses = previous.iter().zip(current);
        let units = bodies.points.iter().zip(&bodies.physics).zip(poses);
        let units = units.map(|((points, physics), (previous, current))| Posed {
            unit: Unit::new(points, *physics),
            previous: *previous,
            current: *current,
        });
        simulator.observe_poses(seconds(bodies.step), units).expect("observation");
        let mut rollout = Rollout::default();
        for _ in 0..steps {
            rollout.step(&mut simulator);
        }
        text += &rollout.text(&simulator, name);
    }
    text
}

/// What the image `robot` must print.
pub fn robot(file: &[u8]) -> String {
    let model = Model::load(file).expect("model loads");
    let mut room = Room::new(SlabSizes::new(model.config(), LIMITS));
    let mut simulator = Simulator::new(&model, LIMITS, room.slabs()).expect("simulator");
    let mut workcell = Workcell::observe(&mut simulator).expect("observation");
    let mut middle = String::new();
    let mut rollout = Rollout::default();
    for step in 0..STEPS {
        workcell.prepare(&mut simulator, step).expect("changes");
        if step == STEPS / 2 {
            middle = snapshot(&simulator, "robot");
        }
        rollout.step(&mut simulator);
        workcell.check(&simulator).expect("driven and fixed units");
    }
    middle + &rollout.text(&simulator, "robot")
}

/// `walk.bin` of a recorded scene: frames 0 and `step`, and pivots that the frames between them show. The layout is in
/// `firmware-sim/firmware/src/walk.rs`.
pub fn walk_file(scene: &RecordedScene, step: u32) -> Vec<u8> {
    // Only the observed frames, as a controller has them.
    let joints = pivots::of_scene(scene, 0..step as usize + 1).expect("frames of a robot");
    let units = scene.units();
    let mut bytes = Vec::new();
    let mut counts = |counts: &[u32]| {
        bytes.extend(counts.iter().flat_map(|count| count.to_le_bytes()));
    };
    let points = units.first().map_or(0, |unit| unit.points.len());
    // The file has one count for all links.
    assert!(units.iter().all(|unit| unit.points.len() == points), "links of as many points");
    let rate = scene.frame_rate_hz() as u32;
    counts(&[step, rate, units.len() as u32, points as u32, joints.len() as u32]);
    let ground = scene.ground().expect("a ground");
    let mut numbers = vec![ground.friction, ground.restitution];
    for RecordedUnit { physics, .. } in units {
        numbers.extend([physics.mass_kg, physics.friction, physics.restitution]);
    }
    numbers
        .extend(units.iter().flat_map(|unit| &unit.points).flat_map(|point| point.coords.iter()));
    for frame in [0, step as usize] {
        for unit in units {
            let Isometry3 { rotation, translation } = unit.poses[frame];
            let turn = rotation.quaternion();
            numbers.extend(translation.vector.iter());
            numbers.extend([turn.w, turn.i, turn.j, turn.k]);
        }
    }
    let as_bytes = |number: &f32| number.to_le_bytes();
    bytes.extend(numbers.iter().flat_map(as_bytes));
    for pivot in &joints {
        bytes.extend(
            [pivot.unit, pivot.parent].iter().flat_map(|unit| (*unit as u32).to_le_bytes()),
        );
    }
    let ends = joints.iter().flat_map(|joint| [joint.pivot, joint.parent_pivot]);
    bytes.extend(ends.flat_map(|pivot| [pivot.x, pivot.y, pivot.z]).flat_map(f32::to_le_bytes));
    bytes
}

/// What the image `walk` must print about its steps.
pub fn walk(file: &[u8], scene: &[u8]) -> String {
    let scene = AlignedBuffer::copy_of(scene);
    let walk = Walk::read(&scene).expect("a walk");
    let model = Model::load(file).expect("model loads");
    let limits = Limits { units: 31, points: 31 * 32 };
    let mut room = Room::new(SlabSizes::new(model.config(), limits));
    let mut simulator = Simulator::new(&model, limits, room.slabs()).expect("simulator");
    walk.observe(&mut simulator).expect("observation");
    let mut middle = String::new();
    let mut rollout = Rollout::default();
    for step in 0..walk::STEPS {
        walk.prepare(&mut simulator, step).expect("command");
        if step == walk::STEPS / 2 {
            middle = snapshot(&simulator, "walk");
        }
        rollout.step(&mut simulator);
    }
    middle + &rollout.text(&simulator, "walk")
}

/// Vertices of the sheet along each side, and patches that its cells are cut into.
const SHEET: [(usize, usize); 2] = [(15, 2), (13, 4)];
/// From a vertex to the next, metres.
const SPACING_M: f32 = 0.06;

/// Numbers of the vertices of each patch: those of its block of cells, so that neighbours share the vertices between them.
fn patches() -> impl Iterator<Item = Vec<[usize; 2]>> {
    let [(columns, across), (rows, along)] = SHEET;
    let [wide, deep] = [(columns - 1) / across, (rows - 1) / along];
    (0..across * along).map(move |patch| {
        let (column, row) = (patch / along * wide, patch % along * deep);
        let of_column = |i| (0..=deep).map(move |j| [column + i, row + j]);
        (0..=wide).flat_map(of_column).collect()
    })
}

/// An icosahedron whose faces were cut in four twice, on the unit sphere: 162 points.
fn icosphere() -> Vec<Vector3<f32>> {
    let golden = (1.0 + 5.0_f32.sqrt()) / 2.0;
    let corner = |k: usize, [y, z]: [f32; 2]| match k {
        0 => Vector3::new(0.0, y, z),
        1 => Vector3::new(z, 0.0, y),
        _ => Vector3::new(y, z, 0.0),
    };
    let sides = [[-1.0, -golden], [-1.0, golden], [1.0, -golden], [1.0, golden]];
    let mut points: Vec<_> =
        (0..3).flat_map(|k| sides.map(|side| corner(k, side).normalize())).collect();
    // Lengths of an edge with twelve corners and with forty-two; the middle of each edge becomes a
    // point.
    for edge in [1.06, 0.62] {
        let mut middles = Vec::new();
        for (number, a) in points.iter().enumerate() {
            let near = points.iter().skip(number + 1).filter(|b| (*b - a).norm() < 1.1 * edge);
            middles.extend(near.map(|b| (a + b).normalize()));
        }
        points.extend(middles);
    }
    points
}

/// `drape.bin`: a sheet of cloth as the lab draws them (`rigidformer_lab.shell`), tilted over a sphere and held still. The layout is
/// in `firmware-sim/firmware/src/drape.rs`.
pub fn drape_file() -> Vec<u8> {
    let (young_pa, kilograms, radius) = (1e6_f32, 0.24_f32, 0.2_f32);
    let [(columns, _), (rows, _)] = SHEET;
    let vertices = (columns * rows) as f32;
    let middle = [(columns - 1) as f32 * 0.5, (rows - 1) as f32 * 0.5];
    let at_rest = |[i, j]: [usize; 2]| {
        Vector3::new((i as f32 - middle[0]) * SPACING_M, (j as f32 - middle[1]) * SPACING_M, 0.0)
    };
    // A turn about the vertical by .8 and .6, then a tilt about x by .96 and .28: 16 degrees.
    let turned = |p: Vector3<f32>| {
        let (x, y) = (p.x * 0.8 - p.y * 0.6, p.x * 0.6 + p.y * 0.8);
        Vector3::new(x, y * 0.96, y * 0.28)
    };
    let all = || (0..columns).flat_map(|i| (0..rows).map(move |j| [i, j]));
    let lowest = all().map(|vertex| turned(at_rest(vertex)).z).fold(f32::INFINITY, f32::min);
    let offset = Vector3::new(0.07, 0.05, 2.0 * radius + 0.05 - lowest);

    let sphere = icosphere();
    let owners = |vertex| patches().filter(|patch| patch.contains(&vertex)).count() as f32;
    let points = patches().next().map_or(0, |patch| patch.len());
    let counts = [5, 60, patches().count() as u32, points as u32, sphere.len() as u32];
    let mut numbers = vec![young_pa, 1.0, 0.0];
    for patch in patches() {
        // Patches share vertices, and the sheet has each vertex's mass once.
        let share: f32 = patch.iter().map(|vertex| 1.0 / owners(*vertex)).sum();
        numbers.extend([kilograms / vertices * share, 0.5, 0.0]);
    }
    numbers.extend([33.5, 1.0, 0.0]);
    let rest: Vec<_> = patches().flatten().map(at_rest).collect();
    let now = rest.iter().map(|p| turned(*p) + offset);
    let sphere = sphere.iter().map(|p| p * radius + Vector3::new(0.0, 0.0, radius));
    let points = rest.iter().copied().chain(now).chain(sphere);
    numbers.extend(points.flat_map(|p| [p.x, p.y, p.z]));
    let words = counts.into_iter().chain(numbers.into_iter().map(f32::to_bits));
    words.flat_map(u32::to_le_bytes).collect()
}

/// What the image `drape` must print about its steps.
pub fn drape(file: &[u8], scene: &[u8]) -> String {
    let scene = AlignedBuffer::copy_of(scene);
    let drape = Drape::read(&scene).expect("a sheet over a sphere");
    let model = Model::load(file).expect("model loads");
    let limits = Limits { units: 9, points: 8 * 32 + 162 };
    let mut room = Room::new(SlabSizes::new(model.config(), limits));
    let mut simulator = Simulator::new(&model, limits, room.slabs()).expect("simulator");
    drape.observe(&mut simulator).expect("observation");
    let (mut rollout, mut hash) = (Rollout::default(), Fnv1a::default());
    let mut middle = String::new();
    for step in 0..drape::STEPS {
        if step == drape::STEPS / 2 {
            middle = snapshot(&simulator, "drape");
        }
        rollout.step(&mut simulator);
        drape::each_number(&simulator, |number| hash.add(number));
    }
    let steps = drape::STEPS;
    middle
        + &rollout.text(&simulator, "drape")
        + &format!("drape: {steps} steps, points {:016x}\n", hash.0)
}

/// What the const functions say about the workspace: a line of lengths and bytes.
pub fn workspace(file: &[u8]) -> String {
    let model = Model::load(file).expect("model loads");
    let sizes = SlabSizes::new(model.config(), LIMITS);
    let SlabSizes { f32, i8, points, .. } = sizes;
    // This machine's core has bonds, and the images are built without them.
    let f32 = f32 - BOND_ROOM * UNITS;
    // Units are left out: addresses are shorter on the target, and so are they.
    let bytes = 4 * f32 + i8 + 12 * points;
    format!("workspace f32 {} i8 {i8} points {} bytes {bytes}", 4 * f32, 12 * points)
}

/// What an image must print about the scene of `bindings/c/examples/push.c`: a hash of all units' internal poses after each of
/// 20 steps.
pub fn roles(file: &[u8]) -> String {
    const STEPS: usize = 20;
    let model = Model::load(file).expect("model loads");
    let limits = Limits { units: 4, points: 4 * POINTS };
    let sizes = SlabSizes::new(model.config(), limits);
    let mut room = Room::new(sizes);
    let mut simulator = Simulator::new(&model, limits, room.slabs()).expect("simulator");

    let plane = |normal: [f32; 3], offset_m, friction, restitution| Plane {
        normal: Vector3::from(normal),
        offset_m,
        friction,
        restitution,
    };
    let planes =
        [plane([0.0, 0.0, 1.0], 0.0, 0.5, 0.25), plane([-0.6, 0.0, 0.8], -0.35, 0.25, 0.5)];
    simulator.set_planes(&planes).expect("planes");
    simulator.set_gravity(Vector3::new(0.0, 0.0, -9.75)).expect("gravity");
    // 4 x 4 x 4 points at -1, -1/2, 1/2 and 1 times half the sides.
    let block = |[x, y, z]: [f32; 3]| -> Vec<Point3<f32>> {
        let grid = [-1.0, -0.5, 0.5, 1.0];
        let point = |i: usize| Point3::new(x * grid[i % 4], y * grid[i / 4 % 4], z * grid[i / 16]);
        (0..POINTS).map(point).collect()
    };
    let physics = |mass_kg, friction, restitution| Physics { mass_kg, friction, restitution };
    let at = |x, y, z| Isometry3::translation(x, y, z);
    let table = block([0.5, 0.5, 0.125]);
    let cube = block([0.125; 3]);
    let pusher = block([0.0625, 0.125, 0.125]);
    let small = block([0.0625; 3]);
    let resting = |unit, pose| Posed { unit, previous: pose, current: pose };
    let units = [
        resting(Unit::new(&table, physics(10.0, 0.5, 0.25)).role(Role::Fixed), at(0.0, 0.0, 0.125)),
        resting(Unit::new(&cube, physics(0.5, 0.5, 0.5)), at(0.0, 0.0, 0.375)),
        resting(
            Unit::new(&pusher, physics(1.0, 0.5, 0.25)).role(Role::Driven),
            at(-0.375, 0.0, 0.4375),
        ),
    ];
    simulator.observe_poses(10.0 / 240.0, units).expect("observation");
    let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
    let mut hash = Fnv1a::default();
    for step in 0..STEPS {
        // The steps of the C program, which must come to the same bits.
        if step == 8 {
            let unit = Unit::new(&small, physics(0.25, 0.5, 0.5));
            let pose = at(0.25, 0.25, 0.75);
            simulator.add(&unit, &pose, &pose).expect("room");
        }
        if step == 14 {
            simulator.remove(ids[0]).expect("the table");
        }
        let x = -0.375 + 0.03125 * (step + 1) as f32;
        simulator.drive(ids[2], &at(x, 0.0, 0.4375)).expect("driven");
        simulator.step().expect("step");
        simulator.units().for_each(|unit| hash.add_unit(&unit));
    }
    format!("roles: {STEPS} steps, poses {:016x}\n", hash.0)
}

/// What the C program `bindings/c/examples/host/shatter.c` must print about its wall: a hash of all units' internal poses and of how many
/// bonds hold after each of 20 steps.
pub fn shatter(file: &[u8]) -> String {
    const STEPS: usize = 20;
    let model = Model::load(file).expect("model loads");
    let limits = Limits { units: 4, points: 4 * POINTS };
    let mut room = Room::new(SlabSizes::new(model.config(), limits));
    let mut simulator = Simulator::new(&model, limits, room.slabs()).expect("simulator");
    simulator.set_planes(&[Plane::ground(1.0, 0.0)]).expect("planes");
    let grid = [-0.25, -0.125, 0.125, 0.25];
    let point = |i: usize| Point3::new(grid[i % 4], grid[i / 4 % 4], grid[i / 16]);
    let points: Vec<_> = (0..POINTS).map(point).collect();
    let physics = Physics { mass_kg: 125.0, friction: 0.5, restitution: 0.125 };
    // Written out, because the C program has the same digits and no sine.
    let turn = Quaternion::new(0.9486833, 0.0, 0.31622777, 0.0);
    let places = [[-0.35, 1.95], [0.05, 1.65], [-0.05, 2.35], [0.35, 2.05_f32]];
    let bricks = places.map(|[x, z]| {
        let at = |z| {
            Isometry3::from_parts(Translation3::new(x, 0.0, z), UnitQuaternion::new_unchecked(turn))
        };
        Posed { unit: Unit::new(&points, physics).body(1), previous: at(z + 0.5), current: at(z) }
    });
    simulator.observe_poses(1.0 / 12.0, bricks).expect("observation");
    let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
    let pairs = [[0, 1], [2, 3], [0, 2], [1, 3]].map(|pair| pair.map(|brick: usize| ids[brick]));
    simulator.bond(&pairs).expect("bonds");
    let (mut hash, mut held) = (Fnv1a::default(), 0_u32);
    for step in 1..=STEPS {
        // As the C program does: one bond is broken by the caller, the others by the model.
        if step == 2 {
            simulator.break_bond(pairs[0]).expect("a bond");
        }
        simulator.step().expect("step");
        simulator.units().for_each(|unit| hash.add_unit(&unit));
        held = simulator.bonds().filter(|bond| bond.holds).count() as u32;
        hash.add(f32::from_bits(held));
    }
    format!("shatter: {STEPS} steps, {held} bonds hold, poses {:016x}\n", hash.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sheet_is_that_of_its_file() {
        let path =
            concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware-sim/firmware/scenes/drape.bin");
        let file = std::fs::read(path).expect("the scene");
        assert_eq!(file, drape_file());
        for cut in [0, 4, 19, 20, 32, file.len() - 1] {
            assert!(Drape::read(&AlignedBuffer::copy_of(&file[..cut])).is_none());
        }
        assert!(patches().all(|patch| patch.len() == 32) && icosphere().len() == 162);
    }

    #[test]
    fn scenes_survive_their_files() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware-sim/firmware/scenes");
        let read = |name| std::fs::read(format!("{folder}/{name}")).expect("the scene");
        let bodies = Bodies::from_bytes(&read("bodies.bin"));
        assert_eq!(bodies.to_bytes(), read("bodies.bin"));
        assert!(bodies.points.iter().all(|unit| unit.len() == POINTS));
        let scene = TwoFrames::of(&bodies);
        assert_eq!(scene.to_bytes(), read("contact.bin"));
        assert_eq!(TwoFrames::from_bytes(&scene.to_bytes()), scene);
    }
}
