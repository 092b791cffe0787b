//! Frames of samples.

use joulebus_wire::{DropReason, SampleHeader};
use serde::{Deserialize, Serialize};

/// Intake of one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TickIntake {
    /// Frames taken.
    pub frames: u32,
    /// Intended time, send time and reception time of the first of them, monotonic ns.
    pub first: Option<(u64, u64, u64)>,
}

/// A frame in ingest.
#[derive(Debug, Clone, Copy)]
pub struct FrameIntake {
    pub(crate) header: SampleHeader,
    pub(crate) now_ns: u64,
    /// Whether its samples may be checked.
    pub(crate) admitted: Result<(), DropReason>,
}
