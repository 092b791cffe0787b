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
}

impl Outlets {
    pub(crate) fn open(bus: &Bus, config: &Config) -> anyhow::Result<Self> {
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
    pub(crate) fn pass_on(&mut self, accepted: &Accepted<'_>) -> Result<(), PassError> {
        let (frame, offset_ns) = (&accepted.frame, accepted.offset_ns);
        let pid = process_id();
        let runs = &mut self.runs;
        match frame.service {
            Carried::Forecasts => {
                let mut header: ForecastHeader = frame.header();
                header.shift(offset_ns);
                (header.pid, header.worker_epoch) = (pid, runs.of(header.worker_epoch));
                not_ahead(&header)?;
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
