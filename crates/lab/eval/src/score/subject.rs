//! Inputs of an evaluation.

use joulebus_predictor::Model;
use joulebus_settings::{FleetSettings, Platform};

use super::design::Design;
use super::recording::Recording;

/// Inputs of an evaluation: one platform, one or more models for it, recordings.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// Ingest, intervals and alarms of the live path. Its platforms are ignored.
    pub settings: &'a FleetSettings,
    /// The platform. `None` takes period and limits from each recording
    /// ([`recorded_platform`](super::recorded_platform)).
    pub platform: Option<&'a Platform>,
    /// The models. The others are compared with the first.
    pub models: &'a [Model],
    /// The recordings.
    pub recordings: &'a [Recording],
    /// The rows to evaluate, and the rows to fit the baselines on.
    pub design: &'a Design,
}
