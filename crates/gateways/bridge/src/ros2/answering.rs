//! The thread that answers requests of services: it asks the worker.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use joulebus_bus::Running;
use joulebus_config::Config;
use joulebus_planner::{ClientError, PlanClient};
use joulebus_ros_messages::RosError;

use crate::mapping::account::Reason;
use crate::mapping::robots::Robots;
use crate::mapping::ros::incoming::{MAX_BYTES, Received};
use crate::mapping::ros::services::{Request, Service, acknowledged, answered};
use crate::ros2::sink::Counts;
use crate::ros2::writer::{Client, Writer};
use crate::shared::Shared;

/// Interval of checking whether to end.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// Maximum number of requests that wait.
pub(crate) const MAX_REQUESTS: usize = 64;
/// Timeout of an answer of the worker.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(10);
/// Polls without a request after which the bridge leaves the worker's clients. While there are any,
/// each tick writes plan states.
const IDLE_POLLS: u32 = 100;

/// A request of a service.
pub(crate) struct Asked {
    /// Index of the service.
    pub(super) service: usize,
    pub(super) client: Client,
    pub(super) request: Received,
}

/// Parts that answer requests.
pub(crate) struct Answering {
    pub(crate) config: Config,
    pub(crate) name: String,
    pub(crate) robots: Robots,
    pub(crate) services: Vec<(Service, String)>,
    /// The writers of the services' responses.
    pub(crate) writers: Vec<Writer>,
    pub(crate) counts: Arc<Counts>,
    pub(crate) shared: Arc<Shared>,
}

impl Answering {
    /// Answers until `thread` is to end.
    pub(crate) fn run(&self, requests: &Receiver<Asked>, thread: &Running) {
        let (mut worker, mut idle_polls) = (None, 0);
        while !thread.is_stopping() {
            match requests.recv_timeout(POLL_INTERVAL) {
                Ok(asked) => {
                    self.answer(&asked, &mut worker);
                    idle_polls = 0;
                }
                Err(RecvTimeoutError::Timeout) => {
                    idle_polls += 1;
                    if idle_polls == IDLE_POLLS {
                        worker = None;
                    }
                }
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn answer(&self, asked: &Asked, worker: &mut Option<PlanClient>) {
        let services = self.services.get(asked.service).zip(self.writers.get(asked.service));
        let Some(((service, name), writer)) = services else { return };
        let response = if asked.request.length > MAX_BYTES {
            self.shared.account().count(name, Reason::TooLong, "a request");
            service.refused(format!("the request is longer than {MAX_BYTES} bytes"))
        } else {
            match service.read(&asked.request.bytes, &self.robots) {
                Ok(request) => self.ask(request, worker).unwrap_or_else(|why| {
                    // The next request joins the fleet again.
                    *worker = worker.take().filter(|_| why.is_of_request);
                    service.refused(why.text)
                }),
                Err(why) => service.refused(why),
            }
        };
        self.counts.count(response.is_ok_and(|response| writer.reply(&asked.client, response)));
        self.shared.log_news();
    }

    fn ask(
        &self,
        request: Request,
        worker: &mut Option<PlanClient>,
    ) -> Result<Result<Vec<u8>, RosError>, Refusal> {
        let client = match worker {
            Some(client) => client,
            none => {
                let joined = PlanClient::with_config(&self.config, &self.name);
                none.insert(joined.map_err(|error| Refusal::new(&error))?)
            }
        };
        match request {
            Request::Ask(question) => {
                let answer = client.ask(&question, ANSWER_TIMEOUT)?;
                Ok(answered(&answer.reply, (answer.tick, answer.age_ns), &self.robots))
            }
            Request::Acknowledge { robot, alarm, by } => {
                client.acknowledge(robot, alarm, &by, false, ANSWER_TIMEOUT)?;
                Ok(acknowledged())
            }
        }
    }
}

/// Reason that a request has no answer.
struct Refusal {
    text: String,
    /// True if the worker refused it, so that its client is as good as before.
    is_of_request: bool,
}

impl Refusal {
    fn new(error: &dyn std::fmt::Display) -> Self {
        Self { text: error.to_string(), is_of_request: false }
    }
}

impl From<ClientError> for Refusal {
    fn from(error: ClientError) -> Self {
        Self { is_of_request: matches!(error, ClientError::Refused(_)), ..Self::new(&error) }
    }
}
