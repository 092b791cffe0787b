//! Recordings that are read when needed give the results of recordings in memory, to the bit.

use std::path::PathBuf;

use joulebus_dataset::split::{By, Split};
use joulebus_dataset::trial::ColumnMap;
use joulebus_eval::analyze::{AnalysisSettings, analyze};
use joulebus_eval::score::{
    Design, Options, Recording, ScoreError, Subject, open_recordings, read_recordings, score,
};
use joulebus_eval::training_data::{Parts, training_data};
use joulebus_predictor::FeatureSet;
use joulebus_testkit::trials::{Files, npy_f8};

use super::model::{network, settings};
use joulebus_testkit::assert_contains;

/// Files of different lengths, and one that two robots share.
fn made_up(files: &Files) -> Vec<(u32, PathBuf)> {
    let row = |trial: u32, row: u32| {
        let phase = f64::from(row) * 0.1 + f64::from(trial);
        let noise = f64::from((row * 7919 + trial * 31) % 101) / 101.0;
        let power_mw = 20_000.0 + 5_000.0 * phase.sin() + 4_000.0 * noise;
        let time_s = f64::from(row) * 0.033;
        let (v, omega) = (0.1 + 0.05 * phase.cos(), 0.3);
        [1.0, time_s, 0.0, v, omega, 0.0, 0.0, 0.0, 24_000.0, 900.0, power_mw]
    };
    let alone = (0..6_u32).map(|trial| {
        let rows: Vec<[f64; 11]> = (0..150 + 40 * trial).map(|at| row(trial, at)).collect();
        files.write(&format!("run_{trial}.npy"), &npy_f8(&rows))
    });
    let mut paths: Vec<PathBuf> = alone.collect();
    let mut shared = "robot_id,timestamp_s,v_cmd_mps,omega_cmd_radps,power_mW\n".to_owned();
    for at in 0..200 {
        for robot in [6, 7] {
            let [_, time_s, _, v, omega, .., power_mw] = row(robot, at);
            shared += &format!("{robot},{time_s},{v},{omega},{power_mw}\n");
        }
    }
    paths.insert(2, files.write("shared.csv", shared.as_bytes()));
    (0..).zip(paths).collect()
}

#[test]
fn scores_analysis_and_training_rows_do_not_depend_on_what_is_in_memory() {
    let files = Files::new();
    let paths = made_up(&files);
    let whole = ColumnMap::default();
    // Parts of the long files are recordings.
    let in_parts = ColumnMap::default().in_parts_of(260);
    let model = [network(5, FeatureSet::Full, 20.0)];
    let found = |recordings: &[Recording]| {
        let mut found = Vec::new();
        for by in [By::Trial, By::Time] {
            let wanted = Split { by, held_out: 0.3, ..Split::default() };
            let designs =
                [Design::held_out(recordings, wanted).unwrap(), Design::folds(recordings)];
            for design in designs {
                let design = design.hold_apart(recordings, &model).unwrap();
                let settings = settings();
                let subject = Subject {
                    settings: &settings,
                    platform: None,
                    models: &model,
                    recordings,
                    design: &design,
                };
                let mut options = Options::default();
                options.bootstrap.resamples = 20;
                let scored = score(subject, &options).unwrap();
                found.push(serde_json::to_string(&scored.report).unwrap());
            }
            let analysis = AnalysisSettings { split: wanted, ..AnalysisSettings::default() };
            let analysis = analyze(recordings, &analysis, &[]).unwrap();
            found.push(serde_json::to_string(&analysis).unwrap());
            for max_rows in [usize::MAX, 700] {
                let made = training_data(Parts::Split(recordings, wanted), max_rows);
                let (dataset, summary) = made.unwrap();
                found.push(dataset.sha256(FeatureSet::Full) + &dataset.description);
                found.push(serde_json::to_string(&summary).unwrap());
            }
        }
        let (held_out, rest) = recordings.split_at(3);
        let given = Parts::Given([&rest[..3], &rest[3..], held_out]);
        let (dataset, _) = training_data(given, 900).unwrap();
        found.push(dataset.sha256(FeatureSet::Full));
        found
    };
    for (map, count, always) in [(&whole, 8, 2), (&in_parts, 16, 0)] {
        let all = read_recordings(&paths, map).unwrap();
        assert_eq!(all.len(), count);
        let wanted = found(&all);
        for rows_in_memory in [0, 500] {
            let stored = open_recordings(&paths, map, rows_in_memory).unwrap();
            let left = stored.iter().filter(|one| one.in_memory().is_some());
            // The two robots of a file that they share always are, unless it is long.
            let allowed = always..=always + rows_in_memory / 100;
            assert!(allowed.contains(&(left.count() as u64)), "{rows_in_memory}");
            assert_eq!(stored, all);
            assert_eq!(found(&stored), wanted, "{rows_in_memory}");
        }
    }
}

#[test]
fn a_file_that_changes_or_goes_while_it_is_used_is_an_error_with_its_name() {
    let files = Files::new();
    let paths = made_up(&files);
    let stored = open_recordings(&paths, &ColumnMap::default(), 0).unwrap();
    let bytes = std::fs::read(&paths[1].1).unwrap();
    std::fs::write(&paths[0].1, &bytes).unwrap();
    let error = stored[0].contents().unwrap_err().to_string();
    assert_contains(&error, ["run_0.npy: changed", "190 rows", "150"]);
    std::fs::remove_file(&paths[1].1).unwrap();
    assert!(stored[1].contents().is_err());
    let model = [network(5, FeatureSet::Full, 20.0)];
    let design = Design::folds(&stored);
    let settings = settings();
    let subject = Subject {
        settings: &settings,
        platform: None,
        models: &model,
        recordings: &stored,
        design: &design,
    };
    let refused = score(subject, &Options::default()).unwrap_err();
    assert!(matches!(refused, ScoreError::Recording(detail) if detail.contains("run_0.npy")));
}
