//! Against brute force: the same unit and the same point, whatever the scene.

use super::layout::{NO_PLANE, WIDTH};
use super::search::of_any;
use super::{Index, Parts, ROW, Room};
use crate::contact::ground::Plane;
use crate::geometry::{Nearest, Pose, dot, radius};
use crate::kernels::{Kernels, Portable};
use crate::network::nearest::{Search, Target};
use nalgebra::{Matrix3, Point3, Vector3};
use std::vec;
use std::vec::Vec;

pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn bits(&mut self) -> usize {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize
    }

    /// In [-1, 1).
    pub(super) fn uniform(&mut self) -> f32 {
        self.bits() as f32 / (1 << 30) as f32 - 1.0
    }

    pub(super) fn vector(&mut self) -> Vector3<f32> {
        Vector3::new(self.uniform(), self.uniform(), self.uniform())
    }

    /// A rotation, as good as f32 has it.
    pub(super) fn rotation(&mut self) -> Matrix3<f32> {
        let (x, y) = (self.vector(), self.vector());
        let x = x / dot(&x, &x).sqrt().max(0.01);
        let y = y - x * dot(&x, &y);
        let y = y / dot(&y, &y).sqrt().max(0.01);
        let y = y - x * dot(&x, &y);
        Matrix3::from_columns(&[x, y, x.cross(&y)])
    }
}

/// Units and their poses, of one copy after the other.
pub(super) struct Scene {
    pub(super) units: Vec<Vec<Point3<f32>>>,
    pub(super) poses: Vec<Pose>,
    pub(super) planes: Vec<Plane>,
    /// Of each unit, 0 for one of its own.
    pub(super) bodies: Vec<u32>,
}

impl Scene {
    pub(super) fn index(&self, slab: &mut Vec<f32>) -> Room {
        let copies = self.poses.len() / self.units.len();
        let points = self.units.iter().map(Vec::len).sum();
        let room = Room { units: self.units.len(), points, copies };
        *slab = vec![f32::NAN; points + room.numbers()];
        let mut first = 0;
        for (i, unit) in self.units.iter().enumerate() {
            Parts::new(slab, &room).add(i, first, unit);
            first += unit.len();
        }
        self.place(slab, &room);
        room
    }

    fn body(&self, unit: usize) -> u32 {
        self.bodies.get(unit % self.units.len()).copied().unwrap_or(0)
    }

    pub(super) fn place(&self, slab: &mut [f32], room: &Room) {
        let radii = self.units.iter().map(|unit| radius(unit)).cycle();
        let units = self.poses.iter().zip(radii).enumerate();
        let placed = units.map(|(unit, (pose, radius))| (pose, radius, self.body(unit)));
        Parts::new(slab, room).place(self.units.len(), placed);
    }

    /// All points of all other units of the copy.
    pub(super) fn brute(&self, own: usize, query: &Vector3<f32>) -> Nearest {
        let per_copy = self.units.len();
        let first = own / per_copy * per_copy;
        let target = |unit: usize| {
            let (pose, points) = (self.poses.get(unit)?, self.units.get(unit % per_copy)?);
            Some(Target { pose, points, radius: 1e9 })
        };
        let mut search = Search::new(*query, &self.planes);
        let body = self.body(own);
        let of_body = |unit: &usize| body != 0 && self.body(*unit) == body;
        let others = (first..first + per_copy).filter(|unit| *unit != own && !of_body(unit));
        for unit in others {
            search.visit(Portable, unit, &target(unit).unwrap());
        }
        search.nearest(Portable, target)
    }

    /// The whole search, for the points of all units.
    pub(super) fn search(&self, slab: &mut [f32], room: &Room) {
        let (index, answers) = Parts::new(slab, room).search(self.units.len(), &self.planes);
        let answers = &mut answers[..index.rows(room.copies) * ROW];
        for (row, out) in answers.chunks_mut(ROW).enumerate() {
            Portable.nearest_of_leaf(&index, row, out);
        }
    }

    fn compare(&self, own: usize, query: &Vector3<f32>, found: Nearest) {
        assert_eq!(found, self.brute(own, query), "unit {own}, {query}");
        // Of points at one place, the first.
        if let Nearest::Point { unit, point: i } = found {
            let (points, pose) = (&self.units[unit % self.units.len()], &self.poses[unit]);
            let local = pose.local(query);
            let square = |p: &Point3<f32>| dot(&(p.coords - local), &(p.coords - local));
            assert_eq!(Portable.first_at(points, pose, query, 0, square(&points[i])), i);
        }
    }

    /// Points of all units, as a step asks for them.
    fn check_points(&self) {
        let mut slab = Vec::new();
        let room = self.index(&mut slab);
        self.search(&mut slab, &room);
        let answers = Parts::new(&mut slab, &room).answers(self.units.len());
        for (own, pose) in self.poses.iter().enumerate() {
            let unit = own % self.units.len();
            let first: usize = self.units[..unit].iter().map(Vec::len).sum();
            for (i, point) in self.units[unit].iter().enumerate() {
                self.compare(own, &pose.apply(&point.coords), answers.nearest(own, first + i));
            }
        }
    }

    fn check_queries(&self, index: &Index<'_>, own: usize, queries: &[Vector3<f32>; WIDTH]) {
        let lines = [0, 1, 2].map(|axis| queries.map(|query| query[axis]));
        let [units, numbers] = of_any(index, own, &lines);
        for ((query, unit), number) in queries.iter().zip(units).zip(numbers) {
            let copy = own / self.units.len() * self.units.len();
            let found = match ((unit.to_bits() as usize).checked_sub(1), number.to_bits()) {
                (Some(unit), number) => {
                    Nearest::Point { unit: copy + unit, point: number as usize }
                }
                (None, NO_PLANE) => Nearest::Nothing,
                (None, number) => Nearest::Plane(number as usize),
            };
            self.compare(own, query, found);
        }
    }

    /// Queries at points of every unit, on points of others, and anywhere.
    fn check(&self, random: &mut Random, rounds: usize) {
        self.check_points();
        let mut slab = Vec::new();
        let room = self.index(&mut slab);
        let (index, _) = Parts::new(&mut slab, &room).search(self.units.len(), &self.planes);
        for _ in 0..rounds {
            let own = random.bits() % self.poses.len();
            let queries = core::array::from_fn(|lane| {
                let other = random.bits() % self.poses.len();
                let points = &self.units[other % self.units.len()];
                let point = points[random.bits() % points.len()].coords;
                let far = 10.0_f32.powi((random.bits() % 6) as i32);
                match lane % 4 {
                    0 => self.poses[other].apply(&point),
                    1 => self.poses[other].apply(&(point * 1.01)),
                    2 => self.poses[own].apply(&point),
                    _ => random.vector() * far,
                }
            });
            self.check_queries(&index, own, &queries);
        }
    }
}

/// Points of a unit of a kind.
fn unit(random: &mut Random, kind: usize, count: usize) -> Vec<Point3<f32>> {
    let size = [0.02, 0.5, 0.5, 3.0][random.bits() % 4];
    let grid = |v: f32| (v * 3.0).round() * 0.125;
    (0..count)
        .map(|i| {
            let v = random.vector();
            Point3::from(match kind {
                // Anywhere, on a surface, on a grid with many ties and repeats.
                0 => v * size,
                1 => v / dot(&v, &v).sqrt().max(0.01) * size,
                2 => v.map(grid),
                // Flat, a line, a line with repeats, and two places alone.
                3 => Vector3::new(v.x, v.y, 0.0) * size,
                4 => Vector3::new(v.x, v.x, v.x) * size,
                5 => Vector3::new(0.0, grid(v.x), 0.0),
                _ => Vector3::new(0.0, 0.0, if i % 2 == 0 { 0.0 } else { 0.25 }),
            })
        })
        .collect()
}

/// None, the ground, or a few anywhere.
fn planes(random: &mut Random) -> Vec<Plane> {
    let anywhere = |random: &mut Random| Plane {
        normal: random.rotation().column(0).into(),
        offset_m: random.uniform() * 2.0,
        friction: 0.5,
        restitution: 0.5,
    };
    match random.bits() % 4 {
        0 => vec![],
        1 => (0..random.bits() % 4).map(|_| anywhere(random)).collect(),
        _ => vec![Plane::ground(0.3, 0.5)],
    }
}

fn scene(random: &mut Random, units: usize, most: usize, copies: usize) -> Scene {
    let aligned = random.bits().is_multiple_of(3);
    let apart = [0.0, 0.3, 1.0, 4.0, 1e4][random.bits() % 5];
    let mut shapes: Vec<Vec<Point3<f32>>> = Vec::new();
    for _ in 0..units {
        // Some are the one before, so that whole units tie.
        let again = shapes.last().filter(|_| random.bits().is_multiple_of(4)).cloned();
        let (kind, count) = (random.bits() % 7, 4 + random.bits() % most);
        shapes.push(again.unwrap_or_else(|| unit(random, kind, count)));
    }
    let poses = (0..units * copies).map(|_| {
        let rotation = if aligned { Matrix3::identity() } else { random.rotation() };
        let v = random.vector() * apart + Vector3::z() * (apart * 0.9);
        let centre = if aligned { v.map(|v| (v * 4.0).round() * 0.25) } else { v };
        Pose { rotation, centre }
    });
    let poses = poses.collect();
    let bodies = (0..units).map(|_| (random.bits() % 4) as u32 * (random.bits() % 2) as u32);
    let bodies = bodies.collect();
    Scene { poses, units: shapes, planes: planes(random), bodies }
}

#[test]
fn equals_brute_force() {
    let mut random = Random(1);
    for round in 0..3000 {
        let (units, copies) = (1 + random.bits() % 12, 1 + random.bits() % 3);
        let most = [4, WIDTH, 40, 300][round % 4];
        scene(&mut random, units, most, copies).check(&mut random, 4);
    }
}

#[test]
fn large_units_and_many_units() {
    let mut random = Random(2);
    for (units, most, rounds) in [(3, 1200, 60), (2, 9000, 6), (70, 20, 60), (217, 5, 10)] {
        for _ in 0..rounds {
            scene(&mut random, units, most, 2).check(&mut random, 10);
        }
    }
}

/// What one point more changes, about every size at which a tree gains a leaf, a node or a root.
#[test]
fn every_size_of_unit() {
    let mut random = Random(3);
    let edges = [WIDTH, 2 * WIDTH, WIDTH * WIDTH, 2 * WIDTH * WIDTH, 4096, 4096 + 256];
    for count in (4..80).chain(edges.iter().flat_map(|edge| edge - 1..edge + 3)) {
        for kind in 0..7 {
            let units = vec![unit(&mut random, kind, count), unit(&mut random, kind, count)];
            let poses = (0..2).map(|_| Pose {
                rotation: random.rotation(),
                centre: random.vector() * 0.2 + Vector3::z() * 5.0,
            });
            let poses = poses.collect();
            let planes = planes(&mut random);
            Scene { units, poses, planes, bodies: vec![] }.check(&mut random, 2);
        }
    }
}

/// Units in the same place, of the same points: the lowest unit, then the first point.
#[test]
fn coincident_units_tie() {
    let mut random = Random(4);
    let points = unit(&mut random, 2, 100);
    let rotation = random.rotation();
    let pose = Pose { rotation, centre: Vector3::new(0.3, -0.2, 3.0) };
    let planes = vec![Plane::ground(0.3, 0.5)];
    let scene = Scene { units: vec![points; 40], poses: vec![pose; 40], planes, bodies: vec![] };
    scene.check(&mut random, 50);
    let mut slab = Vec::new();
    let room = scene.index(&mut slab);
    let (index, _) = Parts::new(&mut slab, &room).search(40, &scene.planes);
    let query = pose.apply(&Vector3::new(0.01, 0.0, 0.0));
    let lines = [0, 1, 2].map(|axis| [query[axis]; WIDTH]);
    assert!(of_any(&index, 0, &lines)[0].iter().all(|unit| unit.to_bits() == 2));
    assert!(of_any(&index, 39, &lines)[0].iter().all(|unit| unit.to_bits() == 1));
}

/// Units that moved: the tree is kept, the boxes are not. Rotations that are none are not culled.
#[test]
fn places_again() {
    let mut random = Random(5);
    for round in 0..200 {
        let mut scene = scene(&mut random, 9, 60, 2);
        let mut slab = Vec::new();
        let room = scene.index(&mut slab);
        for pose in &mut scene.poses {
            let skew = [0.0, 1e-6, 1e-3, 0.5][round % 4];
            pose.rotation = random.rotation() + Matrix3::from_element(skew);
            pose.centre += random.vector();
        }
        scene.place(&mut slab, &room);
        let (index, _) = Parts::new(&mut slab, &room).search(9, &scene.planes);
        for own in 0..18 {
            let queries = [0; WIDTH].map(|_| scene.poses[own].apply(&(random.vector() * 2.0)));
            scene.check_queries(&index, own, &queries);
        }
    }
}

/// The room is enough for any division of the points among the units.
#[test]
fn room_is_enough() {
    let mut random = Random(6);
    for _ in 0..300_000 {
        let sizes: Vec<usize> = (0..1 + random.bits() % 8)
            .map(|_| 4 + random.bits() % [10, 20, 300, 5000][random.bits() % 4])
            .collect();
        let room = Room { units: sizes.len(), points: sizes.iter().sum(), copies: 1 };
        let lines: usize = sizes.iter().map(|n| super::tree::Shape::new(*n).lines()).sum();
        assert!(lines <= room.lines(), "{sizes:?}");
    }
    let none = Room { units: 0, points: 0, copies: 1 };
    assert_eq!(none.numbers(), 0);
}
