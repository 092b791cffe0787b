//! Bodies of requests: as JSON, and as messages for people.

use anyhow::{Context as _, anyhow};
use joulebus_board::AlarmRecord;
use joulebus_plan::report::Lasting;
use joulebus_program::utc::Utc;
use joulebus_wire::AlarmCard;
use serde_json::{Value, json};

/// Names that a template may have in braces.
pub(super) const PLACEHOLDERS: [&str; 12] = [
    "fleet", "robot", "alarm", "level", "change", "time", "lasted_s", "by", "meaning", "check",
    "link", "text",
];

/// Time as in RFC 3339, to the millisecond.
pub(super) fn rfc3339(unix_ns: u64) -> String {
    let utc = Utc::new(unix_ns);
    let Utc { hour, minute, second, millisecond, .. } = utc;
    format!("{}T{hour:02}:{minute:02}:{second:02}.{millisecond:03}Z", utc.date())
}

/// Address of a robot on the page, or of the page.
pub(super) fn link(page: &str, robot: Option<u32>) -> String {
    robot.map_or_else(|| format!("{page}/"), |robot| format!("{page}/?robot={robot}"))
}

/// The robot or worker that has the alarm.
pub(super) fn of(robot: Option<u32>) -> String {
    robot.map_or_else(|| "worker".to_owned(), |robot| format!("robot {robot}"))
}

/// A change in one line.
fn line(change: &AlarmRecord) -> String {
    let AlarmRecord { fleet, alarm, change: changed, level, .. } = change;
    let mut line = format!("fleet {fleet}, {}: {alarm} {changed}", of(change.robot));
    let by = change.acknowledged.as_ref().map(|row| &row.by);
    match (change.lasted_s, by) {
        (None, None) => line += &format!(" ({level})"),
        (None, Some(by)) => line += &format!(" by {by}"),
        (Some(lasted_s), by) => {
            line += &format!(" after {}", Lasting(lasted_s));
            line.extend(by.map(|by| format!(", acknowledged by {by}")));
        }
    }
    line
}

/// The changes line by line, and then what the raised alarms mean, each once.
fn lines(changes: &[AlarmRecord], page: Option<&str>) -> Vec<String> {
    let linked = |change: &AlarmRecord| {
        let link = page.map(|page| format!(" {}", link(page, change.robot)));
        line(change) + &link.unwrap_or_default()
    };
    let mut lines: Vec<String> = changes.iter().map(linked).collect();
    for card in changes.iter().filter_map(|change| change.card) {
        let line = format!("{}: {} {}", card.alarm, card.meaning, card.check);
        if !lines.contains(&line) {
            lines.push(line);
        }
    }
    lines
}

/// The changes as JSON.
pub(super) fn changes(fleet: &str, changes: &[AlarmRecord]) -> Value {
    json!({ "fleet": fleet, "changes": changes })
}

/// A message to an incoming webhook of Slack. Only these characters have a meaning there that
/// `mrkdwn` does not switch off.
pub(super) fn slack(changes: &[AlarmRecord], page: Option<&str>) -> Value {
    let text = lines(changes, page).join("\n");
    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    json!({ "text": text, "mrkdwn": false })
}

/// An Adaptive Card for a workflow of Teams, "When a Teams webhook request is received". Runs of a
/// rich text block are plain text: they have no markup that a name could contain.
pub(super) fn teams(changes: &[AlarmRecord], page: Option<&str>) -> Value {
    let paragraph =
        |text| json!({ "type": "RichTextBlock", "inlines": [{ "type": "TextRun", "text": text }] });
    let blocks: Vec<Value> = lines(changes, None).into_iter().map(paragraph).collect();
    let mut card = json!({
        "$schema": "http://adaptivecards.io/schemas/adaptive-card.json",
        "type": "AdaptiveCard",
        "version": "1.4",
        "body": blocks,
    });
    if let (Some(page), Some(first)) = (page, changes.first()) {
        // Several changes may be of several robots.
        let url = link(page, first.robot.filter(|_| changes.len() == 1));
        card["actions"] = json!([{ "type": "Action.OpenUrl", "title": "Open", "url": url }]);
    }
    let kind = "application/vnd.microsoft.card.adaptive";
    let attachment = json!({ "contentType": kind, "contentUrl": null, "content": card });
    json!({ "type": "message", "attachments": [attachment] })
}

/// Reads a template: JSON in whose texts `{name}` stands for a value.
pub(super) fn template(text: &str) -> anyhow::Result<Value> {
    let document: Value = serde_json::from_str(text).context("is no JSON")?;
    let mut unknown = None;
    fill(&document, &mut |name| {
        if !PLACEHOLDERS.contains(&name) {
            unknown.get_or_insert_with(|| name.to_owned());
        }
        String::new()
    });
    let allowed = || PLACEHOLDERS.map(|name| format!("{{{name}}}")).join(", ");
    match unknown {
        Some(name) => Err(anyhow!("has {{{name}}}. Allowed are {}", allowed())),
        None => Ok(document),
    }
}

/// A template's document with the values of a change.
pub(super) fn filled(template: &Value, change: &AlarmRecord, page: Option<&str>) -> Value {
    let card = AlarmCard::named(change.alarm);
    fill(template, &mut |name| match name {
        "fleet" => change.fleet.clone(),
        "robot" => change.robot.map_or_else(|| "worker".to_owned(), |robot| robot.to_string()),
        "alarm" => change.alarm.to_owned(),
        "level" => change.level.to_owned(),
        "change" => change.change.to_owned(),
        "time" => rfc3339(change.stamp_ns),
        "lasted_s" => change.lasted_s.map_or_else(String::new, |lasted_s| lasted_s.to_string()),
        "by" => change.acknowledged.as_ref().map_or_else(String::new, |row| row.by.clone()),
        "meaning" => card.map_or("", |card| card.meaning).to_owned(),
        "check" => card.map_or("", |card| card.check).to_owned(),
        "link" => page.map_or_else(String::new, |page| link(page, change.robot)),
        _ => line(change),
    })
}

/// Replaces the names in all texts of a document. It is JSON again, whatever the values contain.
fn fill(document: &Value, value: &mut dyn FnMut(&str) -> String) -> Value {
    match document {
        Value::String(text) => Value::String(fill_text(text, value)),
        Value::Array(items) => items.iter().map(|item| fill(item, value)).collect(),
        Value::Object(members) => {
            let filled = members.iter().map(|(key, member)| (key.clone(), fill(member, value)));
            Value::Object(filled.collect())
        }
        other => other.clone(),
    }
}

/// Replaces `{name}`. Braces around anything but lower-case letters and `_` stay.
fn fill_text(text: &str, value: &mut dyn FnMut(&str) -> String) -> String {
    let (mut filled, mut rest) = (String::new(), text);
    while let Some((before, after)) = rest.split_once('{') {
        filled += before;
        let is_name = |name: &str| {
            !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_')
        };
        match after.split_once('}') {
            Some((name, behind)) if is_name(name) => {
                filled += &value(name);
                rest = behind;
            }
            _ => {
                filled.push('{');
                rest = after;
            }
        }
    }
    filled + rest
}

#[cfg(test)]
pub(super) mod tests {
    use joulebus_board::AcknowledgedRecord;

    use super::*;

    /// A raise of an alarm of robot 7.
    pub(in crate::webhook) fn raised(alarm: &str) -> AlarmRecord {
        let card = AlarmCard::named(alarm).unwrap();
        AlarmRecord {
            fleet: "lab".to_owned(),
            stamp_ns: 1_764_000_000_250_000_000,
            robot: Some(7),
            alarm: card.name,
            level: card.level.name(),
            change: "raised",
            lasted_s: None,
            acknowledged: None,
            card: Some(card.into()),
        }
    }

    fn acknowledged(by: &str) -> AlarmRecord {
        let row = AcknowledgedRecord { by: by.to_owned(), at_unix_ns: 1 };
        let change = "acknowledged";
        AlarmRecord { change, acknowledged: Some(row), card: None, ..raised("BiasHigh") }
    }

    #[test]
    fn a_message_has_a_line_for_each_change_and_what_an_alarm_means_once() {
        let mut other = raised("BiasHigh");
        other.robot = Some(8);
        let ended = AlarmRecord {
            change: "cleared",
            lasted_s: Some(90.0),
            card: None,
            ..acknowledged("ann")
        };
        let lines = lines(&[raised("BiasHigh"), other, ended], Some("http://page"));
        assert_eq!(lines.len(), 4, "{lines:?}");
        assert_eq!(lines[0], "fleet lab, robot 7: BiasHigh raised (warn) http://page/?robot=7");
        let end = "BiasHigh cleared after 90.0 s, acknowledged by ann http://page/?robot=7";
        assert_eq!(lines[2], format!("fleet lab, robot 7: {end}"));
        assert!(lines[3].starts_with("BiasHigh: The robot draws"), "{lines:?}");
    }

    #[test]
    fn a_name_is_no_markup() {
        let text = slack(&[acknowledged("<!channel> & co")], None)["text"].to_string();
        assert!(text.contains("by &lt;!channel&gt; &amp; co"), "{text}");
        let card = teams(&[acknowledged("[a](http://x)")], Some("http://page"));
        let content = &card["attachments"][0]["content"];
        let run = &content["body"][0]["inlines"][0];
        assert_eq!(run["type"], "TextRun");
        assert!(run["text"].as_str().unwrap().ends_with("by [a](http://x)"), "{run}");
        assert_eq!(content["actions"][0]["url"], "http://page/?robot=7");
    }

    #[test]
    fn a_template_is_json_whatever_its_values_contain() {
        let document = r#"{"{robot}": ["{alarm} {by} {no name} {", 5, null, {"at": "{time}"}]}"#;
        let filled = filled(&template(document).unwrap(), &acknowledged("\"}]{alarm}\\"), None);
        let expected = json!({"{robot}": [
            "BiasHigh \"}]{alarm}\\ {no name} {", 5, null, {"at": "2025-11-24T16:00:00.250Z"},
        ]});
        assert_eq!(filled, expected);
        for name in PLACEHOLDERS {
            let whole = json!(format!("{{{name}}}"));
            assert!(template(&whole.to_string()).is_ok(), "{name}");
        }
    }
}
