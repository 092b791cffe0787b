//! A small fleet for tests: settings, models, sources, and outputs as bits. Random networks, forged
//! model files, and a channel.
#![forbid(unsafe_code)]

pub mod channels;
pub mod exact;
#[allow(missing_docs)] // The names say it.
pub mod forged;
#[allow(missing_docs)]
pub mod random;

use joulebus_fleet::Fleet;
use joulebus_predictor::{FeatureSet, Kernel, Model, Persistence, ResidualStats};
use joulebus_settings::{
    AlarmSettings, Battery, FleetSettings, Intake, IntervalSettings, Platform,
};
use joulebus_wire::{
    Budget, Diagnostic, Forecast, Outlook, PlanState, Quality, SCHEMA_VERSION, Sample, SampleHeader,
};

/// A millisecond, ns.
pub const MS: u64 = 1_000_000;
/// Sample period of robots 0 to 99, whose model needs velocities.
pub const PERIOD_NS: u64 = 33_333_333;
/// Sample period of robots 100 to 199, whose model reads powers only.
pub const SLOW_NS: u64 = 50 * MS;

/// A battery of 10 kJ.
pub fn battery() -> Battery {
    Battery {
        initial_soc: 0.9,
        initial_soc_lo: 0.8,
        counting_sd: 0.0,
        ..Battery::new(10_000.0, 0.1)
    }
}

fn platform(name: &str, first: u32, period_ns: u64) -> Platform {
    Platform {
        name: name.to_owned(),
        robots: vec![first..=first + 49, first + 50..=first + 99],
        period_ns,
        stale_after_ns: 30 * period_ns,
        hold_max_ns: 400 * MS,
        stuck_after_ns: 2_000 * MS,
        power_min_w: 0.0,
        power_max_w: 20.0,
        v_max_mps: 0.5,
        omega_max_radps: 3.0,
        power_resolution_w: 0.01,
        battery: None,
        alarms: None,
        online: false,
        energy_online: first < 200,
    }
}

/// Robots 0 to 99 need velocities and have a battery, 100 to 199 need none and regenerate, 200 to
/// 299 use persistence, and their energy is as trained.
pub fn settings(capacity: u32) -> FleetSettings {
    FleetSettings {
        capacity,
        intake: Intake {
            max_samples_per_tick: 4,
            max_jump_ns: 5_000 * MS,
            leave_after_ns: 2_500 * MS,
            max_sources: 4,
        },
        interval: IntervalSettings { rate: 0.05, ..IntervalSettings::default() },
        alarms: AlarmSettings {
            bias_weight: 0.01,
            noise_weight: 0.01,
            noise_limit: 4.0,
            mismatch_limit: 2.0,
            level_limit: 11.0,
            settle_samples: 20,
            raise_samples: 3,
            clear_samples: 10,
            ..AlarmSettings::default()
        },
        platforms: vec![
            Platform { battery: Some(battery()), ..platform("wheeled", 0, PERIOD_NS) },
            Platform {
                power_min_w: -10.0,
                battery: Some(battery()),
                ..platform("regenerating", 100, SLOW_NS)
            },
            platform("bare", 200, PERIOD_NS),
        ],
    }
}

/// Models with the paper's features.
pub fn models() -> Vec<Model> {
    models_of([FeatureSet::Full, FeatureSet::PowerOnly])
}

/// Same as [`models`], with a given kernel and instruction set. Unchanged if this processor does
/// not support it.
pub fn models_on(kernel: Kernel) -> Vec<Model> {
    let on = |model: Model| match model {
        Model::Network(network) => {
            let moved = network.clone().with_kernel(kernel);
            Model::Network(moved.unwrap_or(network))
        }
        other => other,
    };
    models().into_iter().map(on).collect()
}

/// Same as [`models`], reading the reading age too.
pub fn fresh_models() -> Vec<Model> {
    models_of([FeatureSet::Freshness, FeatureSet::PowerFreshness])
}

fn models_of([first, second]: [FeatureSet; 2]) -> Vec<Model> {
    let residual = ResidualStats { std_w: 0.1, q05_w: -0.15, q95_w: 0.17 };
    vec![
        Model::Network(random::network(1, first)),
        Model::Network(random::network(2, second)),
        Model::Persistence(Persistence::new(residual).expect("finite and in order")),
    ]
}

/// Same as [`settings`], with all forecasts learning online.
pub fn learning(capacity: u32) -> FleetSettings {
    let mut settings = settings(capacity);
    for platform in &mut settings.platforms {
        platform.online = true;
    }
    settings
}

/// A fleet with [`settings`] and [`models`].
pub fn fleet(capacity: u32) -> Fleet {
    fleet_of(capacity, models())
}

/// Same as [`fleet`], with other models.
pub fn fleet_of(capacity: u32, models: Vec<Model>) -> Fleet {
    Fleet::new(settings(capacity), models).expect("the settings are consistent")
}

/// Numbers the frames of one run of one source like a publisher.
#[derive(Debug, Clone)]
pub struct Source {
    /// The header of its next frame.
    pub header: SampleHeader,
}

impl Source {
    /// A run of a source.
    pub fn new(id: u64, epoch: u64) -> Self {
        Self {
            header: SampleHeader {
                schema: SCHEMA_VERSION,
                pid: 1000 + id as u32,
                source_id: id,
                source_epoch: epoch,
                ..SampleHeader::default()
            },
        }
    }

    /// The header of the next frame, of so many samples.
    pub fn frame(&mut self, samples: usize) -> SampleHeader {
        let header = self.header;
        self.header.frame_seq += 1;
        self.header.samples_before += samples as u64;
        header
    }

    /// The fleet takes its next frame.
    pub fn send(&mut self, fleet: &mut Fleet, samples: &[Sample], now_ns: u64) {
        let header = self.frame(samples.len());
        fleet.take(&header, samples, now_ns);
    }

    /// The fleet takes its next frame and ticks.
    pub fn tick(&mut self, fleet: &mut Fleet, samples: &[Sample], now_ns: u64) {
        self.send(fleet, samples, now_ns);
        fleet.tick(now_ns, false);
    }
}

/// The `step`-th sample of a healthy robot: varying command and power, a new measurement every
/// third sample.
pub fn healthy(robot: u32, step: u64, stamp_ns: u64, period_ns: u64) -> Sample {
    let phase = |rate: f64| ((step as f64 + f64::from(robot) * 7.3) * rate).sin() as f32;
    let since = step % 3;
    let power_w = 3.6
        + 0.4 * {
            let measured = (step - since) as f64 + f64::from(robot);
            (measured * 0.31).sin() as f32
        };
    let sample = Sample::new(robot, step, stamp_ns)
        .command(0.2 * phase(0.11), 1.5 * phase(0.07))
        .reading(power_w, stamp_ns.saturating_sub(since * period_ns));
    if since == 0 { sample } else { sample.with(joulebus_wire::sample_flag::HELD) }
}

/// All outputs of one robot, with floats as their bits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bits {
    /// Bits of its forecast.
    pub forecast: Vec<u64>,
    /// Bits of its diagnostic.
    pub diagnostic: Vec<u64>,
    /// Bits of its budget.
    pub budget: Vec<u64>,
    /// Bits of its state for plans.
    pub plan_state: Vec<u64>,
    /// Bits of its outlook.
    pub outlook: Vec<u64>,
}

/// Outputs of a robot; `None` when it is not in the fleet. The slot's generation is omitted: it
/// belongs to the slot, not to the robot.
pub fn bits(fleet: &Fleet, robot: u32) -> Option<Bits> {
    let place = place(fleet, robot)?;
    Some(Bits {
        forecast: row_bits(&Forecast { generation: 0, ..fleet.forecast(place) }),
        diagnostic: row_bits(&fleet.diagnostic(place)),
        budget: row_bits(&fleet.budget(place)),
        plan_state: row_bits(&PlanState { generation: 0, ..fleet.plan_state(place) }),
        outlook: row_bits(&Outlook { generation: 0, ..fleet.outlook(place) }),
    })
}

/// Same as [`bits`] without the bounds of the energy's errors, the shares of outlooks, the priors of
/// lasting power and of trust in commands, and what follows from them: the robots of a platform
/// learn them together.
pub fn own_bits(fleet: &Fleet, robot: u32) -> Option<Bits> {
    let state = fleet.plan_state(place(fleet, robot)?);
    let own = PlanState {
        generation: 0,
        error_lower: [0.0; 3],
        error_upper: [0.0; 3],
        command_trust: 0.0,
        ..state
    };
    let budget = fleet.budget(place(fleet, robot)?);
    let budget =
        Budget { time_to_empty_s: 0.0, time_to_empty_lo_s: 0.0, time_to_empty_hi_s: 0.0, ..budget };
    let outlook = Outlook {
        generation: 0,
        mean_w: 0.0,
        energy_j: [0.0; 4],
        energy_lo_j: [0.0; 4],
        energy_hi_j: [0.0; 4],
        time_to_empty_s: 0.0,
        time_to_empty_lo_s: 0.0,
        time_to_empty_hi_s: 0.0,
        ..fleet.outlook(place(fleet, robot)?)
    };
    Some(Bits {
        plan_state: row_bits(&own),
        budget: row_bits(&budget),
        outlook: row_bits(&outlook),
        ..bits(fleet, robot)?
    })
}

/// Place of a robot in the fleet; `None` if it is not there.
pub fn place(fleet: &Fleet, robot: u32) -> Option<usize> {
    (0..fleet.len()).find(|place| fleet.forecast(*place).robot == robot)
}

/// Forecast of a robot that is there.
///
/// # Panics
/// The robot is not there.
pub fn forecast(fleet: &Fleet, robot: u32) -> Forecast {
    fleet.forecast(place(fleet, robot).expect("the robot is in the fleet"))
}

/// Diagnostic of a robot that is there.
///
/// # Panics
/// The robot is not there.
pub fn diagnostic(fleet: &Fleet, robot: u32) -> Diagnostic {
    fleet.diagnostic(place(fleet, robot).expect("the robot is in the fleet"))
}

/// Budget of a robot that is there.
///
/// # Panics
/// The robot is not there.
pub fn budget(fleet: &Fleet, robot: u32) -> Budget {
    fleet.budget(place(fleet, robot).expect("the robot is in the fleet"))
}

/// The state from which plans of a present robot start.
///
/// # Panics
/// The robot is not there.
pub fn plan_state(fleet: &Fleet, robot: u32) -> PlanState {
    fleet.plan_state(place(fleet, robot).expect("the robot is in the fleet"))
}

/// Outlook of a robot that is there.
///
/// # Panics
/// The robot is not there.
pub fn outlook(fleet: &Fleet, robot: u32) -> Outlook {
    fleet.outlook(place(fleet, robot).expect("the robot is in the fleet"))
}

/// Quality of the forecast of a robot that is there.
///
/// # Panics
/// The robot is not there.
pub fn quality(fleet: &Fleet, robot: u32) -> Quality {
    forecast(fleet, robot).quality()
}

/// All of a row. Its length is a multiple of eight bytes.
pub fn row_bits<R: bytemuck::NoUninit>(row: &R) -> Vec<u64> {
    let words = bytemuck::bytes_of(row).chunks_exact(8);
    words.map(|word| u64::from_ne_bytes(word.try_into().expect("eight bytes"))).collect()
}
