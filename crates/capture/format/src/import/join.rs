//! Joins one robot's messages by time.

use std::collections::BTreeMap;

use mcap::records::MessageHeader;

use super::mapping::{CurrentSign, Expired, Mapping, RobotMapping, TimeSource};
use joulebus_plausibility::{
    CurrentMonitor, Field, Mapped, Observation, Packed, Packs, PowerOf, SOC, Said, StampState,
    Stamps, SupplyStatus, is_charge, whole,
};
use joulebus_ros_messages::{BatteryState, Header, Message, Odometry, RosType, Twist};

/// Maximum number of messages of a robot's topic, of which each has some 100 bytes in memory: 155
/// hours at 30 Hz. Further ones are refused.
const MAX_ROWS: usize = 1 << 24;

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
    /// Battery current, A, positive while discharging. NaN where the battery measures none.
    pub current_a: f64,
    /// Electrical power, W. NaN on the charger, where the battery's power is no consumption.
    pub power_w: f64,
    /// Measured state of charge, 0 to 1. NaN if the battery does not measure it.
    pub soc: f64,
    /// Measured linear velocity, m/s.
    pub v_measured_mps: f64,
    /// Measured angular velocity, rad/s.
    pub omega_measured_radps: f64,
    /// The message says that the battery is on the charger.
    pub on_charger: bool,
}

/// Times of a message, by clock.
#[derive(Debug, Clone, Copy)]
struct Times {
    header_ns: Option<u64>,
    log_ns: u64,
    publish_ns: u64,
    /// Number of the recorder's clock: it was set back so often before.
    run: u32,
}

/// Step back of the time of recording that is no reordering, ns.
const SET_BACK_NS: u64 = 1_000_000_000;
/// Difference of two clocks beyond which they must not be mixed, s.
const MAX_OFFSET_S: f64 = 0.1;

/// Time for which a pack's reading counts for the sum, ns: a bridge's `reading_holds_s`.
const PACK_HOLDS_NS: u64 = 2_000_000_000;

/// Frames of a battery's messages that are named.
const MAX_FRAMES: usize = 8;

#[derive(Debug, Clone, Copy)]
pub(super) struct Reading {
    voltage_v: f64,
    /// NaN if it is not measured.
    current_a: f64,
    soc: f64,
    /// True if the message says that the battery is on the charger, if it says anything.
    charging: Option<bool>,
    /// The current is the number that drivers write where they measure none.
    is_reserved: bool,
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
        Self { items: Vec::new(), messages: 0, refused: BTreeMap::new() }
    }
}

impl<T: Copy> Lane<T> {
    fn refuse(&mut self, why: impl Into<String>) {
        *self.refused.entry(why.into()).or_default() += 1;
    }

    fn push(&mut self, times: Times, item: T) {
        if self.items.len() < MAX_ROWS {
            self.items.push((times, item));
        } else {
            self.refuse(format!("more than {MAX_ROWS} of them"));
        }
    }

    fn stamps(&self) -> Stamps {
        let seconds = |ns: u64, since_ns: u64| (ns as i128 - i128::from(since_ns)) as f64 * 1e-9;
        let mut stamps = Stamps::default();
        // A whole second, so that stamps in whole seconds stay such.
        let since_ns = self.items.first().map_or(0, |(times, _)| times.log_ns);
        let since_ns = since_ns - since_ns % 1_000_000_000;
        for (times, _) in &self.items {
            let stamp_s = times.header_ns.map(|ns| seconds(ns, since_ns));
            stamps.take(stamp_s, seconds(times.log_ns, since_ns));
        }
        stamps
    }

    /// Those of one run, sorted by the selected clock. Messages without that time are refused, or
    /// `by_log` use the time of recording.
    fn timed(&mut self, clock: TimeSource, run: u32, by_log: bool) -> Vec<(u64, T)> {
        let own = self.items.iter().filter(|(times, _)| times.run == run);
        let own: Vec<(Times, T)> = own.copied().collect();
        let mut timed = Vec::with_capacity(own.len());
        for (times, item) in own {
            let time_ns = match clock {
                TimeSource::Header if by_log => times.header_ns.or(Some(times.log_ns)),
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
    command_ns: u64,
    expired: Expired,
    wanted_time: TimeSource,
    pub(super) battery: Lane<Reading>,
    pub(super) command: Lane<Command>,
    pub(super) odometry: Lane<Motion>,
    /// Latest time of recording in this run and file.
    latest_log_ns: u64,
    run: u32,
    without_stamp: u64,
    not_present: u64,
    charging: u64,
    /// The frames that its messages name: each publisher has its own.
    frames: Vec<String>,
    packs: Packs,
    /// Messages of a pack while another one is missing.
    without_pack: u64,
    /// Whether −1 A is a reading of this battery's monitor.
    monitor: CurrentMonitor,
    /// Readings whose state of charge is no share, and those of them that could be percentages.
    odd_soc: u64,
    percent_soc: u64,
    /// Readings of which the battery does not know it.
    unknown_soc: u64,
}

/// A robot's rows, with notes.
pub(super) struct Joined {
    pub(super) rows: Vec<Row>,
    /// The first row of each run but the first: there the recorder's clock was set back.
    pub(super) runs_from: Vec<usize>,
    pub(super) clock: TimeSource,
    /// Readings merged into the last one of their burst.
    pub(super) merged: u64,
    pub(super) notes: Vec<String>,
}

impl Track {
    pub(super) fn new(robot: RobotMapping, mapping: &Mapping) -> Self {
        // The range is checked when the mapping is loaded.
        let ns = |seconds: f64| (seconds * 1e9).round() as u64;
        let packs = robot.packs.iter().map(|pack| pack.wh);
        Self {
            packs: Packs::new(
                std::iter::once(robot.battery_wh.unwrap_or(1.0)).chain(packs).collect(),
            ),
            without_pack: 0,
            robot,
            burst_ns: ns(mapping.burst_s),
            odometry_age_ns: ns(mapping.odometry_max_age_s),
            command_ns: ns(mapping.command_holds_s),
            expired: mapping.command_expired,
            wanted_time: mapping.time,
            battery: Lane::default(),
            command: Lane::default(),
            odometry: Lane::default(),
            latest_log_ns: 0,
            run: 0,
            without_stamp: 0,
            not_present: 0,
            charging: 0,
            frames: Vec::new(),
            monitor: CurrentMonitor::default(),
            odd_soc: 0,
            percent_soc: 0,
            unknown_soc: 0,
        }
    }

    /// Another file of the recording begins, in any order.
    pub(super) fn begin_file(&mut self) {
        self.latest_log_ns = 0;
    }

    /// The run of a message: another one begins where the recorder's clock was set back.
    fn run_of(&mut self, log_ns: u64) -> u32 {
        if log_ns.saturating_add(SET_BACK_NS) < self.latest_log_ns {
            self.run += 1;
            self.latest_log_ns = 0;
        }
        self.latest_log_ns = self.latest_log_ns.max(log_ns);
        self.run
    }

    pub(super) fn take(&mut self, topic: &str, kind: RosType, header: &MessageHeader, data: &[u8]) {
        let pack = self.robot.batteries().position(|battery| battery == topic);
        let RobotMapping { command, odometry, .. } = &self.robot;
        let is = |name: &Option<String>| name.as_deref() == Some(topic);
        let named = [pack.is_some(), is(command), is(odometry)];
        // Channels of several kinds may share a topic: the kind decides, if it fits.
        let of_kind = match kind {
            RosType::BatteryState | RosType::BatteryStateArray => 0,
            RosType::Twist | RosType::TwistStamped => 1,
            RosType::Odometry => 2,
            // It would be of a bridge.
            RosType::Bool => return,
        };
        let first = named.iter().position(|is_named| *is_named);
        let Some(lane) = Some(of_kind).filter(|of| named[*of]).or(first) else {
            return;
        };
        *self.lane(lane).0 += 1;
        if lane != of_kind {
            return self.refuse(lane, format!("of a channel of {kind:?} messages"));
        }
        let run = self.run_of(header.log_time);
        let times = |stamped: Option<&Header>| Times {
            header_ns: stamped.and_then(|header| header.stamp.unix_ns()),
            log_ns: header.log_time,
            publish_ns: header.publish_time,
            run,
        };
        match kind.decode(data) {
            Ok(Message::BatteryState(state)) => {
                self.reading(times(Some(&state.header)), &[*state], pack.unwrap_or_default());
            }
            Ok(Message::BatteryStateArray(array)) => {
                let states: Vec<BatteryState> = array.packs().collect();
                let header = states.first().map(|state| &state.header);
                self.reading(times(header), &states, pack.unwrap_or_default());
            }
            Ok(Message::Twist(twist)) => self.twist(times(None), &twist),
            Ok(Message::TwistStamped(stamped)) => {
                self.twist(times(Some(&stamped.header)), &stamped.twist);
            }
            Ok(Message::Odometry(odometry)) => {
                self.motion(times(Some(&odometry.header)), &odometry);
            }
            // It would be of a bridge.
            Ok(Message::Bool(_)) => {}
            Err(error) => self.refuse(lane, error.to_string()),
        }
    }

    /// Messages and refusals of battery, command and odometry.
    fn lane(&mut self, lane: usize) -> (&mut u64, &mut BTreeMap<String, u64>) {
        match lane {
            0 => (&mut self.battery.messages, &mut self.battery.refused),
            1 => (&mut self.command.messages, &mut self.command.refused),
            _ => (&mut self.odometry.messages, &mut self.odometry.refused),
        }
    }

    fn refuse(&mut self, lane: usize, why: String) {
        *self.lane(lane).1.entry(why).or_default() += 1;
    }

    fn map(&self, state: &BatteryState) -> Mapped {
        let sign = match self.robot.current {
            CurrentSign::DischargeNegative => -1.0,
            CurrentSign::DischargePositive => 1.0,
        };
        let said = Said {
            written_a: state.current.into(),
            product_of: Some(PowerOf::Battery),
            present: Some(state.present),
            charging: SupplyStatus::new(state.power_supply_status).and_then(SupplyStatus::charging),
            ..Said::default()
        };
        let said = said
            .with(Field::Voltage, f64::from(state.voltage) * self.robot.voltage_unit_v)
            .with(Field::Current, sign * f64::from(state.current) * self.robot.current_unit_a)
            .with(Field::Soc, state.percentage.into());
        said.map(|_, _| {})
    }

    /// Takes a battery's packs in one message: mostly one.
    fn reading(&mut self, times: Times, states: &[BatteryState], pack: usize) {
        let packs: Vec<Mapped> = states.iter().map(|state| self.map(state)).collect();
        let Some(state) = states.first() else {
            return self.battery.refuse("it has no battery");
        };
        let mut mapped = whole(&vec![1.0; packs.len()], &packs);
        let voltage_v = mapped.seen.voltage_v;
        if states.iter().any(|state| !state.present) && voltage_v.is_nan() {
            return self.battery.refuse("it reports that there is no battery (`present` is false)");
        }
        if voltage_v.is_nan() || mapped.seen.current_a.is_nan() {
            return self.battery.refuse("its voltage or current is not a number");
        }
        if !self.robot.packs.is_empty() {
            mapped = match self.packs.take(pack, mapped, times.log_ns, PACK_HOLDS_NS) {
                Packed::Whole(whole) => whole,
                Packed::Waits => return,
                Packed::Missing(_) => return self.without_pack += 1,
            };
        }
        let Mapped { seen, is_reserved, .. } = mapped;
        let Observation { voltage_v, current_a, soc, charging, .. } = seen;
        // The number as the driver wrote it: its unit does not matter here.
        let as_written = f64::from(state.current);
        self.monitor.take(&Observation { current_a: as_written, ..Observation::at(0.0) });
        self.without_stamp += u64::from(times.header_ns.is_none());
        self.not_present += u64::from(!state.present);
        self.charging += u64::from(current_a < 0.0 && charging != Some(true));
        if !self.frames.contains(&state.header.frame_id) && self.frames.len() < MAX_FRAMES {
            self.frames.push(state.header.frame_id.clone());
        }
        self.unknown_soc += u64::from(soc.is_nan());
        let known = soc.is_nan() || SOC.contains(&soc);
        self.odd_soc += u64::from(!known);
        self.percent_soc += u64::from(!known && SOC.contains(&(soc / 100.0)));
        self.battery.push(times, Reading { voltage_v, current_a, soc, charging, is_reserved });
    }

    fn twist(&mut self, times: Times, twist: &Twist) {
        let said = Said::default()
            .with(Field::V, twist.linear.x)
            .with(Field::Vy, twist.linear.y)
            .with(Field::Omega, twist.angular.z);
        let Observation { v_mps, omega_radps, .. } = said.map(|_, _| {}).seen;
        if v_mps.is_nan() || omega_radps.is_nan() || twist.linear.y.is_nan() {
            return self.command.refuse("its velocities are not numbers");
        }
        self.command.push(times, Command { v_mps, omega_radps });
    }

    fn motion(&mut self, times: Times, odometry: &Odometry) {
        let (pose, twist) = (&odometry.pose.pose, &odometry.twist.twist);
        let known = |value: f64| if value.is_finite() { value } else { f64::NAN };
        let said = Said::default()
            .with(Field::VMeasured, twist.linear.x)
            .with(Field::VyMeasured, twist.linear.y)
            .with(Field::OmegaMeasured, twist.angular.z);
        let seen = said.map(|_, _| {}).seen;
        let motion = Motion {
            x_m: known(pose.position.x),
            y_m: known(pose.position.y),
            theta_rad: known(pose.orientation.yaw_rad()),
            v_mps: seen.v_measured_mps,
            omega_radps: seen.omega_measured_radps,
        };
        if motion.x_m.is_nan() || motion.y_m.is_nan() {
            self.odometry.refuse("its position is not a number. The rest is used");
        }
        self.odometry.push(times, motion);
    }

    /// All accepted messages as rows, in order of time in each run.
    pub(super) fn join(&mut self) -> Joined {
        let mut notes = self.notes();
        let clock = self.clock(&mut notes);
        let (mut rows, mut runs_from) = (Vec::new(), Vec::new());
        let (mut merged, mut expired) = (0, 0);
        // Drivers that do not measure it leave it at zero instead of NaN.
        let has_percentages = self.has_percentages();
        let measures_one_ampere = self.monitor.measures_one_ampere();
        let is_unmeasured = |reading: &Reading| reading.is_reserved && !measures_one_ampere;
        for (_, reading) in &mut self.battery.items {
            reading.soc = share(reading.soc, has_percentages);
            if is_unmeasured(reading) {
                reading.current_a = f64::NAN;
            }
        }
        let mut readings = self.battery.items.iter();
        let measures_soc =
            readings.any(|(_, reading)| reading.soc.is_finite() && reading.soc != 0.0);
        for run in 0..=self.run {
            if !rows.is_empty() && rows.len() > runs_from.last().copied().unwrap_or(0) {
                runs_from.push(rows.len());
            }
            let readings = self.battery.timed(clock, run, false);
            let commands = self.command.timed(clock, run, true);
            let motions = self.odometry.timed(clock, run, true);
            let taken = readings.len();
            let readings = last_of_bursts(&readings, self.burst_ns);
            merged += (taken - readings.len()) as u64;
            let (mut command, mut motion) = (Follow::new(&commands), Follow::new(&motions));
            rows.extend(readings.iter().map(|(time_ns, reading)| {
                let given = command.at(*time_ns, self.command_ns);
                let is_expired = given.is_none() && command.has_begun();
                expired += u64::from(is_expired);
                let stopped = Command { v_mps: 0.0, omega_radps: 0.0 };
                let stops = is_expired && self.expired == Expired::Stops;
                let command = given.or(stops.then_some(stopped));
                let motion = motion.at(*time_ns, self.odometry_age_ns);
                let soc = if measures_soc { reading.soc } else { f64::NAN };
                row(*time_ns, Reading { soc, ..*reading }, command, motion)
            }));
        }
        runs_from.retain(|from| *from < rows.len());
        if expired > 0 {
            let holds_s = self.command_ns as f64 * 1e-9;
            let what = match self.expired {
                Expired::Unknown => "unknown",
                Expired::Stops => "0",
            };
            notes.push(format!(
                "{expired} of {} rows are more than {holds_s} s after the last command: it is {what} (command_holds_s)",
                rows.len()
            ));
        }
        if !runs_from.is_empty() {
            notes.push(format!(
                "the recorder's clock was set back {} times: each begins another trial",
                runs_from.len()
            ));
        }
        Joined { rows, runs_from, clock, merged, notes }
    }

    /// The clock of all topics: two that differ are not mixed.
    fn clock(&self, notes: &mut Vec<String>) -> TimeSource {
        let all = [
            ("commands", self.command.stamps(), self.command.items.len()),
            ("odometry", self.odometry.stamps(), self.odometry.items.len()),
        ];
        let others = all.iter().filter(|(_, _, count)| *count > 0);
        let unstamped: Vec<&str> = others
            .clone()
            .filter(|(_, stamps, _)| stamps.state() == StampState::Missing)
            .map(|(name, ..)| *name)
            .collect();
        let readings = self.battery.stamps();
        if self.battery.items.is_empty() {
            return match self.wanted_time {
                TimeSource::Auto => TimeSource::Log,
                chosen => chosen,
            };
        }
        let by_log = || {
            let names = unstamped.join(" and ");
            format!("{names} without a stamp use the time of recording")
        };
        if self.wanted_time != TimeSource::Auto {
            if self.wanted_time == TimeSource::Header && !unstamped.is_empty() {
                notes.push(by_log());
            }
            return self.wanted_time;
        }
        let why = match readings.state() {
            // Another note states it.
            StampState::Missing => return TimeSource::Log,
            StampState::Still => "the stamps of readings stand still".to_owned(),
            StampState::WholeSeconds => "the stamps of readings have whole seconds".to_owned(),
            StampState::Backward(back_s) => {
                format!("the stamps of readings go back by {back_s:.1} s")
            }
            StampState::Good { offset_s, drift_s } => {
                let fits = |(_, stamps, _): &&(&str, Stamps, usize)| match stamps.state() {
                    StampState::Missing => readings.fits_log(),
                    StampState::Good { offset_s: other_s, drift_s: other_drift_s } => {
                        let away_s = (offset_s - other_s).abs();
                        let end_s = (offset_s + drift_s - other_s - other_drift_s).abs();
                        away_s.max(end_s) <= MAX_OFFSET_S
                    }
                    _ => false,
                };
                match others.clone().find(|other| !fits(other)) {
                    None => {
                        if !unstamped.is_empty() {
                            notes.push(by_log());
                        }
                        return TimeSource::Header;
                    }
                    Some((name, stamps, _)) => apart((offset_s, drift_s), name, stamps.state()),
                }
            }
        };
        notes.push(format!("{why}: the time of recording is used for all"));
        TimeSource::Log
    }

    /// True if the percentage is one, 0 to 100, though the message defines it as a share: one unit
    /// for all readings.
    fn has_percentages(&self) -> bool {
        let all = self.battery.items.iter();
        let known = all.filter(|(_, reading)| reading.soc.is_finite()).count() as u64;
        self.percent_soc > 0 && 2 * self.percent_soc > known
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        let all = self.battery.items.len() as u64;
        let mut note = |count: u64, what: &str| {
            if count > 0 {
                notes.push(format!("{count} of {all} readings {what}"));
            }
        };
        note(self.without_stamp, "have no stamp in their header");
        note(
            self.not_present,
            "report that there is no battery (`present` is false), and have its voltage",
        );
        note(self.unknown_soc, "have a percentage of NaN or −1: their charge is unknown");
        match self.has_percentages() {
            true => note(
                self.percent_soc,
                "have a percentage above 1: it is read as 0 to 100 in all of them",
            ),
            false => note(self.odd_soc, "have a percentage outside 0 to 1: it is left out"),
        }
        let count = |is: &dyn Fn(&Reading) -> bool| {
            self.battery.items.iter().filter(|(_, reading)| is(reading)).count() as u64
        };
        note(
            count(&|reading| reading.charging == Some(true)),
            "are on the charger (`power_supply_status`): their power is no consumption, and unknown",
        );
        if !self.monitor.measures_one_ampere() {
            note(
                count(&|reading| reading.is_reserved),
                "have a current of exactly −1, which drivers write where they measure none: their \
                 current and power are unknown",
            );
        }
        let remedy = match self.robot.current {
            CurrentSign::DischargeNegative => "discharge-positive",
            CurrentSign::DischargePositive => "discharge-negative",
        };
        if self.charging * 10 > all * 9 {
            note(
                self.charging,
                &format!("have current flowing into the battery: check whether it is {remedy}"),
            );
        }
        if !self.robot.packs.is_empty() {
            notes.push(format!(
                "{} packs are summed. Each reading has a new one of every pack ({} messages came \
                 while another pack was missing)",
                1 + self.robot.packs.len(),
                self.without_pack
            ));
        }
        if self.frames.len() > 1 && self.robot.packs.is_empty() {
            let frames: Vec<String> =
                self.frames.iter().map(|frame| format!("{frame:?}")).collect();
            notes.push(format!(
                "its messages name several frames ({}): several publishers share the topic, and \
                 their readings are mixed",
                frames.join(", ")
            ));
        }
        notes
    }
}

/// The share that a percentage is, if it is one.
fn share(percentage: f64, is_percent: bool) -> f64 {
    let share = if is_percent { percentage / 100.0 } else { percentage };
    if SOC.contains(&share) { share } else { f64::NAN }
}

/// Difference between the clock of readings and that of another topic, in words.
fn apart((offset_s, drift_s): (f64, f64), name: &str, other: StampState) -> String {
    let (size_s, side) = match offset_s < 0.0 {
        true => (-offset_s, "ahead of"),
        false => (offset_s, "behind"),
    };
    let drift = match drift_s.abs() > 0.05 {
        true => format!(" and drift by {drift_s:.2} s"),
        false => String::new(),
    };
    let other = match other {
        StampState::Missing => format!("{name} have none"),
        StampState::Good { offset_s, .. } => {
            format!("those of {name} differ from it by {offset_s:.2} s")
        }
        _ => format!("those of {name} do not advance"),
    };
    format!(
        "the stamps of readings are {size_s:.2} s {side} the time of recording{drift}, and {other}"
    )
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

    /// True if there was any item up to now.
    const fn has_begun(&self) -> bool {
        self.next > 0
    }

    /// The last item up to `time_ns`, unless it is older than `most_age_ns`.
    fn at(&mut self, time_ns: u64, most_age_ns: u64) -> Option<T> {
        while self.items.get(self.next).is_some_and(|item| item.0 <= time_ns) {
            self.next += 1;
        }
        let (since_ns, item) = self.items.get(self.next.checked_sub(1)?)?;
        (time_ns - since_ns <= most_age_ns).then_some(*item)
    }
}

fn row(time_ns: u64, reading: Reading, command: Option<Command>, motion: Option<Motion>) -> Row {
    let unknown = f64::NAN;
    let power_w = reading.voltage_v * reading.current_a;
    Row {
        time_ns,
        v_mps: command.map_or(unknown, |command| command.v_mps),
        omega_radps: command.map_or(unknown, |command| command.omega_radps),
        x_m: motion.map_or(unknown, |motion| motion.x_m),
        y_m: motion.map_or(unknown, |motion| motion.y_m),
        theta_rad: motion.map_or(unknown, |motion| motion.theta_rad),
        voltage_v: reading.voltage_v,
        current_a: reading.current_a,
        power_w: if is_charge(power_w, power_w, true, reading.charging) {
            unknown
        } else {
            power_w
        },
        soc: if reading.soc.is_finite() { reading.soc } else { unknown },
        v_measured_mps: motion.map_or(unknown, |motion| motion.v_mps),
        omega_measured_radps: motion.map_or(unknown, |motion| motion.omega_radps),
        on_charger: reading.charging == Some(true),
    }
}
