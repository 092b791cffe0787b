//! The state from which a forecast of the energy of a plan starts, per robot.

use crate::Quality;
use crate::declare::ZeroCopySend;
use crate::layout::bits;
use crate::rows;

bits! {
    /// Bits of [`PlanState::flags`].
    pub mod plan_state_flag {
        /// A sample has been accepted: `stamp_ns` is known.
        pub const SAMPLE: u32 = 1 << 0;
        /// The lag window is full: all five `lag_w` are known.
        pub const LAGS: u32 = 1 << 1;
        /// `v_mps` and `omega_radps` are known.
        pub const COMMAND: u32 = 1 << 2;
        /// `age_steps` and `interval_steps` are known.
        pub const READING_AGE: u32 = 1 << 3;
        /// The robot's forecasts learn online: the fields from `network_w` to `level_w` are known.
        pub const LEARNED: u32 = 1 << 4;
        /// The last row of the model lay outside the range that it was trained on.
        pub const OUTSIDE_TRAINING: u32 = 1 << 5;
        /// The alarm `NoData` is raised: no sample for too long.
        pub const ALARM_NO_DATA: u32 = 1 << 6;
        /// The alarm `OutOfRange` is raised: samples are refused.
        pub const ALARM_OUT_OF_RANGE: u32 = 1 << 7;
        /// The alarm `StuckSensor` is raised: the reading does not change.
        pub const ALARM_STUCK_SENSOR: u32 = 1 << 8;
        /// The alarm `HeldTooLong` is raised: the same measurement is repeated.
        pub const ALARM_HELD_TOO_LONG: u32 = 1 << 9;
        /// The alarm `SocImplausible` is raised: the measured state of charge is not used.
        pub const ALARM_SOC_IMPLAUSIBLE: u32 = 1 << 10;
        /// The alarm `Implausible` is raised: the source doubts what it reports.
        pub const ALARM_IMPLAUSIBLE: u32 = 1 << 11;
    }
}

rows! {
    /// State from which plans of one robot start. 208 bytes.
    ///
    /// While the robot's next sample is overdue, lag window and reading age include `open_steps`
    /// periods that the model bridged with its own forecasts, as the forecast published in the same
    /// tick does.
    pub struct PlanState: "joulebus.PlanState.v2", 208 {
        /// Id of the robot.
        pub robot: u32,
        /// [`plan_state_flag`] bits.
        pub flags: u32,
        /// [`Quality`] code, as of the forecast of the same tick.
        pub quality: u16,
        /// Detail of the quality.
        pub quality_detail: u16,
        /// Place of the robot's platform, and so of its model, in the config.
        pub platform: u16,
        /// Sample periods since the last reading. Those by the worker's clock are included.
        pub open_steps: u16,
        /// Samples since the last measurement, 0 to 254. 255 before the first.
        pub age_steps: u16,
        /// Samples from one measurement to the next, 1 to 255. 0 until two have been seen.
        pub interval_steps: u16,
        /// Number of times the robot's slot has been reassigned.
        pub generation: u32,
        /// [`crate::Sample::stamp_ns`] of the last accepted sample.
        #[instant]
        pub stamp_ns: u64,
        /// The command in force, m/s.
        pub v_mps: f32,
        /// The command in force, rad/s.
        pub omega_radps: f32,
        /// The last reading, W.
        pub lag1_w: f32,
        /// The one before it, W.
        pub lag2_w: f32,
        /// The third, W.
        pub lag3_w: f32,
        /// The fourth, W.
        pub lag4_w: f32,
        /// The fifth, W.
        pub lag5_w: f32,
        /// The network's own forecast of the next reading, W.
        pub network_w: f32,
        /// Mean of the readings, W.
        pub mean_w: f32,
        /// Mean size of the changes between new measurements, W.
        pub change_w: f32,
        /// Weight of the last reading where a new measurement is due.
        pub weight_last: f32,
        /// Weight of the network there.
        pub weight_network: f32,
        /// Weight of the stack there.
        pub weight_stack: f32,
        /// Weight of the stack where it will be held. The rest is that of the last reading.
        pub held_weight_stack: f32,
        /// Gain of the last reading within the stack.
        pub gain_last: f32,
        /// Gain of the network within the stack.
        pub gain_network: f32,
        /// Gain of the mean of the readings within the stack.
        pub gain_mean: f32,
        /// Level that the stack adds, W.
        pub level_w: f32,
        /// Recent mean size of the residuals where a new measurement is due, W.
        pub size_due_w: f32,
        /// Distance of the interval's lower end from the forecast there, in sizes.
        pub below_due: f32,
        /// Distance of its upper end, in sizes.
        pub above_due: f32,
        /// Recent mean size of the residuals where a reading is held, W.
        pub size_held_w: f32,
        /// Distance of the interval's lower end there, in sizes.
        pub below_held: f32,
        /// Distance of its upper end, in sizes.
        pub above_held: f32,
        /// Discounted energy over the time constants of `joulebus_energy::LEVELS_S`, J.
        pub energy_j: [f32; 4],
        /// What the platform's command model says of the same time, J.
        pub command_j: [f32; 4],
        /// Discounted time, s. 0 before the first metered reading.
        pub time_s: [f32; 4],
        /// Lower bounds of the energy's 90 % interval at the horizons of
        /// `joulebus_energy::SHADOWS_S`, in half widths from the middle of the trained one.
        pub error_lower: [f32; 3],
        /// Its upper bounds. −1 and 1 are the trained interval.
        pub error_upper: [f32; 3],
        /// How far the commands explain this robot's power, 0 to 1: 1 as far as the platform's.
        pub command_trust: f32,
        /// 0.
        pub reserved: u32,
    }
}

impl PlanState {
    /// The robot's quality.
    pub const fn quality(&self) -> Quality {
        Quality::decode(self.quality, self.quality_detail)
    }

    /// The last five readings, W, newest first, if all are known.
    pub const fn lags_w(&self) -> Option<[f32; 5]> {
        if self.flags & plan_state_flag::LAGS == 0 {
            return None;
        }
        Some([self.lag1_w, self.lag2_w, self.lag3_w, self.lag4_w, self.lag5_w])
    }

    /// The command in force, m/s and rad/s, if it is known.
    pub const fn command(&self) -> Option<(f32, f32)> {
        if self.flags & plan_state_flag::COMMAND != 0 {
            Some((self.v_mps, self.omega_radps))
        } else {
            None
        }
    }
}

/// Platforms whose models a header lists.
pub const LISTED_MODELS: usize = 16;

rows! {
    /// Header of a frame of [`PlanState`]s. A planner computes with models and settings of its own:
    /// the hashes tell whether they are the worker's.
    #[derive(Eq)]
    pub struct PlanStateHeader: "joulebus.PlanStateHeader.v1", 200 {
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
        /// Hash of the fleet's settings.
        pub settings_hash: u64,
        /// Hash of all models, as in [`crate::ForecastHeader::model_hash`].
        pub model_hash: u64,
        /// Hash of each platform's model. 0 beyond the last platform, and beyond [`LISTED_MODELS`].
        pub models: [u64; LISTED_MODELS],
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
