//! Forecasts of any number of robots at once, in SI units.

use std::path::PathBuf;
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Instant;

use joulebus_predictor::{
    FEATURES, Features, INPUTS, LAGS, Model, ReadingAge, RolloutStart, Rollouts,
};
use numpy::PyArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::array::{Numbers, array, shape_error, shape_text};
use crate::error::ModelError;
use crate::model;

/// Rows from which on other Python threads may run meanwhile: below, releasing costs more.
const RELEASED_FROM: usize = 32;

/// Energies and powers of rollouts.
type Rolled<'py> = (Bound<'py, PyArrayDyn<f32>>, Bound<'py, PyArrayDyn<f32>>);

/// The network on arrays. Several threads may use one.
#[pyclass(module = "joulebus", subclass, frozen)]
#[derive(Debug)]
pub(crate) struct Predictor {
    /// Replaced by training.
    model: RwLock<Arc<Model>>,
}

#[pymethods]
impl Predictor {
    #[new]
    #[pyo3(signature = (model = PathBuf::from("builtin:gternal-sim"), **_more))]
    fn new(model: PathBuf, _more: Option<&Bound<'_, pyo3::types::PyDict>>) -> PyResult<Self> {
        let model = Model::Network(model::open(&model)?);
        Ok(Self { model: RwLock::new(Arc::new(model)) })
    }

    /// Forecasts in W of rows of features in SI units.
    fn predict<'py>(
        &self,
        py: Python<'py>,
        features: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let model = self.model();
        let rows = rows(&model, features)?;
        let count = rows.len();
        let compute = move || {
            let mut forecasts_w = vec![0.0; rows.len()];
            model.predict(&rows, &mut forecasts_w);
            forecasts_w
        };
        let forecasts_w = if count < RELEASED_FROM { compute() } else { py.detach(compute) };
        array(py, forecasts_w, &[count])
    }

    /// Energy and power of command sequences, in open loop.
    #[pyo3(signature = (v, omega, *, readings_w = None, before = None, step_s = None))]
    fn rollout<'py>(
        &self,
        py: Python<'py>,
        v: &Bound<'py, PyAny>,
        omega: &Bound<'py, PyAny>,
        readings_w: Option<&Bound<'py, PyAny>>,
        before: Option<(Bound<'py, PyAny>, Bound<'py, PyAny>)>,
        step_s: Option<f32>,
    ) -> PyResult<Rolled<'py>> {
        let model = self.model();
        let step_s = match (step_s, model.as_ref()) {
            (Some(step_s), _) => step_s,
            (None, Model::Network(network)) => model::period_s(network, "step_s")?,
            (None, Model::Persistence(_)) => {
                return Err(model::without_period("step_s"));
            }
        };
        if model.needs_freshness() {
            return Err(ModelError::new_err(
                "the network reads the age of readings, which a rollout is not told. Train one \
                 without: `joulebus train … --features full`",
            ));
        }
        let (v, omega) = (Numbers::read("v", v)?, Numbers::read("omega", omega)?);
        let shape = Shape::new(&v, &omega)?;
        let starts = starts(shape.robots, readings_w, before.as_ref())?;
        let (energy_j, power_w) =
            py.detach(|| shape.roll(&model, &starts, &v.values, &omega.values, step_s))?;
        let energies = &v.shape[..v.shape.len() - 1];
        Ok((array(py, energy_j, energies)?, array(py, power_w, &v.shape)?))
    }

    /// The model's name.
    #[getter]
    fn name(&self) -> String {
        self.model().name().to_owned()
    }

    /// Equal for equal models, on every machine: 16 hexadecimal digits.
    #[getter]
    fn hash(&self) -> String {
        format!("{:016x}", self.model().hash())
    }

    /// The features that the model reads: full, power_only, freshness or power_freshness.
    #[getter]
    fn reads(&self) -> &'static str {
        self.model().feature_set().name()
    }

    /// The model file's bytes.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let model = self.model();
        let Model::Network(network) = model.as_ref() else {
            return Err(ModelError::new_err("the model has no file"));
        };
        let bytes =
            network.to_safetensors().map_err(|error| ModelError::new_err(error.to_string()))?;
        Ok(PyBytes::new(py, &bytes))
    }

    /// The arrays of the archive that `joulebus model export` writes: names, and the bytes of each file.
    #[cfg(feature = "lab")]
    fn _arrays<'py>(&self, py: Python<'py>) -> PyResult<Vec<(String, Bound<'py, PyBytes>)>> {
        let model = self.model();
        let Model::Network(network) = model.as_ref() else {
            return Err(ModelError::new_err("the model has no arrays"));
        };
        let arrays = joulebus_model_files::to_arrays(network)
            .map_err(|error| ModelError::new_err(error.to_string()))?;
        let named = |(name, bytes): (String, Vec<u8>)| (name, PyBytes::new(py, &bytes));
        Ok(arrays.into_iter().map(named).collect())
    }

    /// Replaces the model by that of a model file's bytes.
    fn _load(&self, bytes: &[u8]) -> PyResult<()> {
        let model = Arc::new(Model::Network(model::of_bytes(bytes)?));
        *self.model.write().unwrap_or_else(PoisonError::into_inner) = model;
        Ok(())
    }

    /// Seconds that the Rust call alone takes on these rows: the comparison of `joulebus.speed`.
    fn _rust_call_s(&self, features: &Bound<'_, PyAny>, calls: u32) -> PyResult<f64> {
        let model = self.model();
        let rows = rows(&model, features)?;
        let mut forecasts_w = vec![0.0; rows.len()];
        let begin = Instant::now();
        for _ in 0..calls {
            model.predict(std::hint::black_box(&rows), &mut forecasts_w);
            std::hint::black_box(&mut forecasts_w);
        }
        Ok(begin.elapsed().as_secs_f64() / f64::from(calls))
    }
}

impl Predictor {
    pub(crate) fn model(&self) -> Arc<Model> {
        // A value is only ever replaced whole.
        Arc::clone(&self.model.read().unwrap_or_else(PoisonError::into_inner))
    }
}

/// The rows of an array of 11 features, or of 13 with the age of the newest reading.
fn rows(model: &Model, given: &Bound<'_, PyAny>) -> PyResult<Vec<Features>> {
    let found = Numbers::read("features", given)?;
    let needed = model.feature_set().end();
    let width = match found.shape.as_slice() {
        [_, width] if (*width == FEATURES || *width == INPUTS) && *width >= needed => *width,
        shape => {
            let allowed = if needed > FEATURES {
                "(robots, 13), the network reads the age of the newest reading"
            } else {
                "(robots, 11), or (robots, 13) with the age of the newest reading"
            };
            return Err(shape_error("features", shape, allowed));
        }
    };
    let row = |values: &[f32]| {
        let mut row = [f32::NAN; INPUTS];
        row[..width].copy_from_slice(values);
        row
    };
    Ok(found.values.chunks_exact(width).map(row).collect())
}

/// Robots, candidates of each, and steps of each: commands are `v[robot, candidate, step]`.
struct Shape {
    robots: usize,
    candidates: usize,
    steps: usize,
}

impl Shape {
    fn new(v: &Numbers, omega: &Numbers) -> PyResult<Self> {
        if v.shape != omega.shape {
            let allowed = format!("{}, that of v", v.shape_text());
            return Err(shape_error("omega", &omega.shape, &allowed));
        }
        let (robots, candidates, steps) = match *v.shape {
            [steps] => (1, 1, steps),
            [robots, steps] => (robots, 1, steps),
            [robots, candidates, steps] => (robots, candidates, steps),
            _ => {
                let allowed = "(steps,), (robots, steps) or (robots, candidates, steps)";
                return Err(shape_error("v", &v.shape, allowed));
            }
        };
        Ok(Self { robots, candidates, steps })
    }

    /// Energy of each lane, and power of each step, in the order of Python's arrays.
    fn roll(
        &self,
        model: &Model,
        starts: &[RolloutStart],
        v_mps: &[f32],
        omega_radps: &[f32],
        step_s: f32,
    ) -> PyResult<(Vec<f32>, Vec<f32>)> {
        let (lanes, steps) = (self.robots * self.candidates, self.steps);
        let rollouts = Rollouts {
            starts,
            candidates: self.candidates,
            steps,
            step_s,
            v_mps: &transposed(v_mps, lanes, steps),
            omega_radps: &transposed(omega_radps, lanes, steps),
        };
        let (mut energy_j, mut power_w) = (vec![0.0; lanes], vec![0.0; lanes * steps]);
        model
            .rollout(&rollouts, 0..lanes, &mut energy_j, Some(&mut power_w))
            .map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok((energy_j, transposed(&power_w, steps, lanes)))
    }
}

/// `to[column * rows + row] = from[row * columns + column]`.
fn transposed(from: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let column = |column: usize| (0..rows).map(move |row| from[row * columns + column]);
    (0..columns).flat_map(column).collect()
}

/// The start of each robot: its readings (W, newest first) and its command before.
fn starts(
    robots: usize,
    readings_w: Option<&Bound<'_, PyAny>>,
    before: Option<&(Bound<'_, PyAny>, Bound<'_, PyAny>)>,
) -> PyResult<Vec<RolloutStart>> {
    let start =
        RolloutStart { command: None, lag_w: [3.5; LAGS], reading_age: ReadingAge::UNKNOWN };
    let mut starts = vec![start; robots];
    if let Some(given) = readings_w {
        let found = Numbers::read("readings_w", given)?;
        for (robot, start) in starts.iter_mut().enumerate() {
            start.lag_w = match *found.shape {
                [] => [found.values[0]; LAGS],
                [count] if count == robots => [found.values[robot]; LAGS],
                [count, LAGS] if count == robots => {
                    std::array::from_fn(|lag| found.values[robot * LAGS + lag])
                }
                _ => {
                    let allowed = format!("(), ({robots},), or ({robots}, {LAGS}) newest first");
                    return Err(shape_error("readings_w", &found.shape, &allowed));
                }
            };
        }
    }
    if let Some((v, omega)) = before {
        let v = Numbers::read("before[0]", v)?;
        let omega = Numbers::read("before[1]", omega)?;
        for (robot, start) in starts.iter_mut().enumerate() {
            let of = |name: &str, found: &Numbers| match *found.shape {
                [] => Ok(found.values[0]),
                [count] if count == robots => Ok(found.values[robot]),
                _ => {
                    let allowed = format!("() or {}", shape_text(&[robots]));
                    Err(shape_error(name, &found.shape, &allowed))
                }
            };
            start.command = Some((of("before[0]", &v)?, of("before[1]", &omega)?));
        }
    }
    Ok(starts)
}
