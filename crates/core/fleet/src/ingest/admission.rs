//! Admission state of a robot: the slot's owner, and the inputs of its next sample's checks.

use joulebus_wire::{InvalidReason, sample_flag};
use serde::{Deserialize, Serialize};

use crate::ingest::codes::invalid_reason;
use crate::ingest::pending::Pending;
use crate::layout::lanes::{Count, InstantNs, block};

/// Reason that a sample was refused, if it was.
type Invalid = Option<InvalidReason>;

block! {
    /// Admission state of one robot: the slot's owner, and the inputs of its next sample's checks.
    /// One cache line per robot, because samples arrive in any order.
    #[derive(Debug, Clone, Copy, Serialize, Deserialize)]
    #[repr(align(64))]
    pub(crate) struct AdmissionState: FREE {
        /// When the worker last took one of its samples, monotonic ns of the worker.
        pub taken_ns: InstantNs = 0,
        /// Stamp of the last accepted sample, ns. 0 before the first.
        pub stamp_ns: InstantNs = 0,
        /// Highest sequence number taken or refused in the epoch, if `ordered`.
        pub seq: Count = 0,
        pub source_id: Count = 0,
        pub source_epoch: Count = 0,
        pub id: u32 = 0,
        /// Number of times the slot has been reassigned.
        pub generation: u32 = 0,
        pub platform: u16 = 0,
        /// Samples taken in this tick.
        pub taken: u16 = 0,
        /// Number of consecutive samples refused for their contents.
        pub refused_run: u16 = 0,
        /// Reason that the last sample was refused, if it was.
        #[serde(with = "invalid_reason")]
        pub invalid: Invalid = None,
        /// True if the slot is in use.
        pub present: bool = false,
        /// True if a sample of the epoch has been seen.
        pub ordered: bool = false,
        /// True if a new run of the source has taken over and none of its samples has been accepted
        /// yet.
        pub renewed: bool = false,
        /// True if a sample has arrived in this tick, taken or refused.
        pub reported: bool = false,
        /// True if a sample has ever been accepted.
        pub accepted: bool = false,
        pub charging: bool = false,
        /// True if the robot has ever been seen charging: its state of charge is then unknown.
        pub charged: bool = false,
        /// True if the last row was outside the training range.
        pub outside_training: bool = false,
        /// True if the source finds the last sample's robot implausible.
        pub implausible: bool = false,
    }
}

const _: () = assert!(size_of::<AdmissionState>() == 64);

impl AdmissionState {
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
