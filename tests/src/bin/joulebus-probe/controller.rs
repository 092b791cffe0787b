//! A fleet controller: a publisher with known samples.

use std::sync::atomic::Ordering;
use std::time::Duration;

use joulebus_config::Config;
use joulebus_publisher::{Pace, Publisher, clock};
use joulebus_tests::{SourceLine, steady};

use crate::{Done, print_line, stop_with_stdin};

pub(crate) fn run(config: &Config, name: &str, first: u32, robots: u32, rate_hz: f64) -> Done {
    let stop = stop_with_stdin();
    let mut publisher = Publisher::with_config(config, name)?;
    print_line(&SourceLine::Ready { source_epoch: publisher.source_epoch() })?;
    let mut pace = Pace::every(Duration::from_secs_f64(1.0 / rate_hz));
    let mut seq = 0;
    while !stop.load(Ordering::Relaxed) {
        let slot = pace.wait();
        let stamp_ns = clock::monotonic_ns();
        let samples: Vec<_> =
            (first..first + robots).map(|robot| steady(robot, seq, stamp_ns)).collect();
        // The publisher recovers; a controller must not give up at the first error.
        if let Err(error) = publisher.publish_samples(slot.intended_ns, &samples) {
            print_line(&SourceLine::Failed(error.to_string()))?;
        }
        seq += 1;
    }
    Ok(())
}
