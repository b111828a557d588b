//! Arguments of `rigidformer render`.

use std::path::PathBuf;

use clap::Args;

#[derive(Args)]
#[command(after_help = "\
Writes into DIR, which must not exist or be empty:
  frames.json                  cameras, and the times and files of their images (docs/SENSORS.md)
  00000-camera1.png            depths, 16-bit grey, millimetres; 0: nothing was measured
  00000-camera1-labels.png     which unit is seen, counted from 1; 0: none
  preview.png                  the first capture, for people

Cameras look at the middle of the units at the first frame, from 1.5 times the distance at which all of them fill the image, 35 degrees
down, with a view of 60 degrees; several stand 120 degrees apart. Units are the hulls of their points, or their convex pieces. Between
recorded frames poses are interpolated. The error of a depth z has the standard deviation MM x z^2, z in metres; pixels beside a
step in depth are lost with a probability. The same seed gives the same images.

Examples:
  rigidformer render --out seen
  rigidformer render movi-a.safetensors --index 3 --cameras 2 --rate 30 --deviation-mm 3 --out seen
  rigidformer render --bowl 0.005 --step-mm 2 --wave-mm 1 --out kinect
  rigidformer render movi-a.safetensors --deviation-mm 0 --edge-loss 0 --size 320x240 --seconds 0.5 --out seen --json")]
pub(crate) struct Render {
    /// Scene file [default: a scene that comes with the program]
    pub(crate) scene: Option<PathBuf>,
    /// Which scene of the file, from 0 [default: its first of the test split, else its first]
    #[arg(long, value_name = "I")]
    pub(crate) index: Option<usize>,
    /// Cameras around the scene
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=3))]
    pub(crate) cameras: u8,
    /// Captures a second
    #[arg(long, value_name = "HZ", default_value_t = 30.0, value_parser = some)]
    pub(crate) rate: f32,
    /// Seconds from the first frame on [default: the whole record]
    #[arg(long, value_name = "S", value_parser = some)]
    pub(crate) seconds: Option<f32>,
    /// Standard deviation of depths where the units are, millimetres; it grows with the square of the depth
    #[arg(long, value_name = "MM", default_value_t = 1.0, allow_hyphen_values = true, value_parser = up_to::<1000>)]
    pub(crate) deviation_mm: f32,
    /// Share of the pixels beside a step in depth that are lost
    #[arg(long, value_name = "SHARE", default_value_t = 0.3, value_parser = up_to::<1>)]
    pub(crate) edge_loss: f32,
    /// Share by which depths are too large in the corners; it grows with the square of the distance from the middle, and is .005 typically
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = up_to::<1>)]
    pub(crate) bowl: f32,
    /// Step between the depths that are measured, where the units are, millimetres; it grows with the square of the depth
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = up_to::<1000>)]
    pub(crate) step_mm: f32,
    /// Standard deviation of an error that is smooth over a sixteenth of the image, where the units are, millimetres; it grows with the
    /// square of the depth and stays from capture to capture
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = up_to::<1000>)]
    pub(crate) wave_mm: f32,
    /// Another seed, other noise
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub(crate) seed: u64,
    /// Columns and rows of the images
    #[arg(long, value_name = "WxH", default_value = "640x480", value_parser = image_size)]
    pub(crate) size: [u32; 2],
    /// Folder to write
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Print one JSON document instead of a table
    #[arg(long)]
    pub(crate) json: bool,
}

/// Hertz, or seconds.
fn some(text: &str) -> Result<f32, String> {
    let number: f32 = text.parse().map_err(|_| "is not a number".to_owned())?;
    if (0.01..=1000.0).contains(&number) {
        Ok(number)
    } else {
        Err("is not from 0.01 to 1000".into())
    }
}

fn up_to<const MOST: u16>(text: &str) -> Result<f32, String> {
    let number: f32 = text.parse().map_err(|_| "is not a number".to_owned())?;
    let range = 0.0..=f32::from(MOST);
    if range.contains(&number) { Ok(number) } else { Err(format!("is not from 0 to {MOST}")) }
}

fn image_size(text: &str) -> Result<[u32; 2], String> {
    size(text, 8192)
}

/// Sides from 16 to so many pixels.
pub(super) fn size(text: &str, most: u32) -> Result<[u32; 2], String> {
    let sides = text.split_once('x').map(|(width, height)| [width, height].map(str::parse::<u32>));
    match sides {
        Some([Ok(width), Ok(height)])
            if [width, height].iter().all(|s| (16..=most).contains(s)) =>
        {
            Ok([width, height])
        }
        _ => {
            Err(format!("is not two numbers from 16 to {most} with an x between, such as 640x480"))
        }
    }
}
