//! The battery, and the power monitor through which a controller sees the robot's draw.
//!
//! The monitor is an INA260 (power in steps of 10 mW, voltage of 1.25 mV, current of 1.25 mA),
//! polled at 10 Hz by a clock of its own; in between its last reading is returned again.

/// Time between two polls, s.
pub(super) const POLL_S: f64 = 0.1;
/// Time between two polls, ns.
pub(super) const POLL_NS: u64 = 100_000_000;

pub(super) const POWER_STEP_W: f64 = 0.01;
const VOLTAGE_STEP_V: f64 = 1.25e-3;
const CURRENT_STEP_A: f64 = 1.25e-3;

// One lithium cell and its wiring (assumed).
const FULL_V: f64 = 4.1;
const FALL_V_PER_J: f64 = 2.5e-5;
const EMPTY_V: f64 = 3.3;
const RESISTANCE_OHM: f64 = 0.09;

/// One reading of the power monitor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Measurement {
    pub(super) power_w: f64,
    pub(super) voltage_v: f64,
    pub(super) current_a: f64,
}

/// A battery that is being emptied.
#[derive(Clone, Copy, Debug)]
pub(super) struct Battery {
    drawn_j: f64,
}

impl Battery {
    /// A battery from which `drawn_j` joules have been taken.
    pub(super) const fn new(drawn_j: f64) -> Self {
        Self { drawn_j }
    }

    /// Takes `power_w` for the time of a poll, and returns what the monitor shows of `shown_w`.
    pub(super) fn measure(&mut self, power_w: f64, shown_w: f64) -> Measurement {
        self.drawn_j += power_w * POLL_S;
        let shown_w = shown_w.max(0.0);
        let voltage_v = voltage_v(self.drawn_j, shown_w);
        Measurement {
            power_w: stepped(shown_w, POWER_STEP_W),
            voltage_v: stepped(voltage_v, VOLTAGE_STEP_V),
            current_a: stepped(shown_w / voltage_v, CURRENT_STEP_A),
        }
    }
}

/// The voltage at which cell and load agree, u = open - R·P/u, after `drawn_j` have been taken. A load
/// beyond what the cell can give gets the voltage of the largest possible one.
pub(super) fn voltage_v(drawn_j: f64, power_w: f64) -> f64 {
    let open_v = (FULL_V - FALL_V_PER_J * drawn_j).max(EMPTY_V);
    let left = (open_v * open_v - 4.0 * RESISTANCE_OHM * power_w).max(0.0);
    (open_v + libm::sqrt(left)) / 2.0
}

/// `value` in whole steps, as the monitor's converter gives it.
pub(super) fn stepped(value: f64, step: f64) -> f64 {
    libm::round(value / step) * step
}
