//! Ports of a replay: those of the recorded sources and of the recorded worker.

use anyhow::Context as _;
use joulebus_bus::{
    Bus, Domain, Limits, SampleWriter, SendError, Waker, WorkerLock, Writer, clock,
};
use joulebus_capture_format::{Message, MessageKind};
use joulebus_wire::{Sample, WakeEvent};

use super::rebase::{Moment, Rebase};

/// Ports of the played services.
pub(super) struct Ports {
    // Dropped in this order: ports, bus, lock.
    samples: Option<SampleWriter>,
    worker: Option<WorkerPorts>,
    _bus: Bus,
    _lock: Option<WorkerLock>,
}

/// All ports of a worker, also those that are not played: planners open all of them.
struct WorkerPorts {
    forecasts: Writer<joulebus_wire::Forecasts>,
    diagnostics: Writer<joulebus_wire::Diagnostics>,
    budgets: Writer<joulebus_wire::Budgets>,
    plan_states: Writer<joulebus_wire::PlanStates>,
    planners: Waker,
}

/// What was sent.
#[derive(Debug)]
pub(super) enum Sent {
    /// A frame of samples as it was sent.
    Samples(Vec<Sample>),
    /// A frame of another service.
    Other,
}

pub(super) fn now() -> Moment {
    Moment {
        monotonic_ns: clock::monotonic_ns(),
        unix_ns: clock::unix_ns(),
    }
}

impl Ports {
    /// Opens the ports for `kinds`. The worker's ports require that no worker runs.
    pub(super) fn open(
        domain: &Domain,
        limits: &Limits,
        kinds: &[MessageKind],
    ) -> anyhow::Result<Self> {
        let as_worker = kinds.iter().any(|kind| *kind != MessageKind::Samples);
        let lock = as_worker
            .then(|| WorkerLock::acquire(domain))
            .transpose()
            .context("only samples can be played to a running worker")?;
        let bus = Bus::join(domain, "replay")?;
        let samples = kinds
            .contains(&MessageKind::Samples)
            .then(|| bus.sample_writer(limits, limits.capacity))
            .transpose()?;
        let worker = as_worker
            .then(|| -> anyhow::Result<WorkerPorts> {
                Ok(WorkerPorts {
                    forecasts: bus.writer(limits)?,
                    diagnostics: bus.writer(limits)?,
                    budgets: bus.writer(limits)?,
                    plan_states: bus.writer(limits)?,
                    planners: bus.planner_waker(limits)?,
                })
            })
            .transpose()?;
        Ok(Self {
            samples,
            worker,
            _bus: bus,
            _lock: lock,
        })
    }

    /// Sends a message now; `slower` as in [`Rebase::forecasts`]. Messages without a port are
    /// skipped.
    pub(super) fn send(
        &mut self,
        message: Message,
        rebase: &mut Rebase,
        slower: f64,
    ) -> Result<Sent, SendError> {
        let now = now();
        match (message, &mut self.samples, &mut self.worker) {
            (Message::Samples(header, mut rows), Some(writer), _) => {
                let header = rebase.samples(&header, &mut rows, now);
                writer.send(header, rows.len(), |place| rows[place])?;
                return Ok(Sent::Samples(rows));
            }
            (Message::Forecasts(header, mut rows), _, Some(ports)) => {
                let header = rebase.forecasts(&header, &mut rows, now, slower);
                ports
                    .forecasts
                    .send(header, rows.len(), |place| rows[place])?;
                if let Err(error) = ports.planners.wake(WakeEvent::Frame) {
                    tracing::warn!(%error, "planners were not woken");
                }
            }
            (Message::Diagnostics(header, mut rows), _, Some(ports)) => {
                let header = rebase.diagnostics(&header, &mut rows);
                ports
                    .diagnostics
                    .send(header, rows.len(), |place| rows[place])?;
            }
            (Message::Budgets(header, mut rows), _, Some(ports)) => {
                let header = rebase.budgets(&header, &mut rows, now);
                ports
                    .budgets
                    .send(header, rows.len(), |place| rows[place])?;
            }
            (Message::PlanStates(header, mut rows), _, Some(ports)) => {
                let header = rebase.plan_states(&header, &mut rows, now, slower);
                ports
                    .plan_states
                    .send(header, rows.len(), |place| rows[place])?;
            }
            _ => {}
        }
        Ok(Sent::Other)
    }

    /// Sends the newest budgets and plan states to planners that have joined since.
    pub(super) fn update(&mut self) {
        if let Some(ports) = &mut self.worker {
            ports.budgets.update();
            ports.plan_states.update();
        }
    }

    /// Announces to planners the end of the worker.
    pub(super) fn end(&mut self) {
        if let Some(ports) = &self.worker
            && let Err(error) = ports.planners.wake(WakeEvent::Ended)
        {
            tracing::warn!(%error, "the end could not be announced to planners");
        }
    }
}
