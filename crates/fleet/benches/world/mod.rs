//! A fleet to be measured: one platform with a battery, and a sample of every robot for each tick.

#[path = "../../../predictor/tests/random/mod.rs"]
#[allow(dead_code)]
mod random;

use joulebus_fleet::Fleet;
use joulebus_predictor::{FeatureSet, Model};
use joulebus_settings::{
    AlarmSettings, Battery, FleetSettings, Intake, IntervalSettings, Online, Platform,
};
use joulebus_wire::{Budget, Diagnostic, Forecast, SCHEMA_VERSION, Sample, SampleHeader};

pub(crate) use random::Noise;

pub(crate) const PERIOD_NS: u64 = 33_333_333;
pub(crate) const MS: u64 = 1_000_000;
/// Frames of memory that outputs take turns in, as in shared memory.
pub(crate) const FRAMES: usize = 3;

/// A fleet, its samples, and memory for what it says.
pub(crate) struct World {
    pub fleet: Fleet,
    pub model: Model,
    pub forecasts: Vec<Vec<Forecast>>,
    pub diagnostics: Vec<Vec<Diagnostic>>,
    pub budgets: Vec<Vec<Budget>>,
    pub noise: Noise,
    samples: Vec<Sample>,
    header: SampleHeader,
}

impl World {
    pub(crate) fn new(robots: usize) -> Self {
        let model = Model::Network(random::network(1, FeatureSet::Full));
        let settings = settings(robots as u32);
        let models = vec![model.clone(); settings.platforms.len()];
        let contexts = models.len() as u32;
        let each = (robots as u32).div_ceil(contexts);
        // Robots of all platforms in turn.
        let ids =
            (0..each).flat_map(|place| (0..contexts).map(move |context| context * each + place));
        Self {
            fleet: Fleet::new(settings, models).expect("the settings are fine"),
            model,
            forecasts: vec![vec![Forecast::default(); robots]; FRAMES],
            diagnostics: vec![vec![Diagnostic::default(); robots]; FRAMES],
            budgets: vec![vec![Budget::default(); robots]; FRAMES],
            noise: Noise(3),
            samples: ids
                .filter(|robot| *robot < robots as u32)
                .map(|robot| Sample::new(robot, 0, 0))
                .collect(),
            header: SampleHeader {
                schema: SCHEMA_VERSION,
                source_id: 1,
                source_epoch: 1,
                ..SampleHeader::default()
            },
        }
    }

    /// Takes a sample of every robot; gives when, ns, and how long that took, s.
    pub(crate) fn take(&mut self, round: usize) -> (u64, f64) {
        let now_ns = 60_000 * MS + round as u64 * PERIOD_NS;
        let holes = asked_for("holes");
        for sample in &mut self.samples {
            *sample = Sample::new(sample.robot, round as u64, now_ns)
                .command(0.2 * self.noise.next_f32(), self.noise.next_f32());
            if !holes || !self.noise.next_u64().is_multiple_of(10) {
                *sample = sample.reading(3.6 + 0.3 * self.noise.next_f32(), now_ns);
            }
        }
        let start = std::time::Instant::now();
        self.fleet.take(&self.header, &self.samples, now_ns);
        let taken_in_s = start.elapsed().as_secs_f64();
        self.header.samples_before += self.samples.len() as u64;
        (now_ns, taken_in_s)
    }
}

fn asked_for(option: &str) -> bool {
    std::env::args().any(|argument| argument == option)
}

fn settings(capacity: u32) -> FleetSettings {
    let learning = asked_for("learning");
    let contexts = if asked_for("mixed") { 3 } else { 1 };
    let each = capacity.div_ceil(contexts);
    FleetSettings {
        capacity,
        intake: Intake {
            max_samples_per_tick: 8,
            max_jump_ns: 60_000 * MS,
            leave_after_ns: 30_000 * MS,
            max_sources: 64,
        },
        interval: IntervalSettings {
            coverage: 0.9,
            rate: 0.02,
        },
        alarms: AlarmSettings {
            bias_weight: 0.005,
            cusum_slack: 1.0,
            cusum_limit: 50.0,
            noise_weight: 0.005,
            noise_limit: 15.0,
            mismatch_limit: 1.5,
            settle_samples: 300,
            raise_samples: 15,
            clear_samples: 90,
            training_margin: 0.1,
        },
        platforms: (0..contexts)
            .map(|context| Platform {
                name: format!("wheeled-{context}"),
                robots: vec![context * each..=context * each + each - 1],
                period_ns: PERIOD_NS,
                stale_after_ns: 500 * MS,
                hold_max_ns: 500 * MS,
                stuck_after_ns: 10_000 * MS,
                power_min_w: 0.0,
                power_max_w: 20.0,
                v_max_mps: 2.0,
                omega_max_radps: 3.0,
                power_resolution_w: 0.01,
                battery: Some(Battery {
                    capacity_j: 10_000.0,
                    reserve: 0.1,
                    initial_soc: 0.9,
                    initial_soc_lo: 0.8,
                }),
                online: Online {
                    mixture: learning,
                    adapt: learning,
                },
            })
            .collect(),
    }
}
