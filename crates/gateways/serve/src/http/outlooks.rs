//! Outlooks, which the worker computes only while a program reads them.

use joulebus_board::{Board, Reading};
use joulebus_wire::Outlook;

use super::shares::Reply;

/// The newest outlooks must arrive within this time, ns.
const PATIENCE_NS: u64 = 1_000_000_000;
/// Time without a request after which the reader leaves the service, ns: longer than the interval
/// of most scrapers.
const LEAVE_AFTER_NS: u64 = 90_000_000_000;

#[derive(Default)]
pub(super) struct OutlookRequests {
    waiting: Vec<(Option<u32>, Reply<Vec<Outlook>>, u64)>,
    wanted_until_ns: u64,
}

impl OutlookRequests {
    /// One robot's, or those of all robots that are there, which the next request finds. An empty
    /// list if they do not arrive.
    pub(super) fn ask(&mut self, robot: Option<u32>, reply: Reply<Vec<Outlook>>, now_ns: u64) {
        self.wanted_until_ns = now_ns + LEAVE_AFTER_NS;
        self.waiting.push((robot, reply, now_ns + PATIENCE_NS));
    }

    /// True if a client waits for an answer.
    pub(super) const fn are_asked(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Answers what can be answered.
    pub(super) fn poll(&mut self, reading: &mut Reading, board: &Board, now_ns: u64) {
        // With too many readers the answers stay empty. Places become free again.
        let opened = reading.want_outlooks(now_ns < self.wanted_until_ns);
        if let Err(error) = opened {
            tracing::debug!(%error, "outlooks cannot be read");
        }
        let outlooks = &board.outlooks;
        self.waiting.retain(|(_, reply, _)| reply.is_wanted());
        for (robot, reply, until_ns) in std::mem::take(&mut self.waiting) {
            if outlooks.is_empty() && robot.is_some() && now_ns < until_ns {
                self.waiting.push((robot, reply, until_ns));
                continue;
            }
            let found = match robot {
                Some(robot) => outlooks.get(&robot).copied().into_iter().collect(),
                None => outlooks.values().copied().collect(),
            };
            reply.send(found);
        }
    }
}
