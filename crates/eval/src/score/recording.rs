//! A recording and its rows.

use std::path::PathBuf;

use joulebus_settings::Platform;
use rayon::prelude::*;

use joulebus_dataset::rows::{TrialRows, trial_rows};
use joulebus_dataset::split::{Placed, Source, SplitError, check_copies, group_of};
use joulebus_dataset::trial::{ColumnMap, Trial, TrialError};

/// A trial with its names and rows.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Id of its robot, for the live path.
    pub id: u32,
    /// Name of the trial: its file.
    pub name: String,
    /// Name of the robot: as recorded, else the file's.
    pub robot: String,
    /// Name of the group: [`group_of`] its file.
    pub group: String,
    /// The trial.
    pub trial: Trial,
    /// Rows with a forecast and a reading that follows.
    pub rows: TrialRows,
    /// For each row, the time from the previous reading to the target reading, s: the duration of
    /// the forecast.
    pub step_s: Vec<f64>,
}

impl Recording {
    /// With names derived from the trial's file.
    #[must_use]
    pub fn new(id: u32, trial: Trial) -> Self {
        let file = trial.path().file_name().and_then(|name| name.to_str());
        let file = file.unwrap_or_default().to_owned();
        let rows = trial_rows(&trial);
        let offset_ns = trial.offset_ns();
        // Sample k carries the reading of row k; its forecast is for that of row k + 1.
        let step_s = rows.sample_seq.iter().map(|seq| {
            let at = *seq as usize;
            (offset_ns[at + 1] - offset_ns[at]) as f64 * 1e-9
        });
        Self {
            id,
            name: trial.path().display().to_string(),
            robot: trial.robot_name().unwrap_or(&file).to_owned(),
            group: group_of(&file),
            step_s: step_s.collect(),
            rows,
            trial,
        }
    }

    /// As a source of a split.
    #[must_use]
    pub fn source(&self) -> Source {
        Source {
            trial: self.name.clone(),
            robot: self.robot.clone(),
            group: self.group.clone(),
            rows: self.rows.clone(),
        }
    }
}

/// Reads recordings in parallel and returns them in the order of their files. Each has the id given
/// with its file; a file with several robots yields a recording for each. `map` names the columns of
/// CSV files.
///
/// # Errors
/// The error of the first file, in their order, that cannot be read.
pub fn read_recordings(
    files: &[(u32, PathBuf)],
    map: &ColumnMap,
) -> Result<Vec<Recording>, TrialError> {
    let each = files.par_iter();
    let read = each.map(|(id, path)| -> Result<Vec<Recording>, TrialError> {
        let trials = Trial::read_mapped(path, map)?;
        let several = trials.len() > 1;
        let named = trials.into_iter().map(|trial| {
            let mut recording = Recording::new(*id, trial);
            if several {
                recording.name = format!("{} {}", recording.name, recording.robot);
            }
            recording
        });
        Ok(named.collect())
    });
    // Collected first, so that the error is always that of the first file.
    let read: Vec<Result<Vec<Recording>, TrialError>> = read.collect();
    let mut recordings = Vec::new();
    for read in read {
        recordings.extend(read?);
    }
    Ok(recordings)
}

/// A platform that accepts a trial as it was recorded: its median period, and limits that refuse
/// only values that are not finite. For recordings of robots that no config describes.
#[must_use]
pub fn recorded_platform(robot: u32, trial: &Trial) -> Platform {
    const SECOND_NS: u64 = 1_000_000_000;
    let period_ns = trial.period_ns().clamp(SECOND_NS / 10_000, 60 * SECOND_NS);
    Platform {
        name: "recorded".to_owned(),
        robots: vec![robot..=robot],
        period_ns,
        stale_after_ns: (SECOND_NS / 2).clamp(5 * period_ns, 500 * period_ns),
        hold_max_ns: u64::MAX,
        stuck_after_ns: u64::MAX,
        power_min_w: -1e6,
        power_max_w: 1e6,
        v_max_mps: 1e3,
        omega_max_radps: 1e3,
        power_resolution_w: 1e-3,
        battery: None,
        alarms: None,
        online: true,
        energy_online: true,
    }
}

/// Refuses recordings that are both evaluated and fitted on, under the same name or another.
///
/// # Errors
/// [`SplitError::Copy`] with the first duplicate.
pub fn check_apart(
    evaluated: &[Recording],
    learned: (&[Recording], &'static str),
) -> Result<(), SplitError> {
    let placed = [(evaluated, "evaluated"), learned];
    let placed = placed.into_iter().flat_map(|(recordings, part)| {
        recordings
            .iter()
            .map(move |Recording { name, rows, .. }| Placed {
                trial: name,
                rows,
                part,
            })
    });
    check_copies(placed)
}
