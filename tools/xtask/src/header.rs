//! The headers of `bindings/c/include`, generated from the crate.

use std::collections::BTreeSet;
use std::fs;

use anyhow::{Context, Result, bail};
use cbindgen::{Builder, Config};

struct Header {
    path: &'static str,
    /// cbindgen's.
    config: &'static str,
    /// Files of the crate below `src`, in the order of the header.
    files: &'static [&'static str],
}

const HEADERS: [Header; 2] = [
    Header {
        path: "bindings/c/include/rigidformer.h",
        config: "bindings/c/cbindgen.toml",
        files: &["types", "ffi", "edit", "joints", "state", "health"],
    },
    Header {
        path: "bindings/c/include/rigidformer_tracker.h",
        config: "bindings/c/cbindgen-tracker.toml",
        files: &["tracker/types", "tracker/ffi"],
    },
];

/// Compares the committed headers with the crate; `bless` writes them first.
pub(crate) fn run(bless: bool) -> Result<()> {
    for header in &HEADERS {
        let path = header.path;
        let generated = generate(header)?;
        if bless {
            fs::write(path, &generated).with_context(|| format!("cannot write {path}"))?;
        }
        let committed = fs::read_to_string(path).with_context(|| format!("cannot read {path}"))?;
        if let Some(difference) = difference(&committed, &generated) {
            bail!(
                "{path} is not what the crate says, from {difference}\n`cargo xtask header --bless` writes it"
            );
        }
        println!("{path} is what the crate says");
    }
    Ok(())
}

fn generate(header: &Header) -> Result<String> {
    let config = Config::from_file(header.config)
        .map_err(|error| anyhow::anyhow!("{}: {error}", header.config))?;
    let mut builder = Builder::new().with_config(config);
    // Not `with_crate`: that would ask cargo about every dependency.
    let mut unsigned = BTreeSet::new();
    for file in header.files {
        let path = format!("bindings/c/src/{file}.rs");
        let source = fs::read_to_string(&path).with_context(|| format!("cannot read {path}"))?;
        unsigned.extend(source.lines().filter_map(unsigned_constant).map(str::to_owned));
        builder = builder.with_src(path);
    }
    let mut text = Vec::new();
    builder.generate().context("cbindgen cannot read the crate")?.write(&mut text);
    Ok(for_c(&String::from_utf8(text)?, &unsigned))
}

/// The name of a constant without a sign.
fn unsigned_constant(line: &str) -> Option<&str> {
    let (name, rest) = line.strip_prefix("pub const ")?.split_once(": ")?;
    let (kind, _) = rest.split_once(" = ")?;
    ["u32", "usize"].contains(&kind).then_some(name)
}

/// Leaves out what only Rust's documentation needs, sections for those who call the functions from Rust, and writes what cbindgen does
/// not: constants without a sign with a `U`, or braces of C++ narrow them, and nothing that C89 lacks.
fn for_c(text: &str, unsigned: &BTreeSet<String>) -> String {
    let mut out = String::new();
    let mut skipping = false;
    for line in text.lines() {
        let comment = line.trim_start();
        let mut line = line.to_owned();
        let mut words = line.split(' ');
        if words.next() == Some("#define") && words.next().is_some_and(|n| unsigned.contains(n)) {
            line.push('U');
        }
        // Within comments of several lines `//` is text.
        if !comment.starts_with('*')
            && let Some((code, said)) = line.split_once("//")
        {
            line = format!("{}/* {} */", code, said.trim());
        }
        if line == "};" && out.ends_with(",\n") {
            out.truncate(out.len() - ",\n".len());
            out.push('\n');
        }
        if comment.starts_with("* # Safety") {
            skipping = true;
            // The blank line of the comment before it.
            if out.ends_with(" *\n") {
                out.truncate(out.len() - " *\n".len());
            }
        }
        if skipping && comment.starts_with("*/") {
            skipping = false;
        }
        if !skipping {
            out.push_str(line.trim_end());
            out.push('\n');
        }
    }
    out
}

/// The first line that differs, of both texts.
fn difference(committed: &str, generated: &str) -> Option<String> {
    if committed == generated {
        return None;
    }
    let (mut a, mut b) = (committed.lines(), generated.lines());
    let mut number = 0;
    loop {
        number += 1;
        let (a, b) = (a.next(), b.next());
        if a != b || a.is_none() {
            let show = |line: Option<&str>| line.unwrap_or("(end)").to_owned();
            return Some(format!("line {number}:\n  {} (committed)\n  {}", show(a), show(b)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_difference_is_named() {
        assert_eq!(difference("a\nb\n", "a\nb\n"), None);
        assert_eq!(
            difference("a\nb\n", "a\nc\n").as_deref(),
            Some("line 2:\n  b (committed)\n  c")
        );
        assert_eq!(
            difference("a\n", "a\nc\n").as_deref(),
            Some("line 2:\n  (end) (committed)\n  c")
        );
    }

    /// What each change of a scene comes to, by core's `EditError`, `ObserveError` and `JoinError`: `bindings/c/src/status.rs`
    /// makes codes of them.
    const REFUSALS: [(&str, &[&str]); 21] = [
        ("rf_add", &["NO_TIMESTEP", "BAD_ROLE", "BAD_BODY", "DEFORMS"]),
        ("rf_remove", &["NO_SUCH_ID", "DEFORMS"]),
        ("rf_drive", &["NO_SUCH_ID", "NOT_DRIVEN", "BAD_POSE"]),
        ("rf_set_poses", &["NO_SUCH_ID", "BAD_POSE", "DEFORMS"]),
        ("rf_set_velocity", &["NO_SUCH_ID", "BAD_VELOCITY", "BAD_POSE", "DEFORMS"]),
        ("rf_save", &["BUFFER"]),
        (
            "rf_load",
            &["TOO_MANY_UNITS", "TOO_MANY_POINTS", "TOO_MANY_BONDS", "STATE", "STATE_FEATURE"],
        ),
        ("rf_set_physics", &["NO_SUCH_ID", "BAD_PHYSICS"]),
        ("rf_set_compliance", &["NO_SUCH_ID", "BAD_COMPLIANCE", "NO_COMPLIANCE"]),
        ("rf_set_plane_compliance", &["NO_SUCH_PLANE", "BAD_COMPLIANCE", "NO_COMPLIANCE"]),
        ("rf_set_role", &["NO_SUCH_ID", "BAD_ROLE", "BONDED", "DEFORMS"]),
        ("rf_set_planes", &["TOO_MANY_PLANES", "BAD_PLANE"]),
        ("rf_set_contact_law", &["BAD_CONTACT_LAW"]),
        ("rf_set_gravity", &["BAD_GRAVITY", "BAD_TIMESTEP"]),
        ("rf_set_dt", &["BAD_TIMESTEP"]),
        ("rf_join", &["NO_SUCH_ID", "BAD_JOINT", "BONDED", "DEFORMS", "NO_JOINTS"]),
        ("rf_join_by", &["NO_SUCH_ID", "BAD_JOINT", "BONDED", "DEFORMS", "NO_JOINTS"]),
        ("rf_set_joint_target", &["NO_SUCH_ID", "BAD_JOINT", "NO_JOINTS"]),
        ("rf_joint_position", &["NO_SUCH_ID", "BAD_JOINT", "NO_JOINTS"]),
        ("rf_unjoin", &["NO_SUCH_ID", "NO_JOINTS"]),
        (
            "rf_innovation",
            &["NULL", "ALIGNMENT", "LENGTH", "BAD_POSE", "BAD_VARIANCE", "NO_HEALTH"],
        ),
    ];

    #[test]
    fn the_header_lists_what_functions_return() -> Result<()> {
        let header = include_str!("../../../bindings/c/include/rigidformer.h");
        for (function, codes) in REFUSALS {
            let declared = format!("rf_status {function}(");
            let (before, _) = header.split_once(&declared).context(function)?;
            let (_, returns) = before.rsplit_once("@return").context(function)?;
            for code in codes {
                let code = format!("RF_ERROR_{code}");
                let mut words = returns.split(|c: char| c != '_' && !c.is_alphanumeric());
                assert!(words.any(|word| word == code), "{function} also returns {code}");
            }
        }
        Ok(())
    }

    #[test]
    fn sections_for_rust_are_left_out() {
        let text = "/**\n * Steps.\n *\n * # Safety\n * A promise.\n */\nint step(void);\n";
        assert_eq!(for_c(text, &BTreeSet::new()), "/**\n * Steps.\n */\nint step(void);\n");
    }

    #[test]
    fn constants_say_that_they_have_no_sign() {
        assert_eq!(unsigned_constant("pub const RF_A: u32 = 1;"), Some("RF_A"));
        assert_eq!(unsigned_constant("pub const RF_B: i32 = -1;"), None);
        let text =
            "#define RF_A 1\n#define RF_B -1\n#endif // A\nenum a {\n  B = 1,\n};\n * // text\n";
        let expected =
            "#define RF_A 1U\n#define RF_B -1\n#endif /* A */\nenum a {\n  B = 1\n};\n * // text\n";
        assert_eq!(for_c(text, &BTreeSet::from(["RF_A".to_owned()])), expected);
    }
}
