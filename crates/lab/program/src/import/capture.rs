//! Recordings as the samples of a fleet.

use std::collections::BTreeSet;
use std::fs::File;
use std::path::Path;

use anyhow::Context as _;
use joulebus_bus::clock;
use joulebus_capture_format::{CaptureSettings, Clock, Message, Preset, Times, Writer};
use joulebus_capture_recorder::attach;
use joulebus_config::Config;
use joulebus_dataset::trial::{Playback, Trial, TrialFleet};
use joulebus_program::exit::UsageError;
use joulebus_wire::{SCHEMA_VERSION, SampleHeader, Samples};

use super::{Recording, Written};

/// Monotonic time of the first row, ns: a stamp of 0 would mean none.
const BASE_NS: u64 = 1_000_000_000;

/// Writes the recordings as one fleet, each from its own beginning. A row's reading is combined
/// with the next row's command, as a controller would publish it, in frames of a tick's period.
pub(super) fn write(
    path: &Path,
    config: &Config,
    recordings: Vec<Recording>,
) -> anyhow::Result<Written> {
    let starts = recordings.iter().filter_map(|recording| recording.start_unix_ns);
    let start_unix_ns = starts.min().unwrap_or_else(clock::unix_ns);
    let names: Vec<String> = recordings.iter().map(|recording| recording.name.clone()).collect();
    let trials = numbered(config, recordings)?;
    let ids: Vec<u32> = trials.iter().map(|(robot, _)| *robot).collect();
    let clock = Clock {
        // Both are below 2^63 ns for the next 200 years.
        offset_ns: start_unix_ns.wrapping_sub(BASE_NS) as i64,
    };
    let mut attachments = attach(std::slice::from_ref(config), clock)?;
    let robots = ids.iter().zip(&names).map(|(id, name)| format!("{id} {name}"));
    attachments.describe("imported", robots.collect::<Vec<_>>().join(", "));
    let playback =
        Playback { base_ns: BASE_NS, frame_period_ns: config.tick_period_ns(), repeat: false };
    let fleet = TrialFleet::new(trials, playback)?;
    let of = (config.fleet(), clock, start_unix_ns);
    let written = joulebus_files::create(path, |file| {
        let settings = CaptureSettings::new(Preset::ZstdSmall);
        let writer = Writer::new(file, settings, &attachments)?;
        samples(of, fleet, writer)
    });
    Ok(Written {
        file: path.display().to_string(),
        robots: names,
        rows: written.with_context(|| format!("cannot write {}", path.display()))?,
    })
}

/// Writes all samples of a fleet that begins at `start_unix_ns`. Returns their number.
fn samples(
    (fleet_name, clock, start_unix_ns): (&str, Clock, u64),
    mut fleet: TrialFleet,
    mut writer: Writer<&File>,
) -> anyhow::Result<u64> {
    let mut header = SampleHeader {
        schema: SCHEMA_VERSION,
        pid: std::process::id(),
        source_id: 1,
        source_epoch: start_unix_ns,
        ..SampleHeader::default()
    };
    let mut frame = Vec::new();
    while let Some(due_ns) = fleet.next_due_ns() {
        fleet.frame_into(due_ns, &mut frame);
        let sent_ns = BASE_NS.saturating_add(due_ns);
        header.intended_ns = sent_ns;
        header.sent_ns = sent_ns;
        header.sent_unix_ns = clock.unix_ns(sent_ns);
        let times = Times { log_ns: header.sent_unix_ns, publish_ns: header.sent_unix_ns };
        let message = Message::of::<Samples>(header, std::mem::take(&mut frame));
        writer.write(fleet_name, times, &message)?;
        if let Ok(written) = message.into_frame::<Samples>() {
            header.samples_before += written.rows.len() as u64;
            frame = written.rows;
        }
        header.frame_seq += 1;
    }
    writer.finish()?;
    Ok(header.samples_before)
}

/// Each trial with its robot's id: as mapped, else the next free one from the config's lowest on.
fn numbered(config: &Config, recordings: Vec<Recording>) -> anyhow::Result<Vec<(u32, Trial)>> {
    let platforms = &config.settings().platforms;
    let ranges = platforms.iter().flat_map(|platform| &platform.robots);
    let mut next = ranges.map(|range| *range.start()).min().unwrap_or(0);
    let mut taken: BTreeSet<u32> = recordings.iter().filter_map(|recording| recording.id).collect();
    let mut trials = Vec::new();
    for recording in recordings {
        let id = match recording.id {
            Some(id) => id,
            None => {
                while taken.contains(&next) {
                    next = next.checked_add(1).ok_or_else(|| {
                        UsageError("there are no more ids. State them in a mapping".to_owned())
                    })?;
                }
                taken.insert(next);
                next
            }
        };
        trials.push((id, recording.trial));
    }
    Ok(trials)
}
