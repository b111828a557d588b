//! When messages were made: by their stamps, or where these say nothing, by the times at which they were logged.

use std::collections::BTreeMap;

use super::notes::{Note, Notes};
use super::points::shortened;

/// Messages of a topic that tell what its stamps are worth.
const SAMPLES: usize = 8;
/// Topics whose clocks are learned, at most; stamps of others are believed.
// All are looked at for each message.
const MAX_TOPICS: usize = 64;
/// Log times that differ by less do not move, nanoseconds.
const MOVED_NS: i128 = 1_000_000;
/// Clocks that differ by more are not the same, nanoseconds.
// Transforms may be sent a second ahead of their time.
const OTHER_NS: i128 = 5_000_000_000;
/// A stamp that is off by more than this from those before it is none, nanoseconds.
const WILD_NS: i128 = 3_600_000_000_000;

/// Stamps of one topic.
#[derive(Debug, Default)]
struct Topic {
    /// Of the first messages: stamp and log time.
    samples: Vec<(i128, i128)>,
    /// How much later messages were logged than stamped, of the last one whose stamp is believed.
    behind: Option<i128>,
    is_of_transforms: bool,
}

impl Topic {
    /// How much later messages were logged than stamped; none where the stamps are 0 or stand still.
    fn offset(&self) -> Option<i128> {
        let (first, logged) = *self.samples.first()?;
        let stands = self.samples.iter().all(|(stamp, _)| *stamp == first);
        let moves = self.samples.iter().any(|(_, log)| (log - logged).abs() >= MOVED_NS);
        if stands && (moves || first == 0) {
            return None;
        }
        let mut all: Vec<i128> = self.samples.iter().map(|(stamp, log)| log - stamp).collect();
        all.sort_unstable();
        all.get(all.len() / 2).copied()
    }
}

/// Stamps of all topics.
#[derive(Debug, Default)]
pub(super) struct Clocks {
    topics: BTreeMap<String, Topic>,
}

impl Clocks {
    /// Learns from a message; the first ones of a topic tell.
    pub(super) fn learn(&mut self, topic: &str, stamp: i128, log: i128, is_of_transforms: bool) {
        if !self.topics.contains_key(topic) {
            if self.topics.len() >= MAX_TOPICS {
                return;
            }
            self.topics.insert(topic.to_owned(), Topic::default());
        }
        let Some(known) = self.topics.get_mut(topic) else { return };
        known.is_of_transforms = is_of_transforms;
        if known.samples.len() < SAMPLES {
            known.samples.push((stamp, log));
        }
    }

    /// How much later messages are logged than the recording's clock says: of transforms, else of the first topic that knows.
    fn reference(&self) -> i128 {
        let of = |is_wanted: fn(&Topic) -> bool| {
            self.topics.values().filter(|topic| is_wanted(topic)).find_map(Topic::offset)
        };
        of(|topic| topic.is_of_transforms).or_else(|| of(|_| true)).unwrap_or(0)
    }

    /// A log time by the recording's clock.
    pub(super) fn logged(&self, log: i128) -> i128 {
        log - self.reference()
    }

    /// When a message was made; its stamp may be missing.
    pub(super) fn time(
        &mut self,
        topic: &str,
        stamp: Option<i128>,
        log: i128,
        notes: &mut Notes,
    ) -> i128 {
        let logged = self.logged(log);
        let reference = log - logged;
        let Some(stamp) = stamp else { return logged };
        let Some(known) = self.topics.get_mut(topic) else { return stamp };
        let Some(offset) = known.offset() else {
            notes.add(Note::NoStamps(shortened(topic.to_owned())));
            return logged;
        };
        if (offset - reference).abs() > OTHER_NS {
            notes.add(Note::OtherClock(shortened(topic.to_owned())));
            return logged;
        }
        let behind = known.behind.unwrap_or(offset);
        if (log - stamp - behind).abs() > WILD_NS {
            notes.add(Note::NoStamps(shortened(topic.to_owned())));
            return log - behind;
        }
        known.behind = Some(log - stamp);
        stamp
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i128 = 1_000_000_000;
    const EPOCH: i128 = 1_700_000_000 * SECOND;

    /// Times of messages of several topics, all of which are known from the beginning, and the notes.
    fn times(messages: &[(&str, i128, i128)]) -> (Vec<i128>, Vec<Note>) {
        let (mut clocks, mut notes) = (Clocks::default(), Notes::default());
        for (topic, stamp, log) in messages {
            clocks.learn(topic, *stamp, *log, *topic == "/tf");
        }
        let times = messages
            .iter()
            .map(|(topic, stamp, log)| clocks.time(topic, Some(*stamp), *log, &mut notes));
        let times = times.collect();
        (times, notes.iter().map(|(note, _)| note.clone()).collect())
    }

    #[test]
    fn stamps_are_believed_where_they_move() {
        let stamps = [0, 1, 2, 3].map(|step| EPOCH + step * SECOND / 10);
        let messages = stamps.map(|stamp| ("/a", stamp, stamp + 40_000_000));
        assert_eq!(times(&messages), (stamps.to_vec(), vec![]));
        // Simulated time begins at 0.
        let messages = [0, 1, 2].map(|step| ("/a", step * SECOND, EPOCH + step * SECOND));
        assert_eq!(times(&messages), (vec![0, SECOND, 2 * SECOND], vec![]));
        // One twice is no clock that stands still.
        let messages = [("/a", 5, 5 * SECOND), ("/a", 5, 6 * SECOND), ("/a", SECOND, 7 * SECOND)];
        assert_eq!(times(&messages).0, [5, 5, SECOND]);
    }

    #[test]
    fn stamps_that_stand_still_are_replaced_by_log_times() {
        for frozen in [0, EPOCH - 77 * SECOND] {
            let messages = [0, 1, 2].map(|step| ("/a", frozen, EPOCH + step * SECOND));
            let (times, notes) = times(&messages);
            assert_eq!(times, [EPOCH, EPOCH + SECOND, EPOCH + 2 * SECOND]);
            assert_eq!(notes, [Note::NoStamps("/a".into())]);
        }
        assert_eq!(times(&[("/a", 0, EPOCH)]).0, [EPOCH]);
    }

    #[test]
    fn other_clocks_are_brought_to_that_of_transforms() {
        let messages = [
            ("/tf", EPOCH, EPOCH + SECOND / 10),
            ("/tf", EPOCH + SECOND, EPOCH + SECOND * 11 / 10),
            ("/boot", 70 * SECOND, EPOCH + SECOND / 5),
            ("/boot", 71 * SECOND, EPOCH + SECOND * 6 / 5),
            ("/zero", 0, EPOCH + SECOND),
        ];
        let (times, notes) = times(&messages);
        assert_eq!(
            times[2..],
            [EPOCH + SECOND / 10, EPOCH + SECOND * 11 / 10, EPOCH + SECOND * 9 / 10]
        );
        assert_eq!(notes, [Note::OtherClock("/boot".into()), Note::NoStamps("/zero".into())]);
    }

    #[test]
    fn one_wild_stamp_costs_nothing() {
        let mut messages =
            [0, 1, 2, 3, 4].map(|step| ("/a", EPOCH + step * SECOND, EPOCH + step * SECOND));
        messages[0].1 = 0;
        messages[3].1 = 9 * EPOCH;
        let (times, notes) = times(&messages);
        assert_eq!(times, [0, 1, 2, 3, 4].map(|step| EPOCH + step * SECOND));
        assert_eq!(notes, [Note::NoStamps("/a".into())]);
    }
}
