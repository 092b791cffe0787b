//! State of charge of a robot's battery, counted from the ledger and corrected by other
//! information.
//!
//! Everything is a share of the capacity. The consumption is counted from an anchor: the state of
//! the battery at some account of the ledger. The anchor moves when there is other information than
//! metered energy: a gap ends, or the battery is charged, measured, or exchanged. So each gap is
//! valued once.

use joulebus_energy::{Capacity, EnergyLeft};
use joulebus_settings::{Battery, Platform};
use joulebus_wire::{
    Alarm, AlarmSet, Budget, CHARGE_TENTHS, Sample, Statement, budget_flag, sample_flag,
};
use serde::{Deserialize, Serialize};

use crate::layout::lanes::{DurationNs, InstantNs, block, put};
use crate::layout::versions;
use crate::ledger::counting::{Counting, counted};
use crate::ledger::energy::Ledger;
use crate::ledger::gap::GapPower;
use crate::ledger::lessons::Lessons;
use crate::ledger::measured::{BatterySample, Measured};

const SIGMAS: f64 = EnergyLeft::SIGMAS;
/// Standard deviation of the state of charge that a charger reports as full.
const FULL_SD: f64 = 0.01;
/// Share, deviation, and room below and above of a battery that may be full or empty. Counting does
/// not make such a deviation smaller. Only a measured, full or exchanged battery does.
const UNKNOWN: (f64, f64, f64, f64) = (0.5, 1.0, 0.0, 0.0);
/// The charger or the battery reports that it is full. The battery was exchanged. The robot is
/// switched off.
const FULL: u8 = 1;
const SWAPPED: u8 = 2;
const OFF: u8 = 4;
/// Two counts that differ by less are one: a sensor may state a step of 0.
const LEAST_STEP: f64 = 0.01;
/// A correction of the charge by more than this is not what was charged.
const MAX_CORRECTION: f64 = 0.03;
/// Time constant of the power at rest, s.
const IDLE_S: f32 = 60.0;

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

    /// The same after a silence.
    #[inline(always)]
    pub(crate) const fn silent_for(self, silent_ns: u64) -> Self {
        Self { unmetered_ns: self.unmetered_ns.saturating_add(silent_ns), ..self }
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

block! {
    /// The state of a robot's battery.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    pub(crate) struct BatteryState: NONE;

    /// The batteries of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(32))]
    pub(crate) struct BatteryLanes {
        /// [`EnergyLeft`] at the anchor, `monitor` apart.
        pub soc: f64 = 0.0,
        #[serde(deserialize_with = "versions::read_narrow")]
        pub sd: f64 as f32 = 0.0,
        #[serde(deserialize_with = "versions::read_narrow")]
        pub below: f64 as f32 = 0.0,
        #[serde(deserialize_with = "versions::read_narrow")]
        pub above: f64 as f32 = 0.0,
        /// The ledger at the anchor.
        drawn_uj: i64 = 0,
        metered_ns: DurationNs = 0,
        unmetered_ns: DurationNs = 0,
        /// Change of the state of charge since the robot joined, but by charging that is not metered:
        /// measured values are compared with it.
        pub counted: f64 = 0.0,
        /// Error of the measured state of charge, its variance, and its covariance with `soc`.
        #[serde(deserialize_with = "versions::read_narrow")]
        pub bias: f64 as f32 = 0.0,
        #[serde(deserialize_with = "versions::read_narrow")]
        pub bias_var: f64 as f32 = 0.0,
        #[serde(deserialize_with = "versions::read_narrow")]
        pub covariance: f64 as f32 = 0.0,
        /// Stamp of the last measured value that was looked at, ns. 0 before the first.
        pub measured_ns: InstantNs = 0,
        /// That value. `counted` is the counted one when it last changed.
        #[serde(deserialize_with = "versions::read_narrow")]
        pub measured: f64 as f32 = f64::NAN,
        #[serde(deserialize_with = "versions::read_narrow")]
        pub equal_counted: f64 as f32 = 0.0,
        /// Measured minus estimated, while measured values contradict the estimate, else NaN. Since
        /// which stamp, and with which measured value.
        #[serde(deserialize_with = "versions::read_narrow")]
        pub jump: f64 as f32 = f64::NAN,
        pub jump_ns: InstantNs = 0,
        #[serde(deserialize_with = "versions::read_narrow")]
        pub jump_measured: f64 as f32 = f64::NAN,
        /// Stamp of the last sample that did not continue the one before it, ns.
        pub interrupted_ns: InstantNs = 0,
        /// Times that another battery was noticed.
        pub changes: u32 = 0,
        /// Alarms of the battery that are raised: [`joulebus_wire::AlarmSet`] bits.
        pub raised: u32 = 0,
        /// True if the last sample was on the charger.
        pub charging: bool = false,
        /// True if measured values are part of the estimate.
        pub fused: bool = false,
        /// Inputs of the newest sample: measured state of charge and energy to return, J (NaN if
        /// unknown), whether the first is derived from a voltage, and events.
        #[serde(deserialize_with = "versions::read_narrow")]
        input: f64 as f32 = f64::NAN,
        #[serde(deserialize_with = "versions::read_narrow")]
        pub return_j: f64 as f32 = f64::NAN,
        input_by_voltage: bool = false,
        events: u8 = 0,
        /// The monitor's part of the errors of `soc` and of `bias`, in its standard deviations:
        /// [`EnergyLeft::monitor`].
        #[serde(deserialize_with = "versions::read_narrow")]
        pub monitor: f64 as f32 = 0.0,
        #[serde(deserialize_with = "versions::read_narrow")]
        pub bias_monitor: f64 as f32 = 0.0,
        /// [`EnergyLeft::range_sd`] at the anchor.
        #[serde(deserialize_with = "versions::read_narrow")]
        pub range_sd: f64 as f32 = 0.0,
        /// Mean power at the newest sample, and the last reading, W. NaN if unknown. A gap after them is
        /// valued by them.
        pub mean_w: f32 = f32::NAN,
        pub reading_w: f32 = f32::NAN,
        /// True if the newest sample reported a full battery.
        full: bool = false,
        /// True if the newest sample said that the robot is switched off.
        pub off: bool = false,
        /// Mean power at rest, W. NaN if unknown.
        pub idle_w: f32 = f32::NAN,
        /// Unmetered time since the charge was last known, s, and by how much it has lowered the lower
        /// bound at most, as a share. The gap that has not ended is not in them.
        pub pause_s: f32 = 0.0,
        pub pause: f32 = 0.0,
        /// Learned capacity as a share of the stated one, and its relative standard deviation: 0 before
        /// anything is learned.
        #[serde(deserialize_with = "versions::read")]
        pub capacity: f32 = 0.0,
        #[serde(deserialize_with = "versions::read")]
        pub capacity_sd: f32 = 0.0,
        #[serde(deserialize_with = "versions::read")]
        pub lessons: Lessons = Lessons::NONE,
    }
}

impl BatteryLanes {
    /// Takes a reading at rest, which stands for `elapsed_s`, where the mask is set.
    #[inline(always)]
    pub(crate) fn rest(&mut self, lane: usize, mask: bool, power_w: f32, elapsed_s: f32) {
        let idle_w = self.idle_w[lane];
        let weight = elapsed_s / (IDLE_S + elapsed_s);
        let mean_w = idle_w + weight * (power_w - idle_w);
        let mean_w = if idle_w.is_nan() { power_w } else { mean_w };
        put(&mut self.idle_w[lane], mask & !power_w.is_nan(), mean_w);
    }

    /// Keeps a sample's values of the battery of the robot in a lane until the tick. Writes only
    /// these columns: samples come in any order, and each column is another line of the cache.
    #[inline(always)]
    pub(crate) fn note(&mut self, lane: usize, sample: &Sample, battery: &Battery) {
        self.return_j[lane] =
            if sample.has(sample_flag::RETURN) { sample.return_j } else { f32::NAN };
        let by_voltage_only = !sample.has(sample_flag::SOC);
        self.input_by_voltage[lane] = by_voltage_only;
        self.input[lane] = if by_voltage_only {
            by_voltage(sample, battery).map_or(f32::NAN, |soc| soc as f32)
        } else {
            sample.soc.clamp(0.0, 1.0)
        };
        self.events[lane] = if sample.has(sample_flag::FULL) { FULL } else { 0 }
            | if sample.has(sample_flag::SWAPPED) { SWAPPED } else { 0 }
            | if sample.has(sample_flag::OFF) { OFF } else { 0 };
    }
}

impl BatteryState {
    /// A battery as the config describes it when the ledger begins.
    pub(crate) fn new(battery: &Battery) -> Self {
        let sd = (battery.initial_soc - battery.initial_soc_lo) / SIGMAS;
        Self {
            soc: battery.initial_soc,
            sd,
            bias_var: battery.sensor_sd * battery.sensor_sd,
            ..Self::NONE
        }
    }

    /// A battery that is unknown at `at`.
    pub(crate) fn unknown(battery: &Battery, at: At) -> Self {
        let (soc, sd, below, above) = UNKNOWN;
        let mut unknown = Self { soc, sd, below, above, ..Self::new(battery) };
        unknown.anchor(at);
        unknown
    }

    fn anchor(&mut self, at: At) {
        (self.drawn_uj, self.metered_ns, self.unmetered_ns) =
            (at.drawn_uj, at.metered_ns, at.unmetered_ns);
    }

    /// Energy left at `at`, whose unmetered time since the anchor is one gap. `at` may include the
    /// present silence.
    #[inline(always)]
    pub(crate) fn after(
        &self,
        counting: &Counting,
        at: At,
        gap: &GapPower,
        charging: Charging,
    ) -> EnergyLeft {
        let share = counting.per_joule;
        let drawn = self.drawn(counting, at);
        let metered_s = at.metered_ns.saturating_sub(self.metered_ns) as f64 * 1e-9;
        let unmetered_s = self.unmetered_s(at);
        let stored = |seconds: f64| (counting.charge_w * seconds * share).min(1.0);
        let used = |watts: f64| watts * unmetered_s * share;
        let blind = charging.metered & counting.reads_load;
        let counted = counted(counting, drawn, charging.metered);
        let (lo, hi) = (
            if blind { -drawn.max(0.0) } else { counted },
            if blind { stored(metered_s) } else { counted },
        );
        let least_w = counting.least_w.min(gap.mean_w);
        let rise = match (charging.unmetered, gap.charges) {
            // Twice as much is more than a charger changes in a few periods.
            (true, true) => used(2.0 * gap.mean_w.abs()),
            (true, false) => stored(unmetered_s),
            (false, _) => -used(least_w),
        };
        let lowest = self.soc - self.below + lo - used(gap.most_w);
        let lowest = lowest.clamp(0.0, 1.0);
        let highest = (self.soc + self.above + hi + rise).clamp(0.0, 1.0);
        let highest = highest.max(lowest);
        let soc = self.soc + counted - used(gap.mean_w);
        let between = 0.5 * (lowest + highest);
        let uncounted = charging.unmetered & (unmetered_s > 0.0) & !gap.charges;
        let unknown = blind | uncounted;
        let soc = if unknown { between } else { soc.max(lowest).min(highest) };
        let by_monitor = match (blind, charging.metered) {
            (true, _) => 0.0,
            // Its losses are another error, which does not undo that of drawing.
            (_, true) => counted.abs(),
            (_, false) => -counted,
        };
        let left = EnergyLeft {
            left: soc,
            own_sd: self.sd,
            monitor: self.monitor - counting.sd * by_monitor,
            below: soc - lowest,
            above: highest - soc,
            range_sd: if unknown { 0.25 * (highest - lowest) } else { self.range_sd },
        };
        left.with_error_within_range(if unknown { 0.0 } else { used(gap.sd_w) })
    }

    /// Same as [`BatteryState::after`], with a gap that has not ended.
    #[inline(always)]
    pub(crate) fn now(&self, counting: &Counting, at: At, charging: Charging) -> EnergyLeft {
        let counting = &counting.of(self.size());
        let unmetered_ns = at.unmetered_ns.saturating_sub(self.unmetered_ns);
        let readings_w = (self.reading_w, self.mean_w);
        let gap = GapPower::open(counting, readings_w, unmetered_ns, charging.unmetered);
        let off = GapPower::off(counting, self.idle_w);
        self.after(counting, at, if self.off { &off } else { &gap }, charging)
    }

    /// Unmetered time since the charge was known, s, and by how much it lowers the lower bound at
    /// most, as a share, with a gap that has not ended at `at`.
    #[inline(always)]
    pub(crate) fn paused(&self, counting: &Counting, at: At) -> (f32, f32) {
        let counting = &counting.of(self.size());
        let unmetered_s = self.unmetered_s(at);
        let most_w = match self.off {
            true => GapPower::off(counting, self.idle_w).most_w,
            false => counting.most_w,
        };
        let share = (most_w * unmetered_s * counting.per_joule) as f32;
        (self.pause_s + unmetered_s as f32, (self.pause + share).min(1.0))
    }

    /// Unmetered time since the anchor, s.
    #[inline(always)]
    fn unmetered_s(&self, at: At) -> f64 {
        at.unmetered_ns.saturating_sub(self.unmetered_ns) as f64 * 1e-9
    }

    /// Energy drawn since the anchor, as a share.
    #[inline(always)]
    fn drawn(&self, counting: &Counting, at: At) -> f64 {
        at.drawn_uj.wrapping_sub(self.drawn_uj) as f64 * 1e-6 * counting.per_joule
    }

    /// Moves the anchor to `at`, where the gap since it ends.
    /// `is_short`: its power is known.
    fn settle(
        &mut self,
        counting: &Counting,
        at: At,
        (gap, is_short): (&GapPower, bool),
        charging: Charging,
    ) {
        let now = self.after(counting, at, gap, charging);
        let blind = charging.metered & counting.reads_load;
        let counted = counted(counting, self.drawn(counting, at), charging.metered);
        let in_gap = gap.mean_w * self.unmetered_s(at) * counting.per_joule;
        self.counted += if blind { 0.0 } else { counted };
        self.counted -= if is_short && !charging.unmetered { in_gap } else { 0.0 };
        // Beyond this nothing is known anyway, and the sum of years stays finite.
        (self.soc, self.sd) = (now.left, now.own_sd.min(1.0));
        (self.below, self.above) = (outward(now.below), outward(now.above));
        self.range_sd = now.range_sd;
        // What a sample adds may be less than half a rounding, and must not be lost.
        self.monitor = outward(now.monitor.abs().min(1.0)).copysign(now.monitor);
        let unmetered_s = self.unmetered_s(at);
        self.pause_s += unmetered_s as f32;
        self.pause = (self.pause + (gap.most_w * unmetered_s * counting.per_joule) as f32).min(1.0);
        self.anchor(at);
    }

    /// The charge is known at `at`, with this deviation.
    fn know(&mut self, (soc, sd): (f64, f64), at: At) {
        (self.soc, self.sd, self.below, self.above, self.range_sd) = (soc, sd, 0.0, 0.0, 0.0);
        (self.monitor, self.covariance, self.jump) = (0.0, 0.0, f64::NAN);
        (self.pause_s, self.pause) = (0.0, 0.0);
        self.anchor(at);
    }

    /// Takes what a person states of the battery at `at`.
    pub(crate) fn state(
        &mut self,
        (battery, platform): (&Battery, &Platform),
        at: At,
        statement: Statement,
    ) {
        let (soc, sd) = match statement {
            Statement::NewNormal => return,
            Statement::Exchanged => return self.exchange(battery, at),
            Statement::Charge(soc) => (soc.into(), battery.sensor_sd),
            Statement::Full => (battery.on_full_soc, FULL_SD),
        };
        let counting = Counting::new(battery, platform).of(self.size());
        let unmetered_ns = at.unmetered_ns.saturating_sub(self.unmetered_ns);
        if self.charging || unmetered_ns > platform.stale_after_ns {
            self.end_drive(battery);
        }
        self.counted -= if self.charging { 0.0 } else { self.drawn(&counting, at) };
        self.know((soc, sd), at);
        self.lessons.charge(None, None);
        self.learn(battery, (soc, self.counted, sd));
        self.lessons.begin((soc, self.counted, sd));
    }

    /// What an earlier run leaves of it, once its charge is known.
    pub(crate) fn saved(&self, battery: &Battery) -> SavedBattery {
        let finite = |watts: f32| Some(watts).filter(|watts| watts.is_finite());
        let (capacity_j, sd) = (f64::from(self.capacity) * battery.capacity_j, self.capacity_sd);
        SavedBattery {
            soc: self.soc as f32,
            soc_lo: (self.soc - SIGMAS * self.sd - self.below).max(0.0) as f32,
            soc_hi: (self.soc + SIGMAS * self.sd + self.above).min(1.0) as f32,
            soc_sd: self.sd as f32,
            sensor_bias: self.bias as f32,
            sensor_bias_sd: self.bias_var.sqrt() as f32,
            sensor_covariance: self.covariance as f32,
            unmetered_ns: self.unmetered_ns,
            changes: self.changes,
            charging: self.charging,
            measured: self.fused,
            mean_power_w: finite(self.mean_w),
            pause: SavedPause {
                off: self.off,
                idle_w: finite(self.idle_w),
                pause_s: self.pause_s,
                pause: self.pause,
            },
            lessons: SavedLessons {
                capacity_j: capacity_j as f32,
                capacity_sd_j: (capacity_j * f64::from(sd)) as f32,
                capacity_weight: self.lessons.weight,
                charge_rate: self.lessons.charge_rate,
            },
        }
    }

    /// True if a sample has to be taken robot by robot. `unmetered_ns`: of the ledger after it.
    #[inline(always)]
    pub(crate) fn needs(&self, seen: &BatterySample, unmetered_ns: u64) -> bool {
        let measured = !self.input.is_nan() & self.is_due(seen.stamp_ns);
        let joins = self.interrupted_ns == 0;
        let ends_gap = !seen.reading_w.is_nan() & (unmetered_ns != self.unmetered_ns);
        // A sample on the charger without a reading leaves the gap open, as one away from it does.
        let goes_on = seen.charging & self.charging & seen.reading_w.is_nan();
        let charges = (seen.charging | self.charging | self.full) & !goes_on;
        measured | charges | seen.broken | joins | ends_gap | self.off | (self.events != 0)
    }

    /// Takes the newest sample, after which the ledger is at `at`. `mean_w` is the mean power
    /// including it, W: a gap is valued by the mean before, if there was one.
    pub(crate) fn take(
        &mut self,
        (battery, platform): (&Battery, &Platform),
        at: At,
        mean_w: f32,
        seen: &BatterySample,
    ) {
        let counting = Counting::new(battery, platform).of(self.size());
        let unmetered_ns = at.unmetered_ns.saturating_sub(self.unmetered_ns);
        let metered_ns = at.metered_ns.saturating_sub(self.metered_ns);
        let is_interrupted = seen.broken || unmetered_ns > platform.stale_after_ns;
        let joins = self.interrupted_ns == 0;
        if is_interrupted || self.measured_ns == 0 {
            self.interrupted_ns = seen.stamp_ns;
        }
        let charging = Charging {
            metered: self.charging && seen.charging,
            unmetered: self.charging || seen.charging,
        };
        let before_w = if self.mean_w.is_nan() { mean_w } else { self.mean_w };
        let readings_w = (self.reading_w, seen.reading_w);
        let (is_full, was_full) = (self.events & FULL != 0, self.full);
        // Until now it is as full as its charger says.
        if is_interrupted || charging.unmetered && !was_full {
            self.end_drive(battery);
        }
        if is_full && self.full && !is_interrupted && !joins {
            // It is kept full, whatever the charger and the robot draw.
            self.anchor(at);
        } else {
            let is_one_state = !seen.broken && charging.metered == charging.unmetered;
            let on_charger = charging.metered;
            let short =
                GapPower::between(&counting, readings_w, before_w, unmetered_ns, on_charger);
            let gap = short.filter(|_| is_one_state);
            let gap = gap.unwrap_or_else(|| GapPower::mean(&counting, before_w));
            // Until this sample the robot was off.
            let gap = if self.off { GapPower::off(&counting, self.idle_w) } else { gap };
            let before = At { unmetered_ns: self.unmetered_ns, ..at };
            let before = self.after(&counting, before, &gap, charging).left;
            self.settle(&counting, at, (&gap, !is_interrupted), charging);
            // The robot runs, so it was charged meanwhile, or its battery was exchanged.
            let share_drawn = gap.mean_w * unmetered_ns as f64 * 1e-9 * counting.per_joule;
            let any = unmetered_ns > 0 && !charging.unmetered;
            if any && share_drawn >= before.max(battery.low) {
                (self.soc, self.sd, self.below, self.above) = UNKNOWN;
                (self.monitor, self.range_sd) = (0.0, 0.0);
            }
        }
        let settled = self.soc;
        self.charging = seen.charging;
        if was_full && !is_interrupted && !seen.charging {
            self.lessons.begin((battery.on_full_soc, self.counted, FULL_SD));
        }
        if self.events & SWAPPED != 0 {
            self.exchange(battery, at);
        }
        // While it stays full, a sample tells no more than the one before.
        if is_full && (!self.full || is_interrupted || joins) {
            let jump = self.jump;
            self.know((battery.on_full_soc, FULL_SD), at);
            self.jump = jump;
        }
        if is_full {
            self.lessons.begin((battery.on_full_soc, self.counted, FULL_SD));
        }
        self.off = self.events & OFF != 0;
        (self.full, self.events) = (is_full, 0);
        let mut is_known = counting.stored(0.0).is_some();
        let mut goes_on = charging.metered && !is_interrupted;
        if !self.input.is_nan() && self.is_due(seen.stamp_ns) {
            let measured = Measured::new(self.input, battery, self.input_by_voltage);
            let has_changed = measured.soc.to_bits() != self.measured.to_bits();
            let is_believed = self.fuse(measured, seen.stamp_ns);
            if is_believed && has_changed {
                self.begin_measured();
            }
            is_known |= is_believed;
        }
        if counting.stored(0.0).is_some() {
            goes_on &= (self.soc - settled).abs() <= MAX_CORRECTION;
        }
        let elapsed_ns = goes_on.then_some(metered_ns.saturating_add(unmetered_ns));
        self.lessons.charge(is_known.then_some(self.soc), elapsed_ns);
    }

    /// A drive from charge to charge has ended: its last measured value ends a pair, if it is
    /// believed and another one began it.
    fn end_drive(&mut self, battery: &Battery) {
        let is_measured = self.lessons.is_measured();
        if is_measured && !AlarmSet(self.raised).has(Alarm::SocImplausible) {
            self.learn(battery, (self.measured, self.equal_counted, 0.0));
        }
        self.lessons.end();
    }

    /// A believed value that has just changed begins a pair of measured values. At its upper end a
    /// sensor is useless.
    fn begin_measured(&mut self) {
        if !self.charging && !self.lessons.is_measured() && self.measured < 1.0 {
            self.lessons.begin((self.measured, self.counted, 0.0));
        }
    }

    /// Learns the capacity from the pair that this known charge ends: its share, what was counted
    /// until it, and its standard deviation, 0 for a measured one.
    ///
    /// Until something is learned, a pair that says what our own count says is none: a gauge that
    /// counts with the stated capacity, or shows our count, knows nothing about the battery.
    fn learn(&mut self, battery: &Battery, end: (f64, f64, f64)) {
        let mut capacity = self.capacity();
        let Some(pair) = self.lessons.pair(end, battery.sensor_step) else {
            return;
        };
        let drawn = capacity.learned().unwrap_or(1.0) * pair.counted;
        let mirrors = (pair.depth - drawn).abs() <= battery.sensor_step.max(LEAST_STEP) as f32;
        if (capacity.learned().is_some() || !mirrors)
            && capacity.learn(1.0, drawn, (pair.depth, pair.depth_sd))
        {
            self.set_capacity(capacity);
        }
    }

    /// The learned capacity as a share of the stated one, and its deviation.
    #[inline(always)]
    pub(crate) const fn size(&self) -> (f32, f32) {
        (self.capacity, self.capacity_sd)
    }

    fn capacity(&self) -> Capacity {
        Capacity { value: self.capacity, weight: self.lessons.weight, sd: self.capacity_sd }
    }

    fn set_capacity(&mut self, learned: Capacity) {
        (self.capacity, self.lessons.weight) = (learned.value, learned.weight);
        self.capacity_sd = learned.sd;
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
            mean_w: before.mean_w,
            reading_w: before.reading_w,
            idle_w: before.idle_w,
            off: before.off,
            ..Self::new(battery)
        };
        self.anchor(at);
    }

    /// A battery that an earlier run wrote down.
    fn restored(
        (saved, mean_w, pause): (&SavedBattery, f32, &SavedPause),
        learned: &SavedLessons,
        battery: &Battery,
        ledger: &Ledger,
    ) -> Self {
        let at = At { unmetered_ns: saved.unmetered_ns, ..At::new(ledger) };
        let SavedPause { off, idle_w, pause_s, pause } = *pause;
        let idle_w = idle_w.filter(|watts| watts.is_finite()).unwrap_or(f32::NAN);
        let capacity = learned.capacity(battery.capacity_j);
        let lessons = Lessons::continued(learned.charge_rate);
        let counting_sd = capacity.map_or(battery.counting_sd, |learned| learned.sd.into());
        let Some(estimate) = saved.estimate(counting_sd) else {
            let unknown = Self::unknown(battery, at);
            let mut unknown = Self { mean_w, off, idle_w, pause_s, pause, lessons, ..unknown };
            unknown.set_capacity(capacity.unwrap_or_default());
            return unknown;
        };
        let mut restored = Self {
            soc: estimate.left,
            sd: estimate.own_sd,
            monitor: estimate.monitor,
            below: outward(estimate.below),
            above: outward(estimate.above),
            bias: saved.sensor_bias.into(),
            bias_var: saved.bias_var(),
            covariance: saved.sensor_covariance.into(),
            changes: saved.changes,
            charging: saved.charging,
            fused: saved.measured,
            mean_w,
            off,
            idle_w,
            pause_s,
            pause,
            lessons,
            ..Self::new(battery)
        };
        restored.set_capacity(capacity.unwrap_or_default());
        restored.anchor(at);
        restored
    }

    /// The battery of a robot that joins: as it left, as it was written down, unknown if nothing is
    /// known although it was used, or new.
    pub(crate) fn joining(battery: &Battery, known: Known, used: bool, ledger: &Ledger) -> Self {
        let mut joining = match known {
            Known::Kept(kept) => kept,
            Known::Saved(saved, mean_w, pause, lessons) => {
                Self::restored((&saved, mean_w, &pause), &lessons, battery, ledger)
            }
            // Charged by an earlier version, which did not meter it, or its account was given up.
            Known::Nothing if used => Self::unknown(battery, At::new(ledger)),
            Known::Nothing => Self::new(battery),
        };
        // Stamps of before are of another run, or of another boot.
        (joining.measured_ns, joining.jump, joining.interrupted_ns) = (0, f64::NAN, 0);
        (joining.reading_w, joining.full) = (f32::NAN, false);
        joining
    }
}

/// A bound's distance as a column stores it: rounding makes nothing more certain.
fn outward(distance: f64) -> f64 {
    let nearest = distance as f32;
    let is_less = f64::from(nearest) < distance;
    f64::from(if is_less { nearest.next_up() } else { nearest })
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
    /// Mean power at the last sample, W. Apart from the others wherever they are stored.
    #[serde(skip)]
    mean_power_w: Option<f32>,
    /// The same.
    #[serde(skip)]
    pause: SavedPause,
    /// The same.
    #[serde(skip)]
    lessons: SavedLessons,
}

/// A battery that a person has stated, of a robot that is not in the fleet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatedBattery {
    /// Id of the robot.
    pub robot: u32,
    /// Stamp of its last sample, ns, 0 before the first.
    pub stamp_ns: u64,
    /// The battery since.
    pub battery: SavedBattery,
}

/// What the charges of a battery taught an earlier run. Fields as in [`Budget`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedLessons {
    /// 0 before anything is learned, as the two others.
    capacity_j: f32,
    capacity_sd_j: f32,
    capacity_weight: f32,
    charge_rate: [u16; CHARGE_TENTHS],
}

impl SavedLessons {
    fn new(budget: &Budget) -> Self {
        let (capacity_j, capacity_sd_j) = budget.learned_capacity_j().unwrap_or_default();
        let capacity_weight = if capacity_j > 0.0 { budget.capacity_weight } else { 0.0 };
        Self { capacity_j, capacity_sd_j, capacity_weight, charge_rate: budget.charge_rate }
    }

    /// The learned capacity and its standard deviation, J. 0 before anything is learned.
    pub const fn capacity_j(&self) -> (f32, f32) {
        (self.capacity_j, self.capacity_sd_j)
    }

    /// The learned capacity as a share of the stated one. `None` if nothing is learned, or not of a
    /// battery of the stated size.
    fn capacity(&self, stated_j: f64) -> Option<Capacity> {
        let share = |joules: f32| (f64::from(joules) / stated_j) as f32;
        let (value, weight) = (share(self.capacity_j), self.capacity_weight);
        let learned = Capacity { value, weight, sd: share(self.capacity_sd_j) / value };
        learned.is_sound(1.0).then_some(learned)
    }
}

/// What a battery's state from an earlier run says of pauses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedPause {
    /// True if the robot has said that it is switched off.
    off: bool,
    /// Mean power at rest, W, if it is known.
    idle_w: Option<f32>,
    /// Unmetered time since the charge was known, s, and by how much it has lowered the lower
    /// bound, as a share.
    pause_s: f32,
    pause: f32,
}

impl SavedPause {
    /// Unmetered time since the charge was known, s.
    pub const fn pause_s(&self) -> f32 {
        self.pause_s
    }
}

impl SavedBattery {
    /// The battery in a budget, which contains a silence since the last sample beside the budget's
    /// unmetered time. `None` if it has none.
    pub fn new(budget: &Budget, silent_ns: u64) -> Option<Self> {
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
            unmetered_ns: budget.unmetered_ns.saturating_add(silent_ns),
            changes: budget.battery_changes,
            charging: budget.charge_state() == joulebus_wire::ChargeState::Charging,
            measured: has(budget_flag::MEASURED),
            mean_power_w: Some(budget.mean_power_w).filter(|watts| watts.is_finite()),
            pause: SavedPause {
                off: has(budget_flag::OFF),
                idle_w: Some(budget.idle_w).filter(|watts| watts.is_finite()),
                pause_s: budget.pause_s,
                pause: budget.pause,
            },
            lessons: SavedLessons::new(budget),
        })
    }

    /// Time without readings since its charge was known, s, and by how much that may have lowered it,
    /// as a share, at `now_ns` by the clock of the ledger. `None` if the platform has no battery.
    pub fn paused(&self, platform: &Platform, ledger: &Ledger, now_ns: u64) -> Option<(f32, f32)> {
        let battery = platform.battery.as_ref()?;
        let saved = (self, f32::NAN, &self.pause);
        let state = BatteryState::restored(saved, &self.lessons, battery, ledger);
        let at = At::new(ledger).silent_for(now_ns.saturating_sub(ledger.stamp_ns()?));
        Some(state.paused(&Counting::new(battery, platform), at))
    }

    /// Unmetered time that it contains, ns.
    pub const fn unmetered_ns(&self) -> u64 {
        self.unmetered_ns
    }

    /// What it says of pauses, which is stored apart: an older ledger lacks it.
    pub const fn pause(&self) -> SavedPause {
        self.pause
    }

    /// What its charges have taught, which is stored apart too.
    pub const fn lessons(&self) -> SavedLessons {
        self.lessons
    }

    /// The same battery with other pauses, and other lessons.
    #[must_use]
    pub const fn with_pause(self, pause: SavedPause, lessons: SavedLessons) -> Self {
        Self { pause, lessons, ..self }
    }

    /// Times that another battery was noticed.
    pub const fn changes(&self) -> u32 {
        self.changes
    }

    /// Mean power at the last sample, W, which is stored apart: an older ledger lacks it.
    pub const fn mean_power_w(&self) -> Option<f32> {
        self.mean_power_w
    }

    /// The same battery with another mean power.
    #[must_use]
    pub const fn with_mean_power_w(self, mean_power_w: Option<f32>) -> Self {
        Self { mean_power_w, ..self }
    }

    /// The same battery after an unknown time, when anything may be left.
    #[must_use]
    pub const fn without_bounds(self) -> Self {
        Self { soc_lo: 0.0, soc_hi: 1.0, soc_sd: 1.0, ..self }
    }

    fn bias_var(&self) -> f64 {
        f64::from(self.sensor_bias_sd).powi(2)
    }

    /// `None` if no worker can have written it.
    fn estimate(&self, counting_sd: f64) -> Option<EnergyLeft> {
        let [soc, lo, hi] = [self.soc, self.soc_lo, self.soc_hi].map(f64::from);
        let (sd, bias_sd) = (f64::from(self.soc_sd), f64::from(self.sensor_bias_sd));
        let covariance = f64::from(self.sensor_covariance);
        let bounded = covariance.abs() <= 1.0 && self.sensor_bias.abs() <= 1.0;
        let ordered = 0.0 <= lo && lo <= soc && soc <= hi && hi <= 1.0;
        let spread = (0.0..=1.0).contains(&sd) && (0.0..=1.0).contains(&bias_sd);
        // The monitor has at most the error of counting what is missing. The part that the sensor
        // shares is not the monitor's.
        let shared = covariance.powi(2) / self.bias_var().max(f64::MIN_POSITIVE);
        let counted = (sd * sd - shared).max(0.0).sqrt().min(counting_sd * (1.0 - soc));
        (bounded && ordered && spread).then_some(EnergyLeft {
            below: (soc - SIGMAS * sd - lo).max(0.0),
            above: (hi - soc - SIGMAS * sd).max(0.0),
            // Its range's is part of the stated deviation.
            ..EnergyLeft::stated(soc, sd, counted)
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
    /// Saved by an earlier run, with the mean power then, W, NaN if unknown. A gap since is valued by
    /// it.
    Saved(
        SavedBattery,
        f32,
        SavedPause,
        #[serde(deserialize_with = "versions::read")] SavedLessons,
    ),
}

impl Known {
    pub(crate) fn saved(battery: SavedBattery) -> Self {
        let mean_w = battery.mean_power_w.filter(|watts| watts.is_finite());
        Self::Saved(battery, mean_w.unwrap_or(f32::NAN), battery.pause, battery.lessons)
    }
}
