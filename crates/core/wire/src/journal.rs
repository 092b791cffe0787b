//! The journal: which frames the worker took in each tick, in which order and at which time. It
//! suffices to recompute the tick.

use crate::declare::ZeroCopySend;
use crate::rows;

/// Bits of [`TickHeader::flags`].
pub mod tick_flag {
    /// The tick before this one started too late: an input of the tick.
    pub const DEADLINE_MISSED: u32 = 1 << 0;
    /// Ticks took longer than their period: this one computed no diagnostics.
    pub const NO_DIAGNOSTICS: u32 = 1 << 1;
    /// Somebody reads [`crate::PlanStates`]: this tick wrote them.
    pub const PLAN_STATES: u32 = 1 << 2;
    /// Somebody reads [`crate::Outlooks`]: this tick wrote them.
    pub const OUTLOOKS: u32 = 1 << 3;
}

rows! {
    /// One frame of samples that a tick took. 40 bytes.
    ///
    /// Identifies the frame. Its samples are those of the frame with the same source, epoch and
    /// number on [`crate::Samples`].
    #[derive(Eq)]
    pub struct TakenFrame: "joulebus.TakenFrame.v1", 40 {
        /// [`crate::SampleHeader::source_id`] of the frame.
        pub source_id: u64,
        /// [`crate::SampleHeader::source_epoch`] of the frame.
        #[run]
        pub source_epoch: u64,
        /// [`crate::SampleHeader::frame_seq`] of the frame.
        pub frame_seq: u64,
        /// When the worker took it, monotonic ns: the time passed to ingest.
        #[instant]
        pub taken_ns: u64,
        /// Samples taken from it.
        pub samples: u32,
        /// Samples in it beyond the fleet's capacity, which were not read.
        pub truncated: u32,
    }
}

rows! {
    /// Header of a tick's journal: the slice lists the frames taken since the previous tick, in the
    /// order in which they were taken.
    #[derive(Eq)]
    pub struct TickHeader: "joulebus.TickHeader.v1", 48 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the worker.
        pub pid: u32,
        /// As in [`crate::ForecastHeader::worker_epoch`].
        #[run]
        pub worker_epoch: u64,
        /// As in [`crate::ForecastHeader::tick`].
        pub tick: u64,
        /// The time passed to the tick, monotonic ns.
        #[instant]
        pub start_ns: u64,
        /// When the journal was sent, monotonic ns.
        #[instant]
        pub sent_ns: u64,
        /// [`tick_flag`] bits.
        pub flags: u32,
        /// Frames taken but not listed because the list was full: such a tick cannot be recomputed.
        pub unlisted: u32,
    }
}
