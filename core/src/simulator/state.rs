//! What a simulator holds, and how it is made.

use crate::contact::ground::Plane;
use crate::contact::law::ContactLaw;
use crate::error::WorkspaceError;
use crate::limits::{Layout, Limits, MAX_PLANES};
use crate::measure::Measure;
use crate::model::Model;
use crate::scene::{Compliance, Scene};
use crate::sizes::{Sizes, near_numbers};
use crate::slabs::{SlabSizes, Slabs};
use crate::stand_in::{OfCompliance, OfForce, OfHealth, OfHost};
use crate::structure::Bonds;
#[cfg(feature = "deform")]
use crate::structure::bonds::BONDS;
#[cfg(feature = "deform")]
use crate::structure::soft_points::SoftPoints;
use crate::workspace::{Lasting, Rows, carve};
use nalgebra::Vector3;

/// A scene of units and the model that advances it, in memory that the caller owns.
///
/// ```
/// use nalgebra::Point3;
/// use rigidformer_core::{Limits, Model, Observed, Physics, Simulator, SlabSizes, Slabs, Unit, UnitSlot};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let model = Model::load(rigidformer_weights::EDGE)?;
/// let limits = Limits { units: 2, points: 16 };
/// let sizes = SlabSizes::new(model.config(), limits);
/// let (mut numbers, mut bytes) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
/// let mut points = vec![Point3::origin(); sizes.points];
/// let mut units = vec![UnitSlot::EMPTY; sizes.units];
/// let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points, units: &mut units };
/// let mut simulator = Simulator::new(&model, limits, slabs)?;
///
/// // A cube drops onto another; 1/24 s between what was seen.
/// let cube = |z: f32| [0, 1, 2, 3, 4, 5, 6, 7].map(|i| {
///     let corner = |bit: i32| if i & bit == 0 { -0.2 } else { 0.2 };
///     Point3::new(corner(1), corner(2), z + corner(4))
/// });
/// let (low, before, now) = (cube(0.2), cube(0.9), cube(0.8));
/// let rubber = Physics { mass_kg: 0.5, friction: 0.8, restitution: 0.7 };
/// let lower = Observed { unit: Unit::new(&low, rubber), current: &low };
/// let upper = Observed { unit: Unit::new(&before, rubber), current: &now };
/// simulator.observe(1.0 / 24.0, [lower, upper])?;
/// for _ in 0..6 {
///     simulator.step()?;
/// }
/// let cube = simulator.unit(1).ok_or("no such unit")?;
/// let height = (cube.pose() * Point3::new(0.0, 0.0, 0.9)).z; // a pose carries `before` a quarter of a second ahead
/// assert!(height > 0.3, "{height}: free fall would have it at 0.2 m, inside the other");
/// # Ok(())
/// # }
/// ```
pub struct Simulator<'m, 's> {
    pub(super) model: &'m Model<'m>,
    pub(super) sizes: Sizes,
    pub(super) limits: Limits,
    pub(super) scene: Scene<'s>,
    /// What the scene has of it is in its own measure.
    pub(super) given: Given,
    pub(super) lasting: Lasting<'s>,
    pub(super) rows: Rows<'s>,
    pub(super) bonds: Bonds<'s>,
    /// What [`crate::network::present::find`] found.
    pub(super) present: OfHost<&'s mut [f32]>,
    /// The next unit's name.
    pub(super) next_id: u64,
    /// Native frames of the model in a time step: what its step modulation is told.
    pub(super) step_code: f32,
    /// Whether the modulations by the step code are of another one.
    pub(super) films_stale: bool,
    /// Whether a command was set.
    pub(super) commanded: bool,
    /// Whether the modulations by the commands are of others.
    pub(super) commands_stale: bool,
    /// Whether a unit that diverges is held instead of the step refused.
    pub(super) quarantines: OfHealth<bool>,
    /// Whether the network corrects motion.
    pub(super) has_network: bool,
}

/// The scene's surroundings as the caller gave them, in SI units.
pub(super) struct Given {
    pub(super) planes: heapless::Vec<Plane, MAX_PLANES>,
    pub(super) gravity: Vector3<f32>,
    /// 0 before there is one.
    pub(super) dt_s: f32,
}

impl<'m, 's> Simulator<'m, 's> {
    /// A simulator without units, over the model's ground plane and under its gravity. The slabs may be longer than
    /// needed.
    ///
    /// # Errors
    /// [`WorkspaceError`] when a slab is too short.
    pub fn new(
        model: &'m Model<'m>,
        limits: Limits,
        slabs: Slabs<'s>,
    ) -> Result<Self, WorkspaceError> {
        Self::with_layout(model, limits, 1, Layout::SMALL, slabs)
    }

    /// As [`new`](Self::new) for [`step_on`](Self::step_on) with schedules of another layout, and with room for `copies`
    /// (at least 1; it is 1 without the feature `host`, and on Cortex-M with DSP) of a scene within `limits`; the slabs are
    /// as long as [`SlabSizes::of`] says.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_layout(
        model: &'m Model<'m>,
        limits: Limits,
        copies: usize,
        layout: Layout,
        slabs: Slabs<'s>,
    ) -> Result<Self, WorkspaceError> {
        let copies = if cfg!(rigidformer_host) { copies.max(1) } else { 1 };
        let config = model.config();
        let needed = SlabSizes::of(config, limits, copies, layout);
        if slabs.f32.len() < needed.f32 {
            let found = slabs.f32.len();
            return Err(WorkspaceError::F32Slab { needed: needed.f32, found });
        }
        if slabs.i8.len() < needed.i8 {
            let found = slabs.i8.len();
            return Err(WorkspaceError::I8Slab { needed: needed.i8, found });
        }
        if slabs.points.len() < needed.points {
            let found = slabs.points.len();
            return Err(WorkspaceError::PointSlab { needed: needed.points, found });
        }
        if slabs.units.len() < needed.units {
            let found = slabs.units.len();
            return Err(WorkspaceError::UnitSlab { needed: needed.units, found });
        }
        let sizes = Sizes::new(config, limits, copies, layout);
        let (points, hulls) = slabs.points.split_at_mut(sizes.point_rows().min(slabs.points.len()));
        let hulls = if sizes.impacts == 0 { &mut [] } else { hulls };
        let mut planes = heapless::Vec::<Plane, MAX_PLANES>::new();
        let _ = planes.push(Plane::ground(config.ground_friction, config.ground_restitution));
        let gravity = Vector3::from(config.gravity_m_s2);
        let (lasting, rows) = carve(&sizes, slabs.f32, slabs.i8);
        #[cfg(not(feature = "deform"))]
        let _ = &lasting.soft;
        #[cfg(feature = "deform")]
        let (soft, lasting) = {
            let crate::workspace::Lasting { soft, .. } = lasting;
            let soft = SoftPoints::carve(soft, sizes.units, sizes.point_rows(), sizes.neighbours);
            (soft, Lasting { soft: &mut [], ..lasting })
        };
        let (present, lasting) = present_room(&sizes, lasting);
        #[cfg(not(feature = "deform"))]
        let bonds = Bonds::default();
        #[cfg(feature = "deform")]
        let (bonds, lasting) = {
            let crate::workspace::Lasting { solved, .. } = lasting;
            let extra =
                if sizes.layout.index { crate::contact::prior::extra(limits.units) } else { 0 };
            let motion = crate::contact::prior::solved_numbers(limits.units) + extra;
            let motion = if sizes.solved > 0 { sizes.units * motion } else { 0 };
            let (solved, room) = solved.split_at_mut(motion.min(solved.len()));
            let bonds = if sizes.solved > 0 { limits.units * BONDS } else { 0 };
            (Bonds::new(room, bonds), Lasting { solved, ..lasting })
        };
        Ok(Simulator {
            model,
            sizes,
            limits,
            scene: Scene {
                slots: slabs.units,
                count: 0,
                per_copy: 0,
                points,
                hulls,
                planes: planes.clone(),
                #[cfg(feature = "terrain")]
                terrain: None,
                plane_compliance: OfCompliance::new([Compliance::RIGID; MAX_PLANES]),
                measure: Measure::SI,
                second: OfForce::new(1.0),
                gravity,
                contact_law: ContactLaw::RIGID,
                dt: 0.0,
                substeps: 1,
                #[cfg(rigidformer_host)]
                extra: if sizes.layout.index {
                    crate::contact::prior::extra(limits.units)
                } else {
                    0
                },
                #[cfg(feature = "deform")]
                soft,
            },
            given: Given { planes, gravity, dt_s: 0.0 },
            lasting,
            rows,
            bonds,
            present,
            next_id: 1,
            step_code: 0.0,
            films_stale: true,
            commanded: false,
            commands_stale: false,
            quarantines: OfHealth::new(false),
            has_network: true,
        })
    }

    /// The model.
    pub fn model(&self) -> &'m Model<'m> {
        self.model
    }

    /// What it must be able to hold: of each copy, where there are several.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// Units in the scene, or in each copy of it; 0 before an observation.
    pub fn len(&self) -> usize {
        self.scene.per_copy
    }

    /// Whether the scene has no units.
    pub fn is_empty(&self) -> bool {
        self.scene.per_copy == 0
    }

    /// Seconds of a step; `None` before [`set_dt`](Self::set_dt) or an observation.
    pub fn dt_s(&self) -> Option<f32> {
        (self.given.dt_s > 0.0).then_some(self.given.dt_s)
    }

    /// The planes of the scene, z = 0 unless [others were set](Self::set_planes).
    pub fn planes(&self) -> &[Plane] {
        &self.given.planes
    }

    /// How contact with a plane gives way; `None`: there is no such plane.
    #[cfg(feature = "compliance")]
    pub fn plane_compliance(&self, plane: usize) -> Option<Compliance> {
        self.given.planes.get(plane)?;
        self.scene.plane_compliance.get()?.get(plane).copied()
    }

    /// Gravity, m/s^2.
    pub fn gravity_m_s2(&self) -> Vector3<f32> {
        self.given.gravity
    }
}

/// The room for which units the network sees, split off behind that for motion by impulses.
fn present_room<'s>(sizes: &Sizes, lasting: Lasting<'s>) -> (OfHost<&'s mut [f32]>, Lasting<'s>) {
    if !cfg!(feature = "host") {
        return (OfHost::new(&mut []), lasting);
    }
    let Lasting { solved, .. } = lasting;
    let found = near_numbers(sizes.units, sizes.copies) * sizes.near;
    let (solved, present) = solved.split_at_mut(solved.len().saturating_sub(found));
    (OfHost::new(present), Lasting { solved, ..lasting })
}
