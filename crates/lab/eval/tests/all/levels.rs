//! Levels on real recordings: loads on floors that nobody trained on, and healthy robots on other
//! terrains.

use std::path::{Path, PathBuf};

use joulebus_config::Config;
use joulebus_dataset::rows::{Dataset, Row, RowOrigin, trial_rows};
use joulebus_dataset::trial::Trial;
use joulebus_fleet::Fleet;
use joulebus_predictor::{FeatureSet, Model};
use joulebus_settings::FleetSettings;
use joulebus_testkit::recordings;
use joulebus_train::{TrainSettings, train};
use joulebus_wire::{AlarmSet, SCHEMA_VERSION, Sample, SampleHeader};
use rayon::prelude::*;

/// The groups of recordings that are left out in turn: the beginnings of their names.
const SETS: [(&str, FeatureSet, &[&str]); 3] = [
    (
        "robotino",
        FeatureSet::Full,
        &[
            "one_surface_type_brown",
            "one_surface_type_gray",
            "one_surface_type_green",
            "one_surface_type_table",
            "wheel_load",
        ],
    ),
    ("borealtc_husky", FeatureSet::Full, &["ASPHALT", "FLOORING", "ICE", "MIXED", "SANDY", "SNOW"]),
    ("ase_rover", FeatureSet::PowerOnly, &["baseline", "final"]),
];

/// The shipped settings with one platform.
fn settings(platform: &str) -> FleetSettings {
    let text = format!(
        "[fleet]\nname = \"lab\"\ncapacity = 1\n[intake]\nleave_after_s = 3600.0\n\
         [[platform]]\nfile = \"builtin:{platform}\"\nrobots = [0]\n"
    );
    let config = Config::parse(&text, Path::new("fleet.toml")).unwrap();
    config.settings().clone()
}

fn period_s(settings: &FleetSettings) -> f32 {
    settings.platforms[0].period_ns as f32 * 1e-9
}

fn named(path: &Path, words: &[&str]) -> bool {
    let name = path.file_name().unwrap().to_string_lossy();
    words.iter().any(|word| name.starts_with(word))
}

/// The recordings whose names begin with one of these words, and the others.
fn divided(folder: &str, words: &[&str]) -> Option<[Vec<Trial>; 2]> {
    let (own, others): (Vec<PathBuf>, Vec<PathBuf>) =
        recordings::trials(folder)?.into_iter().partition(|path| named(path, words));
    let read = |path: &PathBuf| Trial::read(path).unwrap();
    Some([own, others].map(|paths| paths.iter().map(read).collect()))
}

/// A network trained on these recordings. Of each seven, one decides when to stop, and one is held
/// out.
fn network(trials: &[Trial], period_s: f32, feature_set: FeatureSet, max_epochs: u32) -> Model {
    let part = |sevenths: std::ops::Range<usize>| -> Vec<Row> {
        let each = trials.iter().enumerate();
        each.filter(|(place, _)| sevenths.contains(&(place % 7)))
            .flat_map(|(place, trial)| {
                let origin = RowOrigin::recording(place);
                trial_rows(trial).rows.into_iter().map(move |row| row.of(origin))
            })
            .collect()
    };
    let dataset = Dataset {
        training: part(0..5),
        held_out: part(5..6),
        validation: part(6..7),
        description: "recordings".to_owned(),
        period_s,
    };
    let recipe =
        TrainSettings { max_epochs, ..TrainSettings::new("levels", "recordings", feature_set, 1) };
    Model::Network(train(&dataset, &recipe, |_| ()).unwrap().network)
}

/// The network has seen grey and brown floors alone. The constants were chosen with all floors in
/// view, so this is no blind test.
#[test]
#[ignore = "trains and plays for minutes: CONTRIBUTING.md has the command"]
fn loads_are_found_on_floors_that_nobody_trained_on() {
    let words = ["one_surface_type_gray_surface", "one_surface_type_brown_surface"];
    let Some([own, others]) = divided("robotino", &words) else {
        return;
    };
    let settings = settings("robotino");
    let model = network(&own, period_s(&settings), FeatureSet::Full, 15);
    let delay_s = |trial: &Trial| {
        let (samples, from_ns) = loaded(trial);
        let (raised_ns, _) = raised(&settings, &model, &samples);
        let first_ns = raised_ns.into_iter().find(|at_ns| *at_ns >= from_ns);
        first_ns.map_or(f64::INFINITY, |at_ns| (at_ns - from_ns) as f64 * 1e-9)
    };
    let mut delays_s: Vec<f64> = others.par_iter().map(delay_s).collect();
    delays_s.sort_by(f64::total_cmp);
    let found = delays_s.iter().filter(|delay_s| delay_s.is_finite()).count();
    let median_s = delays_s[delays_s.len() / 2];
    println!("{found} of {} loads found, after {median_s:.1} s", delays_s.len());
    assert!(found * 20 >= delays_s.len() * 19 && median_s < 5.0, "{delays_s:.1?}");
}

/// Healthy robots by the shipped settings, each a robot that nothing is known of.
#[test]
#[ignore = "plays hours of recordings: CONTRIBUTING.md has the command"]
fn on_floors_that_are_left_out_healthy_robots_raise_at_most_a_level_an_hour() {
    for (folder, feature_set, floors) in SETS {
        let platform = folder.rsplit('_').next().unwrap();
        let (mut levels, mut hours) = (0, 0.0);
        for floor in floors {
            let Some([left_out, own]) = divided(folder, &[floor]) else {
                return;
            };
            let settings = settings(platform);
            // Levels read the energy model alone.
            let model = network(&own, period_s(&settings), feature_set, 1);
            let played: Vec<_> = left_out
                .par_iter()
                .map(|trial| raised(&settings, &model, &samples(trial)))
                .collect();
            let count: usize = played.iter().map(|(levels, _)| levels.len()).sum();
            let of_floor_h: f64 = played.iter().map(|(_, hours)| hours).sum();
            println!("{folder}, {floor}: {count} in {of_floor_h:.2} h");
            // There the floor changes within the run, as it does with a load.
            if *floor != "MIXED" {
                (levels, hours) = (levels + count, hours + of_floor_h);
            }
        }
        assert!(levels as f64 <= hours.max(1.0), "{folder}: {levels} in {hours:.2} h");
    }
}

fn samples(trial: &Trial) -> Vec<Sample> {
    trial.to_samples(0, 1_000_000_000)
}

/// The samples with twice the mean power from 40 % of them on, and since when.
fn loaded(trial: &Trial) -> (Vec<Sample>, u64) {
    let mut samples = samples(trial);
    let mean_w = samples.iter().map(|sample| sample.power_w).sum::<f32>() / samples.len() as f32;
    let from = samples.len() * 2 / 5;
    for sample in &mut samples[from..] {
        sample.power_w += mean_w;
    }
    let from_ns = samples[from].stamp_ns;
    (samples, from_ns)
}

/// The times at which a robot raises an alarm of its level, ns, and its hours.
fn raised(settings: &FleetSettings, model: &Model, samples: &[Sample]) -> (Vec<u64>, f64) {
    let mut fleet = Fleet::new(settings.clone(), vec![model.clone()]).unwrap();
    let (mut before, mut raised_ns) = (AlarmSet::default(), Vec::new());
    for (frame, sample) in samples.iter().enumerate() {
        let header = SampleHeader {
            schema: SCHEMA_VERSION,
            source_id: 1,
            source_epoch: 1,
            frame_seq: frame as u64,
            samples_before: frame as u64,
            intended_ns: sample.stamp_ns,
            sent_ns: sample.stamp_ns,
            ..SampleHeader::default()
        };
        fleet.take(&header, std::slice::from_ref(sample), sample.stamp_ns);
        fleet.tick(sample.stamp_ns, false);
        if !fleet.is_empty() {
            let alarms = fleet.diagnostic(0).alarms();
            let new = alarms.iter().filter(|alarm| alarm.is_of_level() && !before.has(*alarm));
            raised_ns.extend(new.map(|_| sample.stamp_ns));
            before = alarms;
        }
    }
    (raised_ns, (samples.last().unwrap().stamp_ns - samples[0].stamp_ns) as f64 / 3.6e12)
}
