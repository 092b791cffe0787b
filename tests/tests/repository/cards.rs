//! The documents say of alarms what their cards say, and of a config's keys what the table of keys
//! says. `JOULEBUS_WRITE=1 cargo test -p joulebus-tests --test repository cards` writes them again.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use joulebus_config::KEYS;
use joulebus_wire::AlarmCard;

/// What stands in `file` between its two lines that have `mark` is `text`.
fn assert_says(file: &str, mark: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(file);
    let old = fs::read_to_string(&path).unwrap();
    let mut parts = old.splitn(3, mark);
    let mut part = || parts.next().unwrap_or_else(|| panic!("{file}: no two {mark}"));
    let (before, between, after) = (part(), part(), part());
    let (end_of_line, _) = between.split_once('\n').unwrap();
    let (_, begin_of_line) = between.rsplit_once('\n').unwrap();
    let new = format!("{before}{mark}{end_of_line}\n{text}{begin_of_line}{mark}{after}");
    if std::env::var_os("JOULEBUS_WRITE").is_some() {
        fs::write(&path, &new).unwrap();
    } else {
        let remedy = "run this test again with JOULEBUS_WRITE=1";
        assert!(old == new, "{file} says something else: {remedy}");
    }
}

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
    assert_says("docs/reference/alarms.md", "<!-- cards", &text);
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
    assert_says("docs/reference/config.md", "<!-- keys", &text);
}

#[test]
fn the_page_about_bridges_has_the_table_of_findings() {
    let source = "../crates/gateways/bridge/src/mapping/doors.rs";
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(source);
    let source = fs::read_to_string(path).unwrap();
    let (_, table) = source.split_once("const TABLE: &str = \"").unwrap();
    let (table, _) = table.split_once("\";").unwrap();
    assert_says("docs/explanation/bridges.md", "<!-- doors", table);
}

#[test]
fn the_alert_rules_say_what_an_alarm_means() {
    let mut text = "          description: >-\n".to_owned();
    let mut word = "if";
    for card in AlarmCard::all() {
        let AlarmCard { name, meaning, check, .. } = card;
        writeln!(text, "            {{{{ {word} eq $labels.alarm \"{name}\" }}}}{meaning} {check}")
            .unwrap();
        word = "else if";
    }
    text.push_str("            {{ end }}\n");
    assert_says("configs/prometheus/joulebus.rules.yml", "# cards", &text);
}

#[test]
fn the_keys_of_every_card_can_be_configured() {
    for card in AlarmCard::all() {
        for key in card.keys {
            assert!(KEYS.iter().any(|known| known.path == *key), "{}: {key}", card.name);
        }
    }
}
