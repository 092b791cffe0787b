//! The body of a request: the changes as JSON, with a text for people.

use joulebus_board::AlarmRecord;
use joulebus_plan::report::Lasting;
use serde_json::{Value, json};

/// The body with these changes. Slack and Mattermost show its `text`.
pub(super) fn body(fleet: &str, changes: &[AlarmRecord], page: Option<&str>) -> Value {
    json!({ "fleet": fleet, "text": lines(changes, page).join("\n"), "changes": changes })
}

/// Address of a robot on the page, or of the page.
fn link(page: &str, robot: Option<u32>) -> String {
    robot.map_or_else(|| format!("{page}/"), |robot| format!("{page}/?robot={robot}"))
}

/// The robot or worker that has the alarm.
fn subject(robot: Option<u32>) -> String {
    robot.map_or_else(|| "worker".to_owned(), |robot| format!("robot {robot}"))
}

/// A person's name without characters that are markup or a mention in a chat.
fn plain(name: &str) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || " .,'-".contains(letter);
    name.chars().map(|letter| if is_plain(letter) { letter } else { '?' }).collect()
}

/// A change in one line.
fn line(change: &AlarmRecord) -> String {
    let AlarmRecord { fleet, alarm, change: changed, level, .. } = change;
    let mut line = format!("fleet {fleet}, {}: {alarm} {changed}", subject(change.robot));
    let by = change.acknowledged.as_ref().map(|row| plain(&row.by));
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

#[cfg(test)]
pub(super) mod tests {
    use joulebus_board::AcknowledgedRecord;
    use joulebus_wire::AlarmCard;

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
        AlarmRecord { change, acknowledged: Some(row), card: None, ..raised("LevelHigh") }
    }

    #[test]
    fn a_text_has_a_line_for_each_change_and_what_an_alarm_means_once() {
        let mut other = raised("LevelHigh");
        other.robot = Some(8);
        let ended = AlarmRecord {
            change: "cleared",
            lasted_s: Some(90.0),
            card: None,
            ..acknowledged("ann")
        };
        let lines = lines(&[raised("LevelHigh"), other, ended], Some("http://page"));
        assert_eq!(lines.len(), 4, "{lines:?}");
        assert_eq!(lines[0], "fleet lab, robot 7: LevelHigh raised (warn) http://page/?robot=7");
        let end = "LevelHigh cleared after 90.0 s, acknowledged by ann http://page/?robot=7";
        assert_eq!(lines[2], format!("fleet lab, robot 7: {end}"));
        assert!(lines[3].starts_with("LevelHigh: For the same commands"), "{lines:?}");
    }

    #[test]
    fn a_name_is_neither_markup_nor_a_mention_in_the_text_and_whole_in_the_changes() {
        for (name, shown) in [
            ("<!channel> & co", "??channel? ? co"),
            ("@all", "?all"),
            ("[a](http://x)", "?a??http???x?"),
            ("*ann* `x` ~y~ _z_ |", "?ann? ?x? ?y? ?z? ?"),
            ("Zoë O'Hara-Åberg, jr.", "Zoë O'Hara-Åberg, jr."),
        ] {
            let body = body("lab", &[acknowledged(name)], None);
            assert_eq!(
                body["text"],
                format!("fleet lab, robot 7: LevelHigh acknowledged by {shown}")
            );
            assert_eq!(body["changes"][0]["acknowledged"]["by"], name);
        }
    }

    #[test]
    fn the_cards_of_alarms_have_no_character_that_slack_reads_as_markup() {
        for card in AlarmCard::all() {
            let text = format!("{} {} {}", card.name, card.meaning, card.check);
            assert!(!text.contains(['<', '>', '&', '@']), "{text}");
        }
    }

    #[test]
    fn the_keys_that_cards_name_can_be_configured() {
        for card in AlarmCard::all() {
            for key in card.keys {
                let is_known = joulebus_config::KEYS.iter().any(|known| known.path == *key);
                assert!(is_known, "{}: {key}", card.name);
            }
        }
    }
}
