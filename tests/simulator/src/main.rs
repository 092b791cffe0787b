//! Simulates whole fleets with faults, from seeds.
#![forbid(unsafe_code)]

use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::time::{Duration, Instant};

use clap::Parser as _;
use joulebus_program::exit::{self, Outcome};
use joulebus_program::output::{self, Format, Output};
use joulebus_program::stop::Stop;
use joulebus_simulator::campaign::{Campaign, play};
use joulebus_simulator::panics::keep_panics;

/// Simulates fleets: sources, worker, planners and recorder in one process on a simulated host,
/// with faults between any two of their operations. Exits with 1 if an invariant did not hold; the
/// report names the seed, the faults that are needed, and the command that does it again
#[derive(Debug, clap::Parser)]
#[command(name = "joulebus-sim", version)]
struct Arguments {
    /// Number of seeds
    #[arg(long, default_value_t = 100, conflicts_with = "seed")]
    seeds: u64,
    /// The first seed
    #[arg(long, default_value_t = 1, conflicts_with = "seed")]
    from: u64,
    /// This seed alone
    #[arg(long)]
    seed: Option<u64>,
    /// Simulated hours of each seed, instead of the seed's own duration (1 to 30 minutes). From 200
    /// hours on, the fleet is small and slow
    #[arg(long, value_parser = hours)]
    hours: Option<f64>,
    /// Fleets over three hosts, joined by links: five minutes each, unless `--hours` states others
    #[arg(long, conflicts_with_all = ["only", "until_ns"])]
    linked: bool,
    /// Threads; 0: one per processor
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Report a failing seed as it is, without looking for fewer faults that do the same
    #[arg(long)]
    no_shrink: bool,
    /// Only the faults of these numbers, separated by commas, or `none`: as a report states them
    #[arg(long, requires = "seed", value_parser = numbers)]
    only: Option<Numbers>,
    /// An earlier end of the faults, simulated ns: as a report states it
    #[arg(long, requires = "seed")]
    until_ns: Option<u64>,
    /// Output format of the report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Debug, Clone)]
struct Numbers(Vec<usize>);

fn numbers(text: &str) -> Result<Numbers, String> {
    if text == "none" {
        return Ok(Numbers(Vec::new()));
    }
    let parsed: Result<_, _> = text.split(',').map(str::parse).collect();
    parsed.map(Numbers).map_err(|error| format!("{error}: give numbers as 3,17, or none"))
}

fn hours(text: &str) -> Result<f64, String> {
    let hours: f64 = text.parse().map_err(|error| format!("{error}"))?;
    if !(0.001..=200_000.0).contains(&hours) {
        return Err("allowed are 0.001 to 200000 hours".to_owned());
    }
    Ok(hours)
}

/// Interval of lines of progress.
const PRINT_INTERVAL: Duration = Duration::from_secs(5);

fn main() -> ExitCode {
    match Arguments::try_parse() {
        Ok(arguments) => exit::code(work(&arguments)),
        Err(refused) => exit::refused(&refused),
    }
}

fn work(arguments: &Arguments) -> anyhow::Result<Outcome> {
    let stop = Stop::on_signals()?;
    keep_panics();
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let campaign = Campaign {
        first: arguments.seed.unwrap_or(arguments.from),
        seeds: if arguments.seed.is_some() { 1 } else { arguments.seeds },
        duration_ns: arguments.hours.map(|hours| (hours * 3_600e9) as u64),
        until_ns: arguments.until_ns,
        only: arguments.only.clone().map(|Numbers(numbers)| numbers),
        linked: arguments.linked,
        threads: if arguments.threads == 0 { processors } else { arguments.threads },
        shrinks: !arguments.no_shrink,
    };
    let printed = Mutex::new(Instant::now());
    let totals = play(&campaign, stop.flag(), |done| {
        let mut printed = printed.lock().unwrap_or_else(PoisonError::into_inner);
        if printed.elapsed() >= PRINT_INTERVAL {
            *printed = Instant::now();
            output::log_line(&format!("{done} of {} seeds", campaign.seeds));
        }
    });
    Output::new(arguments.format).report(&totals)?;
    Ok(match totals.failed.is_empty() {
        false => Outcome::Failed,
        true => Outcome::unless_lost(totals.seeds < campaign.seeds),
    })
}
