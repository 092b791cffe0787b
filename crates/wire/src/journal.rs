//! What the worker took in each tick, in which order, at which time: enough to compute it again.

use bytemuck::{Pod, Zeroable};

use crate::layout::ZeroCopySend;

/// Bits of [`TickHeader::flags`].
pub mod tick_flag {
    /// The tick before this one started too late: what the tick was told.
    pub const DEADLINE_MISSED: u32 = 1 << 0;
    /// Ticks took longer than their period: this one left the diagnostics out.
    pub const NO_DIAGNOSTICS: u32 = 1 << 1;
}

/// One frame of samples that a tick took. 40 bytes.
///
/// Names the frame; its samples are those of the frame with the same source, epoch and number on
/// [`crate::Service::Samples`].
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, ZeroCopySend)]
#[type_name("joulebus.TakenFrame.v1")]
pub struct TakenFrame {
    /// [`crate::SampleHeader::source_id`] of the frame.
    pub source_id: u64,
    /// [`crate::SampleHeader::source_epoch`] of the frame.
    pub source_epoch: u64,
    /// [`crate::SampleHeader::frame_seq`] of the frame.
    pub frame_seq: u64,
    /// When the worker took it, monotonic ns: the time that the intake was told.
    pub taken_ns: u64,
    /// Samples taken from it.
    pub samples: u32,
    /// Samples in it beyond the fleet's capacity, which nobody looked at.
    pub truncated: u32,
}

/// Header of a tick's journal: the slice holds the frames taken since the tick before, in the
/// order in which they were taken.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, ZeroCopySend)]
#[type_name("joulebus.TickHeader.v1")]
pub struct TickHeader {
    /// [`crate::SCHEMA_VERSION`].
    pub schema: u32,
    /// Process id of the worker.
    pub pid: u32,
    /// As in [`crate::ForecastHeader::worker_epoch`].
    pub worker_epoch: u64,
    /// As in [`crate::ForecastHeader::tick`].
    pub tick: u64,
    /// The time that the tick was told, monotonic ns.
    pub start_ns: u64,
    /// When the journal was sent, monotonic ns.
    pub sent_ns: u64,
    /// [`tick_flag`] bits.
    pub flags: u32,
    /// Frames taken for which the list had no room: such a tick cannot be computed again.
    pub unlisted: u32,
}
