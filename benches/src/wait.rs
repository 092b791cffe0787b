//! How late a wait for a descriptor and a deadline ends, by the way the deadline is given to the
//! system: as the timeout of `ppoll`, or as a timer descriptor beside the other one. What the worker
//! does is decided by this figure.

use std::fmt;
use std::num::NonZeroU64;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixDatagram;

use anyhow::Context;
use hdrhistogram::Histogram;
use joulebus_bus::{Scheduling, clock};
use joulebus_predictor_worker::Spread;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::time::{
    ClockId, Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec, clock_gettime,
    timerfd_create, timerfd_settime,
};
use serde::{Deserialize, Serialize};

use crate::{histogram, line};

/// What Linux gives every thread, ns: sleeps may end so much late.
const USUAL_SLACK_NS: u64 = 50_000;

/// What is to be measured.
#[derive(Debug, Clone)]
pub struct Options {
    /// Waits of each way; they take turns.
    pub waits: u64,
    /// Length of a wait, ns.
    pub length_ns: u64,
    /// SimdLevel and priority of the thread that waits.
    pub scheduling: Scheduling,
}

/// What was measured.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Report {
    /// How it was measured.
    pub input: String,
    /// One for each way.
    pub rows: Vec<Row>,
}

/// Figures of one way.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Row {
    /// The way.
    pub name: String,
    /// From the deadline to the thread running again.
    pub late_us: Spread,
    /// SimdLevel time of the thread for a wait, mean, µs.
    pub cpu_us: f64,
}

/// A way to wait.
#[derive(Debug, Clone, Copy)]
enum Way {
    /// The deadline is the timeout.
    Timeout { slack_ns: u64 },
    /// The deadline is a descriptor of its own; there is no timeout.
    Timer { slack_ns: u64 },
}

const WAYS: [(&str, Way); 4] = [
    (
        "ppoll with a timeout, slack 1 ns (the worker's)",
        Way::Timeout { slack_ns: 1 },
    ),
    ("timer descriptor, slack 1 ns", Way::Timer { slack_ns: 1 }),
    (
        "ppoll with a timeout, slack 50 µs (the system's)",
        Way::Timeout {
            slack_ns: USUAL_SLACK_NS,
        },
    ),
    (
        "timer descriptor, slack 50 µs",
        Way::Timer {
            slack_ns: USUAL_SLACK_NS,
        },
    ),
];

/// Measures all ways, in turns.
///
/// # Errors
/// The system refuses a descriptor, a wait, or what the scheduling asks for.
pub fn run(options: &Options) -> anyhow::Result<Report> {
    options.scheduling.apply_to_thread(0)?;
    let silent = UnixDatagram::unbound().context("a socket")?;
    let timer = timerfd_create(TimerfdClockId::Monotonic, TimerfdFlags::NONBLOCK)?;
    let mut late: Vec<Histogram<u64>> = WAYS.iter().map(|_| histogram()).collect();
    let mut cpu_ns = [0; WAYS.len()];
    for _ in 0..options.waits {
        for (place, (_, way)) in WAYS.iter().enumerate() {
            let before_ns = thread_ns();
            let late_ns = way.wait(&silent, &timer, options.length_ns)?;
            cpu_ns[place] += thread_ns() - before_ns;
            late[place].saturating_record(late_ns);
        }
    }
    let row = |place: usize| Row {
        name: WAYS[place].0.to_owned(),
        late_us: Spread::of(&late[place]),
        cpu_us: cpu_ns[place] as f64 * 1e-3 / options.waits.max(1) as f64,
    };
    Ok(Report {
        input: format!(
            "{} waits of {} ms each, the ways in turns; from the deadline to running again",
            options.waits,
            options.length_ns as f64 * 1e-6
        ),
        rows: (0..WAYS.len()).map(row).collect(),
    })
}

impl Way {
    /// Waits for a socket that stays silent until `length_ns` are over; how late that ended, ns.
    fn wait(self, silent: &UnixDatagram, timer: &OwnedFd, length_ns: u64) -> anyhow::Result<u64> {
        let (Self::Timeout { slack_ns } | Self::Timer { slack_ns }) = self;
        rustix::thread::set_current_timer_slack(NonZeroU64::new(slack_ns))?;
        let deadline_ns = clock::monotonic_ns() + length_ns;
        match self {
            Self::Timeout { .. } => {
                let mut polled = [PollFd::new(silent, PollFlags::IN)];
                let left_ns = deadline_ns.saturating_sub(clock::monotonic_ns());
                poll(&mut polled, Some(&time(left_ns)))?;
            }
            Self::Timer { .. } => {
                let due = Itimerspec {
                    it_interval: time(0),
                    it_value: time(deadline_ns),
                };
                timerfd_settime(timer, TimerfdTimerFlags::ABSTIME, &due)?;
                let mut polled = [
                    PollFd::from_borrowed_fd(silent.as_fd(), PollFlags::IN),
                    PollFd::from_borrowed_fd(timer.as_fd(), PollFlags::IN),
                ];
                poll(&mut polled, None)?;
                rustix::io::read(timer, &mut [0; 8])?;
            }
        }
        Ok(clock::monotonic_ns().saturating_sub(deadline_ns))
    }
}

fn time(ns: u64) -> Timespec {
    Timespec {
        tv_sec: (ns / 1_000_000_000).cast_signed(),
        tv_nsec: (ns % 1_000_000_000).cast_signed() as _,
    }
}

fn thread_ns() -> u64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec.cast_unsigned() * 1_000_000_000 + time.tv_nsec as u64
}

impl fmt::Display for Report {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "{}; µs: p50, p99, p99.9, max; CPU a wait", self.input)?;
        for row in &self.rows {
            let (late, cpu_us) = (line(&row.late_us), row.cpu_us);
            writeln!(out, "{:<50}{late} {cpu_us:>8.1}", row.name)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_way_of_waiting_ends_before_its_deadline_or_is_left_out() {
        let report = run(&Options {
            waits: 3,
            length_ns: 2_000_000,
            scheduling: Scheduling::default(),
        })
        .unwrap_or_else(|error| panic!("{error:#}"));
        assert_eq!(report.rows.len(), WAYS.len());
        for row in &report.rows {
            // Lateness 0 would mean that the wait ended early: waking takes longer than 1 ns.
            assert_eq!(row.late_us.count, 3, "{report}");
            assert!(row.late_us.p50_us > 0.0, "{report}");
        }
    }
}
