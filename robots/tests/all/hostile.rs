use std::path::Path;

use rigidformer_robots::{LoadOptions, load_robot, load_robot_with, parse_robot};

fn refused(name: &str, bytes: &[u8]) -> String {
    parse_robot(Path::new(name), bytes, &LoadOptions::default()).unwrap_err().to_string()
}

#[test]
fn other_formats_are_named_with_a_remedy() {
    for (name, expected) in [
        ("a.sdf", "SDF"),
        ("a.usda", "USD"),
        ("a.xacro", "xacro FILE"),
        ("a.mjb", "MJCF that it was made of"),
    ] {
        let error = refused(name, b"<robot/>");
        assert!(error.contains(expected), "{error}");
    }
    assert!(refused("a.xml", b"<sdf version='1.6'/>").contains("SDF"));
    assert!(refused("a.xml", b"<html/>").contains("neither URDF nor MJCF"));
}

#[test]
fn bombs_depth_and_noise_end_in_errors() {
    let bomb = b"<!DOCTYPE r [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;'>]><robot name='&b;'/>";
    assert!(refused("a.urdf", bomb).contains("XML is not read"));
    let deep = "<mujoco><worldbody>".to_owned()
        + &"<body>".repeat(5000)
        + &"</body>".repeat(5000)
        + "</worldbody></mujoco>";
    assert!(refused("a.xml", deep.as_bytes()).contains("too deeply"));
    let deep = "<mujoco>".to_owned() + &"<default class='a'>".repeat(100_000);
    assert!(refused("a.xml", deep.as_bytes()).contains("XML is not read"));
    let wide = format!("<mujoco><worldbody>{}</worldbody></mujoco>", "<body/>".repeat(3000));
    assert!(refused("a.xml", wide.as_bytes()).contains("more than 2000 links"));
    let attributes: String = (0..100_000).map(|n| format!(" a{n}='1'")).collect();
    assert!(
        refused("a.urdf", format!("<robot{attributes}/>").as_bytes())
            .contains("too many attributes")
    );
    for bytes in [&b""[..], b"\xff\xfe", b"<robot", b"\0\0\0\0", b"<robot name='r'><link/></robot>"]
    {
        refused("a.urdf", bytes);
    }
}

#[test]
fn includes_end_and_meshes_stay_in_their_folders() {
    let folder = tempfile::tempdir().unwrap();
    let deep = folder.path().join("a/b/c/d/e/f");
    std::fs::create_dir_all(&deep).unwrap();
    let file = deep.join("self.xml");
    std::fs::write(&file, "<mujoco><include file='self.xml'/></mujoco>").unwrap();
    let error = load_robot(&file).unwrap_err().to_string();
    assert!(error.contains("a second include"), "{error}");
    std::fs::write(folder.path().join("secret.obj"), "v 0 0 0\nsecret").unwrap();
    let file = deep.join("robot.urdf");
    let mesh = |uri: &str| {
        let geometry =
            format!("<collision><geometry><mesh filename=\"{uri}\"/></geometry></collision>");
        std::fs::write(&file, format!("<robot name='r'><link name='a'>{geometry}</link></robot>"))
            .unwrap();
        let mut options = LoadOptions::default();
        options.skip_missing_meshes = false;
        load_robot_with(&file, &options).unwrap_err().to_string()
    };
    assert!(mesh("../../../../../../secret.obj").contains("outside of the robot's folders"));
    assert!(mesh("/dev/zero").contains("not found"));
    std::fs::write(deep.join("a.txt"), "hello").unwrap();
    assert!(mesh("a.txt").contains("no STL, OBJ"));
    std::fs::write(deep.join("a.stl"), "solid").unwrap();
    let error = mesh("a.stl");
    assert!(error.contains("robot.urdf:1: mesh") && error.contains("a.stl"), "{error}");
    std::fs::write(deep.join("a.msh"), [255; 64]).unwrap();
    assert!(mesh("a.msh").contains("MSH"));
}
