//! Alarms that persons have acknowledged.
//!
//! A client asks with [`crate::QueryKind::Acknowledge`]. The worker publishes what is acknowledged
//! on [`crate::Acknowledgements`].

use crate::declare::ZeroCopySend;
use crate::{Alarm, rows};

/// Maximum number of acknowledgements at once: one row for each person and alarm.
pub const MAX_ACKNOWLEDGED: usize = 128;
/// Maximum number of persons who have acknowledged the same alarm, and are kept.
pub const MAX_ACKNOWLEDGED_BY: usize = 4;
/// Maximum length of a person's name, bytes.
pub const MAX_NAME_BYTES: usize = 32;

rows! {
    /// A raised alarm that a person has acknowledged: a row for each person. 48 bytes.
    #[derive(Eq)]
    pub struct Acknowledgement: "joulebus.Acknowledgement.v1", 48 {
        /// Id of the robot.
        pub robot: u32,
        /// [`Alarm`] code.
        pub alarm: u16,
        /// 0.
        pub reserved: u16,
        /// When, monotonic ns.
        #[instant]
        pub at_ns: u64,
        /// By whom: UTF-8, then zeros.
        pub by: [u8; MAX_NAME_BYTES],
    }

    /// Header of a frame of all alarms that are acknowledged. Sent at every change, and once a
    /// second.
    #[derive(Eq)]
    pub struct AcknowledgementHeader: "joulebus.AcknowledgementHeader.v1", 40 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the worker.
        pub pid: u32,
        /// Run of the thread that takes acknowledgements.
        #[run]
        pub server_epoch: u64,
        /// Number of the frame, from 1.
        pub number: u64,
        /// When the frame was sent, monotonic ns.
        #[instant]
        pub sent_ns: u64,
        /// When the frame was sent, Unix ns.
        pub sent_unix_ns: u64,
    }
}

impl Acknowledgement {
    /// An acknowledgement of one alarm. `None` if the name is empty, longer than
    /// [`MAX_NAME_BYTES`] or has control characters.
    #[must_use]
    pub fn new(robot: u32, alarm: Alarm, at_ns: u64, name: &str) -> Option<Self> {
        let mut by = [0; MAX_NAME_BYTES];
        by.get_mut(..name.len())?.copy_from_slice(name.as_bytes());
        let is_name = !name.trim().is_empty() && !name.contains(char::is_control);
        is_name.then_some(Self { robot, alarm: alarm.code(), reserved: 0, at_ns, by })
    }

    /// The alarm.
    pub const fn alarm(&self) -> Alarm {
        Alarm::decode(self.alarm)
    }

    /// By whom.
    pub fn by(&self) -> &str {
        text(&self.by)
    }
}

/// Text in shared memory: what is valid UTF-8 before the first zero.
#[must_use]
pub fn text(bytes: &[u8]) -> &str {
    let bytes = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
    bytes.utf8_chunks().next().map_or("", |chunk| chunk.valid())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_kept_whole_or_refused() {
        for name in ["ann", "Zoë  K.", &"x".repeat(32), &"ω".repeat(16)] {
            let made = Acknowledgement::new(7, Alarm::BiasHigh, 5, name).unwrap();
            assert_eq!((made.by(), made.alarm()), (name, Alarm::BiasHigh));
        }
        for name in ["", " ", "a\nb", "\0", &"x".repeat(33), &"ω".repeat(17)] {
            assert_eq!(Acknowledgement::new(7, Alarm::BiasHigh, 5, name), None);
        }
        assert_eq!((text(b"ann\0x"), text(b"an\xff"), text(b"")), ("ann", "an", ""));
    }
}
