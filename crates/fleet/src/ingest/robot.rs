//! Who holds a slot, and what came of its last sample.

use joulebus_wire::{InvalidReason, Quality, Sample, sample_flag};
use serde::{Deserialize, Serialize};

use crate::ingest::codes::invalid_reason;
use crate::layout::lanes::{Lanes, block, put};

/// Time over which the mean power is taken, s.
const MEAN_POWER_S: f32 = 60.0;

/// Who holds a slot and what the checks of its next sample need: one line of the cache.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[repr(align(64))]
pub(crate) struct AdmissionState {
    /// When the worker last took a sample of it, monotonic ns of the worker.
    pub taken_ns: u64,
    /// Stamp of the last accepted sample, ns; 0 before the first.
    pub stamp_ns: u64,
    /// Highest sequence number taken or refused in the epoch, where `ordered`.
    pub seq: u64,
    pub source_id: u64,
    pub source_epoch: u64,
    pub id: u32,
    /// Times the slot has changed its owner.
    pub generation: u32,
    pub platform: u16,
    /// Samples taken in this tick.
    pub taken: u16,
    /// Samples refused in a row for what was in them.
    pub refused_run: u16,
    /// Why the last sample was refused, if it was.
    #[serde(with = "invalid_reason")]
    pub invalid: Option<InvalidReason>,
    /// Whether the slot is in use.
    pub present: bool,
    /// Whether a sample of the epoch has been seen.
    pub ordered: bool,
    /// Whether a new run of the source has taken over and none of its samples was accepted yet.
    pub renewed: bool,
    /// Whether a sample has come in this tick, taken or refused.
    pub heard: bool,
    /// Whether a sample has ever been accepted.
    pub accepted: bool,
    pub charging: bool,
    /// Whether the robot has ever been seen charging: its state of charge is then not known.
    pub charged: bool,
    /// Whether the last row lay outside the range of the training.
    pub outside_training: bool,
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
        heard: false,
        accepted: false,
        charging: false,
        charged: false,
        outside_training: false,
    };

    /// Takes what of an absorbed sample does not depend on the forecast. Without a row for the
    /// model there is nothing that could lie outside the training.
    #[inline(always)]
    pub(crate) fn accept(&mut self, sample: &Pending) {
        self.accepted = true;
        self.stamp_ns = sample.stamp_ns;
        self.charging = sample.has(sample_flag::CHARGING);
        self.charged |= self.charging;
        self.outside_training = false;
    }
}

/// What is kept of the last accepted sample, and how many were refused.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Last {
    pub seq: u64,
    /// 0 before the first reading.
    pub measured_ns: u64,
    /// Stamp since which new measurements have all been equal to `reading_w`.
    pub equal_since_ns: u64,
    pub refused: u64,
    pub reading_w: f32,
    /// NaN where there was no forecast for it or no reading in it.
    pub residual_w: f32,
    pub mean_power_w: f32,
    /// [`Quality`], as it lies in shared memory.
    pub quality: u16,
    pub quality_detail: u16,
}

impl Last {
    pub(crate) const NONE: Self = Self {
        seq: 0,
        measured_ns: 0,
        equal_since_ns: 0,
        refused: 0,
        reading_w: f32::NAN,
        residual_w: f32::NAN,
        mean_power_w: f32::NAN,
        quality: Quality::Warmup { have: 0 }.encode().0,
        quality_detail: 0,
    };

    /// Takes a sample with a reading, `elapsed_s` after the one before; `forecast_w` was made for it.
    #[inline(always)]
    pub(crate) fn read(&mut self, sample: &Pending, forecast_w: f32, elapsed_s: f32) {
        self.residual_w = sample.power_w - forecast_w;
        // The first reading counts as new, or a robot that joins while its reading is held would
        // have been stuck since the beginning of time.
        let new = !sample.has(sample_flag::HELD) | self.reading_w.is_nan();
        let changed = new & (sample.power_w.to_bits() != self.reading_w.to_bits());
        put(&mut self.equal_since_ns, changed, sample.stamp_ns);
        self.reading_w = sample.power_w;
        self.measured_ns = sample.measured_ns;
        let weight = elapsed_s / (MEAN_POWER_S + elapsed_s);
        let mean_w = self.mean_power_w + weight * (sample.power_w - self.mean_power_w);
        self.mean_power_w = if self.mean_power_w.is_nan() {
            sample.power_w
        } else {
            mean_w
        };
    }
}

block! {
    /// The last samples of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(64))]
    pub(crate) struct LastLanes of Last {
        seq: u64,
        pub measured_ns: u64,
        pub equal_since_ns: u64,
        pub refused: u64,
        reading_w: f32,
        residual_w: f32,
        pub mean_power_w: f32,
        quality: u16,
        quality_detail: u16,
    }
}

impl LastLanes {
    #[inline(always)]
    pub(crate) fn quality(&self, lane: usize) -> (u16, u16) {
        (self.quality[lane], self.quality_detail[lane])
    }

    #[inline(always)]
    pub(crate) fn set_quality(&mut self, lane: usize, which: bool, quality: (u16, u16)) {
        put(&mut self.quality[lane], which, quality.0);
        put(&mut self.quality_detail[lane], which, quality.1);
    }
}

/// A sample that waits for the next pass: what the checks have left to be used.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pending {
    pub seq: u64,
    pub stamp_ns: u64,
    pub measured_ns: u64,
    pub v_mps: f32,
    pub omega_radps: f32,
    pub power_w: f32,
    flags: u8,
    /// Whether what came before has nothing to do with it.
    pub broken: bool,
}

// All flags that a sample may have fit.
const _: () = assert!(sample_flag::ALL <= u8::MAX as u32);

impl Pending {
    /// From a sample whose flags are all known; `broken` also where the flags do not say so.
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

    /// Whether there is a reading.
    #[inline(always)]
    pub(crate) fn read(&self) -> bool {
        self.has(sample_flag::POWER)
    }

    #[inline(always)]
    pub(crate) fn command(&self) -> Option<(f32, f32)> {
        let known = self.has(sample_flag::V | sample_flag::OMEGA);
        known.then_some((self.v_mps, self.omega_radps))
    }
}

/// What the tick has to do with a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PendingState {
    /// Nothing.
    None,
    /// A sample waits to be absorbed.
    Waiting,
    /// A sample was absorbed, and waits to be accounted for.
    Absorbed,
    /// The same of one that has nothing to do with what came before.
    Broken,
}

block! {
    /// [`Pending`] samples of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    pub(crate) struct PendingLanes of Pending {
        seq: u64,
        pub stamp_ns: u64,
        measured_ns: u64,
        v_mps: f32,
        omega_radps: f32,
        pub power_w: f32,
        flags: u8,
        broken: bool,
    }
}

/// The newest samples of a block, and what has come of them.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[repr(align(32))]
pub(crate) struct PendingBlock {
    pub samples: PendingLanes,
    /// Of an absorbed sample: the forecast one step ahead that was made for its reading; NaN where
    /// there was none.
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
    pub(crate) fn mark(&mut self, lane: usize, which: bool, pending: PendingState) {
        put(&mut self.pending[lane], which, pending as u8);
    }
}
