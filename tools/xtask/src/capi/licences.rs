//! The licences that go with a library: ours, and those of the crates whose compiled code it holds.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use cargo_metadata::MetadataCommand;

use crate::process::{cargo, output};

const PACKAGE: &str = "rigidformer-capi";
const OURS: [&str; 2] = ["LICENSE-APACHE", "LICENSE-MIT"];
/// The file about the others.
const THIRD_PARTY: &str = "THIRD-PARTY.txt";
/// How names of files begin that hold a licence or belong to one.
const STARTS: [&str; 6] = ["LICENSE", "LICENCE", "UNLICENSE", "COPYING", "COPYRIGHT", "NOTICE"];

/// A crate of a library, with its texts by the names of their files.
struct Crate {
    name: String,
    version: String,
    licence: String,
    repository: String,
    texts: Vec<(String, String)>,
}

impl Crate {
    fn title(&self) -> String {
        format!("{} {}", self.name, self.version)
    }
}

/// Writes the licences of libraries with such features for such targets into a folder; `root` is the repository's.
pub(super) fn write(root: &Path, to: &Path, features: &str, targets: &[&str]) -> Result<()> {
    fs::create_dir_all(to).with_context(|| format!("cannot make {}", to.display()))?;
    for name in OURS {
        let from = root.join(name);
        fs::copy(&from, to.join(name))
            .with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
    }
    let readme = fs::read_to_string(root.join("README.md")).context("cannot read README.md")?;
    let text = third_party(&crates(features, targets)?, section(&readme)?);
    let to = to.join(THIRD_PARTY);
    fs::write(&to, text).with_context(|| format!("cannot write {}", to.display()))
}

/// The target of this machine.
pub(super) fn host() -> Result<String> {
    let says = output(Command::new("rustc").arg("-vV"))?;
    let host = says.lines().find_map(|line| line.strip_prefix("host: "));
    Ok(host.context("`rustc -vV` names no host")?.to_owned())
}

/// What README says of licences, the training data's among them.
fn section(readme: &str) -> Result<&str> {
    let (_, rest) =
        readme.split_once("\n## Licence\n").context("README.md has no section Licence")?;
    Ok(rest.split("\n## ").next().unwrap_or(rest).trim())
}

/// The crates of others whose code is in a library, by name and version. Macros run while it is built, and are not in it.
fn crates(features: &str, targets: &[&str]) -> Result<Vec<Crate>> {
    // `cargo metadata` alone would count features that other members of the workspace ask for.
    let mut tree = cargo();
    tree.args(["tree", "--locked", "--package", PACKAGE, "--features", features]);
    tree.args(["--edges", "normal,no-proc-macro", "--prefix", "none", "--no-dedupe"]);
    tree.args(["--format", "{p}"]);
    let mut options = vec!["--locked".to_owned()];
    for target in targets {
        tree.args(["--target", target]);
        options.extend(["--filter-platform".to_owned(), (*target).to_owned()]);
    }
    let tree = output(&mut tree)?;
    let wanted: BTreeSet<(&str, &str)> = tree
        .lines()
        .filter_map(|line| {
            let mut words = line.split(' ');
            Some((words.next()?, words.next()?.strip_prefix('v')?))
        })
        .collect();
    let metadata = MetadataCommand::new().other_options(options).exec()?;
    let mut found = Vec::new();
    for (name, version) in wanted {
        let is_it = |package: &&cargo_metadata::Package| {
            package.name.as_str() == name && package.version.to_string() == version
        };
        let package = metadata.packages.iter().find(is_it);
        let package = package.with_context(|| format!("cargo metadata has no {name} {version}"))?;
        // Ours.
        if package.source.is_none() {
            continue;
        }
        let folder = package.manifest_path.parent().context("a manifest has a folder")?;
        found.push(Crate {
            name: name.into(),
            version: version.into(),
            licence: package.license.clone().unwrap_or_else(|| "see its text".into()),
            repository: package.repository.clone().unwrap_or_default(),
            texts: texts(folder.as_std_path())?,
        });
    }
    if found.is_empty() {
        bail!("cargo tree names no crates that {PACKAGE} depends on:\n{tree}");
    }
    Ok(found)
}

/// Licences in a crate's folder and in a folder `LICENSES` of it, by name.
fn texts(folder: &Path) -> Result<Vec<(String, String)>> {
    let mut paths = Vec::new();
    for path in list(folder)? {
        let name = name_of(&path).to_uppercase();
        if !STARTS.iter().any(|start| name.starts_with(start)) {
            continue;
        }
        if path.is_dir() {
            paths.extend(list(&path)?.into_iter().filter(|path| path.is_file()));
        } else {
            paths.push(path);
        }
    }
    let read = |path: PathBuf| {
        let bytes = fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let text = String::from_utf8_lossy(&bytes).replace('\r', "");
        Ok((name_of(&path), text.trim_matches('\n').to_owned()))
    };
    paths.into_iter().map(read).collect()
}

fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// What a folder has, in an order that no file system decides.
fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries =
        fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}

/// The file: crates, README's section, and each text once.
fn third_party(crates: &[Crate], section: &str) -> String {
    let mut out = String::from(concat!(
        "RigidFormer ",
        env!("CARGO_PKG_VERSION"),
        " is MIT OR Apache-2.0: LICENSE-MIT and LICENSE-APACHE beside this file. Its README says:\n\n"
    ));
    out += section;
    out += "\n\nThe libraries hold compiled code of these crates, whose licences follow:\n\n";
    for a_crate in crates {
        out += &format!("{}: {}\n", a_crate.title(), a_crate.licence);
        out += &format!("    {}\n", a_crate.repository);
        if a_crate.texts.is_empty() {
            out += "    Its package has no text of the licence.\n";
        }
    }
    out += "\nThey also hold parts of Rust's standard library, most of it MIT OR Apache-2.0: the compiler's folder has\n\
            share/doc/rust/COPYRIGHT-library.html about it. https://www.rust-lang.org/policies/licenses\n";
    let mut texts: Vec<(&str, Vec<String>)> = Vec::new();
    for a_crate in crates {
        for (name, text) in &a_crate.texts {
            let of = format!("{name} of {}", a_crate.title());
            // However lines are broken.
            let is_known = |known: &str| known.split_whitespace().eq(text.split_whitespace());
            match texts.iter_mut().find(|(known, _)| is_known(known)) {
                Some((_, places)) => places.push(of),
                None => texts.push((text, vec![of])),
            }
        }
    }
    for (text, places) in texts {
        out += &format!("\n{}\n{}:\n\n{text}\n", "-".repeat(78), places.join(",\n"));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

    #[test]
    fn libraries_come_with_the_licences_of_what_they_hold() -> Result<()> {
        let folder = tempfile::tempdir()?;
        let targets = ["riscv32imc-unknown-none-elf", "riscv32imafc-unknown-none-elf"];
        let mut written = Vec::new();
        for name in ["first", "second"] {
            let to = folder.path().join(name);
            write(Path::new(ROOT), &to, super::super::EMBEDDED, &targets)?;
            for name in OURS {
                assert_eq!(fs::read(to.join(name))?, fs::read(Path::new(ROOT).join(name))?);
            }
            written.push(fs::read_to_string(to.join(THIRD_PARTY))?);
        }
        let [first, second] = written.as_slice() else { bail!("two were written") };
        assert_eq!(first, second);
        for (start, says) in
            [("nalgebra ", "Apache-2.0"), ("simba ", "Apache-2.0"), ("libm ", "MIT")]
        {
            let line = first.lines().find(|line| line.starts_with(start)).context(start)?;
            assert!(line.ends_with(&format!(": {says}")), "{line}");
            assert!(first.contains(&format!(" of {}", line.split(':').next().unwrap_or_default())));
        }
        // The training data's; and nothing that is ours, that only builds, or that other members ask for.
        assert!(first.contains("CC BY-SA 4.0"));
        for other in ["rigidformer-core ", "syn ", "tempfile ", "libc "] {
            assert!(!first.lines().any(|line| line.starts_with(other)), "{other}");
        }
        assert!(!first.contains("no text of the licence"), "a crate came without its licence");
        Ok(())
    }

    #[test]
    fn texts_of_several_crates_stand_once() {
        let of = |name: &str, texts: &[(&str, &str)]| Crate {
            name: name.into(),
            version: "1.0.0".into(),
            licence: "MIT".into(),
            repository: "https://example.invalid".into(),
            texts: texts.iter().map(|(name, text)| ((*name).into(), (*text).into())).collect(),
        };
        let crates = [
            of("a", &[("LICENSE", "Do as you like.")]),
            of("b", &[("COPYING", "  Do as\n  you like. "), ("NOTICE", "By b.")]),
            of("c", &[]),
        ];
        let text = third_party(&crates, "Ours.");
        assert_eq!(text.matches("you like.").count(), 1);
        assert!(text.contains("LICENSE of a 1.0.0,\nCOPYING of b 1.0.0:\n\nDo as you like.\n"));
        assert!(text.contains("NOTICE of b 1.0.0:\n\nBy b.\n"));
        assert!(text.contains("c 1.0.0: MIT\n    https://example.invalid\n    Its package has no"));
    }

    #[test]
    fn the_section_ends_with_the_next() -> Result<()> {
        assert_eq!(section("# A\n\n## Licence\n\nOurs.\nTheirs.\n")?, "Ours.\nTheirs.");
        assert_eq!(section("# A\n\n## Licence\n\nOurs.\n\n## More\n\nText.\n")?, "Ours.");
        assert!(section("# A\n").is_err());
        Ok(())
    }
}
