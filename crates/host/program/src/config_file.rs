//! The config that a verb uses.

use std::io;
use std::path::{Path, PathBuf};

use joulebus_config::{Config, ConfigError, Demo, default_root};

use crate::output::log_line;

/// The default path of the config.
const USUAL: &str = "configs/fleet.toml";
/// Variable with the path of the config, for a shell or a service.
const VARIABLE: &str = "JOULEBUS_CONFIG";
/// Folder of the configs of an installed joulebus.
const SYSTEM: &str = "/etc/joulebus";
/// Number of robots of the built-in config, as in its file.
const BUILTIN_ROBOTS: u32 = 100;

/// Selects the config.
#[derive(Debug, Clone, clap::Args)]
pub struct ConfigFile {
    /// The fleet's config, the same for every process of it [default: JOULEBUS_CONFIG, else
    /// configs/fleet.toml, the only fleet in /etc/joulebus, or the built-in one]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

impl ConfigFile {
    /// Reads it. Prints its warnings to stderr.
    ///
    /// # Errors
    /// The file cannot be read, or is refused.
    pub fn load(&self) -> anyhow::Result<Config> {
        let config = self.read()?;
        for warning in config.warnings() {
            log_line(&format!("warning: {warning}"));
        }
        Ok(config)
    }

    /// Reads it. The caller prints its warnings.
    ///
    /// # Errors
    /// The file cannot be read, or is refused.
    pub fn read(&self) -> Result<Config, ConfigError> {
        if let Some(path) = self.find()? {
            return Config::load(path);
        }
        let shipped = Demo {
            fleet: "lab".to_owned(),
            root: default_root(),
            prefix: "jb_".to_owned(),
            robots: BUILTIN_ROBOTS,
        };
        Config::parse(&shipped.toml(), Path::new("."))
    }

    /// Name of the config in messages.
    pub fn name(&self) -> String {
        match self.find() {
            Ok(Some(path)) => path.display().to_string(),
            Ok(None) => "the built-in config".to_owned(),
            Err(_) => SYSTEM.to_owned(),
        }
    }

    /// Its file. `None`: the built-in one.
    fn find(&self) -> Result<Option<PathBuf>, ConfigError> {
        let named = self.config.clone();
        let named = named.or_else(|| std::env::var_os(VARIABLE).map(PathBuf::from));
        match named.filter(|path| !path.as_os_str().is_empty()) {
            Some(path) => Ok(Some(path)),
            None if Path::new(USUAL).exists() => Ok(Some(PathBuf::from(USUAL))),
            None => only_fleet(Path::new(SYSTEM)),
        }
    }
}

/// The only config of a fleet in a folder. `None` if it has none, or cannot be read.
fn only_fleet(folder: &Path) -> Result<Option<PathBuf>, ConfigError> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Ok(None);
    };
    let is_toml = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "toml");
    let (mut fleets, mut unreadable) = (Vec::new(), Vec::new());
    for path in entries.flatten().map(|entry| entry.path()).filter(is_toml) {
        match std::fs::read_to_string(&path) {
            Ok(text) if text.lines().any(is_fleet) => fleets.push(path),
            Ok(_) => {}
            Err(_) => unreadable.push(path),
        }
    }
    // Whoever loads it names why it cannot be read.
    if fleets.is_empty() {
        fleets = unreadable;
    }
    fleets.sort();
    if fleets.len() < 2 {
        return Ok(fleets.pop());
    }
    let names: Vec<_> = fleets.iter().map(|path| path.display().to_string()).collect();
    let several = format!("it has several fleets: {}", names.join(", "));
    Err(ConfigError::Read { path: folder.to_owned(), source: io::Error::other(several) })
}

/// True if a line begins the table of a fleet.
fn is_fleet(line: &str) -> bool {
    let table = line.split('#').next().unwrap_or_default().trim();
    table.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).map(str::trim) == Some("fleet")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_only_fleet_of_a_folder_is_found_and_several_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        assert_eq!(only_fleet(&folder.join("absent")).unwrap(), None);
        let write = |name: &str, text| std::fs::write(folder.join(name), text).unwrap();
        write("lab-bridge.toml", "[bridge]\nkind = \"mqtt\"\n");
        write("notes.txt", "[fleet]\n");
        assert_eq!(only_fleet(folder).unwrap(), None);
        write("lab.toml", "# ours\n[ fleet ] # lab\nname = \"lab\"\n");
        assert_eq!(only_fleet(folder).unwrap(), Some(folder.join("lab.toml")));
        write("yard.toml", "[fleet]\nname = \"yard\"\n");
        let error = only_fleet(folder).unwrap_err().to_string();
        assert!(error.contains("lab.toml") && error.contains("yard.toml"), "{error}");
        assert!(error.contains("--config"), "{error}");
    }
}
