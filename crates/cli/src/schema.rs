//! JSON Schema (2020-12) of the kinds of config files, from the table of keys.

use joulebus_config::{DefaultValue, File, Key, TextRule, ValueKind, keys, list};
use serde_json::{Map, Value, json};

/// The schema of a kind of file.
pub(crate) fn of(file: File) -> Value {
    let mut root = section();
    root["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
    root["title"] = json!(format!("joulebus: file of kind {}", file.name()));
    root["required"] = match file {
        File::Fleet => json!(["fleet", "platform"]),
        File::Bridge => json!(["robots"]),
        File::Link => json!(["network"]),
        File::Webhooks => json!(["webhook"]),
        // Keys of a platform may stand in the fleet's file instead.
        _ => json!([]),
    };
    for key in keys().filter(|key| file.allows(key)) {
        match file {
            File::Platform => add(&mut root, file, key, key.path_in_file()),
            _ => key.paths().iter().for_each(|path| add(&mut root, file, key, path)),
        }
    }
    root
}

fn section() -> Value {
    json!({ "type": "object", "properties": {}, "additionalProperties": false, "required": [] })
}

/// Adds the key at `path`, with the sections that it stands in.
fn add(root: &mut Value, file: File, key: &Key, path: &str) {
    let (sections, name) = path.rsplit_once('.').unwrap_or(("", path));
    let (mut at, mut within) = (root, String::new());
    for name in sections.split_terminator('.') {
        within += name;
        let new = match list(&within).filter(|_| file != File::Platform) {
            Some(most) => json!({ "type": "array", "maxItems": most, "items": section() }),
            None => section(),
        };
        at = entry(at, name, new);
        if at["type"] == "array" {
            at = &mut at["items"];
        }
        within.push('.');
    }
    let is_required = key.default == DefaultValue::Required && key.file == file;
    if is_required && file != File::Platform && name != "*" {
        at["required"].as_array_mut().into_iter().for_each(|names| names.push(json!(name)));
    }
    entry(at, name, leaf(key));
}

/// The schema of a name of a section. `*` is any.
fn entry<'v>(at: &'v mut Value, name: &str, new: Value) -> &'v mut Value {
    let entry = match name {
        "*" => &mut at["additionalProperties"],
        name => &mut at["properties"][name],
    };
    if !entry.is_object() {
        *entry = new;
    }
    entry
}

/// The schema of a key's value.
fn leaf(key: &Key) -> Value {
    let ids = json!([
        { "type": "integer", "minimum": 0, "maximum": u32::MAX },
        { "type": "string", "pattern": "^ *[0-9]+ *(- *[0-9]+ *)?$" },
    ]);
    let mut leaf = match key.kind {
        ValueKind::Integer { min, max } => {
            json!({ "type": "integer", "minimum": min, "maximum": max })
        }
        ValueKind::Number { min, max } => {
            json!({ "type": "number", "minimum": min, "maximum": max })
        }
        ValueKind::Choice(words) => json!({ "enum": words }),
        ValueKind::Words(words) => json!({ "type": "array", "items": { "enum": words } }),
        ValueKind::Text(rule) => text(rule),
        ValueKind::Texts { rule, min, max } => {
            let mut list = json!({ "type": "array", "items": text(rule), "minItems": min });
            if max < usize::MAX {
                list["maxItems"] = json!(max);
            }
            list
        }
        ValueKind::Flag => json!({ "type": "boolean" }),
        ValueKind::Scalars => {
            json!({ "type": "array", "items": { "type": ["number", "string", "boolean"] } })
        }
        ValueKind::Ids => json!({ "anyOf": ids }),
        ValueKind::Robots => json!({ "type": "array", "minItems": 1, "items": { "anyOf": ids } }),
        _ => json!({}),
    };
    leaf["description"] = json!(format!("{} ({})", key.doc, key.facts()));
    match key.default {
        DefaultValue::Integer(value) => leaf["default"] = json!(value),
        DefaultValue::Number(value) => leaf["default"] = json!(value),
        DefaultValue::Text(value) => leaf["default"] = json!(value),
        DefaultValue::Flag(value) => leaf["default"] = json!(value),
        _ => {}
    }
    leaf
}

fn text(rule: TextRule) -> Value {
    let mut text = Map::from_iter([("type".to_owned(), json!("string"))]);
    text.extend(rule.pattern().map(|pattern| ("pattern".to_owned(), json!(pattern))));
    text.into()
}
