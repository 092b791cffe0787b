//! Block bootstrap intervals: coverage, independence of the number of threads, too few blocks.

use joulebus_statistics::bootstrap::{Bootstrap, MIN_BLOCKS};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn mean(values: &[f64], blocks: &[usize]) -> f64 {
    blocks.iter().map(|block| values[*block]).sum::<f64>() / blocks.len() as f64
}

fn of_mean(settings: Bootstrap, values: &[f64]) -> joulebus_statistics::bootstrap::Estimate {
    settings.estimate(values.len(), |blocks| vec![mean(values, blocks)])[0]
}

#[test]
fn intervals_cover_the_true_mean_at_about_the_nominal_rate() {
    let settings = Bootstrap { resamples: 400, confidence: 0.9, ..Bootstrap::default() };
    let mut random = Pcg64::seed_from_u64(7);
    let tries = 500;
    let mut held = 0;
    for _ in 0..tries {
        let values: Vec<f64> = (0..60).map(|_| random.random_range(-1.0..1.0)).collect();
        let found = of_mean(settings, &values);
        assert!(found.lo < found.value && found.value < found.hi);
        held += usize::from(found.lo <= 0.0 && 0.0 <= found.hi);
    }
    let share = held as f64 / tries as f64;
    // The percentile interval of a mean of 60 is narrow by about a percent; chance adds 1.3.
    assert!((0.85..=0.94).contains(&share), "{share}");
}

#[test]
fn of_ten_trials_with_effects_of_their_own_equal_means_differ_as_rarely_as_stated() {
    let settings = Bootstrap { resamples: 400, ..Bootstrap::default() };
    let mut random = Pcg64::seed_from_u64(8);
    let tries = 1_000;
    for trials in [10, 20] {
        let mut differ = 0;
        for _ in 0..tries {
            // The sum of twelve is nearly normal.
            let effect = |_| (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>();
            let effects: Vec<f64> = (0..trials).map(effect).collect();
            let found = of_mean(settings, &effects).widened_for(trials);
            differ += usize::from(found.is_above(0.0) || found.is_below(0.0));
        }
        let share = differ as f64 / tries as f64;
        // 5 % are stated, and chance adds 0.7.
        assert!((0.025..=0.07).contains(&share), "{trials} trials: {share}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 30, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_number_of_threads_changes_no_bit(
        values in prop::collection::vec(-1e3f64..1e3, 8..80), seed in any::<u64>()
    ) {
        let settings = Bootstrap { resamples: 200, seed, ..Bootstrap::default() };
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let found = pool.install(|| of_mean(settings, &values));
            [found.value, found.lo, found.hi].map(f64::to_bits)
        };
        prop_assert_eq!(on(1), on(3));
    }

    #[test]
    fn common_variance_of_two_scores_cancels(
        values in prop::collection::vec(-1e3f64..1e3, 8..60), apart in -2.0f64..2.0
    ) {
        let settings = Bootstrap { resamples: 100, ..Bootstrap::default() };
        let found = settings.estimate(values.len(), |blocks| {
            let one = mean(&values, blocks);
            let other: f64 = blocks.iter().map(|b| values[*b] + apart).sum::<f64>() / blocks.len() as f64;
            vec![other - one]
        })[0];
        prop_assert!((found.lo - apart).abs() < 1e-9 && (found.hi - apart).abs() < 1e-9);
    }
}

#[test]
fn too_few_blocks_and_draws_without_a_score_give_no_interval() {
    let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
    let few = of_mean(Bootstrap::default(), &values[..MIN_BLOCKS - 1]);
    assert!(few.value == 4.0 && few.lo.is_nan() && few.hi.is_nan());
    let off = Bootstrap { resamples: 0, ..Bootstrap::default() };
    assert!(of_mean(off, &values).lo.is_nan());
    // Without the first block, the score is not defined.
    let sometimes = Bootstrap::default().estimate(8, |blocks| {
        let has_first = blocks.contains(&0);
        vec![if has_first { 1.0 } else { f64::NAN }, 2.0]
    });
    assert!(sometimes[0].lo.is_nan() && sometimes[0].value == 1.0);
    assert_eq!((sometimes[1].lo, sometimes[1].hi), (2.0, 2.0));
    assert!(
        sometimes[1].is_above(1.9) && sometimes[1].is_below(2.1) && !sometimes[0].is_above(0.0)
    );
}

#[test]
fn constant_blocks_have_no_spread_and_another_seed_draws_differently() {
    let found = of_mean(Bootstrap::default(), &[5.0; 20]);
    assert_eq!((found.lo, found.hi), (5.0, 5.0));
    let values: Vec<f64> = (0..40).map(f64::from).collect();
    let seeded = |seed| of_mean(Bootstrap { seed, ..Bootstrap::default() }, &values);
    assert_eq!(seeded(1), seeded(1));
    assert_ne!(seeded(1), seeded(2));
}
