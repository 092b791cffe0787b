//! The queue of questions about plans: a few wait, and one is computed on a thread of its own.
//!
//! A client that hangs up leaves the queue at once. A computation keeps its slot until it ends,
//! which is after the current robot. Clients that ask and hang up therefore queue nothing.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use joulebus_config::Config;
use joulebus_models::load_models;
use joulebus_plan::answering::Work;
use joulebus_plan::report::{AnswerReport, AnswersReport};
use joulebus_plan::{Fleet, Question, Reply, RobotRows, Simplified};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use super::error::ApiError;
use super::what_if::MAX_PATH_STEPS;

/// Questions that may be computed or wait.
const MAX_QUESTIONS: usize = 4;
/// Timeout of a computation. It ends after the robot that exceeds the time.
const COMPUTE_TIMEOUT: Duration = Duration::from_secs(10);

/// The queue of questions, and what they are computed with.
#[derive(Debug)]
pub(super) struct Questions {
    places: Arc<Semaphore>,
    permit: Arc<Semaphore>,
    /// Settings and models, loaded at the first question.
    plans: Arc<OnceLock<Fleet>>,
}

/// The right to compute. One question has it at a time, whether or not its client still waits.
#[derive(Debug)]
pub(super) struct Permit {
    _place: OwnedSemaphorePermit,
    _permit: OwnedSemaphorePermit,
}

impl Questions {
    pub(super) fn new() -> Self {
        Self {
            places: Arc::new(Semaphore::new(MAX_QUESTIONS)),
            permit: Arc::new(Semaphore::new(1)),
            plans: Arc::default(),
        }
    }

    /// Waits for the right to compute, in the order of the questions. Loads the models at first
    /// use.
    ///
    /// # Errors
    /// The queue is full, or the models cannot be loaded.
    pub(super) async fn permit(&self, config: &Config) -> Result<Permit, ApiError> {
        let place = Arc::clone(&self.places).try_acquire_owned();
        let place = place.map_err(|_| {
            ApiError::busy(format!("{MAX_QUESTIONS} questions are being answered: ask again"))
        })?;
        let permit = Arc::clone(&self.permit).acquire_owned().await;
        let permit = Permit {
            _place: place,
            _permit: permit.map_err(|_| ApiError::busy("the server is ending"))?,
        };
        if self.plans.get().is_some() {
            return Ok(permit);
        }
        let (config, plans) = (config.clone(), Arc::clone(&self.plans));
        blocking(permit, move |_| {
            let failed =
                |error| ApiError::busy(format!("the config's models cannot be loaded: {error}"));
            let models = load_models(&config).map_err(failed)?;
            // Only this task has the right to compute, so no other sets it.
            let _ = plans.set(Fleet::new(config.settings(), &models));
            Ok(())
        })
        .await
        .map(|(permit, ())| permit)
    }

    /// Answers a question.
    pub(super) async fn answer(
        &self,
        permit: Permit,
        question: Question,
        rows: Vec<RobotRows>,
    ) -> Result<Reply, ApiError> {
        let plans = Arc::clone(&self.plans);
        let computed = blocking(permit, move |is_gone| {
            let plans = plans.get().ok_or_else(|| ApiError::busy("the models are not loaded"))?;
            compute(plans, question, &rows, is_gone)
        });
        computed.await.map(|(_permit, reply)| reply)
    }
}

/// Runs `work` on a blocking thread, which keeps the right to compute until it has ended. `work`
/// can ask whether its client is gone.
async fn blocking<T: Send + 'static>(
    permit: Permit,
    work: impl FnOnce(&dyn Fn() -> bool) -> Result<T, ApiError> + Send + 'static,
) -> Result<(Permit, T), ApiError> {
    let (reply, answer) = oneshot::channel();
    drop(tokio::task::spawn_blocking(move || {
        let done = work(&|| reply.is_closed());
        // If the client is gone, this drops the right to compute.
        let _ = reply.send(done.map(|value| (permit, value)));
    }));
    let defect = |_| ApiError::new(StatusCode::INTERNAL_SERVER_ERROR, "a defect");
    answer.await.map_err(defect)?
}

fn compute(
    plans: &Fleet,
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
    rows: Option<&RobotRows>,
    reply: &Reply,
) -> AnswersReport {
    let answers = reply.ranked().into_iter().map(|row| {
        let mut answer = AnswerReport::new(config.settings(), row);
        answer.set_along(config.settings(), &reply.along);
        answer
    });
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
