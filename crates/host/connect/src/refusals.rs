//! The samples that a worker refuses: what its sources and operators are told.
//!
//! The process of the worker keeps a small file in the fleet's directory, as for [raises](crate::raises).

use std::fmt::Write as _;
use std::io::{self, Read as _};
use std::path::PathBuf;
use std::{fmt, fs};

use joulebus_bus::clock;
use joulebus_config::Config;
use joulebus_settings::{DomainError, REFUSALS_FILE};
use joulebus_wire::DropReason;

/// Maximum size of a file that is read, bytes.
const MAX_BYTES: u64 = 1 << 20;
/// A refusal of which none has followed for this time is over, ns.
const ENDS_AFTER_NS: u64 = 5_000_000_000;

/// Refused samples, since the worker began or the entry did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refused {
    /// Id and run of the source.
    pub source: (u64, u64),
    /// The robot of the newest one.
    pub robot: u32,
    /// The reason.
    pub reason: DropReason,
    /// How many.
    pub count: u64,
    /// When the newest one came, monotonic ns.
    pub at_ns: u64,
    /// The field of the newest one that is out of range, what was found and what is allowed.
    pub found: Option<String>,
}

impl Refused {
    /// True if samples are still refused.
    #[must_use]
    pub fn is_recent(&self) -> bool {
        clock::monotonic_ns().saturating_sub(self.at_ns) <= ENDS_AFTER_NS
    }
}

impl fmt::Display for Refused {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { robot, reason, count, .. } = self;
        write!(
            out,
            "the worker has refused {count} samples ({}), the last of robot {robot}: ",
            reason.name()
        )?;
        if let Some(found) = &self.found {
            write!(out, "{found}. Remedy: ")?;
        }
        out.write_str(reason.remedy())
    }
}

/// All that a worker tells.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Refusals {
    /// By run of a source and reason.
    pub sources: Vec<Refused>,
    /// By robot, for their values.
    pub robots: Vec<Refused>,
}

impl Refusals {
    /// Reads those of the worker of `config`. Empty if none is told.
    #[must_use]
    pub fn read(config: &Config) -> Self {
        let mut text = String::new();
        let file = path(config).ok().and_then(|path| fs::File::open(path).ok());
        if let Some(file) = file {
            // One cut line loses no other.
            let _ = file.take(MAX_BYTES).read_to_string(&mut text);
        }
        let mut all = Self::default();
        for line in text.lines() {
            match line.split_once(' ') {
                Some(("source", rest)) => all.sources.extend(parse(rest)),
                Some(("robot", rest)) => all.robots.extend(parse(rest)),
                _ => {}
            }
        }
        all
    }

    /// Reads those of a run of a source, the most frequent first.
    #[must_use]
    pub fn of_source(config: &Config, source: (u64, u64)) -> Vec<Refused> {
        let mut own = Self::read(config).sources;
        own.retain(|refused| refused.source == source);
        own.sort_by_key(|refused| std::cmp::Reverse(refused.count));
        own
    }
}

fn parse(line: &str) -> Option<Refused> {
    let mut words = line.splitn(7, ' ');
    let mut number = || words.next()?.parse::<u64>().ok();
    let (source, robot) = ((number()?, number()?), number()?);
    let (count, at_ns) = (number()?, number()?);
    let name = words.next()?;
    let reason = DropReason::ALL.into_iter().find(|reason| reason.name() == name)?;
    let found = words.next().filter(|found| !found.is_empty()).map(str::to_owned);
    Some(Refused { source, robot: robot.try_into().ok()?, reason, count, at_ns, found })
}

/// The file of a worker's process. It ends with this value.
#[derive(Debug)]
pub struct RefusalsFile {
    path: PathBuf,
    written: Refusals,
}

impl RefusalsFile {
    /// The file of the fleet of `config`, which is not written yet. Only the process with the
    /// fleet's worker lock may write it.
    ///
    /// # Errors
    /// The config's domain is invalid.
    pub fn new(config: &Config) -> Result<Self, DomainError> {
        Ok(Self { path: path(config)?, written: Refusals::default() })
    }

    /// Writes what is new. A reader sees all of it or what was before.
    ///
    /// # Errors
    /// The file cannot be written. The next call tries again.
    pub fn write(&mut self, refusals: Refusals) -> io::Result<()> {
        if refusals == self.written {
            return Ok(());
        }
        let mut text = String::new();
        for (kind, list) in [("source", &refusals.sources), ("robot", &refusals.robots)] {
            for Refused { source: (id, run), robot, reason, count, at_ns, found } in list {
                let (name, found) = (reason.name(), found.as_deref().unwrap_or_default());
                // Writing to a string cannot fail.
                let _ = writeln!(text, "{kind} {id} {run} {robot} {count} {at_ns} {name} {found}");
            }
        }
        let draft = self.path.with_extension("new");
        fs::write(&draft, text)?;
        fs::rename(draft, &self.path)?;
        self.written = refusals;
        Ok(())
    }
}

impl Drop for RefusalsFile {
    fn drop(&mut self) {
        // What is old counts as over, and the last member removes it.
        let _ = fs::remove_file(&self.path);
    }
}

fn path(config: &Config) -> Result<PathBuf, DomainError> {
    Ok(config.domain()?.directory().join(REFUSALS_FILE))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn a_source_reads_its_own_refusals_with_field_value_range_and_remedy() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let root = folder.path();
        let text = format!(
            "[fleet]\nname = \"lab\"\n[domain]\nroot = {root:?}\n[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n"
        );
        let config = Config::parse(&text, Path::new(".")).expect("a config");
        assert_eq!(Refusals::read(&config), Refusals::default(), "there is no fleet");
        let directory = config.domain().expect("valid").directory();
        fs::create_dir_all(&directory).expect("a directory");
        let mut file = RefusalsFile::new(&config).expect("valid");
        let refused = |source, reason, count, found: Option<&str>| Refused {
            source: (source, 5),
            robot: 7,
            reason,
            count,
            at_ns: clock::monotonic_ns(),
            found: found.map(str::to_owned),
        };
        let found = "power_w is 3500, allowed are 0 to 20";
        let all = Refusals {
            sources: vec![
                refused(1, DropReason::PowerOutOfRange, 3, Some(found)),
                refused(1, DropReason::ForeignSource, 40, None),
                refused(2, DropReason::OldEpoch, 9, None),
            ],
            robots: vec![refused(1, DropReason::PowerOutOfRange, 3, Some(found))],
        };
        file.write(all.clone()).expect("written");
        assert_eq!(Refusals::read(&config), all);
        let own = Refusals::of_source(&config, (1, 5));
        assert_eq!(own.iter().map(|one| one.count).collect::<Vec<_>>(), [40, 3]);
        assert_eq!(Refusals::of_source(&config, (1, 6)), [], "another run");
        assert!(own[0].is_recent() && own[0].to_string().contains("end one of the two"));
        assert!(own[1].to_string().contains(found), "{}", own[1]);
        assert!(
            !Refused { at_ns: 0, ..own[0].clone() }.is_recent()
                || clock::monotonic_ns() < ENDS_AFTER_NS
        );
        // Nonsense hides no other line.
        fs::write(directory.join(REFUSALS_FILE), "x\nsource 1\nsource 2 5 7 9 1 OldEpoch \n")
            .expect("written");
        assert_eq!(Refusals::of_source(&config, (2, 5)).len(), 1);
        drop(file);
        assert_eq!(fs::read_dir(&directory).expect("it is there").count(), 0);
    }
}
