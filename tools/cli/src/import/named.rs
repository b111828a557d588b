//! Names of units: options of the form NAME=NUMBERS, and lists of names.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use rigidformer_runtime::files::shown as one_line;

use crate::usage::Usage;

/// Every unit that has no own.
const REST: &str = "*";
/// Names of units that an error lists, at most.
const MOST_NAMES: usize = 12;

/// Values of units by name.
#[derive(Debug)]
pub(super) struct Named<T> {
    of: BTreeMap<String, (&'static str, T)>,
}

impl<T> Default for Named<T> {
    fn default() -> Self {
        Self { of: BTreeMap::new() }
    }
}

impl<T> Named<T> {
    pub(super) fn add(
        &mut self,
        option: &'static str,
        name: String,
        value: T,
    ) -> Result<(), Usage> {
        match self.of.insert(name.clone(), (option, value)) {
            None => Ok(()),
            Some((before, _)) => Err(Usage(format!(
                "{option} {name}: was given by {before} already; give one of them"
            ))),
        }
    }

    /// What was said of the unit itself.
    pub(super) fn own(&self, name: &str) -> Option<&T> {
        self.of.get(name).map(|(_, value)| value)
    }

    /// What was said of every unit that has no own.
    pub(super) fn rest(&self) -> Option<&T> {
        self.own(REST)
    }

    pub(super) fn get(&self, name: &str) -> Option<&T> {
        self.own(name).or_else(|| self.rest())
    }

    /// Options and the units that they name.
    pub(super) fn names(&self) -> impl Iterator<Item = (&'static str, &str)> {
        let named = self.of.iter().filter(|(name, _)| name.as_str() != REST);
        named.map(|(name, (option, _))| (*option, name.as_str()))
    }
}

/// `NAME=1,2,3`
pub(super) fn numbers<const N: usize>(
    option: &str,
    text: &str,
) -> Result<(String, [f32; N]), Usage> {
    match text.rsplit_once('=') {
        Some((name, numbers)) if !name.is_empty() => Ok((name.to_owned(), row(option, numbers)?)),
        _ => Err(Usage(format!("{option} {text}: write the unit's name, =, and {N} numbers"))),
    }
}

/// `1,2,3`
pub(super) fn row<const N: usize>(option: &str, text: &str) -> Result<[f32; N], Usage> {
    let numbers: Option<Vec<f32>> = text
        .split(',')
        .map(|part| part.trim().parse().ok().filter(|number: &f32| number.is_finite()))
        .collect();
    numbers.and_then(|numbers| numbers.try_into().ok()).ok_or_else(|| {
        Usage(format!("{option} {text}: takes {N} finite numbers with commas between"))
    })
}

/// A recording that has none of the units of `--unit`, but these.
pub(super) fn none_wanted<'n>(path: &Path, names: impl Iterator<Item = &'n str>) -> anyhow::Error {
    let (shown, names) = (path.display(), listed(names));
    anyhow::anyhow!("{shown}: has none of the units of --unit; it has {names}")
}

/// The first names, in order.
pub(super) fn listed<'n>(names: impl Iterator<Item = &'n str>) -> String {
    let names: BTreeSet<&str> = names.collect();
    let shown: Vec<String> = names.iter().take(MOST_NAMES).map(|name| one_line(name, 80)).collect();
    match names.len() > MOST_NAMES {
        true => format!("{} and others", shown.join(", ")),
        false => shown.join(", "),
    }
}
