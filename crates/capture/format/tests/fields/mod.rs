//! Messages with arbitrary bits, and every field of them by name: adding a field to a payload
//! causes a compile error here.
#![allow(dead_code, reason = "each test uses a part")]

use joulebus_capture_format::{Message, Query};
use joulebus_wire::{
    AnswerHeader, AnswerRow, Budget, BudgetHeader, Diagnostic, DiagnosticHeader, DropCounts,
    Forecast, ForecastHeader, LISTED_MODELS, PlanState, PlanStateHeader, QueryHeader, QueryRecord,
    Refusal, Sample, SampleHeader, StateHeader, TakenFrame, TickHeader,
};

/// Arbitrary bits, often special values: zeros, ones, -0, infinities, NaNs with and without sign.
pub(crate) struct Bits(pub(crate) u64);

impl Bits {
    pub(crate) fn u64(&mut self) -> u64 {
        // SplitMix64, as published by Steele, Lea and Flood.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        let awkward = [0, 1, u64::MAX, 1 << 63, 0x8000_0000_8000_0000];
        match z % 16 {
            0..=4 => awkward[(z % 16) as usize],
            5 => z | 0x7ff0_0000_7f80_0000,
            _ => z,
        }
    }

    pub(crate) fn u32(&mut self) -> u32 {
        self.u64() as u32
    }

    pub(crate) fn u16(&mut self) -> u16 {
        self.u64() as u16
    }

    pub(crate) fn f32(&mut self) -> f32 {
        f32::from_bits(self.u32())
    }

    pub(crate) fn f64(&mut self) -> f64 {
        f64::from_bits(self.u64())
    }

    pub(crate) fn rows<T>(&mut self, row: impl Fn(&mut Self) -> T) -> Vec<T> {
        (0..self.u64() % 5).map(|_| row(self)).collect()
    }
}

/// A number by its bits, so that NaNs are comparable and -0 differs from 0.
pub(crate) trait ToBits {
    fn bits(&self) -> u64;
}

impl ToBits for u16 {
    fn bits(&self) -> u64 {
        u64::from(*self)
    }
}

impl ToBits for u32 {
    fn bits(&self) -> u64 {
        u64::from(*self)
    }
}

impl ToBits for u64 {
    fn bits(&self) -> u64 {
        *self
    }
}

impl ToBits for i64 {
    fn bits(&self) -> u64 {
        *self as u64
    }
}

impl ToBits for f32 {
    fn bits(&self) -> u64 {
        u64::from(self.to_bits())
    }
}

impl ToBits for f64 {
    fn bits(&self) -> u64 {
        self.to_bits()
    }
}

/// Names and bits of fields.
pub(crate) type Fields = Vec<(&'static str, u64)>;

/// Functions that create a payload of arbitrary bits, and that destructure one completely.
macro_rules! payload {
    ($make:ident, $fields:ident, $type:ident { $($field:ident: $kind:ident),* $(,)? }) => {
        pub(crate) fn $make(bits: &mut Bits) -> $type {
            $type { $($field: bits.$kind(),)* }
        }

        pub(crate) fn $fields(payload: &$type) -> Fields {
            let $type { $($field),* } = payload;
            vec![$((stringify!($field), $field.bits())),*]
        }
    };
}

payload!(
    sample,
    sample_fields,
    Sample {
        robot: u32,
        flags: u32,
        seq: u64,
        stamp_ns: u64,
        measured_ns: u64,
        v_mps: f32,
        omega_radps: f32,
        power_w: f32,
        voltage_v: f32,
        current_a: f32,
        soc: f32,
        return_j: f32,
        reserved: u32,
    }
);
payload!(
    sample_header,
    sample_header_fields,
    SampleHeader {
        schema: u32,
        pid: u32,
        source_id: u64,
        source_epoch: u64,
        frame_seq: u64,
        samples_before: u64,
        intended_ns: u64,
        sent_ns: u64,
        sent_unix_ns: u64,
    }
);
payload!(
    forecast,
    forecast_fields,
    Forecast {
        robot: u32,
        flags: u32,
        quality: u16,
        quality_detail: u16,
        reading_w: f32,
        power_w: f32,
        lo_w: f32,
        hi_w: f32,
        generation: u32,
        sample_seq: u64,
        stamp_ns: u64,
        target_ns: u64,
        reading_age_ns: u64,
        source_epoch: u64,
    }
);
payload!(
    diagnostic,
    diagnostic_fields,
    Diagnostic {
        robot: u32,
        flags: u32,
        level: u16,
        alarm: u16,
        alarms: u32,
        residual_w: f32,
        residual_z: f32,
        bias_w: f32,
        cusum_up: f32,
        cusum_down: f32,
        noise_ratio: f32,
        coverage: f32,
        coverage_recent: f32,
        scored: u64,
        mae_w: f64,
        r2: f64,
        persistence_mae_w: f64,
        persistence_r2: f64,
        skill: f64,
        sample_seq: u64,
        stamp_ns: u64,
        source_epoch: u64,
        refused: u64,
        network_w: f32,
        mean_w: f32,
        change_w: f32,
        weight_last: f32,
        weight_network: f32,
        weight_stack: f32,
        held_weight_last: f32,
        held_weight_stack: f32,
        gain_last: f32,
        gain_network: f32,
        gain_mean: f32,
        level_w: f32,
    }
);
payload!(
    budget,
    budget_fields,
    Budget {
        robot: u32,
        flags: u32,
        charge_state: u32,
        battery_changes: u32,
        drawn_uj: i64,
        drawn_remainder: i64,
        forecast_uj: i64,
        metered_ns: u64,
        unmetered_ns: u64,
        stamp_ns: u64,
        valid_until_ns: u64,
        mean_power_w: f32,
        left_j: f32,
        usable_j: f32,
        usable_lo_j: f32,
        soc: f32,
        soc_lo: f32,
        time_to_empty_s: f32,
        time_to_empty_lo_s: f32,
        time_to_empty_hi_s: f32,
        soc_hi: f32,
        soc_sd: f32,
        sensor_bias: f32,
        sensor_bias_sd: f32,
        sensor_covariance: f32,
    }
);
payload!(
    budget_header,
    budget_header_fields,
    BudgetHeader {
        schema: u32,
        pid: u32,
        worker_epoch: u64,
        tick: u64,
        sent_ns: u64,
        sent_unix_ns: u64,
    }
);
pub(crate) fn plan_state(bits: &mut Bits) -> PlanState {
    PlanState {
        robot: bits.u32(),
        flags: bits.u32(),
        quality: bits.u16(),
        quality_detail: bits.u16(),
        platform: bits.u16(),
        open_steps: bits.u16(),
        age_steps: bits.u16(),
        interval_steps: bits.u16(),
        generation: bits.u32(),
        stamp_ns: bits.u64(),
        v_mps: bits.f32(),
        omega_radps: bits.f32(),
        lag1_w: bits.f32(),
        lag2_w: bits.f32(),
        lag3_w: bits.f32(),
        lag4_w: bits.f32(),
        lag5_w: bits.f32(),
        network_w: bits.f32(),
        mean_w: bits.f32(),
        change_w: bits.f32(),
        weight_last: bits.f32(),
        weight_network: bits.f32(),
        weight_stack: bits.f32(),
        held_weight_stack: bits.f32(),
        gain_last: bits.f32(),
        gain_network: bits.f32(),
        gain_mean: bits.f32(),
        level_w: bits.f32(),
        size_due_w: bits.f32(),
        below_due: bits.f32(),
        above_due: bits.f32(),
        size_held_w: bits.f32(),
        below_held: bits.f32(),
        above_held: bits.f32(),
        energy_j: std::array::from_fn(|_| bits.f32()),
        command_j: std::array::from_fn(|_| bits.f32()),
        time_s: std::array::from_fn(|_| bits.f32()),
        error_factor: std::array::from_fn(|_| bits.f32()),
        command_trust: bits.f32(),
    }
}

pub(crate) fn plan_state_fields(row: &PlanState) -> Fields {
    let PlanState {
        robot,
        flags,
        quality,
        quality_detail,
        platform,
        open_steps,
        age_steps,
        interval_steps,
        generation,
        stamp_ns,
        v_mps,
        omega_radps,
        lag1_w,
        lag2_w,
        lag3_w,
        lag4_w,
        lag5_w,
        network_w,
        mean_w,
        change_w,
        weight_last,
        weight_network,
        weight_stack,
        held_weight_stack,
        gain_last,
        gain_network,
        gain_mean,
        level_w,
        size_due_w,
        below_due,
        above_due,
        size_held_w,
        below_held,
        above_held,
        energy_j,
        command_j,
        time_s,
        error_factor,
        command_trust,
    } = row;
    let mut fields = vec![
        ("robot", robot.bits()),
        ("flags", flags.bits()),
        ("quality", quality.bits()),
        ("quality_detail", quality_detail.bits()),
        ("platform", platform.bits()),
        ("open_steps", open_steps.bits()),
        ("age_steps", age_steps.bits()),
        ("interval_steps", interval_steps.bits()),
        ("generation", generation.bits()),
        ("stamp_ns", stamp_ns.bits()),
        ("v_mps", v_mps.bits()),
        ("omega_radps", omega_radps.bits()),
        ("lag1_w", lag1_w.bits()),
        ("lag2_w", lag2_w.bits()),
        ("lag3_w", lag3_w.bits()),
        ("lag4_w", lag4_w.bits()),
        ("lag5_w", lag5_w.bits()),
        ("network_w", network_w.bits()),
        ("mean_w", mean_w.bits()),
        ("change_w", change_w.bits()),
        ("weight_last", weight_last.bits()),
        ("weight_network", weight_network.bits()),
        ("weight_stack", weight_stack.bits()),
        ("held_weight_stack", held_weight_stack.bits()),
        ("gain_last", gain_last.bits()),
        ("gain_network", gain_network.bits()),
        ("gain_mean", gain_mean.bits()),
        ("level_w", level_w.bits()),
        ("size_due_w", size_due_w.bits()),
        ("below_due", below_due.bits()),
        ("above_due", above_due.bits()),
        ("size_held_w", size_held_w.bits()),
        ("below_held", below_held.bits()),
        ("above_held", above_held.bits()),
    ];
    let mut each = |name, values: &[f32]| {
        fields.extend(values.iter().map(|value| (name, value.bits())));
    };
    each("energy_j", energy_j);
    each("command_j", command_j);
    each("time_s", time_s);
    each("error_factor", error_factor);
    fields.push(("command_trust", command_trust.bits()));
    fields
}

payload!(
    taken_frame,
    taken_frame_fields,
    TakenFrame {
        source_id: u64,
        source_epoch: u64,
        frame_seq: u64,
        taken_ns: u64,
        samples: u32,
        truncated: u32,
    }
);
payload!(
    tick_header,
    tick_header_fields,
    TickHeader {
        schema: u32,
        pid: u32,
        worker_epoch: u64,
        tick: u64,
        start_ns: u64,
        sent_ns: u64,
        flags: u32,
        unlisted: u32,
    }
);
payload!(
    state_header,
    state_header_fields,
    StateHeader {
        schema: u32,
        pid: u32,
        worker_epoch: u64,
        tick: u64,
        total_bytes: u64,
        offset: u64,
        taken_ns: u64,
        sent_ns: u64,
        sent_unix_ns: u64,
    }
);

impl Bits {
    fn i64(&mut self) -> i64 {
        self.u64() as i64
    }
}

pub(crate) fn forecast_header(bits: &mut Bits) -> ForecastHeader {
    let mut samples_dropped = DropCounts::default();
    let used = (bits.u64() % 25) as usize;
    for count in &mut samples_dropped.counts[..used] {
        *count = bits.u64();
    }
    ForecastHeader {
        schema: bits.u32(),
        pid: bits.u32(),
        worker_epoch: bits.u64(),
        tick: bits.u64(),
        period_ns: bits.u64(),
        model_hash: bits.u64(),
        capacity: bits.u32(),
        frames_taken: bits.u32(),
        first_intended_ns: bits.u64(),
        first_sent_ns: bits.u64(),
        first_taken_ns: bits.u64(),
        compute_start_ns: bits.u64(),
        compute_end_ns: bits.u64(),
        sent_ns: bits.u64(),
        sent_unix_ns: bits.u64(),
        ticks_skipped: bits.u64(),
        ticks_late: bits.u64(),
        samples_accepted: bits.u64(),
        samples_dropped,
    }
}

pub(crate) fn diagnostic_header(bits: &mut Bits) -> DiagnosticHeader {
    let mut refused = [Refusal::default(); 16];
    let used = (bits.u64() % 17) as usize;
    for place in &mut refused[..used] {
        *place = Refusal {
            robot: bits.u32(),
            reason: bits.u32(),
            pid: bits.u32(),
            count: bits.u32(),
        };
    }
    DiagnosticHeader {
        schema: bits.u32(),
        pid: bits.u32(),
        worker_epoch: bits.u64(),
        tick: bits.u64(),
        refused,
    }
}

pub(crate) fn plan_state_header(bits: &mut Bits) -> PlanStateHeader {
    let mut models = [0; LISTED_MODELS];
    for hash in models
        .iter_mut()
        .take(bits.u16() as usize % (LISTED_MODELS + 1))
    {
        *hash = bits.u64();
    }
    PlanStateHeader {
        schema: bits.u32(),
        pid: bits.u32(),
        worker_epoch: bits.u64(),
        tick: bits.u64(),
        period_ns: bits.u64(),
        settings_hash: bits.u64(),
        model_hash: bits.u64(),
        models,
        compute_start_ns: bits.u64(),
        sent_ns: bits.u64(),
        sent_unix_ns: bits.u64(),
    }
}

fn query(bits: &mut Bits) -> Query {
    let record = QueryRecord {
        begun_ns: bits.u64(),
        number: bits.u64(),
        client: bits.u32(),
        values: 0,
        words: 0,
        reserved: 0,
        query: QueryHeader {
            schema: bits.u32(),
            kind: bits.u32(),
            fleet: bits.u64(),
            number: bits.u64(),
            asked_ns: bits.u64(),
            deadline_ns: bits.u64(),
            listener_lo: bits.u64(),
            listener_hi: bits.u64(),
            flags: bits.u32(),
            robots: bits.u32(),
            candidates: bits.u32(),
            steps: bits.u32(),
            coverage: bits.f32(),
            period_s: bits.f32(),
            duration_s: bits.f32(),
            reserved: bits.u32(),
            return_x_m: bits.f64(),
            return_y_m: bits.f64(),
            heading_rad: bits.f64(),
        },
        answer: AnswerHeader {
            schema: bits.u32(),
            pid: bits.u32(),
            number: bits.u64(),
            worker_epoch: bits.u64(),
            tick: bits.u64(),
            period_ns: bits.u64(),
            sent_state_ns: bits.u64(),
            budget_epoch: bits.u64(),
            budget_tick: bits.u64(),
            sent_budget_ns: bits.u64(),
            now_ns: bits.u64(),
            taken_ns: bits.u64(),
            sent_ns: bits.u64(),
            refusal: bits.u32(),
            rows: 0,
            powers: 0,
            text_bytes: 0,
        },
    };
    let row = |bits: &mut Bits| AnswerRow {
        robot: bits.u32(),
        flags: bits.u16(),
        verdict: bits.u16(),
        unknown: bits.u16(),
        unknown_detail: bits.u16(),
        limiting_leg: bits.u32(),
        age_ns: bits.u64(),
        duration_s: bits.f32(),
        mean_j: bits.f32(),
        lo_j: bits.f32(),
        hi_j: bits.f32(),
        left_j: bits.f32(),
        left_lo_j: bits.f32(),
        probability: bits.f32(),
        margin_j: bits.f32(),
        turn_back_s: bits.f32(),
        outside_training: bits.u32(),
    };
    let query = Query {
        record,
        values: bits.rows(Bits::f64),
        rows: bits.rows(row),
        power_w: bits.rows(Bits::f32),
        text: "ω ".repeat(bits.u16() as usize % 5),
    };
    query.counted()
}

/// All words of plain payloads.
fn words(bytes: &[u8]) -> Fields {
    bytes
        .iter()
        .map(|byte| ("byte", u64::from(*byte)))
        .collect()
}

/// One message of each kind, with arbitrary bits.
pub(crate) fn messages(bits: &mut Bits) -> Vec<Message> {
    vec![
        Message::Samples(sample_header(bits), bits.rows(sample)),
        Message::Forecasts(forecast_header(bits), bits.rows(forecast)),
        Message::Diagnostics(diagnostic_header(bits), bits.rows(diagnostic)),
        Message::Budgets(budget_header(bits), bits.rows(budget)),
        Message::PlanStates(plan_state_header(bits), bits.rows(plan_state)),
        Message::Ticks(tick_header(bits), bits.rows(taken_frame)),
        Message::State(state_header(bits), bits.rows(|bits| bits.u16() as u8)),
        Message::Query(query(bits)),
        Message::RobotSample(sample(bits)),
        Message::RobotForecast(forecast(bits)),
        Message::RobotDiagnostic(diagnostic(bits)),
        Message::RobotBudget(budget(bits)),
    ]
}

/// All fields of a message as bits: the header, then row by row.
pub(crate) fn all_bits(message: &Message) -> Vec<u64> {
    let (header, rows): (Fields, Vec<Fields>) = match message {
        Message::Samples(header, rows) => (
            sample_header_fields(header),
            rows.iter().map(sample_fields).collect(),
        ),
        // Without floats: equality compares all bits.
        Message::Forecasts(header, rows) => (
            vec![("tick", header.tick)],
            rows.iter().map(forecast_fields).collect(),
        ),
        Message::Diagnostics(header, rows) => (
            vec![("tick", header.tick)],
            rows.iter().map(diagnostic_fields).collect(),
        ),
        Message::Budgets(header, rows) => (
            budget_header_fields(header),
            rows.iter().map(budget_fields).collect(),
        ),
        // Without floats: equality compares all bits.
        Message::PlanStates(header, rows) => (
            vec![("tick", header.tick)],
            rows.iter().map(plan_state_fields).collect(),
        ),
        Message::Ticks(header, rows) => (
            tick_header_fields(header),
            rows.iter().map(taken_frame_fields).collect(),
        ),
        Message::State(header, bytes) => (
            state_header_fields(header),
            vec![
                bytes
                    .iter()
                    .map(|byte| ("byte", u64::from(*byte)))
                    .collect(),
            ],
        ),
        Message::Query(query) => (
            words(bytemuck::bytes_of(&query.record)),
            vec![
                words(bytemuck::cast_slice(&query.values)),
                words(bytemuck::cast_slice(&query.rows)),
                words(bytemuck::cast_slice(&query.power_w)),
                words(query.text.as_bytes()),
            ],
        ),
        Message::RobotSample(row) => (Vec::new(), vec![sample_fields(row)]),
        Message::RobotForecast(row) => (Vec::new(), vec![forecast_fields(row)]),
        Message::RobotDiagnostic(row) => (Vec::new(), vec![diagnostic_fields(row)]),
        Message::RobotBudget(row) => (Vec::new(), vec![budget_fields(row)]),
        Message::Other { .. } => panic!("not ours"),
    };
    let fields = header.into_iter().chain(rows.into_iter().flatten());
    fields.map(|(_, bits)| bits).collect()
}

/// Fails unless both have the same bits.
pub(crate) fn assert_same_bits(found: &Message, expected: &Message) {
    match (found, expected) {
        (Message::Forecasts(found, _), Message::Forecasts(expected, _)) => {
            assert_eq!(found, expected);
        }
        (Message::Diagnostics(found, _), Message::Diagnostics(expected, _)) => {
            assert_eq!(found, expected);
        }
        (Message::PlanStates(found, _), Message::PlanStates(expected, _)) => {
            assert_eq!(found, expected);
        }
        _ => {}
    }
    assert_eq!(found.kind(), expected.kind());
    assert_eq!(all_bits(found), all_bits(expected), "{expected:?}");
}
