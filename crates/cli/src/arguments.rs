//! The verbs and global options.

use clap::{Parser, Subcommand};
use joulebus_program::options::GlobalOptions;
use joulebus_program::verbs::bench::BenchArguments;
use joulebus_program::verbs::bridge::BridgeArguments;
use joulebus_program::verbs::export::ExportArguments;
use joulebus_program::verbs::link::LinkArguments;
use joulebus_program::verbs::mission::MissionArguments;
use joulebus_program::verbs::report::ReportArguments;
use joulebus_program::verbs::serve::ServeArguments;

use crate::{
    alarms, analyze, ask, calibrate, cat, completions, config, data, demo, doctor, eval, import,
    info, man, model, publish, record, recover, replay, run, train, watch,
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
        joulebus record -o run.mcap                 record everything into a file\n  \
        joulebus doctor                             diagnose problems\n\n\
        Results go to stdout, the rest to stderr. Units are SI and stand in the names: power_w, \
        stamp_ns.\n\
        Exit codes: 0 done; 1 failed; 2 wrong usage or config; 3 finished, but data was lost or \
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
    Run(run::Args),
    Publish(publish::Args),
    Record(record::Args),
    Replay(replay::Args),
    Watch(watch::Args),
    Alarms(alarms::Args),
    Ask(ask::Args),
    Info(info::Args),
    Cat(cat::Args),
    Recover(recover::Args),
    Serve(ServeArguments),
    Bridge(BridgeArguments),
    Link(LinkArguments),
    Import(import::Args),
    Data(data::Args),
    Export(ExportArguments),
    Doctor(doctor::Args),
    Config(config::Args),
    Train(train::Args),
    Analyze(analyze::Args),
    Eval(eval::Args),
    Calibrate(calibrate::Args),
    Report(ReportArguments),
    Model(model::Args),
    Bench(BenchArguments),
    Mission(MissionArguments),
    Completions(completions::Args),
    Man(man::Args),
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::Cli;

    #[test]
    fn the_arguments_do_not_contradict_each_other() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_verb_shows_examples() {
        let mut verbs = vec![Cli::command()];
        while let Some(verb) = verbs.pop() {
            let shown = verb.get_subcommands().filter(|verb| !verb.is_hide_set());
            verbs.extend(shown.cloned());
            let help = verb.get_after_help().map(ToString::to_string);
            let help = help.unwrap_or_default();
            assert!(help.contains("joulebus"), "{}: {help:?}", verb.get_name());
        }
    }
}
