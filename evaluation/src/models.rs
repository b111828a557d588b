//! Model files: packed from the lab's export, quantised, or made of random numbers.
//!
//! The lab exports safetensors whose tensors have the model's own names; [`pack`] turns such a file into the packed
//! format (`weights/FORMAT.md`) that [`LoadedModel`](rigidformer_runtime::models::LoadedModel) and firmware read in place.

mod error;
mod export;
mod pack;
mod provenance;
mod quantise;
pub mod random;

pub use error::{PackError, SourceProblem};
pub use export::{ExportError, ExportProblem};
pub use pack::{pack, pack_bytes, packed};
pub use provenance::{with_metrics, with_provenance, with_ranges, with_rules, with_scope};
pub use quantise::{
    LayerReport, Policy, Precision, Quantised, WIDE, WIDE_MIXED, quantise, quantised, sqnr_db,
};
