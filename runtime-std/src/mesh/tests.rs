//! Meshes of each format, whole and broken.

use nalgebra::{Point3, Vector3};

use super::*;
use crate::memory::USUAL_BYTES;

/// Corners of a cube of .1 m, and its quads.
const CORNERS: &str =
    "v 0 0 0\nv 0 0 .1\nv 0 .1 0\nv 0 .1 .1\nv .1 0 0\nv .1 0 .1\nv .1 .1 0\nv .1 .1 .1\n";
const QUADS: [[u32; 4]; 6] =
    [[1, 2, 4, 3], [5, 7, 8, 6], [1, 5, 6, 2], [3, 4, 8, 7], [1, 3, 7, 5], [2, 6, 8, 4]];

fn groups(text: &[u8], format: Format) -> Result<Vec<Group>, MeshError> {
    read(text, format, &mut Budget::new(USUAL_BYTES))
}

fn joined(groups: Vec<Group>) -> TriangleMesh {
    TriangleMesh::joined(groups.into_iter().map(|group| group.mesh)).welded()
}

fn obj(face: impl Fn(usize, [u32; 4]) -> String) -> String {
    let faces = QUADS.iter().enumerate().map(|(at, quad)| face(at, *quad));
    CORNERS.to_owned() + &faces.collect::<String>()
}

fn triangles() -> Vec<[Vector3<f32>; 3]> {
    let corner = |k: u32| {
        let bit = |bit: u32| if (k - 1) & bit == 0 { 0.0 } else { 0.1 };
        Vector3::new(bit(4), bit(2), bit(1))
    };
    let halves = QUADS.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]);
    halves.map(|face| face.map(corner)).collect()
}

fn binary_stl() -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend(12_u32.to_le_bytes());
    for face in triangles() {
        let numbers = [Vector3::zeros()]
            .iter()
            .chain(&face)
            .flat_map(|v| [v.x, v.y, v.z])
            .collect::<Vec<_>>();
        bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        bytes.extend([0, 0]);
    }
    bytes
}

fn text_stl(head: &str) -> String {
    let faces = triangles().into_iter().map(|face| {
        let corners = face.map(|v| format!("vertex {} {} {}\n", v.x, v.y, v.z)).concat();
        format!("facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n")
    });
    format!("{head}\n{}endsolid\n", faces.collect::<String>())
}

/// A unit of centimetres, a cube of 10 that is turned and moved, and the same beside it.
fn collada() -> String {
    let corners = (0..8).map(|k| format!("{} {} {} ", k >> 2 & 1, k >> 1 & 1, k & 1));
    let faces = QUADS.iter().flatten().map(|corner| format!("{} 0 ", corner - 1));
    format!(
        r##"<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="centimeter" meter="0.01"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="cube"><mesh>
<source id="p"><float_array id="a" count="24">{}</float_array>
<technique_common><accessor source="#a" count="8" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="6"><input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#p" offset="1"/>
<vcount>4 4 4 4 4 4</vcount><p>{}</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><translate>100 0 0</translate><rotate>0 0 1 90</rotate>
<node><scale>10 10 10</scale><instance_geometry url="#cube"/></node>
<node><translate>20 0 0</translate><scale>10 10 10</scale><instance_geometry url="#cube"/></node>
</node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"##,
        corners.collect::<String>(),
        faces.collect::<String>()
    )
}

fn assert_cube(mesh: &TriangleMesh) {
    assert!(mesh.is_closed() && mesh.is_convex(), "{mesh:?}");
    assert!((mesh.volume_m3() - 1e-3).abs() < 1e-9, "{}", mesh.volume_m3());
}

#[test]
fn continued_lines_and_materials_without_a_name_are_read() {
    for text in [
        obj(|_, [a, b, c, d]| format!("f {a} {b} \\\n  {c} {d}\n")),
        obj(|_, [a, b, c, d]| format!("f {a}\\\r\n {b} {c}\\ \r\n {d}\r\n")),
        obj(|at, [a, b, c, d]| format!("usemtl {}\nf {a} {b} {c} {d}\n", ["", "wood"][at % 2])),
        format!("mtllib\n{}", obj(|_, [a, b, c, d]| format!("  usemtl\nf {a} {b} {c} {d}\n"))),
    ] {
        let found = groups(text.as_bytes(), Format::Obj).unwrap();
        assert_eq!(found.len(), 1, "materials make no groups");
        assert_cube(&joined(found));
    }
}

#[test]
fn sides_in_groups_are_one_closed_mesh() {
    let text = obj(|at, [a, b, c, d]| format!("g side{at}\nf {a} {b} {c} {d}\n"));
    let found = groups(text.as_bytes(), Format::Obj).unwrap();
    assert_eq!(found.len(), 6);
    assert!(found.iter().all(|group| !group.mesh.welded().is_closed()));
    let mesh = joined(found);
    assert_cube(&mesh);
    assert_eq!(mesh.parts().len(), 1);
}

#[test]
fn stl_is_read_in_text_and_in_binary() {
    let texts = ["solid cube", "solid", "  SOLID\r", "solid a name of words"].map(text_stl);
    let mut binary_named = binary_stl();
    binary_named[..5].copy_from_slice(b"solid");
    let upper = text_stl("solid x").to_uppercase();
    let mut latin = text_stl("solid Geh?use").into_bytes();
    latin.iter_mut().filter(|byte| **byte == b'?').for_each(|byte| *byte = 0xe4);
    let utf8 = text_stl("solid Gehäuse");
    let all = texts.into_iter().chain([upper, utf8]).map(String::into_bytes).chain([latin]);
    for bytes in all.chain([binary_stl(), binary_named]) {
        assert_cube(&joined(groups(&bytes, Format::Stl).unwrap()));
    }
}

#[test]
fn a_cut_off_stl_is_refused() {
    let whole = binary_stl();
    let cut = groups(&whole[..84 + 50 * 7], Format::Stl);
    assert_eq!(cut, Err(MeshError::CutOff { found: 7, said: 12 }));
    for length in 0..whole.len() {
        assert!(groups(&whole[..length], Format::Stl).is_err(), "{length}");
    }
    let text = text_stl("solid cube");
    for length in 0..text.len() - 10 {
        assert!(groups(&text.as_bytes()[..length], Format::Stl).is_err(), "{length}");
    }
}

#[test]
fn collada_has_its_places_and_its_unit() {
    let found = groups(collada().as_bytes(), Format::Collada).unwrap();
    assert_eq!(found.len(), 2);
    let [near, far] = [0, 1].map(|at| found[at].mesh.welded());
    for mesh in [&near, &far] {
        assert_cube(mesh);
    }
    // Turned a quarter about z, and then moved by 1 m: the second lies .2 m along y.
    let centres = [&near, &far].map(|mesh| mesh.mass_properties().unwrap().centre_m);
    assert!((centres[0] - Point3::new(0.95, 0.05, 0.05)).norm() < 1e-6, "{}", centres[0]);
    assert!((centres[1] - Point3::new(0.95, 0.25, 0.05)).norm() < 1e-6, "{}", centres[1]);
    let mirrored = collada().replacen("<scale>10 10 10", "<scale>-10 10 10", 1);
    for group in groups(mirrored.as_bytes(), Format::Collada).unwrap() {
        assert_cube(&group.mesh.welded());
    }
    let without = collada().replace("<scene>", "<extra>").replace("</scene>", "</extra>");
    let without = without.replace("instance_visual_scene", "none");
    let found = groups(without.as_bytes(), Format::Collada).unwrap();
    assert!((joined(found).volume_m3() - 1e-6).abs() < 1e-12, "a centimetre, where it is");
}

#[test]
fn hostile_collada_is_refused() {
    let whole = collada();
    for (from, to) in [
        ("<vcount>4 4", "<vcount>4000000000 4"),
        ("<p>0", "<p>99"),
        ("<p>0", "<p>-1"),
        ("url=\"#cube\"", "url=\"#none\""),
        ("offset=\"1\"", "offset=\"x\""),
        ("meter=\"0.01\"", "meter=\"0\""),
        ("<translate>100 0", "<translate>100"),
        ("<node><scale>", "<node><instance_node url=\"#s\"/><scale>"),
        ("<scale>10 10 10", "<scale>nan 10 10"),
        ("<?xml version=\"1.0\"?>", "<!DOCTYPE a [<!ENTITY b \"b\">]>"),
    ] {
        let foul = whole.replacen(from, to, 1);
        assert_ne!(foul, whole);
        let found = groups(foul.as_bytes(), Format::Collada);
        assert!(found.is_err() || joined(found.unwrap()).triangles.len() < 24, "{from} {to}");
    }
    // Many counts say nothing of memory, and deep elements nothing of the stack.
    let counted = whole.replace("count=\"24\"", "count=\"4000000000\"");
    assert!(groups(counted.as_bytes(), Format::Collada).is_ok());
    let deep = format!("<a>{}{}</a>", "<node>".repeat(50_000), "</node>".repeat(50_000));
    assert_eq!(groups(deep.as_bytes(), Format::Collada), Err(MeshError::NoFaces));
    let deep = whole.replacen("<node>", &"<node>".repeat(5000), 1);
    let deep = deep.replacen("</visual_scene>", &("</node>".repeat(4999) + "</visual_scene>"), 1);
    assert!(matches!(groups(deep.as_bytes(), Format::Collada), Err(MeshError::Broken { .. })));
}

#[test]
fn memory_is_counted_before() {
    let text = obj(|_, [a, b, c, d]| format!("f {a} {b} {c} {d}\n"));
    for (bytes, format) in [
        (text.as_bytes(), Format::Obj),
        (&binary_stl(), Format::Stl),
        (collada().as_bytes(), Format::Collada),
    ] {
        let refused = read(bytes, format, &mut Budget::new(1000));
        assert!(matches!(refused, Err(MeshError::TooLarge(_))), "{format:?}");
    }
    // Nodes that name each other twice double at each step.
    let twice = |k: usize| {
        format!(
            "<node id=\"n{k}\">{}</node>",
            format!("<instance_node url=\"#n{}\"/>", k + 1).repeat(2)
        )
    };
    let nodes: String = (0..40).map(twice).collect();
    let foul = collada().replace(
        "<library_visual_scenes>",
        &format!("<l>{nodes}<node id=\"n40\"/></l><library_visual_scenes>"),
    );
    let foul =
        foul.replacen("<instance_geometry", "<instance_node url=\"#n0\"/><instance_geometry", 1);
    assert!(matches!(groups(foul.as_bytes(), Format::Collada), Err(MeshError::Broken { .. })));
}

#[test]
fn a_box_weighs_what_a_box_weighs() {
    let (a, b, c) = (0.2_f64, 0.3_f64, 0.4_f64);
    let text = obj(|_, [a, b, c, d]| format!("f {a} {b} {c} {d}\n"));
    let mut mesh = joined(groups(text.as_bytes(), Format::Obj).unwrap());
    for point in &mut mesh.points {
        *point = Point3::new(point.x * 2.0 + 5.0, point.y * 3.0 - 7.0, point.z * 4.0 + 1.0);
    }
    for mesh in [mesh.clone(), mesh.flipped()] {
        let mass = mesh.mass_properties().unwrap();
        let volume = a * b * c;
        assert!((mass.volume_m3 / volume - 1.0).abs() < 1e-4, "{}", mass.volume_m3);
        assert!((mass.centre_m - Point3::new(5.1, -6.85, 1.2)).norm() < 1e-5);
        let expected = [b * b + c * c, a * a + c * c, a * a + b * b].map(|sum| volume / 12.0 * sum);
        for (axis, expected) in expected.into_iter().enumerate() {
            let moment = mass.inertia_m5[(axis, axis)];
            assert!((moment / expected - 1.0).abs() < 1e-3, "{moment}");
            assert!(mass.inertia_m5[(axis, (axis + 1) % 3)].abs() < 1e-6 * expected + 1e-9);
        }
    }
}

#[test]
fn faces_that_look_both_ways_are_turned() {
    let text = obj(|at, [a, b, c, d]| match at % 2 {
        0 => format!("f {a} {b} {c} {d}\n"),
        _ => format!("f {d} {c} {b} {a}\n"),
    });
    let mesh = joined(groups(text.as_bytes(), Format::Obj).unwrap());
    assert!(mesh.is_closed() && mesh.is_convex());
    assert!((mesh.volume_m3().abs() - 1e-3).abs() < 1e-9);
    // A strip with half a turn has no two sides.
    let strip = (0..5_u32).map(|k| [k, (k + 1) % 5, (k + 2) % 5]).collect();
    let around = |k: f32| Point3::new((k * 1.3).sin(), (k * 1.3).cos(), k);
    let points = (0..5).map(|k| around(k as f32)).collect();
    assert!(!TriangleMesh { points, triangles: strip }.welded().is_closed());
}

#[test]
fn cavities_are_taken_away_and_bodies_are_added() {
    let text = obj(|_, [a, b, c, d]| format!("f {a} {b} {c} {d}\n"));
    let cube = joined(groups(text.as_bytes(), Format::Obj).unwrap());
    let mut small = cube.clone().scaled(0.5);
    small.points.iter_mut().for_each(|point| *point += Vector3::repeat(0.025));
    let mut beside = cube.clone();
    beside.points.iter_mut().for_each(|point| point.x += 0.2);
    let hollow = TriangleMesh::joined([cube.clone(), small.flipped()]);
    assert!((hollow.mass_properties().unwrap().volume_m3 - 8.75e-4).abs() < 1e-8);
    assert_eq!(hollow.welded().parts().len(), 2);
    let two = TriangleMesh::joined([cube.clone(), beside.flipped()]).mass_properties().unwrap();
    assert!((two.volume_m3 - 2e-3).abs() < 1e-8);
    let apart = two.inertia_m5[(1, 1)];
    // Two cubes whose centres are .1 m from the common one.
    assert!((apart - 2.0 * (1e-3 * 0.02 / 12.0 + 1e-3 * 0.01)).abs() < 1e-9, "{apart}");
    // In the box around a tetrahedron, and not in it.
    let corners = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let corner = TriangleMesh {
        points: corners.map(Point3::from).to_vec(),
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    };
    let mut outside = cube.clone();
    outside.points.iter_mut().for_each(|point| *point += Vector3::repeat(0.8));
    let both = TriangleMesh::joined([corner, outside.flipped()]).mass_properties().unwrap();
    assert!((both.volume_m3 - (1.0 / 6.0 + 1e-3)).abs() < 1e-6, "{}", both.volume_m3);
    let mut open = cube;
    open.triangles.pop();
    assert_eq!(open.mass_properties(), None);
}
