//! The shipped layouts of Foxglove and PlotJuggler name only topics and fields of the schemas.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use joulebus_capture_format::MessageKind;
use prost_reflect::{DescriptorPool, FieldDescriptor, MessageDescriptor};
use serde_json::Value;

/// The fleet in Foxglove's layout, that of the demo.
const FLEET: &str = "demo";

fn shipped(name: &str) -> String {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../configs");
    fs::read_to_string(configs.join(name)).unwrap()
}

fn layout() -> Value {
    serde_json::from_str(&shipped("foxglove/joulebus.json")).unwrap()
}

/// All texts under keys that hold message paths.
fn paths(value: &Value, found: &mut Vec<String>) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                match value.as_str() {
                    Some(path) if matches!(key.as_str(), "value" | "topicPath") => {
                        found.push(path.to_owned());
                    }
                    _ => paths(value, found),
                }
            }
        }
        Value::Array(values) => values.iter().for_each(|value| paths(value, found)),
        _ => {}
    }
}

fn message(kind: MessageKind) -> MessageDescriptor {
    let pool = DescriptorPool::decode(kind.descriptors().as_slice()).unwrap();
    pool.get_message_by_name(&kind.schema()).unwrap()
}

fn field(message: &MessageDescriptor, name: &str, path: &str) -> FieldDescriptor {
    let found = message.get_field_by_name(name);
    found.unwrap_or_else(|| panic!("{path}: {} has no field {name:?}", message.full_name()))
}

/// `"topic".field[:]{key==$variable}.field`; returns the variables used.
fn check(path: &str) -> Vec<String> {
    let (topic, rest) = path.strip_prefix('"').unwrap().split_once('"').unwrap();
    let kind = MessageKind::of_fleet()
        .find(|kind| kind.topic(FLEET, 0) == topic)
        .unwrap_or_else(|| panic!("{path}: no topic {topic:?}"));
    let mut message = Some(message(kind));
    let mut variables = Vec::new();
    for part in rest.split('.').filter(|part| !part.is_empty()) {
        let name = part.split(['[', '{']).next().unwrap();
        let of = message.take().unwrap_or_else(|| panic!("{path}: {name} is in no message"));
        let field = field(&of, name, path);
        message = field.kind().as_message().cloned();
        assert_eq!(part.contains("[:]"), field.is_list(), "{path}: {name}");
        for filter in part.split('{').skip(1) {
            let (key, value) = filter.trim_end_matches('}').split_once("==").unwrap();
            self::field(message.as_ref().unwrap(), key, path);
            variables.extend(value.strip_prefix('$').map(str::to_owned));
        }
    }
    variables
}

#[test]
fn every_path_names_a_topic_and_a_field_of_the_schemas() {
    let layout = layout();
    let mut found = Vec::new();
    paths(&layout["configById"], &mut found);
    assert!(found.len() > 15, "{found:?}");
    let used: BTreeSet<String> = found.iter().flat_map(|path| check(path)).collect();
    for variable in used {
        assert!(layout["globalVariables"].get(&variable).is_some(), "${variable}");
    }
    for wanted in ["power_w", "lo_w", "hi_w", "reading_w", "residual_w", "alarm"] {
        assert!(found.iter().any(|path| path.ends_with(&format!(".{wanted}"))), "{wanted}");
    }
}

/// The panels in the layout tree.
fn placed(layout: &Value, found: &mut BTreeSet<String>) {
    match layout {
        Value::String(panel) => {
            found.insert(panel.clone());
        }
        layout => {
            for side in ["first", "second"] {
                placed(&layout[side], found);
            }
        }
    }
}

#[test]
fn every_panel_is_placed_once() {
    let layout = layout();
    let mut found = BTreeSet::new();
    placed(&layout["layout"], &mut found);
    let panels: BTreeSet<String> =
        layout["configById"].as_object().unwrap().keys().cloned().collect();
    assert_eq!(found, panels);
}

#[test]
fn every_curve_of_plotjuggler_is_a_number_of_a_message_of_one_robot() {
    let text = shipped("plotjuggler/joulebus.xml");
    let layout = roxmltree::Document::parse(&text).unwrap();
    // PlotJuggler asks before it opens a layout of another version.
    assert_eq!(layout.root_element().attribute("version"), Some("2.3.8"));
    for splitter in layout.descendants().filter(|node| node.has_tag_name("DockSplitter")) {
        let areas = splitter.children().filter(|node| node.has_tag_name("DockArea")).count();
        assert_eq!(splitter.attribute("count"), Some(&*areas.to_string()));
        assert_eq!(splitter.attribute("sizes").unwrap().split(';').count(), areas);
    }
    let curves = layout.descendants().filter(|node| node.has_tag_name("curve"));
    let names: BTreeSet<&str> = curves.map(|curve| curve.attribute("name").unwrap()).collect();
    assert!(names.len() > 12, "{names:?}");
    for name in names {
        // It names a series by its topic and the path of its field.
        let (topic, path) = name.rsplit_once('/').unwrap();
        let kind = MessageKind::all().find(|kind| kind.topic("lab", 0) == topic);
        let kind = kind.unwrap_or_else(|| panic!("{name}: no topic {topic:?}"));
        let field = field(&message(kind), path, name).kind();
        // Names of an enum are texts there, without a line.
        assert!(field.as_enum().is_none() && field.as_message().is_none(), "{name}");
    }
}
