//! Output of a tick, computed directly into loaned shared memory.

use joulebus_bus::{Bus, Limits, Loan, OpenError, SendError, Waker, Writer, clock};
use joulebus_fleet::{Accounts, Fleet};
use joulebus_wire::{
    BudgetHeader, Budgets, Channel, DiagnosticHeader, Diagnostics, ForecastHeader, Forecasts,
    FrameHeader as _, OutlookHeader, Outlooks, PlanStateHeader, PlanStates, SCHEMA_VERSION,
    WakeEvent,
};

use crate::standby::watch::CurrentPermit;
use crate::tick_pool::TickPool;

/// The five ports, and the event that wakes planners.
#[derive(Debug)]
pub(crate) struct Outbox {
    forecasts: Writer<Forecasts>,
    diagnostics: Writer<Diagnostics>,
    budgets: Writer<Budgets>,
    plan_states: Writer<PlanStates>,
    outlooks: Writer<Outlooks>,
    planners: Waker,
}

impl Outbox {
    pub(crate) fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        Ok(Self {
            forecasts: bus.writer(limits)?,
            diagnostics: bus.writer(limits)?,
            budgets: bus.writer(limits)?,
            plan_states: bus.writer(limits)?,
            outlooks: bus.writer(limits)?,
            planners: bus.planner_waker(limits)?,
        })
    }

    /// The outputs that the next tick does not write.
    pub(crate) fn left_out(&self, sheds: bool) -> LeftOut {
        LeftOut {
            diagnostics: sheds,
            plan_states: self.plan_states.readers() == 0,
            outlooks: self.outlooks.readers() == 0,
        }
    }

    /// Ticks the robots of a fleet that has begun a tick, writes the output, and sends it. `header`
    /// has everything known before, `left_out` the outputs not to write. Returns the number of
    /// frames that could not be sent. Nothing is sent after the worker's permit has ended, which
    /// may be in the middle of a tick.
    ///
    /// Forecasts are sent first, and planners are woken for them.
    pub(crate) fn tick(
        &mut self,
        (fleet, pool): (&mut Fleet, &TickPool),
        header: ForecastHeader,
        left_out: LeftOut,
        current_permit: &CurrentPermit,
    ) -> u64 {
        let robots = fleet.len();
        let headers = Headers::new(fleet, &header);
        let mut forecasts = self.forecasts.loan_to_fill(robots);
        let diagnostics = !left_out.diagnostics;
        let mut diagnostics = diagnostics.then(|| self.diagnostics.loan_to_fill(robots));
        let mut budgets = Some(self.budgets.loan_to_fill(robots));
        let plan_states = !left_out.plan_states;
        let mut plan_states = plan_states.then(|| self.plan_states.loan_to_fill(robots));
        let outlooks = !left_out.outlooks;
        let mut outlooks = outlooks.then(|| self.outlooks.loan_to_fill(robots));
        let accounts = Accounts {
            diagnostics: payload(diagnostics.as_mut()),
            budgets: payload(budgets.as_mut()),
            plan_states: payload(plan_states.as_mut()),
            outlooks: payload(outlooks.as_mut()),
        };
        let mut shard = fleet.shard();
        pool.forecast(shard.reborrow(), payload(Some(&mut forecasts)));
        let unsent = send_forecasts(forecasts, &self.planners, header, current_permit);
        pool.account(shard, accounts);
        let sent = (clock::monotonic_ns(), clock::unix_ns());
        if !current_permit.holds(clock::boot_ns()) {
            return unsent;
        }
        unsent
            + send(diagnostics, headers.diagnostics, sent)
            + send(budgets, headers.budgets, sent)
            + send(plan_states, headers.plan_states, sent)
            + send(outlooks, headers.outlooks, sent)
    }

    /// Sends planners the end event.
    pub(crate) fn end(&self) {
        if let Err(error) = self.planners.wake(WakeEvent::Ended) {
            tracing::warn!(%error, "planners were not notified of the end");
        }
    }
}

/// Outputs that a tick does not write.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LeftOut {
    /// For lack of time.
    pub(crate) diagnostics: bool,
    /// Left out because nobody reads them.
    pub(crate) plan_states: bool,
    /// Left out because nobody reads them, as plan states.
    pub(crate) outlooks: bool,
}

/// Headers of the accounts, without the times of sending.
struct Headers {
    diagnostics: DiagnosticHeader,
    budgets: BudgetHeader,
    plan_states: PlanStateHeader,
    outlooks: OutlookHeader,
}

impl Headers {
    fn new(fleet: &Fleet, forecasts: &ForecastHeader) -> Self {
        let (schema, pid) = (SCHEMA_VERSION, forecasts.pid);
        let (worker_epoch, tick) = (forecasts.worker_epoch, forecasts.tick);
        Self {
            diagnostics: DiagnosticHeader {
                schema,
                pid,
                worker_epoch,
                tick,
                refused: fleet.refusals(),
                platforms: fleet.platform_memories(),
            },
            budgets: BudgetHeader { schema, pid, worker_epoch, tick, ..BudgetHeader::default() },
            plan_states: PlanStateHeader {
                schema,
                pid,
                worker_epoch,
                tick,
                period_ns: forecasts.period_ns,
                settings_hash: fleet.settings_hash(),
                model_hash: forecasts.model_hash,
                models: fleet.model_hashes(),
                compute_start_ns: forecasts.compute_start_ns,
                ..PlanStateHeader::default()
            },
            outlooks: OutlookHeader {
                schema,
                pid,
                worker_epoch,
                tick,
                period_ns: forecasts.period_ns,
                model_hash: forecasts.model_hash,
                compute_start_ns: forecasts.compute_start_ns,
                ..OutlookHeader::default()
            },
        }
    }
}

/// The memory of a frame. Empty if it is left out, or if there is no memory for it.
fn payload<'a, C: Channel>(
    loan: Option<&'a mut Result<Loan<'_, C>, SendError>>,
) -> &'a mut [C::Row] {
    loan.and_then(|loan| loan.as_mut().ok()).map_or(&mut [], Loan::payload_mut)
}

/// Sends the forecasts and wakes the planners. Returns the number of frames that could not be sent.
fn send_forecasts(
    forecasts: Result<Loan<'_, Forecasts>, SendError>,
    planners: &Waker,
    mut header: ForecastHeader,
    current_permit: &CurrentPermit,
) -> u64 {
    let Ok(mut forecasts) = forecasts else {
        return 1;
    };
    header.compute_end_ns = clock::monotonic_ns();
    header.sent_unix_ns = clock::unix_ns();
    header.sent_ns = clock::monotonic_ns();
    if !current_permit.holds(clock::boot_ns()) {
        return 0;
    }
    *forecasts.header_mut() = header;
    let sent = forecasts.send().is_ok() && planners.wake(WakeEvent::Frame).is_ok();
    u64::from(!sent)
}

/// Sends a frame, unless it is left out. Returns the number of frames that could not be sent.
fn send<C: Channel>(
    loan: Option<Result<Loan<'_, C>, SendError>>,
    mut header: C::Header,
    (sent_ns, sent_unix_ns): (u64, u64),
) -> u64 {
    header.set_sent(sent_ns, sent_unix_ns);
    let sent = loan.is_none_or(|loan| {
        loan.is_ok_and(|mut loan| {
            *loan.header_mut() = header;
            loan.send().is_ok()
        })
    });
    u64::from(!sent)
}
