//! Batteries of simulated robots that draw what a model forecasts: a step of `EnergyRobotarium`.

use std::ops::Range;
use std::path::PathBuf;

use numpy::{PyArrayDyn, PyReadonlyArray2, PyUntypedArrayMethods as _};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::array::{Doubles, array, shape_error};
use crate::energy_predictor::EnergyPredictor;

type Array<'py, T> = PyResult<Bound<'py, PyArrayDyn<T>>>;

/// Batteries, one for each robot. All vectors have one element for each robot.
#[pyclass(module = "joulebus._native")]
#[derive(Debug)]
pub(crate) struct Batteries {
    predictor: EnergyPredictor,
    arenas: usize,
    period_s: f64,
    capacity_j: Vec<f64>,
    left_j: Vec<f64>,
    drawn_j: Vec<f64>,
    power_w: Vec<f64>,
    charging: Vec<bool>,
    /// Positions, m.
    chargers: Vec<[f64; 2]>,
    /// Energy that a charger gives in a step, J.
    charge_j: f64,
    radius_m: f64,
}

#[pymethods]
impl Batteries {
    /// All numbers have been checked by `EnergyRobotarium` and `EnergyVectorEnv`. `arenas`: groups
    /// of as many robots each, one after the other. Each arena has all the chargers to itself.
    #[new]
    #[pyo3(signature = (model, period_s, capacity_j, left_j, chargers, charge_power_w, radius_m, arenas = 1))]
    #[allow(clippy::too_many_arguments, reason = "arguments of one call in Python")]
    fn new(
        model: PathBuf,
        period_s: f64,
        capacity_j: Vec<f64>,
        left_j: Vec<f64>,
        chargers: Vec<[f64; 2]>,
        charge_power_w: f64,
        radius_m: f64,
        arenas: usize,
    ) -> PyResult<Self> {
        let robots = capacity_j.len();
        if arenas == 0 || !robots.is_multiple_of(arenas) {
            return Err(PyValueError::new_err(format!(
                "{robots} robots in {arenas} arenas, allowed are as many in each"
            )));
        }
        if left_j.len() != robots {
            return Err(PyValueError::new_err(format!(
                "{} states of charge for {robots} batteries",
                left_j.len()
            )));
        }
        Ok(Self {
            predictor: EnergyPredictor::open(model, Some(period_s), robots)?,
            arenas,
            period_s,
            capacity_j,
            left_j,
            drawn_j: vec![0.0; robots],
            power_w: vec![0.0; robots],
            charging: vec![false; robots],
            chargers,
            charge_j: charge_power_w * period_s,
            radius_m,
        })
    }

    /// A step at velocities `(2, robots)`, m/s and rad/s, that ended at poses `(3, robots)`, m.
    /// Returns whether a battery is empty.
    fn step(
        &mut self,
        velocities: PyReadonlyArray2<'_, f64>,
        poses: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<bool> {
        let robots = self.left_j.len();
        for (name, found, rows) in
            [("velocities", velocities.shape(), 2), ("poses", poses.shape(), 3)]
        {
            if *found != [rows, robots] {
                return Err(shape_error(name, found, &format!("({rows}, {robots})")));
            }
        }
        let (velocities, poses) = (velocities.as_array(), poses.as_array());
        let row = |at: usize| Doubles { values: velocities.row(at).to_vec(), shape: vec![robots] };
        let (v_mps, omega_radps) = (row(0), row(1));
        if !v_mps.values.iter().chain(&omega_radps.values).all(|value| value.is_finite()) {
            return Err(PyValueError::new_err(
                "a velocity is not finite: the robots cannot be simulated",
            ));
        }
        let power_mw = self.predictor.compute(&v_mps, &omega_radps, None);
        for (robot, power_mw) in power_mw.into_iter().enumerate() {
            self.draw(robot, 1e-3 * power_mw);
        }
        self.charging.fill(false);
        let size = robots / self.arenas;
        for arena in 0..self.arenas {
            let members = arena * size..(arena + 1) * size;
            for charger in 0..self.chargers.len() {
                let at = |robot| (poses[(0, robot)], poses[(1, robot)]);
                self.charge(charger, members.clone(), at);
            }
        }
        Ok(self.left_j.iter().any(|left_j| *left_j <= 0.0))
    }

    /// Begins anew, at rest, with these robots, whose batteries then have `left_j`.
    fn reset(&mut self, robots: Vec<usize>, left_j: Vec<f64>) -> PyResult<()> {
        let count = self.left_j.len();
        if robots.len() != left_j.len() || robots.iter().any(|robot| *robot >= count) {
            return Err(PyValueError::new_err(format!(
                "{} robots and {} energies, allowed are as many, of robots below {count}",
                robots.len(),
                left_j.len()
            )));
        }
        for (robot, left_j) in robots.into_iter().zip(left_j) {
            self.predictor.begin_robot(robot);
            self.left_j[robot] = left_j;
            (self.drawn_j[robot], self.power_w[robot]) = (0.0, 0.0);
            self.charging[robot] = false;
        }
        Ok(())
    }

    /// Power of the last step, W.
    fn power_w<'py>(&self, py: Python<'py>) -> Array<'py, f64> {
        array(py, self.power_w.clone(), &[self.power_w.len()])
    }

    /// Energy drawn since the beginning, J.
    fn drawn_j<'py>(&self, py: Python<'py>) -> Array<'py, f64> {
        array(py, self.drawn_j.clone(), &[self.drawn_j.len()])
    }

    /// State of charge, 0 to 1.
    fn soc<'py>(&self, py: Python<'py>) -> Array<'py, f64> {
        let each = self.left_j.iter().zip(&self.capacity_j);
        let soc: Vec<f64> = each.map(|(left_j, capacity_j)| left_j / capacity_j).collect();
        array(py, soc, &[self.left_j.len()])
    }

    /// Whether each was charged in the last step.
    fn charging<'py>(&self, py: Python<'py>) -> Array<'py, bool> {
        array(py, self.charging.clone(), &[self.charging.len()])
    }

    /// Whether each is empty.
    fn empty<'py>(&self, py: Python<'py>) -> Array<'py, bool> {
        let empty: Vec<bool> = self.left_j.iter().map(|left_j| *left_j <= 0.0).collect();
        array(py, empty, &[self.left_j.len()])
    }
}

impl Batteries {
    /// An empty battery gives nothing, the last step of a battery what is left.
    fn draw(&mut self, robot: usize, forecast_w: f64) {
        let left_j = &mut self.left_j[robot];
        let power_w = if *left_j > 0.0 { forecast_w } else { 0.0 };
        let drawn_j = (power_w * self.period_s).min(*left_j);
        self.power_w[robot] = power_w;
        self.drawn_j[robot] += drawn_j;
        *left_j -= drawn_j;
    }

    /// Charges the nearest of these robots within the radius.
    fn charge(&mut self, charger: usize, robots: Range<usize>, at: impl Fn(usize) -> (f64, f64)) {
        let [x_m, y_m] = self.chargers[charger];
        let distance_m = |robot: usize| {
            let (robot_x_m, robot_y_m) = at(robot);
            (robot_x_m - x_m).hypot(robot_y_m - y_m)
        };
        let nearest = robots
            .map(|robot| (robot, distance_m(robot)))
            .min_by(|one, other| one.1.total_cmp(&other.1));
        let Some((robot, _)) = nearest.filter(|(_, distance_m)| *distance_m <= self.radius_m)
        else {
            return;
        };
        // Two chargers side by side do not charge one robot twice as fast.
        if !std::mem::replace(&mut self.charging[robot], true) {
            let filled_j = self.left_j[robot] + self.charge_j;
            self.left_j[robot] = filled_j.min(self.capacity_j[robot]);
        }
    }
}
