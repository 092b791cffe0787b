//! Keyframes: the fleet's whole state, for those who record.
//!
//! The checkpointer notices that somebody reads them, and hands the tick a box to put the state in; the
//! tick copies it there after everything else is sent, and hands the box back; the checkpointer encodes
//! and sends it. The tick neither allocates nor waits, and without readers there is no box.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use joulebus_bus::{Bus, Limits, OpenError, StateWriter, clock};
use joulebus_fleet::{Fleet, FleetState};
use joulebus_settings::FleetSettings;
use joulebus_wire::{SCHEMA_VERSION, StateHeader};

/// Least time between two keyframes, unless somebody new reads, ns.
const EVERY_NS: u64 = 5_000_000_000;
/// A keyframe may take at most one part in so many of the checkpointer's time, and of the tick's.
const TIME_DIVISOR: u64 = 100;
/// Pieces sent at one poll: a reader's buffer holds four times as many, and a recorder reads it
/// several times as often as the checkpointer polls.
const BURST: usize = 2;

/// A state, and when it was taken.
#[derive(Debug)]
struct Keyframe {
    worker_epoch: u64,
    tick: u64,
    taken_ns: u64,
    copied_in_ns: u64,
    state: FleetState,
}

impl Keyframe {
    fn with_room_for(settings: &FleetSettings) -> Self {
        Self {
            worker_epoch: 0,
            tick: 0,
            taken_ns: 0,
            copied_in_ns: 0,
            state: FleetState::with_room_for(settings),
        }
    }
}

/// The tick's end.
#[derive(Debug)]
pub(crate) struct Keyframes {
    asked: Receiver<Box<Keyframe>>,
    taken: SyncSender<Box<Keyframe>>,
}

/// The checkpointer's end, not open yet.
#[derive(Debug)]
pub(crate) struct KeyframeOrders {
    ask: SyncSender<Box<Keyframe>>,
    taken: Receiver<Box<Keyframe>>,
}

/// Both ends. A box is on its way in one direction at most, so that no end ever waits.
pub(crate) fn keyframes() -> (Keyframes, KeyframeOrders) {
    let (ask, asked) = sync_channel(1);
    let (give, taken) = sync_channel(1);
    let orders = KeyframeOrders { ask, taken };
    (Keyframes { asked, taken: give }, orders)
}

impl Keyframes {
    /// Takes the state after tick `tick` of the worker's run `worker_epoch`, if it is wanted.
    pub(crate) fn offer(&self, fleet: &Fleet, (worker_epoch, tick): (u64, u64)) {
        let Ok(mut keyframe) = self.asked.try_recv() else {
            return;
        };
        let taken_ns = clock::monotonic_ns();
        fleet.state_into(&mut keyframe.state);
        (keyframe.worker_epoch, keyframe.tick) = (worker_epoch, tick);
        keyframe.copied_in_ns = clock::monotonic_ns().saturating_sub(taken_ns);
        keyframe.taken_ns = taken_ns;
        // The checkpointer has ended: so does the worker.
        let _ = self.taken.try_send(keyframe);
    }
}

/// The checkpointer's end.
pub(crate) struct KeyframeSender {
    writer: StateWriter,
    orders: KeyframeOrders,
    settings: FleetSettings,
    /// The box while it is here and of no use; none before the first reader.
    spare: Option<Box<Keyframe>>,
    is_asked: bool,
    /// The box while its state is being sent, and the bytes sent so far.
    sending: Option<(Box<Keyframe>, usize)>,
    bytes: Vec<u8>,
    readers: usize,
    next_ns: u64,
}

impl KeyframeSender {
    /// Opens the port. Who reads already gets the state before the first tick.
    pub(crate) fn open(
        bus: &Bus,
        limits: &Limits,
        settings: &FleetSettings,
        orders: KeyframeOrders,
    ) -> Result<Self, OpenError> {
        let mut sender = Self {
            writer: bus.state_writer(limits)?,
            orders,
            settings: settings.clone(),
            spare: None,
            is_asked: false,
            sending: None,
            bytes: Vec::new(),
            readers: 0,
            next_ns: 0,
        };
        sender.ask_if_wanted();
        Ok(sender)
    }

    /// Whether the state is on its way, from the tick or to the readers.
    pub(crate) fn is_busy(&self) -> bool {
        self.is_asked || self.sending.is_some()
    }

    /// Asks for a state if it is time, takes one that has come, and sends some of it.
    pub(crate) fn poll(&mut self) {
        self.ask_if_wanted();
        if let Ok(keyframe) = self.orders.taken.try_recv() {
            self.begin(keyframe);
        }
        let Some((keyframe, mut sent)) = self.sending.take() else {
            return;
        };
        for _ in 0..BURST {
            match self.send_piece(&keyframe, sent) {
                Ok(bytes) => sent += bytes,
                Err(error) => {
                    tracing::warn!(%error, "a keyframe was not sent");
                    sent = self.bytes.len();
                }
            }
        }
        if sent < self.bytes.len() {
            self.sending = Some((keyframe, sent));
        } else {
            self.spare = Some(keyframe);
        }
    }

    fn ask_if_wanted(&mut self) {
        let readers = self.writer.readers();
        let somebody_new = readers > self.readers;
        self.readers = readers;
        if somebody_new {
            // It may get the end of one that is on its way: then another follows at once.
            self.next_ns = 0;
        }
        if self.is_busy() {
            return;
        }
        if readers == 0 {
            (self.spare, self.bytes) = (None, Vec::new());
            return;
        }
        if clock::monotonic_ns() < self.next_ns {
            return;
        }
        let keyframe = match self.spare.take() {
            Some(keyframe) => keyframe,
            None => Box::new(Keyframe::with_room_for(&self.settings)),
        };
        self.next_ns = u64::MAX;
        self.is_asked = self.orders.ask.try_send(keyframe).is_ok();
    }

    fn begin(&mut self, keyframe: Box<Keyframe>) {
        self.is_asked = false;
        let begun_ns = clock::monotonic_ns();
        keyframe.state.encode_into(&mut self.bytes);
        let now_ns = clock::monotonic_ns();
        let (copied_ns, encoded_ns) = (keyframe.copied_in_ns, now_ns.saturating_sub(begun_ns));
        let every_ns = EVERY_NS.max(TIME_DIVISOR.saturating_mul(encoded_ns.max(copied_ns)));
        // Unless somebody new has come since it was asked for.
        if self.next_ns > 0 {
            self.next_ns = now_ns.saturating_add(every_ns);
        }
        tracing::debug!(
            tick = keyframe.tick,
            bytes = self.bytes.len(),
            copied_ns,
            encoded_ns,
            "keyframe"
        );
        self.sending = Some((keyframe, 0));
    }

    /// Sends the bytes from `offset`; returns how many, 0 at the end.
    fn send_piece(
        &mut self,
        keyframe: &Keyframe,
        offset: usize,
    ) -> Result<usize, joulebus_bus::SendError> {
        let piece = &self.bytes[offset..];
        let piece = &piece[..piece.len().min(self.writer.max_len())];
        if piece.is_empty() {
            return Ok(0);
        }
        let header = StateHeader {
            schema: SCHEMA_VERSION,
            pid: std::process::id(),
            worker_epoch: keyframe.worker_epoch,
            tick: keyframe.tick,
            total_bytes: self.bytes.len() as u64,
            offset: offset as u64,
            taken_ns: keyframe.taken_ns,
            sent_ns: clock::monotonic_ns(),
            sent_unix_ns: clock::unix_ns(),
        };
        self.writer.send(header, piece.len(), |at| piece[at])?;
        Ok(piece.len())
    }
}
