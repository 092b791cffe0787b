//! The sending side of a stream: frames for one receiver, as many as it takes.

use std::collections::{BTreeMap, VecDeque};

use crate::protocol::carried::Carried;
use crate::protocol::message::{
    FleetId, HEADS_BYTES, Outgoing, Request, Sender, Status, Voice, write_frame,
};

/// A receiver that has not asked for so long is no longer sent anything.
pub(crate) const SILENT_AFTER_NS: u64 = 1_500_000_000;
/// How often a receiver is told the status, frames or not.
pub(crate) const STATUS_EVERY_NS: u64 = 100_000_000;
/// Frames of a service that may be on their way beside those that the way itself holds: one that is being sent, one
/// behind it.
const MOST_UNHEARD: u64 = 2;
/// Frames are sent about that often; only for the number that a long way holds.
const FRAME_EVERY_NS: u64 = 25_000_000;
/// A frame that has not been acknowledged for so long is lost.
const LOST_AFTER_NS: u64 = 1_000_000_000;

/// Statuses on their way that are remembered.
const MOST_TOLD: usize = 64;
/// Lanes before those without a frame are forgotten: sources come and go.
const MOST_LANES: usize = 256;

/// A frame in memory of this host.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalFrame<'a> {
    pub(crate) service: Carried,
    /// The source of samples, since the frames of one do not replace those of another; 0 for all else.
    pub(crate) source: u64,
    /// The tick, by which every n-th is chosen; 0 for samples, of which all are sent.
    pub(crate) tick: u64,
    pub(crate) header: &'a [u8],
    pub(crate) elements: &'a [u8],
}

/// Frames of a service, and of one source, that wait, and those that are on their way.
#[derive(Debug, Default)]
struct Lane {
    /// Number and time of each message on its way.
    unheard: VecDeque<(u64, u64)>,
    /// The newest frame that could not be sent at once: its header and its elements.
    waiting: Option<(Vec<u8>, Vec<u8>)>,
}

impl Lane {
    fn is_idle(&self) -> bool {
        self.waiting.is_none() && self.unheard.is_empty()
    }
}

/// What has been sent to a receiver.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Sent {
    pub(crate) frames: u64,
    pub(crate) bytes: u64,
    /// Frames that were replaced by newer ones before the link was free.
    pub(crate) dropped: u64,
    /// Frames that were not acknowledged within a second.
    pub(crate) unheard: u64,
}

/// The frames for one receiver, from its first request until it is silent.
#[derive(Debug)]
pub(crate) struct Stream {
    /// Its run is when the stream began: after a silence it is another.
    sender: Sender,
    request: Request,
    /// When the newest request was taken, monotonic ns.
    heard_ns: u64,
    /// Number of the last message.
    number: u64,
    told_ns: u64,
    /// Number and time of each status on its way: short, so what it takes is the way itself.
    told: VecDeque<(u64, u64)>,
    /// Shortest time from sending a status to its acknowledgement, ns.
    shortest_ns: u64,
    lanes: BTreeMap<Place, Lane>,
    /// [`Status::realtime_ns`].
    realtime_ns: u64,
    sent: Sent,
}

/// A service and the source of samples.
type Place = (Carried, u64);

impl Stream {
    /// The stream that a request begins.
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

    /// Takes a further request of the receiver, which arrived at `now_ns`. One that is late does no harm: it acknowledges
    /// less, and the next one is right again.
    pub(crate) fn request(&mut self, request: Request, now_ns: u64) {
        self.heard_ns = now_ns;
        let (run, number) = request.heard;
        // Numbers of another run, or not yet sent, acknowledge nothing.
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
        // Of those that one request acknowledges, only the last may have arrived just before it.
        let heard = self.told.partition_point(|(sent, _)| *sent <= number);
        if let Some((last, sent_ns)) = self.told.drain(..heard).next_back()
            && last == number
        {
            let took_ns = now_ns.saturating_sub(sent_ns);
            self.shortest_ns = self.shortest_ns.min(took_ns);
        }
    }

    /// What messages say of this host's realtime clock from now on: [`Status::realtime_ns`].
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

    /// The receiver's selection.
    pub(crate) const fn request_of(&self) -> &Request {
        &self.request
    }

    pub(crate) const fn sent(&self) -> Sent {
        self.sent
    }

    /// Whether a frame waits.
    pub(crate) fn waits(&self) -> bool {
        self.lanes.values().any(|lane| lane.waiting.is_some())
    }

    /// A new frame: writes its message into `out` and returns true, or keeps it, in place of an older one, until
    /// the receiver has acknowledged enough.
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

    /// Writes what is due now into `out`, a frame that waited or the status; false if nothing is. Call it until it
    /// returns false.
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

    /// Writes the status into `out`, whenever it was told last.
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

    /// Whether a further frame of the lane may be on its way. One that is lost does not count for ever.
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
        // One allocation, also where only some robots are wanted.
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
