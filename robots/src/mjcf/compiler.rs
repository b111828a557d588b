//! What `<compiler>` says, and the frames that it rules.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::error::{Problem, RobotError};
use crate::robot::turn;
use crate::xml::Element;

/// Lengths of axes below this are no direction.
const NO_DIRECTION: f64 = 1e-10;

/// When geometries give a body its mass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FromGeometry {
    Never,
    Auto,
    Always,
}

/// Settings of all files together; later elements win.
#[derive(Clone, Debug)]
pub(super) struct Compiler {
    pub(super) is_degree: bool,
    euler: [u8; 3],
    pub(super) mesh_folder: String,
    pub(super) strips_path: bool,
    pub(super) auto_limits: bool,
    pub(super) from_geometry: FromGeometry,
    pub(super) groups: [f64; 2],
    pub(super) bound_mass: f64,
    pub(super) bound_inertia: f64,
    pub(super) total_mass: Option<f64>,
    pub(super) balances: bool,
    pub(super) exact_meshes: bool,
}

impl Default for Compiler {
    fn default() -> Self {
        Self {
            is_degree: true,
            euler: *b"xyz",
            mesh_folder: String::new(),
            strips_path: false,
            auto_limits: true,
            from_geometry: FromGeometry::Auto,
            groups: [0.0, 5.0],
            bound_mass: 0.0,
            bound_inertia: 0.0,
            total_mass: None,
            balances: false,
            exact_meshes: false,
        }
    }
}

impl Compiler {
    pub(super) fn read(root: &Element) -> Result<Self, RobotError> {
        let mut own = Self::default();
        for element in root.all("compiler") {
            own.add(element)?;
        }
        Ok(own)
    }

    fn add(&mut self, element: &Element) -> Result<(), RobotError> {
        let angles = [("degree", true), ("radian", false)];
        if let Some(is_degree) = element.word("angle", &angles, "degree or radian")? {
            self.is_degree = is_degree;
        }
        if element.get("coordinate").is_some_and(|word| word != "local") {
            let what = "coordinate=\"global\"";
            let remedy =
                "save the model with an MuJoCo that still converts it to local coordinates";
            return Err(element.fail(Problem::Unsupported { what, remedy }));
        }
        if let Some(order) = element.get("eulerseq") {
            let letters = <[u8; 3]>::try_from(order.as_bytes()).ok();
            let known =
                letters.filter(|letters| letters.iter().all(|letter| b"xyzXYZ".contains(letter)));
            self.euler = known.ok_or_else(|| {
                element.fail(Problem::word("eulerseq", order, "three letters of xyzXYZ"))
            })?;
        }
        for name in ["assetdir", "meshdir"] {
            if let Some(folder) = element.get(name) {
                self.mesh_folder = folder.to_owned();
            }
        }
        if let Some(strips) = element.flag("strippath")? {
            self.strips_path = strips;
        }
        if let Some(auto) = element.flag("autolimits")? {
            self.auto_limits = auto;
        }
        let ways = [
            ("false", FromGeometry::Never),
            ("auto", FromGeometry::Auto),
            ("true", FromGeometry::Always),
        ];
        if let Some(way) = element.word("inertiafromgeom", &ways, "true, false or auto")? {
            self.from_geometry = way;
        }
        if let Some(groups) = element.numbers("inertiagrouprange")? {
            self.groups = groups;
        }
        let bound = |name: &'static str, now: f64| -> Result<f64, RobotError> {
            Ok(element.number(name)?.map_or(now, |bound| bound.max(0.0)))
        };
        self.bound_mass = bound("boundmass", self.bound_mass)?;
        self.bound_inertia = bound("boundinertia", self.bound_inertia)?;
        if let Some(total) = element.number("settotalmass")? {
            self.total_mass = (total > 0.0).then_some(total);
        }
        if let Some(balances) = element.flag("balanceinertia")? {
            self.balances = balances;
        }
        if let Some(exact) = element.flag("exactmeshinertia")? {
            self.exact_meshes = exact;
        }
        Ok(())
    }

    /// Radians of an angle of the file.
    pub(super) fn angle(&self, angle: f64) -> f64 {
        if self.is_degree { angle.to_radians() } else { angle }
    }

    /// The pose that an element's attributes say.
    pub(super) fn pose(&self, element: &Element) -> Result<Isometry3<f64>, RobotError> {
        let pos = element.numbers("pos")?.unwrap_or([0.0; 3]);
        Ok(Isometry3::from_parts(Translation3::from(Vector3::from(pos)), self.rotation(element)?))
    }

    /// The rotation that an element's attributes say: `quat` counts where there is no other.
    pub(super) fn rotation(&self, element: &Element) -> Result<UnitQuaternion<f64>, RobotError> {
        let bad = |name: &str| {
            let found =
                rigidformer_runtime::files::shown(element.get(name).unwrap_or_default(), 80);
            element.fail(Problem::Number { attribute: name.into(), found, expected: "a rotation" })
        };
        let direction =
            |name: &str, v: Vector3<f64>| Unit::try_new(v, NO_DIRECTION).ok_or_else(|| bad(name));
        if let Some([x, y, z, angle]) = element.numbers("axisangle")? {
            let axis = direction("axisangle", Vector3::new(x, y, z))?;
            return Ok(UnitQuaternion::from_axis_angle(&axis, self.angle(angle)));
        }
        if let Some([a, b, c, d, e, f]) = element.numbers("xyaxes")? {
            let x = direction("xyaxes", Vector3::new(a, b, c))?;
            let y = Vector3::new(d, e, f);
            let y = direction("xyaxes", y - x.into_inner() * x.dot(&y))?;
            let columns = Matrix3::from_columns(&[x.into_inner(), y.into_inner(), x.cross(&y)]);
            return Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
                columns,
            )));
        }
        if let Some(z) = element.numbers("zaxis")? {
            return Ok(from_z(&direction("zaxis", Vector3::from(z))?));
        }
        if let Some(angles) = element.numbers::<3>("euler")? {
            let mut all = UnitQuaternion::identity();
            for (letter, angle) in self.euler.iter().zip(angles) {
                let axis = match letter.to_ascii_lowercase() {
                    b'x' => Vector3::x_axis(),
                    b'y' => Vector3::y_axis(),
                    _ => Vector3::z_axis(),
                };
                let own = UnitQuaternion::from_axis_angle(&axis, self.angle(angle));
                // Small letters turn with the frame, large ones about the parent's axes.
                all = if letter.is_ascii_lowercase() { all * own } else { own * all };
            }
            return Ok(all);
        }
        match element.numbers("quat")? {
            Some(quat) => turn(quat).ok_or_else(|| bad("quat")),
            None => Ok(UnitQuaternion::identity()),
        }
    }
}

/// The least turn from z to a direction.
pub(super) fn from_z(direction: &Unit<Vector3<f64>>) -> UnitQuaternion<f64> {
    let across = Vector3::z().cross(direction);
    let axis = Unit::try_new(across, NO_DIRECTION).unwrap_or(Vector3::x_axis());
    UnitQuaternion::from_axis_angle(&axis, across.norm().atan2(direction.z))
}
