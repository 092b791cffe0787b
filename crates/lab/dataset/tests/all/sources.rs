//! Trials whose rows are in memory, as a split takes them.

use joulebus_dataset::rows::{Dataset, Row, TrialRows};
use joulebus_dataset::split::{self, Assignment, SourceInfo, Split, SplitError, digest, resume};

/// A trial's rows with the names of its units.
#[derive(Clone)]
pub(crate) struct Source {
    pub(crate) trial: String,
    pub(crate) robot: String,
    pub(crate) group: String,
    pub(crate) rows: TrialRows,
}

pub(crate) fn infos(sources: &[Source]) -> Vec<SourceInfo> {
    let info = |source: &Source| SourceInfo {
        trial: source.trial.clone(),
        robot: source.robot.clone(),
        group: source.group.clone(),
        rows: source.rows.rows.len(),
        digest: digest(&source.rows),
        period_s: source.rows.period_s,
    };
    sources.iter().map(info).collect()
}

pub(crate) fn assign(sources: &[Source], wanted: Split) -> Result<Assignment, SplitError> {
    split::assign(&infos(sources), wanted, |at, cuts| Ok(resume(&sources[at].rows, cuts)))
}

/// The rows of each part.
pub(crate) fn dataset(sources: &[Source], assignment: &Assignment) -> Dataset {
    let [training, validation, held_out] = [0, 1, 2].map(|part: usize| -> Vec<Row> {
        let sources = sources.iter().zip(&assignment.ranges);
        sources
            .flat_map(|(source, ranges)| source.rows.rows[ranges[part].clone()].to_vec())
            .collect()
    });
    Dataset { training, validation, held_out, description: String::new(), period_s: 0.0 }
}
