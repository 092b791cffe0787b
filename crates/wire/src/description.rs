//! The layouts as data, from which those of other languages are made: the C header, NumPy's types and the
//! table in `docs/layout.md`.

use std::mem::offset_of;

use crate::{
    Alarm, AnswerHeader, AnswerRow, Budget, BudgetHeader, ChargeState, Diagnostic,
    DiagnosticHeader, DropCounts, DropReason, Forecast, ForecastHeader, InvalidReason, Level,
    PlanState, PlanStateHeader, QUERY_CANDIDATES, QUERY_ROBOTS, QUERY_STEPS, QUERY_VALUES, Quality,
    QueryHeader, QueryKind, QueryRefusal, Refusal, SCHEMA_VERSION, Sample, SampleHeader,
    answer_flag, budget_flag, diagnostic_flag, forecast_flag, plan_state_flag, query_flag,
    sample_flag,
};

/// The type of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FieldType {
    /// 16 bits, unsigned.
    U16,
    /// 32 bits, unsigned.
    U32,
    /// 64 bits, unsigned.
    U64,
    /// 64 bits, signed.
    I64,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
    /// Another struct of [`layouts`], by its name.
    Struct(&'static str),
}

/// A field of a struct in shared memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FieldLayout {
    /// Its name.
    pub name: &'static str,
    /// Its type; that of the elements, if it is an array.
    pub of: FieldType,
    /// Elements; `None` if it is no array.
    pub elements: Option<usize>,
    /// Bytes from the beginning of the struct.
    pub offset: usize,
    /// Its bytes.
    pub size: usize,
}

/// A struct in shared memory. There is no padding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StructLayout {
    /// Its name.
    pub name: &'static str,
    /// Its fields, in the order of memory.
    pub fields: Vec<FieldLayout>,
    /// Its bytes.
    pub size: usize,
    /// Its alignment, bytes.
    pub align: usize,
}

/// Constants that belong together: bits of a field, or its codes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Constants {
    /// What they are of, in capitals: `SAMPLE`, `ALARM`.
    pub of: &'static str,
    /// The module of this crate, if they are bits.
    pub module: Option<&'static str>,
    /// Names in capitals, and values.
    pub values: Vec<(String, u64)>,
}

trait Described {
    const OF: FieldType;
    const ELEMENTS: Option<usize> = None;
}

macro_rules! described {
    ($($type:ty => $of:expr),* $(,)?) => { $(impl Described for $type { const OF: FieldType = $of; })* };
}

described!(
    u16 => FieldType::U16,
    u32 => FieldType::U32,
    u64 => FieldType::U64,
    i64 => FieldType::I64,
    f32 => FieldType::F32,
    f64 => FieldType::F64,
    Refusal => FieldType::Struct("Refusal"),
    DropCounts => FieldType::Struct("DropCounts"),
);

impl<T: Described, const N: usize> Described for [T; N] {
    const OF: FieldType = T::OF;
    const ELEMENTS: Option<usize> = Some(N);
}

const fn field<P, T: Described>(name: &'static str, offset: usize, _: fn(&P) -> &T) -> FieldLayout {
    FieldLayout {
        name,
        of: T::OF,
        elements: T::ELEMENTS,
        offset,
        size: size_of::<T>(),
    }
}

macro_rules! layout {
    ($of:ident: $($field:ident),* $(,)?) => {{
        // Names all fields: a new one does not compile until it is listed.
        let $of { $($field: _),* } = $of::default();
        StructLayout {
            name: stringify!($of),
            fields: vec![$(field(stringify!($field), offset_of!($of, $field), |of: &$of| &of.$field)),*],
            size: size_of::<$of>(),
            align: align_of::<$of>(),
        }
    }};
}

macro_rules! bits {
    ($of:literal, $module:ident: $($name:ident),* $(,)?) => {
        Constants {
            of: $of,
            module: Some(stringify!($module)),
            values: vec![$((stringify!($name).to_owned(), u64::from($module::$name))),*],
        }
    };
}

/// What a controller, a planner or a program that asks reads and writes, a struct before those that contain it.
#[must_use]
pub fn layouts() -> Vec<StructLayout> {
    let mut all = vec![
        layout!(Refusal: robot, reason, pid, count),
        layout!(DropCounts: counts),
    ];
    all.extend(frames());
    all.extend(questions());
    all
}

fn frames() -> [StructLayout; 10] {
    [
        layout!(Sample: robot, flags, seq, stamp_ns, measured_ns, v_mps, omega_radps, power_w,
            voltage_v, current_a, soc, return_j, reserved),
        layout!(SampleHeader: schema, pid, source_id, source_epoch, frame_seq, samples_before,
            intended_ns, sent_ns, sent_unix_ns),
        layout!(Forecast: robot, flags, quality, quality_detail, reading_w, power_w, lo_w, hi_w,
            generation, sample_seq, stamp_ns, target_ns, reading_age_ns, source_epoch),
        layout!(ForecastHeader: schema, pid, worker_epoch, tick, period_ns, model_hash, capacity,
            frames_taken, first_intended_ns, first_sent_ns, first_taken_ns, compute_start_ns,
            compute_end_ns, sent_ns, sent_unix_ns, ticks_skipped, ticks_late, samples_accepted,
            samples_dropped),
        layout!(Diagnostic: robot, flags, level, alarm, alarms, residual_w, residual_z, bias_w,
            cusum_up, cusum_down, noise_ratio, coverage, coverage_recent, scored, mae_w, r2,
            persistence_mae_w, persistence_r2, skill, sample_seq, stamp_ns, source_epoch, refused,
            network_w, mean_w, change_w, weight_last, weight_network, weight_stack,
            held_weight_last, held_weight_stack, gain_last, gain_network, gain_mean, level_w),
        layout!(DiagnosticHeader: schema, pid, worker_epoch, tick, refused),
        layout!(Budget: robot, flags, charge_state, battery_changes, drawn_uj, drawn_remainder,
            forecast_uj, metered_ns, unmetered_ns, stamp_ns, valid_until_ns, mean_power_w, left_j,
            usable_j, usable_lo_j, soc, soc_lo, time_to_empty_s, time_to_empty_lo_s,
            time_to_empty_hi_s, soc_hi, soc_sd, sensor_bias, sensor_bias_sd, sensor_covariance),
        layout!(BudgetHeader: schema, pid, worker_epoch, tick, sent_ns, sent_unix_ns),
        layout!(PlanState: robot, flags, quality, quality_detail, platform, open_steps, age_steps,
            interval_steps, generation, stamp_ns, v_mps, omega_radps, lag1_w, lag2_w, lag3_w,
            lag4_w, lag5_w, network_w, mean_w, change_w, weight_last, weight_network,
            weight_stack, held_weight_stack, gain_last, gain_network, gain_mean, level_w,
            size_due_w, below_due, above_due, size_held_w, below_held, above_held, energy_j,
            command_j, time_s, error_factor, command_trust),
        layout!(PlanStateHeader: schema, pid, worker_epoch, tick, period_ns, settings_hash,
            model_hash, models, compute_start_ns, sent_ns, sent_unix_ns),
    ]
}

fn questions() -> [StructLayout; 3] {
    [
        layout!(QueryHeader: schema, kind, fleet, number, asked_ns, deadline_ns, listener_lo,
            listener_hi, flags, robots, candidates, steps, coverage, period_s, duration_s,
            reserved, return_x_m, return_y_m, heading_rad),
        layout!(AnswerHeader: schema, pid, number, worker_epoch, tick, period_ns, sent_state_ns,
            budget_epoch, budget_tick, sent_budget_ns, now_ns, taken_ns, sent_ns, refusal, rows,
            powers, text_bytes),
        layout!(AnswerRow: robot, flags, verdict, unknown, unknown_detail, limiting_leg, age_ns,
            duration_s, mean_j, lo_j, hi_j, left_j, left_lo_j, probability, margin_j, turn_back_s,
            outside_training),
    ]
}

/// Bits and codes of the fields of [`layouts`].
#[must_use]
pub fn constants() -> Vec<Constants> {
    let mut all = vec![
        bits!("SAMPLE", sample_flag: V, OMEGA, POWER, VOLTAGE, CURRENT, HELD, CHARGING, DISCONTINUITY,
            SOC, FULL, SWAPPED, RETURN, ALL),
        bits!("FORECAST", forecast_flag: POWER, INTERVAL, READING, SAMPLE),
        bits!("DIAGNOSTIC", diagnostic_flag: RESIDUAL, SCORES, LEARNED),
        bits!("BUDGET", budget_flag: BATTERY, TIME_TO_EMPTY, LEDGER, CHARGED, MEASURED, CONTRADICTED),
        bits!("PLAN_STATE", plan_state_flag: SAMPLE, LAGS, COMMAND, READING_AGE, LEARNED,
            OUTSIDE_TRAINING),
        bits!("QUERY", query_flag: RETURN, HEADING, POWER, ALL),
        bits!("ANSWER", answer_flag: ENERGY, LEFT, PROBABILITY, MARGIN, LIMITING_LEG, TURN_BACK,
            BEYOND_HORIZON, NO_READING, OUTSIDE_TRAINING),
    ];
    all.extend(codes());
    all
}

fn codes() -> Vec<Constants> {
    let of = |of, values: Vec<(&str, u64)>| Constants {
        of,
        module: None,
        values: values
            .into_iter()
            .map(|(name, value)| (in_capitals(name), value))
            .collect(),
    };
    let quality = |quality: Quality| u64::from(quality.encode().0);
    let levels = [Level::Ok, Level::Warn, Level::Error, Level::Stale];
    let kinds = [
        ("WhatIf", QueryKind::WhatIf),
        ("Idle", QueryKind::Idle),
        ("Follow", QueryKind::Follow),
    ];
    let reasons = (1..).map(InvalidReason::decode);
    let reasons = reasons.take_while(|reason| *reason != InvalidReason::Unknown);
    let invalid = |reason: InvalidReason| (reason.name(), u64::from(reason.code()));
    let drop_reasons = DropReason::ALL.into_iter().enumerate();
    vec![
        of(
            "QUALITY",
            vec![
                ("Unknown", quality(Quality::Unknown)),
                ("Fresh", quality(Quality::Fresh)),
                ("Held", quality(Quality::Held)),
                ("Warmup", quality(Quality::Warmup { have: 0 })),
                ("OpenLoop", quality(Quality::OpenLoop { steps: 0 })),
                ("Invalid", quality(Quality::Invalid(InvalidReason::Stale))),
            ],
        ),
        of("INVALID", reasons.map(invalid).collect()),
        of(
            "LEVEL",
            levels
                .map(|level| (level.name(), u64::from(level.code())))
                .to_vec(),
        ),
        of(
            "ALARM",
            Alarm::ALL
                .map(|alarm| (alarm.name(), u64::from(alarm.code())))
                .to_vec(),
        ),
        of(
            "CHARGE",
            vec![
                ("Unknown", ChargeState::Unknown.code().into()),
                ("Discharging", ChargeState::Discharging.code().into()),
                ("Charging", ChargeState::Charging.code().into()),
            ],
        ),
        of(
            "DROP",
            drop_reasons
                .map(|(position, reason)| (reason.name(), position as u64))
                .collect(),
        ),
        of(
            "QUERY_KIND",
            kinds
                .map(|(name, kind)| (name, u64::from(kind.code())))
                .to_vec(),
        ),
        of(
            "REFUSAL",
            QueryRefusal::ALL
                .map(|reason| (reason.name(), u64::from(reason.code())))
                .to_vec(),
        ),
        of(
            "MAX_QUERY",
            vec![
                ("Values", QUERY_VALUES as u64),
                ("Robots", QUERY_ROBOTS as u64),
                ("Candidates", QUERY_CANDIDATES as u64),
                ("Steps", QUERY_STEPS as u64),
            ],
        ),
        of("SCHEMA", vec![("Version", SCHEMA_VERSION.into())]),
    ]
}

/// `NoData` as `NO_DATA`.
fn in_capitals(name: &str) -> String {
    let mut capitals = String::new();
    for (at, letter) in name.char_indices() {
        if at > 0 && letter.is_ascii_uppercase() {
            capitals.push('_');
        }
        capitals.push(letter.to_ascii_uppercase());
    }
    capitals
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_follow_each_other_without_gaps() {
        for layout in layouts() {
            let mut end = 0;
            for field in &layout.fields {
                assert_eq!(field.offset, end, "{} {}", layout.name, field.name);
                end += field.size;
            }
            assert_eq!(end, layout.size, "{}", layout.name);
        }
    }

    /// The bits of a module, by its source: a new one must be listed.
    #[test]
    fn all_bits_are_listed() {
        let sources = [
            include_str!("sample.rs"),
            include_str!("forecast.rs"),
            include_str!("diagnostic.rs"),
            include_str!("budget.rs"),
            include_str!("plan_state.rs"),
            include_str!("query.rs"),
        ]
        .concat();
        let mut modules = 0;
        for of in constants() {
            let Some(module) = of.module else { continue };
            let begin = format!("pub mod {module} {{");
            let (_, after) = sources.split_once(&begin).expect("it is in a file above");
            let text = after.split("\n}").next().unwrap_or_default();
            let there: Vec<&str> = text
                .split("pub const ")
                .skip(1)
                .filter_map(|rest| rest.split(':').next())
                .collect();
            let listed: Vec<&str> = of.values.iter().map(|(name, _)| name.as_str()).collect();
            assert_eq!(there, listed, "{module}");
            modules += 1;
        }
        assert_eq!(modules, sources.matches("\npub mod ").count());
    }

    #[test]
    fn names_of_constants_are_unique() {
        let mut names: Vec<String> = constants()
            .iter()
            .flat_map(|of| {
                of.values
                    .iter()
                    .map(|(name, _)| format!("{}_{name}", of.of))
            })
            .collect();
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count);
        assert_eq!(in_capitals("BatteryOutOfRange"), "BATTERY_OUT_OF_RANGE");
    }
}
