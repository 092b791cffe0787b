//! What each alarm means and what to do about it: the one source of `joulebus alarms --explain`,
//! the page, webhooks, the alert rules for Prometheus and docs/reference/alarms.md.

use crate::{Alarm, Level};

/// What an operator needs to know about an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AlarmCard {
    /// Name of the alarm, as in JSON.
    pub name: &'static str,
    /// Level that it means.
    pub level: Level,
    /// What is the case while it is raised.
    pub meaning: &'static str,
    /// What to look at, the likeliest cause first.
    pub check: &'static str,
    /// Keys of the configuration that decide when it is raised. `joulebus config explain KEY`
    /// prints their units and ranges.
    pub keys: &'static [&'static str],
    /// How soon it is raised after its cause, with the shipped settings.
    pub found_within: &'static str,
}

impl AlarmCard {
    /// Of every alarm: those of robots in the order of their codes, then those of the worker.
    pub fn all() -> impl Iterator<Item = &'static Self> {
        OF_ROBOTS.iter().chain(&[Self::IMPLAUSIBLE, Self::WORKER_GONE, Self::WORKER_STALE])
    }

    /// Of the alarm of this name, in any case.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        Self::all().find(|card| card.name.eq_ignore_ascii_case(name))
    }

    /// A source finds what it reports implausible. Readers raise it, and the worker knows nothing
    /// of it.
    pub const IMPLAUSIBLE: Self = Self {
        name: "Implausible",
        level: Level::Warn,
        meaning: "The source of the readings finds them implausible: sign, unit, clock, range or a \
            monitor that does not work. They are used as they are.",
        check: "The source's log and status (of a bridge `implausible`) have what was found and the \
            key that mends it. What is right is accepted there.",
        keys: &[],
        found_within: "64 readings",
    };

    /// No worker runs.
    pub const WORKER_GONE: Self = Self {
        name: "WorkerGone",
        level: Level::Error,
        meaning: "No worker runs: planners get no forecasts.",
        check: "`joulebus run` starts one. `joulebus doctor` says why the last one ended.",
        keys: &[],
        found_within: "at once",
    };

    /// A worker runs and publishes nothing.
    pub const WORKER_STALE: Self = Self {
        name: "WorkerStale",
        level: Level::Stale,
        meaning: "A worker runs and has published nothing for `readers.worker_stale_after_s`.",
        check: "Do sources publish? With no samples there are no ticks by frames. Is its process \
            stopped, or the host overloaded? `joulebus doctor` looks at both.",
        keys: &["readers.worker_stale_after_s", "tick.policy", "tick.rate_hz"],
        found_within: "a second (planners hear of two missed ticks)",
    };
}

impl Alarm {
    /// What it means and what to do about it; `None` for [`Alarm::None`] and [`Alarm::Unknown`].
    #[must_use]
    pub const fn card(self) -> Option<&'static AlarmCard> {
        match self {
            Self::None | Self::Unknown => None,
            raised => Some(&OF_ROBOTS[raised as usize]),
        }
    }

    /// The level that this alarm means.
    #[must_use]
    pub const fn level(self) -> Level {
        match self.card() {
            Some(card) => card.level,
            None if matches!(self, Self::None) => Level::Ok,
            None => Level::Error,
        }
    }
}

/// The samples before a raise, of alarms that are decided sample by sample.
const RAISE: &str = "alarms.raise_samples";
/// The residuals before any alarm on them.
const SETTLE: &str = "alarms.settle_samples";

/// In the order of the codes.
pub(crate) static OF_ROBOTS: [AlarmCard; Alarm::ALL.len()] = [
    AlarmCard {
        name: "NoData",
        level: Level::Stale,
        meaning: "No sample of the robot has arrived for a while. Its forecasts are invalid, and its \
             energy left falls at the platform's greatest power until samples arrive.",
        check: "Is the robot on, in reach, and is its controller or bridge running? `joulebus watch` \
             shows which sources report.",
        keys: &["platform.stale_after_s"],
        found_within: "0.5 s",
    },
    AlarmCard {
        name: "OutOfRange",
        level: Level::Error,
        meaning: "The robot's last samples were refused: a value lies outside the platform's limits, or \
             is no number.",
        check: "The unit and sign that the source sends, then the limits of the platform. The worker's \
             log names the field, the value and the allowed range.",
        keys: &[
            "platform.power_min_w",
            "platform.power_max_w",
            "platform.v_max_mps",
            "platform.omega_max_radps",
            RAISE,
        ],
        found_within: "20 samples, 0.7 s at 30 Hz",
    },
    AlarmCard {
        name: "StuckSensor",
        level: Level::Error,
        meaning: "New measurements arrive, and all of them show the same power for longer than the \
             monitor's resolution explains.",
        check: "The power monitor and its bus. A source that makes up a constant power is found \
            as well. One that repeats an old measurement must keep its time of measurement.",
        keys: &["platform.stuck_after_s", "platform.power_resolution_w", RAISE],
        found_within: "10 s and 20 samples",
    },
    AlarmCard {
        name: "HeldTooLong",
        level: Level::Warn,
        meaning: "Samples arrive, but they repeat one measurement that is too old.",
        check: "How often the power monitor is polled: if that is its rate, the limit is too low for \
             it. Otherwise the monitor or its driver stopped.",
        keys: &["platform.hold_max_s", RAISE],
        found_within: "0.5 s and 20 samples",
    },
    AlarmCard {
        name: "BiasHigh",
        level: Level::Warn,
        meaning: "The robot draws persistently more than its commands and its model explain.",
        check: "Load, slope and floor, a dragging wheel, a motor that wears, a device that was switched \
             on. If the whole fleet has it, the model: train it on newer recordings.",
        keys: &["alarms.cusum_limit", "alarms.cusum_slack", SETTLE, RAISE],
        found_within: "a second where the power doubles, minutes where it rises by a tenth (after \
            the first 150 samples)",
    },
    AlarmCard {
        name: "BiasLow",
        level: Level::Warn,
        meaning: "The robot draws persistently less than its commands and its model explain.",
        check: "Does it drive at all? Look for stalled drivers, a wheel in the air, commands that \
            do not reach it. Was a load taken off? Is the gain of the power monitor right?",
        keys: &["alarms.cusum_limit", "alarms.cusum_slack", SETTLE, RAISE],
        found_within: "a second where the power halves, minutes where it falls by a tenth (after \
            the first 150 samples)",
    },
    AlarmCard {
        name: "NoiseHigh",
        level: Level::Warn,
        meaning: "The readings scatter around their forecasts much more than in training.",
        check: "The power monitor's wiring and averaging, a loose contact, a wheel that slips. If it \
             comes with every drive, the model: train it on newer recordings.",
        keys: &["alarms.noise_limit", "alarms.noise_weight", SETTLE, RAISE],
        found_within: "seconds (after the first 150 samples)",
    },
    AlarmCard {
        name: "ModelMismatch",
        level: Level::Warn,
        meaning: "The network's forecasts are clearly worse than repeating the last reading.",
        check: "Is it this robot's model, at this rate and in these units? `joulebus eval` compares \
             models on a recording of the robot. Published forecasts weigh the network down \
             meanwhile.",
        keys: &["alarms.mismatch_limit", SETTLE, RAISE],
        found_within: "a minute",
    },
    AlarmCard {
        name: "OutOfTraining",
        level: Level::Warn,
        meaning: "A power, speed or their change lies outside what the model was trained on: the \
             forecast is a guess there.",
        check: "Does the robot drive faster than in the recordings of the model? Train with \
            recordings that cover it. `joulebus model info` prints the range of each feature.",
        keys: &["alarms.training_margin", RAISE],
        found_within: "20 samples, 0.7 s at 30 Hz",
    },
    AlarmCard {
        name: "OfflineCharging",
        level: Level::Ok,
        meaning: "The robot is on its charger. No fault.",
        check: "Nothing. If it is not on its charger: the charger's state that the source sends.",
        keys: &["platform.battery.charge_reading", RAISE],
        found_within: "20 samples, 0.7 s at 30 Hz",
    },
    AlarmCard {
        name: "DeadlineMissed",
        level: Level::Warn,
        meaning: "The worker began the robot's tick too late.",
        check: "The load of the host, sources that report late, `worker.priority` and `worker.cpus`. \
             `joulebus doctor` looks at the host.",
        keys: &["tick.deadline_ms", RAISE],
        found_within: "20 samples, 0.7 s at 30 Hz",
    },
    AlarmCard {
        name: "WatchdogStop",
        level: Level::Warn,
        meaning: "The robot's watchdog stopped it. Reserved: this version never raises it.",
        check: "Nothing.",
        keys: &[],
        found_within: "never",
    },
    AlarmCard {
        name: "CannotReturn",
        level: Level::Error,
        meaning: "The energy that is certainly left is less than the robot needs to return.",
        check: "Send it to its charger now, or fetch it. If that is wrong, what the planner states as \
             the energy to return.",
        keys: &["platform.battery.return_wh", "platform.battery.reserve"],
        found_within: "at once",
    },
    AlarmCard {
        name: "BatteryCritical",
        level: Level::Error,
        meaning: "The state of charge is below the critical level.",
        check: "Send the robot to its charger. If that is wrong: capacity, initial charge, and the \
             state of charge that the source sends.",
        keys: &["platform.battery.critical", "platform.battery.level_band"],
        found_within: "at once",
    },
    AlarmCard {
        name: "BatteryLow",
        level: Level::Warn,
        meaning: "The state of charge is below the low level.",
        check: "Plan its way to the charger. If that is wrong: capacity, initial charge, and the state \
             of charge that the source sends.",
        keys: &["platform.battery.low", "platform.battery.level_band"],
        found_within: "at once",
    },
    AlarmCard {
        name: "SocImplausible",
        level: Level::Warn,
        meaning: "The measured state of charge contradicts the energy drawn: it does not change, or it \
             jumps. It is not used. The energy is counted instead.",
        check: "The robot's battery monitor, the unit of its charge (0 to 1, not percent), and the \
             platform's capacity.",
        keys: &["platform.battery.sensor_sd", "platform.battery.capacity_wh"],
        found_within: "at once at a jump, otherwise when the energy drawn shows it",
    },
    AlarmCard {
        name: "LevelHigh",
        level: Level::Warn,
        meaning: "The robot draws more than it did before for the same commands. It stays until the \
            power is back, or the worker restarts: nothing of it is learned.",
        check: "What changed since: load, floor or slope, a dragging wheel, a device that was switched \
            on. Acknowledge it if that is meant, as a payload is.",
        keys: &["alarms.level_limit"],
        found_within: "seconds where the power doubles, ten where it rises by two fifths, a \
            minute at 30 % a minute (after five seconds of known commands)",
    },
    AlarmCard {
        name: "LevelLow",
        level: Level::Warn,
        meaning: "The robot draws less than it did before for the same commands. It stays until the \
            power is back, or the worker restarts: nothing of it is learned.",
        check: "Does it drive at all? Look for a wheel in the air, a stalled driver, commands \
            that do not reach it. Was a load taken off? Is the gain of the power monitor right?",
        keys: &["alarms.level_limit"],
        found_within: "seconds where the power halves (after five seconds of known commands)",
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_alarm_has_its_own_card() {
        for alarm in Alarm::ALL {
            assert_eq!(alarm.card().map(|card| card.name), Some(alarm.name()));
            assert_eq!(AlarmCard::named(alarm.name()), alarm.card());
        }
        assert_eq!(Alarm::None.card(), Alarm::Unknown.card());
    }
}
