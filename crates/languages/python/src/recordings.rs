//! Captures and recorded trials as columns.

use std::collections::{BTreeSet, HashSet};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use bytemuck::cast_slice;
use joulebus_capture_format::import::{CurrentSign, Mapping, import};
use joulebus_capture_format::{Entry, Frame, Message, MessageKind, ReadError, Reader};
use joulebus_dataset::inspect::{
    Implausible, Limits, in_python, judge, judge_from, judge_together,
};
use joulebus_dataset::rows::trial_rows as rows_of;
use joulebus_dataset::trial::{BagTrial, Column, ColumnMap, MappedColumn, Row, Trial, TrialError};
use joulebus_predictor::INPUTS;
use joulebus_publisher::plausibility::{Kind, Origin};
use joulebus_wire::{
    Budgets, Channel, Diagnostics, Forecasts, FrameHeader as _, Outlooks, Samples,
};
use numpy::PyArrayDyn;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{Doubles, Ids, array, shape_error};
use crate::error::{RecordingError, of_file};

type Floats<'py> = Bound<'py, PyArrayDyn<f32>>;
/// A trial: name of the robot, and its columns.
type Named<'py> = (Option<String>, Bound<'py, PyDict>);

/// Maximum size of a bag's mapping, bytes.
const MAX_MAPPING_BYTES: u64 = 4 << 20;

/// The readable channels of a capture.
const READABLE: [Readable; 5] = [
    Readable::of::<Samples>(),
    Readable::of::<Forecasts>(),
    Readable::of::<Diagnostics>(),
    Readable::of::<Budgets>(),
    Readable::of::<Outlooks>(),
];
/// Messages between two looks at Python's signals.
const AT_ONCE: usize = 64;

/// The rows of one kind of messages of a capture, part by part: memory holds one part.
#[pyclass(module = "joulebus._native")]
pub(crate) struct CaptureRows {
    path: PathBuf,
    /// Never locked: Python asks for a type that threads may share.
    reader: Mutex<Reader<File>>,
    wanted: Wanted,
    seen: CaptureContents,
    /// Log time of the capture's first message, Unix ns.
    first_ns: Option<u64>,
    has_ended: bool,
    damage: Option<String>,
}

/// The rows that are asked for.
struct Wanted {
    of: Readable,
    fleet: Option<String>,
    /// All, if `None`.
    robots: Option<HashSet<u32>>,
    start: Edge,
    stop: Option<Edge>,
}

/// An end of a time window.
#[derive(Clone, Copy, FromPyObject)]
enum Edge {
    /// Unix ns.
    #[pyo3(transparent)]
    At(u64),
    /// After the capture's first message, s.
    #[pyo3(transparent)]
    After(f64),
}

impl Edge {
    const fn unix_ns(self, first_ns: u64) -> u64 {
        match self {
            Self::At(unix_ns) => unix_ns,
            Self::After(offset_s) => first_ns.saturating_add((offset_s * 1e9) as u64),
        }
    }
}

/// What the capture has, as far as it was read.
#[derive(Default)]
struct CaptureContents {
    fleets: BTreeSet<String>,
    /// Ends of topics.
    kinds: BTreeSet<String>,
}

#[pymethods]
impl CaptureRows {
    /// Times are Unix ns (an integer), or seconds after the capture's first message (a float).
    #[new]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        kind: &str,
        fleet: Option<String>,
        robots: Option<&Bound<'_, PyAny>>,
        start: Edge,
        stop: Option<Edge>,
    ) -> PyResult<Self> {
        let Some(of) = READABLE.into_iter().find(|of| of.kind.name() == kind) else {
            let allowed = READABLE.map(|of| of.kind.name()).join(", ");
            return Err(PyValueError::new_err(format!(
                "there is no topic {kind}, allowed are {allowed}"
            )));
        };
        let robots = robots.map(|ids| Ids::read("robots", ids)).transpose()?;
        let robots = robots.map(|ids| ids.0.into_iter().collect());
        let opened = py.detach(|| Reader::open(&path));
        let reader = opened.map_err(|error| refused(&path, &error))?;
        Ok(Self {
            path,
            reader: Mutex::new(reader),
            wanted: Wanted { of, fleet, robots, start, stop },
            seen: CaptureContents::default(),
            first_ns: None,
            has_ended: false,
            damage: None,
        })
    }

    /// The next messages, until they have at least `rows` rows: the rows as bytes, and for each
    /// message its number of rows, its tick (for samples, the source's frame), and its times. After
    /// the last message `ended` is true, and `damage` says where the file is damaged.
    fn take<'py>(&mut self, py: Python<'py>, rows: usize) -> PyResult<Bound<'py, PyDict>> {
        let mut part = Part::default();
        while !py.detach(|| self.read(&mut part, rows)) {
            py.check_signals()?;
        }
        if self.has_ended {
            self.check()?;
        }
        let dict = part.columns(py)?;
        dict.set_item("ended", self.has_ended)?;
        dict.set_item("damage", self.damage.as_deref().filter(|_| self.has_ended))?;
        Ok(dict)
    }
}

/// Adds the rows of the robots, or all. Returns the frame's number, and that of the rows.
type Add = fn(&mut Part, &Message, Option<&HashSet<u32>>) -> Option<(u64, usize)>;

/// A channel whose rows can be read.
#[derive(Clone, Copy)]
struct Readable {
    kind: MessageKind,
    add: Add,
}

impl Readable {
    const fn of<C: Channel>() -> Self {
        Self { kind: MessageKind::of::<C>(), add: Part::add::<C> }
    }
}

/// Rows and their messages.
#[derive(Default)]
struct Part {
    bytes: Vec<u8>,
    all_rows: usize,
    rows: Vec<i64>,
    tick: Vec<u64>,
    log_ns: Vec<u64>,
    sent_ns: Vec<u64>,
}

impl CaptureRows {
    /// Reads the next messages into `part`. Returns whether it is complete.
    fn read(&mut self, part: &mut Part, rows: usize) -> bool {
        for _ in 0..AT_ONCE {
            if self.has_ended || part.all_rows >= rows {
                return true;
            }
            let reader = self.reader.get_mut().unwrap_or_else(PoisonError::into_inner);
            match reader.next_entry() {
                Ok(Some(entry)) => self.take_entry(&entry, part),
                Ok(None) => self.has_ended = true,
                // The next one can be read.
                Err(error @ ReadError::Message { .. }) => {
                    self.damage.get_or_insert(error.to_string());
                }
                Err(error) => {
                    self.damage = Some(error.to_string());
                    self.has_ended = true;
                }
            }
        }
        false
    }

    fn take_entry(&mut self, entry: &Entry, part: &mut Part) {
        let Wanted { of, fleet, robots, start, stop } = &self.wanted;
        let first_ns = *self.first_ns.get_or_insert(entry.log_time_ns);
        let Some(kind) = entry.message.kind() else {
            return;
        };
        if kind == of.kind {
            self.seen.fleets.insert(entry.fleet.to_string());
        }
        let name = entry.topic.rsplit('/').next().unwrap_or_default();
        self.seen.kinds.insert(name.to_owned());
        if stop.is_some_and(|stop| entry.log_time_ns >= stop.unix_ns(first_ns)) {
            // Messages are in the order of their log time. Whether the capture has any that are
            // asked for has to be known first.
            self.has_ended = match fleet {
                Some(fleet) => self.seen.fleets.contains(fleet),
                None => !self.seen.fleets.is_empty(),
            };
            return;
        }
        let is_of_other = fleet.as_deref().is_some_and(|wanted| wanted != &*entry.fleet);
        if kind != of.kind || is_of_other || entry.log_time_ns < start.unix_ns(first_ns) {
            return;
        }
        // Rows of two fleets are not mixed.
        self.has_ended = fleet.is_none() && self.seen.fleets.len() > 1;
        match (of.add)(part, &entry.message, robots.as_ref()) {
            None | Some((_, 0)) => {}
            Some((number, rows)) => {
                part.all_rows += rows;
                part.rows.push(rows as i64);
                part.tick.push(number);
                part.log_ns.push(entry.log_time_ns);
                part.sent_ns.push(entry.publish_time_ns);
            }
        }
    }

    /// Whether it was recorded, and of one fleet.
    fn check(&self) -> PyResult<()> {
        let (path, name) = (self.path.display(), self.wanted.of.kind.name());
        let fleets: Vec<&str> = self.seen.fleets.iter().map(String::as_str).collect();
        let wanted = self.wanted.fleet.as_deref();
        if fleets.is_empty() {
            let found: Vec<&str> = self.seen.kinds.iter().map(String::as_str).collect();
            let found = match (found.is_empty(), &self.damage) {
                (false, _) => format!("; it has: {}", found.join(", ")),
                (true, None) => ", nor any other message of joulebus".to_owned(),
                (true, Some(damage)) => format!(": {damage}"),
            };
            return Err(RecordingError::new_err(format!("{path} has no {name}{found}")));
        }
        if let Some(wanted) = wanted.filter(|wanted| !fleets.contains(wanted)) {
            let found = fleets.join(", ");
            return Err(RecordingError::new_err(format!(
                "{path} has no {name} of fleet {wanted}, but of: {found}"
            )));
        }
        if wanted.is_none() && fleets.len() > 1 {
            return Err(RecordingError::new_err(format!(
                "{path} has {name} of several fleets, such as {}. Name one: fleet=\"…\"",
                fleets.join(" and ")
            )));
        }
        Ok(())
    }
}

impl Part {
    /// Adds the rows of the robots, or all. Returns the frame's number, and that of the rows.
    fn add<C: Channel>(
        &mut self,
        message: &Message,
        robots: Option<&HashSet<u32>>,
    ) -> Option<(u64, usize)> {
        let Frame { header, rows } = message.frame::<C>()?;
        let number = header.order().number;
        let Some(wanted) = robots else {
            self.bytes.extend_from_slice(cast_slice(rows));
            return Some((number, rows.len()));
        };
        let mut added = 0;
        for row in rows {
            if C::robot(row).is_some_and(|robot| wanted.contains(&robot)) {
                self.bytes.extend_from_slice(bytemuck::bytes_of(row));
                added += 1;
            }
        }
        Some((number, added))
    }

    fn columns(self, py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
        let (bytes, messages) = ([self.bytes.len()], [self.rows.len()]);
        let dict = PyDict::new(py);
        dict.set_item("bytes", array(py, self.bytes, &bytes)?)?;
        dict.set_item("rows", array(py, self.rows, &messages)?)?;
        dict.set_item("tick", array(py, self.tick, &messages)?)?;
        dict.set_item("log_ns", array(py, self.log_ns, &messages)?)?;
        dict.set_item("sent_ns", array(py, self.sent_ns, &messages)?)?;
        Ok(dict)
    }
}

fn refused(path: &Path, error: &ReadError) -> PyErr {
    match error {
        ReadError::Io(error) => of_file(path, error),
        error => RecordingError::new_err(format!("{}: {error}", path.display())),
    }
}

/// Name of a column in SI units.
const fn name(column: Column) -> &'static str {
    match column {
        Column::Phase => "phase",
        Column::V => "v_mps",
        Column::Omega => "omega_radps",
        Column::X => "x_m",
        Column::Y => "y_m",
        Column::Theta => "theta_rad",
        Column::Voltage => "voltage_v",
        Column::Current => "current_a",
        Column::Power => "power_w",
        Column::VMeasured => "v_measured_mps",
        Column::OmegaMeasured => "omega_measured_radps",
        Column::Soc => "soc",
    }
}

/// Options for reading recordings: columns of CSV files as `quantity=column`, the sign of the
/// current, and findings that are accepted.
pub(crate) type Given = (Vec<String>, Option<String>, Vec<String>);

/// The same, understood.
#[derive(Debug, Clone, Default)]
pub(crate) struct Reading {
    pub(crate) map: ColumnMap,
    accepted: Vec<Kind>,
}

impl Reading {
    pub(crate) fn new((columns, current, accepted): Given) -> PyResult<Self> {
        let refused = |error: String| PyValueError::new_err(error);
        let columns = columns.iter().map(|column| column.parse::<MappedColumn>());
        let columns = columns.collect::<Result<Vec<_>, _>>();
        let map = columns.map(ColumnMap::from).map_err(|error| refused(error.to_string()))?;
        let turned = match current.as_deref() {
            None | Some("discharge-positive") => false,
            Some("discharge-negative") => true,
            Some(found) => {
                let allowed = "discharge-positive, discharge-negative";
                return Err(refused(format!("current is {found:?}, allowed are {allowed}")));
            }
        };
        let accepted = accepted.iter().map(|kind| kind.parse());
        let accepted = accepted.collect::<Result<_, String>>().map_err(refused)?;
        Ok(Self { map: map.discharge_negative(turned), accepted })
    }

    /// Lines about what may be implausible.
    ///
    /// # Errors
    /// Readings that make results wrong, and are not accepted.
    pub(crate) fn judge<'a>(
        &self,
        found: impl IntoIterator<Item = &'a Implausible>,
        short: impl IntoIterator<Item = &'a Trial>,
    ) -> PyResult<Vec<String>> {
        let together = judge_together(short);
        let found: Vec<&Implausible> = found.into_iter().collect();
        let (mut errors, mut others) = (Vec::new(), Vec::new());
        let mut reported = BTreeSet::new();
        for one in found.into_iter().chain(&together) {
            let finding = &one.finding;
            if reported.insert((finding.severity, finding.kind, finding.quantity)) {
                let is_error = finding.is_error() && !self.accepted.contains(&finding.kind);
                let lines = if is_error { &mut errors } else { &mut others };
                lines.push(format!("implausible {}: {}", finding.kind, one.place));
            }
        }
        if errors.is_empty() {
            return Ok(others);
        }
        Err(RecordingError::new_err(in_python(&errors.join("\n"))))
    }

    /// The same of trials in memory. What may be implausible is not reported.
    fn judge_trials(&self, trials: &[Trial]) -> PyResult<()> {
        let found: Vec<Implausible> =
            trials.iter().flat_map(|trial| judge(trial, &Limits::default())).collect();
        self.judge(&found, trials).map(|_| ())
    }
}

/// The trials of a file in SI units: name of the robot, and its columns. `name`: the file is a CSV
/// that has another name.
#[pyfunction]
#[pyo3(signature = (path, reading, name = None))]
pub(crate) fn read_trials<'py>(
    py: Python<'py>,
    path: PathBuf,
    reading: Given,
    name: Option<PathBuf>,
) -> PyResult<Vec<Named<'py>>> {
    let reading = Reading::new(reading)?;
    let trials = py.detach(|| match name {
        None => Trial::read_mapped(&path, &reading.map),
        Some(name) => {
            let text = joulebus_files::open(&path).map_err(TrialError::io(&path))?;
            Trial::read_text(name, BufReader::new(text), &reading.map)
        }
    });
    let trials = trials.map_err(|error| refused_trial(&error))?;
    py.detach(|| reading.judge_trials(&trials))?;
    let named = |trial: &Trial| Ok((trial.robot_name().map(str::to_owned), columns(py, trial)?));
    trials.iter().map(named).collect()
}

/// The trials of a bag of ROS 2 in MCAP, as of [`read_trials`], and what of it could not be used.
/// `bag`: the path that names it, and the name of a robot without a namespace.
#[pyfunction]
pub(crate) fn read_bag<'py>(
    py: Python<'py>,
    path: PathBuf,
    bag: (PathBuf, String),
    mapping: Option<PathBuf>,
    reading: Given,
) -> PyResult<(Vec<Named<'py>>, Option<String>)> {
    let (bag, name) = bag;
    let (_, current, _) = &reading;
    let sign = current.as_deref().map(|sign| match sign {
        "discharge-positive" => CurrentSign::DischargePositive,
        // Another one is refused below.
        _ => CurrentSign::DischargeNegative,
    });
    let reading = Reading::new(reading)?;
    let refused = |error: &dyn std::fmt::Display| {
        RecordingError::new_err(format!("{}: {error}", bag.display()))
    };
    let mut own = match mapping {
        None => Mapping::default(),
        Some(path) => {
            let text = joulebus_files::read_to_string(&path, MAX_MAPPING_BYTES);
            let text = text.map_err(|error| of_file(&path, &error))?;
            let parsed = text.parse::<Mapping>();
            parsed.map_err(|error| PyValueError::new_err(format!("{}: {error}", path.display())))?
        }
    };
    if let Some(sign) = sign {
        own.set_current(sign);
    }
    own.check().map_err(|error| PyValueError::new_err(error.to_string()))?;
    let opened = joulebus_files::open(&path).map_err(|error| of_file(&path, &error))?;
    let imported = py.detach(|| import(opened, &name, &own)).map_err(|error| refused(&error))?;
    let (mut found, mut left_out) = (Vec::new(), String::new());
    for robot in &imported.robots {
        for trial in BagTrial::runs(&bag, robot) {
            match trial {
                Ok(trial) => found.push(trial),
                Err(error) => left_out += &format!("\nleft out   {}: {error}", robot.name),
            }
        }
    }
    let is_whole = imported.is_whole() && left_out.is_empty();
    let lost = (!is_whole).then(|| imported.to_string().trim_end().to_owned() + &left_out);
    if found.is_empty() {
        return Err(refused(&format!("nothing could be used\n{}", lost.unwrap_or_default())));
    }
    let judged =
        found.iter().flat_map(|one| judge_from(Origin::Bag, &one.trial, &Limits::default()));
    let judged: Vec<Implausible> = judged.collect();
    reading.judge(&judged, found.iter().map(|one| &one.trial))?;
    let named = |one: &BagTrial| Ok((Some(one.name.clone()), columns(py, &one.trial)?));
    Ok((found.iter().map(named).collect::<PyResult<_>>()?, lost))
}

/// The columns of a trial in SI units.
pub(crate) fn columns<'py>(py: Python<'py>, trial: &Trial) -> PyResult<Bound<'py, PyDict>> {
    let (dict, rows) = (PyDict::new(py), [trial.rows()]);
    dict.set_item("timestamp_s", array(py, trial.timestamp_s().to_vec(), &rows)?)?;
    for column in Column::ALL {
        if let Some(values) = trial.column(column) {
            dict.set_item(name(column), array(py, values.to_vec(), &rows)?)?;
        }
    }
    Ok(dict)
}

/// Writes a trial of one robot, in SI units.
#[pyfunction]
pub(crate) fn write_trial(
    py: Python<'_>,
    path: PathBuf,
    robot: &str,
    columns: &Bound<'_, PyDict>,
    accepted: Vec<String>,
) -> PyResult<()> {
    let trial = trial(&path, robot, columns)?;
    Reading::new((Vec::new(), None, accepted))?.judge_trials(std::slice::from_ref(&trial))?;
    py.detach(|| trial.to_table().write(&path))
        .map_err(|error| RecordingError::new_err(error.to_string()))
}

/// Rows of features of a trial and the readings that followed, W, on which a network is trained.
#[pyfunction]
pub(crate) fn trial_rows<'py>(
    py: Python<'py>,
    columns: &Bound<'py, PyDict>,
    accepted: Vec<String>,
) -> PyResult<(Floats<'py>, Floats<'py>)> {
    let trial = trial(Path::new("the trial"), "", columns)?;
    Reading::new((Vec::new(), None, accepted))?.judge_trials(std::slice::from_ref(&trial))?;
    let found = py.detach(|| rows_of(&trial)).rows;
    let features: Vec<f32> = found.iter().flat_map(|row| row.features).collect();
    let targets_w: Vec<f32> = found.iter().map(|row| row.target_w).collect();
    let rows = found.len();
    Ok((array(py, features, &[rows, INPUTS])?, array(py, targets_w, &[rows])?))
}

/// The trial of columns in SI units.
pub(crate) fn trial(path: &Path, robot: &str, columns: &Bound<'_, PyDict>) -> PyResult<Trial> {
    let mut times_s = None;
    let mut values: [Option<Vec<f64>>; Column::ALL.len()] = Default::default();
    for (key, given) in columns {
        let key: String = key.extract()?;
        let found = Doubles::read(&key, &given)?;
        let [_] = *found.shape else {
            return Err(shape_error(&key, &found.shape, "(rows,)"));
        };
        if key == "timestamp_s" {
            times_s = Some(found.values);
        } else if let Some(column) = Column::ALL.into_iter().find(|column| name(*column) == key) {
            values[column as usize] = Some(found.values);
        } else {
            let allowed = Column::ALL.map(name).join(", ");
            return Err(PyValueError::new_err(format!(
                "there is no column {key}, allowed are timestamp_s, {allowed}"
            )));
        }
    }
    let times_s = times_s
        .ok_or_else(|| PyValueError::new_err("timestamp_s is missing: the time of each row, s"))?;
    for (column, values) in Column::ALL.into_iter().zip(&values) {
        if let Some(values) = values.as_ref().filter(|values| values.len() != times_s.len()) {
            let allowed = format!("({},), that of timestamp_s", times_s.len());
            return Err(shape_error(name(column), &[values.len()], &allowed));
        }
    }
    let row = |(at, timestamp_s): (usize, &f64)| Row {
        timestamp_s: *timestamp_s,
        values: std::array::from_fn(|column| {
            values[column].as_ref().map_or(f64::NAN, |values| values[at])
        }),
    };
    let rows = times_s.iter().enumerate().map(row);
    Trial::from_rows(path, robot, rows).map_err(|error| refused_trial(&error))
}

pub(crate) fn refused_trial(error: &TrialError) -> PyErr {
    match error.os_error() {
        Some(source) => of_file(error.path(), source),
        None => RecordingError::new_err(in_python(&error.to_string())),
    }
}
