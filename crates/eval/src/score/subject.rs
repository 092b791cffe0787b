//! What is evaluated.

use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, Platform};

use super::design::Design;
use super::recording::Recording;

/// What is evaluated: one kind of robot, one or more models for it.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// Intake, intervals and alarms of the live path. Its platforms do not count.
    pub settings: &'a FleetSettings,
    /// The kind of robot; `None` takes period and limits from each recording
    /// ([`recorded_platform`](super::recorded_platform)).
    pub platform: Option<&'a Platform>,
    /// The models; the first is the one that the others are compared with.
    pub models: &'a [Model],
    /// The recordings.
    pub recordings: &'a [Recording],
    /// Which rows are evaluated and which the baselines are fitted on.
    pub design: &'a Design,
}
