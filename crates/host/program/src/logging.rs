//! Logging to stderr.

use std::fmt::{Debug, Write as _};
use std::io::{self, IsTerminal as _};
use std::str::FromStr;
use std::sync::OnceLock;

use serde_json::{Map, Value};
use tracing::field::{Field, Visit};
use tracing::level_filters::LevelFilter;
use tracing::span::{Attributes, Id, Record};
use tracing::subscriber::Interest;
use tracing::{Event, Level, Metadata, Subscriber};

use crate::output::{PROGRAM_TARGET, log_line, log_to_objects, printable, time_now, to_stderr};

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
        Ok(levels) => Some(levels),
        Err(error) => {
            log_line(&format!("{VARIABLE} is ignored: {error}"));
            None
        }
    });
    let mut levels = asked.unwrap_or_else(|| by_verbosity(verbose));
    levels.set(PROGRAM_TARGET, LevelFilter::INFO);
    let is_coloured = io::stderr().is_terminal();
    let log = Log { levels, tap: TAP.get().copied(), format, is_coloured };
    // Fails only if logging was already started. It is then left unchanged.
    let started = tracing::subscriber::set_global_default(log).is_ok();
    if started && format == LogFormat::Json {
        log_to_objects();
    }
}

fn by_verbosity(verbose: u8) -> Levels {
    // The bus handles and reports the conditions that iceoryx2 warns about.
    let (level, libraries) = match verbose {
        0 => (LevelFilter::WARN, LevelFilter::ERROR),
        1 => (LevelFilter::INFO, LevelFilter::ERROR),
        2 => (LevelFilter::DEBUG, LevelFilter::WARN),
        _ => (LevelFilter::TRACE, LevelFilter::TRACE),
    };
    let mut levels = Levels { other: level, targets: Vec::new() };
    levels.set("iceoryx2", libraries);
    // It warns of each message to a peer on another network of the host than the chosen one.
    levels.set("rustdds", libraries);
    levels.set(ALARMS, level.max(LevelFilter::INFO));
    levels
}

/// The most detailed level that is shown, by target.
#[derive(Debug, PartialEq, Eq)]
struct Levels {
    /// Of targets that no entry is for.
    other: LevelFilter,
    /// Beginnings of targets, the longest first: the first that fits decides.
    targets: Vec<(String, LevelFilter)>,
}

impl Levels {
    fn set(&mut self, target: &str, level: LevelFilter) {
        self.targets.retain(|(known, _)| known != target);
        self.targets.push((target.to_owned(), level));
        self.targets.sort_by_key(|(target, _)| std::cmp::Reverse(target.len()));
    }

    fn of(&self, target: &str) -> LevelFilter {
        let fits = |(begin, _): &&(String, LevelFilter)| target.starts_with(begin.as_str());
        self.targets.iter().find(fits).map_or(self.other, |(_, level)| *level)
    }
}

/// Levels and targets with `,` between them: `info,iceoryx2=off`. A target alone is shown whole.
impl FromStr for Levels {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut levels = Self { other: LevelFilter::OFF, targets: Vec::new() };
        for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
            match (part.split_once('='), part.parse()) {
                (Some((target, level)), _) => {
                    let parsed = level.parse().map_err(|_| {
                        format!(
                            "{level:?} is no level. Allowed: off, error, warn, info, debug, trace"
                        )
                    });
                    levels.set(target, parsed?);
                }
                (None, Ok(level)) => levels.other = level,
                (None, Err(_)) => levels.set(part, LevelFilter::TRACE),
            }
        }
        Ok(levels)
    }
}

/// Writes each event that is shown as a line. Spans are not shown.
struct Log {
    levels: Levels,
    tap: Option<LogTap>,
    format: LogFormat,
    is_coloured: bool,
}

impl Log {
    fn shows(&self, of: &Metadata<'_>) -> bool {
        !of.is_span() && *of.level() <= self.levels.of(of.target())
    }

    fn taps(&self, of: &Metadata<'_>) -> bool {
        let targets = self.tap.map_or(&[][..], |tap| tap.targets);
        !of.is_span()
            && targets
                .iter()
                .any(|(target, level)| of.target().starts_with(target) && of.level() <= level)
    }
}

impl Subscriber for Log {
    fn register_callsite(&self, of: &'static Metadata<'static>) -> Interest {
        match self.shows(of) || self.taps(of) {
            true => Interest::always(),
            false => Interest::never(),
        }
    }

    fn enabled(&self, of: &Metadata<'_>) -> bool {
        self.shows(of) || self.taps(of)
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        let tapped = self.tap.map_or(&[][..], |tap| tap.targets).iter().map(|(_, level)| *level);
        let shown = self.levels.targets.iter().map(|(_, level)| *level);
        tapped.chain(shown).chain([self.levels.other]).max()
    }

    fn event(&self, event: &Event<'_>) {
        let of = event.metadata();
        let mut said = Said::default();
        event.record(&mut said);
        let is_taken =
            self.tap.filter(|_| self.taps(of)).is_some_and(|tap| (tap.take)(&said.message));
        if is_taken || !self.shows(of) {
            return;
        }
        let time = time_now();
        let line = match self.format {
            LogFormat::Text => said.text(&time, of, self.is_coloured),
            LogFormat::Json => said.json(time, of),
        };
        to_stderr(&line);
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        // None is enabled.
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}
    fn record_follows_from(&self, _: &Id, _: &Id) {}
    fn enter(&self, _: &Id) {}
    fn exit(&self, _: &Id) {}
}

/// What an event says.
#[derive(Default)]
struct Said {
    message: String,
    /// The other fields, as text.
    fields: String,
    /// The same as values.
    values: Map<String, Value>,
}

impl Said {
    fn text(&self, time: &str, of: &Metadata<'_>, is_coloured: bool) -> String {
        let Self { message, fields, .. } = self;
        let said = format!("{}: {message}{fields}", of.target());
        let (colour, plain) = match is_coloured {
            true => (colour(*of.level()), "\u{1b}[0m"),
            false => ("", ""),
        };
        format!("{time} {colour}{:>5}{plain} {}\n", of.level(), printable(&said))
    }

    /// A field of the event has its value, even if it is named as one that every line has.
    fn json(self, time: String, of: &Metadata<'_>) -> String {
        let of_all = [
            ("timestamp", time),
            ("level", of.level().to_string()),
            ("target", of.target().to_owned()),
            ("message", self.message),
        ];
        let mut object: Map<_, _> =
            of_all.map(|(name, text)| (name.to_owned(), text.into())).into_iter().collect();
        object.extend(self.values);
        format!("{}\n", printable(&Value::Object(object).to_string()))
    }

    fn add(&mut self, field: &Field, value: Value, shown: &dyn Debug) {
        if field.name() == "message" {
            self.message = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            return;
        }
        // Writing to a string cannot fail.
        let _ = write!(self.fields, " {}={shown:?}", field.name());
        self.values.insert(field.name().to_owned(), value);
    }
}

impl Visit for Said {
    fn record_f64(&mut self, field: &Field, value: f64) {
        self.add(field, value.into(), &value);
    }

    fn record_i64(&mut self, field: &Field, value: i64) {
        self.add(field, value.into(), &value);
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        self.add(field, value.into(), &value);
    }

    fn record_bool(&mut self, field: &Field, value: bool) {
        self.add(field, value.into(), &value);
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        self.add(field, value.into(), &value);
    }

    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.add(field, format!("{value:?}").into(), value);
    }
}

const fn colour(level: Level) -> &'static str {
    match level {
        Level::ERROR => "\u{1b}[31m",
        Level::WARN => "\u{1b}[33m",
        Level::INFO => "\u{1b}[32m",
        Level::DEBUG => "\u{1b}[34m",
        Level::TRACE => "\u{1b}[35m",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_target_that_fits_decides_the_level() {
        let levels: Levels = "warn, rustdds=off,rustdds::net=debug,joulebus_link".parse().unwrap();
        for (target, level) in [
            ("joulebus::program", LevelFilter::WARN),
            ("rustdds", LevelFilter::OFF),
            ("rustdds_link", LevelFilter::OFF),
            ("rustdds::net::runtime", LevelFilter::DEBUG),
            ("joulebus_link::peers", LevelFilter::TRACE),
        ] {
            assert_eq!(levels.of(target), level, "{target}");
        }
        let only: Levels = "joulebus::alarms=INFO".parse().unwrap();
        assert_eq!((only.of(ALARMS), only.of("rustdds")), (LevelFilter::INFO, LevelFilter::OFF));
        let refused = "rustdds=loud".parse::<Levels>().unwrap_err();
        assert!(refused.contains("\"loud\"") && refused.contains("trace"), "{refused}");
    }

    #[test]
    fn a_moment_has_its_date_and_milliseconds() {
        assert_eq!(crate::output::timestamp(1_795_338_307_250_999_999), "2026-11-22T09:05:07.250Z");
    }

    /// Keeps the lines that would be written.
    struct Kept(std::sync::Mutex<Vec<[String; 2]>>);

    impl Subscriber for Kept {
        fn enabled(&self, _: &Metadata<'_>) -> bool {
            true
        }

        fn event(&self, event: &Event<'_>) {
            let said = || {
                let mut said = Said::default();
                event.record(&mut said);
                said
            };
            let of = event.metadata();
            let lines = [said().text("now", of, false), said().json("now".to_owned(), of)];
            self.0.lock().unwrap().push(lines);
        }

        fn new_span(&self, _: &Attributes<'_>) -> Id {
            Id::from_u64(1)
        }

        fn record(&self, _: &Id, _: &Record<'_>) {}
        fn record_follows_from(&self, _: &Id, _: &Id) {}
        fn enter(&self, _: &Id) {}
        fn exit(&self, _: &Id) {}
    }

    #[test]
    fn a_line_has_all_that_an_event_says_and_escapes_what_a_terminal_would_execute() {
        let kept = std::sync::Arc::new(Kept(Default::default()));
        tracing::subscriber::with_default(std::sync::Arc::clone(&kept), || {
            let error = "no\u{1b}[2J";
            tracing::warn!(target: "a", robot = 7, level = "stale", s = 0.5, %error, "gone {}", 1);
        });
        let lines = kept.0.lock().unwrap();
        let [text, json] = &lines[0];
        let shown = "now  WARN a: gone 1 robot=7 level=\"stale\" s=0.5 error=no\\u001b[2J\n";
        assert_eq!(text, shown);
        let json: Value = serde_json::from_str(json).unwrap();
        let expected = serde_json::json!({
            "timestamp": "now", "level": "stale", "target": "a", "message": "gone 1",
            "robot": 7, "s": 0.5, "error": "no\u{1b}[2J",
        });
        assert_eq!(json, expected);
    }
}
