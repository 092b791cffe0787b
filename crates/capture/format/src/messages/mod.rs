//! Messages of a capture: the frames in shared memory.

mod codec;
mod descriptors;
mod frame;
mod kind;
mod message;
mod query;
mod table;
pub(crate) mod wire_fields;

pub use codec::OutOfRange;
pub use frame::{Frame, RobotRow};
pub use message::{Content, DecodeError, Entry, Message, MessageKind};
pub use query::Query;
