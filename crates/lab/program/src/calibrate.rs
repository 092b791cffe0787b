//! `joulebus calibrate`: limits of a platform's residual alarms for a rate of false alarms.

use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};

use joulebus_bus::clock;
use joulebus_config::{Assignment, Config, platform_file};
use joulebus_dataset::trial::{ColumnMap, Trial, is_capture};
use joulebus_eval::calibrate::{CalibrateError, Calibration, Request, calibrate};
use joulebus_models::load_models;
use joulebus_predictor::Model;
use joulebus_program::config_file::ConfigFile;
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::file::write;
use joulebus_program::output::{Output, log_line};
use joulebus_program::platform::{names, platform};
use joulebus_settings::Platform;
use serde::Serialize;

use crate::eval::load;
use crate::judgement::{AcceptArguments, report};
use crate::recordings::Recordings;
use joulebus_program::utc::Utc;

/// Set the limits of a platform's alarms for a rate of false alarms, with the evidence of
/// recordings
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus calibrate fleet.mcap --false-alarms 1/day --robots 20 -o lab/platforms/robot-alarms.toml\n  \
    joulebus calibrate recordings/ --config configs/mixed.toml --platform husky --false-alarms 2/hour\n  \
    joulebus calibrate trials/ --config lab/fleet.toml --false-alarms 1/day --extrapolate --format json\n\n\
    All recordings count as healthy: leave out those with faults. The code of the tick plays them \
    at a grid of limits. One half decides the ratios between the limits, the other half how high \
    they are. The second half states the rate with an exact Poisson bound, widened where alarms \
    come in groups. A rate that needs longer recordings is refused (exit 1) with the hours needed. \
    --extrapolate continues the tail of what they show, and says so. Then faults are put into the \
    second half. The report says how soon they are found, beside limits of power and \
    voltage.\n\
    --out writes the platform's file with these limits and their evidence, and overwrites nothing. \
    docs/measured/alarms.md has results.")]
pub(crate) struct Args {
    #[command(flatten)]
    recordings: Recordings,
    #[command(flatten)]
    accept: AcceptArguments,
    #[command(flatten)]
    config: ConfigFile,
    /// Platform of the config that recorded [default: the config's only platform]
    #[arg(long, value_name = "NAME")]
    platform: Option<String>,
    /// A model file [default: as in the config]
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// False alarms of the whole fleet: a number an hour, a day or a week, such as 1/day
    #[arg(long, value_name = "N/TIME", value_parser = rate)]
    false_alarms: f64,
    /// Robots of the fleet [default: those of the platform in the capture that has most, 1 without
    /// captures]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    robots: Option<u32>,
    /// Allow limits beyond what the recordings show: the file then says so
    #[arg(long)]
    extrapolate: bool,
    /// Write the platform's file with the limits
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Confidence of the stated rate.
const CONFIDENCE: f64 = 0.95;

#[derive(Debug, Serialize)]
struct CalibrateReport {
    platform: String,
    model: String,
    #[serde(flatten)]
    found: Calibration,
    written: Option<PathBuf>,
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    if let Some(out) = args.out.as_ref().filter(|out| out.exists()) {
        let what = format!("{} exists", out.display());
        return Err(UsageError(format!("{what}. Name another file with --out")).into());
    }
    let config = args.config.load()?;
    // Looked for once: a file that is gone when it is read is an error.
    let files: Vec<RecordedFile> =
        args.recordings.find()?.into_iter().map(RecordedFile::new).collect();
    args.check_config(&files)?;
    let place = args.place(&config)?;
    let own = &config.settings().platforms[place];
    let model = match &args.model {
        Some(file) => load(file)?,
        None => load_models(&config)?.swap_remove(place),
    };
    let map = args.recordings.map_of(&config, place)?;
    let (trials, recorded) = trials(&files, own, &map)?;
    let implausible = args.accept.or_configured(&config, [place])?.judge(&trials)?;
    let robots = args.robots.unwrap_or(recorded);
    log_line(&format!(
        "platform {}, model {}: {} recordings, a fleet of {robots} robots",
        own.name,
        model.name(),
        trials.len()
    ));
    let request = Request {
        fleet_per_h: args.false_alarms,
        robots,
        confidence: CONFIDENCE,
        extrapolate: args.extrapolate,
    };
    let found = calibrate(config.settings(), place, &model, &trials, &request);
    let found = found.map_err(|error| match error {
        CalibrateError::Recordings { .. } => UsageError(error.to_string()).into(),
        error => anyhow::Error::from(error),
    })?;
    if let Some(out) = &args.out {
        write(out, args.file(&config, place, &model, &found)?.as_bytes())?;
    }
    let calibrated = CalibrateReport {
        platform: own.name.clone(),
        model: model.name().to_owned(),
        found,
        written: args.out.clone(),
    };
    report(output, &calibrated, implausible)?;
    Ok(Outcome::Done)
}

/// A file of recordings, as it was found.
pub(crate) struct RecordedFile {
    path: PathBuf,
    is_capture: bool,
}

impl RecordedFile {
    pub(crate) fn new(path: PathBuf) -> Self {
        Self { is_capture: is_capture(&path), path }
    }
}

impl Args {
    /// Recordings that are no captures are of nobody's platform but the one that a config names:
    /// the built-in one has the limits of another robot.
    fn check_config(&self, files: &[RecordedFile]) -> anyhow::Result<()> {
        match files.iter().find(|file| !file.is_capture) {
            Some(file) if self.config.is_builtin() => {
                let what = format!("which platform recorded {}?", file.path.display());
                let remedy = "name its fleet's config with --config. `joulebus config init` makes \
                    one from recordings";
                Err(UsageError(format!("{what} {remedy}")).into())
            }
            _ => Ok(()),
        }
    }

    /// The platform's number in the config.
    fn place(&self, config: &Config) -> Result<usize, UsageError> {
        let settings = config.settings();
        let name = match (&self.platform, settings.platforms.as_slice()) {
            (Some(name), _) => name,
            (None, [only]) => &only.name,
            (None, several) => {
                let names = names(several);
                let what = "which platform? The config has several";
                return Err(UsageError(format!("{what}: {names}. Give --platform NAME")));
            }
        };
        let named = platform(settings, name)?;
        let place = settings.platforms.iter().position(|one| one == named);
        // `platform` has found it among them, so there is an index.
        Ok(place.unwrap_or_default())
    }

    /// The platform's file with the limits.
    fn file(
        &self,
        config: &Config,
        place: usize,
        model: &Model,
        found: &Calibration,
    ) -> anyhow::Result<String> {
        let replaced = |key: &str| {
            let modelled = matches!(key, "model" | "residual_std_w") && self.model.is_some();
            modelled || key.starts_with("alarms.")
        };
        let keys = config.platform_keys(place).iter();
        let mut keys: Vec<Assignment> = keys.filter(|one| !replaced(one.key)).cloned().collect();
        if let Some(file) = &self.model {
            // A built-in model has no path.
            let path = file.canonicalize().unwrap_or_else(|_| file.clone());
            let note = "The limits of the alarms hold for this model.";
            keys.push(Assignment::text("model", &path.to_string_lossy(), note));
        }
        for limit in &found.limits {
            let key = match limit.key {
                "noise_limit" => "alarms.noise_limit",
                "mismatch_limit" => "alarms.mismatch_limit",
                _ => "alarms.level_limit",
            };
            keys.push(Assignment::number(key, limit.value, limit.evidence()));
        }
        let title = format!(
            "Platform {}, limits of its alarms by joulebus calibrate {} on {}, model {}. {}",
            config.settings().platforms[place].name,
            env!("CARGO_PKG_VERSION"),
            today(),
            model.name(),
            found.evidence().join(" ")
        );
        Ok(platform_file(&title, &keys))
    }
}

/// The recordings of the platform's robots, and the robots of the capture that has most. In
/// other recordings, names of robots are no ids: all are of the platform.
pub(crate) fn trials(
    files: &[RecordedFile],
    own: &Platform,
    map: &ColumnMap,
) -> anyhow::Result<(Vec<Trial>, u32)> {
    let is_own = |trial: &Trial| {
        // `fleet/7` in a capture of several fleets.
        let id = trial.robot_name().and_then(|name| name.rsplit('/').next());
        let id = id.and_then(|id| id.parse::<u32>().ok());
        id.is_some_and(|id| own.robots.iter().any(|ids| ids.contains(&id)))
    };
    let (mut trials, mut robots) = (Vec::new(), 1);
    for RecordedFile { path, is_capture } in files {
        let mut read = Trial::read_mapped(path, map)?;
        if *is_capture {
            let all = read.len();
            read.retain(is_own);
            left_out(path, all - read.len());
            let names: BTreeSet<_> = read.iter().filter_map(Trial::robot_name).collect();
            robots = robots.max(u32::try_from(names.len()).unwrap_or(u32::MAX));
        }
        trials.extend(read);
    }
    Ok((trials, robots))
}

fn left_out(file: &Path, robots: usize) {
    if robots > 0 {
        log_line(&format!(
            "{}: {robots} recordings of robots that are not of the platform are left out",
            file.display()
        ));
    }
}

/// The date, in UTC.
fn today() -> String {
    Utc::new(clock::unix_ns()).date()
}

/// False alarms an hour of a text like `1/day`.
fn rate(text: &str) -> Result<f64, String> {
    let refused =
        || format!("{text}: give a number above 0 an hour, a day or a week, such as 1/day");
    let (number, time) = text.split_once('/').ok_or_else(refused)?;
    let hours = match time {
        "hour" | "h" => 1.0,
        "day" | "d" => 24.0,
        "week" => 168.0,
        _ => return Err(refused()),
    };
    let number: f64 = number.parse().map_err(|_| refused())?;
    if number > 0.0 && number <= 1e6 { Ok(number / hours) } else { Err(refused()) }
}

impl fmt::Display for CalibrateReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.found)?;
        match &self.written {
            Some(path) => writeln!(
                out,
                "written: {}. Name it as the platform's file in the fleet's config",
                path.display()
            ),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_of_hours_days_and_weeks() {
        assert_eq!(rate("2/hour"), Ok(2.0));
        assert_eq!(rate("12/day"), Ok(0.5));
        assert_eq!(rate("168/week"), Ok(1.0));
        for text in ["1", "0/day", "-1/day", "NaN/day", "inf/day", "1/month", "x/day"] {
            assert!(rate(text).is_err(), "{text}");
        }
    }
}
