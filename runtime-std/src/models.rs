//! Model files: loaded, or packed from the lab's export.
//!
//! The lab exports safetensors whose tensors have the model's own names; [`pack`] turns such a file into the packed
//! format (`weights/FORMAT.md`) that [`LoadedModel`] and firmware read in place.

mod error;
mod export;
mod loaded;
mod map;
mod pack;
mod panels;
mod provenance;
mod quantise;
pub mod random;

pub use error::{ModelError, PackError, SourceProblem};
pub use export::{ExportError, ExportProblem};
pub use loaded::LoadedModel;
pub use pack::{pack, pack_bytes, packed};
pub use panels::to_panels;
pub use provenance::{with_provenance, with_ranges, with_scope};
pub use quantise::{
    LayerReport, Policy, Precision, Quantised, WIDE, WIDE_MIXED, quantise, sqnr_db,
};
