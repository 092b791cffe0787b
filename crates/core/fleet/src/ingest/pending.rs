//! Samples that have passed the checks, until the tick.

use joulebus_wire::{Sample, sample_flag};
use serde::{Deserialize, Serialize};

use crate::layout::lanes::{Count, InstantNs, Lanes, block, put};

block! {
    /// A sample that has passed the checks: the fields that the tick uses.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Pending;

    /// [`Pending`] samples of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    pub(crate) struct PendingLanes {
        pub seq: Count,
        pub stamp_ns: InstantNs,
        pub measured_ns: InstantNs,
        pub v_mps: f32,
        pub omega_radps: f32,
        pub power_w: f32,
        flags: u8,
        /// True if it breaks the sequence, so that earlier samples are irrelevant.
        pub broken: bool,
    }
}

// The flags that the tick reads fit. The battery's values of samples are kept with the battery.
const _: () = assert!(sample_flag::DISCONTINUITY <= u8::MAX as u32);

impl Pending {
    /// Creates it from a sample whose flags are all known. `broken` adds to the sample's own flag.
    #[inline(always)]
    pub(crate) fn new(sample: &Sample, broken: bool) -> Self {
        Self {
            seq: sample.seq,
            stamp_ns: sample.stamp_ns,
            measured_ns: sample.measured_ns,
            v_mps: sample.v_mps,
            omega_radps: sample.omega_radps,
            power_w: sample.power_w,
            flags: sample.flags as u8,
            broken: broken | sample.has(sample_flag::DISCONTINUITY),
        }
    }

    #[inline(always)]
    pub(crate) fn has(&self, flags: u32) -> bool {
        u32::from(self.flags) & flags == flags
    }

    /// True if there is a reading.
    #[inline(always)]
    pub(crate) fn read(&self) -> bool {
        self.has(sample_flag::POWER)
    }

    /// True if it commands to stand.
    #[inline(always)]
    pub(crate) fn rests(&self) -> bool {
        self.has(sample_flag::V | sample_flag::OMEGA)
            & (self.v_mps == 0.0)
            & (self.omega_radps == 0.0)
    }

    #[inline(always)]
    pub(crate) fn command(&self) -> Option<(f32, f32)> {
        let known = self.has(sample_flag::V | sample_flag::OMEGA);
        known.then_some((self.v_mps, self.omega_radps))
    }
}

/// Processing state of a robot's newest sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PendingState {
    None,
    /// A sample is waiting to be absorbed.
    Waiting,
    /// A sample was absorbed, and is waiting to be scored.
    Absorbed,
    /// Same as `Absorbed`, for a sample that breaks the sequence.
    Broken,
}

/// The newest samples of a block, with their processing states.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[repr(align(16))]
pub(crate) struct PendingBlock {
    pub samples: PendingLanes,
    /// For an absorbed sample: the one-step-ahead forecast of its reading. NaN if there was none.
    pub expected_w: Lanes<f32>,
    /// [`PendingState`].
    pending: Lanes<u8>,
}

impl PendingBlock {
    #[inline(always)]
    pub(crate) fn is(&self, lane: usize, pending: PendingState) -> bool {
        self.pending[lane] == pending as u8
    }

    #[inline(always)]
    pub(crate) fn mark(&mut self, lane: usize, mask: bool, pending: PendingState) {
        put(&mut self.pending[lane], mask, pending as u8);
    }
}
