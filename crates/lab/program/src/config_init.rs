//! `joulebus config init`: a platform and a fleet from recordings, or from a data sheet.

use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use joulebus_config::{Assignment, Config, fleet_file, platform_file};
use joulebus_dataset::inspect::{Profile, Profiler, is_short};
use joulebus_dataset::split::Split;
use joulebus_dataset::trial::{ColumnMap, Trial, TrialError};
use joulebus_eval::score::{
    Design, Options, Role, ScoreError, ScoredRows, Subject, score_reported,
};
use joulebus_files::WholeFolder;
use joulebus_models::load_models;
use joulebus_predictor::{MAX_MODEL_BYTES, Model};
use joulebus_program::exit::{Outcome, UsageError};
use joulebus_program::file::write;
use joulebus_program::output::{Output, log_line};
use joulebus_program::shell::word;
use joulebus_settings::bounds;
use joulebus_statistics::bootstrap::Estimate;
use serde::Serialize;

use crate::judgement::{AcceptArguments, Origin, report};
use crate::next_command::recordings;
use crate::recordings::{ColumnArguments, find_recordings, open_with_ids};
use crate::train::train_recordings;
use joulebus_program::{model_range, model_source};

/// Write a platform's and a fleet's config from recordings or a data sheet, and train its model if
/// asked
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    joulebus config init --power 30-200 --speed 1.2 --battery-wh 480 --out lab/\n  \
    joulebus config init --from recordings/ --out lab/ --train\n  \
    joulebus config init --from runs/*.csv --map time=t,power_W=p --name husky --battery-wh 480 --out lab/\n\n\
    Rate, limits, resolution, holds and residual deviation are those of the recordings, each with \
    its measured value in a comment. Limits leave a margin. Without --train or --model, forecasts \
    are by \
    persistence. So they are if the trained model is no better on held-out rows. Without recordings, \
    --power states what is known: intervals begin as wide as its range. The files pass `config check`. Nothing is overwritten.")]
pub(crate) struct Args {
    /// Recordings (.npy, .csv, .csv.gz), captures (.mcap), directories (searched recursively), or
    /// patterns in quotes
    #[arg(long, required_unless_present = "power", value_name = "PATH", num_args = 1..)]
    from: Vec<PathBuf>,
    /// Without recordings: least and greatest power of the robot at work, W
    #[arg(long, value_name = "LOW-HIGH", allow_hyphen_values = true, value_parser = power_w,
        conflicts_with_all = ["from", "train", "map", "current", "accept"])]
    power: Option<(f64, f64)>,
    /// Greatest speed, m/s [default: robots that state no velocity]
    #[arg(long, value_name = "MPS", requires = "power", value_parser = positive)]
    speed: Option<f64>,
    /// Greatest turn rate, rad/s
    #[arg(long, value_name = "RADPS", requires = "speed", value_parser = positive, default_value = "3")]
    turn: f64,
    /// Samples a second of each robot, Hz
    #[arg(long, value_name = "HZ", conflicts_with = "from", value_parser = positive, default_value = "10")]
    rate: f64,
    #[command(flatten)]
    columns: ColumnArguments,
    #[command(flatten)]
    accept: AcceptArguments,
    /// Directory for fleet.toml, platforms/ and models/
    #[arg(short, long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
    /// Name of platform and fleet [default: that of the recordings' directory]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Ids of the robots [default: those of the recordings if they are numbers, else from 0]
    #[arg(long, value_name = "IDS", value_delimiter = ',')]
    robots: Vec<String>,
    /// Train a model on the recordings
    #[arg(long, conflicts_with = "model")]
    train: bool,
    /// Use this model file, or builtin:NAME, even if the last reading is a better forecast
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Energy of the battery from full to empty, Wh, which recordings do not state
    #[arg(long, value_name = "WH", value_parser = capacity_wh)]
    battery_wh: Option<f64>,
}

/// `LOW-HIGH`. Either may have a sign.
fn power_w(text: &str) -> Result<(f64, f64), String> {
    let signs = text.match_indices('-').skip_while(|(at, _)| *at == 0);
    let mut found = signs.filter_map(|(at, _)| {
        Some((text[..at].parse::<f64>().ok()?, text[at + 1..].parse::<f64>().ok()?))
    });
    let found = found.find(|(low, high)| low < high && high.is_finite() && *high > 0.0);
    found.ok_or_else(|| "write the least and the greatest power in W, for example 30-200".into())
}

fn positive(text: &str) -> Result<f64, String> {
    let found: Option<f64> = text.parse().ok();
    found
        .filter(|found| 0.0 < *found && found.is_finite())
        .ok_or_else(|| "allowed is above 0".into())
}

pub(crate) fn capacity_wh(text: &str) -> Result<f64, String> {
    let allowed = bounds::BATTERY_CAPACITY_WH;
    let found: Option<f64> = text.parse().ok();
    found
        .filter(|wh| allowed.contains(wh))
        .ok_or_else(|| format!("allowed is {} to {} Wh", allowed.start(), allowed.end()))
}

#[derive(Debug, Serialize)]
struct InitReport {
    fleet: PathBuf,
    platform: PathBuf,
    model: Option<PathBuf>,
    /// The model that was trained.
    #[serde(skip)]
    trained: Option<PathBuf>,
    held_out: Option<HeldOut>,
    /// True if the model does not beat the last reading on the scored rows.
    persistence_is_better: bool,
    /// True if the platform uses persistence.
    uses_persistence: bool,
    recorded: Profile,
    warnings: Vec<String>,
    next: Vec<String>,
}

/// Scores of the model: of a trained one on rows that it has not seen, of a given one on all rows
/// that it was not trained on, if there are some.
#[derive(Debug, Serialize)]
struct HeldOut {
    rows: u64,
    trials: usize,
    design: String,
    /// Against the last reading.
    skill: Estimate,
    confidence: f64,
    scored_rows: ScoredRows,
}

impl HeldOut {
    /// None where too few rows are held out for a score, which is logged.
    fn score(
        config: &Config,
        models: &[Model],
        (files, map): (Vec<PathBuf>, &ColumnMap),
        split: Option<Split>,
    ) -> anyhow::Result<Option<Self>> {
        let settings = config.settings();
        let platform = settings.platforms.first();
        let robot = platform.and_then(|one| Some(*one.robots.first()?.start()));
        let of_robot = |file| (robot.unwrap_or_default(), file);
        let files: Vec<(u32, PathBuf)> = files.into_iter().map(of_robot).collect();
        let recordings = open_with_ids(&files, map)?;
        let design = match split {
            Some(split) => Design::held_out(&recordings, split)?,
            None => Design::folds(&recordings),
        };
        let design = design.hold_apart(&recordings, models)?;
        let subject =
            Subject { settings, platform, models, recordings: &recordings, design: &design };
        let options = Options::default();
        let report = match score_reported(subject, &options) {
            Ok(report) => report,
            Err(error @ ScoreError::NoRows { .. }) => {
                log_line(&format!("warning: no score of the model: {error}"));
                return Ok(None);
            }
            Err(error) => return Err(error.into()),
        };
        let all = &report.all;
        let mut published = all.forecasters.iter();
        let published = published.find(|one| one.role == Role::Published);
        let skill = published.and_then(|one| one.skill.first());
        Ok(skill.map(|skill| Self {
            rows: all.rows,
            trials: all.trials,
            design: design.description.clone(),
            skill: skill.skill,
            confidence: options.bootstrap.confidence,
            scored_rows: report.scored_rows,
        }))
    }

    /// An undefined skill is none.
    fn is_below_persistence(&self) -> bool {
        self.skill.value.is_nan() || self.skill.value <= 0.0
    }
}

impl fmt::Display for HeldOut {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Estimate { value, lo, hi } = self.skill;
        let (rows, trials, design) = (self.rows, self.trials, &self.design);
        let whose = match self.scored_rows {
            ScoredRows::TrainedOn | ScoredRows::Mixed => "TRAINED ON",
            _ => "held out",
        };
        write!(out, "{whose}, {rows} rows of {trials} recordings ({design}): skill {value:.3}")?;
        match lo.is_finite() && hi.is_finite() {
            true => write!(out, " [{lo:.3}, {hi:.3}] at {:.0} %", 100.0 * self.confidence)?,
            false => out.write_str(" (too few for an interval)")?,
        }
        out.write_str(" against the last reading")
    }
}

pub(crate) fn run(args: &Args, output: Output) -> anyhow::Result<Outcome> {
    let map = args.columns.map();
    let files = match args.power {
        Some(_) => Vec::new(),
        None => find_recordings(&args.from)?,
    };
    let (mut profiler, mut found, mut short) = (Profiler::default(), Vec::new(), Vec::new());
    let mut recorded_robots = RecordedRobots::default();
    for file in &files {
        Trial::each(file, &map, |trial| {
            profiler.take(&trial);
            found.push(args.accept.look_at(Origin::Recording, &trial));
            recorded_robots.take(&trial);
            short.extend(Some(trial).filter(is_short));
            Ok::<_, TrialError>(())
        })?;
    }
    let count = recorded_robots.trials as usize;
    let implausible = args.accept.settle(found, &short)?;
    let Some(recorded) = args.stated().or_else(|| profiler.finish()) else {
        let what = "power is constant in all recordings, or there are fewer than two readings";
        return Err(UsageError(format!("{what}. Give recordings of a working robot")).into());
    };
    let name = args.name()?;
    let places = Places::new(&args.out, &name);
    places.check(args.train)?;
    let failed = || format!("cannot write into {}", args.out.display());
    let whole = WholeFolder::begin(&args.out).with_context(failed)?;
    for stuck in &recorded.stuck {
        let held = "its readings are held far longer than those of the others";
        log_line(&format!("warning: {stuck}: {held}. They set no hold_max_s"));
    }
    let fleet = fleet(&name, &recorded, &robots(args, &recorded_robots)?, &files);
    let given = args.given_model()?;
    let draft = platform(&name, &recorded, ChosenModel::new(given.as_deref()), args);
    let read = |platform: &str, trained: Option<&[u8]>| {
        let refused = "recordings and options contradict each other. Nothing was written";
        read(&name, (&fleet, platform), (given.as_deref(), trained)).context(refused)
    };
    read(&draft, None)?;
    let (mut split, mut trained) = (None, None);
    if args.train {
        let Some(made) = train_recordings(&files, &args.columns, &places.model, count)? else {
            return Ok(Outcome::Failed);
        };
        (split, trained) = (Some(made.0), Some(made.1));
    }
    let model = match args.train {
        true => Some(trained_model(&name)),
        false => given.clone(),
    };
    let chosen = ChosenModel::new(model.as_deref());
    let mut text = platform(&name, &recorded, chosen, args);
    let (mut config, mut models) = read(&text, trained.as_deref())?;
    let held_out = match model {
        Some(_) if args.power.is_none() => HeldOut::score(&config, &models, (files, &map), split)?,
        _ => None,
    };
    let persistence_is_better = held_out.as_ref().is_some_and(HeldOut::is_below_persistence);
    if persistence_is_better && args.train {
        // --model states which model is wanted, --train does not.
        let chosen = ChosenModel { path: model.as_deref(), is_below_persistence: true };
        text = platform(&name, &recorded, chosen, args);
        (config, models) = read(&text, trained.as_deref())?;
    }
    write_all(whole, &name, (&fleet, &text), trained.as_deref()).with_context(failed)?;
    let mut warnings: Vec<String> = config.warnings().iter().map(ToString::to_string).collect();
    warnings.extend(model_range::warnings(&config, &models).iter().map(ToString::to_string));
    for warning in &warnings {
        log_line(&format!("warning: {warning}"));
    }
    let (file, from) = (word(&places.fleet), recordings(&args.from));
    let reading = args.columns.options() + &args.accept.option();
    let mut next = Vec::new();
    if model.is_none() && args.power.is_none() {
        next.push(format!("joulebus train trials {from} --out {}{reading}", word(&places.model)));
    }
    next.push(format!("joulebus config check {file}"));
    next.push(format!("joulebus run --config {file}"));
    next.push(match config.settings().platforms.first().filter(|_| args.power.is_some()) {
        Some(platform) => {
            let ids = platform.robots.iter().cloned().flatten().take(20).count();
            format!("joulebus publish sim --config {file} --robots {ids} --duration 20")
        }
        None => format!("joulebus publish trial {from} --config {file}{reading}"),
    });
    let written = InitReport {
        fleet: places.fleet,
        platform: places.platform,
        model: args.train.then_some(&places.model).or(args.model.as_ref()).cloned(),
        trained: args.train.then_some(places.model),
        held_out,
        persistence_is_better,
        uses_persistence: model.is_none() || (persistence_is_better && args.train),
        recorded,
        warnings,
        next,
    };
    report(output, &written, implausible)?;
    Ok(Outcome::Done)
}

/// Reads a fleet's and its platform's text with the model that they name, which has no file yet if
/// it was trained: recordings and options may contradict each other.
fn read(
    name: &str,
    (fleet, platform): (&str, &str),
    (given, trained): (Option<&str>, Option<&[u8]>),
) -> anyhow::Result<(Config, Vec<Model>)> {
    let of_platform = format!("platforms/{name}.toml");
    let of_model = format!("platforms/{}", trained_model(name));
    let mut files = vec![(of_platform.as_str(), platform.as_bytes())];
    files.extend(trained.map(|bytes| (of_model.as_str(), bytes)));
    let bytes;
    if let Some(path) = given.filter(|path| !model_source::is_builtin(Path::new(path))) {
        bytes = joulebus_files::read(Path::new(path), MAX_MODEL_BYTES as u64)
            .with_context(|| format!("cannot read {path}"))?;
        files.push((path, &bytes));
    }
    let config = Config::parse_attached(fleet, &files)?;
    let models = load_models(&config)?;
    Ok((config, models))
}

/// The path of the trained model as the platform's file writes it.
fn trained_model(name: &str) -> String {
    format!("../models/{name}.safetensors")
}

struct Places {
    fleet: PathBuf,
    platform: PathBuf,
    model: PathBuf,
}

impl Places {
    fn new(out: &Path, name: &str) -> Self {
        Self {
            fleet: out.join("fleet.toml"),
            platform: out.join(format!("platforms/{name}.toml")),
            model: out.join(format!("models/{name}.safetensors")),
        }
    }

    /// Refuses to overwrite a file. The model is written only if it is trained.
    fn check(&self, train: bool) -> Result<(), UsageError> {
        let existing = [&self.fleet, &self.platform]
            .into_iter()
            .chain(train.then_some(&self.model))
            .find(|path| path.exists());
        match existing {
            Some(path) => {
                let what = format!("{} exists", path.display());
                Err(UsageError(format!("{what}. Name another directory with --out")))
            }
            None => Ok(()),
        }
    }
}

/// Writes the files of a fleet and its platform, and the trained model. Without one, its folder is
/// made for the model of the next command.
fn write_all(
    mut whole: WholeFolder,
    name: &str,
    (fleet, platform): (&str, &str),
    trained: Option<&[u8]>,
) -> anyhow::Result<()> {
    let model = whole.path(format!("models/{name}.safetensors"))?;
    if let Some(bytes) = trained {
        write(&model, bytes)?;
    }
    write(&whole.path(format!("platforms/{name}.toml"))?, platform.as_bytes())?;
    write(&whole.path("fleet.toml")?, fleet.as_bytes())?;
    Ok(whole.keep_new()?)
}

/// True if a name of a platform may contain it.
const fn is_allowed(letter: char) -> bool {
    letter.is_ascii_alphanumeric() || matches!(letter, '-' | '_')
}

impl Args {
    /// The profile that a data sheet leaves: each reading anywhere in the range, whatever the one
    /// before.
    fn stated(&self) -> Option<Profile> {
        let (low_w, high_w) = self.power?;
        let span_w = high_w - low_w;
        Some(Profile {
            trials: 0,
            readings: 0,
            rate_hz: self.rate,
            power_w: (low_w, high_w),
            resolution_w: Some(span_w * 1e-3),
            difference_w: span_w / 6f64.sqrt(),
            usual_hold_s: 0.0,
            longest_hold_s: 20.0,
            stuck: Vec::new(),
            v_mps: self.speed,
            omega_radps: self.speed.map(|_| self.turn),
            voltage_v: None,
        })
    }

    fn name(&self) -> Result<String, UsageError> {
        let name = match &self.name {
            Some(name) => name.clone(),
            None => {
                let first = self.from.first().map_or(Path::new(""), PathBuf::as_path);
                let directory = match first.is_dir() {
                    true => first.canonicalize().ok(),
                    false => first.parent().and_then(|parent| parent.canonicalize().ok()),
                };
                let name = directory.as_deref().and_then(Path::file_name);
                let name = name.map(|name| name.to_string_lossy().into_owned());
                let plain = name.unwrap_or_default();
                let plain = plain.chars().map(|c| if is_allowed(c) { c } else { '_' });
                let plain: String = plain.take(32).collect();
                if plain.is_empty() { "robot".to_owned() } else { plain }
            }
        };
        match (1..=32).contains(&name.len()) && name.chars().all(is_allowed) {
            true => Ok(name),
            false => Err(UsageError(format!(
                "the name {name:?} is not of 1 to 32 letters, digits, - and _. Give one with --name"
            ))),
        }
    }

    /// The given model's path as the platform's file writes it. None for persistence.
    fn given_model(&self) -> anyhow::Result<Option<String>> {
        let Some(path) = &self.model else {
            return Ok(None);
        };
        if model_source::is_builtin(path) {
            model_source::load(path)?;
            return Ok(Some(path.to_string_lossy().into_owned()));
        }
        let path =
            path.canonicalize().with_context(|| format!("cannot read {}", path.display()))?;
        Ok(Some(path.to_string_lossy().into_owned()))
    }
}

/// Rounded up to two significant digits.
fn above(value: f64) -> f64 {
    rounded(value, f64::ceil)
}

/// Rounded down to two significant digits.
fn below(value: f64) -> f64 {
    rounded(value, f64::floor)
}

fn rounded(value: f64, round: fn(f64) -> f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return 0.0;
    }
    let decimals = 1 - value.abs().log10().floor() as i32;
    // A division by a power of ten gives the nearest decimal, a product with .1 does not.
    match decimals >= 0 {
        true => round(value * 10f64.powi(decimals)) / 10f64.powi(decimals),
        false => round(value / 10f64.powi(-decimals)) * 10f64.powi(-decimals),
    }
}

/// The nearest number of five significant digits.
fn nearest(value: f64) -> f64 {
    format!("{value:.4e}").parse().unwrap_or(value)
}

fn number(key: &'static str, value: f64, note: impl Into<String>) -> Assignment {
    Assignment::number(key, value, note)
}

/// The model of a platform's file.
#[derive(Clone, Copy)]
struct ChosenModel<'a> {
    /// As the file writes it. None for persistence.
    path: Option<&'a str>,
    /// True if the file names persistence instead.
    is_below_persistence: bool,
}

impl<'a> ChosenModel<'a> {
    const fn new(path: Option<&'a str>) -> Self {
        Self { path, is_below_persistence: false }
    }

    fn assignment(self) -> Assignment {
        match self.path {
            Some(path) if self.is_below_persistence => Assignment::text(
                "model",
                "persistence",
                format!(
                    "Better here than {path} on rows held out. To use that model, put its path here."
                ),
            ),
            Some(path) => Assignment::text("model", path, ""),
            None => Assignment::text(
                "model",
                "persistence",
                "Put a trained model here: joulebus train trials.",
            ),
        }
    }

    const fn is_persistence(self) -> bool {
        self.path.is_none() || self.is_below_persistence
    }
}

/// Origins of values without recordings.
const STATED: [(&str, &str); 8] = [
    ("rate_hz", "--rate, or assumed."),
    ("stale_after_s", "6.5 samples or more."),
    ("hold_max_s", "Assumed: each sample is measured anew."),
    ("stuck_after_s", "Assumed."),
    ("power_min_w", "--power. A robot that rests may draw less."),
    ("power_max_w", "--power, and a quarter more."),
    ("power_resolution_w", "Assumed: a thousandth of the range."),
    (
        "residual_std_w",
        "Assumed: a reading says nothing about the next one. Intervals begin that wide, and NoiseHigh needs recordings.",
    ),
];

fn platform(name: &str, recorded: &Profile, model: ChosenModel<'_>, args: &Args) -> String {
    let (least_w, greatest_w) = recorded.power_w;
    let span_w = greatest_w - least_w;
    let margin = if args.power.is_some() { 1.25 } else { 1.5 };
    let rate_hz = nearest(recorded.rate_hz);
    let stale_s = above(6.5 / rate_hz).max(0.5);
    let hold_s = above(3.0 * recorded.usual_hold_s).max(0.5).max(above(1.5 / rate_hz));
    let stuck_s = above(1.5 * recorded.longest_hold_s).max(10.0).max(hold_s);
    // A robot that never feeds energy back has no negative power.
    let min_w = match least_w < 0.0 {
        true => below(least_w - 0.5 * span_w),
        false => 0.0,
    };
    let resolution = match recorded.resolution_w {
        Some(step_w) => {
            (nearest(step_w), "Measured: all readings are whole steps apart.".to_owned())
        }
        None => (
            nearest(recorded.difference_w * 1e-2),
            "The readings have no step: a hundredth of their usual difference.".to_owned(),
        ),
    };
    let speed = |key, value: Option<f64>, unit: &str, least: f64| match value {
        None => number(key, 0.0, "Not known."),
        Some(0.0) => number(key, least, "Recorded: nothing but 0."),
        Some(value) => number(
            key,
            above(1.25 * value),
            match args.power {
                Some(_) => format!(
                    "--{}, and a quarter more.",
                    if unit == "m/s" { "speed" } else { "turn" }
                ),
                None => format!("Recorded: up to {value:.3} {unit}, a quarter more."),
            },
        ),
    };
    let mut assignments = vec![
        Assignment::text("name", name, ""),
        model.assignment(),
        number("rate_hz", rate_hz, "Median of the recordings."),
        number("stale_after_s", stale_s, "6.5 samples or more."),
        number(
            "hold_max_s",
            hold_s,
            format!("Recorded: a reading is usually held for {:.3} s.", recorded.usual_hold_s),
        ),
        number(
            "stuck_after_s",
            stuck_s,
            format!("Recorded: equal readings for up to {:.1} s.", recorded.longest_hold_s),
        ),
        number("power_min_w", min_w, format!("Recorded: {least_w:.3} W and more.")),
        number(
            "power_max_w",
            above(margin * greatest_w.max(0.0)).max(min_w.abs() * 1e-3).max(1e-3),
            format!("Recorded: up to {greatest_w:.3} W, half as much again."),
        ),
        number("power_resolution_w", resolution.0, resolution.1),
        speed("v_max_mps", recorded.v_mps, "m/s", 1.0),
        speed("omega_max_radps", recorded.omega_radps, "rad/s", 3.0),
    ];
    if model.is_persistence() {
        assignments.push(number(
            "residual_std_w",
            nearest(recorded.difference_w),
            "Measured: root mean square of the differences.",
        ));
    }
    assignments.extend(args.columns.assignments());
    assignments.extend(args.accept.assignment());
    if let Some(capacity_wh) = args.battery_wh {
        assignments.push(number("battery.capacity_wh", capacity_wh, "As given."));
        assignments.push(number(
            "battery.initial_soc_lo",
            0.7,
            "Assumed: a used battery holds less than its rating.",
        ));
    }
    let mut title = format!(
        "Platform {name}, from {} trials with {} readings.",
        recorded.trials, recorded.readings
    );
    if args.power.is_some() {
        title =
            format!("Platform {name}, from a data sheet. `joulebus config init --from` measures.");
        for assignment in &mut assignments {
            if let Some((_, note)) = STATED.iter().find(|(key, _)| *key == assignment.key) {
                (*note).clone_into(&mut assignment.note);
            }
        }
    }
    if let (Some((low, high)), None) = (recorded.voltage_v, args.battery_wh) {
        title += &format!(
            " Battery voltage {low:.2} to {high:.2} V. Recordings do not state its capacity: add a \
             [battery] section for budgets (config explain platform.battery)."
        );
    }
    platform_file(&title, &assignments)
}

/// The robots of the recordings.
#[derive(Default)]
struct RecordedRobots {
    names: BTreeSet<String>,
    /// Trials, of which the parts of a long one are one.
    trials: u32,
    /// Robots of long recordings, by their file.
    in_parts: BTreeSet<(PathBuf, Option<String>)>,
}

impl RecordedRobots {
    fn take(&mut self, trial: &Trial) {
        self.names.extend(trial.robot_name().map(str::to_owned));
        let of = || (trial.path().to_owned(), trial.robot_name().map(str::to_owned));
        let is_new = !trial.is_part() || self.in_parts.insert(of());
        self.trials = self.trials.saturating_add(u32::from(is_new));
    }
}

/// The ids of the fleet's robots as TOML.
fn robots(args: &Args, recorded: &RecordedRobots) -> Result<String, UsageError> {
    if !args.robots.is_empty() {
        let quoted: Vec<String> = args.robots.iter().map(|ids| format!("{ids:?}")).collect();
        return Ok(format!("[{}]", quoted.join(", ")));
    }
    let names = recorded.names.iter();
    let ids: Option<BTreeSet<u32>> = names.map(|name| name.parse().ok()).collect();
    let ids: Vec<u32> = match ids.filter(|ids| !ids.is_empty()) {
        Some(ids) => ids.into_iter().collect(),
        // As many as `publish sim` makes.
        None if args.power.is_some() => (0..20).collect(),
        // One for each trial, so that all of them can be played together.
        None => (0..recorded.trials).collect(),
    };
    let mut ranges: Vec<(u32, u32)> = Vec::new();
    for id in ids {
        match ranges.last_mut() {
            Some((_, last)) if last.checked_add(1) == Some(id) => *last = id,
            _ => ranges.push((id, id)),
        }
    }
    let ranges: Vec<String> = ranges
        .iter()
        .map(|(first, last)| match first == last {
            true => first.to_string(),
            false => format!("\"{first}-{last}\""),
        })
        .collect();
    Ok(format!("[{}]", ranges.join(", ")))
}

fn fleet(name: &str, recorded: &Profile, robots: &str, files: &[PathBuf]) -> String {
    let rate_hz = nearest(recorded.rate_hz);
    let stale_s = above(6.5 / rate_hz).max(0.5);
    let leave_s = above(4.0 * stale_s).max(30.0);
    let assignments = [
        Assignment::text("fleet.name", name, ""),
        Assignment::number("tick.rate_hz", rate_hz.max(30.0), "At least the robots' rate."),
        Assignment::number(
            "tick.deadline_ms",
            // Below the period.
            nearest((500.0 / rate_hz.max(30.0)).min(10.0)),
            "",
        ),
        Assignment::number("intake.max_jump_s", (2.0 * leave_s).max(60.0), ""),
        Assignment::number("intake.leave_after_s", leave_s, ""),
        Assignment::text("platform.file", &format!("platforms/{name}.toml"), ""),
        Assignment { key: "platform.robots", value: robots.to_owned(), note: String::new() },
    ];
    let title = match files.len() {
        0 => format!("Fleet {name}, made by `joulebus config init` from a data sheet."),
        count => format!("Fleet {name}, made by `joulebus config init` from {count} recordings."),
    };
    fleet_file(&title, &assignments)
}

impl fmt::Display for InitReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Profile {
            trials,
            readings,
            rate_hz,
            power_w: (least_w, greatest_w),
            difference_w,
            usual_hold_s,
            ..
        } = &self.recorded;
        if *trials == 0 {
            writeln!(
                out,
                "without recordings: {rate_hz} Hz, {least_w} to {greatest_w} W. Forecasts repeat \
                 the last reading, and intervals begin wider than that range"
            )?;
        } else {
            writeln!(
                out,
                "{trials} trials, {readings} readings: {rate_hz:.2} Hz, {least_w:.2} to {greatest_w:.2} W, \
             usually held for {usual_hold_s:.3} s, difference of consecutive readings {difference_w:.3} W"
            )?;
        }
        if let Some(step_w) = self.recorded.resolution_w {
            writeln!(out, "resolution {step_w:.4} W")?;
        }
        let trained = self.trained.as_ref();
        for path in [&self.platform, &self.fleet].into_iter().chain(trained) {
            writeln!(out, "written: {}", path.display())?;
        }
        if let Some(held_out) = &self.held_out {
            writeln!(out, "{held_out}")?;
        }
        if self.persistence_is_better {
            let chosen = match self.uses_persistence {
                true => "the platform uses it. The trained model is kept",
                false => "the platform uses the model that --model names",
            };
            writeln!(out, "persistence is better here: {chosen}")?;
        }
        writeln!(out, "next:")?;
        for command in &self.next {
            writeln!(out, "  {command}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_rounded_outward_to_two_digits() {
        for (value, up, down) in [
            (1716.0, 1800.0, 1700.0),
            (0.0333, 0.034, 0.033),
            (12.0, 12.0, 12.0),
            (-3.21, -3.2, -3.3),
            (0.0, 0.0, 0.0),
        ] {
            assert_eq!((above(value), below(value)), (up, down), "{value}");
        }
    }
}
