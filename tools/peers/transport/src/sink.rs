//! The sink of every transport.

use std::io::{self, Write as _};

use anyhow::ensure;
use hdrhistogram::Histogram;
use joulebus_bench::latency::{WARM_UP, record_places};
use joulebus_bench::{Spread, histogram};
use joulebus_bus::clock;

use crate::frame::{forecast_bytes, stamps};

/// Latencies of the frames received.
pub struct Sink {
    robots: usize,
    period_ns: u64,
    acknowledge: bool,
    seen: u64,
    times: Histogram<u64>,
}

impl Sink {
    /// For frames of `robots` robots each `period_ns`; `acknowledge`: print a byte for each.
    pub fn new(robots: usize, period_ns: u64, acknowledge: bool) -> Self {
        Self { robots, period_ns, acknowledge, seen: 0, times: histogram() }
    }

    /// Takes a frame; returns whether it was the last, in which case the latencies have been
    /// printed.
    pub fn take(&mut self, frame: &[u8]) -> anyhow::Result<bool> {
        let now_ns = clock::monotonic_ns();
        let (found, expected) = (frame.len(), forecast_bytes(self.robots));
        ensure!(found == expected, "a frame of {found} bytes, not {expected}");
        let stamps = stamps(frame);
        let mut stdout = io::stdout();
        if stamps.due_ns == 0 {
            writeln!(stdout, "\n{}", serde_json::to_string(&Spread::new(&self.times))?)?;
            return Ok(true);
        }
        self.seen += 1;
        if self.seen > WARM_UP {
            let times = (stamps.due_ns, stamps.sent_ns, now_ns);
            record_places(&mut self.times, times, self.period_ns, 1);
        }
        if self.acknowledge {
            stdout.write_all(b".")?;
            stdout.flush()?;
        }
        Ok(false)
    }
}
