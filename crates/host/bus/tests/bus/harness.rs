//! Processes for tests: the test binary restarts itself as members that execute commands.

use std::fs;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use joulebus_bus::{
    Bus, Domain, FrameBuf, Limits, Reader, SampleReader, SampleWriter, Waiter, Waker, WorkerLock,
    Writer,
};
use joulebus_testkit::{Member, left_behind, send_to_test};
use joulebus_wire::{
    Budget, BudgetHeader, Budgets, DiagnosticHeader, Diagnostics, Forecast, ForecastHeader,
    Forecasts, Sample, SampleHeader, State, Ticks, WakeEvent,
};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use crate::beside::Host;

const CHILD: &str = "JOULEBUS_TEST_CHILD";
static PLACES: AtomicU32 = AtomicU32::new(0);

/// The domain of one test; removed when dropped. What its members have left then fails the test.
pub(crate) struct Place {
    pub(crate) domain: Domain,
}

impl Place {
    pub(crate) fn new() -> Self {
        let number = PLACES.fetch_add(1, Ordering::Relaxed);
        let root = format!("/dev/shm/joulebus-test-{}-{number}", std::process::id());
        let domain = Domain::new("test", Path::new(&root), "jbt_").unwrap();
        Self { domain }
    }

    /// Objects in shared memory with the domain's prefix.
    pub(crate) fn objects(&self) -> Vec<PathBuf> {
        fs::read_dir("/dev/shm")
            .unwrap()
            .flatten()
            .filter(|entry| {
                let name = entry.file_name();
                name.to_string_lossy().starts_with(self.domain.shm_prefix())
            })
            .map(|entry| entry.path())
            .collect()
    }

    pub(crate) fn assert_nothing_left(&self) {
        let left = left_behind(self.domain.shm_prefix(), self.domain.root());
        assert_eq!(left, Vec::<PathBuf>::new());
    }

    pub(crate) fn member(&self) -> Member {
        Member::spawn_to_finish("member", self.as_member(Member::command()))
    }

    /// A member that has joined and opened the ports of `role`.
    pub(crate) fn joined(&self, role: &str) -> Member {
        let mut member = self.member();
        must(&mut member, "join");
        must(&mut member, role);
        member
    }

    /// Makes `command` start a member of this domain.
    pub(crate) fn as_member(&self, mut command: Command) -> Command {
        command.env(CHILD, self.domain.root());
        command
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let left = left_behind(self.domain.shm_prefix(), self.domain.root());
        for object in self.objects() {
            let _ = fs::remove_file(object);
        }
        let _ = fs::remove_dir_all(self.domain.root());
        assert!(left.is_empty() || std::thread::panicking(), "left behind: {left:?}");
    }
}

/// Sends a command that must succeed; returns the answer.
pub(crate) fn must(member: &mut Member, command: &str) -> String {
    let answer = member.ask(command);
    match answer.strip_prefix("ok ") {
        Some(answer) => answer.to_owned(),
        None => panic!("{command:?}: {answer}"),
    }
}

pub(crate) fn limits() -> Limits {
    Limits { capacity: 64, max_sources: 3, max_planners: 3, ..Limits::default() }
}

/// Allows this process to open `more` files.
fn limit_files(more: u64) -> Answer {
    let before = getrlimit(Resource::Nofile);
    // It cannot be opened if the limit is reached.
    let next = fs::File::open("/proc/self/fd").map(|file| file.as_raw_fd() as u64);
    let limit = Rlimit { current: next.ok().or(before.current).map(|next| next + more), ..before };
    setrlimit(Resource::Nofile, limit)?;
    Ok(String::new())
}

/// Joins and leaves `times` times in each of six threads at the same time.
fn join_in_threads(domain: &Domain, times: u64) -> Answer {
    let joins = || (0..times).try_for_each(|_| Bus::join(domain, "test").map(drop));
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..6).map(|_| scope.spawn(joins)).collect();
        threads.into_iter().try_for_each(|thread| thread.join().unwrap())
    })?;
    Ok(String::new())
}

/// Executes the parent's commands if this process was started as a member.
pub(crate) fn run_member() {
    let Some(root) = std::env::var_os(CHILD) else {
        return;
    };
    let domain = Domain::new("test", Path::new(&root), "jbt_").unwrap();
    let mut ports = Ports::new(domain);
    for line in std::io::stdin().lines() {
        let line = line.unwrap();
        if line == "quit" {
            break;
        }
        match ports.obey(&line) {
            Ok(answer) => send_to_test(format_args!("ok {answer}")),
            Err(error) => send_to_test(format_args!("err {error}")),
        }
    }
}

/// Declaration order: ports are dropped before the bus.
struct Ports {
    sources: Option<SampleWriter>,
    samples: Option<SampleReader>,
    arrivals: Option<Waiter>,
    forecasts: Option<Writer<Forecasts>>,
    diagnostics: Option<Writer<Diagnostics>>,
    budgets: Option<Writer<Budgets>>,
    /// Journal and keyframes, which also take memory.
    recorded: Option<(Writer<Ticks>, Writer<State>)>,
    wake: Option<Waker>,
    forecast_reader: Option<Reader<Forecasts>>,
    /// Bytes of the frame that the reader holds, as they were when it began to.
    held: Vec<u8>,
    diagnostic_reader: Option<Reader<Diagnostics>>,
    budget_reader: Option<Reader<Budgets>>,
    planner: Option<Waiter>,
    worker_lock: Option<WorkerLock>,
    bus: Option<Bus>,
    host: Option<Host>,
    domain: Domain,
    limits: Limits,
    frame: FrameBuf,
    sent: u64,
}

type Answer = Result<String, Box<dyn std::error::Error>>;

impl Ports {
    fn new(domain: Domain) -> Self {
        Self {
            sources: None,
            samples: None,
            arrivals: None,
            forecasts: None,
            diagnostics: None,
            budgets: None,
            recorded: None,
            wake: None,
            forecast_reader: None,
            held: Vec::new(),
            diagnostic_reader: None,
            budget_reader: None,
            planner: None,
            worker_lock: None,
            bus: None,
            host: None,
            domain,
            limits: limits(),
            frame: FrameBuf::new(limits().capacity),
            sent: 0,
        }
    }

    fn obey(&mut self, line: &str) -> Answer {
        let (command, argument) = line.split_once(' ').unwrap_or((line, "0"));
        let number: u64 = argument.parse()?;
        match command {
            "join" => {
                let bus = Bus::join(&self.domain, "test")?;
                let answer = format!("{:?}", bus.joined());
                self.bus = Some(bus);
                Ok(answer)
            }
            "threads" => join_in_threads(&self.domain, number),
            "capacity" => {
                self.limits.capacity = number as usize;
                Ok(String::new())
            }
            "source" => self.open_source(),
            "worker" => {
                if self.worker_lock.is_none() {
                    self.worker_lock = Some(WorkerLock::acquire(&self.domain)?);
                }
                self.open_worker()
            }
            // With the worker's ports but without its lock.
            "impostor" => self.open_worker(),
            "planner" => self.open_planner(),
            "send" => self.send(number),
            "take" => self.take(),
            "tick" => self.tick(number),
            "latest" => self.latest(),
            "count" => self.count(),
            "hold" => self.hold(),
            "held" => Ok((self.held_bytes()? == self.held).to_string()),
            "foreign" => Ok(self.forecast_reader.as_ref().ok_or("no port")?.foreign().to_string()),
            "wait" => self.wait(),
            "lock" => {
                self.worker_lock = Some(WorkerLock::acquire(&self.domain)?);
                Ok(String::new())
            }
            "unlock" => {
                self.worker_lock = None;
                Ok(String::new())
            }
            "degraded" => Ok(self.samples.as_ref().ok_or("no port")?.degraded().to_string()),
            // Most further files that this process may open.
            "files" => limit_files(number),
            "log" => crate::logging::log(),
            "host" => {
                self.host = Some(Host::start(&self.domain)?);
                Ok(String::new())
            }
            "publish" => {
                self.host.as_ref().ok_or("no host")?.publish(number)?;
                Ok(String::new())
            }
            "received" => {
                let received = self.host.as_ref().ok_or("no host")?.received()?;
                Ok(format!("{received:?}"))
            }
            "housekeeping" => Ok(format!("{:?}", self.bus()?.housekeeping())),
            "leave" => {
                let host = self.host.take();
                *self = Self::new(self.domain.clone());
                self.host = host;
                Ok(String::new())
            }
            _ => Err(format!("no such command {line:?}").into()),
        }
    }

    fn bus(&self) -> Result<&Bus, &'static str> {
        self.bus.as_ref().ok_or("not joined")
    }

    fn open_source(&mut self) -> Answer {
        let writer = self.bus()?.sample_writer(&self.limits, self.limits.capacity)?;
        self.sources = Some(writer);
        Ok(String::new())
    }

    fn open_worker(&mut self) -> Answer {
        let limits = self.limits;
        let bus = self.bus.as_ref().ok_or("not joined")?;
        self.samples = Some(bus.sample_reader(&limits)?);
        self.arrivals = Some(bus.arrivals_waiter(&limits)?);
        self.forecasts = Some(bus.writer(&limits)?);
        self.diagnostics = Some(bus.writer(&limits)?);
        self.budgets = Some(bus.writer(&limits)?);
        self.recorded = Some((bus.writer(&limits)?, bus.writer(&limits)?));
        self.wake = Some(bus.planner_waker(&limits)?);
        Ok(String::new())
    }

    fn open_planner(&mut self) -> Answer {
        let limits = self.limits;
        let bus = self.bus.as_ref().ok_or("not joined")?;
        self.forecast_reader = Some(bus.reader(&limits)?);
        self.diagnostic_reader = Some(bus.reader(&limits)?);
        self.budget_reader = Some(bus.reader(&limits)?);
        self.planner = Some(bus.planner_waiter(&limits)?);
        Ok(String::new())
    }

    /// Sends a frame of `len` samples; sample `i` of frame `n` draws `n + i / 100` W.
    fn send(&mut self, len: u64) -> Answer {
        let number = self.sent;
        let header =
            SampleHeader { frame_seq: number, pid: std::process::id(), ..SampleHeader::default() };
        let sent = self.sources.as_mut().ok_or("no port")?.send(header, len as usize, |i| {
            let power_w = number as f32 + i as f32 / 100.0;
            Sample::new(i as u32, number, 1).reading(power_w, 1)
        })?;
        self.sent += 1;
        Ok(sent.readers.to_string())
    }

    fn take(&mut self) -> Answer {
        let reader = self.samples.as_mut().ok_or("no port")?;
        if !reader.take(&mut self.frame)? {
            return Ok("none".to_owned());
        }
        let number = self.frame.header().frame_seq;
        for (i, sample) in self.frame.samples().iter().enumerate() {
            assert_eq!(sample.robot, i as u32);
            assert_eq!(sample.power_w, number as f32 + i as f32 / 100.0);
        }
        Ok(format!("{number}:{}", self.frame.samples().len()))
    }

    /// Sends `ticks` ticks of forecasts, diagnostics and budgets of three robots.
    fn tick(&mut self, ticks: u64) -> Answer {
        for _ in 0..ticks {
            self.sent += 1;
            let tick = self.sent;
            let forecasts = self.forecasts.as_mut().ok_or("no port")?;
            let mut loan = forecasts.loan(3)?;
            loan.header_mut().tick = tick;
            loan.header_mut().pid = std::process::id();
            for (robot, forecast) in loan.payload_mut().iter_mut().enumerate() {
                *forecast =
                    Forecast { robot: robot as u32, power_w: tick as f32, ..Forecast::default() };
            }
            loan.send()?;
            let diagnostics = DiagnosticHeader { tick, ..DiagnosticHeader::default() };
            self.diagnostics
                .as_mut()
                .ok_or("no port")?
                .send(diagnostics, 3, |_| Default::default())?;
            let budgets = BudgetHeader { tick, ..BudgetHeader::default() };
            self.budgets.as_mut().ok_or("no port")?.send(budgets, 1, |_| Budget {
                drawn_uj: tick.cast_signed(),
                ..Budget::default()
            })?;
            self.wake.as_ref().ok_or("no port")?.wake(WakeEvent::Frame)?;
        }
        Ok(self.sent.to_string())
    }

    /// The newest ticks of forecasts, diagnostics and budgets.
    fn latest(&mut self) -> Answer {
        if let Some(budgets) = &mut self.budgets {
            budgets.update();
            return Ok(String::new());
        }
        let mut ticks = Vec::new();
        let reader = self.forecast_reader.as_mut().ok_or("no port")?;
        ticks.push(reader.take_latest()?.map(|frame| {
            let header: &ForecastHeader = frame.header();
            assert!(frame.payload().iter().all(|forecast| forecast.power_w == header.tick as f32));
            assert_eq!(frame.payload().len(), 3);
            header.tick
        }));
        let reader = self.diagnostic_reader.as_mut().ok_or("no port")?;
        ticks.push(reader.take_latest()?.map(|frame| frame.header().tick));
        let reader = self.budget_reader.as_mut().ok_or("no port")?;
        ticks.push(reader.take_latest()?.map(|frame| {
            assert_eq!(frame.payload()[0].drawn_uj, frame.header().tick.cast_signed());
            frame.header().tick
        }));
        Ok(format!("{ticks:?}"))
    }

    /// The ticks of all queued forecasts, in order.
    fn count(&mut self) -> Answer {
        let reader = self.forecast_reader.as_mut().ok_or("no port")?;
        let mut ticks = Vec::new();
        while let Some(frame) = reader.take_next()? {
            ticks.push(frame.header().tick);
        }
        Ok(format!("{ticks:?}"))
    }

    /// Holds the newest forecasts from now on.
    fn hold(&mut self) -> Answer {
        let reader = self.forecast_reader.as_mut().ok_or("no port")?;
        let is_held = reader.hold_latest(|_, _, _| true)?;
        self.held = self.held_bytes()?;
        Ok(is_held.to_string())
    }

    fn held_bytes(&self) -> Result<Vec<u8>, &'static str> {
        let reader = self.forecast_reader.as_ref().ok_or("no port")?;
        let (header, rows) = reader.held().ok_or("nothing is held")?;
        Ok([bytemuck::bytes_of(header), bytemuck::cast_slice(rows)].concat())
    }

    /// Waits until an event.
    fn wait(&mut self) -> Answer {
        let waiter = self.arrivals.as_mut().or(self.planner.as_mut());
        let waiter = waiter.ok_or("no port")?;
        loop {
            let woken = waiter.wait_until(None, None)?;
            if !woken.is_nothing() {
                return Ok(format!("{woken:?}"));
            }
        }
    }
}
