//! A planner built on the public consumer library.

use std::sync::atomic::Ordering;
use std::time::Duration;

use joulebus_config::Config;
use joulebus_consumer::{Event, Subscriber, clock};
use joulebus_tests::ReaderLine;

use crate::{Done, print_line, stop_with_stdin};

const POLL_INTERVAL: Duration = Duration::from_millis(20);

pub(crate) fn run(config: &Config) -> Done {
    let stop = stop_with_stdin();
    let mut planner = Subscriber::with_config(config, "consumer")?;
    print_line(&ReaderLine::Ready)?;
    while !stop.load(Ordering::Relaxed) {
        let gaps = planner.counts().gaps;
        let line = match planner.wait_next(POLL_INTERVAL)? {
            Event::Frame(frame) => ReaderLine::Given {
                worker_epoch: frame.header().worker_epoch,
                tick: frame.header().tick,
                ticks_missed: frame.arrival().ticks_missed,
                restarted: frame.arrival().restarted,
                gaps: gaps + u64::from(frame.arrival().ticks_missed > 0),
                robots: frame.robots().len(),
                accepted: frame.header().samples_accepted,
            },
            Event::Gone(end) => {
                ReaderLine::WorkerGone { end: format!("{end:?}"), at_ns: clock::monotonic_ns() }
            }
            Event::Stale { age_ns } => ReaderLine::Stale { age_ns },
            _ => continue,
        };
        print_line(&line)?;
    }
    Ok(())
}
