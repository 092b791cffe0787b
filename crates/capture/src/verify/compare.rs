//! Recorded against computed, field by field, bit for bit.

use std::fmt;

use joulebus_wire::{Budget, Diagnostic, DropReason, Forecast, ForecastHeader};

/// How the bits of a field are to be read.
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
    /// A number that is no field of a payload.
    pub(super) const fn count(bits: u64) -> Self {
        Self {
            bits,
            form: Form::Unsigned,
        }
    }

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

impl fmt::Display for Value {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.form {
            Form::Unsigned => write!(out, "{}", self.bits),
            Form::Signed => write!(out, "{}", self.bits.cast_signed()),
            // A float is written so that it reads back to the same bits; those of a NaN are shown.
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

/// The fields of a payload: names and forms, in the order of its bits.
type Fields<const N: usize> = [(&'static str, Form); N];

/// A field that differs: its name, what was recorded, what was computed.
pub(super) type FieldDifference = (&'static str, Value, Value);

/// Calls `differs` for every field whose bits differ.
fn each_difference<const N: usize>(
    fields: &Fields<N>,
    recorded: [u64; N],
    computed: [u64; N],
    mut differs: impl FnMut(FieldDifference),
) {
    if recorded == computed {
        return;
    }
    for (place, (name, form)) in fields.iter().enumerate() {
        let value = |bits| Value { bits, form: *form };
        if recorded[place] != computed[place] {
            differs((name, value(recorded[place]), value(computed[place])));
        }
    }
}

fn single(value: f32) -> u64 {
    value.to_bits().into()
}

const FORECAST: Fields<14> = [
    ("robot", Form::Unsigned),
    ("flags", Form::Unsigned),
    ("quality", Form::Unsigned),
    ("quality_detail", Form::Unsigned),
    ("reading_w", Form::Single),
    ("power_w", Form::Single),
    ("lo_w", Form::Single),
    ("hi_w", Form::Single),
    ("generation", Form::Unsigned),
    ("sample_seq", Form::Unsigned),
    ("stamp_ns", Form::Unsigned),
    ("target_ns", Form::Unsigned),
    ("reading_age_ns", Form::Unsigned),
    ("source_epoch", Form::Unsigned),
];

fn forecast_bits(it: &Forecast) -> [u64; 14] {
    [
        it.robot.into(),
        it.flags.into(),
        it.quality.into(),
        it.quality_detail.into(),
        single(it.reading_w),
        single(it.power_w),
        single(it.lo_w),
        single(it.hi_w),
        it.generation.into(),
        it.sample_seq,
        it.stamp_ns,
        it.target_ns,
        it.reading_age_ns,
        it.source_epoch,
    ]
}

/// Fields in which two forecasts differ.
pub(super) fn forecasts(
    recorded: &Forecast,
    computed: &Forecast,
    differs: impl FnMut(FieldDifference),
) {
    each_difference(
        &FORECAST,
        forecast_bits(recorded),
        forecast_bits(computed),
        differs,
    );
}

const DIAGNOSTIC: Fields<23> = [
    ("robot", Form::Unsigned),
    ("flags", Form::Unsigned),
    ("level", Form::Unsigned),
    ("alarm", Form::Unsigned),
    ("alarms", Form::Unsigned),
    ("residual_w", Form::Single),
    ("residual_z", Form::Single),
    ("bias_w", Form::Single),
    ("cusum_up", Form::Single),
    ("cusum_down", Form::Single),
    ("noise_ratio", Form::Single),
    ("coverage", Form::Single),
    ("coverage_recent", Form::Single),
    ("scored", Form::Unsigned),
    ("mae_w", Form::Double),
    ("r2", Form::Double),
    ("persistence_mae_w", Form::Double),
    ("persistence_r2", Form::Double),
    ("skill", Form::Double),
    ("sample_seq", Form::Unsigned),
    ("stamp_ns", Form::Unsigned),
    ("source_epoch", Form::Unsigned),
    ("refused", Form::Unsigned),
];

fn diagnostic_bits(it: &Diagnostic) -> [u64; 23] {
    [
        it.robot.into(),
        it.flags.into(),
        it.level.into(),
        it.alarm.into(),
        it.alarms.into(),
        single(it.residual_w),
        single(it.residual_z),
        single(it.bias_w),
        single(it.cusum_up),
        single(it.cusum_down),
        single(it.noise_ratio),
        single(it.coverage),
        single(it.coverage_recent),
        it.scored,
        it.mae_w.to_bits(),
        it.r2.to_bits(),
        it.persistence_mae_w.to_bits(),
        it.persistence_r2.to_bits(),
        it.skill.to_bits(),
        it.sample_seq,
        it.stamp_ns,
        it.source_epoch,
        it.refused,
    ]
}

/// Fields in which two diagnostics differ.
pub(super) fn diagnostics(
    recorded: &Diagnostic,
    computed: &Diagnostic,
    differs: impl FnMut(FieldDifference),
) {
    let bits = (diagnostic_bits(recorded), diagnostic_bits(computed));
    each_difference(&DIAGNOSTIC, bits.0, bits.1, differs);
}

const BUDGET: Fields<21> = [
    ("robot", Form::Unsigned),
    ("flags", Form::Unsigned),
    ("charge_state", Form::Unsigned),
    ("reserved", Form::Unsigned),
    ("drawn_uj", Form::Signed),
    ("drawn_remainder", Form::Signed),
    ("forecast_uj", Form::Signed),
    ("metered_ns", Form::Unsigned),
    ("unmetered_ns", Form::Unsigned),
    ("stamp_ns", Form::Unsigned),
    ("valid_until_ns", Form::Unsigned),
    ("mean_power_w", Form::Single),
    ("left_j", Form::Single),
    ("usable_j", Form::Single),
    ("usable_lo_j", Form::Single),
    ("soc", Form::Single),
    ("soc_lo", Form::Single),
    ("time_to_empty_s", Form::Single),
    ("time_to_empty_lo_s", Form::Single),
    ("time_to_empty_hi_s", Form::Single),
    ("reserved2", Form::Unsigned),
];

fn budget_bits(it: &Budget) -> [u64; 21] {
    [
        it.robot.into(),
        it.flags.into(),
        it.charge_state.into(),
        it.reserved.into(),
        it.drawn_uj.cast_unsigned(),
        it.drawn_remainder.cast_unsigned(),
        it.forecast_uj.cast_unsigned(),
        it.metered_ns,
        it.unmetered_ns,
        it.stamp_ns,
        it.valid_until_ns,
        single(it.mean_power_w),
        single(it.left_j),
        single(it.usable_j),
        single(it.usable_lo_j),
        single(it.soc),
        single(it.soc_lo),
        single(it.time_to_empty_s),
        single(it.time_to_empty_lo_s),
        single(it.time_to_empty_hi_s),
        it.reserved2.into(),
    ]
}

/// Fields in which two budgets differ.
pub(super) fn budgets(recorded: &Budget, computed: &Budget, differs: impl FnMut(FieldDifference)) {
    each_difference(
        &BUDGET,
        budget_bits(recorded),
        budget_bits(computed),
        differs,
    );
}

const INTAKE: Fields<8> = [
    ("model_hash", Form::Unsigned),
    ("capacity", Form::Unsigned),
    ("frames_taken", Form::Unsigned),
    ("first_intended_ns", Form::Unsigned),
    ("first_sent_ns", Form::Unsigned),
    ("first_taken_ns", Form::Unsigned),
    ("compute_start_ns", Form::Unsigned),
    ("samples_accepted", Form::Unsigned),
];

fn intake_bits(it: &ForecastHeader) -> [u64; 8] {
    [
        it.model_hash,
        it.capacity.into(),
        it.frames_taken.into(),
        it.first_intended_ns,
        it.first_sent_ns,
        it.first_taken_ns,
        it.compute_start_ns,
        it.samples_accepted,
    ]
}

/// What two headers say differently of the intake; times of sending are no part of it.
pub(super) fn intakes(
    recorded: &ForecastHeader,
    computed: &ForecastHeader,
    mut differs: impl FnMut(FieldDifference),
) {
    let bits = (intake_bits(recorded), intake_bits(computed));
    each_difference(&INTAKE, bits.0, bits.1, &mut differs);
    for reason in DropReason::ALL {
        let drops = |header: &ForecastHeader| header.samples_dropped.get(reason);
        let (was, is) = (drops(recorded), drops(computed));
        if was != is {
            differs((reason.name(), Value::count(was), Value::count(is)));
        }
    }
}
