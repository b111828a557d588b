//! Poses of an MCAP file.

use std::path::Path;

use nalgebra::Isometry3;
use rigidformer_runtime::memory::Budget;

use super::error::{CaptureError, CaptureProblem};
use super::messages::transforms;
use super::points::shortened;
use super::records::messages;

/// Poses that are read, at most.
// A robot of thirty links has as many in an hour at 100 Hz.
const MAX_POSES: usize = 12_000_000;
/// Types that an error names, at most.
const MAX_NAMES: usize = 32;

/// Pose of a frame in another at an instant.
#[derive(Clone, Debug, PartialEq)]
pub struct FramePose {
    /// Seconds since the file's first pose.
    pub time_s: f64,
    /// The child of a transform, or the topic of a message with a pose alone, without the leading slash.
    pub frame: String,
    /// The frame that the pose is in.
    pub parent: String,
    /// Carries the frame to its parent, metres.
    pub pose: Isometry3<f64>,
}

/// Reads all poses of an MCAP file, in the order of its messages: `foxglove.FrameTransform`, `FrameTransforms` and `PoseInFrame` (JSON or
/// protobuf), and `tf2_msgs/msg/TFMessage`, `geometry_msgs/msg/TransformStamped` and `PoseStamped` (CDR). A pose without a stamp has the
/// time at which it was logged. Transforms that are known once for all, such as those of `/tf_static`, may be of any time.
///
/// # Errors
/// [`CaptureError`] names the file, the message and the remedy; [`CaptureProblem::NoPoses`] where no message holds a pose.
///
/// ```no_run
/// use rigidformer_perception::recording::poses;
///
/// for sample in poses("drive.mcap".as_ref())? {
///     println!("{} in {} at {} s: {}", sample.frame, sample.parent, sample.time_s, sample.pose);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn poses(path: &Path) -> Result<Vec<FramePose>, CaptureError> {
    let mut found: Vec<(i128, FramePose)> = Vec::new();
    let mut others: Vec<String> = Vec::new();
    let mut budget = Budget::default();
    for message in messages(path)? {
        let message = message?;
        let (channel, topic) = (&message.channel, message.channel.topic.as_str());
        let schema = channel.schema.as_deref().unwrap_or_default();
        let at = |problem| {
            let topic = shortened(topic.to_owned());
            let location = format!("message {} of {topic}", message.sequence);
            CaptureError::at(path, &location, problem)
        };
        let Some(read) = transforms(&channel.encoding, schema, message.data()).map_err(at)? else {
            let what = shortened(format!("{topic} ({schema})"));
            if others.len() < MAX_NAMES && !others.contains(&what) {
                others.push(what);
            }
            continue;
        };
        if found.len() + read.len() > MAX_POSES {
            let (points, most) = ((found.len() + read.len()) as u64, MAX_POSES as u64);
            return Err(CaptureError::of(
                path,
                CaptureProblem::TooManyPoses { poses: points, most },
            ));
        }
        for one in read {
            let names = one.parent.len() + one.child.as_ref().map_or(topic.len(), String::len);
            budget
                .take((size_of::<(i128, FramePose)>() + names) as u64)
                .map_err(|large| CaptureError::of(path, large))?;
            let time = one.time.unwrap_or(message.log_time.into());
            let frame = one.child.unwrap_or_else(|| topic.trim_start_matches('/').to_owned());
            found
                .push((time, FramePose { time_s: 0.0, frame, parent: one.parent, pose: one.pose }));
        }
    }
    if found.is_empty() {
        let others = if others.is_empty() { "none at all".into() } else { others.join(", ") };
        return Err(CaptureError::of(path, CaptureProblem::NoPoses(others)));
    }
    // Stamps of static transforms are often 0.
    let start = found.iter().map(|(time, _)| *time).filter(|time| *time > 0).min().unwrap_or(0);
    let seconds = |time: i128| (time - start) as f64 / 1e9;
    Ok(found
        .into_iter()
        .map(|(time, sample)| FramePose { time_s: seconds(time), ..sample })
        .collect())
}
