//! The connection of a planner: events with frames in shared memory, diagnostics, budgets and
//! outlooks.

use std::collections::HashMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use bytemuck::cast_slice;
use joulebus_consumer::wire::{Channel, ForecastHeader, FrameHeader as _, Quality};
use joulebus_consumer::{
    Arrival, Budgets, Config, Diagnostics, End, Event, Feed, KeptForecasts, Outlooks, ReadError,
    Subscriber as Ports, WorkerState,
};
use pyo3::IntoPyObjectExt as _;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyTuple};

use crate::error::{ConnectError, ReadError as ReadFailed, of_read};
use crate::port_thread::PortThread;

/// Longest wait without a look at Python's signals: Ctrl-C works within twice this.
pub(crate) const SLICE: Duration = Duration::from_millis(40);
/// Maximum timeout. Longer ones are the same as none.
const MAX_TIMEOUT: Duration = Duration::from_secs(1 << 32);

/// Tick and rows of the newest frame, if one arrived.
type Rows = PyResult<Option<(u64, Vec<u8>)>>;

/// The state of the thread.
pub(crate) struct PlannerState {
    ports: Option<Open>,
    frames: HashMap<u64, KeptForecasts>,
    next: u64,
}

struct Open {
    planner: Ports,
    diagnostics: Option<Feed<Diagnostics>>,
    budgets: Option<Feed<Budgets>>,
    outlooks: Option<Feed<Outlooks>>,
}

/// An event, as the thread reports it.
#[allow(clippy::large_enum_variant, reason = "there is one at a time")]
enum Observed {
    Frame(Memory),
    Gone(End),
    Stale { age_ns: u64 },
    Nothing,
    Closed,
}

/// Address and number of a frame that the thread keeps.
#[derive(Debug)]
struct Memory {
    number: u64,
    address: usize,
    robots: usize,
    header: ForecastHeader,
    arrival: Arrival,
}

#[pyclass(module = "joulebus._native", frozen)]
#[derive(Debug)]
pub(crate) struct PlannerPorts {
    thread: PortThread<PlannerState>,
}

#[pymethods]
impl PlannerPorts {
    #[new]
    fn new(py: Python<'_>, config: PathBuf, name: String) -> PyResult<Self> {
        let open = move || {
            let config = Config::load(config).map_err(|error| error.to_string())?;
            let planner = Ports::with_config(&config, &name).map_err(|error| error.to_string())?;
            let open = Open { planner, diagnostics: None, budgets: None, outlooks: None };
            Ok(PlannerState { ports: Some(open), frames: HashMap::new(), next: 0 })
        };
        let thread = py.detach(|| PortThread::start(open))?;
        Ok(Self { thread })
    }

    /// The next event within `timeout_s`, or without limit: a frame, `("gone", how)`,
    /// `("stale", age_s)`, or `None`.
    fn wait<'py>(
        &self,
        py: Python<'py>,
        timeout_s: Option<f64>,
    ) -> PyResult<Option<Bound<'py, PyAny>>> {
        let deadline = deadline(timeout_s)?;
        loop {
            let left = deadline
                .map_or(SLICE, |deadline| deadline.saturating_duration_since(Instant::now()));
            let slice = left.min(SLICE);
            let observed = py.detach(|| self.thread.ask(move |state| state.wait(slice)))??;
            match observed {
                Observed::Nothing => py.check_signals()?,
                observed => return Ok(Some(self.event(py, observed)?)),
            }
            if left.is_zero() {
                return Ok(None);
            }
        }
    }

    /// The fleet's newest diagnostics: tick and bytes. `None` if none arrived within `timeout_s`.
    fn diagnostics<'py>(
        &self,
        py: Python<'py>,
        timeout_s: Option<f64>,
    ) -> PyResult<Option<Bound<'py, PyTuple>>> {
        self.poll(py, timeout_s, |state| {
            state.newest(|open| (&open.planner, &mut open.diagnostics))
        })
    }

    /// The fleet's newest budgets: tick and bytes. `None` if none arrived within `timeout_s`.
    fn budgets<'py>(
        &self,
        py: Python<'py>,
        timeout_s: Option<f64>,
    ) -> PyResult<Option<Bound<'py, PyTuple>>> {
        self.poll(py, timeout_s, |state| state.newest(|open| (&open.planner, &mut open.budgets)))
    }

    /// The fleet's newest outlooks: tick and bytes. `None` if none arrived within `timeout_s`.
    fn outlooks<'py>(
        &self,
        py: Python<'py>,
        timeout_s: Option<f64>,
    ) -> PyResult<Option<Bound<'py, PyTuple>>> {
        self.poll(py, timeout_s, |state| state.newest(|open| (&open.planner, &mut open.outlooks)))
    }

    /// The worker as seen by the last event, and what was counted.
    fn status<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let observed = py.detach(|| self.thread.ask(|state| state.open().map(status)))?;
        let (worker, counts, kept) = observed?;
        let dict = PyDict::new(py);
        dict.set_item("worker", worker)?;
        for (name, count) in counts {
            dict.set_item(name, count)?;
        }
        dict.set_item("frames_kept", kept)?;
        Ok(dict)
    }

    /// Refuses a closed planner, and one of another process.
    fn check(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.thread.ask(|state| state.open().map(|_| ())))?
    }

    /// Leaves the fleet. Frames that are still in use keep their memory.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.thread.ask(|state| state.ports = None))
    }
}

impl PlannerPorts {
    fn event<'py>(&self, py: Python<'py>, observed: Observed) -> PyResult<Bound<'py, PyAny>> {
        match observed {
            Observed::Frame(memory) => {
                let thread = self.thread.share();
                FrameMemory { memory, thread }.into_bound_py_any(py)
            }
            Observed::Gone(end) => ("gone", end_name(end)).into_bound_py_any(py),
            Observed::Stale { age_ns } => ("stale", age_ns as f64 * 1e-9).into_bound_py_any(py),
            Observed::Nothing => Ok(py.None().into_bound(py)),
            Observed::Closed => Err(closed()),
        }
    }

    fn poll<'py>(
        &self,
        py: Python<'py>,
        timeout_s: Option<f64>,
        read: fn(&mut PlannerState) -> Rows,
    ) -> PyResult<Option<Bound<'py, PyTuple>>> {
        const PAUSE: Duration = Duration::from_millis(2);
        let deadline = deadline(timeout_s)?;
        loop {
            if let Some((tick, bytes)) = py.detach(|| self.thread.ask(read))?? {
                let tick = tick.into_bound_py_any(py)?;
                return PyTuple::new(py, [tick, PyBytes::new(py, &bytes).into_any()]).map(Some);
            }
            py.check_signals()?;
            if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
                return Ok(None);
            }
            py.detach(|| std::thread::sleep(PAUSE));
        }
    }
}

impl PlannerState {
    fn open(&mut self) -> PyResult<(&mut Open, usize)> {
        let kept = self.frames.len();
        self.ports.as_mut().map(|open| (open, kept)).ok_or_else(closed)
    }

    fn wait(&mut self, slice: Duration) -> PyResult<Observed> {
        let kept = self.frames.len();
        let Some(open) = &mut self.ports else {
            return Ok(Observed::Closed);
        };
        let arrival = match open.planner.wait_next(slice) {
            Ok(Event::Frame(frame)) => frame.arrival(),
            Ok(Event::Gone(end)) => return Ok(Observed::Gone(end)),
            Ok(Event::Stale { age_ns }) => return Ok(Observed::Stale { age_ns }),
            // The caller learns of an interruption by its signal.
            Ok(_) => return Ok(Observed::Nothing),
            Err(error) => return Err(read_failed(&error, kept)),
        };
        let Some(frame) = open.planner.take_current() else {
            return Ok(Observed::Nothing);
        };
        let number = self.next;
        self.next += 1;
        let memory = Memory {
            number,
            address: frame.robots().as_ptr().expose_provenance(),
            robots: frame.robots().len(),
            header: *frame.header(),
            arrival,
        };
        self.frames.insert(number, frame);
        Ok(Observed::Frame(memory))
    }

    /// The newest frame of a channel, which the first call opens.
    fn newest<C: Channel>(&mut self, of: fn(&mut Open) -> (&Ports, &mut Option<Feed<C>>)) -> Rows {
        let (open, kept) = self.open()?;
        let (planner, feed) = of(open);
        let feed = match feed {
            Some(feed) => feed,
            none => {
                let opened = planner.feed();
                none.insert(opened.map_err(|error| ConnectError::new_err(error.to_string()))?)
            }
        };
        let frame = feed.latest().map_err(|error| read_failed(&error, kept))?;
        Ok(frame.map(|frame| (frame.header().order().number, cast_slice(frame.robots()).to_vec())))
    }
}

/// A frame of forecasts in shared memory, for NumPy. The array that NumPy makes has this object as
/// its base, which keeps the frame. Nothing is copied.
#[pyclass(module = "joulebus._native", frozen)]
#[derive(Debug)]
pub(crate) struct FrameMemory {
    memory: Memory,
    thread: PortThread<PlannerState>,
}

#[pymethods]
impl FrameMemory {
    /// NumPy's array interface, version 3: address, and that it must not be written.
    #[getter(__array_interface__)]
    fn array_interface<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.thread.check_process()?;
        let (fields, size) = crate::dtype::forecast();
        let dict = PyDict::new(py);
        dict.set_item(intern!(py, "version"), 3)?;
        dict.set_item(intern!(py, "shape"), (self.memory.robots,))?;
        dict.set_item(intern!(py, "typestr"), format!("|V{size}"))?;
        // Without gaps: the payloads have no padding.
        let descr: Vec<_> = fields.iter().map(|(name, code, _)| (*name, code.as_str())).collect();
        dict.set_item(intern!(py, "descr"), descr)?;
        dict.set_item(intern!(py, "data"), (self.memory.address, true))?;
        Ok(dict)
    }

    fn __len__(&self) -> usize {
        self.memory.robots
    }

    /// The header's fields that a planner asks for.
    #[getter]
    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (header, arrival) = (&self.memory.header, &self.memory.arrival);
        let dict = PyDict::new(py);
        for (name, value) in [
            ("tick", header.tick),
            ("worker_pid", header.pid.into()),
            ("worker_epoch", header.worker_epoch),
            ("period_ns", header.period_ns),
            ("model_hash", header.model_hash),
            ("capacity", header.capacity.into()),
            ("compute_start_ns", header.compute_start_ns),
            ("compute_end_ns", header.compute_end_ns),
            ("sent_ns", header.sent_ns),
            ("sent_unix_ns", header.sent_unix_ns),
            ("ticks_skipped", header.ticks_skipped),
            ("ticks_late", header.ticks_late),
            ("samples_accepted", header.samples_accepted),
            ("ticks_missed", arrival.ticks_missed),
        ] {
            dict.set_item(name, value)?;
        }
        dict.set_item("restarted", arrival.restarted)?;
        Ok(dict)
    }
}

impl Drop for FrameMemory {
    fn drop(&mut self) {
        let number = self.memory.number;
        self.thread.post(move |state| drop(state.frames.remove(&number)));
    }
}

/// Name and detail of a quality: readings so far, steps, or the name of the reason.
#[pyfunction]
pub(crate) fn quality(
    py: Python<'_>,
    code: u16,
    detail: u16,
) -> PyResult<(&'static str, Py<PyAny>)> {
    let number = |detail: u16| detail.into_py_any(py);
    Ok(match Quality::decode(code, detail) {
        Quality::Fresh => ("Fresh", py.None()),
        Quality::Held => ("Held", py.None()),
        Quality::Warmup { have } => ("Warmup", number(have)?),
        Quality::OpenLoop { steps } => ("OpenLoop", number(steps)?),
        Quality::Invalid(reason) => ("Invalid", format!("{reason:?}").into_py_any(py)?),
        _ => ("Unknown", py.None()),
    })
}

/// The newest state: the worker, numbers counted, and frames kept.
fn status((open, kept): (&mut Open, usize)) -> (&'static str, [(&'static str, u64); 6], usize) {
    let worker = match open.planner.worker() {
        WorkerState::Waiting => "waiting",
        WorkerState::Alive => "alive",
        WorkerState::Stale { .. } => "stale",
        WorkerState::Gone(_) => "gone",
        _ => "unknown",
    };
    let counts = open.planner.counts();
    let counts = [
        ("frames", counts.frames),
        ("gaps", counts.gaps),
        ("ticks_missed", counts.ticks_missed),
        ("workers", counts.workers),
        ("degraded", open.planner.degraded()),
        ("foreign", open.planner.foreign()),
    ];
    (worker, counts, kept)
}

const fn end_name(end: End) -> &'static str {
    match end {
        End::Ended => "ended",
        End::Exited => "exited",
        End::FoundDead => "found dead",
        End::Unreachable => "unreachable",
        _ => "unknown",
    }
}

pub(crate) fn deadline(timeout_s: Option<f64>) -> PyResult<Option<Instant>> {
    let Some(timeout_s) = timeout_s else {
        return Ok(None);
    };
    if timeout_s.is_nan() || timeout_s < 0.0 {
        return Err(PyValueError::new_err(format!(
            "timeout is {timeout_s}, allowed are 0 s and more, and None for ever"
        )));
    }
    let timeout = Duration::try_from_secs_f64(timeout_s).unwrap_or(MAX_TIMEOUT);
    Ok(Instant::now().checked_add(timeout.min(MAX_TIMEOUT)))
}

fn closed() -> PyErr {
    PyRuntimeError::new_err("the planner is closed. Connect a new one")
}

fn read_failed(error: &ReadError, kept: usize) -> PyErr {
    let hint = match kept {
        0 => String::new(),
        _ => format!(
            "; {kept} frames are in use by arrays and variables of this program: copy what is kept longer \
             (`frame.rows.copy()`)"
        ),
    };
    ReadFailed::new_err(format!("{}{hint}", of_read(error)))
}
