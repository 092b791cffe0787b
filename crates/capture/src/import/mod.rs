//! Recordings of other programs, as rows of commands and readings.
//!
//! A rosbag2 MCAP file is read message by message; what cannot be used is counted by reason. A row
//! stands for one battery reading: the command in force when it was made, the odometry known then,
//! and NaN for what is not known.

mod join;
mod mapping;
mod report;

use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};

use mcap::records::Record;

use crate::ros::{Message, RosType};
use crate::scan::{Event, Scan, ScanError};
pub use join::Row;

pub use mapping::{CurrentSign, Mapping, MappingError, RobotMapping, TimeSource};
pub use report::{Imported, RobotReport, TopicReport, Unusable};

/// Why a recording cannot be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// It is no MCAP file, or cannot be read.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// A topic of the mapping is not in the file, or cannot be used.
    #[error("topic {topic:?}: {why}")]
    Topic {
        /// The topic.
        topic: String,
        /// Why not.
        why: String,
    },
    /// Nothing says which topics are a robot's.
    #[error("{what}; name them with options or a mapping file")]
    Choice {
        /// What is ambiguous.
        what: String,
    },
    /// No two robots may have the same name.
    #[error("two robots named {name:?}; give them names of their own in a mapping file")]
    TwoOfAName {
        /// The name.
        name: String,
    },
}

/// A channel of the file.
#[derive(Debug, Clone)]
struct Channel {
    topic: String,
    type_name: String,
    encoding: String,
    kind: Result<RosType, crate::ros::RosError>,
    messages: u64,
}

/// Reads a recording.
///
/// # Errors
/// [`ImportError`]. A damaged file is read as far as it can be; [`Imported::damage`] says so.
pub fn import(
    mut input: impl Read + Seek,
    name: &str,
    mapping: &Mapping,
) -> Result<Imported, ImportError> {
    let (channels, _) = channels(&mut input)?;
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
    let damage = read_tracks(&mut input, &mut tracks)?;
    Ok(report::imported(tracks, &channels, damage))
}

fn rewind(input: &mut impl Seek) -> Result<(), ScanError> {
    let io = |source| ScanError::Io {
        place: crate::scan::Place::top(0),
        source,
    };
    input.seek(SeekFrom::Start(0)).map(|_| ()).map_err(io)
}

/// The channels of a file with their messages, and what is damaged.
fn channels(input: &mut (impl Read + Seek)) -> Result<(Vec<Channel>, Vec<String>), ScanError> {
    let mut schemas = BTreeMap::new();
    let mut channels: BTreeMap<u16, Channel> = BTreeMap::new();
    let damage = each_record(input, |record| match record {
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
    })?;
    Ok((channels.into_values().collect(), damage))
}

/// Calls `take` with every record of the data; says what is damaged.
fn each_record(
    input: &mut (impl Read + Seek),
    mut take: impl FnMut(Record<'_>),
) -> Result<Vec<String>, ScanError> {
    rewind(input)?;
    let mut scan = Scan::new(input)?;
    let mut damage = Vec::new();
    loop {
        match scan.next_event() {
            Ok(Some(Event::Record(raw))) => match raw.parse() {
                Ok(record) => take(record),
                Err(error) => damage.push(error.to_string()),
            },
            Ok(Some(Event::ChunkEnds { frame, crc })) if crc.is_wrong() => {
                damage.push(format!(
                    "byte {}: chunk: its checksum is wrong",
                    frame.offset
                ));
            }
            Ok(Some(_)) => {}
            Ok(None) => return Ok(damage),
            Err(error @ ScanError::Io { .. }) => return Err(error),
            Err(error) => {
                damage.push(error.to_string());
                if scan.resume()?.is_none() {
                    return Ok(damage);
                }
            }
        }
    }
}

fn read_tracks(
    input: &mut (impl Read + Seek),
    tracks: &mut [join::Track],
) -> Result<Vec<String>, ScanError> {
    let mut schemas = BTreeMap::new();
    let mut kinds: BTreeMap<u16, (String, RosType)> = BTreeMap::new();
    each_record(input, |record| match record {
        Record::Schema { header, data } => {
            schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
        }
        Record::Channel(channel) => {
            let Some((type_name, encoding, data)) = schemas.get(&channel.schema_id) else {
                return;
            };
            if let Ok(kind) = RosType::of(&channel.message_encoding, type_name, encoding, data) {
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
    })
}
