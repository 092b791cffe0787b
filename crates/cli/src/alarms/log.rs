//! The alarms of the robots in the worker's log: a line for each raise and each end, and one for
//! many robots of which the same is true at once, as when their source or link is gone.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use joulebus_bus::{Background, Steps, ThreadWatch};
use joulebus_config::Config;
use joulebus_connect::ConnectError;
use joulebus_connect::raises::RaisesFile;
use joulebus_connect::refusals::{Refusals, RefusalsFile, Refused};
use joulebus_consumer::{AlarmChange, AlarmFeed, Change, FleetAlarm};
use joulebus_plan::report::Lasting;
use joulebus_predictor_worker::{RefusalLog, RefusedSamples};
use joulebus_program::logging::ALARMS;
use joulebus_wire::{DropReason, Level};
use serde::Serialize;

/// Pause before the diagnostics are opened again.
const OPEN_EVERY: Duration = Duration::from_secs(1);
/// Interval of telling what is refused.
const TELL_EVERY: Duration = Duration::from_millis(500);
/// Interval of checking whether the worker is open.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Counts of logged alarms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub(crate) struct AlarmReport {
    /// Alarms that were raised.
    pub(crate) raised: u64,
    /// Alarms that a person acknowledged.
    pub(crate) acknowledged: u64,
    /// Alarms that ended, those of robots that left included.
    pub(crate) ended: u64,
    /// Ticks without diagnostics: alarms that were raised and cleared within them are not known.
    pub(crate) ticks_missed: u64,
}

/// A thread that logs alarms, stopped when dropped. It reads as a planner, not in the tick.
pub(crate) struct AlarmLog {
    thread: Background,
    report: Arc<Mutex<AlarmReport>>,
    may_open: Arc<AtomicBool>,
    refusals: Arc<Mutex<RefusalLog>>,
}

impl AlarmLog {
    /// Starts the thread, which waits for [`AlarmLog::open`]. Call it before the worker is opened,
    /// whose CPUs and priority the thread would inherit.
    pub(crate) fn start(config: &Config) -> std::io::Result<Self> {
        let report = Arc::<Mutex<AlarmReport>>::default();
        let (config, shared) = (config.clone(), Arc::clone(&report));
        let may_open = Arc::<AtomicBool>::default();
        let worker_is_open = Arc::clone(&may_open);
        let refusals = Arc::<Mutex<RefusalLog>>::default();
        let refused = Arc::clone(&refusals);
        let thread = Background::start("joulebus-alarms", move || {
            Ok::<_, std::io::Error>(Logging {
                raises: RaisesFile::new(&config).ok(),
                refusals_file: RefusalsFile::new(&config).ok(),
                refusals: refused,
                told: None,
                config,
                feed: None,
                before: AlarmReport::default(),
                report: shared,
                worker_is_open,
                failed: false,
            })
        })?;
        Ok(Self { thread, report, may_open, refusals })
    }

    /// Where the worker tells its refusals.
    pub(crate) fn refusals(&self) -> Arc<Mutex<RefusalLog>> {
        Arc::clone(&self.refusals)
    }

    /// Opens the diagnostics, once the worker holds the fleet's lock.
    pub(crate) fn open(&self) {
        self.may_open.store(true, Ordering::Relaxed);
    }

    /// Tells whether the thread has ended.
    pub(crate) fn watch(&self) -> ThreadWatch {
        self.thread.watch()
    }

    /// Logs what the worker has sent so far, and ends the thread.
    pub(crate) fn finish(mut self) -> AlarmReport {
        if let Err(error) = self.thread.finish() {
            tracing::error!("{error}");
        }
        *self.report.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct Logging {
    config: Config,
    /// For readers that start later.
    raises: Option<RaisesFile>,
    refusals_file: Option<RefusalsFile>,
    refusals: Arc<Mutex<RefusalLog>>,
    told: Option<Instant>,
    feed: Option<AlarmFeed>,
    /// Totals of earlier feeds.
    before: AlarmReport,
    report: Arc<Mutex<AlarmReport>>,
    worker_is_open: Arc<AtomicBool>,
    failed: bool,
}

impl Logging {
    /// The feed, opened if there is none. A failure is logged once, until a feed is opened.
    fn feed(&mut self) -> Option<&mut AlarmFeed> {
        if self.feed.is_none() {
            match AlarmFeed::with_config(&self.config, "alarm-log") {
                Ok(feed) => {
                    self.feed = Some(feed);
                    self.failed = false;
                }
                Err(error) => self.fails(&error),
            }
        }
        self.feed.as_mut()
    }

    /// Tells the sources and views what the worker refuses.
    fn tell_refusals(&mut self) {
        let Some(file) = &mut self.refusals_file else {
            return;
        };
        if self.told.is_some_and(|told| told.elapsed() < TELL_EVERY) {
            return;
        }
        self.told = Some(Instant::now());
        let settings = self.config.settings();
        let refused = |one: &RefusedSamples| Refused {
            source: (one.source_id, one.source_epoch),
            robot: one.sample.robot,
            reason: one.reason,
            count: one.count,
            at_ns: one.at_ns,
            // Another reason may have come first: then the values are not at fault.
            found: (settings.refusal(&one.sample))
                .filter(|refused| refused.reason == one.reason)
                .filter(|_| one.reason != DropReason::UnknownRobot)
                .map(|refused| refused.found()),
        };
        let log = self.refusals.lock().unwrap_or_else(PoisonError::into_inner);
        let list = |list: &[RefusedSamples]| list.iter().map(refused).collect();
        let refusals = Refusals { sources: list(log.sources()), robots: list(log.robots()) };
        drop(log);
        if let Err(error) = file.write(refusals) {
            tracing::debug!(%error, "sources do not learn what is refused");
        }
    }

    fn fails(&mut self, error: &ConnectError) {
        if !std::mem::replace(&mut self.failed, true) {
            tracing::warn!(%error, "alarms are not logged at present");
        }
    }
}

impl Steps for Logging {
    fn step(&mut self, last: bool) -> Option<Duration> {
        if !self.worker_is_open.load(Ordering::Relaxed) {
            return (!last).then_some(POLL_INTERVAL);
        }
        self.tell_refusals();
        let mut report = *self.report.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(feed) = self.feed() else {
            return (!last).then_some(OPEN_EVERY);
        };
        let mut changes = Vec::new();
        let read = feed.changes(|change| {
            changes.push(change);
            match change.change {
                Change::Raised => report.raised += 1,
                Change::Cleared | Change::Left => report.ended += 1,
                Change::Acknowledged => report.acknowledged += 1,
                _ => {}
            }
        });
        let (missed, pause) = (feed.history().ticks_missed(), feed.look_every());
        let run = feed.history().run().filter(|_| !changes.is_empty());
        let raised: Vec<_> = run.iter().flat_map(|_| feed.history().raised()).collect();
        if let (Some(raises), Some(run)) = (&self.raises, run)
            && let Err(error) = raises.write(run, raised.into_iter())
        {
            tracing::debug!(%error, "readers that start later count alarms from their start");
        }
        report.ticks_missed = self.before.ticks_missed.saturating_add(missed);
        *self.report.lock().unwrap_or_else(PoisonError::into_inner) = report;
        log_all(&mut changes);
        if last {
            return None;
        }
        if let Err(error) = read {
            // Diagnostics of another version, or removed files: the worker notices that too.
            tracing::warn!(%error, "alarms cannot be read: they are opened again");
            self.before = report;
            self.feed = None;
            return Some(OPEN_EVERY);
        }
        Some(pause)
    }
}

/// More robots than these share one line.
const MAX_LINES: usize = 8;
/// Ranges of robots that a line names.
const MAX_RANGES: usize = 16;

/// The changes of one look, in the order of their ticks: of few robots a line each, of many one
/// line. What persons do has a line each.
fn log_all(changes: &mut [AlarmChange]) {
    let key = |change: &AlarmChange| (change.at_ns, change.alarm.name(), change.change.name());
    changes.sort_by_key(|change| (key(change), change.robot));
    for alike in changes.chunk_by(|a, b| key(a) == key(b)) {
        match alike {
            [first, ..] if alike.len() > MAX_LINES && first.change != Change::Acknowledged => {
                let ids: Vec<u32> = alike.iter().map(|change| change.robot).collect();
                log_many(first, alike.len(), &ranges(&ids));
            }
            _ => alike.iter().for_each(log),
        }
    }
}

fn log_many(first: &AlarmChange, robots: usize, ids: &str) {
    let (alarm, level) = (first.alarm.name(), first.alarm.level());
    let (level_name, what) = (level.name(), first.change.name());
    match (first.change, level) {
        (Change::Raised, Level::Error) => {
            tracing::error!(target: ALARMS, robots, ids, alarm, level = level_name, change = what, "alarm raised of {robots} robots");
        }
        (Change::Raised, _) => {
            tracing::warn!(target: ALARMS, robots, ids, alarm, level = level_name, change = what, "alarm raised of {robots} robots");
        }
        _ => {
            tracing::info!(target: ALARMS, robots, ids, alarm, level = level_name, change = what, "alarm {what} of {robots} robots");
        }
    }
}

/// Ids in ascending order as ranges, `0-9, 12`. Those that are too many are left out.
fn ranges(ids: &[u32]) -> String {
    let mut ranges = ids.chunk_by(|a, b| a.checked_add(1) == Some(*b));
    let shown = ranges.by_ref().take(MAX_RANGES).map(|range| match range {
        [one] => one.to_string(),
        _ => format!("{}-{}", range[0], range[range.len() - 1]),
    });
    let mut text = shown.collect::<Vec<_>>().join(", ");
    let more = ranges.map(<[u32]>::len).sum::<usize>();
    if more > 0 {
        text += &format!(" and {more} more");
    }
    text
}

#[cfg(test)]
#[test]
fn ids_are_shown_as_ranges_and_not_without_end() {
    let odd: Vec<u32> = (0..100).map(|id| 2 * id).collect();
    for (ids, shown) in [
        (&[7][..], "7".to_owned()),
        (&[0, 1, 2, 5, 7, 8], "0-2, 5, 7-8".to_owned()),
        (&[u32::MAX - 1, u32::MAX], "4294967294-4294967295".to_owned()),
        (&odd, {
            let first: Vec<String> = odd[..16].iter().map(u32::to_string).collect();
            format!("{} and 84 more", first.join(", "))
        }),
    ] {
        assert_eq!(ranges(ids), shown);
    }
}

/// One line, at the level of the alarm. Ends at that of information, which the default shows.
fn log(change: &AlarmChange) {
    let (robot, alarm, level) = (change.robot, change.alarm.name(), change.alarm.level());
    let (level_name, what) = (level.name(), change.change.name());
    match (change.change, level) {
        (Change::Raised, Level::Error) => {
            tracing::error!(target: ALARMS, robot, alarm, level = level_name, change = what, "alarm raised");
        }
        (Change::Raised, _) => {
            tracing::warn!(target: ALARMS, robot, alarm, level = level_name, change = what, "alarm raised");
        }
        (Change::Acknowledged, _) => {
            let by = change.acknowledged.as_ref().map(|row| row.by()).unwrap_or_default();
            tracing::info!(target: ALARMS, robot, alarm, level = level_name, change = what, by, "alarm acknowledged by {by}");
        }
        _ => {
            let lasted_s = FleetAlarm::from(*change).lasted_s().unwrap_or_default();
            let lasted = Lasting(lasted_s);
            tracing::info!(target: ALARMS, robot, alarm, level = level_name, change = what, lasted_s, "alarm ended after {lasted}");
        }
    }
}
