//! Robots of unknown quality: URDF and MJCF with an included file and a mesh of any format, beside each other.

use crate::files::{folder, parts, written};
use rigidformer_robots::{LoadOptions, MeshSetOptions, SceneOptions, load_meshes, load_robot_with};

/// Handles an input: a byte of options, then three parts: an included file, a mesh, the robot.
pub fn run(data: &[u8]) {
    let Some((kind, rest)) = data.split_first() else { return };
    let [included, mesh, robot] = parts(rest, 2)[..] else { return };
    written("part.xml", included);
    let end = ["stl", "obj", "dae", "msh"][usize::from(kind / 4) % 4];
    // The robot names all of them.
    let meshes = folder().join("meshes");
    std::fs::create_dir_all(&meshes).expect("a folder");
    for other in ["stl", "obj", "dae", "msh"] {
        let _ = std::fs::remove_file(meshes.join(format!("a.{other}")));
    }
    std::fs::write(meshes.join(format!("a.{end}")), mesh).expect("room");
    if kind % 4 == 3 {
        let found = load_meshes(&meshes, &MeshSetOptions::default());
        if let Ok(found) = found {
            follow(&found);
        }
    }
    let mut options = LoadOptions::default();
    options.merge_fixed = kind % 2 == 1;
    options.balance_inertia = kind & 64 != 0;
    options.skip_missing_meshes = kind & 128 == 0;
    if let Ok(robot) = load_robot_with(&written("robot.xml", robot), &options) {
        follow(&robot);
    }
}

/// What is read has finite poses and moments, and makes a scene or says why not.
fn follow(robot: &rigidformer_robots::Robot) {
    let rest = robot.rest();
    let poses = robot.poses(&rest).expect("poses at rest");
    assert_eq!(poses.len(), robot.links.len(), "a pose a link");
    let numbers =
        poses.iter().flat_map(|pose| pose.translation.vector.iter().copied().collect::<Vec<f64>>());
    assert!(numbers.into_iter().all(f64::is_finite), "a place that is not finite");
    for link in &robot.links {
        assert!(link.surface.is_sound(), "a surface with a corner that is not there");
        let inertia = &link.inertia;
        assert!(
            inertia.mass_kg >= 0.0 && inertia.about_centre.iter().all(|m| m.is_finite()),
            "{inertia:?}"
        );
    }
    for joint in &robot.joints {
        assert!(
            joint.parent < robot.links.len() && joint.child < robot.links.len(),
            "a joint to nowhere"
        );
    }
    robot.describe().expect("a description");
    let mut options = SceneOptions::default();
    options.points = 8;
    options.principal_frames = robot.links.len() % 2 == 0;
    if let Ok(made) = robot.scene(&options) {
        assert_eq!(made.links.len(), made.scene.units().len(), "a link a unit");
    }
}
