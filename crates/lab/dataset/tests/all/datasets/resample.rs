//! Each resampling method against slow, obvious loops.

use joulebus_dataset::trial::{Column, Method, Resample, ResampleError, Table};
use joulebus_testkit::trials::{Files, npy_f8, timed};
use proptest::prelude::*;

fn table(rows: &[(f64, f64)]) -> Table {
    let files = Files::new();
    Table::read(files.write("a.npy", &npy_f8(&timed(rows)))).unwrap()
}

/// The resampled rows. Empty if gaps leave fewer than two rows.
fn resampled(rows: &[(f64, f64)], method: Method, rate_hz: f64) -> Vec<(f64, f64)> {
    let (made, counts) = match table(rows).resampled(Resample { method, rate_hz }) {
        Err(ResampleError::TooFewRows { .. }) => return Vec::new(),
        made => made.unwrap(),
    };
    assert_eq!(counts.rows, made.rows());
    let power = made.column(Column::Power).unwrap();
    made.timestamp_s().iter().copied().zip(power.iter().copied()).collect()
}

/// Times with jitter and gaps of some five periods, with a value each.
fn recording() -> impl Strategy<Value = Vec<(f64, f64)>> {
    let step = prop_oneof![9 => 0.028_f64..0.038, 1 => 0.15_f64..0.3];
    prop::collection::vec((step, -50.0_f64..5_000.0), 20..120).prop_map(|rows| {
        let mut time_s = 0.25;
        let timed = rows.into_iter().map(|(step_s, value)| {
            time_s += step_s;
            (time_s, value)
        });
        timed.collect()
    })
}

fn median_step_s(rows: &[(f64, f64)]) -> f64 {
    let mut steps: Vec<f64> = rows.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    steps.sort_by(f64::total_cmp);
    steps[(steps.len() - 1) / 2]
}

/// When the hold of each row begins and ends.
fn spans(rows: &[(f64, f64)]) -> Vec<(f64, f64, f64)> {
    let period_s = median_step_s(rows);
    let until = |at: usize| match rows.get(at + 1) {
        Some(next) if next.0 - rows[at].0 <= 1.5 * period_s => next.0,
        _ => rows[at].0 + period_s,
    };
    (0..rows.len()).map(|at| (rows[at].0, until(at), rows[at].1)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn hold_yields_the_latest_row_and_only_recorded_values(rows in recording(), rate_hz in 3.0_f64..90.0) {
        for (time_s, value) in resampled(&rows, Method::Hold, rate_hz) {
            let near_s = 1e-3 / rate_hz;
            let latest = rows.iter().rev().find(|row| row.0 <= time_s + near_s).unwrap();
            // Rounding may put a row on either side of the tolerance.
            let edge = rows.iter().any(|row| (row.0 - time_s - near_s).abs() < 1e-9);
            prop_assert!(edge || value.to_bits() == latest.1.to_bits());
            prop_assert!(rows.iter().any(|row| row.1.to_bits() == value.to_bits()));
            let counts = spans(&rows).iter().any(|(from, until, _)| {
                *from - near_s <= time_s && time_s <= *until + 1e-6
            });
            prop_assert!(counts, "a row in a gap at {time_s}");
        }
    }

    #[test]
    fn mean_keeps_the_energy_of_every_period(rows in recording(), rate_hz in 3.0_f64..90.0) {
        let period_s = 1.0 / rate_hz;
        let made = resampled(&rows, Method::Mean, rate_hz);
        let spans = spans(&rows);
        let energy = |from_s: f64, until_s: f64| {
            let overlap = |span: &(f64, f64, f64)| (span.1.min(until_s) - span.0.max(from_s)).max(0.0);
            spans.iter().map(|span| overlap(span) * span.2).sum::<f64>()
        };
        for (time_s, mean) in &made {
            let wanted = energy(time_s - period_s, *time_s);
            prop_assert!((mean * period_s - wanted).abs() <= 1e-5 * 5_000.0 * period_s,
                "{} {wanted} at {time_s}", mean * period_s);
        }
        // Without gaps, resampling keeps the total energy of the rows.
        let whole = made.windows(2).all(|pair| pair[1].0 - pair[0].0 < 1.5 * period_s);
        if whole && !made.is_empty() {
            let (first_s, last_s) = (made[0].0 - period_s, made[made.len() - 1].0);
            let sum = made.iter().map(|(_, mean)| mean * period_s).sum::<f64>();
            let wanted = energy(first_s, last_s);
            prop_assert!((sum - wanted).abs() <= 1e-6 * 5_000.0 * (last_s - first_s));
        }
    }

    #[test]
    fn linear_is_exact_on_a_line(
        rows in recording(),
        rate_hz in 3.0_f64..90.0,
        slope in -900.0_f64..900.0,
    ) {
        let line = |time_s: f64| 40.0 + slope * time_s;
        let rows: Vec<(f64, f64)> = rows.iter().map(|row| (row.0, line(row.0))).collect();
        let near = slope.abs() * 1e-3 / rate_hz;
        for (time_s, value) in resampled(&rows, Method::Linear, rate_hz) {
            let before_gap = spans(&rows).iter().any(|(from, until, _)| {
                time_s - from < 1e-3 / rate_hz && !rows.iter().any(|row| row.0 == *until)
            });
            let allowed = if before_gap { near } else { 1e-9 * (40.0 + slope.abs() * 20.0) };
            prop_assert!((value - line(time_s)).abs() <= allowed, "{value} at {time_s}");
        }
    }

    #[test]
    fn gaps_and_missing_values_are_kept(
        rows in recording(),
        lost in prop::collection::vec(any::<prop::sample::Index>(), 1..6),
        rate_hz in 20.0_f64..90.0,
    ) {
        let mut rows = rows;
        for index in lost {
            let at = index.index(rows.len());
            rows[at].1 = f64::NAN;
        }
        let spans = spans(&rows);
        let near_s = 1e-3 / rate_hz;
        for method in [Method::Hold, Method::Mean, Method::Linear] {
            for (time_s, value) in resampled(&rows, method, rate_hz) {
                // With hold, a row just after the time of the grid is taken as simultaneous.
                let until_s = time_s + if method == Method::Hold { near_s + 1e-9 } else { -1e-9 };
                let span = spans.iter().rev().find(|span| span.0 <= until_s).unwrap_or(&spans[0]);
                prop_assert!(time_s <= span.1 + 2.0 * near_s, "{method:?}: a row in a gap at {time_s}");
                let inside = time_s > span.0 + 2.0 * near_s && time_s < span.1 - 2.0 * near_s;
                if inside && span.2.is_nan() {
                    prop_assert!(value.is_nan(), "{method:?}: {value} at {time_s}");
                }
            }
        }
    }
}

#[test]
fn a_series_already_on_the_grid_is_unchanged() {
    // Times rounded as in files.
    let rows: Vec<(f64, f64)> = (0..300)
        .map(|row| ((f64::from(row) / 30.0 * 1e5).round() / 1e5, f64::from(row * 7 % 11)))
        .collect();
    let made = resampled(&rows, Method::Hold, 30.0);
    assert_eq!(made.len(), rows.len());
    for (made, row) in made.iter().zip(&rows) {
        assert_eq!(made.1, row.1);
    }
}

#[test]
fn phases_are_never_mixed_and_headings_take_the_shorter_arc() {
    let mut rows = timed(&[(0.0, 1.0), (1.0, 2.0), (2.0, 3.0), (3.0, 4.0)]);
    for (row, (phase, theta)) in
        rows.iter_mut().zip([(1.0, 3.0), (1.0, -3.1), (5.0, -3.0), (5.0, 3.1)])
    {
        (row[2], row[7]) = (phase, theta);
    }
    let files = Files::new();
    let table = Table::read(files.write("a.npy", &npy_f8(&rows))).unwrap();
    for method in [Method::Linear, Method::Mean] {
        let how = Resample { method, rate_hz: 0.8 };
        let (made, _) = table.resampled(how).unwrap();
        for phase in made.column(Column::Phase).unwrap() {
            assert!([1.0, 5.0].contains(phase), "{method:?}: {phase}");
        }
        for theta in made.column(Column::Theta).unwrap() {
            assert!(theta.cos() < -0.98, "{method:?}: {theta} is on the longer arc");
        }
    }
}

#[test]
fn rows_that_do_not_advance_are_left_out_and_counted() {
    let rows = [(0.0, 1.0), (1.0, 2.0), (0.5, 9.0), (1.0, 9.0), (2.0, 3.0), (3.0, 4.0)];
    let how = Resample { method: Method::Hold, rate_hz: 1.0 };
    let (made, counts) = table(&rows).resampled(how).unwrap();
    assert_eq!(made.column(Column::Power).unwrap(), [1.0, 2.0, 3.0, 4.0]);
    assert_eq!((counts.rows_before, counts.not_advancing, counts.in_gaps), (6, 2, 0));
}

#[test]
fn invalid_too_high_and_too_low_rates_are_refused() {
    let rows = [(0.0, 1.0), (1.0, 2.0), (200.0, 3.0)];
    type Wrong = fn(&ResampleError) -> bool;
    let cases: [(f64, Wrong); 6] = [
        (0.0, |e| matches!(e, ResampleError::Rate { .. })),
        (-1.0, |e| matches!(e, ResampleError::Rate { .. })),
        (f64::NAN, |e| matches!(e, ResampleError::Rate { .. })),
        (f64::INFINITY, |e| matches!(e, ResampleError::Rate { .. })),
        (90_000.0, |e| matches!(e, ResampleError::TooManyRows { .. })),
        (0.001, |e| matches!(e, ResampleError::TooFewRows { .. })),
    ];
    for (rate_hz, wrong) in cases {
        let how = Resample { method: Method::Hold, rate_hz };
        let refused = table(&rows).resampled(how).unwrap_err();
        assert!(wrong(&refused), "{rate_hz}: {refused}");
    }
}
