//! Judges whether recordings are plausible before they are used.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};

use anyhow::bail;
use joulebus_config::{Assignment, Config};
use joulebus_dataset::inspect::{Implausible, Limits, Range, judge, judge_from, judge_together};
use joulebus_dataset::trial::{LeftOut, Trial};
use joulebus_eval::score::Recording;
pub(crate) use joulebus_plausibility::Origin;
use joulebus_plausibility::{Kind, Quantity, Severity};
use joulebus_program::exit::UsageError;
use joulebus_program::output::{Output, log_line};
use joulebus_settings::Platform;
use serde::Serialize;

use crate::recordings::GIVEN;

/// Findings that the user lets through.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct AcceptArguments {
    /// Findings to let through, because you know better: sign, unit, clock, hold, never-came,
    /// range, saturation, constant, sentinel, mismatch, sources
    #[arg(long, value_name = "FINDING,…", value_delimiter = ',')]
    pub(crate) accept: Vec<Kind>,
    /// The recordings were judged before.
    #[arg(skip)]
    settled: bool,
}

/// Implausible readings of one kind, in any number of recordings.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Judged {
    /// Recordings that show it.
    pub(crate) recordings: usize,
    /// True if the user lets it through.
    pub(crate) accepted: bool,
    /// The first.
    #[serde(flatten)]
    pub(crate) first: Implausible,
}

impl Judged {
    fn is_error(&self) -> bool {
        self.first.finding.is_error() && !self.accepted
    }

    fn line(&self) -> String {
        let mut line = format!("{}: {}", self.first.finding.kind, self.first.place);
        if self.recordings > 1 {
            // Writing to a String cannot fail.
            let _ = write!(line, " (and in {} other recordings)", self.recordings - 1);
        }
        line
    }
}

impl AcceptArguments {
    /// For recordings that were judged before: nothing is logged again.
    pub(crate) const fn settled() -> Self {
        Self { accept: Vec::new(), settled: true }
    }

    /// The same with what the config accepts in recordings of some platforms.
    pub(crate) fn or_configured(
        &self,
        config: &Config,
        platforms: impl IntoIterator<Item = usize>,
    ) -> anyhow::Result<Self> {
        let mut own = self.clone();
        for platform in platforms {
            let stated = config.recordings(platform).accept.unwrap_or_default();
            for kind in stated.split(',').filter(|kind| !kind.is_empty()) {
                own.accept.push(kind.parse().map_err(|error| {
                    let name = &config.settings().platforms[platform].name;
                    UsageError(format!("platform {name}: `recordings.accept`: {error}"))
                })?);
            }
        }
        Ok(own)
    }

    /// The same option as a setting of a platform's config.
    pub(crate) fn assignment(&self) -> Option<Assignment> {
        let kinds = self.kinds();
        (!kinds.is_empty()).then(|| Assignment::text("recordings.accept", &kinds, GIVEN))
    }

    fn kinds(&self) -> String {
        let kinds: Vec<&str> = self.accept.iter().map(|kind| kind.name()).collect();
        kinds.join(",")
    }

    /// The option again, for a command that uses the same recordings: empty, or with a space in
    /// front.
    pub(crate) fn option(&self) -> String {
        match self.kinds() {
            kinds if kinds.is_empty() => kinds,
            kinds => format!(" --accept {kinds}"),
        }
    }

    /// Shows what is implausible in trials, each with the remedies of where it comes from, and
    /// refuses errors.
    ///
    /// # Errors
    /// A finding that makes results wrong and is not accepted.
    pub(crate) fn judge_from<'a>(
        &self,
        trials: impl Iterator<Item = (Origin, &'a Trial)>,
    ) -> anyhow::Result<Vec<Judged>> {
        let (mut found, mut all) = (Vec::new(), Vec::new());
        for (origin, trial) in trials {
            found.push(self.look_at(origin, trial));
            all.push(trial);
        }
        self.settle(found, all)
    }

    /// Implausible findings of a trial, for [`AcceptArguments::settle`].
    pub(crate) fn look_at(&self, origin: Origin, trial: &Trial) -> Vec<Implausible> {
        let notes = trial.notes();
        self.log_lines_left_out(
            &trial.path().display(),
            &notes.left_out,
            notes.no_final_line_break,
        );
        judge_from(origin, trial, &Limits::default())
    }

    /// The same, each with the limits of its platform: what is outside is a warning.
    pub(crate) fn judge_within<'a>(
        &self,
        trials: impl Iterator<Item = (Limits, &'a Trial)>,
    ) -> anyhow::Result<Vec<Judged>> {
        let mut all = Vec::new();
        let found = trials.map(|(limits, trial)| {
            all.push(trial);
            let notes = trial.notes();
            self.log_lines_left_out(
                &trial.path().display(),
                &notes.left_out,
                notes.no_final_line_break,
            );
            let mut found = judge(trial, &limits);
            // The worker refuses such samples and counts them.
            let ranges = found.iter_mut().map(|one| &mut one.finding);
            for finding in ranges.filter(|finding| finding.kind == Kind::Range) {
                finding.severity = Severity::Warning;
            }
            found
        });
        let found = found.collect();
        self.settle(found, all)
    }

    /// The same of recordings, which were judged when they were opened.
    pub(crate) fn recordings<'a>(
        &self,
        recordings: impl IntoIterator<Item = &'a Recording>,
    ) -> anyhow::Result<Vec<Judged>> {
        let mut short = Vec::new();
        let found = recordings.into_iter().map(|recording| {
            self.log_lines_left_out(&recording.name, recording.left_out(), recording.may_be_cut());
            short.extend(recording.short());
            recording.implausible().to_vec()
        });
        let found = found.collect();
        self.settle(found, short)
    }

    fn log_lines_left_out(&self, file: &dyn fmt::Display, left_out: &LeftOut, may_be_cut: bool) {
        if may_be_cut && !self.settled {
            let what = "its last line has no newline, so that its last number may be cut";
            let remedy = "`joulebus data convert --whole-rows` leaves such a line out";
            log_line(&format!("warning: {file}: {what}; {remedy}"));
        }
        if left_out.lines > 0 && !self.settled {
            log_line(&format!("warning: {file}: {left_out}"));
        }
    }

    /// Shows what is implausible in each of some trials, and in the short ones of a folder
    /// together. Refuses errors.
    pub(crate) fn settle<'a>(
        &self,
        mut found: Vec<Vec<Implausible>>,
        trials: impl IntoIterator<Item = &'a Trial>,
    ) -> anyhow::Result<Vec<Judged>> {
        if self.settled {
            return Ok(Vec::new());
        }
        found.push(together(&found, trials));
        let judged = self.gather(found.into_iter());
        let (errors, others): (Vec<_>, Vec<_>) = judged.into_iter().partition(Judged::is_error);
        for finding in &others {
            let word = if finding.accepted { "accepted" } else { "warning" };
            log_line(&format!("{word}: {}", finding.line()));
        }
        if errors.is_empty() {
            return Ok(others);
        }
        let lines: Vec<String> = errors.iter().map(Judged::line).collect();
        bail!("implausible readings: nothing was done\n  {}", lines.join("\n  "))
    }

    /// One line of each kind and quantity, errors first.
    fn gather(&self, found: impl Iterator<Item = Vec<Implausible>>) -> Vec<Judged> {
        type Key = (Severity, Kind, Option<Quantity>);
        let mut judged: BTreeMap<Key, Judged> = BTreeMap::new();
        for first in found.flatten() {
            let finding = &first.finding;
            let accepted = self.accept.contains(&finding.kind);
            let key = (finding.severity, finding.kind, finding.quantity);
            let entry = judged.entry(key).or_insert(Judged { recordings: 0, accepted, first });
            entry.recordings += 1;
        }
        judged.into_values().collect()
    }
}

/// Findings that short trials show together, where none shows them by itself.
fn together<'a>(
    found: &[Vec<Implausible>],
    trials: impl IntoIterator<Item = &'a Trial>,
) -> Vec<Implausible> {
    let of = |one: &Implausible| (one.finding.kind, one.finding.quantity);
    let mut together = judge_together(trials);
    together.retain(|one| !found.iter().flatten().any(|other| of(other) == of(one)));
    together
}

/// The limits of a platform's readings and commands.
pub(crate) fn limits(platform: &Platform) -> Limits {
    Limits {
        v_mps: Range::within(f64::from(platform.v_max_mps)),
        omega_radps: Range::within(f64::from(platform.omega_max_radps)),
        power_w: Range {
            least: f64::from(platform.power_min_w),
            greatest: f64::from(platform.power_max_w),
        },
        ..Limits::default()
    }
}

/// A report, and what is implausible in its recordings.
#[derive(Serialize)]
struct WithJudged<'a, R> {
    #[serde(flatten)]
    report: &'a R,
    implausible: Vec<Judged>,
}

impl<R: fmt::Display> fmt::Display for WithJudged<'_, R> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.report.fmt(out)
    }
}

/// Writes a report: in JSON with what is implausible, if anything is.
pub(crate) fn report<R: Serialize + fmt::Display>(
    output: Output,
    report: &R,
    implausible: Vec<Judged>,
) -> anyhow::Result<()> {
    match implausible.is_empty() {
        true => output.report(report),
        false => output.report(&WithJudged { report, implausible }),
    }
}
