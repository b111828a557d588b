//! The two commands of README.md.

use std::fs;

use anyhow::{Context, Result, bail};

const README: &str = "README.md";
const HEADING: &str = "## Two commands";

/// The commands as they stand there, comments and all: the first predicts a scene, the second tests.
pub(crate) fn commands() -> Result<[String; 2]> {
    let text = fs::read_to_string(README).with_context(|| format!("cannot read {README}"))?;
    parse(&text)
}

/// A command without its comment.
pub(crate) fn bare(command: &str) -> &str {
    command.split(" #").next().unwrap_or_default().trim_end()
}

pub(crate) fn parse(text: &str) -> Result<[String; 2]> {
    let section = text.lines().skip_while(|line| *line != HEADING).skip(1);
    let mut section = section.take_while(|line| !line.starts_with("## "));
    if !section.any(|line| line == "```sh") {
        bail!("{README} has no block of sh below \"{HEADING}\"");
    }
    let block = section.take_while(|line| *line != "```");
    let lines = block.filter(|line| !line.trim().is_empty() && !line.trim_start().starts_with('#'));
    let commands: Vec<String> = lines.map(str::to_owned).collect();
    <[String; 2]>::try_from(commands).map_err(|commands| {
        anyhow::anyhow!("{README} has {} commands below \"{HEADING}\"", commands.len())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_commands_are_found() -> Result<()> {
        let text = "# A\n\n```sh\nno\n```\n\n## Two commands\n\nWith Rust:\n\n```sh\n# first\n\
            a --b   # makes c\n\nd e\n```\n\n```sh\nf\n```\n";
        assert_eq!(parse(text)?, ["a --b   # makes c", "d e"]);
        assert_eq!(bare("a --b   # makes c"), "a --b");
        assert_eq!(bare("d e"), "d e");
        Ok(())
    }

    #[test]
    fn a_readme_without_two_commands_is_an_error() {
        let error = |text| parse(text).err().map(|error| error.to_string());
        let two = error("## Two commands\n```sh\na\nb\nc\n```\n");
        assert_eq!(two.as_deref(), Some("README.md has 3 commands below \"## Two commands\""));
        let next = error("## Two commands\n\n## Other\n```sh\na\nb\n```\n");
        assert_eq!(next.as_deref(), Some("README.md has no block of sh below \"## Two commands\""));
    }
}
