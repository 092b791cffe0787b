//! State kept of a robot's last accepted sample.

use joulebus_wire::{Quality, sample_flag};
use serde::{Deserialize, Serialize};

use crate::ingest::pending::Pending;
use crate::layout::lanes::{block, put};
use crate::layout::shift::Shift;

/// Time constant of the mean power, s.
const MEAN_POWER_S: f32 = 60.0;

/// State kept of the last accepted sample, and the number of refused ones.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Last {
    pub seq: u64,
    /// 0 before the first reading.
    pub measured_ns: u64,
    /// Stamp since which all new measurements have been equal to `reading_w`.
    pub equal_since_ns: u64,
    pub refused: u64,
    pub reading_w: f32,
    /// The reading minus the network's forecast of it, W. NaN if there was no forecast or no
    /// reading.
    pub residual_w: f32,
    pub mean_power_w: f32,
    /// [`Quality`], encoded as in shared memory.
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

    /// Takes a sample with a reading, which stands for `elapsed_s`. `network_w` is the network's
    /// forecast of it.
    #[inline(always)]
    pub(crate) fn read(&mut self, sample: &Pending, network_w: f32, elapsed_s: f32) {
        self.residual_w = sample.power_w - network_w;
        // The first reading counts as new, or a robot that joins while its reading is held would
        // have been stuck since the beginning of time.
        let new = !sample.has(sample_flag::HELD) | self.reading_w.is_nan();
        let changed = new & (sample.power_w.to_bits() != self.reading_w.to_bits());
        put(&mut self.equal_since_ns, changed, sample.stamp_ns);
        self.reading_w = sample.power_w;
        self.measured_ns = sample.measured_ns;
        let weight = elapsed_s / (MEAN_POWER_S + elapsed_s);
        let mean_w = self.mean_power_w + weight * (sample.power_w - self.mean_power_w);
        let mean_w = if self.mean_power_w.is_nan() { sample.power_w } else { mean_w };
        // The charger's power says nothing about time away from it.
        put(&mut self.mean_power_w, !sample.has(sample_flag::CHARGING), mean_w);
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
        pub reading_w: f32,
        pub residual_w: f32,
        pub mean_power_w: f32,
        quality: u16,
        quality_detail: u16,
    }
}

impl LastLanes {
    /// Moves the instants to another clock.
    pub(crate) fn shift(&mut self, shift: Shift) {
        let Self {
            seq: _,
            measured_ns,
            equal_since_ns,
            refused: _,
            reading_w: _,
            residual_w: _,
            mean_power_w: _,
            quality: _,
            quality_detail: _,
        } = self;
        shift.instants(measured_ns);
        shift.instants(equal_since_ns);
    }

    #[inline(always)]
    pub(crate) fn quality(&self, lane: usize) -> (u16, u16) {
        (self.quality[lane], self.quality_detail[lane])
    }

    #[inline(always)]
    pub(crate) fn set_quality(&mut self, lane: usize, mask: bool, quality: (u16, u16)) {
        put(&mut self.quality[lane], mask, quality.0);
        put(&mut self.quality_detail[lane], mask, quality.1);
    }
}
