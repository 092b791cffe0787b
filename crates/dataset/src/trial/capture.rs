//! Rows of the samples in a capture: the inverse of [`Trial::to_samples`](super::Trial::to_samples).
//!
//! A sample has the reading of one row and the command and time of the next, so row *k* gets its
//! time and command from sample *k* − 1 and its reading from sample *k*. The command of the first
//! row is not in the capture.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::Path;

use joulebus_capture::{Message, ReadError, Reader};
use joulebus_wire::{Sample, sample_flag};

use super::limits::MCAP_MAGIC;
use super::table::{Cell, Column, Table};
use super::{MAX_ROWS, TrialError};

/// Bytes within which the first record of a capture names its writer.
const HEAD_BYTES: u64 = 64;

/// Whether a file is named `.mcap` and written by joulebus, by its first record.
#[must_use]
pub fn is_capture(path: &Path) -> bool {
    if path.extension().is_none_or(|extension| extension != "mcap") {
        return false;
    }
    let mut head = Vec::new();
    let read =
        joulebus_files::open(path).and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head));
    let name = b"joulebus";
    read.is_ok() && head.starts_with(MCAP_MAGIC) && head.windows(name.len()).any(|at| at == name)
}

/// One run of a robot's source: samples whose time advances, without a discontinuity.
#[derive(Default)]
struct Run {
    samples: Vec<Sample>,
}

/// Runs of each robot, by fleet and id.
type Robots = BTreeMap<(String, u32), Vec<Run>>;

/// A table for each robot and run, in SI units converted to those of files.
pub(super) fn read(path: &Path) -> Result<Vec<Table>, TrialError> {
    let refused = |detail: String| TrialError::Capture {
        path: path.to_owned(),
        detail,
    };
    let failed = |error: ReadError| refused(error.to_string());
    let mut reader = Reader::open(path).map_err(failed)?;
    let mut robots = Robots::new();
    let mut frames = 0_u64;
    // The run of a source that each robot's last sample came from.
    let mut sources: BTreeMap<(String, u32), (u64, u64)> = BTreeMap::new();
    while let Some(entry) = reader.next_entry().map_err(failed)? {
        let Message::Samples(header, samples) = entry.message else {
            continue;
        };
        frames += 1;
        for sample in samples {
            let robot = (entry.fleet.to_string(), sample.robot);
            let source = (header.source_id, header.source_epoch);
            let is_same = sources.insert(robot.clone(), source) == Some(source);
            let runs = robots.entry(robot).or_default();
            let goes_on = is_same && !sample.has(sample_flag::DISCONTINUITY);
            let last = runs.last_mut().filter(|_| goes_on);
            match last {
                Some(run) => {
                    // Ingest refuses a time that does not advance.
                    let before_ns = run.samples.last().map_or(0, |before| before.stamp_ns);
                    if sample.stamp_ns > before_ns {
                        run.samples.push(sample);
                    }
                    if run.samples.len() > MAX_ROWS {
                        let path = path.to_owned();
                        return Err(TrialError::TooManyRows { path });
                    }
                }
                None => runs.push(Run {
                    samples: vec![sample],
                }),
            }
        }
    }
    if frames == 0 {
        let detail = "no samples of joulebus in this MCAP file; convert recordings of other programs: \
                      joulebus import";
        return Err(refused(detail.to_owned()));
    }
    let several_fleets = {
        let mut fleets: Vec<&str> = robots.keys().map(|robot| robot.0.as_str()).collect();
        fleets.dedup();
        fleets.len() > 1
    };
    let mut tables = Vec::new();
    for ((fleet, robot), runs) in &robots {
        let name = match several_fleets {
            true => format!("{fleet}/{robot}"),
            false => robot.to_string(),
        };
        for run in runs.iter().filter(|run| run.samples.len() > 1) {
            tables.push(table(path, &name, &run.samples)?);
        }
    }
    match tables.is_empty() {
        true => Err(refused("no robot has two samples in a row".to_owned())),
        false => Ok(tables),
    }
}

/// The rows of one run; there are at least two samples.
fn table(path: &Path, name: &str, samples: &[Sample]) -> Result<Table, TrialError> {
    let mut table = Table {
        path: path.to_owned(),
        robot_name: Some(name.to_owned()),
        ..Table::default()
    };
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
        for (column, value) in [
            (Column::V, known(sample_flag::V, v_mps, command)),
            (
                Column::Omega,
                known(sample_flag::OMEGA, omega_radps, command),
            ),
            (
                Column::Voltage,
                known(sample_flag::VOLTAGE, sample.voltage_v, own),
            ),
            (
                Column::Current,
                known(sample_flag::CURRENT, sample.current_a, own),
            ),
            (
                Column::Power,
                known(sample_flag::POWER, sample.power_w, own),
            ),
            (Column::Soc, known(sample_flag::SOC, sample.soc, own)),
        ] {
            table.push(cell, column, column.recorded(value))?;
        }
        command = Some(sample);
        stamp_ns = sample.stamp_ns;
    }
    Ok(table)
}

/// Time of the first row: that of its reading if it was measured within the step before the first
/// sample, else a median step before.
fn start_ns(samples: &[Sample]) -> u64 {
    let mut steps: Vec<u64> = samples
        .windows(2)
        .map(|pair| pair[1].stamp_ns.saturating_sub(pair[0].stamp_ns))
        .collect();
    steps.sort_unstable();
    let median_ns = steps.get(steps.len() / 2).copied().unwrap_or(1);
    let Some(first) = samples.first() else {
        return 0;
    };
    let is_new = first.has(sample_flag::POWER) && !first.has(sample_flag::HELD);
    let measured_ns = first.measured_ns;
    match is_new && measured_ns > 0 && measured_ns < first.stamp_ns {
        true => measured_ns,
        false => first.stamp_ns.saturating_sub(median_ns),
    }
}
