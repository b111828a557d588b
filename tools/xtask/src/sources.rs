//! The machine's own package sources, as apt reads them.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};

/// The entries that name the main Debian archive.
pub(crate) fn debian() -> Result<Vec<Source>> {
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
    sources.retain(Source::is_debian);
    if sources.is_empty() {
        bail!("the apt sources of this machine name no Debian archive");
    }
    Ok(sources)
}

/// An entry of the machine's package sources.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Source {
    pub(crate) uri: String,
    pub(crate) suites: Vec<String>,
    /// The file of keys that the archive must be signed with.
    pub(crate) signed_by: Option<String>,
}

impl Source {
    /// The main archive: not its security updates, and not another vendor's.
    pub(crate) fn is_debian(&self) -> bool {
        self.uri.trim_end_matches('/').ends_with("/debian")
    }

    /// The suites but their updates and backports.
    pub(crate) fn releases(&self) -> impl Iterator<Item = &String> + Clone {
        self.suites.iter().filter(|suite| !suite.contains('-'))
    }

    pub(crate) fn with_suite(&self, suite: &str) -> String {
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
pub(crate) fn files(folder: &Path) -> Result<Vec<PathBuf>> {
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
}
