//! Imports recordings of other programs as rows of commands and readings.
//!
//! A rosbag2 MCAP file is read message by message. Unusable messages are counted by reason. A row
//! is one battery reading with the command and odometry at its time, and NaN for unknown values.

mod channel;
mod error;
mod join;
mod mapping;
mod report;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Read, Seek};

use mcap::records::{MessageHeader, Record};

use crate::scan::{self, ScanError};
use channel::Channel;
pub use error::ImportError;
pub use join::Row;
use joulebus_ros_messages::RosType;

pub use mapping::{
    CurrentSign, Expired, Mapping, MappingError, PackMapping, RobotMapping, TimeSource,
};
pub use report::{Imported, RobotReport, TopicReport, Unusable};

/// Reads a recording.
///
/// # Errors
/// [`ImportError`]. A corrupt file is read as far as possible. See [`Imported::damage`].
pub fn import(
    input: impl Read + Seek,
    name: &str,
    mapping: &Mapping,
) -> Result<Imported, ImportError> {
    import_files(&mut [(String::new(), input)], name, mapping)
}

/// Reads a recording of several files with their names, in any order.
///
/// # Errors
/// As [`import`].
pub fn import_files(
    inputs: &mut [(String, impl Read + Seek)],
    name: &str,
    mapping: &Mapping,
) -> Result<Imported, ImportError> {
    let mut channels = Vec::new();
    for (_, input) in inputs.iter_mut() {
        let (found, _) = each_message(input, |channel, _, _| channel.messages += 1)?;
        channel::join(&mut channels, found);
    }
    let robots = mapping::choose(name, mapping, &channels)?;
    let mut names: Vec<&str> = robots.iter().map(|robot| robot.name.as_str()).collect();
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        let name = pair[0].to_owned();
        let batteries = robots.iter().filter(|robot| robot.name == name);
        let batteries: Vec<&str> = batteries.map(|robot| robot.battery.as_str()).collect();
        return Err(ImportError::Robots(format!(
            "two robots named {name:?}, with the batteries {}. In a mapping file (--mapping), choose the \
             one of its power as the robot's `battery`, sum them as its `packs`, or give them \
             different names",
            batteries.join(", ")
        )));
    }
    let mut tracks: Vec<join::Track> =
        robots.into_iter().map(|robot| join::Track::new(robot, mapping)).collect();
    let mut damage = Vec::new();
    let several = inputs.len() > 1;
    for (file, input) in inputs.iter_mut() {
        tracks.iter_mut().for_each(join::Track::begin_file);
        let (_, found) = each_message(input, |channel, header, data| {
            let Ok(kind) = &channel.kind else {
                return;
            };
            // One that cannot be unpacked is refused as what it is.
            let data = unpacked(data).unwrap_or(Cow::Borrowed(data));
            for track in &mut tracks {
                track.take(&channel.topic, *kind, header, &data);
            }
        })?;
        damage.extend(found.into_iter().map(|what| match several {
            true => format!("{file}: {what}"),
            false => what,
        }));
    }
    Ok(report::imported(tracks, &channels, damage))
}

/// The start of a message that rosbag2 compressed (`--compression-mode message`). CDR starts with
/// 0.
const ZSTD_MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];
/// Bytes of an unpacked message for each that it has, and at most: battery states, velocities and
/// odometry have some hundreds, and lists of cells a few thousand.
const MAX_EXPANSION: usize = 1_000;
const MAX_MESSAGE_BYTES: usize = 64 << 20;

/// A message of rosbag2 without its compression, if it has one.
///
/// # Errors
/// The message cannot be unpacked, or is far too long.
fn unpacked(data: &[u8]) -> io::Result<Cow<'_, [u8]>> {
    if !data.starts_with(ZSTD_MAGIC) {
        return Ok(Cow::Borrowed(data));
    }
    let allowed = data.len().saturating_mul(MAX_EXPANSION).min(MAX_MESSAGE_BYTES);
    zstd::bulk::decompress(data, allowed).map(Cow::Owned)
}

/// Passes each message of a file with its channel to `take`. Returns the channels, and the damage.
fn each_message(
    input: &mut (impl Read + Seek),
    mut take: impl FnMut(&mut Channel, &MessageHeader, &[u8]),
) -> Result<(Vec<Channel>, Vec<String>), ScanError> {
    let mut schemas = BTreeMap::new();
    let mut channels: BTreeMap<u16, Channel> = BTreeMap::new();
    let damage = scan::each_record(input, |record| {
        match record {
            Record::Schema { header, data } => {
                schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
            }
            Record::Channel(channel) => {
                let empty = (String::new(), String::new(), Vec::new());
                let (type_name, encoding, data) = schemas.get(&channel.schema_id).unwrap_or(&empty);
                let found = Channel {
                    kind: RosType::new(&channel.message_encoding, type_name, encoding, data),
                    topic: channel.topic,
                    type_name: type_name.clone(),
                    encoding: channel.message_encoding,
                    messages: 0,
                };
                channels.entry(channel.id).or_insert(found);
            }
            Record::Message { header, data } => {
                if let Some(channel) = channels.get_mut(&header.channel_id) {
                    take(channel, &header, &data);
                }
            }
            _ => {}
        }
        Ok(())
    })?;
    Ok((channels.into_values().collect(), damage))
}
