//! The ports of a worker, on a host where a link writes in its place.

use joulebus_bus::{
    BudgetWriter, Bus, DiagnosticWriter, ForecastWriter, PlanStateWriter, SendError, TickWriter,
    Waker, Writer, clock, process_id,
};
use joulebus_config::Config;
use joulebus_wire::{
    BudgetHeader, DiagnosticHeader, ForecastHeader, Payload, PlanStateHeader, TickHeader, WakeEvent,
};

use crate::protocol::carried::{Carried, RawFrame};
use crate::protocol::receiver::Accepted;
use crate::protocol::shift::Instants;

/// The ports.
pub(crate) struct Outlets {
    pub(crate) forecasts: ForecastWriter,
    pub(crate) diagnostics: DiagnosticWriter,
    pub(crate) budgets: BudgetWriter,
    pub(crate) plan_states: PlanStateWriter,
    ticks: TickWriter,
    pub(crate) planners: Waker,
    runs: Runs,
    /// Every how many ticks a frame comes, at least 1.
    every: u32,
}

impl Outlets {
    pub(crate) fn open(bus: &Bus, config: &Config, every: u32) -> anyhow::Result<Self> {
        let limits = config.limits();
        Ok(Self {
            forecasts: bus.forecast_writer(&limits)?,
            diagnostics: bus.diagnostic_writer(&limits)?,
            budgets: bus.budget_writer(&limits)?,
            plan_states: bus.plan_state_writer(&limits)?,
            ticks: bus.tick_writer(&limits)?,
            planners: bus.planner_waker(&limits)?,
            runs: Runs::default(),
            every,
        })
    }

    /// Writes a frame where the worker of this host would.
    pub(crate) fn pass_on(&mut self, accepted: &Accepted<'_>) -> Result<(), PassError> {
        let (frame, offset_ns) = (&accepted.frame, accepted.offset_ns);
        // As of a slower worker: consecutive where none is lost, so that readers miss only what was lost.
        let (pid, every) = (process_id(), u64::from(self.every));
        let runs = &mut self.runs;
        let mut place = |run, tick: u64| (pid, runs.of(run), tick / every);
        match frame.service {
            Carried::Forecasts => {
                let mut header: ForecastHeader = frame.header();
                header.shift(offset_ns);
                (header.pid, header.worker_epoch, header.tick) =
                    place(header.worker_epoch, header.tick);
                header.period_ns = frames_apart_ns(header.period_ns, self.every);
                not_ahead(&header)?;
                write(&mut self.forecasts, header, frame, offset_ns)?;
                self.planners
                    .wake(WakeEvent::Frame)
                    .map_err(SendError::Wake)?;
            }
            Carried::Diagnostics => {
                let mut header: DiagnosticHeader = frame.header();
                (header.pid, header.worker_epoch, header.tick) =
                    place(header.worker_epoch, header.tick);
                write(&mut self.diagnostics, header, frame, offset_ns)?;
            }
            Carried::Budgets => {
                let mut header: BudgetHeader = frame.header();
                header.shift(offset_ns);
                (header.pid, header.worker_epoch, header.tick) =
                    place(header.worker_epoch, header.tick);
                write(&mut self.budgets, header, frame, offset_ns)?;
            }
            Carried::PlanStates => {
                let mut header: PlanStateHeader = frame.header();
                header.shift(offset_ns);
                (header.pid, header.worker_epoch, header.tick) =
                    place(header.worker_epoch, header.tick);
                header.period_ns = frames_apart_ns(header.period_ns, self.every);
                write(&mut self.plan_states, header, frame, offset_ns)?;
            }
            Carried::Ticks => {
                let mut header: TickHeader = frame.header();
                header.shift(offset_ns);
                (header.pid, header.worker_epoch, header.tick) =
                    place(header.worker_epoch, header.tick);
                write(&mut self.ticks, header, frame, offset_ns)?;
            }
            // Not asked for, and therefore not accepted.
            Carried::Samples | Carried::State => {}
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
    for (to, mut element) in loan.payload_mut().iter_mut().zip(frame.elements::<T>()) {
        element.shift(offset_ns);
        *to = element;
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

/// The period that a header states where every n-th tick has a frame: one of two periods without a frame is stale.
pub(crate) fn frames_apart_ns(period_ns: u64, every: u32) -> u64 {
    period_ns.saturating_mul(u64::from(every))
}

/// Refuses a frame from the future.
pub(crate) fn not_ahead(header: &ForecastHeader) -> Result<(), PassError> {
    let ahead_ns = header.sent_ns.saturating_sub(clock::monotonic_ns());
    if ahead_ns > 0 {
        return Err(PassError::Future { ahead_ns });
    }
    Ok(())
}

/// Why a frame was not passed on.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PassError {
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
