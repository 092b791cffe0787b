//! The usual mappings: what `joulebus bridge ros2` and `joulebus bridge mqtt` do without a file.
//! They are the shipped files, with other robots and another broker.

use std::path::Path;

use anyhow::anyhow;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::file::write;
use joulebus_program::output::{self, log_line};
use joulebus_program::shell::word;
use toml::Value;

use crate::arguments::BridgeArguments;

const ROS2: &str = include_str!("../configs/ros2.toml");
const MQTT: &str = include_str!("../configs/mqtt.toml");

/// The mapping of a call without a file. `None` if it names one.
///
/// # Errors
/// [`UsageError`]: options that only a usual mapping has, or none of its robots.
pub(crate) fn mapping(args: &BridgeArguments) -> Result<Option<String>, UsageError> {
    let shipped = match args.file.to_str() {
        Some("ros2") => ROS2,
        Some("mqtt") => MQTT,
        _ if args.robots.is_empty() && args.broker.is_none() && args.write.is_none() => {
            return Ok(None);
        }
        _ => {
            let why = "--robots, --broker and --write belong to `joulebus bridge ros2` and `mqtt`: \
                       a file names robots and broker itself";
            return Err(UsageError(why.to_owned()));
        }
    };
    if args.robots.is_empty() {
        let why = "which robots? --robots 'robot{id}=0-9' names robot0 to robot9, with these ids";
        return Err(UsageError(why.to_owned()));
    }
    if args.broker.is_some() && shipped == ROS2 {
        return Err(UsageError("ROS 2 has no broker: leave --broker out".to_owned()));
    }
    let mut robots = String::new();
    for given in &args.robots {
        let Some((name, ids)) = given.rsplit_once('=') else {
            let why =
                format!("--robots {given}: allowed is NAME=IDS, as 'robot{{id}}=0-9' or lifter=12");
            return Err(UsageError(why));
        };
        robots += &format!("{} = {}\n", quoted(name), quoted(ids));
    }
    let lines = shipped.lines().map(|line| match line.split(" = ").next() {
        Some("\"robot{id}\"") => robots.clone(),
        Some("broker") => match &args.broker {
            Some(broker) => format!("broker = {}\n", quoted(broker)),
            None => format!("{line}\n"),
        },
        _ => format!("{line}\n"),
    });
    Ok(Some(lines.collect()))
}

/// A text in TOML.
fn quoted(text: &str) -> String {
    Value::String(text.to_owned()).to_string()
}

/// Prints a mapping to stderr, without its comments.
pub(crate) fn print(mapping: &str) {
    log_line("the usual mapping, which --write FILE writes, to be changed:");
    for line in mapping.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        log_line(&format!("  {line}"));
    }
}

/// Writes a mapping as a new file.
///
/// # Errors
/// There is such a file, or it cannot be written.
pub(crate) fn write_new(mapping: &str, path: &Path) -> anyhow::Result<Outcome> {
    let shown = path.display();
    if path.symlink_metadata().is_ok() {
        return Err(anyhow!("{shown} is there already: name a new file"));
    }
    let command = format!("joulebus bridge {}", word(path));
    let mapping = mapping.replace("joulebus bridge configs/bridges/ros2.toml", &command);
    write(path, mapping.as_bytes())?;
    output::text(&command)?;
    Ok(Outcome::Done)
}
