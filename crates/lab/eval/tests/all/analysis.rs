//! `analyze` on data with known statistics, and on the real recordings.

use std::path::Path;

use joulebus_dataset::split::{By, SplitError};
use joulebus_dataset::trial::{Column, Method, Resample, Row, Trial};
use joulebus_eval::analyze::{
    AnalysisSettings, AnalyzeError, Member, Series, analyze, autocorrelation, pooled,
};
use joulebus_eval::score::Recording;
use joulebus_testkit::assert_contains;
use joulebus_testkit::recordings::trials;
use proptest::prelude::*;

/// Uniform on [−1, 1), from a simple reference generator.
fn noise(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// A trial at 30 Hz with this power and velocity in each row.
fn trial(name: &str, rows: impl Iterator<Item = (f64, f64)>) -> Trial {
    let rows = rows.enumerate().map(|(number, (power_w, v_mps))| {
        let mut values = [f64::NAN; Column::ALL.len()];
        values[Column::Power as usize] = power_w;
        if !v_mps.is_nan() {
            values[Column::V as usize] = v_mps;
            values[Column::Omega as usize] = -v_mps / 2.0;
        }
        Row { timestamp_s: number as f64 / 30.0, values }
    });
    Trial::from_rows(Path::new(name), "robot", rows).unwrap()
}

/// AR(1) power with coefficient `keep`.
fn kept(name: &str, rows: usize, keep: f64, hold: usize, seed: u64) -> Trial {
    let mut state = seed;
    let mut away = 0.0;
    let mut shown = 3.0;
    let power = (0..rows).map(move |row| {
        away = keep * away + noise(&mut state);
        if row % hold == 0 {
            shown = 3.0 + 0.1 * away;
        }
        (shown, f64::NAN)
    });
    trial(name, power)
}

fn recordings(trials: &[Trial]) -> Vec<Recording> {
    let each = (0..).zip(trials);
    each.map(|(id, trial)| Recording::new(id, trial.clone())).collect()
}

/// AR(1) trials of these rows, as [`kept`].
fn six(rows: usize, keep: f64, hold: usize) -> Vec<Trial> {
    let trials = (0..6).map(|n| kept(&format!("t_{n}.npy"), rows, keep, hold, n));
    trials.collect()
}

/// The usual settings with this change, and without grids.
fn settings(change: impl FnOnce(&mut AnalysisSettings)) -> AnalysisSettings {
    let mut settings = AnalysisSettings { grids: Vec::new(), ..AnalysisSettings::default() };
    change(&mut settings);
    settings
}

/// The series on a grid, or the native one.
fn series(trials: &[Trial], grid: Option<Resample>) -> Series {
    let settings = settings(|settings| settings.grids.extend(grid));
    let mut found = analyze(&recordings(trials), &settings, &[]).unwrap().series;
    found.pop().unwrap()
}

fn named<'a>(series: &'a Series, name: &str) -> &'a Member {
    let members = &series.ablation.as_ref().unwrap().members;
    let member = members.iter().find(|member| member.name == name);
    member.unwrap_or_else(|| panic!("no {name} in {members:?}"))
}

fn grid(method: Method, rate_hz: f64) -> Option<Resample> {
    Some(Resample { method, rate_hz })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn autocorrelation_equals_two_plain_loops(
        power in prop::collection::vec(prop_oneof![9 => -5.0_f64..5.0, 1 => Just(f64::NAN)], 10..80),
        lags in 1_usize..6,
    ) {
        prop_assume!(power.iter().filter(|value| !value.is_nan()).count() > 3);
        let found = autocorrelation(&trial("t", power.iter().map(|power_w| (*power_w, f64::NAN))), lags);
        let known: Vec<f64> = power.iter().copied().filter(|value| !value.is_nan()).collect();
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        let variance = known.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / known.len() as f64;
        for lag in 1..=lags {
            let (mut sum, mut pairs) = (0.0, 0);
            for at in 0..power.len().saturating_sub(lag) {
                if power[at..=at + lag].iter().all(|value| !value.is_nan()) {
                    sum += (power[at] - mean) * (power[at + lag] - mean);
                    pairs += 1;
                }
            }
            prop_assert_eq!(found.pairs[lag - 1], pairs);
            match found.at_lag[lag - 1] {
                None => prop_assert_eq!(pairs, 0),
                Some(value) => prop_assert!((value - sum / pairs as f64 / variance).abs() < 1e-9),
            }
        }
    }
}

#[test]
fn the_autocorrelation_of_an_ar1_series_is_its_coefficient() {
    let series = series(&six(4_000, 0.9, 1), None);
    for (lag, value) in series.pooled_autocorrelation.iter().enumerate() {
        let wanted = 0.9_f64.powi(lag as i32 + 1);
        let off = (value.unwrap() - wanted).abs();
        assert!(off < 0.03, "lag {}: {value:?} {wanted}", lag + 1);
    }
    assert_eq!(series.held_share, 0.0);
    // Persistence scores 2ρ − 1, one lag ρ².
    assert!((named(&series, "persistence").all.r2 - 0.8).abs() < 0.03);
    assert!((named(&series, "AR(1)").all.r2 - 0.81).abs() < 0.03);
    assert!((named(&series, "AR(5)").all.r2 - 0.81).abs() < 0.03);
    assert_contains(&series.left_out[0], ["velocities"]);
}

#[test]
fn the_share_of_held_readings_in_a_score_is_separated() {
    // Each reading is held for three rows and independent of the next: all skill is repetition.
    let trials = six(6_000, 0.0, 3);
    let native = series(&trials, None);
    let held = native.held_share;
    assert!((held - 2.0 / 3.0).abs() < 1e-3, "{held}");
    assert!((native.pooled_autocorrelation[0].unwrap() - 2.0 / 3.0).abs() < 0.02);
    // The next reading.
    assert!(native.pooled_autocorrelation[2].unwrap().abs() < 0.03);
    let persistence = named(&native, "persistence");
    assert_eq!((persistence.held.mae_w, persistence.held.r2), (0.0, 1.0));
    let r2 = persistence.all.r2;
    assert!((r2 - 1.0 / 3.0).abs() < 0.03, "{persistence:?}");
    assert!((persistence.new.r2 + 1.0).abs() < 0.1, "{persistence:?}");
    // What it saves on held readings, it loses on new ones.
    assert!(persistence.held_share_of_gain > 1.5);
    let rows = persistence.held.rows + persistence.new.rows;
    assert_eq!(rows, persistence.all.rows);

    // The same readings at their own rate: no skill remains.
    let at_10_hz = series(&trials, grid(Method::Hold, 10.0));
    let (name, held) = (at_10_hz.name.as_str(), at_10_hz.held_share);
    assert_eq!((name, held), ("held at 10 Hz", 0.0));
    assert!(at_10_hz.pooled_autocorrelation[0].unwrap().abs() < 0.03);
    assert!(named(&at_10_hz, "AR(5)").all.r2 < 0.01);
}

#[test]
fn power_that_depends_on_the_command_is_explained_by_velocities() {
    let trials: Vec<Trial> = (0..6)
        .map(|n| {
            let mut state = n;
            let mut command = move |_| noise(&mut state);
            // A row pairs the command with the reading that follows.
            let rows = (0..800).map(move |row| {
                let v_mps = command(row);
                (3.0 + v_mps + 0.5 * v_mps.abs(), v_mps)
            });
            trial(&format!("t_{n}.npy"), rows)
        })
        .collect();
    let series = series(&trials, None);
    assert!(named(&series, "velocities").all.r2 > 0.999_999);
    assert!(named(&series, "velocities + 1 lag").all.mae_w < 1e-5);
    assert!(named(&series, "AR(5)").all.r2 < 0.02);
    assert!(named(&series, "persistence").all.r2 < -0.8);
    let ablation = series.ablation.as_ref().unwrap();
    let [training, validation, held_out] = series.split.rows;
    assert_eq!(training + validation, ablation.fitted_rows);
    assert_eq!(held_out, ablation.rows);
    let split = "by trial, 15 % for validation, 30 % held out, seed 0";
    assert_contains(&series.split.name, [split]);
}

#[test]
fn a_group_is_held_out_by_name_and_an_unknown_one_is_refused() {
    let trials: Vec<Trial> = (0..6)
        .map(|n| {
            let group = ["ICE", "SNOW", "SAND"][n as usize / 2];
            kept(&format!("{group}_{}.npy", n % 2), 200, 0.5, 1, n)
        })
        .collect();
    let leave_out = |names: &[&str]| {
        let settings = settings(|settings| {
            settings.leave_out = names.iter().map(|name| (*name).to_owned()).collect();
            settings.split.by = By::Group;
        });
        analyze(&recordings(&trials), &settings, &[])
    };
    let found = leave_out(&["ICE"]).unwrap();
    let split = &found.series[0].split;
    assert_eq!(split.held_out, ["ICE"]);
    assert_contains(&split.name, ["ICE held out"]);
    assert!(!split.training.is_empty() && !split.validation.is_empty());
    let refused = |names: &[&str]| match leave_out(names) {
        Err(AnalyzeError::Split(error)) => error,
        other => panic!("{other:?}"),
    };
    let unknown = refused(&["MUD"]);
    assert!(matches!(unknown, SplitError::Unknown { .. }));
    assert_contains(&unknown, ["ICE, SAND, SNOW"]);
    let few = refused(&["ICE", "SNOW"]);
    assert!(matches!(few, SplitError::TooFew { .. }));
    let no_lags = settings(|settings| settings.lags = 0);
    let long = settings(|settings| settings.window = 6);
    for (settings, what) in [(no_lags, "lags"), (long, "1 to 5")] {
        let refused = analyze(&recordings(&trials), &settings, &[]);
        assert_contains(&refused.unwrap_err(), [what]);
    }
    let none = analyze(&[], &AnalysisSettings::default(), &[]);
    assert!(matches!(none, Err(AnalyzeError::NoTrial)));
}

/// The reference is `../shared/data/README.md`, computed by another program with another split. Its
/// correlations also count the pairs across the ends of trials.
#[test]
fn the_robotino_scores_equal_the_reference() {
    let Some(paths) = trials("robotino") else {
        return;
    };
    let trials: Vec<Trial> = paths.iter().map(|path| Trial::read(path).unwrap()).collect();
    let settings = settings(|settings| settings.grids.extend(grid(Method::Linear, 30.0)));
    let found = analyze(&recordings(&trials), &settings, &[]).unwrap();
    let wanted = [(0.888, 0.819, 0.03, 0.860), (0.928, 0.895, 0.03, 0.909)];
    for (series, (lag_1, persistence, velocities, all)) in found.series.iter().zip(wanted) {
        let (name, first) = (&series.name, series.pooled_autocorrelation[0].unwrap());
        let r2 = |member: &str| named(series, member).all.r2;
        for (what, found, wanted, allowed) in [
            ("lag 1", first, lag_1, 0.01),
            ("persistence", r2("persistence"), persistence, 0.01),
            ("velocities", r2("velocities"), velocities, 0.04),
            ("all", r2("AR(5) + velocities"), all, 0.01),
        ] {
            let off = (found - wanted).abs();
            assert!(off <= allowed, "{name}: {what} {found:.4}, {wanted}");
        }
    }
    let ours = pooled(&trials, 1).at_lag;
    assert_eq!(ours[0], found.series[0].pooled_autocorrelation[0]);
}
