//! Samples that came while another host's worker serves: what that worker's last state does not contain is taken from
//! here.

use std::collections::VecDeque;

use joulebus_fleet::Fleet;
use joulebus_wire::{Sample, SampleHeader};

/// For how long frames are kept: a state is a second old, and a lease lasts for a few.
const KEEP_NS: u64 = 10_000_000_000;
/// Samples a robot at most: those of that time at 30 Hz.
const SAMPLES_PER_ROBOT: usize = 300;

/// A frame, and when it came.
#[derive(Debug)]
struct Held {
    header: SampleHeader,
    samples: Vec<Sample>,
    taken_ns: u64,
}

/// The frames of the last seconds, in the order in which they came.
#[derive(Debug)]
pub(crate) struct Backlog {
    frames: VecDeque<Held>,
    samples: usize,
    most_samples: usize,
}

/// What was taken from a backlog.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Replayed {
    pub(crate) frames: u64,
    pub(crate) samples: u64,
}

impl Backlog {
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            frames: VecDeque::new(),
            samples: 0,
            most_samples: capacity.saturating_mul(SAMPLES_PER_ROBOT),
        }
    }

    /// Keeps a frame, and forgets those that are too old or too many.
    pub(crate) fn keep(&mut self, header: SampleHeader, samples: Vec<Sample>, taken_ns: u64) {
        self.samples += samples.len();
        self.frames.push_back(Held {
            header,
            samples,
            taken_ns,
        });
        while let Some(oldest) = self.frames.front() {
            let age_ns = taken_ns.saturating_sub(oldest.taken_ns);
            if age_ns <= KEEP_NS && self.samples <= self.most_samples {
                break;
            }
            self.samples -= oldest.samples.len();
            self.frames.pop_front();
        }
    }

    /// Has the fleet take the frames that it does not contain, as if it had been there, without output.
    pub(crate) fn replay(self, fleet: &mut Fleet, period_ns: u64) -> Replayed {
        let mut replayed = Replayed::default();
        let mut tick_ns = None;
        for held in self.frames {
            if fleet.has_accounted(&held.header) {
                continue;
            }
            let next_ns = *tick_ns.get_or_insert(held.taken_ns.saturating_add(period_ns));
            if held.taken_ns >= next_ns {
                fleet.tick(held.taken_ns, false);
                tick_ns = Some(held.taken_ns.saturating_add(period_ns));
            }
            fleet.take(&held.header, &held.samples, held.taken_ns);
            replayed.frames += 1;
            replayed.samples += held.samples.len() as u64;
        }
        replayed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_older_than_the_time_and_samples_beyond_the_room_are_forgotten_the_oldest_first() {
        let mut backlog = Backlog::new(2);
        let frame = |seq| SampleHeader {
            frame_seq: seq,
            ..SampleHeader::default()
        };
        let samples = |count: usize| vec![Sample::new(1, 1, 1); count];
        let held = |backlog: &Backlog| -> Vec<u64> {
            backlog
                .frames
                .iter()
                .map(|it| it.header.frame_seq)
                .collect()
        };
        backlog.keep(frame(1), samples(10), 1_000);
        backlog.keep(frame(2), samples(10), 2_000);
        backlog.keep(frame(3), samples(10), 1_000 + KEEP_NS);
        assert_eq!(held(&backlog), [1, 2, 3]);
        backlog.keep(frame(4), samples(10), 1_001 + KEEP_NS);
        assert_eq!(held(&backlog), [2, 3, 4]);
        backlog.keep(frame(5), samples(570), 1_002 + KEEP_NS);
        assert_eq!((held(&backlog), backlog.samples), (vec![2, 3, 4, 5], 600));
        backlog.keep(frame(6), samples(1), 1_003 + KEEP_NS);
        assert_eq!((held(&backlog), backlog.samples), (vec![3, 4, 5, 6], 591));
        // One frame alone that is larger than the room.
        backlog.keep(frame(7), samples(601), 1_004 + KEEP_NS);
        assert_eq!((held(&backlog), backlog.samples), (vec![], 0));
    }
}
