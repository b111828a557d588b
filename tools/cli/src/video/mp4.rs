//! MP4 (ISO/IEC 14496-12 and -15) with one track of H.264. All tables stand before the frames, so that players can begin at once.

use super::h264::{Parameters, colour_codes};
use super::kind::Rate;
use super::planes::Colours;

/// Of the film; the track counts thousandths of a frame.
const TICKS_PER_S: u32 = 1000;
const TICKS_PER_FRAME: u32 = 1000;
/// No turn: a matrix in 16.16, the last column in 2.30.
const IDENTITY: [u32; 9] = [0x1_0000, 0, 0, 0, 0x1_0000, 0, 0, 0, 0x4000_0000];

pub(super) struct Track<'t> {
    pub(super) size: [u32; 2],
    pub(super) rate: Rate,
    /// (frames) Bytes.
    pub(super) sizes: &'t [u32],
    pub(super) parameters: &'t Parameters,
    pub(super) colours: Colours,
}

/// Numbers of several widths, one after another.
#[derive(Default)]
struct Body(Vec<u8>);

impl Body {
    fn bytes(mut self, bytes: &[u8]) -> Body {
        self.0.extend_from_slice(bytes);
        self
    }

    fn u16s(self, numbers: &[u16]) -> Body {
        numbers.iter().fold(self, |body, number| body.bytes(&number.to_be_bytes()))
    }

    fn u32s(self, numbers: &[u32]) -> Body {
        numbers.iter().fold(self, |body, number| body.bytes(&number.to_be_bytes()))
    }

    fn boxed(self, kind: &[u8; 4]) -> Vec<u8> {
        let length = (self.0.len() + 8) as u32;
        [&length.to_be_bytes()[..], kind, &self.0].concat()
    }
}

fn of(boxes: &[&[u8]]) -> Body {
    Body(boxes.concat())
}

/// All before the frames.
pub(super) fn head(track: &Track<'_>) -> Vec<u8> {
    let brands = Body::default().bytes(b"isom").u32s(&[0x200]).bytes(b"isomiso2avc1mp41");
    let mut head = brands.boxed(b"ftyp");
    // Where the frames begin is in a table, whose length does not depend on it.
    let length = head.len() + movie(track, 0).len() + 16;
    head.extend(movie(track, length as u32));
    // With a length of 64 bits: long videos of large pictures may need it.
    let frames: u64 = track.sizes.iter().map(|size| u64::from(*size)).sum();
    head.extend(Body::default().u32s(&[1]).bytes(b"mdat").bytes(&(frames + 16).to_be_bytes()).0);
    head
}

fn movie(track: &Track<'_>, frames_at: u32) -> Vec<u8> {
    let frames = track.sizes.len() as u32;
    let thousandths = u64::from(track.rate.thousandths.max(1));
    let ticks = u64::from(frames) * u64::from(TICKS_PER_S) * 1000 / thousandths;
    let ticks = u32::try_from(ticks).unwrap_or(u32::MAX);
    let movie = Body::default().u32s(&[0, 0, 0, TICKS_PER_S, ticks, 0x1_0000]);
    let movie = movie.u16s(&[0x100, 0]).u32s(&[0, 0]).u32s(&IDENTITY).u32s(&[0; 6]).u32s(&[2]);
    of(&[&movie.boxed(b"mvhd"), &whole_track(track, frames_at, ticks)]).boxed(b"moov")
}

fn whole_track(track: &Track<'_>, frames_at: u32, ticks: u32) -> Vec<u8> {
    let frames = track.sizes.len() as u32;
    // Enabled, and part of the film.
    let header = Body::default().u32s(&[3, 0, 0, 1, 0, ticks, 0, 0]).u16s(&[0; 4]).u32s(&IDENTITY);
    let header = header.u32s(&track.size.map(|side| side << 16)).boxed(b"tkhd");
    let duration = frames.saturating_mul(TICKS_PER_FRAME);
    let media = Body::default().u32s(&[0, 0, 0, track.rate.thousandths, duration]);
    // "und": no language.
    let media = media.u16s(&[0x55C4, 0]).boxed(b"mdhd");
    let handler = Body::default().u32s(&[0, 0]).bytes(b"vide").u32s(&[0; 3]).bytes(b"video\0");
    let own = Body::default().u32s(&[1]).boxed(b"url ");
    let references = Body::default().u32s(&[0, 1]).bytes(&own).boxed(b"dref");
    let video = Body::default().u32s(&[1]).u16s(&[0; 4]).boxed(b"vmhd");
    let data = of(&[&references]).boxed(b"dinf");
    let table = samples(track, frames_at);
    let information = of(&[&video, &data, &table]).boxed(b"minf");
    let media = of(&[&media, &handler.boxed(b"hdlr"), &information]).boxed(b"mdia");
    of(&[&header, &media]).boxed(b"trak")
}

/// What frames are, when each is shown, how long it is, and where.
fn samples(track: &Track<'_>, frames_at: u32) -> Vec<u8> {
    let frames = track.sizes.len() as u32;
    let description = Body::default().u32s(&[0, 1]).bytes(&description(track)).boxed(b"stsd");
    let times = Body::default().u32s(&[0, 1, frames, TICKS_PER_FRAME]).boxed(b"stts");
    // The first one depends on no other.
    let keys = Body::default().u32s(&[0, 1, 1]).boxed(b"stss");
    let chunks = Body::default().u32s(&[0, 1, 1, frames, 1]).boxed(b"stsc");
    let sizes = Body::default().u32s(&[0, 0, frames]).u32s(track.sizes).boxed(b"stsz");
    let places = Body::default().u32s(&[0, 1, frames_at]).boxed(b"stco");
    of(&[&description, &times, &keys, &chunks, &sizes, &places]).boxed(b"stbl")
}

fn description(track: &Track<'_>) -> Vec<u8> {
    let [width, height] = track.size.map(|side| side as u16);
    let entry = Body::default().u16s(&[0, 0, 0, 1]).u32s(&[0; 4]).u16s(&[width, height]);
    // 72 dots an inch, one frame a sample, no name, 24 bits a pixel.
    let entry = entry.u32s(&[0x48_0000, 0x48_0000, 0]).u16s(&[1]).bytes(&[0; 32]);
    let entry = entry.u16s(&[24, 0xFFFF]);
    let (codes, is_full) = colour_codes(track.colours);
    let colours = Body::default().bytes(b"nclx").u16s(&codes.map(u16::from));
    let colours = colours.bytes(&[u8::from(is_full) << 7]).boxed(b"colr");
    let square = Body::default().u32s(&[1, 1]).boxed(b"pasp");
    entry.bytes(&configuration(track)).bytes(&colours).bytes(&square).boxed(b"avc1")
}

/// The parameter sets; before each unit stands its length, four bytes.
fn configuration(track: &Track<'_>) -> Vec<u8> {
    let Parameters { profile, sequence, picture } = track.parameters;
    let body = Body::default().bytes(&[1]).bytes(profile).bytes(&[0xFF, 0xE1]);
    let body = body.u16s(&[sequence.len() as u16]).bytes(sequence);
    let body = body.bytes(&[1]).u16s(&[picture.len() as u16]).bytes(picture);
    // Of profiles with other chroma: 4:4:4, 8 bits, no further parameter sets.
    let more: &[u8] = if track.colours == Colours::Exact { &[0xFF, 0xF8, 0xF8, 0] } else { &[] };
    body.bytes(more).boxed(b"avcC")
}
