//! Schedules that search an index for the nearest point roll out the bits of those that try all
//! points.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use rigidformer_core::{
    Layout, Limits, Model, NoTrace, Physics, Plane, Portable, Posed, Role, Schedule, Serial,
    Simulator, SlabSizes, Tiles,
};
use rigidformer_tests::bits::{GIVING, SOFT, models};
use rigidformer_tests::{Golden, Inputs, Random, Room, packed_model, seconds};

/// One thread with an index, and other tiles.
#[derive(Clone, Copy, Default)]
struct Indexed;

impl Schedule for Indexed {
    type Kernels = Portable;
    const LAYOUT: Layout =
        Layout { tiles: Tiles { points: 100, ..Tiles::SMALL }, queries: 1, index: true };

    fn kernels(self) -> Portable {
        Portable
    }
}

/// A scene, and what else there is in it.
struct Start<'a> {
    posed: Vec<Posed<'a>>,
    command: Option<Vec<f32>>,
    planes: Option<Vec<Plane>>,
}

impl<'a> Start<'a> {
    fn new(inputs: &'a Inputs) -> Self {
        Start { posed: inputs.posed(), command: None, planes: None }
    }
}

/// Bits of every pose of every copy after every step. Each copy but the first is moved aside, and
/// other copies are dropped on the way.
fn poses<S: Schedule + Default>(
    file: &[u8],
    (dt_s, steps): (f32, usize),
    start: &Start<'_>,
    copies: usize,
) -> Vec<u32> {
    let model = Model::load(file).unwrap();
    let Start { posed, command, planes } = start;
    let points = posed.iter().map(|posed| posed.unit.points.len()).sum::<usize>() + 7;
    let limits = Limits { units: posed.len() + 1, points };
    let mut room = Room::new(SlabSizes::of(model.config(), limits, copies, S::LAYOUT));
    let mut simulator =
        Simulator::with_layout(&model, limits, copies, S::LAYOUT, room.slabs()).unwrap();
    if let Some(command) = command {
        simulator.set_command(command).unwrap();
    }
    if let Some(planes) = planes {
        simulator.set_planes(planes).unwrap();
    }
    let mut bits = Vec::new();
    // Twice: an index that was there before is built anew.
    for _ in 0..2 {
        simulator.observe_poses(dt_s, posed).unwrap();
        assert_eq!(simulator.replicate(copies), copies);
        let ids: Vec<_> = simulator.units().map(|unit| (unit.id(), unit.role())).collect();
        let mut random = Random(7);
        for copy in 1..copies {
            for ((id, _), posed) in ids.iter().zip(posed) {
                let by = Translation3::from(random.vector() * 0.05);
                let (before, now) = (by * posed.previous, by * posed.current);
                simulator.set_poses_in(copy, *id, &before, &now).unwrap();
            }
        }
        for step in 0..steps {
            for copy in 0..simulator.copies() {
                for (id, _) in ids.iter().filter(|(_, role)| *role == Role::Driven) {
                    let by = Translation3::from(random.vector() * 0.02);
                    let pose = by * simulator.pose(*id).unwrap();
                    simulator.drive_in(copy, *id, &pose).unwrap();
                }
            }
            let mut failed = Vec::new();
            simulator
                .step_copies(S::default(), &mut NoTrace, |copy, report| {
                    bits.push(report.map_or(u32::MAX, |report| report.active_units));
                    failed.push(copy == 1 && step == steps / 2);
                })
                .unwrap();
            simulator.retain_copies(|copy| !failed[copy]);
            for unit in 0..simulator.len() * simulator.copies() {
                let pose = simulator.unit(unit).unwrap().internal_pose();
                bits.extend(pose.rotation.iter().chain(&pose.centre).map(|v| v.to_bits()));
            }
        }
    }
    bits
}

#[test]
fn rollouts_of_the_golden_scenes_are_equal() {
    for (name, file) in models() {
        let (scene, storage) = name.rsplit_once('-').unwrap();
        // The points of soft bodies change their places: they are not searched by an index.
        if scene == SOFT {
            continue;
        }
        // An index searches as well whatever contact does.
        if scene.ends_with(GIVING) {
            continue;
        }
        let golden = Golden::read(scene);
        let (inputs, command) = (golden.inputs(), golden.command());
        // The storage of weights is nothing to the search.
        let (steps, copies) = match (scene, storage) {
            ("edge", "i8") => (12, 1),
            ("edge", _) => continue,
            _ => (40, 3),
        };
        let start = Start { command, ..Start::new(&inputs) };
        let all = poses::<Serial<Portable>>(&file, (golden.dt_s(), steps), &start, copies);
        let indexed = poses::<Indexed>(&file, (golden.dt_s(), steps), &start, copies);
        assert!(all.len() > 1000 && all == indexed, "{name}");
    }
}

/// Units of 4 to 1,200 points that fall on each other, some of them in the same place.
#[test]
fn rollouts_of_large_and_small_units_are_equal() {
    let file = packed_model("tiny-paper-inputs");
    let mut random = Random(3);
    for sizes in [&[4, 16, 17, 1200, 300, 64, 64, 8][..], &[8; 40], &[257, 4, 4]] {
        let points: Vec<Vec<_>> = sizes
            .iter()
            .map(|size| (0..*size).map(|_| Point3::from(random.vector() * 0.2)).collect())
            .collect();
        let current: Vec<Isometry3<f32>> = sizes
            .iter()
            .enumerate()
            .map(|(i, _)| {
                let v = random.vector() * if i % 5 == 4 { 0.0 } else { 0.5 };
                let at = Translation3::new(v.x, v.y, v.z + 0.5);
                Isometry3::from_parts(at, random.rotation())
            })
            .collect();
        let physics = Physics { mass_kg: 0.5, friction: 0.8, restitution: 0.7 };
        let physics = vec![physics; sizes.len()];
        let inputs = Inputs { points, physics, previous: current.clone(), current };
        let start = Start::new(&inputs);
        let all = poses::<Serial<Portable>>(&file, (seconds(10), 12), &start, 1);
        assert!(all == poses::<Indexed>(&file, (seconds(10), 12), &start, 1), "{sizes:?}");
    }
}

/// Roles, bodies and planes: units of one body are not looked at for each other, planes are.
#[test]
fn rollouts_with_roles_bodies_and_planes_are_equal() {
    for name in ["tiny-paper-inputs", "tiny-impact"] {
        let file = packed_model(name);
        let inputs = Golden::read(name).inputs();
        let roles = [Role::Free, Role::Driven, Role::Free, Role::Fixed];
        let bodies = [Some(3), None, Some(3), Some(0), Some(0)];
        let mut start = Start::new(&inputs);
        for (number, posed) in start.posed.iter_mut().enumerate() {
            posed.unit.role = roles[number % roles.len()];
            posed.unit.body = bodies[number % bodies.len()];
        }
        let plane = |normal: Vector3<f32>, offset_m| Plane {
            normal: normal.normalize(),
            offset_m,
            friction: 0.4,
            restitution: 0.2,
        };
        let slope = plane(Vector3::new(0.2, -0.1, 1.0), -0.1);
        let wall = plane(Vector3::new(-1.0, 0.3, 0.0), -1.5);
        for planes in [vec![], vec![slope], vec![wall, slope, Plane::ground(0.3, 0.5)]] {
            let start = Start { planes: Some(planes), posed: start.posed.clone(), command: None };
            let all = poses::<Serial<Portable>>(&file, (seconds(7), 15), &start, 3);
            assert!(all == poses::<Indexed>(&file, (seconds(7), 15), &start, 3), "{name}");
        }
    }
}

/// The index lies in the caller's slab.
#[test]
fn nothing_is_allocated() {
    let file = packed_model("tiny-paper-inputs");
    let inputs = Golden::read("tiny-paper-inputs").inputs();
    let model = Model::load(&file).unwrap();
    let points = inputs.points.iter().map(Vec::len).sum();
    let limits = Limits { units: 16, points };
    let sizes = SlabSizes::of(model.config(), limits, 1, Indexed::LAYOUT);
    assert!(sizes.f32 > SlabSizes::new(model.config(), limits).f32);
    let mut room = Room::new(sizes);
    let posed = inputs.posed();
    let counted = allocation_counter::measure(|| {
        let slabs = room.slabs();
        let mut simulator =
            Simulator::with_layout(&model, limits, 1, Indexed::LAYOUT, slabs).unwrap();
        simulator.observe_poses(seconds(10), &posed).unwrap();
        simulator.step_on(Indexed, &mut NoTrace).unwrap();
    });
    assert_eq!(counted.count_total, 0);
}
