//! What ran and what did not, why, and how to get it.

use std::collections::BTreeMap;
use std::fmt::{self, Display, Formatter};
use std::fs;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use comfy_table::presets::ASCII_MARKDOWN;
use comfy_table::{ContentArrangement, Table};

/// The skips that are no failure where `CI` is set.
const ALLOWED: &str = "tools/xtask/allowed-skips.toml";

/// Something that a check needs and that this machine cannot have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Missing {
    pub(crate) why: String,
    /// What to do by hand.
    pub(crate) remedy: String,
}

impl Missing {
    /// Texts of several lines become one, for the table.
    pub(crate) fn new(why: impl Display, remedy: impl Display) -> Missing {
        let line = |text: String| {
            let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
            lines.collect::<Vec<_>>().join("; ")
        };
        Missing { why: line(why.to_string()), remedy: line(remedy.to_string()) }
    }
}

impl Display for Missing {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}; by hand: {}", self.why, self.remedy)
    }
}

enum Outcome {
    Ran(Duration),
    /// The caller says so.
    RanBefore,
    /// A release needs it, a change does not.
    LeftOut,
    Skipped(Missing),
    Failed,
}

/// The outcomes of steps and of their parts, in order.
#[derive(Default)]
pub(crate) struct Report {
    step: String,
    rows: Vec<(String, Outcome)>,
    /// What steps guard, by their names.
    guards: BTreeMap<String, &'static str>,
}

impl Report {
    /// Runs a step and notes what became of it; those of its parts that are skipped have rows of their own.
    pub(crate) fn step(
        &mut self,
        name: &str,
        run: impl FnOnce(&mut Report) -> Result<()>,
    ) -> Result<()> {
        println!("== {name}");
        name.clone_into(&mut self.step);
        let (at, start) = (self.rows.len(), Instant::now());
        let done = run(self);
        let skipped = self.rows.iter().skip(at).any(|(row, _)| row == name);
        match &done {
            Ok(()) if skipped => {}
            Ok(()) => self.rows.insert(at, (name.into(), Outcome::Ran(start.elapsed()))),
            Err(_) => self.rows.insert(at, (name.into(), Outcome::Failed)),
        }
        self.step.clear();
        done
    }

    /// Says what a step guards, for the table.
    pub(crate) fn guards(&mut self, name: &str, what: &'static str) {
        self.guards.insert(name.into(), what);
    }

    /// Notes a step that only `--full` runs.
    pub(crate) fn left_out(&mut self, name: &str) {
        self.rows.push((name.into(), Outcome::LeftOut));
    }

    /// Notes a step that ran before this program started.
    pub(crate) fn ran_before(&mut self, name: &str) {
        println!("== {name}: ran before");
        self.rows.push((name.into(), Outcome::RanBefore));
    }

    /// Notes that the step cannot run.
    pub(crate) fn skip(&mut self, missing: Missing) {
        println!("skipped: {missing}");
        self.rows.push((self.step.clone(), Outcome::Skipped(missing)));
    }

    /// Notes that a part of the step cannot run.
    pub(crate) fn skip_part(&mut self, part: &str, missing: Missing) {
        println!("{part}: skipped: {missing}");
        self.rows.push((format!("{}: {part}", self.step), Outcome::Skipped(missing)));
    }

    fn skipped(&self) -> impl Iterator<Item = (&str, &Missing)> {
        self.rows.iter().filter_map(|(row, outcome)| match outcome {
            Outcome::Skipped(missing) => Some((row.as_str(), missing)),
            _ => None,
        })
    }

    /// A row for each step and each skipped part.
    pub(crate) fn table(&self) -> String {
        let mut table = Table::new();
        table.load_style(ASCII_MARKDOWN);
        table.set_content_arrangement(ContentArrangement::Disabled);
        table.set_header(["step", "guards", "outcome", "why", "how to get it"]);
        for (name, outcome) in &self.rows {
            let (outcome, why, remedy) = match outcome {
                Outcome::Ran(took) => (format!("ran, {}", minutes(*took)), "", ""),
                Outcome::RanBefore => ("ran before".into(), "", ""),
                Outcome::LeftOut => ("left out".into(), "a release needs it", "--full"),
                Outcome::Failed => ("FAILED".into(), "the error is below", ""),
                Outcome::Skipped(Missing { why, remedy }) => {
                    ("SKIPPED".into(), why.as_str(), remedy.as_str())
                }
            };
            let guards = self.guards.get(name).copied().unwrap_or_default();
            table.add_row([name, guards, &outcome, why, remedy]);
        }
        table.to_string()
    }

    /// An error for every skip that is not allowed, and for every permission that names no step.
    pub(crate) fn judge(&self, allowed: &Allowed) -> Result<()> {
        let mut faults = Vec::new();
        for (name, missing) in self.skipped() {
            if !allowed.0.contains_key(name) {
                faults.push(format!("{name} was skipped: {missing}"));
            }
        }
        for name in allowed.0.keys() {
            let step = name.split(": ").next().unwrap_or_default();
            if !self.rows.iter().any(|(row, _)| row.split(": ").next() == Some(step)) {
                faults.push(format!("{ALLOWED} names {name}, and there is no such step"));
            }
        }
        if !faults.is_empty() {
            bail!("{}\nwith CI=true only the skips in {ALLOWED} are allowed", faults.join("\n"));
        }
        Ok(())
    }

    /// How many steps and parts did not run.
    pub(crate) fn skips(&self) -> usize {
        self.skipped().count()
    }
}

/// Steps, or parts of steps, that may be skipped where `CI` is set, and the reasons.
#[derive(Debug)]
pub(crate) struct Allowed(BTreeMap<String, String>);

impl Allowed {
    pub(crate) fn read() -> Result<Allowed> {
        let text = fs::read_to_string(ALLOWED).with_context(|| format!("cannot read {ALLOWED}"))?;
        Self::parse(&text)
    }

    pub(crate) fn parse(text: &str) -> Result<Allowed> {
        let allowed: BTreeMap<String, String> = toml::from_str(text).with_context(|| {
            format!("{ALLOWED} must have lines such as `\"step: part\" = \"the reason\"`")
        })?;
        if let Some((name, _)) = allowed.iter().find(|(_, reason)| reason.trim().is_empty()) {
            bail!("{ALLOWED} gives no reason for {name}");
        }
        Ok(Allowed(allowed))
    }
}

/// Such as 1 min 46 s.
pub(crate) fn minutes(took: Duration) -> String {
    let seconds = took.as_secs_f64().round() as u64;
    match (seconds / 60, seconds % 60) {
        (0, seconds) => format!("{seconds} s"),
        (minutes, seconds) => format!("{minutes} min {seconds} s"),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn missing() -> Missing {
        Missing::new("no qemu:\n  E: broken", "apt-get install qemu")
    }

    /// A run with a step of each outcome.
    fn report() -> Report {
        let mut report = Report::default();
        report.guards("tests", "bits");
        report.ran_before("tests");
        report.left_out("site");
        report.step("lints", |_| Ok(())).unwrap();
        let bits = |report: &mut Report| {
            report.skip_part("aarch64", missing());
            Ok(())
        };
        report.step("bits", bits).unwrap();
        let firmware = |report: &mut Report| {
            report.skip(missing());
            Ok(())
        };
        report.step("firmware", firmware).unwrap();
        assert!(report.step("header", |_| bail!("it differs")).is_err());
        report
    }

    #[test]
    fn the_table_has_a_row_for_each_step_and_each_skipped_part() {
        let table = report().table();
        let rows: Vec<Vec<&str>> = table
            .lines()
            .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
            .collect();
        assert_eq!(rows[0], ["step", "guards", "outcome", "why", "how to get it"]);
        let (why, remedy) = ("no qemu:; E: broken", "apt-get install qemu");
        assert_eq!(
            rows[2..],
            [
                ["tests", "bits", "ran before", "", ""],
                ["site", "", "left out", "a release needs it", "--full"],
                ["lints", "", "ran, 0 s", "", ""],
                ["bits", "", "ran, 0 s", "", ""],
                ["bits: aarch64", "", "SKIPPED", why, remedy],
                ["firmware", "", "SKIPPED", why, remedy],
                ["header", "", "FAILED", "the error is below", ""],
            ]
        );
    }

    #[test]
    fn only_the_skips_of_the_list_are_allowed() {
        let judge = |text: &str| report().judge(&Allowed::parse(text).unwrap());
        let error = judge("").unwrap_err().to_string();
        assert!(error.contains("bits: aarch64 was skipped: no qemu"), "{error}");
        assert!(error.contains("firmware was skipped"), "{error}");
        assert!(judge("firmware = 'none'").is_err());
        assert!(judge("firmware = 'none'\n'bits: aarch64' = 'none'").is_ok());
        let error = judge("firmwear = 'none'").unwrap_err().to_string();
        assert!(error.contains("firmwear, and there is no such step"), "{error}");
    }

    #[test]
    fn a_permission_needs_a_reason() {
        assert!(Allowed::parse("firmware = ' '").is_err());
        assert!(Allowed::parse("firmware = true").is_err());
        assert!(Allowed::parse("# none\n").unwrap().0.is_empty());
    }

    #[test]
    fn times_are_in_minutes() {
        assert_eq!(minutes(Duration::from_millis(1400)), "1 s");
        assert_eq!(minutes(Duration::from_millis(59_600)), "1 min 0 s");
        assert_eq!(minutes(Duration::from_secs(106)), "1 min 46 s");
    }
}
