//! Implausible findings of sources in their own reports.
//!
//! A source that judges writes a small file beside the fleet's shared memory, and readers raise the
//! alarm `Implausible`. Beside it, the source flags its samples
//! ([`joulebus_wire::sample_flag::IMPLAUSIBLE`]), so that answers about plans follow from captures.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::{fmt, fs};

use joulebus_bus::clock;
use joulebus_config::Config;
use joulebus_wire::fnv1a;

/// A file is written again after this time, so that readers know that its source lives.
const AGAIN: Duration = Duration::from_secs(3);
/// A file that is older is of a source that was killed.
const EXPIRES: Duration = Duration::from_secs(15);
/// Maximum size of a file, bytes, of lines in one, and of letters that state what was found: so all
/// lines are read.
const MAX_BYTES: u64 = 1 << 20;
const MAX_LINES: usize = 12_000;
const MAX_LETTERS: usize = 10;
/// Beginning of a line, and what stands before the time of the first finding, monotonic ns.
const ROBOT: &str = "robot ";
const SINCE: &str = " since ";
/// Suffix of a file that is being written. No other name ends with it: a source's part has no `.`.
const DRAFT: &str = ".new";

/// Beginning of a file's name. It names the fleet, because several share the default root. No name
/// of a fleet has a `.`.
fn beginning(config: &Config) -> String {
    format!("findings-{}.", config.fleet())
}

/// The findings of one source. They end with it.
#[derive(Debug)]
pub struct FindingsFile {
    path: PathBuf,
    written: String,
    at: Option<Instant>,
    /// When the present findings of a robot began, monotonic ns.
    since_ns: BTreeMap<u32, u64>,
}

impl FindingsFile {
    /// Opens the file of a source of the fleet of `config`, without findings.
    #[must_use]
    pub fn new(config: &Config, source: &str) -> Self {
        let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_".contains(letter);
        let plain = source.chars().map(|c| if is_plain(c) { c } else { '_' });
        let plain: String = plain.take(64).collect();
        // What is legible may be another source's as well.
        let hash = fnv1a(source.bytes());
        let name = format!("{}{plain}-{hash:016x}", beginning(config));
        Self {
            path: config.root().join(name),
            written: String::new(),
            at: None,
            since_ns: BTreeMap::new(),
        }
    }

    /// Writes the robots that are implausible now, with the kind of each finding in a word. Call it
    /// every second. Returns how many lines are too many for the file, when that is news.
    ///
    /// # Errors
    /// The file cannot be written. The next call tries again.
    pub fn write<F: fmt::Display>(
        &mut self,
        found: impl IntoIterator<Item = (u32, F)>,
    ) -> io::Result<usize> {
        let (now_ns, before_ns) = (clock::monotonic_ns(), std::mem::take(&mut self.since_ns));
        let lines = found.into_iter().map(|(robot, found)| {
            let found = found.to_string().replace(char::is_control, " ");
            let found: String = found.chars().take(MAX_LETTERS).collect();
            let since_ns = before_ns.get(&robot).copied().unwrap_or(now_ns);
            self.since_ns.insert(robot, since_ns);
            format!("{ROBOT}{robot}: {found}{SINCE}{since_ns}\n")
        });
        let lines: BTreeSet<String> = lines.collect();
        let cut = lines.len().saturating_sub(MAX_LINES);
        let mut text: String = lines.into_iter().take(MAX_LINES).collect();
        if cut > 0 {
            text.push_str(&format!("and {cut} more\n"));
        }
        let is_due = self.at.is_none_or(|at| at.elapsed() >= AGAIN);
        if text == self.written && (text.is_empty() || !is_due) {
            return Ok(0);
        }
        if text.is_empty() {
            remove(&self.path)?;
        } else {
            let mut draft = self.path.clone().into_os_string();
            draft.push(DRAFT);
            fs::write(&draft, &text)?;
            fs::rename(&draft, &self.path)?;
        }
        self.at = Some(Instant::now());
        let is_news = std::mem::replace(&mut self.written, text) != self.written;
        Ok(if is_news { cut } else { 0 })
    }
}

impl Drop for FindingsFile {
    fn drop(&mut self) {
        if !self.written.is_empty() {
            // Readers take no old file.
            let _ = remove(&self.path);
        }
    }
}

fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// The robots of which a living source finds something implausible, and since when, monotonic ns.
#[must_use]
pub fn implausible_robots(config: &Config) -> BTreeMap<u32, u64> {
    let beginning = beginning(config);
    // Without a fleet there is no directory.
    let entries = fs::read_dir(config.root()).into_iter().flatten().flatten();
    let of_fleet = entries.filter(|entry| {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        name.starts_with(&beginning) && !name.ends_with(DRAFT)
    });
    let mut first_ns = BTreeMap::new();
    for (robot, since_ns) in of_fleet.flat_map(|entry| robots(&entry.path())) {
        let first_ns = first_ns.entry(robot).or_insert(since_ns);
        *first_ns = since_ns.min(*first_ns);
    }
    first_ns
}

fn robots(path: &Path) -> Vec<(u32, u64)> {
    let read = || -> io::Result<Vec<u8>> {
        let file = fs::File::open(path)?;
        let modified = file.metadata()?.modified()?;
        let mut text = Vec::new();
        if modified.elapsed().is_ok_and(|age| age <= EXPIRES) {
            file.take(MAX_BYTES).read_to_end(&mut text)?;
        }
        Ok(text)
    };
    // One that was removed meanwhile has none.
    let text = read().unwrap_or_default();
    // One cut letter loses no other line.
    let text = String::from_utf8_lossy(&text);
    let now_ns = clock::monotonic_ns();
    let robot = |line: &str| {
        let (robot, found) = line.strip_prefix(ROBOT)?.split_once(':')?;
        // Nothing was found in the future, and a line without a time may be new.
        let since = found.rsplit_once(SINCE).and_then(|(_, since_ns)| since_ns.parse().ok());
        Some((robot.parse().ok()?, since.unwrap_or(now_ns).min(now_ns)))
    };
    text.lines().filter_map(robot).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(folder: &Path, fleet: &str) -> Config {
        let text = format!(
            "[fleet]\nname = {fleet:?}\n[domain]\nroot = {folder:?}\n[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n"
        );
        Config::parse(&text, Path::new(".")).expect("a config")
    }

    fn found(config: &Config) -> Vec<u32> {
        implausible_robots(config).into_keys().collect()
    }

    #[test]
    fn a_reader_learns_when_findings_began_and_not_when_it_looked() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let config = config(folder.path(), "lab");
        let mut file = FindingsFile::new(&config, "bridge");
        let before_ns = clock::monotonic_ns();
        file.write([(7, "sign")]).expect("written");
        let first_ns = implausible_robots(&config)[&7];
        assert!((before_ns..=clock::monotonic_ns()).contains(&first_ns));
        // Another finding is added, and one robot's ends.
        file.write([(7, "sign"), (7, "unit"), (9, "unit")]).expect("written");
        let both = implausible_robots(&config);
        assert!(both[&7] == first_ns && both[&9] > first_ns, "{both:?}");
        file.write([(9, "unit")]).expect("written");
        file.write([(7, "sign"), (9, "unit")]).expect("written");
        let again = implausible_robots(&config);
        assert!(again[&7] > first_ns && again[&9] == both[&9], "{again:?}");
        // Of another program, or of a clock that is not ours.
        fs::write(&file.path, "robot 3: sign\nrobot 4: sign since 18446744073709551615\n")
            .expect("written");
        let foreign = implausible_robots(&config);
        assert!(foreign.values().all(|since_ns| *since_ns <= clock::monotonic_ns()));
        assert_eq!(found(&config), [3, 4]);
    }

    #[test]
    fn a_fleet_does_not_read_another_whose_name_begins_as_its_own() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let [lab, other] = ["lab", "lab-2"].map(|fleet| config(folder.path(), fleet));
        let mut findings = FindingsFile::new(&other, "bridge");
        findings.write([(7, "sign")]).expect("written");
        assert_eq!(found(&lab), []);
        assert_eq!(found(&other), [7]);
    }

    #[test]
    fn sources_whose_names_look_alike_have_a_file_each() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let config = config(folder.path(), "lab");
        let long = "a".repeat(64);
        let names = ["a/b", "a b", "a_b", &long, &format!("{long}a")];
        let mut files = names.map(|name| FindingsFile::new(&config, name));
        for (robot, file) in (0..).zip(&mut files) {
            file.write([(robot, "sign")]).expect("written");
        }
        assert_eq!(found(&config), [0, 1, 2, 3, 4]);
        files[2].write::<&str>([]).expect("removed");
        assert_eq!(found(&config), [0, 1, 3, 4]);
    }

    #[test]
    fn long_and_foreign_text_loses_no_robot_and_what_is_cut_is_reported() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let config = config(folder.path(), "lab");
        let mut file = FindingsFile::new(&config, "bridge");
        let many = |count: u32| (0..count).map(|robot| (robot, "\u{1F916}".repeat(300)));
        assert_eq!(file.write(many(MAX_LINES as u32)).expect("written"), 0);
        assert_eq!(implausible_robots(&config).len(), MAX_LINES);
        assert_eq!(file.write(many(MAX_LINES as u32 + 7)).expect("written"), 7);
        let text = fs::read_to_string(&file.path).expect("text");
        assert!(text.ends_with("and 7 more\n") && (text.len() as u64) < MAX_BYTES);
        fs::write(&file.path, b"robot 7: \xf0\x9f\nrobot 3: sign\n").expect("written");
        assert_eq!(found(&config), [3, 7]);
    }

    #[test]
    fn findings_are_read_while_their_source_lives() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let config = config(folder.path(), "lab");
        let found = || found(&config);
        assert_eq!(found(), []);
        let (mut one, mut other) =
            (FindingsFile::new(&config, "bridge"), FindingsFile::new(&config, "../other bridge"));
        one.write([(7, "sign"), (7, "unit: two\nlines"), (3, "sign")]).expect("written");
        other.write([(9, "sign")]).expect("written");
        assert_eq!(found(), [3, 7, 9]);
        one.write::<&str>([]).expect("removed");
        assert_eq!(found(), [9]);
        drop(other);
        assert_eq!(found(), []);
        // Left by a source that was killed.
        one.write([(7, "sign")]).expect("written");
        let file = fs::File::open(&one.path).expect("it is there");
        let written = file.metadata().and_then(|metadata| metadata.modified());
        let written = written.expect("a time");
        file.set_modified(written - 2 * EXPIRES).expect("set");
        assert_eq!(found(), []);
    }
}
