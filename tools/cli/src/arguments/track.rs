//! Arguments of `rigidformer track`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
#[cfg(feature = "sensors")]
use rigidformer_perception::tracker::Segmentation;

use super::model::Model;
use super::viewers::Viewers;

#[derive(Args)]
#[command(after_help = "\
INPUT is a recording: a folder of depth images with frames.json, a folder of PLY or PCD clouds, or one such file (docs/SENSORS.md). With
--render it is a scene file: what depth cameras would see of it is followed, and scored. With - frames come from standard input, and a
line of JSON goes to standard output for each (docs/SENSORS.md says how).

A unit that rests is held still until it is seen to move, also where nothing is seen to carry it.

Writes into DIR:
  poses.csv             time, unit, pose, velocity, their standard deviations, and whether it was seen
  strip.png             what was seen, what is followed, and what is predicted, at four instants
  tracked.safetensors   the units that were followed as a scene file, at a constant rate, for `rigidformer evaluate` and for training

With --truth-labels the segments of each depth image are scored by its labels: overlap, boundary, and bodies found.
With --truth, or with --render, the poses are scored against the true scene (docs/SENSORS.md says how), and predictions .2 s and .4 s ahead
beside those of the same model that is given the true poses, points and masses.

Examples:
  rigidformer track seen --out tracked
  rigidformer track seen --truth movi-a.safetensors --index 3 --segmentation given --json
  rigidformer track seen --truth-labels --json
  rigidformer track seen --object mug.obj=0.35 --object box.stl
  rigidformer track seen --mask first.png
  rigidformer track clouds --rate 10 --up 0,0,1
  camera | rigidformer track -
  rigidformer track movi-a.safetensors --render --index 3 --cameras 2 --deviation-mm 1
  rigidformer track seen --mcap tracked.mcap --html tracked.html")]
pub(crate) struct Track {
    /// Recording; with --render a scene file
    #[arg(value_name = "INPUT")]
    pub(crate) input: PathBuf,
    #[command(flatten)]
    pub(crate) model: Model,
    /// Without a motion model: units fly or lie, and nothing is predicted
    #[arg(long, conflicts_with = "path")]
    pub(crate) no_model: bool,
    /// Without the model's network: impulses alone predict
    #[arg(long, conflicts_with = "no_model")]
    pub(crate) no_network: bool,
    /// What tells bodies from each other
    #[arg(long, value_enum, default_value_t = SegmentationName::Found)]
    pub(crate) segmentation: SegmentationName,
    /// Mesh of a body that is followed, OBJ, STL or COLLADA, and its mass, else that of its volume at 1000 kg/m3; may be given more than once
    #[arg(long, value_name = "FILE[=KG]")]
    pub(crate) object: Vec<String>,
    /// Metres that a length of 1 in the meshes of --object stands for
    #[arg(long, value_name = "METRES", default_value_t = 1.0, value_parser = super::positive)]
    pub(crate) object_scale: f32,
    /// Labels of the first image, 0 for no body: PNG of grey, or with a palette
    #[arg(long, value_name = "PNG")]
    pub(crate) mask: Option<PathBuf>,
    /// How much later the stamps of images and clouds are than what they show, against those of transforms, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, allow_hyphen_values = true, value_parser = latency)]
    pub(crate) latency: f64,
    /// Topic of an MCAP file that is followed; may be given several times [default: depth images, else clouds]
    #[arg(long, value_name = "TOPIC")]
    pub(crate) topic: Vec<String>,
    /// Captures a second, of clouds that have no times and of --render [default: with --render 30]
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub(crate) rate: Option<f64>,
    /// Metres a unit of length of the recording: .001 for millimetres. Depth images and clouds are multiplied by it
    #[arg(long, value_name = "M", conflicts_with = "render", value_parser = scale)]
    pub(crate) scale: Option<f32>,
    /// Gravity in the recording's world, m/s^2 [default: the recording's or the scene's, else by what is seen]
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    pub(crate) gravity: Vec<f32>,
    /// The way up in the recording's world: gravity is 9.81 m/s^2 the other way
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_delimiter = ',',
        allow_hyphen_values = true,
        conflicts_with = "gravity"
    )]
    pub(crate) up: Vec<f32>,
    /// Friction and restitution of units and planes, which cannot be seen
    #[arg(long, value_name = "F,R", value_delimiter = ',', default_values_t = [0.5, 0.4])]
    pub(crate) physics: Vec<f32>,
    /// Scene file with what truly happened
    #[arg(long, value_name = "SCENE", conflicts_with = "render")]
    pub(crate) truth: Option<PathBuf>,
    /// The recording's labels are the true bodies of its depth images: score the segments that are found
    #[arg(long, conflicts_with_all = ["mask", "truth", "render"])]
    pub(crate) truth_labels: bool,
    /// Which scene of the file, from 0
    #[arg(long, value_name = "I", default_value_t = 0)]
    pub(crate) index: usize,
    /// INPUT is a scene file: see it with depth cameras
    #[arg(long)]
    pub(crate) render: bool,
    /// Cameras of --render, as `rigidformer render` places them
    #[arg(long, value_name = "N", default_value_t = 1, requires = "render", value_parser = clap::value_parser!(u8).range(1..=3))]
    pub(crate) cameras: u8,
    /// Standard deviation of depths of --render where the units are, millimetres; it grows with the square of the depth
    #[arg(long, value_name = "MM", default_value_t = 1.0, requires = "render", value_parser = deviation)]
    pub(crate) deviation_mm: f32,
    /// Hulls and masses of the scene's free units are known, as with --object
    #[arg(long, requires = "render", conflicts_with = "object")]
    pub(crate) known: bool,
    /// Folder for the results, made if need be [default: none are written with --json, else `track`]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) viewers: Viewers,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

#[cfg(feature = "sensors")]
impl Track {
    /// Whether the recording's labels tell bodies from each other, or which of them are visible.
    pub(crate) fn reads_labels(&self) -> bool {
        self.segmentation == SegmentationName::Given || self.truth.is_some() || self.truth_labels
    }
}

/// What tells bodies from each other, as the command line calls it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum SegmentationName {
    /// Labels of the recording
    Given,
    /// Planes, and gaps between what is left
    Found,
}

#[cfg(feature = "sensors")]
impl From<SegmentationName> for Segmentation {
    fn from(name: SegmentationName) -> Self {
        match name {
            SegmentationName::Given => Segmentation::Given,
            SegmentationName::Found => Segmentation::Found,
        }
    }
}

fn rate(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (0.1..=1000.0).contains(&number) {
        Ok(number)
    } else {
        Err("is not from 0.1 to 1000".into())
    }
}

fn latency(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (-10.0..=10.0).contains(&number) { Ok(number) } else { Err("is not from -10 to 10".into()) }
}

fn scale(text: &str) -> Result<f32, String> {
    let number: f32 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (1e-6..=1e6).contains(&number) { Ok(number) } else { Err("is not from 1e-6 to 1e6".into()) }
}

fn deviation(text: &str) -> Result<f32, String> {
    let number: f32 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (0.0..=1000.0).contains(&number) { Ok(number) } else { Err("is not from 0 to 1000".into()) }
}
