//! A message between the threads of a recording.

use std::sync::Arc;

use joulebus_capture_format::{Message, Times};

/// A message between the threads of a recording.
#[derive(Debug)]
pub(crate) struct Item {
    pub(crate) fleet: Arc<str>,
    pub(crate) times: Times,
    pub(crate) message: Message,
}

impl Item {
    pub(super) fn topic(&self) -> String {
        let kind = self.message.kind();
        kind.map_or_else(String::new, |kind| kind.topic(&self.fleet, 0))
    }

    /// Its approximate memory.
    pub(crate) fn bytes(&self) -> usize {
        let rows = match &self.message {
            Message::Samples(_, rows) => size_of_val(rows.as_slice()),
            Message::Forecasts(_, rows) => size_of_val(rows.as_slice()),
            Message::Diagnostics(_, rows) => size_of_val(rows.as_slice()),
            Message::Budgets(_, rows) => size_of_val(rows.as_slice()),
            Message::PlanStates(_, rows) => size_of_val(rows.as_slice()),
            Message::Ticks(_, rows) => size_of_val(rows.as_slice()),
            Message::State(_, bytes) => bytes.len(),
            Message::Query(query) => {
                size_of_val(query.values.as_slice())
                    + size_of_val(query.rows.as_slice())
                    + size_of_val(query.power_w.as_slice())
                    + query.text.len()
            }
            _ => 0,
        };
        size_of::<Self>() + rows
    }
}
