//! Scores equal their textbook formulas for any order of merging; undefined scores are NaN.

use joulebus_statistics::metrics::{
    CoverageTally, ResidualQuantiles, Tally, quantile, sorted, tally,
};
use proptest::prelude::*;

type Pairs = Vec<(f64, f64)>;

fn pairs() -> impl Strategy<Value = Pairs> {
    let power = prop_oneof![8 => -50.0f64..150.0, 1 => Just(0.0), 1 => Just(7.5)];
    let forecast = prop_oneof![9 => -50.0f64..150.0, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)];
    prop::collection::vec((power, forecast), 0..200)
}

fn tallied(pairs: &[(f64, f64)]) -> Tally {
    let mut tally = Tally::default();
    for (reading_w, forecast_w) in pairs {
        tally.add(*reading_w, *forecast_w, 0.04);
    }
    tally
}

/// NaN equals only NaN.
fn near(found: f64, wanted: f64) -> bool {
    (found.is_nan() && wanted.is_nan()) || (found - wanted).abs() <= 1e-9 * (1.0 + wanted.abs())
}

fn nan_if(undefined: bool, value: f64) -> f64 {
    if undefined { f64::NAN } else { value }
}

/// Every score from its definition, one pass each, over the finite pairs.
fn by_definition(pairs: &[(f64, f64)]) -> [f64; 8] {
    let finite: Vec<_> = pairs.iter().filter(|pair| pair.1.is_finite()).collect();
    let n = finite.len() as f64;
    let mean_of = |values: Vec<f64>| values.iter().sum::<f64>() / values.len() as f64;
    let each = |of: fn(&(f64, f64)) -> f64| mean_of(finite.iter().map(|pair| of(pair)).collect());
    let mean = each(|pair| pair.0);
    let scatter: f64 = finite.iter().map(|pair| (pair.0 - mean).powi(2)).sum();
    let all_equal = finite.iter().all(|pair| pair.0 == finite[0].0);
    let mse = each(|pair| (pair.0 - pair.1).powi(2));
    let relative: Vec<f64> = finite
        .iter()
        .filter(|pair| pair.0 != 0.0)
        .map(|pair| ((pair.0 - pair.1) / pair.0).abs())
        .collect();
    let (measured, forecast) = (each(|pair| pair.0), each(|pair| pair.1));
    [
        nan_if(all_equal, 1.0 - mse * n / scatter),
        mse.sqrt(),
        each(|pair| (pair.0 - pair.1).abs()),
        mean_of(relative),
        each(|pair| pair.0 - pair.1),
        nan_if(measured == 0.0, (forecast - measured) / measured.abs()),
        mean,
        n,
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn scores_equal_their_definitions_however_the_parts_are_merged(
        pairs in pairs(), cuts in prop::collection::vec(0usize..200, 0..5)
    ) {
        let wanted = by_definition(&pairs);
        let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut.min(pairs.len())).collect();
        cuts.extend([0, pairs.len()]);
        cuts.sort_unstable();
        let mut merged = Tally::default();
        for cut in cuts.windows(2) {
            merged.merge(&tallied(&pairs[cut[0]..cut[1]]));
        }
        for found in [tallied(&pairs), merged] {
            let values = [
                found.r2(), found.rmse_w(), found.mae_w(), found.mape(), found.bias_w(),
                found.energy_error(), found.reading_mean_w(), found.count() as f64,
            ];
            for (place, (value, wanted)) in values.into_iter().zip(wanted).enumerate() {
                // Energies close to zero lose digits to cancellation.
                if place != 5 || wanted.abs() < 1e3 {
                    prop_assert!(near(value, wanted), "score {place}: {value}, not {wanted}");
                }
            }
            prop_assert_eq!(found.count() + found.unscored(), pairs.len() as u64);
        }
    }

    #[test]
    fn skill_is_one_minus_the_ratio_of_squared_errors(
        rows in prop::collection::vec((3.0f64..9.0, -1.0f64..1.0, -1.0f64..1.0), 1..100)
    ) {
        let own = tallied(&rows.iter().map(|row| (row.0, row.0 + row.1)).collect::<Pairs>());
        let other = tallied(&rows.iter().map(|row| (row.0, row.0 + row.2)).collect::<Pairs>());
        let squares = |of: fn(&(f64, f64, f64)) -> f64| rows.iter().map(|row| of(row).powi(2)).sum::<f64>();
        prop_assert!(near(own.skill(&other), 1.0 - squares(|row| row.1) / squares(|row| row.2)));
    }

    #[test]
    fn intervals_count_what_lies_inside_below_and_above(
        rows in prop::collection::vec((0.0f64..10.0, 0.0f64..10.0, -1.0f64..5.0), 0..100)
    ) {
        let mut found = CoverageTally::default();
        let mut parts = [CoverageTally::default(); 2];
        for (at, (reading, lo, width)) in rows.iter().enumerate() {
            found.add(*reading, *lo, lo + width);
            parts[usize::from(at * 2 > rows.len())].add(*reading, *lo, lo + width);
        }
        let [mut merged, last] = parts;
        merged.merge(&last);
        let valid: Vec<_> = rows.iter().filter(|row| row.1 + row.2 >= row.1).collect();
        let n = valid.len() as f64;
        let share = |of: fn(&(f64, f64, f64)) -> bool| valid.iter().filter(|row| of(row)).count() as f64 / n;
        let (below, above) = (share(|row| row.0 < row.1), share(|row| row.0 > row.1 + row.2));
        let score = |row: &(f64, f64, f64)| {
            let miss = if row.0 < row.1 { row.1 - row.0 } else { (row.0 - row.1 - row.2).max(0.0) };
            row.2 + 20.0 * miss
        };
        for found in [found, merged] {
            let scores = found.coverage_of(0.9);
            prop_assert!(near(scores.below, below) && near(scores.above, above));
            prop_assert!(near(scores.coverage, 1.0 - below - above));
            prop_assert!(near(scores.score_w, valid.iter().map(|row| score(row)).sum::<f64>() / n));
            prop_assert_eq!(scores.count + scores.unscored, rows.len() as u64);
        }
    }

    #[test]
    fn a_quantile_splits_the_numbers_at_its_share(
        values in prop::collection::vec(-1e3f64..1e3, 1..60), share in 0.0f64..=1.0
    ) {
        let ascending = sorted(values.iter().copied());
        let found = quantile(&ascending, share);
        let place = share * (ascending.len() - 1) as f64;
        let at_most = ascending.iter().filter(|value| **value <= found + 1e-9).count();
        prop_assert!(at_most as f64 >= place.floor() + 1.0 - 1e-9);
        let below = ascending.iter().filter(|value| **value < found - 1e-9).count();
        prop_assert!(below as f64 <= place.ceil());
        prop_assert_eq!(quantile(&ascending, 0.0), ascending[0]);
        prop_assert_eq!(quantile(&ascending, 1.0), ascending[ascending.len() - 1]);
    }
}

#[test]
fn quantiles_interpolate_between_neighbours() {
    let ascending = [1.0, 2.0, 4.0, 8.0];
    for (share, wanted) in [(0.0, 1.0), (1.0 / 3.0, 2.0), (0.5, 3.0), (0.95, 7.4), (1.0, 8.0)] {
        assert!((quantile(&ascending, share) - wanted).abs() < 1e-12, "{share}");
    }
    let quantiles = ResidualQuantiles::new([f64::NAN, 8.0, 1.0, 4.0, 2.0, f64::INFINITY]);
    assert_eq!((quantiles.min_w, quantiles.max_w, quantiles.q50_w), (1.0, 8.0, 3.0));
}

#[test]
fn undefined_scores_are_nan() {
    let empty = Tally::default();
    for value in [
        empty.r2(),
        empty.rmse_w(),
        empty.mae_w(),
        empty.mape(),
        empty.bias_w(),
        empty.energy_error(),
        empty.reading_mean_w(),
        empty.reading_std_w(),
        empty.residual_std_w(),
        empty.skill(&empty),
        CoverageTally::default().coverage(),
        quantile(&[], 0.5),
        quantile(&[1.0], 1.5),
        quantile(&[1.0], f64::NAN),
    ] {
        assert!(value.is_nan());
    }
    let constant = tally(&[4.0; 9], &[4.5; 9], 1.0);
    assert!(constant.r2().is_nan(), "readings without variance");
    assert_eq!((constant.mae_w(), constant.bias_w()), (0.5, -0.5));
    assert!((constant.energy_error() - 0.125).abs() < 1e-12);
    let perfect = tally(&[1.0, 2.0], &[1.0, 2.0], 1.0);
    assert_eq!(perfect.r2(), 1.0);
    assert!(perfect.skill(&perfect).is_nan(), "a baseline without error");
    let fewer = tally(&[1.0, 2.0], &[1.5, f64::NAN], 1.0);
    assert!(fewer.skill(&perfect).is_nan() && perfect.skill(&fewer).is_nan(), "other rows");
    let at_rest = tally(&[0.0, 2.0], &[1.0, 1.0], 1.0);
    assert_eq!(at_rest.mape(), 0.5, "a reading of 0 has no relative error");
    let coverage = CoverageTally::default().coverage_of(0.8);
    let json = serde_json::to_value(coverage).expect("plain numbers");
    assert!(json["width_w"].is_null() && json["count"] == 0);
}
