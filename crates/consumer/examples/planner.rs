//! A planner waits for forecasts, and is notified at once when the worker ends.
//!
//! Arguments: the fleet's config, and the number of frames. Without a number it runs until Ctrl-C.

use std::path::Path;
use std::time::Duration;

use joulebus_consumer::{Event, Subscriber, wire::Forecast};

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let config = arguments.next();
    let config = config.as_deref().unwrap_or("configs/fleet.toml");
    let frames = arguments.next().map_or(Ok(u64::MAX), |number| number.parse())?;
    run(config.as_ref(), frames)
}

/// Prints `frames` frames of forecasts, and changes of the worker's state.
pub(crate) fn run(config: &Path, frames: u64) -> anyhow::Result<()> {
    let mut subscriber = Subscriber::connect(config)?;
    while subscriber.counts().frames < frames {
        match subscriber.wait_next(Duration::from_secs(1))? {
            Event::Frame(frame) => {
                let tick = frame.header().tick;
                let fleet_w: f32 = frame.iter().filter_map(Forecast::expected_w).sum();
                match frame.robot(7).and_then(Forecast::interval_w) {
                    Some((lo, hi)) => {
                        println!("tick {tick}: fleet {fleet_w:.1} W, robot 7 {lo:.2} to {hi:.2} W");
                    }
                    None => println!("tick {tick}: fleet {fleet_w:.1} W, robot 7 unknown"),
                }
            }
            Event::Gone(end) => println!("the worker is gone ({end:?}): forecasts are invalid"),
            Event::Stale { age_ns } => println!("nothing new for {} ms", age_ns / 1_000_000),
            Event::Interrupted => break,
            _ => println!("no forecasts: does a worker run, and does a controller publish?"),
        }
    }
    Ok(())
}
