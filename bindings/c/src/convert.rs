//! What C hands in as the core takes it, and back.

#[cfg(feature = "compliance")]
use crate::types::rf_compliance;
use crate::types::rf_status::{
    RF_ERROR_BAD_BODY, RF_ERROR_BAD_ROLE, RF_ERROR_NOT_SOFT, RF_ERROR_POINT_COUNTS,
};
use crate::types::{
    RF_MAX_BODY, RF_MAX_PIECES, RF_MAX_PLANES, RF_OWN_BODY, RF_ROLE_DRIVEN, RF_ROLE_FIXED,
    RF_ROLE_FREE, rf_centre, rf_detail, rf_internal_pose, rf_physics, rf_plane, rf_pose,
    rf_velocity,
};
use core::iter::repeat;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::geometry::Pose;
use rigidformer_core::{
    MAX_PIECES, MAX_PLANES, Observed, Physics, Pieces, Plane, Posed, Role, Unit, Velocity,
};

// The header repeats limits of the core, and the two must not drift apart.
const _: () = assert!(RF_MAX_PLANES == MAX_PLANES);
const _: () = assert!(RF_MAX_PIECES == MAX_PIECES);
const _: () = assert!(RF_MAX_BODY < u16::MAX as i32);
// C hands in points as three floats, and a cast makes points of them.
const _: () = assert!(size_of::<Point3<f32>>() == 12 && align_of::<Point3<f32>>() == 4);

/// The units of an observation, whose roles, bodies and counts are sound: unit i has the next `counts[i]` points of
/// each frame.
#[derive(Clone, Copy)]
pub(crate) struct Units<'a> {
    physics: &'a [rf_physics],
    counts: &'a [u32],
    points: usize,
    /// Empty: all are free.
    roles: &'a [u32],
    /// Empty: each is a body of its own.
    bodies: &'a [i32],
    /// Empty: those of boxes.
    inertias: &'a [[f32; 3]],
    pieces: UnitPieces<'a>,
    soft: UnitRest<'a>,
}

impl<'a> Units<'a> {
    /// `points` is how many points each frame has.
    #[expect(clippy::too_many_arguments, reason = "the arrays of rf_units, in its order")]
    pub(crate) fn new(
        physics: &'a [rf_physics],
        counts: &'a [u32],
        points: usize,
        roles: &'a [u32],
        bodies: &'a [i32],
        inertias: &'a [[f32; 3]],
        pieces: UnitPieces<'a>,
        soft: UnitRest<'a>,
    ) -> Result<Self, rf_detail> {
        // Counts are checked once, so that slicing below needs no error.
        add_up(counts, points)?;
        // The unit's number goes into the detail, which a conversion alone does not know.
        for (unit, found) in roles.iter().enumerate() {
            role(*found).map_err(|error| error.at(unit))?;
        }
        for (unit, found) in bodies.iter().enumerate() {
            body(*found).map_err(|error| error.at(unit))?;
        }
        Ok(Units { physics, counts, points, roles, bodies, inertias, pieces, soft })
    }

    /// How many units.
    pub(crate) fn len(&self) -> usize {
        self.physics.len()
    }

    /// How many points each array of points has.
    pub(crate) fn points(&self) -> usize {
        self.points
    }

    /// Units with two frames of points.
    pub(crate) fn observed(
        self,
        previous: &'a [Point3<f32>],
        current: &'a [Point3<f32>],
    ) -> impl Iterator<Item = Observed<'a>> + Clone {
        let current = split(self.counts, current);
        self.with(previous).zip(current).map(|(unit, current)| Observed { unit, current })
    }

    /// Units with two poses each.
    pub(crate) fn posed(
        self,
        points: &'a [Point3<f32>],
        previous: &'a [rf_pose],
        current: &'a [rf_pose],
    ) -> impl Iterator<Item = Posed<'a>> + Clone {
        let poses = previous.iter().zip(current);
        self.with(points).zip(poses).map(|(unit, (previous, current))| Posed {
            unit,
            previous: isometry(previous),
            current: isometry(current),
        })
    }

    fn with(self, points: &'a [Point3<f32>]) -> impl Iterator<Item = Unit<'a>> + Clone {
        let points = split(self.counts, points);
        // Arrays that C leaves out are empty, and the defaults follow them without end.
        let roles = self.roles.iter().copied().chain(repeat(RF_ROLE_FREE));
        let bodies = self.bodies.iter().copied().chain(repeat(RF_OWN_BODY));
        let inertias = self.inertias.iter().copied().chain(repeat([0.0; 3]));
        let made = self.physics.iter().zip(points).zip(roles.zip(bodies));
        let shapes = inertias.zip(self.pieces.each()).zip(self.soft.each(self.counts));
        let units = made.zip(shapes);
        units.map(|(((physics, points), (of_role, of_body)), ((of_inertia, pieces), soft))| {
            let unit = Unit {
                // `new` refuses unknown roles and bodies, so the defaults stand for nothing.
                role: role(of_role).unwrap_or_default(),
                body: body(of_body).unwrap_or_default(),
                inertia_kg_m2: inertia(of_inertia),
                pieces,
                ..Unit::new(points, (*physics).into())
            };
            soften(unit, soft)
        })
    }
}

/// What the units of an observation are like at rest.
#[derive(Clone, Copy)]
pub(crate) struct UnitRest<'a> {
    /// Young's modulus of each, Pa, 0 of rigid ones. Empty: all are rigid.
    young_pa: &'a [f32],
    /// As many points as are observed.
    points: &'a [Point3<f32>],
}

impl<'a> UnitRest<'a> {
    pub(crate) fn new(young_pa: &'a [f32], points: &'a [Point3<f32>]) -> Result<Self, rf_detail> {
        // 0 is a rigid unit; NaN is not, so that the core refuses it.
        let is_soft = |young_pa: &f32| *young_pa != 0.0;
        match young_pa.iter().position(is_soft) {
            Some(unit) if cfg!(not(feature = "deform")) => {
                Err(rf_detail::of(RF_ERROR_NOT_SOFT).at(unit))
            }
            _ => Ok(UnitRest { young_pa, points }),
        }
    }

    /// Of each unit that is soft; behind the last, none.
    fn each(self, counts: &'a [u32]) -> impl Iterator<Item = Option<AtRest<'a>>> + Clone {
        let given = self.young_pa.iter().zip(split(counts, self.points));
        let soft = given.map(|(young_pa, rest)| (*young_pa != 0.0).then_some((*young_pa, rest)));
        soft.chain(repeat(None))
    }
}

/// Young's modulus, Pa, and points at rest.
type AtRest<'a> = (f32, &'a [Point3<f32>]);

#[cfg(feature = "deform")]
fn soften<'a>(unit: Unit<'a>, soft: Option<AtRest<'a>>) -> Unit<'a> {
    soft.map_or(unit, |(young_pa, rest)| unit.soft(rest, young_pa))
}

/// `UnitRest::new` has refused soft units.
#[cfg(not(feature = "deform"))]
fn soften<'a>(unit: Unit<'a>, _: Option<AtRest<'a>>) -> Unit<'a> {
    unit
}

/// Convex pieces of the units of an observation, whose counts are sound.
#[derive(Clone, Copy)]
pub(crate) struct UnitPieces<'a> {
    /// How many each unit has. Empty: none has any.
    units: &'a [u16],
    /// How many points each piece has.
    counts: &'a [u16],
    points: &'a [Point3<f32>],
}

impl<'a> UnitPieces<'a> {
    pub(crate) fn new(
        units: &'a [u16],
        counts: &'a [u16],
        points: &'a [Point3<f32>],
    ) -> Result<Self, rf_detail> {
        add_up(units, counts.len())?;
        add_up(counts, points.len())?;
        Ok(UnitPieces { units, counts, points })
    }

    /// Those of each unit; behind the last, none.
    fn each(self) -> impl Iterator<Item = Pieces<'a>> + Clone {
        let given = self.units.iter().scan((self.counts, self.points), |rest, pieces| {
            let (counts, points) = *rest;
            let number = usize::from(*pieces);
            // `new` has checked both sums, and a panic must be impossible all the same.
            let (counts, others) = counts.split_at_checked(number).unwrap_or((counts, &[]));
            let sum = counts.iter().fold(0_usize, |sum, count| sum.saturating_add((*count).into()));
            let (points, after) = points.split_at_checked(sum).unwrap_or((points, &[]));
            *rest = (others, after);
            Some(Pieces::new(points, counts))
        });
        given.chain(repeat(Pieces::NONE))
    }
}

/// Whether counts add up to what is there.
fn add_up<T: Copy + Into<u64>>(counts: &[T], there: usize) -> Result<(), rf_detail> {
    let sum = counts.iter().fold(0_u64, |sum, count| sum.saturating_add((*count).into()));
    match sum == there as u64 {
        true => Ok(()),
        false => Err(rf_detail::numbers(RF_ERROR_POINT_COUNTS, sum, there as u64)),
    }
}

/// The points of each unit; `counts` add up to their number.
fn split<'a>(
    counts: &'a [u32],
    points: &'a [Point3<f32>],
) -> impl Iterator<Item = &'a [Point3<f32>]> + Clone {
    counts.iter().scan(points, |rest, count| {
        // `new` has checked the sum, and a panic must be impossible all the same.
        let (unit, after) = rest.split_at_checked(*count as usize).unwrap_or((rest, &[]));
        *rest = after;
        Some(unit)
    })
}

/// Moments of inertia; zeros are none.
pub(crate) fn inertia(moments: [f32; 3]) -> Option<[f32; 3]> {
    // C has no `None`, and no body has moments of 0.
    (moments != [0.0; 3]).then_some(moments)
}

/// A role by its number.
pub(crate) fn role(number: u32) -> Result<Role, rf_detail> {
    match number {
        RF_ROLE_FREE => Ok(Role::Free),
        RF_ROLE_DRIVEN => Ok(Role::Driven),
        RF_ROLE_FIXED => Ok(Role::Fixed),
        _ => Err(rf_detail::numbers(RF_ERROR_BAD_ROLE, number.into(), RF_ROLE_FIXED.into())),
    }
}

/// A body by its number; `None` is one of its own.
pub(crate) fn body(number: i32) -> Result<Option<u16>, rf_detail> {
    match u16::try_from(number) {
        // 65535 fits 16 bits and is above the limit.
        Ok(body) if number <= RF_MAX_BODY => Ok(Some(body)),
        _ if number == RF_OWN_BODY => Ok(None),
        _ => {
            // The detail has no sign: the header says how negative numbers read there.
            let found = i64::from(number) as u64;
            Err(rf_detail::numbers(RF_ERROR_BAD_BODY, found, RF_MAX_BODY as u64))
        }
    }
}

#[cfg(feature = "compliance")]
impl From<rf_compliance> for rigidformer_core::Compliance {
    fn from(compliance: rf_compliance) -> Self {
        let rf_compliance { stiffness_n_m, dissipation_s_m } = compliance;
        Self { stiffness_n_m, dissipation_s_m }
    }
}

impl From<rf_physics> for Physics {
    fn from(physics: rf_physics) -> Self {
        let rf_physics { mass_kg, friction, restitution } = physics;
        Physics { mass_kg, friction, restitution }
    }
}

impl From<rf_plane> for Plane {
    fn from(plane: rf_plane) -> Self {
        let rf_plane { normal, offset_m, friction, restitution } = plane;
        Plane { normal: Vector3::from(normal), offset_m, friction, restitution }
    }
}

#[cfg(feature = "tracker")]
impl From<Plane> for rf_plane {
    fn from(plane: Plane) -> Self {
        let Plane { normal, offset_m, friction, restitution } = plane;
        rf_plane { normal: normal.into(), offset_m, friction, restitution }
    }
}

/// A pose as the core takes it, which checks the quaternion's length.
pub(crate) fn isometry(pose: &rf_pose) -> Isometry3<f32> {
    let ([x, y, z], [i, j, k, w]) = (pose.position, pose.quaternion);
    // Normalising would hide a wrong quaternion from the core's check.
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k));
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}

impl From<Isometry3<f32>> for rf_pose {
    fn from(pose: Isometry3<f32>) -> Self {
        let (p, q) = (pose.translation.vector, pose.rotation.as_ref().coords);
        rf_pose { position: [p.x, p.y, p.z], quaternion: [q.x, q.y, q.z, q.w] }
    }
}

impl From<Velocity> for rf_velocity {
    fn from(velocity: Velocity) -> Self {
        let Velocity { linear_m_s, angular_rad_s } = velocity;
        rf_velocity { linear_m_s: linear_m_s.into(), angular_rad_s: angular_rad_s.into() }
    }
}

impl From<rf_velocity> for Velocity {
    fn from(velocity: rf_velocity) -> Self {
        let rf_velocity { linear_m_s, angular_rad_s } = velocity;
        Velocity { linear_m_s: linear_m_s.into(), angular_rad_s: angular_rad_s.into() }
    }
}

impl From<Point3<f64>> for rf_centre {
    fn from(centre: Point3<f64>) -> Self {
        rf_centre { x: centre.x, y: centre.y, z: centre.z }
    }
}

impl From<Pose> for rf_internal_pose {
    fn from(pose: Pose) -> Self {
        let (r, c) = (pose.rotation, pose.centre);
        rf_internal_pose {
            rotation: [r.m11, r.m12, r.m13, r.m21, r.m22, r.m23, r.m31, r.m32, r.m33],
            centre: [c.x, c.y, c.z],
        }
    }
}
