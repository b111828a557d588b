//! Frames from a pipe: a line of JSON and the image's depths for each.

use std::io::{ErrorKind, Read};

use anyhow::{Context, bail};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use rigidformer_perception::camera::Camera;
use rigidformer_perception::capture::{Capture, DepthView, View};
use serde_json::{Map, Value};

/// Bytes of a line, at most.
const MAX_LINE: usize = 4096;
/// Columns and rows, at most.
const MAX_SIDE: u32 = 8192;
/// Cameras of a capture, at most.
const MAX_CAMERAS: usize = 8;
/// Frames are of one capture where their times differ by less than this, seconds.
const MAX_SPAN_S: f64 = 1e-3;
/// Tolerance of a quaternion's length.
const QUATERNION_TOLERANCE: f32 = 1e-3;

/// The line before an image's bytes.
struct Head {
    time_s: f64,
    width: u32,
    height: u32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    depth_scale_m: f32,
    /// x, y, z and a quaternion, from the camera's frame to the world; without it the camera's frame is the world.
    pose: Option<[f32; 7]>,
    /// Whether a frame of another camera at the same instant follows.
    more: bool,
}

/// Captures from a stream of frames.
pub(super) struct Pipe<R> {
    from: R,
    frames: u64,
}

impl<R: Read> Pipe<R> {
    pub(super) fn new(from: R) -> Self {
        Pipe { from, frames: 0 }
    }

    /// The next capture; none where the stream ends between two.
    pub(super) fn next(&mut self) -> Option<anyhow::Result<Capture>> {
        self.capture().transpose()
    }

    fn capture(&mut self) -> anyhow::Result<Option<Capture>> {
        let mut capture: Option<Capture> = None;
        loop {
            let number = self.frames;
            let Some((head, view)) = self.frame().with_context(|| format!("frame {number}"))?
            else {
                match capture {
                    Some(_) => {
                        bail!("the stream ends where a frame of the same instant was announced")
                    }
                    None => return Ok(None),
                }
            };
            self.frames += 1;
            let (time_s, views) = (head.time_s, vec![View::Depth(view)]);
            match &mut capture {
                None => capture = Some(Capture { time_s, views }),
                Some(capture) if (time_s - capture.time_s).abs() < MAX_SPAN_S => {
                    capture.views.extend(views);
                }
                Some(capture) => bail!(
                    "frame {number}: its time is {time_s} s where one of {} s was announced",
                    capture.time_s
                ),
            }
            if !head.more {
                return Ok(capture);
            }
            if capture.as_ref().is_some_and(|capture| capture.views.len() >= MAX_CAMERAS) {
                bail!("frame {number}: an instant has more than {MAX_CAMERAS} frames");
            }
        }
    }

    fn frame(&mut self) -> anyhow::Result<Option<(Head, DepthView)>> {
        let Some(line) = self.line()? else { return Ok(None) };
        let head = head(&line).context(
            "not a line such as {\"time_s\":0,\"width\":640,\"height\":480,\"fx\":554,\"fy\":554,\"cx\":319.5,\"cy\":239.5,\"depth_scale_m\":0.001}",
        )?;
        if !(1..=MAX_SIDE).contains(&head.width) || !(1..=MAX_SIDE).contains(&head.height) {
            bail!("{} x {} pixels: give 1 to {MAX_SIDE} each", head.width, head.height);
        }
        let pose = head.pose.map_or(Ok(Isometry3::identity()), pose)?;
        let (size, focal) = ([head.width, head.height], [head.fx, head.fy]);
        let camera = Camera::new(size, focal, [head.cx, head.cy], pose)?;
        let wanted = 2 * u64::from(head.width) * u64::from(head.height);
        // Memory grows as bytes come: a line alone takes none.
        let mut bytes = Vec::new();
        (&mut self.from).take(wanted).read_to_end(&mut bytes)?;
        if bytes.len() as u64 != wanted {
            bail!("the stream ends after {} of the image's {wanted} bytes", bytes.len());
        }
        let depth = bytes.chunks_exact(2).map(|two| match two {
            [low, high] => u16::from_le_bytes([*low, *high]),
            _ => 0,
        });
        let view = DepthView::new(camera, head.depth_scale_m, depth.collect(), None)?;
        Ok(Some((head, view)))
    }

    /// A line without its end; none at the stream's end.
    fn line(&mut self) -> anyhow::Result<Option<Vec<u8>>> {
        let mut line = Vec::new();
        let mut byte = [0];
        loop {
            match self.from.read(&mut byte) {
                Ok(0) if line.is_empty() => return Ok(None),
                Ok(0) => bail!("the stream ends within a line"),
                Ok(_) if byte == [b'\n'] => return Ok(Some(line)),
                Ok(_) if line.len() < MAX_LINE => line.extend(byte),
                Ok(_) => bail!(
                    "a line of more than {MAX_LINE} bytes: a line of JSON and the image's bytes take turns"
                ),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
    }
}

fn head(line: &[u8]) -> anyhow::Result<Head> {
    let mut fields: Map<String, Value> = serde_json::from_slice(line)?;
    let mut take = |name: &str| fields.remove(name).unwrap_or(Value::Null);
    let number = |name: &str, value: Value| match value.as_f64() {
        Some(number) => Ok(number),
        None => bail!("{name} is no number"),
    };
    let mut single = |name: &str| Ok::<f32, anyhow::Error>(number(name, take(name))? as f32);
    let [fx, fy, cx, cy] = [single("fx")?, single("fy")?, single("cx")?, single("cy")?];
    let depth_scale_m = single("depth_scale_m")?;
    let mut side = |name: &str| match take(name).as_u64().and_then(|side| side.try_into().ok()) {
        Some(side) => Ok::<u32, anyhow::Error>(side),
        None => bail!("{name} is no count of pixels"),
    };
    let (width, height) = (side("width")?, side("height")?);
    let time_s = number("time_s", take("time_s"))?;
    let pose = match take("pose") {
        Value::Null => None,
        Value::Array(values) => {
            let numbers: anyhow::Result<Vec<f32>> =
                values.into_iter().map(|one| Ok(number("pose", one)? as f32)).collect();
            match <[f32; 7]>::try_from(numbers?) {
                Ok(pose) => Some(pose),
                Err(other) => bail!("pose has {} numbers where 7 are needed", other.len()),
            }
        }
        _ => bail!("pose is no list"),
    };
    let more = match take("more") {
        Value::Null => false,
        Value::Bool(more) => more,
        _ => bail!("more is neither true nor false"),
    };
    if let Some(name) = fields.keys().next() {
        bail!("{name:?} is no field of a frame");
    }
    Ok(Head { time_s, width, height, fx, fy, cx, cy, depth_scale_m, pose, more })
}

fn pose([x, y, z, w, i, j, k]: [f32; 7]) -> anyhow::Result<Isometry3<f32>> {
    let rotation = Quaternion::new(w, i, j, k);
    if (rotation.norm() - 1.0).abs() > QUATERNION_TOLERANCE {
        bail!("pose: the quaternion (w, x, y, z) is not of length 1");
    }
    let rotation = UnitQuaternion::from_quaternion(rotation);
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests {
    use super::*;

    const HEAD: &str =
        r#"{"time_s":0.5,"width":4,"height":3,"fx":4,"fy":4,"cx":1.5,"cy":1,"depth_scale_m":0.001"#;

    fn frame(rest: &str, bytes: usize) -> Vec<u8> {
        [format!("{HEAD}{rest}}}\n").as_bytes(), &vec![1; bytes]].concat()
    }

    #[test]
    fn frames_come_one_by_one_and_together() {
        let bytes = [frame("", 24), frame(",\"more\":true", 24), frame("", 24)].concat();
        let mut pipe = Pipe::new(bytes.as_slice());
        let counts: Vec<usize> =
            std::iter::from_fn(|| pipe.next()).map(|one| one.unwrap().views.len()).collect();
        assert_eq!(counts, [1, 2]);
    }

    #[test]
    fn broken_streams_are_named_and_take_no_memory() {
        let huge = HEAD
            .replace("\"width\":4", "\"width\":8192")
            .replace("\"height\":3", "\"height\":8192");
        for (bytes, what) in [
            (frame("", 23), "23 of the image's 24 bytes"),
            (format!("{huge}}}\n12").into_bytes(), "2 of the image's 134217728 bytes"),
            (frame(",\"more\":true", 24), "announced"),
            (frame(",\"pose\":[0,0,0,2,0,0,0]", 24), "quaternion"),
            (frame(",\"colour\":1", 24), "not a line such as"),
            (vec![b'x'; 10_000], "more than 4096 bytes"),
            (b"{".to_vec(), "within a line"),
        ] {
            let error = Pipe::new(bytes.as_slice()).next().unwrap().unwrap_err();
            assert!(format!("{error:#}").contains(what), "{error:#}");
        }
        assert!(Pipe::new(&b""[..]).next().is_none());
    }
}
