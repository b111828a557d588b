//! A sheet of cloth of eight patches falls on a sphere and hangs from it: twelve steps of a twelfth of a second. Poses and points
//! as bits. Needs the feature `drape`.
#![no_std]
#![no_main]

use defmt::Display2Format;
use nalgebra::Point3;
use rigidformer_core::{Observed, Simulator, Unit};
use rigidformer_firmware::counter::Counter;
use rigidformer_firmware::drape::{Drape, STEPS, each_number, wrong};
use rigidformer_firmware::memory::{LIMITS, SIZES, slabs};
use rigidformer_firmware::rollout::{Board, Hash, Rollout, load};
use rigidformer_firmware::snapshot::go_back;
use rigidformer_firmware::{image, scene};
use rigidformer_weights::SHELL;

#[cortex_m_rt::entry]
fn main() -> ! {
    image::run(case)
}

/// Tries to observe the sheet with a patch that cannot be.
fn try_patch<'d>(
    board: &mut Board<'_>,
    drape: &Drape<'d>,
    name: &'static str,
    change: impl Fn(&mut Observed<'d>) + Clone,
) {
    if let Err(error) = board.observe(drape.seconds(), wrong(drape, change)) {
        defmt::info!("{=str}: {}", name, Display2Format(&error));
    }
}

/// What may be wrong with a patch: each is refused, and the sheet falls on as it did.
fn refusals(board: &mut Board<'_>, drape: &Drape<'_>) {
    static NOWHERE: [Point3<f32>; 32] = [Point3::new(0.0, f32::NAN, 0.0); 32];
    try_patch(board, drape, "no number", |seen| seen.current = &NOWHERE);
    try_patch(board, drape, "a point too few", |seen| {
        if let Some((_, fewer)) = seen.current.split_last() {
            seen.current = fewer;
        }
    });
    try_patch(board, drape, "no stiffness", |seen| {
        if let Some(soft) = seen.unit.soft {
            seen.unit = seen.unit.soft(soft.rest, 0.0);
        }
    });
    let first = board.unit(0).map(|unit| unit.id());
    if let Some(Err(error)) = first.map(|id| board.remove(id)) {
        defmt::info!("a patch less: {}", Display2Format(&error));
    }
    let Some(Observed { unit, .. }) = drape.units().next() else { return };
    let here = nalgebra::Isometry3::identity();
    if let Err(error) = board.add(&Unit { soft: None, ..unit }, &here, &here) {
        defmt::info!("a unit more: {}", Display2Format(&error));
    }
}

fn case(counter: Counter) -> Result<(), &'static str> {
    let model = load(SHELL)?;
    let slabs = slabs().ok_or("the slabs are taken")?;
    let mut board: Board<'_> =
        Simulator::new(&model, LIMITS, slabs).map_err(|_| "the slabs are too short")?;
    let drape = Drape::read(scene::DRAPE).ok_or("the scene in flash is damaged")?;
    let start = counter.now();
    drape.observe(&mut board)?;
    defmt::info!("measured observe {=u32}", counter.since(start));
    let mut rollout = Rollout::new(counter);
    let mut hash = Hash::default();
    for step in 0..STEPS {
        // In the middle, so that the poses at the end show that nothing has changed.
        if step == STEPS / 2 {
            refusals(&mut board, &drape);
            go_back(&mut board, "drape")?;
        }
        rollout.step(&mut board)?;
        each_number(&board, |number| hash.add(number));
    }
    rollout.end(&board, "drape").report("drape");
    defmt::info!("drape: {=u32} steps, points {=u64:016x}", STEPS, hash.value());
    defmt::info!("measured workspace {=usize}", SIZES.bytes());
    Ok(())
}
