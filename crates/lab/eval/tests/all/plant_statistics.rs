//! The simulated robots against the paper's figures.

#[allow(dead_code, reason = "the test uses some of it, the example other parts")]
#[path = "../../examples/plant/statistics.rs"]
mod statistics;

use std::path::Path;

use joulebus_plant::parts::Parts;
use joulebus_sim::scenario::SCENARIO_STEPS;
use statistics::{Averaged, Basics, measure, six_trials};

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    values.sum::<f64>() / count
}

/// The table of `docs/measured/plant.md`, recomputed.
#[test]
fn every_figure_of_the_paper_is_within_its_band_on_average_and_in_the_docs() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/measured/plant.md");
    let docs = std::fs::read_to_string(docs).expect("the docs are in the repository");
    let seeds: Vec<_> = (1..=10)
        .map(|seed| {
            let measured = measure(Parts::default(), seed, SCENARIO_STEPS).expect("sound data");
            measured.figures()
        })
        .collect();
    let mut wrong = Vec::new();
    for averaged in Averaged::of(&seeds) {
        println!("{averaged}");
        if !averaged.figure.holds() {
            wrong.push(format!("not within its band: {averaged}"));
        }
        if !docs.contains(&averaged.to_string()) {
            wrong.push(format!("docs/measured/plant.md lacks {averaged}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn the_fit_holds_for_other_seeds() {
    let all: Vec<Basics> = (201..209)
        .map(|seed| {
            let (trials, rows) = six_trials(Parts::default(), seed);
            Basics::new(&trials, &rows)
        })
        .collect();
    let average = |figure: fn(&Basics) -> f64| mean(all.iter().map(figure));
    let figures: [(&str, f64, f64, f64); 6] = [
        ("mean, W", average(|b| b.mean_w), 3.652, 0.04),
        ("deviation, W", average(|b| b.std_w), 0.375, 0.02),
        ("lowest, W", average(|b| b.min_w), 3.0, 0.15),
        ("ρ₁", average(|b| mean(b.rho1.iter().copied())), 0.95, 0.004),
        ("R² of velocities", average(|b| b.r2_velocities), 0.16, 0.03),
        ("R² with one lag", average(|b| b.r2_one_lag), 0.90, 0.01),
    ];
    for (name, found, paper, tolerance) in figures {
        println!("{name}: {found:.4}, the paper {paper}");
        assert!((found - paper).abs() <= tolerance, "{name}: {found}, the paper {paper}");
    }
}
