//! Joins one robot's messages by time.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use mcap::records::MessageHeader;

use super::mapping::{CurrentSign, Mapping, RobotMapping, TimeSource};
use joulebus_ros_messages::{BatteryState, Header, Message, Odometry, RosType, Twist};

/// Maximum number of rows per robot, that of a trial; further ones are refused.
const MOST_ROWS: usize = 1 << 22;

/// Commands and measurements at one time. NaN for unknown values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// When the reading was made, ns of the selected clock.
    pub time_ns: u64,
    /// Commanded linear velocity, m/s.
    pub v_mps: f64,
    /// Commanded angular velocity, rad/s.
    pub omega_radps: f64,
    /// Position, m.
    pub x_m: f64,
    /// Position, m.
    pub y_m: f64,
    /// Heading, rad.
    pub theta_rad: f64,
    /// Battery voltage, V.
    pub voltage_v: f64,
    /// Battery current, A, positive while discharging.
    pub current_a: f64,
    /// Electrical power, W.
    pub power_w: f64,
    /// Measured state of charge, 0 to 1; NaN if the battery does not measure it.
    pub soc: f64,
    /// Measured linear velocity, m/s.
    pub v_measured_mps: f64,
    /// Measured angular velocity, rad/s.
    pub omega_measured_radps: f64,
}

/// Times of a message, by clock.
#[derive(Debug, Clone, Copy)]
struct Times {
    header_ns: Option<u64>,
    log_ns: u64,
    publish_ns: u64,
}

/// States of charge that the worker takes.
const SOC: RangeInclusive<f64> = -0.05..=1.05;

#[derive(Debug, Clone, Copy)]
pub(super) struct Reading {
    voltage_v: f64,
    current_a: f64,
    soc: f64,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Command {
    v_mps: f64,
    omega_radps: f64,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Motion {
    x_m: f64,
    y_m: f64,
    theta_rad: f64,
    v_mps: f64,
    omega_radps: f64,
}

/// Messages of one topic, with the reasons of refusals.
#[derive(Debug)]
pub(super) struct Lane<T> {
    items: Vec<(Times, T)>,
    pub(super) messages: u64,
    pub(super) refused: BTreeMap<String, u64>,
}

impl<T> Default for Lane<T> {
    fn default() -> Self {
        Self {
            items: Vec::new(),
            messages: 0,
            refused: BTreeMap::new(),
        }
    }
}

impl<T: Copy> Lane<T> {
    fn refuse(&mut self, why: impl Into<String>) {
        *self.refused.entry(why.into()).or_default() += 1;
    }

    fn push(&mut self, times: Times, item: T) {
        if self.items.len() < MOST_ROWS {
            self.items.push((times, item));
        } else {
            self.refuse(format!("more than {MOST_ROWS} of them"));
        }
    }

    /// Sorted by the selected clock; messages without that time are refused.
    fn timed(&mut self, clock: TimeSource) -> Vec<(u64, T)> {
        let mut timed = Vec::with_capacity(self.items.len());
        for (times, item) in std::mem::take(&mut self.items) {
            let time_ns = match clock {
                TimeSource::Header => times.header_ns,
                TimeSource::Publish => Some(times.publish_ns),
                TimeSource::Auto | TimeSource::Log => Some(times.log_ns),
            };
            match time_ns {
                Some(time_ns) => timed.push((time_ns, item)),
                None => self.refuse("its header has no stamp"),
            }
        }
        timed.sort_by_key(|(time_ns, _)| *time_ns);
        timed
    }
}

/// State of one robot during the scan.
pub(super) struct Track {
    pub(super) robot: RobotMapping,
    burst_ns: u64,
    odometry_age_ns: u64,
    wanted_time: TimeSource,
    pub(super) battery: Lane<Reading>,
    pub(super) command: Lane<Command>,
    pub(super) odometry: Lane<Motion>,
    without_stamp: u64,
    not_present: u64,
    charging: u64,
    /// Readings whose state of charge is none.
    odd_soc: u64,
}

/// A robot's rows, with notes.
pub(super) struct Joined {
    pub(super) rows: Vec<Row>,
    pub(super) clock: TimeSource,
    /// Readings merged into the last one of their burst.
    pub(super) merged: u64,
    pub(super) notes: Vec<String>,
}

impl Track {
    pub(super) fn new(robot: RobotMapping, mapping: &Mapping) -> Self {
        // The range is checked when the mapping is loaded.
        let ns = |seconds: f64| (seconds * 1e9).round() as u64;
        Self {
            robot,
            burst_ns: ns(mapping.burst_s),
            odometry_age_ns: ns(mapping.odometry_max_age_s),
            wanted_time: mapping.time,
            battery: Lane::default(),
            command: Lane::default(),
            odometry: Lane::default(),
            without_stamp: 0,
            not_present: 0,
            charging: 0,
            odd_soc: 0,
        }
    }

    pub(super) fn take(&mut self, topic: &str, kind: RosType, header: &MessageHeader, data: &[u8]) {
        let is_battery = topic == self.robot.battery;
        let is_command = self.robot.command.as_deref() == Some(topic);
        let is_odometry = self.robot.odometry.as_deref() == Some(topic);
        // Channels of several kinds may share a topic: the kind decides, if it fits.
        let (as_battery, as_command, as_odometry) = match kind {
            RosType::BatteryState => (is_battery, false, false),
            RosType::Twist | RosType::TwistStamped => (false, is_command, false),
            RosType::Odometry => (false, false, is_odometry),
        };
        if !(as_battery || as_command || as_odometry) {
            let why = format!("of a channel of {kind:?} messages");
            if is_battery {
                self.battery.messages += 1;
                self.battery.refuse(why);
            } else if is_command {
                self.command.messages += 1;
                self.command.refuse(why);
            } else if is_odometry {
                self.odometry.messages += 1;
                self.odometry.refuse(why);
            }
            return;
        }
        let times = |stamped: Option<&Header>| Times {
            header_ns: stamped.and_then(|header| header.stamp.unix_ns()),
            log_ns: header.log_time,
            publish_ns: header.publish_time,
        };
        let messages = if as_battery {
            &mut self.battery.messages
        } else if as_command {
            &mut self.command.messages
        } else {
            &mut self.odometry.messages
        };
        *messages += 1;
        match kind.decode(data) {
            Ok(Message::BatteryState(state)) => self.reading(times(Some(&state.header)), &state),
            // A Twist has no stamp: its log time is used.
            Ok(Message::Twist(twist)) => {
                let mut times = times(None);
                times.header_ns = Some(times.log_ns);
                self.twist(times, &twist);
            }
            Ok(Message::TwistStamped(stamped)) => {
                self.twist(times(Some(&stamped.header)), &stamped.twist);
            }
            Ok(Message::Odometry(odometry)) => {
                self.motion(times(Some(&odometry.header)), &odometry);
            }
            Err(error) if as_battery => self.battery.refuse(error.to_string()),
            Err(error) if as_command => self.command.refuse(error.to_string()),
            Err(error) => self.odometry.refuse(error.to_string()),
        }
    }

    fn reading(&mut self, times: Times, state: &BatteryState) {
        let sign = match self.robot.current {
            CurrentSign::DischargeNegative => -1.0,
            CurrentSign::DischargePositive => 1.0,
        };
        let voltage_v = f64::from(state.voltage) * self.robot.voltage_unit_v;
        let current_a = sign * f64::from(state.current) * self.robot.current_unit_a;
        if !voltage_v.is_finite() || !current_a.is_finite() {
            return self
                .battery
                .refuse("its voltage or current is not a number");
        }
        self.without_stamp += u64::from(times.header_ns.is_none());
        self.not_present += u64::from(!state.present);
        self.charging += u64::from(current_a < 0.0);
        let soc = f64::from(state.percentage);
        let known = !soc.is_finite() || SOC.contains(&soc);
        self.odd_soc += u64::from(!known);
        self.battery.push(
            times,
            Reading {
                voltage_v,
                current_a,
                soc: if known { soc } else { f64::NAN },
            },
        );
    }

    fn twist(&mut self, times: Times, twist: &Twist) {
        let (v_mps, omega_radps) = (twist.linear.x, twist.angular.z);
        if !v_mps.is_finite() || !omega_radps.is_finite() {
            return self.command.refuse("its velocities are not numbers");
        }
        self.command.push(times, Command { v_mps, omega_radps });
    }

    fn motion(&mut self, times: Times, odometry: &Odometry) {
        let (pose, twist) = (&odometry.pose.pose, &odometry.twist.twist);
        let known = |value: f64| if value.is_finite() { value } else { f64::NAN };
        let motion = Motion {
            x_m: known(pose.position.x),
            y_m: known(pose.position.y),
            theta_rad: known(pose.orientation.yaw_rad()),
            v_mps: known(twist.linear.x),
            omega_radps: known(twist.angular.z),
        };
        if motion.x_m.is_nan() || motion.y_m.is_nan() {
            self.odometry
                .refuse("its position is not a number; the rest is used");
        }
        self.odometry.push(times, motion);
    }

    /// All accepted messages as rows in order of time.
    pub(super) fn join(&mut self) -> Joined {
        let mut notes = self.notes();
        let clock = match self.wanted_time {
            TimeSource::Auto if self.without_stamp == 0 && !self.battery.items.is_empty() => {
                TimeSource::Header
            }
            TimeSource::Auto => TimeSource::Log,
            chosen => chosen,
        };
        if clock == TimeSource::Header
            && self
                .command
                .items
                .iter()
                .any(|(times, _)| times.header_ns == Some(times.log_ns))
        {
            notes.push("commands without a stamp use the time of recording".to_owned());
        }
        let readings = self.battery.timed(clock);
        let commands = self.command.timed(clock);
        let motions = self.odometry.timed(clock);
        let taken = readings.len();
        let readings = last_of_bursts(&readings, self.burst_ns);
        let merged = (taken - readings.len()) as u64;
        // Drivers that do not measure it leave it at zero instead of NaN.
        let measures_soc = readings.iter().any(|(_, reading)| reading.soc != 0.0);
        let (mut command, mut motion) = (Follow::new(&commands), Follow::new(&motions));
        let rows = readings
            .iter()
            .map(|(time_ns, reading)| {
                let command = command.at(*time_ns, u64::MAX);
                let motion = motion.at(*time_ns, self.odometry_age_ns);
                let soc = if measures_soc { reading.soc } else { f64::NAN };
                row(*time_ns, Reading { soc, ..*reading }, command, motion)
            })
            .collect();
        Joined {
            rows,
            clock,
            merged,
            notes,
        }
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        let all = self.battery.items.len() as u64;
        if self.without_stamp > 0 {
            notes.push(format!(
                "{} of {all} readings have no stamp in their header",
                self.without_stamp
            ));
        }
        if self.not_present > 0 {
            notes.push(format!(
                "{} of {all} readings report that there is no battery (`present` is false)",
                self.not_present
            ));
        }
        if self.odd_soc > 0 {
            notes.push(format!(
                "{} of {all} readings have a percentage outside 0 to 1: it is left out",
                self.odd_soc
            ));
        }
        if all > 0 && self.charging * 10 > all * 9 {
            let remedy = match self.robot.current {
                CurrentSign::DischargeNegative => "discharge-positive",
                CurrentSign::DischargePositive => "discharge-negative",
            };
            notes.push(format!(
                "{} of {all} readings have current flowing into the battery: check whether it is {remedy}",
                self.charging
            ));
        }
        notes
    }
}

/// The last reading of each burst.
fn last_of_bursts<T: Copy>(readings: &[(u64, T)], burst_ns: u64) -> Vec<(u64, T)> {
    let mut last = Vec::with_capacity(readings.len());
    for (at, reading) in readings.iter().enumerate() {
        let next_ns = readings.get(at + 1).map(|next| next.0);
        let goes_on = next_ns.is_some_and(|next_ns| {
            // Two readings of the same time cannot both be rows.
            next_ns - reading.0 < burst_ns.max(1)
        });
        if !goes_on {
            last.push(*reading);
        }
    }
    last
}

/// Iterates over known values at increasing times.
struct Follow<'a, T> {
    items: &'a [(u64, T)],
    next: usize,
}

impl<'a, T: Copy> Follow<'a, T> {
    const fn new(items: &'a [(u64, T)]) -> Self {
        Self { items, next: 0 }
    }

    /// The last item up to `time_ns`, unless it is older than `most_age_ns`.
    fn at(&mut self, time_ns: u64, most_age_ns: u64) -> Option<T> {
        while self
            .items
            .get(self.next)
            .is_some_and(|item| item.0 <= time_ns)
        {
            self.next += 1;
        }
        let (since_ns, item) = self.items.get(self.next.checked_sub(1)?)?;
        (time_ns - since_ns <= most_age_ns).then_some(*item)
    }
}

fn row(time_ns: u64, reading: Reading, command: Option<Command>, motion: Option<Motion>) -> Row {
    let unknown = f64::NAN;
    Row {
        time_ns,
        v_mps: command.map_or(unknown, |command| command.v_mps),
        omega_radps: command.map_or(unknown, |command| command.omega_radps),
        x_m: motion.map_or(unknown, |motion| motion.x_m),
        y_m: motion.map_or(unknown, |motion| motion.y_m),
        theta_rad: motion.map_or(unknown, |motion| motion.theta_rad),
        voltage_v: reading.voltage_v,
        current_a: reading.current_a,
        power_w: reading.voltage_v * reading.current_a,
        soc: if reading.soc.is_finite() {
            reading.soc
        } else {
            unknown
        },
        v_measured_mps: motion.map_or(unknown, |motion| motion.v_mps),
        omega_measured_radps: motion.map_or(unknown, |motion| motion.omega_radps),
    }
}
