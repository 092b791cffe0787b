//! Trials of a bag's robots.

use std::path::Path;

use joulebus_capture_format::import::{RobotReport, Row as ImportedRow};

use super::{Column, Row, Trial, TrialError};

/// The trial of a robot in a run of the recorder's clock.
#[derive(Debug)]
pub struct BagTrial {
    /// Name of the robot, and of the run if it is not the first.
    pub name: String,
    /// The robot's id in captures, if the mapping gives one.
    pub id: Option<u32>,
    /// Time of the first row, Unix ns.
    pub start_unix_ns: u64,
    /// Powers that messages had, and that were left out.
    pub left_out: usize,
    /// Its rows.
    pub trial: Trial,
}

/// Reason that a run of a robot is no trial.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum BagTrialError {
    #[error("no row of it can be used")]
    NoRow,
    #[error(
        "no reading has a power that it consumes: each is on the charger, or its current is not \
            measured. Record the robot while it drives, with a driver that measures the current"
    )]
    WithoutPower,
    #[error(transparent)]
    Trial(#[from] TrialError),
}

impl BagTrial {
    /// The trials of a robot: one for each run of the recorder's clock. `path` names the bag.
    pub fn runs<'a>(
        path: &'a Path,
        robot: &'a RobotReport,
    ) -> impl Iterator<Item = Result<Self, BagTrialError>> + 'a {
        let ends = robot.runs_from.iter().copied();
        let starts = std::iter::once(0).chain(ends.clone());
        let ends = ends.chain([robot.rows.len()]);
        starts.zip(ends).zip(1..).map(|((from, to), run)| {
            let rows = robot.rows.get(from..to).unwrap_or_default();
            let mut found = Self::new(path, robot, rows)?;
            if run > 1 {
                found.name = format!("{}_run_{run}", found.name);
                found.id = None;
            }
            Ok(found)
        })
    }

    fn new(path: &Path, robot: &RobotReport, rows: &[ImportedRow]) -> Result<Self, BagTrialError> {
        let start_ns = rows.first().ok_or(BagTrialError::NoRow)?.time_ns;
        if rows.iter().all(|row| row.power_w.is_nan()) {
            return Err(BagTrialError::WithoutPower);
        }
        let known = rows.iter().filter(|row| row.power_w.is_finite()).count();
        let charged = rows.iter().enumerate().filter(|(_, row)| row.on_charger);
        let charged: Vec<usize> = charged.map(|(at, _)| at).collect();
        let rows = rows.iter().map(|row| Row {
            timestamp_s: (row.time_ns - start_ns) as f64 / 1e9,
            values: [
                f64::NAN,
                row.v_mps,
                row.omega_radps,
                row.x_m,
                row.y_m,
                row.theta_rad,
                row.voltage_v,
                row.current_a,
                row.power_w,
                row.v_measured_mps,
                row.omega_measured_radps,
                row.soc,
            ],
        });
        let trial = Trial::from_bag(path, &robot.name, rows, &charged, robot.is_turned)?;
        let power_w = trial.column(Column::Power).unwrap_or_default();
        let kept = power_w.iter().filter(|power_w| power_w.is_finite()).count();
        Ok(Self {
            name: robot.name.clone(),
            id: robot.id,
            start_unix_ns: start_ns,
            left_out: known - kept,
            trial,
        })
    }

    /// A note on the readings that are on the charger, though no message says so.
    pub fn by_sign(&self) -> Option<String> {
        let (by_sign, of) = (self.left_out, self.trial.rows());
        (by_sign > 0).then(|| {
            format!(
                "{by_sign} of {of} readings are on the charger by the sign of their power at rest, \
                 which no message says: their power is no consumption, and unknown"
            )
        })
    }
}
