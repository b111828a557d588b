use std::f64::consts::FRAC_PI_2;

use nalgebra::{Point3, Vector3};
use rigidformer_core::{JointKind as Held, Role};
use rigidformer_evaluation::scenes::{Dataset, SceneNotes};
use rigidformer_robots::{
    JointKind, LoadOptions, Robot, SceneOptions, load_robot, load_robot_with,
};

use crate::data;

fn cart(merge: bool) -> Robot {
    let mut options = LoadOptions::default();
    options.merge_fixed = merge;
    load_robot_with(&data("cart_description/urdf/cart.urdf"), &options).unwrap()
}

#[test]
fn links_joints_and_limits_are_those_of_the_file() {
    let robot = cart(false);
    assert_eq!((robot.links.len(), robot.joints.len(), robot.positions()), (6, 5, 2));
    assert!((robot.mass_kg() - 6.2).abs() < 1e-12);
    let shoulder = robot.joints.iter().find(|joint| joint.name == "shoulder").unwrap();
    let JointKind::Revolute { axis, limits } = shoulder.kind else { panic!("{shoulder:?}") };
    assert_eq!((axis.into_inner(), limits), (Vector3::y(), [-1.0, 2.0]));
    assert_eq!(robot.links[0].friction, Some(0.8));
    // The inertial frame is turned by half a radian, and moments about z stay.
    let about = robot.links[0].inertia.about_centre;
    assert!((about[(2, 2)] - 0.4).abs() < 1e-12 && (about.trace() - 0.9).abs() < 1e-12);
    // Collision geometries alone; the mast has what is seen.
    let arm = &robot.links[robot.link("arm").unwrap()];
    assert_eq!(arm.pieces.len(), 2);
    assert_eq!(robot.links[robot.link("mast").unwrap()].surface.triangles.len(), 8);
}

#[test]
fn poses_follow_joints_and_fingers_mimic() {
    let robot = cart(false);
    let at =
        |positions: &[f64], link: &str| robot.poses(positions).unwrap()[robot.link(link).unwrap()];
    let tip = at(&[0.0, 0.0], "finger") * Point3::origin();
    assert!((tip - Point3::new(-0.01, 0.34, 0.75)).norm() < 1e-12, "{tip}");
    let lifted = at(&[-FRAC_PI_2, 0.02], "finger") * Point3::origin();
    assert!((lifted - Point3::new(-0.03, 0.0, 0.75 + 0.34)).norm() < 1e-12, "{lifted}");
    let other = at(&[-FRAC_PI_2, 0.02], "other_finger") * Point3::origin();
    assert!((other - Point3::new(0.03, 0.0, 0.75 + 0.34)).norm() < 1e-12, "{other}");
    assert!(robot.poses(&[0.0]).unwrap_err().to_string().contains("has 2"));
    assert!(robot.poses(&[f64::NAN, 0.0]).is_err());
}

#[test]
fn merged_links_keep_mass_places_and_motion() {
    let (apart, merged) = (cart(false), cart(true));
    assert_eq!((merged.links.len(), merged.joints.len()), (4, 3));
    assert!((merged.mass_kg() - apart.mass_kg()).abs() < 1e-12);
    let base = &merged.links[0].inertia;
    let expected = (4.0 * 0.1 + 1.5 * 0.45) / 5.5;
    assert!((base.centre_m.z - expected).abs() < 1e-12);
    let at = [0.3, 0.01];
    for link in ["arm", "finger", "other_finger"] {
        let [a, b] =
            [&apart, &merged].map(|robot| robot.poses(&at).unwrap()[robot.link(link).unwrap()]);
        assert!((a.to_homogeneous() - b.to_homogeneous()).norm() < 1e-12, "{link}");
    }
}

#[test]
fn a_scene_has_units_with_masses_moments_and_pivots_and_is_read_back() {
    let robot = cart(true);
    let made = robot.scene(&SceneOptions::default()).unwrap();
    let units = made.scene.units();
    assert_eq!(units.len(), 4);
    assert!(
        units
            .iter()
            .all(|unit| unit.points.len() == 32 && unit.body == Some(0) && unit.role == Role::Free)
    );
    assert_eq!(units[0].pieces.len(), 2);
    // The arm turns; fingers slide, which no pivot holds.
    let pivots = made.scene.pivots();
    assert_eq!(pivots.len(), 1);
    let poses: Vec<_> = units.iter().map(|unit| unit.poses[0]).collect();
    assert!(pivots[0].apart_m(&poses).unwrap() < 1e-6);
    let kinds: Vec<_> = made.held.iter().map(|held| held.kind).collect();
    let [Held::Revolute(arm), Held::Prismatic(left), Held::Prismatic(_)] = kinds[..] else {
        unreachable!("{kinds:?}")
    };
    assert!(arm.limits.is_some() && left.limits.is_some());
    assert!(made.held.iter().all(|held| {
        let [own, parent] = [held.unit, held.parent].map(|unit| poses[unit]);
        (own * held.pivot - parent * held.parent_pivot).norm() < 1e-6
    }));
    // Limits count from where the scene begins.
    let mut turned = SceneOptions::default();
    turned.positions = Some(vec![0.25, 0.01]);
    let moved = robot.scene(&turned).unwrap();
    let Held::Revolute(later) = moved.held[0].kind else { unreachable!() };
    let shift = arm.limits.unwrap()[0] - later.limits.unwrap()[0];
    assert!((shift - 0.25).abs() < 1e-6, "{shift}");
    let notes =
        SceneNotes { dataset: "cart".into(), provenance: "a test".into(), licence: "none".into() };
    let bytes = made.file("cart.safetensors".as_ref(), &notes).unwrap();
    let read = Dataset::from_bytes("cart.safetensors", bytes).unwrap().scene(0, None).unwrap();
    assert_eq!((read.units().len(), read.frames()), (4, 2));
    assert!((read.units()[0].physics.mass_kg - 5.5).abs() < 1e-5);
    let rows = made.joints.as_array().unwrap();
    assert_eq!((rows.len(), rows[0]["kind"].as_str()), (3, Some("revolute")));
    // Along principal axes moments are those of the tensor.
    let mut options = SceneOptions::default();
    (options.principal_frames, options.fixed_base) = (true, true);
    let made = robot.scene(&options).unwrap();
    assert_eq!(made.scene.units()[0].role, Role::Fixed);
    let moments = made.scene.units()[1].inertia.unwrap();
    let own = robot.links[made.links[1]].inertia.principal_moments();
    assert!((f64::from(moments.iter().sum::<f32>()) - own.iter().sum::<f64>()).abs() < 1e-6);
}

#[test]
fn what_no_robot_has_is_refused_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let link = |name: &str| format!("<link name=\"{name}\"/>\n");
    let joint = |name: &str, kind: &str, parent: &str, child: &str, more: &str| {
        format!(
            "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/>{more}</joint>\n"
        )
    };
    let three = || link("a") + &link("b") + &link("c");
    let cases = [
        (link("a") + &link("a"), ":3: link \"a\": a second link"),
        (three() + &joint("j", "fixed", "a", "b", ""), "has 2 root links"),
        (three() + &joint("j", "fixed", "a", "c", "") + &joint("k", "fixed", "b", "c", ""), "second joint has the same child"),
        (link("a") + &link("b") + &joint("j", "fixed", "a", "b", "") + &joint("k", "fixed", "b", "a", ""), "circle"),
        (link("a") + &joint("j", "fixed", "a", "a", ""), "hangs from itself"),
        (link("a") + &joint("j", "fixed", "a", "x", ""), "\"x\", which is not there"),
        (link("a") + &link("b") + &joint("j", "twist", "a", "b", ""), "give fixed, revolute"),
        (link("a") + &link("b") + &joint("j", "revolute", "a", "b", ""), "has no limit"),
        (link("a") + &link("b") + &joint("j", "continuous", "a", "b", "<axis xyz=\"0 0 0\"/>"), "a direction"),
        (link("a") + &link("b") + &joint("j", "continuous", "a", "b", "<mimic joint=\"j\"/>"), "in a circle"),
        (link("a") + &link("b") + &joint("j", "fixed", "a", "b", "<origin xyz=\"0 nan 0\"/>"), "xyz=\"0 nan 0\""),
        (inertial("-1", "1 1 1"), "mass is below 0"),
        (inertial("1", "1 -1 1"), "below 0"),
        (inertial("1e400", "1 1 1"), "a finite number"),
        ("<link name=\"a\"><collision><geometry><mesh filename=\"package://none/a.stl\"/></geometry></collision></link>".into(), "--package-path"),
        ("<link name=\"a\"><collision><geometry><box size=\"0 1 1\"/></geometry></collision></link>".into(), "a length that is not above 0 is not taken; give whole sides"),
        ("<link name=\"a\"><collision><geometry><cone/></geometry></collision></link>".into(), "box, sphere"),
        (String::new(), "has no link"),
    ];
    for (body, expected) in cases {
        let file = folder.path().join("robot.urdf");
        std::fs::write(&file, format!("<robot name=\"r\">\n{body}</robot>")).unwrap();
        let error = load_robot(&file).unwrap_err().to_string();
        assert!(
            error.contains(expected) && error.contains("robot.urdf:"),
            "{error}, not {expected}"
        );
    }
}

fn inertial(mass: &str, moments: &str) -> String {
    let [x, y, z] = <[&str; 3]>::try_from(moments.split(' ').collect::<Vec<_>>()).unwrap();
    format!(
        "<link name=\"a\"><inertial><mass value=\"{mass}\"/>\
         <inertia ixx=\"{x}\" iyy=\"{y}\" izz=\"{z}\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>"
    )
}

#[test]
fn options_balance_and_skip() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("robot.urdf");
    std::fs::write(&file, format!("<robot name=\"r\">{}</robot>", inertial("1", "1 1 5"))).unwrap();
    let mut options = LoadOptions::default();
    options.balance_inertia = true;
    let robot = load_robot_with(&file, &options).unwrap();
    assert!((robot.links[0].inertia.about_centre[(0, 0)] - 7.0 / 3.0).abs() < 1e-12);
    assert_eq!(robot.notes.len(), 1);
    let kept = load_robot(&file).unwrap();
    assert!((kept.links[0].inertia.about_centre[(2, 2)] - 5.0).abs() < 1e-12);
    assert!(kept.notes[0].contains("--balance"));
    let missing = "<link name=\"a\"><visual><geometry><mesh filename=\"gone.stl\"/></geometry></visual></link>";
    std::fs::write(&file, format!("<robot name=\"r\">{missing}</robot>")).unwrap();
    options.skip_missing_meshes = true;
    assert!(load_robot_with(&file, &options).unwrap().links[0].surface.triangles.is_empty());
}
