//! What a person states of a robot's battery: the worker is asked, as by `joulebus battery`.

use axum::http::StatusCode;
use joulebus_config::Config;
use joulebus_planner::PlanClient;
use joulebus_wire::Statement;
use serde::{Deserialize, Serialize};

use super::acknowledge::{ANSWER_TIMEOUT, refused};
use super::error::ApiError;

/// A statement as JSON, in both directions: one of charge, full and exchanged.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StateBattery {
    robot: u32,
    /// Name of the person.
    by: String,
    /// Measured state of charge, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    charge: Option<f32>,
    /// True if the battery is full.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    full: bool,
    /// True if the battery was exchanged.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    exchanged: bool,
}

impl StateBattery {
    /// Asks the worker, and waits for its answer.
    ///
    /// # Errors
    /// Not one statement, the platform has no battery, or no worker takes it.
    pub(super) fn ask(self, config: &Config) -> Result<Self, ApiError> {
        let statement = match (self.charge, self.full, self.exchanged) {
            (Some(soc), false, false) => Statement::Charge(soc),
            (None, true, false) => Statement::Full,
            (None, false, true) => Statement::Exchanged,
            _ => {
                let text = "state one of \"charge\": 0 to 1, \"full\": true, \"exchanged\": true";
                return Err(ApiError::new(StatusCode::BAD_REQUEST, text.to_owned()));
            }
        };
        let client = PlanClient::with_config(config, "page");
        let mut client = client.map_err(|error| ApiError::busy(error.to_string()))?;
        let taken = client.state_battery(self.robot, statement, &self.by, ANSWER_TIMEOUT);
        taken.map(|()| self).map_err(refused)
    }
}
