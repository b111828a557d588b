//! The harness: a float and a quantised model over the same scenes.

use std::path::PathBuf;

use rayon::prelude::*;
use rigidformer_evaluation::figures::{FRAMES, GREATEST_STEP, LAST_FRAME};
use rigidformer_evaluation::metrics::{FrameErrors, frame_errors, mean, rigidity};
use rigidformer_evaluation::predicted::{Predicted, predict_many, recorded};
use rigidformer_evaluation::rollout::RolloutError;
use rigidformer_evaluation::scenes::{RecordedScene, SceneError};
use rigidformer_evaluation::soft::vertex_error_m;
use rigidformer_runtime::core::ContactLaw;
use rigidformer_runtime::core::weights::{DType, ModelConfig};
use rigidformer_runtime::models::{LoadedModel, ModelError};
use rigidformer_runtime::progress::Progress;

use crate::drift;
use crate::one_step::{self, Sums};
use crate::pair::Pair;
use crate::report::{Difference, MetricChange, ModelSummary, PointChange, Report, StepFigures};

/// What is looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// Step codes, each from 1 to [`GREATEST_STEP`].
    pub steps: Vec<u32>,
    /// Frames between the recorded states that single steps start from.
    pub state_every: u32,
}

impl Default for Options {
    /// Steps 5 and 10, a state every 10 frames.
    fn default() -> Self {
        Options { steps: vec![5, 10], state_every: 10 }
    }
}

impl Options {
    /// Calls of [`Progress::stepped`] that a check of so many scenes makes.
    pub fn calls(&self, scenes: usize) -> u64 {
        let of = |step: &u32| {
            // Two models roll out, and neither predicts the step that is observed.
            let rollouts = 2 * u64::from(LAST_FRAME.div_ceil((*step).max(1)).saturating_sub(1));
            rollouts + one_step::frames(*step, self.state_every).count() as u64
        };
        self.steps.iter().map(of).sum::<u64>() * scenes as u64
    }
}

/// Why nothing was measured. Its text says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckError {
    /// A model cannot be used.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A scene cannot be rolled out.
    #[error(transparent)]
    Rollout(#[from] RolloutError),
    /// A scene cannot be taken as of rigid contact.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The float model is not one.
    #[error("{}: tensor {tensor} is {dtype}; give the f32 model that was quantised, or the f16 one, as the float model", .path.display())]
    NotFloat {
        /// Its file.
        path: PathBuf,
        /// The first tensor that is neither f32 nor f16.
        tensor: String,
        /// Its type.
        dtype: String,
    },
    /// The models are not of the same architecture.
    #[error(
        "{}: configuration: {field} is {quantised}, the float model has {float}; quantise that very model with \
         `rigidformer pack --dtype`", .path.display()
    )]
    Configuration {
        /// File of the quantised model.
        path: PathBuf,
        /// The field.
        field: String,
        /// In the float model.
        float: String,
        /// In the quantised model.
        quantised: String,
    },
    /// There is nothing to look at.
    #[error("{0}; give at least one scene and step codes from 1 to {GREATEST_STEP}")]
    Nothing(&'static str),
}

/// Measures how far `quantised` is from `float`, a model of the same architecture, on scenes with at least 101 frames:
/// rollouts of the first 100 frames, single steps from recorded states, and layers of those steps. Of soft units points are
/// compared, where of rigid ones poses are. Scenes run in
/// parallel; the report does not depend on the threads.
///
/// ```no_run
/// use rigidformer_firmware_sim::{Options, Tolerances, check};
/// use rigidformer_evaluation::scenes::Dataset;
/// use rigidformer_runtime::models::LoadedModel;
/// use rigidformer_runtime::progress::Progress;
/// let float = LoadedModel::open("edge.rfm".as_ref())?;
/// let quantised = LoadedModel::open("edge-i8.rfm".as_ref())?;
/// let scene = Dataset::open("movi-a.safetensors".as_ref())?.scene(0, Some(101))?;
/// let report = check(&float, &quantised, &[scene], &Options::default(), Progress::none())?;
/// for violation in report.verdict(&Tolerances::of(quantised.model())) {
///     println!("{violation}");
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Models with `most_units` leave scenes with a contact law alone: they are compared over rigid contact.
///
/// # Errors
/// [`CheckError`]; a model that differs too much is no error but a [violation](Report::verdict).
pub fn check(
    float: &LoadedModel,
    quantised: &LoadedModel,
    scenes: &[RecordedScene],
    options: &Options,
    progress: Progress<'_>,
) -> Result<Report, CheckError> {
    // A mean over nothing would pass every tolerance.
    if scenes.is_empty() {
        return Err(CheckError::Nothing("there are no scenes"));
    }
    if options.steps.is_empty()
        || options.steps.iter().any(|step| !(1..=GREATEST_STEP).contains(step))
    {
        return Err(CheckError::Nothing("there is no step code, or one out of range"));
    }
    let models = Pair { float, quantised };
    same_architecture(&models)?;
    // Checked before the first rollout, which takes minutes.
    let frames = scenes.iter().find(|scene| scene.frames() <= LAST_FRAME as usize);
    if let Some(scene) = frames {
        let (step, recorded) = (LAST_FRAME, scene.frames());
        let scene = scene.name().into();
        return Err(RolloutError::TooFewFrames { scene, step, recorded }.into());
    }
    // Both models would leave scenes with a contact law alone, and nothing would be compared.
    let rigid: Vec<RecordedScene>;
    let mut scenes = scenes;
    if float.model().config().most_units > 0
        && scenes.iter().any(|scene| !scene.contact_law().is_rigid())
    {
        let each = scenes.iter().cloned().map(|scene| scene.with_contact_law(ContactLaw::RIGID));
        rigid = each.collect::<Result<_, _>>()?;
        scenes = &rigid;
    }
    let mut steps = Vec::with_capacity(options.steps.len());
    let mut layers = Sums::default();
    for step in &options.steps {
        let (figures, sums) = of_step(&models, scenes, *step, options, progress)?;
        steps.push(figures);
        layers.add(&sums);
    }
    Ok(Report {
        float: summary(float),
        quantised: summary(quantised),
        scenes: scenes.len(),
        frame_rate_hz: scenes.first().map_or(240.0, RecordedScene::frame_rate_hz),
        steps,
        layers: layers.layers(),
    })
}

fn of_step(
    models: &Pair<'_>,
    scenes: &[RecordedScene],
    step: u32,
    options: &Options,
    progress: Progress<'_>,
) -> Result<(StepFigures, Sums), CheckError> {
    let float = predict_many(models.float, scenes, step, LAST_FRAME, progress)?;
    let quantised = predict_many(models.quantised, scenes, step, LAST_FRAME, progress)?;
    // Collected in the order of the scenes, so that sums do not depend on the threads.
    let sums: Vec<Result<Sums, RolloutError>> = scenes
        .par_iter()
        .map(|scene| one_step::of_scene(models, scene, step, options.state_every, progress))
        .collect();
    let mut total = Sums::default();
    for sums in sums {
        total.add(&sums?);
    }
    let figures = StepFigures {
        step,
        drift: drift::over_time(scenes, &float, &quantised),
        point_drift: drift::of_points(&float, &quantised),
        point_metrics: point_metrics(scenes, &float, &quantised),
        metrics: metrics(scenes, &float, &quantised),
        float_rigidity: worst_rigidity(scenes, &float),
        quantised_rigidity: worst_rigidity(scenes, &quantised),
        one_step: total.one_step(),
    };
    Ok((figures, total))
}

fn metrics(
    scenes: &[RecordedScene],
    float: &[Predicted],
    quantised: &[Predicted],
) -> Vec<MetricChange> {
    let at = |predicted: &[Predicted], frame| {
        let pairs = predicted.iter().zip(scenes);
        // Every scene and every rollout reaches the last frame, so none is dropped here.
        let errors: Vec<FrameErrors> =
            pairs.filter_map(|(of, scene)| frame_errors(&of.poses, scene, frame)).collect();
        mean(&errors)
    };
    FRAMES
        .into_iter()
        .map(|frame| MetricChange::new(frame, at(float, frame), at(quantised, frame)))
        .collect()
}

/// Errors of soft points; none where no scene has any.
fn point_metrics(
    scenes: &[RecordedScene],
    float: &[Predicted],
    quantised: &[Predicted],
) -> Vec<PointChange> {
    let at = |predicted: &[Predicted], frame: u32| {
        let of = |(of, scene): (&Predicted, &RecordedScene)| {
            let points = of.points.as_ref()?.between(frame)?;
            vertex_error_m(&points, &recorded(scene, frame as usize)?)
        };
        let errors: Vec<f64> = predicted.iter().zip(scenes).filter_map(of).collect();
        // Scenes without soft points have no such figure, rather than 0.
        (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
    };
    let change = |frame| {
        let vertex_m = Difference::new(at(float, frame)?, at(quantised, frame)?);
        Some(PointChange { frame, vertex_m })
    };
    FRAMES.into_iter().filter_map(change).collect()
}

fn worst_rigidity(scenes: &[RecordedScene], predicted: &[Predicted]) -> f64 {
    let pairs = predicted.par_iter().zip(scenes);
    pairs.map(|(of, scene)| rigidity(&of.poses, scene)).reduce(|| 0.0, f64::max)
}

fn same_architecture(models: &Pair<'_>) -> Result<(), CheckError> {
    let Pair { float, quantised } = models;
    // Halves are widened exactly, so they are a reference too: of some models nothing wider is kept.
    let wide = float.model().file().tensors().find(|tensor| tensor.data.dtype() == DType::I8);
    if let Some(tensor) = wide {
        return Err(CheckError::NotFloat {
            path: float.path().into(),
            tensor: tensor.name.into(),
            dtype: tensor.data.dtype().to_string(),
        });
    }
    let fields = |config: &ModelConfig| match serde_json::to_value(config) {
        Ok(serde_json::Value::Object(fields)) => fields,
        _ => serde_json::Map::new(),
    };
    // The serialised configuration leaves these fields out.
    if float.model().config().elastic != quantised.model().config().elastic {
        return Err(CheckError::Configuration {
            path: quantised.path().into(),
            field: "elastic".into(),
            float: format!("{:?}", float.model().config().elastic),
            quantised: format!("{:?}", quantised.model().config().elastic),
        });
    }
    let others = fields(quantised.model().config());
    // Compared field by field, so that the error names the one that differs.
    for (field, value) in fields(float.model().config()) {
        let other = others.get(&field).cloned().unwrap_or_default();
        if other != value {
            return Err(CheckError::Configuration {
                path: quantised.path().into(),
                field,
                float: value.to_string(),
                quantised: other.to_string(),
            });
        }
    }
    Ok(())
}

fn summary(loaded: &LoadedModel) -> ModelSummary {
    let model = loaded.model();
    let mut weights: Vec<String> = Vec::new();
    for dtype in [DType::I8, DType::F16, DType::F32] {
        let of_type = model.file().tensors().filter(|tensor| tensor.data.dtype() == dtype);
        let parameters: u64 = of_type.map(|tensor| tensor.shape.elements()).sum();
        if parameters > 0 {
            weights.push(format!("{parameters} {dtype}"));
        }
    }
    ModelSummary {
        name: model.file().name().into(),
        path: loaded.path().display().to_string(),
        bytes: loaded.len(),
        weights: weights.join(", "),
    }
}
