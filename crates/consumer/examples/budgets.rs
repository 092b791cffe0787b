//! Energy budgets: what each robot has drawn, and what it may still use.
//!
//! Arguments: the fleet's config, and the number of frames after which they are printed. Without a
//! number after one frame.

use std::time::Duration;

use anyhow::Context;
use joulebus_consumer::{Event, Subscriber};

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let config = arguments.next();
    let config = config.as_deref().unwrap_or("configs/fleet.toml");
    let frames = arguments.next().map_or(Ok(1), |number| number.parse())?;

    let mut subscriber = Subscriber::connect(config)?;
    let mut budgets = subscriber.budgets()?;
    while subscriber.counts().frames < frames {
        if let Event::Interrupted = subscriber.wait_next(Duration::from_secs(1))? {
            return Ok(());
        }
    }
    // Budgets are sent with the forecasts.
    let frame = budgets.latest()?.context("the worker has sent no budgets")?;
    for budget in frame.robots() {
        println!(
            "robot {}: {:.1} J metered over {:.1} s, {:.1} s unmetered; usable {:.0} J, at least {:.0} J",
            budget.robot,
            budget.drawn_j(),
            budget.metered_ns as f64 * 1e-9,
            budget.unmetered_ns as f64 * 1e-9,
            budget.usable_j,
            budget.usable_lo_j,
        );
    }
    Ok(())
}
