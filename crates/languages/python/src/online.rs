//! Forecasts that learn online, of robots without a fleet: `OnlineForecaster`, `OnlineConformal`.

use joulebus_fleet::{IntervalForecast, OnlineForecasts, OnlineSettings};
use joulebus_predictor::{
    Activation, FeatureSet, Features, HIDDEN, INPUTS, LAGS, Layer, Linear, Model, ModelCard,
    Network, Normalisation, Parameters, ResidualStats, TrainingRange,
};
use joulebus_settings::IntervalSettings;
use numpy::{PyArrayDyn, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::array::array;
use crate::error::ModelError;
use crate::predictor::Predictor;

/// A regressor's residuals: standard deviation, 5 % and 95 % quantile. Its target's autoregression:
/// bias, and weights of the last readings, newest first. The readings that it was fitted to, five
/// in a row, newest first.
type Fitted = ([f32; 3], f32, [f32; LAGS], Vec<[f32; LAGS]>);

/// Robots, each with what its forecast has learned. Arguments have been checked in Python.
#[pyclass(module = "joulebus._native")]
#[derive(Debug)]
pub(crate) struct OnlineRobots {
    forecasts: OnlineForecasts,
}

#[pymethods]
impl OnlineRobots {
    /// `start`: a `Predictor`, or what is known of another regressor ([`Fitted`]). `limits`: the
    /// least and the largest possible reading.
    #[new]
    fn new(
        start: &Bound<'_, PyAny>,
        online: bool,
        coverage: f32,
        rate: f32,
        resolution_w: f32,
        limits: (f32, f32),
        longest_steps: u16,
    ) -> PyResult<Self> {
        let settings = OnlineSettings {
            interval: IntervalSettings { coverage, rate },
            online,
            resolution_w,
            power_min_w: limits.0,
            power_max_w: limits.1,
            longest_steps,
        };
        let forecasts = match start.cast::<Predictor>() {
            Ok(predictor) => OnlineForecasts::new(&predictor.get().model(), settings),
            Err(_) => OnlineForecasts::new(&model_of(&start.extract()?)?, settings),
        };
        Ok(Self { forecasts })
    }

    fn __len__(&self) -> usize {
        self.forecasts.len()
    }

    /// Adds a robot and returns its index.
    fn add(&mut self) -> usize {
        self.forecasts.add()
    }

    /// Forecasts and interval ends, `(rows, 3)`, from the member's forecasts. A robot of −1 has
    /// read nothing.
    fn forecast<'py>(
        &self,
        py: Python<'py>,
        robots: PyReadonlyArray1<'_, i64>,
        member_w: PyReadonlyArray1<'_, f32>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let rows = robots.as_array().into_iter().zip(member_w.as_array());
        let made = rows.map(|(robot, member_w)| {
            self.forecasts.forecast(usize::try_from(*robot).ok(), *member_w)
        });
        columns(py, made)
    }

    /// Takes readings in their order. Returns the forecasts before each, as `forecast`.
    fn read<'py>(
        &mut self,
        py: Python<'py>,
        robots: PyReadonlyArray1<'_, i64>,
        member_w: PyReadonlyArray1<'_, f32>,
        readings_w: PyReadonlyArray1<'_, f32>,
        held: PyReadonlyArray1<'_, bool>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let (robots, member_w) = (robots.as_array(), member_w.as_array());
        let rows = robots.into_iter().zip(member_w);
        let readings = readings_w.as_array().into_iter().zip(held.as_array()).zip(rows);
        let made = readings.map(|((reading_w, held), (robot, member_w))| {
            self.forecasts.read(*robot as usize, *member_w, *reading_w, *held)
        });
        columns(py, made)
    }

    /// A robot forgets what it has read.
    fn reset(&mut self, robot: usize) {
        self.forecasts.reset(robot);
    }

    /// Weights of the last reading, the member and the stacks, for the next reading that is a new
    /// measurement. `None` where robots do not learn.
    fn weights(&self, robot: usize) -> Option<[f32; 3]> {
        self.forecasts.learned(robot).map(|learned| learned.weights)
    }

    fn to_bytes<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.forecasts.to_bytes())
    }

    fn restore(&mut self, bytes: &[u8]) -> PyResult<()> {
        self.forecasts.restore(bytes).map_err(|error| PyValueError::new_err(error.to_string()))
    }
}

fn columns<'py>(
    py: Python<'py>,
    made: impl Iterator<Item = IntervalForecast>,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let values: Vec<f32> = made.flat_map(|made| [made.power_w, made.lo_w, made.hi_w]).collect();
    let rows = values.len() / 3;
    array(py, values, &[rows, 3])
}

/// A model with the card of a regressor. Its network has no weights, because the regressor
/// forecasts in its place.
fn model_of((residual, bias_w, weights, lags_w): &Fitted) -> PyResult<Model> {
    let feature_set = FeatureSet::Full;
    let row = |lag_w: &[f32; LAGS]| {
        let mut row: Features = [0.0; INPUTS];
        row[FeatureSet::PowerOnly.range()].copy_from_slice(lag_w);
        row
    };
    let rows: Vec<Features> = lags_w.iter().map(row).collect();
    let [std_w, q05_w, q95_w] = *residual;
    let linear = Linear {
        feature_set: FeatureSet::PowerOnly,
        bias_w: *bias_w,
        weights: row(weights),
        r2: 0.0,
    };
    let mut card = ModelCard::new(TrainingRange::of(feature_set, rows.iter()));
    card.residual = ResidualStats { std_w, q05_w, q95_w };
    card.linear = Some(linear);
    let sizes = [feature_set.inputs(), HIDDEN[0], HIDDEN[1], HIDDEN[2], 1];
    let layer = |at: usize| Layer {
        weights: vec![0.0; sizes[at] * sizes[at + 1]],
        bias: vec![0.0; sizes[at + 1]],
    };
    let parameters = Parameters {
        feature_set,
        normalisation: Normalisation {
            feature_mean: [0.0; INPUTS],
            feature_std: [1.0; INPUTS],
            power_mean_w: 0.0,
            power_std_w: 1.0,
        },
        activation: Activation::Relu,
        layers: std::array::from_fn(layer),
    };
    let network = Network::new(parameters, card);
    network.map(Model::Network).map_err(|error| ModelError::new_err(error.to_string()))
}
