//! Groups: members go as they would alone where nobody is near, whatever the threads; a step that fails changes nobody.

use std::f32::consts::PI;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{
    CommandError, EditError, Limits, Physics, Posed, Role, StepError, Unit, UnitId,
};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::group::{Group, GroupError, MemberId};
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::threads::Threads;
use rigidformer_runtime::world::World;

const WOOD: Physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.1 };
const DT_S: f32 = 1.0 / 3.0;

fn g1() -> LoadedModel {
    LoadedModel::embedded("g1", rigidformer_weights::G1).unwrap()
}

fn edge() -> LoadedModel {
    LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap()
}

fn cuboid(half: [f32; 3]) -> Vec<Point3<f32>> {
    let side = |i: usize, bit: usize, half: f32| if i & bit == 0 { -half } else { half };
    (0..8)
        .map(|i| Point3::new(side(i, 1, half[0]), side(i, 2, half[1]), side(i, 4, half[2])))
        .collect()
}

fn at(x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Isometry3::translation(x, y, z)
}

/// A body of links that walks under commands: no G1, but all that a model of robots needs.
fn robot(model: &LoadedModel, place: &Isometry3<f32>, limits: Limits) -> World {
    let links = [
        ([0.1, 0.15, 0.2], 0.9, 30.0),
        ([0.05, 0.05, 0.2], 0.5, 5.0),
        ([0.1, 0.05, 0.03], 0.03, 1.0),
    ];
    let points = links.map(|(half, _, _)| cuboid(half));
    let mut world = World::new(model, limits).unwrap();
    let units: Vec<Posed<'_>> = links
        .iter()
        .zip(&points)
        .map(|((_, height, mass_kg), points)| Posed {
            unit: Unit::new(points, Physics { mass_kg: *mass_kg, ..WOOD }).body(3),
            previous: place * at(-0.1, 0.0, *height),
            current: place * at(0.0, 0.0, *height),
        })
        .collect();
    world.edit(|simulator| {
        simulator.observe_poses(DT_S, &units).unwrap();
        simulator.set_command(&[0.3, 0.0, 0.0]).unwrap();
    });
    world
}

const ROOM: Limits = Limits { units: 16, points: 256 };

fn walker(place: &Isometry3<f32>) -> World {
    robot(&g1(), place, ROOM)
}

/// A box on the ground.
fn table(x: f32, y: f32) -> (World, UnitId) {
    let mut world = World::new(&edge(), ROOM).unwrap();
    world.set_dt(DT_S).unwrap();
    let id = world.add(&Unit::new(&cuboid([0.1; 3]), WOOD), &at(x, y, 0.1)).unwrap();
    (world, id)
}

/// All that a member's world is, to the bit.
fn state(group: &Group, id: MemberId) -> Vec<u8> {
    group.world(id).unwrap().snapshot().as_bytes().to_vec()
}

fn states(group: &Group) -> Vec<Vec<u8>> {
    group.ids().map(|id| state(group, id)).collect()
}

/// Poses, to the bit: names that a world gave to neighbours count in a snapshot, and change nothing.
fn bits(group: &Group) -> Vec<u32> {
    let units = group.ids().flat_map(|id| {
        let units = group.world(id).unwrap().simulator().units();
        units.map(|unit| unit.internal_pose()).collect::<Vec<_>>()
    });
    let numbers = units.flat_map(|pose| {
        pose.rotation.iter().chain(&pose.centre).map(|x| x.to_bits()).collect::<Vec<_>>()
    });
    numbers.collect()
}

fn away(x: f32) -> Isometry3<f32> {
    at(x, 0.0, 0.0)
}

#[test]
fn members_far_apart_go_as_alone_to_the_bit() {
    let alone: Vec<Vec<u8>> = [0.0, 30.0]
        .map(|x| {
            let mut world = walker(&away(x));
            for _ in 0..5 {
                world.step().unwrap();
            }
            world.snapshot().as_bytes().to_vec()
        })
        .into();
    let mut group = Group::new();
    for (name, x) in [("one", 0.0), ("other", 30.0)] {
        let id = group.add(name, walker(&away(x))).unwrap();
        group.set_neighbour_distance(id, Some(1.0)).unwrap();
    }
    for _ in 0..5 {
        let reports = group.step().unwrap();
        assert!(reports.iter().all(|report| report.neighbours == 0), "{reports:?}");
    }
    assert_eq!(states(&group), alone);
}

#[test]
fn a_member_without_neighbours_goes_as_alone_beside_others() {
    let mut world = walker(&away(0.0));
    let mut group = Group::new();
    let one = group.add("one", walker(&away(0.0))).unwrap();
    group.add("other", walker(&away(0.3))).unwrap();
    assert_eq!(group.neighbour_distance(one), Ok(None), "as it came");
    for _ in 0..5 {
        world.step().unwrap();
        group.step().unwrap();
    }
    assert_eq!(state(&group, one), world.snapshot().as_bytes());
    group.set_neighbour_distance(one, Some(0.5)).unwrap();
    world.step().unwrap();
    let reports = group.step().unwrap();
    assert_eq!(reports.iter().map(|report| report.neighbours).collect::<Vec<_>>(), [3, 0]);
    assert_ne!(state(&group, one), world.snapshot().as_bytes());
    assert_eq!(group.world(one).unwrap().simulator().len(), 3, "its own units alone");
}

/// Two robots and two tables, all near each other.
fn crowd(threads: usize) -> Group {
    let mut group = Group::on(Threads::new(threads));
    for (name, x) in [("one", 0.0), ("other", 0.6)] {
        let id = group.add(name, walker(&away(x))).unwrap();
        group.set_neighbour_distance(id, Some(0.5)).unwrap();
    }
    for (name, x) in [("table", 0.3), ("shelf", 0.55)] {
        group.add(name, table(x, 0.1).0).unwrap();
    }
    group
}

#[test]
fn threads_change_no_bit() {
    let run = |threads: usize| {
        let mut group = crowd(threads);
        let mut counts = Vec::new();
        for _ in 0..6 {
            let reports = group.step().unwrap();
            counts.push(reports.iter().map(|report| report.neighbours).collect::<Vec<_>>());
        }
        let gaps = group.gaps_in_step(0.5).unwrap();
        let gaps: Vec<_> =
            gaps.iter().map(|gap| (gap.gap_m.to_bits(), gap.share.to_bits())).collect();
        (states(&group), counts, gaps)
    };
    let one = run(1);
    assert!(one.1.iter().flatten().any(|count| *count > 0), "they are neighbours: {:?}", one.1);
    assert_eq!(run(2), one);
    assert_eq!(run(16), one);
}

#[test]
fn robots_push_boxes_where_this_step_takes_them() {
    let mut group = Group::new();
    let mut pusher = World::new(&edge(), ROOM).unwrap();
    pusher.set_dt(1.0 / 12.0).unwrap();
    let corners = cuboid([0.1; 3]);
    let hand = Unit::new(&corners, WOOD).role(Role::Driven);
    let hand_id = pusher.add(&hand, &at(-0.25, 0.0, 0.1)).unwrap();
    let (mut boxes, id) = table(0.0, 0.0);
    boxes.set_dt(1.0 / 12.0).unwrap();
    let far = boxes.add(&Unit::new(&cuboid([0.1; 3]), WOOD), &at(3.0, 0.0, 0.1)).unwrap();
    let pusher = group.add("pusher", pusher).unwrap();
    let boxes = group.add("boxes", boxes).unwrap();
    let before = group.world(boxes).unwrap().simulator().get(far).unwrap().internal_pose();
    for step in 1..=12 {
        let target = at(-0.25 + 0.03 * step as f32, 0.0, 0.1);
        group.world_mut(pusher).unwrap().drive(hand_id, &target).unwrap();
        group.step().unwrap();
    }
    let pushed = group.world(boxes).unwrap().pose(id).unwrap().translation;
    assert!((0.28..0.36).contains(&pushed.x), "{pushed}");
    assert!(pushed.y.abs() < 0.02 && (pushed.z - 0.1).abs() < 0.01, "{pushed}");
    assert_eq!(group.world(boxes).unwrap().simulator().get(far).unwrap().internal_pose(), before);
}

#[test]
fn boxes_are_pushed_by_the_step_that_a_robot_makes() {
    // It walks onto a box, at a place and time where only the present step touches it.
    let mut group = Group::new();
    let one = group.add("one", walker(&away(0.0))).unwrap();
    let before = group.world(one).unwrap().simulator().units().next().unwrap().pose();
    let mut alone = group.world(one).unwrap().try_clone().unwrap();
    alone.step().unwrap();
    let after = alone.simulator().units().next().unwrap().pose();
    let way = after.translation.x - before.translation.x;
    assert!(way.abs() > 0.01, "{way}");
    // A block in front of the trunk or behind it, 2 cm in where it ends: only where this step takes the trunk does it touch.
    let ahead = way.signum();
    let (mut world, _) = table(30.0, 0.0);
    let place = after.translation.vector + Vector3::new(ahead * 0.13, 0.0, 0.0);
    let corners = cuboid([0.05; 3]);
    let plate = Unit::new(&corners, WOOD);
    let id = world.add(&plate, &at(place.x, place.y, place.z)).unwrap();
    world.set_gravity(Vector3::zeros()).unwrap();
    let plates = group.add("plate", world).unwrap();
    let reports = group.step().unwrap();
    assert!(reports[1].neighbours > 0, "{reports:?}");
    let pushed = group.world(plates).unwrap().pose(id).unwrap().translation.vector - place;
    assert!(pushed.x * ahead > 0.015, "{pushed}");
    let gap = group.gaps(0.5).unwrap()[0];
    assert_eq!(gap.members, [one, plates]);
    assert_eq!(gap.units[1], id);
    assert!(gap.gap_m > -0.005, "{gap:?}");
}

#[test]
fn members_have_names_and_come_and_go() {
    let mut group = Group::new();
    assert!(group.is_empty() && group.dt_s().is_none());
    assert_eq!(group.step().unwrap(), []);
    let one = group.add("one", walker(&away(0.0))).unwrap();
    let other = group.add("other", walker(&away(5.0))).unwrap();
    assert_eq!((group.len(), group.dt_s()), (2, Some(DT_S)));
    assert_eq!((group.find("other"), group.name(one)), (Some(other), Some("one")));
    let taken = group.add("one", walker(&away(9.0))).unwrap_err();
    assert_eq!(taken, GroupError::NameTaken { name: "one".into() });
    assert_eq!(group.add("", walker(&away(9.0))).unwrap_err(), GroupError::NoName);
    group.step().unwrap();
    let mut gone = group.remove(one).unwrap();
    assert_eq!(gone.simulator().len(), 3);
    gone.step().unwrap();
    let missing = GroupError::NoSuchMember { id: one };
    assert_eq!(group.remove(one).map(drop), Err(missing.clone()));
    assert_eq!(group.set_command(one, &[0.0; 3]), Err(missing.clone()));
    assert_eq!(group.set_neighbour_distance(one, None), Err(missing));
    assert!(
        group.world(one).is_none() && group.world_mut(one).is_none() && group.find("one").is_none()
    );
    // A name is free again, an id is not.
    let again = group.add("one", gone).unwrap();
    assert_ne!(again, one);
    assert_eq!(group.ids().collect::<Vec<_>>(), [other, again]);
    group.step().unwrap();
}

#[test]
fn worlds_that_do_not_fit_are_refused() {
    let mut group = Group::new();
    let untimed = World::new(&edge(), ROOM).unwrap();
    assert_eq!(
        group.add("box", untimed).unwrap_err(),
        GroupError::NoTimestep { name: "box".into() }
    );
    let one = group.add("one", walker(&away(0.0))).unwrap();
    let (mut world, _) = table(3.0, 0.0);
    world.set_dt(0.1).unwrap();
    let other = GroupError::OtherTimestep { name: "box".into(), dt_s: 0.1, group_dt_s: DT_S };
    assert_eq!(group.add("box", world.try_clone().unwrap()).unwrap_err(), other);
    // The last bit is no other step.
    world.set_dt(DT_S.next_up()).unwrap();
    group.add("box", world).unwrap();
    group.step().unwrap();
    let mut copied = World::on(Engine::new().unwrap(), &edge(), ROOM, 2).unwrap();
    copied.set_dt(DT_S).unwrap();
    copied.add(&Unit::new(&cuboid([0.1; 3]), WOOD), &at(0.0, 0.0, 0.1)).unwrap();
    copied.edit(|simulator| simulator.replicate(2));
    assert_eq!(
        group.add("two", copied).unwrap_err(),
        GroupError::Copies { name: "two".into(), copies: 2 }
    );
    for bad in [f32::NAN, f32::INFINITY, -0.1] {
        assert!(matches!(
            group.set_neighbour_distance(one, Some(bad)),
            Err(GroupError::Distance { .. })
        ));
        assert!(matches!(group.gaps(bad), Err(GroupError::Distance { .. })));
        assert!(matches!(group.gaps_in_step(bad), Err(GroupError::Distance { .. })));
    }
    let nan = CommandError::NotFinite { index: 1 };
    let refused = group.set_command(one, &[0.0, f32::NAN, 0.0]).unwrap_err();
    assert_eq!(refused, GroupError::Command { name: "one".into(), source: nan });
    assert!(refused.to_string().starts_with("one: "), "{refused}");
    let short = group.set_command(one, &[0.0]).unwrap_err();
    assert_eq!(
        short,
        GroupError::Command {
            name: "one".into(),
            source: CommandError::Size { expected: 3, found: 1 }
        }
    );
}

#[test]
fn a_member_takes_another_world() {
    let mut group = Group::new();
    let one = group.add("one", walker(&away(0.0))).unwrap();
    let boxes = group.add("box", table(3.0, 0.0).0).unwrap();
    let (mut slow, _) = table(5.0, 0.0);
    slow.set_dt(0.1).unwrap();
    // The first member's time is that of the others too.
    for id in [one, boxes] {
        let refused = group.set_world(id, slow.try_clone().unwrap()).map(drop);
        assert!(matches!(refused, Err(GroupError::OtherTimestep { .. })), "{refused:?}");
    }
    let old = group.set_world(boxes, table(7.0, 0.0).0).unwrap();
    let place = |world: &World| world.simulator().units().next().unwrap().pose().translation.x;
    assert_eq!((place(&old), place(group.world(boxes).unwrap())), (3.0, 7.0));
    // Soft bodies have no neighbours.
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../weights/models/soft.rfm");
    let soft = LoadedModel::open(path.as_ref()).unwrap();
    let mut world = World::new(&soft, ROOM).unwrap();
    world.set_dt(DT_S).unwrap();
    assert_eq!(group.neighbour_distance(boxes), Ok(Some(0.1)));
    group.set_world(boxes, world).unwrap();
    assert_eq!(group.neighbour_distance(boxes), Ok(None));
    let refused = group.set_neighbour_distance(boxes, Some(0.1));
    assert_eq!(refused, Err(GroupError::Soft { name: "box".into() }));
}

/// Makes the next step of a group fail.
type Spoil = fn(&mut Group);

#[test]
fn a_step_that_fails_changes_nobody() {
    // A later member has no command, another no room for its neighbours, one another time, one no units.
    let spoil: [(&str, Spoil); 5] = [
        ("no command", |group| {
            let mut world = World::new(&g1(), ROOM).unwrap();
            let points = cuboid([0.1; 3]);
            let posed = [Posed {
                unit: Unit::new(&points, WOOD),
                previous: at(9.0, 0.0, 1.0),
                current: at(9.0, 0.0, 1.0),
            }];
            world.edit(|simulator| simulator.observe_poses(DT_S, &posed)).unwrap();
            group.add("spoiler", world).unwrap();
        }),
        ("no room", |group| {
            let mut world = World::new(&edge(), Limits { units: 2, points: 64 }).unwrap();
            world.set_dt(DT_S).unwrap();
            world.add(&Unit::new(&cuboid([0.1; 3]), WOOD), &at(0.1, 0.1, 0.1)).unwrap();
            group.add("spoiler", world).unwrap();
        }),
        ("another time", |group| {
            let id = group.find("table").unwrap();
            group.world_mut(id).unwrap().set_dt(0.1).unwrap();
        }),
        ("no units", |group| {
            let mut world = World::new(&edge(), ROOM).unwrap();
            world.set_dt(DT_S).unwrap();
            group.add("spoiler", world).unwrap();
        }),
        ("too fast", |group| {
            let mut world = World::new(&edge(), ROOM).unwrap();
            world.set_dt(DT_S).unwrap();
            let id = world.add(&Unit::new(&cuboid([0.1; 3]), WOOD), &at(0.0, 2.0, 1.0)).unwrap();
            world.set_velocity(id, &Vector3::new(0.0, 150.0, 0.0), &Vector3::zeros()).unwrap();
            group.add("spoiler", world).unwrap();
        }),
    ];
    for (why, spoil) in spoil {
        let mut group = crowd(2);
        group.step().unwrap();
        spoil(&mut group);
        let (before, poses) = (states(&group), bits(&group));
        let previous = |group: &Group| -> Vec<_> {
            let worlds = group.ids().map(|id| group.world(id).unwrap());
            worlds
                .flat_map(|world| {
                    world
                        .simulator()
                        .units()
                        .map(|unit| world.previous_pose(unit.id()))
                        .collect::<Vec<_>>()
                })
                .collect()
        };
        let then = previous(&group);
        let error = group.step().unwrap_err();
        assert_eq!(bits(&group), poses, "{why}: {error}");
        assert_eq!(previous(&group), then, "{why}: {error}");
        // Names may have been given meanwhile, so snapshots are compared where nobody took anything in.
        let lengths = |states: &[Vec<u8>]| states.iter().map(Vec::len).collect::<Vec<_>>();
        assert_eq!(lengths(&states(&group)), lengths(&before), "{why}");
        match (why, &error) {
            ("no command", GroupError::Step { name, source: StepError::NoCommand { size: 3 } })
            | ("no units", GroupError::Step { name, source: StepError::NoUnits }) => {
                assert_eq!(name, "spoiler");
            }
            ("no room", GroupError::Room { name, needed, limits }) => {
                assert_eq!((name.as_str(), limits.units), ("spoiler", 2));
                assert!(needed.units > 2, "{error}");
            }
            ("another time", GroupError::OtherTimestep { name, .. }) => assert_eq!(name, "table"),
            ("too fast", GroupError::Neighbour { of, source: EditError::Jump { .. }, .. }) => {
                assert_eq!(of, "spoiler");
            }
            _ => panic!("{why}: {error:?}"),
        }
        // It goes on as if the step had never been tried.
        let mut other = crowd(1);
        other.step().unwrap();
        if let Some(id) = group.find("spoiler") {
            group.remove(id).unwrap();
        } else {
            let id = group.find("table").unwrap();
            group.world_mut(id).unwrap().set_dt(DT_S).unwrap();
            let id = other.find("table").unwrap();
            other.world_mut(id).unwrap().set_dt(0.1).unwrap();
            other.world_mut(id).unwrap().set_dt(DT_S).unwrap();
        }
        group.step().unwrap();
        other.step().unwrap();
        assert_eq!(bits(&group), bits(&other), "{why}");
    }
}

#[test]
fn a_clone_looks_ahead_and_a_member_can_go_back() {
    let mut group = crowd(2);
    group.step().unwrap();
    let mut ahead = group.try_clone().unwrap();
    assert_eq!(ahead.ids().collect::<Vec<_>>(), group.ids().collect::<Vec<_>>());
    let kept: Vec<_> = group.ids().map(|id| (id, group.world(id).unwrap().snapshot())).collect();
    for _ in 0..3 {
        ahead.step().unwrap();
    }
    for _ in 0..3 {
        group.step().unwrap();
    }
    assert_eq!(bits(&ahead), bits(&group));
    // Going on from kept states gives the same bits: what others take in of a member follows from its state alone.
    for (id, snapshot) in &kept {
        group.world_mut(*id).unwrap().restore(snapshot).unwrap();
    }
    for _ in 0..3 {
        group.step().unwrap();
    }
    assert_eq!(bits(&ahead), bits(&group));
}

#[test]
fn gaps_tell_overlaps_and_what_happened_within_the_step() {
    let mut group = Group::new();
    let block = |x: f32, name: &str, group: &mut Group| {
        let mut world = World::new(&edge(), ROOM).unwrap();
        world.set_dt(0.1).unwrap();
        let corners = cuboid([0.1; 3]);
        let unit = Unit::new(&corners, WOOD);
        let id = world.add(&unit.role(Role::Driven), &at(x, 0.0, 0.5)).unwrap();
        (group.add(name, world).unwrap(), id)
    };
    let (one, a) = block(0.0, "one", &mut group);
    let (other, b) = block(1.0, "other", &mut group);
    assert_eq!(group.gaps(0.5).unwrap(), []);
    let gap = group.gaps(0.9).unwrap()[0];
    assert!((gap.gap_m - 0.8).abs() < 1e-5, "{gap:?}");
    assert_eq!((gap.members, gap.units), ([one, other], [a, b]));
    // Straight through.
    group.world_mut(one).unwrap().drive(a, &at(2.0, 0.0, 0.5)).unwrap();
    group.step().unwrap();
    assert_eq!(group.gaps(0.5).unwrap(), [], "they are apart now");
    let gap = group.gaps_in_step(0.5).unwrap()[0];
    assert!((gap.gap_m + 0.2).abs() < 0.02, "{gap:?}");
    assert!((gap.share - 0.5).abs() < 0.06, "{gap:?}");
    // Half in.
    let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * PI / 2.0);
    let target = Isometry3::from_parts(Translation3::new(1.15, 0.0, 0.5), turn);
    group.world_mut(one).unwrap().drive(a, &target).unwrap();
    group.step().unwrap();
    let gap = group.gaps(0.0).unwrap()[0];
    assert!((gap.gap_m + 0.05).abs() < 1e-4 && gap.share == 1.0, "{gap:?}");
}
