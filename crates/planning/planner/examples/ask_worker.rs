//! Ask the worker: a program that loads no models asks what a path costs, and what standing still
//! costs.
//!
//! Argument: the fleet's config. A worker and a controller run beside it.

use std::time::Duration;

use joulebus_planner::PlanClient;
use joulebus_planner::plan::{Path, Plan, Point, Question};

fn main() -> anyhow::Result<()> {
    let config = std::env::args().nth(1);
    let mut client = PlanClient::connect(config.as_deref().unwrap_or("configs/fleet.toml"))?;
    let dock = Point::new(0.0, 0.0);
    let plans = [
        Plan::Follow {
            robots: vec![0, 1],
            path: Path::new(&[dock, Point::new(1.5, 0.0)], 0.15),
            back_to: Some(dock),
        },
        Plan::Idle { robots: vec![1], duration_s: 60.0 },
        // A robot that has not sent a sample is refused, with the reason.
        Plan::Idle { robots: vec![2], duration_s: 60.0 },
    ];
    for plan in plans {
        let question = Question { plan, ..Question::default() };
        match client.ask(&question, Duration::from_secs(10)) {
            Ok(answered) => {
                for row in answered.reply.rows {
                    println!("robot {}: {}", row.robot, row.answer.verdict);
                }
            }
            Err(error) => println!("{error}"),
        }
    }
    Ok(())
}
