//! Refusals for reasons of time: nothing recomputes them. An excuse needs what a worker that refused
//! for this reason would have left in the capture, otherwise an answer could be altered to one.
//!
//! The evidence comes after the refusal. So a refusal waits until it is there, at most until the
//! end of the capture.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::hash::{BuildHasher as _, RandomState};

use bytemuck::bytes_of;
use joulebus_wire::{
    Acknowledgement, MAX_ACKNOWLEDGED, MAX_ACKNOWLEDGED_BY, QueryKind, QueryRecord, QueryRefusal,
    query_flag,
};

use crate::loss::Loss;
use crate::report::Verification;

/// Number of questions of one process that wait when a further one is refused as
/// [`QueryRefusal::Busy`].
const MAX_OF_A_PROCESS: usize = 4;
/// Number of statements that wait for the next tick when a further one is refused so.
const MAX_STATEMENTS: usize = 64;
/// Maximum time that a worker works on a question, ns.
const MAX_AGE_NS: u64 = 10_000_000_000;
/// Minimum time that a question waits for the first frame of the fleet, ns.
const FIRST_FRAME_NS: u64 = 2_000_000_000;
/// Maximum number of ticks that begin after a worker refused questions because it ends.
const MAX_LAST_TICKS: usize = 2;
/// Maximum number of runs, of workers and of threads that answer, of which something is remembered.
const MAX_RUNS: usize = 64;
/// Maximum number of refusals of one run that are remembered.
const MAX_REFUSALS: usize = 65_536;

/// Refusals that wait for evidence, and the evidence.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    /// By the start of the thread that answers: its records are numbered in the order of sending.
    servers: BTreeMap<u64, Server>,
    /// Refusals because the client was gone, by the client.
    gone: HashMap<u32, Vec<Waiting>>,
    /// Starts of the first tick and of the last ticks of each run of the worker, monotonic ns.
    starts: BTreeMap<u64, (u64, VecDeque<u64>)>,
    /// The newest frame of acknowledged alarms had no room for another, or for one of its alarms.
    acknowledged_full: bool,
    hasher: RandomState,
}

/// What is known of one thread that answers.
#[derive(Debug, Default)]
struct Server {
    /// The latest time of a record so far, monotonic ns.
    newest_ns: u64,
    /// The newest record, if it is a refusal whose time the next record confirms.
    last: Option<Waiting>,
    /// By the client, or `None` for statements that a tick takes: those of all clients count.
    busy: HashMap<Option<u32>, Vec<Busy>>,
    /// Refusals because the worker ends. Nothing else may follow.
    ending: Vec<Waiting>,
    /// Hashes of refusals by their number, to recognise copies.
    seen: BTreeMap<u64, u64>,
}

/// A refusal that waits for evidence: the run that it is counted in, and when it was sent.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    run: u64,
    sent_ns: u64,
}

/// A refusal because others waited, and how many of them have been found: of its process, and
/// statements of any.
#[derive(Debug)]
struct Busy {
    refusal: Waiting,
    client: u32,
    taken_ns: u64,
    open: usize,
    stated: usize,
}

/// True if the reason of a refusal does not follow from the question and the ticks.
pub(super) fn is_of_time(record: &QueryRecord) -> bool {
    use QueryRefusal as Reason;
    let reason = Reason::decode(record.answer.refusal);
    let reasons = [
        Reason::Deadline,
        Reason::NoFrame,
        Reason::Busy,
        Reason::Ending,
        Reason::ClientGone,
        Reason::Unsent,
    ];
    reason.is_some_and(|reason| reasons.contains(&reason))
}

/// True if a question of this kind is none, but what a person states.
pub(super) fn is_by_a_person(kind: u32) -> bool {
    matches!(QueryKind::decode(kind), Some(QueryKind::Acknowledge | QueryKind::Battery))
}

/// True if the next tick takes what it states.
fn is_of_tick(record: &QueryRecord) -> bool {
    record.query.kind == QueryKind::Battery.code()
        || record.query.flags & query_flag::NEW_NORMAL != 0
}

/// True if it waited for a tick, as far as its answer shows.
fn is_stated(record: &QueryRecord) -> bool {
    use QueryRefusal as Reason;
    let after = [Reason::Ending, Reason::ClientGone, Reason::Unsent];
    let reason = Reason::decode(record.answer.refusal);
    is_of_tick(record)
        && (record.answer.refusal == 0 || reason.is_some_and(|reason| after.contains(&reason)))
}

impl Refusals {
    /// Notes a tick of which the journal was recorded. Those of a run come in order.
    pub(super) fn note_tick(&mut self, run: u64, start_ns: u64) {
        let (_, last) = self.starts.entry(run).or_insert_with(|| (start_ns, VecDeque::new()));
        last.push_back(start_ns);
        if last.len() > MAX_LAST_TICKS + 1 {
            last.pop_front();
        }
        if self.starts.len() > MAX_RUNS {
            self.starts.pop_first();
        }
    }

    /// Notes what is acknowledged.
    pub(super) fn note_acknowledged(&mut self, rows: &[Acknowledgement]) {
        let mut of_one = rows.chunk_by(|a, b| (a.robot, a.alarm) == (b.robot, b.alarm));
        let is_full = of_one.any(|persons| persons.len() >= MAX_ACKNOWLEDGED_BY);
        self.acknowledged_full = is_full || rows.len() >= MAX_ACKNOWLEDGED;
    }

    /// Takes a record as evidence for refusals before it. `is_new`: its number follows those before
    /// it, so that it is no copy.
    pub(super) fn note(&mut self, record: &QueryRecord, is_new: bool, report: &mut Verification) {
        if !is_new {
            return;
        }
        let reason = QueryRefusal::decode(record.answer.refusal);
        let (taken_ns, sent_ns) = (record.answer.taken_ns, record.answer.sent_ns);
        let is_gone = reason == Some(QueryRefusal::ClientGone);
        // Its client goes on asking: it has given up the question, or its answer was altered.
        let gone = (!is_gone).then(|| self.gone.remove(&record.client)).flatten();
        for refusal in gone.into_iter().flatten() {
            refusal.settle(Loss::Unproven, report);
        }
        let server = self.servers.entry(record.begun_ns).or_default();
        if let Some(last) = server.last.take_if(|_| sent_ns > 0) {
            let is_earlier = sent_ns < last.sent_ns;
            last.settle(if is_earlier { Loss::Unproven } else { Loss::ByTime }, report);
        }
        if reason != Some(QueryRefusal::Ending) {
            for refusal in server.ending.drain(..) {
                refusal.settle(Loss::Unproven, report);
            }
        }
        // Nothing is sent to a client that is gone, so that its record has no times.
        let since_ns = if is_gone { record.query.asked_ns } else { taken_ns };
        let is_stated = is_stated(record);
        for of in [Some(record.client), None] {
            let busy = server.busy.get_mut(&of);
            let Some(busy) = busy.filter(|_| reason != Some(QueryRefusal::Busy)) else {
                continue;
            };
            busy.retain_mut(|busy| {
                let is_open = since_ns <= busy.taken_ns && (is_gone || sent_ns >= busy.taken_ns);
                busy.open += usize::from(is_open && busy.client == record.client);
                busy.stated += usize::from(is_open && is_stated && of.is_none());
                let is_proven = busy.open >= MAX_OF_A_PROCESS || busy.stated >= MAX_STATEMENTS;
                if is_proven {
                    busy.refusal.settle(Loss::ByTime, report);
                }
                !is_proven
            });
        }
        server.newest_ns = server.newest_ns.max(sent_ns);
        while self.servers.len() > MAX_RUNS
            && let Some((_, oldest)) = self.servers.pop_first()
        {
            oldest.finish(&self.starts, report);
        }
    }

    /// Takes a refusal of [`is_of_time`], after [`Refusals::note`]. It is counted in `run`.
    pub(super) fn take(
        &mut self,
        record: &QueryRecord,
        (run, is_new): (u64, bool),
        report: &mut Verification,
    ) {
        use QueryRefusal as Reason;
        let answer = &record.answer;
        let is_acknowledgement = record.query.kind == QueryKind::Acknowledge.code();
        let refusal = Waiting { run, sent_ns: answer.sent_ns };
        let hash = self.hasher.hash_one(bytes_of(record));
        let server = self.servers.entry(record.begun_ns).or_default();
        if !is_new {
            let is_copy = server.seen.get(&record.number) == Some(&hash);
            return refusal.settle(if is_copy { Loss::ByTime } else { Loss::Unproven }, report);
        }
        server.seen.insert(record.number, hash);
        if server.seen.len() > MAX_REFUSALS {
            server.seen.pop_first();
        }
        let is_empty = answer.rows == 0 && answer.powers == 0;
        let is_in_order =
            record.query.asked_ns <= answer.taken_ns && answer.taken_ns <= answer.sent_ns;
        let waited_ns = answer.sent_ns.saturating_sub(answer.taken_ns);
        let is_newest = server.newest_ns <= answer.sent_ns;
        match Reason::decode(answer.refusal).filter(|_| is_empty) {
            // An altered answer has times.
            Some(Reason::ClientGone) if answer.sent_ns == 0 && answer.taken_ns == 0 => {
                self.gone.entry(record.client).or_default().push(refusal);
            }
            Some(Reason::Deadline)
                if is_in_order
                    && is_newest
                    && (answer.sent_ns >= record.query.deadline_ns || waited_ns >= MAX_AGE_NS) =>
            {
                server.last = Some(refusal);
            }
            Some(Reason::NoFrame)
                if is_in_order && is_newest && answer.tick == 0 && waited_ns >= FIRST_FRAME_NS =>
            {
                server.last = Some(refusal);
            }
            // No more alarms are kept.
            Some(Reason::Busy)
                if answer.tick == 0 && is_acknowledgement && self.acknowledged_full =>
            {
                refusal.settle(Loss::ByTime, report);
            }
            Some(Reason::Busy) if is_in_order && is_newest && answer.tick == 0 => {
                let (client, taken_ns) = (record.client, answer.taken_ns);
                let busy = Busy { refusal, client, taken_ns, open: 0, stated: 0 };
                let of = (!is_of_tick(record)).then_some(client);
                server.busy.entry(of).or_default().push(busy);
            }
            Some(Reason::Ending) if is_in_order && is_newest => server.ending.push(refusal),
            _ => refusal.settle(Loss::Unproven, report),
        }
    }

    pub(super) fn finish(&mut self, report: &mut Verification) {
        for (_, server) in std::mem::take(&mut self.servers) {
            server.finish(&self.starts, report);
        }
        for refusal in std::mem::take(&mut self.gone).into_values().flatten() {
            refusal.settle(Loss::ByTime, report);
        }
    }
}

impl Server {
    fn finish(self, starts: &BTreeMap<u64, (u64, VecDeque<u64>)>, report: &mut Verification) {
        self.last.into_iter().for_each(|last| last.settle(Loss::ByTime, report));
        // Those that waited were never answered if the worker, or the recording, ended.
        let busy = self.busy.into_values().flatten().map(|busy| busy.refusal);
        for refusal in self.ending.into_iter().chain(busy) {
            let is_at_end = is_at_end(starts, refusal.sent_ns);
            refusal.settle(if is_at_end { Loss::ByTime } else { Loss::Unproven }, report);
        }
    }
}

impl Waiting {
    fn settle(self, why: Loss, report: &mut Verification) {
        report.settle_refusal(self.run, why);
    }
}

/// True if the worker that ran at a time sent no more than a few ticks after it.
fn is_at_end(starts: &BTreeMap<u64, (u64, VecDeque<u64>)>, sent_ns: u64) -> bool {
    let begun = starts.values().filter(|(first_ns, _)| *first_ns <= sent_ns);
    let run = begun.max_by_key(|(first_ns, _)| *first_ns);
    run.is_some_and(|(_, last)| {
        last.iter().filter(|start_ns| **start_ns > sent_ns).count() <= MAX_LAST_TICKS
    })
}
