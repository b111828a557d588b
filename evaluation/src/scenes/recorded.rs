//! One recorded scene, in memory.

use std::ops::Range;
use std::path::PathBuf;

use nalgebra::{Isometry3, Point3, Vector3};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{
    Compliance, ContactLaw, MAX_PIECES, MAX_PLANES, Physics, Plane, Role, Unit,
};
use rigidformer_runtime::pivots::Pivot;
use rigidformer_runtime::terrain::HeightFieldBuf;

use super::bonds::{RecordedBond, clusters};
use super::split::Split;
use super::{Problem, SceneError};
use crate::convex_pieces::{ConvexPieces, lie_far};

/// Roles in the order of their codes in a file.
pub(super) const ROLES: [Role; 3] = [Role::Free, Role::Driven, Role::Fixed];
/// The largest number of a body.
// The core keeps the greatest number for units that are a body of their own.
pub(super) const MAX_BODY: u16 = u16::MAX - 1;

/// The code of a role in a file; `None` for a role that files do not know.
pub(super) fn role_code(role: Role) -> Option<u8> {
    ROLES.iter().position(|known| *known == role).and_then(|code| u8::try_from(code).ok())
}

/// How a unit moves.
///
/// ```
/// use nalgebra::Vector3;
/// use rigidformer_evaluation::scenes::Velocity;
/// let thrown = Velocity { linear_m_s: Vector3::new(1.0, 0.0, 0.5), ..Velocity::default() };
/// assert_eq!(thrown.angular_rad_s, Vector3::zeros());
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity {
    /// Of the origin of its body frame, in the world, m/s.
    pub linear_m_s: Vector3<f32>,
    /// In the world, rad/s.
    pub angular_rad_s: Vector3<f32>,
}

/// One unit of a scene: a body, or one of several units of a body.
///
/// ```
/// use nalgebra::{Isometry3, Point3};
/// use rigidformer_core::{Physics, Role};
/// use rigidformer_evaluation::scenes::RecordedUnit;
///
/// let points = vec![Point3::origin(), Point3::new(0.1, 0.0, 0.0), Point3::new(0.0, 0.1, 0.0), Point3::new(0.0, 0.0, 0.1)];
/// let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
/// let poses = vec![Isometry3::translation(0.0, 0.0, 1.0); 11];
/// let shelf = RecordedUnit::new("shelf", points, physics, poses).with_role(Role::Fixed).with_body(3);
/// assert_eq!((shelf.role, shelf.body), (Role::Fixed, Some(3)));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedUnit {
    /// Name of its shape.
    pub shape: String,
    /// (points) Surface points in the body frame, metres.
    pub points: Vec<Point3<f32>>,
    /// Mass in kg, friction, restitution.
    pub physics: Physics,
    /// Who moves it.
    pub role: Role,
    /// Units of a scene with the same number, at most 65534, belong to one body; `None`: a body of its own.
    pub body: Option<u16>,
    /// (frames) Body frame to world; of a soft unit, the rigid pose that fits best.
    pub poses: Vec<Isometry3<f32>>,
    /// (frames, points) World positions of a soft unit's points, metres; `None` for a rigid unit.
    pub soft: Option<Vec<Vec<Point3<f32>>>>,
    /// Young's modulus of a soft unit, Pa, where it is known.
    pub young_pa: Option<f32>,
    /// Its velocity at frame 0, where it was recorded.
    pub velocity: Option<Velocity>,
    /// Principal moments of inertia, kg m^2, through its centre about axes along those of its points; `None`: those of a
    /// uniform box around them.
    pub inertia: Option<[f32; 3]>,
    /// How contact with it gives way.
    pub compliance: Compliance,
    /// Convex pieces that it touches with, in the body frame, metres; none: it is the hull of its points.
    pub pieces: ConvexPieces,
}

impl RecordedUnit {
    /// A rigid unit that the model moves, a body of its own.
    pub fn new(
        shape: impl Into<String>,
        points: Vec<Point3<f32>>,
        physics: Physics,
        poses: Vec<Isometry3<f32>>,
    ) -> Self {
        Self {
            shape: shape.into(),
            points,
            physics,
            role: Role::Free,
            body: None,
            poses,
            soft: None,
            young_pa: None,
            velocity: None,
            inertia: None,
            compliance: Compliance::RIGID,
            pieces: ConvexPieces::default(),
        }
    }

    /// As a simulator takes it.
    pub fn as_unit(&self) -> Unit<'_> {
        let Self { physics, role, body, inertia: inertia_kg_m2, compliance, .. } = *self;
        let pieces = self.pieces.view();
        let unit = Unit::new(&self.points, physics);
        Unit { role, body, inertia_kg_m2, pieces, compliance, ..unit }
    }

    /// World positions of its points at a frame, metres: as recorded for soft units, by the pose for rigid ones. `None` where the
    /// frame is not recorded.
    pub fn points_at(&self, frame: usize) -> Option<Vec<Point3<f32>>> {
        match &self.soft {
            Some(frames) => frames.get(frame).cloned(),
            None => {
                let pose = self.poses.get(frame)?;
                Some(in_own_environment(|| self.points.iter().map(|point| pose * point).collect()))
            }
        }
    }

    /// The same unit in another role.
    pub fn with_role(self, role: Role) -> Self {
        Self { role, ..self }
    }

    /// The same unit as one of a body's.
    pub fn with_body(self, body: u16) -> Self {
        Self { body: Some(body), ..self }
    }

    /// The same unit as a soft one: (frames, points) world positions of its points, metres.
    pub fn with_soft(self, points: Vec<Vec<Point3<f32>>>) -> Self {
        Self { soft: Some(points), ..self }
    }

    /// The same unit with a known Young's modulus, Pa.
    pub fn with_young(self, young_pa: f32) -> Self {
        Self { young_pa: Some(young_pa), ..self }
    }

    /// The same unit with a known velocity at frame 0.
    pub fn with_velocity(self, velocity: Velocity) -> Self {
        Self { velocity: Some(velocity), ..self }
    }

    /// The same unit, which touches with convex pieces.
    pub fn with_pieces(self, pieces: ConvexPieces) -> Self {
        Self { pieces, ..self }
    }

    /// The same unit, with contact that gives way.
    pub fn with_compliance(self, compliance: Compliance) -> Self {
        Self { compliance, ..self }
    }

    /// The same unit with known moments of inertia, kg m^2.
    pub fn with_inertia(self, inertia: [f32; 3]) -> Self {
        Self { inertia: Some(inertia), ..self }
    }
}

/// A command per frame.
#[derive(Clone, Debug, PartialEq)]
struct Commands {
    /// At least 1.
    size: usize,
    /// (frames, size)
    values: Vec<f32>,
    /// (size) Whether of a step the last one counts, not the mean.
    set_points: Vec<bool>,
}

/// What soft units are the surface of and filled with, for figures and pictures. Points are counted over a scene's soft units, one
/// unit after the other.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SoftMesh {
    /// Triangles of surfaces.
    pub faces: Vec<[usize; 3]>,
    /// Lines whose lengths are measured.
    pub edges: Vec<[usize; 2]>,
    /// What bodies are filled with, for volumes.
    pub tetrahedra: Vec<[usize; 4]>,
}

impl SoftMesh {
    /// The first row that is not of different points among the first `points`.
    fn problem(&self, points: usize) -> Option<Problem> {
        let of = |list, rows: &mut dyn Iterator<Item = &[usize]>| {
            rows.enumerate().find_map(|(row, corners)| {
                let what = row_problem(corners, &(0..points))?;
                Some(Problem::BadMesh { list, row, what })
            })
        };
        of("faces", &mut self.faces.iter().map(|row| row.as_slice()))
            .or_else(|| of("edges", &mut self.edges.iter().map(|row| row.as_slice())))
            .or_else(|| of("tetrahedra", &mut self.tetrahedra.iter().map(|row| row.as_slice())))
    }
}

/// What is wrong with a row of numbers that must be different ones of a range.
pub(super) fn row_problem(row: &[usize], range: &Range<usize>) -> Option<&'static str> {
    let again = |(at, number): (usize, &usize)| row.iter().take(at).any(|n| n == number);
    if !row.iter().all(|number| range.contains(number)) {
        Some("names what its scene does not have")
    } else if row.iter().enumerate().any(again) {
        Some("names one of them twice")
    } else {
        None
    }
}

/// One scene with its recorded motion: at least one unit, at least one frame, the same frames for all units, all
/// numbers finite, fixed units at one pose.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedScene {
    name: String,
    seed: i64,
    split: Split,
    frame_rate_hz: f32,
    gravity_m_s2: Vector3<f32>,
    units: Vec<RecordedUnit>,
    frames: usize,
    planes: Option<Vec<Plane>>,
    /// Of each plane; none: all are rigid.
    plane_compliance: Vec<Compliance>,
    contact_law: ContactLaw,
    height_field: Option<HeightFieldBuf>,
    commands: Option<Commands>,
    pivots: Vec<Pivot>,
    mesh: SoftMesh,
    bonds: Vec<RecordedBond>,
}

impl RecordedScene {
    /// A scene from its parts, without commands and with planes that are not known. `name` is what errors and tables
    /// call it.
    pub fn new(
        name: impl Into<String>,
        seed: i64,
        split: Split,
        frame_rate_hz: f32,
        gravity_m_s2: Vector3<f32>,
        units: Vec<RecordedUnit>,
    ) -> Result<Self, SceneError> {
        let gravity = gravity_m_s2;
        in_own_environment(|| {
            Self::checked(name.into(), (seed, split), frame_rate_hz, gravity, units)
        })
    }

    fn checked(
        name: String,
        (seed, split): (i64, Split),
        frame_rate_hz: f32,
        gravity_m_s2: Vector3<f32>,
        units: Vec<RecordedUnit>,
    ) -> Result<Self, SceneError> {
        let frames = units.first().map_or(0, |unit| unit.poses.len());
        // In this order: later checks rely on earlier ones.
        let problem = if units.is_empty() {
            Some(Problem::Inconsistent("has no units"))
        } else if frames == 0 || units.iter().any(|unit| unit.poses.len() != frames) {
            let text = "needs the same number of poses for every unit, at least one";
            Some(Problem::Inconsistent(text))
        } else if !(frame_rate_hz.is_finite()
            && frame_rate_hz > 0.0
            && gravity_m_s2.iter().all(|g| g.is_finite()))
        {
            Some(Problem::Inconsistent("needs a frame rate above 0 and a finite gravity"))
        } else if units.iter().any(|unit| unit.velocity.is_some() != units[0].velocity.is_some()) {
            let text = "needs the velocity at frame 0 of every unit, or of none";
            Some(Problem::Inconsistent(text))
        } else if some_moduli(&units) {
            let text = "needs the Young's modulus of every soft unit, or of none";
            Some(Problem::Inconsistent(text))
        } else if !units.iter().all(finite_unit) {
            Some(Problem::Inconsistent(
                "needs finite points, poses and velocities, a mass above 0, friction and restitution of at least 0",
            ))
        } else {
            units.iter().enumerate().find_map(|(index, unit)| unit_problem(index, unit))
        };
        if let Some(problem) = problem {
            return Err(in_memory(name, problem));
        }
        let (planes, commands, pivots) = (None, None, Vec::new());
        Ok(Self {
            name,
            seed,
            split,
            frame_rate_hz,
            gravity_m_s2,
            units,
            frames,
            planes,
            plane_compliance: Vec::new(),
            contact_law: ContactLaw::RIGID,
            height_field: None,
            commands,
            pivots,
            mesh: SoftMesh::default(),
            bonds: Vec::new(),
        })
    }

    /// The same scene with the mesh of its soft units.
    ///
    /// # Errors
    /// [`Problem::BadMesh`] where a row names a point that no soft unit has, or one point twice.
    pub fn with_mesh(self, mesh: SoftMesh) -> Result<Self, SceneError> {
        let soft = self.units.iter().filter(|unit| unit.soft.is_some());
        match mesh.problem(soft.map(|unit| unit.points.len()).sum()) {
            Some(problem) => Err(in_memory(self.name, problem)),
            None => Ok(self.with_checked_mesh(mesh)),
        }
    }

    /// The same scene with a mesh that a file's reader has checked.
    pub(super) fn with_checked_mesh(self, mesh: SoftMesh) -> Self {
        Self { mesh, ..self }
    }

    /// What its soft units are the surface of and filled with.
    pub fn mesh(&self) -> &SoftMesh {
        &self.mesh
    }

    /// The same scene with units that hold together. A bond that breaks behind the last frame counts as one that holds.
    ///
    /// # Errors
    /// [`Problem::BadBond`] for a bond to a unit that is not there, or of a unit to itself.
    ///
    /// ```
    /// # use nalgebra::{Isometry3, Point3, Vector3};
    /// # use rigidformer_core::Physics;
    /// use rigidformer_evaluation::scenes::{RecordedBond, RecordedScene, RecordedUnit, Split};
    /// # let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
    /// # let unit = RecordedUnit::new("x", vec![Point3::origin(); 4], physics, vec![Isometry3::identity(); 9]).with_body(0);
    /// # let scene = RecordedScene::new("wall", 1, Split::Test, 60.0, Vector3::zeros(), vec![unit.clone(), unit])?;
    /// let scene = scene.with_bonds(vec![RecordedBond { units: [0, 1], breaks_at: Some(5) }])?;
    /// assert_eq!((scene.clusters_at(4), scene.clusters_at(5)), (vec![0, 0], vec![0, 1]));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn with_bonds(self, bonds: Vec<RecordedBond>) -> Result<Self, SceneError> {
        let range = 0..self.units.len();
        let bad = bonds.iter().enumerate().find_map(|(bond, found)| {
            row_problem(&found.units, &range).map(|what| Problem::BadBond { bond, what })
        });
        match bad {
            Some(problem) => Err(in_memory(self.name, problem)),
            None => Ok(self.with_checked_bonds(bonds)),
        }
    }

    /// The same scene with bonds that a file's reader has checked.
    pub(super) fn with_checked_bonds(self, bonds: Vec<RecordedBond>) -> Self {
        let frames = self.frames;
        Self { bonds: bonds.into_iter().map(|bond| bond.within(frames)).collect(), ..self }
    }

    /// The same scene without bonds, and with each unit that had one a body of its own.
    pub(crate) fn separated(&self) -> Result<Self, SceneError> {
        let mut scene = self.clone();
        for bond in &self.bonds {
            for unit in bond.units {
                if let Some(unit) = scene.units.get_mut(unit) {
                    // Units of one body do not collide, and separated pieces do.
                    unit.body = None;
                }
            }
        }
        scene.with_bonds(Vec::new())
    }

    /// Pairs of units that hold together until their bond breaks.
    pub fn bonds(&self) -> &[RecordedBond] {
        &self.bonds
    }

    /// (units) Which units hang together at a frame, as [`clusters`](super::clusters) says.
    pub fn clusters_at(&self, frame: usize) -> Vec<usize> {
        let holding = self.bonds.iter().filter(|bond| bond.holds(frame));
        clusters(self.units.len(), holding.map(|bond| bond.units))
    }

    /// The same scene between these planes, of which it may have none and has at most [`MAX_PLANES`].
    ///
    /// # Errors
    /// [`Problem::Inconsistent`] for too many planes, [`Problem::BadPlane`] for one that is none.
    ///
    /// ```
    /// use rigidformer_core::Plane;
    /// # use nalgebra::{Isometry3, Point3, Vector3};
    /// # use rigidformer_core::Physics;
    /// # use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
    /// # let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
    /// # let unit = RecordedUnit::new("x", vec![Point3::origin(); 4], physics, vec![Isometry3::identity()]);
    /// # let scene = RecordedScene::new("drop", 1, Split::Test, 240.0, Vector3::zeros(), vec![unit])?;
    /// let wall = Plane { normal: Vector3::new(-1.0, 0.0, 0.0), offset_m: -2.0, friction: 0.5, restitution: 0.3 };
    /// let scene = scene.with_planes(vec![Plane::ground(0.3, 0.5), wall])?;
    /// assert_eq!(scene.planes().map(<[Plane]>::len), Some(2));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn with_planes(self, planes: Vec<Plane>) -> Result<Self, SceneError> {
        if planes.len() > MAX_PLANES {
            let problem = Problem::Inconsistent("has more than 8 planes");
            return Err(in_memory(self.name, problem));
        }
        match planes.iter().position(|plane| !plane.is_sound()) {
            Some(plane) => Err(in_memory(self.name, Problem::BadPlane { plane })),
            None => Ok(self.with_checked_planes(planes)),
        }
    }

    /// The same scene between planes that a file's reader has checked.
    pub(super) fn with_checked_planes(self, planes: Vec<Plane>) -> Self {
        Self { planes: Some(planes), plane_compliance: Vec::new(), ..self }
    }

    /// The same scene, with planes that give way: the stiffness and the dissipation of each, or none where all are rigid.
    ///
    /// # Errors
    /// [`Problem::Inconsistent`] unless there is one for each plane or none, [`Problem::BadPlaneCompliance`] for one out of range.
    ///
    /// ```
    /// use rigidformer_core::{Compliance, Plane};
    /// # use nalgebra::{Isometry3, Point3, Vector3};
    /// # use rigidformer_core::Physics;
    /// # use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
    /// # let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
    /// # let unit = RecordedUnit::new("x", vec![Point3::origin(); 4], physics, vec![Isometry3::identity()]);
    /// # let scene = RecordedScene::new("drop", 1, Split::Test, 240.0, Vector3::zeros(), vec![unit])?;
    /// let mat = Compliance { stiffness_n_m: 2_000.0, dissipation_s_m: 1.0 };
    /// let scene = scene.with_planes(vec![Plane::ground(0.3, 0.5)])?.with_plane_compliance(vec![mat])?;
    /// assert_eq!(scene.plane_compliance(), [mat]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn with_plane_compliance(self, all: Vec<Compliance>) -> Result<Self, SceneError> {
        if !all.is_empty() && self.planes().map_or(0, <[Plane]>::len) != all.len() {
            let text = "needs the compliance of each of its planes";
            return Err(in_memory(self.name, Problem::Inconsistent(text)));
        }
        match all.iter().position(|compliance| !compliance.is_sound()) {
            Some(plane) => Err(in_memory(self.name, Problem::BadPlaneCompliance { plane })),
            None => Ok(self.with_checked_plane_compliance(all)),
        }
    }

    /// The same scene with what a file's reader has checked.
    pub(super) fn with_checked_plane_compliance(self, all: Vec<Compliance>) -> Self {
        let rigid = all.iter().all(Compliance::is_rigid);
        Self { plane_compliance: if rigid { Vec::new() } else { all }, ..self }
    }

    /// How contact with each plane gives way; none: all are rigid.
    pub fn plane_compliance(&self) -> &[Compliance] {
        &self.plane_compliance
    }

    /// The same scene, recorded by what has such contacts: those that bounce differ from rigid ones.
    ///
    /// # Errors
    /// [`Problem::BadContactLaw`] for an offset that is not from 0 to 1.
    ///
    /// ```
    /// # use nalgebra::{Isometry3, Point3, Vector3};
    /// # use rigidformer_core::Physics;
    /// # use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
    /// # let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
    /// # let unit = RecordedUnit::new("x", vec![Point3::origin(); 4], physics, vec![Isometry3::identity()]);
    /// # let scene = RecordedScene::new("drop", 1, Split::Test, 240.0, Vector3::zeros(), vec![unit])?;
    /// let scene = scene.with_contact_law("0.03,pyramid".parse()?)?;
    /// assert_eq!(scene.contact_law().restitution_offset, 0.03);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn with_contact_law(self, law: ContactLaw) -> Result<Self, SceneError> {
        match law.is_sound() {
            true => Ok(self.with_checked_contact_law(law)),
            false => Err(in_memory(self.name, Problem::BadContactLaw)),
        }
    }

    /// The same scene with a law that a file's reader has checked.
    pub(super) fn with_checked_contact_law(self, contact_law: ContactLaw) -> Self {
        Self { contact_law, ..self }
    }

    /// How contacts that bounce differ from rigid ones in what recorded it.
    pub fn contact_law(&self) -> ContactLaw {
        self.contact_law
    }

    /// The same scene on ground of varying height.
    ///
    /// # Errors
    /// [`Problem::BadHeightField`].
    ///
    /// ```
    /// # use nalgebra::{Isometry3, Point3, Vector3};
    /// # use rigidformer_core::Physics;
    /// # use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
    /// use rigidformer_runtime::terrain::HeightFieldBuf;
    /// # let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
    /// # let unit = RecordedUnit::new("x", vec![Point3::origin(); 4], physics, vec![Isometry3::identity()]);
    /// # let scene = RecordedScene::new("drop", 1, Split::Test, 240.0, Vector3::zeros(), vec![unit])?;
    /// let ramp = HeightFieldBuf {
    ///     heights_m: [0.0, 0.1, 0.0, 0.1].into(),
    ///     columns: 2,
    ///     spacing_m: [1.0, 1.0],
    ///     corner_m: Vector3::new(-0.5, -0.5, 0.0),
    ///     friction: 0.5,
    ///     restitution: 0.3,
    /// };
    /// let scene = scene.with_height_field(Some(ramp))?;
    /// assert_eq!(scene.height_field().map(|field| field.columns), Some(2));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn with_height_field(
        self,
        height_field: Option<HeightFieldBuf>,
    ) -> Result<Self, SceneError> {
        match height_field.as_ref().map_or(Ok(()), |field| field.view().check()) {
            Ok(()) => Ok(self.with_checked_height_field(height_field)),
            Err(cause) => Err(in_memory(self.name, Problem::BadHeightField(cause))),
        }
    }

    /// The same scene on ground that a file's reader has checked.
    pub(super) fn with_checked_height_field(self, height_field: Option<HeightFieldBuf>) -> Self {
        Self { height_field, ..self }
    }

    /// The ground of varying height that it is on, besides its planes.
    pub fn height_field(&self) -> Option<&HeightFieldBuf> {
        self.height_field.as_ref()
    }

    /// The same scene with other units and planes, which are checked as those of a new one.
    #[cfg(feature = "contact")]
    pub(crate) fn with_parts(
        &self,
        units: Vec<RecordedUnit>,
        planes: Option<Vec<Plane>>,
        gravity_m_s2: Vector3<f32>,
    ) -> Result<Self, SceneError> {
        let kind = (self.seed, self.split);
        let new = Self::checked(self.name.clone(), kind, self.frame_rate_hz, gravity_m_s2, units)?;
        let new = match planes {
            Some(planes) => new.with_planes(planes)?,
            None => new,
        };
        // Not the scene whole: its poses are most of it.
        Ok(Self {
            plane_compliance: self.plane_compliance.clone(),
            contact_law: self.contact_law,
            height_field: self.height_field.clone(),
            commands: self.commands.clone(),
            pivots: self.pivots.clone(),
            mesh: self.mesh.clone(),
            bonds: self.bonds.clone(),
            ..new
        })
    }

    /// The same scene with a command of `size` numbers per frame, `values` (frames, size).
    ///
    /// # Errors
    /// [`Problem::Inconsistent`] unless there are `size` finite numbers for each frame, at least one.
    pub fn with_commands(self, size: usize, values: Vec<f32>) -> Result<Self, SceneError> {
        let fits = size > 0 && self.frames.checked_mul(size) == Some(values.len());
        if !fits || !values.iter().all(|value| value.is_finite()) {
            let text =
                "needs a command of the same size for every frame, at least one number, all finite";
            return Err(in_memory(self.name, Problem::Inconsistent(text)));
        }
        // Means are right for speeds, which most commands are.
        let set_points = vec![false; size];
        Ok(Self { commands: Some(Commands { size, values, set_points }), ..self })
    }

    /// The same scene whose commands have set points: numbers that say where something is to be, such as the targets of joints,
    /// and not how fast. `set_points` (size) says which. See [`RecordedScene::command_of_step`].
    ///
    /// # Errors
    /// [`Problem::Inconsistent`] for a scene without commands, or with commands of another size.
    pub fn with_set_points(mut self, set_points: Vec<bool>) -> Result<Self, SceneError> {
        match &mut self.commands {
            Some(commands) if commands.size == set_points.len() => {
                commands.set_points = set_points;
                Ok(self)
            }
            _ => {
                let text = "needs commands, and of each number whether it is a set point";
                Err(in_memory(self.name, Problem::Inconsistent(text)))
            }
        }
    }

    /// The same scene with pivots at which rollouts hold its units together, such as [`pivots::of_scene`] finds. Files do not
    /// have them.
    ///
    /// # Errors
    /// [`Problem::Inconsistent`] for a pivot of a unit that is not there, or that is not finite. Circles are found when a rollout
    /// begins.
    ///
    /// [`pivots::of_scene`]: crate::pivots::of_scene
    pub fn with_pivots(self, pivots: Vec<Pivot>) -> Result<Self, SceneError> {
        // Circles of pivots need the whole tree, which `hold` builds anyway.
        let is_sound = |pivot: &Pivot| {
            pivot.unit.max(pivot.parent) < self.units.len()
                && pivot.pivot.iter().chain(pivot.parent_pivot.iter()).all(|v| v.is_finite())
        };
        if !pivots.iter().all(is_sound) {
            let text = "needs finite pivots of units that it has";
            return Err(in_memory(self.name, Problem::Inconsistent(text)));
        }
        Ok(Self { pivots, ..self })
    }

    /// Pivots at which rollouts hold its units together.
    pub fn pivots(&self) -> &[Pivot] {
        &self.pivots
    }

    /// Its planes, at most [`MAX_PLANES`]. `None` where they are not known: then a model's own ground is taken, the
    /// plane z = 0.
    pub fn planes(&self) -> Option<&[Plane]> {
        self.planes.as_deref()
    }

    /// The plane z = 0, if that is the only plane and known.
    pub fn ground(&self) -> Option<Plane> {
        only_ground(self.planes.as_deref()?)
    }

    /// Numbers in a command; 0 for a scene without commands.
    pub fn command_size(&self) -> usize {
        self.commands.as_ref().map_or(0, |commands| commands.size)
    }

    /// The command at a frame; `None` without commands or beyond the last frame.
    pub fn command(&self, frame: usize) -> Option<&[f32]> {
        let Commands { size, values, .. } = self.commands.as_ref()?;
        values.chunks_exact(*size).nth(frame)
    }

    /// (size) Which numbers of commands are set points; empty without commands.
    pub fn set_points(&self) -> &[bool] {
        self.commands.as_ref().map_or(&[], |commands| &commands.set_points)
    }

    /// The command of a step from frame `from` to frame `to`: the mean over frames `from` to `to` - 1, of set points that of frame
    /// `to` - 1. `None` without commands, or if one of those frames was not recorded or there is none.
    pub fn command_of_step(&self, from: usize, to: usize) -> Option<Vec<f32>> {
        in_own_environment(|| self.mean_command(from, to))
    }

    fn mean_command(&self, from: usize, to: usize) -> Option<Vec<f32>> {
        let Commands { size, values, set_points } = self.commands.as_ref()?;
        let rows = values.get(from.checked_mul(*size)?..to.checked_mul(*size)?)?;
        let count = to.checked_sub(from).filter(|count| *count > 0)? as f64;
        // Sums are in f64, so that equal commands have that command as their mean.
        let mut sums = vec![0.0; *size];
        for row in rows.chunks_exact(*size) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += f64::from(*value);
            }
        }
        let last = rows.chunks_exact(*size).next_back()?;
        let numbers = sums.into_iter().zip(last).zip(set_points);
        Some(
            numbers
                // The mean of a target is a place that nobody asked for.
                .map(|((sum, last), held)| if *held { *last } else { (sum / count) as f32 })
                .collect(),
        )
    }

    /// What errors and tables call it, such as `movi-a seed 1019`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The seed it was generated from.
    pub fn seed(&self) -> i64 {
        self.seed
    }

    /// What it may be used for.
    pub fn split(&self) -> Split {
        self.split
    }

    /// Frames per second of the recording.
    pub fn frame_rate_hz(&self) -> f32 {
        self.frame_rate_hz
    }

    /// Gravity, m/s².
    pub fn gravity_m_s2(&self) -> Vector3<f32> {
        self.gravity_m_s2
    }

    /// Its units, at least one.
    pub fn units(&self) -> &[RecordedUnit] {
        &self.units
    }

    /// Recorded frames, at least one; the last one is this minus 1.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Points of all units together.
    pub fn points(&self) -> usize {
        self.units.iter().map(|unit| unit.points.len()).sum()
    }

    /// Whether the velocities of its units at frame 0 are known.
    pub fn has_velocities(&self) -> bool {
        self.units.iter().all(|unit| unit.velocity.is_some())
    }

    /// Recorded pose of a unit at a frame.
    pub fn pose(&self, frame: usize, unit: usize) -> Option<&Isometry3<f32>> {
        self.units.get(unit)?.poses.get(frame)
    }

    /// (units) Recorded poses at a frame, if it was recorded.
    pub fn poses_at(&self, frame: usize) -> Option<Vec<Isometry3<f32>>> {
        self.units.iter().map(|unit| unit.poses.get(frame).copied()).collect()
    }

    /// The same scene with its first `frames` frames only, at least one; unchanged if it has no more.
    pub fn truncated(mut self, frames: usize) -> Self {
        self.frames = self.frames.min(frames.max(1));
        for unit in &mut self.units {
            unit.poses.truncate(self.frames);
            if let Some(soft) = &mut unit.soft {
                soft.truncate(self.frames);
            }
        }
        if let Some(Commands { size, values, .. }) = &mut self.commands {
            values.truncate(self.frames * *size);
        }
        let frames = self.frames;
        self.bonds.iter_mut().for_each(|bond| *bond = bond.within(frames));
        self
    }

    /// The same scene without its first `frames` frames; its last frame always stays. Velocities are those of frame 0
    /// and are left out where that is.
    pub fn skipping(mut self, frames: usize) -> Self {
        // A scene keeps one frame, since it cannot have none.
        let skipped = frames.min(self.frames.saturating_sub(1));
        self.frames -= skipped;
        for unit in &mut self.units {
            unit.poses.drain(..skipped);
            // A velocity at frame 0 is not that of the frame that is first now.
            unit.velocity = unit.velocity.filter(|_| skipped == 0);
            if let Some(soft) = &mut unit.soft {
                soft.drain(..skipped);
            }
        }
        if let Some(Commands { size, values, .. }) = &mut self.commands {
            values.drain(..skipped * *size);
        }
        self.bonds.iter_mut().for_each(|bond| *bond = bond.later(skipped));
        self
    }
}

/// The plane z = 0, if it is the only one of `planes`.
pub(super) fn only_ground(planes: &[Plane]) -> Option<Plane> {
    match planes {
        [plane] if *plane == Plane::ground(plane.friction, plane.restitution) => Some(*plane),
        _ => None,
    }
}

/// Whether the Young's moduli of some soft units are known, but not of all.
fn some_moduli(units: &[RecordedUnit]) -> bool {
    let known = |unit: &RecordedUnit| unit.soft.is_some().then_some(unit.young_pa.is_some());
    let mut known = units.iter().filter_map(known);
    known.next().is_some_and(|first| known.any(|other| other != first))
}

fn in_memory(field: String, problem: Problem) -> SceneError {
    SceneError { path: PathBuf::from("<memory>"), field, problem }
}

/// What is wrong with a unit's role, body, inertia or soft points; its poses are known to be as many as frames.
fn unit_problem(index: usize, unit: &RecordedUnit) -> Option<Problem> {
    let bad = |what| Some(Problem::BadUnit { unit: index, what });
    // Roles may be added to the core before files know them.
    if role_code(unit.role).is_none() {
        return bad("has a role that scene files do not know");
    }
    if unit.body.is_some_and(|body| body > MAX_BODY) {
        return bad("has a body number above 65534");
    }
    if unit.inertia.is_some_and(|moments| !is_inertia(moments)) {
        return bad(
            "needs moments of inertia that are finite, above 0 and at most the sum of the other two",
        );
    }
    if !unit.compliance.is_sound() {
        return bad(
            "needs a stiffness from 1e-3 to 1e12 N/m, or 0 (rigid), and a dissipation from 0 to 1e6 s/m",
        );
    }
    let pieces = &unit.pieces;
    // A scene is as sound in memory as one from a file.
    if pieces.len() > MAX_PIECES || pieces.counts().iter().any(|count| !(4..=255).contains(count)) {
        return bad("needs at most 32 convex pieces of 4 to 255 points each");
    }
    if !pieces.points().iter().flat_map(|point| point.iter()).all(|v| v.is_finite()) {
        return bad("has a point of a convex piece that is not finite");
    }
    if lie_far(&unit.points, pieces.points().iter()) {
        return bad(
            "has convex pieces more than 100 times as far out as its points; give both in metres",
        );
    }
    if let Some(soft) = &unit.soft {
        let points = unit.points.len();
        if soft.len() != unit.poses.len() || soft.iter().any(|frame| frame.len() != points) {
            return bad("needs as many soft points at every frame as its shape has points");
        }
        if !soft.iter().flatten().all(|point| point.iter().all(|v| v.is_finite())) {
            return bad("has a soft point that is not finite");
        }
    }
    if unit.young_pa.is_some_and(|young| !(young.is_finite() && young > 0.0) || unit.soft.is_none())
    {
        return bad("needs a Young's modulus above 0 if it is soft, and none if it is rigid");
    }
    // Scenery that moves would be a driven unit that the model is not told of.
    if unit.role == Role::Fixed {
        let first = unit.poses.first();
        let first_soft = unit.soft.as_ref().and_then(|soft| soft.first());
        let moves = |frame: &usize| {
            unit.poses.get(*frame) != first
                || unit.soft.as_ref().and_then(|soft| soft.get(*frame)) != first_soft
        };
        let frame = (0..unit.poses.len()).find(moves)?;
        return Some(Problem::FixedMoves { unit: index, frame });
    }
    None
}

/// Whether a body has such moments: of a plate the greatest is the sum of the others, but for rounding.
pub(super) fn is_inertia(moments: [f32; 3]) -> bool {
    let [x, y, z] = moments.map(f64::from);
    let greatest = x.max(y).max(z);
    moments.iter().all(|moment| moment.is_finite() && *moment > 0.0)
        // Of a plate the greatest moment equals the sum of the others, and rounding may lift it
        // above.
        && greatest <= 1.001 * (x + y + z - greatest)
}

fn finite_unit(unit: &RecordedUnit) -> bool {
    let Physics { mass_kg, friction, restitution } = unit.physics;
    mass_kg.is_finite()
        && mass_kg > 0.0
        && [friction, restitution].iter().all(|v| v.is_finite() && *v >= 0.0)
        && unit.points.iter().all(|point| point.iter().all(|v| v.is_finite()))
        && unit.poses.iter().all(|pose| {
            pose.translation.vector.iter().all(|v| v.is_finite())
                && pose.rotation.coords.iter().all(|v| v.is_finite())
        })
        && unit.velocity.is_none_or(|velocity| {
            velocity.linear_m_s.iter().chain(&velocity.angular_rad_s).all(|v| v.is_finite())
        })
}
