//! Simulated GTernal robots: what they are told to do and the electrical power that they draw.
//!
//! A robot's power is the sum of named parts (the constants of `electrical.rs`):
//! electronics with a spread from manufacturing, slow thermal drift, processor load, motors with
//! friction, radio bursts and rare inrush. What the controller sees of it passes through a power
//! monitor that is polled at 10 Hz, in steps of 10 mW, and held in between.
//!
//! Sources: the limits of command and the monitor are those of the published platform (arXiv
//! 2603.13908). *Fitted* to the published figures of its dataset (power 3.65 ± 0.375 W within 3.0 to
//! 8.45 W, lag-1 autocorrelation .95 at 30 Hz, velocities alone explain .16) are the sizes and time
//! constants of the parts. *Assumed*, with no figure to fit: battery voltage and resistance, the
//! split between the parts, the mission. It is a plant for tests and demonstrations; nothing
//! measured on it is a claim about real robots.
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

/// What a controller has in hand at one control tick: the latest reading of a robot and the command
/// that it has just issued to it, which is in force until the next tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimReading {
    /// Position of the robot in the fleet.
    pub robot: usize,
    /// Linear velocity just commanded, in m/s, within ±[`V_MAX_MPS`](crate::arena::V_MAX_MPS).
    pub v_mps: f32,
    /// Angular velocity just commanded, in rad/s, within ±[`OMEGA_MAX_RADPS`](crate::arena::OMEGA_MAX_RADPS).
    pub omega_radps: f32,
    /// Power of the latest measurement in watt, a multiple of 10 mW.
    pub power_w: f32,
    /// Battery voltage of the latest measurement in volt.
    pub voltage_v: f32,
    /// Battery current of the latest measurement in ampere.
    pub current_a: f32,
    /// Whether the measurement was already returned at an earlier tick.
    pub held: bool,
    /// When it was measured, in nanoseconds since the plant's start.
    pub measured_ns: u64,
}

/// Something that makes a robot stand out.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Fault {
    /// A constant load on top, such as a dragging brush, in watt.
    ExtraLoad {
        /// Additional power in watt.
        power_w: f64,
    },
    /// The monitor returns its last value indefinitely and calls it new.
    StuckSensor,
    /// Additional white noise of each measurement.
    Noise {
        /// Standard deviation in watt.
        std_w: f64,
    },
}

/// Why a plant can't be set up as asked.
#[derive(Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum PlantError {
    /// A fault was meant for a robot that does not exist.
    #[error("fault for robot {robot}, the fleet has {robots}: allowed are 0 to {robots} - 1")]
    UnknownRobot {
        /// Robot asked for.
        robot: usize,
        /// Robots of the fleet.
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
    /// A fleet at time 0, each robot waiting at a place of its own. Robot `i` of a seed is the same
    /// robot whatever the size of the fleet.
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

    /// Gives a robot a fault from a time on, in seconds since the plant's start. A robot can have
    /// several.
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

    /// Lets `dt_s` seconds pass and returns, per robot in order, the reading that the controller has
    /// just received and the command that it has then issued. A step that is not positive changes
    /// nothing, a step beyond one second counts as one second.
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

    /// Runs the robot under the command in force; whether the monitor was polled on the way.
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
