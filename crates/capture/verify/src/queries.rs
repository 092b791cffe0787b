//! Recomputes the answers to recorded questions from recomputed ticks.

use std::collections::BTreeMap;

use joulebus_fleet::Fleet;
use joulebus_plan::answering::Work;
use joulebus_plan::{PlanFleet, Question, Refused, Reply, RobotRows, acknowledgement, statement};
use joulebus_predictor::Model;
use joulebus_settings::FleetSettings;
use joulebus_wire::{
    Acknowledgement, AcknowledgementHeader, Acknowledgements, AnswerHeader, Budget, Channel as _,
    MAX_QUERY_STEPS, PlanState, QueryHeader, QueryKind, QueryRefusal, answer_parts, fnv1a,
    query_flag,
};

use crate::compare::{self, FieldDifference};
use crate::coverage::{QUERIES, Settled};
use crate::loss::Loss;
use crate::refusals::{self, Refusals, is_by_a_person};
use crate::report::Verification;
use crate::tick_id::TickId;
use joulebus_capture_format::{MessageKind, Query};

/// Maximum memory of ticks kept for questions about them, bytes.
const MAX_KEPT: usize = 128 << 20;
/// Maximum memory of questions that wait for their ticks, bytes: a recorder writes them after
/// these.
const MAX_WAITING: usize = 64 << 20;

/// Maximum number of ticks before or after a recording that an answer in it may be about.
const MAX_BEYOND_TICKS: u64 = 2;
/// Maximum number of runs whose last numbers are remembered.
const MAX_RUNS: usize = 64;

/// A question, and the hash of the name of the fleet that it was asked of.
type FleetQuery = (Query, u64);

/// Questions, and the ticks that they may be about.
#[derive(Debug)]
pub(super) struct Queries {
    fleet: PlanFleet,
    /// By the later of the two ticks that the answer is computed from.
    waiting: BTreeMap<TickId, Vec<FleetQuery>>,
    waiting_bytes: usize,
    kept: BTreeMap<TickId, Tick>,
    kept_bytes: usize,
    /// True if the answers were computed by the rules of another version.
    pub(super) has_other_rules: bool,
    /// The first tick of the recording.
    pub(super) first: Option<TickId>,
    /// The first and the last tick that was computed.
    span: Option<(TickId, TickId)>,
    queries_seen: Numbers,
    acknowledged_seen: Numbers,
    pub(super) refusals: Refusals,
    /// The period of the worker's ticks, if it is known.
    pub(super) period_ns: Option<u64>,
}

/// Plan states and budgets of one tick.
#[derive(Debug)]
struct Tick {
    states: Vec<PlanState>,
    budgets: Vec<Budget>,
}

impl Tick {
    fn bytes(&self) -> usize {
        size_of_val(self.states.as_slice()) + size_of_val(self.budgets.as_slice())
    }
}

impl Queries {
    pub(super) fn new(settings: &FleetSettings, models: &[Model]) -> Self {
        Self {
            fleet: PlanFleet::new(settings, models),
            waiting: BTreeMap::new(),
            waiting_bytes: 0,
            kept: BTreeMap::new(),
            kept_bytes: 0,
            has_other_rules: false,
            first: None,
            span: None,
            queries_seen: Numbers::default(),
            acknowledged_seen: Numbers::default(),
            refusals: Refusals::default(),
            period_ns: None,
        }
    }

    /// Takes a question that was asked of the fleet of this name.
    pub(super) fn take(&mut self, query: Query, fleet: &str, report: &mut Verification) {
        let (record, run) = (&query.record, self.run_of(&query));
        let absent = self.queries_seen.note((record.begun_ns, record.number));
        // A copy, or one that differs from it, is compared as well.
        let is_new = absent.is_some();
        report.settle_absent(run, QUERIES, absent.unwrap_or_default());
        self.refusals.note(record, is_new, report);
        let asked = (query, fnv1a(fleet.bytes()));
        let record = &asked.0.record;
        report.queries += 1;
        let is_acknowledgement = is_by_a_person(record.query.kind);
        report.acknowledgements += u64::from(is_acknowledgement);
        let is_compared = is_acknowledgement || !self.has_other_rules;
        // Others are refused before anything else.
        if is_compared && refusals::is_of_time(record) && is_decoded(&asked) {
            return self.refusals.take(record, (run, is_new), report);
        }
        if is_acknowledgement {
            let settled = self.verify_acknowledgement(&asked, report);
            return report.settle_query(self.run_of(&asked.0), &settled);
        }
        if self.has_other_rules {
            report.queries_of_other_rules += 1;
            let settled = Settled::Not(Loss::OtherAnswers);
            return report.settle_query(self.run_of(&asked.0), &settled);
        }
        let Err(after) = self.verify(&asked, report) else {
            return;
        };
        self.waiting_bytes += bytes(&asked);
        self.waiting.entry(after).or_default().push(asked);
        while self.waiting_bytes > MAX_WAITING
            && let Some((_, last)) = self.waiting.pop_last()
        {
            self.waiting_bytes -= last.iter().map(bytes).sum::<usize>();
            last.iter().for_each(|asked| self.leave(asked, Loss::NotRecomputed, report));
        }
    }

    /// Takes a frame of the alarms that are acknowledged: people make them, and no sample.
    pub(super) fn take_acknowledged(
        &mut self,
        (header, rows): (&AcknowledgementHeader, &[Acknowledgement]),
        report: &mut Verification,
    ) {
        self.refusals.note_acknowledged(rows);
        let run = self.newest_run();
        if let Some(absent) = self.acknowledged_seen.note((header.server_epoch, header.number)) {
            report.settle_absent(run, Acknowledgements::SERVICE.name(), absent);
            let kind = MessageKind::of::<Acknowledgements>();
            report.settle(TickId::new(run, 0), kind, &Settled::Not(Loss::ByPeople));
        }
    }

    /// Counts a question that is not compared.
    fn leave(&self, (query, _): &FleetQuery, why: Loss, report: &mut Verification) {
        let count = if why.is_excused() {
            &mut report.queries_outside
        } else {
            &mut report.queries_unverified
        };
        *count += 1;
        report.settle_query(self.run_of(query), &Settled::Not(why));
    }

    /// The run that a question was answered in, or the newest one if it names none.
    fn run_of(&self, query: &Query) -> u64 {
        match query.record.answer.worker_epoch {
            0 => self.newest_run(),
            run => run,
        }
    }

    fn newest_run(&self) -> u64 {
        self.span.map(|(_, last)| last).or(self.first).map_or(0, |of| of.run)
    }

    /// Checks that the question is a person's statement, and was answered like one. Whether the alarm
    /// was raised, or the robot has a battery, is not computed.
    fn verify_acknowledgement(
        &self,
        (query, fleet): &FleetQuery,
        report: &mut Verification,
    ) -> Settled {
        let (record, values) = (&query.record, &query.values);
        let decoded = decode_by_a_person(&record.query, values, *fleet);
        let reason = QueryRefusal::decode(record.answer.refusal);
        // A host without a worker takes none.
        let is_new_normal = record.query.flags & query_flag::NEW_NORMAL != 0;
        let is_of_battery = record.query.kind == QueryKind::Battery.code();
        let by_people = match reason {
            Some(QueryRefusal::NotRaised) => !is_of_battery,
            Some(QueryRefusal::Kind) => is_new_normal || is_of_battery,
            Some(QueryRefusal::UnknownRobot | QueryRefusal::Question) => is_of_battery,
            _ => false,
        };
        if decoded.is_ok() && by_people {
            return Settled::Not(Loss::ByPeople);
        }
        let computed = decoded.map(|_| Reply::default());
        let id = TickId::new(record.answer.worker_epoch, record.answer.tick);
        compare(query, &computed, |robot, difference| {
            report.differ(id, "query", robot, difference);
        });
        if computed.is_ok() { Settled::Not(Loss::ByPeople) } else { Settled::Compared }
    }

    /// Keeps the tick that `fleet` has just computed, if plan states were written in it, and
    /// verifies the questions that waited for it.
    pub(super) fn ticked(
        &mut self,
        id: TickId,
        fleet: &Fleet,
        plans: bool,
        report: &mut Verification,
    ) {
        let (first, _) = self.span.unwrap_or((id, id));
        self.span = Some((first, id));
        if plans {
            let rows = 0..fleet.len();
            let tick = Tick {
                states: rows.clone().map(|row| fleet.plan_state(row)).collect(),
                budgets: rows.map(|row| fleet.budget(row)).collect(),
            };
            self.kept_bytes += tick.bytes();
            let before = self.kept.insert(id, tick);
            self.kept_bytes -= before.as_ref().map_or(0, Tick::bytes);
            while self.kept_bytes > MAX_KEPT
                && let Some((_, oldest)) = self.kept.pop_first()
            {
                self.kept_bytes -= oldest.bytes();
            }
        }
        while let Some(due) = self.waiting.first_entry().filter(|due| *due.key() <= id) {
            for asked in due.remove() {
                self.waiting_bytes -= bytes(&asked);
                // It waits for no later tick.
                let _ = self.verify(&asked, report);
            }
        }
    }

    /// Ends the input: what still waits is about ticks that were not computed. `last_tick`: of a
    /// run, of which the capture has anything.
    pub(super) fn finish(&mut self, last_tick: impl Fn(u64) -> u64, report: &mut Verification) {
        let waiting = std::mem::take(&mut self.waiting);
        self.waiting_bytes = 0;
        self.refusals.finish(report);
        for (TickId { run, tick }, asked) in waiting {
            let last = last_tick(run);
            // A recorder ends between a tick and the answers about it.
            let is_last = last > 0 && tick <= last.saturating_add(MAX_BEYOND_TICKS);
            let why = if is_last { Loss::End } else { Loss::NoTick };
            asked.iter().for_each(|asked| self.leave(asked, why, report));
        }
    }

    /// Computes an answer again and compares it. The tick that has to be computed first is the
    /// error.
    fn verify(&self, asked: &FleetQuery, report: &mut Verification) -> Result<(), TickId> {
        let (query, fleet) = asked;
        let answer = &query.record.answer;
        if !is_recomputed(answer) {
            self.leave(asked, Loss::Undefined, report);
            return Ok(());
        }
        let state = TickId::new(answer.worker_epoch, answer.tick);
        let computed = match Question::decode(&query.record.query, &query.values, *fleet) {
            Err(refused) => Err(refused),
            Ok(question) => {
                let budget = TickId::new(answer.budget_epoch, answer.budget_tick);
                match (self.find(state), self.find(budget)) {
                    (TickLookup::Later, TickLookup::Later) => return Err(state.max(budget)),
                    (TickLookup::Later, _) => return Err(state),
                    (_, TickLookup::Later) => return Err(budget),
                    (TickLookup::At(states), TickLookup::At(budgets)) => {
                        self.compute(question, answer, states, Some(budgets))
                    }
                    (TickLookup::At(states), TickLookup::None) => {
                        self.compute(question, answer, states, None)
                    }
                    (TickLookup::Absent, _) | (_, TickLookup::Absent) => {
                        self.leave(asked, Loss::NoTick, report);
                        return Ok(());
                    }
                    (TickLookup::Lost | TickLookup::None, _) | (_, TickLookup::Lost) => {
                        self.leave(asked, Loss::NotRecomputed, report);
                        return Ok(());
                    }
                    (TickLookup::Before, _) | (_, TickLookup::Before) => {
                        self.leave(asked, Loss::Before, report);
                        return Ok(());
                    }
                }
            }
        };
        report.queries_verified += 1;
        report.settle_query(self.run_of(query), &Settled::Compared);
        compare(query, &computed, |robot, difference| {
            report.differ(state, "query", robot, difference);
        });
        if let Some(period_ns) = self.period_ns
            && computed.is_ok()
            && answer.period_ns != period_ns
        {
            let difference = ("period_ns", answer.period_ns.into(), period_ns.into());
            report.differ(state, "query", None, difference);
        }
        Ok(())
    }

    fn compute(
        &self,
        question: Question,
        answer: &AnswerHeader,
        states: &Tick,
        budgets: Option<&Tick>,
    ) -> Result<Reply, Refused> {
        let find = |robot| {
            let state = states.states.iter().find(|row| row.robot == robot)?;
            let budget =
                budgets.and_then(|tick| tick.budgets.iter().find(|row| row.robot == robot));
            Some(RobotRows::recorded(answer, *state, budget.copied()))
        };
        let answered = Work::begin(question, find, MAX_QUERY_STEPS).and_then(|mut work| {
            while !work.step(&self.fleet)? {}
            // As the worker: what is stale when the answer is sent is not promised.
            Ok(work.finish_at(answer.sent_ns))
        });
        answered.map_err(|error| Refused::from(&error))
    }

    fn find(&self, id: TickId) -> TickLookup<'_> {
        if id.tick == 0 {
            return TickLookup::None;
        }
        if let Some(tick) = self.kept.get(&id) {
            return TickLookup::At(tick);
        }
        let is_near =
            |of: TickId| id.run == of.run && id.tick.saturating_add(MAX_BEYOND_TICKS) >= of.tick;
        match self.span {
            Some((first, _)) if id < first => {
                if self.first.is_some_and(is_near) {
                    TickLookup::Before
                } else {
                    TickLookup::Absent
                }
            }
            Some((_, last)) if id <= last => TickLookup::Lost,
            _ => TickLookup::Later,
        }
    }
}

fn bytes((query, _): &FleetQuery) -> usize {
    size_of::<FleetQuery>() + query.memory()
}

enum TickLookup<'a> {
    At(&'a Tick),
    /// The answer is computed from no such frame.
    None,
    /// Recorded before the first tick that was computed, or directly before the recording.
    Before,
    Absent,
    Later,
    /// Not computed, or not kept.
    Lost,
}

/// True if the question, or the acknowledgement, is one.
fn is_decoded((query, fleet): &FleetQuery) -> bool {
    let (asked, values) = (&query.record.query, &query.values);
    if is_by_a_person(asked.kind) {
        decode_by_a_person(asked, values, *fleet).is_ok()
    } else {
        Question::decode(asked, values, *fleet).is_ok()
    }
}

fn decode_by_a_person(asked: &QueryHeader, values: &[f64], fleet: u64) -> Result<(), Refused> {
    if asked.kind == QueryKind::Battery.code() {
        return statement::decode(asked, values, fleet).map(drop);
    }
    acknowledgement::decode(asked, values, fleet, 0).map(drop)
}

/// True if it was answered, or refused for a reason that follows from the question.
fn is_recomputed(answer: &AnswerHeader) -> bool {
    use QueryRefusal as Reason;
    let recomputed = [
        Reason::Schema,
        Reason::Fleet,
        Reason::Kind,
        Reason::TooLarge,
        Reason::Length,
        Reason::UnknownRobot,
        Reason::Question,
    ];
    let reason = QueryRefusal::decode(answer.refusal);
    answer.refusal == 0 || reason.is_some_and(|reason| recomputed.contains(&reason))
}

/// The last number of each run of numbered messages.
#[derive(Debug, Default)]
struct Numbers(BTreeMap<u64, u64>);

impl Numbers {
    /// Absent numbers before this one. `None` for a number that is not after the last one.
    fn note(&mut self, (run, number): (u64, u64)) -> Option<u64> {
        let last = self.0.insert(run, number);
        let absent = match last {
            // A recording begins with any.
            None => 0,
            Some(last) if number > last => number - last - 1,
            Some(last) => {
                self.0.insert(run, last);
                return None;
            }
        };
        while self.0.len() > MAX_RUNS {
            self.0.pop_first();
        }
        Some(absent)
    }
}

/// Calls `differs` for each difference between the recorded and the computed answer.
fn compare(
    recorded: &Query,
    computed: &Result<Reply, Refused>,
    mut differs: impl FnMut(Option<u32>, FieldDifference),
) {
    let number = recorded.record.query.number;
    let (mut header, mut words) = (AnswerHeader { number, ..AnswerHeader::default() }, Vec::new());
    match computed {
        Ok(reply) => reply.encode(&mut header, &mut words),
        Err(refused) => refused.encode(&mut header, &mut words),
    }
    let (rows, power_w, text) = answer_parts(&header, &words);
    // The others do not follow from the question.
    let only = Some(&["number", "refusal", "rows", "powers"][..]);
    compare::fields(&recorded.record.answer, &header, only, &mut differs);
    if recorded.text != text {
        let lengths = (recorded.text.len() as u64, text.len() as u64);
        differs(None, ("text", lengths.0.into(), lengths.1.into()));
    }
    let pairs = recorded.rows.iter().zip(rows);
    for (recorded, computed) in pairs {
        let robot = Some(computed.robot);
        compare::fields(recorded, computed, None, &mut |_, difference| {
            differs(robot, difference);
        });
    }
    for (recorded, computed) in recorded.power_w.iter().zip(power_w) {
        if recorded.to_bits() != computed.to_bits() {
            differs(None, ("power_w", (*recorded).into(), (*computed).into()));
        }
    }
}
