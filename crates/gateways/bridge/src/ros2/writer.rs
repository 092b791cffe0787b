//! Writers of encoded messages: of DDS, and of the child that has zenoh.

use std::io::{self, Write as _};
use std::process::ChildStdin;
use std::sync::{Arc, Mutex, PoisonError};

use rustdds::no_key::DataWriter;
use rustdds::{SampleIdentity, WriteOptionsBuilder};

use crate::ros2::raw::Raw;

pub(crate) type DdsWriter = DataWriter<Vec<u8>, Raw>;

/// A writer of encoded messages.
pub(crate) enum Writer {
    Dds(Box<DdsWriter>),
    Zenoh(ZenohWriter),
}

/// The client of a service whose request is answered.
pub(crate) enum Client {
    /// Fast DDS and others: the response names the request beside its bytes.
    Sample(SampleIdentity),
    /// Cyclone DDS: the response begins with the header of the request, in little endian.
    Header([u8; 16]),
    /// The number of the child's query.
    Query(u64),
}

impl Client {
    /// Names the program, as far as the request does: a client of zenoh by a part of its number.
    pub(super) fn program(&self) -> [u8; 12] {
        let mut name = [0; 12];
        match self {
            Self::Sample(request) => {
                name.copy_from_slice(&request.writer_guid.to_bytes()[..12]);
            }
            Self::Header(header) => name[..8].copy_from_slice(&header[..8]),
            Self::Query(number) => name[..2].copy_from_slice(&number.to_be_bytes()[..2]),
        }
        name
    }
}

impl Writer {
    /// True if the message is on its way.
    pub(super) fn write(&self, message: Vec<u8>) -> bool {
        match self {
            Self::Dds(writer) => writer.write(message, None).is_ok(),
            Self::Zenoh(writer) => writer.write(&[], &message).is_ok(),
        }
    }

    /// Writes a response. Returns whether it is on its way.
    pub(super) fn reply(&self, client: &Client, message: Vec<u8>) -> bool {
        match (self, client) {
            (Self::Dds(writer), Client::Sample(request)) => {
                let options = WriteOptionsBuilder::new().related_sample_identity(*request).build();
                writer.write_with_options(message, options).is_ok()
            }
            (_, Client::Header(header)) => self.write([header.as_slice(), &message].concat()),
            (Self::Zenoh(writer), Client::Query(number)) => {
                writer.write(&number.to_le_bytes(), &message).is_ok()
            }
            _ => false,
        }
    }
}

/// The input of the child, and the topic or service that is written.
pub(crate) struct ZenohWriter {
    pub(super) input: Arc<Mutex<ChildStdin>>,
    pub(super) topic: u32,
}

impl ZenohWriter {
    /// Writes a frame: the number of a query, if it is a response, and the message.
    fn write(&self, number: &[u8], message: &[u8]) -> io::Result<()> {
        let mut input = self.input.lock().unwrap_or_else(PoisonError::into_inner);
        // The encapsulation states that the message is CDR in little endian. DDS adds it by itself.
        let encapsulation = [0, 1, 0, 0];
        let length = number.len() + encapsulation.len() + message.len();
        input.write_all(&self.topic.to_le_bytes())?;
        input.write_all(&(length as u32).to_le_bytes())?;
        input.write_all(&[number, &encapsulation].concat())?;
        input.write_all(message)
    }
}
