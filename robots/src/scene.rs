//! A robot as the units of a scene.

use nalgebra::{
    Isometry3, Matrix3, Point3, Rotation3, SymmetricEigen, Translation3, UnitQuaternion,
    UnitVector3, Vector3,
};
use rigidformer_core::{
    Joint, JointAxis, JointKind as Held, MAX_PIECES, MAX_PLANES, Physics, Plane, Role, UnitId,
};
use rigidformer_evaluation::convex_pieces::ConvexPieces;
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, SceneNotes, Split, scene_file};
use rigidformer_runtime::hull::ConvexHull;
use rigidformer_runtime::pivots::Pivot;
use serde_json::{Value, json};
use std::path::Path;

use crate::error::RobotError;
use crate::robot::{JointKind, Link, Robot, RobotJoint};
use crate::sample;

/// Points of a convex piece, at most: a step's time grows with them.
const PIECE_POINTS: usize = 32;
/// Pieces that are merged to those of a unit, at most: the time grows with their square.
const MOST_MERGED: usize = 256;
/// Anchors of joints through links without a shape that are one, metres.
const SAME_M: f64 = 1e-6;
/// The least mass of a unit, kg, as the simulator takes it.
const LEAST_KG: f64 = 1e-9;
/// The farthest that a joint slides, metres, as the simulator takes it.
const MOST_M: f32 = 1e6;
/// The mass of units that nothing moves, kg: it counts for nothing.
const STATIC_KG: f32 = 1.0;

/// How a robot becomes a scene.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct SceneOptions {
    /// Points of a unit, 4 to 4096: 32.
    pub points: usize,
    /// Frames a second: 60. Both frames of the scene have the same poses.
    pub frame_rate_hz: f32,
    /// Gravity, m/s^2: 9.81 downwards.
    pub gravity_m_s2: Vector3<f32>,
    /// Friction of links whose file gives none: 0.5.
    pub friction: f32,
    /// Restitution of all links: 0.4.
    pub restitution: f32,
    /// What the robot stands on; none: the planes of its file, else z = 0 with friction 0.5 and restitution 0.4.
    pub planes: Option<Vec<Plane>>,
    /// Where the first link is in the world.
    pub base: Isometry3<f64>,
    /// Whether the first link, and what is fixed to it, never moves. What a file fixes to its world never does.
    pub fixed_base: bool,
    /// Joint positions; none: [`Robot::rest`].
    pub positions: Option<Vec<f64>>,
    /// Turns each unit's frame to its principal axes, so that its moments are exact. Else frames are the links', and products of inertia
    /// are left out: units have no such.
    pub principal_frames: bool,
}

impl Default for SceneOptions {
    fn default() -> Self {
        Self {
            points: 32,
            frame_rate_hz: 60.0,
            gravity_m_s2: Vector3::new(0.0, 0.0, -9.81),
            friction: 0.5,
            restitution: 0.4,
            planes: None,
            base: Isometry3::identity(),
            fixed_base: false,
            positions: None,
            principal_frames: false,
        }
    }
}

/// A robot's scene: two frames at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotScene {
    /// Its units, joined at pivots, which rollouts hold.
    pub scene: RecordedScene,
    /// (units) Number of each unit's link.
    pub links: Vec<usize>,
    /// (units) Each unit's frame in its link's: the identity without [`SceneOptions::principal_frames`].
    pub frames: Vec<Isometry3<f64>>,
    /// Joints between units, as the file's metadata have them: see [`file`](Self::file).
    pub joints: Value,
    /// Joints between units, as a simulator holds them: see [`joints_of`](Self::joints_of).
    pub held: Vec<HeldJoint>,
    /// What units leave out.
    pub notes: Vec<String>,
}

/// A joint between two units of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldJoint {
    /// Number of the unit that hangs.
    pub unit: usize,
    /// Number of the unit that it hangs from.
    pub parent: usize,
    /// The pivot in the unit's frame, metres.
    pub pivot: Point3<f32>,
    /// The pivot in the parent's frame, metres.
    pub parent_pivot: Point3<f32>,
    /// Kind, axis in the unit's frame, and limits, which count from the position that the scene begins at.
    pub kind: Held,
}

impl RobotScene {
    /// The joints for [`Simulator::join`](rigidformer_core::Simulator::join), once units are where the scene has them. `ids`: the
    /// simulator's ids of the scene's units; joints of units beyond them are left out.
    ///
    /// Models that move units by impulses hold all kinds. Other models hold balls alone: `held` tells which those are.
    ///
    /// ```
    /// use rigidformer_core::{JointKind, Limits, Posed};
    /// use rigidformer_robots::{LoadOptions, SceneOptions, parse_robot};
    /// use rigidformer_runtime::{models::LoadedModel, world::World};
    /// let door = br#"<mujoco><compiler angle="degree"/><worldbody><body name="frame" pos="0 0 1"><geom type="box" size=".05 .05 1"/>
    ///   <body name="door" pos=".05 0 0"><joint axis="0 0 1" range="0 90" limited="true"/>
    ///     <geom type="box" size=".4 .02 .9" pos=".42 0 0"/></body></body></worldbody></mujoco>"#;
    /// let robot = parse_robot("door.xml".as_ref(), door, &LoadOptions::default())?;
    /// let mut options = SceneOptions::default();
    /// options.fixed_base = true;
    /// let made = robot.scene(&options)?;
    /// let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
    /// let mut world = World::new(&model, Limits { units: 2, points: 64 })?;
    /// let units = made.scene.units().iter();
    /// let posed = units.map(|unit| Posed { unit: unit.as_unit(), previous: unit.poses[0], current: unit.poses[1] });
    /// let door = world.edit(|simulator| {
    ///     simulator.observe_poses(1.0 / 60.0, posed)?;
    ///     let ids: Vec<_> = (0..2).filter_map(|number| Some(simulator.unit(number)?.id())).collect();
    ///     for joint in made.joints_of(&ids) {
    ///         simulator.join(&joint)?;
    ///     }
    ///     let door = ids.last().copied().ok_or("no door")?;
    ///     simulator.set_joint_target(door, Some(1.0))?;
    ///     Ok::<_, Box<dyn std::error::Error>>(door)
    /// })?;
    /// world.step()?;
    /// assert!(matches!(made.held[0].kind, JointKind::Revolute(_)));
    /// assert!(world.simulator().joint_position(door).is_some_and(|radians| radians > 0.0));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn joints_of(&self, ids: &[UnitId]) -> Vec<Joint> {
        let joint = |held: &HeldJoint| {
            let (unit, parent) = (*ids.get(held.unit)?, *ids.get(held.parent)?);
            Some(Joint::ball(unit, parent, held.pivot, held.parent_pivot).kind(held.kind))
        };
        self.held.iter().filter_map(joint).collect()
    }
}

impl Robot {
    /// The robot's links as units: those that have a shape, and a mass or no motion. Parts of one robot have one body number, so that they
    /// do not collide.
    ///
    /// Units have no centre of mass of their own: a simulator takes that of the shape. The scene's pivots hold
    /// joints that turn, in all ways; [`RobotScene::joints_of`] has their kinds, axes and limits too.
    ///
    /// ```
    /// use rigidformer_core::{Limits, Posed};
    /// use rigidformer_robots::{LoadOptions, SceneOptions, parse_robot};
    /// use rigidformer_runtime::{models::LoadedModel, pivots::hold, world::World};
    /// let arm = br#"<mujoco><worldbody>
    ///   <body name="upper" pos="0 0 1"><freejoint/><geom type="capsule" size=".05" fromto="0 0 0 .3 0 0"/>
    ///     <body name="lower" pos=".3 0 0"><joint axis="0 1 0"/><geom type="capsule" size=".04" fromto="0 0 0 .3 0 0"/></body>
    ///   </body></worldbody></mujoco>"#;
    /// let robot = parse_robot("arm.xml".as_ref(), arm, &LoadOptions::default())?;
    /// let made = robot.scene(&SceneOptions::default())?;
    /// let scene = &made.scene;
    /// let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
    /// let mut world = World::new(&model, Limits { units: 2, points: 64 })?;
    /// let units = scene.units().iter();
    /// let posed = units.map(|unit| Posed { unit: unit.as_unit(), previous: unit.poses[0], current: unit.poses[1] });
    /// world.edit(|simulator| {
    ///     simulator.observe_poses(1.0 / 60.0, posed)?;
    ///     hold(simulator, scene.pivots()).map_err(Box::<dyn std::error::Error>::from)
    /// })?;
    /// world.step()?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`RobotError::Scene`] where no link makes a unit, or an option is out of range.
    pub fn scene(&self, options: &SceneOptions) -> Result<RobotScene, RobotError> {
        let fail = |problem: String| RobotError::Scene { robot: self.name.clone(), problem };
        if !(4..=4096).contains(&options.points) {
            return Err(fail(format!("{} points a unit; give 4 to 4096", options.points)));
        }
        let rest = self.rest();
        let poses = self.poses(options.positions.as_ref().unwrap_or(&rest))?;
        let statics = self.statics(options.fixed_base);
        let bodies = self.bodies();
        let mut made = Made {
            options,
            units: Vec::new(),
            links: Vec::new(),
            frames: Vec::new(),
            notes: Vec::new(),
        };
        for (number, link) in self.links.iter().enumerate() {
            let is_static = statics.get(number) == Some(&true);
            let pose = options.base * poses.get(number).copied().unwrap_or_default();
            made.add(number, link, (is_static, bodies.get(number).copied().flatten()), &pose);
        }
        let Made { units, links, frames, mut notes, .. } = made;
        if units.is_empty() {
            return Err(fail(
                "no link has both a shape and a mass; give links <collision> and <inertial>".into(),
            ));
        }
        let mut number = vec![None; self.links.len()];
        for (unit, link) in links.iter().enumerate() {
            if let Some(slot) = number.get_mut(*link) {
                *slot = Some(unit);
            }
        }
        let positions = options.positions.as_ref().unwrap_or(&rest);
        let (pivots, held, joints) =
            self.pivots(&poses, positions, (&number, &frames, &statics), &mut notes);
        if options.planes.is_none() && self.planes.len() > MAX_PLANES {
            notes.push(format!(
                "the world has {} planes: the first {MAX_PLANES} count",
                self.planes.len()
            ));
        }
        let scene = RecordedScene::new(
            &self.name,
            0,
            Split::Extra,
            options.frame_rate_hz,
            options.gravity_m_s2,
            units,
        );
        let scene = scene
            .and_then(|scene| scene.with_planes(self.planes_of(options)))
            .and_then(|scene| scene.with_pivots(pivots));
        let scene = scene.map_err(|error| fail(error.to_string()))?;
        Ok(RobotScene { scene, links, frames, joints, held, notes })
    }

    fn planes_of(&self, options: &SceneOptions) -> Vec<Plane> {
        if let Some(planes) = &options.planes {
            return planes.clone();
        }
        let ground = Plane { normal: Vector3::z(), offset_m: 0.0, friction: 0.5, restitution: 0.4 };
        if self.planes.is_empty() {
            return vec![ground];
        }
        let own = |(normal, offset, friction): &([f64; 3], f64, f64)| {
            let normal = options.base.rotation * Vector3::from(*normal);
            let offset_m = (offset + normal.dot(&options.base.translation.vector)) as f32;
            Plane {
                normal: normal.cast().normalize(),
                offset_m,
                friction: *friction as f32,
                restitution: ground.restitution,
            }
        };
        self.planes.iter().take(MAX_PLANES).map(own).collect()
    }

    /// (links) Whether nothing moves it.
    fn statics(&self, fixed_base: bool) -> Vec<bool> {
        let mut statics = vec![false; self.links.len()];
        if let Some(first) = statics.first_mut() {
            // A root of mass 0 that has a shape is scenery: tables and grounds are written so.
            let is_scenery = self.links.first().is_some_and(|link| {
                link.inertia.mass_kg == 0.0 && !link.surface.triangles.is_empty()
            });
            *first = self.is_in_world || fixed_base || is_scenery;
        }
        for joint in &self.joints {
            let above = statics.get(joint.parent) == Some(&true);
            if let Some(own) = statics.get_mut(joint.child) {
                *own = above && joint.kind == JointKind::Fixed;
            }
        }
        statics
    }

    /// (links) The number of the body that a link is a part of; none for the world's own shapes.
    fn bodies(&self) -> Vec<Option<u16>> {
        let mut bodies = vec![None; self.links.len()];
        let mut next = 0_u16;
        if let (false, Some(first)) = (self.is_in_world, bodies.first_mut()) {
            (*first, next) = (Some(0), 1);
        }
        for joint in &self.joints {
            let above = bodies.get(joint.parent).copied().flatten();
            let own = above.unwrap_or(next);
            next = next.max(own.saturating_add(1));
            if let Some(slot) = bodies.get_mut(joint.child) {
                *slot = Some(own);
            }
        }
        bodies
    }

    /// Pivots between units, and all joints between them for other programs.
    fn pivots(
        &self,
        poses: &[Isometry3<f64>],
        positions: &[f64],
        (number, frames, statics): (&[Option<usize>], &[Isometry3<f64>], &[bool]),
        notes: &mut Vec<String>,
    ) -> (Vec<Pivot>, Vec<HeldJoint>, Value) {
        let unit_of = |link: usize| number.get(link).copied().flatten();
        // (links) The joint that it hangs by.
        let mut above = vec![None; self.links.len()];
        for joint in &self.joints {
            if let Some(slot) = above.get_mut(joint.child) {
                *slot = Some(joint);
            }
        }
        let (mut pivots, mut held, mut rows) = (Vec::new(), Vec::new(), Vec::new());
        for (link, unit) in (0..self.links.len()).filter_map(|link| Some((link, unit_of(link)?))) {
            // The joints up to the next link that is a unit.
            let mut chain = Vec::new();
            let mut at = link;
            let parent = loop {
                let Some(joint) = above.get(at).copied().flatten() else { break None };
                chain.push(joint);
                at = joint.parent;
                if let Some(unit) = unit_of(at) {
                    break Some((at, unit));
                }
            };
            let Some((parent_link, parent)) = parent else { continue };
            // What never moves needs no joint to what never moves.
            if [link, parent_link].iter().all(|link| statics.get(*link) == Some(&true)) {
                continue;
            }
            let name = |link: usize| self.links.get(link).map_or("", |link| link.name.as_str());
            let (Some(own_pose), Some(parent_pose)) = (poses.get(link), poses.get(parent_link))
            else {
                continue;
            };
            let frame = |unit: usize| frames.get(unit).copied().unwrap_or_default();
            let anchors: Vec<Point3<f64>> = chain
                .iter()
                .filter(|joint| joint.kind != JointKind::Fixed || chain.len() == 1)
                .filter_map(|joint| Some(poses.get(joint.child)? * joint.anchor))
                .collect();
            let slides = chain
                .iter()
                .any(|joint| matches!(joint.kind, JointKind::Prismatic { .. } | JointKind::Free));
            let first = anchors.first().copied().unwrap_or(own_pose * Point3::origin());
            let is_one = anchors.iter().all(|anchor| (anchor - first).norm() <= SAME_M);
            let is_held = !slides && is_one;
            let pivot = (own_pose * frame(unit)).inverse() * first;
            let parent_pivot = (parent_pose * frame(parent)).inverse() * first;
            let (near, far) = (pivot.cast(), parent_pivot.cast());
            if is_held {
                pivots.push(Pivot {
                    unit,
                    parent,
                    pivot: near,
                    parent_pivot: far,
                    residual_m: 0.0,
                });
            }
            let moving: Vec<&RobotJoint> =
                chain.iter().copied().filter(|joint| joint.kind != JointKind::Fixed).collect();
            let kind = match moving[..] {
                [] => Some(Held::Fixed),
                [joint] => {
                    let own = (own_pose * frame(unit)).rotation.inverse();
                    let turn = poses.get(joint.child).map(|pose| own * pose.rotation);
                    held_kind(
                        joint,
                        turn.unwrap_or_default(),
                        self.position_of(joint, positions).unwrap_or(joint.reference),
                    )
                }
                _ => is_held.then_some(Held::Ball),
            };
            match kind {
                Some(kind) => {
                    held.push(HeldJoint { unit, parent, pivot: near, parent_pivot: far, kind })
                }
                None if chain.iter().any(|joint| joint.kind == JointKind::Free) => {}
                None => notes.push(format!(
                    "{} moves against {} in several ways: it is not joined",
                    name(link),
                    name(parent_link)
                )),
            }
            let single = match chain[..] {
                [joint] => Some(joint),
                _ => None,
            };
            let axis = single.and_then(|joint| joint.kind.axis());
            rows.push(json!({
                "name": single.map(|joint| &joint.name),
                "kind": single.map_or("chain", |joint| joint.kind.name()),
                "unit": unit,
                "parent": parent,
                "pivot": kind.is_some().then(|| <[f64; 3]>::from(pivot)),
                "parent_pivot": kind.is_some().then(|| <[f64; 3]>::from(parent_pivot)),
                "axis": axis.map(|axis| <[f64; 3]>::from(frame(unit).rotation.inverse() * axis.into_inner())),
                "limits": single.and_then(|joint| joint.limits()),
            }));
        }
        (pivots, held, Value::Array(rows))
    }
}

/// What a simulator holds of a joint: `turn` takes the child's frame to the unit's, `position` is where it is. `None`: it moves freely.
fn held_kind(joint: &RobotJoint, turn: UnitQuaternion<f64>, position: f64) -> Option<Held> {
    let axis = |axis: UnitVector3<f64>, limits: Option<[f64; 2]>, most: f64| {
        let axis = JointAxis::new((turn * axis.into_inner()).cast());
        let limits = limits.map(|limits| limits.map(|limit| limit - position));
        // A joint that turns further than a simulator tells apart has no ends there.
        match limits.filter(|[least, greatest]| *least >= -most && *greatest <= most) {
            Some([least, greatest]) => axis.limits(least as f32, greatest as f32),
            None => axis,
        }
    };
    let turns = f64::from(std::f32::consts::PI);
    match joint.kind {
        JointKind::Fixed => Some(Held::Fixed),
        JointKind::Ball => Some(Held::Ball),
        JointKind::Revolute { axis: along, limits } => {
            Some(Held::Revolute(axis(along, Some(limits), turns)))
        }
        JointKind::Continuous { axis: along } => Some(Held::Revolute(axis(along, None, turns))),
        JointKind::Prismatic { axis: along, limits } => {
            Some(Held::Prismatic(axis(along, limits, f64::from(MOST_M))))
        }
        JointKind::Free => None,
    }
}

/// A scene's units while they are made.
struct Made<'r> {
    options: &'r SceneOptions,
    units: Vec<RecordedUnit>,
    links: Vec<usize>,
    frames: Vec<Isometry3<f64>>,
    notes: Vec<String>,
}

impl Made<'_> {
    fn add(
        &mut self,
        number: usize,
        link: &Link,
        (is_static, body): (bool, Option<u16>),
        pose: &Isometry3<f64>,
    ) {
        let mass_kg = link.inertia.mass_kg;
        let has_mass = is_static || mass_kg >= LEAST_KG;
        if link.surface.triangles.is_empty() || !has_mass {
            // The world, and frames without either, are what files mean.
            if mass_kg > 0.0 {
                self.notes.push(format!(
                    "{} has a mass of {mass_kg} kg and no shape: it is no unit",
                    link.name
                ));
            } else if !link.surface.triangles.is_empty() {
                self.notes.push(format!("{} has a shape and no mass: it is no unit", link.name));
            }
            return;
        }
        let (frame, moments) = match self.options.principal_frames {
            true => principal(&link.inertia.about_centre),
            false => (UnitQuaternion::identity(), link.inertia.about_centre.diagonal().into()),
        };
        let frame = Isometry3::from_parts(Translation3::identity(), frame);
        let back = frame.inverse().cast::<f32>();
        let points: Vec<Point3<f32>> = sample::points(&link.surface, self.options.points)
            .iter()
            .map(|point| back * point)
            .collect();
        if points.len() < 4 {
            self.notes.push(format!("{} has fewer than 4 points: it is no unit", link.name));
            return;
        }
        let physics = Physics {
            mass_kg: if is_static { STATIC_KG } else { mass_kg as f32 },
            friction: link.friction.map_or(self.options.friction, |friction| friction as f32),
            restitution: self.options.restitution,
        };
        let here = (pose * frame).cast::<f32>();
        // Rotations in f32 keep the length of 1 that files ask for.
        let here = Isometry3::from_parts(
            here.translation,
            UnitQuaternion::new_normalize(here.rotation.into_inner()),
        );
        let mut unit = RecordedUnit::new(&link.name, points, physics, vec![here; 2]);
        if let Some(body) = body {
            unit = unit.with_body(body);
        }
        if is_static {
            unit = unit.with_role(Role::Fixed);
        } else if let Some(moments) = sound(moments) {
            unit = unit.with_inertia(moments);
        } else {
            self.notes
                .push(format!("{} has no moments of inertia: those of a box count", link.name));
        }
        if link.pieces.len() > 1 {
            let solid = link.pieces.iter().filter(|piece| ConvexHull::new(piece).is_some());
            let moved = solid.map(|piece| piece.iter().map(|point| back * point).collect());
            let pieces: Vec<Vec<Point3<f32>>> = moved.take(MOST_MERGED).collect();
            if link.pieces.len() > MOST_MERGED {
                self.notes.push(format!(
                    "{} has {} pieces: the first {MOST_MERGED} count",
                    link.name,
                    link.pieces.len()
                ));
            }
            let pieces = ConvexPieces::merged(pieces, MAX_PIECES).thinned(PIECE_POINTS);
            unit = unit.with_pieces(pieces);
        }
        self.units.push(unit);
        self.links.push(number);
        self.frames.push(frame);
    }
}

/// Principal axes, right-handed, and the moments about them.
fn principal(inertia: &Matrix3<f64>) -> (UnitQuaternion<f64>, [f64; 3]) {
    // Nothing is turned that has its axes already.
    let off = (inertia - Matrix3::from_diagonal(&inertia.diagonal())).amax();
    if off <= 1e-9 * inertia.amax() {
        return (UnitQuaternion::identity(), inertia.diagonal().into());
    }
    let parted = SymmetricEigen::new(*inertia);
    let mut axes = parted.eigenvectors;
    if axes.determinant() < 0.0 {
        axes.column_mut(2).neg_mut();
    }
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    (turn, parted.eigenvalues.into())
}

/// Moments as a scene takes them: each above 0, and at most the sum of the others, which rounding may exceed.
fn sound(moments: [f64; 3]) -> Option<[f32; 3]> {
    let [x, y, z] = moments;
    let greatest = x.max(y).max(z);
    let rest = x + y + z - greatest;
    let least = x.min(y).min(z);
    (least >= 1e-18 && greatest <= 1.001 * rest).then(|| moments.map(|moment| moment as f32))
}

impl RobotScene {
    /// The bytes of its scene file; errors name `path`. Metadata `robot_joints` has the joints between units (evaluation/SCENES.md).
    ///
    /// # Errors
    /// None for scenes that were made.
    pub fn file(&self, path: &Path, notes: &SceneNotes) -> Result<Vec<u8>, RobotError> {
        let fail = |problem: String| RobotError::Scene { robot: self.scene.name().into(), problem };
        let bytes =
            scene_file(path, &self.scene, notes).map_err(|error| fail(error.to_string()))?;
        let broken = || fail("its file has no header".into());
        let (length, rest) = bytes.split_first_chunk::<8>().ok_or_else(broken)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| broken())?;
        let (header, payload) = rest.split_at_checked(length).ok_or_else(broken)?;
        let mut header: Value = serde_json::from_slice(header).map_err(|_| broken())?;
        let metadata =
            header.get_mut("__metadata__").and_then(Value::as_object_mut).ok_or_else(broken)?;
        metadata.insert("robot_joints".into(), self.joints.to_string().into());
        let mut header = header.to_string();
        // Offsets count from the payload, and eight bytes align its first tensor.
        while !header.len().is_multiple_of(8) {
            header.push(' ');
        }
        let mut file = (header.len() as u64).to_le_bytes().to_vec();
        file.extend(header.as_bytes());
        file.extend(payload);
        Ok(file)
    }
}
