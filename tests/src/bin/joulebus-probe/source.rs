//! A source that sends the frames it is given, including forged ones.

use joulebus_bus::{Bus, clock};
use joulebus_config::Config;
use joulebus_tests::{FrameLine, SourceLine};
use joulebus_wire::{SCHEMA_VERSION, SampleHeader, fnv1a};

use crate::{Done, print_line};

pub(crate) fn run(config: &Config, name: &str) -> Done {
    let limits = config.limits();
    let bus = Bus::join(&config.domain()?, name)?;
    let mut writer = bus.sample_writer(&limits, limits.capacity)?;
    let mut header = SampleHeader {
        schema: SCHEMA_VERSION,
        pid: std::process::id(),
        source_id: fnv1a(name.bytes()),
        source_epoch: clock::monotonic_ns(),
        ..SampleHeader::default()
    };
    print_line(&SourceLine::Ready { source_epoch: header.source_epoch })?;
    for line in std::io::stdin().lines() {
        let frames: Vec<FrameLine> = serde_json::from_str(&line?)?;
        let mut readers = 0;
        for frame in frames {
            let now_ns = clock::monotonic_ns();
            (header.intended_ns, header.sent_ns) = (now_ns, now_ns);
            header.sent_unix_ns = clock::unix_ns();
            let forged = SampleHeader {
                schema: frame.forge.schema.unwrap_or(header.schema),
                source_epoch: frame.forge.source_epoch.unwrap_or(header.source_epoch),
                samples_before: frame.forge.samples_before.unwrap_or(header.samples_before),
                ..header
            };
            let samples = frame.samples();
            readers = match writer.send(forged, samples.len(), |place| samples[place]) {
                Ok(sent) => sent.readers,
                Err(error) => {
                    print_line(&SourceLine::Failed(error.to_string()))?;
                    return Err(error.into());
                }
            };
            header.frame_seq += 1;
            header.samples_before += samples.len() as u64;
        }
        print_line(&SourceLine::Sent { readers, samples: header.samples_before })?;
    }
    Ok(())
}
