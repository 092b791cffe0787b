//! Processes whose monotonic clocks differ.

use std::process::Command;

use joulebus_tests::{Arena, Child, Planner, ReaderLine, Setup};
use joulebus_wire::{Forecast, Quality};
use rustix::process::Signal;

/// Difference of the clocks, s.
const AWAY_S: i64 = 1_000;
const FAR_NS: u64 = 500_000_000_000;

/// The command in a time namespace of its own, whose clocks are `ahead_s` ahead.
fn elsewhere(command: &Command, ahead_s: i64) -> Command {
    let mut there = Command::new("unshare");
    there.args(["--time", &format!("--monotonic={ahead_s}"), &format!("--boottime={ahead_s}")]);
    there.arg(command.get_program()).args(command.get_args());
    there
}

/// True if this kernel gives a program that is started so another clock. Prints a line if it does
/// not.
fn can_differ() -> bool {
    let uptime_s = |mut command: Command| {
        let output = command.output().ok().filter(|output| output.status.success())?;
        let text = String::from_utf8(output.stdout).ok()?;
        text.split(['.', ' ']).next()?.parse::<i64>().ok()
    };
    let mut command = Command::new("cat");
    command.arg("/proc/uptime");
    let there = uptime_s(elsewhere(&command, AWAY_S));
    let works = there.zip(uptime_s(command)).is_some_and(|(there, here)| there - here > AWAY_S / 2);
    if !works {
        println!("skipped: a time namespace is not permitted here, or the kernel has none");
    }
    works
}

#[test]
fn processes_whose_clocks_differ_are_forecast_and_each_notices_a_silent_worker() {
    if !can_differ() {
        return;
    }
    let setup = Setup { rate_hz: 20.0, stale_after_s: 2.0, leave_after_s: 4.0, ..Setup::default() };
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut beside = arena.planner();
    let mut near = arena.controller("near", 0, 2, 20.0);
    let mut away: Option<Child> = None;
    for ahead_s in [AWAY_S, -AWAY_S] {
        // A source in the run before it had a clock that was ahead: it is accepted again when that
        // run has been silent.
        away.as_mut().map(Child::kill);
        let controller = arena.probe(&["controller", "away", "2", "2", "20"]);
        away = Some(Child::spawn("away", elsewhere(&controller, ahead_s)));
        let consumer = arena.probe(&["consumer"]);
        let mut planner = Planner::new(Child::spawn("planner", elsewhere(&consumer, ahead_s)));
        beside.forecast("forecasts of all robots", |frame| {
            let fresh = |line: &Forecast| {
                let ahead_ns = line.stamp_ns.cast_signed() - frame.read_ns.cast_signed();
                let far_s = if line.robot < 2 { 0 } else { ahead_s };
                let as_its_clock = (ahead_ns / 1_000_000_000 - far_s).abs() < AWAY_S / 2;
                matches!(line.quality(), Quality::Fresh | Quality::Held) && as_its_clock
            };
            (frame.robots.len() == 4 && frame.robots.iter().all(fresh)).then_some(())
        });
        let given =
            |line: &ReaderLine| matches!(line, ReaderLine::Given { robots: 4, .. }).then_some(());
        planner.until("frames of all robots", given);
        worker.signal(Signal::STOP);
        // By a clock that is ahead every frame is old.
        let age_ns = planner.until("the worker is silent", |line| match line {
            ReaderLine::Stale { age_ns } => Some(*age_ns),
            _ => None,
        });
        assert_eq!(age_ns > FAR_NS, ahead_s > 0, "{age_ns} ns by a clock {ahead_s} s ahead");
        worker.signal(Signal::CONT);
        planner.until("it continues", given);
        planner.leave();
    }
    for controller in [&mut near, away.as_mut().unwrap()] {
        controller.kill();
    }
}
