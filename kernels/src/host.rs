//! Kernels of hosts: the core's arithmetic, and int8 products that threads share by output channel.

use rigidformer_core::quant::Scratch;
use rigidformer_core::weights::Panels;
use rigidformer_core::{Kernels, Portable};

use crate::columns::Columns;

/// Quantised rows, in the layout of the kernels that made them.
#[derive(Clone, Copy)]
pub struct Quantised<'a> {
    /// (rows, [`row_bytes`](HostKernels::row_bytes))
    pub values: &'a [i8],
    /// (rows) The quantisation scale.
    pub scales: &'a [f32],
    /// Numbers in a row.
    pub inputs: usize,
}

/// Kernels whose int8 products can be shared out by output channel.
pub trait HostKernels: Kernels + Send {
    /// Bytes that a quantised row of so many inputs takes.
    fn row_bytes(self, inputs: usize) -> usize;

    /// [`Kernels::linear_panels`] for the output channels of `weight` and `bias` (all empty, or one a channel), into as
    /// many columns and for as many rows as `out` has.
    fn multiply(self, x: Quantised<'_>, weight: Panels<'_>, bias: &[f32], out: Columns<'_>);
}

impl HostKernels for Portable {
    fn row_bytes(self, inputs: usize) -> usize {
        inputs
    }

    fn multiply(self, x: Quantised<'_>, weight: Panels<'_>, bias: &[f32], mut out: Columns<'_>) {
        let rows = x.values.chunks_exact(x.inputs.max(1)).zip(x.scales);
        for (index, (values, scale)) in rows.enumerate().take(out.rows()) {
            // `Scratch` borrows mutably, and threads share the rows, so each row is copied.
            let mut row = values.to_vec();
            let mut scratch = Scratch { values: &mut row, scales: &mut [*scale] };
            self.linear_panels(&mut scratch, weight, bias, x.inputs, out.row(index));
        }
    }
}
