//! What tells a model from another in a snapshot.

use super::words::Hash;
use crate::model::Model;
use rigidformer_weights::{Shape, TensorData};

/// Numbers of a tensor that are looked at: training changes all of them, and a snapshot must not read megabytes.
const LOOKED_AT: usize = 16;

/// A number that a model shares with no other, but with itself in the order in which a host multiplies int8 matrices.
pub(super) fn identity(model: &Model<'_>) -> u64 {
    let mut hash = Hash::NEW;
    let config = model.config();
    let numbers = [config.frame_rate_hz, config.output_scale]
        .into_iter()
        .chain([config.similarity.length_m, config.similarity.longest_step])
        .chain([config.ground_friction, config.ground_restitution])
        .chain(config.gravity_m_s2);
    numbers.for_each(|number| hash.add(number.to_bits()));
    let counts = [config.width, config.heads, config.blocks, config.command_size, config.bonds];
    let counts = counts
        .into_iter()
        .chain([config.features.len(), config.motion.outputs()].map(|count| count as u32));
    counts.for_each(|count| hash.add(count));
    for tensor in model.file().tensors() {
        tensor.name.bytes().for_each(|byte| hash.add(byte.into()));
        let (rows, columns) = match tensor.shape {
            Shape::Scalar => (1, 0),
            Shape::Vector(length) => (length, 0),
            Shape::Matrix { rows, columns } => (rows, columns),
        };
        hash.add(rows);
        hash.add(columns);
        let (dtype, numbers) = match tensor.data {
            TensorData::F32(values) => (0, values),
            TensorData::F16(values) => {
                values.iter().take(LOOKED_AT).for_each(|v| hash.add(v.to_bits().into()));
                (1, &[][..])
            }
            TensorData::I8 { scales, .. } => (2, scales),
            TensorData::Panels(panels) => (2, panels.scales),
        };
        hash.add(dtype);
        numbers.iter().take(LOOKED_AT).for_each(|number| hash.add(number.to_bits()));
    }
    hash.number()
}
