//! The program `joulebus-lab`: the verbs that work on recordings and models, without a fleet.
//! `joulebus VERB` runs it, so that the main program needs none of their code.
//!
//! Only `publish trial` joins a fleet: it is a source like any other, whose samples come from
//! recordings.
#![forbid(unsafe_code)]

mod analyze;
mod config_init;
mod data;
mod design;
mod eval;
mod import;
mod judgement;
mod mission;
mod model;
mod next_command;
mod publish_trial;
mod recordings;
mod references;
mod report;
mod split_unit;
mod train;
mod trials;

use std::process::ExitCode;

use clap::{CommandFactory as _, Parser, Subcommand};
use joulebus_program::described;
use joulebus_program::exit::{self, Outcome};
use joulebus_program::options::GlobalOptions;
use joulebus_program::output::Output;

/// The verbs of joulebus that work on recordings and models (`joulebus VERB` runs them)
#[derive(Debug, Parser)]
#[command(
    name = "joulebus",
    bin_name = "joulebus",
    version,
    after_help = "Examples:\n  joulebus eval recordings/ --model my.safetensors\n  joulebus help eval"
)]
struct Cli {
    #[command(flatten)]
    options: GlobalOptions,
    #[command(subcommand)]
    command: Command,
}

/// The verb to run.
#[derive(Debug, Subcommand)]
enum Command {
    Import(import::Args),
    Data(data::Args),
    Train(train::Args),
    Analyze(analyze::Args),
    Eval(eval::Args),
    Report(report::Args),
    Model(model::Args),
    Mission(mission::Args),
    /// Publish samples of recorded trials
    #[command(subcommand)]
    Publish(Publish),
    /// Make configs from recordings
    #[command(subcommand)]
    Config(Config),
}

/// The parts of `joulebus publish` in this program.
#[derive(Debug, Subcommand)]
enum Publish {
    Trial(publish_trial::Args),
}

/// The parts of `joulebus config` in this program.
#[derive(Debug, Subcommand)]
enum Config {
    Init(config_init::Args),
}

fn main() -> ExitCode {
    let verbs = || Cli::command().get_subcommands().cloned().collect();
    if let Some(answered) = described::answer(verbs) {
        return answered;
    }
    joulebus_bus::trace_iceoryx2();
    match parse() {
        Ok((command, output)) => exit::code(execute(&command, output)),
        Err(refused) => exit::refused(&refused),
    }
}

fn parse() -> Result<(Command, Output), clap::Error> {
    let cli = Cli::try_parse()?;
    Ok((cli.command, cli.options.start()?))
}

fn execute(command: &Command, output: Output) -> anyhow::Result<Outcome> {
    match command {
        Command::Import(args) => import::run(args, output),
        Command::Data(args) => data::run(args, output),
        Command::Train(args) => train::run(args, output),
        Command::Analyze(args) => analyze::run(args, output),
        Command::Eval(args) => eval::run(args, output),
        Command::Report(args) => report::run(args, output),
        Command::Model(args) => model::run(args, output),
        Command::Mission(args) => mission::run(args, output),
        Command::Publish(Publish::Trial(args)) => publish_trial::run(args, output),
        Command::Config(Config::Init(args)) => config_init::run(args, output),
    }
}
