use nalgebra::{Point3, UnitQuaternion, Vector3};
use rigidformer_core::Role;
use rigidformer_robots::{JointKind, LoadOptions, SceneOptions, load_robot, parse_robot};

use crate::data;

#[test]
fn classes_frames_includes_and_masses_are_those_of_mujoco() {
    let robot = load_robot(&data("crab.xml")).unwrap();
    let names: Vec<&str> = robot.links.iter().map(|link| link.name.as_str()).collect();
    // The included body stands where the include stands: before the others.
    assert_eq!(names, ["world", "post", "trunk", "leg/1", "leg", "shin"]);
    // A wedge is half of its box; what has a mass of 0 weighs nothing.
    let trunk = &robot.links[2].inertia;
    assert!((trunk.mass_kg - 500.0 * 0.4 * 0.3 * 0.1 / 2.0).abs() < 1e-6, "{trunk:?}");
    assert!((robot.links[5].inertia.mass_kg - 0.3).abs() < 1e-12);
    assert!((robot.links[5].inertia.about_centre[(0, 1)] - 1e-4).abs() < 1e-12);
    assert_eq!(robot.planes, [([0.0, 0.0, 1.0], -0.1, 0.9)]);
    assert_eq!(robot.links[5].friction, Some(0.7));
    assert!(robot.notes.iter().any(|note| note.contains("connect")));
    let rest = robot.rest();
    assert_eq!((rest.len(), rest[2], rest[7], rest[8], rest[9]), (10, 0.4, 0.0, 0.2, 0.0));
    let poses = robot.poses(&rest).unwrap();
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.3);
    let leg = Point3::new(0.0, 0.0, 0.4) + turn * Vector3::new(0.2, 0.0, 0.0);
    assert!((poses[4] * Point3::origin() - leg).norm() < 1e-12);
    // A position of 0 is .2 rad from how the file has it.
    let mut moved = rest.clone();
    moved[8] = 0.0;
    assert!(
        (robot.poses(&moved).unwrap()[4].rotation.angle_to(&poses[4].rotation) - 0.2).abs() < 1e-12
    );
    assert!(matches!(
        robot.joints.last().unwrap().kind,
        JointKind::Prismatic { limits: Some(_), .. }
    ));
}

#[test]
fn a_scene_has_scenery_planes_and_bodies() {
    let robot = load_robot(&data("crab.xml")).unwrap();
    let made = robot.scene(&SceneOptions::default()).unwrap();
    let units = made.scene.units();
    let roles: Vec<_> =
        units.iter().map(|unit| (unit.shape.as_str(), unit.role, unit.body)).collect();
    assert_eq!(
        roles,
        [
            ("post", Role::Fixed, Some(0)),
            ("trunk", Role::Free, Some(1)),
            ("leg", Role::Free, Some(1)),
            ("shin", Role::Free, Some(1))
        ]
    );
    // Both hinges of the leg are at one place.
    assert_eq!(made.scene.pivots().len(), 1);
    assert_eq!(made.scene.planes().unwrap()[0].offset_m, -0.1);
}

#[test]
fn what_the_compiler_says_counts() {
    let mass = |compiler: &str| {
        let text = format!(
            "<mujoco><compiler {compiler}/><worldbody><body><freejoint/><inertial pos='0 0 0' mass='2' diaginertia='1 1 1'/>\
             <geom size='.1' mass='3'/></body></worldbody></mujoco>"
        );
        parse_robot("r.xml".as_ref(), text.as_bytes(), &LoadOptions::default())
            .map(|robot| robot.mass_kg())
            .map_err(|error| error.to_string())
    };
    assert_eq!(mass("inertiafromgeom='true'").unwrap(), 3.0);
    assert_eq!(mass("inertiafromgeom='auto'").unwrap(), 2.0);
    assert_eq!(mass("boundmass='4'").unwrap(), 4.0);
    assert!((mass("settotalmass='7'").unwrap() - 7.0).abs() < 1e-12);
    assert!(mass("inertiafromgeom='maybe'").unwrap_err().contains("true, false or auto"));
    assert!(mass("coordinate='global'").is_err());
    assert!(mass("eulerseq='xyw'").is_err());
}

#[test]
fn what_is_not_taken_is_refused_by_name() {
    let cases = [
        ("<body><replicate count='2'/></body>", "an element that makes others"),
        ("<body><geom type='mesh' mesh='none'/></body>", "names the mesh \"none\""),
        ("<body><geom type='box' size='1'/></body>", "size of so many"),
        ("<body><geom class='none'/></body>", "default class"),
        ("<body><joint type='free'/><joint/></body>", "a free joint"),
        ("<body><joint limited='true'/></body>", "has no range"),
        ("<body><joint axis='0 0 0'/></body>", "a direction"),
        ("<body quat='0 0 0 0'/>", "a rotation"),
        ("<body name='a'/><body name='a'/>", "a second body"),
        ("<body><geom type='capsule' size='1' fromto='1 1 1 1 1 1'/></body>", "a line"),
        ("<body><inertial mass='1' pos='0 0 0'/></body>", "diaginertia"),
        ("<body><inertial mass='1' pos='0 0 0' diaginertia='1 1 -9'/></body>", "below 0"),
    ];
    for (world, expected) in cases {
        let text = format!("<mujoco>\n<worldbody>\n{world}</worldbody></mujoco>");
        let error =
            parse_robot("r.xml".as_ref(), text.as_bytes(), &LoadOptions::default()).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains(expected) && error.starts_with("r.xml:3:"),
            "{error}, not {expected}"
        );
    }
}
