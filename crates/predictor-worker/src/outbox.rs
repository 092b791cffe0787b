//! Output of a tick, computed directly into loaned shared memory.

use joulebus_bus::{Bus, Limits, Loan, OpenError, SendError, Waker, Writer, clock};
use joulebus_fleet::{Fleet, Output, SecondaryOutputs};
use joulebus_wire::{
    Budgets, Diagnostics, ForecastHeader, Forecasts, FrameHeader as _, Outlooks, PlanStates,
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

    /// The [`joulebus_wire::tick_flag`]s of the next tick: which outputs it leaves out, for lack of time if it
    /// `sheds`, or because nobody reads them.
    pub(crate) fn flags(&self, sheds: bool) -> u32 {
        fn flag<O: Output>(writer: &Writer<O>, sheds: bool) -> u32 {
            O::SENT_IN.flag(sheds, O::FLOW.is_on_demand() && writer.readers() > 0)
        }
        flag(&self.diagnostics, sheds)
            | flag(&self.budgets, sheds)
            | flag(&self.plan_states, sheds)
            | flag(&self.outlooks, sheds)
    }

    /// Ticks the robots of a fleet that has begun a tick, writes the outputs of a tick with these
    /// `flags`, and sends them. `header` has everything known before. Returns the number of frames
    /// that could not be sent. Nothing is sent after the worker's permit has ended, which may be in
    /// the middle of a tick.
    ///
    /// Forecasts are sent first, and planners are woken for them.
    pub(crate) fn tick(
        &mut self,
        fleet: &mut Fleet,
        pool: &TickPool,
        header: ForecastHeader,
        flags: u32,
        current_permit: &CurrentPermit,
    ) -> u64 {
        let robots = fleet.len();
        let mut forecasts = Some(self.forecasts.loan_to_fill(robots));
        let mut diagnostics = loan(&mut self.diagnostics, robots, flags);
        let mut budgets = loan(&mut self.budgets, robots, flags);
        let mut plan_states = loan(&mut self.plan_states, robots, flags);
        let mut outlooks = loan(&mut self.outlooks, robots, flags);
        let mut shard = fleet.shard();
        pool.forecast(shard.reborrow(), payload(&mut forecasts));
        let unsent = send_forecasts(forecasts, &self.planners, header, current_permit);
        let secondary = SecondaryOutputs {
            diagnostics: payload(&mut diagnostics),
            budgets: payload(&mut budgets),
            plan_states: payload(&mut plan_states),
            outlooks: payload(&mut outlooks),
        };
        pool.account(shard, secondary);
        let sent = (clock::monotonic_ns(), clock::unix_ns());
        if !current_permit.holds(clock::boot_ns()) {
            return unsent;
        }
        unsent
            + send(diagnostics, fleet, &header, sent)
            + send(budgets, fleet, &header, sent)
            + send(plan_states, fleet, &header, sent)
            + send(outlooks, fleet, &header, sent)
    }

    /// Sends planners the end event.
    pub(crate) fn end(&self) {
        if let Err(error) = self.planners.wake(WakeEvent::Ended) {
            tracing::warn!(%error, "planners were not notified of the end");
        }
    }
}

/// The memory of an output's frame: `None` if the tick leaves it out.
type Lent<'a, O> = Option<Result<Loan<'a, O>, SendError>>;

fn loan<O: Output>(writer: &mut Writer<O>, robots: usize, flags: u32) -> Lent<'_, O> {
    O::SENT_IN.is_in(flags).then(|| writer.loan_to_fill(robots))
}

/// The rows of a frame. Empty if it is left out, or if there is no memory for it.
fn payload<'a, O: Output>(lent: &'a mut Lent<'_, O>) -> &'a mut [O::Row] {
    lent.as_mut().and_then(|loan| loan.as_mut().ok()).map_or(&mut [], Loan::payload_mut)
}

/// Sends the forecasts and wakes the planners. Returns the number of frames that could not be sent.
fn send_forecasts(
    lent: Lent<'_, Forecasts>,
    planners: &Waker,
    mut header: ForecastHeader,
    current_permit: &CurrentPermit,
) -> u64 {
    let Some(Ok(mut forecasts)) = lent else {
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
fn send<O: Output>(
    lent: Lent<'_, O>,
    fleet: &Fleet,
    forecasts: &ForecastHeader,
    (sent_ns, sent_unix_ns): (u64, u64),
) -> u64 {
    let sent = lent.is_none_or(|loan| {
        loan.is_ok_and(|mut loan| {
            let mut header = O::header(fleet, forecasts);
            header.set_sent(sent_ns, sent_unix_ns);
            *loan.header_mut() = header;
            loan.send().is_ok()
        })
    });
    u64::from(!sent)
}
