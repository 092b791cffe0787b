//! Answers are right if everything is known, and never yes if something is not.

use crate::world::{PERIOD_NS, Rows, fleet, model, platform, settings};
use joulebus_energy::{Commands, EnergyModel, HORIZONS_S, Limit};
use joulebus_plan::report::AnswerReport;
use joulebus_plan::{
    Answer, AskError, Candidates, Differs, Frames, Path, PathError, Plan, PlanFleet, Platform,
    Point, Question, Robot, RobotRows, Row, Trip, Unknown, Verdict, rank, rank_each,
};
use joulebus_wire::{Budget, InvalidReason, PlanState, Quality, budget_flag, plan_state_flag};
use proptest::prelude::*;

const STEP_S: f32 = 1.0 / 30.0;

/// Straight on at a speed.
fn straight(robot: &Robot<'_>, v_mps: f32, steps: usize) -> Answer {
    let (v, omega) = (vec![v_mps; steps], vec![0.0; steps]);
    let candidates = Candidates::new(1, STEP_S, &v, &omega).expect("one candidate");
    robot.what_if(&candidates, 0.9).expect("allowed")[0]
}

#[test]
fn yes_tight_and_no_follow_from_what_the_battery_can_spare() {
    let fleet = fleet();
    // 10 s at 0.1 m/s: 3.6 W as metered at rest, and a sixth more for driving: 42 J ± 10 %.
    let answers: Vec<Answer> = [400.0, 45.0, 30.0]
        .map(|usable_j| straight(&Rows::with_usable(usable_j).robot(&fleet), 0.1, 300))
        .to_vec();
    let verdicts: Vec<Verdict> = answers.iter().map(|answer| answer.verdict).collect();
    assert_eq!(verdicts, [Verdict::Yes, Verdict::Tight, Verdict::No]);
    for (answer, usable_j) in answers.iter().zip([400.0f32, 45.0, 30.0]) {
        let energy = answer.energy.expect("known");
        assert!((energy.mean_j - 42.0).abs() < 0.5, "{answer:?}");
        assert!((energy.lo_j / energy.mean_j - 0.9).abs() < 0.02, "{answer:?}");
        assert!((energy.hi_j / energy.mean_j - 1.1).abs() < 0.02, "{answer:?}");
        let margin_j = answer.margin_j.expect("known");
        // The monitor counts the energy with its error of 3 %, two deviations of it.
        let most_j = energy.hi_j + 0.06 * energy.mean_j;
        assert!((margin_j - (0.9 * usable_j - most_j)).abs() < 0.01, "{answer:?}");
        let left = answer.left.expect("known");
        assert!((left.mean_j - (3_600.0 + usable_j - energy.mean_j)).abs() < 0.1);
        assert!((left.lo_j - (3_600.0 + 0.9 * usable_j - most_j)).abs() < 0.1);
        assert_eq!(answer.limiting_leg.is_none(), answer.verdict == Verdict::Yes);
    }
    let probability = |answer: &Answer| answer.probability.expect("known");
    assert!(probability(&answers[0]) > 0.99 && probability(&answers[2]) < 0.01);
    assert!(probability(&answers[1]) > 0.05 && probability(&answers[1]) < 0.95);
}

#[test]
fn a_learned_capacity_counts_with_its_error_and_the_time_to_charge_follows_the_plan() {
    let fleet = fleet();
    // Half of the stated capacity, up to 30 %.
    let (stated, mut learned) = (Rows::with_usable(60.0), Rows::with_usable(60.0));
    let capacity_j = 18_000.0;
    learned.budget = Budget {
        left_j: 1_860.0,
        soc: 1_860.0 / capacity_j,
        soc_lo: 1_854.0 / capacity_j,
        soc_sd: 3.0 / capacity_j,
        capacity_j,
        capacity_sd_j: 0.3 * capacity_j,
        // To 80 % in 0.7 hours from 10 %, and slower above.
        charge_rate: [1_000, 1_000, 1_000, 1_000, 1_000, 1_000, 1_000, 1_000, 500, 250],
        ..learned.budget
    };
    let answers = [&stated, &learned].map(|rows| straight(&rows.robot(&fleet), 0.1, 300));
    let [before, after] = answers.map(|answer| answer.probability.expect("known"));
    assert!(before > 0.98 && (0.75..0.9).contains(&after), "{before} {after}");
    // The monitor that counts the plan has taught the capacity: only its error counts, once.
    let energy = answers[1].energy.expect("known");
    assert!((answers[1].margin_j.expect("known") - (54.0 - energy.hi_j)).abs() < 0.01);
    let left = answers[1].left.expect("known");
    assert!((left.lo_j - (1_800.0 + 54.0 - energy.hi_j)).abs() < 0.1, "{left:?}");
    let charge = |budget: Option<&Budget>, to: f64| {
        let mut report = AnswerReport::new(&settings(), &Row::new(7, answers[1]));
        report.set_along(&settings(), &[], (budget, Some(to)));
        serde_json::to_value(report).expect("JSON")["charge"].clone()
    };
    let to_80 = charge(Some(&learned.budget), 0.8);
    let [time_s, most_s] = ["time_s", "most_s"].map(|name| to_80[name].as_f64().expect("known"));
    assert!((time_s - 3_600.0 * 0.7).abs() < 10.0 && most_s > time_s, "{to_80}");
    let full = charge(Some(&learned.budget), 1.0);
    assert!((full["time_s"].as_f64().expect("known") - time_s - 2_160.0).abs() < 1.0, "{full}");
    assert!(charge(Some(&stated.budget), 0.8)["time_s"].is_null());
    assert!(charge(None, 0.8)["most_s"].is_null());
}

#[test]
fn whatever_is_unknown_is_reported_and_never_yes() {
    let fleet = fleet();
    let fine = Rows::with_usable(20_000.0);
    assert_eq!(straight(&fine.robot(&fleet), 0.1, 300).verdict, Verdict::Yes);
    type Spoil = fn(&mut Rows);
    let cases: [(Spoil, Unknown); 15] = [
        (|rows| rows.now_ns += 3 * PERIOD_NS, Unknown::Stale { age_ns: 1_000_000 + 3 * PERIOD_NS }),
        // By a clock that is behind the worker's.
        (|rows| rows.now_ns -= 4 * PERIOD_NS, Unknown::Stale { age_ns: 4 * PERIOD_NS - 1_000_000 }),
        (
            |rows| {
                let code = Quality::Invalid(InvalidReason::Stale).encode();
                (rows.state.quality, rows.state.quality_detail) = code;
            },
            Unknown::Invalid { reason: InvalidReason::Stale },
        ),
        (
            |rows| {
                let code = Quality::Warmup { have: 3 }.encode();
                (rows.state.quality, rows.state.quality_detail) = code;
            },
            Unknown::Warmup { have: 3 },
        ),
        (|rows| rows.state.quality = 999, Unknown::Unreadable),
        (|rows| rows.state.flags = 0, Unknown::NoLevel),
        (|rows| rows.state.time_s = [0.0; 4], Unknown::NoLevel),
        (|rows| rows.has_budget = false, Unknown::NoBudget),
        (|rows| rows.budget_header.worker_epoch = 4, Unknown::NoBudget),
        (|rows| rows.budget_header.sent_ns -= 3 * PERIOD_NS, Unknown::NoBudget),
        (|rows| rows.budget_header.tick -= 1, Unknown::NoBudget),
        (|rows| rows.budget.robot = 8, Unknown::NoBudget),
        (|rows| rows.budget.flags &= !budget_flag::CHARGE, Unknown::BatteryUnknown),
        (|rows| rows.budget.usable_lo_j = f32::NAN, Unknown::BatteryUnknown),
        (|rows| rows.budget.flags |= budget_flag::CONTRADICTED, Unknown::BatteryUnknown),
    ];
    for (spoil, reason) in cases {
        let mut rows = fine;
        spoil(&mut rows);
        let answer = straight(&rows.robot(&fleet), 0.1, 300);
        assert_eq!(answer.verdict, Verdict::Unknown(reason), "{answer:?}");
        let battery = matches!(reason, Unknown::NoBudget | Unknown::BatteryUnknown);
        assert_eq!(answer.energy.is_some(), battery, "{answer:?}");
        assert_eq!((answer.left, answer.margin_j), (None, None), "{answer:?}");
        assert!(!reason.to_string().is_empty());
    }
    let spoilt = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    for (place, value) in (0..19).flat_map(|place| spoilt.map(|value| (place, value))) {
        let mut rows = fine;
        let state = &mut rows.state;
        let (energy, command) = (&mut state.energy_j, &mut state.command_j);
        let all = energy.iter_mut().chain(command).chain(&mut state.time_s);
        let all = all.chain(&mut state.error_lower).chain(&mut state.error_upper);
        let trust = std::slice::from_mut(&mut state.command_trust);
        let mut all = all.chain(trust);
        *all.nth(place).expect("19 numbers") = value;
        let answer = straight(&rows.robot(&fleet), 0.1, 300);
        assert_eq!(answer.verdict, Verdict::Unknown(Unknown::NoLevel), "{place}");
    }
    let mut settings = platform().settings;
    settings.battery = None;
    let without = PlanFleet::of(vec![Platform::new(settings, model(), 1)], 1);
    let answer = straight(&fine.robot(&without), 0.1, 300);
    assert_eq!(answer.verdict, Verdict::Unknown(Unknown::NoBattery));
    assert!(answer.energy.is_some());
}

#[test]
fn what_is_not_known_of_a_plan_costs_what_the_platform_can_draw_and_a_weak_state_the_yes() {
    let fleet = fleet();
    let rows = Rows::with_usable(30_000.0);
    let robot = rows.robot(&fleet);
    // The platform allows 0.25 m/s, the training data end at 0.2.
    let outside = straight(&robot, 0.25, 300);
    assert_eq!(outside.caveats.steps_outside_training, 300);
    let hi_j = outside.energy.expect("known").hi_j;
    assert!(hi_j >= 20.0 * 10.0, "20 W are possible for 10 s: {outside:?}");
    assert_eq!(outside.verdict, Verdict::Yes, "even that can be spared");
    assert_eq!(outside.probability, None, "{outside:?}");
    let poor = Rows::with_usable(0.9 * f64::from(hi_j));
    let outside = straight(&poor.robot(&fleet), 0.25, 300);
    assert_eq!(outside.verdict, Verdict::Tight);
    assert!(outside.energy.expect("known").lo_j >= 0.0, "{outside:?}");
    // A jump that no recording has, in one step of many.
    let careful =
        fleet_with(EnergyModel { combined: Some([0.4, 1.0, 100.0, 4.0, 100.0]), ..model() });
    let careful = rows.robot(&careful);
    let gentle = straight(&careful, 0.12, 300);
    assert_eq!((gentle.verdict, gentle.caveats.any()), (Verdict::Yes, false));
    let sudden = straight(&careful, 0.15, 300);
    assert_eq!(sudden.caveats.steps_outside_training, 1);
    assert_eq!((sudden.verdict, sudden.probability), (Verdict::Yes, None));
    let widened_j = sudden.energy.expect("known").hi_j - gentle.energy.expect("known").hi_j;
    assert!(widened_j > 0.9 * 16.0 * STEP_S, "{widened_j} J");
    // 400 s: errors are known up to 300, and extrapolated.
    let long = straight(&robot, 0.1, 12_000);
    assert!(long.caveats.beyond_horizon && long.verdict == Verdict::Yes, "{long:?}");
    assert!(long.probability.is_some(), "{long:?}");
    let mut open = rows;
    open.state.open_steps = 2;
    let answer = straight(&open.robot(&fleet), 0.1, 300);
    assert!(answer.caveats.no_reading && answer.verdict == Verdict::Tight, "{answer:?}");
    // As the worker marks a robot whose newest row is extrapolated.
    let mut extrapolated = rows;
    extrapolated.state.flags |= plan_state_flag::OUTSIDE_TRAINING;
    let answer = straight(&extrapolated.robot(&fleet), 0.1, 300);
    assert!(answer.caveats.state_outside_training, "{answer:?}");
    assert_eq!(answer.verdict, Verdict::Tight);
    // A model file without an energy model.
    let untrained = EnergyModel::untrained(3.0);
    let bare = PlanFleet::of(vec![Platform::new(platform().settings, untrained, 1)], 1);
    let answer = straight(&rows.robot(&bare), 0.1, 300);
    assert_eq!((answer.verdict, answer.probability), (Verdict::Yes, None));
    assert!(answer.energy.expect("known").hi_j >= 199.0, "{answer:?}");
}

#[test]
fn a_step_that_no_model_knows_is_bounded_by_what_was_recorded_and_named() {
    let rows = Rows::with_usable(30_000.0);
    let fleet = fleet_with(EnergyModel { recorded_w: Some([2.5, 6.0]), ..model() });
    let robot = rows.robot(&fleet);
    let outside = straight(&robot, 0.25, 300);
    let energy = outside.energy.expect("known");
    // 2.5 to 6 W for 10 s, a fifth more as the robot draws at rest, and the errors of known steps.
    // The platform may draw 20 W.
    assert!((60.0..80.0).contains(&energy.hi_j) && energy.lo_j > 15.0, "{outside:?}");
    let words = outside.caveats.to_string();
    assert!(
        words.contains("300 steps") && words.contains("v is 0.25 m/s, known from −0.2 to 0.2"),
        "{words}"
    );
    let advised_mps = 0.199;
    assert!(words.contains(&format!("inside at {advised_mps} m/s")), "{words}");
    assert!(!straight(&robot, advised_mps, 300).caveats.any());
    let json = serde_json::to_value(outside.caveats).expect("JSON");
    assert_eq!(json["outside"]["quantity"], "velocity", "{json}");
    // The platform's limits hold where what was recorded reaches beyond them.
    let fleet = fleet_with(EnergyModel { recorded_w: Some([-90.0, 900.0]), ..model() });
    let energy = straight(&rows.robot(&fleet), 0.25, 300).energy.expect("known");
    assert!(energy.lo_j >= 0.0 && energy.hi_j < 250.0, "{energy:?}");
}

#[test]
fn an_answer_says_what_the_recordings_of_its_model_cannot_show() {
    let rows = Rows::with_usable(30_000.0);
    let asked = |limits: &[Limit], hotel_w, v_mps| {
        let fleet = fleet_with(EnergyModel { limits: limits.to_vec(), hotel_w, ..model() });
        let answer = straight(&rows.robot(&fleet), v_mps, 300);
        let names: Vec<&str> = answer.caveats.limits.names().collect();
        (answer.verdict, names, answer.energy.expect("known").mean_j)
    };
    let (_, _, plain_j) = asked(&[], None, 0.1);
    let drive = [Limit::DrivePower, Limit::NoTurns];
    for (limits, v_mps, verdict, names) in [
        (&[Limit::MeasuredVelocities][..], 0.1, Verdict::Tight, &["measured_velocities"][..]),
        (&[Limit::NoVelocities], 0.1, Verdict::Tight, &["no_velocities"]),
        // A robot at rest asks nothing of them.
        (&[Limit::MeasuredVelocities, Limit::NoVelocities], 0.0, Verdict::Yes, &[]),
        // The battery's readings have no hotel load either.
        (&drive, 0.1, Verdict::Yes, &["drive_power"]),
    ] {
        let (found, met, _) = asked(limits, None, v_mps);
        assert_eq!((found, &met[..]), (verdict, names), "{limits:?}");
    }
    let (_, met, energy_j) = asked(&drive, Some(2.0), 0.1);
    assert!(met.is_empty() && (energy_j - plain_j - 20.0).abs() < 0.01, "{energy_j} {plain_j}");
}

#[test]
fn a_plan_as_long_as_the_longest_calibrated_horizon_can_be_a_yes() {
    let rows = Rows::with_usable(30_000.0);
    for (calibrated, horizon_s) in (1..).zip(HORIZONS_S) {
        let energy = EnergyModel { calibrated, ..model() };
        let fleet = fleet_with(energy);
        let robot = rows.robot(&fleet);
        let steps = (30.0 * horizon_s) as usize;
        // Thirty steps of 1/30 s add up to a little more than a second.
        let answers = [straight(&robot, 0.1, steps), robot.idle(horizon_s, 0.9).expect("allowed")];
        for answer in answers {
            assert!((answer.duration_s / horizon_s - 1.0).abs() < 1e-5);
            let energy = answer.energy.expect("known");
            assert!(energy.hi_j < 1.2 * energy.mean_j, "{answer:?}");
            assert_eq!(answer.verdict, Verdict::Yes, "{answer:?}");
            assert!(answer.probability.is_some(), "{answer:?}");
        }
        let longer = robot.idle(1.02 * horizon_s, 0.9).expect("allowed");
        assert!(longer.caveats.beyond_horizon, "{longer:?}");
        assert!(longer.margin_j < answers[1].margin_j, "{longer:?}");
    }
}

#[test]
fn the_interval_of_a_plan_of_any_length_widens_steadily_and_not_to_what_is_possible() {
    let rows = Rows::with_usable(300_000.0);
    for calibrated in 1..=HORIZONS_S.len() {
        let fleet = fleet_with(EnergyModel { calibrated, ..model() });
        let robot = rows.robot(&fleet);
        let relative = |duration_s: f32| {
            let answer = robot.idle(duration_s, 0.9).expect("allowed");
            let energy = answer.energy.expect("known");
            assert!(answer.probability.is_some(), "{answer:?}");
            assert!(energy.lo_j > 0.0, "{answer:?}");
            (energy.hi_j - energy.lo_j) / energy.mean_j
        };
        let longest_s = HORIZONS_S[calibrated - 1];
        let durations = [1.0, 1.01, 1.1, 2.0, 5.0, 12.0, 36.0].map(|times| times * longest_s);
        let widths = durations.map(relative);
        for (pair, durations) in widths.windows(2).zip(durations.windows(2)) {
            let [before, after] = [pair[0], pair[1]];
            assert!(after > 0.999 * before, "{durations:?}: {before} {after}");
            // Without a step where the known errors end.
            let steps = (durations[1] / durations[0]).ln().max(0.01);
            assert!(after < before * (1.0 + 6.0 * steps), "{durations:?}: {before} {after}");
        }
        assert!(widths[6] < 2.5 * widths[0], "{widths:?}");
    }
}

#[test]
fn wrong_questions_are_refused_with_the_value() {
    let fleet = fleet();
    let robot = Rows::with_usable(1_000.0).robot(&fleet);
    let four = [0.1f32; 4];
    assert!(matches!(Candidates::new(0, 0.1, &four, &four), Err(AskError::Empty { .. })));
    assert!(matches!(Candidates::new(1, 0.1, &[], &[]), Err(AskError::Empty { .. })));
    assert!(matches!(Candidates::new(8, 0.1, &four, &four), Err(AskError::Empty { .. })));
    let error = Candidates::new(3, 0.1, &four, &four).expect_err("4 is no multiple of 3");
    assert!(matches!(error, AskError::Shape { found: 4, allowed: 3, .. }), "{error}");
    let error = Candidates::new(2, 0.1, &four, &four[..3]).expect_err("another length");
    assert!(matches!(error, AskError::Shape { column: "omega_radps", found: 3, .. }), "{error}");
    for period_s in [0.0, -0.1, f32::NAN, f32::INFINITY, 61.0] {
        let error = Candidates::new(1, period_s, &four, &four).expect_err("no period");
        assert!(matches!(error, AskError::Period { .. }), "{error}");
    }
    for value in [f32::NAN, f32::INFINITY, -9.0] {
        let mut omega = four;
        omega[3] = value;
        let candidates = Candidates::new(2, 0.1, &four, &omega).expect("the shape is right");
        let error = robot.what_if(&candidates, 0.9).expect_err("no command");
        let is_expected =
            matches!(error, AskError::Command { column: "omega_radps", candidate: 1, step: 1, .. });
        assert!(is_expected, "{error}");
    }
    let candidates = Candidates::new(2, 0.1, &four, &four).expect("the shape is right");
    for coverage in [0.0, 0.4, 1.0, f32::NAN] {
        let error = robot.what_if(&candidates, coverage).expect_err("no coverage");
        assert!(matches!(error, AskError::Coverage { .. }), "{error}");
    }
    let error = robot.power_w(&candidates, &mut [0.0; 3]).expect_err("too short");
    assert_eq!(error, AskError::Results { found: 3, allowed: 4 });
    for duration_s in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let error = robot.idle(duration_s, 0.9).expect_err("no duration");
        assert!(matches!(error, AskError::Duration { .. }), "{error}");
    }
}

/// Commands within the platform's limits.
fn commands(candidates: usize, steps: usize, seed: u32) -> (Vec<f32>, Vec<f32>) {
    let mut state = u64::from(seed) | 1;
    let mut draw = |most: f32| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        most * ((state >> 40) as f32 / (1 << 23) as f32 - 1.0)
    };
    let count = candidates * steps;
    let v = (0..count).map(|_| draw(0.2)).collect();
    (v, (0..count).map(|_| draw(2.0)).collect())
}

#[test]
fn an_alarm_on_a_robots_readings_bars_yes_and_is_named_in_text_json_and_row() {
    let fleet = fleet();
    for (bit, name) in [
        (plan_state_flag::ALARM_NO_DATA, "NoData"),
        (plan_state_flag::ALARM_OUT_OF_RANGE, "OutOfRange"),
        (plan_state_flag::ALARM_STUCK_SENSOR, "StuckSensor"),
        (plan_state_flag::ALARM_HELD_TOO_LONG, "HeldTooLong"),
        (plan_state_flag::ALARM_SOC_IMPLAUSIBLE, "SocImplausible"),
        (plan_state_flag::ALARM_IMPLAUSIBLE, "Implausible"),
    ] {
        let mut rows = Rows::with_usable(20_000.0);
        rows.state.flags |= bit;
        let answer = straight(&rows.robot(&fleet), 0.1, 300);
        assert_eq!(answer.verdict, Verdict::Tight, "{name}");
        assert_eq!(answer.caveats.alarms.names().collect::<Vec<_>>(), [name]);
        assert!(answer.caveats.any() && answer.caveats.to_string().contains(name));
        let json = serde_json::to_value(answer.caveats).expect("JSON");
        assert_eq!(json["alarms"], serde_json::json!([name]));
    }
}

#[test]
fn a_robot_with_an_alarm_on_its_readings_ranks_behind_all_others_that_may_make_it() {
    let fleet = fleet();
    let robot = |id: u32, usable_j: f64, flags: u32| {
        let mut rows = Rows::with_usable(usable_j);
        (rows.state.robot, rows.budget.robot) = (id, id);
        rows.state.flags |= flags;
        rows
    };
    let stuck = plan_state_flag::ALARM_STUCK_SENSOR;
    // Cheaper than the others, were it true: a stuck reading.
    let mut doubted = robot(1, 20_000.0, stuck);
    doubted.state.energy_j = doubted.state.energy_j.map(|energy_j| 0.5 * energy_j);
    let rows =
        [doubted, robot(2, 20_000.0, 0), robot(3, 45.0, 0), robot(4, 2.0, stuck), robot(5, 2.0, 0)];
    let robots: Vec<Robot<'_>> = rows.iter().map(|rows| rows.robot(&fleet)).collect();
    let path = Path::new(&[Point::new(0.0, 0.0), Point::new(1.0, 0.0)], 0.1);
    let ranked = rank(&robots, &path, None, 0.9).expect("allowed");
    let order: Vec<u32> = ranked.iter().map(|ranked| ranked.robot).collect();
    assert_eq!(order, [2, 3, 1, 5, 4]);
    assert_eq!(ranked[1].trip.answer.verdict, Verdict::Tight);
    let each: Vec<_> = robots.iter().map(|robot| (*robot, path.clone())).collect();
    let ranked = rank_each(&each, None, 0.9).expect("allowed");
    assert_eq!(ranked.iter().map(|ranked| ranked.robot).collect::<Vec<_>>(), order);
}

#[test]
fn a_load_that_no_reading_of_the_platform_can_contain_is_refused() {
    let fleet = fleet();
    let robot = Rows::with_usable(20_000.0).robot(&fleet);
    let points = [0.0, 1.0].map(|x_m| Point::new(x_m, 0.0));
    let settings = &robot.platform().settings;
    let most_w = f64::from(settings.power_max_w) - f64::from(settings.power_min_w);
    for (load_w, is_refused) in
        [(most_w, false), (-most_w, false), (5_000.0, true), (-5_000.0, true)]
    {
        let path = Path { load_w: vec![0.0, load_w], ..Path::new(&points, 0.1) };
        let asked = robot.can_finish(&path, None, 0.9);
        assert_eq!(asked.is_err(), is_refused, "{load_w}");
        if let Err(error) = asked {
            let text = error.to_string();
            let wanted = [&load_w.to_string(), &most_w.to_string(), "gternal", "`power_max_w`"];
            assert!(wanted.iter().all(|part| text.contains(*part)), "{text}");
        }
    }
}

#[test]
fn a_speed_above_the_platforms_is_refused_and_none_is_as_fast_as_the_model_knows() {
    let fleet = fleet();
    let robot = Rows::with_usable(20_000.0).robot(&fleet);
    let points = [0.0, 1.0, 2.0].map(|x_m| Point::new(x_m, 0.0));
    // The platform allows 0.25 m/s.
    let path = Path { speed_mps: vec![9.0, 0.25, 0.26], ..Path::new(&points, 0.1) };
    let error = robot.can_finish(&path, None, 0.9).expect_err("too fast");
    let AskError::Path(PathError::TooFast { point: 2, found, allowed, .. }) = &error else {
        panic!("{error}");
    };
    assert_eq!((*found, *allowed), (0.26, 0.25));
    let text = error.to_string();
    assert!(
        ["0.26", "0.25", "gternal", "v_max_mps"].iter().all(|part| text.contains(part)),
        "{text}"
    );
    for speed_mps in [0.25, f64::INFINITY] {
        assert!(robot.can_finish(&Path::new(&points, speed_mps), None, 0.9).is_ok());
    }
}

fn bits(answers: &[Answer]) -> String {
    // Debug prints floats so that they parse to the same bits.
    format!("{answers:?}")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn the_same_question_gives_the_same_bits_in_any_thread_batch_and_order(seed: u32) {
        const CANDIDATES: usize = 12;
        let fleet = fleet();
        let robot = Rows::with_usable(60.0).robot(&fleet);
        let (v, omega) = commands(CANDIDATES, 40, seed);
        let candidates = Candidates::new(CANDIDATES, STEP_S, &v, &omega).expect("allowed");
        let expected = robot.what_if(&candidates, 0.9).expect("allowed");
        let again = std::thread::scope(|scope| {
            let each = v.chunks(40).zip(omega.chunks(40)).map(|(v, omega)| {
                scope.spawn(move || {
                    let candidates = Candidates::new(1, STEP_S, v, omega).expect("allowed");
                    robot.what_if(&candidates, 0.9).expect("allowed")[0]
                })
            });
            let threads: Vec<_> = each.collect();
            threads.into_iter().map(|thread| thread.join().expect("it answers")).collect::<Vec<_>>()
        });
        prop_assert_eq!(bits(&expected), bits(&again));
    }

    #[test]
    fn traces_add_up_to_the_energy_and_gradients_are_its_differences(seed: u32, steps in 1usize..30) {
        let fleet = fleet();
        let robot = Rows::with_usable(60.0).robot(&fleet);
        let (v, omega) = commands(2, steps, seed);
        let ask = |v: &[f32], omega: &[f32]| -> f64 {
            let plan = Commands { period_s: STEP_S, v_mps: v, omega_radps: omega };
            robot.platform().energy.forecast(robot.energy_state(), plan).energy_j.into()
        };
        let candidates = Candidates::new(2, STEP_S, &v, &omega).expect("allowed");
        let answers = robot.what_if(&candidates, 0.9).expect("allowed");
        let mut power_w = vec![0.0; 2 * steps];
        robot.power_w(&candidates, &mut power_w).expect("allowed");
        for (answer, trace) in answers.iter().zip(power_w.chunks(steps)) {
            let sum: f64 = trace.iter().map(|w| f64::from(*w) * f64::from(STEP_S)).sum();
            let mean_j = f64::from(answer.energy.expect("known").mean_j);
            prop_assert!((sum - mean_j).abs() <= 1e-5 * mean_j, "{} {}", sum, mean_j);
        }
        let (mut by_v, mut by_omega) = (vec![0.0; 2 * steps], vec![0.0; 2 * steps]);
        robot.gradient(&candidates, &mut by_v, &mut by_omega).expect("allowed");
        const H: f32 = 1e-3;
        for step in 0..steps {
            let moved = |values: &[f32], by: f32| {
                let mut moved = values[..steps].to_vec();
                moved[step] += by;
                moved
            };
            // Corners of |v| and |dv/dt| have no derivative.
            let is_smooth = |values: &[f32]| {
                let near = |a: f32, b: f32| (a - b).abs() < 4.0 * H;
                let before = step.checked_sub(1).map_or(0.0, |before| values[before]);
                let after = values[..steps].get(step + 1).copied();
                !near(values[step], 0.0) && !near(values[step], before)
                    && after.is_none_or(|after| !near(values[step], after))
            };
            if is_smooth(&v) {
                let slope = ask(&moved(&v, H), &omega[..steps]) - ask(&moved(&v, -H), &omega[..steps]);
                let slope = slope / (2.0 * f64::from(H));
                let found = f64::from(by_v[step]);
                prop_assert!((slope - found).abs() < 0.02 + 0.02 * slope.abs(), "{} {}", slope, found);
            }
            if is_smooth(&omega) {
                let slope = ask(&v[..steps], &moved(&omega, H)) - ask(&v[..steps], &moved(&omega, -H));
                let slope = slope / (2.0 * f64::from(H));
                let found = f64::from(by_omega[step]);
                prop_assert!((slope - found).abs() < 0.02 + 0.02 * slope.abs(), "{} {}", slope, found);
            }
        }
    }

    /// Whatever shared memory contains: no panic, and a yes only with finite numbers that support
    /// it.
    #[test]
    fn arbitrary_rows_never_panic_and_never_answer_yes_without_a_reason(
        state in prop::array::uniform32(any::<u8>()),
        more in prop::collection::vec(any::<u8>(), size_of::<PlanState>() - 32),
        budget in prop::collection::vec(any::<u8>(), size_of::<Budget>()),
        keep in any::<u64>(),
    ) {
        let fleet = fleet();
        let fine = Rows::with_usable(20_000.0);
        let bytes: Vec<u8> = state.iter().chain(&more).copied().collect();
        let mut rows = fine;
        // Each word is kept or spoilt.
        let mix = |fine: &[u8], spoilt: &[u8], seed: u64| -> Vec<u8> {
            let word = |at: usize| seed.rotate_left(at as u32 * 7) & 7 == 0;
            (0..fine.len()).map(|at| if word(at / 4) { spoilt[at] } else { fine[at] }).collect()
        };
        let row = mix(bytemuck::bytes_of(&fine.state), &bytes, keep);
        rows.state = bytemuck::pod_read_unaligned::<PlanState>(&row);
        let row = mix(bytemuck::bytes_of(&fine.budget), &budget, keep.rotate_left(31));
        rows.budget = bytemuck::pod_read_unaligned::<Budget>(&row);
        let frames = Frames {
            header: &rows.header,
            state: &rows.state,
            budget: Some((&rows.budget_header, &rows.budget)),
            now_ns: rows.now_ns,
        };
        let Some(robot) = fleet.robot(&frames) else {
            return Ok(());
        };
        let answer = straight(&robot, 0.1, 300);
        if answer.verdict == Verdict::Yes {
            let energy = answer.energy.expect("a yes knows the energy");
            prop_assert!(energy.lo_j <= energy.mean_j && energy.mean_j <= energy.hi_j);
            prop_assert!(energy.hi_j.is_finite() && energy.hi_j <= rows.budget.usable_lo_j);
            prop_assert!(!answer.caveats.any() && answer.margin_j.is_some_and(|j| j >= 0.0));
        }
        let path = Path::new(&[Point::new(0.0, 0.0), Point::new(0.5, 0.2)], 0.2);
        let trip = robot.can_finish(&path, Some(Point::new(0.0, 0.0)), 0.9);
        prop_assert!(trip.is_ok());
    }

    /// Turning back at the stated time still is a yes, and a fuller battery never shortens it.
    #[test]
    fn turning_back_in_time_is_safe(usable_j in 20.0f64..400.0, x_m in 0.5f64..4.0, y_m in -2.0f64..2.0) {
        let fleet = fleet();
        let path = Path::new(&[Point::new(0.0, 0.0), Point::new(x_m, 0.0), Point::new(x_m, y_m)], 0.15);
        let dock = Point::new(0.0, 0.0);
        let trip_of = |usable_j: f64| {
            let robot = Rows::with_usable(usable_j).robot(&fleet);
            robot.can_finish(&path, Some(dock), 0.9).expect("allowed")
        };
        let (trip, fuller) = (trip_of(usable_j), trip_of(1.5 * usable_j));
        let is_yes = |trip: &Trip| trip.answer.verdict == Verdict::Yes;
        prop_assert!(is_yes(&fuller) || fuller.turn_back_s >= trip.turn_back_s);
        prop_assert!(trip.answer.limiting_leg.is_none() == is_yes(&trip));
        // A robot that can drive the whole path has no time at which it must turn back.
        prop_assert!(!is_yes(&trip) || trip.turn_back_s.is_none());
        let Some(turn_back_s) = trip.turn_back_s else {
            return Ok(());
        };
        let robot = Rows::with_usable(usable_j).robot(&fleet);
        let there = robot.can_finish(&path, None, 0.9).expect("allowed").commands;
        let turn = ((turn_back_s / there.period_s).round() as usize).min(there.v_mps.len());
        let pose = there.poses[turn];
        let home = Path {
            heading_rad: Some(pose.heading_rad),
            ..Path::new(&[pose.at, dock], 0.15)
        };
        let home = robot.can_finish(&home, None, 0.9).expect("allowed").commands;
        let v = [&there.v_mps[..turn], &home.v_mps].concat();
        let omega = [&there.omega_radps[..turn], &home.omega_radps].concat();
        let candidates = Candidates::new(1, there.period_s, &v, &omega).expect("allowed");
        let answer = robot.what_if(&candidates, 0.9).expect("allowed")[0];
        prop_assert_eq!(answer.verdict, Verdict::Yes);
    }
}

/// The test platform with other energies.
fn fleet_with(energy: EnergyModel) -> PlanFleet {
    PlanFleet::of(vec![Platform::new(platform().settings, energy, 1)], 1)
}

#[test]
fn a_trip_that_fits_is_answered_though_the_way_back_from_its_middle_does_not() {
    let fleet = fleet_with(EnergyModel { omega_radps: [-20.0, 20.0], ..model() });
    let (rich, poor) = (Rows::with_usable(30_000.0), Rows::with_usable(150.0));
    let (rich, robot) = (rich.robot(&fleet), poor.robot(&fleet));
    let dock = Point::new(0.0, 0.0);
    let points = [dock, Point::new(2.0, 0.0), Point::new(0.1, 0.0), dock];
    // The last leg, and so the path back, is slow: from the middle it takes more than three
    // minutes.
    let path = Path { speed_mps: vec![0.2, 0.2, 0.2, 0.01], ..Path::new(&points, 0.2) };
    for (max_steps, seconds) in [(2_000, 60.0), (4_000, 120.0)] {
        let trip = robot.can_finish_within(&path, Some(dock), 0.9, max_steps);
        let trip = trip.expect("the whole trip fits");
        assert!(trip.answer.duration_s < 60.0, "{:?}", trip.answer);
        assert_ne!(trip.answer.verdict, Verdict::Yes);
        let whole = rich.can_finish_within(&path, Some(dock), 0.9, max_steps);
        let whole = whole.expect("the whole trip fits");
        assert_eq!((whole.answer.verdict, whole.turn_back_s), (Verdict::Yes, None));
        // 1 cm in a second.
        let turn_back_s = trip.turn_back_s.expect("at once, it can");
        let most_s = 0.01 * seconds / 0.15;
        assert!(turn_back_s > 0.0 && turn_back_s < most_s, "{turn_back_s}");
    }
    // Not even the whole trip fits.
    let error = robot.can_finish_within(&path, Some(dock), 0.9, 300);
    assert!(error.is_err(), "{error:?}");
}

#[test]
fn a_yes_holds_at_the_end_of_every_leg() {
    let mut energy = model();
    // Within the first second the robot may draw twenty times as much.
    energy.errors[0] = energy.errors[0].map(|error| 200.0 * error);
    let fleet = fleet_with(energy);
    let robot = Rows::with_usable(60.0).robot(&fleet);
    let points = [0.0, 0.22, 1.5].map(|x_m| Point::new(x_m, 0.0));
    let trip = robot.can_finish(&Path::new(&points, 0.2), None, 0.9);
    let trip = trip.expect("allowed");
    let (v, omega) = (&trip.commands.v_mps, &trip.commands.omega_radps);
    let at_once = Candidates::new(1, trip.commands.period_s, v, omega).expect("allowed");
    let at_once = robot.what_if(&at_once, 0.9).expect("allowed")[0];
    assert_eq!(at_once.verdict, Verdict::Yes, "{at_once:?}");
    assert_eq!(trip.answer.energy, at_once.energy);
    assert_eq!(trip.answer.verdict, Verdict::Tight, "{:?}", trip.answer);
    assert_eq!(trip.answer.limiting_leg, Some(0));
}

#[test]
fn the_limiting_leg_is_the_first_that_is_not_sure() {
    let fleet = fleet();
    let robot = Rows::with_usable(150.0).robot(&fleet);
    // Some 10 s a metre, 4 W: each leg costs about 45 J, 50 at most; 135 J can be spared for sure.
    let points: Vec<Point> = (0..6).map(|place| Point::new(f64::from(place), 0.0)).collect();
    let trip = robot.can_finish(&Path::new(&points, 0.1), None, 0.9).expect("allowed");
    assert_eq!(trip.commands.leg_ends.len(), 5);
    let leg = trip.answer.limiting_leg.expect("it is too far");
    let ends = &trip.commands.leg_ends;
    let up_to = |leg: usize| {
        let (v, omega) =
            (&trip.commands.v_mps[..ends[leg]], &trip.commands.omega_radps[..ends[leg]]);
        let candidates = Candidates::new(1, trip.commands.period_s, v, omega).expect("allowed");
        robot.what_if(&candidates, 0.9).expect("allowed")[0].verdict
    };
    assert!(leg > 0 && leg < 4, "{leg}");
    assert_eq!(up_to(leg - 1), Verdict::Yes);
    assert_ne!(up_to(leg), Verdict::Yes);
}

#[test]
fn robots_are_ranked_by_verdict_then_energy() {
    let fleet = fleet();
    let robot = |id: u32, usable_j: f64, share: f32| {
        let mut rows = Rows::with_usable(usable_j);
        (rows.state.robot, rows.budget.robot) = (id, id);
        rows.state.energy_j = rows.state.energy_j.map(|joules| share * joules);
        rows
    };
    let mut silent = robot(4, 10_000.0, 1.0);
    silent.now_ns += 10 * PERIOD_NS;
    // Cheap but empty; dear; cheap; unknown; in between.
    let rows = [
        robot(1, 20.0, 0.7),
        robot(2, 10_000.0, 1.3),
        robot(3, 10_000.0, 0.9),
        silent,
        robot(5, 10_000.0, 1.0),
    ];
    let robots: Vec<Robot<'_>> = rows.iter().map(|rows| rows.robot(&fleet)).collect();
    let path = Path::new(&[Point::new(0.0, 0.0), Point::new(1.0, 0.0)], 0.1);
    let ranked = rank(&robots, &path, None, 0.9).expect("allowed");
    let order: Vec<u32> = ranked.iter().map(|ranked| ranked.robot).collect();
    assert_eq!(order, [3, 5, 2, 1, 4]);
    assert!(rank(&[], &path, None, 0.9).expect("allowed").is_empty());
}

#[test]
fn robots_in_different_places_are_ranked_by_their_own_ways_with_the_answers_of_can_finish() {
    let fleet = fleet();
    let robot = |id: u32, usable_j: f64| {
        let mut rows = Rows::with_usable(usable_j);
        (rows.state.robot, rows.budget.robot) = (id, id);
        rows
    };
    let (goal, dock) = (Point::new(1.0, 0.0), Point::new(1.0, 1.0));
    let rows = [robot(1, 10_000.0), robot(2, 10_000.0), robot(3, 5.0)];
    // The first is far, the second near, the third next to the goal without energy.
    let asked: Vec<(Robot<'_>, Path)> = rows
        .iter()
        .zip([-3.0, 0.5, 0.9])
        .map(|(rows, x_m)| (rows.robot(&fleet), Path::new(&[Point::new(x_m, 0.0), goal], 0.1)))
        .collect();
    let ranked = rank_each(&asked, Some(dock), 0.9).expect("allowed");
    let order: Vec<u32> = ranked.iter().map(|ranked| ranked.robot).collect();
    assert_eq!(order, [2, 1, 3]);
    for ranked in &ranked {
        let (robot, path) = &asked[ranked.robot as usize - 1];
        let whole = robot.can_finish(path, Some(dock), 0.9).expect("allowed");
        assert_eq!(ranked.trip.answer, whole.answer);
        assert_eq!(ranked.trip.commands, whole.commands);
        assert_eq!(ranked.trip.turn_back_s, None);
    }
}

#[test]
fn standing_still_costs_the_level_times_the_time() {
    let fleet = fleet();
    let robot = Rows::with_usable(10_000.0).robot(&fleet);
    for duration_s in [0.01f32, 1.0, 60.0, 300.0] {
        let answer = robot.idle(duration_s, 0.9).expect("allowed");
        let mean_j = answer.energy.expect("known").mean_j;
        assert!((answer.duration_s / duration_s - 1.0).abs() < 1e-3, "{answer:?}");
        assert!((mean_j / (3.6 * duration_s) - 1.0).abs() < 0.01, "{answer:?}");
        assert_eq!(answer.verdict, Verdict::Yes);
    }
}

#[test]
fn a_frame_of_another_config_or_model_is_refused_with_both_hashes() {
    let platforms = |count: u64| {
        (0..count).map(|place| Platform::new(platform().settings, model(), 100 + place))
    };
    for count in [1, 2, 20] {
        let fleet = PlanFleet::of(platforms(count).collect(), 7);
        let mut header = Rows::with_usable(1.0).header;
        header.settings_hash = 7;
        header.models = std::array::from_fn(|place| {
            let place = place as u64;
            if place < count { 100 + place } else { 0 }
        });
        header.model_hash =
            if count == 1 { 100 } else { joulebus_wire::combine_hashes(100..100 + count) };
        assert_eq!(fleet.check(&header), Ok(()));
        let mut other = header;
        other.settings_hash = 8;
        let expected = Differs::Settings { found: 8, expected: 7 };
        assert_eq!(fleet.check(&other), Err(expected));
        let mut other = header;
        other.models[0] = 5;
        let error = fleet.check(&other).expect_err("another model");
        assert!(error.to_string().contains("gternal"), "{error}");
        // A model beyond those that are listed.
        let mut other = header;
        other.model_hash ^= 1;
        assert!(matches!(fleet.check(&other), Err(Differs::Model { .. })));
    }
}

#[test]
fn a_row_of_no_robot_of_its_platform_is_none() {
    let fleet = fleet();
    let mut rows = Rows::with_usable(1.0);
    for (robot, platform) in [(100, 0), (7, 1), (7, u16::MAX)] {
        (rows.state.robot, rows.state.platform) = (robot, platform);
        let frames =
            Frames { header: &rows.header, state: &rows.state, budget: None, now_ns: rows.now_ns };
        assert!(fleet.robot(&frames).is_none(), "{robot} {platform}");
    }
}

#[test]
fn loads_and_docking_add_their_energy_to_the_trip_and_to_the_time_to_turn_back() {
    let mut platform = platform();
    let set_docking = |platform: &mut Platform, docking_j| {
        platform.settings.battery.as_mut().expect("it has a battery").docking_j = docking_j;
    };
    let (dock, end) = (Point::new(0.0, 0.0), Point::new(3.0, 0.0));
    let path = Path::new(&[dock, Point::new(1.0, 0.0), end], 0.15);
    let loaded = Path { load_w: vec![0.0, 2.0, -0.5], ..path.clone() };
    let trip = |platform: &Platform, path: &Path, back_to, usable_j| {
        let fleet = PlanFleet::of(vec![platform.clone()], 1);
        Rows::with_usable(usable_j).robot(&fleet).can_finish(path, back_to, 0.9).expect("allowed")
    };
    let mean_j = |trip: &Trip| trip.answer.energy.expect("known").mean_j;
    let plain = trip(&platform, &path, Some(dock), 10_000.0);
    let with_load = trip(&platform, &loaded, Some(dock), 10_000.0);
    let legs_s: Vec<f32> = [0, 1]
        .map(|leg| {
            let ends = &plain.commands.leg_ends;
            (ends[leg] - if leg == 0 { 0 } else { ends[leg - 1] }) as f32 * plain.commands.period_s
        })
        .to_vec();
    let added_j = 2.0 * legs_s[0] - 0.5 * legs_s[1];
    assert!((mean_j(&with_load) - mean_j(&plain) - added_j).abs() < 0.01);
    set_docking(&mut platform, 25.0);
    let docked = trip(&platform, &path, Some(dock), 10_000.0);
    let (before, after) = (plain.answer.energy.unwrap(), docked.answer.energy.unwrap());
    for (before, after) in
        [(before.lo_j, after.lo_j), (before.mean_j, after.mean_j), (before.hi_j, after.hi_j)]
    {
        assert!((after - before - 25.0).abs() < 0.01, "{before} {after}");
    }
    // Who does not return does not dock.
    let one_way = trip(&platform, &path, None, 10_000.0);
    assert!(mean_j(&one_way) < 0.6 * mean_j(&plain));
    // What docking takes is missing on the way: the robot turns back earlier, or not at all.
    let mut turned = |docking_j| {
        set_docking(&mut platform, docking_j);
        trip(&platform, &path, Some(dock), 160.0).turn_back_s
    };
    let (late, early, never) = (turned(0.0), turned(25.0), turned(500.0));
    assert!(late.is_some() && early.is_some() && early < late && never.is_none());
}

#[test]
fn the_moments_of_a_trip_are_answers_to_its_parts_and_the_last_is_the_whole() {
    let fleet = fleet();
    let rows = Rows::with_usable(2_000.0);
    let find = |_| {
        let budget = Some((rows.budget_header, rows.budget));
        Some(RobotRows { header: rows.header, state: rows.state, budget, now_ns: rows.now_ns })
    };
    let path = Path {
        dwell_s: vec![0.0, 30.0, 0.0],
        load_w: vec![0.0, 1.0, 0.0],
        ..Path::new(&[Point::new(0.0, 0.0), Point::new(2.0, 0.0), Point::new(2.0, 1.0)], 0.15)
    };
    let back_to = Some(Point::new(0.0, 0.0));
    let plans = [
        Plan::Follow { robots: vec![7], path, back_to },
        Plan::Idle { robots: vec![7], duration_s: 120.0 },
    ];
    for plan in plans {
        let question = Question { plan, moments: 40, ..Question::default() };
        let reply = question.answer(&fleet, find, joulebus_plan::MAX_STEPS).expect("answered");
        let (whole, along) = (reply.rows[0].answer, &reply.along);
        assert_eq!(along.len(), 40);
        assert_eq!(along[39].answer, whole);
        for pair in along.windows(2) {
            let [before, after] = [pair[0].answer, pair[1].answer];
            assert!(before.duration_s < after.duration_s);
            assert!(before.left.unwrap().mean_j > after.left.unwrap().mean_j);
            assert!(before.margin_j > after.margin_j);
        }
    }
}
