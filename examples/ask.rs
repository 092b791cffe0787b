//! Ask before you move: what a plan costs, whether a robot makes it, when it must turn back, and
//! which robot does it for the least. `cargo run -p joulebus-examples --example ask`

use std::time::Duration;

use joulebus_examples::PrivateFleet;
use joulebus_plan::{Path, Point, rank};
use joulebus_planner::Planner;
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
    let mut planner = Planner::connect(fleet.config())?;
    let mut pace = Pace::every(Duration::from_nanos(33_333_333));
    // Two seconds at rest: robot 1 draws less than the others, robot 2 has no readings.
    for _ in 0..60 {
        pace.wait();
        publisher.publish([
            RobotState::new(0).command(0.0, 0.0).reading(3.4),
            RobotState::new(1).command(0.0, 0.0).reading(2.6),
            RobotState::new(2).command(0.0, 0.0),
        ])?;
    }
    let view = planner.wait(Duration::from_secs(3))?;
    let dock = Point::new(0.0, 0.0);
    let path = Path::new(&[dock, Point::new(1.5, 0.0), Point::new(1.5, 0.8)], 0.15);
    let robots: Vec<_> = (0..3).filter_map(|robot| view.robot(robot)).collect();
    for ranked in rank(&robots, &path, Some(dock), 0.9)? {
        let (answer, turn_back_s) = (ranked.trip.answer, ranked.trip.turn_back_s);
        let energy = answer.energy.map_or("unknown energy".to_owned(), |energy| {
            format!("{:.0} J ({:.0} to {:.0})", energy.mean_j, energy.lo_j, energy.hi_j)
        });
        println!("robot {}: {}, {energy}", ranked.robot, answer.verdict);
        if let Some(turn_back_s) = turn_back_s {
            println!("  must turn back within {turn_back_s:.0} s");
        }
    }
    Ok(())
}
