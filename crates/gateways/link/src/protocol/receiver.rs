//! The receiving side of a stream: which messages have arrived, from which run, which are missing,
//! and by which clock.

use crate::protocol::carried::{Carried, RawFrame};
use crate::protocol::message::{
    Body, LeaderStatus, Message, Request, Sender, Status, Worker, write_request,
};
use crate::protocol::offset::{Offset, Trip, shifted};
use crate::protocol::selection::Selection;
use crate::protocol::stream::SILENCE_TIMEOUT_NS;

/// Interval between requests while nothing arrives.
pub(crate) const REQUEST_INTERVAL_NS: u64 = 100_000_000;
/// Maximum delay of an acknowledgement for a frame that a later one replaces. Usually the next
/// frame of its service acknowledges it, because the sender has room for two. The delay exceeds the
/// period of most fleets, and is shorter than the time that a frame takes on a busy path.
const MAX_ACK_DELAY_NS: u64 = 40_000_000;
/// Timeout of a request. Older ones cannot be the request that an answer names.
const REQUEST_TIMEOUT_NS: u64 = 10_000_000_000;

/// Time without messages, three statuses, after which another run may replace a run.
const QUIET_TIMEOUT_NS: u64 = 300_000_000;
/// Maximum number of missing messages between two: more than a link sends within the silence
/// timeout.
const MAX_LOST: u64 = 100_000;

/// Totals of received messages.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Received {
    pub(crate) frames: u64,
    pub(crate) bytes: u64,
    /// Messages that were sent and did not arrive.
    pub(crate) lost: u64,
    /// Messages that arrived again, or after a later one.
    pub(crate) repeated: u64,
    /// Messages of another run while the present one was sending: from a link that restarted at
    /// once, a second link of the same name, or a stranger.
    pub(crate) other_runs: u64,
    /// Number of times that a run continued after a message of another run: not a restarted link.
    pub(crate) contested: u64,
    /// Messages whose time, or whose frame's time, was in the future.
    pub(crate) future: u64,
    /// Frames that the sender dropped because the link was slower than the fleet, in its present
    /// run.
    pub(crate) dropped: u64,
    /// Number of the sender's runs.
    pub(crate) runs: u64,
    /// Number of times that nothing arrived for 1.5 s.
    pub(crate) silences: u64,
}

/// A frame to be passed on.
#[derive(Debug)]
pub(crate) struct Accepted<'a> {
    pub(crate) frame: RawFrame<'a>,
    /// Offset to add to its times, ns.
    pub(crate) offset_ns: i128,
    /// [`LeaderStatus::term`] of the worker that wrote it.
    pub(crate) term: u64,
}

/// Reason that a message was not used. Counted in [`Received`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unused {
    /// The message has only the status, no frame.
    Status,
    /// The message arrived before, or a later one did.
    Repeated,
    /// The message belongs to another run than the present one.
    OtherRun,
    /// Its time is in the future.
    Future,
    /// The sender's clock offset is not known yet.
    NoClock,
    /// The frame was not requested.
    NotAsked,
}

/// A message's position in its stream.
#[derive(Debug, Clone, Copy)]
struct Position {
    run: u64,
    /// When it was sent, monotonic ns of the sender.
    sent_ns: u64,
    number: u64,
}

/// The stream from one sender.
#[derive(Debug, Default)]
pub(crate) struct Receiver {
    own: Sender,
    selection: Selection,
    /// Number of the last request.
    asked: u64,
    asked_ns: u64,
    /// Position of the newest message.
    newest: Option<Position>,
    received_ns: u64,
    /// The next request is due at once.
    owes: bool,
    /// Services with one frame since the last request, and when the first of these frames arrived.
    unanswered: u32,
    unanswered_ns: u64,
    is_silent: bool,
    /// Another run has sent since the present one last did.
    has_rival: bool,
    leader: LeaderStatus,
    offset: Offset,
    received: Received,
}

impl Receiver {
    pub(crate) fn new(own: Sender, selection: Selection) -> Self {
        Self { own, selection, is_silent: true, ..Self::default() }
    }

    /// Changes the requested services from now on.
    pub(crate) fn select(&mut self, services: u32) {
        self.owes |= self.selection.services != services;
        self.selection.services = services;
    }

    /// Handles a message of `bytes` that arrived at `now_ns`.
    pub(crate) fn take<'a>(
        &mut self,
        message: &Message<'a>,
        bytes: usize,
        now_ns: u64,
    ) -> Result<Accepted<'a>, Unused> {
        let Body::Frame(status, frame) = &message.body else {
            return Err(Unused::NotAsked);
        };
        let position =
            Position { run: message.run, sent_ns: status.sent_ns, number: message.number };
        self.account(position, status, now_ns)?;
        self.received_ns = now_ns;
        self.is_silent = false;
        self.note(*frame, now_ns);
        self.received.bytes += bytes as u64;
        self.received.dropped = status.dropped;
        self.leader = status.leader;
        self.measure(status, now_ns);
        let frame = (*frame).ok_or(Unused::Status)?;
        if !self.selection.wants(frame.service) {
            return Err(Unused::NotAsked);
        }
        // A frame sent later than its message would look fresh for ever.
        if frame.sent_ns() > status.sent_ns {
            self.received.future += 1;
            return Err(Unused::Future);
        }
        let offset_ns = self.offset.used_ns().ok_or(Unused::NoClock)?;
        self.received.frames += 1;
        Ok(Accepted { frame, offset_ns, term: status.leader.term })
    }

    /// Notes what the next request has to acknowledge.
    ///
    /// It is due at once for a status, which measures the path, and for a frame that no later one
    /// replaces, because several of those arrive together after a delay of the sender. It is also
    /// due at once before the clock offset is known. For other services the sender has room for one
    /// more frame.
    fn note(&mut self, frame: Option<RawFrame<'_>>, now_ns: u64) {
        let service = frame.map(|frame| frame.service);
        let bit = service.filter(|service| service.is_replaced()).map_or(0, Carried::bit);
        let is_second = self.unanswered & bit != 0;
        self.owes |= bit == 0 || is_second || !self.offset.is_measured();
        if self.unanswered == 0 {
            self.unanswered_ns = now_ns;
        }
        self.unanswered |= bit;
    }

    /// Accounts for a message's position.
    ///
    /// Messages are ordered by their time, because one with a false number could otherwise hide all
    /// real ones, and none is from the future. A run that sends is not replaced by another. A
    /// silent run is, by a later or an earlier one, because a host's clock restarts when it boots.
    fn account(&mut self, position: Position, status: &Status, now_ns: u64) -> Result<(), Unused> {
        match self.newest {
            Some(last) if last.run == position.run && !self.is_overdue(now_ns) => {
                if self.is_future(status.sent_ns, now_ns) && !self.has_stepped(status, now_ns) {
                    self.received.future += 1;
                    return Err(Unused::Future);
                }
                if (position.sent_ns, position.number) <= (last.sent_ns, last.number) {
                    self.received.repeated += 1;
                    return Err(Unused::Repeated);
                }
                self.count_missing(position.number.saturating_sub(last.number));
                self.received.contested += u64::from(self.has_rival);
            }
            Some(last) if last.run != position.run && !self.is_quiet(now_ns) => {
                self.received.other_runs += 1;
                self.has_rival = true;
                return Err(Unused::OtherRun);
            }
            _ => {
                // Messages sent before the first one that arrived are not missing: the path was
                // being set up.
                self.offset.forget();
                self.received.runs += 1;
            }
        }
        self.has_rival = false;
        self.newest = Some(position);
        Ok(())
    }

    /// Counts the missing messages before the `numbers`-th message after the last one. A false
    /// number counts nothing.
    const fn count_missing(&mut self, numbers: u64) {
        if numbers <= MAX_LOST {
            self.received.lost += numbers.saturating_sub(1);
        }
        // Until the next request, the sender counts them as in flight.
        self.owes |= numbers > 1;
    }

    fn is_future(&self, sent_ns: u64, now_ns: u64) -> bool {
        let offset_ns = self.offset.used_ns();
        offset_ns.is_some_and(|offset_ns| shifted(sent_ns, offset_ns) > now_ns)
    }

    /// True if a clock has stepped, so that a message only seems to be from the future: this host
    /// was a paused virtual machine, for instance. Its round trip shows that, and is measured. A
    /// damaged message has no possible round trip.
    fn has_stepped(&mut self, status: &Status, now_ns: u64) -> bool {
        if !self.trip(status, now_ns).is_some_and(|trip| trip.is_possible()) {
            return false;
        }
        self.measure(status, now_ns);
        !self.is_future(status.sent_ns, now_ns)
    }

    fn measure(&mut self, status: &Status, now_ns: u64) {
        if let Some(trip) = self.trip(status, now_ns) {
            self.offset.note(trip);
        }
    }

    /// The round trip that ends with this message. `None` if the message answers no request that
    /// this link has sent.
    fn trip(&self, status: &Status, now_ns: u64) -> Option<Trip> {
        let within_ns = now_ns.checked_sub(status.asked_ns)?;
        let is_of_request = status.asked_ns > 0
            && status.asked_ns <= self.asked_ns
            && within_ns <= REQUEST_TIMEOUT_NS;
        is_of_request.then_some(Trip {
            asked_ns: status.asked_ns,
            received_ns: status.received_ns,
            sent_ns: status.sent_ns,
            now_ns,
        })
    }

    /// Returns the request to send now, if one is due.
    pub(crate) fn request_if_due(&mut self, now_ns: u64) -> Option<Vec<u8>> {
        if !self.owes && now_ns < self.request_due_ns() {
            return None;
        }
        (self.owes, self.unanswered) = (false, 0);
        self.asked += 1;
        self.asked_ns = now_ns;
        let request = Request {
            acknowledged: self.newest.map_or((0, 0), |position| (position.run, position.number)),
            asked_ns: now_ns,
            selection: self.selection.clone(),
        };
        Some(write_request(self.own, self.asked, &request))
    }

    /// When the next request is due if nothing arrives, monotonic ns.
    pub(crate) const fn request_due_ns(&self) -> u64 {
        let due_ns = self.asked_ns.saturating_add(REQUEST_INTERVAL_NS);
        let answer_ns = self.unanswered_ns.saturating_add(MAX_ACK_DELAY_NS);
        if self.unanswered != 0 && answer_ns < due_ns { answer_ns } else { due_ns }
    }

    const fn is_quiet(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.received_ns) > QUIET_TIMEOUT_NS
    }

    const fn is_overdue(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.received_ns) > SILENCE_TIMEOUT_NS
    }

    /// True if the sender has just become silent. True once for each silence.
    pub(crate) fn becomes_silent(&mut self, now_ns: u64) -> bool {
        let falls = !self.is_silent && self.is_overdue(now_ns);
        if falls {
            self.silence();
        }
        falls
    }

    /// Handles the network's report that the sender is lost. Returns whether that is new.
    pub(crate) fn lost(&mut self) -> bool {
        let falls = !self.is_silent;
        if falls {
            self.silence();
        }
        falls
    }

    fn silence(&mut self) {
        self.is_silent = true;
        self.received.silences += 1;
    }

    /// True if the sender sends.
    pub(crate) const fn is_sending(&self) -> bool {
        !self.is_silent
    }

    /// The sender's worker, by its last message.
    pub(crate) const fn worker(&self) -> Worker {
        self.leader.worker
    }

    /// [`LeaderStatus::term`] of its worker, by its last message.
    pub(crate) const fn term(&self) -> u64 {
        self.leader.term
    }

    /// The highest term that the sender knows of, by its last message.
    pub(crate) fn highest_term(&self) -> u64 {
        self.leader.highest_term.max(self.leader.term)
    }

    pub(crate) const fn received(&self) -> Received {
        self.received
    }

    pub(crate) const fn offset(&self) -> &Offset {
        &self.offset
    }
}
