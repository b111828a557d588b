//! `rigidformer rollout --command`: a robot goes where it is told.

use std::sync::atomic::AtomicBool;

use rigidformer_evaluation::pivots::joined;
use rigidformer_evaluation::robots::Pace;
use rigidformer_evaluation::rollout::rollout;
use rigidformer_evaluation::scenes::Dataset;
use rigidformer_runtime::poses::heading;
use rigidformer_runtime::progress::Progress;

use crate::arguments::Rollout;
use crate::commanded::Drive;
use crate::csv_text::CsvText;
use crate::usage::Usage;
use crate::viewers::{Moving, Viewers};
use crate::{contact, defaults, interrupt, output, picture};

/// Where a rollout ends unless told otherwise.
const LAST_FRAME: u32 = 300;
/// Rows of the table, about.
const ROWS: u32 = 10;

pub(crate) fn run(
    arguments: &Rollout,
    dataset: &Dataset,
    index: usize,
    viewers: &Viewers<'_>,
    cancelled: &AtomicBool,
) -> anyhow::Result<()> {
    let (step, command) = (arguments.step_for(dataset), arguments.command.as_slice());
    let wanted = arguments.frames.unwrap_or(LAST_FRAME);
    if wanted < step.saturating_mul(2) {
        let first = step.saturating_mul(2);
        let problem =
            format!("--frames {wanted} with --step {step}: the first prediction is frame {first}");
        return Err(Usage(problem).into());
    }
    if let Some(number) = command.iter().find(|number| !number.is_finite()) {
        return Err(Usage(format!("--command: {number} is no number to go by")).into());
    }
    let last_frame = wanted - wanted % step;
    let loaded = defaults::model(&arguments.model)?.for_host()?;
    let size = loaded.model().config().command_size as usize;
    if command.len() != size {
        let name = loaded.model().file().name();
        let problem = match size {
            0 => format!(
                "--command: the model {name} takes none; leave it out, or give another model"
            ),
            _ => format!("--command has {} numbers, the model {name} takes {size}", command.len()),
        };
        return Err(Usage(problem).into());
    }
    // Frames 0 and S alone are seen.
    let scene = dataset.scene(index, Some(step as usize + 1))?;
    let scene = contact::applied_to(&arguments.contact, scene)?;
    let frames = scene.frames();
    let scene = scene.with_commands(size, command.repeat(frames))?;
    let scene = if arguments.join { joined(scene, step as usize)? } else { scene };
    let bar = output::progress(u64::from(last_frame / step - 1), scene.name());
    let stepped = || bar.inc(1);
    let progress = Progress { cancelled, stepped: &stepped };
    let walk = rollout(&loaded, &scene, step, last_frame, progress)?;
    bar.finish_and_clear();
    let drive = Drive { scene: &scene, walk: &walk, command };
    print(loaded.model().file().name(), &drive)?;

    let mut files = vec![
        (arguments.out.join("poses.csv"), poses_csv(&drive)),
        (arguments.out.join("walk.png"), picture::walk(&drive, &arguments.show)?),
    ];
    if viewers.is_asked() {
        let poses_are = format!("predicted by {}", loaded.model().file().name());
        files.extend(viewers.made(&Moving::of_rollout(&scene, poses_are, &walk))?);
    }
    interrupt::check()?;
    output::folder(&arguments.out)?;
    output::write_results(&files, false)
}

fn print(model: &str, drive: &Drive<'_>) -> anyhow::Result<()> {
    let (walk, leader) = (drive.walk, drive.leader());
    let (step, last) = (walk.step(), walk.last_frame());
    let command: Vec<String> = drive.command.iter().map(f32::to_string).collect();
    output::line(format_args!(
        "{}: {} units, model {model}, command {} from frame {step} on",
        drive.scene.name(),
        drive.scene.units().len(),
        command.join(", ")
    ))?;
    let header = ["time s", "x m", "y m", "heading deg", "forward m/s", "left m/s", "turn rad/s"];
    let mut table = output::table(header);
    let every = (last / step).div_ceil(ROWS).max(1) * step;
    let cells = |time: String, from: u32, to: u32| -> Option<[String; 7]> {
        let place = heading(&walk.pose(to, leader)?);
        let Pace { forward_m_s, left_m_s, turn_rad_s } = drive.pace(from, to);
        Some([
            time,
            format!("{:.2}", place.translation.x),
            format!("{:.2}", place.translation.y),
            format!("{:.0}", place.rotation.scaled_axis().z.to_degrees()),
            format!("{forward_m_s:.2}"),
            format!("{left_m_s:.2}"),
            format!("{turn_rad_s:.2}"),
        ])
    };
    for to in (step + every..=last).step_by(every as usize) {
        if let Some(row) = cells(format!("{:.2}", drive.time_s(to)), to - every, to) {
            output::row(&mut table, row);
        }
    }
    output::table_lines(&table)?;
    // The first third is for taking the command up.
    let from = step + (last - step) / step / 3 * step;
    let Pace { forward_m_s, left_m_s, turn_rad_s } = drive.pace(from, last);
    output::line(format_args!(
        "mean from {:.1} s on: {forward_m_s:.3} m/s forward, {left_m_s:.3} m/s to the left, {turn_rad_s:.3} rad/s",
        drive.time_s(from)
    ))
}

fn poses_csv(drive: &Drive<'_>) -> Vec<u8> {
    let head = ["frame", "time_s", "unit", "x", "y", "z", "qw", "qx", "qy", "qz"];
    let mut csv = CsvText::new(head);
    for (frame, poses) in drive.walk.iter() {
        for (unit, pose) in poses.iter().enumerate() {
            let (t, q) = (pose.translation.vector, pose.rotation.quaternion());
            let head = [frame.to_string(), format!("{:.6}", drive.time_s(frame)), unit.to_string()];
            let numbers = [t.x, t.y, t.z, q.w, q.i, q.j, q.k].map(|number| number.to_string());
            csv.row(head.into_iter().chain(numbers));
        }
    }
    csv.into_bytes()
}
