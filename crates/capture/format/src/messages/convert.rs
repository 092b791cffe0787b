//! Conversion between payloads in shared memory and messages in a capture, bit for bit.

use joulebus_wire as wire;
use prost_types::Timestamp;

use super::proto;

use super::codec::OutOfRange;

fn narrow(field: &'static str, found: impl Into<i128>) -> Result<u16, OutOfRange> {
    let found = found.into();
    u16::try_from(found).map_err(|_| OutOfRange {
        field,
        found,
        allowed: u16::MAX.into(),
    })
}

/// Every u64 of ns fits into a timestamp and is restored exactly.
fn timestamp(ns: u64) -> Option<Timestamp> {
    Some(Timestamp {
        seconds: (ns / 1_000_000_000) as i64,
        nanos: (ns % 1_000_000_000) as i32,
    })
}

fn ns(field: &'static str, time: &Option<Timestamp>) -> Result<u64, OutOfRange> {
    let time = time.unwrap_or_default();
    let found = i128::from(time.seconds) * 1_000_000_000 + i128::from(time.nanos);
    u64::try_from(found).map_err(|_| OutOfRange {
        field,
        found,
        allowed: u64::MAX,
    })
}

pub(super) fn to_proto<'a, W: 'a, P: From<&'a W>>(rows: &'a [W]) -> Vec<P> {
    rows.iter().map(Into::into).collect()
}

pub(super) fn from_proto<'a, P: 'a, W: TryFrom<&'a P>>(rows: &'a [P]) -> Result<Vec<W>, W::Error> {
    rows.iter().map(TryInto::try_into).collect()
}

/// Both directions between a payload or header in shared memory and its message, field by field:
/// `same` type on both sides; `float`, which another program may have omitted; `narrow`, 16 bits in
/// shared memory; `code`, an enumeration; and one `with` conversion functions. The message of a
/// header holds the rows of the frame in the field after `of`, initially empty.
macro_rules! convert {
    ($wire:ident <=> $proto:ident $(of $rows:ident)? {
        $(same: $($same:ident),+;)?
        $(float: $($float:ident),+;)?
        $(narrow: $($narrow:ident),+;)?
        $(code: $($code:ident),+;)?
        $(with $there:ident = $here:ident by $to:expr, $from:expr;)*
    }) => {
        impl From<&wire::$wire> for proto::$proto {
            fn from(found: &wire::$wire) -> Self {
                Self {
                    $($($same: found.$same,)+)?
                    $($($float: Some(found.$float),)+)?
                    $($($narrow: found.$narrow.into(),)+)?
                    $($($code: found.$code as i32,)+)?
                    $($there: $to(found.$here),)*
                    $($rows: Vec::new(),)?
                }
            }
        }

        impl TryFrom<&proto::$proto> for wire::$wire {
            type Error = OutOfRange;

            fn try_from(found: &proto::$proto) -> Result<Self, OutOfRange> {
                Ok(Self {
                    $($($same: found.$same,)+)?
                    $($($float: found.$float.unwrap_or(f32::NAN.into()),)+)?
                    $($($narrow: narrow(
                        concat!(stringify!($proto), ".", stringify!($narrow)),
                        found.$narrow,
                    )?,)+)?
                    $($($code: found.$code as u32,)+)?
                    $($here: $from(&found.$there)?,)*
                })
            }
        }
    };
}

convert! { Sample <=> Sample {
    same:
        robot, flags, seq, stamp_ns, measured_ns, reserved;
    float:
        v_mps, omega_radps, power_w, voltage_v, current_a, soc, return_j;
} }

convert! { Forecast <=> Forecast {
    same:
        robot, flags, generation, sample_seq, stamp_ns, target_ns, reading_age_ns, source_epoch;
    float:
        reading_w, power_w, lo_w, hi_w;
    narrow:
        quality, quality_detail;
} }

convert! { Diagnostic <=> Diagnostic {
    same:
        robot, flags, alarms, scored, sample_seq, stamp_ns, source_epoch, refused;
    float:
        residual_w, residual_z, bias_w, cusum_up, cusum_down, noise_ratio, coverage,
        coverage_recent, mae_w, r2, persistence_mae_w, persistence_r2, skill, network_w, mean_w,
        change_w, weight_last, weight_network, weight_stack, held_weight_last,
        held_weight_stack, gain_last, gain_network, gain_mean, level_w;
    narrow:
        level, alarm;
} }

convert! { Budget <=> Budget {
    same:
        robot, flags, battery_changes, drawn_uj, drawn_remainder, forecast_uj, metered_ns, unmetered_ns,
        stamp_ns, valid_until_ns;
    float:
        mean_power_w, left_j, usable_j, usable_lo_j, soc, soc_lo, time_to_empty_s,
        time_to_empty_lo_s, time_to_empty_hi_s, soc_hi, soc_sd, sensor_bias, sensor_bias_sd,
        sensor_covariance;
    code:
        charge_state;
} }

convert! { PlanState <=> PlanState {
    same:
        robot, flags, generation, stamp_ns;
    float:
        v_mps, omega_radps, lag1_w, lag2_w, lag3_w, lag4_w, lag5_w, network_w, mean_w, change_w,
        weight_last, weight_network, weight_stack, held_weight_stack, gain_last,
        gain_network, gain_mean, level_w, size_due_w, below_due, above_due, size_held_w,
        below_held, above_held, command_trust;
    narrow:
        quality, quality_detail, platform, open_steps, age_steps, interval_steps;
    with energy_j = energy_j by each, each_of;
    with command_j = command_j by each, each_of;
    with time_s = time_s by each, each_of;
    with error_factor = error_factor by each, each_of;
} }

convert! { QueryHeader <=> Question of values {
    same:
        schema, kind, fleet, number, asked_ns, deadline_ns, listener_lo, listener_hi, flags, robots,
        candidates, steps, reserved;
    float:
        coverage, period_s, duration_s, return_x_m, return_y_m, heading_rad;
} }

convert! { AnswerRow <=> AnswerRow {
    same:
        robot, limiting_leg, age_ns, outside_training;
    float:
        duration_s, mean_j, lo_j, hi_j, left_j, left_lo_j, probability, margin_j, turn_back_s;
    narrow:
        flags, verdict, unknown, unknown_detail;
} }

convert! { TakenFrame <=> TakenFrame {
    same:
        source_id, source_epoch, frame_seq, taken_ns, samples, truncated;
} }

convert! { SampleHeader <=> Samples of samples {
    same:
        schema, pid, source_id, source_epoch, frame_seq, samples_before, intended_ns, sent_ns;
    with sent_at = sent_unix_ns by timestamp, |at| ns("Samples.sent_at", at);
} }

convert! { ForecastHeader <=> Forecasts of forecasts {
    same:
        schema, pid, worker_epoch, tick, period_ns, model_hash, capacity, frames_taken,
        first_intended_ns, first_sent_ns, first_taken_ns, compute_start_ns, compute_end_ns,
        sent_ns, ticks_skipped, ticks_late, samples_accepted;
    with sent_at = sent_unix_ns by timestamp, |at| ns("Forecasts.sent_at", at);
    with samples_dropped = samples_dropped by drop_counts, counts_of;
} }

convert! { DiagnosticHeader <=> Diagnostics of diagnostics {
    same:
        schema, pid, worker_epoch, tick;
    with refused = refused by refusals, refusals_of;
} }

convert! { BudgetHeader <=> Budgets of budgets {
    same:
        schema, pid, worker_epoch, tick, sent_ns;
    with sent_at = sent_unix_ns by timestamp, |at| ns("Budgets.sent_at", at);
} }

convert! { PlanStateHeader <=> PlanStates of plan_states {
    same:
        schema, pid, worker_epoch, tick, period_ns, settings_hash, model_hash, compute_start_ns,
        sent_ns;
    with sent_at = sent_unix_ns by timestamp, |at| ns("PlanStates.sent_at", at);
    with models = models by listed, listed_of;
} }

convert! { TickHeader <=> Ticks of frames {
    same:
        schema, pid, worker_epoch, tick, start_ns, sent_ns, flags, unlisted;
} }

convert! { StateHeader <=> State of bytes {
    same:
        schema, pid, worker_epoch, tick, total_bytes, offset, taken_ns, sent_ns;
    with sent_at = sent_unix_ns by timestamp, |at| ns("State.sent_at", at);
} }

fn drop_counts(drops: wire::DropCounts) -> Option<proto::DropCounts> {
    let [
        unknown_robot,
        over_capacity,
        foreign_source,
        old_epoch,
        duplicate,
        out_of_order,
        bad_time,
        not_finite,
        power_out_of_range,
        command_out_of_range,
        bad_flags,
        backlog,
        overflow,
        schema,
        before_join,
        too_many_sources,
        battery_out_of_range,
        later @ ..,
    ] = drops.counts;
    // Unnamed reasons are rare: trailing zeros are not written.
    let used = later.iter().rposition(|count| *count != 0);
    Some(proto::DropCounts {
        unknown_robot,
        over_capacity,
        foreign_source,
        old_epoch,
        duplicate,
        out_of_order,
        bad_time,
        not_finite,
        power_out_of_range,
        command_out_of_range,
        bad_flags,
        backlog,
        overflow,
        schema,
        before_join,
        too_many_sources,
        battery_out_of_range,
        later: later[..used.map_or(0, |last| last + 1)].to_vec(),
    })
}

fn counts_of(drops: &Option<proto::DropCounts>) -> Result<wire::DropCounts, OutOfRange> {
    let mut counts = wire::DropCounts::default();
    let Some(drops) = drops else {
        return Ok(counts);
    };
    let named = [
        drops.unknown_robot,
        drops.over_capacity,
        drops.foreign_source,
        drops.old_epoch,
        drops.duplicate,
        drops.out_of_order,
        drops.bad_time,
        drops.not_finite,
        drops.power_out_of_range,
        drops.command_out_of_range,
        drops.bad_flags,
        drops.backlog,
        drops.overflow,
        drops.schema,
        drops.before_join,
        drops.too_many_sources,
        drops.battery_out_of_range,
    ];
    let all = named.iter().chain(&drops.later);
    for (count, found) in counts.counts.iter_mut().zip(all) {
        *count = *found;
    }
    Ok(counts)
}

fn each<const PLACES: usize>(values: [f32; PLACES]) -> Vec<f32> {
    values.to_vec()
}

/// Values that another program has omitted are NaN.
fn each_of<const PLACES: usize>(found: &[f32]) -> Result<[f32; PLACES], OutOfRange> {
    let mut values = [f32::NAN; PLACES];
    for (value, found) in values.iter_mut().zip(found) {
        *value = *found;
    }
    Ok(values)
}

/// Trailing zeros are not written.
fn listed<const PLACES: usize>(hashes: [u64; PLACES]) -> Vec<u64> {
    let used = hashes.iter().rposition(|hash| *hash != 0);
    hashes[..used.map_or(0, |last| last + 1)].to_vec()
}

fn listed_of<const PLACES: usize>(found: &[u64]) -> Result<[u64; PLACES], OutOfRange> {
    let mut hashes = [0; PLACES];
    for (hash, found) in hashes.iter_mut().zip(found) {
        *hash = *found;
    }
    Ok(hashes)
}

/// Trailing empty entries are not written.
fn refusals<const PLACES: usize>(places: [wire::Refusal; PLACES]) -> Vec<proto::Refusal> {
    let empty = wire::Refusal::default();
    let used = places.iter().rposition(|place| *place != empty);
    places[..used.map_or(0, |last| last + 1)]
        .iter()
        .map(|place| proto::Refusal {
            robot: place.robot,
            reason: place.reason as i32,
            pid: place.pid,
            count: place.count,
        })
        .collect()
}

fn refusals_of<const PLACES: usize>(
    refused: &[proto::Refusal],
) -> Result<[wire::Refusal; PLACES], OutOfRange> {
    let mut places = [wire::Refusal::default(); PLACES];
    for (place, found) in places.iter_mut().zip(refused) {
        *place = wire::Refusal {
            robot: found.robot,
            reason: found.reason as u32,
            pid: found.pid,
            count: found.count,
        };
    }
    Ok(places)
}
