//! Samples that arrived while another host's worker leads, and may be missing in its newest state
//! on this host.

use std::collections::VecDeque;

use joulebus_settings::FleetSettings;
use joulebus_wire::{Sample, SampleHeader};

/// For how long frames are kept: a state is a second old when it comes, and samples may reach that
/// worker later than this one.
pub(crate) const KEEP_NS: u64 = 10_000_000_000;
/// For how long there is room: that time, and the pause between two looks at the state.
const ROOM_NS: u64 = KEEP_NS + 2_000_000_000;
/// Longest sample period for which there is room. Sources of slow robots may send more often.
const MAX_PERIOD_NS: u64 = 33_333_333;

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
    max_samples: usize,
}

/// The room that a frame takes. A frame without samples takes some, too.
fn size(held: &Held) -> usize {
    held.samples.len().max(1)
}

impl Backlog {
    /// For as many robots as `settings` allow, all at the rate of the fastest platform.
    pub(crate) fn new(settings: &FleetSettings) -> Self {
        let periods_ns = settings.platforms.iter().map(|platform| platform.period_ns);
        let fastest_ns = periods_ns.fold(MAX_PERIOD_NS, u64::min).max(1);
        let samples = usize::try_from(ROOM_NS / fastest_ns).unwrap_or(usize::MAX);
        Self {
            frames: VecDeque::new(),
            samples: 0,
            max_samples: samples.saturating_mul(settings.capacity as usize),
        }
    }

    pub(crate) fn keep(&mut self, held: Held) {
        self.samples += size(&held);
        self.frames.push_back(held);
    }

    pub(crate) fn is_full(&self) -> bool {
        self.samples > self.max_samples
    }

    /// The oldest frame, if it is too old at `now_ns` or there are too many.
    pub(crate) fn pop_due(&mut self, now_ns: u64) -> Option<Held> {
        let oldest = self.frames.front()?;
        let age_ns = now_ns.saturating_sub(oldest.taken_ns);
        if age_ns > KEEP_NS || self.is_full() { self.pop() } else { None }
    }

    pub(crate) fn pop(&mut self) -> Option<Held> {
        let oldest = self.frames.pop_front()?;
        self.samples -= size(&oldest);
        Some(oldest)
    }
}

#[cfg(test)]
mod tests {
    use joulebus_config::Config;

    use super::*;

    fn settings(capacity: u32) -> FleetSettings {
        let text = format!(
            "[fleet]\nname = \"lab\"\ncapacity = {capacity}\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0\"]\n"
        );
        let config = Config::parse(&text, "nowhere".as_ref()).unwrap();
        config.settings().clone()
    }

    #[test]
    fn there_is_room_for_all_samples_of_the_time_at_the_rate_of_the_fastest_robots() {
        for (period_ns, samples) in
            [(1_000_000, 12_000), (10_000_000, 1_200), (33_333_333, 360), (1_000_000_000, 360)]
        {
            let mut settings = settings(5);
            settings.platforms[0].period_ns = period_ns;
            assert_eq!(Backlog::new(&settings).max_samples, 5 * samples);
        }
    }

    #[test]
    fn a_flood_of_frames_without_samples_takes_no_more_room_than_samples() {
        let mut backlog = Backlog::new(&settings(1));
        for _ in 0..10_000 {
            backlog.keep(Held {
                header: SampleHeader::default(),
                samples: Vec::new(),
                taken_ns: 1_000,
            });
            while backlog.pop_due(1_000).is_some() {}
        }
        assert_eq!(backlog.frames.len(), 360);
        while backlog.pop().is_some() {}
        assert_eq!(backlog.samples, 0);
    }

    #[test]
    fn frames_older_than_the_time_and_those_beyond_the_room_are_due_the_oldest_first() {
        let mut backlog = Backlog::new(&settings(2));
        let frame = |seq, count: usize, taken_ns| Held {
            header: SampleHeader { frame_seq: seq, ..SampleHeader::default() },
            samples: vec![Sample::new(1, 1, 1); count],
            taken_ns,
        };
        let due = |backlog: &mut Backlog, now_ns| -> Vec<u64> {
            let due = std::iter::from_fn(|| backlog.pop_due(now_ns));
            due.map(|held| held.header.frame_seq).collect()
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
