//! Two recordings, bit by bit.

use std::collections::BTreeMap;
use std::fmt;

use rigidformer_runtime::core::ANCHORS;
use serde::Serialize;

use super::{Part, Recording, Stage};

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
    /// Name of the stage.
    pub layer: &'static str,
    /// The unit.
    pub unit: usize,
    /// Index of the part: the unit, or the scale for tokens.
    pub index: usize,
    /// Row of the part: a point, an anchor, or the unit.
    pub row: usize,
    /// Element of the row.
    pub element: usize,
    /// Value in the first recording.
    pub a: f32,
    /// Value in the second.
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
        match *layer {
            "registers" => write!(f, " at scale {index}, register {row}")?,
            "tokens" => write!(f, " at scale {index}, unit {unit}")?,
            // Rows beyond the units are registers.
            "attention" => write!(f, " of block {index}, unit {unit}")?,
            "features" | "point_features" => write!(f, ", unit {unit}, point {row}")?,
            "advanced" => write!(f, ", unit {unit}, anchor {row}")?,
            "anchor_queries" | "seen" | "anchor_tokens" => {
                write!(f, ", unit {unit}, anchor {}", row % ANCHORS)?;
            }
            _ => write!(f, ", unit {unit}")?,
        }
        write!(f, ", element {element}: {a:e} ({a_bits:#010x}) and {b:e} ({b_bits:#010x})")
    }
}

/// How a layer differs over all steps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LayerDifference {
    /// Name of the stage, with the scale for tokens.
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

/// Compares two recordings of the same run bit by bit; 0 and -0 differ. Names of models are not compared.
///
/// # Errors
/// [`Incomparable`] when scene, step code, steps or layers are not the same.
pub fn compare(a: &Recording, b: &Recording) -> Result<Comparison, Incomparable> {
    let steps = |recording: &Recording| recording.parts.last().map_or(0, |part| part.step);
    for (what, a, b) in [
        ("scene", a.scene.clone(), b.scene.clone()),
        ("step", a.step.to_string(), b.step.to_string()),
        ("steps", steps(a).to_string(), steps(b).to_string()),
    ] {
        if a != b {
            return Err(Incomparable::Run { what, a, b });
        }
    }
    for position in 0..a.parts.len().max(b.parts.len()) {
        let (a, b) = (describe(a.parts.get(position)), describe(b.parts.get(position)));
        if a != b {
            return Err(Incomparable::Layers { position, a, b });
        }
    }
    let mut first = None;
    let mut layers: BTreeMap<(Stage, usize), LayerDifference> = BTreeMap::new();
    for (a, b) in a.parts.iter().zip(&b.parts) {
        let scale = if a.stage.is_by_scale() { a.index } else { 0 };
        let layer = layers.entry((a.stage, scale)).or_insert_with(|| LayerDifference {
            layer: a.stage.label(scale),
            elements: 0,
            different: 0,
            largest: 0.0,
            first_step: None,
        });
        layer.elements += a.values.len() as u64;
        for (at, (x, y)) in a.values.iter().zip(&b.values).enumerate() {
            if x.to_bits() != y.to_bits() {
                layer.different += 1;
                layer.first_step.get_or_insert(a.step);
                let apart = (f64::from(*x) - f64::from(*y)).abs();
                layer.largest =
                    layer.largest.max(if apart.is_nan() { f64::INFINITY } else { apart });
                first.get_or_insert_with(|| difference(a, at, *x, *y));
            }
        }
    }
    Ok(Comparison { first, layers: layers.into_values().collect() })
}

fn difference(part: &Part, at: usize, a: f32, b: f32) -> FirstDifference {
    let (row, element) = (at / part.columns.max(1), at % part.columns.max(1));
    FirstDifference {
        step: part.step,
        layer: part.stage.name(),
        unit: if part.stage.is_by_unit() { part.index } else { row / part.stage.rows_of_a_unit() },
        index: part.index,
        row,
        element,
        a,
        b,
        a_bits: a.to_bits(),
        b_bits: b.to_bits(),
    }
}

fn describe(part: Option<&Part>) -> String {
    let Some(part) = part else { return "missing".into() };
    let rows = part.values.len() / part.columns.max(1);
    let Part { step, index, columns, .. } = part;
    format!("{} {index} of step {step} ({rows} x {columns})", part.stage.name())
}
