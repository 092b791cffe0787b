//! Least squares against a slow solver, and with dependent columns.

use joulebus_dataset::rows::Row;
use joulebus_predictor::{FEATURES, FeatureSet, INPUTS};
use joulebus_statistics::noise::Noise;
use joulebus_train::linear::{Dropped, KnownFeatures, Linear, LinearError, Moments, Terms};
use proptest::prelude::*;

const NEWEST: usize = FeatureSet::PowerOnly.first();

fn row(features: &[f32], target_w: f32) -> Row {
    let mut row = Row::new([0.0; INPUTS], target_w);
    row.features[..features.len()].copy_from_slice(features);
    row
}

fn rows(count: std::ops::Range<usize>) -> impl Strategy<Value = Vec<Row>> {
    let one = (prop::collection::vec(-2.0f32..2.0, FEATURES), -5.0f32..5.0);
    prop::collection::vec(one.prop_map(|(features, target_w)| row(&features, target_w)), count)
}

/// The same by Gauss-Jordan elimination with full pivoting, on the plain columns and a column of
/// ones.
fn slow_fit(rows: &[Row], terms: Terms) -> Vec<f64> {
    let columns: Vec<usize> = terms.features().collect();
    let line = |row: &Row| -> Vec<f64> {
        let values = columns.iter().map(|at| f64::from(row.features[*at]));
        std::iter::once(1.0).chain(values).collect()
    };
    let size = columns.len() + 1;
    let mut system = vec![vec![0.0; size + 1]; size];
    for row in rows {
        let values = line(row);
        for i in 0..size {
            for j in 0..size {
                system[i][j] += values[i] * values[j];
            }
            system[i][size] += values[i] * f64::from(row.target_w);
        }
    }
    for pivot in 0..size {
        let best = (pivot..size)
            .max_by(|a, b| system[*a][pivot].abs().total_cmp(&system[*b][pivot].abs()))
            .expect("there are rows left");
        system.swap(pivot, best);
        let line = system[pivot].clone();
        for (_, other) in system.iter_mut().enumerate().filter(|(i, _)| *i != pivot) {
            let factor = other[pivot] / line[pivot];
            for (value, pivots) in other.iter_mut().zip(&line).skip(pivot) {
                *value -= factor * pivots;
            }
        }
    }
    (0..size).map(|i| system[i][size] / system[i][i]).collect()
}

fn squares(rows: &[Row], forecasts_w: &[f64]) -> f64 {
    let pairs = rows.iter().zip(forecasts_w);
    pairs.map(|(row, forecast_w)| (f64::from(row.target_w) - forecast_w).powi(2)).sum()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_fit_equals_that_of_a_slow_solver(rows in rows(40..120), bits in 0u32..1 << FEATURES) {
        let chosen: Vec<usize> = (0..FEATURES).filter(|at| bits >> at & 1 == 1).collect();
        let terms = Terms::new(&chosen);
        let linear = Linear::fit(&rows, terms).expect("more rows than columns");
        let wanted = slow_fit(&rows, terms);
        prop_assert!(linear.dropped().is_empty());
        prop_assert!((linear.intercept_w() - wanted[0]).abs() < 1e-7);
        for ((feature, found), (at, wanted)) in linear.coefficients().iter().zip(chosen.iter().zip(&wanted[1..])) {
            prop_assert_eq!(feature, at);
            prop_assert!((found - wanted).abs() < 1e-7, "{found}, not {wanted}");
        }
    }

    #[test]
    fn moments_of_parts_give_the_fit_of_the_whole(rows in rows(60..120), cut in 1usize..59) {
        let mut merged = Moments::new(Terms::AR5_AND_VELOCITIES);
        for part in [&rows[..cut], &rows[cut..]] {
            merged.merge(&Moments::of(part, Terms::AR5_AND_VELOCITIES)).expect("the same terms");
        }
        for terms in [Terms::VELOCITIES, Terms::velocities_and_lags(2), Terms::AR5, Terms::AR5_AND_VELOCITIES] {
            let (found, whole) = (merged.fit(terms).expect("enough rows"), Linear::fit(&rows, terms).expect("enough rows"));
            prop_assert!((found.intercept_w() - whole.intercept_w()).abs() < 1e-9);
            for (found, whole) in found.coefficients().iter().zip(whole.coefficients()) {
                prop_assert_eq!(found.0, whole.0);
                prop_assert!((found.1 - whole.1).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn dependent_columns_are_dropped_and_change_no_forecast(
        rows in rows(40..80), constant in -3.0f32..3.0, twice in -4.0f32..4.0
    ) {
        prop_assume!(twice.abs() > 0.01);
        let mut doubled = rows.clone();
        for row in &mut doubled {
            row.features[2] = constant;
            row.features[NEWEST + 3] = row.features[1] * 2.0;
        }
        let linear = Linear::fit(&doubled, Terms::AR5_AND_VELOCITIES).expect("enough rows");
        prop_assert_eq!(linear.dropped(), [(2, Dropped::Constant), (NEWEST + 3, Dropped::Dependent)]);
        let rest: Vec<usize> = (0..FEATURES).filter(|at| ![2, NEWEST + 3].contains(at)).collect();
        let without = Linear::fit(&doubled, Terms::new(&rest)).expect("enough rows");
        for row in &doubled {
            prop_assert!((linear.predict(&row.features) - without.predict(&row.features)).abs() < 1e-9);
        }
    }

    #[test]
    fn more_features_never_fit_the_same_rows_worse(rows in rows(40..80)) {
        let moments = Moments::of(&rows, Terms::AR5_AND_VELOCITIES);
        let mut before = f64::INFINITY;
        for lags in 0..=5 {
            let linear = moments.fit(Terms::velocities_and_lags(lags)).expect("enough rows");
            let error = squares(&rows, &linear.predict_rows(&rows));
            prop_assert!(error <= before * (1.0 + 1e-9), "{lags} lags");
            before = error;
        }
    }
}

#[test]
fn rows_with_missing_numbers_are_left_out_and_counted() {
    let mut rows: Vec<Row> = (0..50u8)
        .map(|i| {
            let x = f32::from(i);
            row(
                &[x, (x * 0.7).sin(), (x * 1.3).cos(), x.sqrt(), x % 3.0, x % 7.0, 3.0 + x % 5.0],
                1.0 + 2.0 * x,
            )
        })
        .collect();
    let whole = Linear::fit(&rows, Terms::VELOCITIES).expect("enough rows");
    rows.push(row(&[f32::NAN], 9.0));
    rows.push(row(&[1e3], f32::NAN));
    rows.push(row(&[f32::INFINITY], 9.0));
    let found = Linear::fit(&rows, Terms::VELOCITIES).expect("enough rows");
    assert_eq!((found.rows(), found.unusable_rows()), (50, 3));
    assert_eq!(found.coefficients(), whole.coefficients());
    assert!((found.predict(&rows[7].features) - 15.0).abs() < 1e-9);
    assert!(found.predict(&rows[50].features).is_nan(), "NaN input must give NaN");
}

#[test]
fn unrecorded_velocities_are_dropped_and_change_no_forecast() {
    let mut rows: Vec<Row> = (0..30u8)
        .map(|i| {
            let mut row = row(&[f32::NAN; NEWEST], f32::from(i % 4));
            for lag in 0..5u8 {
                let mixed = (u16::from(i) * 7 + u16::from(lag) * 5).pow(2) % 23;
                row.features[NEWEST + usize::from(lag)] = f32::from(mixed);
            }
            row
        })
        .collect();
    let found = Linear::fit(&rows, Terms::AR5_AND_VELOCITIES).expect("the readings are there");
    let alone = Linear::fit(&rows, Terms::AR5).expect("the readings are there");
    assert_eq!(found.coefficients(), alone.coefficients());
    assert_eq!(found.dropped().len(), NEWEST);
    assert!(found.dropped().iter().all(|(_, why)| *why == Dropped::Missing));
    assert!(found.predict(&rows[3].features).is_finite());
    rows.truncate(0);
    let (known, missing) = KnownFeatures::new(&rows, Terms::AR5).split(Terms::AR5);
    assert_eq!((known.count(), missing.len()), (0, 5));
}

#[test]
fn the_coefficients_of_a_linear_series_are_recovered() {
    let mut power_w = vec![3.0f32, 3.5, 2.5, 4.0, 3.2];
    let mut rows = Vec::new();
    for step in 0..400u16 {
        let v = f32::from(step % 37) * 0.01;
        let n = power_w.len();
        let next = 0.5 + 0.6 * power_w[n - 1] + 0.2 * power_w[n - 3] + 4.0 * v;
        let mut features = [0.0; INPUTS];
        features[0] = v;
        for lag in 0..5 {
            features[NEWEST + lag] = power_w[n - 1 - lag];
        }
        rows.push(row(&features, next));
        power_w.push(next);
    }
    let linear = Linear::fit(&rows, Terms::AR5_AND_VELOCITIES).expect("enough rows");
    let errors = linear.predict_rows(&rows);
    assert!(squares(&rows, &errors) < 1e-9);
    let report = linear.report();
    assert!(report.dropped.contains(&("omega_radps", Dropped::Constant)));
    assert_eq!(report.terms, "AR(5) + velocities");
    let persistence = Linear::persistence();
    assert_eq!(persistence.predict(&rows[9].features), f64::from(rows[9].features[NEWEST]));
}

#[test]
fn too_few_rows_and_features_without_moments_are_refused() {
    let few = [row(&[1.0], 1.0), row(&[2.0], 2.0), row(&[4.0], f32::NAN)];
    let error = Linear::fit(&few, Terms::AR5).expect_err("two rows, six numbers");
    assert_eq!(
        error.to_string(),
        "AR(5) needs at least 6 rows with every number known, found 2 of 3. Name more or longer \
         recordings, or fewer features"
    );
    let taken = Moments::of(&few, Terms::AR5);
    assert!(matches!(taken.fit(Terms::VELOCITIES), Err(LinearError::NotTaken { .. })));
    let constant = taken.fit(Terms::new(&[])).expect("two rows have a mean");
    assert_eq!(constant.predict(&few[0].features), 1.5);
    assert_eq!(constant.terms().to_string(), "constant");
    assert_eq!(Terms::new(&[0, NEWEST, 99]).to_string(), "v_mps + power_lag1_w");
}

#[test]
fn ridge_regression_takes_no_penalty_where_a_line_holds_and_one_where_nothing_does() {
    let mut noise = Noise::new(3, 0);
    let mut rows = |count: usize, slope: f32| -> Vec<Row> {
        let each = (0..count).map(|_| {
            let features: [f32; FEATURES] = std::array::from_fn(|_| noise.uniform() as f32);
            row(&features, slope * features[NEWEST] + (1.0 - slope) * noise.uniform() as f32)
        });
        each.collect()
    };
    let size = |line: &Linear| line.coefficients().iter().map(|(_, by)| by * by).sum::<f64>();
    for (slope, shrinks) in [(1.0, false), (0.0, true)] {
        let rows = rows(120, slope);
        let terms = Terms::AR5_AND_VELOCITIES;
        let parts: Vec<Moments> = rows.chunks(24).map(|part| Moments::of(part, terms)).collect();
        let parts: Vec<&Moments> = parts.iter().collect();
        let ridge = Moments::fit_ridge(&parts, terms).unwrap();
        let plain = Linear::fit(&rows, terms).unwrap();
        assert_eq!(size(&ridge) < 0.9 * size(&plain), shrinks, "{ridge:?} {plain:?}");
        assert!(shrinks || (size(&ridge) - size(&plain)).abs() < 1e-3, "{ridge:?} {plain:?}");
    }
}
