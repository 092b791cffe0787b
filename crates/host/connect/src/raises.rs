//! When the raised alarms of a fleet were raised, for readers that start later.
//!
//! The process of the worker follows its diagnostics and keeps a small file in the fleet's
//! directory. So no layout, no capture and no bit of the worker knows of it. Without the file, as
//! on a host that a link joins, a reader counts from its own start.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::fs;
use std::io::{self, Read as _};
use std::path::PathBuf;

use joulebus_config::Config;
use joulebus_settings::{DomainError, RAISES_FILE};
use joulebus_wire::Alarm;

/// Maximum size of a file that is read, bytes.
const MAX_BYTES: u64 = 8 << 20;

/// When each raised alarm was raised, by robot and code of the alarm, monotonic ns.
pub type Raises = HashMap<(u32, u16), u64>;

/// The file of a worker's process. It ends with this value.
#[derive(Debug)]
pub struct RaisesFile {
    path: PathBuf,
}

impl RaisesFile {
    /// The file of the fleet of `config`, which is not written yet. Only the process with the
    /// fleet's worker lock may write it.
    ///
    /// # Errors
    /// The config's domain is invalid.
    pub fn new(config: &Config) -> Result<Self, DomainError> {
        Ok(Self { path: path(config)? })
    }

    /// Writes the alarms that are raised in the run `worker_epoch`: robot, alarm, and when, in
    /// monotonic ns. A reader sees all of them or those before.
    ///
    /// # Errors
    /// The file cannot be written. The next call tries again.
    pub fn write(
        &self,
        worker_epoch: u64,
        raised: impl Iterator<Item = (u32, Alarm, u64)>,
    ) -> io::Result<()> {
        let mut text = format!("run {worker_epoch}\n");
        for (robot, alarm, raised_ns) in raised {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{robot} {} {raised_ns}", alarm.name());
        }
        let draft = self.path.with_extension("new");
        fs::write(&draft, text)?;
        fs::rename(draft, &self.path)
    }
}

impl Drop for RaisesFile {
    fn drop(&mut self) {
        // Another run's file is not believed, and the last member removes it.
        let _ = fs::remove_file(&self.path);
    }
}

/// When the alarms were raised that are raised in the run `worker_epoch`. Empty if that is not
/// known.
#[must_use]
pub fn raises(config: &Config, worker_epoch: u64) -> Raises {
    let read = || -> Option<Raises> {
        let mut text = String::new();
        fs::File::open(path(config).ok()?).ok()?.take(MAX_BYTES).read_to_string(&mut text).ok()?;
        let (run, lines) = text.split_once('\n')?;
        let is_of_run = run.strip_prefix("run ")?.parse() == Ok(worker_epoch);
        is_of_run.then(|| lines.lines().filter_map(raise).collect())
    };
    read().unwrap_or_default()
}

fn raise(line: &str) -> Option<((u32, u16), u64)> {
    let mut words = line.split(' ');
    let robot = words.next()?.parse().ok()?;
    let name = words.next()?;
    let alarm = Alarm::ALL.into_iter().find(|alarm| alarm.name() == name)?;
    Some(((robot, alarm.code()), words.next()?.parse().ok()?))
}

fn path(config: &Config) -> Result<PathBuf, DomainError> {
    Ok(config.domain()?.directory().join(RAISES_FILE))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn raises_are_known_of_the_run_that_wrote_them_while_its_process_lives() {
        let folder = tempfile::tempdir().expect("a temporary directory");
        let root = folder.path();
        let text = format!(
            "[fleet]\nname = \"lab\"\n[domain]\nroot = {root:?}\n[[platform]]\nfile = \"builtin:gternal\"\nrobots = [\"0-9\"]\n"
        );
        let config = Config::parse(&text, Path::new(".")).expect("a config");
        assert_eq!(raises(&config, 5), Raises::new(), "there is no fleet");
        let directory = config.domain().expect("valid").directory();
        fs::create_dir_all(&directory).expect("a directory");
        let file = RaisesFile::new(&config).expect("valid");
        let all = [(7, Alarm::NoData, 1_000), (7, Alarm::BiasHigh, 2_000), (9, Alarm::NoData, 3)];
        file.write(5, all.into_iter()).expect("written");
        let known = all.map(|(robot, alarm, ns)| ((robot, alarm.code()), ns));
        let known = Raises::from(known);
        assert_eq!(raises(&config, 5), known);
        assert_eq!(raises(&config, 6), Raises::new(), "another run");
        // Nonsense hides no other line.
        let text = "run 5\n7 NoData\nx\n7 Nothing 5\n9 NoData 3\n";
        fs::write(directory.join(RAISES_FILE), text).expect("written");
        assert_eq!(raises(&config, 5), Raises::from([((9, Alarm::NoData.code()), 3)]));
        drop(file);
        assert_eq!(raises(&config, 5), Raises::new());
        assert_eq!(fs::read_dir(&directory).expect("it is there").count(), 0);
    }
}
