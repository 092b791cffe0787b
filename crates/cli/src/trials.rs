//! Which recorded trial is played by which robot.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use joulebus_dataset::trial::{Form, Trial};
use joulebus_program::exit::UsageError;
use joulebus_program::output::say;
use joulebus_program::platform::{names, platform};
use joulebus_settings::FleetSettings;

use crate::recordings::find_recordings;

/// Recordings, one robot each.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct TrialFiles {
    /// Recordings (.npy, .csv, .csv.gz), or directories of them. After an @ stands the robot's id,
    /// or the platform whose ids the robots get: a.csv.gz@100, recordings/@husky
    #[arg(required = true, value_name = "PATH[@ROBOT|@PLATFORM]")]
    paths: Vec<OsString>,
    /// Platform of the config whose ids the robots get, lowest first, where a path names none
    /// [default: the only one of the config]
    #[arg(long, value_name = "NAME", conflicts_with = "first_robot")]
    platform: Option<String>,
    /// Id of the first robot, where a path names none; the others count on
    #[arg(long, value_name = "ID")]
    first_robot: Option<u32>,
}

/// Whose ids the robots of a path get.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Who {
    From(u32),
    Platform(String),
}

impl TrialFiles {
    /// Reads the trials, each with its robot's id, in the order of the arguments.
    ///
    /// # Errors
    /// A file cannot be read, a name is no platform of the config, or a platform has fewer ids than
    /// there are files. A directory gives as many trials as there are ids.
    pub(crate) fn read(&self, settings: &FleetSettings) -> anyhow::Result<Vec<(u32, Trial)>> {
        let mut ids = Ids::new(self.first_robot);
        let mut trials = Vec::new();
        for path in &self.paths {
            let (path, who) = self.whose(path, settings)?;
            for (robot, file) in assign(&path, who.as_ref(), settings, &mut ids)? {
                trials.push((robot, Trial::read(file)?));
            }
        }
        Ok(trials)
    }

    /// Whether anybody says which ids or which platform the robots are of.
    pub(crate) fn names_robots(&self) -> bool {
        let named = self.platform.is_some() || self.first_robot.is_some();
        named || self.paths.iter().any(|path| split(path).1.is_some())
    }

    /// The recordings, where nobody says whose they are.
    ///
    /// # Errors
    /// A directory cannot be read, or holds none.
    pub(crate) fn files(&self) -> anyhow::Result<Vec<PathBuf>> {
        let paths: Vec<PathBuf> = self.paths.iter().map(PathBuf::from).collect();
        find_recordings(&paths)
    }

    /// The recordings with their robots' ids, for robots that never meet: where a platform has no
    /// id left, its ids are given out again.
    ///
    /// # Errors
    /// As [`TrialFiles::read`], but for too few ids.
    pub(crate) fn assigned(&self, settings: &FleetSettings) -> anyhow::Result<Vec<(u32, PathBuf)>> {
        let mut ids = Ids::new(self.first_robot);
        let mut assigned = Vec::new();
        for path in &self.paths {
            let (path, who) = self.whose(path, settings)?;
            for file in find_recordings(&[path])? {
                let mut robot = ids.next(who.as_ref(), settings)?;
                if robot.is_none() {
                    ids.taken.clear();
                    robot = ids.next(who.as_ref(), settings)?;
                }
                let Some(robot) = robot else {
                    let name = file.display();
                    return Err(UsageError(format!("{name}: its platform has no ids")).into());
                };
                assigned.push((robot, file));
            }
        }
        Ok(assigned)
    }

    /// The path, and whose ids its robots get.
    fn whose(
        &self,
        argument: &OsString,
        settings: &FleetSettings,
    ) -> Result<(PathBuf, Option<Who>), UsageError> {
        let (path, who) = split(argument);
        let who = match who {
            Some(who) => Some(who),
            None => self.usual(settings)?,
        };
        Ok((path, who))
    }

    /// Whose ids are taken where the path does not say; none: those that count on.
    fn usual(&self, settings: &FleetSettings) -> Result<Option<Who>, UsageError> {
        if self.first_robot.is_some() {
            return Ok(None);
        }
        let platform = match (&self.platform, settings.platforms.as_slice()) {
            (Some(name), _) => name.clone(),
            (None, [only]) => only.name.clone(),
            (None, several) => {
                let names = names(several);
                let what = "whose robots are these? The config has several platforms";
                let remedy = "give --platform NAME, or write PATH@NAME";
                return Err(UsageError(format!("{what}: {names}; {remedy}")));
            }
        };
        Ok(Some(Who::Platform(platform)))
    }
}

/// The files of a path with their robots.
fn assign(
    path: &Path,
    who: Option<&Who>,
    settings: &FleetSettings,
    ids: &mut Ids,
) -> anyhow::Result<Vec<(u32, PathBuf)>> {
    let is_directory = path.is_dir();
    let files = if is_directory {
        recordings(path)?
    } else {
        vec![path.to_owned()]
    };
    let found = files.len();
    let mut assigned = Vec::with_capacity(found);
    for file in files {
        match ids.next(who, settings)? {
            Some(robot) => assigned.push((robot, file)),
            None if is_directory && !assigned.is_empty() => break,
            None => {
                let name = file.display();
                let what = format!("{name}: no id is left for it");
                let remedy = "enlarge the `robots` of its platform in the config";
                return Err(UsageError(format!("{what}; name fewer files or {remedy}")).into());
            }
        }
    }
    if assigned.len() < found {
        let (name, taken) = (path.display(), assigned.len());
        say(&format!(
            "{name}: {taken} of {found} recordings are played: there are no more ids"
        ));
    }
    Ok(assigned)
}

/// The path and what stands after its @. A file that has an @ in its own name is taken as it is.
fn split(argument: &OsString) -> (PathBuf, Option<Who>) {
    let whole = PathBuf::from(argument);
    if whole.exists() {
        return (whole, None);
    }
    match argument.to_str().and_then(|text| text.rsplit_once('@')) {
        Some((path, who)) if !path.is_empty() && !who.is_empty() => {
            let who = who
                .parse()
                .map_or_else(|_| Who::Platform(who.to_owned()), Who::From);
            (PathBuf::from(path), Some(who))
        }
        _ => (whole, None),
    }
}

/// The recordings in a directory, by name.
pub(crate) fn recordings(directory: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let failed = || format!("cannot read the directory {}", directory.display());
    let mut files = Vec::new();
    for entry in std::fs::read_dir(directory).with_context(failed)? {
        let path = entry.with_context(failed)?.path();
        if Form::of(&path).is_some() && path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        let what = "holds no recordings (.npy, .csv, .csv.gz)";
        return Err(UsageError(format!("{} {what}", directory.display())).into());
    }
    Ok(files)
}

/// Ids that are still free.
struct Ids {
    next: Option<u32>,
    taken: Vec<u32>,
}

impl Ids {
    const fn new(first: Option<u32>) -> Self {
        Self {
            next: first,
            taken: Vec::new(),
        }
    }

    /// The next id; none when there is none left.
    fn next(
        &mut self,
        who: Option<&Who>,
        settings: &FleetSettings,
    ) -> Result<Option<u32>, UsageError> {
        let id = match who {
            None => {
                let id = self.next;
                self.next = id.and_then(|id| id.checked_add(1));
                id
            }
            Some(Who::From(first)) => self.first_free(*first..=u32::MAX),
            Some(Who::Platform(name)) => {
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
