//! Recorded frames, sent again: ports of the recorded sources and of the recorded worker.

mod rebase;

use joulebus_bus::{
    Bus, Domain, JoinError, Limits, OpenError, SampleWriter, SendError, Waker, WorkerLock,
    WorkerLockError, Writer, clock,
};
use joulebus_capture_format::{Message, MessageKind};
use joulebus_wire::{Channel, Flow, ForEachChannel, Forecasts, Samples, WakeEvent, each_channel};

pub use rebase::{Moment, Rebase};

type Open = fn(&Bus, &Limits) -> Result<Box<dyn Outlet>, OpenError>;

/// A channel that can be played.
#[derive(Debug, Clone, Copy)]
pub struct PlayedChannel {
    /// Kind of its messages.
    pub kind: MessageKind,
    open: Open,
}

impl PlayedChannel {
    /// A channel, also one that is declared elsewhere.
    #[must_use]
    pub const fn of<C: Channel>() -> Self {
        Self {
            kind: MessageKind::of::<C>(),
            open: |bus, limits| Ok(Box::new(bus.writer::<C>(limits)?)),
        }
    }

    /// All channels that sources send and planners read.
    #[must_use]
    pub fn all() -> Vec<Self> {
        struct All(Vec<PlayedChannel>);
        impl ForEachChannel for All {
            fn channel<C: Channel>(&mut self) {
                let mut played = PlayedChannel::of::<C>();
                if played.kind == MessageKind::of::<Samples>() {
                    played.open =
                        |bus, limits| Ok(Box::new(bus.sample_writer(limits, limits.capacity)?));
                }
                if !matches!(C::FLOW, Flow::Recorders { .. }) {
                    self.0.push(played);
                }
            }
        }
        let mut all = All(Vec::new());
        each_channel(&mut all);
        all.0
    }
}

/// A port that sends frames again.
trait Outlet {
    /// Sends the frame as of now, and leaves it as it was sent.
    fn send(
        &mut self,
        message: &mut Message,
        rebase: &mut Rebase,
        slower: f64,
    ) -> Result<(), SendError>;

    /// Sends the newest frame to readers that have joined since.
    fn update(&mut self) {}
}

impl<C: Channel> Outlet for Writer<C> {
    fn send(
        &mut self,
        message: &mut Message,
        rebase: &mut Rebase,
        slower: f64,
    ) -> Result<(), SendError> {
        let Some(frame) = message.frame_mut::<C>() else {
            return Ok(());
        };
        rebase.frame(frame, now(), slower);
        Self::send(self, frame.header, frame.rows.len(), |place| frame.rows[place]).map(drop)
    }

    fn update(&mut self) {
        Self::update(self);
    }
}

impl Outlet for SampleWriter {
    fn send(
        &mut self,
        message: &mut Message,
        rebase: &mut Rebase,
        _slower: f64,
    ) -> Result<(), SendError> {
        let Some(frame) = message.frame_mut::<Samples>() else {
            return Ok(());
        };
        rebase.samples(frame, now());
        Self::send(self, frame.header, frame.rows.len(), |place| frame.rows[place]).map(drop)
    }
}

/// The time, on both clocks.
#[must_use]
pub fn now() -> Moment {
    Moment { monotonic_ns: clock::monotonic_ns(), unix_ns: clock::unix_ns() }
}

/// Errors of opening the ports.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplayError {
    /// A worker runs.
    #[error("only samples can be played to a running worker")]
    Lock(#[source] WorkerLockError),
    /// The domain could not be joined.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A port could not be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
}

/// Ports of the played channels.
pub struct ReplayPorts {
    // Dropped in this order: ports, bus, lock.
    ports: Vec<(MessageKind, Box<dyn Outlet>)>,
    planners: Option<Waker>,
    _bus: Bus,
    _lock: Option<WorkerLock>,
}

impl std::fmt::Debug for ReplayPorts {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let kinds = self.ports.iter().map(|(kind, _)| kind);
        out.debug_list().entries(kinds).finish()
    }
}

impl ReplayPorts {
    /// Opens the ports of those `channels` whose kinds are played. The worker's require that no
    /// worker runs, and are opened together, also those that are not played: planners open all of
    /// them.
    ///
    /// # Errors
    /// [`ReplayError`].
    pub fn open(
        domain: &Domain,
        limits: &Limits,
        channels: &[PlayedChannel],
        kinds: &[MessageKind],
    ) -> Result<Self, ReplayError> {
        let is_of_worker = |kind: &MessageKind| kind.flow() != Flow::Sources;
        let as_worker = kinds.iter().any(is_of_worker);
        let lock = as_worker.then(|| WorkerLock::acquire(domain)).transpose();
        let lock = lock.map_err(ReplayError::Lock)?;
        let bus = Bus::join(domain, "replay")?;
        let mut ports = Vec::new();
        for PlayedChannel { kind, open } in channels {
            if kinds.contains(kind) || (as_worker && is_of_worker(kind)) {
                ports.push((*kind, open(&bus, limits)?));
            }
        }
        let planners = as_worker.then(|| bus.planner_waker(limits)).transpose()?;
        Ok(Self { ports, planners, _bus: bus, _lock: lock })
    }

    /// Sends a frame now, and leaves it as it was sent. `slower` as in [`Rebase::frame`]. A message
    /// without a port is skipped.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send(
        &mut self,
        message: &mut Message,
        rebase: &mut Rebase,
        slower: f64,
    ) -> Result<(), SendError> {
        let Some(kind) = message.kind() else {
            return Ok(());
        };
        let mut ports = self.ports.iter_mut();
        let Some((_, port)) = ports.find(|(of, _)| *of == kind) else {
            return Ok(());
        };
        port.send(message, rebase, slower)?;
        if let Some(planners) = &self.planners
            && kind == MessageKind::of::<Forecasts>()
            && let Err(error) = planners.wake(WakeEvent::Frame)
        {
            tracing::warn!(%error, "planners were not woken");
        }
        Ok(())
    }

    /// Sends the newest budgets and plan states to planners that have joined since.
    pub fn update(&mut self) {
        self.ports.iter_mut().for_each(|(_, port)| port.update());
    }

    /// Announces to planners the end of the worker.
    pub fn end(&mut self) {
        if let Some(planners) = &self.planners
            && let Err(error) = planners.wake(WakeEvent::Ended)
        {
            tracing::warn!(%error, "the end could not be announced to planners");
        }
    }
}
