//! How a verb ended, and the exit code that says so.

use std::process::ExitCode;

use joulebus_config::{ConfigError, UnknownKey};

/// Exit code for wrong usage and for a config that was refused.
pub(crate) const USAGE: u8 = 2;

/// How a verb ended that was able to do its work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// As it should.
    Done,
    /// What was to be found out is bad news.
    Failed,
    /// It finished, but data was lost or differs.
    Incomplete,
}

impl Outcome {
    /// [`Outcome::Done`], or [`Outcome::Incomplete`] if data was lost.
    pub(crate) const fn unless_lost(lost: bool) -> Self {
        if lost { Self::Incomplete } else { Self::Done }
    }
}

/// Arguments that are well formed but cannot be meant.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct UsageError(pub(crate) String);

/// Nobody reads stdout any more, so there is nothing left to do.
#[derive(Debug, thiserror::Error)]
#[error("stdout was closed")]
pub(crate) struct StdoutClosed;

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
pub(crate) fn code(result: anyhow::Result<Outcome>) -> ExitCode {
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Failed) => ExitCode::from(1),
        Ok(Outcome::Incomplete) => ExitCode::from(3),
        Err(error) if error.is::<StdoutClosed>() => ExitCode::SUCCESS,
        Err(error) => {
            crate::output::say(&format!("error: {}", in_words(&error)));
            let is_usage = error.chain().any(|cause| {
                cause.is::<UsageError>() || cause.is::<ConfigError>() || cause.is::<UnknownKey>()
            });
            ExitCode::from(if is_usage { USAGE } else { 1 })
        }
    }
}
