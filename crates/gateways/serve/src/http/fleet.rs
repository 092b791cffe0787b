//! The fleet as a whole: worker, ticks, counts and sums.

use std::collections::BTreeMap;

use joulebus_board::{AheadScores, Board, Counted, Link, UPPER_S};
use joulebus_connect::refusals::{Refusals, Refused};
use joulebus_wire::{OUTLOOK_HORIZONS, budget_flag, forecast_flag};
use serde::Serialize;

/// The state of a fleet.
#[derive(Debug, Clone, Serialize)]
pub(super) struct FleetRecord {
    fleet: String,
    now_unix_ns: u64,
    pub(super) worker: WorkerRecord,
    tick: Option<u64>,
    period_s: f64,
    tick_s: TickTimes,
    ticks_skipped: Option<u64>,
    ticks_late: Option<u64>,
    samples_accepted: Option<u64>,
    samples_dropped: BTreeMap<&'static str, u64>,
    frames_missed: u64,
    latency_s: LatencyTimes,
    questions_answered: Option<u64>,
    questions_refused: BTreeMap<&'static str, u64>,
    /// Same as in `watch --format json`.
    model_hash: Option<String>,
    /// Platforms whose limits of power do not fit their model's training.
    model_warnings: Vec<String>,
    /// Samples that the worker refuses at present: by robot for values, else by source.
    refusals: Vec<RefusalRecord>,
    /// Whether the model of each platform fits its robots, in a sentence.
    model_fit: Vec<String>,
    pub(super) totals: Totals,
    /// Processes that record, if they are known.
    recorders: Option<Vec<Recorder>>,
    /// Scores of the outlooks that clients have asked for, by horizon, if any were compared.
    ahead: Option<[AheadScores; OUTLOOK_HORIZONS]>,
}

/// Refused samples of a robot, or of a source.
#[derive(Debug, Clone, Serialize)]
struct RefusalRecord {
    /// The robot of the newest one.
    robot: u32,
    reason: &'static str,
    count: u64,
    /// The field, its value and its range. Null if no value is at fault.
    found: Option<String>,
    remedy: &'static str,
}

impl From<&Refused> for RefusalRecord {
    fn from(refused: &Refused) -> Self {
        Self {
            robot: refused.robot,
            reason: refused.reason.name(),
            count: refused.count,
            found: refused.found.clone(),
            remedy: refused.reason.remedy(),
        }
    }
}

#[derive(Debug, Clone, Serialize)]
pub(super) struct WorkerRecord {
    /// waiting, alive, stale or gone.
    pub(super) state: &'static str,
    /// Time since the newest frame was sent, s.
    age_s: Option<f64>,
    /// Reason that the worker is not alive.
    pub(super) reason: Option<String>,
    pid: Option<u32>,
    epoch: Option<u64>,
}

/// Times of a tick, from its begin to its last forecast written.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct TickTimes {
    last: Option<f64>,
    p50: Option<f64>,
    p99: Option<f64>,
    max: Option<f64>,
}

/// Latencies from sending a sample to sending its forecast.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct LatencyTimes {
    p50: Option<f64>,
    p99: Option<f64>,
    p999: Option<f64>,
    max: Option<f64>,
    /// Upper bound, s, null for the last, and the frames between it and the one before.
    histogram: Vec<(Option<f64>, u64)>,
}

/// Sums over the robots.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub(super) struct Totals {
    pub(super) robots: usize,
    pub(super) ok: usize,
    pub(super) warn: usize,
    pub(super) error: usize,
    pub(super) stale: usize,
    /// Sum of the newest readings, W. Null if there is none.
    pub(super) power_w: Option<f64>,
    /// Sum of the ledgers, J. Null if there is none.
    pub(super) drawn_j: Option<f64>,
    pub(super) alarms: usize,
}

/// A process that records the fleet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct Recorder {
    pub(super) name: String,
    pub(super) pid: Option<u32>,
}

/// Distributions, which take longer to compute than a frame is read.
#[derive(Debug, Clone, Default)]
pub(super) struct Distributions {
    tick_s: TickTimes,
    latency_s: LatencyTimes,
}

impl Distributions {
    pub(super) fn new(board: &Board) -> Self {
        let latency = board.stages.latency();
        let (tick, total) = (latency.compute, latency.total);
        let seconds = |count: u64, us: f64| (count > 0).then_some(us * 1e-6);
        Self {
            tick_s: TickTimes {
                last: None,
                p50: seconds(tick.count, tick.p50_us),
                p99: seconds(tick.count, tick.p99_us),
                max: seconds(tick.count, tick.max_us),
            },
            latency_s: LatencyTimes {
                p50: seconds(total.count, total.p50_us),
                p99: seconds(total.count, total.p99_us),
                p999: seconds(total.count, total.p999_us),
                max: seconds(total.count, total.max_us),
                histogram: histogram(&board.stages.total_counted),
            },
        }
    }
}

fn histogram(counted: &Counted) -> Vec<(Option<f64>, u64)> {
    let uppers = UPPER_S.into_iter().map(Some).chain([None]);
    uppers.zip(counted.counts).collect()
}

/// Inputs of a record that are not on the board.
pub(super) struct Around<'a> {
    pub(super) fleet: &'a str,
    pub(super) period_ns: u64,
    pub(super) stale_after_ns: u64,
    pub(super) now_ns: u64,
    pub(super) now_unix_ns: u64,
    pub(super) distributions: &'a Distributions,
    pub(super) recorders: Option<Vec<Recorder>>,
    pub(super) model_warnings: &'a [String],
    /// What to do if no worker is seen.
    pub(super) without_worker: &'a str,
}

impl FleetRecord {
    pub(super) fn new(board: &Board, around: &Around<'_>) -> Self {
        let header = board.header();
        let mut tick_s = around.distributions.tick_s.clone();
        tick_s.last = header.map(|header| {
            header.compute_end_ns.saturating_sub(header.compute_start_ns) as f64 * 1e-9
        });
        Self {
            fleet: around.fleet.to_owned(),
            now_unix_ns: around.now_unix_ns,
            worker: WorkerRecord::new(board, around),
            tick: header.map(|header| header.tick),
            period_s: around.period_ns as f64 * 1e-9,
            tick_s,
            ticks_skipped: header.map(|header| header.ticks_skipped),
            ticks_late: header.map(|header| header.ticks_late),
            samples_accepted: header.map(|header| header.samples_accepted),
            samples_dropped: board.samples_dropped_by_name(),
            frames_missed: board.frames_missed,
            latency_s: around.distributions.latency_s.clone(),
            questions_answered: board.queries.map(|counts| counts.answered),
            questions_refused: board.questions_refused_by_name(),
            model_hash: header.map(|header| format!("{:016x}", header.model_hash)),
            model_warnings: around.model_warnings.to_vec(),
            refusals: {
                let Refusals { sources, robots } = &board.refusals;
                let told = |one: &&Refused| robots.iter().any(|robot| robot.reason == one.reason);
                let all = robots.iter().chain(sources.iter().filter(|one| !told(one)));
                all.filter(|refused| refused.is_recent()).map(RefusalRecord::from).collect()
            },
            model_fit: board.model_fit(),
            totals: Totals::new(board),
            recorders: around.recorders.clone(),
            ahead: board.ahead(),
        }
    }
}

impl WorkerRecord {
    fn new(board: &Board, around: &Around<'_>) -> Self {
        let header = board.header();
        let age_ns = header.map(|header| around.now_ns.saturating_sub(header.sent_ns));
        let age_s = age_ns.map(|age_ns| age_ns as f64 * 1e-9);
        let (state, reason) = match board.link {
            Link::Waiting => {
                ("waiting", Some(format!("no frame has arrived: {}", around.without_worker)))
            }
            Link::Live => ("alive", None),
            Link::Stale => (
                "stale",
                Some(format!(
                    "its newest frame is {:.2} s old, {:.2} s are allowed: see `joulebus doctor`",
                    age_s.unwrap_or_default(),
                    around.stale_after_ns as f64 * 1e-9
                )),
            ),
            Link::Gone => ("gone", Some("its process ended without a shutdown".to_owned())),
            Link::Ended => ("gone", Some("it has shut down".to_owned())),
        };
        Self {
            state,
            age_s,
            reason,
            pid: header.map(|header| header.pid),
            epoch: header.map(|header| header.worker_epoch),
        }
    }
}

impl Totals {
    fn new(board: &Board) -> Self {
        let [ok, warn, error, stale] = board.levels();
        let rows = || board.rows.values();
        let read = rows().filter(|row| row.forecast.flags & forecast_flag::READING != 0);
        let ledgers = rows().filter_map(|row| row.budget);
        let ledgers = ledgers.filter(|budget| budget.flags & budget_flag::LEDGER != 0);
        Self {
            robots: board.rows.len(),
            ok,
            warn,
            error,
            stale,
            power_w: sum(read.map(|row| row.forecast.reading_w.into())),
            drawn_j: sum(ledgers.map(|budget| budget.drawn_j())),
            alarms: rows()
                .filter_map(|row| row.diagnostic)
                .map(|diagnostic| diagnostic.alarms().iter().count())
                .sum(),
        }
    }
}

/// The sum. `None` if empty or if any value is not finite.
fn sum(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
    (count > 0 && f64::is_finite(sum)).then_some(sum)
}
