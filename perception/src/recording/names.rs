//! Names of files: their order, and the times that they are.

use std::cmp::Ordering;
use std::iter::Peekable;
use std::str::Chars;

/// Seconds since 1970 of years from 2001 to 2050: whole numbers of other sizes are no times.
const EPOCH_S: std::ops::Range<u64> = 978_307_200..2_524_608_000;
/// Median times between files, nanoseconds.
const INTERVALS_NS: std::ops::RangeInclusive<i128> = 500_000..=60_000_000_000;
/// Digits of nanoseconds.
const NANO_DIGITS: usize = 9;

/// Compares names with runs of digits as numbers: `2` comes before `10`.
pub(super) fn natural(one: &str, other: &str) -> Ordering {
    let (mut left, mut right) = (one.chars().peekable(), other.chars().peekable());
    loop {
        let both = (left.peek().copied(), right.peek().copied());
        let order = match both {
            (None, None) => return one.cmp(other),
            (Some(l), Some(r)) if l.is_ascii_digit() && r.is_ascii_digit() => {
                let (l, r) = (digits(&mut left), digits(&mut right));
                // Without leading zeros, the longer one is the larger one.
                l.len().cmp(&r.len()).then_with(|| l.cmp(&r))
            }
            (l, r) => {
                left.next();
                right.next();
                l.cmp(&r)
            }
        };
        if order != Ordering::Equal {
            return order;
        }
    }
}

/// Takes the digits that come next, without leading zeros.
fn digits(chars: &mut Peekable<Chars<'_>>) -> String {
    let mut found = String::new();
    while let Some(digit) = chars.next_if(char::is_ascii_digit) {
        if digit != '0' || !found.is_empty() {
            found.push(digit);
        }
    }
    found
}

/// Times of files.
#[derive(Debug, PartialEq)]
pub(super) struct Stamps {
    /// By file.
    pub(super) nanoseconds: Vec<i128>,
    /// How names say them.
    pub(super) kind: &'static str,
}

/// A name without what all names share.
struct Parts<'n> {
    before: &'n str,
    whole: &'n str,
    /// Behind a point, a dash or an underscore.
    fraction: Option<(char, &'n str)>,
    after: &'n str,
}

/// Times that names are, if all are: seconds with decimals, seconds and nanoseconds as ROS 2 writes them (not padded), or whole seconds,
/// milliseconds, microseconds or nanoseconds since 1970.
pub(super) fn stamps(names: &[impl AsRef<str>]) -> Option<Stamps> {
    let parts: Vec<Parts<'_>> =
        names.iter().map(|name| parts(name.as_ref())).collect::<Option<_>>()?;
    let first = parts.first()?;
    let separator = first.fraction.map(|(separator, _)| separator);
    let is_same = |part: &Parts<'_>| {
        part.before == first.before
            && part.after == first.after
            && part.fraction.map(|(separator, _)| separator) == separator
    };
    if parts.len() < 2 || !parts.iter().all(is_same) {
        return None;
    }
    match separator {
        None => whole(&parts),
        // Two numbers are a time behind a dash or an underscore only if the first one can be.
        Some('.') => fractions(&parts),
        Some(_) => {
            let is_time = |part: &Parts<'_>| {
                part.whole.parse().is_ok_and(|seconds: u64| EPOCH_S.contains(&seconds))
            };
            parts.iter().all(is_time).then(|| fractions(&parts)).flatten()
        }
    }
}

/// Splits a name at its longest number.
fn parts(name: &str) -> Option<Parts<'_>> {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for (at, byte) in name.bytes().enumerate() {
        match runs.last_mut() {
            Some((_, end)) if *end == at && byte.is_ascii_digit() => *end = at + 1,
            _ if byte.is_ascii_digit() => runs.push((at, at + 1)),
            _ => {}
        }
    }
    let is_joined = |one: &(usize, usize), other: &(usize, usize)| {
        one.1 + 1 == other.0 && matches!(name.get(one.1..other.0), Some("." | "_" | "-"))
    };
    let long = |run: &(usize, usize)| run.1 - run.0;
    let longest = (0..runs.len()).max_by_key(|index| long(&runs[*index]))?;
    // The longest number is the fraction, or the seconds, or all of it.
    let pair = match () {
        _ if long(&runs[longest]) > 10 => None,
        _ if longest > 0 && is_joined(&runs[longest - 1], &runs[longest]) => Some(longest - 1),
        _ => runs.get(longest + 1).filter(|next| is_joined(&runs[longest], next)).map(|_| longest),
    };
    let (start, end) = runs[pair.unwrap_or(longest)];
    let (fraction, last) = match pair.and_then(|first| runs.get(first + 1)) {
        Some((from, to)) => (name.get(end..)?.chars().next().zip(name.get(*from..*to)), *to),
        None => (None, end),
    };
    Some(Parts {
        before: name.get(..start)?,
        whole: name.get(start..end)?,
        fraction,
        after: name.get(last..)?,
    })
}

fn whole(parts: &[Parts<'_>]) -> Option<Stamps> {
    let numbers: Vec<u64> =
        parts.iter().map(|part| part.whole.parse().ok()).collect::<Option<_>>()?;
    let units = [
        (1_000_000_000, "seconds"),
        (1_000_000, "milliseconds"),
        (1000, "microseconds"),
        (1, "nanoseconds"),
    ];
    let is_of = |nanoseconds: u64| {
        numbers.iter().all(|number| EPOCH_S.contains(&(number / (1_000_000_000 / nanoseconds))))
    };
    let (unit, kind) = units.into_iter().find(|(unit, _)| is_of(*unit))?;
    let nanoseconds = numbers.iter().map(|number| i128::from(*number) * i128::from(unit)).collect();
    sound(Stamps { nanoseconds, kind })
}

fn fractions(parts: &[Parts<'_>]) -> Option<Stamps> {
    let fractions = || parts.iter().filter_map(|part| part.fraction.map(|(_, digits)| digits));
    let of = |kind, nanoseconds: fn(&str) -> Option<i128>| {
        let times = parts.iter().map(|part| {
            let seconds: u64 = part.whole.parse().ok()?;
            Some(i128::from(seconds) * 1_000_000_000 + nanoseconds(part.fraction?.1)?)
        });
        sound(Stamps { nanoseconds: times.collect::<Option<_>>()?, kind })
    };
    let decimal = || of("seconds", decimal);
    let nanos = || {
        of("seconds and nanoseconds, not padded", |digits| {
            digits.parse().ok().filter(|nanos: &u32| *nanos < 1_000_000_000).map(i128::from)
        })
    };
    let mut lengths = fractions().map(str::len);
    let first = lengths.next()?;
    // Nanoseconds that are not padded have no leading zeros, and decimals that were cut at their last digit end in none.
    let is_padded = lengths.all(|length| length == first) && first != NANO_DIGITS - 1;
    if is_padded || fractions().any(|digits| digits.len() > 1 && digits.starts_with('0')) {
        return decimal();
    }
    if fractions().any(|digits| digits.len() > 1 && digits.ends_with('0')) {
        return nanos();
    }
    // Either is possible: files come at a steady rate.
    match (decimal(), nanos()) {
        (Some(one), Some(other)) => Some(if spread(&one) <= spread(&other) { one } else { other }),
        (one, other) => one.or(other),
    }
}

/// Nanoseconds of decimals.
fn decimal(digits: &str) -> Option<i128> {
    let nine = digits.get(..digits.len().min(NANO_DIGITS))?;
    let number: i128 = nine.parse().ok()?;
    Some(number * 10_i128.pow((NANO_DIGITS - nine.len()) as u32))
}

/// Times between files, in order.
fn intervals(stamps: &Stamps) -> Vec<i128> {
    let mut times = stamps.nanoseconds.clone();
    times.sort_unstable();
    let mut intervals: Vec<i128> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    intervals.sort_unstable();
    intervals
}

/// How uneven the times between files are: the longest one over the median.
fn spread(stamps: &Stamps) -> f64 {
    let intervals = intervals(stamps);
    let at = |index: usize| intervals.get(index).map_or(0.0, |interval| *interval as f64);
    let last = intervals.len().saturating_sub(1);
    at(last) / at(last / 2).max(1.0)
}

/// Times that differ, as those of a recording do.
fn sound(stamps: Stamps) -> Option<Stamps> {
    let intervals = intervals(&stamps);
    let is_rising = intervals.first().is_some_and(|least| *least > 0);
    let median = intervals.get(intervals.len().saturating_sub(1) / 2)?;
    (is_rising && INTERVALS_NS.contains(median)).then_some(stamps)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_are_numbers() {
        let mut names = ["10.pcd", "9.pcd", "1.pcd", "scan-2", "scan-10", "scan-2b", "01.pcd", "a"];
        names.sort_by(|one, other| natural(one, other));
        assert_eq!(
            names,
            ["01.pcd", "1.pcd", "9.pcd", "10.pcd", "a", "scan-2", "scan-2b", "scan-10"]
        );
        let long = "9".repeat(5000);
        assert_eq!(natural(&long, &format!("1{long}")), Ordering::Less);
    }

    /// Milliseconds from the first file on.
    fn read(names: &[&str]) -> Option<(Vec<i64>, &'static str)> {
        let stamps = stamps(names)?;
        let first = *stamps.nanoseconds.first()?;
        let times = stamps.nanoseconds.iter().map(|time| ((time - first) / 1_000_000) as i64);
        Some((times.collect(), stamps.kind))
    }

    #[test]
    fn names_are_times_in_many_ways() {
        let ros = "seconds and nanoseconds, not padded";
        for (names, times, kind) in [
            (["899.950000000", "900.50000000", "900.150000000"], [0, 100, 200], ros),
            (["cloud_7.900000001", "cloud_8.1", "cloud_8.100000001"], [0, 100, 200], ros),
            (["899.25", "899.5", "899.75"], [0, 250, 500], "seconds"),
            (
                ["1305031102.175304", "1305031102.211214", "1305031102.243211"],
                [0, 35, 67],
                "seconds",
            ),
            (
                ["1700000000_050000000", "1700000000_150000000", "1700000000_250000000"],
                [0, 100, 200],
                "seconds",
            ),
            (
                ["1700000000100000000", "1700000000200000000", "1700000000300000000"],
                [0, 100, 200],
                "nanoseconds",
            ),
            (
                ["p1700000000100000", "p1700000000200000", "p1700000000300000"],
                [0, 100, 200],
                "microseconds",
            ),
            (
                ["1700000000100-left", "1700000000200-left", "1700000000300-left"],
                [0, 100, 200],
                "milliseconds",
            ),
            (["1700000001", "1700000002", "1700000003"], [0, 1000, 2000], "seconds"),
        ] {
            assert_eq!(read(&names), Some((times.to_vec(), kind)), "{names:?}");
        }
    }

    #[test]
    fn numbers_that_count_are_no_times() {
        for names in [
            ["1", "2", "3"],
            ["0000000001", "0000000002", "0000000003"],
            ["a", "b", "c"],
            ["take-1_1", "take-1_2", "take-1_3"],
            ["left.1", "right.2", "left.3"],
            ["1.5", "1.5", "1.6"],
            ["20240501123000", "20240501123001", "20240501123002"],
            ["1.000000001", "1.000000002", "1.000000003"],
            ["99999999999999999999999999", "99999999999999999999999998", "1"],
            ["1.é", "1.2", "é.1"],
        ] {
            assert_eq!(read(&names), None, "{names:?}");
        }
        assert_eq!(read(&["1700000000.5"]), None);
        assert_eq!(read(&[]), None);
    }
}
