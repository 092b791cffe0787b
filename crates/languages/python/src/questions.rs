//! Questions about plans: what command sequences, a path or a time at rest cost, computed here from
//! the worker's shared memory.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use joulebus_plan::answering::Work;
use joulebus_plan::{
    MAX_STEPS, Path, Plan, PlanFleet, Point, Question, QuestionError, RobotRows, Row, Verdict,
};
use joulebus_planner::{ClientError, Config, PlanClient, Planner, ViewError};
use joulebus_wire::{Alarm, Statement};
use pyo3::exceptions::{PyKeyError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{Doubles, Ids, Numbers, array, shape_error};
use crate::error::{ConnectError, ReadError, of_read};
use crate::planner::{SLICE, deadline};
use crate::port_thread::PortThread;

/// The connection of a planner that asks, for which the worker writes what plans start from.
#[pyclass(module = "joulebus._native", frozen)]
#[derive(Debug)]
pub(crate) struct QuestionPorts {
    /// Empty after closing.
    thread: PortThread<Option<Planner>>,
    fleet: PlanFleet,
}

/// Acknowledges an alarm of a robot: the worker is asked.
#[pyfunction]
pub(crate) fn acknowledge(
    py: Python<'_>,
    joined: (PathBuf, String),
    robot: u32,
    alarm: &str,
    by: &str,
    new_normal: bool,
    timeout_s: f64,
) -> PyResult<()> {
    let mut all = Alarm::ALL.into_iter();
    let alarm = all.find(|known| known.name() == alarm).ok_or_else(|| {
        let allowed = Alarm::ALL.map(Alarm::name).join(", ");
        PyValueError::new_err(format!("{alarm:?} is no alarm of a robot, allowed: {allowed}"))
    })?;
    told(py, joined, timeout_s, |client, timeout| {
        client.acknowledge(robot, alarm, by, new_normal, timeout)
    })
}

/// States a robot's battery: the worker is asked.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "arguments of one call in Python")]
pub(crate) fn state_battery(
    py: Python<'_>,
    joined: (PathBuf, String),
    robot: u32,
    charge: Option<f32>,
    full: bool,
    exchanged: bool,
    by: &str,
    timeout_s: f64,
) -> PyResult<()> {
    let statement = match (charge, full, exchanged) {
        (Some(soc), false, false) => Statement::Charge(soc),
        (None, true, false) => Statement::Full,
        (None, false, true) => Statement::Exchanged,
        _ => return Err(PyValueError::new_err("state one of charge, full and exchanged")),
    };
    told(py, joined, timeout_s, |client, timeout| {
        client.state_battery(robot, statement, by, timeout)
    })
}

/// Has the worker take what a person states.
fn told(
    py: Python<'_>,
    (config, name): (PathBuf, String),
    timeout_s: f64,
    tell: impl FnOnce(&mut PlanClient, Duration) -> Result<(), ClientError> + Send,
) -> PyResult<()> {
    let timeout = Duration::try_from_secs_f64(timeout_s);
    let timeout = timeout.map_err(|error| PyValueError::new_err(error.to_string()))?;
    py.detach(|| {
        let failed = |error: &dyn std::fmt::Display| ConnectError::new_err(error.to_string());
        let config = Config::load(config).map_err(|error| failed(&error))?;
        let client = PlanClient::with_config(&config, &name);
        let mut client = client.map_err(|error| failed(&error))?;
        let taken = tell(&mut client, timeout);
        taken.map_err(|error| PyRuntimeError::new_err(error.to_string()))
    })
}

/// The robots asked about, as of one tick.
struct TickStates {
    tick: u64,
    age_ns: u64,
    is_current: bool,
    robots: Vec<Option<RobotRows>>,
}

#[pymethods]
impl QuestionPorts {
    #[new]
    fn new(py: Python<'_>, config: PathBuf, name: String) -> PyResult<Self> {
        let open = move || {
            let config = Config::load(config).map_err(|error| error.to_string())?;
            let planner =
                Planner::with_config(&config, &name).map_err(|error| error.to_string())?;
            Ok(Some(planner))
        };
        let thread = py.detach(|| PortThread::start(open))?;
        let fleet =
            |planner: &mut Option<Planner>| planner.as_ref().map(|planner| planner.fleet().clone());
        let fleet = py.detach(|| thread.ask(fleet))?.ok_or_else(closed)?;
        Ok(Self { thread, fleet })
    }

    /// One robot, each of several sequences of commands `(steps,)` or `(candidates, steps)`.
    #[allow(clippy::too_many_arguments, reason = "arguments of one call in Python")]
    fn what_if<'py>(
        &self,
        py: Python<'py>,
        robot: &Bound<'py, PyAny>,
        v: &Bound<'py, PyAny>,
        omega: &Bound<'py, PyAny>,
        period_s: Option<f32>,
        coverage: f32,
        power: bool,
        timeout_s: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let robots = Ids::read("robot", robot)?.0;
        let [robot] = *robots else {
            return Err(PyValueError::new_err(format!("{} robots, allowed is one", robots.len())));
        };
        let (v, omega) = (Numbers::read("v", v)?, Numbers::read("omega", omega)?);
        let candidates = match *v.shape {
            [_] => 1,
            [candidates, _] => candidates,
            _ => {
                return Err(shape_error("v", &v.shape, "(steps,) or (candidates, steps)"));
            }
        };
        if v.shape != omega.shape {
            let allowed = format!("{}, that of v", v.shape_text());
            return Err(shape_error("omega", &omega.shape, &allowed));
        }
        let plan = Plan::WhatIf {
            robot,
            candidates,
            period_s: period_s.unwrap_or_else(|| self.period_s(robot)),
            v_mps: v.values,
            omega_radps: omega.values,
        };
        self.answer(py, Question { plan, coverage, power, moments: 0 }, timeout_s)
    }

    /// Robots that stand still for a time, s.
    fn idle<'py>(
        &self,
        py: Python<'py>,
        robots: &Bound<'py, PyAny>,
        duration_s: f32,
        coverage: f32,
        moments: usize,
        timeout_s: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let robots = Ids::read("robots", robots)?.0;
        let plan = Plan::Idle { robots, duration_s };
        let question = Question { plan, coverage, power: false, moments };
        self.answer(py, question, timeout_s)
    }

    /// Robots that follow a path: points `(points, 2)` in m, the speed towards each, and the columns
    /// `dwell_s`, `load_w` and `time_s`, of which each may be missing.
    #[allow(clippy::too_many_arguments, reason = "arguments of one call in Python")]
    fn follow<'py>(
        &self,
        py: Python<'py>,
        robots: &Bound<'py, PyAny>,
        points: &Bound<'py, PyAny>,
        speed: &Bound<'py, PyAny>,
        columns: [Option<Bound<'py, PyAny>>; 3],
        heading_and_tolerance: (Option<f64>, Option<f32>),
        back_to: Option<(f64, f64)>,
        coverage: f32,
        power: bool,
        moments: usize,
        timeout_s: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let robots = Ids::read("robots", robots)?.0;
        let (heading_rad, tolerance_m) = heading_and_tolerance;
        let plan = Plan::Follow {
            robots,
            path: Path { heading_rad, tolerance_m, ..path(points, speed, &columns)? },
            back_to: back_to.map(|(x_m, y_m)| Point::new(x_m, y_m)),
        };
        self.answer(py, Question { plan, coverage, power, moments }, timeout_s)
    }

    /// Leaves the fleet.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.thread.ask(|planner| *planner = None))
    }
}

impl QuestionPorts {
    /// The tick period of a robot's platform. That of the first where it is unknown.
    fn period_s(&self, robot: u32) -> f32 {
        let platforms = self.fleet.platforms();
        let its = platforms
            .iter()
            .find(|platform| platform.settings.robots.iter().any(|ids| ids.contains(&robot)));
        let period_ns = its.or(platforms.first()).map_or(0, |platform| platform.settings.period_ns);
        period_ns as f32 * 1e-9
    }

    fn answer<'py>(
        &self,
        py: Python<'py>,
        question: Question,
        timeout_s: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let robots = question.plan.robots().to_vec();
        let seen = self.look(py, &robots, timeout_s)?;
        let find = |robot: u32| {
            let at = robots.iter().position(|id| *id == robot)?;
            seen.robots[at]
        };
        let mut work = Work::begin(question, find, MAX_STEPS).map_err(refused)?;
        while !py.detach(|| work.step(&self.fleet)).map_err(refused)? {
            py.check_signals()?;
        }
        let reply = work.finish();
        let found = columns(py, &reply.rows)?;
        if !reply.along.is_empty() {
            found.set_item("along", columns(py, &reply.along)?)?;
        }
        found.set_item("tick", seen.tick)?;
        found.set_item("age_s", seen.age_ns as f64 * 1e-9)?;
        if !reply.power_w.is_empty() {
            // With one robot: as many steps for each of its candidates.
            let rows = reply.rows.len().max(1);
            let steps = reply.power_w.len() / rows;
            found.set_item("power_w", array(py, reply.power_w, &[rows, steps])?)?;
        }
        Ok(found)
    }

    /// The robots as of a current frame. After the time of what there is.
    fn look(&self, py: Python<'_>, robots: &[u32], timeout_s: f64) -> PyResult<TickStates> {
        let deadline = deadline(Some(timeout_s))?.unwrap_or_else(Instant::now);
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let (slice, ids) = (left.min(SLICE), robots.to_vec());
            let ask = move |planner: &mut Option<Planner>| {
                let planner = planner.as_mut().ok_or_else(closed)?;
                seen(planner, slice, &ids)
            };
            let seen = py.detach(|| self.thread.ask(ask))??;
            py.check_signals()?;
            match seen {
                Ok(seen) if seen.is_current || left.is_zero() => return Ok(seen),
                Err(nothing) if left.is_zero() => return Err(nothing.into_error(timeout_s)),
                _ => {}
            }
        }
    }
}

/// No frame has arrived.
struct Nothing;

impl Nothing {
    fn into_error(self, waited_s: f64) -> PyErr {
        ReadError::new_err(ViewError::Nothing { waited_s }.to_string())
    }
}

fn seen(
    planner: &mut Planner,
    slice: Duration,
    robots: &[u32],
) -> PyResult<Result<TickStates, Nothing>> {
    let view = match planner.wait(slice) {
        Ok(view) => view,
        // The caller learns of an interruption by its signal.
        Err(ViewError::Nothing { .. } | ViewError::Interrupted) => return Ok(Err(Nothing)),
        Err(ViewError::Read(error)) => return Err(ReadError::new_err(of_read(&error))),
        Err(error) => return Err(ReadError::new_err(error.to_string())),
    };
    Ok(Ok(TickStates {
        tick: view.tick(),
        age_ns: view.age_ns(),
        is_current: view.is_current(),
        robots: robots.iter().map(|robot| view.rows(*robot)).collect(),
    }))
}

fn path(
    points: &Bound<'_, PyAny>,
    speed: &Bound<'_, PyAny>,
    columns: &[Option<Bound<'_, PyAny>>; 3],
) -> PyResult<Path> {
    let (points, speed) = (Doubles::read("path", points)?, Doubles::read("speed", speed)?);
    let [count, 2] = *points.shape else {
        return Err(shape_error(
            "path",
            &points.shape,
            "(points, 2): x and y in m, first where the robot is",
        ));
    };
    let speed_mps = match *speed.shape {
        [] => vec![speed.values[0]; count],
        [found] if found == count => speed.values,
        _ => {
            let allowed = format!("() or ({count},), towards each point. The first is not used");
            return Err(shape_error("speed", &speed.shape, &allowed));
        }
    };
    let point = |at: &[f64]| Point::new(at[0], at[1]);
    let column = |place: usize, name: &str| -> PyResult<Vec<f64>> {
        let Some(values) = &columns[place] else {
            return Ok(Vec::new());
        };
        let values = Doubles::read(name, values)?;
        if *values.shape == [count] {
            return Ok(values.values);
        }
        Err(shape_error(name, &values.shape, &format!("({count},), of each point")))
    };
    Ok(Path {
        points: points.values.chunks_exact(2).map(point).collect(),
        speed_mps,
        dwell_s: column(0, "dwell")?,
        load_w: column(1, "load")?,
        time_s: column(2, "times")?,
        ..Path::default()
    })
}

/// The answers by columns. What is unknown is NaN, and −1 as a leg.
fn columns<'py>(py: Python<'py>, rows: &[Row]) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    let count = [rows.len()];
    let robots: Vec<u32> = rows.iter().map(|row| row.robot).collect();
    dict.set_item("robot", array(py, robots, &count)?)?;
    let number = |name: &str, of: fn(&Row) -> Option<f32>| {
        let values: Vec<f32> = rows.iter().map(|row| of(row).unwrap_or(f32::NAN)).collect();
        dict.set_item(name, array(py, values, &count)?)
    };
    number("duration_s", |row| Some(row.answer.duration_s))?;
    number("energy_j", |row| row.answer.energy.map(|energy| energy.mean_j))?;
    number("energy_lo_j", |row| row.answer.energy.map(|energy| energy.lo_j))?;
    number("energy_hi_j", |row| row.answer.energy.map(|energy| energy.hi_j))?;
    number("left_j", |row| row.answer.left.map(|left| left.mean_j))?;
    number("left_lo_j", |row| row.answer.left.map(|left| left.lo_j))?;
    number("margin_j", |row| row.answer.margin_j)?;
    number("probability", |row| row.answer.probability)?;
    number("turn_back_s", |row| row.turn_back_s)?;
    let leg = |row: &Row| row.answer.limiting_leg.map_or(-1, |leg| leg as i64);
    dict.set_item("limiting_leg", array(py, rows.iter().map(leg).collect(), &count)?)?;
    let texts: Vec<(&str, Option<String>)> =
        rows.iter().map(|row| verdict(row.answer.verdict)).collect();
    let (verdicts, reasons): (Vec<_>, Vec<_>) = texts.into_iter().unzip();
    dict.set_item("verdict", verdicts)?;
    dict.set_item("reason", reasons)?;
    let alarms = |row: &Row| {
        let alarms = row.answer.caveats.alarms;
        (!alarms.is_empty()).then(|| alarms.names().collect::<Vec<_>>().join(", "))
    };
    dict.set_item("alarms", rows.iter().map(alarms).collect::<Vec<_>>())?;
    let caveats = |row: &Row| row.answer.caveats.any().then(|| row.answer.caveats.to_string());
    dict.set_item("caveats", rows.iter().map(caveats).collect::<Vec<_>>())?;
    Ok(dict)
}

/// Its name, and why it is unknown.
fn verdict(verdict: Verdict) -> (&'static str, Option<String>) {
    match verdict {
        Verdict::Yes => ("yes", None),
        Verdict::Tight => ("tight", None),
        Verdict::No => ("no", None),
        Verdict::Unknown(reason) => ("unknown", Some(reason.to_string())),
        _ => ("unknown", None),
    }
}

fn refused(error: QuestionError) -> PyErr {
    match error {
        QuestionError::UnknownRobot { .. } => PyKeyError::new_err(error.to_string()),
        error => PyValueError::new_err(error.to_string()),
    }
}

fn closed() -> PyErr {
    PyRuntimeError::new_err("the planner is closed. Connect a new one")
}
