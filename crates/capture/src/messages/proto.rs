//! The messages as they lie in a capture: the Rust side of `proto/joulebus/*.proto`. A test holds the
//! two together.

use prost_types::Timestamp;

/// How far a robot's output can be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, prost::Enumeration)]
#[repr(i32)]
pub(crate) enum Quality {
    Unknown = 0,
    Fresh = 1,
    Held = 2,
    Warmup = 3,
    OpenLoop = 4,
    Invalid = 5,
}

/// Levels as in ROS diagnostic_msgs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, prost::Enumeration)]
#[repr(i32)]
pub(crate) enum Level {
    Ok = 0,
    Warn = 1,
    Error = 2,
    Stale = 3,
}

/// Why a robot is not OK, most important first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, prost::Enumeration)]
#[repr(i32)]
pub(crate) enum Alarm {
    None = 0,
    NoData = 1,
    OutOfRange = 2,
    StuckSensor = 3,
    HeldTooLong = 4,
    BiasHigh = 5,
    BiasLow = 6,
    NoiseHigh = 7,
    ModelMismatch = 8,
    OutOfTraining = 9,
    OfflineCharging = 10,
    DeadlineMissed = 11,
    WatchdogStop = 12,
}

/// Whether the battery is filling.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, prost::Enumeration)]
#[repr(i32)]
pub(crate) enum ChargeState {
    Unknown = 0,
    Discharging = 1,
    Charging = 2,
}

/// Why a sample was not accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, prost::Enumeration)]
#[repr(i32)]
pub(crate) enum DropReason {
    None = 0,
    UnknownRobot = 1,
    OverCapacity = 2,
    ForeignSource = 3,
    OldEpoch = 4,
    Duplicate = 5,
    OutOfOrder = 6,
    BadTime = 7,
    NotFinite = 8,
    PowerOutOfRange = 9,
    CommandOutOfRange = 10,
    BadFlags = 11,
    Backlog = 12,
    Overflow = 13,
    Schema = 14,
    BeforeJoin = 15,
    TooManySources = 16,
}

/// Samples dropped, by reason.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct DropCounts {
    #[prost(uint64, tag = "1")]
    pub(crate) unknown_robot: u64,
    #[prost(uint64, tag = "2")]
    pub(crate) over_capacity: u64,
    #[prost(uint64, tag = "3")]
    pub(crate) foreign_source: u64,
    #[prost(uint64, tag = "4")]
    pub(crate) old_epoch: u64,
    #[prost(uint64, tag = "5")]
    pub(crate) duplicate: u64,
    #[prost(uint64, tag = "6")]
    pub(crate) out_of_order: u64,
    #[prost(uint64, tag = "7")]
    pub(crate) bad_time: u64,
    #[prost(uint64, tag = "8")]
    pub(crate) not_finite: u64,
    #[prost(uint64, tag = "9")]
    pub(crate) power_out_of_range: u64,
    #[prost(uint64, tag = "10")]
    pub(crate) command_out_of_range: u64,
    #[prost(uint64, tag = "11")]
    pub(crate) bad_flags: u64,
    #[prost(uint64, tag = "12")]
    pub(crate) backlog: u64,
    #[prost(uint64, tag = "13")]
    pub(crate) overflow: u64,
    #[prost(uint64, tag = "14")]
    pub(crate) schema: u64,
    #[prost(uint64, tag = "15")]
    pub(crate) before_join: u64,
    #[prost(uint64, tag = "16")]
    pub(crate) too_many_sources: u64,
    #[prost(uint64, repeated, tag = "17")]
    pub(crate) later: Vec<u64>,
}

/// One robot's refusals for one reason.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Refusal {
    #[prost(uint32, tag = "1")]
    pub(crate) robot: u32,
    #[prost(enumeration = "DropReason", tag = "2")]
    pub(crate) reason: i32,
    #[prost(uint32, tag = "3")]
    pub(crate) pid: u32,
    #[prost(uint32, tag = "4")]
    pub(crate) count: u32,
}

/// One robot's command and latest reading in one control tick.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Sample {
    #[prost(uint32, tag = "1")]
    pub(crate) robot: u32,
    #[prost(uint32, tag = "2")]
    pub(crate) flags: u32,
    #[prost(uint64, tag = "3")]
    pub(crate) seq: u64,
    #[prost(fixed64, tag = "4")]
    pub(crate) stamp_ns: u64,
    #[prost(fixed64, tag = "5")]
    pub(crate) measured_ns: u64,
    #[prost(float, optional, tag = "6")]
    pub(crate) v_mps: Option<f32>,
    #[prost(float, optional, tag = "7")]
    pub(crate) omega_radps: Option<f32>,
    #[prost(float, optional, tag = "8")]
    pub(crate) power_w: Option<f32>,
    #[prost(float, optional, tag = "9")]
    pub(crate) voltage_v: Option<f32>,
    #[prost(float, optional, tag = "10")]
    pub(crate) current_a: Option<f32>,
    #[prost(uint32, tag = "11")]
    pub(crate) reserved: u32,
}

/// One robot's forecast.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Forecast {
    #[prost(uint32, tag = "1")]
    pub(crate) robot: u32,
    #[prost(uint32, tag = "2")]
    pub(crate) flags: u32,
    #[prost(enumeration = "Quality", tag = "3")]
    pub(crate) quality: i32,
    #[prost(uint32, tag = "4")]
    pub(crate) quality_detail: u32,
    #[prost(float, optional, tag = "5")]
    pub(crate) reading_w: Option<f32>,
    #[prost(float, optional, tag = "6")]
    pub(crate) power_w: Option<f32>,
    #[prost(float, optional, tag = "7")]
    pub(crate) lo_w: Option<f32>,
    #[prost(float, optional, tag = "8")]
    pub(crate) hi_w: Option<f32>,
    #[prost(uint32, tag = "9")]
    pub(crate) generation: u32,
    #[prost(uint64, tag = "10")]
    pub(crate) sample_seq: u64,
    #[prost(fixed64, tag = "11")]
    pub(crate) stamp_ns: u64,
    #[prost(fixed64, tag = "12")]
    pub(crate) target_ns: u64,
    #[prost(uint64, tag = "13")]
    pub(crate) reading_age_ns: u64,
    #[prost(fixed64, tag = "14")]
    pub(crate) source_epoch: u64,
}

/// One robot's diagnostics.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Diagnostic {
    #[prost(uint32, tag = "1")]
    pub(crate) robot: u32,
    #[prost(uint32, tag = "2")]
    pub(crate) flags: u32,
    #[prost(enumeration = "Level", tag = "3")]
    pub(crate) level: i32,
    #[prost(enumeration = "Alarm", tag = "4")]
    pub(crate) alarm: i32,
    #[prost(uint32, tag = "5")]
    pub(crate) alarms: u32,
    #[prost(float, optional, tag = "6")]
    pub(crate) residual_w: Option<f32>,
    #[prost(float, optional, tag = "7")]
    pub(crate) residual_z: Option<f32>,
    #[prost(float, optional, tag = "8")]
    pub(crate) bias_w: Option<f32>,
    #[prost(float, optional, tag = "9")]
    pub(crate) cusum_up: Option<f32>,
    #[prost(float, optional, tag = "10")]
    pub(crate) cusum_down: Option<f32>,
    #[prost(float, optional, tag = "11")]
    pub(crate) noise_ratio: Option<f32>,
    #[prost(float, optional, tag = "12")]
    pub(crate) coverage: Option<f32>,
    #[prost(float, optional, tag = "13")]
    pub(crate) coverage_recent: Option<f32>,
    #[prost(uint64, tag = "14")]
    pub(crate) scored: u64,
    #[prost(double, optional, tag = "15")]
    pub(crate) mae_w: Option<f64>,
    #[prost(double, optional, tag = "16")]
    pub(crate) r2: Option<f64>,
    #[prost(double, optional, tag = "17")]
    pub(crate) persistence_mae_w: Option<f64>,
    #[prost(double, optional, tag = "18")]
    pub(crate) persistence_r2: Option<f64>,
    #[prost(double, optional, tag = "19")]
    pub(crate) skill: Option<f64>,
    #[prost(uint64, tag = "20")]
    pub(crate) sample_seq: u64,
    #[prost(fixed64, tag = "21")]
    pub(crate) stamp_ns: u64,
    #[prost(fixed64, tag = "22")]
    pub(crate) source_epoch: u64,
    #[prost(uint64, tag = "23")]
    pub(crate) refused: u64,
}

/// One robot's budget.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Budget {
    #[prost(uint32, tag = "1")]
    pub(crate) robot: u32,
    #[prost(uint32, tag = "2")]
    pub(crate) flags: u32,
    #[prost(enumeration = "ChargeState", tag = "3")]
    pub(crate) charge_state: i32,
    #[prost(uint32, tag = "4")]
    pub(crate) reserved: u32,
    #[prost(int64, tag = "5")]
    pub(crate) drawn_uj: i64,
    #[prost(int64, tag = "6")]
    pub(crate) drawn_remainder: i64,
    #[prost(int64, tag = "7")]
    pub(crate) forecast_uj: i64,
    #[prost(uint64, tag = "8")]
    pub(crate) metered_ns: u64,
    #[prost(uint64, tag = "9")]
    pub(crate) unmetered_ns: u64,
    #[prost(fixed64, tag = "10")]
    pub(crate) stamp_ns: u64,
    #[prost(fixed64, tag = "11")]
    pub(crate) valid_until_ns: u64,
    #[prost(float, optional, tag = "12")]
    pub(crate) mean_power_w: Option<f32>,
    #[prost(float, optional, tag = "13")]
    pub(crate) left_j: Option<f32>,
    #[prost(float, optional, tag = "14")]
    pub(crate) usable_j: Option<f32>,
    #[prost(float, optional, tag = "15")]
    pub(crate) usable_lo_j: Option<f32>,
    #[prost(float, optional, tag = "16")]
    pub(crate) soc: Option<f32>,
    #[prost(float, optional, tag = "17")]
    pub(crate) soc_lo: Option<f32>,
    #[prost(float, optional, tag = "18")]
    pub(crate) time_to_empty_s: Option<f32>,
    #[prost(float, optional, tag = "19")]
    pub(crate) time_to_empty_lo_s: Option<f32>,
    #[prost(float, optional, tag = "20")]
    pub(crate) time_to_empty_hi_s: Option<f32>,
    #[prost(uint32, tag = "21")]
    pub(crate) reserved2: u32,
}

/// One frame of samples that a tick took.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct TakenFrame {
    #[prost(fixed64, tag = "1")]
    pub(crate) source_id: u64,
    #[prost(fixed64, tag = "2")]
    pub(crate) source_epoch: u64,
    #[prost(uint64, tag = "3")]
    pub(crate) frame_seq: u64,
    #[prost(fixed64, tag = "4")]
    pub(crate) taken_ns: u64,
    #[prost(uint32, tag = "5")]
    pub(crate) samples: u32,
    #[prost(uint32, tag = "6")]
    pub(crate) truncated: u32,
}

/// A frame of samples: what one source sends at once.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Samples {
    #[prost(uint32, tag = "1")]
    pub(crate) schema: u32,
    #[prost(uint32, tag = "2")]
    pub(crate) pid: u32,
    #[prost(fixed64, tag = "3")]
    pub(crate) source_id: u64,
    #[prost(fixed64, tag = "4")]
    pub(crate) source_epoch: u64,
    #[prost(uint64, tag = "5")]
    pub(crate) frame_seq: u64,
    #[prost(uint64, tag = "6")]
    pub(crate) samples_before: u64,
    #[prost(fixed64, tag = "7")]
    pub(crate) intended_ns: u64,
    #[prost(fixed64, tag = "8")]
    pub(crate) sent_ns: u64,
    #[prost(message, optional, tag = "9")]
    pub(crate) sent_at: Option<Timestamp>,
    #[prost(message, repeated, tag = "20")]
    pub(crate) samples: Vec<Sample>,
}

/// A tick's forecasts, and how the intake stands.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Forecasts {
    #[prost(uint32, tag = "1")]
    pub(crate) schema: u32,
    #[prost(uint32, tag = "2")]
    pub(crate) pid: u32,
    #[prost(fixed64, tag = "3")]
    pub(crate) worker_epoch: u64,
    #[prost(uint64, tag = "4")]
    pub(crate) tick: u64,
    #[prost(uint64, tag = "5")]
    pub(crate) period_ns: u64,
    #[prost(fixed64, tag = "6")]
    pub(crate) model_hash: u64,
    #[prost(uint32, tag = "7")]
    pub(crate) capacity: u32,
    #[prost(uint32, tag = "8")]
    pub(crate) frames_taken: u32,
    #[prost(fixed64, tag = "9")]
    pub(crate) first_intended_ns: u64,
    #[prost(fixed64, tag = "10")]
    pub(crate) first_sent_ns: u64,
    #[prost(fixed64, tag = "11")]
    pub(crate) first_taken_ns: u64,
    #[prost(fixed64, tag = "12")]
    pub(crate) compute_start_ns: u64,
    #[prost(fixed64, tag = "13")]
    pub(crate) compute_end_ns: u64,
    #[prost(fixed64, tag = "14")]
    pub(crate) sent_ns: u64,
    #[prost(message, optional, tag = "15")]
    pub(crate) sent_at: Option<Timestamp>,
    #[prost(uint64, tag = "16")]
    pub(crate) ticks_skipped: u64,
    #[prost(uint64, tag = "17")]
    pub(crate) ticks_late: u64,
    #[prost(uint64, tag = "18")]
    pub(crate) samples_accepted: u64,
    #[prost(message, optional, tag = "19")]
    pub(crate) samples_dropped: Option<DropCounts>,
    #[prost(message, repeated, tag = "30")]
    pub(crate) forecasts: Vec<Forecast>,
}

/// A tick's diagnostics.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Diagnostics {
    #[prost(uint32, tag = "1")]
    pub(crate) schema: u32,
    #[prost(uint32, tag = "2")]
    pub(crate) pid: u32,
    #[prost(fixed64, tag = "3")]
    pub(crate) worker_epoch: u64,
    #[prost(uint64, tag = "4")]
    pub(crate) tick: u64,
    #[prost(message, repeated, tag = "5")]
    pub(crate) refused: Vec<Refusal>,
    #[prost(message, repeated, tag = "20")]
    pub(crate) diagnostics: Vec<Diagnostic>,
}

/// A tick's budgets.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Budgets {
    #[prost(uint32, tag = "1")]
    pub(crate) schema: u32,
    #[prost(uint32, tag = "2")]
    pub(crate) pid: u32,
    #[prost(fixed64, tag = "3")]
    pub(crate) worker_epoch: u64,
    #[prost(uint64, tag = "4")]
    pub(crate) tick: u64,
    #[prost(fixed64, tag = "5")]
    pub(crate) sent_ns: u64,
    #[prost(message, optional, tag = "6")]
    pub(crate) sent_at: Option<Timestamp>,
    #[prost(message, repeated, tag = "20")]
    pub(crate) budgets: Vec<Budget>,
}

/// A tick's journal: which frames it took, in which order, at which time.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct Ticks {
    #[prost(uint32, tag = "1")]
    pub(crate) schema: u32,
    #[prost(uint32, tag = "2")]
    pub(crate) pid: u32,
    #[prost(fixed64, tag = "3")]
    pub(crate) worker_epoch: u64,
    #[prost(uint64, tag = "4")]
    pub(crate) tick: u64,
    #[prost(fixed64, tag = "5")]
    pub(crate) start_ns: u64,
    #[prost(fixed64, tag = "6")]
    pub(crate) sent_ns: u64,
    #[prost(uint32, tag = "7")]
    pub(crate) flags: u32,
    #[prost(uint32, tag = "8")]
    pub(crate) unlisted: u32,
    #[prost(message, repeated, tag = "20")]
    pub(crate) frames: Vec<TakenFrame>,
}

/// A piece of a keyframe: the worker's whole state at one tick.
#[derive(Clone, PartialEq, prost::Message)]
pub(crate) struct State {
    #[prost(uint32, tag = "1")]
    pub(crate) schema: u32,
    #[prost(uint32, tag = "2")]
    pub(crate) pid: u32,
    #[prost(fixed64, tag = "3")]
    pub(crate) worker_epoch: u64,
    #[prost(uint64, tag = "4")]
    pub(crate) tick: u64,
    #[prost(uint64, tag = "5")]
    pub(crate) total_bytes: u64,
    #[prost(uint64, tag = "6")]
    pub(crate) offset: u64,
    #[prost(fixed64, tag = "7")]
    pub(crate) taken_ns: u64,
    #[prost(fixed64, tag = "8")]
    pub(crate) sent_ns: u64,
    #[prost(message, optional, tag = "9")]
    pub(crate) sent_at: Option<Timestamp>,
    #[prost(bytes = "vec", tag = "20")]
    pub(crate) bytes: Vec<u8>,
}
