//! When the next message is due: the rate, pauses, and steps.

use std::io::{BufRead as _, IsTerminal as _};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use anyhow::Context as _;
use crossterm::event::{self, Event, KeyCode};
use joulebus_bus::clock;
use joulebus_program::stop::Stop;

use crate::keys::{asks_for_the_end, pressed};
use crate::publish::Rate;

/// How often keys are looked for, ns.
const LOOK_EVERY_NS: u64 = 20_000_000;
/// Less than this is no hold-up, ns.
const LATE_NS: u64 = 100_000_000;

/// What somebody at the keyboard asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wish {
    Toggle,
    Step,
    End,
}

/// Where wishes come from.
enum Keys {
    /// A terminal, taken over until this is dropped.
    Terminal,
    /// Lines on stdin: each is one wish.
    Lines(Receiver<()>, Wish),
    Nobody,
}

impl Keys {
    fn open(paused: bool, step: bool) -> anyhow::Result<Self> {
        if std::io::stdin().is_terminal() && is_foreground() {
            crossterm::terminal::enable_raw_mode().context("cannot read keys")?;
            return Ok(Self::Terminal);
        }
        if (!paused && !step) || std::io::stdin().is_terminal() {
            return Ok(Self::Nobody);
        }
        let (give, lines) = channel();
        thread::spawn(move || {
            for line in std::io::stdin().lock().lines() {
                if line.is_err() || give.send(()).is_err() {
                    return;
                }
            }
        });
        let wish = if step { Wish::Step } else { Wish::Toggle };
        Ok(Self::Lines(lines, wish))
    }

    fn next(&self) -> anyhow::Result<Option<Wish>> {
        match self {
            Self::Nobody => Ok(None),
            Self::Lines(lines, wish) => Ok(lines.try_recv().is_ok().then_some(*wish)),
            Self::Terminal => {
                while event::poll(Duration::ZERO).context("cannot read keys")? {
                    if let Some(wish) = wish(&event::read().context("cannot read keys")?) {
                        return Ok(Some(wish));
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
            // A terminal that is gone needs nothing back.
            let _ = crossterm::terminal::disable_raw_mode();
        }
    }
}

/// Whether this process may use its terminal: one in the background is stopped when it tries.
fn is_foreground() -> bool {
    // `pid (name) state ppid pgrp session tty_nr tpgid …`; the name may have anything in it.
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit(')').next().unwrap_or_default();
    let fields: Vec<&str> = fields.split_ascii_whitespace().collect();
    matches!((fields.get(2), fields.get(5)), (Some(group), Some(foreground)) if group == foreground)
}

fn wish(event: &Event) -> Option<Wish> {
    let key = pressed(event)?;
    match key.code {
        _ if asks_for_the_end(key) => Some(Wish::End),
        KeyCode::Char(' ') => Some(Wish::Toggle),
        KeyCode::Right | KeyCode::Char('s') => Some(Wish::Step),
        _ => None,
    }
}

/// Says when messages are due.
pub(super) struct Pace {
    keys: Keys,
    course: RestartPolicy,
    paused: bool,
    /// Steps asked for and not done.
    steps: u64,
}

/// How recorded time lies in that of now.
#[derive(Debug, Clone, Copy)]
struct RestartPolicy {
    rate: Rate,
    /// When the recorded time 0 is due, monotonic ns.
    zero_ns: u64,
    /// After a pause: the next message is due at once, and the others after it.
    align: bool,
    held_up_ns: u64,
}

impl RestartPolicy {
    fn wall_ns(&self, recorded_ns: u64) -> u64 {
        match self.rate {
            Rate::Max => 0,
            Rate::Times(factor) => (recorded_ns as f64 / factor) as u64,
        }
    }

    /// When what was recorded `recorded_ns` after the beginning is due. A hold-up moves all that
    /// follows: making up for it would be a burst that nobody sent.
    fn due_ns(&mut self, recorded_ns: u64, now_ns: u64) -> u64 {
        if self.rate == Rate::Max {
            return now_ns;
        }
        let wall_ns = self.wall_ns(recorded_ns);
        let late_ns = now_ns.saturating_sub(self.zero_ns.saturating_add(wall_ns));
        if self.align || late_ns > LATE_NS {
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
            course: RestartPolicy {
                rate,
                zero_ns: clock::monotonic_ns(),
                align: true,
                held_up_ns: 0,
            },
            paused: paused || step,
            steps: 0,
        })
    }

    /// A pass begins: its first message is due at once.
    pub(super) fn begin(&mut self) {
        self.course.align = true;
    }

    /// Waits until what was recorded `recorded_ns` after the beginning is due; `leads`: it begins a
    /// step. False at a signal, or when somebody wants the end.
    pub(super) fn wait(
        &mut self,
        recorded_ns: u64,
        leads: bool,
        stop: &Stop,
    ) -> anyhow::Result<bool> {
        loop {
            while let Some(wish) = self.keys.next()? {
                match wish {
                    Wish::Toggle => self.paused = !self.paused,
                    Wish::Step => (self.paused, self.steps) = (true, self.steps + 1),
                    Wish::End => return Ok(false),
                }
            }
            if stop.is_asked() {
                return Ok(false);
            }
            let now_ns = clock::monotonic_ns();
            if !self.paused {
                let due_ns = self.course.due_ns(recorded_ns, now_ns);
                if now_ns >= due_ns {
                    return Ok(true);
                }
                stop.sleep_until(due_ns.min(now_ns + LOOK_EVERY_NS));
                continue;
            }
            self.course.align = true;
            // What goes with a frame goes with its step.
            if !leads || self.steps > 0 {
                self.steps -= u64::from(leads);
                return Ok(true);
            }
            stop.sleep_until(now_ns + LOOK_EVERY_NS);
        }
    }

    /// Time by which the playback was held up, s.
    pub(super) fn held_up_s(&self) -> f64 {
        self.course.held_up_ns as f64 / 1e9
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn course(rate: Rate) -> RestartPolicy {
        RestartPolicy {
            rate,
            zero_ns: 1_000_000,
            align: true,
            held_up_ns: 0,
        }
    }

    #[test]
    fn the_rate_divides_times_and_a_pause_or_a_hold_up_moves_what_follows() {
        let mut slow = course(Rate::Times(0.5));
        assert_eq!(slow.due_ns(0, 2_000_000), 2_000_000);
        assert_eq!(slow.due_ns(50, 2_000_000), 2_000_100);
        slow.align = true;
        assert_eq!(slow.due_ns(100, 7_000_000), 7_000_000);
        assert_eq!(slow.due_ns(200, 7_000_000), 7_000_200);
        let late_ns = 7_000_200 + LATE_NS + 300;
        assert_eq!(slow.due_ns(200, late_ns), late_ns);
        assert_eq!(slow.due_ns(300, late_ns), late_ns + 200);
        assert_eq!(slow.held_up_ns, LATE_NS + 300);
        assert_eq!(course(Rate::Max).due_ns(u64::MAX, 77), 77);
    }

    #[test]
    fn a_little_late_is_made_up_for() {
        let mut course = course(Rate::Times(2.0));
        course.due_ns(0, 0);
        assert_eq!(course.due_ns(200, 150), 100);
        assert_eq!(course.due_ns(400, 160), 200);
    }
}
