//! The verbs and global options.

use clap::{CommandFactory as _, Parser, Subcommand};
use joulebus_program::described::Verb;
use joulebus_program::options::GlobalOptions;

use crate::{
    alarms, ask, completions, config, demo, doctor, external, info, man, new, publish, record,
    recover, replay, run, watch,
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

/// What to do. Verbs without arguments here are other programs' ([`external`]).
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
    Ask(ask::Args),
    Info(info::Args),
    Cat,
    Recover(recover::Args),
    Serve,
    Bridge,
    Link,
    Import,
    Data,
    Export,
    Doctor(doctor::Args),
    Config(config::Args),
    Train,
    Analyze,
    Eval,
    Calibrate,
    Report,
    Model,
    Bench,
    Mission,
    Completions(completions::Args),
    Man(man::Args),
}

/// The verbs by what they are for, in the order of the help.
const GROUPS: [(&str, &[&str]); 6] = [
    ("To begin", &["demo", "new", "config", "doctor"]),
    ("A running fleet", &["run", "publish", "bridge", "link"]),
    ("What to know of it", &["watch", "ask", "alarms", "serve"]),
    ("Captures", &["record", "replay", "info", "cat", "recover", "import", "export"]),
    (
        "Models and data",
        &["data", "train", "eval", "analyze", "calibrate", "report", "model", "mission"],
    ),
    ("This program", &["bench", "completions", "man", "help"]),
];

/// Columns of a line of the help.
const COLUMNS: usize = 98;

/// The whole parser, with the verbs of other programs.
pub(crate) fn command() -> clap::Command {
    let command = Verb::complete(external::verbs(), Cli::command());
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
    use std::fmt::Write as _;

    use joulebus_testkit::assert_page_contains;

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
            let help = verb.get_after_help().map(ToString::to_string);
            let help = help.unwrap_or_default();
            assert!(help.contains("joulebus"), "{}: {help:?}", verb.get_name());
        }
    }

    /// Text that has no tags of HTML outside of inline code.
    fn escaped(text: &str) -> String {
        let parts = text.split('`').enumerate().map(|(number, part)| match number % 2 {
            0 => part.replace('<', "\\<"),
            _ => part.to_owned(),
        });
        parts.collect::<Vec<_>>().join("`")
    }

    /// The text after a verb's options: examples as they are, sentences as paragraphs.
    fn paragraphs(help: &str) -> String {
        let parts = help.trim_end().split("\n\n").map(|part| match part.contains("\n  ") {
            true => format!("\n```text\n{}\n```\n", part.trim_end()),
            false => format!("\n{}\n", escaped(part.trim()).replace('\n', "\n\n")),
        });
        parts.collect()
    }

    /// A table of the options or arguments of a verb, or nothing if there are none.
    fn table(verb: &clap::Command) -> String {
        let mut rows = String::new();
        let is_global =
            |option: &clap::Arg| option.is_global_set() && verb.get_name() != "joulebus";
        let is_of_clap =
            |option: &clap::Arg| ["help", "version"].contains(&option.get_id().as_str());
        for option in verb.get_arguments() {
            if option.is_hide_set() || is_global(option) || is_of_clap(option) {
                continue;
            }
            let help = option.get_long_help().or(option.get_help());
            let mut help = escaped(&help.map(ToString::to_string).unwrap_or_default());
            for value in option.get_possible_values().iter().filter(|value| !value.is_hide_set()) {
                match (option.get_action().takes_values(), value.get_help()) {
                    (false, _) => {}
                    (true, Some(about)) => {
                        let about = escaped(&about.to_string());
                        write!(help, "<br>`{}`: {about}", value.get_name()).unwrap();
                    }
                    (true, None) => write!(help, "<br>`{}`", value.get_name()).unwrap(),
                }
            }
            let defaults = option.get_default_values().iter();
            let defaults: Vec<_> = defaults.map(|value| value.display().to_string()).collect();
            let takes_value =
                option.get_action().takes_values() && !option.is_hide_default_value_set();
            let default = match defaults.join(" ") {
                default if takes_value && !default.is_empty() => format!("`{default}`"),
                _ if option.is_required_set() => "required".to_owned(),
                _ => String::new(),
            };
            let help = help.replace("\n\n", "<br>").replace('\n', " ").replace('|', "\\|");
            let short = option.get_short().filter(|_| option.get_long().is_some());
            let short = short.map(|short| format!("`-{short}`, ")).unwrap_or_default();
            let option = option.to_string().replace('|', "\\|");
            writeln!(rows, "| {short}`{option}` | {help} | {default} |").unwrap();
        }
        match rows.is_empty() {
            true => rows,
            false => format!("\n| option | meaning | default |\n|---|---|---|\n{rows}"),
        }
    }

    /// `JOULEBUS_WRITE=1 cargo test -p joulebus --lib every_option` writes the page.
    #[test]
    fn the_page_about_the_command_line_has_every_option() {
        let mut program = command();
        program.build();
        let mut text = format!("\n## Options of every verb\n{}", table(&program));
        let shown = |verb: &clap::Command| -> Vec<clap::Command> {
            let shown = verb.get_subcommands().filter(|verb| !verb.is_hide_set());
            shown.filter(|verb| verb.get_name() != "help").cloned().collect()
        };
        let mut verbs = shown(&program);
        verbs.reverse();
        while let Some(mut verb) = verbs.pop() {
            let within = shown(&verb);
            verbs.extend(within.into_iter().rev());
            let name = verb.get_bin_name().unwrap_or_else(|| verb.get_name()).to_owned();
            let about = verb.get_long_about().or(verb.get_about());
            let about = about.map(ToString::to_string).unwrap_or_default();
            let usage = verb.render_usage().to_string();
            let usage = usage.trim_start_matches("Usage: ").trim();
            let help = verb.get_after_help().map(ToString::to_string).unwrap_or_default();
            let (about, help) = (escaped(&about), paragraphs(&help));
            let table = table(&verb);
            write!(text, "\n## `{name}`\n\n{about}\n\n```text\n{usage}\n```\n{table}{help}")
                .unwrap();
        }
        text.push('\n');
        assert_page_contains("docs/reference/commands.md", "<!-- verbs", &text);
    }
}
