//! The ways in which applications link the libraries for Linux, each with a program of `bindings/c/tests/link`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use super::{MODEL, Place};
use crate::process::{output, run};

const SOURCES: &str = "bindings/c/tests/link";
/// Warnings are faults, in C as C programs are written, whichever compiler there is.
const C: [&str; 5] = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror"];
/// What docs/C.md says that a thread needs on Linux, KiB.
const STACK_KIB: &str = "192";
/// Models that a step is tried with on such a stack: rows of int8, and a network that sees what is in contact.
const OF_STACK: [&str; 2] = [MODEL, "weights/models/edge.rfm"];
/// Another model that a program embeds.
const SECOND: &str = "weights/models/edge.rfm";

/// Links and runs all of them.
pub(super) fn check(place: &Place) -> Result<()> {
    // A name with a space, as users have.
    let folder = place.folder.join("link ing");
    if folder.exists() {
        fs::remove_dir_all(&folder).context("cannot remove a folder")?;
    }
    fs::create_dir_all(&folder).context("cannot make a folder")?;
    fully_static(place, &folder)?;
    two_libraries(place, &folder)?;
    stack(place, &folder)?;
    embedding(place, &folder)
}

/// `cc`, and what pkg-config says for static libraries, between sources and `more`.
fn linked(
    place: &Place,
    sources: &[PathBuf],
    before: &[&str],
    after: &[&str],
    to: &Path,
) -> Result<()> {
    let mut flags = Command::new("pkg-config");
    flags.args(["--static", "--cflags", "--libs", "rigidformer"]);
    flags.env("PKG_CONFIG_PATH", place.prefix.join("lib/pkgconfig"));
    let flags = output(&mut flags)?;
    // The archive itself: with `-l` the linker would take the shared library.
    let archive = place.prefix.join("lib/librigidformer.a").display().to_string();
    let flags = flags.split_whitespace();
    let flags = flags.map(|flag| if flag == "-lrigidformer" { archive.as_str() } else { flag });
    let mut command = Command::new("cc");
    command.args(C).args(sources).args(before).args(flags).args(after).arg("-o").arg(to);
    run(&mut command)
}

fn source(name: &str) -> PathBuf {
    Path::new(SOURCES).join(name)
}

/// A program without any shared library, such as in a container without a system.
fn fully_static(place: &Place, folder: &Path) -> Result<()> {
    let program = folder.join("static");
    linked(place, &[source("stack.c")], &["-static", "-pthread"], &[], &program)?;
    let printed = output(Command::new(&program).args(["256", MODEL]))?;
    println!("C, cc -static: {}", printed.trim_end());
    Ok(())
}

/// Beside another static library of Rust, in either order.
fn two_libraries(place: &Place, folder: &Path) -> Result<()> {
    let other = folder.join("libother.a");
    let mut rustc = Command::new("rustc");
    rustc.args(["--edition", "2024", "--crate-type", "staticlib", "-O", "-o"]).arg(&other);
    run(rustc.arg(source("other.rs")))?;
    let other = other.display().to_string();
    let program = folder.join("both");
    for (before, after) in [(&[other.as_str()][..], &[][..]), (&[], &[other.as_str()])] {
        linked(place, &[source("both.c")], before, after, &program)?;
        let printed = output(Command::new(&program).arg(MODEL))?;
        let order = if after.is_empty() { "before" } else { "behind" };
        println!("C, another Rust library {order} ours: {}", printed.trim_end());
    }
    Ok(())
}

/// Steps on the stack that docs/C.md asks for.
fn stack(place: &Place, folder: &Path) -> Result<()> {
    let program = folder.join("stack");
    linked(place, &[source("stack.c")], &["-pthread"], &[], &program)?;
    let printed = output(Command::new(&program).arg(STACK_KIB).args(OF_STACK))?;
    print!("{printed}");
    Ok(())
}

/// A CMake project, written into a folder of its own; what it says where it cannot be configured.
fn configured(
    place: &Place,
    folder: &Path,
    languages: &str,
    calls: &str,
) -> Result<Option<String>> {
    fs::create_dir_all(folder).context("cannot make a folder")?;
    for name in ["models.c", "scene.h"] {
        super::install::copy(&source(name), &folder.join(name))?;
    }
    let text = format!(
        "cmake_minimum_required(VERSION 3.18)\nproject(models LANGUAGES {languages})\n\
         find_package(rigidformer 0.2 REQUIRED)\nadd_executable(models models.c)\n\
         target_link_libraries(models PRIVATE rigidformer::static)\n{calls}\n"
    );
    fs::write(folder.join("CMakeLists.txt"), text).context("cannot write a project")?;
    let mut command = Command::new("cmake");
    command.arg("-S").arg(folder).arg("-B").arg(folder.join("build"));
    command.arg(format!("-DCMAKE_PREFIX_PATH={}", place.prefix.display()));
    let done = command.output().context("cannot start cmake")?;
    // CMake breaks the lines of its messages.
    let said = String::from_utf8_lossy(&done.stderr);
    let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
    Ok((!done.status.success()).then_some(said))
}

/// Two models in one program, from a file whose name has a space; and what CMake refuses before anything is built.
fn embedding(place: &Place, folder: &Path) -> Result<()> {
    let model = folder.join("a model.rfm");
    super::install::copy(Path::new(MODEL), &model)?;
    let model = model.display().to_string();
    let second = Path::new(SECOND).canonicalize().with_context(|| format!("no {SECOND}"))?;
    let embed = |rest: &str| format!("rigidformer_embed_model(models {rest})\n");
    let first = embed(&format!("\"{model}\""));
    let both = first.clone() + &embed(&format!("\"{}\" SYMBOL second_model", second.display()));
    let project = folder.join("two models");
    if let Some(said) = configured(place, &project, "C ASM", &both)? {
        bail!("two models are refused: {said}");
    }
    output(Command::new("cmake").arg("--build").arg(project.join("build")))?;
    let printed = output(&mut Command::new(project.join("build/models")))?;
    for (name, path) in [("first", Path::new(MODEL)), ("second", &second)] {
        let bytes = fs::metadata(path).with_context(|| format!("no {}", path.display()))?.len();
        if !printed.contains(&format!("models: {name}, {bytes} bytes, ")) {
            bail!("a program with two models prints\n{printed}");
        }
    }
    print!("{printed}");
    for (number, (languages, calls, text)) in [
        ("C", first.clone(), "needs the language ASM: write enable_language(ASM)"),
        ("C ASM", embed("none.rfm"), "there is no model file"),
        ("C ASM", first.repeat(2), "give the other model a name of its own"),
        ("C ASM", embed(&format!("\"{model}\" SYMBOL 2nd")), "a name of C"),
    ]
    .into_iter()
    .enumerate()
    {
        let project = folder.join(format!("refused {number}"));
        match configured(place, &project, languages, &calls)? {
            Some(said) if said.contains(text) => println!("CMake refuses: {text}"),
            said => bail!("CMake was to say `{text}` to\n{calls}it said: {said:?}"),
        }
    }
    Ok(())
}
