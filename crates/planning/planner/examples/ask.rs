//! Ask before you move: what a plan costs, whether a robot makes it, when it must turn back, and
//! which robot does it for the least.
//!
//! Argument: the fleet's config. A worker and a controller run beside it.

use std::time::Duration;

use joulebus_planner::Planner;
use joulebus_planner::plan::{Path, Point, rank};

fn main() -> anyhow::Result<()> {
    let config = std::env::args().nth(1);
    let mut planner = Planner::connect(config.as_deref().unwrap_or("configs/fleet.toml"))?;
    let view = planner.wait(Duration::from_secs(10))?;
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
