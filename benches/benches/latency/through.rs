//! Through the broker: a source (this process), a worker and a planner.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, anyhow};
use joulebus_benches::{Spread, histogram};
use joulebus_bus::{Bus, clock};
use joulebus_config::{Config, Demo};
use joulebus_predictor_worker::Worker;
use joulebus_publisher::{Pace, Publisher, RobotState};
use serde::{Deserialize, Serialize};

use crate::{finish, start};

/// Frames before the figures count.
const WARM_UP: u64 = 30;

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Figures {
    pub end_to_end_us: Spread,
    pub sent_to_readable_us: Spread,
    pub source_us: Spread,
    pub one_way_us: Spread,
    pub compute_us: Spread,
    pub missed: u64,
    #[serde(default)]
    pub tick_us: Spread,
    #[serde(default)]
    pub worker_bytes: u64,
}

#[derive(Debug, Serialize, Deserialize)]
struct WorkerFigures {
    tick_us: Spread,
    own_bytes: u64,
}

pub(crate) fn measure(robots: usize, rate_hz: u64, frames: u64) -> anyhow::Result<Figures> {
    let path = config_file(robots)?;
    let figures = run(&path, robots, rate_hz, frames);
    std::fs::remove_file(&path)?;
    figures
}

fn run(path: &Path, robots: usize, rate_hz: u64, frames: u64) -> anyhow::Result<Figures> {
    let config = Config::load(path)?;
    let name = path.display().to_string();
    let mut worker = start(&["worker".into(), name.clone()])?;
    ready(&mut worker)?;
    let mut planner = start(&["planner".into(), name, frames.to_string()])?;
    ready(&mut planner)?;
    let mut publisher = Publisher::with_config(&config, "bench")?;
    let mut pace = Pace::every(Duration::from_nanos(1_000_000_000 / rate_hz));
    for frame in 0..WARM_UP + frames + 1 {
        let slot = pace.wait();
        let state = |robot: usize| {
            let power_w = 3.5 + ((robot as u64 + frame) % 100) as f32 * 0.001;
            RobotState::new(robot as u32)
                .command(0.1, 0.2)
                .reading(power_w)
        };
        publisher.publish_intended(slot.intended_ns, (0..robots).map(state))?;
    }
    let mut figures: Figures = finish(planner)?;
    drop(worker.stdin.take());
    let worker: WorkerFigures = finish(worker)?;
    (figures.tick_us, figures.worker_bytes) = (worker.tick_us, worker.own_bytes);
    drop(publisher);
    std::fs::remove_dir(config.root()).ok();
    Ok(figures)
}

/// A private fleet, as the demo makes it, at a rate that leaves the source in command.
fn config_file(robots: usize) -> anyhow::Result<PathBuf> {
    let demo = Demo {
        fleet: "bench".into(),
        root: format!("/dev/shm/joulebus-bench-{}", std::process::id()).into(),
        prefix: "jbb_".into(),
        robots: u32::try_from(robots)?,
    };
    let path = std::env::temp_dir().join(format!(
        "joulebus-bench-{}-{robots}.toml",
        std::process::id()
    ));
    std::fs::write(&path, demo.toml())?;
    Ok(path)
}

/// A child says that it is ready with a line.
fn ready(child: &mut std::process::Child) -> anyhow::Result<()> {
    let stdout = child
        .stdout
        .as_mut()
        .context("the child's output is not piped")?;
    let mut byte = [0];
    loop {
        stdout
            .read_exact(&mut byte)
            .context("the child ended before it was ready")?;
        if byte[0] == b'\n' {
            return Ok(());
        }
    }
}

pub(crate) fn worker(path: &Path) -> anyhow::Result<()> {
    let config = Config::load(path)?;
    let worker = Worker::open(&config)?;
    println!("ready");
    let stop = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&stop);
    // The benchmark closes our input when it is done; what the worker holds is measured before it
    // gives it back.
    let measuring = std::thread::spawn(move || {
        let mut line = String::new();
        let _ = BufReader::new(std::io::stdin()).read_line(&mut line);
        let own_bytes = own_bytes();
        told.store(true, Ordering::Relaxed);
        own_bytes
    });
    let report = worker.run(&stop)?;
    let tick_us = report.tick;
    let own_bytes = measuring
        .join()
        .map_err(|_| anyhow!("measuring panicked"))??;
    println!(
        "{}",
        serde_json::to_string(&WorkerFigures { tick_us, own_bytes })?
    );
    Ok(())
}

/// Anonymous memory of this process, at its highest: neither files nor shared memory.
fn own_bytes() -> anyhow::Result<u64> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("RssAnon:"));
    let kilobytes: u64 = line
        .context("no RssAnon")?
        .trim()
        .trim_end_matches(" kB")
        .parse()?;
    Ok(kilobytes * 1024)
}

pub(crate) fn planner(path: &Path, frames: u64) -> anyhow::Result<()> {
    let config = Config::load(path)?;
    let limits = config.limits();
    let bus = Bus::join(&config.domain()?, "planner")?;
    let mut waiter = bus.planner_waiter(&limits)?;
    let mut reader = bus.forecast_reader(&limits)?;
    println!("ready");
    let (mut end_to_end, mut sent_to_readable) = (histogram(), histogram());
    let mut source = histogram();
    let (mut one_way, mut compute) = (histogram(), histogram());
    let (mut seen, mut last_tick, mut missed) = (0, 0, 0);
    while seen < WARM_UP + frames {
        waiter.wait_until(None, None)?;
        while let Some(frame) = reader.take_next()? {
            let now_ns = clock::monotonic_ns();
            let header = frame.header();
            if header.frames_taken == 0 {
                continue;
            }
            seen += 1;
            if seen <= WARM_UP {
                last_tick = header.tick;
                continue;
            }
            missed += header.tick - last_tick - 1;
            last_tick = header.tick;
            end_to_end.saturating_record(now_ns.saturating_sub(header.first_intended_ns));
            sent_to_readable.saturating_record(now_ns.saturating_sub(header.first_sent_ns));
            source.saturating_record(
                header
                    .first_sent_ns
                    .saturating_sub(header.first_intended_ns),
            );
            one_way.saturating_record(header.first_taken_ns.saturating_sub(header.first_sent_ns));
            compute.saturating_record(
                header
                    .compute_end_ns
                    .saturating_sub(header.compute_start_ns),
            );
        }
    }
    let figures = Figures {
        end_to_end_us: Spread::of(&end_to_end),
        sent_to_readable_us: Spread::of(&sent_to_readable),
        source_us: Spread::of(&source),
        one_way_us: Spread::of(&one_way),
        compute_us: Spread::of(&compute),
        missed,
        tick_us: Spread::default(),
        worker_bytes: 0,
    };
    println!("{}", serde_json::to_string(&figures)?);
    Ok(())
}
