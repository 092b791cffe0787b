//! Input of a fleet: the samples of all robots, tick by tick.

use joulebus_settings::Platform;
use joulebus_wire::{SCHEMA_VERSION, Sample, SampleHeader, sample_flag};

/// Steps after which commands and powers repeat.
const CYCLE: usize = 1024;

/// Robots that all send a sample each tick: varying commands and powers, a new measurement every
/// third sample, as from the GTernal's monitor.
pub(crate) struct World {
    header: SampleHeader,
    samples: Vec<Sample>,
    period_ns: u64,
    step: u64,
    command: Vec<(f32, f32)>,
    power_w: Vec<f32>,
}

impl World {
    /// The first `robots` robots of a platform.
    pub(crate) fn new(platform: &Platform, robots: usize) -> Self {
        let first = *platform.robots[0].start();
        let wave = |step: usize, times: f32| {
            let turn = std::f32::consts::TAU * step as f32 / CYCLE as f32;
            (turn * times).sin()
        };
        let command = |step| (0.15 * wave(step, 3.0), 1.2 * wave(step, 5.0));
        let mut world = Self {
            header: SampleHeader {
                schema: SCHEMA_VERSION,
                pid: 1,
                source_id: 1,
                source_epoch: 1,
                ..SampleHeader::default()
            },
            samples: (0..robots).map(|place| Sample::new(first + place as u32, 0, 0)).collect(),
            period_ns: platform.period_ns,
            step: 0,
            command: (0..CYCLE).map(command).collect(),
            power_w: (0..CYCLE).map(|step| 3.65 + 0.3 * wave(step, 7.0)).collect(),
        };
        world.write();
        world
    }

    /// The frame of this step.
    pub(crate) fn frame(&self) -> (&SampleHeader, &[Sample]) {
        (&self.header, &self.samples)
    }

    /// When the frame of this step is received, ns on the worker's clock.
    pub(crate) fn now_ns(&self) -> u64 {
        self.stamp_ns() + 1_000_000
    }

    /// Continues to the next step.
    pub(crate) fn advance(&mut self) {
        self.step += 1;
        self.header.frame_seq += 1;
        self.header.samples_before += self.samples.len() as u64;
        self.write();
    }

    fn stamp_ns(&self) -> u64 {
        (self.step + 100) * self.period_ns
    }

    fn write(&mut self) {
        let stamp_ns = self.stamp_ns();
        self.header.intended_ns = stamp_ns;
        self.header.sent_ns = stamp_ns;
        for (robot, sample) in self.samples.iter_mut().enumerate() {
            let since = (self.step + robot as u64) % 3;
            let at = |step: u64| (step as usize + robot * 37) % CYCLE;
            let (v_mps, omega_radps) = self.command[at(self.step)];
            let power_w = self.power_w[at(self.step + 2 - since)];
            *sample = Sample::new(sample.robot, self.step, stamp_ns)
                .command(v_mps, omega_radps)
                .reading(power_w, stamp_ns - since * self.period_ns);
            if since > 0 {
                *sample = sample.with(sample_flag::HELD);
            }
        }
    }
}
