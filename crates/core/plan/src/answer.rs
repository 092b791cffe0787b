//! Answers to a planner's question.

use std::fmt;

use joulebus_energy::{Limit, Outside};
use joulebus_settings::NO_BATTERY;
use joulebus_wire::{Alarm, AlarmCard, InvalidReason, answer_flag, plan_state_flag};
use serde::{Serialize, Serializer};

/// An amount of energy with its interval, J.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Range {
    /// Expected, J.
    pub mean_j: f32,
    /// Lower end at the asked coverage, J.
    pub lo_j: f32,
    /// Upper end, J.
    pub hi_j: f32,
}

/// Energy left in the battery at the end, J.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Left {
    /// Best estimate, at least 0.
    pub mean_j: f32,
    /// Conservative: the battery's lower bound less the upper end of the plan's energy and the error
    /// of counting it, at least 0.
    pub lo_j: f32,
}

/// The answer to one candidate, path or time at rest.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Answer {
    /// Time from the first command to the end of the last, s.
    pub duration_s: f32,
    /// Energy of the plan. `None` if the robot's state is unknown.
    pub energy: Option<Range>,
    /// Energy left at the end, reserve included. `None` if energy or battery is unknown.
    pub left: Option<Left>,
    /// Probability of finishing above the reserve, with the errors of the energy and of the battery.
    /// `None` where it is not known: with steps outside the training data, if the model states no
    /// distribution of its errors, and if the robot's state is weak or an alarm casts doubt on its
    /// readings.
    pub probability: Option<f32>,
    /// A bound, not an expectation: the lower bound of the spare energy in the battery, less the
    /// upper bound of the energy and the error of counting it, J. Negative if as much may be
    /// missing.
    pub margin_j: Option<f32>,
    /// Whether the robot makes it.
    pub verdict: Verdict,
    /// The first leg at whose end [`Verdict::Yes`] does not hold. `None` with `Yes` and `Unknown`.
    pub limiting_leg: Option<usize>,
    /// Reasons that weaken the answer.
    pub caveats: Caveats,
}

impl Answer {
    /// Before it is computed: fills the memory that [`crate::Robot::what_if_into`] writes into.
    pub const UNKNOWN: Self = Self {
        duration_s: 0.0,
        energy: None,
        left: None,
        probability: None,
        margin_j: None,
        verdict: Verdict::Unknown(Unknown::NoLevel),
        limiting_leg: None,
        caveats: Caveats {
            steps_outside_training: 0,
            outside: None,
            beyond_horizon: false,
            no_reading: false,
            state_outside_training: false,
            late_s: 0,
            alarms: Doubts(0),
            limits: Limits(0),
        },
    };
}

/// Verdict whether a robot makes a plan with its reserve untouched.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Verdict {
    /// The upper bound of the energy, with the error of counting it, fits into the lower bound of
    /// the spare energy, at the end of every leg, and the robot's state is known ([`Caveats`]).
    Yes,
    /// The expected energy fits into the best estimate, but not so surely.
    Tight,
    /// The expected energy does not fit.
    No,
    /// The answer is unknown.
    Unknown(Unknown),
}

/// Reason that an answer is unknown.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Unknown {
    /// The newest frame is older than two ticks: the worker is stopped, overloaded or gone.
    Stale {
        /// Its age, ns.
        age_ns: u64,
    },
    /// The robot has no forecast.
    Invalid {
        /// Why, as JSON by its name.
        #[serde(serialize_with = "name")]
        reason: InvalidReason,
    },
    /// The robot's lag window is not full yet.
    Warmup {
        /// Readings so far.
        have: u16,
    },
    /// Its quality was written by a newer version, or the row contradicts the config.
    Unreadable,
    /// No reading has been metered yet, or the state has values that are not finite.
    NoLevel,
    /// The platform's config describes no battery.
    NoBattery,
    /// The energy in the battery is unknown, or a measured state of charge is below the counted
    /// one.
    BatteryUnknown,
    /// No budget of the robot from the tick of its state, or a later one of the same run, that is
    /// at most two ticks old.
    NoBudget,
}

fn name<S: Serializer>(reason: &InvalidReason, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(reason.name())
}

/// Reasons that weaken an answer.
///
/// What is not known of a *plan* widens its interval. Steps outside the training data count with the
/// lowest and highest power that was recorded. All steps of a model that states no errors count with
/// the platform's minimum and maximum power. Beyond the longest horizon whose errors are known, they are extrapolated. The answer is [`Verdict::Yes`] if
/// the battery spares even that. If the *robot's state* is weak, or an alarm
/// casts doubt on its readings, no interval shows by how much, and the answer is
/// [`Verdict::Tight`] at best. So it is if the model's recordings cannot show what a plan that moves
/// costs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
#[non_exhaustive]
pub struct Caveats {
    /// Steps whose commands lie outside the training data, or all of a model without errors.
    pub steps_outside_training: usize,
    /// The quantity outside that would need the greatest change. `None` without such steps, if the
    /// model knows no errors, and from a worker that does not tell it.
    pub outside: Option<Outside>,
    /// The plan is longer than the longest horizon whose errors are known: its interval and its
    /// probability are extrapolated.
    pub beyond_horizon: bool,
    /// The robot's sample is overdue, or came without a reading.
    pub no_reading: bool,
    /// The robot's newest row lay outside the range that its model was trained on.
    pub state_outside_training: bool,
    /// The longest delay at a point of a path with times, s, rounded up: the platform is not as fast as
    /// they state. The energy is of the delayed drive. 0 if no point is reached more than a second late.
    pub late_s: u16,
    /// Raised alarms that cast doubt on the robot's readings.
    pub alarms: Doubts,
    /// What the model's recordings cannot show of this plan.
    pub limits: Limits,
}

/// Limits of a model's recordings that a plan meets. As JSON: a list of their names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Limits(u32);

/// The limits that an answer states, each with its name and its words.
const LIMITS: [(Limit, &str, &str); 3] = [
    (
        Limit::MeasuredVelocities,
        "measured_velocities",
        "the model was trained on measured velocities, and not on commands",
    ),
    (
        Limit::NoVelocities,
        "no_velocities",
        "the model was trained without velocities, so it does not know what moving costs",
    ),
    (
        Limit::DrivePower,
        "drive_power",
        "the energy is that of the drives alone: state hotel_w in the recipe of the model",
    ),
];

impl Limits {
    /// Those of a model that a plan meets. A plan that turns beyond the training has steps outside.
    pub(crate) fn met(limits: &[Limit], moves: bool, has_hotel: bool) -> Self {
        let is_met = |limit: &Limit| match limit {
            Limit::MeasuredVelocities | Limit::NoVelocities => moves,
            Limit::DrivePower => !has_hotel,
            _ => false,
        };
        let stated = LIMITS.iter().enumerate();
        let met = stated.filter(|(_, (limit, ..))| limits.contains(limit) && is_met(limit));
        Self(met.fold(0, |set, (place, _)| set | 1 << place))
    }

    /// From their bits in an answer's words. Those of a newer version are left out.
    pub(crate) const fn from_bits(bits: u32) -> Self {
        Self(bits & ((1 << LIMITS.len()) - 1))
    }

    /// Their bits in an answer's words.
    pub(crate) const fn bits(self) -> u32 {
        self.0
    }

    /// True if there is none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    fn iter(self) -> impl Iterator<Item = &'static (Limit, &'static str, &'static str)> {
        LIMITS
            .iter()
            .enumerate()
            .filter(move |(place, _)| self.0 >> place & 1 == 1)
            .map(|(_, of)| of)
    }

    /// True if what moving costs is not known. A hotel load that is left out is one of which the
    /// battery's readings know nothing either.
    const fn bar_yes(self) -> bool {
        self.0 & 0b11 != 0
    }

    /// Their names.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        self.iter().map(|(_, name, _)| *name)
    }
}

impl Serialize for Limits {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_seq(self.names())
    }
}

/// A set of the raised alarms that cast doubt on what a robot reports: `NoData`, `OutOfRange`,
/// `StuckSensor`, `HeldTooLong`, `SocImplausible` and `Implausible`.
///
/// As JSON: a list of the alarms' names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Doubts(u16);

/// Name and bit of each alarm in [`Doubts`], as in the flags of an answer's row, and its bit in the
/// flags of a plan state.
const DOUBTS: [(&str, u16, u32); 6] = [
    (Alarm::NoData.name(), answer_flag::ALARM_NO_DATA, plan_state_flag::ALARM_NO_DATA),
    (
        Alarm::OutOfRange.name(),
        answer_flag::ALARM_OUT_OF_RANGE,
        plan_state_flag::ALARM_OUT_OF_RANGE,
    ),
    (
        Alarm::StuckSensor.name(),
        answer_flag::ALARM_STUCK_SENSOR,
        plan_state_flag::ALARM_STUCK_SENSOR,
    ),
    (
        Alarm::HeldTooLong.name(),
        answer_flag::ALARM_HELD_TOO_LONG,
        plan_state_flag::ALARM_HELD_TOO_LONG,
    ),
    (
        Alarm::SocImplausible.name(),
        answer_flag::ALARM_SOC_IMPLAUSIBLE,
        plan_state_flag::ALARM_SOC_IMPLAUSIBLE,
    ),
    (
        AlarmCard::IMPLAUSIBLE.name,
        answer_flag::ALARM_IMPLAUSIBLE,
        plan_state_flag::ALARM_IMPLAUSIBLE,
    ),
];

impl Doubts {
    /// The alarms in the flags of a plan state.
    pub(crate) fn from_state(flags: u32) -> Self {
        let raised = DOUBTS.iter().filter(|(_, _, bit)| flags & bit != 0);
        Self(raised.fold(0, |set, (_, bit, _)| set | bit))
    }

    /// The alarms in the flags of an answer's row.
    pub(crate) fn from_row(flags: u16) -> Self {
        Self(DOUBTS.iter().fold(0, |set, (_, bit, _)| set | (flags & bit)))
    }

    /// Their bits in the flags of an answer's row.
    pub(crate) const fn row_flags(self) -> u16 {
        self.0
    }

    /// True if no such alarm is raised.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Names of the raised alarms.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        DOUBTS.into_iter().filter(move |(_, bit, _)| self.0 & bit != 0).map(|(name, ..)| name)
    }
}

impl Serialize for Doubts {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_seq(self.names())
    }
}

impl Caveats {
    /// True if the robot's state is too weak for [`Verdict::Yes`].
    pub(crate) const fn bar_yes(&self) -> bool {
        self.no_reading
            || self.state_outside_training
            || !self.alarms.is_empty()
            || self.limits.bar_yes()
    }

    /// True if there is any.
    #[must_use]
    pub const fn any(&self) -> bool {
        self.steps_outside_training > 0
            || self.beyond_horizon
            || self.no_reading
            || self.state_outside_training
            || self.late_s > 0
            || !self.alarms.is_empty()
            || !self.limits.is_empty()
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Yes => write!(out, "yes"),
            Self::Tight => write!(out, "tight"),
            Self::No => write!(out, "no"),
            Self::Unknown(reason) => write!(out, "unknown: {reason}"),
        }
    }
}

impl fmt::Display for Unknown {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stale { age_ns } => write!(
                out,
                "the worker's newest frame is {:.2} s old. Does it run?",
                *age_ns as f64 * 1e-9
            ),
            Self::Invalid { reason } => {
                write!(out, "the robot has no forecast ({})", reason.name())
            }
            Self::Warmup { have } => write!(out, "{have} of 5 readings so far"),
            Self::Unreadable => {
                write!(out, "the robot's state does not fit this version or config")
            }
            Self::NoLevel => write!(out, "no power of the robot has been metered yet"),
            Self::NoBattery => write!(out, "{NO_BATTERY}"),
            Self::BatteryUnknown => write!(
                out,
                "the energy in its battery is unknown, or less is measured than was counted: let the \
                 source send state_of_charge, or report a full or exchanged battery"
            ),
            Self::NoBudget => write!(out, "there is no current budget of the robot"),
        }
    }
}

impl fmt::Display for Caveats {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts = Vec::new();
        match (self.steps_outside_training, self.outside) {
            (0, _) => {}
            (steps, None) => parts.push(format!(
                "the model does not know the energy of {steps} steps: they count with the platform's \
                 limits of power"
            )),
            (steps, Some(outside)) => parts.push(outside_words(steps, &outside)),
        }
        if self.beyond_horizon {
            parts.push(
                "the plan is longer than those whose errors the model knows: its interval is \
                extrapolated"
                    .to_owned(),
            );
        }
        if self.no_reading {
            parts.push("no reading at present".to_owned());
        }
        if self.state_outside_training {
            parts.push("the robot is outside the model's training data".to_owned());
        }
        if self.late_s > 0 {
            parts.push(format!(
                "the path's times cannot be kept: the robot is up to {} s late",
                self.late_s
            ));
        }
        if !self.alarms.is_empty() {
            let names: Vec<&str> = self.alarms.names().collect();
            parts.push(format!("alarms cast doubt on its readings: {}", names.join(" and ")));
        }
        parts.extend(self.limits.iter().map(|(.., words)| (*words).to_owned()));
        write!(out, "{}", parts.join(", "))
    }
}

/// Which quantity is outside the training data, its value, its known range and what to change.
fn outside_words(steps: usize, outside: &Outside) -> String {
    let [name, unit] = outside.quantity.words();
    let [lowest, highest] = outside.known.map(number);
    let value = number(outside.value);
    let count = if steps == 1 { "1 step is".to_owned() } else { format!("{steps} steps are") };
    let remedy = match outside.inside_at_mps {
        Some(speed_mps) => format!(", inside at {} m/s", number(0.995 * speed_mps)),
        None => String::new(),
    };
    format!(
        "{count} outside the model's training data ({name} is {value}{unit}, known from {lowest} to \
         {highest}{remedy})"
    )
}

/// A number with three digits that count.
fn number(value: f32) -> String {
    let digits = match value.abs() {
        large if large >= 100.0 => 0,
        large if large >= 10.0 => 1,
        middle if middle >= 1.0 => 2,
        _ => 3,
    };
    let text = format!("{value:.digits$}");
    let text =
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text == "-0" { "0".to_owned() } else { text.replace('-', "−") }
}
