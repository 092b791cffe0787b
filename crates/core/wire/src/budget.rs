//! Energy drawn and energy left, per robot.

use crate::declare::ZeroCopySend;
use crate::layout::bits;
use crate::rows;

bits! {
    /// Bits of [`Budget::flags`].
    pub mod budget_flag {
        /// The platform's config describes a battery.
        pub const BATTERY: u32 = 1 << 0;
        /// Time to empty is known.
        pub const TIME_TO_EMPTY: u32 = 1 << 1;
        /// The ledger holds at least one sample.
        pub const LEDGER: u32 = 1 << 2;
        /// The robot has been on its charger since the ledger began.
        pub const CHARGED: u32 = 1 << 3;
        /// The state of charge contains a measured one.
        pub const MEASURED: u32 = 1 << 4;
        /// A measured state of charge says that less is left than was counted, and is not believed
        /// yet: the battery may be another one, and the bounds need not hold.
        pub const CONTRADICTED: u32 = 1 << 5;
        /// Energy left, usable and state of charge are known, with their bounds. Without it they
        /// are NaN: the battery may be full or empty.
        pub const CHARGE: u32 = 1 << 6;
        /// The robot has said that it is switched off: until its next sample it draws `idle_w`.
        pub const OFF: u32 = 1 << 7;
    }
}

rows! {
    /// One robot's budget. 176 bytes.
    ///
    /// The ledger part (`drawn_uj`, `drawn_remainder`, `metered_ns`, `unmetered_ns`, `stamp_ns`) is
    /// exact: `metered_ns + unmetered_ns` is the time from the first sample to `stamp_ns`. The
    /// energy left is counted from it and fused with measured states of charge. The truth lies
    /// between the bounds (`_lo`, `_hi`) with 95 % where the errors are as the platform's config
    /// says. They widen with unmetered time by all that the robot could have drawn.
    pub struct Budget: "joulebus.Budget.v4", 176 {
        /// Id of the robot.
        pub robot: u32,
        /// [`budget_flag`] bits.
        pub flags: u32,
        /// [`ChargeState`] code.
        pub charge_state: u32,
        /// Times that another battery was noticed: a measured state of charge that contradicted the
        /// counted one and lasted, or a sample that says so.
        pub battery_changes: u32,
        /// Energy drawn over the metered time, µJ.
        pub drawn_uj: i64,
        /// Remainder of the integral below one µJ, in µW·ns · 2: carried, so that no energy is
        /// rounded away.
        pub drawn_remainder: i64,
        /// Forecast energy over the same metered time, µJ.
        pub forecast_uj: i64,
        /// Time covered by readings, ns.
        pub metered_ns: u64,
        /// Time not covered by readings, ns.
        pub unmetered_ns: u64,
        /// Stamp of the newest sample in the ledger, monotonic ns.
        #[instant]
        pub stamp_ns: u64,
        /// Valid until, monotonic ns: `stamp_ns` plus the platform's `stale_after`.
        #[instant]
        pub valid_until_ns: u64,
        /// Mean power over the last minutes off the charger (exponentially weighted), W.
        pub mean_power_w: f32,
        /// Energy left in the battery, best estimate, J.
        pub left_j: f32,
        /// Usable energy above the reserve, best estimate, J.
        pub usable_j: f32,
        /// Lower bound of `usable_j`: unmetered time is charged at the platform's maximum power, J.
        pub usable_lo_j: f32,
        /// State of charge, 0 to 1.
        pub soc: f32,
        /// State of charge, lower bound.
        pub soc_lo: f32,
        /// Time until the reserve is reached at the power that is expected until then, s.
        pub time_to_empty_s: f32,
        /// The same, lower bound of the 90 % interval, s.
        pub time_to_empty_lo_s: f32,
        /// The same, its upper bound, s.
        pub time_to_empty_hi_s: f32,
        /// State of charge, upper bound.
        pub soc_hi: f32,
        /// Standard deviation of `soc`, by which probabilities are computed: errors of the monitor,
        /// and what is likely within the range of unmetered time.
        pub soc_sd: f32,
        /// Estimated error of the measured state of charge: measured minus true.
        pub sensor_bias: f32,
        /// Standard deviation of `sensor_bias`.
        pub sensor_bias_sd: f32,
        /// Covariance of `soc` and `sensor_bias`.
        pub sensor_covariance: f32,
        /// Mean power at rest over the last minutes at rest (exponentially weighted), W. NaN if
        /// unknown.
        pub idle_w: f32,
        /// Unmetered time since the charge was last measured, full or stated, s.
        pub pause_s: f32,
        /// By how much that time has lowered `soc_lo` at most, as a share.
        pub pause: f32,
        /// Learned capacity, J: energy left is the charge times it. NaN before anything is learned,
        /// when the stated one counts.
        pub capacity_j: f32,
        /// Its standard deviation, J. NaN before anything is learned.
        pub capacity_sd_j: f32,
        /// Weight of the pairs of known charges that it is learned from: 1 for one from full to
        /// empty, at most 2.5. 0 before anything is learned.
        pub capacity_weight: f32,
        /// Charging rate in each tenth of the charge, in thousandths of the capacity an hour. 0 if
        /// unknown.
        pub charge_rate: [u16; CHARGE_TENTHS],
        /// 0.
        pub reserved: u32,
    }
}

/// Parts of the charge whose charging rates are learned.
pub const CHARGE_TENTHS: usize = 10;
/// From this tenth on charging slows down, and each counts by itself. Those before it are alike.
const TAPER: usize = 8;

impl Budget {
    /// Energy drawn over the metered time, J.
    pub fn drawn_j(&self) -> f64 {
        self.drawn_uj as f64 * 1e-6
    }

    /// The learned capacity and its standard deviation, J. `None` before anything is learned.
    pub fn learned_capacity_j(&self) -> Option<(f32, f32)> {
        let is_learned = self.capacity_j > 0.0 && self.capacity_sd_j > 0.0;
        is_learned.then_some((self.capacity_j, self.capacity_sd_j))
    }

    /// Time on the charger between two states of charge, s. 0 if `to` is no more. `None` if a rate
    /// is unknown: below 80 %, the nearest known one is taken.
    #[must_use]
    pub fn charging_s(&self, from: f64, to: f64) -> Option<f64> {
        if !(0.0..=1.0).contains(&from) || !(0.0..=1.0).contains(&to) {
            return None;
        }
        let rates = self.charge_rate;
        let known = |tenth: usize| {
            let nearest = (0..TAPER).filter(|other| rates[*other] > 0);
            let nearest = || nearest.min_by_key(|other| other.abs_diff(tenth));
            let tenth = if tenth < TAPER { nearest()? } else { tenth };
            (rates[tenth] > 0).then_some(f64::from(rates[tenth]))
        };
        let seconds = (0..CHARGE_TENTHS).map(|tenth| {
            let share =
                |charge: f64| (charge * CHARGE_TENTHS as f64 - tenth as f64).clamp(0.0, 1.0);
            let part = (share(to) - share(from)) / CHARGE_TENTHS as f64;
            if part <= 0.0 { Some(0.0) } else { Some(3.6e6 * part / known(tenth)?) }
        });
        seconds.sum()
    }

    /// What time without readings has cost the lower bound, and what to do. `None` unless it is a
    /// minute at least, and 1 % of the capacity.
    #[must_use]
    pub fn pause_note(&self) -> Option<String> {
        let has_battery = self.flags & budget_flag::BATTERY != 0;
        if !(has_battery && self.pause_s >= 60.0 && self.pause >= 0.01) {
            return None;
        }
        let (robot, percent) = (self.robot, 100.0 * self.pause.min(1.0));
        let minutes = f64::from(self.pause_s) / 60.0;
        let long = match minutes < 120.0 {
            true => format!("{minutes:.0} min"),
            false => format!("{:.1} h", minutes / 60.0),
        };
        Some(format!(
            "{long} without readings may have cost up to {percent:.0} % of the battery: say what is \
             left with `joulebus battery {robot} --full`, --charge or --exchanged"
        ))
    }

    /// The charge state.
    pub const fn charge_state(&self) -> ChargeState {
        ChargeState::decode(self.charge_state)
    }
}

rows! {
    /// Header of a frame of budgets.
    #[derive(Eq)]
    pub struct BudgetHeader: "joulebus.BudgetHeader.v1", 40 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the worker.
        pub pid: u32,
        /// As in [`crate::ForecastHeader::worker_epoch`].
        #[run]
        pub worker_epoch: u64,
        /// As in [`crate::ForecastHeader::tick`].
        pub tick: u64,
        /// When the frame was sent, monotonic ns.
        #[instant]
        pub sent_ns: u64,
        /// When the frame was sent, Unix ns: relates stamps to the wall clock over a reboot.
        pub sent_unix_ns: u64,
    }
}

/// Charging state of the battery.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChargeState {
    /// The robot runs on its battery.
    Discharging,
    /// The robot is on its charger.
    Charging,
    /// Not known, or written by something newer than this reader.
    Unknown,
}

impl ChargeState {
    /// The code in shared memory.
    pub const fn code(self) -> u32 {
        match self {
            Self::Unknown => 0,
            Self::Discharging => 1,
            Self::Charging => 2,
        }
    }

    /// From shared memory.
    #[must_use]
    pub const fn decode(code: u32) -> Self {
        match code {
            1 => Self::Discharging,
            2 => Self::Charging,
            _ => Self::Unknown,
        }
    }
}
