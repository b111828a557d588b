//! Scene files: a written scene comes back unchanged, and every kind of damage has its own answer.

use std::path::Path;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rigidformer_core::{Compliance, ContactLaw, Physics, Plane, Role};
use rigidformer_evaluation::convex_pieces::ConvexPieces;
use rigidformer_evaluation::scenes::{
    Dataset, Problem, RecordedBond, RecordedScene, RecordedUnit, SceneNotes, SoftMesh, Split,
    Velocity, write_scene,
};
use rigidformer_runtime::memory::Budget;
use rigidformer_runtime::terrain::HeightFieldBuf;

fn unit(offset: f32, points: usize) -> RecordedUnit {
    let pose = |frame: usize| {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, 0.3) * frame as f32);
        Isometry3::from_parts(Vector3::new(offset, 0.0, 5.0 - 0.01 * frame as f32).into(), turn)
    };
    let points = (0..points).map(|i| Point3::new(i as f32, (i * i) as f32, -(i as f32))).collect();
    let physics = Physics { mass_kg: 1.0 + offset, friction: 0.4, restitution: 0.3 };
    RecordedUnit::new(format!("shape {offset}"), points, physics, (0..12).map(pose).collect())
}

fn scene() -> RecordedScene {
    let gravity = Vector3::new(0.0, 0.0, -10.0);
    let units = vec![unit(0.0, 4), unit(2.5, 7)];
    RecordedScene::new("drop seed 42", 42, Split::Validation, 240.0, gravity, units)
        .unwrap()
        .with_planes(vec![Plane::ground(0.3, 0.5)])
        .unwrap()
}

fn notes() -> SceneNotes {
    SceneNotes {
        dataset: "drop".into(),
        provenance: "a test with a \"quote\"".into(),
        licence: "none".into(),
    }
}

fn encoded(scene: &RecordedScene) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.safetensors");
    write_scene(&path, scene, &notes()).unwrap();
    std::fs::read(path).unwrap()
}

fn written() -> Vec<u8> {
    encoded(&scene())
}

#[test]
fn units_and_scenes_count_together() {
    // 20 units of 120 kB.
    let scene = RecordedScene::new(
        "many",
        1,
        Split::Test,
        240.0,
        Vector3::new(0.0, 0.0, -10.0),
        vec![unit(0.0, 10_000); 20],
    );
    let scene = scene.unwrap().with_planes(Vec::new()).unwrap();
    let dataset = Dataset::from_bytes("many", encoded(&scene)).unwrap();
    let error = dataset.scene_within(0, None, &mut Budget::new(2 << 20)).unwrap_err();
    assert!(matches!(error.problem, Problem::Memory(_)), "{error}");
    assert!(error.to_string().contains("--memory"), "{error}");
    let mut budget = Budget::new(4 << 20);
    assert!(dataset.scene_within(0, None, &mut budget).is_ok());
    assert!(dataset.scene_within(0, None, &mut budget).is_err(), "a second scene");
}

/// The problem that opening `bytes`, or reading its first scene, ends in.
fn problem(bytes: Vec<u8>) -> (String, Problem) {
    let error = match Dataset::from_bytes("x.safetensors", bytes) {
        Err(error) => error,
        Ok(dataset) => dataset.scene(0, None).expect_err("damaged, and read all the same"),
    };
    assert!(error.to_string().starts_with("x.safetensors: "), "{error}");
    (error.field, error.problem)
}

fn replaced(from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let mut bytes = written();
    let at = bytes
        .windows(from.len())
        .position(|window| window == from.as_bytes())
        .expect("text to replace");
    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    bytes
}

/// The file with an element of a tensor overwritten.
fn overwritten<const N: usize>(tensor: &str, element: usize, value: [u8; N]) -> Vec<u8> {
    damaged(written(), tensor, element, value)
}

fn damaged<const N: usize>(
    mut bytes: Vec<u8>,
    tensor: &str,
    element: usize,
    value: [u8; N],
) -> Vec<u8> {
    let header_bytes = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header: serde_json::Value = serde_json::from_slice(&bytes[8..8 + header_bytes]).unwrap();
    let start = header[tensor]["data_offsets"][0].as_u64().unwrap() as usize;
    let at = 8 + header_bytes + start + element * N;
    bytes[at..at + N].copy_from_slice(&value);
    bytes
}

#[test]
fn a_written_scene_comes_back_unchanged() {
    assert_eq!(written(), written(), "the same scene gives the same bytes");
    let dataset = Dataset::from_bytes("x", written()).unwrap();
    assert_eq!((dataset.name(), dataset.len(), dataset.frames()), ("drop", 1, 12));
    assert_eq!(dataset.provenance(), "a test with a \"quote\"");
    assert_eq!(dataset.scene(0, None).unwrap(), scene());
    assert_eq!(dataset.scene(0, Some(5)).unwrap(), scene().truncated(5));
    assert_eq!(dataset.scenes_of(Split::Validation), [0]);
    assert!(dataset.scenes_of(Split::Test).is_empty());
}

#[test]
fn every_truncation_is_refused() {
    let bytes = written();
    for length in 0..bytes.len() {
        let (field, problem) = problem(bytes[..length].to_vec());
        assert!(
            field == "file" && matches!(problem, Problem::NotSafetensors(_)),
            "{length}: {problem}"
        );
    }
    let longer = [bytes, vec![0]].concat();
    assert!(matches!(problem(longer), (_, Problem::NotSafetensors(_))));
}

#[test]
fn foreign_and_newer_files_are_named() {
    let (field, found) = problem(replaced("rigidformer-scenes", "rigidformer-sceneX"));
    assert!(field == "metadata format" && matches!(found, Problem::Foreign { .. }));
    let (field, found) = problem(replaced("\"version\":\"1\"", "\"version\":\"3\""));
    assert!(field == "metadata version" && matches!(found, Problem::Foreign { .. }));
    assert!(found.to_string().contains("1 or 2"), "{found}");
    let (field, found) = problem(replaced("\"version\":\"1\"", "\"version\":\"2\""));
    assert!(field == "tensor planes" && matches!(found, Problem::Missing), "{found}");
    let (field, found) = problem(replaced("\"licence\"", "\"licenXX\""));
    assert!(field == "metadata licence" && matches!(found, Problem::Missing));
    let (field, found) = problem(replaced("unit_poses", "unit_posts"));
    assert!(field == "tensor unit_poses" && matches!(found, Problem::Missing));
    let (field, found) = problem(replaced("0 0 -10", "0 0  ten"[..7].into()));
    assert!(field == "metadata gravity_m_s2" && matches!(found, Problem::Unparsable { .. }));
    let (field, found) = problem(replaced("\"240\"", "\"-24\""));
    assert!(field == "metadata frame_rate_hz" && matches!(found, Problem::Unparsable { .. }));
    let (field, found) = problem(replaced("\"dtype\":\"I32\"", "\"dtype\":\"F32\""));
    assert!(field == "tensor unit_shape" && matches!(found, Problem::WrongTensor { .. }));
}

#[test]
fn bad_values_are_found_with_their_row() {
    let (field, found) = problem(overwritten("shape_points", 5, f32::NAN.to_le_bytes()));
    assert!(
        field == "tensor shape_points" && matches!(found, Problem::BadValue { row: 1, .. }),
        "{found}"
    );
    let (field, found) = problem(overwritten("shape_offsets", 1, (-4i64).to_le_bytes()));
    assert!(
        field == "tensor shape_offsets" && matches!(found, Problem::NotRising { .. }),
        "{found}"
    );
    let (field, found) = problem(overwritten("scene_units", 1, 3i64.to_le_bytes()));
    assert!(
        field == "tensor scene_units" && matches!(found, Problem::NotRising { total: 2 }),
        "{found}"
    );
    let (field, found) = problem(overwritten("unit_shape", 1, 2i32.to_le_bytes()));
    assert!(
        field == "tensor unit_shape" && matches!(found, Problem::BadValue { row: 1, .. }),
        "{found}"
    );
    let (field, found) = problem(overwritten("unit_scale", 0, 0f32.to_le_bytes()));
    assert!(
        field == "tensor unit_scale" && matches!(found, Problem::BadValue { row: 0, .. }),
        "{found}"
    );
    let (field, found) = problem(overwritten("unit_physics", 3, (-1f32).to_le_bytes()));
    assert!(
        field == "tensor unit_physics" && matches!(found, Problem::BadValue { row: 1, .. }),
        "{found}"
    );
    let (field, found) = problem(overwritten("scene_split", 0, [4]));
    assert!(
        field == "tensor scene_split" && matches!(found, Problem::BadValue { row: 0, .. }),
        "{found}"
    );
}

#[test]
fn bad_poses_are_found_with_unit_and_frame() {
    let at = |unit: usize, frame: usize, number: usize| (unit * 12 + frame) * 7 + number;
    let (field, found) =
        problem(overwritten("unit_poses", at(1, 3, 0), f32::INFINITY.to_le_bytes()));
    assert_eq!(field, "tensor unit_poses, scene 0 (seed 42)");
    assert!(matches!(found, Problem::BadPose { unit: 1, frame: 3, .. }), "{found}");
    let (_, found) = problem(overwritten("unit_poses", at(0, 11, 4), 2f32.to_le_bytes()));
    assert!(matches!(found, Problem::BadPose { unit: 0, frame: 11, .. }), "{found}");
}

#[test]
fn scenes_and_frames_that_are_not_there() {
    let dataset = Dataset::from_bytes("x", written()).unwrap();
    assert!(matches!(
        dataset.scene(1, None).unwrap_err().problem,
        Problem::NoSuchScene { index: 1, scenes: 1 }
    ));
    assert!(matches!(
        dataset.scene(usize::MAX, None).unwrap_err().problem,
        Problem::NoSuchScene { .. }
    ));
    let problem = dataset.scene(0, Some(13)).unwrap_err().problem;
    assert!(matches!(problem, Problem::TooFewFrames { recorded: 12, asked: 13 }));
    assert!(dataset.scene(0, Some(0)).is_err());
    let error = Dataset::open(Path::new("/nowhere/at all")).err().unwrap();
    assert!(error.to_string().contains("/nowhere/at all: file: cannot be read"), "{error}");
    let error = Dataset::open(&std::env::temp_dir()).err().unwrap();
    assert!(error.to_string().contains("directory"), "{error}");
}

#[test]
fn random_damage_never_panics() {
    let bytes = written();
    let mut state = 1u64;
    let mut next = |below: usize| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % below
    };
    for _ in 0..20_000 {
        let mut damaged = bytes.clone();
        for _ in 0..=next(4) {
            let at = next(damaged.len());
            damaged[at] = next(256) as u8;
        }
        if let Ok(dataset) = Dataset::from_bytes("x", damaged) {
            let _ = (dataset.scene(0, None), dataset.scene(1, Some(1)));
        }
    }
}

/// Pieces of 4 and 5 points.
fn two_pieces() -> ConvexPieces {
    let piece = |count: usize| unit(0.0, count).points;
    [piece(4), piece(5)].into_iter().collect()
}

/// A scene of version 2 with everything that version 1 has not.
const FOAM: Compliance = Compliance { stiffness_n_m: 500.0, dissipation_s_m: 0.5 };

fn everything() -> RecordedScene {
    everything_as_stiff_as([Some(4e5), Some(5e4)])
}

/// As [`everything`], with these moduli of its soft units.
fn everything_as_stiff_as([sheet, block]: [Option<f32>; 2]) -> RecordedScene {
    let soft_points = |count: usize| {
        let frame = |frame: usize| {
            (0..count).map(|i| Point3::new(i as f32, 0.1 * frame as f32, 2.0)).collect()
        };
        (0..12).map(frame).collect()
    };
    let mut shelf = unit(6.0, 5).with_role(Role::Fixed);
    shelf.poses.fill(Isometry3::translation(6.0, 0.5, 1.0));
    let units = vec![
        unit(0.0, 4).with_body(7).with_inertia([2e-3, 3e-3, 4e-3]).with_compliance(FOAM),
        RecordedUnit { young_pa: sheet, ..unit(1.0, 6) }
            .with_soft(soft_points(6))
            .with_pieces(two_pieces()),
        unit(2.5, 7).with_role(Role::Driven).with_body(7),
        shelf,
        RecordedUnit { young_pa: block, ..unit(8.0, 4) }.with_soft(soft_points(4)).with_body(65534),
    ];
    let units = units.into_iter().enumerate().map(|(number, unit)| {
        unit.with_velocity(Velocity {
            linear_m_s: Vector3::new(number as f32, 0.5, -1.0),
            angular_rad_s: Vector3::new(0.1, 0.2, 0.3),
        })
    });
    let units = units.collect();
    let gravity = Vector3::new(0.0, 1.5, -3.7);
    let wall = Plane {
        normal: Vector3::new(-0.6, 0.0, 0.8),
        offset_m: -2.0,
        friction: 0.5,
        restitution: 0.25,
    };
    let commands = (0..24).map(|i| i as f32 * 0.5).collect();
    RecordedScene::new("drop seed 42", 42, Split::Extra, 59.94, gravity, units)
        .unwrap()
        .with_planes(vec![Plane::ground(0.3, 0.5), wall])
        .unwrap()
        .with_plane_compliance(vec![Compliance::RIGID, FOAM])
        .unwrap()
        .with_contact_law("0.25,pyramid".parse().unwrap())
        .unwrap()
        .with_height_field(Some(hills()))
        .unwrap()
        .with_commands(2, commands)
        .unwrap()
        .with_set_points(vec![false, true])
        .unwrap()
        .with_mesh(mesh())
        .unwrap()
        .with_bonds(bonds())
        .unwrap()
}

fn hills() -> HeightFieldBuf {
    HeightFieldBuf {
        heights_m: (0..12).map(|i| 0.1 * (i * i % 7) as f32).collect(),
        columns: 4,
        spacing_m: [0.5, 0.25],
        corner_m: Vector3::new(-1.0, -0.5, 0.125),
        friction: 0.75,
        restitution: 0.1,
    }
}

/// A mesh over the ten soft points of [`everything`], of which six are unit 1's.
fn mesh() -> SoftMesh {
    SoftMesh {
        faces: vec![[0, 1, 2], [3, 4, 5], [6, 7, 8]],
        edges: vec![[0, 1], [9, 8]],
        tetrahedra: vec![[6, 7, 8, 9]],
    }
}

fn bonds() -> Vec<RecordedBond> {
    let bond = |units, breaks_at| RecordedBond { units, breaks_at };
    vec![bond([0, 2], Some(7)), bond([4, 2], None), bond([0, 3], Some(0))]
}

/// What a file of [`everything`] ends in once an element is overwritten.
fn spoilt<const N: usize>(tensor: &str, element: usize, value: [u8; N]) -> (String, Problem) {
    problem(damaged(encoded(&everything()), tensor, element, value))
}

/// As [`spoilt`], with a text of the header replaced by one of the same length.
fn retold(from: &str, to: &str) -> (String, Problem) {
    problem(reworded(encoded(&everything()), from, to))
}

fn reworded(mut bytes: Vec<u8>, from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).expect(from);
    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    bytes
}

#[test]
fn a_scene_with_everything_comes_back_unchanged() {
    let bytes = encoded(&everything());
    assert_eq!(bytes, encoded(&everything()), "the same scene gives the same bytes");
    let dataset = Dataset::from_bytes("x", bytes).unwrap();
    assert_eq!(dataset.scene(0, None).unwrap(), everything());
    assert_eq!(dataset.scene(0, Some(5)).unwrap(), everything().truncated(5));
    assert_eq!((dataset.version(), dataset.command_size(), dataset.soft_units()), (2, 2, 2));
    assert_eq!(
        [Role::Free, Role::Driven, Role::Fixed].map(|role| dataset.units_in_role(role)),
        [3, 1, 1]
    );
    assert_eq!((dataset.bodies_of(0), dataset.units_with_inertia()), (Some((4, 2)), 1));
    assert_eq!(dataset.units_in_pieces(), 1);
    assert_eq!(dataset.planes_of(0), everything().planes());
    assert_eq!((dataset.young_pa(), dataset.soft_points()), (Some((5e4, 4e5)), 10));
    assert_eq!((dataset.mesh_sizes(), dataset.bonds()), ([3, 2, 1], (3, 2)));
    assert_eq!(dataset.scene(0, None).unwrap().bonds(), bonds());
    assert_eq!(dataset.contact_law(), everything().contact_law());
    assert!(dataset.planes_of(1).is_none() && dataset.ground().is_none());
}

#[test]
fn each_part_of_version_2_is_written_alone() {
    let alone = |scene: RecordedScene| {
        let dataset = Dataset::from_bytes("x", encoded(&scene)).unwrap();
        assert_eq!(dataset.scene(0, None).unwrap(), scene);
        dataset.version()
    };
    let with = |unit: RecordedUnit| {
        RecordedScene::new("drop seed 42", 42, Split::Test, 240.0, Vector3::zeros(), vec![unit])
            .unwrap()
            .with_planes(vec![Plane::ground(0.3, 0.5)])
            .unwrap()
    };
    assert_eq!(alone(with(unit(0.0, 4))), 1);
    let law = ContactLaw { restitution_offset: 0.03, ..ContactLaw::RIGID };
    assert_eq!(alone(with(unit(0.0, 4)).with_contact_law(law).unwrap()), 1);
    assert_eq!(alone(with(unit(0.0, 4).with_role(Role::Driven))), 2);
    assert_eq!(alone(with(unit(0.0, 4).with_body(0))), 2);
    assert_eq!(alone(with(unit(0.0, 4).with_soft(vec![vec![Point3::origin(); 4]; 12]))), 2);
    assert_eq!(alone(with(unit(0.0, 4).with_velocity(Velocity::default()))), 2);
    assert_eq!(alone(with(unit(0.0, 4).with_inertia([1e-4, 1e-4, 2e-4]))), 2);
    assert_eq!(alone(with(unit(0.0, 4).with_pieces(two_pieces()))), 2);
    assert_eq!(alone(with(unit(0.0, 4)).with_commands(1, vec![0.5; 12]).unwrap()), 2);
    assert_eq!(alone(with(unit(0.0, 4)).with_planes(Vec::new()).unwrap()), 2);
    let soft = || unit(0.0, 4).with_soft(vec![vec![Point3::origin(); 4]; 12]);
    assert_eq!(alone(with(soft().with_young(1e5))), 2);
    let tetrahedra = SoftMesh { tetrahedra: vec![[3, 1, 2, 0]], ..SoftMesh::default() };
    assert_eq!(alone(with(soft()).with_mesh(tetrahedra).unwrap()), 2);
    let raised = Plane { offset_m: 0.1, ..Plane::ground(0.3, 0.5) };
    assert_eq!(alone(with(unit(0.0, 4)).with_planes(vec![raised]).unwrap()), 2);
    assert_eq!(alone(with(unit(0.0, 4)).with_planes(vec![raised; 8]).unwrap()), 2);
}

#[test]
fn a_scene_of_version_1_is_written_to_the_same_bytes() {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/cli/scenes/default.safetensors");
    let dataset = Dataset::open(&path).unwrap();
    let notes = SceneNotes {
        dataset: dataset.name().into(),
        provenance: dataset.provenance().into(),
        licence: dataset.licence().into(),
    };
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("copy.safetensors");
    write_scene(&copy, &dataset.scene(0, None).unwrap(), &notes).unwrap();
    assert!(std::fs::read(copy).unwrap() == std::fs::read(path).unwrap(), "other bytes");
    assert_eq!((dataset.version(), dataset.ground()), (1, Some(Plane::ground(0.3, 0.5))));
    assert_eq!(dataset.planes_of(0), Some(&[Plane::ground(0.3, 0.5)][..]));
}

#[test]
fn a_scene_whose_planes_are_not_known_is_not_written() {
    let gravity = Vector3::zeros();
    let scene =
        RecordedScene::new("drop", 1, Split::Test, 240.0, gravity, vec![unit(0.0, 4)]).unwrap();
    assert!(scene.planes().is_none());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.safetensors");
    let error = write_scene(&path, &scene, &notes()).unwrap_err().to_string();
    assert!(error.contains("drop") && error.contains("with_planes"), "{error}");
    assert!(!path.exists());
}

#[test]
fn commands_of_a_step_are_the_mean_over_its_frames_or_the_last() {
    let scene = everything();
    assert_eq!(scene.command(3), Some(&[3.0, 3.5][..]));
    assert_eq!(scene.command(12), None);
    assert_eq!(scene.command_of_step(3, 4), Some(vec![3.0, 3.5]));
    assert_eq!(scene.command_of_step(0, 4), Some(vec![1.5, 3.5]));
    assert_eq!(scene.command_of_step(11, 12), Some(vec![11.0, 11.5]));
    for (from, to) in [(4, 4), (5, 4), (11, 13), (0, usize::MAX)] {
        assert_eq!(scene.command_of_step(from, to), None, "{from} to {to}");
    }
    let later = scene.clone().skipping(3);
    assert_eq!((later.frames(), later.command(0)), (9, Some(&[3.0, 3.5][..])));
    assert_eq!(later.pose(0, 2), scene.pose(3, 2));
    assert_eq!(later.units()[1].soft.as_ref().unwrap().len(), 9);
    assert_eq!(scene.clone().skipping(99).frames(), 1);
    let rates = scene.with_set_points(vec![false; 2]).unwrap();
    assert_eq!(rates.command_of_step(0, 4), Some(vec![1.5, 2.0]));
    assert!(rates.with_set_points(vec![true; 3]).is_err());
    let without = self::scene();
    assert!(without.set_points().is_empty());
    assert!(without.clone().with_set_points(Vec::new()).is_err());
    assert_eq!((without.command_size(), without.command(0)), (0, None));
    assert_eq!(without.command_of_step(0, 1), None);
}

#[test]
fn bad_roles_bodies_and_marks_are_found_with_their_row() {
    for (tensor, expected, (field, found)) in [
        ("unit_role", "2 (fixed)", spoilt("unit_role", 2, [3])),
        ("unit_body", "from 0 to 65534", spoilt("unit_body", 2, 65535i32.to_le_bytes())),
        ("unit_body", "-1 (a body of its own)", spoilt("unit_body", 2, (-2i32).to_le_bytes())),
        ("unit_soft", "1 (soft)", spoilt("unit_soft", 2, [2])),
    ] {
        assert_eq!(field, format!("tensor {tensor}"));
        assert!(matches!(found, Problem::BadValue { row: 2, .. }), "{found}");
        assert!(found.to_string().contains(expected), "{found}");
        assert!(found.remedy().contains("make the file again"));
    }
}

#[test]
fn bad_planes_are_found_with_their_row() {
    for (number, value, expected) in [
        (6, 0.7, "a normal of length 1"),
        (8, f32::NAN, "finite"),
        (9, f32::INFINITY, "finite"),
        (9, 2e6, "an offset"),
        (10, -0.1, "friction"),
        (11, -0.1, "restitution"),
    ] {
        let (field, found) = spoilt("planes", number, value.to_le_bytes());
        assert_eq!(field, "tensor planes");
        assert!(matches!(found, Problem::BadValue { row: 1, .. }), "{found}");
        assert!(found.to_string().contains(expected), "{found}");
    }
    for (row, value) in [(0, 1i64), (0, -1), (1, 3), (1, 1), (1, -5)] {
        let (field, found) = spoilt("scene_planes", row, value.to_le_bytes());
        assert_eq!(field, "tensor scene_planes");
        let problem = matches!(found, Problem::NotAscending { row: r, value: v, total: 2 }
            if r == row && v == value);
        assert!(problem, "{found}");
    }
    let (field, found) = retold("\"scene_planes\"", "\"scene_plains\"");
    assert!(field == "tensor scene_planes" && matches!(found, Problem::Missing), "{found}");
    let (field, found) = retold("\"planes\"", "\"plains\"");
    assert!(field == "tensor planes" && matches!(found, Problem::Missing), "{found}");
}

#[test]
fn at_most_eight_planes_a_scene() {
    let ground = Plane::ground(0.3, 0.5);
    let error = everything().with_planes(vec![ground; 9]).unwrap_err();
    assert!(error.to_string().contains("more than 8 planes"), "{error}");
    let slanted = Plane { normal: Vector3::new(0.0, 0.1, 1.0), ..ground };
    let error = everything().with_planes(vec![ground, slanted]).unwrap_err();
    assert!(matches!(error.problem, Problem::BadPlane { plane: 1 }), "{error}");

    // A file of 9 planes: rows are added to one of 8.
    let bytes = encoded(&everything().with_planes(vec![ground; 8]).unwrap());
    let header_bytes = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let mut header: serde_json::Value =
        serde_json::from_slice(&bytes[8..8 + header_bytes]).unwrap();
    let mut payload = bytes[8 + header_bytes..].to_vec();
    let end = header["planes"]["data_offsets"][1].as_u64().unwrap() as usize;
    let start = header["scene_planes"]["data_offsets"][0].as_u64().unwrap() as usize;
    payload[start + 8..start + 16].copy_from_slice(&9i64.to_le_bytes());
    let row = payload[end - 24..end].to_vec();
    payload.splice(end..end, row);
    header["planes"]["shape"][0] = 9.into();
    for tensor in header.as_object_mut().unwrap().values_mut() {
        for at in 0..2 {
            let Some(offset) = tensor["data_offsets"][at].as_u64() else { continue };
            if offset > end as u64 || (offset == end as u64 && at == 0) {
                tensor["data_offsets"][at] = (offset + 24).into();
            }
        }
    }
    header["planes"]["data_offsets"][1] = (end + 24).into();
    header["__metadata__"].as_object_mut().unwrap().remove("data_offsets");
    let header = header.to_string();
    let longer = [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &payload].concat();
    let (field, found) = problem(longer);
    assert_eq!(field, "tensor scene_planes");
    assert!(matches!(found, Problem::TooManyPlanes { scene: 0, planes: 9 }), "{found}");
    assert!(found.remedy().contains("8 planes"));
}

#[test]
fn a_fixed_unit_stays() {
    let at = |unit: usize, frame: usize, number: usize| (unit * 12 + frame) * 7 + number;
    let (field, found) = spoilt("unit_poses", at(3, 9, 2), 1.001f32.to_le_bytes());
    assert_eq!(field, "tensor unit_poses, scene 0 (seed 42)");
    assert!(matches!(found, Problem::FixedMoves { unit: 3, frame: 9 }), "{found}");
    assert!(found.remedy().contains("driven"));
    let gravity = Vector3::zeros();
    let units = vec![unit(0.0, 4), unit(1.0, 4).with_role(Role::Fixed)];
    let error = RecordedScene::new("drop", 1, Split::Test, 240.0, gravity, units).unwrap_err();
    assert!(matches!(error.problem, Problem::FixedMoves { unit: 1, frame: 1 }), "{error}");
}

#[test]
fn soft_points_match_their_units() {
    // Point 8 of all soft points is point 2 of unit 4.
    let (field, found) = spoilt("soft_points", (8 * 12 + 3) * 3 + 1, f32::NAN.to_le_bytes());
    assert_eq!(field, "tensor soft_points, scene 0 (seed 42)");
    assert!(matches!(found, Problem::BadValue { row: 8, .. }), "{found}");
    assert!(found.to_string().contains("frame 3"), "{found}");
    // Without moduli, which would have to be those of the marked units.
    let bytes = encoded(&everything_as_stiff_as([None, None]));
    for (unit, mark, expected) in [(1, 0, 4), (0, 1, 14)] {
        let (field, found) = problem(damaged(bytes.clone(), "unit_soft", unit, [mark]));
        assert_eq!(field, "tensor soft_points");
        let fits = matches!(found, Problem::SoftPoints { found: 10, expected: e } if e == expected);
        assert!(fits, "{found}");
        assert!(found.remedy().contains("every soft unit"));
    }
    let (field, found) = retold("\"soft_points\"", "\"soft_paints\"");
    assert!(field == "tensor soft_points" && matches!(found, Problem::Missing), "{found}");
    let (field, found) = problem(reworded(bytes, "\"unit_soft\"", "\"unit_sort\""));
    assert_eq!(field, "tensor soft_points");
    assert!(matches!(found, Problem::SoftPoints { found: 10, expected: 0 }), "{found}");
    let (field, found) = retold("\"shape\":[10,12,3]", "\"shape\":[12,10,3]");
    assert!(field == "tensor soft_points" && matches!(found, Problem::WrongTensor { .. }));

    let gravity = Vector3::zeros();
    for soft in [vec![vec![Point3::origin(); 3]; 12], vec![vec![Point3::origin(); 4]; 11]] {
        let units = vec![unit(0.0, 4).with_soft(soft)];
        let error = RecordedScene::new("drop", 1, Split::Test, 240.0, gravity, units).unwrap_err();
        assert!(matches!(error.problem, Problem::BadUnit { unit: 0, .. }), "{error}");
    }
}

#[test]
fn moduli_are_those_of_soft_units() {
    for (unit, young) in [(1, 0.0), (1, -4e5), (4, f32::NAN), (1, f32::INFINITY), (0, 1e5)] {
        let (field, found) = spoilt("unit_young", unit, young.to_le_bytes());
        assert_eq!(field, "tensor unit_young", "{young}");
        assert!(matches!(found, Problem::BadValue { row, .. } if row == unit), "{found}");
    }
}

/// A list of a soft body's mesh or of bonds: what is wrong is found with its row, before any scene is read.
#[test]
fn rows_of_meshes_and_bonds_are_different_points_and_units_of_their_scene() {
    // (tensor, element, value, row)
    let cases: [(&str, usize, i32, usize); 12] = [
        ("faces", 4, 10, 1),
        ("faces", 4, -1, 1),
        ("faces", 8, 6, 2),
        ("edges", 3, i32::MAX, 1),
        ("edges", 1, 0, 0),
        ("tetrahedra", 2, 10, 0),
        ("tetrahedra", 3, 7, 0),
        ("bonds", 1, 5, 0),
        ("bonds", 2, -4, 1),
        ("bonds", 5, 0, 2),
        ("bond_frame", 1, 13, 1),
        ("bond_frame", 2, -1, 2),
    ];
    for (tensor, element, value, expected) in cases {
        let bytes = damaged(encoded(&everything()), tensor, element, value.to_le_bytes());
        let error = Dataset::from_bytes("x", bytes).err().expect("damaged");
        assert_eq!(error.field, format!("tensor {tensor}"), "{value}");
        let is_found = matches!(error.problem, Problem::BadValue { row, .. } if row == expected);
        assert!(is_found, "{tensor} {value}: {error}");
        assert!(error.to_string().contains(&value.to_string()), "{error}");
    }
    for (tensor, element, value) in [
        ("scene_faces", 0, 1_i64),
        ("scene_faces", 1, 2),
        ("scene_edges", 1, 3),
        ("scene_tetrahedra", 1, -1),
        ("scene_bonds", 0, -1),
        ("scene_bonds", 1, 4),
    ] {
        let (field, found) = spoilt(tensor, element, value.to_le_bytes());
        assert_eq!(field, format!("tensor {tensor}"));
        let is_found = matches!(found, Problem::NotAscending { row, .. } if row == element);
        assert!(is_found, "{tensor} {value}: {found}");
    }
}

#[test]
fn lists_have_the_tensors_that_belong_to_them() {
    for (gone, missed) in [
        ("\"faces\"", "faces"),
        ("\"scene_edges\"", "scene_edges"),
        ("\"tetrahedra\"", "tetrahedra"),
        ("\"bonds\"", "bonds"),
        ("\"scene_bonds\"", "scene_bonds"),
        ("\"bond_frame\"", "bond_frame"),
    ] {
        let (field, found) = retold(gone, &gone.to_uppercase());
        assert_eq!(field, format!("tensor {missed}"));
        assert!(matches!(found, Problem::Missing), "{gone}: {found}");
    }
    let (field, found) = retold("\"shape\":[3,3]", "\"shape\":[9,1]");
    assert_eq!(field, "tensor faces");
    assert!(matches!(found, Problem::WrongTensor { .. }), "{found}");
}

#[test]
fn scenes_in_memory_have_sound_meshes_moduli_and_bonds() {
    let refused = |found: Result<RecordedScene, rigidformer_evaluation::scenes::SceneError>| {
        found.expect_err("unsound").problem
    };
    let faces = |row| SoftMesh { faces: vec![[0, 1, 2], row], ..SoftMesh::default() };
    for row in [[0, 1, 10], [4, 5, 4]] {
        let found = refused(everything().with_mesh(faces(row)));
        assert!(matches!(found, Problem::BadMesh { list: "faces", row: 1, .. }), "{found}");
    }
    let edges = SoftMesh { edges: vec![[3, 3]], ..SoftMesh::default() };
    let found = refused(everything().with_mesh(edges));
    assert_eq!(found.to_string(), "row 0 of edges names one of them twice");
    let tetrahedra = SoftMesh { tetrahedra: vec![[0, 1, 2, 99]], ..SoftMesh::default() };
    let found = refused(everything().with_mesh(tetrahedra));
    assert_eq!(found.to_string(), "row 0 of tetrahedra names what its scene does not have");
    for units in [[1, 1], [0, 5], [usize::MAX, 0]] {
        let bad = vec![bonds()[0], RecordedBond { units, breaks_at: None }];
        let found = refused(everything().with_bonds(bad));
        assert!(matches!(found, Problem::BadBond { bond: 1, .. }), "{found}");
        assert!(!found.remedy().is_empty());
    }
    let soft = || unit(0.0, 4).with_soft(vec![vec![Point3::origin(); 4]; 12]);
    let units = vec![soft().with_young(1e5), unit(0.0, 4), soft()];
    let found = refused(RecordedScene::new("x", 1, Split::Test, 60.0, Vector3::zeros(), units));
    assert!(found.to_string().contains("modulus of every soft unit"), "{found}");
}

#[test]
fn bonds_break_at_their_frame_of_what_is_left() {
    let scene = everything();
    assert_eq!(scene.clusters_at(6), [0, 1, 0, 3, 0]);
    assert_eq!(scene.clusters_at(7), [0, 1, 2, 3, 2]);
    assert_eq!(scene.clusters_at(1000), [0, 1, 2, 3, 2]);
    let frames = |scene: &RecordedScene| -> Vec<Option<usize>> {
        scene.bonds().iter().map(|bond| bond.breaks_at).collect()
    };
    assert_eq!(frames(&scene.clone().truncated(8)), [Some(7), None, Some(0)]);
    assert_eq!(frames(&scene.clone().truncated(7)), [None, None, Some(0)]);
    assert_eq!(frames(&scene.clone().skipping(3)), [Some(4), None, Some(0)]);
    assert_eq!(frames(&scene.skipping(11)), [Some(0), None, Some(0)]);
}

#[test]
fn commands_match_scenes_and_frames() {
    let (field, found) = spoilt("commands", 7, f32::NAN.to_le_bytes());
    assert_eq!(field, "tensor commands");
    assert!(matches!(found, Problem::BadValue { row: 0, .. }), "{found}");
    for shape in ["[2,12,1]", "[1,24,1]", "[12,1,2]"] {
        let (field, found) = retold("\"shape\":[1,12,2]", &format!("\"shape\":{shape}"));
        assert_eq!(field, "tensor commands");
        assert!(matches!(found, Problem::WrongTensor { .. }), "{found}");
        assert!(found.to_string().contains("[1, 12, any]"), "{found}");
    }
    let (field, found) = spoilt("command_last", 1, [2]);
    assert_eq!(field, "tensor command_last");
    assert!(matches!(found, Problem::BadValue { row: 1, .. }), "{found}");
    let (field, found) = retold("\"commands\":", "\"commandx\":");
    assert!(field == "tensor commands" && matches!(found, Problem::Missing), "{field}: {found}");
    for (size, values) in [(0, vec![]), (2, vec![0.0; 12]), (1, vec![f32::NAN; 12])] {
        let error = scene().with_commands(size, values).unwrap_err();
        assert!(error.to_string().contains("command of the same size"), "{error}");
    }
}

#[test]
fn velocities_are_of_every_unit_and_of_frame_0() {
    assert!(everything().has_velocities() && !scene().has_velocities());
    assert!(
        everything().skipping(0).has_velocities() && !everything().skipping(1).has_velocities()
    );
    assert!(Dataset::from_bytes("x", encoded(&everything())).unwrap().has_velocities());
    assert!(!Dataset::from_bytes("x", written()).unwrap().has_velocities());
    let (field, found) = spoilt("unit_velocity", 6 + 2, f32::NAN.to_le_bytes());
    assert_eq!(field, "tensor unit_velocity");
    assert!(matches!(found, Problem::BadValue { row: 1, .. }), "{found}");
    let (field, found) = retold("\"shape\":[5,6]", "\"shape\":[6,5]");
    assert!(field == "tensor unit_velocity" && matches!(found, Problem::WrongTensor { .. }));

    let units = vec![unit(0.0, 4).with_velocity(Velocity::default()), unit(2.5, 4)];
    let gravity = Vector3::zeros();
    let error = RecordedScene::new("drop", 1, Split::Test, 240.0, gravity, units).unwrap_err();
    assert!(error.to_string().contains("of every unit, or of none"), "{error}");
    let endless = Velocity { linear_m_s: Vector3::repeat(f32::INFINITY), ..Velocity::default() };
    let units = vec![unit(0.0, 4).with_velocity(endless)];
    let error = RecordedScene::new("drop", 1, Split::Test, 240.0, gravity, units).unwrap_err();
    assert!(error.to_string().contains("finite points, poses and velocities"), "{error}");
}

#[test]
fn pieces_are_counted_and_finite() {
    let (field, found) = spoilt("piece_points", 13, f32::NAN.to_le_bytes());
    assert_eq!(field, "tensor piece_points");
    assert!(matches!(found, Problem::BadValue { row: 4, .. }), "{found}");
    // A piece in another unit of length.
    let (field, found) = spoilt("piece_points", 13, 1e6_f32.to_le_bytes());
    assert_eq!(field, "tensor shape_pieces");
    assert!(found.to_string().contains("both in metres"), "{found}");
    // 0, 4, 9: a piece of 3 points, and one that ends before it starts.
    for (element, value) in [(1, 3), (1, 10), (2, 8), (0, 1)] {
        let (field, found) = spoilt("piece_offsets", element, i64::to_le_bytes(value));
        assert_eq!(field, "tensor piece_offsets", "{found}");
    }
    for (element, value) in [(5, 1), (5, 3), (1, -1)] {
        let (field, found) = spoilt("shape_pieces", element, i64::to_le_bytes(value));
        assert_eq!(field, "tensor shape_pieces", "{found}");
    }
    let (field, found) = retold("\"shape_pieces\"", "\"shape_peaces\"");
    assert!(field == "tensor shape_pieces" && matches!(found, Problem::Missing), "{found}");
    let many: ConvexPieces = (0..33).map(|_| unit(0.0, 4).points).collect();
    let small: ConvexPieces = [unit(0.0, 3).points].into_iter().collect();
    let mut endless = unit(0.0, 4).points;
    endless[2].y = f32::INFINITY;
    let endless: ConvexPieces = [endless].into_iter().collect();
    let mut far = unit(0.0, 4).points;
    far[2].y = 1e6;
    let far: ConvexPieces = [far].into_iter().collect();
    let wrong = [(many, "32"), (small, "4 to 255"), (endless, "finite"), (far, "both in metres")];
    for (pieces, text) in wrong {
        let units = vec![unit(2.5, 4).with_pieces(pieces)];
        let gravity = Vector3::zeros();
        let error = RecordedScene::new("drop", 1, Split::Test, 240.0, gravity, units).unwrap_err();
        assert!(matches!(error.problem, Problem::BadUnit { unit: 0, .. }), "{error}");
        assert!(error.to_string().contains(text), "{error}");
    }
}

#[test]
fn moments_of_inertia_are_those_of_a_body_or_zeros() {
    for (element, value) in [(0, f32::NAN), (1, 0.0), (2, -4e-3), (2, 5.1e-3), (5, 1e-3)] {
        let (field, found) = spoilt("unit_inertia", element, value.to_le_bytes());
        assert_eq!(field, "tensor unit_inertia");
        let row = element / 3;
        assert!(matches!(found, Problem::BadValue { row: at, .. } if at == row), "{found}");
        let text = if value.is_nan() { "finite" } else { "sum of the other two" };
        assert!(found.to_string().contains(text), "{found}");
    }
    let (field, found) = retold("\"shape\":[5,3]", "\"shape\":[3,5]");
    assert!(field == "tensor unit_inertia" && matches!(found, Problem::WrongTensor { .. }));
    for moments in [[0.0; 3], [1.0, f32::INFINITY, 1.0], [1.0, 1.0, 2.1]] {
        let units = vec![unit(0.0, 4), unit(2.5, 4).with_inertia(moments)];
        let gravity = Vector3::zeros();
        let error = RecordedScene::new("drop", 1, Split::Test, 240.0, gravity, units).unwrap_err();
        assert!(matches!(error.problem, Problem::BadUnit { unit: 1, .. }), "{error}");
        assert!(error.to_string().contains("moments of inertia"), "{error}");
    }
}

#[test]
fn compliance_is_in_its_range() {
    for name in ["unit_compliance", "plane_compliance"] {
        for (element, value) in [(2, 1e-4), (2, -1.0), (2, 2e12), (3, -0.5), (1, 1e7)] {
            let (field, found) = spoilt(name, element, f32::to_le_bytes(value));
            assert_eq!(field, format!("tensor {name}"));
            let row = element / 2;
            assert!(matches!(found, Problem::BadValue { row: at, .. } if at == row), "{found}");
            assert!(found.to_string().contains("stiffness"), "{found}");
        }
    }
    let bad = Compliance { stiffness_n_m: -1.0, ..FOAM };
    let units = vec![unit(0.0, 4).with_compliance(bad)];
    let made = RecordedScene::new("drop", 1, Split::Test, 240.0, Vector3::zeros(), units);
    assert!(matches!(made.unwrap_err().problem, Problem::BadUnit { unit: 0, .. }));
    let of_planes = |all: Vec<Compliance>| everything().with_plane_compliance(all).unwrap_err();
    assert!(matches!(of_planes(vec![FOAM]).problem, Problem::Inconsistent(_)));
    let found = of_planes(vec![FOAM, bad]).problem;
    assert!(matches!(found, Problem::BadPlaneCompliance { plane: 1 }), "{found}");
    // What is infinitely stiff is rigid, which files say by 0.
    let stiff = Compliance { stiffness_n_m: f32::INFINITY, ..FOAM };
    let scene = everything().with_plane_compliance(vec![stiff, FOAM]).unwrap();
    let read = Dataset::from_bytes("stiff", encoded(&scene)).unwrap().scene(0, None).unwrap();
    assert!(read.plane_compliance()[0].is_rigid() && read.plane_compliance()[1] == FOAM);
    // New planes are rigid.
    let scene = everything().with_planes(vec![Plane::ground(0.3, 0.5)]).unwrap();
    assert!(scene.plane_compliance().is_empty());
}

#[test]
fn contact_laws_out_of_range_are_refused() {
    for law in [
        "1.25,pyramid",
        "-.25,pyramid",
        "nan,,pyramid",
        "0.25,pyramix",
        "0.25;pyramid",
        "0.25pyramid,",
    ] {
        let (field, found) = retold("0.25,pyramid", law);
        assert!(field == "metadata contact_law" && matches!(found, Problem::Unparsable { .. }));
        assert!(found.to_string().contains("a number from 0 to 1"), "{found}");
    }
    for restitution_offset in [-0.1, 1.5, f32::NAN] {
        let law = ContactLaw { restitution_offset, ..ContactLaw::RIGID };
        let found = everything().with_contact_law(law).unwrap_err();
        assert!(matches!(found.problem, Problem::BadContactLaw));
        assert!(found.to_string().contains("from 0 to 1"), "{found}");
    }
    // Scenes with rigid contact have no such entry.
    let text = |scene: &RecordedScene| String::from_utf8_lossy(&encoded(scene)).into_owned();
    assert!(text(&everything()).contains("contact_law"));
    let rigid = everything().with_contact_law(ContactLaw::RIGID).unwrap();
    assert!(!text(&rigid).contains("contact_law"));
}

#[test]
fn a_height_field_is_read_back_or_refused() {
    let bytes = encoded(&everything());
    let dataset = Dataset::from_bytes("x", bytes).unwrap();
    assert_eq!(dataset.height_field_of(0), Some(&hills()));
    assert_eq!(dataset.scene(0, None).unwrap().height_field(), Some(&hills()));
    assert_eq!(dataset.height_field_of(1), None);
    // Rows, columns, spacing, corner, friction.
    for (element, value, text) in [
        (0, 2.5, "whole numbers of rows and columns"),
        (0, 1.0, "whole numbers of rows and columns"),
        (1, 1e9, "whole numbers of rows and columns"),
        (1, 5.0, "that the tensor heights has numbers for"),
        (2, 0.0, "spacing must be"),
        (4, 2e6, "within 1e6 m"),
        (7, -1.0, "from 0 to 1000"),
    ] {
        let (field, found) = spoilt("height_fields", element, f32::to_le_bytes(value));
        assert!(field.starts_with("tensor height_fields"), "{field}");
        assert!(found.to_string().contains(text), "{found}");
    }
    let (field, found) = spoilt("height_fields", 0, f32::to_le_bytes(2.0));
    assert!(
        field == "tensor heights" && matches!(found, Problem::Heights { found: 12, expected: 8 })
    );
    let (field, _) = spoilt("heights", 3, f32::to_le_bytes(f32::NAN));
    assert!(field.starts_with("tensor heights"), "{field}");
    let (field, _) = spoilt("scene_height_fields", 1, 2_i64.to_le_bytes());
    assert!(field.starts_with("tensor scene_height_fields"), "{field}");
    let wrong = HeightFieldBuf { columns: 5, ..hills() };
    let found = everything().with_height_field(Some(wrong)).unwrap_err();
    assert!(matches!(found.problem, Problem::BadHeightField(_)), "{found}");
    assert!(
        !encoded(&everything().with_height_field(None).unwrap())
            .windows(7)
            .any(|w| w == b"heights")
    );
}

/// A file with one more tensor of the type I64 at its end.
fn with_i64(bytes: &[u8], name: &str, values: &[i64]) -> Vec<u8> {
    let header_bytes = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let mut header: serde_json::Value =
        serde_json::from_slice(&bytes[8..8 + header_bytes]).unwrap();
    let payload = &bytes[8 + header_bytes..];
    let end = payload.len() + 8 * values.len();
    header[name] = serde_json::json!({
        "dtype": "I64", "shape": [values.len()], "data_offsets": [payload.len(), end],
    });
    let header = header.to_string();
    let more: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), payload, &more].concat()
}

/// A scene of 12 frames that stays where it is from frame 6 on.
fn stopping() -> RecordedScene {
    let mut stopping = unit(0.0, 4);
    let last = stopping.poses[6];
    stopping.poses[6..].fill(last);
    let gravity = Vector3::zeros();
    RecordedScene::new("drop seed 42", 42, Split::Test, 148.0, gravity, vec![stopping])
        .unwrap()
        .with_planes(Vec::new())
        .unwrap()
}

#[test]
fn a_scene_may_be_shorter_than_its_file() {
    let bytes = encoded(&stopping());
    let whole = Dataset::from_bytes("x", bytes.clone()).unwrap();
    assert_eq!((whole.frames(), whole.frames_of(0), whole.frames_of(1)), (12, Some(12), None));
    for recorded in [7, 8, 12] {
        let short = with_i64(&bytes, "scene_frames", &[recorded as i64]);
        let dataset = Dataset::from_bytes("x", short).unwrap();
        assert_eq!((dataset.frames(), dataset.frames_of(0)), (recorded, Some(recorded)));
        assert_eq!(dataset.scene(0, None).unwrap(), stopping().truncated(recorded));
        assert_eq!(dataset.scene(0, Some(3)).unwrap(), stopping().truncated(3));
        let error = dataset.scene(0, Some(recorded + 1)).unwrap_err();
        assert!(matches!(error.problem, Problem::TooFewFrames { .. }), "{error}");
    }
    for hostile in [0, -1, 13, i64::MAX, i64::MIN] {
        let (field, found) = problem(with_i64(&bytes, "scene_frames", &[hostile]));
        assert_eq!(field, "tensor scene_frames");
        assert!(matches!(found, Problem::BadValue { row: 0, .. }), "{found}");
        assert!(found.to_string().contains("from 1 to the frames"), "{found}");
    }
    let (field, found) = problem(with_i64(&bytes, "scene_frames", &[7, 7]));
    assert!(field == "tensor scene_frames" && matches!(found, Problem::WrongTensor { .. }));
    // The frames that were not recorded repeat the last one that was.
    let (field, found) = problem(with_i64(&bytes, "scene_frames", &[6]));
    assert_eq!(field, "tensor unit_poses, scene 0 (seed 42)");
    assert!(matches!(found, Problem::BadPose { unit: 0, frame: 6, .. }), "{found}");
    // Version 1 has no such tensor, and a reader of it does not look.
    let old = Dataset::from_bytes("x", with_i64(&written(), "scene_frames", &[0])).unwrap();
    assert_eq!(old.scene(0, None).unwrap(), scene());
}

#[test]
fn a_body_number_that_files_do_not_have() {
    let gravity = Vector3::zeros();
    let units = vec![unit(0.0, 4).with_body(65535)];
    let error = RecordedScene::new("drop", 1, Split::Test, 240.0, gravity, units).unwrap_err();
    assert!(error.to_string().contains("body number above 65534"), "{error}");
}

#[test]
fn random_damage_to_everything_never_panics() {
    let bytes = encoded(&everything());
    let mut state = 3u64;
    let mut next = |below: usize| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % below
    };
    for _ in 0..20_000 {
        let mut damaged = bytes.clone();
        for _ in 0..=next(4) {
            let at = next(damaged.len());
            damaged[at] = next(256) as u8;
        }
        if let Ok(dataset) = Dataset::from_bytes("x", damaged) {
            let _ = (dataset.scene(0, None), dataset.scene(1, Some(1)));
        }
    }
}
