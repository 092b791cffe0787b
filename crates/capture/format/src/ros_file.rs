//! Messages of ROS 2 as an MCAP file: what programs write that read recordings of other kinds, for
//! [`import_files`](crate::import::import_files).

use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::BufWriter;

use mcap::records::MessageHeader;

use crate::writer::{WriteError, reason};
use joulebus_ros_messages::RosType;

/// Writes such a file, uncompressed.
pub struct RosFile {
    writer: mcap::Writer<BufWriter<File>>,
}

impl fmt::Debug for RosFile {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("RosFile").finish_non_exhaustive()
    }
}

/// A topic of a recording.
#[derive(Debug, Clone, Copy)]
pub struct RosTopic<'a> {
    /// Its name.
    pub topic: &'a str,
    /// The type of its messages, such as `sensor_msgs/msg/BatteryState`.
    pub type_name: &'a str,
    /// The encoding of its messages. `cdr` can be imported.
    pub encoding: &'a str,
    /// The encoding of the definition.
    pub definition_encoding: &'a str,
    /// The definition of the type. Empty if it is unknown.
    pub definition: &'a [u8],
}

impl RosTopic<'_> {
    /// True if messages of this type can be imported.
    #[must_use]
    pub fn is_imported(&self) -> bool {
        let (encoding, definition) = (self.definition_encoding, self.definition);
        RosType::new(self.encoding, self.type_name, encoding, definition).is_ok()
    }
}

/// Number of a topic in its file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RosTopicId(u16);

impl RosFile {
    /// Writes into `file`, which is empty.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn in_file(file: File) -> Result<Self, WriteError> {
        let options = mcap::WriteOptions::new().profile("ros2").compression(None);
        let writer = options.create(BufWriter::new(file)).map_err(|error| failed(&error))?;
        Ok(Self { writer })
    }

    /// Adds a topic.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn topic(&mut self, topic: &RosTopic<'_>) -> Result<RosTopicId, WriteError> {
        let schema =
            self.writer.add_schema(topic.type_name, topic.definition_encoding, topic.definition);
        let schema = schema.map_err(|error| failed(&error))?;
        let id = self.writer.add_channel(schema, topic.topic, topic.encoding, &BTreeMap::new());
        id.map(RosTopicId).map_err(|error| failed(&error))
    }

    /// Adds a message that was received at `log_ns` (Unix time).
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn message(&mut self, id: RosTopicId, log_ns: u64, data: &[u8]) -> Result<(), WriteError> {
        let header =
            MessageHeader { channel_id: id.0, sequence: 0, log_time: log_ns, publish_time: log_ns };
        let written = self.writer.write_to_known_channel(&header, data);
        written.map_err(|error| failed(&error))
    }

    /// Ends the file.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(mut self) -> Result<(), WriteError> {
        self.writer.finish().map(drop).map_err(|error| failed(&error))
    }
}

fn failed(error: &mcap::McapError) -> WriteError {
    WriteError::Failed { reason: reason(error) }
}
