//! Latency from a sample to its forecast by stage, from the timestamps in the headers.

use std::fmt;

use hdrhistogram::Histogram;
use joulebus_latency::{Spread, histogram};
use joulebus_wire::ForecastHeader;
use serde::{Deserialize, Serialize};

/// Upper bounds of [`Counted::counts`], s. The last count is of longer times.
pub const UPPER_S: [f64; 16] = [
    0.000_025, 0.000_05, 0.000_1, 0.000_2, 0.000_5, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1,
    0.2, 0.5, 1.0, 10.0,
];

/// Times in few classes, which may be added up over runs and hosts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counted {
    /// Number of times up to each of [`UPPER_S`] and above the previous bound, and of times above
    /// all.
    pub counts: [u64; UPPER_S.len() + 1],
    /// Their sum, ns.
    pub sum_ns: u64,
}

impl Counted {
    fn add(&mut self, time_ns: u64) {
        let time_s = time_ns as f64 * 1e-9;
        self.counts[UPPER_S.partition_point(|upper_s| *upper_s < time_s)] += 1;
        self.sum_ns = self.sum_ns.saturating_add(time_ns);
    }
}

/// Distributions of the stages, one value per frame that answers samples.
#[derive(Debug, Clone)]
pub struct Stages {
    total: Histogram<u64>,
    parts: [Histogram<u64>; 5],
    /// Time from sending a sample until its forecast is readable.
    pub total_counted: Counted,
    /// Computation of the tick.
    pub compute_counted: Counted,
}

impl Default for Stages {
    fn default() -> Self {
        let empty = histogram();
        Self {
            total: empty.clone(),
            parts: std::array::from_fn(|_| empty.clone()),
            total_counted: Counted::default(),
            compute_counted: Counted::default(),
        }
    }
}

impl Stages {
    /// Adds a frame that became readable at `readable_ns` (monotonic). Returns the total latency
    /// from the first sample sent, ns, or `None` if the frame answers no sample.
    pub fn observe(&mut self, header: &ForecastHeader, readable_ns: u64) -> Option<u64> {
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
        self.total_counted.add(total_ns);
        let compute_ns = header.compute_end_ns.saturating_sub(header.compute_start_ns);
        self.compute_counted.add(compute_ns);
        Some(total_ns)
    }

    /// The distributions.
    pub fn latency(&self) -> Latency {
        let [sent_to_taken, taken_to_compute, compute, compute_to_sent, sent_to_readable] =
            self.parts.each_ref().map(Spread::new);
        Latency {
            total: Spread::new(&self.total),
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
pub struct Latency {
    /// The total.
    pub total: Spread,
    /// First sample of the tick sent → received by the worker.
    pub sent_to_taken: Spread,
    /// Received → tick starts computing: waiting for the rest of the fleet.
    pub taken_to_compute: Spread,
    /// Computation of the tick.
    pub compute: Spread,
    /// Computed → sent by the worker.
    pub compute_to_sent: Spread,
    /// Sent by the worker → readable: wake-up of the planner.
    pub sent_to_readable: Spread,
}

impl Latency {
    /// The stages in order, with their labels.
    pub const fn stages(&self) -> [(&'static str, Spread); 6] {
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
    fn every_time_is_in_the_class_below_whose_bound_it_lies() {
        let mut counted = Counted::default();
        for time_ns in [0, 25_000, 25_001, 10_000_000_000, 10_000_000_001, u64::MAX] {
            counted.add(time_ns);
        }
        assert_eq!((counted.counts[0], counted.counts[1]), (2, 1));
        assert_eq!((counted.counts[15], counted.counts[16]), (1, 2));
        assert_eq!(counted.counts.iter().sum::<u64>(), 6);
        assert_eq!(counted.sum_ns, u64::MAX);
        assert!(UPPER_S.is_sorted());
    }

    #[test]
    fn stages_add_up_to_the_total_and_frames_without_samples_are_excluded() {
        let mut stages = Stages::default();
        let header = ForecastHeader {
            first_sent_ns: 1_000,
            first_taken_ns: 9_000,
            compute_start_ns: 10_000,
            compute_end_ns: 30_000,
            sent_ns: 31_000,
            ..ForecastHeader::default()
        };
        assert_eq!(stages.observe(&header, 71_000), Some(70_000));
        let silent = ForecastHeader { first_sent_ns: 0, ..header };
        assert_eq!(stages.observe(&silent, 71_000), None);
        let latency = stages.latency();
        let parts: Vec<f64> = latency.stages().iter().map(|(_, s)| s.max_us.round()).collect();
        assert_eq!(parts, [8.0, 1.0, 20.0, 1.0, 40.0, 70.0]);
        assert!(latency.stages().iter().all(|(_, spread)| spread.count == 1));
    }
}
