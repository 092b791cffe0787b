//! The request of a calibration, and why it cannot be met.

use joulebus_settings::SettingsError;

/// The requested rate and its conditions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Request {
    /// False alarms of the fleet, an hour, all residual alarms of all robots together, above 0.
    pub fleet_per_h: f64,
    /// Robots of the fleet, above 0.
    pub robots: u32,
    /// Level of the bounds, above 0 and below 1.
    pub confidence: f64,
    /// True if limits may be extrapolated beyond the recordings.
    pub extrapolate: bool,
}

impl Request {
    /// False alarms that a robot may raise an hour.
    pub(super) fn per_robot_h(&self) -> f64 {
        self.fleet_per_h / f64::from(self.robots)
    }
}

/// Errors of calibrating.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The messages name the fields.
pub enum CalibrateError {
    #[error(
        "{found} recording of at most ten minutes: at least 2 are needed, one to choose limits on and one to \
         state their rate on"
    )]
    Recordings { found: usize },
    #[error(
        "the recordings of the half that states the rate are so short that no reading of them was scored: give longer \
         ones, or more"
    )]
    Unscored,
    #[error(
        "{hours:.2} robot-hours (half of the recordings) cannot show a rate below {at_best:.3} false \
         alarms a robot-hour at {:.0} %, which is {:.1} a day for {robots} robots. Asked for are \
         {wanted:.3e} a robot-hour. Record {needed_h:.1} robot-hours in which no alarm is raised, \
         ask for more alarms, or allow limits that are not shown (--extrapolate)",
        100.0 * confidence,
        at_best * f64::from(*robots) * 24.0
    )]
    Hours { hours: f64, at_best: f64, wanted: f64, needed_h: f64, robots: u32, confidence: f64 },
    #[error(
        "{alarms} alarms in {hours:.2} robot-hours at the greatest limits, at most {at_most:.3} a robot-hour, and \
         {wanted:.3e} are asked for: are the recordings healthy, and the model trained for this robot?"
    )]
    Alarms {
        alarms: u64,
        hours: f64,
        /// Their bound.
        at_most: f64,
        wanted: f64,
    },
    #[error(
        "{key}: {reached} recordings reach the tail, which leaves {rate:.3e} false alarms a \
            robot-hour at the greatest limit, {greatest}. Allowed are {wanted:.3e}: give more \
            recordings, or ask for a higher rate"
    )]
    Tail { key: &'static str, reached: u64, greatest: f64, rate: f64, wanted: f64 },
    #[error(
        "{key}: {found} recordings of the half that states the rate go beyond {limit}, and the tail of the others \
         expects at most {expected:.2}: the tail does not hold. Give more recordings"
    )]
    Refuted { key: &'static str, limit: f64, expected: f64, found: u64 },
    #[error(transparent)]
    Settings(#[from] SettingsError),
}
