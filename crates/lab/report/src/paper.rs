//! The paper's numbers (arXiv 2603.13908), for comparison.
//!
//! From its full text.

/// Mean of all power readings, W.
pub(super) const POWER_MEAN_W: f64 = 3.652;
/// Standard deviation of all power readings, W.
pub(super) const POWER_STD_W: f64 = 0.375;
/// Minimum and maximum of all power readings, W.
pub(super) const POWER_RANGE_W: [f64; 2] = [3.0, 8.45];
/// Lag-1 autocorrelation, minimum and maximum of the six trials.
pub(super) const LAG1: [f64; 2] = [0.942, 0.956];
/// R² of a model of velocities alone.
pub(super) const R2_VELOCITIES: f64 = 0.16;
/// R² of a model of velocities and one past reading.
pub(super) const R2_ONE_LAG: f64 = 0.90;
/// R² of the network, minimum and maximum of the trials.
pub(super) const R2_TRIALS: [f64; 2] = [0.89, 0.92];
/// R² of the network, mean of the six trials.
pub(super) const R2_TRIALS_MEAN: f64 = 0.90;
/// R² of the network on trial 6.
pub(super) const R2_TRIAL_6: f64 = 0.92;
/// Its mean absolute error there, W.
pub(super) const MAE_TRIAL_6_W: f64 = 0.0315;
/// Mean of the residuals of all trials, W.
pub(super) const RESIDUAL_MEAN_W: f64 = 0.0013;
/// Central 90 % of the residuals of all trials, W.
pub(super) const RESIDUAL_90_W: [f64; 2] = [-0.047, 0.050];
/// R² over the seven robots: mean and standard deviation.
pub(super) const R2_ROBOTS: [f64; 2] = [0.87, 0.018];
/// Mean absolute error over the seven robots, W.
pub(super) const MAE_ROBOTS_W: f64 = 0.0707;
/// The robots with the highest consumption.
pub(super) const HUNGRY_ROBOTS: [u32; 4] = [1, 2, 3, 6];
/// Upper bound of the relative energy error of each robot.
pub(super) const MAX_ENERGY_ERROR_ALL: f64 = 0.023;
/// Upper bound of the relative energy error of four of the seven.
pub(super) const MAX_ENERGY_ERROR_FOUR: f64 = 0.001;
