//! The meaning and the remedy of each alarm: the one source of `joulebus alarms --explain`, the
//! page, webhooks and the alert rules for Prometheus. docs/reference/alarms.md has them in short.

use crate::{Alarm, Level};

/// The meaning, causes and remedies of an alarm, for operators.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AlarmCard {
    /// Name of the alarm, as in JSON.
    pub name: &'static str,
    /// Level that it means.
    pub level: Level,
    /// The condition while it is raised.
    pub meaning: &'static str,
    /// Things to look at, the likeliest cause first.
    pub check: &'static str,
    /// Keys of the configuration that decide when it is raised. `joulebus config explain KEY`
    /// prints their units and ranges.
    pub keys: &'static [&'static str],
    /// Time from the cause to the alarm, with the shipped settings.
    pub found_within: &'static str,
}

impl AlarmCard {
    /// All cards: those of robots in the order of their codes, then those of the worker.
    pub fn all() -> impl Iterator<Item = &'static Self> {
        OF_ROBOTS.iter().chain(&[Self::IMPLAUSIBLE, Self::WORKER_GONE, Self::WORKER_STALE])
    }

    /// The card of the alarm of this name, in upper or lower case.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        Self::all().find(|card| card.name.eq_ignore_ascii_case(name))
    }

    /// A source finds what it reports implausible. Readers raise it. The worker passes the finding
    /// on to answers about plans.
    pub const IMPLAUSIBLE: Self = Self {
        name: "Implausible",
        level: Level::Warn,
        meaning: "The source of the readings finds them implausible: sign, unit, clock, range or a \
            monitor that does not work. The worker uses them as they are.",
        check: "The source's log says what was found, and which key fixes it. A bridge's status \
            has it as `implausible`. If the readings are right, accept the finding in the source's \
            settings.",
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
        check: "Is the worker's process stopped, or the host overloaded? `joulebus doctor` looks \
            at both. Sources are not the cause: the worker also ticks without samples.",
        keys: &["readers.worker_stale_after_s", "tick.policy", "tick.rate_hz"],
        found_within: "a second (planners hear of two missed ticks)",
    };
}

impl Alarm {
    /// The alarm's card. `None` for [`Alarm::None`] and [`Alarm::Unknown`].
    pub const fn card(self) -> Option<&'static AlarmCard> {
        match self {
            Self::None | Self::Unknown => None,
            raised => Some(&OF_ROBOTS[raised as usize]),
        }
    }

    /// True if it compares a robot with its own earlier level: it can be acknowledged as the new
    /// normal.
    pub const fn is_of_level(self) -> bool {
        matches!(self, Self::LevelHigh | Self::LevelLow)
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
        meaning: "No sample of the robot has arrived for a while. Its forecasts are invalid. Until \
             samples arrive, its energy left falls as if it drew the platform's greatest power.",
        check: "Is the robot on, in reach, and is its controller or bridge running? `joulebus watch` \
             shows which sources report.",
        keys: &["platform.stale_after_s"],
        found_within: "0.5 s",
    },
    AlarmCard {
        name: "OutOfRange",
        level: Level::Error,
        meaning: "The robot's last samples were refused: a value lies outside the platform's \
             limits, or is not a number.",
        check: "The unit and sign that the source sends, then the limits of the platform. `joulebus watch` \
             and the page name the field, the value and the allowed range.",
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
        check: "The power monitor and its bus. A source that sends a made-up constant power raises \
            this alarm too. A source that repeats an old measurement must keep its time of \
            measurement.",
        keys: &["platform.stuck_after_s", "platform.power_resolution_w", RAISE],
        found_within: "10 s and 20 samples",
    },
    AlarmCard {
        name: "HeldTooLong",
        level: Level::Warn,
        meaning: "Samples arrive, but they repeat one measurement that is too old.",
        check: "How often does the source read the power monitor? If it reads less often than \
             `hold_max_s`, raise that limit. Otherwise the monitor or its driver has stopped.",
        keys: &["platform.hold_max_s", RAISE],
        found_within: "0.5 s and 20 samples",
    },
    AlarmCard {
        name: "BiasHigh",
        level: Level::Warn,
        meaning: "Retired: LevelHigh has replaced it. In captures of older versions it says that \
            the robot drew persistently more than its commands and its model explained.",
        check: "What LevelHigh says.",
        keys: &[],
        found_within: "never",
    },
    AlarmCard {
        name: "BiasLow",
        level: Level::Warn,
        meaning: "Retired: LevelLow has replaced it. In captures of older versions it says that \
            the robot drew persistently less than its commands and its model explained.",
        check: "What LevelLow says.",
        keys: &[],
        found_within: "never",
    },
    AlarmCard {
        name: "NoiseHigh",
        level: Level::Warn,
        meaning: "The readings scatter around their forecasts much more than in training.",
        check: "The power monitor's wiring and averaging, a loose contact, a wheel that slips. If \
             every drive raises it, train the model on newer recordings.",
        keys: &["alarms.noise_limit", "alarms.noise_weight", SETTLE, RAISE],
        found_within: "seconds (after the first 150 samples)",
    },
    AlarmCard {
        name: "ModelMismatch",
        level: Level::Warn,
        meaning: "The network's forecasts are clearly worse than repeating the last reading, or \
            the robot draws four times the power of its model, or a quarter of it.",
        check: "Is it this robot's model, at this rate and in these units? `joulebus eval` compares \
             models on a recording of the robot. Meanwhile published forecasts give the network \
             little weight.",
        keys: &["alarms.mismatch_limit", SETTLE, RAISE],
        found_within: "a minute",
    },
    AlarmCard {
        name: "OutOfTraining",
        level: Level::Warn,
        meaning: "A power, a speed or a change of one lies outside what the model was trained on. \
             There the forecast is a guess.",
        check: "Does the robot drive faster than in the recordings of the model? Train with \
            recordings that cover it. `joulebus model info` prints the range of each feature.",
        keys: &["alarms.training_margin", RAISE],
        found_within: "20 samples, 0.7 s at 30 Hz",
    },
    AlarmCard {
        name: "OfflineCharging",
        level: Level::Ok,
        meaning: "The robot is on its charger. No fault.",
        check: "Nothing. If the robot is not on its charger, check the charger's state that the \
            source sends.",
        keys: &["platform.battery.charge_reading", RAISE],
        found_within: "20 samples, 0.7 s at 30 Hz",
    },
    AlarmCard {
        name: "DeadlineMissed",
        level: Level::Warn,
        meaning: "The worker began the robot's tick too late, or computed it for longer than a period.",
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
        meaning: "The lower bound of the energy left is less than the robot needs to return.",
        check: "Send the robot to its charger now, or fetch it. If it can return, check the energy \
             to return that the planner states.",
        keys: &["platform.battery.return_wh", "platform.battery.reserve"],
        found_within: "at once",
    },
    AlarmCard {
        name: "BatteryCritical",
        level: Level::Error,
        meaning: "The state of charge is below the critical level.",
        check: "Send the robot to its charger. If its battery is fuller, check the capacity, the \
             initial charge, and the state of charge that the source sends.",
        keys: &["platform.battery.critical", "platform.battery.level_band"],
        found_within: "at once",
    },
    AlarmCard {
        name: "BatteryLow",
        level: Level::Warn,
        meaning: "The state of charge is below the low level.",
        check: "Plan its path to the charger. If its battery is fuller, check the capacity, the \
             initial charge, and the state of charge that the source sends.",
        keys: &["platform.battery.low", "platform.battery.level_band"],
        found_within: "at once",
    },
    AlarmCard {
        name: "SocImplausible",
        level: Level::Warn,
        meaning: "The measured state of charge contradicts the energy drawn: it does not change, \
             or it jumps. The worker does not use it, and counts the energy instead.",
        check: "The robot's battery monitor, the unit of its charge (0 to 1, not percent), and the \
             platform's capacity.",
        keys: &["platform.battery.sensor_sd", "platform.battery.capacity_wh"],
        found_within: "at once at a jump, otherwise when the energy drawn shows it",
    },
    AlarmCard {
        name: "LevelHigh",
        level: Level::Warn,
        meaning: "For the same commands the robot draws more than it did before, or than the \
            platform's other robots do. The alarm stays until the power is back, somebody acknowledges it as the new normal, or the worker \
            restarts. Meanwhile the worker does not learn the new level.",
        check: "Floor? Another floor or slope looks like a load. Otherwise: a load, a dragging \
            wheel, a device that was switched on? If the change is intended, such as a payload, \
            acknowledge it as the new normal.",
        keys: &["alarms.level_limit"],
        found_within: "seconds if the power doubles, ten seconds if it rises by two fifths, a \
            minute if it rises by 30 % a minute (after five seconds of known commands). Half a \
            minute if it is doubled from the first sample on, beside eight other robots",
    },
    AlarmCard {
        name: "LevelLow",
        level: Level::Warn,
        meaning: "For the same commands the robot draws less than it did before, or than the \
            platform's other robots do. The alarm stays until the power is back, somebody acknowledges it as the new normal, or the worker \
            restarts. Meanwhile the worker does not learn the new level.",
        check: "Does it drive at all? Look for a wheel in the air, a stalled driver, commands \
            that do not reach it. Is the gain of the power monitor right? If a load was taken off, \
            acknowledge it as the new normal.",
        keys: &["alarms.level_limit"],
        found_within: "seconds if the power halves (after five seconds of known commands)",
    },
    AlarmCard {
        name: "BatteryWorn",
        level: Level::Warn,
        meaning: "The capacity that the worker has learned of the robot's battery is below 80 % of \
            the stated one, at the upper end of its interval. Budgets and answers count with the \
            learned one.",
        check: "Exchange the battery and state it: `joulebus battery ROBOT --exchanged`. If it is \
            new, check `capacity_wh`, the gain of the power monitor, and the state of charge that \
            the source sends.",
        keys: &["platform.battery.capacity_wh"],
        found_within: "five discharges by 70 % or more",
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
