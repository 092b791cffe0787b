//! The rows on which plans start. The worker writes them only while a program reads them.

use joulebus_bus::clock;
use joulebus_consumer::{Budgets, ConnectError, Feed, PlanStates, Subscriber};
use joulebus_plan::RobotRows;

use super::shares;

/// A frame must arrive within this time, ns.
const PATIENCE_NS: u64 = 3_000_000_000;
/// Time without a question after which the reader leaves the services, ns. The worker then writes
/// less.
const LEAVE_AFTER_NS: u64 = 10_000_000_000;

/// Reason that there are no rows.
#[derive(Debug, thiserror::Error)]
pub(super) enum RowsError {
    #[error("no frame of the worker within 3 s: see `joulebus doctor`")]
    Late,
    #[error(
        "robot {0} is not in the fleet: its source must publish samples of it (/api/v1/robots lists the robots)"
    )]
    UnknownRobot(u32),
    #[error("{0}")]
    Open(String),
}

type Reply = shares::Reply<Result<Vec<RobotRows>, RowsError>>;

struct Waiting {
    robots: Vec<u32>,
    reply: Reply,
    until_ns: u64,
}

struct Feeds {
    states: Feed<PlanStates>,
    budgets: Feed<Budgets>,
}

/// The services, while they are needed.
#[derive(Default)]
pub(super) struct PlanRows {
    feeds: Option<Feeds>,
    waiting: Vec<Waiting>,
    asked_ns: u64,
}

impl PlanRows {
    pub(super) fn ask(&mut self, robots: Vec<u32>, reply: Reply, now_ns: u64) {
        self.asked_ns = now_ns;
        self.waiting.push(Waiting { robots, reply, until_ns: now_ns + PATIENCE_NS });
    }

    /// True if a client waits for an answer.
    pub(super) const fn are_asked(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Answers what can be answered.
    pub(super) fn poll(&mut self, planner: &Subscriber, now_ns: u64) {
        self.waiting.retain(|waiting| waiting.reply.is_wanted());
        if self.waiting.is_empty() {
            if now_ns.saturating_sub(self.asked_ns) > LEAVE_AFTER_NS {
                self.feeds = None;
            }
            return;
        }
        if self.feeds.is_none() {
            match Feeds::open(planner) {
                Ok(feeds) => self.feeds = Some(feeds),
                Err(error) => return self.refuse(&error),
            }
        }
        let Some(feeds) = &mut self.feeds else { return };
        for waiting in std::mem::take(&mut self.waiting) {
            let found = feeds.rows(&waiting.robots);
            let answer = match found {
                None if now_ns < waiting.until_ns => {
                    self.waiting.push(waiting);
                    continue;
                }
                found => found.unwrap_or(Err(RowsError::Late)),
            };
            waiting.reply.send(answer);
        }
    }

    fn refuse(&mut self, error: &ConnectError) {
        for waiting in self.waiting.drain(..) {
            waiting.reply.send(Err(RowsError::Open(error.to_string())));
        }
    }
}

impl Feeds {
    fn open(planner: &Subscriber) -> Result<Self, ConnectError> {
        Ok(Self { states: planner.plan_states()?, budgets: planner.budgets()? })
    }

    /// None while there is no frame that is at most two ticks old.
    fn rows(&mut self, robots: &[u32]) -> Option<Result<Vec<RobotRows>, RowsError>> {
        // Read the state first: the budget of the same tick was sent before it. A failed receive is
        // transient.
        let states = self.states.latest().ok().flatten()?;
        let budgets = self.budgets.latest().ok().flatten()?;
        let now_ns = clock::monotonic_ns();
        let header = *states.header();
        let fresh = |sent_ns: u64| now_ns.abs_diff(sent_ns) <= header.period_ns.saturating_mul(2);
        let budget_header = *budgets.header();
        if !(fresh(header.sent_ns)
            && fresh(budget_header.sent_ns)
            && budget_header.worker_epoch == header.worker_epoch)
        {
            return None;
        }
        let rows = robots.iter().map(|robot| {
            let state = states.robot(*robot).ok_or(RowsError::UnknownRobot(*robot))?;
            Ok(RobotRows {
                header,
                state: *state,
                budget: budgets.robot(*robot).map(|budget| (budget_header, *budget)),
                now_ns,
            })
        });
        Some(rows.collect())
    }
}
