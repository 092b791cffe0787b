//! Checks of a sample of a known robot, in the order of their execution.

use std::ops::RangeInclusive;

use joulebus_settings::Platform;
use joulebus_wire::{DropReason, InvalidReason, Sample, SampleHeader, sample_flag};

use crate::ingest::admission::AdmissionState;

/// Measured states of charge: batteries report a little more than full, or less than empty.
const SOC: RangeInclusive<f32> = -0.05..=1.05;
/// Energy to return, J: up to the largest battery.
const RETURN_J: RangeInclusive<f32> = 0.0..=3.6e9;

/// Checks that the source owns the robot, and that its numbers rise. The frame belongs to its
/// source's present run: another one than the robot's has taken over.
pub(crate) fn sender(
    admission: &mut AdmissionState,
    header: &SampleHeader,
    seq: u64,
) -> Result<(), DropReason> {
    if admission.source_id != header.source_id {
        return Err(DropReason::ForeignSource);
    }
    if header.source_epoch != admission.source_epoch {
        (admission.source_epoch, admission.ordered, admission.renewed) =
            (header.source_epoch, false, true);
    }
    if admission.ordered && seq <= admission.seq {
        return Err(if seq == admission.seq {
            DropReason::Duplicate
        } else {
            DropReason::OutOfOrder
        });
    }
    (admission.seq, admission.ordered) = (seq, true);
    Ok(())
}

/// Refuses samples beyond `most` per robot and tick.
pub(crate) fn backlog(admission: &AdmissionState, most: u16) -> Result<(), DropReason> {
    if admission.taken >= most {
        return Err(DropReason::Backlog);
    }
    Ok(())
}

/// Refuses values outside the limits of the platform.
///
/// A value whose flag is cleared is unknown and not checked.
pub(crate) fn values(sample: &Sample, platform: &Platform) -> Result<(), DropReason> {
    let full_off_the_charger = sample.has(sample_flag::FULL) && !sample.has(sample_flag::CHARGING);
    if sample.flags & !sample_flag::ALL != 0 || sample.reserved != 0 || full_off_the_charger {
        return Err(DropReason::BadFlags);
    }
    let known = [
        (sample_flag::V, sample.v_mps),
        (sample_flag::OMEGA, sample.omega_radps),
        (sample_flag::POWER, sample.power_w),
        (sample_flag::VOLTAGE, sample.voltage_v),
        (sample_flag::CURRENT, sample.current_a),
        (sample_flag::SOC, sample.soc),
        (sample_flag::RETURN, sample.return_j),
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
    let soc_fine = SOC.contains(&sample.soc);
    let return_fine = RETURN_J.contains(&sample.return_j);
    if (sample.has(sample_flag::SOC) && !soc_fine)
        || (sample.has(sample_flag::RETURN) && !return_fine)
    {
        return Err(DropReason::BatteryOutOfRange);
    }
    if sample.has(sample_flag::POWER) && sample.measured_ns > sample.stamp_ns {
        return Err(DropReason::BadTime);
    }
    Ok(())
}

/// Refuses a stamp that is not after the robot's last one, or more than `max_jump_ns` after it; for
/// the first sample of a new run this only breaks the sequence.
pub(crate) fn time(
    admission: &AdmissionState,
    stamp_ns: u64,
    max_jump_ns: u64,
) -> Result<bool, DropReason> {
    let in_time = !admission.accepted
        || (stamp_ns > admission.stamp_ns && stamp_ns - admission.stamp_ns <= max_jump_ns);
    if !in_time && !admission.renewed {
        return Err(DropReason::BadTime);
    }
    Ok(!in_time)
}

/// The effect of a refused value on the robot. `None` if the robot is not affected.
pub(crate) fn invalid(reason: DropReason) -> Option<InvalidReason> {
    match reason {
        DropReason::NotFinite => Some(InvalidReason::NotFinite),
        DropReason::PowerOutOfRange => Some(InvalidReason::PowerOutOfRange),
        DropReason::CommandOutOfRange => Some(InvalidReason::CommandOutOfRange),
        DropReason::BadFlags => Some(InvalidReason::BadFlags),
        DropReason::BatteryOutOfRange => Some(InvalidReason::BatteryOutOfRange),
        DropReason::BadTime => Some(InvalidReason::BadTime),
        _ => None,
    }
}
