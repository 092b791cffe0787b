//! Built-in config files and models, so that the program works from any directory.

use std::path::PathBuf;

use crate::values::quoted;

/// The built-in fleet file.
pub(crate) const FLEET: &str = include_str!("../configs/fleet.toml");

const PLATFORMS: &[(&str, &str)] = &[
    ("gternal", include_str!("../configs/platforms/gternal.toml")),
    ("robotino", include_str!("../configs/platforms/robotino.toml")),
    ("husky", include_str!("../configs/platforms/husky.toml")),
    ("rover", include_str!("../configs/platforms/rover.toml")),
];

const MODELS: &[(&str, &[u8])] = &[
    ("gternal-sim", include_bytes!("../configs/models/gternal-sim.safetensors")),
    ("gternal-sim-power", include_bytes!("../configs/models/gternal-sim-power.safetensors")),
    (
        "gternal-sim-freshness",
        include_bytes!("../configs/models/gternal-sim-freshness.safetensors"),
    ),
    ("robotino", include_bytes!("../configs/models/robotino.safetensors")),
    ("husky", include_bytes!("../configs/models/husky.safetensors")),
    ("husky-grass", include_bytes!("../configs/models/husky-grass.safetensors")),
    ("rover", include_bytes!("../configs/models/rover.safetensors")),
];

/// Names of the built-in platforms, for `file = "builtin:<name>"`.
pub fn builtin_platforms() -> impl Iterator<Item = &'static str> {
    PLATFORMS.iter().map(|(name, _)| *name)
}

/// The annotated file of a built-in platform.
#[must_use]
pub fn builtin_platform(name: &str) -> Option<&'static str> {
    PLATFORMS.iter().find_map(|(known, text)| (*known == name).then_some(*text))
}

/// Names of the built-in models, for `model = "builtin:<name>"`.
pub fn builtin_models() -> impl Iterator<Item = &'static str> {
    MODELS.iter().map(|(name, _)| *name)
}

/// Name and bytes of a built-in model file.
#[must_use]
pub fn builtin_model(name: &str) -> Option<(&'static str, &'static [u8])> {
    MODELS.iter().copied().find(|(known, _)| *known == name)
}

/// A fleet of simulated GTernal robots, configured by the built-in files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Demo {
    /// Name of the fleet.
    pub fleet: String,
    /// Private directory for its shared memory, absolute.
    pub root: PathBuf,
    /// Prefix of its names in shared memory.
    pub prefix: String,
    /// Robots, with ids from 0. 1 to 1,000,000.
    pub robots: u32,
}

impl Demo {
    /// The annotated file of the fleet, for all its processes. [`crate::Config::load`] checks it.
    pub fn toml(&self) -> String {
        let root = self.root.to_string_lossy();
        let last = self.robots.saturating_sub(1);
        let lines = FLEET.lines().map(|line| match line.split(" = ").next() {
            Some("name") => format!("name = {}\n", quoted(&self.fleet)),
            Some("capacity") => format!("capacity = {}\n", self.robots),
            Some("root") => format!("root = {}\n", quoted(&root)),
            Some("prefix") => format!("prefix = {}\n", quoted(&self.prefix)),
            Some("checkpoint") => "checkpoint = \"\"\n".to_owned(),
            Some("file") => "file = \"builtin:gternal\"\n".to_owned(),
            Some("robots") => format!("robots = [\"0-{last}\"]\n"),
            _ => format!("{line}\n"),
        });
        lines.collect()
    }
}
