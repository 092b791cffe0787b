//! Questions about plans: a few wait, one is computed, on a thread of its own.
//!
//! A client that hangs up leaves the queue at once. What is computed for it keeps its place until it ends, which is
//! after the robot being computed: so that clients that ask and hang up queue nothing.

use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use axum::http::StatusCode;
use joulebus_config::Config;
use joulebus_models::load_models;
use joulebus_plan::answering::Work;
use joulebus_plan::report::{AnswerReport, AnswersReport};
use joulebus_plan::{Fleet, Question, Reply, RobotRows};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use super::error::ApiError;
use super::what_if::MOST_STEPS;

/// Questions that may be computed or wait.
const MOST_QUESTIONS: usize = 4;
/// Time to compute one; it ends after the robot during which the time is over.
const COMPUTE_LIMIT: Duration = Duration::from_secs(10);

/// The queue of questions, and what they are computed with.
#[derive(Debug)]
pub(super) struct Questions {
    places: Arc<Semaphore>,
    turn: Arc<Semaphore>,
    /// Settings and models, loaded at the first question.
    plans: Arc<OnceLock<Fleet>>,
}

/// A question's turn to be computed: there is one, whoever still waits for the answer.
#[derive(Debug)]
pub(super) struct Turn {
    _place: OwnedSemaphorePermit,
    _turn: OwnedSemaphorePermit,
}

impl Questions {
    pub(super) fn new() -> Self {
        Self {
            places: Arc::new(Semaphore::new(MOST_QUESTIONS)),
            turn: Arc::new(Semaphore::new(1)),
            plans: Arc::default(),
        }
    }

    /// Waits for a turn, in the order of asking, and loads the models if nobody has.
    ///
    /// # Errors
    /// As many questions as may wait do; the models cannot be loaded.
    pub(super) async fn turn(&self, config: &Config) -> Result<Turn, ApiError> {
        let place = Arc::clone(&self.places).try_acquire_owned();
        let place = place.map_err(|_| {
            ApiError::busy(format!(
                "{MOST_QUESTIONS} questions are being answered: ask again"
            ))
        })?;
        let turn = Arc::clone(&self.turn).acquire_owned().await;
        let turn = Turn {
            _place: place,
            _turn: turn.map_err(|_| ApiError::busy("the server is ending"))?,
        };
        if self.plans.get().is_some() {
            return Ok(turn);
        }
        let (config, plans) = (config.clone(), Arc::clone(&self.plans));
        blocking(turn, move |_| {
            let failed =
                |error| ApiError::busy(format!("the config's models cannot be loaded: {error}"));
            let models = load_models(&config).map_err(failed)?;
            // Nobody else has the turn.
            let _ = plans.set(Fleet::new(config.settings(), &models));
            Ok(())
        })
        .await
        .map(|(turn, ())| turn)
    }

    /// The answer.
    ///
    /// # Errors
    /// What is wrong with the question; it takes too long.
    pub(super) async fn answer(
        &self,
        turn: Turn,
        question: Question,
        rows: Vec<RobotRows>,
    ) -> Result<Reply, ApiError> {
        let plans = Arc::clone(&self.plans);
        let computed = blocking(turn, move |is_gone| {
            let plans = plans
                .get()
                .ok_or_else(|| ApiError::busy("the models are not loaded"))?;
            compute(plans, question, &rows, is_gone)
        });
        computed.await.map(|(_turn, reply)| reply)
    }
}

/// Does `work` on the blocking thread, which keeps the turn until it has ended. `work` is given whether its client is
/// gone.
async fn blocking<T: Send + 'static>(
    turn: Turn,
    work: impl FnOnce(&dyn Fn() -> bool) -> Result<T, ApiError> + Send + 'static,
) -> Result<(Turn, T), ApiError> {
    let (reply, answer) = oneshot::channel();
    drop(tokio::task::spawn_blocking(move || {
        let done = work(&|| reply.is_closed());
        // Dropped with its turn if the client is gone.
        let _ = reply.send(done.map(|value| (turn, value)));
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
    let mut work = Work::begin(question, find, MOST_STEPS).map_err(wrong)?;
    let begun = Instant::now();
    let step = || work.step(plans).map_err(wrong);
    in_time(step, is_gone, || begun.elapsed())?;
    Ok(work.finish())
}

/// Takes steps until one says that it is the last.
///
/// # Errors
/// That of a step; the client is gone; the time is over.
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
        if elapsed() >= COMPUTE_LIMIT {
            let limit_s = COMPUTE_LIMIT.as_secs();
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
    coverage: f32,
    rows: Option<&RobotRows>,
    reply: &Reply,
) -> AnswersReport {
    let answers = reply.rows.iter();
    AnswersReport {
        fleet: config.fleet().to_owned(),
        tick: rows.map_or(0, |rows| rows.header.tick),
        age_s: rows.map_or(0.0, |rows| {
            rows.now_ns.saturating_sub(rows.header.sent_ns) as f64 * 1e-9
        }),
        coverage,
        answers: answers
            .map(|row| AnswerReport::new(config.settings(), row))
            .collect(),
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
        // What is computed is told.
        assert_eq!(steps(64, 0), (64, true));
    }
}
