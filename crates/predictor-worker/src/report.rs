//! Report of a run of the worker.

use std::collections::BTreeMap;

use joulebus_fleet::Stage;
use joulebus_latency::Spread;
use joulebus_wire::DropCounts;
use serde::Serialize;

use crate::tick_pool::StageTimes;

/// Report of a run of the worker.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Name of the fleet.
    pub fleet: String,
    /// Ticks done.
    pub ticks: u64,
    /// Ticks skipped because the one before took too long.
    pub ticks_skipped: u64,
    /// Ticks that started more than a tenth of a period late.
    pub ticks_late: u64,
    /// Ticks without diagnostics because ticks took too long.
    pub ticks_without_diagnostics: u64,
    /// Robots in the fleet at the end.
    pub robots: usize,
    /// Samples accepted.
    pub samples_accepted: u64,
    /// Samples dropped, by reason.
    pub samples_dropped: BTreeMap<&'static str, u64>,
    /// Frames that could not be sent.
    pub frames_unsent: u64,
    /// Failures to receive.
    pub receive_errors: u64,
    /// The last attempt to save the ledger failed: metering since the previous save is lost at the
    /// end.
    pub ledger_unsaved: bool,
    /// Time from the start of a tick until its last frame is sent.
    pub tick: Spread,
    /// Mean time of each stage.
    pub parts: Parts,
}

/// Mean time of each stage of a tick, over the ticks of a run, µs, summed over the threads that
/// share a tick.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Parts {
    /// Frames copied and samples checked, before the tick begins.
    pub intake_us: f64,
    /// Samples taken in, windows and intervals advanced, features laid out in columns.
    pub features_us: f64,
    /// The model.
    pub network_us: f64,
    /// Ledgers, scores, residuals and alarms.
    pub bookkeeping_us: f64,
    /// Forecasts, diagnostics, budgets and plan states written into shared memory.
    pub writing_us: f64,
}

impl Parts {
    pub(crate) fn new(ticks: u64, intake_ns: u64, spent: StageTimes) -> Self {
        let mean_us = |ns: u64| ns as f64 * 1e-3 / ticks.max(1) as f64;
        let of = |stage: Stage| mean_us(spent.0[stage as usize]);
        Self {
            intake_us: mean_us(intake_ns),
            features_us: of(Stage::Features),
            network_us: of(Stage::Network),
            bookkeeping_us: of(Stage::Bookkeeping),
            writing_us: of(Stage::Writing),
        }
    }
}

/// Drops by the name of their reason.
pub(crate) fn by_name(drops: &DropCounts) -> BTreeMap<&'static str, u64> {
    drops.iter().map(|(reason, count)| (reason.name(), count)).collect()
}
