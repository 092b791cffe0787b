//! Energy budgets: what each robot has drawn, what it may still use, and for how long.
//! `cargo run -p joulebus-examples --example budgets`

use std::time::Duration;

use joulebus_consumer::{Event, Subscriber};
use joulebus_examples::PrivateFleet;
use joulebus_publisher::{Pace, Publisher, RobotState};

const PLATFORMS: &str = r#"
[[platform]]
file = "builtin:gternal"
robots = ["0-2"]
[platform.battery]
capacity_wh = 10.0
initial_soc_lo = 0.9
"#;

fn main() -> anyhow::Result<()> {
    let fleet = PrivateFleet::with_worker(PLATFORMS)?;
    let mut publisher = Publisher::connect(fleet.config(), "controller")?;
    let mut subscriber = Subscriber::connect(fleet.config())?;
    let mut budgets = subscriber.budgets()?;
    let mut pace = Pace::every(Duration::from_nanos(33_333_333));
    for _ in 0..60 {
        pace.wait();
        publisher.publish([
            RobotState::new(0).command(0.0, 0.0).reading(2.8),
            RobotState::new(1).command(0.2, 0.0).reading(4.6),
            // Its power monitor does not respond: the conservative estimate is charged the
            // platform's 20 W.
            RobotState::new(2).command(0.2, 0.0),
        ])?;
        // Budgets are sent with the forecasts, for which a planner waits.
        if let Event::Frame(_) = subscriber.wait_next(Duration::from_secs(1))? {}
    }
    let Some(frame) = budgets.latest()? else {
        anyhow::bail!("the worker has sent no budgets");
    };
    for budget in (0..3).filter_map(|robot| frame.robot(robot)) {
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
