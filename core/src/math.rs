//! The one place that every transcendental function comes from, so that every target
//! computes the same bits: `libm`'s portable versions, never the platform's.

/// Square root, correctly rounded.
pub(crate) fn sqrt(x: f32) -> f32 {
    libm::sqrtf(x)
}

/// e to the x.
pub(crate) fn exp(x: f32) -> f32 {
    libm::expf(x)
}

/// Natural logarithm.
pub(crate) fn ln(x: f32) -> f32 {
    libm::logf(x)
}

/// Sine and cosine of an angle in radians.
pub(crate) fn sin_cos(x: f32) -> (f32, f32) {
    (libm::sinf(x), libm::cosf(x))
}

/// Logistic function, 1 / (1 + e^-x).
pub(crate) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}

/// x times its logistic function (SiLU).
pub(crate) fn silu(x: f32) -> f32 {
    x / (1.0 + exp(-x))
}
