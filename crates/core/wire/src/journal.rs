//! The journal: which frames the worker took in each tick, in which order and at which time, which
//! sources had ended, and what persons stated. It suffices to recompute the tick.

use crate::declare::ZeroCopySend;
use crate::{Statement, rows};

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
    /// number on [`crate::Samples`]. A row whose `truncated` is 2³² − 1 is no frame. If its
    /// `samples` is 0 it is a [`Statement`] of the robot with the id `frame_seq`: its code is the
    /// lower half of `source_id`, its value as `f32` the upper one. If it is 1, the run of the
    /// source has ended.
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

impl TakenFrame {
    /// [`TakenFrame::truncated`] of a row that is no frame. Frames are far smaller.
    const NO_FRAME: u32 = u32::MAX;

    /// Not a frame: what a person states of `robot`.
    #[must_use]
    pub const fn stated(robot: u32, statement: Statement, taken_ns: u64) -> Self {
        let (code, value) = statement.encode();
        Self {
            source_id: (value.to_bits() as u64) << 32 | code as u64,
            source_epoch: 0,
            frame_seq: robot as u64,
            taken_ns,
            samples: 0,
            truncated: Self::NO_FRAME,
        }
    }

    /// Not a frame: the run of a source had ended, so that others may publish for its robots.
    #[must_use]
    pub const fn source_ended(source_id: u64, source_epoch: u64, taken_ns: u64) -> Self {
        Self {
            source_id,
            source_epoch,
            frame_seq: 0,
            taken_ns,
            samples: 1,
            truncated: Self::NO_FRAME,
        }
    }

    /// True if the row is a frame.
    pub const fn is_frame(&self) -> bool {
        self.truncated != Self::NO_FRAME
    }

    /// The robot and what was [stated](TakenFrame::stated) of it, if the row is that.
    #[must_use]
    pub fn statement(&self) -> Option<(u32, Statement)> {
        if self.is_frame() || self.samples != 0 {
            return None;
        }
        let value = f32::from_bits((self.source_id >> 32) as u32);
        // Only the worker writes it: a robot's id.
        Some((self.frame_seq as u32, Statement::decode(self.source_id as u32, value)?))
    }

    /// The source and its run, if the row is the [end of a source](TakenFrame::source_ended).
    pub const fn ended_source(&self) -> Option<(u64, u64)> {
        if !self.is_frame() && self.samples == 1 {
            Some((self.source_id, self.source_epoch))
        } else {
            None
        }
    }
}

rows! {
    /// Header of a tick's journal: the slice lists the frames taken since the previous tick and the
    /// ends of sources, in the order in which they were taken, and then the statements.
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
