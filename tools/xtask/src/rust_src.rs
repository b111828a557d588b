//! The standard library's source, of exactly the compiler's version: from rustup, or from a Debian
//! package, unpacked and not installed.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::apt::is_root_with_apt;
use crate::process::{output, run};
use crate::report::Missing;
use crate::sources::{self, Source, files};

/// Suites newer than the machine's own that may hold a newer compiler.
const NEWER_SUITES: &[&str] = &["trixie-backports", "forky", "sid"];

/// Puts the source into the sysroot where it is missing, or tells why this machine cannot have it.
pub(crate) fn ensure(sysroot: &Path) -> std::result::Result<(), Missing> {
    let library = sysroot.join("lib/rustlib/src/rust/library");
    if present(&library) {
        return Ok(());
    }
    match run(Command::new("rustup").args(["component", "add", "rust-src"])) {
        Ok(()) if present(&library) => return Ok(()),
        Ok(()) => println!("rustup added rust-src, but not to {}", library.display()),
        Err(error) => println!("{error:#}; looking for a Debian package instead"),
    }
    let missing = |why: &str| {
        let by_hand = format!(
            "`rustup component add rust-src`, or put the library folder of this rustc's source into {}",
            library.display()
        );
        Missing::new(format!("rustup cannot provide rust-src, and {why}"), by_hand)
    };
    is_root_with_apt().map_err(missing)?;
    from_debian(&library).map_err(|error| missing(&format!("{error:#}")))
}

fn present(library: &Path) -> bool {
    library.join("core/src/lib.rs").is_file() && library.join("Cargo.lock").is_file()
}

/// Finds, downloads and unpacks the package, and copies the source.
fn from_debian(library: &Path) -> Result<()> {
    let version = rustc_version()?;
    let work = tempfile::tempdir().context("cannot make a temporary folder")?;
    for apt in candidates(work.path())? {
        let package = match apt.find(&version) {
            Ok(Some(package)) => package,
            Ok(None) => {
                println!("{}: no rust-src {version}", apt.suite);
                continue;
            }
            Err(error) => {
                println!("{}: {error:#}", apt.suite);
                continue;
            }
        };
        println!("{}: rust-src {package}", apt.suite);
        run(apt
            .command("apt-get")
            .args(["download", &format!("rust-src={package}")])
            .current_dir(work.path()))?;
        let archive = files(work.path())?
            .into_iter()
            .find(|path| path.extension().is_some_and(|kind| kind == "deb"));
        let archive = archive.context("apt-get downloaded no package")?;
        let unpacked = work.path().join("unpacked");
        run(Command::new("dpkg").arg("--extract").arg(&archive).arg(&unpacked))?;
        return install(&unpacked.join(format!("usr/src/rustc-{version}/library")), library);
    }
    bail!("no suite of this machine's package sources holds rust-src {version}")
}

/// Copies the source beside its place and renames it, so that half a copy is never taken for a
/// whole.
fn install(from: &Path, library: &Path) -> Result<()> {
    if !present(from) {
        bail!("the package has no {}", from.display());
    }
    let parent = library.parent().context("a sysroot has folders")?;
    fs::create_dir_all(parent).with_context(|| format!("cannot make {}", parent.display()))?;
    let partial = parent.join("library.partial");
    for folder in [&partial, &library.to_path_buf()] {
        if folder.exists() {
            fs::remove_dir_all(folder)
                .with_context(|| format!("cannot remove {}", folder.display()))?;
        }
    }
    run(Command::new("cp").args(["--recursive", "--dereference"]).arg(from).arg(&partial))?;
    fs::rename(&partial, library).with_context(|| format!("cannot rename {}", partial.display()))
}

/// Such as 1.95.0.
fn rustc_version() -> Result<String> {
    let text = output(Command::new("rustc").arg("-vV"))?;
    let release = text.lines().find_map(|line| line.strip_prefix("release: "));
    Ok(release.context("`rustc -vV` has no release")?.to_owned())
}

/// One suite, with lists and downloads of its own: the machine's configuration stays as it is.
struct Apt {
    suite: String,
    folder: PathBuf,
}

impl Apt {
    fn new(folder: PathBuf, source: &Source, suite: &str) -> Result<Self> {
        for part in ["sources", "lists/partial", "cache/archives/partial"] {
            fs::create_dir_all(folder.join(part)).context("cannot make a folder for apt")?;
        }
        fs::write(folder.join("sources/suite.sources"), source.with_suite(suite))
            .context("cannot write for apt")?;
        Ok(Apt { suite: suite.into(), folder })
    }

    /// The rest of the configuration, such as proxies, is the machine's.
    fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        let mut option = |name: &str, value: &str| {
            command.arg("-o").arg(format!("{name}={value}"));
        };
        let path = |part: &str| self.folder.join(part).display().to_string();
        option("Dir::Etc::SourceList", "/dev/null");
        option("Dir::Etc::SourceParts", &path("sources"));
        option("Dir::State::Lists", &path("lists"));
        option("Dir::Cache", &path("cache"));
        option("Acquire::Languages", "none");
        // The folders belong to root alone.
        option("APT::Sandbox::User", "root");
        command
    }

    /// The package version of that compiler version, if the suite holds it.
    fn find(&self, version: &str) -> Result<Option<String>> {
        output(self.command("apt-get").args(["--quiet", "update"]))?;
        let table = output(self.command("apt-cache").args(["madison", "rust-src"]))?;
        Ok(matching(&table, version).map(str::to_owned))
    }
}

/// The package version of an upstream version in a table of `apt-cache madison`: name | version |
/// source.
fn matching<'t>(table: &'t str, upstream: &str) -> Option<&'t str> {
    let mut versions = table.lines().filter_map(|line| line.split('|').nth(1)).map(str::trim);
    versions.find(|version| version.split(['+', '-', '~']).next() == Some(upstream))
}

/// Every suite worth trying in the archives that the machine uses: its own backports, newer suites,
/// its own.
fn candidates(work: &Path) -> Result<Vec<Apt>> {
    let sources = sources::debian()?;
    let mut all = Vec::new();
    for source in &sources {
        // Not its updates, which have no backports.
        let own = source.releases();
        let backports = own.clone().map(|suite| format!("{suite}-backports"));
        let newer = NEWER_SUITES.iter().map(|&suite| suite.to_owned());
        for suite in backports.chain(newer).chain(own.cloned()) {
            if !all.iter().any(|(seen, uri, _)| *seen == suite && *uri == source.uri) {
                all.push((suite, source.uri.clone(), source));
            }
        }
    }
    let apt = |(at, (suite, _, source)): (usize, (String, String, &Source))| {
        Apt::new(work.join(format!("apt-{at}")), source, &suite)
    };
    all.into_iter().enumerate().map(apt).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_version_matches() {
        let table = " rust-src | 1.96.1+dfsg1-2 | a\n rust-src | 1.95.0+dfsg1-2~bpo13+1 | a\n rust-src | 1.9-1 | a\n";
        assert_eq!(matching(table, "1.95.0"), Some("1.95.0+dfsg1-2~bpo13+1"));
        assert_eq!(matching(table, "1.9"), Some("1.9-1"));
        assert_eq!(matching(table, "1.96"), None);
    }
}
