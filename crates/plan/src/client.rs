//! Asking the worker, for processes that do not compute for themselves.

use std::fmt;
use std::path::Path;
use std::time::Duration;

pub use joulebus_bus::QueryError;
use joulebus_bus::{Bus, QueryClient, clock};
use joulebus_config::{Config, ConnectError};
use joulebus_consumer::OpenError;
use joulebus_wire::fnv1a;

use crate::error::Refused;
use crate::question::{Question, Reply};

/// Asks the thread of `joulebus run` that answers questions about plans. Loads no models, and needs no
/// more memory than a question and an answer. Belongs to one thread.
pub struct PlanClient {
    client: QueryClient,
    fleet: u64,
    // After the port, which must be dropped before the process leaves the domain.
    _bus: Bus,
}

/// Errors of connecting.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenClientError {
    /// The config, or joining the fleet.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The port.
    #[error(transparent)]
    Open(#[from] OpenError),
}

/// Reason that a question has no answer.
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
#[derive(Debug, Clone, PartialEq)]
pub struct Answered {
    /// The reply.
    pub reply: Reply,
    /// Run of the worker.
    pub worker_epoch: u64,
    /// Tick of the plan states.
    pub tick: u64,
    /// Tick of the budgets; 0 without any.
    pub budget_tick: u64,
    /// Age of the plan states when the question was answered, ns.
    pub age_ns: u64,
    /// From asking to the answer, ns.
    pub took_ns: u64,
}

impl PlanClient {
    /// Joins the fleet of the config file at `config_path`. The worker need not run yet.
    ///
    /// # Errors
    /// [`OpenClientError`] with the cause and the remedy.
    pub fn connect(config_path: impl AsRef<Path>) -> Result<Self, OpenClientError> {
        let config = Config::load(config_path).map_err(ConnectError::from)?;
        Self::with_config(&config, "plan-client")
    }

    /// As [`PlanClient::connect`], with a loaded config, and a name that is shown to operators.
    ///
    /// # Errors
    /// [`OpenClientError`].
    pub fn with_config(config: &Config, name: &str) -> Result<Self, OpenClientError> {
        let bus = config.join(name)?;
        Ok(Self {
            client: bus.query_client(&config.limits())?,
            fleet: fnv1a(config.fleet().bytes()),
            _bus: bus,
        })
    }

    /// Asks, and waits for the answer. If the worker ends meanwhile, this returns at once.
    ///
    /// # Errors
    /// [`ClientError`]. After `timeout` the question is given up, and the worker does not answer it
    /// any more.
    pub fn ask(&mut self, question: &Question, timeout: Duration) -> Result<Answered, ClientError> {
        let (mut header, values) = question.encode(self.fleet)?;
        let begun_ns = clock::monotonic_ns();
        let timeout_ns = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        header.deadline_ns = begun_ns.saturating_add(timeout_ns);
        let (answer, words) = self.client.ask(header, &values)?;
        Ok(Answered {
            reply: Reply::decode(&answer, &words)?,
            worker_epoch: answer.worker_epoch,
            tick: answer.tick,
            budget_tick: answer.budget_tick,
            age_ns: answer.now_ns.saturating_sub(answer.sent_state_ns),
            took_ns: clock::monotonic_ns().saturating_sub(begun_ns),
        })
    }
}

impl fmt::Debug for PlanClient {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("PlanClient")
            .field("client", &self.client)
            .finish_non_exhaustive()
    }
}
