//! One robot with all its parts, for any controller.

use super::arena::{Command, Pose};
use super::fault::Fault;
use super::loads::Loads;
use super::monitor::{Battery, Measurement, POLL_NS};
use super::parts::Parts;
use joulebus_statistics::noise::Noise;

/// Maximum energy drawn from a battery before a run begins, J.
const MAX_DRAWN_J: f64 = 6_000.0;

/// A robot: pose, loads, battery and monitor.
#[derive(Clone, Debug)]
pub struct Body {
    /// Position and heading.
    pub pose: Pose,
    /// The monitor's output.
    pub measured: Measurement,
    /// When it was measured, ns.
    pub measured_ns: u64,
    noise: Noise,
    monitor_noise_w: f64,
    loads: Loads,
    battery: Battery,
    faults: Vec<(Fault, f64)>,
    next_poll_ns: u64,
}

impl Body {
    /// A robot at rest at time 0. `extra_w` is a constant additional load, W. `neighbours` share
    /// its radio channel. `made` draws its manufacturing variation, `noise` everything else.
    pub fn new(
        parts: Parts,
        extra_w: f64,
        neighbours: usize,
        pose: Pose,
        made: &mut Noise,
        mut noise: Noise,
    ) -> Self {
        let mut loads = Loads::new(parts, extra_w, neighbours, made, &mut noise);
        let mut battery = Battery::new(noise.between(0.0, MAX_DRAWN_J));
        let power_w = loads.poll(&mut noise);
        let measured = battery.measure(power_w, power_w);
        let next_poll_ns = (noise.uniform() * POLL_NS as f64) as u64;
        Self {
            pose,
            measured,
            measured_ns: 0,
            noise,
            monitor_noise_w: parts.monitor_noise_w,
            loads,
            battery,
            faults: Vec::new(),
            next_poll_ns,
        }
    }

    /// Adds a fault from a time on, s.
    pub fn fail(&mut self, fault: Fault, from_s: f64) {
        self.faults.push((fault, from_s));
    }

    /// Energy drawn from the battery, J.
    pub const fn drawn_j(&self) -> f64 {
        self.battery.drawn_j()
    }

    /// Simulates from `now_ns` to `end_ns` under a command.
    pub fn run(&mut self, now_ns: u64, end_ns: u64, command: Command) {
        self.loads.command(command, &mut self.noise);
        self.pose = self.pose.driven(command, end_ns.saturating_sub(now_ns) as f64 * 1e-9);
        let mut now_ns = now_ns;
        while self.next_poll_ns <= end_ns {
            self.turn(now_ns, self.next_poll_ns, command);
            now_ns = self.next_poll_ns;
            self.poll(now_ns);
            self.next_poll_ns += POLL_NS;
        }
        self.turn(now_ns, end_ns, command);
    }

    fn turn(&mut self, now_ns: u64, end_ns: u64, command: Command) {
        if end_ns > now_ns {
            self.loads.turn((end_ns - now_ns) as f64 * 1e-9, command);
        }
    }

    fn poll(&mut self, now_ns: u64) {
        let mut power_w = self.loads.poll(&mut self.noise);
        let mut noise_w = self.monitor_noise_w * self.noise.normal();
        let mut stuck = false;
        for (fault, from_s) in &self.faults {
            if now_ns as f64 * 1e-9 >= *from_s {
                match fault {
                    Fault::ExtraLoad { power_w: extra_w } => power_w += extra_w,
                    Fault::Noise { std_w } => noise_w += std_w * self.noise.normal(),
                    Fault::StuckSensor => stuck = true,
                }
            }
        }
        let measured = self.battery.measure(power_w, power_w + noise_w);
        if !stuck {
            self.measured = measured;
        }
        self.measured_ns = now_ns;
    }
}
