//! The `joulebus` program as a library, so that other packages can build the same program.
//!
//! Heavy verbs are separate programs, `joulebus-VERB`, which this one executes; `joulebus_program`
//! has the code shared by all programs.
#![forbid(unsafe_code)]

mod alarms;
mod analyze;
mod arguments;
mod ask;
mod calibrate;
mod cat;
mod completions;
mod config;
mod data;
mod demo;
mod doctor;
mod eval;
mod external;
mod import;
mod info;
mod keys;
mod man;
mod model;
mod next_command;
mod publish;
mod record;
mod recordings;
mod recover;
mod replay;
mod run;
mod service_manager;
mod split_unit;
mod supervisor;
mod train;
mod trials;
mod utc;
mod view;
mod watch;

use std::process::ExitCode;

use clap::{Args as _, CommandFactory as _, FromArgMatches as _, Parser as _};
use joulebus_program::exit::{self, Outcome};
use joulebus_program::output::Output;

use arguments::{Cli, Command};

/// Runs the program with the arguments of this process.
#[must_use]
pub fn main() -> ExitCode {
    match parse() {
        Ok((command, output)) => exit::code(execute(&command, output)),
        Err(refused) => exit::refused(&refused),
    }
}

fn parse() -> Result<(Command, Output), clap::Error> {
    let cli = Cli::try_parse()?;
    let command = match cli.command {
        Some(command) => command,
        None => Command::Demo(default_demo()?),
    };
    let has_rows = matches!(command, Command::Cat(_));
    Ok((command, cli.options.start(has_rows)?))
}

/// `demo` with default options.
fn default_demo() -> Result<demo::Args, clap::Error> {
    let parser = demo::Args::augment_args(clap::Command::new("demo"));
    demo::Args::from_arg_matches(&parser.try_get_matches_from(["demo"])?)
}

fn execute(command: &Command, output: Output) -> anyhow::Result<Outcome> {
    match command {
        Command::Demo(args) => demo::run(args, output),
        Command::Run(args) => run::run(args, output),
        Command::Publish(args) => publish::run(args, output),
        Command::Record(args) => record::run(args, output),
        Command::Replay(args) => replay::run(args, output),
        Command::Watch(args) => watch::run(args, output),
        Command::Alarms(args) => alarms::run(args, output),
        Command::Ask(args) => ask::run(args, output),
        Command::Info(args) => info::run(args, output),
        Command::Cat(args) => cat::run(args, output),
        Command::Recover(args) => recover::run(args, output),
        Command::Serve(_) => external::run("serve"),
        Command::Bridge(_) => external::run("bridge"),
        Command::Link(_) => external::run("link"),
        Command::Import(args) => import::run(args, output),
        Command::Data(args) => data::run(args, output),
        Command::Export(_) => external::run("export"),
        Command::Doctor(args) => doctor::run(args, output),
        Command::Config(args) => config::run(args, output),
        Command::Train(args) => train::run(args, output),
        Command::Analyze(args) => analyze::run(args, output),
        Command::Eval(args) => eval::run(args, output),
        Command::Calibrate(args) => calibrate::run(args, output),
        Command::Report(_) => external::run("report"),
        Command::Model(args) => model::run(args, output),
        Command::Bench(_) => external::run("bench"),
        Command::Mission(_) => external::run("mission"),
        Command::Completions(args) => completions::run(args, Cli::command()),
        Command::Man(args) => man::run(args, Cli::command()),
    }
}
