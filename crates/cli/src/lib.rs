//! The program `joulebus` as a library, so that other packages can build the same program.
//!
//! ```no_run
//! fn main() -> std::process::ExitCode {
//!     joulebus_cli::main()
//! }
//! ```
//!
//! **To know.** [`main`](main()) runs the program with the arguments of the process, and is all
//! that this library exports. To use joulebus from a program of your own, take its SDKs:
//! `joulebus-publisher`, `joulebus-consumer` and `joulebus-planner`.
//!
//! **Verbs.** Heavy verbs are separate programs, which this one executes: `joulebus-VERB`, and
//! `joulebus-lab` for all verbs on recordings and models. `joulebus_program` has the code that all
//! programs share.
//!
//! **Units** stand beside the numbers in reports, and in the names of keys in JSON.
//!
//! **Errors** go to stderr, with what was found, what is allowed and the remedy. The exit code
//! states which kind of error it was.
//!
//! **In the book**: [programs and verbs][1], [every option][2], [the demo][3],
//! [troubleshooting][4].
//!
//! [1]: https://github.com/joulebus/joulebus/blob/main/docs/reference/programs.md
//! [2]: https://github.com/joulebus/joulebus/blob/main/docs/reference/programs.md
//! [3]: https://github.com/joulebus/joulebus/blob/main/docs/tutorial/demo.md
//! [4]: https://github.com/joulebus/joulebus/blob/main/docs/how-to/troubleshooting.md
#![forbid(unsafe_code)]

mod alarms;
mod arguments;
mod ask;
mod battery;
mod budgets;
mod completions;
mod config;
mod configs;
mod demo;
mod doctor;
mod external;
mod info;
mod keys;
mod man;
mod new;
mod publish;
mod record;
mod recover;
mod replay;
mod run;
mod schema;
mod service_manager;
mod status;
mod supervisor;
mod view;
mod watch;

use std::process::ExitCode;

use clap::{Args as _, FromArgMatches as _};
use joulebus_program::exit::{self, Outcome};
use joulebus_program::output::Output;

use arguments::{Cli, Command};

/// Runs the program with the arguments of this process.
pub fn main() -> ExitCode {
    if let Err(error) = joulebus_bus::check_stack() {
        return exit::code(Err(error.into()));
    }
    joulebus_bus::trace_iceoryx2();
    if let Some(helped) = external::help(&arguments::command()) {
        return exit::code(helped);
    }
    match parse() {
        Ok((command, output)) => exit::code(execute(&command, output)),
        Err(refused) => exit::refused(&refused),
    }
}

fn parse() -> Result<(Command, Output), clap::Error> {
    let cli = Cli::from_arg_matches(&arguments::command().try_get_matches()?)?;
    let command = match cli.command {
        Some(command) => command,
        None => Command::Demo(default_demo()?),
    };
    Ok((command, cli.options.start()?))
}

/// `demo` with default options.
fn default_demo() -> Result<demo::Args, clap::Error> {
    let parser = demo::Args::augment_args(clap::Command::new("demo"));
    demo::Args::from_arg_matches(&parser.try_get_matches_from(["demo"])?)
}

fn execute(command: &Command, output: Output) -> anyhow::Result<Outcome> {
    match command {
        Command::Demo(args) => demo::run(args, output),
        Command::New(args) => new::run(args, output),
        Command::Run(args) => run::run(args, output),
        Command::Publish(args) => publish::run(args, output),
        Command::Record(args) => record::run(args, output),
        Command::Replay(args) => replay::run(args, output),
        Command::Watch(args) => watch::run(args, output),
        Command::Alarms(args) => alarms::run(args, output),
        Command::Battery(args) => battery::run(args, output),
        Command::Ask(args) => ask::run(args, output),
        Command::Info(args) => info::run(args, output),
        Command::Recover(args) => recover::run(args, output),
        Command::Serve(_) => external::run("serve"),
        Command::Bridge(_) => external::run("bridge"),
        Command::Link(_) => external::run("link"),
        Command::Import(_) => external::run_lab("import"),
        Command::Data(_) => external::run_lab("data"),
        Command::Doctor(args) => doctor::run(args, output),
        Command::Status(args) => status::run(args, output),
        Command::Config(args) => config::run(args, output),
        Command::Train(_) => external::run_lab("train"),
        Command::Analyze(_) => external::run_lab("analyze"),
        Command::Eval(_) => external::run_lab("eval"),
        Command::Report(_) => external::run_lab("report"),
        Command::Model(_) => external::run_lab("model"),
        Command::Bench(_) => external::run("bench"),
        Command::Mission(_) => external::run_lab("mission"),
        Command::Completions(args) => completions::run(args, arguments::whole()),
        Command::Man(args) => man::run(args, &arguments::whole()),
    }
}
