//! Checks `[mqtt]`: the broker, and the topics to read and to write.

use std::time::Duration;

use joulebus_config::{Scalar, Section, Text};
use serde_json::Value;

use crate::config::check::Check;
use crate::config::tls::TlsSettings;
use crate::mapping::fields::{Fields, Flag, Number, ValuePath, connection_topic};
use crate::mapping::outgoing::What;
use crate::mapping::robots::Robots;
use crate::mapping::route::Route;
use crate::mapping::topic::{Pattern, Template};
use crate::mapping::units::Quantity;

/// Versions of MQTT, as connections name them: 3.1.1 and 5.
pub(crate) const VERSIONS: [u8; 2] = [4, 5];

/// A broker, and the topics that are read and written there.
#[derive(Debug, Clone)]
pub(crate) struct MqttSettings {
    pub(crate) host: String,
    pub(crate) port: u16,
    pub(crate) client_id: String,
    /// User name and password.
    pub(crate) login: Option<(String, String)>,
    /// Version of MQTT, 4 for 3.1.1. `None`: 5, or else 4.
    pub(crate) version: Option<u8>,
    pub(crate) tls: Option<TlsSettings>,
    pub(crate) keep_alive: Duration,
    pub(crate) max_payload_bytes: usize,
    pub(crate) routes: Vec<Route>,
    pub(crate) writes: Vec<Write>,
}

/// A topic to write.
#[derive(Debug, Clone)]
pub(crate) struct Write {
    pub(crate) what: What,
    pub(crate) topic: Template,
    pub(crate) every_ns: u64,
    pub(crate) retain: bool,
}

impl Check<'_> {
    pub(super) fn mqtt(
        &mut self,
        section: &Section<'_>,
        name: &str,
        robots: &Robots,
    ) -> Option<MqttSettings> {
        let text = section.text("broker")?;
        let (host, port) = self.checked(&text, broker(&text))?;
        let client_id = section.text("client_id");
        let usual = || format!("joulebus-{}-{name}", self.fleet);
        let client_id = client_id.map_or_else(usual, |id| id.to_string());
        let login = self.login(section);
        let version = section.text("version").map(|text| match &*text {
            "3.1.1" => VERSIONS[0],
            _ => VERSIONS[1],
        });
        let tls = section.section("tls").and_then(|tls| self.tls(&tls));
        let mut routes = Vec::new();
        for read in section.list("read") {
            let mut fields = self.fields(&read.or_defaults("fields"));
            fields.robot = read.text("robot_at").map(|at| ValuePath::at(&at));
            routes.extend(self.route(read.text("topic"), fields));
        }
        for vda in section.list("vda5050") {
            let negate = vda.text("current").is_some_and(|word| &*word == "discharge_negative");
            let route = self.route(vda.text("topic"), Fields::vda5050(negate));
            if let Some(Route { name, pattern, .. }) = &route
                && let Some(topic) = connection_topic(name)
                && let Ok(of_connection) = Pattern::parse(&topic)
                && pattern.has_robot()
            {
                let fields = Fields::vda5050_connection();
                routes.push(Route { name: topic, pattern: of_connection, fields });
            }
            routes.extend(route);
        }
        let mut writes = Vec::new();
        for write in section.list("write") {
            let Some(topic) = write.text("topic") else { continue };
            writes.extend(self.write(&write, &topic, robots, &routes));
        }
        Some(MqttSettings {
            host,
            port,
            client_id,
            login,
            version,
            tls,
            keep_alive: Duration::from_secs(section.integer("keep_alive_s")?),
            max_payload_bytes: section.integer("max_payload_bytes")?,
            routes,
            writes,
        })
    }

    fn login(&mut self, section: &Section<'_>) -> Option<(String, String)> {
        match (section.text("username"), section.text("password_file")) {
            (None, None) => None,
            (Some(username), Some(file)) => {
                let password = joulebus_files::read_secret_line(&file.file())
                    .map_err(|error| format!("cannot be read: {error}"));
                Some((username.to_string(), self.checked(&file, password)?))
            }
            _ => {
                let what = "needs `username` and `password_file`, or neither".to_owned();
                self.add(section.problem("username", what, "Name both"));
                None
            }
        }
    }

    fn route(&mut self, topic: Option<Text>, fields: Fields) -> Option<Route> {
        let topic = topic?;
        let pattern = self.checked(&topic, Pattern::parse(&topic))?;
        let is_named = pattern.has_robot() != fields.robot.is_some();
        let named =
            is_named.then_some(()).ok_or("needs {robot}, or else `robot_at`: one of the two");
        self.checked(&topic, named)?;
        Some(Route { name: topic.to_string(), pattern, fields })
    }

    fn fields(&mut self, section: &Section<'_>) -> Fields {
        let mut number = |name: &str, quantity| self.number(&section.section(name)?, quantity);
        let mut fields = Fields {
            v: number("v", Quantity::Speed),
            vy: number("vy", Quantity::Speed),
            omega: number("omega", Quantity::TurnRate),
            power: number("power", Quantity::Power),
            power_of: section.word("power_of").unwrap_or_default(),
            power_of_current: section.flag("power_of_current") == Some(true),
            voltage: number("voltage", Quantity::Voltage),
            current: number("current", Quantity::Current),
            soc: number("soc", Quantity::Share),
            ..Fields::default()
        };
        fields.charging = section.section("charging").and_then(|flag| self.flag(&flag));
        fields.full = section.section("full").and_then(|flag| self.flag(&flag));
        fields.swapped = section.section("swapped").and_then(|flag| self.flag(&flag));
        fields.off = section.section("off").and_then(|flag| self.flag(&flag));
        let has = |name| section.section(name).is_some();
        if fields.power_of_current && !(has("voltage") && has("current")) {
            let what = "needs `voltage` and `current`".to_owned();
            self.add(section.problem("power_of_current", what, "Name both"));
        }
        if fields == Fields::default() {
            self.add(section.problem("", "names no value".to_owned(), "Name at least one"));
        }
        fields
    }

    fn number(&mut self, section: &Section<'_>, quantity: Quantity) -> Option<Number> {
        let path = self.value_path(section)?;
        let unit = match section.text("unit") {
            None => quantity.si(),
            Some(unit) => self.checked(&unit, quantity.unit(&unit))?,
        };
        Some(Number { path, unit, negate: section.flag("negate")? })
    }

    fn flag(&mut self, section: &Section<'_>) -> Option<Flag> {
        let path = self.value_path(section)?;
        let is = section.scalars("is").map_or_else(|| vec![Value::Bool(true)], json);
        Some(Flag { path, is })
    }

    fn value_path(&mut self, section: &Section<'_>) -> Option<ValuePath> {
        let at = section.text("at")?;
        let path = ValuePath::at(&at);
        let escapes = path.pointer.split('~').skip(1);
        let is_pointer = escapes.into_iter().all(|rest| rest.starts_with(['0', '1']));
        let is_pointer =
            is_pointer.then_some(()).ok_or("is no JSON pointer: ~ is written ~0, / in a name ~1");
        self.checked(&at, is_pointer)?;
        Some(ValuePath { unknown: json(section.scalars("unknown").unwrap_or_default()), ..path })
    }

    fn write(
        &mut self,
        section: &Section<'_>,
        topic: &Text,
        robots: &Robots,
        routes: &[Route],
    ) -> Option<Write> {
        let what: What = section.word("what")?;
        let template = Template::parse(topic, self.fleet, what.is_of_robot());
        let template = self.checked(topic, template)?;
        self.apart_from_routes(topic, &template, robots, routes)?;
        let usual_s = if what == What::Budget { 5.0 } else { 1.0 };
        let every = Self::every(section, "every_s", usual_s);
        Some(Write {
            what,
            topic: template,
            every_ns: every.as_nanos() as u64,
            retain: section.flag("retain").unwrap_or(what.is_kept()),
        })
    }

    /// Refuses to write a topic that is read.
    fn apart_from_routes(
        &mut self,
        text: &Text,
        topic: &Template,
        robots: &Robots,
        routes: &[Route],
    ) -> Option<()> {
        // A topic without a robot is the same for all robots.
        let mut written = robots.iter().map(|(_, robot)| topic.of(robot));
        let reads = written.find_map(|written| {
            let mut routes = routes.iter();
            routes.find(|route| route.pattern.matches(&written).is_some())
        });
        let apart = reads
            .map_or(Ok(()), |route| Err(format!("is written, and {} reads it too", route.name)));
        self.checked(text, apart)
    }
}

/// Numbers, texts and flags as JSON.
fn json(scalars: Vec<Scalar>) -> Vec<Value> {
    scalars.into_iter().filter_map(|scalar| serde_json::to_value(scalar).ok()).collect()
}

/// Splits `host:port` or `[address]:port`.
fn broker(text: &str) -> Result<(String, u16), &'static str> {
    let refused = "is not host:port, such as localhost:1883";
    let (host, port) = text.rsplit_once(':').ok_or(refused)?;
    let port: u16 = port.parse().map_err(|_| refused)?;
    let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    let is_host = !host.is_empty() && port != 0 && !host.contains(['/', ' ', '@']);
    is_host.then(|| (host.to_owned(), port)).ok_or(refused)
}
