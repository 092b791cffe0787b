//! Frames of samples.

use joulebus_wire::{DropReason, SampleHeader};
use serde::{Deserialize, Serialize};

/// What one tick took in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct TickIntake {
    /// Frames taken.
    pub frames: u32,
    /// When the first of them was meant to be sent, was sent, and was taken, monotonic ns.
    pub first: Option<(u64, u64, u64)>,
}

/// A frame that is being taken in.
#[derive(Debug, Clone, Copy)]
pub struct FrameIntake {
    pub(crate) header: SampleHeader,
    pub(crate) now_ns: u64,
    /// Whether its samples may be checked at all.
    pub(crate) admitted: Result<(), DropReason>,
}
