//! The effective config as a file.

use std::fmt::Write as _;

use crate::consistency::level_limit_by_rate;
use crate::document::FleetFile;
use crate::files;
use crate::key::Key;
use crate::keys::KEYS;
use crate::model_source::ModelSource;
use crate::values::{Location, Value, Values};

/// Every key with its value and origin, as a valid config file.
pub(crate) fn toml(read: &FleetFile) -> String {
    let mut text =
        "# The effective config: every key, with where its value comes from.\n".to_owned();
    let mut section = "";
    for key in KEYS.iter().filter(|key| !key.path.starts_with("platform.")) {
        let of_key = section_of(key);
        if of_key != section {
            section = of_key;
            // Writing to a String cannot fail, here and below.
            let _ = writeln!(text, "\n[{section}]");
        }
        line(&mut text, &read.values, key);
    }
    for values in read.platforms.iter().map(|listed| &listed.values) {
        text += "\n[[platform]]\n";
        let mut section = "platform.";
        for key in keys_of(values).filter(|key| key.path != "platform.file") {
            let of_key = key.path.trim_end_matches(key.name());
            if of_key != section {
                section = of_key;
                let _ = writeln!(text, "\n[{}]", section.trim_end_matches('.'));
            }
            line(&mut text, values, key);
        }
    }
    text
}

/// The keys of a platform, without those of sections that it does not have.
fn keys_of(values: &Values) -> impl Iterator<Item = &'static Key> {
    let given = |section: &str| values.names_any(section);
    let sections = ["platform.battery.", "platform.alarms.", "platform.recordings."];
    let sections = sections.map(|section| (section, given(section)));
    KEYS.iter().filter(move |key| {
        let mut own = sections.iter();
        let own = own.find(|(section, _)| key.path.starts_with(section));
        own.map_or(key.path.starts_with("platform."), |(_, given)| *given)
    })
}

fn section_of(key: &Key) -> &'static str {
    key.path.split('.').next().unwrap_or(key.path)
}

fn line(text: &mut String, values: &Values, key: &Key) {
    let location = values
        .location(key.path)
        .map_or_else(|| "default".to_owned(), Location::to_string)
        // A control character in a file's name would end the comment.
        .replace(char::is_control, "?");
    let _ = match resolved(values, key) {
        Some(value) => writeln!(text, "{} = {value} # {location}", key.name()),
        None => writeln!(text, "# {} is not set", key.name()),
    };
}

/// The value in force, with paths made independent of the file that contains them.
fn resolved(values: &Values, key: &Key) -> Option<Value> {
    let path = match key.path {
        "domain.root" => files::root(&values.text(key.path)?),
        "ledger.checkpoint" => match values.text(key.path)?.as_str() {
            "auto" => return values.get(key.path),
            _ => files::resolve(values, key.path)?,
        },
        "platform.model" => match files::model(values, None)? {
            ModelSource::File(path) => path,
            _ => return values.get(key.path),
        },
        // The one that is in force.
        "alarms.level_limit" => {
            let chosen = level_limit_by_rate(values);
            return chosen
                .map(|limit| Value::Number(limit.into()))
                .or_else(|| values.get(key.path));
        }
        _ => return values.get(key.path),
    };
    if path.as_os_str().is_empty() {
        return values.get(key.path);
    }
    // Without a current directory the path is left unchanged.
    let path = std::path::absolute(&path).unwrap_or(path);
    Some(Value::Text(path.to_string_lossy().into_owned()))
}
