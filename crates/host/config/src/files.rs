//! Files that a config refers to.

use std::io;
use std::path::{Component, Path, PathBuf};

use crate::builtin;
use crate::document::{FleetFile, NamedText};
use crate::key::File;
use crate::keys::DEFAULT_ROOT;
use crate::model_source::ModelSource;
use crate::problem::Problem;
use crate::values::Values;

/// Maximum size of a config or a model: larger files were named by mistake.
pub(crate) const MAX_BYTES: u64 = 4 << 20;

/// Paths and bytes of the files that a config may refer to. `None`: those of the file system.
pub(crate) type Attached<'a> = Option<&'a [(&'a str, &'a [u8])]>;

fn attached<'a>(files: &[(&str, &'a [u8])], path: &Path) -> Option<&'a [u8]> {
    files.iter().find(|(name, _)| Path::new(name) == path).map(|(_, bytes)| *bytes)
}

/// The text of a config file.
pub(crate) fn read(path: &Path) -> io::Result<String> {
    joulebus_files::read_to_string(path, MAX_BYTES)
}

/// True if `path` is below `folder`, and by its text alone: one with `..` is not.
#[must_use]
pub fn is_below(path: &Path, folder: &Path) -> bool {
    path.starts_with(folder) && path.components().all(|part| part != Component::ParentDir)
}

/// Reads the file of each platform. Keys in the fleet's file override it.
pub(crate) fn platforms(fleet: &mut FleetFile, files: Attached<'_>, problems: &mut Vec<Problem>) {
    for listed in &mut fleet.platforms {
        if !listed.values.names("platform.file") {
            continue;
        }
        match platform(&listed.values, files, problems) {
            Ok(Some(mut of_file)) => {
                of_file.override_with(std::mem::take(&mut listed.values));
                listed.values = of_file;
            }
            Ok(None) => listed.cut_short = true,
            Err((what, remedy)) => {
                listed.cut_short = true;
                problems.push(complaint(&listed.values, "platform.file", what, remedy));
            }
        }
    }
    // Problems of a file that two platforms share are reported once.
    let mut seen = Vec::new();
    problems.retain(|problem| {
        let new = !seen.contains(problem);
        seen.push(problem.clone());
        new
    });
}

/// The values of the platform's file. `None` together with a problem.
fn platform(
    values: &Values,
    files: Attached<'_>,
    problems: &mut Vec<Problem>,
) -> Result<Option<Values>, (String, String)> {
    let Some(file) = values.text("platform.file") else {
        return Ok(None);
    };
    if let Some(name) = file.strip_prefix("builtin:") {
        let text = builtin::builtin_platform(name).ok_or_else(|| {
            let known: Vec<&str> = builtin::builtin_platforms().collect();
            let what = format!("is {file:?}, and there is no such built-in platform");
            (what, format!("Built-in platforms: {}", known.join(", ")))
        })?;
        return Ok(NamedText::new(text, &file, None).values(File::Platform, problems));
    }
    let path = resolve(values, "platform.file").unwrap_or_else(|| PathBuf::from(&file));
    let text = match files {
        Some(files) => {
            let text = attached(files, &path).and_then(|bytes| str::from_utf8(bytes).ok());
            text.map(str::to_owned).ok_or_else(|| not_attached(&file))?
        }
        None => read(&path).map_err(|error| {
            let what = format!("names {}, which cannot be read: {error}", path.display());
            (what, "The path is relative to the file that names it".to_owned())
        })?,
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    let source = NamedText::new(&text, &path.display().to_string(), Some(folder));
    Ok(source.values(File::Platform, problems))
}

fn not_attached(file: &str) -> (String, String) {
    (format!("is {file:?}, which is not attached"), "Give a config with --config".to_owned())
}

/// The path of a key, relative to the directory of the file that sets it. `None` if empty.
pub(crate) fn resolve(values: &Values, path: &str) -> Option<PathBuf> {
    let text = values.text(path)?;
    let directory = values.location(path).and_then(|location| location.directory.clone());
    match directory {
        Some(directory) if !text.is_empty() => Some(directory.join(text)),
        _ => Some(PathBuf::from(text)),
    }
}

/// The platform's model. `None` if the keys do not determine it.
pub(crate) fn model(values: &Values, files: Attached<'_>) -> Option<ModelSource> {
    let text = values.text("platform.model")?;
    if text == "persistence" {
        let residual_std_w = values.number("platform.residual_std_w")? as f32;
        return Some(ModelSource::Persistence { residual_std_w });
    }
    if let Some(name) = text.strip_prefix("builtin:") {
        let (name, bytes) = builtin::builtin_model(name)?;
        return Some(ModelSource::Builtin(name, bytes));
    }
    let path = resolve(values, "platform.model")?;
    let Some(files) = files else { return Some(ModelSource::File(path)) };
    let bytes = attached(files, &path)?;
    Some(ModelSource::Attached(path.display().to_string().into(), bytes.into()))
}

/// Reports a model that does not exist.
pub(crate) fn check_model(values: &Values, files: Attached<'_>, problems: &mut Vec<Problem>) {
    let Some(text) = values.text("platform.model") else {
        return;
    };
    let (what, remedy) = match (model(values, files), text.strip_prefix("builtin:")) {
        (None, Some(_)) => {
            let known: Vec<&str> = builtin::builtin_models().collect();
            let what = format!("is {text:?}, and there is no such built-in model");
            (what, format!("Built-in models: {}", known.join(", ")))
        }
        (Some(ModelSource::File(path)), _) => {
            let Err(error) = joulebus_files::look(&path) else {
                return;
            };
            let why = match error.kind() {
                io::ErrorKind::NotFound => ", and there is no such file".to_owned(),
                _ => format!(", which {error}"),
            };
            (
                format!("names {}{why}", path.display()),
                "Give \"persistence\", \"builtin:<name>\", or a path relative to this file"
                    .to_owned(),
            )
        }
        (None, None) if files.is_some() => not_attached(&text),
        _ => return,
    };
    problems.push(complaint(values, "platform.model", what, remedy));
}

/// A problem of a key that a file sets.
pub(crate) fn complaint(values: &Values, key: &str, what: String, remedy: String) -> Problem {
    let location = values.location(key);
    Problem {
        file: location.map_or_else(String::new, |location| location.file.to_string()),
        line: location.map(|location| location.line),
        key: key.to_owned(),
        what,
        remedy,
    }
}

/// The root directory of a fleet whose file names none: `/dev/shm/joulebus-<uid>`.
#[must_use]
pub fn default_root() -> PathBuf {
    root(DEFAULT_ROOT)
}

/// The root directory, with the uid substituted.
pub(crate) fn root(text: &str) -> PathBuf {
    let uid = rustix::process::geteuid().as_raw();
    PathBuf::from(text.replace("{uid}", &uid.to_string()))
}
