//! Acknowledgements of alarms: the worker is asked, as by `joulebus alarms --acknowledge`.

use std::time::Duration;

use axum::http::StatusCode;
use joulebus_config::Config;
use joulebus_planner::{ClientError, PlanClient};
use joulebus_wire::{Alarm, QueryRefusal};
use serde::{Deserialize, Serialize};

use super::error::ApiError;

/// Timeout of an answer of the worker.
pub(super) const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// An acknowledgement as JSON, in both directions.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Acknowledge {
    robot: u32,
    /// Name of the alarm.
    alarm: String,
    /// Name of the person.
    by: String,
    /// True if the alarm ends, and the robot's power is its own level from now on.
    #[serde(default)]
    new_normal: bool,
}

impl Acknowledge {
    /// Asks the worker, and waits for its answer.
    ///
    /// # Errors
    /// The alarm is not raised, is none of a robot, or no worker takes it.
    pub(super) fn ask(self, config: &Config) -> Result<Self, ApiError> {
        let mut all = Alarm::ALL.into_iter();
        let Some(alarm) = all.find(|alarm| alarm.name() == self.alarm) else {
            // WorkerGone and WorkerStale: no worker is there that could take it.
            let of_robots = Alarm::ALL.map(Alarm::name).join(", ");
            return Err(ApiError::value("alarm", &self.alarm, &of_robots));
        };
        let client = PlanClient::with_config(config, "page");
        let mut client = client.map_err(|error| ApiError::busy(error.to_string()))?;
        let taken =
            client.acknowledge(self.robot, alarm, &self.by, self.new_normal, ANSWER_TIMEOUT);
        taken.map(|()| self).map_err(refused)
    }
}

/// A person's statement that the worker has not taken.
pub(super) fn refused(error: ClientError) -> ApiError {
    match error {
        ClientError::Refused(refused) => match refused.reason {
            // Of the latter kind is one on a host without a worker: asking again does not help.
            QueryRefusal::NotRaised | QueryRefusal::Kind => {
                ApiError::new(StatusCode::CONFLICT, refused.text)
            }
            QueryRefusal::Question | QueryRefusal::UnknownRobot => {
                ApiError::new(StatusCode::BAD_REQUEST, refused.text)
            }
            _ => ApiError::busy(refused.text),
        },
        error => ApiError::busy(error.to_string()),
    }
}
