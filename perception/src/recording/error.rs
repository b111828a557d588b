//! What can be wrong with a recording.

use std::io;
use std::path::PathBuf;

use rigidformer_runtime::files::FileError;
use rigidformer_runtime::memory::TooLarge;

use crate::camera::CameraError;
use crate::capture::DepthError;

/// A recording, or a part of one, that cannot be used. Its text names the file, the place in it and the remedy.
#[derive(Debug, thiserror::Error)]
#[error("{}: {place}{problem}; {}", .path.display(), .problem.remedy())]
pub struct CaptureError {
    /// The file or folder.
    pub path: PathBuf,
    /// Where in it, such as `frame 12: `; empty where it is the whole file.
    pub place: String,
    /// What is wrong.
    pub problem: CaptureProblem,
}

/// What is wrong with a recording.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureProblem {
    /// The file cannot be read.
    #[error("cannot be read ({0})")]
    Unreadable(io::Error),
    /// The file or folder cannot be written.
    #[error("cannot be written ({0})")]
    Unwritable(io::Error),
    /// There is something where a recording is to be written.
    #[error("is there already")]
    Exists,
    /// A path where no recording is.
    #[error("is no recording: {0}")]
    NoRecording(&'static str),
    /// A bag of ROS in a format that is not read.
    #[error("is {0}, which is not read")]
    OtherBag(&'static str),
    /// A file with more bytes than are read.
    #[error("has {bytes} bytes, more than {most}")]
    TooLarge {
        /// Its bytes.
        bytes: u64,
        /// Bytes that are read, at most.
        most: u64,
    },
    /// An MCAP file that is short for what it unpacks to.
    #[error("is short for what it unpacks to: its chunks have more than {most} bytes of records")]
    Unpacked {
        /// Bytes that they may have.
        most: u64,
    },
    /// A capture, or a list of frames, that takes more memory than it may.
    #[error(transparent)]
    Memory(#[from] TooLarge),
    /// A `frames.json` that does not parse.
    #[error("does not parse ({0})")]
    Json(String),
    /// A `frames.json` of something else.
    #[error("is {found}, not {expected}")]
    Foreign {
        /// What it says.
        found: String,
        /// What it should say.
        expected: &'static str,
    },
    /// A recording without captures.
    #[error("has no frames")]
    Empty,
    /// A time that is no number.
    #[error("a time of {0} s")]
    Time(f64),
    /// A time before the one before.
    #[error("time goes back from {before_s} s to {time_s} s")]
    Backwards {
        /// Its time.
        time_s: f64,
        /// The time before.
        before_s: f64,
    },
    /// Two frames of one camera, or two clouds, at one time.
    #[error("is the second one at {0} s, within a millisecond")]
    Duplicate(f64),
    /// Two cameras of one name.
    #[error("has the name of another camera")]
    DuplicateCamera,
    /// A frame of a camera that is not listed.
    #[error("names the camera {0:?}, which is not in the list of cameras")]
    UnknownCamera(String),
    /// A camera whose numbers cannot be.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A depth image that does not fit its camera.
    #[error(transparent)]
    Depth(#[from] DepthError),
    /// A pose that is none.
    #[error("its pose {0}")]
    Pose(&'static str),
    /// A pose that single precision does not resolve.
    #[error("its pose is more than 1000 km from its frame's origin")]
    Far,
    /// A transform that does not say what is there.
    #[error("names no child frame")]
    NoChild,
    /// A file name that leads out of the folder.
    #[error("names the file {0:?}, which is not in the recording's folder")]
    Outside(String),
    /// A file that a recording names and does not have.
    #[error("is named in frames.json and is not there")]
    Missing,
    /// A PNG file that is damaged.
    #[error("is not a whole PNG file ({0})")]
    Png(String),
    /// An image of another kind.
    #[error("is an image of {found}, not of 16-bit grey")]
    ImageKind {
        /// Its kind.
        found: String,
    },
    /// Labels of another kind.
    #[error("is an image of {found}, not of grey or a palette")]
    LabelKind {
        /// Its kind.
        found: String,
    },
    /// An image of another size.
    #[error("has {} x {} pixels, and its camera {} x {}", .found[0], .found[1], .camera[0], .camera[1])]
    ImageSize {
        /// Its columns and rows.
        found: [u32; 2],
        /// The camera's.
        camera: [u32; 2],
    },
    /// A folder of clouds that says no times.
    #[error("has clouds and no frames.json with their times")]
    NoRate,
    /// A rate that is none.
    #[error("a rate of {0} clouds a second")]
    Rate(f64),
    /// A latency that is none.
    #[error("a latency of {0} s")]
    Latency(f64),
    /// A cloud's file that is damaged.
    #[error("is not a whole {format} file ({why})")]
    Cloud {
        /// PLY or PCD.
        format: &'static str,
        /// What its reader met.
        why: String,
    },
    /// A cloud without coordinates.
    #[error("has no x, y and z")]
    NoCoordinates,
    /// Coordinates of four bytes so far from the origin that nearby points fall together.
    #[error(
        "its coordinates are 4-byte numbers of about {far_m:.0} m, which do not tell 5 mm apart"
    )]
    Coarse {
        /// Largest coordinate of the middle point, metres.
        far_m: f64,
    },
    /// A cloud of more points than are read.
    #[error("has {points} points, more than {most}")]
    TooManyPoints {
        /// Its points.
        points: u64,
        /// Points that are read, at most.
        most: u64,
    },
    /// An MCAP file that is damaged.
    #[error("is not a whole MCAP file ({0})")]
    Mcap(String),
    /// An MCAP file in which no message can be read.
    #[error("has no messages that are read here; it has {0}")]
    NoMessages(String),
    /// An MCAP file in which no message holds a pose.
    #[error("has no poses that are read here; it has {0}")]
    NoPoses(String),
    /// An MCAP file with more poses than are read.
    #[error("has {poses} poses, more than {most}")]
    TooManyPoses {
        /// How many were found so far.
        poses: u64,
        /// Poses that are read, at most.
        most: u64,
    },
    /// An MCAP file with more frames than are known at once, or with a frame whose name is long.
    #[error("has more than 65,536 frames, or a frame whose name has more than 1024 bytes")]
    TooManyFrames,
    /// A message that does not say what its type says.
    #[error("does not decode ({0})")]
    Message(String),
    /// A message of an encoding that is not read.
    #[error("{schema} is encoded as {encoding:?}, which is not read")]
    Encoding {
        /// Its type.
        schema: String,
        /// Its encoding.
        encoding: String,
    },
    /// A depth image without calibration.
    #[error("no camera calibration with its topic or the frame {0:?} is there")]
    NoCalibration(String),
    /// A depth image whose calibration cannot be used.
    #[error("its calibration cannot be used ({0})")]
    Uncalibrated(String),
    /// A topic that was asked for and cannot be read.
    #[error("has no topic {asked:?} with clouds or depth images; it has {all}")]
    NoTopic {
        /// As given.
        asked: String,
        /// Those that can be read.
        all: String,
    },
    /// A calibration with distortion.
    #[error("its camera has a distortion of {0}")]
    Distorted(String),
}

impl CaptureProblem {
    /// What the user can do about it.
    pub fn remedy(&self) -> &'static str {
        match self {
            CaptureProblem::Memory(_) | CaptureProblem::Unpacked { .. } => TooLarge::REMEDY,
            CaptureProblem::Unreadable(_) => "give the path of a recording that you may read",
            CaptureProblem::Unwritable(_) => {
                "name a folder that does not exist, in one that you may write to"
            }
            CaptureProblem::Exists => "remove it, or give another folder",
            CaptureProblem::NoRecording(_) => {
                "give a folder with frames.json, a folder of PLY or PCD files, such a file, or an MCAP file (docs/SENSORS.md)"
            }
            CaptureProblem::OtherBag(_) => "convert it: `mcap convert BAG out.mcap`",
            CaptureProblem::TooLarge { .. } | CaptureProblem::TooManyPoses { .. } => {
                "split the recording"
            }
            CaptureProblem::TooManyFrames => "record the transforms of sensors alone",
            CaptureProblem::NoPoses(_) => {
                "give a file with foxglove.FrameTransform(s) or PoseInFrame, tf2_msgs/msg/TFMessage, or geometry_msgs/msg/TransformStamped or PoseStamped"
            }
            CaptureProblem::Json(_) | CaptureProblem::Foreign { .. } => {
                "write it as docs/SENSORS.md says"
            }
            CaptureProblem::Empty => "give a recording with at least one frame",
            CaptureProblem::Time(_) => "give seconds, a finite number",
            CaptureProblem::Backwards { .. } => "list frames in the order of their times",
            CaptureProblem::Duplicate(_) => {
                "leave one of them out, or give sensors names of their own"
            }
            CaptureProblem::DuplicateCamera => "give each camera a name of its own",
            CaptureProblem::UnknownCamera(_) => "correct the name, or add the camera",
            CaptureProblem::Camera(_) | CaptureProblem::Depth(_) => "correct the camera's numbers",
            CaptureProblem::Pose(_) => {
                "give x, y, z in metres and a quaternion w, x, y, z of length 1"
            }
            CaptureProblem::Far => "give poses in a nearer frame",
            CaptureProblem::NoChild => "record transforms with a child_frame_id",
            CaptureProblem::Outside(_) => "give a name without folders above or a root",
            CaptureProblem::Missing => "put it there, or take it out of frames.json",
            CaptureProblem::Png(_)
            | CaptureProblem::Cloud { .. }
            | CaptureProblem::Mcap(_)
            | CaptureProblem::Message(_) => "record or copy it again",
            CaptureProblem::ImageKind { .. } => {
                "write depths as 16-bit grey, in steps of the camera's depth_scale_m"
            }
            CaptureProblem::LabelKind { .. } => {
                "write each pixel's label as grey of 8 or 16 bits, or as the index of a palette; 0 is no body"
            }
            CaptureProblem::ImageSize { .. } => {
                "give the intrinsics of that resolution, or the right image"
            }
            CaptureProblem::NoRate => "say how many clouds there are a second, or add frames.json",
            CaptureProblem::Rate(_) => "give a number from 0.001 to 1000",
            CaptureProblem::Latency(_) => "give seconds from -10 to 10",
            CaptureProblem::NoCoordinates => "write the properties x, y and z of each point",
            CaptureProblem::Coarse { .. } => {
                "subtract an offset before you write it, or write 8-byte numbers"
            }
            CaptureProblem::TooManyPoints { .. } => "thin the cloud out before it is recorded",
            CaptureProblem::NoMessages(_) | CaptureProblem::Encoding { .. } => {
                "record foxglove.PointCloud, foxglove.RawImage with foxglove.CameraCalibration (JSON or protobuf), sensor_msgs/msg/PointCloud2, or Image with CameraInfo (CDR)"
            }
            CaptureProblem::NoCalibration(_) => {
                "record the CameraInfo beside the image, or foxglove.CameraCalibration with its frame_id"
            }
            CaptureProblem::Uncalibrated(_) => "correct it where it is recorded",
            CaptureProblem::NoTopic { .. } => "name one of these",
            CaptureProblem::Distorted(_) => "record rectified depth images",
        }
    }
}

impl CaptureError {
    /// A problem of a whole file.
    pub(super) fn of(path: impl Into<PathBuf>, problem: impl Into<CaptureProblem>) -> Self {
        CaptureError { path: path.into(), place: String::new(), problem: problem.into() }
    }

    /// A problem at a place of a file.
    pub(super) fn at(
        path: impl Into<PathBuf>,
        place: &str,
        problem: impl Into<CaptureProblem>,
    ) -> Self {
        CaptureError { path: path.into(), place: format!("{place}: "), problem: problem.into() }
    }
}

impl From<FileError> for CaptureError {
    fn from(error: FileError) -> Self {
        CaptureError::of(error.path, CaptureProblem::Unwritable(error.source))
    }
}
