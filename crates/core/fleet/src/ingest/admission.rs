//! Admission state of a robot: the slot's owner, and the inputs of its next sample's checks.

use joulebus_wire::{InvalidReason, sample_flag};
use serde::{Deserialize, Serialize};

use crate::ingest::codes::invalid_reason;
use crate::ingest::pending::Pending;
use crate::layout::shift::Shift;
use crate::state::added;

/// Admission state of one robot: the slot's owner, and the inputs of its next sample's checks. One
/// cache line per robot, because samples arrive in any order.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[repr(align(64))]
pub(crate) struct AdmissionState {
    /// When the worker last took one of its samples, monotonic ns of the worker.
    pub taken_ns: u64,
    /// Stamp of the last accepted sample, ns. 0 before the first.
    pub stamp_ns: u64,
    /// Highest sequence number taken or refused in the epoch, if `ordered`.
    pub seq: u64,
    pub source_id: u64,
    pub source_epoch: u64,
    pub id: u32,
    /// Number of times the slot has been reassigned.
    pub generation: u32,
    pub platform: u16,
    /// Samples taken in this tick.
    pub taken: u16,
    /// Number of consecutive samples refused for their contents.
    pub refused_run: u16,
    /// Reason that the last sample was refused, if it was.
    #[serde(with = "invalid_reason")]
    pub invalid: Option<InvalidReason>,
    /// True if the slot is in use.
    pub present: bool,
    /// True if a sample of the epoch has been seen.
    pub ordered: bool,
    /// True if a new run of the source has taken over and none of its samples has been accepted
    /// yet.
    pub renewed: bool,
    /// True if a sample has arrived in this tick, taken or refused.
    pub reported: bool,
    /// True if a sample has ever been accepted.
    pub accepted: bool,
    pub charging: bool,
    /// True if the robot has ever been seen charging: its state of charge is then unknown.
    pub charged: bool,
    /// True if the last row was outside the training range.
    pub outside_training: bool,
    /// True if the source finds the last sample's robot implausible.
    #[serde(deserialize_with = "added::read")]
    pub implausible: bool,
}

const _: () = assert!(size_of::<AdmissionState>() == 64);

impl AdmissionState {
    pub(crate) const FREE: Self = Self {
        taken_ns: 0,
        stamp_ns: 0,
        seq: 0,
        source_id: 0,
        source_epoch: 0,
        id: 0,
        generation: 0,
        platform: 0,
        taken: 0,
        refused_run: 0,
        invalid: None,
        present: false,
        ordered: false,
        renewed: false,
        reported: false,
        accepted: false,
        charging: false,
        charged: false,
        outside_training: false,
        implausible: false,
    };

    /// Moves the instants to another clock.
    pub(crate) fn shift(&mut self, shift: Shift) {
        let Self {
            taken_ns,
            stamp_ns,
            seq: _,
            source_id: _,
            // A name.
            source_epoch: _,
            id: _,
            generation: _,
            platform: _,
            taken: _,
            refused_run: _,
            invalid: _,
            present: _,
            ordered: _,
            renewed: _,
            reported: _,
            accepted: _,
            charging: _,
            charged: _,
            outside_training: _,
            implausible: _,
        } = self;
        shift.instant(taken_ns);
        shift.instant(stamp_ns);
    }

    /// Records the part of an absorbed sample that does not depend on the forecast. Without a row
    /// for the model, nothing is outside the training range.
    #[inline(always)]
    pub(crate) fn accept(&mut self, sample: &Pending) {
        self.accepted = true;
        self.stamp_ns = sample.stamp_ns;
        self.charging = sample.has(sample_flag::CHARGING);
        self.charged |= self.charging;
        self.outside_training = false;
    }
}
