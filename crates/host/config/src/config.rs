//! A checked config.

use std::path::{Path, PathBuf};

use joulebus_settings::{
    AlarmLimits, AlarmSettings, Battery, ChargeReading, FleetSettings, Intake, IntervalSettings,
    OpenCircuit, Platform, Policy, Scheduling,
};

use crate::consistency::{self, level_limit_by_rate};
use crate::document::{FleetFile, Listed, NamedText, RETIRED};
use crate::files::Attached;
use crate::key::{ValueKind, voltages};
use crate::model_source::ModelSource;
use crate::problem::{ConfigError, Problem};
use crate::values::Values;
use crate::{cpus, files, show, table};

/// File in which the energy ledger and the batteries are saved.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Checkpoint {
    /// Nowhere.
    Off,
    /// In the state directory, if a platform has a battery.
    Auto,
    /// In this file.
    File(PathBuf),
}

/// The threads of the worker's tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Threads {
    /// Number of threads, the worker's own included: at least 1.
    pub count: usize,
    /// Minimum number of robots for parallel ticks.
    pub from: usize,
}

/// The thread that answers questions about plans.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Queries {
    /// True if it runs.
    pub answer: bool,
    /// Its nice value, 0 to 19.
    pub nice: u8,
}

impl Threads {
    /// Maximum number of threads chosen automatically: beyond it, memory bandwidth is the limit.
    const MAX_UNASKED: usize = 8;

    /// Processors that this process may use.
    fn processors() -> usize {
        std::thread::available_parallelism().map_or(1, std::num::NonZeroUsize::get)
    }
}

/// Options for reading recordings of a platform, as text.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RecordingOptions {
    /// Names of columns, as `--map` takes them.
    pub map: Option<String>,
    /// The sign of the current, as `--current` takes it.
    pub current: Option<String>,
    /// Kinds of findings that are let through, as `--accept` takes them.
    pub accept: Option<String>,
}

/// A config that was read completely and found consistent.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    fleet: String,
    root: PathBuf,
    prefix: String,
    settings: FleetSettings,
    policy: Policy,
    tick_period_ns: u64,
    models: Vec<ModelSource>,
    buffer_frames: usize,
    max_planners: usize,
    worker_stale_after_ns: u64,
    checkpoint: Checkpoint,
    checkpoint_every_ns: u64,
    scheduling: Scheduling,
    threads: Threads,
    queries: Queries,
    shown: String,
    recordings: Vec<RecordingOptions>,
    warnings: Vec<Problem>,
}

impl Config {
    /// Reads a fleet's file and the platform files that it names.
    ///
    /// # Errors
    /// The file cannot be read, or it or a platform's file is refused: lists all errors, each with
    /// file, line and remedy.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, ConfigError> {
        let path = path.as_ref();
        let text = files::read(path)
            .map_err(|source| ConfigError::Read { path: path.to_owned(), source })?;
        let directory = path.parent().unwrap_or(Path::new(""));
        Self::read(&text, &path.display().to_string(), directory, None)
    }

    /// Reads the text of a fleet's file with the files that it refers to, such as those attached to
    /// a capture. No others are read.
    ///
    /// # Errors
    /// As [`Config::parse`], or a file that is not among `files`.
    pub fn parse_attached(text: &str, files: &[(&str, &[u8])]) -> Result<Self, ConfigError> {
        Self::read(text, "<config>", Path::new(""), Some(files))
    }

    /// Reads the text of a fleet's file. Paths in it are relative to `base_dir`.
    ///
    /// # Errors
    /// As [`Config::load`]. Messages call the text `<config>`.
    pub fn parse(text: &str, base_dir: &Path) -> Result<Self, ConfigError> {
        Self::read(text, "<config>", base_dir, None)
    }

    fn read(
        text: &str,
        name: &str,
        directory: &Path,
        attached: Attached<'_>,
    ) -> Result<Self, ConfigError> {
        let source = NamedText::new(text, name, Some(directory));
        let mut problems = Vec::new();
        let mut warnings = Vec::new();
        let mut read = source.fleet(&mut problems);
        if !read.cut_short {
            files::platforms(&mut read, attached, &mut problems);
            consistency::check(&read, (&source.name, attached), &mut problems, &mut warnings);
        }
        let (retired, mut problems): (Vec<_>, Vec<_>) =
            problems.into_iter().partition(|problem| problem.what == RETIRED);
        warnings.extend(retired);
        let built = match problems.is_empty() {
            true => Self::build(&read, attached, &mut problems),
            false => None,
        };
        match built {
            Some(config) if problems.is_empty() => Ok(Self { warnings, ..config }),
            _ => {
                problems
                    .sort_by(|one, other| (&one.file, one.line).cmp(&(&other.file, other.line)));
                Err(ConfigError::Refused(problems))
            }
        }
    }

    /// `None` only together with a problem: every key has been checked before.
    fn build(
        read: &FleetFile,
        attached: Attached<'_>,
        problems: &mut Vec<Problem>,
    ) -> Option<Self> {
        let values = &read.values;
        let built = Builder::config(read, attached);
        let complaint = match &built {
            Some(config) => config.complaint(),
            None => Some(("fleet.name", "a value is missing".to_owned())),
        };
        if let Some((key, what)) = complaint {
            let location = values.location(key).or_else(|| values.location("fleet.name"));
            problems.push(Problem {
                file: location.map_or_else(String::new, |location| location.file.to_string()),
                line: location.map(|location| location.line),
                key: key.to_owned(),
                what,
                remedy: "See `config explain`".to_owned(),
            });
        }
        built
    }

    /// Errors of the tick's or the bus's own checks of values that are individually valid, with the
    /// key to look at.
    fn complaint(&self) -> Option<(&'static str, String)> {
        let tick = self.settings.check().err();
        let tick = tick.map(|error| ("fleet.name", error.to_string()));
        tick.or_else(|| Some(("domain.root", self.domain().err()?.to_string())))
    }

    /// Name of the fleet.
    pub fn fleet(&self) -> &str {
        &self.fleet
    }

    /// Private directory of the fleet's shared memory, absolute, `{uid}` replaced.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Prefix of every name in shared memory.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Settings of the tick. They have passed [`FleetSettings::check`].
    pub const fn settings(&self) -> &FleetSettings {
        &self.settings
    }

    /// When a tick is due.
    pub const fn policy(&self) -> Policy {
        self.policy
    }

    /// Minimum time between two ticks, ns.
    pub const fn tick_period_ns(&self) -> u64 {
        self.tick_period_ns
    }

    /// The model of each platform of [`Config::settings`], in the same order.
    pub fn models(&self) -> &[ModelSource] {
        &self.models
    }

    /// Options for reading recordings of a platform of [`Config::settings`]. No option is set if
    /// the config has none, or if there is no such platform.
    #[must_use]
    pub fn recordings(&self, platform: usize) -> RecordingOptions {
        self.recordings.get(platform).cloned().unwrap_or_default()
    }

    /// Frames of each source buffered in shared memory.
    pub const fn buffer_frames(&self) -> usize {
        self.buffer_frames
    }

    /// Planners, live views and recorders that can be connected at the same time.
    pub const fn max_planners(&self) -> usize {
        self.max_planners
    }

    /// Silence of the worker that is reported to people, ns. Planners get a report of two missed
    /// ticks.
    pub const fn worker_stale_after_ns(&self) -> u64 {
        self.worker_stale_after_ns
    }

    /// File in which the energy ledger and the batteries are saved.
    pub const fn checkpoint(&self) -> &Checkpoint {
        &self.checkpoint
    }

    /// Time between two checkpoints, ns.
    pub const fn checkpoint_every_ns(&self) -> u64 {
        self.checkpoint_every_ns
    }

    /// Scheduling of the tick threads.
    pub const fn scheduling(&self) -> &Scheduling {
        &self.scheduling
    }

    /// The threads of the worker's tick.
    pub const fn threads(&self) -> Threads {
        self.threads
    }

    /// The thread that answers questions about plans.
    pub const fn queries(&self) -> Queries {
        self.queries
    }

    /// Values that are allowed but doubtful.
    pub fn warnings(&self) -> &[Problem] {
        &self.warnings
    }

    /// The effective value of a key as TOML: of the platform at an index where the key is a
    /// platform's. `None` if it is not set.
    #[must_use]
    pub fn value(&self, path: &str, platform: usize) -> Option<&str> {
        let (wanted, name) = path.rsplit_once('.')?;
        let (mut section, mut platforms) = ("", 0);
        for line in self.shown.lines() {
            if line == "[[platform]]" {
                (section, platforms) = ("platform", platforms + 1);
            } else if let Some(head) = line.strip_prefix('[') {
                section = head.trim_end_matches(']');
            } else if section == wanted
                && (platforms == 0 || platforms == platform + 1)
                && let Some((_, value)) = line.split_once(" = ").filter(|(key, _)| *key == name)
            {
                return value.rsplit_once(" # ").map(|(value, _)| value);
            }
        }
        None
    }

    /// The whole config as one file: defaults, platforms and paths resolved, each value with its
    /// origin. Reading it gives the same config.
    pub fn to_toml(&self) -> &str {
        &self.shown
    }
}

/// Seconds to ns. Every time in a config is positive and below 2^63 ns.
fn ns(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// Converts checked keys to plain values. `None` for a missing one, which the checks exclude.
struct Builder<'a>(&'a Values);

impl Builder<'_> {
    fn config(read: &FleetFile, attached: Attached<'_>) -> Option<Config> {
        let fleet = Builder(&read.values);
        let platforms: Option<Vec<Platform>> =
            read.platforms.iter().map(|listed| Builder(&listed.values).platform(&fleet)).collect();
        let models: Option<Vec<ModelSource>> =
            read.platforms.iter().map(|listed| files::model(&listed.values, attached)).collect();
        let checkpoint = fleet.checkpoint()?;
        let capacity = consistency::room(read)?;
        Some(Config {
            fleet: fleet.0.text("fleet.name")?,
            root: files::root(&fleet.0.text("domain.root")?),
            prefix: fleet.0.text("domain.prefix")?,
            settings: fleet.settings(capacity, platforms?)?,
            recordings: read.platforms.iter().map(recordings).collect(),
            policy: fleet.policy()?,
            tick_period_ns: ns(1.0 / fleet.0.number("tick.rate_hz")?),
            models: models?,
            buffer_frames: fleet.0.integer("intake.buffer_frames")?,
            max_planners: fleet.0.integer("readers.max_planners")?,
            worker_stale_after_ns: ns(fleet.0.number("readers.worker_stale_after_s")?),
            checkpoint,
            checkpoint_every_ns: ns(fleet.0.number("ledger.every_s")?),
            scheduling: fleet.scheduling()?,
            threads: fleet.threads(capacity)?,
            queries: Queries {
                answer: fleet.0.text("queries.answer")? == "on",
                nice: fleet.0.integer("queries.nice")?,
            },
            shown: show::toml(read),
            warnings: Vec::new(),
        })
    }

    fn settings(&self, capacity: u32, platforms: Vec<Platform>) -> Option<FleetSettings> {
        let number = |path| self.single(path);
        Some(FleetSettings {
            capacity,
            intake: Intake {
                max_samples_per_tick: self.0.integer("intake.max_samples_per_tick")?,
                max_jump_ns: ns(self.0.number("intake.max_jump_s")?),
                leave_after_ns: ns(self.0.number("intake.leave_after_s")?),
                max_sources: self.0.integer("intake.max_sources")?,
            },
            interval: IntervalSettings {
                coverage: number("interval.coverage")?,
                rate: number("interval.rate")?,
            },
            alarms: AlarmSettings {
                bias_weight: number("alarms.bias_weight")?,
                noise_weight: number("alarms.noise_weight")?,
                noise_limit: number("alarms.noise_limit")?,
                mismatch_limit: number("alarms.mismatch_limit")?,
                level_limit: self.level_limit()?,
                settle_samples: self.0.integer("alarms.settle_samples")?,
                raise_samples: self.0.integer("alarms.raise_samples")?,
                clear_samples: self.0.integer("alarms.clear_samples")?,
                training_margin: number("alarms.training_margin")?,
            },
            platforms,
        })
    }

    /// The fleet's, which a stated rate chooses.
    fn level_limit(&self) -> Option<f32> {
        level_limit_by_rate(self.0).or_else(|| self.single("alarms.level_limit"))
    }

    /// A number in single precision. A bound such as 0.99 is between two `f32`, of which the one
    /// inside the range is taken.
    fn single(&self, path: &str) -> Option<f32> {
        let value = self.0.number(path)?;
        let narrow = value as f32;
        match table::find(path)?.kind {
            ValueKind::Number { max, .. } if f64::from(narrow) > max => Some(narrow.next_down()),
            ValueKind::Number { min, .. } if f64::from(narrow) < min => Some(narrow.next_up()),
            _ => Some(narrow),
        }
    }

    fn policy(&self) -> Option<Policy> {
        let deadline_ns = ns(self.0.number("tick.deadline_ms")? * 1e-3);
        match self.0.text("tick.policy")?.as_str() {
            "timer" => Some(Policy::Timer),
            _ => Some(Policy::OnFrame { deadline_ns }),
        }
    }

    fn scheduling(&self) -> Option<Scheduling> {
        Some(Scheduling {
            cpus: cpus::parse(&self.0.text("worker.cpus")?)?,
            priority: self.0.integer("worker.priority")?,
            lock_memory: self.0.text("worker.memory")? == "locked",
            required: self.0.text("worker.if_refused")? == "stop",
        })
    }

    fn threads(&self, capacity: u32) -> Option<Threads> {
        let asked: usize = self.0.integer("worker.threads")?;
        let from = self.0.integer("worker.threads_from")?;
        let cpus = cpus::parse(&self.0.text("worker.cpus")?)?.len();
        let count = match (asked, cpus) {
            // No threads without work.
            _ if (capacity as usize) < from => 1,
            (0, 0) => Threads::processors().min(Threads::MAX_UNASKED),
            (0, cpus) => cpus,
            (asked, _) => asked,
        };
        Some(Threads { count, from })
    }

    fn checkpoint(&self) -> Option<Checkpoint> {
        Some(match self.0.text("ledger.checkpoint")?.as_str() {
            "" => Checkpoint::Off,
            "auto" => Checkpoint::Auto,
            _ => Checkpoint::File(files::resolve(self.0, "ledger.checkpoint")?),
        })
    }

    fn platform(&self, fleet: &Self) -> Option<Platform> {
        let number = |path| self.single(path);
        let time_ns = |path| Some(ns(self.0.number(path)?));
        let battery =
            if self.0.names_any("platform.battery.") { Some(self.battery()?) } else { None };
        let alarms =
            if self.0.names_any("platform.alarms.") { Some(self.limits(fleet)?) } else { None };
        Some(Platform {
            name: self.0.text("platform.name")?,
            robots: self.0.robots(),
            period_ns: ns(1.0 / self.0.number("platform.rate_hz")?),
            stale_after_ns: time_ns("platform.stale_after_s")?,
            hold_max_ns: time_ns("platform.hold_max_s")?,
            stuck_after_ns: time_ns("platform.stuck_after_s")?,
            power_min_w: number("platform.power_min_w")?,
            power_max_w: number("platform.power_max_w")?,
            v_max_mps: number("platform.v_max_mps")?,
            omega_max_radps: number("platform.omega_max_radps")?,
            power_resolution_w: number("platform.power_resolution_w")?,
            battery,
            alarms,
            online: self.0.text("platform.forecast")? == "online",
            energy_online: self.0.text("platform.energy")? == "online",
        })
    }

    /// The platform's limits, and the fleet's where the platform sets none.
    fn limits(&self, fleet: &Self) -> Option<AlarmLimits> {
        let own = |name: &str| self.single(&format!("platform.alarms.{name}"));
        let limit = |name: &str| own(name).or_else(|| fleet.single(&format!("alarms.{name}")));
        Some(AlarmLimits {
            noise_limit: limit("noise_limit")?,
            mismatch_limit: limit("mismatch_limit")?,
            level_limit: own("level_limit").or_else(|| fleet.level_limit())?,
        })
    }

    fn battery(&self) -> Option<Battery> {
        let number = |name: &str| self.0.number(&format!("platform.battery.{name}"));
        let known = |value: f64| (value > 0.0).then_some(value);
        Some(Battery {
            capacity_j: number("capacity_wh")? * 3600.0,
            reserve: number("reserve")?,
            initial_soc: number("initial_soc")?,
            initial_soc_lo: number("initial_soc_lo")?,
            counting_sd: number("counting_sd")?,
            charge_reading: self.charge_reading()?,
            charge_efficiency: number("charge_efficiency")?,
            charge_power_w: known(number("charge_power_w")?),
            on_full_soc: number("on_full_soc")?,
            sensor_sd: number("sensor_sd")?,
            sensor_step: number("sensor_step")?,
            open_circuit: self.open_circuit()?,
            low: number("low")?,
            critical: number("critical")?,
            level_band: number("level_band")?,
            return_j: known(number("return_wh")? * 3600.0),
            docking_j: number("docking_wh")? * 3600.0,
        })
    }

    fn charge_reading(&self) -> Option<ChargeReading> {
        let word = self.0.text("platform.battery.charge_reading")?;
        Some(match word.as_str() {
            "battery" => ChargeReading::Battery,
            "charger" => ChargeReading::Charger,
            _ => ChargeReading::Load,
        })
    }

    /// The table, or `Some(None)` if there is none.
    #[allow(clippy::option_option, reason = "the outer one is that of every key")]
    fn open_circuit(&self) -> Option<Option<OpenCircuit>> {
        let resistance_ohm = self.0.number("platform.battery.resistance_ohm")?;
        let sd = self.0.number("platform.battery.open_circuit_sd")?;
        let text = self.0.text("platform.battery.open_circuit_v")?;
        let volts = voltages(&text).unwrap_or_default();
        Some(OpenCircuit::new(&volts, resistance_ohm, sd))
    }
}

fn recordings(listed: &Listed) -> RecordingOptions {
    let text = |name: &str| listed.values.text(&format!("platform.recordings.{name}"));
    RecordingOptions { map: text("map"), current: text("current"), accept: text("accept") }
}
