//! The tick alone: ingest, forecasts, scoring and writing, compared with the bare kernel.

mod bench;

use std::thread;

use crate::arguments::{BenchOptions, TickFleet};
use anyhow::{Context as _, anyhow};
use clap::ValueEnum as _;
use joulebus_predictor::Network;
use joulebus_settings::FleetSettings;

use crate::figure::robots;
use crate::{Figure, Report, input, kernel};
use bench::{Bench, Round};

/// Fleets measured by default.
const ROBOTS: [usize; 5] = [100, 1_000, 10_000, 100_000, 300_000];
/// Ticks before the measurement starts, until windows are full and intervals and alarms have
/// settled.
const WARM_UP: usize = 40;
/// Maximum number of back-to-back rounds.
const MAX_REPETITIONS: usize = 1_000;
/// Minimum fleet size whose memory is reported. Smaller ones are lost in that of the process.
const LEAST_WEIGHED: usize = 10_000;

/// Measures a tick of fleets of several sizes, back to back and paced.
///
/// # Errors
/// The model cannot be read, or a requested kernel is not supported here.
pub(crate) fn measure(options: &BenchOptions) -> anyhow::Result<Report> {
    let (name, network) = input::network(options.model.as_deref())?;
    let kernel = kernel::fastest(options.kernel.as_deref())?;
    let network = kernel::on(&network, kernel)?;
    let fleet = options.fleet.to_possible_value();
    let fleet = fleet.context("no such fleet")?;
    let mut report = Report::new("tick")
        .with_input("model", name)
        .with_input("kernel", kernel::name(kernel))
        .with_input("fleet", fleet.get_name())
        .with_input("seed", options.seed)
        .with_input("rate_hz", options.rate_hz)
        .with_input("paced_s", options.seconds_or(10));
    let mut sized = Vec::new();
    for size in options.sizes(&ROBOTS) {
        eprintln!("tick: {}", robots(size));
        sized.push(figures(&network, size, options)?);
    }
    // Sorted by name, so that sizes are adjacent.
    let names = sized.iter().max_by_key(|figures| figures.len());
    let names: Vec<String> =
        names.iter().flat_map(|figures| figures.iter().map(|figure| figure.name.clone())).collect();
    for name in &names {
        let of_name = sized.iter().flatten().filter(|figure| figure.name == *name);
        report.figures.extend(of_name.cloned());
    }
    report.notes = [
        "Every robot sends a sample each tick. Ingest, forecasts, scoring and writing into \
         existing memory are measured. Shared memory and waking are not.",
        "Back to back: kernel, tick in one pass and tick in two passes are interleaved. In two: first forecasts \
         (features, network, intervals, forecasts written), then scoring (residuals, \
         scores, alarms, ledgers, diagnostics and budgets written).",
        "Without plan states and outlooks, which a worker writes while somebody reads them. \
            tick_with_plan_states_over_tick and tick_with_outlooks_over_tick compare neighbouring \
         ticks in one pass with and without.",
        "Paced: the tick starts after a sleep, and `due` is the grid time. A grid time that a \
         late tick skipped is a missed tick.",
    ]
    .map(str::to_owned)
    .to_vec();
    Ok(report)
}

/// Settings of a fleet of one platform.
pub(crate) fn uniform_settings(robots: usize) -> anyhow::Result<FleetSettings> {
    bench::settings(TickFleet::Uniform, robots)
}

fn figures(network: &Network, size: usize, options: &BenchOptions) -> anyhow::Result<Vec<Figure>> {
    let mut report = Report::new("tick");
    let mut bench = Bench::new(network, (options.fleet, size), 1, options.seed)?;
    let one = back_to_back(&mut bench, options);
    push_one_thread(&mut report, size, &one);
    if size >= LEAST_WEIGHED {
        let each: Vec<f64> =
            bench.own_bytes().map(|bytes| bytes / size as f64).into_iter().collect();
        let title = "fleet_bytes_per_robot";
        report.push(Figure::less, title, &robots(size), "bytes", &each);
    }
    paced(&mut report, "1_thread", &mut bench, options);
    drop(bench);
    if options.threads > 1 {
        // The pool's first thread belongs to it permanently, so it gets a new thread.
        let shared = || -> anyhow::Result<()> {
            let mut bench =
                Bench::new(network, (options.fleet, size), options.threads, options.seed)?;
            let several = back_to_back(&mut bench, options);
            push_several(&mut report, size, options.threads, &one, &several);
            let title = format!("{}_threads", options.threads);
            paced(&mut report, &title, &mut bench, options);
            Ok(())
        };
        let done = thread::scope(|scope| scope.spawn(shared).join());
        done.map_err(|_| anyhow!("measuring panicked"))??;
    }
    Ok(report.figures)
}

fn back_to_back(bench: &mut Bench, options: &BenchOptions) -> Vec<Round> {
    for _ in 0..WARM_UP {
        bench.tick_in_one();
    }
    let most = options.repetitions().clamp(1, MAX_REPETITIONS);
    let mut rounds = Vec::new();
    let start = std::time::Instant::now();
    while rounds.len() < most && (rounds.len() < 5 || start.elapsed() < options.each()) {
        rounds.push(bench.round());
    }
    rounds
}

fn values(rounds: &[Round], of: impl Fn(&Round) -> f64) -> Vec<f64> {
    rounds.iter().map(of).collect()
}

fn push_one_thread(report: &mut Report, size: usize, rounds: &[Round]) {
    let case = robots(size);
    let each = 1.0 / size as f64;
    let mut ns = |name: &str, of: fn(&Round) -> f64| {
        let values = values(rounds, |round| of(round) * each);
        report.push(Figure::less, &format!("{name}_ns_per_robot"), &case, "ns", &values);
    };
    ns("tick", |round| round.tick());
    ns("take", |round| round.take);
    ns("features", |round| round.stages[0]);
    ns("network", |round| round.stages[1]);
    ns("bookkeeping", |round| round.stages[2]);
    ns("writing", |round| round.stages[3]);
    ns("tick_in_two", |round| round.take_in_two + round.forecast + round.account);
    ns("forecast", |round| round.forecast);
    ns("account", |round| round.account);
    ns("kernel", |round| round.kernel);
    let mut ratio = |name: &str, of: fn(&Round) -> f64| {
        report.push(Figure::less, name, &case, "1", &values(rounds, of));
    };
    ratio("tick_over_kernel", |round| round.tick() / round.kernel);
    ratio("tick_with_plan_states_over_tick", |round| round.with_plan_states / round.tick());
    ratio("tick_with_outlooks_over_tick", |round| round.with_outlooks / round.tick());
    ratio("forecast_over_kernel", |round| round.forecast / round.kernel);
    ratio("take_and_forecast_over_kernel", |round| {
        (round.take_in_two + round.forecast) / round.kernel
    });
    ratio("account_share_of_tick", |round| {
        round.account / (round.take_in_two + round.forecast + round.account)
    });
}

fn push_several(
    report: &mut Report,
    size: usize,
    threads: usize,
    one: &[Round],
    several: &[Round],
) {
    let case = robots(size);
    let each = values(several, |round| round.tick() / size as f64);
    let title = format!("tick_{threads}_threads_ns_per_robot");
    report.push(Figure::less, &title, &case, "ns", &each);
    let median = |rounds: &[Round], of: fn(&Round) -> f64| {
        crate::Distribution::new(&values(rounds, of)).map_or(f64::NAN, |all| all.p50)
    };
    for (name, of) in [
        ("tick", Round::tick as fn(&Round) -> f64),
        ("tick_without_take", |round: &Round| round.run),
    ] {
        let speed_up = [median(one, of) / median(several, of)];
        let title = format!("{name}_{threads}_over_1_threads_speed_up");
        report.push(Figure::more, &title, &case, "1", &speed_up);
    }
}

/// On a time grid, with a sleep before each tick.
fn paced(report: &mut Report, title: &str, bench: &mut Bench, options: &BenchOptions) {
    let period_us = 1e6 / options.rate_hz as f64;
    let paced = bench.paced(options.rate_hz, options.seconds_or(10));
    let case = robots(bench.robots());
    let shard: Vec<f64> = paced.due_to_done_us.iter().map(|us| us / period_us).collect();
    let mut less = |name: &str, unit: &str, values: &[f64]| {
        let name = name.replacen('_', &format!("_{title}_"), 1);
        report.push(Figure::less, &name, &case, unit, values);
    };
    less("paced_tick_us", "µs", &paced.tick_us);
    less("paced_due_to_done_us", "µs", &paced.due_to_done_us);
    less("paced_share_of_period", "1", &shard);
    less("paced_missed_ticks", "ticks", &[paced.missed as f64]);
}
