//! The thread of a planners' host: puts a worker's outputs into this host's shared memory, in the worker's place.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use joulebus_bus::{
    BudgetWriter, Bus, DiagnosticWriter, ForecastWriter, PlanStateWriter, SendError, TickWriter,
    Waker, WorkerLock, Writer, clock, process_id,
};
use joulebus_config::Config;
use joulebus_wire::{
    BudgetHeader, DiagnosticHeader, ForecastHeader, Payload, PlanStateHeader, TickHeader, WakeEvent,
};

use crate::config::Follow;
use crate::network::{Event, Inbox, Kind, Network, longest_bytes};
use crate::protocol::carried::{Carried, RawFrame};
use crate::protocol::message::Worker;
use crate::protocol::receiver::Accepted;
use crate::protocol::shift::Instants;
use crate::taking::{TakenRecord, Taking};

/// Longest sleep: how late a stop, a silence or a new reader of plan states may be noticed.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Follows until `stop`. Calls `ready` when the outputs can be read.
///
/// # Errors
/// The fleet cannot be joined, its files were removed, or the network is refused.
pub(crate) fn run(
    (config, follow): (&Config, &Follow),
    (network, lock): (&Arc<Network>, &WorkerLock),
    stop: &AtomicBool,
    ready: impl FnOnce(),
) -> anyhow::Result<TakenRecord> {
    let limits = config.limits();
    let mut bus = config.join("link")?;
    bus.needs_lock(lock);
    let mut inbox = Inbox::new(longest_bytes(limits.capacity));
    let taking = Taking::open(
        network,
        (Kind::Outputs, &follow.worker),
        (config.fleet(), limits.capacity.max(limits.listed_frames())),
        follow.selection.clone(),
        &mut inbox,
    )?;
    let mut following = Following {
        outlets: Outlets::open(&bus, config)?,
        taking,
        asks: follow.selection.services,
        told: Worker::Unknown,
    };
    ready();
    while !stop.load(Ordering::Relaxed) {
        bus.check()?;
        following.turn(&inbox)?;
    }
    following.outlets.planners.wake(WakeEvent::Ended)?;
    let mut record = following.taking.record();
    record.received.lost += inbox.overflowed();
    Ok(record)
}

struct Following {
    outlets: Outlets,
    taking: Taking,
    /// Services that the file names.
    asks: u32,
    /// State of the worker that planners here have been told last.
    told: Worker,
}

impl Following {
    fn turn(&mut self, inbox: &Inbox) -> anyhow::Result<()> {
        // Sent only while somebody reads them, as the worker itself does.
        let plans = Carried::PlanStates.bit();
        let is_read = self.outlets.plan_states.readers() > 0;
        let services = if is_read {
            self.asks
        } else {
            self.asks & !plans
        };
        self.taking.receiver().select(services);
        self.taking.ask();
        match inbox.next(LOOK_EVERY) {
            Ok(Event::Message {
                bytes, arrived_ns, ..
            }) => {
                let outlets = &mut self.outlets;
                let mut ended = Ok(());
                self.taking.message(&bytes, arrived_ns, |accepted| {
                    outlets.pass_on(&accepted).map_err(|error| {
                        let shown = error.to_string();
                        if let PassError::Send(error) = error
                            && error.is_final()
                        {
                            ended = Err(error);
                        }
                        ("not passed on", shown)
                    })
                });
                ended?;
            }
            Ok(Event::Lost { .. }) => {
                self.taking.receiver().lost();
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => anyhow::bail!("the network has ended"),
        }
        self.taking.receiver().falls_silent(clock::monotonic_ns());
        self.tell()
    }

    /// Planners are told once that nothing is to be expected, and why.
    fn tell(&mut self) -> anyhow::Result<()> {
        let is_heard = self.taking.receiver().is_heard();
        let worker = match self.taking.receiver().worker() {
            worker if is_heard => worker,
            _ => Worker::Unknown,
        };
        if worker == self.told {
            return Ok(());
        }
        let from = self.taking.from();
        match (is_heard, worker) {
            (true, Worker::Alive) => tracing::info!("the worker of {from} sends"),
            (true, Worker::Gone) => {
                tracing::warn!("the worker of {from} has ended");
                self.outlets.planners.wake(WakeEvent::Ended)?;
            }
            (true, _) => {}
            (false, _) => {
                tracing::warn!("nothing comes from {from}");
                self.outlets.planners.wake(WakeEvent::Unreachable)?;
            }
        }
        self.told = worker;
        Ok(())
    }
}

/// The ports of a worker.
struct Outlets {
    forecasts: ForecastWriter,
    diagnostics: DiagnosticWriter,
    budgets: BudgetWriter,
    plan_states: PlanStateWriter,
    ticks: TickWriter,
    planners: Waker,
    runs: Runs,
}

impl Outlets {
    fn open(bus: &Bus, config: &Config) -> anyhow::Result<Self> {
        let limits = config.limits();
        Ok(Self {
            forecasts: bus.forecast_writer(&limits)?,
            diagnostics: bus.diagnostic_writer(&limits)?,
            budgets: bus.budget_writer(&limits)?,
            plan_states: bus.plan_state_writer(&limits)?,
            ticks: bus.tick_writer(&limits)?,
            planners: bus.planner_waker(&limits)?,
            runs: Runs::default(),
        })
    }

    /// Writes a frame where the worker of this host would.
    fn pass_on(&mut self, accepted: &Accepted<'_>) -> Result<(), PassError> {
        let (frame, offset_ns) = (&accepted.frame, accepted.offset_ns);
        let pid = process_id();
        let runs = &mut self.runs;
        match frame.service {
            Carried::Forecasts => {
                let mut header: ForecastHeader = frame.header();
                header.shift(offset_ns);
                (header.pid, header.worker_epoch) = (pid, runs.of(header.worker_epoch));
                let now_ns = clock::monotonic_ns();
                if header.sent_ns > now_ns {
                    let ahead_ns = header.sent_ns - now_ns;
                    return Err(PassError::Future { ahead_ns });
                }
                write(&mut self.forecasts, header, frame, offset_ns)?;
                self.planners
                    .wake(WakeEvent::Frame)
                    .map_err(SendError::Wake)?;
            }
            Carried::Diagnostics => {
                let mut header: DiagnosticHeader = frame.header();
                (header.pid, header.worker_epoch) = (pid, runs.of(header.worker_epoch));
                write(&mut self.diagnostics, header, frame, offset_ns)?;
            }
            Carried::Budgets => {
                let mut header: BudgetHeader = frame.header();
                header.shift(offset_ns);
                (header.pid, header.worker_epoch) = (pid, runs.of(header.worker_epoch));
                write(&mut self.budgets, header, frame, offset_ns)?;
            }
            Carried::PlanStates => {
                let mut header: PlanStateHeader = frame.header();
                header.shift(offset_ns);
                (header.pid, header.worker_epoch) = (pid, runs.of(header.worker_epoch));
                write(&mut self.plan_states, header, frame, offset_ns)?;
            }
            Carried::Ticks => {
                let mut header: TickHeader = frame.header();
                header.shift(offset_ns);
                (header.pid, header.worker_epoch) = (pid, runs.of(header.worker_epoch));
                write(&mut self.ticks, header, frame, offset_ns)?;
            }
            // Not asked for, and therefore not accepted.
            Carried::Samples => {}
        }
        Ok(())
    }
}

fn write<H: Payload, T: Payload + Instants>(
    writer: &mut Writer<H, T>,
    header: H,
    frame: &RawFrame<'_>,
    offset_ns: i128,
) -> Result<(), SendError> {
    let mut loan = writer.loan_to_fill(frame.len())?;
    *loan.header_mut() = header;
    frame.copy_to(loan.payload_mut());
    for element in loan.payload_mut() {
        element.shift(offset_ns);
    }
    loan.send()?;
    Ok(())
}

/// Runs of the worker. Planners take a later run for one with a greater number, and a host that has booted counts from
/// the beginning.
#[derive(Debug, Default)]
struct Runs {
    /// The worker's own number, and that under which it is known here.
    now: Option<(u64, u64)>,
}

impl Runs {
    fn of(&mut self, run: u64) -> u64 {
        let (_, here) = match self.now {
            Some(known) if known.0 == run => known,
            Some((_, last)) => (run, run.max(last.saturating_add(1))),
            None => (run, run),
        };
        self.now = Some((run, here));
        here
    }
}

/// Why a frame was not passed on.
#[derive(Debug, thiserror::Error)]
enum PassError {
    #[error("it was sent {ahead_ns} ns from now")]
    Future { ahead_ns: u64 },
    #[error(transparent)]
    Send(#[from] SendError),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_that_starts_again_is_a_later_run_also_after_its_host_has_booted() {
        let mut runs = Runs::default();
        let found = [70, 70, 90, 90, 5, 5, 6, 200].map(|run| runs.of(run));
        assert_eq!(found, [70, 70, 90, 90, 91, 91, 92, 200]);
    }
}
