//! Contact that gives way, against closed forms and against rigid contact.

use super::*;

const SOFT: Compliance = Compliance { stiffness_n_m: 2_000.0, dissipation_s_m: 0.0 };

fn soft_ground(dt: f32, compliance: Compliance) -> World {
    let mut world = World::new(dt);
    world.plane_compliance[0] = compliance;
    world
}

/// A ball at rest on its spring.
fn on_its_spring(dt: f32, compliance: Compliance) -> (World, f32) {
    let mut world = soft_ground(dt, compliance);
    let rests = 0.1 - 9.81 / compliance.stiffness_n_m;
    world.add(&ball(0.1, 160), at(0.0, 0.0, rests));
    (world, rests)
}

/// Of a kilogram on a spring about where it rests: z = v / w' exp(-c g t / 2) sin(w' t), as k d c is m g c there.
#[test]
fn a_mass_swings_on_its_spring_as_the_closed_form_says() {
    for (dt, dissipation) in [(1.0 / 240.0, 0.0), (1.0 / 240.0, 0.3), (10.0 / 240.0, 0.3)] {
        let compliance = Compliance { dissipation_s_m: dissipation, ..SOFT };
        let (mut world, rests) = on_its_spring(dt, compliance);
        let (speed, decay) = (0.03, 0.5 * 9.81 * dissipation);
        world.throw(0, Vector3::new(0.0, 0.0, speed), Vector3::zeros());
        let pace = (2_000.0 - decay * decay).sqrt();
        let (mut time, mut worst) = (0.0_f32, 0.0_f32);
        while time < 0.5 {
            world.step();
            time += dt;
            let expected = speed / pace * (-decay * time).exp() * (pace * time).sin();
            worst = worst.max((world.slots[0].current.centre.z - rests - expected).abs());
        }
        // 22 radians: 1 % of a period are .22 of the amplitude.
        assert!(worst < 0.1 * speed / pace, "{dt} {dissipation}: {worst}");
    }
}

/// Without dissipation a ball bounces to where it fell from, over and over; restitution says nothing.
#[test]
fn a_spring_gives_back_what_it_took() {
    for dt in [1.0 / 240.0, 10.0 / 240.0] {
        let mut world = soft_ground(dt, SOFT);
        world.add(&ball(0.1, 160), at(0.0, 0.0, 0.3)).physics.restitution = 0.0;
        let (mut most, mut late) = (0.0_f32, 0.0_f32);
        for step in 0..(3.0 / dt) as usize {
            world.step();
            let z = world.slots[0].current.centre.z;
            most = most.max(z);
            if step as f32 * dt > 2.0 {
                late = late.max(z);
            }
        }
        assert!(most < 0.303 && late > 0.29, "{dt}: {most} {late}");
    }
}

/// Kinetic, in the field of gravity and in springs of the corners, J.
fn energy(world: &World, slot: &UnitSlot, compliance: &Compliance) -> f32 {
    let (dt, pose) = (world.dt, slot.current);
    let velocity = slot.course.way / dt + world.gravity * (0.5 * dt);
    let spin = slot.course.turn() / dt;
    let own = pose.rotation.transpose() * spin;
    let points = &world.points[slot.start..slot.start + slot.count];
    let depths = points.iter().map(|p| (-(pose.rotation * p.coords + pose.centre).z).max(0.0));
    let springs: f32 = depths.map(|depth| 0.5 * compliance.stiffness_n_m * depth * depth).sum();
    let moves = 0.5 * (velocity.norm_squared() + own.component_mul(&own).dot(&slot.inertia_m2));
    moves + 9.81 * pose.centre.z + springs
}

#[test]
fn no_energy_comes_from_what_gives_way() {
    let mut state = 9;
    for round in 0..40 {
        let dissipation = [0.0, 0.3, 4.0][round % 3];
        let stiffness = [500.0, 10_000.0, 1e6][round / 3 % 3];
        let compliance = Compliance { stiffness_n_m: stiffness, dissipation_s_m: dissipation };
        let mut world = soft_ground([1.0, 5.0, 10.0][round % 3] / 240.0, compliance);
        let rotation = turned(&Matrix3::identity(), &(random_vector(&mut state) * 3.0));
        world.add(&cuboid(0.1, 0.1, 0.1), Pose { rotation, ..at(0.0, 0.0, 0.4) });
        world.throw(0, random_vector(&mut state), random_vector(&mut state) * 5.0);
        let began = energy(&world, &world.slots[0], &compliance);
        for _ in 0..(2.0 / world.dt) as usize {
            world.step();
            let now = energy(&world, &world.slots[0], &compliance);
            assert!(now < 1.02 * began, "{round}: {began} {now}");
        }
    }
}

/// As stiff as it can be it ends where rigid contact without restitution does.
#[test]
fn the_limit_is_rigid() {
    for stiffness_n_m in [1e9, 1e12, f32::INFINITY] {
        let stiff = Compliance { stiffness_n_m, dissipation_s_m: 0.0 };
        let ends = [Compliance::RIGID, stiff].map(|compliance| {
            let mut world = soft_ground(1.0 / 240.0, compliance);
            world.add(&cuboid(0.1, 0.07, 0.05), at(0.0, 0.0, 0.2)).physics.restitution = 0.0;
            world.throw(0, Vector3::new(0.5, 0.0, 0.0), Vector3::zeros());
            world.run(1.5);
            world.slots[0].current.centre
        });
        let [rigid, stiff] = ends;
        assert!(norm(&(stiff - rigid)) < 2e-3, "{stiffness_n_m}: {rigid} {stiff}");
    }
}

#[test]
fn a_stack_that_gives_way_comes_to_rest_and_stays_to_the_bit() {
    for dt in [1.0 / 240.0, 10.0 / 240.0] {
        let compliance = Compliance { stiffness_n_m: 10_000.0, dissipation_s_m: 2.0 };
        let mut world = soft_ground(dt, compliance);
        for k in 0..3 {
            let slot = world.add(&cuboid(0.1, 0.1, 0.1), at(0.0, 0.0, 0.1 + 0.2 * k as f32));
            slot.compliance = OfCompliance::new(compliance);
        }
        world.run(5.0);
        let bits = world.bits();
        world.run(1.0);
        assert_eq!(world.bits(), bits, "{dt}");
        // Corners carry 3, 2 and 1 kg, four a unit; two springs in series, and what units keep between them.
        let (mut expected, skin) = (0.0, 0.002 * 0.1 * 3.0_f32.sqrt());
        for (slot, load) in world.slots.iter().zip([3.0, 2.0, 1.0]) {
            expected += 0.2 - load * 9.81 / 4.0 / 5_000.0 + if load < 3.0 { skin } else { 0.0 };
            let top = slot.current.centre.z + 0.1;
            assert!((top - expected).abs() < 2e-4, "{dt} {load}: {top} {expected}");
        }
    }
}

/// Friction is that of rigid contact: what leans less than its angle stays.
#[test]
fn a_ramp_that_gives_way_holds_below_the_angle_of_friction_and_not_above() {
    for (degrees, holds) in [(24.0_f32, true), (29.0, false)] {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        let normal = Vector3::new(-sine, 0.0, cosine);
        let mut world =
            soft_ground(1.0 / 240.0, Compliance { dissipation_s_m: 4.0, stiffness_n_m: 1e4 });
        world.planes = vec![Plane { normal, ..Plane::ground(1.0, 1.0) }];
        let turn = Vector3::new(0.0, -degrees.to_radians(), 0.0);
        let rotation = turned(&Matrix3::identity(), &turn);
        world.add(&cuboid(0.1, 0.1, 0.1), Pose { rotation, centre: normal * 0.1 });
        world.run(2.0);
        let way = norm(&(world.slots[0].current.centre - normal * 0.1));
        let expected = 0.5 * 9.81 * (sine - 0.5 * cosine) * 4.0;
        let is_so = if holds { way < 2e-3 } else { (way / expected - 1.0).abs() < 0.05 };
        assert!(is_so, "{degrees}: {way} {expected}");
    }
}

/// Lengths times 4 and times times 2, and so stiffness times 1/4 and dissipation times 1/2: no bit but of exponents may change.
#[test]
fn four_times_as_large_is_twice_as_slow_where_it_gives_way() {
    let play = |length: f32, time: f32| {
        let compliance = Compliance {
            stiffness_n_m: 4096.0 / (time * time),
            dissipation_s_m: 2.0 * time / length,
        };
        let mut world = soft_ground(time / 240.0, compliance);
        let side = 0.1 * length;
        world.add(&cuboid(side, side, side), at(0.0, 0.0, 2.0 * side));
        world.throw(
            0,
            Vector3::new(0.4, 0.1, 0.0) * (length / time),
            Vector3::new(2.0, 1.0, 0.3) / time,
        );
        (0..240)
            .map(|_| {
                world.step();
                (world.slots[0].current.centre / length, world.slots[0].current.rotation)
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(play(1.0, 0.5), play(4.0, 1.0));
}
