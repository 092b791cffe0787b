//! Offline evaluation against a slow oracle computed from the table's columns, and against a mixed
//! fleet.

use std::ops::Range;

use joulebus_dataset::trial::{Column, Playback, Trial, TrialFleet};
use joulebus_eval::evaluate::{
    EvaluateError, RobotEvaluation, Series, Step, evaluate, evaluate_trial,
};
use joulebus_fleet::Fleet;
use joulebus_predictor::{FeatureSet, LAGS, Model, features};
use joulebus_statistics::metrics::tally;
use joulebus_testkit::assert_contains;
use joulebus_testkit::recordings::trials;
use joulebus_testkit::trials::{Files, npy_f8, timed};
use joulebus_wire::{
    DropReason, InvalidReason, Quality, SCHEMA_VERSION, SampleHeader, diagnostic_flag,
};

use super::model::{HUSKY, ROBOTINO, ROVER, network, networks, persistence, settings};

/// Every `every`-th recording of a platform, with robot ids from `first`.
fn some(platform: &str, first: u32, every: usize) -> Option<Vec<(u32, Trial)>> {
    let paths = trials(platform)?;
    let read = |path| Trial::read(path).unwrap_or_else(|error| panic!("{error}"));
    let each = paths.iter().step_by(every).map(read);
    Some((first..).zip(each).collect())
}

fn all_platforms(every: usize) -> Option<Vec<(u32, Trial)>> {
    let platforms = [("robotino", ROBOTINO), ("borealtc_husky", HUSKY), ("ase_rover", ROVER)];
    let mut trials = Vec::new();
    for (platform, first) in platforms {
        trials.extend(some(platform, first, every)?);
    }
    Some(trials)
}

fn period_ns(robot: u32) -> u64 {
    let settings = settings();
    let mut platforms = settings.platforms.iter();
    let own = platforms.find(|platform| platform.robots[0].contains(&robot));
    own.unwrap().period_ns
}

fn is_gap_free(robot: u32, trial: &Trial) -> bool {
    let longest_ns = period_ns(robot) as i64 * 3 / 2;
    let mut steps = trial.offset_ns().windows(2).map(|pair| pair[1] - pair[0]);
    steps.all(|step_ns| 0 < step_ns && step_ns <= longest_ns)
        && trial.notes().missing_readings == 0
        && trial.period_ns() as i64 <= longest_ns
}

fn bits(value: Option<f32>) -> Option<u32> {
    value.map(f32::to_bits)
}

/// Forecasts after each row, computed directly from the columns in one batch.
fn oracle(model: &Model, trial: &Trial) -> Vec<Option<f32>> {
    let n = trial.rows();
    let [v, omega, power] = [Column::V, Column::Omega, Column::Power].map(|column| {
        let value = |row: usize| trial.column(column).map_or(f32::NAN, |all| all[row] as f32);
        (0..n).map(value).collect::<Vec<f32>>()
    });
    let time_ns = trial.offset_ns();
    let (mut owners, mut rows) = (Vec::new(), Vec::new());
    for t in LAGS - 1..n {
        let lag_w: [f32; LAGS] = std::array::from_fn(|lag| power[t - lag]);
        let (v_mps, omega_radps, previous) = if t + 1 < n {
            let dt_s = ((time_ns[t + 1] - time_ns[t]) as f64 * 1e-9) as f32;
            (v[t + 1], omega[t + 1], Some((v[t], omega[t], dt_s)))
        } else {
            (f32::NAN, f32::NAN, None)
        };
        if model.needs_command() && v_mps.is_nan() {
            continue;
        }
        owners.push(t);
        rows.push(features(v_mps, omega_radps, previous, &lag_w));
    }
    let mut forecasts_w = vec![0.0; rows.len()];
    model.predict(&rows, &mut forecasts_w);
    let mut after = vec![None; n];
    for (t, forecast_w) in owners.into_iter().zip(forecasts_w) {
        after[t] = Some(forecast_w);
    }
    after
}

fn assert_equals_oracle(found: &RobotEvaluation, model: &Model, trial: &Trial) {
    let context = format!("{} by {}", trial.path().display(), model.name());
    let expected = oracle(model, trial);
    let power = trial.column(Column::Power).unwrap();
    let mut scored = Vec::new();
    assert_eq!(found.steps.len(), trial.rows(), "{context}");
    for (t, step) in found.steps.iter().enumerate() {
        let reading_w = power[t] as f32;
        let residual_w = t.checked_sub(1).and_then(|before| expected[before]);
        let residual_w = residual_w.map(|forecast_w| reading_w - forecast_w);
        let (found, wanted) = (bits(step.power_w), bits(expected[t]));
        assert_eq!(found, wanted, "{context}: forecast after row {t}");
        let (found, wanted) = (bits(step.residual_w), bits(residual_w));
        assert_eq!(found, wanted, "{context}: residual of row {t}");
        assert!(step.accepted, "{context}: {t}");
        assert_eq!(step.scored, residual_w.is_some(), "{context}: {t}");
        if let (Some(lo_w), Some(hi_w)) = (step.lo_w, step.hi_w) {
            assert!(lo_w <= hi_w, "{context}: {t}");
        }
        let has_interval = step.lo_w.is_some();
        assert_eq!(has_interval, step.power_w.is_some(), "{context}: {t}");
        if let Some(residual_w) = residual_w {
            let row = [reading_w, residual_w, power[t - 1] as f32].map(f64::from);
            scored.push(<(f64, f64, f64)>::from(row));
        }
    }
    let n = scored.len() as f64;
    let mean = scored.iter().map(|row| row.0).sum::<f64>() / n;
    let total = scored.iter().map(|row| (row.0 - mean).powi(2)).sum::<f64>();
    let error = scored.iter().map(|row| row.1.powi(2)).sum::<f64>();
    let step: f64 = scored.iter().map(|row| (row.0 - row.2).powi(2)).sum();
    let near = |found: f64, wanted: f64| (found - wanted).abs() <= 1e-8 * (1.0 + wanted.abs());
    assert_eq!(found.scores.count, scored.len() as u64, "{context}");
    assert!(near(found.scores.r2(), 1.0 - error / total), "{context}");
    let persistence_r2 = found.scores.persistence_r2();
    assert!(near(persistence_r2, 1.0 - step / total), "{context}");
    assert!(near(found.scores.skill(), 1.0 - error / step), "{context}");
}

#[test]
fn on_gap_free_trials_the_tick_equals_one_batch_over_the_columns_to_the_bit() {
    let Some(trials) = all_platforms(3) else {
        return;
    };
    let settings = settings();
    let power_only = network(9, FeatureSet::PowerOnly, 30.0);
    let fleets = [networks(), vec![persistence(); 3], vec![power_only; 3]];
    let mut compared = [0; 3];
    for (robot, trial) in trials.iter().filter(|entry| is_gap_free(entry.0, &entry.1)) {
        let kind = (*robot / 1_000 - 1) as usize;
        for models in &fleets {
            let found = evaluate_trial(&settings, models, *robot, trial).unwrap();
            assert_equals_oracle(&found, &models[kind], trial);
        }
        compared[kind] += 1;
    }
    println!("gap-free trials compared: {compared:?}");
    assert!(compared.iter().all(|count| *count >= 5), "{compared:?}");
}

/// Live output for a robot after a sample, as bits.
fn step_bits(step: &Step) -> [Option<u32>; 4] {
    [step.power_w, step.lo_w, step.hi_w, step.residual_w].map(bits)
}

#[test]
fn a_mixed_fleet_gives_the_bits_of_each_robot_alone_for_any_frame_length() {
    let Some(trials) = all_platforms(20) else {
        return;
    };
    let (settings, models) = (settings(), networks());
    let evaluation = evaluate(&settings, &models, &trials).unwrap();
    for frame_period_ms in [7, 33, 400] {
        let playback = Playback {
            base_ns: 77_000_000_000,
            frame_period_ns: frame_period_ms * 1_000_000,
            repeat: false,
        };
        let mut source = TrialFleet::new(trials.clone(), playback).unwrap();
        let mut fleet = Fleet::new(settings.clone(), models.clone()).unwrap();
        let mut header = SampleHeader {
            schema: SCHEMA_VERSION,
            source_id: 5,
            source_epoch: 6,
            ..SampleHeader::default()
        };
        let (mut frame, mut compared) = (Vec::new(), 0);
        while let Some(due_ns) = source.next_due_ns() {
            source.frame_into(due_ns, &mut frame);
            let now_ns = playback.base_ns + due_ns;
            fleet.take(&header, &frame, now_ns);
            fleet.tick(now_ns, false);
            header.frame_seq += 1;
            header.samples_before += frame.len() as u64;
            for place in 0..fleet.len() {
                let (live, diagnostic) = (fleet.forecast(place), fleet.diagnostic(place));
                if !frame.iter().any(|sample| sample.robot == live.robot) {
                    continue;
                }
                let of_it = |found: &&RobotEvaluation| found.robot == live.robot;
                let alone = evaluation.robots.iter().find(of_it).unwrap();
                let step = &alone.steps[live.sample_seq as usize];
                let has_residual = diagnostic.flags & diagnostic_flag::RESIDUAL != 0;
                let interval = live.interval_w();
                let live_bits = [
                    live.expected_w(),
                    interval.map(|ends| ends.0),
                    interval.map(|ends| ends.1),
                    has_residual.then_some(diagnostic.residual_w),
                ];
                let context = format!("{frame_period_ms} ms: {live:?}");
                assert_eq!(live_bits.map(bits), step_bits(step), "{context}");
                assert_eq!(live.quality(), step.quality, "{context}");
                compared += 1;
            }
        }
        assert!(compared > 1_000, "{frame_period_ms} ms: {compared}");
        assert_eq!(fleet.drops().total(), 0);
        for alone in &evaluation.robots {
            assert_eq!(fleet.scores(alone.robot), Some(alone.scores));
            let (found, alone) = (fleet.ledger(alone.robot).unwrap(), &alone.ledger);
            assert_eq!(found.drawn_uj, alone.drawn_uj);
            assert_eq!(found.drawn_remainder, alone.drawn_remainder);
            assert_eq!(found.metered_ns, alone.metered_ns);
            assert_eq!(found.unmetered_ns, alone.unmetered_ns);
        }
    }
}

#[test]
fn without_commands_a_model_that_needs_them_makes_the_rover_invalid() {
    let Some(trials) = some("ase_rover", ROVER, 20) else {
        return;
    };
    let models = vec![network(1, FeatureSet::Full, 10.0); 3];
    let evaluation = evaluate(&settings(), &models, &trials).unwrap();
    for robot in &evaluation.robots {
        assert_eq!(robot.drops.total(), 0);
        for step in &robot.steps[LAGS - 1..] {
            assert_eq!(step.quality, Quality::Invalid(InvalidReason::NoCommand));
            assert_eq!((step.power_w, step.residual_w), (None, None));
        }
        assert_eq!(robot.scores.count, 0);
        // Its energy is metered nevertheless.
        assert!(robot.ledger.drawn_uj > 0);
    }
    let [left_out] = &evaluation.robots[0].left_out()[..] else { panic!("one reason") };
    assert_contains(&left_out.to_string(), ["samples without forecast: NoCommand"]);
}

#[test]
fn pooled_persistence_on_all_robotino_trials_scores_as_published() {
    let Some(trials) = some("robotino", ROBOTINO, 1) else {
        return;
    };
    let evaluation = evaluate(&settings(), &vec![persistence(); 3], &trials).unwrap();
    assert_eq!(evaluation.robots.len(), 648);
    assert_eq!(evaluation.robots.iter().map(|robot| robot.accepted).sum::<u64>(), 264_476);
    assert!(evaluation.robots.iter().all(|robot| robot.left_out().is_empty()));
    let (mut readings_w, mut forecasts_w) = (Vec::new(), Vec::new());
    for series in evaluation.robots.iter().map(Series::new) {
        readings_w.extend(series.reading_w);
        forecasts_w.extend(series.forecast_w);
    }
    // The published .819 was measured on the held-out 30 %.
    let r2 = tally(&readings_w, &forecasts_w, f64::NAN).r2();
    println!("pooled persistence: R² {r2:.4}, {} scored", readings_w.len());
    assert!((0.78..0.86).contains(&r2), "{r2}");
    for robot in &evaluation.robots {
        // The model is persistence too; residuals are f32, the baseline's errors f64.
        assert!(
            robot.scores.count == 0
                || (robot.scores.r2() - robot.scores.persistence_r2()).abs() < 1e-6
        );
    }
}

#[test]
fn a_robot_that_leaves_during_its_recording_comes_back_and_every_scored_reading_counts() {
    /// Changes the time, s, and the power, mW, of a row.
    type Change = fn(usize, &mut (f64, f64));
    let kinds: [(&str, Range<usize>, Change); 6] = [
        ("a gap that ingest takes", 1_500..3_000, |_, row| {
            row.0 += 59.0;
        }),
        ("a gap of a day", 1_500..3_000, |_, row| row.0 += 86_400.0),
        ("impossible values for 40 s", 300..1_500, |_, row| {
            row.1 = -1e9;
        }),
        ("impossible values at first", 0..1_500, |_, row| {
            row.1 = 1e12;
        }),
        ("a stamp of a day later", 700..701, |_, row| {
            row.0 += 86_400.0;
        }),
        ("a day after each row", 0..3_000, |number, row| {
            row.0 = 86_400.0 * number as f64;
        }),
    ];
    let files = Files::new();
    let mut settings = settings();
    settings.intake.leave_after_ns = 30_000_000_000;
    settings.intake.max_jump_ns = 60_000_000_000;
    for (place, (kind, changed, change)) in kinds.into_iter().enumerate() {
        let mut rows: Vec<(f64, f64)> =
            (0..3_000).map(|row| (f64::from(row) / 30.0, 5_000.0 + f64::from(row % 7))).collect();
        for row in changed {
            change(row, &mut rows[row]);
        }
        let file = format!("{place}.npy");
        let trial = Trial::read(files.write(&file, &npy_f8(&timed(&rows)))).unwrap();
        for models in [vec![persistence(); 3], networks()] {
            let found = evaluate_trial(&settings, &models, ROVER, &trial).unwrap();
            let of =
                |is: fn(&Step) -> bool| found.steps.iter().filter(|step| is(step)).count() as u64;
            assert_eq!(found.steps.len(), rows.len(), "{kind}");
            let seen = found.accepted + found.drops.total();
            assert_eq!(seen, rows.len() as u64, "{kind}");
            assert_eq!(found.accepted, of(|step| step.accepted), "{kind}");
            let scored = of(|step| step.scored && step.residual_w.is_some());
            assert_eq!(found.scores.count, scored, "{kind}");
            assert!(scored == 0 || found.scores.mae_w().is_finite(), "{kind}");
        }
        let found = evaluate_trial(&settings, &vec![persistence(); 3], ROVER, &trial).unwrap();
        let last = found.steps.last().unwrap();
        let is_back = kind != "a day after each row" && kind != "a stamp of a day later";
        assert!(!is_back || last.power_w.is_some(), "{kind}: {last:?}");
    }
}

#[test]
fn samples_refused_by_ingest_are_empty_steps_and_counted() {
    let files = Files::new();
    let mut rows =
        (0..12).map(|row| (f64::from(row) * 0.03, 5_000.0 + f64::from(row))).collect::<Vec<_>>();
    rows[7].0 = rows[6].0; // The sample before it has the stamp of row 7.
    rows[9].1 = 1e9;
    let trial = Trial::read(files.write("odd.npy", &npy_f8(&timed(&rows)))).unwrap();
    let found = evaluate_trial(&settings(), &vec![persistence(); 3], ROVER, &trial).unwrap();
    assert_eq!((found.accepted, found.drops.total()), (10, 2));
    assert_eq!(found.drops.get(DropReason::BadTime), 1);
    assert_eq!(found.drops.get(DropReason::PowerOutOfRange), 1);
    let shown: Vec<String> = found.left_out().iter().map(ToString::to_string).collect();
    let named = ["1 samples dropped: PowerOutOfRange", "1 samples dropped: BadTime"];
    assert!(named.iter().all(|why| shown.iter().any(|one| one.ends_with(why))), "{shown:?}");
    for (t, step) in found.steps.iter().enumerate() {
        assert_eq!(step.accepted, t != 6 && t != 9, "{t}");
        if !step.accepted {
            let quality = step.quality;
            assert!(matches!(quality, Quality::Invalid(_)), "{t}: {quality:?}");
            assert_eq!((step.power_w, step.residual_w), (None, None));
            assert!(!step.scored);
        }
    }
}

#[test]
fn invalid_evaluations_are_refused_with_their_numbers() {
    let files = Files::new();
    let trial =
        Trial::read(files.write("two.npy", &npy_f8(&timed(&[(0.0, 1.0), (1.0, 1.0)])))).unwrap();
    let (settings, models) = (settings(), vec![persistence(); 3]);
    let twice = [(ROVER, trial.clone()), (ROVER, trial.clone())];
    let refused = |trials: &[(u32, Trial)]| evaluate(&settings, &models, trials).unwrap_err();
    assert_eq!(refused(&[]), EvaluateError::NoTrial);
    let (robot, platforms) = (7, 3);
    let unknown = EvaluateError::UnknownRobot { robot, platforms };
    assert_eq!(refused(&[(7, trial.clone())]), unknown);
    let robot = ROVER;
    assert_eq!(refused(&twice), EvaluateError::DuplicateRobot { robot });
    let few = evaluate(&settings, &models[..1], &[(ROVER, trial)]).unwrap_err();
    assert!(matches!(few, EvaluateError::Settings(_)), "{few}");
}

#[test]
fn a_trial_alone_is_metered_over_its_rows_and_states_what_was_left_out() {
    let files = Files::new();
    let rows = (0..40).map(|row| (f64::from(row) / 30.0, 5_000.0 + f64::from(row % 7) * 100.0));
    let trial =
        Trial::read(files.write("saw.npy", &npy_f8(&timed(&rows.collect::<Vec<_>>())))).unwrap();
    let robot = evaluate_trial(&settings(), &networks(), ROVER, &trial).unwrap();
    assert_eq!((robot.scores.count, robot.steps.len()), (35, 40));
    assert!(robot.left_out().is_empty(), "a warm-up is no reason: {:?}", robot.left_out());
    // The samples' drawn energy. Their last stamp is one period after the last row.
    let drawn_j = robot.ledger.drawn_uj as f64 / 1e6;
    let metered_s = robot.ledger.metered_ns as f64 / 1e9;
    assert!((metered_s - 39.0 / 30.0).abs() < 1e-6, "{metered_s}");
    assert!((drawn_j / metered_s - 5.29).abs() < 0.02, "{drawn_j} J");
    assert!(robot.steps.iter().all(|step| step.accepted));
}
