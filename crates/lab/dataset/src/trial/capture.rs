//! Rows of the samples in a capture: the inverse of
//! [`Trial::to_samples`](super::Trial::to_samples).
//!
//! A sample has the reading of one row and the command and time of the next, so row *k* gets its
//! time and command from sample *k* − 1 and its reading from sample *k*. The command of the first
//! row is not in the capture.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Read as _, Write as _};
use std::os::unix::fs::FileExt as _;
use std::path::Path;
use std::sync::Arc;

use joulebus_capture_format::{Frame, ReadError, Reader};
use joulebus_wire::{Sample, Samples, sample_flag as flag};

use super::error::{Fault, TrialError};
use super::layout::{mapped, said};
use super::limits::{InMemory, MCAP_MAGIC};
use super::table::{Cell, Column, Table, Take, check_value, too_many_rows};

/// Bytes within which the first record of a capture names its writer.
const HEAD_BYTES: u64 = 64;

/// True if a file is named `.mcap` and written by joulebus, by its first record.
pub fn is_capture(path: &Path) -> bool {
    try_is_capture(path).unwrap_or(false)
}

/// The same.
///
/// # Errors
/// The operating system's, if a file of that name cannot be read.
pub(crate) fn try_is_capture(path: &Path) -> io::Result<bool> {
    if !joulebus_files::ends_in(path, "mcap") {
        return Ok(false);
    }
    let mut head = Vec::new();
    joulebus_files::open(path)?.take(HEAD_BYTES).read_to_end(&mut head)?;
    let name = b"joulebus";
    Ok(head.starts_with(MCAP_MAGIC) && head.windows(name.len()).any(|at| at == name))
}

/// Calls `take` with a table for each run of a robot's source (samples whose time advances, without
/// a discontinuity), in SI units converted to those of files: by fleet, robot and time. The robot's
/// name is its id, after the fleet's name if the capture has several. Rows on the charger have no
/// power that flows into the battery. Only one run and a fixed number of samples are in memory at a
/// time. The others wait in a temporary file.
pub(super) fn read(
    path: &Path,
    in_memory: InMemory,
    take: &mut Take<'_>,
) -> Result<(), TrialError> {
    let refused = |detail: String| TrialError::new(path, Fault::Capture, detail);
    let mut store = collect(path, in_memory)?;
    let several_fleets = {
        let mut fleets: Vec<&str> = store.robots.keys().map(|robot| robot.0.as_ref()).collect();
        fleets.dedup();
        fleets.len() > 1
    };
    let mut found = 0;
    for ((fleet, robot), runs) in std::mem::take(&mut store.robots) {
        let name = match several_fleets {
            true => format!("{fleet}/{robot}"),
            false => robot.to_string(),
        };
        for (at, run) in runs.iter().copied().enumerate() {
            let next = runs.get(at + 1);
            let is_part = [Some(&run), next].into_iter().flatten().any(|run| store.goes_on(*run));
            let samples = store.samples(run).map_err(|error| refused(spilled(&error)))?;
            if samples.len() < 2 {
                continue;
            }
            found += 1;
            let mut table = table(path, &name, &samples)?;
            table.is_part = is_part;
            table.leave_out_charging(samples.iter().map(|sample| sample.flags));
            if take(table).is_break() {
                return Ok(());
            }
        }
    }
    match found {
        0 => Err(refused("no robot has two samples in a row".to_owned())),
        _ => Ok(()),
    }
}

/// Sorts the samples of a capture by run.
fn collect(path: &Path, in_memory: InMemory) -> Result<Store, TrialError> {
    let refused = |detail: String| TrialError::new(path, Fault::Capture, detail);
    let failed = |error: ReadError| refused(error.to_string());
    let mut reader = Reader::open(path).map_err(failed)?;
    let mut store = Store::default();
    let mut frames = 0_u64;
    // The run of a source that each robot's last sample came from.
    let mut sources: BTreeMap<Robot, (u64, u64)> = BTreeMap::new();
    while let Some(entry) = reader.next_entry().map_err(failed)? {
        let Ok(Frame { header, rows }) = entry.message.into_frame::<Samples>() else {
            continue;
        };
        frames += 1;
        for sample in rows {
            let robot = (Arc::clone(&entry.fleet), sample.robot);
            let source = (header.source_id, header.source_epoch);
            let is_same = sources.insert(robot.clone(), source) == Some(source);
            let goes_on = is_same && !sample.has(flag::DISCONTINUITY);
            let run = store.run(robot, goes_on, in_memory.part_rows);
            // Ingest refuses a time that does not advance.
            let is_first = store.runs[run].rows == 0 && !store.runs[run].goes_on;
            if !is_first && sample.stamp_ns <= store.runs[run].stamp_ns {
                continue;
            }
            store.push(run, sample).map_err(|error| refused(spilled(&error)))?;
            if store.runs[run].rows > in_memory.max_rows {
                return Err(too_many_rows(path, in_memory.max_rows));
            }
        }
    }
    if frames == 0 {
        let detail = "no samples of joulebus in this MCAP file. A capture of another host's \
            planners has none: record \
                      beside the worker. Convert recordings of other programs: joulebus import";
        return Err(refused(detail.to_owned()));
    }
    // A run of one sample is no trial: it belongs to the one that it goes on with.
    let successive = store.robots.values().flat_map(|runs| runs.windows(2));
    let lonely = successive.filter(|pair| store.goes_on(pair[1]) && store.runs[pair[1]].rows == 1);
    let lonely: Vec<[usize; 2]> = lonely.map(|pair| [pair[0], pair[1]]).collect();
    for [before, run] in lonely {
        let moved = store.samples(run).and_then(|samples| {
            let mut samples = samples.into_iter();
            samples.try_for_each(|sample| store.push(before, sample))
        });
        moved.map_err(|error| refused(spilled(&error)))?;
    }
    Ok(store)
}

fn spilled(error: &io::Error) -> String {
    let folder = std::env::temp_dir();
    let folder = folder.display();
    format!(
        "cannot keep samples in a temporary file in {folder}: {error}. TMPDIR names another folder"
    )
}

type Robot = (Arc<str>, u32);

const SAMPLE_BYTES: usize = size_of::<Sample>();
/// Samples in memory before they go to the temporary file: 75 MB.
const MAX_PENDING: usize = 1 << 20;

/// Samples sorted by run: some in memory, others in a temporary file that has no name.
#[derive(Default)]
struct Store {
    /// Runs of each robot, as places in `runs`.
    robots: BTreeMap<Robot, Vec<usize>>,
    runs: Vec<Run>,
    pending: usize,
    file: Option<File>,
    written_bytes: u64,
}

#[derive(Default)]
struct Run {
    /// Positions of samples in the temporary file, and their numbers.
    blocks: Vec<(u64, usize)>,
    pending: Vec<Sample>,
    rows: usize,
    /// Stamp of the last sample, also of the run before that this one goes on with.
    stamp_ns: u64,
    /// True if it goes on with the run before, which was full.
    goes_on: bool,
}

impl Store {
    fn goes_on(&self, run: usize) -> bool {
        self.runs[run].goes_on
    }

    /// The robot's last run, or a new one, also where the last has `part_rows`.
    fn run(&mut self, robot: Robot, goes_on: bool, part_rows: usize) -> usize {
        let own = self.robots.entry(robot).or_default();
        let has_room = |run: &usize| goes_on && self.runs[*run].rows < part_rows;
        if let Some(last) = own.last().copied().filter(has_room) {
            return last;
        }
        let full = own.last().filter(|_| goes_on).map(|last| self.runs[*last].stamp_ns);
        own.push(self.runs.len());
        self.runs.push(Run {
            stamp_ns: full.unwrap_or_default(),
            goes_on: full.is_some(),
            ..Run::default()
        });
        self.runs.len() - 1
    }

    fn push(&mut self, run: usize, sample: Sample) -> io::Result<()> {
        let run = &mut self.runs[run];
        run.rows += 1;
        run.stamp_ns = sample.stamp_ns;
        run.pending.push(sample);
        self.pending += 1;
        match self.pending >= MAX_PENDING {
            true => self.spill(),
            false => Ok(()),
        }
    }

    /// Writes all samples in memory to the file, grouped by run.
    fn spill(&mut self) -> io::Result<()> {
        let mut file = match self.file.take() {
            Some(file) => file,
            None => tempfile::tempfile()?,
        };
        let mut out = BufWriter::new(&mut file);
        for run in &mut self.runs {
            if run.pending.is_empty() {
                continue;
            }
            run.blocks.push((self.written_bytes, run.pending.len()));
            for sample in std::mem::take(&mut run.pending) {
                out.write_all(bytemuck::bytes_of(&sample))?;
                self.written_bytes += SAMPLE_BYTES as u64;
            }
        }
        out.flush()?;
        drop(out);
        self.file = Some(file);
        self.pending = 0;
        Ok(())
    }

    /// The samples of a run, which is then empty.
    fn samples(&mut self, run: usize) -> io::Result<Vec<Sample>> {
        let Run { blocks, mut pending, rows, .. } = std::mem::take(&mut self.runs[run]);
        let mut samples = Vec::with_capacity(rows);
        for (place, count) in blocks {
            let mut bytes = vec![0; count * SAMPLE_BYTES];
            if let Some(file) = &self.file {
                file.read_exact_at(&mut bytes, place)?;
            }
            let samples_of = bytes.chunks_exact(SAMPLE_BYTES);
            samples.extend(samples_of.map(bytemuck::pod_read_unaligned::<Sample>));
        }
        samples.append(&mut pending);
        Ok(samples)
    }
}

/// The rows of one run. There are at least two samples.
fn table(path: &Path, name: &str, samples: &[Sample]) -> Result<Table, TrialError> {
    let mut table =
        Table { path: path.to_owned(), robot_name: Some(name.to_owned()), ..Table::default() };
    let start_ns = start_ns(samples);
    let mut command: Option<&Sample> = None;
    let mut stamp_ns = start_ns;
    for (sample, row) in samples.iter().zip(1..) {
        let cell = Cell { path, row };
        table.push_time(cell, stamp_ns.saturating_sub(start_ns) as f64 * 1e-9)?;
        let known = |flag, value: f32, from: Option<&Sample>| match from {
            Some(from) if from.has(flag) => f64::from(value),
            _ => f64::NAN,
        };
        let own = Some(sample);
        let v_mps = command.map_or(f32::NAN, |command| command.v_mps);
        let omega_radps = command.map_or(f32::NAN, |command| command.omega_radps);
        let mut values = [f64::NAN; Column::ALL.len()];
        let columns = [
            (Column::V, known(flag::V, v_mps, command)),
            (Column::Omega, known(flag::OMEGA, omega_radps, command)),
            (Column::Voltage, known(flag::VOLTAGE, sample.voltage_v, own)),
            (Column::Current, known(flag::CURRENT, sample.current_a, own)),
            (Column::Power, known(flag::POWER, sample.power_w, own)),
            (Column::Soc, known(flag::SOC, sample.soc, own)),
        ];
        for (column, value) in columns {
            check_value(cell, column.name(), column, value)?;
            values[column as usize] = column.recorded(value);
        }
        let said = said(&values, false);
        mapped(&mut values, said);
        for (column, _) in columns {
            table.push_checked(column, values[column as usize]);
        }
        command = Some(sample);
        stamp_ns = sample.stamp_ns;
    }
    Ok(table)
}

/// Time of the first row: when its reading was measured, if that is within the step before the
/// first sample, else a median step before it.
fn start_ns(samples: &[Sample]) -> u64 {
    let mut steps: Vec<u64> = samples
        .windows(2)
        .map(|pair| {
            let [before, after] = [pair[0].stamp_ns, pair[1].stamp_ns];
            after.saturating_sub(before)
        })
        .collect();
    steps.sort_unstable();
    let median_ns = steps.get(steps.len() / 2).copied().unwrap_or(1);
    let Some(first) = samples.first() else {
        return 0;
    };
    let is_new = first.has(flag::POWER) && !first.has(flag::HELD);
    let measured_ns = first.measured_ns;
    match is_new && measured_ns > 0 && measured_ns < first.stamp_ns {
        true => measured_ns,
        false => first.stamp_ns.saturating_sub(median_ns),
    }
}
