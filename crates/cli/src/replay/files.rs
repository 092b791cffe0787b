//! The files of a recording, read as one stream.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;

use anyhow::{Context as _, anyhow, bail};
use joulebus_capture_format::{Attachments, Entry, ReadError, Reader};
use joulebus_capture_verify::is_comparable;
use joulebus_config::Config;
use joulebus_program::exit::UsageError;
use joulebus_program::output::log_line;
use joulebus_wire::TICK_RULES;

/// Messages per batch from the reader thread.
const AT_ONCE: usize = 64;
/// Capacity of the queue, batches.
const WAITING: usize = 16;

/// The files of a replay, opened but not yet read.
pub(super) struct Files {
    paths: Vec<PathBuf>,
    pub(super) attachments: Attachments,
    pub(super) fleet: String,
}

/// A message, the name of another fleet that has one, or the error that ends the stream.
type Read = Result<Entry, Unread>;

/// What is not given as a message.
enum Unread {
    Damage(String),
    Elsewhere(Arc<str>),
}

impl Files {
    /// Opens the first file. `fleet`: which one, if the capture contains several.
    pub(super) fn open(paths: &[PathBuf], fleet: Option<&str>) -> anyhow::Result<Self> {
        let Some(first) = paths.first() else {
            return Err(UsageError("no capture given".to_owned()).into());
        };
        let reader = Reader::open(first).with_context(|| first.display().to_string())?;
        let attachments = reader.attachments().clone();
        let mut fleets: Vec<String> = attachments.fleets().map(str::to_owned).collect();
        if fleets.is_empty() {
            // Not from this recorder: the fleets are taken from the messages.
            let found = first_fleet(reader).with_context(|| first.display().to_string())?;
            fleets.push(found);
        }
        let fleet = choose(&fleets, fleet)
            .map_err(|what| UsageError(format!("{}: {what}", first.display())))?;
        let files = Self { paths: paths.to_vec(), attachments, fleet };
        if let Some(altered) = files.altered() {
            log_line(&format!("warning: {altered}"));
        }
        Ok(files)
    }

    /// True if the first file has a fleet of this name, which can be chosen instead.
    pub(super) fn has(&self, fleet: &str) -> bool {
        self.attachments.fleets().any(|attached| attached == fleet)
    }

    /// Number of the rules by which the answers in all files were computed. `None` if they differ,
    /// as where a recording went on after an update.
    pub(super) fn answer_rules(&self) -> Option<u32> {
        let rules = self.attachments.answer_rules();
        let is_same = |attachments: &Attachments| attachments.answer_rules() == rules;
        self.unlike(is_same).is_none().then_some(rules)
    }

    /// Number of the rules by which the ticks in all files were computed. Refuses files of which
    /// this version computes no channel to the same bits, and files of several rules.
    pub(super) fn tick_rules(&self) -> anyhow::Result<u32> {
        let rules = self.attachments.tick_rules();
        let is_ours =
            |attachments: &Attachments| attachments.tick_rules() == rules && is_comparable(rules);
        let Some((path, attachments)) = self.unlike(is_ours) else {
            return Ok(rules);
        };
        bail!(
            "{}: its ticks were computed by rules {}, and this version computes by {TICK_RULES}. \
                Verify it with the version that recorded it ({}), or play it without --verify",
            path.display(),
            attachments.tick_rules(),
            attachments.about("version").unwrap_or("unknown"),
        )
    }

    /// Refuses files that are not in the order in which they were recorded. The order of files of
    /// other fleets says nothing.
    pub(super) fn check_order(&self) -> Result<(), UsageError> {
        let from_ns = |path: &PathBuf| {
            let mut reader = Reader::open(path).ok()?;
            let attached: Vec<&str> = reader.attachments().fleets().collect();
            let is_ours = attached.is_empty() || attached.contains(&&*self.fleet);
            let first = is_ours.then(|| reader.find_map(Result::ok)).flatten()?;
            Some(first.log_time_ns)
        };
        let from_ns: Vec<Option<u64>> = self.paths.iter().map(from_ns).collect();
        let mut known: Vec<(u64, &PathBuf)> = from_ns
            .iter()
            .zip(&self.paths)
            .filter_map(|(from_ns, path)| from_ns.map(|from_ns| (from_ns, path)))
            .collect();
        if known.is_sorted_by_key(|(from_ns, _)| *from_ns) {
            return Ok(());
        }
        known.sort();
        let sorted: Vec<String> =
            known.iter().map(|(_, path)| path.display().to_string()).collect();
        Err(UsageError(format!(
            "the files are not in the order in which they were recorded. Give them as {}",
            sorted.join(" ")
        )))
    }

    /// Attachments that were changed since the first file was written.
    pub(super) fn altered(&self) -> Option<String> {
        let altered = self.attachments.altered();
        let path = self.paths.first()?.display();
        (!altered.is_empty())
            .then(|| format!("{path}: changed since it was written: {}", altered.join(", ")))
    }

    /// The first file whose attachments are not as asked. One that cannot be opened has none.
    fn unlike(&self, is_like: impl Fn(&Attachments) -> bool) -> Option<(&Path, Attachments)> {
        if let (Some(path), false) = (self.paths.first(), is_like(&self.attachments)) {
            return Some((path, self.attachments.clone()));
        }
        self.paths.iter().skip(1).find_map(|path| {
            let attachments = Reader::open(path).ok()?.attachments().clone();
            (!is_like(&attachments)).then_some((path.as_path(), attachments))
        })
    }

    /// The config attached to the capture with its models, or the given one instead. Files beside
    /// them are not read.
    pub(super) fn config(&self, instead: Option<&PathBuf>) -> anyhow::Result<Config> {
        if let Some(path) = instead {
            return Ok(Config::load(path)?);
        }
        let Some(text) = self.attachments.config(&self.fleet) else {
            let fleet = &self.fleet;
            let what = format!("no config of fleet {fleet:?} is attached: give one with --config");
            return Err(UsageError(what).into());
        };
        Ok(Config::parse_attached(text, &self.attachments.files(&self.fleet))?)
    }

    /// All messages of the fleet in file order, read by a separate thread.
    pub(super) fn read(&self) -> Messages {
        let (give, waiting) = sync_channel(WAITING);
        let (paths, fleet) = (self.paths.clone(), self.fleet.clone());
        thread::spawn(move || {
            let mut batch = Vec::with_capacity(AT_ONCE);
            let mut hand = |read: Option<Read>, flush: bool| {
                batch.extend(read);
                let full = batch.len() == AT_ONCE || flush;
                // The receiver is gone: stop reading.
                !full || give.send(std::mem::take(&mut batch)).is_ok()
            };
            for path in paths {
                let damage = |error: &ReadError| format!("{}: {error}", path.display());
                let reader = match Reader::open(&path) {
                    Ok(reader) => reader,
                    Err(error) => {
                        hand(Some(Err(Unread::Damage(damage(&error)))), true);
                        continue;
                    }
                };
                let is_attached = reader.attachments().fleets().any(|attached| attached == fleet);
                let (mut has_ours, mut other) = (is_attached, None);
                for entry in reader {
                    let read = match entry {
                        Ok(entry) if *entry.fleet != *fleet => {
                            other.get_or_insert(Arc::clone(&entry.fleet));
                            Err(Unread::Elsewhere(entry.fleet))
                        }
                        entry => entry.map_err(|error| Unread::Damage(damage(&error))),
                    };
                    has_ours |= read.is_ok();
                    if !hand(Some(read), false) {
                        return;
                    }
                }
                if let Some(other) = other.filter(|_| !has_ours) {
                    let path = path.display();
                    let what =
                        format!("{path}: is of fleet {other:?}, and has nothing of {fleet:?}");
                    if !hand(Some(Err(Unread::Damage(what))), false) {
                        return;
                    }
                }
            }
            hand(None, true);
        });
        Messages {
            waiting,
            batch: Vec::new().into_iter(),
            damages: Vec::new(),
            of_others: BTreeMap::new(),
        }
    }

    /// Name of the first file, for reports.
    pub(super) fn name(&self) -> String {
        let names = self.paths.iter().map(|path| path.display().to_string());
        names.collect::<Vec<String>>().join(" ")
    }
}

/// The messages of the files. Read errors are kept until the end.
pub(super) struct Messages {
    waiting: Receiver<Vec<Read>>,
    batch: std::vec::IntoIter<Read>,
    pub(super) damages: Vec<String>,
    /// Number of messages of each other fleet.
    pub(super) of_others: BTreeMap<Arc<str>, u64>,
}

impl Iterator for Messages {
    type Item = Entry;

    fn next(&mut self) -> Option<Entry> {
        loop {
            match self.batch.next() {
                Some(Ok(entry)) => return Some(entry),
                Some(Err(Unread::Damage(damage))) => self.damages.push(damage),
                Some(Err(Unread::Elsewhere(fleet))) => {
                    *self.of_others.entry(fleet).or_default() += 1;
                }
                None => self.batch = self.waiting.recv().ok()?.into_iter(),
            }
        }
    }
}

/// The fleet of the first message that has one. Without any, the first damage.
fn first_fleet(reader: Reader<std::fs::File>) -> anyhow::Result<String> {
    let mut damage = None;
    for entry in reader {
        match entry {
            Ok(entry) if !entry.fleet.is_empty() => return Ok(entry.fleet.to_string()),
            Ok(_) => {}
            Err(error) => drop(damage.get_or_insert(error)),
        }
    }
    Err(damage
        .map_or_else(|| anyhow!("contains no fleet. Is it a capture of joulebus?"), Into::into))
}

fn choose(fleets: &[String], wanted: Option<&str>) -> Result<String, String> {
    let there = fleets.join(", ");
    match (wanted, fleets) {
        (Some(wanted), _) if fleets.iter().any(|fleet| fleet == wanted) => Ok(wanted.to_owned()),
        (Some(wanted), _) => Err(format!("contains no fleet {wanted:?}, its fleets: {there}")),
        (None, [only]) => Ok(only.clone()),
        (None, _) => Err(format!("contains several fleets: choose with --fleet: {there}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_fleet_is_the_default_and_one_of_several_must_be_given() {
        let fleets = |names: &[&str]| -> Vec<String> {
            names.iter().map(|name| (*name).to_owned()).collect()
        };
        assert_eq!(choose(&fleets(&["lab"]), None).unwrap(), "lab");
        assert_eq!(choose(&fleets(&["lab", "yard"]), Some("yard")).unwrap(), "yard");
        for (there, wanted, expected) in
            [(fleets(&["lab", "yard"]), None, "lab, yard"), (fleets(&["lab"]), Some("yard"), "lab")]
        {
            let error = choose(&there, wanted).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
