//! Checks `[mqtt]`: the broker, and the topics to read and to write.

use std::collections::BTreeMap;
use std::time::Duration;

use serde_json::Value;
use toml::Spanned;

use crate::config::check::Check;
use crate::config::file::{
    CurrentWord, FieldsSection, FlagSection, MqttSection, NumberSection, OutgoingValueSection,
    Text, WriteSection,
};
use crate::config::secret::secret;
use crate::config::tls::TlsSettings;
use crate::mapping::fields::{Fields, Flag, Number, Place};
use crate::mapping::outgoing::{OutgoingValue, What, quantity, value_names};
use crate::mapping::robots::Robots;
use crate::mapping::route::Route;
use crate::mapping::topic::{Pattern, ROBOT, Template};
use crate::mapping::units::Quantity;
use crate::mapping::vizier;

/// Versions of MQTT, as connections name them: 3.1.1 and 5.
pub(crate) const VERSIONS: [u8; 2] = [4, 5];
/// Range of the keep-alive interval, s.
const KEEP_ALIVE_S: (u64, u64) = (5, 3_600);
/// Maximum of the configurable payload size, bytes.
const MAX_PAYLOAD_BYTES: u32 = 8 << 20;
/// Range of the interval between messages or requests, s.
const EVERY_S: (f64, f64) = (0.02, 3_600.0);

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
    pub(crate) vizier: Option<VizierSettings>,
    pub(crate) writes: Vec<Write>,
}

/// A vizier to poll.
#[derive(Debug, Clone)]
pub(crate) struct VizierSettings {
    pub(crate) every: Duration,
    pub(crate) fields: Fields,
}

/// A topic to write.
#[derive(Debug, Clone)]
pub(crate) struct Write {
    pub(crate) what: What,
    pub(crate) topic: Template,
    pub(crate) every_ns: u64,
    pub(crate) retain: bool,
    pub(crate) fields: Vec<OutgoingValue>,
}

impl Check<'_> {
    pub(super) fn mqtt(
        &mut self,
        section: MqttSection,
        name: &str,
        robots: &Robots,
    ) -> Option<MqttSettings> {
        let broker = broker(section.broker.get_ref());
        let (host, port) = self.checked(&section.broker, "mqtt.broker", broker)?;
        let client_id = self.client_id(section.client_id.as_ref(), name);
        let login = self.login(section.username, section.password_file.as_ref());
        let version = section.version.and_then(|text| {
            let version = match text.get_ref().as_str() {
                "3.1.1" => Ok(VERSIONS[0]),
                "5" => Ok(VERSIONS[1]),
                _ => Err("is no version of MQTT; allowed are 3.1.1 and 5"),
            };
            self.checked(&text, "mqtt.version", version)
        });
        let tls = section.tls.and_then(|tls| self.tls(&tls));
        let (least, most) = KEEP_ALIVE_S;
        if !(least..=most).contains(&section.keep_alive_s) {
            let what = format!("is {}", section.keep_alive_s);
            self.problem(None, "mqtt.keep_alive_s", what, &format!("Allowed: {least} to {most}"));
        }
        if !(1..=MAX_PAYLOAD_BYTES).contains(&section.max_payload_bytes) {
            let what = format!("is {}", section.max_payload_bytes);
            self.problem(
                None,
                "mqtt.max_payload_bytes",
                what,
                &format!("Allowed: 1 to {MAX_PAYLOAD_BYTES}"),
            );
        }
        let mut routes = Vec::new();
        for read in &section.read {
            let mut fields = self.fields(&read.fields, "mqtt.read.fields");
            fields.robot = read.robot_at.as_deref().map(Place::at);
            routes.extend(self.route(&read.topic, "mqtt.read.topic", fields));
        }
        for vda in &section.vda5050 {
            let negate = matches!(vda.current, Some(CurrentWord::DischargeNegative));
            routes.extend(self.route(&vda.topic, "mqtt.vda5050.topic", Fields::vda5050(negate)));
        }
        let vizier = section.vizier.map(|vizier| {
            let fields =
                vizier.fields.as_ref().map(|fields| self.fields(fields, "mqtt.vizier.fields"));
            routes.extend(self.route(
                &vizier.commands,
                "mqtt.vizier.commands",
                vizier::command_fields(),
            ));
            VizierSettings {
                every: self.every("mqtt.vizier.every_s", vizier.every_s),
                fields: fields.unwrap_or_else(vizier::status_fields),
            }
        });
        if vizier.is_some() {
            for write in &section.write {
                self.apart_from_vizier(&write.topic, robots);
            }
        }
        let writes =
            section.write.iter().filter_map(|write| self.write(write, robots, &routes)).collect();
        Some(MqttSettings {
            host,
            port,
            client_id,
            login,
            version,
            tls,
            keep_alive: Duration::from_secs(section.keep_alive_s),
            max_payload_bytes: section.max_payload_bytes as usize,
            routes,
            vizier,
            writes,
        })
    }

    fn client_id(&mut self, found: Option<&Text>, name: &str) -> String {
        let usual = || format!("joulebus-{}-{name}", self.fleet);
        let id = found.map_or_else(usual, |id| id.get_ref().clone());
        // The client's name is a level of the answers' topics.
        let is_bad = |letter: char| "/+#".contains(letter) || letter.is_control();
        if id.is_empty() || id.len() > 200 || id.contains(is_bad) {
            let start = found.map(|id| id.span().start);
            let what = format!("is {id:?}");
            self.problem(start, "mqtt.client_id", what, "Allowed: 1 to 200 bytes without / + #");
        }
        id
    }

    fn login(&mut self, username: Option<String>, file: Option<&Text>) -> Option<(String, String)> {
        match (username, file) {
            (None, None) => None,
            (Some(username), Some(file)) => {
                let password = secret(&self.folder.join(file.get_ref()));
                let password = self.checked(file, "mqtt.password_file", password)?;
                Some((username, password))
            }
            _ => {
                let what = "needs `username` and `password_file`, or neither".to_owned();
                self.problem(None, "mqtt.username", what, "Name both");
                None
            }
        }
    }

    fn route(&mut self, topic: &Text, key: &str, fields: Fields) -> Option<Route> {
        let pattern = Pattern::parse(topic.get_ref());
        let pattern = self.checked(topic, key, pattern)?;
        let is_named = pattern.has_robot() != fields.robot.is_some();
        let named =
            is_named.then_some(()).ok_or("needs {robot}, or else `robot_at`: one of the two");
        self.checked(topic, key, named)?;
        Some(Route { name: topic.get_ref().clone(), pattern, fields })
    }

    fn fields(&mut self, section: &FieldsSection, key: &str) -> Fields {
        let mut number = |field: &Option<NumberSection>, quantity, name: &str| {
            let field = field.as_ref()?;
            self.number(field, quantity, &format!("{key}.{name}"))
        };
        let mut fields = Fields {
            v: number(&section.v, Quantity::Speed, "v"),
            vy: number(&section.vy, Quantity::Speed, "vy"),
            omega: number(&section.omega, Quantity::TurnRate, "omega"),
            power: number(&section.power, Quantity::Power, "power"),
            power_of: section.power_of.map(Into::into).unwrap_or_default(),
            power_of_current: section.power_of_current,
            voltage: number(&section.voltage, Quantity::Voltage, "voltage"),
            current: number(&section.current, Quantity::Current, "current"),
            soc: number(&section.soc, Quantity::Share, "soc"),
            ..Fields::default()
        };
        fields.charging = self.flag(section.charging.as_ref(), &format!("{key}.charging"));
        fields.full = self.flag(section.full.as_ref(), &format!("{key}.full"));
        if section.power_of_current && (section.voltage.is_none() || section.current.is_none()) {
            let key = format!("{key}.power_of_current");
            let what = "needs `voltage` and `current`".to_owned();
            self.problem(None, &key, what, "Name both");
        }
        if fields == Fields::default() {
            self.problem(None, key, "names no value".to_owned(), "Name at least one");
        }
        fields
    }

    fn number(&mut self, section: &NumberSection, quantity: Quantity, key: &str) -> Option<Number> {
        let place = self.place(&section.at, &section.unknown, key)?;
        let unit = match &section.unit {
            None => quantity.si(),
            Some(unit) => {
                self.checked(unit, &format!("{key}.unit"), quantity.unit(unit.get_ref()))?
            }
        };
        Some(Number { place, unit, negate: section.negate })
    }

    fn flag(&mut self, section: Option<&FlagSection>, key: &str) -> Option<Flag> {
        let section = section?;
        let place = self.place(&section.at, &section.unknown, key)?;
        let is = match &section.is {
            None => vec![Value::Bool(true)],
            Some(values) => self.plain(&section.at, values, key)?,
        };
        Some(Flag { place, is })
    }

    fn place(&mut self, at: &Text, unknown: &[toml::Value], key: &str) -> Option<Place> {
        let place = Place::at(at.get_ref());
        let escapes = place.pointer.split('~').skip(1);
        let is_pointer = escapes.into_iter().all(|rest| rest.starts_with(['0', '1']));
        let is_pointer =
            is_pointer.then_some(()).ok_or("is no JSON pointer: ~ is written ~0, / in a name ~1");
        self.checked(at, &format!("{key}.at"), is_pointer)?;
        let unknown = self.plain(at, unknown, key)?;
        Some(Place { unknown, ..place })
    }

    /// Converts numbers, texts and booleans to JSON.
    fn plain(&mut self, at: &Text, values: &[toml::Value], key: &str) -> Option<Vec<Value>> {
        let value = |value: &toml::Value| match value {
            toml::Value::Integer(number) => Some(Value::from(*number)),
            toml::Value::Float(number) => serde_json::Number::from_f64(*number).map(Value::Number),
            toml::Value::String(text) => Some(Value::from(text.as_str())),
            toml::Value::Boolean(is_true) => Some(Value::Bool(*is_true)),
            _ => None,
        };
        let values: Option<Vec<Value>> = values.iter().map(value).collect();
        self.checked(
            at,
            key,
            values.ok_or("is compared with something else than numbers, texts, true and false"),
        )
    }

    pub(super) fn every(&mut self, key: &str, found_s: f64) -> Duration {
        let (least, most) = EVERY_S;
        if !(least <= found_s && found_s <= most) {
            let what = format!("is {found_s} s");
            self.problem(None, key, what, &format!("Allowed: {least} to {most} s"));
            return Duration::from_secs(1);
        }
        Duration::from_secs_f64(found_s)
    }

    fn write(
        &mut self,
        section: &WriteSection,
        robots: &Robots,
        routes: &[Route],
    ) -> Option<Write> {
        let (topic, what) = (&section.topic, section.what);
        let template = Template::parse(topic.get_ref(), self.fleet, what.is_of_robot());
        let template = self.checked(topic, "mqtt.write.topic", template)?;
        // A topic without a robot is the same for all robots.
        let mut written = robots.iter().map(|(_, robot)| template.of(robot));
        let reads = written.find_map(|written| {
            let mut routes = routes.iter();
            routes.find(|route| route.pattern.matches(&written).is_some())
        });
        let apart = reads
            .map_or(Ok(()), |route| Err(format!("is written, and {} reads it too", route.name)));
        self.checked(topic, "mqtt.write.topic", apart)?;
        let usual_s = if what == What::Budget { 5.0 } else { 1.0 };
        let every = self.every("mqtt.write.every_s", section.every_s.unwrap_or(usual_s));
        let fields = match &section.fields {
            None => what.usual().iter().map(|value| OutgoingValue::plain(value)).collect(),
            Some(fields) => self.outgoing_values(topic, what, fields)?,
        };
        Some(Write {
            what,
            topic: template,
            every_ns: every.as_nanos() as u64,
            retain: section.retain.unwrap_or(what.is_kept()),
            fields,
        })
    }

    /// Refuses topics of a vizier's nodes: those receive only this bridge's requests, and nobody
    /// writes in their name.
    fn apart_from_vizier(&mut self, topic: &Text, robots: &Robots) {
        let text = topic.get_ref().replace("{fleet}", self.fleet);
        let is_its = robots.iter().any(|(_, robot)| {
            let written = text.replace(ROBOT, robot);
            written == vizier::request_topic(robot)
                || written.starts_with(&format!("{robot}/responses/"))
        });
        let apart = (!is_its).then_some(()).ok_or("is a topic of the vizier, which is only read");
        self.checked(topic, "mqtt.write.topic", apart);
    }

    fn outgoing_values(
        &mut self,
        topic: &Text,
        what: What,
        fields: &BTreeMap<Text, OutgoingValueSection>,
    ) -> Option<Vec<OutgoingValue>> {
        let of_robot = what
            .is_of_robot()
            .then_some(())
            .ok_or("has fields, which only forecast, budget and alarms have");
        self.checked(topic, "mqtt.write.fields", of_robot)?;
        let mut values: Vec<(&Text, OutgoingValue)> = Vec::new();
        for (name, section) in fields {
            let key = format!("mqtt.write.fields.{}", name.get_ref());
            let value = section.value.get_ref();
            let known = quantity(value).ok_or_else(|| {
                format!("is no value; allowed are {}", value_names().collect::<Vec<_>>().join(", "))
            });
            let known = self.checked(&section.value, &key, known)?;
            let unit = section
                .unit
                .as_ref()
                .map(|unit| self.checked(unit, &format!("{key}.unit"), known.unit(unit.get_ref())));
            let path = path(name);
            let within = values
                .iter()
                .find(|(_, other)| path.starts_with(&other.path) || other.path.starts_with(&path));
            let apart = within.map_or(Ok(()), |(other, _)| {
                Err(format!("lies within {:?}, or is it", other.get_ref()))
            });
            self.checked(name, &key, apart)?;
            values.push((
                name,
                OutgoingValue {
                    value: value.clone(),
                    path,
                    unit: unit.unwrap_or(Some(known.si()))?,
                    negate: section.negate,
                },
            ));
        }
        Some(values.into_iter().map(|(_, value)| value).collect())
    }
}

/// The members of a JSON pointer, or a single name.
fn path(name: &Spanned<String>) -> Vec<String> {
    let pointer = Place::at(name.get_ref()).pointer;
    let parts = pointer.split('/').skip(1);
    parts.map(|part| part.replace("~1", "/").replace("~0", "~")).collect()
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
