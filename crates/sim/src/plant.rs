//! Simulated GTernal robots: their commands and electrical power.
//!
//! A robot's power is the sum of loads (the constants of `electrical.rs`): electronics with
//! manufacturing variation, slow thermal drift, processor load, motors with friction, radio bursts
//! and rare inrush. The controller reads it through a power monitor that is polled at 10 Hz, in
//! steps of 10 mW, and held in between.
//!
//! Sources: the command limits and the monitor are those of the published platform (arXiv
//! 2603.13908). *Fitted* to the published figures of its dataset (power 3.65 ± 0.375 W within 3.0
//! to 8.45 W, lag-1 autocorrelation .95 at 30 Hz, velocities alone explain .16) are the magnitudes
//! and time constants of the loads. *Assumed*, with no figure to fit: battery voltage and
//! resistance, the split between the loads, the mission. The plant is for tests and demonstrations;
//! measurements on it are no claims about real robots.
//!
//! The same seed gives the same bits on every machine: only basic arithmetic, square roots and the
//! portable functions of `libm`.

mod electrical;
mod motion;

use crate::monitor::{Measurement, POLL_NS};
use electrical::Electrical;
use joulebus_statistics::noise::Noise;
use motion::Mission;
use thiserror::Error;

const LONGEST_STEP_S: f64 = 1.0;

/// What a controller knows at one control tick: the latest reading of a robot and the command that
/// it has just issued, which holds until the next tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimReading {
    /// Index of the robot in the fleet.
    pub robot: usize,
    /// Commanded linear velocity, m/s, within ±[`V_MAX_MPS`](crate::arena::V_MAX_MPS).
    pub v_mps: f32,
    /// Commanded angular velocity, rad/s, within
    /// ±[`OMEGA_MAX_RADPS`](crate::arena::OMEGA_MAX_RADPS).
    pub omega_radps: f32,
    /// Power of the latest measurement, W, a multiple of 10 mW.
    pub power_w: f32,
    /// Battery voltage of the latest measurement, V.
    pub voltage_v: f32,
    /// Battery current of the latest measurement, A.
    pub current_a: f32,
    /// Whether an earlier tick already returned this measurement.
    pub held: bool,
    /// When it was measured, ns since the plant's start.
    pub measured_ns: u64,
}

/// A fault of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Fault {
    /// A constant additional load, such as a dragging brush.
    ExtraLoad {
        /// Additional power, W.
        power_w: f64,
    },
    /// The monitor repeats its last value indefinitely and marks it as new.
    StuckSensor,
    /// Additional white noise in each measurement.
    Noise {
        /// Standard deviation, W.
        std_w: f64,
    },
}

/// Errors of configuring a plant.
#[derive(Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum PlantError {
    /// A fault for a robot that does not exist.
    #[error("fault for robot {robot}, the fleet has {robots}: allowed are 0 to {robots} - 1")]
    UnknownRobot {
        /// Index given.
        robot: usize,
        /// Number of robots in the fleet.
        robots: usize,
    },
}

/// A fleet of simulated robots.
#[derive(Clone, Debug)]
pub struct Plant {
    robots: Vec<Robot>,
    readings: Vec<SimReading>,
    now_ns: u64,
}

impl Plant {
    /// A fleet at time 0, each robot at rest at its own position. Robot `i` of a seed is the same
    /// whatever the size of the fleet.
    pub fn new(seed: u64, robots: usize) -> Plant {
        let robots: Vec<Robot> = (0..robots)
            .map(|robot| Robot::new(seed, robot as u64))
            .collect();
        let readings = robots
            .iter()
            .enumerate()
            .map(|(i, robot)| robot.reading(i, true))
            .collect();
        Plant {
            robots,
            readings,
            now_ns: 0,
        }
    }

    /// Adds a fault to a robot from a time on, s since the plant's start. A robot can have several.
    ///
    /// # Errors
    /// [`PlantError::UnknownRobot`].
    pub fn with_fault(
        mut self,
        robot: usize,
        fault: Fault,
        from_s: f64,
    ) -> Result<Plant, PlantError> {
        let robots = self.robots.len();
        let Some(faulty) = self.robots.get_mut(robot) else {
            return Err(PlantError::UnknownRobot { robot, robots });
        };
        faulty.faults.push((fault, from_s));
        Ok(self)
    }

    /// Advances time by `dt_s` seconds and returns, per robot in order, the reading that the
    /// controller has just received and the command that it has then issued. A step that is not
    /// positive has no effect, a step beyond one second is clamped to one second.
    pub fn step(&mut self, dt_s: f64) -> &[SimReading] {
        if dt_s > 0.0 {
            let dt_s = dt_s.min(LONGEST_STEP_S);
            let end_ns = self.now_ns + libm::round(dt_s * 1e9) as u64;
            for (i, (robot, reading)) in self.robots.iter_mut().zip(&mut self.readings).enumerate()
            {
                let held = !robot.run(self.now_ns, end_ns);
                robot.mission.issue(dt_s, &mut robot.noise);
                *reading = robot.reading(i, held);
            }
            self.now_ns = end_ns;
        }
        &self.readings
    }

    /// Nanoseconds since the plant's start.
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }
}

#[derive(Clone, Debug)]
struct Robot {
    noise: Noise,
    mission: Mission,
    electrical: Electrical,
    faults: Vec<(Fault, f64)>,
    measured: Measurement,
    measured_ns: u64,
    next_poll_ns: u64,
}

impl Robot {
    fn new(seed: u64, robot: u64) -> Robot {
        let mut noise = Noise::new(seed, robot);
        let mission = Mission::new(&mut noise);
        let electrical = Electrical::new(&mut noise);
        let measured = electrical.measure(0.0, &mut noise);
        let next_poll_ns = (noise.uniform() * POLL_NS as f64) as u64;
        let faults = Vec::new();
        Robot {
            noise,
            mission,
            electrical,
            faults,
            measured,
            measured_ns: 0,
            next_poll_ns,
        }
    }

    /// Simulates the robot under the current command; returns whether the monitor was polled.
    fn run(&mut self, mut now_ns: u64, end_ns: u64) -> bool {
        let mut polled = false;
        while self.next_poll_ns <= end_ns {
            self.advance((self.next_poll_ns - now_ns) as f64 * 1e-9);
            now_ns = self.next_poll_ns;
            self.poll(now_ns);
            polled = true;
            self.next_poll_ns += POLL_NS;
        }
        self.advance((end_ns - now_ns) as f64 * 1e-9);
        polled
    }

    fn advance(&mut self, dt_s: f64) {
        self.mission.drive(dt_s);
        self.electrical
            .advance(dt_s, self.mission.command(), &mut self.noise);
    }

    fn poll(&mut self, now_ns: u64) {
        let mut extra_w = 0.0;
        let mut stuck = false;
        for (fault, from_s) in &self.faults {
            if now_ns as f64 * 1e-9 >= *from_s {
                match fault {
                    Fault::ExtraLoad { power_w } => extra_w += power_w,
                    Fault::Noise { std_w } => extra_w += std_w * self.noise.normal(),
                    Fault::StuckSensor => stuck = true,
                }
            }
        }
        let measured = self.electrical.measure(extra_w, &mut self.noise);
        if !stuck {
            self.measured = measured;
        }
        self.measured_ns = now_ns;
    }

    fn reading(&self, robot: usize, held: bool) -> SimReading {
        let command = self.mission.command();
        SimReading {
            robot,
            v_mps: command.v_mps as f32,
            omega_radps: command.omega_radps as f32,
            power_w: self.measured.power_w as f32,
            voltage_v: self.measured.voltage_v as f32,
            current_a: self.measured.current_a as f32,
            held,
            measured_ns: self.measured_ns,
        }
    }
}
