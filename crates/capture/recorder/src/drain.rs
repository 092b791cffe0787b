//! Drains a fleet's services in shared memory, often enough that nothing is overwritten.

use std::sync::Arc;
use std::time::Duration;

use joulebus_bus::{Bus, JoinError, OpenError, Reader, ReceiveError, Steps, clock};
use joulebus_config::Config;
use joulebus_wire::{Channel, records};

use crate::item::Item;
use crate::shared::Shared;
use joulebus_capture_format::{Clock, Message, MessageKind, Query, Times};

/// Maximum interval between two drains.
const LOOK_EVERY: Duration = Duration::from_millis(10);
/// Minimum interval between two log lines of receive failures, ns.
const SAY_EVERY_NS: u64 = 1_000_000_000;

/// Errors of opening the services.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DrainError {
    /// The config's domain is invalid.
    #[error(transparent)]
    Domain(#[from] joulebus_bus::DomainError),
    /// The domain could not be joined.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A port could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
}

/// The ports of one fleet. Belongs to the thread that opened them.
pub(crate) struct Drain {
    // Before the bus, because ports must be dropped first.
    samples: Option<Reader<joulebus_wire::Samples>>,
    forecasts: Option<Reader<joulebus_wire::Forecasts>>,
    diagnostics: Option<Reader<joulebus_wire::Diagnostics>>,
    budgets: Option<Reader<joulebus_wire::Budgets>>,
    plan_states: Option<Reader<joulebus_wire::PlanStates>>,
    ticks: Option<Reader<joulebus_wire::Ticks>>,
    state: Option<Reader<joulebus_wire::State>>,
    queries: Option<Reader<joulebus_wire::Queries>>,
    bus: Bus,
    shared: Arc<Shared>,
    fleet: Arc<str>,
    clock: Clock,
    look_every: Duration,
    log_ns: u64,
    say_from_ns: u64,
    batch: Vec<Message>,
}

impl Drain {
    /// Joins as `member`, and opens a port for each `wanted` kind.
    pub(crate) fn open(
        config: &Config,
        member: &str,
        clock: Clock,
        shared: Arc<Shared>,
        wanted: impl Fn(MessageKind) -> bool,
    ) -> Result<Self, DrainError> {
        let bus = Bus::join(&config.domain()?, member)?;
        let limits = config.limits();
        // At most a quarter of the buffered frames arrives between two drains.
        let frames = limits.forecast_frames.min(limits.sample_frames) as u64;
        let most_ns = config.tick_period_ns().saturating_mul(frames) / 4;
        Ok(Self {
            samples: wanted(MessageKind::Samples)
                .then(|| bus.reader(&limits))
                .transpose()?,
            forecasts: wanted(MessageKind::Forecasts)
                .then(|| bus.reader(&limits))
                .transpose()?,
            diagnostics: wanted(MessageKind::Diagnostics)
                .then(|| bus.reader(&limits))
                .transpose()?,
            budgets: wanted(MessageKind::Budgets)
                .then(|| bus.reader(&limits))
                .transpose()?,
            plan_states: wanted(MessageKind::PlanStates)
                .then(|| bus.reader(&limits))
                .transpose()?,
            ticks: wanted(MessageKind::Ticks)
                .then(|| bus.reader(&limits))
                .transpose()?,
            state: wanted(MessageKind::State)
                .then(|| bus.reader(&limits))
                .transpose()?,
            queries: wanted(MessageKind::Queries)
                .then(|| bus.reader(&limits))
                .transpose()?,
            bus,
            shared,
            fleet: Arc::from(config.fleet()),
            clock,
            look_every: LOOK_EVERY.min(Duration::from_nanos(most_ns)),
            // What was sent before is logged now: a false time long ago would begin the file there, and end it.
            log_ns: clock.unix_ns(clock::monotonic_ns()),
            say_from_ns: 0,
            batch: Vec::new(),
        })
    }

    fn look(&mut self) {
        if let Err(error) = self.take_all() {
            self.complain(&error);
        }
        let now_ns = self.clock.unix_ns(clock::monotonic_ns());
        self.batch.sort_by_key(place);
        for message in self.batch.drain(..) {
            let sent_ns = message.sent_ns().map(|sent_ns| self.clock.unix_ns(sent_ns));
            // No frame was sent after now, and written times must be in order.
            let publish_ns = sent_ns.unwrap_or(now_ns).min(now_ns);
            self.log_ns = self.log_ns.max(publish_ns);
            let times = Times {
                log_ns: self.log_ns,
                publish_ns,
            };
            self.shared.hand_on(Item {
                fleet: Arc::clone(&self.fleet),
                times,
                message,
            });
        }
    }

    /// Effects are received before their causes: after a tick's journal is received, the samples
    /// that it took are received as well. A failing service does not block the others.
    fn take_all(&mut self) -> Result<(), ReceiveError> {
        let batch = &mut self.batch;
        let queries = take_queries(&mut self.queries, batch);
        let state = take_all(&mut self.state, batch, Message::State);
        let ticks = take_all(&mut self.ticks, batch, Message::Ticks);
        let plan_states = take_all(&mut self.plan_states, batch, Message::PlanStates);
        let budgets = take_all(&mut self.budgets, batch, Message::Budgets);
        let diagnostics = take_all(&mut self.diagnostics, batch, Message::Diagnostics);
        let forecasts = take_all(&mut self.forecasts, batch, Message::Forecasts);
        let samples = take_all(&mut self.samples, batch, Message::Samples);
        queries
            .and(state)
            .and(ticks)
            .and(plan_states)
            .and(budgets)
            .and(diagnostics)
            .and(forecasts)
            .and(samples)
    }

    fn complain(&mut self, error: &ReceiveError) {
        let now_ns = clock::monotonic_ns();
        if now_ns >= self.say_from_ns {
            self.say_from_ns = now_ns.saturating_add(SAY_EVERY_NS);
            tracing::warn!(%error, "the recorder cannot receive");
        }
    }
}

impl Steps for Drain {
    /// Passes on what waits, until its files in shared memory are removed. It does not listen to
    /// events, because each listener costs the worker time in every tick.
    fn step(&mut self, last: bool) -> Option<Duration> {
        self.look();
        if let Err(error) = self.bus.check() {
            self.shared.fail(error.to_string());
            return None;
        }
        (!last).then_some(self.look_every)
    }
}

/// Receives all waiting frames, if there is a reader.
fn take_all<C: Channel>(
    reader: &mut Option<Reader<C>>,
    batch: &mut Vec<Message>,
    message: impl Fn(C::Header, Vec<C::Row>) -> Message,
) -> Result<(), ReceiveError> {
    let Some(reader) = reader else {
        return Ok(());
    };
    reader.take_all(|header, rows| batch.push(message(*header, rows.to_vec())))
}

/// Receives the records of all waiting frames, if there is a reader.
fn take_queries(
    reader: &mut Option<Reader<joulebus_wire::Queries>>,
    batch: &mut Vec<Message>,
) -> Result<(), ReceiveError> {
    let Some(reader) = reader else {
        return Ok(());
    };
    reader.take_all(|_, words| {
        batch.extend(records(words).map(|record| Message::Query(Query::of_record(record))));
    })
}

/// Causes are sorted before effects: samples first, then tick by tick. Otherwise messages stay in
/// the order in which they were sent.
fn place(message: &Message) -> (u8, u64, u64, u8) {
    match message {
        Message::Samples(header, _) => (0, header.sent_ns, 0, 0),
        Message::Ticks(header, _) => (1, header.worker_epoch, header.tick, 0),
        Message::Forecasts(header, _) => (1, header.worker_epoch, header.tick, 1),
        Message::Diagnostics(header, _) => (1, header.worker_epoch, header.tick, 2),
        Message::Budgets(header, _) => (1, header.worker_epoch, header.tick, 3),
        Message::PlanStates(header, _) => (1, header.worker_epoch, header.tick, 4),
        Message::State(header, _) => (1, header.worker_epoch, header.tick, 5),
        _ => (2, 0, 0, 0),
    }
}
