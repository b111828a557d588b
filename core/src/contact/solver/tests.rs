//! The solver by itself: what mechanics says, what rest is, and what the lab's twin gives.

use super::*;
use crate::contact::ground::Plane;
use crate::contact::impacts::inertia;
use crate::contact::law::{ContactLaw, FrictionLimit};
use crate::contact::pieces::Pieces;
use crate::geometry::{
    Hull, Pose, Precision, STATE, extreme_points, norm, product, read_pose, separation,
    turn_between, turned,
};
use crate::kernels::{Portable, Serial};
use crate::limits::MAX_PLANES;
use crate::measure::Measure;
use crate::scene::{Compliance, Physics, Unit};
use crate::stand_in::{OfCompliance, OfForce};
use nalgebra::{Matrix3, Point3, Vector3};
use std::{format, vec, vec::Vec};

mod closed_forms;
#[cfg(feature = "deform")]
mod clusters;
mod collisions;
#[cfg(feature = "compliance")]
mod giving;

/// A scene with its memory, which goes on by the solver alone.
struct World {
    slots: Vec<UnitSlot>,
    points: Vec<Point3<f32>>,
    planes: Vec<Plane>,
    plane_compliance: [Compliance; MAX_PLANES],
    gravity: Vector3<f32>,
    contact_law: ContactLaw,
    dt: f32,
    scratch: Vec<f32>,
    prior: Vec<f32>,
    /// Numbers a unit that are missing in its memory.
    missing: usize,
}

impl World {
    fn new(dt: f32) -> Self {
        World {
            slots: Vec::new(),
            points: Vec::new(),
            planes: vec![Plane::ground(1.0, 1.0)],
            plane_compliance: [Compliance::RIGID; MAX_PLANES],
            gravity: Vector3::new(0.0, 0.0, -9.81),
            contact_law: ContactLaw::RIGID,
            dt,
            scratch: Vec::new(),
            prior: Vec::new(),
            missing: 0,
        }
    }

    /// A free unit of a kilogram at rest, whose pairs have friction .5 and restitution .3.
    fn add(&mut self, points: &[Point3<f32>], pose: Pose) -> &mut UnitSlot {
        let physics = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.3 };
        let (mut marks, mut hull) = (vec![0.0; points.len()], points.to_vec());
        let (_, is_ball) = extreme_points(points, &mut marks, &mut hull);
        self.slots.push(UnitSlot {
            start: self.points.len(),
            hull_start: self.points.len(),
            count: points.len(),
            hull: points.len(),
            physics,
            is_ball,
            mass: 1.0,
            radius: crate::geometry::radius(points),
            inertia_m2: inertia(&Unit::new(points, physics), points, is_ball, &Measure::SI),
            current: pose,
            target: pose,
            ..UnitSlot::EMPTY
        });
        self.points.extend(points);
        self.slots.last_mut().unwrap()
    }

    /// As [`add`](Self::add), of pieces.
    fn add_pieces(&mut self, pieces: &[Vec<Point3<f32>>], pose: Pose) -> &mut UnitSlot {
        let points = pieces.concat();
        let counts: Vec<u16> = pieces.iter().map(|piece| piece.len() as u16).collect();
        let mut rows = vec![Point3::origin(); points.len() + 2 * pieces.len()];
        let mut marks = vec![0.0; rows.len()];
        let kept = Pieces::new(&points, &counts);
        let hull = kept.store((&Point3::origin(), 1.0), &mut marks, &mut rows);
        self.add(&points, pose);
        self.points.truncate(self.points.len() - points.len());
        self.points.extend(rows);
        let slot = self.slots.last_mut().unwrap();
        (slot.hull, slot.pieces) = (hull, pieces.len() as u8);
        slot
    }

    fn scene(&mut self, copies: usize) -> Scene<'_> {
        let count = self.slots.len();
        Scene {
            slots: &mut self.slots,
            count,
            per_copy: count / copies,
            points: &mut [],
            hulls: &mut self.points,
            planes: self.planes.iter().copied().collect(),
            #[cfg(feature = "terrain")]
            terrain: None,
            plane_compliance: OfCompliance::new(self.plane_compliance),
            measure: Measure::SI,
            second: OfForce::new(1.0),
            gravity: self.gravity,
            contact_law: self.contact_law,
            dt: self.dt,
            substeps: 1,
            #[cfg(rigidformer_host)]
            extra: super::extra(count),
            #[cfg(feature = "deform")]
            soft: crate::structure::soft_points::SoftPoints::carve(&mut [], 0, 0, 0),
        }
    }

    /// Rows of all units after a step; nothing moves yet. All units in all substeps of a step, or without those that contact cannot reach:
    /// that is no difference.
    fn solve(&mut self) -> Vec<[f32; PRIOR]> {
        let bits = |rows: &[[f32; PRIOR]]| -> Vec<_> {
            rows.as_flattened().iter().map(|number| number.to_bits()).collect()
        };
        let all = self.solve_with(false);
        let rows = self.solve_with(true);
        assert!(bits(&rows) == bits(&all), "what is left out makes a difference");
        rows
    }

    fn solve_with(&mut self, may_rest: bool) -> Vec<[f32; PRIOR]> {
        let count = self.slots.len();
        // What is in memory before does not matter.
        let (mut scratch, mut prior) =
            (core::mem::take(&mut self.scratch), core::mem::take(&mut self.prior));
        let numbers = super::scratch(count) + super::extra(count);
        scratch.resize(count * (numbers - self.missing), f32::NAN);
        prior.resize(count * PRIOR, f32::NAN);
        super::solve_with(
            Serial(Portable),
            &self.scene(1),
            0,
            (&mut scratch, &mut prior),
            may_rest,
        );
        let rows = prior.as_chunks().0.to_vec();
        (self.scratch, self.prior) = (scratch, prior);
        rows
    }

    fn step(&mut self) -> Vec<[f32; PRIOR]> {
        let rows = self.solve();
        for (slot, row) in self.slots.iter_mut().zip(&rows) {
            slot.go_to(row);
        }
        rows
    }

    /// As [`step`](Self::step), as a simulator takes it: once, and what lies still is known.
    fn go(&mut self) {
        let rows = self.solve_with(true);
        for (slot, row) in self.slots.iter_mut().zip(&rows) {
            slot.go_to(row);
        }
        #[cfg(rigidformer_host)]
        mark_still(&mut self.slots, &self.prior, &mut self.scratch);
    }

    /// Velocity and spin at the end of the last step.
    fn motion(&self, unit: usize) -> [Vector3<f32>; 2] {
        let course = &self.slots[unit].course;
        [course.way / self.dt + self.gravity * (0.5 * self.dt), course.turn() / self.dt]
    }

    fn run(&mut self, seconds: f32) {
        for _ in 0..(seconds / self.dt).round() as usize {
            self.step();
        }
    }

    fn bits(&self) -> Vec<u32> {
        let row = |slot: &UnitSlot| {
            let mut row = [0.0; STATE];
            slot.state().write(&mut row);
            row.map(f32::to_bits)
        };
        self.slots.iter().flat_map(row).collect()
    }

    /// Gives a unit a velocity and a spin, as two frames tell them.
    fn throw(&mut self, unit: usize, velocity: Vector3<f32>, spin: Vector3<f32>) {
        let (dt, gravity) = (self.dt, self.gravity);
        let slot = &mut self.slots[unit];
        slot.course = slot.course.moving(velocity * dt - gravity * (0.5 * dt * dt), spin * dt);
    }
}

fn cuboid(x: f32, y: f32, z: f32) -> Vec<Point3<f32>> {
    let side = |k: i32, bit: i32, half: f32| if k & bit == 0 { -half } else { half };
    (0..8).map(|k| Point3::new(side(k, 1, x), side(k, 2, y), side(k, 4, z))).collect()
}

/// A plate on two walls, of which nothing is between the walls.
fn table(x: f32, y: f32, z: f32) -> [Vec<Point3<f32>>; 3] {
    let piece = |size: [f32; 3], shift: Vector3<f32>| -> Vec<Point3<f32>> {
        cuboid(size[0], size[1], size[2]).iter().map(|point| point + shift).collect()
    };
    let wall =
        |side: f32| piece([0.15 * x, y, 0.8 * z], Vector3::new(side * 0.85 * x, 0.0, -0.2 * z));
    [piece([x, y, 0.2 * z], Vector3::new(0.0, 0.0, 0.8 * z)), wall(-1.0), wall(1.0)]
}

/// Points about evenly over a sphere.
fn ball(radius: f32, count: usize) -> Vec<Point3<f32>> {
    let point = |k: usize| {
        let z = 1.0 - (2 * k + 1) as f32 / count as f32;
        let (sine, cosine) = crate::math::sin_cos(k as f32 * 2.399_963);
        let across = (1.0 - z * z).sqrt();
        Point3::new(across * cosine * radius, across * sine * radius, z * radius)
    };
    (0..count).map(point).collect()
}

fn at(x: f32, y: f32, z: f32) -> Pose {
    Pose { centre: Vector3::new(x, y, z), ..Pose::default() }
}

fn random(state: &mut u32) -> f32 {
    *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    (*state >> 8) as f32 / (1 << 23) as f32 - 1.0
}

fn random_vector(state: &mut u32) -> Vector3<f32> {
    Vector3::new(random(state), random(state), random(state))
}

#[test]
fn a_step_of_code_ten_has_six_parts() {
    for (code, expected) in [(1.0, 1), (2.5, 2), (5.0, 3), (10.0, 6), (20.0, 12), (1e6, 16)] {
        assert_eq!(substeps(code / 240.0), expected, "{code}");
    }
}

#[test]
fn what_touches_nothing_falls_freely_to_the_bit() {
    let mut world = World::new(10.0 / 240.0);
    world.add(&cuboid(0.1, 0.1, 0.1), at(0.3, 0.2, 10.0));
    world.throw(0, Vector3::new(1.0, 2.0, 3.0), Vector3::new(1.0, -2.0, 0.5));
    let unit = world.slots[0];
    let row = world.solve()[0];
    let fall = world.scene(1).fall();
    assert_eq!((State::read(&row), row[STATE]), (unit.free(&fall), 0.0));
}

#[test]
fn driven_and_fixed_units_go_where_they_are_told() {
    let mut world = World::new(10.0 / 240.0);
    for x in [0.0, 0.25, 2.0] {
        world.add(&cuboid(0.1, 0.1, 0.1), at(x, 0.0, 0.1));
    }
    world.slots[0].role = Role::Driven;
    world.slots[2].role = Role::Fixed;
    for _ in 0..48 {
        world.slots[0].target.centre.x += 0.5 * world.dt;
        let (target, fixed) = (world.slots[0].target, world.slots[2].current);
        let rows = world.step();
        assert_eq!((read_pose(&rows[0]), rows[0][STATE]), (target, 0.0));
        assert_eq!(State::read(&rows[2]), State::at(fixed));
    }
    let centre = world.slots[1].current.centre;
    assert!((1.19..1.25).contains(&centre.x) && (centre.z - 0.1).abs() < 2e-3, "{centre}");
}

#[test]
fn a_box_observed_at_rest_comes_to_rest_and_stays_to_the_bit() {
    for dt in [1.0 / 240.0, 10.0 / 240.0] {
        let mut world = World::new(dt);
        world.add(&cuboid(0.1, 0.07, 0.05), at(0.7, -1.3, 0.05));
        let began = world.slots[0].current;
        let mut shares = Vec::new();
        for _ in 0..4 {
            shares.push(world.step()[0][STATE]);
        }
        assert_eq!(shares[3], -1.0, "{shares:?}");
        let bits = world.bits();
        for _ in 0..480 {
            assert_eq!(world.step()[0][STATE], -1.0);
            assert_eq!(world.bits(), bits);
        }
        let moved = world.slots[0].current.centre - began.centre;
        assert!(norm(&moved) < 1e-6, "{moved}");
    }
}

#[test]
fn five_boxes_stand_for_ten_seconds_and_are_still_in_the_end() {
    for (dt, aside) in [(1.0 / 240.0, 0.0), (10.0 / 240.0, 0.0), (10.0 / 240.0, 0.01)] {
        let mut world = World::new(dt);
        for k in 0..5 {
            let x = if k % 2 == 1 { aside } else { 0.0 };
            world.add(&cuboid(0.1, 0.1, 0.1), at(x, 0.0, 0.1 + 0.2 * k as f32));
        }
        let began: Vec<_> = world.slots.iter().map(|slot| slot.current.centre).collect();
        world.run(9.5);
        let bits = world.bits();
        world.run(0.5);
        assert_eq!(world.bits(), bits, "{dt} {aside}");
        for (slot, began) in world.slots.iter().zip(began) {
            let moved = slot.current.centre - began;
            assert!(norm(&moved) < 5e-4, "{dt} {aside}: {moved}");
        }
    }
}

/// On level ground, and down a slope at 5/7 of g sin a. 64 points are a polyhedron, which comes to lie on a face.
#[test]
fn a_ball_of_many_points_rolls_on() {
    for dt in [1.0 / 240.0, 10.0 / 240.0] {
        let mut world = World::new(dt);
        world.add(&ball(0.1, 160), at(0.0, 0.0, 0.1));
        world.add(&ball(0.1, 64), at(0.0, 1.0, 0.1));
        for number in 0..2 {
            world.throw(number, Vector3::new(0.3, 0.0, 0.0), Vector3::new(0.0, 3.0, 0.0));
        }
        world.run(5.0);
        let [way, stopped] = [0, 1].map(|number| world.slots[number].current.centre);
        assert!((way.x - 1.5).abs() < 0.01 && (way.z - 0.1).abs() < 1e-4, "{dt}: {way}");
        assert!(stopped.x < 0.5, "{dt}: {stopped}");

        let (sine, cosine) = crate::math::sin_cos(0.2);
        let mut world = World::new(dt);
        world.planes =
            vec![Plane { normal: Vector3::new(sine, 0.0, cosine), ..Plane::ground(1.0, 1.0) }];
        world.add(&ball(0.1, 160), at(0.1 * sine, 0.0, 0.1 * cosine));
        world.run(2.0);
        let down = world.slots[0].current.centre.x / cosine - 0.1 * sine / cosine;
        let expected = 0.5 * (5.0 / 7.0) * 9.81 * sine * 4.0;
        assert!((down / expected - 1.0).abs() < 0.05, "{dt}: {down} {expected}");
    }
}

#[test]
fn a_ball_lies_on_a_box_and_stops_at_a_ball() {
    let mut world = World::new(10.0 / 240.0);
    world.add(&ball(0.1, 160), at(0.02, 0.03, 0.31)).physics.restitution = 0.0;
    world.add(&cuboid(0.2, 0.2, 0.2), at(0.0, 0.0, 0.0)).role = Role::Fixed;
    world.add(&ball(0.1, 160), at(1.0, 0.0, 0.1)).role = Role::Fixed;
    world.add(&ball(0.1, 160), at(1.5, 0.0, 0.1)).physics.restitution = 0.0;
    world.throw(3, Vector3::new(-1.0, 0.0, 0.0), Vector3::new(0.0, -10.0, 0.0));
    world.run(0.5);
    let [lying, stopped] = [0, 3].map(|number| world.slots[number].current.centre);
    assert!(norm(&(lying - Vector3::new(0.02, 0.03, 0.3))) < 1e-3, "{lying}");
    assert!((1.199..1.25).contains(&stopped.x), "{stopped}");
}

/// Lengths times 4 and times times 2 are powers of two: no bit of any number but its exponent may change.
#[test]
fn four_times_as_large_is_twice_as_slow_to_the_bit() {
    let play = |length: f32, time: f32| {
        let mut world = World::new(time / 240.0);
        let (side, low) = (0.1 * length, 0.05 * length);
        for k in 0..5 {
            world.add(&cuboid(side, side, side), at(0.0, 0.0, side + 2.0 * side * k as f32));
        }
        let points: Vec<_> = ball(side, 64);
        world.add(&points, at(6.0 * side, 0.0, 3.0 * side));
        world.add(&cuboid(side, low, side), at(7.0 * side, side, 6.0 * side));
        let speed = length / time;
        world.throw(5, Vector3::new(-0.4, 0.1, 0.0) * speed, Vector3::new(0.2, 1.0, 0.3) / time);
        world.throw(6, Vector3::new(-0.8, 0.0, 0.5) * speed, Vector3::new(2.0, 0.1, 0.3) / time);
        (0..240)
            .map(|_| {
                world.step();
                let of = |slot: &UnitSlot| (slot.current.centre / length, slot.current.rotation);
                world.slots.iter().map(of).collect::<Vec<_>>()
            })
            .collect::<Vec<_>>()
    };
    // Both are one substep.
    for (step, (small, large)) in play(1.0, 0.5).iter().zip(&play(4.0, 1.0)).enumerate() {
        assert_eq!(small, large, "step {step}");
    }
}

/// One end of a rod meets smooth ground and stays there: of an impulse J at a lever a, J = m v / (1 + m a^2 / I) and
/// J a = I w.
#[test]
fn a_rod_turns_as_its_inertia_says() {
    let (mass, speed) = (2.5, 0.6);
    let physics = Physics { mass_kg: mass, friction: 0.0, restitution: 0.0 };
    // Across the rod: that of the box (0.0335), of a rod whose mass is at its ends, of one whose mass is in its middle.
    for moment in [None, Some(0.098), Some(0.004)] {
        let mut world = World::new(1.0 / 240.0);
        world.gravity = Vector3::zeros();
        let points = cuboid(0.2, 0.01, 0.01);
        let rotation = turned(&Matrix3::identity(), &Vector3::new(0.0, 0.3, 0.0));
        let lowest = points.iter().map(|p| rotation * p.coords);
        let end = lowest.min_by(|a, b| a.z.total_cmp(&b.z)).unwrap();
        let slot = world.add(&points, Pose { rotation, ..at(0.0, 0.0, -end.z) });
        let unit =
            Unit { inertia_kg_m2: moment.map(|across| [across; 3]), ..Unit::new(&points, physics) };
        assert!(unit.has_sound_inertia());
        (slot.physics, slot.mass) = (physics, mass);
        slot.inertia_m2 = inertia(&unit, &points, false, &Measure::SI);
        world.throw(0, Vector3::new(0.0, 0.0, -speed), Vector3::zeros());
        world.step();
        let slot = &world.slots[0];
        let spin = slot.course.turn() / world.dt;
        let (lever, across) = (end.x, moment.unwrap_or(mass * (0.16 + 4e-4) / 12.0));
        let impulse = mass * speed / (1.0 + mass * lever * lever / across);
        let expected = -lever * impulse / across;
        // About the rod itself it turns a little: its two corners are too close for the sweeps to tell which one bears it.
        assert!((spin.y / expected - 1.0).abs() < 0.01, "{moment:?}: {spin} {expected}");
        assert!(spin.x.abs() < 0.1 * spin.y.abs() && spin.z.abs() < 0.1 * spin.y.abs(), "{spin}");
    }
}

/// The slot has moments of a kilogram in the scene's measure.
#[test]
fn moments_are_kept_by_the_kilogram_and_in_the_scenes_length() {
    let points = cuboid(0.1, 0.1, 0.1);
    let physics = Physics { mass_kg: 0.5, friction: 0.5, restitution: 0.5 };
    let unit = Unit::new(&points, physics).inertia([4e-3, 3e-3, 1e-9]);
    let found = inertia(&unit, &points, false, &Measure::SI);
    assert_eq!(found, Vector3::new(8e-3, 6e-3, 1e-6), "the last one is the least that there is");
    let measure = Measure::new(0.25, 7.0);
    let square = measure.length() * measure.length();
    let found = inertia(&unit, &points, false, &measure);
    assert_eq!(found, Vector3::new(8e-3 / square, 6e-3 / square, 1e-6));
    // Units without any get that of the points, which are in that measure already.
    let plain = inertia(&Unit::new(&points, physics), &points, false, &measure);
    assert!((plain - Vector3::repeat(0.04 / 6.0)).amax() < 1e-8, "{plain}");
    for extreme in [1e-18, 1e18] {
        let light = Physics { mass_kg: if extreme > 1.0 { 1e-9 } else { 1e9 }, ..physics };
        let unit = Unit::new(&points, light).inertia([extreme; 3]);
        assert!(unit.has_sound_inertia());
        assert!(inertia(&unit, &points, false, &measure).iter().all(|moment| *moment >= 1e-6));
    }
}

#[test]
fn a_ramp_holds_below_the_angle_of_friction_and_not_above() {
    for dt in [1.0 / 240.0, 10.0 / 240.0] {
        for degrees in [24.0_f32, 29.0] {
            let (sine, cosine) = degrees.to_radians().sin_cos();
            let normal = Vector3::new(-sine, 0.0, cosine);
            let mut world = World::new(dt);
            world.planes = vec![Plane { normal, ..Plane::ground(1.0, 1.0) }];
            let turn = Vector3::new(0.0, -degrees.to_radians(), 0.0);
            let rotation = turned(&Matrix3::identity(), &turn);
            world.add(&cuboid(0.1, 0.1, 0.1), Pose { rotation, centre: normal * 0.1 });
            // Frames that lie still tell of a start with half of a step's fall.
            world.throw(0, Vector3::zeros(), Vector3::zeros());
            world.run(2.0);
            let way = norm(&(world.slots[0].current.centre - normal * 0.1));
            if degrees == 24.0 {
                assert!(way < 1e-5, "{way}");
                let bits = world.bits();
                world.run(1.0);
                assert_eq!(world.bits(), bits);
            } else {
                let expected = 0.5 * 9.81 * (sine - 0.5 * cosine) * 4.0;
                assert!((way - expected).abs() < 0.05 * expected, "{dt}: {way} {expected}");
            }
        }
    }
}

#[test]
fn boxes_in_the_air_keep_their_momentum() {
    let mut state = 5;
    for _ in 0..50 {
        let mut world = World::new(10.0 / 240.0);
        (world.gravity, world.planes) = (Vector3::zeros(), Vec::new());
        for (unit, x) in [(0, -0.4), (1, 0.4)] {
            let turn = random_vector(&mut state) * 2.0;
            let pose = Pose { rotation: turned(&Matrix3::identity(), &turn), ..at(x, 0.0, 0.0) };
            world.add(&cuboid(0.1, 0.1, 0.1), pose).physics.restitution = 0.9;
            let velocity = Vector3::new(-2.5 * x, 0.05 * random(&mut state), 0.0);
            world.throw(unit, velocity, random_vector(&mut state));
        }
        let momentum = |world: &World| {
            let way = |slot: &UnitSlot| slot.course.way;
            world.slots.iter().map(way).sum::<Vector3<f32>>() / world.dt
        };
        let (before, mut met) = (momentum(&world), false);
        for _ in 0..24 {
            met |= world.step()[0][STATE] > 0.0 || world.slots[0].current.centre.x > -0.2;
        }
        assert!(met);
        assert!(norm(&(momentum(&world) - before)) < 1e-4, "{}", momentum(&world) - before);
        let apart = world.slots[1].current.centre - world.slots[0].current.centre;
        assert!(apart.x > 0.15, "{apart}");
    }
}

/// Whatever overlaps whatever: numbers stay finite, and nothing leaps.
#[test]
fn overlaps_of_any_depth_stay_bounded() {
    let mut state = 77;
    for round in 0..10_000 {
        let mut world = World::new([1.0, 5.0, 10.0][round % 3] / 240.0);
        let count = 2 + round % 3;
        let spread = [0.0, 0.05, 0.2][round / 3 % 3];
        for unit in 0..count {
            let points = match (round + unit) % 3 {
                0 => ball(0.1, 64),
                1 => cuboid(0.1, 0.1, 0.1),
                _ => cuboid(0.12, 0.03, 0.06),
            };
            let turn = random_vector(&mut state) * if round % 5 == 0 { 0.0 } else { 3.0 };
            let centre = random_vector(&mut state) * spread + Vector3::z() * 0.1;
            let pose = Pose { rotation: turned(&Matrix3::identity(), &turn), centre };
            world.add(&points, pose);
            world.throw(unit, random_vector(&mut state), random_vector(&mut state) * 5.0);
        }
        for _ in 0..3 {
            let before: Vec<_> = world.slots.iter().map(|slot| slot.current.centre).collect();
            let rows = world.step();
            assert!(rows.as_flattened().iter().all(|number| number.is_finite()), "{round}");
            for ((slot, before), row) in world.slots.iter().zip(before).zip(&rows) {
                let moved = norm(&(slot.current.centre - before));
                assert!(moved < 0.5, "{round}: {moved}");
                assert!((-1.0..1e3).contains(&row[STATE]));
                let square = slot.current.rotation * slot.current.rotation.transpose();
                assert!((square - Matrix3::identity()).amax() < 1e-5, "{round}: {square}");
            }
        }
    }
}

/// What the stacks stand on: normals of faces that lie on each other.
#[test]
fn normals_of_nearly_parallel_boxes_are_right() {
    let mut state = 3;
    let points = cuboid(0.1, 0.1, 0.1);
    let radius = 0.1 * 3.0_f32.sqrt();
    let mut worst = 0.0_f32;
    for _ in 0..20_000 {
        let whole = turned(&Matrix3::identity(), &(random_vector(&mut state) * 3.0));
        let tilt = turned(&Matrix3::identity(), &(random_vector(&mut state) * 1e-4));
        let yaw = turned(&Matrix3::identity(), &Vector3::new(0.0, 0.0, random(&mut state)));
        let lower = Hull { points: &points, rotation: whole };
        let upper = Hull { points: &points, rotation: product(&whole, &product(&tilt, &yaw)) };
        // At the gap that units keep.
        let local = Vector3::new(
            0.05 * random(&mut state),
            0.05 * random(&mut state),
            0.2 + 0.002 * radius,
        );
        let apart = whole * local;
        let precision = Precision::fine(2.0 * radius);
        let found = separation([&lower, &upper], &-apart, &-apart, &precision).unwrap();
        let up = whole.column(2).into_owned();
        worst = worst.max(norm(&found.normal.cross(&up)));
        assert!((found.distance - 0.002 * radius).abs() < 4e-5, "{found:?}");
    }
    // 1e-4 rad of it are the tilt; but for one of 200,000 the rest is little more.
    assert!(worst < 5e-3, "{worst} rad");
}

#[test]
fn copies_do_not_know_of_each_other() {
    if !cfg!(rigidformer_host) {
        return;
    }
    let mut world = World::new(10.0 / 240.0);
    for copy in 0..2 {
        for k in 0..3 {
            world.add(&cuboid(0.1, 0.1, 0.1), at(0.01 * k as f32, 0.0, 0.1 + 0.19 * k as f32));
            if copy == 1 {
                let (slot, first) = (3 + k, world.slots[k]);
                world.slots[slot] = first;
            }
        }
    }
    let (mut scratch, mut prior) =
        (vec![0.0; 3 * super::scratch(3)], [vec![0.0; 3 * PRIOR], vec![0.0; 3 * PRIOR]]);
    for (copy, prior) in prior.iter_mut().enumerate() {
        solve(Serial(Portable), &world.scene(2), 3 * copy, (&mut scratch, prior));
    }
    assert_eq!(prior[0], prior[1]);
    assert_ne!(State::read(&prior[0]).course, world.slots[0].course, "it touches the ground");
}

/// A small box falls to the ground between the walls of a table, and a large one comes to rest on the table's plate. To a
/// hull of all points there is no room under the table.
#[test]
fn what_is_under_a_table_does_not_touch_it() {
    for in_pieces in [true, false] {
        let mut world = World::new(1.0 / 240.0);
        let table = table(0.3, 0.2, 0.2);
        if in_pieces {
            world.add_pieces(&table, at(0.0, 0.0, 0.2));
        } else {
            world.add(&table.concat(), at(0.0, 0.0, 0.2));
        }
        world.add(&cuboid(0.05, 0.05, 0.05), at(0.0, 0.0, 0.12));
        world.add(&cuboid(0.1, 0.1, 0.1), at(0.0, 0.0, 0.51));
        world.run(2.0);
        let [legs, under, above] = [0, 1, 2].map(|unit| world.slots[unit].current.centre);
        let stands = norm(&(legs - Vector3::new(0.0, 0.0, 0.2))) < 5e-3;
        let lies = (under.z - 0.05).abs() < 2e-3;
        assert_eq!(stands && lies, in_pieces, "{legs} {under}");
        if in_pieces {
            assert!((above.z - 0.5).abs() < 3e-3, "{above}");
            let bits = world.bits();
            world.run(0.5);
            assert_eq!(world.bits(), bits, "what rests stays");
        }
    }
}

/// Single steps of scenes that fell onto each other, from `rigidformer_lab.solver_cases`.
#[test]
fn steps_are_those_of_the_lab() {
    check_against_the_lab(include_str!("cases.txt"), |_, _| ());
}

/// As [`steps_are_those_of_the_lab`], of thrown units with a contact law, which changes each scene.
#[test]
fn steps_with_a_contact_law_are_those_of_the_lab() {
    let law = ContactLaw { restitution_offset: 0.05, friction: FrictionLimit::Pyramid };
    check_against_the_lab(include_str!("law.txt"), |world, _| world.contact_law = law);
}

/// Of a drop: the offset adds to the restitution, up to 1, and what gains energy by its own coefficients goes on to.
#[test]
fn an_offset_adds_to_the_restitution() {
    let speed_after = |restitution: f32, restitution_offset: f32| {
        let mut world = World::new(1.0 / 240.0);
        world.gravity = Vector3::new(0.0, 0.0, -1e-3);
        world.contact_law = ContactLaw { restitution_offset, ..ContactLaw::RIGID };
        world.add(&ball(0.1, 160), at(0.0, 0.0, 0.11)).physics.restitution = restitution;
        world.throw(0, Vector3::new(0.0, 0.0, -1.0), Vector3::zeros());
        world.run(0.1);
        let [velocity, _] = world.motion(0);
        velocity.z
    };
    for (restitution, offset, expected) in
        [(0.3, 0.0, 0.3), (0.3, 0.05, 0.35), (0.0, 0.05, 0.05), (0.98, 0.05, 1.0), (1.2, 0.05, 1.2)]
    {
        let speed = speed_after(restitution, offset);
        assert!((speed - expected).abs() < 2e-3, "{restitution} + {offset}: {speed}");
    }
}

/// `bond` is told the rows of a scene's units.
fn check_against_the_lab(cases: &str, bond: impl Fn(&mut World, &[Vec<f32>])) {
    let cases: Vec<Vec<f32>> = cases
        .lines()
        .map(|line| line.split(' ').map(|number| number.parse().unwrap()).collect())
        .collect();
    let vector = |row: &[f32], place: usize| Vector3::from_column_slice(&row[place..place + 3]);
    for (end, code) in [(19, 1.0), (26, 5.0), (33, 10.0)] {
        for units in cases.chunk_by(|a, b| a[0] == b[0]) {
            let mut world = World::new(code / 240.0);
            for (number, row) in units.iter().enumerate() {
                let rotation = turned(&Matrix3::identity(), &vector(row, 7));
                let pose = Pose { rotation, centre: vector(row, 10) };
                let unit = match vector(row, 1) {
                    size if size.y > 0.0 => world.add(&cuboid(size.x, size.y, size.z), pose),
                    size if size.y < 0.0 => world.add_pieces(&table(size.x, -size.y, size.z), pose),
                    size => world.add(&ball(size.x, if size.z > 0.0 { 160 } else { 64 }), pose),
                };
                unit.mass = row[4];
                unit.physics = Physics { mass_kg: row[4], friction: row[5], restitution: row[6] };
                world.throw(number, vector(row, 13), vector(row, 16));
            }
            bond(&mut world, units);
            for (number, (row, found)) in units.iter().zip(world.solve()).enumerate() {
                let name = format!("scene {}, unit {number}, code {code}", row[0]);
                let pose = read_pose(&found);
                let away = norm(&(pose.centre - vector(row, end)));
                let rotation = turned(&Matrix3::identity(), &vector(row, end + 3));
                let turn = norm(&turn_between(&rotation, &pose.rotation));
                let share = found[STATE] - row[end + 6];
                assert!(away < 1e-4 && turn < 1e-3, "{name}: {away} m, {turn} rad");
                assert!(share.abs() * world.dt < 1e-4, "{name}: {share}"); // a way too, in a step
            }
        }
    }
}

/// `cargo test --release -p rigidformer-core solver -- --ignored --nocapture`
#[test]
#[ignore = "a measurement"]
fn how_long_ten_touching_balls_take() {
    for (name, points) in [("balls", ball(0.1, 64)), ("boxes", cuboid(0.1, 0.1, 0.1))] {
        for code in [1.0, 5.0, 10.0] {
            let mut world = World::new(code / 240.0);
            for k in 0..10 {
                let (layer, place) = (k / 4, k % 4);
                let (x, y) = ((place % 2) as f32 * 0.199, (place / 2) as f32 * 0.199);
                world.add(&points, at(x, y, 0.1 + 0.195 * layer as f32));
            }
            let round = |_| {
                let began = std::time::Instant::now();
                world.solve();
                began.elapsed().as_secs_f64() * 1e6
            };
            let least = (0..1000).map(round).fold(f64::INFINITY, f64::min);
            std::println!("ten {name}, {} substeps: {least:.0} us a step", substeps(world.dt));
        }
    }
}

/// Where units go that a step takes there, after `moved` has changed it.
fn kept_apart(world: &mut World, moved: impl Fn(&mut [[f32; STATE]])) -> Vec<[f32; STATE]> {
    let rows = world.solve();
    let mut next: Vec<_> = rows.iter().map(|row| *row.first_chunk().unwrap()).collect();
    moved(&mut next);
    let mut scratch = core::mem::take(&mut world.scratch);
    keep_apart(&world.scene(1), 0, &mut scratch, next.as_flattened_mut());
    world.scratch = scratch;
    next
}

/// What a correction has moved into each other leaves, the lighter one farther, and nothing else changes.
#[test]
fn corrected_units_do_not_overlap() {
    let mut world = World::new(1.0 / 240.0);
    world.add(&cuboid(0.1, 0.1, 0.1), at(0.0, 0.0, 1.0)).mass = 3.0;
    world.add(&cuboid(0.1, 0.1, 0.1), at(0.201, 0.05, 1.0));
    world.add(&cuboid(0.1, 0.1, 0.1), at(2.0, 0.0, 1.0));
    let corrected = |next: &mut [[f32; STATE]]| {
        next[1][9] -= 0.021;
    };
    let free = kept_apart(&mut world, |_| ());
    let next = kept_apart(&mut world, corrected);
    // Centres are the last three numbers of a pose.
    let way = |unit: usize, number: usize| next[unit][number] - free[unit][number];
    assert!((way(0, 9) + 0.005).abs() < 1e-4, "{}", way(0, 9));
    assert!((way(1, 9) + 0.021 - 0.015).abs() < 1e-4, "{}", way(1, 9));
    for unit in 0..2 {
        let [moved, freely] = [&next, &free].map(|rows| State::read(&rows[unit]).course);
        assert_eq!((moved.way, moved.turn()), (freely.way, freely.turn()), "no velocity");
    }
    assert_eq!((next[0][10], next[1][11]), (free[0][10], free[1][11]));
    assert_eq!(next[2], free[2]);
}

/// From the ground upwards: a pile that is pressed together stands on it again, and what lies beside stays.
#[test]
fn overlaps_leave_upwards() {
    let mut world = World::new(5.0 / 240.0);
    for k in 0..3 {
        world.add(&cuboid(0.1, 0.1, 0.1), at(0.0, 0.0, 0.1 + 0.2 * k as f32));
    }
    let next = kept_apart(&mut world, |next| {
        next[1][11] -= 0.03;
        next[2][11] -= 0.04;
    });
    let heights = [0, 1, 2].map(|unit: usize| next[unit][11]);
    for (height, expected) in heights.into_iter().zip([0.1, 0.3, 0.5]) {
        assert!((height - expected).abs() < 2e-4, "{heights:?}");
    }
}

/// A pile at rest, and one that stands in itself by less than what stays: not a bit changes.
#[test]
fn what_rests_is_not_kept_apart() {
    let mut world = World::new(10.0 / 240.0);
    for k in 0..4 {
        world.add(&cuboid(0.1, 0.07, 0.05), at(0.002 * k as f32, 0.0, 0.05 + 0.09999 * k as f32));
    }
    world.run(2.0);
    let rows = world.solve();
    let next = kept_apart(&mut world, |_| ());
    for (row, next) in rows.iter().zip(&next) {
        assert_eq!(row[STATE], -1.0);
        assert_eq!(row[..STATE], next[..]);
    }
}

/// Whatever is moved wherever: poses stay finite and out of the ground, and rotations as they are.
#[test]
fn keeping_apart_is_bounded() {
    let mut state = 5;
    for round in 0..2_000 {
        let mut world = World::new([1.0, 5.0, 10.0][round % 3] / 240.0);
        for unit in 0..2 + round % 4 {
            let points =
                if (round + unit) % 2 == 0 { ball(0.1, 64) } else { cuboid(0.12, 0.03, 0.06) };
            let turn = random_vector(&mut state) * 3.0;
            let pose =
                Pose { rotation: turned(&Matrix3::identity(), &turn), centre: Vector3::zeros() };
            world.add(&points, pose).current.centre =
                random_vector(&mut state) * 0.15 + Vector3::z() * 0.3;
            world.throw(unit, random_vector(&mut state), random_vector(&mut state) * 5.0);
        }
        let ways: Vec<_> = world.slots.iter().map(|_| random_vector(&mut state) * 0.1).collect();
        let mut before = Vec::new();
        let next = kept_apart(&mut world, |next| {
            for (row, way) in next.iter_mut().zip(&ways) {
                for (number, way) in row[9..12].iter_mut().zip(way.iter()) {
                    *number += way;
                }
            }
        });
        before.extend(kept_apart(&mut world, |_| ()));
        for (next, before) in next.iter().zip(&before) {
            assert!(next.iter().all(|number| number.is_finite()), "{round}");
            assert_eq!(next[..9], before[..9], "{round}");
            let way =
                Vector3::from_row_slice(&next[9..12]) - Vector3::from_row_slice(&before[9..12]);
            assert!(norm(&way) < 1.5, "{round}: {way}");
        }
    }
}

/// Balls that are shot at heaps fly past and into units that fly alone: those are left out of substeps, or were wrongly, and no bit says
/// which.
#[cfg(rigidformer_host)]
#[test]
fn what_flies_alone_is_left_out() {
    let corner = |i: i32, bit: i32| if i & bit == 0 { -0.1 } else { 0.1 };
    let cube: Vec<_> =
        (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
    let mut state = 7_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    let (mut left_out, mut wrong) = (0, 0);
    for scene in 0..40 {
        let mut world = World::new(1.0 / 24.0);
        let far = if scene % 8 == 7 { 2e4 } else { 0.0 };
        for number in 0..14 {
            let pile = number < 5;
            let centre = match pile {
                true => Vector3::new(0.21 * number as f32, 0.05 * random(), 0.1 + 0.02 * random()),
                false => Vector3::new(1.6 * random(), 1.6 * random(), 1.2 + random()),
            };
            let centre = centre + Vector3::new(far, 0.0, 0.0);
            let turn = Vector3::new(random(), random(), random());
            let rotation = turned(&Matrix3::identity(), &(turn * if pile { 0.05 } else { 1.0 }));
            let unit = world.add(&cube, Pose { rotation, centre });
            let is_shot = (5..8).contains(&number);
            let speed = if is_shot { 0.8 } else { 0.04 };
            let way = Vector3::new(random(), random(), random()) * speed;
            unit.course = unit.course.moving(way, Vector3::zeros());
            unit.mass = if is_shot { 50.0 } else { 0.3 };
        }
        for _ in 0..12 {
            // Compares the bits.
            world.step();
            let count = world.slots.len();
            let (mut scratch, mut prior) =
                (core::mem::take(&mut world.scratch), core::mem::take(&mut world.prior));
            let scene = world.scene(1);
            let own_world = bodies::World::new(&scene, 0, substeps(scene.dt));
            let (mut bodies, mut contacts, mut trees) =
                carve(&mut scratch, &mut prior, own_world.units);
            let right = in_substeps(
                Serial(Portable),
                &own_world,
                (&mut bodies, &mut contacts, &mut trees),
                true,
            );
            wrong += usize::from(!right);
            left_out += (0..count).filter(|unit| bodies.is_left_out(*unit)).count();
            (world.scratch, world.prior) = (scratch, prior);
        }
    }
    assert!(left_out > 500 && wrong > 5, "{left_out} left out, {wrong} steps where that was wrong");
}

/// 48 boxes and balls fall onto each other, one of them driven and one fixed; the bits of all steps, and how many numbers of blocks were
/// written.
#[cfg(rigidformer_host)]
fn heap_bits(dt: f32, missing: usize, contact_law: ContactLaw) -> (Vec<u32>, usize) {
    let mut world = World { missing, contact_law, ..World::new(dt) };
    let (cube, sphere, mut state) = (cuboid(0.1, 0.1, 0.1), ball(0.06, 40), 7);
    for number in 0..48 {
        let [x, y, z] = [number % 4, number / 4 % 3, number / 12].map(|n| n as f32 * 0.13);
        let pose = at(x + 0.02 * random(&mut state), y + 0.02 * random(&mut state), z + 0.08);
        let points = if number % 5 == 0 { &sphere } else { &cube };
        let slot = world.add(points, pose);
        slot.role = match number {
            13 => Role::Driven,
            2 => Role::Fixed,
            _ => Role::Free,
        };
        if number == 13 {
            slot.target.centre.x += 0.02;
        }
        let (way, spin) = (random_vector(&mut state), random_vector(&mut state) * 4.0);
        if slot.role == Role::Free {
            world.throw(number, way, spin);
        }
    }
    let mut bits = Vec::new();
    for _ in 0..12 {
        bits.extend(world.solve().as_flattened().iter().map(|number| number.to_bits()));
        world.step();
    }
    let blocks = world.scratch.get(48 * (super::scratch(48) + super::extra(1))..);
    let written = blocks.unwrap_or_default().iter().filter(|number| !number.is_nan());
    (bits, written.count())
}

#[test]
#[cfg(rigidformer_host)]
fn sweeps_over_blocks_and_boxes_of_units_change_no_bit() {
    let law = ContactLaw { restitution_offset: 0.05, friction: FrictionLimit::Pyramid };
    assert!(heap_bits(1.0 / 240.0, 0, law).0 != heap_bits(1.0 / 240.0, 0, ContactLaw::RIGID).0);
    for (dt, law) in
        [(1.0 / 240.0, ContactLaw::RIGID), (1.0 / 24.0, ContactLaw::RIGID), (1.0 / 24.0, law)]
    {
        let (bits, written) = heap_bits(dt, 0, law);
        assert!(written > 0, "there were blocks");
        // Without room for blocks, and without that for balls and boxes too, which are of all pairs then.
        for missing in [super::wide::NUMBERS, super::extra(48)] {
            assert!(
                heap_bits(dt, missing, law).0 == bits,
                "steps of {dt} s without {missing} numbers"
            );
        }
    }
}
