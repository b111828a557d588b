//! The functions of the header that change a scene between steps. One that is refused changes nothing.
#![allow(unsafe_code)]

use crate::arrays::{fits, with_simulator};
use crate::convert::{self, isometry};
#[cfg(not(feature = "deform"))]
use crate::types::rf_status::RF_ERROR_NO_BONDS;
#[cfg(not(feature = "compliance"))]
use crate::types::rf_status::RF_ERROR_NO_COMPLIANCE;
#[cfg(not(feature = "terrain"))]
use crate::types::rf_status::RF_ERROR_NO_HEIGHT_FIELD;
#[cfg(not(feature = "robot"))]
use crate::types::rf_status::RF_ERROR_NO_JOINTS;
use crate::types::rf_status::{self, RF_ERROR_TOO_MANY_PLANES};
use crate::types::{
    RF_MAX_PLANES, rf_bonded, rf_compliance, rf_detail, rf_height_field, rf_physics, rf_plane,
    rf_pose, rf_simulator, rf_unit, rf_unit_id, rf_velocity,
};
#[cfg(feature = "robot")]
use nalgebra::Point3;
use nalgebra::Vector3;
#[cfg(feature = "terrain")]
use rigidformer_core::HeightField;
#[cfg(feature = "robot")]
use rigidformer_core::Joint;
use rigidformer_core::{ContactLaw, FrictionLimit, MAX_PLANES, Plane, Simulator, UnitId, Velocity};

/// Adds a unit behind the others, given its poses a step ago and now: twice the same for a unit at
/// rest. The motion of the other units goes on. The scene needs a time step, from an observation or
/// rf_set_dt.
///
/// @param simulator  the simulator
/// @param unit       the unit
/// @param previous   its pose a step ago: carries `unit->points` to the world
/// @param current    its pose now
/// @param id         out: its id; may be NULL
/// @return RF_OK, an error of the call, of the unit (64 to 76; `unit` in the detail is the number
///         that it would have had), RF_ERROR_NO_TIMESTEP, RF_ERROR_BAD_ROLE, RF_ERROR_BAD_BODY or
///         RF_ERROR_DEFORMS. Where it is refused, the scene is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_add(
    simulator: *mut rf_simulator,
    unit: *const rf_unit,
    previous: *const rf_pose,
    current: *const rf_pose,
    id: *mut rf_unit_id,
) -> rf_status {
    // SAFETY: here and below the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            // Outputs are checked first: a call that is refused must change nothing.
            let out = locked.optional(id)?;
            let unit = locked.unit(unit)?;
            let previous = isometry(&locked.one(previous)?);
            let current = isometry(&locked.one(current)?);
            let id = locked.simulator().add(&unit, &previous, &current)?;
            if let Some(out) = out {
                out.write(id.to_bits());
            }
            Ok(())
        })
    }
}

/// Removes a unit. The others keep their ids and their order, and their motion goes on.
///
/// @param simulator  the simulator
/// @param id         which unit
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID or RF_ERROR_DEFORMS. Where it is
///         refused, the scene is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_remove(simulator: *mut rf_simulator, id: rf_unit_id) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| Ok(locked.simulator().remove(UnitId::from_bits(id))?))
    }
}

/// Sends a driven unit to where it will be after the next step. It then stays there until it is sent
/// somewhere else.
///
/// @param simulator  the simulator
/// @param id         which unit, of RF_ROLE_DRIVEN
/// @param pose       where to: carries the unit's reference points to the world
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_NOT_DRIVEN or
///         RF_ERROR_BAD_POSE. Where it is refused, the unit goes where it would have gone
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_drive(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    pose: *const rf_pose,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let pose = isometry(&locked.one(pose)?);
            Ok(locked.simulator().drive(UnitId::from_bits(id), &pose)?)
        })
    }
}

/// Changes where a unit was a step ago and is now, such as after a new measurement: a free unit goes
/// on with the motion from one to the other.
///
/// @param simulator  the simulator
/// @param id         which unit
/// @param previous   its pose a step ago: carries the unit's reference points to the world
/// @param current    its pose now
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_POSE or RF_ERROR_DEFORMS.
///         Where it is refused, the unit is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_poses(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    previous: *const rf_pose,
    current: *const rf_pose,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let previous = isometry(&locked.one(previous)?);
            let current = isometry(&locked.one(current)?);
            Ok(locked.simulator().set_poses(UnitId::from_bits(id), &previous, &current)?)
        })
    }
}

/// Changes how a unit moves from now on: without contact it flies as a thrown body does. A driven unit
/// forgets where it was sent.
///
/// @param simulator  the simulator
/// @param id         which unit
/// @param velocity   its velocity now; at most half a turn a step
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_VELOCITY, RF_ERROR_DEFORMS or
///         RF_ERROR_BAD_POSE, where it would come from beyond 1e6 m. Where it is refused, the unit is
///         what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_velocity(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    velocity: *const rf_velocity,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let velocity = locked.one(velocity)?.into();
            Ok(locked.simulator().set_velocity(UnitId::from_bits(id), &velocity)?)
        })
    }
}

/// Changes how all units move from now on, in the order of rf_poses: as rf_set_velocity.
///
/// @param simulator   the simulator
/// @param velocities  (count) velocities, unit by unit
/// @param count       how many: as many as there are units
/// @return as rf_set_velocity; where it is refused, all units are what they were
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_velocities(
    simulator: *mut rf_simulator,
    velocities: *const rf_velocity,
    count: usize,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let velocities = locked.input(velocities, count)?.iter();
            let velocities = velocities.map(|velocity| Velocity::from(*velocity));
            Ok(locked.simulator().set_velocities(velocities)?)
        })
    }
}

/// Changes what a unit is made of.
///
/// @param simulator  the simulator
/// @param id         which unit
/// @param physics    what it is made of from now on
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID or RF_ERROR_BAD_PHYSICS. Where it is
///         refused, the unit is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_physics(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    physics: *const rf_physics,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let physics = locked.one(physics)?.into();
            Ok(locked.simulator().set_physics(UnitId::from_bits(id), physics)?)
        })
    }
}

/// Changes how contact with a unit gives way; without this call it is rigid. rf_observe makes it rigid again.
///
/// @param simulator   the simulator
/// @param id          which unit
/// @param compliance  how contact with it gives way from now on
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_COMPLIANCE or
///         RF_ERROR_NO_COMPLIANCE. Where it is refused, the unit is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_compliance(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    compliance: *const rf_compliance,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let compliance = locked.one(compliance)?;
            set_compliance(locked.simulator(), id, compliance)
        })
    }
}

/// Changes how contact with a plane gives way; it lasts until rf_set_planes, which makes all rigid.
///
/// @param simulator   the simulator
/// @param plane       which plane, from 0, in the order of rf_set_planes
/// @param compliance  how contact with it gives way from now on
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_PLANE, RF_ERROR_BAD_COMPLIANCE or
///         RF_ERROR_NO_COMPLIANCE. Where it is refused, the plane is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_plane_compliance(
    simulator: *mut rf_simulator,
    plane: u32,
    compliance: *const rf_compliance,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let compliance = locked.one(compliance)?;
            set_plane_compliance(locked.simulator(), plane, compliance)
        })
    }
}

#[cfg(feature = "compliance")]
fn set_compliance(
    simulator: &mut Simulator<'_, '_>,
    id: rf_unit_id,
    compliance: rf_compliance,
) -> Result<(), rf_detail> {
    Ok(simulator.set_compliance(UnitId::from_bits(id), compliance.into())?)
}

#[cfg(not(feature = "compliance"))]
fn set_compliance(
    _: &mut Simulator<'_, '_>,
    _: rf_unit_id,
    _: rf_compliance,
) -> Result<(), rf_detail> {
    Err(RF_ERROR_NO_COMPLIANCE.into())
}

#[cfg(feature = "compliance")]
fn set_plane_compliance(
    simulator: &mut Simulator<'_, '_>,
    plane: u32,
    compliance: rf_compliance,
) -> Result<(), rf_detail> {
    Ok(simulator.set_plane_compliance(plane as usize, compliance.into())?)
}

#[cfg(not(feature = "compliance"))]
fn set_plane_compliance(
    _: &mut Simulator<'_, '_>,
    _: u32,
    _: rf_compliance,
) -> Result<(), rf_detail> {
    Err(RF_ERROR_NO_COMPLIANCE.into())
}

/// Changes who moves a unit. A unit that becomes free goes on with the motion of its last step. A
/// unit that becomes driven stays where it is until rf_drive sends it somewhere.
///
/// @param simulator  the simulator
/// @param id         which unit
/// @param role       RF_ROLE_FREE, RF_ROLE_DRIVEN or RF_ROLE_FIXED
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_ROLE, RF_ERROR_BONDED or
///         RF_ERROR_DEFORMS. Where it is refused, the unit is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_role(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    role: u32,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let role = convert::role(role)?;
            Ok(locked.simulator().set_role(UnitId::from_bits(id), role)?)
        })
    }
}

/// Changes the planes that the scene stands on or between. Without this call that is the ground,
/// z = 0 with the friction and restitution of the model. They last beyond observations.
///
/// @param simulator  the simulator
/// @param planes     (count) planes
/// @param count      how many, at most RF_MAX_PLANES; 0 for none
/// @return RF_OK, an error of the call, RF_ERROR_TOO_MANY_PLANES or RF_ERROR_BAD_PLANE. Where it is
///         refused, the planes are what they were
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_planes(
    simulator: *mut rf_simulator,
    planes: *const rf_plane,
    count: usize,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let given = locked.input(planes, count)?;
            // The planes of C have another layout, and there is no allocator.
            let mut planes = [Plane::ground(0.0, 0.0); MAX_PLANES];
            let planes = planes.get_mut(..count).ok_or_else(|| {
                let (found, limit) = (count as u64, RF_MAX_PLANES as u64);
                rf_detail::numbers(RF_ERROR_TOO_MANY_PLANES, found, limit)
            })?;
            for (plane, given) in planes.iter_mut().zip(given) {
                *plane = (*given).into();
            }
            Ok(locked.simulator().set_planes(planes)?)
        })
    }
}

/// Puts the scene on ground of varying height, besides its planes. It lasts beyond observations, and rf_save does not
/// hold it. Impulses alone move units there: no network has seen such ground. Contact with it is rigid on its side.
///
/// @param simulator  the simulator
/// @param field      the ground, whose heights the simulator goes on reading; NULL takes it away
/// @return RF_OK, an error of the call, RF_ERROR_BAD_HEIGHT_FIELD or RF_ERROR_NO_HEIGHT_FIELD. Where it is
///         refused, the ground is what it was
///
/// # Safety
/// As rf_observe; and the heights stay where and as they are as long as the simulator has the field.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_height_field(
    simulator: *mut rf_simulator,
    field: *const rf_height_field,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            if field.is_null() {
                return set_height_field(locked.simulator(), None, &[]);
            }
            let field = locked.one(field)?;
            let count = (field.rows as usize).saturating_mul(field.columns as usize);
            let heights = locked.input(field.heights_m, count)?;
            set_height_field(locked.simulator(), Some(field), heights)
        })
    }
}

#[cfg(feature = "terrain")]
fn set_height_field(
    simulator: &mut Simulator<'static, 'static>,
    field: Option<rf_height_field>,
    heights_m: &'static [f32],
) -> Result<(), rf_detail> {
    let field = field.map(|field| HeightField {
        heights_m,
        columns: field.columns as usize,
        spacing_m: field.spacing_m,
        corner_m: field.corner_m.into(),
        friction: field.friction,
        restitution: field.restitution,
    });
    Ok(simulator.set_height_field(field)?)
}

#[cfg(not(feature = "terrain"))]
fn set_height_field(
    _: &mut Simulator<'_, '_>,
    _: Option<rf_height_field>,
    _: &[f32],
) -> Result<(), rf_detail> {
    Err(RF_ERROR_NO_HEIGHT_FIELD.into())
}

/// Lets the network correct motion, as it does at first, or leaves it out. Without it units move as the model moves them
/// before its network corrects that. It lasts beyond observations.
///
/// @param simulator  the simulator
/// @param corrects   1 or 0
/// @return RF_OK or an error of the call
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_network(simulator: *mut rf_simulator, corrects: u32) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            locked.simulator().set_network(corrects != 0);
            Ok(())
        })
    }
}

/// Says how contacts that bounce differ from rigid ones: the law of whatever recorded the scene. Without this call they are
/// rigid. It holds with the network and without it, and lasts beyond observations. It is for models that move units by impulses;
/// with others it has no effect.
///
/// @param simulator           the simulator
/// @param restitution_offset  is added to the restitution of each pair, up to 1: from 0 to 1
/// @param pyramid             1: friction is limited along the sliding and across it apart, as Bullet does; 0: together
/// @return RF_OK, an error of the call or RF_ERROR_BAD_CONTACT_LAW. Where it is refused, the law is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_contact_law(
    simulator: *mut rf_simulator,
    restitution_offset: f32,
    pyramid: u32,
) -> rf_status {
    let friction = if pyramid == 0 { FrictionLimit::Cone } else { FrictionLimit::Pyramid };
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            Ok(locked.simulator().set_contact_law(ContactLaw { restitution_offset, friction })?)
        })
    }
}

/// How contacts that bounce differ from rigid ones, as rf_set_contact_law said.
///
/// @param simulator           the simulator
/// @param restitution_offset  out: what is added to the restitution of each pair
/// @param pyramid             out: 1 or 0
/// @return RF_OK or an error of the call
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_contact_law(
    simulator: *const rf_simulator,
    restitution_offset: *mut f32,
    pyramid: *mut u32,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let offset = locked.output(restitution_offset, 1)?;
            let shape = locked.output(pyramid, 1)?;
            let law = locked.simulator().contact_law();
            offset.write(law.restitution_offset);
            shape.write(u32::from(law.friction == FrictionLimit::Pyramid));
            Ok(())
        })
    }
}

/// Changes gravity; without this call it is the model's. It lasts beyond observations.
///
/// @param simulator     the simulator
/// @param gravity_m_s2  (3) x, y, z in m/s^2, each at most 1e4
/// @return RF_OK, an error of the call, RF_ERROR_BAD_GRAVITY or, in a scene with units,
///         RF_ERROR_BAD_TIMESTEP: models such as nano and edge measure time by gravity, so that a
///         time step can be too long for a stronger one. Where it is refused, gravity is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_gravity(
    simulator: *mut rf_simulator,
    gravity_m_s2: *const f32,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let gravity = Vector3::from(locked.one(gravity_m_s2.cast::<[f32; 3]>())?);
            Ok(locked.simulator().set_gravity(gravity)?)
        })
    }
}

/// Changes the time that a step takes. Units keep their velocities and spins. Before an observation,
/// this gives the scene a time step, so that rf_add can build it unit by unit.
///
/// @param simulator  the simulator
/// @param dt_s       seconds, as for rf_observe. In a scene without units rf_add finds out whether
///                   nano, edge and models like them take it
/// @return RF_OK, an error of the call or RF_ERROR_BAD_TIMESTEP. Where it is refused, the time step
///         is what it was
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_set_dt(simulator: *mut rf_simulator, dt_s: f32) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe { with_simulator(simulator, |locked| Ok(locked.simulator().set_dt(dt_s)?)) }
}

/// Hangs a unit from another by a pivot, a place that is fixed in the frames of both: after each step
/// the two images of it are one. Joints make trees; a unit that hangs already hangs from the new
/// parent then. They end with rf_unjoin, with the removal of one of the two and with another
/// observation. Libraries for microcontrollers have no joints unless they are built with the feature
/// `robot`.
///
/// @param simulator     the simulator
/// @param id            the unit that hangs
/// @param parent        the unit that it hangs from
/// @param pivot         (3) x, y, z in the frame of the unit's reference points, metres
/// @param parent_pivot  (3) the same place in the frame of the parent's reference points
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BAD_JOINT, RF_ERROR_BONDED,
///         RF_ERROR_DEFORMS or RF_ERROR_NO_JOINTS. Where it is refused, the joints are what they were
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_join(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    parent: rf_unit_id,
    pivot: *const f32,
    parent_pivot: *const f32,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            let pivot = locked.one(pivot.cast::<[f32; 3]>())?;
            let parent_pivot = locked.one(parent_pivot.cast::<[f32; 3]>())?;
            join(locked.simulator(), [id, parent], [pivot, parent_pivot])
        })
    }
}

/// Lets a unit go from the one that it hangs from.
///
/// @param simulator  the simulator
/// @param id         the unit; it need not hang
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID or RF_ERROR_NO_JOINTS
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_unjoin(simulator: *mut rf_simulator, id: rf_unit_id) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe { with_simulator(simulator, |locked| unjoin(locked.simulator(), id)) }
}

/// Makes pairs of units hold together rigidly from the next step on, where they are then: free units of
/// one body (`bodies`, `body`). Units that bonds connect, directly or through others, move as one rigid
/// body. A bond holds until rf_break_bond, until one of the two is removed or until another observation.
/// Models of format version 7, such as fragments.rfm, break bonds in rf_step too; rf_bonds says which hold.
/// There is room for 8 bonds for each unit of rf_config. Libraries for microcontrollers have no bonds
/// unless they are built with the feature `deform`.
///
/// @param simulator  the simulator
/// @param pairs      (pair_count, 2) ids
/// @param pair_count how many pairs; each is bonded once
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BOND_MOTION, RF_ERROR_NO_BONDS
///         or one of RF_ERROR_BOND_ITSELF to RF_ERROR_TOO_MANY_BONDS. Where one pair is refused, all
///         are, and the bonds are what they were
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_bond(
    simulator: *mut rf_simulator,
    pairs: *const rf_unit_id,
    pair_count: usize,
) -> rf_status {
    // SAFETY: the caller's promise; a name is a 64-bit number in memory, any of which may be one.
    unsafe {
        with_simulator(simulator, |locked| {
            let pairs = locked.input(pairs.cast::<[UnitId; 2]>(), pair_count)?;
            bond(locked.simulator(), pairs)
        })
    }
}

/// Breaks the bond of a pair for good. Of a cluster that parts by that, what holds together with its
/// first unit keeps the body; the rest is a body of its own from then on, which touches the others.
///
/// @param simulator  the simulator
/// @param id         one unit of the pair
/// @param other      the other one
/// @param held       out: 1 where the bond held until then, else 0; may be NULL
/// @return RF_OK, an error of the call, RF_ERROR_NO_SUCH_ID, RF_ERROR_BOND_ITSELF,
///         RF_ERROR_NO_SUCH_BOND or RF_ERROR_NO_BONDS. Where it is refused, the bonds are what they
///         were
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_break_bond(
    simulator: *mut rf_simulator,
    id: rf_unit_id,
    other: rf_unit_id,
    held: *mut u32,
) -> rf_status {
    // SAFETY: the caller's promise.
    unsafe {
        with_simulator(simulator, |locked| {
            // Outputs are checked first: a call that is refused must change nothing.
            let out = locked.optional(held)?;
            let held = break_bond(locked.simulator(), [id, other].map(UnitId::from_bits))?;
            if let Some(out) = out {
                out.write(held.into());
            }
            Ok(())
        })
    }
}

/// All bonds in the order in which they were made, broken ones among them.
///
/// @param simulator  the simulator
/// @param bonds      out: (count) bonds; may be NULL where capacity is 0
/// @param capacity   how many there is room for
/// @param count      out: how many bonds there are, also where RF_ERROR_BUFFER says that they do not fit
/// @return RF_OK, an error of the call, RF_ERROR_NO_BONDS or RF_ERROR_BUFFER
///
/// # Safety
/// As rf_observe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rf_bonds(
    simulator: *const rf_simulator,
    bonds: *mut rf_bonded,
    capacity: usize,
    count: *mut usize,
) -> rf_status {
    // SAFETY: the caller's promise; `at` is below the count of bonds, which is at most the capacity.
    unsafe {
        with_simulator(simulator, |locked| {
            let found = locked.output(count, 1)?;
            let out = locked.output(bonds, capacity)?;
            let simulator = locked.simulator();
            let number = each_bond(simulator)?.count();
            // Written before the check, so that a caller learns how long its array must be.
            found.write(number);
            fits(capacity, number)?;
            for (at, bond) in each_bond(simulator)?.take(capacity).enumerate() {
                out.add(at).write(bond);
            }
            Ok(())
        })
    }
}

// The functions are in every library, so that one header serves all and a program that asks for joints or bonds learns by a
// status that there are none. Without the feature nothing else of them is compiled.

#[cfg(feature = "deform")]
fn bond(simulator: &mut Simulator<'_, '_>, pairs: &[[UnitId; 2]]) -> Result<(), rf_detail> {
    Ok(simulator.bond(pairs)?)
}

#[cfg(feature = "deform")]
fn break_bond(simulator: &mut Simulator<'_, '_>, pair: [UnitId; 2]) -> Result<bool, rf_detail> {
    Ok(simulator.break_bond(pair)?)
}

#[cfg(feature = "deform")]
fn each_bond(simulator: &Simulator<'_, '_>) -> Result<impl Iterator<Item = rf_bonded>, rf_detail> {
    Ok(simulator.bonds().map(|bond| rf_bonded {
        units: bond.units.map(UnitId::to_bits),
        holds: bond.holds.into(),
        reserved: 0,
    }))
}

#[cfg(not(feature = "deform"))]
fn bond(_: &mut Simulator<'_, '_>, _: &[[UnitId; 2]]) -> Result<(), rf_detail> {
    Err(rf_detail::of(RF_ERROR_NO_BONDS))
}

#[cfg(not(feature = "deform"))]
fn break_bond(_: &mut Simulator<'_, '_>, _: [UnitId; 2]) -> Result<bool, rf_detail> {
    Err(rf_detail::of(RF_ERROR_NO_BONDS))
}

#[cfg(not(feature = "deform"))]
fn each_bond(_: &Simulator<'_, '_>) -> Result<core::iter::Empty<rf_bonded>, rf_detail> {
    Err(rf_detail::of(RF_ERROR_NO_BONDS))
}

#[cfg(feature = "robot")]
fn join(
    simulator: &mut Simulator<'_, '_>,
    units: [rf_unit_id; 2],
    pivots: [[f32; 3]; 2],
) -> Result<(), rf_detail> {
    let [unit, parent] = units.map(UnitId::from_bits);
    let [pivot, parent_pivot] = pivots.map(Point3::from);
    Ok(simulator.join(&Joint::ball(unit, parent, pivot, parent_pivot))?)
}

#[cfg(feature = "robot")]
fn unjoin(simulator: &mut Simulator<'_, '_>, id: rf_unit_id) -> Result<(), rf_detail> {
    simulator.unjoin(UnitId::from_bits(id))?;
    Ok(())
}

#[cfg(not(feature = "robot"))]
fn join(_: &mut Simulator<'_, '_>, _: [rf_unit_id; 2], _: [[f32; 3]; 2]) -> Result<(), rf_detail> {
    Err(rf_detail::of(RF_ERROR_NO_JOINTS))
}

#[cfg(not(feature = "robot"))]
fn unjoin(_: &mut Simulator<'_, '_>, _: rf_unit_id) -> Result<(), rf_detail> {
    Err(rf_detail::of(RF_ERROR_NO_JOINTS))
}
