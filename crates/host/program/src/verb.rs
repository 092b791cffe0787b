//! The `main` of a verb that is a separate program: `joulebus VERB …` runs `joulebus-VERB …`.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::FromArgMatches as _;

use crate::described;
use crate::exit::{self, Outcome};
use crate::options::GlobalOptions;
use crate::output::Output;

/// The `main` of `joulebus-VERB`: parses the arguments of this process, runs `work`, and returns
/// the exit code. Help, errors and options are those of `joulebus VERB`. `ready` states whether
/// this process may begin: parsing needs a stack.
#[must_use]
pub fn main<A: clap::Args, E: Into<anyhow::Error>>(
    verb: &'static str,
    ready: Result<(), E>,
    work: impl FnOnce(&A, Output) -> anyhow::Result<Outcome>,
) -> ExitCode {
    if let Some(answered) = described::answer(|| vec![A::augment_args(clap::Command::new(verb))]) {
        return answered;
    }
    if let Err(error) = ready {
        return exit::code(Err(error.into()));
    }
    match parse(verb, std::env::args_os().skip(1)) {
        Ok((arguments, output)) => exit::code(work(&arguments, output)),
        Err(refused) => exit::refused(&refused),
    }
}

fn parse<A: clap::Args>(
    verb: &'static str,
    arguments: impl Iterator<Item = OsString>,
) -> Result<(A, Output), clap::Error> {
    let program = <GlobalOptions as clap::Args>::augment_args(clap::Command::new("joulebus"))
        .subcommand(A::augment_args(clap::Command::new(verb)));
    let called = ["joulebus", verb].map(OsString::from).into_iter();
    let matches = program.try_get_matches_from(called.chain(arguments))?;
    let options = GlobalOptions::from_arg_matches(&matches)?;
    let matches = matches.subcommand_matches(verb).unwrap_or(&matches);
    Ok((A::from_arg_matches(matches)?, options.start()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::Format;

    #[derive(Debug, clap::Args)]
    struct Arguments {
        #[arg(long, required = true)]
        http: bool,
    }

    fn parsed(words: &[&str]) -> Result<(Arguments, Output), clap::Error> {
        parse("serve", words.iter().map(OsString::from))
    }

    #[test]
    fn global_options_are_accepted_before_and_after_those_of_the_verb() {
        for words in [["--format", "json", "--http"], ["--http", "--format", "json"]] {
            let (arguments, output) = parsed(&words).expect("both are allowed");
            assert!(arguments.http);
            assert_eq!(output.format(), Format::Json);
        }
    }

    #[test]
    fn help_and_errors_are_those_of_the_verb() {
        let help = parsed(&["--help"]).expect_err("help").to_string();
        assert!(help.contains("Usage: joulebus serve"), "{help}");
        let refused = parsed(&[]).expect_err("an option is missing");
        assert_eq!(refused.exit_code(), i32::from(exit::USAGE));
        assert!(refused.to_string().contains("Usage: joulebus serve"));
        let rows = parsed(&["--http", "--format", "csv"]).expect_err("no rows");
        assert_eq!(rows.exit_code(), i32::from(exit::USAGE));
    }
}
