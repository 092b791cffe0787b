//! A planner's view of a fleet: the newest data of every robot, and the runs of workers.

use std::collections::{BTreeMap, HashMap, VecDeque};

use joulebus_connect::refusals::{Refusals, Refused};
use joulebus_wire::{
    Acknowledgement, Alarm, AlarmSet, Budget, Diagnostic, DropCounts, Forecast, ForecastHeader,
    LISTED_MODELS, Level, OUTLOOK_HORIZONS, Outlook, PlatformMemory, QueryCounts, budget_flag,
};

use crate::ahead::{Ahead, AheadScores};
use crate::scores::{Pooled, Scores};
use crate::stages::Stages;

/// Length of a robot's track and of the latency history, ticks: eight seconds at 30 Hz.
const TRACK_TICKS: usize = 240;
/// Maximum number of robots with a track. More could not be viewed anyway.
const MAX_TRACKED_ROBOTS: usize = 512;
/// Capacity of the event log.
const NOTES: usize = 200;
/// Maximum number of separate runs of workers and of sources. Beyond it the two oldest are merged.
const MAX_RUNS: usize = 1_024;
/// Departed robots whose alarms are kept.
const RAISED_ROBOTS: usize = 16_384;

/// State of the worker.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Link {
    /// No frame received yet.
    #[default]
    Waiting,
    /// Frames arrive.
    Live,
    /// The process runs, but the last frame is older than two ticks.
    Stale,
    /// The process is gone without a shutdown.
    Gone,
    /// The worker has shut down.
    Ended,
}

impl Link {
    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Live => "live",
            Self::Stale => "stale",
            Self::Gone => "gone",
            Self::Ended => "ended",
        }
    }
}

/// One run of a worker, from the headers of its frames.
#[derive(Debug, Clone, Copy)]
pub struct WorkerRun {
    /// The newest header.
    pub header: ForecastHeader,
}

impl WorkerRun {
    /// Adds the counts of an earlier run.
    fn add(&mut self, earlier: &Self) {
        let (sum, header) = (&mut self.header, &earlier.header);
        for (reason, count) in header.samples_dropped.iter() {
            sum.samples_dropped.add(reason, count);
        }
        for (sum, count) in [
            (&mut sum.samples_accepted, header.samples_accepted),
            (&mut sum.tick, header.tick),
            (&mut sum.ticks_skipped, header.ticks_skipped),
            (&mut sum.ticks_late, header.ticks_late),
        ] {
            *sum = sum.saturating_add(count);
        }
    }

    /// Samples of this run that were dropped.
    pub const fn dropped(&self) -> DropCounts {
        self.header.samples_dropped
    }
}

/// A reading and the forecast made for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// The reading, W. NaN if there was none.
    pub reading_w: f32,
    /// The forecast of the reading, W. NaN if there was none.
    pub forecast_w: f32,
    /// The interval of the forecast, W. NaN if there was none.
    pub interval_w: (f32, f32),
}

/// An alarm of a robot and when it was first seen, s since the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Raised {
    /// The alarm.
    pub alarm: Alarm,
    /// When it was first seen.
    pub at_s: f64,
}

/// The newest rows of one robot, as the worker sent them.
#[derive(Debug, Clone, Copy)]
pub struct Newest {
    /// Forecast.
    pub forecast: Forecast,
    /// Diagnostics.
    pub diagnostic: Option<Diagnostic>,
    /// Budget.
    pub budget: Option<Budget>,
}

/// The state of one robot.
#[derive(Debug, Clone, Default)]
pub struct Row {
    /// The newest forecast.
    pub forecast: Forecast,
    /// The newest diagnostics.
    pub diagnostic: Option<Diagnostic>,
    /// The newest budget.
    pub budget: Option<Budget>,
    /// Its alarms that persons have acknowledged.
    pub acknowledged: AlarmSet,
    /// The newest reading and the forecast made for it.
    pub point: Option<Point>,
    /// Points of the last eight seconds, oldest first, and none in large fleets.
    pub track: VecDeque<Point>,
    /// The newest reading minus the forecast published for it, W.
    pub residual_w: Option<f64>,
    /// Number of the frame of forecasts that it is from.
    frame: u64,
}

/// All data of the views. Pure: time is an argument.
#[derive(Debug, Clone, Default)]
pub struct Board {
    began_ns: u64,
    /// State of the worker, for people.
    pub link: Link,
    /// True if a planner may rely on the newest forecasts: none was missed.
    pub is_reliable: bool,
    /// Robots by id.
    pub rows: BTreeMap<u32, Row>,
    /// The newest outlooks by robot, none unless they are read.
    pub outlooks: HashMap<u32, Outlook>,
    /// Alarms of each robot in the order in which they were first seen, including cleared ones.
    pub raised: BTreeMap<u32, Vec<Raised>>,
    /// When alarms of the next diagnostics were raised.
    raises: HashMap<(u32, u16), u64>,
    /// Runs of workers, oldest first.
    pub runs: Vec<WorkerRun>,
    /// Runs merged into the one after them.
    merged_runs: usize,
    /// Latencies of all frames.
    pub stages: Stages,
    /// Latencies of the newest frames, µs, oldest first.
    pub recent_us: VecDeque<u64>,
    /// Samples that each run of a source has sent, by its epoch. It is empty without a tap.
    pub sent: BTreeMap<u64, u64>,
    /// Frames seen.
    pub frames: u64,
    /// Frames overwritten before this planner read them.
    pub frames_missed: u64,
    /// Number of questions about plans, if the worker reports it.
    pub queries: Option<QueryCounts>,
    /// Samples that the worker refuses, as it told last.
    pub refusals: Refusals,
    /// Event log, oldest first: time since the start, s, and text.
    pub notes: VecDeque<(f64, String)>,
    /// Names of the platforms, in the order of the config.
    platforms: Vec<String>,
    /// What their robots have shown.
    memories: Option<[PlatformMemory; LISTED_MODELS]>,
    pooled: Pooled,
    ahead: Ahead,
}

/// For each platform a sentence on whether its model fits its robots. It begins with the name where
/// there are several.
pub fn model_fit(names: &[String], memories: &[PlatformMemory]) -> Vec<String> {
    let sentence = |(name, memory): (&String, &PlatformMemory)| match names {
        [_] => memory.sentence(),
        _ => format!("{name}: {}", memory.sentence()),
    };
    names.iter().zip(memories).map(sentence).collect()
}

impl Board {
    /// An empty board. Times are relative to `now_ns` (monotonic).
    #[must_use]
    pub fn new(now_ns: u64) -> Self {
        Self { began_ns: now_ns, ..Self::default() }
    }

    /// Seconds since the start.
    #[must_use]
    pub fn seconds(&self, now_ns: u64) -> f64 {
        now_ns.saturating_sub(self.began_ns) as f64 * 1e-9
    }

    /// Restarts the time. Earlier events are at 0.
    pub fn begin(&mut self, now_ns: u64) {
        self.began_ns = now_ns;
        for (at_s, _) in &mut self.notes {
            *at_s = 0.0;
        }
    }

    /// The newest header.
    pub fn header(&self) -> Option<&ForecastHeader> {
        self.runs.last().map(|run| &run.header)
    }

    /// Adds an event to the log.
    pub fn note(&mut self, text: String, now_ns: u64) {
        let at_s = self.seconds(now_ns);
        self.notes.push_back((at_s, text));
        if self.notes.len() > NOTES {
            self.notes.pop_front();
        }
    }

    /// Sets the state of the worker, and logs a change.
    pub fn set_link(&mut self, link: Link, now_ns: u64) {
        self.is_reliable = link == Link::Live;
        if self.link == link {
            return;
        }
        let note = match (link, self.header()) {
            (Link::Live, Some(header)) if self.link == Link::Stale => {
                format!("worker {} continues", header.pid)
            }
            (Link::Stale, Some(header)) => format!("worker {} is late", header.pid),
            (Link::Gone, Some(header)) => format!("worker {} is gone", header.pid),
            (Link::Ended, Some(header)) => format!("worker {} has ended", header.pid),
            _ => String::new(),
        };
        self.link = link;
        if !note.is_empty() {
            self.note(note, now_ns);
        }
    }

    /// Adds a frame of forecasts that became readable at `readable_ns`.
    pub fn forecasts(&mut self, header: &ForecastHeader, forecasts: &[Forecast], readable_ns: u64) {
        let in_a_row = self.run(header, readable_ns);
        self.frames += 1;
        if let Some(total_ns) = self.stages.observe(header, readable_ns) {
            keep(&mut self.recent_us, total_ns / 1_000);
        }
        for forecast in forecasts {
            self.forecast(forecast, in_a_row);
        }
        if self.rows.len() > forecasts.len() {
            self.rows.retain(|_, row| row.frame == self.frames);
            self.ahead.keep(|robot| self.rows.contains_key(&robot));
        }
    }

    /// Processes a header. Returns whether the previous frame was of the same run.
    fn run(&mut self, header: &ForecastHeader, now_ns: u64) -> bool {
        let before = self.header().copied();
        let before = before.filter(|before| before.worker_epoch == header.worker_epoch);
        if let (Some(before), Some(run)) = (before, self.runs.last_mut()) {
            let missed = header.tick.saturating_sub(before.tick).saturating_sub(1);
            self.frames_missed += missed;
            run.header = *header;
            return true;
        }
        self.runs.push(WorkerRun { header: *header });
        if self.runs.len() > MAX_RUNS {
            let oldest = self.runs.remove(0);
            self.runs[0].add(&oldest);
            self.merged_runs += 1;
        }
        self.note(format!("worker {} serves the fleet", header.pid), now_ns);
        false
    }

    fn forecast(&mut self, forecast: &Forecast, in_a_row: bool) {
        let frame = self.frames;
        let tracked = self.rows.len() <= MAX_TRACKED_ROBOTS;
        let Some(row) = self.rows.get_mut(&forecast.robot) else {
            self.rows.insert(forecast.robot, Row::new(*forecast, frame));
            return;
        };
        let before = row.forecast;
        let residual_w = in_a_row.then(|| self.pooled.observe(&before, forecast));
        if forecast.sample_seq != before.sample_seq || !in_a_row {
            row.residual_w = residual_w.flatten();
        }
        let (lo_w, hi_w) = before.interval_w().unwrap_or((f32::NAN, f32::NAN));
        if forecast.sample_seq != before.sample_seq || !in_a_row {
            let point = Point {
                reading_w: forecast.reading_w,
                forecast_w: before.expected_w().filter(|_| in_a_row).unwrap_or(f32::NAN),
                interval_w: if in_a_row { (lo_w, hi_w) } else { (f32::NAN, f32::NAN) },
            };
            row.point = Some(point);
            if tracked {
                keep(&mut row.track, point);
            }
        }
        row.forecast = *forecast;
        row.frame = frame;
    }

    /// The next diagnostics may have alarms that were raised before: these, by robot and code, with
    /// their monotonic times, ns.
    pub fn know_raises(&mut self, raises: HashMap<(u32, u16), u64>) {
        self.raises = raises;
    }

    /// The names of the platforms, in the order of the config.
    pub fn name_platforms(&mut self, names: Vec<String>) {
        self.platforms = names;
    }

    /// What the robots of each platform have shown. The event log gets it once it is known.
    pub fn memories(&mut self, memories: &[PlatformMemory; LISTED_MODELS], now_ns: u64) {
        let is_known = |memory: &PlatformMemory| memory.robots >= PlatformMemory::ENOUGH;
        let before = self.memories.replace(*memories).unwrap_or_default();
        let news = memories.iter().zip(&before).map(|(now, then)| is_known(now) & !is_known(then));
        let at_s = self.seconds(now_ns);
        let fit = model_fit(&self.platforms, memories).into_iter().zip(news);
        self.notes.extend(fit.filter(|(_, is_news)| *is_news).map(|(text, _)| (at_s, text)));
    }

    /// [`model_fit`] of the platforms, as the worker told it last.
    pub fn model_fit(&self) -> Vec<String> {
        self.memories.map_or_else(Vec::new, |memories| model_fit(&self.platforms, &memories))
    }

    /// Adds a frame of diagnostics.
    pub fn diagnostics(&mut self, diagnostics: &[Diagnostic], now_ns: u64) {
        let at_s = self.seconds(now_ns);
        for diagnostic in diagnostics {
            let Some(row) = self.rows.get_mut(&diagnostic.robot) else {
                continue;
            };
            row.diagnostic = Some(*diagnostic);
            for alarm in diagnostic.alarms().iter() {
                let raised = self.raised.entry(diagnostic.robot).or_default();
                if raised.iter().all(|raised| raised.alarm != alarm) {
                    raised.push(Raised { alarm, at_s });
                    let mut note = format!("robot {}: {}", diagnostic.robot, alarm.name());
                    if let Some(raised_ns) = self.raises.get(&(diagnostic.robot, alarm.code())) {
                        let for_s = now_ns.saturating_sub(*raised_ns) as f64 * 1e-9;
                        note.push_str(&format!(", since {for_s:.0} s"));
                    }
                    self.notes.push_back((at_s, note));
                }
            }
        }
        self.raises.clear();
        while self.notes.len() > NOTES {
            self.notes.pop_front();
        }
        if self.raised.len() > RAISED_ROBOTS {
            let rows = &self.rows;
            self.raised.retain(|robot, _| rows.contains_key(robot));
        }
    }

    /// Replaces what persons have acknowledged.
    pub fn acknowledged(&mut self, rows: &[Acknowledgement]) {
        for row in self.rows.values_mut() {
            row.acknowledged = AlarmSet::default();
        }
        for one in rows {
            if let Some(row) = self.rows.get_mut(&one.robot) {
                row.acknowledged = row.acknowledged.with(one.alarm());
            }
        }
    }

    /// Replaces what the worker refuses, and logs each source and reason that is new.
    pub fn refused(&mut self, refusals: Refusals, now_ns: u64) {
        let key = |one: &Refused| (one.source, one.reason);
        let is_new = |one: &&Refused| {
            one.is_recent() && !self.refusals.sources.iter().any(|known| key(known) == key(one))
        };
        let new = refusals.sources.iter().filter(is_new).map(ToString::to_string);
        let new: Vec<String> = new.collect();
        new.into_iter().for_each(|note| self.note(note, now_ns));
        self.refusals = refusals;
    }

    /// The value for which samples of a robot are refused at present, and what is allowed.
    pub fn refused_value(&self, robot: u32) -> Option<&Refused> {
        let mut robots = self.refusals.robots.iter();
        robots.find(|refused| refused.robot == robot && refused.is_recent())
    }

    /// Replaces the outlooks, which come after the other rows of their tick, and compares earlier
    /// ones with the energy that was drawn.
    pub fn outlooks(&mut self, outlooks: &[Outlook]) {
        self.outlooks.clear();
        self.outlooks.extend(outlooks.iter().map(|outlook| (outlook.robot, *outlook)));
        for outlook in outlooks {
            if let Some(row) = self.rows.get(&outlook.robot)
                && let Some(budget) = &row.budget
            {
                self.ahead.add(outlook, budget, &row.forecast);
            }
        }
    }

    /// Adds a frame of budgets.
    pub fn budgets(&mut self, budgets: &[Budget]) {
        for budget in budgets {
            if let Some(row) = self.rows.get_mut(&budget.robot) {
                row.budget = Some(*budget);
            }
        }
    }

    /// Scores of the outlooks, if any were compared.
    pub fn ahead(&self) -> Option<[AheadScores; OUTLOOK_HORIZONS]> {
        Some(self.ahead.scores()).filter(|[shortest, ..]| shortest.compared > 0)
    }

    /// Scores of the forecasts.
    pub fn scores(&self) -> Scores {
        let diagnostics = self.rows.values().filter_map(|row| row.diagnostic.as_ref());
        Scores::of(diagnostics, &self.pooled)
    }

    /// Number of worker runs seen.
    pub fn workers(&self) -> usize {
        self.runs.len() + self.merged_runs
    }

    /// Run `epoch` of a source has sent `samples`.
    pub fn source_sent(&mut self, epoch: u64, samples: u64) {
        let sent = self.sent.entry(epoch).or_default();
        *sent = samples.max(*sent);
        if self.sent.len() > MAX_RUNS
            && let Some((_, oldest)) = self.sent.pop_first()
            && let Some(mut next) = self.sent.first_entry()
        {
            *next.get_mut() = next.get().saturating_add(oldest);
        }
    }

    /// Samples accepted by all workers.
    pub fn accepted(&self) -> u64 {
        self.runs.iter().map(|run| run.header.samples_accepted).sum()
    }

    /// Samples dropped by all workers, by reason.
    pub fn dropped(&self) -> DropCounts {
        let mut sum = DropCounts::default();
        for run in &self.runs {
            for (reason, count) in run.dropped().iter() {
                sum.add(reason, count);
            }
        }
        sum
    }

    /// Ticks done, skipped and late, all workers.
    pub fn ticks(&self) -> (u64, u64, u64) {
        self.runs.iter().fold((0, 0, 0), |sum, run| {
            let header = &run.header;
            (sum.0 + header.tick, sum.1 + header.ticks_skipped, sum.2 + header.ticks_late)
        })
    }

    /// Questions about plans, answered and refused by reason, once there were any.
    pub fn questions(&self) -> Option<String> {
        let counts = self.queries?;
        let (answered, refused) = (counts.answered, counts.total_refused());
        let reasons = counts.iter().map(|(reason, count)| format!(", {} {count}", reason.name()));
        let reasons: String = reasons.collect();
        (answered + refused > 0)
            .then(|| format!("questions {answered} ({refused} refused{reasons})"))
    }

    /// Samples that the newest worker has dropped, by reason.
    pub fn samples_dropped_by_name(&self) -> BTreeMap<&'static str, u64> {
        let headers = self.header().into_iter();
        headers
            .flat_map(|header| header.samples_dropped.iter())
            .map(|(reason, count)| (reason.name(), count))
            .collect()
    }

    /// Questions about plans that it has refused, by reason.
    pub fn questions_refused_by_name(&self) -> BTreeMap<&'static str, u64> {
        let counts = self.queries.iter();
        counts.flat_map(QueryCounts::iter).map(|(reason, count)| (reason.name(), count)).collect()
    }

    /// Number of robots at each level: ok, warn, error, stale.
    pub fn levels(&self) -> [usize; 4] {
        let mut counts = [0; 4];
        for row in self.rows.values() {
            counts[usize::from(row.level().code())] += 1;
        }
        counts
    }
}

impl Newest {
    /// The level. A robot without diagnostics is stale.
    pub fn level(&self) -> Level {
        self.diagnostic.map_or(Level::Stale, |diagnostic| diagnostic.level())
    }

    /// The state of charge, 0 to 1, if the robot has a battery whose charge is known.
    pub fn soc(&self) -> Option<f64> {
        self.budget
            .filter(|budget| budget.flags & budget_flag::BATTERY != 0)
            .map(|budget| f64::from(budget.soc))
            .filter(|soc| soc.is_finite())
    }
}

impl Row {
    fn new(forecast: Forecast, frame: u64) -> Self {
        Self { forecast, frame, ..Self::default() }
    }

    /// The newest rows.
    pub const fn newest(&self) -> Newest {
        Newest { forecast: self.forecast, diagnostic: self.diagnostic, budget: self.budget }
    }

    /// The level. A robot without diagnostics is stale.
    pub fn level(&self) -> Level {
        self.newest().level()
    }
}

fn keep<T>(track: &mut VecDeque<T>, value: T) {
    if track.len() == TRACK_TICKS {
        track.pop_front();
    }
    track.push_back(value);
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{AlarmSet, DropReason, forecast_flag};

    use super::*;

    fn header(worker_epoch: u64, tick: u64) -> ForecastHeader {
        ForecastHeader { worker_epoch, tick, pid: 7, ..ForecastHeader::default() }
    }

    fn output(robot: u32, seq: u64, reading_w: f32, power_w: f32) -> Forecast {
        Forecast {
            robot,
            flags: forecast_flag::POWER | forecast_flag::READING | forecast_flag::SAMPLE,
            sample_seq: seq,
            reading_w,
            power_w,
            source_epoch: 3,
            ..Forecast::default()
        }
    }

    #[test]
    fn missed_frames_are_counted_within_a_run_and_runs_are_kept_apart() {
        let mut board = Board::new(0);
        for (epoch, tick) in [(1, 1), (1, 2), (1, 5), (2, 1), (2, 4)] {
            let mut header = header(epoch, tick);
            header.samples_accepted = tick;
            header.samples_dropped.add(DropReason::Backlog, 1);
            board.forecasts(&header, &[], 0);
        }
        assert_eq!(board.frames_missed, 4);
        assert_eq!(board.runs.len(), 2);
        assert_eq!(board.ticks(), (9, 0, 0));
        assert_eq!(board.accepted(), 9);
        assert_eq!(board.dropped().get(DropReason::Backlog), 2);
    }

    #[test]
    fn a_point_pairs_a_reading_with_the_forecast_made_for_it() {
        let mut board = Board::new(0);
        board.forecasts(&header(1, 1), &[output(4, 0, 3.0, 3.5)], 0);
        board.forecasts(&header(1, 2), &[output(4, 0, 3.0, 3.5)], 0);
        board.forecasts(&header(1, 3), &[output(4, 1, 4.0, 4.5)], 0);
        let track = &board.rows[&4].track;
        assert_eq!(track.len(), 1);
        assert_eq!((track[0].reading_w, track[0].forecast_w), (4.0, 3.5));
        // A forecast of another worker was not made for the next reading.
        board.forecasts(&header(2, 1), &[output(4, 2, 5.0, 5.0)], 0);
        assert!(board.rows[&4].track[1].forecast_w.is_nan());
    }

    #[test]
    fn a_hundred_thousand_workers_sources_and_robots_take_bounded_memory() {
        let mut board = Board::new(0);
        for name in 1..=100_000_u32 {
            let epoch = u64::from(name);
            let mut header = header(epoch, 2);
            header.samples_accepted = 3;
            header.samples_dropped.add(DropReason::Backlog, 1);
            board.forecasts(&header, &[output(name, 0, 3.0, 3.5)], 0);
            let raising = Diagnostic {
                robot: name,
                alarms: AlarmSet::default().with(Alarm::StuckSensor).0,
                ..Diagnostic::default()
            };
            board.diagnostics(&[raising], 0);
            board.source_sent(epoch, 4);
            assert!(board.runs.len() <= MAX_RUNS && board.sent.len() <= MAX_RUNS);
            assert!(board.raised.len() <= RAISED_ROBOTS && board.rows.len() == 1);
        }
        assert_eq!(board.workers(), 100_000);
        assert_eq!((board.accepted(), board.ticks().0), (300_000, 200_000));
        assert_eq!(board.dropped().get(DropReason::Backlog), 100_000);
        assert_eq!(board.sent.values().sum::<u64>(), 400_000);
    }

    #[test]
    fn departed_robots_are_removed_and_alarms_logged_once() {
        let mut board = Board::new(0);
        board.forecasts(&header(1, 1), &[output(4, 0, 3.0, 3.5), output(5, 0, 3.0, 3.0)], 0);
        let stuck = Diagnostic {
            robot: 4,
            alarms: AlarmSet::default().with(Alarm::StuckSensor).0,
            level: Level::Error.code(),
            ..Diagnostic::default()
        };
        board.diagnostics(&[stuck], 2_000_000_000);
        board.diagnostics(&[stuck], 3_000_000_000);
        let raised = Raised { alarm: Alarm::StuckSensor, at_s: 2.0 };
        assert_eq!(board.raised[&4], [raised]);
        assert_eq!(board.levels(), [0, 0, 1, 1]);
        board.forecasts(&header(1, 2), &[output(5, 1, 3.0, 3.0)], 0);
        assert_eq!(board.rows.keys().copied().collect::<Vec<u32>>(), [5]);
    }
}
