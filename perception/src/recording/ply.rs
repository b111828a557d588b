//! Clouds as PLY files.

use std::io::BufReader;

use nalgebra::Point3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};
use rigidformer_runtime::memory::Budget;

use super::error::CaptureProblem;
use super::points::{MAX_POINTS, count, points_of, shortened};
use crate::capture::Cloud;

/// Ends a header.
const END: &[u8] = b"end_header";
/// Bytes of a header, at most.
const MAX_HEADER: usize = 64 << 10;

/// What is kept of an element.
#[derive(Clone, Copy)]
struct Vertex {
    point: Point3<f32>,
    label: u16,
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Vertex { point: Point3::new(f32::NAN, f32::NAN, f32::NAN), label: 0 }
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
            "x" => self.point.x = number as f32,
            "y" => self.point.y = number as f32,
            "z" => self.point.z = number as f32,
            // The conversion saturates.
            "label" => self.label = number as u16,
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

/// Reads the vertices of a PLY file.
pub(super) fn read(bytes: &[u8], budget: &mut Budget) -> Result<Cloud, CaptureProblem> {
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
        let read = parser.read_payload_for_element(&mut reader, element, &header);
        let elements = read.map_err(|error| broken(error.to_string()))?;
        // Elements behind the vertices are not read.
        if name == "vertex" {
            return Ok(points_of(elements.into_iter().map(|v| (v.point, v.label)), is_labelled));
        }
    }
    Err(broken("it ends before its vertices".into()))
}
