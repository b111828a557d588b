//! The videos of `rigidformer controls`, decoded by FFmpeg: their size, rate and frames, and how far colours are off.

use std::env;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;

use crate::process::{cargo, line, output, run as run_command};
use crate::report::Report;
use crate::{apt, tools};

const WIDTH: usize = 720;
const HEIGHT: usize = 480;
const FRAMES: usize = 49;
const RATE: &str = "8/1";
/// Levels that a colour may be off which shares its chroma with its like alone: Y'CbCr has fewer levels than red, green and blue.
const ROUNDING: u8 = 3;
/// Part of the colours within that.
const WITHIN: f64 = 0.99;

/// Red, green, blue; frame by frame, row by row.
struct Frames(Vec<u8>);

/// Writes videos of the scene that comes with the program, and compares what FFmpeg makes of them with their frames as PNG.
pub(crate) fn run(report: &mut Report) -> Result<()> {
    if let Err(missing) = apt::ensure(&[tools::FFMPEG]) {
        report.skip(missing);
        return Ok(());
    }
    run_command(cargo().args(["build", "--release", "--package", "rigidformer-cli"]))?;
    let target = env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from);
    let program = target.canonicalize().context("no folder of cargo")?.join("release/rigidformer");
    let folder = tempfile::tempdir()?;
    for (name, shape) in [("squares", &[][..]), ("mesh", &["--mesh"])] {
        for (kind, exactness) in [("4:2:0", &[][..]), ("exact", &["--exact"])] {
            let place = folder.path().join(format!("{name} {kind}").replace(':', ""));
            std::fs::create_dir(&place).context("cannot make a folder")?;
            let mut command = Command::new(&program);
            command.arg("controls").args(shape).args(exactness).current_dir(&place);
            command.args(["--rendered", "rendered.mp4", "--png", "png"]);
            println!("{}", line(&command));
            output(&mut command)?;
            for what in ["tracking", "rendered"] {
                let file = place.join(format!("{what}.mp4"));
                describe(&file, kind == "exact")?;
                let video = decode(file.as_os_str())?;
                let drawn = decode(place.join(format!("png/%05d-{what}.png")).as_os_str())?;
                let found = compare(&drawn, &video, kind == "exact")
                    .with_context(|| format!("{name}, {kind}, {what}"))?;
                let bytes = std::fs::metadata(&file).context("no video")?.len();
                println!("{name}, {kind}, {what}: {bytes} bytes; {found}");
            }
        }
    }
    Ok(())
}

/// Whether FFmpeg says of a file what it must be.
fn describe(file: &Path, is_exact: bool) -> Result<()> {
    let mut command = Command::new("ffprobe");
    command.args(["-v", "error", "-count_frames", "-show_streams", "-of", "json"]).arg(file);
    let text = output(&mut command)?;
    let described: Value = serde_json::from_str(&text).context("ffprobe printed no JSON")?;
    let stream = &described["streams"][0];
    let (profile, format, matrix, range) = match is_exact {
        true => ("High 4:4:4 Predictive", "gbrp", "gbr", "pc"),
        false => ("Constrained Baseline", "yuv420p", "smpte170m", "tv"),
    };
    let frames = FRAMES.to_string();
    for (key, expected) in [
        ("codec_name", "h264"),
        ("profile", profile),
        ("pix_fmt", format),
        ("color_space", matrix),
        ("color_range", range),
        ("r_frame_rate", RATE),
        ("avg_frame_rate", RATE),
        ("nb_frames", &frames),
        ("nb_read_frames", &frames),
    ] {
        ensure!(
            stream[key] == expected,
            "{}: {key} is {}, not {expected}",
            file.display(),
            stream[key]
        );
    }
    let size = [&stream["width"], &stream["height"]].map(Value::as_u64);
    ensure!(size == [Some(WIDTH as u64), Some(HEIGHT as u64)], "{}: {size:?}", file.display());
    Ok(())
}

/// Frames of a video, or of numbered pictures. Anything that FFmpeg has to say is an error.
fn decode(input: &OsStr) -> Result<Frames> {
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "warning", "-xerror", "-nostdin", "-i"]).arg(input);
    command.args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]);
    let decoded = command.output().with_context(|| format!("cannot start `{}`", line(&command)))?;
    let said = String::from_utf8_lossy(&decoded.stderr);
    if !decoded.status.success() || !said.trim().is_empty() {
        bail!("`{}`: {}\n{}", line(&command), decoded.status, said.trim_end());
    }
    let bytes = decoded.stdout.len();
    let expected = FRAMES * WIDTH * HEIGHT * 3;
    ensure!(bytes == expected, "`{}`: {bytes} bytes, not {expected}", line(&command));
    Ok(Frames(decoded.stdout))
}

/// Compares colours: exact ones bit for bit; else those whose neighbours share their chroma with them up to rounding.
fn compare(drawn: &Frames, video: &Frames, is_exact: bool) -> Result<String> {
    let (mut lit, mut alike) = (Vec::new(), Vec::new());
    for at in 0..FRAMES * WIDTH * HEIGHT {
        let (Some(own), Some(found)) = (drawn.pixel(at), video.pixel(at)) else { continue };
        let off = own.iter().zip(found).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or_default();
        if is_exact && off > 0 {
            bail!("pixel {at} is {found:?}, not {own:?}");
        }
        if own != [0; 3] {
            lit.push(off);
        }
        if drawn.has_like_neighbours(at, own) {
            alike.push(off);
        }
    }
    if is_exact {
        return Ok("every bit".into());
    }
    ensure!(!lit.is_empty(), "all is black");
    let within = alike.iter().filter(|off| **off <= ROUNDING).count() as f64;
    let part = within / alike.len().max(1) as f64;
    ensure!(part >= WITHIN, "{part:.3} of the colours beside their like are within {ROUNDING}");
    lit.sort_unstable();
    let most = lit.last().copied().unwrap_or_default();
    let at = |part: usize| lit.get(lit.len() * part / 100).copied().unwrap_or_default();
    let (half, nine) = (at(50), at(90));
    Ok(format!("colours other than black are off by {half} (median), {nine} (90 %), {most} (most)"))
}

impl Frames {
    fn pixel(&self, at: usize) -> Option<&[u8]> {
        self.0.get(3 * at..3 * at + 3)
    }

    /// Whether the four pixels that share their chroma differ by no more than rounding.
    fn has_like_neighbours(&self, at: usize, own: &[u8]) -> bool {
        let (row, column) = (at / WIDTH, at % WIDTH);
        let first = (row - row % 2) * WIDTH + column - column % 2;
        [first, first + 1, first + WIDTH, first + WIDTH + 1].into_iter().all(|other| {
            let pair = self.pixel(other).unwrap_or_default().iter().zip(own);
            pair.into_iter().all(|(a, b)| a.abs_diff(*b) <= 1)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(pixel: impl Fn(usize) -> [u8; 3]) -> Frames {
        Frames((0..FRAMES * WIDTH * HEIGHT).flat_map(pixel).collect())
    }

    #[test]
    fn a_colour_that_is_off_is_an_error() -> Result<()> {
        let drawn = || frames(|at| if at % 3 == 0 { [9, 20, 30] } else { [0; 3] });
        assert!(compare(&drawn(), &drawn(), true).is_ok());
        let off = frames(|at| if at % 3 == 0 { [9, 20, 31] } else { [0; 3] });
        assert!(compare(&drawn(), &off, true).is_err());
        assert!(compare(&frames(|_| [0; 3]), &frames(|_| [0; 3]), false).is_err());
        let flat = |level: u8| frames(move |_| [level; 3]);
        let found = compare(&flat(90), &flat(92), false)?;
        assert!(found.contains("2 (median), 2 (90 %), 2 (most)"), "{found}");
        assert!(compare(&flat(90), &flat(94), false).is_err());
        Ok(())
    }
}
