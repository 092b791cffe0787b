//! `joulebus config`: make, check, show and explain configs.

use std::fmt;
use std::path::{Path, PathBuf};

use clap::Subcommand;
use joulebus_config::{
    CheckedFile, Config, ConfigError, Explanation, File, Problem, explain, explanations,
};
use joulebus_models::load_models;
use joulebus_predictor::Model;
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::model_range;
use joulebus_program::output::{self, Format, Output, log_line};
use serde::Serialize;

use crate::{external, schema};

/// Make configs from recordings, and check, show and explain configs
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus config init --from recordings/ --out lab/ --train\n  \
    joulebus config check configs/*.toml\n  \
    joulebus config show configs/fleet.toml    every key, with the origin of its value\n  \
    joulebus config explain tick               the keys of a section, with unit, range, default\n  \
    joulebus config schema bridge > bridge.schema.json   JSON Schema, for editors")]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Write a platform's and a fleet's config from recordings or a data sheet, and train its model
    /// if asked
    Init(external::Args),
    /// Check files of fleets, platforms, bridges, links and webhooks (exit 2 if one is refused)
    #[command(
        after_help = "Example:\n  joulebus config check configs/fleet.toml configs/links/*.toml"
    )]
    Check {
        /// Files, whose kinds their keys tell [default: the one that other verbs find]
        #[arg(value_name = "FILE")]
        files: Vec<PathBuf>,
    },
    /// Show the complete config with defaults, as a valid config
    #[command(after_help = "Example:\n  joulebus config show configs/mixed.toml > whole.toml")]
    Show {
        /// The fleet's config [default: the one that other verbs find]
        #[arg(value_name = "FILE")]
        file: Option<PathBuf>,
    },
    /// Explain a key, a section, or everything: unit, range, default
    #[command(after_help = "Examples:\n  \
        joulebus config explain tick.rate_hz\n  \
        joulebus config explain platform.battery")]
    Explain {
        /// A key (tick.rate_hz) or a section (tick) [default: all]
        key: Option<String>,
    },
    /// Write the JSON Schema of a kind of file, with which editors complete and check it
    #[command(after_help = "Example:\n  joulebus config schema fleet > fleet.schema.json")]
    Schema {
        /// The kind of file
        #[arg(value_name = "KIND", value_parser = File::ALL.map(File::name))]
        kind: String,
    },
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    match &args.verb {
        Verb::Init(_) => external::run_lab("config init"),
        Verb::Check { files } => check(files, output),
        Verb::Show { file } => show(file.clone(), output),
        Verb::Explain { key } => explain_key(key.as_deref(), output),
        Verb::Schema { kind } => {
            let file = File::ALL.into_iter().find(|file| file.name() == kind);
            let schema = schema::of(file.unwrap_or(File::Fleet));
            output::text(&format!("{}\n", serde_json::to_string_pretty(&schema)?))?;
            Ok(Outcome::Done)
        }
    }
}

/// Result of checking configs.
#[derive(Debug, Serialize)]
struct CheckReport {
    files: Vec<Checked>,
}

#[derive(Debug, Default, Serialize)]
struct Checked {
    file: String,
    kind: &'static str,
    accepted: bool,
    fleet: Option<String>,
    /// Maximum number of robots.
    capacity: Option<u32>,
    platforms: Vec<String>,
    /// Reason that the file cannot be read, or that the worker would refuse it. None if it is
    /// valid.
    error: Option<String>,
    problems: Vec<Problem>,
    warnings: Vec<Problem>,
}

impl Checked {
    fn new(file: String, result: Result<Config, ConfigError>) -> Self {
        let mut checked = Self { file, kind: File::Fleet.name(), ..Self::default() };
        match result {
            Ok(config) => {
                let settings = config.settings();
                checked.fleet = Some(config.fleet().to_owned());
                checked.capacity = Some(settings.capacity);
                let names = settings.platforms.iter().map(|platform| platform.name.clone());
                checked.platforms = names.collect();
                checked.warnings = config.warnings().to_vec();
                match refusal(&config) {
                    Ok(models) => {
                        let doubtful = model_range::warnings(&config, &models);
                        checked.warnings.extend(doubtful);
                    }
                    Err(why) => checked.error = Some(format!("{}: {why}", checked.file)),
                }
                checked.accepted = checked.error.is_none();
            }
            Err(error) => checked.refuse(&error),
        }
        checked
    }

    fn refuse(&mut self, error: &ConfigError) {
        self.problems = error.problems().to_vec();
        self.error = self.problems.is_empty().then(|| error.to_string());
    }

    /// Checks a file of the kind that its keys show. Of a fleet's also what it names.
    fn load(path: &Path) -> Self {
        let name = path.display().to_string();
        let kind = File::new(path);
        if kind == File::Fleet {
            return Self::new(name, Config::load(path));
        }
        let mut checked = Self { file: name, kind: kind.name(), ..Self::default() };
        match CheckedFile::load(path, kind) {
            Ok(file) => checked.problems = file.problems,
            Err(error) => checked.refuse(&error),
        }
        checked.accepted = checked.problems.is_empty() && checked.error.is_none();
        checked
    }
}

/// The models, or why the worker would refuse a well-formed config before it joins the fleet.
fn refusal(config: &Config) -> Result<Vec<Model>, String> {
    let models = load_models(config).map_err(|error| error.to_string())?;
    config.settings().check().map_err(|error| error.to_string())?;
    config.domain().map_err(|error| error.to_string())?;
    Ok(models)
}

impl fmt::Display for CheckReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for checked in self.files.iter().filter(|checked| checked.accepted) {
            let file = &checked.file;
            let (Some(fleet), Some(capacity)) = (&checked.fleet, checked.capacity) else {
                writeln!(out, "{file}: ok: the keys of a file of kind {}", checked.kind)?;
                continue;
            };
            let platforms = checked.platforms.join(", ");
            writeln!(out, "{file}: ok: fleet {fleet}, capacity {capacity} robots, {platforms}")?;
        }
        Ok(())
    }
}

fn check(files: &[PathBuf], output: Output) -> anyhow::Result<Outcome> {
    let checked = if files.is_empty() {
        let chosen = ConfigFile { config: None };
        vec![Checked::new(chosen.name(), chosen.read())]
    } else {
        files.iter().map(|path| Checked::load(path)).collect()
    };
    for checked in &checked {
        for problem in &checked.problems {
            log_line(&format!("error: {problem}"));
        }
        if let Some(error) = &checked.error {
            log_line(&format!("error: {error}"));
        }
        for warning in &checked.warnings {
            log_line(&format!("warning: {warning}"));
        }
    }
    let refused = checked.iter().filter(|checked| !checked.accepted).count();
    let of = checked.len();
    let report = CheckReport { files: checked };
    if output.format() == Format::Json || refused < of {
        output.report(&report)?;
    }
    if refused > 0 {
        return Err(UsageError(format!("{refused} of {of} configs refused")).into());
    }
    Ok(Outcome::Done)
}

/// The effective config as a config file.
#[derive(Debug, Serialize)]
struct Shown<'a> {
    file: String,
    fleet: &'a str,
    toml: &'a str,
}

impl fmt::Display for Shown<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.toml)
    }
}

fn show(file: Option<PathBuf>, output: Output) -> anyhow::Result<Outcome> {
    let chosen = ConfigFile { config: file };
    let config = chosen.load()?;
    output.report(&Shown { file: chosen.name(), fleet: config.fleet(), toml: config.to_toml() })?;
    Ok(Outcome::Done)
}

fn explain_key(key: Option<&str>, output: Output) -> anyhow::Result<Outcome> {
    match output.format() {
        Format::Text => output::text(&explain(key)?)?,
        Format::Json => {
            let keys: Vec<Explanation> = explanations(key)?;
            output::text(&serde_json::to_string_pretty(&keys)?)?;
        }
    }
    Ok(Outcome::Done)
}
