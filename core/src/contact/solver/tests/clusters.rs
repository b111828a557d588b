//! Clusters: units that bonds hold together move as one rigid body.

use super::*;
use crate::structure::bonds::{Kept, Seam, group};

impl World {
    /// Makes pairs hold together: their units are of one body then.
    fn bond(&mut self, pairs: &[[usize; 2]]) {
        for unit in pairs.as_flattened() {
            self.slots[*unit].body = 1;
        }
        self.group(pairs);
    }

    fn group(&mut self, pairs: &[[usize; 2]]) {
        let pair = |pair: &[usize; 2]| Kept {
            pair: *pair,
            holds: true,
            breaks: false,
            seam: Seam::default(),
        };
        group(&mut self.slots, pairs.iter().map(pair));
    }

    /// The cells of a box, each half as long, in a row of bonds.
    fn add_cells(&mut self, half: [f32; 3], pose: Pose) {
        let [x, y, z] = half.map(|half| 0.5 * half);
        let first = self.slots.len();
        for k in 0..8 {
            let side = |bit: usize, half: f32| if k & bit == 0 { -half } else { half };
            let arm = Vector3::new(side(1, x), side(2, y), side(4, z));
            self.add(&cuboid(x, y, z), Pose { centre: pose.apply(&arm), ..pose }).mass = 0.125;
        }
        let pairs: Vec<_> = (first..first + 7).map(|unit| [unit, unit + 1]).collect();
        let body = first as u32 + 1;
        self.slots[first..].iter_mut().for_each(|slot| slot.body = body);
        let others = self.pairs(first);
        self.group(&[others, pairs].concat());
    }

    /// What holds together among the first units.
    fn pairs(&self, first: usize) -> Vec<[usize; 2]> {
        let leads = self.slots[..first].iter().enumerate();
        leads
            .filter_map(|(unit, slot)| Some([slot.cluster_root()?, unit]))
            .filter(|[a, b]| a != b)
            .collect()
    }

    /// Mass, centre, momentum, and spin about a place, of units, as their poses tell them.
    fn momentum(
        &self,
        units: core::ops::Range<usize>,
    ) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
        let (mut mass, mut centre, mut linear, mut angular) =
            (0.0, Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for slot in &self.slots[units] {
            let (dt, m) = (f64::from(self.dt), f64::from(slot.mass));
            let place = slot.current.centre.cast::<f64>();
            let velocity =
                slot.course.way.cast::<f64>() / dt + self.gravity.cast::<f64>() * (0.5 * dt);
            let turn = slot.course.turn() / self.dt;
            let own = rotate_back(&slot.current.rotation, &turn).component_mul(&slot.inertia_m2);
            let own = rotate(&slot.current.rotation, &own).cast::<f64>() * m;
            mass += m;
            centre += place * m;
            linear += velocity * m;
            angular += place.cross(&velocity) * m + own;
        }
        (centre / mass, linear, angular)
    }

    /// Gives a cluster a velocity and a spin about a place.
    fn throw_all(
        &mut self,
        units: core::ops::Range<usize>,
        velocity: Vector3<f32>,
        spin: Vector3<f32>,
    ) {
        let (centre, ..) = self.momentum(units.clone());
        for unit in units {
            let arm = self.slots[unit].current.centre - centre.cast::<f32>();
            self.throw(unit, velocity + spin.cross(&arm), spin);
        }
    }

    /// How far the units of a cluster are from where they were in its first one's frame, metres, and how far turned.
    fn looseness(&self, units: core::ops::Range<usize>, began: &[Pose]) -> (f32, f32) {
        let (first, was) = (self.slots[units.start].current, began[units.start]);
        let own = |unit: usize| {
            let (now, then) = (self.slots[unit].current, began[unit]);
            let away = first.local(&now.centre) - was.local(&then.centre);
            let turns = [(first, now), (was, then)]
                .map(|(a, b)| product(&a.rotation.transpose(), &b.rotation));
            (norm(&away), norm(&turn_between(&turns[0], &turns[1])))
        };
        units.map(own).fold((0.0, 0.0), |(a, b), (c, d)| (f32::max(a, c), f32::max(b, d)))
    }

    fn poses(&self) -> Vec<Pose> {
        self.slots.iter().map(|slot| slot.current).collect()
    }
}

use crate::geometry::{product, rotate, rotate_back};

fn askew() -> Pose {
    let rotation = turned(&Matrix3::identity(), &Vector3::new(0.4, -0.7, 0.2));
    Pose { rotation, ..at(0.3, -0.2, 1.0) }
}

#[test]
fn clusters_are_what_bonds_connect() {
    let mut world = World::new(1.0 / 60.0);
    for k in 0..6 {
        world.add(&cuboid(0.1, 0.1, 0.1), at(k as f32, 0.0, 1.0)).body = 7;
    }
    let of = |world: &World| -> Vec<_> {
        world.slots.iter().map(|slot| (slot.cluster_root(), slot.body)).collect()
    };
    world.group(&[[1, 4], [4, 5], [0, 3]]);
    let (a, b) = (Some(0), Some(1));
    assert_eq!(of(&world), [(a, 7), (b, 7), (None, 7), (a, 7), (b, 7), (b, 7)]);
    let numbers: Vec<_> =
        crate::scene::members(&world.slots, 1).map(|(number, _)| number).collect();
    assert_eq!(numbers, [1, 4, 5]);
    // What parts gets numbers of its own.
    world.group(&[[4, 5]]);
    let c = Some(4);
    assert_eq!(of(&world), [(None, 7), (None, 7), (None, 7), (None, 1), (c, 2), (c, 2)]);
    world.group(&[]);
    let bodies: Vec<_> = world.slots.iter().map(|slot| slot.body).collect();
    assert_eq!(bodies, [7, 7, 7, 1, 2, 3]);
}

/// A cube of cells is one cube: it falls, bounces and comes to lie where the cube of one unit does. Their impulses act in other orders,
/// so throws part by more or less: their mean is what counts.
#[test]
fn cells_of_a_box_move_as_the_box() {
    for dt in [1.0 / 240.0, 1.0 / 60.0, 5.0 / 240.0, 10.0 / 240.0] {
        let (mut state, mut sum) = (5, 0.0);
        for _ in 0..16 {
            let (half, pose) = ([0.2, 0.15, 0.1], at(0.1, 0.2, 0.6));
            let mut alone = World::new(dt);
            alone.add(&cuboid(half[0], half[1], half[2]), pose);
            let mut cells = World::new(dt);
            cells.add_cells(half, pose);
            let began = cells.poses();
            let velocity = random_vector(&mut state) * 0.5;
            alone.throw(0, velocity, Vector3::zeros());
            cells.throw_all(0..8, velocity, Vector3::zeros());
            let mut worst = 0.0_f32;
            for _ in 0..(1.0 / dt).round() as usize {
                alone.step();
                cells.step();
                let (centre, ..) = cells.momentum(0..8);
                worst = worst.max(norm(&(centre.cast::<f32>() - alone.slots[0].current.centre)));
            }
            let (away, turn) = cells.looseness(0..8, &began);
            assert!(away < 1e-5 && turn < 1e-5, "{dt}: {away} {turn}");
            sum += worst / 16.0;
        }
        std::println!("{dt}: {sum} m from the box");
        assert!(sum < 8e-3, "{dt}: {sum}");
    }
}

/// Of a cube of eight cubes the inertia is the same about all axes: its spin stays, and its centre falls.
#[test]
fn a_spinning_cluster_flies_freely() {
    let dt = 5.0 / 240.0;
    let mut world = World::new(dt);
    world.planes.clear();
    world.add_cells([0.2; 3], Pose { centre: Vector3::zeros(), ..askew() });
    let (velocity, spin) = (Vector3::new(1.0, 2.0, 3.0), Vector3::new(2.0, -3.0, 1.0));
    world.throw_all(0..8, velocity, spin);
    let began = world.poses();
    let steps = 96;
    let rows = (0..steps).map(|_| world.step()).last().unwrap();
    assert!(rows.iter().all(|row| row[STATE] == 0.0));
    let time = steps as f64 * f64::from(dt);
    let (centre, linear, _) = world.momentum(0..8);
    let fallen = Vector3::new(1.0 * time, 2.0 * time, 3.0 * time - 0.5 * 9.81 * time * time);
    assert!((centre - fallen).norm() < 2e-4, "{centre} {fallen}");
    assert!((linear - Vector3::new(1.0, 2.0, 3.0 - 9.81 * time)).norm() < 3e-3, "{linear}");
    for slot in &world.slots {
        let found = slot.course.turn() / dt;
        assert!(norm(&(found - spin)) < 2e-4, "{found}");
    }
    let (away, turn) = world.looseness(0..8, &began);
    assert!(away < 1e-5 && turn < 1e-5, "{away} {turn}");
}

#[test]
fn cells_stay_together_for_five_hundred_steps() {
    let mut world = World::new(1.0 / 60.0);
    world.add_cells([0.2; 3], askew());
    world.add_cells([0.1, 0.2, 0.15], Pose { centre: Vector3::new(0.25, -0.1, 1.8), ..askew() });
    world.throw_all(0..8, Vector3::new(1.0, 0.5, 0.0), Vector3::new(4.0, 2.0, -1.0));
    let began = world.poses();
    for _ in 0..500 {
        world.step();
    }
    for units in [0..8, 8..16] {
        let (away, turn) = world.looseness(units.clone(), &began);
        std::println!("{units:?}: {away} m, {turn} rad");
        assert!(away < 1e-5 && turn < 1e-5, "{units:?}: {away} m, {turn} rad");
    }
}

/// Two cubes of cells that meet away from their centres, without gravity.
#[test]
fn clusters_that_collide_keep_their_momentum() {
    let mut world = World::new(1.0 / 240.0);
    world.gravity = Vector3::zeros();
    world.planes.clear();
    world.add_cells([0.2; 3], askew());
    world.add_cells([0.2; 3], at(0.9, 0.0, 1.15));
    world.throw_all(8..16, Vector3::new(-3.0, -0.5, 0.0), Vector3::new(1.0, 0.0, 2.0));
    let (_, linear, angular) = world.momentum(0..16);
    let (_, alone, _) = world.momentum(0..8);
    assert!(alone.norm() < 1e-6);
    for step in 0..60 {
        world.step();
        let (_, now, spin) = world.momentum(0..16);
        assert!((now - linear).norm() < 2e-3, "{step}: {now} {linear}");
        assert!((spin - angular).norm() < 1e-2, "{step}: {spin} {angular}");
    }
    let (_, alone, _) = world.momentum(0..8);
    assert!(alone.norm() > 0.5, "they met: {alone}");
}

#[test]
fn a_cluster_comes_to_rest_to_the_bit() {
    for dt in [1.0 / 240.0, 1.0 / 60.0, 10.0 / 240.0] {
        let mut world = World::new(dt);
        world.add_cells([0.2, 0.1, 0.1], at(0.2, 0.1, 0.1));
        world.add_cells([0.1, 0.1, 0.1], at(0.25, 0.1, 0.3));
        world.run(1.0);
        let bits = world.bits();
        for _ in 0..48 {
            let rows = world.step();
            assert!(rows.iter().all(|row| row[STATE] == -1.0), "{dt}");
            assert_eq!(world.bits(), bits, "{dt}");
        }
        let moved = world.slots[0].current.centre - at(0.1, 0.05, 0.05).centre;
        assert!(norm(&moved) < 1e-3, "{dt}: {moved}");
    }
}

/// A row of three, of which one end stands on an edge, falls over; broken, the end that stands stays.
#[test]
fn broken_bonds_let_units_go() {
    for holds in [true, false] {
        let mut world = World::new(1.0 / 60.0);
        for k in 0..3 {
            world.add(&cuboid(0.1, 0.1, 0.1), at(0.2 * k as f32, 0.0, 0.5));
        }
        world.add(&cuboid(0.1, 0.1, 0.2), at(0.0, 0.0, 0.2)).role = Role::Fixed;
        world.bond(&[[0, 1], [1, 2]]);
        world.step();
        if !holds {
            world.group(&[[1, 2]]);
        }
        world.run(1.0);
        let heights = [0, 1, 2].map(|unit: usize| world.slots[unit].current.centre.z);
        if holds {
            assert!(heights[2] < 0.3, "{heights:?}");
        } else {
            // The others fall, and may lean on what the first stands on.
            let falls = heights[1] < 0.3 && heights[2] < 0.2;
            assert!((heights[0] - 0.5).abs() < 2e-3 && falls, "{heights:?}");
        }
    }
}

/// Overlaps that a correction leaves: whole clusters leave each other and the ground.
#[test]
fn clusters_are_kept_apart_as_a_whole() {
    let mut world = World::new(1.0 / 240.0);
    world.gravity = Vector3::zeros();
    world.add_cells([0.1; 3], at(0.0, 0.0, 1.0));
    world.add_cells([0.1; 3], at(0.2005, 0.03, 1.0));
    let free = kept_apart(&mut world, |_| ());
    let next = kept_apart(&mut world, |next| {
        for row in &mut next[8..] {
            row[9] -= 0.02;
        }
    });
    for (unit, (next, free)) in next.iter().zip(&free).enumerate() {
        let x = next[9] - free[9];
        let expected = if unit < 8 { -0.00975 } else { -0.01025 };
        let [moved, freely] = [next, free].map(|row| State::read(row).course);
        assert!((x - expected).abs() < 5e-5 && moved.way == freely.way, "{unit}: {x}");
    }
}

/// Single steps of scenes with clusters, from `rigidformer_lab.solver_cases --clusters`.
#[test]
fn steps_of_clusters_are_those_of_the_lab() {
    check_against_the_lab(include_str!("../clusters.txt"), |world, units| {
        let cluster_root = |row: &Vec<f32>| row[row.len() - 1] as usize;
        let pairs: Vec<_> = units
            .iter()
            .map(cluster_root)
            .enumerate()
            .map(|(unit, cluster_root)| [cluster_root, unit])
            .collect();
        for (slot, [cluster_root, _]) in world.slots.iter_mut().zip(&pairs) {
            slot.body = *cluster_root as u32 + 1;
        }
        world.group(&pairs);
    });
}
