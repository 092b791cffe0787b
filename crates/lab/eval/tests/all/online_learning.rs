//! On a part of the recordings, the online forecast is never much worse than its best member, it
//! beats the baselines where the network does not, and intervals keep their coverage per trial.

use std::path::PathBuf;

use crate::live::settings;
use joulebus_dataset::rows::trial_rows;
use joulebus_dataset::rows::{Dataset, Row};
use joulebus_dataset::trial::Trial;
use joulebus_eval::online_learning::{FEWEST_READINGS, Judged, TOLERANCE, judge};
use joulebus_eval::score::recorded_platform;
use joulebus_predictor::FeatureSet;
use joulebus_settings::Platform;
use joulebus_statistics::metrics::Tally;
use joulebus_testkit::recordings;
use joulebus_train::{TrainSettings, train};

/// The first trials of a terrain. `None` without recordings.
fn trials(terrain: &str, count: usize) -> Option<Vec<Trial>> {
    let mut paths = recordings::trials("borealtc_husky")?;
    paths.retain(|path| path.to_string_lossy().contains(&format!("/{terrain}_")));
    let read = |path: &PathBuf| Trial::read(path).expect("a recording");
    Some(paths.iter().take(count).map(read).collect())
}

fn rows(trials: &[Trial]) -> Vec<Row> {
    trials.iter().flat_map(|trial| trial_rows(trial).rows).collect()
}

/// A network trained on asphalt and flooring, tested on some trials of another terrain.
fn judged(terrain: &str) -> Option<Judged> {
    let (asphalt, flooring) = (trials("ASPHALT", 7)?, trials("FLOORING", 6)?);
    let validation = rows(&flooring[4..]);
    let tested = trials(terrain, 6)?;
    let dataset = Dataset {
        training: [rows(&asphalt), rows(&flooring[..4])].concat(),
        held_out: rows(&tested),
        validation,
        description: "asphalt and flooring".to_owned(),
        period_s: 0.0,
    };
    let recipe = TrainSettings {
        max_epochs: 15,
        ..TrainSettings::new("husky", "recordings", FeatureSet::Full, 1)
    };
    let network = train(&dataset, &recipe, |_| ()).expect("sound rows").network;
    let platform = Platform { power_resolution_w: 0.24, ..recorded_platform(0, &tested[0]) };
    let tested: Vec<&Trial> = tested.iter().collect();
    Some(judge(&network, &platform, &settings(), &tested).expect("settings that agree"))
}

fn check(terrain: &str) -> Option<Judged> {
    let judged = judged(terrain)?;
    let [network, .., both] = &judged.variants;
    let linear = judged.linear.as_ref().map_or(f64::NAN, Tally::r2);
    println!(
        "{terrain}: persistence {:.4}, linear {linear:.4}, network {:.4}, online {:.4}",
        judged.persistence.r2(),
        network.forecasts.r2(),
        both.forecasts.r2()
    );
    // Of the online forecast: its own first readings are part of its squared error.
    let [of_persistence, own] = judged.start_shares(1);
    let starts: f64 = both.squares.starts.iter().sum();
    let expected = starts / (both.squares.first + both.squares.later);
    assert!((own - expected).abs() <= 1e-9 * expected, "{terrain}: {own}, {expected}");
    assert!(of_persistence.is_finite(), "{terrain}: {of_persistence}");
    let mixed = both.forecasts.r2();
    assert!(mixed >= judged.best_member_r2() - 0.005, "{terrain}: {mixed}");
    for variant in &judged.variants {
        assert!(!variant.coverage.is_empty(), "no trial of {FEWEST_READINGS} readings");
        for coverage in &variant.coverage {
            let apart = (coverage - 0.9).abs();
            assert!(apart <= TOLERANCE + 1e-9, "{terrain}: {:?}", variant.coverage);
        }
    }
    Some(judged)
}

#[test]
fn on_ice_the_network_falls_below_persistence_and_the_online_forecast_does_not() {
    let Some(judged) = check("ICE") else { return };
    let [network, .., both] = &judged.variants;
    assert!(
        network.forecasts.r2() < judged.persistence.r2(),
        "the terrain must be a distribution shift"
    );
    assert!(both.forecasts.r2() >= judged.persistence.r2());
}

#[test]
fn on_snow_the_online_forecast_is_as_good_as_its_best_member_and_intervals_hold() {
    check("SNOW");
}
