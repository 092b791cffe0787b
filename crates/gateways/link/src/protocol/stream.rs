//! The sending side of a stream: frames for one receiver, at the rate that its link carries.

use std::collections::{BTreeMap, VecDeque};

use crate::protocol::carried::Carried;
use crate::protocol::message::{
    FleetId, HEADS_BYTES, Outgoing, Request, Sender, Status, Voice, write_frame,
};

/// Timeout of a receiver without requests. Its stream then ends.
pub(crate) const SILENT_AFTER_NS: u64 = 1_500_000_000;
/// Interval between statuses, whether or not frames are sent.
pub(crate) const STATUS_EVERY_NS: u64 = 100_000_000;
/// Maximum number of frames in flight beyond the bandwidth–delay product: one in transmission, one
/// behind it.
const MOST_UNHEARD: u64 = 2;
/// Assumed interval between frames, for the number in flight on a path with a long delay.
const FRAME_EVERY_NS: u64 = 25_000_000;
/// Timeout of an acknowledgement. The frame then counts as lost.
const LOST_AFTER_NS: u64 = 1_000_000_000;

/// Maximum number of remembered statuses in flight.
const MOST_TOLD: usize = 64;
/// Number of lanes above which idle ones are dropped, because sources come and go.
const MOST_LANES: usize = 256;

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
    unheard: VecDeque<(u64, u64)>,
    /// The newest frame that could not be sent at once: its header and elements.
    waiting: Option<(Vec<u8>, Vec<u8>)>,
}

impl Lane {
    fn is_idle(&self) -> bool {
        self.waiting.is_none() && self.unheard.is_empty()
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
#[derive(Debug)]
pub(crate) struct Stream {
    /// Its run is the start of the stream. A stream after a silence has another run.
    sender: Sender,
    request: Request,
    /// When the newest request was received, monotonic ns.
    heard_ns: u64,
    /// Number of the last message.
    number: u64,
    told_ns: u64,
    /// Number and time of each status in flight. Statuses are short, so their round trip measures
    /// the delay of the path.
    told: VecDeque<(u64, u64)>,
    /// Shortest time from a status to its acknowledgement, ns.
    shortest_ns: u64,
    lanes: BTreeMap<Place, Lane>,
    /// [`Status::realtime_ns`].
    realtime_ns: u64,
    sent: Sent,
}

/// A service and the source of samples.
type Place = (Carried, u64);

impl Stream {
    /// Starts a stream for a receiver's first request.
    pub(crate) fn new(fleet: FleetId, request: Request, now_ns: u64) -> Self {
        Self {
            sender: Sender { fleet, run: now_ns },
            request,
            heard_ns: now_ns,
            number: 0,
            told_ns: 0,
            told: VecDeque::new(),
            shortest_ns: LOST_AFTER_NS,
            lanes: BTreeMap::new(),
            realtime_ns: 0,
            sent: Sent::default(),
        }
    }

    /// Handles a further request, which arrived at `now_ns`. A late one does no harm: it
    /// acknowledges less, and the next one corrects that.
    pub(crate) fn request(&mut self, request: Request, now_ns: u64) {
        self.heard_ns = now_ns;
        let (run, number) = request.heard;
        // Ignore the acknowledgement of another run or of messages not yet sent.
        if run == self.sender.run && number <= self.number {
            self.heard(number, now_ns);
        }
        self.lanes
            .retain(|(service, _), _| request.selection.wants(*service));
        self.request = request;
    }

    fn heard(&mut self, number: u64, now_ns: u64) {
        for lane in self.lanes.values_mut() {
            let heard = lane.unheard.partition_point(|(sent, _)| *sent <= number);
            lane.unheard.drain(..heard);
        }
        // One request may acknowledge several statuses. Only the last one may have
        // arrived there just before.
        let heard = self.told.partition_point(|(sent, _)| *sent <= number);
        if let Some((last, sent_ns)) = self.told.drain(..heard).next_back()
            && last == number
        {
            let took_ns = now_ns.saturating_sub(sent_ns);
            self.shortest_ns = self.shortest_ns.min(took_ns);
        }
    }

    /// Sets this host's realtime clock for further messages: [`Status::realtime_ns`].
    pub(crate) const fn tells(&mut self, realtime_ns: Option<u64>) {
        self.realtime_ns = match realtime_ns {
            Some(realtime_ns) => realtime_ns,
            None => 0,
        };
    }

    /// Whether the receiver has been silent for too long.
    pub(crate) const fn is_over(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.heard_ns) > SILENT_AFTER_NS
    }

    /// The receiver's newest request.
    pub(crate) const fn request_of(&self) -> &Request {
        &self.request
    }

    pub(crate) const fn sent(&self) -> Sent {
        self.sent
    }

    /// Whether a frame waits to be sent.
    pub(crate) fn waits(&self) -> bool {
        self.lanes.values().any(|lane| lane.waiting.is_some())
    }

    /// Offers a new frame. Writes its message into `out` and returns true, or holds the frame, in
    /// place of an older one, until the receiver has acknowledged enough.
    pub(crate) fn offer(
        &mut self,
        frame: LocalFrame<'_>,
        voice: Voice,
        now_ns: u64,
        out: &mut Vec<u8>,
    ) -> bool {
        let selection = &self.request.selection;
        if !selection.wants(frame.service) || !selection.wants_tick(frame.tick) {
            return false;
        }
        let place = (frame.service, frame.source);
        if !self.lanes.contains_key(&place) && self.lanes.len() == MOST_LANES {
            self.lanes.retain(|_, lane| !lane.is_idle());
        }
        let is_free = self.is_free(place, now_ns);
        let lane = self.lanes.entry(place).or_default();
        let older = lane.waiting.take();
        self.sent.dropped += u64::from(older.is_some());
        if is_free {
            self.write((place, frame.header, frame.elements), voice, now_ns, out);
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
    pub(crate) fn due(&mut self, voice: Voice, now_ns: u64, out: &mut Vec<u8>) -> bool {
        let waits = |(place, lane): (&Place, &Lane)| lane.waiting.is_some().then_some(*place);
        let waiting: Vec<Place> = self.lanes.iter().filter_map(waits).collect();
        for place in waiting {
            if self.is_free(place, now_ns)
                && let Some((header, elements)) = self
                    .lanes
                    .get_mut(&place)
                    .and_then(|lane| lane.waiting.take())
            {
                self.write((place, &header, &elements), voice, now_ns, out);
                return true;
            }
        }
        if now_ns.saturating_sub(self.told_ns) < STATUS_EVERY_NS {
            return false;
        }
        self.tell(voice, now_ns, out);
        true
    }

    /// Writes the status into `out`, whenever the last one was sent.
    pub(crate) fn tell(&mut self, voice: Voice, now_ns: u64, out: &mut Vec<u8>) {
        self.number += 1;
        self.told_ns = now_ns;
        let status = self.status(voice, now_ns);
        write_frame(out, (self.sender, self.number), status, None);
        if self.told.len() == MOST_TOLD {
            self.told.pop_front();
        }
        self.told.push_back((self.number, now_ns));
        self.sent.bytes += out.len() as u64;
    }

    /// Whether a further frame of the lane may be in flight. A lost frame stops counting after a
    /// while.
    fn is_free(&mut self, place: Place, now_ns: u64) -> bool {
        let Some(lane) = self.lanes.get_mut(&place) else {
            return true;
        };
        let lost_after_ns = LOST_AFTER_NS.max(self.shortest_ns.saturating_mul(4));
        let is_lost = |(_, sent_ns): &(u64, u64)| now_ns.saturating_sub(*sent_ns) > lost_after_ns;
        while lane.unheard.front().is_some_and(is_lost) {
            lane.unheard.pop_front();
            self.sent.unheard += 1;
        }
        let on_the_way = self.shortest_ns / FRAME_EVERY_NS;
        (lane.unheard.len() as u64) < MOST_UNHEARD + on_the_way
    }

    fn write(
        &mut self,
        (place, header, elements): (Place, &[u8], &[u8]),
        voice: Voice,
        now_ns: u64,
        out: &mut Vec<u8>,
    ) {
        self.number += 1;
        self.told_ns = now_ns;
        let status = self.status(voice, now_ns);
        out.clear();
        // Reserve once, even if only some robots are selected.
        out.reserve(HEADS_BYTES + header.len() + elements.len());
        let mut runs = self.request.selection.runs(place.0, elements);
        let frame = Some(Outgoing {
            service: place.0,
            header,
            elements: &mut runs,
        });
        write_frame(out, (self.sender, self.number), status, frame);
        let lane = self.lanes.entry(place).or_default();
        lane.unheard.push_back((self.number, now_ns));
        self.sent.frames += 1;
        self.sent.bytes += out.len() as u64;
    }

    const fn status(&self, voice: Voice, now_ns: u64) -> Status {
        Status {
            asked_ns: self.request.asked_ns,
            heard_ns: self.heard_ns,
            sent_ns: now_ns,
            dropped: self.sent.dropped,
            voice,
            realtime_ns: self.realtime_ns,
        }
    }
}
