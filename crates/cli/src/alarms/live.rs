//! The changes of a running fleet.

use joulebus_bus::clock;
use joulebus_capture::Clock;
use joulebus_consumer::{AlarmChange, AlarmFeed, Change, Event, Planner};
use joulebus_program::exit::Outcome;
use joulebus_program::output::{Output, say};
use joulebus_program::stop::Stop;
use joulebus_wire::Level;

use super::command::OnAlarm;
use super::{Args, Line, s_between};

pub(super) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    let config = args.config.load()?;
    let mut watcher = Watcher {
        planner: Planner::with_config(&config, "alarms")?,
        feed: AlarmFeed::with_config(&config, "alarms")?,
        worker: None,
        sink: Sink {
            fleet: config.fleet().to_owned(),
            clock: Clock::now(),
            command: args.on_alarm.clone().map(OnAlarm::start).transpose()?,
            output,
        },
    };
    say(&format!("alarms of fleet {}, until Ctrl-C", config.fleet()));
    let length_ns = args.duration.map_or(u64::MAX, |s| (s * 1e9) as u64);
    let until_ns = clock::monotonic_ns().saturating_add(length_ns);
    let mut watched = Ok(());
    while !stop.is_asked() && clock::monotonic_ns() < until_ns && watched.is_ok() {
        watched = watcher.turn();
    }
    let missed = watcher.feed.history().ticks_missed();
    let untold = watcher.sink.command.map_or(0, OnAlarm::finish);
    watched?;
    if missed > 0 {
        say(&format!("{missed} ticks without diagnostics"));
    }
    if untold > 0 {
        say(&format!("{untold} changes were not taken by --on-alarm"));
    }
    Ok(Outcome::unless_lost(missed + untold > 0))
}

/// An alarm of the worker itself, and since when.
type OfWorker = (&'static str, Level, u64);

struct Watcher {
    planner: Planner,
    feed: AlarmFeed,
    worker: Option<OfWorker>,
    sink: Sink,
}

impl Watcher {
    /// Waits for the worker, and passes on what has changed.
    fn turn(&mut self) -> anyhow::Result<()> {
        let wait = self.feed.look_every();
        let now = match self.planner.wait_next(wait)? {
            Event::Frame(_) => Some(None),
            Event::Gone(_) => Some(Some(("WorkerGone", Level::Error))),
            Event::Stale { .. } => Some(Some(("WorkerStale", Level::Stale))),
            _ => None,
        };
        if let Some(now) = now {
            self.set_worker(now)?;
        }
        let (sink, mut told) = (&mut self.sink, Ok(()));
        self.feed.changes(|change| {
            if told.is_ok() {
                told = sink.change(&change);
            }
        })?;
        told
    }

    fn set_worker(&mut self, now: Option<(&'static str, Level)>) -> anyhow::Result<()> {
        if self.worker.map(|(alarm, level, _)| (alarm, level)) == now {
            return Ok(());
        }
        let at_ns = clock::monotonic_ns();
        if let Some((alarm, level, raised_ns)) = self.worker.take() {
            let times_ns = (raised_ns, at_ns);
            self.sink
                .tell(None, (alarm, level), Change::Cleared, times_ns)?;
        }
        if let Some((alarm, level)) = now {
            self.sink
                .tell(None, (alarm, level), Change::Raised, (at_ns, at_ns))?;
            self.worker = Some((alarm, level, at_ns));
        }
        Ok(())
    }
}

/// Where changes go.
struct Sink {
    fleet: String,
    clock: Clock,
    command: Option<OnAlarm>,
    output: Output,
}

impl Sink {
    fn change(&mut self, change: &AlarmChange) -> anyhow::Result<()> {
        let alarm = (change.alarm.name(), change.alarm.level());
        let times_ns = (change.raised_ns, change.at_ns);
        self.tell(Some(change.robot), alarm, change.change, times_ns)
    }

    /// The command first: a full disk of stdout does not keep it from being run.
    fn tell(
        &mut self,
        robot: Option<u32>,
        (alarm, level): (&'static str, Level),
        change: Change,
        (raised_ns, at_ns): (u64, u64),
    ) -> anyhow::Result<()> {
        let ended = change != Change::Raised;
        let line = Line {
            fleet: self.fleet.clone(),
            stamp_ns: self.clock.unix_ns(at_ns),
            robot,
            alarm,
            level: level.name(),
            change: change.name(),
            lasted_s: ended.then(|| s_between(raised_ns, at_ns)),
        };
        if let Some(command) = &mut self.command {
            command.tell(&line);
        }
        self.output.line(&line)
    }
}
