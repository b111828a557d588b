//! What rollouts have cost, so that they need not be computed again.

use std::collections::BTreeMap;

const HEAD: &str = "rigidformer-calibration 1";

/// Costs that are known, of one calibration: the same scenes, model and settings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Memo {
    /// By the bits of the numbers.
    means: BTreeMap<Vec<u32>, f64>,
    /// (scenes) Likewise.
    scenes: BTreeMap<Vec<u32>, Vec<f64>>,
}

/// What is wrong with the text of a memo.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MemoError {
    /// It is no memo.
    #[error("is not the state of a calibration; name another file, or one that does not exist yet")]
    Foreign,
    /// It is of another calibration.
    #[error(
        "is the state of another calibration: other scenes, another model or other options; give those, or name another file"
    )]
    Other,
    /// A line is damaged.
    #[error("line {line} is damaged; remove the file, to begin again")]
    Damaged {
        /// The line, from 1.
        line: usize,
    },
}

impl Memo {
    /// Rollouts that it knows.
    pub fn len(&self) -> usize {
        self.means.len() + self.scenes.len()
    }

    /// Whether it knows none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub(super) fn mean(&self, key: &[u32]) -> Option<f64> {
        self.means.get(key).copied()
    }

    pub(super) fn keep_mean(&mut self, key: Vec<u32>, cost: f64) {
        self.means.insert(key, cost);
    }

    pub(super) fn scenes(&self, key: &[u32]) -> Option<&[f64]> {
        self.scenes.get(key).map(Vec::as_slice)
    }

    pub(super) fn keep_scenes(&mut self, key: Vec<u32>, costs: Vec<f64>) {
        self.scenes.insert(key, costs);
    }

    /// As text, of the calibration that `of` tells from others.
    pub fn text(&self, of: u64) -> String {
        let mut text = format!("{HEAD} {of:016x}\n");
        let mut line = |kind: &str, key: &[u32], costs: &[f64]| {
            text += kind;
            // Bits are exact, and digits may not be.
            key.iter().for_each(|bits| text += &format!(" {bits:08x}"));
            text += " =";
            costs.iter().for_each(|cost| text += &format!(" {:016x}", cost.to_bits()));
            text.push('\n');
        };
        self.means.iter().for_each(|(key, cost)| line("mean", key, &[*cost]));
        self.scenes.iter().for_each(|(key, costs)| line("scenes", key, costs));
        text
    }

    /// From the text of the same calibration.
    ///
    /// # Errors
    /// [`MemoError`]
    pub fn parse(text: &str, of: u64) -> Result<Memo, MemoError> {
        let mut lines = text.lines();
        let head =
            lines.next().and_then(|line| line.strip_prefix(HEAD)).ok_or(MemoError::Foreign)?;
        let of_text =
            u64::from_str_radix(head.trim(), 16).map_err(|_| MemoError::Damaged { line: 1 })?;
        if of_text != of {
            return Err(MemoError::Other);
        }
        let mut memo = Memo::default();
        for (line, text) in (2..).zip(lines) {
            memo.take(text).ok_or(MemoError::Damaged { line })?;
        }
        Ok(memo)
    }

    fn take(&mut self, line: &str) -> Option<()> {
        let (numbers, costs) = line.split_once(" =")?;
        let mut words = numbers.split_ascii_whitespace();
        let kind = words.next()?;
        let key: Option<Vec<u32>> = words.map(|word| u32::from_str_radix(word, 16).ok()).collect();
        let cost = |word: &str| {
            let cost = f64::from_bits(u64::from_str_radix(word, 16).ok()?);
            cost.is_finite().then_some(cost)
        };
        let costs: Option<Vec<f64>> = costs.split_ascii_whitespace().map(cost).collect();
        match (kind, costs?.as_slice()) {
            ("mean", [cost]) => drop(self.means.insert(key?, *cost)),
            ("scenes", costs) => drop(self.scenes.insert(key?, costs.to_vec())),
            _ => return None,
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_keeps_all_bits() {
        let mut memo = Memo::default();
        memo.keep_mean(vec![1, u32::MAX], 1.0 / 3.0);
        memo.keep_mean(vec![2, 0], 1e-300);
        memo.keep_scenes(vec![1, 2], vec![0.1, 0.2, 0.3]);
        let text = memo.text(77);
        assert_eq!(Memo::parse(&text, 77), Ok(memo));
        assert_eq!(Memo::parse(&text, 78), Err(MemoError::Other));
        assert_eq!(Memo::parse("", 1), Err(MemoError::Foreign));
        assert_eq!(Memo::parse("friction = 1", 1), Err(MemoError::Foreign));
        let damaged =
            |line: &str| Memo::parse(&format!("{HEAD} 1\nmean 1 = 3ff0000000000000\n{line}\n"), 1);
        for line in [
            "mean 1 =",
            "mean 1 2",
            "x 1 = 0",
            "mean g = 0",
            "mean 1 = 7ff0000000000000",
            "scenes 1 = 0 z",
        ] {
            assert_eq!(damaged(line), Err(MemoError::Damaged { line: 3 }), "{line}");
        }
    }
}
