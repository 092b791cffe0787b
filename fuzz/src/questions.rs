//! Questions, answers and records of both as another process might write them into shared memory.
//!
//! An input's first byte selects a valid question, whose header and values the rest overwrites; or,
//! if its third bit is set, the rest is the header's lengths and the words of an answer and of a
//! frame of records.

use std::sync::OnceLock;

use joulebus_capture_format::Query;
use joulebus_fleet::Fleet;
use joulebus_plan::{Path, Plan, PlanFleet, Point, Question, Refused, Reply, RobotRows};
use joulebus_testkit_fleets::{MS, PERIOD_NS, Source, healthy};
use joulebus_wire::{
    AnswerHeader, Budget, MAX_ANSWER_WORDS, PlanState, QueryHeader, SCHEMA_VERSION, answer_parts,
    records,
};

use super::frames::setting;
use super::input::Input;

const FLEET: u64 = 7;
const START_NS: u64 = 60_000 * MS;
/// Bounds the time that an input takes.
const MAX_STEPS: usize = 300;
/// Robots of three platforms; the fourth is not in the fleet.
const ROBOTS: [u32; 4] = [1, 101, 201, 5];

/// The rows from which plans of a fleet start.
struct Rows {
    plans: PlanFleet,
    states: Vec<PlanState>,
    budgets: Vec<Budget>,
    answer: AnswerHeader,
}

fn rows() -> &'static Rows {
    static ROWS: OnceLock<Rows> = OnceLock::new();
    ROWS.get_or_init(|| {
        let (settings, models) = setting(0);
        let plans = PlanFleet::new(&settings, &models);
        let mut fleet = Fleet::new(settings, models).expect("the settings agree");
        let mut source = Source::new(1, 10);
        let mut now_ns = START_NS;
        for step in 0..40 {
            now_ns += PERIOD_NS;
            let samples = [1, 101, 201].map(|robot| healthy(robot, step, now_ns, PERIOD_NS));
            source.tick(&mut fleet, &samples, now_ns);
        }
        let all = 0..fleet.len();
        Rows {
            plans,
            states: all.clone().map(|row| fleet.plan_state(row)).collect(),
            budgets: all.map(|row| fleet.budget(row)).collect(),
            answer: AnswerHeader {
                schema: SCHEMA_VERSION,
                worker_epoch: 1,
                tick: 40,
                period_ns: PERIOD_NS,
                sent_state_ns: now_ns,
                budget_epoch: 1,
                budget_tick: 40,
                sent_budget_ns: now_ns,
                now_ns,
                ..AnswerHeader::default()
            },
        }
    })
}

fn question(choice: u8) -> Question {
    let wave = |at: u8| f32::from(at % 5) * 0.01;
    let path = |heading_rad| Path {
        heading_rad,
        ..Path::new(&[Point::new(0.0, 0.0), Point::new(0.3, 0.0), Point::new(0.3, 0.2)], 0.1)
    };
    let plan = match choice % 4 {
        0 => Plan::WhatIf {
            robot: 1,
            candidates: 3,
            period_s: 0.1,
            v_mps: (0..12).map(wave).collect(),
            omega_radps: (1..13).map(wave).collect(),
        },
        1 => Plan::Idle { robots: ROBOTS[..3].to_vec(), duration_s: 20.0 },
        2 => {
            let (dwell_s, load_w) = (vec![0.0, 2.0, 0.5], vec![0.0, -0.1, 0.2]);
            let path = Path { dwell_s, load_w, tolerance_m: Some(0.02), ..path(Some(0.5)) };
            Plan::Follow { robots: vec![101], path, back_to: None }
        }
        _ => Plan::Follow {
            robots: ROBOTS[..3].to_vec(),
            path: Path { time_s: vec![5.0, 9.0, 9.0], ..path(None) },
            back_to: Some(Point::new(0.1, -0.0)),
        },
    };
    Question { plan, coverage: 0.9, power: choice % 4 != 1, moments: usize::from(choice % 4) }
}

fn set_header(header: &mut QueryHeader, field: u8, value: u64) {
    let (small, single, double) =
        (value as u32, f32::from_bits(value as u32), f64::from_bits(value));
    match field % 15 {
        0 => header.schema = small,
        1 => header.kind = small,
        2 => header.kind = 1 + small % 3,
        3 => header.fleet = value,
        4 => header.flags = small,
        5 => header.flags ^= small % 256,
        6 => header.robots = small,
        7 => header.candidates = small,
        8 => header.steps = small,
        9 => header.coverage = single,
        10 => header.period_s = single,
        11 => header.duration_s = single,
        12 => header.tolerance_m = single,
        13 => (header.return_x_m, header.return_y_m) = (double, -double),
        _ => header.heading_rad = double,
    }
}

pub(crate) fn run(bytes: &[u8]) -> bool {
    let mut input = Input(bytes);
    match input.u8() {
        choice if choice & 4 == 0 => asked(choice, &mut input),
        _ => answered(&mut input),
    }
}

fn asked(choice: u8, input: &mut Input<'_>) -> bool {
    let (mut header, mut values) = question(choice).encode(FLEET).expect("it fits");
    for _ in 0..input.u8() % 4 {
        set_header(&mut header, input.u8(), input.u64());
    }
    for _ in 0..input.u8() % 8 {
        let place = usize::from(input.u8()) % values.len();
        values[place] = f64::from_bits(input.u64());
    }
    values.resize(values.len() + usize::from(input.u8()) % 3, 0.1);
    values.truncate(values.len() - (usize::from(input.u8()) % 3).min(values.len()));
    let Ok(question) = Question::decode(&header, &values, FLEET) else {
        return false;
    };
    let (header, values) = question.encode(FLEET).expect("what was decoded is encoded");
    let again = Question::decode(&header, &values, FLEET).expect("what was encoded is decoded");
    let (header_again, values_again) = again.encode(FLEET).expect("it fits");
    // As bytes: NaN is not equal to itself.
    assert_eq!(bytemuck::bytes_of(&header), bytemuck::bytes_of(&header_again));
    assert_eq!(
        bytemuck::cast_slice::<f64, u64>(&values),
        bytemuck::cast_slice::<f64, u64>(&values_again)
    );
    answer(question)
}

fn answer(question: Question) -> bool {
    let rows = rows();
    let find = |robot| {
        let state = rows.states.iter().find(|row| row.robot == robot)?;
        let budget = rows.budgets.iter().find(|row| row.robot == robot);
        Some(RobotRows::recorded(&rows.answer, *state, budget.copied()))
    };
    let (mut header, mut words) = (rows.answer, Vec::new());
    let moments = question.moments;
    let replied = question.answer(&rows.plans, find, MAX_STEPS);
    match &replied {
        Ok(reply) => reply.encode(&mut header, &mut words),
        Err(error) => Refused::from(error).encode(&mut header, &mut words),
    }
    assert!(words.len() <= MAX_ANSWER_WORDS, "{} words", words.len());
    let found = Reply::decode(&header, &words, moments);
    assert_eq!(found.is_ok(), replied.is_ok());
    let mut again = (rows.answer, Vec::new());
    match &found {
        Ok(reply) => reply.encode(&mut again.0, &mut again.1),
        Err(refused) => refused.encode(&mut again.0, &mut again.1),
    }
    assert_eq!(again, (header, words), "decoded and encoded");
    replied.is_ok()
}

fn answered(input: &mut Input<'_>) -> bool {
    let header = AnswerHeader {
        schema: SCHEMA_VERSION,
        refusal: u32::from(input.u8()),
        rows: input.u32(),
        powers: input.u32(),
        text_bytes: input.u32(),
        ..AnswerHeader::default()
    };
    let mut words = Vec::new();
    while !input.is_empty() {
        words.push(input.u64());
    }
    let (rows, powers, text) = answer_parts(&header, &words);
    let held = size_of_val(rows) + size_of_val(powers) + text.len();
    assert!(held <= size_of_val(words.as_slice()), "{held} bytes");
    let is_read = Reply::decode(&header, &words, 0).is_ok();
    for record in records(&words) {
        let query = Query::of_record(record);
        let counts = (query.values.len(), query.rows.len(), query.power_w.len());
        assert!(8 * counts.0 + 64 * counts.1 + 4 * counts.2 <= size_of_val(words.as_slice()));
        assert_eq!(query.clone().counted().record.words, query.record.words);
    }
    is_read
}
