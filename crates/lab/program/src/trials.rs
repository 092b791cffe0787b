//! Assigns recorded trials to robots.

use std::collections::HashSet;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use joulebus_config::Config;
use joulebus_dataset::trial::{ColumnMap, Table, Trial};
use joulebus_program::exit::UsageError;
use joulebus_program::output::log_line;
use joulebus_program::platform::{names, platform};
use joulebus_settings::FleetSettings;

use crate::recordings::{ColumnArguments, find_recordings};

/// Recordings, one robot each.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct TrialFiles {
    /// Recordings (.npy, .csv, .csv.gz), captures (.mcap), or directories of them. PATH@ID assigns
    /// the robot ids from ID on, PATH@NAME those of a platform: a.csv.gz@100, recordings/@husky
    /// [default: those of the config's only platform]
    #[arg(required = true, value_name = "PATH[@ROBOT|@PLATFORM]")]
    paths: Vec<OsString>,
    #[command(flatten)]
    columns: ColumnArguments,
}

/// Source of the ids of a path's robots.
#[derive(Debug, Clone, PartialEq, Eq)]
enum IdSource {
    From(u32),
    Platform(String),
}

impl TrialFiles {
    /// Reads the trials with the ids of their robots, in the order of the arguments. From a
    /// directory at most as many trials are read as there are ids.
    ///
    /// # Errors
    /// A file cannot be read, the config has no such platform, or a platform has fewer ids than
    /// there are files.
    pub(crate) fn read(&self, config: &Config) -> anyhow::Result<Vec<(u32, Trial)>> {
        let settings = config.settings();
        let mut ids = Ids::default();
        let mut trials = Vec::new();
        for path in &self.paths {
            let (path, source) = Self::id_source(path, settings)?;
            for (robot, file) in assign(&path, &source, settings, &mut ids)? {
                let map = match place_of(settings, robot) {
                    Some(platform) => self.map_of(config, platform)?,
                    None => self.map(),
                };
                let mut read = Trial::read_mapped(&file, &map)?;
                match read.len() {
                    1 => trials.push((robot, read.remove(0))),
                    _ => trials.extend(apart(&file, (robot, read), &source, settings, &mut ids)?),
                }
            }
        }
        Ok(trials)
    }

    /// The names of the recordings' columns.
    pub(crate) fn map(&self) -> ColumnMap {
        self.columns.map()
    }

    /// The same for recordings of a platform of the config.
    pub(crate) fn map_of(&self, config: &Config, platform: usize) -> anyhow::Result<ColumnMap> {
        self.columns.or_configured(config, platform)
    }

    /// True if an id or a platform is given.
    pub(crate) fn names_robots(&self) -> bool {
        self.paths.iter().any(|path| split(path).1.is_some())
    }

    /// The recordings, if neither ids nor platforms are given.
    ///
    /// # Errors
    /// A directory cannot be read or contains no recordings.
    pub(crate) fn files(&self) -> anyhow::Result<Vec<PathBuf>> {
        let paths: Vec<PathBuf> = self.paths.iter().map(PathBuf::from).collect();
        find_recordings(&paths)
    }

    /// The recordings with the ids of their robots, for independent robots: once a platform's ids
    /// are used up, they are assigned again.
    pub(crate) fn assigned(&self, settings: &FleetSettings) -> anyhow::Result<Vec<(u32, PathBuf)>> {
        let mut ids = Ids::default();
        let mut assigned = Vec::new();
        for path in &self.paths {
            let (path, source) = Self::id_source(path, settings)?;
            for file in find_recordings(&[path])? {
                let mut robot = ids.next(&source, settings)?;
                if robot.is_none() {
                    ids.taken.clear();
                    robot = ids.next(&source, settings)?;
                }
                let Some(robot) = robot else {
                    let name = file.display();
                    return Err(UsageError(format!("{name}: its platform has no robot ids")).into());
                };
                assigned.push((robot, file));
            }
        }
        Ok(assigned)
    }

    /// The path, and the source of its ids.
    fn id_source(
        argument: &OsString,
        settings: &FleetSettings,
    ) -> Result<(PathBuf, IdSource), UsageError> {
        let (path, source) = split(argument);
        let source = match (source, settings.platforms.as_slice()) {
            (Some(source), _) => source,
            (None, [only]) => IdSource::Platform(only.name.clone()),
            (None, several) => {
                let names = names(several);
                let what = "which platform? The config has several";
                let remedy = format!("Give {}@NAME", path.display());
                return Err(UsageError(format!("{what}: {names}. {remedy}")));
            }
        };
        Ok((path, source))
    }
}

/// The robots of one file: with their own ids where the platform has them, else with the next.
fn apart(
    file: &Path,
    (first, trials): (u32, Vec<Trial>),
    source: &IdSource,
    settings: &FleetSettings,
    ids: &mut Ids,
) -> anyhow::Result<Vec<(u32, Trial)>> {
    let found = trials.len();
    let mut assigned = Vec::with_capacity(found);
    // With PATH@ID the ids are consecutive, whatever the robots' names are.
    let named = matches!(source, IdSource::Platform(_));
    ids.taken.retain(|id| !named || *id != first);
    let mut first = (!named).then_some(first);
    for trial in trials {
        let own = trial.robot_name().and_then(|name| name.parse().ok());
        let is_free = |id: &u32| place_of(settings, *id).is_some() && !ids.taken.contains(id);
        let id = match (own.filter(|id| named && is_free(id)), first.take()) {
            (Some(id), _) => {
                ids.taken.insert(id);
                Some(id)
            }
            (None, Some(first)) => Some(first),
            (None, None) => ids.next(source, settings)?,
        };
        let Some(id) = id else {
            let (name, taken) = (file.display(), assigned.len());
            log_line(&format!(
                "{name}: {taken} of {found} robots are played: no more robot ids are left"
            ));
            break;
        };
        assigned.push((id, trial));
    }
    Ok(assigned)
}

/// The index of a robot's platform.
pub(crate) fn place_of(settings: &FleetSettings, robot: u32) -> Option<usize> {
    let mut platforms = settings.platforms.iter();
    platforms.position(|platform| platform.robots.iter().any(|ids| ids.contains(&robot)))
}

/// The files of a path with the ids of their robots.
fn assign(
    path: &Path,
    source: &IdSource,
    settings: &FleetSettings,
    ids: &mut Ids,
) -> anyhow::Result<Vec<(u32, PathBuf)>> {
    let is_directory = path.is_dir();
    let files = if is_directory { recordings(path)? } else { vec![path.to_owned()] };
    let found = files.len();
    let mut assigned = Vec::with_capacity(found);
    for file in files {
        match ids.next(source, settings)? {
            Some(robot) => assigned.push((robot, file)),
            None if is_directory && !assigned.is_empty() => break,
            None => {
                let name = file.display();
                let what = format!("{name}: no robot id is left");
                let remedy = "enlarge the `robots` of its platform in the config";
                return Err(UsageError(format!("{what}. Give fewer files or {remedy}")).into());
            }
        }
    }
    if assigned.len() < found {
        let (name, taken) = (path.display(), assigned.len());
        log_line(&format!(
            "{name}: {taken} of {found} recordings are played: no more robot ids are left"
        ));
    }
    Ok(assigned)
}

/// The path and the part after its @. A file whose own name contains an @ is not split.
fn split(argument: &OsString) -> (PathBuf, Option<IdSource>) {
    let whole = PathBuf::from(argument);
    if whole.exists() {
        return (whole, None);
    }
    match argument.to_str().and_then(|text| text.rsplit_once('@')) {
        Some((path, source)) if !path.is_empty() && !source.is_empty() => {
            let source = source
                .parse()
                .map_or_else(|_| IdSource::Platform(source.to_owned()), IdSource::From);
            (PathBuf::from(path), Some(source))
        }
        _ => (whole, None),
    }
}

/// The trial of a file with one robot.
pub(crate) fn read_one(file: &Path, map: &ColumnMap) -> anyhow::Result<Trial> {
    Ok(Table::only_of(file, map)?.into_trial()?)
}

/// The recordings in a directory and those below it, sorted by name.
pub(crate) fn recordings(directory: &Path) -> anyhow::Result<Vec<PathBuf>> {
    find_recordings(&[directory.to_owned()])
}

#[derive(Default)]
struct Ids {
    taken: HashSet<u32>,
}

impl Ids {
    /// The next id. None if all are assigned.
    fn next(
        &mut self,
        source: &IdSource,
        settings: &FleetSettings,
    ) -> Result<Option<u32>, UsageError> {
        let id = match source {
            IdSource::From(first) => self.first_free(*first..=u32::MAX),
            IdSource::Platform(name) => {
                let platform = platform(settings, name)?;
                self.first_free(platform.robots.iter().cloned().flatten())
            }
        };
        self.taken.extend(id);
        Ok(id)
    }

    fn first_free(&self, mut ids: impl Iterator<Item = u32>) -> Option<u32> {
        ids.find(|id| !self.taken.contains(id))
    }
}
