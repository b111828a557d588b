//! The parts of a scene file, from numbers to what they mean.

use std::ops::Range;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rigidformer_core::{Compliance, HeightField, MAX_PIECES, MAX_PLANES, Physics, Plane, Role};
use rigidformer_runtime::terrain::HeightFieldBuf;

use super::check::{Tensors, elements};
use super::recorded::{MAX_BODY, ROLES, Velocity, is_inertia, row_problem};
use super::{Problem, SceneError};
use crate::convex_pieces::lie_far;

/// Numbers of a pose in a file: position x, y, z, quaternion w, x, y, z.
pub(super) const POSE_NUMBERS: usize = 7;

/// Allowed difference of a quaternion's squared length from 1: f32 rounding of a unit quaternion is below 1e-6.
// Other programs have room for their rounding, and a wrong quaternion is off by far more.
const QUATERNION_TOLERANCE: f32 = 1e-4;

/// Points of a convex piece.
// Fewer than four points enclose no volume, and a simulator takes at most 255.
const PIECE_POINTS: std::ops::RangeInclusive<usize> = 4..=255;

pub(super) struct Shape {
    pub(super) name: String,
    /// (points) at scale 1, metres
    pub(super) points: Vec<Point3<f32>>,
    /// (pieces, points) of it, at scale 1, metres; none: it is the hull of its points
    pub(super) pieces: Vec<Vec<Point3<f32>>>,
}

pub(super) struct Unit {
    pub(super) shape: usize,
    pub(super) scale: f32,
    pub(super) physics: Physics,
    pub(super) role: Role,
    pub(super) body: Option<u16>,
    pub(super) soft: bool,
    pub(super) young_pa: Option<f32>,
    pub(super) velocity: Option<Velocity>,
    pub(super) inertia: Option<[f32; 3]>,
    pub(super) compliance: Compliance,
}

pub(super) fn read_shapes(file: &Tensors<'_>) -> Result<Vec<Shape>, SceneError> {
    let found = file.entry("shape_names")?;
    // Each name has a quote before and behind it.
    let most = found.bytes().filter(|byte| *byte == b'"').count() / 2;
    file.count::<Shape>("metadata shape_names", most)?;
    let names: Vec<String> = serde_json::from_str(found).map_err(|_| {
        let expected = "a JSON list of texts";
        file.fail("metadata shape_names", Problem::Unparsable { found: found.into(), expected })
    })?;
    let ([points, _], coordinates) = file.f32("shape_points", [None, Some(3)])?;
    let offsets = file.offsets("shape_offsets", names.len(), points)?;
    file.count::<Point3<f32>>("tensor shape_points", points)?;
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
            Shape { name, points, pieces: Vec::new() }
        })
        .collect())
}

/// The convex pieces that shapes of version 2 touch with, where the file says so.
pub(super) fn read_pieces(file: &Tensors<'_>, shapes: &mut [Shape]) -> Result<(), SceneError> {
    // One of the three asks for all of them, so that half a list is an error.
    if !["shape_pieces", "piece_offsets", "piece_points"].iter().any(|name| file.has(name)) {
        return Ok(());
    }
    let ([points, _], coordinates) = file.f32("piece_points", [None, Some(3)])?;
    let (rows, _) = coordinates.as_chunks::<3>();
    let ([ends], _) = file.i64("piece_offsets", [None])?;
    let count = ends.saturating_sub(1);
    let offsets = file.ascending_offsets("piece_offsets", count, points)?;
    file.count::<Point3<f32>>("tensor piece_points", points)?;
    // Once alone, and once of its shape.
    file.count::<[Vec<Point3<f32>>; 2]>("tensor piece_offsets", count)?;
    let mut pieces = Vec::with_capacity(count);
    for (piece, (start, end)) in offsets.iter().zip(offsets.iter().skip(1)).enumerate() {
        let own = rows.get(*start..*end).unwrap_or_default();
        if !PIECE_POINTS.contains(&own.len()) {
            let expected = "the start of a piece of 4 to 255 points";
            return Err(file.bad_value("piece_offsets", piece, start, expected));
        }
        pieces.push(own.iter().map(|point| Point3::from(*point)).collect());
    }
    let offsets = file.ascending_offsets("shape_pieces", shapes.len(), count)?;
    let mut pieces = pieces.into_iter();
    let bounds = offsets.iter().zip(offsets.iter().skip(1));
    for (row, (shape, (start, end))) in shapes.iter_mut().zip(bounds).enumerate() {
        // A simulator would refuse the unit; the file's row is easier to correct.
        if end - start > MAX_PIECES {
            let expected = "the start of at most 32 pieces";
            return Err(file.bad_value("shape_pieces", row, start, expected));
        }
        shape.pieces = pieces.by_ref().take(end - start).collect();
        // Pieces in millimetres would collide with everything.
        if lie_far(&shape.points, shape.pieces.iter().flatten()) {
            let expected = "the start of pieces at most 100 times as far out as the shape's points; give both in metres";
            return Err(file.bad_value("shape_pieces", row, start, expected));
        }
    }
    Ok(())
}

pub(super) fn read_units(file: &Tensors<'_>, shapes: usize) -> Result<Vec<Unit>, SceneError> {
    let ([count], shape) = file.i32("unit_shape", [None])?;
    let (_, scale) = file.f32("unit_scale", [Some(count)])?;
    let (_, physics) = file.f32("unit_physics", [Some(count), Some(3)])?;
    let (physics, _) = physics.as_chunks::<3>();
    // The reader of the file keeps a row of soft points and a place of each unit.
    file.count::<(Unit, [usize; 2])>("tensor unit_shape", count)?;
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
        // A scale of 0 makes a unit without extent, and one below 0 mirrors it.
        if scale <= 0.0 {
            return Err(file.bad_value("unit_scale", row, scale, "above 0"));
        }
        if mass_kg <= 0.0 || friction < 0.0 || restitution < 0.0 {
            let value = format!("{physics:?}");
            let expected = "a mass above 0 with a friction and restitution of at least 0";
            return Err(file.bad_value("unit_physics", row, value, expected));
        }
        let physics = Physics { mass_kg, friction, restitution };
        let (role, body, soft, velocity, inertia) = (Role::Free, None, false, None, None);
        units.push(Unit {
            shape,
            scale,
            physics,
            role,
            body,
            soft,
            young_pa: None,
            velocity,
            inertia,
            compliance: Compliance::RIGID,
        });
    }
    Ok(units)
}

/// What units of version 2 have besides, each where the file says so.
pub(super) fn read_roles(file: &Tensors<'_>, units: &mut [Unit]) -> Result<(), SceneError> {
    let count = units.len();
    if file.has("unit_role") {
        let (_, codes) = file.u8("unit_role", [Some(count)])?;
        for (row, (unit, code)) in units.iter_mut().zip(codes).enumerate() {
            unit.role = *ROLES.get(usize::from(code)).ok_or_else(|| {
                file.bad_value("unit_role", row, code, "0 (free), 1 (driven) or 2 (fixed)")
            })?;
        }
    }
    if file.has("unit_body") {
        let (_, bodies) = file.i32("unit_body", [Some(count)])?;
        for (row, (unit, number)) in units.iter_mut().zip(bodies).enumerate() {
            let body = u16::try_from(number).ok().filter(|body| *body <= MAX_BODY);
            // -1 alone means a body of its own; other numbers out of range are mistakes.
            if body.is_none() && number != -1 {
                let expected = "-1 (a body of its own) or a number from 0 to 65534";
                return Err(file.bad_value("unit_body", row, number, expected));
            }
            unit.body = body;
        }
    }
    if file.has("unit_soft") {
        let (_, codes) = file.u8("unit_soft", [Some(count)])?;
        for (row, (unit, code)) in units.iter_mut().zip(codes).enumerate() {
            if code > 1 {
                return Err(file.bad_value("unit_soft", row, code, "0 (rigid) or 1 (soft)"));
            }
            unit.soft = code == 1;
        }
    }
    if file.has("unit_young") {
        let (_, moduli) = file.f32("unit_young", [Some(count)])?;
        for (row, (unit, young)) in units.iter_mut().zip(moduli).enumerate() {
            // A stiffness of a rigid unit means that `unit_soft` is wrong.
            let is_sound = young.is_finite() && if unit.soft { young > 0.0 } else { young == 0.0 };
            if !is_sound {
                let expected = "a number of pascals above 0 for a soft unit, 0 for a rigid one";
                return Err(file.bad_value("unit_young", row, young, expected));
            }
            unit.young_pa = unit.soft.then_some(young);
        }
    }
    if file.has("unit_velocity") {
        let (_, numbers) = file.f32("unit_velocity", [Some(count), Some(6)])?;
        for (unit, numbers) in units.iter_mut().zip(numbers.as_chunks::<6>().0) {
            let [x, y, z, about_x, about_y, about_z] = *numbers;
            unit.velocity = Some(Velocity {
                linear_m_s: Vector3::new(x, y, z),
                angular_rad_s: Vector3::new(about_x, about_y, about_z),
            });
        }
    }
    if file.has("unit_inertia") {
        let (_, moments) = file.f32("unit_inertia", [Some(count), Some(3)])?;
        let rows = moments.as_chunks::<3>().0.iter().enumerate();
        for (unit, (row, moments)) in units.iter_mut().zip(rows) {
            // Zeros stand for the box, which a simulator works out.
            if *moments != [0.0; 3] {
                if !is_inertia(*moments) {
                    let expected = "three moments of inertia above 0, none greater than the sum of the other two, or \
                                    three zeros (those of the box around the points)";
                    return Err(file.bad_value(
                        "unit_inertia",
                        row,
                        format!("{moments:?}"),
                        expected,
                    ));
                }
                unit.inertia = Some(*moments);
            }
        }
    }
    if file.has("unit_compliance") {
        let all = read_compliance(file, "unit_compliance", count)?;
        units.iter_mut().zip(all).for_each(|(unit, compliance)| unit.compliance = compliance);
    }
    Ok(())
}

/// (rows, 2) How contact with units or planes gives way.
pub(super) fn read_compliance(
    file: &Tensors<'_>,
    name: &'static str,
    rows: usize,
) -> Result<Vec<Compliance>, SceneError> {
    let (_, numbers) = file.f32(name, [Some(rows), Some(2)])?;
    let numbers = numbers.as_chunks::<2>().0.iter().enumerate();
    numbers
        .map(|(row, [stiffness_n_m, dissipation_s_m])| {
            let [stiffness_n_m, dissipation_s_m] = [*stiffness_n_m, *dissipation_s_m];
            let compliance = Compliance { stiffness_n_m, dissipation_s_m };
            let expected = "a stiffness from 1e-3 to 1e12 N/m, or 0 (rigid), and a dissipation from 0 to 1e6 s/m";
            let value = || format!("{:?}", [stiffness_n_m, dissipation_s_m]);
            match compliance.is_sound() {
                true => Ok(compliance),
                false => Err(file.bad_value(name, row, value(), expected)),
            }
        })
        .collect()
}

/// How many of its `frames` frames each scene was recorded for; `None`: all.
pub(super) fn read_scene_frames(
    file: &Tensors<'_>,
    scenes: usize,
    frames: usize,
) -> Result<Option<Vec<usize>>, SceneError> {
    if !file.has("scene_frames") {
        return Ok(None);
    }
    let (_, values) = file.i64("scene_frames", [Some(scenes)])?;
    let mut counts = Vec::with_capacity(values.len());
    for (row, value) in values.into_iter().enumerate() {
        let count = usize::try_from(value).ok().filter(|count| (1..=frames).contains(count));
        counts.push(count.ok_or_else(|| {
            let expected = "a number from 1 to the frames of unit_poses";
            file.bad_value("scene_frames", row, value, expected)
        })?);
    }
    Ok(Some(counts))
}

/// Lists of all scenes: rows of `N` numbers, and (scenes + 1) which of the rows a scene has.
pub(super) struct Listed<const N: usize> {
    rows: Vec<[usize; N]>,
    ends: Vec<usize>,
}

impl<const N: usize> Listed<N> {
    /// Of a file that has no such list.
    pub(super) fn none() -> Self {
        Self { rows: Vec::new(), ends: Vec::new() }
    }

    /// Rows of all scenes.
    pub(super) fn len(&self) -> usize {
        self.rows.len()
    }

    /// Which of all rows a scene has.
    pub(super) fn rows_of(&self, scene: usize) -> Range<usize> {
        let end = |scene: usize| self.ends.get(scene).copied().unwrap_or_default();
        end(scene)..end(scene.saturating_add(1))
    }

    /// A scene's rows, in numbers that count from `start` on.
    pub(super) fn of(&self, scene: usize, start: usize) -> Vec<[usize; N]> {
        let own = self.rows.get(self.rows_of(scene)).unwrap_or_default();
        own.iter().map(|row| row.map(|number| number.saturating_sub(start))).collect()
    }
}

/// The list `name`, whose tensor `scene_...` is `ends`. The numbers of a row are different ones of the range of its scene, which
/// `expected` says in words. Nothing where the file has neither tensor.
pub(super) fn read_list<const N: usize>(
    file: &Tensors<'_>,
    (name, ends): (&str, &str),
    ranges: &[Range<usize>],
    expected: &'static str,
) -> Result<Listed<N>, SceneError> {
    // One of the two asks for the other, so that half a list is an error.
    if !file.has(name) && !file.has(ends) {
        return Ok(Listed::none());
    }
    let ([count, _], numbers) = file.i32(name, [None, Some(N)])?;
    let ends = file.ascending_offsets(ends, ranges.len(), count)?;
    file.count::<[usize; N]>(name, count)?;
    let mut rows = Vec::with_capacity(count);
    let mut found = numbers.as_chunks::<N>().0.iter().enumerate();
    for ((start, end), range) in ends.iter().zip(ends.iter().skip(1)).zip(ranges) {
        for (row, numbers) in found.by_ref().take(end.saturating_sub(*start)) {
            // A negative number becomes one that no range has.
            let own = numbers.map(|number| usize::try_from(number).unwrap_or(usize::MAX));
            if row_problem(&own, range).is_some() {
                return Err(file.bad_value(name, row, format!("{numbers:?}"), expected));
            }
            rows.push(own);
        }
    }
    Ok(Listed { rows, ends })
}

/// Bonds of all scenes: pairs of units, and (bonds) the first frame in which each is broken.
pub(super) fn read_bonds(
    file: &Tensors<'_>,
    ranges: &[Range<usize>],
    frames: usize,
) -> Result<(Listed<2>, Vec<usize>), SceneError> {
    let names = ("bonds", "scene_bonds");
    let bonds: Listed<2> = read_list(file, names, ranges, "two different units of its scene")?;
    if !file.has("bonds") {
        // Frames without bonds are half a list.
        let lonely = file.has("bond_frame");
        let missing = || file.fail("tensor bonds", Problem::Missing);
        return if lonely { Err(missing()) } else { Ok((bonds, Vec::new())) };
    }
    let (_, values) = file.i32("bond_frame", [Some(bonds.len())])?;
    let mut breaks = Vec::with_capacity(values.len());
    for (row, value) in values.into_iter().enumerate() {
        let frame = usize::try_from(value).ok().filter(|frame| *frame <= frames);
        breaks.push(frame.ok_or_else(|| {
            let expected =
                "a frame from 0 to the number of frames, which says that it never breaks";
            file.bad_value("bond_frame", row, value, expected)
        })?);
    }
    Ok((bonds, breaks))
}

/// Planes of all scenes, and which of them a scene has.
pub(super) fn read_planes(
    file: &Tensors<'_>,
    scenes: usize,
) -> Result<(Vec<Plane>, Vec<usize>), SceneError> {
    let ([count, _], numbers) = file.f32("planes", [None, Some(6)])?;
    file.count::<Plane>("tensor planes", count)?;
    let mut planes = Vec::with_capacity(count);
    for (row, numbers) in numbers.as_chunks::<6>().0.iter().enumerate() {
        let [x, y, z, offset_m, friction, restitution] = *numbers;
        let plane = Plane { normal: Vector3::new(x, y, z), offset_m, friction, restitution };
        if !plane.is_sound() {
            // Two texts: a normal is corrected in another place than an offset.
            let unit = Plane { offset_m: 0.0, friction: 0.0, restitution: 0.0, ..plane };
            let expected = if unit.is_sound() {
                "an offset of at most 1e6 m either way, a friction and restitution from 0 to 1000"
            } else {
                "a plane, whose first three numbers are a normal of length 1"
            };
            return Err(file.bad_value("planes", row, format!("{numbers:?}"), expected));
        }
        planes.push(plane);
    }
    let offsets = file.ascending_offsets("scene_planes", scenes, count)?;
    for (scene, (start, end)) in offsets.iter().zip(offsets.iter().skip(1)).enumerate() {
        let planes = end.saturating_sub(*start);
        if planes > MAX_PLANES {
            let problem = Problem::TooManyPlanes { scene, planes };
            return Err(file.fail("tensor scene_planes", problem));
        }
    }
    Ok((planes, offsets))
}

/// Grounds of varying height of a file, and which of them each scene has.
#[derive(Default)]
pub(super) struct FileHeightFields {
    all: Vec<HeightFieldBuf>,
    /// (scenes + 1); empty where no scene has any.
    of_scenes: Vec<usize>,
}

impl FileHeightFields {
    /// Those of files that have them.
    pub(super) fn read(file: &Tensors<'_>, scenes: usize) -> Result<Self, SceneError> {
        let ([count, _], rows) = file.f32("height_fields", [None, Some(FIELD_NUMBERS)])?;
        let (_, heights) = file.f32("heights", [None])?;
        // Once more, field by field.
        file.count::<f32>("tensor heights", heights.len())?;
        file.count::<HeightFieldBuf>("tensor height_fields", count)?;
        let mut rest = heights.as_slice();
        let mut all = Vec::with_capacity(count);
        for (row, numbers) in rows.as_chunks::<FIELD_NUMBERS>().0.iter().enumerate() {
            let [height_rows, columns, dx, dy, x, y, z, friction, restitution] = *numbers;
            let bad = |expected| {
                Err(file.bad_value("height_fields", row, format!("{numbers:?}"), expected))
            };
            let is_whole = |number: f32| number.fract() == 0.0 && (2.0..=4e6).contains(&number);
            if !is_whole(height_rows) || !is_whole(columns) {
                return bad("whole numbers of rows and columns first, of at least 2");
            }
            // Small enough for both, whatever a usize is.
            let count = (height_rows as u64).saturating_mul(columns as u64);
            let own = usize::try_from(count).ok().and_then(|count| rest.split_at_checked(count));
            let Some((own, behind)) = own else {
                return bad("rows and columns that the tensor heights has numbers for");
            };
            rest = behind;
            let field = HeightField {
                heights_m: own,
                columns: columns as usize,
                spacing_m: [dx, dy],
                corner_m: Vector3::new(x, y, z),
                friction,
                restitution,
            };
            let copy = HeightFieldBuf::copy_of(&field).map_err(|cause| {
                let name = format!("tensor height_fields, row {row}");
                file.fail(name, Problem::BadHeightField(cause))
            })?;
            all.push(copy);
        }
        if !rest.is_empty() {
            let (found, expected) = (heights.len(), heights.len() - rest.len());
            return Err(file.fail("tensor heights", Problem::Heights { found, expected }));
        }
        let of_scenes = file.ascending_offsets("scene_height_fields", scenes, count)?;
        for (scene, (start, end)) in of_scenes.iter().zip(of_scenes.iter().skip(1)).enumerate() {
            let fields = end.saturating_sub(*start);
            if fields > 1 {
                let problem = Problem::TooManyHeightFields { scene, fields };
                return Err(file.fail("tensor scene_height_fields", problem));
            }
        }
        Ok(FileHeightFields { all, of_scenes })
    }

    /// That of a scene.
    pub(super) fn of(&self, scene: usize) -> Option<&HeightFieldBuf> {
        let (start, end) = (*self.of_scenes.get(scene)?, *self.of_scenes.get(scene + 1)?);
        self.all.get(start..end)?.first()
    }
}

/// Rows, columns, spacing along x and y, corner, friction and restitution of a height field.
pub(super) const FIELD_NUMBERS: usize = 9;

/// Commands of a file.
pub(super) struct FileCommands {
    /// Numbers in one, at least 1.
    pub(super) size: usize,
    /// (scenes, frames, size)
    pub(super) values: Vec<f32>,
    /// (size) Which of them are set points.
    pub(super) set_points: Vec<bool>,
}

/// A command for every frame of every scene.
pub(super) fn read_commands(
    file: &Tensors<'_>,
    scenes: usize,
    frames: usize,
) -> Result<Option<FileCommands>, SceneError> {
    if !file.has("commands") {
        if file.has("command_last") {
            return Err(file.fail("tensor commands", Problem::Missing));
        }
        return Ok(None);
    }
    let ([.., size], values) = file.f32("commands", [Some(scenes), Some(frames), None])?;
    // Commands of no numbers would make chunks of 0.
    if size == 0 {
        let problem = Problem::WrongTensor {
            found: format!("F32 of shape {:?}", [scenes, frames, 0]),
            expected: format!("F32 of shape [{scenes}, {frames}, 1 or more]"),
        };
        return Err(file.fail("tensor commands", problem));
    }
    file.count::<bool>("tensor commands", size)?;
    let mut set_points = vec![false; size];
    if file.has("command_last") {
        let (_, codes) = file.u8("command_last", [Some(size)])?;
        for (row, (held, code)) in set_points.iter_mut().zip(codes).enumerate() {
            if code > 1 {
                let expected = "0 (of a step the mean counts) or 1 (the last one counts)";
                return Err(file.bad_value("command_last", row, code, expected));
            }
            *held = code == 1;
        }
    }
    Ok(Some(FileCommands { size, values, set_points }))
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
    // Normalising would change the last bits of what was recorded.
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_unchecked(quaternion)))
}
