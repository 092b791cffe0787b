//! Mapping of topics to robots, and their interpretation.

use std::str::FromStr;

use joulebus_plausibility::COMMAND_HOLDS_S;
pub use joulebus_plausibility::Expired;
use serde::Deserialize;

use super::channel::Channel;
use super::error::ImportError;
use joulebus_ros_messages::RosType;

/// Which time of a message is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeSource {
    /// The header's if every battery message of the robot has one that advances and that can be
    /// joined with the other topics, else the log time.
    #[default]
    Auto,
    /// The measurement time in its header; readings without a stamp are refused, other messages use
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

const fn one() -> f64 {
    1.0
}

/// Configuration of an import. As TOML: `time`, `burst_s`, `odometry_max_age_s`,
/// `command_holds_s`, `command_expired`, `current`, and a table `[[robot]]` for each robot; without
/// robots every battery topic is one.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// Which time is used.
    #[serde(default)]
    pub time: TimeSource,
    /// Readings within this time are one burst, of which the last is used, s; 0 keeps all.
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

/// Errors of a mapping file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MappingError {
    /// It is not a valid mapping in TOML.
    #[error("{0}")]
    Toml(String),
    /// A number out of range.
    #[error("{key}: found {found}, allowed are {allowed}")]
    Range {
        /// The key.
        key: String,
        /// The number found.
        found: f64,
        /// The allowed numbers.
        allowed: &'static str,
    },
}

impl FromStr for Mapping {
    type Err = MappingError;

    fn from_str(text: &str) -> Result<Self, MappingError> {
        let mapping: Self = toml::from_str(text)
            .map_err(|error| MappingError::Toml(error.to_string().trim_end().to_owned()))?;
        mapping.check()?;
        Ok(mapping)
    }
}

impl Mapping {
    /// Checks every number.
    ///
    /// # Errors
    /// [`MappingError::Range`].
    pub fn check(&self) -> Result<(), MappingError> {
        let refuse = |key: String, found: f64, allowed: &'static str| {
            Err(MappingError::Range {
                key,
                found,
                allowed,
            })
        };
        for (key, found) in [
            ("burst_s", self.burst_s),
            ("odometry_max_age_s", self.odometry_max_age_s),
            ("command_holds_s", self.command_holds_s),
        ] {
            if !(0.0..=3600.0).contains(&found) {
                return refuse(key.to_owned(), found, "0 to 3600 s");
            }
        }
        for robot in &self.robots {
            for (key, found) in [
                ("voltage_unit_v", robot.voltage_unit_v),
                ("current_unit_a", robot.current_unit_a),
            ] {
                if !(1e-9..=1e9).contains(&found) {
                    let key = format!("robot {:?}: {key}", robot.name);
                    return refuse(key, found, "1e-9 to 1e9");
                }
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
    if !mapping.robots.is_empty() {
        for robot in &mapping.robots {
            check_topics(robot, channels)?;
        }
        return Ok(mapping.robots.clone());
    }
    let of_kind = |wanted: RosType| {
        channels
            .iter()
            .filter(move |channel| channel.kind == Ok(wanted) && channel.messages > 0)
    };
    let mut robots = Vec::new();
    let batteries: Vec<&Channel> = of_kind(RosType::BatteryState).collect();
    for battery in &batteries {
        let namespace = namespace(&battery.topic);
        let ours = |channel: &&Channel| {
            batteries.len() == 1 || self::namespace(&channel.topic) == namespace
        };
        let commands = of_kind(RosType::Twist).chain(of_kind(RosType::TwistStamped));
        let command = only(
            &commands.filter(ours).collect::<Vec<_>>(),
            "cmd_vel",
            &battery.topic,
        )?;
        let odometry: Vec<_> = of_kind(RosType::Odometry).filter(ours).collect();
        let odometry = only(&odometry, "odom", &battery.topic)?;
        robots.push(RobotMapping {
            name: namespace.unwrap_or(name).to_owned(),
            id: None,
            battery: battery.topic.clone(),
            command,
            odometry,
            current: mapping.current,
            voltage_unit_v: 1.0,
            current_unit_a: 1.0,
        });
    }
    Ok(robots)
}

/// The first component of a topic with several.
fn namespace(topic: &str) -> Option<&str> {
    let (first, rest) = topic.trim_start_matches('/').split_once('/')?;
    (!rest.is_empty()).then_some(first)
}

/// The only candidate topic, or the one with the usual name among several.
fn only(found: &[&Channel], usual: &str, battery: &str) -> Result<Option<String>, ImportError> {
    match found {
        [] => Ok(None),
        [one] => Ok(Some(one.topic.clone())),
        several => {
            let mut named = several
                .iter()
                .filter(|channel| channel.topic.rsplit('/').next() == Some(usual));
            match (named.next(), named.next()) {
                (Some(one), None) => Ok(Some(one.topic.clone())),
                _ => {
                    let topics: Vec<&str> = several
                        .iter()
                        .map(|channel| channel.topic.as_str())
                        .collect();
                    let what = format!("{battery} could go with any of {}", topics.join(", "));
                    Err(ImportError::Choice { what })
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
                let topics: Vec<&str> = channels
                    .iter()
                    .map(|channel| channel.topic.as_str())
                    .collect();
                format!("the file does not have it; it has {}", topics.join(", "))
            }
            Some(Channel { kind: Ok(kind), .. }) if allowed.contains(kind) => return Ok(()),
            Some(Channel { kind: Ok(kind), .. }) => {
                format!("found {kind:?}, allowed are {allowed:?}")
            }
            Some(Channel {
                kind: Err(error), ..
            }) => error.to_string(),
        };
        let topic = topic.to_owned();
        Err(ImportError::Topic { topic, why })
    };
    check(&robot.battery, &[RosType::BatteryState])?;
    if let Some(command) = &robot.command {
        check(command, &[RosType::Twist, RosType::TwistStamped])?;
    }
    if let Some(odometry) = &robot.odometry {
        check(odometry, &[RosType::Odometry])?;
    }
    Ok(())
}
