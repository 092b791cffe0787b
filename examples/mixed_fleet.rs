//! One fleet of three platforms, each with its own model, rate and limits. One worker forecasts for
//! all.
//! `cargo run -p joulebus-examples --example mixed_fleet`

use std::time::Duration;

use joulebus_consumer::{Event, Subscriber, wire::Forecast};
use joulebus_examples::PrivateFleet;
use joulebus_publisher::{Pace, Publisher, RobotState};

/// Other keys come from the platform's file. `joulebus config explain` describes each key.
const PLATFORMS: &str = r#"
[[platform]]
file = "builtin:gternal"
robots = ["0-9"]
[[platform]]
file = "builtin:husky"
robots = ["100-101"]
[[platform]]
file = "builtin:rover"
robots = ["200"]
power_max_w = 150.0
"#;

fn main() -> anyhow::Result<()> {
    let fleet = PrivateFleet::with_worker(PLATFORMS)?;
    let mut publisher = Publisher::connect(fleet.config(), "controller")?;
    let mut subscriber = Subscriber::connect(fleet.config())?;
    let mut pace = Pace::every(Duration::from_nanos(33_333_333));
    for tick in 0..600_u32 {
        pace.wait();
        let gternals = (0..10).map(|id| RobotState::new(id).command(0.2, 0.0).reading(4.6));
        // Every fifth tick: Huskies send 6.5 samples a second. Rovers report no velocities.
        let huskies = (100..102).filter(|_| tick % 5 == 0);
        let huskies = huskies.map(|id| RobotState::new(id).command(0.5, 0.1).reading(140.0));
        let rovers = [RobotState::new(200).reading(31.0)];
        publisher.publish(gternals.chain(huskies).chain(rovers))?;
        if let Event::Frame(_) = subscriber.wait_next(Duration::from_secs(1))? {}
        // Two seconds. Where a program gets no processor for a while, the windows of its robots
        // begin anew.
        let frame = subscriber.current();
        let known = frame.map_or(0, |frame| frame.iter().filter_map(Forecast::expected_w).count());
        if tick >= 59 && known == 13 {
            break;
        }
    }
    let Some(frame) = subscriber.current() else {
        anyhow::bail!("the worker has sent no forecasts");
    };
    for (platform, ids) in [("gternal", 0..100), ("husky", 100..200), ("rover", 200..300)] {
        let robots = frame.robots().iter().filter(|forecast| ids.contains(&forecast.robot));
        let powers_w: Vec<f32> = robots.filter_map(|forecast| forecast.expected_w()).collect();
        let sum_w: f32 = powers_w.iter().sum();
        println!("{platform}: {} robots, {sum_w:.1} W", powers_w.len());
    }
    Ok(())
}
