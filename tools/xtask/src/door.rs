//! README's Rust example as a crate of its own, with the dependencies that docs/USING.md has, as somebody outside the workspace copies
//! them.

use std::fs;

use anyhow::{Context, Result, ensure};

use crate::process::{cargo, line, output, target};

const README: &str = "README.md";
const HEADING: &str = "## Ten lines";
const PAGE: &str = "docs/USING.md";
const OF_PAGE: &str = "## From Rust, on a host";
/// Where a clone lies in the page's paths.
const CLONE: &str = "path = \"rigidformer/";

/// Builds and runs it, on the versions that the workspace has.
pub(crate) fn run() -> Result<()> {
    let [program, dependencies] =
        [(README, HEADING, "rust"), (PAGE, OF_PAGE, "toml")].map(|(path, heading, language)| {
            let text = fs::read_to_string(path).with_context(|| format!("cannot read {path}"))?;
            block(&text, heading, language).with_context(|| path.to_owned())
        });
    let (program, dependencies) = (program?, dependencies?);
    let folder = target().join("door");
    fs::create_dir_all(folder.join("src")).context("cannot make a folder")?;
    let root = std::env::current_dir().context("no current folder")?;
    let manifest = manifest(&dependencies, &root.display().to_string())?;
    fs::write(folder.join("Cargo.toml"), manifest)?;
    fs::write(folder.join("src/main.rs"), program)?;
    fs::copy("Cargo.lock", folder.join("Cargo.lock")).context("cannot copy Cargo.lock")?;
    let mut command = cargo();
    command.args(["run", "--offline", "--quiet", "--manifest-path"]).arg(folder.join("Cargo.toml"));
    command.env("CARGO_TARGET_DIR", folder.join("target"));
    println!("{}", line(&command));
    let said = output(&mut command)?;
    let heights: Vec<f32> = said
        .lines()
        .map(|line| line.strip_suffix(" m").and_then(|height| height.parse().ok()))
        .collect::<Option<_>>()
        .with_context(|| format!("README's example printed {said:?}"))?;
    // It falls, and rises again.
    let lowest = heights.iter().copied().fold(f32::INFINITY, f32::min);
    let fell = heights.first().is_some_and(|first| *first > 0.9) && lowest < 0.5;
    ensure!(fell && heights.last().is_some_and(|last| *last > lowest), "it printed {heights:?}");
    Ok(())
}

/// The crate's manifest, with the workspace where the page has a clone.
fn manifest(dependencies: &str, root: &str) -> Result<String> {
    ensure!(dependencies.contains(CLONE), "the dependencies name no {CLONE}");
    let dependencies = dependencies.replace(CLONE, &format!("path = \"{root}/"));
    Ok(format!("[package]\nname = \"door\"\nedition = \"2024\"\n\n[workspace]\n\n{dependencies}"))
}

/// The first block of a language in the section.
fn block(text: &str, heading: &str, language: &str) -> Result<String> {
    let section = text.lines().skip_while(|line| *line != heading).skip(1);
    let mut section = section.take_while(|line| !line.starts_with("## "));
    let begins = |line: &str| {
        line.strip_prefix("```").is_some_and(|words| words.split(',').next() == Some(language))
    };
    ensure!(section.any(begins), "no block of {language} is below \"{heading}\"");
    let lines = section.take_while(|line| *line != "```");
    Ok(lines.flat_map(|line| [line, "\n"]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_those_of_the_section() -> Result<()> {
        let text = "```toml\nno\n```\n## Ten lines\nWith:\n```toml\na = { path = \"rigidformer/a\" }\n```\n\
            ```rust,no_run\nfn main() {}\n\n// end\n```\n## Next\n```c\n```\n";
        assert_eq!(block(text, HEADING, "rust")?, "fn main() {}\n\n// end\n");
        assert!(block(text, HEADING, "c").is_err());
        let manifest = manifest(&block(text, HEADING, "toml")?, "/w")?;
        assert!(manifest.ends_with("[workspace]\n\na = { path = \"/w/a\" }\n"), "{manifest}");
        assert!(super::manifest("a = \"1\"", "/w").is_err());
        Ok(())
    }
}
