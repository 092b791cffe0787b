//! A planner that reports to a test everything it reads.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use joulebus_wire::{Forecasts, Quality, Sample};

use crate::{Answer, Child, Ended, FrameRead, PATIENCE, ReaderLine, Source, answer};

/// First answers to samples, by robot and sample number.
pub type Answers = BTreeMap<(u32, u64), Answer>;

/// Interval of checking whether a source has exited.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// A planner or recorder in a separate process.
#[derive(Debug)]
pub struct Planner {
    pub child: Child,
    lines: Vec<ReaderLine>,
    at: usize,
}

impl Planner {
    /// Wraps a process that prints the lines of the probe's readers; does not wait.
    pub const fn new(child: Child) -> Self {
        Self { child, lines: Vec::new(), at: 0 }
    }

    pub(crate) fn ready(child: Child) -> Self {
        let mut planner = Self::new(child);
        planner.until("it has joined", |line| matches!(line, ReaderLine::Ready).then_some(()));
        planner
    }

    /// Reads until `look` returns something for a line, and returns that. Later calls continue
    /// after that line.
    pub fn until<T>(&mut self, what: &str, look: impl FnMut(&ReaderLine) -> Option<T>) -> T {
        self.read_on(None, what, look)
    }

    /// Same as [`Self::until`], but fails at once with the output of `source` if it has exited.
    pub fn until_beside<T>(
        &mut self,
        source: &mut Child,
        what: &str,
        look: impl FnMut(&ReaderLine) -> Option<T>,
    ) -> T {
        self.read_on(Some(source), what, look)
    }

    fn read_on<T>(
        &mut self,
        mut source: Option<&mut Child>,
        what: &str,
        mut look: impl FnMut(&ReaderLine) -> Option<T>,
    ) -> T {
        let begin = Instant::now();
        loop {
            while self.at < self.lines.len() {
                self.at += 1;
                if let Some(found) = look(&self.lines[self.at - 1]) {
                    return found;
                }
            }
            let left = PATIENCE.saturating_sub(begin.elapsed());
            let is_over = match &mut source {
                None => self.fetch(left) == 0,
                Some(source) => {
                    assert!(source.is_running(), "without a source: {what}; {}", source.tail());
                    self.fetch(left.min(POLL_INTERVAL)) == 0 && !self.child.is_running()
                }
            };
            if left.is_zero() || is_over {
                panic!("timeout of {:?}: {what}; {}", begin.elapsed(), self.child.tail());
            }
        }
    }

    /// Reads until `look` returns something for a frame of forecasts.
    pub fn forecast<T>(
        &mut self,
        what: &str,
        mut look: impl FnMut(&FrameRead<Forecasts>) -> Option<T>,
    ) -> T {
        self.until(what, |line| match line {
            ReaderLine::Forecasts(frame) => look(frame),
            _ => None,
        })
    }

    /// Reads until `is_it` holds for the quality of a robot.
    pub fn quality(&mut self, what: &str, robot: u32, is_it: impl Fn(Quality) -> bool) {
        self.forecast(what, |frame| is_it(frame.robot(robot)?.quality()).then_some(()));
    }

    /// Reads until each of `samples` is the newest one answered by its robot's forecast.
    pub fn answered(&mut self, samples: &[Sample]) -> FrameRead<Forecasts> {
        self.forecast("the samples are answered", |frame| {
            let is_answered = |sample: &Sample| {
                let line = frame.robot(sample.robot);
                line.is_some_and(|line| {
                    (line.sample_seq, line.stamp_ns) == (sample.seq, sample.stamp_ns)
                })
            };
            samples.iter().all(is_answered).then(|| frame.clone())
        })
    }

    /// Sends frame after frame, each once the previous one has been answered.
    pub fn play(&mut self, source: &mut Source, frames: &[Vec<Sample>]) {
        for frame in frames {
            source.send(frame);
            self.answered(frame);
        }
    }

    /// All lines read so far.
    pub fn seen(&mut self) -> &[ReaderLine] {
        self.fetch(Duration::ZERO);
        &self.lines
    }

    /// All frames of forecasts read so far.
    pub fn forecasts(&mut self) -> impl Iterator<Item = &FrameRead<Forecasts>> {
        self.seen().iter().filter_map(|line| match line {
            ReaderLine::Forecasts(frame) => Some(frame),
            _ => None,
        })
    }

    /// First answers to samples in corrected mode, of the robots selected by `is_one`. Open-loop
    /// forecasts by the worker's clock are provisional and omitted.
    pub fn answers(&mut self, is_one: impl Fn(u32) -> bool) -> Answers {
        let mut answers = Answers::new();
        for line in self.forecasts().flat_map(|frame| &frame.robots) {
            let answered =
                matches!(line.quality(), Quality::Fresh | Quality::Held | Quality::Warmup { .. });
            if answered && line.stamp_ns > 0 && is_one(line.robot) {
                answers.entry((line.robot, line.sample_seq)).or_insert_with(|| answer(line));
            }
        }
        answers
    }

    /// Closes its stdin and waits for the exit.
    pub fn leave(mut self) -> Ended {
        self.child.finish()
    }

    fn fetch(&mut self, within: Duration) -> usize {
        let lines = self.child.lines(self.lines.len(), within);
        for line in &lines {
            // The last line of a killed reader may be truncated and is ignored.
            let Ok(line) = serde_json::from_str(line) else {
                assert!(!self.child.is_running(), "invalid line: {line:?}");
                break;
            };
            self.lines.push(line);
        }
        lines.len()
    }
}
