//! The parts of a scene file, from numbers to what they mean.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use rigidformer_core::Physics;

use super::check::{Tensors, elements};
use super::dataset::POSE_NUMBERS;
use super::{Problem, SceneError};

/// Allowed difference of a quaternion's squared length from 1: f32 rounding of a unit quaternion is below 1e-6.
const QUATERNION_TOLERANCE: f32 = 1e-4;

pub(super) struct Shape {
    pub(super) name: String,
    /// (points) at scale 1, metres
    pub(super) points: Vec<Point3<f32>>,
}

pub(super) struct Unit {
    pub(super) shape: usize,
    pub(super) scale: f32,
    pub(super) physics: Physics,
}

pub(super) fn read_shapes(file: &Tensors<'_>) -> Result<Vec<Shape>, SceneError> {
    let found = file.entry("shape_names")?;
    let names: Vec<String> = serde_json::from_str(found).map_err(|_| {
        let expected = "a JSON list of texts";
        file.fail("metadata shape_names", Problem::Unparsable { found: found.into(), expected })
    })?;
    let ([points, _], coordinates) = file.f32("shape_points", [None, Some(3)])?;
    let offsets = file.offsets("shape_offsets", names.len(), points)?;
    let (rows, _) = coordinates.as_chunks::<3>();
    let shapes = names.into_iter().zip(offsets.iter().zip(offsets.iter().skip(1)));
    Ok(shapes
        .map(|(name, (start, end))| {
            let points = rows
                .get(*start..*end)
                .unwrap_or_default()
                .iter()
                .map(|p| Point3::from(*p))
                .collect();
            Shape { name, points }
        })
        .collect())
}

pub(super) fn read_units(file: &Tensors<'_>, shapes: usize) -> Result<Vec<Unit>, SceneError> {
    let ([count], shape) = file.i32("unit_shape", [None])?;
    let (_, scale) = file.f32("unit_scale", [Some(count)])?;
    let (_, physics) = file.f32("unit_physics", [Some(count), Some(3)])?;
    let (physics, _) = physics.as_chunks::<3>();
    let mut units = Vec::with_capacity(count);
    for (row, ((shape, scale), physics)) in shape.into_iter().zip(scale).zip(physics).enumerate() {
        let [mass_kg, friction, restitution] = *physics;
        let Some(shape) = usize::try_from(shape).ok().filter(|shape| *shape < shapes) else {
            return Err(file.bad_value(
                "unit_shape",
                row,
                shape,
                "one of the shapes of shape_names",
            ));
        };
        if scale <= 0.0 {
            return Err(file.bad_value("unit_scale", row, scale, "above 0"));
        }
        if mass_kg <= 0.0 || friction < 0.0 || restitution < 0.0 {
            let value = format!("{physics:?}");
            let expected = "a mass above 0 with a friction and restitution of at least 0";
            return Err(file.bad_value("unit_physics", row, value, expected));
        }
        units.push(Unit { shape, scale, physics: Physics { mass_kg, friction, restitution } });
    }
    Ok(units)
}

pub(super) fn read_pose(bytes: &[u8]) -> Result<Isometry3<f32>, &'static str> {
    let mut numbers = [0.0; POSE_NUMBERS];
    for (number, bytes) in numbers.iter_mut().zip(elements(bytes)) {
        *number = f32::from_le_bytes(bytes);
    }
    if !numbers.iter().all(|number| number.is_finite()) {
        return Err("a number that is not finite");
    }
    let [x, y, z, qw, qx, qy, qz] = numbers;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    if (quaternion.norm_squared() - 1.0).abs() > QUATERNION_TOLERANCE {
        return Err("a quaternion whose length is not 1");
    }
    // Kept as recorded: normalising would change the last bits.
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_unchecked(quaternion)))
}
