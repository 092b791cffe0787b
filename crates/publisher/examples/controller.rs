//! A fleet controller publishes its commands and readings, 30 times a second, whether or not a
//! worker runs.
//!
//! Arguments: the fleet's config, and the number of ticks. Without a number it runs until Ctrl-C.

use std::path::Path;
use std::time::Duration;

use joulebus_publisher::{Charger, Pace, PublishError, Publisher, RobotState};

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let config = arguments.next();
    let config = config.as_deref().unwrap_or("configs/fleet.toml");
    let ticks = arguments.next().map_or(Ok(u32::MAX), |number| number.parse())?;
    let sent = run(config.as_ref(), ticks)?;
    println!("{sent} samples sent");
    Ok(())
}

/// Publishes samples of twenty robots 30 times a second, `ticks` times. Returns their number.
pub(crate) fn run(config: &Path, ticks: u32) -> anyhow::Result<u64> {
    let mut publisher = Publisher::connect(config, "example-controller")?;
    let mut pace = Pace::every(Duration::from_nanos(33_333_333));
    for tick in 0..ticks {
        let slot = pace.wait();
        // Here a controller reads its robots, decides, and sends the commands.
        let robots = (0..20_u32).map(|robot| {
            let mut state = RobotState::new(robot).command(speed_mps(robot, tick), 0.0);
            // These come full from their chargers. State what yours know: `state_of_charge` if
            // they measure it, `charger`, `swapped` after an exchange, and `off` in the last frame
            // of a robot that is switched off.
            if tick == 0 {
                state = state.charger(Charger::Full);
            }
            // The monitor measures at every third tick, and repeats its reading in between.
            let power_w = 2.8 + 9.0 * speed_mps(robot, tick - tick % 3);
            match tick % 3 {
                0 => state.reading(power_w),
                _ => state.held_reading(power_w),
            }
        });
        match publisher.publish_intended(slot.intended_ns, robots) {
            Ok(_) => {}
            // The files of this process were removed: it must join again.
            Err(PublishError::Send(error)) if error.is_final() => return Err(error.into()),
            // This frame is lost. The next one is due soon.
            Err(error) => eprintln!("{error}"),
        }
    }
    Ok(publisher.samples_sent())
}

/// Up to 0.15 m/s: the built-in model was trained up to 0.2.
fn speed_mps(robot: u32, tick: u32) -> f32 {
    0.1 + 0.05 * (tick as f32 * 0.02 + robot as f32).sin()
}
