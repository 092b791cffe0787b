//! NumPy's descriptions of payloads, from the layout that the compiler gave them.

use std::mem::offset_of;

use joulebus_wire::{Budget, Diagnostic, Forecast, Sample};

/// Name, type and offset of each field, and the size of the whole.
pub(crate) type Layout = (Vec<(&'static str, &'static str, usize)>, usize);

/// The type of a field, as NumPy writes it.
trait Scalar {
    const CODE: &'static str;
}

macro_rules! scalar {
    ($($type:ty => $code:literal),*) => { $(impl Scalar for $type { const CODE: &'static str = $code; })* };
}

scalar!(u16 => "<u2", u32 => "<u4", u64 => "<u8", i64 => "<i8", f32 => "<f4", f64 => "<f8");

const fn code<P, T: Scalar>(_: fn(&P) -> T) -> &'static str {
    T::CODE
}

macro_rules! layout {
    ($payload:ident: $($field:ident),* $(,)?) => {{
        // Names all fields: a new one does not compile until it is listed.
        let $payload { $($field: _),* } = $payload::default();
        let fields = vec![$((
            stringify!($field),
            code(|payload: &$payload| payload.$field),
            offset_of!($payload, $field),
        )),*];
        (fields, size_of::<$payload>())
    }};
}

pub(crate) fn sample() -> Layout {
    layout!(Sample: robot, flags, seq, stamp_ns, measured_ns, v_mps, omega_radps, power_w, voltage_v, current_a, soc,
        return_j, reserved)
}

pub(crate) fn forecast() -> Layout {
    layout!(Forecast: robot, flags, quality, quality_detail, reading_w, power_w, lo_w, hi_w, generation, sample_seq,
        stamp_ns, target_ns, reading_age_ns, source_epoch)
}

pub(crate) fn diagnostic() -> Layout {
    layout!(Diagnostic: robot, flags, level, alarm, alarms, residual_w, residual_z, bias_w, cusum_up, cusum_down,
        noise_ratio, coverage, coverage_recent, scored, mae_w, r2, persistence_mae_w, persistence_r2, skill,
        sample_seq, stamp_ns, source_epoch, refused, network_w, mean_w, change_w, weight_last, weight_network,
        weight_stack, held_weight_last, held_weight_stack, gain_last, gain_network, gain_mean, level_w)
}

pub(crate) fn budget() -> Layout {
    layout!(Budget: robot, flags, charge_state, battery_changes, drawn_uj, drawn_remainder, forecast_uj, metered_ns,
        unmetered_ns, stamp_ns, valid_until_ns, mean_power_w, left_j, usable_j, usable_lo_j, soc, soc_lo,
        time_to_empty_s, time_to_empty_lo_s, time_to_empty_hi_s, soc_hi, soc_sd, sensor_bias, sensor_bias_sd,
        sensor_covariance)
}
