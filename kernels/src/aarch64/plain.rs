//! Loops that the compiler makes vectors of: the definitions of `Kernels`, four registers at a time. In the definitions'
//! own shape it takes one, and each instruction of an exponential waits for the one before.

use rigidformer_core::math;

/// Numbers at a time.
const WIDTH: usize = 16;

/// As `Kernels::gate`.
pub(super) fn gate(x: &mut [f32], share: f32, gate: &[f32]) {
    let length = x.len().min(gate.len());
    let (x, x_rest) = x[..length].as_chunks_mut::<WIDTH>();
    let (gate, gate_rest) = gate[..length].as_chunks::<WIDTH>();
    let gated = |x: f32, gate: f32| (x * share) * math::sigmoid(gate);
    for (x, gate) in x.iter_mut().zip(gate) {
        for (x, gate) in x.iter_mut().zip(gate) {
            *x = gated(*x, *gate);
        }
    }
    for (x, gate) in x_rest.iter_mut().zip(gate_rest) {
        *x = gated(*x, *gate);
    }
}

/// As `Kernels::silu`.
pub(super) fn silu(x: &mut [f32]) {
    let (x, rest) = x.as_chunks_mut::<WIDTH>();
    for x in x {
        for x in x {
            *x = math::silu(*x);
        }
    }
    for x in rest {
        *x = math::silu(*x);
    }
}
