//! Forecasts of the worker.

use crate::InvalidReason;
use crate::declare::ZeroCopySend;
use crate::layout::bits;
use crate::rows;

bits! {
    /// Bits of [`Forecast::flags`].
    pub mod forecast_flag {
        /// `power_w` is known.
        pub const POWER: u32 = 1 << 0;
        /// `lo_w` and `hi_w` are known.
        pub const INTERVAL: u32 = 1 << 1;
        /// `reading_w` and `reading_age_ns` are known.
        pub const READING: u32 = 1 << 2;
        /// `sample_seq`, `stamp_ns` and `target_ns` are known: a sample has been accepted.
        pub const SAMPLE: u32 = 1 << 3;
    }
}

rows! {
    /// One robot's forecast. 72 bytes.
    pub struct Forecast: "joulebus.Forecast.v1", 72 {
        /// Id of the robot.
        pub robot: u32,
        /// [`forecast_flag`] bits.
        pub flags: u32,
        /// [`Quality`] code.
        pub quality: u16,
        /// Detail of the quality: readings held so far, open-loop steps, or the reason.
        pub quality_detail: u16,
        /// The last accepted reading, W.
        pub reading_w: f32,
        /// Power expected at `target_ns`, W.
        pub power_w: f32,
        /// Lower end of the interval, W.
        pub lo_w: f32,
        /// Upper end of the interval, W.
        pub hi_w: f32,
        /// Number of times the robot's slot has been reassigned.
        pub generation: u32,
        /// [`crate::Sample::seq`] of the sample that this forecast is based on.
        pub sample_seq: u64,
        /// [`crate::Sample::stamp_ns`] of that sample.
        #[instant]
        pub stamp_ns: u64,
        /// Stamp for which the reading is forecast, monotonic ns.
        #[instant]
        pub target_ns: u64,
        /// From the measurement of `reading_w` to `stamp_ns`, ns.
        pub reading_age_ns: u64,
        /// [`crate::SampleHeader::source_epoch`] of that sample.
        #[run]
        pub source_epoch: u64,
    }
}

impl Forecast {
    /// The forecast's quality.
    pub const fn quality(&self) -> Quality {
        Quality::decode(self.quality, self.quality_detail)
    }

    /// The power expected, W, if there is a forecast.
    pub const fn expected_w(&self) -> Option<f32> {
        if self.flags & forecast_flag::POWER != 0 { Some(self.power_w) } else { None }
    }

    /// Lower and upper end of the interval, W, if there is one.
    pub const fn interval_w(&self) -> Option<(f32, f32)> {
        if self.flags & forecast_flag::INTERVAL != 0 { Some((self.lo_w, self.hi_w)) } else { None }
    }
}

/// Quality of a robot's output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Quality {
    /// Made from a new measurement.
    Fresh,
    /// Made from a repeated measurement.
    Held,
    /// The lag window holds `have` of its five readings: no forecast yet.
    Warmup {
        /// Readings in the window.
        have: u16,
    },
    /// No valid reading for `steps` sample periods: the model runs on its own forecasts.
    OpenLoop {
        /// Sample periods since the last reading.
        steps: u16,
    },
    /// No forecast, with the reason.
    Invalid(InvalidReason),
    /// Written by a newer version than this reader.
    Unknown,
}

impl Quality {
    /// Code and detail as they lie in shared memory.
    pub const fn encode(self) -> (u16, u16) {
        match self {
            Self::Unknown => (0, 0),
            Self::Fresh => (1, 0),
            Self::Held => (2, 0),
            Self::Warmup { have } => (3, have),
            Self::OpenLoop { steps } => (4, steps),
            Self::Invalid(reason) => (5, reason.code()),
        }
    }

    /// From shared memory. A code that this version does not know is [`Quality::Unknown`].
    #[must_use]
    pub const fn decode(code: u16, detail: u16) -> Self {
        match code {
            1 => Self::Fresh,
            2 => Self::Held,
            3 => Self::Warmup { have: detail },
            4 => Self::OpenLoop { steps: detail },
            5 => Self::Invalid(InvalidReason::decode(detail)),
            _ => Self::Unknown,
        }
    }
}

rows! {
    /// Header of a frame of forecasts: timing of the tick and counters of sample ingest.
    #[derive(Eq)]
    pub struct ForecastHeader: "joulebus.ForecastHeader.v1", 320 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the worker.
        pub pid: u32,
        /// When this run of the worker began, monotonic ns: a restart has a greater one, however
        /// the wall clock was set.
        #[run]
        pub worker_epoch: u64,
        /// Number of this tick within the epoch, from 1.
        pub tick: u64,
        /// Period of the tick, ns: a frame older than two of these is stale.
        pub period_ns: u64,
        /// Hash of the model in use. Where platforms use different models: a combination of their
        /// hashes, in the order of the platforms.
        pub model_hash: u64,
        /// Robots that the worker has capacity for.
        pub capacity: u32,
        /// Frames of samples taken in this tick.
        pub frames_taken: u32,
        /// [`crate::SampleHeader::intended_ns`] of the first frame taken in this tick. 0 if none
        /// was.
        #[instant]
        pub first_intended_ns: u64,
        /// [`crate::SampleHeader::sent_ns`] of that frame. 0 if none was taken.
        #[instant]
        pub first_sent_ns: u64,
        /// When the worker took that frame, monotonic ns. 0 if none was taken.
        #[instant]
        pub first_taken_ns: u64,
        /// When the tick began to compute, monotonic ns.
        #[instant]
        pub compute_start_ns: u64,
        /// When the last forecast was written, monotonic ns.
        #[instant]
        pub compute_end_ns: u64,
        /// When the frame was sent, monotonic ns.
        #[instant]
        pub sent_ns: u64,
        /// When the frame was sent, Unix ns: informative only.
        pub sent_unix_ns: u64,
        /// Ticks skipped in this epoch because the one before took too long.
        pub ticks_skipped: u64,
        /// Ticks in this epoch that started more than a tenth of a period after they were due.
        pub ticks_late: u64,
        /// Samples of this epoch: accepted.
        pub samples_accepted: u64,
        /// Samples of this epoch: dropped, by reason.
        pub samples_dropped: crate::DropCounts,
    }
}
