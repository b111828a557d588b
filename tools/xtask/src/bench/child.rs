//! A program that measures slices: it waits for a line and answers with one.

use std::io::{BufRead, BufReader, Write};
use std::process::{self, ChildStdin, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::process::line;

/// One that runs. It ends with this value, and by itself where this process is killed: then its input ends.
pub(crate) struct Child {
    name: String,
    process: process::Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    /// Its first line: what it can do.
    pub(crate) hello: Value,
}

impl Child {
    /// Starts it and waits for its first line.
    pub(crate) fn start(command: &mut Command) -> Result<Self> {
        let name = line(command);
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = command.spawn().with_context(|| format!("cannot start `{name}`"))?;
        let (Some(input), Some(output)) = (process.stdin.take(), process.stdout.take()) else {
            bail!("`{name}` has no pipes");
        };
        let output = BufReader::new(output);
        let mut started = Child { name, process, input, output, hello: Value::Null };
        started.hello = started.answer()?;
        Ok(started)
    }

    /// Asks for a slice.
    pub(crate) fn ask(&mut self, request: &Value) -> Result<Value> {
        let asked = writeln!(self.input, "{request}").and_then(|()| self.input.flush());
        asked.with_context(|| format!("`{}` has ended", self.name))?;
        self.answer()
    }

    fn answer(&mut self) -> Result<Value> {
        let mut text = String::new();
        self.output.read_line(&mut text)?;
        if text.is_empty() {
            bail!("`{}` has ended", self.name);
        }
        serde_json::from_str(&text)
            .with_context(|| format!("`{}` answers {:?}", self.name, text.trim_end()))
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // It may have ended; nothing else can go wrong that is worth telling.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[cfg(all(test, unix))]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Result<Child> {
        Child::start(Command::new("sh").args(["-c", script]))
    }

    #[test]
    fn it_answers_line_by_line_and_ends_with_its_value() {
        let mut started =
            shell("echo '{\"a\":1}'; while read -r line; do echo \"[$line]\"; done").unwrap();
        assert_eq!(started.hello["a"], 1);
        assert_eq!(started.ask(&Value::from(2)).unwrap()[0], 2);
        assert_eq!(started.ask(&Value::from(3)).unwrap()[0], 3);
        let id = started.process.id();
        drop(started);
        assert!(!std::path::Path::new(&format!("/proc/{id}")).exists());
    }

    #[test]
    fn one_that_ends_or_talks_nonsense_is_an_error() {
        let error = shell("exit 1").err().unwrap();
        assert!(error.to_string().contains("has ended"), "{error:#}");
        let error = shell("echo hello").err().unwrap();
        assert!(error.to_string().contains("hello"), "{error:#}");
        let mut started = shell("echo 1").unwrap();
        assert!(started.ask(&Value::Null).is_err());
    }
}
