//! Exit codes of every joulebus program.

use std::io::{self, Write as _};
use std::process::ExitCode;

use joulebus_config::{ConfigError, UnknownKey};

use crate::gone;
use crate::output::{self, StdoutClosed};

/// The run failed, or a check found a fault.
pub const FAILED: u8 = 1;
/// Wrong usage, or a config that was refused. Also clap's code for wrong usage.
pub const USAGE: u8 = 2;
/// The run finished, but data was lost or differs.
pub const INCOMPLETE: u8 = 3;

/// Result of a verb that finished.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Success.
    Done,
    /// A check found a fault.
    Failed,
    /// The run finished, but data was lost or differs.
    Incomplete,
}

impl Outcome {
    /// [`Outcome::Done`], or [`Outcome::Incomplete`] if data was lost.
    #[must_use]
    pub const fn unless_lost(lost: bool) -> Self {
        if lost { Self::Incomplete } else { Self::Done }
    }
}

/// Arguments that are well formed but invalid together.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// The error and its causes, each once: many error texts already contain their cause.
fn in_words(error: &anyhow::Error) -> String {
    let mut words = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !words.contains(&cause) {
            words = format!("{words}: {cause}");
        }
    }
    words
}

/// The exit code. Prints the error to stderr.
#[must_use]
pub fn code(result: anyhow::Result<Outcome>) -> ExitCode {
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Failed) => FAILED.into(),
        Ok(Outcome::Incomplete) => INCOMPLETE.into(),
        Err(error) if error.is::<StdoutClosed>() => ExitCode::SUCCESS,
        Err(error) => {
            output::last_line(&format!("error: {}", in_words(&error)));
            let is_usage = error.chain().any(|cause| {
                cause.is::<UsageError>() || cause.is::<ConfigError>() || cause.is::<UnknownKey>()
            });
            if is_usage { USAGE } else { FAILED }.into()
        }
    }
}

/// The exit code of arguments that clap did not accept: a request for help, or wrong usage.
#[must_use]
pub fn refused(arguments: &clap::Error) -> ExitCode {
    if let Some(instead) = gone::instead(arguments) {
        output::log_line(&format!("error: {instead}"));
    } else if arguments.use_stderr() {
        // The message quotes the arguments, which may contain escape sequences.
        output::log_line(arguments.render().to_string().trim_end());
    } else if let Err(error) = arguments.print().and_then(|()| io::stdout().flush())
        && error.kind() != io::ErrorKind::BrokenPipe
    {
        output::log_line(&format!("error: cannot write to stdout: {error}"));
        return FAILED.into();
    }
    u8::try_from(arguments.exit_code()).unwrap_or(USAGE).into()
}
