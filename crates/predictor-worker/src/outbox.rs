//! Output of a tick, computed directly into loaned shared memory.

use joulebus_bus::{Bus, Limits, Loan, OpenError, SendError, Waker, Writer, clock};
use joulebus_fleet::{Fleet, Output, SecondaryOutputs};
use joulebus_wire::{ForecastHeader, Forecasts, FrameHeader as _, WakeEvent};

use crate::standby::watch::CurrentPermit;
use crate::tick_pool::TickPool;

/// The ports, and the event that wakes planners.
#[derive(Debug)]
pub(crate) struct Outbox {
    forecasts: Writer<Forecasts>,
    secondary: SecondaryWriters,
    planners: Waker,
}

/// Declares the ports of the outputs beside the forecasts, and what is done with each of them.
macro_rules! ports {
    ($($(#[doc = $doc:literal])* $rows:ident: $channel:ident, $row:ident, $get:ident,
        $computed:expr, |$fleet:ident, $forecasts:ident| $header:ident { $($fields:tt)* };)*
    ) => {
        #[derive(Debug)]
        struct SecondaryWriters {
            $($rows: Writer<joulebus_wire::$channel>,)*
        }

        /// Their frames in a tick.
        struct SecondaryFrames<'a> {
            $($rows: Lent<'a, joulebus_wire::$channel>,)*
        }

        impl SecondaryWriters {
            fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
                Ok(Self { $($rows: bus.writer(limits)?,)* })
            }

            fn flags(&self, sheds: bool) -> u32 {
                0 $(| flag(&self.$rows, sheds))*
            }

            fn loan(&mut self, robots: usize, flags: u32) -> SecondaryFrames<'_> {
                SecondaryFrames { $($rows: loan(&mut self.$rows, robots, flags),)* }
            }
        }

        impl SecondaryFrames<'_> {
            fn outputs(&mut self) -> SecondaryOutputs<'_> {
                SecondaryOutputs { $($rows: payload(&mut self.$rows),)* }
            }

            /// Returns the number of frames that could not be sent.
            fn send(self, fleet: &Fleet, forecasts: &ForecastHeader, sent: (u64, u64)) -> u64 {
                0 $(+ send(self.$rows, fleet, forecasts, sent))*
            }
        }
    };
}

joulebus_fleet::secondary_outputs!(ports);

impl Outbox {
    pub(crate) fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        Ok(Self {
            forecasts: bus.writer(limits)?,
            secondary: SecondaryWriters::open(bus, limits)?,
            planners: bus.planner_waker(limits)?,
        })
    }

    /// The [`joulebus_wire::tick_flag`]s of the next tick: which outputs it leaves out, for lack of
    /// time if it `sheds`, or because nobody reads them.
    pub(crate) fn flags(&self, sheds: bool) -> u32 {
        self.secondary.flags(sheds)
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
        let mut secondary = self.secondary.loan(robots, flags);
        let mut shard = fleet.shard();
        pool.forecast(shard.reborrow(), payload(&mut forecasts));
        let unsent = send_forecasts(forecasts, &self.planners, header, current_permit);
        pool.account(shard, secondary.outputs());
        let sent = (clock::monotonic_ns(), clock::unix_ns());
        if !current_permit.holds(clock::boot_ns()) {
            return unsent;
        }
        unsent + secondary.send(fleet, &header, sent)
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

fn flag<O: Output>(writer: &Writer<O>, sheds: bool) -> u32 {
    O::SENT_IN.flag(sheds, O::FLOW.is_on_demand() && writer.readers() > 0)
}

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
