//! Annotated config files from given values: every key with its comment, as in the shipped files.

use crate::key::{File, Key};
use crate::keys::KEYS;

/// Width of the comments.
const WIDTH: usize = 100;

/// A value for a key of an annotated file.
#[derive(Debug, Clone, PartialEq)]
pub struct Assignment {
    /// The key as in its own file: `tick.rate_hz`, or `rate_hz` in a platform's file.
    pub key: &'static str,
    /// The value as TOML.
    pub value: String,
    /// Its origin, for the comment. May be empty.
    pub note: String,
}

impl Assignment {
    /// A number.
    #[must_use]
    pub fn number(key: &'static str, value: f64, note: impl Into<String>) -> Self {
        // Debug format has a decimal point or an exponent, as a float of TOML needs.
        Self { key, value: format!("{value:?}"), note: note.into() }
    }

    /// A text.
    #[must_use]
    pub fn text(key: &'static str, value: &str, note: impl Into<String>) -> Self {
        Self { key, value: crate::values::quoted(value), note: note.into() }
    }
}

/// A platform's file: `assignments`, and the defaults of all other keys. A battery is left out if
/// none of its keys is assigned. `title` is the first comment.
#[must_use]
pub fn platform_file(title: &str, assignments: &[Assignment]) -> String {
    file(File::Platform, title, assignments)
}

/// A fleet's file with one platform, as [`platform_file`].
#[must_use]
pub fn fleet_file(title: &str, assignments: &[Assignment]) -> String {
    file(File::Fleet, title, assignments)
}

fn file(of: File, title: &str, assignments: &[Assignment]) -> String {
    let mut text = String::new();
    comment(&mut text, title);
    let battery = assignments.iter().any(|one| one.key.starts_with("battery."));
    let mut section = "";
    for key in KEYS.iter().filter(|key| key.file == of) {
        let path = key.path_in_file();
        let own = path.rsplit_once('.').map_or("", |(section, _)| section);
        let given = assignments.iter().find(|one| one.key == path);
        let value = match (given, crate::values::preset(key)) {
            (Some(given), _) => given.value.clone(),
            _ if own == "battery" && !battery => continue,
            (None, Some(value)) => value.to_string(),
            (None, None) => continue,
        };
        if own != section {
            section = own;
            text += &match own {
                "platform" => "\n[[platform]]\n".to_owned(),
                section => format!("\n[{section}]\n"),
            };
        } else {
            text.push('\n');
        }
        described(&mut text, key, given.map_or("", |given| &given.note));
        text += &format!("{} = {value}\n", key.name());
    }
    text
}

fn described(text: &mut String, key: &Key, note: &str) {
    comment(text, key.doc);
    comment(text, &key.facts());
    if !note.is_empty() {
        comment(text, note);
    }
}

/// A comment in lines of at most [`WIDTH`] characters. Control characters would end it.
fn comment(text: &mut String, what: &str) {
    let mut line = String::from("#");
    for word in what.split_whitespace() {
        if line.chars().count() + 1 + word.chars().count() > WIDTH && line.len() > 1 {
            *text += &line;
            text.push('\n');
            line = String::from("#");
        }
        line.push(' ');
        line.extend(word.chars().map(|letter| if letter.is_control() { '?' } else { letter }));
    }
    *text += &line;
    text.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Config;

    #[test]
    fn a_generated_fleet_with_its_platform_is_a_valid_config_with_every_key() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let platform = platform_file(
            "A robot.\nrobots = [7]",
            &[
                Assignment::text("name", "robot", ""),
                Assignment::text("model", "persistence", "Measured."),
                Assignment::number("residual_std_w", 1e-3, "Root mean square."),
                Assignment::number("rate_hz", 30.0, ""),
                Assignment::number("power_min_w", 0.0, ""),
                Assignment::number("power_max_w", 60.0, ""),
                Assignment::number("power_resolution_w", 0.01, ""),
                Assignment::number("v_max_mps", 1.0, ""),
                Assignment::number("omega_max_radps", 2.0, ""),
                Assignment::number("alarms.noise_limit", 9.0, ""),
                Assignment::number("alarms.mismatch_limit", 3.0, ""),
                Assignment::number("alarms.level_limit", 9.0, ""),
                Assignment::text("recordings.map", "time=t", ""),
                Assignment::text("recordings.current", "discharge-negative", ""),
                Assignment::text("recordings.accept", "sign", ""),
                Assignment::number("battery.capacity_wh", 100.0, ""),
                Assignment::number("battery.initial_soc_lo", 0.9, ""),
            ],
        );
        std::fs::write(folder.path().join("robot.toml"), &platform).expect("writable");
        let fleet = fleet_file(
            "A fleet.",
            &[
                Assignment::text("fleet.name", "lab", ""),
                Assignment { key: "fleet.capacity", value: "10".to_owned(), note: String::new() },
                Assignment::text("platform.file", "robot.toml", ""),
                Assignment {
                    key: "platform.robots",
                    value: "[\"0-9\"]".to_owned(),
                    note: String::new(),
                },
            ],
        );
        let path = folder.path().join("fleet.toml");
        std::fs::write(&path, &fleet).expect("writable");
        let config = Config::load(&path).unwrap_or_else(|error| panic!("{error}\n{platform}"));
        let robot = &config.settings().platforms[0];
        assert_eq!(robot.power_max_w, 60.0);
        assert_eq!(robot.alarms.map(|limits| limits.noise_limit), Some(9.0));
        assert!(config.warnings().is_empty(), "{:?}", config.warnings());
        // The rate replaces another key, and has no default.
        for key in KEYS.iter().filter(|key| key.path != crate::consistency::LEVEL_RATE) {
            let text = if key.file == File::Fleet { &fleet } else { &platform };
            assert!(text.contains(&format!("\n{} = ", key.name())), "{}", key.path);
        }
        let widest = fleet.lines().chain(platform.lines()).map(|line| line.chars().count()).max();
        assert!(widest <= Some(WIDTH + 20), "{widest:?}");
    }
}
