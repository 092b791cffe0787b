//! The port of a channel that workers write, on a host where a link writes in their place.

use joulebus_bus::{Bus, Limits, SendError, Writer, clock, process_id};
use joulebus_wire::{Channel, FrameHeader as _, FrameOrder};

use crate::protocol::carried::Carried;
use crate::protocol::receiver::Accepted;
use crate::protocol::shift::shift;

/// The port of a channel.
pub(crate) struct OutputPort<C: Channel> {
    service: Carried,
    writer: Writer<C>,
}

/// An [`OutputPort`] of any channel.
pub(crate) trait AnyOutputPort {
    fn service(&self) -> Carried;

    /// True if a worker would write no frame, because nobody reads them.
    fn is_unread(&self) -> bool;

    /// Writes a frame as the worker of this host would.
    fn pass_on(&mut self, accepted: &Accepted<'_>, to: (&mut Runs, u32)) -> Result<(), PassError>;
}

impl<C: Channel> OutputPort<C> {
    pub(crate) fn open(service: Carried, bus: &Bus, limits: &Limits) -> anyhow::Result<Self> {
        Ok(Self { service, writer: bus.writer(limits)? })
    }
}

impl<C: Channel> AnyOutputPort for OutputPort<C> {
    fn service(&self) -> Carried {
        self.service
    }

    fn is_unread(&self) -> bool {
        C::FLOW.is_on_demand() && self.writer.readers() == 0
    }

    fn pass_on(&mut self, accepted: &Accepted<'_>, to: (&mut Runs, u32)) -> Result<(), PassError> {
        pass_on(&mut self.writer, accepted, to)
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
    let mut header: C::Header = frame.header();
    shift(&mut header, offset_ns);
    if let Some(period_ns) = header.period_ns() {
        // A frame counts as stale after two periods without one.
        *period_ns = period_ns.saturating_mul(u64::from(every));
    }
    if frame.service == Carried::FORECASTS {
        let sent_ns = header.sent_ns().unwrap_or_default();
        let ahead_ns = sent_ns.saturating_sub(clock::monotonic_ns());
        if ahead_ns > 0 {
            return Err(PassError::Future { ahead_ns });
        }
    }
    let order = header.order();
    let order = FrameOrder { run: runs.of(order.run), number: order.number / u64::from(every) };
    header.set_order(process_id(), order);
    let mut loan = writer.loan_to_fill(frame.len())?;
    *loan.header_mut() = header;
    for (to, mut element) in loan.payload_mut().iter_mut().zip(frame.elements()) {
        shift(&mut element, offset_ns);
        *to = element;
    }
    loan.send()?;
    Ok(())
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

/// Reason that a frame was not passed on.
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
    use joulebus_bus::{Domain, WorkerLock};
    use joulebus_testkit_fleets::channels::{Signal, SignalHeader, Signals};
    use joulebus_wire::SCHEMA_VERSION;

    use super::*;
    use crate::protocol::message::{Body, FleetId, Sender, Worker, read_of};
    use crate::protocol::offset::shifted;
    use crate::protocol::receiver::Receiver;
    use crate::protocol::selection::Selection;
    use crate::protocol::stream::{LocalFrame, Stream};

    /// From the sender's stream to readers on the receiver's host.
    #[test]
    fn frames_of_a_channel_that_is_declared_elsewhere_cross_a_link() {
        const FLEET: FleetId = FleetId(7);
        let signals = Carried::of::<Signals>(Carried::ALL.len() as u32 + 1);
        let channels = [Carried::ALL, &[signals]].concat();
        let root = format!("/dev/shm/joulebus-test-{}-signals", std::process::id());
        let domain = Domain::new("test", root.as_ref(), "jbt_").unwrap();
        let limits = Limits::default();
        let bus = Bus::join(&domain, "link").unwrap();
        let _lock = WorkerLock::acquire(&domain).unwrap();
        let mut reader = bus.reader::<Signals>(&limits).unwrap();
        let mut port = OutputPort::<Signals>::open(signals, &bus, &limits).unwrap();

        let header = SignalHeader {
            schema: SCHEMA_VERSION,
            worker_epoch: 70,
            tick: 12,
            sent_ns: 5_000,
            sent_unix_ns: 9,
            ..SignalHeader::default()
        };
        let rows = [2, 3].map(|robot| Signal { robot, stamp_ns: 4_000, ..Signal::default() });
        let own = Sender { fleet: FLEET, run: 1 };
        let mut receiver = Receiver::new(own, Selection::new(signals.bit(), 1, vec![(3, 9)]));
        let asked = receiver.request_if_due(900_000_000).unwrap();
        let Body::Request(request) = read_of(&channels, &asked, FLEET, 0).unwrap().body else {
            panic!("a request");
        };
        // The sender's clock is behind.
        let mut stream = Stream::new(FLEET, request, 6_000);
        let frame = LocalFrame {
            service: signals,
            source: 0,
            tick: 12,
            header: bytes_of(&header),
            elements: cast_slice(&rows),
        };
        let mut sent = Vec::new();
        assert!(stream.offer(frame, Worker::Alive.into(), 6_000, &mut sent));
        let message = read_of(&channels, &sent, FLEET, 64).unwrap();
        let accepted = receiver.take(&message, sent.len(), 900_000_000).unwrap();
        let here_ns = |ns| shifted(ns, accepted.offset_ns);
        assert!((899_000_000..900_000_000).contains(&here_ns(6_000)));

        port.pass_on(&accepted, (&mut Runs::default(), 3)).unwrap();
        let here = SignalHeader { pid: process_id(), tick: 4, sent_ns: here_ns(5_000), ..header };
        let row = Signal { stamp_ns: here_ns(4_000), ..rows[1] };
        let found = reader.take_latest().unwrap().unwrap();
        assert_eq!((*found.header(), found.payload()), (here, &[row][..]));
    }

    #[test]
    fn a_worker_that_starts_again_is_a_later_run_also_after_its_host_has_booted() {
        let mut runs = Runs::default();
        let found = [70, 70, 90, 90, 5, 5, 6, 200].map(|run| runs.of(run));
        assert_eq!(found, [70, 70, 90, 90, 91, 91, 92, 200]);
    }
}
