//! Records of questions and answers, sent in frames to whoever reads them.

use joulebus_bus::{Bus, Limits, OpenError, SendError, Writer, clock, process_id};
use joulebus_wire::{
    MAX_RECORD_WORDS, Queries, QueriesHeader, QueryCounts, QueryRecord, SCHEMA_VERSION, push_record,
};

/// Maximum time that a record waits for others, ns. A recorder polls every 10 ms.
const FLUSH_EVERY_NS: u64 = 3_000_000;
/// Maximum time until counts are sent, ns.
const COUNTS_EVERY_NS: u64 = 500_000_000;

/// Gathers records, and sends them.
pub(crate) struct Records {
    writer: Writer<Queries>,
    words: Vec<u64>,
    begun_ns: u64,
    /// When the oldest record was gathered.
    since_ns: u64,
    sent: Option<(QueryCounts, u64)>,
    /// True if the frame that later readers get has records: an empty one must follow.
    has_sent_records: bool,
}

impl Records {
    /// Opens the port. `begun_ns` is when the thread began to answer, before any loss of ports.
    pub(crate) fn open(bus: &Bus, limits: &Limits, begun_ns: u64) -> Result<Self, OpenError> {
        Ok(Self {
            writer: bus.writer(limits)?,
            words: Vec::with_capacity(MAX_RECORD_WORDS),
            begun_ns,
            since_ns: 0,
            sent: None,
            has_sent_records: false,
        })
    }

    /// Adds the record of the question counted last, if there is a reader.
    pub(crate) fn add(
        &mut self,
        mut record: QueryRecord,
        (values, words): (&[f64], &[u64]),
        counts: QueryCounts,
    ) -> Result<(), SendError> {
        if self.writer.readers() == 0 {
            return Ok(());
        }
        let number = counts.answered.saturating_add(counts.total_refused());
        (record.begun_ns, record.number) = (self.begun_ns, number);
        if push_record(&mut self.words, record, values, words) {
            return Ok(());
        }
        self.send(counts)?;
        // One record always fits into an empty frame.
        push_record(&mut self.words, record, values, words);
        Ok(())
    }

    /// Sends the records that are due. Returns when the next are due, monotonic ns.
    pub(crate) fn flush(&mut self, counts: QueryCounts, last: bool) -> Result<u64, SendError> {
        let now_ns = clock::monotonic_ns();
        if self.words.is_empty() {
            self.since_ns = now_ns;
        }
        let records_due_ns = self.since_ns.saturating_add(FLUSH_EVERY_NS);
        let counts_due_ns = match self.sent {
            None => 0,
            Some((sent, _)) if sent == counts && !self.has_sent_records => u64::MAX,
            Some((_, sent_ns)) => sent_ns.saturating_add(COUNTS_EVERY_NS),
        };
        let has_records = !self.words.is_empty();
        let is_due = (has_records && now_ns >= records_due_ns) || now_ns >= counts_due_ns;
        let is_new = has_records || counts_due_ns < u64::MAX;
        if is_due || (last && is_new) {
            self.send(counts)?;
            return Ok(u64::MAX);
        }
        if has_records {
            return Ok(records_due_ns.min(counts_due_ns));
        }
        // A reader that has joined gets the newest frame.
        self.writer.update();
        Ok(counts_due_ns)
    }

    fn send(&mut self, counts: QueryCounts) -> Result<(), SendError> {
        let sent_ns = clock::monotonic_ns();
        let header = QueriesHeader {
            schema: SCHEMA_VERSION,
            pid: process_id(),
            begun_ns: self.begun_ns,
            counts,
            sent_ns,
        };
        self.has_sent_records = !self.words.is_empty();
        let words = &self.words;
        let sent = self.writer.send(header, words.len(), |place| words[place]);
        self.words.clear();
        self.sent = Some((counts, sent_ns));
        sent.map(|_| ())
    }
}
