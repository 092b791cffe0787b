//! Asking the worker, for processes that do not compute for themselves.

use std::fmt;
use std::path::Path;
use std::time::Duration;

#[doc(inline)]
pub use joulebus_bus::QueryError;
use joulebus_bus::{Bus, QueryClient, clock};
use joulebus_config::Config;
use joulebus_connect::{ConnectError, join};
use joulebus_plan::{Plan, Question, Refused, Reply, acknowledgement, statement};
use joulebus_wire::{Alarm, AnswerHeader, QueryHeader, Statement, fnv1a};

/// A client of the thread of `joulebus run` that answers questions about plans. Loads no models,
/// and needs no more memory than a question and an answer. Belongs to one thread.
///
/// ```no_run
/// use std::time::Duration;
///
/// use joulebus_planner::plan::Question;
/// use joulebus_planner::{ClientError, PlanClient};
///
/// # fn example(question: &Question) -> Result<(), Box<dyn std::error::Error>> {
/// let mut client = PlanClient::connect("configs/fleet.toml")?;
/// match client.ask(question, Duration::from_secs(1)) {
///     Ok(answered) => println!("{:?}, of tick {}", answered.reply, answered.tick),
///     Err(ClientError::Refused(why)) => println!("the worker refuses it: {why}"),
///     Err(ClientError::Unanswered(why)) => println!("no answer: {why}"),
///     Err(other) => return Err(other.into()),
/// }
/// # Ok(())
/// # }
/// ```
pub struct PlanClient {
    client: QueryClient,
    fleet: u64,
    /// Times of the question that waits for an answer.
    asked: Option<QuestionTimes>,
    // After the port, which must be dropped before the process leaves the domain.
    _bus: Bus,
}

/// Reason that a question has no answer.
///
/// [`PlanClient`] has an example.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClientError {
    /// The worker refused it.
    #[error(transparent)]
    Refused(#[from] Refused),
    /// No worker answered: none runs, it has ended, or it took too long.
    #[error(transparent)]
    Unanswered(#[from] QueryError),
}

/// A reply, and the frames that it was computed from.
///
/// [`PlanClient`] has an example.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Answered {
    /// The reply.
    pub reply: Reply,
    /// Run of the worker.
    pub worker_epoch: u64,
    /// Tick of the plan states.
    pub tick: u64,
    /// Tick of the budgets, 0 without any.
    pub budget_tick: u64,
    /// Age of the plan states when the answer was sent, ns.
    pub age_ns: u64,
    /// From asking to the answer, ns.
    pub took_ns: u64,
}

impl PlanClient {
    /// Joins the fleet of the config file at `config_path`. The worker need not run yet.
    ///
    /// # Errors
    /// [`ConnectError`] with the cause and the remedy.
    pub fn connect(config_path: impl AsRef<Path>) -> Result<Self, ConnectError> {
        Self::with_config(&Config::load(config_path)?, "plan-client")
    }

    /// Same as [`PlanClient::connect`], with a loaded config, and a name that is shown to
    /// operators.
    ///
    /// # Errors
    /// [`ConnectError`].
    pub fn with_config(config: &Config, name: &str) -> Result<Self, ConnectError> {
        let bus = join(config, name)?;
        Ok(Self {
            client: bus.query_client(&config.limits())?,
            fleet: fnv1a(config.fleet().bytes()),
            asked: None,
            _bus: bus,
        })
    }

    /// Asks, and waits for the answer. If the worker ends meanwhile, this returns at once.
    ///
    /// # Errors
    /// [`ClientError`]. After `timeout` the question is given up, and the worker does not answer it
    /// any more.
    pub fn ask(&mut self, question: &Question, timeout: Duration) -> Result<Answered, ClientError> {
        let (asked, header, values) = self.begin(question, timeout)?;
        let (answer, words) = self.client.ask(header, &values)?;
        asked.answered(&answer, &words)
    }

    /// Acknowledges an alarm of a robot in the name of the person `by`, until the alarm ends.
    /// Returns when the worker has taken it, which is after its next diagnostics. With
    /// `new_normal` the alarm ends: what the robot draws from now on is its own level.
    ///
    /// # Errors
    /// [`ClientError`]: among others, the alarm is not raised, the name is none
    /// ([`joulebus_wire::Acknowledgement::new`]), or the alarm cannot be the new normal
    /// ([`Alarm::is_of_level`]).
    pub fn acknowledge(
        &mut self,
        robot: u32,
        alarm: Alarm,
        by: &str,
        new_normal: bool,
        timeout: Duration,
    ) -> Result<(), ClientError> {
        let encoded = acknowledgement::encode(robot, alarm, by, new_normal, self.fleet)?;
        self.tell(encoded, timeout)
    }

    /// States a robot's battery in the name of the person `by`: measured, full or exchanged. The
    /// worker's next tick takes it, and counts from there.
    ///
    /// # Errors
    /// [`ClientError`]: among others, the robot's platform has no battery, or the name is none.
    pub fn state_battery(
        &mut self,
        robot: u32,
        statement: Statement,
        by: &str,
        timeout: Duration,
    ) -> Result<(), ClientError> {
        let encoded = statement::encode(robot, statement, by, self.fleet)?;
        self.tell(encoded, timeout)
    }

    fn tell(
        &mut self,
        (mut header, values): (QueryHeader, Vec<f64>),
        timeout: Duration,
    ) -> Result<(), ClientError> {
        let asked = QuestionTimes::now(timeout);
        header.deadline_ns = asked.deadline_ns;
        self.asked = None;
        let (answer, words) = self.client.ask(header, &values)?;
        asked.answered(&answer, &words).map(drop)
    }

    /// Sends a question and does not wait: [`PlanClient::poll`] returns the answer. Gives up an
    /// earlier question.
    ///
    /// # Errors
    /// [`ClientError`]. [`QueryError::NotServed`] also if the worker is just starting: ask again.
    pub fn send(&mut self, question: &Question, timeout: Duration) -> Result<(), ClientError> {
        let (asked, header, values) = self.begin(question, timeout)?;
        self.client.send(header, &values)?;
        self.asked = Some(asked);
        Ok(())
    }

    /// The question as it is sent from now on. An earlier one is given up.
    fn begin(
        &mut self,
        question: &Question,
        timeout: Duration,
    ) -> Result<(QuestionTimes, QueryHeader, Vec<f64>), ClientError> {
        let (mut header, values) = question.encode(self.fleet)?;
        // Other plans have no rows along them.
        let has_moments = match &question.plan {
            Plan::WhatIf { .. } => false,
            plan => plan.robots().len() == 1,
        };
        let moments = if has_moments { question.moments } else { 0 };
        let asked = QuestionTimes { moments, ..QuestionTimes::now(timeout) };
        header.deadline_ns = asked.deadline_ns;
        self.asked = None;
        Ok((asked, header, values))
    }

    /// The answer to the question sent last. `None` until it has arrived, and if no question waits.
    /// Does not wait.
    ///
    /// # Errors
    /// [`ClientError`], which is [`QueryError::TimedOut`] at the end of its time. The question is
    /// given up then.
    pub fn poll(&mut self) -> Result<Option<Answered>, ClientError> {
        let Some(asked) = self.asked.take() else {
            return Ok(None);
        };
        match self.client.poll(asked.deadline_ns)? {
            Some((answer, words)) => asked.answered(&answer, &words).map(Some),
            None => {
                self.asked = Some(asked);
                Ok(None)
            }
        }
    }
}

/// When a question was asked, and until when an answer is of use, monotonic ns.
#[derive(Debug, Clone, Copy)]
struct QuestionTimes {
    begun_ns: u64,
    deadline_ns: u64,
    /// Of the question.
    moments: usize,
}

impl QuestionTimes {
    fn now(timeout: Duration) -> Self {
        let begun_ns = clock::monotonic_ns();
        let timeout_ns = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        Self { begun_ns, deadline_ns: begun_ns.saturating_add(timeout_ns), moments: 0 }
    }

    fn answered(self, answer: &AnswerHeader, words: &[u64]) -> Result<Answered, ClientError> {
        Ok(Answered {
            reply: Reply::decode(answer, words, self.moments)?,
            worker_epoch: answer.worker_epoch,
            tick: answer.tick,
            budget_tick: answer.budget_tick,
            age_ns: answer.sent_ns.saturating_sub(answer.sent_state_ns),
            took_ns: clock::monotonic_ns().saturating_sub(self.begun_ns),
        })
    }
}

impl fmt::Debug for PlanClient {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("PlanClient").field("client", &self.client).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::SCHEMA_VERSION;

    use super::*;

    #[test]
    fn the_age_of_an_answer_includes_the_time_of_its_computation() {
        let answer = AnswerHeader {
            schema: SCHEMA_VERSION,
            sent_state_ns: 1_000,
            now_ns: 1_500,
            sent_ns: 9_000,
            ..AnswerHeader::default()
        };
        let asked = QuestionTimes { begun_ns: 1_200, deadline_ns: u64::MAX, moments: 0 };
        let answered = asked.answered(&answer, &[]);
        assert_eq!(answered.map(|answered| answered.age_ns).ok(), Some(8_000));
    }
}
