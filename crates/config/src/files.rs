//! Files that a config names.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::builtin;
use crate::document::{FleetFile, Source};
use crate::model_source::ModelSource;
use crate::problem::Problem;
use crate::values::Values;

/// A config larger than this is none: something else was named by mistake.
const MOST_BYTES: u64 = 4 << 20;

/// The text of a config file.
pub(crate) fn read(path: &Path) -> io::Result<String> {
    let about = std::fs::metadata(path)?;
    if !about.is_file() {
        return Err(io::Error::other("not a regular file"));
    }
    if about.len() > MOST_BYTES {
        let what = format!("{} bytes, allowed are {MOST_BYTES}", about.len());
        return Err(io::Error::other(what));
    }
    std::fs::read_to_string(path)
}

/// Reads the file of each platform; what stands in the fleet's file wins over it.
pub(crate) fn platforms(fleet: &mut FleetFile, problems: &mut Vec<Problem>) {
    for listed in &mut fleet.platforms {
        if !listed.values.names("platform.file") {
            continue;
        }
        match platform(&listed.values, problems) {
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
    // Complaints about a file that two platforms share would come twice.
    let mut seen = Vec::new();
    problems.retain(|problem| {
        let new = !seen.contains(problem);
        seen.push(problem.clone());
        new
    });
}

/// What the platform's file says; none where a problem tells why not.
fn platform(
    values: &Values,
    problems: &mut Vec<Problem>,
) -> Result<Option<Values>, (String, String)> {
    let Some(file) = values.text("platform.file") else {
        return Ok(None);
    };
    if let Some(name) = file.strip_prefix("builtin:") {
        let text = builtin::builtin_platform(name).ok_or_else(|| {
            let known: Vec<&str> = builtin::builtin_platforms().collect();
            let what = format!("is {file:?}, and no such platform ships");
            (what, format!("Those that ship: {}", known.join(", ")))
        })?;
        let source = Source {
            text,
            name: Arc::from(file.as_str()),
            directory: None,
        };
        return Ok(source.platform(problems));
    }
    let path = resolve(values, "platform.file").unwrap_or_else(|| PathBuf::from(&file));
    let text = read(&path).map_err(|error| {
        let what = format!("names {}, which cannot be read: {error}", path.display());
        (
            what,
            "The path is relative to the file that names it".to_owned(),
        )
    })?;
    let source = Source {
        text: &text,
        name: Arc::from(path.display().to_string()),
        directory: Some(Arc::new(path.parent().unwrap_or(Path::new("")).to_owned())),
    };
    Ok(source.platform(problems))
}

/// The path that a key holds, from the directory of the file that set it; empty stays empty.
pub(crate) fn resolve(values: &Values, path: &str) -> Option<PathBuf> {
    let text = values.text(path)?;
    let directory = values.place(path).and_then(|place| place.directory.clone());
    match directory {
        Some(directory) if !text.is_empty() => Some(directory.join(text)),
        _ => Some(PathBuf::from(text)),
    }
}

/// The platform's model; none where the keys do not say.
pub(crate) fn model(values: &Values) -> Option<ModelSource> {
    let text = values.text("platform.model")?;
    if text == "persistence" {
        let residual_std_w = values.number("platform.residual_std_w")? as f32;
        return Some(ModelSource::Persistence { residual_std_w });
    }
    if let Some(name) = text.strip_prefix("builtin:") {
        let (name, bytes) = builtin::builtin_model(name)?;
        return Some(ModelSource::Builtin(name, bytes));
    }
    Some(ModelSource::File(resolve(values, "platform.model")?))
}

/// Complains about a model that cannot be had.
pub(crate) fn check_model(values: &Values, problems: &mut Vec<Problem>) {
    let Some(text) = values.text("platform.model") else {
        return;
    };
    let (what, remedy) = match (model(values), text.strip_prefix("builtin:")) {
        (None, Some(_)) => {
            let known: Vec<&str> = builtin::builtin_models().collect();
            let what = format!("is {text:?}, and no such model ships");
            (what, format!("Those that ship: {}", known.join(", ")))
        }
        (Some(ModelSource::File(path)), _) if !path.is_file() => (
            format!("names {}, and there is no such file", path.display()),
            "Give \"persistence\", \"builtin:<name>\", or a path relative to this file".to_owned(),
        ),
        _ => return,
    };
    problems.push(complaint(values, "platform.model", what, remedy));
}

/// A complaint about a key that a file sets.
pub(crate) fn complaint(values: &Values, key: &str, what: String, remedy: String) -> Problem {
    let place = values.place(key);
    Problem {
        file: place.map_or_else(String::new, |place| place.file.to_string()),
        line: place.map(|place| place.line),
        key: key.to_owned(),
        what,
        remedy,
    }
}

/// The root directory, with the user's number filled in.
pub(crate) fn root(text: &str) -> PathBuf {
    let uid = rustix::process::geteuid().as_raw();
    PathBuf::from(text.replace("{uid}", &uid.to_string()))
}
