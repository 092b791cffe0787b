//! Counts what was overwritten in shared memory before it was taken, by the numbers in the headers.
//! Pure.

use std::collections::HashMap;
use std::sync::Arc;

use crate::{Kind, Message};

/// Sources and runs that account is kept of. The rest is recorded, but its gaps are not counted.
const MOST_RUNS: usize = 4_096;

/// Counts gaps.
#[derive(Debug, Default)]
pub(crate) struct Gaps {
    /// When the recording began, Unix ns: runs that began later are known from their first frame.
    began_unix_ns: u64,
    runs: HashMap<(Arc<str>, Kind, u64), Run>,
}

/// Where a numbered stream stands.
#[derive(Debug, Default)]
struct Run {
    epoch: u64,
    next: u64,
}

impl Gaps {
    pub(crate) fn new(began_unix_ns: u64) -> Self {
        Self {
            began_unix_ns,
            runs: HashMap::new(),
        }
    }

    /// Messages that are missing between the one before of its fleet and this one.
    pub(crate) fn missing_before(&mut self, fleet: &Arc<str>, message: &Message) -> u64 {
        let (kind, source, epoch, number, first) = match message {
            Message::Samples(header, _) => {
                let (source, epoch) = (header.source_id, header.source_epoch);
                (Kind::Samples, source, epoch, header.frame_seq, 0)
            }
            Message::Forecasts(header, _) => {
                (Kind::Forecasts, 0, header.worker_epoch, header.tick, 1)
            }
            Message::Diagnostics(header, _) => {
                (Kind::Diagnostics, 0, header.worker_epoch, header.tick, 1)
            }
            Message::Budgets(header, _) => (Kind::Budgets, 0, header.worker_epoch, header.tick, 1),
            Message::Ticks(header, _) => (Kind::Ticks, 0, header.worker_epoch, header.tick, 1),
            // Pieces of a keyframe say themselves whether they are whole.
            _ => return 0,
        };
        let key = (Arc::clone(fleet), kind, source);
        if self.runs.len() >= MOST_RUNS && !self.runs.contains_key(&key) {
            return 0;
        }
        let run = self.runs.entry(key).or_default();
        if epoch < run.epoch {
            // A run that has been replaced still says something.
            return 0;
        }
        if epoch > run.epoch {
            let heard_from_the_start = epoch > self.began_unix_ns;
            *run = Run {
                epoch,
                next: if heard_from_the_start { first } else { number },
            };
        }
        let missing = number.saturating_sub(run.next);
        run.next = run.next.max(number.saturating_add(1));
        missing
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{ForecastHeader, SampleHeader};

    use super::*;

    fn frame(source_id: u64, source_epoch: u64, frame_seq: u64) -> Message {
        let header = SampleHeader {
            source_id,
            source_epoch,
            frame_seq,
            ..SampleHeader::default()
        };
        Message::Samples(header, Vec::new())
    }

    fn tick(worker_epoch: u64, tick: u64) -> Message {
        let header = ForecastHeader {
            worker_epoch,
            tick,
            ..ForecastHeader::default()
        };
        Message::Forecasts(header, Vec::new())
    }

    #[test]
    fn what_lies_between_two_frames_is_counted_once_per_source_and_run() {
        for (messages, missing) in [
            // What was sent before the recording is not missing.
            (vec![frame(1, 5, 40), frame(1, 5, 41)], 0),
            (vec![frame(1, 5, 40), frame(1, 5, 44)], 3),
            // Sources do not see each other.
            (vec![frame(1, 5, 1), frame(2, 5, 9), frame(1, 5, 2)], 0),
            // A run that began after the recording did is known from its first frame.
            (vec![frame(1, 101, 2)], 2),
            (vec![frame(1, 5, 7), frame(1, 101, 0), frame(1, 101, 1)], 0),
            (vec![frame(1, 5, 7), frame(1, 101, 3)], 3),
            // Late words of a run that was replaced, and the same frame twice.
            (vec![frame(1, 101, 0), frame(1, 5, 9), frame(1, 101, 1)], 0),
            (vec![frame(1, 5, 7), frame(1, 5, 7), frame(1, 5, 8)], 0),
            // Ticks are numbered from 1.
            (vec![tick(101, 1), tick(101, 2)], 0),
            (vec![tick(101, 2), tick(101, 5)], 3),
            (vec![tick(5, 90), tick(101, 1)], 0),
        ] {
            let fleet = Arc::from("lab");
            let mut gaps = Gaps::new(100);
            let found: u64 = messages
                .iter()
                .map(|message| gaps.missing_before(&fleet, message))
                .sum();
            assert_eq!(found, missing, "{messages:?}");
            // Another fleet is another matter, whatever its numbers.
            let other = Arc::from("yard");
            assert_eq!(gaps.missing_before(&other, &frame(1, 5, 999)), 0);
        }
    }
}
