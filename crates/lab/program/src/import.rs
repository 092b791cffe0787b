//! `joulebus import`: recordings of other programs, as datasets or captures.

mod bag;
mod capture;
mod mapping;

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow, bail};
use joulebus_capture_format::import::{Imported, Mapping};
use joulebus_dataset::trial::{BagTrial, BagTrialError, Column, ColumnMap, Trial, is_capture};
use joulebus_files::{WholeFolder, disk, ends_in, foreign, without_ending};
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::output::Output;
use serde::Serialize;

use crate::judgement::{self, AcceptArguments, Judged};
use crate::recordings::{ColumnArguments, LineArguments};
use bag::BagRead;

/// Import recordings (bags of rosbag2, our captures, .npy, .csv, .csv.gz) as datasets or as a
/// capture
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus import bag_0.mcap -o trials/ --current discharge-positive\n  \
    joulebus import bag/ -o trials/ --mapping mapping.toml\n  \
    joulebus import trials/*.csv.gz -o trials.mcap\n  \
    joulebus import captures/fleet.mcap -o trials/\n\n\
    A bag of rosbag2 is an .mcap file, or a folder with the files of one bag. In Python, \
    joulebus.read_bag also reads .db3 files and bags of ROS 1. From a bag, the verb reads \
    sensor_msgs/BatteryState, geometry_msgs/Twist, TwistStamped and nav_msgs/Odometry, encoded as cdr. Without a mapping every \
    battery topic is a robot. From a capture of joulebus, it reads the samples of each robot. Data \
    that the file does not have is missing in the result, never 0. Unusable data is named and \
    counted.\n\
    The result is a capture if its name ends in .mcap, and a dataset if it ends in .csv or \
    .csv.gz. Otherwise it is a directory of datasets, which `joulebus publish trial` plays.\n\n\
    A mapping file (all keys except name and battery are optional):\n\n  \
    time = \"auto\"              # header, log, publish\n  \
    burst_s = 0.005            # among readings closer than this, the last counts\n  \
    odometry_max_age_s = 1.0\n  \
    command_holds_s = 0.5      # how long a command applies if no other comes\n  \
    command_expired = \"unknown\"   # or \"stops\": 0 afterwards\n\n  \
    [[robot]]\n  \
    name = \"r1\"                # in datasets\n  \
    id = 7                     # in captures\n  \
    battery = \"/r1/battery\"\n  \
    command = \"/r1/cmd_vel\"    # Twist or TwistStamped\n  \
    odometry = \"/r1/odom\"\n  \
    current = \"discharge-negative\"   # as ROS has it, or discharge-positive\n  \
    voltage_unit_v = 1.0       # 0.001 for millivolts\n  \
    current_unit_a = 1.0\n\n\
    Exit code 1: nothing could be used. Exit code 3: some messages, files of a bag or lines could \
    not.")]
pub(crate) struct Args {
    /// Recordings, of which several go into one capture, or into a directory
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// A capture (.mcap), a dataset (.csv, .csv.gz) or a directory
    #[arg(short, long, value_name = "PATH")]
    out: PathBuf,
    /// A TOML file with the mapping of each robot [default: each battery topic is a robot]
    #[arg(long, value_name = "FILE")]
    mapping: Option<PathBuf>,
    #[command(flatten)]
    columns: ColumnArguments,
    #[command(flatten)]
    lines: LineArguments,
    #[command(flatten)]
    accept: AcceptArguments,
    /// Fleet whose config goes into a capture
    #[command(flatten)]
    config: ConfigFile,
}

struct Recording {
    name: String,
    id: Option<u32>,
    /// True if it is of a bag, whose signs and units are those of ROS.
    is_of_bag: bool,
    /// Time of its first row, Unix ns, if the recording has it.
    start_unix_ns: Option<u64>,
    trial: Trial,
}

impl From<BagTrial> for Recording {
    fn from(found: BagTrial) -> Self {
        let BagTrial { name, id, start_unix_ns, trial, .. } = found;
        Self { name, id, is_of_bag: true, start_unix_ns: Some(start_unix_ns), trial }
    }
}

#[derive(Debug, Serialize)]
struct ImportReport {
    sources: Vec<ImportedFile>,
    /// Implausible findings that are no reason to stop.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    implausible: Vec<Judged>,
    /// Files written.
    written: Vec<Written>,
}

#[derive(Debug, Serialize)]
struct ImportedFile {
    file: String,
    #[serde(flatten)]
    imported: Option<Imported>,
    /// For a file that was already a trial: notes on it.
    trial: Option<String>,
    /// Robots left out, with reasons.
    left_out: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Written {
    file: String,
    robots: Vec<String>,
    /// Rows of a dataset, samples of a capture.
    rows: u64,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    check_out(&args.out)?;
    let mapping = mapping::mapping(args.mapping.as_deref(), args.columns.current)?;
    let mut recordings = Vec::new();
    let mut sources = Vec::new();
    for file in &args.files {
        sources.push(if bag::is_bag(file) {
            read_bag(file, &mapping, &mut recordings)?
        } else {
            read_trials(
                file,
                &args.columns.map().whole_rows(args.lines.whole_rows),
                &mut recordings,
            )?
        });
    }
    let mut report = ImportReport { sources, implausible: Vec::new(), written: Vec::new() };
    if recordings.is_empty() {
        bail!("nothing could be used\n{}", report.to_string().trim_end());
    }
    let source = |recording: &Recording| match recording.is_of_bag {
        true => judgement::Origin::Bag,
        false => judgement::Origin::Recording,
    };
    let judged = recordings.iter().map(|one| (source(one), &one.trial));
    report.implausible = args.accept.judge_from(judged)?;
    report.written = write(args, recordings)?;
    output.report(&report)?;
    let is_whole = report.sources.iter().all(|source| {
        source.left_out.is_empty() && source.imported.as_ref().is_none_or(Imported::is_whole)
    });
    Ok(Outcome::unless_lost(!is_whole))
}

/// Refuses the name of a file that is not written, of which a directory would be made.
fn check_out(out: &Path) -> Result<(), UsageError> {
    let is_written = ["mcap", "csv", "csv.gz"].iter().any(|ending| ends_in(out, ending));
    let is_directory = out.is_dir() || out.to_string_lossy().ends_with('/');
    let kind = foreign::of_name(out).map(|kind| kind.what);
    let array = ends_in(out, "npy").then_some("a NumPy array");
    match kind.or(array).filter(|_| !is_written && !is_directory) {
        None => Ok(()),
        Some(what) => Err(UsageError(format!(
            "{} names {what}, which is not written. Name a dataset (.csv, .csv.gz), a capture \
             (.mcap), or a directory, with a / at its end",
            out.display()
        ))),
    }
}

/// A name without directory and extensions.
fn stem(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let endings = ["mcap", "npy", "csv.gz", "csv"];
    let stem = endings.iter().find_map(|ending| without_ending(&name, ending));
    stem.unwrap_or(&name).to_owned()
}

fn read_bag(
    path: &Path,
    mapping: &Mapping,
    recordings: &mut Vec<Recording>,
) -> anyhow::Result<ImportedFile> {
    let named = || path.display().to_string();
    let BagRead { mut imported, mut left_out } =
        bag::read(path, &stem(path), mapping).with_context(named)?;
    for robot in &mut imported.robots {
        let mut notes = Vec::new();
        for found in BagTrial::runs(path, robot) {
            match found {
                Ok(found) => {
                    notes.extend(found.by_sign());
                    recordings.push(found.into());
                }
                Err(error) => left_out.push(format!("{}: {error}", robot.name)),
            }
        }
        robot.notes.extend(notes);
    }
    Ok(ImportedFile { file: named(), imported: Some(imported), trial: None, left_out })
}

/// The trials of a dataset with one robot, or of our capture with any number.
fn read_trials(
    path: &Path,
    map: &ColumnMap,
    recordings: &mut Vec<Recording>,
) -> anyhow::Result<ImportedFile> {
    let from_capture = is_capture(path);
    let trials = match from_capture {
        true => Trial::read_mapped(path, map)?,
        false => one_robot(path, map)?,
    };
    let notes: Vec<String> = trials.iter().map(|trial| trial.notes().to_string()).collect();
    let mut source = ImportedFile {
        file: path.display().to_string(),
        imported: None,
        trial: Some(notes.join("; ")),
        left_out: trials
            .iter()
            .map(|trial| &trial.notes().left_out)
            .filter(|left_out| !left_out.is_none())
            .map(ToString::to_string)
            .collect(),
    };
    let several = trials.len() > 1;
    let mut runs: BTreeMap<String, u32> = BTreeMap::new();
    for trial in trials {
        let robot = trial.robot_name().unwrap_or_default().to_owned();
        let run = runs.entry(robot.clone()).or_default();
        *run += 1;
        let name = match (several, *run) {
            (false, _) => stem(path),
            (true, 1) if !from_capture => stem(path),
            (true, run) if !from_capture => format!("{}_run_{run}", stem(path)),
            (true, 1) => format!("{}_robot_{robot}", stem(path)),
            (true, run) => format!("{}_robot_{robot}_run_{run}", stem(path)),
        };
        if trial.column(Column::Power).is_none() {
            source.left_out.push(format!("{name}: {}", BagTrialError::WithoutPower));
            continue;
        }
        recordings.push(Recording {
            name,
            id: robot.parse().ok().filter(|_| from_capture && *run == 1),
            is_of_bag: false,
            start_unix_ns: None,
            trial,
        });
    }
    Ok(source)
}

/// The trials of a dataset with one robot: several if recordings were appended to each other.
fn one_robot(path: &Path, map: &ColumnMap) -> anyhow::Result<Vec<Trial>> {
    let trials = Trial::read_mapped(path, map)?;
    let is_one = trials.iter().all(|trial| trial.robot_name() == trials[0].robot_name());
    match is_one {
        true => Ok(trials),
        // Refused with the row of the second robot.
        false => Ok(vec![crate::trials::read_one(path, map)?]),
    }
}

fn write(args: &Args, recordings: Vec<Recording>) -> anyhow::Result<Vec<Written>> {
    if ends_in(&args.out, "mcap") {
        let config = args.config.load()?;
        let written = capture::write(&args.out, &config, recordings)?;
        return Ok(vec![written]);
    }
    let is_dataset = ends_in(&args.out, "csv") || ends_in(&args.out, "csv.gz");
    if is_dataset && recordings.len() > 1 {
        let what = format!("{} recordings cannot be written to one dataset", recordings.len());
        return Err(UsageError(format!("{what}. Name a directory or a capture (.mcap)")).into());
    }
    let failed = || format!("cannot write {}", args.out.display());
    let places = match is_dataset {
        true => {
            recordings[0].trial.write_csv(&args.out).with_context(failed)?;
            vec![args.out.clone()]
        }
        false => {
            let places = places(&args.out, &recordings)?;
            let mut whole = WholeFolder::begin(&args.out).with_context(failed)?;
            for (recording, place) in recordings.iter().zip(&places) {
                let path = whole.path(place.file_name().unwrap_or_default());
                recording.trial.write_csv(&path.with_context(failed)?).with_context(failed)?;
            }
            whole.keep_new().with_context(failed)?;
            places
        }
    };
    let mut written = Vec::new();
    for (recording, path) in recordings.iter().zip(places) {
        // Read back to verify the output.
        let again = Trial::read(&path)?;
        written.push(Written {
            file: path.display().to_string(),
            robots: vec![recording.name.clone()],
            rows: again.rows() as u64,
        });
    }
    Ok(written)
}

/// The target paths of the datasets in a directory. If one of them is not possible, nothing is
/// written.
fn places(directory: &Path, recordings: &[Recording]) -> anyhow::Result<Vec<PathBuf>> {
    let mut places: Vec<PathBuf> = Vec::with_capacity(recordings.len());
    for recording in recordings {
        // A robot's name may have any characters. A file's name may not.
        let allowed = |letter: char| letter.is_alphanumeric() || "-_.".contains(letter);
        let letters = recording.name.chars();
        let file: String =
            letters.map(|letter| if allowed(letter) { letter } else { '_' }).collect();
        let place = directory.join(format!("{file}.csv.gz"));
        let at = place.display();
        if places.contains(&place) {
            let what = format!("two recordings would be written to {at}");
            let remedy = "import each into a directory of its own, or all into one capture (.mcap)";
            return Err(UsageError(format!("{what}: {remedy}")).into());
        }
        if disk::exists(&place) {
            let what = format!("{at} exists and is not overwritten. Name another directory");
            return Err(anyhow!(what));
        }
        places.push(place);
    }
    Ok(places)
}

impl fmt::Display for ImportReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for source in &self.sources {
            writeln!(out, "{}", source.file)?;
            if let Some(imported) = &source.imported {
                write!(out, "{imported}")?;
            }
            if let Some(trial) = &source.trial {
                writeln!(out, "trial      {trial}")?;
            }
            for why in &source.left_out {
                writeln!(out, "left out   {why}")?;
            }
        }
        for written in &self.written {
            let (file, robots) = (&written.file, written.robots.join(", "));
            writeln!(out, "written    {file}: {} rows of {robots}", written.rows)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::check_out;

    #[test]
    fn no_directory_has_the_name_of_a_file_of_another_program() {
        for name in ["y.parquet", "a/y.MAT", "y.npy", "y.json"] {
            let refused = check_out(Path::new(name)).expect_err(name).to_string();
            assert!(
                refused.contains("which is not written") && refused.contains(name),
                "{refused}"
            );
        }
        for name in ["y.csv", "y.csv.gz", "y.mcap", "y", "y.parquet/", "run.1", "."] {
            assert!(check_out(Path::new(name)).is_ok(), "{name}");
        }
    }
}
