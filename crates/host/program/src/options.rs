//! The options of every verb.

use clap::error::ErrorKind;

use crate::logging::LogFormat;
use crate::output::{Format, Output};
use crate::{exit_with_parent, logging, stop};

/// The heading of these options.
const HEADING: &str = "Options of every verb";

/// Options of every verb, which its help shows after its own.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct GlobalOptions {
    /// Output format of results: text, or json with null for unknown numbers
    #[arg(long, global = true, help_heading = HEADING, value_enum, default_value_t = Format::Text,
          hide_possible_values = true)]
    format: Format,
    /// Log more to stderr: once for events, twice for details, three times for everything
    #[arg(short, long, global = true, help_heading = HEADING, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Format of the log on stderr: text, or json with an object per line: `timestamp` (UTC),
    /// `level`, `target`, `message` and the fields of the event
    #[arg(long, global = true, help_heading = HEADING, value_enum, default_value_t = LogFormat::Text,
          hide_possible_values = true, value_name = "FORMAT")]
    log_format: LogFormat,
    /// Exit when stdin closes: set by a supervisor, so that no process outlives it
    #[arg(long, global = true, hide = true)]
    exit_with_stdin: bool,
}

impl GlobalOptions {
    /// Starts logging and, if requested, the watch of stdin.
    ///
    /// # Errors
    /// A thread that cannot be started.
    pub fn start(self) -> Result<Output, clap::Error> {
        logging::start(self.verbose, self.log_format);
        let failed = |error: anyhow::Error| clap::Error::raw(ErrorKind::Io, format!("{error:#}\n"));
        stop::survive_file_limit().map_err(failed)?;
        if self.exit_with_stdin {
            exit_with_parent::end_with_stdin().map_err(failed)?;
        }
        Ok(Output::new(self.format))
    }
}
