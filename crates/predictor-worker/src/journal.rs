//! The worker's journal: which frames each tick took, in which order, at which time, and which
//! sources had ended.

use std::sync::atomic::{AtomicU64, Ordering};

use joulebus_bus::{Bus, IncomingFrame, Limits, OpenError, Writer, clock, process_id};
use joulebus_wire::{FrameOrder, SCHEMA_VERSION, Statement, TakenFrame, TickHeader, Ticks};

/// Collects the frames that ingest takes and the statements of persons, and sends the list after each tick.
#[derive(Debug)]
pub(crate) struct Journal {
    writer: Writer<Ticks>,
    taken: Vec<TakenFrame>,
    unlisted: u32,
}

impl Journal {
    /// Opens the port. The list's memory is allocated here, once.
    pub(crate) fn open(bus: &Bus, limits: &Limits) -> Result<Self, OpenError> {
        let writer = bus.writer::<Ticks>(limits)?;
        Ok(Self { taken: Vec::with_capacity(writer.max_len()), writer, unlisted: 0 })
    }

    /// Records a frame that is passed to ingest with the time `now_ns`.
    pub(crate) fn note(&mut self, frame: &IncomingFrame<'_>, now_ns: u64) {
        let header = frame.header();
        // Both counts are bounded by the capacity of a frame, far below 2^32.
        self.list(TakenFrame {
            source_id: header.source_id,
            source_epoch: header.source_epoch,
            frame_seq: header.frame_seq,
            taken_ns: now_ns,
            samples: frame.len() as u32,
            truncated: frame.truncated() as u32,
        });
    }

    /// True if the list takes another row.
    pub(crate) fn has_room(&self) -> bool {
        self.taken.len() < self.writer.max_len()
    }

    /// Records what a person states of a robot.
    pub(crate) fn note_statement(&mut self, robot: u32, stated: Statement, now_ns: u64) {
        self.list(TakenFrame::stated(robot, stated, now_ns));
    }

    /// Records that the run of a source has ended.
    pub(crate) fn note_source_ended(&mut self, source_id: u64, epoch: u64, now_ns: u64) {
        self.list(TakenFrame::source_ended(source_id, epoch, now_ns));
    }

    fn list(&mut self, row: TakenFrame) {
        if self.has_room() {
            self.taken.push(row);
        } else {
            self.unlisted = self.unlisted.saturating_add(1);
        }
    }

    /// Sends the journal of a tick, and begins the next one. Failures are counted in `unsent`.
    pub(crate) fn send(&mut self, tick: FrameOrder, start_ns: u64, flags: u32, unsent: &AtomicU64) {
        let header = TickHeader {
            schema: SCHEMA_VERSION,
            pid: process_id(),
            worker_epoch: tick.run,
            tick: tick.number,
            start_ns,
            sent_ns: clock::monotonic_ns(),
            flags,
            unlisted: self.unlisted,
        };
        let taken = &self.taken;
        let sent = self.writer.send(header, taken.len(), |place| taken[place]);
        unsent.fetch_add(u64::from(sent.is_err()), Ordering::Relaxed);
        self.taken.clear();
        self.unlisted = 0;
    }
}
