//! The ports of a worker, on a host where a link writes in its place.

use joulebus_bus::{Bus, SendError, Waker, Writer, clock, process_id};
use joulebus_config::Config;
use joulebus_wire::{
    Budgets, Channel, Diagnostics, Forecasts, FrameHeader as _, Outlooks, Place, PlanStates, Ticks,
    WakeEvent,
};

use crate::protocol::carried::Carried;
use crate::protocol::receiver::Accepted;
use crate::protocol::shift::shift;

/// The worker's ports of this host.
pub(crate) struct WorkerPorts {
    pub(crate) forecasts: Writer<Forecasts>,
    pub(crate) diagnostics: Writer<Diagnostics>,
    pub(crate) budgets: Writer<Budgets>,
    pub(crate) plan_states: Writer<PlanStates>,
    pub(crate) outlooks: Writer<Outlooks>,
    ticks: Writer<Ticks>,
    pub(crate) planners: Waker,
    runs: Runs,
    /// A frame comes every n-th tick, n at least 1.
    every: u32,
}

impl WorkerPorts {
    pub(crate) fn open(bus: &Bus, config: &Config, every: u32) -> anyhow::Result<Self> {
        let limits = config.limits();
        Ok(Self {
            forecasts: bus.writer(&limits)?,
            diagnostics: bus.writer(&limits)?,
            budgets: bus.writer(&limits)?,
            plan_states: bus.writer(&limits)?,
            outlooks: bus.writer(&limits)?,
            ticks: bus.writer(&limits)?,
            planners: bus.planner_waker(&limits)?,
            runs: Runs::default(),
            every,
        })
    }

    /// After a frame of forecasts. Who is not woken finds it within 100 ms.
    pub(crate) fn wake_planners(&self) {
        if let Err(error) = self.planners.wake(WakeEvent::Frame) {
            tracing::debug!(%error, "planners were not woken");
        }
    }

    /// Writes a frame as the worker of this host would.
    pub(crate) fn pass_on(&mut self, accepted: &Accepted<'_>) -> Result<(), PassError> {
        let to = (&mut self.runs, self.every);
        match accepted.frame.service {
            Carried::FORECASTS => {
                pass_on(&mut self.forecasts, accepted, to)?;
                self.wake_planners();
                Ok(())
            }
            Carried::DIAGNOSTICS => pass_on(&mut self.diagnostics, accepted, to),
            Carried::BUDGETS => pass_on(&mut self.budgets, accepted, to),
            Carried::PLAN_STATES => pass_on(&mut self.plan_states, accepted, to),
            Carried::OUTLOOKS => pass_on(&mut self.outlooks, accepted, to),
            Carried::TICKS => pass_on(&mut self.ticks, accepted, to),
            // Other services are not requested, and therefore not accepted.
            _ => Ok(()),
        }
    }
}

/// Writes a frame as of a slower worker of this host. Ticks are consecutive if no frame is lost, so
/// that readers miss only lost ones. A worker's frame from the future is refused.
pub(crate) fn pass_on<C: Channel>(
    writer: &mut Writer<C>,
    accepted: &Accepted<'_>,
    (runs, every): (&mut Runs, u32),
) -> Result<(), PassError> {
    let (frame, offset_ns) = (&accepted.frame, accepted.offset_ns);
    let mut header = header_here::<C>(accepted, every)?;
    let place = header.place();
    let place = Place { run: runs.of(place.run), number: place.number / u64::from(every) };
    header.set_place(process_id(), place);
    let mut loan = writer.loan_to_fill(frame.len())?;
    *loan.header_mut() = header;
    for (to, mut element) in loan.payload_mut().iter_mut().zip(frame.elements()) {
        shift(&mut element, offset_ns);
        *to = element;
    }
    loan.send()?;
    Ok(())
}

/// The header of a frame with the times of this host, if only every n-th tick has a frame.
pub(crate) fn header_here<C: Channel>(
    accepted: &Accepted<'_>,
    every: u32,
) -> Result<C::Header, PassError> {
    let mut header: C::Header = accepted.frame.header();
    shift(&mut header, accepted.offset_ns);
    if let Some(period_ns) = header.period_ns() {
        // A frame counts as stale after two periods without one.
        *period_ns = period_ns.saturating_mul(u64::from(every));
    }
    if accepted.frame.service == Carried::FORECASTS {
        let sent_ns = header.sent_ns().unwrap_or_default();
        let ahead_ns = sent_ns.saturating_sub(clock::monotonic_ns());
        if ahead_ns > 0 {
            return Err(PassError::Future { ahead_ns });
        }
    }
    Ok(header)
}

/// Maps the worker's runs to increasing numbers. Planners take the greater number for the later
/// run, but a host that has booted restarts its clock.
#[derive(Debug, Default)]
pub(crate) struct Runs {
    /// The worker's own number, and its number on this host.
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
pub(crate) enum PassError {
    #[error("it was sent {ahead_ns} ns from now")]
    Future { ahead_ns: u64 },
    #[error(transparent)]
    Send(#[from] SendError),
}

#[cfg(test)]
mod tests {
    use bytemuck::{bytes_of, cast_slice};
    use joulebus_bus::{Domain, Limits, WorkerLock};
    use joulebus_testkit_channels::{Signal, SignalHeader, Signals};
    use joulebus_wire::SCHEMA_VERSION;

    use super::*;
    use crate::protocol::carried::RawFrame;

    /// A channel that this crate does not name.
    #[test]
    fn a_frame_of_any_channel_is_written_with_the_times_and_the_place_of_this_host() {
        let root = format!("/dev/shm/joulebus-test-{}-signals", std::process::id());
        let domain = Domain::new("test", root.as_ref(), "jbt_").unwrap();
        let limits = Limits::default();
        let bus = Bus::join(&domain, "link").unwrap();
        let _lock = WorkerLock::acquire(&domain).unwrap();
        let mut reader = bus.reader::<Signals>(&limits).unwrap();
        let mut writer = bus.writer::<Signals>(&limits).unwrap();
        let header = SignalHeader {
            schema: SCHEMA_VERSION,
            worker_epoch: 70,
            tick: 12,
            sent_ns: 5_000,
            sent_unix_ns: 9,
            ..SignalHeader::default()
        };
        let row = Signal { robot: 3, stamp_ns: 4_000, level_dbm: -61.5, ..Signal::default() };
        let mut bytes = bytes_of(&header).to_vec();
        bytes.extend_from_slice(cast_slice(&[row; 2]));
        let frame = RawFrame::new(Carried::SIGNALS, 2, 64, &bytes).unwrap();
        assert_eq!(frame.sent_ns(), 5_000);
        let accepted = Accepted { frame, offset_ns: -400, term: 0 };
        pass_on(&mut writer, &accepted, (&mut Runs::default(), 3)).unwrap();
        let found = reader.take_latest().unwrap().unwrap();
        let here = SignalHeader { pid: process_id(), tick: 4, sent_ns: 4_600, ..header };
        assert_eq!(*found.header(), here);
        let here = Signal { stamp_ns: 3_600, ..row };
        assert_eq!(found.payload(), [here; 2]);
    }

    #[test]
    fn a_worker_that_starts_again_is_a_later_run_also_after_its_host_has_booted() {
        let mut runs = Runs::default();
        let found = [70, 70, 90, 90, 5, 5, 6, 200].map(|run| runs.of(run));
        assert_eq!(found, [70, 70, 90, 90, 91, 91, 92, 200]);
    }
}
