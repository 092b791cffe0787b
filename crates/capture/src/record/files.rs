//! Where recorded messages go: one file, several that continue from each other, or memory that is
//! saved when something happens.

use std::collections::{HashMap, VecDeque};
use std::fmt;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::item::Item;
use super::options::{Options, Snapshot};
use crate::{Attachments, Message, MessageKind, Sequences, WriteError, Writer, Written};

/// Any place that bytes go to.
type Out = Box<dyn Write + Send>;

/// Where a capture goes.
pub enum Target {
    /// A file; further ones beside it when it is split.
    File(PathBuf),
    /// A pipe, or what else takes bytes; never split.
    Stream(Box<dyn Write + Send>),
}

impl fmt::Debug for Target {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => out.debug_tuple("File").field(path).finish(),
            Self::Stream(_) => out.debug_tuple("Stream").finish_non_exhaustive(),
        }
    }
}

/// Topics whose choice is remembered; forgetting it costs asking again.
const MOST_CHOSEN: usize = 1 << 17;

/// Files of a capture, open and done.
pub(crate) struct Files {
    target: Target,
    attachments: Attachments,
    options: Options,
    chosen: HashMap<(Arc<str>, MessageKind, u32), bool>,
    open: Option<Open>,
    kept: Kept,
    sequences: Sequences,
    /// Files that were ended, with what is in them.
    pub(crate) done: Vec<(PathBuf, Written)>,
    parts: u32,
}

struct Open {
    path: PathBuf,
    writer: Writer<Out>,
    from_ns: Option<u64>,
}

impl Files {
    /// Begins the first file, unless it is to be a snapshot.
    pub(crate) fn begin(
        target: Target,
        attachments: Attachments,
        options: Options,
    ) -> Result<Self, WriteError> {
        let mut files = Self {
            target,
            attachments,
            kept: Kept::default(),
            options,
            chosen: HashMap::new(),
            open: None,
            sequences: Sequences::default(),
            done: Vec::new(),
            parts: 0,
        };
        if files.options.snapshot.is_none() {
            files.open()?;
        }
        Ok(files)
    }

    /// Takes a message: into the file, or into memory.
    pub(crate) fn take(&mut self, item: Item) -> Result<(), WriteError> {
        if let Some(snapshot) = self.options.snapshot {
            let alarm = self.kept.keep(item, snapshot);
            return if alarm && snapshot.on_alarm {
                self.write_down()
            } else {
                Ok(())
            };
        }
        if self.is_full(item.times.log_ns) {
            self.end()?;
            self.open()?;
        }
        self.write(&item)
    }

    /// Writes down what is kept in memory, if this is a snapshot and there is anything.
    pub(crate) fn write_down(&mut self) -> Result<(), WriteError> {
        if self.kept.items.is_empty() {
            return Ok(());
        }
        self.open()?;
        for item in self.kept.take() {
            self.write(&item)?;
        }
        self.end()
    }

    /// Writes the open chunk if it is due.
    pub(crate) fn look(&mut self, now_ns: u64) -> Result<(), WriteError> {
        match &mut self.open {
            Some(open) => open.writer.flush_if_due(now_ns),
            None => Ok(()),
        }
    }

    /// Ends the open file with its summary.
    pub(crate) fn end(&mut self) -> Result<(), WriteError> {
        let Some(open) = self.open.take() else {
            return Ok(());
        };
        let so_far = open.writer.written();
        match open.writer.finish() {
            Ok((written, sequences, _)) => {
                self.sequences = sequences;
                self.done.push((open.path, written));
                Ok(())
            }
            Err(error) => {
                self.done.push((open.path, so_far));
                Err(error)
            }
        }
    }

    /// What is in the open file so far, and in those that were ended.
    pub(crate) fn written(&self) -> Vec<(PathBuf, Written)> {
        let mut all = self.done.clone();
        if let Some(open) = &self.open {
            all.push((open.path.clone(), open.writer.written()));
        }
        all
    }

    fn is_full(&mut self, log_ns: u64) -> bool {
        let (Some(open), Target::File(_)) = (&mut self.open, &self.target) else {
            return false;
        };
        let from_ns = *open.from_ns.get_or_insert(log_ns);
        let is_long = log_ns.saturating_sub(from_ns) >= self.options.max_file_ns;
        is_long || open.writer.bytes() >= self.options.max_file_bytes
    }

    fn open(&mut self) -> Result<(), WriteError> {
        let settings = self.options.settings;
        if let (Target::File(path), true) = (&self.target, self.options.go_on) {
            while part(path, self.parts).exists() {
                self.parts += 1;
            }
        }
        let path = match &self.target {
            Target::File(path) => part(path, self.parts),
            Target::Stream(_) => PathBuf::from("-"),
        };
        let out: Out = match &mut self.target {
            Target::File(_) => {
                Box::new(
                    File::create_new(&path).map_err(|source| WriteError::Create {
                        path: path.clone(),
                        source,
                    })?,
                )
            }
            Target::Stream(out) => std::mem::replace(out, Box::new(std::io::sink())),
        };
        self.attachments.tell("part", self.parts.to_string());
        let sequences = self.sequences.clone();
        let writer = Writer::go_on(out, settings, &self.attachments, sequences)?;
        self.parts += 1;
        self.open = Some(Open {
            path,
            writer,
            from_ns: None,
        });
        Ok(())
    }

    fn write(&mut self, item: &Item) -> Result<(), WriteError> {
        if let Some(kind) = item.message.kind()
            && self.is_chosen(item, kind, 0)
            && let Some(open) = &mut self.open
        {
            open.writer.write(&item.fleet, item.times, &item.message)?;
        }
        if self.options.per_robot {
            self.write_robots(item)?;
        }
        Ok(())
    }

    fn write_robots(&mut self, item: &Item) -> Result<(), WriteError> {
        match &item.message {
            Message::Samples(_, rows) => {
                self.write_rows(item, rows, |row| Message::RobotSample(*row))
            }
            Message::Forecasts(_, rows) => {
                self.write_rows(item, rows, |row| Message::RobotForecast(*row))
            }
            Message::Diagnostics(_, rows) => {
                self.write_rows(item, rows, |row| Message::RobotDiagnostic(*row))
            }
            Message::Budgets(_, rows) => {
                self.write_rows(item, rows, |row| Message::RobotBudget(*row))
            }
            _ => Ok(()),
        }
    }

    fn write_rows<T>(
        &mut self,
        item: &Item,
        rows: &[T],
        message: impl Fn(&T) -> Message,
    ) -> Result<(), WriteError> {
        for message in rows.iter().map(message) {
            let (Some(kind), Some(robot)) = (message.kind(), message.robot()) else {
                continue;
            };
            if self.is_chosen(item, kind, robot)
                && let Some(open) = &mut self.open
            {
                open.writer.write(&item.fleet, item.times, &message)?;
            }
        }
        Ok(())
    }

    fn is_chosen(&mut self, item: &Item, kind: MessageKind, robot: u32) -> bool {
        let key = (Arc::clone(&item.fleet), kind, robot);
        let choose = &self.options.choose;
        if self.chosen.len() >= MOST_CHOSEN {
            self.chosen.clear();
        }
        *self
            .chosen
            .entry(key)
            .or_insert_with(|| choose(&kind.topic(&item.fleet, robot)))
    }
}

/// The name of the part with this number: `run.mcap`, `run_1.mcap`, `run_2.mcap`.
fn part(path: &Path, number: u32) -> PathBuf {
    if number == 0 {
        return path.to_owned();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let name = match path.extension() {
        Some(extension) => format!("{stem}_{number}.{}", extension.to_string_lossy()),
        None => format!("{stem}_{number}"),
    };
    path.with_file_name(name)
}

/// The last seconds, in memory. Goes back as far as is asked for, and from there to the keyframe
/// before, so that all of it can be computed again.
#[derive(Debug, Default)]
struct Kept {
    items: VecDeque<Item>,
    bytes: usize,
    /// Log times at which keyframes among the items begin.
    keyframes: VecDeque<u64>,
    /// Alarms of the robots in each fleet's newest diagnostics.
    alarms: HashMap<Arc<str>, HashMap<u32, u32>>,
}

impl Kept {
    /// Keeps the item and forgets what has become too old or too much; whether it raises an alarm.
    fn keep(&mut self, item: Item, snapshot: Snapshot) -> bool {
        let alarm = self.raises_alarm(&item);
        let from_ns = item.times.log_ns.saturating_sub(snapshot.keep_ns);
        if matches!(&item.message, Message::State(header, _) if header.offset == 0) {
            self.keyframes.push_back(item.times.log_ns);
        }
        self.bytes += item.bytes();
        self.items.push_back(item);
        let keyframe = self.keyframes.iter().rev().find(|at_ns| **at_ns <= from_ns);
        let from_ns = keyframe.copied().unwrap_or(from_ns);
        while let Some(oldest) = self.items.front()
            && (oldest.times.log_ns < from_ns || self.bytes > snapshot.max_bytes)
        {
            self.bytes -= oldest.bytes();
            self.items.pop_front();
        }
        let oldest_ns = self.items.front().map_or(0, |oldest| oldest.times.log_ns);
        while self
            .keyframes
            .front()
            .is_some_and(|at_ns| *at_ns < oldest_ns)
        {
            self.keyframes.pop_front();
        }
        alarm
    }

    /// Gives everything away; what was raised stays known.
    fn take(&mut self) -> VecDeque<Item> {
        self.bytes = 0;
        self.keyframes.clear();
        std::mem::take(&mut self.items)
    }

    fn raises_alarm(&mut self, item: &Item) -> bool {
        let Message::Diagnostics(_, rows) = &item.message else {
            return false;
        };
        let known = self.alarms.entry(Arc::clone(&item.fleet)).or_default();
        let mut raised = false;
        for row in rows {
            let before = known.get(&row.robot).copied().unwrap_or(0);
            raised |= row.alarms & !before != 0;
        }
        known.clear();
        known.extend(rows.iter().map(|row| (row.robot, row.alarms)));
        raised
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{StateHeader, TickHeader};

    use super::*;
    use crate::Times;

    fn item(log_ns: u64, message: Message) -> Item {
        Item {
            fleet: Arc::from("lab"),
            times: Times {
                log_ns,
                publish_ns: log_ns,
            },
            message,
        }
    }

    #[test]
    fn a_snapshot_goes_back_to_the_keyframe_before_its_window_within_its_bytes() {
        let tick = |at_ns| item(at_ns, Message::Ticks(TickHeader::default(), Vec::new()));
        let keyframe = |at_ns| item(at_ns, Message::State(StateHeader::default(), Vec::new()));
        let each = tick(0).bytes();
        // Window of 10; keyframes at these times; room for so many items; oldest that is kept at 100.
        for (keyframes, room, oldest_ns) in [
            (vec![], 1_000, 90),
            (vec![95], 1_000, 90),
            (vec![60, 85], 1_000, 85),
            (vec![60, 90], 1_000, 90),
            (vec![60], 1_000, 60),
            // No room to go back that far: the window alone.
            (vec![60], 20, 90),
            (vec![60], 5, 96),
        ] {
            let snapshot = Snapshot {
                keep_ns: 10,
                max_bytes: room * each,
                on_alarm: false,
            };
            let mut kept = Kept::default();
            for at_ns in 0..=100 {
                let is_keyframe = keyframes.contains(&at_ns);
                let item = if is_keyframe {
                    keyframe(at_ns)
                } else {
                    tick(at_ns)
                };
                assert!(!kept.keep(item, snapshot));
            }
            let found = kept.items.front().map(|item| item.times.log_ns);
            assert_eq!(found, Some(oldest_ns), "{keyframes:?}, room for {room}");
        }
    }
}
