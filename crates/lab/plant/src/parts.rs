//! Physical parameters of a simulated robot: its loads, and the variation between robots.

/// Magnitudes and time constants of the loads of a robot. [`Parts::default`] is the fit to the
/// published figures (`docs/measured/plant.md` states which were fitted and which only checked).
/// Other values are for what-if runs and for the fit itself.
///
/// A *drift* below is a mean-reverting process of mean 0 and deviation 1 with a time constant. All
/// powers are electrical, at the battery.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parts {
    /// Constant power of the electronics (computer, sensors, regulators), W, above 0.
    pub electronics_w: f64,
    /// Standard deviation of the electronics' power between robots (manufacturing), W.
    pub electronics_spread_w: f64,
    /// Standard deviation of the regulators' slow drift, W.
    pub drift_w: f64,
    /// Time constant of the regulators' drift, s.
    pub drift_time_s: f64,
    /// Mean of the processor's variable load, W: the square of a drift times this.
    pub processor_w: f64,
    /// Time constant of the processor's load, s.
    pub processor_time_s: f64,
    /// Coulomb friction of each wheel: power per speed, W/(m/s).
    pub friction_w_per_mps: f64,
    /// Losses of each motor that grow with the square of the wheel's speed, W/(m/s)².
    pub losses_w_per_m2ps2: f64,
    /// Power of each motor per rate of change of its wheel's squared speed, W/(m²/s³).
    pub acceleration_w_per_m2ps3: f64,
    /// Relative standard deviation of friction and losses between wheels (manufacturing).
    pub friction_spread: f64,
    /// Relative standard deviation of a robot's friction over time: dust, floor seams.
    pub roughness: f64,
    /// Time constant of the roughness, s.
    pub roughness_time_s: f64,
    /// Time constant of a wheel's response to a command, s, above 0.
    pub motor_time_s: f64,
    /// Thermal memory: additional power per motor power of the recent past, W/W.
    pub thermal_share: f64,
    /// Time constant of the thermal memory, s.
    pub thermal_time_s: f64,
    /// Radio bursts per second of a robot alone on the channel.
    pub bursts_per_s: f64,
    /// Additional bursts per second for each other robot on the channel.
    pub bursts_per_neighbour_s: f64,
    /// Mean power of a burst, W. Exponentially distributed.
    pub burst_w: f64,
    /// Mean length of a burst of a robot alone on the channel, s. Exponentially distributed.
    pub burst_time_s: f64,
    /// Shortening of bursts by other robots on the channel: with n of them the mean length of a
    /// single robot's bursts is divided by 1 + n times this.
    pub burst_cut_per_neighbour: f64,
    /// Probability that a wheel stalls when it starts from rest, 0 to 1.
    pub stall_chance: f64,
    /// Power of a stalled motor until it breaks free, at the next poll, W.
    pub stall_w: f64,
    /// White noise of the monitor, standard deviation, W.
    pub monitor_noise_w: f64,
}

impl Default for Parts {
    fn default() -> Self {
        Self {
            electronics_w: 3.23,
            electronics_spread_w: 0.03,
            drift_w: 0.08,
            drift_time_s: 30.0,
            processor_w: 0.07,
            processor_time_s: 15.0,
            friction_w_per_mps: 0.86,
            losses_w_per_m2ps2: 2.0,
            acceleration_w_per_m2ps3: 2.0,
            friction_spread: 0.1,
            roughness: 0.05,
            roughness_time_s: 0.4,
            motor_time_s: 0.08,
            thermal_share: 0.3,
            thermal_time_s: 40.0,
            bursts_per_s: 0.59,
            bursts_per_neighbour_s: 0.13,
            burst_w: 0.41,
            burst_time_s: 0.46,
            burst_cut_per_neighbour: 0.02,
            stall_chance: 0.005,
            stall_w: 4.6,
            monitor_noise_w: 0.008,
        }
    }
}
