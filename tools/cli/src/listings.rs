//! The commands in the pages are commands of this program.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Parser;

use crate::arguments::Arguments;

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

fn pages(folder: &Path, found: &mut Vec<PathBuf>) -> anyhow::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        // What is built, and what git leaves out.
        if name.starts_with('.') || ["target", "node_modules", "out"].contains(&name.as_str()) {
            continue;
        }
        if path.is_dir() {
            pages(&path, found)?;
        } else if path.extension().is_some_and(|end| end == "md") {
            found.push(path);
        }
    }
    Ok(())
}

/// Lines of the shell listings of a page; those that end in a backslash go on.
fn lines(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut is_shell = false;
    let mut so_far = String::new();
    let mut is_elsewhere = false;
    for line in text.lines() {
        // From another folder cargo runs another program.
        is_elsewhere |= is_shell && line.starts_with("cd ");
        if is_elsewhere && line.contains("cargo run") {
            continue;
        }
        match line.trim_start().strip_prefix("```") {
            Some(language) => (is_shell, is_elsewhere) = (language.starts_with("sh"), false),
            None if is_shell => match line.strip_suffix('\\') {
                Some(part) => so_far.push_str(part),
                None => found.push(std::mem::take(&mut so_far) + line),
            },
            None => {}
        }
    }
    found
}

/// The calls of this program in a line of a shell.
fn calls(line: &str) -> Vec<Vec<String>> {
    let words = shlex::split(line).unwrap_or_default();
    let mut calls = Vec::new();
    for command in words.split(|word| ["&&", "|", ";", "do", "done"].contains(&word.as_str())) {
        // Where output goes, and whether it waits, is the shell's.
        let end =
            command.iter().position(|word| word.starts_with('>') || word == "2>" || word == "&");
        let own = command.get(..end.unwrap_or(command.len())).unwrap_or_default();
        let is_program = |word: &String| word == "rigidformer" || word.ends_with("/rigidformer");
        let is_other = |word: &String| word == "-p" || word == "--example";
        let is_cargo = own.iter().position(|word| word == "--");
        let is_cargo = is_cargo.filter(|at| !own.iter().take(*at).any(is_other));
        let at = match own.first() {
            Some(first) if is_program(first) => Some(1),
            Some(first) if first == "cargo" && own.get(1).is_some_and(|word| word == "run") => {
                is_cargo.map(|at| at + 1)
            }
            _ => None,
        };
        if let Some(arguments) = at.and_then(|at| own.get(at..)) {
            let trimmed = arguments.iter().map(|word| word.trim_end_matches(';').to_owned());
            calls.push(trimmed.collect());
        }
    }
    calls
}

#[test]
fn every_command_in_the_pages_is_one() -> anyhow::Result<()> {
    let mut found = Vec::new();
    pages(Path::new(ROOT), &mut found)?;
    let (mut count, mut faults) = (0, Vec::new());
    for page in found {
        let text = fs::read_to_string(&page)?;
        for line in lines(&text) {
            for call in calls(&line) {
                count += 1;
                // What a loop counts is a number.
                let words = call.iter().map(|word| word.replace("$i", "1"));
                let parsed =
                    Arguments::try_parse_from(["rigidformer".to_owned()].into_iter().chain(words));
                let error = parsed.err().filter(clap::Error::use_stderr);
                faults.extend(error.map(|error| format!("{}: {line}\n{error}", page.display())));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(count > 50, "{count} commands were found");
    Ok(())
}
