//! Typed access to the tensors of a safetensors file: every length proven before it is used.

use std::cell::RefCell;
use std::path::Path;

use rigidformer_runtime::memory::Budget;
use safetensors::tensor::{Dtype, Metadata};

use super::{Problem, SceneError};

/// A safetensors file whose header is proven to describe exactly `bytes`.
pub(super) struct Tensors<'a> {
    path: &'a Path,
    payload: &'a [u8],
    header: Metadata,
    /// What the file's contents take besides the file.
    budget: RefCell<Budget>,
}

/// Bytes that a byte of the header takes in memory.
// An entry `"a":{"dtype":"U8","shape":[0],"data_offsets":[0,0]}` has 57 and takes about 300: a name twice, two tables.
const HEADER_GROWTH: u64 = 6;

impl<'a> Tensors<'a> {
    pub(super) fn parse(path: &'a Path, bytes: &'a [u8]) -> Result<Self, SceneError> {
        let fail = |problem: String| error(path, "file", Problem::NotSafetensors(problem));
        // safetensors calls an empty file a header that is too short, which helps nobody.
        if bytes.is_empty() {
            return Err(fail("it is empty".into()));
        }
        let mut budget = Budget::default();
        let length = bytes.first_chunk().map_or(0, |length| u64::from_le_bytes(*length));
        // A header that is longer than the file is refused below.
        let length = length.min(bytes.len() as u64);
        budget
            .take((bytes.len() as u64).saturating_add(length.saturating_mul(HEADER_GROWTH)))
            .map_err(|large| error(path, "file", large.into()))?;
        let (header_bytes, header) = safetensors::SafeTensors::read_metadata(bytes)
            .map_err(|error| fail(error.to_string()))?;
        // The header's length takes 8 bytes before it.
        let payload = bytes.get(header_bytes.saturating_add(8)..).unwrap_or_default();
        Ok(Self { path, payload, header, budget: RefCell::new(budget) })
    }

    pub(super) fn fail(&self, field: impl Into<String>, problem: Problem) -> SceneError {
        error(self.path, field, problem)
    }

    /// Counts so many values that are about to be made of `field`.
    pub(super) fn count<T>(&self, field: &str, values: usize) -> Result<(), SceneError> {
        let counted = self.budget.borrow_mut().take_all::<T>(values);
        counted.map_err(|large| self.fail(field, large.into()))
    }

    /// A metadata entry.
    pub(super) fn entry(&self, name: &str) -> Result<&str, SceneError> {
        let entries = self.header.metadata().as_ref();
        let entry = entries.and_then(|entries| entries.get(name));
        entry
            .map(String::as_str)
            .ok_or_else(|| self.fail(format!("metadata {name}"), Problem::Missing))
    }

    /// Whether a metadata entry is there.
    pub(super) fn has_entry(&self, name: &str) -> bool {
        self.header.metadata().as_ref().is_some_and(|entries| entries.contains_key(name))
    }

    /// A metadata entry that must be one of some texts, `expected` in words: which one it is.
    pub(super) fn require<const N: usize>(
        &self,
        name: &str,
        texts: [&str; N],
        expected: &'static str,
    ) -> Result<usize, SceneError> {
        // An entry that is missing is a foreign file too, and the text says so.
        let found = self.entry(name).unwrap_or("nothing").to_owned();
        let index = texts.iter().position(|text| *text == found);
        index.ok_or_else(|| {
            self.fail(format!("metadata {name}"), Problem::Foreign { found, expected })
        })
    }

    /// Whether a tensor is there.
    pub(super) fn has(&self, name: &str) -> bool {
        self.header.info(name).is_some()
    }

    /// A metadata entry of `N` finite numbers with blanks between.
    pub(super) fn numbers<const N: usize>(
        &self,
        name: &str,
        expected: &'static str,
    ) -> Result<[f32; N], SceneError> {
        let found = self.entry(name)?;
        let numbers: Option<Vec<f32>> = found
            .split_whitespace()
            .map(|word| word.parse::<f32>().ok().filter(|v| v.is_finite()))
            .collect();
        numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| {
            self.fail(
                format!("metadata {name}"),
                Problem::Unparsable { found: found.into(), expected },
            )
        })
    }

    /// A tensor of type `dtype` and a shape in which `None` stands for any size: its shape and bytes.
    fn tensor<const R: usize>(
        &self,
        name: &str,
        dtype: Dtype,
        expected: [Option<usize>; R],
    ) -> Result<([usize; R], &'a [u8]), SceneError> {
        let field = || format!("tensor {name}");
        let info = self.header.info(name).ok_or_else(|| self.fail(field(), Problem::Missing))?;
        let wrong = || {
            let sizes: Vec<String> = expected
                .iter()
                .map(|size| size.map_or("any".into(), |size| size.to_string()))
                .collect();
            Problem::WrongTensor {
                found: format!("{:?} of shape {:?}", info.dtype, info.shape),
                expected: format!("{dtype:?} of shape [{}]", sizes.join(", ")),
            }
        };
        let shape: [usize; R] =
            info.shape.as_slice().try_into().map_err(|_| self.fail(field(), wrong()))?;
        let fits = shape
            .iter()
            .zip(&expected)
            .all(|(found, wanted)| wanted.is_none_or(|wanted| wanted == *found));
        if !fits || info.dtype != dtype {
            return Err(self.fail(field(), wrong()));
        }
        let (start, end) = info.data_offsets;
        let bytes =
            self.payload.get(start..end).ok_or_else(|| self.fail(field(), Problem::Missing))?;
        Ok((shape, bytes))
    }

    pub(super) fn f32<const R: usize>(
        &self,
        name: &str,
        shape: [Option<usize>; R],
    ) -> Result<([usize; R], Vec<f32>), SceneError> {
        let (shape, bytes) = self.tensor(name, Dtype::F32, shape)?;
        self.count::<u8>(name, bytes.len())?;
        let values: Vec<f32> = elements(bytes).map(f32::from_le_bytes).collect();
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            // Errors name the row, which a user can look up, and not the element.
            let columns = shape.iter().skip(1).product::<usize>().max(1);
            return Err(self.bad_value(name, at / columns, values[at], "finite"));
        }
        Ok((shape, values))
    }

    pub(super) fn i64<const R: usize>(
        &self,
        name: &str,
        shape: [Option<usize>; R],
    ) -> Result<([usize; R], Vec<i64>), SceneError> {
        let (shape, bytes) = self.tensor(name, Dtype::I64, shape)?;
        self.count::<u8>(name, bytes.len())?;
        Ok((shape, elements(bytes).map(i64::from_le_bytes).collect()))
    }

    pub(super) fn i32<const R: usize>(
        &self,
        name: &str,
        shape: [Option<usize>; R],
    ) -> Result<([usize; R], Vec<i32>), SceneError> {
        let (shape, bytes) = self.tensor(name, Dtype::I32, shape)?;
        self.count::<u8>(name, bytes.len())?;
        Ok((shape, elements(bytes).map(i32::from_le_bytes).collect()))
    }

    pub(super) fn u8<const R: usize>(
        &self,
        name: &str,
        shape: [Option<usize>; R],
    ) -> Result<([usize; R], Vec<u8>), SceneError> {
        let (shape, bytes) = self.tensor(name, Dtype::U8, shape)?;
        self.count::<u8>(name, bytes.len())?;
        Ok((shape, bytes.to_vec()))
    }

    /// Where an F32 tensor's payload lies within the file, unread.
    pub(super) fn f32_range<const R: usize>(
        &self,
        name: &str,
        shape: [Option<usize>; R],
        file: &[u8],
    ) -> Result<([usize; R], std::ops::Range<usize>), SceneError> {
        let (shape, bytes) = self.tensor(name, Dtype::F32, shape)?;
        // Offsets in the header count from the payload, and callers slice the file.
        let payload_start = file.len().saturating_sub(self.payload.len());
        let start = self
            .header
            .info(name)
            .map_or(0, |info| info.data_offsets.0)
            .saturating_add(payload_start);
        Ok((shape, start..start.saturating_add(bytes.len())))
    }

    /// An I64 tensor whose `rows + 1` values rise strictly from 0 to `total`.
    pub(super) fn offsets(
        &self,
        name: &str,
        rows: usize,
        total: usize,
    ) -> Result<Vec<usize>, SceneError> {
        let (_, values) = self.i64(name, [rows.checked_add(1)])?;
        self.count::<usize>(name, values.len())?;
        // A negative offset becomes one beyond the end, which the checks below refuse.
        let offsets: Vec<usize> =
            values.iter().map(|value| usize::try_from(*value).unwrap_or(usize::MAX)).collect();
        // Rows that rise strictly leave no scene and no shape empty.
        let rises = offsets.first() == Some(&0)
            && offsets.last() == Some(&total)
            && offsets.iter().zip(offsets.iter().skip(1)).all(|(a, b)| a < b);
        if rises {
            Ok(offsets)
        } else {
            Err(self.fail(format!("tensor {name}"), Problem::NotRising { total }))
        }
    }

    /// An I64 tensor whose `rows + 1` values go from 0 to `total` without going back.
    pub(super) fn ascending_offsets(
        &self,
        name: &str,
        rows: usize,
        total: usize,
    ) -> Result<Vec<usize>, SceneError> {
        let (_, values) = self.i64(name, [rows.checked_add(1)])?;
        self.count::<usize>(name, values.len())?;
        let mut offsets: Vec<usize> = Vec::with_capacity(values.len());
        for (row, value) in values.iter().enumerate() {
            let before = offsets.last().copied().unwrap_or(0);
            // Equal neighbours are allowed here: a scene may have no planes and a shape no pieces.
            let fits = |offset: &usize| {
                (before..=total).contains(offset)
                    && (row > 0 || *offset == 0)
                    && (row < rows || *offset == total)
            };
            let Some(offset) = usize::try_from(*value).ok().filter(fits) else {
                let problem = Problem::NotAscending { row, value: *value, total };
                return Err(self.fail(format!("tensor {name}"), problem));
            };
            offsets.push(offset);
        }
        Ok(offsets)
    }

    pub(super) fn bad_value(
        &self,
        name: &str,
        row: usize,
        value: impl ToString,
        expected: &'static str,
    ) -> SceneError {
        self.fail(
            format!("tensor {name}"),
            Problem::BadValue { row, value: value.to_string(), expected },
        )
    }
}

pub(super) fn error(path: &Path, field: impl Into<String>, problem: Problem) -> SceneError {
    SceneError { path: path.into(), field: field.into(), problem }
}

/// The little-endian elements of `bytes`; a remainder, which the header check excludes, is ignored.
pub(super) fn elements<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> + '_ {
    bytes.as_chunks::<N>().0.iter().copied()
}
