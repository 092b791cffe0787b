//! Routes messages to the observations of their robots.

use serde_json::Value;

use crate::mapping::account::{Account, Reason};
use crate::mapping::fields::Fields;
use crate::mapping::observation::Observation;
use crate::mapping::robots::Robots;
use crate::mapping::topic::Pattern;

const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";
/// Numbers that Python and JavaScript write though JSON has none of them: they are not known.
const NOT_NUMBERS: [&[u8]; 3] = [b"NaN", b"-Infinity", b"Infinity"];

/// A pattern of topics, with the layout of their documents.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Route {
    pub(crate) name: String,
    pub(crate) pattern: Pattern,
    pub(crate) fields: Fields,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Message<'m> {
    pub(crate) topic: &'m str,
    pub(crate) payload: &'m [u8],
    /// The broker retained it from earlier.
    pub(crate) retained: bool,
    /// When it arrived, Unix s.
    pub(crate) unix_s: f64,
}

/// Reads messages. Bad ones are counted and change nothing.
#[derive(Debug, Clone)]
pub(crate) struct Reader {
    routes: Vec<Route>,
    robots: Robots,
    max_bytes: usize,
}

impl Reader {
    pub(crate) fn new(routes: Vec<Route>, robots: Robots, max_bytes: usize) -> Self {
        Self { routes, robots, max_bytes }
    }

    /// The topics to subscribe to, without duplicates.
    pub(crate) fn filters(&self) -> Vec<String> {
        let mut filters: Vec<String> =
            self.routes.iter().map(|route| route.pattern.filter()).collect();
        filters.sort();
        filters.dedup();
        filters
    }

    /// Reads a message, and passes each robot's observation to `take`.
    pub(crate) fn read(
        &self,
        message: Message<'_>,
        account: &mut Account,
        mut take: impl FnMut(u32, &Observation),
    ) {
        let matching = self.routes.iter().filter_map(|route| {
            let robot = route.pattern.matches(message.topic)?;
            Some((route, robot))
        });
        let mut is_read = false;
        for (route, robot) in matching {
            is_read = true;
            let reading = Reading { route: &route.name, message, account };
            if let Some((robot, seen)) = reading.seen(route, robot, &self.robots, self.max_bytes) {
                take(robot, &seen);
            }
        }
        if !is_read {
            account.count("mqtt", Reason::NoRoute, message.topic);
        }
    }

    /// Counts a message that was not read, by each route that its topic fits.
    pub(crate) fn skip(&self, topic: &str, reason: Reason, account: &mut Account) {
        let routes = self.routes.iter();
        for route in routes.filter(|route| route.pattern.matches(topic).is_some()) {
            account.count(&route.name, reason, topic);
        }
    }
}

/// The text with null for numbers that JSON does not have.
fn without_nan(payload: &[u8]) -> Vec<u8> {
    let mut text = Vec::with_capacity(payload.len());
    let (mut rest, mut in_string) = (payload, false);
    while let Some((first, after)) = rest.split_first() {
        let word = NOT_NUMBERS.iter().find(|word| !in_string && rest.starts_with(word));
        if let Some(word) = word {
            text.extend_from_slice(b"null");
            rest = &rest[word.len()..];
            continue;
        }
        text.push(*first);
        rest = after;
        match (first, in_string) {
            (b'"', _) => in_string = !in_string,
            // What follows ends no string.
            (b'\\', true) => {
                text.extend(rest.first());
                rest = rest.get(1..).unwrap_or_default();
            }
            _ => {}
        }
    }
    text
}

struct Reading<'a> {
    route: &'a str,
    message: Message<'a>,
    account: &'a mut Account,
}

impl Reading<'_> {
    fn count(&mut self, reason: Reason, name: &str) {
        self.account.count(self.route, reason, name);
    }

    fn document(&mut self, max_bytes: usize, takes_retained: bool) -> Option<Value> {
        let Message { topic, payload, retained, .. } = self.message;
        let refused = if payload.len() > max_bytes {
            Reason::TooLong
        } else if retained && !takes_retained {
            Reason::Retained
        } else {
            let payload = payload.strip_prefix(BYTE_ORDER_MARK).unwrap_or(payload);
            let read = serde_json::from_slice(payload);
            match read.or_else(|_| serde_json::from_slice(&without_nan(payload))) {
                Ok(document) => return Some(document),
                Err(_) => Reason::NotJson,
            }
        };
        self.count(refused, topic);
        None
    }

    fn observation(&mut self, fields: &Fields, document: &Value, robot: &str) -> Observation {
        let mut refused = Vec::new();
        let seen = fields.read(document, |reason, field| refused.push((reason, field)));
        for (reason, field) in refused {
            self.count(reason, &format!("{field} of {robot}"));
        }
        seen
    }

    fn id(&mut self, name: &str, robots: &Robots) -> Option<u32> {
        let id = robots.id(name);
        if id.is_none() {
            self.count(Reason::UnknownRobot, name);
        }
        id
    }

    fn seen(
        mut self,
        route: &Route,
        robot: Option<&str>,
        robots: &Robots,
        max_bytes: usize,
    ) -> Option<(u32, Observation)> {
        // Look up a name in the topic first, so that messages about other robots are not parsed.
        let id = robot.map(|name| self.id(name, robots));
        let document = match id {
            Some(None) => return None,
            // That a robot is gone stays said.
            _ => self.document(max_bytes, route.fields.ended.is_some())?,
        };
        let (robot, id) = match (robot, id.flatten()) {
            (Some(name), Some(id)) => (name.to_owned(), id),
            _ => {
                let Some(name) = route.fields.robot(&document) else {
                    self.count(Reason::UnknownRobot, "a document without name");
                    return None;
                };
                let id = self.id(&name, robots)?;
                (name, id)
            }
        };
        if let Some(standard) = route.fields.standard
            && let Some(version) = standard.unknown_version(&document)
        {
            self.count(Reason::UnknownVersion, &format!("{version} of {robot}"));
            return None;
        }
        let age_s = route.fields.standard.and_then(|of| of.age_s(&document, self.message.unix_s));
        if let Some(age_s) = age_s.filter(|_| !self.message.retained) {
            // Few names, whatever the ages.
            let age_s = 10_f64.powf((age_s.abs().log10() * 4.0).round() / 4.0).copysign(age_s);
            self.count(Reason::Late, &format!("{robot}: made some {age_s:.0} s before it came"));
        }
        let seen = self.observation(&route.fields, &document, &robot);
        let came = route.fields.came(&seen);
        self.account.came(self.route, &robot, &came);
        if seen.is_empty() {
            if !route.fields.may_be_empty() {
                self.count(Reason::Nothing, &robot);
            }
            return None;
        }
        Some((id, seen))
    }
}

#[cfg(test)]
mod tests {
    use joulebus_testkit::cases;
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;
    use crate::mapping::fields::{Number, ValuePath};
    use crate::mapping::units::Quantity;

    fn robots() -> Robots {
        let mut robots = Robots::default();
        robots.add("r{id}", "1-3").unwrap();
        robots
    }

    fn route(name: &str, robot: Option<ValuePath>) -> Route {
        Route {
            name: name.to_owned(),
            pattern: Pattern::parse(name).unwrap(),
            fields: Fields {
                power: Some(Number::si(Quantity::Power, "power")),
                robot,
                ..Fields::default()
            },
        }
    }

    fn reader() -> Reader {
        let named = route("all", Some(ValuePath::at("robot")));
        Reader::new(vec![route("fleet/{robot}/power", None), named], robots(), 1_000)
    }

    /// Robots with their powers, and reasons with their names.
    type Read = (Vec<(u32, f32)>, Vec<(&'static str, String)>);

    fn read(reader: &Reader, topic: &str, payload: &[u8]) -> Read {
        let (mut taken, mut account) = (Vec::new(), Account::default());
        let message = Message { topic, payload, retained: false, unix_s: 0.0 };
        reader.read(message, &mut account, |robot, seen| {
            taken.push((robot, seen.power.unwrap().power_w));
        });
        let refused =
            account.records().into_iter().map(|record| (record.reason, record.names.join(",")));
        (taken, refused.collect())
    }

    #[test]
    fn messages_are_of_the_robot_that_topic_or_document_names() {
        for (topic, payload, robot) in [
            ("fleet/r2/power", json!({"power": 3}), 2),
            ("all", json!({"robot": "r3", "power": 3}), 3),
        ] {
            let payload = payload.to_string();
            assert_eq!(read(&reader(), topic, payload.as_bytes()), (vec![(robot, 3.0)], vec![]));
        }
        assert_eq!(reader().filters(), ["all", "fleet/+/power"]);
    }

    #[test]
    fn what_cannot_be_mapped_is_counted_and_named() {
        for case in cases(
            r#"
            fleet/x/power | {"power": 3} | unknown_robot | x
            fleet/r1/power | { | not_json | fleet/r1/power
            fleet/r1/power |  | not_json | fleet/r1/power
            fleet/r1/power | {"power": NaN} | nothing_mapped | r1
            fleet/r1/power | {"power": Nan} | not_json | fleet/r1/power
            fleet/r1/power | {"power": 1e999} | not_json | fleet/r1/power
            fleet/r1/power | {"power": 1e99} | not_finite | power of r1
            fleet/r1/power | {"power": "3"} | wrong_type | power of r1
            fleet/r1/power | {"watt": 3} | nothing_mapped | r1
            fleet/r1/power | [] | nothing_mapped | r1
            all | {"power": 3} | unknown_robot | a document without name
            all | {"robot": "r9", "power": 3} | unknown_robot | r9
            all | {"robot": ["r1"], "power": 3} | unknown_robot | a document without name
            "#,
        ) {
            let [topic, payload, reason, name] = case.as_slice() else {
                panic!("{case:?}");
            };
            let (taken, refused) = read(&reader(), topic, payload.as_bytes());
            assert_eq!(taken, [], "{payload}");
            let is_it = |found: &(&str, String)| found.0 == reason && found.1 == *name;
            assert!(refused.iter().any(is_it), "{payload}: {refused:?}");
        }
        let (taken, refused) = read(&reader(), "fleet/r1/power", "[".repeat(900).as_bytes());
        assert_eq!((taken, refused[0].0), (vec![], "not_json"));
        let (taken, refused) = read(&reader(), "fleet/r1/power", &[b' '; 1_001]);
        assert_eq!((taken, refused[0].0), (vec![], "too_long"));
        let (taken, refused) = read(&reader(), "elsewhere", b"{");
        assert_eq!((taken, refused), (vec![], vec![("no_route", "elsewhere".to_owned())]));
        let mut account = Account::default();
        let kept = Message {
            topic: "fleet/r1/power",
            payload: br#"{"power": 3}"#,
            retained: true,
            unix_s: 0.0,
        };
        reader().read(kept, &mut account, |_, _| panic!("nobody knows how old it is"));
        assert_eq!(account.records()[0].reason, "retained");
    }

    /// As Python and PlotJuggler write them.
    #[test]
    fn numbers_that_json_does_not_have_are_unknown_and_the_rest_is_read() {
        for payload in [
            r#"{"v": NaN, "power": 3}"#,
            r#"{"v": [-Infinity, Infinity], "power": 3, "note": "NaN \" NaN \\"}"#,
            "\u{feff}{\"power\": 3}",
        ] {
            let read = read(&reader(), "fleet/r1/power", payload.as_bytes());
            assert_eq!(read, (vec![(1, 3.0)], vec![]), "{payload}");
        }
        let kept = br#"{"note": "NaN, \"Infinity\""}"#;
        assert_eq!(without_nan(kept), kept);
    }

    /// A vehicle of VDA 5050 says when its message was made, and its broker when it is gone.
    #[test]
    fn ages_and_ends_of_vehicles_are_told() {
        let route = |topic: &str, fields| Route {
            name: topic.to_owned(),
            pattern: Pattern::parse(topic).unwrap(),
            fields,
        };
        let routes = vec![
            route("v/{robot}/state", Fields::vda5050(false)),
            route("v/{robot}/connection", Fields::vda5050_connection()),
        ];
        let reader = Reader::new(routes, robots(), 1_000);
        let made = "2026-04-07T10:30:00.5Z";
        let state = json!({"timestamp": made, "batteryState": {"batteryCharge": 80.0}});
        let says = |word: &str| json!({"timestamp": made, "connectionState": word});
        let arrived_s = 1_775_557_800.5;
        let cases = [
            ("state", state.clone(), 0.1, Some(false), None),
            ("state", state.clone(), 1_200.0, Some(false), Some("late")),
            ("state", state, -60.0, Some(false), Some("late")),
            ("connection", says("ONLINE"), 0.1, None, None),
            ("connection", says("OFFLINE"), 0.1, Some(true), None),
            ("connection", says("CONNECTION_BROKEN"), 9_000.0, Some(true), None),
            ("connection", says("CONNECTIONBROKEN"), 0.1, Some(true), None),
        ];
        for (topic, document, age_s, expected, reason) in cases {
            let (mut account, mut ended) = (Account::default(), None);
            let (topic_of_it, payload) = (format!("v/r1/{topic}"), document.to_string());
            let message = Message {
                topic: &topic_of_it,
                payload: payload.as_bytes(),
                // A broker keeps that a vehicle is gone.
                retained: topic == "connection",
                unix_s: arrived_s + age_s,
            };
            reader.read(message, &mut account, |_, seen| {
                ended = Some(seen.has_ended || seen.off == Some(true));
            });
            let records = account.records();
            let told: Vec<&str> = records.iter().map(|record| record.reason).collect();
            assert_eq!((ended, told.first().copied()), (expected, reason), "{document} {age_s}");
            assert_eq!(account.lost(), 0, "{document}");
        }
    }

    proptest! {
        #[test]
        fn no_message_panics(topic in "[a-z0-9/]{0,30}", payload in prop::collection::vec(any::<u8>(), 0..200)) {
            let (mut account, reader) = (Account::default(), reader());
            for topic in [topic.as_str(), "fleet/r1/power", "all"] {
                let message = Message { topic, payload: &payload, retained: false, unix_s: 0.0 };
                reader.read(message, &mut account, |_, seen| assert!(!seen.is_empty()));
            }
        }
    }
}
