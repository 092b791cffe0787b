//! The kernel alone, after the same sleep.

use std::hint::black_box;
use std::time::Instant;

use hdrhistogram::Histogram;
use joulebus_latency::Spread;
use joulebus_predictor::{Features, Model, features};

use crate::histogram;

/// Input rows and the kernel's output.
pub(super) struct Alone<'a> {
    model: &'a Model,
    rows: Vec<Features>,
    forecasts_w: Vec<f32>,
    times: Histogram<u64>,
}

impl<'a> Alone<'a> {
    pub(super) fn new(model: &'a Model, robots: usize) -> Self {
        let row = |robot: usize| {
            let power_w = 3.5 + (robot % 100) as f32 * 0.001;
            features(0.1, 0.2, Some((0.1, 0.1, 0.033)), &[power_w; 5])
        };
        Self {
            model,
            rows: (0..robots).map(row).collect(),
            forecasts_w: vec![0.0; robots],
            times: histogram(),
        }
    }

    /// One batch. `counts`: the warm-up is over.
    pub(super) fn run(&mut self, counts: bool) {
        let start = Instant::now();
        self.model.predict(black_box(&self.rows), &mut self.forecasts_w);
        if counts {
            self.times.saturating_record(start.elapsed().as_nanos() as u64);
        }
        black_box(&mut self.forecasts_w);
    }

    pub(super) fn finish(self) -> Spread {
        Spread::new(&self.times)
    }
}
