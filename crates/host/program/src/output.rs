//! Output to stdout and stderr. Neither panics when the reader has closed it.

use std::borrow::Cow;
use std::fmt::{Display, Write as _};
use std::io::{self, Write as _};
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::Context as _;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use serde::Serialize;
use serde_json::json;

use crate::stop::{is_asked_of_the_process, sets_a_flag};
use crate::utc::Utc;

/// Time that a reader of stdout has to take something once a stop was requested.
const PATIENCE: Duration = Duration::from_secs(5);
/// Interval at which such a request is noticed.
const POLL_INTERVAL: Timespec = Timespec { tv_sec: 0, tv_nsec: 50_000_000 };
/// A pipe that is ready takes this many bytes without blocking. A terminal may block.
const PIPE_BYTES: usize = 4_096;

/// The reader has closed stdout, so the program can stop.
#[derive(Debug, thiserror::Error)]
#[error("stdout was closed")]
pub struct StdoutClosed;

/// Stdout without a buffer. A reader that takes nothing keeps no signal from ending the program,
/// and one whose pipe somebody has made non-blocking is waited for.
#[derive(Debug, Clone, Copy)]
pub struct Stdout;

impl io::Write for Stdout {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let stdout = rustix::stdio::stdout();
        let bytes = &bytes[..bytes.len().min(PIPE_BYTES)];
        let mut until = None;
        loop {
            let mut polled = [PollFd::new(&stdout, PollFlags::OUT)];
            let is_ready = matches!(poll(&mut polled, Some(&POLL_INTERVAL)), Ok(1..));
            match is_ready.then(|| rustix::io::write(stdout, bytes)) {
                None | Some(Err(Errno::INTR | Errno::AGAIN)) => {}
                Some(written) => return Ok(written?),
            }
            if is_asked_of_the_process()
                && Instant::now() > *until.get_or_insert_with(|| Instant::now() + PATIENCE)
            {
                let why = "its reader has taken nothing for 5 s after the request to stop";
                return Err(io::Error::new(io::ErrorKind::TimedOut, why));
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Value of `--format`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// Text
    Text,
    /// JSON, with null for unknown numbers
    Json,
}

/// Writes results to stdout.
#[derive(Debug, Clone, Copy)]
pub struct Output {
    format: Format,
}

impl Output {
    /// With the requested format.
    #[must_use]
    pub const fn new(format: Format) -> Self {
        Self { format }
    }

    /// The requested format.
    #[must_use]
    pub const fn format(self) -> Format {
        self.format
    }

    /// Writes a report: as text or as indented JSON.
    ///
    /// # Errors
    /// [`StdoutClosed`], or the operating system's error.
    pub fn report<R: Serialize + Display>(self, report: &R) -> anyhow::Result<()> {
        match self.format() {
            Format::Text => text(&report.to_string()),
            Format::Json => {
                let json = serde_json::to_string_pretty(report).context("cannot write as JSON")?;
                text(&json)
            }
        }
    }

    /// Writes a line of a stream of reports: as text or as JSON in one line.
    ///
    /// # Errors
    /// [`StdoutClosed`], or the operating system's error.
    pub fn line<R: Serialize + Display>(self, report: &R) -> anyhow::Result<()> {
        match self.format() {
            Format::Text => text(&report.to_string()),
            Format::Json => text(&serde_json::to_string(report).context("cannot write as JSON")?),
        }
    }
}

/// Writes text to stdout, followed by a newline.
///
/// # Errors
/// [`StdoutClosed`], or the operating system's error.
pub fn text(text: &str) -> anyhow::Result<()> {
    let mut text = printable(text).into_owned();
    if !text.ends_with('\n') {
        text.push('\n');
    }
    // Lines of several threads do not mix.
    let mut before = io::stdout().lock();
    match before.flush().and_then(|()| Stdout.write_all(text.as_bytes())) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(StdoutClosed.into()),
        written => written.context("cannot write to stdout"),
    }
}

/// Target of a program's messages in a log whose lines are objects.
pub(crate) const PROGRAM_TARGET: &str = "joulebus::program";
/// True if messages go to the log, whose lines are objects.
static TO_LOG: AtomicBool = AtomicBool::new(false);

/// Lets [`log_line`] write to the log from now on.
pub(crate) fn log_to_objects() {
    TO_LOG.store(true, Ordering::Relaxed);
}

/// Writes a line to stderr, or to the log if its lines are objects. Errors are ignored, because it
/// is not a result.
pub fn log_line(line: &str) {
    let line = printable(line);
    if TO_LOG.load(Ordering::Relaxed) {
        tracing::info!(target: PROGRAM_TARGET, "{line}");
    } else {
        to_stderr(&format!("{line}\n"));
    }
}

/// A message of the program as a line of a log whose lines are objects, without its end.
fn object(message: &str) -> String {
    let (time, target) = (time_now(), PROGRAM_TARGET);
    json!({"timestamp": time, "level": "INFO", "target": target, "message": message}).to_string()
}

/// The time now, for a line of the log.
pub(crate) fn time_now() -> String {
    let unix_ns = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
    // Until the year 2554.
    timestamp(unix_ns as u64)
}

/// As in `2026-11-22T09:05:07.250Z`.
pub(crate) fn timestamp(unix_ns: u64) -> String {
    let at = Utc::new(unix_ns);
    let Utc { hour, minute, second, millisecond, .. } = at;
    format!("{}T{hour:02}:{minute:02}:{second:02}.{millisecond:03}Z", at.date())
}

/// Lines since the last written one that the reader of stderr has not taken.
static MISSED: AtomicU64 = AtomicU64::new(0);
/// True if it has taken the begin of the first of them.
static CUT: AtomicBool = AtomicBool::new(false);
/// Time that it has for a line. After a line that it has not taken, none waits for it.
const LOG_PATIENCE: Timespec = Timespec { tv_sec: 0, tv_nsec: 200_000_000 };
/// Time that it has for the last line.
const LAST_PATIENCE: Timespec = Timespec { tv_sec: 5, tv_nsec: 0 };

/// Writes a line to stderr. Where signals set a flag, the reader of a pipe that takes nothing would
/// keep a fleet waiting, and the signals: there the line is left out, and counted before the next one
/// that is taken. Other programs wait for their reader, and a signal ends them.
pub(crate) fn to_stderr(line: &str) {
    write_line(line, &LOG_PATIENCE, &Timespec::default());
}

/// Writes the last line of a program: the reader has some seconds for it, whatever it has missed.
pub(crate) fn last_line(line: &str) {
    if TO_LOG.load(Ordering::Relaxed) {
        return log_line(line);
    }
    write_line(&format!("{}\n", printable(line)), &LAST_PATIENCE, &LAST_PATIENCE);
}

fn write_line(line: &str, patience: &Timespec, after_a_miss: &Timespec) {
    // Lines of several threads do not mix.
    let mut stderr = io::stderr().lock();
    if !sets_a_flag() {
        let _ = stderr.write_all(line.as_bytes());
        return;
    }
    let (missed, is_cut) = (MISSED.load(Ordering::Relaxed), CUT.load(Ordering::Relaxed));
    let written = if missed == 0 {
        takes(&stderr, line.as_bytes(), patience)
    } else {
        let count = format!("{missed} lines were left out: stderr had no room for them");
        let count = if TO_LOG.load(Ordering::Relaxed) { object(&count) } else { count };
        let end_of_line = if is_cut { "\n" } else { "" };
        takes(&stderr, format!("{end_of_line}{count}\n{line}").as_bytes(), after_a_miss)
    };
    MISSED.store(if written.is_ok() { 0 } else { missed + 1 }, Ordering::Relaxed);
    CUT.store(written.is_err_and(|bytes| bytes > 0 || is_cut), Ordering::Relaxed);
}

/// Writes without blocking.
///
/// # Errors
/// The number of bytes that the reader has taken, if it has not taken all.
fn takes(stderr: &impl AsFd, bytes: &[u8], patience: &Timespec) -> Result<(), usize> {
    let mut written = 0;
    while written < bytes.len() {
        match poll(&mut [PollFd::new(stderr, PollFlags::OUT)], Some(patience)) {
            Ok(1..) => {}
            Err(Errno::INTR) => continue,
            _ => return Err(written),
        }
        let end = bytes.len().min(written + PIPE_BYTES);
        match rustix::io::write(stderr, &bytes[written..end]) {
            Ok(more) => written += more,
            Err(Errno::INTR) => {}
            Err(Errno::AGAIN) => return Err(written),
            // Where it is closed, nobody reads it.
            Err(_) => return Ok(()),
        }
    }
    Ok(())
}

/// The text with control characters escaped, except tabs and line breaks, and with Unicode's
/// directional ones escaped: a terminal would execute or reorder them. The form `\u001b` is valid
/// in JSON and TOML. Names of files, topics and schemas may contain any character, so joulebus
/// prints everything through this function.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(is_unprintable) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for letter in text.chars() {
        if is_unprintable(letter) {
            // Writing to a String cannot fail.
            let _ = write!(shown, "\\u{:04x}", u32::from(letter));
        } else {
            shown.push(letter);
        }
    }
    Cow::Owned(shown)
}

fn is_unprintable(letter: char) -> bool {
    !matches!(letter, '\t' | '\n') && (letter.is_control() || is_directional(letter))
}

/// True for letters that reorder what a terminal shows, or break its lines.
const fn is_directional(letter: char) -> bool {
    matches!(
        letter,
        '\u{200e}' | '\u{200f}' | '\u{061c}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}'
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped() {
        for (text, shown) in [
            ("plain: größe, 3 µs, €\n\tnext", "plain: größe, 3 µs, €\n\tnext"),
            ("\u{1b}[2Jred\r", "\\u001b[2Jred\\u000d"),
            ("bell\u{7} null\0 delete\u{7f}", "bell\\u0007 null\\u0000 delete\\u007f"),
            // A single character that some terminals interpret as ESC [.
            ("\u{9b}31m", "\\u009b31m"),
            ("a\u{202e}lmth.exe", "a\\u202elmth.exe"),
        ] {
            assert_eq!(printable(text), shown);
            // Escaping is idempotent: a supervisor repeats the output of its children.
            assert_eq!(printable(&printable(text)), shown);
        }
    }

    #[test]
    fn json_stays_the_same_json() {
        let names = ["\u{1b}]0;x\u{7}", "\u{9b}31m", "a\u{202e}b", "line\nbreak", "\\u001b"];
        let json = serde_json::to_string_pretty(&names).unwrap();
        let read: Vec<String> = serde_json::from_str(&printable(&json)).unwrap();
        assert_eq!(read, names);
    }
}
