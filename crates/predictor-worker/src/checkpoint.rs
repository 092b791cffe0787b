//! The ledger on disk, so that a restarted worker continues with every robot's account.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use joulebus_fleet::Ledger;
use joulebus_wire::{Budget, budget_flag};
use serde::{Deserialize, Serialize};

/// Version of the file.
const SCHEMA: u32 = 1;

/// All robots' accounts at one moment.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Checkpoint {
    schema: u32,
    /// Name of the fleet: another fleet's file is refused.
    pub fleet: String,
    /// The machine's run that the stamps belong to.
    pub boot_id: String,
    /// When it was written, monotonic ns of that run.
    pub written_ns: u64,
    /// When it was written, Unix ns.
    pub written_unix_ns: u64,
    /// Accounts by robot id.
    pub robots: BTreeMap<u32, Account>,
}

/// One robot's account, as in [`joulebus_wire::Budget`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Account {
    drawn_uj: i64,
    drawn_remainder: i64,
    forecast_uj: i64,
    metered_ns: u64,
    unmetered_ns: u64,
    stamp_ns: u64,
    /// As [`budget_flag::CHARGED`].
    charged: bool,
}

/// Why a checkpoint could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckpointError {
    /// The system refused.
    #[error("ledger checkpoint {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a checkpoint.
    #[error(
        "ledger checkpoint {path} cannot be read: {source}; move it away to begin a new account"
    )]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where and what.
        source: serde_json::Error,
    },
    /// The file is another fleet's, or of another version.
    #[error(
        "ledger checkpoint {path} is of fleet {found:?} in version {found_schema}, expected {expected:?} in version {SCHEMA}; \
         give each fleet a file of its own"
    )]
    Foreign {
        /// The file.
        path: PathBuf,
        /// Fleet it is of.
        found: String,
        /// Version it is in.
        found_schema: u32,
        /// Fleet it should be of.
        expected: String,
    },
}

impl Checkpoint {
    /// A checkpoint without accounts.
    #[must_use]
    pub fn new(fleet: &str, boot_id: &str) -> Self {
        Self {
            schema: SCHEMA,
            fleet: fleet.to_owned(),
            boot_id: boot_id.to_owned(),
            written_ns: 0,
            written_unix_ns: 0,
            robots: BTreeMap::new(),
        }
    }

    /// Reads the file of `fleet`; `None` when there is none.
    ///
    /// # Errors
    /// It cannot be read, is malformed, or is another fleet's.
    pub fn read(path: &Path, fleet: &str) -> Result<Option<Self>, CheckpointError> {
        let text = match std::fs::read(path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(source) => {
                return Err(CheckpointError::Io {
                    path: path.to_owned(),
                    source,
                });
            }
        };
        let read: Self =
            serde_json::from_slice(&text).map_err(|source| CheckpointError::Malformed {
                path: path.to_owned(),
                source,
            })?;
        if read.schema != SCHEMA || read.fleet != fleet {
            return Err(CheckpointError::Foreign {
                path: path.to_owned(),
                found: read.fleet,
                found_schema: read.schema,
                expected: fleet.to_owned(),
            });
        }
        Ok(Some(read))
    }

    /// Writes the file whole or not at all: a kill at any point leaves the last one or this one.
    ///
    /// # Errors
    /// The system refused; the last file is still there.
    pub fn write(&self, path: &Path) -> Result<(), CheckpointError> {
        self.write_aside(path)
            .map_err(|source| CheckpointError::Io {
                path: path.to_owned(),
                source,
            })
    }

    fn write_aside(&self, path: &Path) -> std::io::Result<()> {
        let mut aside = path.as_os_str().to_owned();
        aside.push(".new");
        let aside = PathBuf::from(aside);
        if let Some(directory) = path
            .parent()
            .filter(|parent| !parent.as_os_str().is_empty())
        {
            std::fs::create_dir_all(directory)?;
        }
        let mut file = File::create(&aside)?;
        file.write_all(&serde_json::to_vec(self)?)?;
        file.sync_all()?;
        std::fs::rename(&aside, path)
    }

    /// Takes the accounts of a frame of budgets.
    pub fn take(&mut self, budgets: &[Budget]) {
        for budget in budgets
            .iter()
            .filter(|budget| budget.flags & budget_flag::LEDGER != 0)
        {
            let account = Account {
                drawn_uj: budget.drawn_uj,
                drawn_remainder: budget.drawn_remainder,
                forecast_uj: budget.forecast_uj,
                metered_ns: budget.metered_ns,
                unmetered_ns: budget.unmetered_ns,
                stamp_ns: budget.stamp_ns,
                charged: budget.flags & budget_flag::CHARGED != 0,
            };
            self.robots.insert(budget.robot, account);
        }
    }

    /// Makes the accounts fit the machine's present run: after a reboot the stamps restart, and
    /// the time in between, known from the wall clock alone, is unmetered.
    #[must_use]
    pub fn carried_over(mut self, boot_id: &str, now_ns: u64, now_unix_ns: u64) -> Self {
        if self.boot_id == boot_id {
            return self;
        }
        let away_ns = now_unix_ns.saturating_sub(self.written_unix_ns);
        for account in self.robots.values_mut() {
            let before_ns = self.written_ns.saturating_sub(account.stamp_ns);
            account.unmetered_ns = account
                .unmetered_ns
                .saturating_add(away_ns)
                .saturating_add(before_ns);
            account.stamp_ns = now_ns;
        }
        boot_id.clone_into(&mut self.boot_id);
        self
    }

    /// The accounts as ledgers, each with its robot and whether that has been on its charger.
    pub fn ledgers(&self) -> impl Iterator<Item = (u32, Ledger, bool)> + '_ {
        self.robots.iter().map(|(robot, account)| {
            let drawn = (account.drawn_uj, account.drawn_remainder);
            let (metered_ns, unmetered_ns) = (account.metered_ns, account.unmetered_ns);
            let ledger = Ledger::restored(
                drawn,
                account.forecast_uj,
                metered_ns,
                unmetered_ns,
                account.stamp_ns,
            );
            (*robot, ledger, account.charged)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkpoint() -> Checkpoint {
        let budget = Budget {
            robot: 3,
            flags: budget_flag::LEDGER,
            drawn_uj: i64::MAX,
            drawn_remainder: 1_999_999_999,
            metered_ns: u64::MAX - 50,
            unmetered_ns: 20,
            stamp_ns: 900,
            ..Budget::default()
        };
        let unheard = Budget {
            robot: 4,
            ..Budget::default()
        };
        let mut checkpoint = Checkpoint::new("lab", "boot-a");
        checkpoint.take(&[budget, unheard]);
        (checkpoint.written_ns, checkpoint.written_unix_ns) = (1_000, 50_000);
        checkpoint
    }

    #[test]
    fn what_is_written_is_read_to_the_last_digit() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("deep/ledger.json");
        assert_eq!(Checkpoint::read(&path, "lab").unwrap(), None);
        checkpoint().write(&path).unwrap();
        assert_eq!(Checkpoint::read(&path, "lab").unwrap(), Some(checkpoint()));
        assert_eq!(checkpoint().ledgers().count(), 1);
    }

    #[test]
    fn another_fleets_file_and_every_truncation_are_refused() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("ledger.json");
        checkpoint().write(&path).unwrap();
        let error = Checkpoint::read(&path, "mine").unwrap_err();
        assert!(matches!(error, CheckpointError::Foreign { .. }), "{error}");
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            let error = Checkpoint::read(&path, "lab").unwrap_err();
            assert!(
                matches!(error, CheckpointError::Malformed { .. }),
                "{length}: {error}"
            );
        }
    }

    #[test]
    fn after_a_reboot_the_time_between_is_unmetered() {
        let same = checkpoint().carried_over("boot-a", 5_000, 60_000);
        assert_eq!(same, checkpoint());
        let other = checkpoint().carried_over("boot-b", 5, 60_000);
        let account = &other.robots[&3];
        assert_eq!(account.unmetered_ns, 20 + 10_000 + 100);
        assert_eq!(account.stamp_ns, 5);
    }
}
