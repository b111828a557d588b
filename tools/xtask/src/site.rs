//! The pages as a site: an mdBook with search, and the API's documentation beside.

use std::collections::{BTreeMap, BTreeSet};
use std::env;
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::install::Program;
use crate::process::{cargo, line, output, run as run_command};
use crate::report::Report;

const MDBOOK: Program = Program { name: "mdbook", version: Some("0.5.4"), features: &["search"] };
/// The order of the pages, and how they look.
const BOOK: &str = "docs/book";
const IMAGES: &str = "docs/images";
/// Where the API's documentation begins.
const API: [&str; 11] = [
    "rigidformer_core",
    "rigidformer_runtime",
    "rigidformer_kernels",
    "rigidformer_perception",
    "rigidformer_evaluation",
    "rigidformer_planning",
    "rigidformer_robots",
    "rigidformer_weights",
    "rigidformer_capi",
    "rigidformer_firmware_sim",
    "rigidformer_cli",
];

/// Builds the site below `target/site` and follows every link within it.
pub(crate) fn run(report: &mut Report) -> Result<()> {
    // Links are checked without the program too.
    let pages = Pages::read()?;
    pages.check()?;
    let program = match MDBOOK.ensure() {
        Ok(program) => program,
        Err(missing) => {
            report.skip(missing);
            return Ok(());
        }
    };
    let target = env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from);
    let site = target.join("site");
    if site.exists() {
        fs::remove_dir_all(&site).with_context(|| format!("cannot empty {}", site.display()))?;
    }
    pages.write(&site.join("src"))?;
    fs::copy(format!("{BOOK}/book.toml"), site.join("book.toml")).context("no book.toml")?;
    let mut build = Command::new(program);
    build.arg("build").arg(&site);
    println!("{}", line(&build));
    run_command(&mut build)?;
    run_command(cargo().args(["doc", "--workspace", "--no-deps"]))?;
    let book = site.join("book");
    copy_folder(&target.join("doc"), &book.join("api"))?;
    let links = follow(&book)?;
    println!("{}: {} pages, {links} links", book.join("index.html").display(), pages.texts.len());
    Ok(())
}

/// Follows every link of the pages to the files of the repository.
pub(crate) fn check_links() -> Result<()> {
    Pages::read()?.check()
}

/// The pages of the book, by their paths in the repository.
struct Pages {
    summary: String,
    texts: BTreeMap<PathBuf, String>,
}

impl Pages {
    fn read() -> Result<Self> {
        let path = format!("{BOOK}/SUMMARY.md");
        let summary = fs::read_to_string(&path).with_context(|| format!("cannot read {path}"))?;
        let mut texts = BTreeMap::new();
        for (_, target) in links(&summary) {
            let text = fs::read_to_string(&target)
                .with_context(|| format!("{path} names {target}, which cannot be read"))?;
            texts.insert(PathBuf::from(target), text);
        }
        Ok(Pages { summary, texts })
    }

    /// Every page of the repository is in the book, and every link leads somewhere.
    fn check(&self) -> Result<()> {
        let all = output(Command::new("git").args(["ls-files", "*.md"]))?;
        let mut faults: Vec<String> = all
            .lines()
            .filter(|path| !path.starts_with(BOOK) && !path.contains("/tests/"))
            .filter(|path| !self.texts.contains_key(Path::new(path)))
            .map(|path| format!("{path} is not in {BOOK}/SUMMARY.md"))
            .collect();
        for (page, text) in &self.texts {
            for (_, target) in links(text) {
                if let Some(fault) = self.fault(page, &target) {
                    faults.push(format!("{}: {target}: {fault}", page.display()));
                }
            }
        }
        match faults.is_empty() {
            true => Ok(()),
            false => bail!("{}", faults.join("\n")),
        }
    }

    fn fault(&self, page: &Path, target: &str) -> Option<String> {
        if is_elsewhere(target) {
            return None;
        }
        let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
        let path = if file.is_empty() { page.to_path_buf() } else { beside(page, file) };
        if !path.exists() {
            return Some("there is no such file".into());
        }
        let text = self.texts.get(&path)?;
        let is_there = anchor.is_empty() || anchors(text).contains(anchor);
        (!is_there).then(|| format!("{} has no heading {anchor}", path.display()))
    }

    /// Writes them where mdBook looks. What they link to beside pages and pictures is no part of the site, and becomes its name.
    fn write(&self, folder: &Path) -> Result<()> {
        let mut summary = self.summary.replace("README.md", "index.md");
        summary.push_str("- [Documentation of the crates](api.md)\n");
        let api = API.map(|name| format!("- [`{name}`](api/{name}/index.html)\n")).concat();
        let api = format!("# Documentation of the crates\n\nWhat `cargo doc` says:\n\n{api}");
        put(&folder.join("SUMMARY.md"), summary.as_bytes())?;
        put(&folder.join("api.md"), api.as_bytes())?;
        for (page, text) in &self.texts {
            let mut text = text.clone();
            for (words, target) in links(&text) {
                let written = format!("[{words}]({target})");
                let path = beside(page, target.split('#').next().unwrap_or_default());
                let is_kept = is_elsewhere(&target)
                    || target.starts_with('#')
                    || self.texts.contains_key(&path)
                    || path.starts_with(IMAGES);
                // A folder's page is its index in a book.
                let named = target.replace("README.md", "index.md");
                text = match is_kept {
                    true => text.replace(&written, &format!("[{words}]({named})")),
                    false => text.replace(&written, &words),
                };
            }
            let page = page.with_file_name(
                match page.file_name().is_some_and(|name| name == "README.md") {
                    true => "index.md".into(),
                    false => page.file_name().map(ToOwned::to_owned).unwrap_or_default(),
                },
            );
            put(&folder.join(page), text.as_bytes())?;
        }
        copy_folder(Path::new(IMAGES), &folder.join(IMAGES))
    }
}

fn is_elsewhere(target: &str) -> bool {
    ["http://", "https://", "mailto:"].iter().any(|scheme| target.starts_with(scheme))
}

/// Words and targets of the links and pictures of a page, outside of listings.
fn links(text: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut is_listing = false;
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            is_listing = !is_listing;
        }
        if is_listing || line.starts_with("    ") {
            continue;
        }
        for (at, _) in line.match_indices("](") {
            let Some((target, _)) = line[at + 2..].split_once(')') else { continue };
            // The words may have brackets of their own.
            let mut depth = 0;
            let start = line[..at].char_indices().rev().find(|(_, letter)| {
                depth += i32::from(*letter == ']') - i32::from(*letter == '[');
                depth < 0
            });
            let Some((start, _)) = start else { continue };
            let is_code = line[..start].matches('`').count() % 2 == 1;
            if !is_code {
                found.push((line[start + 1..at].to_owned(), target.to_owned()));
            }
        }
    }
    found
}

/// What a page's headings are called in links.
fn anchors(text: &str) -> BTreeSet<String> {
    let headings = text.lines().filter(|line| line.starts_with('#'));
    let name = |line: &str| {
        let words = line.trim_start_matches('#').trim().to_lowercase();
        let letters = words.chars().filter_map(|letter| match letter {
            ' ' => Some('-'),
            '-' | '_' => Some(letter),
            _ => letter.is_alphanumeric().then_some(letter),
        });
        letters.collect()
    };
    headings.map(name).collect()
}

/// A path that a page names, from the repository's root.
fn beside(page: &Path, target: &str) -> PathBuf {
    let mut path = page.parent().map(Path::to_path_buf).unwrap_or_default();
    for part in Path::new(target).components() {
        match part {
            Component::ParentDir => {
                path.pop();
            }
            Component::Normal(name) => path.push(name),
            _ => {}
        }
    }
    path
}

/// Follows the links of all pages of the built book but for those of the API, which rustdoc checks. Gives how many there were.
fn follow(book: &Path) -> Result<usize> {
    let mut count = 0;
    let mut faults = Vec::new();
    for path in files(book)? {
        let inner = path.strip_prefix(book).unwrap_or(&path);
        let is_page = path.extension().is_some_and(|end| end == "html");
        // These two stand for any page, whatever its folder.
        if !is_page
            || inner.starts_with("api")
            || ["404.html", "print.html", "toc.html"].iter().any(|name| inner == Path::new(name))
        {
            continue;
        }
        let text = fs::read_to_string(&path)?;
        for part in text.split("href=\"").skip(1).chain(text.split("src=\"").skip(1)) {
            let target = part.split('"').next().unwrap_or_default();
            let file = target.split(['#', '?']).next().unwrap_or_default();
            if is_elsewhere(target) || file.is_empty() || target.starts_with("data:") {
                continue;
            }
            count += 1;
            if !book.join(beside(inner, file)).exists() {
                faults.push(format!("{}: {target} leads nowhere", path.display()));
            }
        }
    }
    match faults.is_empty() {
        true => Ok(count),
        false => bail!("{}", faults.join("\n")),
    }
}

fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let entries =
            fs::read_dir(&folder).with_context(|| format!("cannot list {}", folder.display()))?;
        for entry in entries {
            let path = entry?.path();
            match path.is_dir() {
                true => folders.push(path),
                false => found.push(path),
            }
        }
    }
    found.sort();
    Ok(found)
}

fn copy_folder(from: &Path, to: &Path) -> Result<()> {
    for path in files(from)? {
        let inner = path.strip_prefix(from).unwrap_or(&path);
        put(&to.join(inner), &fs::read(&path)?)?;
    }
    Ok(())
}

fn put(path: &Path, bytes: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_found_where_there_are_some() {
        let text =
            "See [a `[b]` c](x.md#y) and ![p](i.png).\n```sh\n[no](no.md)\n```\n`[code](c.md)`\n";
        let found = links(text);
        let targets: Vec<&str> = found.iter().map(|(_, target)| target.as_str()).collect();
        assert_eq!(targets, ["x.md#y", "i.png"]);
        assert_eq!(found[0].0, "a `[b]` c");
        assert_eq!(beside(Path::new("docs/A.md"), "../weights/B.md"), Path::new("weights/B.md"));
        assert!(anchors("# One, two: `three`\n").contains("one-two-three"));
    }
}
