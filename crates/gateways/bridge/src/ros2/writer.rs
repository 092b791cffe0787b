//! Writers of encoded messages: of DDS, and of the child that has zenoh.

use std::io::{self, Write as _};
use std::process::ChildStdin;
use std::sync::{Arc, Mutex, PoisonError};

use rustdds::no_key::DataWriter;
use rustdds::{GUID, RTPSEntity as _};

use crate::ros2::raw::Raw;

pub(super) type DdsWriter = DataWriter<Vec<u8>, Raw>;

/// A writer of encoded messages.
pub(crate) enum Writer {
    Dds(Box<DdsWriter>),
    Zenoh(ZenohWriter),
}

impl Writer {
    /// Its id in DDS.
    pub(super) fn guid(&self) -> Option<GUID> {
        match self {
            Self::Dds(writer) => Some(writer.guid()),
            Self::Zenoh(_) => None,
        }
    }

    /// Whether the message is on its way.
    pub(super) fn write(&self, message: Vec<u8>) -> bool {
        match self {
            Self::Dds(writer) => writer.write(message, None).is_ok(),
            Self::Zenoh(writer) => writer.write(&message).is_ok(),
        }
    }
}

/// The input of the child, and the topic that is written.
pub(super) struct ZenohWriter {
    pub(super) input: Arc<Mutex<ChildStdin>>,
    pub(super) topic: u32,
}

impl ZenohWriter {
    fn write(&self, message: &[u8]) -> io::Result<()> {
        let mut input = self.input.lock().unwrap_or_else(PoisonError::into_inner);
        // The encapsulation says that the message is CDR in little endian. DDS adds it by itself.
        let mut head = [0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0];
        head[..4].copy_from_slice(&self.topic.to_le_bytes());
        head[4..8].copy_from_slice(&(4 + message.len() as u32).to_le_bytes());
        input.write_all(&head)?;
        input.write_all(message)
    }
}
