//! The class of the paper's module (arXiv 2603.13908): mW, one step at a time.

use std::path::PathBuf;

use joulebus_predictor::{LAGS, Network, features};
use pyo3::IntoPyObjectExt as _;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::array::{Doubles, array, shape_error, shape_text};
use crate::error::ModelError;
use crate::model;

/// Robots from which on other Python threads may run meanwhile: below, releasing costs more.
const RELEASED_FROM: usize = 32;
/// Power of a robot at rest that nothing is known of, mW.
const INITIAL_MW: f64 = 3_500.0;

/// Forecasts of one robot's power, or of several robots', step by step, in milliwatt.
#[pyclass(module = "joulebus")]
#[derive(Debug)]
pub(crate) struct EnergyPredictor {
    network: Network,
    period_s: f32,
    robots: Vec<Robot>,
    /// Shape of all arguments so far. Empty while all were single numbers.
    shape: Vec<usize>,
}

#[derive(Debug, Clone, Copy)]
struct Robot {
    /// Newest first, W.
    lag_w: [f32; LAGS],
    before: Option<(f32, f32)>,
}

impl Robot {
    /// With this power as all readings before.
    fn at_rest(power_mw: f64) -> Self {
        Self { lag_w: [watt(power_mw); LAGS], before: None }
    }
}

#[pymethods]
impl EnergyPredictor {
    #[new]
    #[pyo3(signature = (path = PathBuf::from("builtin:gternal-sim"), period_s = None))]
    fn new(path: PathBuf, period_s: Option<f64>) -> PyResult<Self> {
        let mut predictor = Self::open(path, period_s, 1)?;
        predictor.begin(&[INITIAL_MW], Vec::new());
        Ok(predictor)
    }

    /// Begins anew, at rest with `initial_power` (mW) as all readings before.
    #[pyo3(signature = (initial_power = None))]
    fn reset(&mut self, initial_power: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let Some(given) = initial_power else {
            self.begin(&[INITIAL_MW], Vec::new());
            return Ok(());
        };
        let power_mw = Doubles::read("initial_power", given)?;
        if !power_mw.values.iter().all(|power| power.is_finite()) {
            return Err(PyValueError::new_err(format!(
                "initial_power is {given}, allowed are finite powers in mW"
            )));
        }
        self.begin(&power_mw.values, power_mw.shape);
        Ok(())
    }

    /// The power of the next step in mW, under a command in m/s and rad/s.
    fn step<'py>(
        &mut self,
        v_cmd: &Bound<'py, PyAny>,
        w_cmd: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.advance(v_cmd, w_cmd, None)
    }

    /// Same as `step`. The next one continues with `measured_power` (mW), or if NaN with the
    /// forecast.
    fn step_with_correction<'py>(
        &mut self,
        v_cmd: &Bound<'py, PyAny>,
        w_cmd: &Bound<'py, PyAny>,
        measured_power: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.advance(v_cmd, w_cmd, Some(measured_power))
    }

    #[getter]
    const fn period_s(&self) -> f32 {
        self.period_s
    }

    fn __repr__(&self) -> String {
        let (name, robots) = (&self.network.card().name, self.robots.len());
        format!("EnergyPredictor({name:?}, robots={robots})")
    }
}

impl EnergyPredictor {
    /// A predictor of several robots at rest.
    pub(crate) fn open(path: PathBuf, period_s: Option<f64>, robots: usize) -> PyResult<Self> {
        let network = model::open(&path)?;
        let period_s = match period_s {
            Some(period_s) => period_s as f32,
            None => model::period_s(&network, "period_s")?,
        };
        if !(period_s > 0.0 && period_s.is_finite()) {
            return Err(PyValueError::new_err(format!(
                "period_s is {period_s}, allowed is a finite time above 0 s"
            )));
        }
        if network.feature_set().needs_freshness() {
            return Err(ModelError::new_err(
                "the network reads the age of readings, which `step(v_cmd, w_cmd)` does not tell: use `Predictor`, or \
                 train one without: `joulebus train … --features full`",
            ));
        }
        let mut predictor = Self { network, period_s, robots: Vec::new(), shape: Vec::new() };
        predictor.begin(&vec![INITIAL_MW; robots], vec![robots]);
        Ok(predictor)
    }

    fn begin(&mut self, power_mw: &[f64], shape: Vec<usize>) {
        self.robots.clear();
        let robots = power_mw.iter().map(|power_mw| Robot::at_rest(*power_mw));
        self.robots.extend(robots);
        self.shape = shape;
    }

    /// Begins anew with one of several robots.
    pub(crate) fn begin_robot(&mut self, robot: usize) {
        self.robots[robot] = Robot::at_rest(INITIAL_MW);
    }

    fn advance<'py>(
        &mut self,
        v_cmd: &Bound<'py, PyAny>,
        w_cmd: &Bound<'py, PyAny>,
        measured_power: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let py = v_cmd.py();
        let (v, omega) = (Doubles::read("v_cmd", v_cmd)?, Doubles::read("w_cmd", w_cmd)?);
        if !v.values.iter().chain(&omega.values).all(|value| value.is_finite()) {
            return Err(PyValueError::new_err(format!(
                "the command is {v_cmd} m/s, {w_cmd} rad/s: allowed are finite numbers"
            )));
        }
        let measured =
            measured_power.map(|given| Doubles::read("measured_power", given)).transpose()?;
        if let Some(measured) = &measured
            && measured.values.iter().any(|power| power.is_infinite())
        {
            return Err(PyValueError::new_err(format!(
                "measured_power is {}, allowed are finite powers in mW, and NaN where there is none",
                measured_power.map_or_else(String::new, ToString::to_string)
            )));
        }
        self.spread(&[
            ("v_cmd", Some(&v)),
            ("w_cmd", Some(&omega)),
            ("measured_power", measured.as_ref()),
        ])?;
        let forecast_mw = if self.robots.len() < RELEASED_FROM {
            self.compute(&v, &omega, measured.as_ref())
        } else {
            py.detach(|| self.compute(&v, &omega, measured.as_ref()))
        };
        match (self.shape.as_slice(), forecast_mw.first()) {
            ([], Some(power_mw)) => power_mw.into_bound_py_any(py),
            _ => array(py, forecast_mw, &self.shape)?.into_bound_py_any(py),
        }
    }

    /// Gives every robot of the arguments a state. All arrays must have the same shape.
    fn spread(&mut self, arguments: &[(&str, Option<&Doubles>)]) -> PyResult<()> {
        let mut shape = self.shape.clone();
        for (name, numbers) in arguments {
            let Some(numbers) = numbers.filter(|numbers| !numbers.shape.is_empty()) else {
                continue;
            };
            if !shape.is_empty() && shape != numbers.shape {
                let allowed = format!("{} or a single number", shape_text(&shape));
                return Err(shape_error(name, &numbers.shape, &allowed));
            }
            shape.clone_from(&numbers.shape);
        }
        if shape != self.shape {
            // Until now all robots were one.
            let robot = self.robots[0];
            self.robots = vec![robot; shape.iter().product()];
            self.shape = shape;
        }
        Ok(())
    }

    /// The next forecasts, mW, of commands that `spread` or the caller has checked.
    pub(crate) fn compute(
        &mut self,
        v: &Doubles,
        omega: &Doubles,
        measured: Option<&Doubles>,
    ) -> Vec<f64> {
        let (network, period_s) = (&self.network, self.period_s);
        let command = |at: usize| (of(v, at) as f32, of(omega, at) as f32);
        let row = |(at, robot): (usize, &Robot)| {
            let (v_mps, omega_radps) = command(at);
            let previous = robot.before.map(|(v, omega)| (v, omega, period_s));
            features(v_mps, omega_radps, previous, &robot.lag_w)
        };
        let rows: Vec<_> = self.robots.iter().enumerate().map(row).collect();
        let mut forecasts_w = vec![0.0; rows.len()];
        network.predict(&rows, &mut forecasts_w);
        let range = &network.card().training_range;
        for (at, (robot, forecast_w)) in self.robots.iter_mut().zip(&forecasts_w).enumerate() {
            // Its own forecast is fed back only within the range of the training data.
            let measured_w = measured.map_or(f32::NAN, |measured| watt(of(measured, at)));
            let newest_w =
                if measured_w.is_nan() { range.fed_back_w(*forecast_w) } else { measured_w };
            robot.lag_w.copy_within(..LAGS - 1, 1);
            robot.lag_w[0] = newest_w;
            robot.before = Some(command(at));
        }
        let milliwatt = |power_w: &f32| 1e3 * f64::from(*power_w);
        forecasts_w.iter().map(milliwatt).collect()
    }
}

/// The number for robot `at`: a single one is for all.
fn of(numbers: &Doubles, at: usize) -> f64 {
    numbers.values[if numbers.shape.is_empty() { 0 } else { at }]
}

fn watt(power_mw: f64) -> f32 {
    (1e-3 * power_mw) as f32
}
