//! A robot's scene as a world that can step.

use rigidformer_core::{EditError, JoinError, Limits, ObserveError, Posed};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::world::{World, WorldError};

use crate::scene::RobotScene;

/// Why a robot's scene makes no world.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RobotWorldError {
    /// There is no memory for it, or no kernel.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The model takes no such units or time step.
    #[error(transparent)]
    Units(#[from] ObserveError),
    /// Its planes or its gravity are out of range.
    #[error(transparent)]
    Scene(#[from] EditError),
    /// A joint cannot be held.
    #[error(
        "joint of unit {unit}: {source}; models that move units by impulses, such as edge, hold all kinds"
    )]
    Joint {
        /// The unit that hangs from it.
        unit: usize,
        /// Why.
        source: JoinError,
    },
}

impl RobotScene {
    /// The scene at rest in a world of just its size: units, planes, gravity, the time step of a frame, and all joints with their kinds,
    /// axes and limits. [`World::snapshot`] of it is a scene for microcontrollers: C's `rf_load` and Rust's `Simulator::restore`
    /// take it within the same [limits](rigidformer_core::Simulator::limits).
    ///
    /// ```
    /// use rigidformer_robots::{LoadOptions, SceneOptions, parse_robot};
    /// use rigidformer_runtime::{engine::Engine, models::LoadedModel, world::World};
    /// let door = br#"<mujoco><worldbody><body name="frame" pos="0 0 1"><geom type="box" size=".05 .05 1"/>
    ///   <body name="door" pos=".05 0 0"><joint axis="0 0 1"/><geom type="box" size=".4 .02 .9" pos=".42 0 0"/></body>
    ///   </body></worldbody></mujoco>"#;
    /// let robot = parse_robot("door.xml".as_ref(), door, &LoadOptions::default())?;
    /// let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
    /// let mut world = robot.scene(&SceneOptions::default())?.world(Engine::new()?, &model)?;
    /// assert_eq!(world.simulator().joints().count(), 1);
    /// // The same scene from its bytes.
    /// let state = world.start()?;
    /// let mut other = World::new(&model, state.limits())?;
    /// other.restore(state.snapshot())?;
    /// for world in [&mut world, &mut other] {
    ///     world.step()?;
    /// }
    /// assert_eq!(world.snapshot(), other.snapshot());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`RobotWorldError`].
    pub fn world(&self, engine: Engine, model: &LoadedModel) -> Result<World, RobotWorldError> {
        let units = self.scene.units();
        let points = units.iter().map(|unit| unit.as_unit().room()).sum();
        let mut world = World::on(engine, model, Limits { units: units.len(), points }, 1)?;
        // A pose of each frame, twice the same: at rest.
        let posed = units.iter().filter_map(|unit| {
            let pose = *unit.poses.first()?;
            Some(Posed { unit: unit.as_unit(), previous: pose, current: pose })
        });
        world.edit(|simulator| {
            simulator.set_gravity(self.scene.gravity_m_s2())?;
            if let Some(planes) = self.scene.planes() {
                simulator.set_planes(planes)?;
            }
            simulator.observe_poses(1.0 / self.scene.frame_rate_hz(), posed)?;
            let ids: Vec<_> = simulator.units().map(|unit| unit.id()).collect();
            for (joint, held) in self.joints_of(&ids).iter().zip(&self.held) {
                let joined = simulator.join(joint);
                joined.map_err(|source| RobotWorldError::Joint { unit: held.unit, source })?;
            }
            Ok::<_, RobotWorldError>(())
        })?;
        Ok(world)
    }
}
