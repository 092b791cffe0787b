//! Prints alarms as robots raise them, and samples that the worker refuses.
//!
//! Arguments: the fleet's config, and the number of frames. Without a number it runs until Ctrl-C.

use std::collections::BTreeSet;
use std::time::Duration;

use joulebus_consumer::{Event, Subscriber};

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let config = arguments.next();
    let config = config.as_deref().unwrap_or("configs/fleet.toml");
    let frames = arguments.next().map_or(Ok(u64::MAX), |number| number.parse())?;

    let mut subscriber = Subscriber::connect(config)?;
    let mut diagnostics = subscriber.diagnostics()?;
    let mut printed = BTreeSet::new();
    while subscriber.counts().frames < frames {
        // Diagnostics are sent with the forecasts, for which a planner waits.
        if let Event::Interrupted = subscriber.wait_next(Duration::from_secs(1))? {
            break;
        }
        let Some(frame) = diagnostics.latest()? else {
            continue;
        };
        // The header names up to sixteen recently refused robots, each with the reason.
        let refused = frame.header().refusals().filter_map(|refusal| {
            let reason = refusal.reason()?;
            Some(format!("robot {} refused: {reason:?}", refusal.robot))
        });
        let raised = frame.robots().iter().flat_map(|robot| {
            let alarms = robot.alarms().iter();
            alarms.map(|alarm| format!("robot {}: {alarm:?} ({:?})", robot.robot, alarm.level()))
        });
        for line in refused.chain(raised) {
            if !printed.contains(&line) {
                println!("{line}");
                printed.insert(line);
            }
        }
    }
    Ok(())
}
