#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod attachments;
mod chunk;
mod clock;
mod definitions;
pub mod import;
pub mod inspect;
mod messages;
mod reader;
pub mod recover;
pub mod scan;
mod writer;

pub use attachments::{Attached, Attachments};
pub use clock::Clock;
pub use messages::{
    Content, DecodeError, Entry, Frame, Message, MessageKind, OutOfRange, Query, RobotRow,
};
pub use reader::{ReadError, Reader};
pub use writer::{
    CaptureSettings, MAX_CHANNELS, Preset, Sequences, Times, WriteError, Writer, Written,
};
