//! Training rows have full windows, and splits leak nothing.

use std::collections::HashSet;

use joulebus_dataset::rows::{Dataset, Row, sample_rows};
use joulebus_dataset::split::{
    By, PAUSE_ROWS, Split, SplitError, SplitSummary, assign_leaving_out, group_of,
};
use joulebus_predictor::{FEATURES, FeatureSet};
use joulebus_testkit::assert_contains;
use joulebus_wire::{Sample, sample_flag};
use proptest::prelude::*;

use super::sources::{Source, assign, dataset, infos};

const PERIOD_NS: u64 = 33_000_000;

#[test]
fn gaps_missing_readings_and_times_that_do_not_advance_empty_the_window() {
    let sample = |seq: u64, stamp_ns: u64, power: bool| {
        let sample = Sample::new(1, seq, stamp_ns);
        let sample = sample.reading(3.0 + seq as f32, stamp_ns);
        Sample {
            flags: if power { sample.flags } else { sample.flags & !sample_flag::POWER },
            ..sample
        }
    };
    let regular = |seq: u64| sample(seq, (seq + 1) * PERIOD_NS, true);
    let rows = |samples: &[Sample]| sample_rows(samples, PERIOD_NS).sample_seq;
    let whole: Vec<Sample> = (0..12).map(regular).collect();
    assert_eq!(rows(&whole), [4, 5, 6, 7, 8, 9, 10]);

    let mut late = whole.clone();
    late[6..].iter_mut().for_each(|sample| sample.stamp_ns += PERIOD_NS);
    assert_eq!(rows(&late), [4, 10], "sample 5 has no reading after it, 6 to 9 no window");
    let mut missing = whole.clone();
    missing[6] = sample(6, 7 * PERIOD_NS, false);
    assert_eq!(rows(&missing), [4]);
    let mut still = whole.clone();
    still[6].stamp_ns = still[5].stamp_ns;
    assert_eq!(rows(&still), [4], "the step after it is two periods long");
    assert_eq!(sample_rows(&late, PERIOD_NS).without_window, 8);
    assert!(rows(&whole[..5]).is_empty(), "a full window, but no reading after it");
}

fn split(sources: &[Source], wanted: Split) -> Result<(Dataset, SplitSummary), SplitError> {
    let assignment = assign(sources, wanted)?;
    Ok((dataset(sources, &assignment), assignment.summary))
}

fn sources(trials: usize, rows: usize) -> Vec<Source> {
    let sources = (0..trials).map(|trial| {
        let samples: Vec<Sample> = (0..rows as u64 + 5)
            .map(|seq| {
                let power_w = (trial as u64 * 10_000 + seq) as f32;
                Sample::new(0, seq, (seq + 1) * PERIOD_NS).reading(power_w, (seq + 1) * PERIOD_NS)
            })
            .collect();
        Source {
            trial: format!("t{trial}"),
            robot: format!("r{}", trial % 4),
            group: format!("g{}", trial % 3),
            rows: sample_rows(&samples, PERIOD_NS),
        }
    });
    sources.collect()
}

/// The same recording as another file of another robot.
fn copy_of(source: &Source) -> Source {
    Source {
        trial: "copy".to_owned(),
        robot: "other".to_owned(),
        group: "other".to_owned(),
        rows: source.rows.clone(),
    }
}

#[test]
fn a_duplicate_recording_is_never_both_trained_and_scored_on() {
    let mut sources = sources(6, 80);
    sources.push(copy_of(&sources[2]));
    let rows =
        |rows: &[Row]| -> HashSet<u32> { rows.iter().map(|row| row.target_w.to_bits()).collect() };
    let mut refused = 0;
    for by in [By::Trial, By::Robot, By::Group, By::Time] {
        for seed in 0..20 {
            let wanted = Split { by, seed, ..Split::default() };
            match split(&sources, wanted) {
                Ok((dataset, _)) => {
                    let [training, validation, held_out] =
                        [&dataset.training, &dataset.validation, &dataset.held_out]
                            .map(|part| rows(part));
                    assert!(training.is_disjoint(&validation), "{by} {seed}");
                    assert!(training.is_disjoint(&held_out), "{by} {seed}");
                    assert!(validation.is_disjoint(&held_out), "{by} {seed}");
                }
                Err(SplitError::Copy { trials, parts, .. }) => {
                    assert_eq!(trials, ["t2", "copy"]);
                    assert_ne!(parts[0], parts[1]);
                    assert_ne!(by, By::Time, "copies are cut at the same rows");
                    refused += 1;
                }
                Err(other) => panic!("{by} {seed}: {other}"),
            }
        }
    }
    assert!((1..60).contains(&refused), "{refused} of 60");
    let wanted = Split { by: By::Group, ..Split::default() };
    let error = assign_leaving_out(&infos(&sources), wanted, &["g2".to_owned()]).unwrap_err();
    let text = error.to_string();
    assert_contains(&text, "t2 and copy | held out | 80 rows | leave one of them out".split(" | "));
}

/// The unit of a row, encoded in its readings.
fn trial_of(target_w: f32) -> usize {
    target_w as usize / 10_000
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn no_unit_is_in_two_parts_and_no_row_is_lost(
        trials in 3_usize..20,
        seed in any::<u64>(),
        validation in 0.01_f64..0.5,
        held_out in 0.01_f64..0.45,
        by in prop_oneof![Just(By::Trial), Just(By::Robot), Just(By::Group)],
    ) {
        let sources = sources(trials, 20);
        let wanted = Split { by, validation, held_out, seed };
        let (dataset, summary) = split(&sources, wanted).expect("three units and more");
        let unit = |trial: usize| match by {
            By::Robot => trial % 4,
            By::Group => trial % 3,
            _ => trial,
        };
        let units = |rows: &[joulebus_dataset::rows::Row]| -> HashSet<usize> {
            rows.iter().map(|row| unit(trial_of(row.target_w))).collect()
        };
        let parts = [&dataset.training, &dataset.validation, &dataset.held_out];
        let found = parts.map(|rows| units(rows));
        for (one, other) in [(0, 1), (0, 2), (1, 2)] {
            prop_assert!(found[one].is_disjoint(&found[other]));
        }
        prop_assert!(found.iter().all(|units| !units.is_empty()));
        prop_assert_eq!(parts.map(Vec::len), summary.rows);
        prop_assert_eq!(summary.rows.iter().sum::<usize>(), trials * 20);
        let (again, _) = split(&sources, wanted).expect("as before");
        prop_assert_eq!(again.sha256(FeatureSet::Freshness), dataset.sha256(FeatureSet::Freshness), "the same seed gives the same parts");
    }

    #[test]
    fn parts_cut_in_time_share_no_reading(rows in 40_usize..200, validation in 0.05_f64..0.4) {
        let sources = sources(3, rows);
        let wanted = Split { by: By::Time, validation, ..Split::default() };
        let (dataset, summary) = split(&sources, wanted).expect("time needs no units");
        let readings = |rows: &[joulebus_dataset::rows::Row]| -> HashSet<u32> {
            rows.iter()
                .flat_map(|row| row.features[6..FEATURES].iter().chain([&row.target_w]))
                .map(|power_w| power_w.to_bits())
                .collect()
        };
        let parts = [&dataset.training, &dataset.validation, &dataset.held_out].map(|rows| readings(rows));
        for (one, other) in [(0, 1), (0, 2), (1, 2)] {
            prop_assert!(parts[one].is_disjoint(&parts[other]));
        }
        prop_assert_eq!(summary.pause_rows, 3 * 2 * PAUSE_ROWS);
        prop_assert_eq!(summary.rows.iter().sum::<usize>() + summary.pause_rows, 3 * rows);
    }
}

/// Rows of a trial whose sensor is read every `hold` rows: each reading has a unique value.
fn held_source(rows: usize, hold: usize) -> Source {
    let samples: Vec<Sample> = (0..rows as u64 + 5)
        .map(|seq| {
            let read_at = seq - seq % hold as u64;
            let stamp_ns = (seq + 1) * PERIOD_NS;
            Sample::new(0, seq, stamp_ns).reading(read_at as f32, stamp_ns)
        })
        .collect();
    Source { rows: sample_rows(&samples, PERIOD_NS), ..sources(1, 1).remove(0) }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn a_reading_that_a_slow_sensor_holds_is_in_one_part_only(
        rows in 3_usize..400,
        hold in 1_usize..60,
        validation in 0.05_f64..0.4,
    ) {
        let source = held_source(rows, hold);
        let wanted = Split { by: By::Time, validation, ..Split::default() };
        let (dataset, summary) = split(std::slice::from_ref(&source), wanted).expect("time needs no units");
        let readings = |rows: &[joulebus_dataset::rows::Row]| -> HashSet<u32> {
            let readings = rows.iter().flat_map(|row| row.features[6..FEATURES].iter().chain([&row.target_w]));
            readings.map(|power_w| power_w.to_bits()).collect()
        };
        let parts = [&dataset.training, &dataset.validation, &dataset.held_out].map(|rows| readings(rows));
        for (one, other) in [(0, 1), (0, 2), (1, 2)] {
            prop_assert!(parts[one].is_disjoint(&parts[other]));
        }
        prop_assert_eq!(summary.rows.iter().sum::<usize>() + summary.pause_rows, source.rows.rows.len());
        prop_assert!(summary.name.starts_with("by time"));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]
    /// Readings ascend from part to part.
    #[test]
    fn the_parts_of_a_long_recording_are_cut_in_time_as_one(
        count in 1_usize..9,
        rows in 3_usize..300,
        validation in 0.05_f64..0.4,
    ) {
        let mut parts = sources(count, rows);
        for part in &mut parts {
            (part.trial, part.robot) = ("long".to_owned(), "r1".to_owned());
        }
        let wanted = Split { by: By::Time, validation, ..Split::default() };
        let (dataset, summary) = split(&parts, wanted).expect("time needs no units");
        let ends = |rows: &[joulebus_dataset::rows::Row]| {
            let readings = || rows.iter().map(|row| row.target_w);
            (readings().fold(f32::INFINITY, f32::min), readings().fold(f32::NEG_INFINITY, f32::max))
        };
        let [(_, trained_w), (from_w, to_w), (held_out_w, _)] =
            [&dataset.training, &dataset.validation, &dataset.held_out].map(|rows| ends(rows));
        prop_assert!(trained_w < from_w && to_w < held_out_w && trained_w < held_out_w);
        let found = summary.rows.iter().sum::<usize>() + summary.pause_rows;
        prop_assert_eq!(found, count * rows);
    }
}

#[test]
fn only_units_named_are_held_out() {
    let sources = sources(12, 20);
    let wanted = Split { by: By::Group, ..Split::default() };
    let assignment =
        assign_leaving_out(&infos(&sources), wanted, &["g1".to_owned()]).expect("three groups");
    for (source, ranges) in sources.iter().zip(&assignment.ranges) {
        let held_out = source.group == "g1";
        assert_eq!(!ranges[2].is_empty(), held_out, "{}", source.group);
        assert_eq!(ranges[0].is_empty() && ranges[1].is_empty(), held_out);
    }
    assert_eq!(assignment.summary.rows.iter().sum::<usize>(), 12 * 20);
    assert_eq!(assignment.summary.held_out, ["g1"]);
    let refused =
        assign_leaving_out(&infos(&sources), wanted, &["g9".to_owned()]).expect_err("no g9");
    assert!(refused.to_string().contains("g0, g1, g2"), "{refused}");
}

#[test]
fn shares_and_units_that_leave_a_part_empty_are_refused() {
    let sources = sources(2, 20);
    let error = split(&sources, Split::default()).expect_err("two trials");
    assert_eq!(error, SplitError::TooFew { by: By::Trial, found: 2 });
    for (validation, held_out) in [(0.0, 0.2), (0.2, 0.0), (0.5, 0.5), (f64::NAN, 0.2)] {
        let wanted = Split { validation, held_out, ..Split::default() };
        let error = split(&sources, wanted).expect_err("no such shares");
        assert!(error.to_string().contains("come to less than 1"), "{error}");
    }
}

#[test]
fn a_group_is_the_file_name_without_its_number() {
    for (name, group) in [
        ("ICE_03.csv.gz", "ICE"),
        ("one_surface_type_brown_surface_exp205.csv.gz", "one_surface_type_brown_surface_exp"),
        ("trial1.npy", "trial"),
        ("7.csv", "7"),
        ("plain", "plain"),
    ] {
        assert_eq!(group_of(name), group);
    }
}

proptest! {
    #[test]
    fn of_too_many_rows_evenly_spread_stretches_of_every_part_are_taken(
        trials in 3usize..12, rows in 20usize..400, max_rows in 60usize..3_000, by_time in any::<bool>()
    ) {
        let sources = sources(trials, rows);
        let wanted = Split {
            by: if by_time { By::Time } else { By::Trial },
            ..Split::default()
        };
        let assignment = assign(&sources, wanted).expect("three trials or more");
        let thinned = assignment.thin(max_rows);
        let found: usize = assignment.summary.rows.iter().sum();
        let taken: usize = thinned.rows.iter().sum();
        let mut counted = [0; 3];
        for (whole, ranges) in assignment.ranges.iter().zip(&thinned.ranges) {
            for part in 0..3 {
                let mut end = whole[part].start;
                for range in &ranges[part] {
                    prop_assert!(end <= range.start && range.end <= whole[part].end);
                    end = range.end;
                    counted[part] += range.len();
                }
            }
        }
        prop_assert_eq!(counted, thinned.rows);
        if found <= max_rows {
            prop_assert_eq!(thinned.rows, assignment.summary.rows);
        } else {
            let stretch = (max_rows / 64).max(1);
            prop_assert!(taken <= max_rows + 3 * stretch, "{} of {}", taken, max_rows);
            for part in 0..3 {
                let of_part = assignment.summary.rows[part];
                prop_assert_eq!(of_part > 0, thinned.rows[part] > 0);
                // Ends of trials are stretches that are not full.
                let ends = stretch * (trials + 1);
                let share = of_part * max_rows / found;
                prop_assert!(thinned.rows[part] <= share + stretch);
                prop_assert!(thinned.rows[part] + 2 * ends >= share.min(of_part), "part {}", part);
            }
        }
        prop_assert_eq!(thinned, assignment.thin(max_rows));
    }
}
