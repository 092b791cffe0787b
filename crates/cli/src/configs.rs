//! Configs of several fleets, as `--config` names them.

use std::path::PathBuf;

use joulebus_config::Config;
use joulebus_program::config_file::ConfigFile;

/// Reads the files, or without any the usual one. Prints their warnings to stderr.
pub(crate) fn load(files: &[PathBuf]) -> anyhow::Result<Vec<Config>> {
    if files.is_empty() {
        return Ok(vec![ConfigFile { config: None }.load()?]);
    }
    let load = |path: &PathBuf| ConfigFile { config: Some(path.clone()) }.load();
    files.iter().map(load).collect()
}
