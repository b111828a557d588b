//! What files of other programs say, where a reader could take it otherwise.

use std::fs;

use nalgebra::{Point3, Vector3};
use rigidformer_robots::{
    JointKind, LoadOptions, MeshSetOptions, Robot, SceneOptions, load_meshes, load_robot_with,
    parse_robot,
};

fn read(text: &str) -> Result<Robot, String> {
    let read = parse_robot("r.xml".as_ref(), text.as_bytes(), &LoadOptions::default());
    read.map_err(|error| error.to_string())
}

fn world(bodies: &str) -> Robot {
    read(&format!("<mujoco><worldbody>{bodies}</worldbody></mujoco>")).unwrap()
}

fn refused(text: &str) -> String {
    read(text).unwrap_err()
}

#[test]
fn frames_place_joints_and_inertials() {
    let robot = world(
        "<body><frame pos='1 2 3' euler='90 0 0'><joint axis='0 0 1' pos='.1 0 0'/><geom size='.1'/></frame></body>",
    );
    let joint = &robot.joints[0];
    assert!((joint.anchor - Point3::new(1.1, 2.0, 3.0)).norm() < 1e-12, "{joint:?}");
    let axis = joint.kind.axis().unwrap().into_inner();
    assert!((axis - Vector3::new(0.0, -1.0, 0.0)).norm() < 1e-12, "{axis}");
    let robot = world(
        "<body><freejoint/><frame pos='1 2 3' euler='90 0 0'><inertial pos='0 0 1' mass='1' diaginertia='1 2 2'/></frame></body>",
    );
    let centre = robot.links[1].inertia.centre_m;
    assert!((centre - Point3::new(1.0, 1.0, 3.0)).norm() < 1e-12, "{centre}");
}

#[test]
fn an_orientation_replaces_those_of_classes() {
    let wide = |defaults: &str, own: &str| {
        let text = format!(
            "<mujoco>{defaults}<worldbody><body><geom type='box' size='.1 .2 .3' {own}/></body></worldbody></mujoco>"
        );
        let points = read(&text).unwrap().links[1].surface.points.clone();
        points.iter().fold(Vector3::zeros(), |most: Vector3<f32>, point| most.sup(&point.coords))
    };
    let turned = "<default><geom euler='90 0 0'/><default class='q'><geom quat='0 0 1 0'/></default></default>";
    let upright = Vector3::new(0.1, 0.2, 0.3);
    assert!((wide(turned, "") - Vector3::new(0.1, 0.3, 0.2)).norm() < 1e-6);
    assert!((wide(turned, "quat='1 0 0 0'") - upright).norm() < 1e-6);
    assert!((wide(turned, "class='q'") - upright).norm() < 1e-6);
}

#[test]
fn boxes_along_a_line_are_square() {
    let robot = world("<body><geom type='box' size='.1 .3' fromto='0 0 0 0 0 1'/></body>");
    assert!((robot.mass_kg() - 40.0).abs() < 1e-9, "{}", robot.mass_kg());
}

#[test]
fn masses_below_0_and_numbers_beyond_counting_are_refused() {
    let body = |body: &str, compiler: &str| {
        format!(
            "<mujoco><compiler boundmass='1' {compiler}/><worldbody><body><freejoint/>{body}</body></worldbody></mujoco>"
        )
    };
    for geometry in [
        "<inertial pos='0 0 0' mass='-1' diaginertia='1 1 1'/>",
        "<geom size='.1' mass='-1'/><geom size='.1' mass='3'/>",
        "<geom size='.1' density='-1'/>",
    ] {
        assert!(refused(&body(geometry, "")).contains("mass is below 0"));
    }
    let tiny = body(
        "<inertial pos='0 0 0' mass='1e-320' diaginertia='0 0 0'/>",
        "settotalmass='1' boundmass='0'",
    );
    assert!(refused(&tiny.replacen("boundmass='1' ", "", 1)).contains("settotalmass"));
    let link = |n: usize| format!("<link name='l{n}'/>");
    let joint = |n: usize| {
        let mimic = if n > 1 {
            format!("<mimic joint='j{}' multiplier='1e20'/>", n - 1)
        } else {
            String::new()
        };
        format!(
            "<joint name='j{n}' type='continuous'><parent link='l{}'/><child link='l{n}'/>{mimic}</joint>",
            n - 1
        )
    };
    let links: String = (0..20).map(link).collect();
    let joints: String = (1..20).map(joint).collect();
    assert!(refused(&format!("<robot name='r'>{links}{joints}</robot>")).contains("multipliers"));
    let folder = tempfile::tempdir().unwrap();
    for (density, scale) in [(f64::NAN, 1.0), (f64::INFINITY, 1.0), (-1.0, 1.0), (1.0, f64::NAN)] {
        let mut options = MeshSetOptions::default();
        (options.density_kg_m3, options.scale) = (density, scale);
        let error = load_meshes(folder.path(), &options).unwrap_err().to_string();
        assert!(error.contains("density=") || error.contains("scale="), "{error}");
    }
}

#[test]
fn classes_share_what_they_inherit() {
    let long = format!("<mujoco><default><geom size='{}'/></default></mujoco>", " 1".repeat(3000));
    assert!(refused(&long).contains("a default of more than 4096 bytes"));
    // What no reader asks for is kept nowhere.
    let text = "x".repeat(500_000);
    let classes: String =
        (0..1500).map(|n| format!("<default class='c{n}'><geom size='.1'/></default>")).collect();
    let many = format!(
        "<mujoco><default><geom user='{text}' material='{text}'/>{classes}</default></mujoco>"
    );
    assert!(read(&many).is_ok());
    let joints = "<joint/>".repeat(1000);
    let named =
        format!("<mujoco><worldbody><body name='{text}'>{joints}</body></worldbody></mujoco>");
    assert!(refused(&named).contains("a name of more than 1024 bytes"));
    let around = format!(
        "<mujoco><worldbody><body childclass='{text}'>{}</body></worldbody></mujoco>",
        "<geom size='1'/>".repeat(20_000)
    );
    assert!(refused(&around).contains("default class"));
}

#[test]
fn meshes_of_a_file_itself_are_read_once_and_have_corners_that_are_there() {
    let mesh = |face: &str, count: usize| {
        let geometries = "<geom type='mesh' mesh='m'/>".repeat(count);
        format!(
            "<mujoco><asset><mesh name='m' vertex='0 0 0 1 0 0 0 1 0 0 0 1' face='{face}'/></asset>\
             <worldbody><body><freejoint/>{geometries}</body></worldbody></mujoco>"
        )
    };
    let good = "0 2 1 0 1 3 0 3 2 1 2 3";
    let robot = read(&mesh(good, 300)).unwrap();
    assert!((robot.mass_kg() - 300.0 * 1000.0 / 6.0).abs() < 1e-3 * robot.mass_kg());
    let made = robot.scene(&SceneOptions::default()).unwrap();
    assert!(made.notes.iter().any(|note| note.contains("300 pieces")), "{:?}", made.notes);
    for bad in ["0 2 1 -5 1 3", "0 2 1 1.7 2 3", "0 2 1 4 1 3", "0 2 1 1e30 1 3", "0 2"] {
        assert!(refused(&mesh(bad, 1)).contains("numbers of corners"), "{bad}");
    }
}

#[test]
fn limits_count_where_they_rise() {
    let limited = |joint: &str| {
        let text = format!(
            "<mujoco><worldbody><body><joint {joint}/><geom size='.1'/></body></worldbody></mujoco>"
        );
        read(&text).map(|robot| matches!(robot.joints[0].kind, JointKind::Revolute { .. }))
    };
    assert!(limited("range='-1 1'").unwrap());
    for free in ["range='0 0'", "range='1 1'", "range='2 1'", "range='2 1' limited='false'"] {
        assert!(!limited(free).unwrap(), "{free}");
    }
    for bad in ["0 0", "2 1"] {
        let error = limited(&format!("range='{bad}' limited='true'")).unwrap_err();
        assert!(error.contains("a range that rises"), "{error}");
    }
    let urdf = "<robot name='r'><link name='a'/><link name='b'/><link name='c'/>\
        <joint name='j' type='revolute'><parent link='a'/><child link='b'/><limit effort='1' velocity='1'/></joint>\
        <joint name='p' type='planar'><parent link='b'/><child link='c'/><mimic joint='j'/></joint></robot>";
    let robot = read(urdf).unwrap();
    assert!(matches!(robot.joints[0].kind, JointKind::Continuous { .. }));
    assert!(robot.notes[0].contains("follows no other"), "{:?}", robot.notes);
}

#[test]
fn planes_that_touch_nothing_and_joints_between_scenery_are_none() {
    let plane = "<geom type='plane' size='1 1 1' pos='0 0 5'";
    let robot =
        world(&format!("{plane} contype='0' conaffinity='0'/>{}", format!("{plane}/>").repeat(9)));
    assert_eq!(robot.planes.len(), 9);
    assert!(robot.notes[0].contains("touches nothing"));
    let text = "<mujoco><worldbody><geom type='box' size='1 1 .1'/><body name='post' pos='0 0 1'><geom size='.1'/></body>\
         <body name='b' pos='0 0 3'><joint/><geom size='.1'/></body></worldbody></mujoco>";
    for merge_fixed in [false, true] {
        let mut options = LoadOptions::default();
        options.merge_fixed = merge_fixed;
        let robot = parse_robot("r.xml".as_ref(), text.as_bytes(), &options).unwrap();
        let made = robot.scene(&SceneOptions::default()).unwrap();
        assert_eq!((made.scene.units().len(), made.held.len()), (3, 1));
        assert_eq!((made.scene.pivots().len(), made.notes.len()), (1, 0), "{:?}", made.notes);
    }
    let both = robot.scene(&SceneOptions::default());
    assert!(both.unwrap_err().to_string().contains("no link"));
}

#[test]
fn files_are_read_below_a_robots_folders_alone() {
    let folder = tempfile::tempdir().unwrap();
    let cube = "v 0 0 0\nv 0 0 1\nv 0 1 0\nv 0 1 1\nv 1 0 0\nv 1 0 1\nv 1 1 0\nv 1 1 1\n\
                f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n";
    let mesh = folder.path().join("pack/m.obj");
    fs::create_dir_all(mesh.parent().unwrap()).unwrap();
    fs::write(&mesh, cube).unwrap();
    let robot = |uri: &str| {
        format!(
            "<robot name='r'><link name='a'><visual><geometry><mesh filename='{uri}'/></geometry></visual></link></robot>"
        )
    };
    let outside = robot(mesh.to_str().unwrap());
    for name in ["a/b/c/d/e/r.urdf", "/none.urdf", "/none/of/these.urdf"] {
        let read = parse_robot(name.as_ref(), outside.as_bytes(), &LoadOptions::default());
        let error = read.unwrap_err().to_string();
        assert!(error.contains("outside of the robot's folders"), "{name}: {error}");
    }
    let inner = folder.path().join("pack/urdf");
    fs::create_dir_all(&inner).unwrap();
    let file = folder.path().join("r.urdf");
    fs::write(&file, robot("package://pack/m.obj")).unwrap();
    let mut options = LoadOptions::default();
    // A folder that is said by `..` has a name.
    options.package_paths = vec![inner.join("..")];
    let read = load_robot_with(&file, &options).unwrap();
    assert_eq!(read.files, [mesh.canonicalize().unwrap()]);
}
