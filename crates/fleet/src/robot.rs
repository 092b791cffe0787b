//! Who holds a slot, and what came of its last sample.

use joulebus_wire::{InvalidReason, Quality, Sample, sample_flag};
use serde::{Deserialize, Serialize};

use crate::state::{invalid_reason, quality};

/// Time over which the mean power is taken, s.
const MEAN_POWER_S: f32 = 60.0;

/// Identity and bookkeeping of a robot in its slot.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Robot {
    pub id: u32,
    /// Whether the slot is in use.
    pub present: bool,
    pub platform: u16,
    pub generation: u32,
    pub source_id: u64,
    pub source_epoch: u64,
    /// Whether a new run of the source has taken over and none of its samples was accepted yet.
    pub renewed: bool,
    /// Whether a sample of it waits for the next pass.
    pub waiting: bool,
    /// Highest sequence number taken or refused in the epoch, if any.
    pub seq: Option<u64>,
    /// When the worker last took a sample of it, monotonic ns of the worker.
    pub taken_ns: u64,
    /// Samples taken in this tick.
    pub taken: u16,
    /// Whether a sample has come in this tick, taken or refused.
    pub heard: bool,
    pub refused: u64,
    /// Samples refused in a row for what was in them.
    pub refused_run: u16,
    /// Why the last sample was refused, if it was.
    #[serde(with = "invalid_reason")]
    pub invalid: Option<InvalidReason>,
    pub last: Last,
}

/// What is kept of the last accepted sample.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Last {
    pub accepted: bool,
    #[serde(with = "quality")]
    pub quality: Quality,
    pub seq: u64,
    pub stamp_ns: u64,
    pub reading_w: f32,
    pub measured_ns: u64,
    /// NaN where there was no forecast for it or no reading in it.
    pub residual_w: f32,
    /// Stamp since which new measurements have all been equal to `reading_w`.
    pub equal_since_ns: u64,
    pub outside_training: bool,
    pub charging: bool,
    /// Whether the robot has ever been seen charging: its state of charge is then not known.
    pub charged: bool,
    pub mean_power_w: f32,
}

impl Robot {
    /// Nobody: the slot has never been in use.
    pub(crate) const ABSENT: Self = Self {
        id: 0,
        present: false,
        platform: 0,
        generation: 0,
        source_id: 0,
        source_epoch: 0,
        renewed: false,
        waiting: false,
        seq: None,
        taken_ns: 0,
        taken: 0,
        heard: false,
        refused: 0,
        refused_run: 0,
        invalid: None,
        last: Last::NONE,
    };
}

impl Last {
    pub(crate) const NONE: Self = Self {
        accepted: false,
        quality: Quality::Warmup { have: 0 },
        seq: 0,
        stamp_ns: 0,
        reading_w: f32::NAN,
        measured_ns: 0,
        residual_w: f32::NAN,
        equal_since_ns: 0,
        outside_training: false,
        charging: false,
        charged: false,
        mean_power_w: f32::NAN,
    };

    /// Takes what does not depend on the forecast.
    pub(crate) fn accept(&mut self, sample: &Sample) {
        let elapsed_s = (sample.stamp_ns.saturating_sub(self.stamp_ns) as f64 * 1e-9) as f32;
        let first = !self.accepted;
        self.accepted = true;
        self.seq = sample.seq;
        self.stamp_ns = sample.stamp_ns;
        self.charging = sample.has(sample_flag::CHARGING);
        self.charged |= self.charging;
        if !sample.has(sample_flag::POWER) {
            return;
        }
        // The first reading counts as new, or a robot that joins while its reading is held would
        // have been stuck since the beginning of time.
        let new = !sample.has(sample_flag::HELD) || self.reading_w.is_nan();
        if new && sample.power_w.to_bits() != self.reading_w.to_bits() {
            self.equal_since_ns = sample.stamp_ns;
        }
        self.reading_w = sample.power_w;
        self.measured_ns = sample.measured_ns;
        if first || self.mean_power_w.is_nan() {
            self.mean_power_w = sample.power_w;
        } else {
            let weight = elapsed_s / (MEAN_POWER_S + elapsed_s);
            self.mean_power_w += weight * (sample.power_w - self.mean_power_w);
        }
    }
}

/// A sample that waits for the next pass: what the checks have left to be used.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct Pending {
    seq: u64,
    pub stamp_ns: u64,
    measured_ns: u64,
    v_mps: f32,
    omega_radps: f32,
    power_w: f32,
    pub flags: u32,
}

impl Pending {
    pub(crate) fn new(sample: &Sample) -> Self {
        Self {
            seq: sample.seq,
            stamp_ns: sample.stamp_ns,
            measured_ns: sample.measured_ns,
            v_mps: sample.v_mps,
            omega_radps: sample.omega_radps,
            power_w: sample.power_w,
            flags: sample.flags & !(sample_flag::VOLTAGE | sample_flag::CURRENT),
        }
    }

    /// The sample without its voltage and current.
    pub(crate) fn sample(&self, robot: u32) -> Sample {
        Sample {
            flags: self.flags,
            measured_ns: self.measured_ns,
            v_mps: self.v_mps,
            omega_radps: self.omega_radps,
            power_w: self.power_w,
            ..Sample::new(robot, self.seq, self.stamp_ns)
        }
    }
}
