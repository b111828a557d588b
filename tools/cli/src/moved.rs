//! Commands of other programs that users look for here, and what to run instead.

use std::ffi::OsString;

use crate::usage::Usage;

/// A name, and what to run instead.
const MOVED: [(&str, &str); 6] = [
    ("controls", "`python -m rigidformer_lab.controls` in tools/lab (docs/CONTROLS.md)"),
    ("embed", "`rigidformer pack MODEL --header --out FILE`"),
    ("health", "`rigidformer inspect FILE --health`"),
    ("push", "`cargo run --release -p rigidformer-planning --example push`"),
    ("throw", "`cargo run --release -p rigidformer-planning --example throw`"),
    ("walk", "`cargo run --release -p rigidformer-planning --example walk`"),
];

/// Refuses a command line, the program's name first, whose command lives elsewhere.
pub(crate) fn check(line: &[OsString]) -> Result<(), Usage> {
    let words: Vec<_> = line.iter().skip(1).map(|word| word.to_str()).collect();
    let command = match words[..] {
        [Some("help"), command, ..] | [command, ..] => command,
        [] => None,
    };
    match MOVED.iter().find(|(name, _)| Some(*name) == command) {
        None => Ok(()),
        Some((name, instead)) => {
            Err(Usage(format!("`rigidformer {name}` is no command of this program; run {instead}")))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arguments::Arguments;
    use clap::CommandFactory;

    #[test]
    fn commands_that_live_elsewhere_are_named_with_what_to_run() {
        let line = |words: &[&str]| words.iter().map(OsString::from).collect::<Vec<_>>();
        for (name, instead) in MOVED {
            let error = check(&line(&["rigidformer", name, "--mesh"])).map_err(|error| error.0);
            assert!(
                error.is_err_and(|text| text.contains(name) && text.contains(instead)),
                "{name}"
            );
            assert!(check(&line(&["rigidformer", "help", name])).is_err(), "help {name}");
            let is_own = Arguments::command().get_subcommands().any(|own| own.get_name() == name);
            assert!(!is_own, "{name} is a command of the program");
        }
        for words in [
            &["rigidformer"][..],
            &["rigidformer", "rollout", "controls"],
            &["rigidformer", "help"],
        ] {
            assert!(check(&line(words)).is_ok(), "{words:?}");
        }
    }
}
