//! Models that measure scenes in their own length, mass and time: the same motion at any size.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::{
    EditError, ObserveError, Physics, Plane, Posed, Role, SHORTEST_STEP_S, Simulator, Unit,
};
use rigidformer_tests::{
    Golden, isometry, packed_model, pose_difference, poses, with_similarity, with_simulator,
};
use rigidformer_weights::{AlignedBuffer, Similarity};

const STEPS: usize = 20;
const POINTS: usize = 2048;
/// About the typical radius of the scene below, so that models do there what they were made for.
const SIMILAR: Similarity = Similarity { length_m: 0.25, longest_step: 0.0 };

/// What a scene is multiplied by.
#[derive(Clone, Copy)]
struct Scale {
    length: f32,
    time: f32,
    mass: f32,
}

const AS_IT_IS: Scale = Scale { length: 1.0, time: 1.0, mass: 1.0 };

impl Scale {
    fn pose(&self, pose: &Isometry3<f32>) -> Isometry3<f32> {
        Isometry3::from_parts((pose.translation.vector * self.length).into(), pose.rotation)
    }

    fn points(&self, points: &[Point3<f32>]) -> Vec<Point3<f32>> {
        points.iter().map(|point| point * self.length).collect()
    }
}

/// The scene of tiny-roles: units of all roles, bodies, three planes, an oblique gravity.
struct Scene {
    points: Vec<Vec<Point3<f32>>>,
    physics: Vec<Physics>,
    roles: Vec<Role>,
    bodies: Vec<Option<u16>>,
    /// Empty: those of boxes.
    inertias: Vec<Option<[f32; 3]>>,
    previous: Vec<Isometry3<f32>>,
    current: Vec<Isometry3<f32>>,
    planes: Vec<Plane>,
    gravity: Vector3<f32>,
    dt_s: f32,
    /// (steps, units)
    targets: Vec<Vec<Isometry3<f32>>>,
    steps: usize,
}

impl Scene {
    fn new(scale: Scale) -> Self {
        Scene { steps: STEPS, ..Scene::of("tiny-roles", scale) }
    }

    /// As a golden case has it, for as many steps.
    fn of(name: &str, scale: Scale) -> Self {
        let golden = Golden::read(name);
        let inputs = golden.inputs();
        let role = |code| [Role::Free, Role::Driven, Role::Fixed][code as usize];
        let plane = |row: &[f32]| Plane {
            normal: Vector3::new(row[0], row[1], row[2]),
            offset_m: row[3] * scale.length,
            friction: row[4],
            restitution: row[5],
        };
        let scaled = |pose: Isometry3<f32>| scale.pose(&pose);
        let targets = golden.tensor("targets").0;
        let targets: Vec<_> = targets.chunks_exact(7).map(isometry).map(scaled).collect();
        let heavier =
            |physics: Physics| Physics { mass_kg: physics.mass_kg * scale.mass, ..physics };
        let targets: Vec<_> =
            targets.chunks_exact(inputs.points.len()).map(<[_]>::to_vec).collect();
        Scene {
            steps: targets.len(),
            points: inputs.points.iter().map(|points| scale.points(points)).collect(),
            physics: inputs.physics.into_iter().map(heavier).collect(),
            roles: golden.integers("role").into_iter().map(role).collect(),
            bodies: golden.integers("body").into_iter().map(|b| u16::try_from(b).ok()).collect(),
            inertias: vec![],
            previous: inputs.previous.into_iter().map(scaled).collect(),
            current: inputs.current.into_iter().map(scaled).collect(),
            planes: golden.tensor("planes").0.chunks_exact(6).map(plane).collect(),
            gravity: Vector3::from_column_slice(&golden.tensor("gravity").0),
            dt_s: golden.tensor("dt").0[0] * scale.time,
            targets,
        }
    }

    /// The same scene with moments of inertia for every unit but each third.
    fn with_inertia(self, scale: Scale) -> Self {
        let moments = |number: usize| {
            let mass_kg = self.physics[number].mass_kg;
            let share = |share: f32| mass_kg * share * scale.length * scale.length;
            (!number.is_multiple_of(3)).then(|| [share(0.01), share(0.004), share(0.012)])
        };
        Scene { inertias: (0..self.points.len()).map(moments).collect(), ..self }
    }

    fn unit(&self, number: usize) -> Unit<'_> {
        let unit = Unit::new(&self.points[number], self.physics[number]).role(self.roles[number]);
        let inertia_kg_m2 = self.inertias.get(number).copied().flatten();
        Unit { body: self.bodies[number], inertia_kg_m2, ..unit }
    }

    fn posed(&self) -> Vec<Posed<'_>> {
        let posed = |number| Posed {
            unit: self.unit(number),
            previous: self.previous[number],
            current: self.current[number],
        };
        (0..self.points.len()).map(posed).collect()
    }

    fn observe(&self, simulator: &mut Simulator<'_, '_>) {
        simulator.set_planes(&self.planes).unwrap();
        simulator.set_gravity(self.gravity).unwrap();
        simulator.observe_poses(self.dt_s, self.posed()).unwrap();
    }

    /// Tells driven units where to go in a step.
    fn drive(&self, simulator: &mut Simulator<'_, '_>, step: usize) {
        let Some(targets) = self.targets.get(step) else { return };
        let ids: Vec<_> = simulator.units().map(|unit| (unit.id(), unit.role())).collect();
        for ((id, role), target) in ids.into_iter().zip(targets) {
            if role == Role::Driven {
                simulator.drive(id, target).unwrap();
            }
        }
    }

    /// Poses after each step, and how many predictions of the network took effect; `begin` puts the scene there, `change`
    /// is called before each step.
    fn roll(
        &self,
        file: &[u8],
        begin: impl Fn(&mut Simulator<'_, '_>),
        change: impl Fn(&mut Simulator<'_, '_>, usize),
    ) -> (Vec<Vec<Isometry3<f32>>>, u32) {
        with_simulator(file, POINTS, |simulator| {
            begin(simulator);
            let (mut all, mut active) = (vec![], 0);
            for step in 0..self.steps {
                change(simulator, step);
                self.drive(simulator, step);
                active += simulator.step().unwrap().active_units;
                all.push(poses(simulator));
            }
            (all, active)
        })
    }

    fn rollout(&self, file: &[u8]) -> (Vec<Vec<Isometry3<f32>>>, u32) {
        self.roll(file, |simulator| self.observe(simulator), |_, _| ())
    }
}

fn bits(poses: &[Isometry3<f32>], length: f32) -> Vec<u32> {
    let numbers = |pose: &Isometry3<f32>| {
        let place = pose.translation.vector / length;
        place.iter().chain(&pose.rotation.coords).map(|v| v.to_bits()).collect::<Vec<_>>()
    };
    poses.iter().flat_map(numbers).collect()
}

fn models(similarity: Similarity) -> [(&'static str, AlignedBuffer); 2] {
    [
        ("tiny-roles", with_similarity(&packed_model("tiny-roles"), similarity)),
        ("edge", with_similarity(rigidformer_weights::EDGE, similarity)),
    ]
}

/// Powers of two change no digit.
#[test]
fn four_times_the_length_in_twice_the_time_is_the_same_motion_to_the_bit() {
    let in_parts = models(Similarity { longest_step: 2.5, ..SIMILAR });
    for (name, file) in models(SIMILAR).into_iter().chain(in_parts) {
        let (expected, active) = Scene::new(AS_IT_IS).rollout(&file);
        assert!(active > 20, "{name}: {active}");
        for scale in [
            Scale { length: 4.0, time: 2.0, mass: 1.0 },
            Scale { length: 4.0, time: 2.0, mass: 8.0 },
            Scale { length: 1.0 / 64.0, time: 1.0 / 8.0, mass: 1.0 / 4096.0 },
        ] {
            let (found, _) = Scene::new(scale).rollout(&file);
            for (step, (found, expected)) in found.iter().zip(&expected).enumerate() {
                assert_eq!(bits(found, scale.length), bits(expected, 1.0), "{name}, step {step}");
            }
        }
    }
}

/// Moments of inertia are lengths squared times masses, and matter.
#[test]
fn moments_of_inertia_scale_to_the_bit() {
    for (name, file) in models(SIMILAR) {
        let plain = Scene::new(AS_IT_IS).rollout(&file).0;
        let expected = Scene::new(AS_IT_IS).with_inertia(AS_IT_IS).rollout(&file).0;
        assert_ne!(plain, expected, "{name}");
        for scale in [
            Scale { length: 4.0, time: 2.0, mass: 8.0 },
            Scale { length: 1.0 / 64.0, time: 1.0 / 8.0, mass: 1.0 / 4096.0 },
        ] {
            let (found, _) = Scene::new(scale).with_inertia(scale).rollout(&file);
            for (step, (found, expected)) in found.iter().zip(&expected).enumerate() {
                assert_eq!(bits(found, scale.length), bits(expected, 1.0), "{name}, step {step}");
            }
        }
    }
}

/// What was held when the first free unit measured the scene anew keeps its moments of inertia.
#[test]
fn a_new_measure_keeps_the_moments_of_inertia() {
    let corner = |k: usize, x: f32, y: f32, z: f32| {
        let side = |bit: usize, half: f32| if k & bit == 0 { -half } else { half };
        Point3::new(side(1, x), side(2, y), side(4, z))
    };
    let rod: Vec<_> = (0..8).map(|k| corner(k, 0.2, 0.01, 0.01)).collect();
    let block: Vec<_> = (0..8).map(|k| corner(k, 0.7, 0.7, 0.7)).collect();
    let wood = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.1 };
    let here = [
        Isometry3::new(Vector3::new(0.0, 0.0, 0.069), Vector3::new(0.0, 0.3, 0.0)),
        Isometry3::translation(5.0, 0.0, 0.7),
    ];
    // Where its mass is at its ends it tips by less in the same time.
    let run = |at_once: bool, inertia: Option<[f32; 3]>| {
        let held = Unit { inertia_kg_m2: inertia, ..Unit::new(&rod, wood).role(Role::Fixed) };
        let free = Unit::new(&block, wood);
        let (_, file) = &models(SIMILAR)[1];
        with_simulator(file, POINTS, |simulator| {
            if at_once {
                let units = [held, free].into_iter().zip(here);
                let units = units.map(|(unit, at)| Posed { unit, previous: at, current: at });
                simulator.observe_poses(1.0 / 24.0, units).unwrap();
            } else {
                simulator.set_dt(1.0 / 24.0).unwrap();
                simulator.add(&held, &here[0], &here[0]).unwrap();
                simulator.add(&free, &here[1], &here[1]).unwrap();
            }
            let id = simulator.unit(0).unwrap().id();
            simulator.set_role(id, Role::Free).unwrap();
            for _ in 0..2 {
                simulator.step().unwrap();
            }
            poses(simulator)
        })
    };
    for inertia in [None, Some([1e-3, 0.04, 0.04])] {
        let (found, expected) = (run(false, inertia), run(true, inertia));
        let difference = pose_difference(&found, &expected);
        assert!(difference.0 < 1e-4 && difference.1 < 1e-3, "{inertia:?}: {difference:?}");
        let other = run(true, Some([1e-4, 2e-3, 2e-3]));
        assert!(pose_difference(&found, &other).1 > 0.02, "{found:?} {other:?}");
    }
}

/// Everything that changes a scene between steps is in the caller's units.
#[test]
fn edits_scale_to_the_bit() {
    let run = |file: &[u8], scale: Scale| {
        let scene = Scene::new(scale).with_inertia(scale);
        let begin = |simulator: &mut Simulator<'_, '_>| {
            simulator.set_planes(&scene.planes).unwrap();
            simulator.set_dt(scene.dt_s).unwrap();
            // What is fixed and driven first: the first free unit measures the scene anew.
            let (free, held): (Vec<_>, Vec<_>) =
                scene.posed().into_iter().partition(|posed| posed.unit.role == Role::Free);
            for Posed { unit, previous, current } in held.iter().chain(&free) {
                simulator.add(unit, previous, current).unwrap();
            }
            simulator.set_gravity(scene.gravity).unwrap();
        };
        let change = |simulator: &mut Simulator<'_, '_>, step: usize| {
            let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
            let id = ids[5];
            match step {
                2 => simulator.set_dt(scene.dt_s * 0.75).unwrap(),
                4 => simulator.remove(ids[4]).unwrap(),
                6 => simulator.set_gravity(scene.gravity * 0.6).unwrap(),
                8 => {
                    let before = simulator.get(id).unwrap().physics();
                    let heavy = Physics { mass_kg: before.mass_kg * 3.0, ..before };
                    simulator.set_physics(id, heavy).unwrap();
                    assert_eq!(simulator.get(id).unwrap().physics(), heavy);
                }
                10 => {
                    let unit = simulator.get(id).unwrap();
                    let (before, now) = (unit.previous_pose(), unit.pose());
                    let shift = Vector3::new(0.0, 0.0, 0.25 * scale.length);
                    let up = |pose: Isometry3<f32>| {
                        Isometry3::from_parts(
                            (pose.translation.vector + shift).into(),
                            pose.rotation,
                        )
                    };
                    simulator.set_poses(id, &up(before), &up(now)).unwrap();
                }
                12 => simulator.set_planes(&scene.planes[..1]).unwrap(),
                14 => simulator.set_role(id, Role::Fixed).unwrap(),
                // Held when the first free unit measured the scene anew.
                16 => simulator.set_role(ids[0], Role::Free).unwrap(),
                _ => {}
            }
        };
        let drives = Scene { targets: vec![], ..Scene::new(scale) };
        drives.roll(file, begin, change).0
    };
    let in_parts = models(Similarity { longest_step: 2.5, ..SIMILAR });
    for (name, file) in models(SIMILAR).into_iter().chain(in_parts) {
        let expected = run(&file, AS_IT_IS);
        let scale = Scale { length: 16.0, time: 4.0, mass: 0.25 };
        for (step, (found, expected)) in run(&file, scale).iter().zip(&expected).enumerate() {
            assert_eq!(bits(found, scale.length), bits(expected, 1.0), "{name}, step {step}");
        }
    }
}

/// Other factors round: 2 cm and 5 m agree.
#[test]
fn a_small_and_a_large_scene_agree() {
    let [roles, edge] = models(SIMILAR);
    let tiny = ("tiny-impulses", with_similarity(&packed_model("tiny-impulses"), SIMILAR));
    // Scenes and lengths in which rounding does not decide between one contact and another.
    for ((name, file), scene) in
        [(roles, "tiny-roles"), (tiny, "tiny-impulses"), (edge, "tiny-impulses")]
    {
        let run = |length: f32| {
            let length = length / SIMILAR.length_m;
            let scale = Scale { length, time: length.sqrt(), mass: length.powi(3) };
            let (poses, active) = Scene::of(scene, scale).rollout(&file);
            assert!(active > 5, "{name}: {active}");
            let inverse = Scale { length: 1.0 / length, time: 1.0, mass: 1.0 };
            let back = poses.iter().map(|poses| poses.iter().map(|p| inverse.pose(p)).collect());
            back.collect::<Vec<Vec<_>>>()
        };
        let (small, large) = (run(0.05), run(5.0));
        let mut worst = (0.0_f32, 0.0_f32);
        for (small, large) in small.iter().zip(&large) {
            let (position, angle) = pose_difference(small, large);
            worst = (worst.0.max(position / SIMILAR.length_m), worst.1.max(angle));
        }
        println!("{name}: {:.1e} of a size, {:.1e} rad", worst.0, worst.1);
        assert!(worst.0 < 1e-4 && worst.1 < 1e-3, "{name}: {worst:?}");
    }
}

/// Masses count by their ratios alone, and gravity by nothing but the time.
#[test]
fn on_the_moon_the_same_motion_takes_longer() {
    let (name, file) = &models(SIMILAR)[1];
    let scene = Scene::new(AS_IT_IS);
    let (expected, _) = scene.rollout(file);
    let slow =
        Scene { gravity: scene.gravity * 0.25, dt_s: scene.dt_s * 2.0, ..Scene::new(AS_IT_IS) };
    for (found, expected) in slow.rollout(file).0.iter().zip(&expected) {
        assert_eq!(bits(found, 1.0), bits(expected, 1.0), "{name}");
    }
}

#[test]
fn what_was_given_is_read() {
    let scale = Scale { length: 0.07, time: 0.07_f32.sqrt(), mass: 0.07 };
    let (scene, file) = (Scene::new(scale), with_similarity(&packed_model("tiny-roles"), SIMILAR));
    with_simulator(&file, POINTS, |simulator| {
        scene.observe(simulator);
        assert_eq!(simulator.planes(), scene.planes);
        assert_eq!(simulator.gravity_m_s2(), scene.gravity);
        assert_eq!(simulator.dt_s(), Some(scene.dt_s));
        for (number, unit) in simulator.units().enumerate() {
            assert_eq!(unit.physics(), scene.physics[number]);
            let (before, now) = (unit.previous_pose(), unit.pose());
            let difference =
                pose_difference(&[before, now], &[scene.previous[number], scene.current[number]]);
            // Angles by quaternions of f32.
            assert!(difference.0 < 1e-6 * scale.length && difference.1 < 1e-6, "{difference:?}");
            let mut points: Vec<_> = scene.points[number].iter().map(|p| now * p).collect();
            for found in unit.points() {
                let near = points.iter().position(|p| (p - found).norm() < 1e-6 * scale.length);
                points.remove(near.expect("the point"));
            }
        }
        let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
        for id in ids {
            simulator.remove(id).unwrap();
        }
        // The next unit measures anew.
        simulator.add(&scene.unit(0), &scene.previous[0], &scene.current[0]).unwrap();
        assert_eq!(simulator.units().count(), 1);
        let found = simulator.unit(0).unwrap().pose();
        assert!(pose_difference(&[found], &scene.current[..1]).0 < 1e-6 * scale.length);
    });
}

/// An observation that is refused leaves the scene's measure as it was.
#[test]
fn refused_calls_change_nothing() {
    let (scene, other) =
        (Scene::new(AS_IT_IS), Scene::new(Scale { length: 100.0, time: 1.0, mass: 1.0 }));
    let file = with_similarity(&packed_model("tiny-roles"), SIMILAR);
    let refuse = |simulator: &mut Simulator<'_, '_>, step: usize| {
        if step == 3 {
            let bad = Err(ObserveError::BadTimestep);
            assert_eq!(simulator.observe_poses(f32::NAN, other.posed()), bad);
            let dt_s = f32::MIN_POSITIVE;
            let short = Err(ObserveError::ShortTimestep { dt_s, shortest_s: SHORTEST_STEP_S });
            assert_eq!(simulator.observe_poses(dt_s, other.posed()), short);
            let mut posed = other.posed();
            posed[9].unit.physics.mass_kg = -1.0;
            let bad = Err(ObserveError::BadPhysics { unit: 9 });
            assert_eq!(simulator.observe_poses(scene.dt_s, posed), bad);
            let bad = Err(EditError::Unit(ObserveError::BadTimestep));
            assert_eq!(simulator.set_dt(-1.0), bad);
        }
    };
    let (found, _) = scene.roll(&file, |simulator| scene.observe(simulator), refuse);
    assert_eq!(found, scene.rollout(&file).0);
}
