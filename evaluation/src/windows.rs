//! What the network sees in single steps of recorded scenes, and where these steps end without it: what training learns from.

use nalgebra::Isometry3;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{Layer, Trace, Uncorrected};
use rigidformer_runtime::engine::Engine;
use rigidformer_runtime::models::LoadedModel;

use crate::rollout::{Replay, RolloutError};
use crate::scenes::RecordedScene;

/// A step of a recorded scene, from its frame `first + step` to `first + 2 * step`; `first` and `first + step` are observed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// The first observed frame.
    pub first: u32,
    /// Frames of the step.
    pub step: u32,
}

/// What a window observes in place of the record: poses of all units, a step before and then.
pub type Start = [Vec<Isometry3<f32>>; 2];

/// A unit as the network sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Its number in the scene.
    pub unit: usize,
    /// (points, features) Normalised inputs of its points, in the model's order: each farthest from those before.
    pub features: Vec<f32>,
    /// (impacts, impact features) Normalised inputs of its impacts.
    pub impacts: Vec<f32>,
    /// Where the step ends without the network.
    pub uncorrected: Uncorrected,
}

/// Keeps the inputs of the network.
#[derive(Default)]
struct Inputs {
    /// (units) Of points, and of impacts.
    units: Vec<(Vec<f32>, Vec<f32>)>,
}

impl Trace for Inputs {
    fn record(&mut self, layer: Layer, index: usize, values: &[f32]) {
        let Some((features, impacts)) = self.units.get_mut(index) else { return };
        match layer {
            Layer::Features => features.extend(values),
            Layer::Impacts => impacts.extend(values),
            _ => {}
        }
    }
}

/// The units that the network sees in each window, in order, as the model does that is given: its configuration and its
/// normalisation count, its other weights do not. The scene began at frame 0 of the record. A step that the model takes in substeps has
/// the inputs of all of them, one after another. `starts` has what each window observes; empty: its two frames of the record. Between
/// these a unit may have met something, and a start can say how fast it is afterwards.
///
/// ```
/// use nalgebra::{Isometry3, Point3, Vector3};
/// use rigidformer_core::Physics;
/// use rigidformer_evaluation::scenes::{RecordedScene, RecordedUnit, Split};
/// use rigidformer_evaluation::windows::{Window, network_inputs};
/// use rigidformer_runtime::engine::Engine;
/// use rigidformer_runtime::models::LoadedModel;
///
/// let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
/// // Usually from `Dataset::open(path)?.scene(index, None)?`.
/// let fall = |frame| Isometry3::translation(0.0, 0.0, 0.4 - 5.0 * (frame as f32 / 240.0).powi(2));
/// let corner = |i: i32| [1, 2, 4].map(|bit| if i & bit == 0 { -0.2 } else { 0.2 });
/// let points = (0..8).map(|i| Point3::from(corner(i))).collect();
/// let rubber = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.9 };
/// let unit = RecordedUnit::new("cube", points, rubber, (0..=60).map(fall).collect());
/// let scene = RecordedScene::new("drop", 1, Split::Train, 240.0, Vector3::new(0.0, 0.0, -10.0), vec![unit])?;
///
/// let windows = [Window { first: 0, step: 10 }, Window { first: 35, step: 10 }];
/// let seen = network_inputs(Engine::new()?, &model, &scene, &windows, &[])?;
/// // In the second window the cube meets the ground.
/// let touched = |window: usize| seen[window].iter().any(|unit| unit.uncorrected.share_m_s > 0.0);
/// assert!(!touched(0) && touched(1));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`RolloutError`] where the model cannot move the scene's units, or a frame is not recorded.
pub fn network_inputs(
    engine: Engine,
    model: &LoadedModel,
    scene: &RecordedScene,
    windows: &[Window],
    starts: &[Start],
) -> Result<Vec<Vec<Seen>>, RolloutError> {
    let mut replay = Replay::new(engine, model, scene)?;
    let run = || {
        replay.observe(1, 1)?;
        let mut one = |(number, window): (usize, &Window)| {
            of_window(&mut replay, scene, *window, starts.get(number))
        };
        windows.iter().enumerate().map(&mut one).collect()
    };
    engine.enter(|| in_own_environment(run))
}

fn of_window(
    replay: &mut Replay<'_>,
    scene: &RecordedScene,
    Window { first, step }: Window,
    start: Option<&Start>,
) -> Result<Vec<Seen>, RolloutError> {
    let now = first.saturating_add(step);
    match start {
        Some(start) => replay.go_as(step, now, start)?,
        None => replay.go_to(step, now)?,
    }
    replay.command(now, step)?;
    let mut inputs = Inputs { units: vec![Default::default(); scene.units().len()] };
    let frame = now.saturating_add(step);
    let done = replay.world.step_traced(&mut inputs);
    done.map_err(|source| RolloutError::Step { scene: scene.name().to_owned(), frame, source })?;
    let simulator = replay.world.simulator();
    let units = simulator.units().zip(inputs.units).enumerate();
    Ok(units
        .filter(|(_, (_, (features, _)))| !features.is_empty())
        .filter_map(|(unit, (view, (features, impacts)))| {
            let uncorrected = simulator.uncorrected(view.id())?;
            Some(Seen { unit, features, impacts, uncorrected })
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Point3, Vector3};
    use rigidformer_core::{Compliance, Physics};

    use super::*;
    use crate::scenes::{RecordedUnit, Split};

    /// Two cubes; one falls onto the other, as a record has it that knows no contact. Smaller ones would take a step in two substeps.
    fn scene() -> RecordedScene {
        let corner = |i: i32| [1, 2, 4].map(|bit| if i & bit == 0 { -0.2 } else { 0.2 });
        let points: Vec<_> = (0..8).map(|i| Point3::from(corner(i))).collect();
        let rubber = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
        let unit = |name, pose: &dyn Fn(i32) -> Isometry3<f32>| {
            RecordedUnit::new(name, points.clone(), rubber, (0..=60).map(pose).collect())
        };
        let fall =
            |frame| Isometry3::translation(0.02, 0.0, 0.8 - 5.0 * (frame as f32 / 240.0).powi(2));
        let rest = |_| Isometry3::translation(0.0, 0.0, 0.2);
        let units = vec![unit("falls", &fall), unit("rests", &rest)];
        let gravity = Vector3::new(0.0, 0.0, -10.0);
        RecordedScene::new("drop", 1, Split::Train, 240.0, gravity, units).unwrap()
    }

    #[test]
    fn windows_are_steps_of_the_record() {
        let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
        let (scene, engine) = (scene(), Engine::new().unwrap());
        let windows: Vec<_> = (0..40).map(|first| Window { first, step: 10 }).collect();
        let all = network_inputs(engine, &model, &scene, &windows, &[]).unwrap();
        let touched = all.iter().flatten().filter(|seen| seen.uncorrected.share_m_s > 0.0).count();
        assert!(touched > 5, "{touched}");
        let config = model.model().config();
        for (window, seen) in windows.iter().zip(&all) {
            // By itself a window is what it is among others.
            let alone = network_inputs(engine, &model, &scene, &[*window], &[]).unwrap();
            assert_eq!(&alone[0], seen);
            for Seen { features, impacts, uncorrected, .. } in seen {
                assert_eq!(features.len(), 8 * config.features.len());
                assert_eq!(impacts.len() % rigidformer_weights::IMPACT_FEATURES, 0);
                assert!(features.iter().chain(impacts).all(|v| v.is_finite()));
                assert!(uncorrected.share_m_s.is_finite());
            }
        }
        let beyond = [Window { first: 100_000, step: 1 }];
        let refused = network_inputs(engine, &model, &scene, &beyond, &[]);
        assert!(matches!(refused, Err(RolloutError::TooFewFrames { .. })));
    }

    /// What a step ends at without the network is what it ends at with the network left out.
    fn ends_where_it_says(scene: &RecordedScene) {
        let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
        let engine = Engine::new().unwrap();
        let windows: Vec<_> = (30..40).map(|first| Window { first, step: 10 }).collect();
        let mut touched = 0;
        for (window, seen) in
            windows.iter().zip(network_inputs(engine, &model, scene, &windows, &[]).unwrap())
        {
            let mut replay = Replay::new(engine, &model, scene).unwrap();
            replay.observe(10, window.first + 10).unwrap();
            replay.world.set_network(false);
            replay.world.step().unwrap();
            for seen in &seen {
                touched += usize::from(seen.uncorrected.share_m_s > 0.0);
                let unit = replay.world.simulator().units().nth(seen.unit).unwrap();
                let found = unit.internal_pose();
                let way = found.centre - seen.uncorrected.centre.coords.map(|v| v as f32);
                // What overlaps in the end is moved apart afterwards.
                assert!(way.norm() < 1e-3, "{way}");
                assert!((found.rotation - seen.uncorrected.rotation).norm() < 1e-5);
                let speed = replay.world.simulator().velocity(unit.id()).unwrap().linear_m_s;
                // A way is that of half a step before, as that between two poses is.
                let later = scene.gravity_m_s2() / 48.0;
                let says = seen.uncorrected.way_m * 24.0 + later;
                assert!((speed - says).norm() < 1e-3, "{speed} {says}");
            }
        }
        assert!(touched > 5, "{touched}");
    }

    #[test]
    fn without_the_network_a_step_ends_where_it_says() {
        ends_where_it_says(&scene());
    }

    #[test]
    fn so_does_one_with_springs() {
        let (given, compliance) =
            (scene(), Compliance { stiffness_n_m: 2e3, dissipation_s_m: 2.0 });
        let units = given.units().iter().map(|unit| unit.clone().with_compliance(compliance));
        let gravity = given.gravity_m_s2();
        let soft = RecordedScene::new("soft", 1, Split::Train, 240.0, gravity, units.collect());
        let soft = soft.unwrap();
        ends_where_it_says(&soft);
        let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
        let (engine, windows) = (Engine::new().unwrap(), [Window { first: 35, step: 10 }]);
        let [rigid, soft] = [&given, &soft]
            .map(|scene| network_inputs(engine, &model, scene, &windows, &[]).unwrap());
        // The springs' motion is another one, and so is what it changes.
        assert!((rigid[0][0].uncorrected.centre - soft[0][0].uncorrected.centre).norm() > 1e-3);
        assert!(rigid[0][0].uncorrected.share_m_s != soft[0][0].uncorrected.share_m_s);
    }

    #[test]
    fn a_window_starts_as_it_is_told() {
        let model = LoadedModel::embedded("edge", rigidformer_weights::EDGE).unwrap();
        let (scene, engine) = (scene(), Engine::new().unwrap());
        let windows = [Window { first: 30, step: 10 }];
        let told = [scene.poses_at(30).unwrap(), scene.poses_at(40).unwrap()];
        let recorded = network_inputs(engine, &model, &scene, &windows, &[]).unwrap();
        let same =
            network_inputs(engine, &model, &scene, &windows, std::slice::from_ref(&told)).unwrap();
        assert_eq!(recorded, same);
        let mut faster = told;
        faster[0][0].translation.z += 0.01;
        let other = network_inputs(engine, &model, &scene, &windows, &[faster]).unwrap();
        // It falls faster, by 0.24 m/s, and leaves otherwise.
        let change = (other[0][0].uncorrected.way_m - recorded[0][0].uncorrected.way_m).norm();
        assert!(change > 1e-3, "{change}");
    }
}
