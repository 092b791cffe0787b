//! One host of several: its processes, and what an observer on it sees.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use joulebus_config::Config;
use joulebus_wire::{Forecasts, Row as _, Sample, SampleHeader};
use simulated_bus::{self as bus, Bus, Reader, SampleReader};
use simulated_host::{self as host, disk, time};
use simulated_link::{self as link, Link, LinkFile, Packet};
use simulated_worker::Worker;

use super::fault::{BASES, Fault, Part, SECOND};
use crate::check::{Checked, failure};
use crate::process::{self, PlannerProgram, SourceProgram, Stepped, power_w};
use crate::scenario::Setup;

/// Pid of the observer, which is never killed.
const OBSERVER: u32 = 7;
/// Pids of processes that come and go.
const PIDS: std::ops::Range<u32> = 100..160;

/// A frame that the observer of a host has read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Seen {
    /// When, simulated ns.
    pub at_ns: u64,
    pub run: u64,
    pub tick: u64,
    pub robots: usize,
    /// A hash of its rows, without times.
    pub digest: u64,
    /// Samples that its worker has accepted or dropped.
    pub known: u64,
}

/// Events of a host since the last report.
#[derive(Debug, Default)]
pub(super) struct Report {
    /// When the next step is due, simulated ns.
    pub due_ns: u64,
    pub sent: Vec<Packet>,
    pub frames: Vec<Seen>,
    pub samples: u64,
    /// Samples that the source of the newest frame has published, the newest one included.
    pub published: Option<u64>,
    /// Frames that the planner was given.
    pub learned: u64,
    pub processes: u64,
    /// Links that have ended.
    pub links_ended: u64,
}

enum Program {
    Worker(Box<Worker>),
    Source(Box<SourceProgram>),
    Planner(Box<PlannerProgram>),
    Link(Box<Link>),
}

struct Slot {
    part: Part,
    program: Option<Program>,
    pid: u32,
    wake_ns: u64,
    start_ns: u64,
    paused_until_ns: u64,
    /// A worker that serves.
    serves: bool,
}

struct Observer {
    samples: SampleReader,
    forecasts: Reader<Forecasts>,
    _bus: Bus,
}

/// The state of the worker as a planner knows it.
#[derive(Default)]
struct Received {
    /// Its newest frame: the process, run and tick of its worker.
    newest: Option<(u32, u64, u64)>,
    /// When it came, or the planner could first look since, monotonic ns.
    since_ns: u64,
    is_warned: bool,
}

pub(super) struct Machine {
    config: Config,
    file: LinkFile,
    setup: Setup,
    slots: Vec<Slot>,
    /// By the time of arrival, and a number.
    incoming: BTreeMap<(u64, u64), Packet>,
    arrivals: u64,
    observer: Option<Observer>,
    /// Number of the last frame of each run of a source.
    sources: BTreeMap<(u64, u64), u64>,
    received: Received,
    next_pid: u32,
    report: Report,
    disk_until_ns: u64,
    memory_until_ns: u64,
}

impl Machine {
    pub(super) fn new(
        (seed, uptime_ns): (u64, u64),
        setup: &Setup,
        (config, file): (Config, LinkFile),
        parts: &[Part],
    ) -> Self {
        host::begin(seed, uptime_ns);
        bus::begin();
        let slot = |part: &Part| Slot {
            part: *part,
            program: None,
            pid: 0,
            wake_ns: 0,
            start_ns: SECOND / 10 + host::below(1_000) as u64 * 1_000_000,
            paused_until_ns: 0,
            serves: false,
        };
        Self {
            config,
            file,
            setup: setup.clone(),
            slots: parts.iter().map(slot).collect(),
            incoming: BTreeMap::new(),
            arrivals: 0,
            observer: None,
            sources: BTreeMap::new(),
            received: Received::default(),
            next_pid: PIDS.start,
            report: Report::default(),
            disk_until_ns: 0,
            memory_until_ns: 0,
        }
    }

    pub(super) fn due_ns(&self) -> u64 {
        let slots = self.slots.iter().map(|slot| slot.due_ns());
        let arrival = self.incoming.keys().next().map(|(at_ns, _)| *at_ns);
        slots.chain(arrival).min().unwrap_or(u64::MAX).max(time::now_ns())
    }

    /// Runs until `until_ns` (simulated), with these messages on their way.
    pub(super) fn run_until(
        &mut self,
        until_ns: u64,
        arrivals: Vec<(u64, Packet)>,
    ) -> Checked<Report> {
        for (at_ns, packet) in arrivals {
            self.arrivals += 1;
            self.incoming.insert((at_ns, self.arrivals), packet);
        }
        while self.due_ns() < until_ns {
            time::pass_until(self.due_ns());
            self.end_windows();
            let now_ns = time::now_ns();
            while let Some(first) = self.incoming.first_entry()
                && first.key().0 <= now_ns
            {
                link::deliver(&first.remove());
            }
            self.deliver();
            let due = (0..self.slots.len()).min_by_key(|at| self.slots[*at].due_ns());
            if let Some(at) = due.filter(|at| self.slots[*at].due_ns() <= now_ns) {
                self.advance(at)?;
                self.observe()?;
            }
        }
        self.report.due_ns = self.due_ns();
        self.report.sent = link::take_sent();
        Ok(std::mem::take(&mut self.report))
    }

    fn end_windows(&mut self) {
        let now_ns = time::now_ns();
        if now_ns >= self.disk_until_ns {
            self.disk_until_ns = u64::MAX;
            disk::fail(disk::Fault::None);
        }
        if now_ns >= self.memory_until_ns {
            self.memory_until_ns = u64::MAX;
            host::fill_memory(false);
        }
    }

    /// Wakes processes that wait for an event that has happened.
    fn deliver(&mut self) {
        let mut woken = Vec::new();
        host::take_woken(&mut woken);
        for slot in self.slots.iter_mut().filter(|slot| woken.contains(&slot.pid)) {
            slot.wake_ns = slot.wake_ns.min(time::now_ns() + 20_000);
        }
    }

    fn advance(&mut self, at: usize) -> Checked {
        let slot = &mut self.slots[at];
        let Some(mut program) = slot.program.take() else {
            return self.start(at);
        };
        let thread = host::next_thread(slot.pid).filter(|(_, due_ns)| *due_ns <= slot.wake_ns);
        host::enter(slot.pid, host::USUAL_COST_NS);
        let stepped = catch_unwind(AssertUnwindSafe(|| match thread {
            Some((number, _)) => {
                host::run_thread(number);
                match &program {
                    Program::Link(link) if link.has_ended() => Some(Stepped::Ended(String::new())),
                    _ => None,
                }
            }
            None => Some(program.step(&mut slot.serves)),
        }));
        let deadline_ns = host::leave();
        slot.program = Some(program);
        match stepped {
            Ok(None) => {}
            Ok(Some(
                Stepped::On(wake_ns) | Stepped::Asked(wake_ns, _) | Stepped::Shown(wake_ns, _),
            )) => {
                slot.wake_ns = deadline_ns.map_or(wake_ns, time::simulated_ns);
            }
            Ok(Some(Stepped::Learned(wake_ns, learned))) => {
                slot.wake_ns = wake_ns;
                let age_ns = match &slot.program {
                    Some(Program::Planner(planner)) => planner.age_ns(),
                    _ => None,
                };
                self.learns(&learned, age_ns)?;
            }
            Ok(Some(Stepped::Ended(_))) => self.ends(at)?,
            Err(panic) => match process::cause(panic) {
                Ok(_) => self.dies(at),
                Err(text) => return Err(failure("nothing panics", text)),
            },
        }
        self.deliver();
        Ok(())
    }

    /// Frames come in order, and a planner that has none for some periods knows it.
    fn learns(&mut self, learned: &process::Learned, age_ns: Option<u64>) -> Checked {
        self.report.learned += learned.frames.len() as u64;
        let (received, now_ns) = (&mut self.received, time::monotonic_ns());
        for frame in &learned.frames {
            let before = received.newest.replace(*frame);
            if before.is_some_and(|before| {
                before.0 == frame.0 && (frame.1, frame.2) <= (before.1, before.2)
            }) {
                let found = format!("a planner has frame {frame:?} after {before:?}");
                return Err(failure("planners see runs and ticks in order", found));
            }
            (received.since_ns, received.is_warned) = (now_ns, false);
        }
        received.is_warned |= learned.is_worse;
        // Stale after two periods, and somewhat later.
        let bound_ns = 2 * self.setup.period_ns + 2 * learned.every_ns + SECOND / 5;
        let silent_ns = now_ns.saturating_sub(received.since_ns);
        if received.newest.is_some() && !received.is_warned && silent_ns > bound_ns {
            let found = format!(
                "nothing for {silent_ns} ns, the newest frame is {age_ns:?} ns old, allowed are \
                 {bound_ns}"
            );
            return Err(failure("silence is told within its bound", found));
        }
        Ok(())
    }

    fn start(&mut self, at: usize) -> Checked {
        let pid = loop {
            let pid = self.next_pid;
            self.next_pid = if pid + 1 == PIDS.end { PIDS.start } else { pid + 1 };
            if host::life(pid).is_none() {
                break pid;
            }
        };
        let (config, setup, file) = (&self.config, &self.setup, &self.file);
        let slot = &mut self.slots[at];
        (slot.pid, slot.serves) = (pid, false);
        self.report.processes += 1;
        host::begin_life(pid);
        host::enter(pid, host::USUAL_COST_NS);
        let opened = catch_unwind(AssertUnwindSafe(|| match slot.part {
            Part::Worker => Worker::open_standby(config).ok().map(Box::new).map(Program::Worker),
            Part::Source => {
                let robots = (0..setup.robots as u32).collect();
                let source = SourceProgram::open(config, "controller", robots, setup);
                source.map(Box::new).map(Program::Source)
            }
            Part::Planner => {
                let planner = PlannerProgram::open(config, setup, 1);
                planner.map(Box::new).map(Program::Planner)
            }
            Part::Link => Link::start(config, file).ok().map(Box::new).map(Program::Link),
        }));
        let _ = host::leave();
        slot.wake_ns = time::now_ns();
        slot.program = match opened {
            Ok(program) => program,
            Err(panic) => match process::cause(panic) {
                Ok(_) => None,
                Err(text) => return Err(failure("nothing panics", text)),
            },
        };
        match slot.program {
            Some(Program::Planner(_)) => self.received = Received::default(),
            Some(_) => {}
            None => {
                host::bury(pid);
                host::remove_threads(pid);
                let _ = host::leave();
                self.gone(at);
            }
        }
        Ok(())
    }

    /// A process was killed: its destructors do nothing.
    fn dies(&mut self, at: usize) {
        let slot = &mut self.slots[at];
        host::bury(slot.pid);
        let program = slot.program.take();
        host::remove_threads(slot.pid);
        drop(program);
        let _ = host::leave();
        self.gone(at);
    }

    fn ends(&mut self, at: usize) -> Checked {
        let slot = &mut self.slots[at];
        let Some(program) = slot.program.take() else {
            return Ok(());
        };
        host::enter(slot.pid, host::USUAL_COST_NS);
        let finished = catch_unwind(AssertUnwindSafe(|| program.finish()));
        let _ = host::leave();
        if let Err(panic) = finished {
            if let Err(text) = process::cause(panic) {
                return Err(failure("nothing panics", text));
            }
            host::bury(slot.pid);
            host::remove_threads(slot.pid);
            let _ = host::leave();
        }
        self.gone(at);
        Ok(())
    }

    fn gone(&mut self, at: usize) {
        let slot = &mut self.slots[at];
        bus::remove_process(slot.pid);
        host::end_life(slot.pid);
        (slot.pid, slot.program, slot.paused_until_ns) = (0, None, 0);
        slot.start_ns = time::now_ns() + SECOND / 10 + host::below(1_000) as u64 * 1_000_000;
        self.report.links_ended += u64::from(slot.part == Part::Link);
    }

    /// The observer reads what has come, without taking time.
    fn observe(&mut self) -> Checked {
        host::enter(OBSERVER, 0);
        let seen = self.look();
        let _ = host::leave();
        seen
    }

    fn look(&mut self) -> Checked {
        if self.observer.is_none() {
            let limits = self.config.limits();
            let domain = self.config.domain().map_err(|error| error.to_string());
            let opened = domain.and_then(|domain| {
                let bus = Bus::join(&domain, "observer").map_err(|error| error.to_string())?;
                Ok::<_, String>(Observer {
                    samples: bus.sample_reader(&limits).map_err(|error| error.to_string())?,
                    forecasts: bus.reader(&limits).map_err(|error| error.to_string())?,
                    _bus: bus,
                })
            });
            self.observer = opened.ok();
        }
        let Some(observer) = &mut self.observer else {
            return Ok(());
        };
        let mut samples = Vec::with_capacity(64);
        while let Ok(Some(mut frame)) = observer.samples.next(64) {
            let header = *frame.header();
            samples.clear();
            let samples = frame.copy_part(&mut samples).unwrap_or_default();
            self.report.samples += samples.len() as u64;
            self.report.published = Some(header.samples_before + samples.len() as u64);
            let run = (header.source_id, header.source_epoch);
            let before = self.sources.insert(run, header.frame_seq);
            if before.is_some_and(|before| before >= header.frame_seq) {
                let found = format!("{header:?} after frame {before:?}");
                return Err(failure("samples come once and in order", found));
            }
            right(&header, samples)?;
        }
        let frames = &mut self.report.frames;
        let _ = observer.forecasts.take_all(|header, rows| {
            let mut hasher = DefaultHasher::new();
            for row in rows {
                let mut row = *row;
                row.instants(|stamp_ns| *stamp_ns = 0);
                bytemuck::bytes_of(&row).hash(&mut hasher);
            }
            frames.push(Seen {
                at_ns: time::now_ns(),
                run: header.worker_epoch,
                tick: header.tick,
                robots: rows.len(),
                digest: hasher.finish(),
                known: header.samples_accepted + header.samples_dropped.total(),
            });
        });
        Ok(())
    }

    fn slot(&self, part: Part) -> Option<usize> {
        self.slots.iter().position(|slot| slot.part == part && slot.program.is_some())
    }

    /// A fault of this host.
    pub(super) fn happens(&mut self, fault: Fault) -> Checked {
        let now_ns = time::now_ns();
        match fault {
            Fault::Kill(part, operations) => {
                if let Some(at) = self.slot(part) {
                    host::kill_in(self.slots[at].pid, operations);
                }
            }
            Fault::KillAtDisk(part, accesses) => {
                if let Some(at) = self.slot(part) {
                    host::kill_at_disk(self.slots[at].pid, accesses);
                }
            }
            Fault::End(part) => {
                if let Some(at) = self.slot(part) {
                    self.ends(at)?;
                }
            }
            Fault::Pause(part, ns) => {
                if let Some(at) = self.slot(part) {
                    self.slots[at].paused_until_ns = now_ns + ns;
                    if part == Part::Planner {
                        self.received = Received::default();
                    }
                }
            }
            Fault::Suspend(ns) => time::sleep(ns),
            Fault::Jump(ns) => {
                time::pass(ns);
                self.received = Received::default();
            }
            Fault::StandStill(ns) => {
                time::stand_still(ns);
                self.received = Received::default();
            }
            Fault::WallClock(ns) => time::set_wall_clock(ns),
            Fault::Drift(ppm) => time::drift(ppm),
            Fault::Disk(fault, ns) => {
                disk::fail(fault);
                self.disk_until_ns = now_ns + ns;
            }
            Fault::MemoryFull(ns) => {
                host::fill_memory(true);
                self.memory_until_ns = now_ns + ns;
            }
            Fault::PowerLoss(ns) => self.power_loss(ns),
            Fault::Cut(..) | Fault::Store(..) | Fault::Weather(..) => {}
        }
        Ok(())
    }

    fn power_loss(&mut self, ns: u64) {
        for at in 0..self.slots.len() {
            if self.slots[at].program.is_some() {
                self.dies(at);
            }
        }
        self.observer = None;
        self.sources.clear();
        disk::lose_power();
        for path in disk::names().iter().filter(|path| path.starts_with("/dev/shm")) {
            disk::take_away(path);
        }
        bus::begin();
        time::pass(ns);
        time::boot();
        // No two boots begin the same: the runs of sources are numbered by the time since.
        for slot in &mut self.slots {
            slot.start_ns = time::now_ns() + SECOND / 10 + host::below(1_000_000) as u64 * 1_000;
        }
    }

    /// Nothing of this host is to happen any more; its processes go on.
    pub(super) fn spare(&mut self) {
        host::spare_all();
        (self.disk_until_ns, self.memory_until_ns) = (0, 0);
        self.slots.iter_mut().for_each(|slot| slot.paused_until_ns = 0);
    }

    pub(super) fn bury_all(&mut self) {
        self.observer = None;
        for at in 0..self.slots.len() {
            if self.slots[at].program.is_some() {
                self.dies(at);
            }
        }
    }
}

impl Slot {
    fn due_ns(&self) -> u64 {
        if self.program.is_none() {
            return self.start_ns;
        }
        let thread_ns = host::next_thread(self.pid).map_or(u64::MAX, |(_, due_ns)| due_ns);
        self.wake_ns.min(thread_ns).max(self.paused_until_ns)
    }
}

impl Program {
    fn step(&mut self, serves: &mut bool) -> Stepped {
        match self {
            Self::Worker(worker) => {
                let turned = match *serves {
                    true => worker.poll().map(|_| true),
                    false => worker.stand_by_once(),
                };
                match turned {
                    Ok(is_serving) => *serves = is_serving,
                    Err(error) => return Stepped::Ended(error.to_string()),
                }
                Stepped::On(time::now_ns())
            }
            Self::Source(source) => source.step(),
            Self::Planner(planner) => planner.step(),
            Self::Link(link) if link.has_ended() => Stepped::Ended(String::new()),
            Self::Link(_) => Stepped::On(time::now_ns() + SECOND),
        }
    }

    fn finish(self) {
        match self {
            Self::Worker(worker) => drop(worker.finish()),
            Self::Link(link) => drop(link.finish()),
            Self::Source(_) | Self::Planner(_) => {}
        }
    }
}

/// Each sample is as its source made it.
fn right(header: &SampleHeader, samples: &[Sample]) -> Checked {
    for sample in samples {
        let expected = Sample::new(sample.robot, sample.seq, sample.stamp_ns)
            .command(0.2, 0.0)
            .reading(power_w(sample.robot, sample.seq), sample.measured_ns);
        let mut found = *sample;
        found.instants(|stamp_ns| *stamp_ns = 0);
        let mut wanted = expected;
        wanted.instants(|stamp_ns| *stamp_ns = 0);
        if bytemuck::bytes_of(&found) != bytemuck::bytes_of(&wanted) {
            let found = format!("{sample:?} in frame {}, expected {expected:?}", header.frame_seq);
            return Err(failure("no bit changes on the way", found));
        }
    }
    Ok(())
}

/// The config of a host, and its link's file.
pub(super) fn files(setup: &Setup, name: &str) -> anyhow::Result<(Config, LinkFile)> {
    let config = Config::parse(&setup.toml("/sim/ledger"), Path::new("/"))?;
    let folder = tempfile::tempdir()?;
    let [one, other] = BASES;
    let network = "[network]\nlisten = [\"tcp/127.0.0.1:7447\"]\n";
    let rest = if BASES.contains(&name) {
        "[worker]\n[[worker.take]]\nfrom = \"edge\"\nrobots = [\"0-999999\"]\n\
         [lease]\nendpoints = [\"http://127.0.0.1:2379\"]\n"
    } else {
        "[samples]\n[follow]\n"
    };
    let workers = format!("workers = [\"{one}\", \"{other}\"]\n");
    let text = format!("name = \"{name}\"\n{workers}{network}{rest}");
    let path = folder.path().join("link.toml");
    std::fs::write(&path, text)?;
    let file = LinkFile::load(&path, &config)?;
    Ok((config, file))
}
