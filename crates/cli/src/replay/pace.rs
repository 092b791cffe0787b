//! Due times of messages: rate, pauses and steps.

use std::io::{BufRead as _, IsTerminal as _};
use std::sync::mpsc::{Receiver, channel};
use std::thread;

use anyhow::Context as _;
use crossterm::event::{self, Event, KeyCode};
use joulebus_bus::clock;
use joulebus_program::stop::Stop;

use crate::keys::{EVENT_TIMEOUT, asks_for_the_end, pressed, read_at_once};
use joulebus_source::rate::Rate;

/// Interval at which keys are polled, ns.
const KEY_POLL_NS: u64 = 20_000_000;
/// A delay of at most this is made up for, ns. A longer one shifts what follows.
const MAX_CATCH_UP_NS: u64 = 100_000_000;

/// Request from the keyboard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Request {
    Toggle,
    Step,
    End,
}

enum Keys {
    /// A terminal in raw mode until this is dropped.
    Terminal,
    /// Lines on stdin: each is one request.
    Lines(Receiver<()>, Request),
    Unavailable,
}

impl Keys {
    fn open(paused: bool, step: bool) -> anyhow::Result<Self> {
        if std::io::stdin().is_terminal() && is_foreground() {
            crossterm::terminal::enable_raw_mode().context("cannot read keys")?;
            let keys = Self::Terminal;
            read_at_once().context("cannot read keys")?;
            return Ok(keys);
        }
        if (!paused && !step) || std::io::stdin().is_terminal() {
            return Ok(Self::Unavailable);
        }
        let (give, lines) = channel();
        thread::spawn(move || {
            for line in std::io::stdin().lock().lines() {
                if line.is_err() || give.send(()).is_err() {
                    return;
                }
            }
        });
        let request = if step { Request::Step } else { Request::Toggle };
        Ok(Self::Lines(lines, request))
    }

    fn next(&self) -> anyhow::Result<Option<Request>> {
        match self {
            Self::Unavailable => Ok(None),
            Self::Lines(lines, request) => Ok(lines.try_recv().is_ok().then_some(*request)),
            Self::Terminal => {
                while event::poll(EVENT_TIMEOUT).context("cannot read keys")? {
                    if let Some(request) = request(&event::read().context("cannot read keys")?) {
                        return Ok(Some(request));
                    }
                }
                Ok(None)
            }
        }
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        if matches!(self, Self::Terminal) {
            // Fails only if the terminal is gone.
            let _ = crossterm::terminal::disable_raw_mode();
        }
    }
}

/// True if this process may read its terminal: a background process is stopped by SIGTTIN.
fn is_foreground() -> bool {
    // `pid (name) state ppid pgrp session tty_nr tpgid …`. The name may contain any character.
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit(')').next().unwrap_or_default();
    let fields: Vec<&str> = fields.split_ascii_whitespace().collect();
    matches!((fields.get(2), fields.get(5)), (Some(group), Some(foreground)) if group == foreground)
}

fn request(event: &Event) -> Option<Request> {
    let key = pressed(event)?;
    match key.code {
        _ if asks_for_the_end(key) => Some(Request::End),
        KeyCode::Char(' ') => Some(Request::Toggle),
        KeyCode::Right | KeyCode::Char('s') => Some(Request::Step),
        _ => None,
    }
}

/// Paces the messages of a playback.
pub(super) struct Pace {
    keys: Keys,
    timeline: Timeline,
    paused: bool,
    /// Steps requested and not done.
    steps: u64,
}

/// Mapping of recorded time to monotonic time.
#[derive(Debug, Clone, Copy)]
struct Timeline {
    rate: Rate,
    /// Due time of the recorded time 0, monotonic ns.
    zero_ns: u64,
    /// After a pause: the next message is due at once and shifts the others.
    align: bool,
    held_up_ns: u64,
}

impl Timeline {
    fn wall_ns(&self, recorded_ns: u64) -> u64 {
        match self.rate {
            Rate::Max => 0,
            Rate::Times(factor) => (recorded_ns as f64 / factor) as u64,
        }
    }

    /// Due time of what was recorded `recorded_ns` after the start, monotonic ns. A hold-up shifts
    /// everything after it: catching up would be a burst that is not in the recording.
    fn due_ns(&mut self, recorded_ns: u64, now_ns: u64) -> u64 {
        if self.rate == Rate::Max {
            return now_ns;
        }
        let wall_ns = self.wall_ns(recorded_ns);
        let late_ns = now_ns.saturating_sub(self.zero_ns.saturating_add(wall_ns));
        if self.align || late_ns > MAX_CATCH_UP_NS {
            self.held_up_ns += if self.align { 0 } else { late_ns };
            self.align = false;
            self.zero_ns = now_ns.saturating_sub(wall_ns);
            return now_ns;
        }
        self.zero_ns.saturating_add(wall_ns)
    }
}

impl Pace {
    pub(super) fn new(rate: Rate, paused: bool, step: bool) -> anyhow::Result<Self> {
        Ok(Self {
            keys: Keys::open(paused, step)?,
            timeline: Timeline { rate, zero_ns: clock::monotonic_ns(), align: true, held_up_ns: 0 },
            paused: paused || step,
            steps: 0,
        })
    }

    /// Starts a pass: its first message is due at once.
    pub(super) fn begin(&mut self) {
        self.timeline.align = true;
    }

    /// Waits until what was recorded `recorded_ns` after the start is due. `leads`: it is the first
    /// message of a step. False at a signal or a request to quit.
    pub(super) fn wait(
        &mut self,
        recorded_ns: u64,
        leads: bool,
        stop: &Stop,
    ) -> anyhow::Result<bool> {
        loop {
            while let Some(request) = self.keys.next()? {
                match request {
                    Request::Toggle => self.paused = !self.paused,
                    Request::Step => (self.paused, self.steps) = (true, self.steps + 1),
                    Request::End => return Ok(false),
                }
            }
            if stop.is_asked() {
                return Ok(false);
            }
            let now_ns = clock::monotonic_ns();
            if !self.paused {
                let due_ns = self.timeline.due_ns(recorded_ns, now_ns);
                if now_ns >= due_ns {
                    return Ok(true);
                }
                stop.sleep_until(due_ns.min(now_ns + KEY_POLL_NS));
                continue;
            }
            self.timeline.align = true;
            // Messages that follow a frame belong to its step.
            if !leads || self.steps > 0 {
                self.steps -= u64::from(leads);
                return Ok(true);
            }
            stop.sleep_until(now_ns + KEY_POLL_NS);
        }
    }

    /// Total time of hold-ups, s.
    pub(super) fn held_up_s(&self) -> f64 {
        self.timeline.held_up_ns as f64 / 1e9
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timeline(rate: Rate) -> Timeline {
        Timeline { rate, zero_ns: 1_000_000, align: true, held_up_ns: 0 }
    }

    #[test]
    fn rate_divides_times_and_a_pause_or_a_hold_up_shifts_later_messages() {
        let mut slow = timeline(Rate::Times(0.5));
        assert_eq!(slow.due_ns(0, 2_000_000), 2_000_000);
        assert_eq!(slow.due_ns(50, 2_000_000), 2_000_100);
        slow.align = true;
        assert_eq!(slow.due_ns(100, 7_000_000), 7_000_000);
        assert_eq!(slow.due_ns(200, 7_000_000), 7_000_200);
        let late_ns = 7_000_200 + MAX_CATCH_UP_NS + 300;
        assert_eq!(slow.due_ns(200, late_ns), late_ns);
        assert_eq!(slow.due_ns(300, late_ns), late_ns + 200);
        assert_eq!(slow.held_up_ns, MAX_CATCH_UP_NS + 300);
        assert_eq!(timeline(Rate::Max).due_ns(u64::MAX, 77), 77);
    }

    #[test]
    fn a_short_delay_is_made_up_for() {
        let mut timeline = timeline(Rate::Times(2.0));
        timeline.due_ns(0, 0);
        assert_eq!(timeline.due_ns(200, 150), 100);
        assert_eq!(timeline.due_ns(400, 160), 200);
    }
}
