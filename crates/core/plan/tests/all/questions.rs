//! Questions and replies survive their payloads, and invalid ones are refused.

use crate::world::{Rows, fleet};
use joulebus_plan::answering::Work;
use joulebus_plan::{
    Candidates, Path, Plan, Point, Question, QuestionError, Refused, Reply, RobotRows, Unknown,
    Verdict, acknowledgement, rank, statement,
};
use joulebus_wire::{
    Alarm, AnswerHeader, MAX_QUERY_STEPS, QueryHeader, QueryRefusal, SCHEMA_VERSION, Statement,
    plan_state_flag, query_flag,
};
use proptest::prelude::*;

const FLEET: u64 = 5;

fn rows(rows: &Rows, robot: u32) -> RobotRows {
    let mut state = rows.state;
    state.robot = robot;
    let mut budget = rows.budget;
    budget.robot = robot;
    RobotRows {
        header: rows.header,
        state,
        budget: rows.has_budget.then_some((rows.budget_header, budget)),
        now_ns: rows.now_ns,
    }
}

fn path() -> Path {
    Path::new(&[Point::new(0.0, 0.0), Point::new(1.0, 0.0), Point::new(1.0, -0.5)], 0.15)
}

fn questions() -> Vec<Question> {
    let commands = Plan::WhatIf {
        robot: 7,
        candidates: 3,
        period_s: 0.1,
        v_mps: (0..30).map(|at| at as f32 * 0.005).collect(),
        omega_radps: (0..30).map(|at| at as f32 * -0.01).collect(),
    };
    let idle = Plan::Idle { robots: vec![7, 3], duration_s: 20.0 };
    let follow = |robots: &[u32], heading_rad, back_to| Plan::Follow {
        robots: robots.to_vec(),
        path: Path { heading_rad, ..path() },
        back_to,
    };
    let plans = [
        commands,
        idle,
        follow(&[7], Some(0.5), None),
        Plan::Follow {
            robots: vec![7],
            path: Path { time_s: vec![3.0, 4.0, 60.0], tolerance_m: Some(0.025), ..path() },
            back_to: None,
        },
        Plan::Follow {
            robots: vec![7],
            path: Path {
                dwell_s: vec![0.0, 4.0, 2.0],
                load_w: vec![0.0, 0.5, -0.2],
                tolerance_m: Some(0.0),
                ..path()
            },
            back_to: Some(Point::new(0.0, 0.0)),
        },
        follow(&[9, 7, 3], None, Some(Point::new(0.1, -0.0))),
    ];
    let question = |plan| Question {
        moments: if matches!(plan, Plan::WhatIf { .. }) { 0 } else { 4 },
        plan,
        coverage: 0.9,
        power: true,
    };
    plans.into_iter().map(question).collect()
}

#[test]
fn questions_and_replies_survive_their_payloads() {
    let (fleet, mut robots) = (fleet(), Rows::with_usable(5_000.0));
    robots.state.flags |= plan_state_flag::OUTSIDE_TRAINING
        | plan_state_flag::ALARM_IMPLAUSIBLE
        | plan_state_flag::ALARM_NO_DATA;
    // Faster than the training data.
    let (v_mps, omega_radps) = (vec![0.25; 20], vec![0.0; 20]);
    let fast = Plan::WhatIf { robot: 7, candidates: 2, period_s: 0.1, v_mps, omega_radps };
    let fast = Question { plan: fast, coverage: 0.9, power: true, moments: 0 };
    let path = Path::new(&[Point::new(0.0, 0.0), Point::new(1.0, 0.0)], 0.25);
    let plan = Plan::Follow { robots: vec![7], path, back_to: None };
    let fast = [fast.clone(), Question { plan, moments: 4, ..fast }];
    for question in questions().into_iter().chain(fast.clone()) {
        let (header, values) = question.encode(FLEET).unwrap();
        assert_eq!(Question::decode(&header, &values, FLEET).as_ref(), Ok(&question));
        let moments = question.moments;
        let find = |robot| Some(rows(&robots, robot));
        let reply = question.clone().answer(&fleet, find, MAX_QUERY_STEPS).unwrap();
        assert!(!reply.rows.is_empty());
        let (mut header, mut words) = (AnswerHeader::default(), Vec::new());
        header.schema = SCHEMA_VERSION;
        reply.encode(&mut header, &mut words);
        let outside = reply.rows[0].answer.caveats.outside;
        assert_eq!(outside.is_some(), fast.contains(&question), "{question:?}");
        let of_part = reply.along.first().and_then(|row| row.answer.caveats.outside);
        assert_eq!(of_part.is_some(), outside.is_some() && moments > 0, "{question:?}");
        assert_eq!(Reply::decode(&header, &words, moments), Ok(reply), "{question:?}");
        // A worker of an earlier version sends no reasons, and a capture keeps none.
        words.truncate(8 * header.rows as usize + (header.powers as usize).div_ceil(2));
        let earlier = Reply::decode(&header, &words, moments).unwrap();
        assert_eq!(earlier.rows[0].answer.caveats.outside, None);
    }
}

#[test]
fn only_an_alarm_of_the_own_level_is_acknowledged_as_the_new_normal() {
    for alarm in Alarm::ALL {
        let encode = |new_normal| acknowledgement::encode(7, alarm, "ann", new_normal, FLEET);
        let (known, values) = encode(false).unwrap();
        let flagged = QueryHeader { flags: query_flag::NEW_NORMAL, ..known };
        let decode = |header| acknowledgement::decode(header, &values, FLEET, 5);
        let taken = decode(&known).unwrap();
        assert_eq!((taken.robot, taken.alarm(), taken.by()), (7, alarm, "ann"));
        if matches!(alarm, Alarm::LevelHigh | Alarm::LevelLow) {
            assert_eq!(encode(true).unwrap().0, flagged);
            assert_eq!(decode(&flagged), Ok(taken));
            continue;
        }
        // As a program that does not check it would ask.
        for refused in [encode(true).unwrap_err(), decode(&flagged).unwrap_err()] {
            assert_eq!(refused.reason, QueryRefusal::Question);
            let text = &refused.text;
            assert!(text.starts_with(alarm.name()), "{text}");
            assert!(text.contains("allowed: LevelHigh, LevelLow"), "{text}");
        }
    }
    for question in questions() {
        let (mut header, values) = question.encode(FLEET).unwrap();
        header.flags |= query_flag::NEW_NORMAL;
        let refused = Question::decode(&header, &values, FLEET).unwrap_err();
        assert_eq!(refused.reason, QueryRefusal::Kind, "{question:?}");
    }
}

#[test]
fn a_statement_of_a_battery_travels_whole_or_is_refused_with_what_is_allowed() {
    for stated in [Statement::Charge(0.8), Statement::Full, Statement::Exchanged] {
        let (header, values) = statement::encode(7, stated, "Zoë", FLEET).unwrap();
        let decode = |header, values: &[f64]| statement::decode(header, values, FLEET);
        assert_eq!(decode(&header, &values), Ok((7, stated, "Zoë".to_owned())));
        let question = Question::decode(&header, &values, FLEET).unwrap_err();
        assert_eq!(question.reason, QueryRefusal::Kind);
        let (mut wrong, mut flagged) = (values.clone(), header);
        wrong[1] = 9.0;
        assert_eq!(decode(&header, &wrong).unwrap_err().reason, QueryRefusal::Question);
        flagged.flags = query_flag::NEW_NORMAL;
        assert_eq!(decode(&flagged, &values).unwrap_err().reason, QueryRefusal::Kind);
        let short = decode(&header, &values[..values.len() - 1]).unwrap_err();
        assert_eq!(short.reason, QueryRefusal::Length);
        assert_eq!(
            statement::decode(&header, &values, FLEET + 1).unwrap_err().reason,
            QueryRefusal::Fleet
        );
    }
    for (stated, by) in [
        (Statement::NewNormal, "ann"),
        (Statement::Charge(1.5), "ann"),
        (Statement::Charge(f32::NAN), "ann"),
        (Statement::Full, ""),
    ] {
        let refused = statement::encode(7, stated, by, FLEET).unwrap_err();
        assert!(refused.text.contains("allowed"), "{stated:?}: {refused:?}");
    }
}

#[test]
fn several_robots_are_answered_as_rank_answers() {
    let (fleet, poor) = (fleet(), Rows::with_usable(20.0));
    let rich = Rows::with_usable(20_000.0);
    let of = |robot| rows(if robot == 3 { &rich } else { &poor }, robot);
    let question = questions().pop().unwrap();
    let reply = question.answer(&fleet, |robot| Some(of(robot)), MAX_QUERY_STEPS).unwrap();
    let all = [9, 7, 3].map(of);
    let robots: Vec<_> = all.iter().map(|rows| fleet.robot(&rows.frames()).unwrap()).collect();
    let ranked = rank(&robots, &path(), Some(Point::new(0.1, -0.0)), 0.9).unwrap();
    assert_eq!(reply.rows[0].robot, 3);
    for (row, ranked) in reply.rows.iter().zip(&ranked) {
        assert_eq!((row.robot, row.answer), (ranked.robot, ranked.trip.answer));
        assert_eq!(row.turn_back_s, ranked.trip.turn_back_s);
    }
}

#[test]
fn a_yes_whose_state_is_stale_when_the_answer_is_sent_is_unknown() {
    let (fleet, poor) = (fleet(), Rows::with_usable(20.0));
    let rich = Rows::with_usable(20_000.0);
    let of = |robot| Some(rows(if robot == 3 { &rich } else { &poor }, robot));
    let stale_ns = rich.header.sent_ns + 2 * rich.header.period_ns + 1;
    // Straight ahead: all commands are inside the training data.
    let end = Point::new(1.0, 0.0);
    let reply = |sent_ns| {
        let question = Question {
            plan: Plan::Follow {
                robots: vec![9, 7, 3],
                path: Path::new(&[Point::new(0.0, 0.0), end], 0.15),
                back_to: Some(end),
            },
            coverage: 0.9,
            power: false,
            moments: 0,
        };
        let mut work = Work::begin(question, of, MAX_QUERY_STEPS).unwrap();
        while !work.step(&fleet).unwrap() {}
        work.finish_at(sent_ns)
    };
    let (fresh, stale) = (reply(stale_ns - 1), reply(stale_ns));
    let yes = fresh.rows[0];
    assert_eq!((yes.robot, yes.answer.verdict), (3, Verdict::Yes));
    // Sorted behind robots with known energy.
    let row = stale.rows[2];
    let age_ns = stale_ns - rich.header.sent_ns;
    assert_eq!(row.robot, 3);
    assert_eq!(row.answer.verdict, Verdict::Unknown(Unknown::Stale { age_ns }));
    assert_eq!((row.answer.energy, row.turn_back_s), (yes.answer.energy, None));
    assert_eq!(stale.rows[0].answer, fresh.rows[1].answer);
}

/// Straight ahead, so that all commands are inside the training data.
fn straight(robots: &[u32]) -> Question {
    let end = Point::new(1.0, 0.0);
    Question {
        plan: Plan::Follow {
            robots: robots.to_vec(),
            path: Path::new(&[Point::new(0.0, 0.0), end], 0.15),
            back_to: Some(end),
        },
        coverage: 0.9,
        power: false,
        moments: 0,
    }
}

#[test]
fn a_way_is_followed_once_for_all_robots_of_a_platform_and_each_is_a_step_of_its_own() {
    let (fleet, poor) = (fleet(), Rows::with_usable(60.0));
    let steps = |robots: &[u32]| {
        let find = |robot| Some(rows(&poor, robot));
        let mut question = straight(robots);
        if let Plan::Follow { back_to, .. } = &mut question.plan {
            *back_to = Some(Point::new(0.0, 0.0));
        }
        let mut work = Work::begin(question, find, MAX_QUERY_STEPS).unwrap();
        let mut steps = 1;
        while !work.step(&fleet).unwrap() {
            steps += 1;
        }
        steps
    };
    let (one, four) = (steps(&[3]), steps(&[3, 7, 9, 11]));
    // The path, up to 64 ways back, and the robot.
    assert!(one > 30 && one <= 66, "{one}");
    assert_eq!(four, one + 3);
}

#[test]
fn rows_taken_again_are_answered_as_if_they_were_the_first_without_following_a_way_again() {
    let (fleet, robots) = (fleet(), [3, 7, 9]);
    let (old, mut new) = (Rows::with_usable(20_000.0), Rows::with_usable(200.0));
    new.header.sent_ns += 1_000_000_000;
    new.budget_header.sent_ns += 1_000_000_000;
    new.now_ns += 1_000_000_000;
    let mut work = Work::begin(straight(&robots), |robot| Some(rows(&old, robot)), MAX_QUERY_STEPS);
    let work = work.as_mut().unwrap();
    while !work.step(&fleet).unwrap() {}
    assert!(!work.is_stale(old.now_ns) && work.is_stale(new.now_ns));
    let find = |robot| Some(rows(&new, robot));
    let mut work = std::mem::take(work).renew(find).unwrap();
    assert!(!work.is_stale(new.now_ns));
    assert!(work.rest(&fleet).unwrap(), "nothing is left to be followed");
    let expected = straight(&robots).answer(&fleet, find, MAX_QUERY_STEPS).unwrap();
    assert_eq!(work.finish_at(new.now_ns), expected);
    assert_ne!(expected.rows[0].answer.left, None);
}

#[test]
fn the_worker_answers_a_trip_of_most_of_an_hour_as_its_commands_are_answered() {
    let (fleet, robots) = (fleet(), Rows::with_usable(200_000.0));
    let points = [0.0, 200.0, 0.0].map(|x_m| Point::new(x_m, 0.0));
    let path = Path { dwell_s: vec![0.0, 60.0, 0.0], ..Path::new(&points, 0.15) };
    let plan = Plan::Follow { robots: vec![7], path: path.clone(), back_to: None };
    let question = Question { plan, moments: 48, ..Question::default() };
    let find = |robot| Some(rows(&robots, robot));
    let reply = question.answer(&fleet, find, MAX_QUERY_STEPS).unwrap();
    let answer = reply.rows[0].answer;
    assert!((2_700.0..3_600.0).contains(&answer.duration_s), "{answer:?}");
    assert_eq!(reply.along[47].answer, answer);
    let robot = robots.robot(&fleet);
    let trip = robot.can_finish(&path, None, 0.9).unwrap();
    assert_eq!(trip.answer, answer);
    let commands = trip.commands.commands();
    let columns = (commands.v_mps, commands.omega_radps);
    let commands = Candidates::new(1, commands.period_s, columns.0, columns.1).unwrap();
    let alone = robot.what_if(&commands, 0.9).unwrap()[0].energy.unwrap();
    let energy = answer.energy.unwrap();
    assert!((energy.mean_j / alone.mean_j - 1.0).abs() < 1e-5, "{energy:?} {alone:?}");
}

#[test]
fn robots_that_are_not_there_and_paths_that_take_too_long_are_refused() {
    let (fleet, robots) = (fleet(), Rows::with_usable(5_000.0));
    let question = questions().pop().unwrap();
    let nobody = question.clone().answer(&fleet, |_| None, MAX_QUERY_STEPS);
    assert_eq!(nobody, Err(QuestionError::UnknownRobot { robot: 9 }));
    let short = question.answer(&fleet, |robot| Some(rows(&robots, robot)), 20);
    let refused = Refused::from(&short.unwrap_err());
    assert_eq!(refused.reason, QueryRefusal::Question);
    let (mut header, mut words) = (AnswerHeader::default(), Vec::new());
    header.schema = SCHEMA_VERSION;
    refused.encode(&mut header, &mut words);
    assert_eq!(Reply::decode(&header, &words, 0), Err(refused));
}

proptest! {
    #[test]
    fn headers_and_values_with_arbitrary_bits_never_panic(
        header: [u8; size_of::<QueryHeader>()],
        values: Vec<f64>,
        known: bool,
    ) {
        let mut header: QueryHeader = bytemuck::pod_read_unaligned(&header);
        if known {
            (header.schema, header.fleet) = (SCHEMA_VERSION, FLEET);
            header.kind = 1 + header.kind % 3;
            header.flags &= 7;
            header.robots %= 3;
            header.candidates %= 3;
            header.steps %= 4;
        }
        let decoded = Question::decode(&header, &values, FLEET);
        if let Ok(question) = decoded {
            let (fleet, robots) = (fleet(), Rows::with_usable(5_000.0));
            let _ = question.answer(&fleet, |robot| Some(rows(&robots, robot)), 50);
        }
    }

    #[test]
    fn answers_with_arbitrary_bits_never_panic(
        header: [u8; size_of::<AnswerHeader>()],
        words: Vec<u64>,
    ) {
        let mut header: AnswerHeader = bytemuck::pod_read_unaligned(&header);
        header.schema = SCHEMA_VERSION;
        for refusal in [header.refusal, 0] {
            header.refusal = refusal;
            let _ = Reply::decode(&header, &words, 3);
        }
    }
}
