//! The native half of the Python package `joulebus`: `joulebus._native`. The other half, in `python/joulebus`,
//! documents what users call and adds what needs no speed.
//!
//! Array arguments are copied before the interpreter is released, so that another Python thread that writes
//! into them changes no computation. No `unsafe` is written here: arrays over shared memory are made by NumPy
//! itself, from `__array_interface__` (`frame.rs`).
#![forbid(unsafe_code)]

mod array;
mod dtype;
mod energy_predictor;
mod error;
mod model;
mod planner;
mod port_thread;
mod predictor;
mod publisher;
mod training;

use pyo3::prelude::pymodule;

#[pymodule]
mod _native {
    #[pymodule_export]
    use crate::energy_predictor::EnergyPredictor;
    #[pymodule_export]
    use crate::error::{ConnectError, Error, ModelError, PublishError, ReadError};
    #[pymodule_export]
    use crate::planner::{FrameMemory, PlannerPorts, quality};
    #[pymodule_export]
    use crate::predictor::Predictor;
    #[pymodule_export]
    use crate::publisher::PublisherPort;
    #[pymodule_export]
    use crate::training::train_rows;
    use pyo3::prelude::{Bound, PyModule, PyModuleMethods as _, PyResult};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        module.add("FEATURE_NAMES", joulebus_predictor::FEATURE_NAMES)?;
        module.add("FORECAST", crate::dtype::forecast())?;
        module.add("DIAGNOSTIC", crate::dtype::diagnostic())?;
        module.add("BUDGET", crate::dtype::budget())
    }
}
