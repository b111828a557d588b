//! What an image sent: decoded, and what is measured apart from what must always be the same.

use anyhow::{Context, Result, bail};
use defmt_decoder::{DecodeError, Table};

/// Lines that begin so end in a number that may change a little with the compiler.
const MEASURED: &str = "INFO measured ";

/// The lines of one image.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Output {
    /// Level and text, line by line.
    pub(super) stable: String,
    /// What was measured and how much, such as `contact.encoder`.
    pub(super) measured: Vec<(String, f64)>,
}

/// Decodes what came over semihosting with the strings of the image's file.
pub(super) fn decode(elf: &[u8], sent: &[u8]) -> Result<Output> {
    let table = Table::parse(elf)?.context("the image has no defmt strings")?;
    let mut decoder = table.new_stream_decoder();
    decoder.received(sent);
    let mut lines = Vec::new();
    loop {
        match decoder.decode() {
            Ok(frame) => {
                let level = frame.level().map_or("-", |level| level.as_str());
                lines.push(format!("{} {}", level.to_uppercase(), frame.display_message()));
            }
            Err(DecodeError::UnexpectedEof) => break,
            Err(DecodeError::Malformed) => bail!("a damaged frame after {lines:#?}"),
        }
    }
    sort(&lines)
}

fn sort(lines: &[String]) -> Result<Output> {
    let mut output = Output::default();
    for line in lines {
        match line.strip_prefix(MEASURED) {
            None => output.stable += &format!("{line}\n"),
            Some(rest) => {
                let (name, number) = rest.rsplit_once(' ').with_context(|| line.clone())?;
                let number = number.parse().with_context(|| line.clone())?;
                output.measured.push((name.replace(' ', "."), number));
            }
        }
    }
    Ok(output)
}

/// The first line of `found` that is not that of `expected`, as a sentence.
pub(super) fn first_difference(expected: &str, found: &str) -> Option<String> {
    let (mut expected, mut found) = (expected.lines(), found.lines());
    for number in 1.. {
        match (expected.next(), found.next()) {
            (None, None) => return None,
            (a, b) if a == b => {}
            (a, b) => {
                let text = |line: Option<&str>| line.unwrap_or("(nothing)").to_owned();
                return Some(format!("line {number}:\n  {}\n  {} (expected)", text(b), text(a)));
            }
        }
    }
    None
}

/// The lines of `host` that `found` does not have, whatever their level.
pub(super) fn missing<'h>(host: &'h str, found: &str) -> Vec<&'h str> {
    let has = |line: &&str| found.lines().any(|found| found.ends_with(line));
    host.lines().filter(|line| !has(line)).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn what_is_measured_is_told_apart() {
        let lines = ["INFO measured contact encoder 12", "ERROR no", "INFO measured ratio 1.5"];
        let output = sort(&lines.map(str::to_owned)).unwrap();
        assert_eq!(output.stable, "ERROR no\n");
        let measured = [("contact.encoder".to_owned(), 12.0), ("ratio".to_owned(), 1.5)];
        assert_eq!(output.measured, measured);
        assert!(sort(&["INFO measured nothing".to_owned()]).is_err());
    }

    #[test]
    fn differences_are_named() {
        assert_eq!(first_difference("a\nb\n", "a\nb\n"), None);
        let text = first_difference("a\nb\n", "a\nc\n").unwrap();
        assert_eq!(text, "line 2:\n  c\n  b (expected)");
        assert!(first_difference("a\nb\n", "a\n").unwrap().contains("(nothing)"));
        assert_eq!(missing("x: 1\ny: 2\n", "INFO y: 2\n"), ["x: 1"]);
    }
}
