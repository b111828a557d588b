//! The postcard header: decoded lazily, so that it needs no memory.

use core::marker::PhantomData;

use serde::{Deserialize, Serialize};

#[cfg(feature = "health")]
use crate::layout::{RANGED, VERSION, is_left_out};
use crate::layout::{RESERVED, RULED, fields_of};
use crate::order::is_finite;
use crate::{DType, FormatError, Hidden, MAX_NAME_BYTES, MAX_TENSORS, ModelConfig, Shape};

/// A tensor in the directory; offsets count from the start of the payload.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Entry<'a> {
    pub(crate) name: &'a str,
    pub(crate) dtype: DType,
    pub(crate) shape: Shape,
    pub(crate) offset: u64,
    pub(crate) byte_length: u64,
    /// Only for int8: `f32` per row.
    pub(crate) scales_offset: Option<u64>,
}

/// `count` items of one type, one after another.
#[derive(Debug)]
pub(crate) struct Items<'a, T> {
    rest: &'a [u8],
    count: u32,
    item: PhantomData<fn() -> T>,
}

impl<T> Clone for Items<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Items<'_, T> {}

impl<'a, T: Deserialize<'a>> Iterator for Items<'a, T> {
    type Item = T;

    fn next(&mut self) -> Option<T> {
        self.count = self.count.checked_sub(1)?;
        let (item, rest) = postcard::take_from_bytes(self.rest).ok()?;
        self.rest = rest;
        Some(item)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        (self.count as usize, Some(self.count as usize))
    }
}

/// Exact once `Header::decode` has seen every item.
impl<'a, T: Deserialize<'a>> ExactSizeIterator for Items<'a, T> {}

/// A decoded header whose items all decode again.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Header<'a> {
    pub(crate) name: &'a str,
    pub(crate) config: ModelConfig,
    /// What training saw, if the file says so.
    #[cfg(feature = "health")]
    pub(crate) ranges: Option<crate::Ranges>,
    /// The version that the model is of without its ranges.
    #[cfg(feature = "health")]
    pub(crate) version: u32,
    pub(crate) provenance: Items<'a, (&'a str, &'a str)>,
    pub(crate) metrics: Items<'a, (&'a str, f32)>,
    pub(crate) tensors: Items<'a, Entry<'a>>,
}

impl<'a> Header<'a> {
    /// Checks all but the contents of the tensor directory.
    pub(crate) fn decode(bytes: &'a [u8], version: u32) -> Result<Self, FormatError> {
        let mut cursor = Cursor { rest: bytes, length: bytes.len() };
        let name = cursor.take("name")?;
        text(name_like(name), "model name", 0)?;
        let mut config: ModelConfig = cursor.take("config")?;
        #[cfg(feature = "health")]
        let (has_ranges, version) = match version == RANGED {
            true => (true, cursor.plain_version()?),
            false => (false, version),
        };
        #[cfg(feature = "health")]
        let plain = version;
        #[cfg(feature = "host")]
        if version == 8 {
            config.scope = crate::Scope::Near;
        }
        let version = fields_of(version);
        if version > 1 {
            config.hidden = cursor.take("hidden")?;
        }
        if cfg!(not(feature = "host")) && config.hidden != Hidden::DEFAULT {
            return Err(FormatError::Version { found: version, supported: 1 });
        }
        if version > 2 {
            config.similarity = cursor.take("similarity")?;
        }
        let has_rules = version == RULED;
        if version > 4 && !has_rules {
            config.directions = cursor.take("directions")?;
        }
        #[cfg(feature = "deform")]
        if version > 5 && !has_rules {
            config.elastic = cursor.take("elastic")?;
        }
        #[cfg(feature = "deform")]
        if version > 6 && !has_rules {
            config.bonds = cursor.take("bonds")?;
        }
        if has_rules {
            config.scope = cursor.scope()?;
            cursor.reserved()?;
            config.most_units = cursor.take("most units")?;
        }
        config.validate()?;
        #[cfg(feature = "health")]
        let ranges = if has_ranges { Some(cursor.ranges()?) } else { None };
        let provenance = cursor.items("provenance", |index, (key, value)| {
            text(name_like(key), "provenance key", index)?;
            text(printable(value), "provenance value", index)
        })?;
        let metrics = cursor.items("metrics", |index, (name, value): (&str, f32)| {
            text(name_like(name), "metric", index)?;
            if is_finite(value) { Ok(()) } else { Err(FormatError::Metric { index }) }
        })?;
        // Before the items: the limit holds for what the file claims.
        let found = Cursor { ..cursor }.take("tensors")?;
        if found > MAX_TENSORS {
            return Err(FormatError::TooManyTensors { found, maximum: MAX_TENSORS });
        }
        let tensors = cursor.items("tensors", |index, entry: Entry<'_>| {
            text(name_like(entry.name), "tensor name", index)
        })?;
        if cursor.rest.is_empty() {
            return Ok(Header {
                name,
                config,
                #[cfg(feature = "health")]
                ranges,
                #[cfg(feature = "health")]
                version: plain,
                provenance,
                metrics,
                tensors,
            });
        }
        Err(cursor.error("end of the header"))
    }
}

struct Cursor<'a> {
    rest: &'a [u8],
    length: usize,
}

impl<'a> Cursor<'a> {
    fn error(&self, field: &'static str) -> FormatError {
        FormatError::Header { field, at: self.length.saturating_sub(self.rest.len()) as u32 }
    }

    fn take<T: Deserialize<'a>>(&mut self, field: &'static str) -> Result<T, FormatError> {
        let (value, rest) = postcard::take_from_bytes(self.rest).map_err(|_| self.error(field))?;
        self.rest = rest;
        Ok(value)
    }

    /// Which units the network sees, where the header says so.
    fn scope(&mut self) -> Result<crate::Scope, FormatError> {
        match self.take("scope")? {
            false => Ok(crate::Scope::All),
            #[cfg(feature = "host")]
            true => Ok(crate::Scope::Near),
            // As version 8, which says so by its number.
            #[cfg(not(feature = "host"))]
            true => Err(FormatError::Version { found: RULED, supported: RULED - 1 }),
        }
    }

    /// What is kept free: how contacts differ from rigid ones is a scene's to say.
    fn reserved(&mut self) -> Result<(), FormatError> {
        match self.take("reserved words")? {
            RESERVED => Ok(()),
            _ => Err(FormatError::Reserved),
        }
    }

    /// The version that a model with ranges is of without them.
    #[cfg(feature = "health")]
    fn plain_version(&mut self) -> Result<u32, FormatError> {
        let version = self.take("version without ranges")?;
        match (1..=VERSION).contains(&version) && version != RANGED && !is_left_out(version) {
            true => Ok(version),
            false => Err(FormatError::Version { found: version, supported: VERSION }),
        }
    }

    #[cfg(feature = "health")]
    fn ranges(&mut self) -> Result<crate::Ranges, FormatError> {
        let ranges: crate::Ranges = self.take("ranges")?;
        match ranges.first_bad() {
            Some(index) => Err(FormatError::Range { index: index as u32 }),
            None => Ok(ranges),
        }
    }

    /// A counted list: decodes and checks every item, and returns it for decoding again.
    fn items<T: Deserialize<'a>>(
        &mut self,
        field: &'static str,
        check: impl Fn(u32, T) -> Result<(), FormatError>,
    ) -> Result<Items<'a, T>, FormatError> {
        let count = self.take(field)?;
        let items = Items { rest: self.rest, count, item: PhantomData };
        for index in 0..count {
            check(index, self.take(field)?)?;
        }
        Ok(items)
    }
}

fn text(valid: bool, field: &'static str, index: u32) -> Result<(), FormatError> {
    if valid { Ok(()) } else { Err(FormatError::Text { field, index }) }
}

fn name_like(name: &str) -> bool {
    (1..=MAX_NAME_BYTES).contains(&name.len()) && !name.chars().any(char::is_control)
}

/// Safe to show in a terminal: nothing but line breaks and tabs steers it.
fn printable(value: &str) -> bool {
    !value.chars().any(|c| c.is_control() && c != '\n' && c != '\t')
}
