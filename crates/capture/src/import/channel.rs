//! A channel of a recording.

use crate::ros::{RosError, RosType};

/// A channel of the file.
#[derive(Debug, Clone)]
pub(super) struct Channel {
    pub(super) topic: String,
    pub(super) type_name: String,
    pub(super) encoding: String,
    pub(super) kind: Result<RosType, RosError>,
    pub(super) messages: u64,
}
