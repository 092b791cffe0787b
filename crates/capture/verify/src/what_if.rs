//! Comparison of models on the same recorded samples.

use std::collections::BTreeMap;
use std::fmt;

use joulebus_fleet::Fleet;
use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, SettingsError};
use joulebus_wire::{Alarm, AlarmSet, Diagnostic, tick_flag};
use serde::{Serialize, Serializer};

use crate::assemble::{Assembler, Event, TickParts};
use crate::output::Output;
use joulebus_capture_format::{Entry, Frame};

/// Runs the samples of a capture through two fleets that differ only in their models. Both begin
/// without state. The journal assigns frames to ticks.
#[derive(Debug)]
pub struct WhatIf {
    assembler: Assembler,
    recorded: ModelRun,
    other: ModelRun,
    ticks: u64,
    frames_missing: u64,
}

/// One fleet with its robots' statistics.
#[derive(Debug)]
struct ModelRun {
    fleet: Fleet,
    robots: BTreeMap<u32, RobotRun>,
}

/// Statistics of one robot.
#[derive(Debug, Clone, Copy, Default)]
struct RobotRun {
    last: Diagnostic,
    raised: AlarmSet,
    alarms: u64,
    ticks_in_alarm: u64,
}

/// Comparison of the two models.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Ticks computed.
    pub ticks: u64,
    /// Frames of samples that the capture lacks.
    pub frames_missing: u64,
    /// Hash of the recorded models, as in [`joulebus_wire::ForecastHeader::model_hash`].
    #[serde(serialize_with = "hexadecimal")]
    pub recorded_model_hash: u64,
    /// Hash of the other models.
    #[serde(serialize_with = "hexadecimal")]
    pub other_model_hash: u64,
    /// The robots, ascending.
    pub robots: Vec<RobotComparison>,
}

fn hexadecimal<S: Serializer>(hash: &u64, out: S) -> Result<S::Ok, S::Error> {
    out.collect_str(&format_args!("{hash:016x}"))
}

/// Comparison of the two models on one robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RobotComparison {
    /// The robot.
    pub robot: u32,
    /// With the recorded model.
    pub recorded: ModelScores,
    /// With the other model.
    pub other: ModelScores,
}

/// Scores of one model on one robot.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ModelScores {
    /// Forecasts with a reading.
    pub scored: u64,
    /// Mean absolute residual, W.
    pub mae_w: f64,
    /// Coefficient of determination.
    pub r2: f64,
    /// 1 − squared error over that of persistence.
    pub skill: f64,
    /// Share of readings inside their interval.
    pub coverage: f32,
    /// Alarms raised.
    pub alarms: u64,
    /// Ticks with an alarm.
    pub ticks_in_alarm: u64,
}

impl WhatIf {
    /// `models` are the worker's, `others` those to compare with, both in the order of
    /// `settings.platforms`.
    ///
    /// # Errors
    /// As [`Fleet::new`].
    pub fn new(
        settings: FleetSettings,
        models: Vec<Model>,
        others: Vec<Model>,
    ) -> Result<Self, SettingsError> {
        let run = |settings, models| -> Result<ModelRun, SettingsError> {
            Ok(ModelRun { fleet: Fleet::new(settings, models)?, robots: BTreeMap::new() })
        };
        Ok(Self {
            assembler: Assembler::new(Output::all()),
            recorded: run(settings.clone(), models)?,
            other: run(settings, others)?,
            ticks: 0,
            frames_missing: 0,
        })
    }

    /// Takes the next message of the fleet's channels.
    pub fn push(&mut self, entry: Entry) {
        self.assembler.push(entry.message);
        self.work();
    }

    /// Ends the input.
    #[must_use]
    pub fn finish(mut self) -> Comparison {
        self.assembler.finish();
        self.work();
        let robots = self.recorded.robots.iter().filter_map(|(robot, recorded)| {
            Some(RobotComparison {
                robot: *robot,
                recorded: recorded.scores(),
                other: self.other.robots.get(robot)?.scores(),
            })
        });
        Comparison {
            ticks: self.ticks,
            frames_missing: self.frames_missing,
            recorded_model_hash: self.recorded.fleet.model_hash(),
            other_model_hash: self.other.fleet.model_hash(),
            robots: robots.collect(),
        }
    }

    fn work(&mut self) {
        while let Some(event) = self.assembler.next_event() {
            if let Event::Tick { parts, .. } = event {
                let taken = parts.journal.iter().flat_map(|journal| &journal.rows);
                let missing = taken
                    .zip(&parts.frames)
                    .filter(|(taken, frame)| frame.is_none() && taken.is_frame());
                self.frames_missing += missing.count() as u64;
                self.ticks += u64::from(parts.journal.is_some());
                self.recorded.tick(&parts);
                self.other.tick(&parts);
            }
        }
    }
}

impl ModelRun {
    fn tick(&mut self, parts: &TickParts) {
        let Some(Frame { header, rows: taken }) = &parts.journal else {
            return;
        };
        crate::take(&mut self.fleet, taken, &parts.frames);
        let missed = header.flags & tick_flag::DEADLINE_MISSED != 0;
        self.fleet.tick(header.start_ns, missed);
        for place in 0..self.fleet.len() {
            let diagnostic = self.fleet.diagnostic(place);
            let run = self.robots.entry(diagnostic.robot).or_default();
            run.take(diagnostic);
        }
    }
}

impl RobotRun {
    fn take(&mut self, diagnostic: Diagnostic) {
        let alarms = diagnostic.alarms();
        // Alarms caused by the worker's delay or a charger do not depend on the model.
        let counts =
            |alarm: &Alarm| !matches!(alarm, Alarm::DeadlineMissed | Alarm::OfflineCharging);
        let raised: AlarmSet =
            alarms.iter().filter(counts).fold(AlarmSet::default(), AlarmSet::with);
        let newly = raised.iter().filter(|alarm| !self.raised.has(*alarm));
        self.alarms += newly.count() as u64;
        self.ticks_in_alarm += u64::from(raised != AlarmSet::default());
        self.raised = raised;
        self.last = diagnostic;
    }

    fn scores(&self) -> ModelScores {
        let last = &self.last;
        ModelScores {
            scored: last.scored,
            mae_w: last.mae_w,
            r2: last.r2,
            skill: last.skill,
            coverage: last.coverage,
            alarms: self.alarms,
            ticks_in_alarm: self.ticks_in_alarm,
        }
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{} ticks, {} robots: recorded model {:016x} and other model {:016x}",
            self.ticks,
            self.robots.len(),
            self.recorded_model_hash,
            self.other_model_hash
        )?;
        if self.frames_missing > 0 {
            writeln!(out, "{} frames of samples are missing", self.frames_missing)?;
        }
        writeln!(
            out,
            "{:>8} {:>8}  {:>19}  {:>17}  {:>17}  {:>13}",
            "robot", "scored", "MAE W", "R²", "coverage", "alarms"
        )?;
        for row in &self.robots {
            let (was, is) = (&row.recorded, &row.other);
            writeln!(
                out,
                "{:>8} {:>8}  {:>8.4} → {:>8.4}  {:>7.3} → {:>7.3}  {:>7.3} → {:>7.3}  {:>5} → {:>5}",
                row.robot,
                is.scored,
                was.mae_w,
                is.mae_w,
                was.r2,
                is.r2,
                was.coverage,
                is.coverage,
                was.alarms,
                is.alarms
            )?;
        }
        Ok(())
    }
}
