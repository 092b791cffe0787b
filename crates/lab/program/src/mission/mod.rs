//! `joulebus mission`: missions of simulated robots under several policies.

mod arguments;

use std::sync::atomic::{AtomicUsize, Ordering};

use joulebus_mission::{
    CHOSEN, MissionError, Outcome, Policy, Runs, Scenario, Summary, mission, tried,
};
use joulebus_program::exit::Outcome as Exit;
use joulebus_program::output::{Output, log_line};
use rayon::prelude::*;

pub(crate) use arguments::Args;

/// First seed of the comparison, and of tuning.
const SEED: u64 = 1;
const TUNING_SEED: u64 = 1001;

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Exit> {
    let scenario = Scenario {
        duration_s: 3600.0 * args.hours,
        capacity_j: 3600.0 * args.battery_wh,
        ..Scenario::default()
    };
    let mut policies = if args.tune { tried() } else { CHOSEN.to_vec() };
    if args.oracle {
        policies.insert(0, Policy::Oracle);
    }
    let first_seed = if args.tune { TUNING_SEED } else { SEED };
    let runs = all(&scenario, &policies, first_seed, args.seeds)?;
    let summary = Summary::new(scenario, first_seed, &runs);
    output.report(&summary)?;
    Ok(Exit::Done)
}

/// Every mission, in parallel. Progress on stderr.
fn all(
    scenario: &Scenario,
    policies: &[Policy],
    first_seed: u64,
    seeds: u64,
) -> Result<Vec<Runs>, MissionError> {
    let asked: Vec<(Policy, u64)> = (first_seed..first_seed + seeds)
        .flat_map(|seed| policies.iter().map(move |policy| (*policy, seed)))
        .collect();
    let (done, total) = (AtomicUsize::new(0), asked.len());
    let outcomes: Vec<Outcome> = asked
        .par_iter()
        .map(|(policy, seed)| {
            let outcome = mission(scenario, *policy, *seed);
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            // A line for each tenth.
            if done * 10 / total != (done - 1) * 10 / total {
                log_line(&format!("{done} of {total} missions"));
            }
            outcome
        })
        .collect::<Result<_, _>>()?;
    let of = |place: usize| outcomes.iter().skip(place).step_by(policies.len()).cloned();
    let runs = policies
        .iter()
        .enumerate()
        .map(|(place, policy)| Runs { policy: *policy, outcomes: of(place).collect() });
    Ok(runs.collect())
}
