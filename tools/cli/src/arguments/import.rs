//! Arguments of `rigidformer import`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

#[derive(Args)]
#[command(after_help = "\
INPUT is a recording, one scene each:
  poses.csv   columns time_s, unit, x, y, z, qw, qx, qy, qz, in any order; others are passed over. `rigidformer track` writes such files.
  take.csv    rigid bodies as OptiTrack's Motive exports them: quaternions, global; y up becomes z up, and a blank cell is a lost frame.
  poses.npz   arrays poses (frames, units, 7: x, y, z, qw, qx, qy, qz), time (frames) in seconds or fps (one number), and the points of
              the units, metres, each (points, 3): points_NAME for each unit, in the order of the units; or points, the same for all.
              Units without a name are called 0, 1 and so on.
  poses.mcap  foxglove.FrameTransform, FrameTransforms or PoseInFrame, tf2_msgs/msg/TFMessage, geometry_msgs/msg/TransformStamped or
              PoseStamped. A unit is a frame, or the topic of a pose; frames in frames are carried to the world. `--unit` picks.

Poses are those of the body frame in the world, metres, z up. Units get points in the body frame from --points, from the npz file, or
as --box, --cylinder or --sphere. A NAME of * is every unit that has no own. All units are resampled to one constant rate over the time
that all of them are seen. Poses at the origin without a turn, far off those beside, are taken for lost frames. Clouds and depth images: `rigidformer track` follows their units, and writes a scene file itself.

Scenes are shared out over the splits train, validation and test by --seed. Nothing is written where a recording has a mistake.

Examples:
  rigidformer import poses.csv --box '*=0.1,0.1,0.1' --ground 0.5,0.4 --out mine.safetensors
  rigidformer import day1.csv day2.csv --points points.csv --fps 120 --physics cup=0.3,0.5,0.2 --fixed table --out mine.safetensors
  rigidformer import take.csv --box cube=.1,.1,.1 --unit cube --out mine.safetensors
  rigidformer import vicon.csv --time-scale .001 --scale .001 --up y --repeats keep-first --box '*=.1,.1,.1' --out mine.safetensors
  rigidformer import drive.mcap --unit cup --unit table --fixed table --box cup=.08,.08,.1 --box table=1,1,.04 --out mine.safetensors
  rigidformer import tosses/*.npz --open-loop --test-share 0.2 --seed 7 --out tosses.safetensors --json")]
pub(crate) struct Import {
    /// Recordings, one scene each
    #[arg(value_name = "INPUT", required = true)]
    pub(crate) inputs: Vec<PathBuf>,
    /// Scene file to write
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// CSV file of units' points: columns unit, x, y, z; metres, body frame
    #[arg(long, value_name = "FILE")]
    pub(crate) points: Option<PathBuf>,
    /// Only this unit is taken; may be given more than once [default: all, of MCAP files all frames that move]
    #[arg(long, value_name = "NAME")]
    pub(crate) unit: Vec<String>,
    /// A unit is a box with these sides, metres; may be given more than once
    #[arg(long = "box", value_name = "NAME=A,B,C")]
    pub(crate) boxes: Vec<String>,
    /// A unit is a cylinder about z with this radius and height, metres
    #[arg(long = "cylinder", value_name = "NAME=R,H")]
    pub(crate) cylinders: Vec<String>,
    /// A unit is a sphere of this radius, metres
    #[arg(long = "sphere", value_name = "NAME=R")]
    pub(crate) spheres: Vec<String>,
    /// Mass in kg, friction and restitution of a unit [default: *=1,0.5,0.4]
    #[arg(long, value_name = "NAME=M,F,R")]
    pub(crate) physics: Vec<String>,
    /// Principal moments of inertia of a unit, kg m^2, about the axes of its body frame [default: of the uniform box around its points]
    #[arg(long, value_name = "NAME=A,B,C")]
    pub(crate) inertia: Vec<String>,
    /// A unit does not move; it stays at its first pose
    #[arg(long, value_name = "NAME")]
    pub(crate) fixed: Vec<String>,
    /// A unit moves as recorded, whatever it meets: a hand, a gripper
    #[arg(long, value_name = "NAME")]
    pub(crate) driven: Vec<String>,
    /// Gravity, m/s^2
    #[arg(long, value_name = "X,Y,Z", default_value = "0,0,-9.81", allow_hyphen_values = true)]
    pub(crate) gravity: String,
    /// Friction and restitution of the ground, the plane z = 0
    #[arg(long, value_name = "F,R", default_value = "0.5,0.4")]
    pub(crate) ground: String,
    /// There is no ground at z = 0
    #[arg(long, conflicts_with = "ground")]
    pub(crate) no_ground: bool,
    /// One plane more: normal towards the free side, offset along it in metres, friction, restitution; 8 planes at most
    #[arg(long, value_name = "NX,NY,NZ,D,F,R", allow_hyphen_values = true)]
    pub(crate) plane: Vec<String>,
    /// Frames a second of the scene file [default: that of the first recording]
    #[arg(long, value_name = "HZ")]
    pub(crate) fps: Option<f64>,
    /// Longest time without a pose of a unit, seconds [default: five times its median interval]
    #[arg(long, value_name = "S")]
    pub(crate) gap: Option<f64>,
    /// Seconds that a time of 1 in the recordings stands for
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0, value_parser = scale::<f64>)]
    pub(crate) time_scale: f64,
    /// Metres that a length of 1 in the recordings stands for, in poses and in their own points
    #[arg(long, value_name = "METRES", default_value_t = 1.0, value_parser = scale::<f32>)]
    pub(crate) scale: f32,
    /// Which axis of the recordings points up; y up becomes z up [default: y for Motive's files, else z]
    #[arg(long, value_enum, value_name = "AXIS")]
    pub(crate) up: Option<UpAxis>,
    /// What becomes of rows that are not later than the one before of the same unit
    #[arg(long, value_enum, default_value_t = RepeatsName::Error)]
    pub(crate) repeats: RepeatsName,
    /// Keep the velocities at frame 0, for `evaluate` in open loop: those between frames 0 and 1, in free flight
    #[arg(long)]
    pub(crate) open_loop: bool,
    /// Share of the scenes of the split test
    #[arg(long, value_name = "SHARE", default_value_t = 0.2)]
    pub(crate) test_share: f64,
    /// Share of the scenes of the split validation, by which choices are made
    #[arg(long, value_name = "SHARE", default_value_t = 0.1)]
    pub(crate) validation_share: f64,
    /// Another seed, other splits
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Name of the data set [default: that of the file]
    #[arg(long, value_name = "TEXT")]
    pub(crate) name: Option<String>,
    /// Under which terms the recordings may be used
    #[arg(long, value_name = "TEXT", default_value = "not told")]
    pub(crate) licence: String,
    /// Print one JSON document instead of text
    #[arg(long)]
    pub(crate) json: bool,
}

/// Which axis of a recording points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum UpAxis {
    /// As in many programs for motion capture
    Y,
    /// As here
    Z,
}

/// What becomes of rows that are not later than those before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum RepeatsName {
    /// They are an error
    Error,
    /// Rows are sorted by time; of equal times the first in the file stays
    KeepFirst,
    /// Rows are sorted by time; of equal times the last in the file stays
    KeepLast,
}

fn scale<T: std::str::FromStr + PartialOrd + From<f32>>(text: &str) -> Result<T, String> {
    let number: T = text.parse().map_err(|_| "is not a number".to_owned())?;
    let is_likely = number >= T::from(1e-10) && number <= T::from(1e6);
    if is_likely { Ok(number) } else { Err("is not from 1e-10 to 1e6".into()) }
}
