//! Where a search goes: a number's distance from what the scenes have, in its spreads.

use rigidformer_evaluation::contact::{Contact, NUMBERS, Number, Scale};
use rigidformer_evaluation::scenes::RecordedScene;

use super::intervals::{Bounds, Fit};

/// Cost of a squared spread beyond a number's range.
const BEYOND: f64 = 10.0;
/// Share of the resampled fits below an interval, and above it.
const TAIL: f64 = 0.05;

pub(super) struct Space {
    /// Places among the [`NUMBERS`].
    fit: Vec<usize>,
    given: Contact,
    /// Where searches begin.
    begin: Contact,
}

impl Space {
    pub(super) fn new(fit: &[usize], scenes: &[RecordedScene]) -> Self {
        let mean = |of: fn(&RecordedScene) -> Contact| {
            let all: Vec<Contact> = scenes.iter().map(of).collect();
            fit.iter().fold(Contact::default(), |mean, at| {
                let sum: f64 = all.iter().filter_map(|of| of.at(*at)).map(f64::from).sum();
                mean.with(*at, Some((sum / all.len().max(1) as f64) as f32))
            })
        };
        Space { fit: fit.to_vec(), given: mean(Contact::of), begin: mean(Contact::begin) }
    }

    pub(super) fn len(&self) -> usize {
        self.fit.len()
    }

    /// Means of what the scenes have.
    pub(super) fn given(&self) -> Contact {
        self.given
    }

    fn numbers(&self) -> impl Iterator<Item = (usize, &'static Number, f64)> + '_ {
        static ALL: [Number; NUMBERS.len()] = NUMBERS;
        self.fit.iter().filter_map(|at| {
            let number = ALL.get(*at)?;
            Some((*at, number, along(number, f64::from(self.begin.at(*at)?))))
        })
    }

    /// The numbers at a place, each in its range.
    pub(super) fn contact(&self, place: &[f64]) -> Contact {
        self.numbers().zip(place).fold(Contact::default(), |contact, ((at, number, zero), own)| {
            contact.with(at, Some(back(number, zero + own * number.spread) as f32))
        })
    }

    /// The place of numbers.
    pub(super) fn place(&self, contact: &Contact) -> Vec<f64> {
        let own = |(at, number, zero): (usize, &Number, f64)| {
            let value = contact.at(at).map_or(zero, |value| along(number, f64::from(value)));
            (value - zero) / number.spread
        };
        self.numbers().map(own).collect()
    }

    /// What tells numbers apart.
    pub(super) fn key(&self, contact: &Contact) -> Vec<u32> {
        self.fit.iter().map(|at| contact.at(*at).unwrap_or_default().to_bits()).collect()
    }

    /// Cost of a place where numbers are out of their ranges: it leads back.
    pub(super) fn penalty(&self, place: &[f64]) -> f64 {
        let kept = self.place(&self.contact(place));
        let beyond = place.iter().zip(kept).map(|(own, kept)| (own - kept) * (own - kept));
        // Numbers are rounded to f32, which is no reason to go back.
        beyond.filter(|square| *square > 1e-8).sum::<f64>() * BEYOND
    }

    /// (numbers) Intervals: how far `ends`, where fits to resampled scenes end, are from `least`, where that to all scenes does. What the
    /// quadratic is off by is off alike in both.
    pub(super) fn bounds(
        &self,
        (ends, least): (&[Vec<f64>], &[f64]),
        fit: &Fit,
        contact: &Contact,
    ) -> Vec<Option<Bounds>> {
        let own = self.place(contact);
        let bounds = |(index, (_, number, zero)): (usize, (usize, &Number, f64))| {
            let mut all: Vec<f64> = ends.iter().filter_map(|end| end.get(index).copied()).collect();
            all.sort_by(f64::total_cmp);
            let last = all.len().checked_sub(1)?;
            let at = |share: f64| all.get((share * last as f64).round() as usize).copied();
            let (low, high) = (at(TAIL)?, at(1.0 - TAIL)?);
            let open = fit.open(index, low, high);
            let (own, least) = (own.get(index).copied()?, least.get(index).copied()?);
            let [first, last] = fit.reach(index);
            // An interval holds the number itself, and ends where the quadratic does.
            let low = if open[0] { first } else { own + (low - least).min(0.0) }.max(first);
            let high = if open[1] { last } else { own + (high - least).max(0.0) }.min(last);
            let [lowest, highest] = number.range;
            let value = |place: f64| {
                (back(number, zero + place * number.spread) as f32).clamp(lowest, highest)
            };
            let (low, high) = (value(low.min(own)), value(high.max(own)));
            Some(Bounds { low, high, open })
        };
        self.numbers().enumerate().map(bounds).collect()
    }
}

fn along(number: &Number, value: f64) -> f64 {
    match number.scale {
        Scale::Linear => value,
        Scale::Log => libm::log(value),
    }
}

fn back(number: &Number, along: f64) -> f64 {
    match number.scale {
        Scale::Linear => along,
        Scale::Log => libm::exp(along),
    }
}
