//! A recording and its rows.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::Arc;

use joulebus_dataset::inspect::{Implausible, Limits, is_short, judge};
use joulebus_dataset::rows::{TrialRows, trial_rows};
use joulebus_dataset::split::{Placed, SourceInfo, SplitError, check_copies, digest, group_of};
use joulebus_dataset::trial::{Fault, LeftOut, Stored, Trial, TrialError};
use joulebus_settings::Platform;

/// A trial with its names: in memory, or in a file that is read whenever its rows are needed.
#[derive(Clone)]
pub struct Recording {
    /// Id of its robot, for the live path.
    pub id: u32,
    /// Name of the trial: its file.
    pub name: String,
    /// Name of the robot: as recorded, else the file's.
    pub robot: String,
    /// Name of the group: [`group_of`] its file.
    pub group: String,
    /// The trial's file: its name, if no other robot shares the file.
    file: String,
    /// Notes on the trial's quality, in one line.
    notes: String,
    /// Implausible findings of its readings.
    implausible: Vec<Implausible>,
    /// Itself, if it is judged with others as well.
    short: Option<Arc<Trial>>,
    /// Lines of its file that were left out.
    left_out: LeftOut,
    /// True if its file has no newline at the end.
    may_be_cut: bool,
    /// Rows of the trial.
    trial_rows: usize,
    /// Rows with a forecast and a reading that follows.
    rows: usize,
    /// Hash of these.
    digest: [u8; 32],
    period_ns: u64,
    held: Held,
}

/// Parts of a split.
const PARTS: usize = 3;

/// Location of a recording's rows.
#[derive(Clone)]
enum Held {
    Memory(Arc<Contents>),
    Stored(Stored),
}

/// The contents of a recording.
#[derive(Debug)]
pub struct Contents {
    /// The trial.
    pub trial: Trial,
    /// Rows with a forecast and a reading that follows.
    pub rows: TrialRows,
    /// For each row, the time from the previous reading to the target reading, s: the duration of
    /// the forecast.
    pub step_s: Vec<f64>,
}

impl Contents {
    /// The rows of a trial.
    pub fn new(trial: Trial) -> Self {
        let rows = trial_rows(&trial);
        let offset_ns = trial.offset_ns();
        // Sample k carries the reading of row k. Its forecast is for the reading of row k + 1.
        let step_s = rows.sample_seq.iter().map(|seq| {
            let at = *seq as usize;
            (offset_ns[at + 1] - offset_ns[at]) as f64 * 1e-9
        });
        Self { step_s: step_s.collect(), rows, trial }
    }
}

impl Recording {
    /// A trial in memory, with names derived from its file.
    pub fn new(id: u32, trial: Trial) -> Self {
        Self::with(id, Contents::new(trial))
    }

    fn with(id: u32, contents: Contents) -> Self {
        let Contents { trial, rows, .. } = &contents;
        let file = trial.path().file_name().and_then(|name| name.to_str());
        let file = file.unwrap_or_default().to_owned();
        Self {
            id,
            name: trial.path().display().to_string(),
            robot: trial.robot_name().unwrap_or(&file).to_owned(),
            group: group_of(&file),
            file: trial.path().display().to_string(),
            notes: trial.notes().to_string(),
            implausible: judge(trial, &Limits::default()),
            short: is_short(trial).then(|| Arc::new(trial.clone())),
            left_out: trial.notes().left_out.clone(),
            may_be_cut: trial.notes().no_final_line_break,
            trial_rows: trial.rows(),
            rows: rows.rows.len(),
            digest: digest(rows),
            period_ns: trial.period_ns(),
            held: Held::Memory(Arc::new(contents)),
        }
    }

    /// Implausible findings of its readings, errors first.
    pub fn implausible(&self) -> &[Implausible] {
        &self.implausible
    }

    /// Itself, if it has so few rows that it is judged with the others of its folder as well.
    pub fn short(&self) -> Option<&Trial> {
        self.short.as_deref()
    }

    /// Lines of its file that are no whole rows and were left out.
    pub fn left_out(&self) -> &LeftOut {
        &self.left_out
    }

    /// True if its file, a CSV, has no newline at the end, so that its last number may be cut.
    pub const fn may_be_cut(&self) -> bool {
        self.may_be_cut
    }

    /// The same recording, read again from its source when its rows are needed.
    pub(super) fn stored(self, place: Stored) -> Self {
        Self { held: Held::Stored(place), ..self }
    }

    /// The trial and its rows. Read from the file if they are not in memory.
    ///
    /// # Errors
    /// [`TrialError`]: the file cannot be read again, or has changed.
    pub fn contents(&self) -> Result<Arc<Contents>, TrialError> {
        let place = match &self.held {
            Held::Memory(contents) => return Ok(Arc::clone(contents)),
            Held::Stored(place) => place,
        };
        let contents = Contents::new(place.read_again()?);
        let found = contents.trial.rows();
        if found != self.trial_rows || digest(&contents.rows) != self.digest {
            let what = format!(
                "changed while it was used: {found} rows, or other ones, where {} were read before. \
                 Run the command again when it is complete",
                self.trial_rows
            );
            return Err(TrialError::new(contents.trial.path(), Fault::Changed, what));
        }
        Ok(Arc::new(contents))
    }

    /// The same in memory.
    ///
    /// # Errors
    /// As [`Recording::contents`].
    pub fn loaded(&self) -> Result<Self, TrialError> {
        Ok(Self { held: Held::Memory(self.contents()?), ..self.clone() })
    }

    /// The trial and its rows, if they are in memory.
    pub fn in_memory(&self) -> Option<&Contents> {
        match &self.held {
            Held::Memory(contents) => Some(contents),
            Held::Stored(_) => None,
        }
    }

    /// The trial's file.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Notes on the trial's quality, in one line.
    pub fn notes(&self) -> &str {
        &self.notes
    }

    /// Number of rows with a forecast and a reading that follows.
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// Number of rows of the trial.
    pub const fn trial_rows(&self) -> usize {
        self.trial_rows
    }

    /// Hash of the rows with a forecast.
    pub const fn digest(&self) -> [u8; 32] {
        self.digest
    }

    /// Median period of the trial, ns.
    pub const fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// The recording as a source of a split.
    pub fn info(&self) -> SourceInfo {
        SourceInfo {
            trial: self.name.clone(),
            robot: self.robot.clone(),
            group: self.group.clone(),
            rows: self.rows,
            digest: self.digest,
            period_s: (self.period_ns as f64 * 1e-9) as f32,
        }
    }
}

impl fmt::Debug for Recording {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut shown = out.debug_struct("Recording");
        shown.field("id", &self.id).field("name", &self.name);
        shown.field("rows", &self.rows).finish_non_exhaustive()
    }
}

impl PartialEq for Recording {
    fn eq(&self, other: &Self) -> bool {
        (&self.name, self.digest) == (&other.name, other.digest)
    }
}

/// Sources of a split into whole trials. Robots that share a file stay in one part. Of fewer than
/// three files each robot is a trial of its own.
pub(crate) fn sources(recordings: &[Recording]) -> Vec<SourceInfo> {
    let files: BTreeSet<&str> = recordings.iter().map(Recording::file).collect();
    let apart = files.len() < PARTS;
    let source = |recording: &Recording| {
        let info = recording.info();
        let file = recording.file().to_owned();
        let trial = if apart { info.trial } else { file };
        SourceInfo { trial, ..info }
    };
    recordings.iter().map(source).collect()
}

/// A platform that accepts a trial as it was recorded: its median period, and limits that refuse
/// only values that are not finite. For recordings of robots that no config describes.
pub fn recorded_platform(robot: u32, trial: &Trial) -> Platform {
    const SECOND_NS: u64 = 1_000_000_000;
    let period_ns = trial.period_ns().clamp(SECOND_NS / 10_000, 60 * SECOND_NS);
    Platform {
        name: "recorded".to_owned(),
        robots: vec![robot..=robot],
        period_ns,
        stale_after_ns: (SECOND_NS / 2).clamp(5 * period_ns, 500 * period_ns),
        hold_max_ns: u64::MAX,
        stuck_after_ns: u64::MAX,
        power_min_w: -1e6,
        power_max_w: 1e6,
        v_max_mps: 1e3,
        omega_max_radps: 1e3,
        power_resolution_w: 1e-3,
        battery: None,
        alarms: None,
        online: true,
        energy_online: true,
    }
}

/// Refuses recordings that are both evaluated and fitted on, under the same name or another.
///
/// # Errors
/// [`SplitError::Copy`] with the first duplicate.
pub fn check_apart(
    evaluated: &[Recording],
    learned: (&[Recording], &'static str),
) -> Result<(), SplitError> {
    let placed = [(evaluated, "evaluated"), learned];
    let placed = placed.into_iter().flat_map(|(recordings, part)| {
        recordings.iter().map(move |recording| Placed {
            trial: &recording.name,
            rows: recording.rows,
            digest: recording.digest,
            part,
        })
    });
    check_copies(placed)
}
