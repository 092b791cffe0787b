//! Latency through the broker: a source (this process), a worker and a planner.

use std::fmt;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::Child;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, anyhow};
use hdrhistogram::Histogram;
use joulebus_bus::{Bus, clock};
use joulebus_config::{Config, Demo};
use joulebus_latency::Spread;
use joulebus_predictor_worker::Worker;
use joulebus_publisher::{Publisher, RobotState};
use joulebus_wire::{ForecastHeader, Forecasts};
use serde::{Deserialize, Serialize};

use super::{Launcher, WARM_UP, finish, record_places};
use crate::histogram;
use crate::machine::anonymous_bytes;

/// Figures of the planner and the worker.
#[derive(Debug, Serialize, Deserialize)]
pub struct Figures {
    /// From the frame's intended time to the forecast being readable.
    pub end_to_end_us: Spread,
    /// From the frame's sending to the forecast being readable: the broker's share.
    pub sent_to_readable_us: Spread,
    /// From the frame's intended time to its sending: the source's share.
    pub source_us: Spread,
    /// From the frame's sending to the worker's reception.
    pub one_way_us: Spread,
    /// From the tick's start to the last forecast being written.
    pub compute_us: Spread,
    /// Ticks whose forecasts the planner missed.
    pub missed: u64,
    /// The whole tick, diagnostics and budgets included.
    #[serde(default)]
    pub tick_us: Spread,
    /// Anonymous memory of the worker, bytes.
    #[serde(default)]
    pub worker_bytes: u64,
}

#[derive(Debug, Serialize, Deserialize)]
struct WorkerFigures {
    tick_us: Spread,
    own_bytes: u64,
}

/// The source, and the processes of the worker and the planner.
pub struct Broker {
    publisher: Publisher,
    worker: Child,
    planner: Child,
    config: Config,
    path: PathBuf,
    robots: usize,
}

impl fmt::Debug for Broker {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Broker").field("robots", &self.robots).finish_non_exhaustive()
    }
}

impl Broker {
    /// Starts the worker and the planner, and connects.
    ///
    /// # Errors
    /// A process could not be started, or the fleet could not be joined.
    pub fn open(launcher: &Launcher, robots: usize, period_ns: u64) -> anyhow::Result<Self> {
        let path = config_file(robots)?;
        let config = Config::load(&path)?;
        let name = path.display().to_string();
        let worker = launcher.start(&["worker".into(), name.clone()])?;
        let planner = launcher.start(&["planner".into(), name, period_ns.to_string()])?;
        Ok(Self {
            publisher: Publisher::without_judgement(&config, "bench")?,
            worker,
            planner,
            config,
            path,
            robots,
        })
    }

    /// Sends the frame that was due at `intended_ns`.
    ///
    /// # Errors
    /// The publisher reports an error.
    pub fn send(&mut self, intended_ns: u64, frame: u64) -> anyhow::Result<()> {
        let state = |robot: usize| {
            let power_w = 3.5 + ((robot as u64 + frame) % 100) as f32 * 0.001;
            RobotState::new(robot as u32).command(0.1, 0.2).reading(power_w)
        };
        self.publisher.publish_intended(intended_ns, (0..self.robots).map(state))?;
        Ok(())
    }

    /// Ends the worker, and with it the planner.
    ///
    /// # Errors
    /// One of them failed.
    pub fn finish(mut self) -> anyhow::Result<Figures> {
        drop(self.worker.stdin.take());
        let worker: anyhow::Result<WorkerFigures> = finish(self.worker);
        let figures: anyhow::Result<Figures> = finish(self.planner);
        drop(self.publisher);
        // The last member has removed the rest.
        std::fs::remove_dir(self.config.root()).ok();
        std::fs::remove_file(&self.path)?;
        let (worker, mut figures) = (worker?, figures?);
        (figures.tick_us, figures.worker_bytes) = (worker.tick_us, worker.own_bytes);
        Ok(figures)
    }
}

/// A private fleet with the demo's config, at a tick rate above the source's.
fn config_file(robots: usize) -> anyhow::Result<PathBuf> {
    let demo = Demo {
        fleet: "bench".into(),
        root: format!("/dev/shm/joulebus-bench-{}", std::process::id()).into(),
        prefix: "jbb_".into(),
        robots: u32::try_from(robots)?,
    };
    let path =
        std::env::temp_dir().join(format!("joulebus-bench-{}-{robots}.toml", std::process::id()));
    std::fs::write(&path, demo.toml())?;
    Ok(path)
}

/// The worker's process.
///
/// # Errors
/// The worker fails to start or to run.
pub fn worker(path: &Path) -> anyhow::Result<()> {
    let config = Config::load(path)?;
    let mut worker = Worker::open(&config)?;
    println!("ready");
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    // The benchmark closes our stdin at the end. The worker's memory is measured before it is
    // freed.
    let measuring = std::thread::spawn(move || {
        let mut line = String::new();
        let _ = BufReader::new(std::io::stdin()).read_line(&mut line);
        let own_bytes = anonymous_bytes();
        stopped.store(true, Ordering::Relaxed);
        own_bytes
    });
    worker.run(&stop)?;
    let report = worker.finish();
    let tick_us = report.tick;
    let own_bytes =
        measuring.join().map_err(|_| anyhow!("measuring panicked"))?.context("no RssAnon")?;
    println!("{}", serde_json::to_string(&WorkerFigures { tick_us, own_bytes })?);
    Ok(())
}

/// The planner's process: prints its figures.
///
/// # Errors
/// The planner fails to join or to run.
pub fn planner(path: &Path, period_ns: u64) -> anyhow::Result<()> {
    let config = Config::load(path)?;
    let limits = config.limits();
    let bus = Bus::join(&config.domain()?, "planner")?;
    let mut waiter = bus.planner_waiter(&limits)?;
    let mut reader = bus.reader::<Forecasts>(&limits)?;
    println!("ready");
    let mut seen = Seen::new(period_ns);
    loop {
        let woken = waiter.wait_until(None, None)?;
        while let Some(frame) = reader.take_next()? {
            seen.take(frame.header(), clock::monotonic_ns());
        }
        if woken.ended || woken.died {
            println!("{}", serde_json::to_string(&seen.figures())?);
            return Ok(());
        }
    }
}

/// Figures of a planner.
struct Seen {
    period_ns: u64,
    frames: u64,
    last_tick: u64,
    missed: u64,
    end_to_end: Histogram<u64>,
    sent_to_readable: Histogram<u64>,
    source: Histogram<u64>,
    one_way: Histogram<u64>,
    compute: Histogram<u64>,
}

impl Seen {
    fn new(period_ns: u64) -> Self {
        Self {
            period_ns,
            frames: 0,
            last_tick: 0,
            missed: 0,
            end_to_end: histogram(),
            sent_to_readable: histogram(),
            source: histogram(),
            one_way: histogram(),
            compute: histogram(),
        }
    }

    /// Records a frame of forecasts that was readable at `now_ns`.
    fn take(&mut self, header: &ForecastHeader, now_ns: u64) {
        let before = std::mem::replace(&mut self.last_tick, header.tick);
        let warm = self.frames >= WARM_UP;
        self.frames += u64::from(header.frames_taken);
        if !warm || header.frames_taken == 0 {
            return;
        }
        self.missed += (header.tick - before).saturating_sub(1);
        let record = |times: &mut Histogram<u64>, from_ns: u64, to_ns: u64| {
            times.saturating_record(to_ns.saturating_sub(from_ns));
        };
        let (due_ns, sent_ns) = (header.first_intended_ns, header.first_sent_ns);
        record_places(
            &mut self.end_to_end,
            (due_ns, sent_ns, now_ns),
            self.period_ns,
            header.frames_taken.into(),
        );
        record(&mut self.source, due_ns, sent_ns);
        record(&mut self.sent_to_readable, sent_ns, now_ns);
        record(&mut self.one_way, sent_ns, header.first_taken_ns);
        record(&mut self.compute, header.compute_start_ns, header.compute_end_ns);
    }

    fn figures(&self) -> Figures {
        Figures {
            end_to_end_us: Spread::new(&self.end_to_end),
            sent_to_readable_us: Spread::new(&self.sent_to_readable),
            source_us: Spread::new(&self.source),
            one_way_us: Spread::new(&self.one_way),
            compute_us: Spread::new(&self.compute),
            missed: self.missed,
            tick_us: Spread::default(),
            worker_bytes: 0,
        }
    }
}
