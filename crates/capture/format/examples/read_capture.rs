//! A capture is an MCAP file. This reads one message by message, in constant memory.
//!
//! Argument: a file of `joulebus record`.

use std::collections::BTreeMap;

use anyhow::Context;
use joulebus_capture_format::{Frame, Reader};
use joulebus_wire::Forecasts;

fn main() -> anyhow::Result<()> {
    let file = std::env::args().nth(1).context("name a capture")?;
    let mut reader = Reader::open(file)?;
    let mut messages: BTreeMap<String, u64> = BTreeMap::new();
    let (mut sum_w, mut forecasts) = (0.0, 0);
    while let Some(entry) = reader.next_entry()? {
        *messages.entry(entry.topic.to_string()).or_default() += 1;
        // The payloads are those of shared memory, with the same bits.
        if let Some(Frame { rows, .. }) = entry.message.frame::<Forecasts>() {
            for power_w in rows.iter().filter_map(|robot| robot.expected_w()) {
                sum_w += f64::from(power_w);
                forecasts += 1;
            }
        }
    }
    for (topic, count) in messages {
        println!("{topic}: {count} messages");
    }
    println!("{forecasts} forecasts, {:.2} W on average", sum_w / f64::from(forecasts));
    Ok(())
}
