//! The OpenAPI document and the answers describe each other.

use std::collections::BTreeSet;

use joulebus_testkit::eventually;
use serde_json::Value;

use super::client::{Events, acknowledge, answered, get, get_json, has_alarm, what_if};
use super::fleet::Fleet;

/// The differences between `value` and `schema`.
fn differences(
    document: &Value,
    schema: &Value,
    value: &Value,
    place: &str,
    found: &mut Vec<String>,
) {
    if let Some(name) = schema["$ref"].as_str() {
        let schema = document.pointer(name.strip_prefix('#').unwrap()).unwrap();
        return differences(document, schema, value, place, found);
    }
    let types: Vec<&str> = match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(several) => several.iter().filter_map(Value::as_str).collect(),
        _ => return,
    };
    let fits = types.iter().any(|name| match *name {
        "null" => value.is_null(),
        "integer" => value.is_u64() || value.is_i64(),
        "number" => value.is_number(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        _ => false,
    });
    if !fits {
        found.push(format!("{place} is {value}, expected {types:?}"));
    }
    let among = schema["enum"].as_array().is_none_or(|all| all.contains(value));
    if !among {
        found.push(format!("{place} is {value}"));
    }
    for (number, item) in value.as_array().into_iter().flatten().enumerate() {
        differences(document, &schema["items"], item, &format!("{place}[{number}]"), found);
    }
    let (Some(object), Some(properties)) = (value.as_object(), schema["properties"].as_object())
    else {
        return;
    };
    for name in schema["required"].as_array().into_iter().flatten() {
        if !object.contains_key(name.as_str().unwrap()) {
            found.push(format!("{place} lacks {name}"));
        }
    }
    for (name, value) in object {
        match properties.get(name) {
            Some(schema) => differences(document, schema, value, &format!("{place}.{name}"), found),
            None => found.push(format!("{place}.{name} is not described")),
        }
    }
}

#[test]
fn every_answer_is_as_the_document_states() {
    let fleet = Fleet::new();
    let _worker = fleet.worker();
    let _source = fleet.joulebus("publish sim --robots 4 --fault 2=stuck");
    let (_server, address) = fleet.serve(&[]);
    // By then the robot's history has points, too.
    eventually("an alarm of the robot", || has_alarm(&address, 2, "StuckSensor"));
    let document = get_json(&address, "/api/v1/openapi.json");
    let check = |name: &str, value: &Value| {
        let schema = &document["components"]["schemas"][name];
        let mut found = Vec::new();
        differences(&document, schema, value, name, &mut found);
        assert_eq!(found, Vec::<String>::new());
    };
    check("Error", &get(&address, "/api/v1/robots/77").json());
    let asked =
        what_if(&address, r#"{"robot": 1, "path": [{"x_m": 0, "y_m": 0}, {"x_m": 1, "y_m": 0}]}"#);
    assert_eq!(asked.status, 200, "{}", asked.text());
    check("Answers", &asked.json());
    let acknowledged = acknowledge(
        &address,
        r#"{"robot": 2, "alarm": "StuckSensor", "by": "ann"}"#,
        "Content-Type: application/json",
    );
    assert_eq!(acknowledged.status, 200, "{}", acknowledged.text());
    check("Acknowledge", &acknowledged.json());
    eventually("it is shown", || {
        let alarms = get_json(&address, "/api/v1/alarms");
        alarms["changes"][0]["acknowledged"]["by"] == "ann"
    });
    for (path, item) in document["paths"].as_object().unwrap() {
        let content = &item["get"]["responses"]["200"]["content"];
        let named = content["application/json"]["schema"]["$ref"].as_str();
        if let Some(name) = named.and_then(|name| name.rsplit('/').next()) {
            check(name, &get_json(&address, &path.replace("{id}", "2")));
        } else if path == "/api/v1/stream" {
            let view = Events::open(&address, "robot=2").view;
            for (key, name) in
                [("fleet", "Fleet"), ("robots", "Robots"), ("robot", "Robot"), ("alarms", "Alarms")]
            {
                check(name, &view[key]);
            }
        } else if item.get("get").is_some() {
            // Not ready while the newest frame is older than two periods.
            let response = answered(path, || get(&address, path));
            assert_eq!(response.status, 200, "{path}");
        }
    }
}

#[test]
fn the_document_has_every_route_of_the_router_and_no_other() {
    let document: Value =
        serde_json::from_str(include_str!("../../../src/http/openapi.json")).unwrap();
    let described: BTreeSet<String> = document["paths"]
        .as_object()
        .unwrap()
        .iter()
        .flat_map(|(path, methods)| {
            methods.as_object().unwrap().keys().map(move |method| format!("{method} {path}"))
        })
        .collect();
    let router = include_str!("../../../src/http/api.rs");
    let routes = router.split(".route(\"").skip(1).map(|route| {
        let (path, rest) = route.split_once("\", ").unwrap();
        format!("{} {path}", rest.split('(').next().unwrap())
    });
    assert_eq!(routes.collect::<BTreeSet<_>>(), described);
}
