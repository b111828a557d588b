//! The benchmark as a program: built here, or from a commit before.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::process::{cargo, output, run};

/// How cargo names it.
pub(crate) const BENCH: [&str; 6] =
    ["bench", "--quiet", "-p", "rigidformer-runtime", "--bench", "workloads"];

/// Builds it in this folder and says where it is.
pub(crate) fn built(folder: &Path, target: Option<&Path>) -> Result<PathBuf> {
    let mut command = cargo();
    // The compiler's errors are for people.
    command.args(BENCH).args(["--no-run", "--message-format=json-render-diagnostics"]);
    command.current_dir(folder).stderr(Stdio::inherit());
    if let Some(target) = target {
        command.env("CARGO_TARGET_DIR", target);
    }
    eprintln!("building the benchmark in {}", folder.display());
    let text = output(&mut command).context("the benchmark must build")?;
    executable(&text).context("cargo does not say where the benchmark is")
}

/// The program in cargo's messages.
fn executable(messages: &str) -> Option<PathBuf> {
    let messages = messages.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let mut found = messages.filter(|message| message["target"]["name"] == "workloads");
    found.find_map(|message| message["executable"].as_str().map(PathBuf::from))
}

/// A commit in a worktree of its own, which is there while this value is.
pub(crate) struct Checkout {
    /// Its hash.
    pub(crate) commit: String,
    folder: PathBuf,
    target: PathBuf,
}

impl Checkout {
    /// Checks it out below cargo's target folder, where what it builds stays for the next time.
    pub(crate) fn new(commit: &str) -> Result<Self> {
        let mut parse = Command::new("git");
        parse.args(["rev-parse", "--verify", "--quiet", "--end-of-options"]);
        let found = output(parse.arg(format!("{commit}^{{commit}}")));
        let commit = found.with_context(|| format!("git knows no commit {commit}"))?;
        let commit = commit.trim().to_owned();
        let target = env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
        let target = env::current_dir()?.join(target).join("before");
        let folder = target.join(commit.get(..12).unwrap_or(&commit));
        fs::create_dir_all(&target).with_context(|| format!("cannot make {}", target.display()))?;
        let checkout = Checkout { commit, folder, target };
        // One that was killed may have left its own, locked or half made.
        checkout.remove();
        let mut add = Command::new("git");
        add.args(["worktree", "add", "-f", "-f", "--quiet", "--detach"]).arg(&checkout.folder);
        run(add.arg(&checkout.commit))?;
        Ok(checkout)
    }

    /// Builds its benchmark.
    pub(crate) fn built(&self) -> Result<PathBuf> {
        let built = built(&self.folder, Some(&self.target));
        built.with_context(|| format!("the benchmark of commit {}", self.commit))
    }

    fn remove(&self) {
        if !self.folder.exists() {
            return;
        }
        let mut remove = Command::new("git");
        remove.args(["worktree", "remove", "--force", "--force"]).arg(&self.folder);
        // Git may not know what is there; the folder goes all the same.
        let removed = output(&mut remove);
        if self.folder.exists() {
            if let Err(error) = removed {
                eprintln!("{error:#}");
            }
            if let Err(error) = fs::remove_dir_all(&self.folder) {
                eprintln!("cannot remove {}: {error}", self.folder.display());
            }
        }
        if let Err(error) = output(Command::new("git").args(["worktree", "prune"])) {
            eprintln!("{error:#}");
        }
    }
}

impl Drop for Checkout {
    fn drop(&mut self) {
        self.remove();
    }
}

/// What a commit is called whose files are these, and whether they have changed since.
pub(crate) fn present_commit() -> Result<(String, bool)> {
    let commit = output(Command::new("git").args(["rev-parse", "HEAD"]))?;
    let status =
        output(Command::new("git").args(["status", "--porcelain", "--untracked-files=no"]))?;
    if commit.trim().is_empty() {
        bail!("git knows no commit");
    }
    Ok((commit.trim().to_owned(), !status.trim().is_empty()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cargo_tells_where_the_program_is() {
        let messages = "{\"reason\":\"compiler-artifact\",\"target\":{\"name\":\"clap\"},\"executable\":null}\n\
            not json\n\
            {\"reason\":\"compiler-artifact\",\"target\":{\"name\":\"workloads\"},\"executable\":\"/t/workloads-1\"}\n\
            {\"reason\":\"build-finished\",\"success\":true}\n";
        assert_eq!(executable(messages), Some("/t/workloads-1".into()));
        assert_eq!(executable("{}"), None);
    }
}
