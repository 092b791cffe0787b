//! The receiving side of a stream: what has come, from which run, what is missing, and by which clock.

use crate::protocol::carried::{Carried, RawFrame};
use crate::protocol::message::{
    Body, Message, Request, Sender, Status, Voice, Worker, write_request,
};
use crate::protocol::offset::{Offset, Trip, shifted};
use crate::protocol::selection::Selection;
use crate::protocol::stream::SILENT_AFTER_NS;
use crate::protocol::wall::Kept;

/// How often is asked where nothing comes.
pub(crate) const ASK_EVERY_NS: u64 = 100_000_000;
/// A frame that a later one replaces is acknowledged with the next one of its service, or after this time: the sender has
/// room for two. Longer than the period of most fleets, shorter than what a frame takes on a way that is not free for the next.
const ANSWER_WITHIN_NS: u64 = 40_000_000;
/// The services of which only the newest frame counts.
const REPLACED: u32 = Carried::FORECASTS.bit()
    | Carried::DIAGNOSTICS.bit()
    | Carried::BUDGETS.bit()
    | Carried::PLAN_STATES.bit();
/// Requests older than this are not taken for the one that an answer names.
const ASKED_WITHIN_NS: u64 = 10_000_000_000;

/// A run that has sent nothing for so long, three statuses, may be replaced by another.
const QUIET_AFTER_NS: u64 = 300_000_000;
/// Messages that can be missing between two: more than a link sends while it is not yet silent.
const MOST_LOST: u64 = 100_000;

/// What has come.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Received {
    pub(crate) frames: u64,
    pub(crate) bytes: u64,
    /// Messages that were sent and did not come.
    pub(crate) lost: u64,
    /// Messages that came again, or after a later one.
    pub(crate) repeated: u64,
    /// Messages of another run while one spoke: a link that started again at once, two links of one name, or a stranger.
    pub(crate) other_runs: u64,
    /// Times that a run went on after another had spoken: not a link that started again.
    pub(crate) contested: u64,
    /// Messages whose time, or that of their frame, lay ahead.
    pub(crate) future: u64,
    /// Frames that the sender left out because the link was slower than the fleet: of its present run.
    pub(crate) dropped: u64,
    /// Runs of the sender.
    pub(crate) runs: u64,
    /// Times that nothing came for 1.5 s.
    pub(crate) silences: u64,
}

/// A frame that is to be passed on.
#[derive(Debug)]
pub(crate) struct Accepted<'a> {
    pub(crate) frame: RawFrame<'a>,
    /// To be added to its times, ns.
    pub(crate) offset_ns: i128,
    /// [`Voice::term`] of the worker that wrote it.
    pub(crate) term: u64,
}

/// Why a message was not used; counted in [`Received`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unused {
    /// It has no frame, only the status.
    Status,
    /// It came before, or a later one did.
    Repeated,
    /// It is of another run than the one that speaks.
    OtherRun,
    /// Its time lies ahead.
    Future,
    /// The sender's clock is not known yet.
    NoClock,
    /// It is not a frame that was asked for.
    NotAsked,
}

/// A message's place in its stream.
#[derive(Debug, Clone, Copy)]
struct Place {
    run: u64,
    /// Monotonic ns of the sender.
    sent_ns: u64,
    number: u64,
}

/// What comes from one sender.
#[derive(Debug)]
pub(crate) struct Receiver {
    own: Sender,
    selection: Selection,
    /// Number of the last request.
    asked: u64,
    asked_ns: u64,
    /// The newest message.
    heard: Option<Place>,
    heard_ns: u64,
    /// The next request is due at once.
    owes: bool,
    /// Services of which one frame has come since it was last asked, and when the first did.
    unanswered: u32,
    unanswered_ns: u64,
    is_silent: bool,
    /// Another run has spoken since the present one last did.
    has_rival: bool,
    voice: Voice,
    offset: Offset,
    /// This host's realtime clock, where it counts.
    clock: Option<Kept>,
    received: Received,
}

impl Receiver {
    pub(crate) fn new(own: Sender, selection: Selection) -> Self {
        Self {
            own,
            selection,
            asked: 0,
            asked_ns: 0,
            heard: None,
            heard_ns: 0,
            owes: false,
            unanswered: 0,
            unanswered_ns: 0,
            is_silent: true,
            has_rival: false,
            voice: Voice::default(),
            offset: Offset::default(),
            clock: None,
            received: Received::default(),
        }
    }

    /// Changes what is asked for from now on.
    pub(crate) fn select(&mut self, services: u32) {
        self.owes |= self.selection.services != services;
        self.selection.services = services;
    }

    /// What this host's realtime clock says from now on; `None` where it does not count.
    pub(crate) const fn reads(&mut self, clock: Option<Kept>) {
        self.clock = clock;
    }

    /// Takes a message of `bytes` that arrived at `now_ns`.
    ///
    /// # Errors
    /// [`Unused`]: there is no frame to pass on.
    pub(crate) fn take<'a>(
        &mut self,
        message: &Message<'a>,
        bytes: usize,
        now_ns: u64,
    ) -> Result<Accepted<'a>, Unused> {
        let Body::Frame(status, frame) = &message.body else {
            return Err(Unused::NotAsked);
        };
        let place = Place {
            run: message.run,
            sent_ns: status.sent_ns,
            number: message.number,
        };
        self.place(place, now_ns)?;
        self.heard_ns = now_ns;
        self.is_silent = false;
        self.note(*frame, now_ns);
        self.received.bytes += bytes as u64;
        self.received.dropped = status.dropped;
        self.voice = status.voice;
        self.measure(status, now_ns);
        let frame = (*frame).ok_or(Unused::Status)?;
        if !self.selection.wants(frame.service) {
            return Err(Unused::NotAsked);
        }
        // It would be young for ever.
        if frame.sent_ns() > status.sent_ns {
            self.received.future += 1;
            return Err(Unused::Future);
        }
        let offset_ns = self.offset.used_ns().ok_or(Unused::NoClock)?;
        self.received.frames += 1;
        Ok(Accepted {
            frame,
            offset_ns,
            term: status.voice.term,
        })
    }

    /// Notes that something is to be acknowledged: at once a status, which measures the way, and a frame that no later one
    /// replaces, since several of those come together where a sender was held up; and all before the clock is known. Of the
    /// other services the sender has room for one more frame.
    fn note(&mut self, frame: Option<RawFrame<'_>>, now_ns: u64) {
        let bit = frame.map_or(0, |frame| frame.service.bit() & REPLACED);
        let is_second = self.unanswered & bit != 0;
        self.owes |= bit == 0 || is_second || !self.offset.is_measured();
        if self.unanswered == 0 {
            self.unanswered_ns = now_ns;
        }
        self.unanswered |= bit;
    }

    /// Accounts for a message's place: by its time, since one with a false number could otherwise hide all real ones, and none
    /// is from the future. A run that speaks is not replaced by another; a run that is silent is, whichever is later, since a
    /// host's clock begins anew when it boots.
    fn place(&mut self, place: Place, now_ns: u64) -> Result<(), Unused> {
        match self.heard {
            Some(last) if last.run == place.run && !self.is_overdue(now_ns) => {
                if self.is_future(place.sent_ns, now_ns) {
                    self.received.future += 1;
                    return Err(Unused::Future);
                }
                if (place.sent_ns, place.number) <= (last.sent_ns, last.number) {
                    self.received.repeated += 1;
                    return Err(Unused::Repeated);
                }
                self.lose(place.number.saturating_sub(last.number));
                self.received.contested += u64::from(self.has_rival);
            }
            Some(last) if last.run != place.run && !self.is_quiet(now_ns) => {
                self.received.other_runs += 1;
                self.has_rival = true;
                return Err(Unused::OtherRun);
            }
            _ => {
                // What was sent before the first message came is not missing: the way was being made.
                self.offset.forget();
                self.received.runs += 1;
            }
        }
        self.has_rival = false;
        self.heard = Some(place);
        Ok(())
    }

    /// Counts what is missing before the `numbers`-th message after the last one; a false number counts nothing.
    const fn lose(&mut self, numbers: u64) {
        if numbers <= MOST_LOST {
            self.received.lost += numbers.saturating_sub(1);
        }
        // The sender counts them as on their way until it is asked again.
        self.owes |= numbers > 1;
    }

    fn is_future(&self, sent_ns: u64, now_ns: u64) -> bool {
        let offset_ns = self.offset.used_ns();
        offset_ns.is_some_and(|offset_ns| shifted(sent_ns, offset_ns) > now_ns)
    }

    fn measure(&mut self, status: &Status, now_ns: u64) {
        let within = now_ns.checked_sub(status.asked_ns);
        // Times that this link has not asked at measure nothing.
        if status.asked_ns == 0
            || status.asked_ns > self.asked_ns
            || within.is_none_or(|within| within > ASKED_WITHIN_NS)
        {
            return;
        }
        let trip = Trip {
            asked_ns: status.asked_ns,
            heard_ns: status.heard_ns,
            sent_ns: status.sent_ns,
            now_ns,
        };
        // 0: the sender's clock is not kept.
        let theirs_ns = Some(status.realtime_ns).filter(|ns| *ns > 0);
        self.offset.note(trip, theirs_ns.zip(self.clock));
    }

    /// The request to send now, if one is due.
    pub(crate) fn ask(&mut self, now_ns: u64) -> Option<Vec<u8>> {
        if !self.owes && now_ns < self.ask_due_ns() {
            return None;
        }
        (self.owes, self.unanswered) = (false, 0);
        self.asked += 1;
        self.asked_ns = now_ns;
        let request = Request {
            heard: self.heard.map_or((0, 0), |place| (place.run, place.number)),
            asked_ns: now_ns,
            selection: self.selection.clone(),
        };
        Some(write_request(self.own, self.asked, &request))
    }

    /// When the next request is due if nothing comes, monotonic ns.
    pub(crate) const fn ask_due_ns(&self) -> u64 {
        let due_ns = self.asked_ns.saturating_add(ASK_EVERY_NS);
        let answer_ns = self.unanswered_ns.saturating_add(ANSWER_WITHIN_NS);
        if self.unanswered != 0 && answer_ns < due_ns {
            answer_ns
        } else {
            due_ns
        }
    }

    const fn is_quiet(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.heard_ns) > QUIET_AFTER_NS
    }

    const fn is_overdue(&self, now_ns: u64) -> bool {
        now_ns.saturating_sub(self.heard_ns) > SILENT_AFTER_NS
    }

    /// Whether the sender has just fallen silent; told once.
    pub(crate) fn falls_silent(&mut self, now_ns: u64) -> bool {
        let falls = !self.is_silent && self.is_overdue(now_ns);
        if falls {
            self.silence();
        }
        falls
    }

    /// The sender's end was told by the network; whether that is news.
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

    /// Whether the sender speaks.
    pub(crate) const fn is_heard(&self) -> bool {
        !self.is_silent
    }

    /// The sender's worker, by its last message.
    pub(crate) const fn worker(&self) -> Worker {
        self.voice.worker
    }

    /// [`Voice::term`] of its worker, by its last message.
    pub(crate) const fn term(&self) -> u64 {
        self.voice.term
    }

    /// The greatest term that the sender knows of, by its last message.
    pub(crate) fn heard_term(&self) -> u64 {
        self.voice.heard.max(self.voice.term)
    }

    pub(crate) const fn received(&self) -> Received {
        self.received
    }

    pub(crate) const fn offset(&self) -> &Offset {
        &self.offset
    }
}
