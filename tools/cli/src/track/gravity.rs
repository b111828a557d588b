//! Where gravity is from.

use nalgebra::Vector3;
use rigidformer_perception::gravity::{Gravity, Known, STANDARD_M_S2};

use super::source::Source;
use crate::arguments::Track;
use crate::usage::Usage;

/// Gravity as it is given, else as it is seen.
pub(super) fn gravity(arguments: &Track, source: &mut Source) -> anyhow::Result<Gravity> {
    let given = |m_s2| Ok(Gravity::new(m_s2, Known::Given));
    match (&arguments.gravity[..], &arguments.up[..]) {
        ([x, y, z], []) => return given(Vector3::new(*x, *y, *z)),
        ([], [x, y, z]) => match Vector3::new(*x, *y, *z).try_normalize(1e-9) {
            Some(up) if up.iter().all(|number| number.is_finite()) => {
                return given(up * -STANDARD_M_S2);
            }
            _ => return Err(Usage("--up needs a direction, such as 0,0,1".into()).into()),
        },
        ([], []) => {}
        ([], _) => return Err(Usage("--up needs three numbers, such as 0,0,1".into()).into()),
        _ => {
            return Err(Usage("--gravity needs three numbers, such as 0,0,-9.81".into()).into());
        }
    }
    if let Some(m_s2) = source.gravity_m_s2() {
        return given(m_s2);
    }
    let seen = source.peek()?.map(Gravity::seen);
    if let Some(up) = source.measured_up() {
        let in_camera = seen.is_some_and(|seen| seen.in_camera);
        return Ok(Gravity { in_camera, ..Gravity::new(up * -STANDARD_M_S2, Known::Imu) });
    }
    Ok(seen.unwrap_or_else(|| Gravity::new(Vector3::new(0.0, 0.0, -STANDARD_M_S2), Known::Assumed)))
}

/// How it is known, for programs.
pub(super) fn word(known: Known) -> &'static str {
    match known {
        Known::Given => "given",
        Known::Imu => "imu",
        Known::LargestPlane => "largest plane",
        _ => "assumed",
    }
}

/// What a user should know about it.
pub(super) fn note(gravity: &Gravity) -> Option<String> {
    let g = gravity.m_s2;
    let value = format!("{:.2},{:.2},{:.2}", g.x, g.y, g.z);
    match (gravity.known, gravity.in_camera) {
        (Known::Imu, _) => Some(format!("gravity {value} is by the recording's inertial sensor")),
        (Known::LargestPlane, true) => Some(format!(
            "gravity {value} takes the largest plane to be level: the world is the camera's frame, where -z is never down; --up says better"
        )),
        (Known::LargestPlane, false) => Some(format!(
            "gravity {value} takes the largest plane to be level: no plane is level by z; --up says better"
        )),
        (Known::Assumed, true) => Some(format!(
            "gravity {value} is a guess, and wrong in a camera's own frame: say --up, such as 0,-1,0 for a level camera"
        )),
        (Known::Assumed, false) => {
            Some(format!("gravity {value} is assumed: the recording does not say it"))
        }
        _ => None,
    }
}
