//! The pages: how many words they have, how long their sentences are, and which words they leave out.

mod page;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};
use clap::Args;
use comfy_table::presets::ASCII_MARKDOWN;
use comfy_table::{CellAlignment, ContentArrangement, Table};
use serde::Deserialize;

use crate::process::output;
use crate::{site, tables};
use page::{Block, Word};

/// Limits and forbidden phrases.
const RULES: &str = "tools/xtask/docs.toml";
/// It has what was, release by release, and grows.
const EXEMPT: &str = "CHANGELOG.md";
/// Words of a sentence that an error shows.
const SHOWN: usize = 12;

/// Of `cargo xtask docs`.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct Options {
    /// Prints the words of each page beside its limit, and checks nothing.
    #[arg(long)]
    words: bool,
    /// Checks these pages alone, and neither the total nor links.
    pages: Vec<String>,
}

/// Checks every tracked page but CHANGELOG.md, and lists all faults.
pub(crate) fn run(options: &Options) -> Result<()> {
    let rules = Rules::read()?;
    let pages = read(&options.pages)?;
    if options.words {
        println!("{}", table(&rules, &pages));
        return Ok(());
    }
    let mut faults: Vec<String> =
        pages.iter().flat_map(|(path, text)| rules.faults(path, text)).collect();
    if options.pages.is_empty() {
        faults.extend(rules.strangers(&pages));
        faults.extend(rules.total(&pages));
        faults.extend(tables::check().err().map(|error| format!("{error:#}")));
        faults.extend(site::check_links().err().map(|error| error.to_string()));
    }
    if !faults.is_empty() {
        bail!("{}\n{} faults; {RULES} has the rules", faults.join("\n"), faults.len());
    }
    let total: usize = pages.values().map(|text| words(text)).sum();
    println!("{} pages, {total} words", pages.len());
    Ok(())
}

/// Texts by path: the pages that are named, or all.
fn read(named: &[String]) -> Result<BTreeMap<String, String>> {
    let tracked = output(Command::new("git").args(["ls-files", "*.md"]))?;
    let all = tracked.lines().filter(|path| *path != EXEMPT && Path::new(path).exists());
    let all: Vec<&str> = all.collect();
    if let Some(stranger) = named.iter().find(|path| !all.contains(&path.as_str())) {
        bail!(
            "{stranger} is no tracked page; name pages from the repository's root, such as docs/USING.md"
        );
    }
    let chosen =
        all.into_iter().filter(|path| named.is_empty() || named.iter().any(|name| name == path));
    let text = |path: &str| {
        let text = fs::read_to_string(path).with_context(|| format!("cannot read {path}"))?;
        Ok((path.to_owned(), text))
    };
    chosen.map(text).collect()
}

/// As `wc -w` counts them.
fn words(text: &str) -> usize {
    text.split_whitespace().count()
}

fn table(rules: &Rules, pages: &BTreeMap<String, String>) -> String {
    let mut table = Table::new();
    table.load_style(ASCII_MARKDOWN);
    table.set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["page", "words", "at most", "too many"]);
    let mut add = |name: &str, words: usize, most: usize| {
        let more = words.saturating_sub(most);
        let more = if more > 0 { more.to_string() } else { String::new() };
        table.add_row([name, &words.to_string(), &most.to_string(), &more]);
    };
    for (path, text) in pages {
        add(path, words(text), rules.limit(path));
    }
    add("all", pages.values().map(|text| words(text)).sum(), rules.total_words);
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table.to_string()
}

/// What a page may be.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Rules {
    total_words: usize,
    page_words: usize,
    sentence_words: usize,
    /// Words by page, where they are not `page_words`.
    pages: BTreeMap<String, usize>,
    forbidden: Vec<Forbidden>,
}

/// Phrases and what to write instead.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Forbidden {
    phrases: Vec<String>,
    /// Words that make the phrase another one where they stand before it.
    #[serde(default)]
    unless_after: Vec<String>,
    /// The same behind it.
    #[serde(default)]
    unless_before: Vec<String>,
    instead: String,
}

impl Rules {
    fn read() -> Result<Self> {
        let text = fs::read_to_string(RULES).with_context(|| format!("cannot read {RULES}"))?;
        toml::from_str(&text).with_context(|| format!("{RULES} does not parse"))
    }

    fn limit(&self, path: &str) -> usize {
        self.pages.get(path).copied().unwrap_or(self.page_words)
    }

    /// Limits of pages that do not exist.
    fn strangers(&self, pages: &BTreeMap<String, String>) -> Vec<String> {
        let strangers = self.pages.keys().filter(|path| !pages.contains_key(*path));
        strangers
            .map(|path| format!("{RULES}: {path} is no tracked page; remove or rename its limit"))
            .collect()
    }

    fn total(&self, pages: &BTreeMap<String, String>) -> Option<String> {
        let total: usize = pages.values().map(|text| words(text)).sum();
        (total > self.total_words).then(|| {
            let most = self.total_words;
            format!("all pages: {total} words, at most {most}; `cargo xtask docs --words` has each page's")
        })
    }

    /// All that is wrong with a page, in the order of its lines.
    fn faults(&self, path: &str, text: &str) -> Vec<String> {
        let mut faults = Vec::new();
        let (found, most) = (words(text), self.limit(path));
        if found > most {
            faults.push(format!(
                "{path}: {found} words, at most {most}; leave out what no reader decides by"
            ));
        }
        for block in page::blocks(text) {
            faults.extend(self.long(path, &block));
            faults.extend(self.phrases(path, &block));
        }
        faults
    }

    fn long(&self, path: &str, block: &Block) -> Vec<String> {
        let mut faults = Vec::new();
        for sentence in block.sentences() {
            let (found, most) = (page::length(sentence), self.sentence_words);
            if found > most {
                let line = sentence.first().map_or(0, |word| word.line);
                let start: Vec<&str> =
                    sentence.iter().take(SHOWN).map(|word| word.shown.as_str()).collect();
                let start = start.join(" ");
                faults.push(format!(
                    "{path}:{line}: a sentence of {found} words, at most {most}: \"{start} ...\"; one thought a sentence"
                ));
            }
        }
        faults
    }

    fn phrases(&self, path: &str, block: &Block) -> Vec<String> {
        let bare: Vec<String> = block.words.iter().map(Word::bare).collect();
        let mut faults = Vec::new();
        for (at, word) in block.words.iter().enumerate() {
            for rule in &self.forbidden {
                if let Some(phrase) = rule.at(&bare, at) {
                    let (line, instead) = (word.line, &rule.instead);
                    faults.push(format!("{path}:{line}: \"{phrase}\"; write {instead}"));
                }
            }
        }
        faults
    }
}

impl Forbidden {
    /// The phrase that begins there.
    fn at(&self, words: &[String], at: usize) -> Option<&String> {
        let rest = words.get(at..)?;
        let phrase = self.phrases.iter().find(|phrase| {
            let mut rest = rest.iter();
            phrase.split(' ').all(|part| rest.next().is_some_and(|word| word == part))
        })?;
        let before = at.checked_sub(1).and_then(|before| words.get(before));
        let after = rest.get(phrase.split(' ').count());
        let is_other = before.is_some_and(|word| self.unless_after.contains(word))
            || after.is_some_and(|word| self.unless_before.contains(word));
        (!is_other).then_some(phrase)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules() -> Rules {
        let forbid = |phrases: [&str; 2], after: &str, before: &str| Forbidden {
            phrases: phrases.map(str::to_owned).to_vec(),
            unless_after: vec![after.into()],
            unless_before: vec![before.into()],
            instead: "now".into(),
        };
        Rules {
            total_words: 30,
            page_words: 20,
            sentence_words: 5,
            pages: [("B.md".to_owned(), 3)].into(),
            forbidden: vec![
                forbid(["no longer", "used to"], "is", "than"),
                forbid(["stir", "lag"], "", ""),
            ],
        }
    }

    #[test]
    fn a_good_page_has_no_fault() {
        let text = "# T\n\nIt is used to count. This is no longer than. `stir` and `lag` do.\n";
        assert_eq!(rules().faults("A.md", text), [""; 0]);
    }

    #[test]
    fn faults_name_line_words_and_remedy() {
        let text = "# We used to\n\nOne two three four five six.\nIt *no\nlonger* can stir.\n";
        let faults = rules().faults("A.md", text);
        assert_eq!(
            faults,
            [
                "A.md:1: \"used to\"; write now",
                "A.md:3: a sentence of 6 words, at most 5: \"One two three four five six. ...\"; one thought a sentence",
                "A.md:4: \"no longer\"; write now",
                "A.md:5: \"stir\"; write now",
            ]
        );
    }

    #[test]
    fn words_are_limited_a_page_and_in_all() {
        let rules = rules();
        assert_eq!(words("| a | b |\n|---|---|\n"), 6);
        assert!(rules.faults("B.md", "a b c d")[0].starts_with("B.md: 4 words, at most 3"));
        let page = |name: &str, words: usize| (name.to_owned(), "w ".repeat(words));
        assert!(rules.total(&[page("A.md", 20), page("C.md", 10)].into()).is_none());
        assert!(rules.total(&[page("A.md", 20), page("C.md", 11)].into()).is_some());
        assert!(rules.strangers(&[page("B.md", 1)].into()).is_empty());
        assert!(rules.strangers(&[page("C.md", 1)].into())[0].contains("B.md is no tracked page"));
    }

    #[test]
    fn the_rules_parse() -> Result<()> {
        let text = fs::read_to_string(format!("{}/docs.toml", env!("CARGO_MANIFEST_DIR")))?;
        let rules: Rules = toml::from_str(&text)?;
        for rule in &rules.forbidden {
            let is_lower = rule.phrases.iter().all(|phrase| *phrase == phrase.to_lowercase());
            assert!(is_lower && !rule.instead.is_empty());
        }
        Ok(())
    }
}
