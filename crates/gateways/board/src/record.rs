//! The board as JSON: one object per frame. Unknown values are null.

use std::collections::BTreeMap;
use std::fmt;

use joulebus_wire::{
    ChargeState, Diagnostic, OUTLOOK_HORIZONS, OUTLOOK_S, Outlook, Quality, budget_flag,
    diagnostic_flag, forecast_flag,
};
use serde::Serialize;

use crate::board::{Board, Newest};
use crate::scores::known;

/// A frame of forecasts with the data of its tick.
#[derive(Debug, Serialize)]
pub struct FrameRecord {
    worker_epoch: u64,
    worker_pid: u32,
    tick: u64,
    sent_ns: u64,
    sent_unix_ns: u64,
    /// Hexadecimal, as `joulebus model info` prints it.
    model_hash: String,
    ticks_skipped: u64,
    ticks_late: u64,
    samples_accepted: u64,
    samples_dropped: BTreeMap<&'static str, u64>,
    /// Number of questions about plans that the worker answered. Null if it has not reported it.
    questions_answered: Option<u64>,
    questions_refused: BTreeMap<&'static str, u64>,
    /// Frames overwritten before this planner read them, since its start.
    frames_missed: u64,
    /// Whether the model of each platform fits its robots, in a sentence.
    model_fit: Vec<String>,
    robots: Vec<RobotRecord>,
}

/// One robot. The names contain the units.
#[derive(Debug, Serialize)]
pub struct RobotRecord {
    robot: u32,
    quality: &'static str,
    /// Number of readings in the window, number of open-loop steps, or the reason.
    quality_detail: Option<String>,
    sample_seq: Option<u64>,
    stamp_ns: Option<u64>,
    target_ns: Option<u64>,
    reading_w: Option<f64>,
    reading_age_ns: Option<u64>,
    power_w: Option<f64>,
    lo_w: Option<f64>,
    hi_w: Option<f64>,
    residual_w: Option<f64>,
    bias_w: Option<f64>,
    /// The network's own forecast of the next reading.
    network_w: Option<f64>,
    learned: Option<LearnedRecord>,
    scored: u64,
    mae_w: Option<f64>,
    persistence_mae_w: Option<f64>,
    r2: Option<f64>,
    persistence_r2: Option<f64>,
    skill: Option<f64>,
    coverage: Option<f64>,
    level: Option<&'static str>,
    alarms: Vec<&'static str>,
    drawn_j: Option<f64>,
    metered_s: Option<f64>,
    unmetered_s: Option<f64>,
    mean_power_w: Option<f64>,
    soc: Option<f64>,
    soc_lo: Option<f64>,
    soc_hi: Option<f64>,
    /// True if measured states of charge are part of it.
    soc_measured: Option<bool>,
    /// Measured minus true state of charge, as far as it is known.
    sensor_bias: Option<f64>,
    /// Times that another battery was noticed.
    battery_changes: Option<u32>,
    charging: Option<bool>,
    /// True if the robot has said that it is switched off.
    off: Option<bool>,
    /// Mean power at rest.
    idle_w: Option<f64>,
    /// What time without readings may have cost, and what to do.
    battery_note: Option<String>,
    usable_j: Option<f64>,
    usable_lo_j: Option<f64>,
    time_to_empty_s: Option<f64>,
    time_to_empty_lo_s: Option<f64>,
    time_to_empty_hi_s: Option<f64>,
    /// Learned capacity of the battery and its standard deviation.
    capacity_j: Option<f64>,
    capacity_sd_j: Option<f64>,
    /// Time on the charger until the battery is at 80 %, and full, by earlier charges.
    time_to_80_s: Option<f64>,
    time_to_full_s: Option<f64>,
    /// Absent unless outlooks are read.
    #[serde(skip_serializing_if = "Option::is_none")]
    outlook: Option<OutlookRecord>,
}

/// The energy that a robot will draw over each horizon if it goes on as it does, with the ends of
/// its 90 % intervals.
#[derive(Debug, Serialize)]
pub struct OutlookRecord {
    mean_w: Option<f64>,
    horizon_s: [f32; OUTLOOK_HORIZONS],
    energy_j: [Option<f64>; OUTLOOK_HORIZONS],
    energy_lo_j: [Option<f64>; OUTLOOK_HORIZONS],
    energy_hi_j: [Option<f64>; OUTLOOK_HORIZONS],
}

impl OutlookRecord {
    /// An outlook. Unknown values are `None`.
    #[must_use]
    pub fn new(outlook: &Outlook) -> Self {
        let joules = |of: [f32; OUTLOOK_HORIZONS]| of.map(|joules| known(joules.into()));
        Self {
            mean_w: known(outlook.mean_w.into()),
            horizon_s: OUTLOOK_S,
            energy_j: joules(outlook.energy_j),
            energy_lo_j: joules(outlook.energy_lo_j),
            energy_hi_j: joules(outlook.energy_hi_j),
        }
    }
}

/// Results of learning from the robot's readings: the weights of last reading, network and stack,
/// and the gains within the stack.
#[derive(Debug, Serialize)]
pub struct LearnedRecord {
    weight_last: f64,
    weight_network: f64,
    weight_stack: f64,
    held_weight_last: f64,
    held_weight_stack: f64,
    gain_last: f64,
    gain_network: f64,
    gain_mean: f64,
    level_w: f64,
    mean_w: f64,
    change_w: f64,
}

impl LearnedRecord {
    fn new(diagnostic: &Diagnostic) -> Self {
        Self {
            weight_last: diagnostic.weight_last.into(),
            weight_network: diagnostic.weight_network.into(),
            weight_stack: diagnostic.weight_stack.into(),
            held_weight_last: diagnostic.held_weight_last.into(),
            held_weight_stack: diagnostic.held_weight_stack.into(),
            gain_last: diagnostic.gain_last.into(),
            gain_network: diagnostic.gain_network.into(),
            gain_mean: diagnostic.gain_mean.into(),
            level_w: diagnostic.level_w.into(),
            mean_w: diagnostic.mean_w.into(),
            change_w: diagnostic.change_w.into(),
        }
    }
}

impl FrameRecord {
    /// The newest frame on the board, if any, with all robots or one.
    #[must_use]
    pub fn newest(board: &Board, only: Option<u32>) -> Option<Self> {
        let header = board.header()?;
        let robots = board
            .rows
            .iter()
            .filter(|(robot, _)| only.is_none_or(|only| only == **robot))
            .map(|(robot, row)| RobotRecord {
                outlook: board.outlooks.get(robot).map(OutlookRecord::new),
                ..RobotRecord::new(*robot, &row.newest())
            })
            .collect();
        Some(Self {
            worker_epoch: header.worker_epoch,
            worker_pid: header.pid,
            tick: header.tick,
            sent_ns: header.sent_ns,
            sent_unix_ns: header.sent_unix_ns,
            model_hash: format!("{:016x}", header.model_hash),
            ticks_skipped: header.ticks_skipped,
            ticks_late: header.ticks_late,
            samples_accepted: header.samples_accepted,
            samples_dropped: board.samples_dropped_by_name(),
            questions_answered: board.queries.map(|counts| counts.answered),
            questions_refused: board.questions_refused_by_name(),
            frames_missed: board.frames_missed,
            model_fit: board.model_fit(),
            robots,
        })
    }
}

impl RobotRecord {
    /// The rows of `robot`.
    #[must_use]
    pub fn new(robot: u32, newest: &Newest) -> Self {
        let forecast = &newest.forecast;
        let quality = forecast.quality();
        let sampled = forecast.flags & forecast_flag::SAMPLE != 0;
        let read = forecast.flags & forecast_flag::READING != 0;
        let interval_w = forecast.interval_w();
        let diagnostic = newest.diagnostic.as_ref();
        let residual = diagnostic.filter(|d| d.flags & diagnostic_flag::RESIDUAL != 0);
        let scores = diagnostic.filter(|d| d.flags & diagnostic_flag::SCORES != 0);
        let learned = diagnostic.filter(|d| d.flags & diagnostic_flag::LEARNED != 0);
        let score = |value: fn(&Diagnostic) -> f64| scores.and_then(|d| known(value(d)));
        let budget = newest.budget.as_ref();
        let ledger = budget.filter(|b| b.flags & budget_flag::LEDGER != 0);
        let battery = budget.filter(|b| b.flags & budget_flag::BATTERY != 0);
        let lasting = budget.filter(|b| b.flags & budget_flag::TIME_TO_EMPTY != 0);
        let seconds = |ns: u64| ns as f64 * 1e-9;
        Self {
            robot,
            quality: quality_name(quality),
            quality_detail: quality_detail(quality),
            sample_seq: sampled.then_some(forecast.sample_seq),
            stamp_ns: sampled.then_some(forecast.stamp_ns),
            target_ns: sampled.then_some(forecast.target_ns),
            reading_w: read.then(|| forecast.reading_w.into()),
            reading_age_ns: read.then_some(forecast.reading_age_ns),
            power_w: forecast.expected_w().map(f64::from),
            lo_w: interval_w.map(|(lo_w, _)| lo_w.into()),
            hi_w: interval_w.map(|(_, hi_w)| hi_w.into()),
            residual_w: residual.and_then(|d| known(d.residual_w.into())),
            bias_w: scores.and_then(|d| known(d.bias_w.into())),
            network_w: learned.and_then(|d| known(d.network_w.into())),
            learned: learned.map(LearnedRecord::new),
            scored: diagnostic.map_or(0, |d| d.scored),
            mae_w: score(|d| d.mae_w),
            persistence_mae_w: score(|d| d.persistence_mae_w),
            r2: score(|d| d.r2),
            persistence_r2: score(|d| d.persistence_r2),
            skill: score(|d| d.skill),
            coverage: score(|d| d.coverage.into()),
            level: diagnostic.map(|d| d.level().name()),
            alarms: diagnostic.map_or_else(Vec::new, |d| {
                d.alarms().iter().map(joulebus_wire::Alarm::name).collect()
            }),
            drawn_j: ledger.map(joulebus_wire::Budget::drawn_j),
            metered_s: ledger.map(|b| seconds(b.metered_ns)),
            unmetered_s: ledger.map(|b| seconds(b.unmetered_ns)),
            mean_power_w: ledger.and_then(|b| known(b.mean_power_w.into())),
            soc: battery.and_then(|b| known(b.soc.into())),
            soc_lo: battery.and_then(|b| known(b.soc_lo.into())),
            soc_hi: battery.and_then(|b| known(b.soc_hi.into())),
            soc_measured: battery.map(|b| b.flags & budget_flag::MEASURED != 0),
            sensor_bias: battery.and_then(|b| known(b.sensor_bias.into())),
            battery_changes: battery.map(|b| b.battery_changes),
            charging: budget.and_then(|b| match b.charge_state() {
                ChargeState::Charging => Some(true),
                ChargeState::Discharging => Some(false),
                ChargeState::Unknown => None,
            }),
            off: battery.map(|b| b.flags & budget_flag::OFF != 0),
            idle_w: battery.and_then(|b| known(b.idle_w.into())),
            battery_note: battery.and_then(|b| b.pause_note()),
            usable_j: battery.and_then(|b| known(b.usable_j.into())),
            usable_lo_j: battery.and_then(|b| known(b.usable_lo_j.into())),
            time_to_empty_s: lasting.and_then(|b| known(b.time_to_empty_s.into())),
            time_to_empty_lo_s: lasting.and_then(|b| known(b.time_to_empty_lo_s.into())),
            time_to_empty_hi_s: lasting.and_then(|b| known(b.time_to_empty_hi_s.into())),
            capacity_j: battery.and_then(|b| Some(b.learned_capacity_j()?.0.into())),
            capacity_sd_j: battery.and_then(|b| Some(b.learned_capacity_j()?.1.into())),
            time_to_80_s: battery.and_then(|b| b.charging_s(b.soc.into(), 0.8)),
            time_to_full_s: battery.and_then(|b| b.charging_s(b.soc.into(), 1.0)),
            outlook: None,
        }
    }
}

/// The name of a quality, without its detail.
#[must_use]
pub const fn quality_name(quality: Quality) -> &'static str {
    match quality {
        Quality::Fresh => "Fresh",
        Quality::Held => "Held",
        Quality::Warmup { .. } => "Warmup",
        Quality::OpenLoop { .. } => "OpenLoop",
        Quality::Invalid(_) => "Invalid",
        _ => "Unknown",
    }
}

fn quality_detail(quality: Quality) -> Option<String> {
    match quality {
        Quality::Warmup { have } => Some(have.to_string()),
        Quality::OpenLoop { steps } => Some(steps.to_string()),
        Quality::Invalid(reason) => Some(reason.name().to_owned()),
        _ => None,
    }
}

impl fmt::Display for FrameRecord {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "tick {} of worker {}", self.tick, self.worker_pid)
    }
}
