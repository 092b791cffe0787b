//! `joulebus alarms --acknowledge`: a person takes notice of an alarm.

use std::fmt;
use std::time::Duration;

use joulebus_planner::PlanClient;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;
use joulebus_wire::{Acknowledgement, Alarm, AlarmCard, MAX_NAME_BYTES};
use serde::Serialize;

use super::Args;
use crate::ask::refused;

/// Timeout of an answer of the worker.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// The acknowledgement that the worker has taken.
#[derive(Debug, Serialize)]
struct Taken {
    fleet: String,
    robot: u32,
    alarm: &'static str,
    by: String,
    new_normal: bool,
}

pub(super) fn run(args: &Args, of: &[String], output: Output) -> anyhow::Result<Outcome> {
    let [robot, alarm] = of else {
        return Err(UsageError("--acknowledge takes a robot and an alarm".to_owned()).into());
    };
    let robot: u32 = robot.parse().map_err(|_| {
        UsageError(format!("{robot:?} is no id of a robot, allowed: 0 to {}", u32::MAX))
    })?;
    let alarm = alarm_named(alarm)?;
    let by = person(args.by.as_deref())?;
    if args.new_normal && !alarm.is_of_level() {
        let text = format!(
            "{} cannot be the new normal, allowed: LevelHigh, LevelLow. Acknowledge it without \
             --new-normal",
            alarm.name()
        );
        return Err(UsageError(text).into());
    }
    let config = args.config.load()?;
    let mut client = PlanClient::with_config(&config, "acknowledge")?;
    let new_normal = args.new_normal;
    let taken = client.acknowledge(robot, alarm, &by, new_normal, ANSWER_TIMEOUT);
    taken.map_err(|error| refused(error, &config))?;
    let (fleet, alarm) = (config.fleet().to_owned(), alarm.name());
    output.report(&Taken { fleet, robot, alarm, by, new_normal })?;
    Ok(Outcome::Done)
}

/// The alarm of a robot that is named so, in any case.
fn alarm_named(name: &str) -> Result<Alarm, UsageError> {
    let mut all = Alarm::ALL.into_iter();
    let found = all.find(|alarm| alarm.name().eq_ignore_ascii_case(name));
    found.ok_or_else(|| {
        if AlarmCard::named(name).is_some() {
            return UsageError(format!(
                "{name} cannot be acknowledged: no worker could take the acknowledgement"
            ));
        }
        let names = Alarm::ALL.map(Alarm::name).join(", ");
        UsageError(format!("there is no alarm {name:?} of a robot, allowed: {names}"))
    })
}

/// Name of the person who acknowledges or states: as given, or the user.
pub(crate) fn person(by: Option<&str>) -> Result<String, UsageError> {
    let variables = ["USER", "LOGNAME"].into_iter();
    let user =
        || variables.filter_map(|name| std::env::var(name).ok()).find(|user| !user.is_empty());
    let by = by.map(str::to_owned).or_else(user);
    let by = by.ok_or_else(|| {
        UsageError("the environment has no USER: say who with --by NAME".to_owned())
    })?;
    if Acknowledgement::new(0, Alarm::NoData, 0, &by).is_none() {
        let text = format!(
            "--by {by:?}: allowed are 1 to {MAX_NAME_BYTES} bytes without control characters"
        );
        return Err(UsageError(text));
    }
    Ok(by)
}

impl fmt::Display for Taken {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { robot, alarm, by, new_normal, .. } = self;
        let how = if *new_normal { " as the new normal" } else { "" };
        writeln!(out, "robot {robot}: {alarm} acknowledged{how} by {by}")
    }
}
