//! Ports of a member.

mod connection_leak;
mod degradation;
mod open;
mod places;
mod poll;
mod query;
mod reader;
mod readiness;
mod reading;
mod repair;
mod samples;
mod service;
mod wait;
mod writer;

use self::places::Open;
pub use self::poll::Poller;
pub use self::query::{OpenQuery, QueryClient, QueryError, QueryServer};
use self::reader::{Member, Noted, Received};
pub use self::reader::{Reader, ReceiveError};
pub use self::readiness::Readiness;
pub use self::reading::{Frame, KeptFrame};
pub use self::samples::{FrameBuf, IncomingFrame, SampleReader, SampleWriter};
pub use self::service::OpenError;
pub use self::wait::{WaitError, Waiter, Waker, Woken};
pub use self::writer::{Loan, SendError, Sent, Writer};
