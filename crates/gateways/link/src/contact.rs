//! Whether a stream of a link that is present has stopped, although this link requests it.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

/// Time without a message of a requested stream after which the session is opened anew. A link
/// sends ten statuses a second.
pub(crate) const SILENCE_TIMEOUT_NS: u64 = 5_000_000_000;
/// Maximum number of times that this time is doubled: some 40 minutes.
const MAX_DOUBLINGS: u32 = 9;
/// Time between two requests after which the stream counts as not requested. A link sends ten
/// requests a second.
const REQUEST_TIMEOUT_NS: u64 = 1_000_000_000;

/// What is known of one stream from another link. All instants are monotonic ns, 0 for never.
#[derive(Debug, Default)]
pub(crate) struct Contact {
    /// Since when the link has been present.
    present_ns: AtomicU64,
    /// When a message arrived last.
    heard_ns: AtomicU64,
    /// Since when requests have been sent without a gap, and when the last one was.
    asking_ns: AtomicU64,
    asked_ns: AtomicU64,
    /// Sessions opened anew for it since the last message.
    attempts: AtomicU32,
}

impl Contact {
    /// Notes that the link is present, or is not.
    pub(crate) fn present(&self, is_present: bool, now_ns: u64) {
        if !is_present {
            self.present_ns.store(0, Ordering::Release);
        } else if self.present_ns.load(Ordering::Acquire) == 0 {
            self.present_ns.store(now_ns, Ordering::Release);
        }
    }

    /// Notes a message of the stream.
    pub(crate) fn heard(&self, now_ns: u64) {
        self.heard_ns.store(now_ns, Ordering::Release);
        self.attempts.store(0, Ordering::Release);
    }

    /// Notes a request for the stream.
    pub(crate) fn asked(&self, now_ns: u64) {
        let before_ns = self.asked_ns.swap(now_ns, Ordering::AcqRel);
        if now_ns.saturating_sub(before_ns) > REQUEST_TIMEOUT_NS {
            self.asking_ns.store(now_ns, Ordering::Release);
        }
    }

    /// True if the link is present, has sent to this one before, and has not answered requests for
    /// too long. The time doubles with each session that did not help: the link may have another
    /// file now, and other links lose their connection meanwhile.
    pub(crate) fn is_split(&self, now_ns: u64) -> bool {
        let [present_ns, heard_ns, asking_ns, asked_ns] =
            [&self.present_ns, &self.heard_ns, &self.asking_ns, &self.asked_ns]
                .map(|instant| instant.load(Ordering::Acquire));
        let is_asking = now_ns.saturating_sub(asked_ns) <= REQUEST_TIMEOUT_NS;
        let silent_ns = now_ns.saturating_sub(heard_ns.max(asking_ns).max(present_ns));
        let doublings = self.attempts.load(Ordering::Acquire).min(MAX_DOUBLINGS);
        let is_silent = silent_ns > SILENCE_TIMEOUT_NS << doublings;
        present_ns > 0 && heard_ns > 0 && is_asking && is_silent
    }

    /// Notes that the session ends, on account of this stream if it is split. In another one the
    /// link is not present yet.
    pub(crate) fn ends(&self, now_ns: u64) {
        if self.is_split(now_ns) {
            self.attempts.fetch_add(1, Ordering::AcqRel);
        }
        self.present(false, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;
    const STEP_NS: u64 = SECOND_NS / 10;

    /// Requests and, until `heard_until_ns`, messages, every tenth of a second.
    fn played(contact: &Contact, (from_ns, until_ns): (u64, u64), heard_until_ns: u64) -> bool {
        let mut is_split = false;
        for now_ns in (from_ns..until_ns).step_by(STEP_NS as usize) {
            contact.asked(now_ns);
            if now_ns < heard_until_ns {
                contact.heard(now_ns);
            }
            is_split |= contact.is_split(now_ns);
        }
        is_split
    }

    #[test]
    fn a_stream_that_stops_while_its_link_is_present_is_split_and_one_that_never_came_is_not() {
        let contact = Contact::default();
        contact.present(true, 1);
        assert!(!played(&contact, (SECOND_NS, 30 * SECOND_NS), 0), "it has another file");
        assert!(!played(&contact, (30 * SECOND_NS, 60 * SECOND_NS), 60 * SECOND_NS), "it sends");
        assert!(!played(&contact, (60 * SECOND_NS, 64 * SECOND_NS), 0), "for less than the bound");
        // It announces itself again: a repetition is no new presence.
        contact.present(true, 64 * SECOND_NS);
        assert!(played(&contact, (64 * SECOND_NS, 66 * SECOND_NS), 0));
        contact.present(false, 66 * SECOND_NS);
        assert!(!played(&contact, (66 * SECOND_NS, 90 * SECOND_NS), 0), "it is gone");
    }

    #[test]
    fn each_session_that_does_not_help_doubles_the_time_until_the_next_one() {
        let contact = Contact::default();
        contact.present(true, 1);
        assert!(!played(&contact, (SECOND_NS, 2 * SECOND_NS), 2 * SECOND_NS));
        let mut now_ns = 2 * SECOND_NS;
        for time_s in [5, 10, 20, 40] {
            let until_ns = now_ns + time_s * SECOND_NS;
            assert!(!played(&contact, (now_ns, until_ns), 0), "{time_s}");
            assert!(played(&contact, (until_ns, until_ns + SECOND_NS), 0), "{time_s}");
            now_ns = until_ns + SECOND_NS;
            contact.ends(now_ns);
            contact.present(true, now_ns);
        }
        // A message shows that the last one has helped.
        assert!(!played(&contact, (now_ns, now_ns + SECOND_NS), now_ns + SECOND_NS));
        now_ns += SECOND_NS;
        assert!(played(&contact, (now_ns, now_ns + 6 * SECOND_NS), 0));
        for _ in 0..100 {
            contact.ends(now_ns + 9_999 * SECOND_NS);
            contact.present(true, now_ns);
            let _ = contact.is_split(u64::MAX);
        }
    }

    #[test]
    fn a_silence_counts_only_while_this_link_requests() {
        let contact = Contact::default();
        contact.present(true, 1);
        assert!(!played(&contact, (SECOND_NS, 9 * SECOND_NS), 9 * SECOND_NS));
        // This process was stopped for a minute.
        assert!(!contact.is_split(70 * SECOND_NS));
        assert!(!played(&contact, (70 * SECOND_NS, 75 * SECOND_NS), 0));
        assert!(played(&contact, (75 * SECOND_NS, 77 * SECOND_NS), 0));
    }
}
