//! Text from files and command lines as it may reach a terminal: printable characters alone, and no more of them than one reads.

use std::borrow::Cow;
use std::fmt::Write;

/// Characters of a name, at most.
const NAME: usize = 80;
/// Characters without a space that a line has, at most: paths are shorter.
const WORD: usize = 600;
/// Characters of a line, at most.
const LINE: usize = 4000;

/// Whether a terminal may do something other than draw it: controls, and what turns the direction of text or is not seen.
fn is_printable(c: char) -> bool {
    !c.is_control()
        && !matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}' | '\u{61c}' | '\u{180e}')
}

fn escaped(text: &str, is_kept: impl Fn(char) -> bool) -> Cow<'_, str> {
    if text.chars().all(|c| is_printable(c) || is_kept(c)) {
        return Cow::Borrowed(text);
    }
    let mut made = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match is_printable(c) || is_kept(c) {
            true => made.push(c),
            false => made.extend(c.escape_unicode()),
        }
    }
    Cow::Owned(made)
}

/// The first and the last characters of a longer text: its end often says what to do.
fn shortened(text: &str, most: usize) -> Cow<'_, str> {
    // No text has more characters than bytes.
    if text.len() <= most || text.chars().count() <= most {
        return Cow::Borrowed(text);
    }
    let at = |number: usize| text.char_indices().nth(number).map_or(text.len(), |(at, _)| at);
    let last = most / 4;
    let from = text.char_indices().rev().nth(last.max(1) - 1).map_or(0, |(at, _)| at);
    Cow::Owned(format!("{}…{}", &text[..at(most - 1 - last)], &text[from..]))
}

/// A name, a cell of a table or another short text on one line.
pub(crate) fn name(text: &str) -> String {
    // Escapes are longer than what they stand for, so the rest is cut before them.
    let short = shortened(text, NAME);
    escaped(&short, |_| false).into_owned()
}

/// Lines of text.
pub(crate) fn shown(text: &str) -> String {
    let mut made = String::with_capacity(text.len().min(4 * LINE));
    for (number, line) in text.split('\n').enumerate() {
        if number > 0 {
            made.push('\n');
        }
        if line.len() <= WORD {
            made.push_str(&escaped(line, |c| c == '\t'));
            continue;
        }
        let line = escaped(line, |c| c == '\t');
        let words: Vec<_> = line.split(' ').map(|word| shortened(word, WORD)).collect();
        made.push_str(&shortened(&words.join(" "), LINE));
    }
    made
}

/// A JSON document without what its strings may have besides the controls that JSON escapes.
pub(crate) fn escaped_json(text: &str) -> Cow<'_, str> {
    let is_kept = |c: char| is_printable(c) || c == '\n';
    if text.chars().all(is_kept) {
        return Cow::Borrowed(text);
    }
    let mut made = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_kept(c) {
            made.push(c);
            continue;
        }
        for unit in c.encode_utf16(&mut [0; 2]) {
            // Writing to a String does not fail.
            let _ = write!(made, "\\u{unit:04x}");
        }
    }
    Cow::Owned(made)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn controls_are_shown_as_text() {
        for (text, expected) in [
            ("\u{1b}[2J", "\\u{1b}[2J"),
            ("\u{1b}]52;c;eA==\u{7}", "\\u{1b}]52;c;eA==\\u{7}"),
            ("\u{9b}31m \u{7f}", "\\u{9b}31m \\u{7f}"),
            ("a\u{202e}b\u{2066}c\u{200b}", "a\\u{202e}b\\u{2066}c\\u{200b}"),
            ("a\rb", "a\\u{d}b"),
            ("würfel 立方体 🎲", "würfel 立方体 🎲"),
        ] {
            assert_eq!(shown(text), expected);
            assert_eq!(name(text), expected);
        }
        assert_eq!(shown("a\n\tb"), "a\n\tb");
        assert_eq!(name("a\n\tb"), "a\\u{a}\\u{9}b");
    }

    #[test]
    fn what_is_long_keeps_its_ends() {
        let long = format!("ä{}z", "x".repeat(100_000));
        let found = name(&long);
        assert_eq!(found.chars().count(), NAME);
        assert!(found.starts_with("äx") && found.contains('…') && found.ends_with("xz"));
        let found = shown(&format!("file: {long}: give another"));
        assert!(found.starts_with("file: ä") && found.ends_with("z: give another"), "{found}");
        assert!(found.chars().count() < WORD + 40);
        assert!(shown(&"word ".repeat(100_000)).chars().count() <= LINE);
    }

    #[test]
    fn json_stays_json() {
        let value = serde_json::json!({ "name": "\u{7f}\u{9b}\u{202e}\u{1b}\u{e0041}ü" });
        let text = serde_json::to_string_pretty(&value).unwrap();
        let text = escaped_json(&text);
        assert!(text.chars().all(|c| is_printable(c) || c == '\n'), "{text}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap(), value);
    }
}
