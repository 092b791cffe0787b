//! The columns of a trial: their names, their units, and the table that both readers fill.

use std::path::Path;

use super::{MAX_ROWS, TrialError};

/// A column of a trial, without robot and time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Column {
    /// Phase of the experiment, a number.
    Phase,
    /// Commanded linear velocity, m/s.
    V,
    /// Commanded angular velocity, rad/s.
    Omega,
    /// Position, m.
    X,
    /// Position, m.
    Y,
    /// Heading, rad.
    Theta,
    /// Battery voltage, V.
    Voltage,
    /// Battery current, A.
    Current,
    /// Electrical power, W.
    Power,
    /// Measured linear velocity, m/s; not in the array layout.
    VMeasured,
    /// Measured angular velocity, rad/s; not in the array layout.
    OmegaMeasured,
}

impl Column {
    /// All columns; the first nine are the last nine of the array layout, in its order.
    pub const ALL: [Self; 11] = [
        Self::Phase,
        Self::V,
        Self::Omega,
        Self::X,
        Self::Y,
        Self::Theta,
        Self::Voltage,
        Self::Current,
        Self::Power,
        Self::VMeasured,
        Self::OmegaMeasured,
    ];

    /// Name in a CSV header, with the unit in the file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.names()[0]
    }

    /// The names under which a CSV may have the column: with the unit, and as in the array layout.
    pub(super) const fn names(self) -> &'static [&'static str] {
        match self {
            Self::Phase => &["phase"],
            Self::V => &["v_cmd_mps", "v_cmd"],
            Self::Omega => &["omega_cmd_radps", "omega_cmd"],
            Self::X => &["x_m", "x"],
            Self::Y => &["y_m", "y"],
            Self::Theta => &["theta_rad", "theta"],
            Self::Voltage => &["voltage_mV", "voltage"],
            Self::Current => &["current_mA", "current"],
            Self::Power => &["power_mW"],
            Self::VMeasured => &["v_meas_mps", "v_meas"],
            Self::OmegaMeasured => &["omega_meas_radps", "omega_meas"],
        }
    }

    /// A value in SI units as it stands in a file.
    pub(super) const fn recorded(self, value: f64) -> f64 {
        if self.is_milli() {
            value * 1000.0
        } else {
            value
        }
    }

    const fn is_milli(self) -> bool {
        matches!(self, Self::Voltage | Self::Current | Self::Power)
    }
}

/// The names under which a CSV may have the robot.
pub(super) const ROBOT_NAMES: &[&str] = &["robot_id"];
/// The names under which a CSV may have the time.
pub(super) const TIME_NAMES: &[&str] = &["timestamp_s", "timestamp"];

/// What a reader of a file hands over: rows in file order, values in SI units.
#[derive(Debug, Default)]
pub(super) struct Table {
    pub(super) robot_name: Option<String>,
    pub(super) timestamp_s: Vec<f64>,
    pub(super) columns: [Option<Vec<f64>>; Column::ALL.len()],
    pub(super) ignored_columns: Vec<String>,
    pub(super) no_final_line_break: bool,
}

/// A value and where it stands, for checks and their messages.
#[derive(Clone, Copy)]
pub(super) struct Cell<'a> {
    pub(super) path: &'a Path,
    /// From 1.
    pub(super) row: usize,
}

impl Cell<'_> {
    pub(super) fn refuse(
        self,
        column: &'static str,
        found: impl Into<String>,
        allowed: &'static str,
    ) -> TrialError {
        TrialError::Value {
            path: self.path.to_owned(),
            row: self.row,
            column,
            found: found.into(),
            allowed,
        }
    }
}

impl Table {
    /// Takes the value of `column` in a new row, converting it to SI.
    pub(super) fn push(
        &mut self,
        cell: Cell<'_>,
        column: Column,
        recorded: f64,
    ) -> Result<(), TrialError> {
        let value = if column.is_milli() {
            recorded / 1000.0
        } else {
            recorded
        };
        self.push_si(cell, column, value)
    }

    /// Takes the value of `column` in a new row, in SI units.
    pub(super) fn push_si(
        &mut self,
        cell: Cell<'_>,
        column: Column,
        value: f64,
    ) -> Result<(), TrialError> {
        // Samples carry f32: what overflows there would arrive as infinity.
        if !value.is_nan() && !(value as f32).is_finite() {
            let allowed = "NaN, or a finite number within ±3.4e38 in SI units";
            return Err(cell.refuse(column.name(), column.recorded(value).to_string(), allowed));
        }
        self.columns[column as usize]
            .get_or_insert_default()
            .push(value);
        Ok(())
    }

    /// Takes the time of a new row.
    pub(super) fn push_time(&mut self, cell: Cell<'_>, timestamp_s: f64) -> Result<(), TrialError> {
        if self.timestamp_s.len() == MAX_ROWS {
            return Err(TrialError::TooManyRows {
                path: cell.path.to_owned(),
            });
        }
        // Sums of two such times fit i64 nanoseconds with room for repeats.
        if !(-MAX_TIMESTAMP_S..=MAX_TIMESTAMP_S).contains(&timestamp_s) {
            let allowed = "a number of seconds within ±4e9";
            return Err(cell.refuse(TIME_NAMES[0], timestamp_s.to_string(), allowed));
        }
        self.timestamp_s.push(timestamp_s);
        Ok(())
    }

    /// Takes the robot of a new row; an empty name says nothing.
    pub(super) fn push_robot(&mut self, cell: Cell<'_>, name: &str) -> Result<(), TrialError> {
        match &self.robot_name {
            _ if name.is_empty() => Ok(()),
            None => {
                self.robot_name = Some(name.to_owned());
                Ok(())
            }
            Some(first) if first == name => Ok(()),
            Some(first) => Err(TrialError::SecondRobot {
                path: cell.path.to_owned(),
                row: cell.row,
                first: first.clone(),
                found: name.to_owned(),
            }),
        }
    }
}

/// Enough for Unix seconds until the year 2096.
const MAX_TIMESTAMP_S: f64 = 4e9;
