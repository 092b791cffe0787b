//! The port of a channel that workers write, on a host where a link writes in their place.

use joulebus_bus::{Bus, Limits, SendError, Writer, clock, process_id};
use joulebus_wire::{Channel, FrameHeader as _, FrameOrder};

use crate::protocol::carried::Carried;
use crate::protocol::merge::{Merge, Merged, Origin};
use crate::protocol::receiver::Accepted;
use crate::protocol::shards::Shards;
use crate::protocol::shift::shift;

/// Periods after which a worker's frame is stale.
const STALE_PERIODS: u64 = 2;

/// The port of a channel, and the newest frames of the shards.
pub(crate) struct OutputPort<C: Merged> {
    service: Carried,
    writer: Writer<C>,
    merge: Merge<C>,
    /// Shards that are left out because they do not agree with the others, as last logged.
    differ: Vec<bool>,
}

/// An [`OutputPort`] of any channel.
pub(crate) trait AnyOutputPort {
    fn service(&self) -> Carried;

    /// True if a worker would write no frame, because nobody reads them.
    fn is_unread(&self) -> bool;

    /// Writes a frame as the worker of this host would.
    fn pass_on(&mut self, accepted: &Accepted<'_>, to: (&mut Runs, u32)) -> Result<(), PassError>;

    /// Takes a shard's frame: the rows of the shard's robots, with the times of this host.
    fn put(
        &mut self,
        accepted: &Accepted<'_>,
        every: u32,
        of: (&Shards, usize),
    ) -> Result<(), PassError>;

    /// Writes the merged frame, if it is due. Returns whether it was.
    fn write(&mut self, round: &MergeRound<'_>) -> Result<bool, SendError>;
}

/// A round in which merged frames are written.
pub(crate) struct MergeRound<'a> {
    pub(crate) shards: &'a Shards,
    /// The shards with a living leader.
    pub(crate) has_worker: &'a [bool],
    /// The shards whose forecasts are fresh.
    pub(crate) is_live: &'a [bool],
    pub(crate) now_ns: u64,
    pub(crate) period_ns: u64,
    pub(crate) every: u32,
    /// Maximum number of rows of a frame.
    pub(crate) capacity: usize,
    pub(crate) own: Origin,
}

impl<C: Merged> OutputPort<C> {
    pub(crate) fn open(
        service: Carried,
        (bus, limits): (&Bus, &Limits),
        shards: usize,
    ) -> anyhow::Result<Self> {
        let (writer, merge) = (bus.writer(limits)?, Merge::new(shards));
        Ok(Self { service, writer, merge, differ: vec![false; shards] })
    }

    /// True if the shard's newest frame is fresh.
    pub(crate) fn is_fresh(&self, shard: usize, now_ns: u64) -> bool {
        self.merge.header(shard).is_some_and(|header| {
            let mut header = *header;
            let period_ns = header.period_ns().map_or(0, |period_ns| *period_ns);
            let sent_ns = header.sent_ns().unwrap_or_default();
            now_ns.saturating_sub(sent_ns) <= period_ns.saturating_mul(STALE_PERIODS)
        })
    }

    /// The live shards. Where parts must agree: those with a fresh part that agrees with the first.
    fn agree(&mut self, round: &MergeRound<'_>) -> Vec<bool> {
        let mut is_live = round.is_live.to_vec();
        let Some(agree) = C::AGREE else {
            return is_live;
        };
        for (shard, is_live) in is_live.iter_mut().enumerate() {
            *is_live &= self.is_fresh(shard, round.now_ns);
        }
        let first = is_live.iter().position(|is_live| *is_live);
        let first = first.and_then(|shard| self.merge.header(shard));
        for (shard, differed) in self.differ.iter_mut().enumerate() {
            let with = self.merge.header(shard).zip(first);
            let differs = is_live[shard] && with.is_some_and(|(one, first)| !agree(one, first));
            if differs && !*differed {
                tracing::warn!(
                    "shard {name} computes with other settings or models: nobody plans for its \
                        robots. Use one config",
                    name = round.shards.all()[shard].name
                );
            }
            is_live[shard] &= !differs;
            *differed = differs;
        }
        is_live
    }
}

impl<C: Merged> AnyOutputPort for OutputPort<C> {
    fn service(&self) -> Carried {
        self.service
    }

    fn is_unread(&self) -> bool {
        C::FLOW.is_on_demand() && self.writer.readers() == 0
    }

    fn pass_on(&mut self, accepted: &Accepted<'_>, to: (&mut Runs, u32)) -> Result<(), PassError> {
        pass_on(&mut self.writer, accepted, to)
    }

    fn put(
        &mut self,
        accepted: &Accepted<'_>,
        every: u32,
        (shards, shard): (&Shards, usize),
    ) -> Result<(), PassError> {
        let header = header_here::<C>(accepted, every)?;
        let is_own = |row: &C::Row| C::robot(row).and_then(|id| shards.of_robot(id)) == Some(shard);
        let rows = accepted.frame.elements::<C::Row>().filter(is_own).map(|mut row| {
            shift(&mut row, accepted.offset_ns);
            row
        });
        self.merge.put(shard, header, rows, clock::monotonic_ns());
        Ok(())
    }

    fn write(&mut self, round: &MergeRound<'_>) -> Result<bool, SendError> {
        let MergeRound { has_worker, is_live, now_ns, .. } = *round;
        if !self.merge.is_due((has_worker, is_live), (now_ns, round.period_ns, round.every)) {
            return Ok(false);
        }
        let is_live = self.agree(round);
        let mut loan = self.writer.loan_to_fill(self.merge.len().min(round.capacity))?;
        let mut to = loan.payload_mut().iter_mut();
        let header = self.merge.write(&is_live, round.own, now_ns, |row| {
            // If the shards have more robots than this host has room for, the last ones are
            // dropped.
            if let Some(to) = to.next() {
                *to = row;
            }
        });
        let Some(header) = header else {
            return Ok(false);
        };
        *loan.header_mut() = header;
        loan.send()?;
        Ok(true)
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

/// The header of a frame with the times of this host, if only every n-th tick has a frame.
fn header_here<C: Channel>(accepted: &Accepted<'_>, every: u32) -> Result<C::Header, PassError> {
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
    use joulebus_testkit_channels::{Signal, SignalHeader, Signals};
    use joulebus_wire::SCHEMA_VERSION;

    use super::*;
    use crate::protocol::message::{Body, FleetId, Sender, Worker, read_of};
    use crate::protocol::offset::shifted;
    use crate::protocol::receiver::Receiver;
    use crate::protocol::selection::Selection;
    use crate::protocol::shards::Shard;
    use crate::protocol::stream::{LocalFrame, Stream};

    impl Merged for Signals {
        fn merged(parts: &[SignalHeader], _: &[SignalHeader]) -> SignalHeader {
            parts[0]
        }

        fn silence(_: &mut Signal) {}
    }

    /// From the sender's stream to readers on the receiver's host, alone and as one of two shards.
    #[test]
    fn frames_of_a_channel_that_is_declared_elsewhere_cross_a_link() {
        const FLEET: FleetId = FleetId { name: 7, shards: 0 };
        let signals = Carried::of::<Signals>(Carried::ALL.len() as u32 + 1);
        let channels = [Carried::ALL, &[signals]].concat();
        let root = format!("/dev/shm/joulebus-test-{}-signals", std::process::id());
        let domain = Domain::new("test", root.as_ref(), "jbt_").unwrap();
        let limits = Limits::default();
        let bus = Bus::join(&domain, "link").unwrap();
        let _lock = WorkerLock::acquire(&domain).unwrap();
        let mut reader = bus.reader::<Signals>(&limits).unwrap();
        let mut port = OutputPort::<Signals>::open(signals, (&bus, &limits), 2).unwrap();

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

        let shards = [(0, 4), (5, 9)].map(|robots| Shard {
            name: format!("from {}", robots.0),
            workers: Vec::new(),
            robots: vec![robots],
        });
        let shards = Shards::new(shards.to_vec());
        // The other shard may not send rows of this robot.
        for shard in [0, 1] {
            port.put(&accepted, 3, (&shards, shard)).unwrap();
        }
        let round = MergeRound {
            shards: &shards,
            has_worker: &[true; 2],
            is_live: &[true; 2],
            now_ns: clock::monotonic_ns(),
            period_ns: 33_000_000,
            every: 3,
            capacity: 64,
            own: Origin { pid: 8, order: FrameOrder { run: 5, number: 6 } },
        };
        assert!(port.write(&round).unwrap());
        let here = SignalHeader { pid: 8, worker_epoch: 5, tick: 6, ..here };
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
