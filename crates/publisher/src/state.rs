//! State of a robot as known to a controller, and its conversion to a sample.

use std::collections::HashMap;

use joulebus_wire::{Sample, sample_flag};

/// One robot in one control tick: the command just issued, and the reading just received. `None`
/// means unknown.
///
/// Made by [`RobotState::new`] and the methods that add what is known. Fields may be set as well.
///
/// ```
/// # use joulebus_publisher::{Charger, RobotState};
/// let driving = RobotState::new(7).command(0.2, 0.0).reading(4.6);
/// let mut docked = RobotState::new(8).charger(Charger::Charging);
/// docked.voltage_v = Some(12.4);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[must_use]
#[non_exhaustive]
pub struct RobotState {
    /// Id of the robot, unique in the fleet.
    pub robot: u32,
    /// Linear velocity just commanded, after saturation, m/s.
    pub v_mps: Option<f32>,
    /// Angular velocity just commanded, after saturation, rad/s.
    pub omega_radps: Option<f32>,
    /// Electrical power just read, W. Negative where the platform regenerates.
    pub power_w: Option<f32>,
    /// When the power was measured, monotonic ns. `None`: when the frame is published, or, for a
    /// held reading, when the repeated reading was measured.
    pub measured_ns: Option<u64>,
    /// Battery voltage, V.
    pub voltage_v: Option<f32>,
    /// Battery current, A, positive while discharging.
    pub current_a: Option<f32>,
    /// The reading repeats the previous one: the monitor has not measured again.
    pub held: bool,
    /// Measured state of charge, 0 to 1.
    pub soc: Option<f32>,
    /// Energy that the robot needs from here to return to its charger, J, by its planner. It
    /// applies to this frame. Without it the platform's config applies.
    pub return_j: Option<f32>,
    /// The robot's charger.
    pub charger: Charger,
    /// The battery has been exchanged since the last frame.
    pub swapped: bool,
    /// The robot is switched off: until its next frame it draws what it draws at rest. A silence
    /// without it costs the platform's greatest power.
    pub off: bool,
    /// What the robot reports is implausible: answers about its plans are never a yes. A
    /// [`crate::Publisher`] that judges sets it by itself.
    pub implausible: bool,
}

/// A value of a [`RobotState`] by its name in other languages, where columns hold it for all robots.
/// [`RobotState`] has an example.
#[derive(Debug, Clone, Copy)]
pub struct Column {
    /// Its name.
    pub name: &'static str,
    /// What it states, with its unit.
    pub doc: &'static str,
    /// How it is set.
    pub set: SetColumn,
}

/// Sets a value of a robot's state.
/// [`RobotState`] has an example.
#[derive(Debug, Clone, Copy)]
pub enum SetColumn {
    /// A number, or `None` if it is unknown.
    Number(fn(&mut RobotState, Option<f32>)),
    /// A truth value.
    Truth(fn(&mut RobotState, bool)),
}

use SetColumn::{Number, Truth};

/// Every column.
#[rustfmt::skip]
pub const COLUMNS: &[Column] = &[
    Column { name: "v", doc: "as commanded, m/s",
        set: Number(|robot, value| robot.v_mps = value) },
    Column { name: "omega", doc: "as commanded, rad/s",
        set: Number(|robot, value| robot.omega_radps = value) },
    Column { name: "power", doc: "W", set: Number(|robot, value| robot.power_w = value) },
    Column { name: "voltage", doc: "V", set: Number(|robot, value| robot.voltage_v = value) },
    Column { name: "current", doc: "A, positive while discharging",
        set: Number(|robot, value| robot.current_a = value) },
    Column { name: "soc", doc: "state of charge, 0 to 1",
        set: Number(|robot, value| robot.soc = value) },
    Column { name: "return_j", doc: "energy needed to return, J",
        set: Number(|robot, value| robot.return_j = value) },
    Column { name: "held", doc: "the reading repeats the one before",
        set: Truth(|robot, value| robot.held = value) },
    // A charger that reports "full" is connected, in whichever order the columns are given.
    Column { name: "charging", doc: "on its charger",
        set: Truth(|robot, value| if value && robot.charger == Charger::Disconnected {
            robot.charger = Charger::Charging;
        }) },
    Column { name: "full", doc: "on its charger, which reports that the battery is full",
        set: Truth(|robot, value| if value { robot.charger = Charger::Full }) },
    Column { name: "swapped", doc: "the battery has been exchanged since the last frame",
        set: Truth(|robot, value| robot.swapped = value) },
    Column { name: "off", doc: "switched off until the next frame",
        set: Truth(|robot, value| robot.off = value) },
];

/// A robot's charger.
///
/// [`RobotState`] has an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Charger {
    /// The robot is not on its charger, or that is not known.
    #[default]
    Disconnected,
    /// The robot is on its charger.
    Charging,
    /// The robot is on its charger, which reports that the battery is full.
    Full,
}

impl Charger {
    const fn flags(self) -> u32 {
        match self {
            Self::Disconnected => 0,
            Self::Charging => sample_flag::CHARGING,
            Self::Full => sample_flag::CHARGING | sample_flag::FULL,
        }
    }
}

impl RobotState {
    /// A robot without known values.
    pub fn new(robot: u32) -> Self {
        Self { robot, ..Self::default() }
    }

    /// With the command just issued: m/s and rad/s.
    pub const fn command(mut self, v_mps: f32, omega_radps: f32) -> Self {
        self.v_mps = Some(v_mps);
        self.omega_radps = Some(omega_radps);
        self
    }

    /// With the power just measured, W.
    pub const fn reading(mut self, power_w: f32) -> Self {
        self.power_w = Some(power_w);
        self.measured_ns = None;
        self.held = false;
        self
    }

    /// With a power measured at `measured_ns` (monotonic), W.
    pub const fn reading_of(mut self, power_w: f32, measured_ns: u64) -> Self {
        self.power_w = Some(power_w);
        self.measured_ns = Some(measured_ns);
        self.held = false;
        self
    }

    /// With the previous power repeated, W: the monitor has not measured again.
    pub const fn held_reading(mut self, power_w: f32) -> Self {
        self.power_w = Some(power_w);
        self.measured_ns = None;
        self.held = true;
        self
    }

    /// With the battery's voltage, V, and current, A (positive while discharging).
    pub const fn battery(mut self, voltage_v: f32, current_a: f32) -> Self {
        self.voltage_v = Some(voltage_v);
        self.current_a = Some(current_a);
        self
    }

    /// With the measured state of charge, 0 to 1.
    pub const fn state_of_charge(mut self, soc: f32) -> Self {
        self.soc = Some(soc);
        self
    }

    /// With the energy that the robot needs to return, J.
    pub const fn return_energy(mut self, return_j: f32) -> Self {
        self.return_j = Some(return_j);
        self
    }

    /// With the state of the charger.
    pub const fn charger(mut self, charger: Charger) -> Self {
        self.charger = charger;
        self
    }

    /// With a battery that has been exchanged since the last frame.
    pub const fn swapped(mut self) -> Self {
        self.swapped = true;
        self
    }

    /// Of a robot that is switched off: its last frame until it is switched on again.
    pub const fn off(mut self) -> Self {
        self.off = true;
        self
    }
}

/// Last published sequence number and stamp of each robot. When there are twice as many robots as a
/// frame holds, those not published for longest are forgotten.
///
/// Frames name the robots of a fleet in the same order, so a robot is looked for behind the one
/// before it first.
#[derive(Debug)]
pub(crate) struct Registry {
    robots: Vec<(u32, Last)>,
    /// Place of each robot.
    places: HashMap<u32, usize>,
    /// Place behind the last robot's.
    next: usize,
    most: usize,
    /// Number and stamp from which a robot continues that is new, or was forgotten, ns.
    seq_floor: u64,
    stamp_floor_ns: u64,
}

#[derive(Debug, Clone, Copy)]
struct Last {
    seq: u64,
    stamp_ns: u64,
    measured_ns: Option<u64>,
    frame: u64,
}

impl Registry {
    /// For frames of at most `capacity` robots.
    pub(crate) fn new(capacity: usize) -> Self {
        Self {
            robots: Vec::new(),
            places: HashMap::new(),
            next: 0,
            most: capacity.saturating_mul(2),
            seq_floor: 0,
            stamp_floor_ns: 0,
        }
    }

    /// The sample of `state` in frame `frame`, issued at `now_ns`. Allocates for robots that are
    /// new. `None` when the frame has the robot already.
    pub(crate) fn sample(&mut self, state: &RobotState, frame: u64, now_ns: u64) -> Option<Sample> {
        let place = self.place(state.robot);
        let before = place.map(|place| self.robots[place].1);
        if before.is_some_and(|last| last.frame == frame) {
            return None;
        }
        if before.is_none() && self.robots.len() == self.most {
            self.forget_half();
        }
        let seq = before.map_or(self.seq_floor, |last| last.seq + 1);
        // Stamps must rise, and a clock may show the same time twice.
        let least_ns = before.map_or(self.stamp_floor_ns, |last| last.stamp_ns + 1);
        let stamp_ns = now_ns.max(least_ns);
        let repeated_ns = before.and_then(|last| last.measured_ns);
        let measured_ns =
            state.measured_ns.or(repeated_ns.filter(|_| state.held)).unwrap_or(stamp_ns);
        let last = Last {
            seq,
            stamp_ns,
            measured_ns: state.power_w.map(|_| measured_ns).or(repeated_ns),
            frame,
        };
        self.set(place, (state.robot, last));
        Some(sample(state, seq, stamp_ns, measured_ns))
    }

    fn place(&self, robot: u32) -> Option<usize> {
        let is_next = self.robots.get(self.next).is_some_and(|(next, _)| *next == robot);
        if is_next { Some(self.next) } else { self.places.get(&robot).copied() }
    }

    fn set(&mut self, place: Option<usize>, robot: (u32, Last)) {
        let place = place.unwrap_or(self.robots.len());
        if let Some(known) = self.robots.get_mut(place) {
            *known = robot;
        } else {
            self.places.insert(robot.0, place);
            self.robots.push(robot);
        }
        self.next = place + 1;
    }

    /// Forgets the half that was not published for longest. A robot that comes back continues above
    /// the numbers and stamps of all that were forgotten, so its own still rise.
    fn forget_half(&mut self) {
        let mut frames: Vec<u64> = self.robots.iter().map(|(_, last)| last.frame).collect();
        let (_, median, _) = frames.select_nth_unstable(self.most / 2);
        // A frame holds at most half as many robots: some are older, and those of this frame stay.
        let oldest = *median;
        let (seq_floor, stamp_floor_ns) = (&mut self.seq_floor, &mut self.stamp_floor_ns);
        self.robots.retain(|(_, last)| {
            let stays = last.frame >= oldest;
            if !stays {
                *seq_floor = (*seq_floor).max(last.seq + 1);
                *stamp_floor_ns = (*stamp_floor_ns).max(last.stamp_ns + 1);
            }
            stays
        });
        let places = self.robots.iter().enumerate();
        self.places = places.map(|(place, (robot, _))| (*robot, place)).collect();
    }
}

fn sample(state: &RobotState, seq: u64, stamp_ns: u64, measured_ns: u64) -> Sample {
    let mut sample = Sample::new(state.robot, seq, stamp_ns);
    if let Some(power_w) = state.power_w {
        sample = sample.reading(power_w, measured_ns);
        if state.held {
            sample = sample.with(sample_flag::HELD);
        }
    }
    for (value, place, flag) in [
        (state.v_mps, &mut sample.v_mps, sample_flag::V),
        (state.omega_radps, &mut sample.omega_radps, sample_flag::OMEGA),
        (state.voltage_v, &mut sample.voltage_v, sample_flag::VOLTAGE),
        (state.current_a, &mut sample.current_a, sample_flag::CURRENT),
        (state.soc, &mut sample.soc, sample_flag::SOC),
        (state.return_j, &mut sample.return_j, sample_flag::RETURN),
    ] {
        if let Some(value) = value {
            *place = value;
            sample.flags |= flag;
        }
    }
    sample.flags |= state.charger.flags();
    if state.swapped {
        sample.flags |= sample_flag::SWAPPED;
    }
    if state.off {
        sample.flags |= sample_flag::OFF;
    }
    if state.implausible {
        sample.flags |= sample_flag::IMPLAUSIBLE;
    }
    sample
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_robot_has_its_own_rising_numbers_and_stamps() {
        let mut registry = Registry::new(4);
        let mut stamped = |robot, frame, now_ns| {
            let sample = registry.sample(&RobotState::new(robot), frame, now_ns);
            sample.map(|sample| (sample.seq, sample.stamp_ns))
        };
        assert_eq!(stamped(1, 0, 100), Some((0, 100)));
        assert_eq!(stamped(2, 0, 100), Some((0, 100)));
        assert_eq!(stamped(1, 0, 100), None, "twice in one frame");
        assert_eq!(stamped(1, 1, 200), Some((1, 200)));
        assert_eq!(stamped(1, 2, 200), Some((2, 201)), "the clock stood still");
        assert_eq!(stamped(1, 3, 150), Some((3, 202)), "the clock went back");
        assert_eq!(stamped(2, 9, 900), Some((1, 900)), "robot 2 was silent for a while");
    }

    #[test]
    fn a_hundred_thousand_robots_take_the_memory_of_two_frames_and_all_numbers_rise() {
        let mut registry = Registry::new(8);
        let mut last: HashMap<u32, (u64, u64)> = HashMap::new();
        for frame in 0..100_000_u64 {
            // One robot that is always there, and four that change. Each comes back later or soon.
            let name = (frame * 4) as u32;
            let robots = [u32::MAX, name, name + 1, name.wrapping_sub(7), (frame % 40) as u32];
            for robot in robots {
                let sample = registry.sample(&RobotState::new(robot), frame, 1_000 * frame);
                let Some(sample) = sample else {
                    continue;
                };
                let now = (sample.seq, sample.stamp_ns);
                if let Some(before) = last.insert(robot, now) {
                    assert!(now.0 > before.0 && now.1 > before.1, "robot {robot}");
                }
                assert!(registry.robots.len() <= 16, "robot {robot}");
            }
        }
        assert_eq!(last[&u32::MAX].1, 99_999_000, "stamps are not pushed ahead");
    }

    #[test]
    fn a_held_reading_keeps_the_time_of_the_measurement_it_repeats() {
        let mut registry = Registry::new(4);
        let fresh = RobotState::new(1).reading(3.5);
        let held = RobotState::new(1).held_reading(3.5);
        let silent = RobotState::new(1).command(0.1, 0.0);
        for (frame, state, now_ns, measured_ns) in [
            (0, fresh, 100, 100),
            (1, held, 200, 100),
            (2, silent, 300, 0),
            (3, held, 400, 100),
            (4, RobotState::new(1).reading_of(3.6, 450), 500, 450),
            (5, held, 600, 450),
            (6, fresh, 700, 700),
        ] {
            let sample = registry.sample(&state, frame, now_ns).unwrap();
            assert_eq!(sample.measured_ns, measured_ns, "frame {frame}");
        }
        let held = registry.sample(&RobotState::new(2).held_reading(1.0), 7, 800);
        assert_eq!(held.unwrap().measured_ns, 800, "nothing to repeat");
    }

    #[test]
    fn unknown_values_are_nan_and_not_flagged() {
        use sample_flag::{
            CHARGING, CURRENT, FULL, HELD, OFF, OMEGA, POWER, RETURN, SOC, SWAPPED, V, VOLTAGE,
        };
        let new = RobotState::new(1);
        let only_v = RobotState { v_mps: Some(0.0), ..new };
        for (state, flags) in [
            (new, 0),
            (only_v, V),
            (new.command(0.0, 0.0), V | OMEGA),
            (new.reading(0.0), POWER),
            (new.held_reading(0.0), POWER | HELD),
            (new.battery(0.0, 0.0), VOLTAGE | CURRENT),
            (new.charger(Charger::Disconnected), 0),
            (new.charger(Charger::Charging), CHARGING),
            (new.charger(Charger::Full), CHARGING | FULL),
            (new.charger(Charger::Full).swapped(), CHARGING | FULL | SWAPPED),
            (new.swapped(), SWAPPED),
            (new.off(), OFF),
            (new.state_of_charge(0.0), SOC),
            (new.return_energy(0.0), RETURN),
            // Without a reading there is nothing to repeat.
            (RobotState { held: true, ..new }, 0),
        ] {
            let sample = Registry::new(4).sample(&state, 0, 5).unwrap();
            assert_eq!(sample.flags, flags, "{state:?}");
            for (value, flag) in [
                (sample.v_mps, V),
                (sample.omega_radps, OMEGA),
                (sample.power_w, POWER),
                (sample.voltage_v, VOLTAGE),
                (sample.current_a, CURRENT),
                (sample.soc, SOC),
                (sample.return_j, RETURN),
            ] {
                assert_eq!(value.is_nan(), !sample.has(flag), "{state:?}");
            }
        }
        let claimed = Registry::new(4).sample(&new.reading(f32::NAN), 0, 5).unwrap();
        assert!(claimed.has(POWER) && claimed.power_w.is_nan(), "the worker refuses it");
    }
}
