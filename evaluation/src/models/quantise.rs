//! From an f32 packed model to int8 or f16 weights, layer by layer.

use std::path::Path;

use half::f16;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::quant;
use rigidformer_runtime::models::{LoadedModel, ModelError};
use rigidformer_weights::{
    AlignedBuffer, DType, ModelFile, ModelWriter, Shape, Tensor, TensorData,
};
use serde::Serialize;

use super::error::{PackError, SourceProblem};

/// What the weights of linear layers become. Everything else (norms, biases, registers, constants) stays f32.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// As they are: the reference.
    F32,
    /// All f16.
    F16,
    /// int8 with a scale per output channel; layers of [`WIDE`] f16.
    I8,
    /// As [`Precision::I8`], and layers of [`WIDE_MIXED`] f16 too: for models that int8 hurts.
    Mixed,
}

/// Layers that an int8 model keeps at f16: the first ones of points, impacts, anchors and bonds see inputs of very different size
/// in one row, the last is the answer. All are small. `docs/QUANTISATION.md` has the measurement.
pub const WIDE: [&str; 5] =
    ["encoder.point.0", "encoder.impact.0", "anchors.query.0", "anchors.head.1", "bonds.net.0"];

/// Layers that a mixed model keeps at f16 besides: the whole point network, anchor queries and the head.
pub const WIDE_MIXED: [&str; 6] = [
    "encoder.point.1",
    "encoder.impact.1",
    "anchors.avp.0",
    "anchors.avp.1",
    "anchors.query.1",
    "anchors.head.0",
];

/// A precision and the layers that are exceptions to it, by name (such as `blocks.0.attention.qkvg`). Exceptions matter to
/// [`Precision::I8`] and [`Precision::Mixed`] alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Policy {
    /// What the linear layers become.
    pub precision: Precision,
    /// Further layers to keep at f16.
    pub wide: Vec<String>,
    /// Layers to make int8 although the precision keeps them at f16; a layer of both lists is f16. A controller without
    /// fast f16 wants the first layer int8: every point goes through it.
    pub narrow: Vec<String>,
}

impl From<Precision> for Policy {
    fn from(precision: Precision) -> Self {
        Policy { precision, wide: Vec::new(), narrow: Vec::new() }
    }
}

/// What became of one tensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LayerReport {
    /// Name of the tensor.
    pub name: String,
    /// `f32`, `f16` or `i8`.
    pub dtype: String,
    /// Elements.
    pub parameters: u64,
    /// Bytes of elements and scales.
    pub bytes: u64,
    /// Signal to quantisation noise of the weights, decibels; none where they are exact.
    pub sqnr_db: Option<f64>,
    /// Why a linear layer was kept wider than asked.
    pub kept_wide: Option<&'static str>,
}

/// Bytes and layers of a quantised model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quantised {
    /// The packed model, which has been loaded.
    #[serde(skip)]
    pub file: Vec<u8>,
    /// A row a tensor, by name.
    pub layers: Vec<LayerReport>,
    /// Elements of all tensors.
    pub parameters: u64,
}

impl Quantised {
    /// Bytes of the file for each parameter.
    pub fn bytes_per_parameter(&self) -> f64 {
        self.file.len() as f64 / self.parameters.max(1) as f64
    }
}

/// An f32 model, quantised ([`quantise`]).
///
/// # Errors
/// As [`quantise`].
pub fn quantised(model: &LoadedModel, policy: &Policy) -> Result<LoadedModel, PackError> {
    let quantised = quantise(model.path(), model.bytes(), policy)?;
    Ok(LoadedModel::copy_of(model.path(), &quantised.file)?)
}

/// Quantises the linear layers of a packed f32 model; errors call it `name`.
///
/// # Errors
/// [`PackError`] when the input is no model, is quantised already, or the policy names a linear layer that it lacks.
pub fn quantise(name: &Path, packed: &[u8], policy: &Policy) -> Result<Quantised, PackError> {
    // Codes and scales of a model are the same whoever packs it.
    in_own_environment(|| quantise_here(name, packed, policy))
}

fn quantise_here(name: &Path, packed: &[u8], policy: &Policy) -> Result<Quantised, PackError> {
    let buffer = AlignedBuffer::copy_of(packed);
    let file = ModelFile::parse(&buffer).map_err(|source| {
        PackError::Model(ModelError::Load { path: name.into(), source: source.into() })
    })?;
    let source_error = |source| PackError::Source { path: name.into(), source };
    // Quantising twice would add a second error to the first.
    if let Some(tensor) = file.tensors().find(|t| t.data.dtype() != DType::F32) {
        let (tensor, dtype) = (tensor.name.to_owned(), tensor.data.dtype().to_string());
        return Err(source_error(SourceProblem::NotF32 { tensor, dtype }));
    }
    // A misspelt layer would stay int8 without a word.
    let unknown = |layer: &&String| !file.tensors().any(|t| layer_of(&t) == Some(layer.as_str()));
    for (option, layers) in [("--wide", &policy.wide), ("--narrow", &policy.narrow)] {
        if let Some(layer) = layers.iter().find(unknown) {
            return Err(source_error(SourceProblem::NoSuchLayer { option, layer: layer.clone() }));
        }
    }

    let tensors: Vec<(Tensor<'_>, Stored, Option<&'static str>)> = file
        .tensors()
        .map(|tensor| {
            let (dtype, why) = choose(&tensor, policy);
            let stored = Stored::new(&tensor, dtype);
            (tensor, stored, why)
        })
        .collect();
    let mut writer = ModelWriter::new(file.name(), *file.config()).ranges(file.ranges().copied());
    for (key, value) in file.provenance() {
        writer = writer.provenance(key, value);
    }
    // An f32 model stays what it was, byte for byte.
    if policy.precision != Precision::F32 {
        let text = format!("{:?} by channel", policy.precision).to_lowercase();
        writer = writer.provenance("quantised", &text);
    }
    for (metric, value) in file.metrics() {
        writer = writer.metric(metric, value);
    }
    for (tensor, stored, _) in &tensors {
        writer = writer.tensor(tensor.name, tensor.shape, stored.data(tensor));
    }
    let packed =
        writer.finish().map_err(|source| PackError::Write { path: name.into(), source })?;
    // Loading checks every tensor, so that no file is written that does not load.
    LoadedModel::copy_of(name, &packed)?;
    let layers = tensors.iter().map(|(tensor, stored, why)| report(tensor, stored, *why)).collect();
    Ok(Quantised { file: packed, layers, parameters: file.parameters() })
}

/// Name of the linear layer that a tensor is the weight of.
fn layer_of<'t>(tensor: &Tensor<'t>) -> Option<&'t str> {
    match tensor.shape {
        Shape::Matrix { .. } => tensor.name.strip_suffix(".weight"),
        _ => None,
    }
}

fn choose(tensor: &Tensor<'_>, policy: &Policy) -> (DType, Option<&'static str>) {
    let Some(layer) = layer_of(tensor) else { return (DType::F32, None) };
    let named = |layers: &[String]| layers.iter().any(|l| l == layer);
    match policy.precision {
        Precision::F32 => (DType::F32, None),
        Precision::F16 => (DType::F16, None),
        Precision::I8 | Precision::Mixed => {
            // The caller's lists come first: exceptions are what they are for.
            if named(&policy.wide) {
                (DType::F16, Some("asked for"))
            } else if named(&policy.narrow) {
                (DType::I8, None)
            } else if WIDE.contains(&layer) {
                (DType::F16, Some("first or last layer"))
            } else if is_wide(layer, policy.precision) {
                (DType::F16, Some("mixed precision"))
            } else {
                (DType::I8, None)
            }
        }
    }
}

/// Whether an int8 or mixed model keeps this layer f16 unless it is told otherwise.
pub(super) fn is_wide(layer: &str, precision: Precision) -> bool {
    WIDE.contains(&layer) || precision == Precision::Mixed && WIDE_MIXED.contains(&layer)
}

/// Values of a tensor in its new type.
enum Stored {
    F32,
    F16(Vec<f16>),
    I8 { values: Vec<i8>, scales: Vec<f32> },
}

impl Stored {
    fn new(tensor: &Tensor<'_>, dtype: DType) -> Self {
        let TensorData::F32(values) = tensor.data else { return Stored::F32 };
        match dtype {
            DType::F32 => Stored::F32,
            DType::F16 => Stored::F16(values.iter().map(|v| f16::from_f32(*v)).collect()),
            DType::I8 | DType::Panels => {
                let columns = match tensor.shape {
                    // A row of a matrix is an output channel, and each channel has its own scale.
                    Shape::Matrix { columns, .. } => (columns as usize).max(1),
                    _ => values.len().max(1),
                };
                let mut quantised = vec![0; values.len()];
                let rows = values.chunks_exact(columns).zip(quantised.chunks_exact_mut(columns));
                // A channel of zeros has the scale 0, which files refuse.
                let scale = |scale: f32| if scale > 0.0 { scale } else { 1.0 };
                let scales = rows.map(|(row, out)| scale(quant::quantise_row(row, out))).collect();
                Stored::I8 { values: quantised, scales }
            }
        }
    }

    fn data<'a>(&'a self, tensor: &Tensor<'a>) -> TensorData<'a> {
        match self {
            Stored::F32 => tensor.data,
            Stored::F16(values) => TensorData::F16(values),
            Stored::I8 { values, scales } => TensorData::I8 { values, scales },
        }
    }

    /// The values that a reader of the file computes with.
    fn widened(&self, count: usize) -> Option<Vec<f32>> {
        match self {
            Stored::F32 => None,
            Stored::F16(values) => Some(values.iter().map(|v| v.to_f32()).collect()),
            Stored::I8 { values, scales } => {
                let columns = (count / scales.len().max(1)).max(1);
                let rows = values.chunks_exact(columns).zip(scales);
                Some(rows.flat_map(|(row, s)| row.iter().map(move |q| f32::from(*q) * s)).collect())
            }
        }
    }
}

fn report(tensor: &Tensor<'_>, stored: &Stored, kept_wide: Option<&'static str>) -> LayerReport {
    let data = stored.data(tensor);
    let parameters = tensor.shape.elements();
    let scales = match data {
        TensorData::I8 { scales, .. } => 4 * scales.len() as u64,
        _ => 0,
    };
    let sqnr_db = match (&tensor.data, stored.widened(data.len())) {
        (TensorData::F32(exact), Some(widened)) => sqnr_db(exact, &widened),
        _ => None,
    };
    LayerReport {
        name: tensor.name.into(),
        dtype: data.dtype().to_string(),
        parameters,
        bytes: parameters * data.dtype().bytes() + scales,
        sqnr_db,
        kept_wide,
    }
}

/// Signal to noise of an approximation, decibels; none where it is exact.
pub fn sqnr_db(exact: &[f32], approximate: &[f32]) -> Option<f64> {
    let pairs = exact.iter().zip(approximate);
    // Squares of small differences vanish in f32 sums.
    let (signal, noise) = pairs.fold((0.0_f64, 0.0_f64), |(signal, noise), (a, b)| {
        let (a, b) = (f64::from(*a), f64::from(*b));
        (signal + a * a, noise + (a - b) * (a - b))
    });
    // An exact copy has no noise, and infinity is no number in JSON.
    (noise != 0.0).then(|| 10.0 * (signal / noise).log10())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ratio_of_powers_in_decibels() {
        assert_eq!(sqnr_db(&[1.0, 2.0], &[1.0, 2.0]), None);
        let db = sqnr_db(&[10.0; 4], &[11.0; 4]).unwrap();
        assert!((db - 20.0).abs() < 1e-9);
    }

    #[test]
    fn int8_channels_are_within_half_a_quantum() {
        let values: Vec<f32> = (0..96).map(|i| ((i * 29 % 97) as f32 - 48.0) * 0.01).collect();
        let tensor = Tensor {
            name: "x.weight",
            shape: Shape::Matrix { rows: 3, columns: 32 },
            data: TensorData::F32(&values),
        };
        let stored = Stored::new(&tensor, DType::I8);
        let Stored::I8 { scales, .. } = &stored else { panic!("i8 expected") };
        let widened = stored.widened(96).unwrap();
        for (i, (a, b)) in values.iter().zip(&widened).enumerate() {
            assert!((a - b).abs() <= scales[i / 32] * 0.5001);
        }
    }
}
