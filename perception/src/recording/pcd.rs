//! Clouds as PCD files, versions 0.5 to 0.7: ascii, binary, and compressed by LZF.
//!
//! No crate does it: pcd-rs 0.13 panics where the sizes of a compressed file disagree with its header, and allocates what that says.

use nalgebra::Point3;
use rigidformer_runtime::memory::Budget;

use super::error::CaptureProblem;
use super::numbers::{Kind, Number, label};
use super::points::{MAX_POINTS, Points, Read, count, number as parsed, shortened};

/// Lines of a header, at most.
// The format has ten; comments may add some.
const MAX_LINES: usize = 64;
/// Bytes of a point, and of a header's line, at most.
// It bounds what a hostile header makes the reader allocate.
const MAX_RECORD: usize = 4096;
/// Largest ratio of LZF's output to its input.
// Three bytes give 264 at most.
const MAX_GROWTH: usize = 88;

/// One field of a point.
#[derive(Clone, Copy)]
struct Field {
    number: Number,
    count: usize,
}

impl Field {
    fn bytes(&self) -> usize {
        self.number.size() * self.count
    }
}

/// Position of a field that is read.
#[derive(Clone, Copy)]
struct FieldLayout {
    field: Field,
    /// Index among the numbers of a point.
    token: usize,
    /// Bytes of all fields before it.
    before: usize,
}

struct Header<'b> {
    axes: [FieldLayout; 3],
    label: Option<FieldLayout>,
    points: usize,
    /// Bytes of a point.
    record: usize,
    /// Numbers of a point.
    tokens: usize,
    sensor: Option<Point3<f64>>,
    data: &'b str,
    payload: &'b [u8],
}

/// Reads the points of a PCD file.
pub(super) fn read(bytes: &[u8], budget: &mut Budget) -> Result<Points, CaptureProblem> {
    let header = header(bytes)?;
    // Once as they are read, and once in the cloud; a point has a byte of the file at least, or a 264th part of one where it is packed.
    count(budget, header.points)?;
    count(budget, header.points)?;
    let points: Vec<_> = match header.data {
        "ascii" => ascii(&header)?,
        "binary" => {
            let all =
                header.points.checked_mul(header.record).and_then(|all| header.payload.get(..all));
            let all = all.ok_or_else(|| damaged("it ends before its last point"))?;
            let rows = all.chunks_exact(header.record);
            rows.map(|row| point(&header, |field| field.field.number.read(row, field.before)))
                .collect()
        }
        "binary_compressed" => {
            budget.take((header.points as u64).saturating_mul(header.record as u64))?;
            let all = decompressed(&header)?;
            // The compressed layout is field by field, each with all points.
            let at = |index: usize, field: &FieldLayout| {
                let start = field.before * header.points + index * field.field.bytes();
                field.field.number.read(&all, start)
            };
            (0..header.points).map(|index| point(&header, |field| at(index, field))).collect()
        }
        other => return Err(damaged(&format!("its data are {other:?}"))),
    };
    let is_single =
        header.data != "ascii" && header.axes.iter().any(|axis| axis.field.number.size() == 4);
    Ok(Points { points, is_labelled: header.label.is_some(), is_single, sensor: header.sensor })
}

fn damaged(why: &str) -> CaptureProblem {
    CaptureProblem::Cloud { format: "PCD", why: shortened(why.into()) }
}

fn point(header: &Header<'_>, number: impl Fn(&FieldLayout) -> f64) -> Read {
    let point_m = Point3::from([0, 1, 2].map(|axis: usize| number(&header.axes[axis])));
    (point_m, header.label.as_ref().map_or(0, |field| label(number(field))))
}

fn header(bytes: &[u8]) -> Result<Header<'_>, CaptureProblem> {
    let (mut names, mut sizes, mut kinds, mut counts) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut width, mut height, mut given, mut sensor) = (None, None, None, None);
    let mut rest = bytes;
    for _ in 0..MAX_LINES {
        let Some(end) = rest.iter().take(MAX_RECORD).position(|byte| *byte == b'\n') else {
            break;
        };
        let (line, after) = rest.split_at(end);
        rest = after.get(1..).unwrap_or_default();
        let Ok(line) = std::str::from_utf8(line) else { break };
        let mut words = line.split('#').next().unwrap_or_default().split_ascii_whitespace();
        let Some(key) = words.next() else { continue };
        let words: Vec<&str> = words.collect();
        let numbers = || -> Result<Vec<usize>, CaptureProblem> {
            let parsed = words.iter().map(|word| word.parse().ok()).collect::<Option<Vec<usize>>>();
            parsed.ok_or_else(|| damaged(&format!("{key} is not of whole numbers")))
        };
        match key {
            "FIELDS" | "COLUMNS" => names = words,
            "SIZE" => sizes = numbers()?,
            "TYPE" => kinds = words,
            "COUNT" => counts = numbers()?,
            "WIDTH" => width = numbers()?.first().copied(),
            "HEIGHT" => height = numbers()?.first().copied(),
            "POINTS" => given = numbers()?.first().copied(),
            "VIEWPOINT" => sensor = viewpoint(&words),
            "DATA" => {
                let data = words.first().copied().unwrap_or_default();
                if counts.is_empty() {
                    counts = vec![1; names.len()];
                }
                let fields = fields(&names, &sizes, &kinds, &counts)?;
                let product = width
                    .zip(height)
                    .and_then(|(width, height): (usize, usize)| width.checked_mul(height));
                let points = given
                    .or(product)
                    .ok_or_else(|| damaged("it does not say how many POINTS it has"))?;
                // A header that contradicts itself leaves the layout open.
                if product.is_some_and(|product| product != points) {
                    return Err(damaged("POINTS is not WIDTH times HEIGHT"));
                }
                if points as u64 > MAX_POINTS {
                    return Err(CaptureProblem::TooManyPoints {
                        points: points as u64,
                        most: MAX_POINTS,
                    });
                }
                return layout(&names, &fields, points, sensor, data, rest);
            }
            _ => {}
        }
    }
    Err(damaged("it has no header that ends with DATA"))
}

fn fields(
    names: &[&str],
    sizes: &[usize],
    kinds: &[&str],
    counts: &[usize],
) -> Result<Vec<Field>, CaptureProblem> {
    if [sizes.len(), kinds.len(), counts.len()].iter().any(|len| *len != names.len()) {
        return Err(damaged("FIELDS, SIZE, TYPE and COUNT are not equally many"));
    }
    let of = sizes.iter().zip(kinds).zip(counts);
    of.map(|((size, kind), count)| {
        let of_kind = match *kind {
            "F" => Some(Kind::Float),
            "I" => Some(Kind::Signed),
            "U" => Some(Kind::Unsigned),
            _ => None,
        };
        // A field of no numbers takes no bytes: PCL writes some as padding.
        let count = *count;
        let number = of_kind.and_then(|of_kind| Number::new(of_kind, *size));
        match number.filter(|_| count <= MAX_RECORD) {
            Some(number) => Ok(Field { number, count }),
            None => Err(damaged(&format!("a field of type {kind:?}, size {size}, count {count}"))),
        }
    })
    .collect()
}

fn layout<'b>(
    names: &[&str],
    fields: &[Field],
    points: usize,
    sensor: Option<Point3<f64>>,
    data: &'b str,
    payload: &'b [u8],
) -> Result<Header<'b>, CaptureProblem> {
    let (mut record, mut tokens) = (0, 0);
    let (mut axes, mut label) = ([None; 3], None);
    for (name, field) in names.iter().zip(fields) {
        // A coordinate of no numbers is none.
        let layout = (field.count > 0).then_some(FieldLayout {
            field: *field,
            token: tokens,
            before: record,
        });
        match *name {
            "x" => axes[0] = layout,
            "y" => axes[1] = layout,
            "z" => axes[2] = layout,
            "label" => label = layout,
            _ => {}
        }
        record += field.bytes();
        tokens += field.count;
        if record > MAX_RECORD {
            return Err(damaged("its points have more than 4096 bytes"));
        }
    }
    let [Some(x), Some(y), Some(z)] = axes else { return Err(CaptureProblem::NoCoordinates) };
    Ok(Header { axes: [x, y, z], label, points, record, tokens, sensor, data, payload })
}

/// Position of the sensor; none for the identity, which PCL writes where it is unknown.
fn viewpoint(words: &[&str]) -> Option<Point3<f64>> {
    let numbers: Vec<f64> = words.iter().map_while(|word| word.parse().ok()).collect();
    let [x, y, z, w, i, j, k] = *numbers.as_slice() else { return None };
    let nothing = [x, y, z, w, i, j, k] == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
    let is_sound = numbers.iter().all(|number| number.is_finite());
    (is_sound && !nothing).then(|| Point3::new(x, y, z))
}

fn ascii(header: &Header<'_>) -> Result<Vec<Read>, CaptureProblem> {
    let text = std::str::from_utf8(header.payload).map_err(|_| damaged("its data are not text"))?;
    let mut points = Vec::new();
    let lines = text.lines().filter(|line| !line.trim().is_empty());
    for (index, line) in lines.take(header.points).enumerate() {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let number = |field: &FieldLayout| words.get(field.token).and_then(|word| parsed(word));
        let fields = header.axes.iter().chain(&header.label);
        if words.len() != header.tokens || fields.clone().any(|field| number(field).is_none()) {
            return Err(damaged(&format!("point {index} has not {} numbers", header.tokens)));
        }
        points.push(point(header, |field| number(field).unwrap_or(f64::NAN)));
    }
    if points.len() < header.points {
        return Err(damaged("it ends before its last point"));
    }
    Ok(points)
}

fn decompressed(header: &Header<'_>) -> Result<Vec<u8>, CaptureProblem> {
    let size = |at: usize| -> Option<usize> {
        let four: [u8; 4] = header.payload.get(at..at + 4)?.try_into().ok()?;
        usize::try_from(u32::from_le_bytes(four)).ok()
    };
    let short = || damaged("it ends before its last point");
    let (packed, whole) = size(0).zip(size(4)).ok_or_else(short)?;
    let input =
        packed.checked_add(8).and_then(|end| header.payload.get(8..end)).ok_or_else(short)?;
    if Some(whole) != header.points.checked_mul(header.record) {
        return Err(damaged("its compressed data are of another size than its points"));
    }
    // The allocation is bounded by the length of the file.
    if whole > packed.saturating_mul(MAX_GROWTH) {
        return Err(damaged("its compressed data are too short for its points"));
    }
    lzf(input, whole).ok_or_else(|| damaged("its compressed data are damaged"))
}

/// Marc Lehmann's LZF: runs of literals, and copies from up to 8192 bytes before.
fn lzf(input: &[u8], whole: usize) -> Option<Vec<u8>> {
    let mut output = Vec::with_capacity(whole);
    let mut bytes = input.iter().copied();
    while let Some(control) = bytes.next() {
        let control = usize::from(control);
        if control < 32 {
            let before = output.len();
            output.extend(bytes.by_ref().take(control + 1));
            if output.len() != before + control + 1 {
                return None;
            }
        } else {
            let mut length = control >> 5;
            if length == 7 {
                length += usize::from(bytes.next()?);
            }
            let back = ((control & 31) << 8) + usize::from(bytes.next()?) + 1;
            let start = output.len().checked_sub(back)?;
            for at in start..start + length + 2 {
                // Source and destination may overlap, so bytes are copied one by one.
                output.push(*output.get(at)?);
            }
        }
        if output.len() > whole {
            return None;
        }
    }
    (output.len() == whole).then_some(output)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lzf_undoes_what_the_format_says() {
        // "abc" as literals, then five bytes from three back.
        assert_eq!(lzf(&[2, b'a', b'b', b'c', 3 << 5, 2], 8).unwrap(), b"abcabcab");
        // A long run of one byte: 7 + 10 + 2 copies.
        assert_eq!(lzf(&[0, b'x', 7 << 5, 10, 0], 20).unwrap(), [b'x'; 20]);
        assert_eq!(lzf(&[2, b'a'], 3), None, "literals that end early");
        assert_eq!(lzf(&[0, b'a', 3 << 5, 1], 6), None, "from before the beginning");
        assert_eq!(lzf(&[0, b'a'], 2), None, "too short");
        assert_eq!(lzf(&[2, b'a', b'b', b'c'], 2), None, "too long");
        assert!(lzf(&[], 0).unwrap().is_empty());
    }
}
