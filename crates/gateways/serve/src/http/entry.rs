//! The newest rows of one robot in a snapshot.

use std::sync::{Arc, OnceLock};

use joulebus_board::Newest;
use joulebus_wire::forecast_flag;
use serde_json::{Map, Value};

pub(super) type Object = Map<String, Value>;

/// The newest rows of one robot.
#[derive(Debug)]
pub(super) struct Entry {
    pub(super) robot: u32,
    /// Place in the names of platforms.
    pub(super) platform: Option<usize>,
    pub(super) newest: Newest,
    /// Energy consumed according to the ledgers seen by this program, µJ. It never falls.
    pub(super) consumed_uj: Option<u64>,
    /// Its JSON record, made on first use.
    pub(super) record: OnceLock<Arc<Object>>,
}

impl Entry {
    /// Time since the stamp of its newest sample, ns. `None` before the first sample.
    pub(super) fn sample_age_ns(&self, now_ns: u64) -> Option<u64> {
        let forecast = &self.newest.forecast;
        let sampled = forecast.flags & forecast_flag::SAMPLE != 0;
        sampled.then(|| now_ns.saturating_sub(forecast.stamp_ns))
    }
}
