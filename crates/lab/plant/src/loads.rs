//! Electrical loads of one robot, advanced at each poll of its power monitor.
//!
//! Wheels are simulated in continuous time under each command. Loads visible only to the monitor
//! are advanced when it is polled, every tenth of a second: that is exact for drifts and thermal
//! memory, and aligns the ends of radio bursts with the monitor's polls.

use super::arena::{Command, wheels_mps};
use super::monitor::POLL_S;
use super::parts::Parts;
use joulebus_statistics::noise::Noise;

/// Maximum number of simultaneous bursts of one robot. Further ones are dropped.
const MAX_BURSTS: usize = 8;
/// Maximum power of a burst, in multiples of the mean.
const MAX_OF_A_BURST: f64 = 4.0;
/// A wheel slower than this is at rest, m/s.
const REST_MPS: f64 = 0.005;
/// A wheel commanded to turn faster than this starts, m/s.
const START_MPS: f64 = 0.02;
/// Manufacturing variations are clamped to this many standard deviations.
const WIDEST: f64 = 2.5;

/// Decay factors per poll of the drifts and the thermal memory.
#[derive(Clone, Copy, Debug)]
struct Decay {
    drift: f64,
    processor: f64,
    roughness: f64,
    thermal: f64,
    burst: f64,
    no_burst: f64,
}

/// The electrical loads of one robot.
#[derive(Clone, Debug)]
pub(super) struct Loads {
    parts: Parts,
    decay: Decay,
    electronics_w: f64,
    friction: [f64; 2],
    drift: f64,
    processor: f64,
    roughness: f64,
    warm_w: f64,
    wheels_mps: [f64; 2],
    motors_j: f64,
    motors_s: f64,
    bursts_w: [f64; MAX_BURSTS],
    stuck: bool,
}

impl Loads {
    /// The loads of a robot at rest. `made` draws its manufacturing variations, `noise` its initial
    /// state. `extra_w` is a constant additional load. `neighbours` share its radio channel.
    pub(super) fn new(
        parts: Parts,
        extra_w: f64,
        neighbours: usize,
        made: &mut Noise,
        noise: &mut Noise,
    ) -> Self {
        let mut spread = || made.normal().clamp(-WIDEST, WIDEST);
        let busy = 1.0 + parts.burst_cut_per_neighbour * neighbours as f64;
        let bursts_per_s = parts.bursts_per_s + parts.bursts_per_neighbour_s * neighbours as f64;
        Self {
            parts,
            decay: Decay {
                drift: libm::exp(-POLL_S / parts.drift_time_s),
                processor: libm::exp(-POLL_S / parts.processor_time_s),
                roughness: libm::exp(-POLL_S / parts.roughness_time_s),
                thermal: libm::exp(-POLL_S / parts.thermal_time_s),
                burst: libm::exp(-POLL_S * busy / parts.burst_time_s),
                no_burst: libm::exp(-POLL_S * bursts_per_s),
            },
            electronics_w: parts.electronics_w + parts.electronics_spread_w * spread() + extra_w,
            friction: std::array::from_fn(|_| 1.0 + parts.friction_spread * spread()),
            drift: noise.normal(),
            processor: noise.normal(),
            roughness: noise.normal(),
            warm_w: 0.0,
            wheels_mps: [0.0; 2],
            motors_j: 0.0,
            motors_s: 0.0,
            bursts_w: [0.0; MAX_BURSTS],
            stuck: false,
        }
    }

    /// A new command: a wheel that starts from rest may stick.
    pub(super) fn command(&mut self, command: Command, noise: &mut Noise) {
        for (speed_mps, wanted_mps) in self.wheels_mps.into_iter().zip(wheels_mps(command)) {
            if speed_mps.abs() < REST_MPS && wanted_mps.abs() > START_MPS {
                self.stuck |= noise.uniform() < self.parts.stall_chance;
            }
        }
    }

    /// Accelerates the wheels towards the command for `dt_s` seconds, above 0.
    pub(super) fn turn(&mut self, dt_s: f64, command: Command) {
        let reached = 1.0 - libm::exp(-dt_s / self.parts.motor_time_s);
        for ((speed_mps, wanted_mps), friction) in
            self.wheels_mps.iter_mut().zip(wheels_mps(command)).zip(self.friction)
        {
            let before_mps = *speed_mps;
            *speed_mps += (wanted_mps - before_mps) * reached;
            let mean_mps = 0.5 * (before_mps.abs() + speed_mps.abs());
            let rolling_w = self.parts.friction_w_per_mps * mean_mps
                + self.parts.losses_w_per_m2ps2 * mean_mps * mean_mps;
            let gained_m2ps2 = *speed_mps * *speed_mps - before_mps * before_mps;
            self.motors_j += friction * rolling_w * dt_s
                + self.parts.acceleration_w_per_m2ps3 * gained_m2ps2.max(0.0);
        }
        self.motors_s += dt_s;
    }

    /// Power at a poll, one poll period after the last one, W. The motors' part is their mean over
    /// that period, as the monitor averages it.
    pub(super) fn poll(&mut self, noise: &mut Noise) -> f64 {
        let Decay { drift, processor, roughness, thermal, .. } = self.decay;
        self.drift = drifted(self.drift, drift, noise);
        self.processor = drifted(self.processor, processor, noise);
        self.roughness = drifted(self.roughness, roughness, noise);
        let smooth_w = if self.motors_s > 0.0 { self.motors_j / self.motors_s } else { 0.0 };
        (self.motors_j, self.motors_s) = (0.0, 0.0);
        let motors_w = smooth_w * (1.0 + self.parts.roughness * self.roughness).max(0.0);
        self.warm_w = motors_w + (self.warm_w - motors_w) * thermal;
        let stuck_w = if self.stuck { self.parts.stall_w } else { 0.0 };
        self.stuck = false;
        self.electronics_w
            + self.parts.drift_w * self.drift
            + self.parts.processor_w * self.processor * self.processor
            + motors_w
            + self.parts.thermal_share * self.warm_w
            + self.radio_w(noise)
            + stuck_w
    }

    /// Ends and starts bursts. Returns the power of the active ones, W.
    fn radio_w(&mut self, noise: &mut Noise) -> f64 {
        let mut radio_w = 0.0;
        let mut begins = noise.uniform() >= self.decay.no_burst;
        for burst_w in &mut self.bursts_w {
            if *burst_w > 0.0 && noise.uniform() >= self.decay.burst {
                *burst_w = 0.0;
            } else if *burst_w == 0.0 && begins {
                let mean_w = self.parts.burst_w;
                *burst_w = noise.waiting_s(mean_w).min(MAX_OF_A_BURST * mean_w);
                begins = false;
            }
            radio_w += *burst_w;
        }
        radio_w
    }
}

/// One step of a mean-reverting drift with mean 0 and deviation 1. `decay` is the decay factor.
pub(super) fn drifted(value: f64, decay: f64, noise: &mut Noise) -> f64 {
    value * decay + libm::sqrt(1.0 - decay * decay) * noise.normal()
}
