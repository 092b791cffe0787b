//! The paper's full training (32,000 rows, 100 epochs, batches of 256): time on one and two
//! threads.
//!
//! `cargo bench -p joulebus-train --bench train`
use std::time::Instant;

use joulebus_dataset::rows::Dataset;
use joulebus_predictor::FeatureSet;
use joulebus_sim::training_data::{SimulatedData, dataset_from_plant};
use joulebus_train::{TrainSettings, Training};

const EPOCHS: u32 = 100;

fn main() {
    let dataset = dataset_from_plant(SimulatedData {
        seed: 1,
        training_robots: 4,
        validation_robots: 1,
        held_out_robots: 1,
        full_speed_robots: 0,
        ticks: 8_005,
    });
    println!(
        "{} on {}, release profile: {} rows, {EPOCHS} epochs, batches of 256",
        env!("CARGO_PKG_VERSION"),
        std::env::consts::ARCH,
        dataset.training.len()
    );
    let mut hashes = Vec::new();
    for threads in [1, 2] {
        let (seconds, hash) = run(&dataset, threads);
        let rows_s = dataset.training.len() as f64 * f64::from(EPOCHS) / seconds;
        println!("{threads} thread(s): {seconds:.2} s, {:.2} million rows a second", rows_s / 1e6);
        hashes.push(hash);
    }
    assert_eq!(hashes[0], hashes[1], "the number of threads changes no bit");
}

fn run(dataset: &Dataset, threads: usize) -> (f64, u64) {
    let settings = TrainSettings {
        patience: EPOCHS,
        max_epochs: EPOCHS,
        ..TrainSettings::new("bench", "simulation", FeatureSet::Full, 1)
    };
    let start = Instant::now();
    let mut training = Training::new(dataset, &settings, threads).expect("sound data");
    while !training.is_done() {
        training.epoch().expect("it does not diverge");
    }
    let network = training.finish().expect("a sound network").network;
    (start.elapsed().as_secs_f64(), network.hash())
}
