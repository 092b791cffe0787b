//! Output of a tick, computed directly into loaned shared memory.

use joulebus_bus::{
    BudgetWriter, Bus, DiagnosticWriter, ForecastWriter, Limits, Loan, OpenError, SendError, Waker,
    clock,
};
use joulebus_fleet::{Fleet, Outputs};
use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, Payload,
    SCHEMA_VERSION, WakeEvent,
};

use crate::tick_pool::TickPool;

/// The three ports, and the event that wakes planners.
#[derive(Debug)]
pub(crate) struct Outbox {
    forecasts: ForecastWriter,
    diagnostics: DiagnosticWriter,
    budgets: BudgetWriter,
    planners: Waker,
}

impl Outbox {
    pub(crate) fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        Ok(Self {
            forecasts: bus.forecast_writer(limits)?,
            diagnostics: bus.diagnostic_writer(limits)?,
            budgets: bus.budget_writer(limits)?,
            planners: bus.planner_waker(limits)?,
        })
    }

    /// Ticks the robots of a fleet that has begun a tick, writes the output, and sends it. `header`
    /// has everything known before; `sheds`: diagnostics are left out for lack of time. Returns the
    /// number of frames that could not be sent.
    ///
    /// Forecasts are sent first, and planners are woken for them. In a parallel tick all three are
    /// written in one pass, because a second pass over so many robots would cost more memory
    /// bandwidth.
    pub(crate) fn tick(
        &mut self,
        fleet: &mut Fleet,
        pool: &TickPool,
        header: ForecastHeader,
        sheds: bool,
    ) -> u64 {
        let robots = fleet.len();
        let refused = fleet.refusals();
        let mut forecasts = self.forecasts.loan_to_fill(robots);
        let mut diagnostics = (!sheds).then(|| self.diagnostics.loan_to_fill(robots));
        let mut budgets = self.budgets.loan_to_fill(robots);
        let mut shard = fleet.shard();
        let unsent = if pool.shares(robots) {
            let outputs = Outputs {
                forecasts: payload(Some(&mut forecasts)),
                diagnostics: payload(diagnostics.as_mut()),
                budgets: payload(Some(&mut budgets)),
            };
            pool.run(shard, outputs);
            send_forecasts(forecasts, &self.planners, header)
        } else {
            pool.forecast(&mut shard, payload(Some(&mut forecasts)));
            let unsent = send_forecasts(forecasts, &self.planners, header);
            pool.account(
                &mut shard,
                payload(diagnostics.as_mut()),
                payload(Some(&mut budgets)),
            );
            unsent
        };
        let diagnostic_header = DiagnosticHeader {
            schema: SCHEMA_VERSION,
            pid: header.pid,
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            refused,
        };
        let budget_header = BudgetHeader {
            schema: SCHEMA_VERSION,
            pid: header.pid,
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            sent_ns: clock::monotonic_ns(),
            sent_unix_ns: clock::unix_ns(),
        };
        let diagnostics_sent = diagnostics.is_none_or(|loan| {
            loan.is_ok_and(|mut loan: DiagnosticLoan<'_>| {
                *loan.header_mut() = diagnostic_header;
                loan.send().is_ok()
            })
        });
        let budgets_sent = budgets.is_ok_and(|mut loan: BudgetLoan<'_>| {
            *loan.header_mut() = budget_header;
            loan.send().is_ok()
        });
        unsent + u64::from(!diagnostics_sent) + u64::from(!budgets_sent)
    }

    /// Sends planners the end event.
    pub(crate) fn end(&self) {
        if let Err(error) = self.planners.wake(WakeEvent::Ended) {
            tracing::warn!(%error, "planners were not told of the end");
        }
    }
}

/// The memory of a frame; empty if it is left out, or if there is no memory for it.
fn payload<'a, H: Payload, T: Payload>(
    loan: Option<&'a mut Result<Loan<'_, H, T>, SendError>>,
) -> &'a mut [T] {
    loan.and_then(|loan| loan.as_mut().ok())
        .map_or(&mut [], Loan::payload_mut)
}

/// Sends the forecasts and wakes the planners. Returns the number of frames that could not be sent.
fn send_forecasts(
    forecasts: Result<ForecastLoan<'_>, SendError>,
    planners: &Waker,
    mut header: ForecastHeader,
) -> u64 {
    let Ok(mut forecasts) = forecasts else {
        return 1;
    };
    header.compute_end_ns = clock::monotonic_ns();
    header.sent_unix_ns = clock::unix_ns();
    header.sent_ns = clock::monotonic_ns();
    *forecasts.header_mut() = header;
    let sent = forecasts.send().is_ok() && planners.wake(WakeEvent::Frame).is_ok();
    u64::from(!sent)
}

type ForecastLoan<'a> = Loan<'a, ForecastHeader, Forecast>;
type DiagnosticLoan<'a> = Loan<'a, DiagnosticHeader, Diagnostic>;
type BudgetLoan<'a> = Loan<'a, BudgetHeader, Budget>;
