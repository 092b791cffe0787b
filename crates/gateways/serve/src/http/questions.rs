//! Questions about plans: one is computed at a time, on a thread of its own.
//!
//! A client that hangs up leaves the queue at once. A computation keeps its turn until it ends,
//! which is after the current robot. Clients that ask and hang up therefore queue nothing.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use joulebus_config::Config;
use joulebus_models::load_models;
use joulebus_plan::answering::Work;
use joulebus_plan::report::{AnswerReport, AnswersReport};
use joulebus_plan::{PlanFleet, Question, Reply, RobotRows, Simplified};
use tokio::sync::oneshot;

use super::error::ApiError;
use super::shares::Turn;
use super::what_if::MAX_PATH_STEPS;

/// Timeout of a computation. It ends after the robot that exceeds the time.
const COMPUTE_TIMEOUT: Duration = Duration::from_secs(10);

/// What questions are computed with.
#[derive(Debug, Default)]
pub(super) struct Questions {
    /// Settings and models, loaded at the first question.
    plans: Arc<OnceLock<PlanFleet>>,
}

impl Questions {
    /// Loads the models at first use.
    ///
    /// # Errors
    /// The models cannot be loaded.
    pub(super) async fn load(&self, turn: Turn, config: &Config) -> Result<Turn, ApiError> {
        if self.plans.get().is_some() {
            return Ok(turn);
        }
        let (config, plans) = (config.clone(), Arc::clone(&self.plans));
        blocking(turn, move |_| {
            let failed =
                |error| ApiError::busy(format!("the config's models cannot be loaded: {error}"));
            let models = load_models(&config).map_err(failed)?;
            // Only this task has its turn, so no other sets it.
            let _ = plans.set(PlanFleet::new(config.settings(), &models));
            Ok(())
        })
        .await
        .map(|(turn, ())| turn)
    }

    /// Answers a question.
    pub(super) async fn answer(
        &self,
        turn: Turn,
        question: Question,
        rows: Vec<RobotRows>,
    ) -> Result<Reply, ApiError> {
        let plans = Arc::clone(&self.plans);
        let computed = blocking(turn, move |is_gone| {
            let plans = plans.get().ok_or_else(|| ApiError::busy("the models are not loaded"))?;
            compute(plans, question, &rows, is_gone)
        });
        computed.await.map(|(_turn, reply)| reply)
    }
}

/// Runs `work` on a blocking thread, which keeps the turn until it has ended. `work` can ask whether
/// its client is gone.
async fn blocking<T: Send + 'static>(
    turn: Turn,
    work: impl FnOnce(&dyn Fn() -> bool) -> Result<T, ApiError> + Send + 'static,
) -> Result<(Turn, T), ApiError> {
    let (reply, answer) = oneshot::channel();
    drop(tokio::task::spawn_blocking(move || {
        let done = work(&|| reply.is_closed());
        // If the client is gone, this ends its turn.
        let _ = reply.send(done.map(|value| (turn, value)));
    }));
    let defect = |_| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, "a defect");
    answer.await.map_err(defect)?
}

fn compute(
    plans: &PlanFleet,
    question: Question,
    rows: &[RobotRows],
    is_gone: &dyn Fn() -> bool,
) -> Result<Reply, ApiError> {
    if let Some(rows) = rows.first() {
        let checked = plans.check(&rows.header);
        checked.map_err(|error| ApiError::busy(error.to_string()))?;
    }
    let wrong = |error| ApiError::new(StatusCode::BAD_REQUEST, format!("{error}"));
    let find = |robot| rows.iter().find(|rows| rows.state.robot == robot).copied();
    let mut work = Work::begin(question, find, MAX_PATH_STEPS).map_err(wrong)?;
    let begun = Instant::now();
    let step = || work.step(plans).map_err(wrong);
    in_time(step, is_gone, || begun.elapsed())?;
    Ok(work.finish())
}

/// Executes steps until the last one.
///
/// # Errors
/// A step failed, the client is gone, or the time is over.
fn in_time(
    mut step: impl FnMut() -> Result<bool, ApiError>,
    is_gone: &dyn Fn() -> bool,
    elapsed: impl Fn() -> Duration,
) -> Result<(), ApiError> {
    let mut robots = 0;
    while !step()? {
        robots += 1;
        if is_gone() {
            return Err(ApiError::busy("nobody waits for the answer"));
        }
        if elapsed() >= COMPUTE_TIMEOUT {
            let limit_s = COMPUTE_TIMEOUT.as_secs();
            let text = format!(
                "{robots} robots took more than {limit_s} s, which is the time of one question: ask about fewer, or a \
                 shorter path"
            );
            return Err(ApiError::busy(text));
        }
    }
    Ok(())
}

/// An answer as clients get it.
pub(super) fn report(
    config: &Config,
    (coverage, path): (f32, Option<Simplified>),
    (of, charge_to): (&[RobotRows], Option<f64>),
    reply: &Reply,
) -> AnswersReport {
    let answers = reply.ranked().into_iter().map(|row| {
        let mut answer = AnswerReport::new(config.settings(), row);
        let budget = of.iter().filter_map(|rows| rows.budget.as_ref());
        let mut budget = budget.filter(|(_, budget)| budget.robot == row.robot);
        let budget = budget.next().map(|(_, budget)| budget);
        answer.set_along(config.settings(), &reply.along, (budget, charge_to));
        answer
    });
    let rows = of.first();
    AnswersReport {
        fleet: config.fleet().to_owned(),
        tick: rows.map_or(0, |rows| rows.header.tick),
        age_s: rows
            .map_or(0.0, |rows| rows.now_ns.saturating_sub(rows.header.sent_ns) as f64 * 1e-9),
        coverage,
        path,
        answers: answers.collect(),
        missing: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    /// Steps taken of a question about 64 robots, and whether it was answered.
    fn steps(gone_after: usize, step_s: u64) -> (usize, bool) {
        let taken = Cell::new(0_usize);
        let step = || {
            taken.set(taken.get() + 1);
            Ok(taken.get() >= 64)
        };
        let elapsed = || Duration::from_secs(step_s * taken.get() as u64);
        let done = in_time(step, &|| taken.get() >= gone_after, elapsed).is_ok();
        (taken.get(), done)
    }

    #[test]
    fn a_question_ends_when_its_client_or_its_time_does() {
        assert_eq!(steps(usize::MAX, 0), (64, true));
        assert_eq!(steps(3, 0), (3, false));
        assert_eq!(steps(usize::MAX, 4), (3, false));
        // A computed answer is sent.
        assert_eq!(steps(64, 0), (64, true));
    }
}
