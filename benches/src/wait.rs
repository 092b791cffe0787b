//! Overshoot of a wait for a descriptor with a deadline, by how the deadline is passed to the
//! system: as the timeout of `ppoll`, or as a timer descriptor polled as well. The worker's method
//! is chosen by this figure.

use std::num::NonZeroU64;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixDatagram;

use crate::arguments::BenchOptions;
use anyhow::Context;
use joulebus_bus::{clock, schedule_thread};
use rustix::event::{PollFd, PollFlags, poll};
use rustix::time::{
    ClockId, Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec, clock_gettime,
    timerfd_create, timerfd_settime,
};

use crate::{Figure, Report, threads};

/// Linux's default timer slack, ns.
const USUAL_SLACK_NS: u64 = 50_000;

/// A method of waiting.
#[derive(Debug, Clone, Copy)]
enum WaitMethod {
    /// The deadline is the timeout.
    Timeout { slack_ns: u64 },
    /// The deadline is a timer descriptor. There is no timeout.
    Timer { slack_ns: u64 },
}

const METHODS: [(&str, WaitMethod); 4] = [
    ("ppoll with a timeout, slack 1 ns (the worker's)", WaitMethod::Timeout { slack_ns: 1 }),
    ("timer descriptor, slack 1 ns", WaitMethod::Timer { slack_ns: 1 }),
    (
        "ppoll with a timeout, slack 50 µs (the system's)",
        WaitMethod::Timeout { slack_ns: USUAL_SLACK_NS },
    ),
    ("timer descriptor, slack 50 µs", WaitMethod::Timer { slack_ns: USUAL_SLACK_NS }),
];

/// Measures all methods, interleaved.
///
/// # Errors
/// The system refuses a descriptor, a wait, or the requested scheduling.
pub(crate) fn measure(options: &BenchOptions) -> anyhow::Result<Report> {
    let length_ns = 1_000_000_000 / options.rate_hz;
    schedule_thread(&threads::scheduling(options), 0)?;
    let silent = UnixDatagram::unbound().context("a socket")?;
    let timer = timerfd_create(TimerfdClockId::Monotonic, TimerfdFlags::NONBLOCK)?;
    let mut late_us = METHODS.map(|_| Vec::new());
    let mut cpu_us = METHODS.map(|_| Vec::new());
    for _ in 0..options.repetitions_or(300) {
        for (place, (_, method)) in METHODS.iter().enumerate() {
            let before_ns = thread_ns();
            late_us[place].push(method.wait(&silent, &timer, length_ns)? as f64 * 1e-3);
            cpu_us[place].push((thread_ns() - before_ns) as f64 * 1e-3);
        }
    }
    let mut report = Report::new("wait").with_input("rate_hz", options.rate_hz);
    for (name, values) in [("late_us", &late_us), ("cpu_us", &cpu_us)] {
        for ((method, _), values) in METHODS.iter().zip(values) {
            report.push(Figure::less, name, method, "µs", values);
        }
    }
    report.notes = vec![
        "A wait takes one period. Late: from the deadline to the thread running again. CPU: the \
         thread's time for one wait."
            .to_owned(),
    ];
    Ok(report)
}

impl WaitMethod {
    /// Waits `length_ns` for a socket that stays silent. Returns the overshoot, ns.
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
                let due = Itimerspec { it_interval: time(0), it_value: time(deadline_ns) };
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

#[cfg(test)]
mod tests {
    use crate::arguments::BenchArguments;
    use clap::{Args as _, FromArgMatches as _};

    use super::*;

    #[test]
    fn no_method_of_waiting_ends_before_its_deadline_or_is_missing() {
        let arguments = ["bench", "wait", "--repetitions", "3", "--rate-hz", "500"];
        let arguments = BenchArguments::augment_args(clap::Command::new("bench"))
            .try_get_matches_from(arguments)
            .and_then(|matches| BenchArguments::from_arg_matches(&matches))
            .unwrap_or_else(|error| panic!("{error}"));
        let report = measure(&arguments.options).unwrap_or_else(|error| panic!("{error:#}"));
        let late = report.figures.iter().filter(|figure| figure.name == "late_us");
        let late: Vec<_> = late.collect();
        assert_eq!(late.len(), METHODS.len());
        for figure in late {
            // An overshoot of 0 would mean that the wait ended early: waking takes longer than 1
            // ns.
            assert_eq!(figure.spread.count, 3, "{report}");
            assert!(figure.spread.p50 > 0.0, "{report}");
        }
    }
}
