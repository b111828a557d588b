//! Errors of the elementary functions over the ranges that the core uses, against f64: the table
//! of `docs/MATH.md`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use micromath::F32Ext;
use rigidformer_core::math;

/// Sines are added to other numbers, so that an error matters against 1, not against a zero of
/// theirs.
enum Bound {
    Ulp(f64),
    Absolute(f64),
}

/// A function of `core/src/math.rs`.
struct Function {
    name: &'static str,
    /// Where the core calls it.
    range: (f32, f32),
    exact: fn(f64) -> f64,
    libm: fn(f32) -> f32,
    /// Our own, where there is one.
    ours: Option<fn(f32) -> f32>,
    micromath: fn(f32) -> f32,
    /// Largest error allowed to what is used.
    bound: Bound,
}

const FUNCTIONS: [Function; 6] = [
    Function {
        name: "exp, softmax and pooling",
        range: (-80.0, 0.0),
        exact: f64::exp,
        libm: libm::expf,
        ours: Some(math::exp),
        micromath: F32Ext::exp,
        bound: Bound::Ulp(1.2),
    },
    Function {
        name: "exp, sigmoid and SiLU",
        range: (-20.0, 20.0),
        exact: f64::exp,
        libm: libm::expf,
        ours: Some(math::exp),
        micromath: F32Ext::exp,
        bound: Bound::Ulp(1.2),
    },
    Function {
        name: "ln of a mass",
        range: (1e-3, 1e4),
        exact: f64::ln,
        libm: libm::logf,
        ours: None,
        micromath: F32Ext::ln,
        bound: Bound::Ulp(1.0),
    },
    Function {
        name: "sin of a rotary angle",
        range: (-200.0, 200.0),
        exact: f64::sin,
        libm: libm::sinf,
        ours: Some(|x| math::sin_cos(x).0),
        micromath: F32Ext::sin,
        bound: Bound::Absolute(1e-7),
    },
    Function {
        name: "cos of a rotary angle",
        range: (-200.0, 200.0),
        exact: f64::cos,
        libm: libm::cosf,
        ours: Some(|x| math::sin_cos(x).1),
        micromath: F32Ext::cos,
        bound: Bound::Absolute(1e-7),
    },
    Function {
        name: "sqrt",
        range: (1e-12, 1e6),
        exact: f64::sqrt,
        libm: libm::sqrtf,
        ours: None,
        micromath: F32Ext::sqrt,
        bound: Bound::Ulp(0.5),
    },
];

/// Samples of each kind and sign.
const SAMPLES: u32 = 1 << 20;

/// Evenly spaced numbers of a range, and numbers evenly spaced by their bits, which are as many
/// in each power of two.
fn samples((low, high): (f32, f32)) -> impl Iterator<Item = f32> {
    let even = (0..=SAMPLES).map(move |i| {
        (f64::from(low) + (f64::from(high) - f64::from(low)) * f64::from(i) / f64::from(SAMPLES))
            as f32
    });
    let by_bits = |from: f32, to: f32| {
        let (from, to) = (from.to_bits(), to.to_bits());
        let stride = ((to - from) / SAMPLES).max(1);
        (from..=to).step_by(stride as usize).map(f32::from_bits)
    };
    let smallest = if low > 0.0 { low } else { 1e-6 };
    let positive = (high > smallest).then(|| by_bits(smallest, high));
    let negative = (low < -1e-6).then(|| by_bits(1e-6, -low).map(|x| -x));
    even.chain(positive.into_iter().flatten()).chain(negative.into_iter().flatten())
}

/// Distance to the next f32 at the size of `exact`.
fn ulp(exact: f64) -> f64 {
    let size = (exact.abs() as f32).max(f32::MIN_POSITIVE);
    f64::from(f32::from_bits(size.to_bits() + 1)) - f64::from(size)
}

/// Largest error in units in the last place, absolute, and relative.
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    ulp: f64,
    absolute: f64,
    relative: f64,
}

impl Errors {
    fn add(&mut self, found: f32, exact: f64) {
        let error = (f64::from(found) - exact).abs();
        assert!(error.is_finite(), "{found} for {exact}");
        self.ulp = self.ulp.max(error / ulp(exact));
        self.absolute = self.absolute.max(error);
        self.relative = self.relative.max(error / exact.abs().max(1e-30));
    }
}

#[test]
fn functions_keep_their_bounds() {
    println!(
        "| function | range | ours: ulp | absolute | libm: ulp | relative | micromath: ulp | absolute | relative |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for f in FUNCTIONS {
        let (mut ours, mut libm, mut micro) =
            (Errors::default(), Errors::default(), Errors::default());
        for x in samples(f.range) {
            let exact = (f.exact)(f64::from(x));
            libm.add((f.libm)(x), exact);
            micro.add((f.micromath)(x), exact);
            if let Some(f) = f.ours {
                ours.add(f(x), exact);
            }
        }
        let shown = f.ours.map_or_else(
            || "- | -".to_owned(),
            |_| format!("{:.3} | {:.1e}", ours.ulp, ours.absolute),
        );
        println!(
            "| {} | {} to {} | {} | {:.3} | {:.1e} | {:.0e} | {:.1e} | {:.1e} |",
            f.name,
            f.range.0,
            f.range.1,
            shown,
            libm.ulp,
            libm.relative,
            micro.ulp,
            micro.absolute,
            micro.relative
        );
        let used = if f.ours.is_some() { ours } else { libm };
        let kept = match f.bound {
            Bound::Ulp(most) => used.ulp <= most + 1e-6,
            Bound::Absolute(most) => used.absolute <= most,
        };
        assert!(kept, "{}: {used:?}", f.name);
    }
}
