//! Final report of a link's threads.

use serde::Serialize;

use crate::protocol::receiver::Received;
use crate::protocol::stream::Sent;
use crate::refusals::Refusals;

/// The part of the report from one thread, or from all.
#[derive(Debug, Default)]
pub(crate) struct Done {
    pub(crate) given: Vec<EgressRecord>,
    pub(crate) taken: Vec<IngressRecord>,
    /// Refused requests, by reason.
    pub(crate) refused: Refusals,
}

/// Totals of the frames sent to one link.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct EgressRecord {
    pub(crate) to: String,
    #[serde(flatten)]
    pub(crate) sent: Sent,
}

/// Totals of the frames received from one link.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct IngressRecord {
    pub(crate) from: String,
    #[serde(flatten)]
    pub(crate) received: Received,
    /// Frames that arrived before the clock offset was known.
    pub(crate) before_clock: u64,
    /// Frames of an earlier leader, dropped after another has led.
    pub(crate) fenced: u64,
    /// Upper bound of how much older stamps may look than they are, s. Null before the clock offset
    /// is known.
    pub(crate) clock_uncertainty_s: Option<f64>,
    /// Number of changes of the clock offset in use.
    pub(crate) clock_refits: u64,
    /// Number of clock steps.
    pub(crate) clock_steps: u64,
    pub(crate) refused: Refusals,
}
