//! How a program ends. Every exit code of every joulebus program is defined here.

use std::process::ExitCode;

use joulebus_config::{ConfigError, UnknownKey};

use crate::output::{self, StdoutClosed};

/// It failed, or what was to be found out is bad news.
pub const FAILED: u8 = 1;
/// Wrong usage, or a config that was refused; clap's own code for wrong usage.
pub const USAGE: u8 = 2;
/// It finished, but data was lost or differs.
pub const INCOMPLETE: u8 = 3;

/// How a verb ended that was able to do its work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// As it should.
    Done,
    /// What was to be found out is bad news.
    Failed,
    /// It finished, but data was lost or differs.
    Incomplete,
}

impl Outcome {
    /// [`Outcome::Done`], or [`Outcome::Incomplete`] if data was lost.
    #[must_use]
    pub const fn unless_lost(lost: bool) -> Self {
        if lost { Self::Incomplete } else { Self::Done }
    }
}

/// Arguments that are well formed but cannot be meant.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// The error and its causes, each said once: many of ours quote their cause already.
fn in_words(error: &anyhow::Error) -> String {
    let mut words = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !words.contains(&cause) {
            words = format!("{words}: {cause}");
        }
    }
    words
}

/// The exit code; says on stderr what went wrong.
#[must_use]
pub fn code(result: anyhow::Result<Outcome>) -> ExitCode {
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Failed) => FAILED.into(),
        Ok(Outcome::Incomplete) => INCOMPLETE.into(),
        Err(error) if error.is::<StdoutClosed>() => ExitCode::SUCCESS,
        Err(error) => {
            output::say(&format!("error: {}", in_words(&error)));
            let is_usage = error.chain().any(|cause| {
                cause.is::<UsageError>() || cause.is::<ConfigError>() || cause.is::<UnknownKey>()
            });
            if is_usage { USAGE } else { FAILED }.into()
        }
    }
}

/// The exit code of arguments that were not taken: help that was asked for, or wrong usage.
#[must_use]
pub fn refused(arguments: &clap::Error) -> ExitCode {
    // Help on a closed pipe is nobody's loss.
    let _ = arguments.print();
    u8::try_from(arguments.exit_code()).unwrap_or(USAGE).into()
}
