//! Pages agree with the sources: cards of alarms, keys of configs, paths of the HTTP interface,
//! limits. `JOULEBUS_WRITE=1 cargo test -p joulebus-tests --test repository cards` writes them
//! again.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use joulebus_config::KEYS;
use joulebus_testkit::assert_page_contains;
use joulebus_wire::AlarmCard;
use serde_json::Value;

#[test]
fn the_page_about_alarms_has_every_card() {
    let mut text = String::new();
    for card in AlarmCard::all() {
        let keys: Vec<String> = card.keys.iter().map(|key| format!("`{key}`")).collect();
        let keys = if keys.is_empty() { "no key".to_owned() } else { keys.join(", ") };
        let AlarmCard { name, meaning, check, found_within, .. } = card;
        let level = card.level.name();
        write!(
            text,
            "\n## {name}\n\n*{level}.* {meaning}\n\n- **Check**: {check}\n- **Set by**: {keys}\n\
             - **Found within**: {found_within}\n"
        )
        .unwrap();
    }
    text.push('\n');
    assert_page_contains("docs/reference/alarms.md", "<!-- cards", &text);
}

#[test]
fn the_page_about_configs_has_every_key() {
    let (mut text, mut section) = (String::new(), "");
    for key in KEYS {
        let (of, name) = key.path.rsplit_once('.').unwrap();
        if of != section {
            section = of;
            write!(text, "\n## `[{of}]`\n\n").unwrap();
            text += "| key | meaning | unit | allowed | default |\n|---|---|---|---|---|\n";
        }
        let default = key.default_words();
        let default = default.trim_start_matches("default").trim_start_matches([':', ' ']);
        let cell = |text: &str| text.replace('<', "\\<").replace('|', "\\|");
        let cells = [key.doc, key.unit, &key.range(), default].map(cell).join(" | ");
        writeln!(text, "| `{name}` | {cells} |").unwrap();
    }
    text.push('\n');
    assert_page_contains("docs/reference/config.md", "<!-- keys", &text);
}

#[test]
fn the_page_about_bridges_has_the_table_of_findings() {
    let source = source("crates/gateways/bridge/src/mapping/doors.rs");
    let (_, table) = source.split_once("const TABLE: &str = \"").unwrap();
    let (table, _) = table.split_once("\";").unwrap();
    assert_page_contains("docs/explanation/bridges.md", "<!-- doors", table);
}

#[test]
fn the_alert_rules_state_what_an_alarm_means() {
    let mut text = "          description: >-\n".to_owned();
    let mut word = "if";
    for card in AlarmCard::all() {
        let AlarmCard { name, meaning, check, .. } = card;
        writeln!(text, "            {{{{ {word} eq $labels.alarm \"{name}\" }}}}{meaning} {check}")
            .unwrap();
        word = "else if";
    }
    text.push_str("            {{ end }}\n");
    assert_page_contains("configs/prometheus/joulebus.rules.yml", "# cards", &text);
}

#[test]
fn the_keys_of_every_card_can_be_configured() {
    for card in AlarmCard::all() {
        for key in card.keys {
            assert!(KEYS.iter().any(|known| known.path == *key), "{}: {key}", card.name);
        }
    }
}

/// A source, by its path from the root.
fn source(path: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)).unwrap()
}

#[test]
fn the_page_about_http_has_every_path_of_the_router() {
    let document = source("crates/gateways/serve/src/http/openapi.json");
    let document: Value = serde_json::from_str(&document).unwrap();
    let (mut text, mut described) = (String::new(), BTreeSet::new());
    text += "\n| method | path | answer | parameters |\n|---|---|---|---|\n";
    for (path, methods) in document["paths"].as_object().unwrap() {
        for (method, about) in methods.as_object().unwrap() {
            described.insert(format!("{method} {path}"));
            let parameters = about["parameters"].as_array().into_iter().flatten();
            let names = parameters.map(|parameter| parameter["name"].as_str().unwrap());
            let named = names.filter(|name| *name != "id").map(|name| format!("`{name}`"));
            let named = named.collect::<Vec<_>>().join(", ");
            let (method, summary) = (method.to_uppercase(), about["summary"].as_str().unwrap());
            writeln!(text, "| `{method}` | `{path}` | {summary} | {named} |").unwrap();
        }
    }
    text.push('\n');
    let router = source("crates/gateways/serve/src/http/api.rs");
    let routes = router.split(".route(\"").skip(1).map(|route| {
        let (path, rest) = route.split_once("\", ").unwrap();
        format!("{} {path}", rest.split('(').next().unwrap())
    });
    assert_eq!(routes.collect::<BTreeSet<_>>(), described);
    assert_page_contains("docs/reference/http.md", "<!-- paths", &text);
}

/// Constants that a user meets: a heading, a source and its constants.
const LIMITS: [(&str, &str, &[&str]); 19] = [
    (
        "A fleet",
        "crates/core/settings/src/bounds.rs",
        &[
            "CAPACITY",
            "PLATFORMS",
            "PERIOD_MS",
            "MAX_SAMPLES_PER_TICK",
            "MAX_SOURCES",
            "MAX_PLANNERS",
        ],
    ),
    ("", "crates/core/domain/src/limits.rs", &["MAX_QUERY_CLIENTS"]),
    ("Plans", "crates/core/plan/src/limits.rs", &["MAX_STEPS", "MAX_PERIOD_S"]),
    ("", "crates/planning/plan-server/src/server.rs", &["MAX_OF_A_PROCESS"]),
    ("HTTP interface", "crates/gateways/serve/src/http/connections.rs", &["MAX_CONNECTIONS"]),
    ("", "crates/gateways/serve/src/http/stream_places.rs", &["MAX_STREAMS", "MAX_PER_CLIENT"]),
    ("", "crates/gateways/serve/src/http/api.rs", &["MAX_BODY_BYTES"]),
    ("", "crates/gateways/serve/src/http/view.rs", &["MAX_ROBOTS", "MAX_SEARCH_BYTES"]),
    ("", "crates/gateways/serve/src/http/what_if.rs", &["MAX_ROBOTS", "MAX_POINTS"]),
    ("", "crates/gateways/serve/src/http/questions.rs", &["MAX_QUESTIONS"]),
    ("", "crates/gateways/serve/src/http/alarms.rs", &["MAX_CHANGES"]),
    ("", "crates/core/wire/src/acknowledgement.rs", &["MAX_ACKNOWLEDGED", "MAX_NAME_BYTES"]),
    ("", "crates/gateways/serve/src/webhook/mod.rs", &["MAX_WAITING", "MAX_CHANGES"]),
    (
        "Recordings",
        "crates/lab/dataset/src/trial/limits.rs",
        &["MAX_WHOLE_ROWS", "MAX_TEXT_BYTES", "MAX_ROW_BYTES", "MAX_EXPANSION", "MAX_ROBOTS"],
    ),
    ("", "crates/capture/format/src/scan/record.rs", &["MAX_RECORD_BYTES"]),
    ("", "crates/lab/eval/src/score/error.rs", &["MAX_HORIZON"]),
    ("Models", "crates/core/predictor/src/file.rs", &["MAX_MODEL_BYTES", "MAX_NAME_BYTES"]),
    ("", "crates/lab/model-files/src/error.rs", &["MAX_FILE_BYTES"]),
    ("Bridges", "crates/gateways/bridge/src/mapping/robots.rs", &["MAX_BYTES", "MAX_RANGE"]),
];

/// A number of the sources as a page shows it: `1 << 20` as `1,048,576`.
fn shown(number: &str) -> String {
    let parse = |text: &str| text.trim().replace('_', "").parse::<u64>();
    let value = match number.split_once(" << ") {
        Some((value, bits)) => parse(value).unwrap() << parse(bits).unwrap(),
        None => match parse(number) {
            Ok(value) => value,
            Err(_) => return number.trim_end_matches(".0").replace('_', ","),
        },
    };
    let digits = value.to_string();
    let groups = digits.as_bytes().rchunks(3).rev().map(|group| str::from_utf8(group).unwrap());
    groups.collect::<Vec<_>>().join(",")
}

#[test]
fn the_page_about_limits_has_the_constants_of_the_sources() {
    let mut text = String::new();
    for (heading, path, names) in LIMITS {
        if !heading.is_empty() {
            write!(text, "\n## {heading}\n\n| limit | value |\n|---|---|\n").unwrap();
        }
        let source = source(path);
        for name in names {
            let (before, after) = source.split_once(&format!("const {name}: ")).expect(name);
            let (_, value) = after.split(';').next().unwrap().split_once(" = ").unwrap();
            let lines = before.rsplit('\n').skip(1);
            let mut doc: Vec<&str> = lines.map_while(|line| line.strip_prefix("/// ")).collect();
            doc.reverse();
            let doc = doc.join(" ");
            let doc = doc.split(". ").next().unwrap().trim_end_matches('.');
            let ends: Vec<String> = value.split("..=").map(shown).collect();
            writeln!(text, "| {doc} | {} |", ends.join(" to ")).unwrap();
        }
    }
    text.push('\n');
    assert_page_contains("docs/reference/limits.md", "<!-- limits", &text);
}
