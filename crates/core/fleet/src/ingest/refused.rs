//! Lists of recent refusals, for operators and sources.

use joulebus_wire::{DropReason, Refusal, Sample, SampleHeader};
use serde::{Deserialize, Serialize};

use crate::ingest::codes::refusals;

/// The newest distinct refusals (robot, reason, source), in a fixed number of entries.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Refused {
    #[serde(with = "refusals")]
    places: [Refusal; 16],
    next: u8,
}

impl Refused {
    pub(crate) fn note(&mut self, robot: u32, reason: DropReason, pid: u32) {
        let code = reason as u32 + 1;
        let known = self
            .places
            .iter_mut()
            .find(|place| place.reason == code && place.robot == robot && place.pid == pid);
        if let Some(place) = known {
            place.count = place.count.saturating_add(1);
            return;
        }
        self.places[usize::from(self.next) % self.places.len()] =
            Refusal { robot, reason: code, pid, count: 1 };
        self.next = (self.next + 1) % self.places.len() as u8;
    }

    pub(crate) fn places(&self) -> [Refusal; 16] {
        self.places
    }
}

/// Entries of each list of a [`RefusalLog`].
const MAX_KEPT: usize = 32;

/// Refused samples of one run of a source for one reason, or of one robot.
#[derive(Debug, Clone, Copy)]
pub struct RefusedSamples {
    /// [`SampleHeader::source_id`] of the newest one.
    pub source_id: u64,
    /// Its [`SampleHeader::source_epoch`].
    pub source_epoch: u64,
    /// Its reason.
    pub reason: DropReason,
    /// Samples since the entry began.
    pub count: u64,
    /// The newest one.
    pub sample: Sample,
    /// When it came, monotonic ns.
    pub at_ns: u64,
}

/// The newest refusals, in a fixed number of entries: by run of a source and reason, and by robot
/// for values. It is no part of the [state](crate::FleetState), and no tick depends on it.
#[derive(Debug)]
pub struct RefusalLog {
    sources: Vec<RefusedSamples>,
    robots: Vec<RefusedSamples>,
    changes: u64,
}

impl Default for RefusalLog {
    /// An empty log with all its memory.
    fn default() -> Self {
        let room = || Vec::with_capacity(MAX_KEPT);
        Self { sources: room(), robots: room(), changes: 0 }
    }
}

impl RefusalLog {
    /// Makes this a copy of `newest`, if that has changed. Allocates nothing.
    pub fn follow(&mut self, newest: &Self) {
        if self.changes != newest.changes {
            self.sources.clone_from(&newest.sources);
            self.robots.clone_from(&newest.robots);
            self.changes = newest.changes;
        }
    }

    /// By run of a source, and reason.
    #[must_use]
    pub fn sources(&self) -> &[RefusedSamples] {
        &self.sources
    }

    /// By robot, refused for their values.
    #[must_use]
    pub fn robots(&self) -> &[RefusedSamples] {
        &self.robots
    }

    pub(crate) fn note(
        &mut self,
        header: &SampleHeader,
        sample: &Sample,
        (reason, is_value): (DropReason, bool),
        at_ns: u64,
    ) {
        self.changes += 1;
        let new = RefusedSamples {
            source_id: header.source_id,
            source_epoch: header.source_epoch,
            reason,
            count: 1,
            sample: *sample,
            at_ns,
        };
        let key = |one: &RefusedSamples| (one.source_id, one.source_epoch, one.reason as u32);
        keep(&mut self.sources, new, |known| key(known) == key(&new));
        if is_value {
            keep(&mut self.robots, new, |known| known.sample.robot == sample.robot);
        }
    }
}

/// Adds to the entry that is meant, or takes a new one, at worst that of the oldest.
fn keep(
    kept: &mut Vec<RefusedSamples>,
    new: RefusedSamples,
    is_same: impl Fn(&RefusedSamples) -> bool,
) {
    if let Some(known) = kept.iter_mut().find(|known| is_same(known)) {
        *known = RefusedSamples { count: known.count.saturating_add(1), ..new };
    } else if kept.len() < MAX_KEPT {
        kept.push(new);
    } else if let Some(oldest) = kept.iter_mut().min_by_key(|known| known.at_ns) {
        *oldest = new;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_are_kept_and_repeats_are_counted() {
        let mut refused = Refused::default();
        for robot in 0..20 {
            for _ in 0..3 {
                refused.note(robot, DropReason::OverCapacity, 9);
            }
        }
        let mut robots: Vec<u32> = refused.places().iter().map(|place| place.robot).collect();
        robots.sort_unstable();
        assert_eq!(robots, (4..20).collect::<Vec<u32>>());
        assert!(refused.places().iter().all(|place| place.count == 3 && place.pid == 9));
    }

    #[test]
    fn a_log_counts_by_source_and_reason_and_keeps_the_newest_robots() {
        let mut log = RefusalLog::default();
        let header = SampleHeader { source_id: 7, source_epoch: 1, ..SampleHeader::default() };
        for at_ns in 0..300 {
            let sample = Sample::new(at_ns as u32 % 100, 0, 0).reading(-5.0, 0);
            log.note(&header, &sample, (DropReason::ForeignSource, false), at_ns);
            log.note(&header, &sample, (DropReason::PowerOutOfRange, true), at_ns);
        }
        let counts: Vec<_> = log.sources().iter().map(|one| (one.reason, one.count)).collect();
        assert_eq!(counts, [(DropReason::ForeignSource, 300), (DropReason::PowerOutOfRange, 300)]);
        let mut robots: Vec<u32> = log.robots().iter().map(|one| one.sample.robot).collect();
        robots.sort_unstable();
        assert_eq!(robots, (68..100).collect::<Vec<u32>>());
        let mut copy = RefusalLog::default();
        copy.follow(&log);
        // Not the samples, whose unknown values are NaN.
        let keys = |list: &[RefusedSamples]| -> Vec<(u32, u64, u64)> {
            list.iter().map(|one| (one.sample.robot, one.count, one.at_ns)).collect()
        };
        assert_eq!(keys(copy.sources()), keys(log.sources()));
        assert_eq!(keys(copy.robots()), keys(log.robots()));
    }
}
