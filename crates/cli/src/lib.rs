//! The `joulebus` program as a library, so that other packages can build the same program.
//!
//! Results go to stdout, everything else to stderr. Exit codes: 0 done; 1 failed; 2 wrong usage or
//! a config that was refused; 3 finished, but data was lost or differs.
#![forbid(unsafe_code)]

mod analyze;
mod arguments;
mod bench;
mod cat;
mod completions;
mod config;
mod config_file;
mod data;
mod demo;
mod doctor;
mod eval;
mod exit;
mod import;
mod info;
mod keys;
mod logging;
mod model;
mod model_source;
mod output;
mod publish;
mod record;
mod recover;
mod replay;
mod report;
mod run;
mod serve;
mod split_unit;
mod stop;
mod supervisor;
mod train;
mod trials;
mod view;
mod watch;

use std::process::ExitCode;

use clap::{Args as _, FromArgMatches as _, Parser as _};

use arguments::{Cli, Command};
use exit::Outcome;
use output::{Output, OutputFormat};

/// Runs the program with the arguments of this process.
#[must_use]
pub fn main() -> ExitCode {
    match parse() {
        Ok((command, output)) => exit::code(execute(&command, output)),
        Err(refused) => {
            // Help on a closed pipe is nobody's loss.
            let _ = refused.print();
            ExitCode::from(u8::try_from(refused.exit_code()).unwrap_or(exit::USAGE))
        }
    }
}

fn parse() -> Result<(Command, Output), clap::Error> {
    let cli = Cli::try_parse()?;
    logging::start(cli.verbose);
    if cli.exit_with_stdin {
        supervisor::end_with_stdin().map_err(|error| {
            clap::Error::raw(clap::error::ErrorKind::Io, format!("{error:#}\n"))
        })?;
    }
    let command = match cli.command {
        Some(command) => command,
        None => Command::Demo(default_demo()?),
    };
    let is_cat = matches!(command, Command::Cat(_));
    if !is_cat && matches!(cli.format, OutputFormat::Ndjson | OutputFormat::Csv) {
        let what = "--format ndjson and csv are of `cat` alone; use --format json\n";
        return Err(clap::Error::raw(clap::error::ErrorKind::InvalidValue, what));
    }
    Ok((command, Output::new(cli.format)))
}

/// `demo` as if it had been asked for without options.
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
        Command::Info(args) => info::run(args, output),
        Command::Cat(args) => cat::run(args, output),
        Command::Recover(args) => recover::run(args, output),
        Command::Serve(args) => serve::run(args, output),
        Command::Import(args) => import::run(args, output),
        Command::Data(args) => data::run(args, output),
        Command::Doctor(args) => doctor::run(args, output),
        Command::Config(args) => config::run(args, output),
        Command::Train(args) => train::run(args, output),
        Command::Analyze(args) => analyze::run(args, output),
        Command::Eval(args) => eval::run(args, output),
        Command::Report(args) => report::run(args, output),
        Command::Model(args) => model::run(args, output),
        Command::Bench(args) => bench::run(args, output),
        Command::BenchRole(args) => bench::play(args, output),
        Command::Completions(args) => completions::run(args, output),
    }
}
