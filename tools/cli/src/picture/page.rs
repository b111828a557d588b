//! A sheet to draw on: lines, areas and text.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use tiny_skia::{
    Color, FillRule, Paint, PathBuilder, Pixmap, PremultipliedColorU8, Rect, Stroke, Transform,
};

/// Red, green, blue from 0 to 1.
pub(crate) type Rgb = [f32; 3];

#[cfg(feature = "examples")]
pub(super) const WHITE: Rgb = [1.0, 1.0, 1.0];
pub(super) const INK: Rgb = [0.13, 0.15, 0.19];
pub(super) const FAINT: Rgb = [0.42, 0.45, 0.50];
pub(super) const RULE: Rgb = [0.88, 0.89, 0.91];

/// Of an image's channel: half of what a file could tell apart, which nobody sees, make it a fifth smaller.
const TONES: f32 = 127.0;

/// Where a text's position is on it.
#[derive(Clone, Copy)]
pub(super) enum Align {
    Left,
    Centre,
    Right,
}

/// How a text looks.
#[derive(Clone, Copy)]
pub(super) struct Font {
    pub(super) weight: FontWeight,
    pub(super) height: RasterHeight,
    pub(super) colour: Rgb,
}

impl Font {
    pub(super) const SMALL: Font =
        Font { weight: FontWeight::Regular, height: RasterHeight::Size16, colour: FAINT };
    pub(super) const PLAIN: Font =
        Font { weight: FontWeight::Regular, height: RasterHeight::Size20, colour: INK };
    pub(super) const BOLD: Font =
        Font { weight: FontWeight::Bold, height: RasterHeight::Size20, colour: INK };
    pub(super) const TITLE: Font =
        Font { weight: FontWeight::Bold, height: RasterHeight::Size24, colour: INK };

    pub(super) fn coloured(self, colour: Rgb) -> Font {
        Font { colour, ..self }
    }

    pub(super) fn width(self, text: &str) -> f32 {
        (text.chars().count() * get_raster_width(self.weight, self.height)) as f32
    }
}

/// A sheet of pixels, white at first.
pub(super) struct Page {
    pixmap: Pixmap,
}

impl Page {
    pub(super) fn new(width: u32, height: u32) -> anyhow::Result<Page> {
        let mut pixmap = Pixmap::new(width, height)
            .ok_or_else(|| anyhow::anyhow!("a picture of {width} x {height} pixels"))?;
        pixmap.fill(Color::WHITE);
        Ok(Page { pixmap })
    }

    pub(super) fn png(&self) -> anyhow::Result<Vec<u8>> {
        // No pixel is see-through, so a quarter of the bytes says nothing.
        let pixels: Vec<u8> = self
            .pixmap
            .pixels()
            .iter()
            .flat_map(|pixel| [pixel.red(), pixel.green(), pixel.blue()])
            .collect();
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.pixmap.width(), self.pixmap.height());
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_compression(png::Compression::High);
        // Of plain areas, soft shades and text together none makes the least of it.
        encoder.set_filter(png::Filter::NoFilter);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&pixels)?;
        writer.finish()?;
        Ok(bytes)
    }

    pub(super) fn fill(&mut self, [x, y, width, height]: [f32; 4], colour: Rgb) {
        if let Some(rect) = Rect::from_xywh(x, y, width, height) {
            self.pixmap.fill_rect(rect, &paint(colour, 1.0), Transform::identity(), None);
        }
    }

    /// A line through points, with round corners.
    pub(super) fn line(
        &mut self,
        points: impl IntoIterator<Item = (f32, f32)>,
        width: f32,
        colour: Rgb,
    ) {
        let stroke = Stroke {
            width,
            line_cap: tiny_skia::LineCap::Round,
            line_join: tiny_skia::LineJoin::Round,
            ..Stroke::default()
        };
        if let Some(path) = path(points, false) {
            self.pixmap.stroke_path(
                &path,
                &paint(colour, 1.0),
                &stroke,
                Transform::identity(),
                None,
            );
        }
    }

    pub(super) fn area(
        &mut self,
        points: impl IntoIterator<Item = (f32, f32)>,
        colour: Rgb,
        opacity: f32,
    ) {
        if let Some(path) = path(points, true) {
            let paint = paint(colour, opacity);
            self.pixmap.fill_path(&path, &paint, FillRule::Winding, Transform::identity(), None);
        }
    }

    pub(super) fn dot(&mut self, (x, y): (f32, f32), radius: f32, colour: Rgb) {
        if let Some(path) = PathBuilder::from_circle(x, y, radius) {
            self.pixmap.fill_path(
                &path,
                &paint(colour, 1.0),
                FillRule::Winding,
                Transform::identity(),
                None,
            );
        }
    }

    /// One line of text with its top at `y`. Characters beyond Latin-1 become question marks.
    pub(super) fn text(&mut self, text: &str, (x, y): (f32, f32), align: Align, font: Font) {
        let mut left = match align {
            Align::Left => x,
            Align::Centre => x - font.width(text) / 2.0,
            Align::Right => x - font.width(text),
        };
        for character in text.chars() {
            let raster = get_raster(character, font.weight, font.height)
                .or_else(|| get_raster('?', font.weight, font.height));
            let Some(raster) = raster else { continue };
            for (row, pixels) in raster.rows().enumerate() {
                for (column, coverage) in pixels.iter().enumerate() {
                    let at = (left.round() as i64 + column as i64, y.round() as i64 + row as i64);
                    self.blend(at, font.colour, f32::from(*coverage) / 255.0);
                }
            }
            left += raster.width() as f32;
        }
    }

    /// Puts pixels, (height, width) row by row, with their top left corner at `(x, y)`.
    pub(super) fn image(&mut self, (x, y): (u32, u32), width: usize, pixels: &[Rgb]) {
        for (row, pixels) in pixels.chunks_exact(width.max(1)).enumerate() {
            for (column, colour) in pixels.iter().enumerate() {
                let colour = colour.map(|channel| (channel * TONES).round() / TONES);
                self.blend((i64::from(x) + column as i64, i64::from(y) + row as i64), colour, 1.0);
            }
        }
    }

    fn blend(&mut self, (x, y): (i64, i64), colour: Rgb, opacity: f32) {
        let (width, height) = (i64::from(self.pixmap.width()), i64::from(self.pixmap.height()));
        if !(0..width).contains(&x) || !(0..height).contains(&y) || opacity <= 0.0 {
            return;
        }
        let Some(pixel) = self.pixmap.pixels_mut().get_mut((y * width + x) as usize) else {
            return;
        };
        let mix = |under: u8, over: f32| {
            (f32::from(under) * (1.0 - opacity) + over * 255.0 * opacity).round() as u8
        };
        let [red, green, blue] = colour;
        let mixed = [mix(pixel.red(), red), mix(pixel.green(), green), mix(pixel.blue(), blue)];
        // The page is opaque everywhere.
        if let Some(opaque) = PremultipliedColorU8::from_rgba(mixed[0], mixed[1], mixed[2], 255) {
            *pixel = opaque;
        }
    }
}

fn paint([red, green, blue]: Rgb, opacity: f32) -> Paint<'static> {
    let colour = Color::from_rgba(red, green, blue, opacity).unwrap_or(Color::BLACK);
    Paint { shader: tiny_skia::Shader::SolidColor(colour), anti_alias: true, ..Paint::default() }
}

fn path(points: impl IntoIterator<Item = (f32, f32)>, close: bool) -> Option<tiny_skia::Path> {
    let mut builder = PathBuilder::new();
    for (index, (x, y)) in points.into_iter().enumerate() {
        if index == 0 { builder.move_to(x, y) } else { builder.line_to(x, y) }
    }
    if close {
        builder.close();
    }
    builder.finish()
}
