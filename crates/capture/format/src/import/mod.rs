//! Imports recordings of other programs as rows of commands and readings.
//!
//! A rosbag2 MCAP file is read message by message; unusable messages are counted by reason. A row
//! is one battery reading with the command and odometry at its time, and NaN for unknown values.

mod channel;
mod error;
mod join;
mod mapping;
mod report;

use std::collections::BTreeMap;
use std::io::{Read, Seek};

use mcap::records::Record;

use crate::scan::{self, ScanError};
use channel::Channel;
pub use error::ImportError;
pub use join::Row;
use joulebus_ros_messages::RosType;

pub use mapping::{CurrentSign, Expired, Mapping, MappingError, RobotMapping, TimeSource};
pub use report::{Imported, RobotReport, TopicReport, Unusable};

/// Reads a recording.
///
/// # Errors
/// [`ImportError`]. A corrupt file is read as far as possible; see [`Imported::damage`].
pub fn import(
    input: impl Read + Seek,
    name: &str,
    mapping: &Mapping,
) -> Result<Imported, ImportError> {
    import_files(&mut [input], name, mapping)
}

/// Reads a recording of several files, in any order.
///
/// # Errors
/// As [`import`].
pub fn import_files(
    inputs: &mut [impl Read + Seek],
    name: &str,
    mapping: &Mapping,
) -> Result<Imported, ImportError> {
    let mut channels = Vec::new();
    for input in inputs.iter_mut() {
        let (found, _) = self::channels(input)?;
        channel::join(&mut channels, found);
    }
    let robots = mapping::choose(name, mapping, &channels)?;
    let mut names: Vec<&str> = robots.iter().map(|robot| robot.name.as_str()).collect();
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        let name = pair[0].to_owned();
        return Err(ImportError::TwoOfAName { name });
    }
    let mut tracks: Vec<join::Track> = robots
        .into_iter()
        .map(|robot| join::Track::new(robot, mapping))
        .collect();
    let mut damage = Vec::new();
    let several = inputs.len() > 1;
    for (input, number) in inputs.iter_mut().zip(1..) {
        let found = read_tracks(input, &mut tracks)?;
        damage.extend(found.into_iter().map(|what| match several {
            true => format!("file {number}: {what}"),
            false => what,
        }));
    }
    Ok(report::imported(tracks, &channels, damage))
}

/// The channels of a file with their messages, and the damage.
fn channels(input: &mut (impl Read + Seek)) -> Result<(Vec<Channel>, Vec<String>), ScanError> {
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
                    kind: RosType::of(&channel.message_encoding, type_name, encoding, data),
                    topic: channel.topic,
                    type_name: type_name.clone(),
                    encoding: channel.message_encoding,
                    messages: 0,
                };
                channels.entry(channel.id).or_insert(found);
            }
            Record::Message { header, .. } => {
                if let Some(channel) = channels.get_mut(&header.channel_id) {
                    channel.messages += 1;
                }
            }
            _ => {}
        }
        Ok(())
    })?;
    Ok((channels.into_values().collect(), damage))
}

fn read_tracks(
    input: &mut (impl Read + Seek),
    tracks: &mut [join::Track],
) -> Result<Vec<String>, ScanError> {
    tracks.iter_mut().for_each(join::Track::begin_file);
    let mut schemas = BTreeMap::new();
    let mut kinds: BTreeMap<u16, (String, RosType)> = BTreeMap::new();
    scan::each_record(input, |record| {
        match record {
            Record::Schema { header, data } => {
                schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
            }
            Record::Channel(channel) => {
                let Some((type_name, encoding, data)) = schemas.get(&channel.schema_id) else {
                    return Ok(());
                };
                if let Ok(kind) = RosType::of(&channel.message_encoding, type_name, encoding, data)
                {
                    kinds.insert(channel.id, (channel.topic, kind));
                }
            }
            Record::Message { header, data } => {
                if let Some((topic, kind)) = kinds.get(&header.channel_id) {
                    for track in tracks.iter_mut() {
                        track.take(topic, *kind, &header, &data);
                    }
                }
            }
            _ => {}
        }
        Ok(())
    })
}
