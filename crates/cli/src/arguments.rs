//! The verbs and global options.

use clap::{CommandFactory as _, Parser, Subcommand};
use joulebus_program::described::Verb;
use joulebus_program::options::GlobalOptions;

use crate::{
    alarms, ask, battery, completions, config, demo, doctor, external, info, man, new, publish,
    record, recover, replay, run, status, watch,
};

/// Power forecasts for robot fleets over shared memory: one worker, any number of sources and
/// planners, one host.
///
/// Without a verb: `demo`, a complete simulated fleet.
#[derive(Debug, Parser)]
#[command(
    name = "joulebus",
    version,
    after_help = "Examples:\n  \
        joulebus                                    20 simulated robots, worker, planner, 20 s\n  \
        joulebus run --config configs/fleet.toml    the worker\n  \
        joulebus publish sim --robots 20            a simulated fleet for it\n  \
        joulebus watch                              the forecasts, live\n  \
        joulebus new controller my-controller       a program of your own for it\n  \
        joulebus record -o run.mcap                 record everything into a file\n  \
        joulebus doctor                             diagnose problems\n\n\
        Results go to stdout, the rest to stderr. Units are SI and stand in the names: power_w, \
        stamp_ns.\n\
        Exit codes: 0 done, 1 failed, 2 wrong usage or config, 3 finished, but data was lost or \
        differs.\n\
        JOULEBUS_LOG sets the log level, like RUST_LOG: JOULEBUS_LOG=debug."
)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) options: GlobalOptions,
    #[command(subcommand)]
    pub(crate) command: Option<Command>,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Demo(demo::Args),
    New(new::Args),
    Run(run::Args),
    Publish(publish::Args),
    Record(record::Args),
    Replay(replay::Args),
    Watch(watch::Args),
    Alarms(alarms::Args),
    Battery(battery::Args),
    Ask(ask::Args),
    Info(info::Args),
    Recover(recover::Args),
    /// Show a fleet to people and programs: a page, a JSON API and metrics, and alarms as webhooks
    Serve(external::Args),
    /// Bring robots that speak MQTT or ROS 2 into a fleet, and tell others its forecasts, budgets
    /// and alarms
    Bridge(external::Args),
    /// Join a fleet over several hosts: samples of robots elsewhere, forecasts for planners
    /// elsewhere
    Link(external::Args),
    /// Import recordings (bags of rosbag2, our captures, .npy, .csv, .csv.gz) as datasets or as a
    /// capture
    Import(external::Args),
    /// Describe recorded trials, check them, convert them, and write simulated ones
    Data(external::Args),
    Status(status::Args),
    Doctor(doctor::Args),
    Config(config::Args),
    /// Train a model
    Train(external::Args),
    /// Analyse a dataset: autocorrelation, the gain of each input, and the share of a score that
    /// comes from held readings
    Analyze(external::Args),
    /// Evaluate recorded trials offline: the same bits as playing them live, compared with the
    /// baselines
    Eval(external::Args),
    /// Report what recordings say of energy and battery, and the accuracy of models
    Report(external::Args),
    /// Inspect, import, export and compare model files
    Model(external::Args),
    /// Measure the speed of this machine
    Bench(external::Args),
    /// Simulate missions under several charging policies, to see what energy forecasts are worth
    Mission(external::Args),
    Completions(completions::Args),
    Man(man::Args),
}

/// The verbs by what they are for, in the order of the help.
const GROUPS: [(&str, &[&str]); 6] = [
    ("To begin", &["demo", "new", "config", "doctor"]),
    ("A running fleet", &["run", "publish", "bridge", "link"]),
    ("What to know of it", &["status", "watch", "ask", "battery", "alarms", "serve"]),
    ("Captures", &["record", "replay", "info", "recover", "import"]),
    ("Models and data", &["data", "train", "eval", "analyze", "report", "model", "mission"]),
    ("This program", &["bench", "completions", "man", "help"]),
];

/// Columns of a line of the help.
const COLUMNS: usize = 98;

/// The parser with the verbs of other programs, which are there to be completed and listed.
pub(crate) fn whole() -> clap::Command {
    Verb::complete(external::verbs(), command())
}

/// The parser. Other programs parse the arguments of their verbs.
pub(crate) fn command() -> clap::Command {
    let command = Cli::command();
    let list = listed(&command);
    command.help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\nCommands:\n{list}\nOptions:\n{{options}}{{after-help}}"
    ))
}

/// The verbs in their groups, each with what it does.
fn listed(command: &clap::Command) -> String {
    let mut list = String::new();
    for (title, names) in GROUPS {
        list.push_str(&format!("\n{title}\n"));
        for name in names {
            let verb = command.find_subcommand(name);
            let about = verb.and_then(clap::Command::get_about).map(ToString::to_string);
            let about = about.unwrap_or_else(|| "Show the help of a verb: `help VERB`".to_owned());
            let mut line = format!("  {name:<11}");
            for word in about.split_whitespace() {
                if line.chars().count() + 1 + word.chars().count() > COLUMNS {
                    list.push_str(&line);
                    line = format!("\n{:13}", "");
                }
                line.push(' ');
                line.push_str(word);
            }
            list.push_str(&line);
            list.push('\n');
        }
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arguments_do_not_contradict_each_other() {
        command().debug_assert();
    }

    #[test]
    fn every_verb_is_in_one_group_of_the_help() {
        let of_groups = GROUPS.iter().flat_map(|(_, names)| names.iter().copied());
        let mut listed: Vec<&str> = of_groups.filter(|name| *name != "help").collect();
        listed.sort_unstable();
        let command = Cli::command();
        let shown = command.get_subcommands().filter(|verb| !verb.is_hide_set());
        let mut names: Vec<&str> = shown.map(clap::Command::get_name).collect();
        names.sort_unstable();
        assert_eq!(listed, names);
    }

    #[test]
    fn every_verb_shows_examples() {
        let mut verbs = vec![command()];
        while let Some(verb) = verbs.pop() {
            let shown = verb.get_subcommands().filter(|verb| !verb.is_hide_set());
            verbs.extend(shown.cloned());
            if verb.is_disable_help_flag_set() {
                // Another program has it.
                continue;
            }
            let help = verb.get_after_help().map(ToString::to_string);
            let help = help.unwrap_or_default();
            assert!(help.contains("joulebus"), "{}: {help:?}", verb.get_name());
        }
    }
}
