//! On a part of the recordings, the online forecast is never much worse than its best member, it
//! beats the baselines where the network does not, and intervals keep their coverage per trial.

use std::path::PathBuf;

use crate::live::settings;
use joulebus_dataset::rows::{Dataset, Row, sample_rows, trial_rows};
use joulebus_dataset::trial::Trial;
use joulebus_eval::evaluate::evaluate_trial;
use joulebus_eval::score::{
    Cell, Design, ForecasterScore, Options, Recording, Role, Subject, recorded_platform, score,
};
use joulebus_predictor::{FeatureSet, Model, Network};
use joulebus_settings::{FleetSettings, Platform};
use joulebus_statistics::bootstrap::Bootstrap;
use joulebus_statistics::metrics::Tally;
use joulebus_testkit::recordings;
use joulebus_train::{TrainSettings, train};

/// With fewer readings, one changes a trial's coverage by half a percent or more.
const FEWEST_READINGS: u64 = 200;
/// Allowed deviation of a trial's coverage from the nominal one.
const TOLERANCE: f64 = 0.02;
/// The first readings of a trial.
const START: usize = 30;

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

/// Scores of a network trained on asphalt and flooring, on all of some trials of another terrain
/// and on each of them.
fn scores(terrain: &str) -> Option<(Cell, Vec<Cell>)> {
    let (asphalt, flooring) = (trials("ASPHALT", 7)?, trials("FLOORING", 6)?);
    let tested = trials(terrain, 6)?;
    let dataset = Dataset {
        training: [rows(&asphalt), rows(&flooring[..4])].concat(),
        held_out: rows(&tested),
        validation: rows(&flooring[4..]),
        description: "asphalt and flooring".to_owned(),
        period_s: 0.0,
    };
    let recipe = TrainSettings {
        max_epochs: 15,
        ..TrainSettings::new("husky", "recordings", FeatureSet::Full, 1)
    };
    let network = train(&dataset, &recipe, |_| ()).expect("sound rows").network;
    let platform = Platform {
        robots: vec![0..=u32::MAX],
        power_resolution_w: 0.24,
        ..recorded_platform(0, &tested[0])
    };
    check_start(&network, &platform, &tested);
    let recordings: Vec<Recording> =
        (0..).zip(tested).map(|(id, trial)| Recording::new(id, trial)).collect();
    let subject = Subject {
        settings: &settings(),
        platform: Some(&platform),
        models: &[Model::Network(network)],
        recordings: &recordings,
        design: &Design::folds(&recordings),
    };
    let options = Options {
        baselines: Vec::new(),
        bootstrap: Bootstrap { resamples: 0, ..Bootstrap::default() },
        ..Options::default()
    };
    let report = score(subject, &options).expect("settings that agree").report;
    Some((report.all, report.trials))
}

/// Over the first readings of the trials, the mean squared error of the online forecast is at most a
/// tenth of r₀² above that of persistence, where r₀ is the size of changes that an unknown robot
/// begins with. R² says little there: a robot that rests has no variance to explain.
fn check_start(network: &Network, platform: &Platform, trials: &[Trial]) {
    let (mut online, mut persistence) = (Tally::default(), Tally::default());
    for trial in trials {
        let of_trial = Platform {
            robots: platform.robots.clone(),
            power_resolution_w: platform.power_resolution_w,
            ..recorded_platform(0, trial)
        };
        let settings = FleetSettings { platforms: vec![of_trial], ..settings() };
        let model = Model::Network(network.clone());
        let live = evaluate_trial(&settings, &[model], 0, trial).expect("sound settings");
        let rows = sample_rows(&trial.to_samples(0, 1_000_000_000), trial.period_ns());
        for (row, seq) in rows.rows.iter().zip(&rows.sample_seq).take(START) {
            let power_w = live.steps[*seq as usize].power_w.map_or(f64::NAN, f64::from);
            let last_w = row.features[FeatureSet::PowerOnly.first()];
            online.add(row.target_w.into(), power_w, 0.0);
            persistence.add(row.target_w.into(), last_w.into(), 0.0);
        }
    }
    let changes_w = 0.8 * f64::from(network.card().residual.std_w);
    let r0_w = changes_w.max(platform.power_resolution_w.into());
    let [own, other] = [online, persistence].map(|tally| (tally.rmse_w() / r0_w).powi(2));
    assert!(own <= other + 0.1, "{own} of the forecast and {other} of the last reading, in r₀²");
}

/// R² of the published forecast, of persistence, and of the best member.
fn check(terrain: &str) -> Option<[f64; 3]> {
    let (all, trials) = scores(terrain)?;
    let of = |role| {
        let scores = all.forecasters.iter().filter(move |one: &&ForecasterScore| one.role == role);
        scores.map(|one| one.r2.value)
    };
    let members: Vec<f64> = of(Role::Member).collect();
    // The network, and the autoregression of its file.
    assert_eq!(members.len(), 2, "{terrain}");
    let persistence = of(Role::Baseline).next().expect("persistence");
    let online = of(Role::Published).next().expect("the model");
    println!("{terrain}: online {online:.4}, persistence {persistence:.4}, members {members:.4?}");
    let best = members.iter().copied().fold(persistence, f64::max);
    assert!(online >= best - 0.005, "{terrain}: {online}, {best}");
    let judged: Vec<&Cell> = trials.iter().filter(|one| one.rows >= FEWEST_READINGS).collect();
    assert!(!judged.is_empty(), "no trial of {FEWEST_READINGS} readings");
    for trial in judged {
        let interval = trial.forecasters[0].interval.expect("a network has intervals");
        let apart = (interval.scores.coverage - 0.9).abs();
        assert!(apart <= TOLERANCE + 1e-9, "{}: {}", trial.name, interval.scores.coverage);
    }
    Some([online, persistence, members[0]])
}

#[test]
fn on_ice_the_network_falls_below_persistence_and_the_online_forecast_does_not() {
    let Some([online, persistence, network]) = check("ICE") else { return };
    assert!(network < persistence, "the terrain must be a distribution shift");
    assert!(online >= persistence);
}

#[test]
fn on_snow_the_online_forecast_is_as_good_as_its_best_member_and_intervals_hold() {
    check("SNOW");
}
