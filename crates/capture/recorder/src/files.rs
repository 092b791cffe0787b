//! Output of a recording: one file, a split sequence of files, or a memory buffer that is saved on
//! events.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use joulebus_files::disk;
use joulebus_wire::{Diagnostics, State};

use crate::capture_file::{CaptureFile, Watch};
use crate::item::Item;
use crate::options::{Options, Snapshot};
use joulebus_capture_format::{
    Attachments, Frame, MessageKind, Sequences, WriteError, Writer, Written,
};

/// Destination of a capture.
pub enum Target {
    /// A file, with further parts next to it when split.
    File(PathBuf),
    /// A pipe or another writer. Never split.
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

/// Topics whose choice is remembered. Forgetting it costs asking again.
const MAX_CHOSEN: usize = 1 << 17;

/// Output of a part.
enum Out {
    File(CaptureFile),
    Stream(Box<dyn Write + Send>),
}

impl Write for Out {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.write(bytes),
            Self::Stream(stream) => stream.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::File(file) => file.flush(),
            Self::Stream(stream) => stream.flush(),
        }
    }
}

impl Out {
    /// Writes all buffered data. For a file also to the disk.
    fn end(self) -> Result<(), WriteError> {
        match self {
            Self::File(file) => file.sync().map_err(|error| WriteError::Failed {
                reason: format!("the disk may not have all of it: {error}"),
            }),
            Self::Stream(_) => Ok(()),
        }
    }
}

/// Files of a capture, open and finished. Every message passed to [`Files::take`] is in a file,
/// counted as lost, or kept in memory.
pub(crate) struct Files {
    target: Target,
    attachments: Attachments,
    options: Options,
    chosen: HashMap<(Arc<str>, MessageKind, u32), bool>,
    open: Option<Open>,
    snapshot: KeptItems,
    sequences: Sequences,
    /// Finished files with their statistics.
    done: Vec<(PathBuf, Written)>,
    /// Files that other processes have taken away, and how.
    taken: Vec<(PathBuf, &'static str)>,
    /// Lost messages by topic.
    lost: BTreeMap<String, u64>,
    parts: u32,
    /// True if the first file is open, or the memory buffer is filled.
    has_begun: bool,
}

struct Open {
    path: PathBuf,
    writer: Writer<Out>,
    /// None of a stream.
    watch: Option<Watch>,
    from_ns: Option<u64>,
}

impl Open {
    fn harm(&self) -> Option<&'static str> {
        self.watch.as_ref()?.harm()
    }
}

impl Files {
    /// Opens the first file, unless this is a snapshot.
    pub(crate) fn begin(
        target: Target,
        attachments: Attachments,
        options: Options,
    ) -> Result<Self, WriteError> {
        let mut files = Self {
            target,
            attachments,
            snapshot: KeptItems::default(),
            options,
            chosen: HashMap::new(),
            open: None,
            sequences: Sequences::default(),
            done: Vec::new(),
            taken: Vec::new(),
            lost: BTreeMap::new(),
            parts: 0,
            has_begun: false,
        };
        match &files.target {
            _ if files.options.snapshot.is_none() => files.open()?,
            Target::File(path) if !files.options.resume && disk::exists(path) => {
                let path = path.clone();
                return Err(WriteError::Exists { path });
            }
            _ => {}
        }
        files.has_begun = true;
        Ok(files)
    }

    /// Stores a message, in the file or in memory.
    pub(crate) fn take(&mut self, item: Item) -> Result<(), WriteError> {
        if let Some(snapshot) = self.options.snapshot {
            let alarm = self.snapshot.keep(item, snapshot);
            return if alarm && snapshot.on_alarm { self.write_down() } else { Ok(()) };
        }
        if self.is_full(item.times.log_ns)
            && let Err(error) = self.end().and_then(|()| self.open())
        {
            self.lose(&item);
            return Err(error);
        }
        self.write(&item)
    }

    /// Saves the memory buffer, if this is a snapshot and it is not empty.
    pub(crate) fn write_down(&mut self) -> Result<(), WriteError> {
        if self.snapshot.items.is_empty() {
            return Ok(());
        }
        let mut written = self.open();
        for item in self.snapshot.take() {
            match written {
                Ok(()) => written = self.write(&item),
                Err(_) => self.lose(&item),
            }
        }
        let ended = self.end();
        written.and(ended)
    }

    /// Counts a lost message.
    pub(crate) fn lose(&mut self, item: &Item) {
        *self.lost.entry(item.topic()).or_default() += 1;
    }

    /// Writes the open chunk if it is due.
    pub(crate) fn look(&mut self, now_ns: u64) -> Result<(), WriteError> {
        match &mut self.open {
            Some(open) => open.writer.flush_if_due(now_ns),
            None => Ok(()),
        }
    }

    /// Begins the next part if another process has removed, replaced or cut the open file.
    pub(crate) fn check(&mut self) -> Result<(), WriteError> {
        if self.open.as_ref().is_none_or(|open| open.harm().is_none()) {
            return Ok(());
        }
        self.end()?;
        self.open()
    }

    /// Finishes the open file with its summary. Messages that its writer could not write are lost,
    /// and those of a file that another process has taken away.
    pub(crate) fn end(&mut self) -> Result<(), WriteError> {
        let Some(mut open) = self.open.take() else {
            return Ok(());
        };
        let flushed = open.writer.flush();
        let so_far = open.writer.written();
        for (topic, count) in open.writer.unwritten() {
            *self.lost.entry(topic).or_default() += count;
        }
        let watch = open.watch.take();
        let finished = flushed.and_then(|()| open.writer.finish());
        let (written, ended) = match finished {
            Ok((written, sequences, out)) => {
                self.sequences = sequences;
                (written, out.end())
            }
            Err(error) => (so_far, Err(error)),
        };
        if let Some(harm) = watch.as_ref().and_then(Watch::harm) {
            tracing::error!(
                "{} was {harm} by another process while it was recorded: its {} messages are lost",
                open.path.display(),
                written.messages
            );
            for (topic, count) in written.by_topic {
                *self.lost.entry(topic).or_default() += count;
            }
            self.taken.push((open.path, harm));
            return Ok(());
        }
        self.done.push((open.path, written));
        ended
    }

    /// Statistics of the open file, and of the finished ones.
    pub(crate) fn written(&self) -> Vec<(PathBuf, Written)> {
        let mut all = self.done.clone();
        if let Some(open) = &self.open {
            all.push((open.path.clone(), open.writer.written()));
        }
        all
    }

    /// Files that other processes have removed, replaced or cut.
    pub(crate) fn taken(&self) -> &[(PathBuf, &'static str)] {
        &self.taken
    }

    /// Lost messages by topic, without those of the open file.
    pub(crate) fn lost(&self) -> &BTreeMap<String, u64> {
        &self.lost
    }

    /// State of the memory buffer. None unless this is a snapshot.
    pub(crate) fn kept(&self) -> Option<SnapshotContents> {
        self.options.snapshot.map(|_| self.snapshot.summary())
    }

    fn is_full(&mut self, log_ns: u64) -> bool {
        let (Some(open), Target::File(_)) = (&mut self.open, &self.target) else {
            return false;
        };
        let from_ns = *open.from_ns.get_or_insert(log_ns);
        let is_long = log_ns.saturating_sub(from_ns) >= self.options.max_file_ns;
        is_long
            || open.writer.bytes() >= self.options.max_file_bytes
            || open.writer.index_entries() >= self.options.max_index_entries
    }

    fn open(&mut self) -> Result<(), WriteError> {
        let settings = self.options.settings;
        // Only the first file is the user's choice: a recording that has begun does not end because
        // of a name.
        let passes_over = self.options.resume || self.has_begun;
        let (path, out) = match &mut self.target {
            Target::File(path) => loop {
                let path = part(path, self.parts);
                match CaptureFile::create(&path) {
                    Err(WriteError::Exists { .. }) if passes_over => self.parts += 1,
                    created => break (path, Out::File(created?)),
                }
            },
            Target::Stream(out) => {
                let out = std::mem::replace(out, Box::new(io::sink()));
                (PathBuf::from("-"), Out::Stream(out))
            }
        };
        self.attachments.describe("part", self.parts.to_string());
        let sequences = self.sequences.clone();
        let is_file = matches!(out, Out::File(_));
        let watch = match &out {
            Out::File(file) => {
                let watch = file.watch().map(Some);
                watch.map_err(|source| WriteError::Create { path: path.clone(), source })
            }
            Out::Stream(_) => Ok(None),
        };
        let opened = watch.and_then(|watch| {
            let writer = Writer::resume(out, settings, &self.attachments, sequences)?;
            Ok((watch, writer))
        });
        let (watch, writer) = opened.inspect_err(|_| {
            // Just created, without messages. Failing to remove it does not matter.
            if is_file {
                let _ = disk::remove_file(&path);
            }
        })?;
        self.parts += 1;
        self.open = Some(Open { path, writer, watch, from_ns: None });
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
        let kind = item.message.kind();
        let mut channels = self.options.channels.iter();
        if !channels.any(|channel| channel.kind.has_robots() && Some(channel.kind) == kind) {
            return Ok(());
        }
        let mut written = Ok(());
        item.message.each_robot(|row| {
            if written.is_ok()
                && let (Some(kind), Some(robot)) = (row.kind(), row.robot())
                && self.is_chosen(item, kind, robot)
                && let Some(open) = &mut self.open
            {
                written = open.writer.write(&item.fleet, item.times, &row);
            }
        });
        written
    }

    fn is_chosen(&mut self, item: &Item, kind: MessageKind, robot: u32) -> bool {
        let key = (Arc::clone(&item.fleet), kind, robot);
        let choose = &self.options.choose;
        if self.chosen.len() >= MAX_CHOSEN {
            self.chosen.clear();
        }
        *self.chosen.entry(key).or_insert_with(|| choose(&kind.topic(&item.fleet, robot)))
    }
}

/// The file name of a part: `run.mcap`, `run_1.mcap`, `run_2.mcap`. A name that is taken is passed
/// over.
fn part(path: &Path, number: u32) -> PathBuf {
    if number == 0 {
        return path.to_owned();
    }
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(format!("_{number}"));
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

/// A snapshot's contents in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SnapshotContents {
    /// Messages.
    pub messages: u64,
    /// Size of the messages, bytes.
    pub bytes: u64,
    /// From the oldest to the newest, ns.
    pub span_ns: u64,
}

/// The last seconds, in memory. Covers the configured time, and from there back to the keyframe
/// before, so that all of it can be recomputed.
#[derive(Debug, Default)]
struct KeptItems {
    items: VecDeque<Item>,
    bytes: usize,
    /// Log times at which keyframes among the items begin.
    keyframes: VecDeque<u64>,
    /// Alarms of the robots in each fleet's newest diagnostics.
    alarms: HashMap<Arc<str>, HashMap<u32, u32>>,
}

impl KeptItems {
    /// Stores the item and drops those that are too old or too many. Returns whether it raises an
    /// alarm.
    fn keep(&mut self, item: Item, snapshot: Snapshot) -> bool {
        let alarm = self.raises_alarm(&item);
        let from_ns = item.times.log_ns.saturating_sub(snapshot.keep_ns);
        if item.message.frame::<State>().is_some_and(|piece| piece.header.offset == 0) {
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
        while self.keyframes.front().is_some_and(|at_ns| *at_ns < oldest_ns) {
            self.keyframes.pop_front();
        }
        alarm
    }

    fn summary(&self) -> SnapshotContents {
        let log_ns = |item: Option<&Item>| item.map_or(0, |item| item.times.log_ns);
        let (oldest, newest) = (log_ns(self.items.front()), log_ns(self.items.back()));
        SnapshotContents {
            messages: self.items.len() as u64,
            bytes: self.bytes as u64,
            span_ns: newest.saturating_sub(oldest),
        }
    }

    /// Returns all items. The raised alarms stay known.
    fn take(&mut self) -> VecDeque<Item> {
        self.bytes = 0;
        self.keyframes.clear();
        std::mem::take(&mut self.items)
    }

    fn raises_alarm(&mut self, item: &Item) -> bool {
        let Some(Frame { rows, .. }) = item.message.frame::<Diagnostics>() else {
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
    use joulebus_wire::{StateHeader, TickHeader, Ticks};

    use super::*;
    use joulebus_capture_format::{Message, Times};

    fn item(log_ns: u64, message: Message) -> Item {
        Item { fleet: Arc::from("lab"), times: Times { log_ns, publish_ns: log_ns }, message }
    }

    #[test]
    fn a_snapshot_goes_back_to_the_keyframe_before_its_window_within_its_bytes() {
        let tick = |at_ns| item(at_ns, Message::of::<Ticks>(TickHeader::default(), Vec::new()));
        let keyframe =
            |at_ns| item(at_ns, Message::of::<State>(StateHeader::default(), Vec::new()));
        let each = tick(0).bytes();
        // Window of 10. Keyframes at these times. Capacity in items. Oldest item kept at time 100.
        for (keyframes, room, oldest_ns) in [
            (vec![], 1_000, 90),
            (vec![95], 1_000, 90),
            (vec![60, 85], 1_000, 85),
            (vec![60, 90], 1_000, 90),
            (vec![60], 1_000, 60),
            // Not enough capacity to go back that far: only the window.
            (vec![60], 20, 90),
            (vec![60], 5, 96),
        ] {
            let snapshot = Snapshot { keep_ns: 10, max_bytes: room * each, on_alarm: false };
            let mut kept = KeptItems::default();
            for at_ns in 0..=100 {
                let is_keyframe = keyframes.contains(&at_ns);
                let item = if is_keyframe { keyframe(at_ns) } else { tick(at_ns) };
                assert!(!kept.keep(item, snapshot));
            }
            let found = kept.items.front().map(|item| item.times.log_ns);
            assert_eq!(found, Some(oldest_ns), "{keyframes:?}, room for {room}");
        }
    }

    /// A disk with a capacity of `room` bytes.
    struct Disk {
        room: usize,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let fits = bytes.len().min(self.room);
            self.room -= fits;
            match fits {
                0 if !bytes.is_empty() => Err(io::ErrorKind::StorageFull.into()),
                fits => Ok(fits),
            }
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    const GIVEN: u64 = 9;

    /// Passes all messages to files on a disk of that capacity. Returns how many are written, lost
    /// and kept.
    fn record(room: usize, snapshot: Option<Snapshot>, write_down: bool) -> [u64; 3] {
        let options = Options {
            snapshot,
            settings: joulebus_capture_format::CaptureSettings {
                chunk_ns: 3,
                ..joulebus_capture_format::CaptureSettings::default()
            },
            ..Options::default()
        };
        let target = Target::Stream(Box::new(Disk { room }));
        let Ok(mut files) = Files::begin(target, Attachments::default(), options) else {
            return [0, GIVEN, 0];
        };
        let mut failed = false;
        for at_ns in 0..GIVEN {
            let tick = item(at_ns, Message::of::<Ticks>(TickHeader::default(), Vec::new()));
            if failed {
                files.lose(&tick);
            } else {
                failed = files.take(tick).is_err();
            }
        }
        if write_down && !failed {
            // Counted below.
            let _ = files.write_down();
        }
        let _ = files.end();
        let written = files.written().iter().map(|(_, file)| file.messages).sum();
        let kept = files.kept().map_or(0, |kept| kept.messages);
        [written, files.lost().values().sum(), kept]
    }

    #[test]
    fn a_recording_that_has_begun_passes_over_names_that_are_taken() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let tick = |at_ns| item(at_ns, Message::of::<Ticks>(TickHeader::default(), Vec::new()));
        let kept = Snapshot { keep_ns: 1_000, max_bytes: 1 << 20, on_alarm: false };
        let begin = |snapshot, resume| {
            let options = Options { max_file_ns: 10, snapshot, resume, ..Options::default() };
            Files::begin(Target::File(path.clone()), Attachments::default(), options)
        };
        let names = |files: &Files| -> Vec<String> {
            let name = |path: &Path| path.file_name().unwrap().to_str().unwrap().to_owned();
            files.written().iter().map(|(path, _)| name(path)).collect()
        };
        std::fs::write(folder.path().join("run_1.mcap"), "somebody's").unwrap();
        for (snapshot, resume, times, wanted) in [
            (None, false, 0..4, ["run.mcap", "run_2.mcap", "run_3.mcap"]),
            (Some(kept), true, 0..3, ["run_4.mcap", "run_5.mcap", "run_6.mcap"]),
        ] {
            let mut files = begin(snapshot, resume).unwrap();
            for at in times.clone() {
                files.take(tick(10 * at)).unwrap();
                files.write_down().unwrap();
            }
            files.end().unwrap();
            assert_eq!(names(&files), wanted);
            let messages: u64 = files.written().iter().map(|(_, summary)| summary.messages).sum();
            assert_eq!(messages, times.end);
            // The first name is refused at the start, also where nothing is written yet.
            for snapshot in [None, Some(kept)] {
                let refused = begin(snapshot, false).err();
                assert!(matches!(refused, Some(WriteError::Exists { .. })), "{refused:?}");
            }
        }
        std::fs::remove_file(&path).unwrap();
        let mut files = begin(Some(kept), false).unwrap();
        std::fs::write(&path, "came later").unwrap();
        files.take(tick(0)).unwrap();
        files.write_down().unwrap();
        assert_eq!(names(&files), ["run_7.mcap"]);
        let first = std::fs::read_to_string(folder.path().join("run_1.mcap"));
        assert_eq!(first.unwrap(), "somebody's");
    }

    #[test]
    fn a_file_whose_index_would_take_too_much_memory_is_followed_by_the_next() {
        let folder = tempfile::tempdir().unwrap();
        let target = Target::File(folder.path().join("run.mcap"));
        let options = Options { max_index_entries: 2, ..Options::default() };
        let mut files = Files::begin(target, Attachments::default(), options).unwrap();
        for second in 0..7 {
            let message = Message::of::<Ticks>(TickHeader::default(), Vec::new());
            files.take(item(second * 1_000_000_000, message)).unwrap();
        }
        files.end().unwrap();
        let messages = files.written().iter().map(|(_, of)| of.messages).collect::<Vec<_>>();
        assert_eq!(messages, [3, 3, 1], "the index of a chunk counts when it is written");
    }

    #[test]
    fn a_file_that_is_removed_replaced_or_cut_meanwhile_is_noticed_and_its_messages_are_lost() {
        for harm in ["removed", "replaced", "cut", "nothing"] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("run.mcap");
            let mut files = Files::begin(
                Target::File(path.clone()),
                Attachments::default(),
                Options::default(),
            )
            .unwrap();
            let message =
                |at_ns| item(at_ns, Message::of::<Ticks>(TickHeader::default(), Vec::new()));
            files.take(message(1)).unwrap();
            files.look(10_000_000_000).unwrap();
            files.check().unwrap();
            match harm {
                "removed" => std::fs::remove_file(&path).unwrap(),
                "replaced" => {
                    let other = folder.path().join("other");
                    std::fs::write(&other, vec![0; 1 << 20]).unwrap();
                    std::fs::rename(&other, &path).unwrap();
                }
                "cut" => std::fs::write(&path, "").unwrap(),
                _ => {}
            }
            files.take(message(2)).unwrap();
            files.look(20_000_000_000).unwrap();
            files.check().unwrap();
            files.take(message(3)).unwrap();
            files.end().unwrap();
            let lost: u64 = files.lost().values().sum();
            let (last, written) = files.written().pop().unwrap();
            if harm == "nothing" {
                assert_eq!((lost, written.messages), (0, 3));
                continue;
            }
            assert_eq!((lost, written.messages), (2, 1), "{harm}");
            assert_eq!(files.taken(), [(path.clone(), harm)]);
            assert_eq!(last, folder.path().join("run_1.mcap"), "{harm}");
            let read = joulebus_capture_format::Reader::open(&last).unwrap();
            assert_eq!(read.map(Result::unwrap).count(), 1, "{harm}");
        }
    }

    #[test]
    fn at_any_capacity_of_the_disk_every_message_is_written_lost_or_kept() {
        let snapshot = Some(Snapshot { keep_ns: 1_000, max_bytes: 1 << 20, on_alarm: false });
        assert_eq!(record(usize::MAX, snapshot, false), [0, 0, GIVEN]);
        for (snapshot, write_down) in [(None, false), (snapshot, true)] {
            assert_eq!(record(1 << 20, snapshot, write_down), [GIVEN, 0, 0]);
            let mut partly = 0;
            for room in 0..4_000 {
                let [written, lost, kept] = record(room, snapshot, write_down);
                assert_eq!(written + lost + kept, GIVEN, "room for {room}");
                partly += u64::from(written > 0 && lost > 0);
            }
            assert!(partly > 0 || snapshot.is_some());
        }
    }
}
