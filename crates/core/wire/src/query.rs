//! Questions about plans, and their answers: for processes that do not compute for themselves.
//!
//! A client sends a [`QueryHeader`] with a slice of `f64`. The worker answers with an
//! [`AnswerHeader`] and a slice of words of 8 bytes: [`AnswerRow`]s, then the power of every step
//! as `f32` if it was asked for, then three words for each row if one lies outside the training data. A refused question gets the reason's text in UTF-8 instead.
//!
//! | kind | values of the question |
//! |---|---|
//! | [`QueryKind::WhatIf`] | the robot's id, then v in m/s, ω in rad/s for each candidate's steps |
//! | [`QueryKind::Idle`] | ids of the robots |
//! | [`QueryKind::Follow`] | ids of the robots, then x in m, y in m, speed to it in m/s per point, then the columns that [flags](query_flag) name |
//! | [`QueryKind::Acknowledge`] | the robot's id, the alarm's code, then the characters of a name |
//! | [`QueryKind::Battery`] | the robot's id, code and value of a [`crate::Statement`], then the characters of a name |

use crate::declare::ZeroCopySend;
use crate::layout::{bits, names};
use crate::rows;

/// Number of the rules by which answers about plans are computed: increased with each change by
/// which the same question of the same tick gets another answer. Captures state it. 1 where they do
/// not.
///
/// 4: a path is followed by its shape and not by its points, a probability is known only where the
/// model's errors cover the plan, an alarm on a robot's readings bars yes, and the error of counting
/// a plan's energy is part of verdict and probability.
///
/// 5: a plan whose commands are not trusted leans on the robot's own mean, as its outlook does.
///
/// 6: the stairs of a grid are driven as straight lines; a ridge regression, recorded bounds of
/// power and limits of the model's recordings.
///
/// 7: a path's energies are sums of parts that all robots share, and a path may have an hour. The ridge
/// regression counts less for a robot with readings.
pub const ANSWER_RULES: u32 = 7;
/// Number of the rules by which a tick computes: increased with each change by which the same
/// frames get other forecasts, intervals, alarms, budgets or plan states. Captures state it. 1
/// where they do not.
///
/// 8: a platform remembers what its robots have shown.
///
/// 9: levels of all robots are judged, by the scatter that the platform remembers. BiasHigh and
/// BiasLow are retired. What one robot moves of the memory is bounded in any fleet. A robot may say
/// that it is switched off, and persons state batteries.
///
/// 10: the capacity of batteries and their charging rates are learned. Outlooks have bounds beyond
/// the horizons whose errors are known. Levels of robots are also compared with those of the
/// platform's other robots. Trust in commands follows the errors of 10 s and more.
///
/// 11: the scatter of levels is no longer remembered. Errors of batteries are kept in single
/// precision, and shadow forecasts to three digits. The plan state of a robot whose window was emptied
/// has the command of its last sample.
pub const TICK_RULES: u32 = 11;

/// Maximum number of values of a question.
pub const MAX_QUERY_VALUES: usize = 4_096;
/// Maximum number of words of an answer.
pub const MAX_ANSWER_WORDS: usize = 4_608;
/// Maximum number of robots of a question.
pub const MAX_QUERY_ROBOTS: usize = 64;
/// Maximum number of candidates of a question.
pub const MAX_QUERY_CANDIDATES: usize = 256;
/// Maximum number of steps of a followed path, with the return: an hour at 30 Hz.
pub const MAX_QUERY_STEPS: usize = 108_000;
/// Maximum number of words of a frame of records: the longest one fits.
pub const MAX_RECORD_WORDS: usize = 9_216;

/// Kinds of questions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum QueryKind {
    /// The energy of each of several sequences of commands of one robot.
    WhatIf,
    /// The energy of standing still.
    Idle,
    /// The energy of a path, and of returning. Several robots are answered best first.
    Follow,
    /// No question: a person acknowledges an alarm, maybe as the [new
    /// normal](query_flag::NEW_NORMAL).
    Acknowledge,
    /// No question: a person states a robot's battery.
    Battery,
}

impl QueryKind {
    /// The code in shared memory.
    pub const fn code(self) -> u32 {
        self as u32 + 1
    }

    /// From shared memory. `None` for a code of a newer version.
    #[must_use]
    pub const fn decode(code: u32) -> Option<Self> {
        Some(match code {
            1 => Self::WhatIf,
            2 => Self::Idle,
            3 => Self::Follow,
            4 => Self::Acknowledge,
            5 => Self::Battery,
            _ => return None,
        })
    }
}

bits! {
    /// Bits of [`QueryHeader::flags`].
    pub mod query_flag {
        /// After the path, return to `return_x_m`, `return_y_m`.
        pub const RETURN: u32 = 1 << 0;
        /// `heading_rad` is the heading at the first point. Without it, towards the second.
        pub const HEADING: u32 = 1 << 1;
        /// One robot's: the power of every step is wanted.
        pub const POWER: u32 = 1 << 2;
        /// For an acknowledgement: the robot's present level is its own from now on.
        pub const NEW_NORMAL: u32 = 1 << 3;
        /// Of a path: the time that the robot waits at each point follows the points, s.
        pub const DWELL: u32 = 1 << 4;
        /// Of a path: the power that the robot draws in addition towards each point follows, W.
        pub const LOAD: u32 = 1 << 5;
        /// Of a path: the time of each point follows, s.
        pub const TIMES: u32 = 1 << 6;
        /// Of a path: `tolerance_m` is stated.
        pub const TOLERANCE: u32 = 1 << 7;
        /// The bits that only a path has.
        pub const OF_PATH: u32 = RETURN | HEADING | DWELL | LOAD | TIMES | TOLERANCE;
        /// All bits of a question about a plan that this version knows.
        pub const ALL: u32 = OF_PATH | POWER;
    }
}

rows! {
    /// Header of a question. 112 bytes.
    pub struct QueryHeader: "joulebus.QueryHeader.v1", 112 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Code of the [`QueryKind`].
        pub kind: u32,
        /// [`crate::fnv1a`] of the fleet's name.
        pub fleet: u64,
        /// Number that the answer repeats.
        pub number: u64,
        /// When it was asked, monotonic ns.
        #[instant]
        pub asked_ns: u64,
        /// When the client stops waiting, monotonic ns: later the question is refused.
        #[instant]
        pub deadline_ns: u64,
        /// Lower half of the id of the client's listener, which the answer wakes.
        pub listener_lo: u64,
        /// Upper half.
        pub listener_hi: u64,
        /// [`query_flag`] bits.
        pub flags: u32,
        /// Number of robots, at most [`MAX_QUERY_ROBOTS`].
        pub robots: u32,
        /// Number of candidates, at most [`MAX_QUERY_CANDIDATES`]. Of one robot's path or rest: number of
        /// evenly spaced moments up to which a part of the plan is answered too, each with a row.
        pub candidates: u32,
        /// Steps of each candidate, points of the path, or characters of a name.
        pub steps: u32,
        /// Coverage of the intervals, 0.5 to 0.999.
        pub coverage: f32,
        /// Time that each command is in force, s.
        pub period_s: f32,
        /// Time at rest, s.
        pub duration_s: f32,
        /// Distance from the path within which corners are cut, m. Without the flag: stairs of a grid
        /// within half a cell.
        pub tolerance_m: f32,
        /// Where to return to, m.
        pub return_x_m: f64,
        /// Where to return to, m.
        pub return_y_m: f64,
        /// Heading at the first point, rad, counter-clockwise from east.
        pub heading_rad: f64,
    }
}

rows! {
    /// Header of an answer. 112 bytes.
    #[derive(Eq)]
    pub struct AnswerHeader: "joulebus.AnswerHeader.v1", 112 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the worker.
        pub pid: u32,
        /// The question's number.
        pub number: u64,
        /// Run of the worker that the state is of.
        #[run]
        pub worker_epoch: u64,
        /// Tick of the plan states that the answer is computed from. 0 if it is refused.
        pub tick: u64,
        /// Period of the tick, ns.
        pub period_ns: u64,
        /// When that frame was sent, monotonic ns.
        #[instant]
        pub sent_state_ns: u64,
        /// Run of the worker that the budgets are of.
        #[run]
        pub budget_epoch: u64,
        /// Tick of the budgets. 0 without any.
        pub budget_tick: u64,
        /// When that frame was sent, monotonic ns.
        #[instant]
        pub sent_budget_ns: u64,
        /// The time that the answer is as of, monotonic ns.
        #[instant]
        pub now_ns: u64,
        /// When the worker took the question, monotonic ns.
        #[instant]
        pub taken_ns: u64,
        /// When the answer was sent, monotonic ns.
        #[instant]
        pub sent_ns: u64,
        /// Code of the [`QueryRefusal`]. 0 if the question is answered.
        pub refusal: u32,
        /// Number of [`AnswerRow`]s.
        pub rows: u32,
        /// Number of powers after the rows.
        pub powers: u32,
        /// Bytes of the text of a refusal.
        pub text_bytes: u32,
    }
}

bits! {
    /// Bits of [`AnswerRow::flags`].
    pub mod answer_flag {
        /// `mean_j`, `lo_j` and `hi_j` are known.
        pub const ENERGY: u16 = 1 << 0;
        /// `left_j` and `left_lo_j` are known.
        pub const LEFT: u16 = 1 << 1;
        /// `probability` is known.
        pub const PROBABILITY: u16 = 1 << 2;
        /// `margin_j` is known.
        pub const MARGIN: u16 = 1 << 3;
        /// `limiting_leg` is known.
        pub const LIMITING_LEG: u16 = 1 << 4;
        /// `turn_back_s` is known.
        pub const TURN_BACK: u16 = 1 << 5;
        /// The plan is longer than the longest horizon whose errors are known: its interval and
        /// its probability are extrapolated.
        pub const BEYOND_HORIZON: u16 = 1 << 6;
        /// The robot's sample is overdue, or came without a reading.
        pub const NO_READING: u16 = 1 << 7;
        /// The robot's newest row lay outside the range that its model was trained on.
        pub const OUTSIDE_TRAINING: u16 = 1 << 8;
        /// The robot's alarm `NoData` is raised.
        pub const ALARM_NO_DATA: u16 = 1 << 9;
        /// The robot's alarm `OutOfRange` is raised.
        pub const ALARM_OUT_OF_RANGE: u16 = 1 << 10;
        /// The robot's alarm `StuckSensor` is raised.
        pub const ALARM_STUCK_SENSOR: u16 = 1 << 11;
        /// The robot's alarm `HeldTooLong` is raised.
        pub const ALARM_HELD_TOO_LONG: u16 = 1 << 12;
        /// The robot's alarm `SocImplausible` is raised.
        pub const ALARM_SOC_IMPLAUSIBLE: u16 = 1 << 13;
        /// The robot's alarm `Implausible` is raised.
        pub const ALARM_IMPLAUSIBLE: u16 = 1 << 14;
        /// The recordings of the robot's model cannot show what the plan costs in full.
        pub const MODEL_LIMIT: u16 = 1 << 15;
    }
}

rows! {
    /// The answer to one candidate, or of one robot. 64 bytes.
    pub struct AnswerRow: "joulebus.AnswerRow.v1", 64 {
        /// Id of the robot.
        pub robot: u32,
        /// [`answer_flag`] bits.
        pub flags: u16,
        /// 1 yes, 2 tight, 3 no, 4 unknown. Others are of a newer version.
        pub verdict: u16,
        /// Why it is unknown: 1 stale, 2 invalid, 3 warm-up, 4 unreadable, 5 no level, 6 no
        /// battery, 7 battery unknown, 8 no budget. 0 if it is not.
        pub unknown: u16,
        /// Code of the [`crate::InvalidReason`], or readings so far in the warm-up. With other verdicts
        /// the longest delay at a point of a path with times, s, rounded up.
        pub unknown_detail: u16,
        /// The first leg at whose end a yes does not hold, from 0.
        pub limiting_leg: u32,
        /// Age of the frame where it is stale, ns.
        pub age_ns: u64,
        /// From the first command to the end of the last, s.
        pub duration_s: f32,
        /// Energy of the plan, expected, J.
        pub mean_j: f32,
        /// Lower end at the asked coverage, J.
        pub lo_j: f32,
        /// Upper end, J.
        pub hi_j: f32,
        /// Energy left in the battery at the end, best estimate, J.
        pub left_j: f32,
        /// Conservative, J.
        pub left_lo_j: f32,
        /// Probability of finishing above the reserve. NaN where the model's errors do not cover the
        /// plan.
        pub probability: f32,
        /// A bound: what the battery can spare at least, less the upper end of the energy, J.
        pub margin_j: f32,
        /// Until when the robot must turn back, s. NaN with a yes: it can drive the whole path.
        pub turn_back_s: f32,
        /// Steps whose commands lie outside the training data.
        pub outside_training: u32,
    }
}

/// Words of an [`AnswerRow`].
pub const ROW_WORDS: usize = size_of::<AnswerRow>() / 8;

/// Reason that a question was not answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum QueryRefusal {
    /// Another version of the payloads.
    Schema,
    /// Asked of another fleet.
    Fleet,
    /// A kind, flag or reserved field that this version does not know.
    Kind,
    /// More robots, candidates, steps or values than allowed.
    TooLarge,
    /// Not as many values as the counts state.
    Length,
    /// The robot is not in the fleet.
    UnknownRobot,
    /// Values that are not allowed: not finite, beyond the platform's limits, a coverage, a path.
    Question,
    /// Not answered before its deadline.
    Deadline,
    /// The worker has no frame of the fleet yet.
    NoFrame,
    /// Too many questions of one process wait.
    Busy,
    /// The worker ends.
    Ending,
    /// The client has ended, or has stopped waiting.
    ClientGone,
    /// The answer could not be sent.
    Unsent,
    /// The alarm to be acknowledged is not raised.
    NotRaised,
}

names! {
    /// All reasons. The position is the index into [`QueryCounts::refused`].
    pub QueryRefusal:
        Schema Fleet Kind TooLarge Length UnknownRobot Question Deadline NoFrame Busy Ending
        ClientGone Unsent NotRaised
}

impl QueryRefusal {
    /// The code in shared memory.
    pub const fn code(self) -> u32 {
        self as u32 + 1
    }

    /// From shared memory. `None` for a code of a newer version.
    #[must_use]
    pub fn decode(code: u32) -> Option<Self> {
        let position = usize::try_from(code).ok()?.checked_sub(1)?;
        Self::ALL.get(position).copied()
    }
}

rows! {
    /// Questions answered, and refused by reason, with spare counters for later versions.
    #[derive(Eq)]
    pub struct QueryCounts: "joulebus.QueryCounts", 160 {
        /// Questions answered.
        pub answered: u64,
        /// Indexed by the reason's position in [`QueryRefusal::ALL`].
        pub refused: [u64; 19],
    }
}

impl QueryCounts {
    /// Counts one more refusal.
    pub const fn refuse(&mut self, reason: QueryRefusal) {
        let count = &mut self.refused[reason as usize];
        *count = count.saturating_add(1);
    }

    /// Questions refused for any reason.
    pub fn total_refused(&self) -> u64 {
        let add = |sum: u64, count: &u64| sum.saturating_add(*count);
        self.refused.iter().fold(0, add)
    }

    /// The reasons that occurred, with their counts.
    pub fn iter(&self) -> impl Iterator<Item = (QueryRefusal, u64)> + '_ {
        QueryRefusal::ALL
            .into_iter()
            .map(|reason| (reason, self.refused[reason as usize]))
            .filter(|(_, count)| *count > 0)
    }
}

rows! {
    /// Header of a frame of records: the questions since the last frame, with their answers. The
    /// payload is words of 8 bytes, read by [`records`]. Sent while somebody reads it. The newest
    /// frame, whose counts show what was answered and refused, is kept for readers that come later.
    #[derive(Eq)]
    pub struct QueriesHeader: "joulebus.QueriesHeader.v1", 184 {
        /// [`crate::SCHEMA_VERSION`].
        pub schema: u32,
        /// Process id of the worker.
        pub pid: u32,
        /// When the worker began to answer, monotonic ns.
        #[instant]
        pub begun_ns: u64,
        /// So far, those of this frame included.
        pub counts: QueryCounts,
        /// When the frame was sent, monotonic ns.
        #[instant]
        pub sent_ns: u64,
    }
}

rows! {
    /// One question and its answer in a frame of records. 256 bytes. Its values and words follow.
    pub struct QueryRecord: "joulebus.QueryRecord.v1", 256 {
        /// When the worker began to answer, monotonic ns: the run that `number` counts in.
        #[instant]
        pub begun_ns: u64,
        /// Number of the question, from 1, in the order of the answers.
        pub number: u64,
        /// Process id of the client.
        pub client: u32,
        /// Values of the question.
        pub values: u32,
        /// Words of the answer.
        pub words: u32,
        /// 0.
        pub reserved: u32,
        /// The question.
        pub query: QueryHeader,
        /// The answer.
        pub answer: AnswerHeader,
    }
}

/// Words of a [`QueryRecord`].
const RECORD_HEAD_WORDS: usize = size_of::<QueryRecord>() / 8;
const _: () = assert!(RECORD_HEAD_WORDS + MAX_QUERY_VALUES + MAX_ANSWER_WORDS <= MAX_RECORD_WORDS);

/// Appends a record to the payload of a frame. Its lengths are set. Returns whether it fits.
pub fn push_record(
    to: &mut Vec<u64>,
    mut record: QueryRecord,
    values: &[f64],
    words: &[u64],
) -> bool {
    let more = RECORD_HEAD_WORDS + values.len() + words.len();
    if to.len() + more > MAX_RECORD_WORDS {
        return false;
    }
    // Both are shorter than a frame.
    (record.values, record.words) = (values.len() as u32, words.len() as u32);
    to.extend_from_slice(bytemuck::cast_slice(std::slice::from_ref(&record)));
    to.extend_from_slice(bytemuck::cast_slice(values));
    to.extend_from_slice(words);
    true
}

/// A record with the values of its question and the words of its answer.
pub type Record<'a> = (QueryRecord, &'a [f64], &'a [u64]);

/// The records in the payload of a frame, up to the first that exceeds it.
pub fn records(mut payload: &[u64]) -> impl Iterator<Item = Record<'_>> {
    std::iter::from_fn(move || {
        let (head, rest) = payload.split_at_checked(RECORD_HEAD_WORDS)?;
        let record: QueryRecord = *bytemuck::from_bytes(bytemuck::cast_slice(head));
        let (values, rest) = rest.split_at_checked(record.values as usize)?;
        let (words, rest) = rest.split_at_checked(record.words as usize)?;
        payload = rest;
        Some((record, bytemuck::cast_slice(values), words))
    })
}

/// Rows, powers and refusal's text of an answer, empty where the header's lengths exceed the words.
#[must_use]
pub fn answer_parts<'a>(
    header: &AnswerHeader,
    words: &'a [u64],
) -> (&'a [AnswerRow], &'a [f32], &'a str) {
    if header.refusal != 0 {
        let bytes: &[u8] = bytemuck::cast_slice(words);
        let text = bytes.get(..header.text_bytes as usize).unwrap_or_default();
        return (&[], &[], std::str::from_utf8(text).unwrap_or_default());
    }
    let rows = (header.rows as usize).checked_mul(ROW_WORDS);
    let Some((rows, powers)) = rows.and_then(|rows| words.split_at_checked(rows)) else {
        return (&[], &[], "");
    };
    let powers: &[f32] = bytemuck::cast_slice(powers);
    let powers = powers.get(..header.powers as usize).unwrap_or_default();
    (bytemuck::cast_slice(rows), powers, "")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_are_read_as_they_were_written_and_damaged_ones_end_the_frame() {
        let mut words = Vec::new();
        let record = |number| QueryRecord { number, ..QueryRecord::default() };
        assert!(push_record(&mut words, record(1), &[1.5, -0.0], &[7]));
        assert!(push_record(&mut words, record(2), &[], &[]));
        let full = vec![0; MAX_RECORD_WORDS];
        assert!(!push_record(&mut words, record(3), &[], &full), "no space");
        let found: Vec<Record<'_>> = records(&words).collect();
        let numbers: Vec<u64> = found.iter().map(|(record, _, _)| record.number).collect();
        assert_eq!(numbers, [1, 2]);
        assert_eq!((found[0].1, found[0].2), (&[1.5, -0.0][..], &[7][..]));
        for cut in 0..words.len() {
            assert!(records(&words[..cut]).count() < 2, "{cut}");
        }
        let mut false_length = words.clone();
        let head: &mut QueryRecord = bytemuck::from_bytes_mut(bytemuck::cast_slice_mut(
            &mut false_length[..RECORD_HEAD_WORDS],
        ));
        head.values = u32::MAX;
        assert_eq!(records(&false_length).count(), 0);
    }

    #[test]
    fn answers_whose_lengths_exceed_their_words_are_empty() {
        let words = [0; ROW_WORDS + 1];
        let header = |rows, powers| AnswerHeader { rows, powers, ..AnswerHeader::default() };
        let lengths = |header: &AnswerHeader| {
            let (rows, powers, text) = answer_parts(header, &words);
            (rows.len(), powers.len(), text.len())
        };
        assert_eq!(lengths(&header(1, 2)), (1, 2, 0));
        assert_eq!(lengths(&header(1, 3)), (1, 0, 0));
        assert_eq!(lengths(&header(2, 0)), (0, 0, 0));
        assert_eq!(lengths(&header(u32::MAX, u32::MAX)), (0, 0, 0));
        let refused = AnswerHeader { refusal: 1, text_bytes: u32::MAX, ..header(1, 1) };
        assert_eq!(lengths(&refused), (0, 0, 0));
    }

    #[test]
    fn codes_are_decoded_and_unknown_ones_are_not() {
        for reason in QueryRefusal::ALL {
            assert_eq!(QueryRefusal::decode(reason.code()), Some(reason));
        }
        for code in [0, 15, u32::MAX] {
            assert_eq!(QueryRefusal::decode(code), None);
        }
        for code in 1..=5 {
            assert_eq!(QueryKind::decode(code).map(QueryKind::code), Some(code));
        }
        assert_eq!(QueryKind::decode(0), None);
    }
}
