//! Rows that a model was trained on are recognised by their readings, and no others are.

use std::ops::Range;

use joulebus_dataset::rows::{Dataset, Row, TrialRows, sample_rows};
use joulebus_dataset::split::{By, PAUSE_ROWS, Split};
use joulebus_dataset::trained_rows::{is_trained_on, is_untold, trained_rows};
use joulebus_predictor::training::TrainedRows;
use joulebus_statistics::noise::Noise;
use joulebus_wire::Sample;
use proptest::prelude::*;

use super::sources::{self, Source, assign};

const PERIOD_NS: u64 = 33_000_000;

/// Readings of a robot, W, and the positions of gaps before them.
#[derive(Clone)]
struct Recorded {
    powers_w: Vec<f32>,
    gaps: Vec<usize>,
}

impl Recorded {
    /// A robot that drives: its power wanders.
    fn driving(seed: u64, rows: usize, gaps: Vec<usize>) -> Self {
        let mut noise = Noise::new(seed, 0);
        let mut power_w = 30.0_f32;
        let mut next = || {
            power_w = 0.9 * power_w + 3.0 + (noise.below(2_001) as f32 - 1_000.0) * 1e-3;
            power_w
        };
        Self { powers_w: (0..rows).map(|_| next()).collect(), gaps }
    }

    /// A robot that rests: a monitor of 10 mW, polled at a third of the rate, moves between two
    /// steps.
    fn resting(seed: u64, rows: usize) -> Self {
        let mut noise = Noise::new(seed, 1);
        let mut power_w = 3.5;
        let mut next = |row: usize| {
            if row.is_multiple_of(3) {
                power_w = 3.5 + 0.01 * noise.below(2) as f32;
            }
            power_w
        };
        Self { powers_w: (0..rows).map(&mut next).collect(), gaps: Vec::new() }
    }

    fn rows(&self) -> TrialRows {
        let mut stamp_ns = 0;
        let samples = self.powers_w.iter().enumerate().map(|(at, power_w)| {
            let gap = if self.gaps.contains(&at) { 5 } else { 1 };
            stamp_ns += gap * PERIOD_NS;
            Sample::new(0, at as u64, stamp_ns).reading(*power_w, stamp_ns)
        });
        let samples: Vec<Sample> = samples.collect();
        sample_rows(&samples, PERIOD_NS)
    }
}

fn dataset(training: &[TrialRows]) -> Dataset {
    let rows = training.iter().flat_map(|trial| trial.rows.iter().copied());
    Dataset {
        training: rows.collect(),
        validation: Vec::new(),
        held_out: Vec::new(),
        description: String::new(),
        period_s: 0.0,
    }
}

fn found(rows: &[Row], training: &[TrialRows]) -> Vec<bool> {
    let trained = trained_rows(&dataset(training)).expect("few runs");
    is_trained_on(rows, &trained)
}

fn gaps() -> impl Strategy<Value = Vec<usize>> {
    prop::collection::vec(1usize..600, 0..12)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_row_of_a_trained_recording_is_recognised_and_none_of_another(
        lengths in prop::collection::vec(60usize..600, 2..6),
        gaps in gaps(),
        seed in 0u64..1_000_000,
    ) {
        let all: Vec<TrialRows> = (0..)
            .zip(&lengths)
            .map(|(place, length)| Recorded::driving(seed + place, *length, gaps.clone()).rows())
            .collect();
        let (other, training) = all.split_last().unwrap();
        let unseen = found(&other.rows, training);
        prop_assert!(unseen.iter().all(|trained| !trained));
        for trial in training {
            // The rows beside runs of fewer than 16 rows make those recognised.
            let has_run = trial.sample_seq.chunk_by(|a, b| a + 1 == *b).all(|run| run.len() >= 16);
            if has_run && trial.rows.len() >= 24 {
                let seen = found(&trial.rows, training);
                prop_assert!(seen.iter().all(|trained| *trained), "{seen:?}");
            }
        }
    }

    #[test]
    fn a_recording_is_recognised_cut_joined_and_rounded(
        cut in 0usize..200,
        before in 0usize..100,
        seed in 0u64..1_000_000,
    ) {
        let whole = Recorded::driving(seed, 700, Vec::new());
        let mut powers_w = Recorded::driving(seed + 1, before, Vec::new()).powers_w;
        // The precision of a file in float32 and mW.
        powers_w.extend(whole.powers_w[cut..600].iter().map(|w| ((w * 1e3) as f64 * 1e-3) as f32));
        let changed = Recorded { powers_w, gaps: vec![before] }.rows();
        let seen = found(&changed.rows, &[whole.rows()]);
        let first = changed.rows.len().checked_sub(600 - cut - 5).unwrap();
        let own = &seen[first..];
        let missed = own.iter().filter(|trained| !**trained).count();
        // At most a block at either cut, and a tenth in blocks where rounding changed a reading.
        prop_assert!(missed <= 2 * 64 + own.len() / 10, "{missed} of {}", own.len());
        let wrong = seen[..first].iter().filter(|trained| **trained).count();
        prop_assert!(wrong <= PAUSE_ROWS, "{wrong}");
    }

    #[test]
    fn what_a_split_in_time_holds_out_is_not_trained_on(
        lengths in prop::collection::vec(200usize..600, 1..5),
        seed in 0u64..1_000_000,
    ) {
        let source = |(place, length): (u64, &usize)| Source {
            trial: place.to_string(),
            robot: String::new(),
            group: String::new(),
            rows: Recorded::driving(seed + place, *length, Vec::new()).rows(),
        };
        let sources: Vec<Source> = (0..).zip(&lengths).map(source).collect();
        let wanted = Split { by: By::Time, ..Split::default() };
        let assignment = assign(&sources, wanted).unwrap();
        let dataset = sources::dataset(&sources, &assignment);
        let trained = trained_rows(&dataset).unwrap();
        prop_assert_eq!(trained.rows, (dataset.training.len() + dataset.validation.len()) as u64);
        for (source, [training, validation, held_out]) in sources.iter().zip(&assignment.ranges) {
            let seen = is_trained_on(&source.rows.rows, &trained);
            prop_assert!(seen[training.clone()].iter().all(|trained| *trained));
            prop_assert!(validation.len() < 16 || seen[validation.clone()].iter().all(|trained| *trained));
            prop_assert!(seen[held_out.clone()].iter().all(|trained| !trained));
        }
    }
}

#[test]
fn resting_robots_with_a_coarse_monitor_are_not_confused() {
    let training: Vec<TrialRows> =
        (0..40).map(|seed| Recorded::resting(seed, 3_000).rows()).collect();
    let trained = trained_rows(&dataset(&training)).unwrap();
    let others = (1_000..1_020).map(|seed| Recorded::resting(seed, 3_000).rows());
    let wrong: usize = others
        .map(|other| {
            let seen = is_trained_on(&other.rows, &trained);
            seen.iter().filter(|trained| **trained).count()
        })
        .sum();
    assert_eq!(wrong, 0, "of 60,000 rows");
    let own = is_trained_on(&training[7].rows, &trained);
    assert!(own.iter().all(|trained| *trained));
}

/// A slow monitor: each reading is repeated.
fn held(seed: u64, rows: usize, times: usize) -> TrialRows {
    let powers_w = Recorded::driving(seed, rows.div_ceil(times), Vec::new()).powers_w;
    let powers_w = powers_w.iter().flat_map(|power_w| std::iter::repeat_n(*power_w, times));
    Recorded { powers_w: powers_w.take(rows).collect(), gaps: Vec::new() }.rows()
}

#[test]
fn a_short_recording_that_changes_rarely_is_recognised_as_a_whole_or_counted_as_untold() {
    // 138 rows, as of a monitor that is read at 5 Hz: 23 readings, and 9.
    for (times, is_told) in [(6, true), (15, false)] {
        let rows = held(5, 138, times);
        let trained = trained_rows(&dataset(&[held(6, 400, times), rows.clone()])).unwrap();
        let seen = is_trained_on(&rows.rows, &trained);
        let untold = is_untold(&rows.rows, &seen, &trained);
        assert!(seen.iter().all(|trained| *trained == is_told), "{times}");
        assert!(untold.iter().all(|untold| *untold != is_told), "{times}");
        // Another one may be an excerpt of a recording that was trained on.
        let other = held(7, 138, times).rows;
        let unseen = is_trained_on(&other, &trained);
        assert!(unseen.iter().all(|trained| !trained), "{times}");
        assert!(is_untold(&other, &unseen, &trained).iter().all(|untold| *untold), "{times}");
    }
}

/// How often each excerpt of a trained recording is recognised, untold, or neither.
fn silently_missed(whole: &TrialRows, trained: &TrainedRows, excerpt: Range<usize>) -> usize {
    let excerpt = &whole.rows[excerpt];
    let is_known = is_trained_on(excerpt, trained);
    let untold = is_untold(excerpt, &is_known, trained);
    is_known.iter().zip(&untold).filter(|(known, untold)| !**known && !**untold).count()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn each_row_of_an_excerpt_is_recognised_or_counted_as_untold(
        seed in 0u64..1_000_000,
        times in 1usize..16,
        start in 0usize..500,
        length in 1usize..300,
    ) {
        let whole = held(seed, 900, times);
        let trained = trained_rows(&dataset(std::slice::from_ref(&whole))).unwrap();
        prop_assert_eq!(silently_missed(&whole, &trained, start..start + length), 0);
    }
}

#[test]
fn excerpts_of_large_data_are_recognised_or_counted_as_untold() {
    // So many rows that a block has 256 of them.
    let training: Vec<TrialRows> =
        (0..30).map(|seed| Recorded::driving(seed, 20_000, Vec::new()).rows()).collect();
    let trained = trained_rows(&dataset(&training)).unwrap();
    for (start, length) in [(101, 200), (101, 400), (101, 511), (3, 2_000)] {
        let missed = silently_missed(&training[5], &trained, start..start + length);
        assert_eq!(missed, 0, "{length}");
    }
}

#[test]
fn a_driving_robots_other_recording_can_be_told_and_nothing_can_without_hashes() {
    let trained = trained_rows(&dataset(&[Recorded::driving(1, 600, Vec::new()).rows()])).unwrap();
    let other = Recorded::driving(2, 600, Vec::new()).rows();
    let is_known = is_trained_on(&other.rows, &trained);
    assert!(is_untold(&other.rows, &is_known, &trained).iter().all(|untold| !untold));
    let none = TrainedRows { rows: 9, blocks: Vec::new() };
    assert!(is_untold(&other.rows, &is_known, &none).iter().all(|untold| *untold));
}

#[test]
fn the_number_of_hashes_is_bounded_and_large_data_are_recognised() {
    let training: Vec<TrialRows> = (0..30)
        .map(|seed| Recorded::driving(seed, 20_000 + 17 * seed as usize, Vec::new()).rows())
        .collect();
    let trained = trained_rows(&dataset(&training)).unwrap();
    let hashes: usize = trained.blocks.iter().map(|group| group.hashes.len()).sum();
    assert!((2_000..=4_096).contains(&hashes), "{hashes}");
    for trial in [&training[0], &training[29]] {
        let seen = is_trained_on(&trial.rows, &trained);
        assert!(seen.iter().all(|trained| *trained));
    }
    // Too many separate runs are stated as unknown, not in part.
    let short: Vec<TrialRows> =
        (0..9_000).map(|seed| Recorded::driving(seed, 30, Vec::new()).rows()).collect();
    assert_eq!(trained_rows(&dataset(&short)), None);
}
