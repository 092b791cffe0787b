//! The kernel alone, woken from the same sleep.

use std::hint::black_box;
use std::time::{Duration, Instant};

use joulebus_benches::{Spread, histogram};
use joulebus_predictor::{Model, features};

pub(crate) fn measure(model: &Model, robots: usize, rate_hz: u64, frames: u64) -> Spread {
    let row = |robot: usize| {
        let power_w = 3.5 + (robot % 100) as f32 * 0.001;
        features(0.1, 0.2, Some((0.1, 0.1, 0.033)), &[power_w; 5])
    };
    let rows: Vec<_> = (0..robots).map(row).collect();
    let mut forecasts_w = vec![0.0; robots];
    let mut times = histogram();
    for _ in 0..frames {
        std::thread::sleep(Duration::from_nanos(1_000_000_000 / rate_hz));
        let start = Instant::now();
        model.predict(black_box(&rows), &mut forecasts_w);
        times.saturating_record(start.elapsed().as_nanos() as u64);
        black_box(&mut forecasts_w);
    }
    Spread::of(&times)
}
