//! The thread that answers requests of services: it asks the worker.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
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
const MAX_REQUESTS: usize = 64;
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

/// A program that asks, as far as the middleware names it, and the service that it asks.
type Asker = ([u8; 12], usize);

/// Requests that wait. Of one program as many as it leaves free, and all programs in turns: none
/// waits for more than one request of each other.
pub(crate) struct Requests<T = Asked> {
    waiting: Mutex<Waiting<T>>,
    arrived: Condvar,
}

/// Requests in the order of their arrival, each with its round, the round of the last, and the
/// programs that it has served.
struct Waiting<T> {
    requests: Vec<(u64, Asker, T)>,
    round: u64,
    served: Vec<Asker>,
}

impl<T> Default for Requests<T> {
    fn default() -> Self {
        let waiting = Mutex::new(Waiting { requests: Vec::new(), round: 0, served: Vec::new() });
        Self { waiting, arrived: Condvar::new() }
    }
}

impl<T> Requests<T> {
    /// Adds a request. Returns false if too many of its program wait.
    pub(super) fn add(&self, asker: Asker, asked: T) -> bool {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let own = waiting.requests.iter().filter(|(_, other, _)| *other == asker);
        let own: Vec<u64> = own.map(|(round, ..)| *round).collect();
        let free = MAX_REQUESTS - waiting.requests.len();
        if free == 0 || (own.len() + 1 > free && !own.is_empty()) {
            return false;
        }
        let next = waiting.round + u64::from(waiting.served.contains(&asker));
        let round = own.last().map_or(next, |last| last + 1);
        waiting.requests.push((round, asker, asked));
        self.arrived.notify_one();
        true
    }

    /// The next request, if there is one within [`POLL_INTERVAL`].
    fn next(&self) -> Option<T> {
        let waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let is_empty = |waiting: &mut Waiting<T>| waiting.requests.is_empty();
        let waited = self.arrived.wait_timeout_while(waiting, POLL_INTERVAL, is_empty);
        let (mut waiting, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let rounds = waiting.requests.iter().enumerate();
        // Of several the first.
        let (place, _) = rounds.min_by_key(|(_, (round, ..))| *round)?;
        let (round, asker, asked) = waiting.requests.remove(place);
        if round > waiting.round || waiting.served.len() == MAX_REQUESTS {
            waiting.served.clear();
        }
        waiting.round = round;
        waiting.served.push(asker);
        Some(asked)
    }
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
    pub(crate) fn run(&self, requests: &Requests, thread: &Running) {
        let (mut worker, mut idle_polls) = (None, 0);
        while !thread.is_stopping() {
            if let Some(asked) = requests.next() {
                self.answer(&asked, &mut worker);
                idle_polls = 0;
                continue;
            }
            idle_polls += 1;
            if idle_polls == IDLE_POLLS {
                worker = None;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_waits_for_one_request_of_each_other_and_finds_room() {
        let requests = Requests::<(u8, u32)>::default();
        let add = |program: u8, number| requests.add(([program; 12], 0), (program, number));
        let taken = (0..200).filter(|number| add(1, *number)).count();
        assert_eq!(taken, MAX_REQUESTS / 2);
        assert_eq!(requests.next(), Some((1, 0)));
        assert!(add(2, 0) && add(2, 1) && add(3, 0));
        let order: Vec<_> = (0..6).filter_map(|_| requests.next()).collect();
        assert_eq!(order, [(2, 0), (3, 0), (1, 1), (2, 1), (1, 2), (1, 3)]);
        // Another service of the same program.
        assert!(requests.add(([1; 12], 1), (4, 0)));
        assert_eq!(requests.next(), Some((4, 0)));
        while requests.next().is_some() {}
    }
}
