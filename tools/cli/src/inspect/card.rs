//! A model's card: what it was made from and how, what it is worth, and where it fails.

use rigidformer_weights::ModelFile;

use crate::output;

/// What a metric's name ends with that is of the same motion without the network; `rigidformer pack --metrics` writes both.
pub(crate) const WITHOUT: &str = ".without_network";
/// Figures that differ by less are called equal, per cent: a mean over 120 scenes is known no better.
const EQUAL_PERCENT: f32 = 2.0;

/// A figure with the network and, where the file has it, without.
struct Figure<'m> {
    name: &'m str,
    with: f32,
    without: Option<f32>,
}

impl Figure<'_> {
    /// What the network takes off an error, per cent.
    fn gain(&self) -> Option<f32> {
        self.without
            .filter(|without| *without > 0.0)
            .map(|without| 100.0 * (1.0 - self.with / without))
    }
}

fn figures<'m>(metrics: &[(&'m str, f32)]) -> Vec<Figure<'m>> {
    let with = metrics.iter().filter(|(name, _)| !name.ends_with(WITHOUT));
    with.map(|&(name, with)| {
        let beside = |(other, _): &&(&str, f32)| other.strip_suffix(WITHOUT) == Some(name);
        Figure { name, with, without: metrics.iter().find(beside).map(|(_, value)| *value) }
    })
    .collect()
}

pub(super) fn run(file: &ModelFile<'_>, length: usize) -> anyhow::Result<()> {
    let config = file.config();
    let metrics: Vec<(&str, f32)> = file.metrics().collect();
    let figures = figures(&metrics);
    let said =
        |key: &str| file.provenance().find(|(known, _)| *known == key).map(|(_, value)| value);
    let line = |text: &str| output::line(text);
    output::line(format_args!("# Model card: {}", output::name(file.name())))?;
    output::line(format_args!(
        "\n{} parameters, {length} bytes, weights CRC-32 {:08x}, motion {:?}.",
        file.parameters(),
        file.payload_crc(),
        config.motion
    ))?;
    line("\n## Data and training\n")?;
    let mut has_provenance = false;
    for (key, value) in file.provenance().filter(|(key, _)| *key != "licence") {
        has_provenance = true;
        output::line(format_args!("- {}: {value}", output::name(key)))?;
    }
    if !has_provenance {
        line("The file does not say.")?;
    }
    line("\n## Figures\n")?;
    if figures.is_empty() {
        line(
            "The file has none: `rigidformer pack --metrics` adds those of `rigidformer evaluate --json`.",
        )?;
    } else {
        line("With the network, and of the same motion without it.\n")?;
        line("|figure|with|without|gain|\n|---|---|---|---|")?;
    }
    for figure in &figures {
        let without = figure.without.map_or("-".into(), |value| format!("{value:.4}"));
        let gain = figure.gain().map_or("-".into(), |gain| format!("{gain:.0} %"));
        output::line(format_args!(
            "|{}|{:.4}|{without}|{gain}|",
            output::name(figure.name),
            figure.with
        ))?;
    }
    line("\n## Where it fails\n")?;
    let worse: Vec<&Figure<'_>> = figures
        .iter()
        .filter(|figure| figure.gain().is_some_and(|gain| gain < -EQUAL_PERCENT))
        .collect();
    for figure in &worse {
        let gain = figure.gain().unwrap_or_default();
        output::line(format_args!(
            "- {}: {:.0} % worse than the same motion without it.",
            output::name(figure.name),
            -gain
        ))?;
    }
    if !figures.iter().any(|figure| figure.without.is_some()) {
        line("- It is not compared with the same motion without its network.")?;
    } else if worse.is_empty() {
        line("- No figure above is worse than without the network.")?;
    }
    if config.most_units > 0 {
        output::line(format_args!(
            "- Scenes of more than {} units, and those with a contact law, are left alone: they move without the network.",
            config.most_units
        ))?;
    }
    line(
        "- Scenes unlike its data are not known; `rigidformer inspect SCENES --health` counts them.",
    )?;
    line("\n## Licence\n")?;
    line(said("licence").unwrap_or("The file does not say."))
}

#[cfg(test)]
mod tests {
    use super::figures;

    #[test]
    fn figures_come_with_those_without_the_network() {
        let metrics = [("a.m", 0.5), ("a.m.without_network", 1.0), ("b.m", 2.0)];
        let found: Vec<_> = figures(&metrics).iter().map(|f| (f.name, f.with, f.gain())).collect();
        assert_eq!(found, [("a.m", 0.5, Some(50.0)), ("b.m", 2.0, None)]);
    }
}
