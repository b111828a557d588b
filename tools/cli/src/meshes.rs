//! Meshes from files, in metres.

use std::path::Path;

use rigidformer_runtime::files;
use rigidformer_runtime::memory::Budget;
use rigidformer_runtime::mesh::{self, Format, Group};

use crate::output;

/// Sizes of what a robot handles, metres; others are a doubt about the unit of length.
const LIKELY_M: std::ops::RangeInclusive<f32> = 1e-4..=50.0;

/// The groups of a mesh's file, at least one, all with faces.
pub(crate) fn read(path: &Path, scale: f32) -> anyhow::Result<Vec<Group>> {
    let bytes = files::read_whole(path)?;
    let groups = mesh::read(&bytes, Format::of(path), &mut Budget::default())
        .map_err(|error| anyhow::anyhow!("{}: {error}", path.display()))?;
    let groups: Vec<Group> =
        groups.into_iter().map(|group| Group { mesh: group.mesh.scaled(scale), ..group }).collect();
    let finite = |group: &Group| group.mesh.points.iter().all(|p| p.iter().all(|v| v.is_finite()));
    anyhow::ensure!(
        groups.iter().all(finite),
        "{}: --scale {scale} makes lengths that are no numbers; give another",
        path.display()
    );
    if let Some(doubt) = doubt(&groups, scale) {
        output::note(&format!("{}: {doubt}", path.display()));
    }
    Ok(groups)
}

/// What is odd about its size, in words.
fn doubt(groups: &[Group], scale: f32) -> Option<String> {
    let points = || groups.iter().flat_map(|group| &group.mesh.points);
    let first = *points().next()?;
    let (low, high) =
        points().fold((first, first), |(low, high), point| (low.inf(point), high.sup(point)));
    let size = (high - low).amax();
    if LIKELY_M.contains(&size) {
        return None;
    }
    Some(match size > *LIKELY_M.end() {
        true => format!("is {size} m long; is it in millimetres? --scale {}", scale * 1e-3),
        false => format!("is {size} m long, less than a grain of sand; give a larger --scale"),
    })
}
