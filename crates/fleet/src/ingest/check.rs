//! The checks that one sample must pass, in the order in which they are made.

use joulebus_settings::Platform;
use joulebus_wire::{DropReason, InvalidReason, Sample, sample_flag};

/// Refuses values that cannot be true of a robot of this platform.
///
/// A value whose flag is cleared is not looked at: it is unknown.
pub(crate) fn check_values(sample: &Sample, platform: &Platform) -> Result<(), DropReason> {
    if sample.flags & !sample_flag::ALL != 0 || sample.reserved != 0 {
        return Err(DropReason::BadFlags);
    }
    let known = [
        (sample_flag::V, sample.v_mps),
        (sample_flag::OMEGA, sample.omega_radps),
        (sample_flag::POWER, sample.power_w),
        (sample_flag::VOLTAGE, sample.voltage_v),
        (sample_flag::CURRENT, sample.current_a),
    ];
    if known
        .iter()
        .any(|(flag, value)| sample.has(*flag) && !value.is_finite())
    {
        return Err(DropReason::NotFinite);
    }
    let power_fine =
        platform.power_min_w <= sample.power_w && sample.power_w <= platform.power_max_w;
    if sample.has(sample_flag::POWER) && !power_fine {
        return Err(DropReason::PowerOutOfRange);
    }
    let v_fine = sample.v_mps.abs() <= platform.v_max_mps;
    let omega_fine = sample.omega_radps.abs() <= platform.omega_max_radps;
    if (sample.has(sample_flag::V) && !v_fine) || (sample.has(sample_flag::OMEGA) && !omega_fine) {
        return Err(DropReason::CommandOutOfRange);
    }
    if sample.has(sample_flag::POWER) && sample.measured_ns > sample.stamp_ns {
        return Err(DropReason::BadTime);
    }
    Ok(())
}

/// What a refused value means for the robot; `None` where the robot is not to blame.
pub(crate) fn invalid(reason: DropReason) -> Option<InvalidReason> {
    match reason {
        DropReason::NotFinite => Some(InvalidReason::NotFinite),
        DropReason::PowerOutOfRange => Some(InvalidReason::PowerOutOfRange),
        DropReason::CommandOutOfRange => Some(InvalidReason::CommandOutOfRange),
        DropReason::BadFlags => Some(InvalidReason::BadFlags),
        DropReason::BadTime => Some(InvalidReason::BadTime),
        _ => None,
    }
}
