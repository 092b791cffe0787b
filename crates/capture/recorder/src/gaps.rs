//! Counts the messages overwritten in shared memory before they were received, by the numbers in
//! the headers. Pure.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use joulebus_wire::{Flow, FrameOrder, FrameRows, Samples, TakenFrame, TickHeader, Ticks};

use joulebus_capture_format::{Frame, Message, MessageKind};

/// Maximum number of tracked runs of sources and workers. Beyond it those silent longest are
/// dropped.
const MAX_RUNS: usize = 4_096;
/// Maximum number of ticks without a frame stored per run.
const MAX_UNSENT: usize = 4_096;

#[derive(Debug, Default)]
pub(crate) struct Gaps {
    /// Runs that began later are tracked from their first frame, monotonic ns. Start of the
    /// recording, or of the newest dropped run if that is later.
    known_since_ns: u64,
    /// The fleet whose shared memory is read, and since when, monotonic ns.
    opened: Option<(Arc<str>, u64)>,
    /// Of that fleet, the newest run of the worker whose journal is read, and its first tick there
    /// that began since then.
    begun: Option<FrameOrder>,
    runs: HashMap<Key, Stream>,
    /// Number of messages processed.
    looked: u64,
}

/// Fleet, kind, source (0 of a worker) and run.
type Key = (Arc<str>, MessageKind, u64, u64);

/// State of a numbered stream.
#[derive(Debug, Default)]
struct Stream {
    /// Smaller numbers are not counted as missing.
    from: u64,
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
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Loss {
    /// Messages missing between the previous one of its kind and this one.
    pub(crate) missing: u64,
    /// Kinds of which one was counted as missing before that was never sent.
    pub(crate) never_sent: Vec<MessageKind>,
    /// Frames of samples that a tick took, missing before the first one of their source.
    pub(crate) samples: u64,
    /// True if it is the journal of a tick that began before all ports were open. The tick cannot
    /// be verified, because what other channels lack of it is counted by nobody.
    pub(crate) is_before: bool,
}

impl Gaps {
    pub(crate) fn new(began_ns: u64) -> Self {
        Self { known_since_ns: began_ns, ..Self::default() }
    }

    /// The ports of the fleet are open: what is sent from now on is received, or missing.
    pub(crate) fn opened(&mut self, fleet: Arc<str>, opened_ns: u64) {
        self.known_since_ns = opened_ns;
        self.opened = Some((fleet, opened_ns));
    }

    /// Determines the loss before a message of a fleet.
    pub(crate) fn look(&mut self, fleet: &Arc<str>, message: &Message) -> Loss {
        self.looked += 1;
        let mut found = Loss::default();
        if let Some(journal) = message.frame::<Ticks>() {
            found.is_before = !self.begin(fleet, &journal.header);
            found.never_sent = self.left_out(fleet, &journal.header);
            found.samples = self.samples_before(fleet, journal);
        }
        found.missing = self.missing_before(fleet, message);
        found
    }

    /// Queues differ in length. A recorder that got no processor just after its start finds older
    /// ticks in the journal than in other channels, so the first tick of a channel alone does not
    /// show what was overwritten before it. Returns false if the tick began before the ports were
    /// open.
    fn begin(&mut self, fleet: &Arc<str>, header: &TickHeader) -> bool {
        let Some((_, opened_ns)) = self.opened.as_ref().filter(|(opened, _)| opened == fleet)
        else {
            return true;
        };
        let order = FrameOrder { run: header.worker_epoch, number: header.tick };
        let is_since = order.run > *opened_ns || header.start_ns >= *opened_ns;
        if is_since && self.begun.is_none_or(|begun| begun.run < order.run) {
            self.begun = Some(order);
        }
        is_since
    }

    /// The first tick of a worker's run that counts, if its journal shows it.
    fn first_tick(&self, fleet: &Arc<str>, run: u64) -> Option<u64> {
        let is_opened = self.opened.as_ref().is_some_and(|(opened, _)| opened == fleet);
        self.begun.filter(|begun| is_opened && begun.run == run).map(|begun| begun.number)
    }

    /// A journal states which kinds its tick did not send, and may arrive before or after the next
    /// frame of them. Returns the kinds of which the tick was counted as missing.
    fn left_out(&mut self, fleet: &Arc<str>, header: &TickHeader) -> Vec<MessageKind> {
        let order = FrameOrder { run: header.worker_epoch, number: header.tick };
        let of_tick = MessageKind::of_fleet().filter(|kind| kind.is_of_tick());
        let left_out = of_tick.filter(|kind| !kind.is_sent_in(header));
        let was_counted =
            |kind: &MessageKind| self.run(fleet, *kind, 0, order).leave_out(header.tick);
        left_out.filter(was_counted).collect()
    }

    /// Frames that the tick took and that are older than the first one received of their source.
    /// The first two ticks that count may have taken what was sent before.
    fn samples_before(&self, fleet: &Arc<str>, journal: &Frame<Ticks>) -> u64 {
        let TickHeader { worker_epoch, tick, .. } = journal.header;
        let first = self.first_tick(fleet, worker_epoch);
        if first.is_none_or(|first| tick <= first.saturating_add(1)) {
            return 0;
        }
        let kind = MessageKind::of::<Samples>();
        let is_missing = |taken: &&TakenFrame| {
            let key = (Arc::clone(fleet), kind, taken.source_id, taken.source_epoch);
            taken.is_frame() && self.runs.get(&key).is_some_and(|run| taken.frame_seq < run.from)
        };
        journal.rows.iter().filter(is_missing).count() as u64
    }

    fn missing_before(&mut self, fleet: &Arc<str>, message: &Message) -> u64 {
        let (Some(kind), Some(order)) = (message.kind(), message.order()) else {
            return 0;
        };
        // Pieces of a keyframe state their completeness themselves.
        if kind.rows() == FrameRows::Bytes {
            return 0;
        }
        let samples = message.frame::<Samples>();
        let source = samples.map_or(0, |samples| samples.header.source_id);
        let run = self.run(fleet, kind, source, order);
        if samples.is_some() {
            // The first one may have stated a false number.
            run.from = run.from.min(order.number);
        }
        let is_later = order.number > run.last;
        let missing = run.missing_before(order.number);
        if run.unknown_gap && is_later {
            run.unknown_gap = false;
            run.from = run.next;
            return 0;
        }
        missing
    }

    /// The numbered stream that a frame belongs to.
    fn run(
        &mut self,
        fleet: &Arc<str>,
        kind: MessageKind,
        source: u64,
        order: FrameOrder,
    ) -> &mut Stream {
        let FrameOrder { run: epoch, number } = order;
        let key = (Arc::clone(fleet), kind, source, epoch);
        if !self.runs.contains_key(&key) {
            self.forget_silent();
        }
        let first_tick = self.first_tick(fleet, epoch).filter(|_| kind.is_of_tick());
        let read_from_the_start = epoch > self.known_since_ns && !kind.flow().is_on_demand();
        let looked = self.looked;
        let run = self.runs.entry(key).or_insert_with(|| {
            // Sources count from 0, and ticks are numbered from 1.
            let from_the_start = u64::from(kind.flow() != Flow::Sources);
            let from = first_tick.map_or(number, |first| number.min(first));
            let from = if read_from_the_start { from_the_start } else { from };
            let unknown_gap = kind.flow().is_on_demand();
            Stream { from, next: from, last: from, unknown_gap, ..Stream::default() }
        });
        if let Some(first) = first_tick.filter(|_| !read_from_the_start) {
            (run.from, run.next) = (run.from.max(first), run.next.max(first));
            run.unknown_gap = false;
        }
        run.looked = looked;
        run
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
                self.begun = None;
            }
            stays
        });
    }
}

impl Stream {
    /// The number was not sent. Returns true if it was counted as missing.
    fn leave_out(&mut self, number: u64) -> bool {
        if number < self.next {
            return self.from <= number;
        }
        if self.unsent.len() == MAX_UNSENT {
            self.unsent.pop_front();
        }
        self.unsent.push_back(number);
        false
    }

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
        Channel, DiagnosticHeader, Diagnostics, ForecastHeader, Forecasts, FrameHeader as _,
        Outlooks, PlanStates, SampleHeader, Statement, tick_flag,
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
            assert_eq!(gaps.look(&other, &frame(1, 5, 999)), Loss::default());
        }
    }

    /// Run 5 began before the ports were open at 100 ns. Its tick n begins at 90 + 10n ns.
    #[test]
    fn what_a_worker_that_ran_before_sends_counts_from_the_first_tick_since_the_ports_are_open() {
        fn of_tick<C: Channel>(run: u64, number: u64) -> Message {
            let mut header = C::Header::default();
            header.set_order(1, FrameOrder { run, number });
            Message::of::<C>(header, Vec::new())
        }
        let journal = |tick: u64, flags: u32, rows: Vec<TakenFrame>| {
            let start_ns = 90 + 10 * tick;
            let header =
                TickHeader { worker_epoch: 5, tick, start_ns, flags, ..TickHeader::default() };
            Message::of::<Ticks>(header, rows)
        };
        let tick = |tick: u64| journal(tick, 0, Vec::new());
        let with_states = |tick: u64| journal(tick, tick_flag::PLAN_STATES, Vec::new());
        let taking = |tick: u64, numbers: &[u64]| {
            let row = |number: &u64| {
                let (source_id, source_epoch, frame_seq) = (1, 5, *number);
                TakenFrame { source_id, source_epoch, frame_seq, ..TakenFrame::default() }
            };
            journal(tick, 0, numbers.iter().map(row).collect())
        };
        let (forecasts, states) = (of_tick::<Forecasts>, of_tick::<PlanStates>);
        for (messages, missing, samples) in [
            // The queue of forecasts is shorter than the journal's.
            (vec![tick(4), tick(5), forecasts(5, 6)], 2, 0),
            (vec![tick(4), forecasts(5, 9), tick(10)], 5 + 5, 0),
            (vec![tick(4), forecasts(5, 4), forecasts(5, 5), forecasts(5, 7)], 1, 0),
            // Began before the ports were open, or was sent to a reader before.
            (vec![tick(0), forecasts(5, 3), tick(4), forecasts(5, 4)], 0, 0),
            (vec![states(5, 2), with_states(4), states(5, 4)], 0, 0),
            // Another run.
            (vec![tick(4), forecasts(6, 9)], 0, 0),
            // The journal states whether plan states were sent.
            (vec![with_states(4), with_states(5), states(5, 5)], 1, 0),
            (vec![tick(4), with_states(5), states(5, 5), tick(6), states(5, 7)], 0, 0),
            (vec![states(5, 2), with_states(4), tick(5), states(5, 6)], 1, 0),
            // Ticks 4 and 5 may have taken samples that were sent before.
            (vec![frame(1, 5, 8), taking(4, &[6]), taking(5, &[7]), taking(6, &[8])], 0, 0),
            (vec![frame(1, 5, 8), tick(4), tick(5), taking(6, &[6, 7, 8])], 0, 2),
            // Of another run of the source, nothing is known.
            (vec![frame(1, 6, 8), tick(4), tick(5), taking(6, &[7])], 0, 0),
            // A false number.
            (vec![frame(1, 5, u64::MAX), frame(1, 5, 8), tick(4), tick(5), taking(6, &[8])], 0, 0),
            (
                vec![
                    frame(1, 5, 8),
                    tick(4),
                    tick(5),
                    journal(6, 0, vec![TakenFrame::stated(0, Statement::NewNormal, 0)]),
                ],
                0,
                0,
            ),
        ] {
            let (fleet, mut gaps) = (Arc::from("lab"), Gaps::new(0));
            gaps.opened(Arc::clone(&fleet), 100);
            let mut sums = (0, 0);
            for message in &messages {
                let found = gaps.look(&fleet, message);
                sums = (sums.0 + found.missing, sums.1 + found.samples);
                assert_eq!(found.never_sent, [], "{messages:?}");
                let journal = message.frame::<Ticks>();
                assert_eq!(
                    found.is_before,
                    journal.is_some_and(|journal| journal.header.tick == 0)
                );
            }
            assert_eq!(sums, (missing, samples), "{messages:?}");
            // Other fleets are read from captures, which begin at any tick.
            let (other, mut gaps) = (Arc::from("yard"), Gaps::new(100));
            gaps.opened(fleet, 100);
            assert_eq!(gaps.look(&other, &messages[0]), Loss::default());
            assert_eq!(gaps.look(&other, &forecasts(5, 90)), Loss::default());
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
            // The first one that is received follows ticks without any.
            (vec![none(1), none(2), sent(3), sent(4)], 0),
            (vec![none(1), sent(3)], 1),
        ] {
            let (fleet, mut gaps) = (Arc::from("lab"), Gaps::new(100));
            let mut sum = 0_i64;
            for message in &messages {
                let found = gaps.look(&fleet, message);
                let of_diagnostics = message.frame::<Diagnostics>().is_some();
                sum += if of_diagnostics { found.missing as i64 } else { 0 };
                sum -= found.never_sent.len() as i64;
            }
            assert_eq!(sum, lost, "{messages:?}");
        }
    }
}
