//! Watches a port of another process that sends frames.

use std::fs;
use std::path::PathBuf;

use super::Member;
use crate::cleanup::objects::named;

/// A port that sends frames, of a process that may end at any time.
///
/// The port's memory is removed when the port is dropped. That of a killed process is removed by
/// the cleanup of a living member, within some 1.3 s. A process that is stopped keeps its own.
#[derive(Debug, Clone)]
pub struct WriterWatch {
    /// `None` if it was gone before.
    memory: Option<PathBuf>,
}

impl WriterWatch {
    pub(super) fn new(member: &Member, port: u128) -> Self {
        let mut memory = named(&member.domain, &port.to_string(), &[".data"]);
        Self { memory: memory.pop() }
    }

    /// True while the port can send frames. Does not allocate.
    pub fn is_open(&self) -> bool {
        self.memory.as_ref().is_some_and(|memory| fs::symlink_metadata(memory).is_ok())
    }
}
