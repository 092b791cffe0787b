//! Latency from a sample to its forecast by stage, from the timestamps in the headers.

use std::fmt;

use hdrhistogram::Histogram;
use joulebus_predictor_worker::Spread;
use joulebus_wire::ForecastHeader;
use serde::{Deserialize, Serialize};

/// Upper bound of the histograms, ns.
const LONGEST_NS: u64 = 60_000_000_000;

/// Distributions of the stages, one value per frame that answers samples.
#[derive(Debug, Clone)]
pub(crate) struct Stages {
    total: Histogram<u64>,
    parts: [Histogram<u64>; 5],
}

impl Stages {
    /// Empty distributions.
    ///
    /// # Errors
    /// Never: the bounds are fixed.
    pub(crate) fn new() -> Result<Self, hdrhistogram::CreationError> {
        let empty = Histogram::new_with_bounds(1, LONGEST_NS, 3)?;
        Ok(Self {
            total: empty.clone(),
            parts: std::array::from_fn(|_| empty.clone()),
        })
    }

    /// Adds a frame that became readable at `readable_ns` (monotonic). Returns the total latency
    /// from the first sample sent, ns; none if the frame answers no sample.
    pub(crate) fn observe(&mut self, header: &ForecastHeader, readable_ns: u64) -> Option<u64> {
        if header.first_sent_ns == 0 {
            return None;
        }
        let stamps = [
            header.first_sent_ns,
            header.first_taken_ns,
            header.compute_start_ns,
            header.compute_end_ns,
            header.sent_ns,
            readable_ns,
        ];
        for (part, ends) in self.parts.iter_mut().zip(stamps.windows(2)) {
            part.saturating_record(ends[1].saturating_sub(ends[0]));
        }
        let total_ns = readable_ns.saturating_sub(header.first_sent_ns);
        self.total.saturating_record(total_ns);
        Some(total_ns)
    }

    /// The distributions.
    pub(crate) fn latency(&self) -> Latency {
        let [
            sent_to_taken,
            taken_to_compute,
            compute,
            compute_to_sent,
            sent_to_readable,
        ] = self.parts.each_ref().map(Spread::of);
        Latency {
            total: Spread::of(&self.total),
            sent_to_taken,
            taken_to_compute,
            compute,
            compute_to_sent,
            sent_to_readable,
        }
    }
}

/// Latency from a sample sent to its forecast readable by a planner, and its stages.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Latency {
    /// The total.
    pub(crate) total: Spread,
    /// First sample of the tick sent → received by the worker.
    pub(crate) sent_to_taken: Spread,
    /// Received → tick starts computing: waiting for the rest of the fleet.
    pub(crate) taken_to_compute: Spread,
    /// Computation of the tick.
    pub(crate) compute: Spread,
    /// Computed → sent by the worker.
    pub(crate) compute_to_sent: Spread,
    /// Sent by the worker → readable: wake-up of the planner.
    pub(crate) sent_to_readable: Spread,
}

impl Latency {
    /// The stages in order, with their labels.
    pub(crate) const fn stages(&self) -> [(&'static str, Spread); 6] {
        [
            ("sent → taken", self.sent_to_taken),
            ("taken → compute", self.taken_to_compute),
            ("compute", self.compute),
            ("compute → sent", self.compute_to_sent),
            ("sent → readable", self.sent_to_readable),
            ("sample → forecast", self.total),
        ]
    }
}

/// The stages as a table, µs.
impl fmt::Display for Latency {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [name, p50, p99, p999, max] = ["", "p50", "p99", "p99.9", "max"];
        writeln!(out, "  {name:<18}{p50:>10}{p99:>10}{p999:>10}{max:>10}  µs")?;
        for (name, spread) in self.stages() {
            let us = [spread.p50_us, spread.p99_us, spread.p999_us, spread.max_us];
            write!(out, "  {name:<18}")?;
            for us in us {
                write!(out, "{us:>10.1}")?;
            }
            writeln!(out)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_add_up_to_the_total_and_frames_without_samples_are_excluded() {
        let mut stages = Stages::new().unwrap();
        let header = ForecastHeader {
            first_sent_ns: 1_000,
            first_taken_ns: 9_000,
            compute_start_ns: 10_000,
            compute_end_ns: 30_000,
            sent_ns: 31_000,
            ..ForecastHeader::default()
        };
        assert_eq!(stages.observe(&header, 71_000), Some(70_000));
        let silent = ForecastHeader {
            first_sent_ns: 0,
            ..header
        };
        assert_eq!(stages.observe(&silent, 71_000), None);
        let latency = stages.latency();
        let parts: Vec<f64> = latency
            .stages()
            .iter()
            .map(|(_, s)| s.max_us.round())
            .collect();
        assert_eq!(parts, [8.0, 1.0, 20.0, 1.0, 40.0, 70.0]);
        assert!(latency.stages().iter().all(|(_, spread)| spread.count == 1));
    }
}
