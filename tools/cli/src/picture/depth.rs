//! What depth cameras see: depths as colours beside the units that are seen.

use rigidformer_core::Role;
use rigidformer_perception::capture::DepthView;

use super::colours::colour;
use super::page::{Align, FAINT, Font, Page, Rgb};

/// Pixels a row that an image is shown with, at most.
const WIDEST: usize = 640;
const GAP: u32 = 24;
/// Height of the line of text above each image.
const LINE: u32 = 28;
/// What is not measured.
const NOTHING: Rgb = [0.10, 0.10, 0.12];
/// Height of the scale of colours below the images.
const SCALE: u32 = 14;
/// From near to far: colours whose lightness falls evenly, so that they can be told apart without colour vision.
const DEPTHS: [Rgb; 6] = [
    [0.99, 0.91, 0.15],
    [0.48, 0.82, 0.32],
    [0.13, 0.66, 0.52],
    [0.16, 0.47, 0.56],
    [0.25, 0.27, 0.53],
    [0.27, 0.00, 0.33],
];

/// A PNG file with a row for each camera: the depths, and the units that are seen.
pub(crate) fn depths(views: &[(String, DepthView)], title: &str) -> anyhow::Result<Vec<u8>> {
    let shown: Vec<Shown<'_>> =
        views.iter().map(|(name, view)| Shown { name, view, step: step(view) }).collect();
    let widest = shown.iter().map(|shown| shown.size()[0]).max().unwrap_or(1) as u32;
    let rows: u32 = shown.iter().map(|shown| LINE + shown.size()[1] as u32 + GAP).sum();
    let width = 2 * widest + 3 * GAP;
    let mut page = Page::new(width, 2 * GAP + LINE + rows + SCALE + LINE + GAP)?;
    page.text(title, (GAP as f32, GAP as f32), Align::Left, Font::TITLE);

    let (near_m, far_m) = range_m(&shown);
    let part = |depth_m: f32| (depth_m - near_m) / (far_m - near_m).max(f32::MIN_POSITIVE);
    let mut y = 2 * GAP + LINE;
    let faint = Font::SMALL.coloured(FAINT);
    for shown in &shown {
        let columns = [GAP, 2 * GAP + widest];
        let texts = [format!("{}: depth", shown.name), format!("{}: units", shown.name)];
        for (text, x) in texts.iter().zip(columns) {
            page.text(text, (x as f32, y as f32), Align::Left, Font::PLAIN);
        }
        let [width, height] = shown.size();
        let of_depth = |at: (u32, u32)| match shown.view.depth_m(at.0, at.1) {
            Some(depth_m) => gradient(part(depth_m)),
            None => NOTHING,
        };
        let of_unit = |at: (u32, u32)| match shown.view.depth_m(at.0, at.1) {
            // Lighter where it is near.
            Some(depth_m) => {
                let own = match shown.label(at) {
                    0 => [0.80, 0.81, 0.83],
                    label => colour(usize::from(label) - 1, Role::Free),
                };
                own.map(|channel| channel * (1.0 - 0.45 * part(depth_m).clamp(0.0, 1.0)))
            }
            None => NOTHING,
        };
        page.image((columns[0], y + LINE), width, &shown.pixels(of_depth));
        page.image((columns[1], y + LINE), width, &shown.pixels(of_unit));
        y += LINE + height as u32 + GAP;
    }
    let bar: Vec<Rgb> = (0..SCALE)
        .flat_map(|_| (0..widest).map(|x| gradient(x as f32 / (widest.max(2) - 1) as f32)))
        .collect();
    page.image((GAP, y), widest as usize, &bar);
    let below = (y + SCALE + 6) as f32;
    page.text(&format!("{near_m:.2} m"), (GAP as f32, below), Align::Left, faint);
    page.text(&format!("{far_m:.2} m"), ((GAP + widest) as f32, below), Align::Right, faint);
    let dark = "dark: not measured; grey: planes";
    page.text(dark, ((2 * GAP + widest) as f32, y as f32), Align::Left, faint);
    page.png()
}

/// An image and how it is thinned out.
struct Shown<'v> {
    name: &'v str,
    view: &'v DepthView,
    step: usize,
}

fn step(view: &DepthView) -> usize {
    (view.camera.size()[0] as usize).div_ceil(WIDEST).max(1)
}

impl Shown<'_> {
    /// As it is shown.
    fn size(&self) -> [usize; 2] {
        self.view.camera.size().map(|side| (side as usize).div_ceil(self.step))
    }

    fn label(&self, (column, row): (u32, u32)) -> u16 {
        let at = row as usize * self.view.camera.size()[0] as usize + column as usize;
        let labels = self.view.labels.as_ref();
        labels.and_then(|labels| labels.get(at)).copied().unwrap_or(0)
    }

    fn pixels(&self, of: impl Fn((u32, u32)) -> Rgb) -> Vec<Rgb> {
        let [width, height] = self.view.camera.size();
        let every = |side: u32| (0..side).step_by(self.step);
        every(height)
            .flat_map(|row| every(width).map(move |column| (column, row)))
            .map(of)
            .collect()
    }
}

/// Nearest and farthest depth of all but the farthest twentieth, which would take up most colours: planes go on to the horizon.
fn range_m(shown: &[Shown<'_>]) -> (f32, f32) {
    let of = |shown: &Shown<'_>| {
        let scale_m = shown.view.scale_m;
        let measured = shown.view.depth.iter().step_by(shown.step).filter(|depth| **depth > 0);
        measured.map(|depth| f32::from(*depth) * scale_m).collect::<Vec<_>>()
    };
    let mut depths: Vec<f32> = shown.iter().flat_map(of).collect();
    depths.sort_by(f32::total_cmp);
    let far = depths.get(depths.len().saturating_sub(1) * 19 / 20);
    (depths.first().copied().unwrap_or(0.0), far.copied().unwrap_or(1.0))
}

/// The colour of a depth, from 0, near, to 1.
fn gradient(part: f32) -> Rgb {
    let last = DEPTHS.len() - 1;
    let at = part.clamp(0.0, 1.0) * last as f32;
    let before = (at as usize).min(last - 1);
    let share = at - before as f32;
    [0, 1, 2].map(|k| DEPTHS[before][k] + (DEPTHS[before + 1][k] - DEPTHS[before][k]) * share)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;
    use rigidformer_perception::camera::Camera;

    #[test]
    fn gradients_go_from_near_to_far_and_stay_there() {
        assert_eq!((gradient(-3.0), gradient(0.0)), (DEPTHS[0], DEPTHS[0]));
        assert_eq!((gradient(1.0), gradient(9.0)), (DEPTHS[5], DEPTHS[5]));
        assert_eq!(gradient(0.4), DEPTHS[2]);
    }

    #[test]
    fn images_of_all_sizes_are_drawn() {
        for size in [[1, 1], [1300, 2]] {
            let camera = Camera::new(size, [100.0; 2], [0.0; 2], Isometry3::identity()).unwrap();
            let pixels = (size[0] * size[1]) as usize;
            let view = DepthView::new(camera, 0.001, vec![0; pixels], None).unwrap();
            let png = depths(&[("one".into(), view)], "title").unwrap();
            assert!(png.starts_with(b"\x89PNG"));
        }
    }
}
