//! Samples that came while another host's worker serves, and may not be in a state of it that is here.

use std::collections::VecDeque;

use joulebus_wire::{Sample, SampleHeader};

/// For how long frames are kept: a state is a second old when it comes, and samples may reach that worker later than this
/// one.
pub(crate) const KEEP_NS: u64 = 10_000_000_000;
/// Samples a robot at most: those of that time, and of the pause between two looks at the state, at 30 Hz.
const SAMPLES_PER_ROBOT: usize = 360;

/// A frame, and when it came.
#[derive(Debug)]
pub(crate) struct Held {
    pub(crate) header: SampleHeader,
    pub(crate) samples: Vec<Sample>,
    pub(crate) taken_ns: u64,
}

/// The frames of the last seconds, in the order in which they came.
#[derive(Debug)]
pub(crate) struct Backlog {
    frames: VecDeque<Held>,
    samples: usize,
    most_samples: usize,
}

impl Backlog {
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            frames: VecDeque::new(),
            samples: 0,
            most_samples: capacity.saturating_mul(SAMPLES_PER_ROBOT),
        }
    }

    pub(crate) fn keep(&mut self, held: Held) {
        self.samples += held.samples.len();
        self.frames.push_back(held);
    }

    pub(crate) fn is_full(&self) -> bool {
        self.samples > self.most_samples
    }

    /// The oldest frame, if it is too old at `now_ns` or there are too many.
    pub(crate) fn pop_due(&mut self, now_ns: u64) -> Option<Held> {
        let oldest = self.frames.front()?;
        let age_ns = now_ns.saturating_sub(oldest.taken_ns);
        if age_ns > KEEP_NS || self.is_full() {
            self.pop()
        } else {
            None
        }
    }

    /// The oldest frame.
    pub(crate) fn pop(&mut self) -> Option<Held> {
        let oldest = self.frames.pop_front()?;
        self.samples -= oldest.samples.len();
        Some(oldest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_older_than_the_time_and_those_beyond_the_room_are_due_the_oldest_first() {
        let mut backlog = Backlog::new(2);
        let frame = |seq, count: usize, taken_ns| Held {
            header: SampleHeader {
                frame_seq: seq,
                ..SampleHeader::default()
            },
            samples: vec![Sample::new(1, 1, 1); count],
            taken_ns,
        };
        let due = |backlog: &mut Backlog, now_ns| -> Vec<u64> {
            let due = std::iter::from_fn(|| backlog.pop_due(now_ns));
            due.map(|it| it.header.frame_seq).collect()
        };
        for (seq, taken_ns) in [(1, 1_000), (2, 2_000), (3, 1_000 + KEEP_NS)] {
            backlog.keep(frame(seq, 10, taken_ns));
        }
        assert_eq!(due(&mut backlog, 1_000 + KEEP_NS), [0; 0]);
        assert_eq!(due(&mut backlog, 1_001 + KEEP_NS), [1]);
        assert!(!backlog.is_full());
        backlog.keep(frame(4, 701, 1_002 + KEEP_NS));
        assert!(backlog.is_full());
        assert_eq!(due(&mut backlog, 1_002 + KEEP_NS), [2]);
        assert_eq!((backlog.samples, backlog.is_full()), (711, false));
        // One frame alone that is larger than the room.
        backlog.keep(frame(5, 721, 1_003 + KEEP_NS));
        assert_eq!(due(&mut backlog, 1_003 + KEEP_NS), [3, 4, 5]);
        assert_eq!(backlog.samples, 0);
        assert!(backlog.pop().is_none());
    }
}
