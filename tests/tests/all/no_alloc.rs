//! Loading, observing and stepping allocate nothing, whatever the storage.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::Isometry3;
use rigidformer_core::{Limits, Model, Plane, Role, Simulator, SlabSizes, Unit};
use rigidformer_tests::bits::{PRECISIONS, quantised};
use rigidformer_tests::packed_model;
use rigidformer_tests::{Golden, Room, Seen, observed, seconds};

fn allocations(run: impl FnOnce()) -> u64 {
    allocation_counter::measure(run).count_total
}

#[test]
fn nothing_is_allocated() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![1]))), 1, "the counter counts");
    let golden = Golden::read("tiny");
    let inputs = golden.inputs();
    let (posed, command) = (inputs.posed(), golden.command().unwrap());
    let (before, now) = (inputs.frame(&inputs.previous), inputs.frame(&inputs.current));
    let frames = observed(&inputs.physics, &before, &now);
    let dt = seconds(golden.step);
    for (name, precision) in PRECISIONS {
        let file = quantised(&packed_model("tiny"), precision);
        let limits =
            Limits { units: 16, points: 2 * inputs.points.iter().map(Vec::len).sum::<usize>() };
        let sizes = SlabSizes::new(Model::load(&file).unwrap().config(), limits);
        let mut room = Room::new(sizes);
        let mut state = vec![0; 100_000];
        let count = allocations(|| {
            let model = Model::load(&file).unwrap();
            let mut simulator = Simulator::new(&model, limits, room.slabs()).unwrap();
            simulator.set_command(&command).unwrap();
            simulator.observe(dt, &frames).unwrap();
            simulator.step().unwrap();
            simulator.observe_poses(dt, &posed).unwrap();
            simulator.step().unwrap();
            assert!(simulator.unit(0).unwrap().points().count() > 3);
            // So do changes of the scene.
            let hand = Unit::new(&inputs.points[0], inputs.physics[0]).role(Role::Driven);
            let pose = Isometry3::translation(0.0, 0.0, 9.0);
            let hand = simulator.add(&hand, &pose, &pose).unwrap();
            simulator.drive(hand, &pose).unwrap();
            simulator.set_planes(&[Plane::ground(0.5, 0.5); 2]).unwrap();
            simulator.set_dt(2.5 * dt).unwrap();
            simulator.step().unwrap();
            simulator.remove(hand).unwrap();
            simulator.step().unwrap();
            // And a snapshot, and going on from it.
            let length = simulator.snapshot(&mut state).unwrap();
            simulator.step().unwrap();
            simulator.restore(&state[..length]).unwrap();
            assert!(simulator.restore(&state[1..length]).is_err());
            let velocity = simulator.velocities().next().unwrap();
            let first = simulator.units().next().unwrap().id();
            simulator.set_velocity(first, &velocity).unwrap();
            simulator.step().unwrap();
            // Refusals allocate nothing either.
            assert!(simulator.observe(0.0, &frames).is_err());
            assert!(simulator.remove(hand).is_err());
            assert!(Model::load(&file[..file.len() - 64]).is_err());
        });
        assert_eq!(count, 0, "{name}");
    }
}

#[test]
fn nothing_is_allocated_where_bonds_break() {
    let golden = Golden::read("tiny-breaking");
    let inputs = golden.inputs();
    let mut posed = inputs.posed();
    for (posed, body) in posed.iter_mut().zip(golden.integers("body")) {
        posed.unit.body = u16::try_from(body).ok();
    }
    let (pairs, dt) = (golden.integers("bonds"), golden.dt_s());
    let limits = Limits { units: 16, points: inputs.points.iter().map(Vec::len).sum() };
    let mut all_broken = 0;
    for (name, precision) in PRECISIONS {
        let file = quantised(&packed_model("tiny-breaking"), precision);
        let sizes = SlabSizes::new(Model::load(&file).unwrap().config(), limits);
        let mut room = Room::new(sizes);
        let mut broken = 0;
        let count = allocations(|| {
            let model = Model::load(&file).unwrap();
            let mut simulator = Simulator::new(&model, limits, room.slabs()).unwrap();
            simulator.observe_poses(dt, &posed).unwrap();
            for pair in pairs.as_chunks::<2>().0 {
                let pair = pair.map(|unit| simulator.unit(unit as usize).unwrap().id());
                simulator.bond(&[pair]).unwrap();
            }
            for _ in 0..100 {
                simulator.step().unwrap();
            }
            broken = simulator.bonds().filter(|bond| !bond.holds).count();
        });
        assert_eq!(count, 0, "{name}");
        all_broken += broken;
    }
    assert!(all_broken > 0, "a bond breaks");
}

#[test]
fn nothing_is_allocated_for_soft_bodies() {
    let seen = Seen::golden();
    let units = seen.units();
    let (dt, planes) = (seen.dt_s(), seen.scene.planes().unwrap());
    for (name, precision) in PRECISIONS {
        let file = quantised(&packed_model("tiny-soft"), precision);
        let limits = Limits { units: units.len(), points: seen.scene.points() };
        let sizes = SlabSizes::new(Model::load(&file).unwrap().config(), limits);
        let mut room = Room::new(sizes);
        let (units, again) = (units.clone(), units.clone());
        let count = allocations(|| {
            let model = Model::load(&file).unwrap();
            let mut simulator = Simulator::new(&model, limits, room.slabs()).unwrap();
            simulator.set_planes(planes).unwrap();
            simulator.observe(dt, &units).unwrap();
            simulator.step().unwrap();
            simulator.observe(dt, &again).unwrap();
            simulator.step().unwrap();
            let places = simulator.units().flat_map(|unit| unit.soft_points());
            assert!(places.count() > 48);
            let last = simulator.units().last().unwrap().id();
            assert!(simulator.remove(last).is_err());
        });
        assert_eq!(count, 0, "{name}");
    }
}
