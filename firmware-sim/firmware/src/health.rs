//! What the image `health` says of ten units. This machine compiles this file too, for `tests/tests/all/health.rs`, so that both say the
//! same.

use nalgebra::{Isometry3, Translation3};
use rigidformer_core::{Health, Simulator, StepError};
use rigidformer_weights::Ranges;

/// What training saw: nano's file has no room for it in the flash of these boards, so the ranges stand here. They are those of edge's
/// file, which learnt from the same scenes in the same measure.
#[rustfmt::skip]
pub const RANGES: Ranges = Ranges {
    of: [
        [0.0, 15.923282], // speed
        [0.0, 21.576738], // spin
        [-1.3470308, 0.40278804], // ln radius
        [0.17971553, 0.97999793], // thickness
        [-5.758547, 1.9784571], // ln mass
        [0.00069525215, 0.9987564], // friction
        [0.0025119274, 0.79889053], // restitution
        [0.8303917, 14.807622], // step code
        [9.0, 11.0], // gravity
        [0.9, 1.1], // footing
        [3.4339871, 7.0405364], // ln points
        [0.029315513, 0.5432538], // spacing
        [0.019311607, 0.74319124], // hole
        [-0.0071516326, 0.012848366], // depth
    ],
};

/// Which unit is tampered with.
const UNIT: usize = 3;

/// A pose a step before another one, this way.
fn before(pose: &Isometry3<f32>, x: f32, y: f32, z: f32) -> Isometry3<f32> {
    Translation3::new(x, y, z) * pose
}

/// Says of every unit how far it is from what training saw: bits of what is outside, the quantity that is farthest, and the bits of how
/// far.
fn say_all(
    board: &Simulator<'_, '_>,
    what: &'static str,
    say: &mut impl FnMut(&'static str, [u32; 4]),
) {
    for (number, unit) in (0..).zip(board.units()) {
        let Some(health) = board.health_within(unit.id(), Some(&RANGES)) else { continue };
        let (quantity, beyond) = health
            .farthest
            .map_or((u32::MAX, 0.0), |excess| (excess.quantity as u32, excess.beyond));
        say(what, [number, health.outside, quantity, beyond.to_bits()]);
    }
}

/// Observed units, then one that is ten times too fast, then one that a broken sensor sends out of the world, in quarantine.
pub fn tell(
    board: &mut Simulator<'_, '_>,
    mut say: impl FnMut(&'static str, [u32; 4]),
) -> Result<(), &'static str> {
    say_all(board, "observed", &mut say);
    let unit = board.unit(UNIT).ok_or("there is no such unit")?;
    let (id, pose) = (unit.id(), unit.pose());
    // 2 m in a step is faster than anything that training saw.
    let fast = before(&pose, 2.0, 0.0, 0.0);
    board.set_poses(id, &fast, &pose).map_err(|_| "a pose was refused")?;
    say_all(board, "too fast", &mut say);

    let seen = before(&pose, 0.003, 0.004, 0.0);
    // Deviations of 1 mm and 0.01 rad.
    let variances = [1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4];
    let innovation = Health::innovation(&pose, &seen, &variances).map_err(|_| "no innovation")?;
    say("innovation", [innovation.to_bits(), 0, 0, 0]);

    // Both poses are within 1e6 m, which edits accept, and the next step leaves it.
    let (from, to) = (before(&pose, -9e5, 0.0, 0.0), before(&pose, 9e5, 0.0, 0.0));
    board.set_poses(id, &from, &to).map_err(|_| "a pose was refused")?;
    let there = board.get(id).ok_or("the unit is gone")?.internal_pose();
    match board.step() {
        Err(StepError::Diverged { unit }) => say("diverged", [unit as u32, 0, 0, 0]),
        _ => return Err("a step out of the world was taken"),
    }
    board.set_quarantine(true);
    // The second step shows that the unit stays in quarantine.
    for _ in 0..2 {
        let report = board.step().map_err(|_| "a step was refused")?;
        say("quarantine", [report.quarantined_units, 0, 0, 0]);
    }
    let held = board.get(id).ok_or("the unit is gone")?;
    if !held.is_quarantined() || held.internal_pose() != there {
        return Err("a unit in quarantine has moved");
    }
    board.set_poses(id, &pose, &pose).map_err(|_| "a pose was refused")?;
    let report = board.step().map_err(|_| "a step was refused")?;
    say("released", [report.quarantined_units, 0, 0, 0]);
    Ok(())
}
