//! Runs the examples as a user does.

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// A small trained model.
pub(crate) const NANO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../weights/models/nano.rfm");

/// The first source file that is newer than what cargo built of it, by the list that cargo writes beside a program.
fn newer_source(program: &Path) -> Option<PathBuf> {
    let list = program.with_extension("d");
    let text = std::fs::read_to_string(&list).ok();
    // A program, a colon, its sources; a blank in a name is escaped.
    let Some(sources) = text.as_deref().and_then(|text| text.split_once(": ")) else {
        return Some(list);
    };
    let built = program.metadata().and_then(|about| about.modified()).unwrap();
    let sources = sources.1.trim_end().replace("\\ ", "\0");
    let mut sources = sources.split(' ').map(|name| PathBuf::from(name.replace('\0', " ")));
    sources.find(|source| match source.metadata() {
        Ok(about) => about.is_file() && about.modified().unwrap() > built,
        Err(_) => true,
    })
}

/// An example that this crate's `cargo test` has built.
pub(crate) struct Example(pub(crate) &'static str);

impl Example {
    fn program(&self) -> PathBuf {
        let tests = env::current_exe().unwrap();
        let folder = tests.parent().and_then(|deps| deps.parent()).unwrap();
        let program = folder.join(format!("examples/{}{}", self.0, env::consts::EXE_SUFFIX));
        let release = if folder.ends_with("release") { " --release" } else { "" };
        let remedy = format!("cargo build -p rigidformer-planning --examples{release}");
        assert!(program.is_file(), "build the example {}: {remedy}", self.0);
        if let Some(source) = newer_source(&program) {
            panic!("{} is newer than the example {}: {remedy}", source.display(), self.0);
        }
        program
    }

    /// The program, which reads nothing from stdin.
    pub(crate) fn command(&self) -> Command {
        let mut command = Command::new(self.program());
        command.stdin(Stdio::null());
        command
    }

    pub(crate) fn run(&self, arguments: &[&str]) -> Output {
        self.command().args(arguments).output().unwrap()
    }

    /// Runs what must work; its stdout.
    pub(crate) fn works(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{arguments:?}: {stderr}");
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs what must fail with this exit code, say all of `expected` on stderr and nothing on stdout.
    pub(crate) fn fails(&self, arguments: &[&str], code: i32, expected: &[&str]) {
        let output = self.run(arguments);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {stderr}");
        for part in expected {
            assert!(stderr.contains(part), "{arguments:?}: no {part:?} in: {stderr}");
        }
        assert!(!stderr.contains("panicked"), "{stderr}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
}

/// A file of a temporary folder.
pub(crate) fn path(folder: &tempfile::TempDir, name: &str) -> String {
    folder.path().join(name).to_str().unwrap().to_owned()
}

/// Packs what the lab exported; the model's path.
pub(crate) fn packed(folder: &tempfile::TempDir, exported: &str) -> String {
    use rigidformer_evaluation::models::{Policy, Precision, packed};
    let model = path(folder, "model.rfm");
    let file = packed(exported.as_ref(), &Policy::from(Precision::F32)).unwrap().file;
    std::fs::write(&model, &file[..]).unwrap();
    model
}
