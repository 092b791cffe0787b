//! Questions about plans and their answers as messages.

use joulebus_wire::{
    AnswerHeader, AnswerRow, QueryHeader, QueryRecord, ROW_WORDS, Record, answer_parts,
};

use super::codec::OutOfRange;
use super::convert::{from_proto, to_proto};
use super::proto;

/// A question that the worker was asked, and its answer. Lengths in the headers are those of the parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Query {
    /// Headers of question and answer.
    pub record: QueryRecord,
    /// Values of the question.
    pub values: Vec<f64>,
    /// Rows of the answer; none if it was refused.
    pub rows: Vec<AnswerRow>,
    /// Power of every step, W, if asked for.
    pub power_w: Vec<f32>,
    /// Why it was refused.
    pub text: String,
}

impl Query {
    /// From a frame of records.
    #[must_use]
    pub fn of_record((record, values, words): Record<'_>) -> Self {
        let (rows, power_w, text) = answer_parts(&record.answer, words);
        let query = Self {
            record,
            values: values.to_vec(),
            rows: rows.to_vec(),
            power_w: power_w.to_vec(),
            text: text.to_owned(),
        };
        query.counted()
    }

    /// With the lengths of its parts in the headers.
    #[must_use]
    pub fn counted(mut self) -> Self {
        let count = |found: usize| u32::try_from(found).unwrap_or(u32::MAX);
        let words = if self.record.answer.refusal == 0 {
            self.text.clear();
            self.rows.len() * ROW_WORDS + self.power_w.len().div_ceil(2)
        } else {
            self.rows.clear();
            self.power_w.clear();
            self.text.len().div_ceil(8)
        };
        self.record.values = count(self.values.len());
        self.record.words = count(words);
        self.record.reserved = 0;
        self.record.answer.rows = count(self.rows.len());
        self.record.answer.powers = count(self.power_w.len());
        self.record.answer.text_bytes = count(self.text.len());
        self
    }

    pub(super) fn to_proto(&self) -> proto::Query {
        let QueryRecord {
            begun_ns,
            number,
            client,
            query,
            answer,
            values: _,
            words: _,
            reserved: _,
        } = self.record;
        proto::Query {
            begun_ns,
            number,
            client,
            question: Some(proto::Question {
                values: self.values.clone(),
                ..(&query).into()
            }),
            answer: Some(proto::Answer {
                rows: to_proto(&self.rows),
                power_w: self.power_w.clone(),
                text: self.text.clone(),
                ..answer_to_proto(&answer)
            }),
        }
    }

    pub(super) fn of_proto(read: proto::Query) -> Result<Self, OutOfRange> {
        let question = read.question.unwrap_or_default();
        let answer = read.answer.unwrap_or_default();
        let query = Self {
            record: QueryRecord {
                begun_ns: read.begun_ns,
                number: read.number,
                client: read.client,
                query: QueryHeader::try_from(&question)?,
                answer: answer_of_proto(&answer),
                ..QueryRecord::default()
            },
            rows: from_proto(&answer.rows)?,
            values: question.values,
            power_w: answer.power_w,
            text: answer.text,
        };
        Ok(query.counted())
    }
}

fn answer_to_proto(found: &AnswerHeader) -> proto::Answer {
    let AnswerHeader {
        schema,
        pid,
        number,
        worker_epoch,
        tick,
        period_ns,
        sent_state_ns,
        budget_epoch,
        budget_tick,
        sent_budget_ns,
        now_ns,
        taken_ns,
        sent_ns,
        refusal,
        rows: _,
        powers: _,
        text_bytes: _,
    } = *found;
    proto::Answer {
        schema,
        pid,
        number,
        worker_epoch,
        tick,
        period_ns,
        sent_state_ns,
        budget_epoch,
        budget_tick,
        sent_budget_ns,
        now_ns,
        taken_ns,
        sent_ns,
        refusal,
        ..proto::Answer::default()
    }
}

fn answer_of_proto(found: &proto::Answer) -> AnswerHeader {
    AnswerHeader {
        schema: found.schema,
        pid: found.pid,
        number: found.number,
        worker_epoch: found.worker_epoch,
        tick: found.tick,
        period_ns: found.period_ns,
        sent_state_ns: found.sent_state_ns,
        budget_epoch: found.budget_epoch,
        budget_tick: found.budget_tick,
        sent_budget_ns: found.sent_budget_ns,
        now_ns: found.now_ns,
        taken_ns: found.taken_ns,
        sent_ns: found.sent_ns,
        refusal: found.refusal,
        ..AnswerHeader::default()
    }
}
