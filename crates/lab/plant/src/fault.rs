//! Faults of simulated robots.

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
