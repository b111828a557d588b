//! Tensors as a file holds them.

use core::fmt;

use half::f16;
use serde::{Deserialize, Serialize};

/// How a tensor's elements are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum DType {
    /// IEEE 754 single precision.
    F32,
    /// IEEE 754 half precision.
    F16,
    /// -127 to 127, times one `f32` scale per output channel (row).
    I8,
    /// As `I8`, in [`Panels`]; version 2 of the format.
    Panels,
}

/// Output channels of a panel.
pub const PANEL: usize = 16;
/// Inputs of a channel that stand together in a panel.
pub const PANEL_DEPTH: usize = 4;

/// An int8 matrix in the order in which wide registers multiply it: panels of [`PANEL`] output
/// channels, in each of which [`PANEL_DEPTH`] inputs of the first channel, those of the second
/// and so on stand together, then the next inputs. Zeros fill up both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Panels<'a> {
    /// (rows / 16 rounded up, columns / 4 rounded up, 16, 4), -127 to 127.
    pub values: &'a [i8],
    /// (rows), finite and positive.
    pub scales: &'a [f32],
    /// (rows) sum of each channel's values.
    pub sums: &'a [i32],
}

impl Panels<'_> {
    /// Numbers of all panels of a matrix.
    pub const fn length(rows: u64, columns: u64) -> u64 {
        let rows = rows.div_ceil(PANEL as u64).saturating_mul(PANEL as u64);
        rows.saturating_mul(columns.div_ceil(PANEL_DEPTH as u64).saturating_mul(PANEL_DEPTH as u64))
    }
}

impl DType {
    /// Bytes of one element.
    pub const fn bytes(self) -> u64 {
        match self {
            DType::F32 => 4,
            DType::F16 => 2,
            DType::I8 | DType::Panels => 1,
        }
    }
}

impl fmt::Display for DType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            DType::F32 => "f32",
            DType::F16 => "f16",
            DType::I8 => "i8",
            DType::Panels => "i8 panels",
        })
    }
}

/// Dimensions of a tensor, each at least 1 in a file.
///
/// ```
/// use rigidformer_weights::Shape;
///
/// let shape = Shape::Matrix { rows: 2, columns: 3 };
/// assert_eq!(shape.elements(), 6);
/// assert_eq!(shape.to_string(), "[2, 3]");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Shape {
    /// One number.
    Scalar,
    /// So many numbers.
    Vector(u32),
    /// Row by row; the rows of a linear layer are its output channels.
    Matrix {
        /// Output channels.
        rows: u32,
        /// Input channels.
        columns: u32,
    },
}

impl Shape {
    /// Number of elements.
    pub const fn elements(self) -> u64 {
        match self {
            Shape::Scalar => 1,
            Shape::Vector(length) => length as u64,
            // Two 32-bit factors: no overflow.
            Shape::Matrix { rows, columns } => (rows as u64).saturating_mul(columns as u64),
        }
    }
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Shape::Scalar => write!(f, "[]"),
            Shape::Vector(length) => write!(f, "[{length}]"),
            Shape::Matrix { rows, columns } => write!(f, "[{rows}, {columns}]"),
        }
    }
}

/// Elements of a tensor, row by row, borrowed from the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TensorData<'a> {
    /// All finite.
    F32(&'a [f32]),
    /// All finite.
    F16(&'a [f16]),
    /// Symmetric per output channel: weight (row, column) =
    /// `values[row * columns + column] * scales[row]`.
    I8 {
        /// (rows, columns), -127 to 127.
        values: &'a [i8],
        /// (rows), finite and positive.
        scales: &'a [f32],
    },
    /// As `I8`, in panels.
    Panels(Panels<'a>),
}

impl TensorData<'_> {
    /// How the elements are stored.
    pub const fn dtype(&self) -> DType {
        match self {
            TensorData::F32(_) => DType::F32,
            TensorData::F16(_) => DType::F16,
            TensorData::I8 { .. } => DType::I8,
            TensorData::Panels(_) => DType::Panels,
        }
    }

    /// Number of elements as stored, scales not among them.
    pub const fn len(&self) -> usize {
        match self {
            TensorData::F32(values) => values.len(),
            TensorData::F16(values) => values.len(),
            TensorData::I8 { values, .. } => values.len(),
            TensorData::Panels(panels) => panels.values.len(),
        }
    }

    /// Whether there is no element, which no tensor of a file has.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A named tensor of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tensor<'a> {
    /// Unique in its file.
    pub name: &'a str,
    /// As many elements as `data`.
    pub shape: Shape,
    /// The elements.
    pub data: TensorData<'a>,
}
