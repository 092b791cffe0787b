//! A planner in an event loop that waits for other things as well, here of tokio: forecasts, a
//! timer, and the worker's exit. `epoll` and mio wait for the same descriptor.
//!
//! Argument: the fleet's config.

use std::path::Path;
use std::time::Duration;

use joulebus_consumer::{Event, Readiness, Subscriber};
use tokio::io::unix::AsyncFd;
use tokio::time::{interval, timeout};

// A subscriber belongs to its thread, and so does this runtime.
#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let config = std::env::args().nth(1);
    let config: &Path = config.as_deref().unwrap_or("configs/fleet.toml").as_ref();
    let mut subscriber = Subscriber::connect(config)?;
    #[expect(deprecated, reason = "safe here: the descriptor is open as long as this exists")]
    let readiness = AsyncFd::new(subscriber.readiness()?)?;
    let mut seconds = interval(Duration::from_secs(1));
    let mut frames = 0_u64;
    loop {
        tokio::select! {
            // Whatever else the planner does.
            _ = seconds.tick() => println!("{frames} frames"),
            waited = ready(&readiness, subscriber.look_within()) => waited?,
        }
        // All that has happened, without waiting.
        loop {
            match subscriber.wait_next(Duration::ZERO)? {
                // Here a planner reads the frame.
                Event::Frame(_) => frames += 1,
                Event::Gone(end) => {
                    println!("the worker is gone ({end:?}) after {frames} frames");
                    return Ok(());
                }
                Event::Stale { .. } => println!("nothing new"),
                _ => break,
            }
        }
    }
}

/// Waits until something is likely to have happened, and no longer than `within`.
async fn ready(readiness: &AsyncFd<Readiness>, within: Duration) -> std::io::Result<()> {
    if let Ok(ready) = timeout(within, readiness.readable()).await {
        // Before the frames are read: one that arrives meanwhile makes it ready again.
        ready?.clear_ready();
    }
    Ok(())
}
