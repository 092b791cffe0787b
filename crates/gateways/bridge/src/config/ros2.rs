//! Checks `[ros2]`: the domain, and the topics to read and to write.

use std::net::Ipv4Addr;

use joulebus_config::{Section, Text};
use joulebus_ros_messages::RosType;

use crate::config::check::Check;
use crate::mapping::observation::PowerOf;
use crate::mapping::outgoing::check_number;
use crate::mapping::robots::Robots;
use crate::mapping::ros::incoming::{BatteryFields, RosRoute};
use crate::mapping::ros::names::{check_topic, read_type};
use crate::mapping::ros::outgoing::RosWhat;
use crate::mapping::ros::services::Service;
use crate::mapping::topic::{Pattern, Template};
use crate::mapping::units::Quantity;

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
    /// Energies of the packs that each robot has, Wh. Empty: it has one battery.
    pub(crate) packs_wh: Vec<f64>,
    pub(crate) writes: Vec<RosWrite>,
    /// True if samples have the time of a simulation.
    pub(crate) use_sim_time: bool,
    /// Services and their names.
    pub(crate) services: Vec<(Service, String)>,
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
    pub(crate) value: Option<String>,
}

impl Check<'_> {
    pub(super) fn ros2(&mut self, section: &Section<'_>, robots: &Robots) -> Option<Ros2Settings> {
        let before = self.problems.len();
        let domain_id = self.domain_id(section);
        let networks = section.texts("networks");
        let networks = networks
            .iter()
            .filter_map(|network| self.checked(network, network.parse::<Ipv4Addr>()));
        let networks = networks.collect();
        let mut packs_wh = Vec::new();
        let routes: Vec<RosRoute> = section
            .list("read")
            .filter_map(|read| self.ros_route(&read, robots, &mut packs_wh))
            .collect();
        let batteries = routes.iter().filter(|route| route.is_battery()).count();
        if packs_wh.len() == 1 || !packs_wh.is_empty() && packs_wh.len() != batteries {
            let what = format!("{} of {batteries} batteries have pack_wh", packs_wh.len());
            let remedy = "Give it to all packs of a robot, and to no single battery";
            self.add(section.problem("", what, remedy));
        }
        let writes: Vec<RosWrite> =
            section.list("write").filter_map(|write| self.ros_write(&write, robots)).collect();
        self.apart(section, (&routes, &writes), robots);
        let topics = robots.len() * (routes.len() + writes.len());
        if topics > MAX_TOPICS {
            let what = format!("has {topics} topics of {} robots", robots.len());
            let remedy = format!("Allowed: {MAX_TOPICS}. Run several bridges");
            self.add(section.problem("", what, &remedy));
        }
        let services: Vec<(Service, String)> = Service::ALL
            .into_iter()
            .filter_map(|service| Some((service, self.service(section, service)?)))
            .collect();
        let is_idle = routes.is_empty() && writes.is_empty() && services.is_empty();
        if is_idle && self.problems.len() == before {
            let what = "neither reads nor writes, and has no service".to_owned();
            self.add(section.problem("", what, "Add [[ros2.read]] or [[ros2.write]]"));
        }
        let use_sim_time = section.flag("use_sim_time").unwrap_or_default();
        Some(Ros2Settings { domain_id, networks, routes, packs_wh, writes, use_sim_time, services })
    }

    /// The name of a service, if the file has it.
    fn service(&mut self, section: &Section<'_>, service: Service) -> Option<String> {
        let name = section.text(service.key())?;
        self.checked(&name, check_topic(&name))?;
        Some(name.to_string())
    }

    /// The domain of the file, else of the variable as in every ROS 2 program, else 0.
    fn domain_id(&mut self, section: &Section<'_>) -> u16 {
        let variable = std::env::var(DOMAIN_VARIABLE).unwrap_or_default();
        if section.has("domain_id") || variable.is_empty() {
            return section.integer("domain_id").unwrap_or_default();
        }
        let id = variable.parse().ok().filter(|id| *id <= LAST_DOMAIN);
        id.unwrap_or_else(|| {
            let what = format!("is missing, and {DOMAIN_VARIABLE} is {variable:?}");
            let remedy = format!("Allowed: 0 to {LAST_DOMAIN}");
            self.add(section.problem("domain_id", what, &remedy));
            0
        })
    }

    fn ros_route(
        &mut self,
        section: &Section<'_>,
        robots: &Robots,
        packs_wh: &mut Vec<f64>,
    ) -> Option<RosRoute> {
        let name = section.text("topic")?;
        let topic = self.ros_topic(&name, &name, (true, robots))?;
        let pattern = self.checked(&name, Pattern::parse(&name.replace("{fleet}", self.fleet)))?;
        let kind = section.text("type")?;
        let ros_type = self.checked(&kind, read_type(&kind))?;
        // An array states its own unit, and has all packs.
        let of_battery = ["percentage_unit", "pack_wh", "current", "power_of", "power_of_current"];
        let refused = match ros_type {
            RosType::BatteryState => &[][..],
            RosType::BatteryStateArray => &of_battery[..2],
            _ => &of_battery,
        };
        let fits = !refused.iter().any(|key| section.has(key));
        let fits = fits.then_some(()).ok_or("has no such current, percentage, power or pack");
        self.checked(&kind, fits)?;
        let says = section.word("says");
        let fits = says.is_some() == (ros_type == RosType::Bool);
        let fits =
            fits.then_some(()).ok_or("goes with `says`: a truth value that is off or swapped");
        self.checked(&kind, fits)?;
        let power_of = section.word("power_of").unwrap_or(PowerOf::Battery);
        let current = section.text("current");
        let battery = BatteryFields {
            discharge_is_positive: current.is_some_and(|word| &*word == "discharge_positive"),
            percentage: match section.text("percentage_unit") {
                None => Quantity::Share.si(),
                Some(unit) => self.checked(&unit, Quantity::Share.unit(&unit))?,
            },
            power_of: section.flag("power_of_current").unwrap_or(true).then_some(power_of),
            pack: section.number("pack_wh").map(|pack_wh| {
                packs_wh.push(pack_wh);
                packs_wh.len() - 1
            }),
        };
        Some(RosRoute { name: name.to_string(), topic, pattern, kind: ros_type, battery, says })
    }

    /// Checks a pattern that yields a valid ROS 2 topic for every robot.
    fn ros_topic(
        &mut self,
        place: &Text,
        text: &str,
        (of_robot, robots): (bool, &Robots),
    ) -> Option<Template> {
        let template = self.checked(place, Template::parse(text, self.fleet, of_robot))?;
        let mut names = robots.iter().map(|(_, name)| template.of(name));
        let fits = names.try_for_each(|name| check_topic(&name));
        self.checked(place, fits)?;
        Some(template)
    }

    fn ros_write(&mut self, section: &Section<'_>, robots: &Robots) -> Option<RosWrite> {
        let what = section.word("what")?;
        let value = match (section.text("value"), what) {
            (Some(value), RosWhat::Value) => {
                self.checked(&value, check_number(&value))?;
                Some(value.to_string())
            }
            (None, RosWhat::Value) => {
                let what = "is missing".to_owned();
                self.add(section.problem("value", what, "Name one value"));
                return None;
            }
            (Some(text), _) => {
                self.checked(&text, Err::<(), _>("belongs to what = \"value\""));
                return None;
            }
            (None, _) => None,
        };
        let name = section.text("topic");
        let usual = || match (what, &value) {
            (RosWhat::Diagnostics, _) => "/diagnostics".to_owned(),
            (RosWhat::Budget, _) => "/{robot}/joulebus/budget".to_owned(),
            (RosWhat::Outlook, _) => "/{robot}/joulebus/outlook".to_owned(),
            (RosWhat::Value, Some(value)) => format!("/{{robot}}/joulebus/{value}"),
            _ => "/{robot}/joulebus/forecast".to_owned(),
        };
        let place = name.clone().or_else(|| section.text("what"))?;
        let name = name.map_or_else(usual, |name| name.to_string());
        let topic = self.ros_topic(&place, &name, (what.is_of_robot(), robots))?;
        let every = Self::every(section, "every_s", 1.0);
        Some(RosWrite { what, name, topic, every_ns: every.as_nanos() as u64, value })
    }

    /// Checks that each topic has one purpose: the bridge reads no topic that it writes, and reads
    /// or writes none twice.
    fn apart(
        &mut self,
        section: &Section<'_>,
        (routes, writes): (&[RosRoute], &[RosWrite]),
        robots: &Robots,
    ) {
        let mut topics: Vec<(String, &str)> = Vec::new();
        for (_, robot) in robots.iter() {
            topics.extend(routes.iter().map(|route| (route.topic.of(robot), route.name.as_str())));
            let of_robot = writes.iter().filter(|write| write.what.is_of_robot());
            topics.extend(of_robot.map(|write| (write.topic.of(robot), write.name.as_str())));
        }
        let of_fleet = writes.iter().filter(|write| !write.what.is_of_robot());
        topics.extend(of_fleet.map(|write| (write.topic.of(""), write.name.as_str())));
        topics.sort();
        let twice = topics.windows(2).find(|pair| pair[0].0 == pair[1].0);
        if let Some([(topic, one), (_, other)]) = twice {
            let what = format!("{one} and {other} both name {topic}");
            self.add(section.problem("", what, "Give each a topic of its own"));
        }
    }
}
