//! Captures: what went through a fleet's shared memory, in a file that explains itself. The only
//! crate that names mcap.
//!
//! A capture is an MCAP file with protobuf messages; the schemas, the config, the models and the
//! build are in it. It opens in Foxglove and PlotJuggler as it is. One channel per fleet and service,
//! `joulebus/<fleet>/samples` and so on, and if wanted channels of single robots for plots,
//! `joulebus/<fleet>/robot/<id>/forecast`.
//!
//! | part | what it does |
//! |---|---|
//! | [`Writer`] | messages to a file; what was written survives whatever happens next |
//! | [`Reader`] | a file to messages, in little memory however long it is |
//! | [`record`] | shared memory to files, whatever the disk does |
//! | [`verify`] | everything that was published computed again, bit for bit |
//! | [`Attachments`] | config, models and build, so that the file can be replayed on its own |
//!
//! **Bits.** Every field of the payloads in [`joulebus_wire`] is in the message, and comes back as
//! the same bits: −0 and the payload of a NaN as well.
//!
//! **Time.** A message's log time is when the recorder knew of it, its publish time when it was sent;
//! both are Unix ns, made of the monotonic clock by adding an offset that is fixed when the
//! recording begins ([`Clock`]). So they are in order even if the wall clock jumps. The monotonic
//! times themselves are in the messages.
#![forbid(unsafe_code)]

mod attachments;
mod chunk;
mod clock;
pub mod import;
pub mod inspect;
mod messages;
mod reader;
pub mod record;
pub mod recover;
pub mod ros;
pub mod scan;
pub mod verify;
mod writer;

pub use attachments::{AttachError, Attached, Attachments};
pub use clock::Clock;
pub use inspect::values;
pub use messages::{DecodeError, Entry, Message, MessageKind, OutOfRange};
pub use reader::{ReadError, Reader};
pub use writer::{
    CaptureFile, CaptureSettings, Preset, Sequences, Times, WriteError, Writer, Written,
};
