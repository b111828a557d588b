//! What an image without a logger has: a panic handler that cannot be linked, and inputs.

use core::panic::PanicInfo;

use nalgebra::{Isometry3, Point3};
use rigidformer_core::{Observed, Physics, Posed, Unit};

unsafe extern "C" {
    fn the_runtime_must_not_be_able_to_panic() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: does not exist, so whatever links cannot come here.
    unsafe { the_runtime_must_not_be_able_to_panic() }
}

// The image is linked and never run, so any points will do.
static POINTS: [Point3<f32>; 8] = [Point3::new(0.0, 0.0, 0.0); 8];
const UNIT: Unit<'static> =
    Unit::new(&POINTS, Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 });

/// What a program would see. The caller hides from the optimiser what is in it, and how many there are.
#[cfg(not(feature = "deform"))]
pub static SEEN: [Observed<'static>; 1] = [Observed { unit: UNIT, current: &POINTS }];

/// What a program would see of a soft body.
#[cfg(feature = "deform")]
pub fn patches() -> [Observed<'static>; 1] {
    [Observed { unit: UNIT.soft(&POINTS, 1e4), current: &POINTS }]
}

/// What a program would know.
pub fn known() -> [Posed<'static>; 1] {
    let pose = Isometry3::identity();
    [Posed { unit: UNIT, previous: pose, current: pose }]
}
