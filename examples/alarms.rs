//! Alarms: a robot with a stuck power monitor, and one that sends invalid values.
//! `cargo run -p joulebus-examples --example alarms`

use std::time::Duration;

use joulebus_consumer::{Event, Subscriber, wire::Alarm};
use joulebus_examples::PrivateFleet;
use joulebus_publisher::{Pace, Publisher, RobotState};

const PLATFORMS: &str = r#"
[[platform]]
file = "builtin:gternal"
robots = ["0-2"]
stuck_after_s = 0.5
stale_after_s = 5.0
"#;

fn main() -> anyhow::Result<()> {
    let fleet = PrivateFleet::with_worker(PLATFORMS)?;
    let mut publisher = Publisher::connect(fleet.config(), "controller")?;
    let mut subscriber = Subscriber::connect(fleet.config())?;
    let mut diagnostics = subscriber.diagnostics()?;
    let mut pace = Pace::every(Duration::from_nanos(33_333_333));
    let (mut stuck, mut refused) = (false, false);
    for tick in 0..150 {
        pace.wait();
        let noise_w = 0.05 * (tick as f32).sin();
        publisher.publish([
            RobotState::new(0).command(0.1, 0.0).reading(3.7 + noise_w),
            RobotState::new(1).command(0.1, 0.0).reading(3.7),
            RobotState::new(2).command(0.1, 0.0).reading(f32::NAN),
        ])?;
        if let Event::Frame(_) = subscriber.wait_next(Duration::from_secs(1))? {}
        let Some(frame) = diagnostics.latest()? else {
            continue;
        };
        // The header names up to sixteen recently refused robots, each with the reason.
        if let Some(refusal) = frame.header().refusals().next().filter(|_| !refused) {
            println!("robot {} refused: {:?}", refusal.robot, refusal.reason());
            refused = true;
        }
        if let Some(robot) =
            frame.robots().iter().find(|robot| robot.alarms().has(Alarm::StuckSensor))
        {
            println!("robot {}: {} ({:?})", robot.robot, robot.alarm().name(), robot.level());
            stuck = true;
        }
        if stuck && refused {
            return Ok(());
        }
    }
    anyhow::bail!("no alarm within five seconds")
}
