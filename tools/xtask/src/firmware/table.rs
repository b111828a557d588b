//! The measured numbers for people.

use super::budget::Numbers;

const STAGES: [&str; 7] =
    ["impulses", "nearest", "encoder", "interaction", "anchors", "kabsch", "step"];

const COLUMNS: [(&str, &str); 6] = [
    ("runtime, text", "runtime.text"),
    ("model", "model"),
    ("image, flash", "rollout.flash"),
    ("static RAM", "rollout.ram"),
    ("of which workspace", "rollout.workspace"),
    ("stack, at most", "rollout.stack"),
];

/// Instructions a step, then bytes, as Markdown.
pub(super) fn tables(numbers: &Numbers) -> String {
    let mut steps = vec![header(["board", "scene"].into_iter().chain(STAGES))];
    for (board, numbers) in numbers {
        for scene in ["contact", "flight"] {
            let of = |stage: &&str| millions(numbers.get(&format!("rollout.{scene}.{stage}")));
            let row = [board.clone(), scene.to_owned()];
            steps.push(line(row.into_iter().chain(STAGES.iter().map(of))));
        }
    }
    let mut bytes = vec![header(["board"].into_iter().chain(COLUMNS.map(|(title, _)| title)))];
    for (board, numbers) in numbers {
        let of = |(_, name): (&str, &str)| grouped(numbers.get(name).copied());
        bytes.push(line([board.clone()].into_iter().chain(COLUMNS.map(of))));
    }
    let (steps, bytes) = (steps.concat(), bytes.concat());
    format!("Millions of instructions a step\n\n{steps}\nBytes\n\n{bytes}")
}

fn header<'t>(titles: impl Iterator<Item = &'t str> + Clone) -> String {
    let rule: String = titles.clone().map(|_| "|---").collect();
    format!("{}{rule}|\n", line(titles.map(str::to_owned)))
}

fn line(cells: impl Iterator<Item = String>) -> String {
    format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
}

pub(crate) fn millions(number: Option<&f64>) -> String {
    number.map_or("-".into(), |number| format!("{:.2}", number / 1e6))
}

/// With commas between thousands.
pub(crate) fn grouped(number: Option<f64>) -> String {
    let Some(number) = number else { return "-".into() };
    let digits = format!("{number:.0}");
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_grouped() {
        assert_eq!(grouped(Some(1234567.0)), "1,234,567");
        assert_eq!(grouped(Some(999.0)), "999");
        assert_eq!(grouped(None), "-");
    }
}
