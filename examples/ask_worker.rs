//! Ask the worker: a program that loads no models asks what a path costs, and what standing still
//! costs. `cargo run -p joulebus-examples --example ask_worker`

use std::time::Duration;

use joulebus_config::Config;
use joulebus_examples::PrivateFleet;
use joulebus_plan::{Path, Plan, Point, Question};
use joulebus_plan_server::PlanServer;
use joulebus_planner::PlanClient;
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
    // In `joulebus run` this thread runs beside the tick.
    let server = PlanServer::start(&Config::load(fleet.config())?, None)?;
    server.serve();
    server.wait_until_open();
    let mut publisher = Publisher::connect(fleet.config(), "controller")?;
    let mut client = PlanClient::connect(fleet.config())?;
    let mut pace = Pace::every(Duration::from_nanos(33_333_333));
    for _ in 0..60 {
        pace.wait();
        publisher.publish([
            RobotState::new(0).command(0.0, 0.0).reading(3.4),
            RobotState::new(1).command(0.0, 0.0).reading(2.6),
        ])?;
    }
    let dock = Point::new(0.0, 0.0);
    let plans = [
        Plan::Follow {
            robots: vec![0, 1],
            path: Path::new(&[dock, Point::new(1.5, 0.0)], 0.15),
            back_to: Some(dock),
        },
        Plan::Idle { robots: vec![1], duration_s: 60.0 },
        // Robot 2 has not sent a sample: refused, with the reason.
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
    println!("{} questions answered", server.finish().answered);
    Ok(())
}
