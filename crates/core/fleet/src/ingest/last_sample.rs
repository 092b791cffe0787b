//! State kept of a robot's last accepted sample.

use joulebus_wire::{Quality, sample_flag};
use serde::{Deserialize, Serialize};

use crate::ingest::pending::Pending;
use crate::layout::lanes::{Count, InstantNs, block, put};

/// Time constant of the mean power, s.
const MEAN_POWER_S: f32 = 60.0;

block! {
    /// State kept of the last accepted sample, and the number of refused ones.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Last: NONE;

    /// The last samples of a block.
    #[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
    #[repr(align(64))]
    pub(crate) struct LastLanes {
        pub seq: Count = 0,
        /// 0 before the first reading.
        pub measured_ns: InstantNs = 0,
        /// Stamp since which all new measurements have been equal to `reading_w`.
        pub equal_since_ns: InstantNs = 0,
        pub refused: Count = 0,
        pub reading_w: f32 = f32::NAN,
        /// The reading minus the network's forecast of it, W. NaN if there was no forecast or no
        /// reading.
        pub residual_w: f32 = f32::NAN,
        pub mean_power_w: f32 = f32::NAN,
        /// [`Quality`], encoded as in shared memory.
        pub quality: u16 = Quality::Warmup { have: 0 }.encode().0,
        pub quality_detail: u16 = 0,
    }
}

impl Last {
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

impl LastLanes {
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
