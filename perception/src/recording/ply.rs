//! Clouds as PLY files.

use std::io::{BufRead, BufReader};

use nalgebra::Point3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Property, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType,
};
use rigidformer_runtime::memory::Budget;

use super::error::CaptureProblem;
use super::numbers::label;
use super::points::{MAX_POINTS, Points, count, number as parsed, shortened};

/// Ends a header.
const END: &[u8] = b"end_header";
/// Bytes of a header, at most.
const MAX_HEADER: usize = 64 << 10;

/// What is kept of an element.
#[derive(Clone, Copy)]
struct Vertex {
    point: Point3<f64>,
    label: u16,
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Vertex { point: Point3::new(f64::NAN, f64::NAN, f64::NAN), label: 0 }
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let number = match property {
            Property::Char(number) => f64::from(number),
            Property::UChar(number) => f64::from(number),
            Property::Short(number) => f64::from(number),
            Property::UShort(number) => f64::from(number),
            Property::Int(number) => f64::from(number),
            Property::UInt(number) => f64::from(number),
            Property::Float(number) => f64::from(number),
            Property::Double(number) => number,
            _ => return PropertyAccessResult::Ignored,
        };
        match name {
            "x" => self.point.x = number,
            "y" => self.point.y = number,
            "z" => self.point.z = number,
            "label" => self.label = label(number),
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

/// Elements of a text, a line each. The parser of the crate knows no `nan`, which PCL and CloudCompare write.
fn lines(
    reader: &mut impl BufRead,
    element: &ElementDef,
    is_wanted: bool,
) -> Result<Vec<Vertex>, String> {
    let mut read = Vec::new();
    let mut line = String::new();
    for index in 0..element.count {
        line.clear();
        if reader.read_line(&mut line).map_err(|error| error.to_string())? == 0 {
            return Err(format!("it ends before line {index} of its element `{}`", element.name));
        }
        if is_wanted {
            let vertex = vertex(&line, element);
            read.push(
                vertex
                    .ok_or_else(|| format!("vertex {index} is not as its header says: {line}"))?,
            );
        }
    }
    Ok(read)
}

fn vertex(line: &str, element: &ElementDef) -> Option<Vertex> {
    let mut words = line.split_ascii_whitespace();
    let mut vertex = Vertex::new();
    for (name, property) in &element.properties {
        let first = parsed(words.next()?)?;
        match property.data_type {
            PropertyType::Scalar(_) => {
                vertex.set_property(name, Property::Double(first));
            }
            PropertyType::List(..) => {
                for _ in 0..first as usize {
                    words.next()?;
                }
            }
        }
    }
    Some(vertex)
}

/// Reads the vertices of a PLY file.
pub(super) fn read(bytes: &[u8], budget: &mut Budget) -> Result<Points, CaptureProblem> {
    let broken = |why: String| CaptureProblem::Cloud { format: "PLY", why: shortened(why) };
    // A header of many elements or properties takes many times its length in memory.
    if !bytes.get(..MAX_HEADER).unwrap_or(bytes).windows(END.len()).any(|at| at == END) {
        return Err(broken("it has no header that ends within 64 kB".into()));
    }
    let parser = Parser::<Vertex>::new();
    let mut reader = Reader::new(BufReader::new(bytes));
    let header = parser.read_header(&mut reader).map_err(|error| broken(error.to_string()))?;
    let Some(vertices) = header.elements.get("vertex") else {
        return Err(broken("it has no element `vertex`".into()));
    };
    if !["x", "y", "z"].iter().all(|axis| vertices.properties.contains_key(*axis)) {
        return Err(CaptureProblem::NoCoordinates);
    }
    let is_labelled = vertices.properties.contains_key("label");
    let is_float = |axis: &str| {
        let property = vertices.properties.get(axis);
        property
            .is_some_and(|property| property.data_type == PropertyType::Scalar(ScalarType::Float))
    };
    let is_single =
        header.encoding != Encoding::Ascii && ["x", "y", "z"].iter().any(|axis| is_float(axis));
    let mut all = 0_u64;
    for (name, element) in &header.elements {
        let points = element.count as u64;
        // Elements without properties take no bytes, so a short file may claim any number of them.
        if element.properties.is_empty() && points > 0 {
            return Err(broken(format!("its element `{name}` has no properties")));
        }
        all = all.saturating_add(points);
        if all > MAX_POINTS {
            return Err(CaptureProblem::TooManyPoints { points: all, most: MAX_POINTS });
        }
        // Once as they are read, and once as points; an element has a byte at least.
        let most = element.count.min(bytes.len());
        budget.take_all::<Vertex>(most)?;
        count(budget, most)?;
        let elements = match header.encoding {
            Encoding::Ascii => {
                lines(reader.get_mut(), element, name == "vertex").map_err(broken)?
            }
            _ => {
                let read = parser.read_payload_for_element(&mut reader, element, &header);
                read.map_err(|error| broken(error.to_string()))?
            }
        };
        // Elements behind the vertices are not read.
        if name == "vertex" {
            let points = elements.into_iter().map(|v| (v.point, v.label)).collect();
            return Ok(Points { points, is_labelled, is_single, sensor: None });
        }
    }
    Err(broken("it ends before its vertices".into()))
}
