//! Frames of samples.

use joulebus_wire::{DropReason, SampleHeader};
use serde::{Deserialize, Serialize};

use crate::layout::shift::Shift;

/// Intake of one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TickIntake {
    /// Frames taken.
    pub frames: u32,
    /// Intended time, send time and reception time of the first of them, monotonic ns.
    pub first: Option<(u64, u64, u64)>,
}

impl TickIntake {
    /// Moves the instants to another clock.
    pub(crate) fn shift(&mut self, shift: Shift) {
        let Self { frames: _, first } = self;
        if let Some((intended_ns, sent_ns, taken_ns)) = first {
            for instant_ns in [intended_ns, sent_ns, taken_ns] {
                shift.instant(instant_ns);
            }
        }
    }
}

/// A frame in ingest.
#[derive(Debug, Clone, Copy)]
pub struct FrameIntake {
    pub(crate) header: SampleHeader,
    pub(crate) now_ns: u64,
    /// Result of the frame's checks: its samples may be checked, or the reason why not.
    pub(crate) admitted: Result<(), DropReason>,
}

impl FrameIntake {
    /// True if it is a frame of its source's present run, whatever its samples are.
    pub const fn is_admitted(&self) -> bool {
        self.admitted.is_ok()
    }
}
