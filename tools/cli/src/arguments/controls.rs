//! Arguments of `rigidformer controls`.

use std::path::PathBuf;

use clap::Args;

use super::Model;
use super::render::size;
use crate::video::Rate;

#[derive(Args)]
#[command(after_help = "\
Writes what drives rendering by Diffusion as Shader, which reads 49 frames of 720 x 480 pixels (docs/CONTROLS.md):
  --out FILE.mp4        the tracking video: points in colours that say where they were in the first frame, before black
  --rendered FILE.mp4   the shaded units and planes, from the same camera
  --png DIR             the frames of both as PNG, bit for bit; DIR must not exist or be empty

A point's colour is that of its place in the first frame: red from the left to the right edge, green from the upper to the lower one, blue
from the farthest to the nearest points, by inverse depth between the 2nd and the 98th percentile of the points in the picture (128 where both
are equal). A point that begins beside the picture has the colour of the nearest edge.

The frames are spread evenly over the motion: poses between two predictions are interpolated, as in viewers. --fps says how fast the
file plays. The camera looks from --azimuth and --elevation at the whole motion, as near as shows all of it, or from --eye to --look-at.

H.264 at 4:2:0 shares chroma among four pixels, which blurs squares of 2 pixels. --exact keeps every bit (RGB, profile High 4:4:4
Predictive): FFmpeg and what is built on it read that, browsers and phones mostly do not.

Examples:
  rigidformer controls
  rigidformer controls --mesh --rendered rendered.mp4
  rigidformer controls movi-b.safetensors --index 71 --step 5 --mesh --exact --out b72.mp4
  rigidformer controls movi-a.safetensors --recorded --seconds 0.5 --azimuth 30 --elevation 20
  rigidformer controls --eye 3,-3,2 --look-at 0,0,0.5 --view 50 --size 960x540 --fps 24 --frames 121 --png frames --json")]
pub(crate) struct Controls {
    /// Scene file [default: a scene that comes with the program]
    pub(crate) scene: Option<PathBuf>,
    /// Which scene of the file, from 0 [default: its first of the test split, else its first]
    #[arg(long, value_name = "I")]
    pub(crate) index: Option<usize>,
    #[command(flatten)]
    pub(crate) model: Model,
    /// Frames of the record between two predictions; frames 0 and S are observed [default: 10; 5 with soft units or bonds]
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) step: Option<u32>,
    /// Hold the parts of each body together at pivots that are found from frames 0 to S (to 10 where the file has velocities)
    #[arg(long, conflicts_with = "recorded")]
    pub(crate) join: bool,
    /// Show the recorded motion instead of the predicted one
    #[arg(long, conflicts_with_all = ["path", "step"])]
    pub(crate) recorded: bool,
    /// Surfaces instead of points: hulls of points or convex pieces, each of whose places has its colour
    #[arg(long)]
    pub(crate) mesh: bool,
    /// Pixels a side of a point's square
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    pub(crate) side: u32,
    /// Frames of the video
    #[arg(long, value_name = "N", default_value_t = 49, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(crate) frames: u32,
    /// Frames a second that the video plays with
    #[arg(long, value_name = "HZ", default_value = "8", value_parser = rate)]
    pub(crate) fps: Rate,
    /// Seconds of the motion, from its first frame on, that the video shows [default: all that is predicted, or recorded]
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub(crate) seconds: Option<f64>,
    /// Columns and rows of the videos, even
    #[arg(long, value_name = "WxH", default_value = "720x480", value_parser = even_size)]
    pub(crate) size: [u32; 2],
    /// Where the camera stands about the middle of the motion: degrees from x towards y
    #[arg(long, value_name = "DEG", default_value_t = -60.0, allow_hyphen_values = true, value_parser = degrees::<360>)]
    pub(crate) azimuth: f32,
    /// How far the camera looks down, degrees
    #[arg(long, value_name = "DEG", default_value_t = 35.0, allow_hyphen_values = true, value_parser = degrees::<89>)]
    pub(crate) elevation: f32,
    /// Angle of view along the longer side, degrees
    #[arg(long, value_name = "DEG", default_value_t = 60.0, value_parser = view)]
    pub(crate) view: f32,
    /// Where the camera stands, metres
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = place)]
    #[arg(conflicts_with_all = ["azimuth", "elevation"])]
    pub(crate) eye: Option<[f32; 3]>,
    /// Where that camera looks, metres [default: the middle of the motion]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = place, requires = "eye")]
    pub(crate) look_at: Option<[f32; 3]>,
    /// Keep every bit of colours: RGB, 4:4:4
    #[arg(long)]
    pub(crate) exact: bool,
    /// The tracking video
    #[arg(long, value_name = "FILE.mp4", default_value = "tracking.mp4")]
    pub(crate) out: PathBuf,
    /// Also the shaded units from the same camera
    #[arg(long, value_name = "FILE.mp4")]
    pub(crate) rendered: Option<PathBuf>,
    /// Also the frames as PNG, in a new folder
    #[arg(long, value_name = "DIR")]
    pub(crate) png: Option<PathBuf>,
    /// Print one JSON document instead of lines
    #[arg(long)]
    pub(crate) json: bool,
}

fn even_size(text: &str) -> Result<[u32; 2], String> {
    let sides = size(text, 4096)?;
    if sides.iter().all(|side| side.is_multiple_of(2)) {
        return Ok(sides);
    }
    let [width, height] = sides.map(|side| side.next_multiple_of(2));
    Err(format!("has an odd side, which H.264 at 4:2:0 does not take; give {width}x{height}"))
}

fn number(text: &str, [low, high]: [f64; 2]) -> Result<f64, String> {
    let number: f64 = text.trim().parse().map_err(|_| "is not a number".to_owned())?;
    match (low..=high).contains(&number) {
        true => Ok(number),
        false => Err(format!("is not from {low} to {high}")),
    }
}

fn rate(text: &str) -> Result<Rate, String> {
    number(text, [0.1, 240.0]).map(Rate::of_hz)
}

fn seconds(text: &str) -> Result<f64, String> {
    number(text, [0.01, 1000.0])
}

fn degrees<const MOST: u16>(text: &str) -> Result<f32, String> {
    let most = f64::from(MOST);
    number(text, [-most, most]).map(|number| number as f32)
}

fn view(text: &str) -> Result<f32, String> {
    number(text, [1.0, 150.0]).map(|number| number as f32)
}

fn place(text: &str) -> Result<[f32; 3], String> {
    let metres = |part| number(part, [-1e6, 1e6]).map(|number| number as f32);
    let numbers: Vec<f32> = text.split(',').map(metres).collect::<Result<_, _>>()?;
    numbers
        .try_into()
        .map_err(|_| "is not three numbers with commas between, such as 3,-3,2".into())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_even_and_the_remedy_is_a_size() {
        assert_eq!(even_size("720x480"), Ok([720, 480]));
        for (text, remedy) in
            [("721x480", "722x480"), ("64x4095", "64x4096"), ("9000x100", "16 to 4096")]
        {
            let error = even_size(text).unwrap_err();
            assert!(error.contains(remedy), "{error}");
        }
        assert!(even_size("720").is_err() && even_size("8x8").is_err());
    }

    #[test]
    fn places_have_three_numbers() {
        assert_eq!(place("1,-2, .5"), Ok([1.0, -2.0, 0.5]));
        for text in ["1,2", "1,2,3,4", "1,2,x", "1,2,inf", "nan,0,0"] {
            assert!(place(text).is_err(), "{text}");
        }
    }
}
