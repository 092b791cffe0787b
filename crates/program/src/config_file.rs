//! Which config a verb works with.

use std::path::{Path, PathBuf};

use joulebus_bus::Domain;
use joulebus_config::{Config, ConfigError, Demo};

use crate::output::say;

/// The config that is taken when none is named.
const USUAL: &str = "configs/fleet.toml";
/// Robots of the fleet that ships in the program: as in the file of that name.
const BUILTIN_ROBOTS: u32 = 100;

/// Chooses the config.
#[derive(Debug, Clone, clap::Args)]
pub struct ConfigFile {
    /// The fleet's config, the same for every process of it [default: configs/fleet.toml, or the
    /// one that ships in the program if there is no such file]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

impl ConfigFile {
    /// Reads it; says on stderr what is doubtful in it.
    ///
    /// # Errors
    /// It cannot be read, or is refused.
    pub fn load(&self) -> anyhow::Result<Config> {
        let config = self.read()?;
        for warning in config.warnings() {
            say(&format!("warning: {warning}"));
        }
        Ok(config)
    }

    /// Reads it; leaves its warnings to the caller.
    ///
    /// # Errors
    /// It cannot be read, or is refused.
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

    /// What the config is called in messages.
    pub fn name(&self) -> String {
        match &self.config {
            Some(path) => path.display().to_string(),
            None if Path::new(USUAL).exists() => USUAL.to_owned(),
            None => "the config that ships".to_owned(),
        }
    }
}
