//! Records a run of one robot as rows of the published table.

use std::path::Path;

use joulebus_dataset::trial::{Column, Row, Trial};
use joulebus_plant::arena::{Command, STEP_S};
use joulebus_plant::body::Body;

/// Length of a step in whole ns.
const STEP_NS: u64 = 33_000_000;

/// The rows so far.
pub(super) struct Recorder {
    rows: Vec<Row>,
}

impl Recorder {
    pub(super) fn with_capacity(rows: usize) -> Self {
        Self { rows: Vec::with_capacity(rows) }
    }

    /// Advances the body through step `step` (from 0) under a command, and records the result.
    pub(super) fn step(&mut self, body: &mut Body, step: usize, phase: u32, command: Command) {
        let start_ns = step as u64 * STEP_NS;
        body.run(start_ns, start_ns + STEP_NS, command);
        let measured = body.measured;
        let mut values = [f64::NAN; Column::ALL.len()];
        for (column, value) in [
            (Column::Phase, f64::from(phase)),
            (Column::V, command.v_mps),
            (Column::Omega, command.omega_radps),
            (Column::X, body.pose.at_m.x),
            (Column::Y, body.pose.at_m.y),
            (Column::Theta, body.pose.theta_rad),
            (Column::Voltage, measured.voltage_v),
            (Column::Current, measured.current_a),
            (Column::Power, measured.power_w),
        ] {
            values[column as usize] = value;
        }
        self.rows.push(Row { timestamp_s: (step + 1) as f64 * STEP_S, values });
    }

    /// The trial of the rows, at least two.
    pub(super) fn finish(self, path: &Path, robot: u32) -> Trial {
        let trial = Trial::from_rows(path, &robot.to_string(), self.rows);
        // Times increase by a constant step and every number is bounded by the arena, the commands
        // and the battery, so that no row can be refused.
        trial.expect("the plant yields finite numbers and increasing times")
    }
}
