//! The energy that each robot will draw if it goes on as it does.

use crate::Quality;
use crate::declare::ZeroCopySend;
use crate::layout::bits;
use crate::rows;

/// Number of horizons of an [`Outlook`].
pub const OUTLOOK_HORIZONS: usize = 4;

/// Horizons of an [`Outlook`], s, ascending.
pub const OUTLOOK_S: [f32; OUTLOOK_HORIZONS] = [1.0, 10.0, 60.0, 300.0];

bits! {
    /// Bits of [`Outlook::flags`].
    pub mod outlook_flag {
        /// A sample has been accepted: `stamp_ns` is known.
        pub const SAMPLE: u32 = 1 << 0;
        /// `mean_w` and `energy_j` are known.
        pub const ENERGY: u32 = 1 << 1;
        /// Time to empty is known.
        pub const TIME_TO_EMPTY: u32 = 1 << 2;
        /// The last row of the model lay outside the range that it was trained on.
        pub const OUTSIDE_TRAINING: u32 = 1 << 3;
        /// Bounds of the longest horizons are extrapolated beyond those whose errors are known.
        pub const EXTRAPOLATED: u32 = 1 << 4;
    }
}

rows! {
    /// One robot's outlook. 96 bytes.
    ///
    /// The assumption: the robot goes on as it does. Its future commands are unknown. The forecast
    /// follows from its own recent power, with the platform's mean as the prior.
    ///
    /// The horizons are 1, 10, 60 and 300 s from `stamp_ns` on, in this order in each array. The
    /// energy lies between the bounds (`_lo`, `_hi`) with 90 %. The first `bounded` horizons have
    /// bounds: all, or none of a model without known errors.
    pub struct Outlook: "joulebus.Outlook.v1", 96 {
        /// Id of the robot.
        pub robot: u32,
        /// [`outlook_flag`] bits.
        pub flags: u32,
        /// [`Quality`] code, as of the forecast of the same tick.
        pub quality: u16,
        /// Detail of the quality.
        pub quality_detail: u16,
        /// Place of the robot's platform, and so of its model, in the config.
        pub platform: u16,
        /// Number of horizons, from the shortest, with bounds.
        pub bounded: u16,
        /// Number of times the robot's slot has been reassigned.
        pub generation: u32,
        /// Mean power expected over the longest horizon, W.
        pub mean_w: f32,
        /// [`crate::Sample::stamp_ns`] of the last accepted sample.
        #[instant]
        pub stamp_ns: u64,
        /// Energy expected over each horizon, J.
        pub energy_j: [f32; 4],
        /// Its lower bounds, J.
        pub energy_lo_j: [f32; 4],
        /// Its upper bounds, J.
        pub energy_hi_j: [f32; 4],
        /// [`crate::Budget::usable_j`] of the same tick, J.
        pub usable_j: f32,
        /// [`crate::Budget::time_to_empty_s`] of the same tick, s.
        pub time_to_empty_s: f32,
        /// Its lower bound, s.
        pub time_to_empty_lo_s: f32,
        /// Its upper bound, s.
        pub time_to_empty_hi_s: f32,
    }
}

impl Outlook {
    /// The robot's quality.
    pub const fn quality(&self) -> Quality {
        Quality::decode(self.quality, self.quality_detail)
    }

    /// The energy expected over a horizon of [`OUTLOOK_S`], J, if it is known.
    #[must_use]
    pub fn expected_j(&self, horizon: usize) -> Option<f32> {
        let is_known = self.flags & outlook_flag::ENERGY != 0;
        self.energy_j.get(horizon).copied().filter(|_| is_known)
    }

    /// Its lower and upper bound, J, if there are any.
    #[must_use]
    pub fn bounds_j(&self, horizon: usize) -> Option<(f32, f32)> {
        self.expected_j(horizon).filter(|_| horizon < usize::from(self.bounded))?;
        Some((self.energy_lo_j[horizon], self.energy_hi_j[horizon]))
    }
}

rows! {
    /// Header of a frame of [`Outlook`]s.
    #[derive(Eq)]
    pub struct OutlookHeader: "joulebus.OutlookHeader.v1", 64 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the worker.
        pub pid: u32,
        /// As in [`crate::ForecastHeader::worker_epoch`].
        #[run]
        pub worker_epoch: u64,
        /// As in [`crate::ForecastHeader::tick`].
        pub tick: u64,
        /// Period of the tick, ns: a frame older than two of these is stale.
        pub period_ns: u64,
        /// Hash of all models, as in [`crate::ForecastHeader::model_hash`].
        pub model_hash: u64,
        /// When the tick began to compute, monotonic ns.
        #[instant]
        pub compute_start_ns: u64,
        /// When the frame was sent, monotonic ns.
        #[instant]
        pub sent_ns: u64,
        /// When the frame was sent, Unix ns: informative only.
        pub sent_unix_ns: u64,
    }
}
