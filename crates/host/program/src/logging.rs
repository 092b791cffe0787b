//! Logging to stderr.

use std::fmt::{Debug, Write as _};
use std::io::{self, IsTerminal as _};
use std::sync::OnceLock;

use tracing::field::{Field, Visit};
use tracing::subscriber::Interest;
use tracing::{Event, Metadata, Subscriber};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt;
use tracing_subscriber::layer::{Context, Layer, SubscriberExt as _};
use tracing_subscriber::util::SubscriberInitExt as _;

use crate::output::{LogLines, PROGRAM_TARGET, log_line, log_to_objects};

const VARIABLE: &str = "JOULEBUS_LOG";
/// Target of the robots' alarms, which are logged at any verbosity.
pub const ALARMS: &str = "joulebus::alarms";

/// Form of a line of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// Text
    Text,
    /// One JSON object per line, with the fields `timestamp` (UTC), `level`, `target`, `message`
    /// and those of the event
    Json,
}

/// Libraries' log messages that a program reads itself, whether or not they are shown.
#[derive(Debug, Clone, Copy)]
pub struct LogTap {
    /// Beginnings of targets, with their levels.
    pub targets: &'static [(&'static str, LevelFilter)],
    /// Takes a message. Returns true if it needs no line in the log: the program reports it
    /// otherwise. It must not log.
    pub take: fn(&str) -> bool,
}

static TAP: OnceLock<LogTap> = OnceLock::new();

/// Before [`start`]: lets this program read its libraries' logs. Later calls have no effect.
pub fn tap(tap: LogTap) {
    let _ = TAP.set(tap);
}

/// Starts logging to stderr at the level of `JOULEBUS_LOG`, or else of the number of `--verbose`.
pub fn start(verbose: u8, format: LogFormat) {
    let variable = std::env::var(VARIABLE).ok().filter(|text| !text.is_empty());
    let asked = variable.and_then(|text| match text.parse() {
        Ok(targets) => Some(targets),
        Err(error) => {
            log_line(&format!("{VARIABLE} is ignored: {error}"));
            None
        }
    });
    let levels = asked.unwrap_or_else(|| by_verbosity(verbose));
    let levels = levels.with_target(PROGRAM_TARGET, LevelFilter::INFO);
    let levels = Levels { levels, tap: TAP.get().copied() };
    let registry = tracing_subscriber::registry().with(levels);
    let layer = fmt::layer().with_writer(|| LogLines).with_ansi(io::stderr().is_terminal());
    // Fails only if logging was already started. It is then left unchanged.
    let _ = match format {
        LogFormat::Text => registry.with(layer).try_init(),
        LogFormat::Json => {
            let started = registry.with(layer.json().flatten_event(true)).try_init();
            if started.is_ok() {
                log_to_objects();
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
        // It warns of each line of a figure that has no length.
        .with_target("tiny_skia", libraries)
        .with_target(ALARMS, level.max(LevelFilter::INFO))
}

/// The events that are shown: those of `levels` that the program does not report otherwise.
struct Levels {
    levels: Targets,
    tap: Option<LogTap>,
}

impl Levels {
    fn shows(&self, of: &Metadata<'_>) -> bool {
        self.levels.would_enable(of.target(), of.level())
    }

    fn taps(&self, of: &Metadata<'_>) -> bool {
        let targets = self.tap.map_or(&[][..], |tap| tap.targets);
        targets.iter().any(|(target, level)| of.target().starts_with(target) && of.level() <= level)
    }
}

impl<S: Subscriber> Layer<S> for Levels {
    fn enabled(&self, of: &Metadata<'_>, _: Context<'_, S>) -> bool {
        self.shows(of) || self.taps(of)
    }

    fn register_callsite(&self, of: &'static Metadata<'static>) -> Interest {
        match self.shows(of) || self.taps(of) {
            true => Interest::always(),
            false => Interest::never(),
        }
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        let shown = Layer::<S>::max_level_hint(&self.levels)?;
        let targets = self.tap.map_or(&[][..], |tap| tap.targets);
        Some(targets.iter().fold(shown, |max, (_, level)| max.max(*level)))
    }

    fn event_enabled(&self, event: &Event<'_>, _: Context<'_, S>) -> bool {
        let of = event.metadata();
        if let Some(tap) = self.tap.filter(|_| self.taps(of)) {
            let mut message = Message::default();
            event.record(&mut message);
            if (tap.take)(&message.0) {
                return false;
            }
        }
        self.shows(of)
    }
}

#[derive(Default)]
struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            // Writing to a string cannot fail.
            let _ = write!(self.0, "{value:?}");
        }
    }
}
