//! Two recordings, bit by bit.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::fmt;

use rigidformer_runtime::core::Layer;
use serde::Serialize;

use super::{Content, Record, Recording};

/// Why two recordings cannot be compared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Incomparable {
    /// They are of different runs.
    #[error("{what} is {a} in the first trace and {b} in the second; record both of the same run")]
    Run {
        /// `scene`, `step` or `steps`.
        what: &'static str,
        /// In the first.
        a: String,
        /// In the second.
        b: String,
    },
    /// They have different layers, as those of models with different configurations do.
    #[error(
        "part {position} is {a} in the first trace and {b} in the second; record both with models of the same \
         configuration"
    )]
    Layers {
        /// Place in the order of computation, from 0.
        position: usize,
        /// In the first.
        a: String,
        /// In the second.
        b: String,
    },
}

/// The first element that differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FirstDifference {
    /// 0 for the observation, n for the n-th step.
    pub step: u32,
    /// Name of the layer.
    pub layer: &'static str,
    /// The unit.
    pub unit: usize,
    /// Index of the record: the unit, or the scale for tokens.
    pub index: usize,
    /// Row of the record: a point, an impact, an anchor, or the unit.
    pub row: usize,
    /// Element of the row.
    pub element: usize,
    /// Value in the first recording; no number for an impact that it does not have.
    pub a: f32,
    /// Value in the second; as in the first.
    pub b: f32,
    /// Bits in the first.
    pub a_bits: u32,
    /// Bits in the second.
    pub b_bits: u32,
}

impl fmt::Display for FirstDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { step, layer, unit, index, row, element, a, b, a_bits, b_bits } = self;
        write!(f, "step {step}, layer {layer}")?;
        match Layer::from_name(layer) {
            Some(Layer::Registers) => write!(f, " at scale {index}, register {row}")?,
            Some(Layer::Attention) => write!(f, " of block {index}, unit {unit}")?,
            Some(layer) if layer.is_by_scale() => write!(f, " at scale {index}, unit {unit}")?,
            Some(layer) if layer.is_by_unit() => {
                write!(f, ", unit {unit}, {} {row}", layer.row())?;
            }
            Some(layer) if layer.rows_of_a_unit() > 1 => {
                let row = row % layer.rows_of_a_unit();
                write!(f, ", unit {unit}, {} {row}", layer.row())?;
            }
            None if *layer == Content::SoftPoints.name() => {
                write!(f, ", unit {unit}, point {row}")?;
            }
            Some(_) | None => write!(f, ", unit {unit}")?,
        }
        write!(f, ", element {element}: {a:e} ({a_bits:#010x}) and {b:e} ({b_bits:#010x})")
    }
}

/// How a layer differs over all steps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LayerDifference {
    /// Name of the layer, with the scale for tokens.
    pub layer: String,
    /// Elements compared.
    pub elements: u64,
    /// Those with other bits.
    pub different: u64,
    /// Largest difference; infinite where one side alone is no number.
    pub largest: f64,
    /// The first step that differs.
    pub first_step: Option<u32>,
}

/// What [`compare`] found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The first element that differs; none for equal recordings.
    pub first: Option<FirstDifference>,
    /// A row a layer, in the order of the forward pass.
    pub layers: Vec<LayerDifference>,
}

/// Compares two recordings of the same run bit by bit; 0 and -0 differ. Names of models are not compared. The
/// states decide how many impacts a unit has: an impact of one recording alone differs in all its elements.
///
/// # Errors
/// [`Incomparable`] when scene, step code, steps or layers are not the same.
pub fn compare(a: &Recording, b: &Recording) -> Result<Comparison, Incomparable> {
    let steps = |recording: &Recording| recording.records.last().map_or(0, |record| record.step);
    for (what, a, b) in [
        ("scene", a.scene.clone(), b.scene.clone()),
        ("step", a.step.to_string(), b.step.to_string()),
        ("steps", steps(a).to_string(), steps(b).to_string()),
    ] {
        if a != b {
            return Err(Incomparable::Run { what, a, b });
        }
    }
    let pairs = pairs(a, b)?;
    let mut first = None;
    let mut layers: BTreeMap<(Content, usize), LayerDifference> = BTreeMap::new();
    for Paired { record, a, b } in &pairs {
        let scale = record.content.scale(record.index);
        let layer = layers.entry((record.content, scale)).or_insert_with(|| LayerDifference {
            layer: record.content.label(scale),
            elements: 0,
            different: 0,
            largest: 0.0,
            first_step: None,
        });
        // The state decides how many impacts a unit has, so lengths may differ.
        let elements = a.len().max(b.len());
        layer.elements += elements as u64;
        for at in 0..elements {
            let value = |values: &[f32]| values.get(at).copied().unwrap_or(f32::NAN);
            let (x, y) = (value(a), value(b));
            // What one side lacks reads as NaN, and differs also from a NaN of the other side.
            if x.to_bits() != y.to_bits() || at >= a.len().min(b.len()) {
                layer.different += 1;
                layer.first_step.get_or_insert(record.step);
                let apart = (f64::from(x) - f64::from(y)).abs();
                // `max` drops NaN, which would hide the worst difference.
                layer.largest =
                    layer.largest.max(if apart.is_nan() { f64::INFINITY } else { apart });
                first.get_or_insert_with(|| difference(record, at, x, y));
            }
        }
    }
    Ok(Comparison { first, layers: layers.into_values().collect() })
}

/// The values of a record in both recordings.
struct Paired<'r> {
    /// That of the recording that has it.
    record: &'r Record,
    a: &'r [f32],
    b: &'r [f32],
}

/// Records side by side. Records whose rows vary with the state may be missing on one side, and are empty there.
fn pairs<'r>(a: &'r Recording, b: &'r Recording) -> Result<Vec<Paired<'r>>, Incomparable> {
    let varies = |record: &&&Record| record.content.rows_vary();
    let order = |record: &Record| (record.content, record.index);
    let (mut rest_a, mut rest_b) = (a.records.iter().peekable(), b.records.iter().peekable());
    let mut pairs = Vec::new();
    loop {
        let (x, y) = (rest_a.peek(), rest_b.peek());
        // Records of impacts may be missing on one side; their order says on which.
        let (next_x, next_y) = match (x.filter(varies), y.filter(varies)) {
            (None, None) => (rest_a.next(), rest_b.next()),
            (Some(_), None) => (rest_a.next(), None),
            (None, Some(_)) => (None, rest_b.next()),
            (Some(x), Some(y)) => match order(x).cmp(&order(y)) {
                Ordering::Less => (rest_a.next(), None),
                Ordering::Equal => (rest_a.next(), rest_b.next()),
                Ordering::Greater => (None, rest_b.next()),
            },
        };
        let Some(record) = next_x.or(next_y) else { return Ok(pairs) };
        let both = next_x.zip(next_y);
        let other_widths = both.is_some_and(|(x, y)| x.columns != y.columns);
        // Another width or layer means another configuration, where a comparison of elements says
        // nothing.
        if other_widths || (!record.content.rows_vary() && describe(next_x) != describe(next_y)) {
            let (position, a, b) = (pairs.len(), describe(next_x), describe(next_y));
            return Err(Incomparable::Layers { position, a, b });
        }
        let values = |record: Option<&'r Record>| record.map_or(&[][..], |record| &record.values);
        pairs.push(Paired { record, a: values(next_x), b: values(next_y) });
    }
}

fn difference(record: &Record, at: usize, a: f32, b: f32) -> FirstDifference {
    // A file may claim 0 columns.
    let (row, element) = (at / record.columns.max(1), at % record.columns.max(1));
    FirstDifference {
        step: record.step,
        layer: record.content.name(),
        unit: record.content.unit(record.index, row),
        index: record.index,
        row,
        element,
        a,
        b,
        a_bits: a.to_bits(),
        b_bits: b.to_bits(),
    }
}

fn describe(record: Option<&Record>) -> String {
    let Some(record) = record else { return "missing".into() };
    let rows = record.values.len() / record.columns.max(1);
    let Record { step, index, columns, .. } = record;
    format!("{} {index} of step {step} ({rows} x {columns})", record.content.name())
}
