//! The command line.

mod calibrate;
mod import;
mod import_robot;
mod inspect;
mod model;
mod render;
mod split;
mod track;
mod viewers;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use rigidformer_core::ContactLaw;
use rigidformer_evaluation::models::Precision;
use rigidformer_evaluation::scenes::Dataset;

pub(crate) use calibrate::{Calibrate, Contact};
pub(crate) use import::Import;
#[cfg(feature = "import")]
pub(crate) use import::{RepeatsName, UpAxis};
pub(crate) use import_robot::ImportRobot;
pub(crate) use inspect::Inspect;
pub use model::Model;
pub(crate) use render::Render;
pub(crate) use split::SplitName;
#[cfg(feature = "sensors")]
pub(crate) use track::SegmentationName;
pub(crate) use track::Track;
pub use viewers::Viewers;

/// Rigid bodies, predicted: points in, poses out.
#[derive(Parser)]
#[command(name = "rigidformer", version, propagate_version = true)]
#[command(after_help = after_help())]
pub(crate) struct Arguments {
    /// Memory that a scene, a capture, an import, a model or a mesh may take, such as 500M or 4G [default: 1G]
    #[arg(long, global = true, value_name = "BYTES", value_parser = bytes)]
    pub(crate) memory: Option<u64>,
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// Bytes, with K, M or G behind for powers of 1024.
fn bytes(text: &str) -> Result<u64, String> {
    let (digits, factor) = match text.char_indices().next_back() {
        Some((end, 'K' | 'k')) => (&text[..end], 1 << 10),
        Some((end, 'M' | 'm')) => (&text[..end], 1 << 20),
        Some((end, 'G' | 'g')) => (&text[..end], 1 << 30),
        _ => (text, 1_u64),
    };
    let bytes = digits.parse::<u64>().ok().and_then(|number| number.checked_mul(factor));
    bytes.filter(|bytes| *bytes > 0).ok_or_else(|| "is no number of bytes, such as 4G".into())
}

/// Exit codes, and what this build only refuses.
fn after_help() -> String {
    let with_features = [
        ("calibrate", cfg!(feature = "calibrate")),
        ("identify", cfg!(feature = "identify")),
        ("import", cfg!(feature = "import")),
        ("import-robot", cfg!(feature = "robots")),
        ("pieces", cfg!(feature = "pieces")),
        ("render", cfg!(feature = "sensors")),
        ("track", cfg!(feature = "sensors")),
        ("--contact", cfg!(feature = "calibrate")),
        ("--gltf", cfg!(feature = "viewers")),
        ("--html", cfg!(feature = "viewers")),
        ("--mcap", cfg!(feature = "viewers")),
        ("pack --provenance", cfg!(feature = "provenance")),
    ];
    let lacking: Vec<&str> =
        with_features.iter().filter(|(_, is_there)| !is_there).map(|(what, _)| *what).collect();
    let codes = "Exit codes: 0 done, 1 failed, 2 wrong usage, 130 interrupted.";
    match lacking[..] {
        [] => codes.into(),
        _ => format!("Only a build with `--features full` has: {}.\n\n{codes}", lacking.join(", ")),
    }
}

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Predict one recorded scene; compare with the record and with free fall; draw both
    Rollout(Rollout),
    /// Measure a model on a split of a data set, beside free fall and the published figures
    Evaluate(Evaluate),
    /// Describe a model or a scene file; count the units that are unlike what a model's training saw
    Inspect(Inspect),
    /// Turn a model exported by the lab into a packed model, or a packed model into a C header
    Pack(Pack),
    /// Find the convex pieces that a hollow unit touches with, from a mesh
    Pieces(Pieces),
    /// Compare a quantised model with its float model, and say whether it is within tolerances
    Check(Check),
    /// Make a scene file of your own recorded poses (CSV, npz), to train on and to measure by
    Import(Box<Import>),
    /// Make a scene file of a robot (URDF, MJCF) or of a folder of meshes
    ImportRobot(Box<ImportRobot>),
    /// Find friction, restitution and mass ratios of units from how they moved
    Identify(Identify),
    /// Fit contact's numbers to many recorded scenes: friction, restitution, table, inertia
    Calibrate(Calibrate),
    /// Record what depth cameras would see of a scene, with their noise
    Render(Render),
    /// Follow the units of a recording of depth cameras or scanners, and predict them
    Track(Track),
    /// Keep every layer of a few steps in a file, to compare it with another target's
    Trace(Trace),
    /// Compare two traces bit by bit and name the first difference
    Diff(Diff),
}

#[derive(Args)]
#[command(after_help = "\
Writes into DIR:
  poses.csv   frame, time, unit, predicted pose, recorded pose (the first two frames are observed)
  errors.png  position and orientation error over time, the model's and free fall's
  strip.png   predicted and recorded units at four instants, or at the frames of --show

Of a scene with soft units or bonds it writes predicted.safetensors too, the prediction as a scene file: poses, soft points and bonds
at the predicted frames. Errors of a scene with soft units are those of their points. A soft unit needs a model of soft bodies, such as
shell.rfm; strip.png draws the triangles that the file has (faces). Units that bonds hold together have one colour in strip.png.

With --command nothing is recorded to compare with: the prediction may go on beyond the record (300 frames unless told
otherwise), and DIR gets poses.csv and walk.png. A robot's pace is that of its heaviest part, in its heading.

Examples:
  rigidformer rollout
  rigidformer rollout g1-test.safetensors --model g1.rfm --command 0.5,0,0.3 --out walk
  rigidformer rollout movi-b.safetensors --index 71 --step 5 --frames 100 --out b72
  rigidformer rollout shell-test.safetensors --model shell.rfm --show 20,45,70,100
  rigidformer rollout wrecking-64.safetensors --step 8 --frames 200 --show 50,100,200
  rigidformer rollout --html scene.html --gltf scene.glb --mcap scene.mcap
  rigidformer rollout --model edge.rfm --step 1")]
pub(crate) struct Rollout {
    /// Scene file [default: a scene that comes with the program]
    pub(crate) scene: Option<PathBuf>,
    /// Which scene of the file, from 0 [default: its first of the test split, else its first]
    #[arg(long, value_name = "I")]
    pub(crate) index: Option<usize>,
    #[command(flatten)]
    pub(crate) model: Model,
    #[command(flatten)]
    pub(crate) contact: Contact,
    /// Frames of the record between two predictions; frames 0 and S are observed [default: 10; 5 with soft units or bonds]
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) step: Option<u32>,
    /// Last frame to predict [default: the last recorded one, at most 120]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) frames: Option<u32>,
    /// Hold the parts of each body together at pivots that are found from frames 0 to S
    #[arg(long)]
    pub(crate) join: bool,
    /// Frames that strip.png shows, with commas between, at most 8; between predicted frames poses are interpolated
    /// [default: four, evenly spaced]
    #[arg(long, value_name = "F", value_delimiter = ',')]
    pub(crate) show: Vec<u32>,
    /// Drive a robot: the command that holds from frame S on, numbers with commas between, instead of the recorded ones
    #[arg(long, value_name = "C", value_delimiter = ',', allow_hyphen_values = true)]
    pub(crate) command: Vec<f32>,
    /// Folder for the results, made if need be
    #[arg(long, value_name = "DIR", default_value = "rollout")]
    pub(crate) out: PathBuf,
    #[command(flatten)]
    pub(crate) viewers: Viewers,
}

#[derive(Args)]
#[command(after_help = "\
Errors are those of HopNet's protocol: per scene and frame the root mean square over units, then the mean over scenes.
Only every S-th frame is predicted. Where frame 50, 75 or 100 is none of them, its poses are interpolated between the two
beside it: with step 8, frame 50 between 48 and 56.

A file with the velocities of its units at frame 0 (unit_velocity), such as the recorded cube tosses, is rolled out in open
loop from that frame's poses and velocities to the last recorded frame, whatever the number of frames. Errors are means over all
frames after frame 0, then over scenes. A step code is a number of the model's native frames there (s/240 s), and predictions are
interpolated at the file's frames. --picture draws the toss with the median position error at the first step code: of all
tosses in the order of that error, number n / 2, rounded up. It is shown at eight evenly spaced times, the last one the end.

A file with commands holds robots. Their errors go to frame 300, or as far as the record, beside those of parts that keep
their velocity and of a body that is carried on rigidly.

Examples:
  rigidformer evaluate cube-tosses.safetensors --steps 2 --picture toss.png
  rigidformer evaluate cube-tosses.safetensors --steps 2 --contact contact.toml --without-network
  rigidformer evaluate movi-a.safetensors --contact-law 0.03,pyramid
  rigidformer evaluate g1-test.safetensors --model g1.rfm --neighbours g1.safetensors
  rigidformer evaluate wrecking-216.safetensors --steps 8
  rigidformer evaluate movi-a.safetensors
  rigidformer evaluate movi-sphere.safetensors --model edge.rfm --steps 10 --limit 12
  rigidformer evaluate movi-b.safetensors --split validation --json > b.json
  rigidformer evaluate movi-a.safetensors --steps 10 --index 3 --html a3.html
  rigidformer evaluate movi-a.safetensors --picture a.png")]
pub(crate) struct Evaluate {
    /// Scene file with at least 101 frames, or with unit_velocity
    pub(crate) dataset: PathBuf,
    /// Which scenes
    #[arg(long, value_enum, default_value_t = SplitName::Test)]
    pub(crate) split: SplitName,
    #[command(flatten)]
    pub(crate) model: Model,
    /// Impulses alone: the model's motion without what its network corrects
    #[arg(long, visible_alias = "no-network")]
    pub(crate) without_network: bool,
    #[command(flatten)]
    pub(crate) contact: Contact,
    /// How contacts that bounce differ from rigid ones, in place of what the file says: what is added to restitutions, 0 to 1, and a
    /// pyramid of friction in place of the cone. PyBullet's is 0.03,pyramid, that of rigid contact 0 (docs/CONTACT.md); of models that
    /// move units by impulses. edge and nano leave scenes with another law than rigid contact to impulses alone
    #[arg(long, value_name = "OFFSET[,pyramid]")]
    pub(crate) contact_law: Option<ContactLaw>,
    /// Step codes, with commas between [default: 1,5,10; of robots 10]
    #[arg(long, value_name = "S", value_delimiter = ',')]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=100))]
    pub(crate) steps: Vec<u32>,
    /// Of robots: also what three recorded walks that began alike went on to do, from the training split of this scene file
    #[arg(long, value_name = "FILE")]
    pub(crate) neighbours: Option<PathBuf>,
    /// Only the first N scenes of the split
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) limit: Option<u32>,
    /// Hold the parts of each body together at pivots that are found from frames 0 to S; of a file with unit_velocity from
    /// frames 0 to 10
    #[arg(long)]
    pub(crate) join: bool,
    /// Also draws the errors against time, beside the published ones; of tosses the one with the median error
    #[arg(long, value_name = "FILE.png")]
    pub(crate) picture: Option<PathBuf>,
    /// Scene of the file that --mcap, --gltf and --html show, from 0 [default: the first that is evaluated]
    #[arg(long, value_name = "I")]
    pub(crate) index: Option<usize>,
    #[command(flatten)]
    pub(crate) viewers: Viewers,
    /// Print one JSON document instead of tables
    #[arg(long)]
    pub(crate) json: bool,
}

/// Step codes of the published tables.
pub(crate) const STEPS: [u32; 3] = [1, 5, 10];

/// Step code of a rollout where none is given.
const USUAL_STEP: u32 = 10;
/// The same of soft bodies and of units with bonds, whose models learnt this one.
const SOFT_STEP: u32 = 5;

/// The step code that suits the data.
pub(crate) fn usual_step(dataset: &Dataset) -> u32 {
    let is_quick = dataset.soft_units() > 0 || dataset.bonds().0 > 0;
    if is_quick { SOFT_STEP } else { USUAL_STEP }
}

impl Rollout {
    /// The step code, or that of the data where none is given.
    pub(crate) fn step_for(&self, dataset: &Dataset) -> u32 {
        self.step.unwrap_or_else(|| usual_step(dataset))
    }
}

impl Evaluate {
    /// The step codes, or those of the data where none are given.
    pub(crate) fn steps_or<'s>(&'s self, usual: &'s [u32]) -> &'s [u32] {
        if self.steps.is_empty() { usual } else { &self.steps }
    }
}

#[derive(Args)]
#[command(after_help = "\
A ring, a cup or a table is hollow: others reach into it. A unit that is given convex pieces touches with those instead of
the hull of its points. Meshes of simulators often are groups of convex pieces already. V-HACD splits others: each closed
part on its own. Pairs of pieces are then merged, the pair first that gains the least volume. Fewer pieces are faster.

A JSON document has `pieces`: (pieces, points, 3) in metres; `closed`; `volume_m3`, `centre_of_mass_m` and `inertia_m5`, the
matrix of inertia about it, which times a density in kg/m3 is in kg m2. They are those of the pieces where the mesh is not
closed. Rust and C are constants for firmware. What was found is said on stderr.

Examples:
  rigidformer pieces torus.obj --most 12
  rigidformer pieces link_mm.stl --scale 0.001
  rigidformer pieces cup.obj --split vhacd --resolution 128 --out cup.json
  rigidformer pieces gripper_mm.obj --scale 0.001 --most 4 --points 16 --format rust --out src/gripper.rs
  rigidformer pieces table.obj --format c --out table.h")]
pub(crate) struct Pieces {
    /// OBJ, STL or COLLADA (.dae) file: closed meshes, or groups (o or g) that are closed and convex
    #[arg(value_name = "MESH")]
    pub(crate) mesh: PathBuf,
    /// Pieces, at most
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u8).range(1..=32))]
    pub(crate) most: u8,
    /// Points of a piece, at most: those that lie farthest from each other are kept
    #[arg(long, value_name = "N", default_value_t = 255, value_parser = clap::value_parser!(u8).range(4..))]
    pub(crate) points: u8,
    /// Where pieces come from
    #[arg(long, value_enum, default_value_t = PieceSource::Auto)]
    pub(crate) split: PieceSource,
    /// Voxels of V-HACD along the longest side
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(8..=256))]
    pub(crate) resolution: u32,
    /// Metres that a length of 1 in the mesh stands for
    #[arg(long, value_name = "METRES", default_value_t = 1.0, value_parser = positive)]
    pub(crate) scale: f32,
    /// What is written
    #[arg(long, value_enum, default_value_t = PieceFormat::Json)]
    pub(crate) format: PieceFormat,
    /// File to write [default: stdout]
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
}

pub(super) fn positive(text: &str) -> Result<f32, String> {
    let number: f32 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (1e-6..=1e6).contains(&number) { Ok(number) } else { Err("is not from 1e-6 to 1e6".into()) }
}

fn identifier(text: &str) -> Result<String, String> {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    if text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.chars().all(is_word) {
        Ok(text.to_owned())
    } else {
        Err("is no name in C; give letters, digits and _, a letter first".into())
    }
}

/// Where convex pieces come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum PieceSource {
    /// The mesh's groups if each is closed and convex; else V-HACD of the parts that are not
    Auto,
    /// The hulls of the mesh's groups
    Groups,
    /// V-HACD of the whole mesh
    Vhacd,
}

/// How convex pieces are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum PieceFormat {
    /// A JSON document
    Json,
    /// Constants in Rust
    Rust,
    /// Constants in C
    C,
}

#[derive(Args)]
#[command(after_help = "\
The result has been loaded before it is written: a missing or misshapen tensor is an error here.

Types: f32 is the reference; i8 has one scale per output channel and keeps the first and the last layer f16; mixed keeps
the point network, the anchor queries and the head f16 besides; f16 is f16 throughout. Norms and biases stay f32.

A header defines NAME, an aligned array of constants that stays in flash, and NAME_bytes, its length: what rf_config takes
(docs/C.md). C11, C++11 and, with GCC or Clang, C99 compile it. Include it in one file. The model is checked first.

Examples:
  python -m rigidformer_lab.export runs/edge/checkpoint.pt --out edge.safetensors
  rigidformer pack edge.safetensors --out edge.rfm
  rigidformer pack edge.rfm --dtype i8 --out edge-i8.rfm
  rigidformer pack edge.rfm --dtype i8 --wide blocks.0.attention.qkvg --out edge-i8.rfm --json
  rigidformer pack nano.safetensors --dtype i8 --narrow encoder.point.0 --out nano.rfm
  rigidformer pack edge.rfm --dtype i8 --panels --out edge-panels.rfm
  rigidformer pack nano.rfm --provenance runs.toml --out nano.rfm
  rigidformer pack nano.rfm --scope near --out nano-near.rfm
  rigidformer pack nano.rfm --metrics movi-a.json movi-b.json --out nano.rfm
  rigidformer pack nano.rfm --header --out model.h
  rigidformer pack tossed.rfm --header --name tossed --out tossed.h
  rigidformer pack --random paper --dtype i8 --out paper.rfm")]
pub(crate) struct Pack {
    /// Model exported by rigidformer_lab.export (safetensors), or a packed f32 model
    #[arg(value_name = "IN", required_unless_present = "random")]
    pub(crate) input: Option<PathBuf>,
    /// Instead of IN: random weights in the sizes of a preset, for measurements of speed; int8 is in panels
    #[arg(long, value_enum, value_name = "PRESET", conflicts_with_all = ["input", "wide", "narrow", "json"])]
    pub(crate) random: Option<PresetName>,
    /// With --random: which random weights
    #[arg(long, value_name = "N", default_value_t = 1, requires = "random")]
    pub(crate) seed: u64,
    /// Store int8 matrices in panels: hosts have nothing to lay out when they load such a file, and map it from 16 MiB on;
    /// microcontrollers cannot read it
    #[arg(long)]
    pub(crate) panels: bool,
    /// Keep the packed model IN as it is but for its provenance, which gets the entries `key = "text"` of this TOML
    /// file; an entry replaces one of the same key
    #[arg(long, value_name = "FILE", conflicts_with_all = ["random", "panels", "dtype", "wide", "narrow"])]
    pub(crate) provenance: Option<PathBuf>,
    /// Keep the packed model IN as it is but for which units of a scene its network sees: all, or those that it corrects and those that
    /// may touch one of them within the step; models that move by impulses alone
    #[arg(long, value_enum, conflicts_with_all = ["random", "panels", "dtype", "wide", "narrow", "provenance"])]
    pub(crate) scope: Option<ScopeName>,
    /// Keep the packed model IN as it is but for what it says that training saw, measured on the splits train and extra of these scene
    /// files, or taken over from one other packed model: by it a runtime tells units that are unlike them
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["random", "panels", "dtype", "wide", "narrow", "provenance", "scope"])]
    pub(crate) ranges: Vec<PathBuf>,
    /// Keep the packed model IN as it is but for its figures, which become the headlines of these outputs of `rigidformer evaluate --json`,
    /// with the network and without it; `rigidformer inspect --card` shows them
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["random", "panels", "dtype", "wide", "narrow", "provenance", "scope", "ranges"])]
    pub(crate) metrics: Vec<PathBuf>,
    /// Write the packed model IN as a C header, for firmware in C or C++
    #[arg(long, conflicts_with_all = ["random", "panels", "dtype", "wide", "narrow", "provenance", "scope", "ranges", "metrics", "json"])]
    pub(crate) header: bool,
    /// With --header: what the array is called [default: rf_model]
    #[arg(long, value_name = "NAME", requires = "header", value_parser = identifier)]
    pub(crate) name: Option<String>,
    /// Packed model or header to write
    #[arg(long, value_name = "OUT")]
    pub(crate) out: PathBuf,
    /// Type of the linear layers' weights
    #[arg(long, value_enum, default_value_t = PrecisionName::F32)]
    pub(crate) dtype: PrecisionName,
    /// Keep this layer f16 in an i8 or mixed model; may be given more than once
    #[arg(long, value_name = "LAYER")]
    pub(crate) wide: Vec<String>,
    /// Make this layer int8 although the dtype keeps it f16; may be given more than once
    #[arg(long, value_name = "LAYER")]
    pub(crate) narrow: Vec<String>,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
#[command(after_help = "\
Rolls both models out over the first 100 frames, and lets both take single steps from the same recorded states. Reports
drift between them, change of the benchmark metrics, one-step anchor difference, rigidity, and noise layer by layer.
Exit code 0: within the tolerances. 1: not, or nothing could be measured.

Tolerances are chosen by the quantised model's weights unless a JSON file gives them; null switches a limit off:
  {\"metric_change\": 0.03, \"one_step_ratio\": 0.1, \"bonds_apart\": 0.03, \"drift_step\": 10,
   \"median_drift_m\": 0.005, \"median_drift_deg\": 0.5, \"rigidity\": 1e-5, \"layer_sqnr_db\": null}
metric_change is 0.003 for f16.

Writes into DIR, if given:
  drift.png   median and 95 % of the drift over time

Examples:
  rigidformer check --float edge.rfm --quantised edge-i8.rfm movi-a.safetensors
  rigidformer check --float edge.rfm --quantised edge-f16.rfm movi-b.safetensors --split validation --limit 30
  rigidformer check --float edge.rfm --quantised edge-i8.rfm movi-a.safetensors --out check --json > check.json")]
pub(crate) struct Check {
    /// Scene file with at least 101 frames
    pub(crate) dataset: PathBuf,
    /// Packed f32 model, or f16 where nothing wider is kept: the reference
    #[arg(long, value_name = "F")]
    pub(crate) float: PathBuf,
    /// Packed model that was quantised from it
    #[arg(long, value_name = "Q")]
    pub(crate) quantised: PathBuf,
    /// Which scenes
    #[arg(long, value_enum, default_value_t = SplitName::Test)]
    pub(crate) split: SplitName,
    /// Step codes, with commas between
    #[arg(long, value_name = "S", value_delimiter = ',', default_value = "5,10")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=25))]
    pub(crate) steps: Vec<u32>,
    /// Only the first N scenes of the split
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) limit: Option<u32>,
    /// What is allowed [default: by the type of the weights]
    #[arg(long, value_name = "FILE")]
    pub(crate) tolerances: Option<PathBuf>,
    /// Folder for the picture, made if need be [default: no picture]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Print one JSON document instead of tables
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Args)]
#[command(after_help = "\
Motion is cut into pieces of a few tenths of a second, and the model predicts each of them with many parameters. What fits best counts
most. A row is a unit that touched something. Friction and restitution are those with the plane, the products of both
coefficients: motion tells no more. Of several planes the roughest is meant. The unit's own coefficients follow if the plane's are as the
file says (--json has them). Of two units that met, the ratio of masses is told.

Intervals are of 90 %. Against another engine they hold for slides and for bounces, and are too narrow for bodies that tumble
(docs/IDENTIFY.md). \"not seen\" means that the motion hardly depends on it: a body that never slid has no friction
to be seen, one that never bounced no restitution. One that lies on a slope has a friction of at least so much. Frictions, restitutions
and masses of units in the file do not count, but that masses are guessed to be within a factor of 3.
docs/IDENTIFY.md says what can be seen and how well the intervals hold.

--out writes the scene file once more with the middle of each interval in place of the unit's friction and restitution, and the
bound where there is one alone. What was not seen stays as it was, and so do masses. With --same-body all scenes with as many units
get it, also those that were not looked at.

The same seed gives the same intervals, to the bit, on any number of threads.

Examples:
  rigidformer identify tracked.safetensors
  rigidformer identify cube-tosses.safetensors --split train --same-body --limit 10 --out cube.safetensors
  rigidformer identify slides.safetensors --index 3 --noise-mm 0.5 --noise-mrad 10 --particles 128 --json")]
pub(crate) struct Identify {
    /// Scene file with recorded poses, such as one that `track` wrote
    pub(crate) scenes: PathBuf,
    #[command(flatten)]
    pub(crate) model: Model,
    #[command(flatten)]
    pub(crate) contact: Contact,
    /// Which scene of the file, from 0 [default: all of the split, each by itself]
    #[arg(long, value_name = "I", conflicts_with_all = ["split", "limit", "same_body"])]
    pub(crate) index: Option<usize>,
    /// Only the scenes of this split [default: all scenes]
    #[arg(long, value_enum)]
    pub(crate) split: Option<SplitName>,
    /// Only the first N of them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) limit: Option<u32>,
    /// All scenes show the same bodies: one friction, one restitution and one mass for each unit number
    #[arg(long)]
    pub(crate) same_body: bool,
    /// Tried at once; more take longer and make intervals smoother
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(16..=4096))]
    pub(crate) particles: u32,
    /// Which random particles
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(crate) seed: u64,
    /// What each coordinate of a pose is off, a standard deviation in millimetres [default: estimated from the poses]
    #[arg(long, value_name = "MM", value_parser = deviation, requires = "noise_mrad")]
    pub(crate) noise_mm: Option<f32>,
    /// What a rotation about each axis is off, in milliradians
    #[arg(long, value_name = "MRAD", value_parser = deviation, requires = "noise_mm")]
    pub(crate) noise_mrad: Option<f32>,
    /// The largest friction and restitution that may be, with commas between
    #[arg(long, value_name = "F,E", value_delimiter = ',', num_args = 1, default_value = "1.2,1", value_parser = most)]
    pub(crate) most: Vec<f32>,
    /// Scene file to write, with what was identified
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

fn deviation(text: &str) -> Result<f32, String> {
    let number: f32 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (0.0..=1e4).contains(&number) { Ok(number) } else { Err("is not from 0 to 10,000".into()) }
}

fn most(text: &str) -> Result<f32, String> {
    let number: f32 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (0.01..=100.0).contains(&number) {
        Ok(number)
    } else {
        Err("is not from 0.01 to 100".into())
    }
}

#[derive(Args)]
#[command(after_help = "\
The file is a safetensors file with a tensor a step and layer, in the order of computation, and the poses after each
step. The same run gives the same bytes on every target.

Examples:
  rigidformer trace --out here.trace
  rigidformer trace movi-a.safetensors --index 3 --model edge-i8.rfm --step 5 --steps 100 --out here.trace")]
pub(crate) struct Trace {
    /// Scene file [default: a scene that comes with the program]
    pub(crate) scene: Option<PathBuf>,
    /// Which scene of the file, from 0 [default: its first of the test split, else its first]
    #[arg(long, value_name = "I")]
    pub(crate) index: Option<usize>,
    #[command(flatten)]
    pub(crate) model: Model,
    /// Frames of the record between two predictions; frames 0 and S are observed
    #[arg(long, value_name = "S", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) step: u32,
    /// Steps to take
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) steps: u32,
    /// Trace to write
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
}

#[derive(Args)]
#[command(after_help = "\
Exit code 0: the same bits. 1: not, or the traces are of different runs.

Examples:
  rigidformer diff here.trace from-the-robot.trace
  rigidformer diff here.trace from-the-robot.trace --json")]
pub(crate) struct Diff {
    /// Trace made by `rigidformer trace`
    pub(crate) a: PathBuf,
    /// Another of the same scene, step and number of steps
    pub(crate) b: PathBuf,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

/// Presets as the command line calls them.
#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum PresetName {
    /// 175.06 million parameters: the paper's widths
    Paper,
    /// 1.43 million: the sizes of the default model
    Edge,
}

/// Which units a network sees, as the command line calls it.
#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum ScopeName {
    /// All units of a scene
    All,
    /// Those that it corrects, and those that may touch one of them within the step
    Near,
}

/// Types as the command line calls them.
#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum PrecisionName {
    F32,
    F16,
    I8,
    Mixed,
}

impl From<PrecisionName> for Precision {
    fn from(name: PrecisionName) -> Self {
        match name {
            PrecisionName::F32 => Precision::F32,
            PrecisionName::F16 => Precision::F16,
            PrecisionName::I8 => Precision::I8,
            PrecisionName::Mixed => Precision::Mixed,
        }
    }
}
