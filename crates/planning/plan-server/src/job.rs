//! A question that waits or is being answered.

use joulebus_bus::{OpenQuery, PeerWatch};
use joulebus_plan::answering::Work;
use joulebus_plan::{Question, Refused, acknowledgement, statement};
use joulebus_wire::{
    Acknowledgement, AnswerHeader, QueryHeader, QueryKind, QueryRefusal, Statement, query_flag,
};

/// A question's process is watched from this age on, ns: most are answered before.
const WATCHED_FROM_NS: u64 = 1_000_000;
/// Maximum time for which a question is kept, even if its client asks for more, ns.
const MAX_AGE_NS: u64 = 10_000_000_000;
/// A question waits this many ticks for a new frame, then it is answered from the old one.
const FRAME_TICKS: u64 = 3;
/// A question waits this long for the first frame, then it is refused, ns.
const FIRST_FRAME_NS: u64 = 2_000_000_000;

/// A question, copied from shared memory when it was taken.
#[derive(Debug)]
pub(crate) struct Job {
    pub(crate) query: OpenQuery,
    pub(crate) header: QueryHeader,
    pub(crate) values: Vec<f64>,
    /// The process that asked.
    pub(crate) client: u32,
    pub(crate) taken_ns: u64,
    /// Inputs of the answer. Filled when the computation starts.
    pub(crate) answer: AnswerHeader,
    pub(crate) state: JobState,
    /// Number of times that its computation restarted because the robots' state had become stale.
    pub(crate) renewals: u32,
    /// When its acknowledgement was first entered, monotonic ns.
    pub(crate) entered_ns: Option<u64>,
    watch: Option<PeerWatch>,
}

/// State of a job. A job that is answered or refused is removed.
///
/// 1. A question is `Waiting` until a current frame of the robots' states is here. It is then
///    `Working`, a step at a time. If the states become stale meanwhile, it starts again with newer
///    ones, a few times.
/// 2. An acknowledgement (`Acknowledging`) waits for diagnostics that show its alarm raised, and is
///    answered. One that also states the new normal becomes `Stated` once its row was shown.
/// 3. A statement (`Stating`) is passed on to the worker, and is `Stated` until the worker has taken
///    it.
#[derive(Debug)]
pub(crate) enum JobState {
    Waiting(Question),
    Working(Work),
    /// Waits for diagnostics, which state whether the alarm is raised.
    Acknowledging(Acknowledgement),
    /// A robot, what is stated of its battery, and by whom.
    Stating(u32, Statement, String),
    /// Waits until the worker has taken the statement of this number.
    Stated(u64),
}

impl Job {
    /// Copies and checks a question.
    pub(crate) fn take(query: OpenQuery, fleet: u64, now_ns: u64) -> (Self, Result<(), Refused>) {
        let (header, values) = (*query.header(), query.values().to_vec());
        let decoded = match QueryKind::decode(header.kind) {
            Some(QueryKind::Acknowledge) => {
                acknowledgement::decode(&header, &values, fleet, now_ns)
                    .map(JobState::Acknowledging)
            }
            Some(QueryKind::Battery) => statement::decode(&header, &values, fleet)
                .map(|(robot, stated, by)| JobState::Stating(robot, stated, by)),
            _ => Question::decode(&header, &values, fleet).map(JobState::Waiting),
        };
        let (state, checked) = match decoded {
            Ok(state) => (state, Ok(())),
            Err(refused) => (JobState::Waiting(Question::default()), Err(refused)),
        };
        let client = query.client();
        let job = Self {
            query,
            header,
            values,
            client,
            taken_ns: now_ns,
            answer: AnswerHeader::default(),
            state,
            renewals: 0,
            entered_ns: None,
            watch: None,
        };
        (job, checked)
    }

    /// Id of the listener that the answer wakes.
    pub(crate) fn listener(&self) -> u128 {
        (u128::from(self.header.listener_hi) << 64) | u128::from(self.header.listener_lo)
    }

    /// The acknowledgement, if it is one.
    pub(crate) const fn acknowledgement(&self) -> Option<Acknowledgement> {
        match self.state {
            JobState::Acknowledging(row) => Some(row),
            _ => None,
        }
    }

    /// True if it acknowledges an alarm as the new normal.
    pub(crate) const fn is_new_normal(&self) -> bool {
        self.acknowledgement().is_some() && self.header.flags & query_flag::NEW_NORMAL != 0
    }

    /// True if it has waited long enough for a new frame. `has_frame`: there is an old one.
    pub(crate) const fn is_impatient(&self, now_ns: u64, period_ns: u64, has_frame: bool) -> bool {
        let patience_ns =
            if has_frame { period_ns.saturating_mul(FRAME_TICKS) } else { FIRST_FRAME_NS };
        now_ns.saturating_sub(self.taken_ns) >= patience_ns
    }

    /// Reason that the question is not worth answering any more, if so.
    pub(crate) fn is_over(&mut self, now_ns: u64) -> Option<Refused> {
        let limit_ns = self.taken_ns.saturating_add(MAX_AGE_NS);
        // What the worker has got is not refused for its time.
        let is_stated = matches!(self.state, JobState::Stated(_));
        if !is_stated && now_ns >= self.header.deadline_ns.min(limit_ns) {
            let waited_s = now_ns.saturating_sub(self.taken_ns) as f64 * 1e-9;
            let text =
                format!("not answered within the client's time, it waited for {waited_s:.3} s");
            return Some(Refused::new(QueryRefusal::Deadline, text));
        }
        if now_ns.saturating_sub(self.taken_ns) >= WATCHED_FROM_NS {
            // A client that has already ended costs an unread answer, until the cleanup finds it.
            self.watch = self.watch.take().or_else(|| PeerWatch::open(self.client));
        }
        let is_gone = self.watch.as_ref().is_some_and(PeerWatch::is_gone);
        (is_gone || !self.query.is_connected())
            .then(|| Refused::new(QueryRefusal::ClientGone, String::new()))
    }
}
