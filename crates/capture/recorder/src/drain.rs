//! Drains a fleet's services in shared memory, often enough that nothing is overwritten.

use std::sync::Arc;
use std::time::Duration;

use joulebus_bus::{Bus, JoinError, OpenError, ReceiveError, Steps, clock};
use joulebus_config::Config;
use joulebus_wire::{Flow, FrameRows};

use crate::channel::{Intake, RecordedChannel};
use crate::item::Item;
use crate::options::RECORDER;
use crate::shared::Shared;
use joulebus_capture_format::{Clock, Message, MessageKind, Times};

/// Maximum interval between two drains.
const POLL_INTERVAL: Duration = Duration::from_millis(10);
/// Minimum interval between two log lines of receive failures, ns.
const LOG_INTERVAL_NS: u64 = 1_000_000_000;

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
    /// Causes before effects. Before the bus, because ports must be dropped first.
    ports: Vec<Box<dyn Intake>>,
    bus: Bus,
    shared: Arc<Shared>,
    fleet: Arc<str>,
    clock: Clock,
    look_every: Duration,
    log_ns: u64,
    log_from_ns: u64,
    batch: Vec<Message>,
}

impl Drain {
    /// Joins as [`RECORDER`], and opens a port for each of the channels.
    pub(crate) fn open(
        config: &Config,
        clock: Clock,
        shared: Arc<Shared>,
        channels: impl Iterator<Item = RecordedChannel>,
    ) -> Result<Self, DrainError> {
        let bus = Bus::join(&config.domain()?, RECORDER)?;
        let limits = config.limits();
        // At most a quarter of the buffered frames arrives between two drains.
        let frames = limits.forecast_frames.min(limits.sample_frames) as u64;
        let most_ns = config.tick_period_ns().saturating_mul(frames) / 4;
        let (mut ports, mut opened_ns) = (Vec::new(), clock::monotonic_ns());
        for channel in channels {
            ports.push((channel.open)(&bus, &limits)?);
            // The ticks after a keyframe must be complete, so its port does not count.
            if channel.kind.flow() == Flow::Sources || channel.kind.is_of_tick() {
                opened_ns = clock::monotonic_ns();
            }
        }
        let fleet = Arc::from(config.fleet());
        shared.opened(Arc::clone(&fleet), opened_ns);
        Ok(Self {
            ports,
            bus,
            shared,
            fleet,
            clock,
            look_every: POLL_INTERVAL.min(Duration::from_nanos(most_ns)),
            // What was sent before is logged now: a false time long ago would begin the file there,
            // and end it.
            log_ns: clock.unix_ns(clock::monotonic_ns()),
            log_from_ns: 0,
            batch: Vec::new(),
        })
    }

    fn look(&mut self) {
        // Once more if there was something: the journals of the ticks before it, from which on
        // frames count as missing, were sent before it, maybe after their port was asked.
        for _ in 0..2 {
            if let Err(error) = self.take_all() {
                self.complain(&error);
            }
            if self.batch.is_empty() {
                break;
            }
        }
        let now_ns = self.clock.unix_ns(clock::monotonic_ns());
        self.batch.sort_by_cached_key(sort_key);
        for message in self.batch.drain(..) {
            let sent_ns = message.sent_ns().map(|sent_ns| self.clock.unix_ns(sent_ns));
            // No frame was sent after now, and written times must be in order.
            let publish_ns = sent_ns.unwrap_or(now_ns).min(now_ns);
            self.log_ns = self.log_ns.max(publish_ns);
            self.shared.compare(&message);
            let times = Times { log_ns: self.log_ns, publish_ns };
            self.shared.hand_on(Item { fleet: Arc::clone(&self.fleet), times, message });
        }
    }

    /// Effects are received before their causes: after a tick's journal is received, the samples
    /// that it took are received as well. A failing service does not block the others.
    fn take_all(&mut self) -> Result<(), ReceiveError> {
        let mut taken = Ok(());
        for port in self.ports.iter_mut().rev() {
            taken = taken.and(port.take_all(&mut self.batch));
        }
        taken
    }

    fn complain(&mut self, error: &ReceiveError) {
        let now_ns = clock::monotonic_ns();
        if now_ns >= self.log_from_ns {
            self.log_from_ns = now_ns.saturating_add(LOG_INTERVAL_NS);
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
        if let Some(name) = self.bus.ended_thread() {
            self.shared.fail(format!("the thread {name} has ended, which is a defect of joulebus"));
            return None;
        }
        (!last).then_some(self.look_every)
    }
}

/// Causes are sorted before effects: samples first, then tick by tick. Otherwise messages stay in
/// the order in which they were sent.
fn sort_key(message: &Message) -> (u8, u64, u64, usize) {
    let (Some(kind), Some(order)) = (message.kind(), message.order()) else {
        return (2, 0, 0, 0);
    };
    match (kind.flow(), kind.rows()) {
        (Flow::Sources, _) => (0, message.sent_ns().unwrap_or_default(), 0, 0),
        (_, FrameRows::UpTo(_)) => (2, 0, 0, 0),
        // The journal lists what a tick took.
        (_, FrameRows::Taken) => (1, order.run, order.number, 0),
        _ => {
            let after = MessageKind::of_fleet().take_while(|known| *known != kind).count();
            (1, order.run, order.number, 1 + after)
        }
    }
}
