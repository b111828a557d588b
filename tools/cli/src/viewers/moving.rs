//! Units in motion, whichever command they come from.

use std::iter;
use std::ops::Range;

use nalgebra::{Isometry3, Point3};
use rigidformer_core::{Plane, Role, Unit};
use rigidformer_evaluation::rollout::Trajectory;
use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit};
use rigidformer_runtime::hull::ConvexHull;
use rigidformer_runtime::terrain::HeightFieldBuf;

use crate::picture::{Rgb, colour};

/// An instant.
pub struct Frame {
    /// Of the scene or the recording.
    pub time_s: f64,
    /// (units) What is predicted; `None` where a unit is not there.
    pub poses: Vec<Option<Isometry3<f32>>>,
    /// (units) What truly happened; empty where nobody knows.
    pub truth: Vec<Option<Isometry3<f32>>>,
}

/// A unit's looks.
pub struct MovingUnit {
    pub(crate) name: String,
    pub(crate) role: Role,
    pub(crate) colour: Rgb,
    /// In the unit's frame, metres.
    pub(crate) points: Vec<Point3<f32>>,
    /// Corners of `triangles`, metres: the points, or the corners of the convex pieces.
    pub(crate) corners: Vec<Point3<f32>>,
    /// Which corners are those of a convex piece; all of them where a unit has none.
    pub(crate) pieces: Vec<Range<usize>>,
    /// Counter-clockwise seen from outside; none for points without volume.
    pub(crate) triangles: Vec<[usize; 3]>,
    pub(crate) mass_kg: Option<f32>,
    /// Units with the same number are parts of one body.
    pub(crate) body: Option<u16>,
    /// It bends, which viewers do not show.
    pub(crate) is_soft: bool,
}

/// Units in motion: what all viewers get.
pub struct Moving {
    /// Of the scene.
    pub(crate) name: String,
    /// What `poses` of the frames are, such as "predicted by edge".
    pub(crate) poses_are: String,
    /// What their `truth` is.
    pub(crate) truth_is: String,
    pub(crate) planes: Vec<Plane>,
    pub(crate) terrain: Option<HeightFieldBuf>,
    pub(crate) units: Vec<MovingUnit>,
    /// (frames) In the order of time.
    frames: Vec<Frame>,
}

impl MovingUnit {
    /// The unit with this number in its scene.
    pub fn new(number: usize, name: impl Into<String>, unit: &Unit<'_>) -> MovingUnit {
        let hull = ConvexHull::new(unit.points);
        MovingUnit {
            name: name.into(),
            role: unit.role,
            colour: colour(number, unit.role),
            points: unit.points.to_vec(),
            corners: unit.points.to_vec(),
            pieces: iter::once(0..unit.points.len()).collect(),
            triangles: hull.map(|hull| hull.faces().to_vec()).unwrap_or_default(),
            mass_kg: Some(unit.physics.mass_kg),
            body: unit.body,
            is_soft: unit.soft.is_some(),
        }
    }

    /// The units of a scene.
    pub(crate) fn of_scene(scene: &RecordedScene) -> Vec<MovingUnit> {
        let units = scene.units().iter().enumerate();
        units.map(|(number, unit)| MovingUnit::recorded(number, unit)).collect()
    }

    /// A unit of a record: the hull of its points, or its convex pieces.
    fn recorded(number: usize, unit: &RecordedUnit) -> MovingUnit {
        let mut moving = MovingUnit::new(number, unit.shape.as_str(), &unit.as_unit());
        moving.is_soft = unit.soft.is_some();
        if !unit.pieces.is_empty() {
            moving.corners.clear();
            moving.triangles.clear();
            moving.pieces.clear();
            for piece in unit.pieces.iter() {
                let first = moving.corners.len();
                let Some(hull) = ConvexHull::new(piece) else { continue };
                moving.corners.extend_from_slice(piece);
                moving.pieces.push(first..moving.corners.len());
                let faces = hull.faces().iter().map(|face| face.map(|corner| first + corner));
                moving.triangles.extend(faces);
            }
        }
        moving
    }
}

impl Moving {
    /// The units of a scene, so far without motion.
    fn of_scene(scene: &RecordedScene, poses_are: String) -> Moving {
        Moving {
            name: scene.name().into(),
            poses_are,
            truth_is: "recorded".into(),
            planes: scene.planes().unwrap_or_default().to_vec(),
            terrain: scene.height_field().cloned(),
            units: MovingUnit::of_scene(scene),
            frames: Vec::new(),
        }
    }

    /// A rollout of a scene, whose frames are those of the record, beside the record as far as that goes.
    pub(crate) fn of_rollout(
        scene: &RecordedScene,
        poses_are: String,
        rollout: &Trajectory,
    ) -> Moving {
        let rate_hz = f64::from(scene.frame_rate_hz());
        let frames = rollout.iter().map(|(frame, poses)| Frame {
            time_s: f64::from(frame) / rate_hz,
            poses: poses.iter().copied().map(Some).collect(),
            truth: scene
                .poses_at(frame as usize)
                .unwrap_or_default()
                .into_iter()
                .map(Some)
                .collect(),
        });
        Moving::of_scene(scene, poses_are).with(frames)
    }

    /// An open-loop rollout of a scene, whose frames are the model's, so many a second.
    pub(crate) fn of_open_loop(
        scene: &RecordedScene,
        poses_are: String,
        rollout: &Trajectory,
        rate_hz: f64,
    ) -> Moving {
        let frames = rollout.iter().map(|(frame, poses)| {
            let time_s = f64::from(frame) / rate_hz;
            let truth = (0..poses.len()).map(|unit| scene.pose_at(time_s, unit)).collect();
            Frame { time_s, poses: poses.iter().copied().map(Some).collect(), truth }
        });
        Moving::of_scene(scene, poses_are).with(frames)
    }

    /// Units of other origin, so far without motion.
    pub fn new(
        name: impl Into<String>,
        poses_are: impl Into<String>,
        truth_is: impl Into<String>,
        planes: &[Plane],
        units: Vec<MovingUnit>,
    ) -> Moving {
        let (name, planes) = (name.into(), planes.to_vec());
        let (poses_are, truth_is) = (poses_are.into(), truth_is.into());
        Moving { name, poses_are, truth_is, planes, terrain: None, units, frames: Vec::new() }
    }

    /// Adds frames. One that is not later than the one before it, or not finite, is left out: viewers need times that rise.
    pub fn with(mut self, frames: impl IntoIterator<Item = Frame>) -> Moving {
        for mut frame in frames {
            let before = self.frames.last().map_or(f32::NEG_INFINITY, |last| self.seconds(last));
            let time = self.seconds(&frame);
            if time.is_finite() && time > before {
                frame.poses.resize(self.units.len(), None);
                frame.truth.resize(self.units.len(), None);
                self.frames.push(frame);
            }
        }
        self
    }

    pub(crate) fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// Time since the first frame: recordings may count from 1970, which f32 cannot.
    pub(crate) fn seconds(&self, frame: &Frame) -> f32 {
        (frame.time_s - self.frames.first().unwrap_or(frame).time_s) as f32
    }

    /// Whether the truth of a unit is known at a frame.
    pub(crate) fn has_truth(&self) -> bool {
        self.frames.iter().any(|frame| frame.truth.iter().any(Option::is_some))
    }

    /// Unit names with numbers, so that no two are the same.
    pub(crate) fn label(&self, unit: usize) -> String {
        format!("{unit} {}", self.units.get(unit).map_or("", |unit| unit.name.as_str()))
    }

    /// The middle of where units are, and the radius of a sphere around all of them, metres.
    pub(crate) fn extent(&self) -> (Point3<f32>, f32) {
        let of_frame = |frame: &Frame| frame.poses.iter().chain(&frame.truth).copied().collect();
        let poses = self.frames.iter().map(of_frame).collect::<Vec<Vec<Option<_>>>>();
        let places = || poses.iter().flatten().flatten().map(|pose| pose.translation.vector);
        let Some(first) = places().next() else { return (Point3::origin(), 1.0) };
        let (low, high) = places().fold((first, first), |(l, h), p| (l.inf(&p), h.sup(&p)));
        let sizes = self.units.iter().flat_map(|unit| unit.corners.iter().map(|p| p.coords.norm()));
        let radius = (high - low).norm() / 2.0 + sizes.fold(0.0, f32::max);
        (Point3::from((low + high) / 2.0), radius.max(1e-3))
    }
}
