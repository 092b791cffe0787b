//! Checks `[ros2]`: the domain, and the topics to read and to write.

use std::net::Ipv4Addr;

use joulebus_ros_messages::RosType;

use crate::config::check::Check;
use crate::config::file::{CurrentWord, Ros2Section, RosReadSection, RosWriteSection, Text};
use crate::mapping::observation::PowerOf;
use crate::mapping::outgoing::{OutgoingValue, quantity, value_names};
use crate::mapping::robots::Robots;
use crate::mapping::ros::incoming::{BatteryFields, RosRoute};
use crate::mapping::ros::names::{check_topic, read_type};
use crate::mapping::ros::outgoing::RosWhat;
use crate::mapping::topic::{Pattern, Template};
use crate::mapping::units::{Quantity, Unit};

/// The last domain whose ports are below 65,536.
const LAST_DOMAIN: u16 = 232;
/// Maximum number of topics of a bridge. Each has its own descriptors and buffers.
const MAX_TOPICS: usize = 4_000;
/// The variable with which every ROS 2 program chooses its domain.
const DOMAIN_VARIABLE: &str = "ROS_DOMAIN_ID";

/// A ROS 2 domain, and the topics that are read and written there.
#[derive(Debug, Clone)]
pub(crate) struct Ros2Settings {
    pub(crate) domain_id: u16,
    /// Addresses of this host to use. Empty: all.
    pub(crate) networks: Vec<Ipv4Addr>,
    pub(crate) routes: Vec<RosRoute>,
    pub(crate) writes: Vec<RosWrite>,
}

/// Topics to write, one for each robot or one for the fleet.
#[derive(Debug, Clone)]
pub(crate) struct RosWrite {
    pub(crate) what: RosWhat,
    /// The name as written in the file.
    pub(crate) name: String,
    pub(crate) topic: Template,
    pub(crate) every_ns: u64,
    /// The value of [`RosWhat::Value`].
    pub(crate) value: Option<OutgoingValue>,
}

impl Check<'_> {
    pub(super) fn ros2(&mut self, section: &Ros2Section, robots: &Robots) -> Option<Ros2Settings> {
        let before = self.problems.len();
        let domain_id = self.domain_id(section.domain_id);
        let networks = section.networks.iter().filter_map(|network| {
            let address = network.get_ref().parse::<Ipv4Addr>();
            self.checked(network, "ros2.networks", address)
        });
        let networks = networks.collect();
        let routes: Vec<RosRoute> =
            section.read.iter().filter_map(|read| self.ros_route(read, robots)).collect();
        let writes: Vec<RosWrite> =
            section.write.iter().filter_map(|write| self.ros_write(write, robots)).collect();
        self.apart(&routes, &writes, robots);
        let topics = robots.len() * (routes.len() + writes.len());
        if topics > MAX_TOPICS {
            let what = format!("has {topics} topics of {} robots", robots.len());
            let remedy = format!("Allowed: {MAX_TOPICS}. Run several bridges");
            self.problem(None, "ros2", what, &remedy);
        }
        if routes.is_empty() && writes.is_empty() && self.problems.len() == before {
            let what = "neither reads nor writes".to_owned();
            self.problem(None, "ros2", what, "Add [[ros2.read]] or [[ros2.write]]");
        }
        Some(Ros2Settings { domain_id, networks, routes, writes })
    }

    /// The domain of the file, else of the variable as in every ROS 2 program, else 0.
    fn domain_id(&mut self, found: Option<u16>) -> u16 {
        let variable = std::env::var(DOMAIN_VARIABLE).unwrap_or_default();
        let (key, text) = match found {
            Some(id) => ("ros2.domain_id", id.to_string()),
            None if variable.is_empty() => return 0,
            None => (DOMAIN_VARIABLE, variable),
        };
        let id = text.parse().ok().filter(|id| *id <= LAST_DOMAIN);
        id.unwrap_or_else(|| {
            let remedy = format!("Allowed: 0 to {LAST_DOMAIN}");
            self.problem(None, key, format!("is {text:?}"), &remedy);
            0
        })
    }

    fn ros_route(&mut self, section: &RosReadSection, robots: &Robots) -> Option<RosRoute> {
        let key = "ros2.read.topic";
        let topic = self.ros_topic(&section.topic, section.topic.get_ref(), key, (true, robots))?;
        let pattern = section.topic.get_ref().replace("{fleet}", self.fleet);
        let pattern = self.checked(&section.topic, key, Pattern::parse(&pattern))?;
        let kind = read_type(section.kind.get_ref());
        let kind = self.checked(&section.kind, "ros2.read.type", kind)?;
        let is_battery = kind == RosType::BatteryState;
        let is_mapped = section.current.is_some()
            || section.percentage_unit.is_some()
            || section.power_of.is_some()
            || section.power_of_current.is_some();
        let fits =
            (is_battery || !is_mapped).then_some(()).ok_or("has no current, percentage or power");
        self.checked(&section.kind, "ros2.read.type", fits)?;
        let power_of = section.power_of.map_or(PowerOf::Battery, Into::into);
        let battery = BatteryFields {
            discharge_is_positive: matches!(section.current, Some(CurrentWord::DischargePositive)),
            percentage: self.share(section.percentage_unit.as_ref())?,
            power_of: section.power_of_current.unwrap_or(true).then_some(power_of),
        };
        Some(RosRoute { name: section.topic.get_ref().clone(), topic, pattern, kind, battery })
    }

    fn share(&mut self, unit: Option<&Text>) -> Option<Unit> {
        let Some(unit) = unit else {
            return Some(Quantity::Share.si());
        };
        let found = Quantity::Share.unit(unit.get_ref());
        self.checked(unit, "ros2.read.percentage_unit", found)
    }

    /// Checks a pattern that yields a valid ROS 2 topic for every robot.
    fn ros_topic(
        &mut self,
        place: &Text,
        text: &str,
        key: &str,
        (of_robot, robots): (bool, &Robots),
    ) -> Option<Template> {
        let template = Template::parse(text, self.fleet, of_robot);
        let template = self.checked(place, key, template)?;
        let mut names = robots.iter().map(|(_, name)| template.of(name));
        let fits = names.try_for_each(|name| check_topic(&name));
        self.checked(place, key, fits)?;
        Some(template)
    }

    fn ros_write(&mut self, section: &RosWriteSection, robots: &Robots) -> Option<RosWrite> {
        let what = section.what;
        let value = match (&section.value, what) {
            (Some(value), RosWhat::Value) => Some(self.ros_value(value, section)?),
            (None, RosWhat::Value) => {
                let what = "lacks `value`".to_owned();
                self.problem(None, "ros2.write.value", what, "Name one value");
                return None;
            }
            (given, _) => {
                if let Some(text) = given.as_ref().or(section.unit.as_ref()) {
                    let refused = Err::<(), _>("belongs to what = \"value\"");
                    self.checked(text, "ros2.write.value", refused);
                    return None;
                }
                None
            }
        };
        let usual = match (what, &value) {
            (RosWhat::Diagnostics, _) => "/diagnostics".to_owned(),
            (RosWhat::Budget, _) => "/{robot}/joulebus/budget".to_owned(),
            (RosWhat::Value, Some(field)) => format!("/{{robot}}/joulebus/{}", field.value),
            _ => "/{robot}/joulebus/forecast".to_owned(),
        };
        let place = section.topic.clone().unwrap_or_else(|| toml::Spanned::new(0..0, usual));
        let name = place.get_ref().clone();
        let topic =
            self.ros_topic(&place, &name, "ros2.write.topic", (what.is_of_robot(), robots))?;
        let every = self.every("ros2.write.every_s", section.every_s.unwrap_or(1.0));
        Some(RosWrite { what, name, topic, every_ns: every.as_nanos() as u64, value })
    }

    fn ros_value(&mut self, value: &Text, section: &RosWriteSection) -> Option<OutgoingValue> {
        let key = "ros2.write.value";
        let known = quantity(value.get_ref()).ok_or_else(|| {
            let all: Vec<&str> = value_names().collect();
            format!("is no value; allowed are {}", all.join(", "))
        });
        let known = self.checked(value, key, known)?;
        let is_number = known != Quantity::Plain || value.get_ref() == "charging";
        let is_number = is_number.then_some(()).ok_or("is no number");
        self.checked(value, key, is_number)?;
        let unit = match &section.unit {
            None => known.si(),
            Some(unit) => self.checked(unit, "ros2.write.unit", known.unit(unit.get_ref()))?,
        };
        Some(OutgoingValue {
            unit,
            negate: section.negate,
            ..OutgoingValue::plain(value.get_ref())
        })
    }

    /// Checks that each topic has one purpose: the bridge reads no topic that it writes, and reads
    /// or writes none twice.
    fn apart(&mut self, routes: &[RosRoute], writes: &[RosWrite], robots: &Robots) {
        let mut topics: Vec<(String, &str)> = Vec::new();
        for (_, robot) in robots.iter() {
            topics.extend(routes.iter().map(|it| (it.topic.of(robot), it.name.as_str())));
            let of_robot = writes.iter().filter(|it| it.what.is_of_robot());
            topics.extend(of_robot.map(|it| (it.topic.of(robot), it.name.as_str())));
        }
        let of_fleet = writes.iter().filter(|it| !it.what.is_of_robot());
        topics.extend(of_fleet.map(|it| (it.topic.of(""), it.name.as_str())));
        topics.sort();
        let twice = topics.windows(2).find(|pair| pair[0].0 == pair[1].0);
        if let Some([(topic, one), (_, other)]) = twice {
            let what = format!("{one} and {other} both name {topic}");
            self.problem(None, "ros2", what, "Give each a topic of its own");
        }
    }
}
