//! Statistics of one channel.

use std::collections::BTreeMap;

use mcap::records::{Channel, MessageHeader};
use serde::Serialize;

use super::records::SchemaReport;
use crate::scan::RecordLocation;

/// A step longer than this many median steps is a gap.
const GAP_STEPS: f64 = 3.0;

/// Sequence numbers of a channel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Sequence {
    /// All messages have the same number, or there are too few.
    #[default]
    Unused,
    /// Consecutive numbers, with exceptions.
    Counted {
        /// Number of missing messages.
        missing: u64,
        /// Numbers that do not increase: a new recorder, or a duplicate message.
        restarts: u64,
    },
}

/// A channel of a file.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ChannelReport {
    /// Its id in the file.
    pub id: u16,
    /// Its topic.
    pub topic: String,
    /// Its message encoding: `protobuf`, `cdr`, `json`, …
    pub message_encoding: String,
    /// Name of its schema, if it has one.
    pub schema: Option<String>,
    /// Its metadata.
    pub metadata: BTreeMap<String, String>,
    /// Messages.
    pub messages: u64,
    /// Log time of its earliest message, ns.
    pub start_ns: Option<u64>,
    /// Log time of its latest message, ns.
    pub end_ns: Option<u64>,
    /// Mean message rate, Hz.
    pub rate_hz: Option<f64>,
    /// Median step of the log time, s, within 7 %.
    pub median_step_s: Option<f64>,
    /// Longest step, s.
    pub longest_step_s: Option<f64>,
    /// Steps longer than three median steps.
    pub gaps: u64,
    /// Messages earlier than their predecessor.
    pub out_of_order: u64,
    /// Minimum time from publishing to logging, s.
    pub least_delay_s: Option<f64>,
    /// Maximum time from publishing to logging, s.
    pub longest_delay_s: Option<f64>,
    /// Its sequence numbers.
    pub sequence: Sequence,
    #[serde(skip)]
    first_missing: Option<RecordLocation>,
}

impl ChannelReport {
    /// Messages missing according to the sequence numbers.
    pub(super) fn lost_words(&self) -> Option<(Option<RecordLocation>, String)> {
        let Sequence::Counted { missing, restarts } = self.sequence else {
            return None;
        };
        let topic = &self.topic;
        let what = match (missing, restarts) {
            (0, 0) => return None,
            (missing, 0) => format!("{topic}: {missing} messages are missing by their numbers"),
            (missing, restarts) => format!(
                "{topic}: {missing} messages are missing by their numbers, which start again {restarts} times"
            ),
        };
        Some((self.first_missing, what))
    }
}

/// Counters of a channel during the scan.
pub(super) struct Tally {
    pub(super) channel: Channel,
    found: ChannelReport,
    last_ns: u64,
    last_sequence: u32,
    numbers_differ: bool,
    missing: u64,
    restarts: u64,
    longest_step_ns: u64,
    least_delay_ns: i128,
    longest_delay_ns: i128,
    steps: Steps,
}

impl Tally {
    pub(super) fn new(channel: Channel) -> Self {
        Self {
            channel,
            found: ChannelReport::default(),
            last_ns: 0,
            last_sequence: 0,
            numbers_differ: false,
            missing: 0,
            restarts: 0,
            longest_step_ns: 0,
            least_delay_ns: i128::MAX,
            longest_delay_ns: i128::MIN,
            steps: Steps::default(),
        }
    }

    pub(super) fn add(&mut self, header: &MessageHeader, place: RecordLocation) {
        let log_ns = header.log_time;
        if self.found.messages > 0 {
            self.add_step(log_ns);
            self.add_number(header.sequence, place);
        }
        let delay_ns = i128::from(log_ns) - i128::from(header.publish_time);
        self.least_delay_ns = self.least_delay_ns.min(delay_ns);
        self.longest_delay_ns = self.longest_delay_ns.max(delay_ns);
        let found = &mut self.found;
        found.start_ns = Some(found.start_ns.map_or(log_ns, |start_ns| start_ns.min(log_ns)));
        found.end_ns = found.end_ns.max(Some(log_ns));
        found.messages += 1;
        (self.last_ns, self.last_sequence) = (log_ns, header.sequence);
    }

    fn add_step(&mut self, log_ns: u64) {
        match log_ns.checked_sub(self.last_ns) {
            None => self.found.out_of_order += 1,
            Some(step_ns) => {
                self.longest_step_ns = self.longest_step_ns.max(step_ns);
                self.steps.add(step_ns);
            }
        }
    }

    /// Numbers are 32 bits and may wrap.
    fn add_number(&mut self, sequence: u32, place: RecordLocation) {
        let step = sequence.wrapping_sub(self.last_sequence);
        self.numbers_differ |= step != 0;
        if step == 0 || step > u32::MAX / 2 {
            self.restarts += 1;
        } else if step > 1 {
            self.missing += u64::from(step - 1);
            self.found.first_missing.get_or_insert(place);
        }
    }

    pub(super) fn report(self, schemas: &BTreeMap<u16, SchemaReport>) -> ChannelReport {
        let (any, several) = (self.found.messages > 0, self.found.messages > 1);
        let seconds = |ns: u64| ns as f64 / 1e9;
        let span_ns = self.found.start_ns.zip(self.found.end_ns);
        let span_s = seconds(span_ns.map_or(0, |(start_ns, end_ns)| end_ns - start_ns));
        let median_ns = self.steps.median_ns();
        let sequence = if self.numbers_differ {
            Sequence::Counted { missing: self.missing, restarts: self.restarts }
        } else {
            Sequence::Unused
        };
        ChannelReport {
            id: self.channel.id,
            schema: schemas.get(&self.channel.schema_id).map(|schema| schema.name.clone()),
            topic: self.channel.topic,
            message_encoding: self.channel.message_encoding,
            metadata: self.channel.metadata,
            rate_hz: (several && span_s > 0.0).then(|| (self.found.messages - 1) as f64 / span_s),
            median_step_s: median_ns.map(|median_ns| median_ns / 1e9),
            longest_step_s: several.then(|| seconds(self.longest_step_ns)),
            gaps: median_ns.map_or(0, |median_ns| self.steps.longer_than(GAP_STEPS * median_ns)),
            least_delay_s: any.then_some(self.least_delay_ns as f64 / 1e9),
            longest_delay_s: any.then_some(self.longest_delay_ns as f64 / 1e9),
            sequence,
            ..self.found
        }
    }
}

/// Histogram of steps with eight classes per octave: a median in bounded memory.
#[derive(Debug, Default)]
struct Steps {
    counts: BTreeMap<u16, u64>,
}

impl Steps {
    fn add(&mut self, step_ns: u64) {
        *self.counts.entry(class(step_ns)).or_default() += 1;
    }

    fn median_ns(&self) -> Option<f64> {
        let all: u64 = self.counts.values().sum();
        let mut before = 0;
        for (class, count) in &self.counts {
            before += count;
            if 2 * before >= all {
                return Some(middle_ns(*class));
            }
        }
        None
    }

    fn longer_than(&self, step_ns: f64) -> u64 {
        let longer = |class: u16| middle_ns(class) > step_ns;
        self.counts.iter().filter(|(class, _)| longer(**class)).map(|(_, count)| count).sum()
    }
}

/// The class of a step: its highest bit and the next three.
fn class(step_ns: u64) -> u16 {
    if step_ns < 8 {
        return u16::try_from(step_ns).unwrap_or_default();
    }
    let octave = step_ns.ilog2();
    let eighth = (step_ns >> (octave - 3)) & 7;
    u16::try_from(u64::from(octave - 2) * 8 + eighth).unwrap_or(u16::MAX)
}

/// The centre of a class, ns.
fn middle_ns(class: u16) -> f64 {
    if class < 8 {
        return f64::from(class);
    }
    let octave = i32::from(class / 8) + 2;
    let eighth = f64::from(class % 8);
    (1.0 + (eighth + 0.5) / 8.0) * f64::from(octave).exp2()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{Steps, class, middle_ns};

    proptest! {
        #[test]
        fn a_class_is_within_7_percent_of_its_steps(step_ns in 0_u64..=u64::MAX) {
            let middle_ns = middle_ns(class(step_ns));
            let apart = (middle_ns - step_ns as f64).abs();
            prop_assert!(apart <= 0.07 * step_ns as f64, "{step_ns}: {middle_ns}");
        }

        #[test]
        fn the_median_is_that_of_the_sorted_steps(mut steps_ns in prop::collection::vec(0_u64..1 << 40, 1..200)) {
            let mut steps = Steps::default();
            steps_ns.iter().for_each(|step_ns| steps.add(*step_ns));
            steps_ns.sort_unstable();
            let median_ns = steps_ns[(steps_ns.len() - 1) / 2];
            prop_assert_eq!(steps.median_ns(), Some(middle_ns(class(median_ns))));
        }
    }
}
