//! Recomputes the answers to recorded questions from recomputed ticks.

use std::collections::BTreeMap;

use joulebus_fleet::Fleet;
use joulebus_plan::answering::Work;
use joulebus_plan::{Fleet as PlanFleet, Question, Refused, Reply, RobotRows};
use joulebus_predictor::Model;
use joulebus_settings::FleetSettings;
use joulebus_wire::{
    AnswerHeader, Budget, MAX_QUERY_STEPS, PlanState, QueryKind, QueryRefusal, answer_parts, fnv1a,
};

use crate::compare::{self, FieldDifference};
use crate::report::Verification;
use joulebus_capture_format::Query;

/// Maximum memory of ticks kept for questions about them, bytes.
const MAX_KEPT: usize = 128 << 20;
/// Maximum memory of questions that wait for their ticks, bytes: a recorder writes them after
/// these.
const MAX_WAITING: usize = 64 << 20;

/// Run and number of a tick.
type TickId = (u64, u64);

/// A question, and the hash of the name of the fleet that it was asked of.
type Asked = (Query, u64);

/// Questions, and the ticks that they may be about.
#[derive(Debug)]
pub(super) struct Queries {
    fleet: PlanFleet,
    /// By the later of the two ticks that the answer is computed from.
    waiting: BTreeMap<TickId, Vec<Asked>>,
    waiting_bytes: usize,
    kept: BTreeMap<TickId, Tick>,
    kept_bytes: usize,
    /// True if the answers were computed by the rules of another version.
    pub(super) has_other_rules: bool,
    /// The first and the last tick that was computed.
    span: Option<(TickId, TickId)>,
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
            span: None,
        }
    }

    /// Takes a question that was asked of the fleet of this name.
    pub(super) fn take(&mut self, query: Query, fleet: &str, report: &mut Verification) {
        report.queries += 1;
        if query.record.query.kind == QueryKind::Acknowledge.code() {
            report.acknowledgements += 1;
            return;
        }
        if self.has_other_rules {
            report.queries_of_other_rules += 1;
            return;
        }
        let asked = (query, fnv1a(fleet.bytes()));
        let Err(after) = self.verify(&asked, report) else {
            return;
        };
        self.waiting_bytes += bytes(&asked);
        self.waiting.entry(after).or_default().push(asked);
        while self.waiting_bytes > MAX_WAITING
            && let Some((_, last)) = self.waiting.pop_last()
        {
            self.waiting_bytes -= last.iter().map(bytes).sum::<usize>();
            report.queries_unverified += last.len() as u64;
        }
    }

    /// Keeps the tick that `fleet` has just computed, if plan states were written in it, and
    /// verifies the questions that waited for it.
    pub(super) fn ticked(
        &mut self,
        place: TickId,
        fleet: &Fleet,
        plans: bool,
        report: &mut Verification,
    ) {
        let (first, _) = self.span.unwrap_or((place, place));
        self.span = Some((first, place));
        if plans {
            let rows = 0..fleet.len();
            let tick = Tick {
                states: rows.clone().map(|row| fleet.plan_state(row)).collect(),
                budgets: rows.map(|row| fleet.budget(row)).collect(),
            };
            self.kept_bytes += tick.bytes();
            let before = self.kept.insert(place, tick);
            self.kept_bytes -= before.as_ref().map_or(0, Tick::bytes);
            while self.kept_bytes > MAX_KEPT
                && let Some((_, oldest)) = self.kept.pop_first()
            {
                self.kept_bytes -= oldest.bytes();
            }
        }
        while let Some(due) = self.waiting.first_entry().filter(|due| *due.key() <= place) {
            for asked in due.remove() {
                self.waiting_bytes -= bytes(&asked);
                // It waits for no later tick.
                let _ = self.verify(&asked, report);
            }
        }
    }

    /// Ends the input: what still waits is about ticks that were not computed.
    pub(super) fn finish(&mut self, report: &mut Verification) {
        let waiting = std::mem::take(&mut self.waiting);
        self.waiting_bytes = 0;
        report.queries_outside += waiting.values().map(Vec::len).sum::<usize>() as u64;
    }

    /// Computes an answer again and compares it. The tick that has to be computed first is the
    /// error.
    fn verify(&self, (query, fleet): &Asked, report: &mut Verification) -> Result<(), TickId> {
        let answer = &query.record.answer;
        if depends_on_time(answer) {
            report.queries_by_time += 1;
            return Ok(());
        }
        let state = (answer.worker_epoch, answer.tick);
        let computed = match Question::decode(&query.record.query, &query.values, *fleet) {
            Err(refused) => Err(refused),
            Ok(question) => {
                let budget = (answer.budget_epoch, answer.budget_tick);
                match (self.find(state), self.find(budget)) {
                    (Found::Later, Found::Later) => return Err(state.max(budget)),
                    (Found::Later, _) => return Err(state),
                    (_, Found::Later) => return Err(budget),
                    (Found::At(states), Found::At(budgets)) => {
                        self.compute(question, answer, states, Some(budgets))
                    }
                    (Found::At(states), Found::None) => {
                        self.compute(question, answer, states, None)
                    }
                    (Found::Before, _) | (_, Found::Before) => {
                        report.queries_outside += 1;
                        return Ok(());
                    }
                    (Found::Lost | Found::None, _) | (_, Found::Lost) => {
                        report.queries_unverified += 1;
                        return Ok(());
                    }
                }
            }
        };
        report.queries_verified += 1;
        compare(query, &computed, |robot, difference| {
            report.differ(state, "query", robot, difference);
        });
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

    fn find(&self, place: TickId) -> Found<'_> {
        if place.1 == 0 {
            return Found::None;
        }
        if let Some(tick) = self.kept.get(&place) {
            return Found::At(tick);
        }
        match self.span {
            Some((first, _)) if place < first => Found::Before,
            Some((_, last)) if place <= last => Found::Lost,
            _ => Found::Later,
        }
    }
}

fn bytes((query, _): &Asked) -> usize {
    size_of::<Asked>() + query.memory()
}

enum Found<'a> {
    At(&'a Tick),
    /// The answer is computed from no such frame.
    None,
    /// Before the first tick that was computed.
    Before,
    /// Not yet computed.
    Later,
    /// Not computed, or not kept.
    Lost,
}

/// True if it was refused for a reason that does not follow from what is recorded.
fn depends_on_time(answer: &AnswerHeader) -> bool {
    use QueryRefusal as Reason;
    let reason = QueryRefusal::decode(answer.refusal);
    let recomputed = [
        Reason::Schema,
        Reason::Fleet,
        Reason::Kind,
        Reason::TooLarge,
        Reason::Length,
        Reason::UnknownRobot,
        Reason::Question,
    ];
    answer.refusal != 0 && !reason.is_some_and(|reason| recomputed.contains(&reason))
}

/// Calls `differs` for each difference between the recorded and the computed answer.
fn compare(
    recorded: &Query,
    computed: &Result<Reply, Refused>,
    mut differs: impl FnMut(Option<u32>, FieldDifference),
) {
    let (mut header, mut words) = (AnswerHeader::default(), Vec::new());
    match computed {
        Ok(reply) => reply.encode(&mut header, &mut words),
        Err(refused) => refused.encode(&mut header, &mut words),
    }
    let (rows, power_w, text) = answer_parts(&header, &words);
    // The others do not follow from the question.
    let only = Some(&["refusal", "rows", "powers"][..]);
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
