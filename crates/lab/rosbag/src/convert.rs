//! The messages of a bag, written as MCAP.

use std::collections::BTreeMap;

use joulebus_capture_format::import::unpacked;
use joulebus_capture_format::{RosFile, RosTopic, RosTopicId, WriteError};

use crate::bag::{Bag, BagError, Definition, Row};

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

/// Reason that a part of a bag is not in the result.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct LeftOut {
    /// `topics` or `messages`.
    pub(crate) what: &'static str,
    pub(crate) why: String,
}

/// Writes the messages of `bag` into `file`. Returns the number of omitted messages by reason.
/// Everything after damage counts as one message.
///
/// # Errors
/// [`ConvertError`].
pub(crate) fn convert(
    bag: &Bag,
    mut file: RosFile,
) -> Result<BTreeMap<LeftOut, u64>, ConvertError> {
    let (topics, definitions) = (bag.topics()?, bag.definitions()?);
    let mut left_out = BTreeMap::new();
    if topics.odd > 0 {
        let why = "id is no integer, or name, type or encoding no text".to_owned();
        let what = "topics";
        left_out.insert(LeftOut { what, why }, topics.odd);
    }
    let definitions: BTreeMap<_, _> = definitions.rows.into_iter().collect();
    let mut written = BTreeMap::new();
    let unknown = Definition::default();
    for topic in &topics.rows {
        let definition = definitions.get(&topic.type_name).unwrap_or(&unknown);
        // Only ros2msg definitions can be compared. Others count as missing.
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
    let mut leave_out = |why: String| {
        let what = "messages";
        *left_out.entry(LeftOut { what, why }).or_insert(0) += 1;
    };
    bag.each_row(|row| -> Result<(), ConvertError> {
        let (topic, time_ns, data) = match row {
            Row::Message { topic, time_ns, data } => (topic, time_ns, data),
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
        match unpacked(data) {
            Ok(data) => file.message(topic.id, time_ns, &data)?,
            Err(error) => leave_out(format!("compressed: {error}")),
        }
        Ok(())
    })?;
    file.finish()?;
    Ok(left_out)
}
