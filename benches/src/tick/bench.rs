//! A fleet with its input and output buffers.

use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use joulebus_bus::{Scheduling, clock};
use joulebus_config::{Config, Demo};
use joulebus_fleet::{Batch, Fleet, OutputRows, SecondaryOutputs};
use joulebus_predictor::{Features, Model, Network};
use joulebus_predictor_worker::TickPool;
use joulebus_publisher::Pace;
use joulebus_settings::FleetSettings;

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

use super::world::World;
use crate::input;
use crate::machine::anonymous_bytes;

/// Durations of the parts of one round, ns.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Round {
    /// The network alone on as many rows.
    pub(crate) kernel: f64,
    /// Ingest of the tick in one pass.
    pub(crate) take: f64,
    /// The rest of the tick in one pass.
    pub(crate) run: f64,
    /// Its stages, over all threads: features, network, scoring, writing.
    pub(crate) stages: [f64; 4],
    /// Another tick in one pass, ingest included, that also writes the plan states.
    pub(crate) with_plan_states: f64,
    /// And another that writes the outlooks.
    pub(crate) with_outlooks: f64,
    /// Ingest of the tick in two passes.
    pub(crate) take_in_two: f64,
    pub(crate) forecast: f64,
    pub(crate) account: f64,
}

impl Round {
    /// The tick in one pass, ingest included, ns.
    pub(crate) fn tick(&self) -> f64 {
        self.take + self.run
    }
}

/// Result of a paced run.
pub(super) struct Paced {
    pub(super) tick_us: Vec<f64>,
    pub(super) due_to_done_us: Vec<f64>,
    pub(super) missed: u64,
}

pub(super) struct Bench {
    network: Network,
    rows: Vec<Features>,
    forecasts_w: Vec<f32>,
    world: World,
    fleet: Fleet,
    pool: TickPool,
    batch: Batch,
    written: OutputRows,
    rounds: u64,
    before_bytes: Option<u64>,
}

impl Bench {
    /// A fleet of `robots` robots, ticked by `threads` threads.
    pub(super) fn new(
        network: &Network,
        robots: usize,
        threads: usize,
        learning: bool,
    ) -> anyhow::Result<Self> {
        let settings = settings(robots, learning)?;
        let models = vec![Model::Network(network.clone())];
        let rows = input::rows(network, input::SEED, robots);
        let world = World::new(&settings.platforms[0], robots);
        let forecasts_w = vec![0.0; robots];
        let before_bytes = anonymous_bytes();
        Ok(Self {
            network: network.clone(),
            rows,
            forecasts_w,
            world,
            fleet: Fleet::new(settings, models)?,
            pool: pool(threads)?,
            batch: Batch::default(),
            written: OutputRows::new(robots),
            rounds: 0,
            before_bytes,
        })
    }

    pub(super) fn robots(&self) -> usize {
        self.rows.len()
    }

    /// Memory of the fleet, without its inputs and outputs.
    pub(super) fn own_bytes(&self) -> Option<f64> {
        Some(anonymous_bytes()? as f64 - self.before_bytes? as f64)
    }

    /// The kernel and the variants of the tick, one after the other. Every other round, the ticks
    /// that write plan states or outlooks come before the one that does not.
    pub(super) fn round(&mut self) -> Round {
        let kernel = self.kernel();
        self.rounds += 1;
        let plans_first = self.rounds.is_multiple_of(2);
        let mut with = [0.0; 2];
        if plans_first {
            with = self.ticks_with_more();
        }
        let before = self.pool.spent_ns();
        let (take, run) = self.tick_in_one();
        let after = self.pool.spent_ns();
        if !plans_first {
            with = self.ticks_with_more();
        }
        let mut round = Round {
            kernel,
            take,
            run,
            with_plan_states: with[0],
            with_outlooks: with[1],
            stages: std::array::from_fn(|stage| (after[stage] - before[stage]) as f64),
            ..Round::default()
        };
        [round.take_in_two, round.forecast, round.account] = self.tick_in_two();
        round
    }

    /// ns of the network alone, on as many rows as there are robots.
    fn kernel(&mut self) -> f64 {
        let start = Instant::now();
        self.network.predict(black_box(&self.rows), black_box(&mut self.forecasts_w));
        start.elapsed().as_nanos() as f64
    }

    /// ns of ingest, and of the rest.
    pub(super) fn tick_in_one(&mut self) -> (f64, f64) {
        self.one_pass(false, false)
    }

    /// ns of the whole tick that also writes the plan states, and of one that writes the outlooks.
    fn ticks_with_more(&mut self) -> [f64; 2] {
        [(true, false), (false, true)].map(|(plans, outlooks)| {
            let (take_ns, run_ns) = self.one_pass(plans, outlooks);
            take_ns + run_ns
        })
    }

    fn one_pass(&mut self, plans: bool, outlooks: bool) -> (f64, f64) {
        let now_ns = self.world.now_ns();
        let start = Instant::now();
        let (header, samples) = self.world.frame();
        self.fleet.take(black_box(header), black_box(samples), now_ns);
        let taken = Instant::now();
        self.fleet.begin(now_ns, false);
        let mut outputs = self.written.outputs(self.fleet.len());
        if !plans {
            outputs.secondary.plan_states = &mut [];
        }
        if !outlooks {
            outputs.secondary.outlooks = &mut [];
        }
        self.pool.run(self.fleet.shard(), outputs);
        let done = Instant::now();
        black_box(&self.written);
        self.world.advance();
        let ns = |from, to: Instant| to.duration_since(from).as_nanos() as f64;
        (ns(start, taken), ns(taken, done))
    }

    /// ns of ingest, of the forecasts, and of scoring, diagnostics and budgets, on the calling
    /// thread.
    fn tick_in_two(&mut self) -> [f64; 3] {
        let now_ns = self.world.now_ns();
        let Self { fleet, batch, written, .. } = self;
        let (header, samples) = self.world.frame();
        let start = Instant::now();
        fleet.take(black_box(header), black_box(samples), now_ns);
        let taken = Instant::now();
        fleet.begin(now_ns, false);
        fleet.shard().forecast(batch, &mut written.forecasts, &mut |_| {});
        let forecast = Instant::now();
        let robots = fleet.len();
        let secondary = SecondaryOutputs {
            plan_states: &mut [],
            outlooks: &mut [],
            ..written.outputs(robots).secondary
        };
        fleet.shard().account(batch, secondary, &mut |_| {});
        let done = Instant::now();
        black_box(&self.written);
        self.world.advance();
        let times = [(start, taken), (taken, forecast), (forecast, done)];
        times.map(|(from, to)| to.duration_since(from).as_nanos() as f64)
    }

    /// Ticks on a time grid, with a sleep before each.
    pub(super) fn paced(&mut self, rate_hz: u64, seconds: u64) -> Paced {
        let mut pace = Pace::every(Duration::from_nanos(1_000_000_000 / rate_hz));
        let mut paced = Paced { tick_us: Vec::new(), due_to_done_us: Vec::new(), missed: 0 };
        for _ in 0..seconds * rate_hz {
            let slot = pace.wait();
            let late_ns = clock::monotonic_ns().saturating_sub(slot.intended_ns);
            let (take_ns, run_ns) = self.tick_in_one();
            let tick_us = (take_ns + run_ns) * 1e-3;
            paced.tick_us.push(tick_us);
            paced.due_to_done_us.push(late_ns as f64 * 1e-3 + tick_us);
        }
        paced.missed = pace.grid().skipped();
        paced
    }
}

/// Threads that share every tick, each pinned to its own processor if there are several.
fn pool(threads: usize) -> anyhow::Result<TickPool> {
    let mut scheduling = Scheduling::default();
    if threads > 1 {
        let allowed = sched_getaffinity(None)?;
        scheduling.cpus = (0..CpuSet::MAX_CPU).filter(|cpu| allowed.is_set(*cpu)).collect();
        let mut first = CpuSet::new();
        scheduling.cpus.first().into_iter().for_each(|cpu| first.set(*cpu));
        sched_setaffinity(None, &first)?;
    }
    Ok(TickPool::new(threads, 1, &scheduling)?)
}

/// Settings of the demo: GTernal robots with a battery.
pub(super) fn settings(robots: usize, learning: bool) -> anyhow::Result<FleetSettings> {
    let demo = Demo {
        fleet: "bench".to_owned(),
        root: "/dev/shm/joulebus-bench".into(),
        prefix: "jbb_".to_owned(),
        robots: u32::try_from(robots).context("too many robots")?,
    };
    let config = Config::parse(&demo.toml(), Path::new("/"))?;
    let mut settings = config.settings().clone();
    settings.platforms[0].online = learning;
    Ok(settings)
}
