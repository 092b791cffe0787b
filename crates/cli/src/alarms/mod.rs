//! `joulebus alarms`: each raise and each end of an alarm, live or in a capture.

mod acknowledge;
mod captured;
mod command;
mod explain;
mod live;
mod log;

use std::fmt;
use std::path::PathBuf;

use joulebus_board::AlarmRecord;
use joulebus_plan::report::Lasting;
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::Outcome;
use joulebus_program::output::Output;
use serde::Serialize;

use joulebus_program::utc::Utc;

pub(crate) use acknowledge::person;
pub(crate) use log::{AlarmLog, AlarmReport};

/// Show each raise and each end of an alarm, with its duration: of a running fleet, or of captures
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus alarms                                   of the running fleet, until Ctrl-C\n  \
    joulebus alarms --format json | jq .alarm\n  \
    joulebus alarms run.mcap                          history of a capture\n  \
    joulebus alarms --explain LevelHigh               what it means and what to check\n  \
    joulebus alarms --acknowledge 7 LevelHigh --by ann\n  \
    joulebus alarms --acknowledge 7 LevelHigh --new-normal    the load stays: compare with it\n  \
    joulebus alarms --on-alarm 'logger \"$JOULEBUS_ALARM of robot $JOULEBUS_ROBOT $JOULEBUS_CHANGE\"'\n\n\
    Live, each change is one line, or one object with --format json. WorkerGone and WorkerStale \
    are alarms of the worker itself. Alarms that are already raised at the start are shown with the \
    time at which they were raised. On a host that a link joins that time is not known, and they \
    are shown as raised at the start.\n\
    An acknowledgement lasts until the alarm ends. If the alarm returns, it is raised again. \
    With --new-normal an alarm of the robot's own level ends within a tick: the robot learns its \
    level anew, and a further change is found after some three seconds. \
    WorkerGone and WorkerStale cannot be acknowledged, because no worker could take the \
    acknowledgement.\n\
    --on-alarm runs its command with `sh -c` for each change, one after the other, each for at \
    most 10 s. The command gets the variables JOULEBUS_FLEET, JOULEBUS_ROBOT (empty for the \
    worker), JOULEBUS_ALARM, JOULEBUS_LEVEL (ok, \
    warn, error, stale), JOULEBUS_CHANGE (raised, acknowledged, cleared, left), JOULEBUS_STAMP_NS \
    (Unix time), JOULEBUS_LASTED_S (empty while raised), JOULEBUS_BY (who acknowledged it). At \
    most 256 changes wait, and 256 acknowledgements, which let the others pass. The command is not \
    run for further ones, and they are counted.\n\
    Exit code 1: nothing of a file can be read, or an acknowledgement was not taken. Exit code 3: \
    ticks were missed, a file is damaged, or a command was not run or failed.")]
pub(crate) struct Args {
    /// Captures [default: the running fleet]
    #[arg(value_name = "FILE", conflicts_with_all = ["config", "on_alarm", "duration", "explain", "acknowledge"])]
    files: Vec<PathBuf>,
    #[command(flatten)]
    config: ConfigFile,
    /// Run this command for each change
    #[arg(long, value_name = "COMMAND")]
    on_alarm: Option<String>,
    /// End after this time, s
    #[arg(long, value_name = "S", value_parser = crate::alarms::seconds)]
    duration: Option<f64>,
    /// Say what an alarm means, what to check and which keys set it [default: of all alarms]
    #[arg(long, value_name = "ALARM", num_args = 0..=1, default_missing_value = explain::ALL,
          conflicts_with_all = ["config", "on_alarm", "duration"])]
    explain: Option<String>,
    /// Acknowledge a raised alarm of a robot, until it ends
    #[arg(long, num_args = 2, value_names = ["ROBOT", "ALARM"],
          conflicts_with_all = ["on_alarm", "duration", "explain"])]
    acknowledge: Option<Vec<String>>,
    /// Who acknowledges it [default: the user's name, from the environment]
    #[arg(long, value_name = "NAME", requires = "acknowledge")]
    by: Option<String>,
    /// The power is the robot's new normal, as with a payload: LevelHigh or LevelLow ends
    #[arg(long, requires = "acknowledge")]
    new_normal: bool,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    if let Some(name) = &args.explain {
        explain::run(name, output)
    } else if let Some(of) = &args.acknowledge {
        acknowledge::run(args, of, output)
    } else if args.files.is_empty() {
        live::run(args, output)
    } else {
        captured::run(&args.files, output)
    }
}

/// A time after which something ends, s.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if 0.0 < seconds && seconds <= 1e9 => Ok(seconds),
        _ => Err(format!("{text} is not a time, allowed is 0 to 1e9 s")),
    }
}

/// Time in s of a difference in ns.
fn s_between(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}

/// One change, for stdout and for the command.
#[derive(Debug, Clone, Serialize)]
#[serde(transparent)]
struct Line(AlarmRecord);

impl fmt::Display for Line {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Utc { hour, minute, second, millisecond, .. } = Utc::new(self.0.stamp_ns);
        write!(out, "{hour:02}:{minute:02}:{second:02}.{millisecond:03}Z ")?;
        match self.0.robot {
            Some(robot) => write!(out, "robot {robot}: ")?,
            None => write!(out, "worker: ")?,
        }
        write!(out, "{} {}", self.0.alarm, self.0.change)?;
        let by = self.0.acknowledged.as_ref().map(|acknowledgement| &acknowledgement.by);
        match (self.0.lasted_s, by) {
            (None, None) => write!(out, " ({})", self.0.level),
            (None, Some(by)) => write!(out, " by {by}"),
            (Some(lasted_s), None) => write!(out, " after {}", Lasting(lasted_s)),
            (Some(lasted_s), Some(by)) => {
                write!(out, " after {}, acknowledged by {by}", Lasting(lasted_s))
            }
        }
    }
}
