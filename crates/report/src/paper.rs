//! What the paper gives (arXiv 2603.13908), to stand beside what was measured here.
//!
//! From its abstract, from the README of its repository (y4ssn/robotarium-energy-predictor), and from
//! the statistics of its sections 4 to 6 as this project's task quotes them. The numbers of its
//! figures and tables beyond these could not be read for this work.

/// Mean of all power readings, W.
pub(super) const POWER_MEAN_W: f64 = 3.652;
/// Their standard deviation, W.
pub(super) const POWER_STD_W: f64 = 0.375;
/// The least and the greatest, W.
pub(super) const POWER_RANGE_W: [f64; 2] = [3.0, 8.45];
/// Lag-1 autocorrelation, least and greatest of the six trials.
pub(super) const LAG1: [f64; 2] = [0.942, 0.956];
/// R² of a model of velocities alone.
pub(super) const R2_VELOCITIES: f64 = 0.16;
/// R² of a model of velocities and one past reading.
pub(super) const R2_ONE_LAG: f64 = 0.90;
/// R² of the network, least and greatest of the trials.
pub(super) const R2_TRIALS: [f64; 2] = [0.89, 0.92];
/// R² of the network on trial 5, which decided when to stop.
pub(super) const R2_VALIDATION: f64 = 0.90;
/// Its mean absolute error there, W.
pub(super) const MAE_VALIDATION_W: f64 = 0.0373;
/// R² of the network on trial 6.
pub(super) const R2_TRIAL_6: f64 = 0.92;
/// Its mean absolute error there, W.
pub(super) const MAE_TRIAL_6_W: f64 = 0.0315;
/// Mean of the residuals there, W.
pub(super) const RESIDUAL_MEAN_W: f64 = 0.0013;
/// What holds 90 % of the residuals there, W.
pub(super) const RESIDUAL_90_W: [f64; 2] = [-0.047, 0.050];
/// R² over the seven robots: mean and standard deviation.
pub(super) const R2_ROBOTS: [f64; 2] = [0.87, 0.018];
/// Mean absolute error over the seven robots, W.
pub(super) const MAE_ROBOTS_W: f64 = 0.0707;
/// The robots that drew more than the rest.
pub(super) const HUNGRY_ROBOTS: [u32; 4] = [1, 2, 3, 6];
/// Error of the energy of each robot, share: all stay below.
pub(super) const ENERGY_ERROR_ALL: f64 = 0.023;
/// Error of the energy, share: four of the seven stay below.
pub(super) const ENERGY_ERROR_FOUR: f64 = 0.001;
