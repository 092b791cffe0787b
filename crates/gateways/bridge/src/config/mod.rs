//! The bridge's file, checked strictly: robots, topics and units. Every problem is reported with
//! its line.

mod check;
mod mqtt;
mod ros2;
mod tls;

use std::time::Duration;

use joulebus_config::{CheckedFile, Config, ConfigError, Section};
use joulebus_plausibility::{Kind, Origin, Packs};
use joulebus_publisher::Judgement;

use crate::config::check::Check;
use crate::mapping::intake::{Holds, Intake};
use crate::mapping::outgoing::{What, is_of_outlook};
use crate::mapping::robots::Robots;
use crate::mapping::ros::outgoing::RosWhat;

pub(crate) use mqtt::{MqttSettings, VERSIONS, Write};
pub(crate) use ros2::{Ros2Settings, RosWrite};

/// The checked settings of a bridge.
#[derive(Debug, Clone)]
pub(crate) struct Settings {
    /// Name of the source and of the planners.
    pub(crate) name: String,
    pub(crate) holds: Holds,
    /// Findings that are not reported.
    pub(crate) accepted: Vec<Kind>,
    pub(crate) robots: Robots,
    pub(crate) mqtt: Option<MqttSettings>,
    pub(crate) ros2: Option<Ros2Settings>,
}

impl Settings {
    /// Checks a bridge's file for the fleet of `config`.
    pub(crate) fn new(file: &CheckedFile, config: &Config) -> Result<Self, ConfigError> {
        let mut check = Check { fleet: config.fleet(), problems: file.problems.clone() };
        match check.settings(&file.root(), config) {
            Some(settings) if check.problems.is_empty() => Ok(settings),
            _ => Err(ConfigError::Refused(check.problems)),
        }
    }

    /// True if any topic is read.
    pub(crate) fn is_source(&self) -> bool {
        let mqtt = self.mqtt.as_ref();
        let ros2 = self.ros2.as_ref();
        mqtt.is_some_and(|mqtt| !mqtt.routes.is_empty())
            || ros2.is_some_and(|ros2| !ros2.routes.is_empty())
    }

    /// True if energies left are written.
    pub(crate) fn writes_budgets(&self) -> bool {
        let mut mqtt = self.mqtt.iter().flat_map(|mqtt| &mqtt.writes);
        let mut ros2 = self.ros2.iter().flat_map(|ros2| &ros2.writes);
        mqtt.any(|write| write.what == What::Budget)
            || ros2.any(|write| write.what == RosWhat::Budget)
    }

    /// True if values of outlooks are written: only then the worker computes them.
    pub(crate) fn writes_outlooks(&self) -> bool {
        let mut mqtt = self.mqtt.iter().flat_map(|mqtt| &mqtt.writes);
        let mut ros2 = self.ros2.iter().flat_map(|ros2| &ros2.writes);
        let is_of_outlook = |value: &String| is_of_outlook(value);
        mqtt.any(|write| write.what == What::Outlook)
            || ros2.any(|write| {
                write.what == RosWhat::Outlook || write.value.as_ref().is_some_and(is_of_outlook)
            })
    }

    /// Interval of the most frequent topic. Alarm changes are read separately.
    pub(crate) fn publish_interval(&self) -> Duration {
        let mqtt = self.mqtt.iter().flat_map(|mqtt| &mqtt.writes);
        let ros2 = self.ros2.iter().flat_map(|ros2| &ros2.writes);
        let timed = mqtt.filter(|write| write.what != What::AlarmChanges);
        let every_ns = timed.map(|write| write.every_ns);
        let least_ns = every_ns.chain(ros2.map(|write| write.every_ns)).min();
        least_ns.map_or(Duration::MAX, Duration::from_nanos)
    }

    /// The initial state of all robots, without any observation.
    pub(crate) fn intake(&self, config: &Config) -> Intake {
        let platforms = &config.settings().platforms;
        let robots = self.robots.iter().filter_map(|(id, _)| {
            let platform = platforms
                .iter()
                .find(|platform| platform.robots.iter().any(|ids| ids.contains(&id)))?;
            let reading = platform.battery.map(|battery| battery.charge_reading);
            Some((id, reading.unwrap_or(joulebus_settings::ChargeReading::Load)))
        });
        let routes = self.mqtt.iter().flat_map(|mqtt| &mqtt.routes);
        let names = routes.flat_map(|route| route.fields.named()).collect();
        let judgement = Judgement::new(Origin::Bridge, self.accepted.clone()).named(names);
        let packs_wh = self.ros2.iter().flat_map(|ros2| ros2.packs_wh.clone()).collect();
        Intake::new(self.holds, self.reports_charging(), robots)
            .judged_by(judgement)
            .with_packs(Packs::new(packs_wh))
    }

    /// True if MQTT messages report that a robot charges. ROS 2 messages with a battery's power
    /// always report it, or that it is unknown.
    fn reports_charging(&self) -> bool {
        self.mqtt
            .as_ref()
            .is_some_and(|mqtt| mqtt.routes.iter().any(|route| route.fields.charging.is_some()))
    }
}

impl Check<'_> {
    fn settings(&mut self, file: &Section<'_>, config: &Config) -> Option<Settings> {
        let within = file.or_defaults("bridge");
        let name = within.text("name");
        let ns = |key: &str| Some((within.number(key)? * 1e9) as u64);
        let holds = Holds {
            command_ns: ns("command_holds_s").unwrap_or_default(),
            expired: within.word("command_expired").unwrap_or_default(),
            reading_ns: ns("reading_holds_s").unwrap_or_default(),
            silent_ns: ns("silent_after_s").unwrap_or_default(),
        };
        let accepted = within.texts("accept");
        let accepted = accepted.iter().filter_map(|kind| self.checked(kind, kind.parse::<Kind>()));
        let accepted = accepted.collect();
        let robots = self.robots(file, config);
        let name = name?.to_string();
        let (mqtt, ros2) = (file.section("mqtt"), file.section("ros2"));
        if mqtt.is_none() && ros2.is_none() {
            let what = "names nothing to bridge".to_owned();
            self.add(file.problem("", what, "Add [mqtt] or [ros2]"));
        }
        let has_mqtt = mqtt.is_some();
        let mqtt = mqtt.and_then(|section| self.mqtt(&section, &name, &robots));
        let ros2 = ros2.and_then(|section| {
            let ros2 = self.ros2(&section, &robots)?;
            if ros2.use_sim_time && has_mqtt {
                let what = "is set, and MQTT has no simulated time".to_owned();
                let remedy = "Run two bridges, one with [mqtt]";
                self.add(section.problem("use_sim_time", what, remedy));
            }
            Some(ros2)
        });
        Some(Settings { name, holds, accepted, robots, mqtt, ros2 })
    }

    fn robots(&mut self, file: &Section<'_>, config: &Config) -> Robots {
        let mut robots = Robots::default();
        for entry in file.list("robots.*") {
            let (Some(name), Some(ids)) = (entry.name(), entry.text("")) else { continue };
            if let Err(error) = robots.add(&name, &ids) {
                self.add(entry.problem("", error.to_string(), "Correct the line"));
            }
        }
        let platforms = &config.settings().platforms;
        let known = |id: u32| {
            platforms.iter().any(|platform| platform.robots.iter().any(|ids| ids.contains(&id)))
        };
        let strangers: Vec<u32> =
            robots.iter().map(|(id, _)| id).filter(|id| !known(*id)).collect();
        if let Some(first) = strangers.first() {
            let what = format!("has {} ids of no platform, the first is {first}", strangers.len());
            let remedy =
                format!("Name them in `platform.robots` of the config of fleet {}", self.fleet);
            self.add(file.problem("robots", what, &remedy));
        }
        let capacity = config.settings().capacity as usize;
        if robots.len() == 0 || robots.len() > capacity {
            let what = format!("has {} robots, allowed are 1 to {capacity}", robots.len());
            self.add(file.problem("robots", what, "`fleet.capacity` is the limit"));
        }
        robots
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use joulebus_config::File;
    use joulebus_testkit::{assert_contains, cases};

    use super::*;

    const FLEET: &str = "[fleet]\nname = \"lab\"\ncapacity = 20\n\
        [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n";
    const GOOD: &str = "[robots]\n\"agv-{id}\" = \"0-3\"\nlifter = 7\n[mqtt]\nbroker = \"localhost:1883\"\n\
        [[mqtt.read]]\ntopic = \"fleet/{robot}/power\"\n[mqtt.read.fields]\npower = { at = \"power\", unit = \"mW\" }\n\
        [[mqtt.write]]\ntopic = \"jb/{robot}\"\nwhat = \"forecast\"\n";

    fn load(text: &str) -> Result<Settings, ConfigError> {
        let config = Config::parse(FLEET, Path::new(".")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bridge.toml");
        fs::write(&path, text).unwrap();
        Settings::new(&CheckedFile::load(&path, File::Bridge)?, &config)
    }

    /// Each change of a good file is refused, with the words and a problem in the line.
    fn assert_refused(good: &str, table: &str) {
        for case in cases(table) {
            let [from, to, line, expected] = case.as_slice() else {
                panic!("{case:?}");
            };
            let text = good.replacen(from, to, 1);
            assert_ne!(text, good, "{from}");
            let refused = load(&text).expect_err(to);
            assert_contains(&refused, [expected]);
            let mut lines = refused.problems().iter().filter_map(|problem| problem.line);
            let line: usize = line.parse().unwrap();
            assert!(lines.any(|found| found == line), "{to}: {refused}");
        }
    }

    #[test]
    fn a_good_file_is_taken() {
        let settings = load(GOOD).unwrap();
        assert_eq!((settings.name.as_str(), settings.robots.len()), ("bridge", 5));
        assert_eq!(settings.holds.reading_ns, 2_000_000_000);
        let mqtt = settings.mqtt.unwrap();
        assert_eq!(
            (mqtt.host.as_str(), mqtt.port, mqtt.client_id.as_str()),
            ("localhost", 1883, "joulebus-lab-bridge")
        );
        assert_eq!((mqtt.routes.len(), mqtt.writes.len()), (1, 1));
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        assert_refused(
            GOOD,
            r#"
            broker = | borker = | 5 | nearest key is `mqtt.broker`
            "localhost:1883" | "localhost" | 5 | host:port
            "localhost:1883" | 1883 | 5 | integer
            lifter = 7 | lifter = 17 | 1 | 17
            lifter = 7 | lifter = 2 | 3 | second name
            lifter = 7 | lifter = true | 3 | boolean
            "mW" | "mA" | 9 | allowed are W, mW, kW
            fleet/{robot}/power | fleet/power | 7 | {robot}
            fleet/{robot}/power | fleet/#/{robot} | 7 | wildcard
            fleet/{robot}/power | jb/{robot} | 11 | reads it too
            jb/{robot} | jb/+/{robot} | 11 | wildcard
            jb/{robot} | jb | 11 | lacks {robot}
            power = { | power_of_current = true\npower = { | 9 | voltage
            at = "power" | at = "/a~2" | 9 | pointer
            "forecast" | "forecasts" | 12 | nearest word is "forecast"
            "forecast" | "forecast"\nevery_s = nan | 13 | NaN
            "forecast" | "status" | 11 | not of one robot
            "forecast" | "forecast"\nfields = { x = { value = "soc" } } | 13 | all values
            [mqtt] | [bridge]\nreading_holds_s = 0\n[mqtt] | 5 | s; 0.01 to 3600
            [mqtt] | [bridge]\nname = "a/b"\n[mqtt] | 5 | a/b
            [mqtt] | [mqtt]\nusername = "joe" | 5 | password_file
            [mqtt] | [mqtt]\nkeep_alive_s = 0 | 5 | 5 to 3600
            [mqtt] | [mqtt]\nversion = "4" | 5 | "3.1.1" or "5"
            [mqtt] | [mqtt]\ntls = { ca = "nowhere.pem" } | 5 | `mqtt.tls.ca` = "nowhere.pem" cannot be read
            [mqtt] | [mqtt]\ntls = { ca = "bridge.toml" } | 5 | BEGIN CERTIFICATE
            [mqtt] | [mqtt]\ntls = { ca = "a.pem", key = "a.key" } | 5 | `certificate` and `key`
            "#,
        );
    }

    const ROS: &str = "[robots]\n\"r{id}\" = \"0-3\"\nlifter = 7\n[ros2]\ndomain_id = 7\nnetworks = [\"127.0.0.1\"]\n\
        [[ros2.read]]\ntopic = \"/{fleet}/{robot}/battery\"\ntype = \"sensor_msgs/msg/BatteryState\"\n\
        [[ros2.write]]\nwhat = \"value\"\nvalue = \"power_w\"\n\
        [[ros2.write]]\nwhat = \"diagnostics\"\n";

    #[test]
    fn a_good_file_of_ros_2_is_taken() {
        let settings = load(ROS).unwrap();
        assert!(settings.is_source());
        let ros2 = settings.ros2.unwrap();
        assert_eq!((ros2.domain_id, ros2.networks.len()), (7, 1));
        assert_eq!(ros2.routes[0].topic.of("r2"), "/lab/r2/battery");
        assert_eq!(ros2.routes[0].pattern.matches("/lab/x/battery"), Some(Some("x")));
        let topics: Vec<String> = ros2.writes.iter().map(|write| write.topic.of("r2")).collect();
        assert_eq!(topics, ["/r2/joulebus/power_w", "/diagnostics"]);
        assert_eq!(ros2.writes[0].value.as_deref(), Some("power_w"));
    }

    #[test]
    fn what_is_wrong_for_ros_2_is_named_with_its_line() {
        assert_refused(
            ROS,
            r#"
            domain_id = 7 | domain_id = 233 | 5 | 0 to 232
            domain_id = 7 | domain = 7 | 5 | nearest key is `ros2.domain_id`
            127.0.0.1 | lo | 6 | invalid IPv4 address
            /{fleet}/{robot}/battery | /{robot}/7b | 8 | no topic of ROS 2
            /{fleet}/{robot}/battery | {robot}/b | 8 | no topic of ROS 2
            /{fleet}/{robot}/battery | /battery | 8 | lacks {robot}
            /{fleet}/{robot}/battery | /+/{robot} | 8 | wildcard
            lifter = 7 | lif-ter = 7 | 8 | /lab/lif-ter/battery
            BatteryState | Batteries | 9 | nav_msgs/msg/Odometry
            "sensor_msgs/msg/BatteryState" | "geometry_msgs/msg/Twist"\npower_of = "load" | 9 | no such current
            BatteryState" | BatteryState"\npercentage_unit = "W" | 10 | share, %
            BatteryState" | BatteryState"\npack_wh = 240 | 4 | 1 of 1 batteries have pack_wh
            BatteryState" | BatteryState"\npack_wh = 240\n[[ros2.read]]\ntopic = "/{robot}/b"\ntype = "sensor_msgs/msg/BatteryState" | 4 | 1 of 2 batteries
            BatteryState" | BatteryState"\nsays = "off" | 9 | goes with `says`
            sensor_msgs/msg/BatteryState | std_msgs/msg/Bool | 9 | goes with `says`
            sensor_msgs/msg/BatteryState" | spot_msgs/msg/BatteryStateArray"\npercentage_unit = "%" | 9 | no such current
            BatteryState" | BatteryState"\npack_wh = -1 | 10 | 0.001 to
            power_w | watt | 12 | is no value
            "power_w" | "name" | 12 | is no number
            "power_w" | "power_w"\nunit = "mW" | 13 | units of the SI
            "power_w" | "power_w"\nevery_s = 0 | 13 | 0.02 to 3600
            "value" | "forecast" | 12 | belongs to
            "power_w" | "power_w"\ntopic = "/lab/{robot}/battery" | 4 | both name
            [ros2] | [mqtt]\nbroker = "h:1"\n[ros2]\nuse_sim_time = true | 7 | no simulated time
            "#,
        );
        let nothing = load("[robots]\nr = 1\n[ros2]\n").unwrap_err().to_string();
        assert!(nothing.contains("neither reads nor writes"), "{nothing}");
    }

    #[test]
    fn a_file_without_robots_or_a_bridge_is_refused() {
        for text in ["", "[robots]\n", "[robots]\na = 1\n", "[robots]\n[mqtt]\nbroker = \"h:1\"\n"]
        {
            assert!(!load(text).unwrap_err().problems().is_empty(), "{text:?}");
        }
        let nowhere = CheckedFile::load(Path::new("/nowhere"), File::Bridge);
        assert!(matches!(nowhere, Err(ConfigError::Read { .. })));
    }
}
