//! Futures and copies that start from a world as it is.

use rigidformer_core::{Limits, SnapshotError};

use crate::terrain::HeightFieldBuf;
use crate::world::{Snapshot, World, WorldError};

/// The whole state of a world, for futures to start from ([`Start::of`](super::Start::of)).
///
/// ```
/// use nalgebra::Isometry3;
/// # use nalgebra::{Point3, Vector3};
/// # use rigidformer_runtime::core::{Joint, Limits, Physics, Role, Unit};
/// use rigidformer_runtime::engine::Engine;
/// use rigidformer_runtime::futures::{BatchSimulator, Start};
/// # use rigidformer_runtime::models::LoadedModel;
/// # use rigidformer_runtime::world::World;
/// # let loaded = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// # let corner = |i: usize, bit| if i & bit == 0 { -0.1 } else { 0.1 };
/// # let points: Vec<_> = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
/// # let unit = Unit::new(&points, Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 }).body(1);
/// # let mut world = World::new(&loaded, Limits { units: 8, points: 512 })?;
/// # world.set_dt(1.0 / 24.0)?;
/// # let hand = world.add(&unit.role(Role::Driven), &Isometry3::translation(0.0, 0.0, 1.0))?;
/// # let link = world.add(&unit, &Isometry3::translation(0.2, 0.0, 1.0))?;
/// # let (pivot, parent_pivot) = (Point3::new(-0.1, 0.0, 0.0), Point3::new(0.1, 0.0, 0.0));
/// # world.edit(|simulator| simulator.join(&Joint::ball(link, hand, pivot, parent_pivot)))?;
/// world.step()?; // a hand, and a link that hangs from it
/// let state = world.start()?;
/// let mut poses = vec![Isometry3::identity(); 16 * 2]; // one future of 16 steps
/// BatchSimulator::new(Engine::new()?, &loaded).run(&Start::of(&state), 16, &(), &mut poses)?;
/// (0..16).try_for_each(|_| world.step().map(drop))?;
/// assert_eq!(poses.last().copied(), world.pose(link)); // to the bit
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct StartState {
    snapshot: Snapshot,
    limits: Limits,
    dt_s: f32,
    height_field: Option<HeightFieldBuf>,
}

impl StartState {
    /// Of a snapshot of a world with so many units as `limits` say, points that they have room in, and a time step. Where futures
    /// start it is checked.
    pub fn new(snapshot: Snapshot, limits: Limits, dt_s: f32) -> Self {
        StartState { snapshot, limits, dt_s, height_field: None }
    }

    /// The same state on ground of varying height, which snapshots do not hold.
    pub fn on_height_field(self, height_field: Option<HeightFieldBuf>) -> Self {
        StartState { height_field, ..self }
    }

    /// The ground of varying height.
    pub fn height_field(&self) -> Option<&HeightFieldBuf> {
        self.height_field.as_ref()
    }

    /// The world's snapshot.
    pub fn snapshot(&self) -> &Snapshot {
        &self.snapshot
    }

    /// Its units, and points that it has room in.
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// Units.
    pub fn units(&self) -> usize {
        self.limits.units
    }

    /// Seconds of a step.
    pub fn dt_s(&self) -> f32 {
        self.dt_s
    }
}

impl World {
    /// The world as it is, for futures, copies and planners to start from with the same bits ([`StartState`]).
    ///
    /// # Errors
    /// [`WorldError`] where there is no memory to find out how much room its units need.
    pub fn start(&self) -> Result<StartState, WorldError> {
        let simulator = self.simulator();
        let snapshot = match self.copies() {
            1 => self.snapshot(),
            _ => self.snapshot_copy(0)?,
        };
        let (most, height_field) = (simulator.limits(), self.height_field());
        let points = simulator.units().map(|unit| unit.point_count()).sum();
        let mut limits = Limits { units: simulator.len(), points };
        // Hulls may need more room than points. Copies of a world with room to spare would take memory for nothing.
        loop {
            let mut world = World::on(self.engine().single(), self.model(), limits, 1)?;
            // The same model takes the same field.
            let _ = world.set_height_field(height_field.as_ref());
            match world.restore(&snapshot) {
                Err(SnapshotError::TooManyPoints { found, .. }) if limits.points < most.points => {
                    limits.points = found.max(limits.points.saturating_mul(2)).min(most.points);
                }
                restored => {
                    restored?;
                    let dt_s = simulator.dt_s().unwrap_or_default();
                    return Ok(StartState { snapshot, limits, dt_s, height_field });
                }
            }
        }
    }
}
