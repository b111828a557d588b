//! The tensor directory against the payload.

use crate::header::{Entry, Items};
use crate::layout::padded;
use crate::order::{is_finite, order};
use crate::{DType, FormatError, PANEL, PANEL_DEPTH, Panels, Section, Shape, TensorData};

/// Checks every tensor: order of names, shape, place, padding and values. The number of parameters.
pub(crate) fn check(entries: Items<'_, Entry<'_>>, payload: &[u8]) -> Result<u64, FormatError> {
    let mut previous = "";
    let mut free = 0;
    let mut parameters: u64 = 0;
    for (tensor, entry) in (0..).zip(entries) {
        // Names are not empty, so the first comes after "".
        if entry.name <= previous {
            return Err(FormatError::Order { tensor });
        }
        previous = entry.name;
        let elements = check_size(tensor, &entry)?;
        free = check_place(tensor, entry.offset, entry.byte_length, free, payload)?;
        match (entry.dtype, entry.scales_offset) {
            (DType::I8, Some(offset)) => {
                free = check_place(tensor, offset, entry.scales_bytes(), free, payload)?
            }
            (DType::Panels, Some(offset)) if cfg!(feature = "host") => {
                free = check_place(tensor, offset, entry.scales_bytes(), free, payload)?;
                free = check_place(tensor, free, entry.scales_bytes(), free, payload)?;
            }
            (DType::F32 | DType::F16, None) => {}
            _ => return Err(FormatError::ScalesOffset { tensor }),
        }
        let beyond = FormatError::Beyond { tensor, payload_length: payload.len() as u64 };
        check_values(tensor, entry.shape, entry.data(payload).ok_or(beyond)?)?;
        parameters = parameters.saturating_add(elements);
    }
    let found = payload.len() as u64;
    if found == free {
        Ok(parameters)
    } else {
        Err(FormatError::Unclaimed { expected: free, found })
    }
}

/// Shape against type and length; the number of elements.
fn check_size(tensor: u32, entry: &Entry<'_>) -> Result<u64, FormatError> {
    let matrix = matches!(entry.shape, Shape::Matrix { .. });
    let elements = entry.shape.elements();
    let bytes = match (entry.dtype, entry.shape) {
        (DType::Panels, Shape::Matrix { rows, columns }) if cfg!(feature = "host") => {
            Some(Panels::length(rows.into(), columns.into()))
        }
        (DType::I8 | DType::Panels, _) if !matrix => None,
        (DType::Panels, _) => None,
        _ => elements.checked_mul(entry.dtype.bytes()),
    };
    match bytes {
        Some(expected) if elements > 0 => {
            let found = entry.byte_length;
            if found == expected {
                Ok(elements)
            } else {
                Err(FormatError::Size { tensor, expected, found })
            }
        }
        _ => Err(FormatError::Shape { tensor }),
    }
}

/// Data must begin at the first free boundary, so files have no gap and nothing can overlap; the
/// next free boundary.
fn check_place(
    tensor: u32,
    offset: u64,
    length: u64,
    free: u64,
    payload: &[u8],
) -> Result<u64, FormatError> {
    if offset < free {
        return Err(FormatError::Overlap { tensor, free, found: offset });
    }
    if offset > free {
        return Err(FormatError::Gap { tensor, free, found: offset });
    }
    let next = offset.checked_add(length).and_then(|end| Some((end, padded(end)?)));
    let padding = next.and_then(|(end, next)| slice(payload, end, next.checked_sub(end)?));
    match (next, padding) {
        (Some((_, next)), Some(padding)) if padding.iter().all(|&byte| byte == 0) => Ok(next),
        (Some(_), Some(_)) => Err(FormatError::Padding { section: Section::Payload }),
        _ => Err(FormatError::Beyond { tensor, payload_length: payload.len() as u64 }),
    }
}

fn check_values(tensor: u32, shape: Shape, data: TensorData<'_>) -> Result<(), FormatError> {
    let not_finite = |element| FormatError::NotFinite { tensor, element };
    match data {
        TensorData::F32(values) => {
            first(values, |value| !is_finite(value)).map_or(Ok(()), |at| Err(not_finite(at)))
        }
        TensorData::F16(values) => {
            first(values, |value| !value.is_finite()).map_or(Ok(()), |at| Err(not_finite(at)))
        }
        TensorData::I8 { values, scales } => {
            if let Some(element) = first(values, |value| value == i8::MIN) {
                return Err(FormatError::Asymmetric { tensor, element });
            }
            check_scales(tensor, scales)
        }
        // `data` makes none without the feature; what is not there costs no flash.
        TensorData::Panels(_) if cfg!(not(feature = "host")) => Ok(()),
        TensorData::Panels(panels) => {
            if let Some(element) = first(panels.values, |value| value == i8::MIN) {
                return Err(FormatError::Asymmetric { tensor, element });
            }
            check_scales(tensor, panels.scales)?;
            check_panels(tensor, shape, panels)
        }
    }
}

fn check_scales(tensor: u32, scales: &[f32]) -> Result<(), FormatError> {
    match first(scales, |scale| !(is_finite(scale) && order(scale) > 0)) {
        Some(channel) => Err(FormatError::Scale { tensor, channel }),
        None => Ok(()),
    }
}

/// Padding of zeros, and the sums of what it pads.
fn check_panels(tensor: u32, shape: Shape, panels: Panels<'_>) -> Result<(), FormatError> {
    let Shape::Matrix { columns, .. } = shape else {
        return Err(FormatError::Shape { tensor });
    };
    let groups = (columns as usize).div_ceil(PANEL_DEPTH).max(1);
    // Inputs in the last group of four.
    let rest = (columns as usize).saturating_sub(1).checked_rem(PANEL_DEPTH).unwrap_or_default();
    let (values, _) = panels.values.as_chunks::<{ PANEL * PANEL_DEPTH }>();
    let all = values.chunks(groups).zip(panels.sums.chunks(PANEL));
    for (panel, (groups, stated)) in (0_u64..).zip(all) {
        let mut sums = [0_i32; PANEL];
        let mut bits = [0_i8; PANEL];
        for group in groups {
            let (lanes, _) = group.as_chunks::<PANEL_DEPTH>();
            for ((sum, bits), [a, b, c, d]) in sums.iter_mut().zip(&mut bits).zip(lanes) {
                // At most 16,384 * 8 columns of 127: far from overflow.
                let pairs = (
                    i32::from(*a).wrapping_add(i32::from(*b)),
                    i32::from(*c).wrapping_add(i32::from(*d)),
                );
                *sum = sum.wrapping_add(pairs.0.wrapping_add(pairs.1));
                *bits |= a | b | c | d;
            }
        }
        let last = groups.last().map(|group| group.as_chunks::<PANEL_DEPTH>().0);
        let ragged = |lane: &[i8; PANEL_DEPTH]| lane.iter().skip(rest).skip(1).any(|v| *v != 0);
        let wrong = sums.iter().zip(stated).position(|(found, stated)| found != stated);
        let spare = (0..).zip(&bits).skip(stated.len()).find(|(_, bits)| **bits != 0);
        let lane = wrong
            .or(last.unwrap_or_default().iter().position(ragged))
            .or(spare.map(|(lane, _)| lane));
        if let Some(lane) = lane {
            let channel = panel.saturating_mul(PANEL as u64).saturating_add(lane as u64);
            return Err(FormatError::Panel { tensor, channel });
        }
    }
    Ok(())
}

/// Index of the first value that is `bad`.
fn first<T: Copy>(values: &[T], bad: impl Fn(T) -> bool) -> Option<u64> {
    values.iter().position(|&value| bad(value)).map(|at| at as u64)
}

impl<'a> Entry<'a> {
    /// Length of the scales: one `f32` per row.
    fn scales_bytes(&self) -> u64 {
        match self.shape {
            Shape::Matrix { rows, .. } => u64::from(rows).saturating_mul(4),
            Shape::Scalar | Shape::Vector(_) => 0,
        }
    }

    /// The elements; `None` never happens once `check` has passed.
    pub(crate) fn data(&self, payload: &'a [u8]) -> Option<TensorData<'a>> {
        let values = slice(payload, self.offset, self.byte_length)?;
        Some(match self.dtype {
            DType::F32 => TensorData::F32(bytemuck::try_cast_slice(values).ok()?),
            DType::F16 => TensorData::F16(bytemuck::try_cast_slice(values).ok()?),
            DType::I8 => TensorData::I8 {
                values: bytemuck::try_cast_slice(values).ok()?,
                scales: bytemuck::try_cast_slice(slice(
                    payload,
                    self.scales_offset?,
                    self.scales_bytes(),
                )?)
                .ok()?,
            },
            DType::Panels if cfg!(not(feature = "host")) => return None,
            DType::Panels => {
                let scales = self.scales_offset?;
                let sums = padded(scales.checked_add(self.scales_bytes())?)?;
                TensorData::Panels(Panels {
                    values: bytemuck::try_cast_slice(values).ok()?,
                    scales: bytemuck::try_cast_slice(slice(payload, scales, self.scales_bytes())?)
                        .ok()?,
                    sums: bytemuck::try_cast_slice(slice(payload, sums, self.scales_bytes())?)
                        .ok()?,
                })
            }
        })
    }
}

fn slice(payload: &[u8], offset: u64, length: u64) -> Option<&[u8]> {
    let end = offset.checked_add(length)?;
    payload.get(usize::try_from(offset).ok()?..usize::try_from(end).ok()?)
}
