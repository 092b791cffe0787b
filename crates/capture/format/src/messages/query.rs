//! Questions about plans and their answers as messages.

use std::rc::Rc;

use joulebus_wire::{
    AnswerHeader, AnswerRow, FrameOrder, QueryHeader, QueryRecord, ROW_WORDS, Record, Row,
    answer_parts,
};
use prost_types::DescriptorProto;

use super::codec::{Decoded, Encoder, MAX_DEPTH, Wrong, inner};
use super::descriptors;
use super::message::{Content, DecodeError, Message, MessageKind, check_rows, read};
use super::table::{Number, Table};

/// A question that the worker was asked, and its answer. Lengths in the headers are those of the
/// parts.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Query {
    /// Headers of question and answer.
    pub record: QueryRecord,
    /// Values of the question.
    pub values: Vec<f64>,
    /// Rows of the answer. None if it was refused.
    pub rows: Vec<AnswerRow>,
    /// Power of every step, W, if asked for.
    pub power_w: Vec<f32>,
    /// Reason for a refusal.
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

    /// Memory of its parts, bytes.
    pub const fn memory(&self) -> usize {
        size_of_val(self.values.as_slice())
            + size_of_val(self.rows.as_slice())
            + size_of_val(self.power_w.as_slice())
            + self.text.len()
    }

    pub(super) fn decode(data: &[u8]) -> Result<Message, DecodeError> {
        let tables = &*TABLES.with(Rc::clone);
        // The rows are within the answer.
        check_rows(data, 1)?;
        let mut record: QueryRecord = read(&tables.record.empty);
        let mut asked: QueryHeader = read(&tables.question.empty);
        let mut answered: AnswerHeader = read(&tables.answer.empty);
        let (mut values, mut rows, mut power_w) = (Vec::new(), Vec::new(), Vec::new());
        let (mut text, mut exceeds) = (String::new(), None);
        let (mut question, mut answer) =
            (Decoded::new(&tables.question), Decoded::new(&tables.answer));
        let mut row = Decoded::new(&tables.row);
        let mut head = Decoded::new(&tables.record);
        let into = bytemuck::bytes_of_mut(&mut record);
        head.take(data, into, MAX_DEPTH, &mut |number, wire, data, depth| {
            if number == tables.question_number {
                let into = bytemuck::bytes_of_mut(&mut asked);
                let part = data.bytes(wire)?;
                question.take(part, into, inner(depth)?, &mut |number, wire, data, _| {
                    if number != tables.values_number {
                        return Ok(false);
                    }
                    data.numbers(Number::F64, wire, |bits| values.push(f64::from_bits(bits)))?;
                    Ok(true)
                })?;
            } else if number == tables.answer_number {
                let into = bytemuck::bytes_of_mut(&mut answered);
                let part = data.bytes(wire)?;
                answer.take(part, into, inner(depth)?, &mut |number, wire, data, depth| {
                    if number == tables.text_number {
                        let bytes = data.bytes(wire)?;
                        text = String::from_utf8(bytes.to_vec()).map_err(|_| Wrong::Text)?;
                    } else if number == tables.rows_number {
                        let mut found: AnswerRow = read(&tables.row.empty);
                        let into = bytemuck::bytes_of_mut(&mut found);
                        row.row(data.bytes(wire)?, into, inner(depth)?, &mut exceeds)?;
                        rows.push(found);
                    } else if number == tables.power_number {
                        let mut push = |bits| power_w.push(f32::from_bits(bits as u32));
                        data.numbers(Number::F32, wire, &mut push)?;
                    } else {
                        return Ok(false);
                    }
                    Ok(true)
                })?;
            } else {
                return Ok(false);
            }
            Ok(true)
        })?;
        if let Some(exceeds) = exceeds {
            return Err(exceeds.into());
        }
        (record.query, record.answer) = (asked, answered);
        let query = Self { record, values, rows, power_w, text };
        Ok(query.counted().into())
    }
}

impl Content for Query {
    fn kind(&self) -> MessageKind {
        MessageKind::of::<joulebus_wire::Queries>()
    }

    fn order(&self) -> Option<FrameOrder> {
        Some(FrameOrder { run: self.record.begun_ns, number: self.record.number })
    }

    fn sent_ns(&self) -> Option<u64> {
        Some(self.record.answer.sent_ns)
    }

    fn memory(&self) -> usize {
        Self::memory(self)
    }

    fn encode(&self, out: &mut Vec<u8>) {
        let tables = &*TABLES.with(Rc::clone);
        let QueryRecord { query, answer, .. } = &self.record;
        let mut encoder = Encoder::after(std::mem::take(out));
        encoder.fields(&tables.record, bytemuck::bytes_of(&self.record));
        encoder.part(tables.question_number, |to| {
            to.fields(&tables.question, bytemuck::bytes_of(query));
            let values = self.values.iter().flat_map(|value| value.to_le_bytes());
            to.bytes(tables.values_number, &values.collect::<Vec<u8>>());
        });
        encoder.part(tables.answer_number, |to| {
            to.fields(&tables.answer, bytemuck::bytes_of(answer));
            to.bytes(tables.text_number, self.text.as_bytes());
            to.rows(tables.rows_number, &tables.row, &self.rows);
            let power_w = self.power_w.iter().flat_map(|power_w| power_w.to_le_bytes());
            to.bytes(tables.power_number, &power_w.collect::<Vec<u8>>());
        });
        *out = encoder.finish();
    }

    fn cloned(&self) -> Box<dyn Content> {
        Box::new(self.clone())
    }

    fn is_same(&self, other: &dyn Content) -> bool {
        let other: &dyn std::any::Any = other;
        other.downcast_ref::<Self>().is_some_and(|other| {
            bytemuck::bytes_of(&self.record) == bytemuck::bytes_of(&other.record)
                && bytemuck::cast_slice::<_, u8>(&self.values)
                    == bytemuck::cast_slice::<_, u8>(&other.values)
                && bytemuck::cast_slice::<_, u8>(&self.rows)
                    == bytemuck::cast_slice::<_, u8>(&other.rows)
                && bytemuck::cast_slice::<_, u8>(&self.power_w)
                    == bytemuck::cast_slice::<_, u8>(&other.power_w)
                && self.text == other.text
        })
    }

    fn hash_bits(&self, state: &mut dyn std::hash::Hasher) {
        state.write(bytemuck::bytes_of(&self.record));
        state.write(bytemuck::cast_slice(&self.values));
        state.write(bytemuck::cast_slice(&self.rows));
        state.write(bytemuck::cast_slice(&self.power_w));
        state.write(self.text.as_bytes());
    }
}

/// Encodings of questions and answers.
struct Tables {
    record: Table,
    question: Table,
    answer: Table,
    row: Table,
    question_number: u32,
    values_number: u32,
    answer_number: u32,
    text_number: u32,
    rows_number: u32,
    power_number: u32,
}

thread_local! {
    /// Not of all threads: a child made by `fork` could find the lock taken for ever.
    static TABLES: Rc<Tables> = Rc::new(Tables::new());
}

impl Tables {
    fn new() -> Self {
        let set = descriptors::all();
        let find = |name: &str| descriptors::message(&set, name);
        let message = |name: &str| find(name).unwrap_or_default();
        let (query, question, answer) = (message("Query"), message("Question"), message("Answer"));
        let number = |of: &DescriptorProto, name: &str| {
            let field = of.field.iter().find(|field| field.name() == name);
            field.map_or(0, |field| field.number().unsigned_abs())
        };
        // Ours, and tested.
        let table = |layout, message, parts: &[&str], lengths: &[&str]| {
            Table::new(&layout, message, &find, parts, lengths).unwrap_or_default()
        };
        let in_parts = ["values", "words", "reserved", "query", "answer"];
        Self {
            record: table(QueryRecord::LAYOUT, &query, &["question", "answer"], &in_parts),
            question: table(QueryHeader::LAYOUT, &question, &["values"], &[]),
            answer: table(
                AnswerHeader::LAYOUT,
                &answer,
                &["text", "rows", "power_w"],
                &["rows", "powers", "text_bytes"],
            ),
            row: table(AnswerRow::LAYOUT, &message("AnswerRow"), &[], &[]),
            question_number: number(&query, "question"),
            values_number: number(&question, "values"),
            answer_number: number(&query, "answer"),
            text_number: number(&answer, "text"),
            rows_number: number(&answer, "rows"),
            power_number: number(&answer, "power_w"),
        }
    }
}
