//! The native half of the Python package `joulebus`: `joulebus._native`. The other half, in
//! `python/joulebus`, documents what users call and adds what needs no speed.
//! With the feature `lab` it is `joulebus_lab._native`, which has everything that the other has.
//!
//! Array arguments are copied before the interpreter is released, so another Python thread that
//! writes into them changes no computation. No `unsafe` is written here: NumPy itself makes arrays
//! over shared memory, from `__array_interface__` (`planner.rs`).
#![forbid(unsafe_code)]
#![allow(clippy::needless_pass_by_value, reason = "what Python passes arrives as owned values")]

mod array;
mod batteries;
mod demo;
mod dtype;
mod energy_predictor;
mod error;
#[cfg(feature = "lab")]
mod lab;
mod model;
mod online;
mod planner;
mod port_thread;
mod predictor;
mod publisher;
mod questions;
#[cfg(feature = "lab")]
mod recordings;
#[cfg(feature = "lab")]
mod training;

use pyo3::prelude::pymodule;

#[pymodule]
mod _native {
    #[pymodule_export]
    use crate::batteries::Batteries;
    #[pymodule_export]
    use crate::demo::{DemoRobots, DemoWorker, demo_config, sweep_demo};
    #[pymodule_export]
    use crate::energy_predictor::EnergyPredictor;
    #[pymodule_export]
    use crate::error::{ConnectError, Error, ModelError, PublishError, ReadError, RecordingError};
    #[cfg(feature = "lab")]
    #[pymodule_export]
    use crate::lab::{
        Report, analyze, evaluate, report_recorded, report_simulated, simulate, train_recordings,
        train_simulated, trips,
    };
    #[pymodule_export]
    use crate::online::OnlineRobots;
    #[pymodule_export]
    use crate::planner::{FrameMemory, PlannerPorts, quality};
    #[pymodule_export]
    use crate::predictor::Predictor;
    #[pymodule_export]
    use crate::publisher::PublisherPort;
    #[pymodule_export]
    use crate::questions::{QuestionPorts, acknowledge, state_battery};
    #[cfg(feature = "lab")]
    #[pymodule_export]
    use crate::recordings::{CaptureRows, read_bag, read_trials, trial_rows, write_trial};
    #[cfg(feature = "lab")]
    #[pymodule_export]
    use crate::training::train_rows;
    use joulebus_publisher::columns::COLUMNS;
    use pyo3::prelude::{Bound, PyModule, PyModuleMethods as _, PyResult};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("FEATURE_NAMES", joulebus_predictor::FEATURE_NAMES)?;
        let columns = COLUMNS.iter().map(|column| (column.name, column.doc));
        module.add("PUBLISHED_COLUMNS", columns.collect::<Vec<_>>())?;
        for (constant, payload) in [
            ("SAMPLE", "Sample"),
            ("FORECAST", "Forecast"),
            ("DIAGNOSTIC", "Diagnostic"),
            ("BUDGET", "Budget"),
            ("OUTLOOK", "Outlook"),
            ("PLAN_STATE", "PlanState"),
            ("ANSWER_ROW", "AnswerRow"),
        ] {
            module.add(constant, crate::dtype::layout(payload))?;
        }
        module.add("OUTLOOK_S", <(f32, f32, f32, f32)>::from(joulebus_wire::OUTLOOK_S))?;
        Ok(())
    }
}
