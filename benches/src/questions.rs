//! Questions that the worker answers: how long they take beside the same answer computed in the
//! client's process, and beside two raw iceoryx2 hops of as many bytes, and the ticks while clients
//! ask as fast as they can, beside those of the same run while they do not.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::arguments::BenchOptions;
use anyhow::Context as _;
use joulebus_bus::clock;
use joulebus_config::Config;
use joulebus_latency::Spread;
use joulebus_plan::{Plan, Question};
use joulebus_plan_server::PlanServer;
use joulebus_planner::{PlanClient, Planner};
use joulebus_predictor_worker::Worker;
use joulebus_publisher::{Pace, Publisher, RobotState};
use joulebus_wire::{MAX_QUERY_STEPS, Sample};

use crate::Report;
use crate::latency::Launcher;
use crate::latency::raw::RawHops;
use crate::report::quantile;
use crate::rollout::title;

/// Candidates of one robot, and steps of each.
const CANDIDATES: usize = 16;
const STEPS: usize = 50;
/// Robots in a raw frame that has the bytes of the question's commands, f64 in shared memory.
const RAW_ROBOTS: usize = (CANDIDATES * STEPS * 2 * size_of::<f64>()).div_ceil(size_of::<Sample>());
/// No raw frame is late: they are sent one by one, each after the one before arrived.
const RAW_PERIOD_NS: u64 = 1_000_000_000;
/// Clients that ask as fast as they can.
const CLIENTS: usize = 4;
/// Ticks a second while ticks are measured.
const TICK_HZ: u64 = 200;
/// Length of a phase with or without questions.
const PHASE: Duration = Duration::from_millis(500);
/// Timeout of an answer.
const PATIENCE: Duration = Duration::from_secs(30);

/// Measures answers, then ticks.
pub(crate) fn measure(options: &BenchOptions, launcher: &Launcher) -> anyhow::Result<Report> {
    let robots = options.robots.first().copied().unwrap_or(1_000);
    let mut report = Report::new("questions")
        .with_input("robots", robots)
        .with_input("clients", CLIENTS)
        .with_input("tick_hz", TICK_HZ)
        .with_input("seconds", options.paced_s(60));
    answers(&mut report, options, launcher)?;
    ticks(&mut report, options, robots)?;
    report.notes.push(
        "Interleaved in one client: the answer of the worker's thread, the same answer computed by the client \
         from shared memory, and two raw iceoryx2 hops through a process that computes nothing, with the bytes of the \
         question's commands. Ticks: phases of half \
         a second with and without questions alternate, plan states are written in both."
            .to_owned(),
    );
    Ok(report)
}

/// A fleet of its own in shared memory.
struct Fleet {
    root: PathBuf,
    config: Config,
}

impl Fleet {
    fn new(robots: usize, rate_hz: u64) -> anyhow::Result<Self> {
        let root = PathBuf::from(format!("/dev/shm/joulebus-bench-{}", std::process::id()));
        let last = robots - 1;
        let text = format!(
            "[fleet]\nname = \"bench\"\ncapacity = {robots}\n\
             [domain]\nroot = \"{}\"\nprefix = \"jbb_\"\n\
             [tick]\nrate_hz = {rate_hz}.0\ndeadline_ms = 4.0\n\
             [ledger]\ncheckpoint = \"\"\n[worker]\nthreads = 1\n\
             [[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-{last}\"]\nrate_hz = {rate_hz}.0\n\
             [platform.battery]\ncapacity_wh = 10.0\ninitial_soc_lo = 0.9\n",
            root.display()
        );
        let config = Config::parse(&text, &root.join("fleet.toml"))?;
        Ok(Self { root, config })
    }

    /// Runs `work` beside a worker's ticks and a source, in threads of this process.
    fn run<T>(
        &self,
        robots: usize,
        rate_hz: u64,
        work: impl FnOnce(
            &mut dyn FnMut() -> anyhow::Result<Option<f64>>,
            &AtomicBool,
        ) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let stop = AtomicBool::new(false);
        let server = PlanServer::start(&self.config, None)?;
        let mut worker = Worker::open(&self.config)?;
        server.serve();
        server.wait_until_open();
        let done = std::thread::scope(|scope| {
            let source = scope.spawn(|| publish(&self.config, robots, rate_hz, &stop));
            let mut turn = || -> anyhow::Result<Option<f64>> {
                let begun = Instant::now();
                let ticked = worker.poll()?;
                Ok(ticked.then(|| begun.elapsed().as_secs_f64() * 1e6))
            };
            let done = work(&mut turn, &stop);
            stop.store(true, Ordering::Relaxed);
            source.join().ok().context("the source panicked")??;
            done
        });
        let _ = (server.finish(), worker.finish());
        done
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        // Empty once its members have left.
        let _ = std::fs::remove_dir(&self.root);
    }
}

fn publish(config: &Config, robots: usize, rate_hz: u64, stop: &AtomicBool) -> anyhow::Result<()> {
    let mut publisher = Publisher::without_judgement(config, "source")?;
    let mut pace = Pace::every(Duration::from_nanos(1_000_000_000 / rate_hz));
    let mut step = 0_u32;
    while !stop.load(Ordering::Relaxed) {
        pace.wait();
        step += 1;
        let states = (0..robots as u32).map(|robot| {
            let wave = ((step * 7 + robot * 3) % 100) as f32 * 0.001;
            RobotState::new(robot).command(0.05 + wave, 0.3).reading(3.5 + wave)
        });
        publisher.publish(states)?;
    }
    Ok(())
}

fn question(robot: u32) -> Question {
    let wave = |at: usize| ((at * 7) % 19) as f32 * 0.01;
    let places = 0..CANDIDATES * STEPS;
    Question {
        plan: Plan::WhatIf {
            robot,
            candidates: CANDIDATES,
            period_s: 1.0 / 30.0,
            v_mps: places.clone().map(wave).collect(),
            omega_radps: places.map(|at| 5.0 * wave(at + 3)).collect(),
        },
        coverage: 0.9,
        power: false,
        moments: 0,
    }
}

/// Times of one question each way, µs.
#[derive(Default)]
struct Times {
    through_us: Vec<f64>,
    here_us: Vec<f64>,
}

fn answers(report: &mut Report, options: &BenchOptions, launcher: &Launcher) -> anyhow::Result<()> {
    let fleet = Fleet::new(20, 30)?;
    let rounds = options.rounds(5_000);
    let is_done = AtomicBool::new(false);
    let (times, raw) = fleet.run(20, 30, |turn, stop| {
        std::thread::scope(|scope| {
            let client = scope.spawn(|| {
                let asked = ask(&fleet.config, rounds, launcher);
                is_done.store(true, Ordering::Relaxed);
                asked
            });
            while !is_done.load(Ordering::Relaxed) && !stop.load(Ordering::Relaxed) {
                turn()?;
            }
            client.join().ok().context("the client panicked")?
        })
    })?;
    let case = title((1, CANDIDATES, STEPS));
    report.less("through_worker_us", &case, "µs", &times.through_us);
    report.less("in_process_us", &case, "µs", &times.here_us);
    report.times("raw_two_hops_us", &case, &raw);
    let way_us = quantile(&times.through_us, 0.5) - quantile(&times.here_us, 0.5);
    report.less("way_p50_over_raw_hops", &case, "1", &[way_us / raw.p50_us]);
    Ok(())
}

fn ask(config: &Config, rounds: usize, launcher: &Launcher) -> anyhow::Result<(Times, Spread)> {
    let question = question(3);
    let mut planner = Planner::with_config(config, "planner")?;
    let fleet = planner.fleet().clone();
    let mut client = PlanClient::with_config(config, "client")?;
    let mut raw = RawHops::open(launcher, RAW_ROBOTS, RAW_PERIOD_NS, true)?;
    let mut times = Times::default();
    let timed = |us: &mut Vec<f64>, work: &mut dyn FnMut() -> anyhow::Result<()>| {
        let begun = Instant::now();
        work()?;
        us.push(begun.elapsed().as_secs_f64() * 1e6);
        anyhow::Ok(())
    };
    // The robots begin when they begin.
    let begun = Instant::now();
    loop {
        let is_known = client.ask(&question, PATIENCE);
        if let Ok(answered) = &is_known
            && answered.reply.rows.iter().all(|row| row.answer.energy.is_some())
        {
            break;
        }
        if begun.elapsed() > PATIENCE {
            is_known?;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    for _ in 0..rounds {
        timed(&mut times.through_us, &mut || {
            client.ask(&question, PATIENCE)?;
            Ok(())
        })?;
        timed(&mut times.here_us, &mut || {
            let view = planner.view()?.context("a frame")?;
            let find = |robot| view.rows(robot);
            question.clone().answer(&fleet, find, MAX_QUERY_STEPS)?;
            Ok(())
        })?;
        raw.send(clock::monotonic_ns())?;
        raw.acknowledged()?;
    }
    Ok((times, raw.finish()?))
}

fn ticks(report: &mut Report, options: &BenchOptions, robots: usize) -> anyhow::Result<()> {
    let fleet = Fleet::new(robots, TICK_HZ)?;
    let (asks, answered) = (AtomicBool::new(false), AtomicU64::new(0));
    let length = Duration::from_secs(options.paced_s(60));
    let mut us = [Vec::new(), Vec::new()];
    fleet.run(robots, TICK_HZ, |turn, stop| {
        std::thread::scope(|scope| {
            let clients: Vec<_> = (0..CLIENTS as u32)
                .map(|robot| {
                    let (config, asks, answered) = (&fleet.config, &asks, &answered);
                    scope.spawn(move || flood(config, robot, asks, answered, stop))
                })
                .collect();
            let begun = Instant::now();
            while begun.elapsed() < length {
                let phase = (begun.elapsed().as_nanos() / PHASE.as_nanos()) as usize % 2;
                asks.store(phase == 1, Ordering::Relaxed);
                let into = begun.elapsed().as_nanos() % PHASE.as_nanos();
                // Clients begin and end to ask some time into a phase.
                let settled = into > PHASE.as_nanos() / 10;
                if let Some(took_us) = turn()?.filter(|_| settled) {
                    us[phase].push(took_us);
                }
            }
            stop.store(true, Ordering::Relaxed);
            for client in clients {
                client.join().ok().context("a client panicked")??;
            }
            anyhow::Ok(())
        })
    })?;
    let case = format!("{robots} robots");
    let [without, with] = &us;
    report.less("tick_without_questions_us", &case, "µs", without);
    report.less("tick_with_questions_us", &case, "µs", with);
    for (name, share) in
        [("tick_p999_with_over_without", 0.999), ("tick_p50_with_over_without", 0.5)]
    {
        report.less(name, &case, "1", &[quantile(with, share) / quantile(without, share)]);
    }
    let asked_s = length.as_secs_f64() / 2.0;
    let rate_hz = answered.load(Ordering::Relaxed) as f64 / asked_s;
    report.more("questions_hz", &case, "1/s", &[rate_hz]);
    Ok(())
}

/// Asks as fast as it can while `asks` is set.
fn flood(
    config: &Config,
    robot: u32,
    asks: &AtomicBool,
    answered: &AtomicU64,
    stop: &AtomicBool,
) -> anyhow::Result<()> {
    let question = question(robot);
    let mut client = PlanClient::with_config(config, "flood")?;
    while !stop.load(Ordering::Relaxed) {
        if !asks.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
        } else if client.ask(&question, Duration::from_secs(1)).is_ok() {
            answered.fetch_add(1, Ordering::Relaxed);
        }
    }
    Ok(())
}
