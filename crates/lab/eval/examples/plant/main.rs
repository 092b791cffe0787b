//! The table of the simulated plant for the docs, and the fit of its parameters.
//!
//! `cargo run --release -p joulebus-eval --example plant -- table` prints the table of
//! `docs/measured/plant.md`; `-- fit` searches for the parameters and prints improvements.
//! `name=value` after either overrides a parameter, as in `-- table burst_w=0.4`.

#[allow(dead_code, reason = "the test uses some of it, the example other parts")]
mod statistics;

use std::process::ExitCode;

use joulebus_plant::parts::Parts;
use joulebus_sim::scenario::SCENARIO_STEPS;
use statistics::{Averaged, Figure, TARGETS, Target, measure};

/// Number of seeds, from 1, over which the table gives mean and deviation.
const SEEDS: u64 = 10;

type Part = fn(&mut Parts) -> &mut f64;

const PARTS: [(&str, Part); 23] = [
    ("electronics_w", |p| &mut p.electronics_w),
    ("electronics_spread_w", |p| &mut p.electronics_spread_w),
    ("drift_w", |p| &mut p.drift_w),
    ("drift_time_s", |p| &mut p.drift_time_s),
    ("processor_w", |p| &mut p.processor_w),
    ("processor_time_s", |p| &mut p.processor_time_s),
    ("friction_w_per_mps", |p| &mut p.friction_w_per_mps),
    ("losses_w_per_m2ps2", |p| &mut p.losses_w_per_m2ps2),
    ("acceleration_w_per_m2ps3", |p| &mut p.acceleration_w_per_m2ps3),
    ("friction_spread", |p| &mut p.friction_spread),
    ("roughness", |p| &mut p.roughness),
    ("roughness_time_s", |p| &mut p.roughness_time_s),
    ("motor_time_s", |p| &mut p.motor_time_s),
    ("thermal_share", |p| &mut p.thermal_share),
    ("thermal_time_s", |p| &mut p.thermal_time_s),
    ("bursts_per_s", |p| &mut p.bursts_per_s),
    ("bursts_per_neighbour_s", |p| &mut p.bursts_per_neighbour_s),
    ("burst_w", |p| &mut p.burst_w),
    ("burst_time_s", |p| &mut p.burst_time_s),
    ("burst_cut_per_neighbour", |p| &mut p.burst_cut_per_neighbour),
    ("stall_chance", |p| &mut p.stall_chance),
    ("stall_w", |p| &mut p.stall_w),
    ("monitor_noise_w", |p| &mut p.monitor_noise_w),
];

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let what = arguments.next().unwrap_or_default();
    let mut parts = Parts::default();
    let mut seeds = SEEDS;
    for argument in arguments {
        let Some((name, value)) = argument.split_once('=') else {
            eprintln!("{argument}: expected name=value");
            return ExitCode::from(2);
        };
        let value: f64 = value.parse().unwrap_or(f64::NAN);
        if name == "seeds" {
            seeds = value as u64;
        } else if let Some((_, part)) = PARTS.iter().find(|(known, _)| *known == name) {
            *part(&mut parts) = value;
        } else {
            eprintln!("{name}: no such parameter");
            return ExitCode::from(2);
        }
    }
    match what.as_str() {
        "table" => table(parts, seeds),
        "fit" => fit(parts),
        _ => return ExitCode::from(2),
    }
    ExitCode::SUCCESS
}

fn figures(parts: Parts, seed: u64) -> Vec<Figure> {
    let measured =
        measure(parts, seed, SCENARIO_STEPS).expect("training on the plant's data succeeds");
    measured.figures()
}

/// The figures of the seeds from 1 to `seeds`. Those whose mean is outside its band are named on
/// stderr.
fn table(parts: Parts, seeds: u64) {
    let all: Vec<Vec<Figure>> = (1..=seeds).map(|seed| figures(parts, seed)).collect();
    println!("| figure | paper | plant, mean ± deviation | mean held within | role |");
    println!("|---|---|---|---|---|");
    for averaged in Averaged::of(&all) {
        println!("{averaged}");
        if !averaged.figure.holds() {
            eprintln!("out of its band: {averaged}");
        }
    }
}

/// Seeds of the fit, disjoint from the table's.
const FIT_SEEDS: std::ops::Range<u64> = 101..105;
/// Parameters of the fit with the initial step of each, as a share of its value.
const FREE: [(&str, f64); 9] = [
    ("electronics_w", 0.01),
    ("processor_w", 0.2),
    ("friction_w_per_mps", 0.15),
    ("roughness", 0.3),
    ("bursts_per_s", 0.15),
    ("burst_w", 0.1),
    ("burst_time_s", 0.1),
    ("bursts_per_neighbour_s", 0.3),
    ("burst_cut_per_neighbour", 0.5),
];
const SWEEPS: usize = 2;

/// Sum of squared deviations of the figures from their targets.
fn misfit(parts: Parts, report: bool) -> f64 {
    let all: Vec<Vec<Figure>> = FIT_SEEDS.map(|seed| figures(parts, seed)).collect();
    let mut sum = 0.0;
    for Target { name, value, scale } in TARGETS {
        let found = all.iter().flatten().filter(|figure| figure.name == name);
        let found: Vec<f64> = found.map(|figure| figure.found).collect();
        assert!(!found.is_empty(), "{name} is a figure");
        let mean = found.iter().sum::<f64>() / found.len() as f64;
        if report {
            println!("  {name}: {mean:.4}, target {value}");
        }
        let off = (mean - value) / scale;
        sum += off * off;
    }
    sum
}

/// Coordinate search: each parameter up and down by its step, which is halved when neither
/// improves.
fn fit(mut parts: Parts) {
    let mut best = misfit(parts, true);
    println!("misfit {best:.2}");
    let mut steps = FREE.map(|(_, step)| step);
    for _ in 0..SWEEPS {
        for ((name, _), step) in FREE.iter().zip(&mut steps) {
            let (_, part) = PARTS.iter().find(|(known, _)| known == name).expect("a part");
            let helped = [1.0 + *step, 1.0 / (1.0 + *step)].into_iter().any(|factor| {
                let mut tried = parts;
                *part(&mut tried) *= factor;
                let found = misfit(tried, false);
                let helps = found < best;
                if helps {
                    (parts, best) = (tried, found);
                    eprintln!("misfit {best:.2}: {name} {:.4}", *part(&mut tried));
                }
                helps
            });
            *step *= if helped { 1.3 } else { 0.5 };
        }
    }
    misfit(parts, true);
    for (name, part) in PARTS {
        println!("{name}: {:.4}", part(&mut parts));
    }
}
