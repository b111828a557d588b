//! Kernels.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod checks;
mod lengths;
mod methods;
