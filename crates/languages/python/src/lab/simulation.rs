//! `joulebus.simulate`.

use joulebus_plant::parts::Parts;
use joulebus_plant::protocol::Protocol;
use joulebus_sim::protocol::drive_with;
use joulebus_sim::scenario;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::job;
use crate::recordings::columns;

/// A trial: its name, its robot, and its columns.
type Made<'py> = (String, Option<String>, Bound<'py, PyDict>);

/// The six trials of one robot, and the trials of seven robots together. `progress` is called with
/// the numbers of trials made and of all. The seven count as one.
#[pyfunction]
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    seed: u64,
    steps: usize,
    progress: &Bound<'py, PyAny>,
) -> PyResult<(Vec<Made<'py>>, Vec<Made<'py>>)> {
    let all = Protocol::ALL.len() + 1;
    let work = move |reporter: &job::Reporter<usize>| {
        let mut alone = Vec::new();
        for (protocol, done) in Protocol::ALL.into_iter().zip(1..) {
            alone.push(drive_with(protocol, Parts::default(), seed, steps));
            if reporter.report(done).is_break() {
                return Ok((alone, Vec::new()));
            }
        }
        let together = scenario::seven_robots(seed, steps);
        let _ = reporter.report(all);
        Ok((alone, together))
    };
    let (alone, together) = job::run(py, work, |done| progress.call1((done, all)).map(|_| ()))?;
    let made = |trial: &joulebus_dataset::trial::Trial| {
        Ok((
            trial.path().display().to_string(),
            trial.robot_name().map(str::to_owned),
            columns(py, trial)?,
        ))
    };
    let made = |trials: &[_]| trials.iter().map(made).collect::<PyResult<Vec<_>>>();
    Ok((made(&alone)?, made(&together)?))
}
