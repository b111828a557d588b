//! COLLADA: geometries at their places in the scene, in metres.
//!
//! mesh-loader reads COLLADA too, but one instance of a geometry alone, with transforms of nested nodes in the wrong order; it panics at
//! indices that are not there, and reserves memory for whatever count a file tells. roxmltree parses the text, without recursion.

use std::collections::{HashMap, HashSet};
use std::rc::Rc;

use nalgebra::{Matrix4, Point3, Rotation3, Unit, Vector3};
use roxmltree::{Document, Node, NodeId, ParsingOptions};

use super::error::MeshError;
use super::triangles::{Group, TriangleMesh};
use crate::memory::Budget;

/// Nodes of a scene within each other, at most.
const MOST_DEPTH: usize = 256;
/// Elements that are visited in scenes, at most: instances of nodes may multiply.
const MOST_VISITS: usize = 1_000_000;
/// Bytes of numbers that nodes of scenes may have, at most, where instances repeat them.
const MOST_PARSED: usize = 16 << 20;
/// Attributes of an element, at most: roxmltree compares each with those before it.
const MOST_ATTRIBUTES: usize = 64;
/// Names of namespaces in a file, at most: roxmltree copies those of an element to each within that has one of its own.
const MOST_NAMESPACES: usize = 16;
/// Bytes of the name of a namespace, at most.
const MOST_NAME: usize = 128;
/// Bytes that a triangle takes in memory, as those of STL: all instances of a geometry have corners of their own, also while they are
/// welded.
const TRIANGLE_BYTES: u64 = 600;
/// Bytes of a group, without its name and its triangles.
const GROUP_BYTES: u64 = 200;

fn broken(problem: impl ToString) -> MeshError {
    MeshError::broken("COLLADA", problem)
}

pub(super) fn read(bytes: &[u8], budget: &mut Budget) -> Result<Vec<Group>, MeshError> {
    let text = std::str::from_utf8(bytes).map_err(broken)?;
    check_attributes(text)?;
    let options = ParsingOptions { allow_dtd: false, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text.trim_start_matches('\u{feff}'), options)
        .map_err(broken)?;
    let all = document.descendants().filter_map(|node| Some((node.attribute("id")?, node)));
    let mut reader = Reader {
        by_id: all.collect(),
        positions: HashMap::new(),
        shapes: HashMap::new(),
        groups: Vec::new(),
        budget,
        visits: 0,
        parsed: 0,
    };
    let metres = Matrix4::new_scaling(unit_m(&document)?);
    let scenes =
        document.descendants().filter(|node| node.has_tag_name_of("instance_visual_scene"));
    for scene in scenes {
        let scene = reader.target(&scene, "url")?;
        reader.walk(scene, &metres, 0)?;
    }
    // Without a scene all geometries are where they are.
    if reader.shapes.is_empty() {
        for geometry in document.descendants().filter(|node| node.has_tag_name_of("geometry")) {
            reader.add(geometry, &metres)?;
        }
    }
    Ok(reader.groups)
}

/// Refuses what roxmltree takes the square of its length for.
fn check_attributes(text: &str) -> Result<(), MeshError> {
    // No value of an attribute has a `<`, and a comment has no attributes.
    for tag in text.split('<').filter(|tag| !tag.starts_with(['!', '?', '/'])) {
        let values = tag.split('=').skip(1);
        if values.filter(|value| value.trim_start().starts_with(['"', '\''])).count()
            > MOST_ATTRIBUTES
        {
            return Err(broken("an element has too many attributes"));
        }
    }
    let mut names = HashSet::new();
    for (at, _) in text.match_indices("xmlns") {
        let rest = text.as_bytes().get(at..).unwrap_or_default();
        let is_name = |byte: &&u8| **byte != b'=' && !byte.is_ascii_whitespace();
        let name: Vec<u8> = rest.iter().take(MOST_NAME).take_while(is_name).copied().collect();
        if name.len() == MOST_NAME || (names.insert(name) && names.len() > MOST_NAMESPACES) {
            return Err(broken("it names too many namespaces, or one too long"));
        }
    }
    Ok(())
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

/// The numbers in an element, one by one.
fn numbers<'d, T: std::str::FromStr>(
    node: &Node<'d, '_>,
) -> impl Iterator<Item = Result<T, MeshError>> + use<'d, T> {
    let words = node.text().unwrap_or_default().split_ascii_whitespace();
    words.map(|word| word.parse().map_err(|_| broken(format!("{word:.80} is no number"))))
}

fn attribute<T: std::str::FromStr>(
    node: &Node<'_, '_>,
    name: &str,
    usual: T,
) -> Result<T, MeshError> {
    let Some(text) = node.attribute(name) else { return Ok(usual) };
    text.trim().parse().map_err(|_| broken(format!("{name}=\"{text:.80}\" is no number")))
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

/// Faces of a geometry that have the same positions.
struct Faces {
    positions: Rc<Vec<Point3<f64>>>,
    triangles: Vec<[u32; 3]>,
}

struct Reader<'d, 'i, 'b> {
    by_id: HashMap<&'d str, Node<'d, 'i>>,
    /// Of sources, which many faces and geometries may name.
    positions: HashMap<NodeId, Rc<Vec<Point3<f64>>>>,
    /// Of geometries, which many nodes may have.
    shapes: HashMap<NodeId, Rc<[Faces]>>,
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
        found.copied().ok_or_else(|| broken(format!("{attribute}=\"{url:.80}\" is not in it")))
    }

    /// Adds the geometries of a node and of those within, at their places.
    fn walk(
        &mut self,
        node: Node<'d, 'i>,
        above: &Matrix4<f64>,
        depth: usize,
    ) -> Result<(), MeshError> {
        // First, because the transform reads them all.
        self.visits += 1;
        for within in node.children() {
            self.visits += 1;
            self.parsed = self.parsed.saturating_add(within.text().unwrap_or_default().len());
            if self.visits > MOST_VISITS || self.parsed > MOST_PARSED {
                break;
            }
        }
        if depth > MOST_DEPTH || self.visits > MOST_VISITS || self.parsed > MOST_PARSED {
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
        let shape = match self.shapes.get(&geometry.id()) {
            Some(shape) => shape.clone(),
            None => {
                let shape: Rc<[Faces]> = self.shape(&geometry)?.into();
                self.shapes.insert(geometry.id(), shape.clone());
                shape
            }
        };
        // Splines and hulls have no faces.
        let number: u64 = shape.iter().map(|faces| faces.triangles.len() as u64).sum();
        if number == 0 {
            return Ok(());
        }
        let room = GROUP_BYTES + name.len() as u64;
        self.budget.take(room.saturating_add(number.saturating_mul(TRIANGLE_BYTES)))?;
        // A mirrored copy keeps its outside.
        let is_mirrored = place.fixed_view::<3, 3>(0, 0).determinant() < 0.0;
        let mut mesh = TriangleMesh::default();
        for faces in shape.iter() {
            for face in &faces.triangles {
                let first = mesh.points.len() as u32;
                let points = face.map(|corner| faces.positions.get(corner as usize));
                mesh.points.extend(
                    points.into_iter().flatten().map(|p| place.transform_point(p).cast::<f32>()),
                );
                let [second, third] = if is_mirrored { [2, 1] } else { [1, 2] };
                mesh.triangles.push([first, first + second, first + third]);
            }
        }
        self.groups.push(Group { name: name.to_owned(), mesh });
        Ok(())
    }

    /// The faces of a geometry, where it has some.
    fn shape(&mut self, geometry: &Node<'d, 'i>) -> Result<Vec<Faces>, MeshError> {
        let mut shape = Vec::new();
        let Some(source) = child(geometry, "mesh") else { return Ok(shape) };
        for faces in source.children().filter(Node::is_element) {
            shape.extend(self.faces(&faces)?.filter(|faces| !faces.triangles.is_empty()));
        }
        Ok(shape)
    }

    fn faces(&mut self, faces: &Node<'d, 'i>) -> Result<Option<Faces>, MeshError> {
        let kind = faces.tag_name().name();
        if !["triangles", "polylist", "polygons", "tristrips", "trifans"].contains(&kind) {
            return Ok(None);
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
        let counts: Option<Vec<u32>> =
            child(faces, "vcount").map(|counts| numbers(&counts).collect()).transpose()?;
        let mut all = Vec::new();
        for indices in faces.children().filter(|node| node.has_tag_name_of("p")) {
            let mut corners: Vec<u32> = Vec::new();
            for (at, index) in numbers(&indices).enumerate() {
                let index: u32 = index?;
                if at % stride != offset {
                    continue;
                }
                if index as usize >= positions.len() {
                    return Err(broken(format!("corner {index} is not there")));
                }
                corners.push(index);
            }
            let budget = &mut *self.budget;
            triangles(kind, counts.as_deref(), &corners, |face| {
                budget.take(size_of_val(&face) as u64)?;
                all.push(face);
                Ok(())
            })?;
        }
        Ok(Some(Faces { positions, triangles: all }))
    }

    /// Positions of the vertices that an input names.
    fn positions(&mut self, vertex: &Node<'d, 'i>) -> Result<Rc<Vec<Point3<f64>>>, MeshError> {
        let vertices = self.target(vertex, "source")?;
        if let Some(positions) = self.positions.get(&vertices.id()) {
            return Ok(positions.clone());
        }
        let mut inputs = vertices.children().filter(|node| node.has_tag_name_of("input"));
        let position = inputs.find(|input| input.attribute("semantic") == Some("POSITION"));
        let source = match position {
            Some(position) => self.target(&position, "source")?,
            None => return Err(broken("its vertices have no positions")),
        };
        let positions = match self.positions.get(&source.id()) {
            Some(positions) => positions.clone(),
            None => Rc::new(source_positions(&source)?),
        };
        self.positions.insert(source.id(), positions.clone());
        self.positions.insert(vertices.id(), positions.clone());
        Ok(positions)
    }
}

/// The first three numbers of each row of a source.
fn source_positions(source: &Node<'_, '_>) -> Result<Vec<Point3<f64>>, MeshError> {
    let Some(array) = child(source, "float_array") else {
        return Err(broken("its positions are no numbers"));
    };
    let technique = child(source, "technique_common");
    let accessor = technique.and_then(|technique| child(&technique, "accessor"));
    let stride = accessor.map_or(Ok(3), |accessor| attribute(&accessor, "stride", 3_usize))?;
    let offset = accessor.map_or(Ok(0), |accessor| attribute(&accessor, "offset", 0_usize))?;
    let mut positions = Vec::new();
    let mut row = Point3::origin();
    for (at, value) in numbers(&array).skip(offset).enumerate() {
        let column = at % stride.max(1);
        let value: f64 = value?;
        if let Some(number) = row.coords.get_mut(column) {
            *number = value;
        }
        if column == 2 {
            positions.push(row);
        }
    }
    Ok(positions)
}

/// Hands on the corners of the triangles of faces; polygons are fans.
fn triangles(
    kind: &str,
    counts: Option<&[u32]>,
    corners: &[u32],
    mut each: impl FnMut([u32; 3]) -> Result<(), MeshError>,
) -> Result<(), MeshError> {
    let mut fan = |corners: &[u32]| {
        let [first, rest @ ..] = corners else { return Ok(()) };
        rest.array_windows().try_for_each(|[b, c]| each([*first, *b, *c]))
    };
    match (kind, counts) {
        ("triangles", _) => corners.as_chunks::<3>().0.iter().try_for_each(|face| each(*face)),
        ("polylist", Some(counts)) => {
            let mut rest = corners;
            for count in counts {
                // A list that ends early has no further faces.
                let Some((face, after)) = rest.split_at_checked(*count as usize) else { break };
                fan(face)?;
                rest = after;
            }
            Ok(())
        }
        ("tristrips", _) => corners.array_windows().enumerate().try_for_each(|(at, [a, b, c])| {
            each(if at % 2 == 0 { [*a, *b, *c] } else { [*b, *a, *c] })
        }),
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
        let values: Vec<f64> = numbers(&element).collect::<Result<_, _>>()?;
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
