//! The protocol of the Robotarium's vizier. A JSON request on `<node>/requests` is answered on
//! `<node>/responses/<id>`, with the link's JSON as a text (`vizier/node.py`, `vizier/utils.py`).
//! The bridge sends only `GET`.

use serde_json::{Value, json};

use crate::mapping::account::Reason;
use crate::mapping::fields::{Fields, Flag, Number, ValuePath};
use crate::mapping::observation::Observation;
use crate::mapping::units::{Quantity, Unit};

/// Status of an answer with data.
const SUCCESS: u64 = 200;

pub(crate) fn request_topic(node: &str) -> String {
    format!("{node}/requests")
}

pub(crate) fn response_filter(client: &str) -> String {
    format!("+/responses/{client}/+")
}

/// The request number and the node of an answer. `None` if the topic is no answer to `client`.
pub(crate) fn answered<'t>(client: &str, topic: &'t str) -> Option<(&'t str, u64)> {
    let (node, rest) = topic.split_once("/responses/")?;
    let number = rest.strip_prefix(client)?.strip_prefix('/')?;
    let is_plain = !number.is_empty() && number.bytes().all(|digit| digit.is_ascii_digit());
    (is_plain && !node.contains('/')).then_some((node, number.parse().ok()?))
}

/// The body of request `number` of `client` for a node's status.
pub(crate) fn request(client: &str, node: &str, number: u64) -> Value {
    json!({
        "id": format!("{client}/{number}"),
        "method": "GET",
        "link": format!("{node}/status"),
        "body": {},
    })
}

/// The contents of an answer.
///
/// # Errors
/// [`Reason::Refused`] without success or body, [`Reason::NotJson`] for a body that is not a text
/// with JSON.
pub(crate) fn body(response: &Value) -> Result<Value, Reason> {
    if response.get("status").and_then(Value::as_u64) != Some(SUCCESS) {
        return Err(Reason::Refused);
    }
    match response.get("body") {
        // The node has not put anything on the link yet.
        Some(Value::String(text)) if text.is_empty() => Err(Reason::Refused),
        Some(Value::String(text)) => serde_json::from_str(text).map_err(|_| Reason::NotJson),
        Some(Value::Null) | None => Err(Reason::Refused),
        Some(_) => Err(Reason::WrongType),
    }
}

/// The fields of a GTernal's status: battery in V, power monitor in mW and mA. −1 means no reading
/// yet.
pub(crate) fn status_fields() -> Fields {
    let number = |quantity: Quantity, name, size, path| Number {
        path: ValuePath { unknown: vec![json!(-1)], ..ValuePath::at(path) },
        unit: Unit { name, size },
        ..Number::si(quantity, path)
    };
    Fields {
        power: Some(number(Quantity::Power, "mW", 1e-3, "power")),
        current: Some(number(Quantity::Current, "mA", 1e-3, "bus_current")),
        voltage: Some(number(Quantity::Voltage, "V", 1.0, "batt_volt")),
        charging: Some(Flag::at("charge_status")),
        ..Fields::default()
    }
}

pub(crate) fn command_fields() -> Fields {
    Fields {
        v: Some(Number::si(Quantity::Speed, "v")),
        omega: Some(Number::si(Quantity::TurnRate, "w")),
        ..Fields::default()
    }
}

/// Corrects a status, given whether its text equals the previous one's. Before the first reading
/// `charge_status` is always false. A status with identical text was not measured again.
pub(crate) fn status(mut seen: Observation, repeats: bool) -> Observation {
    let is_read = seen.power.is_some() || seen.voltage_v.is_some() || seen.current_a.is_some();
    if !is_read {
        seen.charging = None;
    }
    Observation { repeats, ..seen }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Observation {
        let document = serde_json::from_str(text).unwrap();
        let seen = status_fields().read(&document, |reason, name| panic!("{reason:?} {name}"));
        status(seen, false)
    }

    #[test]
    fn a_status_before_the_first_reading_reports_nothing() {
        let first = r#"{"batt_volt": -1, "charge_status": false, "bus_volt": -1, "bus_current": -1, "power": -1}"#;
        assert!(read(first).is_empty());
        let later = r#"{"batt_volt": 3.9, "charge_status": false, "bus_volt": 3900.0, "bus_current": 950, "power": 3705}"#;
        let seen = read(later);
        assert_eq!(seen.power.unwrap().power_w, 3.705);
        assert_eq!(
            (seen.voltage_v, seen.current_a, seen.charging),
            (Some(3.9), Some(0.95), Some(false))
        );
    }

    #[test]
    fn only_answers_to_our_own_requests_are_answers() {
        for (topic, found) in [
            ("1/responses/jb/17", Some(("1", 17))),
            ("1/responses/jb/18446744073709551616", None),
            ("1/responses/jb/+17", None),
            ("1/responses/jb/", None),
            ("1/responses/other/17", None),
            ("1/responses/jb2/17", None),
            ("a/1/responses/jb/17", None),
            ("1/requests", None),
        ] {
            assert_eq!(answered("jb", topic), found, "{topic}");
        }
        let asked = request("jb", "1", 17);
        assert_eq!(
            (&asked["id"], &asked["method"], &asked["link"]),
            (&json!("jb/17"), &json!("GET"), &json!("1/status"))
        );
    }

    #[test]
    fn answers_that_carry_nothing_are_refused() {
        let carried = json!({"status": 200, "body": "{\"power\": 1}", "type": "DATA"});
        assert_eq!(body(&carried), Ok(json!({"power": 1})));
        for (response, why) in [
            (json!({"status": 404, "body": "{}"}), Reason::Refused),
            (json!({"status": "200", "body": "{}"}), Reason::Refused),
            (json!({"status": 200, "body": ""}), Reason::Refused),
            (json!({"status": 200}), Reason::Refused),
            (json!({"status": 200, "body": "{"}), Reason::NotJson),
            (json!({"status": 200, "body": {"power": 1}}), Reason::WrongType),
            (json!([]), Reason::Refused),
        ] {
            assert_eq!(body(&response), Err(why), "{response}");
        }
    }
}
