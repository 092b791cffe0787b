//! Mapping of topics to robots, and their interpretation.

use std::collections::BTreeSet;
use std::str::FromStr;

use joulebus_plausibility::COMMAND_HOLDS_S;
pub use joulebus_plausibility::Expired;
use serde::Deserialize;

use super::channel::Channel;
use super::error::ImportError;
use joulebus_ros_messages::RosType;

/// The source of a message's time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeSource {
    /// The header's if every battery message of the robot has one that advances and that can be
    /// joined with the other topics, else the log time.
    #[default]
    Auto,
    /// The measurement time in its header. Readings without a stamp are refused, other messages use
    /// the log time.
    Header,
    /// The log time.
    Log,
    /// The publish time.
    Publish,
}

/// Sign of the current.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CurrentSign {
    /// Negative while discharging, as defined for the message.
    #[default]
    DischargeNegative,
    /// Positive while discharging, as in many drivers.
    DischargePositive,
}

/// A robot of a recording.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotMapping {
    /// Its name in a dataset.
    pub name: String,
    /// Its id in a capture.
    #[serde(default)]
    pub id: Option<u32>,
    /// Topic of its `BatteryState`.
    pub battery: String,
    /// Where it has several packs: the energy of this one from full to empty, Wh.
    #[serde(default)]
    pub battery_wh: Option<f64>,
    /// Its other packs. All of them are summed.
    #[serde(default)]
    pub packs: Vec<PackMapping>,
    /// True if its command and odometry are looked for, as those of robots that no mapping names.
    #[serde(skip)]
    pub is_searched: bool,
    /// Topic of its `Twist` or `TwistStamped`.
    #[serde(default)]
    pub command: Option<String>,
    /// Topic of its `Odometry`.
    #[serde(default)]
    pub odometry: Option<String>,
    /// Sign of its current.
    #[serde(default)]
    pub current: CurrentSign,
    /// Unit of its voltage, V: 0.001 for millivolts.
    #[serde(default = "one")]
    pub voltage_unit_v: f64,
    /// Unit of its current, A: 0.001 for milliamperes.
    #[serde(default = "one")]
    pub current_unit_a: f64,
}

/// A further pack of a robot.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PackMapping {
    /// Topic of its `BatteryState`.
    pub topic: String,
    /// Its energy from full to empty, Wh.
    pub wh: f64,
}

impl RobotMapping {
    /// Topics of its packs.
    pub(super) fn batteries(&self) -> impl Iterator<Item = &str> {
        let packs = self.packs.iter().map(|pack| pack.topic.as_str());
        std::iter::once(self.battery.as_str()).chain(packs)
    }
}

const fn one() -> f64 {
    1.0
}

/// Configuration of an import. As TOML: `time`, `burst_s`, `odometry_max_age_s`,
/// `command_holds_s`, `command_expired`, `current`, and a table `[[robot]]` for each robot. Without
/// robots every battery topic is one.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// The source of times.
    #[serde(default)]
    pub time: TimeSource,
    /// Readings within this time are one burst, of which the last is used, s. 0 keeps all.
    #[serde(default = "usual_burst_s")]
    pub burst_s: f64,
    /// Maximum age of odometry, s.
    #[serde(default = "usual_age_s")]
    pub odometry_max_age_s: f64,
    /// Time for which a command applies if no other one comes, s: that of a bridge.
    #[serde(default = "usual_hold_s")]
    pub command_holds_s: f64,
    /// The substitute for an expired command.
    #[serde(default)]
    pub command_expired: Expired,
    /// Sign of the current of robots that do not set it.
    #[serde(default)]
    pub current: CurrentSign,
    /// The robots.
    #[serde(default, rename = "robot")]
    pub robots: Vec<RobotMapping>,
}

const fn usual_burst_s() -> f64 {
    0.005
}

const fn usual_age_s() -> f64 {
    1.0
}

const fn usual_hold_s() -> f64 {
    COMMAND_HOLDS_S
}

impl Default for Mapping {
    fn default() -> Self {
        Self {
            time: TimeSource::default(),
            burst_s: usual_burst_s(),
            odometry_max_age_s: usual_age_s(),
            command_holds_s: usual_hold_s(),
            command_expired: Expired::default(),
            current: CurrentSign::default(),
            robots: Vec::new(),
        }
    }
}

/// Error of a mapping file: the text is not a valid mapping in TOML, or a number is out of range.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct MappingError(String);

impl FromStr for Mapping {
    type Err = MappingError;

    fn from_str(text: &str) -> Result<Self, MappingError> {
        let mapping: Self = toml::from_str(text)
            .map_err(|error| MappingError(error.to_string().trim_end().to_owned()))?;
        mapping.check()?;
        Ok(mapping)
    }
}

impl Mapping {
    /// Sets the sign of the current of every robot.
    pub fn set_current(&mut self, sign: CurrentSign) {
        self.current = sign;
        for robot in &mut self.robots {
            robot.current = sign;
        }
    }

    /// Checks every number.
    ///
    /// # Errors
    /// A number out of range.
    pub fn check(&self) -> Result<(), MappingError> {
        let check =
            |key: String, found: f64, (least, greatest): (f64, f64), allowed: &str| match (least
                ..=greatest)
                .contains(&found)
            {
                true => Ok(()),
                false => Err(MappingError(format!("{key}: found {found}, allowed are {allowed}"))),
            };
        for (key, found) in [
            ("burst_s", self.burst_s),
            ("odometry_max_age_s", self.odometry_max_age_s),
            ("command_holds_s", self.command_holds_s),
        ] {
            check(key.to_owned(), found, (0.0, 3600.0), "0 to 3600 s")?;
        }
        for robot in &self.robots {
            let units = [
                ("voltage_unit_v", robot.voltage_unit_v),
                ("current_unit_a", robot.current_unit_a),
            ];
            // A robot with packs has the energy of each.
            let first = (!robot.packs.is_empty() || robot.battery_wh.is_some())
                .then(|| ("battery_wh", robot.battery_wh.unwrap_or(f64::NAN)));
            let packs = robot.packs.iter().map(|pack| ("packs.wh", pack.wh));
            for (key, found) in units.into_iter().chain(first).chain(packs) {
                let key = format!("robot {:?}: {key}", robot.name);
                check(key, found, (1e-9, 1e9), "1e-9 to 1e9")?;
            }
        }
        Ok(())
    }
}

/// The robots of a recording: those of the mapping, or one per battery topic.
pub(super) fn choose(
    name: &str,
    mapping: &Mapping,
    channels: &[Channel],
) -> Result<Vec<RobotMapping>, ImportError> {
    let search = Search::new(channels);
    if !mapping.robots.is_empty() {
        let mut robots = mapping.robots.clone();
        for robot in &mut robots {
            check_topics(robot, channels)?;
            if robot.is_searched && robot.command.is_none() {
                robot.command = search.command(&robot.battery)?;
            }
            if robot.is_searched && robot.odometry.is_none() {
                robot.odometry = search.odometry(&robot.battery)?;
            }
        }
        return Ok(robots);
    }
    let mut robots = Vec::new();
    for battery in &search.batteries {
        robots.push(RobotMapping {
            name: robot_name(battery, channels).unwrap_or(name).to_owned(),
            id: None,
            battery: (*battery).to_owned(),
            battery_wh: None,
            packs: Vec::new(),
            is_searched: true,
            command: search.command(battery)?,
            odometry: search.odometry(battery)?,
            current: mapping.current,
            voltage_unit_v: 1.0,
            current_unit_a: 1.0,
        });
    }
    let names: BTreeSet<String> =
        robots.iter().map(|robot: &RobotMapping| robot.name.clone()).collect();
    for name in names {
        let same = robots.iter_mut().filter(|robot| robot.name == name);
        let mut same: Vec<&mut RobotMapping> = same.collect();
        if same.len() > 1 {
            rename(&mut same);
        }
    }
    Ok(robots)
}

/// Types of the messages of a battery.
const BATTERIES: [RosType; 2] = [RosType::BatteryState, RosType::BatteryStateArray];
/// Namespaces of the parts of a robot.
const PARTS: [&str; 6] = ["batter", "bms", "power", "base", "platform", "driver"];

/// Names a robot by the namespace that all its topics have: of `/fleet/r1` it is `r1`. A number
/// distinguishes robots, and no part of a robot is one.
fn robot_name<'a>(battery: &'a str, channels: &[Channel]) -> Option<&'a str> {
    let all = folders(battery);
    let is_ours = |topic: &&str| {
        folders(topic).first() == all.first() && !is_of_another_number(battery, topic)
    };
    let topics = channels.iter().map(|channel| channel.topic.as_str()).filter(is_ours);
    let length = topics.map(|topic| shared(battery, topic)).min().unwrap_or(all.len());
    let is_robot = |name: &&&str| !PARTS.iter().any(|part| name.to_lowercase().contains(part));
    let mut names = all[..length].iter().rev().filter(is_robot);
    let numbered = names.clone().find(|name| name.contains(|letter: char| letter.is_ascii_digit()));
    numbered.or(names.next()).or(all.first()).copied()
}

/// Names robots of one namespace by what their own adds to it: that of battery and command.
fn rename(robots: &mut [&mut RobotMapping]) {
    let own = |robot: &RobotMapping| -> Vec<String> {
        let battery = folders(&robot.battery);
        let command = robot.command.as_deref().or(robot.odometry.as_deref());
        let length = command.map_or(battery.len(), |command| shared(&robot.battery, command));
        battery[..length].iter().map(|part| (*part).to_owned()).collect()
    };
    let all: Vec<Vec<String>> = robots.iter().map(|robot| own(robot)).collect();
    let is_same = |at: &usize| {
        all.iter().all(|one| one.get(*at).is_some() && one.get(*at) == all[0].get(*at))
    };
    let common = (0..).take_while(is_same).count();
    for (robot, own) in robots.iter_mut().zip(&all) {
        if own.len() > common {
            robot.name = own[common..].join("_");
        }
    }
}

/// The parts of a topic without the last one.
fn folders(topic: &str) -> Vec<&str> {
    let mut parts: Vec<&str> = topic.trim_start_matches('/').split('/').collect();
    parts.pop();
    parts
}

/// The number of namespaces that two topics share.
fn shared(one: &str, other: &str) -> usize {
    let (one, other) = (folders(one), folders(other));
    one.iter().zip(&other).take_while(|(a, b)| a == b).count()
}

/// True if the namespaces of two topics differ first in a number: `/r1` and `/r2`.
fn is_of_another_number(one: &str, other: &str) -> bool {
    let (one, other) = (folders(one), folders(other));
    let mut pairs = one.iter().zip(&other);
    let letters = |part: &str| part.replace(|letter: char| letter.is_ascii_digit(), "");
    pairs
        .find(|(one, other)| one != other)
        .is_some_and(|(one, other)| letters(one) == letters(other))
}

/// The topics of a recording by their kinds.
struct Search<'a> {
    batteries: Vec<&'a str>,
    commands: Vec<&'a str>,
    odometries: Vec<&'a str>,
}

impl<'a> Search<'a> {
    fn new(channels: &'a [Channel]) -> Self {
        let of_kind = |kinds: &[RosType]| -> Vec<&str> {
            let used = channels.iter().filter(|channel| {
                channel.messages > 0 && channel.kind.as_ref().is_ok_and(|kind| kinds.contains(kind))
            });
            let mut topics = Vec::new();
            for channel in used {
                if !topics.contains(&channel.topic.as_str()) {
                    topics.push(channel.topic.as_str());
                }
            }
            topics
        };
        Self {
            batteries: of_kind(&BATTERIES),
            commands: of_kind(&[RosType::Twist, RosType::TwistStamped]),
            odometries: of_kind(&[RosType::Odometry]),
        }
    }

    fn command(&self, battery: &str) -> Result<Option<String>, ImportError> {
        self.nearest(&self.commands, "cmd_vel", battery)
    }

    fn odometry(&self, battery: &str) -> Result<Option<String>, ImportError> {
        self.nearest(&self.odometries, "odom", battery)
    }

    /// The topics with the longest namespace in common with a battery, none of which is nearer to
    /// another one. Of one battery all are, but those of a robot with another number.
    fn nearest(
        &self,
        topics: &[&str],
        usual: &str,
        battery: &str,
    ) -> Result<Option<String>, ImportError> {
        let is_alone = self.batteries.len() == 1;
        let is_ours = |topic: &&str| {
            if is_alone {
                return !is_of_another_number(battery, topic);
            }
            let depth = shared(battery, topic);
            let mut others = self.batteries.iter();
            let at_root = folders(battery).is_empty() && folders(topic).is_empty();
            (depth > 0 || at_root) && others.all(|other| shared(other, topic) <= depth)
        };
        let ours: Vec<&str> = topics.iter().copied().filter(is_ours).collect();
        let deepest = ours.iter().map(|topic| shared(battery, topic)).max();
        let nearest = ours.into_iter().filter(|topic| Some(shared(battery, topic)) == deepest);
        only(&nearest.collect::<Vec<_>>(), usual, battery)
    }
}

/// The only candidate topic, or the one with the usual name among several.
fn only(found: &[&str], usual: &str, battery: &str) -> Result<Option<String>, ImportError> {
    match found {
        [] => Ok(None),
        [one] => Ok(Some((*one).to_owned())),
        several => {
            let named = |topic: &&&str| topic.rsplit('/').next() == Some(usual);
            let mut named = several.iter().filter(named);
            match (named.next(), named.next()) {
                (Some(one), None) => Ok(Some((*one).to_owned())),
                _ => {
                    let several = several.join(", ");
                    Err(ImportError::Robots(format!(
                        "{battery} could go with any of {several}. Name them with options or a \
                         mapping file"
                    )))
                }
            }
        }
    }
}

/// Checks that the topics of a robot exist and have the right type.
fn check_topics(robot: &RobotMapping, channels: &[Channel]) -> Result<(), ImportError> {
    let check = |topic: &str, allowed: &[RosType]| {
        let why = match channels.iter().find(|channel| channel.topic == topic) {
            None => {
                let topics: Vec<&str> =
                    channels.iter().map(|channel| channel.topic.as_str()).collect();
                format!("the file does not have it. It has {}", topics.join(", "))
            }
            Some(Channel { kind: Ok(kind), .. }) if allowed.contains(kind) => return Ok(()),
            Some(Channel { kind: Ok(kind), .. }) => {
                format!("found {kind:?}, allowed are {allowed:?}")
            }
            Some(Channel { kind: Err(error), .. }) => error.to_string(),
        };
        Err(ImportError::Robots(format!("topic {topic:?}: {why}")))
    };
    for battery in robot.batteries() {
        check(battery, &BATTERIES)?;
    }
    if let Some(command) = &robot.command {
        check(command, &[RosType::Twist, RosType::TwistStamped])?;
    }
    if let Some(odometry) = &robot.odometry {
        check(odometry, &[RosType::Odometry])?;
    }
    Ok(())
}
