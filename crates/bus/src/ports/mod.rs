//! Ports: the payload of each service, and how a member opens it.

mod degradation;
mod poll;
mod query;
mod reader;
mod repair;
mod samples;
mod service;
mod wait;
mod worn;
mod writer;

use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, PlanState,
    PlanStateHeader, QueriesHeader, RECORD_WORDS, Sample, SampleHeader, Service, StateHeader,
    TakenFrame, TickHeader,
};

pub use self::poll::Poller;
pub use self::query::{OpenQuery, QueryClient, QueryError, QueryServer};
pub use self::reader::{Frame, KeptFrame, Reader, ReceiveError};
pub use self::samples::{FrameBuf, IncomingFrame, SampleReader, SampleWriter};
pub use self::service::OpenError;
pub use self::wait::{WaitError, Waiter, Waker, Woken};
pub use self::writer::{Loan, SendError, Writer};
use crate::{Bus, Limits};

/// The worker's port for forecasts.
pub type ForecastWriter = Writer<ForecastHeader, Forecast>;
/// The worker's port for diagnostics.
pub type DiagnosticWriter = Writer<DiagnosticHeader, Diagnostic>;
/// The worker's port for budgets.
pub type BudgetWriter = Writer<BudgetHeader, Budget>;
/// The worker's port for its journal.
pub type TickWriter = Writer<TickHeader, TakenFrame>;
/// A planner's port for forecasts.
pub type ForecastReader = Reader<ForecastHeader, Forecast>;
/// A planner's port for diagnostics.
pub type DiagnosticReader = Reader<DiagnosticHeader, Diagnostic>;
/// A planner's port for budgets.
pub type BudgetReader = Reader<BudgetHeader, Budget>;
/// The worker's port for what plans start from.
pub type PlanStateWriter = Writer<PlanStateHeader, PlanState>;
/// A planner's port for what plans start from.
pub type PlanStateReader = Reader<PlanStateHeader, PlanState>;
/// The worker's port for keyframes.
pub type StateWriter = Writer<StateHeader, u8>;
/// A recorder's port for keyframes.
pub type StateReader = Reader<StateHeader, u8>;
/// The worker's port for records of questions.
pub type QueriesWriter = Writer<QueriesHeader, u64>;
/// A recorder's port for records of questions.
pub type QueriesReader = Reader<QueriesHeader, u64>;
/// A recorder's port for samples: reads the same frames as the worker.
pub type SampleTap = Reader<SampleHeader, Sample>;
/// A recorder's port for the worker's journal.
pub type TickReader = Reader<TickHeader, TakenFrame>;

impl Bus {
    /// A source's port. `max_len`: maximum number of samples per frame, at most the capacity.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn sample_writer(
        &self,
        limits: &Limits,
        max_len: usize,
    ) -> Result<SampleWriter, OpenError> {
        SampleWriter::open(self, limits, max_len)
    }

    /// The worker's port for samples of all sources.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn sample_reader(&self, limits: &Limits) -> Result<SampleReader, OpenError> {
        Reader::open(self, Service::Samples, limits, limits.samples()).map(SampleReader::new)
    }

    /// The worker's port for forecasts.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn forecast_writer(&self, limits: &Limits) -> Result<ForecastWriter, OpenError> {
        let shape = limits.forecasts();
        Writer::open(self, Service::Forecasts, limits, shape, limits.capacity)
    }

    /// The worker's port for diagnostics.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn diagnostic_writer(&self, limits: &Limits) -> Result<DiagnosticWriter, OpenError> {
        let shape = limits.diagnostics();
        Writer::open(self, Service::Diagnostics, limits, shape, limits.capacity)
    }

    /// The worker's port for budgets.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn budget_writer(&self, limits: &Limits) -> Result<BudgetWriter, OpenError> {
        let shape = limits.budgets();
        Writer::open(self, Service::Budgets, limits, shape, limits.capacity)
    }

    /// The worker's port for what plans start from.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn plan_state_writer(&self, limits: &Limits) -> Result<PlanStateWriter, OpenError> {
        let shape = limits.plan_states();
        Writer::open(self, Service::PlanStates, limits, shape, limits.capacity)
    }

    /// The worker's port for its journal; frames of up to [`Limits::listed_frames`].
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn tick_writer(&self, limits: &Limits) -> Result<TickWriter, OpenError> {
        let (shape, listed) = (limits.ticks(), limits.listed_frames());
        Writer::open(self, Service::Ticks, limits, shape, listed)
    }

    /// A recorder's port for the worker's journal.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn tick_reader(&self, limits: &Limits) -> Result<TickReader, OpenError> {
        Reader::open(self, Service::Ticks, limits, limits.ticks())
    }

    /// A recorder's port for samples of all sources.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn sample_tap(&self, limits: &Limits) -> Result<SampleTap, OpenError> {
        Reader::open(self, Service::Samples, limits, limits.samples())
    }

    /// A planner's port for forecasts.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn forecast_reader(&self, limits: &Limits) -> Result<ForecastReader, OpenError> {
        Reader::open(self, Service::Forecasts, limits, limits.forecasts())
    }

    /// A planner's port for diagnostics.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn diagnostic_reader(&self, limits: &Limits) -> Result<DiagnosticReader, OpenError> {
        Reader::open(self, Service::Diagnostics, limits, limits.diagnostics())
    }

    /// A planner's port for budgets; the newest frame is delivered at once.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn budget_reader(&self, limits: &Limits) -> Result<BudgetReader, OpenError> {
        Reader::open(self, Service::Budgets, limits, limits.budgets())
    }

    /// A planner's port for what plans start from. While it is open, the worker sends it.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn plan_state_reader(&self, limits: &Limits) -> Result<PlanStateReader, OpenError> {
        Reader::open(self, Service::PlanStates, limits, limits.plan_states())
    }

    /// The worker's port for keyframes; a piece holds [`Writer::max_len`]
    /// bytes.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn state_writer(&self, limits: &Limits) -> Result<StateWriter, OpenError> {
        let shape = limits.state();
        let piece = limits.state_piece_bytes();
        Writer::open(self, Service::State, limits, shape, piece)
    }

    /// A recorder's port for keyframes. While it is open, the worker sends them.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn state_reader(&self, limits: &Limits) -> Result<StateReader, OpenError> {
        Reader::open(self, Service::State, limits, limits.state())
    }

    /// The worker's port for records of questions; a frame holds [`RECORD_WORDS`] words.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn queries_writer(&self, limits: &Limits) -> Result<QueriesWriter, OpenError> {
        let shape = limits.queries();
        Writer::open(self, Service::Queries, limits, shape, RECORD_WORDS)
    }

    /// A recorder's port for records of questions; the newest frame is delivered at once.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn queries_reader(&self, limits: &Limits) -> Result<QueriesReader, OpenError> {
        Reader::open(self, Service::Queries, limits, limits.queries())
    }

    /// The worker's port for questions.
    ///
    /// # Errors
    /// [`OpenError`]: among others, there is one already.
    pub fn query_server(&self, limits: &Limits) -> Result<QueryServer, OpenError> {
        QueryServer::open(self, limits)
    }

    /// A client's port for questions.
    ///
    /// # Errors
    /// [`OpenError`]: among others, there are as many as planners are allowed, or 16.
    pub fn query_client(&self, limits: &Limits) -> Result<QueryClient, OpenError> {
        QueryClient::open(self, limits)
    }

    /// Waits for samples: the worker.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn arrivals_waiter(&self, limits: &Limits) -> Result<Waiter, OpenError> {
        Waiter::open(self, Service::Arrivals, limits, limits.arrivals())
    }

    /// Wakes planners: the worker.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn planner_waker(&self, limits: &Limits) -> Result<Waker, OpenError> {
        Waker::open(self, Service::Wake, limits, limits.wake())
    }

    /// Waits for forecasts: planners.
    ///
    /// # Errors
    /// [`OpenError`].
    pub fn planner_waiter(&self, limits: &Limits) -> Result<Waiter, OpenError> {
        Waiter::open(self, Service::Wake, limits, limits.wake())
    }

    /// Waits for times instead: readers that look now and then.
    #[must_use]
    pub fn planner_poller(&self) -> Poller {
        Poller::new(self)
    }
}
