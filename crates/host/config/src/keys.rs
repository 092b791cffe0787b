//! The table of keys, the only source of explanations, range checks and the comments in the shipped
//! files.

use std::ops::RangeInclusive;

use joulebus_settings::bounds;

use crate::key::{
    DefaultValue,
    File::{self, Fleet, Platform},
    Key, TextRule, ValueKind,
};

/// The root directory of a fleet whose file names none.
pub(crate) const DEFAULT_ROOT: &str = "/dev/shm/joulebus-{uid}";

pub(crate) const fn key(
    path: &'static str,
    kind: ValueKind,
    unit: &'static str,
    default: DefaultValue,
    doc: &'static str,
) -> Key {
    Key { path, file: Fleet, kind, unit, default, doc }
}

pub(crate) const fn of(file: File, mut key: Key) -> Key {
    key.file = file;
    key
}

pub(crate) const fn int(allowed: RangeInclusive<u32>) -> ValueKind {
    ValueKind::Integer { min: *allowed.start() as i64, max: *allowed.end() as i64 }
}

pub(crate) const fn num(allowed: RangeInclusive<f64>) -> ValueKind {
    ValueKind::Number { min: *allowed.start(), max: *allowed.end() }
}

/// Tick rate of a fleet and sample rate of a robot, Hz.
const RATE_HZ: RangeInclusive<f64> = 0.1..=1000.0;
/// Silence of a robot, or age of a measurement, s.
const SILENCE_S: RangeInclusive<f64> = 0.002..=3600.0;
/// Absence after which a robot counts as new, s: up to a week.
const ABSENCE_S: RangeInclusive<f64> = 0.01..=604_800.0;

/// Every key of fleets and platforms, in the order of the shipped files.
#[rustfmt::skip]
pub const KEYS: &[Key] = &[
    key("fleet.name", ValueKind::Text(TextRule::Name), "", DefaultValue::Required,
        "Name of the fleet. Part of every service name, so that fleets do not mix."),
    key("fleet.capacity", int(bounds::CAPACITY), "robots", DefaultValue::Unset,
        "Maximum number of robots. Further ones are refused, counted and named. Some 25 MB of shared memory are reserved, and 0.1 to 0.4 MB more for each robot. Without it: the robots that the platforms list, up to 1000."),

    key("domain.root", ValueKind::Text(TextRule::Root), "", DefaultValue::Text(DEFAULT_ROOT),
        "Private directory that holds the fleet's shared memory. Keep it on a tmpfs."),
    key("domain.prefix", ValueKind::Text(TextRule::Prefix), "", DefaultValue::Text("jb_"),
        "Prefix of every name in shared memory. It distinguishes the fleet's files from others."),

    key("tick.policy", ValueKind::Choice(&["on_frame", "timer"]), "", DefaultValue::Text("on_frame"),
        "When a tick is due: once every robot whose sample is due has reported, or on a fixed grid."),
    key("tick.rate_hz", num(RATE_HZ), "Hz", DefaultValue::Number(30.0),
        "Maximum tick rate, with either policy."),
    key("tick.deadline_ms", num(0.1..=10_000.0), "ms", DefaultValue::Number(10.0),
        "With on_frame: longest wait for the other robots after the first sample of a tick."),

    key("intake.max_samples_per_tick", int(bounds::MAX_SAMPLES_PER_TICK), "samples", DefaultValue::Integer(8),
        "Samples of one robot processed per tick. Further ones are dropped and counted as Backlog."),
    key("intake.max_jump_s", num(ABSENCE_S), "s", DefaultValue::Number(60.0),
        "A stamp further than this after the robot's last one is refused."),
    key("intake.leave_after_s", num(ABSENCE_S), "s", DefaultValue::Number(30.0),
        "A robot silent for longer than this has left. Its slot can be reused."),
    key("intake.max_sources", int(bounds::MAX_SOURCES), "sources", DefaultValue::Integer(64),
        "Maximum number of sources that the worker tracks."),
    key("intake.buffer_frames", int(bounds::BUFFER_FRAMES), "frames", DefaultValue::Integer(8),
        "Frames buffered in shared memory per source. When the buffer is full, the oldest is lost."),

    key("interval.coverage", num(bounds::COVERAGE), "share", DefaultValue::Number(0.9),
        "Nominal coverage: share of readings inside the interval around their forecast."),
    key("interval.rate", num(bounds::INTERVAL_RATE), "share", DefaultValue::Number(0.2),
        "How far an end of the interval moves when a reading falls outside it, relative to its distance from the centre."),

    key("alarms.bias_weight", num(bounds::ALARM_WEIGHT), "share", DefaultValue::Number(0.005),
        "Weight of the newest residual in the running bias."),
    key("alarms.noise_weight", num(bounds::ALARM_WEIGHT), "share", DefaultValue::Number(0.005),
        "Weight of the newest squared residual in the noise ratio."),
    key("alarms.noise_limit", num(bounds::NOISE_LIMIT), "ratio", DefaultValue::Number(15.0),
        "Noise ratio (1 = as in training) at which NoiseHigh is raised. The alarm is cleared below half of it."),
    key("alarms.mismatch_limit", num(bounds::MISMATCH_LIMIT), "ratio", DefaultValue::Number(2.0),
        "Ratio of the network's squared error to that of persistence at which ModelMismatch is raised. Three times the network's error in training replaces that of persistence if it is greater. The alarm is cleared below 0.9 of the limit."),
    key("alarms.level_limit", num(bounds::LEVEL_LIMIT), "standard deviations", DefaultValue::Number(8.0),
        "Change of a robot's power for the same commands at which LevelHigh or LevelLow is raised after three seconds. It grows by a third in a robot's first ten minutes, because by chance a robot deviates the farther, the longer it runs. Either is cleared below half of it."),
    key("alarms.level_alarms_per_robot_h", num(bounds::LEVEL_RATE), "alarms a robot and hour", DefaultValue::Unset,
        "Replaces level_limit by the lowest that kept this rate of false alarms in 200 simulated robot-hours, with 95 % confidence."),
    key("alarms.settle_samples", int(bounds::SETTLE_SAMPLES), "samples", DefaultValue::Integer(150),
        "Residuals of a robot before any alarm based on them is raised."),
    key("alarms.raise_samples", int(bounds::ALARM_SAMPLES), "samples", DefaultValue::Integer(20),
        "Consecutive samples above the limit before an alarm is raised."),
    key("alarms.clear_samples", int(bounds::ALARM_SAMPLES), "samples", DefaultValue::Integer(90),
        "Consecutive samples below the limit before an alarm is cleared."),
    key("alarms.training_margin", num(bounds::TRAINING_MARGIN), "share", DefaultValue::Number(0.1),
        "How far a feature may lie outside its training range, relative to that range."),

    key("ledger.checkpoint", ValueKind::Text(TextRule::StateFile), "", DefaultValue::Text("auto"),
        "File that energy ledger and batteries are saved to and restored from. auto: a file of this fleet in the state directory where a platform has a battery, otherwise none. The state directory is $STATE_DIRECTORY, $XDG_STATE_HOME/joulebus or ~/.local/state/joulebus. Empty: both are lost when the worker ends."),
    key("ledger.every_s", num(0.05..=3600.0), "s", DefaultValue::Number(1.0),
        "Longest time between two checkpoints. A killed worker loses at most this much of the ledger. The log says if the disk is too slow for that."),

    key("worker.threads", int(0..=64), "threads", DefaultValue::Integer(0),
        "Threads of a parallel tick, at most as many as cpus lists. 0: one per entry of cpus. Without cpus: one per processor, at most 8."),
    key("worker.threads_from", int(bounds::CAPACITY), "robots", DefaultValue::Integer(512),
        "Number of robots from which ticks run in parallel. Below, a second thread wakes too late to help."),
    key("worker.cpus", ValueKind::Text(TextRule::Cpus), "", DefaultValue::Text(""),
        "CPUs that the tick threads are pinned to, one each, the main tick thread first. Empty: not pinned."),
    key("worker.priority", int(0..=99), "", DefaultValue::Integer(0),
        "Real-time priority (SCHED_FIFO) of the tick threads. 0: normal scheduling."),
    key("worker.memory", ValueKind::Choice(&["unlocked", "locked"]), "", DefaultValue::Text("unlocked"),
        "locked: all memory of the worker is locked (mlockall) and touched at start."),
    key("worker.if_refused", ValueKind::Choice(&["warn", "stop"]), "", DefaultValue::Text("warn"),
        "When the system refuses cpus, priority or memory: continue with a warning, or do not start."),

    key("readers.max_planners", int(bounds::MAX_PLANNERS), "readers", DefaultValue::Integer(16),
        "Planners and views that can be connected at the same time. Worker, two recorders and a link have places of their own."),
    key("readers.worker_stale_after_s", num(SILENCE_S), "s", DefaultValue::Number(1.0),
        "Silence after which page, alarms, webhooks and metrics report the worker as stale. Planners hear of two missed ticks."),

    key("queries.answer", ValueKind::Choice(&["on", "off"]), "", DefaultValue::Text("on"),
        "Whether a thread of the worker answers questions about plans, for processes that do not compute for themselves."),
    key("queries.nice", int(bounds::NICE), "", DefaultValue::Integer(10),
        "Nice value of that thread: above 0 the tick and other processes go first."),

    key("platform.file", ValueKind::Text(TextRule::PlatformFile), "", DefaultValue::Unset,
        "The platform's file. Keys given here override the file's."),
    key("platform.robots", ValueKind::Robots, "ids", DefaultValue::Required,
        "Ids of the robots of this platform. A robot belongs to at most one platform."),

    of(Platform, key("platform.name", ValueKind::Text(TextRule::Name), "", DefaultValue::Required,
        "Name of the platform, for messages.")),
    of(Platform, key("platform.model", ValueKind::Text(TextRule::Model), "", DefaultValue::Required,
        "Forecast model: a model file, a built-in model, or persistence (the last reading again).")),
    of(Platform, key("platform.forecast", ValueKind::Choice(&["online", "network"]), "", DefaultValue::Text("online"),
        "online: last reading, autoregression and network, combined per robot by its own readings.")),
    of(Platform, key("platform.energy", ValueKind::Choice(&["online", "model"]), "", DefaultValue::Text("online"),
        "online: energy of plans, corrected per robot by the errors of its earlier plans. model: as trained.")),
    of(Platform, key("platform.residual_std_w", num(1e-6..=1e6), "W", DefaultValue::Unset,
        "With model = \"persistence\": standard deviation of the difference of consecutive readings.")),
    of(Platform, key("platform.rate_hz", num(RATE_HZ), "Hz", DefaultValue::Required,
        "Samples per second of each robot.")),
    of(Platform, key("platform.stale_after_s", num(SILENCE_S), "s", DefaultValue::Number(0.5),
        "Silence after which a robot is Invalid. A longer gap empties its lag window.")),
    of(Platform, key("platform.hold_max_s", num(SILENCE_S), "s", DefaultValue::Number(0.5),
        "Age of a measurement above which HeldTooLong is raised.")),
    of(Platform, key("platform.stuck_after_s", num(0.01..=86_400.0), "s", DefaultValue::Number(10.0),
        "Time over which all new measurements may be equal before StuckSensor is raised.")),
    of(Platform, key("platform.power_min_w", num(bounds::POWER_MIN_W), "W", DefaultValue::Required,
        "Lowest plausible power, negative where the robot regenerates.")),
    of(Platform, key("platform.power_max_w", num(bounds::POWER_MAX_W), "W", DefaultValue::Required,
        "Highest plausible power. It is also the power assumed for unmetered time, on the safe side.")),
    of(Platform, key("platform.power_resolution_w", num(bounds::POWER_RESOLUTION_W), "W", DefaultValue::Required,
        "Resolution of the power monitor. It is the lower bound of every residual scale.")),
    of(Platform, key("platform.v_max_mps", num(bounds::V_MAX_MPS), "m/s", DefaultValue::Required,
        "Largest |v| that can be commanded, 0 for robots that report no velocity.")),
    of(Platform, key("platform.omega_max_radps", num(bounds::OMEGA_MAX_RADPS), "rad/s", DefaultValue::Required,
        "Largest |omega| that can be commanded, 0 for robots that report no velocity.")),

    of(Platform, key("platform.alarms.noise_limit", num(bounds::NOISE_LIMIT), "ratio", DefaultValue::Unset,
        "Replaces the fleet's alarms.noise_limit for this platform.")),
    of(Platform, key("platform.alarms.mismatch_limit", num(bounds::MISMATCH_LIMIT), "ratio", DefaultValue::Unset,
        "Replaces the fleet's alarms.mismatch_limit for this platform.")),
    of(Platform, key("platform.alarms.level_limit", num(bounds::LEVEL_LIMIT), "standard deviations", DefaultValue::Unset,
        "Replaces the fleet's alarms.level_limit for this platform.")),

    of(Platform, key("platform.recordings.map", ValueKind::Text(TextRule::Columns), "", DefaultValue::Unset,
        "Columns of this platform's recordings, as --map names them. Verbs that read the config use it where --map is not given.")),
    of(Platform, key("platform.recordings.current", ValueKind::Choice(&["discharge-positive", "discharge-negative"]), "", DefaultValue::Unset,
        "Sign of the current in this platform's recordings, as --current states it.")),
    of(Platform, key("platform.recordings.accept", ValueKind::Text(TextRule::Findings), "", DefaultValue::Unset,
        "Findings that are let through in this platform's recordings, as by --accept.")),

    of(Platform, key("platform.battery.capacity_wh", num(bounds::BATTERY_CAPACITY_WH), "Wh", DefaultValue::Required,
        "Energy of the battery from full to empty. Omit [battery] if it is unknown.")),
    of(Platform, key("platform.battery.reserve", num(bounds::SHARE), "share", DefaultValue::Number(0.1),
        "Share of the capacity that is never counted as usable.")),
    of(Platform, key("platform.battery.initial_soc", num(bounds::SHARE), "share", DefaultValue::Number(1.0),
        "State of charge when the ledger starts, best estimate.")),
    of(Platform, key("platform.battery.initial_soc_lo", num(bounds::SHARE), "share", DefaultValue::Required,
        "State of charge when the ledger starts, conservative estimate, at most initial_soc.")),
    of(Platform, key("platform.battery.counting_sd", num(bounds::COUNTING_SD), "share", DefaultValue::Number(0.03),
        "Standard deviation of counted energy, as a share of it. It covers errors of the power monitor and of the capacity.")),
    of(Platform, key("platform.battery.charge_reading", ValueKind::Choice(&["load", "battery", "charger"]), "", DefaultValue::Text("load"),
        "What a power reading means on the charger. load: what the robot consumes, so the charge is unknown. battery: power out of the battery, negative while it is charged. charger: power into the battery, positive.")),
    of(Platform, key("platform.battery.charge_efficiency", num(bounds::CHARGE_EFFICIENCY), "share", DefaultValue::Number(0.9),
        "Share of metered charging energy that the battery gives back.")),
    of(Platform, key("platform.battery.charge_power_w", num(0.0..=*bounds::CHARGE_POWER_W.end()), "W", DefaultValue::Number(0.0),
        "Greatest power that fills the battery, for charging that is not metered. 0: unknown, the battery may be full at once.")),
    of(Platform, key("platform.battery.on_full_soc", num(bounds::SHARE), "share", DefaultValue::Number(1.0),
        "State of charge when a sample says that the charger has finished (Charger::Full).")),
    of(Platform, key("platform.battery.sensor_sd", num(bounds::SOC_SD), "share", DefaultValue::Number(0.05),
        "Standard deviation of a measured state of charge (RobotState::state_of_charge). Its error is assumed to last for about an hour.")),
    of(Platform, key("platform.battery.sensor_step", num(bounds::SOC_STEP), "share", DefaultValue::Number(0.01),
        "Resolution of a measured state of charge.")),
    of(Platform, key("platform.battery.open_circuit_v", ValueKind::Text(TextRule::Voltages), "V", DefaultValue::Text(""),
        "Open-circuit voltages at equal steps of the state of charge from empty to full, for robots that measure a voltage but no state of charge.")),
    of(Platform, key("platform.battery.open_circuit_sd", num(bounds::SOC_SD), "share", DefaultValue::Number(0.1),
        "Standard deviation of a state of charge that follows from a voltage.")),
    of(Platform, key("platform.battery.resistance_ohm", num(bounds::RESISTANCE_OHM), "Ohm", DefaultValue::Number(0.0),
        "Internal resistance of the battery: what the current takes off its voltage.")),
    of(Platform, key("platform.battery.low", num(bounds::SHARE), "share", DefaultValue::Number(0.2),
        "State of charge below which BatteryLow is raised.")),
    of(Platform, key("platform.battery.critical", num(bounds::SHARE), "share", DefaultValue::Number(0.1),
        "State of charge below which BatteryCritical is raised, at most low.")),
    of(Platform, key("platform.battery.level_band", num(bounds::LEVEL_BAND), "share", DefaultValue::Number(0.03),
        "A level is cleared this far above the threshold at which it is raised.")),
    of(Platform, key("platform.battery.return_wh", num(0.0..=*bounds::BATTERY_CAPACITY_WH.end()), "Wh", DefaultValue::Number(0.0),
        "Energy that a robot needs to return from anywhere. CannotReturn is raised when less than this is certainly left. A planner states it per robot (RobotState::return_energy). 0: only robots whose planner states it.")),
    of(Platform, key("platform.battery.docking_wh", num(0.0..=*bounds::BATTERY_CAPACITY_WH.end()), "Wh", DefaultValue::Number(0.0),
        "Energy that docking costs the robot at the end of a way back. Answers about a path with a return add it, so that it is not taken from the reserve.")),
];
