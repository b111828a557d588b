//! Clouds as PLY files.

use std::io::BufReader;

use nalgebra::Point3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};

use super::error::CaptureProblem;
use super::points::{MOST_POINTS, points_of, shortened};
use crate::capture::Cloud;

/// What is kept of an element.
#[derive(Clone, Copy)]
struct Vertex {
    place: Point3<f32>,
    label: u16,
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Vertex { place: Point3::new(f32::NAN, f32::NAN, f32::NAN), label: 0 }
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
            "x" => self.place.x = number as f32,
            "y" => self.place.y = number as f32,
            "z" => self.place.z = number as f32,
            // A conversion that saturates.
            "label" => self.label = number as u16,
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

/// Reads the vertices of a PLY file.
pub(super) fn read(bytes: &[u8]) -> Result<Cloud, CaptureProblem> {
    let broken = |why: String| CaptureProblem::Cloud { format: "PLY", why: shortened(why) };
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
    for (name, element) in &header.elements {
        // An element without properties takes no bytes, so their number says nothing of its size.
        let points = element.count as u64;
        if points > MOST_POINTS {
            return Err(CaptureProblem::TooManyPoints { points, most: MOST_POINTS });
        }
        let read = parser.read_payload_for_element(&mut reader, element, &header);
        let elements = read.map_err(|error| broken(error.to_string()))?;
        // What comes behind the vertices is not asked for.
        if name == "vertex" {
            return Ok(points_of(elements.into_iter().map(|v| (v.place, v.label)), is_labelled));
        }
    }
    Err(broken("it ends before its vertices".into()))
}
