//! Conditions of a robot's alarms, from its residuals and from its samples.

use joulebus_settings::{AlarmSettings, Platform};
use joulebus_wire::Alarm;

use crate::alarms::detector::{Conditions, Detector};
use crate::ingest::admission::AdmissionState;
use crate::ingest::last_sample::Last;
use crate::layout::lanes::{InstantNs, block};

block! {
    /// Inputs of the alarms other than the residuals.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct AlarmInputs;

    /// [`AlarmInputs`] of a block.
    #[derive(Clone, Copy, Default)]
    pub(crate) struct AlarmInputLanes {
        pub stamp_ns: InstantNs,
        /// 0 before the first measurement.
        pub measured_ns: InstantNs,
        pub equal_since_ns: InstantNs,
        pub refused: bool,
        pub outside_training: bool,
        pub charging: bool,
    }
}

impl AlarmInputs {
    #[inline(always)]
    pub(crate) fn new(admission: &AdmissionState, last: &Last) -> Self {
        Self {
            stamp_ns: admission.stamp_ns,
            measured_ns: last.measured_ns,
            equal_since_ns: last.equal_since_ns,
            refused: admission.refused_run > 0,
            outside_training: admission.outside_training,
            charging: admission.charging,
        }
    }
}

/// The conditions of a robot's alarms. `scored`: number of residuals observed.
#[inline(always)]
pub(crate) fn judge(
    settings: &AlarmSettings,
    platform: &Platform,
    inputs: &AlarmInputs,
    scored: u64,
    detector: &Detector,
    deadline_missed: bool,
) -> Conditions {
    let mut conditions = detector.conditions(scored, settings);
    let age_ns = inputs.stamp_ns.saturating_sub(inputs.measured_ns);
    let equal_ns = inputs.measured_ns.saturating_sub(inputs.equal_since_ns);
    let read = inputs.measured_ns > 0;
    let (held, stuck) =
        (read & (age_ns > platform.hold_max_ns), read & (equal_ns > platform.stuck_after_ns));
    conditions.when(inputs.refused, Alarm::OutOfRange);
    conditions.when(held, Alarm::HeldTooLong);
    conditions.when(stuck, Alarm::StuckSensor);
    conditions.when(inputs.outside_training, Alarm::OutOfTraining);
    conditions.when(inputs.charging, Alarm::OfflineCharging);
    conditions.when(deadline_missed, Alarm::DeadlineMissed);
    conditions
}
