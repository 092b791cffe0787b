//! Logging to stderr.

use std::io::{self, IsTerminal as _};

use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::output::{SAID, say, say_in_log};

const VARIABLE: &str = "JOULEBUS_LOG";
/// Target of the robots' alarms, which are logged at any verbosity.
pub const ALARMS: &str = "joulebus::alarms";

/// How a line of the log is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// Text
    Text,
    /// One JSON object per line, with the fields `timestamp` (UTC), `level`, `target`, `message`
    /// and those of the event
    Json,
}

/// Starts logging to stderr at the level of `JOULEBUS_LOG`, or else of the number of `--verbose`.
pub fn start(verbose: u8, format: LogFormat) {
    let told = std::env::var(VARIABLE).ok().filter(|told| !told.is_empty());
    let asked = told.and_then(|told| match told.parse() {
        Ok(targets) => Some(targets),
        Err(error) => {
            say(&format!("{VARIABLE} is ignored: {error}"));
            None
        }
    });
    let levels = asked.unwrap_or_else(|| by_verbosity(verbose));
    let levels = levels.with_target(SAID, LevelFilter::INFO);
    let registry = tracing_subscriber::registry().with(levels);
    let layer = fmt::layer().with_writer(io::stderr).with_ansi(io::stderr().is_terminal());
    // Fails only if logging was already started; it is then left unchanged.
    let _ = match format {
        LogFormat::Text => registry.with(layer).try_init(),
        LogFormat::Json => {
            let started = registry.with(layer.json().flatten_event(true)).try_init();
            if started.is_ok() {
                say_in_log();
            }
            started
        }
    };
}

fn by_verbosity(verbose: u8) -> Targets {
    // The bus handles and reports the conditions that iceoryx2 warns about.
    let (level, libraries) = match verbose {
        0 => (LevelFilter::WARN, LevelFilter::ERROR),
        1 => (LevelFilter::INFO, LevelFilter::ERROR),
        2 => (LevelFilter::DEBUG, LevelFilter::WARN),
        _ => (LevelFilter::TRACE, LevelFilter::TRACE),
    };
    let targets = Targets::new().with_default(level);
    targets
        .with_target("iceoryx2", libraries)
        // It warns of each message to a peer on another network of the host than the chosen one.
        .with_target("rustdds", libraries)
        .with_target(ALARMS, level.max(LevelFilter::INFO))
}
