//! Electrical loads of the robots, and the power monitor's output.

use crate::arena::{Command, wheels_mps};
use crate::loads::drifted;
use crate::monitor::{Measurement, POWER_STEP_W, stepped, voltage_v};
use joulebus_statistics::noise::Noise;

// Electronics, with manufacturing variation between robots (fitted).
const ELECTRONICS_W: f64 = 3.15;
const ELECTRONICS_SPREAD_W: f64 = 0.07;
// Regulators and motors warming up and cooling down (fitted).
const THERMAL_MEAN_W: f64 = 0.16;
const THERMAL_TIME_S: f64 = 50.0;
// The processor's variable load (fitted).
const PROCESSOR_MEAN_W: f64 = 0.14;
const PROCESSOR_TIME_S: f64 = 5.0;
// Each motor: rolling friction, losses that grow with speed, and acceleration (fitted).
const FRICTION_W_PER_MPS: f64 = 0.75;
const FRICTION_SPREAD: f64 = 0.15;
const LOSSES_W_PER_MPS2: f64 = 2.0;
const ACCELERATION_W_PER_M2PS3: f64 = 2.0;
const MOTOR_TIME_S: f64 = 0.08;
// Radio bursts (fitted).
const BURST_EVERY_S: f64 = 1.2;
const BURST_LENGTH_S: f64 = 0.08;
const BURST_W: (f64, f64) = (0.2, 0.7);
// Inrush: rare and large (fitted to the largest published reading).
const INRUSH_EVERY_S: f64 = 120.0;
const INRUSH_LENGTH_S: f64 = 0.12;
const INRUSH_W: (f64, f64) = (1.0, 3.9);
// Monitor: INA260.
const MONITOR_NOISE_W: f64 = 0.01;

/// The electrical state of one robot.
#[derive(Clone, Debug)]
pub(super) struct Electrical {
    electronics_w: f64,
    friction: f64,
    thermal: f64,
    processor: f64,
    wheels_mps: [f64; 2],
    motors_w: f64,
    burst: Burst,
    inrush: Burst,
    drawn_j: f64,
}

impl Electrical {
    pub(super) fn new(noise: &mut Noise) -> Electrical {
        Electrical {
            electronics_w: ELECTRONICS_W + ELECTRONICS_SPREAD_W * noise.normal().clamp(-2.5, 2.5),
            friction: 1.0 + FRICTION_SPREAD * noise.normal().clamp(-2.5, 2.5),
            thermal: noise.normal(),
            processor: noise.normal(),
            wheels_mps: [0.0; 2],
            motors_w: 0.0,
            burst: Burst::new(BURST_EVERY_S, BURST_LENGTH_S, BURST_W, noise),
            inrush: Burst::new(INRUSH_EVERY_S, INRUSH_LENGTH_S, INRUSH_W, noise),
            drawn_j: 0.0,
        }
    }

    pub(super) fn advance(&mut self, dt_s: f64, command: Command, noise: &mut Noise) {
        if dt_s <= 0.0 {
            return;
        }
        self.thermal = drifted(self.thermal, libm::exp(-dt_s / THERMAL_TIME_S), noise);
        self.processor = drifted(self.processor, libm::exp(-dt_s / PROCESSOR_TIME_S), noise);
        self.turn_wheels(dt_s, command);
        self.burst.advance(dt_s, noise);
        self.inrush.advance(dt_s, noise);
        self.drawn_j += self.power_w() * dt_s;
    }

    fn turn_wheels(&mut self, dt_s: f64, command: Command) {
        let reached = 1.0 - libm::exp(-dt_s / MOTOR_TIME_S);
        self.motors_w = 0.0;
        for (wheel_mps, wanted_mps) in self.wheels_mps.iter_mut().zip(wheels_mps(command)) {
            let change_mps = (wanted_mps - *wheel_mps) * reached;
            *wheel_mps += change_mps;
            let speed_mps = wheel_mps.abs();
            let rolling_w =
                FRICTION_W_PER_MPS * speed_mps + LOSSES_W_PER_MPS2 * speed_mps * speed_mps;
            let speeding_up = *wheel_mps * change_mps / dt_s;
            self.motors_w +=
                self.friction * rolling_w + ACCELERATION_W_PER_M2PS3 * speeding_up.max(0.0);
        }
    }

    /// A drifting load is the square of a drift times its mean: never negative, with a long tail,
    /// like the published readings.
    fn power_w(&self) -> f64 {
        self.electronics_w
            + THERMAL_MEAN_W * self.thermal * self.thermal
            + PROCESSOR_MEAN_W * self.processor * self.processor
            + self.motors_w
            + self.burst.power_w
            + self.inrush.power_w
    }

    /// The monitor's reading, with an additional load.
    pub(super) fn measure(&self, extra_w: f64, noise: &mut Noise) -> Measurement {
        let shown_w = self.power_w() + extra_w + MONITOR_NOISE_W * noise.normal();
        let power_w = stepped(shown_w.max(0.0), POWER_STEP_W);
        let voltage_v = voltage_v(self.drawn_j, power_w);
        Measurement {
            power_w,
            voltage_v,
            current_a: power_w / voltage_v,
        }
    }
}

/// An intermittent load.
#[derive(Clone, Debug)]
struct Burst {
    every_s: f64,
    length_s: f64,
    range_w: (f64, f64),
    left_s: f64,
    power_w: f64,
}

impl Burst {
    fn new(every_s: f64, length_s: f64, range_w: (f64, f64), noise: &mut Noise) -> Burst {
        Burst {
            every_s,
            length_s,
            range_w,
            left_s: noise.waiting_s(every_s),
            power_w: 0.0,
        }
    }

    fn advance(&mut self, dt_s: f64, noise: &mut Noise) {
        self.left_s -= dt_s;
        while self.left_s <= 0.0 {
            if self.power_w > 0.0 {
                self.power_w = 0.0;
                self.left_s += noise.waiting_s(self.every_s);
            } else {
                self.power_w = noise.between(self.range_w.0, self.range_w.1);
                self.left_s += noise.waiting_s(self.length_s);
            }
        }
    }
}
