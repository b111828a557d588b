//! Programs that cargo installs.

use std::env;
use std::path::PathBuf;
use std::process::Command;

use crate::process::{cargo, line, output, run as run_command};
use crate::report::Missing;

/// A program of a crate of the same name.
pub(crate) struct Program {
    pub(crate) name: &'static str,
    /// The one that checks rely on; any where there is none.
    pub(crate) version: Option<&'static str>,
    /// Instead of the crate's own, where there are any.
    pub(crate) features: &'static [&'static str],
}

impl Program {
    /// Installs it where it is missing, or tells why that cannot be.
    pub(crate) fn ensure(&self) -> Result<PathBuf, Missing> {
        if self.works(&PathBuf::from(self.name)) {
            return Ok(self.name.into());
        }
        // Where cargo puts it; not everyone has that on PATH.
        let home = env::var_os("CARGO_HOME").map(PathBuf::from);
        let home =
            home.or_else(|| env::var_os("HOME").map(|home| PathBuf::from(home).join(".cargo")));
        let path = home.unwrap_or_default().join("bin").join(self.name);
        if self.works(&path) {
            return Ok(path);
        }
        let mut install = cargo();
        install.args(["install", "--locked", "--force", self.name]);
        install.args(self.version.iter().flat_map(|version| ["--version", version]));
        if !self.features.is_empty() {
            install.args(["--no-default-features", "--features", &self.features.join(",")]);
        }
        println!("{}", line(&install));
        let installed = run_command(&mut install);
        match installed {
            Ok(()) if self.works(&path) => Ok(path),
            Ok(()) => Err(Missing::new(
                format!("{} does not run once installed", self.name),
                line(&install),
            )),
            Err(error) => {
                Err(Missing::new(format!("no {}, and {error:#}", self.name), line(&install)))
            }
        }
    }

    fn works(&self, path: &PathBuf) -> bool {
        // Some are parts of cargo alone, and want their own name first.
        let part = self.name.strip_prefix("cargo-").map(|part| vec![part, "--version"]);
        let mut asked = [Some(vec!["--version"]), part].into_iter().flatten();
        let version = asked.find_map(|words| output(Command::new(path).args(words)).ok());
        version.is_some_and(|said| self.version.is_none_or(|wanted| said.contains(wanted)))
    }
}
