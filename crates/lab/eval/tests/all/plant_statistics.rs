//! The simulated robots against the paper's mean, deviation and autocorrelation of power.

use joulebus_dataset::trial::Column;
use joulebus_eval::analyze::autocorrelation;
use joulebus_plant::parts::Parts;
use joulebus_plant::protocol::{Protocol, SAMPLES};
use joulebus_sim::protocol::drive_with;

/// Mean and standard deviation of all readings of the six trials of a seed, W, and the mean of
/// their autocorrelations at a lag of one row.
fn statistics(seed: u64) -> [f64; 3] {
    let trials =
        Protocol::ALL.map(|protocol| drive_with(protocol, Parts::default(), seed, SAMPLES));
    let column =
        |trial| Vec::from(joulebus_dataset::trial::Trial::column(trial, Column::Power).unwrap());
    let power_w: Vec<f64> = trials.iter().flat_map(column).collect();
    let count = power_w.len() as f64;
    let mean_w = power_w.iter().sum::<f64>() / count;
    let squares_w2: f64 = power_w.iter().map(|power_w| (power_w - mean_w).powi(2)).sum();
    let rho1 = trials.each_ref().map(|trial| autocorrelation(trial, 1).at_lag[0].unwrap());
    [mean_w, (squares_w2 / count).sqrt(), rho1.iter().sum::<f64>() / rho1.len() as f64]
}

/// The table of `docs/measured/plant.md` has further figures, as they were measured. No choice was
/// made on these seeds.
#[test]
fn mean_deviation_and_autocorrelation_of_power_are_the_papers() {
    let seeds: Vec<[f64; 3]> = (201..209).map(statistics).collect();
    for (at, (name, paper, tolerance)) in [
        ("mean, W", 3.652, 0.04),
        ("deviation, W", 0.375, 0.02),
        ("autocorrelation at one row", 0.95, 0.004),
    ]
    .into_iter()
    .enumerate()
    {
        let found = seeds.iter().map(|one| one[at]).sum::<f64>() / seeds.len() as f64;
        println!("{name}: {found:.4}, the paper {paper}");
        assert!((found - paper).abs() <= tolerance, "{name}: {found}, the paper {paper}");
    }
}
