//! The words of a page as its reader meets them.

use std::ops::Range;

use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};

/// What a block of text is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A paragraph, or an item of a list.
    Prose,
    /// A heading, or a cell of a table: not of sentences.
    Label,
}

/// A word between white space; a code span is part of one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Word {
    /// As the page shows it.
    pub(super) shown: String,
    /// Without code.
    plain: String,
    /// From 1.
    pub(super) line: usize,
}

impl Word {
    /// Lower case, without code and punctuation.
    pub(super) fn bare(&self) -> String {
        self.plain.trim_matches(|letter: char| !letter.is_alphanumeric()).to_lowercase()
    }

    /// A dash, an arrow or an operator is none.
    fn counts(&self) -> bool {
        self.shown.chars().any(char::is_alphanumeric)
    }

    fn ends_sentence(&self) -> bool {
        let closers = ['"', '\'', ')', ']', '”', '’'];
        let text = self.shown.trim_end_matches(closers);
        let is_short = ABBREVIATIONS.contains(&text.trim_start_matches(['(', '[']));
        text.ends_with(['.', '?', '!']) && !is_short
    }
}

/// Their full stops end no sentence.
const ABBREVIATIONS: [&str; 6] = ["e.g.", "i.e.", "cf.", "vs.", "al.", "approx."];

/// Words without a paragraph's end between them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Block {
    pub(super) kind: Kind,
    pub(super) words: Vec<Word>,
}

impl Block {
    /// The sentences of prose.
    pub(super) fn sentences(&self) -> impl Iterator<Item = &[Word]> {
        let words: &[Word] = if self.kind == Kind::Prose { &self.words } else { &[] };
        words.split_inclusive(Word::ends_sentence)
    }
}

/// How many words a sentence has.
pub(super) fn length(sentence: &[Word]) -> usize {
    sentence.iter().filter(|word| word.counts()).count()
}

/// The blocks of a page in order. Code blocks, HTML, pictures and the targets of links are in none.
pub(super) fn blocks(text: &str) -> Vec<Block> {
    let options = Options::ENABLE_TABLES | Options::ENABLE_FOOTNOTES | Options::ENABLE_TASKLISTS;
    let mut reader = Reader::new(text);
    for (event, range) in Parser::new_ext(text, options).into_offset_iter() {
        reader.take(event, range);
    }
    reader.end_block();
    reader.blocks
}

struct Reader {
    /// Where lines begin.
    starts: Vec<usize>,
    kind: Kind,
    /// Code blocks and pictures that are open.
    silent: usize,
    word: Word,
    words: Vec<Word>,
    blocks: Vec<Block>,
}

impl Reader {
    fn new(text: &str) -> Self {
        let breaks = text.match_indices('\n').map(|(at, _)| at + 1);
        Reader {
            starts: [0].into_iter().chain(breaks).collect(),
            kind: Kind::Prose,
            silent: 0,
            word: Word::default(),
            words: Vec::new(),
            blocks: Vec::new(),
        }
    }

    fn take(&mut self, event: Event, range: Range<usize>) {
        match event {
            Event::Start(Tag::CodeBlock(_) | Tag::Image { .. } | Tag::HtmlBlock) => {
                // A picture stands within a block.
                if !matches!(event, Event::Start(Tag::Image { .. })) {
                    self.end_block();
                }
                self.silent += 1;
            }
            Event::End(TagEnd::CodeBlock | TagEnd::Image | TagEnd::HtmlBlock) => self.silent -= 1,
            Event::Start(Tag::Heading { .. } | Tag::TableCell) => self.begin(Kind::Label),
            Event::Start(Tag::Paragraph | Tag::Item | Tag::FootnoteDefinition(_)) => {
                self.begin(Kind::Prose);
            }
            Event::End(
                TagEnd::Heading(_)
                | TagEnd::TableCell
                | TagEnd::Paragraph
                | TagEnd::Item
                | TagEnd::List(_)
                | TagEnd::FootnoteDefinition,
            ) => self.begin(Kind::Prose),
            Event::Text(text) if self.silent == 0 => self.text(&text, range.start),
            Event::Code(code) if self.silent == 0 => {
                self.letters(&format!("`{code}`"), range.start);
            }
            Event::SoftBreak | Event::HardBreak => self.end_word(),
            _ => {}
        }
    }

    fn begin(&mut self, kind: Kind) {
        self.end_block();
        self.kind = kind;
    }

    fn text(&mut self, text: &str, start: usize) {
        for (at, part) in text.split(char::is_whitespace).enumerate() {
            if at > 0 {
                self.end_word();
            }
            self.letters(part, start);
            if !part.is_empty() {
                self.word.plain.push_str(part);
            }
        }
    }

    fn letters(&mut self, letters: &str, start: usize) {
        if self.word.shown.is_empty() {
            self.word.line = self.starts.partition_point(|line| *line <= start);
        }
        self.word.shown.push_str(letters);
    }

    fn end_word(&mut self) {
        let word = std::mem::take(&mut self.word);
        if !word.shown.is_empty() {
            self.words.push(word);
        }
    }

    fn end_block(&mut self) {
        self.end_word();
        let words = std::mem::take(&mut self.words);
        if !words.is_empty() {
            self.blocks.push(Block { kind: self.kind, words });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sentences(text: &str) -> Vec<String> {
        let shown = |sentence: &[Word]| {
            let words: Vec<&str> = sentence.iter().map(|word| word.shown.as_str()).collect();
            words.join(" ")
        };
        blocks(text)
            .iter()
            .flat_map(|block| block.sentences().map(shown).collect::<Vec<_>>())
            .collect()
    }

    #[test]
    fn prose_is_paragraphs_and_items() {
        let text = "# A heading. Here\n\nOne two\nthree. `four. five` six (e.g. seven).\n\n- an item\n- \
            [another](x.md#a-b-c) one: `a b`.\n  - inner\n\n```sh\nno prose.\n```\n\n| a | b |\n|---|---|\n| c. d | e |\n\n\
            ![alt text](i.png)\n<!-- table: x -->\nEnd\n";
        let expected = [
            "One two three.",
            "`four. five` six (e.g. seven).",
            "an item",
            "another one: `a b`.",
            "inner",
        ];
        let found = sentences(text);
        assert_eq!(found[..5], expected);
        assert!(!found.concat().contains("alt"), "{found:?}");
        assert!(!found.concat().contains("table"), "{found:?}");
        let labels: Vec<Block> =
            blocks(text).into_iter().filter(|block| block.kind == Kind::Label).collect();
        assert_eq!(labels.len(), 5);
    }

    #[test]
    fn words_know_their_lines_and_code_is_one_word() {
        let found = blocks("A\n\nb - `c d e` f\n**g.** h\n");
        let words = &found[1].words;
        assert_eq!(words.iter().map(|word| word.line).collect::<Vec<_>>(), [3, 3, 3, 3, 4, 4]);
        let lengths: Vec<usize> = found[1].sentences().map(length).collect();
        assert_eq!(lengths, [4, 1]);
        assert_eq!(words[2].bare(), "");
        assert_eq!(words[4].bare(), "g");
    }
}
