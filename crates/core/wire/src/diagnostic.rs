//! Residual scores and alarms per robot.

use crate::declare::ZeroCopySend;
use crate::layout::{bits, names};
use crate::rows;

bits! {
    /// Bits of [`Diagnostic::flags`].
    pub mod diagnostic_flag {
        /// `residual_w` and `residual_z` belong to the sample `sample_seq`. Otherwise they are NaN.
        pub const RESIDUAL: u32 = 1 << 0;
        /// At least one residual has been scored.
        pub const SCORES: u32 = 1 << 1;
        /// The forecast learns online: the fields from `network_w` to `level_w` are known.
        /// Otherwise they are NaN.
        pub const LEARNED: u32 = 1 << 2;
    }
}

rows! {
    /// One robot's diagnostics. 176 bytes.
    pub struct Diagnostic: "joulebus.Diagnostic.v2", 176 {
        /// Id of the robot.
        pub robot: u32,
        /// [`diagnostic_flag`] bits.
        pub flags: u32,
        /// [`Level`] code.
        pub level: u16,
        /// [`Alarm`] code of the most important alarm.
        pub alarm: u16,
        /// All alarms that are raised: [`AlarmSet`] bits.
        pub alarms: u32,
        /// Reading minus what the network forecast for it, W, whatever was published.
        pub residual_w: f32,
        /// The residual over the model's own residual standard deviation.
        pub residual_z: f32,
        /// Exponentially weighted mean of the residuals, W.
        pub bias_w: f32,
        /// NaN: retired with BiasHigh.
        pub cusum_up: f32,
        /// NaN: retired with BiasLow.
        pub cusum_down: f32,
        /// Exponentially weighted mean of the squared whitened residual: 1 for a healthy robot.
        pub noise_ratio: f32,
        /// Share of readings that fell inside their interval, over the whole epoch.
        pub coverage: f32,
        /// The same, exponentially weighted: recent coverage.
        pub coverage_recent: f32,
        /// Residuals scored so far.
        pub scored: u64,
        /// Mean absolute residual, W.
        pub mae_w: f64,
        /// Coefficient of determination of the forecasts.
        pub r2: f64,
        /// Mean absolute error of persistence (the last reading again) on the same readings, W.
        pub persistence_mae_w: f64,
        /// Coefficient of determination of persistence.
        pub persistence_r2: f64,
        /// 1 − (squared error of the forecasts / squared error of persistence).
        pub skill: f64,
        /// [`crate::Sample::seq`] of the newest sample accepted.
        pub sample_seq: u64,
        /// [`crate::Sample::stamp_ns`] of that sample.
        #[instant]
        pub stamp_ns: u64,
        /// [`crate::SampleHeader::source_epoch`] of that sample.
        #[run]
        pub source_epoch: u64,
        /// Samples of this robot that were refused in this epoch.
        pub refused: u64,
        /// The network's own forecast of the next reading, W, whatever is published.
        pub network_w: f32,
        /// Mean of the readings, W. The newest counts 1/256 at least.
        pub mean_w: f32,
        /// Mean size of the changes between new measurements, W.
        pub change_w: f32,
        /// Weight of the last reading where a new measurement is due, 0 to 1.
        pub weight_last: f32,
        /// Weight of the network there.
        pub weight_network: f32,
        /// Weight of the stack there.
        pub weight_stack: f32,
        /// Weight of the last reading where the measurement will be held.
        pub held_weight_last: f32,
        /// Weight of the stack there.
        pub held_weight_stack: f32,
        /// Gain of the last reading within the stack: signed, on its deviation from the model's
        /// autoregression.
        pub gain_last: f32,
        /// Gain of the network.
        pub gain_network: f32,
        /// Gain of the mean of the readings.
        pub gain_mean: f32,
        /// Level that the stack adds, W.
        pub level_w: f32,
    }
}

impl Diagnostic {
    /// The level.
    pub const fn level(&self) -> Level {
        Level::decode(self.level)
    }

    /// The most important alarm.
    pub const fn alarm(&self) -> Alarm {
        Alarm::decode(self.alarm)
    }

    /// All alarms that are raised.
    pub const fn alarms(&self) -> AlarmSet {
        AlarmSet(self.alarms)
    }
}

rows! {
    /// Header of a frame of diagnostics.
    pub struct DiagnosticHeader: "joulebus.DiagnosticHeader.v2", 856 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the worker.
        pub pid: u32,
        /// As in [`crate::ForecastHeader::worker_epoch`].
        #[run]
        pub worker_epoch: u64,
        /// As in [`crate::ForecastHeader::tick`].
        pub tick: u64,
        /// Recent refusals. See [`DiagnosticHeader::refusals`].
        pub refused: [crate::Refusal; 16],
        /// What the robots of each platform have shown, in the order of the config. Of the first
        /// 16 platforms.
        pub platforms: [crate::PlatformMemory; 16],
    }
}

impl DiagnosticHeader {
    /// Recent refusals: the newest 16 pairs of robot and reason, unordered.
    pub fn refusals(&self) -> impl Iterator<Item = &crate::Refusal> {
        self.refused.iter().filter(|refusal| refusal.reason != 0)
    }
}

/// Levels as in ROS `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// No alarm.
    Ok,
    /// Needs attention.
    Warn,
    /// Must not be relied on.
    Error,
    /// No data arrives.
    Stale,
}

impl Level {
    /// The code in shared memory: 0 to 3, as in `diagnostic_msgs`.
    pub const fn code(self) -> u16 {
        self as u16
    }

    /// The name, as in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warn => "warn",
            Self::Error => "error",
            Self::Stale => "stale",
        }
    }

    /// From shared memory. An unknown code decodes to [`Level::Error`].
    #[must_use]
    pub const fn decode(code: u16) -> Self {
        match code {
            0 => Self::Ok,
            1 => Self::Warn,
            3 => Self::Stale,
            _ => Self::Error,
        }
    }
}

/// Reason that a robot is not [`Level::Ok`], most important first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Alarm {
    /// No sample for longer than `stale_after`.
    NoData,
    /// The last samples were refused: values outside the platform's limits.
    OutOfRange,
    /// The reading has not changed for longer than the platform's monitor can explain.
    StuckSensor,
    /// The same measurement has been repeated for too long.
    HeldTooLong,
    /// Drew persistently more than forecast. Retired: this version never raises it.
    BiasHigh,
    /// Drew persistently less than forecast. Retired: this version never raises it.
    BiasLow,
    /// Residuals scatter much more than in training.
    NoiseHigh,
    /// The forecasts are clearly worse than repeating the last reading, or the robot is of another
    /// kind than those of the training.
    ModelMismatch,
    /// A feature lies outside the range the model was trained on.
    OutOfTraining,
    /// On the charger.
    OfflineCharging,
    /// The tick that computed this started too late.
    DeadlineMissed,
    /// The robot's watchdog stopped it. Reserved: this version never raises it.
    WatchdogStop,
    /// The energy that is certainly left is below what the robot needs to return.
    CannotReturn,
    /// The state of charge is below the platform's critical level.
    BatteryCritical,
    /// The state of charge is below the platform's low level.
    BatteryLow,
    /// The measured state of charge does not follow the energy drawn, or jumps. It is not used.
    SocImplausible,
    /// Drawing more than it did before for the same commands.
    LevelHigh,
    /// Drawing less than it did before for the same commands.
    LevelLow,
    /// The learned capacity of the battery is below four fifths of the stated one.
    BatteryWorn,
    /// No alarm.
    None,
    /// Written by something newer than this reader.
    Unknown,
}

names! {
    /// All alarms that can be raised, in the order of their codes. The most important of a level
    /// comes first.
    pub Alarm:
        NoData OutOfRange StuckSensor HeldTooLong BiasHigh BiasLow NoiseHigh ModelMismatch
        OutOfTraining OfflineCharging DeadlineMissed WatchdogStop CannotReturn BatteryCritical
        BatteryLow SocImplausible LevelHigh LevelLow BatteryWorn
        ;
        None Unknown
}

impl Alarm {
    /// The code in shared memory: 0 is [`Alarm::None`].
    pub const fn code(self) -> u16 {
        match self {
            Self::None => 0,
            Self::Unknown => u16::MAX,
            raised => raised as u16 + 1,
        }
    }

    /// From shared memory.
    #[must_use]
    pub const fn decode(code: u16) -> Self {
        if code == 0 {
            Self::None
        } else if code as usize <= Self::ALL.len() {
            Self::ALL[code as usize - 1]
        } else {
            Self::Unknown
        }
    }
}

/// A set of alarms, one bit each: bit `code − 1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AlarmSet(pub u32);

impl AlarmSet {
    /// With `alarm` raised.
    #[must_use]
    pub const fn with(self, alarm: Alarm) -> Self {
        Self(self.0 | Self::bit(alarm))
    }

    /// Without `alarm`.
    #[must_use]
    pub const fn without(self, alarm: Alarm) -> Self {
        Self(self.0 & !Self::bit(alarm))
    }

    /// True if `alarm` is raised.
    #[must_use]
    pub const fn has(self, alarm: Alarm) -> bool {
        self.0 & Self::bit(alarm) != 0
    }

    /// The most important alarm of the set: the first of the worst level.
    #[must_use]
    pub fn first(self) -> Alarm {
        let level = self.level();
        let mut worst = self.iter().filter(|alarm| alarm.level() == level);
        worst.next().unwrap_or(Alarm::None)
    }

    /// The alarm to name where there is room for one: the most important one, but a cause before its
    /// consequence. Of a robot whose samples are refused, `OutOfRange` and not `NoData`.
    #[must_use]
    pub fn cause(self) -> Alarm {
        match self.first() {
            Alarm::NoData if self.has(Alarm::OutOfRange) => Alarm::OutOfRange,
            first => first,
        }
    }

    /// The worst level of the set.
    #[must_use]
    pub fn level(self) -> Level {
        self.iter().map(Alarm::level).max().unwrap_or(Level::Ok)
    }

    /// The alarms of the set, in the order of their codes.
    pub fn iter(self) -> impl Iterator<Item = Alarm> {
        Alarm::ALL.into_iter().filter(move |alarm| self.has(*alarm))
    }

    /// All alarms of both sets.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    const fn bit(alarm: Alarm) -> u32 {
        match alarm {
            Alarm::None | Alarm::Unknown => 0,
            raised => 1 << (raised as u32),
        }
    }
}
