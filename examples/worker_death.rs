//! The worker is killed and restarted: a planner is notified of both at once, and stays connected.
//! `cargo run -p joulebus-examples --example worker_death`

use std::path::Path;
use std::process::{Child, Command};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use joulebus_consumer::{Config, Event, Subscriber};
use joulebus_examples::PrivateFleet;
use joulebus_predictor_worker::Worker;

const PLATFORMS: &str = r#"
[[platform]]
file = "builtin:gternal"
robots = ["0-9"]
"#;

fn main() -> anyhow::Result<()> {
    // This program is also the worker that it starts.
    if let Some(config) = std::env::args().nth(1) {
        Worker::open(&Config::load(config)?)?.run(&AtomicBool::new(false))?;
        return Ok(());
    }
    let fleet = PrivateFleet::new(PLATFORMS)?;
    let mut subscriber = Subscriber::connect(fleet.config())?;
    let mut worker = start(fleet.config())?;
    let mut killed = false;
    loop {
        match subscriber.wait_next(Duration::from_secs(60))? {
            Event::Frame(frame) if frame.arrival().restarted => {
                println!("tick {} of a new worker", frame.header().tick);
                break;
            }
            Event::Frame(frame) if !killed => {
                println!("tick {}. Now killing the worker", frame.header().tick);
                worker.kill()?;
                killed = true;
            }
            Event::Gone(end) => {
                println!("the worker is gone ({end:?}): forecasts are invalid");
                worker.wait()?;
                worker = start(fleet.config())?;
            }
            Event::TimedOut => {
                worker.kill()?;
                anyhow::bail!("no event for a minute");
            }
            // Frames sent before the end, and `Stale` before it is reported: nothing to do.
            _ => {}
        }
    }
    worker.kill()?;
    worker.wait()?;
    Ok(())
}

fn start(config: &Path) -> std::io::Result<Child> {
    Command::new(std::env::current_exe()?).arg(config).spawn()
}
