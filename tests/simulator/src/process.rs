//! The processes of a fleet: the shells' own code, called step by step.

use std::cell::RefCell;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use joulebus_capture_format::{Attachments, CaptureSettings, Preset};
use joulebus_config::Config;
use joulebus_plan::{Plan, Question, Reply};
use joulebus_wire::{
    Channel, Flow, ForEachChannel, Forecast, ForecastHeader, Forecasts, FrameRows, Sample,
    each_channel,
};
use simulated_board::{Board, Feed, Link, Reading};
use simulated_bridge::Bridge;
use simulated_bus::{Background, Rounds};
use simulated_consumer::{AlarmFeed, End, Event, ReadError, Subscriber};
use simulated_host::{self as host, time};
use simulated_plan_server::{PlanServer, QueryReport};
use simulated_planner::{Answered, ClientError, PlanClient, QueryError};
use simulated_publisher::{Publisher, RobotState};
use simulated_recorder::{Options, Recorder, Summary, Target, host_clock};
use simulated_worker::Worker;

use crate::panics::last_panic;
use crate::scenario::Setup;

pub(crate) enum Program {
    Worker(Box<Worker>, Box<PlanServer>),
    Client(Box<ClientProgram>),
    Source(Box<SourceProgram>),
    Planner(Box<PlannerProgram>),
    Display(Box<DisplayProgram>),
    Bridge(Box<BridgeProgram>),
    /// The paths of its files begin so.
    Recorder(Recorder, String),
}

/// Result of a program's step.
pub(crate) enum Stepped {
    /// The program goes on, at the latest at this simulated time.
    On(u64),
    /// A planner that goes on: what it learned.
    Learned(u64, Learned),
    /// A display or a bridge that goes on: what it shows.
    Shown(u64, Shown),
    /// A client that goes on, and the outcome.
    Asked(u64, Outcome),
    /// The program has ended by itself, for the reason given.
    Ended(String),
}

/// Result of a client's step.
pub(crate) enum Outcome {
    Nothing,
    Answer(Box<Answered>),
    /// No answer in time to what it asked then, simulated ns.
    TimedOut(u64),
}

/// A frame: the process, run and tick of its worker.
pub(crate) type FrameId = (u32, u64, u64);

/// Result of a planner's step.
#[derive(Debug, Clone, Default)]
pub(crate) struct Learned {
    /// The planner polls, and the longest time between two polls.
    pub polls: bool,
    pub every_ns: u64,
    /// Frames that it has read.
    pub frames: Vec<FrameId>,
    /// End of the worker.
    pub end: Option<End>,
    /// The worker has ended, or is silent.
    pub is_worse: bool,
    /// A frame that the worker did not send.
    pub is_false: bool,
}

/// Longest time between two looks of a planner, ns.
pub(crate) const POLL_INTERVAL_NS: u64 = 50_000_000;

/// Marks a false frame: the worker never has such a robot.
pub(crate) const FALSE_ROBOT: u32 = 0x00BA_DBAD;

impl Program {
    /// Does what the program's main loop does once.
    pub(crate) fn step(&mut self) -> Stepped {
        match self {
            Self::Client(client) => client.step(),
            Self::Worker(worker, _) => match worker.poll() {
                // If it has not ticked it sleeps. It has informed the host until when.
                Ok(_) => Stepped::On(time::now_ns()),
                Err(error) => Stepped::Ended(error.to_string()),
            },
            Self::Source(source) => source.step(),
            Self::Planner(planner) => planner.step(),
            Self::Display(display) => display.step(),
            Self::Bridge(bridge) => bridge.step(),
            Self::Recorder(recorder, _) if recorder.is_over() => {
                Stepped::Ended("the recording has failed".to_owned())
            }
            Self::Recorder(..) => Stepped::On(time::now_ns() + 1_000_000_000),
        }
    }

    /// What a display or a bridge shows.
    pub(crate) fn shown(&self) -> Option<Shown> {
        match self {
            Self::Display(display) => Some(display.shown()),
            Self::Bridge(bridge) => Some(bridge.screen.shown()),
            _ => None,
        }
    }

    /// Ends the program in order.
    pub(crate) fn finish(self) -> Finished {
        match self {
            Self::Recorder(recorder, _) => Finished::Recorded(Box::new(recorder.finish())),
            Self::Worker(worker, questions) => {
                let report = questions.finish();
                // Its report counts what the frames did.
                let _ = worker.finish();
                Finished::Answered(report)
            }
            Self::Display(display) => {
                display.finish();
                Finished::Nothing
            }
            Self::Bridge(bridge) => {
                // Its files may have been removed.
                let _ = bridge.bridge.finish();
                Finished::Nothing
            }
            Self::Source(_) | Self::Planner(_) | Self::Client(_) => Finished::Nothing,
        }
    }
}

/// A program's result at its end.
pub(crate) enum Finished {
    Nothing,
    Recorded(Box<Summary>),
    /// Questions that a worker has answered.
    Answered(QueryReport),
}

/// Power of a robot in W: of every second one constant, so that its energy is known exactly.
pub(crate) fn power_w(robot: u32, seq: u64) -> f32 {
    let base = 2.0 + 0.25 * (robot % 16) as f32;
    if is_constant(robot) {
        return base;
    }
    base + ((seq * 7 + u64::from(robot)) % 32) as f32 * 0.0625
}

/// True if the power of a robot is constant.
pub(crate) const fn is_constant(robot: u32) -> bool {
    robot.is_multiple_of(2)
}

/// A source: its robots, one sample each in every period.
pub(crate) struct SourceProgram {
    publisher: Publisher,
    robots: Vec<u32>,
    samples: Vec<Sample>,
    /// Time of the next frame, monotonic ns, on a fixed grid.
    due_ns: u64,
    period_ns: u64,
    frames: u64,
    /// Frames to be sent at once.
    pub(crate) flood: u64,
}

impl SourceProgram {
    pub(crate) fn open(
        config: &Config,
        name: &str,
        robots: Vec<u32>,
        setup: &Setup,
    ) -> Option<Self> {
        let publisher = Publisher::without_judgement(config, name).ok()?;
        let period_ns = setup.period_ns;
        Some(Self {
            publisher,
            robots,
            samples: Vec::new(),
            due_ns: (time::monotonic_ns() / period_ns + 1) * period_ns,
            period_ns,
            frames: 0,
            flood: 0,
        })
    }

    pub(crate) fn step(&mut self) -> Stepped {
        if time::monotonic_ns() >= self.due_ns {
            let count = 1 + std::mem::take(&mut self.flood);
            for extra in 0..count {
                // The frames of a flood lie between two of the grid.
                if let Err(error) = self.send(self.due_ns + extra) {
                    return Stepped::Ended(error);
                }
            }
            let missed = (time::monotonic_ns() - self.due_ns) / self.period_ns;
            self.due_ns += (missed + 1) * self.period_ns;
        }
        Stepped::On(time::simulated_ns(self.due_ns))
    }

    /// One half of the sources stamps its samples itself, the other leaves it to the library.
    fn send(&mut self, stamp_ns: u64) -> Result<(), String> {
        let seq = self.frames;
        self.frames += 1;
        let v_mps = 0.2;
        let sent = if self.robots.first().is_some_and(|robot| robot % 20 < 10) {
            self.samples.clear();
            self.samples.extend(self.robots.iter().map(|robot| {
                Sample::new(*robot, seq, stamp_ns)
                    .command(v_mps, 0.0)
                    .reading(power_w(*robot, seq), stamp_ns)
            }));
            self.publisher.publish_samples(stamp_ns, &self.samples)
        } else {
            self.publisher.publish(self.robots.iter().map(|robot| {
                let state = RobotState::new(*robot).command(v_mps, 0.0);
                state.reading(power_w(*robot, seq))
            }))
        };
        match sent {
            Err(simulated_publisher::PublishError::Send(error)) if error.is_final() => {
                Err(error.to_string())
            }
            _ => Ok(()),
        }
    }
}

/// A planner that reads forecasts, and all other channels with rows of robots.
pub(crate) struct PlannerProgram {
    planner: Subscriber,
    feeds: Vec<HasFalseRobot>,
    polls: bool,
    every_ns: u64,
}

/// Reads a channel's newest frame. Returns whether it has [`FALSE_ROBOT`].
type HasFalseRobot = Box<dyn FnMut() -> bool>;

/// Opens the channels that a planner reads beside the forecasts.
struct Feeds<'a>(&'a Subscriber, Option<Vec<HasFalseRobot>>);

impl ForEachChannel for Feeds<'_> {
    fn channel<C: Channel>(&mut self) {
        let is_read = matches!(C::FLOW, Flow::Planners { .. }) && C::ROWS == FrameRows::Robots;
        if !is_read || C::SERVICE == Forecasts::SERVICE {
            return;
        }
        let Ok(mut feed) = self.0.feed::<C>() else {
            self.1 = None;
            return;
        };
        let has_false_robot = move || {
            let newest = feed.latest().ok().flatten();
            let is_false = |row: &C::Row| C::robot(row) == Some(FALSE_ROBOT);
            newest.is_some_and(|frame| frame.robots().iter().any(is_false))
        };
        if let Some(feeds) = &mut self.1 {
            feeds.push(Box::new(has_false_robot));
        }
    }
}

impl PlannerProgram {
    /// Planner `number` of the fleet: the first one polls if the setup asks for it.
    pub(crate) fn open(config: &Config, setup: &Setup, number: usize) -> Option<Self> {
        let poll_every = (number == 0 && setup.poll_every_ns > 0)
            .then(|| Duration::from_nanos(setup.poll_every_ns));
        let planner = match poll_every {
            Some(every) => Subscriber::polling(config, "planner", every).ok()?,
            None => Subscriber::with_config(config, "planner").ok()?,
        };
        let looks = planner.look_every();
        let mut feeds = Feeds(&planner, Some(Vec::new()));
        each_channel(&mut feeds);
        Some(Self {
            polls: looks.is_some(),
            every_ns: looks
                .map_or(POLL_INTERVAL_NS.max(setup.period_ns / 2), |every| every.as_nanos() as u64),
            feeds: feeds.1?,
            planner,
        })
    }

    pub(crate) fn step(&mut self) -> Stepped {
        let mut learned =
            Learned { polls: self.polls, every_ns: self.every_ns, ..Learned::default() };
        let mut note = |header: &ForecastHeader, robots: &[Forecast]| {
            learned.frames.push((header.pid, header.worker_epoch, header.tick));
            learned.is_false |= robots.iter().any(|row| row.robot == FALSE_ROBOT);
        };
        let event = if self.polls {
            self.planner.wait_each(Duration::ZERO, note)
        } else {
            self.planner.wait_next(Duration::ZERO).inspect(|event| {
                if let Event::Frame(frame) = event {
                    note(frame.header(), frame.robots());
                }
            })
        };
        match event {
            Ok(Event::Gone(end)) => (learned.is_worse, learned.end) = (true, Some(end)),
            Ok(Event::Stale { .. }) => learned.is_worse = true,
            Ok(_) => {}
            Err(error) => return Stepped::Ended(error.to_string()),
        }
        if !learned.frames.is_empty() {
            // Every feed is read, whatever the others have.
            for has_false_robot in &mut self.feeds {
                learned.is_false |= has_false_robot();
            }
        }
        Stepped::Learned(time::now_ns() + self.every_ns, learned)
    }

    /// Age of the newest frame, ns.
    pub(crate) fn age_ns(&self) -> Option<u64> {
        let frame = self.planner.current()?;
        Some(time::monotonic_ns().saturating_sub(frame.header().sent_ns))
    }
}

/// A board as people see it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shown {
    /// The newest frame, and when it was sent, monotonic ns.
    pub frame: Option<(FrameId, u64)>,
    /// Frames read, and frames counted as missed.
    pub frames: u64,
    pub missed: u64,
    /// The worker serves, and the forecasts may be relied on.
    pub is_live: bool,
    pub robots: Vec<Forecast>,
}

impl Shown {
    fn new(board: &Board) -> Self {
        let place = |header: &ForecastHeader| (header.pid, header.worker_epoch, header.tick);
        Self {
            frame: board.header().map(|header| (place(header), header.sent_ns)),
            frames: board.frames,
            missed: board.frames_missed,
            is_live: board.link == Link::Live && board.is_reliable,
            robots: board.rows.values().map(|row| row.forecast).collect(),
        }
    }
}

/// Where a thread shows its board.
#[derive(Clone, Default)]
pub(crate) struct Screen(Arc<Mutex<Shown>>);

impl Screen {
    fn show(&self, board: &Board) {
        // Whole also after a kill: it is replaced at once.
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Shown::new(board);
    }

    fn shown(&self) -> Shown {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Longest time between two looks of a display.
const SHOW_EVERY: Duration = Duration::from_millis(100);

/// A display of the fleet.
pub(crate) enum DisplayProgram {
    /// As that of `joulebus demo`: each tick wakes it.
    Feed(Feed),
    /// As the page of `joulebus serve`: it polls, and reads alarms.
    Page(Background<anyhow::Result<()>>, Screen),
}

/// The ports of the reading thread of `joulebus serve`. The rest of it needs tokio.
struct Page {
    reading: Reading,
    alarms: AlarmFeed,
    board: RefCell<Board>,
    screen: Screen,
}

impl Rounds<(), anyhow::Error> for Page {
    fn round(&mut self) -> anyhow::Result<Duration> {
        let Self { reading, alarms, board, screen } = self;
        reading.poll_within(SHOW_EVERY, || board.borrow_mut())?;
        match alarms.changes(|_| {}) {
            Ok(()) | Err(ReadError::Receive(_)) => {}
            Err(error) => return Err(error.into()),
        }
        screen.show(&board.borrow());
        Ok(Duration::ZERO)
    }

    fn finish(self) -> anyhow::Result<()> {
        Ok(())
    }
}

impl DisplayProgram {
    /// Display `number` of the fleet: the first one is a feed, the second one a page.
    pub(crate) fn open(config: &Config, number: usize) -> Option<Self> {
        if number == 0 {
            return Some(Self::Feed(Feed::start(config, "display", (true, true)).ok()?));
        }
        let screen = Screen::default();
        let (config, of_thread) = (config.clone(), screen.clone());
        let opened = Background::repeat("joulebus-reader", move || {
            let page = Page {
                reading: Reading::polling(&config, "page", SHOW_EVERY)?,
                alarms: AlarmFeed::with_config(&config, "page")?,
                board: RefCell::new(Board::new(time::monotonic_ns())),
                screen: of_thread,
            };
            Ok((page, ()))
        });
        Some(Self::Page(opened.ok()?.0, screen))
    }

    pub(crate) fn shown(&self) -> Shown {
        match self {
            Self::Feed(feed) => Shown::new(&feed.board()),
            Self::Page(_, screen) => screen.shown(),
        }
    }

    fn step(&self) -> Stepped {
        let is_reading = match self {
            Self::Feed(feed) => feed.is_reading(),
            Self::Page(thread, _) => !thread.has_ended(),
        };
        if is_reading {
            Stepped::Shown(time::now_ns() + SHOW_EVERY.as_nanos() as u64, self.shown())
        } else {
            Stepped::Ended("the thread has ended".to_owned())
        }
    }

    /// Its files may have been removed: that is no failure.
    fn finish(self) {
        match self {
            Self::Feed(feed) => drop(feed.finish()),
            Self::Page(thread, _) => drop(thread.join()),
        }
    }
}

/// A bridge, whose robots each send two messages in every period.
pub(crate) struct BridgeProgram {
    bridge: Bridge,
    screen: Screen,
    robots: Vec<u32>,
    every_ns: u64,
    messages: u64,
}

impl BridgeProgram {
    pub(crate) fn open(
        config: &Config,
        name: &str,
        robots: Vec<u32>,
        setup: &Setup,
    ) -> Option<Self> {
        let every_ns = setup.period_ns / 2;
        let screen = Screen::default();
        let show = {
            let screen = screen.clone();
            move |board: &Board| screen.show(board)
        };
        let messages = (&*robots, Duration::from_nanos(every_ns));
        let bridge = Bridge::start(config, name, messages, show).ok()?;
        Some(Self { bridge, screen, robots, every_ns, messages: 0 })
    }

    fn step(&mut self) -> Stepped {
        if self.bridge.has_ended() {
            return Stepped::Ended("a thread has ended".to_owned());
        }
        for robot in &self.robots {
            self.bridge.observe(*robot, 0.2, power_w(*robot, self.messages));
        }
        self.messages += 1;
        Stepped::Shown(time::now_ns() + self.every_ns, self.screen.shown())
    }
}

/// A client that asks about robots of the first source, one question after the other.
pub(crate) struct ClientProgram {
    client: PlanClient,
    robots: Vec<u32>,
    period_ns: u64,
    /// When it asks again, simulated ns.
    next_ns: u64,
    is_asking: bool,
    /// When it asked last, simulated ns.
    asked_ns: u64,
    /// When it was answered last, simulated ns.
    pub(crate) answered_ns: u64,
    /// Reason that it was not answered the last time.
    pub(crate) last: String,
}

impl ClientProgram {
    pub(crate) fn open(config: &Config, setup: &Setup) -> Option<Self> {
        Some(Self {
            client: PlanClient::with_config(config, "client").ok()?,
            robots: (0..setup.robots as u32).collect(),
            period_ns: setup.period_ns,
            next_ns: time::now_ns(),
            is_asking: false,
            asked_ns: 0,
            answered_ns: 0,
            last: String::new(),
        })
    }

    /// Time after which it gives a question up.
    pub(crate) const fn patience(period_ns: u64) -> Duration {
        Duration::from_nanos(6 * period_ns + 3_000_000_000)
    }

    fn step(&mut self) -> Stepped {
        if self.is_asking {
            return match self.client.poll() {
                // It sleeps. It has informed the host until when.
                Ok(None) => Stepped::Asked(time::now_ns(), Outcome::Nothing),
                Ok(Some(answered)) => {
                    self.answered_ns = time::now_ns();
                    self.pauses(Outcome::Answer(Box::new(answered)))
                }
                Err(error) => self.fails(&error),
            };
        }
        if time::now_ns() < self.next_ns {
            return Stepped::Asked(self.next_ns, Outcome::Nothing);
        }
        self.asked_ns = time::now_ns();
        let sent = self.client.send(&self.question(), Self::patience(self.period_ns));
        match sent {
            Ok(()) => {
                self.is_asking = true;
                Stepped::Asked(time::now_ns(), Outcome::Nothing)
            }
            Err(error) => self.fails(&error),
        }
    }

    fn question(&self) -> Question {
        let robot = self.robots[host::below(self.robots.len())];
        let plan = match host::below(3) {
            0 => Plan::Idle { robots: self.robots.clone(), duration_s: 10.0 },
            1 => Plan::Idle { robots: vec![robot, 999_999], duration_s: 1.0 },
            _ => Plan::WhatIf {
                robot,
                candidates: 2,
                period_s: 0.1,
                v_mps: vec![0.1; 20],
                omega_radps: vec![0.0; 20],
            },
        };
        Question { plan, ..Question::default() }
    }

    fn fails(&mut self, error: &ClientError) -> Stepped {
        self.last = error.to_string();
        let is_removed =
            matches!(error, ClientError::Unanswered(QueryError::Removed(_) | QueryError::Wait(_)));
        if is_removed {
            return Stepped::Ended(self.last.clone());
        }
        self.pauses(match error {
            ClientError::Unanswered(QueryError::TimedOut { .. }) => {
                Outcome::TimedOut(self.asked_ns)
            }
            _ => Outcome::Nothing,
        })
    }

    fn pauses(&mut self, outcome: Outcome) -> Stepped {
        self.is_asking = false;
        let most = 1 + 4 * self.period_ns as usize / 1_000_000;
        self.next_ns = time::now_ns() + 1_000_000 * (1 + host::below(most)) as u64;
        Stepped::Asked(self.next_ns, outcome)
    }
}

/// True if the contents of an answer are possible: its ranges are in order.
pub(crate) fn is_possible(reply: &Reply) -> bool {
    let energies = reply.rows.iter().filter_map(|row| row.answer.energy);
    let mut ranges = energies.map(|energy| (energy.lo_j, energy.mean_j, energy.hi_j));
    ranges.all(|(lo_j, mean_j, hi_j)| lo_j <= mean_j && mean_j <= hi_j)
}

/// Starts a recorder whose files begin with `path`.
pub(crate) fn recorder(config: &Config, path: String) -> Option<Program> {
    let options =
        Options { settings: CaptureSettings::new(Preset::FastWrite), ..Options::default() };
    let target = Target::File(PathBuf::from(format!("{path}.mcap")));
    let attachments = Attachments::default();
    let started = Recorder::start(config, Vec::new(), host_clock(), attachments, target, &options);
    Some(Program::Recorder(started.ok()?, path))
}

pub(crate) fn worker(config: &Config) -> Result<Program, String> {
    let questions = PlanServer::start(config, None).map_err(|error| error.to_string())?;
    let opened = Worker::open(config).map_err(|error| error.to_string())?;
    questions.serve();
    Ok(Program::Worker(Box::new(opened), Box::new(questions)))
}

/// Cause of the unwinding of a process's code: killed, or else the panic's message.
pub(crate) fn cause(panic: Box<dyn std::any::Any + Send>) -> Result<host::Killed, String> {
    let panic = match panic.downcast::<host::Killed>() {
        Ok(killed) => return Ok(*killed),
        Err(panic) => panic,
    };
    drop(panic);
    Err(last_panic())
}
