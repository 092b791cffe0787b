//! Keyframes: the fleet's whole state, for recorders and for the standby worker of another host.
//!
//! When the checkpointer detects readers, or the worker serves with a permit, it passes the tick a
//! box for the state. The tick copies its state into the box after everything else is sent, and
//! returns it. The checkpointer encodes and sends it. The tick neither allocates nor blocks, and if
//! nobody needs the state there is no box.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use joulebus_bus::{Bus, Limits, OpenError, Writer, clock, process_id};
use joulebus_connect::standby::SavedState;
use joulebus_fleet::{Fleet, FleetState};
use joulebus_settings::FleetSettings;
use joulebus_wire::{FrameOrder, SCHEMA_VERSION, State, StateHeader, fnv1a};

use crate::standby::watch::CurrentPermit;

/// Minimum time between two keyframes, unless there is a new reader, ns.
const EVERY_NS: u64 = 5_000_000_000;
/// A keyframe may take at most 1/100 of the checkpointer's time, and of the tick's.
const TIME_DIVISOR: u64 = 100;
/// Interval of the file that the link sends to other hosts: a worker that takes over begins at most
/// that far back. Its encoding may take 1/10 of the time of the checkpointer, which otherwise waits
/// for disks. Copying may still take 1/100 of the tick's time.
const FILE_EVERY_NS: u64 = 1_000_000_000;
const FILE_TIME_DIVISOR: u64 = 10;
/// Pieces sent per poll: a reader's buffer holds four times as many, and a recorder reads it
/// several times per poll of the checkpointer.
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
    fn with_capacity_for(settings: &FleetSettings) -> Self {
        Self {
            worker_epoch: 0,
            tick: 0,
            taken_ns: 0,
            copied_in_ns: 0,
            state: FleetState::with_capacity_for(settings),
        }
    }
}

/// The tick's end of the channel.
#[derive(Debug)]
pub(crate) struct Keyframes {
    asked: Receiver<Box<Keyframe>>,
    taken: SyncSender<Box<Keyframe>>,
}

/// The checkpointer's end of the channel, before its port is open.
#[derive(Debug)]
pub(crate) struct KeyframeOrders {
    ask: SyncSender<Box<Keyframe>>,
    taken: Receiver<Box<Keyframe>>,
    current_permit: Arc<CurrentPermit>,
}

/// Both ends. At most one box is in transfer in either direction, so no end ever blocks.
pub(crate) fn keyframes(current_permit: Arc<CurrentPermit>) -> (Keyframes, KeyframeOrders) {
    let (ask, asked) = sync_channel(1);
    let (give, taken) = sync_channel(1);
    let orders = KeyframeOrders { ask, taken, current_permit };
    (Keyframes { asked, taken: give }, orders)
}

impl Keyframes {
    /// Copies the state after a tick, if it was requested.
    pub(crate) fn offer(&self, fleet: &Fleet, tick: FrameOrder) {
        let Ok(mut keyframe) = self.asked.try_recv() else {
            return;
        };
        let taken_ns = clock::monotonic_ns();
        fleet.state_into(&mut keyframe.state);
        (keyframe.worker_epoch, keyframe.tick) = (tick.run, tick.number);
        keyframe.copied_in_ns = clock::monotonic_ns().saturating_sub(taken_ns);
        keyframe.taken_ns = taken_ns;
        // Fails only if the checkpointer has ended, and then the worker ends too.
        let _ = self.taken.try_send(keyframe);
    }
}

/// The checkpointer's end of the channel.
pub(crate) struct KeyframeSender {
    writer: Writer<State>,
    orders: KeyframeOrders,
    settings: FleetSettings,
    /// The unused box. `None` before the first reader.
    spare: Option<Box<Keyframe>>,
    is_asked: bool,
    /// The box whose state is being sent, and the number of bytes sent so far.
    sending: Option<(Box<Keyframe>, usize)>,
    bytes: Vec<u8>,
    /// Hashes of the keyframe being sent, and of the one before it.
    hash: u64,
    before_hash: u64,
    /// The run of the worker that they belong to.
    run: u64,
    readers: usize,
    /// When the next one for readers is due.
    next_ns: u64,
    /// True if the requested one is for them.
    is_for_readers: bool,
    file: PathBuf,
    /// When the next one for the file is due.
    file_ns: u64,
    is_file_logged: bool,
}

impl KeyframeSender {
    /// Opens the port. Existing readers get the state before the first tick.
    pub(crate) fn open(
        bus: &Bus,
        limits: &Limits,
        settings: &FleetSettings,
        orders: KeyframeOrders,
        file: PathBuf,
    ) -> Result<Self, OpenError> {
        let mut sender = Self {
            writer: bus.writer(limits)?,
            orders,
            settings: settings.clone(),
            spare: None,
            is_asked: false,
            sending: None,
            bytes: Vec::new(),
            hash: 0,
            before_hash: 0,
            run: 0,
            readers: 0,
            next_ns: 0,
            is_for_readers: false,
            file,
            file_ns: 0,
            is_file_logged: false,
        };
        sender.ask_if_wanted();
        Ok(sender)
    }

    /// True if a state is in transfer, from the tick or to the readers.
    pub(crate) fn is_busy(&self) -> bool {
        self.is_asked || self.sending.is_some()
    }

    /// Requests a state if it is due, receives a finished one, and sends a part of it.
    ///
    /// 1. A new reader, or the end of the interval, asks the tick for a copy of its state.
    /// 2. The tick copies between two ticks, and hands the copy over.
    /// 3. The copy is encoded, and sent in pieces, a few in each call: no burst fills the channel.
    /// 4. After the last piece the memory of the copy waits for the next request.
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
            // It may receive only the rest of the current keyframe, so request another one at once.
            self.next_ns = 0;
        }
        if self.is_busy() {
            return;
        }
        let has_permit = self.orders.current_permit.term() > 0;
        if readers == 0 && !has_permit {
            (self.spare, self.bytes) = (None, Vec::new());
            return;
        }
        let now_ns = clock::monotonic_ns();
        let is_for_readers = readers > 0 && now_ns >= self.next_ns;
        let is_for_file = has_permit && now_ns >= self.file_ns;
        if !is_for_readers && !is_for_file {
            return;
        }
        let keyframe = match self.spare.take() {
            Some(keyframe) => keyframe,
            None => Box::new(Keyframe::with_capacity_for(&self.settings)),
        };
        self.is_for_readers = is_for_readers;
        if is_for_readers {
            self.next_ns = u64::MAX;
        }
        self.is_asked = self.orders.ask.try_send(keyframe).is_ok();
    }

    fn begin(&mut self, keyframe: Box<Keyframe>) {
        self.is_asked = false;
        let begun_ns = clock::monotonic_ns();
        keyframe.state.encode_into(&mut self.bytes);
        if self.is_for_readers {
            // A standby worker that takes over begins another run.
            let is_same_run = self.run == keyframe.worker_epoch;
            self.before_hash = if is_same_run { self.hash } else { 0 };
            (self.run, self.hash) = (keyframe.worker_epoch, fnv1a(self.bytes.iter().copied()));
        }
        let now_ns = clock::monotonic_ns();
        let (copied_ns, encoded_ns) = (keyframe.copied_in_ns, now_ns.saturating_sub(begun_ns));
        let every_ns = EVERY_NS.max(TIME_DIVISOR.saturating_mul(encoded_ns.max(copied_ns)));
        // Unless a new reader has connected since the request.
        if self.is_for_readers && self.next_ns > 0 {
            self.next_ns = now_ns.saturating_add(every_ns);
        }
        self.save(&keyframe, begun_ns);
        tracing::debug!(
            tick = keyframe.tick,
            bytes = self.bytes.len(),
            copied_ns,
            encoded_ns,
            "keyframe"
        );
        if self.is_for_readers {
            self.sending = Some((keyframe, 0));
        } else {
            self.spare = Some(keyframe);
        }
    }

    /// Leaves the state to the link of this host, if the worker serves with a permit. `begun_ns`:
    /// when the encoding began.
    fn save(&mut self, keyframe: &Keyframe, begun_ns: u64) {
        let term = self.orders.current_permit.term();
        if term == 0 {
            return;
        }
        let saved = SavedState::write(&self.file, (term, keyframe.taken_ns, 0), &self.bytes);
        match saved {
            Ok(()) => self.is_file_logged = false,
            Err(error) if !self.is_file_logged => {
                tracing::error!(
                    "a worker that takes over would begin with an older state: {error}"
                );
                self.is_file_logged = true;
            }
            Err(_) => {}
        }
        let now_ns = clock::monotonic_ns();
        let took_ns = now_ns.saturating_sub(begun_ns);
        let every_ns = FILE_EVERY_NS
            .max(TIME_DIVISOR.saturating_mul(keyframe.copied_in_ns))
            .max(FILE_TIME_DIVISOR.saturating_mul(took_ns));
        self.file_ns = begun_ns.saturating_add(every_ns);
    }

    /// Sends the bytes from `offset`. Returns how many, 0 at the end.
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
            pid: process_id(),
            worker_epoch: keyframe.worker_epoch,
            tick: keyframe.tick,
            total_bytes: self.bytes.len() as u64,
            offset: offset as u64,
            taken_ns: keyframe.taken_ns,
            sent_ns: clock::monotonic_ns(),
            sent_unix_ns: clock::unix_ns(),
            before_hash: self.before_hash,
        };
        self.writer.send(header, piece.len(), |at| piece[at])?;
        Ok(piece.len())
    }
}
