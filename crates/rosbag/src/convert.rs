//! The messages of a bag, written as MCAP.

use std::collections::BTreeMap;
use std::path::Path;

use joulebus_capture::{RosFile, RosTopic, RosTopicId, WriteError};

use crate::bag::{Bag, BagError, Definition, MOST_BYTES, Row};

/// What a message that rosbag2 compressed begins with (`--compression-mode message`); CDR begins with 0.
const ZSTD_MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// Errors of a conversion.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ConvertError {
    /// The bag.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The result.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// A topic as it is written.
struct Written {
    id: RosTopicId,
    /// Messages of other types lose their contents.
    is_imported: bool,
}

/// Writes the messages of `bag` into the file `out`, which must not exist. Returns how many messages were left out, by
/// reason; what follows damage counts as one.
///
/// # Errors
/// [`ConvertError`].
pub(crate) fn convert(bag: &Path, out: &Path) -> Result<BTreeMap<String, u64>, ConvertError> {
    let bag = Bag::open(bag)?;
    let (topics, definitions) = (bag.topics()?, bag.definitions()?);
    let mut file = RosFile::create(out)?;
    let mut written = BTreeMap::new();
    let unknown = Definition::default();
    for topic in &topics {
        let definition = definitions.get(&topic.type_name).unwrap_or(&unknown);
        // A definition of another kind is none that could be compared, as one that is missing.
        let is_comparable = definition.encoding == "ros2msg";
        let topic_of_file = RosTopic {
            topic: &topic.name,
            type_name: &topic.type_name,
            encoding: &topic.encoding,
            definition_encoding: "ros2msg",
            definition: match is_comparable {
                true => definition.text.as_bytes(),
                false => &[],
            },
        };
        let is_imported = topic_of_file.is_imported();
        let id = file.topic(&topic_of_file)?;
        written.insert(topic.id, Written { id, is_imported });
    }
    let mut left_out = BTreeMap::new();
    let mut leave_out = |why: String| *left_out.entry(why).or_insert(0_u64) += 1;
    bag.each_row(|row| -> Result<(), ConvertError> {
        let (topic, time_ns, data) = match row {
            Row::Message {
                topic,
                time_ns,
                data,
            } => (topic, time_ns, data),
            Row::Odd(why) => {
                leave_out(why.to_owned());
                return Ok(());
            }
            Row::Damage(why) => {
                leave_out(format!("this one and all after it: {why}"));
                return Ok(());
            }
        };
        let Some(topic) = written.get(&topic) else {
            leave_out("of a topic that the bag does not name".to_owned());
            return Ok(());
        };
        if !topic.is_imported {
            return Ok(file.message(topic.id, time_ns, &[])?);
        }
        if !data.starts_with(ZSTD_MAGIC) {
            return Ok(file.message(topic.id, time_ns, data)?);
        }
        match zstd::bulk::decompress(data, expanded_bytes(data)) {
            Ok(data) => file.message(topic.id, time_ns, &data)?,
            Err(error) => leave_out(format!("compressed: {error}")),
        }
        Ok(())
    })?;
    file.finish()?;
    Ok(left_out)
}

/// Bytes that a compressed message may have: battery states, velocities and odometry have some hundreds, and lists of cells
/// a few thousand; a thousand times its own size is more than any of them needs.
fn expanded_bytes(data: &[u8]) -> usize {
    data.len().saturating_mul(1_000).min(MOST_BYTES as usize)
}
