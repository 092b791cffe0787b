//! Times of rows, and stamps beside the time of recording.

use crate::sizes::Sizes;

/// Rows before their times count.
pub(crate) const MIN_ROWS: u64 = 20;
/// Rows a second that a robot may report: of times whose unit nothing states, and of others.
pub(crate) const RATE_HZ: (f64, f64) = (0.05, 1_100.0);
pub(crate) const STATED_RATE_HZ: (f64, f64) = (2.5e-4, 20_000.0);
/// Share of rows whose time repeats or goes back, beyond which too few are left.
const MAX_LOST: f64 = 0.2;
/// Stamps kept from each end of a topic.
const KEPT: usize = 32;
/// Difference of two clocks beyond which they must not be mixed, s.
const MAX_OFFSET_S: f64 = 0.1;

#[derive(Debug, Clone)]
pub(crate) struct Times {
    pub(crate) rows: u64,
    pub(crate) latest_s: f64,
    pub(crate) steps: Sizes,
    pub(crate) repeated: u64,
    pub(crate) backward: u64,
    pub(crate) back_s: f64,
    whole: bool,
}

impl Times {
    pub(crate) const fn new() -> Self {
        Self {
            rows: 0,
            latest_s: f64::NEG_INFINITY,
            steps: Sizes::new(),
            repeated: 0,
            backward: 0,
            back_s: 0.0,
            whole: true,
        }
    }

    pub(crate) fn take(&mut self, time_s: f64) {
        if self.rows > 0 {
            let step_s = time_s - self.latest_s;
            self.repeated += u64::from(step_s == 0.0);
            self.backward += u64::from(step_s < 0.0);
            self.back_s = self.back_s.max(-step_s);
            if step_s > 0.0 {
                self.steps.add(step_s);
            }
        }
        self.rows += 1;
        self.whole &= time_s.fract() == 0.0;
        self.latest_s = self.latest_s.max(time_s);
    }

    pub(crate) fn rate_hz(&self) -> Option<f64> {
        self.steps.usual().map(|step_s| 1.0 / step_s)
    }

    /// True if so many rows are behind the latest time that too few are left.
    pub(crate) fn loses_many(&self) -> bool {
        let lost = (self.repeated + self.backward) as f64;
        self.rows >= MIN_ROWS && lost > MAX_LOST * self.rows as f64
    }

    pub(crate) fn has_whole_seconds(&self) -> bool {
        self.whole && self.repeated > 0
    }
}

/// Stamps of one topic's messages beside the times at which they were recorded.
#[derive(Debug, Clone, Default)]
pub struct Stamps {
    messages: u64,
    unstamped: u64,
    /// Time of recording minus stamp, s: of the first messages, and of the last.
    first: Vec<f64>,
    last: Vec<f64>,
    latest_s: Option<f64>,
    backward: u64,
    back_s: f64,
    varies: bool,
    has_fraction: bool,
    log_span_s: f64,
    first_log_s: Option<f64>,
}

/// State of a topic's stamps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StampState {
    /// There are none, or not in every message.
    Missing,
    /// All of them are equal.
    Still,
    /// They have whole seconds, several messages each.
    WholeSeconds,
    /// They go back by so much, s.
    Backward(f64),
    /// They advance. The time of recording is later by so much, s, at the start and at the end.
    Good {
        /// At the start.
        offset_s: f64,
        /// Growth until the end, s.
        drift_s: f64,
    },
}

impl Stamps {
    /// Takes a message. `stamp_s`: its header's stamp, if it has one. Both since any common time.
    pub fn take(&mut self, stamp_s: Option<f64>, log_s: f64) {
        self.messages += 1;
        let first_log_s = *self.first_log_s.get_or_insert(log_s);
        self.log_span_s = self.log_span_s.max(log_s - first_log_s);
        let Some(stamp_s) = stamp_s else {
            self.unstamped += 1;
            return;
        };
        self.has_fraction |= stamp_s.fract() != 0.0;
        if let Some(latest_s) = self.latest_s {
            self.varies |= stamp_s != latest_s;
            self.backward += u64::from(stamp_s < latest_s);
            self.back_s = self.back_s.max(latest_s - stamp_s);
        }
        self.latest_s = Some(self.latest_s.map_or(stamp_s, |latest_s| latest_s.max(stamp_s)));
        let offset_s = log_s - stamp_s;
        if self.first.len() < KEPT {
            self.first.push(offset_s);
        }
        if self.last.len() < KEPT {
            self.last.push(offset_s);
        } else {
            let place = (self.messages as usize) % KEPT;
            self.last[place] = offset_s;
        }
    }

    /// State of the stamps.
    #[must_use]
    pub fn state(&self) -> StampState {
        if self.unstamped > 0 || self.messages == 0 {
            return StampState::Missing;
        }
        let several = self.messages >= MIN_ROWS && self.log_span_s > 0.0;
        if several && !self.varies {
            return StampState::Still;
        }
        if several && !self.has_fraction && self.messages as f64 > 1.5 * self.log_span_s {
            return StampState::WholeSeconds;
        }
        let offset_s = median(&self.first);
        // Messages may overtake each other by little.
        if self.back_s > 1.0 {
            return StampState::Backward(self.back_s);
        }
        StampState::Good { offset_s, drift_s: median(&self.last) - offset_s }
    }

    /// True if its stamps can be joined with times of recording.
    #[must_use]
    pub fn fits_log(&self) -> bool {
        match self.state() {
            StampState::Good { offset_s, drift_s } => {
                offset_s.abs() <= MAX_OFFSET_S && (offset_s + drift_s).abs() <= MAX_OFFSET_S
            }
            _ => false,
        }
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}
