//! Compares recorded with computed payloads, field by field, bit for bit.

use std::fmt;

use bytemuck::bytes_of;
use joulebus_wire::{
    AnswerHeader, AnswerRow, Budget, Diagnostic, DropReason, Forecast, ForecastHeader, PlanState,
    PlanStateHeader,
};

/// Interpretation of a field's bits.
#[derive(Debug, Clone, Copy)]
enum Form {
    Unsigned,
    Signed,
    Single,
    Double,
}

/// A field's value, as its bits.
#[derive(Debug, Clone, Copy)]
pub struct Value {
    bits: u64,
    form: Form,
}

impl Value {
    /// As a number; not exact beyond 2^53.
    #[must_use]
    pub fn number(self) -> f64 {
        match self.form {
            Form::Unsigned => self.bits as f64,
            Form::Signed => self.bits.cast_signed() as f64,
            Form::Single => f32::from_bits(self.bits as u32).into(),
            Form::Double => f64::from_bits(self.bits),
        }
    }
}

/// The value of a field by its type: interpretation and bits.
macro_rules! value_of {
    ($type:ty, $form:ident, $bits:expr) => {
        impl From<$type> for Value {
            fn from(value: $type) -> Self {
                Self {
                    bits: $bits(value),
                    form: Form::$form,
                }
            }
        }
    };
}

value_of!(u16, Unsigned, u64::from);
value_of!(u32, Unsigned, u64::from);
value_of!(u64, Unsigned, |value| value);
value_of!(i64, Signed, i64::cast_unsigned);
value_of!(f32, Single, |value: f32| value.to_bits().into());
value_of!(f64, Double, f64::to_bits);

impl fmt::Display for Value {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.form {
            Form::Unsigned => write!(out, "{}", self.bits),
            Form::Signed => write!(out, "{}", self.bits.cast_signed()),
            // A float is written so that it parses to the same bits; a NaN's bits are shown.
            Form::Single => match f32::from_bits(self.bits as u32) {
                nan if nan.is_nan() => write!(out, "NaN ({:08x})", self.bits),
                value => write!(out, "{value:?}"),
            },
            Form::Double => match f64::from_bits(self.bits) {
                nan if nan.is_nan() => write!(out, "NaN ({:016x})", self.bits),
                value => write!(out, "{value:?}"),
            },
        }
    }
}

/// A field that differs: name, recorded value, computed value.
pub(super) type FieldDifference = (&'static str, Value, Value);

/// Calls `differs` for each of the fields whose bits differ.
macro_rules! each_difference {
    ($recorded:ident, $computed:ident, $differs:ident: $($field:ident),+) => {$(
        let (recorded, computed) = (Value::from($recorded.$field), Value::from($computed.$field));
        if recorded.bits != computed.bits {
            $differs((stringify!($field), recorded, computed));
        }
    )+};
}

/// Fields in which two forecasts differ.
pub(super) fn forecasts(
    recorded: &Forecast,
    computed: &Forecast,
    mut differs: impl FnMut(FieldDifference),
) {
    if bytes_of(recorded) == bytes_of(computed) {
        return;
    }
    each_difference!(recorded, computed, differs:
        robot, flags, quality, quality_detail, reading_w, power_w, lo_w, hi_w, generation,
        sample_seq, stamp_ns, target_ns, reading_age_ns, source_epoch
    );
}

/// Fields in which two diagnostics differ.
pub(super) fn diagnostics(
    recorded: &Diagnostic,
    computed: &Diagnostic,
    mut differs: impl FnMut(FieldDifference),
) {
    if bytes_of(recorded) == bytes_of(computed) {
        return;
    }
    each_difference!(recorded, computed, differs:
        robot, flags, level, alarm, alarms, residual_w, residual_z, bias_w, cusum_up, cusum_down,
        noise_ratio, coverage, coverage_recent, scored, mae_w, r2, persistence_mae_w,
        persistence_r2, skill, sample_seq, stamp_ns, source_epoch, refused, network_w, mean_w,
        change_w, weight_last, weight_network, weight_stack, held_weight_last,
        held_weight_stack, gain_last, gain_network, gain_mean, level_w
    );
}

/// Fields in which two budgets differ.
pub(super) fn budgets(
    recorded: &Budget,
    computed: &Budget,
    mut differs: impl FnMut(FieldDifference),
) {
    if bytes_of(recorded) == bytes_of(computed) {
        return;
    }
    each_difference!(recorded, computed, differs:
        robot, flags, charge_state, battery_changes, drawn_uj, drawn_remainder, forecast_uj, metered_ns,
        unmetered_ns, stamp_ns, valid_until_ns, mean_power_w, left_j, usable_j, usable_lo_j, soc,
        soc_lo, time_to_empty_s, time_to_empty_lo_s, time_to_empty_hi_s, soc_hi, soc_sd,
        sensor_bias, sensor_bias_sd, sensor_covariance
    );
}

/// Fields in which two plan states differ.
pub(super) fn plan_states(
    recorded: &PlanState,
    computed: &PlanState,
    mut differs: impl FnMut(FieldDifference),
) {
    if bytes_of(recorded) == bytes_of(computed) {
        return;
    }
    each_difference!(recorded, computed, differs:
        robot, flags, quality, quality_detail, platform, open_steps, age_steps, interval_steps,
        generation, stamp_ns, v_mps, omega_radps, lag1_w, lag2_w, lag3_w, lag4_w, lag5_w,
        network_w, mean_w, change_w, weight_last, weight_network, weight_stack,
        held_weight_stack, gain_last, gain_network, gain_mean, level_w, size_due_w, below_due,
        above_due, size_held_w, below_held, above_held, command_trust
    );
    let mut each = |name, recorded: &[f32], computed: &[f32]| {
        for (recorded, computed) in recorded.iter().zip(computed) {
            if recorded.to_bits() != computed.to_bits() {
                differs((name, (*recorded).into(), (*computed).into()));
            }
        }
    };
    each("energy_j", &recorded.energy_j, &computed.energy_j);
    each("command_j", &recorded.command_j, &computed.command_j);
    each("time_s", &recorded.time_s, &computed.time_s);
    each(
        "error_factor",
        &recorded.error_factor,
        &computed.error_factor,
    );
}

/// Fields in which two headers of answers differ that follow from the question.
pub(super) fn answers(
    recorded: &AnswerHeader,
    computed: &AnswerHeader,
    mut differs: impl FnMut(FieldDifference),
) {
    each_difference!(recorded, computed, differs: refusal, rows, powers);
}

/// Fields in which two rows of answers differ.
pub(super) fn answer_rows(
    recorded: &AnswerRow,
    computed: &AnswerRow,
    mut differs: impl FnMut(FieldDifference),
) {
    if bytes_of(recorded) == bytes_of(computed) {
        return;
    }
    each_difference!(recorded, computed, differs:
        robot, flags, verdict, unknown, unknown_detail, limiting_leg, age_ns, duration_s, mean_j,
        lo_j, hi_j, left_j, left_lo_j, probability, margin_j, turn_back_s, outside_training
    );
}

/// Fields in which two headers of plan states differ; send times are not included.
pub(super) fn plan_state_headers(
    recorded: &PlanStateHeader,
    computed: &PlanStateHeader,
    mut differs: impl FnMut(FieldDifference),
) {
    each_difference!(recorded, computed, differs:
        settings_hash, model_hash, compute_start_ns
    );
    for (recorded, computed) in recorded.models.iter().zip(computed.models) {
        if *recorded != computed {
            differs(("models", (*recorded).into(), computed.into()));
        }
    }
}

/// Fields in which two headers differ about the intake; send times are not included.
pub(super) fn intakes(
    recorded: &ForecastHeader,
    computed: &ForecastHeader,
    mut differs: impl FnMut(FieldDifference),
) {
    each_difference!(recorded, computed, differs:
        model_hash, capacity, frames_taken, first_intended_ns, first_sent_ns, first_taken_ns,
        compute_start_ns, samples_accepted
    );
    for reason in DropReason::ALL {
        let drops = |header: &ForecastHeader| header.samples_dropped.get(reason);
        let (was, is) = (drops(recorded), drops(computed));
        if was != is {
            differs((reason.name(), was.into(), is.into()));
        }
    }
}
