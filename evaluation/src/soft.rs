//! Rollouts of soft bodies, and how far their points are from where they were recorded.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use rigidformer_core::Role;
use rigidformer_core::geometry::kabsch_f64;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_runtime::models::LoadedModel;
use rigidformer_runtime::progress::Progress;

use crate::predicted::{predict_many, recorded};
use crate::rollout::RolloutError;
use crate::scenes::{RecordedScene, RecordedUnit};

/// Frames, after the last one observed, that tables read.
pub const FRAMES: [u32; 3] = [25, 50, 100];
/// The last of [`FRAMES`].
pub const LAST_FRAME: u32 = 100;

/// What a model of soft bodies is measured beside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Baseline {
    /// Points stay where they were last seen.
    Still,
    /// Points go on at the velocity between the two frames seen.
    ConstantVelocity,
    /// Each patch goes on rigidly: falls, and turns as it did between the two frames seen.
    RigidPatches,
    /// The rigid motion of each body that is nearest to what was recorded, frame by frame. It is told the truth: no model of rigid
    /// bodies can be better.
    BestRigid,
}

impl Baseline {
    /// All of them.
    pub const ALL: [Baseline; 4] =
        [Baseline::Still, Baseline::ConstantVelocity, Baseline::RigidPatches, Baseline::BestRigid];

    /// As tables call it.
    pub fn name(self) -> &'static str {
        match self {
            Baseline::Still => "still",
            Baseline::ConstantVelocity => "constant velocity",
            Baseline::RigidPatches => "rigid patches",
            Baseline::BestRigid => "best rigid motion (told the truth)",
        }
    }

    /// Points of all soft units at a frame, seen at frames 0 and `step`; `None` where frames are not recorded.
    pub fn points(self, scene: &RecordedScene, step: u32, frame: u32) -> Option<Vec<Point3<f32>>> {
        let (before, now) = (recorded(scene, 0)?, recorded(scene, step as usize)?);
        // Time counts in gaps between the two observed frames, because they alone tell the
        // velocity.
        let gaps = (f64::from(frame) - f64::from(step)) / f64::from(step);
        match self {
            Baseline::Still => Some(now),
            Baseline::ConstantVelocity => {
                let advanced = |(a, b): (&Point3<f32>, &Point3<f32>)| b + (b - a) * gaps as f32;
                Some(before.iter().zip(&now).map(advanced).collect())
            }
            Baseline::RigidPatches => {
                let gap_s = f64::from(step) / f64::from(scene.frame_rate_hz());
                let mut all = Vec::new();
                for unit in scene.units() {
                    let Some(frames) = &unit.soft else { continue };
                    // A file may hold any pose of a soft unit, so its motion is fitted to its
                    // points.
                    let (a, b) = (frames.first()?, frames.get(step as usize)?);
                    let origin = Isometry3::identity();
                    let motion = fit(a, b);
                    // The mean of the points falls on a parabola and other points do not, so the
                    // pose is about it.
                    let middle = Point3::from(mean(a));
                    let there =
                        Isometry3::from_parts((motion * middle).coords.into(), motion.rotation);
                    let from = Isometry3::from_parts(middle.coords.into(), origin.rotation);
                    let gravity = scene.gravity_m_s2();
                    let pose =
                        rigidformer_runtime::poses::free_fall(&from, &there, &gravity, gap_s, gaps);
                    all.extend(a.iter().map(|point| pose * (from.inverse() * point)));
                }
                Some(all)
            }
            Baseline::BestRigid => {
                let truth = recorded(scene, frame as usize)?;
                let mut all = truth.clone();
                let mut start = 0;
                let rows: Vec<_> = scene
                    .units()
                    .iter()
                    .enumerate()
                    .filter(|(_, unit)| unit.soft.is_some())
                    .map(|(index, unit)| {
                        let own = start..start + unit.points.len();
                        start = own.end;
                        // A unit without a number is a body of its own. The flag keeps its index
                        // apart from numbers of bodies.
                        (unit.body.map_or((true, index), |body| (false, usize::from(body))), own)
                    })
                    .collect();
                // All patches of a body share one motion: a model of rigid bodies can do no better.
                for (body, _) in &rows {
                    let own: Vec<usize> = rows
                        .iter()
                        .filter(|(b, _)| b == body)
                        .flat_map(|(_, r)| r.clone())
                        .collect();
                    let a: Vec<_> = own.iter().filter_map(|row| now.get(*row).copied()).collect();
                    let b: Vec<_> = own.iter().filter_map(|row| truth.get(*row).copied()).collect();
                    let motion = fit(&a, &b);
                    for (row, point) in own.iter().zip(&a) {
                        if let Some(slot) = all.get_mut(*row) {
                            *slot = motion * point;
                        }
                    }
                }
                Some(all)
            }
        }
    }
}

fn mean(points: &[Point3<f32>]) -> Vector3<f32> {
    // f64 keeps the order of the points out of the mean.
    let sum = points.iter().fold(Vector3::<f64>::zeros(), |sum, p| sum + p.coords.cast::<f64>());
    (sum / points.len().max(1) as f64).cast()
}

/// The rigid motion that carries points nearest to others.
fn fit(from: &[Point3<f32>], to: &[Point3<f32>]) -> Isometry3<f32> {
    let pairs = from.iter().zip(to).map(|(a, b)| (&a.coords, &b.coords));
    // Points on a line leave the turn open, and the identity fills it.
    kabsch_f64(pairs, &Matrix3::identity()).pose.isometry(&Point3::origin())
}

/// Mean distance of points from where they are to be, metres; `None` where they are not as many, or none.
pub fn vertex_error_m(points: &[Point3<f32>], truth: &[Point3<f32>]) -> Option<f64> {
    let distance =
        |(a, b): (&Point3<f32>, &Point3<f32>)| (a.cast::<f64>() - b.cast::<f64>()).norm();
    let count = truth.len();
    // A mean of no points is NaN, which would spread to the mean over scenes.
    (points.len() == count && count > 0).then(|| {
        in_own_environment(|| points.iter().zip(truth).map(distance).sum::<f64>() / count as f64)
    })
}

/// Length of the diagonal of the box around a scene's soft points at rest, metres: what shares are of.
pub fn size_m(scene: &RecordedScene) -> f64 {
    let points = scene.units().iter().filter(|unit| unit.soft.is_some()).flat_map(|u| &u.points);
    in_own_environment(|| {
        let mut low = Vector3::repeat(f64::INFINITY);
        let mut high = -low;
        for point in points {
            let p = point.coords.cast::<f64>();
            (low, high) = (low.inf(&p), high.sup(&p));
        }
        (high - low).norm()
    })
}

/// Errors of a predictor at a frame, means over scenes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexErrors {
    /// Frame after the last one observed.
    pub frame: u32,
    /// Mean distance of the points from where they were recorded, metres.
    pub vertex_m: f64,
    /// That, as a share of the body's [size](size_m).
    pub vertex_share: f64,
    /// Scenes that were recorded to that frame.
    pub scenes: usize,
}

/// What a prediction does to bodies, over all scenes and frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Soundness {
    /// How much longer than at rest 99 % of the edges are, at most, as a share; 0 without edges.
    pub stretch_99: f64,
    /// How much shorter than at rest 99 % of the edges are, at most, as a share; 0 without edges.
    pub shrink_99: f64,
    /// Relative change of the volume of a body that 99 % of samples stay within; 0 without tetrahedra.
    pub volume_99: f64,
    /// Greatest distance of points that were in one place at rest, metres.
    pub tear_m: f64,
    /// How deep 99 % of the points are in a ball that nothing but a command moves, at most; metres, 0 where none is.
    pub ball_depth_99_m: f64,
    /// How deep 99 % of the points are below a plane, at most, metres.
    pub plane_depth_99_m: f64,
}

/// Figures of a predictor over scenes.
#[derive(Clone, Debug, PartialEq)]
pub struct Figures {
    /// At each predicted frame to [`LAST_FRAME`] that a scene reaches.
    pub errors: Vec<VertexErrors>,
    /// What it does to bodies.
    pub soundness: Soundness,
}

/// Rolls out all scenes by a model, on all threads.
///
/// # Errors
/// The first scene's that has one.
pub fn model(
    model: &LoadedModel,
    scenes: &[RecordedScene],
    step: u32,
    progress: Progress<'_>,
) -> Result<Figures, RolloutError> {
    let all = predict_many(model, scenes, step, step.saturating_add(LAST_FRAME), progress)?;
    Ok(figures(scenes, step, |index, frame| {
        all.get(index)?.points.as_ref()?.at(frame).map(<[_]>::to_vec)
    }))
}

/// Figures of a baseline.
pub fn baseline(baseline: Baseline, scenes: &[RecordedScene], step: u32) -> Figures {
    figures(scenes, step, |index, frame| baseline.points(scenes.get(index)?, step, frame))
}

/// Figures of the record itself.
pub fn of_record(scenes: &[RecordedScene], step: u32) -> Figures {
    figures(scenes, step, |index, frame| recorded(scenes.get(index)?, frame as usize))
}

fn figures(
    scenes: &[RecordedScene],
    step: u32,
    points: impl Fn(usize, u32) -> Option<Vec<Point3<f32>>>,
) -> Figures {
    let mut errors = Vec::new();
    // Between multiples of the step a model predicts nothing, so those frames have no error.
    for frame in (step..=LAST_FRAME).step_by(step.max(1) as usize) {
        let (mut metres, mut share, mut count) = (0.0, 0.0, 0usize);
        for (index, scene) in scenes.iter().enumerate() {
            // Tables count frames from the last observed one, records from the first.
            let at = step + frame;
            let (Some(own), Some(truth)) = (points(index, at), recorded(scene, at as usize)) else {
                continue;
            };
            let Some(error) = vertex_error_m(&own, &truth) else { continue };
            metres += error;
            share += error / size_m(scene);
            count += 1;
        }
        if count > 0 {
            let n = count as f64;
            let (vertex_m, vertex_share) = (metres / n, share / n);
            errors.push(VertexErrors { frame, vertex_m, vertex_share, scenes: count });
        }
    }
    let mut probe = SoundnessProbe::default();
    for (index, scene) in scenes.iter().enumerate() {
        // Frames 0 and `step` are observed, so the first prediction is one step later.
        let mut frame = step * 2;
        while frame <= step + LAST_FRAME {
            if let Some(own) = points(index, frame) {
                probe.measure(scene, &own, frame);
            }
            frame += step;
        }
    }
    Figures { errors, soundness: probe.soundness() }
}

/// What [`Soundness`] is worked out from.
#[derive(Default)]
struct SoundnessProbe {
    stretches: Vec<f64>,
    shrinks: Vec<f64>,
    volumes: Vec<f64>,
    balls: Vec<f64>,
    planes: Vec<f64>,
    tear_m: f64,
}

impl SoundnessProbe {
    fn measure(&mut self, scene: &RecordedScene, points: &[Point3<f32>], frame: u32) {
        let rest: Vec<Point3<f64>> = scene
            .units()
            .iter()
            .filter(|unit| unit.soft.is_some())
            .flat_map(|unit| unit.points.iter().map(|point| point.cast()))
            .collect();
        let points: Vec<Point3<f64>> = points.iter().map(|point| point.cast()).collect();
        let mesh = scene.mesh();
        for [a, b] in &mesh.edges {
            let length = |all: &[Point3<f64>]| Some((all.get(*a)? - all.get(*b)?).norm());
            if let (Some(now), Some(once)) = (length(&points), length(&rest)) {
                // Edges that are shorter count as 0, so that both percentiles are over all edges.
                self.stretches.push((now / once - 1.0).max(0.0));
                self.shrinks.push((1.0 - now / once).max(0.0));
            }
        }
        let volume = |all: &[Point3<f64>]| -> f64 {
            let one = |[a, b, c, d]: &[usize; 4]| -> Option<f64> {
                let (a, b, c, d) = (all.get(*a)?, all.get(*b)?, all.get(*c)?, all.get(*d)?);
                Some((b - a).cross(&(c - a)).dot(&(d - a)) / 6.0)
            };
            mesh.tetrahedra.iter().filter_map(one).sum()
        };
        if !mesh.tetrahedra.is_empty() {
            // Tetrahedra are summed first, because a body keeps its volume and a tetrahedron need
            // not.
            self.volumes.push((volume(&points) / volume(&rest) - 1.0).abs());
        }
        // Patches have copies of the points that they share, and those are in one place at rest.
        let mut order: Vec<usize> = (0..rest.len()).collect();
        // Within 0.01 mm two positions are one, because copies are rounded by themselves.
        let key =
            |row: &usize| rest.get(*row).map(|p| [p.x, p.y, p.z].map(|v| (v * 1e5).round() as i64));
        order.sort_by_key(key);
        for pair in order.windows(2) {
            let [a, b] = pair else { continue };
            if let (Some(p), Some(q), true) = (points.get(*a), points.get(*b), key(a) == key(b)) {
                self.tear_m = self.tear_m.max((p - q).norm());
            }
        }
        let is_commanded = |unit: &&RecordedUnit| unit.soft.is_none() && unit.role != Role::Free;
        for unit in scene.units().iter().filter(is_commanded) {
            // Beyond the record a commanded unit stays, as it does in rollouts.
            let Some(pose) = unit.poses.get(frame as usize).or(unit.poses.last()) else { continue };
            let far = |p: &Point3<f32>| p.coords.cast::<f64>().norm();
            let radius = unit.points.iter().map(far).fold(0.0, f64::max);
            let least = unit.points.iter().map(far).fold(f64::INFINITY, f64::min);
            // The depth is exact in balls alone, so units whose points lie on no sphere are left
            // out.
            if least < 0.999 * radius {
                continue;
            }
            let centre = pose.translation.vector.cast::<f64>();
            for point in &points {
                self.balls.push((radius - (point.coords - centre).norm()).max(0.0));
            }
        }
        for plane in scene.planes().unwrap_or_default() {
            let normal = plane.normal.cast::<f64>();
            let depth =
                |p: &Point3<f64>| (f64::from(plane.offset_m) - normal.dot(&p.coords)).max(0.0);
            self.planes.extend(points.iter().map(depth));
        }
    }

    fn soundness(mut self) -> Soundness {
        Soundness {
            stretch_99: at_99(&mut self.stretches),
            shrink_99: at_99(&mut self.shrinks),
            volume_99: at_99(&mut self.volumes),
            tear_m: self.tear_m,
            ball_depth_99_m: at_99(&mut self.balls),
            plane_depth_99_m: at_99(&mut self.planes),
        }
    }
}

/// What 99 % of values are at most.
fn at_99(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (values.len() as f64 * 0.99).ceil() as usize;
    values.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}
