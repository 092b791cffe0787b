//! Flow control: frames that the worker has not answered yet.
//!
//! A forecast of one of a frame's samples, or of a later frame's, answers the frame, because the
//! worker takes frames as a whole and in order. If every sample of a frame was refused, there is no
//! forecast. The frame then counts as answered when two ticks have begun after it was sent, because
//! the second one took everything sent before the first.

use std::collections::{HashMap, VecDeque};

use joulebus_wire::Sample;

/// Frames sent and not yet answered.
#[derive(Debug)]
pub struct Window {
    max_frames: usize,
    max_samples: usize,
    frames: VecDeque<Outstanding>,
    answered: HashMap<u32, u64>,
    /// Start of the tick before the last one seen.
    before_last_ns: u64,
    last_ns: u64,
}

#[derive(Debug)]
struct Outstanding {
    sent_ns: u64,
    robots: HashMap<u32, OfRobot>,
}

#[derive(Debug, Default)]
struct OfRobot {
    last_seq: u64,
    samples: usize,
}

impl Window {
    /// A window of at most `max_frames` frames, with at most `max_samples` samples of a robot in
    /// them.
    #[must_use]
    pub fn new(max_frames: usize, max_samples: usize) -> Self {
        Self {
            max_frames,
            max_samples,
            frames: VecDeque::new(),
            answered: HashMap::new(),
            before_last_ns: 0,
            last_ns: 0,
        }
    }

    /// True if the frame can be sent without overflowing anything. Always true when nothing is
    /// outstanding, because waiting would not help.
    #[must_use]
    pub fn has_capacity(&self, frame: &[Sample]) -> bool {
        if self.frames.is_empty() {
            return true;
        }
        let fits = |(robot, of_frame): (&u32, &OfRobot)| {
            let outstanding = self.frames.iter().filter_map(|sent| sent.robots.get(robot));
            let samples: usize = outstanding.map(|of_robot| of_robot.samples).sum();
            samples + of_frame.samples <= self.max_samples
        };
        self.frames.len() < self.max_frames && by_robot(frame).iter().all(fits)
    }

    /// Records a frame sent at `sent_ns`.
    pub fn sent(&mut self, frame: &[Sample], sent_ns: u64) {
        self.frames.push_back(Outstanding { sent_ns, robots: by_robot(frame) });
    }

    /// Records that a tick that began at `started_ns` has answered these robots' samples.
    pub fn answered(&mut self, started_ns: u64, robots: impl Iterator<Item = (u32, u64)>) {
        self.answered.extend(robots);
        self.before_last_ns = self.last_ns;
        self.last_ns = started_ns;
        let is_answered = |frame: &Outstanding| {
            let answered = |robot: &u32| self.answered.get(robot).copied();
            let mut robots = frame.robots.iter();
            frame.sent_ns < self.before_last_ns
                || robots.any(|(robot, sent)| answered(robot) >= Some(sent.last_seq))
        };
        // An answer to a frame answers the earlier ones too.
        let newest = self.frames.iter().rposition(is_answered);
        self.frames.drain(..newest.map_or(0, |newest| newest + 1));
    }

    /// Frames that are not answered yet.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True if every frame is answered.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// The worker is gone, with everything that it had not answered. Returns the number of frames.
    pub fn forget(&mut self) -> u64 {
        let lost = self.frames.len() as u64;
        *self = Self::new(self.max_frames, self.max_samples);
        lost
    }
}

fn by_robot(frame: &[Sample]) -> HashMap<u32, OfRobot> {
    let mut robots = HashMap::<u32, OfRobot>::with_capacity(frame.len());
    for sample in frame {
        let robot = robots.entry(sample.robot).or_default();
        robot.last_seq = robot.last_seq.max(sample.seq);
        robot.samples += 1;
    }
    robots
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(samples: &[(u32, u64)]) -> Vec<Sample> {
        let sample = |(robot, seq): &(u32, u64)| Sample::new(*robot, *seq, *seq);
        samples.iter().map(sample).collect()
    }

    #[test]
    fn the_number_of_frames_in_flight_is_limited() {
        let mut window = Window::new(2, 8);
        for seq in 0..2 {
            assert!(window.has_capacity(&frame(&[(1, seq)])));
            window.sent(&frame(&[(1, seq)]), 10 + seq);
        }
        assert!(!window.has_capacity(&frame(&[(1, 2)])), "two are outstanding");
        window.answered(5, [(1, 0)].into_iter());
        assert!(window.has_capacity(&frame(&[(1, 2)])), "the first was answered");
        assert_eq!(window.len(), 1);
    }

    #[test]
    fn the_number_of_samples_in_flight_per_robot_is_limited() {
        let mut window = Window::new(8, 3);
        window.sent(&frame(&[(1, 0), (1, 1), (2, 0)]), 10);
        assert!(window.has_capacity(&frame(&[(1, 2), (2, 1)])));
        assert!(!window.has_capacity(&frame(&[(1, 2), (1, 3)])), "four of robot 1");
        window.answered(5, [(2, 0)].into_iter());
        assert!(window.has_capacity(&frame(&[(1, 2), (1, 3)])));
        // A frame that could never fit is not waited for.
        assert!(window.has_capacity(&frame(&[(1, 2), (1, 3), (1, 4), (1, 5)])));
    }

    #[test]
    fn a_refused_frame_is_answered_by_a_later_frame_or_by_two_ticks() {
        let mut window = Window::new(4, 8);
        window.sent(&frame(&[(1, 0)]), 10);
        window.sent(&frame(&[(1, 1)]), 20);
        window.answered(15, [(1, 1)].into_iter());
        assert_eq!(window.len(), 0, "the later one was answered");

        window.sent(&frame(&[(9, 0)]), 30);
        for (started_ns, left) in [(25, 1), (31, 1), (64, 0)] {
            window.answered(started_ns, [(1, 1)].into_iter());
            assert_eq!(window.len(), left, "tick at {started_ns}");
        }
    }

    #[test]
    fn frames_unanswered_by_a_dead_worker_are_counted() {
        let mut window = Window::new(4, 8);
        window.sent(&frame(&[(1, 7)]), 10);
        window.sent(&frame(&[(1, 8)]), 20);
        assert_eq!(window.forget(), 2);
        assert_eq!(window.len(), 0);
        // An answer of the dead worker does not count for the next.
        window.sent(&frame(&[(1, 9)]), 30);
        window.answered(31, std::iter::empty());
        assert_eq!(window.len(), 1);
    }
}
