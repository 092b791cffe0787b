//! The config that a verb uses.

use std::path::{Path, PathBuf};

use joulebus_config::{Config, ConfigError, Demo, Domain};

use crate::output::log_line;

/// The default path of the config.
const USUAL: &str = "configs/fleet.toml";
/// Number of robots of the built-in config, as in its file.
const BUILTIN_ROBOTS: u32 = 100;

/// Selects the config.
#[derive(Debug, Clone, clap::Args)]
pub struct ConfigFile {
    /// The fleet's config, the same for every process of it [default: configs/fleet.toml, or the
    /// built-in one if that file does not exist]
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
        if let Some(path) = &self.config {
            return Config::load(path);
        }
        if Path::new(USUAL).exists() {
            return Config::load(USUAL);
        }
        let shipped = Demo {
            fleet: "lab".to_owned(),
            root: Domain::default_root(),
            prefix: "jb_".to_owned(),
            robots: BUILTIN_ROBOTS,
        };
        Config::parse(&shipped.toml(), Path::new("."))
    }

    /// True if it is the built-in one, because no file is named and the usual one does not exist.
    pub fn is_builtin(&self) -> bool {
        self.config.is_none() && !Path::new(USUAL).exists()
    }

    /// Name of the config in messages.
    pub fn name(&self) -> String {
        match &self.config {
            Some(path) => path.display().to_string(),
            None if Path::new(USUAL).exists() => USUAL.to_owned(),
            None => "the built-in config".to_owned(),
        }
    }
}
