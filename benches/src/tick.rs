//! The tick alone: ingest, forecasts, scoring and writing, compared with the bare kernel.

mod bench;
mod world;

use std::thread;

use crate::arguments::BenchOptions;
use anyhow::anyhow;
use joulebus_predictor::Network;
use joulebus_settings::FleetSettings;

use crate::input::RATE_HZ;
use crate::report::{quantile, robots};
use crate::{Report, kernel};
use bench::{Bench, Round};

/// Fleets measured by default.
const ROBOTS: [usize; 5] = [100, 1_000, 10_000, 100_000, 300_000];
/// Ticks before the measurement starts, until windows are full and intervals and alarms have
/// settled.
const WARM_UP: usize = 40;
/// Threads of the second measurement.
const THREADS: usize = 2;
/// Minimum fleet size whose memory is reported. Smaller ones are lost in that of the process.
const LEAST_WEIGHED: usize = 10_000;

/// Measures a tick of fleets of several sizes, back to back and paced.
///
/// # Errors
/// A requested kernel is not supported here.
pub(crate) fn measure(options: &BenchOptions) -> anyhow::Result<Report> {
    let (network, report) = kernel::chosen("tick", options)?;
    let mut report = report
        .with_input("fleet", if options.learning { "learning" } else { "not learning" })
        .with_input("rate_hz", RATE_HZ)
        .with_input("paced_s", options.paced_s(10));
    for size in options.sizes(&ROBOTS) {
        eprintln!("tick: {}", robots(size));
        figures(&mut report, &network, size, options)?;
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
pub(crate) fn settings(robots: usize) -> anyhow::Result<FleetSettings> {
    bench::settings(robots, false)
}

fn figures(
    report: &mut Report,
    network: &Network,
    size: usize,
    options: &BenchOptions,
) -> anyhow::Result<()> {
    let mut bench = Bench::new(network, size, 1, options.learning)?;
    let one = back_to_back(&mut bench, options);
    push_one_thread(report, size, &one);
    if size >= LEAST_WEIGHED {
        let each: Vec<f64> = bench.own_bytes().iter().map(|bytes| bytes / size as f64).collect();
        report.less("fleet_bytes_per_robot", &robots(size), "bytes", &each);
    }
    paced(report, "1_thread", &mut bench, options);
    drop(bench);
    // The pool's first thread belongs to it permanently, so it gets a new thread.
    let shared = || -> anyhow::Result<()> {
        let mut bench = Bench::new(network, size, THREADS, options.learning)?;
        let several = back_to_back(&mut bench, options);
        push_several(report, size, &one, &several);
        paced(report, &format!("{THREADS}_threads"), &mut bench, options);
        Ok(())
    };
    let done = thread::scope(|scope| scope.spawn(shared).join());
    done.map_err(|_| anyhow!("measuring panicked"))?
}

fn back_to_back(bench: &mut Bench, options: &BenchOptions) -> Vec<Round> {
    for _ in 0..WARM_UP {
        bench.tick_in_one();
    }
    let most = options.rounds(kernel::ROUNDS);
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
        report.less(&format!("{name}_ns_per_robot"), &case, "ns", &values);
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
        report.less(name, &case, "1", &values(rounds, of));
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

fn push_several(report: &mut Report, size: usize, one: &[Round], several: &[Round]) {
    let case = robots(size);
    let each = values(several, |round| round.tick() / size as f64);
    report.less(&format!("tick_{THREADS}_threads_ns_per_robot"), &case, "ns", &each);
    let speed_up = |of: fn(&Round) -> f64| {
        [quantile(&values(one, of), 0.5) / quantile(&values(several, of), 0.5)]
    };
    let mut more = |name: &str, speed_up: [f64; 1]| {
        report.more(&format!("{name}_{THREADS}_over_1_threads_speed_up"), &case, "1", &speed_up);
    };
    more("tick", speed_up(Round::tick));
    more("tick_without_take", speed_up(|round| round.run));
}

/// On a time grid, with a sleep before each tick.
fn paced(report: &mut Report, title: &str, bench: &mut Bench, options: &BenchOptions) {
    let period_us = 1e6 / RATE_HZ as f64;
    let paced = bench.paced(RATE_HZ, options.paced_s(10));
    let case = robots(bench.robots());
    let share: Vec<f64> = paced.due_to_done_us.iter().map(|us| us / period_us).collect();
    let mut less = |name: &str, unit: &'static str, values: &[f64]| {
        let name = name.replacen('_', &format!("_{title}_"), 1);
        report.less(&name, &case, unit, values);
    };
    less("paced_tick_us", "µs", &paced.tick_us);
    less("paced_due_to_done_us", "µs", &paced.due_to_done_us);
    less("paced_share_of_period", "1", &share);
    less("paced_missed_ticks", "ticks", &[paced.missed as f64]);
}
