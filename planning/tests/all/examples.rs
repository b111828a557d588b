//! Runs the examples as a user does.

use std::env;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

/// A small trained model.
pub(crate) const NANO: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../weights/models/nano.rfm");

/// An example that this crate's `cargo test` has built.
pub(crate) struct Example(pub(crate) &'static str);

impl Example {
    fn program(&self) -> PathBuf {
        let tests = env::current_exe().unwrap();
        let folder = tests.parent().and_then(|deps| deps.parent()).unwrap();
        let program = folder.join(format!("examples/{}{}", self.0, env::consts::EXE_SUFFIX));
        let name = self.0;
        assert!(
            program.is_file(),
            "build it: cargo build -p rigidformer-planning --example {name}"
        );
        program
    }

    pub(crate) fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(self.program());
        command.args(arguments).stdin(Stdio::null()).output().unwrap()
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
