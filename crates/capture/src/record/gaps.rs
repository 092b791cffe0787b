//! Counts what was overwritten in shared memory before it was taken, by the numbers in the headers.
//! Pure.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use joulebus_wire::{TickHeader, tick_flag};

use crate::{Message, MessageKind};

/// Sources and runs that account is kept of. The rest is recorded, but its gaps are not counted.
const MOST_RUNS: usize = 4_096;

/// Counts gaps.
#[derive(Debug, Default)]
pub(crate) struct Gaps {
    /// When the recording began, Unix ns: runs that began later are known from their first frame.
    began_unix_ns: u64,
    runs: HashMap<(Arc<str>, MessageKind, u64), Run>,
}

/// Where a numbered stream stands.
#[derive(Debug, Default)]
struct Run {
    epoch: u64,
    next: u64,
    /// Numbers from `next` on that nobody has sent.
    unsent: VecDeque<u64>,
}

/// What a message says about others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Found {
    /// Messages that are missing between the one before of its kind and this one.
    pub(crate) missing: u64,
    /// Diagnostics that were told as missing before, but were never sent.
    pub(crate) never_sent: u64,
}

impl Gaps {
    pub(crate) fn new(began_unix_ns: u64) -> Self {
        Self {
            began_unix_ns,
            runs: HashMap::new(),
        }
    }

    /// What the message says about those before it of its fleet.
    pub(crate) fn look(&mut self, fleet: &Arc<str>, message: &Message) -> Found {
        let never_sent = match message {
            Message::Ticks(header, _) => self.left_out(fleet, header),
            _ => 0,
        };
        Found {
            missing: self.missing_before(fleet, message),
            never_sent,
        }
    }

    /// A worker whose ticks take too long leaves diagnostics out, and says so in its journal, which
    /// may come before or after the next diagnostics. Returns how many were taken for missing.
    fn left_out(&mut self, fleet: &Arc<str>, header: &TickHeader) -> u64 {
        if header.flags & tick_flag::NO_DIAGNOSTICS == 0 {
            return 0;
        }
        let key = (Arc::clone(fleet), MessageKind::Diagnostics, 0);
        let (tick, known) = (header.tick, self.runs.get_mut(&key));
        match known.filter(|run| run.epoch == header.worker_epoch) {
            Some(run) if tick < run.next => 1,
            Some(run) if run.unsent.len() < MOST_RUNS => {
                run.unsent.push_back(tick);
                0
            }
            _ => 0,
        }
    }

    fn missing_before(&mut self, fleet: &Arc<str>, message: &Message) -> u64 {
        let (kind, source, epoch, number, first) = match message {
            Message::Samples(header, _) => {
                let (source, epoch) = (header.source_id, header.source_epoch);
                (MessageKind::Samples, source, epoch, header.frame_seq, 0)
            }
            Message::Forecasts(header, _) => (
                MessageKind::Forecasts,
                0,
                header.worker_epoch,
                header.tick,
                1,
            ),
            Message::Diagnostics(header, _) => (
                MessageKind::Diagnostics,
                0,
                header.worker_epoch,
                header.tick,
                1,
            ),
            Message::Budgets(header, _) => {
                (MessageKind::Budgets, 0, header.worker_epoch, header.tick, 1)
            }
            Message::Ticks(header, _) => {
                (MessageKind::Ticks, 0, header.worker_epoch, header.tick, 1)
            }
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
                unsent: VecDeque::new(),
            };
        }
        let mut missing = number.saturating_sub(run.next);
        while run.unsent.front().is_some_and(|unsent| *unsent < number) {
            run.unsent.pop_front();
            missing = missing.saturating_sub(1);
        }
        run.next = run.next.max(number.saturating_add(1));
        missing
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{DiagnosticHeader, ForecastHeader, SampleHeader};

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
                .map(|message| gaps.look(&fleet, message).missing)
                .sum();
            assert_eq!(found, missing, "{messages:?}");
            // Another fleet is another matter, whatever its numbers.
            let other = Arc::from("yard");
            assert_eq!(gaps.look(&other, &frame(1, 5, 999)), Found::default());
        }
    }

    fn diagnostics(tick: u64) -> Message {
        let header = DiagnosticHeader {
            worker_epoch: 5,
            tick,
            ..DiagnosticHeader::default()
        };
        Message::Diagnostics(header, Vec::new())
    }

    fn without_diagnostics(tick: u64) -> Message {
        let header = TickHeader {
            worker_epoch: 5,
            tick,
            flags: tick_flag::NO_DIAGNOSTICS,
            ..TickHeader::default()
        };
        Message::Ticks(header, Vec::new())
    }

    #[test]
    fn diagnostics_that_the_worker_left_out_are_not_lost_whenever_it_says_so() {
        let left_out = without_diagnostics;
        for (messages, lost) in [
            (vec![diagnostics(1), diagnostics(4)], 2),
            (
                vec![diagnostics(1), left_out(2), left_out(3), diagnostics(4)],
                0,
            ),
            (
                vec![diagnostics(1), left_out(2), diagnostics(4), left_out(3)],
                0,
            ),
            (vec![diagnostics(1), left_out(3), diagnostics(4)], 1),
            (
                vec![diagnostics(1), left_out(2), diagnostics(3), diagnostics(5)],
                1,
            ),
        ] {
            let (fleet, mut gaps) = (Arc::from("lab"), Gaps::new(100));
            let mut sum = 0_i64;
            for message in &messages {
                let found = gaps.look(&fleet, message);
                let of_diagnostics = matches!(message, Message::Diagnostics(..));
                sum += if of_diagnostics {
                    found.missing as i64
                } else {
                    0
                };
                sum -= found.never_sent as i64;
            }
            assert_eq!(sum, lost, "{messages:?}");
        }
    }
}
