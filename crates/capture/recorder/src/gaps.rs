//! Counts the messages overwritten in shared memory before they were received, by the numbers in
//! the headers. Pure.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use joulebus_wire::{
    Diagnostics, Flow, FrameOrder, FrameRows, Samples, TickHeader, Ticks, tick_flag,
};

use joulebus_capture_format::{Message, MessageKind};

/// Maximum number of tracked runs of sources and workers. Beyond it those silent longest are
/// dropped.
const MAX_RUNS: usize = 4_096;
/// Maximum number of ticks without diagnostics stored per run.
const MAX_UNSENT: usize = 4_096;

#[derive(Debug, Default)]
pub(crate) struct Gaps {
    /// Runs that began later are tracked from their first frame, monotonic ns. Start of the
    /// recording, or of the newest dropped run if that is later.
    known_since_ns: u64,
    runs: HashMap<Key, Run>,
    /// Number of messages processed.
    looked: u64,
}

/// Fleet, kind, source (0 of a worker) and run.
type Key = (Arc<str>, MessageKind, u64, u64);

/// State of a numbered stream.
#[derive(Debug, Default)]
struct Run {
    next: u64,
    last: u64,
    /// Numbers from `next` on that were not sent.
    unsent: VecDeque<u64>,
    /// Message count at its last frame.
    looked: u64,
    /// True if the next gap proves nothing: what is sent only while somebody reads it may begin
    /// with a frame of a reader before, and the second frame is of a later tick.
    unknown_gap: bool,
}

/// Loss as shown by a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Found {
    /// Messages missing between the previous one of its kind and this one.
    pub(crate) missing: u64,
    /// Diagnostics counted as missing before that were never sent.
    pub(crate) never_sent: u64,
}

impl Gaps {
    pub(crate) fn new(began_ns: u64) -> Self {
        Self { known_since_ns: began_ns, ..Self::default() }
    }

    /// Determines the loss before a message of a fleet.
    pub(crate) fn look(&mut self, fleet: &Arc<str>, message: &Message) -> Found {
        self.looked += 1;
        let journal = message.frame::<Ticks>();
        let never_sent = journal.map_or(0, |journal| self.left_out(fleet, &journal.header));
        Found { missing: self.missing_before(fleet, message), never_sent }
    }

    /// A worker whose ticks take too long omits diagnostics, and reports so in its journal, which
    /// may arrive before or after the next diagnostics. Returns how many were counted as missing.
    fn left_out(&mut self, fleet: &Arc<str>, header: &TickHeader) -> u64 {
        if header.flags & tick_flag::NO_DIAGNOSTICS == 0 {
            return 0;
        }
        let epoch = header.worker_epoch;
        let key = (Arc::clone(fleet), MessageKind::of::<Diagnostics>(), 0, epoch);
        let Some(run) = self.runs.get_mut(&key) else {
            return 0;
        };
        if header.tick < run.next {
            return 1;
        }
        if run.unsent.len() == MAX_UNSENT {
            run.unsent.pop_front();
        }
        run.unsent.push_back(header.tick);
        0
    }

    fn missing_before(&mut self, fleet: &Arc<str>, message: &Message) -> u64 {
        let (Some(kind), Some(order)) = (message.kind(), message.order()) else {
            return 0;
        };
        // Pieces of a keyframe state their completeness themselves.
        if kind.rows() == FrameRows::Bytes {
            return 0;
        }
        let FrameOrder { run: epoch, number } = order;
        let samples = message.frame::<Samples>();
        let source = samples.map_or(0, |samples| samples.header.source_id);
        // Sources count from 0, and ticks are numbered from 1.
        let first = u64::from(kind.flow() != Flow::Sources);
        let key = (Arc::clone(fleet), kind, source, epoch);
        if !self.runs.contains_key(&key) {
            self.forget_silent();
            let is_on_demand = kind.flow().is_on_demand();
            let read_from_the_start = epoch > self.known_since_ns && !is_on_demand;
            let next = if read_from_the_start { first } else { number };
            let run = Run { next, last: next, unknown_gap: is_on_demand, ..Run::default() };
            self.runs.insert(key.clone(), run);
        }
        let Some(run) = self.runs.get_mut(&key) else {
            return 0;
        };
        run.looked = self.looked;
        let is_later = number > run.last;
        let missing = run.missing_before(number);
        if run.unknown_gap && is_later {
            run.unknown_gap = false;
            return 0;
        }
        missing
    }

    /// Frees space for other runs: drops the half that was silent longest.
    fn forget_silent(&mut self) {
        if self.runs.len() < MAX_RUNS {
            return;
        }
        let mut looked: Vec<u64> = self.runs.values().map(|run| run.looked).collect();
        let (_, median, _) = looked.select_nth_unstable(MAX_RUNS / 2);
        self.runs.retain(|(_, _, _, epoch), run| {
            let stays = run.looked > *median;
            if !stays {
                // If it sends again, its earlier messages do not count as missing.
                self.known_since_ns = self.known_since_ns.max(*epoch);
            }
            stays
        });
    }
}

impl Run {
    fn missing_before(&mut self, number: u64) -> u64 {
        // A sender numbers its frames in order: two in a row below what is expected mean that a
        // number in between was false.
        let corrected = number < self.next && self.last.checked_add(1) == Some(number);
        if corrected {
            self.next = number;
        }
        self.last = number;
        let mut missing = number.saturating_sub(self.next);
        while self.unsent.front().is_some_and(|unsent| *unsent < number) {
            self.unsent.pop_front();
            missing = missing.saturating_sub(1);
        }
        self.next = self.next.max(number.saturating_add(1));
        missing
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{
        Channel, DiagnosticHeader, ForecastHeader, Forecasts, FrameHeader as _, Outlooks,
        PlanStates, SampleHeader,
    };

    use super::*;

    fn frame(source_id: u64, source_epoch: u64, frame_seq: u64) -> Message {
        let header = SampleHeader { source_id, source_epoch, frame_seq, ..SampleHeader::default() };
        Message::of::<Samples>(header, Vec::new())
    }

    fn tick(worker_epoch: u64, tick: u64) -> Message {
        let header = ForecastHeader { worker_epoch, tick, ..ForecastHeader::default() };
        Message::of::<Forecasts>(header, Vec::new())
    }

    #[test]
    fn what_is_sent_while_somebody_reads_it_counts_from_the_second_on() {
        fn counted<C: Channel>() {
            let fleet: Arc<str> = "lab".into();
            let mut gaps = Gaps::new(0);
            let mut missing = |number| {
                let mut header = C::Header::default();
                header.set_order(1, FrameOrder { run: 5, number });
                gaps.look(&fleet, &Message::of::<C>(header, Vec::new())).missing
            };
            assert_eq!([7, 28, 29, 32, 33].map(&mut missing), [0, 0, 0, 2, 0]);
        }
        counted::<PlanStates>();
        counted::<Outlooks>();
    }

    #[test]
    fn gaps_are_counted_once_per_source_and_run() {
        for (messages, missing) in [
            // Messages sent before the recording are not missing.
            (vec![frame(1, 5, 40), frame(1, 5, 41)], 0),
            (vec![frame(1, 5, 40), frame(1, 5, 44)], 3),
            // Sources are independent.
            (vec![frame(1, 5, 1), frame(2, 5, 9), frame(1, 5, 2)], 0),
            // A run that began after the recording is tracked from its first frame.
            (vec![frame(1, 101, 2)], 2),
            (vec![frame(1, 5, 7), frame(1, 101, 0), frame(1, 101, 1)], 0),
            (vec![frame(1, 5, 7), frame(1, 101, 3)], 3),
            // Late messages of a replaced run, and a duplicate frame.
            (vec![frame(1, 101, 0), frame(1, 5, 9), frame(1, 101, 1)], 0),
            (vec![frame(1, 5, 7), frame(1, 5, 7), frame(1, 5, 8)], 0),
            // Ticks are numbered from 1.
            (vec![tick(101, 1), tick(101, 2)], 0),
            (vec![tick(101, 2), tick(101, 5)], 3),
            (vec![tick(5, 90), tick(101, 1)], 0),
        ] {
            let fleet = Arc::from("lab");
            let mut gaps = Gaps::new(100);
            let found: u64 =
                messages.iter().map(|message| gaps.look(&fleet, message).missing).sum();
            assert_eq!(found, missing, "{messages:?}");
            // Fleets are independent.
            let other = Arc::from("yard");
            assert_eq!(gaps.look(&other, &frame(1, 5, 999)), Found::default());
        }
    }

    fn diagnostics(tick: u64) -> Message {
        let header = DiagnosticHeader { worker_epoch: 5, tick, ..DiagnosticHeader::default() };
        Message::of::<Diagnostics>(header, Vec::new())
    }

    fn without_diagnostics(tick: u64) -> Message {
        let header = TickHeader {
            worker_epoch: 5,
            tick,
            flags: tick_flag::NO_DIAGNOSTICS,
            ..TickHeader::default()
        };
        Message::of::<Ticks>(header, Vec::new())
    }

    #[test]
    fn a_false_number_or_run_does_not_hide_the_gaps_that_follow() {
        let far = u64::MAX;
        let fleet = Arc::from("lab");
        let sent = |epoch, number| frame(1, epoch, number);
        for (messages, missing) in [
            (vec![sent(5, 7), sent(far, 7), sent(5, 8), sent(5, 10)], 1),
            (vec![tick(5, 7), tick(far, 1), tick(5, 9), tick(5, 10)], 1),
        ] {
            let mut gaps = Gaps::new(far);
            let found: u64 =
                messages.iter().map(|message| gaps.look(&fleet, message).missing).sum();
            assert_eq!(found, missing, "{messages:?}");
        }
        let mut gaps = Gaps::new(100);
        let mut missing = |number| gaps.look(&fleet, &frame(1, 5, number)).missing;
        assert_eq!([missing(7), missing(8)], [0, 0]);
        assert!(missing(far - 1) > 1_000, "it is counted");
        assert_eq!([missing(9), missing(10), missing(13)], [0, 0, 2]);
    }

    #[test]
    fn a_hundred_thousand_sources_take_the_memory_of_a_few_thousand_and_gaps_are_still_counted() {
        let (fleet, mut gaps) = (Arc::from("lab"), Gaps::new(100));
        for name in 0..100_000 {
            let living = gaps.look(&fleet, &frame(u64::MAX, 150, 2 * name));
            assert_eq!(living.missing, u64::from(name > 0), "source {name}");
            for number in [0, 1, 3] {
                let found = gaps.look(&fleet, &frame(name, 200 + name, number));
                assert_eq!(found.missing, u64::from(number == 3), "source {name}");
            }
            assert!(gaps.runs.len() <= MAX_RUNS);
        }
        // A dropped run has no missing messages when it sends again.
        assert_eq!(gaps.look(&fleet, &frame(7, 207, 90)).missing, 0);
    }

    #[test]
    fn diagnostics_that_the_worker_left_out_are_not_lost_whenever_it_reports_it() {
        let (sent, none) = (diagnostics, without_diagnostics);
        for (messages, lost) in [
            (vec![sent(1), sent(4)], 2),
            (vec![sent(1), none(2), none(3), sent(4)], 0),
            (vec![sent(1), none(2), sent(4), none(3)], 0),
            (vec![sent(1), none(3), sent(4)], 1),
            (vec![sent(1), none(2), sent(3), sent(5)], 1),
        ] {
            let (fleet, mut gaps) = (Arc::from("lab"), Gaps::new(100));
            let mut sum = 0_i64;
            for message in &messages {
                let found = gaps.look(&fleet, message);
                let of_diagnostics = message.frame::<Diagnostics>().is_some();
                sum += if of_diagnostics { found.missing as i64 } else { 0 };
                sum -= found.never_sent as i64;
            }
            assert_eq!(sum, lost, "{messages:?}");
        }
    }
}
