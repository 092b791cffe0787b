//! The battery, and the power monitor that the controller reads.
//!
//! The monitor is an INA260 (power in steps of 10 mW, voltage of 1.25 mV, current of 1.25 mA),
//! polled at 10 Hz on its own clock. Between polls its last reading is repeated.

/// Poll period, s.
pub(super) const POLL_S: f64 = 0.1;
/// Poll period, ns.
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
pub struct Measurement {
    /// Power, W.
    pub power_w: f64,
    /// Terminal voltage, V.
    pub voltage_v: f64,
    /// Current, A.
    pub current_a: f64,
}

/// A discharging battery.
#[derive(Clone, Copy, Debug)]
pub(super) struct Battery {
    drawn_j: f64,
}

impl Battery {
    /// A battery from which `drawn_j` joules have been drawn.
    pub(super) const fn new(drawn_j: f64) -> Self {
        Self { drawn_j }
    }

    /// Energy drawn from it, J.
    pub(super) const fn drawn_j(&self) -> f64 {
        self.drawn_j
    }

    /// Draws `power_w` for one poll period, and returns the monitor's reading of `shown_w`.
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

/// The terminal voltage, the solution of u = open − R·P/u, after `drawn_j` have been drawn. A load
/// beyond the cell's maximum gets the voltage at that maximum.
pub(super) fn voltage_v(drawn_j: f64, power_w: f64) -> f64 {
    let open_v = (FULL_V - FALL_V_PER_J * drawn_j).max(EMPTY_V);
    let left = (open_v * open_v - 4.0 * RESISTANCE_OHM * power_w).max(0.0);
    (open_v + libm::sqrt(left)) / 2.0
}

/// `value` quantised to whole steps, as by the monitor's converter.
pub(super) fn stepped(value: f64, step: f64) -> f64 {
    libm::round(value / step) * step
}
