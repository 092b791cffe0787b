//! The ports, and the order in which questions are answered.

use std::sync::mpsc::TrySendError;

use joulebus_bus::{Bus, Limits, QueryServer, SendError, WaitError, clock, process_id};
use joulebus_config::Config;
use joulebus_plan::answering::Work;
use joulebus_plan::{PlanFleet, QuestionError, Refused, Reply};
use joulebus_planner::{Planner, View};
use joulebus_wire::{
    Acknowledgement, AnswerHeader, MAX_QUERY_STEPS, QueryCounts, QueryRecord, QueryRefusal,
    SCHEMA_VERSION, Statement, fnv1a,
};

use crate::acknowledgements::{Acknowledged, Table};
use crate::error::ServerError;
use crate::fair::Fair;
use crate::job::{Job, JobState};
use crate::records::Records;
use crate::statements::Statements;

/// Questions and statements of one process that may wait.
const MAX_OF_A_PROCESS: usize = 4;
/// Times that an answer is begun again with newer rows, at most: ways are followed once, so that
/// the first is enough unless the thread is hardly run.
const MAX_RENEWALS: u32 = 3;
/// Pause while a frame of the fleet is awaited, ns.
const FRAME_POLL_NS: u64 = 1_000_000;
/// Time for which an alarm is acknowledged before it ends as the new normal, ns: those who look for
/// changes ten times a second see by whom.
const SHOWN_NS: u64 = 250_000_000;
/// Time after the last client has left until plan states are not read any more, ns.
const LINGER_NS: u64 = 5_000_000_000;

/// The ports of one run of the worker. Belongs to the thread that opened them.
pub(crate) struct Server {
    // Dropped in this order: questions, ports, and then the process leaves the domain.
    jobs: Vec<Job>,
    server: QueryServer,
    records: Records,
    acknowledged: Acknowledged,
    /// While there are clients that have asked about plans.
    planner: Option<Planner>,
    bus: Bus,
    config: Config,
    models: PlanFleet,
    /// Hash of its name.
    fleet: u64,
    limits: Limits,
    fair: Fair,
    counts: QueryCounts,
    /// To the worker of this process, if there is one.
    statements: Option<Statements>,
    /// When a client was connected last, monotonic ns.
    asked_ns: u64,
}

impl Server {
    /// Opens the ports. `begun_ns` is the thread's start. `counts` and `table` are those from
    /// before any loss of ports.
    pub(crate) fn open(
        config: &Config,
        models: &PlanFleet,
        statements: Option<&Statements>,
        (begun_ns, counts, table): (u64, QueryCounts, Table),
    ) -> Result<Self, ServerError> {
        let bus = Bus::join(&config.domain()?, "queries")?;
        let limits = config.limits();
        Ok(Self {
            jobs: Vec::new(),
            records: Records::open(&bus, &limits, begun_ns)?,
            acknowledged: Acknowledged::open(&bus, &limits, begun_ns, table)?,
            server: bus.query_server(&limits)?,
            planner: None,
            bus,
            models: models.clone(),
            fleet: fnv1a(config.fleet().bytes()),
            config: config.clone(),
            limits,
            fair: Fair::default(),
            counts,
            statements: statements.cloned(),
            asked_ns: 0,
        })
    }

    pub(crate) const fn counts(&self) -> QueryCounts {
        self.counts
    }

    /// The acknowledged alarms, for a server after this one.
    pub(crate) fn table(&self) -> Table {
        self.acknowledged.table()
    }

    /// True if files of this process were removed.
    pub(crate) fn is_lost(&self) -> bool {
        self.bus.check().is_err()
    }

    /// Takes all waiting questions, works on one of them, or waits.
    pub(crate) fn round(&mut self) -> Result<(), ServerError> {
        self.bus.check().map_err(WaitError::from)?;
        // Before the questions are received, because it notices who has left.
        let clients = self.server.clients();
        self.take()?;
        self.acknowledge()?;
        self.answer_stated()?;
        self.connect(clients)?;
        let (next, is_awaited) = self.next()?;
        match next {
            Some(place) => self.advance(place)?,
            None if is_awaited => {
                let until_ns = clock::monotonic_ns().saturating_add(FRAME_POLL_NS);
                self.server.wait_until(until_ns)?;
            }
            None => {}
        }
        let due_ns = self.records.flush(self.counts, false)?;
        let due_ns = due_ns.min(self.acknowledged.flush()?);
        if self.jobs.is_empty() {
            self.server.wait_until(due_ns)?;
        }
        Ok(())
    }

    /// True if connections of clients that have left may be kept.
    pub(crate) fn needs_reopen(&self) -> bool {
        self.server.needs_reopen(self.jobs.is_empty())
    }

    /// With a new port for questions. Clients whose questions are dropped send them again.
    pub(crate) fn renewed(self) -> Result<Self, ServerError> {
        // A fleet has one such port, which is there while a question is.
        drop(self.jobs);
        drop(self.server);
        Ok(Self { jobs: Vec::new(), server: self.bus.query_server(&self.limits)?, ..self })
    }

    /// Refuses all questions, because the worker ends, and the statements that no tick has taken.
    pub(crate) fn end(&mut self) -> Result<(), ServerError> {
        let taken = self.take();
        self.answer_stated()?;
        for job in std::mem::take(&mut self.jobs) {
            let what = if matches!(job.state, JobState::Stated(_)) { "state it" } else { "ask" };
            let text = format!("the worker ends: {what} again when it has been started again");
            self.refuse(job, &Refused::new(QueryRefusal::Ending, text))?;
        }
        self.records.flush(self.counts, true)?;
        taken
    }

    /// Receives as many questions as clients can have in transfer: more come from clients that do
    /// not wait for answers, and wait until the next round.
    fn take(&mut self) -> Result<(), ServerError> {
        for _ in 0..self.limits.queries_in_transfer() {
            let Some(query) = self.server.receive()? else {
                return Ok(());
            };
            let (mut job, checked) = Job::take(query, self.fleet, clock::monotonic_ns());
            let of_process = self.jobs.iter().filter(|other| other.client == job.client);
            if let Err(refused) = checked {
                self.refuse(job, &refused)?;
            } else if job.is_new_normal() && self.statements.is_none() {
                let text = "this host has no worker that takes a new normal: ask on the host that \
                            has one, or only acknowledge the alarm";
                self.refuse(job, &Refused::new(QueryRefusal::Kind, text.to_owned()))?;
            } else if of_process.count() >= MAX_OF_A_PROCESS {
                let text = format!(
                    "{MAX_OF_A_PROCESS} questions of process {} wait already: ask when they are answered",
                    job.client
                );
                self.refuse(job, &Refused::new(QueryRefusal::Busy, text))?;
            } else if let Err(refused) = self.state(&mut job) {
                self.refuse(job, &refused)?;
            } else {
                self.fair.enter(job.client);
                self.jobs.push(job);
            }
        }
        Ok(())
    }

    /// Passes on what a job states of a battery, if it does.
    fn state(&self, job: &mut Job) -> Result<(), Refused> {
        let now_ns = clock::monotonic_ns();
        let JobState::Stating(robot, statement, by) = &job.state else {
            return Ok(());
        };
        let (robot, statement, by) = (*robot, *statement, by.clone());
        // Who gave up has not stated it.
        job.is_over(now_ns).map_or(Ok(()), Err)?;
        job.state = JobState::Stated(self.state_battery(robot, statement, &by)?);
        Ok(())
    }

    /// Answers the statements that the worker has taken. They count as waiting until then, so that
    /// one process cannot take all places.
    fn answer_stated(&mut self) -> Result<(), ServerError> {
        let worker = self.statements.as_ref();
        let has_taken = |number| worker.is_some_and(|worker| worker.has_taken(number));
        let is_due = |job: &mut Job| matches!(job.state, JobState::Stated(of) if has_taken(of));
        let stated: Vec<Job> = self.jobs.extract_if(.., is_due).collect();
        stated.into_iter().try_for_each(|job| self.answer(job, |_| Reply::default()))
    }

    /// Follows the diagnostics, and acknowledges what is asked for, once they have arrived.
    fn acknowledge(&mut self) -> Result<(), ServerError> {
        let asked = self.jobs.iter().filter_map(Job::acknowledgement);
        let asked: Vec<Acknowledgement> = asked.collect();
        let ports = (&self.bus, &self.limits);
        let Some(raised) = self.acknowledged.look(ports, &asked)? else {
            return Ok(());
        };
        let now_ns = clock::monotonic_ns();
        let mut place = 0;
        for (row, is_raised) in asked.into_iter().zip(raised) {
            let mut waiting = self.jobs.iter().skip(place);
            let Some(passed) = waiting.position(|job| job.acknowledgement().is_some()) else {
                break;
            };
            place += passed;
            let entered = self.acknowledged.enter(row, is_raised);
            let job = &mut self.jobs[place];
            let is_new_normal = job.is_new_normal();
            // Not from when it was asked: its row is sent after this.
            let shown_ns = now_ns.saturating_sub(*job.entered_ns.get_or_insert(now_ns));
            if is_new_normal && entered.is_ok() && shown_ns < SHOWN_NS {
                place += 1;
                continue;
            }
            let mut job = self.jobs.remove(place);
            // Else the answer would be that its time is over, although the worker took it.
            let taken = match job.is_over(now_ns) {
                Some(refused) => Err(refused),
                // The question's record has the name that the table has no room for.
                None if is_new_normal => entered.or_else(busy_is_no_reason).and_then(|()| {
                    let (robot, normal) = (row.robot, Statement::NewNormal);
                    let but = "is acknowledged, but not as its new normal";
                    self.pass_on(robot, normal, but).map(Some)
                }),
                None => entered.map(|()| None),
            };
            match taken {
                Ok(None) => self.answer(job, |_| Reply::default())?,
                Ok(Some(number)) => {
                    job.state = JobState::Stated(number);
                    self.jobs.insert(place, job);
                    place += 1;
                }
                Err(refused) => self.refuse(job, &refused)?,
            }
        }
        Ok(())
    }

    /// Has the worker take what `by` states of a robot's battery. Returns the statement's number.
    fn state_battery(&self, robot: u32, statement: Statement, by: &str) -> Result<u64, Refused> {
        let refused = |reason, text: String| Err(Refused::new(reason, text));
        if self.statements.is_none() {
            let text = "this host has no worker that takes it: ask on the host that has one";
            return refused(QueryRefusal::Kind, text.to_owned());
        }
        let platforms = &self.config.settings().platforms;
        let platform = platforms.iter().find(|platform| platform.has(robot));
        let Some(platform) = platform else {
            let text = format!("robot {robot} is of no platform of the config: `joulebus watch`");
            return refused(QueryRefusal::UnknownRobot, text);
        };
        if platform.battery.is_none() {
            let text = format!(
                "platform {} has no [battery]: add its capacity_wh, and start the worker again",
                platform.name
            );
            return refused(QueryRefusal::Question, text);
        }
        let number = self.pass_on(robot, statement, "keeps its battery as it was")?;
        // As visible as what a pause has cost.
        tracing::warn!("robot {robot}: {statement}, states {by}");
        Ok(number)
    }

    /// Has the next tick of the worker take what a person states of a robot. `but` says what is the
    /// case if it does not. Returns the statement's number.
    fn pass_on(&self, robot: u32, statement: Statement, but: &str) -> Result<u64, Refused> {
        let sent = self.statements.as_ref();
        let sent = sent.map_or(Ok(0), |worker| worker.send((robot, statement)));
        sent.map_err(|error| {
            let (reason, why) = match error {
                TrySendError::Full(_) => (QueryRefusal::Busy, "too many wait. Ask again"),
                TrySendError::Disconnected(_) => (QueryRefusal::Ending, "the worker ends"),
            };
            let text = format!("robot {robot} {but}: {why}");
            Refused::new(reason, text)
        })
    }

    /// Reads plan states from the first question about a plan on, while there are clients: without,
    /// the tick does not write them.
    fn connect(&mut self, clients: usize) -> Result<(), ServerError> {
        let now_ns = clock::monotonic_ns();
        let is_plan = |job: &Job| matches!(job.state, JobState::Waiting(_) | JobState::Working(_));
        if clients > 0 {
            self.asked_ns = now_ns;
            if self.planner.is_none() && self.jobs.iter().any(is_plan) {
                self.planner =
                    Some(Planner::with_fleet(&self.config, "queries", self.models.clone())?);
            }
        } else if now_ns.saturating_sub(self.asked_ns) > LINGER_NS {
            self.planner = None;
        }
        Ok(())
    }

    /// The question to work on, and whether one waits for a frame. Gives up those that are over.
    fn next(&mut self) -> Result<(Option<usize>, bool), ServerError> {
        let now_ns = clock::monotonic_ns();
        let mut place = 0;
        while let Some(job) = self.jobs.get_mut(place) {
            match job.is_over(now_ns) {
                Some(refused) => {
                    let job = self.jobs.remove(place);
                    self.refuse(job, &refused)?;
                }
                None => place += 1,
            }
        }
        let jobs = &self.jobs;
        self.fair.keep(|process| jobs.iter().any(|job| job.client == process));
        if jobs.is_empty() {
            return Ok((None, false));
        }
        // A view that cannot be read now is read later, or the question is refused.
        let view = self.planner.as_mut().map(Planner::view);
        let view = view.and_then(Result::ok).flatten();
        let (has_frame, is_current) = (view.is_some(), view.is_some_and(|view| view.is_current()));
        let period_ns = self.config.tick_period_ns();
        let is_ready = |job: &&(usize, &Job)| match job.1.state {
            JobState::Working(_) => true,
            JobState::Waiting(_) => is_current || job.1.is_impatient(now_ns, period_ns, has_frame),
            JobState::Acknowledging(_) | JobState::Stating(..) | JobState::Stated(_) => false,
        };
        let ready: Vec<(usize, &Job)> =
            jobs.iter().enumerate().filter(|job| is_ready(&job)).collect();
        let next = self.fair.next(ready.iter().map(|(_, job)| job.client));
        let next = next.map(|at| ready[at].0);
        Ok((next, next.is_none()))
    }

    /// Works on a question: up to one robot of it, or one way to be followed.
    fn advance(&mut self, place: usize) -> Result<(), ServerError> {
        // Thread time: the time that other threads take is not charged to a client.
        let begun_ns = clock::thread_cpu_ns();
        let mut job = self.jobs.remove(place);
        let client = job.client;
        let worked = self.work(&mut job);
        let took_ns = clock::thread_cpu_ns().saturating_sub(begun_ns);
        self.fair.served(client, took_ns);
        match worked {
            // In the order in which they were taken.
            Ok(None) => self.jobs.insert(place, job),
            Ok(Some(work)) => self.answer(job, |now_ns| work.finish_at(now_ns))?,
            Err(refused) => self.refuse(job, &refused)?,
        }
        Ok(())
    }

    /// The work, if it is complete.
    fn work(&mut self, job: &mut Job) -> Result<Option<Work>, Refused> {
        let refused = |error: QuestionError| Refused::from(&error);
        let none = || {
            let text = "the worker has not published the fleet's state yet: ask again".to_owned();
            Refused::new(QueryRefusal::NoFrame, text)
        };
        let planner = self.planner.as_mut().ok_or_else(none)?;
        if let JobState::Waiting(question) = &mut job.state {
            let view = planner.view().map_err(|_| none())?.ok_or_else(none)?;
            let question = std::mem::take(question);
            let find = |robot| View::rows(&view, robot);
            let work = Work::begin(question, find, MAX_QUERY_STEPS).map_err(refused);
            view.state_in(&mut job.answer);
            job.state = JobState::Working(work?);
        }
        let JobState::Working(work) = &mut job.state else {
            return Ok(None);
        };
        let fleet = planner.fleet();
        let is_done = if job.renewals == 0 { work.step(fleet) } else { work.rest(fleet) };
        if !is_done.map_err(refused)? {
            return Ok(None);
        }
        let work = std::mem::take(work);
        self.renew(job, work)
    }

    /// The finished work. If the robots' state has become stale, it is computed again from the
    /// newest frames. A part that needs another way to be followed stays with the question.
    fn renew(&mut self, job: &mut Job, work: Work) -> Result<Option<Work>, Refused> {
        if job.renewals >= MAX_RENEWALS || !work.is_stale(clock::monotonic_ns()) {
            return Ok(Some(work));
        }
        // Without a newer frame the answer states that.
        let Some(planner) = self.planner.as_mut() else {
            return Ok(Some(work));
        };
        let Some(view) = planner.view().ok().flatten().filter(View::is_current) else {
            return Ok(Some(work));
        };
        let refused = |error: QuestionError| Refused::from(&error);
        let mut work = work.renew(|robot| View::rows(&view, robot)).map_err(refused)?;
        view.state_in(&mut job.answer);
        job.renewals += 1;
        if work.rest(planner.fleet()).map_err(refused)? {
            return Ok(Some(work));
        }
        job.state = JobState::Working(work);
        Ok(None)
    }

    fn answer(
        &mut self,
        mut job: Job,
        reply: impl FnOnce(u64) -> Reply,
    ) -> Result<(), ServerError> {
        let now_ns = clock::monotonic_ns();
        if let Some(refused) = job.is_over(now_ns) {
            return self.refuse(job, &refused);
        }
        let mut words = Vec::new();
        reply(now_ns).encode(&mut job.answer, &mut words);
        if let Err(error) = self.send(&mut job, &words, now_ns) {
            return self.refuse_unsent(job, &error);
        }
        self.counts.answered += 1;
        self.record(&job, &words)
    }

    fn refuse(&mut self, mut job: Job, refused: &Refused) -> Result<(), ServerError> {
        let mut words = Vec::new();
        refused.encode(&mut job.answer, &mut words);
        self.counts.refuse(refused.reason);
        if refused.reason != QueryRefusal::ClientGone {
            // Its client learns it from the deadline otherwise.
            let _ = self.send(&mut job, &words, clock::monotonic_ns());
        }
        self.record(&job, &words)
    }

    fn refuse_unsent(&mut self, mut job: Job, error: &SendError) -> Result<(), ServerError> {
        let mut words = Vec::new();
        let refused = Refused::new(QueryRefusal::Unsent, error.to_string());
        (job.answer.rows, job.answer.powers) = (0, 0);
        refused.encode(&mut job.answer, &mut words);
        self.counts.refuse(QueryRefusal::Unsent);
        self.record(&job, &words)
    }

    /// Sends an answer. The age in the answer depends on `now_ns`.
    fn send(&mut self, job: &mut Job, words: &[u64], now_ns: u64) -> Result<(), SendError> {
        job.answer = AnswerHeader {
            schema: SCHEMA_VERSION,
            pid: process_id(),
            number: job.header.number,
            taken_ns: job.taken_ns,
            sent_ns: now_ns,
            ..job.answer
        };
        // A client that was not woken finds the answer itself.
        self.server.answer(&job.query, job.answer, job.listener(), words)?;
        Ok(())
    }

    fn record(&mut self, job: &Job, words: &[u64]) -> Result<(), ServerError> {
        let record = QueryRecord {
            client: job.client,
            query: job.header,
            answer: job.answer,
            ..QueryRecord::default()
        };
        self.records.add(record, (&job.values, words), self.counts)?;
        Ok(())
    }
}
/// A full table of acknowledgements keeps no new normal from being taken.
fn busy_is_no_reason(refused: Refused) -> Result<(), Refused> {
    if refused.reason == QueryRefusal::Busy { Ok(()) } else { Err(refused) }
}
