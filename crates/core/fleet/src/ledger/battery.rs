//! State of charge of a robot's battery, counted from the ledger and corrected by other
//! information.
//!
//! Everything is a share of the capacity. The consumption is counted from an anchor: the state of
//! the battery at some account of the ledger. The anchor moves when there is other information than
//! drawn energy: the battery is charged, measured, or exchanged.

use joulebus_settings::{Battery, ChargeReading, Platform};
use joulebus_wire::{Budget, Sample, budget_flag, sample_flag};
use serde::{Deserialize, Serialize};

use crate::layout::lanes::{Block as _, LANES, block};
use crate::layout::shift::Shift;
use crate::ledger::energy::Ledger;
use crate::ledger::measured::{Measured, Seen};

/// Distance of the bounds from an estimate in standard deviations: 95 % of a normal distribution.
pub(crate) const SIGMAS: f64 = 2.0;
/// Standard deviation of the state of charge that a charger reports as full.
const FULL_SD: f64 = 0.01;
/// Share, deviation, and room below and above of a battery that may be full or empty. Counting does
/// not make such a deviation smaller. Only a measured, full or exchanged battery does.
const UNKNOWN: (f64, f64, f64, f64) = (0.5, 1.0, 0.0, 0.0);
/// In place of an unknown charging power, W: it fills every battery at once.
const ANY_W: f64 = 1e30;
/// The charger or the battery reports that it is full. The battery was exchanged.
const FULL: u8 = 1;
const SWAPPED: u8 = 2;

/// A platform's settings for counting.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Counting {
    /// 1 / J.
    per_joule: f64,
    sd: f64,
    least_w: f64,
    most_w: f64,
    reading: ChargeReading,
    efficiency: f64,
    charge_w: f64,
}

impl Counting {
    #[inline(always)]
    pub(crate) fn new(battery: &Battery, platform: &Platform) -> Self {
        Self {
            per_joule: 1.0 / battery.capacity_j,
            sd: battery.counting_sd,
            least_w: platform.power_min_w.into(),
            most_w: f64::from(platform.power_max_w).max(0.0),
            reading: battery.charge_reading,
            efficiency: battery.charge_efficiency,
            charge_w: battery.charge_power_w.unwrap_or(ANY_W),
        }
    }
}

/// An account of the ledger.
#[derive(Debug, Clone, Copy)]
pub(crate) struct At {
    pub drawn_uj: i64,
    pub metered_ns: u64,
    pub unmetered_ns: u64,
}

impl At {
    #[inline(always)]
    pub(crate) fn new(ledger: &Ledger) -> Self {
        Self {
            drawn_uj: ledger.drawn_uj,
            metered_ns: ledger.metered_ns,
            unmetered_ns: ledger.unmetered_ns,
        }
    }
}

/// Charging of a robot while something was counted.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Charging {
    /// In metered time.
    pub metered: bool,
    /// Possibly, in unmetered time.
    pub unmetered: bool,
}

/// State of charge at one moment. The truth is within `below` and `above` of `soc`, whatever was
/// drawn in unmetered time, except for an error of standard deviation `sd`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Estimate {
    pub soc: f64,
    pub sd: f64,
    pub below: f64,
    pub above: f64,
}

impl Estimate {
    /// Lower bound.
    #[inline(always)]
    pub(crate) fn lo(&self) -> f64 {
        (self.soc - self.below - SIGMAS * self.sd).max(0.0)
    }

    /// Upper bound.
    #[inline(always)]
    pub(crate) fn hi(&self) -> f64 {
        (self.soc + self.above + SIGMAS * self.sd).min(1.0)
    }
}

/// The state of a robot's battery.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct BatteryState {
    /// [`Estimate`] at the anchor.
    pub soc: f64,
    pub sd: f64,
    pub below: f64,
    pub above: f64,
    /// The ledger at the anchor.
    drawn_uj: i64,
    metered_ns: u64,
    unmetered_ns: u64,
    /// Metered change of the state of charge since the robot joined: measured values are compared
    /// with it.
    pub counted: f64,
    /// Error of the measured state of charge, its variance, and its covariance with `soc`.
    pub bias: f64,
    pub bias_var: f64,
    pub covariance: f64,
    /// Stamp of the last measured value that was looked at, ns. 0 before the first.
    pub measured_ns: u64,
    /// That value. `counted` is the counted one when it last changed.
    pub measured: f64,
    pub equal_counted: f64,
    /// Measured minus estimated, while measured values contradict the estimate, else NaN. Since
    /// which stamp, and with which measured value.
    pub jump: f64,
    pub jump_ns: u64,
    pub jump_measured: f64,
    /// Stamp of the last sample that did not continue the one before it, ns.
    pub interrupted_ns: u64,
    /// Times that another battery was noticed.
    pub changes: u32,
    /// Alarms of the battery that are raised: [`joulebus_wire::AlarmSet`] bits.
    pub raised: u32,
    /// True if the last sample was on the charger.
    pub charging: bool,
    /// True if measured values are part of the estimate.
    pub fused: bool,
    /// Inputs of the newest sample: measured state of charge and energy to return, J (NaN if
    /// unknown), whether the first is derived from a voltage, and events.
    input: f64,
    pub return_j: f64,
    input_by_voltage: bool,
    events: u8,
}

block! {
    /// The batteries of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(64))]
    pub(crate) struct BatteryLanes of BatteryState {
        soc: f64,
        sd: f64,
        below: f64,
        above: f64,
        drawn_uj: i64,
        metered_ns: u64,
        unmetered_ns: u64,
        counted: f64,
        bias: f64,
        bias_var: f64,
        covariance: f64,
        measured_ns: u64,
        measured: f64,
        equal_counted: f64,
        jump: f64,
        jump_ns: u64,
        jump_measured: f64,
        interrupted_ns: u64,
        changes: u32,
        pub raised: u32,
        charging: bool,
        fused: bool,
        input: f64,
        pub return_j: f64,
        input_by_voltage: bool,
        events: u8,
    }
}

impl BatteryLanes {
    /// Same as [`BatteryState::shift`], for all.
    pub(crate) fn shift(&mut self, shift: Shift) {
        for lane in 0..LANES {
            let mut battery = self.get(lane);
            battery.shift(shift);
            self.set(lane, true, battery);
        }
    }

    /// Keeps a sample's values of the battery of the robot in a lane until the tick. Writes only
    /// these columns: samples come in any order, and each column is another line of the cache.
    #[inline(always)]
    pub(crate) fn note(&mut self, lane: usize, sample: &Sample, battery: &Battery) {
        self.return_j[lane] =
            if sample.has(sample_flag::RETURN) { sample.return_j.into() } else { f64::NAN };
        let by_voltage_only = !sample.has(sample_flag::SOC);
        self.input_by_voltage[lane] = by_voltage_only;
        self.input[lane] = if by_voltage_only {
            by_voltage(sample, battery).unwrap_or(f64::NAN)
        } else {
            f64::from(sample.soc).clamp(0.0, 1.0)
        };
        self.events[lane] = if sample.has(sample_flag::FULL) { FULL } else { 0 }
            | if sample.has(sample_flag::SWAPPED) { SWAPPED } else { 0 };
    }
}

impl BatteryState {
    /// A battery as the config describes it when the ledger begins.
    pub(crate) fn new(battery: &Battery) -> Self {
        let sd = (battery.initial_soc - battery.initial_soc_lo) / SIGMAS;
        Self {
            soc: battery.initial_soc,
            sd,
            below: 0.0,
            above: 0.0,
            drawn_uj: 0,
            metered_ns: 0,
            unmetered_ns: 0,
            counted: 0.0,
            bias: 0.0,
            bias_var: battery.sensor_sd * battery.sensor_sd,
            covariance: 0.0,
            measured_ns: 0,
            measured: f64::NAN,
            equal_counted: 0.0,
            jump: f64::NAN,
            jump_ns: 0,
            jump_measured: f64::NAN,
            interrupted_ns: 0,
            changes: 0,
            raised: 0,
            charging: false,
            fused: false,
            input: f64::NAN,
            return_j: f64::NAN,
            input_by_voltage: false,
            events: 0,
        }
    }

    /// A battery that is unknown at `at`.
    pub(crate) fn unknown(battery: &Battery, at: At) -> Self {
        let (soc, sd, below, above) = UNKNOWN;
        let mut unknown = Self { soc, sd, below, above, ..Self::new(battery) };
        unknown.anchor(at);
        unknown
    }

    /// Moves the instants to another clock. Of the anchor both times are durations.
    pub(crate) fn shift(&mut self, shift: Shift) {
        let Self {
            soc: _,
            sd: _,
            below: _,
            above: _,
            drawn_uj: _,
            metered_ns: _,
            unmetered_ns: _,
            counted: _,
            bias: _,
            bias_var: _,
            covariance: _,
            measured_ns,
            measured: _,
            equal_counted: _,
            jump: _,
            jump_ns,
            jump_measured: _,
            interrupted_ns,
            changes: _,
            raised: _,
            charging: _,
            fused: _,
            input: _,
            return_j: _,
            input_by_voltage: _,
            events: _,
        } = self;
        for instant_ns in [measured_ns, jump_ns, interrupted_ns] {
            shift.instant(instant_ns);
        }
    }

    fn anchor(&mut self, at: At) {
        (self.drawn_uj, self.metered_ns, self.unmetered_ns) =
            (at.drawn_uj, at.metered_ns, at.unmetered_ns);
    }

    /// The estimate at `at`, whose unmetered time may include the present silence. `mean_w` is the
    /// robot's mean consumption.
    #[inline(always)]
    pub(crate) fn after(
        &self,
        counting: &Counting,
        at: At,
        mean_w: f64,
        charging: Charging,
    ) -> Estimate {
        let share = counting.per_joule;
        let drawn = self.drawn(counting, at);
        let metered_s = at.metered_ns.saturating_sub(self.metered_ns) as f64 * 1e-9;
        let unmetered_s = at.unmetered_ns.saturating_sub(self.unmetered_ns) as f64 * 1e-9;
        let mean_w = mean_w.max(0.0);
        let stored = |seconds: f64| (counting.charge_w * seconds * share).min(1.0);
        let used = |watts: f64| watts * unmetered_s * share;
        let blind = charging.metered & matches!(counting.reading, ChargeReading::Load);
        let counted = counted(counting, drawn, charging.metered);
        let (lo, hi) = (
            if blind { -drawn.max(0.0) } else { counted },
            if blind { stored(metered_s) } else { counted },
        );
        let least_w = counting.least_w.min(mean_w);
        let rise = if charging.unmetered { stored(unmetered_s) } else { -used(least_w) };
        let lowest = self.soc - self.below + lo - used(counting.most_w.max(mean_w));
        let lowest = lowest.clamp(0.0, 1.0);
        let highest = (self.soc + self.above + hi + rise).clamp(0.0, 1.0);
        let highest = highest.max(lowest);
        let soc = self.soc + counted - used(mean_w);
        let between = 0.5 * (lowest + highest);
        let unknown = blind | (charging.unmetered & (unmetered_s > 0.0));
        let soc = if unknown { between } else { soc.max(lowest).min(highest) };
        Estimate {
            soc,
            sd: self.sd + counting.sd * if blind { 0.0 } else { counted.abs() },
            below: soc - lowest,
            above: highest - soc,
        }
    }

    /// Energy drawn since the anchor, as a share.
    #[inline(always)]
    fn drawn(&self, counting: &Counting, at: At) -> f64 {
        at.drawn_uj.wrapping_sub(self.drawn_uj) as f64 * 1e-6 * counting.per_joule
    }

    /// Moves the anchor to `at`.
    fn settle(&mut self, counting: &Counting, at: At, mean_w: f64, charging: Charging) {
        let now = self.after(counting, at, mean_w, charging);
        let blind = charging.metered & matches!(counting.reading, ChargeReading::Load);
        let counted = counted(counting, self.drawn(counting, at), charging.metered);
        self.counted += if blind { 0.0 } else { counted };
        (self.soc, self.sd, self.below, self.above) = (now.soc, now.sd, now.below, now.above);
        // Beyond this nothing is known anyway, and the sum of years stays finite.
        self.sd = self.sd.min(1.0);
        self.anchor(at);
    }

    /// True if a sample of this stamp has to be taken robot by robot.
    #[inline(always)]
    pub(crate) fn needs(&self, stamp_ns: u64, charging: bool, broken: bool) -> bool {
        let measured = !self.input.is_nan() & self.is_due(stamp_ns);
        let joins = self.interrupted_ns == 0;
        measured | charging | self.charging | broken | joins | (self.events != 0)
    }

    /// Takes the newest sample, after which the ledger is at `at`. `stale_after_ns`: silence after
    /// which it does not continue the sample before.
    pub(crate) fn take(
        &mut self,
        (battery, platform): (&Battery, &Platform),
        at: At,
        mean_w: f32,
        seen: Seen,
    ) {
        let counting = Counting::new(battery, platform);
        let unmetered_ns = at.unmetered_ns.saturating_sub(self.unmetered_ns);
        if seen.broken || unmetered_ns > platform.stale_after_ns || self.measured_ns == 0 {
            self.interrupted_ns = seen.stamp_ns;
        }
        let charging = Charging {
            metered: self.charging && seen.charging,
            unmetered: self.charging || seen.charging,
        };
        let before = self.soc;
        self.settle(&counting, at, mean_w.into(), charging);
        // The robot runs, so it was charged meanwhile, or its battery was exchanged.
        let share_drawn = f64::from(mean_w) * unmetered_ns as f64 * 1e-9 * counting.per_joule;
        if !charging.unmetered && share_drawn >= before.max(battery.low) {
            (self.soc, self.sd, self.below, self.above) = UNKNOWN;
        }
        self.charging = seen.charging;
        if self.events & SWAPPED != 0 {
            self.exchange(battery, at);
        }
        if self.events & FULL != 0 {
            (self.soc, self.sd) = (battery.on_full_soc, FULL_SD);
            (self.below, self.above, self.covariance) = (0.0, 0.0, 0.0);
        }
        self.events = 0;
        if !self.input.is_nan() && self.is_due(seen.stamp_ns) {
            let measured = Measured::new(self.input, battery, self.input_by_voltage);
            self.fuse(measured, seen.stamp_ns);
        }
    }

    /// Another battery, as full as the first one was.
    fn exchange(&mut self, battery: &Battery, at: At) {
        let before = *self;
        *self = Self {
            changes: before.changes.saturating_add(1),
            raised: before.raised,
            charging: before.charging,
            input: before.input,
            input_by_voltage: before.input_by_voltage,
            return_j: before.return_j,
            events: before.events,
            interrupted_ns: before.interrupted_ns,
            ..Self::new(battery)
        };
        self.anchor(at);
    }

    /// A battery that an earlier run wrote down.
    fn restored(saved: &SavedBattery, battery: &Battery, ledger: &Ledger) -> Self {
        let at = At { unmetered_ns: saved.unmetered_ns, ..At::new(ledger) };
        let Some(estimate) = saved.estimate() else {
            return Self::unknown(battery, at);
        };
        let mut restored = Self {
            soc: estimate.soc,
            sd: estimate.sd,
            below: estimate.below,
            above: estimate.above,
            bias: saved.sensor_bias.into(),
            bias_var: f64::from(saved.sensor_bias_sd).powi(2),
            covariance: saved.sensor_covariance.into(),
            changes: saved.changes,
            charging: saved.charging,
            fused: saved.measured,
            ..Self::new(battery)
        };
        restored.anchor(at);
        restored
    }

    /// The battery of a robot that joins: as it left, as it was written down, unknown if nothing is
    /// known although it was used, or new.
    pub(crate) fn joining(battery: &Battery, known: Known, used: bool, ledger: &Ledger) -> Self {
        let mut joining = match known {
            Known::Kept(kept) => kept,
            Known::Saved(saved) => Self::restored(&saved, battery, ledger),
            // Charged by an earlier version, which did not meter it, or its account was given up.
            Known::Nothing if used => Self::unknown(battery, At::new(ledger)),
            Known::Nothing => Self::new(battery),
        };
        // Stamps of before are of another run, or of another boot.
        (joining.measured_ns, joining.jump, joining.interrupted_ns) = (0, f64::NAN, 0);
        joining
    }
}

/// The state of charge that the voltage gives.
fn by_voltage(sample: &Sample, battery: &Battery) -> Option<f64> {
    let table = battery.open_circuit?;
    let voltage_v = sample.has(sample_flag::VOLTAGE).then_some(sample.voltage_v)?;
    let current_a = if sample.has(sample_flag::CURRENT) {
        sample.current_a
    } else {
        let power_w = sample.has(sample_flag::POWER).then_some(sample.power_w)?;
        power_w / voltage_v
    };
    table.soc(voltage_v.into(), current_a.into())
}

/// Change of the state of charge by a drawn share, negative if the power flowed the other way.
#[inline(always)]
fn counted(counting: &Counting, drawn: f64, charging: bool) -> f64 {
    let stored = match counting.reading {
        ChargeReading::Battery | ChargeReading::Load => -drawn,
        ChargeReading::Charger => drawn,
    };
    let part = if stored > 0.0 { counting.efficiency } else { 1.0 };
    if charging { part * stored } else { -drawn }
}

/// A battery's state from an earlier run, from a [`Budget`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedBattery {
    soc: f32,
    soc_lo: f32,
    soc_hi: f32,
    soc_sd: f32,
    sensor_bias: f32,
    sensor_bias_sd: f32,
    sensor_covariance: f32,
    /// Unmetered time that they contain, ns.
    unmetered_ns: u64,
    changes: u32,
    charging: bool,
    measured: bool,
}

impl SavedBattery {
    /// The battery in a budget. `None` if it has none.
    pub fn new(budget: &Budget) -> Option<Self> {
        let has = |flag| budget.flags & flag != 0;
        let (soc, soc_lo, soc_hi, soc_sd) = match has(budget_flag::CHARGE) {
            true => (budget.soc, budget.soc_lo, budget.soc_hi, budget.soc_sd),
            false => (0.5, 0.0, 1.0, 1.0),
        };
        has(budget_flag::BATTERY).then_some(Self {
            soc,
            soc_lo,
            soc_hi,
            soc_sd,
            sensor_bias: budget.sensor_bias,
            sensor_bias_sd: budget.sensor_bias_sd,
            sensor_covariance: budget.sensor_covariance,
            unmetered_ns: budget.unmetered_ns,
            changes: budget.battery_changes,
            charging: budget.charge_state() == joulebus_wire::ChargeState::Charging,
            measured: has(budget_flag::MEASURED),
        })
    }

    /// Times that another battery was noticed.
    pub const fn changes(&self) -> u32 {
        self.changes
    }

    /// The same battery after an unknown time, when anything may be left.
    #[must_use]
    pub const fn without_bounds(self) -> Self {
        Self { soc_lo: 0.0, soc_hi: 1.0, soc_sd: 1.0, ..self }
    }

    /// `None` if no worker can have written it.
    fn estimate(&self) -> Option<Estimate> {
        let [soc, lo, hi] = [self.soc, self.soc_lo, self.soc_hi].map(f64::from);
        let (sd, bias_sd) = (f64::from(self.soc_sd), f64::from(self.sensor_bias_sd));
        let bounded =
            f64::from(self.sensor_covariance).abs() <= 1.0 && self.sensor_bias.abs() <= 1.0;
        let ordered = 0.0 <= lo && lo <= soc && soc <= hi && hi <= 1.0;
        let spread = (0.0..=1.0).contains(&sd) && (0.0..=1.0).contains(&bias_sd);
        (bounded && ordered && spread).then_some(Estimate {
            soc,
            sd,
            below: (soc - SIGMAS * sd - lo).max(0.0),
            above: (hi - soc - SIGMAS * sd).max(0.0),
        })
    }
}

/// The known state of the battery of a robot that is not in the fleet.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant, reason = "kept in place, one per robot")]
pub(crate) enum Known {
    #[default]
    Nothing,
    /// The robot has left.
    Kept(BatteryState),
    /// Saved by an earlier run.
    Saved(SavedBattery),
}
