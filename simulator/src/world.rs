//! Runs a scenario.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use joulebus_predictor::Model;
use simulated_bus as bus;
use simulated_config::Config;
use simulated_host::{self as host, disk, memory, time};

use crate::check::{Answers, Checked, Checker, Ending, Failure, failure};
use crate::grown::{self, Grown};
use crate::hostile;
use crate::ledger::{LEDGER, damage, newest_whole};
use crate::process::{
    self, ClientProgram, Finished, Heard, LOOK_EVERY_NS, Learned, PlannerProgram, Program,
    SourceProgram, Stepped,
};
use crate::scenario::{Fault, Role, Scenario};

const SECOND: u64 = 1_000_000_000;
/// Files of others beside it.
const FOREIGN: [&str; 3] = [
    "/sim/ledger.json.mine",
    "/sim/notes.txt",
    "/sim/captures/other.mcap",
];
/// Pids are reused after so many processes.
const PIDS: std::ops::Range<u32> = host::FIRST_PID..host::FIRST_PID + 40;
/// The robot of the source that joins last.
const LAST_ROBOT: u32 = 900_001;

/// What a simulation came to.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// Simulated time, ns.
    pub simulated_ns: u64,
    /// Ticks of all workers.
    pub ticks: u64,
    /// Faults that happened.
    pub faults: u64,
    /// Processes started.
    pub processes: u64,
    /// Captures read and computed again, and their ticks.
    pub captures: u64,
    /// Ticks computed again.
    pub verified_ticks: u64,
    /// Questions that clients were answered.
    pub questions: u64,
    /// Answers compared with those of an undisturbed run.
    pub answers: u64,
    /// By how much processes have grown at most.
    pub grown: Grown,
    /// The first invariant that did not hold.
    pub failure: Option<Failure>,
    /// It was stopped before its end: it says nothing.
    pub is_stopped: bool,
}

/// A place for a process.
struct Slot {
    /// None: a visitor, who is not restarted.
    role: Option<Role>,
    name: String,
    robots: Vec<u32>,
    program: Option<Program>,
    pid: u32,
    /// Pid of the process before.
    last_pid: u32,
    wake_ns: u64,
    /// When it is started again, if it does not run.
    start_ns: u64,
    paused_until_ns: u64,
    cost_ns: u64,
    slow_until_ns: u64,
    blind_until_ns: u64,
    /// When a visitor leaves.
    until_ns: u64,
    /// Accesses to the disk after which it dies, of its next lives.
    kills_at_disk: VecDeque<u64>,
    /// False frames that are the first that the next process reads.
    greeting: u64,
    /// The power fails for so long when it dies.
    power_loss_ns: u64,
    /// What it had allocated when it began its work, bytes.
    opened_bytes: i64,
    /// A planner: the worker of which it has frames; and until when it must have learned of its end.
    follows: Option<(u32, u64, u64)>,
    learn_until_ns: u64,
    /// A planner: the run of the worker, if it was running when the planner had its first frame.
    watched: Option<u64>,
    /// When it looked last, simulated ns.
    looked_ns: u64,
    /// A planner: it was told not to rely on the newest frame.
    is_warned: bool,
    /// Why it did not start, or ended, the last time.
    last: String,
}

struct World<'a> {
    scenario: &'a Scenario,
    stop: &'a AtomicBool,
    config: Config,
    slots: Vec<Slot>,
    checker: Checker,
    next_pid: u32,
    names: u64,
    woken: Vec<u32>,
    disk_until_ns: u64,
    memory_until_ns: u64,
    /// A process has died with which the power fails, for so long.
    power_loss_ns: u64,
    /// The newest generation of the ledger that was whole when a worker ended.
    saved: u64,
    /// When a worker has ended last, simulated ns.
    worker_ended_ns: u64,
    /// Questions that clients were answered in the life of this worker.
    answered: u64,
    outcome: Outcome,
}

/// Runs a scenario, and that without faults where their answers must be equal; ends soon after `stop` is set.
#[must_use]
pub fn run(scenario: &Scenario, stop: &AtomicBool) -> Outcome {
    let (mut outcome, answers) = run_once(scenario, stop);
    if outcome.failure.is_some() || outcome.is_stopped || scenario.setup.everything {
        return outcome;
    }
    let (undisturbed, expected) = run_once(&scenario.undisturbed(), stop);
    outcome.simulated_ns += undisturbed.simulated_ns;
    if undisturbed.is_stopped {
        outcome.is_stopped = true;
        return outcome;
    }
    outcome.answers = (answers.forecasts.len() + answers.ledgers.len()) as u64;
    outcome.failure = undisturbed.failure.or_else(|| compare(&answers, &expected));
    outcome
}

/// Each sample of a source that nothing happened to is answered as in a run in which nothing happened.
fn compare(answers: &Answers, expected: &Answers) -> Option<Failure> {
    const NAME: &str = "robots that are not touched are answered as ever";
    for (key, answer) in &answers.forecasts {
        if let Some(expected) = expected.forecasts.get(key)
            && answer != expected
        {
            return Some(failure(
                NAME,
                format!("{key:?}: {answer:?}, expected {expected:?}"),
            ));
        }
    }
    for (key, entry) in &answers.ledgers {
        if let Some(expected) = expected.ledgers.get(key)
            && entry != expected
        {
            return Some(failure(
                NAME,
                format!("{key:?}: {entry:?}, expected {expected:?}"),
            ));
        }
    }
    let (found, wanted) = (answers.forecasts.len(), expected.forecasts.len());
    // The runs end at different samples.
    (found + 20 + found / 50 < wanted)
        .then(|| failure(NAME, format!("{found} samples answered, expected {wanted}")))
}

fn run_once(scenario: &Scenario, stop: &AtomicBool) -> (Outcome, Answers) {
    host::begin(scenario.seed, scenario.setup.uptime_ns);
    bus::begin();
    let text = scenario.setup.toml(LEDGER);
    let parsed = Config::parse(&text, Path::new("/"));
    let loaded = parsed
        .map_err(|error| error.to_string())
        .and_then(|config| {
            let models =
                simulated_models::load_models(&config).map_err(|error| error.to_string())?;
            Ok((config, models))
        });
    let (config, models) = match loaded {
        Ok(loaded) => loaded,
        Err(error) => {
            let failure = Some(failure("the config is accepted", error));
            return (
                Outcome {
                    failure,
                    ..Outcome::default()
                },
                Answers::default(),
            );
        }
    };
    for path in FOREIGN {
        disk::put(Path::new(path), path.as_bytes().to_vec());
    }
    let mut world = World::new(scenario, stop, config, models);
    if let Err(failure) = world.play()
        && !world.outcome.is_stopped
    {
        world.outcome.failure = Some(failure);
    }
    world.outcome.simulated_ns = time::now_ns();
    world.outcome.ticks = world.checker.ticks;
    world.outcome.captures = world.checker.captures;
    world.outcome.verified_ticks = world.checker.verified_ticks;
    let answers = world.checker.answers.take().unwrap_or_default();
    let outcome = world.outcome.clone();
    world.bury_all();
    (outcome, answers)
}

impl Slot {
    /// The process that runs dies in its next access to the disk for which that was asked.
    fn is_killed_at_disk(&mut self) {
        if self.pid != 0
            && let Some(accesses) = self.kills_at_disk.pop_front()
        {
            host::kill_at_disk(self.pid, accesses);
        }
    }
}

impl<'a> World<'a> {
    fn new(
        scenario: &'a Scenario,
        stop: &'a AtomicBool,
        config: Config,
        models: Vec<Model>,
    ) -> Self {
        let setup = &scenario.setup;
        let mut checker = Checker::new(setup, &config, models);
        checker.answers = (!setup.everything).then(Answers::default);
        checker.join();
        let mut world = Self {
            scenario,
            stop,
            config,
            slots: Vec::new(),
            checker,
            next_pid: PIDS.start,
            names: 0,
            woken: Vec::new(),
            disk_until_ns: 0,
            memory_until_ns: 0,
            power_loss_ns: 0,
            saved: 0,
            worker_ended_ns: 0,
            answered: 0,
            outcome: Outcome::default(),
        };
        world.place(Some(Role::Worker), "worker".to_owned(), Vec::new(), 0);
        for source in 0..setup.sources {
            let robots = (0..setup.robots).map(|robot| (10 * source + robot) as u32);
            // The first answers are the same only if the worker has read the first sample.
            let name = format!("source-{source}");
            world.place(
                Some(Role::Source(source)),
                name,
                robots.collect(),
                SECOND / 10,
            );
        }
        for planner in 0..setup.planners {
            world.place(
                Some(Role::Planner(planner)),
                "planner".to_owned(),
                Vec::new(),
                0,
            );
        }
        for client in 0..setup.clients {
            world.place(
                Some(Role::Client(client)),
                format!("client-{client}"),
                Vec::new(),
                SECOND / 5,
            );
        }
        if setup.records {
            world.place(
                Some(Role::Recorder),
                "recorder".to_owned(),
                Vec::new(),
                SECOND / 20,
            );
        }
        world
    }

    fn place(&mut self, role: Option<Role>, name: String, robots: Vec<u32>, start_ns: u64) {
        self.slots.push(Slot {
            role,
            name,
            robots,
            program: None,
            pid: 0,
            last_pid: 0,
            wake_ns: u64::MAX,
            start_ns,
            paused_until_ns: 0,
            cost_ns: host::USUAL_COST_NS,
            slow_until_ns: 0,
            blind_until_ns: 0,
            until_ns: u64::MAX,
            kills_at_disk: VecDeque::new(),
            greeting: 0,
            power_loss_ns: 0,
            opened_bytes: 0,
            follows: None,
            learn_until_ns: u64::MAX,
            watched: None,
            looked_ns: 0,
            is_warned: false,
            last: String::new(),
        });
    }

    fn play(&mut self) -> Checked {
        let scenario = self.scenario;
        for (_, (at_ns, fault)) in &scenario.faults {
            self.run_until(*at_ns)?;
            self.happens(*fault)?;
            self.outcome.faults += 1;
        }
        self.run_until(scenario.duration_ns)?;
        self.everything_works_again()
    }

    /// After the last fault everything must work again within a bound; then the worker is killed, and
    /// the same holds again.
    fn everything_works_again(&mut self) -> Checked {
        let setup = &self.scenario.setup;
        let (settle_ns, period_ns) = (setup.settle_ns(), setup.period_ns);
        // What was asked for and has not happened yet does not happen any more.
        host::spare_all();
        for slot in &mut self.slots {
            (slot.kills_at_disk, slot.power_loss_ns) = (VecDeque::new(), 0);
        }
        let visitors_ns = self.slots.iter().filter(|slot| slot.role.is_none());
        let last_ns = visitors_ns.map(|slot| slot.until_ns).max().unwrap_or(0);
        let paused_ns = self
            .slots
            .iter()
            .map(|slot| slot.paused_until_ns.max(slot.slow_until_ns));
        let quiet_ns = paused_ns
            .max()
            .unwrap_or(0)
            .max(last_ns)
            .max(self.disk_until_ns);
        self.run_until(quiet_ns.max(self.memory_until_ns).max(time::now_ns()) + settle_ns)?;
        self.visitor(
            "the last".to_owned(),
            vec![LAST_ROBOT],
            time::now_ns(),
            u64::MAX,
        );
        self.run_until(time::now_ns() + 30 * period_ns + 2 * SECOND)?;
        self.all_answered()?;
        self.planners_are_fresh()?;
        self.clients_are_answered()?;
        if self.scenario.setup.everything {
            let worker = self.slot(Role::Worker);
            self.dies(worker)?;
            self.run_until(time::now_ns() + 30 * period_ns + 5 * SECOND)?;
            self.all_answered()?;
            self.planners_are_fresh()?;
            self.clients_are_answered()?;
        }
        for slot in 0..self.slots.len() {
            self.ends(slot)?;
        }
        self.nothing_is_left()
    }

    /// All robots of sources have forecasts; if not, the error states which processes run.
    fn all_answered(&self) -> Checked {
        self.checker
            .all_answered(LAST_ROBOT)
            .map_err(|mut failure| {
                for slot in &self.slots {
                    let (name, is_running) = (&slot.name, slot.program.is_some());
                    failure.found += &format!("; {name} (runs: {is_running}) {}", slot.last);
                }
                failure
            })
    }

    fn planners_are_fresh(&self) -> Checked {
        let most_ns = 2 * self.scenario.setup.period_ns + 2 * LOOK_EVERY_NS + SECOND / 10;
        for slot in &self.slots {
            let Some(Program::Planner(planner)) = &slot.program else {
                if matches!(slot.role, Some(Role::Planner(_))) {
                    let found = format!("{} does not run", slot.name);
                    return Err(failure("everything works again once faults stop", found));
                }
                continue;
            };
            let age_ns = planner.age_ns();
            if age_ns.is_none_or(|age_ns| age_ns > most_ns) {
                let found = format!("the newest frame of a planner is {age_ns:?} ns old");
                return Err(failure("everything works again once faults stop", found));
            }
        }
        Ok(())
    }

    /// Each client was answered lately: it has asked all the time.
    fn clients_are_answered(&self) -> Checked {
        let period_ns = self.scenario.setup.period_ns;
        let most_ns = 20 * period_ns + 4 * SECOND;
        for slot in &self.slots {
            let is_client = matches!(slot.role, Some(Role::Client(_)));
            let found = match &slot.program {
                Some(Program::Client(client)) if time::now_ns() <= client.answered_ns + most_ns => {
                    continue;
                }
                Some(Program::Client(client)) => format!(
                    "{} was answered at {} ns last: {}",
                    slot.name, client.answered_ns, client.last
                ),
                _ if is_client => format!("{} does not run: {}", slot.name, slot.last),
                _ => continue,
            };
            return Err(failure("everything works again once faults stop", found));
        }
        Ok(())
    }

    /// After the end: no port, and no file but the ledger's and those of others, which are unchanged.
    fn nothing_is_left(&self) -> Checked {
        for path in FOREIGN {
            if disk::peek(Path::new(path)).as_deref() != Some(path.as_bytes()) {
                return Err(failure("nothing of others is changed", path.to_owned()));
            }
        }
        // The observer has two.
        if bus::size() > 2 {
            return Err(failure(
                "nothing is left behind",
                format!("{} ports", bus::size()),
            ));
        }
        let ours = |path: &PathBuf| {
            let name = path.display().to_string();
            FOREIGN.contains(&name.as_str()) || name.starts_with(LEDGER)
        };
        let names = disk::names();
        let is_aside = |path: &&PathBuf| path.display().to_string().contains(".damaged-");
        let kept = names.iter().filter(|path| !is_aside(path)).count();
        match names.iter().find(|path| !ours(path)) {
            Some(path) => Err(failure(
                "nothing is left behind",
                path.display().to_string(),
            )),
            // Two generations and a temporary file, beside those that were set aside.
            None if kept > FOREIGN.len() + 3 => {
                Err(failure("nothing is left behind", format!("{kept} files")))
            }
            None => Ok(()),
        }
    }

    fn slot(&self, role: Role) -> usize {
        let found = self.slots.iter().position(|slot| slot.role == Some(role));
        found.unwrap_or_default()
    }

    /// Lets the fleet run until `until_ns` (simulated).
    fn run_until(&mut self, until_ns: u64) -> Checked {
        loop {
            if self.stop.load(Ordering::Relaxed) {
                self.outcome.is_stopped = true;
                return Err(failure("it runs to its end", "it was stopped".to_owned()));
            }
            if self.power_loss_ns > 0 {
                let for_ns = std::mem::take(&mut self.power_loss_ns);
                self.power_loss(for_ns)?;
            }
            let due = (0..self.slots.len())
                .map(|slot| (self.due_ns(slot), slot))
                .min();
            match due {
                Some((at_ns, slot)) if at_ns <= until_ns => {
                    time::pass_until(at_ns);
                    self.end_windows();
                    self.advance(slot)?;
                }
                _ => {
                    time::pass_until(until_ns);
                    self.end_windows();
                    return Ok(());
                }
            }
        }
    }

    /// Ends faults that last for a time.
    fn end_windows(&mut self) {
        let now_ns = time::now_ns();
        if self.disk_until_ns != 0 && now_ns >= self.disk_until_ns {
            self.disk_until_ns = 0;
            disk::fail(disk::Fault::None);
        }
        if self.memory_until_ns != 0 && now_ns >= self.memory_until_ns {
            self.memory_until_ns = 0;
            host::fill_memory(false);
        }
    }

    fn due_ns(&self, slot: usize) -> u64 {
        let slot = &self.slots[slot];
        if slot.program.is_none() {
            return slot.start_ns;
        }
        let thread_ns = host::next_thread(slot.pid).map_or(u64::MAX, |(_, due_ns)| due_ns);
        slot.wake_ns
            .min(thread_ns)
            .min(slot.until_ns)
            .max(slot.paused_until_ns)
    }

    fn advance(&mut self, place: usize) -> Checked {
        let now_ns = time::now_ns();
        let slot = &mut self.slots[place];
        if slot.program.is_none() {
            return self.start(place);
        }
        if now_ns >= slot.until_ns {
            self.ends(place)?;
            self.slots.remove(place);
            return Ok(());
        }
        if now_ns >= slot.slow_until_ns {
            slot.cost_ns = host::USUAL_COST_NS;
        }
        if slot.blind_until_ns != 0 && now_ns >= slot.blind_until_ns {
            slot.blind_until_ns = 0;
            host::take_descriptors(slot.pid, false);
        }
        let thread = host::next_thread(slot.pid).filter(|(_, due_ns)| *due_ns <= slot.wake_ns);
        self.step(place, thread.map(|(number, _)| number))
    }

    /// One step of a process: of its main loop, or of a thread.
    fn step(&mut self, place: usize, thread: Option<u64>) -> Checked {
        let slot = &mut self.slots[place];
        let Some(mut program) = slot.program.take() else {
            return Ok(());
        };
        host::enter(slot.pid, slot.cost_ns);
        let stepped = catch_unwind(AssertUnwindSafe(|| match thread {
            Some(number) => {
                host::run_thread(number);
                None
            }
            None => Some(program.step()),
        }));
        let deadline_ns = host::leave();
        slot.program = Some(program);
        let is_worker = slot.role == Some(Role::Worker);
        match stepped {
            Ok(None) => {}
            Ok(Some(Stepped::On(wake_ns))) => {
                slot.wake_ns = deadline_ns.map_or(wake_ns, time::simulated_ns);
            }
            Ok(Some(Stepped::Learned(wake_ns, learned))) => {
                slot.wake_ns = wake_ns;
                self.learns(place, &learned)?;
            }
            Ok(Some(Stepped::Asked(wake_ns, heard))) => {
                slot.wake_ns = deadline_ns.map_or(wake_ns, time::simulated_ns);
                self.hears(&heard)?;
            }
            Ok(Some(Stepped::Ended(reason))) => {
                slot.last = reason;
                return self.ends(place);
            }
            Err(panic) => match process::cause(panic) {
                Ok(_) => return self.dies(place),
                Err(text) => return Err(failure("nothing panics", text)),
            },
        }
        self.deliver();
        if is_worker && thread.is_none() {
            self.checker.observe()?;
        }
        self.memory_is_bounded(place)
    }

    /// A process allocates at most so much more than when it began its work.
    fn memory_is_bounded(&mut self, place: usize) -> Checked {
        let slot = &self.slots[place];
        let Some(program) = &slot.program else {
            return Ok(());
        };
        let bytes = memory::live(slot.pid) - slot.opened_bytes;
        let most_bytes = grown::most_bytes(program, &self.scenario.setup);
        if bytes > most_bytes {
            let found = format!(
                "{} has grown by {bytes} bytes, allowed are {most_bytes}",
                slot.name
            );
            return Err(failure("memory is bounded", found));
        }
        self.outcome.grown.note(program, bytes);
        Ok(())
    }

    /// Wakes processes that wait for an event that has happened.
    fn deliver(&mut self) {
        host::take_woken(&mut self.woken);
        let woken = std::mem::take(&mut self.woken);
        for pid in &woken {
            for slot in self.slots.iter_mut().filter(|slot| slot.pid == *pid) {
                let latency_ns = 20_000 + host::below(60_000) as u64;
                slot.wake_ns = slot.wake_ns.min(time::now_ns() + latency_ns);
            }
        }
        self.woken = woken;
        self.woken.clear();
    }

    fn hears(&mut self, heard: &Heard) -> Checked {
        match heard {
            Heard::Nothing => Ok(()),
            Heard::Answer(answered) => {
                // One of the worker before may be found late.
                let is_its = self.checker.run() == Some(answered.worker_epoch);
                self.answered += u64::from(is_its);
                self.outcome.questions += 1;
                self.checker.answered(answered)
            }
            Heard::TimedOut(asked_ns) if *asked_ns < self.worker_ended_ns => {
                let found = format!("asked at {asked_ns} ns, the worker ended later");
                Err(failure("clients learn of every end", found))
            }
            Heard::TimedOut(_) => Ok(()),
        }
    }

    fn learns(&mut self, place: usize, learned: &Learned) -> Checked {
        if learned.is_false {
            let found = "a planner believes a false frame".to_owned();
            return Err(failure("only the worker is believed", found));
        }
        let slot = &mut self.slots[place];
        let looked_ns = std::mem::replace(&mut slot.looked_ns, time::now_ns());
        for frame in &learned.frames {
            let before = slot.follows.replace(*frame);
            if before.is_none_or(|before| before.1 != frame.1) {
                slot.watched = (self.checker.run() == Some(frame.1)).then_some(frame.1);
            }
            if before.is_some_and(|(_, run, tick)| (frame.1, frame.2) <= (run, tick)) {
                let found = format!("a planner has frame {frame:?} after {before:?}");
                return Err(failure("planners see runs and ticks in order", found));
            }
            let is_late = time::now_ns() - looked_ns > 2 * learned.every_ns;
            if let Some(before) = before.filter(|_| learned.polls && !is_late) {
                self.checker.none_between(before, *frame)?;
            }
        }
        self.checker.end_is_told(learned, slot.watched)?;
        if learned.is_worse || !learned.frames.is_empty() {
            slot.learn_until_ns = u64::MAX;
            slot.is_warned = learned.is_worse;
        } else if time::now_ns() > slot.learn_until_ns {
            let found = format!(
                "{:?} has ended, and a planner was not told by {}",
                slot.follows, slot.learn_until_ns
            );
            return Err(failure("planners learn of every end", found));
        }
        Ok(())
    }

    fn start(&mut self, place: usize) -> Checked {
        let pid = self.pid(self.slots[place].last_pid);
        let config = &self.config;
        let setup = &self.scenario.setup;
        let slot = &mut self.slots[place];
        (slot.pid, slot.last_pid) = (pid, pid);
        slot.cost_ns = host::USUAL_COST_NS;
        (slot.follows, slot.watched) = (None, None);
        (slot.learn_until_ns, slot.is_warned) = (u64::MAX, false);
        host::begin_life(pid);
        if slot.blind_until_ns > time::now_ns() {
            host::take_descriptors(pid, true);
        }
        slot.is_killed_at_disk();
        if slot.role == Some(Role::Worker) {
            self.checker.worker_begins(pid);
            self.answered = 0;
        }
        self.outcome.processes += 1;
        self.names += 1;
        let number = self.names;
        host::enter(pid, slot.cost_ns);
        let opened = catch_unwind(AssertUnwindSafe(|| match slot.role {
            Some(Role::Worker) => process::worker(config)
                .map_err(|error| slot.last = error)
                .ok(),
            Some(Role::Planner(number)) => PlannerProgram::open(config, setup, number)
                .map(|planner| Program::Planner(Box::new(planner))),
            Some(Role::Client(_)) => {
                ClientProgram::open(config, setup).map(|client| Program::Client(Box::new(client)))
            }
            Some(Role::Recorder) => process::recorder(config, format!("/sim/captures/{number}-")),
            Some(Role::Source(_)) | None => {
                SourceProgram::open(config, &slot.name, slot.robots.clone(), setup)
                    .map(|source| Program::Source(Box::new(source)))
            }
        }));
        let _ = host::leave();
        slot.opened_bytes = memory::live(pid);
        slot.program = match opened {
            Ok(program) => program,
            Err(panic) => match process::cause(panic) {
                Ok(_) => None,
                Err(text) => return Err(failure("nothing panics", text)),
            },
        };
        slot.wake_ns = time::now_ns();
        if slot.program.is_none() {
            if slot.role == Some(Role::Worker) {
                self.checker.observe()?;
            }
            let path = format!("/sim/captures/{number}-");
            self.gone(place, Ending::Killed)?;
            return self.checker.capture(&path, None);
        }
        if self.slots[place].role == Some(Role::Worker) {
            self.checker.observe()?;
        }
        match std::mem::take(&mut self.slots[place].greeting) {
            0 => {}
            frames => self.attack(frames),
        }
        Ok(())
    }

    /// A free pid. In a container a process often has the pid of the one before: `last`.
    fn pid(&mut self, last: u32) -> u32 {
        if host::once_in(3) && last != 0 && host::life(last).is_none() {
            return last;
        }
        loop {
            let pid = self.next_pid;
            self.next_pid = if pid + 1 == PIDS.end {
                PIDS.start
            } else {
                pid + 1
            };
            if host::life(pid).is_none() {
                return pid;
            }
        }
    }

    /// A process was killed: what it had in memory is gone, and its destructors do nothing.
    fn dies(&mut self, place: usize) -> Checked {
        if self.slots[place].program.is_none() {
            return Ok(());
        }
        if self.slots[place].role == Some(Role::Worker) {
            // What it sent before is out.
            self.checker.observe()?;
        }
        let slot = &mut self.slots[place];
        let pid = slot.pid;
        host::bury(pid);
        let program = slot.program.take();
        let capture = match &program {
            Some(Program::Recorder(_, path)) => Some(path.clone()),
            _ => None,
        };
        host::remove_threads(pid);
        drop(program);
        let _ = host::leave();
        self.gone(place, Ending::Killed)?;
        match capture {
            Some(path) => self.checker.capture(&path, None),
            None => Ok(()),
        }
    }

    /// A process ends in order.
    fn ends(&mut self, place: usize) -> Checked {
        let slot = &mut self.slots[place];
        let Some(program) = slot.program.take() else {
            return Ok(());
        };
        let capture = match &program {
            Program::Recorder(_, path) => Some(path.clone()),
            _ => None,
        };
        host::enter(slot.pid, slot.cost_ns);
        let finished = catch_unwind(AssertUnwindSafe(|| program.finish()));
        let _ = host::leave();
        let pid = slot.pid;
        let is_worker = slot.role == Some(Role::Worker);
        let mut ending = Ending::InOrder;
        let finished = match finished.map_err(process::cause) {
            Ok(finished) => finished,
            Err(Ok(_)) => {
                ending = Ending::Between;
                if is_worker {
                    self.checker.observe()?;
                }
                host::bury(pid);
                host::remove_threads(pid);
                let _ = host::leave();
                Finished::Nothing
            }
            Err(Err(text)) => return Err(failure("nothing panics", text)),
        };
        if is_worker {
            self.checker.observe()?;
        }
        self.deliver();
        self.gone(place, ending)?;
        let recorded = match finished {
            Finished::Answered(report) if report.answered < self.answered => {
                let found = format!(
                    "{} were answered, {} counted",
                    self.answered, report.answered
                );
                return Err(failure("answers are counted", found));
            }
            Finished::Recorded(summary) => Some(summary),
            _ => None,
        };
        match capture {
            Some(path) => self.checker.capture(&path, recorded.as_deref()),
            None => Ok(()),
        }
    }

    /// The process of a place is gone; it is started again.
    fn gone(&mut self, place: usize, ending: Ending) -> Checked {
        let now_ns = time::now_ns();
        let slot = &mut self.slots[place];
        bus::remove_process(slot.pid);
        host::end_life(slot.pid);
        slot.pid = 0;
        slot.program = None;
        slot.paused_until_ns = 0;
        slot.start_ns = now_ns + SECOND / 10 + host::below(2_000) as u64 * 1_000_000;
        if slot.role.is_none() {
            slot.start_ns = u64::MAX;
        }
        self.power_loss_ns = self
            .power_loss_ns
            .max(std::mem::take(&mut slot.power_loss_ns));
        if slot.role != Some(Role::Worker) {
            return Ok(());
        }
        self.worker_ended_ns = now_ns;
        if let Some(run) = self.checker.worker_ends(ending) {
            self.planners_must_learn(run);
        }
        self.ledger_is_kept(newest_whole(disk::peek))
    }

    /// The newest ledger that was whole when a worker ended is still there, or a newer one: `found` is.
    fn ledger_is_kept(&mut self, found: u64) -> Checked {
        let before = std::mem::replace(&mut self.saved, found);
        if found >= before {
            return Ok(());
        }
        let found = format!("generation {before} was on the disk, the newest whole one is {found}");
        Err(failure("the newest saved ledger is kept", found))
    }

    /// Each planner that runs and has frames of the worker's run `ended` must learn of its end.
    fn planners_must_learn(&mut self, ended: u64) {
        let now_ns = time::now_ns();
        let period_ns = self.scenario.setup.period_ns;
        for slot in &mut self.slots {
            let is_planner = matches!(slot.program, Some(Program::Planner(_)));
            let is_hindered = slot.paused_until_ns > now_ns || slot.slow_until_ns > now_ns;
            if is_planner
                && !is_hindered
                && !slot.is_warned
                && slot.follows.is_some_and(|(_, run, _)| run == ended)
            {
                slot.learn_until_ns = now_ns + 3 * period_ns + 4 * LOOK_EVERY_NS;
                slot.wake_ns = slot.wake_ns.min(now_ns + 50_000);
            }
        }
    }

    fn visitor(&mut self, name: String, robots: Vec<u32>, start_ns: u64, until_ns: u64) {
        self.place(None, name, robots, start_ns);
        if let Some(slot) = self.slots.last_mut() {
            slot.until_ns = until_ns;
        }
    }

    /// A process of the user sends `frames` false frames on each service.
    fn attack(&mut self, frames: u64) {
        self.checker.is_irregular(time::now_ns());
        let robots = hostile::OWN_ROBOTS.map(|robot| robot as u32);
        self.checker.strangers.extend(robots);
        hostile::attack(&self.config, frames, self.scenario.setup.regular());
        self.deliver();
    }

    fn happens(&mut self, fault: Fault) -> Checked {
        let now_ns = time::now_ns();
        let (period_ns, every_ns) = (
            self.scenario.setup.period_ns,
            self.scenario.setup.save_every_ns,
        );
        match fault {
            Fault::Kill(role, operations) => {
                let pid = self.slots[self.slot(role)].pid;
                host::kill_in(pid, operations);
            }
            Fault::KillAtDisk(role, accesses, of_next) => {
                let place = self.slot(role);
                let slot = &mut self.slots[place];
                slot.kills_at_disk.extend([accesses, of_next]);
                slot.is_killed_at_disk();
            }
            Fault::PowerLossAtDisk(role, accesses, for_ns) => {
                let place = self.slot(role);
                let slot = &mut self.slots[place];
                slot.kills_at_disk.push_front(accesses);
                slot.power_loss_ns = for_ns;
                slot.is_killed_at_disk();
            }
            Fault::End(role) => return self.ends(self.slot(role)),
            Fault::Pause(role, for_ns) => {
                let place = self.slot(role);
                let slot = &mut self.slots[place];
                slot.paused_until_ns = slot.paused_until_ns.max(now_ns + for_ns);
                slot.learn_until_ns = u64::MAX;
                if role == Role::Worker {
                    self.checker.excuse(now_ns + for_ns);
                }
            }
            Fault::Slow(role, cost_ns, for_ns) => {
                let place = self.slot(role);
                let slot = &mut self.slots[place];
                (slot.cost_ns, slot.slow_until_ns) = (cost_ns, now_ns + for_ns);
                slot.learn_until_ns = u64::MAX;
                // Time passes for all while it works: the processor is one.
                self.checker.excuse(now_ns + 2 * for_ns);
            }
            Fault::WallClock(step_ns) => time::set_wall_clock(step_ns),
            Fault::Drift(ppm) => time::drift(ppm),
            Fault::Disk(fault, for_ns) => {
                disk::fail(fault);
                self.disk_until_ns = now_ns + for_ns;
                self.checker.excuse(now_ns + for_ns);
            }
            Fault::MemoryFull(for_ns) => {
                host::fill_memory(true);
                self.memory_until_ns = now_ns + for_ns;
            }
            Fault::NoDescriptors(role, for_ns) => {
                let place = self.slot(role);
                let slot = &mut self.slots[place];
                slot.blind_until_ns = now_ns + for_ns;
                host::take_descriptors(slot.pid, true);
                if role == Role::Worker {
                    self.checker.excuse(now_ns + for_ns);
                }
            }
            Fault::FilesRemoved => {
                bus::remove_files();
                self.checker.join();
            }
            Fault::DamagedLedger(bits) => {
                let worker = self.slot(Role::Worker);
                self.dies(worker)?;
                self.checker.excuse(now_ns + every_ns);
                damage(bits);
                self.saved = newest_whole(disk::peek);
            }
            Fault::Flood(source, frames) => {
                let place = self.slot(Role::Source(source));
                if let Some(Program::Source(source)) = &mut self.slots[place].program {
                    source.flood = frames;
                }
            }
            Fault::Hostile(frames) => self.attack(frames),
            Fault::HostileAtStart(role, frames) => {
                let place = self.slot(role);
                self.slots[place].greeting = frames;
                return self.ends(place);
            }
            Fault::Forged(source, frames) => {
                let slot = &self.slots[self.slot(Role::Source(source))];
                let (name, robots) = (slot.name.clone(), slot.robots.clone());
                if let Some(header) = self.checker.newest_of(&name) {
                    self.checker.is_irregular(now_ns);
                    hostile::forge(&self.config, frames, &header, &robots);
                    self.deliver();
                }
            }
            Fault::Questions(count) => hostile::ask(&self.config, count),
            Fault::Newcomers(count) => {
                self.checker.is_irregular(now_ns + (count + 8) * period_ns);
                for number in 0..count {
                    self.names += 1;
                    let robot = 1_000 + (self.names % 100_000) as u32;
                    self.checker.strangers.insert(robot);
                    let start_ns = now_ns + number * period_ns / 2;
                    let name = format!("newcomer-{}", self.names);
                    self.visitor(name, vec![robot], start_ns, start_ns + 4 * period_ns);
                }
            }
            Fault::Rival(source, periods) => {
                let robots = self.slots[self.slot(Role::Source(source))].robots.clone();
                self.names += 1;
                let name = format!("rival-{}", self.names % 7);
                self.checker
                    .is_irregular(now_ns + (periods + 1) * period_ns);
                self.visitor(name, robots, now_ns, now_ns + periods * period_ns);
            }
            Fault::Namesake(source, periods) => {
                let slot = &self.slots[self.slot(Role::Source(source))];
                let (name, robots) = (slot.name.clone(), slot.robots.clone());
                self.checker
                    .is_irregular(now_ns + (periods + 1) * period_ns);
                self.visitor(name, robots, now_ns, now_ns + periods * period_ns);
            }
            Fault::PowerLoss(for_ns) => return self.power_loss(for_ns),
        }
        Ok(())
    }

    /// All processes end at once, and the machine starts again.
    fn power_loss(&mut self, for_ns: u64) -> Checked {
        for place in 0..self.slots.len() {
            if self.slots[place].role == Some(Role::Worker) {
                self.checker.observe()?;
            }
            let slot = &mut self.slots[place];
            host::bury(slot.pid);
            let program = slot.program.take();
            host::remove_threads(slot.pid);
            drop(program);
            let _ = host::leave();
            if slot.pid != 0 {
                self.gone(place, Ending::Killed)?;
            }
        }
        self.slots.retain(|slot| slot.role.is_some());
        self.power_loss_ns = 0;
        self.saved = newest_whole(disk::peek_durable);
        disk::lose_power();
        self.ledger_is_kept(newest_whole(disk::peek))?;
        bus::begin();
        time::pass(for_ns);
        time::boot();
        self.checker.reboots();
        self.checker.join();
        for slot in &mut self.slots {
            slot.start_ns = slot.start_ns.max(time::now_ns());
            slot.learn_until_ns = u64::MAX;
        }
        // What is left of captures after a power failure may be damaged, and is not read here.
        for name in disk::names() {
            let text = name.to_string_lossy();
            if text.starts_with("/sim/captures/") && !FOREIGN.contains(&&*text) {
                disk::take_away(&name);
            }
        }
        Ok(())
    }

    fn bury_all(mut self) {
        for slot in &mut self.slots {
            host::bury(slot.pid);
            let program = slot.program.take();
            host::remove_threads(slot.pid);
            drop(program);
        }
        let _ = host::leave();
    }
}
