//! One fleet of three platforms, each with its own model, rate and limits. One worker forecasts for
//! all. Here worker, controller and planner are threads of one process.

use std::fs;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use joulebus_consumer::{Event, Subscriber, wire::Forecast};
use joulebus_predictor_worker::Worker;
use joulebus_publisher::{Config, Pace, Publisher, RobotState};

/// Other keys come from the platform's file. `joulebus config explain` describes each key.
const FLEET: &str = r#"
[fleet]
name = "mixed"
capacity = 100
[domain]
root = "@/domain"
[ledger]
checkpoint = ""
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
    // Shared memory of its own, so that it neither needs another worker nor interferes with one.
    let folder = tempfile::TempDir::with_prefix_in("joulebus-example-", "/dev/shm")?;
    let file = folder.path().join("fleet.toml");
    fs::write(&file, FLEET.replace('@', &folder.path().display().to_string()))?;
    let config = Config::load(&file)?;
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        let (ready, started) = mpsc::channel();
        // A worker must stay on the thread that opened it.
        let worker = scope.spawn(|| -> anyhow::Result<()> {
            let mut worker = Worker::open(&config)?;
            drop(ready);
            worker.run(&stop)?;
            println!("{} ticks", worker.finish().ticks);
            Ok(())
        });
        // Until the worker has opened, or has failed to.
        let _: Result<(), _> = started.recv();
        let driven = drive(&config);
        stop.store(true, Ordering::Relaxed);
        worker.join().map_err(|_| anyhow::Error::msg("the worker's thread has panicked"))??;
        driven
    })
}

/// Publishes for all robots, reads their forecasts, and prints them once all are known.
fn drive(config: &Config) -> anyhow::Result<()> {
    let mut publisher = Publisher::with_config(config, "controller")?;
    let mut subscriber = Subscriber::with_config(config, "planner")?;
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
