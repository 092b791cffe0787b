//! A source of samples, from arrays.

use std::collections::{BTreeSet, VecDeque};
use std::ffi::CString;
use std::path::PathBuf;
use std::sync::Mutex;

use joulebus_publisher::columns::{COLUMNS, SetColumn};
use joulebus_publisher::plausibility::{Kind, Origin};
use joulebus_publisher::{
    Config, Judgement, PublishError as Refusal, Publisher as Port, Refused, RobotState, clock,
};
use pyo3::exceptions::{PyRuntimeWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyFloat};

use crate::array::{Ids, Numbers, shape_error};
use crate::error::{ConnectError, PublishError};
use crate::port_thread::PortThread;

/// Frames sent, samples sent, capacity, connections that failed.
type Counts = (u64, u64, usize, u64);

#[pyclass(module = "joulebus._native", frozen)]
#[derive(Debug)]
pub(crate) struct PublisherPort {
    /// Empty after closing.
    thread: PortThread<Option<Port>>,
    /// Warnings that it has given, once each.
    warned: Mutex<BTreeSet<(u32, &'static str)>>,
    judgement: Mutex<Judgement>,
    /// Implausible findings not reported yet. A send may fail, and a warning may be an error.
    unreported: Mutex<VecDeque<String>>,
}

#[pymethods]
impl PublisherPort {
    #[new]
    fn new(py: Python<'_>, config: PathBuf, name: String) -> PyResult<Self> {
        let open = move || {
            let config = Config::load(config).map_err(|error| error.to_string())?;
            let port = Port::with_config(&config, &name).map_err(|error| error.to_string())?;
            Ok(Some(port))
        };
        let thread = py.detach(|| PortThread::start(open))?;
        Ok(Self {
            thread,
            warned: Mutex::default(),
            judgement: Mutex::new(Judgement::new(Origin::Program, vec![Kind::Constant])),
            unreported: Mutex::default(),
        })
    }

    /// Sends one frame. `columns` are by the names of `RobotState`'s fields. NaN and absent columns
    /// are unknown. Returns the numbers of readers and of samples, and the frame's own.
    fn publish(
        &self,
        py: Python<'_>,
        ids: &Bound<'_, PyAny>,
        columns: &Bound<'_, PyDict>,
        intended_ns: Option<u64>,
    ) -> PyResult<(usize, usize, u64)> {
        self.thread.check_process()?;
        let robots = robots(ids, columns)?;
        self.judge(&robots);
        let send = move |port: &mut Option<Port>| {
            let port = port.as_mut().ok_or_else(closed)?;
            let intended_ns = intended_ns.unwrap_or_else(clock::monotonic_ns);
            port.publish_intended(intended_ns, robots).map_err(of_publish)
        };
        let sent = py.detach(|| self.thread.ask(send))??;
        if let Some(error) = &sent.not_woken {
            let message = CString::new(format!("the worker was not woken: {error}"))?;
            PyErr::warn(py, &py.get_type::<PyRuntimeWarning>(), &message, 2)?;
        }
        while let Some(news) = self.next_unreported() {
            let message = CString::new(format!("implausible: {news}"))?;
            PyErr::warn(py, &py.get_type::<PyRuntimeWarning>(), &message, 2)?;
        }
        if let Some(not_taken) = &sent.not_taken
            && self.is_first((u32::MAX, not_taken.reason.name()))
        {
            let message = CString::new(not_taken.to_string())?;
            PyErr::warn(py, &py.get_type::<PyRuntimeWarning>(), &message, 2)?;
        }
        if let Some(first) = &sent.first_refused {
            let what = (first.robot, first.reason.name());
            if self.is_first(what) {
                let more = match sent.refused - 1 {
                    0 => String::new(),
                    more => format!("; {more} more of this frame"),
                };
                let message = CString::new(format!("{first}{more}"))?;
                PyErr::warn(py, &py.get_type::<PyRuntimeWarning>(), &message, 2)?;
            }
        }
        Ok((sent.readers, sent.samples, sent.frame_seq))
    }

    fn counts(&self, py: Python<'_>) -> PyResult<Counts> {
        let counts = |port: &mut Option<Port>| {
            let port = port.as_ref().ok_or_else(closed)?;
            let sent = (port.frames_sent(), port.samples_sent());
            Ok((sent.0, sent.1, port.capacity(), port.degraded()))
        };
        py.detach(|| self.thread.ask(counts))?
    }

    /// Reason, samples, robot of the last one, and the whole in words.
    fn refusals(&self, py: Python<'_>) -> PyResult<Vec<(&'static str, u64, u32, String)>> {
        let refusals = |port: &mut Option<Port>| {
            let all = port.as_ref().ok_or_else(closed)?.refusals().into_iter();
            let told = |one: Refused| (one.reason.name(), one.count, one.robot, one.to_string());
            Ok(all.map(told).collect())
        };
        py.detach(|| self.thread.ask(refusals))?
    }

    /// Leaves the fleet.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.thread.ask(|port| *port = None))
    }
}

impl PublisherPort {
    /// True once for each robot and reason.
    fn is_first(&self, what: (u32, &'static str)) -> bool {
        self.warned.lock().is_ok_and(|mut warned| warned.insert(what))
    }

    /// Judges these states. News wait until they are reported.
    fn judge(&self, robots: &[RobotState]) {
        let now_ns = clock::monotonic_ns();
        let (Ok(mut judgement), Ok(mut unreported)) =
            (self.judgement.lock(), self.unreported.lock())
        else {
            return;
        };
        let new = robots.iter().filter(|state| state.power_w.is_some() && !state.held);
        new.for_each(|state| judgement.take(state, state.soc, now_ns));
        unreported.extend(judgement.take_news());
    }

    /// Without a lock afterwards: a warning runs Python, which may publish.
    fn next_unreported(&self) -> Option<String> {
        self.unreported.lock().ok()?.pop_front()
    }
}

fn closed() -> PyErr {
    pyo3::exceptions::PyRuntimeError::new_err("the publisher is closed. Connect a new one")
}

/// The states of the robots with these ids.
fn robots(ids: &Bound<'_, PyAny>, columns: &Bound<'_, PyDict>) -> PyResult<Vec<RobotState>> {
    let ids = Ids::read("ids", ids)?.0;
    let mut robots: Vec<RobotState> = ids.into_iter().map(RobotState::new).collect();
    for (name, given) in columns {
        let name: String = name.extract()?;
        let Some(column) = COLUMNS.iter().find(|column| column.name == name) else {
            let allowed: Vec<&str> = COLUMNS.iter().map(|column| column.name).collect();
            let allowed = allowed.join(", ");
            let error = format!("there is no column {name}, allowed are {allowed}");
            return Err(PyValueError::new_err(error));
        };
        match column.set {
            SetColumn::Number(set) => {
                let found = Numbers::read(&name, &given)?;
                let values = spread(&name, &found.values, &found.shape, robots.len())?;
                for (robot, value) in robots.iter_mut().zip(values) {
                    set(robot, Some(value).filter(|value| !value.is_nan()));
                }
            }
            SetColumn::Truth(set) => {
                let (values, shape) = truths(&name, &given)?;
                let values = spread(&name, &values, &shape, robots.len())?;
                for (robot, value) in robots.iter_mut().zip(values) {
                    set(robot, value);
                }
            }
        }
    }
    Ok(robots)
}

/// One value for each robot: a single one is for all.
fn spread<T: Copy>(name: &str, values: &[T], shape: &[usize], robots: usize) -> PyResult<Vec<T>> {
    match *shape {
        [] => Ok(vec![values[0]; robots]),
        [count] if count == robots => Ok(values.to_vec()),
        _ => {
            let allowed = format!("() or ({robots},), as ids");
            Err(shape_error(name, shape, &allowed))
        }
    }
}

/// Truth values: of NumPy, Python, or a list of them. Numbers are not.
fn truths(name: &str, given: &Bound<'_, PyAny>) -> PyResult<(Vec<bool>, Vec<usize>)> {
    use pyo3::exceptions::PyTypeError;
    if given.is_instance_of::<PyFloat>() {
        return Err(PyTypeError::new_err(format!(
            "{name} is {given}, allowed are True, False and arrays of them"
        )));
    }
    let py = given.py();
    let array = py.import("numpy")?.call_method1("asarray", (given,))?;
    let found = array.getattr("dtype")?;
    if found.getattr("kind")?.extract::<String>()? != "b" {
        return Err(PyTypeError::new_err(format!("{name} has dtype {found}, allowed is bool")));
    }
    let shape: Vec<usize> = array.getattr("shape")?.extract()?;
    let values = array.call_method0("ravel")?.call_method0("tolist")?.extract()?;
    Ok((values, shape))
}

/// Further frames may pass, unless the process has to connect again.
fn of_publish(error: Refusal) -> PyErr {
    match &error {
        Refusal::Send(reason) if reason.is_final() => ConnectError::new_err(error.to_string()),
        _ => PublishError::new_err(error.to_string()),
    }
}
