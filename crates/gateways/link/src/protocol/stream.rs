//! The sending side of a stream: frames for one receiver, at the rate that its link carries.

use std::collections::{BTreeMap, VecDeque};

use crate::protocol::carried::Carried;
use crate::protocol::message::{
    FleetId, HEADS_BYTES, LeaderStatus, Outgoing, Request, Sender, Status, write_frame,
};

/// Timeout of a receiver without requests. Its stream then ends.
pub(crate) const SILENCE_TIMEOUT_NS: u64 = 1_500_000_000;
/// Interval between statuses, whether or not frames are sent.
pub(crate) const STATUS_INTERVAL_NS: u64 = 100_000_000;
/// Maximum number of frames in flight beyond the bandwidth–delay product: one in transmission, one
/// behind it.
const MAX_EXTRA_IN_FLIGHT: u64 = 2;
/// Assumed interval between frames, for the number in flight on a path with a long delay.
const FRAME_INTERVAL_NS: u64 = 25_000_000;
/// Timeout of an acknowledgement. The frame then counts as lost.
const ACK_TIMEOUT_NS: u64 = 1_000_000_000;

/// Maximum number of remembered statuses in flight.
const MAX_STATUSES: usize = 64;
/// Number of lanes above which idle ones are dropped, because sources come and go.
const MAX_LANES: usize = 256;

/// A frame in memory of this host.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalFrame<'a> {
    pub(crate) service: Carried,
    /// The source of samples, because frames of one source do not replace those of another. 0 for
    /// other services.
    pub(crate) source: u64,
    /// The tick, for decimation. 0 for samples, which are all sent.
    pub(crate) tick: u64,
    pub(crate) header: &'a [u8],
    pub(crate) elements: &'a [u8],
}

/// The queue of one service and source: frames in flight and at most one that waits.
#[derive(Debug, Default)]
struct Lane {
    /// Number and time of each message in flight.
    in_flight: VecDeque<(u64, u64)>,
    /// The newest frame that could not be sent at once: its header and elements.
    waiting: Option<(Vec<u8>, Vec<u8>)>,
}

impl Lane {
    fn is_idle(&self) -> bool {
        self.waiting.is_none() && self.in_flight.is_empty()
    }
}

/// Totals of the frames sent to a receiver.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Sent {
    pub(crate) frames: u64,
    pub(crate) bytes: u64,
    /// Frames replaced by newer ones while the link was busy.
    pub(crate) dropped: u64,
    /// Frames not acknowledged within a second.
    pub(crate) unheard: u64,
}

/// The frames for one receiver, from its first request until it is silent.
#[derive(Debug, Default)]
pub(crate) struct Stream {
    /// Its run is the start of the stream. A stream after a silence has another run.
    sender: Sender,
    request: Request,
    /// When the newest request was received, monotonic ns.
    received_ns: u64,
    /// Number of the last message.
    number: u64,
    status_ns: u64,
    /// Number and time of each status in flight. Statuses are short, so their round trip measures
    /// the delay of the path.
    statuses: VecDeque<(u64, u64)>,
    /// Shortest time from a status to its acknowledgement, ns.
    shortest_ns: u64,
    lanes: BTreeMap<LaneKey, Lane>,
    sent: Sent,
}

/// A service and the source of samples.
type LaneKey = (Carried, u64);

impl Stream {
    /// Starts a stream for a receiver's first request.
    pub(crate) fn new(fleet: FleetId, request: Request, now_ns: u64) -> Self {
        Self {
            sender: Sender { fleet, run: now_ns },
            request,
            received_ns: now_ns,
            shortest_ns: ACK_TIMEOUT_NS,
            ..Self::default()
        }
    }

    /// Handles a further request, which arrived at `now_ns`. A late one does no harm: it
    /// acknowledges less, and the next one corrects that.
    pub(crate) fn request(&mut self, request: Request, now_ns: u64) {
        self.received_ns = now_ns;
        let (run, number) = request.acknowledged;
        // Ignore the acknowledgement of another run or of messages not yet sent.
        if run == self.sender.run && number <= self.number {
            self.acknowledge(number, now_ns);
        }
        self.lanes.retain(|(service, _), _| request.selection.wants(*service));
        self.request = request;
    }

    fn acknowledge(&mut self, number: u64, now_ns: u64) {
        for lane in self.lanes.values_mut() {
            let count = lane.in_flight.partition_point(|(sent, _)| *sent <= number);
            lane.in_flight.drain(..count);
        }
        // One request may acknowledge several statuses. Only the last one may have
        // arrived there just before.
        let count = self.statuses.partition_point(|(sent, _)| *sent <= number);
        if let Some((last, sent_ns)) = self.statuses.drain(..count).next_back()
            && last == number
        {
            let took_ns = now_ns.saturating_sub(sent_ns);
            self.shortest_ns = self.shortest_ns.min(took_ns);
        }
    }

    /// True if the receiver has been silent for too long.
    pub(crate) const fn is_over(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.received_ns) > SILENCE_TIMEOUT_NS
    }

    /// The receiver's newest request.
    pub(crate) const fn request_of(&self) -> &Request {
        &self.request
    }

    pub(crate) const fn sent(&self) -> Sent {
        self.sent
    }

    /// True if a frame waits to be sent.
    pub(crate) fn waits(&self) -> bool {
        self.lanes.values().any(|lane| lane.waiting.is_some())
    }

    /// Offers a new frame. Writes its message into `out` and returns true, or holds the frame, in
    /// place of an older one, until the receiver has acknowledged enough.
    pub(crate) fn offer(
        &mut self,
        frame: LocalFrame<'_>,
        leader: LeaderStatus,
        now_ns: u64,
        out: &mut Vec<u8>,
    ) -> bool {
        let selection = &self.request.selection;
        if !selection.wants(frame.service) || !selection.wants_tick(frame.tick) {
            return false;
        }
        let key = (frame.service, frame.source);
        if !self.lanes.contains_key(&key) && self.lanes.len() >= MAX_LANES {
            self.lanes.retain(|_, lane| !lane.is_idle());
        }
        let is_free = self.is_free(key, now_ns);
        let lane = self.lanes.entry(key).or_default();
        let older = lane.waiting.take();
        self.sent.dropped += u64::from(older.is_some());
        if is_free {
            self.write((key, frame.header, frame.elements), leader, now_ns, out);
            return true;
        }
        let (mut header, mut elements) = older.unwrap_or_default();
        header.clear();
        header.extend_from_slice(frame.header);
        elements.clear();
        elements.extend_from_slice(frame.elements);
        lane.waiting = Some((header, elements));
        false
    }

    /// Writes the next due message into `out`: a waiting frame or the status. Returns false if
    /// there is none. Call it until then.
    pub(crate) fn due(&mut self, leader: LeaderStatus, now_ns: u64, out: &mut Vec<u8>) -> bool {
        let waits = |(key, lane): (&LaneKey, &Lane)| lane.waiting.is_some().then_some(*key);
        let waiting: Vec<LaneKey> = self.lanes.iter().filter_map(waits).collect();
        for key in waiting {
            if self.is_free(key, now_ns)
                && let Some((header, elements)) =
                    self.lanes.get_mut(&key).and_then(|lane| lane.waiting.take())
            {
                self.write((key, &header, &elements), leader, now_ns, out);
                return true;
            }
        }
        if now_ns.saturating_sub(self.status_ns) < STATUS_INTERVAL_NS {
            return false;
        }
        self.write_status(leader, now_ns, out);
        true
    }

    /// Writes the status into `out`, whenever the last one was sent.
    pub(crate) fn write_status(&mut self, leader: LeaderStatus, now_ns: u64, out: &mut Vec<u8>) {
        self.number += 1;
        self.status_ns = now_ns;
        let status = self.status(leader, now_ns);
        write_frame(out, (self.sender, self.number), status, None);
        if self.statuses.len() == MAX_STATUSES {
            self.statuses.pop_front();
        }
        self.statuses.push_back((self.number, now_ns));
        self.sent.bytes += out.len() as u64;
    }

    /// True if a further frame of the lane may be in flight. A lost frame stops counting after a
    /// while.
    fn is_free(&mut self, key: LaneKey, now_ns: u64) -> bool {
        let Some(lane) = self.lanes.get_mut(&key) else {
            return true;
        };
        let lost_after_ns = ACK_TIMEOUT_NS.max(self.shortest_ns.saturating_mul(4));
        let is_lost = |(_, sent_ns): &(u64, u64)| now_ns.saturating_sub(*sent_ns) > lost_after_ns;
        while lane.in_flight.front().is_some_and(is_lost) {
            lane.in_flight.pop_front();
            self.sent.unheard += 1;
        }
        let on_the_way = self.shortest_ns / FRAME_INTERVAL_NS;
        (lane.in_flight.len() as u64) < MAX_EXTRA_IN_FLIGHT + on_the_way
    }

    fn write(
        &mut self,
        (key, header, elements): (LaneKey, &[u8], &[u8]),
        leader: LeaderStatus,
        now_ns: u64,
        out: &mut Vec<u8>,
    ) {
        self.number += 1;
        self.status_ns = now_ns;
        let status = self.status(leader, now_ns);
        out.clear();
        // Reserve once, even if only some robots are selected.
        out.reserve(HEADS_BYTES + header.len() + elements.len());
        let mut runs = self.request.selection.runs(key.0, elements);
        let frame = Some(Outgoing { service: key.0, header, elements: &mut runs });
        write_frame(out, (self.sender, self.number), status, frame);
        let lane = self.lanes.entry(key).or_default();
        lane.in_flight.push_back((self.number, now_ns));
        self.sent.frames += 1;
        self.sent.bytes += out.len() as u64;
    }

    const fn status(&self, leader: LeaderStatus, now_ns: u64) -> Status {
        Status {
            asked_ns: self.request.asked_ns,
            received_ns: self.received_ns,
            sent_ns: now_ns,
            dropped: self.sent.dropped,
            leader,
        }
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{SCHEMA_VERSION, SampleHeader};

    use super::*;
    use crate::protocol::message::Worker;
    use crate::protocol::selection::Selection;

    #[test]
    fn lanes_of_sources_that_left_are_dropped_even_if_more_than_allowed_were_busy_at_once() {
        let request = |run, number| Request {
            acknowledged: (run, number),
            asked_ns: 1,
            selection: Selection::new(u32::MAX, 1, Vec::new()),
        };
        let (fleet, run) = (FleetId(1), 5);
        let mut stream = Stream::new(fleet, request(0, 0), run);
        let header = SampleHeader { schema: SCHEMA_VERSION, ..SampleHeader::default() };
        let mut out = Vec::new();
        let mut offer = |stream: &mut Stream, source: u64| {
            let frame = LocalFrame {
                service: Carried::SAMPLES,
                source,
                tick: 0,
                header: bytemuck::bytes_of(&header),
                elements: &[],
            };
            assert!(stream.offer(frame, Worker::Alive.into(), run + source, &mut out));
        };
        let busy = MAX_LANES as u64 + 50;
        (0..busy).for_each(|source| offer(&mut stream, source));
        assert_eq!(stream.lanes.len() as u64, busy, "a busy source is kept");
        stream.request(request(run, busy), run + busy);
        for source in busy..3 * busy {
            offer(&mut stream, source);
            stream.request(request(run, source + 1), run + source);
        }
        assert!(stream.lanes.len() <= MAX_LANES, "{}", stream.lanes.len());
    }
}
