//! Samples, published by fleet controllers and other sources.

use crate::declare::ZeroCopySend;
use crate::layout::bits;
use crate::rows;

bits! {
    /// Bits of [`Sample::flags`]. A sample with any other bit is refused.
    pub mod sample_flag {
        /// `v_mps` is known.
        pub const V: u32 = 1 << 0;
        /// `omega_radps` is known.
        pub const OMEGA: u32 = 1 << 1;
        /// `power_w` and `measured_ns` are known.
        pub const POWER: u32 = 1 << 2;
        /// `voltage_v` is known.
        pub const VOLTAGE: u32 = 1 << 3;
        /// `current_a` is known.
        pub const CURRENT: u32 = 1 << 4;
        /// The reading repeats the previous one: the monitor has not measured again.
        pub const HELD: u32 = 1 << 5;
        /// The robot is on its charger.
        pub const CHARGING: u32 = 1 << 6;
        /// The sample does not continue the ones before it (a recorded trial starts again): the lag
        /// window starts empty.
        pub const DISCONTINUITY: u32 = 1 << 7;
        /// `soc` is known.
        pub const SOC: u32 = 1 << 8;
        /// The charger or the battery's own electronics says that the battery is full. Only with
        /// [`CHARGING`].
        pub const FULL: u32 = 1 << 9;
        /// The battery has been exchanged since the last sample.
        pub const SWAPPED: u32 = 1 << 10;
        /// `return_j` is known.
        pub const RETURN: u32 = 1 << 11;
        /// The robot is switched off: until its next sample it draws what it draws at rest. Without
        /// it a silence costs the platform's greatest power.
        pub const OFF: u32 = 1 << 12;
        /// The source finds what the robot reports implausible: the alarm `Implausible`. From this
        /// bit on flags are the source's judgement.
        pub const IMPLAUSIBLE: u32 = 1 << 16;
        /// All defined bits.
        pub const ALL: u32 = ((1 << 13) - 1) | IMPLAUSIBLE;
    }
}

rows! {
    /// One robot's command and latest reading in one control tick. 64 bytes.
    pub struct Sample: "joulebus.Sample.v2", 64 {
        /// Id of the robot, unique in the fleet.
        pub robot: u32,
        /// [`sample_flag`] bits.
        pub flags: u32,
        /// Number of this robot's sample within the source epoch. Strictly increasing.
        pub seq: u64,
        /// When the command was issued, monotonic ns. Strictly increasing per robot.
        #[instant]
        pub stamp_ns: u64,
        /// When the power was *measured*, monotonic ns. Equal to the previous one for a held
        /// reading.
        #[instant]
        pub measured_ns: u64,
        /// Linear velocity just commanded, after saturation, m/s.
        pub v_mps: f32,
        /// Angular velocity just commanded, after saturation, rad/s.
        pub omega_radps: f32,
        /// Electrical power just read, W. Negative where the platform regenerates.
        pub power_w: f32,
        /// Battery voltage, V.
        pub voltage_v: f32,
        /// Battery current, A, positive while discharging.
        pub current_a: f32,
        /// Measured state of charge, 0 to 1.
        pub soc: f32,
        /// Energy that the robot needs from here to return, J: what its planner says. It applies to
        /// this sample only. Without it the platform's config applies.
        pub return_j: f32,
        /// Zero.
        pub reserved: u32,
    }
}

impl Sample {
    /// A sample without command and reading.
    #[must_use]
    pub const fn new(robot: u32, seq: u64, stamp_ns: u64) -> Self {
        Self {
            robot,
            flags: 0,
            seq,
            stamp_ns,
            measured_ns: 0,
            v_mps: f32::NAN,
            omega_radps: f32::NAN,
            power_w: f32::NAN,
            voltage_v: f32::NAN,
            current_a: f32::NAN,
            soc: f32::NAN,
            return_j: f32::NAN,
            reserved: 0,
        }
    }

    /// With the command just issued: m/s and rad/s.
    #[must_use]
    pub const fn command(mut self, v_mps: f32, omega_radps: f32) -> Self {
        self.v_mps = v_mps;
        self.omega_radps = omega_radps;
        self.flags |= sample_flag::V | sample_flag::OMEGA;
        self
    }

    /// With the power just read, W, and when it was measured, monotonic ns.
    #[must_use]
    pub const fn reading(mut self, power_w: f32, measured_ns: u64) -> Self {
        self.power_w = power_w;
        self.measured_ns = measured_ns;
        self.flags |= sample_flag::POWER;
        self
    }

    /// With the battery's voltage, V, and current, A (positive while discharging).
    #[must_use]
    pub const fn battery(mut self, voltage_v: f32, current_a: f32) -> Self {
        self.voltage_v = voltage_v;
        self.current_a = current_a;
        self.flags |= sample_flag::VOLTAGE | sample_flag::CURRENT;
        self
    }

    /// With the measured state of charge, 0 to 1.
    #[must_use]
    pub const fn state_of_charge(mut self, soc: f32) -> Self {
        self.soc = soc;
        self.flags |= sample_flag::SOC;
        self
    }

    /// With the energy that the robot needs to return, J.
    #[must_use]
    pub const fn return_energy(mut self, return_j: f32) -> Self {
        self.return_j = return_j;
        self.flags |= sample_flag::RETURN;
        self
    }

    /// With further [`sample_flag`] bits set.
    #[must_use]
    pub const fn with(mut self, flags: u32) -> Self {
        self.flags |= flags;
        self
    }

    /// True if all of `flags` are set.
    #[must_use]
    pub const fn has(&self, flags: u32) -> bool {
        self.flags & flags == flags
    }

    /// Freshness of the reading.
    pub const fn freshness(&self) -> Freshness {
        if !self.has(sample_flag::POWER) {
            Freshness::Missing
        } else if self.has(sample_flag::HELD) {
            Freshness::Held
        } else {
            Freshness::Fresh
        }
    }
}

/// Freshness of a reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Freshness {
    /// A new measurement.
    Fresh,
    /// The last measurement again.
    Held,
    /// No measurement.
    Missing,
}

rows! {
    /// Header of a frame of samples: what one source sends at once.
    #[derive(Eq)]
    pub struct SampleHeader: "joulebus.SampleHeader.v1", 64 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the source. That of a link has the bit 2³¹ beside it.
        pub pid: u32,
        /// Id of the source, stable over restarts (a hash of its name).
        pub source_id: u64,
        /// When this run of the source began, monotonic ns: a restart has a greater one, however
        /// the wall clock was set.
        #[run]
        pub source_epoch: u64,
        /// Number of this frame within the epoch, from 0.
        pub frame_seq: u64,
        /// Samples sent in this epoch before this frame, from which a reader computes its loss.
        pub samples_before: u64,
        /// Intended send time, monotonic ns. Latency is measured from here, so that a stalled
        /// source does not hide its own delay (coordinated omission).
        #[instant]
        pub intended_ns: u64,
        /// When the frame was sent, monotonic ns.
        #[instant]
        pub sent_ns: u64,
        /// When the frame was sent, Unix ns: informative only, never used for an interval.
        pub sent_unix_ns: u64,
    }
}

impl SampleHeader {
    /// Bit of [`SampleHeader::pid`] of a frame that a link passed on: the end of the link is not
    /// the end of the source. Process ids are smaller.
    const RELAYED: u32 = 1 << 31;

    /// Marks the frame as passed on by a link, whose process is `pid`.
    pub const fn relay(&mut self, pid: u32) {
        self.pid = pid | Self::RELAYED;
    }

    /// True if a link passed the frame on.
    pub const fn is_relayed(&self) -> bool {
        self.pid & Self::RELAYED != 0
    }

    /// The process that sent the frame on this host.
    pub const fn process(&self) -> u32 {
        self.pid & !Self::RELAYED
    }
}
