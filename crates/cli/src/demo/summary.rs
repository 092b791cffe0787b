//! Summary of a demo.

use std::fmt;

use joulebus_board::{AheadScores, Board, Raised, Scores};
use joulebus_wire::{Level, OUTLOOK_HORIZONS};
use serde::Serialize;

use super::account::DemoCounts;
use super::capture::Captured;
use super::directory::LeftBehind;
use crate::view::count;
use crate::watch::PlannerReport;

/// A fault injected into a robot of the demo.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Planted {
    pub(super) robot: u32,
    /// The fault, in the syntax of `publish sim --fault`.
    pub(super) fault: &'static str,
    #[serde(skip)]
    pub(super) means: &'static str,
    /// When it began, s.
    pub(super) from_s: f64,
}

impl Planted {
    /// The argument of `publish sim --fault`.
    pub(super) fn argument(&self) -> String {
        format!("{}={}@{}", self.robot, self.fault, self.from_s)
    }
}

/// A robot with alarms.
#[derive(Debug, Clone, Serialize)]
struct StandsOut {
    robot: u32,
    /// Level at the end.
    level: &'static str,
    /// Reasons, in the order of their occurrence.
    reasons: Vec<Reason>,
    /// Mean of the residuals at the end, W. Positive: it draws more than forecast.
    bias_w: Option<f64>,
    /// The fault injected into it, if any.
    planted: Option<Planted>,
}

#[derive(Debug, Clone, Serialize)]
struct Reason {
    reason: &'static str,
    /// When it first occurred, s.
    at_s: f64,
}

/// Ticks of the worker.
#[derive(Debug, Clone, Serialize)]
struct Ticks {
    done: u64,
    skipped: u64,
    late: u64,
}

#[derive(Debug, Clone, Serialize)]
pub(super) struct Summary {
    robots: usize,
    seed: u64,
    /// Time from the start of the source to its end, s.
    duration_s: f64,
    ticks: Ticks,
    samples: DemoCounts,
    /// True if every sample is accounted for.
    adds_up: bool,
    /// The planner's report. `None` if it did not run at the end.
    planner: Option<PlannerReport>,
    /// Scores of the outlooks, by horizon. `None` if no second was metered.
    ahead: Option<[AheadScores; OUTLOOK_HORIZONS]>,
    /// Scores of the forecasts.
    scores: Scores,
    stand_out: Vec<StandsOut>,
    /// Faults that began but raised no alarm.
    unnoticed: Vec<Planted>,
    /// The capture. `None` if there is none, or the recorder did not report it.
    capture: Option<Captured>,
    pub(super) left_behind: LeftBehind,
}

impl Summary {
    pub(super) fn new(
        board: &Board,
        samples: DemoCounts,
        planner: Option<PlannerReport>,
        planted: &[Planted],
        (seed, duration_s): (u64, f64),
        capture: Option<Captured>,
    ) -> Self {
        let (done, skipped, late) = board.ticks();
        let stand_out: Vec<StandsOut> = board
            .raised
            .iter()
            .filter(|(_, raised)| raised.iter().any(|raised| raised.alarm.level() != Level::Ok))
            .map(|(robot, raised)| stands_out(board, *robot, raised, planted))
            .collect();
        let unnoticed = |planted: &&Planted| {
            let begun = planted.from_s < duration_s;
            begun && stand_out.iter().all(|out| out.robot != planted.robot)
        };
        Self {
            robots: board.rows.len(),
            seed,
            duration_s,
            ticks: Ticks { done, skipped, late },
            adds_up: samples.adds_up(),
            samples,
            planner,
            ahead: board.ahead(),
            scores: board.scores(),
            unnoticed: planted.iter().filter(unnoticed).cloned().collect(),
            stand_out,
            capture,
            left_behind: LeftBehind::default(),
        }
    }

    /// True if every sample is accounted for and nothing is left behind.
    pub(super) const fn is_whole(&self) -> bool {
        self.adds_up && self.left_behind.is_nothing()
    }

    fn samples_text(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let samples = &self.samples;
        let dropped: u64 = samples.dropped.values().sum();
        write!(
            out,
            "samples    {} sent = {} accepted + {} dropped",
            count(samples.sent),
            count(samples.accepted),
            count(dropped)
        )?;
        match samples.difference {
            0 => writeln!(out, "   adds up")?,
            off => writeln!(out, "   DOES NOT ADD UP: {off} unaccounted for")?,
        }
        for (reason, dropped) in &samples.dropped {
            writeln!(out, "             {reason}: {}", count(*dropped))?;
        }
        Ok(())
    }

    fn capture_text(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(capture) = &self.capture else {
            return Ok(());
        };
        let (path, lost) = (capture.path.display(), capture.messages_lost);
        let (messages, megabytes) = (count(capture.messages), capture.bytes as f64 * 1e-6);
        let per_hour = megabytes * 3.6 / capture.duration_s.max(1e-9);
        let percent = 100.0 * capture.cpu_share;
        write!(
            out,
            "capture    {path}\n             {messages} messages, {megabytes:.1} MB ({per_hour:.2} GB an \
             hour), {percent:.1} % of a core"
        )?;
        if lost > 0 {
            write!(out, ", {lost} lost")?;
        }
        match &capture.failure {
            Some(failure) => writeln!(out, "; stopped: {failure}"),
            None => writeln!(out),
        }
    }

    fn ahead_text(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(ahead) = &self.ahead else {
            return Ok(());
        };
        writeln!(out, "energy     ahead, if each robot goes on as now: error of the energy, %")?;
        writeln!(
            out,
            "  {:<7}{:>7}{:>13}{:>12}{:>8}{:>16}",
            "over", "outlook", "last reading", "mean of 5 s", "inside", "interval score"
        )?;
        let percent = |share: Option<f64>| {
            share.map_or_else(|| "–".to_owned(), |share| format!("{:.1}", 100.0 * share))
        };
        for scores in ahead.iter().filter(|scores| scores.compared > 0) {
            writeln!(
                out,
                "  {:<7}{:>7}{:>13}{:>12}{:>8}{:>16}",
                format!("{} s", scores.horizon_s),
                percent(scores.error),
                percent(scores.last_reading_error),
                percent(scores.mean_5s_error),
                percent(scores.coverage),
                percent(scores.interval_score)
            )?;
        }
        writeln!(
            out,
            "  90 % of the energies should lie inside. The interval score is relative too"
        )
    }

    fn scores_text(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scores = &self.scores;
        let number = |value: Option<f64>| {
            value.map_or_else(|| format!("{:>9}", "–"), |value| format!("{value:>9.4}"))
        };
        writeln!(out, "forecasts  {} readings scored", count(scores.scored),)?;
        let line = "persistence";
        writeln!(out, "  {:<18}{:>9} {line:>12}", "", "forecast")?;
        for (name, ours, theirs) in [
            ("RMSE, W", scores.rmse_w, scores.persistence_rmse_w),
            ("R²", scores.r2, scores.persistence_r2),
            ("R², median", scores.median_r2, scores.median_persistence_r2),
            ("MAE, W", scores.mae_w, scores.persistence_mae_w),
        ] {
            writeln!(out, "  {name:<18}{}    {}", number(ours), number(theirs))?;
        }
        if let Some(better) = scores.better_than_persistence {
            let percent = 100.0 * better;
            writeln!(
                out,
                "  {percent:.0} % of the robots have a smaller squared error than by persistence"
            )?;
        }
        writeln!(
            out,
            "  A forecast is the mean of what may come, whose sum is energy. The last reading is \
             nearer to the\n  median: two of three readings repeat (a 10 Hz monitor, 30 ticks a \
             second), and steps are rare."
        )?;
        if let Some(coverage) = scores.coverage {
            writeln!(
                out,
                "  {:.1} % of the readings lay inside the interval of their forecast",
                100.0 * coverage
            )?;
        }
        Ok(())
    }

    fn robots_text(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.stand_out.is_empty() {
            writeln!(out, "robots     none stood out")?;
        } else {
            writeln!(out, "robots     {} stood out", self.stand_out.len())?;
        }
        for robot in &self.stand_out {
            let reasons: Vec<String> = robot
                .reasons
                .iter()
                .map(|reason| format!("{} at {:.1} s", reason.reason, reason.at_s))
                .collect();
            writeln!(out, "  {:>4}  {:<6} {}", robot.robot, robot.level, reasons.join(", "))?;
            if let Some(planted) = &robot.planted {
                let (means, from_s) = (planted.means, planted.from_s);
                writeln!(out, "               planted: {means}, from {from_s} s on")?;
            }
        }
        for planted in &self.unnoticed {
            let Planted { robot, means, from_s, .. } = planted;
            writeln!(out, "  {robot:>4}  not noticed: {means}, from {from_s} s on")?;
        }
        Ok(())
    }
}

fn stands_out(board: &Board, robot: u32, raised: &[Raised], planted: &[Planted]) -> StandsOut {
    let row = board.rows.get(&robot);
    let diagnostic = row.and_then(|row| row.diagnostic);
    let bias_w = diagnostic.map(|diagnostic| f64::from(diagnostic.bias_w));
    StandsOut {
        robot,
        level: row.map_or("gone", |row| row.level().name()),
        reasons: raised
            .iter()
            .map(|raised| Reason { reason: raised.alarm.name(), at_s: raised.at_s })
            .collect(),
        bias_w: bias_w.filter(|bias_w| bias_w.is_finite()),
        planted: planted.iter().find(|planted| planted.robot == robot).cloned(),
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (robots, seed, duration_s) = (self.robots, self.seed, self.duration_s);
        writeln!(out, "\ndemo       {robots} robots, seed {seed}, {duration_s:.1} s")?;
        let Ticks { done, skipped, late } = self.ticks;
        writeln!(out, "ticks      {} done, {skipped} skipped, {late} late", count(done))?;
        self.ahead_text(out)?;
        self.samples_text(out)?;
        match &self.planner {
            Some(planner) => write!(
                out,
                "latency    {} frames read by the planner, {} missed\n{}",
                count(planner.frames),
                planner.frames_missed,
                planner.latency
            )?,
            None => writeln!(out, "latency    the planner did not run at the end")?,
        }
        self.scores_text(out)?;
        self.robots_text(out)?;
        self.capture_text(out)?;
        let left = &self.left_behind;
        if left.is_nothing() {
            writeln!(out, "memory     nothing left behind")
        } else {
            let (objects, nodes) = (left.objects, left.nodes);
            writeln!(out, "memory     LEFT BEHIND: {objects} objects, {nodes} nodes")
        }
    }
}
