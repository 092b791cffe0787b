//! The newest observations of each robot, from messages at any rate, and its sample at a given
//! time.
//!
//! Commands and readings arrive in messages of their own, each at its own rate. A sample is made of
//! the newest ones:
//! - A reading that was in no sample yet is a new measurement, made when its message arrived,
//!   because a robot's clock is not this host's. The newest of several readings between two samples
//!   counts.
//! - The same reading again is *held* until `reading_holds_s`. Then the sample has none, and the
//!   worker bridges the gap.
//! - A command holds until the next one, at most for `command_holds_s`. Then it is unknown, or 0 if
//!   the robot stops by itself.
//! - The charging state holds until it changes. If messages report it, it is unknown until the
//!   first of them, and so is the meaning of the battery's power. If none do, the robot never
//!   charges, and neither does one from which such a message has not come within
//!   `silent_after_s` of its first other one. A battery's power from before a change is dropped.
//! - On the charger the battery's power is no consumption. A robot of which no message reports
//!   charging is on its charger while its power is negative at rest for seconds.
//! - A current that nobody measures is unknown, and so is the power made of it: the number that a
//!   format reserves, or one that never changes while the robot moves and the voltage changes.
//! - A robot that says that it is switched off is in one more frame, which says so. Then it is left
//!   out until its next message.
//! - A battery is exchanged where a message says so and the one before did not, or where it is there
//!   again after it was missing for longer than `silent_after_s`.
//! - Packs of one robot are summed. A pack without a reading for `reading_holds_s` makes the battery
//!   unknown.
//! - A robot without any message for `silent_after_s` is left out of the frame, and the worker
//!   reports that.

use std::collections::BTreeMap;

use joulebus_plausibility as plausibility;
use joulebus_plausibility::{
    ChargerWatch, CurrentMonitor, Expired, Origin, Packed, Packs, is_charge,
};
use joulebus_publisher::{Charger, Judgement, RobotState};
use joulebus_settings::ChargeReading;

use crate::mapping::fields::SOC;
use crate::mapping::observation::{Observation, PowerOf, PowerReading};

/// Times for which observed values hold, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Holds {
    pub(crate) command_ns: u64,
    pub(crate) expired: Expired,
    pub(crate) reading_ns: u64,
    pub(crate) silent_ns: u64,
}

#[derive(Debug, Clone, Copy)]
struct Timed<T> {
    value: T,
    at_ns: u64,
}

impl<T: Copy> Timed<T> {
    /// The value, if it is not older than `holds_ns`.
    fn within(&self, holds_ns: u64, now_ns: u64) -> Option<T> {
        (now_ns.saturating_sub(self.at_ns) <= holds_ns).then_some(self.value)
    }
}

#[derive(Debug, Clone, Copy)]
struct Robot {
    charge_reading: ChargeReading,
    any_ns: Option<u64>,
    v_mps: Option<Timed<f32>>,
    omega_radps: Option<Timed<f32>>,
    power: Option<Timed<PowerReading>>,
    /// The reading was already part of a sample.
    sampled: bool,
    /// A value came that was in no sample.
    is_fresh: bool,
    voltage_v: Option<Timed<f32>>,
    current_a: Option<Timed<f32>>,
    soc: Option<Timed<f32>>,
    /// A share above what any battery reports: all of them are percentages, 1 is no full battery.
    percent: bool,
    /// `None` if messages report it and none has come yet.
    charging: Option<bool>,
    /// True if a message has come that reports it, and when the first of any kind came.
    has_reported: bool,
    first_ns: u64,
    full: bool,
    /// When a message last said that the battery was exchanged, monotonic ns, whether it is missing
    /// and since when, and whether a frame has yet to say that it was exchanged.
    swapped_ns: Option<u64>,
    removed: bool,
    removed_ns: Option<u64>,
    has_swapped: bool,
    /// A message has said that the robot is switched off, and whether a frame has.
    off: bool,
    sampled_off: bool,
    monitor: CurrentMonitor,
    power_of_current: bool,
    /// A message has said whether the robot charges. Otherwise the sign of its power does.
    says_charging: bool,
    watch: ChargerWatch,
    on_charger: bool,
}

/// The newest observations of all robots of the mapping.
#[derive(Debug, Clone)]
pub(crate) struct Intake {
    holds: Holds,
    reports_charging: bool,
    robots: BTreeMap<u32, Robot>,
    /// The packs that each robot has, and what is known of them.
    packs: Packs,
    packs_of: BTreeMap<u32, Packs>,
    observations: u64,
    judgement: Judgement,
}

impl Intake {
    /// Creates the intake for these robots, each with what its battery's power means while it
    /// charges. `reports_charging` states that messages report whether a robot charges.
    pub(crate) fn new(
        holds: Holds,
        reports_charging: bool,
        robots: impl IntoIterator<Item = (u32, ChargeReading)>,
    ) -> Self {
        let robot = |(id, charge_reading)| (id, Robot::new(charge_reading, reports_charging));
        Self {
            holds,
            reports_charging,
            robots: robots.into_iter().map(robot).collect(),
            packs: Packs::new(Vec::new()),
            packs_of: BTreeMap::new(),
            observations: 0,
            judgement: Judgement::new(Origin::Bridge, Vec::new()),
        }
    }

    #[must_use]
    pub(crate) fn judged_by(self, judgement: Judgement) -> Self {
        Self { judgement, ..self }
    }

    /// With several packs of each robot.
    #[must_use]
    pub(crate) fn with_packs(self, packs: Packs) -> Self {
        Self { packs, ..self }
    }

    pub(crate) const fn judgement(&mut self) -> &mut Judgement {
        &mut self.judgement
    }

    /// Forgets what was observed: the simulation has begun anew.
    pub(crate) fn forget(&mut self) {
        self.packs_of.clear();
        for robot in self.robots.values_mut() {
            *robot = Robot::new(robot.charge_reading, self.reports_charging);
        }
    }

    /// Adds an observation of a robot made at `at_ns` (monotonic). A robot that the mapping does
    /// not have is ignored. Returns the number of a pack without which its battery is unknown.
    pub(crate) fn take(&mut self, robot: u32, seen: &Observation, at_ns: u64) -> Option<usize> {
        let Some((pack, mapped)) = seen.pack.filter(|_| self.robots.contains_key(&robot)) else {
            self.take_whole(robot, seen, at_ns);
            return None;
        };
        let packs = self.packs_of.entry(robot).or_insert_with(|| self.packs.clone());
        match packs.take(pack, mapped, at_ns, self.holds.reading_ns) {
            Packed::Whole(mapped) => self.take_whole(robot, &Observation::of(&mapped), at_ns),
            Packed::Missing(missing) => return Some(missing),
            Packed::Waits => {}
        }
        None
    }

    fn take_whole(&mut self, robot: u32, seen: &Observation, at_ns: u64) {
        let Some(known) = self.robots.get_mut(&robot).filter(|_| !seen.is_empty()) else {
            return;
        };
        if seen.removed == Some(true) {
            // Nothing else is known of the robot by it, nor that it is there.
            return known.note_exchange(seen, self.holds.silent_ns, at_ns);
        }
        self.observations += 1;
        if seen.has_ended {
            // What it said last is no longer so.
            let monitor = known.monitor;
            *known = Robot { monitor, ..Robot::new(known.charge_reading, self.reports_charging) };
            return;
        }
        let seen = &known.measured(seen, self.holds, at_ns);
        known.any_ns = Some(at_ns);
        known.first_ns = known.first_ns.min(at_ns);
        known.has_reported |= seen.reports_charging;
        for (value, place) in [
            (seen.v_mps, &mut known.v_mps),
            (seen.omega_radps, &mut known.omega_radps),
            (seen.voltage_v, &mut known.voltage_v),
            (seen.current_a, &mut known.current_a),
            (seen.soc, &mut known.soc),
        ] {
            set(place, value, at_ns);
        }
        known.is_fresh = true;
        known.percent |= seen.soc.is_some_and(|soc| soc > *SOC.end());
        let is_of_battery = |timed: Timed<PowerReading>| timed.value.of == PowerOf::Battery;
        let charging = seen.charging.or(known.charging);
        if charging != known.charging {
            known.power = known.power.filter(|timed| !is_of_battery(*timed));
        }
        known.charging = charging;
        known.says_charging |= seen.charging.is_some();
        known.full = seen.full.unwrap_or(known.full);
        known.note_exchange(seen, self.holds.silent_ns, at_ns);
        known.off = seen.off == Some(true);
        known.sampled_off &= known.off;
        if seen.power.is_some() {
            set(&mut known.power, seen.power, at_ns);
            known.power_of_current = seen.power_of_current;
            known.sampled = false;
        }
    }

    /// The state of a robot for the sample of `now_ns` (monotonic). `None` if the robot has been
    /// silent for too long.
    pub(crate) fn sample(&mut self, robot: u32, now_ns: u64) -> Option<RobotState> {
        let (holds, known) = (self.holds, self.robots.get_mut(&robot)?);
        let any_ns = known.any_ns?;
        if now_ns.saturating_sub(any_ns) > holds.silent_ns {
            return None;
        }
        if known.off {
            let is_new = !std::mem::replace(&mut known.sampled_off, true);
            return is_new.then(|| RobotState::new(robot).off());
        }
        let is_unreported =
            !known.has_reported && now_ns.saturating_sub(known.first_ns) > holds.silent_ns;
        let charging = known.charging.or(is_unreported.then_some(false));
        let mut state = RobotState::new(robot);
        state.v_mps = command(known.v_mps, holds, now_ns);
        state.omega_radps = command(known.omega_radps, holds, now_ns);
        state.charger = match (known.charging, known.full) {
            (Some(true), true) => Charger::Full,
            (Some(true), false) => Charger::Charging,
            _ => Charger::Disconnected,
        };
        state.swapped = std::mem::take(&mut known.has_swapped);
        let number = |timed: Option<Timed<f32>>| timed?.within(holds.reading_ns, now_ns);
        state.voltage_v = number(known.voltage_v);
        state.current_a = number(known.current_a);
        let soc = number(known.soc);
        // The worker would refuse the whole sample.
        state.soc = soc.filter(|soc| SOC.contains(soc) && !known.percent);
        if let Some(timed) = &mut known.power {
            // The message may have come after `now_ns` was read. A held reading keeps the time that
            // its sample had.
            timed.at_ns = timed.at_ns.min(now_ns);
        }
        if let Some(timed) = known.power
            && let Some(reading) = timed.within(holds.reading_ns, now_ns)
        {
            state.power_w = known.power_w(reading, &state, charging);
            state.measured_ns = state.power_w.map(|_| timed.at_ns);
            state.held = known.sampled && state.power_w.is_some();
            known.sampled |= state.power_w.is_some();
        }
        // A robot without a power is judged by its other values.
        let is_new = match known.power {
            Some(_) => state.power_w.is_some() && !state.held,
            None => known.is_fresh,
        };
        known.is_fresh = false;
        if is_new {
            self.judgement.take(&state, soc, now_ns);
        }
        known.leave_out(&mut state, now_ns);
        Some(state)
    }

    /// The voltage of a robot's battery, unless it is too old.
    pub(crate) fn voltage_v(&self, robot: u32, now_ns: u64) -> Option<f32> {
        let timed = self.robots.get(&robot)?.voltage_v?;
        timed.within(self.holds.reading_ns, now_ns)
    }

    pub(crate) fn silent(&self) -> impl Iterator<Item = u32> {
        let silent = self.robots.iter().filter(|(_, known)| known.any_ns.is_none());
        silent.map(|(id, _)| *id)
    }

    /// Robots with messages, but without one that reports whether they charge, though others have
    /// such messages.
    pub(crate) fn unreported(&self) -> impl Iterator<Item = u32> {
        let unreported =
            self.robots.iter().filter(|(_, known)| known.any_ns.is_some() && !known.has_reported);
        unreported.map(|(id, _)| *id)
    }

    pub(crate) const fn observations(&self) -> u64 {
        self.observations
    }
}

impl Robot {
    const fn new(charge_reading: ChargeReading, reports_charging: bool) -> Self {
        Self {
            charge_reading,
            any_ns: None,
            v_mps: None,
            omega_radps: None,
            power: None,
            sampled: false,
            is_fresh: false,
            voltage_v: None,
            current_a: None,
            soc: None,
            percent: false,
            charging: if reports_charging { None } else { Some(false) },
            has_reported: !reports_charging,
            first_ns: u64::MAX,
            full: false,
            swapped_ns: None,
            // One that never was there is only not reported.
            removed: true,
            removed_ns: None,
            has_swapped: false,
            off: false,
            sampled_off: false,
            monitor: CurrentMonitor::new(),
            power_of_current: false,
            says_charging: false,
            watch: ChargerWatch::new(),
            on_charger: false,
        }
    }

    fn note_exchange(&mut self, seen: &Observation, holds_ns: u64, at_ns: u64) {
        let said = |before_ns: u64| at_ns.saturating_sub(before_ns) <= holds_ns;
        match seen.swapped {
            Some(true) => {
                self.has_swapped |= !self.swapped_ns.is_some_and(said);
                self.swapped_ns = Some(at_ns);
            }
            Some(false) => self.swapped_ns = None,
            None => {}
        }
        // A battery that is missing for less is a driver that had no answer, or another slot.
        match seen.removed {
            Some(true) if !self.removed => (self.removed, self.removed_ns) = (true, Some(at_ns)),
            Some(false) => {
                let since_ns = self.removed_ns.take();
                self.has_swapped |= since_ns.is_some_and(|since_ns| !said(since_ns));
                self.removed = false;
            }
            _ => {}
        }
    }

    /// The observation without a current that is not measured, and without the power made of it.
    fn measured(&mut self, seen: &Observation, holds: Holds, at_ns: u64) -> Observation {
        let number = |value: Option<f32>| value.map_or(f64::NAN, f64::from);
        let voltage_v = seen.voltage_v.or(self.voltage_v.map(|timed| timed.value));
        self.monitor.take(&plausibility::Observation {
            voltage_v: number(voltage_v),
            current_a: number(seen.current_a),
            v_mps: number(seen.v_mps.or(command(self.v_mps, holds, at_ns))),
            omega_radps: number(seen.omega_radps.or(command(self.omega_radps, holds, at_ns))),
            ..plausibility::Observation::at(0.0)
        });
        if !seen.is_reserved || self.monitor.measures_one_ampere() {
            return *seen;
        }
        let power = seen.power.filter(|_| !seen.power_of_current);
        Observation { power, current_a: None, ..*seen }
    }

    /// Leaves out of a sample what is no consumption, though it was judged.
    fn leave_out(&mut self, state: &mut RobotState, now_ns: u64) {
        if self.monitor.is_unmeasured() {
            state.current_a = None;
        }
        let by_sign = !self.says_charging && self.charge_reading == ChargeReading::Load;
        if let (Some(power_w), true) = (state.power_w, by_sign && !state.held) {
            let number = |value: Option<f32>| value.map_or(f64::NAN, f64::from);
            self.on_charger = self.watch.take(&plausibility::Observation {
                power_w: power_w.into(),
                v_mps: number(state.v_mps),
                omega_radps: number(state.omega_radps),
                ..plausibility::Observation::at(now_ns as f64 * 1e-9)
            });
        }
        let is_on_charger = by_sign && self.on_charger;
        if is_on_charger {
            state.charger = Charger::Charging;
        }
        if is_on_charger || (self.power_of_current && self.monitor.is_unmeasured()) {
            (state.power_w, state.measured_ns, state.held) = (None, None, false);
        }
    }

    /// The power that the platform's config expects. On the charger the battery's power has the
    /// meaning of `charge_reading`. With `load` the consumption is then unknown.
    fn power_w(
        &self,
        reading: PowerReading,
        state: &RobotState,
        charging: Option<bool>,
    ) -> Option<f32> {
        let product_w = state.voltage_v.zip(state.current_a).map(|(volt, ampere)| volt * ampere);
        let product_w = product_w.map_or(f64::NAN, f64::from);
        let of_battery = reading.of == PowerOf::Battery;
        match (charging, self.charge_reading) {
            (_, ChargeReading::Battery) => Some(reading.power_w),
            (None, _) => (!of_battery).then_some(reading.power_w),
            (Some(true), ChargeReading::Charger) if of_battery => Some(-reading.power_w),
            (Some(true), ChargeReading::Load)
                if is_charge(reading.power_w.into(), product_w, of_battery, charging) =>
            {
                None
            }
            _ => Some(reading.power_w),
        }
    }
}

fn set<T: Copy>(place: &mut Option<Timed<T>>, value: Option<T>, at_ns: u64) {
    if let Some(value) = value {
        *place = Some(Timed { value, at_ns });
    }
}

fn command(timed: Option<Timed<f32>>, holds: Holds, now_ns: u64) -> Option<f32> {
    let value = timed?.within(holds.command_ns, now_ns);
    let stopped = (holds.expired == Expired::Stops).then_some(0.0);
    value.or(stopped)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const HOLDS: Holds =
        Holds { command_ns: 50, expired: Expired::Unknown, reading_ns: 100, silent_ns: 300 };

    fn intake(holds: Holds, charge_reading: ChargeReading) -> Intake {
        Intake::new(holds, false, [(7, charge_reading)])
    }

    fn power(power_w: f32, of: PowerOf) -> Observation {
        Observation { power: Some(PowerReading { power_w, of }), ..Observation::default() }
    }

    fn command_of(v_mps: f32) -> Observation {
        Observation { v_mps: Some(v_mps), omega_radps: Some(-v_mps), ..Observation::default() }
    }

    #[test]
    fn readings_are_new_once_then_held_then_missing_and_a_silent_robot_is_left_out() {
        let mut intake = intake(HOLDS, ChargeReading::Load);
        assert_eq!(intake.sample(7, 5), None, "no message yet");
        intake.take(7, &power(3.0, PowerOf::Load), 10);
        intake.take(7, &power(4.0, PowerOf::Load), 15);
        for (now_ns, expected) in [
            (20, Some((Some(4.0), Some(15), false))),
            (50, Some((Some(4.0), Some(15), true))),
            (115, Some((Some(4.0), Some(15), true))),
            (116, Some((None, None, false))),
            (315, Some((None, None, false))),
            (316, None),
        ] {
            let sample = intake.sample(7, now_ns);
            let seen = sample.map(|state| (state.power_w, state.measured_ns, state.held));
            assert_eq!(seen, expected, "at {now_ns}");
        }
        intake.take(7, &power(5.0, PowerOf::Load), 400);
        assert!(!intake.sample(7, 410).unwrap().held, "it is back");
        intake.take(8, &power(5.0, PowerOf::Load), 400);
        assert_eq!((intake.sample(8, 410), intake.observations()), (None, 3), "not in the mapping");
        intake.forget();
        assert_eq!(intake.sample(7, 410), None, "a simulation that begins anew");
    }

    #[test]
    fn commands_come_at_their_own_rate_and_expire() {
        for (expired, after) in [(Expired::Unknown, None), (Expired::Stops, Some(0.0))] {
            let mut intake = intake(Holds { expired, ..HOLDS }, ChargeReading::Load);
            intake.take(7, &power(3.0, PowerOf::Load), 5);
            let state = intake.sample(7, 6).unwrap();
            assert_eq!((state.v_mps, state.omega_radps), (None, None), "never commanded");
            intake.take(7, &command_of(0.5), 10);
            assert_eq!(intake.sample(7, 60).unwrap().v_mps, Some(0.5));
            let state = intake.sample(7, 61).unwrap();
            assert_eq!((state.v_mps, state.omega_radps), (after, after));
            assert_eq!(state.power_w, Some(3.0), "its reading is not affected");
        }
    }

    #[test]
    fn a_robot_that_is_switched_off_says_so_in_one_frame_and_its_next_message_ends_that() {
        let mut intake = intake(HOLDS, ChargeReading::Load);
        let off = |off| Observation { off: Some(off), ..Observation::default() };
        intake.take(7, &power(3.0, PowerOf::Load), 10);
        assert!(!intake.sample(7, 20).unwrap().off);
        // A broken connection is not its word.
        intake.take(7, &off(false), 25);
        assert_eq!(intake.sample(7, 28).unwrap().power_w, Some(3.0));
        for at_ns in [30, 40] {
            intake.take(7, &off(true), at_ns);
        }
        assert_eq!(intake.sample(7, 45), Some(RobotState::new(7).off()));
        assert_eq!((intake.sample(7, 50), intake.sample(7, 60)), (None, None));
        intake.take(7, &power(3.0, PowerOf::Load), 70);
        let back = intake.sample(7, 75).unwrap();
        assert_eq!((back.off, back.power_w), (false, Some(3.0)));
    }

    #[test]
    fn an_exchange_is_told_once_by_its_flag_or_by_a_battery_that_was_removed() {
        let mut intake = intake(HOLDS, ChargeReading::Load);
        let swapped = |swapped| Observation { swapped: Some(swapped), ..Observation::default() };
        let removed = |removed| Observation { removed: Some(removed), ..Observation::default() };
        for (seen, at_ns, told) in [
            (power(3.0, PowerOf::Load), 10, false),
            // Drivers that never say that there is one.
            (removed(true), 20, false),
            (swapped(true), 30, true),
            (swapped(true), 40, false),
            (swapped(false), 50, false),
            (swapped(true), 60, true),
            (removed(false), 70, false),
            // A slot without an answer for a moment.
            (removed(true), 80, false),
            (removed(false), 90, false),
            (removed(true), 100, false),
            (removed(true), 110, false),
            (removed(false), 101 + HOLDS.silent_ns, true),
            (removed(false), 102 + HOLDS.silent_ns, false),
        ] {
            intake.take(7, &seen, at_ns);
            assert_eq!(intake.sample(7, at_ns + 1).unwrap().swapped, told, "at {at_ns}");
            assert!(!intake.sample(7, at_ns + 2).unwrap().swapped, "at {at_ns}");
        }
    }

    /// A percentage where a share is expected: 1 % is no full battery.
    #[test]
    fn a_robot_has_one_unit_of_its_charge() {
        let mut intake = intake(HOLDS, ChargeReading::Load);
        let charge = |soc| Observation { soc: Some(soc), ..Observation::default() };
        for (soc, taken) in [(0.5, Some(0.5)), (96.0, None), (1.0, None), (0.4, None)] {
            intake.take(7, &charge(soc), 10);
            assert_eq!(intake.sample(7, 20).unwrap().soc, taken, "{soc}");
        }
    }

    /// A robot that is gone has no sample until it comes again, and one without a power is judged.
    #[test]
    fn a_robot_that_ends_has_no_sample_and_one_without_a_power_is_judged() {
        let mut intake = intake(HOLDS, ChargeReading::Load);
        intake.take(7, &power(3.0, PowerOf::Load), 10);
        assert!(intake.sample(7, 20).is_some());
        intake.take(7, &Observation { has_ended: true, ..Observation::default() }, 30);
        assert_eq!(intake.sample(7, 40), None);
        intake.take(7, &power(3.0, PowerOf::Load), 50);
        assert!(intake.sample(7, 60).is_some_and(|state| state.power_w == Some(3.0)));
        let mut intake = super::Intake::new(HOLDS, false, [(7, ChargeReading::Load)]);
        for step in 0..200 {
            let drives = Observation {
                v_mps: Some(0.3),
                voltage_v: Some(24.1),
                soc: Some(0.006_52),
                ..Observation::default()
            };
            intake.take(7, &drives, 10 * step);
            intake.sample(7, 10 * step);
        }
        let found = intake.judgement().records();
        assert!(found.iter().any(|one| one.finding.kind == plausibility::Kind::Unit), "{found:?}");
    }

    #[test]
    fn a_batterys_power_on_the_charger_means_what_the_platform_states() {
        let charging = Observation {
            charging: Some(true),
            full: Some(true),
            ..power(-40.0, PowerOf::Battery)
        };
        for (charge_reading, of, expected) in [
            (ChargeReading::Battery, PowerOf::Battery, Some(-40.0)),
            (ChargeReading::Charger, PowerOf::Battery, Some(40.0)),
            (ChargeReading::Load, PowerOf::Battery, None),
            (ChargeReading::Load, PowerOf::Load, None),
        ] {
            let mut intake = intake(HOLDS, charge_reading);
            let power = power(-40.0, of).power;
            intake.take(7, &Observation { power, ..charging }, 10);
            let state = intake.sample(7, 20).unwrap();
            assert_eq!(state.power_w, expected, "{charge_reading:?} {of:?}");
            assert_eq!(state.measured_ns.is_some(), expected.is_some());
            assert_eq!(state.charger, Charger::Full);
            let left = Observation { charging: Some(false), ..power_alone(12.0) };
            intake.take(7, &left, 30);
            let state = intake.sample(7, 40).unwrap();
            assert_eq!((state.power_w, state.charger), (Some(12.0), Charger::Disconnected));
        }
    }

    /// What each door makes of messages: a robot that drives, and then takes energy at rest, or
    /// whose driver measures no current.
    #[test]
    fn what_is_charged_or_not_measured_is_no_consumption_at_any_door() {
        const STEP_NS: u64 = 100_000_000;
        let doors: [(&str, Option<PowerOf>, bool); 4] = [
            ("MQTT, power", Some(PowerOf::Load), false),
            ("MQTT, power of the battery", Some(PowerOf::Battery), false),
            ("MQTT or VDA 5050, power of current", None, false),
            ("ROS 2, BatteryState", None, true),
        ];
        // Current of a step, what messages say of charging, and whether the end has a power.
        type Current = fn(u64) -> f32;
        let load: Current = |step| 2.0 + 0.1 * (step % 7) as f32;
        let dock: Current = |step| if step < 300 { 2.0 + 0.1 * (step % 7) as f32 } else { -3.0 };
        let cases: [(&str, Current, Option<bool>, [bool; 4]); 7] = [
            ("drives", load, None, [true; 4]),
            ("drives, and says so", load, Some(false), [true; 4]),
            ("docks, and says so", dock, Some(true), [false; 4]),
            ("docks in silence", dock, None, [false; 4]),
            ("feeds back, and says that it does not charge", dock, Some(false), [true; 4]),
            ("−1 A", |_| -1.0, None, [true, true, false, false]),
            ("0.01 A", |_| 0.01, None, [true, true, false, false]),
        ];
        for (case, current, says, expected) in cases {
            for ((door, of, is_ros), expected) in doors.iter().zip(expected) {
                let holds = Holds {
                    command_ns: 5 * STEP_NS,
                    reading_ns: 10 * STEP_NS,
                    silent_ns: 50 * STEP_NS,
                    ..HOLDS
                };
                let mut intake = Intake::new(holds, false, [(7, ChargeReading::Load)]);
                let mut last = None;
                for step in 0..400 {
                    let ampere = current(step);
                    let volt = 24.0 + 0.01 * (step % 5) as f32;
                    // A meter of its own measures what the current does not say.
                    let metered_w = volt * if case.ends_with(" A") { load(step) } else { ampere };
                    let power_w = if of.is_some() { metered_w } else { volt * ampere };
                    let power = Some(PowerReading { power_w, of: of.unwrap_or(PowerOf::Battery) });
                    let seen = Observation {
                        power,
                        power_of_current: of.is_none(),
                        voltage_v: Some(volt),
                        current_a: Some(ampere),
                        is_reserved: *is_ros && ampere == -1.0,
                        charging: says.map(|charging| charging && step >= 300),
                        v_mps: Some(if step < 300 { 0.3 } else { 0.0 }),
                        omega_radps: Some(0.0),
                        ..Observation::default()
                    };
                    intake.take(7, &seen, step * STEP_NS);
                    last = intake.sample(7, step * STEP_NS);
                    let is_unknown = *is_ros && case == "−1 A";
                    let power_w = last.and_then(|state| state.power_w);
                    assert!(!is_unknown || power_w.is_none(), "from the first message on");
                }
                let state = last.unwrap();
                assert_eq!(state.power_w.is_some(), expected, "{door}: {case}: {state:?}");
                assert_eq!(state.measured_ns.is_some(), expected, "{door}: {case}");
                let is_docked = case.starts_with("docks");
                assert_eq!(state.charger == Charger::Charging, is_docked, "{door}: {case}");
                if ["−1 A", "0.01 A"].contains(&case) {
                    assert_eq!(state.current_a, None, "{door}: {case}");
                }
            }
        }
        // A coarse monitor at rest may stand still, whether or not a message says that the robot
        // rests, and one ampere may be measured.
        for (current, v_mps, reserved) in [
            ((|_| 0.3) as Current, Some(0.0), false),
            (|_| 0.3, None, false),
            (|_| 1.0, None, false),
            (|step| [-0.9, -1.0, -1.1][(step % 3) as usize], Some(0.3), true),
        ] {
            let mut intake = intake(HOLDS, ChargeReading::Load);
            let mut known = 0;
            for step in 0..300 {
                let ampere = current(step);
                let volt = 24.0 + 0.01 * (step % 5) as f32;
                let seen = Observation {
                    is_reserved: reserved && ampere == -1.0,
                    power_of_current: true,
                    power: Some(PowerReading {
                        power_w: volt * ampere.abs(),
                        of: PowerOf::Battery,
                    }),
                    voltage_v: Some(volt),
                    current_a: Some(ampere.abs()),
                    v_mps: v_mps.or((step < 20).then_some(0.3)),
                    ..Observation::default()
                };
                intake.take(7, &seen, 10 * step);
                known += u32::from(intake.sample(7, 10 * step).unwrap().power_w.is_some());
            }
            assert_eq!(known, 300, "{v_mps:?} m/s");
            let found = intake.judgement().records();
            let is_told = found.iter().any(|one| one.finding.kind == plausibility::Kind::Constant);
            assert!(!is_told, "{v_mps:?} m/s: {found:?}");
        }
    }

    #[test]
    fn packs_make_one_battery_and_a_missing_one_leaves_none() {
        let pack = |number: usize, ampere: f64, soc: f64| {
            let said = plausibility::Said {
                product_of: Some(PowerOf::Battery),
                charging: Some(false),
                ..plausibility::Said::default()
            };
            let said = said
                .with(plausibility::Field::Voltage, 24.0)
                .with(plausibility::Field::Current, ampere)
                .with(plausibility::Field::Soc, soc);
            Observation { pack: Some((number, said.map(|_, _| {}))), ..Observation::default() }
        };
        let mut intake =
            intake(HOLDS, ChargeReading::Load).with_packs(Packs::new(vec![100.0, 300.0]));
        assert_eq!(intake.take(7, &pack(0, 1.0, 0.9), 10), None);
        assert_eq!(intake.sample(7, 15), None, "half a battery is none");
        assert_eq!(intake.take(7, &pack(1, 2.0, 0.3), 20), None);
        let state = intake.sample(7, 25).unwrap();
        let found = (state.power_w, state.voltage_v, state.current_a, state.soc);
        assert_eq!(found, (Some(72.0), Some(24.0), Some(3.0), Some(0.45)));
        // The second falls silent: the readings expire, and it is named.
        let missing: Vec<_> =
            (30..200).step_by(10).map(|at_ns| intake.take(7, &pack(0, 1.0, 0.9), at_ns)).collect();
        assert_eq!((missing[0], missing[16]), (None, Some(1)));
        let state = intake.sample(7, 200).unwrap();
        assert_eq!((state.power_w, state.voltage_v, state.soc), (None, None, None));
        assert_eq!(intake.take(9, &pack(0, 1.0, 0.9), 200), None, "no robot of the mapping");
    }

    #[test]
    fn a_robot_whose_messages_never_report_charging_has_a_power() {
        // Messages of another route report it of other robots.
        let mut intake = Intake::new(HOLDS, true, [(7, ChargeReading::Load)]);
        let mut last = None;
        for at_ns in (10..HOLDS.silent_ns + 100).step_by(10) {
            intake.take(7, &power(12.0, PowerOf::Battery), at_ns);
            last = intake.sample(7, at_ns).unwrap().power_w;
            assert_eq!(last.is_some(), at_ns - 10 > HOLDS.silent_ns, "{at_ns}");
        }
        assert_eq!((last, intake.unreported().collect::<Vec<_>>()), (Some(12.0), vec![7]));
        // A field that such a message names, and does not have, is no report.
        let mut intake = Intake::new(HOLDS, true, [(7, ChargeReading::Load)]);
        let seen = Observation { reports_charging: true, ..power(12.0, PowerOf::Battery) };
        for at_ns in (10..HOLDS.silent_ns + 100).step_by(10) {
            intake.take(7, &seen, at_ns);
            assert_eq!(intake.sample(7, at_ns).unwrap().power_w, None, "{at_ns}");
        }
        assert_eq!(intake.unreported().count(), 0);
    }

    #[test]
    fn a_batterys_power_means_nothing_before_it_is_known_whether_the_robot_charges() {
        for (charge_reading, of, expected) in [
            (ChargeReading::Load, PowerOf::Battery, None),
            (ChargeReading::Charger, PowerOf::Battery, None),
            (ChargeReading::Battery, PowerOf::Battery, Some(-40.0)),
            (ChargeReading::Load, PowerOf::Load, Some(-40.0)),
        ] {
            let mut intake = Intake::new(HOLDS, true, [(7, charge_reading)]);
            intake.take(7, &power(-40.0, of), 10);
            let state = intake.sample(7, 20).unwrap();
            assert_eq!((state.power_w, state.charger), (expected, Charger::Disconnected));
            let other = Observation { charging: Some(false), ..power(12.0, of) };
            intake.take(7, &other, 30);
            let state = intake.sample(7, 40).unwrap();
            assert_eq!((state.power_w, state.held), (Some(12.0), false));
        }
    }

    #[test]
    fn charging_applies_until_a_message_states_otherwise() {
        let mut intake = intake(HOLDS, ChargeReading::Load);
        let charging =
            |charging| Observation { charging: Some(charging), ..Observation::default() };
        intake.take(7, &charging(true), 30);
        for at_ns in (100..2_000).step_by(100) {
            intake.take(7, &power(-40.0, PowerOf::Battery), at_ns);
            let state = intake.sample(7, at_ns + 10).unwrap();
            assert_eq!((state.charger, state.power_w), (Charger::Charging, None), "at {at_ns}");
        }
        intake.take(7, &charging(false), 2_000);
        let state = intake.sample(7, 2_010).unwrap();
        assert_eq!((state.charger, state.power_w), (Charger::Disconnected, None), "of before");
        intake.take(7, &power(12.0, PowerOf::Battery), 2_020);
        let state = intake.sample(7, 2_030).unwrap();
        assert_eq!((state.power_w, state.held), (Some(12.0), false));
    }

    #[test]
    fn a_reading_that_came_after_the_samples_time_keeps_the_time_that_was_stated() {
        let mut intake = intake(HOLDS, ChargeReading::Load);
        intake.take(7, &power(3.0, PowerOf::Load), 12);
        for (now_ns, held) in [(10, false), (20, true)] {
            let state = intake.sample(7, now_ns).unwrap();
            assert_eq!((state.measured_ns, state.held), (Some(10), held), "at {now_ns}");
        }
    }

    fn power_alone(power_w: f32) -> Observation {
        power(power_w, PowerOf::Battery)
    }

    proptest! {
        /// Compares with a list of all observations, searched again for each sample.
        #[test]
        fn samples_are_of_the_newest_of_each(
            steps in prop::collection::vec((1u64..40, 0u8..4, -9.0f32..9.0), 1..80),
        ) {
            let mut intake = intake(HOLDS, ChargeReading::Load);
            let mut all: Vec<(u64, Observation)> = Vec::new();
            let (mut now_ns, mut last_measured) = (0, None);
            for (pause, what, value) in steps {
                now_ns += pause;
                let seen = match what {
                    0 => power(value, PowerOf::Load),
                    1 => command_of(value),
                    2 => Observation { soc: Some(value), ..Observation::default() },
                    _ => Observation::default(),
                };
                intake.take(7, &seen, now_ns);
                if !seen.is_empty() {
                    all.push((now_ns, seen));
                }
                now_ns += 1;
                let newest = |of: fn(&Observation) -> bool| all.iter().rev().find(|(_, seen)| of(seen));
                let state = intake.sample(7, now_ns);
                let is_known = newest(|_| true).is_some_and(|(at_ns, _)| now_ns - at_ns <= 300);
                prop_assert_eq!(state.is_some(), is_known);
                let Some(state) = state else { continue };
                let reading = newest(|seen| seen.power.is_some()).filter(|(at_ns, _)| now_ns - at_ns <= 100);
                prop_assert_eq!(state.measured_ns, reading.map(|(at_ns, _)| *at_ns));
                prop_assert_eq!(state.power_w, reading.and_then(|(_, seen)| seen.power).map(|power| power.power_w));
                prop_assert_eq!(state.held, reading.is_some() && last_measured == state.measured_ns);
                last_measured = state.measured_ns.or(last_measured);
                let command = newest(|seen| seen.v_mps.is_some()).filter(|(at_ns, _)| now_ns - at_ns <= 50);
                prop_assert_eq!(state.v_mps, command.and_then(|(_, seen)| seen.v_mps));
                let soc = newest(|seen| seen.soc.is_some()).filter(|(at_ns, _)| now_ns - at_ns <= 100);
                let soc = soc.and_then(|(_, seen)| seen.soc).filter(|soc| SOC.contains(soc));
                // One that was above a share makes all of them percentages.
                let percent = all.iter().any(|(_, seen)| seen.soc.is_some_and(|soc| soc > 1.05));
                prop_assert_eq!(state.soc, soc.filter(|_| !percent));
            }
        }
    }
}
