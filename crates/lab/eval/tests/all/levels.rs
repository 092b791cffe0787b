//! Levels on real recordings: loads on floors that nobody trained on, and healthy robots on other
//! terrains.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use joulebus_config::Config;
use joulebus_dataset::rows::{Dataset, Row, RowOrigin, trial_rows};
use joulebus_dataset::trial::Trial;
use joulebus_eval::calibrate::{Fault, Request, calibrate};
use joulebus_fleet::Fleet;
use joulebus_predictor::{FeatureSet, Model};
use joulebus_settings::FleetSettings;
use joulebus_testkit::recordings;
use joulebus_train::{TrainSettings, train};
use joulebus_wire::{Alarm, AlarmSet, SCHEMA_VERSION, SampleHeader};

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

/// The recordings whose names begin with one of these words, and the others. The Husky's recording
/// on mixed ground is left out: there a level changes, as it does with a load.
fn divided(folder: &str, words: &[&str]) -> Option<[Vec<Trial>; 2]> {
    let (own, others): (Vec<PathBuf>, Vec<PathBuf>) = recordings::trials(folder)?
        .into_iter()
        .filter(|path| !named(path, &["MIXED"]))
        .partition(|path| named(path, words));
    let read = |path: &PathBuf| Trial::read(path).unwrap();
    Some([own, others].map(|paths| paths.iter().map(read).collect()))
}

/// A network trained on these recordings. Of each seven, one decides when to stop, and one is held
/// out.
fn network(trials: &[Trial], period_s: f32) -> Model {
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
    let recipe = TrainSettings {
        max_epochs: 15,
        ..TrainSettings::new("levels", "recordings", FeatureSet::Full, 1)
    };
    Model::Network(train(&dataset, &recipe, |_| ()).unwrap().network)
}

/// The network has seen grey and brown floors alone. The constants were chosen with all floors in
/// view, so this is no blind test.
#[test]
#[ignore = "trains and calibrates for minutes: CONTRIBUTING.md has the command"]
fn loads_are_found_on_floors_that_nobody_trained_on() {
    let words = ["one_surface_type_gray_surface", "one_surface_type_brown_surface"];
    let Some([own, others]) = divided("robotino", &words) else {
        return;
    };
    let request = Request { fleet_per_h: 8.0, robots: 1, confidence: 0.95, extrapolate: false };
    let settings = settings("robotino");
    let model = network(&own, period_s(&settings));
    let found = calibrate(&settings, 0, &model, &others, &request).unwrap();
    println!("{found}");
    let load = |share: f64| {
        let load = Fault::ExtraLoad(share);
        found.delays.iter().find(|delays| delays.fault == load).unwrap().calibrated
    };
    let double = load(1.0);
    assert!(double.found >= 0.95 && double.median_s < 5.0, "{double:?}");
}

/// Healthy robots by the default settings.
#[test]
#[ignore = "trains for a minute: CONTRIBUTING.md has the command"]
fn on_other_terrains_healthy_robots_raise_next_to_no_level() {
    for (folder, platform, words) in [
        ("borealtc_husky", "husky", &["ASPHALT", "FLOORING", "SNOW"][..]),
        (
            "robotino",
            "robotino",
            &["one_surface_type_gray_surface", "one_surface_type_brown_surface"],
        ),
    ] {
        let Some([own, others]) = divided(folder, words) else {
            return;
        };
        let settings = settings(platform);
        let model = network(&own, period_s(&settings));
        let (mut raised, mut hours) = (BTreeMap::<&str, usize>::new(), 0.0);
        for trial in &others {
            let mut fleet = Fleet::new(settings.clone(), vec![model.clone()]).unwrap();
            let mut before = AlarmSet::default();
            let samples = trial.to_samples(0, 1_000_000_000);
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
                if fleet.is_empty() {
                    continue;
                }
                let alarms = fleet.diagnostic(0).alarms();
                for alarm in alarms.iter().filter(|alarm| !before.has(*alarm)) {
                    *raised.entry(alarm.name()).or_default() += 1;
                }
                before = alarms;
            }
            hours += (samples.last().unwrap().stamp_ns - samples[0].stamp_ns) as f64 / 3.6e12;
        }
        println!("{folder}: {raised:?} in {hours:.2} h");
        let levels = [Alarm::LevelHigh, Alarm::LevelLow];
        let count: usize = levels.iter().filter_map(|alarm| raised.get(alarm.name())).sum();
        assert!(count <= 1, "{folder}: {raised:?}");
    }
}
