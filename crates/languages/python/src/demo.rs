//! The demo of `joulebus.demo()`: a worker in a thread, and simulated robots as columns.

use std::path::PathBuf;
use std::sync::Mutex;

use joulebus_bus::{Background, sweep};
use joulebus_config::Config;
use joulebus_plant::{Plant, SimReading};
use joulebus_predictor_worker::Worker;
use numpy::{Element, PyArrayDyn};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::array;
use crate::error::ConnectError;

fn refused(error: &dyn std::fmt::Display) -> PyErr {
    ConnectError::new_err(error.to_string())
}

/// The config of a fleet of `robots` simulated robots whose shared memory is in `root`.
#[pyfunction]
pub(crate) fn demo_config(root: PathBuf, robots: u32) -> String {
    let demo =
        joulebus_config::Demo { fleet: "demo".to_owned(), root, prefix: "jbd_".to_owned(), robots };
    demo.toml()
}

/// Removes what dead processes of a demo's fleet have left in shared memory.
#[pyfunction]
pub(crate) fn sweep_demo(py: Python<'_>, config: PathBuf) -> PyResult<()> {
    py.detach(|| {
        let domain = Config::load(config).map_err(|error| refused(&error))?;
        let domain = domain.domain().map_err(|error| refused(&error))?;
        sweep(&domain).map_err(|error| refused(&error))?;
        Ok(())
    })
}

/// A running worker.
#[pyclass(module = "joulebus._native", frozen)]
#[derive(Debug)]
pub(crate) struct DemoWorker {
    /// Empty after it was stopped.
    thread: Mutex<Option<Background<PyResult<()>>>>,
}

#[pymethods]
impl DemoWorker {
    /// Starts it, and waits until its ports are open.
    #[new]
    fn new(py: Python<'_>, config: PathBuf) -> PyResult<Self> {
        let start = || {
            Background::run("joulebus-worker", move |thread| {
                let config = Config::load(config).map_err(|error| refused(&error))?;
                let mut worker = Worker::open(&config).map_err(|error| refused(&error))?;
                thread.joined(());
                let mut turned = Ok(true);
                while turned.is_ok() && !thread.is_stopping() {
                    turned = worker.poll();
                }
                let _ = worker.finish();
                turned.map(drop).map_err(|error| refused(&error))
            })
        };
        let (thread, ()) = py.detach(start)?;
        Ok(Self { thread: Mutex::new(Some(thread)) })
    }

    /// Stops it: planners hear of its end.
    fn stop(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| {
            let thread = self.thread.lock().ok().and_then(|mut thread| thread.take());
            thread.map_or(Ok(()), Background::join)
        })
    }
}

/// Simulated robots, which drive the paper's protocols.
#[pyclass(module = "joulebus._native")]
#[derive(Debug)]
pub(crate) struct DemoRobots(Plant);

#[pymethods]
impl DemoRobots {
    #[new]
    fn new(seed: u64, robots: usize) -> Self {
        Self(Plant::new(seed, robots))
    }

    /// Advances by `step_s`, and returns the columns that `Publisher.publish` takes.
    fn step<'py>(&mut self, py: Python<'py>, step_s: f64) -> PyResult<Bound<'py, PyDict>> {
        let (readings, columns) = (self.0.step(step_s), PyDict::new(py));
        columns.set_item("v", column(py, readings, |reading| reading.v_mps)?)?;
        columns.set_item("omega", column(py, readings, |reading| reading.omega_radps)?)?;
        columns.set_item("power", column(py, readings, |reading| reading.power_w)?)?;
        columns.set_item("voltage", column(py, readings, |reading| reading.voltage_v)?)?;
        columns.set_item("current", column(py, readings, |reading| reading.current_a)?)?;
        columns.set_item("held", column(py, readings, |reading| reading.held)?)?;
        Ok(columns)
    }
}

fn column<'py, T: Element + Copy>(
    py: Python<'py>,
    readings: &[SimReading],
    value: fn(&SimReading) -> T,
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    array(py, readings.iter().map(value).collect(), &[readings.len()])
}
