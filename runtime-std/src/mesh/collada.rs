//! COLLADA: geometries at their places in the scene, in metres.
//!
//! mesh-loader reads COLLADA too, but one instance of a geometry alone, with transforms of nested nodes in the wrong order; it panics at
//! indices that are not there, and reserves memory for whatever count a file tells. roxmltree parses the text, without recursion.

use std::collections::HashMap;

use nalgebra::{Matrix4, Point3, Rotation3, Unit, Vector3};
use roxmltree::{Document, Node, ParsingOptions};

use super::error::MeshError;
use super::triangles::{Group, TriangleMesh};
use crate::memory::Budget;

/// Nodes of a scene within each other, at most.
const MOST_DEPTH: usize = 256;
/// Nodes that are visited, at most: instances of nodes may multiply.
const MOST_VISITS: usize = 100_000;
/// Bytes of numbers that are parsed, at most: many instances of a geometry read it again.
const MOST_PARSED: usize = 1 << 30;
/// Bytes of a triangle with three corners of its own.
const TRIANGLE_BYTES: u64 = 48;

fn broken(problem: impl ToString) -> MeshError {
    MeshError::broken("COLLADA", problem)
}

pub(super) fn read(bytes: &[u8], budget: &mut Budget) -> Result<Vec<Group>, MeshError> {
    let text = std::str::from_utf8(bytes).map_err(broken)?;
    let options = ParsingOptions { allow_dtd: false, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text.trim_start_matches('\u{feff}'), options)
        .map_err(broken)?;
    let all = document.descendants().filter_map(|node| Some((node.attribute("id")?, node)));
    let mut reader =
        Reader { by_id: all.collect(), groups: Vec::new(), budget, visits: 0, parsed: 0 };
    let metres = Matrix4::new_scaling(unit_m(&document)?);
    let scenes =
        document.descendants().filter(|node| node.has_tag_name_of("instance_visual_scene"));
    for scene in scenes {
        let scene = reader.target(&scene, "url")?;
        reader.walk(scene, &metres, 0)?;
    }
    // Without a scene all geometries are where they are.
    if reader.groups.is_empty() {
        for geometry in document.descendants().filter(|node| node.has_tag_name_of("geometry")) {
            reader.add(geometry, &metres)?;
        }
    }
    Ok(reader.groups)
}

/// Names without their namespace, which differs between versions.
trait Named {
    fn has_tag_name_of(&self, name: &str) -> bool;
}

impl Named for Node<'_, '_> {
    fn has_tag_name_of(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}

fn child<'d, 'i>(of: &Node<'d, 'i>, name: &str) -> Option<Node<'d, 'i>> {
    of.children().find(|node| node.has_tag_name_of(name))
}

fn numbers<T: std::str::FromStr>(node: &Node<'_, '_>) -> Result<Vec<T>, MeshError> {
    let words = node.text().unwrap_or_default().split_ascii_whitespace();
    let parsed = words.map(|word| word.parse().map_err(|_| broken(format!("{word} is no number"))));
    parsed.collect()
}

fn attribute<T: std::str::FromStr>(
    node: &Node<'_, '_>,
    name: &str,
    usual: T,
) -> Result<T, MeshError> {
    let Some(text) = node.attribute(name) else { return Ok(usual) };
    text.trim().parse().map_err(|_| broken(format!("{name}=\"{text}\" is no number")))
}

/// Metres of a length of 1.
fn unit_m(document: &Document<'_>) -> Result<f64, MeshError> {
    let asset = child(&document.root_element(), "asset");
    let unit = asset.and_then(|asset| child(&asset, "unit"));
    let metres = unit.map_or(Ok(1.0), |unit| attribute(&unit, "meter", 1.0))?;
    if metres > 0.0 && f64::is_finite(metres) {
        Ok(metres)
    } else {
        Err(broken("its unit has no length"))
    }
}

struct Reader<'d, 'i, 'b> {
    by_id: HashMap<&'d str, Node<'d, 'i>>,
    groups: Vec<Group>,
    budget: &'b mut Budget,
    visits: usize,
    parsed: usize,
}

impl<'d, 'i> Reader<'d, 'i, '_> {
    /// The element that an attribute names.
    fn target(&self, of: &Node<'d, 'i>, attribute: &str) -> Result<Node<'d, 'i>, MeshError> {
        let url = of.attribute(attribute).unwrap_or_default();
        let found = url.strip_prefix('#').and_then(|id| self.by_id.get(id));
        found.copied().ok_or_else(|| broken(format!("{attribute}=\"{url}\" is not in it")))
    }

    /// The numbers in an element.
    fn numbers<T: std::str::FromStr>(&mut self, node: &Node<'d, 'i>) -> Result<Vec<T>, MeshError> {
        self.parsed = self.parsed.saturating_add(node.text().unwrap_or_default().len());
        if self.parsed > MOST_PARSED {
            return Err(broken("it has a geometry too often, or too many numbers"));
        }
        numbers(node)
    }

    /// Adds the geometries of a node and of those within, at their places.
    fn walk(
        &mut self,
        node: Node<'d, 'i>,
        above: &Matrix4<f64>,
        depth: usize,
    ) -> Result<(), MeshError> {
        self.visits += 1;
        if depth > MOST_DEPTH || self.visits > MOST_VISITS {
            return Err(broken("its nodes are within each other too deeply, or too many"));
        }
        let place = above * transform(&node)?;
        for within in node.children().filter(Node::is_element) {
            match within.tag_name().name() {
                "node" => self.walk(within, &place, depth + 1)?,
                "instance_node" => self.walk(self.target(&within, "url")?, &place, depth + 1)?,
                "instance_geometry" => self.add(self.target(&within, "url")?, &place)?,
                _ => {}
            }
        }
        Ok(())
    }

    fn add(&mut self, geometry: Node<'d, 'i>, place: &Matrix4<f64>) -> Result<(), MeshError> {
        let name = geometry.attribute("name").or(geometry.attribute("id")).unwrap_or_default();
        let mut mesh = TriangleMesh::default();
        // Splines and hulls have no faces.
        let Some(source) = child(&geometry, "mesh") else { return Ok(()) };
        for faces in source.children().filter(Node::is_element) {
            self.add_faces(&faces, place, &mut mesh)?;
        }
        self.groups.push(Group { name: name.to_owned(), mesh });
        Ok(())
    }

    fn add_faces(
        &mut self,
        faces: &Node<'d, 'i>,
        place: &Matrix4<f64>,
        mesh: &mut TriangleMesh,
    ) -> Result<(), MeshError> {
        let kind = faces.tag_name().name();
        if !["triangles", "polylist", "polygons", "tristrips", "trifans"].contains(&kind) {
            return Ok(());
        }
        let inputs = || faces.children().filter(|node| node.has_tag_name_of("input"));
        let Some(vertex) = inputs().find(|input| input.attribute("semantic") == Some("VERTEX"))
        else {
            return Err(broken(format!("its {kind} have no vertices")));
        };
        let mut stride = 1_usize;
        for input in inputs() {
            stride = stride.max(attribute(&input, "offset", 0_usize)?.saturating_add(1));
        }
        let offset = attribute(&vertex, "offset", 0_usize)?;
        let positions = self.positions(&vertex)?;
        let counts: Option<Vec<usize>> =
            child(faces, "vcount").map(|counts| self.numbers(&counts)).transpose()?;
        for indices in faces.children().filter(|node| node.has_tag_name_of("p")) {
            let indices: Vec<usize> = self.numbers(&indices)?;
            let corners: Vec<usize> =
                indices.chunks_exact(stride).filter_map(|row| row.get(offset).copied()).collect();
            for [a, b, c] in triangles(kind, counts.as_deref(), &corners) {
                self.budget.take(TRIANGLE_BYTES)?;
                let first = mesh.points.len() as u32;
                for corner in [a, b, c] {
                    let Some(point) = positions.get(corner) else {
                        return Err(broken(format!("corner {corner} is not there")));
                    };
                    let point = place.transform_point(point);
                    mesh.points.push(point.cast());
                }
                mesh.triangles.push([first, first + 1, first + 2]);
            }
        }
        Ok(())
    }

    /// Positions of the vertices that an input names.
    fn positions(&mut self, vertex: &Node<'d, 'i>) -> Result<Vec<Point3<f64>>, MeshError> {
        let vertices = self.target(vertex, "source")?;
        let mut inputs = vertices.children().filter(|node| node.has_tag_name_of("input"));
        let position = inputs.find(|input| input.attribute("semantic") == Some("POSITION"));
        let source = match position {
            Some(position) => self.target(&position, "source")?,
            None => return Err(broken("its vertices have no positions")),
        };
        let Some(array) = child(&source, "float_array") else {
            return Err(broken("its positions are no numbers"));
        };
        let technique = child(&source, "technique_common");
        let accessor = technique.and_then(|technique| child(&technique, "accessor"));
        let stride = accessor.map_or(Ok(3), |accessor| attribute(&accessor, "stride", 3_usize))?;
        let offset = accessor.map_or(Ok(0), |accessor| attribute(&accessor, "offset", 0_usize))?;
        let values: Vec<f64> = self.numbers(&array)?;
        let rows = values.get(offset..).unwrap_or_default().chunks(stride.max(1));
        let points = rows.filter_map(|row| row.first_chunk::<3>()).map(|row| Point3::from(*row));
        Ok(points.collect())
    }
}

/// Corners of the triangles of faces; polygons are fans.
fn triangles(kind: &str, counts: Option<&[usize]>, corners: &[usize]) -> Vec<[usize; 3]> {
    let fan = |corners: &[usize]| -> Vec<[usize; 3]> {
        let [first, rest @ ..] = corners else { return Vec::new() };
        rest.array_windows().map(|[b, c]| [*first, *b, *c]).collect()
    };
    match (kind, counts) {
        ("triangles", _) => corners.as_chunks::<3>().0.to_vec(),
        ("polylist", Some(counts)) => {
            let mut rest = corners;
            let mut all = Vec::new();
            for count in counts {
                // A list that ends early has no further faces.
                let Some((face, after)) = rest.split_at_checked(*count) else { break };
                all.extend(fan(face));
                rest = after;
            }
            all
        }
        ("tristrips", _) => {
            let strip = corners.array_windows().enumerate();
            strip
                .map(|(at, [a, b, c])| if at % 2 == 0 { [*a, *b, *c] } else { [*b, *a, *c] })
                .collect()
        }
        _ => fan(corners),
    }
}

/// The transform of a node: those of its elements, the first outermost.
fn transform(node: &Node<'_, '_>) -> Result<Matrix4<f64>, MeshError> {
    let mut all = Matrix4::identity();
    for element in node.children().filter(Node::is_element) {
        let kind = element.tag_name().name();
        if !["translate", "rotate", "scale", "matrix", "lookat", "skew"].contains(&kind) {
            continue;
        }
        let values: Vec<f64> = numbers(&element)?;
        all *= match (kind, values.as_slice()) {
            ("translate", [x, y, z]) => Matrix4::new_translation(&Vector3::new(*x, *y, *z)),
            ("scale", [x, y, z]) => Matrix4::new_nonuniform_scaling(&Vector3::new(*x, *y, *z)),
            ("rotate", [x, y, z, degrees]) => {
                let axis = Unit::try_new(Vector3::new(*x, *y, *z), 1e-9);
                // Exporters write an axis of 0 with an angle of 0.
                axis.map_or_else(Matrix4::identity, |axis| {
                    Rotation3::from_axis_angle(&axis, degrees.to_radians()).to_homogeneous()
                })
            }
            ("matrix", values) if values.len() == 16 => Matrix4::from_row_slice(values),
            _ => {
                return Err(broken(format!(
                    "its {kind} has {} numbers, or is not read",
                    values.len()
                )));
            }
        };
    }
    Ok(all)
}
