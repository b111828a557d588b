//! The standard library's source, of exactly the compiler's version: from rustup, or from a Debian
//! package, unpacked and not installed.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::process::{output, run};

/// Suites newer than the machine's own that may hold a newer compiler.
const NEWER_SUITES: &[&str] = &["trixie-backports", "forky", "sid"];

/// What became of the search.
pub(crate) enum Outcome {
    /// The source is where cargo looks for it.
    Present,
    /// This machine cannot have it, and why.
    Unavailable(String),
}

/// Puts the source into the sysroot where it is missing.
pub(crate) fn ensure(sysroot: &Path) -> Result<Outcome> {
    let library = sysroot.join("lib/rustlib/src/rust/library");
    if present(&library) {
        return Ok(Outcome::Present);
    }
    match run(Command::new("rustup").args(["component", "add", "rust-src"])) {
        Ok(()) if present(&library) => return Ok(Outcome::Present),
        Ok(()) => println!("rustup added rust-src, but not to {}", library.display()),
        Err(error) => println!("{error:#}; looking for a Debian package instead"),
    }
    let by_hand = format!(
        "by hand: put the library folder of the source of this rustc into {}",
        library.display()
    );
    if let Err(why) = is_root_with_apt() {
        return Ok(Outcome::Unavailable(format!(
            "rustup cannot provide rust-src, and {why}; {by_hand}"
        )));
    }
    from_debian(&library).context(by_hand)?;
    Ok(Outcome::Present)
}

fn present(library: &Path) -> bool {
    library.join("core/src/lib.rs").is_file() && library.join("Cargo.lock").is_file()
}

/// Whether packages can be had, or why not.
pub(crate) fn is_root_with_apt() -> std::result::Result<(), &'static str> {
    let works = |program: &str| output(Command::new(program).arg("--version")).is_ok();
    if !works("apt-get") || !works("apt-cache") || !works("dpkg") {
        return Err("this machine has no apt");
    }
    let user = output(Command::new("id").arg("-u")).unwrap_or_default();
    if user.trim() == "0" { Ok(()) } else { Err("this is not root") }
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
    let mut sources = Vec::new();
    let mut paths = vec![PathBuf::from("/etc/apt/sources.list")];
    paths.extend(files(Path::new("/etc/apt/sources.list.d"))?);
    for path in paths {
        let text = fs::read_to_string(&path).unwrap_or_default();
        match path.extension().and_then(|kind| kind.to_str()) {
            Some("sources") => sources.extend(deb822(&text)),
            Some("list") => sources.extend(text.lines().filter_map(one_line)),
            _ => {}
        }
    }
    let mut all = Vec::new();
    for source in sources.iter().filter(|source| source.is_debian()) {
        // Not its updates, which have no backports.
        let own = source.suites.iter().filter(|suite| !suite.contains('-'));
        let backports = own.clone().map(|suite| format!("{suite}-backports"));
        let newer = NEWER_SUITES.iter().map(|&suite| suite.to_owned());
        for suite in backports.chain(newer).chain(own.cloned()) {
            if !all.iter().any(|(seen, uri, _)| *seen == suite && *uri == source.uri) {
                all.push((suite, source.uri.clone(), source));
            }
        }
    }
    if all.is_empty() {
        bail!("the apt sources of this machine name no Debian archive");
    }
    let apt = |(at, (suite, _, source)): (usize, (String, String, &Source))| {
        Apt::new(work.join(format!("apt-{at}")), source, &suite)
    };
    all.into_iter().enumerate().map(apt).collect()
}

/// An entry of the machine's package sources.
#[derive(Clone, Debug, PartialEq)]
struct Source {
    uri: String,
    suites: Vec<String>,
    signed_by: Option<String>,
}

impl Source {
    /// The main archive: not its security updates, and not another vendor's.
    fn is_debian(&self) -> bool {
        self.uri.trim_end_matches('/').ends_with("/debian")
    }

    fn with_suite(&self, suite: &str) -> String {
        let signed =
            self.signed_by.as_ref().map(|key| format!("Signed-By: {key}\n")).unwrap_or_default();
        format!("Types: deb\nURIs: {}\nSuites: {suite}\nComponents: main\n{signed}", self.uri)
    }
}

/// Entries of a `.sources` file: paragraphs of fields.
fn deb822(text: &str) -> Vec<Source> {
    let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).collect();
    let paragraph = |lines: &[&str]| {
        let field = |name: &str| {
            let mut fields = lines.iter().filter_map(|line| line.split_once(':'));
            let (_, value) = fields.find(|(key, _)| key.eq_ignore_ascii_case(name))?;
            Some(value.trim().to_owned())
        };
        let enabled = field("Enabled").is_none_or(|value| value != "no");
        field("Types")
            .filter(|types| enabled && types.split_whitespace().any(|kind| kind == "deb"))?;
        Some(Source {
            uri: field("URIs")?.split_whitespace().next()?.to_owned(),
            suites: field("Suites")?.split_whitespace().map(str::to_owned).collect(),
            signed_by: field("Signed-By").filter(|key| key.starts_with('/')),
        })
    };
    lines.split(|line| line.trim().is_empty()).filter_map(paragraph).collect()
}

/// An entry of a `.list` file: `deb [options] uri suite components`.
fn one_line(line: &str) -> Option<Source> {
    let rest = line.trim().strip_prefix("deb ")?.trim_start();
    let (options, rest) = match rest.strip_prefix('[') {
        Some(rest) => rest.split_once(']')?,
        None => ("", rest),
    };
    let mut words = rest.split_whitespace();
    let signed_by = options.split_whitespace().find_map(|option| option.strip_prefix("signed-by="));
    Some(Source {
        uri: words.next()?.to_owned(),
        suites: vec![words.next()?.to_owned()],
        signed_by: signed_by.map(str::to_owned),
    })
}

/// The files of a folder in order; none where it does not exist.
fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Ok(Vec::new());
    };
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_kinds_of_sources_are_read() {
        let text = "# ours\nTypes: deb deb-src\nURIs: http://example.invalid/debian\nSuites: a a-updates\n\
            Components: main\nSigned-By: /key.gpg\n\nTypes: deb\nEnabled: no\nURIs: u\nSuites: s\n\n\
            Types: deb-src\nURIs: u\nSuites: s\n";
        let source = Source {
            uri: "http://example.invalid/debian".into(),
            suites: vec!["a".into(), "a-updates".into()],
            signed_by: Some("/key.gpg".into()),
        };
        assert_eq!(deb822(text), std::slice::from_ref(&source));
        assert!(source.is_debian());
        let line = "deb [arch=amd64 signed-by=/key.gpg] http://example.invalid/debian a main";
        assert_eq!(one_line(line), Some(Source { suites: vec!["a".into()], ..source }));
        assert_eq!(one_line("deb-src http://example.invalid/debian a main"), None);
        assert_eq!(one_line("# deb http://example.invalid/debian a main"), None);
        let other = one_line("deb http://example.invalid/debian-security a main");
        assert!(other.is_some_and(|other| !other.is_debian() && other.signed_by.is_none()));
    }

    #[test]
    fn only_the_same_version_matches() {
        let table = " rust-src | 1.96.1+dfsg1-2 | a\n rust-src | 1.95.0+dfsg1-2~bpo13+1 | a\n rust-src | 1.9-1 | a\n";
        assert_eq!(matching(table, "1.95.0"), Some("1.95.0+dfsg1-2~bpo13+1"));
        assert_eq!(matching(table, "1.9"), Some("1.9-1"));
        assert_eq!(matching(table, "1.96"), None);
    }
}
